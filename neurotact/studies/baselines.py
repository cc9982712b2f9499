"""Classical classifiers on the inputs of a study's networks: the same windows of the same trials, the same split.

Logistic regression is fitted on every input. Support vector machines and extreme learning machines are fitted on the
signals and on the spikes of the first encoder; of each family, validation windows choose the strongest.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.preprocessing import StandardScaler

from neurotact.baselines.families import Candidate, Family, Sides, accuracy, best_of, elm, logistic_regression, svm
from neurotact.data.recordings import Recordings, select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.data.windows import Windows
from neurotact.encoders.afferents import taxels_of
from neurotact.metrics import paired
from neurotact.metrics.flops import Cost, Moments, Standardise, cost
from neurotact.metrics.signal_flops import Averaging
from neurotact.networks.ledger import encoding_cost

BINS = 10
"""Time bins of a window, in which spikes are counted and signals averaged."""
MOST_MACHINES = 3000
"""Training windows up to which support vector machines are fitted: their time grows with the square of the number."""
LINEAR = "logistic regression"
STRONGER: dict[str, Family] = {"SVM": svm, "ELM": elm}
SIGNALS, SPIKES = "signals", "spikes"
RIGHT = "right"
"""A key of each row that is not a column of `baselines.csv`."""


class Input(NamedTuple):
    """An input of classifiers: features of each window, `(window, feature)`, their name, and their cost.

    source: signals or spikes. pair: refractory periods of RA-I and SA-I in ms; None for signals.
    """

    source: str
    words: str
    pair: tuple[float, float] | None
    features: np.ndarray
    made: Cost


class Cuts(NamedTuple):
    """Windows on the encoder's clock, and three boolean `(window,)` that select those of each side."""

    windows: Windows
    clock_Hz: float
    sides: tuple[np.ndarray, np.ndarray, np.ndarray]

    @property
    def length_ms(self) -> float:
        return 1e3 * self.windows.n_steps / self.clock_Hz


def cuts_of(
    conditions: pd.DataFrame, windows: Windows, clock_Hz: float, parts: Split, subset: Mapping[str, Any]
) -> Cuts:
    """The windows of a subset of trials on each side of a split."""
    inside = select_conditions(conditions, subset)[windows.trial]
    train, validation, test = (inside & np.isin(windows.trial, part) for part in parts)
    return Cuts(windows, clock_Hz, (train, validation, test))


def pieces_of(recordings: Recordings, windows: Windows, clock_Hz: float) -> Iterator[np.ndarray]:
    """The samples of each window of an encoder's clock, as recorded: `(sample, taxel)`, at least one."""
    per_step = recordings.sampling_rate_Hz / clock_Hz
    first = np.ceil(windows.start * per_step - 1e-9).astype(np.int64)
    last = np.ceil((windows.start + windows.n_steps) * per_step - 1e-9).astype(np.int64)
    for trial, begin, end in zip(windows.trial, first, np.maximum(last, first + 1), strict=True):
        signal = recordings.signals[trial]
        begin = min(begin, len(signal) - 1)  # the last window of a slow recording may begin after its last sample
        yield signal[begin : max(end, begin + 1)]


def signal_inputs(recordings: Recordings, cuts: Cuts) -> Iterator[Input]:
    """Mean and deviation of each taxel, and its mean in `BINS` time bins of the window."""
    pieces = list(pieces_of(recordings, cuts.windows, cuts.clock_Hz))
    samples, taxels = max(map(len, pieces)), recordings.n_channels
    moments = np.array([np.concatenate([piece.mean(axis=0), piece.std(axis=0)]) for piece in pieces])
    made = cost(Moments(samples, taxels, order=2), signal_ms=cuts.length_ms)
    yield Input(SIGNALS, "mean and deviation", None, moments, made)
    n_bins = min(BINS, min(map(len, pieces)))
    binned = np.array([_binned(piece, n_bins) / _binned(np.ones((len(piece), 1)), n_bins) for piece in pieces])
    made = cost(Averaging(samples, n_bins, taxels), signal_ms=cuts.length_ms)
    yield Input(SIGNALS, _bins(n_bins), None, binned.reshape(len(binned), -1), made)


def spike_inputs(trains: SpikeTrains, pair: tuple[float, float], cuts: Cuts) -> Iterator[Input]:
    """Spikes of each afferent, counted over the window and in `BINS` time bins; each spike is one addition.

    Events of an event-based sensor cost nothing to encode.
    """
    rasters = trains.raster(cuts.windows)
    n_windows, n_steps, n_afferents = rasters.shape
    n_taxels = taxels_of(n_afferents, trains.encoder)
    encoding = encoding_cost(n_taxels, n_steps, cuts.length_ms, trains.encoder) if trains.encoder else Cost()
    made = encoding + Cost(acs=float(rasters.sum()) / n_windows)
    n_bins = min(BINS, n_steps)
    edges = np.linspace(0, n_steps, n_bins + 1).round().astype(int)
    counts = np.add.reduceat(rasters, edges[:-1], axis=1, dtype=np.int64)
    yield Input(SPIKES, "counts", pair, counts.sum(axis=1).astype(float), made)
    yield Input(SPIKES, _bins(n_bins), pair, counts.reshape(n_windows, -1).astype(float), made)


def rows(
    inputs: Iterable[Input], labels: np.ndarray, cuts: Cuts, *, stronger: bool, most_machines: int = MOST_MACHINES
) -> Iterator[dict[str, Any]]:
    """A row of `baselines.csv` for each classifier on each input; labels: class of each window, `(window,)`.

    Under `RIGHT` a row also has, for validation and test, the share of correctly classified windows of each trial.
    stronger: also fit the families of `STRONGER`; validation windows choose the candidate of each.
    most_machines: training windows up to which support vector machines are fitted.
    """
    for one in inputs:
        scaler = StandardScaler().fit(one.features[cuts.sides[0]])
        sides = Sides(
            *(scaler.transform(one.features[side]) for side in cuts.sides), *(labels[side] for side in cuts.sides)
        )
        families = {LINEAR: logistic_regression, **(STRONGER if stronger else {})}
        for name, family in families.items():
            if name == "SVM" and len(sides.y_train) > most_machines:
                continue
            best = best_of(family, sides, 0)
            right = {
                side: paired.by_trial(cuts.windows.trial[selected], best.fitted.predict(x) == y)
                for side, selected, x, y in (
                    ("validation", cuts.sides[1], sides.validation, sides.y_validation),
                    ("test", cuts.sides[2], sides.test, sides.y_test),
                )
            }
            yield {**_row(one, name, best, sides), RIGHT: right}


def _row(one: Input, name: str, best: Candidate, sides: Sides) -> dict[str, Any]:
    spent = one.made + cost(Standardise(one.features.shape[1]), *best.layers)
    ra_ms, sa_ms = one.pair if one.pair else (None, None)
    named = {"classifier": name, "input": f"{one.source}: {one.words}", "t_ref_ra_ms": ra_ms, "t_ref_sa_ms": sa_ms}
    return {**named, **measured(best, sides, spent)}


def measured(best: Candidate, sides: Sides, spent: Cost) -> dict[str, Any]:
    """Accuracy of a fitted classifier on each side, and the cost of a decision; spent: from the recording on."""
    return {
        "settings": best.settings,
        "n_train": len(sides.y_train),
        "n_validation": len(sides.y_validation),
        "n_test": len(sides.y_test),
        "accuracy_validation": accuracy(best, sides.validation, sides.y_validation),
        "accuracy_test": accuracy(best, sides.test, sides.y_test),
        **spent.columns("macs", "flops", "parameters", "signal_ms", "energy_estimate_nJ"),
    }


def _bins(n: int) -> str:
    return f"{n} time bin{'' if n == 1 else 's'}"


def _binned(piece: np.ndarray, n_bins: int) -> np.ndarray:
    """Sums over `n_bins` time bins, as equal as whole samples allow, `(bin, taxel)`."""
    edges = np.linspace(0, len(piece), n_bins + 1).round().astype(int)
    return np.add.reduceat(piece, edges[:-1], axis=0, dtype=np.float64)
