"""The cost of an encoder over a window, in the layers of `neurotact.metrics.flops`."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from neurotact.data.conditioning import ConditioningSpec
from neurotact.encoders.afferents import marks, under, used_taxels
from neurotact.encoders.closed_form import cost_of_spikes
from neurotact.encoders.model import SA_RA, name_in, of_name
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Layer, MovingAverage, NotCounted, cost
from neurotact.metrics.signal_flops import (
    BaselineRemoval,
    Interpolation,
    Rectification,
    ScaledSteps,
    StandardisedSteps,
)

NOT_COUNTED = (
    "conditioning and encoding are not counted, because a part of them runs at the rate of the recording, which is not "
    "known; encode the recordings again, or give recorded_Hz, their samples per second"
)


def no_cost(encoder: Mapping[str, Any]) -> str | None:
    """That an encoder declares no cost, in words; None if it does.

    >>> no_cost({}) is None
    True
    """
    model = name_in(encoder)
    if of_name(model).cost is not None:
        return None
    return f"encoding is not counted, because the model '{model}' declares no cost"


def is_countable(encoder: Mapping[str, Any], recorded_Hz: float | None) -> bool:
    """Whether `encoding_cost` knows at which rate each step runs.

    >>> resampled = {"conditioning": {"resample_Hz": 1000.0}}
    >>> is_countable({}, None), is_countable(resampled, None), is_countable(resampled, 93.0)
    (True, False, True)
    """
    return _recorded_Hz(encoder, recorded_Hz) is not None or not _conditioning_of(encoder).get("resample_Hz")


def encoding_cost(
    n_taxels: int,
    steps: float,
    signal_ms: float,
    encoder: Mapping[str, Any],
    *,
    recorded_Hz: float | None = None,
    spikes: float | None = None,
) -> Cost:
    """The cost of an encoder over a window, from the recording to the spikes: conditioning and both populations.

    steps: of the encoder's clock. signal_ms: how long they take.

    encoder: its spec, as spike trains hold it; by default LIF without conditioning.

    recorded_Hz: samples of the recording per second; None takes the encoder's own `recorded_Hz` or, without
        resampling, a sample per step.

    spikes: of all afferents in the window, a mean or a number, which cost something where membranes are in closed form
        (`integration` = "exact"). None: as many as their refractory periods allow.

    Of populations that have only some taxels, only their afferents count, and only the conditioning of their taxels.

    Each operation counts at the rate at which it runs: the moving average once per sample of the recording, all after
    it once per step of the clock. In closed form, every sample of a recording that is slower than the clock counts in
    place of a step. A recording at the rate of the clock is not resampled. A baseline `start` counts as in a window
    that begins with its trial.

    All of it is on numbers of 32 bits, as exported integer C computes, but for what a model's cost says is narrower
    (`Cost.in_32_bits`).

    NaN, a `NotCounted`, for a model that declares no cost. Raises InputError where the signal is resampled and the rate
    of the recording is not known.

    Parameters are the values that a sensor's calibration fits: one gain per population (one per grade and polarity), an
    offset and a scale per taxel. Constants that all afferents share (decay, threshold, t_ref, the average's weight) do
    not count, as in every layer of the ledger.

    >>> lif = {"conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "mean"}}
    >>> encoding_cost(8, 300, 150.0, {}).flops, encoding_cost(8, 300, 150.0, lif).flops
    (28800, 40808)
    >>> quick = {"conditioning": {"ema_cutoff_Hz": 30.0, "resample_Hz": 1000.0}}
    >>> encoding_cost(8, 150, 150.0, quick, recorded_Hz=2000.0).multiplications  # one per sample and taxel
    2400
    >>> slow = {"integration": "exact", "recorded_Hz": 100.0}
    >>> encoding_cost(8, 150, 150.0, slow, spikes=20).flops  # 15 samples, and 34 for each spike
    2120
    >>> encoding_cost(8, 300, 150.0, {"sa1": {"taxels": [2]}, "ra1": {"taxels": []}}).flops  # 5 a step
    1500
    >>> calibrated = {"conditioning": {"offset": [0.0] * 16, "scale": [1.0] * 16}}
    >>> encoding_cost(16, 300, 300.0, calibrated).parameters
    34
    """
    if not is_countable(encoder, recorded_Hz):
        raise InputError(f"encoder: {NOT_COUNTED}")
    timed, rate_Hz = Cost(), _recorded_Hz(encoder, recorded_Hz)
    samples = steps if rate_Hz is None else 1e-3 * signal_ms * rate_Hz
    if encoder.get("integration") == "exact":
        steps = min(steps, samples)
        timed = cost_of_spikes(_most_spikes(n_taxels, signal_ms, encoder) if spikes is None else spikes)
    step_ms = signal_ms / steps if steps else 0.0
    n_used = len(used_taxels(encoder, n_taxels))
    layers = _conditioning(_conditioning_of(encoder), n_used, samples, steps, step_ms)
    own = of_name(name_in(encoder)).cost
    afferents = NotCounted() if own is None else own(encoder, n_taxels, _whole(steps), step_ms)
    if not afferents.wide_states_accesses:
        afferents = afferents.in_32_bits()
    return (cost(*layers, signal_ms=signal_ms) + timed).in_32_bits() + afferents


def _conditioning_of(encoder: Mapping[str, Any]) -> Mapping[str, Any]:
    return encoder.get("conditioning") or {}


def _recorded_Hz(encoder: Mapping[str, Any], given: float | None) -> float | None:  # noqa: N802
    return encoder.get("recorded_Hz") if given is None else given


def _whole(number: float) -> int:
    return max(1, round(number))


def _most_spikes(n_taxels: int, signal_ms: float, encoder: Mapping[str, Any]) -> float:
    kinds = [encoder.get(population.part) or {} for population in SA_RA]
    return sum(len(under(kind, n_taxels)) * len(marks(kind)) * signal_ms / kind.get("t_ref_ms", 1.0) for kind in kinds)


def _conditioning(
    spec: Mapping[str, Any], n_taxels: int, samples: float, steps: float, step_ms: float
) -> Iterator[Layer]:
    """The layers of `data.conditioning.condition`, in its order, of samples that become steps."""
    size = _whole(steps), n_taxels
    if spec.get("ema_cutoff_Hz") is not None:
        yield MovingAverage(_whole(samples), n_taxels)
    if spec.get("resample_Hz") is not None and not math.isclose(samples, steps, rel_tol=1e-9):
        yield Interpolation(*size)
    if spec.get("baseline", "none") != "none":
        start_ms = spec.get("start_ms", ConditioningSpec.model_fields["start_ms"].default)
        start = _whole(start_ms / step_ms) if step_ms else 1
        yield BaselineRemoval(*size, level=spec["baseline"], start=start)
    if spec.get("offset") is not None:
        yield StandardisedSteps(*size)  # an offset costs the same without scales, or with scales of 1
    elif spec.get("scale") is not None:
        yield ScaledSteps(*size)
    if spec.get("rectify"):
        yield Rectification(*size)
