"""The commands that use a trained chain: fine-tune, stream, export."""

import json
import shlex
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from neurotact import api, effects
from neurotact.cli.options import MOST_SEEDS, Force, HopMs, Json, MovedSpikes, OutFolder, RunFolder
from neurotact.cli.outcome import print_json, print_outcome
from neurotact.cli.output import print_table
from neurotact.cli.words import as_typed, say
from neurotact.data import hdf5
from neurotact.deploy import c_export, fine_tuning, proving, sources, targets
from neurotact.deploy.chain import chain_of
from neurotact.deploy.nir_exchange import exchange, execute, note
from neurotact.deploy.sources import Noted
from neurotact.deploy.stream import Decision, Stream
from neurotact.deploy.windows import QUIET_MS
from neurotact.errors import INTERRUPTED, InputError
from neurotact.networks.training import train_run, trained
from neurotact.progress import printable

WindowMs = Annotated[float | None, typer.Option("--window-ms", help="Length of a window; as in training when absent.")]
StartMs = Annotated[
    float | None, typer.Option("--start-ms", help="Start of the first window; as in training when absent.")
]
Contact = Annotated[
    bool, typer.Option("--contact", help="Start a window at the first spike after --quiet-ms without spikes.")
]
QuietMs = Annotated[
    float | None,
    typer.Option(
        "--quiet-ms",
        min=0,
        show_default=f"{QUIET_MS:g}",
        help="With --contact: time without spikes before a window can start.",
    ),
]
FullWindow = Annotated[
    bool, typer.Option("--full-window", help="Decide at the end of each window, without early exit.")
]
StateBits = Annotated[
    int | None,
    typer.Option("--state-bits", help="Bits of a state in the integer variant: 8 to 16, or 24; chosen when absent."),
]
RateHz = Annotated[
    float | None,
    typer.Option("--sampling-rate-Hz", min=1e-3, help="Sampling rate of the input, needed if the encoder resamples."),
]
Format = Annotated[
    str | None,
    typer.Option("--format", show_default="csv", help="Format of input other than .h5: csv, float32 or int16."),
]
Baud = Annotated[
    int | None,
    typer.Option(min=1, max=100_000_000, show_default=str(sources.DEFAULT_BAUD), help="Baud rate of a serial port."),
]
Unit = Annotated[str | None, typer.Option(help="Unit of the input; the encoder's when absent.")]
TimeColumn = Annotated[
    str | None,
    typer.Option(
        "--time-column",
        help="Unit of a time stamp in the first column, s, ms, us or ns; missing rows are then detected.",
    ),
]
Lsb = Annotated[
    float | None,
    typer.Option(min=1e-30, show_default="1", help="With --format int16: signal per digit; signal = zero + lsb * x."),
]
Zero = Annotated[float | None, typer.Option(show_default="0", help="With --format int16: the signal at digit 0.")]
HoldMs = Annotated[
    float,
    typer.Option(
        "--hold-ms", min=0, help="A missing value repeats the last one for this long at most; longer is a gap."
    ),
]
StallS = Annotated[
    float | None,
    typer.Option(
        "--stall-s",
        min=1e-3,
        show_default=f"{sources.STALL_S:g}",
        help="A pipe without input for this long counts as a gap.",
    ),
]


def stream(
    run: RunFolder,
    source: Annotated[
        str, typer.Option("--from", help="- (standard input), a device file, serial:/dev/ttyUSB0, FILE.csv or FILE.h5.")
    ] = "-",
    format_: Format = None,
    baud: Baud = None,
    rate: Annotated[str, typer.Option(help="Replay a file at its own rate (real) or at full speed (fast).")] = "fast",
    sampling_rate_Hz: RateHz = None,
    unit: Unit = None,
    time_column: TimeColumn = None,
    lsb: Lsb = None,
    zero: Zero = None,
    length_ms: WindowMs = None,
    start_ms: StartMs = None,
    hop_ms: HopMs = None,
    contact: Contact = False,
    quiet_ms: QuietMs = None,
    full_window: FullWindow = False,
    hold_ms: HoldMs = 5.0,
    stall_s: StallS = None,
    as_json: Json = False,
) -> None:
    """Classify samples as they arrive, from a pipe, a device or a file.

    Prints one line per decision, and at the end the faults in the samples.
    A value that is missing, NaN or infinite is replaced by the last one for --hold-ms and counted; a longer gap drops
    the current windows and starts again. Rows that are not samples count as missing. A clock of time stamps that starts
    again, wraps or errs is followed, which is said once.
    """
    if rate not in ("fast", "real"):
        raise InputError(f"--rate {rate}: is unknown; choose one of fast, real")
    kind = sources.kind_of(source)
    effects.check(
        source=kind, format=format_, baud=baud, sampling_rate_Hz=sampling_rate_Hz, time_column=time_column, lsb=lsb,
        zero=zero, stall_s=stall_s,
    )  # fmt: skip
    is_recorded = kind == "recordings"
    if is_recorded:
        with hdf5.open_recordings(source) as stored:
            sampling_rate_Hz, unit = stored.sampling_rate_Hz, unit or stored.unit
    chain = chain_of(
        run, sampling_rate_Hz=sampling_rate_Hz, early_exit=not full_window, length_ms=length_ms, start_ms=start_ms,
        hop_ms=hop_ms, contact=contact, quiet_ms=quiet_ms,
    )  # fmt: skip
    flow, noted = Stream(chain, unit=unit, hold_ms=hold_ms), Noted()
    block = max(1, round(0.01 * chain.sampling_rate_Hz))
    if is_recorded:
        samples = sources.recorded(Path(source), chain.n_taxels, block)
    else:
        layout = sources.Layout.of(format_, time_column, lsb, zero)
        parser = layout.parser(source, chain.n_taxels, chain.sampling_rate_Hz, noted)
        samples = sources.live(source, parser, noted, stall_s or sources.STALL_S, baud=baud or sources.DEFAULT_BAUD)
    if rate == "real":
        samples = sources.at_its_rate(samples, chain.sampling_rate_Hz, noted, block)
    _run(flow, sources.decide(flow, samples), noted, as_json=as_json)


def _run(flow: Stream, decisions, noted: Noted, *, as_json: bool) -> None:
    began, code = time.perf_counter(), 0
    try:
        for decision in decisions:
            print(_line(decision, as_json=as_json), flush=True)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except BrokenPipeError:  # the reader of the decisions has closed the pipe
        sys.stderr.close()
        sys.exit(0)
    tally, took_s = flow.tally, time.perf_counter() - began
    trouble = sources.trouble_of(tally, noted)
    say(
        f"{tally.samples} samples, {tally.decisions} decisions, in {took_s:.1f} s; "
        f"{trouble or 'every sample was used unchanged'}"
    )
    sys.exit(code)


def _line(decision: Decision, *, as_json: bool) -> str:
    if as_json:
        return json.dumps(decision._asdict())
    held = f", {decision.held} steps on repeated values" if decision.held else ""
    label = printable(decision.label)
    label = label if decision.heard else f"nothing (no readout spike; {label} by its index)"
    return (
        f"{decision.time_s:.4f} s: {label} after {decision.steps} steps ({decision.ms:g} ms), "
        f"{decision.input_spikes} + {decision.hidden_spikes} spikes, {decision.sops} SOPs{held}"
    )


def fine_tune(
    run: RunFolder,
    out: OutFolder,
    weight_bits: Annotated[
        int, typer.Option("--weight-bits", help="Bits of a weight in the integer variant of C: 2 to 8.")
    ] = 8,
    state_bits: StateBits = None,
    epochs: Annotated[int, typer.Option(min=0, help="Epochs of training; 0 only rounds.")] = fine_tuning.EPOCHS,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=MOST_SEEDS, show_default="0", help="Random seed of the order of windows."),
    ] = None,
    spikes: MovedSpikes = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a training that is in the folder.")] = False,
    as_json: Json = False,
) -> None:
    """Continue the training of a network with rounded weights, for an export with few bits.

    The rounded network is saved as a new run; neurotact export --to c writes it with these bits. The best epoch on
    validation windows is saved, or the network that is only rounded, if that is better.
    """
    outcome, training = fine_tuning.run(
        run, out, weight_bits=weight_bits, state_bits=state_bits, epochs=epochs, seed=seed, spikes=spikes, force=force
    )
    if as_json:
        print_json(outcome)
    else:
        print_outcome(outcome)
        rounded, best = (100 * epoch.validation_accuracy for epoch in (training.epochs[0], training.best))
        print(
            f"validation accuracy with {weight_bits}-bit weights: {rounded:.1f} % rounded, {best:.1f} % fine-tuned "
            f"(epoch {training.best.epoch} of {epochs})"
        )
        print(f"saved in {out}: the network, {train_run.RESULT} with all numbers, {trained.LOG}")
        print(f"next: neurotact export {shlex.quote(str(out))} --to c -o chain/")
    for caution in outcome.cautions:
        say(caution)


def export_command(
    run: RunFolder,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The folder to write; with --to nir, the file.")
    ] = None,
    to: Annotated[str | None, typer.Option("--to", help="Target: c or nir.")] = None,
    variant: Annotated[
        str | None, typer.Option(show_default="integer", help="With --to c: integer or float arithmetic.")
    ] = None,
    weight_bits: Annotated[
        int | None,
        typer.Option(
            "--weight-bits",
            help="Bits of a weight in the integer variant: 2 to 8; when absent, as in fine-tune, else 8.",
        ),
    ] = None,
    state_bits: StateBits = None,
    lsb: Annotated[
        float | None, typer.Option(help="Signal per digit of a 16-bit sample; from the recorded range when absent.")
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option(help="The recordings that the run was trained on, if they were moved.")
    ] = None,
    spikes: MovedSpikes = None,
    name: Annotated[str | None, typer.Option(show_default="touch", help="Prefix of all names in C.")] = None,
    sampling_rate_Hz: RateHz = None,
    length_ms: WindowMs = None,
    start_ms: StartMs = None,
    hop_ms: HopMs = None,
    contact: Contact = False,
    quiet_ms: QuietMs = None,
    full_window: FullWindow = False,
    prove: Annotated[
        int | None,
        typer.Option(
            min=0,
            show_default="0",
            help="Compile the export, run it here and in QEMU, and compare this many test trials spike by spike.",
        ),
    ] = None,
    plain: Annotated[
        bool,
        typer.Option("--plain", help="With --to nir: only CubaLIF and Linear nodes, which snnTorch and Norse load."),
    ] = False,
    lower_refractory: Annotated[
        bool, typer.Option("--lower-refractory", help="With --to nir: express refractory periods as nodes.")
    ] = False,
    network_only: Annotated[
        bool, typer.Option("--network-only", help="With --to nir: leave out the afferents.")
    ] = False,
    dt_s: Annotated[
        float | None,
        typer.Option("--dt-s", help="With --to nir: seconds per step; 1 / clock when absent, 1e-4 for snnTorch."),
    ] = None,
    check: Annotated[
        str | None, typer.Option(help="List what this chip cannot run: xyloaudio2, loihi2 or spinnaker2.")
    ] = None,
    force: Force = False,
) -> None:
    """Write a trained chain as C or NIR, or check it against a chip's limits.

    The chain in C computes a decision from raw samples: conditioning, afferents, network and early exit. A NIR file
    holds afferents and network as a graph, the rest as metadata.
    """
    of_c = {
        "variant": variant, "weight_bits": weight_bits, "state_bits": state_bits, "lsb": lsb, "name": name,
        "sampling_rate_Hz": sampling_rate_Hz, "length_ms": length_ms, "start_ms": start_ms, "hop_ms": hop_ms,
        "contact": contact, "quiet_ms": quiet_ms,
    }  # fmt: skip
    of_nir: dict[str, Any] = {
        "plain": plain, "lower_refractory": lower_refractory, "network_only": network_only, "dt_s": dt_s,
    }  # fmt: skip
    moved = {"recordings": recordings, "spikes": spikes}
    given = {**of_c, **of_nir, **moved, "full_window": full_window}
    if check is not None:
        effects.check(check=check, out=out, to=to, prove=prove, force=force, **given)
        restored = trained.restore(run)
        found = targets.check(restored.network, restored.encoder, restored.rule, check)
        print(targets.title(check))
        for row in found.itertuples(index=False):
            parts = filter(None, (f"{'fits' if row.fits else 'NOT'}  {row.what}: {row.here}", row.limit, row.cost))
            print(as_typed("; ".join(parts)))
        return
    if to is None or out is None:
        raise InputError("export: needs --to c (or nir) and -o, or --check TARGET")
    if to not in ("c", "nir"):
        raise InputError(f"--to {to}: is unknown; choose c or nir")
    is_integer = to == "c" and variant in (None, "integer")
    effects.check(to=to, ranges=is_integer or prove, **given)
    if to == "nir":
        _export_nir(run, out, prove or 0, recordings, spikes, force=force, **of_nir)
        return
    chosen = {key: value for key, value in of_c.items() if value is not None}
    chain, formats = api.export_c(
        run, out, force=force, early_exit=not full_window, **(moved if is_integer else {}), **chosen
    )
    print(f"{out}: {c_export.title_of(chain, formats)}")
    if prove:
        print_table(proving.prove(run, chain, formats, prove, recordings, spikes, say=say))


def _export_nir(run: Path, out: Path, prove: int, recordings: Path | None, spikes: Path | None, **options: Any) -> None:
    made = exchange.to_nir(run, out, **options)
    said = note.of(made, str(out))
    assert said is not None
    print(f"{out}: {len(execute.flat(made)[0])} nodes, steps of {said.dt_s:g} s, {said.form}")
    for difference in said.differences:
        print(as_typed(f"  differs: {difference}"))
    if prove:
        print("\n".join(exchange.summary(exchange.proved(run, made, prove, recordings, spikes, say=say))))
