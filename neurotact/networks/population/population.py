"""A population: networks of one form together on a device, their windows as bits, forward and backward.

Networks are of one form if one compiled kernel runs them: the same afferents, classes and steps, membrane, reset,
delay and recurrence, and hidden sizes that are rounded up to the same power of two. Rows and columns beyond a network's
own size hold zeros, stay silent and get no gradient.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from neurotact.errors import InputError
from neurotact.networks.rsnn import RSNN
from neurotact.networks.surrogate import FastSigmoid
from neurotact.neurons import CubaLIF

TILE = 16
"""Windows per program, and the smallest padded size: products of tiles require 16 rows and columns."""
MOST = {"inputs": 128, "hidden": 64, "classes": 64}


class Form(NamedTuple):
    """What a kernel is compiled for; `hidden` is rounded up."""

    inputs: int
    hidden: int
    classes: int
    steps: int
    neuron: CubaLIF
    recurrent: bool

    @staticmethod
    def of(network: RSNN, steps: int) -> "Form":
        """The form of a network over windows of this many steps; InputError if no kernel runs it."""
        check(network)
        spec = network.spec
        hidden = _padded(spec.hidden)
        return Form(network.n_inputs, hidden, network.n_classes, steps, network.neuron, spec.recurrent)

    @property
    def padded(self) -> tuple[int, int, int]:
        """Rows and columns of inputs, hidden neurons and classes in memory."""
        return _padded(self.inputs), self.hidden, _padded(self.classes)

    @property
    def words(self) -> int:
        """Words of 32 bits that hold the afferents of a step."""
        return -(-self.inputs // 32)

    @property
    def warps(self) -> dict[str, int]:
        """Warps per program of each kernel: the fewest with no, or almost no, register spills (compiled for sm_90)."""
        return {"forward": 4, "backward": 4 if self.hidden <= 32 else 8}

    def constants(self) -> dict[str, object]:
        inputs, hidden, classes = self.padded
        return {
            "IP": inputs, "HP": hidden, "OP": classes, "BT": TILE, "WORDS": self.words,
            "MEMBRANE": self.neuron.membrane, "RESET": self.neuron.reset,
            "DELAYED": self.neuron.recurrent_delay_steps > 0, "RECURRENT": self.recurrent,
        }  # fmt: skip


def _padded(size: int) -> int:
    return max(TILE, 1 << (size - 1).bit_length())


def check(network: RSNN) -> None:
    """Refuse, in one line, a network that the kernels do not run."""
    spec = network.spec
    sizes = {"inputs": network.n_inputs, "hidden": spec.hidden, "classes": network.n_classes}
    large = [f"{sizes[name]} {name} (at most {most})" for name, most in MOST.items() if sizes[name] > most]
    if large:
        raise InputError(
            f"--device cuda: the network has {', '.join(large)}; leave --device out to train it on the CPU"
        )
    other = f"readout = '{spec.readout}'" if spec.readout != "count" else "learned dynamics" if spec.learn else None
    if other is None and (network.w_in.dtype != torch.float32 or not isinstance(network.spike, FastSigmoid)):
        other = "float64 or another surrogate"
    if network.adaptation is not None:
        raise InputError(
            "--device cuda: trains thresholds that do not adapt (threshold_adaptation = 0); leave --device out to "
            "train the network on the CPU"
        )
    if other:
        raise InputError(
            f"--device cuda: trains spiking readouts with fixed dynamics (readout = 'count', learn = []), not {other}; "
            "leave --device out to train it on the CPU, or pass --network rsnn"
        )


def packed(spikes: Tensor) -> Tensor:
    """Spikes `(window, time, afferent)`, 0 and 1, as bits: `(window, time, word)` int32, the first afferent lowest.

    >>> packed(torch.tensor([[[1, 0, 1]]], dtype=torch.uint8)).tolist()
    [[[5]]]
    """
    n_windows, n_steps, n_inputs = spikes.shape
    words = torch.zeros(n_windows, n_steps, -(-n_inputs // 32), dtype=torch.int32)
    for j in range(n_inputs):
        words[:, :, j // 32] |= spikes[:, :, j].to(torch.int32) << (j % 32)
    return words


class Counts(NamedTuple):
    """Spikes in a window, padded: `hidden` `(place, trial, hidden)` and `readout` `(place, trial, class)`."""

    hidden: Tensor
    readout: Tensor


class Tape(NamedTuple):
    """Membranes after each step, padded: `(place, trial, time, hidden)` and `(place, trial, time, class)`."""

    hidden: Tensor
    readout: Tensor


class Batch(NamedTuple):
    """Windows of a batch of some members, each member in a place, for one launch of the kernels.

    members: `(place,)` int32. windows: `(place, trial)` int32, indices of the population's bits. trials: how many
    of them are real, `(place,)` int32.
    """

    members: Tensor
    windows: Tensor
    trials: Tensor

    @property
    def real(self) -> Tensor:
        """Which trials are real, `(place, trial)`."""
        return torch.arange(self.windows.shape[1], device=self.trials.device) < self.trials[:, None]


class Population:
    """Networks of one form on a device, with their weights, which training changes in place.

    weights: `(member, weight)` float32: w_in, w_rec and w_out, padded, one after the other.
    bits: spikes of all windows, as `packed`, on the device.
    """

    def __init__(self, networks: Sequence[RSNN], form: Form, bits: Tensor, device: torch.device) -> None:
        if bits.numel() >= 2**31:
            raise InputError(f"--device cuda: {len(bits)} windows exceed what 32 bits can index; train on fewer")
        self.form, self.device, self.bits = form, device, bits.to(device)
        shapes = self._shapes()
        weights = torch.zeros(len(networks), sum(rows * columns for rows, columns in shapes.values()))
        for network, row in zip(networks, weights, strict=True):
            for name, part in self.parts(row).items():
                own = getattr(network, name)
                if own is not None:
                    part[: own.shape[0], : own.shape[1]] = own.detach()
        self.weights = weights.to(device)
        self.sizes = torch.tensor([network.spec.hidden for network in networks], dtype=torch.int32, device=device)
        self.constants = torch.stack([_dynamics(network) for network in networks]).to(device)

    def _shapes(self) -> dict[str, tuple[int, int]]:
        inputs, hidden, classes = self.form.padded
        return {"w_in": (inputs, hidden), "w_rec": (hidden, hidden), "w_out": (hidden, classes)}

    def parts(self, row: Tensor) -> dict[str, Tensor]:
        """Views of one member's weights or gradients."""
        shapes = self._shapes()
        parts = row.split([rows * columns for rows, columns in shapes.values()])
        return {name: part.view(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)}

    def row(self, values: Mapping[str, float]) -> Tensor:
        """One value per matrix, repeated for each of its weights, `(weight,)`."""
        row = torch.zeros(self.weights.shape[1])
        for name, part in self.parts(row).items():
            part.fill_(values.get(name, 0.0))
        return row

    @torch.no_grad()
    def write(self, network: RSNN, row: Tensor) -> None:
        """Copy the weights of a member, `(weight,)`, into a network."""
        for name, part in self.parts(row.cpu()).items():
            own = getattr(network, name)
            if own is not None:
                own.copy_(part[: own.shape[0], : own.shape[1]])

    def run(self, batch: Batch, *, keep: bool) -> tuple[Counts, Tape | None]:
        """Run windows forward; `keep`: return the tape that `gradients` requires."""
        n_places, n_trials = batch.windows.shape
        _, hidden, classes = self.form.padded
        empty = self.weights.new_empty
        counts = Counts(
            self.weights.new_zeros(n_places, n_trials, hidden), self.weights.new_zeros(n_places, n_trials, classes)
        )
        n_kept = (n_places, n_trials, self.form.steps) if keep else (1, 1, 1)
        tape = Tape(empty(*n_kept, hidden), empty(*n_kept, classes))
        _kernels().forward[n_places, -(-n_trials // TILE)](
            self.bits, batch.windows, batch.members, self.sizes, batch.trials, self.constants, self.weights,
            *tape, *counts, n_trials, self.form.steps, self.form.inputs,
            **self.form.constants(), KEEP=keep, num_warps=self.form.warps["forward"], enable_fp_fusion=False,
        )  # fmt: skip
        return counts, tape if keep else None

    def gradients(self, batch: Batch, tape: Tape, g: Counts) -> Tensor:
        """dL/d weights of the members of a batch, `(place, weight)`, from dL/d counts."""
        n_places, n_trials = batch.windows.shape
        n_tiles = -(-n_trials // TILE)
        parts = self.weights.new_empty(n_places, n_tiles, self.weights.shape[1])
        _kernels().backward[n_places, n_tiles](
            self.bits, batch.windows, batch.members, batch.trials, self.constants, self.weights,
            *tape, g.hidden.contiguous(), g.readout.contiguous(), parts,
            n_trials, self.form.steps, self.form.inputs, n_tiles,
            **self.form.constants(), num_warps=self.form.warps["backward"], enable_fp_fusion=False,
        )  # fmt: skip
        # One after another: the order of the terms in a sum over a dimension may depend on the other dimensions.
        total = parts[:, 0]
        for tile in range(1, n_tiles):
            total = total + parts[:, tile]
        return total


def _kernels() -> Any:
    """The kernels, imported when they first run: nothing else in the package imports Triton."""
    from neurotact.networks.population import kernels

    return kernels


def _dynamics(network: RSNN) -> Tensor:
    """Alpha, beta, threshold and surrogate scale, each of hidden layer and readout, `(8,)`."""
    scales = [network.spike_of(layer).scale for layer in (0, 1)]  # pyright: ignore[reportFunctionMemberAccess]
    values = [network.alpha, network.beta, network.threshold, torch.tensor(scales, dtype=torch.float32)]
    return torch.cat([value.detach().cpu() for value in values])
