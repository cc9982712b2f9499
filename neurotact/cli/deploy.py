"""The commands that use a trained chain: fine-tune, stream, export."""

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from neurotact import effects
from neurotact.api import deployment as api
from neurotact.cli.options import (
    MOST_SEEDS,
    REPLACED,
    Force,
    HopMs,
    Json,
    MovedSpikes,
    RunFolder,
    arguments,
    calling,
    option,
)
from neurotact.cli.output import print_json, show, unless
from neurotact.cli.words import say
from neurotact.errors import INTERRUPTED, InputError
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
        show_default="50",
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
    typer.Option("--sampling-rate-Hz", min=1e-3, help="Sampling rate of the input; when absent, of the recordings."),
]
Format = Annotated[
    str | None,
    typer.Option("--format", show_default="csv", help="Format of input other than .h5: csv, float32 or int16."),
]
Baud = Annotated[
    int | None,
    typer.Option(min=1, max=100_000_000, show_default="115200", help="Baud rate of a serial port."),
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
        show_default="1",
        help="A pipe without input for this long counts as a gap.",
    ),
]


OF_SAMPLES = {
    "format": Format, "baud": Baud, "sampling_rate_Hz": RateHz, "unit": Unit, "time_column": TimeColumn, "lsb": Lsb,
    "zero": Zero, "length_ms": WindowMs, "start_ms": StartMs, "hop_ms": HopMs, "contact": Contact, "quiet_ms": QuietMs,
    "hold_ms": HoldMs, "stall_s": StallS,
}  # fmt: skip
"""The options of commands that take samples as they come: how they are read, and how windows are laid over them."""


@calling(
    api.stream,
    source=option(str, "- (standard input), a device file, serial:/dev/ttyUSB0, FILE.csv or FILE.h5.", "--from"),
    rate=option(str, "Replay a file at its own rate (real) or at full speed (fast)."),
    **OF_SAMPLES,
)
def stream(given: dict[str, Any], full_window: FullWindow = False, as_json: Json = False) -> None:
    """Classify samples as they arrive, from a pipe, a device or a file.

    Prints one line per decision, and at the end the faults in the samples.
    A value that is missing, NaN or infinite is replaced by the last one for --hold-ms and counted; a longer gap drops
    the current windows and starts again. Rows that are not samples count as missing. A clock of time stamps that starts
    again, wraps or errs is followed, which is said once.
    """
    flow, code = api.stream(**given, early_exit=not full_window), 0
    try:
        for decision in flow.decisions:
            print(_line(decision, as_json=as_json), flush=True)
    except KeyboardInterrupt:
        code = INTERRUPTED
    say(flow.summary())
    sys.exit(code)


def _line(decision: api.Decision, *, as_json: bool) -> str:
    if as_json:
        return json.dumps(decision._asdict())
    held = f", {decision.held} steps on repeated values" if decision.held else ""
    label = printable(decision.label)
    label = label if decision.heard else f"nothing (no readout spike; {label} by its index)"
    return (
        f"{decision.time_s:.4f} s: {label} after {decision.steps} steps ({decision.ms:g} ms), "
        f"{decision.input_spikes} + {decision.hidden_spikes} spikes, {decision.sops} SOPs{held}"
    )


@calling(
    api.fine_tune,
    weight_bits=option(int, "Bits of a weight in the integer variant of C: 2 to 8."),
    state_bits=StateBits,
    epochs=option(int, "Epochs of training; 0 only rounds.", min=0),
    seed=option(int | None, "Random seed of the order of windows.", min=0, max=MOST_SEEDS, show_default="0"),
    spikes=MovedSpikes,
    force=REPLACED,
)
def fine_tune(given: dict[str, Any], as_json: Json = False) -> None:
    """Continue the training of a network with rounded weights, for an export with few bits.

    The rounded network is saved as a new run; neurotact export --to c writes it with these bits. The best epoch on
    validation windows is saved, or the network that is only rounded, if that is better.
    """
    row = api.fine_tune(**given, tell=unless(as_json))
    if as_json:
        print_json(pd.DataFrame([row]))
    else:
        print(f"next: neurotact export {shlex.quote(str(given['folder']))} --to c -o chain/")
    for caution in row["cautions"]:
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
        float | None,
        typer.Option(
            help="Signal per digit of a 16-bit sample. When absent: 1 for whole numbers, else from the recorded range."
        ),
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
    options = locals()
    given = {key: value for key, value in options.items() if key not in ("run", "check", "out", "to", "prove", "force")}
    if check is not None:
        effects.check(check=check, out=out, to=to, prove=prove, force=force, **given)
        api.check_chip(run, check, tell=show)
        return
    if to is None or out is None:
        raise InputError("export: needs --to c (or nir) and -o, or --check TARGET")
    if to not in ("c", "nir"):
        raise InputError(f"--to {to}: is unknown; choose c or nir")
    effects.check(to=to, ranges=(to == "c" and variant in (None, "integer")) or prove, **given)
    function, target = (api.export_c, "folder") if to == "c" else (api.export_nir, "path")
    function(**arguments(function, {**options, target: out, "early_exit": not full_window}), tell=show)
