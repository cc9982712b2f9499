"""How the cost of a training step grows with steps, batch and spikes.

Draws the figure of the docs: python benchmarks/scaling.py -o docs/images/kernel-scaling.png
"""

import argparse
import time

import matplotlib.pyplot as plt
import torch

from neurotact.networks.rsnn import RSNN
from neurotact.networks.specs import RSNNSpec


def cost(steps: int = 300, batch: int = 128, density: float = 0.12, weight: float = 1.0) -> tuple[float, float]:
    """Least milliseconds of both passes on one thread; spikes of inputs and hidden layer a trial and step."""
    spec = RSNNSpec(hidden=30, forward_weight_scale=weight)
    net = RSNN(16, 8, spec, 2000.0, backend="native", generator=torch.Generator().manual_seed(0))
    x = (torch.rand(batch, steps, 16, generator=torch.Generator().manual_seed(1)) < density).to(torch.uint8)
    times = []
    for _ in range(25):
        start = time.perf_counter()
        counts = net(x)
        counts.readout.sum().backward()
        times.append(1e3 * (time.perf_counter() - start))
    spikes = (x.sum().item() + counts.hidden.sum().item()) / (batch * steps)
    return min(times), spikes


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
        ("steps", steps, [cost(steps=n)[0] for n in steps]),
        ("batch", batches, [cost(batch=n)[0] for n in batches]),
        ("spikes a trial and step", [s for _, s in by_spikes], [ms for ms, _ in by_spikes]),
    )
    figure, axes = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
    for axis, (label, x, y) in zip(axes, panels, strict=True):
        axis.plot(x, y, "o-", color="black", markersize=4)
        axis.set(xlabel=label, xlim=(0, None), ylim=(0, None))
        axis.spines[["top", "right"]].set_visible(False)
        print(label, *(f"{a:g}: {b:.2f} ms" for a, b in zip(x, y, strict=True)), sep="\n  ")
    axes[0].set_ylabel("forward + backward (ms)\n16-30-8, one thread")
    figure.savefig(output, dpi=150)


if __name__ == "__main__":
    main()
