"""Is a refractory period the cheapest way to save? Eleven ways on one axis of accuracy over SOPs, for several sets.

A way is a list of settings (`saving.Setting`); all of them share recordings, split, seeds and the network's recipe.
The sets stand in `sets.py`, and what a user's own file becomes in `own_set.py`.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from neurotact.data.recordings import Recordings
from neurotact.figures.style import Drawn
from neurotact.networks.specs import RSNNSpec
from neurotact.papers.comparison import fronts, own_set, sets
from neurotact.papers.comparison.fronts import NOTHING
from neurotact.papers.comparison.saving import Bench, Fitted, Setting, measured, n_kept, taxels_of
from neurotact.papers.comparison.saving_figures import draw_costs, draw_fronts
from neurotact.papers.comparison.sets import WaysData, bench_of, step_ms
from neurotact.papers.comparison.skipped import SKIPPED, of_run, skipped_row
from neurotact.spec import Spec
from neurotact.studies.protocol import Arrays, Listed, View, heads


class Parameters(Spec):
    """Every way on one set."""

    data: WaysData
    ways: dict[str, tuple[Setting, ...]]
    """The settings of each way, besides `nothing saved`."""
    network: RSNNSpec = RSNNSpec(recipe="default", hidden=50)
    seed: int = Field(default=0, ge=0)
    """Of the split, the weights and the order of training."""

    @model_validator(mode="after")
    def _leaves_the_name_of_nothing(self) -> "Parameters":
        if NOTHING in self.ways:
            raise ValueError(f"ways: '{NOTHING}' is what all ways are compared with; name the way otherwise")
        return self


VIEW = View(
    by=("set", "way", "setting"),
    measures=heads(
        "accuracy_test accuracy_validation sops_total energy_estimate_nJ signal_ms input_spikes hidden_spikes chance",
        chance="guessing (%)",
    ),
    cost="sops_total",
    score="accuracy_test",
    note="Each seed has a split of its own, the same for all ways. A refractory period holds for both populations "
    "where one is given; events have a dead time. SOPs of pruned networks count the weights that remain. Energy is an "
    "estimate of the arithmetic of afferents and network, without memory: both work at every step, whatever they send. "
    "Sets whose recordings are not at hand are left out; the column `skipped` of results.csv says why.",
    apart=("set",),
)


load = sets.load
own = own_set.own


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for each setting of each way, after that of the network that saves nothing.

    `no recurrence` is left out where the network has none to begin with, and so are settings that leave as many taxels
    as one before them, as of a sensor of few taxels.
    """
    if SKIPPED in arrays:
        return [{"way": "", "setting": "", **skipped_row(arrays, VIEW.measures)}]
    bench = bench_of(parameters.data, parameters.network, parameters.seed, arrays)
    clock_ms = step_ms(parameters.data, arrays)
    known: dict[str, Fitted] = {}
    rows: list[dict[str, Any]] = []
    tried = list(_differing(bench, parameters.ways))
    for place, (way, setting) in enumerate(tried):
        if not setting.recurrence and not known[Setting().first_training()].network.spec.recurrent:
            continue  # the recipe chose a feed-forward network
        name = named(setting, clock_ms, bench.encoder is None)
        rows.append({"way": way, "setting": name, **measured(bench, setting, known), SKIPPED: ""})
        later = {Setting().first_training(), *(each.first_training() for _, each in tried[place + 1 :])}
        known = {name: fitted for name, fitted in known.items() if name in later}  # their windows take room
    tested = _tested(bench, known[Setting().first_training()])
    return [{**row, **tested} for row in rows]


def _differing(bench: Bench, ways: dict[str, tuple[Setting, ...]]) -> Iterator[tuple[str, Setting]]:
    """Every way and setting, `NOTHING` first, but for those that leave the same taxels as one before them."""
    felt = bench.felt
    n_taxels = felt.n_channels if isinstance(felt, Recordings) else len({*taxels_of(felt.afferents)})
    seen: set[str] = set()
    for way, settings in {NOTHING: (Setting(),), **ways}.items():
        for setting in settings:
            kept = setting.model_copy(update={"taxels": n_kept(n_taxels, setting.taxels) / n_taxels}).model_dump_json()
            if kept not in seen:
                yield way, setting
            seen.add(kept)


def _tested(bench: Bench, fitted: Fitted) -> dict[str, Any]:
    """What the test side of a split can tell: the accuracy of guessing, its trials, and those of the rarest class."""
    n_classes = len(bench.felt.classes)
    labels = fitted.sides.test.labels.numpy(), bench.felt.labels[bench.split.test]
    windows, trials = (np.bincount(each, minlength=n_classes) for each in labels)
    return {
        "chance": max(1 / n_classes, float(windows.max() / windows.sum())),
        "test_trials": int(trials.sum()),
        "least_test_trials": int(trials.min()),
    }


def named(setting: Setting, step_ms: float, events: bool) -> str:
    """A setting in words.

    >>> named(Setting(t_ref_steps=(1, 5)), 2.0, False), named(Setting(prune=0.5, train_on=True), 2.0, False)
    ('2 & 10 ms', '50 % of the weights, trained on')
    """
    parts = []
    if setting.t_ref_steps is not None:
        periods = setting.t_ref_steps[:1] if events else setting.t_ref_steps
        parts.append(" & ".join(f"{n * step_ms:g}" for n in periods) + " ms")
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


def answers(results: pd.DataFrame) -> list[str]:
    """One sentence for each set that was run: what it costs to save half of the SOPs."""
    return fronts.answers(of_run(results))


def cautions(results: pd.DataFrame) -> list[str]:
    """What makes the answers of a run worth little, one line each with the remedy."""
    return fronts.cautions(of_run(results))


def tables(results: pd.DataFrame) -> dict[str, Listed]:
    """The front of each set that was run, from the best network down."""
    return fronts.tables(of_run(results))


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy over SOPs, a panel per set and a line per way; of one set alone over energy and time, too."""
    shown = of_run(results)
    if shown.empty:
        return
    joined = (
        "Joined: neither another setting of the same way nor the network that saves nothing (star) has both a lower "
        "cost and a higher accuracy. Dashed: the front of all ways."
    )
    mean = "Mean test accuracy over seeds with its 95 % interval."
    if shown["set"].nunique() == 1:
        yield Drawn(
            "ways-to-save",
            "Accuracy over SOPs, energy and time, way by way",
            draw_costs({cost: fronts.fronts(shown, cost) for cost in fronts.COSTS}),
            f"{mean} {joined} Energy is an estimate of the arithmetic.",
            "Three panels, of SOPs, energy and signal; each way to save is a line of marks from the network that saves "
            "nothing to a lower cost.",
        )
        return
    yield Drawn(
        "ways-to-save",
        "Accuracy over SOPs, way by way",
        draw_fronts(fronts.fronts(shown)),
        f"{mean} {joined}",
        "A panel per set; each way to save is a line of marks from the network that saves nothing to fewer SOPs.",
    )
