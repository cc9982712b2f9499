"""Training by surrogate gradients, epoch by epoch: a loss of readout counts, rate penalties, early stopping."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import pandas as pd
import torch
from torch import Tensor

from neurotact import workers
from neurotact.backend import n_threads
from neurotact.baselines.opponent import right
from neurotact.errors import InputError, number_of
from neurotact.networks.definition import optimisers
from neurotact.networks.definition.module import ModuleNetwork
from neurotact.networks.definition.network import Counts, Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import Keep, TrainingSpec
from neurotact.networks.training import losses, sparsity
from neurotact.notebook import html_of


class Examples(NamedTuple):
    """Spikes `(trial, time, afferent)` uint8, and what is learned of each: `tasks.labels_of`.

    weights: of each trial's loss, `(trial,)` float32 with the mean 1; None: all count alike.
    of: the recorded trial that each one is a window of, `(trial,)` int64; None: each is of its own.
    deviation: of numbers, `(target,)` float32, in which `right` measures errors; None of classes.
    """

    spikes: Tensor
    labels: Tensor
    weights: Tensor | None = None
    of: Tensor | None = None
    deviation: Tensor | None = None

    def binned(self, network: Network) -> "Examples":
        """The same on the clock of a network."""
        return self._replace(spikes=network.binned(self.spikes))


JOINED = NOT_KEPT = 0


class Epoch(NamedTuple):
    """One line of the training log; accuracies are shares of trials.

    member: in a checkpoint, which of the networks that are trained one after another, from 1. In the log of a finished
        training, which of those that are kept, from 1, `NOT_KEPT` of the other one; `JOINED`: the joined network.
    """

    epoch: int
    train_loss: float
    train_accuracy: float
    validation_loss: float
    validation_accuracy: float
    member: int = 1


GAINS = ("recurrence_gain", "smallest_accuracy", "layer_gain", "path_gain")
"""Columns of results: what was tried in training, as of `Training`; absent where it was not."""


@dataclass(frozen=True)
class Training:
    """The result of a training: its log, and the epoch whose weights the network now has.

    If several networks were trained, `epochs` are those of all of them, one network after another. `best` is of the
    network that is kept; if several were joined, of the joined network.
    recurrence_gain: with `model = "auto"`, the validation accuracy with recurrence minus that without; None if it was
        not tried.
    smallest_accuracy: with `direct = "auto"`, the validation accuracy without a hidden layer; None if that was not
        tried.
    layer_gain, path_gain: the validation accuracy with a hidden layer minus that without, and that with the path past
        it minus that with the layer alone; None if it was not tried.
    """

    epochs: tuple[Epoch, ...]
    best: Epoch
    recurrence_gain: float | None = None
    smallest_accuracy: float | None = None
    layer_gain: float | None = None
    path_gain: float | None = None

    @property
    def n_members(self) -> int:
        """The number of networks that were joined; 1: one is kept."""
        return max((epoch.member for epoch in self.epochs), default=1)

    def __repr__(self) -> str:
        n = self.n_members
        state = f"{n} networks joined" if n > 1 else f"best: epoch {self.best.epoch}"
        return (
            f"Training({number_of(len(self.epochs), 'epoch')}; {state}, validation loss "
            f"{self.best.validation_loss:.3g}, validation accuracy {self.best.validation_accuracy:.3g})"
        )

    def table(self) -> pd.DataFrame:
        """The log: a row for each epoch, with the columns of `Epoch`, `member` only where several were trained.

        >>> Training((Epoch(1, 0.7, 0.5, 0.6, 0.75),), Epoch(1, 0.7, 0.5, 0.6, 0.75)).table().shape
        (1, 5)
        """
        log = pd.DataFrame(self.epochs, columns=list(Epoch._fields))
        return log if log["member"].nunique() > 1 else log.drop(columns="member")

    def _repr_html_(self) -> str:
        return html_of(self, table=self.table().to_html(index=False, float_format="{:.3f}".format))


@dataclass(frozen=True)
class Checkpoint:
    """A training between two epochs: everything that its continuation depends on, as copies on the CPU.

    epochs: the log so far.
    weights: the network's state after the last epoch; best_weights: after the best one.
    optimiser: its values of each trained parameter, named as in "w_in.exp_avg" (`optimisers.state_of`).
    generator: the state of the generator that orders the trials.
    finished: where several networks are trained one after another, the states of those before the present one.
    """

    epochs: tuple[Epoch, ...]
    weights: Mapping[str, Tensor]
    best_weights: Mapping[str, Tensor]
    optimiser: Mapping[str, Tensor]
    generator: Tensor
    finished: tuple[Mapping[str, Tensor], ...] = ()


def loss(counts: Counts, labels: Tensor, spec: TrainingSpec, weights: Tensor | None = None) -> Tensor:
    """The loss of the spec on the readout counts times the temperature, and two rate penalties of the Braille study.

    `rate_penalty` weights the spikes of a hidden neuron in a window, averaged over trials and neurons;
    `population_penalty` weights the squared spike count of a batch, averaged over neurons.
    weights: of the loss of each trial, `(trial,)`.
    """
    scores = counts.readout if spec.temperature == 1 else counts.readout * spec.temperature
    total = losses.of_scores(spec.loss, scores, labels, weights)
    if not counts.hidden.shape[1]:  # they are not counted
        return total
    if spec.rate_penalty:
        total = total + spec.rate_penalty * counts.hidden.mean()
    if spec.population_penalty:
        total = total + spec.population_penalty * counts.hidden.sum(dim=0).square().mean()
    return total


def train(
    network: Network,
    training: Examples,
    validation: Examples,
    *,
    generator: torch.Generator,
    progress: Callable[[Epoch], None] | None = None,
    start: Checkpoint | None = None,
    keep: Callable[[Checkpoint], None] | None = None,
    member: int = 1,
) -> Training:
    """Train `network` in place by its spec; at the end it has the weights of the best epoch (`TrainingSpec.keep`).

    generator: orders the trials, and drops and moves input spikes; with the network's, its seed reproduces a training.
    progress: called after each epoch.
    start: the last checkpoint of an earlier call with the same arguments; the result is that of an uninterrupted call.
        With a relative learning rate, `network` has its initial weights, which the rates depend on.
    keep: called after each epoch with a checkpoint for `start`.
    member: of its epochs.
    Raises InputError if a weight is no longer finite: its neurons would become silent without an error. And for a spec
    with several members, which `ensemble.train` trains.

    >>> from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
    >>> spec = RSNNSpec(hidden=8, training=TrainingSpec(epochs=2, batch=4))
    >>> net = RSNN(2, 2, spec, 2000.0, backend="reference", generator=torch.Generator().manual_seed(0))
    >>> touches = Examples(torch.ones(6, 50, 2, dtype=torch.uint8), torch.tensor([0, 1, 0, 1, 0, 1]))
    >>> len(train(net, touches, touches, generator=torch.Generator().manual_seed(0)).epochs)
    2
    """
    if network.spec.training.members > 1:
        raise InputError("training.members: this trains one network; set it to 1, or train with `nt.train`")
    training, validation = _on_its_clock(network, training), validation.binned(network)
    optimiser = _optimiser(network)
    rates = [group["lr"] for group in optimiser.param_groups]
    log: list[Epoch] = []
    best_weights: Mapping[str, Tensor] = {}
    if start is not None:
        log, best_weights = list(start.epochs), start.best_weights
        _restore(start, network, optimiser, generator)
    while not is_over(log, network.spec.training):
        order = torch.randperm(len(training.labels), generator=generator)
        epoch_rates = _Rates(network.spec.training, rates, len(log))
        with workers.threads(n_threads(_size(network))):
            fitted = _pass(network, training, order, optimiser, epoch_rates, generator)
            judged = judge(network, validation)
        log.append(Epoch(len(log) + 1, *fitted, *judged, member))
        if not all(p.isfinite().all() for p in network.parameters()):
            raise not_finite(len(log), network.spec.training)
        if progress:
            progress(log[-1])
        if best_in(log, network.spec.training) is log[-1]:
            best_weights = copied(network.state_dict())
        if keep:
            state = copied(network.state_dict()), best_weights, _state(network, optimiser)
            keep(Checkpoint(tuple(log), *state, generator.get_state()))
    network.load_state_dict(best_weights)
    return Training(tuple(log), best_in(log, network.spec.training))


def _size(network: Network) -> float:
    """Hidden neurons x windows of a batch; infinite for a network of another package that does not say how many."""
    spec = network.spec
    return math.inf if spec.own is not None and not spec.n_hidden else spec.n_hidden * spec.training.batch


def best_in(log: Sequence[Epoch], spec: TrainingSpec) -> Epoch:
    """The best epoch of a training; of those that have its final `sparsity`, and before there is one, the last.

    >>> log = [Epoch(n, 0.1, 1.0, 0.1 * n, 1.0) for n in (1, 2, 3)]
    >>> best_in(log, TrainingSpec(epochs=3)).epoch, best_in(log, TrainingSpec(epochs=3, sparsity=0.5)).epoch
    (1, 2)
    """
    first = sparsity.Ramp.of(spec).end
    return best_of([epoch for epoch in log if epoch.epoch >= first] or log[-1:], spec.keep)


def best_of(log: Sequence[Epoch], keep: Keep = "loss") -> Epoch:
    """The best epoch by `TrainingSpec.keep`, the first among equal ones.

    `both` is for few validation windows: an epoch that has learned nothing may classify most of them by chance.

    >>> log = [Epoch(1, 2.0, 0.1, 1.5, 0.67), Epoch(2, 0.1, 1.0, 1.9, 0.56)]
    >>> best_of(log, "loss").epoch, best_of(log, "accuracy").epoch, best_of(log, "both").epoch
    (1, 1, 2)
    """
    if keep == "loss":
        return min(log, key=lambda epoch: epoch.validation_loss)
    if keep == "accuracy":
        return min(log, key=lambda epoch: (-epoch.validation_accuracy, epoch.validation_loss))
    return min(
        log,
        key=lambda epoch: (
            -(epoch.train_accuracy + epoch.validation_accuracy),
            epoch.train_loss + epoch.validation_loss,
        ),
    )


def is_over(log: Sequence[Epoch], spec: TrainingSpec) -> bool:
    """Whether a training with this log has run all its epochs, has exceeded its patience or has learned its windows.

    >>> log = [Epoch(1, 0.004, 1.0, 0.009, 1.0)]
    >>> is_over(log, TrainingSpec(epochs=9)), is_over(log, TrainingSpec(epochs=9, target_loss=0.01))
    (False, True)
    """
    if not log:
        return False
    has_ended = len(log) >= spec.epochs or log[-1].epoch - best_in(log, spec).epoch >= spec.patience
    return has_ended or has_learned(log, spec)


def has_learned(log: Sequence[Epoch], spec: TrainingSpec) -> bool:
    """Whether the last epoch has every window right, with mean losses of at most `target_loss`, and its `sparsity`."""
    *_, (epoch, train_loss, train_accuracy, validation_loss, validation_accuracy, _) = log
    is_low = max(train_loss, validation_loss) <= spec.target_loss and epoch >= sparsity.Ramp.of(spec).end
    return spec.target_loss > 0 and is_low and min(train_accuracy, validation_accuracy) == 1


def not_finite(epoch: int, spec: TrainingSpec) -> InputError:
    """The error for weights that are no longer finite."""
    return InputError(
        f"training: weights are not finite after epoch {epoch}; lower the learning rate, as in {spec.lower_rate}"
    )


def _optimiser(network: Network) -> torch.optim.Optimizer:
    spec = network.spec.training
    options = {"lr": spec.learning_rate, "betas": spec.betas, "weight_decay": spec.weight_decay}
    return optimisers.make(spec.optimiser, _groups(network), **options)


def rates_of(network: Network) -> dict[str, float]:
    """The learning rate of each trained parameter before any schedule, in the network's order.

    >>> from neurotact.networks.definition.specs import RSNNSpec
    >>> rates_of(RSNN(2, 2, RSNNSpec(model="snn", hidden=3), 1000.0))
    {'w_in': 0.001, 'w_out': 0.001}
    """
    spec = network.spec.training
    trained = {name: p.detach() for name, p in network.named_parameters() if p.requires_grad}
    if spec.relative_learning_rate is None:
        shares = {name: spec.stretch_rate if name == "w_stretch" else 1.0 for name in trained}
        return {name: share * spec.learning_rate for name, share in shares.items()}
    deviation = {name: float(p.square().mean().sqrt()) if p.ndim == 2 else 0.0 for name, p in trained.items()}
    if "w_rec" in trained:
        deviation["w_rec"] *= math.sqrt(network.spec.recurrent_blocks)  # of the synapses that exist
    if "w_stretch" in trained:  # it begins at 0
        deviation["w_stretch"] = spec.stretch_rate * deviation["w_out"]
    return {name: spec.relative_learning_rate * size or spec.learning_rate for name, size in deviation.items()}


def _rate_left(spec: TrainingSpec, epochs: float) -> float:
    """The factor of the schedule on the learning rates after so many epochs.

    >>> _rate_left(TrainingSpec(epochs=10), 5.0), round(_rate_left(TrainingSpec(epochs=10, schedule="cosine"), 5.0), 9)
    (1.0, 0.5)
    """
    if spec.schedule != "cosine":
        return 1.0
    begin = sparsity.Ramp.of(spec).end  # what is left learns while weights go; of a dense network 0
    return 0.5 * (1 + math.cos(math.pi * max(0.0, epochs - begin) / max(1, spec.epochs - begin)))


def _groups(network: Network) -> list[dict[str, Any]]:
    """The trained parameters: one group or, where rates or decays differ, one group each, in the network's order."""
    spec, rates = network.spec.training, rates_of(network)
    trained = [p for p in network.parameters() if p.requires_grad]
    if spec.relative_learning_rate is None and "w_stretch" not in rates and not spec.weight_decay:
        return [{"params": trained}]
    groups = [{"params": [p], "lr": rate} for p, rate in zip(trained, rates.values(), strict=True)]
    return [group if group["params"][0].ndim > 1 else {**group, "weight_decay": 0.0} for group in groups]


def disturbed(spikes: Tensor, dropout: float, jitter_steps: int, generator: torch.Generator) -> Tensor:
    """Spikes `(trial, time, afferent)`, some left out and the others moved by up to `jitter_steps`.

    Spikes that would leave the window stay at its first or last step; spikes that coincide become one.

    >>> one = torch.zeros(1, 9, 1, dtype=torch.uint8)
    >>> one[0, 4, 0] = 1
    >>> moved = disturbed(one, 0.0, 2, torch.Generator().manual_seed(0))
    >>> int(moved.sum()), 2 <= int(moved[0, :, 0].argmax()) <= 6
    (1, True)
    """
    trial, step, afferent = spikes.nonzero(as_tuple=True)
    kept = torch.rand(len(step), generator=generator) >= dropout
    moves = torch.randint(-jitter_steps, jitter_steps + 1, (len(step),), generator=generator)
    moved = torch.zeros_like(spikes)
    moved[trial[kept], (step + moves)[kept].clamp(0, spikes.shape[1] - 1), afferent[kept]] = 1
    return moved


def partly_heard(hidden: Tensor, dropout: float, generator: torch.Generator) -> Tensor:
    """Counts `(..., hidden)`, some set to 0 and the others scaled up, to preserve their mean."""
    kept = torch.rand(hidden.shape, generator=generator) >= dropout
    return hidden * kept.to(hidden) / (1 - dropout)


class _Rates(NamedTuple):
    """The learning rates of an epoch: `first` of each group, before any step, and the number of earlier epochs."""

    spec: TrainingSpec
    first: Sequence[float]
    epochs_before: int

    def after(self, share: float) -> float:
        """Epochs after this share of the present one."""
        return self.epochs_before + share

    def set(self, optimiser: torch.optim.Optimizer, share: float) -> None:
        """Set the rates of the groups after this share of the epoch."""
        left = _rate_left(self.spec, self.after(share))
        for group, rate in zip(optimiser.param_groups, self.first, strict=True):
            group["lr"] = rate * left


EXPLODED = 1e6
"""A median gradient norm from which no training recovers: trainings that learn stay some thousandfold below it."""


@torch.no_grad()
def _relative_norm(network: Network) -> Tensor:
    """Norm of the gradient in units of the weights: the effect on the loss of a change by their own size.

    It does not grow with the window, in which small weights receive many spikes.
    """
    parts = [p.grad.norm() * p.square().mean().sqrt() for p in network.parameters() if p.grad is not None]
    return torch.stack(parts).norm()


def _warn_of_explosion(norms: Sequence[Tensor], epoch: int) -> None:
    """Warn of gradients that explode: Adam then follows noise."""
    median = float(torch.stack(list(norms)).median())
    if EXPLODED < median < math.inf:  # weights that are no longer finite raise an error
        warnings.warn(
            f"training: gradients explode (median norm {median:.0e} in epoch {epoch}); use model = 'snn', which has "
            "no recurrence, a larger surrogate_scale or shorter time constants",
            stacklevel=3,
        )


def _jitter_steps(network: Network) -> int:
    return round(network.spec.training.input_jitter_ms * 1e-3 * network.sampling_rate_Hz)


def _disturbs(network: Network) -> bool:
    """Whether training drops or moves input spikes, anew in each step."""
    return bool(network.spec.training.input_dropout or _jitter_steps(network))


def _on_its_clock(network: Network, training: Examples) -> Examples:
    """Training windows in bins, once for all; where spikes are dropped or moved, each batch is put into bins later."""
    return training if _disturbs(network) else training.binned(network)


def _pass(
    network: Network,
    training: Examples,
    order: Tensor,
    optimiser: torch.optim.Optimizer,
    rates: _Rates,
    generator: torch.Generator,
) -> tuple[float, float]:
    """Train on every trial once, in this order; `(loss, accuracy)`, of each batch before its step."""
    spec, device = network.spec.training, network.device
    batches, norms, losses, scores = order.split(spec.batch), [], [], []
    ramp, n = sparsity.Ramp.of(spec), len(batches)
    for number, batch in enumerate(batches):
        rates.set(optimiser, number / n)
        # copies whole windows, where indexing with a tensor copies byte by byte: a tenth of the time
        spikes, labels = training.spikes.index_select(0, batch), training.labels[batch].to(device)
        if _disturbs(network):
            spikes = network.binned(disturbed(spikes, spec.input_dropout, _jitter_steps(network), generator))
        spikes = spikes.to(device)
        optimiser.zero_grad()
        counts = _counts_with_dropout(network, spikes, generator)
        batch_loss = loss(counts, labels, spec, _weights(training, batch, device))
        batch_loss.backward()
        _stay_apart(network)
        norms.append(_relative_norm(network))
        with ramp.step(network, rates.after(number / n), rates.after((number + 1) / n)):
            optimiser.step()
        network.bound()
        losses.append(batch_loss.detach())
        scores.append(right(counts.readout.detach(), labels).sum())
    _warn_of_explosion(norms, rates.epochs_before + 1)
    return _mean(losses, scores, batches)


def _stay_apart(network: Network) -> None:
    """Remove the gradients of recurrent synapses between blocks, whose weights then stay 0."""
    if not isinstance(network, RSNN) or network.w_rec is None or network.spec.recurrent_blocks == 1:
        return
    within = network.within_blocks()
    for name, parameter in network.named_parameters():
        if "w_rec" in name.split(".") and parameter.grad is not None:  # also where it is parametrised
            parameter.grad.mul_(within)


def _weights(examples: Examples, batch: Tensor, device: torch.device) -> Tensor | None:
    """The weights of the trials of a batch."""
    return None if examples.weights is None else examples.weights[batch].to(device)


def _mean(losses: Sequence[Tensor], scores: Sequence[Tensor], batches: Sequence[Tensor]) -> tuple[float, float]:
    """`(loss, accuracy)` over all batches; the numbers are copied from the device once."""
    sizes = [len(batch) for batch in batches]
    total = sum(value * size for value, size in zip(torch.stack([*losses]).tolist(), sizes, strict=True))
    return total / sum(sizes), torch.stack([*scores]).sum().item() / sum(sizes)


def _counts_with_dropout(network: Network, spikes: Tensor, generator: torch.Generator) -> Counts:
    """The counts of a batch; an integrator receives a part of them if it has drop-out."""
    if isinstance(network, ModuleNetwork):
        return network.counts_in_training(spikes, generator)
    assert isinstance(network, RSNN)
    dropout = network.spec.training.readout_dropout
    if not dropout or network.bias is None:
        return network.counts(spikes)
    if network.stretches is not None or network.spec.hears_afferents:
        factors = partly_heard(torch.ones(len(spikes), len(network.w_out)), dropout, generator).to(network.w_out)
        return network.counts(spikes, factors)
    if network.leaks:
        factors = partly_heard(torch.ones(network.spec.hidden), dropout, generator).to(network.w_out)
        return network.counts(spikes, factors)
    counts = network.counts(spikes)
    return counts._replace(readout=network.sums(partly_heard(counts.hidden, dropout, generator)))


def _restore(start: Checkpoint, network: Network, optimiser: torch.optim.Optimizer, generator: torch.Generator) -> None:
    """Set network, optimiser and generator to the state of a checkpoint."""
    network.load_state_dict(start.weights)
    trained = [name for name, p in network.named_parameters() if p.requires_grad]
    # Loading does not copy tensors that fit, and steps work in place: the copy protects the checkpoint.
    state = {i: copied(tensors_of(start.optimiser, name)) for i, name in enumerate(trained)}
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
    generator.set_state(start.generator)


def _state(network: Network, optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    parameters = ((name, p) for name, p in network.named_parameters() if p.requires_grad)
    states = ((name, optimisers.state_of(optimiser, p)) for name, p in parameters)
    return copied({f"{name}.{key}": value for name, state in states for key, value in state.items()})


def tensors_of(tensors: Mapping[str, Tensor], part: str) -> dict[str, Tensor]:
    """The tensors of a part, such as a parameter's optimiser, by the rest of their names.

    >>> tensors_of({"w_in.step": torch.tensor(1.0), "w_out.step": torch.tensor(2.0)}, "w_out")
    {'step': tensor(2.)}
    """
    return {name.removeprefix(f"{part}."): t for name, t in tensors.items() if name.startswith(f"{part}.")}


def copied(tensors: Mapping[Any, Tensor]) -> dict[Any, Tensor]:
    """Copies of tensors, on the CPU and without gradients."""
    return {name: tensor.detach().to("cpu", copy=True) for name, tensor in tensors.items()}


def evaluate(network: Network, examples: Examples) -> tuple[float, float]:
    """`(loss, accuracy)` over the full window."""
    return judge(network, examples.binned(network))


@torch.no_grad()
def judge(network: Network, examples: Examples) -> tuple[float, float]:
    """`evaluate` of examples that are on the network's clock."""
    spec, device = network.spec.training, network.device
    batches, losses, scores = torch.arange(len(examples.labels)).split(spec.batch), [], []
    for spikes, batch in zip(examples.spikes.split(spec.batch), batches, strict=True):
        counts, labels = network.counts(spikes.to(device)), examples.labels[batch]
        losses.append(loss(counts, labels.to(device), spec, _weights(examples, batch, device)))
        scores.append(right(counts.readout, labels.to(device), examples.deviation).sum())
    return _mean(losses, scores, batches)


@torch.no_grad()
def right_of(network: Network, examples: Examples) -> Tensor:
    """`right` of each window; the examples are on the network's clock."""
    scores, size = [], network.spec.training.batch
    for spikes, labels in zip(examples.spikes.split(size), examples.labels.split(size), strict=True):
        counts = network.counts(spikes.to(network.device))
        scores.append(right(counts.readout.cpu(), labels, examples.deviation))
    return torch.cat(scores)
