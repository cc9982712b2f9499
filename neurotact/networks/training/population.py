"""Many small networks trained at once, on any torch device: each by its own `training.course`.

Networks of one shape run as one, with a leading axis (`reference.Model`). Hidden layers are rounded up to a power of
two: a neuron that is added has weights of 0 and never spikes. Each network has its own loss, optimiser, order of
windows and end. Its numbers are those that it has alone, except for rounding: sums are formed in another order.
"""

from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.nn import functional

from neurotact.errors import InputError
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.definition.reference import Layer, Model, counts
from neurotact.networks.definition.rsnn import RSNN, Counts
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.networks.training.training import Batch, Course
from neurotact.neurons import Adaptation

T = TypeVar("T")
BYTES = 64
"""Most that a step of a neuron of a window takes in float32 for the gradient; 25 to 34 were measured on the CPU."""
CPU_BYTES = 2**30
"""Most memory of a batch of networks on the CPU; on a GPU it is half of what is free."""


def device_of(name: str, dtype: torch.dtype = torch.float64) -> torch.device:
    """The torch device of this name; InputError if torch cannot use it with this type. Integrators need float64."""
    try:
        torch.zeros(1, dtype=dtype, device=name).item()
        return torch.device(name)
    except (RuntimeError, AssertionError, TypeError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"`device={name!r}`: torch cannot use it here ({why}); try cpu") from error


def kind_of(name: str) -> str:
    """What a search and a study record of their device: networks on `cuda` and `cuda:1` have the same numbers."""
    return name if name.startswith("cpu") else name.partition(":")[0]


def run(courses: Sequence[Course[T]]) -> list[T]:
    """Run all courses to their ends, together; their results. An error of one course is raised.

    Their networks are on one device.
    """
    ended: dict[int, T] = {}
    waiting: dict[int, Batch] = {}

    def go_on(course: int, answer: Counts | None) -> None:
        try:
            request = courses[course].send(answer)
        except StopIteration as end:
            ended[course] = end.value
        else:
            assert isinstance(request, Batch)
            waiting[course] = request

    for course in range(len(courses)):
        go_on(course, None)
    while waiting:
        for places in _together(waiting):
            batches = [waiting.pop(course) for course in places]
            answers: Sequence[Counts | None] = counts_of(batches)
            if batches[0].learns:
                losses = [courses[course].send(loss) for course, loss in zip(places, answers, strict=True)]
                torch.autograd.backward(losses)  # pyright: ignore[reportArgumentType]
                answers = [None] * len(places)
            for course, answer in zip(places, answers, strict=True):
                go_on(course, answer)
    return [ended[course] for course in range(len(courses))]


def _together(waiting: dict[int, Batch]) -> list[list[int]]:
    """The places of batches that run as one: of one shape, and as many as fit in memory."""
    alike: dict[Hashable, list[int]] = {}
    for course, batch in waiting.items():
        alike.setdefault(_shape(batch), []).append(course)
    parts = []
    for places in alike.values():
        first = waiting[places[0]]
        n_trials = max(len(waiting[course].spikes) for course in places)
        n_neurons = _width(first.network) + first.network.n_inputs + first.network.n_classes
        size = BYTES * n_trials * first.spikes.shape[1] * n_neurons
        most = max(1, _memory(first.network.w_in.device) // size)
        parts += [places[i : i + most] for i in range(0, len(places), most)]
    return parts


def _memory(device: torch.device) -> int:
    if device.type != "cuda":
        return CPU_BYTES
    unused = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return (torch.cuda.mem_get_info(device)[0] + unused) // 2


def _width(network: RSNN) -> int:
    """Hidden neurons, rounded up to a power of two."""
    return 1 << (network.spec.hidden - 1).bit_length()


def _shape(batch: Batch) -> Hashable:
    """What networks that run as one have in common."""
    net = batch.network
    sizes = net.n_inputs, net.n_classes, _width(net), batch.spikes.shape[1], net.w_in.dtype
    spike = None if isinstance(net.spike, FastSigmoid) else (net.spike_of(0), net.spike_of(1))
    readout = net.spec.readout, net.readout_decay == 1, net.stretches
    return *sizes, net.neuron, spike, net.w_rec is None, net.adaptation is None, readout, batch.learns


def counts_of(batches: Sequence[Batch]) -> list[Counts]:
    """The counts of each network, all at once."""
    networks = [batch.network for batch in batches]
    width, n_trials = _width(networks[0]), max(len(batch.spikes) for batch in batches)
    spikes = torch.stack([_padded(batch.spikes, (0, 0, 0, 0, 0, n_trials - len(batch.spikes))) for batch in batches])
    with torch.set_grad_enabled(batches[0].learns):
        readout, hidden = counts(_stacked(networks, width), spikes, _heard(batches, width))
    sizes = [(len(batch.spikes), batch.network.spec.hidden) for batch in batches]
    return [
        Counts(decided[:n], sent[:n, :size])
        for decided, sent, (n, size) in zip(readout.unbind(), hidden.unbind(), sizes, strict=True)
    ]


def _stacked(networks: Sequence[RSNN], width: int) -> Model:
    """What the networks compute with, with a leading axis of networks; gradients reach their own parameters."""
    like, first = networks[0].w_in, networks[0]

    def each(value: Callable[[RSNN], Any], dtype: torch.dtype = like.dtype) -> Tensor:
        return torch.tensor([float(value(net)) for net in networks], dtype=dtype, device=like.device)[:, None, None]

    def stack(name: str, *sides: int) -> Tensor:
        """A weight matrix of each, with `sides` of 1 where it grows: columns, then rows."""
        return torch.stack(
            [
                _padded(getattr(net, name), [n for side in sides for n in (0, side * (width - net.spec.hidden))])
                for net in networks
            ]
        )

    alpha, beta, threshold = (
        torch.stack([getattr(net, name) for net in networks])[:, :, None, None]
        for name in ("alpha", "beta", "threshold")
    )

    def layer(index: int) -> Layer:
        spike, adaptation = first.spike_of(index), first.adaptation_of(index)
        if isinstance(spike, FastSigmoid):
            spike = FastSigmoid(each(lambda net: net.spike_of(index).scale))
        if adaptation is not None:
            strength, decay = (each(lambda net, key=key: getattr(net.adaptation, key)) for key in Adaptation._fields)
            adaptation = Adaptation(strength, decay)
        return Layer(alpha[:, index], beta[:, index], threshold[:, index], first.neuron, spike, adaptation)

    integration = first.integration
    if integration is not None:
        level = torch.stack([net.bias for net in networks if net.bias is not None])[:, None].to(torch.float64)
        decay = each(lambda net: net.readout_decay, torch.float64) if integration.leaks else 1.0
        integration = Integration(level, decay, integration.peak)
    w_rec = None if first.w_rec is None else stack("w_rec", 1, 1)
    return Model(
        layer(0), layer(1), stack("w_in", 1), w_rec, stack("readout_weights", 0, 1), integration, first.stretches
    )


def _heard(batches: Sequence[Batch], width: int) -> Tensor | None:
    """The factors of the input to integrators, `(network, hidden)`, or of stretches `(network, trial, hidden)`.

    None if all are 1.
    """
    factors = [batch.heard for batch in batches]
    given = [factor for factor in factors if factor is not None]
    if not given:
        return None
    n_trials = [max(map(len, given))] if given[0].ndim == 2 else []
    rows = given[0].new_ones(len(batches), *n_trials, width)
    for row, factor in zip(rows, factors, strict=True):
        if factor is not None:
            row[tuple(slice(size) for size in factor.shape)] = factor
    return rows


def _padded(values: Tensor, by: Sequence[int]) -> Tensor:
    return functional.pad(values, [*by]) if any(by) else values
