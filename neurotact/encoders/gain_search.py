"""What each candidate gain does to the spikes of both populations, and which of them is chosen.

Too high, and all inter-spike intervals (ISIs) crowd at the refractory period; too low, and afferents fall silent.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from neurotact.data.conditioning import is_long
from neurotact.data.spool import Spool
from neurotact.encoders.afferents import POPULATIONS, AfferentSpec, encode
from neurotact.encoders.excerpts import Felt
from neurotact.errors import InputError
from neurotact.metrics.isi_distributions import bin_edges, separation, shares_of
from neurotact.metrics.spike_trains import events_of_raster, isis_ms
from neurotact.neurons import LIF
from neurotact.spec import Spec

FLOOR_OF_TAU = 0.1
"""To charge within this share of tau_mem takes 10.5 times the drive that just fires: such an ISI is mostly t_ref."""
STRONGEST, STEPS_BELOW = 99.9, 3
"""The search begins so many steps below the gain at which this percentile of the drive just reaches threshold."""

Progress = Callable[[int, str], None]


class CalibrationRule(Spec):
    """What makes gains acceptable, and which are tried.

    >>> CalibrationRule(candidates=12).max_silent_share
    0.05
    """

    max_silent_share: float = Field(default=0.05, ge=0, lt=1)
    """Of the trials, at most this share may leave a population without a spike."""
    max_floor_share: float = Field(default=0.1, ge=0, le=1)
    """Of a population's ISIs, at most this share may lie at the refractory floor."""
    tie: float = Field(default=0.02, ge=0, lt=1)
    """Gains that separate the classes within this share of the best are as good; the smallest of them is taken."""
    candidates: int = Field(default=24, ge=2)
    """Gains tried for each population."""
    step: float = Field(default=1.25, gt=1)
    """From one candidate to the next."""
    trials_per_class: int = Field(default=64, ge=2)
    """At most so many trials of each class are used, drawn at random."""
    excerpt_s: float = Field(default=2.0, gt=0)
    """Of each of them, at most so long a stretch, at a random place."""
    shuffles: int = Field(default=8, ge=1)
    """Random labellings of the trials; how far they separate is the separation that means nothing."""
    seed: int = Field(default=0, ge=0)
    """Of trials, stretches and shuffles."""


class Searched(NamedTuple):
    """Both populations at each candidate gain.

    table: `Calibration.table`, nothing chosen yet. isi: `Calibration.isi`.
    rates: spikes per second of each trial and afferent, `(trial, afferent)`, by the afferent's name and its gain.
    """

    table: pd.DataFrame
    isi: pd.DataFrame
    rates: dict[tuple[str, float], np.ndarray]


def search(
    felt: Felt, spec: AfferentSpec, rule: CalibrationRule, rng: np.random.Generator, progress: Progress | None
) -> Searched:
    """What both populations send at each candidate gain."""
    n_seconds = np.array(felt.signals.lengths) / felt.sampling_rate_Hz
    labels = felt.labels
    labellings = [labels, *(rng.permutation(labels) for _ in range(rule.shuffles))]
    grids = _candidates(felt, spec, rule)
    rows, isi, rates = [], [], {}
    for gains in zip(*grids.values(), strict=True):
        tried = {
            part: getattr(spec, part).model_copy(update={"gain": gain, "grades": (1.0,)})
            for part, gain in zip(grids, gains, strict=True)
        }
        for (part, afferent), gain, fired in zip(
            POPULATIONS.items(), gains, _fire(felt, spec.model_copy(update=tried)), strict=True
        ):
            row = {
                "afferent": afferent,
                "gain": gain,
                "silent_share": float(1 - fired.n_heard / len(labels)),
                "floor_share": fired.n_at_floor / fired.n_intervals if fired.n_intervals else 0.0,
                "separation": separation(fired.shares, labellings),
                "spikes_per_s": float(fired.counts.sum() / (n_seconds.sum() * fired.counts.shape[1])),
            }
            rows.append(row)
            rates[afferent, gain] = (fired.counts / n_seconds[:, None]).astype(np.float32)
            edges_ms = _edges(felt, spec, part) / felt.sampling_rate_Hz * 1e3
            isi.append(_isi_table(fired.shares, labels, felt.classes, edges_ms, afferent, gain))
        if progress:
            progress(1, ", ".join(f"{a} {g:g}" for a, g in zip(POPULATIONS.values(), gains, strict=True)))
    table = pd.DataFrame(rows).sort_values(["afferent", "gain"], ascending=[False, True], ignore_index=True)
    within = (table.silent_share <= rule.max_silent_share) & (table.floor_share <= rule.max_floor_share)
    return Searched(table.assign(admissible=within, chosen=False), pd.concat(isi, ignore_index=True), rates)


class Fired(NamedTuple):
    """What one population sends at one gain.

    shares: ISI distribution of each trial and afferent (`shares_of`). counts: their spikes, `(trial, afferent)`.
    n_heard: trials with a spike. n_at_floor, n_intervals: ISIs at the refractory floor, and all.
    """

    shares: np.ndarray
    counts: np.ndarray
    n_heard: int
    n_at_floor: int
    n_intervals: int


def _fire(felt: Felt, spec: AfferentSpec) -> Iterator[Fired]:
    """Both populations, in the order of `POPULATIONS`; so many trials at a time as are encoded side by side."""
    parts: dict[str, list[Fired]] = {part: [] for part in POPULATIONS}
    edges = {part: _edges(felt, spec, part) for part in POPULATIONS}
    for signal, n_steps in _side_by_side(felt.signals):
        spikes, _ = encode(signal, felt.sampling_rate_Hz, spec)
        spikes[np.arange(signal.shape[1]) >= n_steps[:, None]] = 0
        n_sa1 = felt.n_channels * len(spec.sa1.gains)
        for part, raster in zip(POPULATIONS, (spikes[..., :n_sa1], spikes[..., n_sa1:]), strict=True):
            isi_steps = isis_ms(events_of_raster(raster), 1e3)  # of 1 ms, so that they are counted in steps
            neuron = spec.neuron(getattr(spec, part), felt.sampling_rate_Hz)
            parts[part].append(
                Fired(
                    shares=shares_of(isi_steps, raster.shape, edges[part]),
                    counts=raster.sum(axis=1, dtype=np.int64),
                    n_heard=int(raster.any(axis=(1, 2)).sum()),
                    n_at_floor=_n_at_floor(isi_steps.isi_ms, neuron),
                    n_intervals=len(isi_steps.isi_ms),
                )
            )
    for found in parts.values():
        shares, counts, *numbers = zip(*found, strict=True)
        yield Fired(np.concatenate(shares), np.concatenate(counts), *map(sum, numbers))


def _side_by_side(signals: Spool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Consecutive signals as `(trial, time, taxel)`, zeros after the end of the shorter ones, and their lengths."""
    waiting: list[np.ndarray] = []
    for signal in signals:
        longest = max(map(len, [*waiting, signal]))
        if waiting and is_long((len(waiting) + 1) * longest, signal.shape[1]):
            yield _padded(waiting)
            waiting = []
        waiting.append(signal)
    yield _padded(waiting)


def _padded(signals: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    n_steps = np.array([len(x) for x in signals])
    padded = np.zeros((len(signals), n_steps.max(), signals[0].shape[1]), np.float32)
    for row, x in zip(padded, signals, strict=True):
        row[: len(x)] = x
    return padded, n_steps


def _edges(felt: Felt, spec: AfferentSpec, part: str) -> np.ndarray:
    """The bins of a population's ISIs, in steps."""
    neuron = spec.neuron(getattr(spec, part), felt.sampling_rate_Hz)
    return bin_edges(neuron.refractory_steps + 1, max(felt.signals.lengths))


def _candidates(felt: Felt, spec: AfferentSpec, rule: CalibrationRule) -> dict[str, list[float]]:
    """Gains of each population, from a little below the one at which its strongest drive just reaches threshold."""
    grids = {}
    for part, (drive, n_values) in drives(felt, spec).items():
        strongest = _strongest((x.ravel() for x in drive), n_values)
        if strongest <= 0:
            raise InputError(
                f"{felt.source}: the conditioned training trials never drive {POPULATIONS[part]} afferents; check "
                "the encoder's baseline and the columns that were read"
            )
        first = (spec.v_threshold_mV - spec.v_rest_mV) / strongest / rule.step**STEPS_BELOW
        grids[part] = [float(f"{first * rule.step**k:.3g}") for k in range(rule.candidates)]
    return grids


def drives(felt: Felt, spec: AfferentSpec) -> dict[str, tuple[Iterator[np.ndarray], int]]:
    """What each type feels by a gain of 1, trial by trial `(time, taxel)`, and how many values that is.

    Of SA-I of both polarities the size alone: one of the two feels it.
    """
    per_ms = felt.sampling_rate_Hz * 1e-3
    n_values = felt.n_channels * sum(felt.signals.lengths)
    return {
        "sa1": ((np.abs(x) if spec.sa1.opposite else x for x in felt.signals), n_values),
        "ra1": (
            (np.abs(np.diff(x, axis=0)) * per_ms for x in felt.signals),
            n_values - felt.n_channels * len(felt.signals),
        ),
    }


def _strongest(drive: Iterable[np.ndarray], n_values: int) -> float:
    """The `STRONGEST` percentile of `n_values` numbers that come in parts, or their maximum where it is not positive.

    As `np.percentile` has it, linear between two of the numbers; only those from there upwards are kept.
    """
    if n_values == 0:
        return 0.0
    place = (n_values - 1) * float(np.true_divide(STRONGEST, 100))
    below = int(place)
    n_kept = n_values - below
    top = np.empty(0, np.float32)
    for part in drive:
        top = np.concatenate([top, part])
        if len(top) > n_kept:
            top = np.partition(top, len(top) - n_kept)[len(top) - n_kept :]
    top.sort()
    low, high, share = top[0], top[min(1, len(top) - 1)], place - below
    strongest = high - (high - low) * (1 - share) if share >= 0.5 else low + (high - low) * share
    return float(strongest if strongest > 0 else top[-1])


def choose(table: pd.DataFrame, rule: CalibrationRule, where: str) -> int:
    """Index of the chosen row of one population.

    Where no gain keeps both limits, that of silent trials gives way: of the gains that keep the other, those with the
    fewest silent trials are left. A class may rest, and its silence tells it then.
    Raises InputError where no gain sends spikes without crowding them at the refractory floor.
    """
    good = table[table.admissible]
    if good.empty:
        heard = table[table.silent_share < 1]
        if heard.empty:
            raise InputError(
                f"{where}: no gain tried sends a spike; check the columns that were read and the encoder's tau_mem_ms"
            )
        good = heard[heard.floor_share <= rule.max_floor_share]
        if good.empty:
            raise InputError(
                f"{where}: every gain that sends spikes puts {heard.floor_share.min():.1%} of the ISIs at the "
                f"refractory floor or more, above max_floor_share = {rule.max_floor_share:.1%}; check the columns that "
                "were read, or give the encoder a longer tau_mem_ms"
            )
        good = good[good.silent_share == good.silent_share.min()]
    best = good.separation.max()
    return int(good.index[good.separation >= best - rule.tie * abs(best)][0])


def _n_at_floor(isi_steps: np.ndarray, neuron: LIF) -> int:
    """Intervals in which charging took one step, or no longer than FLOOR_OF_TAU of tau_mem."""
    with np.errstate(divide="ignore"):  # a membrane that never leaks takes an infinite share
        charging = np.maximum(1.0, np.round(-FLOOR_OF_TAU / np.log(neuron.decay)))
    return int((isi_steps <= neuron.refractory_steps + charging).sum())


def _isi_table(
    shares: np.ndarray, labels: np.ndarray, classes: tuple[str, ...], edges_ms: np.ndarray, afferent: str, gain: float
) -> pd.DataFrame:
    middles_ms = [*np.sqrt(edges_ms[1:] * edges_ms[:-1]), np.inf]
    parts = [
        pd.DataFrame({"label": name, "isi_ms": middles_ms, "share": shares[labels == label].mean(axis=(0, 1))})
        for label, name in enumerate(classes)
    ]
    return pd.concat(parts, ignore_index=True).assign(afferent=afferent, gain=gain)
