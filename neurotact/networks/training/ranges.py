"""The ranges of values on training trials, from which an export to integers chooses its formats."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from pydantic import AfterValidator
from torch import Tensor

from neurotact.data import encoded_from, onset
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.networks.definition import reference
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.neurons import cuba_lif_start

MOST_TRIALS = 256
"""Maximum number of trials from which the range of samples is taken."""
WINDOWS = 256
"""Maximum number of windows whose states are recorded."""

OF_EVENTS = (np.array([0.0, 1.0]),)
"""The samples of a network that takes the events of a sensor: whether there is one in a step."""


class Ranges(NamedTuple):
    """Recorded ranges: extremes of the samples, and the largest |I| or |U| of the hidden layer and of the readout.

    is_whole: whether every sample is a whole number, as the counts of a converter are.
    """

    low: float
    high: float
    hidden: float
    readout: float
    is_whole: bool = False


def _checked(ranges: Ranges) -> Ranges:
    """The ranges as they were read; ValueError if they can be no training's."""
    if not (-math.inf < ranges.low <= ranges.high < math.inf and 0 <= ranges.hidden < math.inf > ranges.readout >= 0):
        raise ValueError(f"cannot be recorded ranges: {[*ranges]}")
    return ranges


SavedRanges = Annotated[Ranges, AfterValidator(_checked)]
"""Ranges in a table that is read."""


def record(network: RSNN, rasters: Tensor, signals: Sequence[np.ndarray]) -> Ranges:
    """Ranges of states over training windows `(window, time, afferent)`, and of the samples of their trials."""
    low, high = min(float(s.min()) for s in signals), max(float(s.max()) for s in signals)
    is_whole = all(bool((s == np.rint(s)).all()) for s in signals)
    return Ranges(low, high, *record_states(network, rasters), is_whole)


@torch.no_grad()
def record_states(network: RSNN, rasters: Tensor) -> tuple[float, float]:
    """The largest |I| or |U| of the hidden layer and of the readout over windows `(window, time, afferent)`."""
    chosen = torch.linspace(0, len(rasters) - 1, min(len(rasters), WINDOWS)).long()
    spikes = network.binned(rasters[chosen]).to(network.w_in.dtype)
    states = [cuba_lif_start(len(spikes), n, network.w_in) for n in (network.spec.hidden, network.n_classes)]
    largest = [0.0, 0.0]
    layers = ((network.w_in, network.w_rec), (network.w_out, None))
    for t in range(spikes.shape[1]):
        inputs = spikes[:, t : t + 1]
        for index, (w, v) in enumerate(layers if network.bias is None else layers[:1]):
            inputs, states[index] = reference.cuba_lif_layer(
                inputs, w, v, alpha=network.alpha[index], beta=network.beta[index], threshold=network.threshold[index],
                neuron=network.neuron, spike=network.spike, adaptation=network.adaptation_of(index),
                state=states[index],
            )  # fmt: skip
            state = states[index]
            values = torch.stack([state.current, state.membrane]).abs()
            largest[index] = max(largest[index], float(values.max())) if values.numel() else 0.0
    return largest[0], largest[1]


def evenly(values: Any, most: int = MOST_TRIALS) -> Any:
    """At most so many of some trials or windows, spread evenly."""
    return values[onset.evenly(len(values), most)]


def recorded(
    network: Network, windows: Tensor, trains: SpikeTrains, trials: np.ndarray, spikes: str | Path
) -> Ranges | None:
    """Ranges over training windows, and over the recordings of training trials; None where these are not found.

    None, too, for a network that is no RSNN, which nothing writes in integers. Events are samples of 0 and 1.

    spikes: the file of the spike trains, which names the recordings.
    """
    if not isinstance(network, RSNN):
        return None
    if not trains.encoder:
        return record(network, windows, OF_EVENTS)
    try:
        path, rows = encoded_from.find(spikes, trains, evenly(trials))
        with encoded_from.opened(path, trains) as stored:
            signals = stored.select(rows).loaded().to_unit(str(trains.encoder.get("unit", "mV"))).signals
    except InputError:
        return None
    return record(network, windows, list(signals))
