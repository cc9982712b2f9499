"""MiniRocket: shares of positive values of many fixed convolutions, and a ridge classifier or regression on them.

Dempster, Schmidt and Webb 2021, KDD, doi 10.1145/3447548.3467231.
"""

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations, groupby
from typing import Any, NamedTuple

import numpy as np
import torch
from neurotact_parts.opponents import rounding
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.linalg.blas import dsyrk
from sklearn.base import BaseEstimator, ClassifierMixin, RegressorMixin, TransformerMixin
from sklearn.linear_model import Ridge, RidgeClassifier
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import LabelBinarizer, StandardScaler
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from neurotact.baselines.opponent import Opponent, part_of, rounded, say_once
from neurotact.checks import at_least, sequences, trial_labels
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Dense, Layer, Standardise, passed, with_weights
from neurotact.progress import counting

KERNEL = 9
"""Weights of a kernel: three are 2, the others -1."""
TRIPLES = tuple(combinations(range(KERNEL), 3))
"""The places of the three weights of 2: 84 kernels."""
FEATURES = 9996
"""As published: the most that are at most 10,000 and divide among the kernels."""
MOST_DILATIONS = 32
MOST_CHANNELS = 9
"""Most channels that one kernel adds up."""
GOLDEN = (5**0.5 + 1) / 2
AT_ONCE = 64
"""Sequences in one computation, which bounds its memory."""
BLOCK = 256
"""Features, or trials, that are standardised and added to a Gram matrix at once."""
ALPHAS = tuple(np.logspace(-3, 3, 10).tolist())
MOST_SEARCHED = 2000
"""Training trials on which the penalty is searched: leaving out each in turn takes time with the third power."""


class Convolution(NamedTuple):
    """One kernel at one dilation: its index among `TRIPLES`, the channels that it adds up, its biases `(feature,)`.

    padded: whether the convolution runs over zeros beyond the ends, so that it is as long as the sequence.
    """

    dilation: int
    kernel: int
    channels: np.ndarray
    biases: np.ndarray
    padded: bool


class MiniRocket(TransformerMixin, BaseEstimator):
    """MiniRocket's features, as published.

    A feature is the share of time at which a convolution of the sequence is above a bias. The kernels are fixed: nine
    weights, three of which are 2 and the others -1, at up to 32 dilations. Each adds up a random choice of channels.
    Biases are quantiles of the convolution of one random training sequence. Half of the convolutions are padded.

    Parameters
    ----------
    features : about how many, at least 84; rounded down to a multiple of 84.
    random_state : seed or RandomState of the channels and of the sequences that give the biases.

    Attributes
    ----------
    convolutions_ : list of `Convolution`, in the order of the features. n_channels_, n_steps_ : of the sequences.

    Raises InputError for sequences that are not `(trial, time, channel)` or are shorter than nine steps.

    >>> X = np.random.default_rng(0).normal(size=(4, 50, 2))
    >>> MiniRocket(features=84, random_state=0).fit_transform(X).shape
    (4, 84)
    """

    def __init__(self, features: int = FEATURES, random_state: int | np.random.RandomState | None = None):
        self.features = features
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> "MiniRocket":
        """Choose dilations, channels and biases. X `(trial, time, channel)`."""
        at_least("features", self.features, len(TRIPLES), whole=True)
        signals = sequences(X, "trial, time, channel", np.float32)
        _, self.n_steps_, self.n_channels_ = signals.shape
        if self.n_steps_ < KERNEL:
            raise InputError(f"X: has {self.n_steps_} steps; MiniRocket needs at least {KERNEL}")
        rng = check_random_state(self.random_state)
        per_dilation = dilations(self.n_steps_, self.features)
        shares = _quantiles(len(TRIPLES) * sum(n for _, n in per_dilation))
        self.convolutions_: list[Convolution] = []
        first = 0
        for index, (dilation, n_biases) in enumerate(per_dilation):
            for kernel in range(len(TRIPLES)):
                channels = _channels(self.n_channels_, rng)
                example = torch.from_numpy(signals[rng.randint(len(signals))][None])
                convolved = _convolve(_shifted(example, dilation), kernel, channels)[0].numpy()
                biases = np.quantile(convolved, shares[first : first + n_biases]).astype(np.float32)
                padded = (index + kernel) % 2 == 0
                self.convolutions_.append(Convolution(dilation, kernel, channels, biases, padded))
                first += n_biases
        return self

    def transform(self, X: ArrayLike) -> np.ndarray:
        """Features `(trial, feature)` float32, each from 0 to 1."""
        check_is_fitted(self)
        signals = sequences(X, "trial, time, channel", np.float32)
        if signals.shape[1:] != (self.n_steps_, self.n_channels_):
            raise InputError(
                f"X: sequences are {signals.shape[1:]}, those of training ({self.n_steps_}, {self.n_channels_}); "
                "give the same (time, channel)"
            )
        n, features = len(signals), sum(len(one.biases) for one in self.convolutions_)
        shares, advance = np.empty((n, features), np.float32), counting("MiniRocket", n)
        for first in range(0, n, AT_ONCE):
            part = torch.from_numpy(signals[first : first + AT_ONCE])
            shares[first : first + AT_ONCE] = self._transform(part)
            advance(len(part))
        return shares

    def _transform(self, signals: torch.Tensor) -> np.ndarray:
        features = []
        for dilation, own in groupby(self.convolutions_, key=lambda one: one.dilation):
            shifted, edge = _shifted(signals, dilation), (KERNEL - 1) * dilation // 2
            for convolution in own:
                convolved = _convolve(shifted, convolution.kernel, convolution.channels)
                inside = convolved if convolution.padded else convolved[:, edge:-edge]
                biases = torch.from_numpy(convolution.biases)[:, None]
                is_above = torch.empty(len(inside), len(biases), inside.shape[1])
                features.append(torch.gt(inside[:, None], biases, out=is_above).mean(dim=2).numpy())
        return np.concatenate(features, axis=1)


class _OnMiniRocket(BaseEstimator):
    """Ridge on standardised MiniRocket features; leave-one-out on training trials chooses its penalty."""

    _ridge: type

    def __init__(self, features: int = FEATURES, random_state: int | np.random.RandomState | None = None):
        self.features = features
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike) -> Any:
        """Fit on X `(trial, time, channel)`, y `(trial,)`, or numbers `(trial, target)`."""
        self.transform_ = MiniRocket(self.features, self.random_state)
        features = self.transform_.fit_transform(X)
        is_class = isinstance(self, ClassifierMixin)
        labels = trial_labels(y, len(features)) if is_class else np.asarray(y, float)
        targets = LabelBinarizer(neg_label=-1).fit_transform(labels) if is_class else labels.reshape(len(labels), -1)
        some = part_of(labels, MOST_SEARCHED)
        if len(some) < len(labels):
            say_once(
                f"baselines: the penalty of MiniRocket is searched on {len(some):,} training windows, evenly over "
                "their labels; it is fitted to all"
            )
        alpha = _penalty(features[some], targets[some])
        scaler, center = _scaler(features), targets.mean(axis=0)
        weights = _weights(features, scaler, targets - center, alpha)
        few = np.unique(labels, return_index=True)[1] if is_class else slice(2)
        ridge = self._ridge(alpha).fit(np.zeros((len(labels[few]), len(weights))), labels[few])  # it knows the classes
        ridge.coef_ = weights.T.reshape(ridge.coef_.shape)
        ridge.intercept_ = center.reshape(np.shape(ridge.intercept_))
        self.ridge_ = Pipeline([("standardscaler", scaler), (type(ridge).__name__.lower(), ridge)])
        if is_class:
            self.classes_ = ridge.classes_
        return self

    def predict(self, X: ArrayLike) -> np.ndarray:
        """Labels `(trial,)`, or numbers as they were fitted."""
        check_is_fitted(self, "ridge_")
        return self.ridge_.predict(self.transform_.transform(X))


class MiniRocketClassifier(ClassifierMixin, _OnMiniRocket):
    """A ridge classifier on standardised MiniRocket features; leave-one-out on training trials chooses its penalty.

    features, random_state : as for `MiniRocket`. Attributes: classes_ `(class,)`; transform_, ridge_, the fitted parts.

    >>> X = np.random.default_rng(0).normal(size=(8, 50, 2)) * np.repeat([1.0, 4.0], 4)[:, None, None]
    >>> MiniRocketClassifier(features=84, random_state=0).fit(X, list("aaaabbbb")).classes_.tolist()
    ['a', 'b']
    """

    _ridge = RidgeClassifier


class MiniRocketRegressor(RegressorMixin, _OnMiniRocket):
    """Ridge regression on the same features, of a number `(trial,)` or several `(trial, target)`.

    >>> X = np.random.default_rng(0).normal(size=(8, 50, 2))
    >>> MiniRocketRegressor(features=84, random_state=0).fit(X, X[:, :, 0].std(axis=1)).predict(X).shape
    (8,)
    """

    _ridge = Ridge


def _scaler(features: np.ndarray) -> StandardScaler:
    """What standardises features `(trial, feature)`; fitted to all at once, it would make a copy in float64."""
    scaler = StandardScaler()
    for first in range(0, len(features), AT_ONCE):
        scaler.partial_fit(features[first : first + AT_ONCE])
    return scaler


def _blocks(features: np.ndarray, scaler: StandardScaler, axis: int) -> Iterator[tuple[slice, np.ndarray]]:
    """Standardised features in float64, `BLOCK` trials (axis 0) or features (axis 1) at once, and which these are."""
    for first in range(0, features.shape[axis], BLOCK):
        some = slice(first, first + BLOCK)
        rows, columns = (some, slice(None)) if axis == 0 else (slice(None), some)
        yield some, (features[rows, columns] - scaler.mean_[columns]) / scaler.scale_[columns]


def _gram(features: np.ndarray, scaler: StandardScaler, axis: int) -> np.ndarray:
    """Products of standardised trials (axis 1) or features (axis 0), summed over the other axis; the upper triangle."""
    gram = np.zeros((features.shape[1 - axis],) * 2, order="F")
    for _, block in _blocks(features, scaler, axis):
        gram = dsyrk(1.0, block.T, 1.0, gram, trans=axis, overwrite_c=True)
    return gram


def _penalty(features: np.ndarray, targets: np.ndarray) -> float:
    """The first of `ALPHAS` with the least squared error on each trial in turn, left out of a ridge regression.

    From one eigendecomposition (Rifkin and Lippert 2007, MIT-CSAIL-TR-2007-025), as scikit-learn's. The direction that
    the intercept fits is given the eigenvalue `far`, so that no other one is like it, and its part is taken away.
    """
    n, gram = len(features), _gram(features, _scaler(features), axis=1)
    far = float(np.trace(gram))
    values, vectors = eigh(gram + far / n, lower=False, overwrite_a=True, check_finite=False)
    projected, squares, errors = vectors.T @ (targets - targets.mean(axis=0)), np.square(vectors), []
    for alpha in ALPHAS:
        gains = 1 / (values + alpha)
        inverse = squares @ gains - 1 / (n * (far + alpha))
        errors.append(np.square(vectors @ (gains[:, None] * projected) / inverse[:, None]).mean())
    return ALPHAS[int(np.argmin(errors))]


def _weights(features: np.ndarray, scaler: StandardScaler, targets: np.ndarray, alpha: float) -> np.ndarray:
    """Ridge weights `(feature, output)` for standardised features and targets without their mean.

    Of the Gram matrices of trials and of features the smaller one is factored, in its own memory.
    """
    axis = int(len(features) <= features.shape[1])
    gram = _gram(features, scaler, axis)
    gram[np.diag_indices_from(gram)] += alpha
    if not axis:
        targets = reduce(np.add, (block.T @ targets[some] for some, block in _blocks(features, scaler, axis)))
    found = cho_solve(cho_factor(gram, overwrite_a=True, check_finite=False), targets)
    return np.concatenate([block.T @ found for _, block in _blocks(features, scaler, axis)]) if axis else found


def dilations(n_steps: int, features: int) -> list[tuple[int, int]]:
    """The dilations, and how many features each has per kernel: exponentially spaced, the longest kernel fits.

    >>> dilations(100, 840)
    [(1, 3), (2, 1), (3, 1), (4, 1), (5, 1), (7, 1), (9, 1), (12, 1)]
    """
    per_kernel = features // len(TRIPLES)
    most = min(per_kernel, MOST_DILATIONS)
    spaced = np.logspace(0, np.log2((n_steps - 1) / (KERNEL - 1)), most, base=2).astype(np.int32)
    values, counts = np.unique(spaced, return_counts=True)
    counts = (counts * (per_kernel / most)).astype(np.int32)
    for index in range(per_kernel - int(counts.sum())):
        counts[index % len(counts)] += 1
    return list(zip(values.tolist(), counts.tolist(), strict=True))


def _quantiles(n: int) -> np.ndarray:
    """A low-discrepancy sequence of shares."""
    return np.arange(1, n + 1) * GOLDEN % 1


def _channels(n_channels: int, rng: np.random.RandomState) -> np.ndarray:
    """A random choice of channels, small numbers being more likely."""
    most = min(n_channels, MOST_CHANNELS)
    n_chosen = int(2 ** rng.uniform(0, np.log2(most + 1)))
    return np.sort(rng.choice(n_channels, n_chosen, replace=False))


def _shifted(signals: torch.Tensor, dilation: int) -> dict[int, torch.Tensor]:
    """The sequences as each of the nine weights sees them, `(channel, trial, time)`; -1: their sum."""
    by_channel = signals.permute(2, 0, 1)
    n_steps = by_channel.shape[2]
    edge = (KERNEL - 1) * dilation // 2
    padded = torch.nn.functional.pad(by_channel, (edge, edge))
    shifted = {tap: padded[:, :, tap * dilation :][:, :, :n_steps] for tap in range(KERNEL)}
    return shifted | {-1: torch.stack([shifted[tap] for tap in range(KERNEL)]).sum(dim=0)}


def _convolve(shifted: dict[int, torch.Tensor], kernel: int, channels: np.ndarray) -> torch.Tensor:
    """The convolution with one kernel, summed over channels, `(trial, time)`.

    Weights of 2 and -1 are 3 more than -1, and -1: the sum of all nine is shared by the 84 kernels.
    """
    one, two, three = (shifted[tap] for tap in TRIPLES[kernel])
    summed = None
    for c in channels.tolist():
        part = (one[c] + two[c]).add_(three[c]).mul_(3).sub_(shifted[-1][c])
        summed = part if summed is None else summed.add_(part)
    assert summed is not None
    return summed


@dataclass(frozen=True)
class FixedConvolutions(Layer):
    """MiniRocket's features: nine-tap convolutions with weights of -1 and 2, and comparisons with biases.

    channels: of the sequence. dilations: how many different ones. convolved: channels, added up over all convolutions.
    biases: number of features. At each step the sum of nine taps is made once per dilation and channel (eight
    additions); a convolution then adds three taps, multiplies by 3 and subtracts that sum for each of its channels; a
    feature is a comparison and a count per step, and a product at the end.

    >>> FixedConvolutions(samples=100, channels=1, dilations=1, convolved=84, biases=84).cost().acs
    42800
    """

    samples: int
    channels: int
    dilations: int
    convolved: int
    biases: int

    def cost(self) -> Cost:
        n = self.samples
        additions = 8 * self.dilations * self.channels + 4 * self.convolved
        sums = n * self.dilations * self.channels  # nine taps are read for each, three for each convolution
        taps = n * self.channels + 10 * sums + 4 * n * self.convolved
        return with_weights(
            self.biases, n * self.channels, acs=n * (additions + self.biases),
            multiplications=n * self.convolved + self.biases, comparisons=n * self.biases,
            weights_accesses=self.biases, states_accesses=taps, **passed(0, self.biases),
        )  # fmt: skip


def _minirocket_layers(fitted: _OnMiniRocket, x: np.ndarray) -> tuple[Layer, ...]:
    _, n_steps, n_channels = x.shape
    convolutions = fitted.transform_.convolutions_
    made = FixedConvolutions(
        n_steps,
        n_channels,
        dilations=len({one.dilation for one in convolutions}),
        convolved=sum(len(one.channels) for one in convolutions),
        biases=sum(len(one.biases) for one in convolutions),
    )
    n_told = len(np.atleast_2d(fitted.ridge_[-1].coef_))  # of two classes one
    return made, Standardise(fitted.features), Dense(fitted.features, n_told)


def _rounded(fitted: _OnMiniRocket, x: np.ndarray, bits: int) -> _OnMiniRocket:
    narrow, convolutions = copy.copy(fitted), fitted.transform_.convolutions_
    every = np.concatenate([one.biases for one in convolutions])
    narrow.transform_ = copy.copy(fitted.transform_)
    narrow.transform_.convolutions_ = [
        one._replace(biases=rounded(one.biases, 2 * bits, of=every)) for one in convolutions
    ]
    narrow.ridge_ = rounding.last_step(fitted.ridge_, x, bits)
    return narrow


MINIROCKET = Opponent(
    "MiniRocket of the published size.",
    MiniRocketClassifier,
    lambda sides, seed: [{"features": FEATURES}],
    "signals",
    _minirocket_layers,
    lambda fitted: f"{fitted.features} features",
    _rounded,
    least_steps=KERNEL,
)
"""One candidate: it costs seconds to fit, and a smaller one loses up to 2 points."""
OF_NUMBERS = replace(MINIROCKET, build=MiniRocketRegressor, tells="numbers")
