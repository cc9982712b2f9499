"""The command line trains the same network on processors with and without AVX-512."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
from levels import thinned

from neurotact import backend
from neurotact.networks.definition import native

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
