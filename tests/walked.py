"""Follows the commands of a page one after the other, in a folder, with settings that make them short."""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from in_process import studies_here, typed, without_pictures

GIVEN = re.compile(r'(\w+)=(\S*?)\$\(python -c "(.*)"\)')


def walk(page: Path, place: Path, shorter: Mapping[str, str]) -> dict[str, str]:
    """What each `neurotact` command of the first block of a page printed, by its words as they stand there.

    shorter: words that are added to a command that begins with these words. `pip` is left out.
    """
    block = page.read_text(encoding="utf-8").partition("```sh\n")[2].partition("```")[0]
    told, names = {}, {}
    for line in filter(None, block.splitlines()):
        if given := GIVEN.fullmatch(line):
            names[f"${given[1]}"] = given[2] + _python(given[3], place)
            continue
        words = [names.get(word, word) for word in shlex.split(line, comments=True)]
        if words[0] == "neurotact":
            more = " ".join(extra for begin, extra in shorter.items() if line.startswith(f"neurotact {begin}"))
            with studies_here() as patch:
                without_pictures(patch)
                done = typed(*words[1:], *shlex.split(more), cwd=place)
            assert done.code == 0, f"{line}: {done.err}"
            told[line] = done.out + done.err
        elif words[0] == "python":
            with pytest.MonkeyPatch.context() as patch:
                patch.chdir(place)
                patch.setattr(sys, "argv", words[1:])
                runpy.run_path(str(page.parent / words[1]))
        elif words[0] == "cc" and shutil.which("cc"):
            subprocess.run(words, cwd=place, check=True)
        else:
            assert words[0] in ("cc", "pip"), line
    return told


def _python(code: str, place: Path) -> str:
    out = StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out):
        patch.chdir(place)
        exec(code, {})
    return out.getvalue().strip()
