"""The same drive to one afferent at several refractory periods (texture paper, Fig. 4).

The paper prints the spike counts, but neither the drive nor its duration. So each candidate drive is scaled until the
afferent gives the published count at the first refractory period; the counts at the others are then a prediction.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from neurotact_parts.studies.texture.signals import legend_once
from pydantic import Field

from neurotact.data.conditioning import condition
from neurotact.data.recordings import LABEL, Recordings
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.specs import is_exact
from neurotact.figures.encoding import Classes
from neurotact.figures.style import MUTED, Drawn, new_figure, printed, sequence
from neurotact.neurons import lif_start, lif_step
from neurotact.spec import Spec
from neurotact.studies import measures
from neurotact.studies.measures import Measure
from neurotact.studies.study import Cell, StudySpec

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


@printed
def draw_same_drive(table: pd.DataFrame, published: Sequence[tuple[float, float]]) -> Figure:
    """Spikes of one afferent over its refractory period, a line per drive (Fig. 4).

    table: of `same_drive.csv`; published: pairs of t_ref_ms and spikes.
    """
    figure = new_figure(2.6, 4.6)
    axes = figure.subplots()
    recorded = table[table["drive"] == "recorded"]
    labels = list(dict.fromkeys(recorded["label"]))
    for label, shade in zip(labels, sequence(len(labels)), strict=True):
        rows = recorded[recorded["label"] == label]
        axes.plot(rows["t_ref_ms"], rows["spikes"], marker=".", color=shade, label=f"recorded, {label}")
    constant = table[table["drive"] == "constant"]
    axes.plot(constant["t_ref_ms"], constant["spikes"], ls="--", color=MUTED, marker=".", label="constant")
    style: Any = {"ls": "", "marker": "D", "ms": 7, "mfc": "none", "mec": "#D55E00", "mew": 1.3, "zorder": 4}
    for t_ref_ms, spikes in published:
        axes.plot(t_ref_ms, spikes, label="published", **style)
    axes.set(xlabel=r"$t_\mathrm{ref}$ (ms)", ylabel="spikes")
    axes.set_xticks(sorted(set(table["t_ref_ms"])))
    axes.set_ylim(bottom=0)
    axes.grid(axis="y")
    legend_once(axes, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _spec(study: StudySpec) -> SameDriveSpec:
    return measures.value_of("same_drive", study.measures)


def _table(folder: Path, study: StudySpec, cells: Sequence[Cell], recordings: Recordings) -> pd.DataFrame:
    assert isinstance(study.encoder, AfferentSpec)
    return same_drive_table(recordings, study.encoder, _spec(study), study.window.start_ms)


def _drawn(study: StudySpec, results: pd.DataFrame, table: pd.DataFrame, classes: Classes) -> Iterator[Drawn]:
    published = [
        (float(claim.where["t_ref_ms"]), claim.value)
        for claim in study.claims
        if claim.table == "same_drive"
        and claim.kind == "value"
        and claim.value is not None
        and "t_ref_ms" in claim.where
    ]
    figure = draw_same_drive(table, sorted(set(published)))
    seconds = _spec(study).duration_s
    caption = (
        f"Spikes of one SA-I afferent in {seconds:g} s over its refractory period. Each drive is scaled until it fires "
        "as often as published at the first period; the paper shows neither the drive nor its duration. Recorded: the "
        "strongest taxel in the strongest trials of each class. As the texture paper's Fig. 4."
    )
    words = [
        f"{' '.join(filter(None, (str(drive), str(label))))}: " + ", ".join(f"{value:.1f}" for value in rows["spikes"])
        for (drive, label), rows in table.fillna("").groupby(["drive", "label"], sort=False)
    ]
    yield Drawn("same-drive", "The same drive at other refractory periods", figure, caption, "; ".join(words) + ".")


def _check(study: StudySpec) -> None:
    if is_exact(study.encoder):
        raise ValueError("same_drive steps its afferents on a clock; leave integration out")
    if not isinstance(study.encoder, AfferentSpec):
        raise ValueError(f"same_drive needs LIF afferents; this encoder's model is '{study.encoder.model}'")


MEASURE = Measure(
    SameDriveSpec,
    "Also give one afferent the same drive at several refractory periods: the table same_drive.csv.",
    "same_drive",
    "spikes of an afferent under the same drive, over refractory periods",
    of_study=_table,
    draw=_drawn,
    check=_check,
)
"""The entry point `same_drive` of the group `neurotact.measures`."""
