"""Variables of MATLAB files: matrices of numbers, texts, cell arrays and structures of them; nothing else is loaded.

scipy's loadmat is not used: it ends the process on some damaged files, and inflates what exceeds the memory.
"""

import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from neurotact.data.hdf5_input import Declared, attribute, own_members, reading
from neurotact.data.readers.formats import Arrays, Cells, Format
from neurotact.data.readers.formats.contents import HDF5, MATLAB
from neurotact.errors import InputError
from neurotact.files import check_size

FORM, FIX = "a MATLAB file of version 5 or later", "save it in MATLAB with -v7"
HEADER_BYTES = 128
ORDERS = {b"IM": "<", b"MI": ">"}
"""Byte orders by the end of the header."""
MATRIX, COMPRESSED = 14, 15
"""Types of the elements of a file."""
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of numbers in an element; those of a matrix of another class are cast."""
ENCODINGS = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
CELL, STRUCT, CHARACTERS, OPAQUE, COMPLEX = 1, 2, 4, 17, 0x800
"""Classes of matrices, of which an opaque one holds an object such as a table, and the flag of complex numbers."""
CLASSES = {
    6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8",
}  # fmt: skip
"""Classes of matrices of numbers. (All of these: MAT-File Format, MathWorks, for versions 5 to 7.)"""
PIECE_BYTES = 2**20
CHARACTER_BYTES = 100
"""Memory of a character while it is read."""

Value = np.ndarray | Cells | dict[str, "Value"] | None
"""A variable, a structure by its fields; None if it is of a class that is not read."""
DEEPEST = 4
"""Depth of structures and cells within one another."""


def _read(path: Path) -> Arrays:
    """The variables of a file: `save` writes version 7, or with `-v7.3` HDF5.

    Vectors have one axis, whether they were rows or columns. A cell array of texts is an array of texts, as is a matrix
    of characters, row by row; one of single numbers is an array of numbers. A field of a structure is named
    `rig/speed`; that of an array of structures is a cell array. Others, such as tables, are not read.
    """
    read = _from_hdf5(path) if h5py.is_hdf5(path) else _from_binary(path)
    variables = {name: value for own, held in read.items() for name, value in _fields(own, held)}
    filled = {name: values for name, values in variables.items() if isinstance(values, np.ndarray) and values.size}
    arrays = {name: values.ravel() if _is_vector(values) else values for name, values in filled.items()}
    cells = {name: values for name, values in variables.items() if isinstance(values, list)}
    others = [name for name in variables if name not in arrays and name not in cells]
    if not (arrays or cells):
        held = f" ({', '.join(others[:5])})" if others else ""
        raise InputError(
            f"{path}: holds neither matrices of numbers nor texts{held}; save matrices, as in save('touch.mat', 'data')"
        )
    return Arrays(arrays, cells, others)


def _fields(name: str, value: Value) -> Iterator[tuple[str, Value]]:
    """A variable, or each field of a structure, with its name."""
    if isinstance(value, dict) and value:
        for field, held in value.items():
            yield from _fields(f"{name}/{field}", held)
    else:
        yield name, value


def _is_vector(values: np.ndarray) -> bool:
    return values.ndim == 2 and 1 in values.shape


def _of_cells(path: Path, values: Iterable[Value]) -> Value:
    """The texts, the single numbers or the matrices of numbers of a cell array; None if it holds anything else."""
    cells, n_bytes = [], 0
    for value in values:
        cells.append(value)
        n_bytes += value.nbytes if isinstance(value, np.ndarray) else 0
        check_size(path, n_bytes)
    filled = [cell for cell in cells if isinstance(cell, np.ndarray) and cell.size]
    if not filled or len(filled) < len(cells):
        return None
    kinds, is_single = {cell.dtype.kind for cell in filled}, all(cell.size == 1 for cell in filled)
    if kinds == {"U"} and is_single:
        return np.array([str(cell.item()) for cell in filled])
    if not kinds <= {*"iufb"}:
        return None
    if is_single:
        return np.array([cell.item() for cell in filled])
    return [cell.ravel() for cell in filled] if all(_is_vector(cell) for cell in filled) else filled


def _rows_of(characters: Sequence[str], shape: tuple[int, ...]) -> np.ndarray:
    """The texts of a matrix of characters, without the spaces that fill them up."""
    rows = np.array(characters).reshape(shape, order="F").reshape(shape[0], -1)
    return np.array(["".join(row).rstrip() for row in rows])


def _from_binary(path: Path) -> dict[str, Value]:
    """The variables of a file of version 5 to 7. (scipy's loadmat ends the process on some damaged files.)"""
    content = memoryview(path.read_bytes())
    order = ORDERS.get(bytes(content[126:HEADER_BYTES]))
    if order is None:
        raise InputError(f"{path}: is not {FORM}; {FIX}")
    return _Binary(path, order).variables(content[HEADER_BYTES:])


class _Binary(NamedTuple):
    """A file of elements: a type, a length, and the content, which of a matrix is again a row of elements."""

    path: Path
    order: str

    def variables(self, content: memoryview) -> dict[str, Value]:
        """The variables by name."""
        variables: dict[str, Value] = {}
        n_bytes = len(content)
        while len(content):
            kind, size = struct.unpack(f"{self.order}II", content[:8])
            inside, content = content[8 : 8 + size], content[8 + size :]
            if len(inside) < size:
                raise ValueError("it was cut off")
            if kind == COMPRESSED:
                inside = self._inflated(inside, n_bytes)
                n_bytes += len(inside)
                kind, inside, _ = self._element(inside)
            if kind == MATRIX:
                name, values = self._matrix(inside)
                if name.isidentifier():  # what functions and objects need has no name
                    variables[name] = values
        return variables

    def _inflated(self, content: memoryview, n_bytes: int) -> memoryview:
        """The content of a compressed element; n_bytes: of all others."""
        stream, parts = zlib.decompressobj(), []
        for begin in range(0, len(content), PIECE_BYTES):
            piece = bytes(content[begin : begin + PIECE_BYTES])
            while part := stream.decompress(piece, PIECE_BYTES):
                parts.append(part)
                n_bytes += len(part)
                check_size(self.path, n_bytes)
                piece = stream.unconsumed_tail
        if not stream.eof:
            raise ValueError("it was cut off")
        return memoryview(b"".join(parts))

    def _element(self, content: memoryview) -> tuple[int, memoryview, memoryview]:
        """The type and the content of the first element, and the elements after it."""
        (kind,) = struct.unpack(f"{self.order}I", content[:4])
        if kind >> 16:  # no longer than four bytes: type and length share a word
            return kind & 0xFFFF, content[4 : 4 + min(kind >> 16, 4)], content[8:]
        (size,) = struct.unpack(f"{self.order}I", content[4:8])
        if size > len(content) - 8:
            raise ValueError("it was cut off")
        return kind, content[8 : 8 + size], content[8 + size + -size % 8 :]

    def _matrix(self, content: memoryview) -> tuple[str, Value]:
        _, flags, content = self._element(content)
        (flag,) = struct.unpack(f"{self.order}I", flags[:4])
        if flag & 0xFF == OPAQUE:
            return bytes(self._element(content)[1]).decode("ascii"), None
        _, sides, content = self._element(content)
        _, name, content = self._element(content)
        shape = tuple(np.frombuffer(sides, f"{self.order}i4").tolist())
        if len(shape) < 2 or min(shape) < 0:
            raise ValueError("a matrix has no size")
        return bytes(name).decode("ascii"), self._values(flag, shape, content)

    def _cells(self, size: int, content: memoryview) -> Iterator[Value]:
        for _ in range(size):
            _, inside, content = self._element(content)
            yield self._matrix(inside)[1]

    def _values(self, flag: int, shape: tuple[int, ...], content: memoryview) -> Value:
        kind, size = flag & 0xFF, math.prod(shape)
        if kind == CELL:
            return _of_cells(self.path, self._cells(size, content))
        if kind == STRUCT:
            _, length, content = self._element(content)
            _, words, content = self._element(content)
            (width,) = struct.unpack(f"{self.order}i", length)
            fields = [
                bytes(words[at : at + width]).split(b"\0")[0].decode("ascii") for at in range(0, len(words), width)
            ]
            values = [*self._cells(size * len(fields), content)]
            every = {field: values[place :: len(fields)] for place, field in enumerate(fields)}
            return {field: own[0] if size == 1 else _of_cells(self.path, own) for field, own in every.items()}
        if flag & COMPLEX or kind not in (*CLASSES, CHARACTERS):
            return None
        stored, values, _ = self._element(content)
        if kind == CHARACTERS:
            check_size(self.path, CHARACTER_BYTES * len(values))
            if stored in ENCODINGS:
                text = str(values, ENCODINGS[stored], "replace")
            else:
                text = "".join(map(chr, np.frombuffer(values, self.order + STORED[stored]).tolist()))
            return _rows_of([*text], shape) if size else None
        check_size(self.path, size * np.dtype(CLASSES[kind]).itemsize)
        numbers = np.frombuffer(values, self.order + STORED[stored]).reshape(shape, order="F")
        with np.errstate(all="ignore"):
            return numbers.astype(CLASSES[kind])


def _from_hdf5(path: Path) -> dict[str, Value]:
    """The variables of a file of version 7.3, which stores each matrix with its axes in the opposite order."""
    with reading(path, "a MATLAB file", "save in MATLAB") as file:
        declared = Declared(file, path)
        return _members(declared, file, 0)


def _members(declared: Declared, group: h5py.Group, depth: int) -> dict[str, Value]:
    """The variables of a file, or the fields of a structure."""
    return {name: _of_dataset(declared, its, depth) for name, its in own_members(group) if name.isidentifier()}


def _of_dataset(declared: Declared, dataset: Any, depth: int) -> Value:
    """Numbers, texts, cells or fields; None for anything else, and for an empty matrix, whose sizes are stored."""
    if depth > DEEPEST:
        return None
    if isinstance(dataset, h5py.Group):
        return _members(declared, dataset, depth + 1)
    if not isinstance(dataset, h5py.Dataset) or dataset.name is None or "MATLAB_empty" in dataset.attrs:
        return None
    kind = attribute(dataset, "MATLAB_class", declared.path) if "MATLAB_class" in dataset.attrs else "double"
    if kind == "cell" or h5py.check_ref_dtype(dataset.dtype) is h5py.Reference:
        check_size(declared.path, dataset.size * dataset.dtype.itemsize)
        cells = (_of_dataset(declared, declared.file[reference], depth + 1) for reference in dataset[()].ravel())
        return _of_cells(Path(declared.path), cells)
    if kind in ("struct", "function_handle") or dataset.dtype.kind not in "iufb":
        return None
    values = np.asarray(declared.value(dataset.name.lstrip("/"))).T
    return _rows_of([*map(chr, values.ravel(order="F"))], values.shape) if kind == "char" else values


FORMAT = Format(FORM, FIX, _read, "arrays", (MATLAB, HDF5))
