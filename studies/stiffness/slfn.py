"""Single-hidden-layer networks trained by back-propagation, many at once."""

from collections.abc import Sequence
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
import torch
from neurotact_parts.opponents import rounding
from neurotact_parts.opponents.targets import encode, indices_of
from neurotact_parts.studies.probabilities import ProbabilitiesMixin
from numpy.typing import ArrayLike
from scipy.special import expit, softmax
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.model_selection import train_test_split
from sklearn.utils import check_random_state
from torch import Tensor
from torch.nn import functional

from neurotact.baselines.opponent import Opponent
from neurotact.checks import at_least, fraction, one_of
from neurotact.data.copies import equal_examples
from neurotact.data.splits import hold_out
from neurotact.errors import InputError
from neurotact.estimators import further_examples, training_examples
from neurotact.metrics.flops import Dense, Layer
from neurotact.networks.definition.optimisers import kind_of

Activation = Literal["sigmoid", "relu"]
Examples = tuple[ArrayLike, ArrayLike]


class SLFNClassifier(ProbabilitiesMixin, ClassifierMixin, BaseEstimator):
    """Single-hidden-layer feed-forward network with a softmax, trained by back-propagation on cross-entropy.

    Stiffness paper, Eq. 1 (S-FC, R-FC): Adam, initial weights uniform in (-1, 1), biases zero; training stops when the
    accuracy on the validation examples has not risen for `patience` epochs, and the weights of the best epoch (ties:
    the first) are kept. Inputs are not scaled: standardise them in a pipeline.

    Parameters
    ----------
    hidden : neurons of the hidden layer.
    activation : "sigmoid" or "relu".
    epochs, patience : maximum number of epochs, and of epochs without a rise.
    batch, learning_rate : of Adam's steps; the last batch of an epoch may be smaller.
    validation_fraction : share of the examples split off by class for validation, if `fit` is given none.
    random_state : seed or RandomState of the weights, the order of the examples and that split.

    Attributes
    ----------
    classes_ `(class,)`; hidden_weights_ `(feature, hidden)`; hidden_biases_ `(hidden,)`; coef_ `(hidden, class)`;
    intercept_ `(class,)`; n_epochs_ that were trained; best_epoch_, from 1; validation_accuracy_ at that epoch.

    Raises InputError for a single class, for parameters out of range and for too few examples to split.

    >>> X = np.linspace(-1, 1, 40)[:, None]
    >>> net = SLFNClassifier(hidden=10, epochs=50, random_state=0).fit(X, np.where(X[:, 0] < 0, "soft", "hard"))
    >>> net.predict([[-0.5], [0.5]]).tolist()
    ['soft', 'hard']
    """

    def __init__(
        self,
        hidden: int = 50,
        activation: Activation = "relu",
        epochs: int = 200,
        patience: int = 20,
        batch: int = 64,
        learning_rate: float = 0.01,
        validation_fraction: float = 0.15,
        random_state: int | np.random.RandomState | None = None,
    ):
        self.hidden = hidden
        self.activation = activation
        self.epochs = epochs
        self.patience = patience
        self.batch = batch
        self.learning_rate = learning_rate
        self.validation_fraction = validation_fraction
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike, validation: Examples | None = None) -> "SLFNClassifier":
        """Train on X `(example, feature)`, y `(example,)`; `validation` is `(X, y)` of other examples."""
        self._keep(_train(self, [_problem(self, X, y, validation)])[0])
        return self

    def predict_proba(self, X: ArrayLike) -> np.ndarray:
        """Softmax of the outputs, `(example, class)`."""
        X = further_examples(self, X)
        drive = X @ self.hidden_weights_ + self.hidden_biases_
        active = expit(drive) if self.activation == "sigmoid" else np.maximum(drive, 0.0)
        return softmax(active @ self.coef_ + self.intercept_, axis=1)

    def _keep(self, trained: "_Trained") -> None:
        weights = (w.double().numpy() for w in trained.weights)
        self.hidden_weights_, self.hidden_biases_, self.coef_, self.intercept_ = weights
        self.n_epochs_, self.best_epoch_ = trained.n_epochs, trained.best_epoch
        self.validation_accuracy_ = trained.accuracy


def fit_many(
    prototype: SLFNClassifier, splits: Sequence[tuple[Examples, Examples]], seeds: Sequence[int]
) -> list[SLFNClassifier]:
    """Fit a copy of `prototype` to each split with its seed, all in one batched computation.

    splits: `(training, validation)` of each network, each an `(X, y)`; one split may be listed several times.
    Each network equals `clone(prototype).set_params(random_state=seed).fit(*training, validation)`.

    >>> X, y = np.random.default_rng(0).normal(size=(30, 2)), np.arange(30) % 2
    >>> split = ((X[:20], y[:20]), (X[20:], y[20:]))
    >>> together = fit_many(SLFNClassifier(hidden=5, epochs=3), [split, split], seeds=[0, 1])
    >>> alone = SLFNClassifier(hidden=5, epochs=3, random_state=1).fit(*split[0], validation=split[1])
    >>> np.allclose(together[1].coef_, alone.coef_)
    True
    """
    networks = [clone(prototype).set_params(random_state=seed) for seed in seeds]
    problems = [
        _problem(network, *training, validation)
        for network, (training, validation) in zip(networks, splits, strict=True)
    ]

    def shape(i: int) -> tuple[int, ...]:
        p = problems[i]
        return (*p.X.shape, len(p.X_held), p.n_classes)

    for _, group in groupby(sorted(range(len(networks)), key=shape), key=shape):
        alike = list(group)
        for i, trained in zip(alike, _train(prototype, [problems[i] for i in alike]), strict=True):
            networks[i]._keep(trained)
    return networks


class _Problem(NamedTuple):
    X: Tensor
    y: Tensor
    X_held: Tensor
    y_held: Tensor
    n_classes: int
    generator: torch.Generator


class _Trained(NamedTuple):
    weights: list[Tensor]
    n_epochs: int
    best_epoch: int
    accuracy: float


def _problem(network: SLFNClassifier, X: ArrayLike, y: ArrayLike, validation: Examples | None) -> _Problem:
    _check_parameters(network)
    X, labels = training_examples(network, X, y)
    network.classes_, indices = encode(labels)
    rng = check_random_state(network.random_state)
    seed = int(rng.randint(2**31 - 1))
    if validation is None:
        X, X_held, indices, held = _split_off(X, indices, network.validation_fraction, rng)
    else:
        X_held, held = further_examples(network, validation[0]), indices_of(validation[1], network.classes_)
    tensors = (torch.tensor(X, dtype=torch.float32), torch.tensor(indices))
    tensors += (torch.tensor(X_held, dtype=torch.float32), torch.tensor(held))
    return _Problem(*tensors, len(network.classes_), torch.Generator().manual_seed(seed))


def _check_parameters(network: SLFNClassifier) -> None:
    one_of("activation", network.activation, ("sigmoid", "relu"))
    for name in ("hidden", "epochs", "patience", "batch"):
        at_least(name, getattr(network, name), 1, whole=True)
    at_least("learning_rate", network.learning_rate, 0, above=True)
    fraction("validation_fraction", network.validation_fraction, above=True)


def _split_off(X: np.ndarray, indices: np.ndarray, share: float, rng: np.random.RandomState) -> list[np.ndarray]:
    """`X, X_held, indices, held`, at least one example of each class on either side, and equal examples on one."""
    n_classes = indices.max() + 1
    n_held = max(n_classes, round(share * len(X)))
    if np.bincount(indices).min() < 2 or len(X) - n_held < n_classes:
        raise InputError(
            f"y: {len(X)} examples of {n_classes} classes are too few to split off validation examples "
            "(n_samples=1 of a class is never enough); give more, or give fit a validation set"
        )
    first = equal_examples(X, indices)
    if (first == np.arange(len(X))).all():
        return train_test_split(X, indices, test_size=n_held, stratify=indices, random_state=rng)
    held = np.isin(np.arange(len(X)), hold_out(indices, share, rng, first))
    return [X[~held], X[held], indices[~held], indices[held]]


def _start(problem: _Problem, hidden: int) -> list[Tensor]:
    def uniform(*shape: int) -> Tensor:
        return 2 * torch.rand(shape, generator=problem.generator) - 1

    into, out_of = uniform(problem.X.shape[1], hidden), uniform(hidden, problem.n_classes)
    return [into, torch.zeros(hidden), out_of, torch.zeros(problem.n_classes)]


def _logits(weights: Sequence[Tensor], X: Tensor, activation: str) -> Tensor:
    """`(network, example, class)` from X `(network, example, feature)`."""
    into, into_biases, out_of, out_of_biases = weights
    drive = torch.baddbmm(into_biases[:, None], X, into)
    active = drive.sigmoid() if activation == "sigmoid" else drive.relu()
    return torch.baddbmm(out_of_biases[:, None], active, out_of)


def _train(network: SLFNClassifier, problems: list[_Problem]) -> list[_Trained]:
    """Train one network for each problem, all of one shape; those that have stopped leave the computation."""
    X, y, X_held, y_held = (torch.stack(t) for t in list(zip(*problems, strict=True))[:4])
    weights = [torch.stack(w) for w in zip(*(_start(p, network.hidden) for p in problems), strict=True)]
    weights = [w.requires_grad_() for w in weights]
    optimiser = kind_of("Adam")(weights, lr=network.learning_rate, fused=True)
    best = [w.detach().clone() for w in weights]
    best_accuracy, best_epoch = (
        torch.full((len(problems),), -1.0, dtype=torch.float64),
        torch.zeros(len(problems), dtype=torch.int64),
    )
    n_epochs = torch.zeros_like(best_epoch)
    running = torch.arange(len(problems))
    for epoch in range(1, network.epochs + 1):
        _train_epoch(network, weights, optimiser, X, y, [problems[i].generator for i in running])
        accuracy = _accuracy(weights, X_held, y_held, network.activation)
        better = accuracy > best_accuracy[running]
        risen = running[better]
        best_accuracy[risen], best_epoch[risen], n_epochs[running] = accuracy[better], epoch, epoch
        for kept, w in zip(best, weights, strict=True):
            kept[risen] = w.detach()[better]
        going = epoch - best_epoch[running] < network.patience
        if not going.any():
            break
        if not going.all():
            running, X, y, X_held, y_held = (t[going] for t in (running, X, y, X_held, y_held))
            _drop(weights, optimiser, going)
    return [
        _Trained([w[i] for w in best], int(n_epochs[i]), int(best_epoch[i]), float(best_accuracy[i]))
        for i in range(len(problems))
    ]


def _train_epoch(
    network: SLFNClassifier,
    weights: list[Tensor],
    optimiser: torch.optim.Optimizer,
    X: Tensor,
    y: Tensor,
    generators: list[torch.Generator],
) -> None:
    order = torch.stack([torch.randperm(X.shape[1], generator=g) for g in generators])
    rows = torch.arange(len(X))[:, None]
    for chosen in order.split(network.batch, dim=1):
        logits = _logits(weights, X[rows, chosen], network.activation)
        # Summed over networks, since each has its own weights; averaged over each batch.
        loss = functional.cross_entropy(logits.flatten(0, 1), y[rows, chosen].flatten(), reduction="sum")
        optimiser.zero_grad()
        (loss / chosen.shape[1]).backward()
        optimiser.step()


@torch.no_grad()
def _accuracy(weights: list[Tensor], X: Tensor, y: Tensor, activation: str) -> Tensor:
    return (_logits(weights, X, activation).argmax(dim=2) == y).double().mean(dim=1)


def _drop(weights: list[Tensor], optimiser: torch.optim.Optimizer, kept: Tensor) -> None:
    """Keep only some networks, with their Adam state."""
    for w in weights:
        w.data, w.grad = w.data[kept], None
        state = optimiser.state[w]
        state["exp_avg"], state["exp_avg_sq"] = state["exp_avg"][kept], state["exp_avg_sq"][kept]


def _layers(fitted: SLFNClassifier, x: np.ndarray) -> tuple[Layer, ...]:
    return Dense(x.shape[1], fitted.hidden, "relu"), Dense(fitted.hidden, len(fitted.classes_), "softmax")


OPPONENT = Opponent(
    "ReLU networks trained by back-propagation, stopped on validation accuracy.",
    SLFNClassifier,
    [{"hidden": hidden} for hidden in (10, 30, 100)],
    layers=_layers,
    words=lambda fitted: f"N {fitted.hidden}",
    rounded=rounding.weights,
    joins="named",
)
