"""A trained chain in use: streamed and exported."""

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from neurotact import effects
from neurotact.data import hdf5
from neurotact.deploy import sources
from neurotact.deploy.chain import chain_of
from neurotact.deploy.exporters import Exporter as Exporter
from neurotact.deploy.exporters import export as export
from neurotact.deploy.exporters import exporter
from neurotact.deploy.exporters import usable as usable
from neurotact.deploy.stream import Decision as Decision
from neurotact.deploy.stream import Stream
from neurotact.errors import InputError
from neurotact.networks.use.fitted import Fitted

EXPORTED = {"export_c": "c", "export_nir": "nir"}
"""Functions that are those of exporters, by their names in Python."""

log = logging.getLogger("neurotact")


def __getattr__(name: str) -> Any:
    if name in EXPORTED:
        return exporter(EXPORTED[name]).export
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class Flow(NamedTuple):
    """A stream of samples: its decisions, as they are taken, and what became of the samples so far, in words.

    >>> flow = nt.stream("run", "touch.h5")
    >>> n_decisions = len(list(flow.decisions))
    >>> flow.summary().startswith("6000 samples")
    True
    """

    decisions: Iterator[Decision]
    summary: Callable[[], str]


def stream(
    run: Fitted,
    source: str | Path = "-",
    *,
    format: str | None = None,
    baud: int | None = None,
    rate: str = "fast",
    sampling_rate_Hz: float | None = None,
    unit: str | None = None,
    time_column: str | None = None,
    lsb: float | None = None,
    zero: float | None = None,
    length_ms: float | None = None,
    start_ms: float | None = None,
    hop_ms: float | None = None,
    contact: bool = False,
    quiet_ms: float | None = None,
    early_exit: bool = True,
    hold_ms: float = 5.0,
    stall_s: float | None = None,
) -> Flow:
    """Decide samples as they arrive from a pipe, a device or a file, as `neurotact stream` does; see also `Stream`.

    run: a run folder that `train` wrote, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    source: "-" (standard input), a device file, "serial:/dev/ttyUSB0", FILE.csv, or FILE.h5, whose rate and unit count.
    format: of other sources than .h5: "csv" (if None), "float32" or "int16", with the signal `zero` (0) + `lsb` (1) x.
    baud: of a serial port; 115200 if None. time_column: the unit of time stamps in the first column of CSV.
    rate: "fast", or "real" for a file at its own rate.
    sampling_rate_Hz, unit, length_ms, start_ms, hop_ms, contact, quiet_ms, early_exit, hold_ms: as for `Stream`.
    stall_s: a pipe without input for so long counts as a gap; 1 if None.
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
    effects.check(
        source=kind, format=format, baud=baud, sampling_rate_Hz=sampling_rate_Hz, time_column=time_column, lsb=lsb,
        zero=zero, stall_s=stall_s,
    )  # fmt: skip
    if kind == "recordings":
        with hdf5.open_recordings(source) as stored:
            sampling_rate_Hz, unit = stored.sampling_rate_Hz, unit or stored.unit
    chain = chain_of(
        run, sampling_rate_Hz=sampling_rate_Hz, early_exit=early_exit, length_ms=length_ms, start_ms=start_ms,
        hop_ms=hop_ms, contact=contact, quiet_ms=quiet_ms,
    )  # fmt: skip
    if sampling_rate_Hz is None and chain.sampling_rate_Hz != chain.clock_Hz:
        log.warning(
            "samples are taken to come at %g Hz, as the recordings of the training; `sampling_rate_Hz` changes it",
            chain.sampling_rate_Hz,
        )
    flow, faults = Stream(chain, unit=unit, hold_ms=hold_ms), sources.Faults()
    block = max(1, round(0.01 * chain.sampling_rate_Hz))
    if kind == "recordings":
        samples = sources.recorded(Path(source), chain.n_taxels, block, taxels=chain.taxels)
    else:
        layout = sources.Layout.of(format, time_column, lsb, zero)
        parser = layout.parser(source, chain.n_taxels, chain.sampling_rate_Hz, faults, chain.taxels)
        samples = sources.live(source, parser, faults, stall_s or sources.STALL_S, baud=baud or sources.DEFAULT_BAUD)
    if rate == "real":
        samples = sources.at_its_rate(samples, chain.sampling_rate_Hz, faults, block)

    def summary() -> str:
        tally, trouble = flow.tally, sources.trouble_of(flow.tally, faults)
        took = f"in {time.perf_counter() - began:.1f} s; {trouble or 'every sample was used unchanged'}"
        return f"{tally.samples} samples, {tally.decisions} decisions, {took}"

    return Flow(sources.decide(flow, samples), summary)
