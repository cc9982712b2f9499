"""The trials of a search; each batch is trained together as a population.

Their lines are written to the journal when the whole batch is trained. This does not change which trials the
median-stop rule ends: it compares only with trials of earlier batches.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import torch

from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.networks import search, search_journal, tasks
from neurotact.networks.population.devices import device_of
from neurotact.networks.population.training import Asked, Ended, Member, train
from neurotact.networks.search import Job, Problem, Run
from neurotact.networks.search_journal import Trial
from neurotact.networks.tasks import Sides
from neurotact.networks.training import Epoch


@contextmanager
def runner(problem: Problem, spikes: Path, n_workers: int, device: str) -> Iterator[Run]:
    """Trials trained on a GPU or, on the CPU, in processes; see `search.processes`."""
    if device == "cpu":
        with search.processes(spikes, n_workers) as run:
            yield run
    else:
        yield on_device(problem, tasks.load_spikes(spikes, problem.task), device_of(device))


def on_device(problem: Problem, trains: SpikeTrains, device: torch.device) -> Run:
    """Trials trained as populations; InputError if the problem's network cannot be."""
    sides = tasks.sides_of(trains, problem.task)
    Asked(trains, problem.network, problem.task, (0, 0), sides).member()
    return lambda jobs: iter(_run(jobs, trains, sides, device))


def _run(jobs: Sequence[Job], trains: SpikeTrains, sides: Sides, device: torch.device) -> list[Trial]:
    members: list[Member] = []
    placed: list[Job] = []
    trials: dict[int, Trial] = {}
    for job in jobs:
        try:
            members.append(_member(job, trains, sides))
            placed.append(job)
        except InputError as error:
            trials[job.proposal.id] = _failed(job, error, [])
    epochs: list[list[float]] = [[] for _ in placed]

    def watch(place: int, epoch: Epoch) -> bool:
        epochs[place].append(epoch.validation_accuracy)
        job = placed[place]
        return job.median_stop is not None and job.median_stop.stops(job.proposal.id, epochs[place])

    ended = train(members, device, watch) if members else []
    for job, member, end, seen in zip(placed, members, ended, epochs, strict=True):
        trials[job.proposal.id] = _trial(job, member, end, sides, seen)
    return [trials[job.proposal.id] for job in jobs]


def _member(job: Job, trains: SpikeTrains, sides: Sides) -> Member:
    problem, proposal = job.problem, job.proposal
    spec = problem.network_of(proposal.parameters)
    return Asked(trains, spec, problem.task, problem.seeds_of(proposal), sides).member()


def _trial(job: Job, member: Member, end: Ended, sides: Sides, epochs: list[float]) -> Trial:
    if end.error is not None:
        return _failed(job, end.error, epochs)
    accuracy = epochs[-1] if end.stopped else end.training.best.validation_accuracy
    outcome = search_journal.STOPPED if end.stopped else search_journal.FINISHED
    return search.trial_of(job, member.network, accuracy, outcome, sides, epochs)


def _failed(job: Job, error: InputError, epochs: list[float]) -> Trial:
    return Trial(*job.proposal, epochs, search_journal.FAILED, error=str(error))
