"""Arrays from NumPy files, .npz and .npy: pickles are never loaded, and errors name the file."""

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

from neurotact.data.readers.formats.contents import NPY, NPZ, ZIP, check_content, damaged_as
from neurotact.errors import InputError
from neurotact.files import check_size, existing

NEVER = "(pickles are never loaded)"
PICKLED = "holds pickled Python objects, which are never loaded; save plain arrays of numbers"


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz archive by key; InputError when it is damaged, too large, or holds pickled objects.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touch.npz"
    >>> np.savez(path, press=np.ones((4, 2)))
    >>> {key: array.shape for key, array in read_arrays(path).items()}
    {'press': (4, 2)}
    """
    check_size(path, existing(path).stat().st_size)
    check_content(path, NPZ, ZIP, wanted="an .npz archive", fix=f"save it with numpy.savez {NEVER}")
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path}: is not an .npz archive, or was cut off; save it with numpy.savez {NEVER}")
    # opened here, because np.load leaves a damaged file open
    with _opened(path, "is a damaged .npz archive", "save or copy it again") as stream:
        check_size(path, _declared_bytes(stream))
        with np.load(stream, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
    foreign = [key for key, array in arrays.items() if not isinstance(array, np.ndarray)]
    if foreign:
        raise InputError(f"{path}: member {foreign[0]!r} is not a NumPy array; save arrays only, with numpy.savez")
    if not arrays:
        raise InputError(f"{path}: holds no array; save at least one with numpy.savez")
    return arrays


def read_array(path: str | Path) -> np.ndarray:
    """The array of an .npy file; InputError when it is damaged, too large, or holds pickled objects.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touch.npy"
    >>> np.save(path, np.ones((4, 2)))
    >>> read_array(path).shape
    (4, 2)
    """
    check_size(path, existing(path).stat().st_size)
    check_content(path, NPY, wanted="an .npy file", fix=f"save it with numpy.save {NEVER}")
    with _opened(path, "cannot be read as an array", "save it with numpy.save") as stream:
        check_size(path, _array_bytes(stream))
        stream.seek(0)
        return np.load(stream, allow_pickle=False)


@contextmanager
def _opened(path: str | Path, what: str, fix: str) -> Iterator[IO[bytes]]:
    """The file, open for reading; what its reading raises is said as by `damaged_as`, and pickles are named."""
    with damaged_as(path, what, fix), open(path, "rb") as stream:
        try:
            yield stream
        except ValueError as error:
            if "Object arrays" in str(error):
                raise InputError(f"{path}: {PICKLED}") from error
            raise


def _declared_bytes(stream: IO[bytes]) -> int:
    """The memory of the members, by the archive's directory or by their own headers, whichever is larger."""
    with zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
        declared = 0
        for member in members:
            with archive.open(member) as inside:
                declared += max(member.file_size, _array_bytes(inside))
    stream.seek(0)
    return declared


def _array_bytes(stream: IO[bytes]) -> int:
    """The size of the array that a header declares; 0 if the stream is not an array."""
    if stream.read(len(npy.MAGIC_PREFIX)) != npy.MAGIC_PREFIX:
        return 0
    stream.seek(0)
    version = npy.read_magic(stream)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read_header(stream)
    return math.prod(shape) * dtype.itemsize
