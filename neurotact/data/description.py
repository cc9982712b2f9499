"""The content of a file of recordings or spikes, as tables for people: conditions, taxels, afferents."""

from __future__ import annotations

import numpy as np

from neurotact.data.recordings import Trials
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import in_digits, number_of, some
from neurotact.lazily import lazily
from neurotact.tables import natural

with lazily():
    import pandas as pd


MOST_VALUES = 12
"""Values of a condition to list; if there are more, only their number is shown."""
MOST_TAXELS = 40
"""Taxels with a row each; of more, a summary is shown."""
PIECE = 100_000
"""Samples of a trial that are read at once."""


def conditions_table(conditions: pd.DataFrame) -> pd.DataFrame:
    """A row per condition: its values, with the number of trials of each.

    >>> conditions_table(pd.DataFrame({"label": ["mat10", "mat2", "mat10"], "speed": [3, 3, 6]})).values.tolist()
    [['label', 'mat2 (1), mat10 (2)'], ['speed', '3 (2), 6 (1)']]
    """
    rows = []
    for name in conditions.columns:
        counts = conditions[name].value_counts()
        counts = counts.reindex(sorted(counts.index, key=natural))
        listed = ", ".join(f"{value} ({n})" for value, n in list(counts.items())[:MOST_VALUES])
        if len(counts) > MOST_VALUES:
            listed = f"{len(counts)} values, {counts.index[0]} to {counts.index[-1]}"
        rows.append({"condition": name, "values (trials)": listed})
    return pd.DataFrame(rows)


def taxels_table(trials: Trials) -> pd.DataFrame:
    """A row per taxel: its lowest, mean and highest sample, and the deviation within a trial (root mean square).

    >>> from neurotact.data.recordings import Recordings
    >>> touch = Recordings([np.array([[0.0, 1.0], [2.0, 1.0]])], 10, "mV", pd.DataFrame({"label": ["a"]}))
    >>> taxels_table(touch).values.tolist()
    [['taxel1', 0.0, 1.0, 2.0, 1.0], ['taxel2', 1.0, 1.0, 1.0, 0.0]]
    """
    low, high = np.full(trials.n_channels, np.inf), np.full(trials.n_channels, -np.inf)
    total, within = np.zeros(trials.n_channels), np.zeros(trials.n_channels)
    for trial, length in enumerate(trials.lengths.tolist()):
        sums, squares = np.zeros(trials.n_channels), np.zeros(trials.n_channels)
        origin = trials.piece(trial, 0, 1)[0].astype(float)  # avoids a loss of digits in the squares of large offsets
        for start in range(0, length, PIECE):
            piece = trials.piece(trial, start, min(start + PIECE, length)).astype(float)
            low, high = np.minimum(low, piece.min(0)), np.maximum(high, piece.max(0))
            sums += (piece - origin).sum(0)
            squares += ((piece - origin) ** 2).sum(0)
        total += sums + length * origin
        within += np.maximum(squares - sums**2 / length, 0.0)
    n_samples = int(trials.lengths.sum())
    unit = f"({trials.unit})"
    return pd.DataFrame(
        {
            "taxel": list(trials.channels), f"lowest {unit}": low, f"mean {unit}": total / n_samples,
            f"highest {unit}": high, f"deviation {unit}": np.sqrt(within / n_samples),
        }
    )  # fmt: skip


def taxels_summary(taxels: pd.DataFrame) -> pd.DataFrame:
    """The lowest, median and highest value over taxels of each column of `taxels_table`.

    >>> taxels_summary(pd.DataFrame({"taxel": ["a", "b", "c"], "mean (V)": [3.0, 1.0, 7.0]})).values.tolist()
    [['lowest', 1.0], ['median', 3.0], ['highest', 7.0]]
    """
    values = taxels.drop(columns="taxel")
    shown = pd.DataFrame({"lowest": values.min(), "median": values.median(), "highest": values.max()}).T
    return shown.rename_axis(f"of {number_of(len(taxels), 'taxel')}").reset_index()


def constant_taxels(taxels: pd.DataFrame) -> list[str]:
    """The names of the taxels of `taxels_table` that do not change within any trial."""
    return taxels["taxel"][taxels.iloc[:, -1] == 0].tolist()


def afferents_table(trains: SpikeTrains) -> pd.DataFrame:
    """A row per population: its afferents, those that never fire, and the mean rate of an afferent in Hz."""
    counts = np.bincount(np.concatenate(trains.units), minlength=len(trains.afferents))
    seconds = float(trains.held_steps.sum()) / trains.sampling_rate_Hz
    rows = [
        {
            "population": name, "afferents": len(members), "silent": int((counts[members] == 0).sum()),
            "rate (Hz)": counts[members].mean() / seconds,
        }
        for name, members in trains.populations.items()
    ]  # fmt: skip
    return pd.DataFrame(rows)


def held_line(trains: SpikeTrains) -> str:
    """How far the spikes of trials are held, in words; empty if to their end."""
    if trains.until_s is None:
        return ""
    return f"spikes of the first {trains.until_s:g} s of a trial alone: a study keeps those of its windows"


def marks_line(marks: pd.DataFrame, seconds: float) -> str:
    """The marks in time in words. seconds: of all trials.

    >>> marks = {"trial": [0, 1], "start_s": [1.0, 0.0], "stop_s": [1.5, 1.5], "label": ["slip", "slip"]}
    >>> marks_line(pd.DataFrame(marks), 8.0)
    'marks in time: slip (2, 0.5 to 1.5 s long); 25 % of the time has one'
    """
    lasts, parts = marks["stop_s"] - marks["start_s"], []
    for label, own in lasts.groupby(marks["label"]):
        ends = dict.fromkeys(in_digits(end) for end in (own.min(), own.max()))
        parts.append(f"{label} ({len(own)}, {' to '.join(ends)} s long)")
    return (
        f"marks in time: {some(parts, MOST_VALUES)}; {in_digits(100 * lasts.sum() / seconds, 2)} % of the time has one"
    )


def lengths_line(steps: np.ndarray, rate_Hz: float) -> str:
    """The lengths of trials, in words.

    >>> lengths_line(np.array([50, 200]), 100.0)
    'trials of 0.5 to 2 s, at 100 Hz (10 ms a sample)'
    >>> lengths_line(np.array([500, 617_250]), 0.5)[:28]
    'trials of 1,000 to 1,234,500'
    """
    seconds = dict.fromkeys(in_digits(n / rate_Hz) for n in (steps.min(), steps.max()))
    return f"trials of {' to '.join(seconds)} s, at {rate_Hz:g} Hz ({in_digits(1e3 / rate_Hz)} ms a sample)"
