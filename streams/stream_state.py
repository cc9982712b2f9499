"""The decisions and the state of a stream."""

from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.streams.running import Running
from neurotact_parts.streams.windows import Opening

from neurotact.data.conditioning import Conditioned


class Decision(NamedTuple):
    """The decision of a network about one window, and its cost.

    window: number of the window in the stream. time_s: time of the decision, from the first sample on.
    start_step: the window's first step on the encoder's clock, since the start of the stream or its last gap.
    label, index: the class; `none` and the number of classes for none of them (`ExitRule.told`).
    steps: number of simulated steps. ms: the same in time.
    input_spikes, hidden_spikes: in those steps. sops: synaptic operations in them, in total.
    held: number of steps that use repeated values, because their own were missing or not finite.
    heard: whether the readout changed; if not, the class was chosen by its index alone.
    values: of a network that tells numbers, each target and its value, in its unit; `label` then holds them as text.

    >>> decision = next(nt.stream("run", "touch.h5").decisions)
    >>> decision.ms == 1e3 * decision.steps / 1000.0
    True
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
    values: dict[str, float] | None = None


class Trace(NamedTuple):
    """The spikes in successive steps of a stream, for `watch`.

    begin_s: start of the first step, from the first sample on. step_s: of the encoder's clock.
    afferents: `(step, afferent)` bool. hidden: `(step, hidden)` bool, spikes that the hidden layer of the oldest open
    window sent to the readout. window: number of that window, `(step,)` int64; -1 if no window was open.
    """

    begin_s: float
    step_s: float
    afferents: np.ndarray
    hidden: np.ndarray
    window: np.ndarray


@dataclass
class Tally:
    """The counts of a stream.

    samples: processed, without missing ones; held: samples with a repeated value; missing: samples that did not arrive;
    gaps: how often the chain restarted; skipped: samples before the first valid one, or inside a gap;
    dropped: windows that a gap cut off; decisions; unfinished: windows that a trial's end cut off.
    events: of a sensor that sends them, and of these late: of a step that was over; doubled: one spike with another of
    their step and channel; unknown: of no channel of the network. A sample is then a step.
    """

    samples: int = 0
    held: int = 0
    missing: int = 0
    gaps: int = 0
    skipped: int = 0
    dropped: int = 0
    decisions: int = 0
    unfinished: int = 0
    events: int = 0
    late: int = 0
    doubled: int = 0
    unknown: int = 0

    def trouble(self) -> str:
        """The counts of errors that are not zero, in words; empty without errors."""
        counted = ((count.name, getattr(self, count.name)) for count in fields(self))
        return ", ".join(f"{name} {n}" for name, n in counted if n and name not in ("samples", "events", "decisions"))


@dataclass
class StreamState:
    """The whole state of a stream: `Stream.state` returns it, `Stream.restore` sets it.

    event_step: the step under way, of events. waiting: the afferents with an event in it, `(afferent,)` bool.
    """

    opening: Opening
    conditioned: Conditioned = field(default_factory=Conditioned)
    encoder: Any = None
    windows: tuple[Running, ...] = ()
    n_windows: int = 0
    good: np.ndarray | None = None
    bad_in_a_row: int = 0
    origin: int = 0
    tally: Tally = field(default_factory=Tally)
    event_step: int = 0
    waiting: np.ndarray | None = None


def copied(state: StreamState) -> StreamState:
    """A copy of a state; only the tally is copied, since all other parts are replaced and never changed."""
    return replace(state, tally=replace(state.tally))
