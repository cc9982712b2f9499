"""LSTM and GRU classifiers of sequences, trained singly or many at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
import torch
from neurotact_parts.opponents import rounding
from neurotact_parts.opponents.pooled_gru import GRU
from neurotact_parts.opponents.targets import encode
from neurotact_parts.studies.probabilities import ProbabilitiesMixin
from neurotact_parts.studies.touch_modality.recurrent_layers import GRULayers, Layers, LSTMLayers, Shape
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted
from torch import Tensor
from torch.nn import functional, init

from neurotact.baselines.opponent import Opponent
from neurotact.checks import at_least, sequences, trial_labels
from neurotact.errors import InputError
from neurotact.metrics.flops import SIGMOID, TANH, Cost, Dense, Layer, changed, in_registers, with_weights
from neurotact.networks.definition.optimisers import kind_of

SIGNAL_AXES = "trial, time, channel"

AT_ONCE = 50
"""Networks in one computation: more bring no speed-up and need more memory."""

PREDICTED_AT_ONCE = 256
"""Trials in one prediction, which bounds its memory."""


class _RecurrentClassifier(ProbabilitiesMixin, ClassifierMixin, BaseEstimator):
    """The common part: a layer of `hidden` cells whose last state feeds a dense softmax."""

    _layers: ClassVar[type[Layers]]

    def __init__(
        self,
        hidden: int = 10,
        epochs: int = 96,
        batch: int = 48,
        learning_rate: float = 1e-3,
        random_state: int | np.random.RandomState | None = None,
    ):
        self.hidden = hidden
        self.epochs = epochs
        self.batch = batch
        self.learning_rate = learning_rate
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike):
        """Train on X `(trial, time, channel)`, y `(trial,)`."""
        problem = _problem(self, X, y)
        self._keep(_train(self, [problem], [self.epochs])[0][0], problem)
        return self

    def predict_proba(self, X: ArrayLike) -> np.ndarray:
        """Softmax of the outputs, `(trial, class)`. The number of steps may differ from that of training."""
        check_is_fitted(self)
        signals = sequences(X, SIGNAL_AXES, float)
        if signals.shape[2] != self.n_channels_:
            raise InputError(f"X: has {signals.shape[2]} channels, but training had {self.n_channels_}; give those")
        parts = [self._logits(part) for part in torch.tensor(signals).split(PREDICTED_AT_ONCE)]
        return torch.cat(parts).softmax(dim=1).numpy()

    def _logits(self, signals: Tensor) -> Tensor:
        n_trials, n_steps, n_channels = signals.shape
        layers = self._layers(Shape(1, n_trials, n_steps, n_channels, self.hidden), torch.float64)
        layers.x.copy_(signals.permute(1, 2, 0)[:, None])
        biases = self.biases_[:, None]
        layer = torch.tensor(np.hstack([self.input_weights_.T, self.recurrent_weights_.T, biases]))[None]
        state = layers.forward(layer)[0, : self.hidden]
        return state.T @ torch.tensor(self.coef_) + torch.tensor(self.intercept_)

    def _keep(self, weights: Tensor, problem: "_Problem") -> None:
        layer, dense = _views(weights[None].double(), problem.shape(self.hidden, 1), self._layers, problem.n_classes)
        x, h, biases = layer[0].T.split([problem.X.shape[2], self.hidden, 1])
        self.input_weights_, self.recurrent_weights_, self.biases_ = x.numpy(), h.numpy(), biases[0].numpy()
        self.coef_, self.intercept_ = dense[0, :, :-1].T.numpy(), dense[0, :, -1].numpy()
        self.n_channels_, self.n_parameters_ = problem.X.shape[2], weights.numel()


class LSTMClassifier(_RecurrentClassifier):
    """One LSTM layer and a dense softmax on its last state, trained on cross-entropy by Adam (touch-modality paper).

    Gates i, f, o are sigmoids with one bias each; candidate and output use tanh. Initialised as in Keras:
    Glorot uniform input weights, orthogonal recurrent weights, forget biases one, other biases zero. Every epoch uses
    a new order of the trials; the last batch may be smaller. Scale the signals beforehand.

    Parameters
    ----------
    hidden : cells.
    epochs, batch, learning_rate : of the training; the paper tries epochs 48 and 96, batches of 48 and 69.
    random_state : seed or RandomState of the weights and of the order of the trials.

    Attributes
    ----------
    classes_ `(class,)`; n_parameters_, all of them trained; n_channels_; input_weights_ `(channel, gates)`;
    recurrent_weights_ `(hidden, gates)`; biases_ `(gates,)`, where gates are i, f, candidate, o of all cells in turn;
    coef_ `(hidden, class)`; intercept_ `(class,)`.

    Raises InputError for signals that are not `(trial, time, channel)`, for a single class and for parameters out of
    range.

    >>> X, y = np.random.default_rng(0).normal(size=(6, 20, 16)), ["brushing", "rolling", "sliding"] * 2
    >>> LSTMClassifier(hidden=10, epochs=1, random_state=0).fit(X, y).n_parameters_
    1113
    """

    _layers = LSTMLayers


class GRUClassifier(_RecurrentClassifier):
    """One GRU layer and a dense softmax on its last state, trained on cross-entropy by Adam (touch-modality paper).

    The reset gate is applied before the recurrent product, so each gate has one bias. Initialisation, training and
    parameters are those of `LSTMClassifier`, except that all biases start at zero; gates are z (update), r (reset) and
    candidate.

    >>> X, y = np.random.default_rng(0).normal(size=(6, 20, 16)), ["brushing", "rolling", "sliding"] * 2
    >>> [GRUClassifier(hidden, epochs=1, random_state=0).fit(X, y).n_parameters_ for hidden in (10, 12)]
    [843, 1083]
    """

    _layers = GRULayers


Classifier = TypeVar("Classifier", bound=_RecurrentClassifier)


def fit_snapshots(
    prototype: Classifier,
    examples: Sequence[tuple[ArrayLike, ArrayLike]],
    seeds: Sequence[int],
    epochs: Sequence[int],
) -> list[list[Classifier]]:
    """Fit a copy of `prototype` to each `(X, y)` with its seed, for each of `epochs`: `[epochs][network]`.

    All are one batched computation at the cost of the largest number of epochs. Each network equals
    `clone(prototype).set_params(random_state=seed, epochs=epochs).fit(X, y)` to rounding; fifty take about five
    times as long as one. One pair of arrays may be listed many times at no cost.

    >>> X, y = np.random.default_rng(0).normal(size=(6, 5, 2)), [0, 1] * 3
    >>> early, late = fit_snapshots(GRUClassifier(4), [(X, y), (X, y)], seeds=[0, 1], epochs=[1, 2])
    >>> alone = GRUClassifier(4, epochs=2, random_state=1).fit(X, y)
    >>> np.allclose(late[1].predict_proba(X), alone.predict_proba(X), atol=1e-5)
    True
    """
    networks = [clone(prototype).set_params(random_state=seed) for seed in seeds]
    known: dict[tuple[int, int], tuple[np.ndarray, np.ndarray, Tensor]] = {}
    problems = [_problem(net, X, y, known) for net, (X, y) in zip(networks, examples, strict=True)]
    fitted = [[clone(net) for net in networks] for _ in epochs]

    def shape(i: int) -> tuple[int, ...]:
        return (*problems[i].X.shape, problems[i].n_classes)

    for _, group in groupby(sorted(range(len(networks)), key=shape), key=shape):
        alike = list(group)
        for chosen in (alike[start : start + AT_ONCE] for start in range(0, len(alike), AT_ONCE)):
            snapshots = _train(prototype, [problems[i] for i in chosen], epochs)
            for copies, weights in zip(fitted, snapshots, strict=True):
                for i, w in zip(chosen, weights, strict=True):
                    copies[i].classes_ = networks[i].classes_
                    copies[i]._keep(w, problems[i])
    return fitted


class _Problem(NamedTuple):
    X: Tensor  # (time, trial, channel): a trial's channels are adjacent, so that selecting trials is fast
    y: Tensor
    n_classes: int
    generator: torch.Generator

    def shape(self, hidden: int, n_trials: int, n_networks: int = 1) -> Shape:
        return Shape(n_networks, n_trials, self.X.shape[0], self.X.shape[2], hidden)


def _problem(
    network: _RecurrentClassifier,
    X: ArrayLike,
    y: ArrayLike,
    known: dict[tuple[int, int], tuple[np.ndarray, np.ndarray, Tensor]] | None = None,
) -> _Problem:
    """Check and convert; arrays in `known`, by identity, are converted only once."""
    for name in ("hidden", "epochs", "batch"):
        at_least(name, getattr(network, name), 1, whole=True)
    at_least("learning_rate", network.learning_rate, 0, above=True)
    known = {} if known is None else known
    if (id(X), id(y)) not in known:
        signals = sequences(X, SIGNAL_AXES, np.float32)
        tensor = torch.tensor(signals).transpose(0, 1).contiguous()
        known[id(X), id(y)] = (*encode(trial_labels(y, len(signals))), tensor)
    network.classes_, indices, tensor = known[id(X), id(y)]
    seed = int(check_random_state(network.random_state).randint(2**31 - 1))
    generator = torch.Generator().manual_seed(seed)
    return _Problem(tensor, torch.tensor(indices), len(network.classes_), generator)


def _start(shape: Shape, kind: type[Layers], problem: _Problem) -> Tensor:
    """All weights of one network in a row, first the layer, then the dense part, as `_views` reads them."""
    n_rows, generator = kind.n_gates * shape.hidden, problem.generator
    layer = torch.zeros(n_rows, shape.stacked)
    init.xavier_uniform_(layer[:, : shape.channels], generator=generator)
    layer[:, shape.state] = init.orthogonal_(torch.empty(n_rows, shape.hidden), generator=generator)
    if kind is LSTMLayers:
        layer[shape.hidden : 2 * shape.hidden, -1] = 1  # of the forget gate, as in Keras
    dense = torch.zeros(problem.n_classes, shape.hidden + 1)
    init.xavier_uniform_(dense[:, :-1], generator=generator)
    return torch.cat([layer.flatten(), dense.flatten()])


def _views(weights: Tensor, shape: Shape, kind: type[Layers], n_classes: int) -> tuple[Tensor, Tensor]:
    """The layer `(network, gates, channel+hidden+1)` and the dense `(network, class, hidden+1)` in the rows."""
    n_rows = kind.n_gates * shape.hidden
    layer, dense = weights.split([n_rows * shape.stacked, n_classes * (shape.hidden + 1)], dim=1)
    return layer.view(-1, n_rows, shape.stacked), dense.view(-1, n_classes, shape.hidden + 1)


def _train(network: _RecurrentClassifier, problems: list[_Problem], epochs: Sequence[int]) -> list[Tensor]:
    """Weights `(network, parameter)` after each of `epochs`, of one network for each problem, all of one shape."""
    kind, first = network._layers, problems[0]
    shape = first.shape(network.hidden, network.batch, len(problems))
    weights = torch.stack([_start(shape, kind, p) for p in problems])
    layer, dense = _views(weights, shape, kind, first.n_classes)
    weights.grad = torch.zeros_like(weights)
    d_layer, d_dense = _views(weights.grad, shape, kind, first.n_classes)
    optimiser = kind_of("Adam")([weights.requires_grad_()], lr=network.learning_rate, eps=1e-7, fused=True)
    by_size: dict[int, Layers] = {}
    snapshots = {}
    with torch.no_grad():
        for epoch in range(1, max(epochs) + 1):
            orders = torch.stack([torch.randperm(len(p.y), generator=p.generator) for p in problems])
            for chosen in orders.split(network.batch, dim=1):
                n_trials = chosen.shape[1]
                if n_trials not in by_size:
                    by_size[n_trials] = kind(shape._replace(trials=n_trials))
                layers = by_size[n_trials]
                labels = torch.stack([p.y[trials] for p, trials in zip(problems, chosen, strict=True)])
                for i, (p, trials) in enumerate(zip(problems, chosen, strict=True)):
                    layers.x[:, i] = p.X.index_select(1, trials).transpose(1, 2)
                state = layers.forward(layer)
                d_logits = _d_cross_entropy(torch.bmm(dense, state), labels)
                torch.bmm(d_logits, state.transpose(1, 2), out=d_dense)
                d_layer.copy_(layers.backward(torch.bmm(dense[:, :, :-1].transpose(1, 2), d_logits)))
                optimiser.step()
            if epoch in epochs:
                snapshots[epoch] = weights.detach().clone()
    return [snapshots[epoch] for epoch in epochs]


def _d_cross_entropy(logits: Tensor, labels: Tensor) -> Tensor:
    """Gradient of the mean cross-entropy of each network, `(network, class, trial)`."""
    n_trials = logits.shape[2]
    truth = functional.one_hot(labels, logits.shape[1]).transpose(1, 2)
    return (logits.softmax(dim=1) - truth) / n_trials


LSTM_UNIT = in_registers(macs=1, multiplications=2) + SIGMOID.times(3) + TANH.times(2)
"""A unit of an LSTM in a step, beside its gates' sums: `f c`, `+ i g`, `o tanh(c)`."""


@dataclass(frozen=True)
class LSTM(Layer):
    """`steps` steps of an LSTM with one bias a gate.

    A step: four gates; `c = f c + i g`; `h = o tanh(c)`; three sigmoids and two tanhs a unit.
    """

    inputs: int
    units: int
    steps: int = 1

    def cost(self) -> Cost:
        n, gates = self.units, 4 * self.units * (self.inputs + self.units)
        parameters = gates + 4 * n
        weights = Cost(macs=gates, weights_accesses=parameters, **changed(2 * n), buffers_accesses=self.inputs)
        return with_weights(parameters, 2 * n) + (weights + LSTM_UNIT.times(n)).times(self.steps)


HIDDEN, TRAINING = (10, 30), {"epochs": 60, "batch": 48, "learning_rate": 0.01}
"""Of both opponents."""


def _opponent(build: type[_RecurrentClassifier], layer: type[LSTM | GRU]) -> Opponent:
    def layers(fitted: _RecurrentClassifier, x: np.ndarray) -> tuple[Layer, ...]:
        _, n_steps, n_channels = x.shape
        return layer(n_channels, fitted.hidden, n_steps), Dense(fitted.hidden, len(fitted.classes_), "softmax")

    return Opponent(
        f"One {layer.__name__} layer and a softmax on its last state.",
        build,
        lambda sides, seed: [{"hidden": hidden, **TRAINING} for hidden in HIDDEN],
        "sequences",
        layers,
        lambda fitted: f"N {fitted.hidden}",
        rounded=rounding.weights,
        joins="named",
    )


LAST_LSTM, LAST_GRU = _opponent(LSTMClassifier, LSTM), _opponent(GRUClassifier, GRU)
