"""Environments apart from this checkout: copies of it, virtual environments, and commands that see neither."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILT = shutil.ignore_patterns(
    ".git",
    ".venv*",
    "build",
    "dist",
    "runs",
    "__pycache__",
    "*.so",
    ".*_cache",
    ".hypothesis",
    "*.egg-info",
    "gallery_of_examples",
)
PIP = (sys.executable, "-m", "pip", "--quiet")
CONSTRAINTS = ("-c", ROOT / "constraints.txt")


def clean(**more: str) -> dict[str, str]:
    """The environment without what would lead to this checkout."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NEUROTACT"))}
    return {**kept, **more}


def run(*words: object, cwd: Path, said: str = "", **more: str) -> str:
    """What a command prints; `said` is its input."""
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, env=clean(**more), input=said, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def copy_of_checkout(folder: Path) -> Path:
    """The files of a clone in which nothing was built."""
    return Path(shutil.copytree(ROOT, folder, ignore=BUILT, symlinks=True))


def venv(folder: Path, *, sees_packages: bool = False) -> Path:
    """The `python` of a new virtual environment without pip.

    sees_packages: it has the packages of this environment, but no neurotact: an editable one hangs on a .pth file, and
    those of another folder are not read.
    """
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    if sees_packages:
        (site,) = folder.glob("lib/python*/site-packages")
        (site / "packages.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "bin" / "python"


def pip_install(python: Path, *words: object) -> None:
    """Install into the environment of `python`, with the versions of `constraints.txt`."""
    run(*PIP, "--python", python, "install", "--no-compile", *CONSTRAINTS, *words, cwd=python.parent)
