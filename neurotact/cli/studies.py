"""The commands that run, resume and report studies."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from neurotact.api import studies as api
from neurotact.api import tools
from neurotact.cli.help import Command
from neurotact.cli.lazy import new_app
from neurotact.cli.options import Json, StudyFolder, calling, flag, option
from neurotact.cli.output import print_table, show
from neurotact.cli.words import as_typed, say
from neurotact.errors import INTERRUPTED
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


WIDE = 110
"""Characters of a line of a table, at least: its rows are read across."""

app = new_app("Run, resume and report studies.")


@app.command("run", cls=Command)
@calling(
    api.run_study,
    name=Annotated[str, typer.Argument(help="Name or path of a study spec.")],
    quick=flag("--quick", "A smaller sweep of the same kind."),
    data=option(
        Path | None,
        "A file of recordings of your own, for own-recordings, which-encoder, ways-to-save or untrained-conditions.",
    ),
    window="window_ms",
    split="test_where group order folds leave_out_each repeats",
    learn="target false_alarms_per_h",
)
def study_run(given: dict[str, Any], as_json: Json = False) -> None:
    """Run a study and write its report.

    With --folds or --repeats every network is trained for each split, and results are means over the splits.
    """
    _run(api.run_study, given, as_json)


@app.command("resume", cls=Command)
@calling(api.resume_study, folder=StudyFolder)
def study_resume(given: dict[str, Any], as_json: Json = False) -> None:
    """Continue an interrupted study."""
    _run(api.resume_study, given, as_json)


@app.command("report", cls=Command)
def study_report(folder: StudyFolder, as_json: Json = False) -> None:
    """Rewrite the tables, figures and report of a study."""
    api.report_study(folder)
    _print_answer(folder, as_json)


@app.command("bundle", cls=Command)
@calling(
    tools.bundle_study,
    study=StudyFolder,
    out=option(Path, "The folder to write.", "-o", "--out"),
    width=option(
        Literal["ieee", "ieee-column", "nature", "nature-column"],
        "Width of the figures: of two columns (7.16 in, 180 mm), or of one (3.5 in, 85 mm).",
    ),
    without_data=flag("--without-data", "Leave the recordings out; their hashes stay."),
)
def study_bundle(given: dict[str, Any]) -> None:
    """Write a finished study as one folder for a paper: tables, figures, methods, references, and how to run it again.

    Tables are CSV and LaTeX, figures PDF. In the folder, sh reproduce.sh runs the study again and compares the bytes.
    """
    tools.bundle_study(**given, tell=show)


def _run(function: Callable[..., Any], given: dict[str, Any], as_json: bool) -> None:
    folder: Path = given["folder"]
    try:
        function(**given)
    except KeyboardInterrupt:
        go_on = f"go on with: {api.store.resuming(folder)}"
        say(f"interrupted; {go_on if api.is_begun(folder) else 'the study had not begun; nothing is saved'}")
        sys.exit(INTERRUPTED)
    _print_answer(folder, as_json)


def _print_answer(folder: Path, as_json: bool) -> None:
    """What a study answers, and where its report is; of a study without an answer in words the report alone."""
    answer = api.study_answer(folder)
    if as_json:
        print(json.dumps(answer, indent=1, ensure_ascii=False))
        return
    for caution in answer["cautions"]:
        say(caution)
    tables = reversed(answer.get("tables", []))
    for table in reversed({table.get("setting"): table for table in tables}.values()):  # the first of each answer
        print(table["caption"])
        rows = [table["rows"][row] for row in table["named"]]
        print_table(pd.DataFrame(rows, columns=table["columns"]), least_width=WIDE)
    if answer["answers"]:
        print(f"tables and figures in {folder}; the whole answer, with each number's meaning, in a browser:")
    print(answer["report"])
    if answer.get("among"):
        print(as_typed(answer["among"]))
    several = len(answer["answers"]) > 1
    for one in [] if answer.get("among") else answer["answers"]:
        for sentence in _told(one, folder, f"{one['dataset']}: " if one["dataset"] and several else ""):
            print(sentence)


def _told(one: Mapping[str, Any], folder: Path, before: str) -> Iterator[str]:
    """An answer of the study in `folder` in the terminal: its numbers, what to do next, and last what it says."""
    figures, then = one.get("figures", []), one.get("next", {"words": "", "commands": []})
    for figure in figures:
        against = f"; {figure['against']}" if figure["against"] else ""
        yield as_typed(f"{before}{figure['what']}: {figure['value']} ({figure['of']}){against}")
    if one.get("folder"):
        yield f"{before}network of these numbers: {folder / one['folder']}"
    if then["words"]:
        yield f"{before}{as_typed(then['words'])}"
        yield from (f"  {command}" for command in then["commands"])
    if not one.get("short"):
        yield as_typed(f"{before}{one['headline']}")
        return
    untold = f"{one['untold']}. " if one.get("untold") else ""
    yield as_typed(f"{before}{untold}{one['short']}.")
    if one.get("period"):
        yield as_typed(one["period"])
