"""Decisions of a run on samples from a pipe, a device or a file: `nt.stream`, and the command of that name."""

import logging
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from neurotact_parts.streams.streamed import SampleSpec, StreamedSpec

from neurotact import effects
from neurotact.data import hdf5
from neurotact.data.readers.clock.units import Unit
from neurotact.errors import InputError, number_of
from neurotact.lazily import lazily
from neurotact.progress import say
from neurotact.spec import takes_specs

with lazily():
    from neurotact_parts.streams import chain as chains
    from neurotact_parts.streams import events, sources, stream_state
    from neurotact_parts.streams import stream as streaming

    from neurotact.networks.use import fitted


log = logging.getLogger("neurotact")

SAID = {
    "late": "an event is of a step of the network's clock that is over; such events are not used",
    "doubled": "events share a step of the network's clock and a channel with another, and are one spike with it",
    "unknown": "an event is of a channel that the network does not have; such events are not used",
}
"""Counts of events that are said when they begin."""


class Flow(NamedTuple):
    """A stream of samples: its decisions, as they are taken, and what became of the samples so far, in words.

    >>> flow = nt.stream("run", "touch.h5")
    >>> n_decisions = len(list(flow.decisions))
    >>> flow.summary().startswith("6000 samples")
    True
    """

    decisions: "Iterator[stream_state.Decision]"
    summary: Callable[[], str]


@takes_specs
def stream(
    run: "fitted.Fitted",
    source: str | Path = "-",
    *,
    rate: str = "fast",
    time_unit: Unit | None = None,
    origin: "events.Origin" = "zero",
    polarity: "events.Polarity | None" = None,
    samples: SampleSpec = SampleSpec(),
    streamed: StreamedSpec = StreamedSpec(),
) -> Flow:
    """Decide samples as they arrive from a pipe, a device or a file, as `neurotact stream` does; see also `Stream`.

    A network that was trained on the events of a sensor takes rows of time, channel and, where there is one, polarity.

    run: a run folder that `train` wrote, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    source: "-" (standard input), a device file, "serial:/dev/ttyUSB0", "tcp:HOST:PORT", "udp:PORT", "lsl:NAME" (a
        stream of the Lab Streaming Layer), FILE.csv, or FILE.h5, whose rate and unit count.
    rate: "fast", or "real" for a file at its own rate.
    time_unit, origin, polarity: of events alone. The unit of their times; None: that of the column's name (time_us),
        else s. Whether the stream begins at time "zero" or with the "first" event. What import made of polarities where
        afferents have none: "merge", "on" or "off".
    samples: how samples are read, such as `nt.Samples(format="int16", lsb=0.1)`.
    streamed: the rate, the windows and their decisions, such as `nt.Streamed(hop_ms=20)`; the rest is as in training.
    Raises InputError for a source that cannot be read, and for a chain that cannot run sample by sample.

    >>> flow = nt.stream("run", "touch.h5")
    >>> decision = next(flow.decisions)
    >>> decision.label in ("felt", "silk")
    True
    """
    if rate not in ("fast", "real"):
        raise InputError(f"`rate={rate!r}`: is unknown; choose one of fast, real")
    began, source = time.perf_counter(), str(source)
    kind = sources.kind_of(source)
    restored = fitted.restore(run)
    takes_events = restored.encoder == {}
    effects.check(
        source=kind, takes_events=takes_events, time_unit=time_unit, origin=None if origin == "zero" else origin,
        polarity=polarity, **samples.given(), **streamed.given(),
    )  # fmt: skip
    if takes_events:
        _check_source(source, kind, rate)
        chain, faults = chains.chain_of(restored, streamed), sources.Faults()
        channels, joins = events.Channels(events.afferents_of(chain), polarity), source.startswith(sources.SERIAL)
        rows = sources.EventRows(source, channels, faults, time_unit, origin, joins=joins)
        return _of_events(chain, sources.live(source, rows, faults, math.inf, baud=samples.baud), source, faults)
    unit = samples.unit
    if kind == "recordings":
        with hdf5.open_recordings(source) as stored:
            streamed, unit = (
                streamed.model_copy(update={"sampling_rate_Hz": stored.sampling_rate_Hz}),
                unit or stored.unit,
            )
    chain = chains.chain_of(restored, streamed)
    if streamed.sampling_rate_Hz is None and chain.sampling_rate_Hz != chain.clock_Hz:
        log.warning(
            "samples are taken to come at %g Hz, as the recordings of the training; `sampling_rate_Hz` changes it",
            chain.sampling_rate_Hz,
        )
    flow, faults = streaming.Stream(chain, unit=unit, hold_ms=samples.hold_ms), sources.Faults()
    block = max(1, round(0.01 * chain.sampling_rate_Hz))
    if kind == "recordings":
        arrived = sources.recorded(Path(source), chain.n_taxels, block, taxels=chain.taxels)
    else:
        parser = sources.parser_of(samples, source, chain.n_taxels, chain.sampling_rate_Hz, faults, chain.taxels)
        arrived = sources.live(source, parser, faults, samples.stall_s, baud=samples.baud)
    if rate == "real":
        arrived = sources.at_its_rate(arrived, chain.sampling_rate_Hz, faults, block)

    def summary() -> str:
        tally, trouble = flow.tally, sources.trouble_of(flow.tally, faults)
        took = f"in {time.perf_counter() - began:.1f} s; {trouble or 'every sample was used unchanged'}"
        return f"{number_of(tally.samples, 'sample')}, {number_of(tally.decisions, 'decision')}, {took}"

    return Flow(sources.decide(flow, arrived), summary)


def _check_source(source: str, kind: str, rate: str) -> None:
    """InputError for a source that holds samples, and for the rate of samples."""
    if kind in ("recordings", "LSL stream"):
        raise InputError(f"{source}: holds samples, but the network takes events; give these as rows of text")
    if rate == "real":
        raise InputError(
            "`rate='real'`: is for samples, but the network takes events, at their own times; leave it out"
        )


def _of_events(
    chain: "chains.Chain", arrived: "Iterator[sources.Arrived]", source: str, faults: "sources.Faults"
) -> Flow:
    """As `stream`, of a network that takes the events of a sensor."""
    began, flow = time.perf_counter(), streaming.Stream(chain)

    def decisions() -> "Iterator[stream_state.Decision]":
        unsaid = dict(SAID)
        for one in arrived:
            yield from sources.decide(flow, [one])
            for fault in [name for name in unsaid if getattr(flow.tally, name)]:
                say(f"{source}: {unsaid.pop(fault)} (said once; the counts come at the end)")

    def summary() -> str:
        tally, trouble = flow.tally, sources.trouble_of(flow.tally, faults)
        took = f"in {time.perf_counter() - began:.1f} s; {trouble or 'every event was used'}"
        return f"{number_of(tally.events, 'event')}, {number_of(tally.decisions, 'decision')}, {took}"

    return Flow(decisions(), summary)
