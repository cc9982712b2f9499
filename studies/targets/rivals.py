"""The rivals of a detector: classifiers on a sliding window of signals or spikes, judged by the same rule.

Each is sized on validation windows, as those of classes are, and tells the label in force at the end of a window. It
then decides all along a recording, at most `EVERY_MS` apart. Its threshold is chosen on validation recordings, and what
it detects is judged, as of a network (`streams.detector`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.opponents.scikit_learn import LOGISTIC_REGRESSION
from neurotact_parts.streams import detector
from neurotact_parts.streams.detector import Heard
from neurotact_parts.studies.targets.measured import DELAYS
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

from neurotact.baselines import opponent, opponents
from neurotact.baselines.opponents import Cuts, Input
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.data.windows import Windows, steps_of
from neurotact.encoders.specs import t_ref_pair_ms
from neurotact.metrics.flops import Cost, Standardise, cost
from neurotact.metrics.prices import PriceList
from neurotact.networks.training import events, tasks
from neurotact.networks.training.tasks import Task
from neurotact.progress import at, say
from neurotact.studies import tables_beside
from neurotact.studies.cell import task_of
from neurotact.studies.study import Cell, StudySpec, split_columns, value_at

EVERY_MS = 10.0
"""Between two decisions of a rival, about."""
LINEAR_SVM = replace(
    LOGISTIC_REGRESSION,
    about="A linear support vector machine for each label with one of several penalties; all cost the same.",
    build=partial(LinearSVC, dual=False),
)
KINDS = {"SVM": ("linear SVM", LINEAR_SVM)}
"""By the rivals of classes in whose place they are: SVM gives votes between pairs, no graded score. At 10 false alarms
an hour it found 11 of 52 slips from spikes in time bins, where logistic regression found 50."""
LEAST = 1e-3
"""Added to a probability before its logarithm: that of one label for which no tree of a forest is."""
SIDES = ("train", "validation", "test")


class Sliding(NamedTuple):
    """Windows all along recordings. every: steps between two. labels: in force at the end of each, `(window,)`.

    cuts: those of the windows that are trained on and chosen by, about as far apart as the network's.
    """

    trains: SpikeTrains
    task: Task
    parts: Split
    every: int
    labels: np.ndarray
    cuts: Cuts

    @classmethod
    def of(cls, trains: SpikeTrains, task: Task) -> "Sliding":
        """The windows of a task's length."""
        rate_Hz = trains.sampling_rate_Hz
        length, _, hop = steps_of(task.window, rate_Hz)
        every = max(1, round(1e-3 * EVERY_MS * rate_Hz))
        starts = [np.arange(0, n - length + 1, every) for n in trains.trial_steps.tolist()]
        windows = Windows(np.repeat(np.arange(len(trains)), [*map(len, starts)]), np.concatenate(starts), length)
        parts, apart = tasks.trials_of(trains, task), max(1, round(hop / every))
        chosen = windows.start // every % apart == 0
        train, validation, test = (chosen & np.isin(windows.trial, side) for side in parts)
        cuts = Cuts(windows, rate_Hz, (train, validation, test))
        return cls(trains, task, parts, every, events.labels_of(trains, windows).numpy(), cuts)

    def heard(self, values: np.ndarray, trials: Sequence[int] | np.ndarray) -> list[Heard]:
        """Recordings as a rival hears them; values: of each label in each window, `(window, label)`.

        Before the first whole window no label leads.
        """
        names, rate_Hz = events.names_of(self.trains), self.trains.sampling_rate_Hz
        before = -(-self.cuts.windows.n_steps // self.every) - 1
        found = []
        for trial in map(int, trials):
            told = values[self.cuts.windows.trial == trial]
            padded = np.concatenate([np.zeros((before, len(names))), told])
            lasts_s = float(self.trains.trial_steps[trial] / rate_Hz)
            found.append(
                Heard(trial, padded, self.every / rate_Hz, lasts_s, detector.marked(self.trains, trial, names))
            )
        return found


def values_of(fitted: Any, features: np.ndarray, n_labels: int) -> np.ndarray:
    """The value of each label in each window, `(window, label)`: of one that was not trained on, the least.

    Of probabilities, their logarithms: leads of many votes to few then differ, as those of other scores do.

    >>> class Fitted:
    ...     classes_ = np.array([0, 2])
    ...     decision_function = staticmethod(lambda x: x[:, 0])
    >>> values_of(Fitted(), np.array([[3.0], [-1.0]]), 3).tolist()
    [[-3.0, -3.0, 3.0], [1.0, -3.0, -1.0]]
    """
    if hasattr(fitted, "decision_function"):
        scores = np.asarray(fitted.decision_function(features), float)
    else:
        scores = np.log(LEAST + fitted.predict_proba(features))
    scores = np.stack([-scores, scores], axis=1) if scores.ndim == 1 else scores
    values = np.full((len(scores), n_labels), scores.min())
    values[:, np.asarray(fitted.classes_)] = scores
    return values


def rows_of(
    folder: Path, recordings: Recordings, study: StudySpec, cell: Cell, _cells: Sequence[Cell], *, is_first: bool
) -> Iterator[dict[str, Any]]:
    """Rows of `baselines.csv` on the spikes of one cell; if `is_first`, also on signals.

    Accuracies are of windows, energy is of a second. Under `RIGHT` are the scores of validation and test recordings,
    and the mean delay of the hits of each test recording.
    """
    sliding = Sliding.of(hdf5.load_spikes(folder / cell.given), task_of(cell))
    split = {key: value_at(cell, key) for key in split_columns(study)}
    first_ms, second_ms = t_ref_pair_ms(cell.encoder)
    level = "linear" if study.baselines in ("linear", "readout") else "quick"
    of_signals = opponents.signal_inputs(recordings, sliding.cuts, level) if is_first else iter(())
    pair, counts = (second_ms, first_ms), study.encoding_in == "processor"
    of_spikes = opponents.spike_inputs(sliding.trains, pair, sliding.cuts, level, is_first=is_first, encoding=counts)
    for one in chain(islice(of_signals, 2), islice(of_spikes, 2)):
        for name, rival in (KINDS.get(name, (name, rival)) for name, rival in one.opponents.items()):
            n_train = int(sliding.cuts.sides[0].sum())
            if rival.most_examples is not None and n_train > rival.most_examples:
                say(f"baselines: no {name} on {one.column}: {n_train} training windows, at most {rival.most_examples}")
                continue
            at(f"{name} on {one.column}")
            with opponent.named(name):
                row = _row(one, name, rival, sliding, study.prices)
                yield {"dataset": cell.dataset, **split, **row, **tables_beside.encoder_of(row, study, cell)}


def _row(one: Input, name: str, rival: opponent.Opponent, sliding: Sliding, prices: PriceList) -> dict[str, Any]:
    scaled = StandardScaler().fit(one.features[sliding.cuts.sides[0]]).transform(one.features)
    sides = sliding.cuts.sides
    given = opponent.Sides(*(scaled[side] for side in sides), *(sliding.labels[side] for side in sides))
    best = opponent.best_of(rival, given, 0)
    held, test = (_heard(best, scaled, sliding, side) for side in (sliding.parts.validation, sliding.parts.test))
    rule = detector.rule_for([*held, *_left_out(best, scaled, sliding, held)], sliding.task)
    found, _, _ = detector.judged(sliding.trains, test, rule)
    scores = {"validation": detector.scores(held, rule), "test": detector.scores(test, rule)}
    scores[DELAYS] = detector.delays_ms(test, rule)
    accuracies = {
        f"accuracy_{side}": opponent.accuracy(best, scaled[place], sliding.labels[place])
        for side, place in zip(SIDES[1:], sides[1:], strict=True)
    }
    ra_ms, sa_ms = one.pair if one.pair else (None, None)
    return {
        "classifier": name, "input": one.column, "t_ref_ra_ms": ra_ms, "t_ref_sa_ms": sa_ms, "settings": best.settings,
        **{f"n_{side}": int(place.sum()) for side, place in zip(SIDES, sides, strict=True)},
        **accuracies, **found, "nJ_per_s": _nJ_per_s(best, one, sliding, prices), opponents.RIGHT: scores,
    }  # fmt: skip


def _heard(fitted: opponent.Candidate, features: np.ndarray, sliding: Sliding, trials: np.ndarray) -> list[Heard]:
    used, n_labels = np.isin(sliding.cuts.windows.trial, trials), len(events.names_of(sliding.trains))
    values = np.zeros((len(features), n_labels))
    values[used] = values_of(fitted.fitted, features[used], n_labels)
    return sliding.heard(values, trials)


def _left_out(
    best: opponent.Candidate, features: np.ndarray, sliding: Sliding, validation: Sequence[Heard]
) -> Iterator[Heard]:
    """Training recordings, each as the same settings hear it that were fitted without it (`detector.turns`)."""
    trial = sliding.cuts.windows.trial
    for turn in detector.turns(sliding.trains, sliding.parts, sliding.task, validation):
        train, _, test = sliding.cuts.sides
        sides = train & np.isin(trial, turn.train), train & np.isin(trial, turn.validation), test
        given = opponent.Sides(*(features[side] for side in sides), *(sliding.labels[side] for side in sides))
        yield from _heard(best.again(given), features, sliding, turn.validation)


def _nJ_per_s(best: opponent.Candidate, one: Input, sliding: Sliding, prices: PriceList) -> float:  # noqa: N802
    """Energy of a second: the features of its samples and spikes once, and each of its decisions."""
    if best.layers is None:
        return float("nan")
    window_s = sliding.cuts.windows.n_steps / sliding.trains.sampling_rate_Hz
    decision: Cost = cost(Standardise(one.features.shape[1]), *best.layers)
    spent = one.made.times(1 / window_s) + decision.times(sliding.trains.sampling_rate_Hz / sliding.every)
    return spent.energy_nJ(prices)
