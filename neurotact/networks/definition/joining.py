"""Several networks as one: their hidden layers side by side, and the mean of their class scores."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN

SHARED = ("alpha", "beta", "threshold")


def joined(networks: Sequence[RSNN]) -> RSNN:
    """One network whose hidden neurons are those of all `networks`, and whose class scores are the means of theirs.

    Input weights stand side by side, recurrent ones in blocks (`recurrent_blocks`), and the weights and the bias of the
    readout are divided by the number of networks n: the sum of all scores over n is b + W s with these weights, for any
    readout that is linear in the hidden spikes. A deep ensemble (Lakshminarayanan et al. 2017, arXiv 1612.01474), which
    averages scores and not probabilities, is thus an ordinary network, whose hidden spikes are those of its members.

    networks: of one spec, on one clock and one device, with an integrator as readout and without learned dynamics.
    Raises InputError otherwise, and for a hidden layer that is too large. Returns the network itself if it is one.

    >>> keys = {"hidden": 4, "readout": "integrator", "sampling_rate_Hz": 1000.0}
    >>> whole = joined([RSNN(3, 2, **keys), RSNN(3, 2, **keys)])
    >>> whole.spec.hidden, whole.spec.recurrent_blocks, tuple(whole.w_in.shape), tuple(whole.bias.shape)
    (8, 2, (3, 8), (2,))
    """
    first, n = networks[0], len(networks)
    if n == 1:
        return first
    _check(networks)
    spec = first.spec
    blocks: dict[str, Any] = {"recurrent_blocks": n * spec.recurrent_blocks} if spec.recurrent else {}
    whole = RSNN(
        first.n_inputs, first.n_classes, spec, first.sampling_rate_Hz, backend=first.backend,
        generator=torch.Generator(),  # the weights are replaced: do not advance the global generator
        dtype=first.w_in.dtype, hidden=n * spec.hidden, **blocks,
    ).to(first.w_in.device)  # fmt: skip
    whole.spike = first.spike
    parts = {name: [network.state_dict()[name] for network in networks] for name in first.state_dict()}
    whole.load_state_dict({name: _whole(name, tensors) for name, tensors in parts.items()})
    return whole


def _whole(name: str, parts: Sequence[Tensor]) -> Tensor:
    """A parameter of the joined network."""
    if name in SHARED:
        return parts[0]
    if name == "w_in":
        return torch.cat([*parts], dim=1)
    if name == "w_rec":
        return torch.block_diag(*parts)
    if name == "bias":
        return torch.stack([*parts]).mean(dim=0)
    return torch.cat([*parts], dim=-2) / len(parts)  # of the readout: (..., hidden, class)


def _check(networks: Sequence[RSNN]) -> None:
    first = networks[0]
    sizes = first.n_inputs, first.n_classes, first.sampling_rate_Hz
    if any((network.n_inputs, network.n_classes, network.sampling_rate_Hz) != sizes for network in networks):
        raise InputError("networks: differ in their afferents, classes or clock; join networks of the same spikes")
    if any(network.spec != first.spec for network in networks):
        raise InputError("networks: have different specs; join networks of one spec")
    if first.spec.readout != "integrator" or first.spec.learn:
        raise InputError("networks: join only with readout = 'integrator' and without learn; train such ones")
