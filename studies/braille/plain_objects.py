"""Lists, tables, text and numbers from a pickle, which is a program: one that does anything else is not run."""

import io
import pickle
import pickletools
from pathlib import Path
from typing import Any

from neurotact.errors import InputError
from neurotact.files import read_bytes

VALUES = {
    "PROTO", "FRAME", "STOP", "MARK", "NONE", "NEWTRUE", "NEWFALSE", "EMPTY_LIST", "EMPTY_DICT", "EMPTY_TUPLE",
    "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT",
    "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "APPEND", "APPENDS", "LIST", "TUPLE", "TUPLE1",
    "TUPLE2", "TUPLE3", "SETITEM", "SETITEMS", "DICT", "MEMOIZE", "GET", "BINGET", "LONG_BINGET",
}  # fmt: skip
"""Opcodes that make built-in values and nothing else."""
REMEMBERED = {"PUT", "BINPUT", "LONG_BINPUT"}
"""Opcodes that number a value."""


class _Plain(pickle.Unpickler):
    """Refuses every name, should an opcode be able to ask for one."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        raise pickle.UnpicklingError(f"it names {module_name}.{global_name}")


def read_plain(path: str | Path) -> Any:
    """The content of a pickle of built-in values; InputError for any other, of which nothing is executed."""
    content = read_bytes(path)
    try:
        for opcode, argument, offset in pickletools.genops(content):
            if opcode.name not in VALUES | REMEMBERED:
                raise InputError(
                    f"{path}: holds more than lists, tables, text and numbers ({opcode.name} at byte {offset}), which "
                    "could run any code; save plain values"
                )
            if opcode.name in REMEMBERED and int(str(argument)) > len(content):  # memory for as many would be taken
                raise ValueError(f"it numbers a value {argument}")
        return _Plain(io.BytesIO(content)).load()
    except InputError:
        raise
    except Exception as error:  # damaged bytes make pickle raise nearly anything
        raise InputError(f"{path}: is damaged ({str(error)[:80] or type(error).__name__}); copy it again") from error
