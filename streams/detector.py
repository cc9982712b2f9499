"""A detector of events in a stream of values: its rule, step by step and on whole recordings, its choice and its test.

A value of each label comes after each step of a network that runs on without a reset. A label leads where it is the
largest by more than a threshold. It is in force from the step on at which it has led for so many steps in a row, where
an event begins, unless the label is `marks.NONE`. What begins while its mark is in force is a hit, once; else a false
alarm.

A threshold is chosen on recordings without training: few minutes of them hold few false alarms, so that training
recordings are heard, too, each by another network that was not trained on it, and counts at all thresholds are used. On
simulated slips, where 10 an hour were allowed, the rule with most hits and no false alarm in 30 s of validation had 138
an hour in 20 min of other recordings, of whose events it found 96 %. Of 270 s without training and by the line through
counts (`rare_from`) the rule has 15 and finds 87 %; where 60 or 200 are allowed, 75 (96 %) and 190 (99 %).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from neurotact_parts.streams.long_recordings import PART_S, RECORDING

from neurotact.data import marks
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.data.windows import Windows
from neurotact.errors import InputError, in_digits
from neurotact.metrics import synops
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.definition.network import Network
from neurotact.networks.exit.rule import leads
from neurotact.networks.training import numbers
from neurotact.networks.training.events import DetectorSpec, in_parts, labels_of, names_of
from neurotact.networks.training.run_folder import Restored
from neurotact.networks.training.tasks import Task
from neurotact.progress import at

THRESHOLDS = 40
"""How many thresholds are tried: quantiles of the lead on validation recordings."""
FALSE_ALARMS_PER_H = 10.0
"""Where a task does not say how many are allowed."""
TURNS = 3
"""Parts of the training recordings that are left out in turn, where validation recordings are short."""
SHOWS = 3.0
"""Without a false alarm in the time of so many, a rate is below the allowed one by a bound of 95 %."""
SHARES = 0.99, 0.95, 0.9, 0.8, 0.5
"""Of hits, whose false alarms are printed of an operating curve."""
COLUMNS = ["trial", "label", "start_s", "stop_s", "detected_s", "ended_s", "delay_ms", "outcome"]
HIT, MISS, FALSE_ALARM, REPEAT, BEGUN = "hit", "miss", "false alarm", "repeat", "begun before"
"""What becomes of a mark or a detection; `BEGUN`: in a mark that begins with the recording, whose onset is unknown."""


class Standing(NamedTuple):
    """The label in force, the one that leads (-1: none), and for how many steps it has."""

    current: int = 0
    leading: int = -1
    led: int = 0

    def after(self, values: np.ndarray, rule: DetectorSpec) -> "Standing":
        """One step later; values: of each label, `(label,)`.

        >>> first = Standing().after(np.array([0.0, 2.0]), rule := DetectorSpec(threshold=1, steps=2))
        >>> first.current, first.after(np.array([0.0, 2.0]), rule).current
        (0, 1)
        """
        leading = int(_leading(values[None], rule)[0])
        led = self.led + 1 if leading == self.leading else 1
        return Standing(leading if leading >= 0 and led >= rule.steps else self.current, leading, led)


def _leading(values: np.ndarray, rule: DetectorSpec) -> np.ndarray:
    """The label that leads after each step, `(step,)`; -1: none by more than the threshold."""
    return np.where(lead_of(values) > rule.threshold, values.argmax(axis=1), -1)


def lead_of(values: np.ndarray) -> np.ndarray:
    """By how much the largest value exceeds the next one, `(step,)`."""
    return leads(torch.from_numpy(values)).numpy()


def changes(values: np.ndarray, rule: DetectorSpec) -> Iterator[tuple[int, int]]:
    """The steps at which another label comes into force, and that label: as `Standing.after` step by step.

    >>> [*changes(np.array([[0.0, 2.0]] * 3 + [[2.0, 0.0]] * 2), DetectorSpec(threshold=1, steps=2))]
    [(1, 1), (4, 0)]
    """
    leading, current = _leading(values, rule), 0
    begins = np.flatnonzero(np.diff(leading, prepend=-2))
    for begin, length in zip(begins.tolist(), np.diff(begins, append=len(leading)).tolist(), strict=True):
        label = int(leading[begin])
        if label >= 0 and label != current and length >= rule.steps:
            yield begin + rule.steps - 1, label
            current = label


class Heard(NamedTuple):
    """A recording as a detector hears it: values `(step, label)`, and its marks as label, start and stop."""

    trial: int
    values: np.ndarray
    step_s: float
    lasts_s: float
    marked: list[tuple[int, float, float]]


def values_of(network: Network, trains: SpikeTrains, trial: int) -> np.ndarray:
    """The value of each label after each whole step of the network, through a trial without reset, `(step, label)`."""
    whole = trains.raster(Windows(np.array([trial]), np.zeros(1, np.int64), int(trains.trial_steps[trial])))
    return run_on(network, whole[0])[1]


@torch.no_grad()
def run_on(network: Network, raster: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hidden spikes `(step, hidden)` and values `(step, label)` at each whole step of the network, without reset.

    raster: spikes of afferents on the encoder's clock, `(step, afferent)`.
    """
    whole = raster[: len(raster) // network.steps_per_bin * network.steps_per_bin]
    hidden, gained = network.simulate(torch.from_numpy(whole)[None].to(network.device))
    integration = network.integration
    assert integration is not None
    return hidden[0].cpu().numpy(), torch.stack([*integration.cpu().over(gained[0].cpu())]).numpy()


def heard(network: Network, trains: SpikeTrains, trials: Iterable[int], names: Sequence[str]) -> list[Heard]:
    """Recordings, each through a network without reset. names: of its labels."""
    found, rate_Hz = [], trains.sampling_rate_Hz
    for trial in map(int, trials):
        values, lasts_s = values_of(network, trains, trial), float(trains.trial_steps[trial] / rate_Hz)
        found.append(Heard(trial, values, network.steps_per_bin / rate_Hz, lasts_s, marked(trains, trial, names)))
    return found


def marked(trains: SpikeTrains, trial: int, names: Sequence[str]) -> list[tuple[int, float, float]]:
    """The marks of a recording as label, start and stop; a label that is none of the names is -1."""
    index = {name: number for number, name in enumerate(names)}
    table = pd.DataFrame(columns=marks.COLUMNS) if trains.marks is None else trains.marks
    own = table[table["trial"] == trial]
    return [(index.get(row.label, -1), float(row.start_s), float(row.stop_s)) for row in own.itertuples()]


def rows_of(one: Heard, rule: DetectorSpec) -> list[tuple[Any, ...]]:
    """What became of the marks of a recording and of what was detected, as `COLUMNS`, labels by their numbers."""
    rows, hit, none = [], set(), float("nan")
    begun = [((step + 1) * one.step_s, label) for step, label in changes(one.values, rule)]
    for (time_s, label), (ended_s, _) in pairwise([*begun, (one.lasts_s, 0)]):
        if not label:
            continue
        place = next((i for i, (its, a, b) in enumerate(one.marked) if its == label and a <= time_s <= b), None)
        its, start_s, stop_s = (label, none, none) if place is None else one.marked[place]
        outcome = FALSE_ALARM if place is None else REPEAT if place in hit else HIT if start_s > 0 else BEGUN
        hit |= {place}
        delay_ms = 1e3 * (time_s - start_s) if outcome == HIT else none
        rows.append((one.trial, its, start_s, stop_s, time_s, ended_s, delay_ms, outcome))
    missed = [mark for i, mark in enumerate(one.marked) if i not in hit and mark[1] > 0]
    return rows + [(one.trial, *mark, none, none, none, MISS) for mark in missed]


class Tally(NamedTuple):
    """Delays of hits in ms, and the recording of each; counts; hours that were listened to."""

    delays_ms: np.ndarray
    trials: np.ndarray
    missed: int
    false_alarms: int
    hours: float

    @property
    def per_h(self) -> float:
        """False alarms an hour."""
        return self.false_alarms / self.hours

    @property
    def share(self) -> float:
        """The share of events that are found; NaN where there are none."""
        n = len(self.delays_ms) + self.missed
        return len(self.delays_ms) / n if n else float("nan")

    @property
    def delay_ms(self) -> float:
        """The mean delay of hits; NaN without one."""
        return float(self.delays_ms.mean()) if len(self.delays_ms) else float("nan")


def tally(recordings: Sequence[Heard], rule: DetectorSpec) -> Tally:
    """What a rule comes to on recordings."""
    rows = [row for one in recordings for row in rows_of(one, rule)]
    hits = [(row[6], row[0]) for row in rows if row[7] == HIT]
    delays, trials = np.array(hits).reshape(-1, 2).T
    missed, wrong = (sum(row[7] == what for row in rows) for what in (MISS, FALSE_ALARM))
    return Tally(delays, trials, missed, wrong, sum(one.lasts_s for one in recordings) / 3600)


def thresholds(recordings: Sequence[Heard]) -> list[float]:
    """The thresholds that are tried, ascending."""
    every = np.concatenate([lead_of(one.values) for one in recordings])
    return sorted({0.0, *np.quantile(every, np.linspace(0, 1, THRESHOLDS)).tolist()})


def scores(recordings: Sequence[Heard], rule: DetectorSpec) -> dict[int, float]:
    """By recording, the share of hits among its events and false alarms; 1 where there are neither."""
    found = {}
    for one in recordings:
        outcomes = [row[7] for row in rows_of(one, rule)]
        hits, others = outcomes.count(HIT), outcomes.count(MISS) + outcomes.count(FALSE_ALARM)
        found[one.trial] = hits / (hits + others) if hits + others else 1.0
    return found


def delays_ms(recordings: Sequence[Heard], rule: DetectorSpec) -> dict[int, float]:
    """By recording, the mean delay of its hits; without those that have none."""
    found = {one.trial: [row[6] for row in rows_of(one, rule) if row[7] == HIT] for one in recordings}
    return {trial: float(np.mean(delays)) for trial, delays in found.items() if delays}


def choose(
    network: Network, trains: SpikeTrains, split: Split, task: Task, again: Callable[[Split], Network]
) -> DetectorSpec:
    """As `rule_for` recordings without training, as a network hears them. again: trains one for another split."""
    names = names_of(trains)
    recordings = heard(network, trains, split.validation, names)
    for turn in turns(trains, split, task, recordings):
        recordings += heard(again(turn), trains, turn.validation, names)
    return rule_for(recordings, task)


def turns(trains: SpikeTrains, split: Split, task: Task, validation: Sequence[Heard]) -> Iterator[Split]:
    """Splits that leave out each part of the training recordings in turn; none where validation is long enough.

    A part holds whole groups of the task's split, and leaves at least two labels for training.
    """
    if sum(one.lasts_s for one in validation) / 3600 * allowed_per_h(task) >= SHOWS:
        return
    groups, own = list(task.split.group), trains.conditions.iloc[split.train]
    turn = (own.groupby(groups).ngroup() if groups else pd.Series(range(len(own)))).to_numpy() % TURNS
    for number in range(TURNS):
        train, held = split.train[turn != number], split.train[turn == number]
        windows = trains.cut(task.training_window, train)
        if len(held) and len(windows.trial) and len(labels_of(trains, windows).unique()) > 1:
            at("threshold", number, TURNS)
            yield Split(train, held, split.test)


def allowed_per_h(task: Task) -> float:
    """How many false alarms an hour a task allows."""
    return FALSE_ALARMS_PER_H if task.false_alarms_per_h is None else task.false_alarms_per_h


def rule_for(recordings: Sequence[Heard], task: Task) -> DetectorSpec:
    """The rule for at most as many false alarms an hour on recordings without training as a task allows.

    Both the count and the line of `rare_from` must allow it. Of these, the rule with most hits, then with the least
    delay; where none is so rare, the one with the fewest. A label leads for half of a window at most.
    """
    hours, most_per_h = sum(one.lasts_s for one in recordings) / 3600, allowed_per_h(task)
    longest = int(1e-3 * task.window.length_ms / recordings[0].step_s + 1e-6)
    tried, found = thresholds(recordings), []
    for steps in (2**power for power in range(max(1, longest // 2).bit_length())):
        rules = [DetectorSpec(threshold=least, steps=steps) for least in tried]
        own = [tally(recordings, rule) for rule in rules]
        rare = rare_from(tried, [one.false_alarms for one in own], most_per_h * hours)
        for rule, one in zip(rules, own, strict=True):
            excess = max(0.0, one.per_h - most_per_h), rule.threshold < rare
            found.append(((*excess, one.missed, one.delays_ms.sum(), -rule.threshold), rule, one.false_alarms))
    _, rule, false_alarms = min(found, key=lambda each: each[0])
    return rule.model_copy(update={"heard_s": 3600 * hours, "false_alarms": false_alarms})


def rare_from(tried: Sequence[float], counts: Sequence[int], most: float) -> float:
    """The threshold from which on at most so many false alarms are expected, and one where fewer are asked for.

    Of the largest count and those behind it, logarithms of 2 and more are on a line; one that does not fall rules out
    nothing. A count of 0 or 1 alone is luck: of many rules, the best of those without a false alarm has more elsewhere.

    >>> round(rare_from([0.0, 1.0, 2.0, 3.0, 4.0], [3, 8, 4, 0, 0], 2.0), 6), rare_from([0.0, 1.0], [0, 0], 2.0)
    (3.0, 0.0)
    """
    thresholds, n = np.array(tried), np.array(counts)
    used = (np.arange(len(n)) >= n.argmax()) & (n >= 2)
    if not used.any() or n[used][0] == n[used][-1]:
        return 0.0
    slope, level = np.polyfit(thresholds[used], np.log(n[used]), 1)
    if slope >= 0:
        return 0.0
    return float(min((np.log(max(1.0, most)) - level) / slope, thresholds[-1]))


def judge(
    network: Network, trains: SpikeTrains, trials: Iterable[int], rule: DetectorSpec
) -> tuple[dict[str, float], dict[str, pd.DataFrame], list[str]]:
    """As `judged`, of test recordings as a network hears them."""
    return judged(trains, heard(network, trains, trials, names_of(trains)), rule)


def judged(
    trains: SpikeTrains, recordings: Sequence[Heard], rule: DetectorSpec
) -> tuple[dict[str, float], dict[str, pd.DataFrame], list[str]]:
    """What a detector comes to on test recordings, as columns of results; its tables, by their files; lines of words.

    Intervals are those of `row_of`.
    """
    names, found = names_of(trains), tally(recordings, rule)
    row = {**row_of(found), "detector_threshold": rule.threshold, "detector_steps": rule.steps,
           "chosen_on_s": rule.heard_s, "chosen_with_false_alarms": rule.false_alarms}  # fmt: skip
    curve = []
    for least in thresholds(recordings):
        at = tally(recordings, rule.model_copy(update={"threshold": least}))
        curve.append((least, rule.steps, at.share, at.per_h, at.delay_ms))
    columns = ["threshold", "steps", "hit_share", "false_alarms_per_h", "delay_ms"]
    tables = {
        "events.csv": events_of(trains, recordings, rule, names),
        "operating_curve.csv": pd.DataFrame(curve, columns=columns),
    }
    return row, tables, [*_lines(row), *_curve(tables["operating_curve.csv"])]


def row_of(found: Tally) -> dict[str, float]:
    """Columns of results of a tally.

    Intervals are of 95 %: of the share of hits Wilson's, of the rate of false alarms that of a Poisson count (Garwood
    1936), of the delay that of recordings drawn with replacement.
    """
    n_events = len(found.delays_ms) + found.missed
    shares = wilson_interval(found.share, n_events) if n_events else (float("nan"),) * 2
    rates = rates_of(found.false_alarms, found.hours)
    delays = numbers.interval(found.delays_ms, found.trials) if len(found.delays_ms) else (float("nan"),) * 2
    return {
        "events_test": n_events, "hits": len(found.delays_ms), "misses": found.missed, "hit_share": found.share,
        "hit_share_low": shares[0], "hit_share_high": shares[1], "false_alarms": found.false_alarms,
        "false_alarms_per_h": found.per_h, "false_alarms_per_h_low": rates[0],
        "false_alarms_per_h_high": rates[1], "delay_ms": found.delay_ms,
        "delay_ms_low": delays[0], "delay_ms_high": delays[1], "tested_s": 3600 * found.hours,
    }  # fmt: skip


def rates_of(false_alarms: int, hours: float) -> tuple[float, float]:
    """The 95 % interval of a rate an hour.

    >>> [round(rate, 1) for rate in rates_of(0, 1.0)]
    [0.0, 3.7]
    """
    from scipy.stats import chi2

    n = 2 * false_alarms
    return float(chi2.ppf(0.025, n) / 2 / hours) if n else 0.0, float(chi2.ppf(0.975, n + 2) / 2 / hours)


def events_of(
    trains: SpikeTrains, recordings: Sequence[Heard], rule: DetectorSpec, names: Sequence[str]
) -> pd.DataFrame:
    """What became of each mark and of each detection, a row each, with times from the begin of the recording."""
    rows = [row for one in recordings for row in rows_of(one, rule)]
    table = pd.DataFrame(rows, columns=COLUMNS).assign(label=[names[row[1]] if row[1] >= 0 else "" for row in rows])
    if trains.marks is None:
        table["outcome"] = ""
    if PART_S in trains.conditions:
        parts = trains.conditions.iloc[table["trial"]].reset_index(drop=True)
        for name in ("start_s", "stop_s", "detected_s", "ended_s"):
            table[name] += parts[PART_S]
        table["trial"] = parts[RECORDING]
    return table.sort_values(["trial", "detected_s"], ignore_index=True)


def detected(restored: Restored, trains: SpikeTrains, *, test_only: bool = False) -> pd.DataFrame:
    """`events_of` recordings, and the side of each: parts of those that a detector was trained on, whole others.

    test_only: of its test recordings alone.
    """
    known, rule = restored.provenance, restored.detector
    assert known is not None
    assert rule is not None
    parts = in_parts(trains, restored.task.parts)
    trains = parts if (known.sides(parts) != synops.UNSEEN).any() else trains
    sides, tables = known.sides(trains), []
    for trial in known.tested(trains) if test_only else range(len(trains)):
        found = heard(restored.network, trains, [trial], restored.classes)
        tables.append(events_of(trains, found, rule, restored.classes).assign(side=sides[trial]))
    if not tables:
        raise InputError("spikes: hold none of the detector's test recordings; give those that it was trained on")
    return pd.concat(tables, ignore_index=True)


def _lines(row: dict[str, float]) -> Iterator[str]:
    """What a detector comes to, in words, from a row of results."""
    yield (
        f"events: {row['hits']} of {row['events_test']} found ({100 * row['hit_share']:.0f} %, 95 % interval "
        f"{100 * row['hit_share_low']:.0f} to {100 * row['hit_share_high']:.0f} %), {row['misses']} missed; delay "
        f"{row['delay_ms']:.0f} ms (95 % interval {row['delay_ms_low']:.0f} to {row['delay_ms_high']:.0f} ms)"
    )
    yield (
        f"false alarms: {row['false_alarms']} in {row['tested_s']:.0f} s, {in_digits(row['false_alarms_per_h'])} an "
        f"hour (95 % interval {in_digits(row['false_alarms_per_h_low'])} to "
        f"{in_digits(row['false_alarms_per_h_high'])})"
    )
    if row["chosen_on_s"]:
        low, high = rates_of(int(row["chosen_with_false_alarms"]), row["chosen_on_s"] / 3600)
        yield (
            f"threshold: chosen on {row['chosen_on_s']:.0f} s without training, with {row['chosen_with_false_alarms']} "
            f"false alarms there (95 % interval {in_digits(low)} to {in_digits(high)} an hour)"
        )


def _curve(table: pd.DataFrame) -> Iterator[str]:
    """The operating curve of test recordings in a line: the fewest false alarms for each of some shares of hits."""
    points = []
    for share in SHARES:
        enough = table[table["hit_share"] >= share]
        if len(enough):
            best = enough.loc[enough["false_alarms_per_h"].idxmin()]
            points.append(f"{share:.0%} at {in_digits(best['false_alarms_per_h'])} ({best['delay_ms']:.0f} ms)")
    if points:
        yield f"operating curve on test recordings: found, at false alarms an hour (delay): {', '.join(points)}"
