"""The source distribution and the wheel, installed as a user does: every command runs outside the checkout.

The wheel is built from the source distribution, and pip installs it with what it declares, torch too: an environment
that saw this one's packages would hide a dependency that nobody declared.
"""

import json
import shutil
import signal
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import made_inputs
import pytest
import torch
from typer.main import get_group
from venvs import CONSTRAINTS, PIP, ROOT, clean, copy_of_checkout, pip_install, run, venv

from neurotact import cli

ROOMS = ("encoders", "exporters", "networks", "opponents", "prices", "readers", "streams", "studies")
SPECS = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.toml")) if path.parent.name != "spaces"]
HAS_COMPILER = any(map(shutil.which, ("c++", "g++", "clang++")))
EXTRAS = "live,nir,neuro"
LINES = """
list
show sa1-ra1-lif
copy rsnn -o mine.toml
fetch
simulate gratings --set trials=2 --set duration_s=0.2 --set pitches_mm=[4.0,1.0] -o gratings.h5
simulate gratings-slips --set recordings=1 --set duration_s=6 -o slips.h5
simulate stiffness --set placements=1 --set grasps=1 -o stiffness.h5
simulate touch-modality --set people=1 --set recording_s=2 -o rubbed.h5
simulate contact-materials --set trials=1 --set frequencies_Hz=[5.0] --set duration_s=0.4 -o materials.h5
simulate compliance --set trials=1 -o compliance.h5
import folder csv --unit mV -o folder.h5
import table table.csv --unit mV --trial trial -o table.h5
import arrays arrays.npz --unit mV --sampling-rate-Hz 1000 --names signals=x,label=gesture -o arrays.h5
import events events.csv -o events.h5
import raster dense.npz -o from-raster.h5
import braille-letters letters.npz -o letters.h5
import fabricslide fabrics -o fabrics.h5
import pvdf-hardness presses -o presses.h5
import touch-modality modality -o modality.h5
info touch.h5
calibrate touch.h5 --set conditioning.baseline=start -o calibrated.toml
encode touch.h5 --encoder calibrated.toml -o encoded.h5
raster spikes.h5 -o raster.png
train spikes.h5 --network rsnn --set hidden=4 --set training.epochs=1 --window-ms 50 -o trained
conditions-curve spikes.h5 day --network rsnn --set hidden=4 --set training.epochs=1 --window-ms 50
tune spikes.h5 --network rsnn --set training.epochs=1 --trials 2 --window-ms 50 -o tuned
infer run spikes.h5 --early-exit
sops run -o sops.csv
fine-tune run --weight-bits 4 --epochs 1 -o fine
stream run --from touch.h5
export run --to c -o chain
study run tiny.toml --set network.hidden=4 --set sweep.seed=[0] --workers 2 -o study
study resume study
study report study
study bundle study -o bundle
"""
"""A line for each command that needs no extra."""
LINES_OF_EXTRAS = """
raster spikes.h5 -o spikes.nwb
import nwb spikes.nwb -o nwb.h5
export run --to nir -o run.nir
"""
SETS = ("cluster-haptic-texture", "cost", "st-mnist", "stemnist", "stemnist-pressure", "vt-snn")
APART = ("learn", "live", "save", *(f"import {name}" for name in SETS))
"""Commands with tests of their own."""
DRIVER = """
import shlex, sys

if __name__ == "__main__":
    from neurotact import cli

    for line in sys.stdin.read().splitlines():
        sys.argv = ["neurotact", *shlex.split(line)]
        try:
            cli.main()
        except SystemExit as end:
            if end.code:
                sys.exit(f"{line}: exit code {end.code}")
"""
"""Runs a command line for each line that it reads: one process, so that what they import is imported once."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """A source distribution, made where something was built before."""
    folder = tmp_path_factory.mktemp("source")
    clone = copy_of_checkout(folder / "clone")
    for built in ("build/cp311/CMakeFiles/kernels.dir/native/infer.cpp.o", "neurotact/_native.abi3.so"):
        (clone / built).parent.mkdir(parents=True, exist_ok=True)
        (clone / built).write_bytes(b"object")
    run(*PIP, "install", *CONSTRAINTS, "--target", folder / "tools", "scikit-build-core", cwd=folder)
    make = "from scikit_build_core.build import build_sdist; build_sdist('../dist')"
    run(sys.executable, "-c", make, cwd=clone, PYTHONPATH=str(folder / "tools"))
    (found,) = (folder / "dist").glob("neurotact-*.tar.gz")
    return found


def _wheel(source: Path, folder: Path, **choice: str) -> Path:
    run(*PIP, "wheel", *CONSTRAINTS, "--no-deps", "-w", folder, source, cwd=folder, **choice)
    (found,) = folder.glob("neurotact-*.whl")
    return found


@pytest.fixture(scope="module")
def wheel(source, tmp_path_factory) -> Path:
    """The wheel of this machine: with kernels where there is a compiler."""
    choice = {"NEUROTACT_REQUIRE_NATIVE": "1"} if HAS_COMPILER else {}
    return _wheel(source, tmp_path_factory.mktemp("wheel"), **choice)


@pytest.fixture(scope="module")
def plain_wheel(source, tmp_path_factory) -> Path:
    """The wheel of a machine without a compiler, that the reference runs on."""
    return _wheel(source, tmp_path_factory.mktemp("plain"), CXX=shutil.which("false") or "")


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory) -> Iterator[Path]:
    """The `python` of an environment that holds the wheel and what it declares."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    found = venv(folder)
    pip_install(found, wheel)
    yield found
    shutil.rmtree(folder)  # 1.4 GB


@pytest.fixture(scope="module")
def python_with_extras(python, wheel) -> Path:
    pip_install(python, f"{wheel}[{EXTRAS}]")
    return python


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Path:
    """A folder with what the lines read, and the driver."""
    folder = tmp_path_factory.mktemp("inputs")
    made_inputs.make(folder)
    made_inputs.make_public_sets(folder)
    shutil.copy(ROOT / "tests" / "studies" / "tiny.toml", folder)
    (folder / "driver.py").write_text(DRIVER)
    return folder


def test_the_source_holds_what_a_clone_holds(source):
    held = {
        path.relative_to(source.parents[1] / "clone").as_posix()
        for path in (source.parents[1] / "clone").rglob("*")
        if path.is_file()
    }
    with tarfile.open(source) as file:
        names = {member.name.partition("/")[2] for member in file.getmembers() if member.isfile()}
    assert names - {"PKG-INFO"} == {name for name in held if not name.endswith((".o", ".so"))}


def test_the_wheel_holds_every_module_every_stub_and_every_spec(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    files = {path for kind in ("*.py", "*.pyi", "*.html", "py.typed") for path in (ROOT / "neurotact").rglob(kind)}
    beside = [path for room in ROOMS for path in (ROOT / room).rglob("*")]
    theirs = {f"neurotact_parts/{path.relative_to(ROOT).as_posix()}" for path in beside
              if path.suffix in (".py", ".pyi", ".toml", ".csv", ".html", ".jinja", ".c", ".ld")}  # fmt: skip
    assert {path.relative_to(ROOT).as_posix() for path in files} | theirs <= names
    assert not {name for name in names if name.startswith(("tests/", "native/", *(f"{room}/" for room in ROOMS)))}


def test_the_wheel_holds_kernels_where_there_is_a_compiler(wheel, plain_wheel):
    kernels = [
        any(name.endswith((".so", ".pyd")) for name in zipfile.ZipFile(one).namelist()) for one in (wheel, plain_wheel)
    ]
    assert kernels == [HAS_COMPILER, False]


def test_the_command_and_the_shipped_specs_are_found_outside_the_checkout(python, tmp_path):
    told = run(python, "-c", "import neurotact, torch; print(neurotact.__file__, torch.__version__)", cwd=tmp_path)
    where, version = told.split()
    assert Path(where).is_relative_to(python.parents[1])
    assert version == torch.__version__  # not one for CUDA, say, beside one for the CPU here
    listed = run(python.parent / "neurotact", "list", cwd=tmp_path)
    assert not [path.stem for path in SPECS if path.stem not in listed]
    shown = run(python.parent / "neurotact", "show", "sa1-ra1-lif", cwd=tmp_path)
    assert shown == (ROOT / "encoders" / "sa1-ra1-lif.toml").read_text(encoding="utf-8")


def _commands(group: Any, before: str = "") -> Iterator[str]:
    for name, command in group.commands.items():
        inner = getattr(command, "commands", None)
        yield from _commands(command, f"{before}{name} ") if inner else [f"{before}{name}"]


def test_every_command_has_a_line():
    lines = [f"{line} " for line in (LINES + LINES_OF_EXTRAS).splitlines()]
    commands = [name for name in _commands(get_group(cli.app)) if name not in APART]
    assert not [name for name in commands if not any(line.startswith(f"{name} ") for line in lines)]


def test_every_command_runs_outside_the_checkout(python, inputs):
    run(python, "driver.py", cwd=inputs, said=LINES.strip())
    backend = json.loads((inputs / "study" / "versions.json").read_text())["backend"]
    assert backend == ("native" if HAS_COMPILER else "reference")


def test_commands_that_need_an_extra_run_with_it(python_with_extras, inputs):
    run(python_with_extras, "driver.py", cwd=inputs, said=LINES_OF_EXTRAS.strip())


@pytest.mark.usefixtures("ctrl_c")
def test_live_serves_outside_the_checkout(python_with_extras, inputs):
    words = [python_with_extras.parent / "neurotact", "live", "run", "--from", "touch.h5", "--loop"]
    with subprocess.Popen(
        words, cwd=inputs, env=clean(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 0, said


def test_the_chain_runs_without_kernels(python, plain_wheel, tmp_path):
    run(*PIP, "install", "--no-deps", "--no-index", "--target", tmp_path / "plain", plain_wheel, cwd=tmp_path)
    lines = """
    simulate gratings --set trials=2 --set duration_s=0.2 --set pitches_mm=[4.0,1.0] -o touch.h5
    encode touch.h5 -o spikes.h5
    train spikes.h5 --set training.epochs=1 -o run
    infer run spikes.h5 --early-exit
    """
    (tmp_path / "driver.py").write_text(DRIVER)
    said = "\n".join(map(str.strip, lines.strip().splitlines()))
    assert "accuracy" in run(python, "driver.py", cwd=tmp_path, said=said, PYTHONPATH=str(tmp_path / "plain"))
