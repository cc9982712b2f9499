"""Optimisers by the names of their classes in `torch.optim`: which ones train a network, their options and state."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from neurotact.errors import InputError, nearest

if TYPE_CHECKING:
    import torch
    from torch import Tensor

UNSUITED = {
    "LBFGS": "it computes the loss several times a step, where a training computes it once",
    "SparseAdam": "it needs sparse gradients, and those of a network are dense",
}
"""Optimisers of torch that cannot train a network here, and why."""
OPTIONS = {"lr", "betas", "weight_decay"}
"""What a training sets, of optimisers that have it."""
USUAL = {**dict.fromkeys(("Adam", "AdamW", "Adamax"), OPTIONS), "SGD": {"lr", "weight_decay"}}
"""Optimisers that every torch has, and which of `OPTIONS` each takes: both are known without loading it."""
SWITCHED = ("add_param_group", "load_state_dict", "state_dict", "step", "zero_grad")
"""Methods that torch wraps in switches of its compiler."""


@cache
def names() -> tuple[str, ...]:
    """The optimisers that train a network.

    >>> {"Adam", "AdamW", "SGD"} <= {*names()}, "LBFGS" in names()
    (True, False)
    """
    import torch

    found = {name: cls for name, cls in vars(torch.optim).items() if isinstance(cls, type)}
    base = torch.optim.Optimizer
    own = (name for name, cls in found.items() if issubclass(cls, base) and cls is not base)
    return tuple(sorted(name for name in own if name not in UNSUITED))


def named(name: str) -> str:
    """The name as torch writes it, of one in any case; ValueError for one that cannot train a network.

    >>> named("adamw")
    'AdamW'
    >>> named("Adamm")
    Traceback (most recent call last):
    ValueError: there is no optimiser 'Adamm'; did you mean 'Adam'?
    """
    if name in USUAL:
        return name
    known = {own.lower(): own for own in (*names(), *UNSUITED)}
    own = known.get(name.lower())
    if own is None:
        raise ValueError(f"there is no optimiser '{name}'; {nearest(name, names())}")
    if own in UNSUITED:
        raise ValueError(f"{own} cannot train a network: {UNSUITED[own]}; take another, such as AdamW")
    return own


def takes(name: str, option: str) -> bool:
    """Whether an optimiser has an option.

    >>> takes("AdamW", "betas"), takes("SGD", "betas"), takes("Rprop", "weight_decay")
    (True, False, False)
    """
    if name in USUAL and option in OPTIONS:
        return option in USUAL[name]
    from torch import optim

    return option in inspect.signature(getattr(optim, name)).parameters


@cache
def kind_of(name: str) -> Any:
    """The class of an optimiser of torch, without the switches of its compiler: their import takes a second.

    Its steps are the same to the last bit.

    >>> kind_of("Adam").__mro__[1]
    <class 'torch.optim.adam.Adam'>
    """
    from torch import no_grad, optim

    whole = getattr(optim, name)
    bare = {each: inspect.unwrap(getattr(whole, each)) for each in SWITCHED}
    return type(name, (whole,), {**bare, "step": no_grad()(bare["step"])})


def make(name: str, groups: Sequence[Mapping[str, Any]], **options: Any) -> torch.optim.Optimizer:
    """An optimiser of groups of parameters; it gets those options that it has. InputError if it refuses them."""
    known = {key: value for key, value in options.items() if takes(name, key)}
    fused = {"fused": True} if name == "Adam" else {}
    try:
        return kind_of(name)([*map(dict, groups)], **known, **fused)
    except ValueError as error:  # such as Muon, of a bias
        raise InputError(f"training.optimiser: {name} does not train this network ({error}); take another") from error


def state_of(optimiser: torch.optim.Optimizer, parameter: Tensor) -> dict[str, Tensor]:
    """What an optimiser has stored of a parameter after a step; an empty table if it stores nothing.

    Some versions of torch store None for the momentum of an SGD without one.
    """
    return {key: value for key, value in optimiser.state[parameter].items() if value is not None}


@cache
def state_shapes(name: str, shape: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    """The shapes of what an optimiser stores of a parameter of a shape, as a step of its own shows them.

    >>> state_shapes("Adamax", (2, 3))
    {'step': (), 'exp_avg': (2, 3), 'exp_inf': (2, 3)}
    """
    import torch

    parameter = torch.zeros(shape, requires_grad=True)
    parameter.grad = torch.zeros(shape)
    optimiser = make(name, [{"params": [parameter]}])
    optimiser.step()
    return {key: tuple(value.shape) for key, value in state_of(optimiser, parameter).items()}
