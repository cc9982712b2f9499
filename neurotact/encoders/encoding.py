"""From recordings to spike trains: unit, conditioning and afferents of one encoder spec."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from neurotact.data import hdf5
from neurotact.data.augmentation import AugmentationSpec, CopiesWhenRead, check_taxels
from neurotact.data.conditioning import ACAUSAL, PIECE_VALUES, condition, condition_pieces, conditioned_length, is_long
from neurotact.data.copies import copies_of, with_touches
from neurotact.data.digests import recorded_digest
from neurotact.data.onset import common_onset_s
from neurotact.data.recordings import Recordings, Trials
from neurotact.data.spikes import SpikeTrains, TrialSpikes, Variations, from_trials, spikes_of
from neurotact.encoders import firing
from neurotact.encoders.model import EncoderSpec, name_in, of_name
from neurotact.encoders.specs import (
    afferent_names,
    conditioning_of,
    encode,
    encode_whole,
    finish,
    is_exact,
    of_used,
    recorded_at,
)
from neurotact.errors import InputError
from neurotact.spec import build

Progress = Callable[[int], None]
TrialsT = TypeVar("TrialsT", bound=Trials)
EXACT_BLOCK = 4
"""Factor on the trials encoded at once in closed form: a step of Python for each sample is faster with many."""
IN_MEMORY_BLOCK = 8
"""Factor on the number of trials encoded at once if they are in memory: Izhikevich neurons are faster with many."""
PADDED = 1.25
"""How much larger a block of trials may become by what is put after the ends of the shorter ones."""


class Encoded(NamedTuple):
    """Summary of a spikes file: trials, spikes of each afferent `(afferent,)`, steps of all trials and per second."""

    trials: int
    fired: np.ndarray
    steps: int
    clock_Hz: float


def encode_recordings(
    recordings: Trials,
    spec: EncoderSpec,
    progress: Progress | None = None,
    augmentation: AugmentationSpec | None = None,
    copied: Recordings | None = None,
) -> SpikeTrains:
    """Spike trains of whole trials; with `augmentation` also of varied copies, for training alone.

    copied: the same trials, or the beginning of each, of which the copies are; if None, these trials.
    progress: called with the number of trials done since its last call.
    Raises InputError if the unit, the sampling rate or the taxels do not fit the spec.

    >>> import pandas as pd
    >>> from neurotact.encoders.specs import load
    >>> skin = Recordings([np.zeros((400, 8))], 2000.0, "mV", pd.DataFrame({"label": ["conditioned"]}))
    >>> trains = encode_recordings(skin, load("sa1-ra1-lif"))
    >>> len(trains), len(trains.afferents), int(trains.trial_steps[0])
    (1, 16, 400)
    """
    recordings = in_order(recordings, spec)
    check_taxels(augmentation, recordings.n_channels)
    trains = from_trials(_encode_trials(recordings, spec, progress), **_about(recordings, spec))
    varied = recordings if copied is None else in_order(copied, spec)
    return replace(trains, variations=_variations(varied, trains.encoder, augmentation))


def _variations(
    recordings: Trials, encoder: Mapping[str, Any], augmentation: AugmentationSpec | None
) -> Variations | None:
    """The varied copies of some trials, whose spikes are made when they are read; None without any."""
    if augmentation is None or not augmentation.kinds:
        return None
    return CopiesWhenRead(recordings.loaded(), encoder, augmentation).variations()


def encode_copies(recordings: Recordings, encoder: Mapping[str, Any]) -> SpikeTrains:
    """The spikes of some varied copies; encoder: the table of their encoder."""
    spec = build(of_name(name_in(encoder)).spec, encoder, source="encoder")
    return from_trials(_encode_blocks(recordings, spec, None), **_about(recordings, spec))


def encode_file(
    recordings: Trials,
    spec: EncoderSpec,
    path: str | Path,
    progress: Progress | None = None,
    augmentation: AugmentationSpec | None = None,
) -> Encoded:
    """Write the spike trains of whole trials to `path`, one after the other: those of `encode_recordings`.

    progress: called with the number of trials done since its last call.
    """
    recordings = in_order(recordings, spec)
    check_taxels(augmentation, recordings.n_channels)
    about = _about(recordings, spec)
    varied = _variations(recordings, about["encoder"], augmentation)
    fired = np.zeros(len(about["afferents"]), np.int64)
    with hdf5.spike_writer(path, **about, variations=varied) as writer:
        for trial in _encode_trials(recordings, spec, progress):
            writer.append(trial)
            fired += np.bincount(trial.units, minlength=len(fired))
    return Encoded(len(recordings), fired, writer.n_steps, about["sampling_rate_Hz"])


def _encode_trials(recordings: Trials, spec: EncoderSpec, progress: Progress | None = None) -> Iterator[TrialSpikes]:
    """The spikes of one trial after the other, with no more of the signals in memory than a block of trials.

    Short trials are encoded side by side; a long one in pieces, since conditioning and afferents carry their state
    from one piece to the next. The spikes are the same.
    """
    recordings = in_order(recordings, spec)
    firing.check_periods(spec, recordings.lengths.min() / recordings.sampling_rate_Hz)
    firing.check_rate(spec, recordings.sampling_rate_Hz)
    yield from with_touches(_encode_blocks(recordings, spec, progress), copies_of(recordings).first)


def _encode_blocks(recordings: Trials, spec: EncoderSpec, progress: Progress | None) -> Iterator[TrialSpikes]:
    for block in _blocks(recordings, spec):
        if len(block) == 1:
            yield _encode_alone(recordings, int(block[0]), spec)
        else:
            yield from _encode_together(recordings, block, spec)
        if progress:
            progress(len(block))


def _encode_together(recordings: Trials, block: np.ndarray, spec: EncoderSpec) -> Iterator[TrialSpikes]:
    recorded = recordings.select(block).loaded()
    used, spec = _of_used(recorded, spec)
    conditioned = condition(used.to_unit(spec.unit), conditioning_of(spec, recorded.sampling_rate_Hz))
    rate_Hz = conditioned.sampling_rate_Hz
    signals = conditioned.signals
    encoded: dict[int, TrialSpikes] = {}
    for group in _of_like_length(np.array([*map(len, signals)]), 1.0 if is_exact(spec) else PADDED):
        together, n_steps = side_by_side([signals[trial] for trial in group])
        rasters = encode_whole(together, rate_Hz, spec)
        for trial, raster, n in zip(group.tolist(), rasters, n_steps, strict=True):
            encoded[trial] = spikes_of(raster if is_exact(spec) else raster[:n])
    for trial in range(len(block)):
        yield encoded[trial]._replace(digest=recorded_digest(recorded, trial))


def side_by_side(signals: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Signals `(time, taxel)` as one array `(trial, time, taxel)`, zeros after the shorter ones, and their lengths.

    No encoder looks ahead, so that what comes after a signal's end does not change its spikes.

    >>> together, n_steps = side_by_side([np.ones((2, 1)), np.ones((3, 1))])
    >>> together[:, :, 0].tolist(), n_steps.tolist()
    ([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0]], [2, 3])
    """
    n_steps = np.array([*map(len, signals)])
    if (n_steps == n_steps[0]).all():
        return np.stack(signals), n_steps
    together = np.zeros((len(signals), n_steps.max(), signals[0].shape[1]), signals[0].dtype)
    for row, signal in zip(together, signals, strict=True):
        row[: len(signal)] = signal
    return together, n_steps


def _of_like_length(lengths: np.ndarray, most: float) -> Iterator[np.ndarray]:
    """Groups of trials that are at most `most` times as large when all of a group are as long as its longest."""
    waiting: list[int] = []
    for trial in np.argsort(lengths, kind="stable"):
        if waiting and lengths[trial] * (len(waiting) + 1) > most * lengths[[*waiting, trial]].sum():
            yield np.array(waiting)
            waiting = []
        waiting.append(trial)
    yield np.array(waiting)


def _encode_alone(recordings: Trials, trial: int, spec: EncoderSpec) -> TrialSpikes:
    """The spikes of one trial, piece by piece."""
    n_steps = 0
    parts: list[TrialSpikes] = []
    for raster in _rasters(*_of_used(recordings, spec), trial):
        part = spikes_of(raster[0])
        parts.append(part._replace(steps=part.steps + n_steps))
        n_steps += part.n_steps
    steps, units = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    return TrialSpikes(steps, units, n_steps, recorded_digest(recordings, trial))


def _rasters(recordings: Trials, spec: EncoderSpec, trial: int) -> Iterator[np.ndarray]:
    """The raster of one trial, `(1, step, afferent)`, piece by piece, of about as many steps at any clock."""
    how, state = conditioning_of(spec, recordings.sampling_rate_Hz), None
    rate_Hz = how.clock_Hz(recordings.sampling_rate_Hz)
    n_rows = max(1, int(PIECE_VALUES / recordings.n_channels / max(1.0, _clock(recordings, spec) / rate_Hz)))
    for piece in condition_pieces(recordings, trial, how, spec.unit):
        for first in range(0, len(piece), n_rows):
            part = piece[None, first : first + n_rows]
            raster, state = encode(part, rate_Hz, spec, state)
            yield raster
    if state is not None and (rest := finish(rate_Hz, spec, state)) is not None:
        yield rest


def _of_used(recordings: TrialsT, spec: EncoderSpec) -> tuple[TrialsT, EncoderSpec]:
    """The recordings of the taxels that an encoder uses, and the encoder for them.

    All where the baseline is the mean of the whole trial, whose last bits depend on the number of taxels.
    """
    if spec.conditioning.baseline in ACAUSAL:
        return recordings, spec
    columns, used = of_used(spec, recordings.n_channels)
    return (recordings, spec) if used is spec else (recordings.of_taxels(columns), used)


def in_order(recordings: TrialsT, spec: EncoderSpec) -> TrialsT:
    """The recordings with their taxels in the order of those that an encoder was fitted to, or has encoded.

    Raises InputError for other taxels.
    """
    recordings = recordings.in_order(spec.conditioning.taxels)
    recorded = getattr(spec, "recorded_taxels", None)
    if recorded is None:
        return recordings
    if len(recorded) != recordings.n_channels:
        raise InputError(
            f"{recordings.source or 'recordings'}: has {recordings.n_channels} taxels where sa1.taxels and ra1.taxels "
            f"are of {len(recorded)}; give recordings of the same taxels, or leave recorded_taxels out"
        )
    return recordings.in_order(recorded)


def _blocks(recordings: Trials, spec: EncoderSpec) -> Iterator[np.ndarray]:
    """Groups of consecutive trials that fit in memory several times; a long trial is its own group."""
    at_once = IN_MEMORY_BLOCK if isinstance(recordings, Recordings) else 1
    at_once *= EXACT_BLOCK if is_exact(spec) else 1
    rate_Hz, clock_Hz = recordings.sampling_rate_Hz, spec.conditioning.resample_Hz
    finest = [max(n, conditioned_length(n, rate_Hz, clock_Hz)) for n in recordings.lengths.tolist()]
    n_channels = recordings.n_channels
    begin, held = 0, finest[0]
    for trial, (before, n_steps) in enumerate(pairwise(finest), start=1):
        held += n_steps
        if is_long(max(before, n_steps), n_channels) or is_long(held // at_once, n_channels):
            yield np.arange(begin, trial)
            begin, held = trial, n_steps
    yield np.arange(begin, len(finest))


def _about(recordings: Trials, spec: EncoderSpec) -> dict[str, Any]:
    """The metadata of spike trains and of their file."""
    recorded = recorded_at(spec, recordings.sampling_rate_Hz, recordings.channels)
    table = recorded.model_dump(mode="json", exclude_none=True)
    return {
        "sampling_rate_Hz": _clock(recordings, spec),
        "afferents": afferent_names(recordings.channels, table),
        "conditions": recordings.conditions,
        "encoder": table,
        "source": recordings.source,
        "touch_s": common_onset_s(recordings),
        "recorded_Hz": recordings.sampling_rate_Hz,
        "marks": recordings.marks,
    }


def _clock(recordings: Trials, spec: EncoderSpec) -> float:
    return spec.conditioning.clock_Hz(recordings.sampling_rate_Hz)
