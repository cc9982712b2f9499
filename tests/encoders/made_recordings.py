"""Recordings of any length that are made as they are read, to see how much of them is held at once."""

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from neurotact.data.recordings import Recordings, Trials


@dataclass(frozen=True)
class MadeRecordings(Trials):
    """Two taxels under a slow wave, of another frequency in each class."""

    made_lengths: tuple[int, ...]
    conditions: pd.DataFrame
    sampling_rate_Hz: float = 2000.0
    unit: str = "mV"
    channels: tuple[str, ...] = ("taxel1", "taxel2")
    source: str = "made"

    @property
    def lengths(self) -> np.ndarray:
        return np.array(self.made_lengths)

    def piece(self, trial: int, start: int, stop: int) -> np.ndarray:
        step = np.arange(start, min(stop, self.made_lengths[trial]), dtype=np.float32)
        frequency_Hz = 2.0 + 3.0 * (self.conditions.label[trial] == "b")
        wave = np.sin(step * np.float32(2 * np.pi * frequency_Hz / self.sampling_rate_Hz))
        return 2.0 * wave[:, None] * np.array([1.0, 0.5], np.float32)

    def loaded(self) -> Recordings:
        signals = [self.piece(trial, 0, n) for trial, n in enumerate(self.made_lengths)]
        return Recordings(signals, self.sampling_rate_Hz, self.unit, self.conditions, self.channels, self.source)

    def of_taxels(self, order) -> "MadeRecordings":
        raise NotImplementedError

    def select(self, keep: np.ndarray) -> "MadeRecordings":
        index = np.arange(len(self))[keep]
        table = self.conditions.iloc[index].reset_index(drop=True)
        return replace(self, made_lengths=tuple(self.lengths[index].tolist()), conditions=table)


def made(lengths: list[int]) -> MadeRecordings:
    return MadeRecordings(tuple(lengths), pd.DataFrame({"label": ["ab"[i % 2] for i in range(len(lengths))]}))


def most_held(work: Callable[[], object]) -> int:
    """The most bytes that are held while `work` runs, beyond those before; what libraries hold is not seen."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        work()
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
