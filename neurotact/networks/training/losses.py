"""What training minimises: a loss of scores `(trial, class)` and class indices `(trial,)`, found by its name.

Of numbers, a loss of values and standardised numbers, `(trial, target)` each.

Another package adds one by an entry point of the group `neurotact.losses`: a function `loss(scores, labels)` that gives
a scalar, the mean over trials. Where trials have weights, with the mean 1, it is given them as a third argument.
"""

import inspect
from collections.abc import Callable

from torch import Tensor
from torch.nn import functional

from neurotact import plugins
from neurotact.errors import InputError


def of_scores(name: str, scores: Tensor, labels: Tensor, weights: Tensor | None = None) -> Tensor:
    """The loss of this name, a scalar.

    weights: of each trial, `(trial,)`. Raises InputError for a loss that takes no weights where there are some, and
    for one that gives no scalar.

    >>> import torch
    >>> scores, labels = torch.tensor([[0.0, 3.0], [0.0, 0.5]]), torch.tensor([1, 1])
    >>> of_scores("hinge", scores, labels), of_scores("hinge", scores, labels, torch.tensor([2.0, 0.0]))
    (tensor(0.1250), tensor(0.))
    """
    loss = plugins.load_function("losses", name)
    if weights is None:
        found = loss(scores, labels)
    elif len(inspect.signature(loss).parameters) < 3:
        raise InputError(f"training.loss: '{name}' takes no weights of trials; take another, or weight none")
    else:
        found = loss(scores, labels, weights)
    if not isinstance(found, Tensor) or found.ndim:
        raise plugins.unfit("losses", name, "does not give a scalar tensor")
    return found


def cross_entropy(scores: Tensor, labels: Tensor, weights: Tensor | None = None) -> Tensor:
    """Cross-entropy of the softmax of the scores."""
    if weights is None:
        return functional.cross_entropy(scores, labels)
    return (functional.cross_entropy(scores, labels, reduction="none") * weights).mean()


def hinge(scores: Tensor, labels: Tensor, weights: Tensor | None = None) -> Tensor:
    """How far wrong classes come within a margin of 1 of the right one, summed and over the number of classes.

    Weston and Watkins 1999; `multi_margin_loss` of torch.
    """
    each = functional.multi_margin_loss(scores, labels, reduction="none")
    return each.mean() if weights is None else (each * weights).mean()


def squared_error(values: Tensor, numbers: Tensor, weights: Tensor | None = None) -> Tensor:
    """The squared error of numbers, the mean over targets."""
    return _of_numbers(values, numbers, weights, functional.mse_loss)


def absolute_error(values: Tensor, numbers: Tensor, weights: Tensor | None = None) -> Tensor:
    """The absolute error of numbers, the mean over targets: single large ones weigh less than in the squared one."""
    return _of_numbers(values, numbers, weights, functional.l1_loss)


def _of_numbers(values: Tensor, numbers: Tensor, weights: Tensor | None, error: Callable[..., Tensor]) -> Tensor:
    each = error(values, numbers.to(values), reduction="none").mean(dim=1)
    return each.mean() if weights is None else (each * weights).mean()
