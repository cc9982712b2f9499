"""NIR's nodes as neurotact writes them, on a clock with steps of `dt_s`.

NIR defines differential equations without a time step. snnTorch, Norse and others use forward Euler,
`I += dt/tau_syn (w_in x - I)`, then `U += dt/tau_mem (v_leak - U + r I)`, then `U > v_threshold` spikes and sets
`U = v_reset`. So a decay of a per step is written as tau = dt / (1 - a), with w_in and r as 1 / (1 - a): then
`I <- alpha I + x` and `U <- beta U + I`, to the last bit of a float64.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from neurotact.errors import InputError, optional

FORCE = 2.0**60
"""An input that makes any membrane fire: larger than any other input, and far below the largest float32."""
Edges = list[tuple[str, str]]


def nir() -> Any:
    """The package; InputError if it is not installed."""
    return optional("nir", "nir: cannot be imported ({}); pip install 'neurotact[nir]'")


@dataclass(frozen=True)
class Clock:
    """Seconds per step."""

    dt_s: float

    def tau(self, decay: Any, name: str) -> Any:
        """The time constant for which an Euler step multiplies by `decay`; of an array, of each."""
        within = (np.asarray(decay) >= 0) & (np.asarray(decay) < 1)
        if not within.all():
            wrong = float(np.atleast_1d(decay)[~np.atleast_1d(within)][0])
            raise InputError(f"{name}: is {wrong:g}, and NIR's time constants represent only decays from 0 to below 1")
        return self.dt_s / (1.0 - decay)

    def delay(self, steps: np.ndarray | int, n: int) -> Any:
        return nir().Delay(delay=np.broadcast_to(np.asarray(steps, np.float64), n) * self.dt_s)

    def leak(self, decay: Any, n: int, name: str, scale: Any = 1.0) -> Any:
        """A leaky integrator: `v <- decay v + scale x`."""
        tau = self.tau(decay, name)
        return nir().LI(tau=_all(tau, n), r=_all(scale * tau / self.dt_s, n), v_leak=np.zeros(n))

    def lif(self, decay: Any, threshold: Any, n: int, name: str) -> Any:
        """A membrane: `v <- decay v + x`, which spikes above its threshold and is then 0."""
        tau = self.tau(decay, name)
        return nir().LIF(
            tau=_all(tau, n), r=_all(tau / self.dt_s, n), v_leak=np.zeros(n), v_threshold=_all(threshold, n),
            v_reset=np.zeros(n),
        )  # fmt: skip

    def cuba(self, alpha: Any, beta: Any, threshold: Any, n: int, scale: Any = 1.0) -> Any:
        """`I <- alpha I + scale x`, `U <- beta U + I`, which spikes above its threshold and is then 0."""
        tau_syn, tau_mem = self.tau(alpha, "alpha"), self.tau(beta, "beta")
        return nir().CubaLIF(
            tau_syn=_all(tau_syn, n), tau_mem=_all(tau_mem, n), r=_all(tau_mem / self.dt_s, n), v_leak=np.zeros(n),
            v_threshold=_all(threshold, n), v_reset=np.zeros(n), w_in=_all(scale * tau_syn / self.dt_s, n),
        )  # fmt: skip

    def adder(self, n: int) -> Any:
        """`v <- v + x`."""
        return nir().I(r=_all(1.0 / self.dt_s, n))


def linear(weight: np.ndarray) -> Any:
    """Weights `(presynaptic, postsynaptic)`; NIR stores them as `(postsynaptic, presynaptic)`."""
    return nir().Linear(weight=np.ascontiguousarray(weight.T))


def threshold(level: Any, n: int) -> Any:
    """One where the input exceeds `level`, else zero."""
    return nir().Threshold(threshold=_all(level, n))


def scale(factor: Any, n: int) -> Any:
    """The input times `factor`."""
    return nir().Scale(scale=_all(factor, n))


def graph(nodes: dict[str, Any], edges: Edges, n_in: int, n_out: int, metadata: dict[str, Any] | None = None) -> Any:
    """A graph of these nodes with the nodes `input` and `output`, which the edges name."""
    package = nir()
    begin, end = package.Input({"input": np.array([n_in])}), package.Output({"output": np.array([n_out])})
    return package.NIRGraph({"input": begin, **nodes, "output": end}, edges, metadata or {})


def _all(value: Any, n: int) -> np.ndarray:
    return np.full(n, value, np.float64)
