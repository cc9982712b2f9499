"""Lists, tables, text and numbers from a file in Python's serialisation format, without executing it.

Such a file is a program. Here its opcodes are only inspected: those that build built-in values are interpreted; all
others, such as imports and calls, are refused.
"""

import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from neurotact.errors import InputError
from neurotact.files import read_bytes

MARK = object()
CONSTANTS = {
    "NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple,
}  # fmt: skip
VALUES = {
    "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT",
    "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8",
}  # fmt: skip
"""Opcodes whose argument is the value."""
IGNORED = {"PROTO", "FRAME", "STOP"}


def read_plain(path: str | Path) -> Any:
    """The content of a file of built-in values; InputError for any other; nothing is executed."""
    content = read_bytes(path)
    machine = _Machine()
    try:
        for opcode, argument, place in pickletools.genops(content):
            follow = machine.known(opcode.name)
            if follow is None:
                raise InputError(
                    f"{path}: holds more than lists, tables, text and numbers ({opcode.name} at byte {place}), which "
                    "could run any code; save plain values"
                )
            follow(argument)
        (value,) = machine.stack
    except InputError:
        raise
    except Exception as error:  # damaged bytes make the reader of opcodes raise nearly anything
        raise InputError(f"{path}: is damaged ({str(error)[:80] or type(error).__name__}); copy it again") from error
    return value


class _Machine:
    """The stack and the memory that the opcodes work on."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memory: dict[int, Any] = {}
        self.steps: dict[str, Callable[[Any], None]] = {
            "MARK": lambda _: self.stack.append(MARK),
            "APPEND": lambda _: self._extend(list, [self.stack.pop()]),
            "APPENDS": lambda _: self._extend(list, self._since_mark()),
            "LIST": lambda _: self.stack.append(self._since_mark()),
            "TUPLE": lambda _: self.stack.append(tuple(self._since_mark())),
            "SETITEM": lambda _: self._extend(dict, [self.stack.pop(-2), self.stack.pop()]),
            "SETITEMS": lambda _: self._extend(dict, self._since_mark()),
            "DICT": lambda _: self.stack.append(self._pairs(self._since_mark())),
            "MEMOIZE": lambda _: self._remember(len(self.memory)),
            **{f"TUPLE{n}": lambda _, n=n: self._tuple(n) for n in (1, 2, 3)},
            **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), self._remember),
            **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), self._recall),
        }

    def known(self, name: str) -> Callable[[Any], None] | None:
        """The action of an opcode on its argument; None for an opcode that is refused."""
        if name in VALUES:
            return self.stack.append
        if name in CONSTANTS:
            made = CONSTANTS[name]
            return lambda _: self.stack.append(made() if callable(made) else made)
        return (lambda _: None) if name in IGNORED else self.steps.get(name)

    def _since_mark(self) -> list[Any]:
        at = max(i for i, value in enumerate(self.stack) if value is MARK)
        found = self.stack[at + 1 :]
        del self.stack[at:]
        return found

    def _extend(self, kind: type, values: list[Any]) -> None:
        target = self.stack[-1]
        if type(target) is not kind:
            raise ValueError(f"it adds to a {type(target).__name__}")
        if kind is list:
            target.extend(values)
        else:
            target.update(self._pairs(values))

    @staticmethod
    def _pairs(values: list[Any]) -> dict[Any, Any]:
        return dict(zip(values[::2], values[1::2], strict=True))

    def _tuple(self, n: int) -> None:
        values = tuple(self.stack[-n:])
        del self.stack[-n:]
        self.stack.append(values)

    def _remember(self, place: Any) -> None:
        self.memory[int(place)] = self.stack[-1]

    def _recall(self, place: Any) -> None:
        self.stack.append(self.memory[int(place)])
