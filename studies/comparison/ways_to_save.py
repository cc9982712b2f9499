"""Is a refractory period the cheapest way to save? Several ways, compared by accuracy over costs, on several sets.

A way is a list of settings (`saving.Setting`); all of them share recordings, split, seeds and the network's recipe.
`sets.py` defines the sets, and `own_set.py` the set of a user's own file.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison import fronts, own_set, sets, together
from neurotact_parts.studies.comparison.fronts import NOTHING
from neurotact_parts.studies.comparison.saving import Bench, Fitted, Setting, measured, n_kept, taxels_of
from neurotact_parts.studies.comparison.saving_figures import draw_costs, draw_fronts
from neurotact_parts.studies.comparison.sets import WaysData, bench_of, computed_at, step_ms
from neurotact_parts.studies.comparison.skipped import SKIPPED, of_run, skipped_row
from pydantic import Field, model_validator

from neurotact.data.recordings import Recordings
from neurotact.figures.style import Drawn
from neurotact.metrics.prices import ARITHMETIC_45NM, Priced
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, Listed, Named, View, heads


class Parameters(Spec):
    """Every way on one set."""

    data: WaysData
    ways: dict[str, tuple[Setting, ...]]
    """The settings of each way, besides `nothing saved`."""
    together: bool = False
    """Try all ways together, too, and these without each of them (`together.py`)."""
    network: RSNNSpec = RSNNSpec(recipe="default", hidden=50)
    seed: int = Field(default=0, ge=0)
    """Random seed of the split, the weights and the order of training."""
    prices: Priced = ARITHMETIC_45NM
    """The price list by which energy is estimated: its name, its path, or the whole table."""

    @model_validator(mode="after")
    def _leaves_the_name_of_nothing(self) -> "Parameters":
        if NOTHING in self.ways:
            raise ValueError(f"ways: '{NOTHING}' is the network that all ways are compared with; use another name")
        if taken := [way for way in self.ways if way.startswith(together.TOGETHER)]:
            raise ValueError(f"ways: '{taken[0]}' begins as what joins all ways; use another name")
        return self


VIEW = View(
    by=("set", "way", "setting"),
    measures=heads(
        "accuracy_test accuracy_validation sops_total energy_estimate_nJ signal_ms network_step_ms input_spikes "
        "hidden_spikes chance",
        network_step_ms="network's clock (ms)",
        chance="guessing (%)",
    ),
    cost="sops_total",
    score="accuracy_test",
    note="Each seed has its own split, the same for all ways. A single refractory period applies to both populations; "
    "events have a dead time. SOPs of pruned networks count the remaining weights. Energy is an estimate for "
    "afferents and network, by the price list in the column `prices` of results.csv. Unless it is event-driven, "
    "a network computes at every step of its clock, with or without spikes; the column `afferents` says when afferents "
    "do. Sets whose recordings are not available are left out; the column `skipped` gives the reason.",
    apart=("set",),
)


load = sets.load
own = own_set.own


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for each setting of each way, after that of the network that saves nothing.

    `no recurrence` is left out if the recipe chose a feed-forward network; where training left recurrence out, it
    changes nothing, so that its mean is over the same seeds as the others. Settings that are on this set the same as an
    earlier one are also left out: such as taxels of a sensor that has few, and times below a step of its clock.
    """
    if SKIPPED in arrays:
        return [{"way": "", "setting": "", **skipped_row(arrays, VIEW.measures)}]
    bench = bench_of(parameters.data, parameters.network, parameters.seed, arrays)
    shared = {"afferents": computed_at(parameters.data, arrays), "prices": parameters.prices.name, SKIPPED: ""}
    known: dict[str, Fitted] = {}
    rows: list[dict[str, Any]] = []
    done: list[tuple[str, Setting]] = []
    tried = list(_differing(bench, parameters.ways, step_ms(parameters.data, arrays)))
    for index, (way, setting) in enumerate(tried):
        name, used = in_words(setting, is_events=bench.encoder is None), setting
        plain = known.get(Setting().first_training())
        if not setting.recurrence and plain is not None and not plain.network.spec.recurrent:
            if not plain.was_open:
                continue
            used = setting.model_copy(update={"recurrence": True})
        rows.append({"way": way, "setting": name, **measured(bench, used, known, parameters.prices), **shared})
        needed = {Setting().first_training(), *(later.first_training() for _, later in tried[index + 1 :])}
        known = {name: fitted for name, fitted in known.items() if name in needed}  # windows use much memory
        done.append((way, used))
    if parameters.together:

        def measure(setting: Setting) -> dict[str, Any]:
            return {**measured(bench, setting, {**known}, parameters.prices), **shared}

        rows += together.rows_of(done, rows, measure, lambda one: in_words(one, is_events=bench.encoder is None))
    tested = _tested(bench, known[Setting().first_training()])
    return [{**row, **tested} for row in rows]


def _differing(bench: Bench, ways: dict[str, tuple[Setting, ...]], step_ms: float) -> Iterator[tuple[str, Setting]]:
    """Every way and its settings on the set's clock, `NOTHING` first, each once."""
    touches = bench.touches
    n_taxels = touches.n_channels if isinstance(touches, Recordings) else len({*taxels_of(touches.afferents)})
    seen: set[str] = set()
    for way, settings in {NOTHING: (Setting(),), **ways}.items():
        for setting in (asked.on(step_ms, is_events=bench.encoder is None) for asked in settings):
            used = setting.model_copy(update={"taxels": n_kept(n_taxels, setting.taxels) / n_taxels}).model_dump_json()
            if used not in seen:
                yield way, setting
            seen.add(used)


def _tested(bench: Bench, fitted: Fitted) -> dict[str, Any]:
    """The test side of a split: accuracy of guessing, number of trials, and number of trials of the rarest class.

    And the number of validation trials.
    """
    n_classes = len(bench.touches.classes)
    labels = fitted.sides.test.labels.numpy(), bench.touches.labels[bench.split.test]
    windows, trials = (np.bincount(side, minlength=n_classes) for side in labels)
    return {
        "chance": max(1 / n_classes, float(windows.max() / windows.sum())),
        "test_trials": int(trials.sum()),
        "validation_trials": len(bench.split.validation),
        "least_test_trials": int(trials.min()),
    }


def in_words(setting: Setting, *, is_events: bool = False) -> str:
    """A setting in words.

    >>> in_words(Setting(t_ref_ms=(2, 10))), in_words(Setting(prune=0.5, train_on=True)), in_words(Setting(step_ms=5))
    ('2 & 10 ms', '50 % of the weights, trained on', 'steps of 5 ms')
    """
    parts = _times_in_words(setting, is_events=is_events)
    if setting.rate_penalty is not None:
        parts.append(f"penalty {setting.rate_penalty:g}")
    if setting.adaptation:
        parts.append(f"raised by {setting.adaptation:g} per spike")
    if setting.time_constants != 1:
        parts.append(f"{setting.time_constants:g} times")
    for what in ("taxels", "window", "hidden"):
        if getattr(setting, what) != 1:
            parts.append(f"{100 * getattr(setting, what):g} % {'of the window' if what == 'window' else what}")
    if not setting.recurrence:
        parts.append("feed-forward")
    if setting.prune is not None:
        parts.append(f"{100 * setting.prune:g} % of the weights" + (", trained on" if setting.train_on else ""))
    if setting.exit_tolerance is not None:
        points = f"{100 * setting.exit_tolerance:g}"
        parts.append("1 point" if points == "1" else f"{points} points")
    return ", ".join(parts) or "-"


def _times_in_words(setting: Setting, *, is_events: bool) -> list[str]:
    parts = []
    if setting.t_ref_ms is not None:
        periods = setting.t_ref_ms[:1] if is_events else setting.t_ref_ms
        parts.append(" & ".join(f"{period:g}" for period in periods) + " ms")
    if setting.step_ms is not None:
        parts.append(f"steps of {setting.step_ms:g} ms")
    if setting.longest_steps:
        parts.append(fronts.LONGEST_STEPS)
    return parts


def named(results: pd.DataFrame) -> dict[str, Named]:
    """Of each set with results what the cheapest way saves, and a picture that names what each way saves."""
    rows = of_run(results)
    return {str(name): _named(part) for name, part in rows.groupby("set", sort=False)}


def _named(rows: pd.DataFrame) -> Named:
    alone = together.alone(rows)
    headline = fronts.headline(alone)
    details = [said for said in (*fronts.answers(alone), *together.answers(rows)) if said != headline]
    if not details:  # nothing was learned, so that no saving has a name
        return Named(headline)
    labels = {cost: fronts.labels(alone, cost) | together.labels(rows, cost) for cost in fronts.PICTURED}
    return Named(headline, details, labels, "cheapest setting that keeps the accuracy")


def cautions(results: pd.DataFrame) -> list[str]:
    """What limits the answers of a run, one line each with the remedy."""
    return fronts.cautions(together.alone(of_run(results)))


def tables(results: pd.DataFrame) -> dict[str, tuple[Listed, ...]]:
    """Of each set with results its Pareto front, and what it costs in each way to save half."""
    rows = of_run(results)
    of_each = {name: tuple(together.listed(part)) for name, part in rows.groupby("set", sort=False)}
    return {name: (*tables, *of_each[name]) for name, tables in fronts.tables(together.shown(rows)).items()}


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy over SOPs and over energy, a panel per set and a line per way; for a single set also over time."""
    shown = together.shown(of_run(results))
    if shown.empty:
        return
    joined = (
        "Joined: neither another setting of the same way nor the network that saves nothing (star) has both a lower "
        "cost and a higher accuracy. Dashed: the Pareto front of all ways."
    )
    by = f" by the price list {' or '.join(shown['prices'].unique())}" if "prices" in shown else ""
    energy = f"Energy is an estimate{by}."
    mean = f"Mean test accuracy over seeds{' with its 95 % interval' if fronts.has_intervals(shown) else ''}."
    if shown["set"].nunique() == 1:
        yield Drawn(
            "ways-to-save",
            "Accuracy over SOPs, energy and time, way by way",
            draw_costs({cost: fronts.fronts(shown, cost) for cost in fronts.COSTS}),
            f"{mean} {joined} {energy}",
            "Three panels for SOPs, energy and signal; each way to save is a line of marks from the network that saves "
            "nothing to a lower cost.",
        )
        return
    for cost in fronts.ANSWERED:
        yield Drawn(
            "ways-to-save" if cost == fronts.SOPS else "ways-to-save-energy",
            f"Accuracy over {fronts.COSTS[cost].called}, way by way",
            draw_fronts(fronts.fronts(shown, cost), cost),
            f"{mean} {joined}{f' {energy}' if cost == fronts.ENERGY else ''}",
            "A panel per set; each way is a line of marks from the network that saves nothing to a lower cost.",
        )
