"""What encoders fire on ramps and vibrations, beside recorded and fitted afferents (docs/afferent-validation.md).

    python benchmarks/afferent_validation.py [--figures docs/images]

The signal of one taxel is the depth in mm of a pin of 0.5 mm radius, at 5 kHz. Gains of the LIF encoders are set once:
SA-I so that one afferent fires at 33 Hz late in a ramp of 0.78 mm, RA-I so that one fires 4 spikes on its rise, as the
fitted afferents do in the mean. Prints the tables of the page; `--figures` draws its figures there.
"""

import argparse
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.spikes import populations_of
from neurotact.encoders.model import EncoderSpec
from neurotact.encoders.specs import afferent_names, encode, load

RATE_Hz = 5000.0
LEAD_s, HELD_s = 0.02, 0.8
DEPTHS_mm = (0.3, 0.54, 0.78, 1.02, 1.44)
FAST_mm_per_s, SLOW_mm_per_s = 72.0, (26.0, 15.0, 9.0, 6.0)
FREQUENCIES_Hz = (5.0, 10.0, 20.0, 40.0, 80.0, 150.0, 200.0, 300.0)
AMPLITUDES_um = np.geomspace(0.02, 2000.0, 72)
SETTLED_s = 0.2
"""Spikes at the abrupt start of a vibration do not count."""
PERIODS_ms = (1.2, 5.0, 10.0)
BARE = {"unit": "mm", "conditioning": {"baseline": "none"}}
ALL_FITS = {"sa1": [1, 2, 3, 4], "ra1": [*range(1, 10)], "pc": [1, 2, 3, 4]}

STATIC_MODEL_Hz = (11, 23, 33, 46, 64)
RECORDED_um: dict[str, dict[float, float]] = {
    "RA-I": {10: 38, 19: 24, 38: 22, 77: 28, 147: 42},
    "PC": {10: 55, 19: 10, 39: 5.8, 79: 1.0, 161: 0.5, 205: 0.4},
}
"""Thresholds of recorded afferents (Freeman and Johnson 1982)."""


def ramp(depth_mm: float, speed_mm_per_s: float) -> np.ndarray:
    """The depth of a ramp that is held, `(time,)`."""
    time_s = np.arange(round((LEAD_s + depth_mm / speed_mm_per_s + HELD_s) * RATE_Hz)) / RATE_Hz - LEAD_s
    return np.clip(time_s * speed_mm_per_s, 0.0, depth_mm)


def vibrations(frequency_Hz: float, amplitudes_um: np.ndarray, duration_s: float = 1.0) -> np.ndarray:
    """The depth in mm of sines of each amplitude, `(amplitude, time)`."""
    phase = 2 * np.pi * frequency_Hz * np.arange(round(duration_s * RATE_Hz)) / RATE_Hz
    return amplitudes_um[:, None] * 1e-3 * np.sin(phase)


def fire(encoder: EncoderSpec, depth_mm: np.ndarray) -> dict[str, np.ndarray]:
    """The spikes of each population, `(trial, time, afferent)`, of depths `(trial, time)`."""
    spikes, _ = encode(np.atleast_2d(depth_mm)[:, :, None], RATE_Hz, encoder)
    names = afferent_names(["taxel"], encoder.model_dump())
    return {name: spikes[:, :, its] for name, its in populations_of(names).items()}


@cache
def encoders() -> dict[str, EncoderSpec]:
    """Today's LIF, each cheap option alone, all of them as shipped, and the fitted afferents."""
    sa1 = set_gain({}, "SA-I", "sa1.gain", late_rate, 33.0)
    ra1 = set_gain({}, "RA-I", "ra1.gain", spikes_of_rise, 4.0)
    gains = {"sa1.gain": sa1, "ra1.gain": ra1}
    fits = {part: {"gain": 1.0, "fits": its} for part, its in ALL_FITS.items()}
    return {
        "LIF": load("sa1-ra1-lif", BARE | gains),
        "+ half-wave": load("sa1-ra1-lif", BARE | gains | {"ra1.change": "on"}),
        "+ grades": load("sa1-ra1-lif", BARE | gains | {"sa1.grades": [0.25, 0.5, 1.0, 2.0]}),
        "+ rise": load("sa1-ra1-lif", BARE | gains | {"sa1.rate_ms": 20.0}),
        "biological": load("sa1-ra1-lif-biological", {"conditioning": {"baseline": "none"}}),
        "mechanoreceptor": load("mechanoreceptor-pc", BARE | fits | {"conduction": False, "noise": False}),
    }


def set_gain(changes: Mapping[str, Any], population: str, key: str, measure: Any, wanted: float) -> float:
    """The least gain of a LIF encoder, to 1 %, at which a measure of a population reaches a value."""
    low, high = 1e-2, 1e6
    while high / low > 1.01:
        gain = float(np.sqrt(low * high))
        found = measure(fire(load("sa1-ra1-lif", BARE | dict(changes) | {key: gain}), STANDARD)[population])
        low, high = (low, gain) if found >= wanted else (gain, high)
    return float(f"{high:.3g}")


STANDARD = ramp(0.78, FAST_mm_per_s)


def late_rate(raster: np.ndarray) -> float:
    """Mean rate of an afferent in the last 0.5 s of a ramp that is held."""
    return float(raster[:, -round(0.5 * RATE_Hz) :].sum(axis=1).mean() / 0.5)


def onset_rate(raster: np.ndarray) -> float:
    """Mean rate of an afferent in the first 50 ms from the ramp's start on."""
    first = round(LEAD_s * RATE_Hz)
    return float(raster[:, first : first + round(0.05 * RATE_Hz)].sum(axis=1).mean() / 0.05)


def spikes_of_rise(raster: np.ndarray) -> float:
    """Mean spikes of an afferent until 50 ms after the rise."""
    return float(raster[:, : -round((HELD_s - 0.05) * RATE_Hz)].sum(axis=1).mean())


def latency_ms(raster: np.ndarray) -> float:
    """Time of the first spike of each afferent after the ramp's start, median over those that fire."""
    fired = raster[0].any(axis=0)
    if not fired.any():
        return float("nan")
    return float(np.median(1e3 * (raster[0].argmax(axis=0)[fired] / RATE_Hz - LEAD_s)))


def cv_of_isis(raster: np.ndarray) -> float:
    """Coefficient of variation of the intervals late in a held ramp, mean over afferents and trials with 5 of them."""
    found = []
    for train in raster[:, -round(0.5 * RATE_Hz) :].transpose(0, 2, 1).reshape(-1, round(0.5 * RATE_Hz)):
        isis = np.diff(np.flatnonzero(train))
        if len(isis) >= 5:
            found.append(isis.std() / isis.mean())
    return float(np.mean(found)) if found else float("nan")


def noisy(encoder: EncoderSpec, seed: int = 0) -> EncoderSpec:
    """The encoder with its noise, if its model has any."""
    return encoder.model_copy(update={"noise": True, "seed": seed}) if encoder.model == "mechanoreceptor" else encoder


def fire_repeatedly(encoder: EncoderSpec, depth_mm: np.ndarray, n_trials: int) -> dict[str, np.ndarray]:
    """The spikes of each population, `(trial, time, afferent)`, of one depth `(time,)` with other noise each time."""
    trials = [fire(noisy(encoder, seed), depth_mm) for seed in range(n_trials)]
    return {kind: np.concatenate([fired[kind] for fired in trials]) for kind in trials[0]}


def ramps_table() -> pd.DataFrame:
    """Static rates, onset, latency and regularity of SA-I; spikes of RA-I on slow ramps, one row an encoder."""
    rows = []
    for name, encoder in encoders().items():
        held = [late_rate(fire(encoder, ramp(depth, FAST_mm_per_s))["SA-I"]) for depth in DEPTHS_mm]
        standard = fire(encoder, STANDARD)
        many = fire_repeatedly(encoder, STANDARD, 60)["SA-I"]
        slow = [spikes_of_rise(fire(encoder, ramp(0.5, speed))["RA-I"]) for speed in SLOW_mm_per_s]
        rows.append(
            {
                "encoder": name,
                "static_Hz": tuple(round(rate) for rate in held),
                "onset_Hz": onset_rate(standard["SA-I"]),
                "late_Hz": late_rate(standard["SA-I"]),
                "latency_ms": latency_ms(standard["SA-I"]),
                "cv": cv_of_isis(many),
                "ra_spikes": tuple(round(n, 1) for n in slow),
            }
        )
    return pd.DataFrame(rows)


class Tuning(NamedTuple):
    """Thresholds in micrometres at each frequency, `(frequency, afferent)`; infinite where the largest is too small.

    one: the least amplitude with a spike after the start; each: the least with a spike a cycle.
    """

    one: np.ndarray
    each: np.ndarray


@cache
def tuning(name: str) -> dict[str, Tuning]:
    """The thresholds of every population of an encoder."""
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for frequency_Hz in FREQUENCIES_Hz:
        fired = fire(encoders()[name], vibrations(frequency_Hz, AMPLITUDES_um))
        cycles = frequency_Hz * (1.0 - SETTLED_s)
        for kind, raster in fired.items():
            counts = raster[:, round(SETTLED_s * RATE_Hz) :].sum(axis=1)
            found.setdefault(kind, []).append((least(counts >= 1), least(counts >= 0.95 * cycles)))
    return {
        kind: Tuning(np.array([one for one, _ in rows]), np.array([each for _, each in rows]))
        for kind, rows in found.items()
    }


def least(reached: np.ndarray) -> np.ndarray:
    """The least amplitude from which on `(amplitude, afferent)` is true, for each afferent; infinite if none."""
    return np.where(reached.any(axis=0), AMPLITUDES_um[reached.argmax(axis=0)], np.inf)


def tuning_table(kind: str) -> pd.DataFrame:
    """The median threshold of one spike of a population's afferents at each frequency, one row an encoder."""
    rows = []
    for name in encoders():
        if kind in tuning(name):
            medians = np.median(tuning(name)[kind].one, axis=1)
            rows.append({"encoder": name, **{f"{f:g} Hz": m for f, m in zip(FREQUENCIES_Hz, medians, strict=True)}})
    return pd.DataFrame(rows)


class Locking(NamedTuple):
    """Responses to a vibration of 50 Hz of every amplitude.

    per_cycle: spikes a cycle, `(amplitude, afferent)`. phases: of the spikes in turns, for each amplitude and afferent.
    """

    per_cycle: np.ndarray
    phases: list[list[np.ndarray]]

    def entrained(self, afferent: int) -> int | None:
        """The place of the least amplitude with a spike a cycle."""
        at = np.flatnonzero(self.per_cycle[:, afferent] >= 0.95)
        return int(at[0]) if len(at) else None

    def plateau(self, afferent: int) -> float:
        """The factor on that amplitude up to which there is no more than a spike a cycle."""
        first = self.entrained(afferent)
        if first is None:
            return float("nan")
        above = np.flatnonzero(self.per_cycle[first:, afferent] > 1.05)
        last = first + above[0] - 1 if len(above) else len(AMPLITUDES_um) - 1
        return float(AMPLITUDES_um[max(last, first)] / AMPLITUDES_um[first])

    def at_twice(self, afferent: int) -> np.ndarray | None:
        """The phases at twice that amplitude."""
        first = self.entrained(afferent)
        if first is None:
            return None
        place = min(int(np.searchsorted(AMPLITUDES_um, 2 * AMPLITUDES_um[first])), len(AMPLITUDES_um) - 1)
        return self.phases[place][afferent]


@cache
def locking(name: str, kind: str, frequency_Hz: float = 50.0) -> Locking:
    """The locking of a population of an encoder, with its noise."""
    raster = fire(noisy(encoders()[name]), vibrations(frequency_Hz, AMPLITUDES_um))[kind]
    raster = raster[:, round(SETTLED_s * RATE_Hz) :]
    turns = frequency_Hz * np.arange(raster.shape[1]) / RATE_Hz % 1.0
    phases = [[turns[train != 0] for train in trial.T] for trial in raster]
    return Locking(raster.sum(axis=1) / (frequency_Hz * (1.0 - SETTLED_s)), phases)


def vector_strength(turns: np.ndarray | None) -> float:
    """Length of the mean of unit vectors at the phases."""
    return float("nan") if turns is None else float(abs(np.mean(np.exp(2j * np.pi * turns))))


def locking_table() -> pd.DataFrame:
    """Phase locking at 50 Hz, medians over the afferents that reach a spike a cycle, one row a population."""
    rows = []
    for name, encoder in encoders().items():
        for kind, raster in fire(encoder, STANDARD).items():
            found, its = locking(name, kind), range(raster.shape[2])
            firsts = [first for first in map(found.entrained, its) if first is not None]
            rows.append(
                {
                    "encoder": name,
                    "afferent": kind,
                    "entrained": f"{len(firsts)} of {len(its)}",
                    "from_um": float(np.median(AMPLITUDES_um[firsts])) if firsts else float("nan"),
                    "plateau": float(np.nanmedian([found.plateau(each) for each in its])) if firsts else float("nan"),
                    "vector_strength_at_twice": float(np.nanmedian([vector_strength(found.at_twice(i)) for i in its]))
                    if firsts
                    else float("nan"),
                }
            )
    return pd.DataFrame(rows)


def with_t_ref(encoder: EncoderSpec, t_ref_ms: float) -> EncoderSpec:
    """The encoder with a least distance of spikes for every population."""
    kinds = {part: getattr(encoder, part, None) for part in ("sa1", "ra1", "pc")}
    changed = {part: kind.model_copy(update={"t_ref_ms": t_ref_ms}) for part, kind in kinds.items() if kind is not None}
    return encoder.model_copy(update=changed)


def t_ref_table(name: str = "mechanoreceptor") -> pd.DataFrame:
    """What refractory periods do to an encoder: rates on a held ramp and on a strong vibration of 100 Hz."""
    rows = []
    for t_ref_ms in PERIODS_ms:
        encoder = with_t_ref(encoders()[name], t_ref_ms)
        pressed, shaken = fire(encoder, ramp(1.44, FAST_mm_per_s)), fire(encoder, vibrations(100.0, np.array([100.0])))
        rates = {
            kind: raster[:, round(SETTLED_s * RATE_Hz) :].sum(axis=1).mean() / 0.8 for kind, raster in shaken.items()
        }
        pressing = {
            "t_ref_ms": t_ref_ms,
            "onset_Hz": onset_rate(pressed["SA-I"]),
            "late_Hz": late_rate(pressed["SA-I"]),
        }
        rows.append({**pressing, **{f"{kind}_100Hz": rate for kind, rate in rates.items()}})
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", type=Path, help="a folder to draw the page's figures in")
    options = parser.parse_args()
    with pd.option_context("display.width", 160, "display.max_columns", 20, "display.float_format", "{:.2f}".format):
        for title, table in (
            ("ramps", ramps_table()),
            ("thresholds of RA-I (um)", tuning_table("RA-I")),
            ("thresholds of PC (um)", tuning_table("PC")),
            ("thresholds of SA-I (um)", tuning_table("SA-I")),
            ("locking at 50 Hz", locking_table()),
            ("refractory period of the fitted afferents", t_ref_table()),
            ("refractory period of LIF, biological", t_ref_table("biological")),
        ):
            print(f"\n{title}\n{table.to_string(index=False)}")
    if options.figures:
        from afferent_validation_figures import draw_all

        draw_all(options.figures)


if __name__ == "__main__":
    main()
