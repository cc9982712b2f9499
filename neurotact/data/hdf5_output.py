"""HDF5 files that are written through a Python file, so that a full disk gives an error and not a crash.

If a write fails, libhdf5 fails again when the file is closed, and may then crash the process. So failures are hidden
from it: the first one is kept, later writes stay in memory, and the error is raised at the end.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

PAGE = 4096
"""Page size of the data that could not be written."""


class Output(io.RawIOBase):
    """A new binary file at `path` whose writes never fail; `error` is the first failure.

    Data written after an error is kept in memory and read back from there. Call `check` during long writes: it raises
    the error.

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
        """Raise the first error of a write, if any."""
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
            except BaseException as error:  # the library would take an interrupt for a failed write, too
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
        """Does nothing: an Output is unbuffered."""

    def close(self) -> None:
        if not self.closed:
            self._lost.clear()
            try:
                self._file.close()
            except OSError as error:  # a network file system reports a full disk here
                self.error = self.error or error
        super().close()

    def _write_to_disk(self, view: memoryview) -> None:
        self._file.seek(self._place)
        while len(view):
            view = view[self._file.write(view) :]

    def _keep(self, view: memoryview) -> None:
        """Write to the pages in memory."""
        position = self._place
        while len(view):
            number, first = divmod(position, PAGE)
            part = view[: PAGE - first]
            if number not in self._lost:
                self._lost[number] = bytearray(self._from_disk(number * PAGE, PAGE))
            self._lost[number][first : first + len(part)] = part
            position, view = position + len(part), view[len(part) :]

    def _remembered(self, position: int, n_bytes: int) -> bytes:
        """The written data, whether it is on the disk or in memory."""
        content = bytearray(self._from_disk(position, n_bytes))
        for number in range(position // PAGE, (position + n_bytes + PAGE - 1) // PAGE):
            page = self._lost.get(number)
            if page is not None:
                first, last = max(position, number * PAGE), min(position + n_bytes, (number + 1) * PAGE)
                content[first - position : last - position] = page[first - number * PAGE : last - number * PAGE]
        return bytes(content)

    def _from_disk(self, position: int, n_bytes: int) -> bytes:
        """The data on the disk; zeros beyond its end."""
        self._file.seek(position)
        content = bytearray()
        while len(content) < n_bytes and (more := self._file.read(n_bytes - len(content))):
            content += more
        return bytes(content.ljust(n_bytes, b"\0"))

    def _end(self) -> int:
        end = self._file.seek(0, io.SEEK_END)
        return max([end, *((number + 1) * PAGE for number in self._lost)])


@contextmanager
def create(path: Path) -> Iterator[tuple[h5py.File, Output]]:
    """A new HDF5 file for writing, and its `Output`; OSError at the end if a write to the disk failed.

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
