"""The published recordings, where they are at hand."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def real_data() -> Path:
    """`$NEUROTACT_DATA`, a relative one resolved against the repository root; skips where it is absent."""
    data = ROOT / os.environ.get("NEUROTACT_DATA", "../shared/data")
    if not data.is_dir():
        pytest.skip(f"no recordings at {data}; set NEUROTACT_DATA to their folder")
    return data
