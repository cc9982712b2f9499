"""The commands that run, resume and report studies."""

import json
import sys
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer

from neurotact import files, spec
from neurotact.cli.lazy import new_app
from neurotact.cli.options import (
    Group,
    Json,
    LeaveOut,
    Order,
    OutFolder,
    PopulationDevice,
    SchedulerOption,
    SetOption,
    StudyFolder,
    TestWhere,
    Where,
    WorkersOption,
    choice_table,
    say_if_seconds,
    split_changes,
)  # fmt: skip
from neurotact.cli.output import print_table
from neurotact.cli.words import as_typed, say
from neurotact.errors import INTERRUPTED
from neurotact.report import report
from neurotact.report.page import ANSWER
from neurotact.studies import loading, runner

WIDE = 110
"""Characters of a line of a table, at least: its rows are read across."""

app = new_app("Run, resume and report studies.")


@app.command("run")
def study_run(
    name: Annotated[str, typer.Argument(help="Name or path of a study spec.")],
    out: OutFolder,
    quick: Annotated[bool, typer.Option("--quick", help="A smaller sweep of the same kind.")] = False,
    data: Annotated[
        Path | None,
        typer.Option(help="A file of recordings of your own, for own-recordings and ways-to-save."),
    ] = None,
    length_ms: Annotated[
        float | None,
        typer.Option("--window-ms", min=0, help="Length of the windows, as --set window.length_ms=300 gives it."),
    ] = None,
    where: Where = None,
    leave_out: LeaveOut = None,
    test_where: TestWhere = None,
    group: Group = None,
    order: Order = None,
    folds: Annotated[
        int | None,
        typer.Option("--folds", min=2, help="Divide the trials into this many folds and test on each in turn."),
    ] = None,
    repeats: Annotated[
        int | None,
        typer.Option("--repeats", min=2, max=1000, help="Number of random splits; results are means over them."),
    ] = None,
    settings: SetOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    device: PopulationDevice = "cpu",
    as_json: Json = False,
) -> None:
    """Run a study and write its report.

    With --folds or --repeats every network is trained for each split, and results are means over the splits.
    """
    say_if_seconds(length_ms)
    changes = spec.parse_assignments(settings or []) | ({} if length_ms is None else {"window.length_ms": length_ms})
    changes |= split_changes(test_where, group, order, folds, repeats)
    changes |= loading.choice_changes(**choice_table(where, leave_out))
    what = loading.resolve(name, changes, quick=quick, data=data)
    for note in getattr(what, "notes", ()):
        say(note)
    _run_study(what, out, (workers, scheduler, device), as_json)


@app.command("resume")
def study_resume(
    folder: StudyFolder,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    device: PopulationDevice = "cpu",
    as_json: Json = False,
) -> None:
    """Continue an interrupted study."""
    _run_study(runner.load(folder), folder, (workers, scheduler, device), as_json)


@app.command("report")
def study_report(folder: StudyFolder, as_json: Json = False) -> None:
    """Rewrite the tables, figures and report of a study."""
    runner.write_tables(folder)
    _print_report(report.write(folder), as_json)


def _run_study(what: loading.Study, out: Path, where: tuple[int | None, str | None, str], as_json: bool) -> None:
    workers, scheduler, device = where
    try:
        runner.run(what, out, workers, scheduler, device)
        page = report.write(out)
    except KeyboardInterrupt:
        is_begun = (out / runner.STUDY).is_file()
        go_on = f"go on with: neurotact study resume {out}" if is_begun else "the study had not begun; nothing is saved"
        say(f"interrupted; {go_on}")
        sys.exit(INTERRUPTED)
    _print_report(page, as_json)


def _print_report(page: Path, as_json: bool) -> None:
    """What a study answers, and where its report is; of a study without an answer in words the report alone."""
    path = page.parent / ANSWER
    found = files.read_json(path) if path.is_file() else {"answers": [], "cautions": []}
    if as_json:
        print(json.dumps(found | {"report": str(page)}, indent=1, ensure_ascii=False))
        return
    for one in found["answers"]:
        before = f"{one['dataset']}: " if len(found["answers"]) > 1 else ""
        print(as_typed(f"{before}{' '.join([one['headline'], *one['details']])}"))
    for table in found.get("tables", []):
        print(table["caption"])
        print_table(pd.DataFrame(table["rows"], columns=table["columns"]), least_width=WIDE)
    for caution in found["cautions"]:
        say(caution)
    if found["answers"]:
        print(f"tables and figures in {page.parent}; open the report in a browser:")
    print(page)
