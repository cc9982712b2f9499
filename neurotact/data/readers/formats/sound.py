"""Sound files: WAV, which SciPy reads, and FLAC, which the package soundfile reads. A channel is a column."""

import warnings
from pathlib import Path

import numpy as np

from neurotact.data.readers.formats.contents import FLAC, SOUND, check_content, damaged_as
from neurotact.data.readers.table.cells import Table, table_of
from neurotact.errors import InputError, optional
from neurotact.files import check_size


def read(path: Path) -> dict[str, Table]:
    """The channels of a file as they are stored, and their interval; InputError for a damaged file.

    >>> import tempfile
    >>> from scipy.io import wavfile
    >>> path = Path(tempfile.mkdtemp()) / "slide.wav"
    >>> wavfile.write(path, 2000, np.array([[1, -1], [2, -2]], np.int16))
    >>> table = read(path)[""]
    >>> table.names, table.intervals_s, table.first_row
    (('channel1', 'channel2'), (0.0005, 0.0005), ['1', '-1'])
    """
    is_flac = path.suffix.lower() == ".flac"
    check_content(path, FLAC if is_flac else SOUND, wanted="a sound file", fix="save it as WAV")
    with damaged_as(path, "is a damaged sound file", "save it again"):
        rate_Hz, samples = _flac(path) if is_flac else _wav(path)
    samples = samples.reshape(len(samples), -1)
    if not rate_Hz > 0 or not samples.size:
        raise InputError(f"{path}: holds no sample, or names no sampling rate; record it again")
    names = [f"channel{number}" for number in range(1, samples.shape[1] + 1)]
    return {"": table_of(path, dict(zip(names, samples.T, strict=True)), [1 / rate_Hz] * len(names))}


def _wav(path: Path) -> tuple[float, np.ndarray]:
    from scipy.io import wavfile

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wavfile.WavFileWarning)  # chunks that are no samples
        return wavfile.read(path)


def _flac(path: Path) -> tuple[float, np.ndarray]:
    soundfile = optional("soundfile", f"{path}: soundfile is needed to read FLAC files; pip install 'neurotact[flac]'")
    with soundfile.SoundFile(path) as file:
        check_size(path, 4 * file.frames * file.channels)
        return file.samplerate, file.read(dtype="int16" if file.subtype in ("PCM_S8", "PCM_16") else "int32")
