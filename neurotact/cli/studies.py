"""The commands that run, resume and report studies."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from neurotact import spec
from neurotact.cli.lazy import new_app
from neurotact.cli.options import OutFolder, SchedulerOption, SetOption, StudyFolder, WorkersOption
from neurotact.errors import INTERRUPTED, InputError
from neurotact.progress import say
from neurotact.report import report
from neurotact.studies import loading, runner

app = new_app("Run, resume and report studies.")


@app.command("run")
def study_run(
    name: Annotated[str, typer.Argument(help="Name or path of a study spec.")],
    out: OutFolder,
    quick: Annotated[bool, typer.Option("--quick", help="A smaller sweep of the same kind.")] = False,
    set_: SetOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Run a study: every cell of its sweep, the tables, the figures, the report."""
    _run_study(loading.resolve(name, spec.parse_assignments(set_ or []), quick=quick), out, workers, scheduler)


@app.command("resume")
def study_resume(folder: StudyFolder, workers: WorkersOption = None, scheduler: SchedulerOption = None) -> None:
    """Go on with a study that was interrupted."""
    _run_study(runner.load(folder), folder, workers, scheduler)


@app.command("report")
def study_report(folder: StudyFolder) -> None:
    """Write the tables, figures and report again from the cells that are done."""
    runner.write_tables(folder)
    print(report.write(folder))


def _run_study(what: loading.Study, out: Path, workers: int | None, scheduler: str | None) -> None:
    if workers and scheduler:
        raise InputError("--workers, --scheduler: give one of them; a cluster has the workers that have joined it")
    try:
        runner.run(what, out, workers or 2, scheduler)
        print(report.write(out))
    except KeyboardInterrupt:
        say(f"interrupted; go on with: neurotact study resume {out}")
        sys.exit(INTERRUPTED)
