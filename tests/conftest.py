"""What every test shares: how hypothesis searches, one thread, and the published recordings where they are at hand."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import levels
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers

# Small tensors are slower on many threads, by far where several tests run at once; threads that wait for each other are
# not to count while they do. The kernels and torch share a library that reads this when the first of them is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
from neurotact.backend import hold_torch_to_avx2

hold_torch_to_avx2()  # before torch is imported: as the command line does

ROOT = Path(__file__).parents[1]
# Scripts and helpers hold no tests, nor examples in docstrings, for which they would be imported.
collect_ignore = [str(path) for path in Path(__file__).parent.rglob("*.py") if not path.name.startswith("test_")]

# A change is judged by the same examples each time; only the slow level (`make test-slow`) draws others.
for name, n_examples in (("quick", levels.QUICK), ("thorough", levels.THOROUGH), ("random", levels.THOROUGH)):
    settings.register_profile(
        name,
        deadline=None,
        max_examples=n_examples,
        derandomize=name != "random",
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    )
settings.load_profile("quick")
# It would also draw constants of the modules that are loaded, and these depend on what a worker has run before.
providers._get_local_constants = lambda: providers._local_constants


LONG = ("live", "report", "studies", "of_studies", "export", "test_cli.py", "test_workers.py", "test_options.py")
"""Folders and files with tests that take seconds: they begin first, so that no worker is alone with them at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not set(LONG) & set(item.path.parts))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Weights drawn without a seed are the same whichever worker a test runs on, and after whichever other test."""
    if torch := sys.modules.get("torch"):
        torch.manual_seed(0)


@pytest.fixture(scope="module", autouse=True)
def _small_opponents() -> Iterator[None]:
    """Trainings and searches end in forests and in MiniRocket, which take longer here than they do."""
    from neurotact_parts.networks.search import search_tables
    from neurotact_parts.opponents import minirocket, scikit_learn

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scikit_learn, "TREES", 10)
        patch.setattr(minirocket, "FEATURES", 1008)
        patch.setattr(search_tables, "TREES", 40)
        yield


@pytest.fixture
def kernels_as_before() -> Iterator[None]:
    """A test may choose the number of threads and the instruction set: the next one finds both as they were."""
    import torch

    from neurotact.networks.definition import native

    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)
    if native.native is not None:
        native.set_isa(native.isas()[-1])


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Ctrl-C is heard here and by the processes that a test starts, also where a shell ignores it (`make test &`)."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """`$NEUROTACT_DATA`, a relative one resolved against the repository root; skips where it is absent."""
    folder = ROOT / os.environ.get("NEUROTACT_DATA", "../shared/data")
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set NEUROTACT_DATA to their folder")
    return folder
