"""Sets of touches with every condition of their trials: simulated, read in published formats, or a user's own file."""

from typing import Any

from neurotact_parts.studies.comparison.arrays import as_arrays
from neurotact_parts.studies.comparison.sets import check_named
from neurotact_parts.studies.comparison.skipped import left_out
from pydantic import Field, model_validator

from neurotact.data.dataset import DatasetSpec, joined, load_recordings
from neurotact.errors import InputError
from neurotact.spec import Spec
from neurotact.studies.way import Arrays


class TouchSet(Spec):
    """A set of touches: recordings of one skin, in one or several parts."""

    parts: dict[str, DatasetSpec] = Field(min_length=1)
    """The parts by name; their trials follow each other."""
    keys: dict[str, Any] = {}
    """Keys of `own-recordings` for this set, such as `window.length_ms`."""


class TouchData(Spec):
    """The chosen set, and all sets."""

    set: str
    sets: dict[str, TouchSet]

    @model_validator(mode="after")
    def _names_a_set(self) -> "TouchData":
        check_named(self.set, self.sets)
        return self

    @property
    def chosen(self) -> TouchSet:
        return self.sets[self.set]


def load(data: TouchData) -> Arrays:
    """Recordings as arrays, or only the reason for their absence.

    Raises InputError if a user's own file does not exist, or was changed since the study began.
    """
    parts = [*data.chosen.parts.values()]
    try:
        return as_arrays(joined([*map(load_recordings, parts)]))
    except InputError as error:
        return left_out(data.set, error, parts[0])
