"""The encoder in a report: figures after the texture paper's Figs. 5, 6 and 10, and their captions."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.specs import populations
from neurotact.errors import number_of
from neurotact.figures import encoding as encoding_figures
from neurotact.figures.columns import in_unit
from neurotact.figures.encoding import Classes
from neurotact.figures.style import Drawn
from neurotact.report import periods
from neurotact.report.periods import named
from neurotact.report.tables import in_the_paper
from neurotact.studies.encoding_tables import TOUCH
from neurotact.studies.study import StudySpec
from neurotact.tables import natural

MOST_ROWS = 3
MOST_CLASSES = 5
SHOWN_s = 1.0


class _View(NamedTuple):
    """The layout of the conditions of trials: one of them varies, the others have their first value."""

    by: tuple[str, ...]
    vary: str | None
    fixed: dict[str, Any]
    values: tuple[Any, ...]

    @property
    def at(self) -> dict[str, Any]:
        """The condition to show if there can be only one: the highest value of the varying one."""
        return {**self.fixed, **({self.vary: self.values[-1]} if self.vary else {})}


def encoding_drawings(
    study: StudySpec, trains: SpikeTrains | None, encoding: pd.DataFrame, classes: Classes
) -> Iterator[Drawn]:
    """Rasters (if there are spike trains), spike counts, firing rates and inter-spike intervals.

    encoding: a run's `encoding.csv` with the column `pair`.
    """
    view = _view_of(encoding, study.dataset.stratify)
    if trains is not None:
        yield _rasters(study, trains, view, classes)
    yield _spike_counts(study, encoding, view, classes)
    yield _rates(study, encoding, view, classes)
    yield _isis(study, encoding, view, classes)


def _view_of(encoding: pd.DataFrame, stratify: Sequence[str]) -> _View:
    """Force varies if there is one, else the first condition that the study balances.

    >>> table = pd.DataFrame({"label": ["a", "a"], "speed_mm_per_s": [8.6, 13.7], "force_N": [12.0, 3.0]})
    >>> _view_of(table, ["speed_mm_per_s", "force_N"]).at
    {'speed_mm_per_s': 8.6, 'force_N': 12.0}
    """
    by = tuple(column for column in stratify if column in encoding)
    vary = "force_N" if "force_N" in by else (by[0] if by else None)
    fixed = {column: encoding[column].tolist()[0] for column in by if column != vary}
    values = tuple(sorted(set(encoding[vary]))) if vary else ()
    return _View(by, vary, fixed, values)


def name_classes(encoding: pd.DataFrame, conditions: pd.DataFrame | None) -> Classes:
    """Classes in their natural order, 2 before 10; gratings by their number, as in the texture paper."""
    order = tuple(dict.fromkeys(encoding[LABEL].astype(str)))
    if conditions is None or not {"grating", "pitch_mm"} <= set(conditions):
        order = tuple(sorted(order, key=natural))
    if conditions is None or not {"grating", "pitch_mm"} <= set(conditions):
        names = {label: label for label in order}
        return Classes("class", order, names, names)
    first = conditions.drop_duplicates(LABEL).set_index(LABEL).loc[list(order)]
    short = {label: f"{number:g}" for label, number in zip(order, first["grating"], strict=True)}
    long = {c: f"Grating {short[c]} (P = {pitch:g} mm)" for c, pitch in zip(order, first["pitch_mm"], strict=True)}
    return Classes("grating", order, short, long, are_ordered=True)


def _few(items: Sequence[Any], most: int = MOST_ROWS) -> list[Any]:
    """The first, the middle and the last of them, or all of up to `most`.

    >>> _few([1, 2, 3, 4, 5, 6, 7, 8]), _few([1, 2, 3, 4], most=4)
    ([1, 5, 8], [1, 2, 3, 4])
    """
    if len(items) <= most:
        return list(items)
    return [items[0], items[len(items) // 2], items[-1]]


def _of_all(shown: Sequence[str], classes: Classes) -> str:
    """The classes in a figure, if it does not show all."""
    if len(shown) == len(classes.order):
        return ""
    return f" Shown are {len(shown)} of the {len(classes.order)} classes: the first, the middle and the last."


def _in_words(where: dict[str, Any]) -> str:
    """Conditions in words.

    >>> _in_words({"force_N": 12.0, "speed_mm_per_s": 8.6})
    '12 N, 8.6 mm/s'
    """
    return ", ".join(in_unit(column, value) for column, value in where.items())


def _rasters(study: StudySpec, trains: SpikeTrains, view: _View, classes: Classes) -> Drawn:
    start_s = study.window.start_ms * 1e-3
    window_s = study.window.length_ms * 1e-3
    shown = _few(classes.order, MOST_CLASSES)
    values = _few(view.values) or [None]
    rows = [in_unit(view.vary, value) if view.vary else "" for value in values]
    wheres = [{**view.fixed, **({view.vary: value} if view.vary else {})} for value in values]
    trials = [[_first_trial(trains, label, where) for label in shown] for where in wheres]
    drawn = [trial for row in trials for trial in row if trial is not None]
    end_s = max((float(trains.trial_steps[t] / trains.sampling_rate_Hz) for t in drawn), default=start_s + window_s)
    stop_s = min(max(end_s, start_s + window_s), start_s + max(SHOWN_s, window_s))
    columns = [classes.long[label] for label in shown]
    figure = encoding_figures.draw_rasters(trains, trials, rows, columns, start_s, stop_s, window_s)
    first, second = names_of(study)
    parts = [trains.encoder.get(population.part, trains.encoder) for population in populations(trains.encoder)[:2]]
    each_ms = [float(part.get("t_ref_ms", 0.0)) for part in parts]
    pair = periods.in_words(study.encoder.model, each_ms[0], each_ms[-1])
    order = f" ({second} & {first})" if "&" in pair else ""
    fixed = f" at {_in_words(view.fixed)}" if view.fixed else ""
    down = f"; from top to bottom {', '.join(rows)}" if len(rows) > 1 else ""
    caption = (
        f"Spikes of the {first} (blue) and {second} (orange) afferents in one trial each{fixed}{down}. "
        f"{named(pair)}{order}. Grey: a trial's first window of {study.window.length_ms:g} ms, the input of networks."
        f"{_of_all(shown, classes)}{in_the_paper(study, 'Fig. 5')}"
    )
    counts = ", ".join(f"{len(trains.steps[trial])}" for trial in drawn)
    alt = (
        f"Raster plots of {len(shown)} classes in {number_of(len(rows), 'row')}; spikes in each whole trial, row by "
        f"row: {counts}."
    )
    return Drawn("rasters", "Spikes of the afferents", figure, caption, alt)


def _first_trial(trains: SpikeTrains, label: str, where: dict[str, Any]) -> int | None:
    keep = trains.conditions[LABEL].astype(str) == label
    for column, value in where.items():
        keep &= trains.conditions[column] == value
    numbers = np.flatnonzero(keep)
    return int(numbers[0]) if len(numbers) else None


def _spike_counts(study: StudySpec, encoding: pd.DataFrame, view: _View, classes: Classes) -> Drawn:
    rows = _select(encoding, view.at)
    shown = _few([label for label in classes.order if label in set(rows[LABEL].astype(str))], MOST_CLASSES)
    figure = encoding_figures.draw_spike_counts(rows, shown, classes, names_of(study), periods.axis(study))
    totals = rows[rows[LABEL].astype(str).isin(shown)].groupby("pair", sort=False)["spikes_total_per_s"].mean()
    falling = totals.sort_values(ascending=False, kind="stable")
    order = ", ".join(f"{pair} ({value:.0f})" for pair, value in falling.items())
    pairs = "pairs of " if any("&" in str(pair) for pair in totals.index) else ""
    fixed = f" at {_in_words(view.at)}" if view.at else ""
    caption = (
        f"Spikes per second of all {' and all '.join(names_of(study))} afferents, and of both, over the {pairs}"
        f"refractory periods{fixed}{_stretch(rows)}. "
        f"Sum of both, mean over these classes, from most to least: {order}.{_of_all(shown, classes)}"
        f"{in_the_paper(study, 'Fig. 6')}"
    )
    alt = f"Bars of spikes per second for {len(shown)} classes over the pairs; from most to least: {order}."
    return Drawn("spike-counts", "Spike counts over the refractory periods", figure, caption, alt)


def _rates(study: StudySpec, encoding: pd.DataFrame, view: _View, classes: Classes) -> Drawn:
    pair, rows = _first_pair(encoding)
    figure = encoding_figures.draw_rates(rows, view.by, classes, names_of(study))
    caption = (
        f"Firing rate of each population for each {classes.word}{' and condition' if view.by else ''}, as a share of "
        f"the population's highest, at {named(pair)}{_stretch(rows)}."
        f"{in_the_paper(study, 'Fig. 10(a)')}"
    )
    alt = f"Two matrices of firing rates, {_trends(rows, view, 'spikes', '_per_s', names_of(study))}"
    return Drawn("rates", "Firing rates", figure, caption, alt)


def _isis(study: StudySpec, encoding: pd.DataFrame, view: _View, classes: Classes) -> Drawn:
    pair, rows = _first_pair(encoding)
    rows = _select(rows, view.fixed)
    within = _stretch(rows)
    of_touch = {name: rows[TOUCH + name] for name in ("isi_sa_ms", "isi_ra_ms") if TOUCH + name in rows}
    if of_touch:  # a window is too short for the longer ones
        rows, within = rows.assign(**of_touch), "; over the whole touch, from a window's start on"
    figure = encoding_figures.draw_isis(rows, view.vary, classes, names_of(study))
    fixed = f" at {_in_words(view.fixed)}" if view.fixed else ""
    caption = (
        f"Mean inter-spike interval of each {classes.word}{fixed}, {named(pair)}{within}; a gap if the population is "
        f"silent.{in_the_paper(study, 'Fig. 10(b)')}"
    )
    alt = f"Points over the classes, {_trends(rows, view, 'isi', '_ms', names_of(study))}"
    return Drawn("isis", "Inter-spike intervals", figure, caption, alt)


def names_of(study: StudySpec) -> tuple[str, str]:
    """The first population of a study's encoder and the others, in words."""
    first, *others = (population.name for population in populations(study.encoder))
    return first, " and ".join(others) or "no other"


def _trends(rows: pd.DataFrame, view: _View, stem: str, unit: str, names: tuple[str, str]) -> str:
    """Means of both populations over the varying condition, in words."""
    words = []
    for kind, name in zip(("sa", "ra"), names, strict=True):
        column = f"{stem}_{kind}{unit}"
        groups = rows.groupby(view.vary)[column].mean() if view.vary else pd.Series({"": rows[column].mean()})
        values = [f"{value:.3g}{f' at {in_unit(view.vary, x)}' if view.vary else ''}" for x, value in groups.items()]
        words.append(f"{name} mean {', '.join(values)}")
    return "; ".join(words) + "."


def _stretch(rows: pd.DataFrame) -> str:
    """The stretch of the rates, as the end of a phrase; empty if the table has none."""
    return f"; {rows['stretch'].iloc[0]}" if "stretch" in rows else ""


def _first_pair(encoding: pd.DataFrame) -> tuple[str, pd.DataFrame]:
    pair = encoding["pair"].iloc[0]
    return pair, encoding[encoding["pair"] == pair]


def _select(table: pd.DataFrame, where: dict[str, Any]) -> pd.DataFrame:
    for column, value in where.items():
        table = table[table[column] == value]
    return table
