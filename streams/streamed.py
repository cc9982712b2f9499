"""How a chain runs on samples as they come, and how these samples are read: each option with its unit and its line."""

from typing import Literal

from pydantic import Field

from neurotact import effects
from neurotact.data.readers.clock.units import Unit
from neurotact.spec import Spec


class StreamedSpec(Spec):
    """How a chain runs on a signal without an end, `nt.Streamed`: the rate, the windows, and when they are decided.

    >>> StreamedSpec(hop_ms=20)
    Streamed(hop_ms=20.0)
    """

    public = "Streamed"
    sampling_rate_Hz: float | None = Field(default=None, ge=1e-3)
    """Sampling rate of the input; when absent, of the recordings. A chain without resampling has one rate alone."""
    length_ms: float | None = Field(default=None, gt=0)
    """Length of a window; as in training when absent."""
    start_ms: float | None = Field(default=None, ge=0)
    """Start of the first window; as in training when absent."""
    hop_ms: float | None = Field(default=None, gt=0)
    """Time between the starts of windows; the window length when absent."""
    contact: bool = False
    """Start a window at the first spike after `quiet_ms` without spikes."""
    quiet_ms: float = Field(default=50.0, ge=0)
    """With `contact`: time without spikes before a window can start."""
    full_window: bool = False
    """Decide at the end of each window, without early exit. Otherwise as soon as the validated rule of the run
    allows."""

    def check_given(self) -> None:
        """Refuse what has no effect."""
        effects.check(**self.given() | {"contact": self.contact})


class SampleSpec(Spec):
    """How samples are read from a pipe, a device or a file, `nt.Samples`.

    >>> SampleSpec(format="int16", lsb=0.5)
    Samples(format='int16', lsb=0.5)
    """

    public = "Samples"
    format: Literal["csv", "float32", "int16"] = "csv"
    """Format of input other than .h5: csv, float32 or int16."""
    baud: int = Field(default=115_200, ge=1, le=100_000_000)
    """Baud rate of a serial port."""
    unit: str | None = None
    """Unit of the input; the encoder's when absent."""
    time_column: Unit | None = None
    """Unit of a time stamp in the first column, s, ms, us or ns; missing rows are then detected."""
    lsb: float = Field(default=1.0, ge=1e-30)
    """With `format="int16"`: signal per digit; signal = zero + lsb * x."""
    zero: float = 0.0
    """With `format="int16"`: the signal at digit 0."""
    hold_ms: float = Field(default=5.0, ge=0)
    """A missing value repeats the last one for this long at most; longer is a gap."""
    stall_s: float = Field(default=1.0, ge=1e-3)
    """A pipe without input for this long counts as a gap."""

    def check_given(self) -> None:
        """Refuse what the format does not use."""
        effects.check(**self.given() | {"format": self.format})
