"""Sound files: WAV, which SciPy reads, and FLAC, which the package soundfile reads. A channel is a column."""

import warnings
from pathlib import Path

import numpy as np

from neurotact.data.readers.formats import Format
from neurotact.data.readers.formats.contents import FLAC, SOUND, content_of
from neurotact.data.readers.table.cells import Table, table_of
from neurotact.errors import InputError, optional
from neurotact.files import check_size


def _read(path: Path) -> dict[str, Table]:
    """The channels of a file as they are stored, and their interval."""
    rate_Hz, samples = _flac(path) if content_of(path) is FLAC else _wav(path)
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


FORMAT = Format("a sound file", "save it as WAV again", _read, contents=(SOUND, FLAC))
