"""HDF5 files from any program: declared sizes are checked before anything is read.

A file of a few kilobytes can declare any size: of data that was never written, that inflates a thousand times, or of
rows that all point to one stretch of the file. So a dataset is checked before it is read, and rows of variable
length are read a few at a time.
"""

import errno
import json
import math
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from neurotact.data.readers.formats.contents import HDF5, MATLAB, content_of
from neurotact.data.recordings import check_text
from neurotact.errors import InputError, number_of
from neurotact.files import MAX_MB, check_size, existing, max_bytes

HEAP = b"GCOL\x01\0\0\0"
"""Signature and version of a global heap, and its reserved bytes."""
HEAP_WORDS = [np.uint32(int.from_bytes(HEAP[i : i + 4], "little")) for i in range(4)]
"""The possible aligned 4-byte words within a signature."""
BLOCK_BYTES = 2**20
"""Bytes of a block that is searched: few enough for a processor's cache."""
MOST_OBJECTS = 2**16 + 1
"""Objects of a heap, whose indices have 16 bits."""
FARTHEST = 2**62
NEAR_BYTES = 2**16
"""Of an object's header, so many bytes are searched for an attribute."""
REFERENCE = np.dtype([("length", "<u4"), ("heap", "<u8"), ("object", "<u4")])
"""An element of variable length in a dataset (HDF5 File Format Specification, VIII.D): what it refers to in a heap."""
STREAMED_RATIO = 50
"""Data read in pieces may exceed the limit on one input, but be at most this many times larger than its file."""
CACHE_BYTES = 32_000_000
"""Bytes of the adjacent chunks that one piece of a dataset needs."""
EVENTS = "events"
"""The kind of a file that declares none and holds spikes with labels, as the Heidelberg Digits do."""
MADE_BY = {"recordings": "simulate or import", "spikes": "encode", EVENTS: "import events"}
"""Kinds of files, and the commands that write them."""
TEXT_BYTES = 200
"""Memory of a short text, in a table that is copied twice."""
FILTERS = {
    h5py.h5z.FILTER_DEFLATE: "gzip",
    h5py.h5z.FILTER_SHUFFLE: "shuffle",
    h5py.h5z.FILTER_FLETCHER32: "fletcher32",
}
"""Accepted filters of chunks: their output size can be bounded before."""


def check_heaps(path: Path) -> None:
    """Refuse a file whose global heaps (texts and rows of variable length) libhdf5 would read for ever.

    A heap is a list of objects: index (2 bytes), references (2), reserved (4) and size (8 bytes), then the content. The
    free space has index 0 and its own header within its size; where a damaged file gives it the size 0, libhdf5 1.14
    never gets past it (HDF5 File Format Specification, III.E).
    """
    with path.open("rb") as file, path.open("rb", buffering=0) as holes:
        for start in _heaps(file, partial(_after_hole, holes.fileno())):
            _check_heap(file, start, path)


def _after_hole(descriptor: int, offset: int) -> int:
    """The next offset with data from `offset` on: a hole holds zeros, of any size, and need not be read."""
    try:
        return os.lseek(descriptor, offset, os.SEEK_DATA)
    except OSError as error:
        if error.errno == errno.ENXIO:  # only a hole is left, or nothing
            return os.lseek(descriptor, 0, os.SEEK_END)
    except AttributeError:
        pass
    return offset  # the system or the file system does not support holes


def _heaps(file: BinaryIO, after_hole: Callable[[int], int] = int) -> Iterator[int]:
    """The offsets of global heaps; a heap whose signature crosses two blocks may occur twice.

    A signature of 8 bytes at any offset covers an aligned word of 4 bytes: numpy finds such words three times faster
    than `bytes.find` finds signatures, and only blocks that hold one are searched.
    """
    offset = after_hole(0)
    file.seek(offset)
    while block := file.read(BLOCK_BYTES):
        words = np.frombuffer(block, "<u4", len(block) // 4)
        if any((words == word).any() for word in HEAP_WORDS):
            first = max(0, offset - len(HEAP) + 1)
            file.seek(first)
            content = file.read(offset + len(block) + len(HEAP) - 1 - first)
            begin = content.find(HEAP)
            while begin >= 0:
                yield first + begin
                begin = content.find(HEAP, begin + len(HEAP))
        offset = after_hole(offset + len(block))
        file.seek(offset)


def _check_heap(file: BinaryIO, start: int, path: Path) -> None:
    position, end = start + 16, start + _number(file, start + 8, 8)
    for _ in range(MOST_OBJECTS):
        if position + 16 > end:
            return
        index, size = _number(file, position, 2), _number(file, position + 8, 8)
        if index == 0 and size < 16:
            break
        position += size if index == 0 else 16 + -(-size // 8) * 8
    raise OSError(f"the heap at byte {start} of {path.name} is damaged")


def _number(file: BinaryIO, position: int, n_bytes: int) -> int:
    file.seek(min(position, FARTHEST))
    return int.from_bytes(file.read(n_bytes), "little")


@contextmanager
def _open(path: str | Path) -> Iterator[h5py.File]:
    existing_path = existing(path)
    check_heaps(existing_path)
    with h5py.File(existing_path, "r") as file:
        yield file


@contextmanager
def opened(path: str | Path, *kinds: str) -> Iterator[tuple[h5py.File, str]]:
    """The file at `path`, open for reading, and which of `kinds` it holds.

    Raises InputError for a file that is truncated, not HDF5 or of another kind. A read error within the block is
    reported as a damaged file.
    """
    what, command = " or ".join([kind for kind in kinds if kind != EVENTS] or kinds), f"neurotact {MADE_BY[kinds[0]]}"
    with reading(path, what, command) as file:
        unsaid = EVENTS if "spikes" in file and "labels" in file else ""
        named = attribute(file, "kind", path) if "kind" in file.attrs else unsaid
        if named not in kinds:
            raise InputError(f"{path}: holds {_shown(named) or 'something else'}, not {what}; make one with {command}")
        yield file, named


@contextmanager
def reading(path: str | Path, what: str, command: str) -> Iterator[h5py.File]:
    """The file at `path`, open for reading; a read error becomes an InputError that names the fix."""
    try:
        with _open(path) as file:
            yield file
    except InputError:
        raise
    except (OSError, LookupError, ValueError, TypeError, RuntimeError, AttributeError, MemoryError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0].strip("'\"")
        reason = reason if h5py.is_hdf5(path) else "it is not HDF5"
        kind = content_of(path)
        if kind is not None and kind not in (HDF5, MATLAB):
            raise kind.refusal(path, f"HDF5 and cannot be read as {what}", f"write it again with {command}") from error
        raise InputError(
            f"{path}: cannot be read as {what} ({_shown(reason)}); write it again with {command}"
        ) from error


def own_members(group: h5py.Group) -> Iterator[tuple[str, Any]]:
    """The members of a group by their names, without links, which could lead to any other file."""
    return ((name, group[name]) for name in group if isinstance(group.get(name, getlink=True), h5py.HardLink))


def attribute(holder: h5py.Group, name: str, path: str | Path) -> Any:
    """One attribute of a file or a group; InputError for a text that is not UTF-8, KeyError if it is absent."""
    attr = h5py.h5a.open(holder.id, name.encode())
    if attr.shape != ():
        raise ValueError(f"{name} is not a single value")
    check_size(path, attr.dtype.itemsize)
    if attr.dtype.hasobject:
        _check_text_length(holder, name, Path(path))
    value = holder.attrs[name]
    if isinstance(value, bytes):
        value = _decoded(value, f"{path}: {name}")
    if isinstance(value, str):
        check_text(value, f"{path}: {name}")
    return value


def _check_text_length(holder: h5py.Group, name: str, path: Path) -> None:
    """Refuse a text that is longer than its file: libhdf5 takes the memory before it looks for the text.

    An attribute's message has version 1, a reserved byte, and the sizes of its name, type and space (2 bytes each),
    then these, each padded to 8 bytes, then its text's length (4 bytes) and place (HDF5 File Format Specification,
    IV.A.2.m). Other versions are not looked at.
    """
    with path.open("rb") as file:
        file.seek(h5py.h5o.get_info(holder.id).addr)
        near = file.read(NEAR_BYTES)
    said = len(name.encode()) + 1
    head = b"\x01\0" + said.to_bytes(2, "little")
    position = near.find(name.encode() + b"\0")
    while position >= 0:
        if near[max(0, position - 8) :].startswith(head):
            sizes = (said, *(int.from_bytes(near[position - n : position - n + 2], "little") for n in (4, 2)))
            start = position + sum(-(-size // 8) * 8 for size in sizes)
            if int.from_bytes(near[start : start + 4], "little") > path.stat().st_size:
                raise OSError(f"the length of {name} is damaged")
        position = near.find(name.encode() + b"\0", position + 1)


def table(text: Any, kind: type) -> Any:
    """The value of a JSON attribute; ValueError unless it is of the expected kind.

    >>> table('["taxel1"]', list)
    ['taxel1']
    """
    value = json.loads(text)
    if not isinstance(value, kind):
        raise ValueError(f"holds {_shown(text)} where a {'table' if kind is dict else kind.__name__} is expected")
    return value


def names(text: Any) -> tuple[str, ...]:
    """The names in a JSON attribute; each is valid UTF-8."""
    labels = table(text, list)
    for name in labels:
        if not isinstance(name, str):
            raise ValueError(f"holds {_shown(name)} where a name is expected")
        name.encode()
    return tuple(labels)


class Declared:
    """The datasets of an open file; each is checked before it is read, and so is their total.

    path: of the file, for messages.

    Its methods raise InputError for data that is too large, and KeyError, TypeError or ValueError for data that is
    absent or of another kind.
    """

    def __init__(self, file: h5py.File, path: str | Path) -> None:
        self.file = file
        self.path = path
        self._file_bytes = Path(path).stat().st_size
        self._read_bytes = 0

    def numbers(self, name: str, kinds: str = "iuf") -> np.ndarray:
        """A dataset of one number per trial, `(trial,)`; `kinds` of numpy."""
        dataset = self._dataset(name, kinds, 1)
        self._reserve(dataset.size * dataset.dtype.itemsize)
        return dataset[()]

    def rows(self, name: str, kinds: str) -> list[np.ndarray]:
        """A dataset of rows of variable length, one per trial."""
        dataset = self._dataset(name, "O", 1)
        base = h5py.check_vlen_dtype(dataset.dtype)
        if not isinstance(base, np.dtype) or base.kind not in kinds:
            raise TypeError(f"{name} does not hold rows of numbers")
        self._reserve(dataset.size * dataset.dtype.itemsize)
        parts: list[np.ndarray] = []
        for part in self._parts(dataset):
            self._reserve(sum(row.nbytes for row in part))
            parts.extend(part)
        return parts

    def texts(self, name: str) -> list[str]:
        """A dataset of UTF-8 texts, one per trial."""
        dataset = self._dataset(name, "OS", 1)
        if not h5py.check_string_dtype(dataset.dtype):
            raise TypeError(f"{name} does not hold texts")
        self._reserve(dataset.size * (dataset.dtype.itemsize + TEXT_BYTES))
        decoded: list[str] = []
        for part in self._parts(dataset):
            self._reserve(4 * sum(map(len, part)))
            decoded.extend(_decoded(text, f"{self.path}: {name}") if isinstance(text, bytes) else text for text in part)
        return decoded

    def value(self, name: str) -> Any:
        """A dataset of numbers of any shape as an array, or of texts as a text or an array of them."""
        dataset = self._dataset(name, "iufbOS", None)
        if dataset.dtype.kind in "iufb":
            self._reserve(dataset.size * dataset.dtype.itemsize)
            return dataset[()]
        if not h5py.check_string_dtype(dataset.dtype):
            raise TypeError(f"{name} holds neither numbers nor texts")
        self._reserve(dataset.size * (dataset.dtype.itemsize + TEXT_BYTES))
        parts = [] if dataset.ndim else [np.array(dataset[()], object)]
        for part in self._parts(dataset) if dataset.ndim else parts:
            self._reserve(4 * sum(map(len, part.ravel())))
            parts += [part] if dataset.ndim else []
        texts = np.concatenate(parts) if dataset.ndim else parts[0]
        decoded = [_decoded(text, f"{self.path}: {name}") for text in texts.ravel()]
        return np.array(decoded, object).reshape(dataset.shape) if dataset.ndim else decoded[0]

    def column(self, name: str, n_trials: int) -> list[str] | np.ndarray:
        """A dataset of texts or of numbers, one per trial."""
        dataset = self._dataset(name, "OSiufb", 1)
        if len(dataset) != n_trials:
            rows = number_of(len(dataset), "row of conditions")
            raise InputError(f"{self.path}: {number_of(n_trials, 'trial')} but {rows} in {name}; write it again")
        return self.texts(name) if dataset.dtype.kind in "OS" else self.numbers(name, "iufb")

    def records(self, name: str, fields: Sequence[str]) -> np.ndarray:
        """A dataset of records, each of a number in every one of these fields, `(record,)`."""
        dataset = self._dataset(name, "V", 1)
        held = dataset.dtype.fields or {}
        if [*held] != [*fields] or any(its[0].kind not in "iuf" for its in held.values()):
            raise TypeError(f"{name} does not hold records of the numbers {', '.join(fields)}")
        self._reserve(dataset.size * dataset.dtype.itemsize)
        return dataset[()]

    def holds(self, name: str) -> bool:
        """Whether this file itself has an object of that name."""
        try:
            self._found(name)
        except KeyError:
            return False
        return True

    def group(self, name: str) -> h5py.Group:
        """A group of this file itself."""
        holder = self._found(name)
        if not isinstance(holder, h5py.Group):
            raise TypeError(f"{name} is not a group")
        return holder

    def streamed(self, name: str, kinds: str = "iuf") -> h5py.Dataset:
        """A dataset of numbers that is read in pieces of rows, `(sample, ...)`, however large it is."""
        dataset = self._dataset(name, kinds, None)
        declared = dataset.size * dataset.dtype.itemsize
        if declared > max(STREAMED_RATIO * self._file_bytes, max_bytes()):
            raise InputError(
                f"{self.path}: {name} declares {declared / 1e6:,.0f} MB in a file of {self._file_bytes / 1e6:,.1f} MB; "
                f"write it again, or set {MAX_MB}=... if it is right"
            )
        chunk = dataset.chunks
        if chunk is None:
            return dataset
        side_by_side = [math.ceil(n / k) * k for n, k in zip(dataset.shape[1:], chunk[1:], strict=True)]
        needed = chunk[0] * math.prod(side_by_side) * dataset.dtype.itemsize
        access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
        access.set_chunk_cache(521, needed, 1.0)
        return h5py.Dataset(h5py.h5d.open(self.file.id, name.encode(), access))

    def _found(self, name: str) -> Any:
        """The object of that name in this file itself: a link could lead to any other file."""
        parts = name.split("/")
        for depth in range(1, len(parts) + 1):
            link = self.file.get("/".join(parts[:depth]), getlink=True)
            if not isinstance(link, h5py.HardLink):
                raise KeyError(f"{name} is not in the file")
        return self.file[name]

    def _dataset(self, name: str, kinds: str, n_dims: int | None) -> h5py.Dataset:
        """The dataset called `name`, in this file itself and of a layout with a bounded size."""
        dataset = self._found(name)
        if not isinstance(dataset, h5py.Dataset) or dataset.shape is None:
            raise TypeError(f"{name} is not a dataset")
        if dataset.external or dataset.is_virtual:
            raise ValueError(f"{name} lies in another file")
        if dataset.dtype.kind not in kinds:
            raise TypeError(f"{name} holds {_shown(dataset.dtype)}")
        if n_dims is not None and dataset.ndim != n_dims:
            raise ValueError(f"{name} has the shape {dataset.shape} where (trial,) is expected")
        if dataset.chunks is not None:
            self._check_chunks(dataset, name)
        if dataset.dtype.hasobject:
            self._check_lengths(dataset, name)
        return dataset

    def _check_chunks(self, dataset: h5py.Dataset, name: str) -> None:
        """Refuse chunks that are large, or that inflate to more than they declare."""
        element = REFERENCE if dataset.dtype.hasobject else dataset.dtype
        chunk_bytes = math.prod(dataset.chunks) * element.itemsize
        across = math.prod(math.ceil(n / k) for n, k in zip(dataset.shape[1:], dataset.chunks[1:], strict=True))
        if chunk_bytes * across > CACHE_BYTES:
            raise InputError(
                f"{self.path}: {name} is stored in chunks of {chunk_bytes * across / 1e6:,.0f} MB, more than "
                f"{CACHE_BYTES / 1e6:,.0f} MB; store it in smaller chunks, or in none"
            )
        filters = _filters(dataset)
        if any(code not in FILTERS for code in filters) or len(set(filters)) < len(filters):
            raise InputError(
                f"{self.path}: {name} is compressed in a way that neurotact does not read; "
                f"store it with gzip or without compression"
            )
        if h5py.h5z.FILTER_DEFLATE in filters and not all(
            _inflates_within(dataset, chunk, chunk_bytes) for chunk in _places(dataset)
        ):
            raise InputError(f"{self.path}: {name} inflates to more than it declares; write it again")

    def _check_lengths(self, dataset: h5py.Dataset, name: str) -> None:
        """Refuse a text or row that is longer than its file: libhdf5 takes the memory before it looks for it."""
        numbers = h5py.check_vlen_dtype(dataset.dtype)
        item_bytes = numbers.itemsize if isinstance(numbers, np.dtype) else 1
        for stored in self._stored(dataset):
            lengths = np.frombuffer(stored, REFERENCE, count=len(stored) // REFERENCE.itemsize)["length"]
            if len(lengths) and int(lengths.max()) * item_bytes > self._file_bytes:
                raise OSError(f"the length of {name} is damaged")

    def _stored(self, dataset: h5py.Dataset) -> Iterator[bytes]:
        """What the file holds of a dataset of variable length: references to a heap, without filters."""
        if dataset.chunks is None:
            offset = dataset.id.get_offset()
            if offset is not None:
                with Path(self.path).open("rb") as file:
                    file.seek(offset)
                    yield file.read(dataset.id.get_storage_size())
            return
        filters = _filters(dataset)
        for chunk in _places(dataset):
            mask, content = dataset.id.read_direct_chunk(chunk.chunk_offset)
            if h5py.h5z.FILTER_DEFLATE in filters and not mask:
                content = zlib.decompress(content)
            if h5py.h5z.FILTER_SHUFFLE in filters and not mask:
                width = REFERENCE.itemsize
                content = (
                    np.frombuffer(content, np.uint8)[: len(content) // width * width].reshape(width, -1).T.tobytes()
                )
            yield content

    def _parts(self, dataset: h5py.Dataset) -> Iterator[np.ndarray]:
        """Its rows, in parts that fit in memory even if each row is as large as the whole file."""
        at_once = max(1, max_bytes() // max(self._file_bytes, 1))
        for start in range(0, len(dataset), at_once):
            yield dataset[start : start + at_once]

    def _reserve(self, n_bytes: int) -> None:
        self._read_bytes += n_bytes
        check_size(self.path, self._read_bytes)


def _decoded(text: bytes, what: str) -> str:
    try:
        return text.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{what} holds {_shown(text[:80])}, which is not UTF-8; rename it") from error


def _filters(dataset: h5py.Dataset) -> list[int]:
    """The codes of the filters through which its chunks are stored, in their order."""
    plan = dataset.id.get_create_plist()
    return [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]


def _places(dataset: h5py.Dataset) -> list[Any]:
    """Where its chunks are stored."""
    places: list[Any] = []
    dataset.id.chunk_iter(places.append)
    return places


def _inflates_within(dataset: h5py.Dataset, chunk: Any, n_bytes: int) -> bool:
    """Whether a gzip chunk holds no more than `n_bytes` and the checksum, which may be inside or after it."""
    if chunk.size > 2 * n_bytes + 1000:
        return False
    mask, content = dataset.id.read_direct_chunk(chunk.chunk_offset)
    if mask:  # a filter was skipped for this chunk: it is stored as it is
        return True
    inflater, left = zlib.decompressobj(), n_bytes + 4
    try:
        while content and left >= 0:
            left -= len(inflater.decompress(content, min(left + 1, 1 << 20)))
            content = inflater.unconsumed_tail
    except zlib.error as error:
        raise ValueError(f"a chunk is damaged: {error}") from error
    return left >= 0


def _shown(value: Any) -> str:
    """An external value, in printable characters and of a readable length."""
    text = str(value)[:200]
    return text if text.isprintable() and text.isascii() else ascii(text)
