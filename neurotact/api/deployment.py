"""A trained chain in use: exported, fine-tuned for it, checked against a chip."""

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

import pandas as pd

from neurotact import effects, files
from neurotact.api.arguments import Tell, check_folder, silent
from neurotact.api.networks import result
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.deploy import c_export, export, fine_tuning, proving, sources, targets
from neurotact.deploy.chain import chain_of
from neurotact.deploy.export import Exported
from neurotact.deploy.nir_exchange import exchange, execute, note
from neurotact.deploy.stream import Decision as Decision
from neurotact.deploy.stream import Stream
from neurotact.errors import InputError
from neurotact.networks.definition import snntorch_exchange
from neurotact.networks.definition.rsnn import RSNN, rsnn_of
from neurotact.networks.training import train_run
from neurotact.networks.use import fitted
from neurotact.networks.use.fitted import Fitted

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
    flow, noted = Stream(chain, unit=unit, hold_ms=hold_ms), sources.Noted()
    block = max(1, round(0.01 * chain.sampling_rate_Hz))
    if kind == "recordings":
        samples = sources.recorded(Path(source), chain.n_taxels, block, taxels=chain.taxels)
    else:
        layout = sources.Layout.of(format, time_column, lsb, zero)
        parser = layout.parser(source, chain.n_taxels, chain.sampling_rate_Hz, noted, chain.taxels)
        samples = sources.live(source, parser, noted, stall_s or sources.STALL_S, baud=baud or sources.DEFAULT_BAUD)
    if rate == "real":
        samples = sources.at_its_rate(samples, chain.sampling_rate_Hz, noted, block)

    def summary() -> str:
        tally, trouble = flow.tally, sources.trouble_of(flow.tally, noted)
        took = f"in {time.perf_counter() - began:.1f} s; {trouble or 'every sample was used unchanged'}"
        return f"{tally.samples} samples, {tally.decisions} decisions, {took}"

    return Flow(sources.decide(flow, samples), summary)


def export_c(
    run: Fitted,
    folder: str | Path,
    *,
    variant: Literal["integer", "float"] = "integer",
    weight_bits: int | None = None,
    state_bits: int | None = None,
    lsb: float | None = None,
    recordings: Recordings | str | Path | None = None,
    spikes: str | Path | None = None,
    name: str = "touch",
    sampling_rate_Hz: float | None = None,
    early_exit: bool = True,
    length_ms: float | None = None,
    start_ms: float | None = None,
    hop_ms: float | None = None,
    contact: bool = False,
    quiet_ms: float | None = None,
    prove: int = 0,
    force: bool = False,
    tell: Tell = silent,
) -> Exported:
    """Write the chain in the run folder `run` as C99, from a raw sample to a decision, as `neurotact export` does.

    run: the folder, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    variant: "integer", whose formats are chosen from the run's training trials, or "float". recordings, spikes: that
    the run was trained on, where they moved since; of a classifier, recordings (or a file of them) like those that it
    was fitted on, which give the range of samples. weight_bits: 2 to 8; when None those of `fine_tune`, else 8.
    state_bits: 8 to 16, or 24; chosen when None. lsb: of a sample of 16 bits; when None, 1 for whole
    numbers that fit, else from the recorded range.
    name: prefix of every name in C.
    sampling_rate_Hz, early_exit, length_ms, start_ms, hop_ms, contact, quiet_ms: as for `Stream`.
    prove: compile the export, run it here and in QEMU, and compare this many test trials spike by spike.
    force: replace files. tell: called with what the command prints.
    Returns the chain and its formats. Raises InputError for files that exist, and for a chain that cannot run in C.

    >>> made = nt.export_c("run", "chain")
    >>> sorted(path.name for path in Path("chain").iterdir())
    ['README.md', 'example.c', 'touch.c', 'touch.h']
    """
    effects.check(
        variant=variant, weight_bits=weight_bits, state_bits=state_bits, lsb=lsb,
        ranges=variant == "integer" or prove, recordings=recordings, spikes=spikes,
    )  # fmt: skip
    if variant not in ("integer", "float"):
        raise InputError(f"variant: '{variant}' is unknown; choose integer or float")
    for path in c_export.paths(Path(folder), name):
        files.check_new(path, force=force)
    prepared = export.prepared(
        run, integer=variant == "integer", recordings=recordings, spikes=spikes, weight_bits=weight_bits,
        state_bits=state_bits, lsb=lsb, sampling_rate_Hz=sampling_rate_Hz, early_exit=early_exit, length_ms=length_ms,
        start_ms=start_ms, hop_ms=hop_ms, contact=contact, quiet_ms=quiet_ms,
    )  # fmt: skip
    c_export.write(prepared.chain, Path(folder), prepared.formats, name=name)
    tell(f"{folder}: {c_export.title_of(prepared.chain, prepared.formats)}")
    if prove:
        tell(proving.prove(run, prepared.chain, prepared.formats, prove, recordings, spikes, say=log.warning))
    return prepared


def export_nir(
    run: Fitted,
    path: str | Path,
    *,
    plain: bool = False,
    lower_refractory: bool = False,
    network_only: bool = False,
    dt_s: float | None = None,
    prove: int = 0,
    recordings: Recordings | str | Path | None = None,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = silent,
) -> Any:
    """Write the afferents and the network of a run as a NIR graph, as `neurotact export` does; returns it.

    run: as of `export_c`.
    plain, lower_refractory, network_only, dt_s: as of `to_nir`.
    prove: run the graph in the interpreter, snnTorch and Norse, and compare this many test trials spike by spike.
    recordings, spikes: for that, those that the run was trained on, where they moved since; of a classifier, others.
    force: replace a file. tell: called with what the command prints.
    Raises InputError for a file that exists, and for a chain that NIR cannot express.

    >>> graph = nt.export_nir("run", "run.nir")
    >>> "afferents" in graph.nodes
    True
    """
    effects.check(ranges=prove, recordings=recordings, spikes=spikes)
    made = exchange.to_nir(
        run, path, plain=plain, lower_refractory=lower_refractory, network_only=network_only, dt_s=dt_s, force=force
    )
    said = note.of(made, str(path))
    assert said is not None
    tell(f"{path}: {len(execute.flat(made)[0])} nodes, steps of {said.dt_s:g} s, {said.form}")
    for difference in said.differences:
        tell(f"  differs: {difference}")
    if prove:
        for line in exchange.summary(exchange.proved(run, made, prove, recordings, spikes, say=log.warning)):
            tell(line)
    return made


def to_snntorch(source: Fitted | RSNN, *, time_first: bool = False) -> snntorch_exchange.SnnTorchNetwork:
    """The same network in snnTorch's neurons, as a `torch.nn.Module` with its own copy of the weights.

    source: a network, a run folder that `train` wrote, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    The module takes spikes `(trial, time, afferent)` and returns the spikes of the hidden layer `(trial, time, hidden)`
    and of the readout `(trial, time, class)`, from a state of zero; of an integrator, its value after each step.
    time_first: take and return `(time, trial, ...)`, as most of snnTorch's examples do.
    Raises InputError unless the network is float32, its reset is `zero` or `subtract`, its decays lie in [0, 1], and
    its thresholds do not adapt.

    >>> import torch
    >>> net = RSNN(16, 8, hidden=20, sampling_rate_Hz=2000.0)
    >>> hidden, readout = to_snntorch(net, time_first=True)(torch.ones(10, 2, 16))
    >>> hidden.shape, readout.shape
    (torch.Size([10, 2, 20]), torch.Size([10, 2, 8]))
    """
    network = source if isinstance(source, RSNN) else fitted.restore(source).network
    return snntorch_exchange.to_snntorch(rsnn_of("snntorch", network), time_first=time_first)


def check_chip(run: Fitted, check: str, *, tell: Tell = silent) -> pd.DataFrame:
    """The limits of a chip ("xyloaudio2", "loihi2", "spinnaker2") for the network of a run.

    run: as of `export_c`.
    One row per limit: what, here, limit, fits, and the cost of making it fit. tell: called with what the command
    prints. Raises InputError for an unknown chip.

    >>> nt.check_chip("run", "loihi2").columns.tolist()
    ['what', 'here', 'limit', 'fits', 'cost']
    """
    restored = fitted.restore(run)
    findings = targets.check(rsnn_of("chip", restored.network), restored.encoder, restored.exits(), check)
    tell(targets.title(check))
    for row in findings.itertuples(index=False):
        parts = filter(None, (f"{'fits' if row.fits else 'NOT'}  {row.what}: {row.here}", row.limit, row.cost))
        tell("; ".join(parts))
    return findings


def fine_tune(
    run: str | Path,
    folder: str | Path,
    *,
    weight_bits: int = 8,
    state_bits: int | None = None,
    epochs: int = fine_tuning.EPOCHS,
    seed: int | None = None,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = silent,
) -> dict[str, Any]:
    """Train the network in the run folder `run` on with rounded weights, as `neurotact fine-tune` does.

    It is saved in `folder` as a run of its own, which `export_c` writes with these bits. weight_bits: 2 to 8.
    state_bits: 8 to 16, or 24; chosen when None. epochs: 0 rounds alone. seed: of the order of windows, 0 if
    None. Training and validation trials are used alone.
    spikes: that the run was trained on, where they moved since. force: replace a training that is in the folder.
    tell: called with what the command prints. Returns what it came to, as `train` does.
    Raises InputError for a folder that is not free, and for spikes that are no longer those of the run.

    >>> nt.fine_tune("run", "few-bits", weight_bits=4, epochs=1)["accuracy_test"] >= 0
    True
    """
    check_folder(run, "fine_tune", "which it trains on from the spikes of that")
    path = Path(folder)
    outcome, training = fine_tuning.run(
        run, path, weight_bits=weight_bits, state_bits=state_bits, epochs=epochs, seed=seed, spikes=spikes, force=force
    )
    rounded, best = (100 * epoch.validation_accuracy for epoch in (training.epochs[0], training.best))
    tuned = (
        f"validation accuracy with {weight_bits}-bit weights: {rounded:.1f} % rounded, {best:.1f} % fine-tuned "
        f"(epoch {training.best.epoch} of {epochs})"
    )
    for line in (*outcome.lines(), tuned, train_run.saved_in(path)):
        tell(line)
    return result(path)
