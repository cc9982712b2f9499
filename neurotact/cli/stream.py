"""The command that classifies samples as they come: stream."""

import json
import sys
from typing import Any, Literal

from neurotact.api import tools
from neurotact.cli.options import Json, calling, option
from neurotact.cli.words import say
from neurotact.errors import INTERRUPTED
from neurotact.progress import printable


@calling(
    tools.stream,
    source=option(
        str,
        "- (standard input), a device, serial:/dev/ttyUSB0, tcp:HOST:PORT, udp:PORT, lsl:NAME, FILE.csv or FILE.h5.",
        "--from",
    ),
    rate=option(str, "Replay a file at its own rate (real) or at full speed (fast)."),
    time_unit=option(
        Literal["s", "ms", "us", "ns"] | None,
        "Of events: unit of their times.",
        show_default="of the column's name, else s",
    ),
    origin=option(Literal["zero", "first"], "Of events: begin at time zero or with the first event."),
    polarity=option(
        Literal["merge", "on", "off"] | None, "Of events, if afferents have no polarity: what import made of theirs."
    ),
)
def stream(given: dict[str, Any], as_json: Json = False) -> None:
    """Classify samples as they arrive, from a pipe, a device or a file.

    Prints one line per decision, and at the end the faults in the samples.
    A value that is missing, NaN or infinite is replaced by the last one for --hold-ms and counted; a longer gap drops
    the current windows and starts again. Rows that are not samples count as missing. A clock of time stamps that starts
    again, wraps or errs is followed, which is said once.
    A network that was trained on the events of a sensor takes rows of time, channel and, where there is one, polarity.
    """
    flow, code = tools.stream(**given), 0
    try:
        for decision in flow.decisions:
            print(_line(decision, as_json=as_json), flush=True)
    except KeyboardInterrupt:
        code = INTERRUPTED
    say(flow.summary())
    sys.exit(code)


def _line(decision: Any, *, as_json: bool) -> str:
    if as_json:
        return json.dumps(decision._asdict())
    held = f", {decision.held} steps on repeated values" if decision.held else ""
    label = printable(decision.label)
    if not (decision.heard or decision.values):
        label = f"nothing (no readout spike; {label} by its index)"
    return (
        f"{decision.time_s:.4f} s: {label} after {decision.steps} steps ({decision.ms:g} ms), "
        f"{decision.input_spikes} + {decision.hidden_spikes} spikes, {decision.sops} SOPs{held}"
    )
