"""Afferents that fire at rest, before contact: their spikes cost operations and carry no information."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from neurotact.data.conditioning import Baseline, condition_pieces
from neurotact.data.recordings import Trials
from neurotact.encoders.specs import EncoderSpec, afferent_names, conditioning_of, encode
from neurotact.errors import some

REST_MS, SEEN_MS = 100.0, 2000.0
"""Length of a trial's beginning that counts as rest, and of the part of the trial that is used."""
MOST_TRIALS = 128
RESTLESS = 0.5
"""An afferent with at least this share of its later rate at rest counts as restless."""
LEAST_Hz = 1.0
SMOOTH = "smooth the signal (conditioning.ema_cutoff_Hz)"


def resting_table(recordings: Trials, spec: EncoderSpec, rest_ms: float = REST_MS) -> pd.DataFrame:
    """The spikes of each afferent in the first `rest_ms` of trials and afterwards, until `SEEN_MS`.

    Columns: afferent, rest_Hz, later_Hz, rest_share (of its spikes, on the resting part), share (of all spikes of all
    afferents), restless. At most `MOST_TRIALS` trials are encoded, evenly spaced.
    """
    chosen = np.unique(np.linspace(0, len(recordings) - 1, min(len(recordings), MOST_TRIALS)).round().astype(int))
    names = afferent_names(recordings.channels, spec.model_dump())
    counts, steps = np.zeros((2, len(names))), np.zeros(2)
    for raster, n_rest in _encoded(recordings.select(chosen), spec, rest_ms):
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


def complaint(table: pd.DataFrame, rest_ms: float = REST_MS, baseline: Baseline = "none") -> str | None:
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


def _encoded(recordings: Trials, spec: EncoderSpec, rest_ms: float) -> Iterator[tuple[np.ndarray, int]]:
    """The raster `(time, afferent)` of the beginning of each trial, and the number of its steps at rest."""
    how = conditioning_of(spec, recordings.sampling_rate_Hz)
    rate_Hz, clock_Hz = (part.clock_Hz(recordings.sampling_rate_Hz) for part in (how, spec.conditioning))
    n_rest, n_seen = max(1, round(rest_ms * 1e-3 * clock_Hz)), max(1, round(SEEN_MS * 1e-3 * rate_Hz))
    for trial in range(len(recordings)):
        parts, n = [], 0
        for piece in condition_pieces(recordings, trial, how, spec.unit):
            parts.append(piece[: n_seen - n].copy())
            n += len(piece)
            if n >= n_seen:
                break
        raster, _ = encode(np.concatenate(parts)[None], rate_Hz, spec)
        yield raster[0], n_rest
