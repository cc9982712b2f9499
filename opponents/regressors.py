"""The opponents that tell numbers, which networks with a target are compared with."""

import numpy as np
from neurotact_parts.opponents.scikit_learn import extra_trees
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.linear_model import Ridge

from neurotact.baselines.opponent import Opponent
from neurotact.metrics.flops import Dense

PENALTIES = (1.0, 100.0, 0.01, 0.1, 10.0, 1000.0)
"""The usual one first: it stands if none is better."""


RIDGE = Opponent(
    "Ridge regression with one of several penalties; all cost the same.",
    Ridge,
    [{"alpha": alpha} for alpha in PENALTIES],
    layers=lambda fitted, x: (Dense(x.shape[1], len(np.atleast_2d(fitted.coef_))),),
    joins="linear",
    tells="numbers",
)
EXTRA_TREES = extra_trees(
    "Forests of extremely randomised regression trees (Geurts et al. 2006).",
    ExtraTreesRegressor,
    lambda fitted: fitted.n_outputs_,
    tells="numbers",
)
