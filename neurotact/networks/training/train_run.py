"""A training in a folder: it resumes after an interruption, and gives the same bytes as without one.

While it runs, the folder holds `train.toml`, its settings, and `checkpoint.safetensors`, the state between two epochs;
at its end `train.toml`, the network and its results. Until the first epoch ends, the folder is not changed.
"""

import os
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from neurotact import effects, files
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import check_stratify, validation_note
from neurotact.errors import InputError
from neurotact.interrupt import stop_if_asked, terminated_as_interrupted
from neurotact.networks.definition import recipe
from neurotact.networks.definition.specs import RSNNSpec, void_keys
from neurotact.networks.training import checkpoint, fitting, tasks, trained, training_checkpoint
from neurotact.networks.training.outcome import Outcome, outcome_of
from neurotact.networks.training.tasks import Task
from neurotact.networks.training.training import Checkpoint, Epoch
from neurotact.progress import track
from neurotact.spec import Spec, build, digest, read, saved, to_toml, unsaved
from neurotact.versions import versions

ASKED = "train.toml"
CHECKPOINT = "checkpoint.safetensors"
RESULT = "result.json"
LEFT = (RESULT, CHECKPOINT, trained.LOG, checkpoint.WEIGHTS, checkpoint.NETWORK, ASKED)
"""All files of a training; the files that show its end or its progress are removed first."""
SECONDS_BETWEEN = 1.0
"""Least time between two checkpoints: short epochs are not slowed down by writing."""
NUMBERS = ("neurotact", "torch", "backend", "machine", "instructions")
"""Versions that the numbers of a training depend on."""


class Asked(Spec):
    """The settings of a training, with its recipe resolved (`train.toml`)."""

    spikes: str
    """Path of the spikes file, relative to the folder."""
    spikes_sha256: str
    """SHA-256 of the spikes file."""
    seed: int = Field(ge=0)
    device: str
    task: Task
    network: RSNNSpec
    versions: dict[str, str]

    def settings(self) -> dict[str, Any]:
        """The settings that the numbers depend on."""
        return self.model_dump(mode="json", exclude={"spikes", "versions"})


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or the end of a time limit; `epochs` of the training are saved."""

    def __init__(self, epochs: int) -> None:
        super().__init__()
        self.epochs = epochs


def run(
    spikes: Path,
    folder: Path,
    network: RSNNSpec,
    task: Task,
    *,
    given: Collection[str] = (),
    seed: int = 0,
    device: str = "cpu",
    force: bool = False,
    resume: bool = False,
    tell: Callable[[str], None] = lambda line: None,
) -> Outcome | None:
    """Train a network on spikes and save it in `folder`; returns None if it is finished already.

    given: keys of the network that the user has set; one that has no effect is refused.
    force: replace the files of an earlier training there, and nothing else.
    resume: continue an interrupted training in the folder; without one, start.
    tell: called with each line on the choices of the network's recipe.
    Raises Interrupted, and InputError for a folder that is not empty, or that holds another training.
    """
    if force and resume:
        raise InputError("`force`, `resume`: give one of them; `force` starts again and `resume` continues")
    with files.locked(folder):
        check_place(folder, force=force, resume=resume)
        trains = tasks.load_spikes(spikes, task)
        check_stratify(trains.conditions, task.stratify, task.split)
        seen = tasks.seen(trains, task)
        tasks.warn_of_onsets(trains, task.window)
        chosen = recipe.resolve(network, seen)
        effects.check_keys(given, [void_keys(chosen)], "network")
        request = Asked(
            spikes=os.path.relpath(spikes, folder),
            spikes_sha256=files.sha256(spikes),
            seed=seed,
            device=device,
            task=task,
            network=chosen,
            versions=versions(),
        )
        start = None
        if resume and _holds(folder, CHECKPOINT, RESULT):
            _check_same(folder, request)
            if not _holds(folder, CHECKPOINT):
                return None
            start = _load(folder, request, trains)
        if task.split.test_where:
            tell(validation_note(trains.conditions, task.split))
        for line in (*tasks.balance_note(trains, task), *recipe.described(network, seen)):
            tell(line)
        return _train(trains, request, spikes, folder, start)


def _train(trains: SpikeTrains, request: Asked, spikes: Path, folder: Path, start: Checkpoint | None) -> Outcome:
    writer = _CheckpointWriter(folder, request, start)
    n_before, training = len(start.epochs) if start else 0, request.network.training
    with terminated_as_interrupted():
        try:
            with track("train", training.members * training.epochs, done=n_before, at_most=True) as advance:
                fitted, sides = fitting.fit(
                    trains,
                    request.network,
                    request.task,
                    (request.seed, request.seed + 1),
                    device=request.device,
                    progress=lambda epoch: advance(1, line_of(epoch, training.members)),
                    start=start,
                    keep=writer.keep,
                )
            writer.write()
            trained.save(fitted, folder, trains, spikes, request.task)
            outcome = outcome_of(fitted, sides, trains, request.task)
            files.write_json(folder / RESULT, outcome.as_json())
            (folder / CHECKPOINT).unlink(missing_ok=True)
        except KeyboardInterrupt:
            writer.write()
            raise Interrupted(writer.epochs) from None
    return outcome


class _CheckpointWriter:
    """Writes the latest checkpoint of a training, at most every `SECONDS_BETWEEN` seconds while it runs."""

    def __init__(self, folder: Path, request: Asked, start: Checkpoint | None) -> None:
        self.folder, self.asked = folder, request
        self.is_ours = start is not None
        self.epochs = len(start.epochs) if start else 0
        self.latest: Checkpoint | None = None
        self.written_at = float("-inf")

    def keep(self, latest: Checkpoint) -> None:
        self.latest = latest
        stop_if_asked()
        if time.monotonic() - self.written_at >= SECONDS_BETWEEN:
            self.write()

    def write(self) -> None:
        """Write the latest checkpoint if it is not saved yet."""
        if self.latest is None:
            return
        if not self.is_ours:
            _begin(self.folder, self.asked)
            self.is_ours = True
        training_checkpoint.save(self.latest, self.folder / CHECKPOINT, digest(self.asked.settings()))
        self.epochs, self.latest = len(self.latest.epochs), None
        self.written_at = time.monotonic()


def _begin(folder: Path, request: Asked) -> None:
    """Remove the files of an earlier training, and write the settings of this one."""
    clear(folder, [name for name in LEFT if name != ASKED])
    comment = "# Settings of neurotact train; a training resumes only with these settings.\n"
    files.write_text(folder / ASKED, comment + to_toml(saved(request.model_dump(mode="json", exclude_none=True))))


def clear(folder: Path, names: Sequence[str] = LEFT) -> None:
    """Remove the files of an earlier training, in this order."""
    for path in (folder / name for name in names):
        if not path.is_dir():
            path.unlink(missing_ok=True)


def check_place(folder: Path, *, force: bool, resume: bool = False) -> None:
    """Refuse a folder that holds anything, unless its training is replaced or resumed."""
    names = {path.name for path in folder.iterdir()} - {files.LOCK}
    names = {name for name in names if not name.startswith(files.DRAFT)}
    if names <= set(LEFT):  # nothing but a training: no other run uses this folder
        files.sweep(folder)
    if not names or force:
        return
    if resume:
        if names <= set(LEFT) or ASKED in names:
            return
        raise InputError(f"{folder}: holds no training to resume; choose another folder")
    if CHECKPOINT in names:
        raise InputError(
            f"{folder}: holds a training that was interrupted; pass `resume=True` to continue, or `force=True` to "
            "start again"
        )
    raise InputError(
        f"{folder}: already exists and is not empty; choose another folder, or pass `force=True` to replace a "
        "training there"
    )


def _check_same(folder: Path, request: Asked) -> None:
    """Refuse settings that differ from the training in the folder; warn of other versions."""
    path = folder / ASKED
    try:
        table = read(path)
    except InputError as error:
        raise InputError(f"{path}: is damaged ({error}); start again with `force=True`") from error
    table = unsaved(table, f"{folder}: holds a training", "start again with `force=True`")
    try:
        before = build(Asked, table, source=str(path))
    except InputError as error:
        raise InputError(f"{path}: is damaged ({error}); start again with `force=True`") from error
    if before.spikes_sha256 != request.spikes_sha256:
        raise InputError(
            f"{folder}: was started with other spikes, or the file has changed since ({before.spikes}, relative to the "
            "folder); give that file, or start again with `force=True`"
        )
    for key, was, now in _differences(before.settings(), request.settings()):
        raise InputError(
            f"{folder}: was started with {key} = {was}, not {now}; give that, or start again with `force=True`"
        )
    versions_before = {name: before.versions.get(name, "not recorded") for name in NUMBERS}
    other = [f"{name} {was}" for name, was in versions_before.items() if was != request.versions[name]]
    if other:
        warnings.warn(
            f"{folder}: was started with {', '.join(other)}; its numbers may differ from those of an uninterrupted run",
            stacklevel=2,
        )


def _differences(before: Any, now: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """The dotted keys with different values, and both values.

    >>> list(_differences({"a": {"b": 1, "c": 2}, "d": 3}, {"a": {"b": 1, "c": 4}, "d": 3}))
    [('a.c', 2, 4)]
    """
    if not (isinstance(before, Mapping) and isinstance(now, Mapping)):
        if before != now:
            yield key, before, now
        return
    for name in (*before, *(name for name in now if name not in before)):
        yield from _differences(before.get(name), now.get(name), f"{key}.{name}" if key else str(name))


def _load(folder: Path, request: Asked, trains: SpikeTrains) -> Checkpoint:
    net = training_checkpoint.Net(request.network, len(trains.afferents), len(trains.classes))
    return training_checkpoint.load(folder / CHECKPOINT, net, digest(request.settings()))


def _holds(folder: Path, *names: str) -> bool:
    return any((folder / name).is_file() for name in names)


def saved_in(folder: Path) -> str:
    """What the folder of a training holds, in one line."""
    return f"saved in {folder}: the network, {RESULT} with all numbers, {trained.LOG}"


def line_of(epoch: Epoch, n_members: int = 1) -> str:
    """An epoch in words, next to a progress bar.

    >>> line_of(Epoch(7, 0.7, 0.5, 0.6, 0.75, 2), 3)
    'network 2 of 3, loss 0.600, validation accuracy 0.750'
    """
    member = f"network {epoch.member} of {n_members}, " if n_members > 1 else ""
    return f"{member}loss {epoch.validation_loss:.3f}, validation accuracy {epoch.validation_accuracy:.3f}"
