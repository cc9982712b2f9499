"""The training of a network without a hidden layer: a regression on the spikes of each stretch of a window.

It is logistic for classes, and ridge regression for numbers.

The problem is convex: one penalty has one solution, whatever the seeds are, and no learning rate. The penalty is chosen
on validation windows, as that of the opponents is.

How many stretches suit a task is not known before: few where the number of spikes tells the classes apart, many where
their times do. So the weight of a stretch is the sum of one for the whole window, one for its half, its quarter and so
on, and all of these are penalised alike: what coarse weights can say costs least, since they receive most spikes. On
900 windows of seven fabrics, 32 stretches have 95.4 % so, 4 stretches with a single weight each 93.3 % and 40 of them
78.9 %.

With `training.sparsity` the smallest synapses are pruned after that, and what is left is fitted again.
"""

import warnings
from collections.abc import Callable

import numpy as np
import torch
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression, Ridge
from torch.nn.functional import cross_entropy, mse_loss

from neurotact.networks.definition.optimisers import kind_of
from neurotact.networks.definition.readouts import Stretches
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.training import epochs, sparsity
from neurotact.networks.training.epochs import Epoch, Examples, Training

INVERSE_PENALTIES = (0.001, 0.01, 0.1, 1.0, 10.0)
"""Of weights in units of the spread of counts; the strongest of equally good ones stands."""
MOST_ITERATIONS, TOLERANCE = 200, 1e-3
ABSENT = -100.0
"""The bias of a class without training windows, beside which it is never chosen."""


def train(
    network: RSNN,
    training: Examples,
    validation: Examples,
    *,
    progress: Callable[[Epoch], None] | None = None,
    member: int = 1,
) -> Training:
    """Fit the weights of a network with `hidden = 0` in place; an epoch of the log is a penalty.

    The one with the highest validation accuracy stays, of equally accurate ones that with the lowest loss; the last
    epoch of a pruned network is that of what is left.

    >>> from neurotact.networks.definition.specs import RSNNSpec
    >>> net = RSNN(2, 2, RSNNSpec(hidden=0, readout="integrator"), 1000.0)
    >>> spikes = torch.zeros(4, 9, 2, dtype=torch.uint8)
    >>> spikes[::2, 3, 0] = spikes[1::2, 5, 1] = 1
    >>> touches = Examples(spikes, torch.tensor([0, 1, 0, 1]))
    >>> train(net, touches, touches).best.validation_accuracy
    1.0
    """
    training, validation = training.binned(network), validation.binned(network)
    levels = _levels(1 if network.stretches is None else network.stretches.number)
    counts = _counts(network, training)
    center, spread = counts.mean(axis=0), np.sqrt(counts.var(axis=0).mean() * len(levels)) or 1.0
    summed = np.einsum("nka,kl->nla", (counts - center) / spread, levels).reshape(len(counts), -1)
    weights = None if training.weights is None else training.weights.numpy()
    log: list[Epoch] = []
    states = []
    for penalty in INVERSE_PENALTIES:
        fitted = _regression(training, penalty)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # of counts that carry no information
            fitted.fit(summed, training.labels.numpy(), weights)
        _set(network, fitted, levels / spread, center)
        log.append(Epoch(len(log) + 1, *epochs.judge(network, training), *epochs.judge(network, validation), member))
        states.append(epochs.copied(network.state_dict()))
        if progress:
            progress(log[-1])
    best = epochs.best_of(log, "accuracy")
    network.load_state_dict(states[best.epoch - 1])
    if share := network.spec.training.sparsity:
        sparsity.prune(network, share)
        _fit_what_is_left(network, fitted, summed, training, INVERSE_PENALTIES[best.epoch - 1])
        _set(network, fitted, levels / spread, center)
        best = Epoch(len(log) + 1, *epochs.judge(network, training), *epochs.judge(network, validation), member)
        log.append(best)
    return Training(tuple(log), best)


def _regression(training: Examples, penalty: float) -> LogisticRegression | Ridge:
    """The regression with an inverse penalty; of numbers, `classes_` are the places of all targets."""
    if training.labels.ndim == 1:
        return LogisticRegression(C=penalty, max_iter=MOST_ITERATIONS, tol=TOLERANCE)
    fitted = Ridge(alpha=1 / penalty)
    fitted.classes_ = np.arange(training.labels.shape[1])
    return fitted


def _fit_what_is_left(
    network: RSNN, fitted: LogisticRegression | Ridge, summed: np.ndarray, training: Examples, penalty: float
) -> None:
    """Fit a regression anew with the synapses of a pruned network, in place; summed: its inputs, `(window, input)`."""
    remains = (network.w_out.cpu() != 0)[:, fitted.classes_].repeat(summed.shape[1] // network.n_inputs, 1)
    inputs, labels = torch.from_numpy(summed), training.labels.double()
    if is_logistic := isinstance(fitted, LogisticRegression):
        labels = torch.from_numpy(np.searchsorted(fitted.classes_, training.labels.numpy()))
    slopes = torch.zeros(remains.shape, dtype=torch.float64, requires_grad=True)
    level = torch.zeros(len(fitted.classes_), dtype=torch.float64, requires_grad=True)
    each = penalty * (torch.ones(len(labels)) if training.weights is None else training.weights).double()
    optimiser = kind_of("LBFGS")([slopes, level], max_iter=MOST_ITERATIONS, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        scores = inputs @ (slopes * remains) + level
        if is_logistic:
            losses = cross_entropy(scores, labels, reduction="none")
        else:
            losses = mse_loss(scores, labels, reduction="none").sum(dim=1) / 2
        total = losses @ each + slopes.square().sum() / 2
        total.backward()
        return total

    optimiser.step(loss)
    fitted.coef_, fitted.intercept_ = slopes.detach().T.numpy(), level.detach().numpy()


def _counts(network: RSNN, examples: Examples) -> np.ndarray:
    """Spikes of each afferent in each stretch, `(window, K, afferent)` float64; the examples are binned."""
    stretches = network.stretches or Stretches(1, 1)
    parts = examples.spikes.cpu().split(network.spec.training.batch)
    return torch.cat([stretches.counts(part).double() for part in parts]).numpy()


def _levels(n: int) -> np.ndarray:
    """Which stretches each weight is of, `(stretch, weight)`: single ones, pairs, and so on up to the whole window.

    >>> _levels(3).astype(int).tolist()
    [[1, 0, 0, 1, 0, 1], [0, 1, 0, 1, 0, 1], [0, 0, 1, 0, 1, 1]]
    """
    sizes = [2**level for level in range(1 + (n - 1).bit_length())]
    return np.concatenate([np.eye(-(-n // size))[np.arange(n) // size] for size in sizes], axis=1)


@torch.no_grad()
def _set(network: RSNN, fitted: LogisticRegression | Ridge, levels: np.ndarray, center: np.ndarray) -> None:
    """Give the network the weights of a fit: those of all stretches are their mean, and deviations from it.

    levels: what each weight of the fit adds to those of the stretches. center: the counts from which it begins.
    """
    coef, level = np.atleast_2d(fitted.coef_), np.atleast_1d(fitted.intercept_)  # a row of the only number
    slopes = coef.reshape(len(coef), levels.shape[1], -1)
    if len(slopes) == 1 and isinstance(fitted, LogisticRegression):  # of two classes
        slopes, level = np.concatenate([-slopes, slopes]) / 2, np.concatenate([-level, level]) / 2
    slopes = np.einsum("cla,kl->kac", slopes, levels)
    level = level - np.einsum("kac,ka->c", slopes, center)
    bias = np.full(network.n_classes, ABSENT + level.min())
    weights = np.zeros((*slopes.shape[:2], network.n_classes))
    bias[fitted.classes_], weights[..., fitted.classes_] = level, slopes
    own, scale = torch.from_numpy(weights), 1 / network.spec.training.temperature
    own *= scale
    assert network.bias is not None
    network.bias.copy_(torch.from_numpy(scale * bias))
    network.w_out.copy_(own.mean(dim=0))
    if network.w_stretch is not None:
        network.w_stretch.copy_(own - own.mean(dim=0))
