"""What a stream tells and what it remembers."""

from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np

from neurotact.data.causal import Conditioned
from neurotact.deploy.running import Running
from neurotact.deploy.windows import Opening
from neurotact.encoders.afferents import EncoderState


class Decision(NamedTuple):
    """What the network decided of one window, and what it did for it.

    window: number of the window in the stream. time_s: when it was decided, from the first sample on.
    start_step: the window's first step on the encoder's clock, since the stream or its last gap began.
    label, index: the class. steps: steps that were simulated. ms: the same in time.
    input_spikes, hidden_spikes: in those steps. sops: synaptic operations in them, in total.
    held: steps that rest on repeated values, since their own were missing or not finite.
    heard: whether the readout moved at all; where it did not, nothing speaks for the class but its place.
    """

    window: int
    time_s: float
    start_step: int
    label: str
    index: int
    steps: int
    ms: float
    input_spikes: int
    hidden_spikes: int
    sops: int
    held: int
    heard: bool


class Trace(NamedTuple):
    """What spiked in successive steps of a stream, for whoever watches it.

    begin_s: when the first of them began, from the first sample on. step_s: of the encoder's clock.
    afferents: `(step, afferent)` bool. hidden: `(step, hidden)` bool, what the hidden layer of the oldest window under
    way sent to the readout. window: the number of that window, `(step,)` int64; -1 where none heard the step.
    """

    begin_s: float
    step_s: float
    afferents: np.ndarray
    hidden: np.ndarray
    window: np.ndarray


@dataclass
class Tally:
    """What a stream has met so far.

    samples: taken, missing ones not counted; held: samples with a value that was repeated; missing: samples that never
    came; gaps: times that the chain began anew; skipped: samples before the first good one, or inside a gap;
    dropped: windows that a gap cut off; decisions; unfinished: windows that a trial's end cut off.
    """

    samples: int = 0
    held: int = 0
    missing: int = 0
    gaps: int = 0
    skipped: int = 0
    dropped: int = 0
    decisions: int = 0
    unfinished: int = 0

    def trouble(self) -> str:
        """What is not zero of all but samples and decisions, in words; empty where nothing was amiss."""
        counted = ((each.name, getattr(self, each.name)) for each in fields(self))
        return ", ".join(f"{name} {n}" for name, n in counted if n and name not in ("samples", "decisions"))


@dataclass
class StreamState:
    """Everything that a stream remembers: `Stream.state` gives it, `Stream.restore` takes it."""

    opening: Opening
    conditioned: Conditioned = field(default_factory=Conditioned)
    encoder: EncoderState | None = None
    windows: tuple[Running, ...] = ()
    n_windows: int = 0
    good: np.ndarray | None = None
    bad_in_a_row: int = 0
    origin: int = 0
    tally: Tally = field(default_factory=Tally)


def copied(state: StreamState) -> StreamState:
    """A state apart: all in it is replaced, never written to, but for the tally."""
    return replace(state, tally=replace(state.tally))
