"""The command that shows a running chain on a local page: live."""

import sys
from pathlib import Path
from typing import Any

from neurotact.api import tools
from neurotact.cli.options import calling, flag, option
from neurotact.cli.words import say

MOST_PORTS = 65_535


@calling(
    tools.live,
    source=option(
        str, "FILE.h5, -, a device file, serial:/dev/ttyUSB0, udp:PORT, lsl:NAME, FILE.csv, or gratings.", "--from"
    ),
    speed=option(
        float | None, "Speed of a replay or of the simulated finger; 1 is real time.",
        show_default="1",
    ),
    loop=flag("--loop", "Repeat recordings from the start."),
    shuffle=flag("--shuffle", "Replay the trials of recordings in a random order."),
    save_to=option(Path | None, "Folder for encoders saved from the page.", "--save-to", file_okay=False),
    port=option(int, "Port of the page; 0 chooses a free one.", min=0, max=MOST_PORTS),
)  # fmt: skip
def live(given: dict[str, Any]) -> None:
    """Show a running chain on a local page with sliders: touch, spikes, decision.

    Prints the address to open in a browser on this machine, and serves the page until Ctrl-C. Recordings are replayed
    at their own rate; a device is read as its samples arrive; gratings is a simulated finger that the page moves (--set
    changes its spec). The page's sliders change refractory periods, gains and patience of the running stream.
    """
    say(tools.live(**given, show=_print_at_once))
    sys.exit(0)


def _print_at_once(line: object) -> None:
    print(line, flush=True)
