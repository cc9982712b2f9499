"""The command that classifies samples as they come: stream."""

import json
import sys
from typing import Annotated, Any

import typer

from neurotact.api import deployment as api
from neurotact.cli.options import HopMs, Json, calling, option
from neurotact.cli.words import say
from neurotact.errors import INTERRUPTED
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
