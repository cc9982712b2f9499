"""Which implementation runs: the compiled kernels where they exist and apply, else the reference."""

import warnings
from typing import Literal, get_args

from neurotact.errors import InputError, nearest

Backend = Literal["auto", "native", "reference"]

try:
    from neurotact import _native as native
except ImportError:
    native = None

_said_so = False


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
