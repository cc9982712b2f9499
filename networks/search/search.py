"""Search of a network's hyperparameters on validation trials, with a journal that survives interruptions.

A search asks its tuner for a batch of trials, trains them, writes them to the journal in the order of their numbers,
and reports them to the tuner. The journal is the only state: a resumed search asks again and reports its trials again.
"""

import hashlib
import json
import math
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import torch
from neurotact_parts.networks.search.journal import (
    FAILED,
    FINISHED,
    JOURNAL,
    STOPPED,
    Trial,
    best_of,
    note,
    read_journal,
    value_of,
)
from neurotact_parts.networks.search.tuning import MedianStop, Proposal, Tuner

from neurotact import effects, files, workers
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import check_stratify
from neurotact.errors import InputError
from neurotact.networks.definition import recipe, seeds
from neurotact.networks.definition import space as spaces
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import RSNNSpec, void_keys
from neurotact.networks.training import ensemble, model_selection, run_folder, tasks, trainer
from neurotact.networks.training.ensemble import joined
from neurotact.networks.training.epochs import Epoch
from neurotact.networks.training.outcome import Chosen, Outcome, outcome_of
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.use import measuring
from neurotact.progress import Advance, silent, time_left
from neurotact.spec import Spec, build, saved, unsaved

DECIDING = {"model", "readout", "input_deviation", "learn", "training.relative_learning_rate"}
"""Keys of a network on which it depends whether others have an effect."""


class Problem(Spec):
    """What is searched: everything that determines the journal's bytes, without the paths of files."""

    search: SearchSpec
    network: RSNNSpec
    """The keys that are not in the space."""
    task: Task
    spikes_sha256: str
    gone = {"device": "cpu"}

    def network_of(self, parameters: Mapping[str, Any]) -> RSNNSpec:
        return spaces.apply(self.network, parameters, source="search.space")

    def seeds_of(self, trial: Proposal) -> tuple[int, int]:
        """Seeds of a trial's initial weights and order of windows, drawn from its number and its content."""
        network = self.network_of(trial.parameters)
        task = self.task.model_copy(update={"exit_choice": "least"})  # of the trained network
        return seeds.drawn([self.search.seed, trial.id, network, task])


class Job(NamedTuple):
    """A trial to train."""

    problem: Problem
    proposal: Proposal
    median_stop: MedianStop | None


Run = Callable[[Sequence[Job]], Iterator[Trial]]
"""Trains the trials of a batch; yields them in the order of their numbers."""


class _Timing(NamedTuple):
    """Seconds of a search in this process, and the part of them that proposals took."""

    seconds: float
    proposals: float


def asked(
    search: SearchSpec, network: RSNNSpec, trains: SpikeTrains, task: Task, given: Collection[str] = ()
) -> SearchSpec:
    """The search that a command or a call describes; its first trial is the network as given, unless it names another.

    Without a space it is around the choices of the network's recipe, or the space of the texture paper for a network
    without one. given: keys of the network that the user has set; one that has no effect in any trial is refused.
    """
    check_stratify(trains.conditions, task.stratify, task.split)
    seen = tasks.seen(trains, task)
    usual = {} if search.space else recipe.space(network, seen) if network.recipe else spaces.load_space("texture")
    built = SearchSpec(**{**search.model_dump(exclude_unset=True), "space": search.space or usual})
    if not DECIDING & {*built.space}:
        effects.check_keys(given, [void_keys(recipe.resolve(network, seen))], "network")
    spaces.check(built.space, network, source="search.space")
    if built.tuner == "grid" or built.first is not None:
        return built
    keeps_auto = "auto" in built.space.get("model", {}).get("_value", ())
    first = recipe.resolve(network, seen) if keeps_auto else recipe.first_of(network, seen)
    return built.model_copy(update={"first": spaces.values_of(first, built.space)})


def problem_of(trains: SpikeTrains, search: SearchSpec, network: RSNNSpec, task: Task) -> Problem:
    """The problem of searching on these spike trains.

    Raises InputError if the space does not suit the network, or if the training trials have fewer than two classes.
    """
    spaces.check(search.space, network, source="search.space")
    tasks.trials_of(trains, task)
    tasks.warn_of_onsets(trains, task.window)
    return Problem(search=search, network=network, task=task, spikes_sha256=_sha256(trains))


@contextmanager
def runner(problem: Problem, spikes: Path, n_workers: int) -> Iterator[Run]:
    """Trials trained in worker processes.

    A single worker is this process: a script without `if __name__ == "__main__"` can start no other.
    """
    if n_workers == 1:
        yield here(tasks.load_spikes(spikes, problem.task), problem.task)
    else:
        with _processes(spikes, n_workers) as run:
            yield run


def here(trains: SpikeTrains, task: Task) -> Run:
    """Trials trained in this process, one after another."""
    sides = tasks.sides_of(trains, task)
    return lambda jobs: (try_network(job, trains, sides) for job in jobs)


@contextmanager
def _processes(spikes: Path, n_workers: int) -> Iterator[Run]:
    """Trials trained in worker processes, which read the spike trains from their file."""
    with workers.pool(n_workers) as run:
        yield lambda jobs: run(_try_from_disk, [(job, spikes) for job in jobs])


def search(
    problem: Problem, folder: Path, run: Run, advance: Advance = silent, *, resume: bool = False
) -> tuple[list[Trial], _Timing]:
    """Every trial of a search; trials in the journal of `folder` are not trained again.

    run: `here` or `_processes`; the journal is the same for both and for any number of processes.
    resume: go on with a search of fewer trials, to the journal that one search of all trials has.
    Raises InputError if the folder holds another search.
    """
    _claim(folder, problem, resume=resume)
    files.sweep(folder)
    known = read_journal(folder / JOURNAL)
    n_known = len(known)
    advance(n_known, note(known))
    started_at = perf_counter()
    done: list[Trial] = []
    tuner = Tuner(problem.search)
    proposals = perf_counter() - started_at
    while True:
        asked_at = perf_counter()
        batch = tuner.ask()
        proposals += perf_counter() - asked_at
        if not batch:
            break
        ended = _take(known, batch, problem, folder)
        for trial in run([Job(problem, proposal, tuner.median_stop) for proposal in batch[len(ended) :]]):
            files.append(folder / JOURNAL, trial.line())
            ended.append(trial)
            advance(1, _progress(done + ended, n_known, problem.search.trials, perf_counter() - started_at))
        ended_at = perf_counter()
        for trial in ended:
            _report(tuner, trial)
        proposals += perf_counter() - ended_at
        done += ended
    if known:
        raise InputError(f"{folder / JOURNAL}: holds trials that this search does not propose; remove the folder")
    _warn_beyond(problem.search.max_sops, done)
    return done, _Timing(perf_counter() - started_at, proposals)


def try_network(job: Job, trains: SpikeTrains, sides: Sides) -> Trial:
    """Train one proposed network; a trial that cannot be trained fails, and the search continues."""
    number, parameters = job.proposal
    epochs: list[float] = []
    try:
        network, accuracy, outcome = _train(job, trains, sides, epochs)
        return _trial_of(job, network, accuracy, outcome, sides, epochs)
    except InputError as error:
        return Trial(number, parameters, epochs, FAILED, error=str(error))


def _trial_of(job: Job, network: Network, accuracy: float, outcome: str, sides: Sides, epochs: list[float]) -> Trial:
    """The journal's line of a trained network, with the SOPs of its decisions on validation windows."""
    number, parameters = job.proposal
    sops = measuring.mean_sops(network, sides.validation)
    if math.isnan(sops) and job.problem.search.weighs_sops:
        return Trial(number, parameters, epochs, FAILED, error="its SOPs are not counted, and the search weighs them")
    value = job.problem.search.value(accuracy, sops)
    if not math.isfinite(value):
        return Trial(number, parameters, epochs, FAILED, error=f"its value is {value}")
    return Trial(number, parameters, epochs, outcome, accuracy, None if math.isnan(sops) else sops, value)


def _warn_beyond(max_sops: float | None, trials: Sequence[Trial]) -> None:
    """Warn if no finished trial stays within the budget."""
    sops = [trial.sops for trial in trials if trial.outcome == FINISHED and trial.sops is not None]
    if max_sops is not None and sops and min(sops) > max_sops:
        warnings.warn(
            f"search: no trial stays within {max_sops:,g} SOPs, the cheapest takes {min(sops):,.0f}; allow more SOPs, "
            "search smaller networks or stronger rate penalties, or lengthen the refractory periods",
            stacklevel=3,
        )


def train_best(problem: Problem, trains: SpikeTrains, best: Trial) -> tuple[trainer.Trained, Sides]:
    """Train a trial's network again; its seeds reproduce the network of the search."""
    seeds = problem.seeds_of(Proposal(best.id, best.parameters))
    return trainer.fit(trains, problem.network_of(best.parameters), problem.task, seeds)


def save_best(problem: Problem, spikes: Path, folder: Path, trials: Sequence[Trial]) -> Outcome:
    """Train the best network again and write it into `folder/best` as `neurotact train` does; returns its outcome.

    It is trained with one thread, as in the search, to be the same network to the last bit; after that with the
    condition that validation leaves out, where it does.
    """
    trains, task, best = tasks.load_spikes(spikes, problem.task), problem.task, best_of(trials)
    with workers.one_thread():
        first = model_selection.Tried(task, *train_best(problem, trains, best))
        last = model_selection.again(trains, first, problem.seeds_of(Proposal(best.id, best.parameters)))
    run_folder.save(last.fitted, folder / "best", trains, spikes, last.task)
    chosen = None if last.choice is None else Chosen(task, last.choice)
    outcome = outcome_of(last.fitted, last.sides, trains, last.task, "tune", problem.search.space, chosen)
    files.write_json(folder / "best" / "result.json", outcome.as_json())
    return outcome


def _progress(trials: Sequence[Trial], n_known: int, n_trials: int, seconds: float) -> str:
    """The best trial so far and, without a progress bar, the time left."""
    if sys.stderr.isatty():
        return note(trials)
    left = seconds / (len(trials) - n_known) * (n_trials - len(trials))
    return f"{note(trials)}, {time_left(left)}"


class _StopTrialError(Exception):
    """Carries a stopped trial out of training."""


def _train(job: Job, trains: SpikeTrains, sides: Sides, epochs: list[float]) -> tuple[Network, float, str]:
    """The trained network, its validation accuracy, the outcome; appends each epoch's accuracy to `epochs`."""
    proposal = job.proposal
    asked_for = job.problem.network_of(proposal.parameters)
    spec = recipe.chosen_for(asked_for, sides.train.spikes, trains.sampling_rate_Hz)
    member: Network | None = None

    def new(spec: RSNNSpec, seeds: tuple[int, int]) -> tuple[Network, torch.Generator]:
        nonlocal member
        member, order = trainer.new_network(trains, spec, seeds, sides.train.spikes, job.problem.task)
        return member, order

    def watch(epoch: Epoch) -> None:
        epochs.append(epoch.validation_accuracy)
        if job.median_stop and job.median_stop.stops(proposal.id, epochs):
            raise _StopTrialError

    first = job.problem.seeds_of(proposal)
    try:
        network, training = ensemble.train(new, spec, first, sides.train, sides.validation, progress=watch)
    except _StopTrialError:
        assert member is not None
        return joined([member] * spec.n_members), epochs[-1], STOPPED
    accuracy = training.best.validation_accuracy
    if accuracy not in epochs:  # of a smaller network, which has none of the epochs that were watched
        epochs.append(accuracy)
    return network, accuracy, FINISHED


def _take(known: list[Trial], batch: Sequence[Proposal], problem: Problem, folder: Path) -> list[Trial]:
    """The trials of this batch that are in the journal; they are removed from `known`."""
    taken = [known.pop(0) for _ in batch[: len(known)]]
    for trial, proposal in zip(taken, batch, strict=False):
        if trial.parameters != proposal.parameters:
            raise InputError(
                f"{folder / JOURNAL}: trial {trial.id} is not the one that this search proposes; remove the folder, "
                "or continue with the versions of nni and numpy that it was started with"
            )
        if trial.outcome != FAILED and not _is_consistent(trial, problem.search):
            where = f"{folder / JOURNAL}: line {trial.id + 1}"
            raise InputError(f"{where} is damaged (its value does not match its accuracy); truncate the file before it")
    return taken


def _is_consistent(trial: Trial, search: SearchSpec) -> bool:
    """Whether a trial's value matches its accuracy and its SOPs."""
    accuracy, sops = trial.accuracy, trial.sops
    if not isinstance(accuracy, (int, float)) or (sops is None and search.weighs_sops):
        return False
    return trial.value == search.value(accuracy, math.nan if sops is None else sops)


def _report(tuner: Tuner, trial: Trial) -> None:
    if trial.outcome == FAILED:
        tuner.fail(trial.id, trial.epochs)
    else:
        tuner.tell(trial.id, value_of(trial), trial.epochs, stopped=trial.outcome == STOPPED)


def _claim(folder: Path, problem: Problem, *, resume: bool) -> None:
    """Use `folder` for this search; refuse the folder of another one. A search without trials is replaced."""
    path, journal = folder / "search.json", folder / JOURNAL
    content = saved(problem.model_dump(mode="json"))
    if not path.is_file() and not files.is_free(folder):
        raise InputError(f"{folder}: is not empty and holds no search; choose another folder")
    known = _read_problem(path) if journal.is_file() and journal.stat().st_size > 0 else content
    if isinstance(known, dict):
        table = unsaved(known, f"{folder}: holds a search", "choose another folder")
        with suppress(InputError):
            known = saved(build(Problem, table, source=path.name).model_dump(mode="json"))
    if known != content:
        before, now = _trials_of(known), problem.search.trials
        if before is None or known != {**content, "search": {**content["search"], "trials": before}}:
            raise InputError(f"{folder}: holds another search, or {path.name} was changed; choose another folder")
        if before > now:
            raise InputError(f"{folder}: holds this search with {before} trials; ask for {before} trials or more")
        if not resume:
            raise InputError(f"{folder}: holds this search with {before} trials; pass `resume=True` to go on to {now}")
    files.write_json(path, content)


def _trials_of(problem: Any) -> int | None:
    """The number of trials in the content of `search.json`; None if it is damaged."""
    search = problem.get("search") if isinstance(problem, dict) else None
    trials = search.get("trials") if isinstance(search, dict) else None
    return trials if isinstance(trials, int) else None


def _read_problem(path: Path) -> Any:
    """The content of `search.json`; None if it is damaged."""
    try:
        return files.read_json(path)
    except InputError:
        return None


def _try_from_disk(job_and_path: tuple[Job, Path]) -> Trial:
    job, path = job_and_path
    return try_network(job, *_read(path, job.problem.task.model_dump_json()))


@lru_cache(maxsize=1)
def _read(path: Path, task: str) -> tuple[SpikeTrains, Sides]:
    """Read the spikes and cut windows once per process, not once per trial."""
    parsed = Task.model_validate_json(task)
    trains = tasks.load_spikes(path, parsed)
    return trains, tasks.sides_of(trains, parsed)


def _sha256(trains: SpikeTrains) -> str:
    """Digest of what a network is trained on: spikes, labels and conditions, whichever file holds them."""
    content = hashlib.sha256(json.dumps([trains.sampling_rate_Hz, list(trains.afferents)]).encode())
    content.update(trains.trial_steps.astype(np.int64).tobytes())
    for events in (trains.steps, trains.units):
        content.update(np.concatenate([part.astype(np.int64) for part in events]).tobytes())
    content.update(trains.conditions.to_csv(index=False).encode())
    return content.hexdigest()
