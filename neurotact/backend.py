"""Which implementation runs: the compiled kernels where they exist and apply, else the reference; torch's settings."""

import os
import sys
import warnings
from typing import Literal, get_args

from neurotact.errors import InputError, nearest

Backend = Literal["auto", "native", "reference"]

try:
    from neurotact import _native as native
except ImportError:
    native = None

TORCH_INSTRUCTIONS = "ATEN_CPU_CAPABILITY"
"""The environment variable that selects torch's instruction set."""
_said_so = False


def hold_torch_to_avx2() -> None:
    """Let torch compute with AVX2 in place of AVX-512, so that a random seed gives the same network on both.

    Some of torch's operations (normal numbers, log-softmax, Adam) round their last bits differently with AVX-512, and
    hundreds of training steps turn these into another network. The compiled kernels round the same on both. Call this
    before torch is loaded: torch reads the variable then; worker processes inherit it. A value set by the user stays.
    """
    if native is not None and native.widest_isa() == "avx512":
        os.environ.setdefault(TORCH_INSTRUCTIONS, "avx2")


def n_threads() -> int:
    """Threads of a kernel: torch's where it is loaded; else $OMP_NUM_THREADS or one per core, as torch would begin."""
    if "torch" in sys.modules:
        return sys.modules["torch"].get_num_threads()
    given = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, int(given)) if given.isdecimal() else os.cpu_count() or 1


def use_native(backend: Backend, applies: bool, needs: str) -> bool:
    """Whether the compiled kernels run.

    `auto` uses them if they are compiled and `applies` holds, and warns once if they are not compiled;
    `native` requires them, with InputError if they cannot run; `needs` is the condition for them to apply, in words.
    """
    if backend not in get_args(Backend):
        raise InputError(f"backend: '{backend}' is unknown; {nearest(backend, get_args(Backend))}")
    if backend == "native" and not applies:
        raise InputError(f"backend: 'native' needs {needs}; use 'auto' or 'reference'")
    if backend == "native" and native is None:
        raise InputError("backend: 'native' is not compiled here; install a C++ compiler and reinstall neurotact")
    if backend == "auto" and native is None and applies:
        _warn_once()
    return backend != "reference" and applies and native is not None


def _warn_once() -> None:
    global _said_so
    if not _said_so:
        _said_so = True
        warnings.warn(
            "neurotact runs without its compiled kernels, some tens of times slower; "
            "install a C++ compiler and reinstall neurotact to get them",
            RuntimeWarning,
            stacklevel=4,
        )
