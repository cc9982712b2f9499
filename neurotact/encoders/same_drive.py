"""The same drive to one afferent at several refractory periods (texture paper, Fig. 4).

The paper prints the spike counts, but neither the drive nor its duration. So each candidate drive is scaled until the
afferent gives the published count at the first refractory period; the counts at the others are then a prediction.
"""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from neurotact.data.conditioning import condition
from neurotact.data.recordings import LABEL, Recordings
from neurotact.encoders.afferents import AfferentSpec
from neurotact.neurons import lif_start, lif_step
from neurotact.spec import Spec

SCALES = np.geomspace(1.0, 100.0, 400)
"""Peaks of a drive to try, in threshold gaps, in steps of about one percent."""


class SameDriveSpec(Spec):
    """The parameters of the comparison with Fig. 4."""

    spikes: int = Field(default=38, ge=1)
    """Count at the first refractory period; decides the strength of each drive."""
    t_ref_ms: tuple[Annotated[float, Field(ge=0)], ...] = Field(default=(1.0, 5.0, 10.0), min_length=2)
    """Refractory periods that are compared."""
    duration_s: float = Field(default=1.0, gt=0)
    """Our choice: the duration of the paper's other counts (Fig. 6)."""
    trials: int = Field(default=10, ge=1)
    """Trials of each class that supply recorded drives."""


def same_drive_table(
    recordings: Recordings, encoder: AfferentSpec, spec: SameDriveSpec, start_ms: float
) -> pd.DataFrame:
    """Spikes of an SA-I afferent, one row per drive and refractory period.

    Drives: `constant`; and for each class `recorded`, the signal of its strongest taxel in its strongest trials.
    Columns: drive, label (empty for `constant`), t_ref_ms, peak_mV (of the scaled drive) and spikes; the last two are
    means over trials. A drive that never reaches the published count is left out.
    """
    signals = condition(recordings.to_unit(encoder.unit), encoder.conditioning)
    n_steps = round(spec.duration_s * signals.sampling_rate_Hz)
    rows = []
    for drive, label, shapes in _drives(
        signals, spec.trials, round(start_ms * 1e-3 * signals.sampling_rate_Hz), n_steps
    ):
        counts = [_counts(shapes, signals.sampling_rate_Hz, encoder, t_ref_ms) for t_ref_ms in spec.t_ref_ms]
        reached = counts[0] >= spec.spikes
        fits = np.flatnonzero(reached.any(axis=0))
        least = reached.argmax(axis=0)[fits]  # the least scale that reaches the count
        for t_ref_ms, spikes in zip(spec.t_ref_ms, counts, strict=True):
            if len(fits):
                means = {"peak_mV": threshold_gap(encoder) * SCALES[least].mean(), "spikes": spikes[least, fits].mean()}
                rows.append({"drive": drive, "label": label, "t_ref_ms": t_ref_ms, **means})
    return pd.DataFrame(rows, columns=["drive", "label", "t_ref_ms", "peak_mV", "spikes"])


def threshold_gap(encoder: AfferentSpec) -> float:
    """The constant drive at which an afferent just fires."""
    return encoder.v_threshold_mV - encoder.v_rest_mV


def _drives(signals: Recordings, n_trials: int, start: int, n_steps: int) -> Iterator[tuple[str, str, np.ndarray]]:
    """The name of a drive, its class, and its shapes `(time, trial)`, each with a peak of 1."""
    yield "constant", "", np.ones((n_steps, 1))
    pieces = [np.asarray(signal[start : start + n_steps], np.float64) for signal in signals.signals]
    long = np.array([len(piece) == n_steps for piece in pieces])
    for label, group in signals.conditions[long].groupby(LABEL, sort=False):
        highest = {trial: pieces[trial].max(axis=0) for trial in group.index}
        strongest = sorted(highest, key=lambda trial: -highest[trial].max())[:n_trials]
        shapes = [pieces[trial][:, highest[trial].argmax()] / highest[trial].max() for trial in strongest]
        yield "recorded", str(label), np.stack(shapes, axis=1)


def _counts(shapes: np.ndarray, rate_Hz: float, encoder: AfferentSpec, t_ref_ms: float) -> np.ndarray:
    """Spikes of an afferent for each scale of each drive, `(scale, trial)`."""
    neuron = encoder.neuron(encoder.sa1.model_copy(update={"t_ref_ms": t_ref_ms}), rate_Hz)
    scales_mV = threshold_gap(encoder) * SCALES[:, None]
    state = lif_start(neuron, (len(SCALES), shapes.shape[1]), np.dtype(float))
    spikes = np.zeros((len(SCALES), shapes.shape[1]), np.int64)
    for now in shapes:
        fired, state = lif_step(neuron, scales_mV * now, state)
        spikes += fired
    return spikes
