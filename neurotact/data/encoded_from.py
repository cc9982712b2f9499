"""The recordings that spike trains were encoded from: found by their content, where their file is named or given."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from neurotact import files
from neurotact.data import hdf5
from neurotact.data.digests import recorded_trials
from neurotact.data.recordings import Trials
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError


class _EncodedFrom(NamedTuple):
    """Recordings in a file, and the trial there of each spike train that was asked for, `(trial,)`."""

    path: Path
    trials: np.ndarray


class AbsentError(InputError):
    """The recordings that a file of spikes names are in no place where they may be."""


def find(spikes: str | Path, trains: SpikeTrains, trials: np.ndarray, given: str | Path | None = None) -> _EncodedFrom:
    """The recordings of some of the spike trains in a file, whose content these trials have.

    The file of spikes names them: they may be beside it, or in the current folder. given: a file in place of these.
    Spikes without digests, of earlier versions, fit recordings of as many trials with the same classes.
    Raises InputError if the given file, or every file that exists, holds other recordings; AbsentError if none exists.
    """
    named = hdf5.source_of(spikes)
    places = (
        [Path(given)] if given is not None else [path for path in files.named_by(spikes, named) if os.path.isfile(path)]
    )
    if not places:
        what = f"'{named}', from which {spikes} was encoded," if named else f"the file from which {spikes} was encoded"
        raise AbsentError(f"{what} is neither beside it nor in the current folder; name it with `recordings`")
    for file, rows in _fitting(places, trains, trials, must_open=given is not None):
        if rows is not None:
            return _EncodedFrom(file, rows)
    shown = " and ".join(map(str, places))
    other = "the one that does" if given is not None else "the file that was encoded"
    raise InputError(
        f"{shown}: does not hold the recordings that {spikes} was encoded from; name {other} with `recordings`"
    )


@contextmanager
def opened(path: Path, trains: SpikeTrains) -> Iterator[Trials]:
    """Recordings in a file, with their taxels in the order in which they were encoded."""
    with hdf5.open_recordings(path) as stored:
        yield stored.in_order((trains.encoder.get("conditioning") or {}).get("taxels"))


def _fitting(
    places: list[Path], trains: SpikeTrains, trials: np.ndarray, *, must_open: bool
) -> Iterator[tuple[Path, np.ndarray | None]]:
    """The trials of each file, None if it holds other recordings or, unless it must open, no recordings at all."""
    for path in places:
        try:
            with opened(path, trains) as stored:
                rows = recorded_trials(stored, trains, trials)
        except InputError:
            if must_open:
                raise
            rows = None
        yield path, rows
