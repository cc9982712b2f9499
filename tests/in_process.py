"""The command line in this process: no start, no import. Processes of their own are for laws about processes."""

import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import pytest

from neurotact import cli


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
