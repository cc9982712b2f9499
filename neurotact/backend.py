"""Which implementation runs: the compiled kernels where they exist and apply, else the reference; and torch's."""

import os
import warnings
from typing import Literal, get_args

from neurotact.errors import InputError, nearest

Backend = Literal["auto", "native", "reference"]

try:
    from neurotact import _native as native
except ImportError:
    native = None

TORCH_INSTRUCTIONS = "ATEN_CPU_CAPABILITY"
"""The environment variable by which torch chooses among its builds for a processor."""
_said_so = False


def hold_torch_to_avx2() -> None:
    """Let torch compute with AVX2 where it would take AVX-512, so that a random seed gives the same network on both.

    Some of torch's operations (normal numbers, log-softmax, Adam) round their last bits otherwise with AVX-512, and a
    training of hundreds of steps turns these into another network. The compiled kernels round alike on both. This comes
    before torch is loaded, which is when it reads the variable; spawned processes inherit it. A user's own value stays.
    """
    if native is not None and native.widest_isa() == "avx512":
        os.environ.setdefault(TORCH_INSTRUCTIONS, "avx2")


def use_native(backend: Backend, applies: bool, needs: str) -> bool:
    """Whether the compiled kernels run.

    `auto` takes them wherever they are compiled and `applies` holds, and says once where they are not compiled;
    `native` insists, with InputError where it cannot be; `needs` says what makes them apply.
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
