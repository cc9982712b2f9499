"""Where the command begins: Ctrl-C ends it in one line, also while its modules load."""

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    # `python -m` looks for modules in the current folder first: a signal.py there would replace Python's own.
    sys.path.append(sys.path.pop(0))


def main() -> None:
    """Load the command line and run it; see `neurotact.cli.main` for the exit codes."""
    from neurotact.backend import hold_torch_to_avx2
    from neurotact.errors import INTERRUPTED
    from neurotact.interrupt import LINE, ending_at_once

    try:
        with ending_at_once():
            hold_torch_to_avx2()
            from neurotact.cli import main as run
        run()
    except KeyboardInterrupt:
        print(LINE, end="", file=sys.stderr)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
