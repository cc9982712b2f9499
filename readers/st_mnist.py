"""ST-MNIST: ten digits that were written on a skin of 10 x 10 event taxels (See et al. 2020, arXiv 2005.04319).

Published as a folder per digit of MATLAB files, each with one matrix, `events/signed_matrix.py`. For a strong change
the skin sends a burst of up to five events, 16 ns apart, so a clock makes one spike of them.
"""

from pathlib import Path

from neurotact_parts.readers.events import signed_matrix
from neurotact_parts.readers.events.files import read as read_events

from neurotact.data.dataset import Reader
from neurotact.data.readers.formats import arrays_in
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.files import existing, is_hidden

SIDE = 10
DIGITS = tuple("0123456789")
STEP_MS = 1.0


def read(path: str | Path, step_ms: float = STEP_MS) -> SpikeTrains:
    """The spikes of every recording of the published folder, or of one digit's folder within it.

    Afferents are the OFF events of each taxel, row by row, then the ON events. The label is the folder, a digit.
    Raises InputError for a folder that is not a digit, and for a file that has other rows than 100 taxels and a time.
    """
    folder = existing(Path(path), "folder")
    if not folder.is_dir():
        raise InputError(
            f"{folder}: is one file; give the folder with a folder per digit, or use neurotact import events"
        )
    if folder.resolve().name in DIGITS:
        raise InputError(f"{folder}: is the folder of one digit; give the folder that holds those of all digits")
    files = [file for file in sorted(folder.glob("*/*.mat")) if not is_hidden(file.name)]
    if not files:
        raise InputError(f"{folder}: holds no folder with .mat files; give the folder with a folder per digit")
    for file in files:
        if file.parent.name not in DIGITS:
            raise InputError(f"{folder}: the folder '{file.parent.name[:40]}' is no digit; ST-MNIST has 0 to 9")
        rows = len(signed_matrix.matrix_of(arrays_in(file), file))
        if rows != SIDE**2 + 1:
            raise InputError(
                f"{file}: has {rows} rows, not {SIDE**2} taxels and a time; read it with neurotact import events"
            )
    names = tuple(f"taxel{taxel + 1}" for taxel in range(SIDE**2))
    return read_events(folder, {"step_ms": step_ms, "channels": names, "merge_events": True})


READER = Reader(
    "ST-MNIST: ten digits on a skin of 10 x 10 event taxels (See et al. 2020), a folder per digit.", read, STEP_MS
)
