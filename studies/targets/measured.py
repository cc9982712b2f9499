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
    kept = {key: value for key, value in result.items() if key != "values"}
    return {**kept, **tested, "row": {**result["row"], **row}, "tables": {**result.get("tables", {}), **found}}


def _of_numbers(
    result: dict[str, Any], fitted: Trained, sides: Sides, trains: SpikeTrains, task: Task
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Scores of trials; and as tables what was told of each test window, with the errors as `row`."""
    parts, first = tasks.trials_of(trains, task), copies_of(trains).first
    test = first[trains.cut(task.window, parts.test).trial]
    held = first[trains.cut(task.training_window, parts.validation).trial]
    values, labels = np.asarray(result["values"]), sides.test.labels.numpy()
    told = {"trial": test}
    for name, value, label in zip(task.numbers, values.T, labels.T, strict=True):
        told |= {f"true_{name}": label.astype(float), f"told_{name}": value.astype(float)}
    right = measuring.right_of(fitted.network.infer(sides.validation.spikes), sides.validation)
    errors = numbers.errors(values, labels, task.numbers, test)
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
