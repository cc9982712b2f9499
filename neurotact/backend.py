"""Which implementation runs: the compiled kernels where they exist and apply, else the reference; torch's settings."""

import math
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
THREADS = "OMP_NUM_THREADS"
"""The environment variable that sets the number of threads."""
SMALL = 2**15
"""Hidden neurons x windows of a batch below which a second thread gains at most a third; beside another process, where
threads wait for one another, it costs up to 27 times."""
_said_so = False


def hold_torch_to_avx2() -> None:
    """Let torch compute with AVX2 in place of AVX-512, so that a random seed gives the same network on both.

    Some of torch's operations (normal numbers, log-softmax, Adam) round their last bits differently with AVX-512, and
    hundreds of training steps turn these into another network. The compiled kernels round the same on both. Call this
    before torch is loaded: torch reads the variable then; worker processes inherit it. A value set by the user stays.
    """
    if native is not None and native.widest_isa() == "avx512":
        os.environ.setdefault(TORCH_INSTRUCTIONS, "avx2")


def n_threads(size: float = math.inf) -> int:
    """Threads for work of some size: one below `SMALL`, unless the user has chosen a number; it changes no result.

    size: hidden neurons x windows in a batch. The user chooses by $OMP_NUM_THREADS, or by `torch.set_num_threads` with
    another number than torch begins with: one for each core, or for each two that share one.
    """
    cores = {os.cpu_count() or 1, len(getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))(0))}
    given, torch = os.environ.get(THREADS, ""), sys.modules.get("torch")
    # Without torch, which takes a second to import: what it would begin with.
    n = torch.get_num_threads() if torch else int(given) if given.isdecimal() else min(cores)
    is_chosen = bool(given) or n not in {*cores, *(each // 2 for each in cores)}
    return 1 if size < SMALL and not is_chosen else max(1, n)


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
