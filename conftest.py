"""Optional packages: what needs one is left out where it is not installed, and never without a word."""

import os
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement

NEEDS = {"pynwb": "neurotact/data/nwb_output.py"}
collect_ignore = [path for package, path in NEEDS.items() if not find_spec(package)]
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


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what is skipped for want of a package."""
    absent = [*missing("test")]
    if absent:
        terminalreporter.section("not tested")
        terminalreporter.line(f"what needs {', '.join(absent)}: not installed; pip install -e '.[test]'")
