"""The search itself: its folder, its journal, its worker processes."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

from neurotact_parts.networks.saving.proposals import Asked, candidates, key_of, next_batch
from neurotact_parts.networks.saving.start import Start
from neurotact_parts.networks.saving.trial import Source, Trial, in_worker, read, tried
from neurotact_parts.networks.saving.ways import Way

from neurotact import files, workers
from neurotact.errors import InputError
from neurotact.metrics.decision import is_within
from neurotact.progress import Advance, time_left

JOURNAL, ASKED = "journal.jsonl", "search.json"


def search(
    start: Start, source: Source, ways: dict[str, Way], asked: Asked, folder: Path, n_workers: int, advance: Advance
) -> list[Trial]:
    """Every trial of a search; those in the journal of `folder` are not done again."""
    known, done = read(folder / JOURNAL), list[Trial]()
    began, n_known = perf_counter(), len(known)
    advance(n_known, "")
    with _running(start, source, n_workers) as run:
        while batch := next_batch(done, ways, asked):
            ended = [known.pop(0) for _ in batch[: len(known)]]
            for trial, job in zip(ended, batch, strict=False):
                if (trial.id, trial.point, trial.member) != job:
                    raise InputError(
                        f"{folder / JOURNAL}: trial {trial.id} is not the one that this search proposes; remove the "
                        "folder, or go on with the versions of nni and numpy that it was started with"
                    )
            for trial in run(batch[len(ended) :]):
                files.append(folder / JOURNAL, trial.line())
                ended.append(trial)
                advance(1, _note([*done, *ended], n_known, asked, perf_counter() - began))
            done += ended
    return done


@contextmanager
def _running(start: Start, source: Source, n_workers: int) -> Iterator[Any]:
    """Trials in this process, or in workers that read the run themselves."""
    if n_workers == 1:
        with workers.one_thread():
            yield lambda jobs: (tried(job, start) for job in jobs)
    else:
        with workers.pool(n_workers) as pool:
            yield lambda jobs: pool(in_worker, [(job, source) for job in jobs])


def claim(folder: Path, problem: dict[str, Any]) -> None:
    """Use the folder for this search; InputError for that of another one."""
    path = folder / ASKED
    if path.is_file() and (folder / JOURNAL).is_file():
        if files.read_json(path) != problem:
            raise InputError(f"{folder}: holds another search; choose another folder, or ask for the same one again")
        return
    files.write_json(path, problem)


def _note(trials: Sequence[Trial], n_known: int, asked: Asked, seconds: float) -> str:
    """The cheapest that kept the accuracy so far and, without a progress bar, the time left."""
    base, *others = candidates([trial for trial in trials if trial.member == 1])
    kept = [one for one in others if key_of(one.trial.point) and is_within(one.accuracy, base.accuracy, asked.loss)]
    least = min((one.energy(asked.prices) for one in kept), default=base.energy(asked.prices))
    share = 100 * least / base.energy(asked.prices)
    said = f"{share:.0f} % of the energy at an accuracy of {100 * (base.accuracy - asked.loss):.1f} % or more"
    if sys.stderr.isatty():
        return said
    left = seconds / max(1, len(trials) - n_known) * max(0, 1 + asked.trials - len(trials))
    return f"{said}, {time_left(left)}"
