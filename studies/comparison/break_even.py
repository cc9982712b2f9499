"""How few spikes a spiking network must send to cost less than the dense network of its size.

The measure is that of Dampfhoffer et al. (IEEE Trans. Emerging Topics in Computational Intelligence 7(3), 2023): spikes
per synapse and decision. A dense network computes each synapse once in a decision, so 1 would be as many operations.
`benchmarks/break_even.py` draws the figure of the docs.
"""

import math
from collections.abc import Sequence

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.figure import Figure

from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Dense, Integrator, SpikingLayer, cost
from neurotact.metrics.prices import PriceList, names, price_list

HALVINGS = 60
STEPS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
SIZE = (32, 50, 10)
"""Afferents, hidden neurons and classes of the figure."""
PUBLISHED = (0.15, 1.38)
"""Spikes per synapse of Dampfhoffer et al. 2023, over the hardware that they model."""


def dense_cost(n_inputs: int, hidden: int, n_classes: int) -> Cost:
    """A decision of the dense network with as many inputs, hidden units and classes, which sees one frame."""
    return cost(Dense(n_inputs, hidden, "relu"), Dense(hidden, n_classes))


def spiking_cost(
    n_inputs: int, hidden: int, n_classes: int, steps: int, rate: float, *, event_driven: bool = False
) -> Cost:
    """A decision of the feed-forward spiking network in `steps` steps; rate: spikes per synapse, spread evenly."""

    def reached(neurons: int, sources: int) -> float | None:
        return neurons * steps * -math.expm1(-rate * sources / steps) if event_driven else None

    return cost(
        SpikingLayer(
            n_inputs, hidden, steps, sops=rate * n_inputs * hidden, recurrent=False, sent=rate * hidden,
            touched=reached(hidden, n_inputs),
        ),
        Integrator(hidden, n_classes, sops=rate * hidden * n_classes, touched=reached(n_classes, hidden), steps=steps),
    )  # fmt: skip


def break_even(n_inputs: int, hidden: int, n_classes: int, steps: int, prices: PriceList) -> float:
    """Spikes per synapse and decision below which the spiking network costs less energy than the dense one.

    steps: of a decision; without a spike a clocked network still updates its neurons on each. 0 where the spiking
    network costs as much without a spike.
    Raises InputError for fewer than one step.

    >>> [round(break_even(32, 50, 10, steps, price_list("arithmetic-45nm")), 2) for steps in (1, 10, 100)]
    [4.87, 2.46, 0.0]
    """
    if steps < 1:
        raise InputError(f"steps: must be at least 1; got {steps}")
    target = dense_cost(n_inputs, hidden, n_classes).energy_nJ(prices)

    def spent(rate: float) -> float:
        found = spiking_cost(n_inputs, hidden, n_classes, steps, rate, event_driven=prices.event_driven)
        return found.energy_nJ(prices)

    if spent(0.0) >= target:
        return 0.0
    low, high = 0.0, 1.0
    while spent(high) < target:
        low, high = high, 2 * high
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if spent(middle) < target else (low, middle)
    return low


def table(lists: Sequence[PriceList] = (), steps: Sequence[int] = STEPS) -> pd.DataFrame:
    """The break-even of each price list (all that are installed) over the steps of a decision, columns by name."""
    chosen = lists or [price_list(name) for name in names()]
    columns = {one.name: [break_even(*SIZE, n, one) for n in steps] for one in chosen}
    return pd.DataFrame({"steps": steps, **columns})


def drawn(found: pd.DataFrame) -> Figure:
    """The break-even over steps, a line for each price list, beside the published range."""
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    axes.axhspan(*PUBLISHED, color="0.9", label="published, Dampfhoffer et al. 2023")
    for name in found.columns[1:]:
        above = found[found[name] > 0]
        axes.plot(above["steps"], above[name], "o-", ms=3, label=name if len(above) else f"{name}: never")
    axes.set(xscale="log", yscale="log", xlabel="steps of a decision", ylabel="spikes per synapse and decision")
    axes.set_title("Below its line a spiking network costs less than the dense one of its size", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
    return figure
