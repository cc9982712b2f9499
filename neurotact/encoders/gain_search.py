"""The spikes of each population at each candidate gain (or threshold), and the choice of the gain.

Too high, and all inter-spike intervals (ISIs) crowd at the refractory period; too low, and afferents fall silent.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from neurotact.data.spikes import populations_of
from neurotact.data.spool import Spool
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.excerpts import Excerpts, draw, liveliest, permuted
from neurotact.encoders.model import DrivenSpec, EncoderSpec, of_name
from neurotact.encoders.sensitivity import Sensitivity, adjusted, sensitivities_of, value_of
from neurotact.encoders.specs import afferent_names
from neurotact.encoders.tally import Asked, Groups
from neurotact.errors import InputError
from neurotact.metrics.decision import is_within
from neurotact.metrics.isi_distributions import bin_edges, separation, shares_of
from neurotact.spec import Spec

STRONGEST, STEPS_BELOW = 99.9, 3
"""The search begins `STEPS_BELOW` steps below the gain at which this percentile of the drive just reaches threshold."""

STRIDE = 4
"""Every so many candidates are tried until few trials are silent."""
LEAST_FACTOR = 4.0**-12
"""Of a sensitivity's own value: where a search for silence ends."""
NEAREST = 0.01
"""A rate within this share of the one asked for is found."""
SLOW_TRIALS, SLOW_TAXELS, SLOW_s = 128, 16, 1.0
"""Trials, taxels and seconds of each trial, at most, for neurons that run step by step in Python."""
SEARCHED = 1
"""Tells the draw of the trials that are searched from the other draws of a calibration's seed."""

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
    searched_taxels: int = Field(default=32, ge=1)
    """Maximum number of those taxels on which the gains are searched; all if they are searched for a rate."""
    searched: int = Field(default=8192, ge=1)
    """Maximum number of trials times taxels on which they are searched; each class has two trials or more."""
    every: bool = False
    """Try every candidate, also those that would not be chosen, as a figure of the search shows them."""
    shuffles: int = Field(default=8, ge=1)
    """Random permutations of the labels; their separation is the chance level."""
    seed: int = Field(default=0, ge=0)
    """Random seed of trials, stretches and permutations."""
    spikes_per_s: float | None = Field(default=None, gt=0)
    """Fit each gain or threshold to this rate of an afferent, in place of the separation of classes: encoders with as
    many afferents then spend as many spikes."""


def suited_rule(spec: EncoderSpec, rule: CalibrationRule, n_classes: int) -> CalibrationRule:
    """The rule with as few trials, taxels and seconds as an encoder of this speed can search with in a minute.

    A model that repeats its spikes (`Model.repeats`) has no limit of intervals at the refractory floor.
    """
    if isinstance(spec, AfferentSpec):
        return rule
    if of_name(spec.model).repeats:
        rule = rule.model_copy(update={"max_floor_share": 1.0})
    less = {
        "trials_per_class": min(rule.trials_per_class, max(2, SLOW_TRIALS // n_classes)),
        "taxels": min(rule.taxels, SLOW_TAXELS),
        "excerpt_s": min(rule.excerpt_s, SLOW_s),
    }
    return rule.model_copy(update=less)


def part_of(excerpts: Excerpts, rule: CalibrationRule) -> Excerpts:
    """The excerpts on which gains are searched: of as many trials and taxels as the rule allows.

    The trials are drawn with the rule's seed; the taxels are the liveliest, unless a rate is searched, which is that of
    all. What is few already is returned as it is.
    """
    signals, labels, n_taxels = excerpts.signals, excerpts.labels, excerpts.n_channels
    is_wide = n_taxels > rule.searched_taxels and rule.spikes_per_s is None
    n_trials = rule.searched // (rule.searched_taxels if is_wide else n_taxels)
    rng, numbers = np.random.default_rng([rule.seed, SEARCHED]), excerpts.numbers
    kept = draw(labels, max(2, n_trials // len(excerpts.classes)), rng, numbers)
    if len(kept) == len(labels) and not is_wide:
        return excerpts
    chosen = slice(None)
    if is_wide:
        chosen = liveliest((signals[trial] for trial in kept.tolist()), rule.searched_taxels)
    part = Spool(signals[trial][:, chosen] for trial in kept.tolist())
    return replace(excerpts, signals=part, labels=labels[kept], numbers=None if numbers is None else numbers[kept])


def rates_of(
    excerpts: Excerpts, spec: EncoderSpec, values: Mapping[Sensitivity, float] | None = None
) -> dict[str, np.ndarray]:
    """Spikes per second of each trial and afferent, `(trial, afferent)`, by the name of each sensitivity.

    values: of the sensitivities, with one grade; if absent, the encoder is as it is, with all its grades.
    """
    sensitivities = sensitivities_of(spec)
    fired = _fire(_prepared(excerpts, spec), spec if values is None else _with(spec, values), sensitivities)
    return {
        sensitivity.name: _per_second(excerpts, spikes)
        for sensitivity, spikes in zip(sensitivities, fired, strict=True)
    }


def _per_second(excerpts: Excerpts, fired: "Fired") -> np.ndarray:
    n_seconds = np.array(excerpts.signals.lengths) / excerpts.sampling_rate_Hz
    return (fired.counts / n_seconds[:, None]).astype(np.float32)


class _Prepared(NamedTuple):
    """Excerpts, and their signals in groups."""

    excerpts: Excerpts
    groups: Groups


def _prepared(excerpts: Excerpts, spec: EncoderSpec) -> _Prepared:
    return _Prepared(excerpts, Groups(excerpts.signals, _clock(excerpts, spec) / excerpts.sampling_rate_Hz))


_ISI = tuple[str, float, np.ndarray, list[np.ndarray]]
"""The afferent, its gain, the edges of the bins in ms, and the share of each bin in each class."""
Tried = dict[tuple[str, str], tuple[dict[str, Any], _ISI, np.ndarray]]
"""A population at one gain, by what decides its spikes: its row of `Calibration.table`, its ISIs, and its rates."""


class _Searched(NamedTuple):
    """Each population at each candidate gain.

    table: `Calibration.table`, before the choice. isi: `Calibration.isi`.
    rates: spikes per second of each trial and afferent, `(trial, afferent)`, by the afferent's name and its gain.
    """

    table: pd.DataFrame
    isi: pd.DataFrame
    rates: dict[tuple[str, float], np.ndarray]


def search(
    excerpts: Excerpts,
    spec: EncoderSpec,
    rule: CalibrationRule,
    rng: np.random.Generator,
    progress: Progress | None,
    known: Tried | None = None,
) -> _Searched:
    """The spikes of each population at each candidate gain (`_ascend`).

    known: what was tried on the same trials, by what decides the spikes; those are not computed again, and what is
        tried is added. Polarities have the same RA-I.
    """
    n_seconds, labels = np.array(excerpts.signals.lengths) / excerpts.sampling_rate_Hz, excerpts.labels
    labellings = [labels, *permuted(labels, rule.shuffles, rng, excerpts.numbers)]
    sensitivities = sensitivities_of(spec)
    edges = [_edges(excerpts, spec, sensitivity) for sensitivity in sensitivities]
    known = {} if known is None else known
    found: dict[tuple[str, float], tuple[dict[str, Any], _ISI, np.ndarray]] = {}
    prepared = _prepared(excerpts, spec)

    def tried(values: Sequence[float], of: Sequence[Sensitivity] = sensitivities) -> list[dict[str, Any]]:
        """The rows of these values of each sensitivity, or of some (`of`), which are added to the tables."""
        encoder = _with(spec, dict(zip(sensitivities, values, strict=True)))
        keys = {one: _alone(encoder, one) for one in of}
        new = [one for one in of if keys[one] not in known]
        for sensitivity, fired in zip(new, _fire(prepared, encoder, new), strict=False):  # nothing is fired for none
            place = sensitivities.index(sensitivity)
            value, steps = values[place], edges[place]
            row = {
                "afferent": sensitivity.name,
                "gain": value,
                "silent_share": float(1 - fired.n_firing / len(labels)),
                "floor_share": fired.n_at_floor / fired.n_intervals if fired.n_intervals else 0.0,
                "separation": separation(fired.shares, labellings),
                "spikes_per_s": float(fired.counts.sum() / (n_seconds.sum() * fired.counts.shape[1])),
            }
            of_trials = fired.shares.mean(axis=1)
            of_classes = [of_trials[labels == label].mean(axis=0) for label in range(len(excerpts.classes))]
            isi = sensitivity.name, value, steps / _clock(excerpts, spec) * 1e3, of_classes
            known[keys[sensitivity]] = row, isi, _per_second(excerpts, fired)
        rows = [known[key][0] for key in keys.values()]
        found.update({(row["afferent"], row["gain"]): known[key] for row, key in zip(rows, keys.values(), strict=True)})
        return rows

    def advance(n: int, values: Sequence[float]) -> None:
        pairs = zip(sensitivities, values, strict=True)
        note = ", ".join(f"{sensitivity.name} {value:g}" for sensitivity, value in pairs)
        if progress:
            for _ in range(n):
                progress(1, note)

    if rule.spikes_per_s is not None:
        _to_rate(spec, rule, tried, advance)
    elif isinstance(spec, DrivenSpec):
        _ascend([*_candidates(prepared, spec, rule).values()], sensitivities, rule, tried, advance)
    else:
        _ascend(_from_silence(prepared, spec, rule), sensitivities, rule, tried, advance)
    places = {
        sensitivity.name: (order, -1 if sensitivity.is_threshold else 1)
        for order, sensitivity in enumerate(sensitivities)
    }
    rows, isi, rates = zip(*found.values(), strict=True)
    table = pd.DataFrame(rows)
    column, sign = (table.afferent.map({name: pair[i] for name, pair in places.items()}) for i in (0, 1))
    table = table.iloc[np.lexsort([sign * table.gain, column])].reset_index(drop=True)  # from few spikes to many
    within = (table.silent_share <= rule.max_silent_share) & (table.floor_share <= rule.max_floor_share)
    shares = _isi_table(isi, excerpts.classes)
    return _Searched(table.assign(admissible=within, chosen=False), shares, dict(zip(found, rates, strict=True)))


def _alone(spec: EncoderSpec, sensitivity: Sensitivity) -> tuple[str, str]:
    """What decides the spikes of a sensitivity's afferents, on the same trials."""
    others = {"sa1", "ra1"} - {sensitivity.part} if isinstance(spec, AfferentSpec) else set[str]()
    return sensitivity.name, spec.model_dump_json(exclude=others)


def _with(spec: EncoderSpec, values: Mapping[Sensitivity, float]) -> EncoderSpec:
    """The encoder whose spikes are counted, with its sensitivities at these values."""
    if isinstance(spec, DrivenSpec):
        tried = spec.for_search
        for sensitivity, value in values.items():
            tried = tried.at_gain(sensitivity.part, value)
        return tried
    for sensitivity, value in values.items():
        spec = adjusted(spec, sensitivity, value)
    return spec


def _ascend(
    candidates: Sequence[Sequence[float]],
    sensitivities: Sequence[Sensitivity],
    rule: CalibrationRule,
    tried: Callable[[Sequence[float], Sequence[Sensitivity]], list[dict[str, Any]]],
    progress: Callable[[int, Sequence[float]], None],
) -> None:
    """Try the candidates of each sensitivity that may be chosen (`following`), those of one place together."""
    steps, n_done = list(zip(*candidates, strict=True)), 0
    known: dict[Sensitivity, dict[int, Mapping[str, Any]]] = {sensitivity: {} for sensitivity in sensitivities}
    while True:
        wanted = {one: place for one, rows in known.items() if (place := following(rows, rule)) is not None}
        if not wanted:
            return progress(len(steps) - n_done, steps[-1])
        place = min(wanted.values())
        together = [one for one in sensitivities if wanted.get(one) == place]
        for one, row in zip(together, tried(steps[place], together), strict=True):
            known[one][place] = row
        if n_done < len(steps):
            progress(1, steps[place])
            n_done += 1


def following(rows: Mapping[int, Mapping[str, Any]], rule: CalibrationRule) -> int | None:
    """The place of the candidate to try next, from few spikes to many; None if no other one would be chosen.

    With more spikes fewer trials are silent, and more intervals are at the refractory floor: what is below a candidate
    that leaves too many silent is not tried, nor what is above one that crowds too many there, unless none satisfies
    both limits. The most crowded ones have most of the spikes to compute.
    rows: of those that were tried, by their place.
    """
    last, most = rule.candidates - 1, rule.max_floor_share
    top = max(rows, default=-1)
    if rule.every:
        return top + 1 if top < last else None
    awake = [place for place, row in rows.items() if row["silent_share"] <= rule.max_silent_share]
    if not awake and top < last:
        return min(top + (STRIDE if rows else 2 * STRIDE), last)  # at the first ones hardly anything fires
    if awake and (below := min(awake) - 1) >= 0 and below not in rows:
        return below
    if awake and top < last and rows[top]["floor_share"] <= most:
        return top + 1
    if any(rows[place]["floor_share"] <= most for place in awake):
        return None
    return max(set(range(top)) - {*rows}, default=None)


def _to_rate(
    spec: EncoderSpec,
    rule: CalibrationRule,
    tried: Callable[[Sequence[float]], list[dict[str, Any]]],
    progress: Callable[[int, Sequence[float]], None],
) -> None:
    """Try values that come nearer and nearer to the rate: steps of 8 until it is passed, then halves in logarithms.

    It ends where a value of each sensitivity is within `NEAREST` of the rate, and after `rule.candidates` steps.
    """
    sensitivities, wanted = sensitivities_of(spec), rule.spikes_per_s or 0.0
    are_near = [False] * len(sensitivities)
    logs = [
        math.log(value_of(spec, sensitivity)) * (-1 if sensitivity.is_threshold else 1) for sensitivity in sensitivities
    ]
    below, above = [-math.inf] * len(sensitivities), [math.inf] * len(sensitivities)
    for _ in range(rule.candidates):
        values = [
            float(f"{math.exp(-x if sensitivity.is_threshold else x):.4g}")
            for sensitivity, x in zip(sensitivities, logs, strict=True)
        ]
        for i, row in enumerate(tried(values)):
            rate = row["spikes_per_s"]
            below[i], above[i] = (logs[i], above[i]) if rate < wanted else (below[i], logs[i])
            is_between = math.isfinite(below[i]) and math.isfinite(above[i])
            step = math.log(8) if rate < wanted else -math.log(8)
            logs[i] = (below[i] + above[i]) / 2 if is_between else logs[i] + step
            are_near[i] |= abs(rate / wanted - 1) <= NEAREST
        progress(1, values)
        if all(are_near):
            return


def _from_silence(prepared: _Prepared, spec: EncoderSpec, rule: CalibrationRule) -> list[list[float]]:
    """Candidate values of each sensitivity, from the largest power of 4 times its own at which no afferent fires."""
    sensitivities, gains = sensitivities_of(spec), []

    def fires(sensitivity: Sensitivity, factor: float) -> bool:
        value = value_of(spec, sensitivity) * (1 / factor if sensitivity.is_threshold else factor)
        every = _fire(prepared, adjusted(spec, sensitivity, value), sensitivities)
        return (
            next(fired for other, fired in zip(sensitivities, every, strict=True) if other == sensitivity).n_firing > 0
        )

    for sensitivity in sensitivities:
        factor = 1.0
        while fires(sensitivity, factor) and factor > LEAST_FACTOR:
            factor /= 4
        while not fires(sensitivity, 4 * factor):
            factor *= 4
            if factor > 1 / LEAST_FACTOR:
                raise InputError(
                    f"{prepared.excerpts.source}: the conditioned training trials never drive {sensitivity.name} "
                    "afferents; check the encoder's baseline and the columns that were read"
                )
        first, step = value_of(spec, sensitivity), rule.step
        first, step = (first / factor, 1 / step) if sensitivity.is_threshold else (first * factor, step)
        gains.append([float(f"{first * step**k:.3g}") for k in range(rule.candidates)])
    return gains


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


def _fire(prepared: _Prepared, spec: EncoderSpec, sensitivities: Sequence[Sensitivity]) -> Iterator[Fired]:
    """The afferents of each sensitivity, in the order of the encoder's output; trials are encoded in groups."""
    excerpts, groups = prepared
    clock_Hz = _clock(excerpts, spec)
    of_each = populations_of(afferent_names([""] * excerpts.n_channels, spec.model_dump()))
    asked = [
        Asked(
            sensitivity.part,
            of_each[sensitivity.populations[0]][0],
            of_each[sensitivity.populations[-1]][-1] + 1,
            _edges(excerpts, spec, sensitivity),
            _floor_steps(spec, sensitivity, clock_Hz),
        )
        for sensitivity in sensitivities
    ]
    of_groups = zip(*(group.tallies(spec, excerpts.sampling_rate_Hz, asked) for group in groups), strict=True)
    for parts in of_groups:
        intervals, counts = (np.concatenate([getattr(part, key) for part in parts]) for key in ("intervals", "counts"))
        yield Fired(
            shares=shares_of(intervals),
            counts=counts,
            n_firing=int(counts.any(axis=1).sum()),
            n_at_floor=sum(int(part.at_floor.sum()) for part in parts),
            n_intervals=int(intervals.sum()),
        )


def _edges(excerpts: Excerpts, spec: EncoderSpec, sensitivity: Sensitivity) -> np.ndarray:
    """The bins of the ISIs of a sensitivity's afferents, in steps."""
    clock_Hz = _clock(excerpts, spec)
    longest = round(max(excerpts.signals.lengths) * clock_Hz / excerpts.sampling_rate_Hz)
    return bin_edges(_least_isi_steps(spec, sensitivity, clock_Hz), longest)


def _clock(excerpts: Excerpts, spec: EncoderSpec) -> float:
    """Steps per second of the spikes."""
    return spec.conditioning.clock_Hz(excerpts.sampling_rate_Hz)


def _least_isi_steps(spec: EncoderSpec, sensitivity: Sensitivity, sampling_rate_Hz: float) -> int:
    """The shortest inter-spike interval of a sensitivity's afferents."""
    if isinstance(spec, DrivenSpec):
        return spec.least_isi_steps(sensitivity.part, sampling_rate_Hz)
    period_ms = getattr(getattr(spec, sensitivity.part) if sensitivity.part else spec, "t_ref_ms", 0.0)
    return math.ceil(period_ms * 1e-3 * sampling_rate_Hz - 1e-9) + 1


def _floor_steps(spec: EncoderSpec, sensitivity: Sensitivity, sampling_rate_Hz: float) -> int:
    """The longest interval that counts as at the refractory floor; the shortest possible, if a model has no other."""
    if isinstance(spec, DrivenSpec):
        return spec.floor_steps(sensitivity.part, sampling_rate_Hz)
    return _least_isi_steps(spec, sensitivity, sampling_rate_Hz)


def _candidates(prepared: _Prepared, spec: DrivenSpec, rule: CalibrationRule) -> dict[str, list[float]]:
    """Candidate gains of each population, from slightly below the gain whose strongest drive reaches threshold."""
    grids, names = {}, {sensitivity.part: sensitivity.name for sensitivity in sensitivities_of(spec)}
    for part, (drive, n_values) in drives(prepared.groups.signals, prepared.excerpts.sampling_rate_Hz, spec).items():
        strongest = _strongest((x.ravel() for x in drive), n_values)
        if strongest <= 0:
            raise InputError(
                f"{prepared.excerpts.source}: the conditioned training trials never drive {names[part]} afferents; "
                "check the encoder's baseline and the columns that were read"
            )
        first = spec.least_drive(part) / strongest / rule.step**STEPS_BELOW
        grids[part] = [float(f"{first * rule.step**k:.3g}") for k in range(rule.candidates)]
    return grids


def drives(
    signals: Sequence[np.ndarray], rate_Hz: float, spec: DrivenSpec
) -> dict[str, tuple[Iterator[np.ndarray], int]]:
    """The drive of each type with a gain of 1, trial by trial `(time, taxel)`, and the number of values."""
    n_samples, first = sum(map(len, signals)), signals[0]

    def of(part: str) -> tuple[Iterator[np.ndarray], int]:
        n_lost = len(first) - len(spec.felt(part, first, rate_Hz))
        n_values = (n_samples - n_lost * len(signals)) * first.shape[1]
        return (spec.felt(part, x, rate_Hz) for x in signals), n_values

    return {sensitivity.part: of(sensitivity.part) for sensitivity in sensitivities_of(spec)}


def _strongest(drive: Iterable[np.ndarray], n_values: int) -> float:
    """The `STRONGEST` percentile of `n_values` numbers that arrive in parts, or their maximum if it is not positive.

    As in `np.percentile`, linear between two of the numbers; only those from there upwards are kept.
    """
    if n_values == 0:
        return 0.0
    rank = (n_values - 1) * float(np.true_divide(STRONGEST, 100))
    below = int(rank)
    n_kept = n_values - below
    top, least = np.empty(0, np.float32), -math.inf
    for part in drive:
        top = np.concatenate([top, part[part > least]])
        if len(top) > 2 * n_kept:  # rarely, as a partition takes longer than all else here
            top = np.partition(top, len(top) - n_kept)[len(top) - n_kept :]
            least = float(top.min())
    top = np.sort(top)[-n_kept:]
    low, high, share = top[0], top[min(1, len(top) - 1)], rank - below
    strongest = high - (high - low) * (1 - share) if share >= 0.5 else low + (high - low) * share
    return float(strongest if strongest > 0 else top[-1])


def choose(table: pd.DataFrame, rule: CalibrationRule, where: str, sensitivity: str = "gain") -> int:
    """Index of the chosen row of one population; sensitivity: what is chosen, a gain or a threshold.

    If no gain satisfies both limits, the limit on silent trials is dropped: of the gains that satisfy the other, those
    with the fewest silent trials are kept. A class may be rest, and silence then identifies it.
    Raises InputError if every gain that gives spikes puts too many ISIs at the refractory floor.
    """
    if rule.spikes_per_s is not None:
        return int((np.log(np.maximum(table.spikes_per_s, 1e-9)) - math.log(rule.spikes_per_s)).abs().idxmin())
    good = table[table.admissible]
    if good.empty:
        firing = table[table.silent_share < 1]
        if firing.empty:
            raise InputError(
                f"{where}: no {sensitivity} tried gives a spike; check the columns that were read and the encoder's "
                "time constants"
            )
        good = firing[firing.floor_share <= rule.max_floor_share]
        if good.empty:
            raise InputError(
                f"{where}: every {sensitivity} that gives spikes puts {firing.floor_share.min():.1%} or more of the "
                f"ISIs at the refractory floor, above max_floor_share = {rule.max_floor_share:.1%}; check the columns "
                "that were read, or give the encoder longer time constants"
            )
        good = good[good.silent_share == good.silent_share.min()]
    best = good.separation.max()
    return int(good.index[is_within(good.separation, best, rule.tie * abs(best))][0])


def _isi_table(tried: Iterable[_ISI], classes: Sequence[str]) -> pd.DataFrame:
    """`Calibration.isi`: a row for each bin, class and value of a sensitivity."""
    rows = [
        (name, isi_ms, share, afferent, gain)
        for afferent, gain, edges_ms, of_classes in tried
        for name, shares in zip(classes, of_classes, strict=True)
        for isi_ms, share in zip([*np.sqrt(edges_ms[1:] * edges_ms[:-1]), np.inf], shares, strict=True)
    ]
    return pd.DataFrame(rows, columns=["label", "isi_ms", "share", "afferent", "gain"])
