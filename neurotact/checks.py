"""Checks of parameters and examples that the estimators share."""

import logging
import numbers
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, DTypeLike

from neurotact.classes import NO_CLASSES, measurement_in
from neurotact.errors import InputError, nearest, number_of

log = logging.getLogger("neurotact")


def at_least(name: str, value: Any, least: float, *, whole: bool = False, above: bool = False) -> None:
    """InputError unless `value` is a number (a whole one with `whole`) >= `least` (> with `above`).

    >>> at_least("hidden", 0, 1, whole=True)
    Traceback (most recent call last):
    neurotact.errors.InputError: hidden: must be a whole number >= 1; got 0
    """
    kind = numbers.Integral if whole else numbers.Real
    number = float(value) if isinstance(value, kind) and not isinstance(value, bool) else float("nan")
    if not (number > least if above else number >= least) or number == float("inf"):
        what = "a whole number" if whole else "a finite number"
        raise InputError(f"{name}: must be {what} {'>' if above else '>='} {least}; got {value!r}")


def fraction(name: str, value: Any, *, above: bool = False) -> None:
    """InputError unless `value` is a number between 0 and 1; 0 itself passes without `above`.

    >>> fraction("validation_fraction", 15)
    Traceback (most recent call last):
    neurotact.errors.InputError: validation_fraction: must lie between 0 and 1; got 15
    """
    number = float(value) if isinstance(value, numbers.Real) and not isinstance(value, bool) else float("nan")
    if not (0 < number < 1 or (number == 0 and not above)):
        raise InputError(f"{name}: must lie between 0 and 1; got {value!r}")


def one_of(name: str, value: object, known: tuple[str, ...]) -> None:
    """InputError unless `value` is one of the `known` words.

    >>> one_of("activation", "relv", ("sigmoid", "relu"))
    Traceback (most recent call last):
    neurotact.errors.InputError: activation: 'relv' is unknown; did you mean 'relu'?
    """
    if value not in known:
        raise InputError(f"{name}: {value!r} is unknown; {nearest(str(value), known)}")


def check_last_axis(values: np.ndarray, n_last: int, axes: str, name: str = "X") -> None:
    """InputError unless the last axis has `n_last` entries; it says so where the last two axes are the other way round.

    axes: the names of all axes, as for `sequences`.

    >>> check_last_axis(np.zeros((5, 8, 300)), 8, "trial, time, taxel")
    Traceback (most recent call last):
    neurotact.errors.InputError: X: is (trial, taxel, time), as 8 is the number of taxels; give X.transpose(0, 2, 1)
    """
    *first, second, last = axes.split(", ")
    if values.shape[-1] == n_last:
        return
    if values.shape[-2] == n_last:
        order = ", ".join(map(str, [*range(len(first)), len(first) + 1, len(first)]))
        swapped = ", ".join([*first, last, second])
        raise InputError(
            f"{name}: is ({swapped}), as {n_last} is the number of {last}s; give {name}.transpose({order})"
        )
    raise InputError(f"{name}: has {number_of(values.shape[-1], last)}, but training had {n_last}; give those")


def swapped(n_steps: int, n_last: int, what: str, fix: str) -> str:
    """The doubt that the last two axes are the other way round; empty if there are not more of the last than steps.

    >>> swapped(12, 200, "taxel", "give X.transpose(0, 2, 1)")
    'has 200 taxels of 12 samples each; if it is the other way round, give X.transpose(0, 2, 1)'
    """
    if not n_last > n_steps > 1:
        return ""
    return f"has {n_last} {what}s of {n_steps} samples each; if it is the other way round, {fix}"


def warn_of_swapped(X: np.ndarray, axes: str) -> None:
    """Warn where X `(example, time, channel)` has more channels than samples; for what names neither.

    axes: the names of all axes, as for `sequences`.
    """
    doubt = swapped(X.shape[1], X.shape[2], axes.rpartition(", ")[2], "give X.transpose(0, 2, 1)")
    if doubt:
        log.warning("X: %s", doubt)


def _lengths(X: Any) -> list[int]:
    """The lengths of a list of arrays, ascending, each once; empty of what is no such list."""
    try:
        return sorted({len(part) for part in X})
    except TypeError:
        return []


def sequences(X: ArrayLike, axes: str, dtype: DTypeLike | None = None) -> np.ndarray:
    """X as an array of the named axes and, if given, of a type; InputError for another shape and for non-finite values.

    >>> sequences([[1.0, 2.0]], "trial, time, channel", float)
    Traceback (most recent call last):
    neurotact.errors.InputError: X: must be (trial, time, channel), none of them empty; got the shape (1, 2)
    """
    try:
        values = np.asarray(X)
        lengths = _lengths(values) if values.dtype == object and values.ndim == 1 else []
    except (RuntimeError, TypeError, ValueError) as error:  # ragged lists; tensors with a gradient or on a GPU
        lengths = _lengths(X) if isinstance(error, ValueError) else []
        if len(lengths) < 2:
            raise InputError(f"X: cannot be read as an array ({error}); give one array ({axes})") from error
    if np.ma.is_masked(X):
        raise InputError("X: holds masked values; fill them, or leave their examples out")
    if len(lengths) > 1:
        raise InputError(
            f"X: has {axes.partition(',')[0]}s of {lengths[0]} to {lengths[-1]} samples where all must be equally "
            "long; cut them to one length, or give nt.Recordings(X, sampling_rate_Hz, unit, {'label': y}) to "
            "nt.encode, and its spikes to nt.windows"
        )
    if values.ndim != axes.count(",") + 1 or 0 in values.shape:
        raise InputError(f"X: must be ({axes}), none of them empty; got the shape {values.shape}")
    if values.dtype.kind not in "fiub" or not np.isfinite(values).all():
        raise InputError("X: holds values that are not finite numbers; remove or replace them")
    return values if dtype is None else values.astype(dtype)


def trial_labels(y: ArrayLike, n_trials: int, name: str = "y") -> np.ndarray:
    """Labels `(trial,)` as an array; InputError for another shape and for a label that is missing.

    >>> trial_labels(["felt", None], 2)
    Traceback (most recent call last):
    neurotact.errors.InputError: y: trial 1 has no label; label the trial or drop it
    """
    labels = np.asarray(y)
    if labels.shape != (n_trials,):
        raise InputError(
            f"{name}: has the shape {labels.shape} where X has {number_of(n_trials, 'trial')}; give one label per trial"
        )
    missing = np.flatnonzero(pd.isna(labels))
    if len(missing):
        raise InputError(f"{name}: trial {missing[0]} has no label; label the trial or drop it")
    return labels


def class_labels(y: ArrayLike, n_trials: int, name: str = "y") -> np.ndarray:
    """Class labels `(trial,)`; InputError also for numbers that are measurements, such as 0.37.

    >>> class_labels([1.0, 2.0], 2)
    array([1., 2.])
    """
    labels = trial_labels(y, n_trials, name)
    measurement = measurement_in(labels.tolist())
    if measurement is not None:
        raise InputError(f"{name}: {NO_CLASSES.format(measurement)}")
    return labels
