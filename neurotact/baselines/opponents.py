"""Opponents of a study's networks: classical and modern classifiers on the same windows, trials and split.

On the signals: logistic regression, support vector machines, extreme learning machines and extremely randomised trees
on three kinds of features, MiniRocket and a GRU on the sequences. On the spikes of the first encoder, the first four on
counts; on those of the others logistic regression. Each but MiniRocket is sized on validation windows. Opponents of
other packages join them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.preprocessing import StandardScaler

from neurotact.baselines.features import BandPowers, averaged, band_powers, bin_edges
from neurotact.baselines.opponent import (
    Candidate,
    Opponent,
    Opponents,
    Sides,
    Takes,
    Tells,
    first_best,
    joined,
    named,
    right,
    rounded,
    standardised,
)
from neurotact.data.augmentation import NONE
from neurotact.data.recordings import Recordings, select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.data.windows import Windows
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.specs import taxels_of
from neurotact.errors import number_of
from neurotact.metrics import paired
from neurotact.metrics.flops import Cost, Moments, Standardise, changed, cost, passed
from neurotact.metrics.signal_flops import Averaging, StandardisedSteps
from neurotact.progress import at, say

BINS = 10
"""Time bins of a window, in which spikes are counted and signals averaged."""
BANDS = 8
"""Bands of frequency, each about as wide in octaves."""
MOST_SAMPLES = 1000
"""Most steps of `signals`; longer windows are averaged."""
GRU_BIN_MS, GRU_STEPS = 20.0, 150
"""A bin of `sequences`, and the most bins of a window."""
LINEAR = "logistic regression"
SLOW = ("spectra of the signals", "a GRU")
"""What `quick` opponents leave out of `all`, in words."""
SIGNALS, SPIKES, EVENTS = "signals", "spikes", "events"
BITS = 8
"""Of an opponent's weights, as of those of the C export; inputs and biases have twice as many."""
ROUNDED = f"_{BITS}bit"
"""Ends the name of what a rounded opponent has."""
SETTINGS = {"settings": "", f"settings{ROUNDED}": ROUNDED}
"""Columns of what validation has chosen, by width."""
RIGHT, ERRORS = "right", "errors"
"""Keys of each row that are no columns of `baselines.csv`."""


class Input(NamedTuple):
    """An input of classifiers: features `(window, feature)` or sequences `(window, time, channel)`, and their cost.

    source: signals, spikes, or the events of an event-based sensor. pair: refractory periods of RA-I and SA-I in ms;
    None for signals. opponents: the classifiers that receive it.
    """

    source: str
    words: str
    pair: tuple[float, float] | None
    features: np.ndarray
    made: Cost
    opponents: Mapping[str, Opponent]

    @property
    def column(self) -> str:
        """The input as a column of `baselines.csv` names it."""
        return f"{self.source}: {self.words}"


class Cuts(NamedTuple):
    """Windows on the encoder's clock, and three boolean `(window,)` that select those of each side.

    copies: for each kind of varied copies (`data.augmentation`), the windows to train on with these copies.
    last: the cuts of the last training, after these have chosen, with the same test trials; None if there is none.
    tells: what the opponents tell of a window.
    """

    windows: Windows
    clock_Hz: float
    sides: tuple[np.ndarray, np.ndarray, np.ndarray]
    copies: Mapping[str, np.ndarray] = {}
    last: "Cuts | None" = None
    tells: Tells = "classes"

    @property
    def trained(self) -> Mapping[str, np.ndarray]:
        """The windows to train on, by the kind of varied copies; the recorded ones alone if there are none."""
        return self.copies or {NONE: self.sides[0]}

    def most_trained(self, kind: str) -> int:
        """The largest number of windows that one training has."""
        numbers = (int(cuts.trained[kind].sum()) for cuts in (self, self.last) if cuts is not None)
        return max(numbers)

    def with_training(self, kind: str) -> "Cuts":
        """The same windows, with one of `trained` for training."""
        return self._replace(sides=(self.trained[kind], *self.sides[1:]))

    @property
    def length_ms(self) -> float:
        return 1e3 * self.windows.n_steps / self.clock_Hz


def in_words(opponents: Opponents) -> str:
    """What a study's networks are compared with, as a sentence; empty for none.

    >>> in_words("linear"), in_words("quick")[:58]
    ('Compared with logistic regression.', 'Compared with logistic regression, SVM, ELM and extra tree')
    """
    if opponents == "none":
        return ""
    if opponents in ("linear", "readout"):
        return f"Compared with {LINEAR}."
    on_features, others = (list(joined(takes, "quick")) for takes in ("features", "signals"))
    others += joined("sequences", "quick")
    quick = f"Compared with {_listed(on_features)}, on signals and on spikes, and {', '.join(others)}"
    return f"{quick}{', without ' if opponents == 'quick' else '; also with '}{_listed(SLOW)}."


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def without_slow() -> str:
    """The warning of a first look whose opponents are `quick`."""
    return (
        f"a first look fits fewer networks, and leaves out {_listed(SLOW)}, which are strong on many sets: a "
        "difference that is clear here need not be clear in the whole study, nor its sign the same"
    )


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


def signal_inputs(
    recordings: Recordings, cuts: Cuts, opponents: Opponents, pieces: Sequence[np.ndarray] = ()
) -> Iterator[Input]:
    """Features of the signals, and the signals themselves as sequences, unless opponents are linear.

    pieces: the samples of each window, if they are not all in the recordings.
    """
    pieces = pieces or list(pieces_of(recordings, cuts.windows, cuts.clock_Hz))
    least, samples, taxels = min(map(len, pieces)), max(map(len, pieces)), recordings.n_channels
    is_linear = opponents in ("linear", "readout")
    of_features = joined("features", opponents, cuts.tells)
    moments = np.array([np.concatenate([piece.mean(axis=0), piece.std(axis=0)]) for piece in pieces])
    made = cost(Moments(samples, taxels, order=2), signal_ms=cuts.length_ms)
    yield Input(SIGNALS, "mean and deviation", None, moments, made, of_features)
    if is_linear:
        return
    n_bins = min(BINS, least)
    binned = averaged(pieces, n_bins)
    made = cost(Averaging(samples, n_bins, taxels), signal_ms=cuts.length_ms)
    yield Input(SIGNALS, number_of(n_bins, "time bin"), None, binned.reshape(len(binned), -1), made, of_features)
    n_bands = 0 if opponents == "quick" else min(BANDS, least // 2)
    if n_bands:
        powers = np.array([band_powers(piece, n_bands).ravel() for piece in pieces])
        made = cost(BandPowers(samples, n_bands, taxels), signal_ms=cuts.length_ms)
        yield Input(SIGNALS, f"power in {n_bands} bands", None, powers, made, of_features)
    for words, n_steps, of_sequences in _sequences_of("samples", cuts, least, opponents):
        made = Cost() if n_steps >= samples else cost(Averaging(samples, n_steps, taxels))
        made += cost(StandardisedSteps(n_steps, taxels), signal_ms=cuts.length_ms)
        yield Input(SIGNALS, words, None, averaged(pieces, n_steps, pieces[0].dtype), made, of_sequences)


def _sequences_of(
    words: str, cuts: Cuts, most: int, level: Opponents
) -> Iterator[tuple[str, int, dict[str, Opponent]]]:
    """Sequences of a window of `most` samples: their name, their steps, and the classifiers that receive them."""
    inputs: tuple[tuple[Takes, str, int], ...] = (
        ("signals", words, min(MOST_SAMPLES, most)),
        ("sequences", f"{GRU_BIN_MS:g} ms bins", gru_steps(cuts.length_ms, most)),
    )
    for takes, its_words, n_steps in inputs:
        found = joined(takes, level, cuts.tells)
        for name in [name for name, one in found.items() if n_steps < one.least_steps]:
            say(f"baselines: no {name}: windows have {n_steps} {its_words}; it needs {found.pop(name).least_steps}")
        if found:
            yield its_words, n_steps, found


def gru_steps(length_ms: float, most: int) -> int:
    """Bins of a window for the GRU: of 20 ms, at most `GRU_STEPS` and at most one a sample.

    >>> gru_steps(1000.0, 500), gru_steps(60_000.0, 500), gru_steps(1000.0, 20)
    (50, 150, 20)
    """
    return max(1, min(round(length_ms / GRU_BIN_MS), GRU_STEPS, most))


def spike_inputs(
    trains: SpikeTrains,
    pair: tuple[float, float],
    cuts: Cuts,
    opponents: Opponents = "quick",
    *,
    is_first: bool = True,
    encoding: bool = True,
) -> Iterator[Input]:
    """Spikes of each afferent, counted over the window and in `BINS` time bins; each spike is one addition.

    With `readout` opponents only the counts over the window, for logistic regression. The spikes that cost are those of
    test windows, as of networks.
    is_first: also for other classifiers than logistic regression. The events of an event-based sensor are its signal:
    they cost nothing to encode, and unless opponents are linear there are sequences of them, too. encoding: whether the
    energy of conditioning and encoding counts.
    """
    n_windows, n_steps, n_afferents = len(cuts.windows), cuts.windows.n_steps, len(trains.afferents)
    source = SPIKES if trains.encoder else EVENTS
    n_taxels = taxels_of(n_afferents, trains.encoder)
    is_counted = encoding and bool(trains.encoder)
    n_bins = min(BINS, n_steps)
    counts = trains.binned(cuts.windows, bin_edges(n_steps, n_bins))
    tested = counts[cuts.sides[2]]
    spikes = float(tested.sum()) / len(tested)
    how = {"recorded_Hz": trains.recorded_Hz, "spikes": spikes}
    encoded = encoding_cost(n_taxels, n_steps, cuts.length_ms, trains.encoder, **how) if is_counted else Cost()

    def made(n: int) -> Cost:
        """The cost of counts in so many bins."""
        counted = Cost(acs=spikes, signal_ms=cuts.length_ms, **changed(spikes), **passed(0, n * n_afferents))
        return counted + encoded

    of_features = joined("features", opponents if is_first else "linear", cuts.tells)
    yield Input(source, "counts", pair, counts.sum(axis=1).astype(float), made(1), of_features)
    if opponents == "readout":
        return
    flat = counts.reshape(n_windows, -1).astype(float)
    yield Input(source, number_of(n_bins, "time bin"), pair, flat, made(n_bins), of_features)
    if opponents == "linear" or source != EVENTS or not is_first:
        return
    for words, n_sequence, of_sequences in _sequences_of("steps", cuts, n_steps, opponents):
        sequences = trains.binned(cuts.windows, bin_edges(n_steps, n_sequence)).astype(np.float32)
        yield Input(source, words, pair, sequences, made(n_sequence), of_sequences)


def rows(inputs: Iterable[Input], labels: np.ndarray, cuts: Cuts) -> Iterator[dict[str, Any]]:
    """A row of `baselines.csv` for each classifier on each input.

    labels: the class of each window, `(window,)`, or its numbers, `(window, target)`, whose accuracies are mean scores;
    then `ERRORS` holds the root-mean-square error of each on test windows, in its unit.

    A slow one (`all`) is trained with the varied copies that were best for the classifiers before it. A
    classifier that is chosen is fitted again to the training windows of `cuts.last`, as networks are.
    With 8 bits (`ROUNDED`), if its opponent can be rounded, validation chooses among the same candidates after
    rounding; costs are those of the one that is chosen with 32 bits.
    Under `RIGHT` a row also has, for validation and test, the share of correctly classified windows of each trial, and
    the same with 8 bits.
    """
    best_yet: tuple[float, str] | None = None
    for one in inputs:
        for name, opponent in one.opponents.items():
            most = opponent.most_examples
            kinds = [kind for kind in cuts.trained if most is None or cuts.most_trained(kind) <= most]
            if not kinds:
                least = min(map(cuts.most_trained, cuts.trained))
                say(f"baselines: no {name} on {one.column}: {least} training windows, at most {most}")
                continue
            if opponent.joins == "all" and best_yet is not None and best_yet[1] in kinds:
                kinds = [best_yet[1]]
            at(f"{name} on {one.column}")
            with named(name):
                kind, sides, chosen = _best_training(one, opponent, labels, cuts, kinds)
                found = {f"validation{width}": each.right for width, each in chosen.items()}
                fitted, last = {width: each.candidate for width, each in chosen.items()}, cuts
                if cuts.last is not None:
                    last = cuts.last
                    sides = _sides(one, labels, last.with_training(kind))
                    distinct = {id(each): each for each in fitted.values()}  # mostly one
                    again = {key: each.again(sides) for key, each in distinct.items()}
                    fitted = {width: again[id(each)] for width, each in fitted.items()}
                for width, each in fitted.items():
                    found[f"test{width}"] = _right(opponent, each, sides, "test", width)
            trials = {"validation": cuts.windows.trial[cuts.sides[1]], "test": last.windows.trial[last.sides[2]]}
            by_trial = {side: paired.by_trial(trials[side.removesuffix(ROUNDED)], of) for side, of in found.items()}
            row = _row(one, name, fitted, sides, found)
            if best_yet is None or row["accuracy_validation"] > best_yet[0]:
                best_yet = row["accuracy_validation"], kind
            if cuts.copies:
                row |= {key: f"{row[key]}; varied copies: {kind}" for key in SETTINGS if row[key]}
            if labels.ndim > 1:
                row[ERRORS] = _errors(fitted[""], sides, labels[last.trained[kind]])
            yield {**row, RIGHT: by_trial}


class _Chosen(NamedTuple):
    """A candidate, and whether it, as wide as it was chosen, classifies each validation window correctly."""

    candidate: Candidate
    right: np.ndarray


def _right(opponent: Opponent, one: Candidate, sides: Sides, side: str, width: str) -> np.ndarray:
    """Whether each window of a side is classified correctly; width: `ROUNDED`, or empty for 32 bits."""
    x, y, fitted = getattr(sides, side), getattr(sides, f"y_{side}"), one.fitted
    if width and opponent.rounded is not None:
        fitted, x = opponent.rounded(fitted, sides.train, BITS), rounded(x, 2 * BITS, of=sides.train)
    return right(fitted.predict(x), y)


def _errors(one: Candidate, sides: Sides, training: np.ndarray) -> list[float]:
    """The root-mean-square error of each number on test windows in its unit; training: numbers of training windows."""
    wrong = one.fitted.predict(sides.test).reshape(sides.y_test.shape) - sides.y_test
    return (np.sqrt(np.square(wrong).mean(axis=0)) * training.std(axis=0, dtype=float)).tolist()


def _best_candidates(opponent: Opponent, sides: Sides) -> dict[str, _Chosen]:
    """The first of the most accurate candidates on validation windows by width: with 32 bits, and rounded if it can be.

    None is fitted after the best of each width make no error.
    """
    best: dict[str, _Chosen] = {}
    for one in opponent.candidates(sides, 0):
        for width in ("", ROUNDED) if opponent.rounded is not None else ("",):
            found = _right(opponent, one, sides, "validation", width)
            if width not in best or found.mean() > best[width].right.mean():
                best[width] = _Chosen(one, found)
        if all(each.right.min() == 1 for each in best.values()):
            break
    return best


def _best_training(
    one: Input, opponent: Opponent, labels: np.ndarray, cuts: Cuts, kinds: Sequence[str]
) -> tuple[str, Sides, dict[str, _Chosen]]:
    """The best candidates of an opponent, with the varied copies by which that with 32 bits is most accurate."""

    def training(kind: str) -> tuple[float, tuple[str, Sides, dict[str, _Chosen]]]:
        sides = _sides(one, labels, cuts.with_training(kind))
        best = _best_candidates(opponent, sides)
        return float(best[""].right.mean()), (kind, sides, best)

    return first_best(map(training, kinds))[1]


def _sides(one: Input, labels: np.ndarray, cuts: Cuts) -> Sides:
    """The input of each side; features, channels and numbers are standardised on training windows, events are not.

    A channel of rare events, divided by its deviation, would be loudest where it tells least: a GRU on Braille letters
    has 72 % with and 79 % without.
    """
    if labels.ndim > 1:
        known = labels[cuts.sides[0]].astype(np.float64)
        labels = (labels - known.mean(axis=0)) / known.std(axis=0)
    if one.features.ndim == 3:
        if one.source == EVENTS:
            return Sides(*(one.features[side] for side in cuts.sides), *(labels[side] for side in cuts.sides))
        return standardised(one.features, labels, cuts.sides)
    scaler = StandardScaler().fit(one.features[cuts.sides[0]])
    return Sides(*(scaler.transform(one.features[side]) for side in cuts.sides), *(labels[side] for side in cuts.sides))


def _row(
    one: Input, name: str, fitted: Mapping[str, Candidate], sides: Sides, right: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """The row of classifiers by width; right: of validation and test, whether each window is classified correctly."""
    scaling = (Standardise(one.features.shape[1]),) if one.features.ndim == 2 else ()
    spent = fitted[""].spent(one.made + cost(*scaling))
    ra_ms, sa_ms = one.pair if one.pair else (None, None)
    return {
        "classifier": name,
        "input": one.column,
        "t_ref_ra_ms": ra_ms,
        "t_ref_sa_ms": sa_ms,
        **{key: fitted[width].settings if width in fitted else "" for key, width in SETTINGS.items()},
        "n_train": len(sides.y_train),
        "n_validation": len(right["validation"]),
        "n_test": len(sides.y_test),
        **{
            f"accuracy_{side}{width}": float(np.mean(right.get(f"{side}{width}", np.nan)))
            for width in ("", ROUNDED)
            for side in ("validation", "test")
        },
        **{name: value for name, value in spent.items() if name != "sops"},
    }
