"""The folder of a trained network: its weights and spec, and what is needed to use it again.

`weights.safetensors` and `network.json`, never pickle. The JSON has the SHA-256 of the weights, so that loading detects
a save that was interrupted between the two files, a truncated file, and a file of another network. Of a training it
also has the window, the split, the spikes, the exit rule, the ranges of values and what was trained on.
"""

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import safetensors.torch
import torch
from pydantic import Field, model_validator
from safetensors import SafetensorError
from torch import Tensor

from neurotact import __version__, files
from neurotact.backend import Backend
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.errors import InputError, nearest, number_of
from neurotact.files import existing, read_bytes, read_json, whole, write_json
from neurotact.networks.definition import module
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.patience import ExitChoice
from neurotact.networks.exit.refusal import Refusal
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule, SavedBand, check_band
from neurotact.networks.training.events import DetectorSpec
from neurotact.networks.training.provenance import Provenance, provenance_of
from neurotact.networks.training.ranges import Ranges, SavedRanges, recorded
from neurotact.networks.training.tasks import Task, load_spikes, names_of, sides_of, trials_of
from neurotact.networks.training.trainer import Trained
from neurotact.spec import build
from neurotact.tables import write_table

WEIGHTS = "weights.safetensors"
NETWORK = "network.json"
DTYPES = {"float32": torch.float32, "float64": torch.float64}
KEYS = ("spec", "n_inputs", "n_classes", "sampling_rate_Hz", "dtype", "neurotact", "weights_sha256", "extra")


Expected = Mapping[str, tuple[tuple[int, ...], torch.dtype]]
"""Shape and type of each tensor that a file must contain."""


def save_network(network: Network, folder: str | Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write a network into `folder`; each file is written in full and then renamed.

    extra: further JSON values of the network: class names, training history, encoder spec.
    Raises InputError for values that JSON cannot hold, for a surrogate that the spec does not describe, and for
    weights that are NaN or infinite.

    >>> import tempfile
    >>> net = RSNN(16, 8, RSNNSpec(hidden=20), sampling_rate_Hz=2000.0)
    >>> folder = tempfile.mkdtemp()
    >>> save_network(net, folder, {"best_epoch": 12})
    >>> again, metadata = load_network(folder)
    >>> torch.equal(again.w_rec, net.w_rec), metadata["extra"]
    (True, {'best_epoch': 12})
    """
    dtype = next((name for name, known in DTYPES.items() if known == network.dtype), None)
    if dtype is None:
        raise InputError(f"network: weights are {network.dtype}; convert it to one of {', '.join(DTYPES)}")
    if isinstance(network, RSNN) and network.spike != network.spec.spike:
        raise InputError(
            "network: its surrogate is not the one that its spec describes, and a checkpoint would lose it; "
            "set network.spike = network.spec.spike before saving"
        )
    for name, tensor in network.state_dict().items():
        if not tensor.isfinite().all():
            lower = network.spec.training.lower_rate
            raise InputError(f"network: '{name}' holds NaN or infinity; train it with a lower rate, as in {lower}")
    extra = dict(extra or {})
    try:
        json.dumps(extra, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"extra: cannot be written as JSON ({error}); give numbers, text, lists and tables") from error
    tensors = {name: t.detach().cpu().contiguous().clone() for name, t in network.state_dict().items()}
    weights = safetensors.torch.save(tensors)
    folder = Path(folder)
    with whole(folder / WEIGHTS) as draft:
        draft.write_bytes(weights)
    values = (
        network.spec.model_dump(mode="json"), network.n_inputs, network.n_classes, network.sampling_rate_Hz,
        dtype, __version__, hashlib.sha256(weights).hexdigest(), extra,
    )  # fmt: skip
    write_json(folder / NETWORK, dict(zip(KEYS, values, strict=True)))


def load_network(folder: str | Path, *, backend: Backend = "auto") -> tuple[Network, dict[str, Any]]:
    """The network in `folder`, and the content of `network.json`; its `extra` is that of `save_network`.

    Raises InputError, which names the file, if a file is missing, truncated or altered, or if the two do not match.
    """
    folder = existing(folder, "folder")
    inner = [path.parent for place in ("*", "cells/*") for path in folder.glob(f"{place}/{NETWORK}")]  # folds, a study
    if inner and not (folder / NETWORK).exists():
        n = f"{len(inner)} trainings in folders of their own" if len(inner) > 1 else "a training in its own folder"
        answer = folder / "answer.json"  # of a study
        answers = read_json(answer).get("answers", []) if answer.is_file() else []
        named = [folder / one["folder"] for one in answers if one.get("folder")]
        which = f"name that of its answer, {named[0]}" if len(named) == 1 else f"name one, such as {min(inner)}"
        raise InputError(f"{folder}: is no network, but holds {n}; {which}")
    metadata = _metadata(folder / NETWORK)
    spec = build(RSNNSpec, metadata["spec"], source=str(folder / NETWORK))
    sizes = metadata["n_inputs"], metadata["n_classes"], spec, metadata["sampling_rate_Hz"]
    dtype = DTYPES[metadata["dtype"]]
    weights = _weights(folder / WEIGHTS, metadata, expected_of(*sizes, dtype))
    network = untrained(*sizes, dtype, backend=backend)
    network.load_state_dict(weights)
    return network, metadata


def _metadata(path: Path) -> dict[str, Any]:
    table = read_json(path)
    if not isinstance(table, dict):
        raise InputError(f"{path}: is not a checkpoint's table; save the network again")
    for key in KEYS:
        if key not in table:
            raise InputError(f"{path}: '{key}' is missing; save the network again")
    for key in ("n_inputs", "n_classes"):
        if type(table[key]) is not int or table[key] < 1:
            raise InputError(f"{path}: {key} must be a whole number >= 1; got {table[key]!r}")
    rate = table["sampling_rate_Hz"]
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0 < rate <= sys.float_info.max:
        raise InputError(f"{path}: sampling_rate_Hz must be a positive number; got {rate!r}")
    if str(table["dtype"]) not in DTYPES:
        raise InputError(f"{path}: dtype {table['dtype']!r} is unknown; {nearest(str(table['dtype']), [*DTYPES])}")
    for key in ("spec", "extra"):
        if not isinstance(table[key], dict):
            raise InputError(f"{path}: {key} must be a table; got {table[key]!r}")
    return table


def _weights(path: Path, metadata: dict[str, Any], expected: Expected) -> dict[str, Tensor]:
    """The tensors; their shapes are checked against the metadata before a network is built."""
    content = read_bytes(path)
    if hashlib.sha256(content).hexdigest() != metadata["weights_sha256"]:
        raise InputError(f"{path}: is damaged, or not the file that {NETWORK} was saved with; save the network again")
    try:
        tensors = safetensors.torch.load(content)
    except SafetensorError as error:
        raise InputError(f"{path}: is not a safetensors file ({error}); save the network again") from error
    check_tensors(tensors, expected, path, "save the network again")
    return tensors


def shapes_of(spec: RSNNSpec, n_inputs: int, n_classes: int) -> dict[str, tuple[int, ...]]:
    """The tensors of a network's state and their shapes, known before it is built.

    >>> shapes_of(RSNNSpec(hidden=20, model="snn"), 16, 8)
    {'w_in': (16, 20), 'w_out': (20, 8), 'alpha': (2,), 'beta': (2,), 'threshold': (2,)}
    """
    recurrent = {"w_rec": (spec.hidden, spec.hidden)} if spec.recurrent else {}
    bias = {"bias": (n_classes,)} if spec.integrates else {}
    dynamics = dict.fromkeys(("alpha", "beta", "threshold"), (2,))
    heard = spec.heard(n_inputs)
    stretch = {"w_stretch": (k, heard, n_classes)} if (k := spec.readout_stretches) > 1 else {}
    readout = {"w_out": (heard, n_classes), **stretch, **bias}
    return {"w_in": (n_inputs, spec.hidden), **recurrent, **readout, **dynamics}


def untrained(
    n_inputs: int, n_classes: int, spec: RSNNSpec, rate_Hz: float, dtype: torch.dtype, *, backend: Backend = "auto"
) -> Network:
    """A network whose weights will be replaced: torch's global generator is not advanced."""
    generator = torch.Generator()
    return module.new(n_inputs, n_classes, spec, rate_Hz, backend=backend, generator=generator, dtype=dtype)


def expected_of(n_inputs: int, n_classes: int, spec: RSNNSpec, rate_Hz: float, dtype: torch.dtype) -> Expected:
    """Shape and type of each tensor of a network's state; those of an RSNN are known before it is built."""
    if spec.own is None:
        return {name: (shape, dtype) for name, shape in shapes_of(spec, n_inputs, n_classes).items()}
    state = untrained(n_inputs, n_classes, spec, rate_Hz, dtype).state_dict()
    return {name: (tuple(tensor.shape), tensor.dtype) for name, tensor in state.items()}


def check_tensors(tensors: Mapping[str, Tensor], expected: Expected, path: Path, fix: str) -> None:
    """Refuse tensors that are missing, unknown, of another shape or type, NaN or infinite; the error ends in `fix`."""
    for name in (*expected, *tensors):
        if name not in tensors:
            raise InputError(f"{path}: '{name}' is missing; {fix}")
        if name not in expected:
            raise InputError(f"{path}: '{name}' is unknown ({nearest(name, [*expected])}); {fix}")
    for name, (shape, dtype) in expected.items():
        tensor = tensors[name]
        if tuple(tensor.shape) != shape or tensor.dtype != dtype:
            raise InputError(
                f"{path}: '{name}' is {tuple(tensor.shape)} {tensor.dtype} where {shape} {dtype} is expected; {fix}"
            )
        if not tensor.isfinite().all():
            raise InputError(f"{path}: '{name}' holds NaN or infinity; {fix}")


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
    windows: Tensor | None = None,
) -> None:
    """Write the network with its task, its exit rule, its training log and what it was trained on into `folder`.

    Of networks that were joined, their number and the hidden neurons of each are saved, too; and the ranges of values
    on training trials, where their recordings are found.
    split: as given to `fit`. more: further JSON values for `restore`. windows: the spikes of training windows, if they
    are at hand.
    """
    folder, n_members, n_hidden = Path(folder), trained.training.n_members, trained.network.spec.n_hidden
    sides = trials_of(trains, task, split)
    windows = sides_of(trains, task, split).train.spikes if windows is None else windows
    found = recorded(trained.network, windows, trains, sides.train, spikes_path)
    extra = {
        "classes": list(names_of(trains, task)),
        "spikes": os.path.relpath(spikes_path, folder),
        "task": task.model_dump(mode="json"),
        "exit_patience": trained.rule.patience,
        **({"exit_band": trained.rule.band} if trained.rule.band else {}),
        **({} if trains.recorded_Hz is None else {"recorded_Hz": trains.recorded_Hz}),
        **({} if trained.has_own_rule else {"has_own_rule": False}),
        **({} if trained.held is None else {"exit_losses": {**trained.held.losses}}),
        **({} if trained.refusal is None else {"refusal": trained.refusal._asdict()}),
        "best_epoch": trained.training.best.epoch,
        **({} if n_members == 1 else {"joined": {"networks": n_members, "hidden": n_hidden // n_members}}),
        **({} if found is None else {"ranges": found._asdict()}),
        **({} if trained.detector is None else {"detector": trained.detector.model_dump()}),
        **provenance_of(trains, sides).model_dump(mode="json"),
        **(more or {}),
    }
    write_table(trained.training.table(), folder / LOG)
    save_network(trained.network, folder, extra)


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
    """As of `trainer.Trained`."""
    names: tuple[str, ...] | None = None
    """Of the afferents of an array that a network was fitted to in memory; None if it had none."""

    held: ExitChoice | None = None
    refusal: Refusal | None = None
    """As of `trainer.Trained`."""
    ranges: Ranges | None = None
    """Of values on its training trials; None where their recordings were not found."""
    detector: DetectorSpec | None = None
    """As of `trainer.Trained`."""
    source: str = "run"
    """Its folder, or what it was in memory, for messages."""
    taught: Mapping[str, list[str]] = {}
    """Of each class that it learned after its training, the touches as the readout heard them (`neurotact learn`)."""

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

    def of_classes(self, what: str) -> "Restored":
        """The network itself; InputError for one with a target, which `what` has no use for."""
        if target := self.task.target:
            tells = "detects events" if self.task.detects else f"tells numbers ({', '.join(target)})"
            raise InputError(f"{self.source}: {tells}, and {what} needs classes; train without `target`")
        return self

    def as_trained(self, what: str) -> "Restored":
        """The network itself; InputError if it learned classes later, of which `what` would need more touches."""
        if self.taught:
            raise InputError(
                f"{self.source}: learned {', '.join(self.taught)} after its training, and {what} knows the touches of "
                "that training alone; give the run that it learned from, or train with all classes"
            )
        return self

    def exits(self, early_exit: bool = True) -> ExitRule:
        """The rule by which it decides: that of early exit if asked for and used (`patience.ExitChoice.used`)."""
        used = self.rule if self.held is None else self.held.used
        rule, refusal = used if early_exit else FULL_WINDOW, self.refusal
        return rule if refusal is None else replace(rule, least_lead=refusal.whole if rule.never else refusal.early)


class _Extra(Provenance):
    """What `network.json` must contain for a trained network, in addition to the network."""

    task: Task
    classes: tuple[str, ...]
    spikes: str
    exit_patience: int | None = Field(ge=1, le=2**31 - 1)
    exit_band: SavedBand = ()
    gone = {"exit_margin": None}
    has_own_rule: bool = True
    exit_losses: dict[int, float] | None = None
    refusal: Refusal | None = None
    ranges: SavedRanges | None = None
    recorded_Hz: float | None = Field(default=None, gt=0)
    detector: DetectorSpec | None = None
    taught: dict[str, list[str]] = {}

    @model_validator(mode="after")
    def _has_a_band_of_its_numbers(self) -> "_Extra":
        check_band(self.exit_band, self.task.numbers)
        return self


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
    network, metadata = load_network(folder, backend=backend)
    path, extra = folder / NETWORK, metadata["extra"]
    missing = [key for key, field in _Extra.model_fields.items() if field.is_required() and key not in extra]
    if missing:
        raise InputError(f"{path}: '{missing[0]}' is missing; make the network with neurotact train")
    own = {*_Extra.model_fields, *_Extra.gone}
    known = build(_Extra, {key: value for key, value in extra.items() if key in own}, source=str(path))
    numbers = known.task.numbers
    for names, n, noun in (
        (known.classes, network.n_classes, "number" if numbers else "class"),
        (known.afferents, network.n_inputs, "afferent"),
        (numbers or known.classes, network.n_classes, "number"),
    ):
        if len(names) != n:
            raise InputError(
                f"{path}: names {number_of(len(names), noun)}, but the network has {n}; make the network with "
                "neurotact train"
            )
    rule = ExitRule(known.exit_patience, from_first_spike=True, band=known.exit_band)
    losses, tolerance = known.exit_losses, known.task.exit_tolerance
    held = None if losses is None else ExitChoice(rule, losses, tolerance)
    places = [files.existing(spikes)] if spikes is not None else files.named_by(path, known.spikes)
    provenance = Provenance(encoder=known.encoder, afferents=known.afferents, trials=known.trials)
    return Restored(
        network.to(device), known.task, rule, known.classes, tuple(places), known.encoder, provenance,
        extra.get("fine_tuned"), known.recorded_Hz, known.has_own_rule, held=held, ranges=known.ranges,
        refusal=known.refusal, detector=known.detector, source=str(folder),
        taught=known.taught,
    )  # fmt: skip


def _has_its_trials(restored: Restored, trains: SpikeTrains) -> bool:
    """Whether spike trains, split again, have the trials of a network's training; a class learned later has others."""
    known, sides = restored.provenance, trials_of(trains, restored.task)
    if known is not None and restored.taught:
        known = known.with_first(len(sides.train))
    return known is None or provenance_of(trains, sides).trials == known.trials


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


def trained_spikes_of(restored: Restored) -> SpikeTrains:
    """The same, refused with another split of trials than in training: test trials may be among the training trials."""
    trains = load_spikes_of(restored)
    if not _has_its_trials(restored, trains):
        raise InputError(
            f"{restored.spikes_path}: no longer contains the trials that the network was trained on; name the file "
            "that does with `spikes`, or train it again"
        )
    return trains
