"""Spike trains of trials, as events; on disk in the layout of the Spiking Heidelberg Digits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.recordings import class_indices, class_names
from neurotact.data.windows import Windows


@dataclass(frozen=True)
class SpikeTrains:
    """The spikes of every trial.

    steps, units: a trial each, the step at which each spike falls and the afferent that sent it, in order of time.
    trial_steps: length of each trial in steps, `(trial,)`.
    sampling_rate_Hz: steps a second.
    afferents: the afferents' names, such as "SA-I taxel1".
    conditions: one row a trial, with the column `label`.
    encoder: the spec that made them.
    source: the recordings that they were made from, usually a path.
    trial_digests: a digest a trial of what was recorded (`data.digests`); empty where that is not known.

    >>> raster = np.zeros((1, 4, 2), np.uint8)
    >>> raster[0, 1, 0] = raster[0, 3, 1] = 1
    >>> trains = from_rasters(raster, 2000.0, ("SA-I taxel1", "RA-I taxel1"), pd.DataFrame({"label": ["felt"]}))
    >>> trains.steps[0].tolist(), trains.units[0].tolist()
    ([1, 3], [0, 1])
    """

    steps: Sequence[np.ndarray]
    units: Sequence[np.ndarray]
    trial_steps: np.ndarray
    sampling_rate_Hz: float
    afferents: tuple[str, ...]
    conditions: pd.DataFrame
    encoder: Mapping[str, Any]
    source: str = ""
    trial_digests: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def classes(self) -> tuple[str, ...]:
        return class_names(self.conditions)

    @property
    def labels(self) -> np.ndarray:
        """Class index of each trial, `(trial,)` int64, into `classes`."""
        return class_indices(self.conditions)

    @property
    def is_sa(self) -> np.ndarray:
        """Which afferents are slowly adapting, `(afferent,)` boolean."""
        return np.array([name.startswith("SA") for name in self.afferents])

    def select(self, keep: np.ndarray) -> "SpikeTrains":
        """The trials where the boolean `keep` is true, or the trials that an index array names."""
        index = np.flatnonzero(keep) if np.asarray(keep).dtype == bool else np.asarray(keep)
        return replace(
            self,
            steps=[self.steps[i] for i in index.tolist()],
            units=[self.units[i] for i in index.tolist()],
            trial_steps=self.trial_steps[index],
            conditions=self.conditions.iloc[index].reset_index(drop=True),
            trial_digests=tuple(self.trial_digests[i] for i in index.tolist()) if self.trial_digests else (),
        )

    def raster(self, windows: Windows) -> np.ndarray:
        """Spikes in the given windows, `(window, time, afferent)` uint8."""
        raster = np.zeros((len(windows), windows.n_steps, len(self.afferents)), np.uint8)
        for window, (trial, start) in enumerate(zip(windows.trial, windows.start, strict=True)):
            first, last = np.searchsorted(self.steps[trial], (start, start + windows.n_steps))
            raster[window, self.steps[trial][first:last] - start, self.units[trial][first:last]] = 1
        return raster


def from_rasters(
    rasters: Sequence[np.ndarray] | np.ndarray,
    sampling_rate_Hz: float,
    afferents: tuple[str, ...],
    conditions: pd.DataFrame,
    encoder: Mapping[str, Any] | None = None,
    source: str = "",
    trial_digests: tuple[str, ...] = (),
) -> SpikeTrains:
    """Events from one `(time, afferent)` raster a trial."""
    found = [np.nonzero(raster) for raster in rasters]
    return SpikeTrains(
        steps=[steps.astype(np.int64) for steps, _ in found],
        units=[units.astype(np.uint16) for _, units in found],
        trial_steps=np.array([len(raster) for raster in rasters], np.int64),
        sampling_rate_Hz=sampling_rate_Hz,
        afferents=afferents,
        conditions=conditions.reset_index(drop=True),
        encoder=dict(encoder or {}),
        source=source,
        trial_digests=trial_digests,
    )
