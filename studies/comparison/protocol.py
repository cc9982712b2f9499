"""Accuracy and cost of every family of classifiers on every task, on the same splits.

Families with two-dimensional input receive a task's features, LSTM and GRU its sequences averaged to a few steps, a
GRU with pooled states those in bins of 20 ms, MiniRocket the samples, the spiking network its sequences as spikes. All
use the same window of signal; only early exit decides sooner. The settings of each family are chosen from a small grid
on validation examples.
"""

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison import by_list, families, figures, rivals
from neurotact_parts.studies.comparison import spiking as spiking_family
from neurotact_parts.studies.comparison.skipped import SKIPPED, left_out, of_run, skipped_row
from neurotact_parts.studies.comparison.tasks import at_most, slowed, source_of, split_groups
from neurotact_parts.studies.task_data import TaskData
from pydantic import Field, field_validator

from neurotact.baselines.opponent import accuracy, best_of, named
from neurotact.data.copies import equal_examples, joined
from neurotact.errors import InputError
from neurotact.figures.style import Drawn
from neurotact.metrics.flops import FLOPS, LEDGER_COLUMNS, Cost, Standardise, cost
from neurotact.metrics.prices import ACCESSES, ARITHMETIC_45NM
from neurotact.spec import Spec, build
from neurotact.studies.way import Arrays, Listed, View, heads

COUNTED = (*FLOPS, "parameters", "bytes", *ACCESSES, "states_bytes", "buffers_bytes")


class TaskSpec(Spec):
    """A task, its settings, and the number of its examples."""

    task: Literal["gratings", "stiffness", "touch_modality", "compliance", "fabrics", "pvdf_hardness"] = "gratings"
    settings: dict[str, dict[str, Any]] = {}
    """For each task the keys of its own spec that differ from their defaults."""
    examples: int = Field(default=800, ge=10)
    """Maximum number of examples, in whole groups."""


class Parameters(Spec):
    """One cell: a family on a task."""

    data: TaskSpec = TaskSpec()
    family: str = "ELM"
    """The spiking network, SNN, or an opponent: one of this study, or of another package."""
    seed: int = Field(default=0, ge=0)
    """Random seed of the split, the weights and the order of training."""

    @field_validator("family")
    @classmethod
    def _is_known(cls, family: str) -> str:
        if family != spiking_family.FAMILY:
            families.opponent_of(family)
        return family


def load(data: TaskSpec) -> Arrays:
    """The task's arrays; if its recordings are not available, only `skipped`, the message with the reason."""
    try:
        source = source_of(data.task)
    except InputError as error:
        return left_out(data.task, error)
    spec = build(source.data, data.settings.get(data.task, {}), source=f"settings of {data.task}")
    try:
        made = source.make(spec)
    except InputError as error:
        return left_out(data.task, error)
    front_end = source.front_end(spec, made)
    task = slowed(at_most(made, data.examples))
    slowing = families.averaging(made.sequences.shape[1], *task.sequences.shape[1:])
    return {
        "features": task.features,
        "sequences": task.sequences,
        "labels": task.labels,
        "groups": task.groups,
        "sampling_rate_Hz": np.array(task.sampling_rate_Hz),
        "unit": np.array(task.unit),
        "before_features": _as_array(cost(*front_end.features)),
        "before_sequences": _as_array(cost(*front_end.sequences, *slowing)),
    }


def run(parameters: Parameters, arrays: Arrays) -> list[dict]:
    """A row of the family on the task; two for the spiking network, which also decides early."""
    head = {"family": parameters.family, SKIPPED: ""}
    if SKIPPED in arrays:
        return [{**head, **skipped_row(arrays, ("accuracy_validation", "accuracy_test", "chance", *LEDGER_COLUMNS))}]
    task = task_of(arrays)
    groups = task.groups[joined(task.groups, equal_examples(task.sequences))]
    split = split_groups(task.labels, groups, parameters.seed)
    majority = np.unique(task.labels[split.train], return_counts=True)
    shared = {
        "examples": len(task.labels),
        "n_train": len(split.train),
        "n_validation": len(split.validation),
        "n_test": len(split.test),
        "validation_trials": len(np.unique(groups[split.validation])),
        "test_trials": len(np.unique(groups[split.test])),
        "chance": float((task.labels[split.test] == majority[0][majority[1].argmax()]).mean()),
    }
    rows = _spiking(task, arrays, parameters, split) if parameters.family == spiking_family.FAMILY else None
    rows = rows or [_plain(task, arrays, parameters, split)]
    return [{**head, **shared, **row} for row in rows]


def task_of(arrays: Arrays) -> TaskData:
    """The task in the arrays of `load`."""
    rate_Hz, unit = float(arrays["sampling_rate_Hz"]), str(arrays["unit"])
    return TaskData(arrays["features"], arrays["sequences"], rate_Hz, unit, arrays["labels"], arrays["groups"])


def _as_array(spent: Cost) -> np.ndarray:
    return np.array([*spent.columns(*COUNTED).values()], float)


def _as_cost(array: np.ndarray) -> Cost:
    counted = dict(zip(COUNTED, array.tolist(), strict=True))
    return Cost(**counted)


def _plain(task: TaskData, arrays: Arrays, parameters: Parameters, split: Any) -> dict:
    window_ms = 1e3 * task.sequences.shape[1] / task.sampling_rate_Hz
    opponent = families.opponent_of(parameters.family)
    if opponent.takes == "features":
        sides = families.feature_sides(task, split)
        before = _as_cost(arrays["before_features"]) + cost(Standardise(sides.train.shape[1]))
    else:
        sides = families.sequence_sides(task, split, parameters.family)
        before = _as_cost(arrays["before_sequences"]) + cost(*families.slowing(task.sequences.shape[1], sides))
    with named(parameters.family):
        best = best_of(opponent, sides, parameters.seed)
    return {
        "settings": best.settings,
        "accuracy_validation": accuracy(best, sides.validation, sides.y_validation),
        "accuracy_test": accuracy(best, sides.test, sides.y_test),
        "energy_before_nJ": before.energy_estimate_nJ,
        **by_list.the_same(best.spent(before + cost(signal_ms=window_ms))),
    }


def _spiking(task: TaskData, arrays: Arrays, parameters: Parameters, split: Any) -> list[dict]:
    window_ms = 1e3 * task.sequences.shape[1] / task.sampling_rate_Hz
    rows = []
    for decided in spiking_family.decide(task, split, parameters.seed):
        # Sequences are made sample by sample: an early decision costs only the samples until then.
        needed = min(1.0, decided.cost.signal_ms / window_ms)
        before = _as_cost(arrays["before_sequences"]).times(needed) + decided.encoder
        rows.append(
            {
                "family": decided.name,
                "settings": decided.settings,
                "accuracy_validation": decided.accuracy_validation,
                "accuracy_test": decided.accuracy_test,
                "energy_before_nJ": before.energy_estimate_nJ,
                **(before + decided.network).columns(),
                **by_list.counted(before + decided.network, before + decided.network_by_events),
            }
        )
    return rows


def tables(results: pd.DataFrame) -> dict[str, tuple[Listed, ...]]:
    """Of each task the best of each kind, and the network beside its rivals by each price list."""
    return rivals.tables(results, VIEW)


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy against the energy estimate and against parameters, and the shares of energy, a panel per task."""
    shown = of_run(results)
    if shown.empty:
        return
    yield Drawn(
        "accuracy-and-energy",
        "Accuracy against the energy estimate",
        figures.draw_trade_offs(shown, "energy_estimate_nJ", "energy estimate of a decision (nJ)"),
        "Means over the splits with their deviations; the dotted line is the largest class, the open star is early "
        "exit. Marks further right cost more, marks further down make more errors.",
        "A panel per task, with a mark for each family of classifiers.",
    )
    yield Drawn(
        "accuracy-and-parameters",
        "Accuracy against parameters",
        figures.draw_trade_offs(shown, "parameters", "parameters"),
        "The same rows against the number of parameters, which training sets.",
        "A panel per task, with a mark for each family of classifiers.",
    )
    yield Drawn(
        "where-the-energy-goes",
        "Energy before the classifier and of the whole decision",
        figures.draw_energy_shares(shown),
        "The energy of features, averaging or afferents alone, and of the whole decision; means over the splits.",
        "A panel per task, two marks per family: the energy estimate before the classifier and of the whole.",
    )


VIEW = View(
    by=("task", "family"),
    measures=heads(
        "accuracy_test accuracy_validation energy_estimate_nJ energy_before_nJ macs acs sops parameters "
        "signal_ms chance",
        energy_before_nJ="before the classifier (nJ)",
        chance="largest class (%)",
    ),
    cost="energy_estimate_nJ",
    score="accuracy_test",
    note=f"{ARITHMETIC_45NM.in_words()} It counts everything from the recorded samples on: conditioning, features, "
    "averaging, afferents, classifier. Afferents are counted on every step and taxel, as digital neurons; an analogue "
    "or event-driven encoder would not have this cost. Tasks whose recordings are not available are left out; the "
    "column `skipped` of results.csv gives the reason.",
    apart=("task",),
    spiking=("family", (spiking_family.FAMILY, spiking_family.EARLY)),
    splits=("seed",),
)
