"""What a cell of a study with a target adds to its results: errors in units or events, and scores by trial."""

from typing import Any

import numpy as np
import pandas as pd
from neurotact_parts.streams import detector

from neurotact.data.copies import copies_of
from neurotact.data.spikes import SpikeTrains
from neurotact.metrics.paired import by_trial
from neurotact.networks.training import events, numbers, tasks
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.training.trainer import Trained
from neurotact.networks.use import measuring
from neurotact.tables import records

HELD, DELAYS = "held", "delays_ms"
"""Of a result: as `right`, by validation trial; the mean delay of hits, by test recording."""
SIDES = ("true", "told", "early")
"""Columns of what was told: the truth, of whole windows, with early exit."""


def measured_target(
    result: dict[str, Any], fitted: Trained, sides: Sides, trains: SpikeTrains, task: Task
) -> dict[str, Any]:
    """The result with the scores of test and validation trials, with tables of what was told, and with errors."""
    tested, found = (_of_events if task.detects else _of_numbers)(result, fitted, sides, trains, task)
    row = {
        "score": float(np.mean([*tested["right"].values()])),
        "score_validation": float(np.mean([*tested[HELD].values()])),
        **found.pop("row"),
    }
    kept = {key: value for key, value in result.items() if key not in ("values", "exit_values")}
    return {**kept, **tested, "row": {**result["row"], **row}, "tables": {**result.get("tables", {}), **found}}


def _of_numbers(
    result: dict[str, Any], fitted: Trained, sides: Sides, trains: SpikeTrains, task: Task
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Scores of trials; and as tables what was told of each test window, early too, with the errors as `row`."""
    parts, first = tasks.trials_of(trains, task), copies_of(trains).first
    test = first[trains.cut(task.window, parts.test).trial]
    held = first[trains.cut(task.training_window, parts.validation).trial]
    values, early, labels = np.asarray(result["values"]), np.asarray(result["exit_values"]), sides.test.labels.numpy()
    told = {"trial": test}
    for name, *parts in zip(task.numbers, labels.T, values.T, early.T, strict=True):
        told |= {f"{side}_{name}": part.astype(float) for side, part in zip(SIDES, parts, strict=True)}
    right = measuring.right_of(fitted.network.infer(sides.validation.spikes), sides.validation)
    errors = numbers.errors(values, labels, task.numbers, test)
    early_errors = numbers.errors(early, labels, task.numbers, test)
    errors |= {f"exit_{key}": error for key, error in early_errors.items()}
    return {HELD: by_trial(held, right), "right": result["right"]}, {"row": errors, "told": records(pd.DataFrame(told))}


def _of_events(
    result: dict[str, Any], fitted: Trained, sides: Sides, trains: SpikeTrains, task: Task
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Scores of recordings; and as tables events and the operating curve, with what they come to as `row`."""
    parts, rule, names = tasks.trials_of(trains, task), fitted.detector, events.names_of(trains)
    assert rule is not None
    test, held = (detector.heard(fitted.network, trains, side, names) for side in (parts.test, parts.validation))
    row, tables, _ = detector.judged(trains, test, rule)
    found = {name.removesuffix(".csv"): records(table) for name, table in tables.items()}
    scores = {HELD: detector.scores(held, rule), "right": detector.scores(test, rule)}
    return {**scores, DELAYS: detector.delays_ms(test, rule)}, {"row": row, **found}
