"""Recordings: trials of taxel signals, with their sampling rate, unit and conditions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from neurotact.classes import NO_CLASSES, measurement_in
from neurotact.data import marks as annotations
from neurotact.errors import InputError, closest, in_digits, nearest, number_of
from neurotact.lazily import lazily
from neurotact.notebook import html_of
from neurotact.tables import natural

with lazily():
    import pandas as pd


LABEL = "label"
NOUNS = ("trial", "condition")
"""A row and a column of a table of conditions."""
MOST_NAMED = 12
"""Values of a condition that an error lists."""


class Trials(ABC):
    """The common interface of recorded trials in memory (`Recordings`) and in a file (`hdf5.StoredRecordings`).

    The attributes are those of `Recordings`, except for the signals: `piece` and `loaded` read them.
    """

    sampling_rate_Hz: float
    unit: str
    conditions: pd.DataFrame
    channels: tuple[str, ...]
    source: str
    marks: pd.DataFrame | None = None

    def __len__(self) -> int:
        return len(self.conditions)

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

    @property
    @abstractmethod
    def lengths(self) -> np.ndarray:
        """Samples of each trial, `(trial,)` int64."""

    @abstractmethod
    def piece(self, trial: int, start: int, stop: int) -> np.ndarray:
        """The samples from `start` to before `stop` of one trial, `(time, channel)` float32."""

    @abstractmethod
    def loaded(self) -> Recordings:
        """The same trials in memory."""

    @abstractmethod
    def select(self, keep: ArrayLike) -> Self:
        """The trials where the boolean `keep` is true, or the trials that an index array names."""

    def in_order(self, channels: Sequence[str] | None) -> Self:
        """The same trials with their taxels in the order of these names, as `order_by_name` finds it."""
        order = order_by_name(self.channels, channels, self.source or "recordings")
        return self if order is None else self.of_taxels(order)

    @abstractmethod
    def of_taxels(self, order: Sequence[int]) -> Self:
        """The same trials with the taxels of these numbers."""


@dataclass(frozen=True, eq=False)
class Recordings(Trials):
    """Trials recorded by one skin.

    signals: one `(time, channel)` array per trial, float32, in `unit`; lengths may differ, the number
        of channels may not. A `(trial, time, channel)` array works if all lengths are equal.
    sampling_rate_Hz: samples per second, the same for every trial.
    unit: of the signals, such as "mV", "V" or "count".
    conditions: one row per trial, index 0..n-1; the column `label` (str) names the class, the others
        describe the trial (`force_N`, `speed_mm_per_s`, ...). A mapping of columns is converted to such a
        table, and a sequence of class names to one with only the column `label`.
    channels: the taxels' names; `taxel1..` when not given. Tables of pandas have those of their columns, and are put
        into the order of the first one.
    source: where the recordings come from, in one line.
    marks: which label is in force when, in long trials: a table of trial, start_s, stop_s and label, or a mapping of
        these columns; unmarked time is "none". None: trials are not annotated in time.

    Raises InputError for signals that hold NaN or infinity, are empty, differ in their number of
    channels, or do not match the table of conditions; for two channels of one name and trials without a class.

    >>> touch = Recordings([np.ones((4, 2)), np.ones((6, 2))], 2000.0, "mV", ["felt", "silk"])
    >>> len(touch), touch.n_channels, touch.classes
    (2, 2, ('felt', 'silk'))
    """

    signals: Sequence[np.ndarray] | np.ndarray
    sampling_rate_Hz: float
    unit: str
    conditions: pd.DataFrame
    channels: tuple[str, ...] = ()
    source: str = ""
    marks: pd.DataFrame | None = None

    if TYPE_CHECKING:  # what is converted may be given, too

        def __init__(
            self,
            signals: Sequence[np.ndarray] | np.ndarray,
            sampling_rate_Hz: float,
            unit: str,
            conditions: pd.DataFrame | Mapping[str, Any] | ArrayLike,
            channels: Sequence[str] = (),
            source: str = "",
            marks: pd.DataFrame | Mapping[str, Any] | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        where = self.source or "recordings"
        check_sampling_rate(self.sampling_rate_Hz, where)
        _check_unit(self.unit, where)
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "conditions", conditions_table(self.conditions, where))
        given, named = _by_name(self.signals, self.channels, where)
        object.__setattr__(self, "channels", named)
        signals = _as_signal(given) if isinstance(given, np.ndarray) else [_as_signal(s) for s in given]
        object.__setattr__(self, "signals", signals)
        if len(self.signals) == 0:
            raise InputError(f"{where}: holds no trial; give at least one")
        if not self.channels:
            n_channels = signals[0].shape[-1] if signals[0].ndim else 0
            object.__setattr__(self, "channels", default_channels(n_channels))
        self._check()

    def _check(self) -> None:
        where = self.source or "recordings"
        if len(self.conditions) != len(self.signals):
            raise InputError(
                f"{where}: {number_of(len(self.signals), 'trial')} but "
                f"{number_of(len(self.conditions), 'row of conditions')}; give one row per trial"
            )
        check_conditions(self.conditions, where)
        check_channels(self.channels, where)
        if list(self.conditions.index) != list(range(len(self.signals))):
            object.__setattr__(self, "conditions", self.conditions.reset_index(drop=True))
        for i, signal in enumerate(self.signals):
            check_shape(signal.shape, i, len(self.channels), where)
            check_finite(signal, i, self.channels, where)
        durations_s = self.lengths / self.sampling_rate_Hz
        object.__setattr__(self, "marks", annotations.checked(self.marks, durations_s, where))

    def __len__(self) -> int:
        return len(self.signals)

    @cached_property
    def lengths(self) -> np.ndarray:
        return np.array([len(signal) for signal in self.signals], np.int64)

    def piece(self, trial: int, start: int, stop: int) -> np.ndarray:
        return self.signals[trial][start:stop]

    def loaded(self) -> Recordings:
        return self

    def select(self, keep: ArrayLike) -> Self:
        """The trials where the boolean `keep` is true, or the trials that an index array names."""
        index = chosen(keep, len(self))
        if isinstance(self.signals, np.ndarray):
            signals = self.signals[index]
        else:
            signals = [self.signals[i] for i in index.tolist()]
        conditions = self.conditions.iloc[index].reset_index(drop=True)
        return replace(self, signals=signals, conditions=conditions, marks=annotations.selected(self.marks, index))

    def of_taxels(self, order: Sequence[int]) -> Self:
        given, names = self.signals, tuple(self.channels[index] for index in order)
        signals = given[..., order] if isinstance(given, np.ndarray) else [signal[:, order] for signal in given]
        return replace(self, signals=signals, channels=names)

    def __repr__(self) -> str:
        lengths = self.lengths
        span = f"{lengths.min()}" if lengths.min() == lengths.max() else f"{lengths.min()} to {lengths.max()}"
        seconds = " to ".join(
            in_digits(n / self.sampling_rate_Hz) for n in dict.fromkeys([lengths.min(), lengths.max()])
        )
        return (
            f"Recordings({number_of(len(self), 'trial')} x {number_of(self.n_channels, 'taxel')}, "
            f"{span} samples at {self.sampling_rate_Hz:g} Hz ({seconds} s), {self.unit}, "
            f"{number_of(len(self.classes), 'class')})"
        )

    def _repr_html_(self) -> str:
        counts = self.conditions[LABEL].value_counts().sort_index()
        return html_of(self, {"trials of each class": ", ".join(f"{name}: {n}" for name, n in counts.items())})

    def summary(self) -> str:
        """The numbers of trials, classes and taxels, the duration, the rate and the unit, in one line."""
        seconds = self.lengths.sum() / self.sampling_rate_Hz
        return (
            f"{number_of(len(self), 'trial')} of {number_of(len(self.classes), 'class')}, "
            f"{number_of(self.n_channels, 'taxel')}, {seconds:.1f} s at {self.sampling_rate_Hz:g} Hz, in {self.unit}"
        )

    def to_unit(self, unit: str) -> Recordings:
        """The same signals in another unit; only volts and millivolts convert, others are refused."""
        if unit == self.unit:
            return self
        factor = unit_factor(self.unit, unit, self.source or "recordings")
        if isinstance(self.signals, np.ndarray):
            return replace(self, signals=self.signals * factor, unit=unit)
        return replace(self, signals=[s * factor for s in self.signals], unit=unit)


def unit_factor(unit: str, wanted: str, where: str) -> np.float32:
    """The factor from `unit` to `wanted`; InputError unless they are equal, or V and mV.

    >>> unit_factor("V", "mV", "skin.h5")
    np.float32(1000.0)
    """
    if unit == wanted:
        return np.float32(1.0)
    volts = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}
    if unit not in volts or wanted not in volts:
        raise InputError(
            f"{where}: signals are in '{unit}' but '{wanted}' is needed; "
            "calibrate an encoder for this sensor (neurotact calibrate, in Python nt.calibrate)"
        )
    return np.float32(volts[unit] / volts[wanted])


def order_by_name(
    own: Sequence[str], wanted: Sequence[str] | None, where: str, noun: str = "taxel"
) -> list[int] | None:
    """Where each of the `wanted` names stands in `own`; None if the order is the same, or if one side has no names.

    Raises InputError where both sides have names and these differ.

    >>> order_by_name(("right", "left"), ("left", "right"), "touches.h5")
    [1, 0]
    >>> order_by_name(("taxel1", "taxel2"), ("left", "right"), "touches.h5")  # by place: one side was never named
    """
    if (
        wanted is None
        or [*own] == [*wanted]
        or any([*names] == [*default_channels(len(names))] for names in (own, wanted))
    ):
        return None
    strange = [name for name in own if name not in {*wanted}] or [name for name in wanted if name not in {*own}]
    if strange or len(own) != len(wanted) or len({*own}) < len(own):
        has = "has" if strange and strange[0] in own else "lacks"
        what = f"{has} the {noun} '{strange[0]}'" if strange else f"names {len(own)} {noun}s, some of them twice,"
        raise InputError(f"{where}: {what} where {', '.join(wanted)} are expected; give the {noun}s of the training")
    return [[*own].index(name) for name in wanted]


def default_channels(n_channels: int) -> tuple[str, ...]:
    """Default names of taxels: taxel1, taxel2, ..."""
    return tuple(f"taxel{i + 1}" for i in range(n_channels))


def chosen(keep: ArrayLike, n_trials: int, what: str = "trials") -> np.ndarray:
    """The indices, at least one, that a boolean mask or an index array chooses, `(chosen,)` int64.

    An index below 0 counts from the end. InputError for a mask of another length and an index out of range.

    >>> chosen([True, False, True], 3).tolist(), chosen([2, -3], 3).tolist()
    ([0, 2], [2, 0])
    """
    given = np.asarray(keep)
    if given.dtype == bool:
        if given.shape != (n_trials,):
            raise InputError(f"select: the mask has the shape {given.shape} where there are {n_trials} {what}")
        given = np.flatnonzero(given)
    if given.ndim != 1 or (given.size and given.dtype.kind not in "iu"):
        raise InputError(f"select: takes a boolean mask or whole numbers; got {given.dtype} of shape {given.shape}")
    if not given.size and n_trials:
        raise InputError(f"select: chooses none of the {n_trials} {what}; choose at least one")
    outside = given[(given < -n_trials) | (given >= n_trials)]
    if len(outside):
        raise InputError(f"select: there is no number {outside[0]} among the {n_trials} {what}, counted from 0")
    return np.where(given < 0, given + n_trials, given).astype(np.int64)


def conditions_table(conditions: Any, where: str) -> pd.DataFrame:
    """A table of conditions as it is, from a mapping of its columns, or from the class of each trial.

    >>> conditions_table(["felt", "silk"], "skin.h5")["label"].tolist()
    ['felt', 'silk']
    """
    if isinstance(conditions, pd.DataFrame):
        return conditions
    try:
        if isinstance(conditions, Mapping):
            return pd.DataFrame(dict(conditions))
        if isinstance(conditions, (Sequence, np.ndarray, pd.Series)) and not isinstance(conditions, str):
            return pd.DataFrame({LABEL: list(conditions)})
    except ValueError as error:  # columns of different lengths, or no column at all
        raise InputError(f"{where}: the conditions make no table ({error}); give one value per trial") from error
    raise InputError(
        f"{where}: conditions must be a table, a mapping of columns or the class of each trial; "
        f"got {type(conditions).__name__}"
    )


def class_names(conditions: pd.DataFrame) -> tuple[str, ...]:
    """The classes in a table of conditions, sorted."""
    return tuple(sorted(conditions[LABEL].drop_duplicates().astype(str).unique()))


def class_indices(conditions: pd.DataFrame) -> np.ndarray:
    """The class of each row, `(trial,)` int64, as an index into `class_names`.

    >>> class_indices(pd.DataFrame({"label": ["silk", "felt", "silk"]})).tolist()
    [1, 0, 1]
    """
    index = {name: i for i, name in enumerate(class_names(conditions))}
    return np.array([index[name] for name in conditions[LABEL].astype(str)], np.int64)


def select_conditions(
    table: pd.DataFrame, where: Mapping[str, object], source: str = "conditions", nouns: tuple[str, str] = NOUNS
) -> np.ndarray:
    """Boolean mask of the rows whose columns equal the given values (a list means any of them).

    3 is the text 03, too, where no row has the text 3. nouns: what a row and a column are called in messages.
    Raises InputError for a value that no row has, and for a number that is several texts of a column.

    >>> table = pd.DataFrame({"label": ["a", "b", "a"], "force_N": [3, 6, 12]})
    >>> select_conditions(table, {"force_N": [3, 12]})
    array([ True, False,  True])
    """
    keep = np.ones(len(table), dtype=bool)
    for column, wanted in where.items():
        if column not in table:
            raise InputError(f"{source}: there is no {nouns[1]} '{column}'; {nearest(column, list(table.columns))}")
        values = list(wanted) if isinstance(wanted, (list, tuple)) else [wanted]
        values_of_column = table[column]
        if values_of_column.dtype.kind not in "iuf":  # a class may have the name 3, and true may be written in two ways
            values_of_column = _as_words(values_of_column)
            values = [_level(values_of_column.unique(), _as_word(value), f"{source}: {column}") for value in values]
        else:
            values = [_number(value, value) if isinstance(value, str) else value for value in values]
        keep &= values_of_column.isin(values).to_numpy()
    if not keep.any():
        condition = ", ".join(f"{column} = {wanted}" for column, wanted in where.items())
        raise InputError(f"{source}: no {nouns[0]} has {condition}; {_values_of(table, where)}")
    return keep


def _level(levels: np.ndarray, wanted: str, source: str) -> str:
    """The text that a wanted one is: the same, else the only one that is the same number, as 03 is 3 and 3.0."""
    if wanted in levels or (number := _number(wanted, None)) is None:
        return wanted
    same = [level for level in levels if _number(level, None) == number]
    if len(same) > 1:
        raise InputError(f"{source} = {wanted} may be {' or '.join(same)}; write one of these, as in {same[0]!r}")
    return (*same, wanted)[0]


def _number(text: str, default: Any) -> Any:
    """A text as a number; `default` if it is none."""
    number = pd.to_numeric(text, errors="coerce")
    return number if pd.notna(number) else default


def _as_words(values: pd.Series) -> pd.Series:
    return values.map(_as_word) if values.dtype.kind == "b" else values.astype(str)


def _as_word(value: object) -> str:
    return str(value).lower() if isinstance(value, (bool, np.bool_)) else str(value)


def _values_of(table: pd.DataFrame, where: Mapping[str, object]) -> str:
    """The values of the trials in each column, and the one that is nearly the wanted text, for an error message."""
    parts = []
    for column, wanted in where.items():
        values = list(map(str, sorted(table[column].drop_duplicates(), key=natural)))
        near = closest(wanted, values, alike=0.7) if isinstance(wanted, str) else None
        meant = f"did you mean '{near}'? " if near is not None and near != wanted else ""
        listed = f"{', '.join(values[:MOST_NAMED])}{', ...' if len(values) > MOST_NAMED else ''}"
        parts.append(f"{meant}{column} is {listed}")
    return "; ".join(parts)


def check_sampling_rate(rate_Hz: float, where: str) -> None:
    """Refuse a sampling rate that is not a positive, finite number."""
    is_number = isinstance(rate_Hz, Real) and not isinstance(rate_Hz, bool)
    if not (is_number and np.isfinite(float(rate_Hz)) and rate_Hz > 0):
        raise InputError(f"{where}: sampling_rate_Hz must be a positive number; got {rate_Hz!r}")


def _check_unit(unit: object, where: str) -> None:
    """Refuse a unit that is not text."""
    if not isinstance(unit, str):
        raise InputError(f"{where}: unit must be text, such as 'mV'; got {unit!r}")


def check_import(rate_Hz: float | None, unit: str, where: str) -> None:
    """Refuse a sampling rate (None: not given) or a unit that imported recordings cannot have."""
    if rate_Hz is not None:
        check_sampling_rate(rate_Hz, where)
    if not unit.strip():
        raise InputError(f"{where}: the unit of the signals is empty; give one, such as mV")


def check_conditions(conditions: pd.DataFrame, where: str) -> None:
    """Refuse a table of conditions with a trial that has no class name, and measurements as classes."""
    if LABEL not in conditions:
        raise InputError(f"{where}: the table of conditions has no column 'label'; add one class name per trial")
    labels = conditions[LABEL]
    for name in dict.fromkeys(map(str, labels.tolist())):
        check_text(name, f"{where}: the label")
    names = labels.astype(str)
    nameless = np.flatnonzero(labels.isna().to_numpy() | (names.str.strip() == "").to_numpy())
    if len(nameless):
        raise InputError(f"{where}: trial {nameless[0]} has an empty label; name its class or drop the trial")
    measurement = measurement_in(labels.tolist())
    if measurement is not None:
        raise InputError(f"{where}: the label {NO_CLASSES.format(measurement)}")


def check_named_classes(labels: Sequence[str], where: str) -> None:
    """Refuse texts of a file that are measurements as classes: numbers, not all whole, of which no trial shares one.

    >>> check_named_classes(["0.5", "0.5", "1.5"], "touch.csv")
    >>> check_named_classes(["0.53", "1.5", "2"], "touch.csv")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    neurotact.errors.InputError: touch.csv: no two trials share a label, and the label holds numbers ...
    """
    numbers = pd.to_numeric(pd.Series(labels, dtype=object), errors="coerce").tolist()
    measurement = measurement_in(numbers)
    is_alone = len({*labels}) == len(labels) > 1
    if is_alone and measurement is not None and np.isfinite(numbers).all():
        said = NO_CLASSES.format(measurement)
        raise InputError(f"{where}: no two trials share a label, and the label {said}")


def check_channels(channels: Sequence[str], where: str) -> None:
    """Refuse channels with equal names."""
    seen: set[str] = set()
    for name in channels:
        if not isinstance(name, str):
            raise InputError(f"{where}: the name of a channel must be text; got {name!r}")
        check_text(name, f"{where}: the channel")
        if name in seen:
            raise InputError(f"{where}: two channels are called {name!r}; give each its own name")
        seen.add(name)


def check_text(text: str, what: str) -> None:
    r"""Refuse a text that cannot be written as UTF-8, such as a name in another encoding.

    >>> check_text("caf\udce9", "touch.h5: the label")
    Traceback (most recent call last):
    neurotact.errors.InputError: touch.h5: the label 'caf\udce9' is not UTF-8; rename it
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{what} {text[:80]!a} is not UTF-8; rename it") from error


def check_shape(shape: tuple[int, ...], trial: int, n_channels: int, where: str) -> None:
    """Refuse a trial that is not `(time, channel)`, is empty, or has other channels."""
    if len(shape) != 2 or 0 in shape:
        raise InputError(f"{where}: trial {trial} has shape {shape}; a trial is (time, channel), not empty")
    if shape[1] != n_channels:
        raise InputError(
            f"{where}: trial {trial} has {shape[1]} channels where {n_channels} are expected; "
            "every trial needs the same taxels"
        )


def check_finite(signal: np.ndarray, trial: int, channels: Sequence[str], where: str, start: int = 0) -> None:
    """Refuse samples of a trial, from number `start` on, that hold NaN or infinity."""
    if np.isfinite(signal).all():
        return
    time, channel = np.argwhere(~np.isfinite(signal))[0]
    raise InputError(
        f"{where}: trial {trial}, sample {start + time}, {channels[channel]} is NaN or infinite; "
        "repair or drop the trial"
    )


def _by_name(signals: Any, channels: tuple[str, ...], where: str) -> tuple[Any, tuple[str, ...]]:
    """Tables of pandas in the order of the first one's columns, which name the channels; other signals as they are."""
    is_named = not isinstance(signals, np.ndarray) and all(
        isinstance(signal, pd.DataFrame) and not isinstance(signal.columns, pd.RangeIndex) for signal in signals
    )
    if not is_named:
        return signals, channels
    tables = list(signals)
    names = [*map(str, tables[0].columns)] if tables else []
    if channels and sorted(channels) != sorted(names):
        return signals, channels  # other names, given by place
    names = list(channels or names)
    for trial, table in enumerate(tables):
        own = [*map(str, table.columns)]
        order = order_by_name(own, names, f"{where}: trial {trial}", "column")
        tables[trial] = table if order is None else table.iloc[:, order]
    return tables, tuple(names)


def _as_signal(signal: np.ndarray) -> np.ndarray:
    try:
        if np.iscomplexobj(signal):
            raise TypeError("complex numbers")
        if np.ma.is_masked(signal):
            raise InputError("recordings: a signal holds masked values; fill them, or leave the trial out")
        with np.errstate(over="ignore"):  # a number that is too large becomes infinite, and is refused
            return np.asarray(signal, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(f"recordings: a signal is not a table of numbers ({error})") from error
