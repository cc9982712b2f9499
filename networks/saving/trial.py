"""One trial of a search for savings: a network trained with a setting, what it decides and what a decision costs."""

import json
import os
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.networks.saving.start import Start, start_of
from neurotact_parts.networks.saving.ways import Point, setting_of, ways_of
from neurotact_parts.studies.comparison import by_list
from neurotact_parts.studies.comparison.saving import Fitted, Setting, exit_of, row_of, trained

from neurotact import files
from neurotact.data.splits import Split
from neurotact.errors import InputError
from neurotact.metrics.paired import by_trial
from neurotact.networks.definition import seeds
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training import tasks
from neurotact.networks.use import measuring

WHOLE, EARLY = "whole window", "early exit"
COSTS = ("sops_total", "signal_ms")
"""Costs of a decision beside its energy by each price list."""


class Source(NamedTuple):
    """Where a search starts, as worker processes read it."""

    run: Path
    spikes: Path | None
    recordings: Path | None
    seed: int

    def start(self) -> Start:
        return start_of(self.run, self.seed, spikes=self.spikes, recordings=self.recordings)


class Job(NamedTuple):
    """A trial to do. member: 1 is the search's; others have weights and validation trials of their own."""

    id: int
    point: Point
    member: int = 1


class Trial(NamedTuple):
    """A line of the journal.

    decided: by how a network decides (`WHOLE`, `EARLY` where early exit is used), its accuracies, and the means of what
    a decision costs on validation windows (the energy in nJ by each price list, under its name), and on test windows
    under `test_...`. right: by the same, the share of the windows of each validation trial that are right, in the order
    of the trials. about: what the network is, for words. error: why nothing could be trained; then all else is empty.
    """

    id: int
    point: Point
    member: int
    decided: dict[str, dict[str, float]] = {}
    right: dict[str, list[float]] = {}
    about: dict[str, Any] = {}
    error: str = ""

    def line(self) -> str:
        return json.dumps(files.without_nan(self._asdict())) + "\n"


def read(path: Path) -> list[Trial]:
    """The trials of a journal; an incomplete last line is removed from the file, and its trial is done again."""
    lines = files.read_bytes(path).splitlines(keepends=True) if path.is_file() else []
    found: list[Trial] = []
    for number, line in enumerate(lines):
        try:
            if not line.endswith(b"\n"):
                raise ValueError("it is incomplete")
            found.append(Trial(**json.loads(line)))
        except (ValueError, TypeError) as error:
            if number + 1 < len(lines):
                raise InputError(f"{path}: line {number + 1} is damaged ({error}); remove the folder") from error
            os.truncate(path, sum(map(len, lines[:-1])))
    return found


def tried(job: Job, start: Start) -> Trial:
    """Train and measure; the point that saves nothing is the run itself, unless its weights are to be others."""
    try:
        fitted = fitted_of(job, start)
        decided, right = {}, {}
        for name, rule in _rules(start, fitted):
            decided[name], right[name] = _measured(fitted, rule)
        return Trial(job.id, job.point, job.member, decided, right, _about(fitted))
    except InputError as error:
        return Trial(job.id, job.point, job.member, error=str(error))


def fitted_of(job: Job, start: Start) -> Fitted:
    """The network of a trial."""
    bench = start.bench
    if job.member > 1:
        own = seeds.of_member(bench.seeds, job.member)
        bench = bench._replace(seeds=own, split=other_validation(start, job.member))
    setting = setting_of(job.point, ways_of(start), start)
    if job.member > 1 and setting == Setting():  # the same once more, where that of the run is known
        setting = setting.model_copy(update={"rate_penalty": start.base.network.spec.training.rate_penalty})
    return trained(bench, setting, start.known)


def other_validation(start: Start, member: int) -> Split:
    """The split with other validation trials, drawn from those of training; test trials stay aside.

    Each member has its own. The split itself where it is by groups or by conditions, or where a class has too few.
    """
    split, task = start.bench.split, start.bench.task
    if task.split.group or task.split.test_where or task.split.order:
        return split
    left, drawn = split.train, split.validation
    try:
        for number in range(2, member + 1):
            share = len(split.validation) / len(left)
            drawn = tasks.held_out(start.base.trains, left, share, start.bench.seeds[0] + number)
            left = np.setdiff1d(left, drawn)
    except InputError:
        return split
    train = np.setdiff1d(np.union1d(split.train, split.validation), drawn)
    return split._replace(train=train, validation=np.sort(drawn))


def _rules(start: Start, fitted: Fitted) -> list[tuple[str, Any]]:
    used = exit_of(start.bench, fitted, start.bench.task.exit_tolerance).used
    return [(WHOLE, FULL_WINDOW), *([] if used.never else [(EARLY, used)])]


def _measured(fitted: Fitted, rule: Any) -> tuple[dict[str, float], list[float]]:
    sides, costs = fitted.sides, {}
    for before, side in (("", sides.validation), ("test_", sides.test)):
        row = row_of(fitted._replace(sides=sides._replace(test=side)), rule)
        costs |= {f"{before}{name}": row[name] for name in COSTS}
        energies = by_list.energies(pd.DataFrame([row])).iloc[0]
        costs |= {f"{before}{name}": float(value) for name, value in energies.items()}
        costs[f"{before or 'validation_'}accuracy"] = row["accuracy_test"]
    validation = sides.validation
    decided = measuring.right_of(fitted.network.infer(validation.spikes, rule), validation)
    assert validation.of is not None
    return costs, [*by_trial(validation.of.numpy(), decided).values()]


def _about(fitted: Fitted) -> dict[str, Any]:
    spec, network, trains = fitted.network.spec, fitted.network, fitted.trains
    periods = {part: trains.encoder[part]["t_ref_ms"] for part in ("ra1", "sa1") if part in trains.encoder}
    return {
        **periods,
        "smoothed": (trains.encoder.get("conditioning") or {}).get("ema_cutoff_Hz") is not None,
        "encoder_ms": 1e3 / trains.sampling_rate_Hz,
        "network_ms": spec.own_step_ms or 1e3 / trains.sampling_rate_Hz,
        "hidden": spec.hidden,
        "direct": spec.direct,
        "recurrent": spec.recurrent,
        "afferents": len(trains.afferents),
        "weights": sum(int(weights.count_nonzero()) for weights in network.weights),
        "sparsity": spec.training.sparsity,
        "rate_penalty": spec.training.rate_penalty,
        "window_ms": 1e3 * fitted.sides.test.spikes.shape[1] / trains.sampling_rate_Hz,
    }


@lru_cache(maxsize=1)
def _start(source: Source) -> Start:
    return source.start()


def in_worker(job: tuple[Job, Source]) -> Trial:
    """`tried`, in a process that reads the run once."""
    return tried(job[0], _start(job[1]))
