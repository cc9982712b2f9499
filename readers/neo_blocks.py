"""Spike trains as blocks of Neo (doi 10.3389/fninf.2014.00010) and back: a segment is a trial, a train an afferent."""

import json
import logging
import math
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.readers.events.observed import Unobserved, observed_trials
from neurotact_parts.readers.events.spikes import BYTES_PER_EVENT, MOST_AFFERENTS, trains_with_ends
from neurotact_parts.readers.events.times import EventTimes, event_times, joined_times

from neurotact.data.digests import DIGEST, TOUCH
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.data.trial_choice import TrialChoice
from neurotact.data.windows import LONGEST_STEPS
from neurotact.errors import InputError, optional
from neurotact.files import check_size

log = logging.getLogger("neurotact")

NOT_SAID_HZ = 1.0
"""Neo's sampling rate of spike trains without one."""


def to_neo(spikes: SpikeTrains) -> Any:
    """A `neo.Block` with a segment per trial and in it a spike train per afferent, in ms from the trial's start.

    Label and conditions are annotations of the segment; the encoder (JSON) and the source are those of the block.
    Raises InputError where neo is not installed, and for trials without a step, which Neo cannot hold.

    >>> from neurotact.data.spikes import from_rasters
    >>> raster = np.zeros((1, 4, 2), np.uint8)
    >>> raster[0, 1, 0] = raster[0, 3, 1] = 1
    >>> felt = from_rasters(raster, 2000.0, ("SA-I a", "RA-I a"), pd.DataFrame({"label": ["felt"]}))
    >>> segment = to_neo(felt).segments[0]
    >>> segment.annotations["label"], [(train.name, train.magnitude.tolist()) for train in segment.spiketrains]
    ('felt', [('SA-I a', [0.5]), ('RA-I a', [1.5])])
    """
    neo, hertz = _neo(), import_module("quantities").Hz
    if not (spikes.trial_steps > 0).all():
        raise InputError("spikes: hold a trial without a step; drop it")
    rate_Hz = spikes.sampling_rate_Hz
    block = neo.Block(name="spikes", sampling_rate_Hz=rate_Hz, encoder=json.dumps(dict(spikes.encoder)))
    known = {} if spikes.recorded_Hz is None else {"recorded_Hz": spikes.recorded_Hz}
    block.annotate(source=spikes.source, **known)
    rows = spikes.conditions.to_dict("records")
    for trial, (row, n_steps) in enumerate(zip(rows, spikes.trial_steps.tolist(), strict=True)):
        segment = neo.Segment(name=f"trial {trial}", index=trial)
        segment.annotate(**{str(key): value for key, value in row.items()})
        if spikes.trial_digests:
            segment.annotations[DIGEST] = spikes.trial_digests[trial]
        if spikes.trial_touches:
            segment.annotations[TOUCH] = spikes.trial_touches[trial]
        units, steps = np.asarray(spikes.units[trial], np.int64), np.asarray(spikes.steps[trial], np.int64)
        order = np.argsort(units, kind="stable")
        ends = np.searchsorted(units[order], np.arange(1, len(spikes.afferents)))
        for name, own in zip(spikes.afferents, np.split(steps[order], ends), strict=True):
            train = neo.SpikeTrain(
                own * 1e3 / rate_Hz, units="ms", t_stop=n_steps * 1e3 / rate_Hz, sampling_rate=rate_Hz * hertz,
                name=name,
            )  # fmt: skip
            segment.spiketrains.append(train)
        block.segments.append(segment)
    return block


def from_neo(
    block: Any,
    *,
    step_ms: float | None = None,
    label: str = LABEL,
    merge_events: bool = False,
    unobserved: Unobserved | None = None,
    where: Mapping[str, Any] | None = None,
    leave_out: Any = None,
) -> SpikeTrains:
    """The spike trains of a `neo.Block`, a trial per segment; those of the same name are one afferent.

    step_ms: the clock; that of the block of `to_neo` or of its spike trains when None, else 1 ms. A spike falls in
    step floor((t - t_start) / step), counted from the beginning of its segment.
    label: the annotation of segments with their class. Other annotations that all segments have are conditions.
    merge_events: whether more than 1 % of the spikes may become one with another of their unit and step.
    unobserved: what becomes of segments whose spike trains do not all last from the first t_start to the last t_stop:
    "leave-out", or "silent", as if they did; when None, at most 10 % of the segments are left out, with a line. A unit
    without a spike train in a segment is silent there, with a line.
    where, leave_out: the segments to read and to leave out, by their annotations, as of `nt.read`.
    Raises InputError for another object, for segments without spike trains or classes, for times beyond any clock, and
    for a clock that would lose more spikes.

    >>> import neurotact as nt
    >>> spikes = nt.encode(nt.simulate("gratings", trials=1, duration_s=0.3))
    >>> len(from_neo(to_neo(spikes))) == len(spikes)
    True
    """
    _neo()
    segments: list[Any] = list(getattr(block, "segments", ()))
    if not segments or not all(len(segment.spiketrains) for segment in segments):
        raise InputError("block: must be a neo.Block whose segments each hold spike trains; drop segments without any")
    conditions = _conditions(segments, label)
    choice = TrialChoice.of(where, leave_out).with_label(label)
    keep = choice.keeps(conditions, "block")
    if choice:
        choice.say(keep, "block")
    segments, conditions = _chosen(segments, conditions, keep)
    rate_Hz, is_own = _clock(block, segments, step_ms)
    recorded_Hz = block.annotations.get("recorded_Hz")
    afferents = _afferents(segments)
    keep = observed_trials(
        _observed(segments, afferents, 1 / rate_Hz), afferents, unobserved, "block",
        fix="give all spike trains of a segment the same t_start and t_stop, if {} was observed throughout",
    )  # fmt: skip
    segments, conditions = _chosen(segments, conditions, keep)
    n_spikes = sum(len(train) for segment in segments for train in segment.spiketrains)
    check_size(f"block: {n_spikes} spikes", BYTES_PER_EVENT * n_spikes)
    places = {name: column for column, name in enumerate(afferents)}
    trials = [_trial(segment, trial, rate_Hz, places) for trial, segment in enumerate(segments)]
    return trains_with_ends(
        [(trial.times, trial.units) for trial in trials], joined_times([trial.end for trial in trials]), rate_Hz,
        afferents, conditions, "block",
        merge_events=merge_events, fix="check t_start and t_stop of its spike trains",
        told=[[str(segment.annotations.get(key, "")) for segment in segments] for key in (DIGEST, TOUCH)],
        encoder=_encoder(block) if is_own else None, source=str(block.annotations.get("source", "")),
        recorded_Hz=float(recorded_Hz) if isinstance(recorded_Hz, (int, float)) else None,
    )  # fmt: skip


def _clock(block: Any, segments: Sequence[Any], step_ms: float | None) -> tuple[float, bool]:
    """Steps per second, and whether they are those of the block."""
    own_Hz = block.annotations.get("sampling_rate_Hz")
    if own_Hz is None:
        given = segments[0].spiketrains[0].sampling_rate
        given_Hz = NOT_SAID_HZ if given is None else float(given.rescale("Hz").magnitude)
        own_Hz = 1e3 if given_Hz == NOT_SAID_HZ else given_Hz
    rate_Hz = float(own_Hz) if step_ms is None else 1e3 / step_ms if step_ms > 0 else math.nan
    if not (math.isfinite(rate_Hz) and rate_Hz > 0):
        raise InputError(f"step_ms: must be a positive number; got {step_ms if step_ms is not None else own_Hz}")
    return rate_Hz, rate_Hz == own_Hz


def _names(segment: Any) -> list[str]:
    return [str(train.name) if train.name else f"unit{number}" for number, train in enumerate(segment.spiketrains)]


def _afferents(segments: Sequence[Any]) -> tuple[str, ...]:
    afferents: dict[str, None] = {}
    for trial, segment in enumerate(segments):
        names = _names(segment)
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"block: segment {trial} has two spike trains called '{twice[:40]}'; rename one of them")
        afferents |= dict.fromkeys(names)
    if len(afferents) > MOST_AFFERENTS:
        raise InputError(f"block: has {len(afferents)} units, more than {MOST_AFFERENTS}; keep fewer")
    return tuple(afferents)


def _chosen(segments: Sequence[Any], conditions: pd.DataFrame, keep: np.ndarray) -> tuple[list[Any], pd.DataFrame]:
    kept = [segment for segment, is_kept in zip(segments, keep, strict=True) if is_kept]
    return kept, conditions[keep].reset_index(drop=True)


def _observed(segments: Sequence[Any], afferents: Sequence[str], step_s: float) -> np.ndarray:
    """Which units each segment observes from its beginning to its end, to a step, `(unit, segment)`.

    A unit without a spike train is taken as silent, and a line counts them.
    """
    observed = np.ones((len(afferents), len(segments)), bool)
    places, n_absent = {name: column for column, name in enumerate(afferents)}, 0
    for trial, segment in enumerate(segments):
        spans = [
            [float(end.rescale("s").magnitude) for end in (unit.t_start, unit.t_stop)] for unit in segment.spiketrains
        ]
        starts_s, stops_s = np.array(spans).T
        is_whole = (starts_s <= starts_s.min() + step_s) & (stops_s >= stops_s.max() - step_s)
        observed[[places[name] for name in _names(segment)], trial] = is_whole
        n_absent += len(spans) < len(afferents)
    if n_absent:
        log.warning(
            "block: %d of %d segments lack spike trains of some units, which are silent there", n_absent, len(segments)
        )
    return observed


class _Trial(NamedTuple):
    """The spikes of a segment from its beginning on: their times and the unit of each; and the time of its end."""

    times: EventTimes
    units: np.ndarray
    end: EventTimes


def _trial(segment: Any, trial: int, rate_Hz: float, places: dict[str, int]) -> _Trial:
    trains = segment.spiketrains
    start_s = min(float(train.t_start.rescale("s").magnitude) for train in trains)
    stop_s = max(float(train.t_stop.rescale("s").magnitude) for train in trains)
    if not 0 <= (stop_s - start_s) * rate_Hz <= LONGEST_STEPS:
        raise InputError(f"block: segment {trial} lasts from {start_s:g} s to {stop_s:g} s; no clock holds it")
    times = [_times(train) for train in trains]
    units = np.repeat([places[name] for name in _names(segment)], [len(unit.time_s) for unit in times])
    ends = joined_times([_times(train.t_stop) for train in trains])
    last = ends.at(np.array([int(ends.time_s.argmax())]))
    return _Trial(joined_times(times).since(start_s), units, last.since(start_s))


def _times(quantity: Any) -> EventTimes:
    return event_times(np.atleast_1d(np.asarray(quantity.magnitude)), float(quantity.units.rescale("s").magnitude))


def _conditions(segments: Sequence[Any], label: str) -> pd.DataFrame:
    for trial, segment in enumerate(segments):
        if label not in segment.annotations:
            known = ", ".join(map(str, segment.annotations)) or "it has none"
            raise InputError(f"block: segment {trial} has no annotation '{label}' ({known}); give another `label`")
    shared = [
        key for key, value in segments[0].annotations.items()
        if key not in (label, LABEL, DIGEST, TOUCH) and isinstance(value, (bool, int, float, str))
        and all(type(segment.annotations.get(key)) is type(value) for segment in segments)
    ]  # fmt: skip
    columns = {key: [segment.annotations[key] for segment in segments] for key in shared}
    return pd.DataFrame({LABEL: [str(segment.annotations[label]) for segment in segments], **columns})


def _encoder(block: Any) -> dict[str, Any]:
    try:
        encoder = json.loads(block.annotations.get("encoder", "{}"))
    except (TypeError, ValueError, RecursionError):
        return {}
    return encoder if isinstance(encoder, dict) else {}


def _neo() -> Any:
    return optional("neo", "neo: cannot be imported ({}); pip install 'neurotact[neuro]'")
