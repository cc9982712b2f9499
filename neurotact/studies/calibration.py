"""Gains of an encoder for another sensor, from training trials (`docs/calibration.md`).

The texture paper (Sec. III-A) weighs gains by the inter-spike intervals (ISIs) of its gratings: too high, and all
ISIs crowd at the refractory period, where the gratings overlap; too low, and afferents fall silent. Here that is a
rule: among the gains with few silent trials and few ISIs at the floor, the one whose ISI distributions separate the
classes best. No classifier is trained, and no trial but those given is seen.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from pydantic import Field
from scipy.special import entr

from neurotact.data.conditioning import Baseline, condition, fit_standardisation
from neurotact.data.recordings import Recordings
from neurotact.encoders.afferents import AfferentSpec, ConditioningSpec, encode
from neurotact.errors import InputError
from neurotact.metrics.isi_distributions import bin_edges
from neurotact.metrics.spike_trains import Intervals, events_of_raster, isis_ms
from neurotact.neurons import LIF
from neurotact.spec import Spec

POPULATIONS = {"sa1": "SA-I", "ra1": "RA-I"}
CLOCK_HZ = 1000.0
"""A clock that can express a refractory period of 1 ms."""
FLOOR_OF_TAU = 0.1
"""To charge within this share of tau_mem takes 10.5 times the drive that just fires: such an ISI is mostly t_ref."""
STRONGEST, STEPS_BELOW = 99.9, 3
"""The search begins so many steps below the gain at which this percentile of the drive just reaches threshold."""
REST_SD = 2.0
"""Where no baseline is taken off, a taxel's rest is so many standard deviations below its mean level."""
QUIET = 0.1
"""A taxel that deviates less than this share of the liveliest one is noise, or out of touch."""
ROUNDING = 1e-5
"""Movements below this share of a taxel's level are float32's own."""

log = logging.getLogger("neurotact")
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
    """At most so many trials of each class are looked at, drawn at random."""
    excerpt_s: float = Field(default=2.0, gt=0)
    """Of each of them, at most so long a stretch, at a random place."""
    shuffles: int = Field(default=8, ge=1)
    """Random labellings of the trials; how far they separate is the separation that means nothing."""
    seed: int = Field(default=0, ge=0)
    """Of trials, stretches and shuffles."""


@dataclass(frozen=True)
class Calibration:
    """An encoder for a sensor, and why it has these gains.

    encoder: the fitted spec, for recordings of the unit, taxels and rate that it was fitted on.
    table: a row a population and candidate gain: `afferent` ("SA-I", "RA-I"), `gain` (mV per standard deviation, or
        mV per standard deviation per ms), `silent_share`, `floor_share`, `separation` (bit), `spikes_per_s` (of one
        afferent), `admissible`, `chosen`.
    isi: a row a population, gain, label and bin: `afferent`, `gain`, `label`, `isi_ms` (the bin's geometric middle,
        infinite for trials without an interval), `share`, over trials and afferents.
    notes: what was changed of the spec, and what else one should know.
    """

    encoder: AfferentSpec
    table: pd.DataFrame
    isi: pd.DataFrame
    notes: tuple[str, ...]


def calibrate(
    recordings: Recordings,
    spec: AfferentSpec,
    progress: Progress | None = None,
    rule: CalibrationRule = CalibrationRule(),
) -> Calibration:
    """Fit standardisation and gains of `spec` on training trials as recorded, of any unit and rate.

    The spec's smoothing, clock and baseline stay, but for what the recordings cannot take: an EMA whose cut-off is
    not below their Nyquist frequency is dropped, and a recording below 1 kHz without `resample_Hz` gets a 1 kHz clock.
    Then each taxel is scaled by its standard deviation, and the gain of each population is searched by itself. The
    same trials, spec and rule give the same encoder.

    progress: called with 1 and a note at each of the `rule.candidates` steps.
    Raises InputError for less than two classes, for signals that never move, and where no gain keeps both limits.

    >>> from neurotact.spec import build
    >>> time_s, rng = np.arange(0, 1, 1e-3)[:, None], np.random.default_rng(0)
    >>> slide = lambda f: np.sin(2 * np.pi * f * time_s + rng.uniform(0, 6)) + rng.normal(0, 0.1, time_s.shape)
    >>> trials = Recordings([slide(f) for f in (2, 2, 2, 8, 8, 8)], 1000.0, "count",
    ...                     pd.DataFrame({"label": [*"aaabbb"]}))
    >>> start = build(AfferentSpec, {"sa1": {"gain": 1}, "ra1": {"gain": 1}}, "an example")
    >>> fitted = calibrate(trials, start, rule=CalibrationRule(candidates=16))
    >>> fitted.encoder.unit, fitted.table[fitted.table.chosen].afferent.tolist()
    ('count', ['SA-I', 'RA-I'])
    """
    if len(recordings.classes) < 2:
        raise InputError(
            f"{_source(recordings)}: holds one class, '{''.join(recordings.classes)}', and gains are chosen by how "
            "well they separate classes; give training trials of at least two"
        )
    rng = np.random.default_rng(rule.seed)
    conditioning, notes = _suited(spec.conditioning, recordings)
    drawn = recordings.select(_draw(recordings.labels, rule.trials_per_class, rng))
    excerpts = _excerpts(drawn, conditioning, rule.excerpt_s, rng)
    offset, scale, quiet = _standardisation(drawn, excerpts, conditioning.baseline)
    conditioning = conditioning.model_copy(update={"offset": offset, "scale": scale})
    fitted = spec.model_copy(update={"unit": recordings.unit, "conditioning": conditioning})
    felt = condition(excerpts, offset=offset, scale=scale, rectify=conditioning.rectify)

    table, isi = _search(felt, fitted, rule, rng, progress)
    chosen = {}
    for part, afferent in POPULATIONS.items():
        mine = table.afferent == afferent
        best = _choose(table[mine], rule, f"{_source(recordings)}: {afferent}")
        table.loc[best, "chosen"] = True
        gain = float(table.gain[best])
        chosen[part] = getattr(spec, part).model_copy(update={"gain": gain})
        if gain == table.gain[mine].max():
            notes.append(f"{afferent}: the chosen gain is the largest tried; more candidates may find a better one")
    if quiet:
        notes.append(f"{', '.join(quiet)}: move less than a tenth of the liveliest taxel and are scaled as if a tenth")
    for note in notes:
        log.warning("%s: %s", _source(recordings), note)
    return Calibration(fitted.model_copy(update=chosen), table, isi, tuple(notes))


def _suited(conditioning: ConditioningSpec, recordings: Recordings) -> tuple[ConditioningSpec, list[str]]:
    """Conditioning that recordings of this rate can take, without standardisation, and what was changed."""
    rate_Hz, notes = recordings.sampling_rate_Hz, []
    change: dict[str, float | None] = {"offset": None, "scale": None}
    cutoff_Hz = conditioning.ema_cutoff_Hz
    if cutoff_Hz is not None and cutoff_Hz >= rate_Hz / 2:
        change["ema_cutoff_Hz"] = None
        notes.append(f"the EMA at {cutoff_Hz:g} Hz is left out: {rate_Hz:g} Hz recordings end at {rate_Hz / 2:g} Hz")
    if conditioning.resample_Hz is None and rate_Hz < CLOCK_HZ:
        change["resample_Hz"] = CLOCK_HZ
        notes.append(f"the clock is {CLOCK_HZ:g} Hz: at {rate_Hz:g} Hz a refractory period of 1 ms cannot be told")
    return conditioning.model_copy(update=change), notes


def _draw(labels: np.ndarray, per_class: int, rng: np.random.Generator) -> np.ndarray:
    """At most `per_class` trials of each class, at random; sorted indices."""
    trials = (rng.permutation(np.flatnonzero(labels == label))[:per_class] for label in np.unique(labels))
    return np.sort(np.concatenate(list(trials)))


def _excerpts(
    recordings: Recordings, conditioning: ConditioningSpec, longest_s: float, rng: np.random.Generator
) -> Recordings:
    """A stretch of each trial, at a random place; conditioned before it is cut, as an encoder sees it."""
    signals, rate_Hz = [], recordings.sampling_rate_Hz
    steps = conditioning.model_dump(exclude={"offset", "scale", "rectify"})
    for trial in range(len(recordings)):
        whole = condition(recordings.select(np.array([trial])), **steps)
        rate_Hz, signal = whole.sampling_rate_Hz, whole.signals[0]
        length = min(len(signal), max(1, round(longest_s * rate_Hz)))
        start = int(rng.integers(len(signal) - length + 1))
        signals.append(signal[start : start + length])
    return replace(recordings, signals=signals, sampling_rate_Hz=rate_Hz)


def _standardisation(
    recorded: Recordings, excerpts: Recordings, baseline: Baseline
) -> tuple[tuple[float, ...] | None, tuple[float, ...], tuple[str, ...]]:
    """`(offset, scale, quiet taxels)` of the excerpts; a quiet taxel's noise is not blown up to full size.

    A baseline already says where each trial's zero is, so that nothing more is subtracted. Without one, the level
    itself is what SA-I feels: counted from the mean, it would silence SA-I in every trial of less than mean pressure.
    """
    mean, scale = (np.array(values) for values in fit_standardisation(list(excerpts.signals)))
    reach = np.max([np.abs(x - mean).max(axis=0) for x in excerpts.signals], axis=0)
    level = np.max([np.abs(x).max(axis=0) for x in recorded.signals], axis=0)
    still = reach <= ROUNDING * level
    if still.all():
        raise InputError(
            f"{_source(recorded)}: the training trials never move once they are conditioned, so there is nothing to "
            "calibrate on; check the sensor, the columns that were read and the encoder's baseline"
        )
    liveliest = scale[~still].max()
    quiet = still | (scale < QUIET * liveliest)
    scale = np.where(quiet, QUIET * liveliest, scale)
    offset = _short(np.where(quiet, mean, mean - REST_SD * scale)) if baseline == "none" else None
    return offset, _short(scale), tuple(np.array(recorded.channels)[quiet].tolist())


def _search(
    felt: Recordings, spec: AfferentSpec, rule: CalibrationRule, rng: np.random.Generator, progress: Progress | None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """`Calibration.table`, nothing chosen yet, and `Calibration.isi`: both populations at each candidate gain."""
    n_steps = np.array([len(x) for x in felt.signals])
    signal = np.zeros((len(felt), n_steps.max(), felt.n_channels), np.float32)
    for padded, x in zip(signal, felt.signals, strict=True):
        padded[: len(x)] = x
    after_end = np.arange(signal.shape[1]) >= n_steps[:, None]
    rate_Hz, labels = felt.sampling_rate_Hz, felt.labels
    labellings = [labels, *(rng.permutation(labels) for _ in range(rule.shuffles))]
    grids = _candidates(felt, spec, rule)
    rows, isi = [], []
    for gains in zip(*grids.values(), strict=True):
        tried = {part: getattr(spec, part).model_copy(update={"gain": g}) for part, g in zip(grids, gains, strict=True)}
        spikes, _ = encode(signal, rate_Hz, spec.model_copy(update=tried))
        spikes[after_end] = 0
        populations = np.split(spikes, 2, axis=2)
        for (part, afferent), gain, raster in zip(POPULATIONS.items(), gains, populations, strict=True):
            neuron = spec.neuron(getattr(spec, part), rate_Hz)
            isi_steps = _isi_steps(raster)
            edges = bin_edges(neuron.refractory_steps + 1, signal.shape[1])
            shares = _isi_shares(isi_steps, raster.shape, edges)
            row = {
                "afferent": afferent,
                "gain": gain,
                "silent_share": float(1 - raster.any(axis=(1, 2)).mean()),
                "floor_share": _floor_share(isi_steps.isi_ms, neuron),
                "separation": _separation(shares, labellings),
                "spikes_per_s": float(raster.sum() / (n_steps.sum() / rate_Hz * felt.n_channels)),
            }
            rows.append(row)
            isi.append(_isi_table(shares, labels, felt.classes, edges / rate_Hz * 1e3, afferent, gain))
        if progress:
            progress(1, ", ".join(f"{a} {g:g}" for a, g in zip(POPULATIONS.values(), gains, strict=True)))
    table = pd.DataFrame(rows).sort_values(["afferent", "gain"], ascending=[False, True], ignore_index=True)
    within = (table.silent_share <= rule.max_silent_share) & (table.floor_share <= rule.max_floor_share)
    return table.assign(admissible=within, chosen=False), pd.concat(isi, ignore_index=True)


def _candidates(felt: Recordings, spec: AfferentSpec, rule: CalibrationRule) -> dict[str, list[float]]:
    """Gains of each population, from a little below the one at which its strongest drive just reaches threshold."""
    per_ms = felt.sampling_rate_Hz * 1e-3
    drives = {
        "sa1": np.concatenate([x.ravel() for x in felt.signals]),
        "ra1": np.concatenate([np.abs(np.diff(x, axis=0)).ravel() for x in felt.signals]) * per_ms,
    }
    grids = {}
    for part, drive in drives.items():
        strongest = float(np.percentile(drive, STRONGEST) if len(drive) else 0.0)
        strongest = strongest if strongest > 0 else float(drive.max(initial=0.0))
        if strongest <= 0:
            raise InputError(
                f"{_source(felt)}: the conditioned training trials never drive {POPULATIONS[part]} afferents; check "
                "the encoder's baseline and the columns that were read"
            )
        first = (spec.v_threshold_mV - spec.v_rest_mV) / strongest / rule.step**STEPS_BELOW
        grids[part] = [float(f"{first * rule.step**k:.3g}") for k in range(rule.candidates)]
    return grids


def _choose(table: pd.DataFrame, rule: CalibrationRule, where: str) -> int:
    """Index of the chosen row of one population; InputError where none is admissible."""
    heard = table[table.silent_share <= rule.max_silent_share]
    if heard.empty:
        raise InputError(
            f"{where}: every gain tried leaves {table.silent_share.min():.1%} of the training trials silent or more, "
            f"above max_silent_share = {rule.max_silent_share:.1%}; drop the trials without contact or raise the limit"
        )
    if not heard.admissible.any():
        raise InputError(
            f"{where}: every gain that leaves few trials silent puts {heard.floor_share.min():.1%} of the ISIs at the "
            f"refractory floor or more, above max_floor_share = {rule.max_floor_share:.1%}; drop the trials with the "
            "weakest contact or raise the limit"
        )
    admissible = table[table.admissible]
    best = admissible.separation.max()
    return int(admissible.index[admissible.separation >= best - rule.tie * abs(best)][0])


def _isi_steps(raster: np.ndarray) -> Intervals:
    """Every interval, counted in steps."""
    return isis_ms(events_of_raster(raster), 1e3)


def _floor_share(isi_steps: np.ndarray, neuron: LIF) -> float:
    """Share of the intervals in which charging took one step, or no longer than FLOOR_OF_TAU of tau_mem."""
    charging = max(1, round(-FLOOR_OF_TAU / np.log(neuron.decay)))
    return float((isi_steps <= neuron.refractory_steps + charging).mean()) if len(isi_steps) else 0.0


def _isi_shares(isi_steps: Intervals, shape: tuple[int, ...], edges: np.ndarray) -> np.ndarray:
    """ISI distribution of each trial and afferent, `(trial, afferent, bin)`, each summing to 1.

    Every trial counts the same, however many spikes it has; the last bin holds those without any interval.
    """
    n_trials, _, n_afferents = shape
    n_bins = len(edges)
    bins = np.clip(np.searchsorted(edges, isi_steps.isi_ms, side="right") - 1, 0, n_bins - 2)
    cell = (isi_steps.trial * n_afferents + isi_steps.afferent) * n_bins + bins
    counts = np.bincount(cell, minlength=n_trials * n_afferents * n_bins).reshape(n_trials, n_afferents, n_bins)
    counts[..., -1] = counts.sum(axis=-1) == 0
    return counts / counts.sum(axis=-1, keepdims=True)


def _separation(shares: np.ndarray, labellings: Sequence[np.ndarray]) -> float:
    """How far the classes' ISI distributions lie apart, in bit: 0 for equal ones, at most 1.

    The Jensen-Shannon divergence of two classes' mean distributions, averaged over pairs and afferents; less the
    average of the same over shuffled labels, because few trials never agree exactly.
    """
    true, *shuffled = (_divergence(shares, labels) for labels in labellings)
    return float(true - np.mean(shuffled))


def _divergence(shares: np.ndarray, labels: np.ndarray) -> float:
    means = np.stack([shares[labels == label].mean(axis=0) for label in np.unique(labels)])
    one, other = np.triu_indices(len(means), k=1)
    entropies = _entropy(means)
    mixed = _entropy((means[one] + means[other]) / 2)
    return float((mixed - (entropies[one] + entropies[other]) / 2).mean())


def _entropy(shares: np.ndarray) -> np.ndarray:
    return entr(shares).sum(axis=-1) / np.log(2)


def _isi_table(
    shares: np.ndarray, labels: np.ndarray, classes: tuple[str, ...], edges_ms: np.ndarray, afferent: str, gain: float
) -> pd.DataFrame:
    middles_ms = [*np.sqrt(edges_ms[1:] * edges_ms[:-1]), np.inf]
    parts = [
        pd.DataFrame({"label": name, "isi_ms": middles_ms, "share": shares[labels == label].mean(axis=(0, 1))})
        for label, name in enumerate(classes)
    ]
    return pd.concat(parts, ignore_index=True).assign(afferent=afferent, gain=gain)


def _short(values: np.ndarray) -> tuple[float, ...]:
    """The same float32 numbers, written with as few digits as they need."""
    return tuple(float(str(value)) for value in values.astype(np.float32))


def _source(recordings: Recordings) -> str:
    return recordings.source or "recordings"
