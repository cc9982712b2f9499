"""A first row that is no sample: a start time, or the sampling rate."""

import numpy as np

from neurotact.data.readers.clock.units import FASTEST_HZ
from neurotact.errors import InputError

SINCE_1970_S = (0.9e9, 2.2e9)
"""Seconds since 1970, from 1998 to 2039; a start time may also be in ms, us or ns."""
ABOVE = 100.0
"""Factor by which a start time, or a sampling rate alone, is above all samples."""
FEW_WHOLE = 0.02
"""Share of whole numbers below which samples have decimals, so that a whole number beside them is none of them."""
LEAST_ROWS = 3
"""Samples that tell what is usual."""


def check_first_row(signal: np.ndarray, where: str, first_line: int) -> None:
    """Refuse a signal, `(time, channel)`, whose first row holds a start time.

    where: begins the message. first_line: the line of the first row, 0 in an array.

    >>> check_first_row(np.array([[1.6e9], [64.0], [0.1], [0.2], [0.3]]), "acc.csv", 1)
    Traceback (most recent call last):
    neurotact.errors.InputError: acc.csv: line 1 holds a start time, 1.6e+09 s since 1970, and the sampling rate is 64 \
Hz; skip what is no sample with `header_lines=2`, and give `sampling_rate_Hz=64`
    """
    started = _start_time(signal) if len(signal) > LEAST_ROWS else ""
    if not started:
        return
    beside = [value for value in signal[0].tolist() if _may_be_rate(value) and value > np.abs(signal[1:]).max()]
    row, number = ("line", first_line) if first_line else ("sample", 0)
    held = f"{where}: {row} {number} holds a start time, {started}"
    is_below = not beside and _may_be_rate(float(signal[1, 0])) and bool((signal[1] == signal[1, 0]).all())
    if is_below and not _differs(float(signal[1, 0]), signal[2:]):
        raise InputError(f"{held}; remove it, and {row} {number + 1}, too, if that is the sampling rate")
    rate_Hz = beside[0] if beside else float(signal[1, 0]) if is_below else None
    n_rows = 1 + is_below
    also, given = "", ""
    if rate_Hz is not None:
        also, given = f", and the sampling rate is {rate_Hz:g} Hz", f", and give `sampling_rate_Hz={rate_Hz:g}`"
    skip = f"skip what is no sample with `header_lines={first_line - 1 + n_rows}`"
    raise InputError(f"{held}{also}; {skip if first_line else f'remove the first {n_rows} rows'}{given}")


def _differs(value: float, samples: np.ndarray) -> bool:
    """Whether a number is surely no sample: whole where hardly a sample is, in several columns or beyond the samples of
    one; or further off than samples differ.
    """
    low, high = float(samples.min()), float(samples.max())
    is_whole = value == round(value) and (samples == np.rint(samples)).mean() < FEW_WHOLE
    if is_whole and (samples.shape[1] > 1 or not low <= value <= high):
        return True
    return not low - (high - low) <= value <= high + (high - low)


def rate_in(signal: np.ndarray, given_Hz: float | None) -> float | None:
    """The sampling rate that the first row seems to hold: one whole number, far above all samples, or the given rate.

    >>> rate_in(np.array([[64.0], [0.1], [0.2], [0.3]]), None), rate_in(np.array([[4.0], [3.0], [2.0], [1.0]]), None)
    (64.0, None)
    """
    if len(signal) <= LEAST_ROWS:
        return None
    first, rest = float(signal[0, 0]), signal[1:]
    is_given = first == given_Hz and not rest.min() <= first <= rest.max()
    is_far = first == round(first) and first > ABOVE * float(np.abs(rest).max()) > 0
    return first if _may_be_rate(first) and (signal[0] == first).all() and (is_given or is_far) else None


def _start_time(signal: np.ndarray) -> str:
    """The start time in the first row, in words; empty if there is none."""
    first, rest = np.abs(signal[0].astype(float)), np.abs(signal[2:]).max(axis=0)
    for unit_s, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")):
        is_time = (SINCE_1970_S[0] < first * unit_s) & (first * unit_s < SINCE_1970_S[1]) & (first > ABOVE * rest)
        if is_time.any():
            return f"{first[is_time][0]:.6g} {unit} since 1970"
    return ""


def _may_be_rate(value: float) -> bool:
    return 1 <= value <= FASTEST_HZ
