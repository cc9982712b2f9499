"""The cost of an encoder over a window, in the layers of `neurotact.metrics.flops`."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from neurotact.encoders.afferents import marks
from neurotact.encoders.specs import MODELS, SA_RA
from neurotact.metrics.flops import Cost, ExactSpikes, Layer, MovingAverage, cost
from neurotact.metrics.signal_flops import (
    BaselineRemoval,
    Interpolation,
    Rectification,
    ScaledSteps,
    StandardisedSteps,
)


def encoding_cost(
    n_taxels: int, steps: float, signal_ms: float, encoder: Mapping[str, Any], *, spikes: float | None = None
) -> Cost:
    """The cost of an encoder over a window, from the recording to the spikes: conditioning and both populations.

    encoder: its spec, as spike trains hold it; by default LIF without conditioning.

    spikes: of all afferents in the window, a mean or a number, which cost something where membranes are in closed form
        (`integration` = "exact"). None: as many as their refractory periods allow.

    Every step of the encoder's clock counts, even for the moving average of a slower recording that is resampled later.
    In closed form, every sample of a recording that is slower than the clock counts in its place.
    Parameters are the values that a sensor's calibration fits: one gain per population (one per grade and polarity), an
    offset and a scale per taxel. Constants that all afferents share (decay, threshold, t_ref, the average's weight) do
    not count, as in every layer of the ledger.

    >>> lif = {"conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "mean"}}
    >>> encoding_cost(8, 300, 150.0, {}).flops, encoding_cost(8, 300, 150.0, lif).flops
    (28800, 40808)
    >>> slow = {"integration": "exact", "recorded_Hz": 100.0}
    >>> encoding_cost(8, 150, 150.0, slow, spikes=20).flops  # 15 samples, and 34 for each spike
    2120
    >>> calibrated = {"conditioning": {"resample_Hz": 1000.0, "offset": [0.0] * 16, "scale": [1.0] * 16}}
    >>> encoding_cost(16, 300, 300.0, calibrated).parameters
    34
    """
    conditioning, timed = encoder.get("conditioning") or {}, []
    if encoder.get("integration") == "exact":
        samples = 1e-3 * signal_ms * (encoder.get("recorded_Hz") or np.inf)
        if samples <= steps * (1 + 1e-9):
            steps, conditioning = samples, {**conditioning, "resample_Hz": None}
        timed = [ExactSpikes(_most_spikes(n_taxels, signal_ms, encoder) if spikes is None else spikes)]
    window = max(1, round(steps))
    layers = _conditioning(conditioning, n_taxels, window)
    afferents = _afferents(encoder, n_taxels, window, signal_ms / steps if steps else 0.0)
    return cost(*layers, afferents, *timed, signal_ms=signal_ms)


def _most_spikes(n_taxels: int, signal_ms: float, encoder: Mapping[str, Any]) -> float:
    kinds = [encoder.get(population.part) or {} for population in SA_RA]
    return sum(n_taxels * len(marks(kind)) * signal_ms / kind.get("t_ref_ms", 1.0) for kind in kinds)


def _conditioning(spec: Mapping[str, Any], n_taxels: int, steps: int) -> Iterator[Layer]:
    """The layers of `data.conditioning.condition`, in its order."""
    size = steps, n_taxels
    if spec.get("ema_cutoff_Hz") is not None:
        yield MovingAverage(*size)
    if spec.get("resample_Hz") is not None:
        yield Interpolation(*size)
    if spec.get("baseline", "none") != "none":
        yield BaselineRemoval(*size, level=spec["baseline"])
    if spec.get("offset") is not None:
        yield StandardisedSteps(*size)  # an offset costs the same without scales, or with scales of 1
    elif spec.get("scale") is not None:
        yield ScaledSteps(*size)
    if spec.get("rectify"):
        yield Rectification(*size)


def _afferents(encoder: Mapping[str, Any], n_taxels: int, steps: int, step_ms: float) -> Layer:
    return MODELS[encoder.get("model", "lif")].layer(encoder, n_taxels, steps, step_ms)
