"""A training in a folder: it resumes after an interruption, and gives the same bytes as without one.

While it runs, the folder holds `train.toml`, its settings, and `checkpoint.safetensors`, the state between two epochs;
at its end `train.toml`, the network and its results. Until the first epoch ends, the folder is not changed.
Where the test is on conditions that validation leaves out in turn, the first training chooses (`choice.json`), and the
last one (`last.safetensors`, its state) has these conditions, too.
"""

import os
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field

from neurotact import effects, files
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import check_stratify, validation_note
from neurotact.errors import InputError
from neurotact.interrupt import stop_if_asked, terminated_as_interrupted
from neurotact.networks.definition import recipe, seeds
from neurotact.networks.definition.specs import RSNNSpec, void_keys
from neurotact.networks.training import epoch_checkpoint, run_folder, tasks, trainer
from neurotact.networks.training.epochs import Checkpoint, Epoch
from neurotact.networks.training.model_selection import Choice
from neurotact.networks.training.outcome import Chosen, Outcome, outcome_of
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.training.trainer import Trained
from neurotact.progress import track
from neurotact.spec import Spec, build, digest, read, saved, to_toml, unsaved
from neurotact.tables import write_table
from neurotact.versions import versions

T = TypeVar("T")
ASKED = "train.toml"
CHECKPOINT = "checkpoint.safetensors"
CHOICE, LAST = "choice.json", "last.safetensors"
RESULT = "result.json"
OF_DETECTOR = "events.csv", "operating_curve.csv"
LEFT = (RESULT, *OF_DETECTOR, CHECKPOINT, LAST, CHOICE, run_folder.LOG, run_folder.WEIGHTS, run_folder.NETWORK, ASKED)
"""All files of a training; the files that show its end or its progress are removed first."""
SECONDS_BETWEEN = 1.0
"""Least time between two checkpoints: short epochs are not slowed down by writing."""
NUMBERS = ("neurotact", "torch", "backend", "machine", "instructions")
"""Versions that the numbers of a training depend on."""


class _Asked(Spec):
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
        network = tasks.network_for(network, task)
        chosen = recipe.resolve(network, seen)
        effects.check_keys(given, [void_keys(chosen)], "network")
        request = _Asked(
            spikes=os.path.relpath(spikes, folder),
            spikes_sha256=files.sha256(spikes),
            seed=seed,
            device=device,
            task=task,
            network=chosen,
            versions=versions(),
        )
        choice = start = None
        if resume and _holds(folder, CHECKPOINT, LAST, CHOICE, RESULT):
            _check_same(folder, request)
            if not _holds(folder, CHECKPOINT, LAST) and _holds(folder, RESULT):
                return None
            choice = _choice(folder)
            start = _load(folder, request, trains, CHECKPOINT if choice is None else LAST)
        last = tasks.with_every_condition(trains, task)
        if task.split.test_where:
            tell(validation_note(trains.conditions, task.split, again=last is not None))
        for line in tasks.balance_note(trains, task):
            tell(line)
        run_of = _Run(trains, request, spikes, folder)
        if last is None:
            outcome = run_of.only(start)
        else:
            if choice is None:
                choice, start = run_of.choice(start), None
            outcome = run_of.last(last, choice, start)
        for line in recipe.described(network, seen, run_folder.load_network(folder)[0].spec):
            tell(line)
        return outcome


class _Run:
    """The trainings of a folder, each of which is resumed from a checkpoint."""

    def __init__(self, trains: SpikeTrains, request: _Asked, spikes: Path, folder: Path) -> None:
        self.trains, self.asked, self.spikes, self.folder = trains, request, spikes, folder

    def only(self, start: Checkpoint | None) -> Outcome:
        """The only training, on the task that was asked for."""
        task = self.asked.task
        return self._trained(
            self.asked.network, task, CHECKPOINT, start, lambda fitted, sides: self._end(fitted, sides, task)
        )

    def choice(self, start: Checkpoint | None) -> Choice:
        """The training that chooses, without a condition."""

        def end(fitted: Trained, sides: Sides) -> Choice:
            chosen = Choice.of(fitted, sides.validation)
            files.write_json(self.folder / CHOICE, chosen.model_dump(mode="json", exclude_none=True))
            return chosen

        return self._trained(self.asked.network, self.asked.task, CHECKPOINT, start, end)

    def last(self, task: Task, choice: Choice, start: Checkpoint | None) -> Outcome:
        """The training after the choice, with every condition."""

        def end(fitted: Trained, sides: Sides) -> Outcome:
            return self._end(choice.given_to(fitted, task), sides, task, Chosen(self.asked.task, choice))

        (self.folder / CHECKPOINT).unlink(missing_ok=True)  # left if the first training was interrupted at its very end
        return self._trained(choice.network, task, LAST, start, end)

    def _trained(
        self, network: RSNNSpec, task: Task, name: str, start: Checkpoint | None, end: Callable[[Trained, Sides], T]
    ) -> T:
        """What `end` makes of a training; name: of its checkpoint."""
        writer = _CheckpointWriter(self.folder, self.asked, name, is_ours=start is not None or name == LAST)
        writer.epochs = n_before = len(start.epochs) if start else 0
        n_trainings = network.n_trainings
        with terminated_as_interrupted():
            try:
                told = "train" if name == CHECKPOINT else "train again"
                with track(told, n_trainings * network.training.epochs, done=n_before, at_most=True) as advance:
                    fitted, sides = trainer.fit(
                        self.trains,
                        network,
                        task,
                        seeds.of_start(self.asked.seed, self.asked.task.split),
                        device=self.asked.device,
                        progress=lambda epoch: advance(1, line_of(epoch, n_trainings)),
                        start=start,
                        keep=writer.keep,
                    )
                writer.write()
                made = end(fitted, sides)
                (self.folder / name).unlink(missing_ok=True)
            except KeyboardInterrupt:
                writer.write()
                raise Interrupted(writer.epochs) from None
        return made

    def _end(self, fitted: Trained, sides: Sides, task: Task, chosen: Chosen | None = None) -> Outcome:
        """Save the network and its results."""
        run_folder.save(fitted, self.folder, self.trains, self.spikes, task)
        outcome = outcome_of(fitted, sides, self.trains, task, chosen=chosen)
        for name, table in outcome.tables.items():
            write_table(table, self.folder / name)
        files.write_json(self.folder / RESULT, outcome.as_json())
        return outcome


class _CheckpointWriter:
    """Writes the latest checkpoint of a training, at most every `SECONDS_BETWEEN` seconds while it runs."""

    def __init__(self, folder: Path, request: _Asked, name: str, *, is_ours: bool) -> None:
        self.folder, self.asked, self.name, self.is_ours = folder, request, name, is_ours
        self.epochs = 0
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
        epoch_checkpoint.save(self.latest, self.folder / self.name, _training(self.asked, self.name))
        self.epochs, self.latest = len(self.latest.epochs), None
        self.written_at = time.monotonic()


def _begin(folder: Path, request: _Asked) -> None:
    """Remove the files of an earlier training, and write the settings of this one."""
    clear(folder, [name for name in LEFT if name != ASKED])
    comment = "# Settings of neurotact train; a training resumes only with these settings.\n"
    files.write_text(folder / ASKED, comment + to_toml(saved(request.model_dump(mode="json", exclude_none=True))))


def clear(folder: Path, names: Sequence[str] = LEFT) -> None:
    """Remove the files of an earlier training, in this order."""
    for path in (folder / name for name in names):
        if not path.is_dir():
            path.unlink(missing_ok=True)


def check_apart(folder: Path, source: Path, what: str) -> None:
    """Refuse to write into the folder of the run that is read. what: is to happen to that, in words."""
    # os.path and not Path: a folder that may not be read counts as another one, and is refused when it is written.
    if os.path.exists(folder) and os.path.exists(source) and folder.samefile(source):
        raise InputError(f"{folder}: is the run that is to {what}; choose another folder")


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
    if names & {CHECKPOINT, LAST} or (CHOICE in names and RESULT not in names):
        raise InputError(
            f"{folder}: holds a training that was interrupted; pass `resume=True` to continue, or `force=True` to "
            "start again"
        )
    raise InputError(
        f"{folder}: already exists and is not empty; choose another folder, or pass `force=True` to replace a "
        "training there"
    )


def _check_same(folder: Path, request: _Asked) -> None:
    """Refuse settings that differ from the training in the folder; warn of other versions."""
    path = folder / ASKED
    try:
        table = read(path)
    except InputError as error:
        raise InputError(f"{path}: is damaged ({error}); start again with `force=True`") from error
    table = unsaved(table, f"{folder}: holds a training", "start again with `force=True`")
    try:
        before = build(_Asked, table, source=str(path))
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


def _load(folder: Path, request: _Asked, trains: SpikeTrains, name: str) -> Checkpoint | None:
    """The checkpoint of a training; None if it has not begun."""
    if not _holds(folder, name):
        return None
    n_values = len(tasks.names_of(trains, request.task))
    net = epoch_checkpoint.Net(request.network, len(trains.afferents), n_values, trains.sampling_rate_Hz)
    return epoch_checkpoint.load(folder / name, net, _training(request, name))


def _choice(folder: Path) -> Choice | None:
    """What an interrupted training chose; None if it has not."""
    path = folder / CHOICE
    return build(Choice, files.read_json(path), source=str(path)) if _holds(folder, CHOICE) else None


def _training(request: _Asked, name: str) -> str:
    """The name of a training in its checkpoint, whose file is called `name`."""
    return digest(request.settings()) + ("" if name == CHECKPOINT else f" {name}")


def _holds(folder: Path, *names: str) -> bool:
    return any((folder / name).is_file() for name in names)


def saved_in(folder: Path) -> str:
    """What the folder of a training holds, in one line."""
    return f"saved in {folder}: the network, {RESULT} with all numbers, {run_folder.LOG}"


def line_of(epoch: Epoch, n_trainings: int = 1) -> str:
    """An epoch in words, next to a progress bar.

    >>> line_of(Epoch(7, 0.7, 0.5, 0.6, 0.75, 2), 3)
    'network 2 of 3, loss 0.600, validation accuracy 0.750'
    """
    member = f"network {epoch.member} of {n_trainings}, " if n_trainings > 1 else ""
    return f"{member}loss {epoch.validation_loss:.3f}, validation accuracy {epoch.validation_accuracy:.3f}"
