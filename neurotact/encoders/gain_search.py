"""The spikes of both populations at each candidate gain, and the choice of the gain.

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
from neurotact.encoders.excerpts import Excerpts
from neurotact.errors import InputError
from neurotact.metrics.isi_distributions import bin_edges, separation, shares_of
from neurotact.metrics.spike_trains import Intervals, events_of_raster, isis_ms, spike_counts
from neurotact.neurons import LIF
from neurotact.spec import Spec

FLOOR_OF_TAU = 0.1
"""Charging within this share of tau_mem takes 10.5 times the threshold drive: such an ISI is mostly t_ref."""
STRONGEST, STEPS_BELOW = 99.9, 3
"""The search begins `STEPS_BELOW` steps below the gain at which this percentile of the drive just reaches threshold."""

Progress = Callable[[int, str], None]


class CalibrationRule(Spec):
    """The limits on gains, and the candidates.

    >>> CalibrationRule(candidates=12).max_silent_share
    0.05
    """

    max_silent_share: float = Field(default=0.05, ge=0, lt=1)
    """Maximum share of trials without a spike of a population."""
    max_floor_share: float = Field(default=0.1, ge=0, le=1)
    """Maximum share of a population's ISIs at the refractory floor."""
    tie: float = Field(default=0.02, ge=0, lt=1)
    """Gains whose separation is within this share of the best count as equal; the smallest of them is chosen."""
    candidates: int = Field(default=24, ge=2)
    """Number of candidate gains for each population."""
    step: float = Field(default=1.25, gt=1)
    """Ratio between successive candidates."""
    trials_per_class: int = Field(default=64, ge=2)
    """Maximum number of trials of each class, drawn at random."""
    excerpt_s: float = Field(default=2.0, gt=0)
    """Maximum length of the stretch of each of them, at a random time."""
    taxels: int = Field(default=128, ge=1)
    """Maximum number of taxels: of more, those that vary most in one trial after the other."""
    shuffles: int = Field(default=8, ge=1)
    """Random permutations of the labels; their separation is the chance level."""
    seed: int = Field(default=0, ge=0)
    """Random seed of trials, stretches and permutations."""


class Searched(NamedTuple):
    """Both populations at each candidate gain.

    table: `Calibration.table`, before the choice. isi: `Calibration.isi`.
    rates: spikes per second of each trial and afferent, `(trial, afferent)`, by the afferent's name and its gain.
    """

    table: pd.DataFrame
    isi: pd.DataFrame
    rates: dict[tuple[str, float], np.ndarray]


def search(
    excerpts: Excerpts,
    spec: AfferentSpec,
    rule: CalibrationRule,
    rng: np.random.Generator,
    progress: Progress | None,
) -> Searched:
    """The spikes of both populations at each candidate gain."""
    n_seconds = np.array(excerpts.signals.lengths) / excerpts.sampling_rate_Hz
    labels = excerpts.labels
    labellings = [labels, *(rng.permutation(labels) for _ in range(rule.shuffles))]
    grids = _candidates(excerpts, spec, rule)
    rows, isi, rates = [], [], {}
    for gains in zip(*grids.values(), strict=True):
        tried = {
            part: getattr(spec, part).model_copy(update={"gain": gain, "grades": (1.0,)})
            for part, gain in zip(grids, gains, strict=True)
        }
        for (part, afferent), gain, fired in zip(
            POPULATIONS.items(), gains, _fire(excerpts, spec.model_copy(update=tried)), strict=True
        ):
            row = {
                "afferent": afferent,
                "gain": gain,
                "silent_share": float(1 - fired.n_firing / len(labels)),
                "floor_share": fired.n_at_floor / fired.n_intervals if fired.n_intervals else 0.0,
                "separation": separation(fired.shares, labellings),
                "spikes_per_s": float(fired.counts.sum() / (n_seconds.sum() * fired.counts.shape[1])),
            }
            rows.append(row)
            rates[afferent, gain] = (fired.counts / n_seconds[:, None]).astype(np.float32)
            edges_ms = _edges(excerpts, spec, part) / excerpts.sampling_rate_Hz * 1e3
            isi.append(_isi_table(fired.shares, labels, excerpts.classes, edges_ms, afferent, gain))
        if progress:
            progress(1, ", ".join(f"{a} {g:g}" for a, g in zip(POPULATIONS.values(), gains, strict=True)))
    table = pd.DataFrame(rows).sort_values(["afferent", "gain"], ascending=[False, True], ignore_index=True)
    within = (table.silent_share <= rule.max_silent_share) & (table.floor_share <= rule.max_floor_share)
    return Searched(table.assign(admissible=within, chosen=False), pd.concat(isi, ignore_index=True), rates)


class Fired(NamedTuple):
    """The spikes of one population at one gain.

    shares: ISI distribution of each trial and afferent (`shares_of`). counts: their spikes, `(trial, afferent)`.
    n_firing: trials with a spike. n_at_floor, n_intervals: ISIs at the refractory floor, and all.
    """

    shares: np.ndarray
    counts: np.ndarray
    n_firing: int
    n_at_floor: int
    n_intervals: int


def _fire(excerpts: Excerpts, spec: AfferentSpec) -> Iterator[Fired]:
    """Both populations, in the order of `POPULATIONS`; trials are encoded in groups."""
    parts: dict[str, list[Fired]] = {part: [] for part in POPULATIONS}
    edges = {part: _edges(excerpts, spec, part) for part in POPULATIONS}
    for signal, n_steps in _side_by_side(excerpts.signals):
        spikes, _ = encode(signal, excerpts.sampling_rate_Hz, spec)
        spikes[np.arange(signal.shape[1]) >= n_steps[:, None]] = 0
        events = events_of_raster(spikes)
        counts, isi = spike_counts(events), isis_ms(events, 1e3)  # at 1 kHz an ISI in ms is its number of steps
        n_sa1 = excerpts.n_channels * len(spec.sa1.gains)
        for part, first, last in zip(POPULATIONS, (0, n_sa1), (n_sa1, spikes.shape[2]), strict=True):
            mine = (isi.afferent >= first) & (isi.afferent < last)
            isi_steps = Intervals(isi.trial[mine], isi.afferent[mine] - first, isi.isi_ms[mine])
            of_part = counts[:, first:last]
            neuron = spec.neuron(getattr(spec, part), excerpts.sampling_rate_Hz)
            parts[part].append(
                Fired(
                    shares=shares_of(isi_steps, of_part.shape, edges[part]),
                    counts=of_part,
                    n_firing=int(of_part.any(axis=1).sum()),
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


def _edges(excerpts: Excerpts, spec: AfferentSpec, part: str) -> np.ndarray:
    """The bins of a population's ISIs, in steps."""
    neuron = spec.neuron(getattr(spec, part), excerpts.sampling_rate_Hz)
    return bin_edges(neuron.refractory_steps + 1, max(excerpts.signals.lengths))


def _candidates(excerpts: Excerpts, spec: AfferentSpec, rule: CalibrationRule) -> dict[str, list[float]]:
    """Candidate gains of each population, from slightly below the gain whose strongest drive reaches threshold."""
    grids = {}
    for part, (drive, n_values) in drives(excerpts, spec).items():
        strongest = _strongest((x.ravel() for x in drive), n_values)
        if strongest <= 0:
            raise InputError(
                f"{excerpts.source}: the conditioned training trials never drive {POPULATIONS[part]} afferents; check "
                "the encoder's baseline and the columns that were read"
            )
        first = (spec.v_threshold_mV - spec.v_rest_mV) / strongest / rule.step**STEPS_BELOW
        grids[part] = [float(f"{first * rule.step**k:.3g}") for k in range(rule.candidates)]
    return grids


def drives(excerpts: Excerpts, spec: AfferentSpec) -> dict[str, tuple[Iterator[np.ndarray], int]]:
    """The drive of each type with a gain of 1, trial by trial `(time, taxel)`, and the number of values.

    For SA-I of both polarities, and RA-I of both signs of change, the magnitude: it drives one of the two.
    """
    per_ms = excerpts.sampling_rate_Hz * 1e-3
    n_values = excerpts.n_channels * sum(excerpts.signals.lengths)

    def of_sa1(x: np.ndarray) -> np.ndarray:
        level = np.abs(x) if spec.sa1.opposite else x
        if not spec.sa1.rate_ms:
            return level
        rise = np.maximum(np.diff(level, axis=0, prepend=level[:1]), 0)
        return level + np.float32(spec.sa1.rate_ms * per_ms) * rise

    def of_ra1(x: np.ndarray) -> np.ndarray:
        change = np.diff(x, axis=0) * per_ms
        if spec.ra1.change in ("on", "off"):
            return np.maximum(change if spec.ra1.change == "on" else -change, 0)
        return np.abs(change)

    return {
        "sa1": (map(of_sa1, excerpts.signals), n_values),
        "ra1": (map(of_ra1, excerpts.signals), n_values - excerpts.n_channels * len(excerpts.signals)),
    }


def _strongest(drive: Iterable[np.ndarray], n_values: int) -> float:
    """The `STRONGEST` percentile of `n_values` numbers that arrive in parts, or their maximum if it is not positive.

    As in `np.percentile`, linear between two of the numbers; only those from there upwards are kept.
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

    If no gain satisfies both limits, the limit on silent trials is dropped: of the gains that satisfy the other, those
    with the fewest silent trials are kept. A class may be rest, and silence then identifies it.
    Raises InputError if every gain that gives spikes puts too many ISIs at the refractory floor.
    """
    good = table[table.admissible]
    if good.empty:
        firing = table[table.silent_share < 1]
        if firing.empty:
            raise InputError(
                f"{where}: no gain tried gives a spike; check the columns that were read and the encoder's tau_mem_ms"
            )
        good = firing[firing.floor_share <= rule.max_floor_share]
        if good.empty:
            raise InputError(
                f"{where}: every gain that gives spikes puts {firing.floor_share.min():.1%} or more of the ISIs at the "
                f"refractory floor, above max_floor_share = {rule.max_floor_share:.1%}; check the columns that "
                "were read, or give the encoder a longer tau_mem_ms"
            )
        good = good[good.silent_share == good.silent_share.min()]
    best = good.separation.max()
    return int(good.index[good.separation >= best - rule.tie * abs(best)][0])


def _n_at_floor(isi_steps: np.ndarray, neuron: LIF) -> int:
    """Number of intervals in which charging took one step, or at most FLOOR_OF_TAU of tau_mem."""
    with np.errstate(divide="ignore"):  # a membrane without leak gives an infinite share
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
