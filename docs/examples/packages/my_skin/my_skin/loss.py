"""A loss: a scalar from scores (trial, class) and class indices (trial,)."""

from torch.nn.functional import one_hot


def squares(scores, labels, weights=None):
    """The squared error of the probabilities, its mean over trials; weights (trial,) have the mean 1."""
    each = (scores.softmax(dim=1) - one_hot(labels, scores.shape[1])).square().sum(dim=1)
    return (each if weights is None else each * weights).mean()
