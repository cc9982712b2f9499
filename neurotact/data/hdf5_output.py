"""HDF5 files that are written through a Python file, so that a full disk ends in an error and not in a crash.

Where a write fails, libhdf5 fails again when the file is closed, and may then crash the process. So it never sees a
failure here: the first one is kept, what is written after it stays in memory, and the error is raised afterwards.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

PAGE = 4096
"""Bytes that are kept together of what could not be written."""


class Output(io.RawIOBase):
    """A new binary file at `path` whose writing never fails; `error` is the first failure that it met.

    What is written after an error is kept in memory and read back from there. Whoever writes much calls `check` in
    between, which raises the error.

    >>> import tempfile
    >>> with Output(Path(tempfile.mkdtemp()) / "a.bin") as file:
    ...     _ = file.write(b"felt"), file.seek(1)
    ...     file.read(2), file.error
    (b'el', None)
    """

    def __init__(self, path: Path) -> None:
        self.error: BaseException | None = None
        self._file = open(path, "w+b", buffering=0)  # noqa: SIM115 (closed by `close`)
        self._place = 0
        self._lost: dict[int, bytearray] = {}

    def check(self) -> None:
        """Raise the error that writing met, if any."""
        if self.error is not None:
            raise self.error

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        origin = {io.SEEK_SET: 0, io.SEEK_CUR: self._place, io.SEEK_END: self._end()}[whence]
        self._place = origin + offset
        return self._place

    def write(self, data) -> int:
        view = memoryview(data).cast("B")
        if self.error is None:
            try:
                self._write_to_disk(view)
            except BaseException as error:  # an interrupt, too, would be a failed write to the library
                self.error = error
        if self.error is not None:
            self._keep(view)
        self._place += len(view)
        return len(view)

    def readinto(self, buffer) -> int:
        view = memoryview(buffer).cast("B")
        n_bytes = min(len(view), max(0, self._end() - self._place))
        view = view[:n_bytes]
        if self._lost:
            view[:] = self._remembered(self._place, n_bytes)
        else:
            view[:] = self._from_disk(self._place, n_bytes)
        self._place += n_bytes
        return n_bytes

    def truncate(self, size: int | None = None) -> int:
        size = self._place if size is None else size
        if self.error is None:
            try:
                self._file.truncate(size)
            except BaseException as error:
                self.error = error
        return size

    def flush(self) -> None:
        """Nothing is held back; an Output is unbuffered."""

    def close(self) -> None:
        if not self.closed:
            self._lost.clear()
            try:
                self._file.close()
            except OSError as error:  # a network file system tells of a full disk here
                self.error = self.error or error
        super().close()

    def _write_to_disk(self, view: memoryview) -> None:
        self._file.seek(self._place)
        while len(view):
            view = view[self._file.write(view) :]

    def _keep(self, view: memoryview) -> None:
        """Write to the pages in memory."""
        place = self._place
        while len(view):
            number, first = divmod(place, PAGE)
            part = view[: PAGE - first]
            if number not in self._lost:
                self._lost[number] = bytearray(self._from_disk(number * PAGE, PAGE))
            self._lost[number][first : first + len(part)] = part
            place, view = place + len(part), view[len(part) :]

    def _remembered(self, place: int, n_bytes: int) -> bytes:
        """What was written, whether it is on the disk or in memory."""
        found = bytearray(self._from_disk(place, n_bytes))
        for number in range(place // PAGE, (place + n_bytes + PAGE - 1) // PAGE):
            page = self._lost.get(number)
            if page is not None:
                first, last = max(place, number * PAGE), min(place + n_bytes, (number + 1) * PAGE)
                found[first - place : last - place] = page[first - number * PAGE : last - number * PAGE]
        return bytes(found)

    def _from_disk(self, place: int, n_bytes: int) -> bytes:
        """What lies on the disk; zeros beyond its end."""
        self._file.seek(place)
        found = bytearray()
        while len(found) < n_bytes and (more := self._file.read(n_bytes - len(found))):
            found += more
        return bytes(found.ljust(n_bytes, b"\0"))

    def _end(self) -> int:
        end = self._file.seek(0, io.SEEK_END)
        return max([end, *((number + 1) * PAGE for number in self._lost)])


@contextmanager
def create(path: Path) -> Iterator[tuple[h5py.File, Output]]:
    """A new HDF5 file to write to, and what it is written through; OSError at the end where the disk did not take it.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "a.h5"
    >>> with create(path) as (file, output):
    ...     file["felt"] = [1, 2]
    ...     output.check()
    >>> h5py.File(path)["felt"][()].tolist()
    [1, 2]
    """
    with Output(path) as output, h5py.File(output, "w") as file:
        yield file, output
    output.check()
