"""Where the command begins: Ctrl-C ends it in one line, also while its modules load."""

import os
import signal
import sys
from types import FrameType

INTERRUPTED = 130
LINE = "neurotact: interrupted\n"


def main() -> None:
    """Load the command line and run it; see `neurotact.cli.main` for the exit codes."""
    is_heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not so under nohup
    try:
        if is_heard:
            signal.signal(signal.SIGINT, _leave)
        from neurotact.cli import main as run  # takes seconds, most of them torch's

        if is_heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        run()
    except KeyboardInterrupt:
        print(LINE, end="", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _leave(number: int, frame: FrameType | None) -> None:
    """End at once. Nothing has begun, and an exception would be taken for a failed import by some module."""
    os.write(2, LINE.encode())
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
