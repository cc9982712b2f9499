"""Checks of an encoder on its data: silent, saturated and restless afferents, and too long refractory periods.

Spikes at rest, before contact, cost operations and carry no information.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from neurotact.data.conditioning import Baseline, condition_pieces
from neurotact.data.contact import REST_MS as REST_MS
from neurotact.data.recordings import Trials
from neurotact.data.spikes import populations_of
from neurotact.encoders.model import EncoderSpec, sensitivity_key
from neurotact.encoders.specs import (
    afferent_names,
    conditioning_of,
    described,
    dotted,
    encode,
    is_exact,
    populations,
    t_ref_ms_of,
    taxels_of,
)
from neurotact.errors import InputError, some
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    import pandas as pd


SATURATED = 0.9
"""Share of the highest rate that a refractory period allows; above it, the rate no longer follows the drive."""


SEEN_MS = 2000.0
"""Length of the part of a trial that is used."""
MOST_TRIALS = 128
RESTLESS = 0.5
"""An afferent with at least this share of its later rate at rest counts as restless."""
LEAST_Hz = 1.0
SMOOTH = "smooth the signal (conditioning.ema_cutoff_Hz)"


class FiringWarning(UserWarning):
    """Warning about an encoder that does not fit its data.

    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", FiringWarning)  # a silent population ends the script
    """


def check_periods(encoder: EncoderSpec, trial_s: float) -> None:
    """InputError if a refractory period is as long as the shortest trial, which lasts `trial_s`.

    >>> from neurotact.encoders.specs import load
    >>> check_periods(load("sa1-ra1-lif", {"sa1.t_ref_ms": 20}), trial_s=0.01)
    Traceback (most recent call last):
    neurotact.errors.InputError: sa1.t_ref_ms: 20 ms is not shorter than the shortest trial, which lasts 10 ms; shorten it
    """  # noqa: E501
    for population in populations(encoder):
        t_ref_ms = t_ref_ms_of(encoder, population)
        if t_ref_ms >= 1e3 * trial_s:
            key = dotted(population.part, "t_ref_ms")
            raise InputError(
                f"{key}: {t_ref_ms:g} ms is not shorter than the shortest trial, which lasts {1e3 * trial_s:g} ms; "
                "shorten it"
            )


def check_rate(encoder: EncoderSpec, sampling_rate_Hz: float) -> None:
    """InputError if an encoder has afferents for which its recordings are too slow, such as PC.

    Resampling to a faster clock adds nothing to them.
    """
    for name, part, least_Hz in populations(encoder):
        if sampling_rate_Hz < least_Hz:
            raise InputError(
                f"{part}: {name} afferents need recordings of {least_Hz:g} Hz or more; these have "
                f"{sampling_rate_Hz:g} Hz; leave {part} out"
            )


def complaints(counts: np.ndarray, n_steps: int, clock_Hz: float, encoder: EncoderSpec) -> Iterator[str]:
    """A sentence for each population that is silent, or all of whose firing afferents are saturated.

    counts: spikes of each afferent in `n_steps` steps of the clock, `(afferent,)`, in the order of its output.

    >>> from neurotact.encoders.specs import load
    >>> list(complaints(np.array([0, 3]), n_steps=1000, clock_Hz=1000.0, encoder=load("sa1-ra1-lif")))
    ['no SA-I afferent fires in any trial; raise sa1.gain, or find gains for this sensor with neurotact calibrate']
    """
    table = encoder.model_dump()
    n_taxels = taxels_of(len(counts), table)
    of_each = populations_of(afferent_names([""] * n_taxels, table))
    for population in populations(encoder):
        name, part, fired = population.name, population.part, counts[of_each.get(population.name, [])]
        kind = described(encoder, population)
        silent_steps = max(0, math.ceil(t_ref_ms_of(encoder, population) * 1e-3 * clock_Hz - 1e-9))
        highest_Hz = clock_Hz / max(1, silent_steps + (not is_exact(encoder)))
        rates_Hz = fired[fired > 0] * clock_Hz / n_steps
        if not len(fired):
            continue  # none was asked for
        if not len(rates_Hz):
            yield f"no {name} afferent fires in any trial; {_remedy('raise', part, kind)}"
        elif rates_Hz.min() > SATURATED * highest_Hz:
            yield (
                f"every {name} afferent that fires does so at over {SATURATED:.0%} of the {highest_Hz:g} Hz that its "
                f"t_ref allows; {_remedy('lower', part, kind)}"
            )


def _remedy(verb: str, part: str, kind: Spec) -> str:
    """The remedy for a population that fires too little or too much."""
    key = sensitivity_key(type(kind))
    assert key is not None  # else the model is unfit
    if key.startswith("threshold"):
        verb = {"raise": "lower", "lower": "raise"}[verb]
    return f"{verb} {dotted(part, key)}, or find gains for this sensor with neurotact calibrate"


def resting_table(recordings: Trials, spec: EncoderSpec, rest_ms: float = REST_MS) -> pd.DataFrame:
    """The spikes of each afferent in the first `rest_ms` of trials and afterwards, until `SEEN_MS`.

    Columns: afferent, rest_Hz, later_Hz, rest_share (of its spikes, on the resting part), share (of all spikes of all
    afferents), restless. At most `MOST_TRIALS` trials are encoded, evenly spaced.
    """
    chosen = np.unique(np.linspace(0, len(recordings) - 1, min(len(recordings), MOST_TRIALS)).round().astype(int))
    names = afferent_names(recordings.channels, spec.model_dump())
    counts, steps = np.zeros((2, len(names))), np.zeros(2)
    for raster, n_rest in _begun(recordings.select(chosen), spec, rest_ms):
        for i, part in enumerate((raster[:n_rest], raster[n_rest:])):
            counts[i] += part.sum(axis=0)
            steps[i] += len(part)
    clock_Hz = spec.conditioning.clock_Hz(recordings.sampling_rate_Hz)
    rest_Hz, later_Hz = (counts[i] / max(1.0, steps[i]) * clock_Hz for i in (0, 1))
    total = counts.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        rest_share, share = np.nan_to_num(counts[0] / total), total / max(1.0, total.sum())
    return pd.DataFrame(
        {
            "afferent": names, "rest_Hz": rest_Hz, "later_Hz": later_Hz,
            "rest_share": rest_share, "share": share,
            "restless": (rest_Hz >= LEAST_Hz) & (rest_Hz >= RESTLESS * later_Hz),
        }
    )  # fmt: skip


def complaint_at_rest(table: pd.DataFrame, rest_ms: float = REST_MS, baseline: Baseline = "none") -> str | None:
    """A note on afferents that fire at rest, with the remedy; None if there are none.

    baseline: of their encoder; if there is one already, it is not suggested.
    """
    restless = table[table["restless"]].sort_values("share", ascending=False)
    if restless.empty:
        return None
    shown = [
        f"{name} ({rest_Hz:.0f} Hz at rest, {later_Hz:.0f} Hz later, {100 * share:.1f} % of all spikes)"
        for name, rest_Hz, later_Hz, _, share, _ in restless.itertuples(index=False)
    ]
    if len(restless) > 0.5 * len(table):
        off = "subtract a baseline (conditioning.baseline=start)"
        remedy = f"if trials begin in contact this is touch; else {off if baseline == 'none' else SMOOTH}"
    else:
        remedy = f"leave these taxels out (`columns` of an import), {SMOOTH} or lower the gain"
    return f"fire in the first {rest_ms:g} ms of trials nearly as much as afterwards: {some(shown, 4)}; {remedy}"


def _begun(recordings: Trials, spec: EncoderSpec, rest_ms: float) -> Iterator[tuple[np.ndarray, int]]:
    """The raster `(time, afferent)` of the beginning of each trial, and the number of its steps at rest."""
    how = conditioning_of(spec, recordings.sampling_rate_Hz)
    rate_Hz, clock_Hz = (part.clock_Hz(recordings.sampling_rate_Hz) for part in (how, spec.conditioning))
    n_rest, n_seen = max(1, round(rest_ms * 1e-3 * clock_Hz)), max(1, round(SEEN_MS * 1e-3 * rate_Hz))
    for trial in range(len(recordings)):
        seen = np.concatenate([*condition_pieces(recordings, trial, how, spec.unit, n_seen)])
        raster, _ = encode(seen[None], rate_Hz, spec)
        yield raster[0], n_rest
