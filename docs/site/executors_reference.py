"""The table of executors as Markdown."""

from neurotact.networks.definition import executors


def page() -> str:
    """One row per feature, one column per program."""
    names = [executor.what.removeprefix("the ").removeprefix("a ") for executor in executors.EXECUTORS.values()]
    rows = executors.table()
    reasons = sorted({cell for row in rows for cell in row if cell.startswith("no: ")})
    notes = {reason: number for number, reason in enumerate(reasons, start=1)}
    heading = ["feature", "part", *names]
    lines = [_line(heading), _line(["---"] * len(heading))]
    lines += [_line([f"no ({notes[cell]})" if cell in notes else cell for cell in row]) for row in rows]
    reasons_below = [f"{number}. {reason.removeprefix('no: ')}" for reason, number in notes.items()]
    return "\n".join([*lines, "", "Reasons:", "", *reasons_below, ""])


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
