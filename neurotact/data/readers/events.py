"""Events of any sensor to spikes on a clock: trial, channel, population (such as ON and OFF) and time of each."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field, field_validator

from neurotact.data.readers.clock import Unit
from neurotact.data.spikes import SpikeTrains, TrialSpikes, from_trials
from neurotact.data.windows import LONGEST_STEPS
from neurotact.errors import InputError
from neurotact.files import check_size
from neurotact.spec import Spec

MOST_AFFERENTS = 65_536
ROW = 2**31
"""Offset between rows of a grid, before its width is known."""
SLACK = 1e-6
"""Tolerance as a share of a step, for times that count from long before the trial and are rounded."""
BYTES_PER_EVENT = 64
"""Memory per event during binning."""
ON_OFF = ("OFF", "ON")
"""The lower and the higher value of a polarity."""


class EventSpec(Spec):
    """How events become spikes."""

    step_ms: float = Field(default=1.0, gt=0)
    """The clock; events of an afferent within one step are one spike."""
    time_unit: Unit | None = None
    """Unit of the times; when absent, from the file (`time_us`), microseconds for x, y, t, p arrays, else seconds."""
    origin: Literal["zero", "first"] = "zero"
    """The start of a trial: time zero, or its first event."""
    duration_ms: float | None = Field(default=None, gt=0)
    """Length of every trial, later events are dropped; up to the last event of all when absent."""
    polarity: Literal["separate", "merge", "on", "off"] = "separate"
    """One population per polarity; one for both; or only the events of one polarity."""
    polarities: tuple[str, ...] = ON_OFF
    """Names of the polarities, from the lowest value."""
    channels: tuple[str, ...] = ()
    """Names of the channels, from channel 0."""
    n_channels: int | None = Field(default=None, ge=1, le=MOST_AFFERENTS)
    """Number of channels, including those without events; up to the highest with an event when absent."""

    sensor: str | None = Field(default=None, pattern=r"^[1-9]\d{0,4}x[1-9]\d{0,4}$")
    """Columns and rows of the grid of x, y, t, p events (`34x34`); up to the last with an event when absent."""

    @field_validator("polarities", "channels", mode="before")
    @classmethod
    def _apart(cls, names: object) -> object:
        return tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else names


class Events(NamedTuple):
    """Events, unordered: the time in s, the channel (a number or a name), the polarity or the name of a population
    (None if there is none) and the trial of each, `(event,)`; and one row of conditions per trial, with `label`.

    is_grid: channels are positions on a sensor's grid, `ROW * y + x`. ignored: columns that are not used.
    """

    time_s: np.ndarray
    channel: np.ndarray
    population: np.ndarray | None
    trial: np.ndarray
    conditions: pd.DataFrame
    is_grid: bool = False
    ignored: tuple[str, ...] = ()


class _Named(NamedTuple):
    """A name for each event, as an index into names: `(event,)` int64."""

    index: np.ndarray
    names: tuple[str, ...]


def to_trains(events: Events, spec: EventSpec, source: str) -> SpikeTrains:
    """The spikes of every trial on a clock of `spec.step_ms`; all trials are of one length.

    Afferents are named `POPULATION CHANNEL`, or by the channel alone if there are no populations, ordered by
    population. `source` begins messages. Raises InputError, which names the fault.

    >>> events = Events(np.array([0.001, 0.0012, 0.007]), np.array([0, 0, 2]), np.array([1, 1, 0]), np.zeros(3, int),
    ...                 pd.DataFrame({"label": ["felt"]}))
    >>> trains = to_trains(events, EventSpec(step_ms=5), "touch.npz")
    >>> trains.afferents[0], trains.steps[0].tolist(), [trains.afferents[unit] for unit in trains.units[0]]
    ('OFF channel0', [0, 1], ['ON channel0', 'OFF channel2'])
    """
    _check(events, source)
    check_size(f"{source}: {len(events.time_s)} events", BYTES_PER_EVENT * len(events.time_s))
    populations = _populations(events, spec, source)
    keep = np.arange(len(events.time_s))
    if spec.polarity in ("on", "off") and populations is not None:
        keep = np.flatnonzero(populations.index == (len(populations.names) - 1 if spec.polarity == "on" else 0))
    channels = _grid(events.channel, spec, source) if events.is_grid else _channels(events.channel, spec, source)
    afferents, units = _afferents(populations if spec.polarity == "separate" else None, channels, source)
    time_s = _from_origin(events, spec)
    n_steps = clock_of(float(time_s.min()), float(time_s.max()), spec, source)
    order = keep[np.argsort(events.trial[keep], kind="stable")]
    ends = np.searchsorted(events.trial[order], np.arange(1, len(events.conditions)))
    trials = (
        one_trial(time_s[mine], units[mine], spec.step_ms, n_steps, len(afferents)) for mine in np.split(order, ends)
    )
    return from_trials(trials, 1e3 / spec.step_ms, afferents, events.conditions, source=source)


def _from_origin(events: Events, spec: EventSpec) -> np.ndarray:
    if spec.origin == "zero":
        return events.time_s
    first = np.full(len(events.conditions), np.inf)
    np.minimum.at(first, events.trial, events.time_s)
    return events.time_s - first[events.trial]


def _check(events: Events, source: str) -> None:
    if not len(events.conditions):
        raise InputError(f"{source}: holds no trial; give at least one")
    if not len(events.time_s):
        raise InputError(f"{source}: holds no event; give at least one")
    wrong = np.flatnonzero(~np.isfinite(events.time_s))
    if len(wrong):
        raise InputError(f"{source}: the time of event {wrong[0]} is {events.time_s[wrong[0]]}; drop the event")


def _populations(events: Events, spec: EventSpec, source: str) -> _Named | None:
    """The population of each event; numeric polarities get the names of the spec."""
    if events.population is None:
        if spec.polarity in ("on", "off"):
            raise InputError(f"{source}: holds no polarity, so --polarity {spec.polarity} selects nothing; drop it")
        return None
    values, index = np.unique(events.population, return_inverse=True)
    if values.dtype.kind not in "iufb":
        names = tuple(str(value) for value in values)
        wrong = [name for name in names if not name.strip() or " " in name]
        if wrong:
            raise InputError(f"{source}: the population {wrong[0]!r} is not a single word; rename it")
        if spec.polarity in ("on", "off") and len(names) != 2:
            raise InputError(f"{source}: has {len(names)} populations, not two polarities; drop --polarity")
        return _Named(index, names)
    expected = sorted({*values.tolist()} | ({0, 1} if {*values.tolist()} <= {0, 1} else set()))
    expected = sorted({*expected} | ({-1, 1} if {*values.tolist()} == {-1} else set()))
    if len(expected) > len(spec.polarities):
        raise InputError(
            f"{source}: has {len(expected)} polarities ({', '.join(map(str, expected[:5]))}) but "
            f"{len(spec.polarities)} names for them; name each with --polarities"
        )
    return _Named(np.searchsorted(expected, values)[index], spec.polarities[: len(expected)])


def _channels(channel: np.ndarray, spec: EventSpec, source: str) -> _Named:
    if channel.dtype.kind not in "iu":
        values, index = np.unique(channel, return_inverse=True)
        names = tuple(str(value) for value in values)
        if spec.channels and set(names) - set(spec.channels):
            raise InputError(
                f"{source}: the channel '{sorted(set(names) - set(spec.channels))[0]}' is not in --channels"
            )
        wanted = spec.channels or names
        place = np.array([wanted.index(name) for name in names], np.int64)
        return _Named(place[index], wanted)
    if channel.min() < 0:
        raise InputError(f"{source}: channel {channel.min()} is negative; number channels from 0")
    return _Named(channel.astype(np.int64), channel_names(int(channel.max()) + 1, spec, source))


def channel_names(n_found: int, spec: EventSpec, source: str) -> tuple[str, ...]:
    """Names of numbered channels; the highest with an event is `n_found - 1`."""
    n_channels = spec.n_channels or len(spec.channels) or n_found
    if n_found > n_channels or (spec.channels and len(spec.channels) != n_channels):
        raise InputError(
            f"{source}: channel {n_found - 1} has events, but there are {n_channels} channels, 0 to {n_channels - 1}; "
            "give as many names in --channels, or another --n-channels"
        )
    if n_channels > MOST_AFFERENTS:
        raise InputError(f"{source}: has {n_channels} channels, more than {MOST_AFFERENTS}; use fewer")
    return spec.channels or tuple(f"channel{i}" for i in range(n_channels))


def _grid(places: np.ndarray, spec: EventSpec, source: str) -> _Named:
    """The channels of a grid, row by row, with names such as `x3y5`."""
    x, y = places % ROW, places // ROW
    width, height = map(int, spec.sensor.split("x")) if spec.sensor else (int(x.max()) + 1, int(y.max()) + 1)
    if x.max() >= width or y.max() >= height or width * height > MOST_AFFERENTS:
        raise InputError(
            f"{source}: events come from a grid of {x.max() + 1}x{y.max() + 1}, but --sensor is {width}x{height} and "
            f"the limit is {MOST_AFFERENTS} channels; give another --sensor"
        )
    return _Named(y * width + x, tuple(f"x{column}y{row}" for row in range(height) for column in range(width)))


def _afferents(populations: _Named | None, channels: _Named, source: str) -> tuple[tuple[str, ...], np.ndarray]:
    """The names of all afferents, and the afferent of each event."""
    if populations is None:
        return tuple(name.replace(" ", "_") for name in channels.names), channels.index
    names = tuple(f"{population} {channel}" for population in populations.names for channel in channels.names)
    if len(names) > MOST_AFFERENTS:
        raise InputError(f"{source}: makes {len(names)} afferents, more than {MOST_AFFERENTS}; use fewer channels")
    return names, populations.index * len(channels.names) + channels.index


def clock_of(first_s: float, last_s: float, spec: EventSpec, source: str) -> int:
    """The length of trials in steps, for events between two times; InputError if no clock holds them."""
    if first_s < 0:
        raise InputError(f"{source}: an event is at {first_s:g} s, before zero; pass --origin first")
    end_s = last_s if spec.duration_ms is None else 1e-3 * spec.duration_ms
    if max(last_s, end_s) * 1e3 / spec.step_ms >= LONGEST_STEPS:
        raise InputError(
            f"{source}: an event at {last_s:g} s is beyond any clock of {spec.step_ms:g} ms; give --time-unit, or "
            "--origin first if times count from long before"
        )
    if spec.duration_ms is not None:
        return max(1, round(spec.duration_ms / spec.step_ms))
    return math.floor(last_s * 1e3 / spec.step_ms + 1e-9) + 1


def one_trial(
    time_s: np.ndarray, units: np.ndarray, step_ms: float, n_steps: int, n_afferents: int, slack: float = 1e-9
) -> TrialSpikes:
    """The events of one trial on the clock: those of an afferent within one step are one spike; later ones are dropped.

    slack: share of a step by which an event may lie before it because of rounding.

    >>> one_trial(np.array([0.004, 0.001, 0.0012, 0.02]), np.array([0, 1, 1, 0]), 1.0, 10, 2).steps.tolist()
    [1, 4]
    """
    steps = np.floor(time_s * (1e3 / step_ms) + slack).astype(np.int64)
    spikes = np.unique(steps * n_afferents + units.astype(np.int64))
    spikes = spikes[: np.searchsorted(spikes, n_steps * n_afferents)]
    return TrialSpikes(spikes // n_afferents, (spikes % n_afferents).astype(np.uint16), n_steps)


def joined(parts: Sequence[Events]) -> Events:
    """Events of several files, concatenated."""
    starts = np.cumsum([0, *(len(part.conditions) for part in parts)])
    populations = [part.population for part in parts]
    return Events(
        np.concatenate([part.time_s for part in parts]),
        np.concatenate([part.channel for part in parts]),
        None
        if any(each is None for each in populations)
        else np.concatenate([each for each in populations if each is not None]),
        np.concatenate([part.trial + start for part, start in zip(parts, starts, strict=False)]),
        pd.concat([part.conditions for part in parts], ignore_index=True),
        all(part.is_grid for part in parts),
        tuple(dict.fromkeys(name for part in parts for name in part.ignored)),
    )
