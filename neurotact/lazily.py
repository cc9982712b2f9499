"""Modules that are loaded when they are first used, so that a command imports what it uses."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from threading import RLock
from types import ModuleType
from typing import Any

PUT_OFF = ("neurotact.", "neurotact_parts.")
"""Where the modules begin whose loading is put off, beside pandas. Another package may need its own at once."""
KNOWN = {"__class__", "__file__", "__loader__", "__name__", "__package__", "__spec__"}
"""What is known of a module before it is loaded: the import system asks for it. `__path__` is not among it, so that a
package is loaded before its modules: where parts of pandas come first, it crashes the process."""


class _Late(ModuleType):
    """A module that is loaded when anything else than `KNOWN` is asked for or set; other threads wait until it is."""

    def __getattribute__(self, name: str) -> Any:
        if name not in KNOWN:
            _load(self)
        return ModuleType.__getattribute__(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in KNOWN:
            _load(self)  # which would set it back later
        ModuleType.__setattr__(self, name, value)


def _load(module: ModuleType) -> None:
    late = object.__getattribute__(module, "__loader__")
    if not isinstance(late, _LateLoader):  # another thread has loaded it
        return
    with late.lock:
        if not late.has_begun:
            late.has_begun = True
            late.load(module)


class _LateLoader(Loader):
    def __init__(self, loader: Loader) -> None:
        self.loader, self.lock, self.has_begun = loader, RLock(), False

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__class__ = _Late

    def load(self, module: ModuleType) -> None:
        spec = module.__spec__
        assert spec is not None
        spec.loader = self.loader
        try:
            self.loader.exec_module(module)
        except BaseException:
            self.has_begun = False  # the next use tries again
            raise
        module.__loader__, module.__class__ = self.loader, ModuleType


class _Finder(MetaPathFinder):
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> Any:
        if fullname != "pandas" and not fullname.startswith(PUT_OFF):
            return None
        others = [finder for finder in sys.meta_path if not isinstance(finder, _Finder)]
        spec = next(filter(None, (finder.find_spec(fullname, path, target) for finder in others)), None)
        if spec is not None and spec.loader is not None:
            spec.loader = _LateLoader(spec.loader)
        return spec


def load_all() -> None:
    """Load every module that is put off, and those that they put off."""
    while late := [module for module in list(sys.modules.values()) if type(module) is _Late]:
        for module in late:
            vars(module)


@contextmanager
def lazily() -> Iterator[None]:
    """Our modules, and pandas, that are imported within it are loaded when something of theirs is first used.

    Import whole modules there; a name of theirs loads its module at once. In annotations, such names stand in quotes.

    >>> with lazily():
    ...     import pandas as pd
    >>> pd.DataFrame({"speed": [300, 450]}).shape
    (2, 1)
    """
    finder = _Finder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
