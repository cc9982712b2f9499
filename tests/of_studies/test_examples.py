"""The examples in docstrings of the packages beside the framework, under the names that users import."""

import doctest
import pkgutil
import shutil
from importlib import import_module

import pytest

import neurotact as nt

PACKAGES = tuple(
    f"neurotact_parts.{room}"
    for room in ("encoders", "exporters", "networks", "opponents", "readers", "streams", "studies")
)
AS_TYPED = tuple(
    f"neurotact_parts.{room}"
    for room in (
        "exporters",
        "networks.new_class",
        "networks.refuse",
        "networks.saving",
        "networks.search",
        "readers",
        "streams",
    )
)
"""Where examples name files as a user does."""
NEEDS = {"neo_blocks": "neo", "nwb": "pynwb", "nwb_output": "pynwb"}
"""Optional packages that the examples of a module need."""
MODULES = [
    module.name
    for package in PACKAGES
    for module in pkgutil.walk_packages(import_module(package).__path__, f"{package}.")
    if not module.ispkg
]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name, request, tmp_path, monkeypatch):
    needed = NEEDS.get(name.rpartition(".")[2])
    if needed is not None:
        pytest.importorskip(needed)
    if name.startswith(AS_TYPED):
        shutil.copytree(request.getfixturevalue("_files_of_examples"), tmp_path / "examples")
        monkeypatch.chdir(tmp_path / "examples")
    assert doctest.testmod(import_module(name), extraglobs={"nt": nt}, raise_on_error=False).failed == 0
