"""The ways to save that a search combines: each is a list of amounts, the run's own first, then ever more saved."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from neurotact_parts.networks.saving.start import Start
from neurotact_parts.studies.comparison.saving import Bench, Setting

from neurotact.encoders.afferents import AfferentSpec

T_REF_MS = (2.0, 5.0, 10.0, 20.0, 50.0)
"""Refractory periods that are tried, where they are longer than the run's own and whole steps of the clock."""
SLOWER_ENCODER, SLOWER_NETWORK = (2, 5, 10), (1.5, 2, 4)
"""Factors on the steps of the encoder's clock and of the network's."""
FEWEST_STEPS = 10
"""Steps of a window that a slower clock leaves, at least."""
AFFERENTS = (0.75, 0.5, 0.35)
HIDDEN = (0.8, 0.6, 0.4, 0.2, 0.1)
WINDOWS = (0.75, 0.5)
RATE_PENALTIES = (0.01, 0.03, 0.1)
PRUNED = (0.5, 0.75, 0.9)
Point = dict[str, int]
"""How much of each way: an index into its amounts."""


class Way(NamedTuple):
    """A way to save. amounts: the keys of a `Setting` with each amount, the first of which saves nothing.

    middle: the index of the amount that is tried alone.
    """

    name: str
    amounts: tuple[Mapping[str, Any], ...]
    middle: int = 1


def ways_of(start: Start) -> dict[str, Way]:
    """The ways that a run has, by name."""
    bench, spec = start.bench, start.base.network.spec
    found = [*_of_afferents(bench), *_of_network(start)]
    if spec.recurrent:
        found.append(_way("recurrence", "recurrence", False))
    return {way.name: way for way in found if len(way.amounts) > 1}


def setting_of(point: Mapping[str, int], ways: Mapping[str, Way], start: Start) -> Setting:
    """The setting of a point, its times in whole steps of the encoder's clock."""
    if not any(point.values()):
        return Setting()
    keys: dict[str, Any] = {}
    for name, way in ways.items():
        keys |= way.amounts[point.get(name, 0)]
    ra1, sa1 = keys.pop("ra1", None), keys.pop("sa1", None)
    encoder, own_ms = start.bench.encoder, 1e3 / start.base.trains.sampling_rate_Hz
    step_ms = keys.get("encoder_ms", own_ms)
    if encoder is not None and (step_ms != own_ms or ra1 or sa1):
        periods = (ra1 or encoder.ra1.t_ref_ms, sa1 or encoder.sa1.t_ref_ms)
        keys["t_ref_ms"] = tuple(_whole(period, step_ms) for period in periods)
    network_ms = keys.get("step_ms", start.bench.network.own_step_ms)
    if network_ms is not None:
        keys["step_ms"] = _whole(network_ms, step_ms)
    return Setting(**keys)


def _whole(time_ms: float, step_ms: float) -> float:
    """The nearest time of whole steps, at least one.

    >>> _whole(12.0, 5.0), _whole(1.0, 5.0)
    (10.0, 5.0)
    """
    return float(f"{max(1, round(time_ms / step_ms)) * step_ms:.9g}")


def _way(name: str, key: str, *values: Any, middle: int = 1) -> Way:
    return Way(name, ({}, *({key: value} for value in values)), min(middle, len(values)))


def _of_afferents(bench: Bench) -> Iterator[Way]:
    """Refractory periods of each population, the encoder's clock, the moving average."""
    encoder = bench.encoder
    if not isinstance(encoder, AfferentSpec):
        return
    assert not hasattr(bench.touches, "afferents")
    step_ms = 1e3 / encoder.conditioning.clock_Hz(bench.touches.sampling_rate_Hz)
    for part, called in (("ra1", "RA-I"), ("sa1", "SA-I")):
        own = getattr(encoder, part).t_ref_ms
        periods = sorted({_whole(period, step_ms) for period in T_REF_MS if period < bench.window.length_ms / 4})
        yield _way(f"t_ref of {called}", part, *(period for period in periods if period > own), middle=2)
    yield _way("afferents", "afferents", *AFFERENTS)
    if encoder.integration == "clock":
        slower = (_whole(step_ms * factor, step_ms) for factor in SLOWER_ENCODER)
        yield _way("encoder's clock", "encoder_ms", *_fitting(slower, bench))
    if encoder.conditioning.ema_cutoff_Hz is not None:
        yield _way("moving average", "smoothing", False)


def _of_network(start: Start) -> Iterator[Way]:
    """The network's clock, its windows, its neurons, its weights and its spikes."""
    encoder_ms = 1e3 / start.base.trains.sampling_rate_Hz
    own_ms = start.base.network.spec.own_step_ms or encoder_ms
    slower = dict.fromkeys(_whole(own_ms * factor, encoder_ms) for factor in SLOWER_NETWORK)
    slower.pop(own_ms, None)
    steps = _fitting(slower, start.bench)
    yield _way("network's clock", "step_ms", *steps, middle=max(1, len(steps) - 1))
    yield _way("window", "window", *WINDOWS)
    spec, fewer = start.base.network.spec, [{"hidden": share} for share in HIDDEN]
    if spec.integrates and spec.readout_tau_ms is None:  # what a readout without a hidden layer needs
        fewer += [] if spec.direct else [{"hidden": HIDDEN[-1], "direct": True}]
        fewer.append({"hidden": 0.0, "recurrence": False} if spec.recurrent else {"hidden": 0.0})
    if spec.hidden:
        yield Way("hidden neurons", ({}, *fewer), 3)
    yield _way("pruning", "sparsity", *PRUNED, middle=2)
    if spec.hidden:
        own = spec.training.rate_penalty
        yield _way("rate penalty", "rate_penalty", *(value for value in RATE_PENALTIES if value > own), middle=2)


def _fitting(steps_ms: Iterable[float], bench: Bench) -> list[float]:
    return [step for step in steps_ms if step * FEWEST_STEPS <= bench.window.length_ms]
