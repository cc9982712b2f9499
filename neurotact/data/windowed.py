"""Windows of spike trains as arrays for an estimator: X, y and the trial of each window."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurotact.data.recordings import chosen, order_by_name
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Splits, split_touches
from neurotact.data.window_choice import ARGUMENTS, suited_window
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError, number_of
from neurotact.notebook import html_of
from neurotact.spec import takes_specs


class Origin(NamedTuple):
    """Where an array of spikes comes from, which an exported network needs as much as its weights.

    encoder: the table of its spec; None if the spikes were not encoded here. afferents: their names.
    window: how it was cut from trials; None for whole trials. recorded_Hz: samples of the recordings per second; None
    if unknown.
    """

    encoder: Mapping[str, Any] | None
    afferents: tuple[str, ...]
    window: WindowSpec | None = None
    recorded_Hz: float | None = None

    def of_afferents(self, key: Any) -> "Origin":
        """Of the afferents that an index or a slice keeps; without the encoder, which makes all of them, in its order.

        >>> Origin({}, ("a", "b", "c")).of_afferents([2, 0])
        Origin(encoder=None, afferents=('c', 'a'), window=None, recorded_Hz=None)
        """
        kept = tuple(np.array(self.afferents, object)[key].tolist())
        return self if kept == self.afferents else self._replace(encoder=None, afferents=kept)

    def of_steps(self, first: int, last: int, step: int, rate_Hz: float) -> "Origin":
        """Of the steps that a slice of the windows keeps; without the encoder if they are on another clock."""
        if step != 1:
            return self._replace(encoder=None, window=None)
        if self.window is None or last <= first:
            return self._replace(window=None)
        cut = {
            "start_ms": self.window.start_ms + 1e3 * first / rate_Hz,
            "length_ms": 1e3 * (last - first) / rate_Hz,
            "hop_ms": self.window.hop_ms or self.window.length_ms,
        }
        return self._replace(window=self.window.model_copy(update=cut))


class SpikeArray(np.ndarray):
    """A raster of spikes with its clock: an ordinary NumPy array with the attributes `sampling_rate_Hz` and `origin`.

    They are kept where NumPy surely leaves the steps and afferents of each example alone (an index of examples, a copy,
    another type, arithmetic), so that they reach an estimator through scikit-learn's splitters and pipelines. A slice
    of the time changes the clock by its step, and an index of afferents (`np.take`, `np.flip`) their names. Whatever
    else NumPy does (pooling, reshaping, transposing, sorting, `np.roll`, products of matrices) drops them, so that the
    clock must be given anew; so does `np.asarray`. `origin` is an `Origin`, or None where that is unknown.

    >>> spikes = SpikeArray.of(np.zeros((4, 300, 16), np.uint8), 2000.0)
    >>> spikes[:2].sampling_rate_Hz, spikes[:, ::4].sampling_rate_Hz, np.repeat(spikes, 2, axis=1).sampling_rate_Hz
    (2000.0, 500.0, None)
    """

    __slots__ = ("origin", "sampling_rate_Hz")  # no __dict__, which masked arrays would pass on through any slice
    sampling_rate_Hz: float | None
    origin: Origin | None

    @staticmethod
    def of(spikes: np.ndarray, sampling_rate_Hz: float, origin: Origin | None = None) -> "SpikeArray":
        """`spikes` `(window, time, afferent)` on the clock `sampling_rate_Hz`, without a copy."""
        made = np.asarray(spikes).view(SpikeArray)
        made.sampling_rate_Hz, made.origin = float(sampling_rate_Hz), origin
        return made

    def __array_finalize__(self, obj: np.ndarray | None) -> None:
        self.sampling_rate_Hz, self.origin = None, None

    def __array_wrap__(self, *result: Any) -> Any:
        """The result of a function of single values, as of inputs that say no other clock and no other origin."""
        made = super().__array_wrap__(*result)
        context = result[1] if len(result) > 1 else None  # the function, its arguments, which of its results
        if isinstance(made, SpikeArray) and context is not None and context[0].signature is None:
            given = (one for one in context[1] if isinstance(one, SpikeArray))
            made._take_over([one for one in given if one.shape[1:] == made.shape[1:]])
        return made

    def _take_over(self, arrays: Sequence["SpikeArray"]) -> "SpikeArray":
        """The same array with what others of its steps and afferents say, unless they say different things."""
        rates, origins = [one.sampling_rate_Hz for one in arrays], [one.origin for one in arrays]
        self.sampling_rate_Hz = rates[0] if rates and rates.count(rates[0]) == len(rates) else None
        self.origin = origins[0] if origins and origins.count(origins[0]) == len(origins) else None
        return self

    def copy(self, *args: Any, **kwargs: Any) -> "SpikeArray":  # NumPy's own methods pass only __array_finalize__
        return super().copy(*args, **kwargs)._take_over([self])

    def astype(self, *args: Any, **kwargs: Any) -> Any:
        made = super().astype(*args, **kwargs)
        return made._take_over([self]) if isinstance(made, SpikeArray) else made

    def __copy__(self) -> "SpikeArray":
        return self.copy()

    def __deepcopy__(self, memo: dict) -> "SpikeArray":
        return super().__deepcopy__(memo)._take_over([self])

    def take(self, indices: Any, axis: Any = None, out: Any = None, mode: Any = "raise") -> Any:
        if axis is None or out is not None or mode != "raise":
            return super().take(indices, axis, out, mode)
        return self[(*[slice(None)] * (axis % self.ndim), np.asarray(indices))]

    def sort(self, *args: Any, **kwargs: Any) -> None:
        super().sort(*args, **kwargs)
        self.sampling_rate_Hz, self.origin = None, None

    def __getitem__(self, key: Any) -> Any:
        part = super().__getitem__(key)
        if isinstance(part, SpikeArray):
            part.sampling_rate_Hz, part.origin = self._of_part(key, part.ndim)
        return part

    def _of_part(self, key: Any, n_axes: int) -> tuple[float | None, Origin | None]:
        """Clock and origin of what a key gives; None where the key does not say which steps and afferents it keeps."""
        keys = list(key) if isinstance(key, tuple) else [key]
        if any(one is Ellipsis for one in keys):
            at = next(axis for axis, one in enumerate(keys) if one is Ellipsis)
            keys[at : at + 1] = [slice(None)] * (self.ndim - len(keys) + 1)
        n_arrays = sum(not isinstance(one, (slice, int, np.integer)) for one in keys)
        examples, steps, channels = [*keys, *[slice(None)] * 3][:3]
        is_whole = self.ndim == 3 and len(keys) <= 3 and n_arrays <= 1 and np.ndim(examples) <= 1  # pyright: ignore
        if not is_whole or examples is None or not isinstance(steps, slice) or np.ndim(channels) > 1:  # pyright: ignore
            return None, None
        if n_axes != 3 - isinstance(examples, (int, np.integer)):
            return None, None
        rate_Hz, (first, last, step) = self.sampling_rate_Hz, steps.indices(self.shape[1])
        origin = None if self.origin is None else self.origin.of_afferents(channels)
        if origin is not None and rate_Hz is not None and (first, last, step) != (0, self.shape[1], 1):
            origin = origin.of_steps(first, last, step, rate_Hz)
        return None if rate_Hz is None else rate_Hz / abs(step), origin

    def __reduce__(self) -> tuple:
        rebuild, arguments, state = super().__reduce__()
        return rebuild, arguments, (state, self.sampling_rate_Hz, self.origin)

    def __setstate__(self, state: tuple) -> None:
        whole, self.sampling_rate_Hz, self.origin = state
        super().__setstate__(whole)


def in_order(X: Any, spikes: np.ndarray, afferents: Sequence[str] | None, name: str = "X") -> np.ndarray:
    """`spikes` `(..., afferent)`, the values of X, in the order of the named afferents, where X names its own.

    Raises InputError where X has other afferents. Without names on one of both sides the order of X is kept.

    >>> X = SpikeArray.of(np.array([[[0, 1]]]), 100.0, Origin(None, ("right", "left")))
    >>> in_order(X, np.asarray(X), ("left", "right")).tolist()
    [[[1, 0]]]
    """
    origin = getattr(X, "origin", None)
    order = None if origin is None else order_by_name(origin.afferents, afferents, name, "afferent")
    return spikes if order is None else spikes[..., order]


@dataclass(frozen=True, eq=False)
class WindowedSpikes:
    """Windows of equal length, cut from trials.

    X: spikes `(window, time, afferent)` uint8, with the attributes `sampling_rate_Hz` and `origin`.
    y: class names `(window,)`.
    groups: the trial of each window `(window,)` int64, for scikit-learn's group splitters.
    start_steps: the first step of each window in its trial `(window,)`.
    trains: the spike trains that the windows were cut from.

    >>> import neurotact as nt
    >>> found = windows(nt.encode(nt.simulate("gratings", trials=1, duration_s=0.3)), nt.Window(length_ms=100))
    >>> found.X.shape, found.y.shape, found.length_ms
    ((144, 200, 16), (144,), 100.0)
    """

    X: SpikeArray
    y: np.ndarray
    groups: np.ndarray
    start_steps: np.ndarray
    trains: SpikeTrains

    def __len__(self) -> int:
        return len(self.y)

    @property
    def length_ms(self) -> float:
        """Length of a window in ms."""
        return 1e3 * self.X.shape[1] / self.trains.sampling_rate_Hz

    def select(self, keep: ArrayLike) -> "WindowedSpikes":
        """The windows where the boolean `keep` is true, or the windows that an index array names."""
        index = chosen(keep, len(self), "windows")
        X = SpikeArray.of(self.X[index], self.trains.sampling_rate_Hz, self.X.origin)
        return WindowedSpikes(X, self.y[index], self.groups[index], self.start_steps[index], self.trains)

    @takes_specs
    def split(self, split: Splits = Splits()) -> "WindowedSplit":
        """Training, validation and test windows. Trials are split, so no trial and no copy of it is on two sides.

        Raises InputError when a class has too few trials, or when training trials would lack one.
        """
        split.check_single("split")
        sides = split_touches(self.trains, split.stratify, split.one)
        return WindowedSplit(*(self.select(np.isin(self.groups, side)) for side in sides))

    def __repr__(self) -> str:
        n_windows, n_steps, n_afferents = self.X.shape
        return (
            f"WindowedSpikes({number_of(n_windows, 'window')} of {n_steps} steps ({self.length_ms:g} ms) x "
            f"{number_of(n_afferents, 'afferent')}, {number_of(len(np.unique(self.y)), 'class')}, "
            f"{number_of(len(np.unique(self.groups)), 'trial')})"
        )

    def _repr_html_(self) -> str:
        counts = zip(*np.unique(self.y, return_counts=True), strict=True)
        return html_of(self, {"windows of each class": ", ".join(f"{name}: {n}" for name, n in counts)})


class WindowedSplit(NamedTuple):
    """The three sides of a split."""

    train: WindowedSpikes
    validation: WindowedSpikes
    test: WindowedSpikes


@takes_specs
def windows(spikes: SpikeTrains, window: WindowSpec = WindowSpec()) -> WindowedSpikes:
    """Cut the trials of spike trains into windows.

    window: how long they are and where they start; without a length they are chosen from the trials, which is logged.
    Warns of trials without an onset of contact, if windows are aligned to it.
    Raises InputError when a trial holds no window, or for values out of range.

    >>> import pandas as pd
    >>> from neurotact.data.spikes import from_rasters
    >>> felt = from_rasters(np.zeros((2, 700, 16)), 2000.0, ("SA-I taxel1",) * 16, pd.DataFrame({"label": ["a", "b"]}))
    >>> windows(felt, WindowSpec(length_ms=150))
    WindowedSpikes(4 windows of 300 steps (150 ms) x 16 afferents, 2 classes, 2 trials)
    >>> windows(felt).length_ms
    350.0
    """
    if not isinstance(spikes, SpikeTrains):
        raise InputError(f"spikes: must be spike trains, as nt.encode returns them; got {type(spikes).__name__}")
    spec = suited_window(spikes, window, ARGUMENTS)
    complaint = spikes.onset_complaint(spec)
    if complaint:
        warnings.warn(complaint, stacklevel=3)
    cut = spikes.cut(spec)
    origin = Origin(spikes.encoder or None, spikes.afferents, spec, spikes.recorded_Hz)
    X = SpikeArray.of(spikes.raster(cut), spikes.sampling_rate_Hz, origin)
    names = spikes.conditions["label"].to_numpy(dtype=str)
    return WindowedSpikes(X, names[cut.trial], cut.trial, cut.start, spikes)
