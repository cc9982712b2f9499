"""How events become spikes: each option with its unit and its line."""

from typing import Literal

import numpy as np
from pydantic import Field, field_validator

from neurotact.data.readers.clock.units import Unit
from neurotact.spec import Names, Spec, chosen

MOST_AFFERENTS = 65_536
SIGNED_MATRIX = "a matrix of -1, 0 and 1 with the times of its columns as the last row"
"""One of the layouts of events, in words."""


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


def holds_events(matrix: np.ndarray) -> bool:
    """Whether a matrix is a `SIGNED_MATRIX`, of which the last row rises.

    >>> holds_events(np.array([[1, 0, 0], [0, -1, 1], [0.1, 0.25, 0.3]]))
    True
    >>> holds_events(np.array([[1, 0, 0], [0, -1, 1], [0, 0, 1]])), holds_events(np.array([[1, 2], [0.1, 0.2]]))
    (False, False)
    """
    if matrix.ndim != 2 or matrix.dtype.kind not in "iuf" or min(matrix.shape) < 2:
        return False
    rows, times, signs = matrix[:-1], matrix[-1], (-1, 0, 1)
    if not (np.diff(times) >= 0).all() or np.isin(times, signs).all() or not np.isin(rows[0], signs).all():
        return False  # as nearly all signals, which may be large
    return bool(np.isin(rows, signs).all() and rows.any())
