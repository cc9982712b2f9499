"""The examples in docstrings of the packages beside the framework, under the names that users import."""

import doctest
import pkgutil
import shutil
from importlib import import_module

import pytest

import neurotact as nt

PACKAGES = ("neurotact_parts.encoders", "neurotact_parts.exporters", "neurotact_parts.studies")
AS_TYPED = "neurotact_parts.exporters"
"""Where examples name files as a user does."""
MODULES = [
    module.name
    for package in PACKAGES
    for module in pkgutil.walk_packages(import_module(package).__path__, f"{package}.")
    if not module.ispkg
]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name, request, tmp_path, monkeypatch):
    if AS_TYPED in name:
        shutil.copytree(request.getfixturevalue("_files_of_examples"), tmp_path / "examples")
        monkeypatch.chdir(tmp_path / "examples")
    assert doctest.testmod(import_module(name), extraglobs={"nt": nt}, raise_on_error=False).failed == 0
