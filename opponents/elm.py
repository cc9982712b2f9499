"""Extreme learning machines: a random hidden layer, and an output layer found by regularised least squares."""

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from neurotact_parts.opponents import rounding
from neurotact_parts.opponents.ridge_path import decompose
from neurotact_parts.opponents.targets import MachinesMixin, encode, signed
from numpy.typing import ArrayLike
from scipy.special import expit
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils import check_random_state

from neurotact.baselines.opponent import Opponent, Settings, Sides
from neurotact.checks import at_least, one_of
from neurotact.estimators import further_examples, training_examples
from neurotact.metrics.flops import Dense, Layer

Activation = Literal["sigmoid", "relu", "hard_limit"]

ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "sigmoid": expit,
    "relu": lambda drive: np.maximum(drive, 0.0),
    "hard_limit": lambda drive: (drive >= 0).astype(float),
}

ELM_HIDDEN, ELM_ALPHAS = (25, 50, 100, 200), tuple(10.0**k for k in range(2, -7, -1))
LEAST_POWER = -8
"""Exponent of the smallest weight of a hard-limit network: a longer shift makes an 8-bit input zero."""


class ELMClassifier(MachinesMixin, ClassifierMixin, BaseEstimator):
    """Extreme learning machine: one output per class (one for two classes), targets ±1, the largest output decides.

    Stiffness paper, Eq. 1 (S-ELM, R-ELM, H-ELM); materials paper, Eqs. 4 and 5 (RELM, `output_bias=True`).
    Hidden weights and biases are uniform in (-1, 1); with `hard_limit` the weights become the nearest powers of two.
    Inputs are not scaled: standardise them in a pipeline.

    Parameters
    ----------
    hidden : neurons of the hidden layer.
    activation : "sigmoid", "relu" or "hard_limit" (1 from zero on, else 0).
    alpha : L2 penalty of the output weights (lambda in the papers); 0 gives the solution of least norm.
    output_bias : whether the outputs have a bias (not penalised).
    random_state : seed or RandomState of the hidden layer.

    Attributes
    ----------
    classes_ `(class,)`; hidden_weights_ `(feature, hidden)`; hidden_biases_ `(hidden,)`;
    coef_ `(hidden, machine)`; intercept_ `(machine,)`, zero without an output bias.

    Raises InputError for a single class and for parameters out of range.

    >>> X = np.array([[0.0], [0.2], [0.8], [1.0]])
    >>> elm = ELMClassifier(hidden=20, random_state=0).fit(X, ["soft", "soft", "hard", "hard"])
    >>> elm.predict([[0.1], [0.9]]).tolist()
    ['soft', 'hard']
    """

    def __init__(
        self,
        hidden: int = 100,
        activation: Activation = "sigmoid",
        alpha: float = 1e-3,
        output_bias: bool = False,
        random_state: int | np.random.RandomState | None = None,
    ):
        self.hidden = hidden
        self.activation = activation
        self.alpha = alpha
        self.output_bias = output_bias
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike) -> "ELMClassifier":
        """Draw the hidden layer and solve the output layer. X `(example, feature)`, y `(example,)`."""
        at_least("hidden", self.hidden, 1, whole=True)
        at_least("alpha", self.alpha, 0)
        one_of("activation", self.activation, tuple(ACTIVATIONS))
        X, y = training_examples(self, X, y)
        self.classes_, indices = encode(y)
        rng = check_random_state(self.random_state)
        weights = rng.uniform(-1, 1, (X.shape[1], self.hidden))
        self.hidden_weights_ = powers_of_two(weights) if self.activation == "hard_limit" else weights
        self.hidden_biases_ = rng.uniform(-1, 1, self.hidden)
        targets = signed(indices, len(self.classes_))
        self._path = decompose(self._hidden(X), targets, intercept=self.output_bias)
        self.coef_, self.intercept_ = self._path.solution(self.alpha)
        return self

    def _outputs(self, X: ArrayLike) -> np.ndarray:
        return self._hidden(further_examples(self, X)) @ self.coef_ + self.intercept_

    def decision_path(self, alphas: ArrayLike, X: ArrayLike) -> np.ndarray:
        """Outputs of this network with each alpha, `(alpha, example, machine)`."""
        return self._path.outputs(self._hidden(further_examples(self, X)), alphas)

    def _hidden(self, X: np.ndarray) -> np.ndarray:
        return ACTIVATIONS[self.activation](X @ self.hidden_weights_ + self.hidden_biases_)


def powers_of_two(weights: np.ndarray) -> np.ndarray:
    """Weights of the same sign, with the nearest power of two in ratio as magnitude, at least `2**LEAST_POWER`.

    A product is then a shift, which takes one cycle on small processors (stiffness paper, H-ELM).

    >>> powers_of_two(np.array([0.9, -0.3, 0.6, 1e-9])).tolist()
    [1.0, -0.25, 0.5, 0.00390625]
    """
    sizes = np.maximum(np.abs(weights), 2.0**LEAST_POWER)
    return np.copysign(np.exp2(np.rint(np.log2(sizes))), weights)


def _elm_grid(sides: Sides, seed: int) -> Iterator[Settings]:
    """Of each size the penalty of the best validation accuracy (ties: the strongest), by one decomposition for all."""
    for hidden in ELM_HIDDEN:
        network = ELMClassifier(hidden, alpha=ELM_ALPHAS[0], random_state=seed).fit(sides.train, sides.y_train)
        path = network.accuracy_path(ELM_ALPHAS, sides.validation, sides.y_validation)
        yield {"hidden": hidden, "alpha": ELM_ALPHAS[int(path.argmax())]}


def _elm_layers(fitted: ELMClassifier, x: np.ndarray) -> tuple[Layer, ...]:
    return Dense(x.shape[1], fitted.hidden, "sigmoid"), Dense(*fitted.coef_.shape, bias=False)


ELM = Opponent(
    "Extreme learning machines with sigmoids.",
    ELMClassifier,
    _elm_grid,
    layers=_elm_layers,
    words=lambda fitted: f"N {fitted.hidden}, alpha {fitted.alpha:g}",
    rounded=rounding.weights,
)
