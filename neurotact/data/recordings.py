"""Recordings: trials of taxel signals, with their sampling rate, unit and conditions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from neurotact.errors import InputError, nearest

LABEL = "label"


@dataclass(frozen=True)
class Recordings:
    """Trials recorded by one skin.

    signals: one `(time, channel)` array a trial, float32, in `unit`; lengths may differ, the number
        of channels may not. A `(trial, time, channel)` array serves where all lengths are equal.
    sampling_rate_Hz: samples a second, the same for every trial.
    unit: of the signals, such as "mV", "V" or "count".
    conditions: one row a trial, index 0..n-1; the column `label` (str) names the class, the others
        say how the trial was recorded (`force_N`, `speed_mm_per_s`, ...).
    channels: the taxels' names; `taxel1..` when not given.
    source: where the recordings come from, in one line.

    Raises InputError for signals that hold NaN or infinity, are empty, differ in their number of
    channels, or do not match the table of conditions.

    >>> touch = Recordings([np.ones((4, 2)), np.ones((6, 2))], 2000.0, "mV",
    ...                    pd.DataFrame({"label": ["felt", "silk"]}))
    >>> len(touch), touch.n_channels, touch.classes
    (2, 2, ('felt', 'silk'))
    """

    signals: Sequence[np.ndarray] | np.ndarray
    sampling_rate_Hz: float
    unit: str
    conditions: pd.DataFrame
    channels: tuple[str, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        check_sampling_rate(self.sampling_rate_Hz, self.source or "recordings")
        given = self.signals
        signals = _as_signal(given) if isinstance(given, np.ndarray) else [_as_signal(s) for s in given]
        object.__setattr__(self, "signals", signals)
        if len(self.signals) == 0:
            raise InputError(f"{self.source or 'recordings'}: holds no trial; give at least one")
        if not self.channels:
            n_channels = signals[0].shape[-1] if signals[0].ndim else 0
            object.__setattr__(self, "channels", tuple(f"taxel{i + 1}" for i in range(n_channels)))
        self._check()

    def _check(self) -> None:
        where = self.source or "recordings"
        if LABEL not in self.conditions:
            raise InputError(f"{where}: the table of conditions has no column 'label'; add one class name a trial")
        if len(self.conditions) != len(self.signals):
            raise InputError(
                f"{where}: {len(self.signals)} trials but {len(self.conditions)} rows of conditions; "
                "give one row a trial"
            )
        if list(self.conditions.index) != list(range(len(self.signals))):
            object.__setattr__(self, "conditions", self.conditions.reset_index(drop=True))
        for i, signal in enumerate(self.signals):
            if signal.ndim != 2 or signal.size == 0:
                raise InputError(f"{where}: trial {i} has shape {signal.shape}; a trial is (time, channel), not empty")
            if signal.shape[1] != len(self.channels):
                raise InputError(
                    f"{where}: trial {i} has {signal.shape[1]} channels where {len(self.channels)} are expected; "
                    "every trial needs the same taxels"
                )
            if not np.isfinite(signal).all():
                time, channel = np.argwhere(~np.isfinite(signal))[0]
                raise InputError(
                    f"{where}: trial {i}, sample {time}, {self.channels[channel]} is NaN or infinite; "
                    "repair or drop the trial"
                )

    def __len__(self) -> int:
        return len(self.signals)

    @property
    def n_channels(self) -> int:
        return len(self.channels)

    @property
    def labels(self) -> np.ndarray:
        """Class index of each trial, `(trial,)` int64, into `classes`."""
        return class_indices(self.conditions)

    @property
    def classes(self) -> tuple[str, ...]:
        return class_names(self.conditions)

    def select(self, keep: np.ndarray) -> "Recordings":
        """The trials where the boolean `keep` is true, or the trials that an index array names."""
        index = np.flatnonzero(keep) if np.asarray(keep).dtype == bool else np.asarray(keep)
        if isinstance(self.signals, np.ndarray):
            signals = self.signals[index]
        else:
            signals = [self.signals[i] for i in index.tolist()]
        return replace(self, signals=signals, conditions=self.conditions.iloc[index].reset_index(drop=True))

    def to_unit(self, unit: str) -> "Recordings":
        """The same signals in another unit; only volts and millivolts convert, others are refused."""
        if unit == self.unit:
            return self
        volts = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}
        if unit not in volts or self.unit not in volts:
            raise InputError(
                f"{self.source or 'recordings'}: signals are in '{self.unit}' but '{unit}' is needed; "
                "calibrate an encoder for this sensor (neurotact calibrate) or import with the right unit"
            )
        factor = np.float32(volts[self.unit] / volts[unit])
        if isinstance(self.signals, np.ndarray):
            return replace(self, signals=self.signals * factor, unit=unit)
        return replace(self, signals=[s * factor for s in self.signals], unit=unit)


def class_names(conditions: pd.DataFrame) -> tuple[str, ...]:
    """The classes in a table of conditions, sorted."""
    return tuple(sorted(set(conditions[LABEL].astype(str))))


def class_indices(conditions: pd.DataFrame) -> np.ndarray:
    """The class of each row, `(trial,)` int64, as an index into `class_names`.

    >>> class_indices(pd.DataFrame({"label": ["silk", "felt", "silk"]})).tolist()
    [1, 0, 1]
    """
    return np.searchsorted(np.array(class_names(conditions)), conditions[LABEL].to_numpy(dtype=str)).astype(np.int64)


def select_conditions(table: pd.DataFrame, where: Mapping[str, object], source: str = "conditions") -> np.ndarray:
    """Boolean mask of the rows whose columns equal the given values (a list means any of them).

    >>> table = pd.DataFrame({"label": ["a", "b", "a"], "force_N": [3, 6, 12]})
    >>> select_conditions(table, {"force_N": [3, 12]})
    array([ True, False,  True])
    """
    keep = np.ones(len(table), dtype=bool)
    for column, wanted in where.items():
        if column not in table:
            raise InputError(f"{source}: there is no condition '{column}'; {nearest(column, list(table.columns))}")
        values = list(wanted) if isinstance(wanted, (list, tuple)) else [wanted]
        keep &= table[column].isin(values).to_numpy()
    if not keep.any():
        raise InputError(f"{source}: no trial has {dict(where)}; see the table of conditions")
    return keep


def check_sampling_rate(rate_Hz: float, where: str) -> None:
    """Refuse a sampling rate that is not a positive, finite number."""
    if not (np.isfinite(rate_Hz) and rate_Hz > 0):
        raise InputError(f"{where}: sampling_rate_Hz must be a positive number; got {rate_Hz}")


def _as_signal(signal: np.ndarray) -> np.ndarray:
    try:
        with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused as that
            return np.asarray(signal, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(f"recordings: a signal is not a table of numbers ({error})") from error
