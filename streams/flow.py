"""Decisions of a run on samples from a pipe, a device or a file: `nt.stream`, and the command of that name."""

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from neurotact_parts.streams import sources
from neurotact_parts.streams.chain import chain_of
from neurotact_parts.streams.stream import Stream
from neurotact_parts.streams.stream_state import Decision
from neurotact_parts.streams.streamed import SampleSpec, StreamedSpec

from neurotact import effects
from neurotact.data import hdf5
from neurotact.errors import InputError
from neurotact.networks.use.fitted import Fitted
from neurotact.spec import takes_specs

log = logging.getLogger("neurotact")


class Flow(NamedTuple):
    """A stream of samples: its decisions, as they are taken, and what became of the samples so far, in words.

    >>> flow = nt.stream("run", "touch.h5")
    >>> n_decisions = len(list(flow.decisions))
    >>> flow.summary().startswith("6000 samples")
    True
    """

    decisions: Iterator[Decision]
    summary: Callable[[], str]


@takes_specs
def stream(
    run: Fitted,
    source: str | Path = "-",
    *,
    rate: str = "fast",
    samples: SampleSpec = SampleSpec(),
    streamed: StreamedSpec = StreamedSpec(),
) -> Flow:
    """Decide samples as they arrive from a pipe, a device or a file, as `neurotact stream` does; see also `Stream`.

    run: a run folder that `train` wrote, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    source: "-" (standard input), a device file, "serial:/dev/ttyUSB0", "udp:PORT", "lsl:NAME" (a stream of the Lab
        Streaming Layer), FILE.csv, or FILE.h5, whose rate and unit count.
    rate: "fast", or "real" for a file at its own rate.
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
    effects.check(source=kind, **samples.given(), **streamed.given())
    unit = samples.unit
    if kind == "recordings":
        with hdf5.open_recordings(source) as stored:
            streamed, unit = (
                streamed.model_copy(update={"sampling_rate_Hz": stored.sampling_rate_Hz}),
                unit or stored.unit,
            )
    chain = chain_of(run, streamed)
    if streamed.sampling_rate_Hz is None and chain.sampling_rate_Hz != chain.clock_Hz:
        log.warning(
            "samples are taken to come at %g Hz, as the recordings of the training; `sampling_rate_Hz` changes it",
            chain.sampling_rate_Hz,
        )
    flow, faults = Stream(chain, unit=unit, hold_ms=samples.hold_ms), sources.Faults()
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
        return f"{tally.samples} samples, {tally.decisions} decisions, {took}"

    return Flow(sources.decide(flow, arrived), summary)
