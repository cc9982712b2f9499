"""What the spikes of a study give back of its signals, by a filter that knows the training trials alone."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.encoders.survival import reconstruction

from neurotact.data import hdf5
from neurotact.data.conditioning import ACAUSAL, ConditioningSpec, condition
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.encoders.excerpts import draw, liveliest
from neurotact.networks.training import tasks
from neurotact.progress import track
from neurotact.spec import build
from neurotact.studies import encoding_tables
from neurotact.studies.cell import task_of
from neurotact.studies.measures import Measure
from neurotact.studies.study import Cell, StudySpec, encoder_columns, split_columns, value_at

PER_CLASS, TAXELS, LONGEST_s = 8, 16, 2.0
"""Trials of each class on each side, taxels and seconds of a trial that are used, at most."""


class _Reconstructed(NamedTuple):
    """What the optimal linear filter gives back of a taxel's signal on test trials.

    snr_dB, bits_per_s: as of `reconstruction`. bits_per_spike: of a taxel's spikes; NaN without any.
    """

    snr_dB: float
    bits_per_s: float
    bits_per_spike: float


def reconstructed(
    recordings: Recordings, trains: SpikeTrains, split: Split, *, start_s: float = 0.0, seed: int = 0
) -> _Reconstructed:
    """Fit the filter to training trials, and decode the spikes of test trials with it.

    trains: of all trials of `recordings`, with the encoder that made them. At most `PER_CLASS` trials of a class on
    each side, drawn with `seed`; of each `LONGEST_s` from `start_s` on, or as much as the shortest has; the liveliest
    `TAXELS` taxels. Signals are those that the encoder received, each taxel standardised on the training trials.
    Raises InputError for trials of a few steps.

    >>> from neurotact.api.encoding import encode
    >>> from neurotact.api.recordings import simulate
    >>> from neurotact.data.splits import SplitSpec, split_touches
    >>> felt = simulate("gratings", trials=6, duration_s=1.0, forces_N=[12.0], speeds_mm_per_s=[8.6])
    >>> often, seldom = (encode(felt, "step-forward", {"threshold": x}) for x in (1.0, 20.0))
    >>> split = split_touches(often, (), SplitSpec())
    >>> reconstructed(felt, often, split).snr_dB > reconstructed(felt, seldom, split).snr_dB > 0
    True
    """
    rng, rate_Hz = np.random.default_rng(seed), trains.sampling_rate_Hz
    labels = recordings.labels
    sides = [side[draw(labels[side], PER_CLASS, rng)] for side in (split.train, split.test)]
    trials = np.concatenate(sides)
    signals = _conditioned(recordings, trials, trains, start_s)
    taxels = liveliest(signals, TAXELS)
    n_steps, n_taxels = min(map(len, signals)), recordings.n_channels
    felt = np.stack([np.asarray(signal[:n_steps, taxels], float) for signal in signals])
    fired = _spikes(trains, trials, round(start_s * rate_Hz), n_steps)
    fired = fired.reshape(len(trials), n_steps, -1, n_taxels)[..., taxels].swapaxes(2, 3)
    known = np.arange(len(trials)) < len(sides[0])
    mean, scale = felt[known].mean(axis=(0, 1)), felt[known].std(axis=(0, 1))
    felt = (felt - mean) / np.maximum(scale, np.finfo(np.float32).tiny)
    x, of = reconstruction.segments([*felt], rate_Hz)
    s, _ = reconstruction.segments([*fired], rate_Hz)
    spectra = reconstruction.transferred((x[known[of]], s[known[of]]), (x[~known[of]], s[~known[of]]), rate_Hz)
    per_s = fired[~known].sum(axis=3).mean() * rate_Hz
    return _Reconstructed(spectra.snr_dB, spectra.bits_per_s, float(spectra.bits_per_s / per_s) if per_s else math.nan)


def _conditioned(recordings: Recordings, trials: np.ndarray, trains: SpikeTrains, start_s: float) -> list[np.ndarray]:
    """The signals of trials as their encoder received them, `(time, taxel)`, from `start_s` on."""
    how = build(ConditioningSpec, trains.encoder.get("conditioning", {}), "the encoder of the spikes")
    how = how.model_copy(update={"resample_Hz": trains.sampling_rate_Hz})  # also where the encoder took samples
    chosen = recordings.select(trials).in_order(how.taxels)
    if how.baseline not in ACAUSAL:
        last = math.ceil((start_s + LONGEST_s) * recordings.sampling_rate_Hz) + 1
        chosen = replace(chosen, signals=[signal[:last] for signal in chosen.signals])
    conditioned = condition(chosen.to_unit(trains.encoder.get("unit", recordings.unit)), how)
    first, longest = (round(seconds * conditioned.sampling_rate_Hz) for seconds in (start_s, LONGEST_s))
    return [np.asarray(signal)[first : first + longest] for signal in conditioned.signals]


def _spikes(trains: SpikeTrains, trials: np.ndarray, first: int, n_steps: int) -> np.ndarray:
    """The spikes of trials, `(trial, time, afferent)` uint8."""
    rasters = np.zeros((len(trials), n_steps, len(trains.afferents)), np.uint8)
    for raster, trial in zip(rasters, trials, strict=True):
        steps = trains.steps[trial].astype(np.int64) - first
        inside = (steps >= 0) & (steps < n_steps)
        raster[steps[inside], trains.units[trial][inside]] = 1
    return rasters


def _table(folder: Path, study: StudySpec, cells: Sequence[Cell], recordings: Recordings) -> pd.DataFrame:
    """A row for each encoding: what its spikes give back of the signals of test trials.

    Columns: the t_ref pair, swept keys of the split and of the encoder, snr_dB, bits_per_s and bits_per_spike.
    """
    distinct, keys = {cell.spikes_name: cell for cell in cells}, [*split_columns(study), *encoder_columns(study)]
    rows = []
    with track("reconstruction", len(distinct)) as advance:
        for cell in distinct.values():
            trains = hdf5.load_spikes(folder / cell.given)
            sides = tasks.trials_of(trains, task_of(cell).model_copy(update={"subset": {}}))
            measured = reconstructed(recordings, trains, sides, start_s=cell.window.start_ms * 1e-3)
            own = {key: value_at(cell, key) for key in keys}
            rows.append({**encoding_tables.periods(cell), **own, **measured._asdict()})
            advance(1, "")
    return pd.DataFrame(rows)


MEASURE = Measure(
    bool,
    "Also measure how well a linear filter, fitted on training trials, gives the signal of test trials back from the "
    "spikes of each encoder: the table reconstruction.csv.",
    "reconstruction",
    "how well a linear filter of each encoder's spikes gives the signal of test trials back",
    of_study=_table,
    needs_whole_trials=True,
)
"""The entry point `reconstruction` of the group `neurotact.measures`."""
