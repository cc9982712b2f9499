"""Streaming: samples are processed as they arrive, and windows are decided as soon as the rule allows.

A value that is NaN, infinite or beyond `LARGEST` is replaced by the taxel's last valid one and counted (`held`); a
decision contains the number of its steps that use such values. More of them in a row than `hold_ms`, or as many missing
samples, are a gap: open windows are dropped and the chain restarts, as with a new trial. A decision therefore
shows whether it uses values that were not recorded.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from neurotact_parts.streams import running, stream_file
from neurotact_parts.streams.chain import LARGEST, Chain, chain_of
from neurotact_parts.streams.events import (
    LEFT_OUT,
    UNKNOWN,
    Channels,
    afferents_of,
    rows_until,
    sorted_events,
    steps_at,
)
from neurotact_parts.streams.native import CompiledStream, Decided, Remembered
from neurotact_parts.streams.stream_state import Decision, StreamState, Tally, Trace, copied
from neurotact_parts.streams.streamed import SampleSpec, StreamedSpec

from neurotact.backend import Backend, use_native
from neurotact.data.conditioning import Conditioner
from neurotact.data.recordings import order_by_name, unit_factor
from neurotact.encoders.afferents import POPULATIONS, AfferentSpec
from neurotact.encoders.model import EncoderSpec
from neurotact.encoders.specs import conditioning_of, encode, finish, is_exact
from neurotact.errors import InputError, number_of
from neurotact.metrics import synops
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.use.fitted import Fitted


def _fixed(encoder: EncoderSpec) -> tuple[object, ...]:
    """What a running stream cannot change."""
    taxels = [getattr(getattr(encoder, part, None), "taxels", None) for part in POPULATIONS]
    return encoder.conditioning, encoder.unit, encoder.model, is_exact(encoder), taxels


OF_EVENTS = "stream: the network takes the events of a sensor, not {}; give them to push_events, and time to advance"
MOST_AHEAD_S = 86_400.0
"""Seconds from one event to the next."""
MOST_STEPS_AT_ONCE = 10_000
"""Of the encoder's clock: longer blocks are processed in parts, so that a fine clock needs no more memory."""


class Stream:
    """A trained chain that processes samples as they arrive.

    source: a run folder that `train` wrote, a fitted `SpikingClassifier` or a pipeline that ends in one, a `Chain`, or
        an encoder and a network.
    streamed: the rate, the windows and their decisions, such as `nt.Streamed(hop_ms=20)`; what is not given is as in
        training. Not for a `Chain`, which has them.
    unit: of the samples; None: that of the encoder.
    hold_ms: for how long a missing value is replaced by the last valid one; at least one sample.
    backend: the compiled step or the reference, which decide the same.
    watch: called with a `Trace` of the processed steps, block by block; the decisions are the same.

    Decisions equal those of `encode` and `infer` on the whole trial, spike for spike, for any blocks.
    InputError for an encoder with a baseline of the whole trial, and for samples with another number of taxels.

    A network that was trained on the events of a sensor takes these, with `push_events`, `advance` and `flush`, and no
    samples; its encoder is None in a pair.

    >>> from neurotact.encoders import specs
    >>> encoder = specs.load("sa1-ra1-lif", {"conditioning.baseline": "start"})
    >>> network = RSNN(16, 2, hidden=4, sampling_rate_Hz=2000.0)
    >>> stream = Stream((encoder, network), streamed=StreamedSpec(length_ms=5))
    >>> [decision.steps for decision in stream.push(np.zeros((25, 8)))]
    [10, 10]
    """

    def __init__(
        self,
        source: Fitted | Chain | tuple[EncoderSpec | None, RSNN],
        *,
        streamed: StreamedSpec = StreamedSpec(),
        unit: str | None = None,
        hold_ms: float = SampleSpec().hold_ms,
        backend: Backend = "auto",
        watch: Callable[[Trace], None] | None = None,
    ) -> None:
        if isinstance(source, Chain) and streamed.given():
            raise InputError("streamed: is an argument of chain_of; give it there")
        # An estimator is of an untyped class, of which a type checker thinks that it may be a Chain, too.
        self.chain = cast(Chain, source) if isinstance(source, Chain) else chain_of(source, streamed)
        columns, self._used = self.chain.of_used()
        self._columns = None if self._used.encoder is self.chain.encoder else columns
        self._options: dict[str, Any] = {"unit": unit, "hold_ms": hold_ms, "backend": backend, "watch": watch}
        encoder, rate_Hz = self._used.encoder, self.chain.sampling_rate_Hz
        factor = unit_factor(unit or encoder.unit, encoder.unit, "samples")
        self.conditioner = Conditioner(rate_Hz, conditioning_of(encoder, rate_Hz), factor=factor)
        if not 0 <= hold_ms < 1e9:
            raise InputError(f"hold_ms: must be from 0 to 1e9 ms; got {hold_ms:g}")
        self._most_samples = max(1, int(MOST_STEPS_AT_ONCE * min(1.0, rate_Hz / self.chain.clock_Hz)))
        self.hold_samples = max(1, int(hold_ms * 1e-3 * rate_Hz))
        # Where the step is compiled, filters, neurons and windows are kept there, and this state is behind until
        # `_copy_state` fetches them.
        self._state = StreamState(self.chain.windows.begin())
        # Synaptic operations are linear in the spikes: the cost of one input spike, and of one hidden spike.
        costs = synops.of_network(self.chain.network, np.array([1, 0]), np.array([0, 1])).total
        self._sops, self._fans = tuple(int(cost) for cost in costs), running.fans_of(self.chain.network)
        self._rates_Hz = rate_Hz, self.chain.clock_Hz
        self._classes = (*self.chain.classes, synops.REFUSED)
        self._compiled: CompiledStream | None = None
        is_plain = isinstance(encoder, AfferentSpec) and encoder.is_plain
        is_fit = is_plain and not is_exact(encoder) and not self.chain.tells_numbers
        is_fit = is_fit and self.chain.detector is None and not self.chain.rule.band
        compilable = self.chain.network.w_in.device.type == "cpu" and is_fit
        if use_native(backend, compilable, "a network of classes on the CPU, and plain SA-I and RA-I on a clock"):
            self._compiled = CompiledStream(self._used, self.conditioner, self._most_samples)
        self._channels: Channels | None = None
        if self.chain.takes_events:
            self._channels = Channels(afferents_of(self.chain))
        self._watch = watch
        if watch is not None and self._compiled is not None:
            self._compiled.watch()

    @property
    def tally(self) -> Tally:
        """The counts so far."""
        self._count_samples()
        return replace(self._state.tally)

    def push(self, samples: np.ndarray) -> list[Decision]:
        """Decisions of the windows that these samples complete or let exit.

        samples: `(sample, taxel)`, or `(taxel,)` for one, in the given unit; NaN for a missing value. A table of pandas
            is taken by the names of its columns, where the chain knows those of its taxels.
        """
        if self._channels is not None:
            raise InputError(OF_EVENTS.format("samples"))
        if (columns := getattr(samples, "columns", None)) is not None:
            order = order_by_name([*map(str, columns)], self.chain.taxels, "samples", "column")
            samples = np.asarray(samples, np.float32)[:, slice(None) if order is None else order]
        # Which checks for itself, in a fraction of the time of `_checked`.
        decided = self._take(samples) if self._columns is None else None
        if decided is None:
            samples = self._checked(samples)
            decided = self._take(samples)
        if decided is not None:
            return self._from_compiled(decided)
        self._count_samples()
        is_good = np.abs(samples) <= LARGEST  # not NaN either
        if is_good.all() and self._state.bad_in_a_row == 0:
            self._state.tally.samples += len(samples)
            self._state.good = samples[-1].copy() if len(samples) else self._state.good
            return self._condition(samples, held=False)
        decisions: list[Decision] = []
        for sample, good in zip(samples, is_good, strict=True):
            decisions += self._push_one(sample, good)
        return decisions

    def push_events(self, time_s: Any, channel: Any, polarity: Any = None) -> list[Decision]:
        """Decisions of the steps that these events of a sensor end, each of which ends the steps before its own.

        time_s: of each event, since the stream began, its last gap or the end of its last trial, `(event,)` or one.
        channel: numbers from 0 or names, as at import. polarity: or population, where afferents have one; without it, a
            channel is an afferent's number or whole name.
        Events may come in any order within a step; those of an afferent in one step are one spike. The counts of those
        that are late, doubled or of an unknown channel are in `tally`.

        >>> stream = Stream((None, RSNN(3, 2, hidden=4, sampling_rate_Hz=1000.0)), streamed=StreamedSpec(length_ms=5))
        >>> stream.push_events([0.0004, 0.0001, 0.0021], [2, 0, 7])
        []
        >>> [decision.input_spikes for decision in stream.advance(0.005)], stream.tally.unknown
        ([2], 1)
        """
        others = None if polarity is None else np.atleast_1d(polarity)
        return self.push_numbered(time_s, self._of_events("events").numbers(np.atleast_1d(channel), others))

    def push_numbered(self, time_s: Any, units: Any) -> list[Decision]:
        """The same of the numbers of afferents, `UNKNOWN` or `LEFT_OUT` for an event that is of none."""
        self._of_events("events")
        steps, units = steps_at(time_s, self.chain.clock_Hz), np.asarray(units, np.int64)
        if len(units) != len(steps):
            raise InputError(
                f"channel: has {number_of(len(units), 'value')} for {number_of(len(steps), 'time')}; give one an event"
            )
        self._state.tally.events += int((units != LEFT_OUT).sum())
        self._state.tally.unknown += int((units == UNKNOWN).sum())
        return self._take_events(steps, units)

    def advance(self, time_s: float) -> list[Decision]:
        """Decisions of the steps that are over at a time, though no event has come."""
        self._of_events("a time")
        return self._take_events(steps_at(time_s, self.chain.clock_Hz)[:1], np.array([UNKNOWN]))

    def flush(self) -> list[Decision]:
        """Decisions of the step under way and of open windows, which end without another event."""
        self._of_events("a flush")
        decisions = self._end_step()
        self._copy_state()
        state, length = self._state, self.chain.windows.length
        left = max((length - window.steps for window in state.windows), default=0)
        return decisions + self._take_events(np.array([state.event_step + left]), np.array([UNKNOWN]))

    def _of_events(self, what: str) -> Channels:
        if self._channels is None:
            raise InputError(f"stream: has an encoder, which takes samples and not {what}; give samples to push")
        return self._channels

    def _take_events(self, steps: np.ndarray, units: np.ndarray) -> list[Decision]:
        state = self._state
        waiting = np.zeros(self.chain.n_taxels, bool) if state.waiting is None else state.waiting
        if len(steps) and np.diff(steps, prepend=state.event_step).max() > MOST_AHEAD_S * self.chain.clock_Hz:
            raise InputError("time_s: an event is more than a day after the one before it; give times in s")
        events = sorted_events(steps, units, state.event_step, waiting)
        state.tally.late += events.late
        state.tally.doubled += events.doubled
        end = max(state.event_step, int(steps.max(initial=0)))
        decisions = self._push_rows(rows_until(events, state.event_step, end, waiting))
        waiting = waiting.copy() if end == state.event_step else np.zeros_like(waiting)
        waiting[events.units[events.steps == end]] = True
        self._state.event_step, self._state.waiting = end, waiting
        return decisions

    def _end_step(self) -> list[Decision]:
        """End the step under way, if it has events."""
        state = self._state
        if state.waiting is None or not state.waiting.any():
            return []
        return self._take_events(np.array([state.event_step + 1]), np.array([UNKNOWN]))

    def _push_rows(self, blocks: Iterable[np.ndarray]) -> list[Decision]:
        """Steps of events, `(step, afferent)` float32 of 0 and 1."""
        decisions: list[Decision] = []
        for rows in blocks:
            self._count_samples()
            self._state.tally.samples += len(rows)
            self._state.good = rows[-1].copy()
            decisions += self._condition(rows, held=False)
        return decisions

    def missing(self, n_samples: int) -> list[Decision]:
        """The source lost `n_samples`: up to `hold_ms` of them are replaced by the last one, more are a gap."""
        if self._channels is not None:
            raise InputError(OF_EVENTS.format("missing samples"))
        if n_samples < 0:
            raise InputError(f"missing: counts samples; got {n_samples}")
        self._count_samples()
        self._state.tally.missing += n_samples
        self._state.bad_in_a_row += n_samples
        good = self._state.good
        if good is None or self._state.bad_in_a_row > self.hold_samples:
            if good is not None:
                self._gap()
            self._state.origin += n_samples
            return []
        return self._condition(np.broadcast_to(good, (n_samples, len(good))), held=True)

    def gap(self) -> None:
        """An unknown number of samples was lost: the chain restarts with the next sample."""
        self._count_samples()
        if self._state.good is not None:
            self._gap()

    def finish(self) -> list[Decision]:
        """End the trial: process the step that resampling delayed, then restart; the counts continue.

        A window that the trial's end cuts off is decided if it exited before, and is otherwise counted as unfinished.
        Of events, the step under way ends; `flush` before lets open windows end.
        """
        if self._channels is not None:
            ended = self._end_step()
            self._copy_state()
            self._end_windows()
            return ended
        self._copy_state()
        signal, _ = self.conditioner.finish(self._state.conditioned)
        decisions = self._encode(signal, held=False) if len(signal) else []
        state = self._state
        if state.encoder is not None:
            rest = finish(self.chain.signal_Hz, self._used.encoder, state.encoder)
            decisions += [] if rest is None else self._decide(rest[0], held=False)
        state.bad_in_a_row = 0
        self._end_windows()
        return decisions

    def _end_windows(self) -> None:
        """Restart after the end of a trial; a detector has no window that it cuts off."""
        if self.chain.detector is None:
            self._state.tally.unfinished += len(self._state.windows)
        self._restart()

    def reset(self) -> None:
        """Return to the state before the first sample; the counts too."""
        self._set_state(StreamState(self.chain.windows.begin()))

    def state(self) -> StreamState:
        """A copy of the whole state."""
        self._copy_state()
        return copied(self._state)

    def restore(self, state: StreamState) -> None:
        """Continue from a state of a stream of the same chain."""
        n_taxels = None if state.good is None else len(state.good)
        if n_taxels not in (None, self._used.n_taxels) or state.opening.plan != self.chain.windows:
            raise InputError("state: belongs to a stream of another chain; restore one of this chain")
        self._set_state(copied(state))

    def changed(self, *, encoder: EncoderSpec | None = None, rule: ExitRule | None = None) -> "Stream":
        """A stream of this chain with other afferents or another exit rule, which continues from the current state.

        The new values apply from the next sample on, also to open windows. Membranes and remaining refractory periods
        are carried over: the spikes are those of `encode` with the first encoder until now, and then, with the state
        that it returned, with the other. This stream is not changed.
        InputError for another conditioning or model: the values so far would have another meaning.
        """
        own = self.chain.encoder
        if encoder is not None and _fixed(encoder) != _fixed(own):
            raise InputError(
                "encoder: has another conditioning, unit, model or taxels; a running stream can change only afferents"
            )
        chain = self.chain._replace(encoder=encoder or self.chain.encoder, rule=rule or self.chain.rule)
        stream = Stream(chain, **self._options)
        stream.restore(self.state())
        return stream

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Save the whole state; an existing file is refused unless `force`."""
        stream_file.save(self._used, self.state(), path, force=force)

    def load(self, path: str | Path) -> None:
        """Continue from a file that `save` wrote; InputError if it is damaged or of another chain."""
        self.restore(stream_file.load(self._used, path))

    def decide(self, blocks: Iterable[np.ndarray]) -> Iterator[Decision]:
        """Decisions of a sequence of blocks, and of its end."""
        for block in blocks:
            yield from self.push(block)
        yield from self.finish()

    def _copy_state(self) -> None:
        """Copy the state of the compiled step."""
        self._count_samples()
        if self._compiled is not None:
            self._state = replace(self._state, **self._compiled.remembered()._asdict())

    def _take(self, samples: np.ndarray) -> list[Decided] | None:
        """The decisions of the compiled step; None if it cannot process the samples as they are."""
        if self._compiled is None or self._state.bad_in_a_row:
            return None
        return self._compiled.take(samples)

    def _count_samples(self) -> None:
        """Count the samples that the compiled step has processed since the last call."""
        if self._compiled is not None:
            n_samples, last = self._compiled.counted()
            if n_samples:
                self._state.tally.samples += n_samples
                self._state.good = last

    def _set_state(self, state: StreamState) -> None:
        """Set the state, also in the compiled step."""
        self._state = state
        if self._compiled is not None:
            self._compiled.remember(Remembered(*(getattr(state, name) for name in Remembered._fields)))

    def _checked(self, samples: np.ndarray) -> np.ndarray:
        try:
            with np.errstate(over="ignore"):
                samples = np.ascontiguousarray(samples, np.float32)
        except (TypeError, ValueError) as error:
            raise InputError(f"samples: are not a table of numbers ({error})") from error
        samples = samples[None] if samples.ndim == 1 else samples
        if samples.ndim == 2 and samples.shape[0] == self.chain.n_taxels != samples.shape[1]:
            raise InputError(f"samples: are (taxel, sample), as {len(samples)} is the number of taxels; give samples.T")
        if samples.ndim != 2 or samples.shape[1] != self.chain.n_taxels:
            raise InputError(
                f"samples: have shape {samples.shape} where (sample, {self.chain.n_taxels}) is expected; give the "
                "taxels that the network was trained on"
            )
        return samples if self._columns is None else np.ascontiguousarray(samples[:, self._columns])

    def _push_one(self, sample: np.ndarray, is_good: np.ndarray) -> list[Decision]:
        state = self._state
        state.tally.samples += 1
        all_good = bool(is_good.all())
        if not all_good:
            state.bad_in_a_row += 1
            if state.good is None or state.bad_in_a_row > self.hold_samples:
                if state.good is not None:
                    self._gap()
                self._state.tally.skipped += 1
                self._state.origin += 1
                return []
            sample = np.where(is_good, sample, state.good)
            state.tally.held += 1
        else:
            state.bad_in_a_row = 0
        state.good = sample.copy()
        return self._condition(sample[None], held=not all_good)

    def _gap(self) -> None:
        self._copy_state()
        self._state.tally.gaps += 1
        self._state.tally.dropped += len(self._state.windows)
        self._restart()

    def _restart(self) -> None:
        old = self._state
        self._set_state(StreamState(
            self.chain.windows.begin(),
            n_windows=old.n_windows,
            bad_in_a_row=old.bad_in_a_row,
            origin=old.origin + old.conditioned.n_samples,
            tally=old.tally,
        ))  # fmt: skip

    def _condition(self, samples: np.ndarray, *, held: bool) -> list[Decision]:
        decisions: list[Decision] = []
        for start in range(0, len(samples), self._most_samples):
            block = np.ascontiguousarray(samples[start : start + self._most_samples])
            if self._compiled is not None:
                decided = self._compiled.push(samples=block, held=held)
                assert decided is not None  # all are valid by now
                decisions += self._from_compiled(decided)
                continue
            signal, self._state.conditioned = self.conditioner.push(block, self._state.conditioned)
            decisions += self._encode(signal, held=held) if len(signal) else []
        return decisions

    def _encode(self, signal: np.ndarray, *, held: bool) -> list[Decision]:
        state, chain = self._state, self._used
        spikes, state.encoder = encode(signal[None], chain.signal_Hz, chain.encoder, state.encoder)
        return self._decide(spikes[0], held=held)

    def _decide(self, spikes: np.ndarray, *, held: bool) -> list[Decision]:
        """The decisions of the network on the next steps of spikes, `(step, afferent)`."""
        decisions: list[Decision] = []
        first, oldest = self._state.opening.step, []
        with torch.inference_mode():
            for row in spikes:
                decisions += self._step(np.flatnonzero(row), held, oldest)
        if self._watch is not None and len(spikes):
            hidden, window = (np.array(part) for part in zip(*oldest, strict=True))
            self._report(first, spikes != 0, hidden, window)
        return decisions

    def _report(self, first: int, afferents: np.ndarray, hidden: np.ndarray, window: np.ndarray) -> None:
        assert self._watch is not None
        rate_Hz, clock_Hz = self.chain.sampling_rate_Hz, self.chain.clock_Hz
        self._watch(Trace(self._state.origin / rate_Hz + first / clock_Hz, 1 / clock_Hz, afferents, hidden, window))

    def _step(self, inputs: np.ndarray, held: bool, oldest: list[tuple[np.ndarray, int]]) -> list[Decision]:
        """One step; with `watch`, the hidden spikes of the oldest window, and its number, are added to `oldest`."""
        state, chain, length = self._state, self.chain, self.chain.windows.length
        step = state.opening.step
        opens, state.opening = state.opening.after(len(inputs) > 0)
        windows = state.windows
        if opens:
            windows = (*windows, running.begin(chain.network, state.n_windows, step, chain.rule.band))
            state.n_windows += 1
        decisions, still_open = [], []
        for window in windows:
            after = running.step(chain.network, inputs, window, length, self._fans, chain.rule.band)
            after = after._replace(held=after.held + 1) if held else after
            if chain.detector is not None:
                after, changed = running.detect(chain.network, after, chain.detector)
                if changed:
                    decisions.append(self._event(after))
                    after = running.counted_anew(after)
            if running.has_decided(chain.network, after, chain.rule, length):
                leader = after.leader
                decisions.append(
                    self._decision(
                        after.window, after.start, after.steps, int(chain.rule.told(leader.index, leader.counts)[0]),
                        after.input_spikes, after.hidden_spikes, after.held, bool(leader.heard[0]), after.sops,
                        readout=leader.counts[0],
                    )
                )  # fmt: skip
            else:
                still_open.append(after)
            if self._watch is not None and window is windows[0]:
                is_due = running.is_due(chain.network, after, length)
                oldest.append((running.sent(chain.network, after) & is_due, after.window))
        if self._watch is not None and not windows:
            oldest.append((np.zeros(chain.network.spec.hidden, bool), -1))
        state.windows = tuple(still_open)
        state.tally.decisions += len(decisions)
        return decisions

    def _event(self, state: running.Running) -> Decision:
        """What a detector tells where another label comes into force: from the last one on."""
        steps, counted = state.steps - state.since, (state.input_spikes, state.hidden_spikes, state.held)
        number, start = self._state.tally.decisions, state.start + state.since
        return self._decision(number, start, steps, state.current, *counted, True, state.sops)

    def _from_compiled(self, decided: list[Decided]) -> list[Decision]:
        """The decisions of the last compiled step, whose spikes are passed to `watch`."""
        if self._watch is not None:
            assert self._compiled is not None
            first, afferents, hidden, window = self._compiled.watched()
            if len(window):
                self._report(first, afferents, hidden, window)
        if not decided:
            return []
        self._state.tally.decisions += len(decided)
        return [self._decision(*row[:7], bool(row[7]), *row[8:]) for row in decided]

    def _decision(
        self, window: int, start: int, steps: int, index: int, inputs: int, hidden: int, held: int, is_heard: bool,
        sops: int = 0, *, readout: torch.Tensor | None = None,
    ) -> Decision:  # fmt: skip
        """sops: of a pruned network; others have the same number a spike. readout: its values, of numbers."""
        rate_Hz, clock_Hz = self._rates_Hz
        time_s = self._state.origin / rate_Hz + (start + steps) / clock_Hz
        sops = self._sops[0] * inputs + self._sops[1] * hidden if self._fans is None else sops
        label, ms = self._classes[index], 1e3 * steps / clock_Hz
        decision = Decision(window, time_s, start, label, index, steps, ms, inputs, hidden, sops, held, is_heard)
        if readout is None or not self.chain.tells_numbers:
            return decision
        values = dict(zip(self.chain.classes, readout.tolist(), strict=True))
        text = ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
        return decision._replace(label=text, index=0, values=values)
