"""The sets of touches on which networks are compared: simulated, read as published, or a user's own file."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison.fronts import EVENTS
from neurotact_parts.studies.comparison.saving import Bench
from neurotact_parts.studies.comparison.skipped import left_out
from pydantic import Field, model_validator

from neurotact.data import hdf5
from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.copies import copies_of
from neurotact.data.digests import content_digest
from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.sources import expand, reader, simulator
from neurotact.data.spikes import SpikeTrains, TrialSpikes, from_rasters, from_trials
from neurotact.data.splits import Split, SplitSpec, split_conditions
from neurotact.data.trial_choice import LeaveOut, TrialChoice, Where, chosen_trials
from neurotact.data.windows import Windows, WindowSpec
from neurotact.encoders.afferents import AfferentSpec, AfferentType, Integration
from neurotact.encoders.calibration import calibrate, calibrate_causally
from neurotact.encoders.specs import pays_exact
from neurotact.errors import InputError, nearest
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import Spec
from neurotact.studies import suited
from neurotact.studies.protocol import Arrays

CALIBRATED_AT_MS = 1.0
OWN_MS: float = AfferentSpec.model_fields["tau_mem_ms"].default
"""Membranes of the encoder, which those of a set are not shorter than."""


class SetSpec(Spec):
    """A set of touches: simulated, read in a published format, or a user's own file."""

    simulate: str | None = None
    simulation: dict[str, Any] = {}
    """Keys of the simulator that differ from their defaults."""
    read: str | None = None
    path: str | None = None
    """The path to read; without `read`, the path of an HDF5 file of recordings or of events."""
    content: str | None = None
    """Digest of the trials in a user's own file (`data.digests.content_digest`)."""
    unit: str = "mV"
    conditioning: ConditioningSpec = ConditioningSpec()
    """Conditioning before the afferents; `resample_Hz` is their clock. Events have none."""
    integration: Literal["auto", "clock", "exact"] = "auto"
    """How afferents are computed (`AfferentSpec.integration`); `auto`: by the rule of `own-recordings`, in closed form
    if the sensor is slower than their clock. Events have no afferents."""
    tau_mem_ms: Annotated[float, Field(gt=0)] | Literal["auto"] = "auto"
    """Time constant of the afferents' membranes; `auto`: by the rule of `own-recordings`, a twentieth of the window."""
    choose_baseline: bool = False
    """Choose a causal baseline on training trials, in place of the baseline of `conditioning`."""
    choose_ema: bool = False
    """With `choose_baseline`: choose the cut-off of the moving average there, too."""
    choose_opposite: bool = False
    """With `choose_baseline`: choose there whether SA-I of the falling signal are added, too."""
    window: WindowSpec = WindowSpec()
    group: tuple[str, ...] = ()
    """Conditions that name a group: if `split` is by groups, trials with equal values are on one side."""
    where: Where = {}
    """Conditions of the trials that are used."""
    leave_out: LeaveOut = {}
    """Conditions of trials that are not used, or classes."""

    @property
    def membrane_ms(self) -> float:
        """The time constant of the afferents' membranes.

        >>> SetSpec(simulate="gratings", window=WindowSpec(length_ms=600.0)).membrane_ms
        30.0
        """
        return suited.membrane_ms(self.window.length_ms, OWN_MS) if self.tau_mem_ms == "auto" else self.tau_mem_ms

    @property
    def choice(self) -> TrialChoice:
        """The trials that are used."""
        return TrialChoice(self.where, self.leave_out)

    @model_validator(mode="after")
    def _has_one_source_as_recorded(self) -> "SetSpec":
        has_source = [self.simulate is not None, self.read is not None, self.content is not None]
        if sum(has_source) != 1 or (self.simulate is None and self.path is None):
            raise ValueError("give simulate, or read with its path; `data` names a file of your own")
        if self.conditioning.offset is not None or self.conditioning.scale is not None:
            raise ValueError("conditioning: offset and scale are fitted on the training trials; leave them out")
        return self


class WaysData(Spec):
    """The chosen set, all sets, and the kind of split."""

    set: str
    sets: dict[str, SetSpec]
    split: Literal["trials", "groups"] = "trials"
    """The units of the random split: single trials, or the set's groups."""

    @model_validator(mode="after")
    def _names_a_set(self) -> "WaysData":
        if self.set not in self.sets:
            raise ValueError(f"set: '{self.set}' is not one of the sets; {nearest(self.set, list(self.sets))}")
        return self

    @property
    def chosen(self) -> SetSpec:
        return self.sets[self.set]


def load(data: WaysData) -> Arrays:
    """The recordings up to the end of their last window, or the spikes of events; or only the reason for their absence.

    Raises InputError if a user's own file does not exist, or was changed since the study began.
    """
    chosen = data.chosen
    if chosen.content is not None:
        return _arrays_of_file(chosen)
    try:
        if data.split == "groups" and not chosen.group:
            raise InputError("the set names no group to split by")
        if chosen.simulate is not None:
            source = simulator(chosen.simulate)
            touches: Recordings | SpikeTrains = source.simulate(source.build(chosen.simulation, data.set), None)
        else:
            assert chosen.read is not None
            assert chosen.path is not None
            touches = reader(chosen.read).read(expand(chosen.path))
    except InputError as error:
        return left_out(data.set, error)
    return _arrays_of(chosen_trials(touches, chosen.choice, data.set), chosen)


def _arrays_of(touches: Recordings | SpikeTrains, chosen: SetSpec) -> Arrays:
    """Arrays of trials cut to one length: `signals`, `(trial, time, taxel)`, or `raster`, `(trial, time, afferent)`."""
    rate_Hz, last_ms = touches.sampling_rate_Hz, _last_ms(chosen.window)
    shared = _shared(touches, chosen)
    if isinstance(touches, SpikeTrains):
        whole = Windows(np.arange(len(touches)), np.zeros(len(touches), np.int64), int(touches.trial_steps.min()))
        return {**shared, "raster": touches.raster(whole), "afferents": np.array(touches.afferents)}
    touches = touches.to_unit(chosen.unit)
    shortest = min(len(signal) for signal in touches.signals)
    if shortest < last_ms * 1e-3 * rate_Hz:
        raise InputError(
            f"{touches.source}: the shortest trial lasts {1e3 * shortest / rate_Hz:.0f} ms, too short for windows that "
            f"end at {last_ms:g} ms; shorten the window"
        )
    longest = min(_n_samples(last_ms, rate_Hz), shortest)
    return {**shared, "signals": np.stack([np.asarray(signal[:longest], np.float32) for signal in touches.signals])}


def _arrays_of_file(chosen: SetSpec) -> Arrays:
    """Arrays of trials of any lengths, concatenated.

    Recordings: `values`, `(sample, taxel)`, and `lengths`, `(trial,)`. Events: `steps` and `units`, `(spike,)`, and
    `counts` and `trial_steps`, `(trial,)`.
    """
    assert chosen.path is not None
    touches = chosen_trials(hdf5.load(expand(chosen.path)), chosen.choice, chosen.path, tell=False)
    if content_digest(touches) != chosen.content:
        raise InputError(f"{chosen.path}: its trials changed since this study began; run it in another folder")
    shared = _shared(touches, chosen)
    if isinstance(touches, SpikeTrains):
        return {
            **shared,
            "steps": np.concatenate([np.asarray(steps, np.int64) for steps in touches.steps]),
            "units": np.concatenate([np.asarray(units, np.int64) for units in touches.units]),
            "counts": np.array([len(steps) for steps in touches.steps]),
            "trial_steps": touches.trial_steps,
            "afferents": np.array(touches.afferents),
        }
    # No window contains the signal after the last one; if windows start at contact, its end is not known yet.
    is_whole = chosen.window.align == "onset" or chosen.window.per_trial is None
    most = None if is_whole else _n_samples(_last_ms(chosen.window), touches.sampling_rate_Hz)
    signals = [np.asarray(signal[:most], np.float32) for signal in touches.signals]
    lengths = np.array([len(signal) for signal in signals])
    return {**shared, "values": np.concatenate(signals), "lengths": lengths, "channels": np.array(touches.channels)}


def _shared(touches: Recordings | SpikeTrains, chosen: SetSpec) -> Arrays:
    """The class of each trial, its group if the set names one, and the sampling rate."""
    conditions = touches.conditions[[LABEL, *chosen.group]].astype(str)
    shared = {"labels": conditions[LABEL].to_numpy(dtype=str), "sampling_rate_Hz": np.array(touches.sampling_rate_Hz)}
    if chosen.group:
        shared["groups"] = conditions[list(chosen.group)].agg(", ".join, axis=1).to_numpy(dtype=str)
    return shared


def _last_ms(window: WindowSpec) -> float:
    """The latest possible end of the last window of a trial."""
    return window.start_ms + (window.per_trial or 1) * (window.hop_ms or window.length_ms)


def _n_samples(last_ms: float, rate_Hz: float) -> int:
    """One sample more than the windows require: then a slower clock does not end within the last window."""
    return int(np.ceil(last_ms * 1e-3 * rate_Hz)) + 1


def bench_of(data: WaysData, network: RSNNSpec, seed: int, arrays: Arrays) -> Bench:
    """The inputs that all ways share on one set and seed; gains are calibrated on the training trials."""
    chosen = data.chosen
    rate_Hz = float(arrays["sampling_rate_Hz"])
    conditions = pd.DataFrame({LABEL: arrays["labels"]})
    is_events = "afferents" in arrays
    touches = (
        _trains_of(arrays, rate_Hz, conditions)
        if is_events
        else Recordings(_signals_of(arrays), rate_Hz, chosen.unit, conditions, _names(arrays, "channels"), data.set)
    )
    copies = copies_of(touches)
    grouped = conditions.assign(group=arrays["groups"]) if data.split == "groups" else conditions
    split, seeds = sides(grouped, data.split, seed, copies.first), of_start(seed, _split_of(data.split, seed))
    if isinstance(touches, SpikeTrains):
        return Bench(touches, None, split, chosen.window, network, seeds)
    encoder = _calibrated(touches.select(copies.distinct(split.train)), chosen, step_ms(data, arrays))
    return Bench(touches, encoder, split, chosen.window, network, seeds)


def sides(conditions: pd.DataFrame, by: Literal["trials", "groups"], seed: int, first: np.ndarray) -> Split:
    """The split of a seed. conditions: with the column `label` and, for a split by groups, the column `group`.

    first: of `data.copies.Copies`.
    """
    return split_conditions(conditions, (), _split_of(by, seed), first)


def _split_of(by: Literal["trials", "groups"], seed: int) -> SplitSpec:
    return SplitSpec(seed=2 * seed, group=("group",) if by == "groups" else ())


def _trains_of(arrays: Arrays, rate_Hz: float, conditions: pd.DataFrame) -> SpikeTrains:
    names = _names(arrays, "afferents")
    if "raster" in arrays:
        return from_rasters(arrays["raster"], rate_Hz, names, conditions)
    ends = np.cumsum(arrays["counts"])[:-1]
    rows = np.split(arrays["steps"], ends), np.split(arrays["units"], ends), arrays["trial_steps"].tolist()
    return from_trials(map(TrialSpikes, *rows), rate_Hz, names, conditions)


def _signals_of(arrays: Arrays) -> Sequence[np.ndarray]:
    if "signals" in arrays:
        return list(arrays["signals"])
    return np.split(arrays["values"], np.cumsum(arrays["lengths"])[:-1])


def _names(arrays: Arrays, key: str) -> tuple[str, ...]:
    return tuple(arrays[key].tolist()) if key in arrays else ()


def _calibrated(training: Recordings, chosen: SetSpec, step_ms: float) -> AfferentSpec:
    """Afferents with gains fitted on training trials, on the set's clock and with refractory periods of a step.

    Gains are fitted on a clock of 1 ms, or on the set's clock if it is finer. They are per ms, so they apply to slower
    clocks, on which too many intervals would be of a single step.
    """
    fine_ms = min(CALIBRATED_AT_MS, step_ms)
    least = AfferentType(gain=1.0, t_ref_ms=fine_ms)
    conditioning = chosen.conditioning.model_copy(update={"resample_Hz": 1e3 / fine_ms})
    integration = integration_of(chosen, training.sampling_rate_Hz)
    how = {"integration": integration, "tau_mem_ms": chosen.membrane_ms, "conditioning": conditioning}
    start = AfferentSpec(unit=chosen.unit, **how, sa1=least, ra1=least)
    if chosen.choose_baseline:
        calibrated = calibrate_causally(
            training, start, choose_ema=chosen.choose_ema, choose_opposite=chosen.choose_opposite, tell=False
        ).encoder
    else:
        calibrated = calibrate(training, start, tell=False).encoder
    parts = {part: getattr(calibrated, part).model_copy(update={"t_ref_ms": step_ms}) for part in ("sa1", "ra1")}
    slower = calibrated.conditioning.model_copy(update={"resample_Hz": 1e3 / step_ms})
    return calibrated.model_copy(update={"conditioning": slower, **parts})


def integration_of(chosen: SetSpec, recorded_Hz: float) -> Integration:
    """How the afferents of a set are computed, from recordings of that rate.

    >>> slow = SetSpec(simulate="gratings", conditioning=ConditioningSpec(resample_Hz=1000.0))
    >>> integration_of(slow, 35.6), integration_of(slow, 2000.0)
    ('exact', 'clock')
    """
    if chosen.integration != "auto":
        return chosen.integration
    least = AfferentType(gain=1.0, t_ref_ms=1e3 / chosen.conditioning.clock_Hz(recorded_Hz))
    default = AfferentSpec(conditioning=chosen.conditioning, sa1=least, ra1=least)
    return "exact" if pays_exact(default, recorded_Hz) else "clock"


def computed_at(data: WaysData, arrays: Arrays) -> str:
    """When the afferents of a set are computed, in words; `EVENTS` if it has none."""
    if "afferents" in arrays:
        return EVENTS
    rate_Hz = float(arrays["sampling_rate_Hz"])
    if integration_of(data.chosen, rate_Hz) == "exact":
        return f"at each sample ({rate_Hz:.4g} Hz)"
    return f"in each step of {step_ms(data, arrays):g} ms"


def step_ms(data: WaysData, arrays: Arrays) -> float:
    """A step of the clock of afferents or events."""
    return 1e3 / data.chosen.conditioning.clock_Hz(float(arrays["sampling_rate_Hz"]))
