"""A network that is trained once, or as several that are trained one after another and joined.

With `model = "auto"`, one is trained without recurrence and one with it, and the first stays unless the second
classifies clearly more validation windows correctly. Several members differ in their initial weights and in the order
of their windows, and are then `joined`. The first one has the seeds that are given: it is the network that one training
without members gives. A checkpoint holds the weights of the networks that are finished.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from neurotact.errors import InputError
from neurotact.metrics.decision import is_within
from neurotact.networks.definition import recipe, seeds
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import epochs as one
from neurotact.networks.training import linear
from neurotact.networks.training.epochs import Checkpoint, Epoch, Examples, Training
from neurotact.networks.training.numbers import Scale

New = Callable[[RSNNSpec, tuple[int, int]], tuple[Network, torch.Generator]]
"""Makes an untrained network, and the generator of the order of its windows, from a spec and two seeds."""


def train(
    new: New,
    spec: RSNNSpec,
    first: tuple[int, int],
    training: Examples,
    validation: Examples,
    *,
    progress: Callable[[Epoch], None] | None = None,
    start: Checkpoint | None = None,
    keep: Callable[[Checkpoint], None] | None = None,
) -> tuple[Network, Training]:
    """Train the networks of a spec, and keep one or join them; the network, and the log of all of them.

    new: is called for each network. spec: with the choices of its recipe. first: the seeds of the first network.
    progress, start, keep: as for `epochs.train`.
    Numbers are learned standardised, and told in their units (`numbers.Scale`).
    Raises InputError as that does.
    """
    scale = Scale.of(training)
    if scale is not None:
        training, validation = scale.standard(training), scale.standard(validation)
    network, log = _trained(new, spec, first, training, validation, progress, start, keep)
    if scale is not None:
        scale.fold(network)
    return network, log


def _trained(
    new: New, spec: RSNNSpec, first: tuple[int, int], training: Examples, validation: Examples,
    progress: Callable[[Epoch], None] | None, start: Checkpoint | None, keep: Callable[[Checkpoint], None] | None,
) -> tuple[Network, Training]:  # fmt: skip
    """As `train`, with what is learned as it is."""
    series, gains = _Series(training, validation, progress, start, keep), dict[str, float]()
    alone = spec.model_copy(update={"training": spec.training.model_copy(update={"members": 1})})
    smallest = None
    if spec.direct == "auto":
        alone = alone.model_copy(update={"direct": False})
        smallest = _without_layer(new, alone, first, training, validation)
        gains["smallest_accuracy"] = float(smallest.right.double().mean())
        if (smallest.right >= 1).all():  # nothing is left to gain
            return smallest.network, replace(smallest.training, **gains)
    if spec.model == "auto":
        member, own, gain = _with_recurrence_if_it_gains(series, new, alone, first)
        gains |= {} if gain is None else {"recurrence_gain": gain}
    else:
        member, own = series.train(*new(alone, first))
    if smallest is not None:
        right = series.right_of(member)
        gains["layer_gain"] = _gain(smallest.right, right)
        if not pays(smallest.right, right):
            gains.pop("recurrence_gain", None)  # of a layer that does not stay
            return smallest.network, replace(smallest.training, **gains)
        if not (right >= 1).all():
            member, own, gains["path_gain"] = _with_path_if_it_gains(series, new, (member, own), first, right)
    if (n := spec.training.members) == 1:
        return member, Training(series.numbered(), own.best._replace(member=1), **gains)
    members = [member]
    for number in range(2, n + 1):
        another, _ = series.train(*new(member.spec, seeds.of_member(first, number)))
        members.append(another)
    whole = joined([one for one in members if isinstance(one, RSNN)])  # no other has several members
    fitted = one.judge(whole, training.binned(whole))
    judged = one.judge(whole, validation.binned(whole))
    best = Epoch(series.log[-1].epoch, *fitted, *judged, one.JOINED)
    return whole, Training(series.numbered(), best, **gains)


class _Smallest(NamedTuple):
    """A network without a hidden layer, its log, and whether it has each validation window right."""

    network: Network
    training: Training
    right: Tensor


def _without_layer(
    new: New, spec: RSNNSpec, first: tuple[int, int], training: Examples, validation: Examples
) -> _Smallest:
    """The network without a hidden layer; it is fitted anew where a training goes on, since that takes seconds."""
    model = spec.of_model("snn") if spec.model == "auto" else spec
    layered, _ = new(model, first)
    assert isinstance(layered, RSNN)
    network, _ = new(recipe.without_layer(layered, training.spikes.shape[1]), first)
    assert isinstance(network, RSNN)
    done = linear.train(network, training, validation)
    return _Smallest(network, done, one.right_of(network, validation.binned(network)))


def _with_path_if_it_gains(
    series: "_Series", new: New, before: tuple[Network, Training], first: tuple[int, int], right: Tensor
) -> tuple[Network, Training, float]:
    """The network with a path past its hidden layer, if that gains, and what it gains; right: as it is without."""
    past, own = series.train(*new(before[0].spec.model_copy(update={"direct": True}), first))
    with_path = series.right_of(past)
    is_better = pays(right, with_path)
    series.dropped.add((before[1] if is_better else own).best.member)
    return *((past, own) if is_better else before), _gain(right, with_path)


def _with_recurrence_if_it_gains(
    series: "_Series", new: New, spec: RSNNSpec, first: tuple[int, int]
) -> tuple[Network, Training, float | None]:
    """The better network of the two, its training, and the validation accuracy that recurrence gains.

    Where all windows are learned without recurrence, it can gain nothing and is not tried (None). If weights with
    recurrence do not stay finite, a warning says so, and the other network stays (None).
    """
    plain, own = series.train(*new(spec.of_model("snn"), first))
    if one.has_learned(own.epochs, spec.training):
        return plain, own, None
    try:
        recurrent, its_own = series.train(*new(spec.of_model("rsnn"), first))
    except InputError as error:
        warnings.warn(f"{error}; the network without recurrence stays", stacklevel=2)
        return plain, own, None
    without, with_it = series.right_of(plain), series.right_of(recurrent)
    gain = _gain(without, with_it)
    if pays(without, with_it):
        series.dropped.add(own.best.member)
        return recurrent, its_own, gain
    series.dropped.add(its_own.best.member)
    return plain, own, gain


def _gain(without: Tensor, with_it: Tensor) -> float:
    """The validation accuracy that a part of a network gains; both as for `pays`."""
    return float(with_it.double().mean() - without.double().mean())


def pays(without: Tensor, with_it: Tensor) -> bool:
    """Whether a part of a network gains more than the standard error of its gain, from the windows decided otherwise.

    without, with_it: whether each validation window is classified correctly, or its score, `(window,)`. Of `n` windows
    that only one of the two has right, chance alone favours either by the root of `n` (McNemar 1947, doi
    10.1007/BF02295996); of scores, by the root of the sum of their squared differences.

    >>> without = torch.tensor([True, False, False, False])
    >>> pays(without, torch.tensor([True, True, True, False])), pays(without, torch.tensor([False, True, True, False]))
    (True, False)
    """
    gained = with_it.double() - without.double()
    return not is_within(0.0, float(gained.sum()), float(gained.square().sum()) ** 0.5)


def spec_of(network: Network, n_members: int) -> RSNNSpec:
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


class _Series:
    """Trainings one after another, each of which is resumed from a checkpoint or is finished in it.

    log: the epochs of all trainings so far. dropped: the numbers of those whose networks are not kept.
    """

    def __init__(
        self,
        training: Examples,
        validation: Examples,
        progress: Callable[[Epoch], None] | None,
        start: Checkpoint | None,
        keep: Callable[[Checkpoint], None] | None,
    ) -> None:
        self.training, self.validation, self.log, self.dropped = training, validation, list[Epoch](), set[int]()
        self._progress, self._start, self._keep, self._networks = progress, start, keep, list[Network]()

    def train(self, network: Network, order: torch.Generator) -> tuple[Network, Training]:
        """Train the next network."""
        number = len(self._networks) + 1
        own, finished = self._saved(number, network)
        if own is not None and finished is not None:
            network.load_state_dict(finished)
            done = Training(own.epochs, one.best_in(own.epochs, network.spec.training))
        elif isinstance(network, RSNN) and not network.spec.hidden:
            sides = self.training, self.validation
            done = linear.train(network, *sides, progress=self._progress, member=number)
        else:
            done = one.train(
                network,
                self.training,
                self.validation,
                generator=order,
                progress=self._progress,
                start=own,
                keep=self._with_earlier(),
                member=number,
            )
        self.log += done.epochs
        self._networks.append(network)
        return network, done

    def right_of(self, network: Network) -> Tensor:
        """Whether a network classifies each validation window correctly."""
        return one.right_of(network, self.validation.binned(network))

    def _saved(self, number: int, network: Network) -> tuple[Checkpoint | None, Mapping[str, Tensor] | None]:
        """The part of the checkpoint with the epochs of a network, and its weights if it is finished.

        Neither of a network that has other weights: where one with recurrence failed, the next one has its number.
        """
        start = self._start
        if start is None or number > len(start.finished) + 1:
            return None, None
        finished = start.finished[number - 1] if number <= len(start.finished) else None
        if (start.weights if finished is None else finished).keys() != network.state_dict().keys():
            return None, None
        return replace(start, epochs=tuple(epoch for epoch in start.epochs if epoch.member == number)), finished

    def numbered(self) -> tuple[Epoch, ...]:
        """The log, in which those networks are numbered that are kept; a network that is not has `NOT_KEPT`."""
        kept = sorted({epoch.member for epoch in self.log} - self.dropped)
        numbers = dict.fromkeys(self.dropped, one.NOT_KEPT) | {member: number for number, member in enumerate(kept, 1)}
        return tuple(epoch._replace(member=numbers[epoch.member]) for epoch in self.log)

    def _with_earlier(self) -> Callable[[Checkpoint], None] | None:
        """`keep` for the checkpoints of one network: they get the epochs and weights of the networks before it."""
        keep, log = self._keep, tuple(self.log)
        if keep is None:
            return None
        finished = tuple(one.copied(network.state_dict()) for network in self._networks)
        return lambda latest: keep(replace(latest, epochs=(*log, *latest.epochs), finished=finished))


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
    _check_alike(networks)
    spec = first.spec
    blocks: dict[str, Any] = {"recurrent_blocks": n * spec.recurrent_blocks} if spec.recurrent else {}
    whole = RSNN(
        first.n_inputs, first.n_classes, spec, first.sampling_rate_Hz, backend=first.backend,
        generator=torch.Generator(),  # the weights are replaced: do not advance the global generator
        dtype=first.w_in.dtype, hidden=n * spec.hidden, **blocks,
    ).to(first.w_in.device)  # fmt: skip
    whole.spike = first.spike
    parts = {name: [network.state_dict()[name] for network in networks] for name in first.state_dict()}
    whole.load_state_dict({name: _joined_parameter(name, tensors, spec.hidden) for name, tensors in parts.items()})
    return whole


def _joined_parameter(name: str, parts: Sequence[Tensor], n_hidden: int) -> Tensor:
    """A parameter of the joined network; n_hidden: neurons of one, behind which its readout may hear the afferents."""
    if name in SHARED:
        return parts[0]
    if name == "w_in":
        return torch.cat([*parts], dim=1)
    if name == "w_rec":
        return torch.block_diag(*parts)
    if name == "bias":
        return torch.stack([*parts]).mean(dim=0)
    past = torch.stack([part[..., n_hidden:, :] for part in parts]).sum(dim=0)
    return torch.cat([*(part[..., :n_hidden, :] for part in parts), past], dim=-2) / len(parts)  # (..., heard, class)


def _check_alike(networks: Sequence[RSNN]) -> None:
    first = networks[0]
    sizes = first.n_inputs, first.n_classes, first.sampling_rate_Hz
    if any((network.n_inputs, network.n_classes, network.sampling_rate_Hz) != sizes for network in networks):
        raise InputError("networks: differ in their afferents, classes or clock; join networks of the same spikes")
    if any(network.spec != first.spec for network in networks):
        raise InputError("networks: have different specs; join networks of one spec")
    if first.spec.readout != "integrator" or first.spec.learn:
        raise InputError("networks: join only with readout = 'integrator' and without learn; train such ones")
