"""The onset of contact in a trial of spikes: the first time that the spike count rises above rest."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from neurotact.errors import InputError
from neurotact.spec import Spec

REST_MS = 50.0
"""Length of the rest at the beginning of a trial, where none is given."""


class OnsetSpec(Spec):
    """The rule for the onset of contact, `nt.Onset`; it is causal.

    c(t) is the number of spikes of all afferents in the last `bin_ms`. A trial begins at rest: m and s are the mean and
    the deviation of c over its first `rest_ms`. The onset is the first step after them at which c > m + deviations s;
    s is at least sqrt(m), the deviation of a Poisson count, and at least one spike, so that a silent rest works too.
    """

    public = "Onset"
    rest_ms: float = Field(default=REST_MS, gt=0)
    """With `align="onset"`: length of the rest at the start of each trial."""
    bin_ms: float = Field(default=10.0, gt=0)
    """Length of the bin in which spikes are counted; a shorter rest is one bin."""
    deviations: float = Field(default=3.0, gt=0)
    """With `align="onset"`: contact begins this many standard deviations above the mean count at rest."""

    @model_validator(mode="before")
    @classmethod
    def _has_a_bin_in_a_short_rest(cls, table: Any) -> Any:
        """The bin of a rest that is shorter than the usual bin.

        >>> OnsetSpec(rest_ms=5).bin_ms
        5.0
        """
        rest_ms = table.get("rest_ms") if isinstance(table, Mapping) else None
        is_short = isinstance(rest_ms, int | float) and rest_ms < cls.model_fields["bin_ms"].default
        return {"bin_ms": rest_ms, **table} if is_short else table

    @model_validator(mode="after")
    def _rests_for_a_bin(self) -> "OnsetSpec":
        if self.bin_ms > self.rest_ms:
            raise ValueError(f"bin_ms must not exceed rest_ms; got {self.bin_ms} and {self.rest_ms}")
        return self


def onset_of(steps: np.ndarray, sampling_rate_Hz: float, spec: OnsetSpec) -> int | None:
    """The step of a trial at which contact begins; None if the spike count never rises above rest.

    steps: of every spike of the trial, ascending. Raises InputError where a bin is shorter than one step.

    >>> silent_then_four_a_step = np.repeat(np.arange(70, 100), 4)
    >>> onset_of(silent_then_four_a_step, 1000.0, OnsetSpec())
    70
    """
    rest, width = (round(ms * 1e-3 * sampling_rate_Hz) for ms in (spec.rest_ms, spec.bin_ms))
    if width < 1:
        raise InputError(
            f"window.onset.bin_ms: {spec.bin_ms:g} ms is less than one step at {sampling_rate_Hz:g} Hz; lengthen it"
        )
    at_rest = _counts(steps, np.arange(width - 1, rest), width)
    mean = at_rest.mean()
    level = mean + spec.deviations * max(at_rest.std(), np.sqrt(mean), 1.0)
    later = np.concatenate([[rest], steps[np.searchsorted(steps, rest) :]])  # a count rises only at a spike
    above = later[_counts(steps, later, width) > level]
    return int(above[0]) if len(above) else None


def _counts(steps: np.ndarray, ends: np.ndarray, width: int) -> np.ndarray:
    """Spikes in the `width` steps that end with each step of `ends`."""
    return np.searchsorted(steps, ends, "right") - np.searchsorted(steps, ends - width, "right")
