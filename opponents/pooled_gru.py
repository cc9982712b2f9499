"""A GRU by a modern recipe: mean and maximum of its states over time, drop-out, AdamW with one cycle of the rate."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from neurotact_parts.opponents import rounding
from neurotact_parts.opponents.targets import encode, indices_of
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin, RegressorMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted
from torch import Tensor, nn

from neurotact.baselines.opponent import Opponent
from neurotact.checks import at_least, fraction, sequences, trial_labels
from neurotact.errors import InputError
from neurotact.metrics.flops import SIGMOID, TANH, Cost, Dense, Layer, changed, in_registers, passed, with_weights
from neurotact.networks.definition.optimisers import kind_of
from neurotact.progress import at

GRU_HIDDEN = (64, 128)
BATCHES, MOST_BATCH, LEAST_BATCH = 16, 64, 8
"""Batches of an epoch that are aimed at, and the limits of a batch."""
LEAST_STEPS, LEAST_EPOCHS, MOST_EPOCHS = 800, 40, 200
"""Training steps that few windows get by more epochs."""
MOST_STEPS, FEWEST_EPOCHS = 2400, 10
"""Training steps that many windows get by fewer epochs, and the fewest epochs."""
LEARNED = 0.01
"""Mean loss, of the training and of the validation trials, at which training ends if all of them are right: nothing is
left to learn. The default network ends by the same rule."""
LARGEST_GRADIENT = 1.0
PREDICTED_AT_ONCE = 512


class _OnPooledGRU(BaseEstimator):
    """One GRU layer; the mean and the maximum of its states over time feed a dense layer."""

    def __init__(
        self,
        hidden: int = 128,
        dropout: float = 0.3,
        learning_rate: float = 4e-3,
        weight_decay: float = 0.01,
        epochs: int | None = None,
        random_state: int | np.random.RandomState | None = None,
    ):
        self.hidden = hidden
        self.dropout = dropout
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay
        self.epochs = epochs
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike, validation: tuple[ArrayLike, ArrayLike] | None = None) -> Any:
        """Train on X `(trial, time, channel)`, y `(trial,)`; validation: trials of the same kind."""
        self._check()
        signals = torch.from_numpy(sequences(X, "trial, time, channel", np.float32))
        if isinstance(self, ClassifierMixin):
            self.classes_, _ = encode(trial_labels(y, len(signals)))
        labels = self._targets(y)
        n_told = labels.shape[1] if labels.ndim > 1 else len(self.classes_)
        self.n_channels_ = signals.shape[2]
        held = None
        if validation is not None:
            held_X = torch.from_numpy(sequences(validation[0], "trial, time, channel", np.float32))
            held = held_X, self._targets(validation[1])
        batch = min(MOST_BATCH, max(LEAST_BATCH, round(len(labels) / BATCHES)))
        per_epoch = math.ceil(len(labels) / batch)
        least = max(FEWEST_EPOCHS, min(LEAST_EPOCHS, MOST_STEPS // per_epoch))
        self.epochs_ = self.epochs or min(MOST_EPOCHS, max(least, math.ceil(LEAST_STEPS / per_epoch)))
        with torch.random.fork_rng(devices=[]):  # drop-out draws from torch's own generator
            torch.manual_seed(int(check_random_state(self.random_state).randint(2**31 - 1)))
            self.network_ = _PooledGRU(self.n_channels_, self.hidden, n_told, self.dropout)
            self._train(signals, labels, held, batch, per_epoch)
        self.n_parameters_ = sum(weights.numel() for weights in self.network_.parameters())
        return self

    def outputs(self, X: ArrayLike) -> np.ndarray:
        """Of the dense layer, `(trial, output)`."""
        check_is_fitted(self)
        signals = torch.from_numpy(sequences(X, "trial, time, channel", np.float32))
        if signals.shape[2] != self.n_channels_:
            raise InputError(f"X: has {signals.shape[2]} channels, but training had {self.n_channels_}; give those")
        return self._logits(signals).numpy()

    def _targets(self, y: ArrayLike) -> Tensor:
        """What is learned: numbers `(trial, target)`, or class indices `(trial,)`."""
        return torch.from_numpy(np.asarray(y, np.float32).reshape(len(np.asarray(y)), -1))

    def _train(
        self, signals: Tensor, labels: Tensor, held: tuple[Tensor, Tensor] | None, batch: int, per_epoch: int
    ) -> None:
        optimiser = kind_of("AdamW")(self.network_.parameters(), lr=self.learning_rate, weight_decay=self.weight_decay)
        rates = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, self.learning_rate, epochs=self.epochs_, steps_per_epoch=per_epoch
        )
        best: tuple[float, float] = (-1.0, 0.0)
        kept: dict[str, Tensor] = {}
        for epoch in range(1, self.epochs_ + 1):
            at(f"GRU of {self.hidden}", epoch - 1, self.epochs_)
            self.network_.train()
            n_right, total = 0, 0.0
            for chosen in torch.randperm(len(labels)).split(batch):
                optimiser.zero_grad()
                logits = self.network_(signals[chosen])
                loss, n = _judged(logits, labels[chosen])
                n_right += n
                total += len(chosen) * float(loss.detach())
                loss.backward()
                nn.utils.clip_grad_norm_(self.network_.parameters(), LARGEST_GRADIENT)
                optimiser.step()
                rates.step()
            if held is None:
                continue
            logits = self._logits(held[0])
            loss, n = _judged(logits, held[1])
            accuracy = n / len(logits)
            merit = accuracy, -float(loss)
            if merit > best:
                best = merit
                kept = {name: weights.clone() for name, weights in self.network_.state_dict().items()}
            is_right = accuracy == 1 and n_right == len(labels)
            if is_right and max(-merit[1], total / len(labels)) <= LEARNED:
                self.epochs_ = epoch
                break
        if kept:
            self.network_.load_state_dict(kept)
        self.network_.eval()

    @torch.no_grad()
    def _logits(self, signals: Tensor) -> Tensor:
        self.network_.eval()
        return torch.cat([self.network_(part) for part in signals.split(PREDICTED_AT_ONCE)])

    def _check(self) -> None:
        at_least("hidden", self.hidden, 1, whole=True)
        at_least("learning_rate", self.learning_rate, 0, above=True)
        at_least("weight_decay", self.weight_decay, 0)
        fraction("dropout", self.dropout)
        if self.epochs is not None:
            at_least("epochs", self.epochs, 1, whole=True)


class PooledGRUClassifier(ClassifierMixin, _OnPooledGRU):
    """One GRU layer; the mean and the maximum of its states over time feed a dense softmax.

    Trained on cross-entropy by AdamW with one cycle of the learning rate (Smith and Topin 2018) and clipped gradients.
    The number of epochs and the batch follow from the number of training trials. With validation trials the weights of
    the epoch with the highest accuracy on them are kept (ties: the lowest loss), and training ends when it has learned
    all trials (`LEARNED`); otherwise those of the last epoch are kept.

    Parameters
    ----------
    hidden : cells. dropout : share of the pooled states that are dropped in training.
    learning_rate : the largest of the cycle. weight_decay : of AdamW.
    epochs : None chooses them.
    random_state : seed or RandomState of the weights, the order of the trials and the drop-out.

    Attributes
    ----------
    classes_ `(class,)`; network_, a torch module; n_parameters_; n_channels_; epochs_, that were trained.

    Raises InputError for sequences that are not `(trial, time, channel)`, for a single class and for parameters out of
    range.

    >>> X, y = np.random.default_rng(0).normal(size=(6, 20, 4)), ["felt", "silk", "wool"] * 2
    >>> PooledGRUClassifier(hidden=8, epochs=1, random_state=0).fit(X, y).predict(X).shape
    (6,)
    """

    def _targets(self, y: ArrayLike) -> Tensor:
        return torch.from_numpy(indices_of(y, self.classes_))

    def predict(self, X: ArrayLike) -> np.ndarray:
        """Labels `(trial,)`."""
        return self.classes_[self.outputs(X).argmax(axis=1)]


class PooledGRURegressor(RegressorMixin, _OnPooledGRU):
    """The same for numbers `(trial, target)`: trained on squared error, and of the epoch with the lowest on validation.

    >>> X = np.random.default_rng(0).normal(size=(6, 20, 4))
    >>> PooledGRURegressor(hidden=8, epochs=1, random_state=0).fit(X, X.mean(axis=1)).predict(X).shape
    (6, 4)
    """

    predict = _OnPooledGRU.outputs


def _judged(outputs: Tensor, labels: Tensor) -> tuple[Tensor, int]:
    """The loss, and how many trials have the right class: none of numbers, of which the lowest loss is the best."""
    if labels.is_floating_point():
        return nn.functional.mse_loss(outputs, labels), 0
    return nn.functional.cross_entropy(outputs, labels), int((outputs.argmax(dim=1) == labels).sum())


class _PooledGRU(nn.Module):
    def __init__(self, n_channels: int, hidden: int, n_classes: int, dropout: float) -> None:
        super().__init__()
        self.gru = nn.GRU(n_channels, hidden, batch_first=True)
        self.dropout = nn.Dropout(dropout)
        self.dense = nn.Linear(2 * hidden, n_classes)

    def forward(self, signals: Tensor) -> Any:
        states = self.gru(signals)[0]
        return self.dense(self.dropout(torch.cat([states.mean(dim=1), states.max(dim=1).values], dim=1)))


@dataclass(frozen=True)
class GRU(Layer):
    """`steps` steps of a GRU with one bias a gate.

    A step: three gates; the reset `r h`; `h = g + z (h - g)`; two sigmoids and a tanh a unit.
    """

    inputs: int
    units: int
    steps: int = 1

    def cost(self) -> Cost:
        n, gates = self.units, 3 * self.units * (self.inputs + self.units)
        unit = in_registers(macs=1, acs=1, multiplications=1) + SIGMOID.times(2) + TANH
        weights = Cost(macs=gates, weights_accesses=gates + 3 * n, **changed(n), buffers_accesses=self.inputs)
        return with_weights(gates + 3 * n, n) + (weights + unit.times(n)).times(self.steps)


@dataclass(frozen=True)
class PooledStates(Layer):
    """Mean and maximum over `steps` steps of each of `units` states: an addition and a comparison each."""

    units: int
    steps: int

    def cost(self) -> Cost:
        n = self.units * self.steps
        moved = {**changed(2, n), **passed(0, 2 * self.units)}
        return with_weights(0, 2 * self.units, acs=n, multiplications=self.units, comparisons=n, **moved)


def _gru_layers(fitted: _OnPooledGRU, x: np.ndarray) -> tuple[Layer, ...]:
    (_, n_steps, n_channels), hidden = x.shape, fitted.hidden
    states = GRU(n_channels, hidden, n_steps), PooledStates(hidden, n_steps)
    last = "softmax" if isinstance(fitted, ClassifierMixin) else "linear"
    return *states, Dense(2 * hidden, fitted.network_.dense.out_features, last)


POOLED_GRU = Opponent(
    "GRUs of two sizes by a modern recipe.",
    PooledGRUClassifier,
    lambda sides, seed: [{"hidden": hidden} for hidden in GRU_HIDDEN],
    "sequences",
    _gru_layers,
    lambda fitted: f"N {fitted.hidden}, {fitted.epochs_} epochs",
    rounded=rounding.module,
    joins="all",
)
OF_NUMBERS = replace(POOLED_GRU, build=PooledGRURegressor, tells="numbers")
