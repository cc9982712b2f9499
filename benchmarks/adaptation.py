"""What thresholds that adapt cost a training step: forward and backward, with and without, in turns of one run.

The line of docs/kernels.md: python benchmarks/adaptation.py
"""

import statistics
import time

import torch

from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec

RATE_Hz, STEPS, BATCH, TURNS = 2000.0, 300, 128, 40


def made(hidden: int, strength: float) -> RSNN:
    """A network of the studies' kind whose thresholds rise by `strength` a spike."""
    spec = RSNNSpec(hidden=hidden, threshold_adaptation=strength)
    return RSNN(16, 8, spec, RATE_Hz, backend="native", generator=torch.Generator().manual_seed(0))


def step_ms(net: RSNN, x: torch.Tensor) -> float:
    """Processor time of forward and backward on this thread."""
    start = time.thread_time()
    net(x).readout.sum().backward()
    return 1e3 * (time.thread_time() - start)


def main() -> None:
    torch.set_num_threads(1)
    x = (torch.rand(BATCH, STEPS, 16, generator=torch.Generator().manual_seed(1)) < 0.12).to(torch.uint8)
    for hidden in (30, 64, 128):
        nets = {strength: made(hidden, strength) for strength in (0.0, 1e-6, 0.3)}
        taken = {strength: [] for strength in nets}
        for _ in range(TURNS):
            for strength, net in nets.items():
                taken[strength].append(step_ms(net, x))
        found = ", ".join(
            f"k = {strength:g} {statistics.median(times):.2f} ms ({nets[strength](x).hidden.sum() / BATCH:.0f} spikes)"
            for strength, times in taken.items()
        )
        print(f"16-{hidden}-8: {found}")


if __name__ == "__main__":
    main()
