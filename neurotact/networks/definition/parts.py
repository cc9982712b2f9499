"""The door of networks: what a part of the group `neurotact.networks` holds, and what its module is given and gives.

A network is any `torch.nn.Module` from spikes `(batch, time, afferent)` to scores in each step `(batch, time, class)`.
The scores of all steps so far are added up, and the class with the largest sum leads (`docs/plugins.md`).
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from neurotact.backend import Backend
from neurotact.spec import Spec

PROJECTIONS = ("input", "recurrent", "between", "readout")
"""Where synaptic operations take place: from the input into hidden neurons, among those of a layer, from one hidden
layer into the next, and into the readout."""


class Sizes(NamedTuple):
    """What a module is made for.

    sampling_rate_Hz: steps of the input's clock per second. clock_Hz: steps per second of the spikes that the module is
    called with, which are in bins where the network has a slower clock.
    generator: of initial weights; None: the global one.
    """

    n_inputs: int
    n_classes: int
    sampling_rate_Hz: float
    clock_Hz: float
    backend: Backend = "auto"
    generator: torch.Generator | None = None
    dtype: torch.dtype = torch.float32


class Counted(NamedTuple):
    """Scores `(batch, time, class)`, and what a module counts beside them, which it need not.

    hidden: spikes of hidden neurons, `(batch, time, neuron)`, as far as penalties weigh them, differentiable.
    sops: synaptic operations in each step by projection (`PROJECTIONS`), `(batch, time)` each; one that is left out has
    none. None: they are not counted.
    """

    scores: Tensor
    hidden: Tensor | None = None
    sops: Mapping[str, Tensor] | None = None


class NetworkPart(NamedTuple):
    """A network that `model` of a spec names.

    about: what it is, in a line. keys: its own keys. module: makes the `torch.nn.Module` from the keys and the sizes,
    such as the class of the module itself.
    """

    about: str
    keys: type[Spec]
    module: Callable[[Any, Sizes], nn.Module]
