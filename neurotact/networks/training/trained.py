"""A trained network in a folder, with what is needed to use it again: window, split, spikes, exit rule."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from neurotact import files
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.errors import InputError
from neurotact.networks.definition.kernels import Backend
from neurotact.networks.definition.network import Network
from neurotact.networks.exit.early_exit import FULL_WINDOW, ExitRule
from neurotact.networks.exit.held_out import ExitChoice
from neurotact.networks.training import checkpoint
from neurotact.networks.training.fitting import Trained
from neurotact.networks.training.provenance import Provenance, provenance_of
from neurotact.networks.training.ranges import Ranges, SavedRanges, recorded
from neurotact.networks.training.tasks import Task, load_spikes, sides_of, trials_of
from neurotact.spec import build
from neurotact.tables import write_table

LOG = "training.csv"
"""The training log: a row per epoch, of all networks where several were joined."""


def save(
    trained: Trained,
    folder: str | Path,
    trains: SpikeTrains,
    spikes_path: str | Path,
    task: Task,
    split: Split | None = None,
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write the network with its task, its exit rule, its training log and what it was trained on into `folder`.

    Of networks that were joined, their number and the hidden neurons of each are saved, too; and the ranges of values
    on training trials, where their recordings are found.
    split: as given to `fit`. more: further JSON values for `restore`.
    """
    folder, n_members, n_hidden = Path(folder), trained.training.n_members, trained.network.spec.n_hidden
    sides = trials_of(trains, task, split)
    windows = sides_of(trains, task, split).train.spikes
    found = recorded(trained.network, windows, trains, sides.train, spikes_path)
    extra = {
        "classes": list(trains.classes),
        "spikes": os.path.relpath(spikes_path, folder),
        "task": task.model_dump(mode="json"),
        "exit_patience": trained.rule.patience,
        **({} if trains.recorded_Hz is None else {"recorded_Hz": trains.recorded_Hz}),
        **({} if trained.has_own_rule else {"has_own_rule": False}),
        **({} if trained.held is None else {"exit_losses": {**trained.held.losses}}),
        "best_epoch": trained.training.best.epoch,
        **({} if n_members == 1 else {"joined": {"networks": n_members, "hidden": n_hidden // n_members}}),
        **({} if found is None else {"ranges": found._asdict()}),
        **provenance_of(trains, sides).model_dump(mode="json"),
        **(more or {}),
    }
    write_table(trained.training.table(), folder / LOG)
    checkpoint.save(trained.network, folder, extra)


class Restored(NamedTuple):
    """A network read back from its folder."""

    network: Network
    task: Task
    rule: ExitRule
    classes: tuple[str, ...]
    spikes: tuple[Path, ...]
    """Where the file of its spikes may be; none of a network that was fitted in memory, to an array."""
    encoder: Mapping[str, Any] | None
    provenance: Provenance | None
    """None if the network was fitted in memory."""
    fine_tuned: Any = None
    """What a fine-tuning saved; None for a network that was not fine-tuned."""
    recorded_Hz: float | None = None
    """Samples per second of the recordings that it was trained on; None if unknown."""
    has_own_rule: bool = True
    """As of `fitting.Trained`."""
    names: tuple[str, ...] | None = None
    """Of the afferents of an array that a network was fitted to in memory; None if it had none."""

    held: ExitChoice | None = None
    """As of `fitting.Trained`."""
    ranges: Ranges | None = None
    """Of values on its training trials; None where their recordings were not found."""

    @property
    def spikes_path(self) -> Path | None:
        """The file of its spikes: of two that exist, the one with the trials of its training."""
        found = [path for path in self.spikes if os.path.isfile(path)] or self.spikes
        if len(found) < 2:
            return next(iter(found), None)
        return next((path for path in found if self._was_trained_on(path)), found[0])

    def _was_trained_on(self, path: Path) -> bool:
        try:
            trains = load_spikes(path, self.task)
            return _has_its_trials(self, trains)
        except InputError:
            return False

    @property
    def afferents(self) -> tuple[str, ...] | None:
        """The names of the afferents, in the order of the network's inputs; None if unknown."""
        return self.names if self.provenance is None else self.provenance.afferents

    def exits(self, early_exit: bool = True) -> ExitRule:
        """The rule by which it decides: that of early exit if asked for and used (`held_out.ExitChoice.used`)."""
        if not early_exit:
            return FULL_WINDOW
        return self.rule if self.held is None else self.held.used


class _Extra(Provenance):
    """What `network.json` must contain for a trained network, in addition to the network."""

    task: Task
    classes: tuple[str, ...]
    spikes: str
    exit_patience: int | None = Field(ge=1, le=2**31 - 1)
    gone = {"exit_margin": None}
    has_own_rule: bool = True
    exit_losses: dict[int, float] | None = None
    ranges: SavedRanges | None = None
    recorded_Hz: float | None = Field(default=None, gt=0)


def files_of(folder: str | Path) -> list[Path]:
    """The files of a network, which no output may replace."""
    paths = files.existing(Path(folder), "folder").glob("*")
    return [path for path in paths if path.is_file() and path.suffix in (".json", ".safetensors")]


def restore(
    folder: str | Path, *, device: str = "cpu", backend: Backend = "auto", spikes: str | Path | None = None
) -> Restored:
    """Read what `save` wrote; InputError names the file that is missing or damaged.

    spikes: the file of spikes, if it is where `save` does not say.
    """
    folder = Path(folder)
    network, metadata = checkpoint.load(folder, backend=backend)
    path, extra = folder / checkpoint.NETWORK, metadata["extra"]
    missing = [key for key, field in _Extra.model_fields.items() if field.is_required() and key not in extra]
    if missing:
        raise InputError(f"{path}: '{missing[0]}' is missing; make the network with neurotact train")
    own = {*_Extra.model_fields, *_Extra.gone}
    known = build(_Extra, {key: value for key, value in extra.items() if key in own}, source=str(path))
    if len(known.classes) != network.n_classes:
        raise InputError(
            f"{path}: names {len(known.classes)} classes, but the network has {network.n_classes}; "
            "make the network with neurotact train"
        )
    rule = ExitRule(known.exit_patience, from_first_spike=True)
    losses, tolerance = known.exit_losses, known.task.exit_tolerance
    held = None if losses is None else ExitChoice(rule, losses, tolerance)
    places = [files.existing(spikes)] if spikes is not None else files.named_by(path, known.spikes)
    provenance = Provenance(encoder=known.encoder, afferents=known.afferents, trials=known.trials)
    return Restored(
        network.to(device), known.task, rule, known.classes, tuple(places), known.encoder, provenance,
        extra.get("fine_tuned"), known.recorded_Hz, known.has_own_rule, held=held, ranges=known.ranges,
    )  # fmt: skip


def _has_its_trials(restored: Restored, trains: SpikeTrains) -> bool:
    """Whether spike trains, split again, have the trials of a network's training."""
    known = restored.provenance
    return known is None or provenance_of(trains, trials_of(trains, restored.task)).trials == known.trials


def test_trials(restored: Restored, trains: SpikeTrains) -> np.ndarray:
    """The test trials of a network among the spike trains that it was trained on."""
    return trials_of(trains, restored.task).test


def load_spikes_of(restored: Restored) -> SpikeTrains:
    """The spikes that the network was trained on, of the trials that its task uses."""
    path = restored.spikes_path
    if path is None:
        raise InputError("run: was fitted in memory, to an array that it did not keep; train it from a file of spikes")
    if not os.path.isfile(path):
        raise InputError(
            f"{path}: the spikes that the network was trained on are neither there nor in the current folder; name "
            "them with `spikes`"
        )
    return load_spikes(path, restored.task)


def check_trials(restored: Restored, trains: SpikeTrains) -> None:
    """Refuse spikes with another split of trials than in training: test trials may be among the training trials."""
    if not _has_its_trials(restored, trains):
        raise InputError(
            f"{restored.spikes_path}: no longer contains the trials that the network was trained on; name the file "
            "that does with `spikes`, or train it again"
        )
