"""The toy protocol, found by name as that of an installed package is."""

from functools import lru_cache
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from neurotact import plugins

FOLDER = Path(__file__).parent / "toy_ways"


def bring(patch: pytest.MonkeyPatch) -> None:
    """Make the protocol `coins` known until the patch is undone."""
    found = plugins._found
    point = EntryPoint("coins", "coins", "neurotact.ways")
    patch.syspath_prepend(str(FOLDER))
    with_coins = lru_cache(lambda group: {**found(group), "coins": [point]} if group == "ways" else found(group))
    patch.setattr(plugins, "_found", with_coins)
