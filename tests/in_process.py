"""The command line and studies in this process: no start, no import. Processes are for laws about processes."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import pytest

from neurotact import cli, workers
from neurotact.report import page
from neurotact.studies import runner
from neurotact.studies.store import cell_folder


class Done(NamedTuple):
    code: int
    out: str
    err: str


def typed(*words: object, cwd: Path | None = None) -> Done:
    """`neurotact WORDS`, in the folder `cwd`."""
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["neurotact", *map(str, words)])
        if cwd is not None:
            patch.chdir(cwd)
        with pytest.raises(SystemExit) as end:
            cli.main()
    return Done(int(end.value.code or 0), out.getvalue(), err.getvalue())


@contextmanager
def studies_here() -> Iterator[pytest.MonkeyPatch]:
    """Studies prepare and compute their cells in this process, with what tests have patched."""

    @contextmanager
    def here(*_):
        def map_cells(kind, cells, folder, beside):
            yield from enumerate(map(beside.run, beside.jobs) if beside else ())
            for cell in cells:
                yield cell, kind.run(cell, kind.load(folder / cell.given), cell_folder(folder, cell), False)

        yield map_cells

    with pytest.MonkeyPatch.context() as patch:
        for module in (runner, workers):  # the report, too
            patch.setattr(module, "in_a_process", lambda task, *arguments: task(*arguments))
        patch.setattr(runner, "executor", here)
        yield patch


def without_pictures(patch: pytest.MonkeyPatch) -> None:
    """Figures of reports are drawn, but neither saved nor shown, which takes most of the time of a report."""
    patch.setattr(page, "_keep", lambda drawn, _: {"source": "", "width": 0, **drawn._asdict()})
