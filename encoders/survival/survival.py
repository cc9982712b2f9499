"""What of a signal survives its encoder: how well it is decoded, what spikes tell of the class, how soon, and the cost.

All numbers are those of the beginnings of trials, as long as the shortest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.encoders.decoding import decode
from neurotact_parts.encoders.survival import reconstruction
from neurotact_parts.encoders.survival.information import binned, class_information, information_of_bins
from neurotact_parts.encoders.survival.reconstruction import Reconstruction

from neurotact.data.conditioning import condition
from neurotact.data.recordings import Trials
from neurotact.data.spikes import populations_of
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.encoding import in_order
from neurotact.encoders.excerpts import draw, liveliest
from neurotact.encoders.model import EncoderSpec, of_name
from neurotact.encoders.specs import (
    afferent_names,
    conditioning_of,
    encode,
    encode_whole,
    is_exact,
    recorded_at,
    with_taxels_of,
)
from neurotact.errors import InputError
from neurotact.metrics.prices import MEMORY_45NM
from neurotact.report.wording import energy

ALL = "all"
PER_CLASS, TAXELS, LONGEST_s = 24, 16, 2.0
"""Trials of each class, taxels and seconds of a trial that are used, at most."""
INSTANTS = 40
"""Moments of a trial at which the information so far is estimated."""
SHUFFLES, ALPHA = 40, 0.05
"""Permutations of the labels, and how many of them may tell more by chance."""
PRICES = MEMORY_45NM


@dataclass(frozen=True)
class Survival:
    """What survives an encoder.

    table: one row per population and one for all, `population`: `spikes_per_s` (of an afferent), `snr_dB` and
        `bits_per_s` (of a taxel's signal, by the optimal linear filter of its spikes on other trials), `bits_per_spike`
        (of the signal), `class_bits` (of an afferent's count in the trial), `class_bits_per_spike`,
        `first_informative_ms` (from when on the counts so far tell more than by chance; NaN if never), and only for
        all: `own_snr_dB` (of the encoder's own decoder, without the mean of each segment; NaN without one),
        `energy_nJ_per_s` (an estimate of conditioning and encoding, by `PRICES`) and `nJ_per_spike`, of all afferents.
    spectra: power and error of the linear filter of all spikes, over frequency.
    told: information of the counts so far over time: `time_ms`, `class_bits` (mean over afferents), `by_chance`.
    shown: the liveliest taxel's signal in one segment and what is decoded: `time_ms`, `signal`, `linear` (NaN at its
        ends), `own` (NaN without a decoder), in standard deviations. events: its spikes there, `population`, `time_ms`.
    """

    table: pd.DataFrame
    spectra: Reconstruction
    told: pd.DataFrame
    shown: pd.DataFrame
    events: pd.DataFrame

    def __repr__(self) -> str:
        """The line of `str`, not the tables."""
        return f"Survival({self})"

    def __str__(self) -> str:
        """One line for people."""
        row = self.table.iloc[-1]
        soon = "never" if np.isnan(row.first_informative_ms) else f"after {row.first_informative_ms:.0f} ms"
        return (
            f"{row.snr_dB:.1f} dB of the signal, {row.bits_per_spike:.2g} bit a spike; {row.class_bits:.2g} bit an "
            f"afferent about the class, first {soon}; {row.spikes_per_s:.3g} spikes/s an afferent, "
            f"{energy(row.energy_nJ_per_s)} a second by {PRICES.name}"
        )


def survival_of(recordings: Trials, encoder: EncoderSpec, seed: int = 0) -> Survival:
    """Encode trials and measure what can be had from the spikes.

    At most `PER_CLASS` trials of a class, drawn with `seed`, their first `LONGEST_s` (or as much as the shortest has)
    and their `TAXELS` liveliest taxels are used. Raises InputError for one class, for trials of a few samples, and as
    `encode` does.
    """
    if len(recordings.classes) < 2:
        raise InputError("recordings: hold one class, and what spikes tell of it is measured; give two or more")
    rng, recordings = np.random.default_rng(seed), in_order(recordings, encoder)
    drawn, encoder = recordings.select(draw(recordings.labels, PER_CLASS, rng)), with_taxels_of(encoder)
    felt = _felt(drawn, encoder)
    recorded = recorded_at(encoder, recordings.sampling_rate_Hz, recordings.channels)
    table = recorded.model_dump(mode="json", exclude_none=True)
    n_taxels = len(felt.scale)
    kinds = populations_of(afferent_names(["x"] * n_taxels, table))
    x, trial = reconstruction.segments(felt.signals, felt.rate_Hz)
    s, _ = reconstruction.segments(felt.spikes, felt.rate_Hz)
    under = s.reshape(*s.shape[:2], -1, n_taxels).swapaxes(2, 3)  # (segment, time, taxel, afferent of a taxel)
    spectra, decoded = reconstruction.linear(x, under, trial, felt.rate_Hz)
    counts = np.stack([raster.sum(axis=0, dtype=int) for raster in felt.spikes])
    seconds = sum(map(len, felt.signals)) / felt.rate_Hz
    rows, told = [], pd.DataFrame()
    for name, its in [*kinds.items(), (ALL, np.arange(counts.shape[1]))]:
        of = np.unique(its // n_taxels)
        one = spectra if name == ALL else reconstruction.linear(x, under[..., of], trial, felt.rate_Hz)[0]
        bits, per_s = float(class_information(counts[:, its], drawn.labels).mean()), counts[:, its].mean(axis=1).sum()
        per_s = float(per_s / seconds)
        told = _told([raster[:, its] for raster in felt.spikes], drawn.labels, felt.rate_Hz, rng)
        late = np.flatnonzero(told.class_bits > told.by_chance)
        rows.append({
            "population": name, "spikes_per_s": per_s, "snr_dB": one.snr_dB, "bits_per_s": one.bits_per_s,
            "bits_per_spike": _per(one.bits_per_s, per_s * len(of)), "class_bits": bits,
            "class_bits_per_spike": _per(bits, float(counts[:, its].mean())),
            "first_informative_ms": float(told.time_ms[late[0]]) if len(late) else np.nan,
        })  # fmt: skip
    own = _own(encoder, felt)
    n_afferents = len(afferent_names(recordings.channels, table))
    fired = rows[-1]["spikes_per_s"] * n_afferents
    spent = {"recorded_Hz": recordings.sampling_rate_Hz, "spikes": fired}
    cost_nJ = encoding_cost(recordings.n_channels, felt.rate_Hz, 1e3, table, **spent).energy_nJ(PRICES)
    rows[-1] |= {
        "own_snr_dB": np.nan if own is None else reconstruction.direct(x, own, felt.rate_Hz).snr_dB,
        "energy_nJ_per_s": cost_nJ,
        "nJ_per_spike": _per(cost_nJ, fired),
    }
    return Survival(pd.DataFrame(rows), spectra, told, *_shown(x, s, decoded, own, kinds, felt.rate_Hz))


class _Felt(NamedTuple):
    """Conditioned signals of the chosen taxels, `(time, taxel)` each, of mean 0 and deviation 1; their spikes.

    mean, scale: what was taken off and divided by, `(taxel,)`.
    """

    signals: list[np.ndarray]
    spikes: list[np.ndarray]
    rate_Hz: float
    mean: np.ndarray
    scale: np.ndarray


def _felt(drawn: Trials, encoder: EncoderSpec) -> _Felt:
    taken = drawn.loaded().to_unit(encoder.unit)
    conditioned = condition(taken, encoder.conditioning)
    rate_Hz = conditioned.sampling_rate_Hz
    signals = [np.asarray(signal)[: max(1, round(LONGEST_s * rate_Hz))] for signal in conditioned.signals]
    taxels = liveliest(signals, TAXELS)
    signals = [np.ascontiguousarray(signal[:, taxels]) for signal in signals]
    shortest = min(map(len, signals))
    signals = [signal[:shortest] for signal in signals]
    if is_exact(encoder):
        sampled = condition(taken, conditioning_of(encoder, taken.sampling_rate_Hz))
        samples = (np.asarray(signal)[None, :, taxels] for signal in sampled.signals)
        spikes = [encode_whole(sample, sampled.sampling_rate_Hz, encoder)[0, :shortest] for sample in samples]
    else:
        spikes = [*encode(np.stack(signals), rate_Hz, encoder)[0]]
    every = np.concatenate(signals).astype(float)
    mean, scale = every.mean(axis=0), np.maximum(every.std(axis=0), np.finfo(np.float32).tiny)
    return _Felt([(signal - mean) / scale for signal in signals], spikes, rate_Hz, mean, scale)


def _own(encoder: EncoderSpec, felt: _Felt) -> np.ndarray | None:
    """The segments that the encoder's own decoder gives, in standard deviations; None without one."""
    if of_name(encoder.model).decode is None:
        return None
    decoded = [(decode(raster[None], felt.rate_Hz, encoder)[0] - felt.mean) / felt.scale for raster in felt.spikes]
    return reconstruction.segments(decoded, felt.rate_Hz)[0]


def _told(rasters: Sequence[np.ndarray], labels: np.ndarray, rate_Hz: float, rng: np.random.Generator) -> pd.DataFrame:
    """The information of the counts so far, mean over afferents, at `INSTANTS` moments of the shortest trial.

    by_chance: what a share `ALPHA` of the permutations of the labels exceeds at some moment.
    """
    n_steps = min(map(len, rasters))
    ends = np.unique(np.linspace(1, n_steps, min(INSTANTS, n_steps)).round().astype(int))
    so_far = np.stack([np.cumsum(raster[:n_steps], axis=0, dtype=int)[ends - 1] for raster in rasters], axis=1)
    told = np.array([class_information(counts, labels).mean() for counts in so_far])
    few = so_far[np.linspace(0, len(ends) - 1, min(8, len(ends))).round().astype(int)]
    bins = [binned(counts, labels) for counts in few]
    shuffled = [max(information_of_bins(one, order).mean() for one in bins) for order in _orders(labels, rng)]
    chance = float(np.quantile(shuffled, 1 - ALPHA))
    return pd.DataFrame({"time_ms": 1e3 * ends / rate_Hz, "class_bits": told, "by_chance": chance})


def _orders(labels: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    return [rng.permutation(labels) for _ in range(SHUFFLES)]


def _shown(
    x: np.ndarray, s: np.ndarray, decoded: np.ndarray, own: np.ndarray | None, kinds: Mapping[str, np.ndarray],
    rate_Hz: float,
) -> tuple[pd.DataFrame, pd.DataFrame]:  # fmt: skip
    """The signal, what is decoded and the spikes of the taxel and the segment that vary most."""
    segment, taxel = np.unravel_index(x.std(axis=1).argmax(), (x.shape[0], x.shape[2]))
    time_ms = np.arange(x.shape[1]) * 1e3 / rate_Hz
    signal, linear = x[segment, :, taxel], decoded[segment, :, taxel]
    direct = np.full(len(signal), np.nan)
    if own is not None:
        direct = own[segment, :, taxel] - own[segment, :, taxel].mean() + signal.mean()
    shown = pd.DataFrame({"time_ms": time_ms, "signal": signal, "linear": linear, "own": direct})
    parts = [
        pd.DataFrame({"population": name, "time_ms": time_ms[np.nonzero(s[segment][:, unit])[0]]})
        for name, its in kinds.items()
        for unit in its[its % x.shape[2] == taxel].tolist()
    ]
    return shown, pd.concat(parts, ignore_index=True)


def _per(value: float, spikes: float) -> float:
    return float(value / spikes) if spikes else np.nan
