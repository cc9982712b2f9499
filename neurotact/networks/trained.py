"""A trained network in a folder, with what is needed to use it again: window, split, spikes, exit rule."""

import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import pandas as pd
import torch
from pydantic import Field
from sklearn.metrics import confusion_matrix
from torch import Tensor

from neurotact.data import hdf5
from neurotact.data.recordings import select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, SplitSpec, split_conditions
from neurotact.data.windows import Windows, WindowSpec
from neurotact.errors import InputError
from neurotact.metrics import synops
from neurotact.networks import checkpoint, exit_choice, recipe
from neurotact.networks.early_exit import FULL_WINDOW, ExitRule
from neurotact.networks.kernels import Backend
from neurotact.networks.provenance import SIDES, Provenance, first_difference, provenance_of
from neurotact.networks.rsnn import RSNN, Inference
from neurotact.networks.specs import RSNNSpec
from neurotact.networks.training import Checkpoint, Epoch, Examples, Training, train
from neurotact.spec import Spec, build
from neurotact.tables import write_table

LOG = "training.csv"
"""The training log: a row per epoch."""
ExitBy = Literal["stability", "margin"]
AT_ONCE = 256
"""Windows that are simulated together."""


class Task(Spec):
    """What a network is trained and tested on: which trials, which windows, which sides of the split."""

    later_keys: ClassVar[tuple[str, ...]] = ("exit_choice", "exit_by")
    window: WindowSpec = WindowSpec()
    split: SplitSpec = SplitSpec()
    stratify: tuple[str, ...] = ()
    subset: dict[str, Any] = {}
    training_windows: int | None = Field(default=None, ge=1)
    """Windows of a trial to train and validate on, `window.hop_ms` apart; as many as are tested when absent."""
    exit_tolerance: float = Field(default=0.01, ge=0, lt=1)
    exit_choice: Literal["least", "steady"] = "least"
    """least: the least patience within the tolerance on validation windows, as in the texture paper's studies. steady:
    from which on all are, on validation windows and on those and the training windows together."""
    exit_by: ExitBy = "stability"
    """stability: a window exits when its leader has stood for a patience. margin: when it leads by a margin, which is
    chosen in place of the patience."""

    @property
    def training_window(self) -> WindowSpec:
        """The windows of trials for training and validation."""
        more = {} if self.training_windows is None else {"per_trial": self.training_windows}
        return self.window.model_copy(update=more)


def task_of(
    source: str,
    window: Mapping[str, Any],
    split: Mapping[str, Any],
    stratify: Sequence[str] | None,
    exit_tolerance: float = 0.01,
    exit_by: str = "stability",
) -> Task:
    """The task that the arguments of a command or a call describe; InputError names `source` and the wrong value.

    window, split: keys of `WindowSpec` and of `SplitSpec`.
    """
    table = {"window": window, "split": split, "stratify": [*(stratify or ())], "exit_tolerance": exit_tolerance}
    return build(Task, {**table, "exit_choice": "steady", "exit_by": exit_by}, source=source)


class Sides(NamedTuple):
    """Windows for training, validation and test."""

    train: Examples
    validation: Examples
    test: Examples


class Trained(NamedTuple):
    """A network, how its training went, and the exit rule that its validation trials chose."""

    network: RSNN
    training: Training
    rule: ExitRule


def sides_of(trains: SpikeTrains, task: Task, split: Split | None = None) -> Sides:
    """The windows of each side of the split, within the trials that the task's subset selects.

    split: sides of trials in place of those that the task draws.
    """
    sides = trials_of(trains, task, split)
    windows = task.training_window, task.training_window, task.window
    return Sides(*(examples_of(trains, *each)[0] for each in zip(sides, windows, strict=True)))


def trials_of(trains: SpikeTrains, task: Task, split: Split | None = None) -> Split:
    """The trials of each side of the split, within those that the task's subset selects; `split` as for `sides_of`.

    Raises InputError where the training trials hold less than two classes: there is nothing to tell apart.
    """
    inside = np.flatnonzero(select_conditions(trains.conditions, task.subset))
    split = split or split_conditions(trains.conditions, task.stratify, task.split)
    sides = Split(*(np.intersect1d(side, inside) for side in split))
    empty = [name for name, side in zip(SIDES, sides, strict=True) if not len(side)]
    if empty:
        raise InputError(f"split: no {empty[0]} trial is left within the subset {task.subset}; split otherwise")
    names = trains.classes  # gathered from all trials at every call
    known = [names[label] for label in np.unique(trains.labels[sides.train])]
    if len(known) < 2:
        raise InputError(
            f"spikes: the training trials hold too few classes ({', '.join(known) or 'none'}); give at least two"
        )
    return sides


def examples_of(trains: SpikeTrains, trials: np.ndarray, window: WindowSpec) -> tuple[Examples, Windows]:
    """The windows of some trials, which keep the classes of all; the windows name trials of `trains`."""
    windows = trains.cut(window, trials)
    labels = torch.from_numpy(trains.labels[windows.trial])
    return Examples(torch.from_numpy(trains.raster(windows)), labels), windows


def seen(trains: SpikeTrains, task: Task) -> recipe.Seen:
    """What a recipe looks at of the training windows."""
    training, _ = examples_of(trains, trials_of(trains, task).train, task.training_window)
    return recipe.Seen.of(training.spikes, trains.sampling_rate_Hz)


def warn_of_onsets(trains: SpikeTrains, window: WindowSpec) -> None:
    """Warn where windows were to start at the onset of contact and some do not."""
    complaint = trains.onset_complaint(window)
    if complaint:
        warnings.warn(complaint, stacklevel=3)


def fit(
    trains: SpikeTrains,
    spec: RSNNSpec,
    task: Task,
    seeds: tuple[int, int],
    *,
    device: str = "cpu",
    backend: Backend = "auto",
    progress=None,
    split: Split | None = None,
    start: Checkpoint | None = None,
    keep: Callable[[Checkpoint], None] | None = None,
) -> tuple[Trained, Sides]:
    """Train a network; the two seeds (initial weights, order of trials) fix every number.

    split: sides of trials in place of those that the task draws.
    start, keep: where to go on, and what is called after each epoch with what `start` takes (see `training.train`).
    Warns where no training window holds a spike: the network then learns nothing.
    """
    sides = sides_of(trains, task, split)
    warn_of_silence(sides.train)
    network, order = new_network(trains, spec, seeds, sides.train.spikes, backend=backend)
    network = network.to(device)
    training = train(network, sides.train, sides.validation, generator=order, progress=progress, start=start, keep=keep)
    return finished(network, training, sides, task), sides


def warn_of_silence(training: Examples) -> None:
    """Warn of training windows without a spike."""
    if not training.spikes.any():
        warnings.warn(
            f"training: none of the {len(training.labels)} training windows holds a spike, so that nothing is "
            "learned; raise the encoder's gains (neurotact calibrate) or move the window",
            stacklevel=3,
        )


def finished(network: RSNN, training: Training, sides: Sides, task: Task) -> Trained:
    """A network whose training is over, with the exit rule that its validation windows choose."""
    known = sides.train if task.exit_choice == "steady" else None
    rule = exit_rule(network, sides.validation, task.exit_tolerance, known, task.exit_by)
    return Trained(network, training, rule)


def new_network(
    trains: SpikeTrains, spec: RSNNSpec, seeds: tuple[int, int], training: Tensor, *, backend: Backend = "auto"
) -> tuple[RSNN, torch.Generator]:
    """An untrained network for the afferents and classes of some spike trains, and what draws the order of trials.

    training: spikes of the training windows, from which a recipe chooses and on which weights are scaled.
    """
    weights, order = (torch.Generator().manual_seed(seed) for seed in seeds)
    return begin(training, len(trains.classes), spec, trains.sampling_rate_Hz, weights, backend=backend), order


def begin(
    training: Tensor,
    n_classes: int,
    spec: RSNNSpec,
    sampling_rate_Hz: float,
    generator: torch.Generator,
    *,
    backend: Backend = "auto",
) -> RSNN:
    """An untrained network for training windows `(window, time, afferent)`, with what its recipe chooses for them."""
    chosen = recipe.resolve(spec, recipe.Seen.of(training, sampling_rate_Hz))
    network = RSNN(training.shape[2], n_classes, chosen, sampling_rate_Hz, backend=backend, generator=generator)
    recipe.start(network, training, generator)
    return network


@torch.no_grad()
def exit_rule(
    network: RSNN,
    validation: Examples,
    tolerance: float,
    training: Examples | None = None,
    by: ExitBy = "stability",
) -> ExitRule:
    """Early exit that keeps the accuracy on validation windows within `tolerance`, with the least patience or margin.

    training: windows that are judged beside those of validation, by `steady`; without them `least`.
    by: what a window exits by.
    """
    integration = network.integration
    margins = None
    if by == "margin":
        leads = (exit_choice.largest_lead(readout, integration) for readout, _ in _readouts(network, validation))
        margins = exit_choice.margins_up_to(max(leads), integration)
    known = _right(network, validation, margins)
    if training is None:
        place = exit_choice.least(known, len(validation.labels), tolerance)
    else:
        more = _right(network, training, margins)
        place = exit_choice.steady(known, len(validation.labels), more, len(training.labels), tolerance)
    return exit_choice.patience_rule(place) if margins is None else exit_choice.margin_rule(margins, place)


def _right(network: RSNN, examples: Examples, margins: Tensor | None) -> Tensor:
    """Windows that are right with each patience or margin."""
    integration = network.integration
    found = (
        exit_choice.right_of(
            exit_choice.exits(readout, integration=integration)
            if margins is None
            else exit_choice.margin_exits(readout, margins, integration),
            labels,
        )
        for readout, labels in _readouts(network, examples)
    )
    return torch.stack([*found]).sum(dim=0).cpu()


def _readouts(network: RSNN, examples: Examples) -> Iterator[tuple[Tensor, Tensor]]:
    """Readout rasters and labels, a part of the windows at a time."""
    device = network.w_in.device
    for spikes, labels in zip(examples.spikes.split(AT_ONCE), examples.labels.split(AT_ONCE), strict=True):
        yield network.simulate(spikes.to(device)).readout, labels.to(device)


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

    split: as it was given to `fit`. more: what else `restore` is to find, as JSON holds it.
    """
    folder = Path(folder)
    extra = {
        "classes": list(trains.classes),
        "spikes": os.path.relpath(spikes_path, folder),
        "task": task.model_dump(mode="json"),
        "exit_patience": trained.rule.patience,
        **({} if trained.rule.margin is None else {"exit_margin": trained.rule.margin}),
        "best_epoch": trained.training.best.epoch,
        **provenance_of(trains, trials_of(trains, task, split)).model_dump(mode="json"),
        **(more or {}),
    }
    write_table(pd.DataFrame(trained.training.epochs, columns=list(Epoch._fields)), folder / LOG)
    checkpoint.save(trained.network, folder, extra)


class Restored(NamedTuple):
    """A network read back from its folder."""

    network: RSNN
    task: Task
    rule: ExitRule
    classes: tuple[str, ...]
    spikes_path: Path
    encoder: Mapping[str, Any] | None
    provenance: Provenance | None
    """None where the network was saved without it, by an earlier version."""
    fine_tuned: Any = None
    """What `deploy.fine_tuning` saved; None of a network that was not fine-tuned."""


class _Extra(Spec):
    """What `network.json` must hold of a trained network besides the network."""

    task: Task
    classes: tuple[str, ...]
    spikes: str
    exit_patience: int | None = Field(ge=1, le=2**31 - 1)
    exit_margin: float | None = Field(default=None, gt=0)


def restore(folder: str | Path, *, device: str = "cpu", backend: Backend = "auto") -> Restored:
    """Read what `save` wrote; InputError names the file that is absent or damaged."""
    folder = Path(folder)
    network, metadata = checkpoint.load(folder, backend=backend)
    path, extra = folder / checkpoint.NETWORK, metadata["extra"]
    missing = [key for key, field in _Extra.model_fields.items() if field.is_required() and key not in extra]
    if missing:
        raise InputError(f"{path}: '{missing[0]}' is missing; make the network with neurotact train")
    known = build(_Extra, {key: extra[key] for key in _Extra.model_fields if key in extra}, source=str(path))
    if len(known.classes) != network.n_classes:
        raise InputError(
            f"{path}: names {len(known.classes)} classes where the network knows {network.n_classes}; "
            "make the network with neurotact train"
        )
    rule = ExitRule(known.exit_patience, from_first_spike=True, margin=known.exit_margin)
    table = {key: extra[key] for key in Provenance.model_fields if key in extra}
    provenance = build(Provenance, table, source=str(path)) if "trials" in table else None
    encoder = extra.get("encoder") if isinstance(extra.get("encoder"), dict) else None
    spikes = folder / known.spikes
    return Restored(
        network.to(device), known.task, rule, known.classes, spikes, encoder, provenance, extra.get("fine_tuned")
    )


def recall(restored: Restored) -> Provenance | None:
    """What a network was trained on; None, with a warning, if that is unknown.

    A network of an earlier version did not save it. Its spikes and the split of its task say the same, with a warning,
    as long as they are where they were.
    """
    if restored.provenance is not None:
        return restored.provenance
    about = "network: was saved without a note of its trials"
    try:
        trains = load_spikes_of(restored)
        if restored.encoder is not None and first_difference(trains.encoder, (), restored.encoder, ()):
            raise InputError(f"{restored.spikes_path}: holds the spikes of another encoder")
        found = provenance_of(trains, trials_of(trains, restored.task))
    except InputError as error:
        warnings.warn(f"{about}, so its training trials are unknown ({error}); train it again", stacklevel=2)
        return None
    warnings.warn(f"{about}; its split is drawn again from {restored.spikes_path}", stacklevel=2)
    return found


def infer(
    restored: Restored,
    trains: SpikeTrains,
    *,
    early_exit: bool,
    test_only: bool = False,
    allow_other_encoder: bool = False,
) -> pd.DataFrame:
    """Decide every window of some spike trains: the SOP report, one row per window.

    Columns: those of `synops.to_table`, with class names in `label` and `predicted`; and `side`, on which the network
    met the window's trial: training, validation or test, else unseen; "unknown" for a network saved without its trials.

    test_only: leave out all trials but the network's own test trials.
    allow_other_encoder: warn of spikes that are encoded otherwise than in training, rather than refuse them.
    Raises InputError for spikes of another encoder, other afferents, another clock or unknown classes.
    """
    unknown = sorted(set(trains.classes) - set(restored.classes))
    if unknown:
        raise InputError(f"spikes: class '{unknown[0]}' is not a class of the network ({', '.join(restored.classes)})")
    if trains.sampling_rate_Hz != restored.network.sampling_rate_Hz:
        raise InputError(
            f"spikes: are sampled at {trains.sampling_rate_Hz:g} Hz but the network was trained at "
            f"{restored.network.sampling_rate_Hz:g} Hz; encode them on that clock"
        )
    _check_encoder(restored, trains, allow_other_encoder)
    known = recall(restored)
    sides = np.full(len(trains), synops.UNKNOWN) if known is None else known.sides(trains)
    trials = _tested(trains, known) if test_only else np.arange(len(trains))
    warn_of_onsets(trains.select(trials), restored.task.window)
    examples, windows = examples_of(trains, trials, restored.task.window)
    network = restored.network
    result = network.infer(examples.spikes.to(network.w_in.device), restored.rule if early_exit else FULL_WINDOW)
    labels, steps, sent, heard = (part.cpu().numpy() for part in result[:4])
    table = synops.to_table(
        labels=np.array(trains.classes)[trains.labels[windows.trial]],
        predicted=np.array(restored.classes)[labels],
        steps=steps,
        input_spikes=sent,
        hidden_spikes=heard,
        n_hidden=network.spec.hidden,
        n_readout=network.n_classes,
        recurrent=network.spec.recurrent,
        trials=windows.trial,
    )
    table.insert(1, synops.SIDE, sides[windows.trial])
    return table


def _check_encoder(restored: Restored, trains: SpikeTrains, allow_other: bool) -> None:
    n_inputs = restored.network.n_inputs
    if len(trains.afferents) != n_inputs:
        raise InputError(
            f"spikes: come from {len(trains.afferents)} afferents but the network was trained on {n_inputs}; "
            "encode recordings of the same taxels"
        )
    if restored.encoder is None:
        return
    trained_on = trains.afferents if restored.provenance is None else restored.provenance.afferents
    difference = first_difference(trains.encoder, trains.afferents, restored.encoder, trained_on)
    if difference and not allow_other:
        raise InputError(
            f"spikes: {difference}; encode the recordings as in training, or pass --allow-other-encoder if you mean it"
        )
    if difference:
        warnings.warn(f"spikes: {difference}; accuracy and SOPs are those of another encoder", stacklevel=3)


def _tested(trains: SpikeTrains, known: Provenance | None) -> np.ndarray:
    """The network's test trials among any, by their content."""
    found = np.array([], np.int64) if known is None else known.tested(trains)
    if not len(found):
        raise InputError(
            "spikes: hold none of the network's test trials; name the spikes that it was trained on, or use "
            "neurotact infer"
        )
    return found


def test_trials(restored: Restored, trains: SpikeTrains) -> np.ndarray:
    """Among the spike trains that a network was trained on, its test trials."""
    return trials_of(trains, restored.task).test


def load_spikes_of(restored: Restored) -> SpikeTrains:
    """The spikes that the network was trained on."""
    return hdf5.load_spikes(restored.spikes_path)


def measure(trained: Trained, test: Examples, populations: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Accuracy, SOPs and early exit on the test windows, and the confusion matrix.

    populations: the afferents of each, as `SpikeTrains.populations`. SOPs, spikes and steps are means over windows.
    """
    network = trained.network
    spikes = test.spikes.to(network.w_in.device)
    full, early = network.infer(spikes), network.infer(spikes, trained.rule)
    cost, exit_cost = synops_of(full, network), synops_of(early, network)
    sent = test.spikes.sum(dim=(0, 1)).numpy() / len(test.labels)
    steps = early.steps.double()
    row = {
        "accuracy_validation": trained.training.best.validation_accuracy,
        "accuracy_test": accuracy_of(full, test),
        **{f"sops_{name}": float(values.mean()) for name, values in cost._asdict().items()},
        **{spikes_column(name): float(sent[its].sum()) for name, its in populations.items()},
        "exit_steps": float(steps.mean()),
        "exit_accuracy": accuracy_of(early, test),
        "exit_sops_total": float(exit_cost.total.mean()),
        "exit_steps_sd": float(steps.std(correction=0)),
        **{f"exit_sops_{n}": float(v.mean()) for n, v in exit_cost._asdict().items() if n != "total"},
        "exit_patience": trained.rule.patience,
        **({} if trained.rule.margin is None else {"exit_margin": trained.rule.margin}),
        **_oracle(network, test),
        "window_steps": test.spikes.shape[1],
        "epochs": len(trained.training.epochs),
    }
    matrix = confusion_matrix(test.labels, full.labels.cpu(), labels=range(network.n_classes))
    return {"row": row, "confusion": matrix.tolist()}


def spikes_column(population: str) -> str:
    """The column of results that holds the spikes of a population per window.

    >>> [spikes_column(name) for name in ("SA-I", "RA-I", "PC", "ON")]
    ['spikes_sa', 'spikes_ra', 'spikes_pc', 'spikes_on']
    """
    return f"spikes_{re.sub('[^a-z0-9]+', '_', population.removesuffix('-I').lower()).strip('_') or 'afferents'}"


def mean_sops(network: RSNN, examples: Examples) -> float:
    """Synaptic operations of a window, the mean over all of them."""
    return float(synops_of(network.infer(examples.spikes.to(network.w_in.device)), network).total.mean())


ORACLE_PATIENCE = 120
"""The patience that the texture paper's Algorithm 1 starts from (Table V), in steps."""


@torch.no_grad()
def _oracle(network: RSNN, test: Examples) -> dict[str, float]:
    """Steps, accuracy and SOPs of the paper's early exit, which knows the true labels (Algorithm 1)."""
    steps, right, sops = [], [], []
    integration = None if network.integration is None else network.integration.cpu()
    for spikes, labels in zip(test.spikes.split(AT_ONCE), test.labels.split(AT_ONCE), strict=True):
        rasters = network.simulate(spikes.to(network.w_in.device))
        patience = min(ORACLE_PATIENCE, spikes.shape[1])
        found = exit_choice.oracle_exit(rasters.readout.cpu(), labels, patience, integration)
        ran = torch.arange(spikes.shape[1]) < found.steps[:, None]
        sent, heard = ((part.cpu().sum(dim=2) * ran).sum(dim=1).long().numpy() for part in (spikes, rasters.hidden))
        steps.append(found.steps)
        right.append(found.labels == labels)
        sops.append(synops.of_network(network, sent, heard).total)
    return {
        "oracle_steps": float(torch.cat(steps).double().mean()),
        "oracle_accuracy": float(torch.cat(right).double().mean()),
        "oracle_sops_total": float(np.concatenate(sops).mean()),
    }


def synops_of(inference: Inference, network: RSNN) -> synops.Synops:
    """The synaptic operations of each window that was decided."""
    return synops.of_network(network, inference.input_spikes.cpu().numpy(), inference.hidden_spikes.cpu().numpy())


def accuracy_of(inference: Inference, examples: Examples) -> float:
    """The share of windows that were decided right."""
    return float((inference.labels.cpu() == examples.labels).double().mean())
