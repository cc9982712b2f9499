"""Any `torch.nn.Module` as a network, and the one builder of networks.

The scores of all steps are added up from the module's `level` on, without a leak, and the largest sum decides. What the
module does not count, such as synaptic operations, is NaN: "not counted".
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor, nn

from neurotact import plugins
from neurotact.backend import Backend
from neurotact.errors import InputError, number_of
from neurotact.metrics import synops
from neurotact.metrics.flops import Cost
from neurotact.metrics.synops import Synops
from neurotact.networks.definition import clock, parts
from neurotact.networks.definition.network import (
    RASTER_VALUES,
    CountedInference,
    Counts,
    Inference,
    Network,
    Rasters,
    Simulated,
    decided,
)
from neurotact.networks.definition.parts import Counted, Sizes
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.definition.specs import RSNNSpec, part_of
from neurotact.networks.exit.rule import ExitRule

CLOSE = 1e-3
"""By how much scores may differ with the spikes after them, of the largest one: sums change in their last bits."""


def new(
    n_inputs: int,
    n_classes: int,
    spec: RSNNSpec,
    sampling_rate_Hz: float,
    *,
    backend: Backend = "auto",
    generator: torch.Generator | None = None,
    dtype: torch.dtype = torch.float32,
) -> Network:
    """An untrained network of a spec, whichever its model is.

    A module that draws its weights from torch's global generator draws them from `generator`, too.
    Raises InputError, which names the package, for a part that gives no module, or one without weights.

    >>> new(3, 2, RSNNSpec(model="layered", hidden=[4, 2]), 1000.0)
    ModuleNetwork(layered, 3 afferents, 2 classes, clock 1000 Hz, 26 weights)
    """
    part, n = part_of(spec.model), clock.steps_per_bin(spec.step_ms, sampling_rate_Hz)
    sizes = Sizes(n_inputs, n_classes, sampling_rate_Hz, sampling_rate_Hz / n, backend, generator, dtype)
    if spec.own is None:
        return part.module(spec, sizes)  # pyright: ignore[reportReturnType]
    with _seeded(_next_of(generator)):
        module = part.module(spec.own, sizes)
    if not isinstance(module, nn.Module):
        raise _unfit(spec, f"gives a {type(module).__name__} where a torch.nn.Module is expected")
    if not any(parameter.requires_grad for parameter in module.parameters()):
        raise _unfit(spec, "gives a module without weights to train")
    return ModuleNetwork(module.to(dtype), spec, sizes)


def cost_of(
    spec: RSNNSpec, n_inputs: int, n_classes: int, measured: Mapping[str, float], steps: float, signal_ms: float
) -> Cost | None:
    """The cost of a decision of a part's network, as its module says; None if it does not.

    measured: mean SOPs and spikes, with the names of results. steps: of the network's clock.
    """
    clock_Hz = 1e3 * steps / signal_ms if steps and signal_ms else 1.0
    with _seeded(0):
        module = part_of(spec.model).module(spec.own, Sizes(n_inputs, n_classes, clock_Hz, clock_Hz))
    cost: Callable[..., Cost] | None = getattr(module, "cost", None)
    return None if cost is None else cost(measured, steps, signal_ms)


class ModuleNetwork(Network):
    """A module of a part, on the clock of its spec."""

    def __init__(self, module: nn.Module, spec: RSNNSpec, sizes: Sizes) -> None:
        super().__init__()
        self.module, self.spec, self._sizes = module, spec, sizes
        self.sampling_rate_Hz, self.clock_Hz, self.backend = sizes.sampling_rate_Hz, sizes.clock_Hz, sizes.backend
        self.steps_per_bin = round(sizes.sampling_rate_Hz / sizes.clock_Hz)

    def __repr__(self) -> str:
        n_weights = sum(parameter.numel() for parameter in self.parameters() if parameter.requires_grad)
        return (
            f"ModuleNetwork({self.spec.model}, {number_of(self.n_inputs, 'afferent')}, {self.n_classes} classes, "
            f"clock {self.clock_Hz:g} Hz, {n_weights:,} weights)"
        )

    @property
    def n_inputs(self) -> int:
        return self._sizes.n_inputs

    @property
    def n_classes(self) -> int:
        return self._sizes.n_classes

    @property
    def integration(self) -> Integration:
        """The sum of the scores, which begins with the module's `level` `(class,)`, or 0."""
        level = getattr(self.module, "level", None)
        if level is None:
            return Integration(torch.zeros(self.n_classes, dtype=torch.float64, device=self.device))
        return Integration(level.double())

    def on_own_clock(self) -> "ModuleNetwork":
        """The same network for spikes that are `binned`, with the same module."""
        spec = self.spec.model_copy(update={"step_ms": None})
        return ModuleNetwork(self.module, spec, self._sizes._replace(sampling_rate_Hz=self.clock_Hz))

    def counts(self, spikes: Tensor) -> Counts:
        """The sums of the scores of windows whose spikes are `binned`, and the hidden spikes if they are counted."""
        self.module.eval()
        return self._counts(spikes)

    def counts_in_training(self, spikes: Tensor, generator: torch.Generator) -> Counts:
        """`counts` as in training; what the module draws from torch's global generator, it draws from `generator`."""
        self.module.train()
        with _seeded(_drawn(generator)):
            return self._counts(spikes)

    def _counts(self, spikes: Tensor) -> Counts:
        found = self._counted(spikes)
        values = self.integration.of(found.scores.double()).to(self.dtype)
        return Counts(values, _hidden_of(found).sum(dim=1))

    def simulate(self, spikes: Tensor) -> Rasters:
        """The scores of each step, and hidden spikes if they are counted."""
        return self.simulated(spikes).rasters

    def simulated(self, spikes: Tensor) -> Simulated:
        """`simulate`, with operations if they are counted."""
        return self._simulated(self.binned(spikes))

    def _simulated(self, spikes: Tensor) -> Simulated:
        self.module.eval()
        found = self._counted(spikes)
        sops = None if found.sops is None else self._operations(found.sops, found.scores)
        return Simulated(Rasters(_hidden_of(found), found.scores.double()), sops)

    def _infer(self, spikes: Tensor, rule: ExitRule) -> Inference:
        n_values = spikes.shape[1] * (self.n_inputs + self.spec.n_hidden + self.n_classes)
        of_parts = [
            decided(part, self._simulated(part), rule, self.integration)
            for part in spikes.split(max(1, RASTER_VALUES // max(1, n_values)))
        ]
        found = type(of_parts[0])(*map(torch.cat, zip(*of_parts, strict=True)))
        if isinstance(found, CountedInference):
            found.sops = torch.cat([part.sops for part in of_parts if isinstance(part, CountedInference)])
        return found

    def operations(self, input_spikes: np.ndarray, hidden_spikes: np.ndarray, sops: np.ndarray | None) -> Synops:
        """As of `Network`; those between hidden layers are in both totals alone."""
        if sops is None:
            return synops.not_counted(len(input_spikes))
        if (sops == np.floor(sops)).all():
            sops = sops.astype(np.int64)
        input_, recurrent, between, readout = sops.T
        feedforward = input_ + between + readout
        return Synops(input_, recurrent, readout, feedforward + recurrent, feedforward)

    def begin(self, spikes: Tensor, generator: torch.Generator) -> None:
        """Let the module prepare its initial weights for training windows whose spikes are `binned`, and check it.

        Raises InputError for scores of another shape, and for those that depend on later spikes: early exit could not
        stop there.
        """
        if callable(begin := getattr(self.module, "begin", None)):
            with _seeded(_next_of(generator)):
                begin(spikes.to(self.dtype), generator)
        self._check_causal(spikes)

    @torch.no_grad()
    def bound(self) -> None:
        """Let the module keep its learned constants in their range."""
        if callable(bound := getattr(self.module, "bound", None)):
            bound()

    def _counted(self, spikes: Tensor) -> Counted:
        """What the module makes of spikes; InputError for scores of another shape."""
        self._check(spikes)
        counted = getattr(self.module, "counted", None)
        given = spikes.to(self.dtype)
        found = Counted(self.module(given)) if counted is None else counted(given)
        expected = (*spikes.shape[:2], self.n_classes)
        scores = found.scores
        if not isinstance(scores, Tensor) or tuple(scores.shape) != expected:
            shape = tuple(scores.shape) if isinstance(scores, Tensor) else type(scores).__name__
            raise _unfit(self.spec, f"gives {shape} where scores (batch, time, class) = {expected} are expected")
        return found

    def _operations(self, sops: Mapping[str, Tensor], scores: Tensor) -> Tensor:
        """Operations `(trial, bin, projection)`."""
        unknown = [name for name in sops if name not in parts.PROJECTIONS]
        if unknown:
            raise _unfit(self.spec, f"counts operations of '{unknown[0]}', which is none of {parts.PROJECTIONS}")
        none = torch.zeros(scores.shape[:2], dtype=torch.float64, device=scores.device)
        return torch.stack([sops.get(name, none).double() for name in parts.PROJECTIONS], dim=-1)

    def _check_causal(self, spikes: Tensor) -> None:
        n_steps = spikes.shape[1]
        some, half = spikes[:: max(1, len(spikes) // 8)][:8], n_steps // 2
        if not half:
            return
        with torch.no_grad():
            cut = torch.cat([some[:, :half], 1 - some[:, half:].clamp(max=1)], dim=1)
            whole, early = (self._simulated(part).rasters.readout[:, :half] for part in (some, cut))
        if not torch.allclose(whole, early, rtol=0, atol=CLOSE * float(whole.abs().max().clamp(min=1.0))):
            raise _unfit(self.spec, "gives scores that depend on later spikes; a step may know those up to it alone")


def _hidden_of(found: Counted) -> Tensor:
    """The spikes of hidden neurons, of none where they are not counted."""
    return found.scores.new_zeros(*found.scores.shape[:2], 0) if found.hidden is None else found.hidden


@contextmanager
def _seeded(seed: int | None) -> Iterator[None]:
    """Seed torch's global generator, and leave it afterwards as it was; None: let it be."""
    with torch.random.fork_rng(enabled=seed is not None):
        if seed is not None:
            torch.manual_seed(seed)
        yield


def _next_of(generator: torch.Generator | None) -> int | None:
    """The number that a generator would draw next, which it does not."""
    if generator is None:
        return None
    return _drawn(torch.Generator().set_state(generator.get_state()))


def _drawn(generator: torch.Generator) -> int:
    return int(torch.randint(2**62, (), generator=generator))


def _unfit(spec: RSNNSpec, why: str) -> InputError:
    return plugins.unfit("networks", spec.model, why)
