"""Facts about signals and spikes from the texture paper and the public recordings, checked on the simulation.

Each fact has a target and a simulated value. No classifier is trained.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.stiffness import reader as pvdf_hardness
from neurotact_parts.studies.texture.simulator import GratingsSpec, simulate
from signal_facts import Fact

from neurotact.data.conditioning import ConditioningSpec, condition
from neurotact.data.dataset import expand
from neurotact.data.recordings import LABEL, Recordings, select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.metrics.firing import firing_of, touch_spikes
from neurotact.progress import say

PAIRS_ms = ((1, 1), (1, 5), (5, 5), (1, 10), (5, 10), (10, 10))
"""Refractory periods of RA-I & SA-I (Table III), in the order of Fig. 6."""
SHOWN = (1, 5, 8)
"""The gratings of Figs. 5 and 6."""
FORCE_N, SPEED_mm_per_s = 12.0, 8.6
"""The condition of Fig. 6."""
SETTLED_s = 0.25
"""Start of the window of 1 s."""
STRONG_TAXELS = 5
"""Number of strong taxels, the first ones: above 2 mV in the public recordings; the other three are near 1 mV."""
PUBLIC_PEAKS_mV = ((10.0, -10.0), (11.0, -11.0), (9.0, -4.0), (3.6, -8.5), (2.6, -3.6), (1.0, -1.0))
"""Highest and lowest value of the strong taxels and of the other three: grating 1, as recorded, force unknown."""
PUBLIC_EVENT = (585, 652)
"""Samples from the cut to the ridge event of three trials of grating 1."""
REPEATED_TRIALS = 12
"""Trials of grating 1: enough pairs to correlate."""
MOST_LAG_s = 0.1
QUIET_CHANNELS = 6
"""Quiet channels of eight; the other two have 0.4 mV rms even at rest."""
PAIR_CONDITIONS = ["force_N", "speed_mm_per_s"]


class Measured(NamedTuple):
    """A row for each grating and condition: `signals` amplitudes and spectra, `firing` spikes of each t_ref pair."""

    signals: pd.DataFrame
    firing: pd.DataFrame


def measure(recordings: Recordings, encoder: AfferentSpec) -> Measured:
    """Amplitudes, spectra and firing of every grating and condition."""
    periods_ms = sorted({period for pair in PAIRS_ms for period in pair})
    tables = []
    for period_ms in periods_ms:
        trains = encode_recordings(recordings, with_periods(encoder, period_ms, period_ms))
        tables.append(firing_table(trains).assign(t_ref_ms=period_ms))
    # The populations are independent, so the six pairs follow from three encodings.
    firing = pd.concat(tables).set_index("t_ref_ms")
    pairs = [_pair_table(firing.loc[[ra]], firing.loc[[sa]], f"{ra}&{sa}") for ra, sa in PAIRS_ms]
    return Measured(signal_table(recordings, encoder), pd.concat(pairs, ignore_index=True))


def with_periods(encoder: AfferentSpec, ra1_ms: float, sa1_ms: float) -> AfferentSpec:
    """The encoder with other refractory periods."""
    ra1, sa1 = (kind.model_copy(update={"t_ref_ms": t}) for kind, t in ((encoder.ra1, ra1_ms), (encoder.sa1, sa1_ms)))
    return encoder.model_copy(update={"ra1": ra1, "sa1": sa1})


def signal_table(recordings: Recordings, encoder: AfferentSpec) -> pd.DataFrame:
    """Means over the trials of each grating and condition, in mV and Hz.

    peak_mV, recorded_peak_mV: highest |signal| of the strongest taxel in a trial, after the EMA and as recorded.
    p99_mV: the 99th percentile of |signal| of the strongest taxel after the EMA.
    weak_mV: the 99th percentile on the strongest of the weak taxels. strong: taxels whose 99th is above 2 mV.
    principal_Hz: the highest line of the mean recorded spectrum; expected_Hz: real speed / spatial period.
    """
    how = ConditioningSpec(ema_cutoff_Hz=encoder.conditioning.ema_cutoff_Hz, baseline="mean")
    smooth = condition(recordings, how)
    start = round(SETTLED_s * recordings.sampling_rate_Hz)
    recorded, smooth = np.asarray(recordings.signals)[:, start:], np.asarray(smooth.signals)[:, start:]
    rows = []
    for key, group in recordings.conditions.groupby(["grating", *PAIR_CONDITIONS]):
        trials = group.index.to_numpy()
        p99 = np.percentile(np.abs(smooth[trials]), 99, axis=(0, 1))
        frequency_Hz, spectrum = mean_spectrum(recorded[trials, :, 0], recordings.sampling_rate_Hz)
        rows.append(
            dict(zip(["grating", *PAIR_CONDITIONS], key, strict=True))
            | {
                "peak_mV": np.abs(smooth[trials, :, 0]).max(axis=1).mean(),
                "recorded_peak_mV": np.abs(recorded[trials, :, 0]).max(axis=1).mean(),
                "p99_mV": p99[0],
                "weak_mV": p99[STRONG_TAXELS:].max(),
                "strong": int((p99 > 2.0).sum()),
                "principal_Hz": frequency_Hz[spectrum.argmax()],
                "expected_Hz": GratingsSpec().speed_factor * key[2] / spatial_period_mm(group),
            }
        )
    return pd.DataFrame(rows)


def spatial_period_mm(conditions: pd.DataFrame) -> float:
    """Pitch and ridge (1 mm) of a grating."""
    return float(conditions["pitch_mm"].iloc[0]) + GratingsSpec().ridge_width_mm


def mean_spectrum(signals: np.ndarray, rate_Hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and amplitude spectrum of `(trial, time)`, averaged over trials, bins of 1 / duration."""
    centred = signals - signals.mean(axis=1, keepdims=True)
    spectrum = 2.0 / signals.shape[1] * np.abs(np.fft.rfft(centred, axis=1)).mean(axis=0)
    return np.fft.rfftfreq(signals.shape[1], 1.0 / rate_Hz), spectrum


def firing_table(trains: SpikeTrains) -> pd.DataFrame:
    """Spikes per second of each population (all taxels together) and mean ISI, for each grating and condition."""
    columns = [LABEL, "grating", *PAIR_CONDITIONS]
    found = firing_of(trains, touch_spikes(trains, 1e3 * SETTLED_s), np.arange(len(trains)), columns)
    return found.drop(columns="sa_share").sort_values(columns, ignore_index=True)


def signal_facts(signals: pd.DataFrame) -> list[Fact]:
    """Amplitudes and spectra: Secs. III-A and VI-B, Fig. 12, and the amplitudes read off the published recordings."""
    coarse = signals[(signals.grating == 1) & (signals.force_N == FORCE_N)].mean(numeric_only=True)
    hard = signals[signals.force_N == FORCE_N]
    by_force = signals.groupby("force_N").p99_mV.mean()
    by_speed = signals.groupby("speed_mm_per_s").p99_mV.mean()
    peaks = hard.groupby("grating").peak_mV.mean()
    half = len(peaks) // 2
    coarse_mV, fine_mV = peaks.iloc[:half].mean(), peaks.iloc[-half:].mean()
    off_Hz = (signals.principal_Hz - signals.expected_Hz).abs().max()
    bin_Hz = 1.0
    speed_up = by_speed.iloc[-1] / by_speed.iloc[0]
    return [
        Fact(
            "grating 1 at 12 N: 99th percentile of |signal| on the strongest taxel, after the EMA",
            "Fig. 12, public code",
            "about 10 mV",
            f"{coarse.p99_mV:.1f} mV (peak {coarse.peak_mV:.1f}; {coarse.recorded_peak_mV:.1f} as recorded)",
            8.0 <= coarse.p99_mV <= 13.0,
        ),
        Fact(
            "taxels above 2 mV at 12 N",
            "public recordings",
            "5 of 8; the others <= 2 mV",
            f"{hard.strong.min()} to {hard.strong.max()}; the others <= {hard.weak_mV.max():.1f} mV",
            bool((hard.strong == STRONG_TAXELS).all() and hard.weak_mV.max() <= 2.0),
        ),
        Fact(
            "amplitude grows with force",
            "Secs. VI-B, Fig. 12",
            "remarkably, 3 < 6 < 12 N",
            " < ".join(f"{value:.1f}" for value in by_force) + " mV",
            bool(by_force.is_monotonic_increasing and by_force.iloc[-1] > 1.5 * by_force.iloc[0]),
        ),
        Fact(
            "amplitude grows with speed",
            "Sec. VI-B",
            "slightly",
            f"x {speed_up:.2f}",
            1.0 < speed_up < 1.3,
        ),
        Fact(
            "amplitude reflects coarseness (peak at 12 N, coarser and finer half of the gratings)",
            "Sec. VI-B",
            "coarse > fine",
            f"{coarse_mV:.1f} > {fine_mV:.1f} mV; each: " + ", ".join(f"{value:.1f}" for value in peaks),
            bool(coarse_mV > fine_mV),
        ),
        Fact(
            "principal frequency is real speed / (pitch + 1 mm)",
            "Sec. III-A; 1.846 Hz for grating 1 in the public recordings",
            "1.8 to about 10 Hz",
            f"{signals.expected_Hz.min():.1f} to {signals.expected_Hz.max():.1f} Hz, at most {off_Hz:.1f} Hz off",
            bool(off_Hz <= bin_Hz),
        ),
    ]


def start_facts(spec: GratingsSpec, encoder: AfferentSpec) -> list[Fact]:
    """The repeatability of trials of grating 1, compared with three public trials (lags 0, 43 and 66 samples)."""
    one = {
        "trials": REPEATED_TRIALS,
        "pitches_mm": spec.pitches_mm[:1],
        "forces_N": (FORCE_N,),
        "speeds_mm_per_s": (SPEED_mm_per_s,),
    }
    recordings = simulate(spec.model_copy(update=one))
    start = round(SETTLED_s * spec.sampling_rate_Hz)
    recorded = np.asarray(recordings.signals, np.float64)[:, start:]
    recorded -= recorded.mean(axis=1, keepdims=True)
    highest, lowest = recorded.max(axis=1).mean(axis=0), recorded.min(axis=1).mean(axis=0)
    change = np.abs(np.diff(recorded, axis=1))
    by_taxel = change.mean(axis=(0, 1))
    lags, correlations = zip(*(align(recorded[:, :, t], spec.sampling_rate_Hz) for t in range(4)), strict=True)
    spread_ms = 1e3 * np.std(np.concatenate(lags)) / np.sqrt(2.0)
    means = [float(each.mean()) for each in correlations]
    noiseless = spec.model_copy(update=one | {"noise_mV_rms": 0.0, "slip_mV_rms": 0.0})
    events = ridge_events(simulate(noiseless), start)
    trains = encode_recordings(recordings, encoder)
    firing = {kind: int(n) for kind, n in zip(("SA-I", "RA-I"), afferents_that_fire(trains), strict=True)}
    shown = [*range(STRONG_TAXELS), slice(STRONG_TAXELS, None)]
    return [
        Fact(
            "peaks of each taxel, grating 1 at 12 N, as recorded",
            "public recordings",
            ", ".join(f"{up:+g}/{down:g}" for up, down in PUBLIC_PEAKS_mV) + " mV (the last: three taxels)",
            ", ".join(f"{np.max(highest[t]):+.1f}/{np.min(lowest[t]):.1f}" for t in shown) + " mV",
            _within(highest, lowest, shown),
        ),
        Fact(
            "mean change from sample to sample, over taxels",
            "public recordings",
            "0.28 to 0.63 mV",
            f"{by_taxel.min():.2f} to {by_taxel.max():.2f} mV",
            bool(abs(by_taxel.min() - 0.28) < 0.03 and abs(by_taxel.max() - 0.63) < 0.1),
        ),
        Fact(
            "greatest change from sample to sample",
            "public recordings",
            "8.7 mV",
            f"{change.max():.1f} mV",
            bool(6.0 < change.max() < 12.0),
        ),
        Fact(
            "ridge event of grating 1, samples after the cut",
            "public recordings",
            "{} to {} in three trials".format(*PUBLIC_EVENT),
            f"{np.median(events):.0f} (median), {events.min()} to {events.max()} in {len(events)} trials",
            bool(PUBLIC_EVENT[0] <= np.median(events) <= PUBLIC_EVENT[1]),
        ),
        Fact(
            "trials of grating 1 lag by (standard deviation)",
            "public recordings",
            "17 ms (0, 43 and 66 samples)",
            f"{spread_ms:.0f} ms",
            bool(10.0 < spread_ms < 25.0),
        ),
        Fact(
            "correlation of aligned trials of grating 1, each of four strong taxels",
            "public recordings",
            "0.88 to 0.99",
            ", ".join(f"{mean:.2f}" for mean in means)
            + f"; single pairs {np.min(correlations):.2f} to {np.max(correlations):.2f}",
            all(0.88 <= mean <= 0.99 for mean in means),
        ),
        Fact(
            "afferents that fire, grating 1 at 12 N",
            "public recordings",
            "3 SA-I, 3 or 4 RA-I",
            f"{firing['SA-I']} SA-I, {firing['RA-I']} RA-I",
            bool(firing["SA-I"] == 3 and firing["RA-I"] in (3, 4)),
        ),
    ]


def _within(highest: np.ndarray, lowest: np.ndarray, shown: list[int | slice]) -> bool:
    """Whether each peak is within 30 % of the public one, or 1 mV if that is more."""
    reached = np.array([(np.max(highest[taxel]), np.min(lowest[taxel])) for taxel in shown])
    public = np.array(PUBLIC_PEAKS_mV)
    return bool((np.abs(reached - public) <= np.maximum(1.0, 0.3 * np.abs(public))).all())


def align(trials: np.ndarray, rate_Hz: float) -> tuple[np.ndarray, np.ndarray]:
    """The lag in seconds at which each pair of signals `(trial, time)` correlates most, and that correlation.

    >>> time_s = np.arange(400) / 200
    >>> pulse = np.exp(-((time_s - 1) / 0.05) ** 2)
    >>> lag_s, correlation = align(np.stack([pulse, np.roll(pulse, 4)]), 200.0)
    >>> lag_s.tolist(), bool(correlation[0] > 0.999)
    ([0.02], True)
    """
    most, n = round(MOST_LAG_s * rate_Hz), trials.shape[1]
    lags, correlations = [], []
    for one, other in combinations(trials, 2):
        found = [
            np.corrcoef(one[max(0, -lag) : n - max(0, lag)], other[max(0, lag) : n - max(0, -lag)])[0, 1]
            for lag in range(-most, most + 1)
        ]
        lags.append((int(np.argmax(found)) - most) / rate_Hz)
        correlations.append(max(found))
    return np.array(lags), np.array(correlations)


def ridge_events(recordings: Recordings, start: int) -> np.ndarray:
    """Samples from `start` to the highest value of the first taxel within one period of grating 1, `(trial,)`."""
    period_s = spatial_period_mm(recordings.conditions) / (GratingsSpec().speed_factor * SPEED_mm_per_s)
    stop = start + round(period_s * recordings.sampling_rate_Hz)
    return np.asarray(recordings.signals)[:, start:stop, 0].argmax(axis=1)


def afferents_that_fire(trains: SpikeTrains) -> tuple[int, int]:
    """SA-I and RA-I afferents with at least one spike per trial."""
    counts = np.bincount(np.concatenate(trains.units), minlength=len(trains.afferents)) / len(trains)
    return int((counts[trains.is_sa] >= 1).sum()), int((counts[~trains.is_sa] >= 1).sum())


def count_facts(firing: pd.DataFrame) -> list[Fact]:
    """Fig. 6: spikes of the six pairs, gratings 1, 5 and 8 at 12 N and 8.6 mm/s."""
    at = select_conditions(firing, {"force_N": FORCE_N, "speed_mm_per_s": SPEED_mm_per_s})
    facts = []
    for grating in SHOWN:
        rows = firing[at & (firing.grating == grating)].set_index("pair")
        total, sa, ra = (rows[f"spikes_{kind}_per_s"] for kind in ("total", "sa", "ra"))
        between = total[["1&10", "5&10"]]
        facts += [
            Fact(
                f"grating {grating}: spikes in 1 s",
                "Fig. 6",
                "1&1 > 1&5 > 5&5 > {1&10, 5&10} > 10&10",
                ", ".join(f"{pair} {value:.0f}" for pair, value in total.items()),
                bool(total["1&1"] > total["1&5"] > total["5&5"] > between.max() and between.min() > total["10&10"]),
            ),
            Fact(
                f"grating {grating}: SA-I and RA-I",
                "Fig. 6",
                "SA-I more than RA-I, except for 1&10",
                ", ".join(f"{pair} {sa[pair]:.0f}/{ra[pair]:.0f}" for pair in total.index),
                all((sa[pair] > ra[pair]) != (pair == "1&10") for pair in total.index),
            ),
        ]
    return facts


def rate_facts(firing: pd.DataFrame) -> list[Fact]:
    """Fig. 10: the effect of force and speed on rates and intervals, at 1&1."""
    rows = firing[firing.pair == "1&1"]
    facts = []
    for kind, name in (("sa", "SA-I"), ("ra", "RA-I")):
        rates = rows.pivot_table(index=["grating", "speed_mm_per_s"], columns="force_N", values=f"spikes_{kind}_per_s")
        isis = rows.groupby("force_N")[f"isi_{kind}_ms"].mean()
        by_speed = rows.groupby("speed_mm_per_s")[f"spikes_{kind}_per_s"].mean()
        speed_up = by_speed.iloc[-1] / by_speed.iloc[0]
        facts += [
            Fact(
                f"{name}: force raises the rate, every grating and speed",
                "Fig. 10a",
                "3 < 6 < 12 N",
                " < ".join(f"{value:.0f}" for value in rates.mean()) + " spikes/s (mean)",
                bool((np.diff(rates.to_numpy(), axis=1) > 0).all()),
            ),
            Fact(
                f"{name}: force lowers the ISI",
                "Fig. 10b",
                "3 > 6 > 12 N",
                " > ".join(f"{value:.0f}" for value in isis) + " ms (mean over gratings)",
                bool(isis.is_monotonic_decreasing),
            ),
            Fact(
                f"{name}: speed raises the rate",
                "Fig. 10a",
                "slightly",
                f"x {speed_up:.2f}",
                1.0 < speed_up < 1.3,
            ),
        ]
    return facts


def noise_facts(noise_mV_rms: float) -> list[Fact]:
    """The electronics' noise on the real PVDF patch; none if that data set is absent."""
    try:
        patch = pvdf_hardness.read(expand("$NEUROTACT_DATA/pvdf-hardness")).to_unit("mV")
    except InputError as error:
        say(f"noise of the real PVDF patch: not measured ({error})")
        return []
    rms, lag1 = quiet_noise(patch)
    quiet = np.sort(np.median(rms, axis=0))[:QUIET_CHANNELS]
    return [
        Fact(
            f"noise of the {QUIET_CHANNELS} quiet channels of the real patch, before a press",
            "PVDF hardness set",
            f"{noise_mV_rms:g} mV rms",
            f"{quiet.min():.2f} to {quiet.max():.2f} mV rms",
            bool(abs(quiet.mean() - noise_mV_rms) < 0.05),
        ),
        Fact(
            "that noise is white (correlation of neighbouring samples)",
            "PVDF hardness set",
            "0",
            f"{np.median(lag1):.2f}",
            bool(abs(np.median(lag1)) < 0.1),
        ),
    ]


def quiet_noise(patch: Recordings) -> tuple[np.ndarray, np.ndarray]:
    """Deviation and lag-1 correlation of the first 0.2 s, before a press, each `(trial, taxel)`."""
    n_samples = round(0.2 * patch.sampling_rate_Hz)
    still = np.stack([signal[:n_samples] for signal in patch.signals]).astype(np.float64)
    still -= still.mean(axis=1, keepdims=True)
    power = (still**2).mean(axis=1)
    return np.sqrt(power), (still[:, 1:] * still[:, :-1]).mean(axis=1) / np.maximum(power, 1e-12)


def _pair_table(ra: pd.DataFrame, sa: pd.DataFrame, pair: str) -> pd.DataFrame:
    """RA-I columns of one encoding with the SA-I columns of another."""
    table = sa.reset_index(drop=True)
    for column in ("spikes_ra_per_s", "isi_ra_ms"):
        table[column] = ra[column].to_numpy()
    table["spikes_total_per_s"] = table["spikes_sa_per_s"] + table["spikes_ra_per_s"]
    return table.assign(pair=pair)
