"""Optional packages: what needs one is left out where it is not installed, and never without a word."""

import gc
import os
import shutil
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

EXTRAS = tomllib.loads((Path(__file__).parent / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def missing(extra: str) -> Iterator[str]:
    """Requirements of an extra, and of the extras that it names, that are not installed."""
    for requirement in map(Requirement, EXTRAS[extra]):
        if requirement.name == "neurotact":
            for inner in sorted(requirement.extras):
                yield from missing(inner)
        elif not is_installed(requirement):
            yield str(requirement)


def is_installed(requirement: Requirement) -> bool:
    """Whether a version that serves is here."""
    try:
        return requirement.specifier.contains(version(requirement.name), prereleases=True)
    except PackageNotFoundError:
        return False


def pytest_configure(config: pytest.Config) -> None:
    """Where make has installed the extra `test`, no test is skipped for want of a package of it."""
    absent = [*missing("test")]
    if absent and os.environ.get("NEUROTACT_REQUIRE_EXTRAS"):
        raise pytest.UsageError(f"not installed: {', '.join(absent)}; pip install -e '.[test]'")


def pytest_collection() -> None:
    """What is collected stays: a search for garbage, a tenth of this time, finds nothing in it, now or later."""
    gc.disable()


def pytest_collection_finish() -> None:
    """From here on only what tests make is searched."""
    gc.freeze()
    gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what is skipped for want of a package."""
    absent = [*missing("test")]
    if absent:
        terminalreporter.section("not tested")
        terminalreporter.line(f"what needs {', '.join(absent)}: not installed; pip install -e '.[test]'")


AS_TYPED = {"neurotact.api", "neurotact.networks.use.exporters"}
"""Where examples name files as a user does: they run beside those of `tests/made_inputs.py`."""


@pytest.fixture(scope="session")
def _files_of_examples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sys.path.insert(0, str(Path(__file__).parent / "tests"))
    import made_inputs

    folder = tmp_path_factory.mktemp("examples")
    made_inputs.make(folder)
    return folder


@pytest.fixture(autouse=True)
def _beside_files(request: pytest.FixtureRequest) -> None:
    """An example in a docstring of the API is in a folder with files, has `nt`, and writes what it likes."""
    named = request.node.name
    if not (isinstance(request.node, pytest.DoctestItem) and any(named.startswith(place) for place in AS_TYPED)):
        return
    files, monkeypatch = request.getfixturevalue("_files_of_examples"), request.getfixturevalue("monkeypatch")
    folder = request.getfixturevalue("tmp_path") / "examples"  # made for these alone: a folder a test takes long
    shutil.copytree(files, folder)
    monkeypatch.chdir(folder)


@pytest.fixture(autouse=True)
def _names(doctest_namespace: dict[str, Any]) -> None:
    import neurotact as nt

    doctest_namespace["nt"] = nt
