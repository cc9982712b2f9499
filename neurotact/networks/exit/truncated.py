"""Trained networks on less than their full window: truncated at a fixed time, or by early exit.

The state of a network does not depend on later input: one simulation of full windows gives the decision, and its cost,
at every step.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from neurotact.networks.definition.network import Network
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.exit.exit_choice import exits, oracle_exit
from neurotact.networks.training.training import Examples

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


def cut_short(network: Network, windows: SimulatedWindows, cuts_ms: Sequence[float]) -> list[dict[str, Any]]:
    """Accuracy and mean SOPs at each cut within the window; the counts at its last step decide.

    Columns: cut_ms, accuracy_test, and sops_* as in results.csv.
    """
    rows = []
    for cut_ms in cuts_ms:
        n_steps = round(cut_ms * 1e-3 * network.clock_Hz)
        if 1 <= n_steps <= windows.readout.shape[1]:
            until = windows.readout[:, :n_steps]
            chosen = (until.sum(dim=1) if windows.integration is None else windows.integration.of(until)).argmax(dim=1)
            steps = torch.full_like(chosen, n_steps)
            rows.append({"cut_ms": cut_ms, **judged(network, windows, steps, chosen)})
    return rows


def exit_curve(
    network: Network, test: SimulatedWindows, validation: SimulatedWindows, patiences: Sequence[int]
) -> list[dict[str, Any]]:
    """Accuracy, steps and mean SOPs on test windows over patience, in each mode of early exit.

    Columns: mode (`validated`; `oracle`, the texture paper's Algorithm 1; `printed`, the same read to the letter),
    patience in steps, accuracy_validation with the same patience,
    accuracy_test, exit_steps, exit_steps_sd (deviation over windows), exit_steps_right (mean over windows with the
    right label at exit), sops_* as in results.csv; compared with the full window, accuracy_lost, and the shares
    steps_saved and sops_saved. Steps are those of the input's clock; of the patiences, those that are whole steps of
    the network are tried. A patience of the window's length never exits.
    """
    n_bins, n = test.readout.shape[1], network.steps_per_bin
    within = [patience // n for patience in patiences if not patience % n and patience <= n_bins * n]
    (whole,) = cut_short(network, test, [1e3 * n_bins / network.clock_Hz])
    rows = []
    for mode, decide in (("validated", _validated), ("oracle", _oracle), ("printed", _printed)):
        on_test, on_validation = decide(test, within), decide(validation, within)
        for patience, (steps, chosen), (_, decided) in zip(within, on_test, on_validation, strict=True):
            row = judged(network, test, steps, chosen)
            mean = n * float(steps.double().mean())
            rows.append(
                {
                    "mode": mode,
                    "patience": patience * n,
                    "accuracy_validation": _share(decided == validation.labels),
                    "exit_steps": mean,
                    "exit_steps_sd": n * float(steps.double().std(correction=0)),
                    "exit_steps_right": _mean_where(chosen == test.labels, steps * n),
                    **row,
                    "accuracy_lost": whole["accuracy_test"] - row["accuracy_test"],
                    "steps_saved": 1.0 - mean / (n * n_bins),
                    "sops_saved": 1.0 - row["sops_total"] / max(whole["sops_total"], 1.0),
                }
            )
    return rows


def _validated(windows: SimulatedWindows, patiences: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
    """Steps and labels `(window,)` at each patience, counted from the first readout spike."""
    decisions = exits(windows.readout, integration=windows.integration)
    return [(decisions.steps[:, patience - 1], decisions.labels[:, patience - 1]) for patience in patiences]


def _oracle(windows: SimulatedWindows, patiences: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
    """The same by the texture paper's Algorithm 1, which starts at each patience and knows the true labels."""
    return [oracle_exit(windows.readout, windows.labels, patience, windows.integration)[:2] for patience in patiences]


def _printed(windows: SimulatedWindows, patiences: Sequence[int]) -> list[tuple[Tensor, Tensor]]:
    """The same by Algorithm 1 to the letter, whose count is never reset."""
    labels, integration = windows.labels, windows.integration
    return [oracle_exit(windows.readout, labels, p, integration, as_printed=True)[:2] for p in patiences]


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


def _mean_where(right: Tensor, steps: Tensor) -> float | None:
    return float(steps[right].double().mean()) if right.any() else None


def _share(right: Tensor) -> float:
    return float(right.double().mean())
