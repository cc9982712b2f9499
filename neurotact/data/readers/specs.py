"""What users say of files: where the class and the conditions are, and how events become spikes."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from neurotact.data.readers.clock.units import Unit
from neurotact.data.recordings import LABEL
from neurotact.spec import Names, Spec, chosen

MOST_AFFERENTS = 65_536
FILE = "file"
FIELD = re.compile(r"\{([^{}]*)\}")


class NamingSpec(Spec):
    """The source of the class and the conditions of a file, `nt.Naming`.

    A pattern holds names in braces, `{label}_F{force}_{repetition}.csv`; each stands for one character or more, as few
    as fit. Values that are numbers in every file become numbers; `label` stays text.
    """

    public = "Naming"
    levels: Names = Field(default=(), json_schema_extra=chosen("label"))
    """Conditions that name the sub-folders, from the top, as in label,speed. Each may be a pattern
    (`{speed}mm_per_s`); deeper folders are read too. `label` alone if neither pattern nor table gives the label."""
    pattern: str | None = None
    """Conditions in the file names, as in {label}_F{force}_{repetition}.csv. Of the end of the path if the pattern
    holds a `/`."""
    table: Annotated[str | None, BeforeValidator(lambda path: path and str(path))] = None
    """A CSV file with the column file and one column per condition. The column holds the path or the name of each
    file."""
    label: str | None = Field(default=None, json_schema_extra=chosen("that which is called label"))
    """The condition that is the class."""

    @model_validator(mode="after")
    def _names_each_condition_once(self) -> NamingSpec:
        if self.pattern is not None and not FIELD.search(self.pattern):
            raise ValueError(f"pattern must hold a name in braces, such as {{label}}; got {self.pattern!r}")
        patterns = [*self.levels, *([] if self.pattern is None else [self.pattern])]
        names = [name for pattern in patterns for name in _fields(pattern)]
        wrong = [name for name in names if not name.isidentifier()]
        twice = [name for name in names if names.count(name) > 1]
        if wrong:
            raise ValueError(f"a condition is a word of letters, digits and _; got {wrong[0]!r}")
        if twice or FILE in names:
            raise ValueError(f"{(twice or [FILE])[0]!r} is named twice; give each condition once")
        return self

    @property
    def is_label_by_folder(self) -> bool:
        """Whether the label is the first sub-folder because nothing else is given."""
        is_given = bool(self.levels) or self.table is not None or self.label not in (None, LABEL)
        return not is_given and LABEL not in _fields(self.pattern or "")


def _fields(pattern: str) -> list[str]:
    """The names in a pattern; a level without braces is a name."""
    return FIELD.findall(pattern) if "{" in pattern else [pattern]


class EventSpec(Spec):
    """How events become spikes, `nt.Events`.

    >>> EventSpec(step_ms=0.5, polarity="merge")
    Events(step_ms=0.5, polarity='merge')
    """

    public = "Events"
    step_ms: float = Field(default=1.0, gt=0)
    """Time step of the spikes. Events of an afferent within one step are one spike."""
    time_unit: Unit | None = Field(default=None, json_schema_extra=chosen("of the file, else s; us for x, y, t, p"))
    """Unit of the times. That of the file is in a name, as in `time_us`."""
    origin: Literal["zero", "first"] = "zero"
    """Start of a trial: time zero, or its first event."""
    duration_ms: float | None = Field(default=None, gt=0, json_schema_extra=chosen("up to the last event"))
    """Length of every trial. Later events are dropped."""
    polarity: Literal["separate", "merge", "on", "off"] = "separate"
    """One population per polarity, one for both (merge), or one polarity only."""
    polarities: Names = Field(default=(), json_schema_extra=chosen("OFF,ON"))
    """Names of the polarities, from the lowest value."""
    channels: Names = ()
    """Names of the channels, from channel 0."""
    n_channels: int | None = Field(
        default=None, ge=1, le=MOST_AFFERENTS, json_schema_extra=chosen("up to the last event's")
    )
    """Number of channels. Those without events count, too."""
    sensor: str | None = Field(default=None, pattern=r"^[1-9]\d{0,4}x[1-9]\d{0,4}$")
    """Size of the grid of x, y, t, p events, as in 34x34. Up to the last with an event when absent."""
    merge_events: bool = False
    """Accept that more than 1 % of the events become one spike with another of their channel and step."""

    @field_validator("polarities", "channels")
    @classmethod
    def _each_once(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"{twice[0]!r} is there twice; give each its own name")
        return names
