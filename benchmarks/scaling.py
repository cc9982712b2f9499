"""How the cost of a training step grows with steps, batch and spikes.

Draws the figure of the docs: python benchmarks/scaling.py -o docs/images/kernel-scaling.png
"""

import argparse
import time
from collections.abc import Sequence
from typing import NamedTuple

import torch
from matplotlib import rc_context
from matplotlib.figure import Figure

from neurotact.figures.style import INK, RC, new_figure, save
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec

RATE_Hz = 2000.0
STEP_ms = 1e3 / RATE_Hz


class Panel(NamedTuple):
    """One thing that changes: what stays, its name, its values, and milliseconds of both passes at each."""

    title: str
    words: str
    x: Sequence[float]
    ms: Sequence[float]


def cost(steps: int = 300, batch: int = 128, density: float = 0.12, weight: float = 1.0) -> tuple[float, float]:
    """Least milliseconds of both passes on one thread; spikes of inputs and hidden layer a trial and step."""
    spec = RSNNSpec(hidden=30, forward_weight_scale=weight)
    net = RSNN(16, 8, spec, RATE_Hz, backend="native", generator=torch.Generator().manual_seed(0))
    x = (torch.rand(batch, steps, 16, generator=torch.Generator().manual_seed(1)) < density).to(torch.uint8)
    times = []
    for _ in range(25):
        start = time.perf_counter()
        counts = net(x)
        counts.readout.sum().backward()
        times.append(1e3 * (time.perf_counter() - start))
    spikes = (x.sum().item() + counts.hidden.sum().item()) / (batch * steps)
    return min(times), spikes


def draw(panels: Sequence[Panel]) -> Figure:
    """Milliseconds of both passes over what each panel changes; what stays is its title."""
    with rc_context(RC):
        figure = new_figure(2.5)
        axes = figure.subplots(1, len(panels))
        for axis, panel in zip(axes, panels, strict=True):
            axis.plot(panel.x, panel.ms, "o-", color=INK, ms=4)
            axis.set(title=panel.title, xlabel=panel.words, xlim=(0, None), ylim=(0, None))
            axis.grid()
        above = axes[0].secondary_xaxis("top", functions=(lambda steps: steps * STEP_ms, lambda ms: ms / STEP_ms))
        above.set_xlabel("window (ms)")
        axes[0].set_ylabel("forward and backward (ms)")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", default="kernel-scaling.png")
    output = parser.parse_args().output
    torch.set_num_threads(1)
    steps, batches = (100, 200, 300, 600, 1000, 1500, 2000), (16, 32, 64, 128, 192, 256)
    by_spikes = [
        cost(density=density, weight=weight)
        for density, weight in ((0, 1), (0.02, 0.3), (0.05, 0.4), (0.12, 0.3), (0.12, 1), (0.3, 1), (0.5, 1))
    ]
    panels = (
        Panel("128 trials", f"steps of {STEP_ms:g} ms", steps, [cost(steps=n)[0] for n in steps]),
        Panel("300 steps (150 ms)", "trials in a batch", batches, [cost(batch=n)[0] for n in batches]),
        Panel(
            "128 trials, 300 steps", "spikes per trial and step", [s for _, s in by_spikes], [ms for ms, _ in by_spikes]
        ),
    )
    for panel in panels:
        print(panel.words, *(f"{a:g}: {b:.2f} ms" for a, b in zip(panel.x, panel.ms, strict=True)), sep="\n  ")
    save(draw(panels), output)


if __name__ == "__main__":
    main()
