"""Events of any sensor to spikes on a clock: trial, channel, population (such as ON and OFF) and time of each."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.readers.clock.stamps import of_length
from neurotact_parts.readers.events.times import (
    FLOAT_ERROR,
    MOST_COMPARED,
    EventTimes,
    InOrder,
    joined_times,
    lengths_of,
    rounding_of,
    steps_of,
)

from neurotact.data.readers.specs import MOST_AFFERENTS as MOST_AFFERENTS
from neurotact.data.readers.specs import EventSpec as EventSpec
from neurotact.data.recordings import LABEL, check_named_classes
from neurotact.data.spikes import SpikeTrains, TrialSpikes, from_trials
from neurotact.data.windows import LONGEST_STEPS
from neurotact.errors import InputError, some
from neurotact.files import check_size
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

ROW = 2**31
"""Offset between rows of a grid, before its width is known."""
BYTES_PER_EVENT = 100
"""Memory per event during binning."""
MOST_MERGED = 0.01
"""Share of the events that may become one spike with another without being asked."""
COARSE = 0.5
"""Share of a step from which on times that their type rounds to it fall into a step by chance."""
OF_UNIT = "give their unit with `time_unit`, or divide sample numbers by their rate"
OF_EVENTS = "if the unit of the times is another, give it with `time_unit`; divide sample numbers by their rate"
"""What to do about trials of events that are too short or too long."""
ON_OFF = ("OFF", "ON")
"""The lower and the higher value of a polarity."""


class Events(NamedTuple):
    """Events, unordered: the time in s from the origin of their trial, the channel (a number or a name), the polarity
    or the name of a population (None if there is none) and the trial of each, `(event,)`; and one row of conditions per
    trial, with `label`.

    is_grid: channels are positions on a sensor's grid, `ROW * y + x`. ignored: columns that change within a trial
    and are not used; other: arrays of another length.
    error_s: of each time; resolutions: as of `EventTimes`. n_back: events that are earlier than the one before them in
    the file; n_wraps: how often its counter began again. has_unit: whether anything but custom says the unit of times
    that are whole numbers. n_channels: how many the file has rows for, with events or without; 0 if it does not say.
    """

    time_s: np.ndarray
    channel: np.ndarray
    population: np.ndarray | None
    trial: np.ndarray
    conditions: pd.DataFrame
    is_grid: bool = False
    ignored: tuple[str, ...] = ()
    other: tuple[str, ...] = ()
    error_s: np.ndarray | float = 0.0
    resolutions: tuple = ()
    n_back: int = 0
    n_wraps: int = 0
    has_unit: bool = True
    n_channels: int = 0

    @property
    def times(self) -> EventTimes:
        return EventTimes(self.time_s, np.broadcast_to(self.error_s, self.time_s.shape), self.resolutions)


class _Named(NamedTuple):
    """A name for each event, as an index into names: `(event,)` int64."""

    index: np.ndarray
    names: tuple[str, ...]


def to_trains(events: Events, spec: EventSpec, source: str) -> SpikeTrains:
    """The spikes of every trial on a clock of `spec.step_ms`; all trials are of one length.

    Afferents are named `POPULATION CHANNEL`, or by the channel alone if there are no populations, ordered by
    population. `source` begins messages. Raises InputError, which names the fault.

    >>> events = Events(np.array([0.001, 0.0012, 0.007]), np.array([0, 1, 2]), np.array([1, 1, 0]), np.zeros(3, int),
    ...                 pd.DataFrame({"label": ["felt"]}))
    >>> trains = to_trains(events, EventSpec(step_ms=5), "touch.npz")
    >>> trains.steps[0].tolist(), [trains.afferents[unit] for unit in trains.units[0]]
    ([0, 0, 1], ['ON channel0', 'ON channel1', 'OFF channel2'])
    """
    if not len(events.conditions) or not len(events.time_s):
        raise InputError(f"{source}: holds no {'event' if len(events.conditions) else 'trial'}; give at least one")
    check_named_classes(events.conditions[LABEL].tolist(), source)
    check_size(f"{source}: {len(events.time_s)} events", BYTES_PER_EVENT * len(events.time_s))
    populations = _populations(events, spec, source)
    keep = np.ones(len(events.time_s), bool)
    if spec.polarity in ("on", "off") and populations is not None:
        keep = populations.index == (len(populations.names) - 1 if spec.polarity == "on" else 0)
    channels = _grid(events.channel, spec, source) if events.is_grid else _channels(events, spec, source)
    afferents, units = _afferents(populations if spec.polarity == "separate" else None, channels, source)
    order = np.argsort(events.trial, kind="stable")
    of_trials = np.split(order, np.searchsorted(events.trial[order], np.arange(1, len(events.conditions))))
    times = events.times
    trials = [TrialEvents(partial(times.at, mine), units[mine], keep[mine]) for mine in of_trials]
    orders = InOrder(times.time_s, events.n_back, events.n_wraps)
    return trains_of(trials, [orders], spec, afferents, events.conditions, source, has_unit=events.has_unit)


class TrialEvents(NamedTuple):
    """The events of a trial: a function that returns their times, their afferents, and which of them become spikes."""

    times: Callable[[], EventTimes]
    units: np.ndarray
    keep: np.ndarray | None = None


def trains_of(
    trials: Sequence[TrialEvents],
    orders: Sequence[InOrder],
    spec: EventSpec,
    afferents: Sequence[str],
    conditions: pd.DataFrame,
    source: str,
    *,
    has_unit: bool = True,
) -> SpikeTrains:
    """The spikes of trials, which are binned one by one: files may hold many millions of events.

    orders: what was found of the order of events. has_unit: whether anything but custom says the unit of their times.
    """
    n_events, step_s = sum(len(trial.units) for trial in trials), 1e-3 * spec.step_ms
    every = max(1, n_events // MOST_COMPARED)
    probes, first_s, last_s, n_coarse, coarsest_s = [], np.inf, 0.0, 0, 0.0
    for number, trial in enumerate(trials):
        times = trial.times()
        probes.append(times.at(np.arange(number % every, len(times.time_s), every)))
        first_s, last_s = (min(first_s, times.time_s.min(initial=np.inf)), max(last_s, times.time_s.max(initial=0.0)))
        error_s = times.error_s / FLOAT_ERROR
        n_coarse += int((error_s >= COARSE * step_s).sum())
        coarsest_s = max(coarsest_s, float(error_s.max(initial=0.0)))
    _check_range(first_s, last_s, spec, source)
    rounding = rounding_of(joined_times(probes), step_s)
    steps = [steps_of(trial.times(), step_s, rounding) for trial in trials]
    n_steps = max(int(row.max(initial=0)) for row in steps) + 1
    if spec.duration_ms is not None:
        n_steps = max(1, round(spec.duration_ms / spec.step_ms))
    every_one = (slice(None) if trial.keep is None else trial.keep for trial in trials)
    rows = ((row[keep], trial.units[keep], n_steps) for row, trial, keep in zip(steps, trials, every_one, strict=True))
    binned = on_clock(rows, len(afferents))
    _say_order(sum(order.n_back for order in orders), sum(order.n_wraps for order in orders), n_events, source)
    if binned.n_late:
        log.warning("%s: %d of %d events are after `duration_ms` and left out", source, binned.n_late, binned.n_events)
    say_merged(binned, step_s, source, accept=spec.merge_events)
    if not has_unit:
        log.warning("%s: the times are whole numbers without a unit, taken as seconds; %s", source, OF_UNIT)
    _say_length([n_steps], 1e3 / spec.step_ms, OF_EVENTS, source)
    if n_coarse:
        log.warning(
            "%s: %d of %d times have a resolution of %.3g us by their type or their digits, of a step of %g ms: save "
            "them as float64 with all digits, or give a longer `step_ms`",
            source, n_coarse, n_events, 1e6 * coarsest_s, spec.step_ms,
        )  # fmt: skip
    return from_trials(binned.trials, 1e3 / spec.step_ms, tuple(afferents), conditions, source=source)


def _populations(events: Events, spec: EventSpec, source: str) -> _Named | None:
    """The population of each event; numeric polarities get the names of the spec."""
    if events.population is None:
        if spec.polarity != "separate":
            raise InputError(f"{source}: holds no polarity, so `polarity={spec.polarity!r}` selects nothing; drop it")
        if spec.polarities:
            raise InputError(f"{source}: holds no polarity, so `polarities` names nothing; drop it")
        return None
    if spec.polarity != "separate" and spec.polarities:
        raise InputError(
            f"{source}: `polarity={spec.polarity!r}` makes one population without a name; drop `polarities`"
        )
    if spec.polarity == "merge":
        return None
    populations = _numbered(events.population, spec, source)
    if spec.polarity != "separate" and len(populations.names) != 2:
        raise InputError(f"{source}: has {len(populations.names)} populations, not two polarities; drop `polarity`")
    return populations


def _numbered(population: np.ndarray, spec: EventSpec, source: str) -> _Named:
    values, index = np.unique(population, return_inverse=True)
    if population.dtype.kind not in "iufb":
        names = tuple(str(value) for value in values)
        wrong = [name for name in names if not name.strip() or " " in name]
        if wrong:
            raise InputError(f"{source}: the population {wrong[0]!r} is not a single word; rename it")
        if spec.polarities:
            raise InputError(f"{source}: its populations have names ({some(names)}); drop `polarities`")
        return _Named(index, names)
    found = {*values.tolist()}
    expected = sorted(found | ({0, 1} if found <= {0, 1} else {-1, 1} if found == {-1} else set()))
    names = spec.polarities or ON_OFF[: len(expected)]
    if spec.polarity != "separate":
        names = tuple(map(str, expected))
    if len(expected) != len(names):
        raise InputError(
            f"{source}: has {len(expected)} polarities ({', '.join(map(str, expected[:5]))}) but "
            f"{len(names)} names for them; name each with `polarities`"
        )
    return _Named(np.searchsorted(expected, values)[index], names)


def _channels(events: Events, spec: EventSpec, source: str) -> _Named:
    channel = events.channel
    if spec.sensor:
        raise InputError(f"{source}: has channels, not places x and y on a grid; drop `sensor`, or give `n_channels`")
    if channel.dtype.kind not in "iu":
        if spec.n_channels:
            raise InputError(f"{source}: its channels have names, not numbers; name them all with `channels` instead")
        values, index = np.unique(channel, return_inverse=True)
        names = tuple(str(value) for value in values)
        if spec.channels and set(names) - set(spec.channels):
            raise InputError(
                f"{source}: the channel '{sorted(set(names) - set(spec.channels))[0]}' is not in `channels`"
            )
        wanted = spec.channels or names
        positions = np.array([wanted.index(name) for name in names], np.int64)
        return _Named(positions[index], wanted)
    if channel.min() < 0:
        raise InputError(f"{source}: channel {channel.min()} is negative; number channels from 0")
    n_found = max(int(channel.max()) + 1, events.n_channels)
    return _Named(channel.astype(np.int64), channel_names(n_found, spec, source))


def channel_names(n_found: int, spec: EventSpec, source: str) -> tuple[str, ...]:
    """Names of numbered channels; the highest with an event is `n_found - 1`."""
    if spec.n_channels and spec.channels:
        raise InputError(f"{source}: `channels` says how many channels there are; drop `n_channels`")
    n_channels = spec.n_channels or len(spec.channels) or n_found
    if n_found > n_channels:
        raise InputError(
            f"{source}: channel {n_found - 1} has events, but there are {n_channels} channels, 0 to {n_channels - 1}; "
            "give as many names in `channels`, or another `n_channels`"
        )
    if n_channels > MOST_AFFERENTS:
        raise InputError(f"{source}: has {n_channels} channels, more than {MOST_AFFERENTS}; use fewer")
    return spec.channels or tuple(f"channel{i}" for i in range(n_channels))


def _grid(places: np.ndarray, spec: EventSpec, source: str) -> _Named:
    """The channels of a grid, row by row, with names such as `x3y5`."""
    if spec.channels or spec.n_channels:
        wrong = "`channels`" if spec.channels else "`n_channels`"
        raise InputError(f"{source}: its channels are places x and y on a grid; drop {wrong}, `sensor` gives its size")
    x, y = places % ROW, places // ROW
    width, height = map(int, spec.sensor.split("x")) if spec.sensor else (int(x.max()) + 1, int(y.max()) + 1)
    if x.max() >= width or y.max() >= height or width * height > MOST_AFFERENTS:
        raise InputError(
            f"{source}: events come from a grid of {x.max() + 1}x{y.max() + 1}, but `sensor` is {width}x{height} and "
            f"the limit is {MOST_AFFERENTS} channels; give another `sensor`"
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


def _check_range(first_s: float, last_s: float, spec: EventSpec, source: str) -> None:
    """Refuse times of events that no clock holds."""
    if first_s < 0:
        raise InputError(f"{source}: an event is at {first_s:g} s, before zero; pass `origin='first'`")
    end_s = last_s if spec.duration_ms is None else 1e-3 * spec.duration_ms
    if max(last_s, end_s) * 1e3 / spec.step_ms >= LONGEST_STEPS:
        raise InputError(
            f"{source}: an event at {last_s:g} s is beyond any clock of {spec.step_ms:g} ms; give `time_unit`, or "
            "`origin='first'` if times count from long before"
        )


def _say_length(n_steps: Sequence[int] | np.ndarray, rate_Hz: float, fix: str, source: str) -> None:
    """Warn of a median trial that is too short or too long for touch. n_steps: of each trial; fix: ends the line."""
    for doubt in of_length(float(np.median(n_steps)) / rate_Hz, fix):
        log.warning("%s: %s", source, doubt)


class OnClock(NamedTuple):
    """The spikes of trials, the number of their events, and of those that are left out, after the end of their trial.

    Events that share a step and an afferent with another are merged with it.
    """

    trials: list[TrialSpikes]
    n_events: int
    n_late: int

    @property
    def n_merged(self) -> int:
        return self.n_events - self.n_late - sum(len(trial.steps) for trial in self.trials)


def on_clock(trials: Iterable[tuple[np.ndarray, np.ndarray, int]], n_afferents: int) -> OnClock:
    """The spikes of trials, of each the step and the afferent of its events, `(event,)`, and its length in steps.

    >>> found = on_clock([(np.array([4, 1, 1, 20]), np.array([0, 1, 1, 0]), 10)], n_afferents=2)
    >>> found.trials[0].steps.tolist(), found.n_merged, found.n_late
    ([1, 4], 1, 1)
    """
    rows, n_events, n_late = [], 0, 0
    for steps, units, n_steps in trials:
        is_late = steps >= n_steps
        n_events += len(steps)
        n_late += int(is_late.sum())
        spikes = np.unique((steps * n_afferents + units.astype(np.int64))[~is_late])
        rows.append(TrialSpikes(spikes // n_afferents, (spikes % n_afferents).astype(np.uint16), n_steps))
    return OnClock(rows, n_events, n_late)


def trains_with_ends(
    events: Sequence[tuple[EventTimes, np.ndarray]],
    ends: EventTimes,
    rate_Hz: float,
    afferents: Sequence[str],
    conditions: pd.DataFrame,
    where: str,
    *,
    merge_events: bool,
    fix: str,
    told: Sequence[Sequence[str]],
    **about: Any,
) -> SpikeTrains:
    """The spikes of trials of lengths of their own; a spike at the end of its trial falls in the last step.

    events: of each trial, the times from its beginning and the afferents. ends: of the trials, from their beginnings.
    fix: about a length that is none of touch. told: the digests and the touches of trials, if any. about: as of
    `from_trials`.
    """
    rounding = rounding_of(joined_times([times for times, _ in events]), 1 / rate_Hz)
    lengths = lengths_of(ends, 1 / rate_Hz, rounding).tolist()
    steps = (
        (steps_of(times, 1 / rate_Hz, rounding).clip(0, n_steps - 1), units, n_steps)
        for (times, units), n_steps in zip(events, lengths, strict=True)
    )
    binned = on_clock(steps, len(afferents))
    say_merged(binned, 1 / rate_Hz, where, accept=merge_events)
    _say_length(lengths, rate_Hz, fix, where)
    digests, touches = (names or [""] * len(binned.trials) for names in told)
    named = zip(binned.trials, digests, touches, strict=True)
    trials = (row._replace(digest=digest, touch=touch) for row, digest, touch in named)
    return from_trials(trials, rate_Hz, tuple(afferents), conditions, **about)


def say_merged(binned: OnClock, step_s: float, source: str, *, accept: bool, step: str = "`step_ms`") -> None:
    """Say how many events are merged; InputError if they are more than `MOST_MERGED`, unless `accept`.

    step: what sets the clock.
    """
    if not binned.n_merged:
        return
    n_events = binned.n_events - binned.n_late
    share = binned.n_merged / n_events
    what = f"{source}: {binned.n_merged} of {n_events} events ({100 * share:.3g} %) share a step of {1e3 * step_s:g} ms"
    if share > MOST_MERGED and not accept:
        unit = "check the unit of the times, " if share > 0.5 else ""
        fix = f"{unit}give a shorter {step}, or make one spike of them with `merge_events=True`"
        raise InputError(f"{what} and a channel with another and would be lost; {fix}")
    log.warning("%s and a channel with another and are one spike with it", what)


def _say_order(n_back: int, n_wraps: int, n_events: int, source: str) -> None:
    """Say what was found of a file whose stamps do not rise."""
    if n_wraps:
        log.warning("%s: a counter begins again %d times; the stamps after it count on", source, n_wraps)
    if n_back:
        log.warning(
            "%s: %d of %d events are earlier than the one before them and are put in order of time; if the clock was "
            "set back there, cut the file", source, n_back, n_events,
        )  # fmt: skip


def joined(parts: Sequence[Events]) -> Events:
    """Events of several files, concatenated."""
    starts = np.cumsum([0, *(len(part.conditions) for part in parts)])
    populations = [part.population for part in parts]
    times = joined_times([part.times for part in parts])
    return Events(
        times.time_s,
        np.concatenate([part.channel for part in parts]),
        np.concatenate([part for part in populations if part is not None]) if populations[0] is not None else None,
        np.concatenate([part.trial + start for part, start in zip(parts, starts, strict=False)]),
        pd.concat([part.conditions for part in parts], ignore_index=True),
        all(part.is_grid for part in parts),
        tuple(dict.fromkeys(name for part in parts for name in part.ignored)),
        tuple(dict.fromkeys(name for part in parts for name in part.other)),
        times.error_s,
        times.resolutions,
        sum(part.n_back for part in parts),
        sum(part.n_wraps for part in parts),
        all(part.has_unit for part in parts),
        max(part.n_channels for part in parts),
    )
