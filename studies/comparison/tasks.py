"""The recognition tasks for every family of classifiers, each as features and as sequences.

This module makes two tasks; the others come from their protocols.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.studies.compliance import simulator as compliance
from neurotact_parts.studies.compliance.flops import CurveFeatures, TactileMoments
from neurotact_parts.studies.task_data import TaskData
from neurotact_parts.studies.texture import reader as fabricslide
from neurotact_parts.studies.texture import simulator as gratings
from neurotact_parts.studies.touch_modality import protocol as touch_modality
from neurotact_parts.studies.touch_modality.datasets import TOUCH_SAMPLES, window_bounds
from pydantic import Field
from sklearn.model_selection import GroupShuffleSplit

from neurotact.data.conditioning import ConditioningSpec, condition
from neurotact.data.dataset import expand
from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.splits import Split, SplitSpec, split_trials
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Layer, Moments, MovingAverage, changed, in_registers, passed, with_weights
from neurotact.metrics.signal_flops import Averaging, BaselineRemoval, Interpolation
from neurotact.spec import Spec
from neurotact.studies.way import module_of

CLOCK_HZ = 1000.0
"""Sequences of a higher rate are averaged to it; afferents run on this clock."""


class GratingsTask(Spec):
    """Recognition of eight sliding gratings, at any of three forces and two speeds."""

    simulation: gratings.GratingsSpec = gratings.GratingsSpec(trials=12)
    start_ms: float = Field(default=250.0, ge=0)
    """Start of the window, after the transient of the moving average."""
    length_ms: float = Field(default=500.0, gt=0)


class FabricsTask(Spec):
    """Recognition of seven sliding fabrics (FabricSlide)."""

    path: str = "$NEUROTACT_DATA/fabricslide/fabric"
    start_ms: float = Field(default=500.0, ge=0)
    length_ms: float = Field(default=2000.0, gt=0)
    """One window per slide."""


def gratings_task(spec: GratingsTask) -> TaskData:
    """Level, spread and rate of each taxel; sequences after the encoder's moving average at 30 Hz."""
    smoothed = condition(gratings.simulate(spec.simulation), ConditioningSpec(ema_cutoff_Hz=30.0))
    return windowed(smoothed, spec.start_ms, spec.length_ms)


def fabrics_task(spec: FabricsTask) -> TaskData:
    """Level, spread and rate of each taxel in one window per slide."""
    return windowed(fabricslide.read(expand(spec.path)), spec.start_ms, spec.length_ms)


def windowed(recordings: Recordings, start_ms: float, length_ms: float) -> TaskData:
    """One window per trial, as sequences and as level, spread and rate of each taxel.

    Raises InputError if a trial is too short.
    """
    rate_Hz = recordings.sampling_rate_Hz
    first, length = round(start_ms * 1e-3 * rate_Hz), round(length_ms * 1e-3 * rate_Hz)
    shortest = min(len(signal) for signal in recordings.signals)
    if shortest < first + length or length < 2:
        raise InputError(
            f"{recordings.source}: the shortest trial lasts {1e3 * shortest / rate_Hz:.0f} ms, too short for "
            f"{start_ms:g} + {length_ms:g} ms; shorten the window"
        )
    sequences = np.stack([signal[first : first + length] for signal in recordings.signals]).astype(np.float32)
    labels = recordings.conditions[LABEL].to_numpy(dtype=str)
    features = level_spread_rate(sequences)
    return TaskData(features, sequences, rate_Hz, recordings.unit, labels, np.arange(len(labels)))


def level_spread_rate(sequences: np.ndarray) -> np.ndarray:
    """Mean, deviation and mean absolute change of each channel, `(example, 3 channels)` for `(example, time, channel)`.

    >>> level_spread_rate(np.array([[[0.0], [2.0], [1.0]]])).round(3).tolist()
    [[1.0, 0.816, 1.5]]
    """
    x = sequences.astype(float)
    return np.concatenate([x.mean(axis=1), x.std(axis=1), np.abs(np.diff(x, axis=1)).mean(axis=1)], axis=1)


def slowed(task: TaskData) -> TaskData:
    """The task with its sequences averaged over whole samples to at most `CLOCK_HZ`.

    >>> task = TaskData(np.zeros((1, 1)), np.arange(6.0).reshape(1, 6, 1), 3000.0, "V", np.array(["a"]), np.arange(1))
    >>> slowed(task).sequences.ravel().tolist(), slowed(task).sampling_rate_Hz
    ([1.0, 4.0], 1000.0)
    """
    factor = int(np.ceil(task.sampling_rate_Hz / CLOCK_HZ - 1e-9))
    if factor <= 1:
        return task
    n_steps = task.sequences.shape[1] // factor
    pieces = task.sequences[:, : n_steps * factor].reshape(len(task.sequences), n_steps, factor, -1)
    slow = pieces.mean(axis=2, dtype=np.float64).astype(np.float32)
    return task._replace(sequences=slow, sampling_rate_Hz=task.sampling_rate_Hz / factor)


def at_most(task: TaskData, examples: int) -> TaskData:
    """The task with at most `examples` examples, in whole groups; a fixed random seed selects the groups."""
    if len(task.labels) <= examples:
        return task
    order = np.random.default_rng(0).permutation(np.unique(task.groups))
    sizes = np.array([(task.groups == group).sum() for group in order])
    kept = np.isin(task.groups, order[np.cumsum(sizes) <= examples])
    return task._replace(
        features=task.features[kept],
        sequences=task.sequences[kept],
        labels=task.labels[kept],
        groups=task.groups[kept],
    )


def split_groups(labels: np.ndarray, groups: np.ndarray, seed: int) -> Split:
    """70/15/15 of the groups, stratified by class if every group has one class; examples follow their groups.

    Raises InputError if a class is missing on a side.

    >>> split = split_groups(np.repeat(["a", "b"], 40), np.arange(80) // 2, seed=0)
    >>> [len(side) for side in split], bool(set(split.train // 2) & set(split.test // 2))
    ([56, 12, 12], False)
    """
    names, first = np.unique(groups, return_index=True)
    one_class = all(len(np.unique(labels[groups == name])) == 1 for name in names)
    if one_class:
        sides = [names[side] for side in split_trials(labels[first], SplitSpec(seed=seed))]
    else:
        rest, test = next(GroupShuffleSplit(1, test_size=0.15, random_state=seed).split(labels, groups=groups))
        again = GroupShuffleSplit(1, test_size=0.15 / 0.85, random_state=seed + 1)
        train, validation = next(again.split(rest, groups=groups[rest]))
        sides = [groups[rest[train]], groups[rest[validation]], groups[test]]
    split = Split(*(np.flatnonzero(np.isin(groups, side)) for side in sides))
    classes = set(labels.tolist())
    if any(set(labels[side].tolist()) != classes for side in split):
        raise InputError(f"split: seed {seed} leaves a class out on one side of {len(names)} groups; add groups")
    return split


class FrontEnd(NamedTuple):
    """The layers that compute features, and sequences, from the recorded samples of a window."""

    features: tuple[Layer, ...]
    sequences: tuple[Layer, ...]


class Source(NamedTuple):
    """The source of a task.

    data: its spec; make: returns the task; front_end: returns the operations of its features and sequences.
    """

    data: type[Spec]
    make: Callable[[Any], TaskData]
    front_end: Callable[[Any, TaskData], FrontEnd]


def _plain_front_end(data: Spec, task: TaskData) -> FrontEnd:
    """Level, spread and rate from sequences as recorded."""
    _, samples, channels = task.sequences.shape
    return FrontEnd((LevelSpreadRate(samples, channels),), ())


def _gratings_front_end(data: Spec, task: TaskData) -> FrontEnd:
    """A moving average, then level, spread and rate; the sequences require the moving average alone."""
    _, samples, channels = task.sequences.shape
    smoothing = MovingAverage(samples, channels)
    return FrontEnd((smoothing, LevelSpreadRate(samples, channels)), (smoothing,))


OWN = {
    "gratings": Source(GratingsTask, gratings_task, _gratings_front_end),
    "fabrics": Source(FabricsTask, fabrics_task, _plain_front_end),
}


def source_of(name: str) -> Source:
    """The source of a task; InputError for a protocol that does not exist or is not a task.

    Features of a protocol without an entry in FRONT_ENDS are counted as level, spread and rate of its sequences.
    """
    if name in OWN:
        return OWN[name]
    module: Any = module_of(name)
    if not hasattr(module, "task"):
        raise InputError(f"task: the protocol '{name}' is not a task; it has no function `task`")
    front_end = FRONT_ENDS.get(name, _plain_front_end)
    return Source(module.Parameters.model_fields["data"].annotation, module.task, front_end)


def _touch_front_end(data: touch_modality.TouchData, task: TaskData) -> FrontEnd:
    """Mean and deviation of each taxel in each window; sequences are without the first sample, smoothed and resampled
    (touch_modality.task).
    """
    _, steps, channels = task.sequences.shape
    bounds = window_bounds(TOUCH_SAMPLES, touch_modality.TASK_STEPS, data.windows)
    moments = tuple(Moments(int(stop - first), channels, order=2) for first, stop in bounds)
    first = BaselineRemoval(TOUCH_SAMPLES, channels, level="first")
    return FrontEnd(moments, (first, MovingAverage(TOUCH_SAMPLES, channels), Interpolation(steps, channels)))


def _moments_front_end(data: Spec, task: TaskData) -> FrontEnd:
    """A moving average, then four moments of each channel (stiffness.task, pvdf_hardness.task)."""
    _, samples, channels = task.sequences.shape
    smoothing = MovingAverage(samples, channels)
    return FrontEnd((smoothing, Moments(samples, channels, order=4)), (smoothing,))


def _compliance_front_end(data: compliance.ComplianceSpec, task: TaskData) -> FrontEnd:
    """Six moments of both arrays, then AR, H1 and H2 of each curve, or averages of the curves (compliance.task)."""
    _, steps, channels = task.sequences.shape
    step = round(data.sampling_rate_Hz / task.sampling_rate_Hz)
    skins = [compliance.skin_of(data, sensor) for sensor in compliance.SENSORS]
    moments = tuple(TactileMoments(s.rows * s.columns, steps * step, channels // len(skins)) for s in skins)
    features = CurveFeatures(channels, steps * step, areas=1, held=2)
    return FrontEnd((*moments, features), (*moments, Averaging(steps * step, steps, channels)))


FRONT_ENDS: dict[str, Callable[[Any, TaskData], FrontEnd]] = {
    "stiffness": _moments_front_end,
    "pvdf_hardness": _moments_front_end,
    "touch_modality": _touch_front_end,
    "compliance": _compliance_front_end,
}


@dataclass(frozen=True)
class LevelSpreadRate(Layer):
    """Mean, deviation and mean absolute change of every channel, in one pass over the signal.

    A sample adds to the sum, its square to the sum of squares, and the magnitude of its difference from the previous
    sample to a third sum; at the end three products, the variance's MAC and a root.

    >>> LevelSpreadRate(samples=500, channels=8).cost().macs
    4008
    """

    samples: int
    channels: int = 1

    def cost(self) -> Cost:
        ends = in_registers(macs=1, multiplications=3, divisions=1)
        sums = 4 * self.channels  # three, and the previous sample
        each = Cost(macs=1, acs=3, comparisons=1, **changed(4)).times(self.samples) + ends + Cost(**passed(0, 3))
        return each.times(self.channels) + with_weights(0, sums)
