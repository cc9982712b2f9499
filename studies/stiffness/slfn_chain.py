"""The single-layer networks of the stiffness paper on features: model selection, accuracy and the unit's cost."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np
from neurotact_parts.opponents import elm
from neurotact_parts.studies.published_flops import SLFN
from neurotact_parts.studies.stiffness import slfn
from pydantic import Field, model_validator
from sklearn.preprocessing import StandardScaler

from neurotact.data.splits import Split
from neurotact.metrics.flops import (
    ACTIVATIONS,
    BYTES,
    Cost,
    Dense,
    Layer,
    Moments,
    MovingAverage,
    Standardise,
    cost,
    passed,
)
from neurotact.spec import Spec

CLASSIFIERS: tuple[SLFN, ...] = get_args(SLFN)
ELM_ACTIVATION: dict[str, elm.Activation] = {"S-ELM": "sigmoid", "R-ELM": "relu", "H-ELM": "hard_limit"}
FC_ACTIVATION: dict[str, slfn.Activation] = {"S-FC": "sigmoid", "R-FC": "relu"}


class SLFNSpec(Spec):
    """Candidates and training of the five networks (stiffness paper, Sec. IV-C)."""

    neurons: tuple[int, ...] = Field(default=(25, 50, 100, 200, 300), min_length=1)
    """N: candidate numbers of hidden neurons."""
    n_max: tuple[int, ...] = Field(default=(50, 100, 200, 300), min_length=1)
    """Largest N allowed in a choice; each gives its own rows."""
    exponents: tuple[int, ...] = Field(default=tuple(range(-8, 9)), min_length=1)
    """lambda = 10^i, the L2 penalty of the ELMs; the FC networks are regularised only by early stopping."""
    draws: int = Field(default=10, ge=1)
    """Draws of the hidden weights for each split; initialisations, for the FC networks."""
    epochs: int = Field(default=200, ge=1)
    patience: int = Field(default=20, ge=1)
    batch: int = Field(default=64, ge=1)
    learning_rate: float = Field(default=0.01, gt=0)
    """Learning rate of the FC networks; Adam is our choice, since the paper names no optimiser."""

    @model_validator(mode="after")
    def _some_candidate_is_allowed(self) -> "SLFNSpec":
        if min(self.n_max) < min(self.neurons):
            raise ValueError(f"n_max: {min(self.n_max)} allows none of the neurons {self.neurons}; raise it")
        return self


class Candidate(NamedTuple):
    """A fitted network: its settings and its accuracies."""

    split: int
    draw: int
    neurons: int
    accuracy_validation: float
    accuracy_test: float


class Choice(NamedTuple):
    """The best of a split's candidates with at most `n_max` neurons, chosen on validation: means over draws."""

    split: int
    n_max: int
    neurons: float
    accuracy_validation: float
    accuracy_test: float
    accuracy_test_sd: float


def choices(
    classifier: SLFN,
    features: np.ndarray,
    labels: np.ndarray,
    splits: Sequence[Split],
    spec: SLFNSpec,
    seed: int,
    *,
    standardise_on: Literal["training", "all"] = "training",
) -> list[Choice]:
    """Fit every candidate on every split and choose on its validation examples; one row per split and `n_max`.

    features: `(example, feature)`, not standardised; labels: `(example,)`.
    standardise_on: `all` includes mean and deviation of the test examples, as in papers that normalise the data set
        before the split.
    Ties go to fewer neurons, then to the larger penalty.
    """
    candidates = list(_candidates(classifier, features, labels, splits, spec, seed, standardise_on))
    rows = []
    for split in range(len(splits)):
        for n_max in spec.n_max:
            chosen = [
                _best(c for c in candidates if (c.split, c.draw) == (split, draw) and c.neurons <= n_max)
                for draw in range(spec.draws)
            ]
            neurons, validation, tests = (
                np.array([getattr(c, name) for c in chosen])
                for name in ("neurons", "accuracy_validation", "accuracy_test")
            )
            rows.append(Choice(split, n_max, neurons.mean(), validation.mean(), tests.mean(), tests.std()))
    return rows


def unit_cost(
    classifier: SLFN, *, samples: int, channels: int, order: int, neurons: int, n_classes: int, signal_ms: float
) -> Cost:
    """The whole processing unit in the ledger: moving average, moments, standardisation and network.

    samples: of a peak; order: moments per channel.

    >>> round(unit_cost("R-FC", samples=150, channels=4, order=2, neurons=51, n_classes=3, signal_ms=75).flops)
    5413
    """
    nf = channels * order
    if classifier == "H-ELM":
        network: tuple[Layer, ...] = (PowerOfTwoDense(nf, neurons), BinaryInputDense(neurons, n_classes, bias=False))
    elif classifier in ELM_ACTIVATION:
        network = (Dense(nf, neurons, ELM_ACTIVATION[classifier]), Dense(neurons, n_classes, bias=False))
    else:
        network = (Dense(nf, neurons, FC_ACTIVATION[classifier]), Dense(neurons, n_classes))
    before = (MovingAverage(samples, channels), Moments(samples, channels, order), Standardise(nf))
    return cost(*before, *network, signal_ms=signal_ms)


def _best(candidates: Iterable[Candidate]) -> Candidate:
    return max(candidates, key=lambda c: (c.accuracy_validation, -c.neurons))


def _candidates(
    classifier: SLFN,
    features: np.ndarray,
    labels: np.ndarray,
    splits: Sequence[Split],
    spec: SLFNSpec,
    seed: int,
    standardise_on: str,
) -> Iterator[Candidate]:
    parts: list[Parts] = []
    for split in splits:
        scaler = StandardScaler().fit(features if standardise_on == "all" else features[split.train])
        scaled = scaler.transform(features)
        train, validation, test = ((scaled[side], labels[side]) for side in split)
        parts.append((train, validation, test))
    fit = _elm_accuracies if classifier in ELM_ACTIVATION else _fc_accuracies
    for neurons in spec.neurons:
        for (split, draw), (validation, test) in fit(classifier, parts, spec, seed, neurons).items():
            yield Candidate(split, draw, neurons, validation, test)


Part = tuple[np.ndarray, np.ndarray]
Parts = tuple[Part, Part, Part]
"""Standardised features and labels of the training, validation and test side of a split."""
Accuracies = dict[tuple[int, int], tuple[float, float]]
"""Validation and test accuracy by split and draw."""


def _elm_accuracies(classifier: str, parts: Sequence[Parts], spec: SLFNSpec, seed: int, neurons: int) -> Accuracies:
    """The candidates of extreme learning machines, each with the best penalty on validation."""
    alphas = [10.0**i for i in sorted(spec.exponents, reverse=True)]  # ties: the larger penalty
    accuracies = {}
    for part, (train, validation, test) in enumerate(parts):
        for draw in range(spec.draws):
            network = elm.ELMClassifier(
                neurons, activation=ELM_ACTIVATION[classifier], random_state=_draw_seed(seed, part, draw)
            ).fit(*train)
            on_validation = network.accuracy_path(alphas, *validation)
            best = int(on_validation.argmax())
            on_test = network.accuracy_path([alphas[best]], *test)
            accuracies[part, draw] = float(on_validation[best]), float(on_test[0])
    return accuracies


def _fc_accuracies(classifier: str, parts: Sequence[Parts], spec: SLFNSpec, seed: int, neurons: int) -> Accuracies:
    """The candidates of networks trained by back-propagation, all draws and splits in one computation."""
    prototype = slfn.SLFNClassifier(
        neurons,
        activation=FC_ACTIVATION[classifier],
        epochs=spec.epochs,
        patience=spec.patience,
        batch=spec.batch,
        learning_rate=spec.learning_rate,
    )
    keys = [(part, draw) for part in range(len(parts)) for draw in range(spec.draws)]
    networks = slfn.fit_many(prototype, [parts[part][:2] for part, _ in keys], [_draw_seed(seed, *key) for key in keys])
    return {
        (part, draw): (float(network.validation_accuracy_), float(network.score(*parts[part][2])))
        for (part, draw), network in zip(keys, networks, strict=True)
    }


def _draw_seed(seed: int, split: int, draw: int) -> int:
    return int(np.random.SeedSequence([seed, split, draw]).generate_state(1)[0])


@dataclass(frozen=True)
class PowerOfTwoDense(Layer):
    """The hidden layer of an H-ELM, whose weights are powers of two: a shift and an addition for each.

    A weight takes one byte (sign and exponent), a bias four.
    """

    inputs: int
    units: int

    def cost(self) -> Cost:
        weights, biases = self.inputs * self.units, self.units
        shifts, stored = weights, weights + BYTES * biases
        moved = {"weights_accesses": weights + biases, **passed(self.inputs, self.units)}
        sums = Cost(acs=weights, comparisons=shifts, parameters=weights + biases, bytes=stored, **moved)
        return sums + ACTIVATIONS["hard_limit"].times(self.units)


@dataclass(frozen=True)
class BinaryInputDense(Dense):
    """A fully connected layer that is fed zeros and ones: additions alone (the output of an H-ELM)."""

    def cost(self) -> Cost:
        dense = super().cost()
        return replace(dense, macs=0, acs=dense.macs)
