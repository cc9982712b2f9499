"""The tables of executors as Markdown, narrow enough for a phone."""

from itertools import groupby

from neurotact.networks.definition import executors

SHORT = {"equal": "✓", "differs": "≈", "outside": "out", "outside, with the encoder": "out", "no": "no"}
HEADS = {"native": "native", "c-float": "C float", "c-integer": "C integer"}


def page() -> str:
    """For each part of a chain one row per feature, one column per program that has the part, but the reference."""
    names = [HEADS.get(key, executor.what.removeprefix("a ")) for key, executor in executors.EXECUTORS.items()]
    rows = sorted(executors.table(), key=lambda row: executors.CHAIN.index(row[1]))
    reasons = sorted({cell.partition(": ")[2] for row in rows for cell in row[2:]} - {""})
    notes = {reason: number for number, reason in enumerate(reasons, start=1)}
    lines = []
    for part, group in groupby(rows, key=lambda row: row[1]):
        features, _, _, *columns = zip(*group, strict=True)
        told = [(name, cells) for name, cells in zip(names[1:], columns, strict=True) if {*cells} != {"outside"}]
        heading = ["feature", *(name for name, _ in told)]
        lines += [f"## {part.capitalize()}", "", _line(heading), _line(["---"] * len(heading))]
        for feature, *cells in zip(features, *(cells for _, cells in told), strict=True):
            lines.append(_line([feature, *(_short(cell, notes) for cell in cells)]))
        lines.append("")
    return "\n".join([*lines, "## Reasons", "", *(f"{number}. {reason}" for reason, number in notes.items()), ""])


def _short(cell: str, notes: dict[str, int]) -> str:
    """A mark, with the number of its reason."""
    what, _, reason = cell.partition(": ")
    return f"{SHORT[what]} {notes.get(reason, '')}".strip()


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
