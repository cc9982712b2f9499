"""The examples in docstrings of the packages beside the framework, under the names that users import."""

import doctest
import pkgutil
from importlib import import_module

import pytest

PACKAGES = ("neurotact_parts.encoders", "neurotact_parts.studies")
MODULES = [
    module.name
    for package in PACKAGES
    for module in pkgutil.walk_packages(import_module(package).__path__, f"{package}.")
    if not module.ispkg
]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name):
    assert doctest.testmod(import_module(name), raise_on_error=False).failed == 0
