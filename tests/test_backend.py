"""The command line trains the same network on processors with and without AVX-512."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
import torch
from levels import thinned

from neurotact import backend
from neurotact.networks.definition import native
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training.epochs import Examples, train

WIDE = "avx512" in native.isas()
ASK = "import runpy, sys; sys.argv = ['neurotact', '--version']\n"
ASK += "try: runpy.run_module('neurotact', run_name='__main__')\nexcept SystemExit: pass\n"
ASK += "import torch; print(torch.backends.cpu.get_cpu_capability())"


def capability(**environment: str) -> str:
    """What torch computes with in a process that began as the command does."""
    free = {name: value for name, value in os.environ.items() if name != backend.TORCH_INSTRUCTIONS}
    done = subprocess.run(
        [sys.executable, "-c", ASK], env=free | environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()[-1]


@pytest.mark.skipif(not WIDE, reason="this processor has no AVX-512")
@thinned(("said", "used"), [({}, "AVX2"), ({backend.TORCH_INSTRUCTIONS: "avx512"}, "AVX512")])
def test_the_command_holds_torch_to_avx2_unless_the_user_has_said_otherwise(said, used):
    assert capability(**said) == used


@pytest.mark.parametrize(
    ("kernels", "held"),
    [
        (SimpleNamespace(widest_isa=lambda: "plain"), None),
        (SimpleNamespace(widest_isa=lambda: "avx2"), None),
        (SimpleNamespace(widest_isa=lambda: "avx512"), "avx2"),
        (None, None),
    ],
    ids=["plain", "avx2", "avx512", "not compiled"],
)
def test_only_processors_with_avx512_are_held(monkeypatch, kernels, held):
    monkeypatch.setattr(backend, "native", kernels)
    monkeypatch.setattr(os, "environ", {})
    backend.hold_torch_to_avx2()
    assert os.environ.get(backend.TORCH_INSTRUCTIONS) == held
    monkeypatch.setattr(os, "environ", {backend.TORCH_INSTRUCTIONS: "default"})  # what the user has said stays
    backend.hold_torch_to_avx2()
    assert os.environ[backend.TORCH_INSTRUCTIONS] == "default"


class TestThreads:
    """One thread for small work, so that none spins beside others; what the user has chosen stays."""

    @pytest.fixture(autouse=True)
    def unset(self, monkeypatch):
        monkeypatch.delenv(backend.THREADS, raising=False)
        monkeypatch.setattr(os, "cpu_count", lambda: 8)
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(4), raising=False)
        before = torch.get_num_threads()
        yield
        torch.set_num_threads(before)

    @pytest.mark.parametrize("begins", [8, 4])
    def test_small_work_takes_one_and_large_work_what_torch_begins_with(self, begins):
        torch.set_num_threads(begins)
        small, large = (backend.n_threads(size) for size in (backend.SMALL - 1, backend.SMALL))
        assert (small, large, backend.n_threads()) == (1, begins, begins)
        assert 128 * 128 < backend.SMALL <= 450 * 128

    def test_what_the_user_chooses_stays(self, monkeypatch):
        torch.set_num_threads(3)
        assert backend.n_threads(1) == 3
        torch.set_num_threads(4)
        monkeypatch.setenv(backend.THREADS, "4")
        assert backend.n_threads(1) == 4

    @pytest.mark.parametrize(("given", "found"), [("3", 3), ("0", 1), ("2,1", 4), ("", 4)])
    def test_without_torch_there_are_as_many_as_torch_would_begin_with(self, given, found, monkeypatch):
        monkeypatch.delitem(sys.modules, "torch")
        monkeypatch.setenv(backend.THREADS, given)
        assert backend.n_threads() == found

    @pytest.mark.parametrize(("hidden", "most"), [(4, 1), (300, 4)])
    def test_a_training_and_its_kernels_use_as_many_as_their_size_needs(self, hidden, most, monkeypatch):
        torch.set_num_threads(4)
        seen, given = [], []
        for name in ("forward", "backward"):
            kernel = getattr(native.native, name)
            monkeypatch.setattr(
                native.native, name,
                lambda *args, kernel=kernel, **named: (
                    seen.append(torch.get_num_threads()), given.append(named["threads"]), kernel(*args, **named)
                )[-1],
            )  # fmt: skip
        network = RSNN(2, 2, RSNNSpec(hidden=hidden, training=TrainingSpec(epochs=1)), 1000.0)
        touches = Examples(torch.ones(128, 5, 2, dtype=torch.uint8), torch.arange(128) % 2)
        train(network, touches, touches, generator=torch.Generator().manual_seed(0))
        assert {*seen} == {*given} == {most}
        assert torch.get_num_threads() == 4
        given.clear()
        network.counts(touches.spikes)
        assert given == [most]
