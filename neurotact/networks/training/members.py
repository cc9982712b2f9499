"""A network that is trained once, or as several members that are then joined (`definition.joining`).

The members differ in their initial weights and in the order of their windows. The first one has the seeds that are
given: it is the network that one training without members gives. Members are trained one after another; a checkpoint
holds the weights of those that are finished.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from neurotact.networks.definition import seeds
from neurotact.networks.definition.joining import joined
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import training as one
from neurotact.networks.training.training import Checkpoint, Course, Epoch, Examples, Training

New = Callable[[tuple[int, int]], tuple[RSNN, torch.Generator]]
"""Makes an untrained network, and the generator of the order of its windows, from two seeds."""


def course(
    new: New,
    first: tuple[int, int],
    training: Examples,
    validation: Examples,
    *,
    progress: Callable[[Epoch], None] | None = None,
    start: Checkpoint | None = None,
    keep: Callable[[Checkpoint], None] | None = None,
) -> Course[tuple[RSNN, Training]]:
    """Train the members of a network, and join them; the network, and the log of all of them.

    new: is called for each member; `training.members` of its network says how many there are.
    first: the seeds of the first member.
    progress, start, keep: as for `training.course`.
    Raises InputError as that does.
    """
    network, order = new(first)
    n, members = network.spec.training.members, [network]
    log: list[Epoch] = []
    for number in range(1, n + 1):
        if number > 1:
            network, order = new(seeds.of_member(first, number))
            members.append(network)
        _be_one(network)
        own, finished = _part_of(start, number)
        if finished is not None:
            network.load_state_dict(finished)
            log += own.epochs if own else ()
            continue
        before = tuple(log), tuple(members[:-1])
        kept = None if keep is None else _with_earlier(keep, *before)
        own_training = yield from one.course(
            network, training, validation, generator=order, progress=progress, start=own, keep=kept, member=number
        )
        if n == 1:
            return network, own_training
        log += own_training.epochs
    whole = joined(members)
    fitted = yield from one.judge(whole, training.binned(whole))
    judged = yield from one.judge(whole, validation.binned(whole))
    return whole, Training(tuple(log), Epoch(log[-1].epoch, *fitted, *judged, one.JOINED))


def spec_of(network: RSNN, n_members: int) -> RSNNSpec:
    """The spec with which the members of a network are trained anew, its recipe resolved.

    >>> spec_of(RSNN(3, 2, hidden=8, readout="integrator", sampling_rate_Hz=1000.0), 2).hidden
    4
    """
    spec = network.spec
    if n_members == 1:
        return spec
    keys = {"hidden": spec.hidden // n_members, "training": spec.training.model_copy(update={"members": n_members})}
    blocks = {"recurrent_blocks": spec.recurrent_blocks // n_members} if spec.recurrent else {}
    return spec.model_copy(update={**keys, **blocks})


def _be_one(network: RSNN) -> None:
    """Have the spec of a member say what it is: one network."""
    alone = network.spec.training.model_copy(update={"members": 1})
    network.spec = network.spec.model_copy(update={"training": alone})


def _part_of(start: Checkpoint | None, number: int) -> tuple[Checkpoint | None, Mapping[str, Tensor] | None]:
    """The part of a checkpoint with the epochs of a member, and that member's weights if it is finished."""
    if start is None or number > len(start.finished) + 1:
        return None, None
    own = replace(start, epochs=tuple(epoch for epoch in start.epochs if epoch.member == number))
    return own, start.finished[number - 1] if number <= len(start.finished) else None


def _with_earlier(
    keep: Callable[[Checkpoint], None], log: tuple[Epoch, ...], members: tuple[RSNN, ...]
) -> Callable[[Checkpoint], None]:
    """`keep` for the checkpoints of one member: they get the epochs and the weights of the members before it."""
    finished = tuple(one.copied(member.state_dict()) for member in members)
    return lambda latest: keep(replace(latest, epochs=(*log, *latest.epochs), finished=finished))
