"""The opponents that tell numbers, which networks with a target are compared with."""

import numpy as np
from neurotact_parts.opponents.scikit_learn import LEAVES, TREES, Trees, mean_depth
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.linear_model import Ridge

from neurotact.baselines.opponent import Opponent
from neurotact.metrics.flops import Dense, Layer

PENALTIES = (1.0, 100.0, 0.01, 0.1, 10.0, 1000.0)
"""The usual one first: it stands if none is better."""


def _trees_layers(fitted: ExtraTreesRegressor, x: np.ndarray) -> tuple[Layer, ...]:
    n_nodes = sum(tree.tree_.node_count for tree in fitted.estimators_)
    return (Trees(len(fitted.estimators_), mean_depth(fitted, x), n_nodes, fitted.n_outputs_),)


RIDGE = Opponent(
    "Ridge regression with one of several penalties; all cost the same.",
    Ridge,
    [{"alpha": alpha} for alpha in PENALTIES],
    layers=lambda fitted, x: (Dense(x.shape[1], len(np.atleast_2d(fitted.coef_))),),
    joins="linear",
    tells="numbers",
)
EXTRA_TREES = Opponent(
    "Forests of extremely randomised regression trees (Geurts et al. 2006).",
    ExtraTreesRegressor,
    lambda sides, seed: [{"n_estimators": TREES, "min_samples_leaf": leaf} for leaf in LEAVES],
    layers=_trees_layers,
    words=lambda fitted: f"{fitted.n_estimators} trees, leaves of {fitted.min_samples_leaf}",
    tells="numbers",
)
