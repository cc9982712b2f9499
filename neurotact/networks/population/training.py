"""Training a population: every member as `networks.training.train` trains it alone, all together on one device.

Members take the same turns: in each turn, every member with a batch left in its epoch runs it and steps. An epoch ends
for all members together; then they are validated, and the numbers are copied from the device once. The rules of
`networks.training` decide which members have finished.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.networks import fitting
from neurotact.networks import training as single
from neurotact.networks.fitting import Trained
from neurotact.networks.population.adam import Adam
from neurotact.networks.population.losses import Settings, losses
from neurotact.networks.population.population import Batch, Form, Population, packed
from neurotact.networks.rsnn import RSNN
from neurotact.networks.specs import RSNNSpec
from neurotact.networks.tasks import Sides, Task
from neurotact.networks.training import Epoch, Examples, Training

TAPE_BYTES = 2**30
"""Most memory for the membranes of the backward pass, in the interpreter; on a GPU, half of its free memory."""


class Member(NamedTuple):
    """A network to train, with what `training.train` takes; members may share their examples."""

    network: RSNN
    training: Examples
    validation: Examples
    generator: torch.Generator


@dataclass(frozen=True)
class Ended:
    """How a member ended.

    training: its log and its best epoch, whose weights its network now has; if stopped, its last epoch.
    stopped: by `watch`.
    error: why it could not continue; its network is unchanged.
    """

    training: Training
    stopped: bool = False
    error: InputError | None = None


Watch = Callable[[int, Epoch], bool]
"""Called with a member's place and each of its epochs; stops it by returning True."""


def check(network: RSNN, steps: int) -> None:
    """Refuse, in one line, a network that cannot be trained here."""
    Form.of(network, steps)
    spec = network.spec.training
    other = [
        name
        for name, differs in {
            "optimiser": spec.optimiser != "adam",
            "input_dropout": spec.input_dropout > 0,
            "input_jitter_ms": spec.input_jitter_ms > 0,
        }.items()
        if differs
    ]
    if other:
        raise InputError(
            f"--device cuda: trains with Adam on spikes as they are, not with training.{other[0]} = "
            f"{getattr(spec, other[0])}; leave --device out to train on the CPU"
        )


def train(members: Sequence[Member], device: torch.device, watch: Watch = lambda place, epoch: False) -> list[Ended]:
    """Train every member in place; returns how each ended, in their order.

    A member's numbers do not depend on the others. Raises InputError for a member that cannot be trained here.
    """
    for member in members:
        check(member.network, member.training.spikes.shape[1])
    groups: dict[Form, list[int]] = {}
    for place, member in enumerate(members):
        groups.setdefault(Form.of(member.network, member.training.spikes.shape[1]), []).append(place)
    ended: dict[int, Ended] = {}
    for form, places in groups.items():
        group = _Group(form, [members[place] for place in places], device)
        found = group.train(lambda own, epoch, places=places: watch(places[own], epoch))
        ended |= dict(zip(places, found, strict=True))
    return [ended[place] for place in range(len(members))]


class Asked(NamedTuple):
    """A new network to train, with the arguments of `fitting.fit`; networks with the same `sides` share windows."""

    trains: SpikeTrains
    spec: RSNNSpec
    task: Task
    seeds: tuple[int, int]
    sides: Sides

    def member(self) -> Member:
        """The untrained network; InputError if it cannot be trained here."""
        training = self.sides.train
        network, order = fitting.new_network(self.trains, self.spec, self.seeds, training.spikes)
        check(network, training.spikes.shape[1])
        return Member(network, training, self.sides.validation, order)


def fit(asked: Sequence[Asked], device: torch.device) -> list[Trained]:
    """Train networks as `fitting.fit` does, all together; their numbers do not depend on the population."""
    for sides in {id(each.sides): each.sides for each in asked}.values():
        fitting.warn_of_silence(sides.train)
    members = [each.member() for each in asked]
    fitted = []
    for each, member, end in zip(asked, members, train(members, device), strict=True):
        if end.error is not None:
            raise end.error
        fitted.append(fitting.finished(member.network, end.training, each.sides, each.task))
    return fitted


class _Windows:
    """The windows of all members on the device, spikes as bits, each set of examples once."""

    def __init__(self, members: Sequence[Member], device: torch.device) -> None:
        self._first: dict[int, int] = {}
        bits, labels, count = [], [], 0
        for examples in (side for member in members for side in (member.training, member.validation)):
            if id(examples.spikes) not in self._first:
                self._first[id(examples.spikes)] = count
                bits.append(packed(examples.spikes))
                labels.append(examples.labels)
                count += len(examples.labels)
        self.bits, self.labels = torch.cat(bits), torch.cat(labels).to(device)

    def of(self, examples: Examples, order: Tensor) -> Tensor:
        """Indices of the windows of some examples, in this order."""
        return (order + self._first[id(examples.spikes)]).to(torch.int32)


class _Plan:
    """The batches of an epoch: windows `(place, turn, trial)`, and how many of them are real, `(place, turn)`."""

    def __init__(self, members: Sequence[int], orders: Sequence[Tensor], sizes: Sequence[int], device) -> None:
        self.turns_of = [-(-len(order) // size) for order, size in zip(orders, sizes, strict=True)]
        self.turns = max(self.turns_of)
        windows = torch.zeros(len(orders), self.turns, max(sizes), dtype=torch.int32)
        for place, (order, size, turns) in enumerate(zip(orders, sizes, self.turns_of, strict=True)):
            whole = torch.zeros(turns * size, dtype=torch.int32)
            whole[: len(order)] = order
            windows[place, :turns, :size] = whole.view(turns, size)
        n, most = torch.tensor([len(order) for order in orders]), torch.tensor(sizes)
        left = n[:, None] - most[:, None] * torch.arange(self.turns)
        trials = torch.minimum(left.clamp(min=0), most[:, None]).to(torch.int32)
        self.longest = trials.max(dim=0).values.tolist()
        self.windows, self.trials = windows.to(device), trials.to(device)
        self.members = torch.tensor(members, dtype=torch.int32, device=device)

    def batches(self, turn: int, most: int) -> Iterator[tuple[list[int], Tensor, Batch]]:
        """Up to `most` places at a time with a batch in this turn: on the host, on the device, and the batch."""
        due = [place for place, turns in enumerate(self.turns_of) if turn < turns]
        for first in range(0, len(due), most):
            places = due[first : first + most]
            at = torch.tensor(places, device=self.windows.device)
            windows = self.windows[at, turn, : self.longest[turn]].contiguous()
            yield places, at, Batch(self.members[at], windows, self.trials[at, turn])


class _Group:
    """Members of one form."""

    def __init__(self, form: Form, members: Sequence[Member], device: torch.device) -> None:
        self.members, self.device = members, device
        networks = [member.network for member in members]
        self.windows = _Windows(members, device)
        self.population = Population(networks, form, self.windows.bits, device)
        self.settings = Settings.of([network.spec for network in networks], device)
        rates = torch.stack([self.population.row(single.rates_of(network)) for network in networks])
        self.adam = Adam(self.population.weights, rates, [network.spec.training.betas for network in networks])
        self.sizes = [network.spec.training.batch for network in networks]

    def train(self, watch: Watch) -> list[Ended]:
        logs: list[list[Epoch]] = [[] for _ in self.members]
        ended: dict[int, Ended] = {}
        best = self.population.weights.clone()
        while running := [place for place in range(len(self.members)) if place not in ended]:
            table = self._epoch(running, epochs_before=len(logs[running[0]]))
            improved = []
            for place, (is_finite, *numbers) in zip(running, table, strict=True):
                log, spec = logs[place], self.members[place].network.spec.training
                log.append(Epoch(len(log) + 1, *numbers))
                if not is_finite:
                    error = single.not_finite(len(log), spec)
                    ended[place] = Ended(Training(tuple(log), log[-1]), error=error)
                elif watch(place, log[-1]):
                    ended[place] = Ended(Training(tuple(log), log[-1]), stopped=True)
                else:
                    leader = single.best_of(log, spec.keep)
                    if leader is log[-1]:
                        improved.append(place)
                    if single.is_over(log, spec):
                        ended[place] = Ended(Training(tuple(log), leader))
            at = torch.tensor(improved, dtype=torch.int64, device=self.device)
            best[at] = self.population.weights[at]
        for place, end in ended.items():
            if end.error is None:
                rows = self.population.weights if end.stopped else best
                self.population.write(self.members[place].network, rows[place])
        return [ended[place] for place in range(len(self.members))]

    def _epoch(self, running: Sequence[int], epochs_before: int) -> list[tuple]:
        """Train members for an epoch and validate them; for each, whether it is finite, and the numbers of `Epoch`."""
        members = [self.members[place] for place in running]
        orders = [torch.randperm(len(each.training.labels), generator=each.generator) for each in members]
        fitted = self._pass(running, [m.training for m in members], orders, epochs_before)
        whole = [torch.arange(len(each.validation.labels)) for each in members]
        judged = self._pass(running, [m.validation for m in members], whole, None)
        is_finite = self.population.weights[running].isfinite().all(dim=1)
        table = torch.stack([is_finite.double(), *fitted, *judged], dim=1).cpu().tolist()
        return [(row[0] > 0, *row[1:]) for row in table]

    def _pass(
        self, running: Sequence[int], examples: Sequence[Examples], orders: Sequence[Tensor], epochs_before: int | None
    ) -> tuple[Tensor, Tensor]:
        """Loss and accuracy `(place,)`, of each batch before its step; no steps without `epochs_before`."""
        sizes = [self.sizes[place] for place in running]
        placed = [self.windows.of(side, order) for side, order in zip(examples, orders, strict=True)]
        plan = _Plan(running, placed, sizes, self.device)
        total = torch.zeros(len(running), dtype=torch.float64, device=self.device)
        correct = torch.zeros_like(total)
        for turn in range(plan.turns):
            for places, at, batch in plan.batches(turn, self._most_places(max(sizes))):
                counts, tape = self.population.run(batch, keep=epochs_before is not None)
                labels = self.windows.labels[batch.windows.long()]
                found = losses(counts, labels, batch, self.settings, self.population.form.classes)
                if tape is not None and epochs_before is not None:
                    shares = [
                        single.rate_left(
                            self.members[running[place]].network.spec.training,
                            epochs_before + turn / plan.turns_of[place],
                        )
                        for place in places
                    ]
                    gradients = self.population.gradients(batch, tape, found.g)
                    self.adam.step(batch.members, gradients, torch.tensor(shares, device=self.device))
                total[at] += found.loss * batch.trials
                correct[at] += found.correct
        n = torch.tensor([len(order) for order in orders], device=self.device)
        return total / n, correct / n

    def _most_places(self, n_trials: int) -> int:
        """How many members' membranes fit in memory together."""
        form = self.population.form
        _, hidden, classes = form.padded
        budget = TAPE_BYTES
        if self.device.type == "cuda":
            free, _ = torch.cuda.mem_get_info(self.device)
            budget = (free + torch.cuda.memory_reserved(self.device) - torch.cuda.memory_allocated(self.device)) // 2
        return max(1, int(budget) // (n_trials * form.steps * (hidden + classes) * 4))
