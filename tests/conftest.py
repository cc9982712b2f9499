"""What every test shares: how hypothesis searches, one thread, and the published recordings where they are at hand."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from neurotact.backend import hold_torch_to_avx2

hold_torch_to_avx2()  # before torch is imported: as the command line does
os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported: small tensors are slower on many threads
os.environ.setdefault("TRITON_INTERPRET", "1")  # before torch's optimisers import Triton, where it is installed

ROOT = Path(__file__).parents[1]

settings.register_profile(
    "neurotact",
    deadline=None,
    max_examples=40,
    derandomize="CI" in os.environ,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("neurotact")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """`$NEUROTACT_DATA`, a relative one resolved against the repository root; skips where it is absent."""
    folder = ROOT / os.environ.get("NEUROTACT_DATA", "../shared/data")
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set NEUROTACT_DATA to their folder")
    return folder
