"""Trained networks on less than their full window: truncated at a fixed time, or by early exit.

The state of a network does not depend on later input: one simulation of full windows gives the decision, and its cost,
at every step.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from neurotact.networks.definition.network import Network
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.training.epochs import Examples

AT_ONCE = 256
"""Windows simulated together: rasters of all test windows of a second would take gigabytes."""


class SimulatedWindows(NamedTuple):
    """Simulated windows of a network.

    readout: spikes, or the input of an integrator, `(window, time, class)`, on the network's clock; integration: of an
    integrator, None if spikes are counted; input, hidden: spikes of all neurons up to and including each step
    `(window, time)` int64; labels: the true classes `(window,)`; sops: operations up to and including each step,
    `(window, time, projection)`, where the network counts them itself; touched: `RSNN.touched`, also up to and
    including each step, `(window, time, layer)`.
    """

    readout: Tensor
    input: Tensor
    hidden: Tensor
    labels: Tensor
    integration: Integration | None = None
    sops: Tensor | None = None
    touched: Tensor | None = None

    def touched_until(self, steps: Tensor) -> Tensor | None:
        """Means over windows that stop after so many steps of the network, `(layer,)`; None if they are not counted."""
        if self.touched is None:
            return None
        return self.touched[torch.arange(len(steps)), steps - 1].double().mean(dim=0)


@torch.no_grad()
def simulate_windows(network: Network, examples: Examples) -> SimulatedWindows:
    """Simulate full windows and return the spikes of each layer."""
    readout, inputs, hidden, sops, touched = [], [], [], [], []
    for spikes in examples.spikes.split(AT_ONCE):
        rasters, own = network.simulated(spikes.to(network.device))
        readout.append(
            rasters.readout.cpu() if network.integration is not None else rasters.readout.cpu().to(torch.uint8)
        )
        inputs.append(_until(network.binned(spikes)))
        hidden.append(_until(rasters.hidden.cpu()))
        sops += [] if own is None else [own.cpu().cumsum(dim=1)]
        if isinstance(network, RSNN):
            touched.append(network.touched(network.binned(spikes), rasters.hidden.cpu()).cumsum(dim=1))
    integration = None if network.integration is None else network.integration.detach().cpu()
    return SimulatedWindows(
        torch.cat(readout), torch.cat(inputs), torch.cat(hidden), examples.labels, integration,
        torch.cat(sops) if sops else None, torch.cat(touched) if touched else None,
    )  # fmt: skip


def judged(network: Network, windows: SimulatedWindows, steps: Tensor, chosen: Tensor) -> dict[str, float]:
    """Accuracy and mean SOPs of windows that stop after so many steps with these labels."""
    inputs, hidden = (until.gather(1, steps[:, None] - 1)[:, 0].numpy() for until in (windows.input, windows.hidden))
    sops = None if windows.sops is None else windows.sops[torch.arange(len(steps)), steps - 1].numpy()
    cost = network.operations(inputs, hidden, sops)
    means = {f"sops_{name}": float(values.mean()) for name, values in cost._asdict().items()}
    return {"accuracy_test": _share(chosen == windows.labels), **means}


def _until(spikes: Tensor) -> Tensor:
    """Spikes of all neurons up to and including each step, `(window, time)`."""
    return spikes.sum(dim=2).to(torch.int64).cumsum(dim=1)


def _share(right: Tensor) -> float:
    return float(right.double().mean())
