"""The page of a study that is still running: how far it is, and what its finished cells gave on validation trials."""

import csv
import json
import shlex
from collections.abc import Iterator, Sequence
from datetime import datetime
from html import escape
from importlib import resources
from pathlib import Path
from time import monotonic
from typing import Any

from neurotact.data.dataset import ALL
from neurotact.errors import number_of
from neurotact.files import write_text
from neurotact.progress import Watcher, time_left
from neurotact.studies.store import PAGE, RESULT

LOG = "training.csv"
LEAST_S, MOST_SHARE = 2.0, 0.005
"""Seconds between two pages, at least, and the most of the time that writing them may take."""
MOST_SHOWN, POINTS = 50, 60
"""The newest cells that are listed; points of a drawn loss."""
ABSENT = {"dataset": ALL, "t_ref_ra_ms": None, "t_ref_sa_ms": None}
"""Values that say nothing of a cell."""
COLUMNS = {
    "dataset": "data", "encoder": "encoder", "t_ref_ra_ms": "t_ref RA-I (ms)", "t_ref_sa_ms": "t_ref SA-I (ms)",
    "hidden": "hidden neurons", "seed": "seed", "accuracy_validation": "validation accuracy",
}  # fmt: skip


def writer(title: str, folder: Path) -> Watcher:
    """A watcher of progress that writes the page into a run folder, whole, every few seconds."""
    rows: dict[str, dict[str, Any]] = {}
    began, due = {}, monotonic()

    def write(what: str, done: int, total: int, parts: str) -> None:
        nonlocal due
        now = monotonic()
        began.setdefault(what, (now, done))
        if now < due:
            return
        for path in sorted(folder.glob(f"cells/*/{RESULT}"), key=lambda path: path.stat().st_mtime):
            if path.parent.name not in rows:
                rows[path.parent.name] = _row(path.parent)
        since, before = began[what]
        left = time_left((now - since) / (done - before) * (total - done)) if before < done < total else ""
        shown = f"{what} {done} of {total}{f', {left}' if left else ''}"
        write_text(folder / PAGE, _page(title, folder, shown, parts, [*rows.values()]))
        took = monotonic() - now
        due = now + max(LEAST_S, took / MOST_SHARE)

    return write


def _row(cell: Path) -> dict[str, Any]:
    """What a finished cell shows: values of its row, and the losses of its training."""
    try:
        row = json.loads((cell / RESULT).read_text(encoding="utf-8")).get("row", {})
        with open(cell / LOG, encoding="utf-8", newline="") as file:
            log = [*csv.DictReader(file)]
    except (OSError, ValueError, AttributeError):  # it is checked when tables are made
        row, log = {}, []
    losses = {name: [float(line[name]) for line in log if line.get(name)] for name in ("train_loss", "validation_loss")}
    return {**row, "losses": losses}


def _page(title: str, folder: Path, shown: str, parts: str, rows: Sequence[dict[str, Any]]) -> str:
    """The page as HTML; parts: what worker processes are at, separated by semicolons."""
    style = (resources.files("neurotact.report") / "assets" / "style.css").read_text(encoding="utf-8")
    at = "".join(f"<li>{escape(part)}</li>" for part in parts.split("; ") if part)
    newest = rows[: -MOST_SHOWN - 1 : -1]
    columns = [name for name in COLUMNS if any(row.get(name) != ABSENT.get(name) for row in rows)]
    heads = "".join(f'<th scope="col">{escape(COLUMNS[name])}</th>' for name in columns)
    shown_rows = ([_cell(name, row.get(name)) for name in columns] + [_drawn(row["losses"])] for row in newest)
    body = "".join(f"<tr>{''.join(f'<td>{value}</td>' for value in values)}</tr>" for values in shown_rows)
    older = f", the newest {MOST_SHOWN}" if len(rows) > MOST_SHOWN else ""
    table = (
        f'<div class="scroll" role="region" aria-label="Finished cells" tabindex="0"><table><caption>'
        f"{number_of(len(rows), 'cell')} finished{older}. Test trials are shown when all are.</caption><thead><tr>"
        f"{heads}"
        f'<th scope="col">loss over epochs: training, validation (dashed)</th></tr></thead><tbody>{body}</tbody>'
        "</table></div>"
        if rows
        else ""
    )
    here = escape(shlex.quote(str(folder.absolute())))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="refresh" content="5">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{escape(title)} (running)</title>
<link rel="icon" href="data:,">
<style>
{style}
</style>
</head>
<body>
<header><h1>{escape(title)}</h1></header>
<main id="main">
<p class="headline">This study is still running: {escape(shown)}.</p>
<ul>{at}</ul>
<p>Written at {datetime.now():%H:%M:%S on %d %B %Y}; the page loads itself again every 5 s. If this time stays, the
study was stopped: <code>neurotact study resume {here}</code> goes on with it, and
<code>neurotact study report {here}</code> writes the report of the finished cells.</p>
{table}
</main>
</body>
</html>
"""


def _cell(name: str, value: Any) -> str:
    if value is None:
        return ""
    if name.startswith("accuracy") and isinstance(value, float):
        return f"{100 * value:.1f}\u00a0%"
    return escape(f"{value:g}" if isinstance(value, float) else str(value))


def _drawn(losses: dict[str, list[float]]) -> str:
    """Losses over epochs as a small picture; nothing for a training without epochs."""
    most = max((max(values) for values in losses.values() if values), default=0.0)
    if not most:
        return ""
    dashes: dict[str, str] = {"train_loss": "", "validation_loss": ' stroke-dasharray="3 2"'}
    lines = "".join(
        f'<polyline points="{" ".join(_points(values, most))}" fill="none" stroke="currentColor"{dashes[name]}/>'
        for name, values in losses.items()
    )
    return (
        f'<svg viewBox="0 0 {POINTS} 20" width="{2 * POINTS}" height="40" role="img" aria-label="losses">{lines}</svg>'
    )


def _points(values: Sequence[float], most: float) -> Iterator[str]:
    """At most `POINTS` places of a curve, from 0 to `most`, evenly spaced."""
    n = min(POINTS, len(values))
    for place in range(n):
        value = values[round(place * (len(values) - 1) / max(1, n - 1))]
        yield f"{place * POINTS / n:.0f},{20 - 19 * value / most:.1f}"
