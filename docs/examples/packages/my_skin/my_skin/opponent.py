"""An opponent: a classifier that networks are compared with."""

from sklearn.neighbors import KNeighborsClassifier

from neurotact.baselines import Opponent
from neurotact.metrics.flops import NearestPoints


def layers(fitted, x):
    """What a decision is computed by, for its cost; x: the training input (window, feature)."""
    return (NearestPoints(len(x), x.shape[1], fitted.n_neighbors),)


GRID = [{"n_neighbors": k} for k in (1, 3, 5)]
OPPONENT = Opponent("The nearest training windows.", KNeighborsClassifier, GRID, layers=layers)
