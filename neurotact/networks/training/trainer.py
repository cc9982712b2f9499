"""From spike trains to a trained network: new weights, training, and the exit rule chosen on validation windows."""

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from neurotact.backend import Backend
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.networks.definition import clock, initial, module, recipe
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.exit import patience
from neurotact.networks.exit.patience import ExitChoice, Judged
from neurotact.networks.exit.refusal import Refusal
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import ensemble
from neurotact.networks.training.epochs import Checkpoint, Epoch, Examples, Training, best_in
from neurotact.networks.training.events import DetectorSpec, tool
from neurotact.networks.training.numbers import spec_for
from neurotact.networks.training.tasks import Sides, Task, names_of, sides_of, trials_of

AT_ONCE = 256
"""Windows that are simulated together."""
BANDS = (0.01, 0.03, 0.1, 0.3)
"""Within which numbers are tried as unchanged, in units of their deviation in training."""


class Paused(Exception):  # noqa: N818 (nothing failed)
    """A training that was to stop early, with the checkpoint from which it goes on and its best epoch so far."""

    def __init__(self, checkpoint: Checkpoint, best: Epoch) -> None:
        super().__init__(f"paused after {len(checkpoint.epochs)} epochs")
        self.checkpoint, self.best = checkpoint, best


class Trained(NamedTuple):
    """A network, the log of its training, and the exit rule chosen on its validation trials.

    has_own_rule: False if a training before chose the rule, at a condition that this one has. held: the rule with its
    losses on trials that did not choose it, which decide whether it is used; None if it is given. refusal: by `refuse`.
    detector: the rule of a detector, chosen on validation recordings.
    """

    network: Network
    training: Training
    rule: ExitRule
    has_own_rule: bool = True
    held: ExitChoice | None = None
    refusal: Refusal | None = None
    detector: DetectorSpec | None = None

    def with_rule(self, rule: ExitRule, held: ExitChoice | None = None) -> "Trained":
        """The network with the exit rule that a training before it chose."""
        return self._replace(rule=rule, has_own_rule=False, held=held)


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
    until: float | None = None,
) -> tuple[Trained, Sides]:
    """Train a network, or several that are joined; two seeds (initial weights, order of trials) determine every number.

    split: replaces the split that the task draws.
    start: a checkpoint to continue from. keep: called with a checkpoint after each epoch (see `epochs.train`).
    until: raise `Paused` after this share of the epochs, unless all is done before.
    Warns if no training window holds a spike: the network then learns nothing.
    """
    sides = sides_of(trains, task, split)
    _warn_of_silence(sides.train)
    how = {"device": device, "backend": backend, "progress": progress, "start": start, "keep": keep, "until": until}
    network, training = new_trained(trains, spec, seeds, sides.train, sides.validation, task=task, **how)
    done = finished(network.cpu(), training, sides, task)
    if task.detects:

        def again(turn: Split) -> Network:
            own = sides_of(trains, task, turn)
            its = {"task": task, "device": device, "backend": backend}
            return new_trained(trains, spec, seeds, own.train, own.validation, **its)[0].cpu()

        split = trials_of(trains, task, split)
        done = done._replace(detector=tool("choose_detector")(network, trains, split, task, again))
    return done, sides


def new_trained(
    trains: SpikeTrains,
    spec: RSNNSpec,
    seeds: tuple[int, int],
    training: Examples,
    validation: Examples,
    *,
    task: Task | None = None,
    device: str | torch.device = "cpu",
    backend: Backend = "auto",
    until: float | None = None,
    **options: Any,
) -> tuple[Network, Training]:
    """Train a network for the afferents and classes of some spike trains, with the choices of its recipe; and its log.

    task: as for `tasks.names_of`. until: as of `fit`, in place of `keep`. options: of `ensemble.train`.
    """

    def new(spec: RSNNSpec, seeds: tuple[int, int]) -> tuple[Network, torch.Generator]:
        network, order = new_network(trains, spec, seeds, training.spikes, task, backend=backend)
        return network.to(device), order

    spec = spec_for(spec, task.numbers if task else ())  # its loss decides what a recipe chooses
    chosen = recipe.chosen_for(spec, training.spikes, trains.sampling_rate_Hz)
    if until is not None:
        options["keep"] = partial(_pause, chosen.training, until)
    return ensemble.train(new, chosen, seeds, training, validation, **options)


def _pause(spec: TrainingSpec, until: float, checkpoint: Checkpoint) -> None:
    if len(checkpoint.epochs) >= math.ceil(until * spec.epochs):
        raise Paused(checkpoint, best_in(checkpoint.epochs, spec))


def _warn_of_silence(training: Examples) -> None:
    """Warn of training windows without a spike."""
    if not training.spikes.any():
        warnings.warn(
            f"training: none of the {len(training.labels)} training windows holds a spike, so nothing is "
            "learned; raise the encoder's gains (neurotact calibrate) or move the window",
            stacklevel=3,
        )


def finished(network: Network, training: Training, sides: Sides, task: Task) -> Trained:
    """A trained network, with the exit rule chosen on its validation windows; a detector has none."""
    if task.detects:
        return Trained(network, training, FULL_WINDOW)
    training_side = sides.train if task.exit_choice == "steady" else None
    held = exit_of(network, sides.validation, task.exit_tolerance, training_side)
    return refusing(Trained(network, training, held.rule, held=held), sides.validation, task)


def refusing(trained: Trained, validation: Examples, task: Task) -> Trained:
    """The network with the least leads of its decisions by its exit rule, if the task refuses a share of touches."""
    return trained._replace(refusal=refusal_of(trained.network, trained.rule, validation, task))


def refusal_of(network: Network, exit_rule: ExitRule, validation: Examples, task: Task) -> Refusal | None:
    """The least leads of the decisions on validation windows; None if the task refuses none."""
    if task.refuse is None:
        return None
    spikes, of = validation.spikes.to(network.device), validation.of
    whole, early = (network.infer(spikes, rule).readout.cpu() for rule in (FULL_WINDOW, exit_rule))
    return Refusal.of(task.refuse, whole, early, len(spikes) if of is None else len(of.unique()))


def new_network(
    trains: SpikeTrains, spec: RSNNSpec, seeds: tuple[int, int], training: Tensor, task: Task | None = None, *,
    backend: Backend = "auto",
) -> tuple[Network, torch.Generator]:  # fmt: skip
    """An untrained network for the afferents and classes of some spike trains, and the generator of the trials' order.

    training: spikes of the training windows; a recipe chooses from them, and weights are scaled on them.
    task: as for `tasks.names_of`.
    """
    weights, order = (torch.Generator().manual_seed(seed) for seed in seeds)
    names, spec = names_of(trains, task), spec_for(spec, task.numbers if task else ())
    return begin(training, len(names), spec, trains.sampling_rate_Hz, weights, backend=backend), order


def begin(
    training: Tensor,
    n_classes: int,
    spec: RSNNSpec,
    sampling_rate_Hz: float,
    generator: torch.Generator,
    *,
    backend: Backend = "auto",
) -> Network:
    """An untrained network for training windows `(window, time, afferent)`, with the choices of its recipe for them."""
    chosen = recipe.chosen_for(spec, training, sampling_rate_Hz)
    network = module.new(training.shape[2], n_classes, chosen, sampling_rate_Hz, backend=backend, generator=generator)
    _warn_of_merged(network, training)
    initial.start(network, training, generator)
    return network


def _warn_of_merged(network: Network, training: Tensor) -> None:
    """Warn of input spikes that the network's clock is too slow for, if they are more than the recipe merges."""
    n_merged, n_spikes = clock.merged(training, network.steps_per_bin), int(training.count_nonzero())
    if n_merged > recipe.MERGED * n_spikes:
        most_ms = 1e3 * clock.apart(training) / network.sampling_rate_Hz
        warnings.warn(
            f"training: {clock.in_words(n_merged, n_spikes)}; step_ms = {most_ms:g} merges none", stacklevel=4
        )


@torch.no_grad()
def exit_of(
    network: Network,
    validation: Examples,
    tolerance: float,
    training: Examples | None = None,
) -> ExitChoice:
    """The early exit of fewest steps within `tolerance`, with its losses on trials that did not choose it.

    Rules are ascending in their mean steps on validation windows: of classes, in their patience.
    training: windows that `steady` evaluates together with the validation windows; without them `least` chooses.
    """
    labels, deviation = validation.labels.cpu(), validation.deviation
    of = torch.arange(len(labels)) if validation.of is None else validation.of
    bands = [()] if deviation is None else [tuple((share * deviation.double()).tolist()) for share in BANDS]
    right, steps = map(torch.cat, zip(*_right(network, validation, bands), strict=True))
    order = steps.double().mean(dim=0).argsort(stable=True)  # whole windows stay the last
    judged = Judged(right[:, order].numpy(), labels.reshape(len(labels), -1)[:, 0].numpy(), of.numpy())
    seen = None
    if training is not None:
        counts = torch.stack([part.sum(dim=0) for part, _ in _right(network, training, bands)])
        seen = counts.sum(dim=0)[order], len(training.labels)
    index = patience.choose(judged, tolerance, seen)
    if deviation is not None and index == len(order) - 1:
        return ExitChoice(FULL_WINDOW, {}, tolerance)
    band, which = divmod(int(order[index]), right.shape[1] // len(bands))
    rule = patience.patience_rule(which, network.steps_per_bin, bands[band])
    return ExitChoice(rule, patience.losses(judged, tolerance, seen), tolerance)


def _right(network: Network, examples: Examples, bands: Sequence[tuple[float, ...]]) -> Iterator[tuple[Tensor, Tensor]]:
    """Whether each window is decided correctly by each rule, or its score, and its steps, some windows at a time.

    `(window, rule)` each; the rules are those of each band, ascending in their patience.
    """
    for readout, labels in _readouts(network, examples):
        found = [patience.exits(readout, integration=network.integration, band=band) for band in bands]
        scores = [patience.is_right(each, labels, examples.deviation).cpu() for each in found]
        yield torch.cat(scores, dim=1), torch.cat([each.steps for each in found], dim=1).cpu()


def _readouts(network: Network, examples: Examples) -> Iterator[tuple[Tensor, Tensor]]:
    """Readout rasters and labels, a part of the windows at a time."""
    device = network.device
    for spikes, labels in zip(examples.spikes.split(AT_ONCE), examples.labels.split(AT_ONCE), strict=True):
        yield network.simulate(spikes.to(device)).readout, labels.to(device)
