"""The sets of touches on which networks are compared: simulated, read as published, or a user's own file."""

from dataclasses import replace
from typing import Annotated, Any, Literal

from neurotact_parts.studies.comparison.fronts import EVENTS
from neurotact_parts.studies.comparison.saving import Bench
from neurotact_parts.studies.comparison.set_arrays import as_arrays, from_arrays
from neurotact_parts.studies.comparison.skipped import left_out
from pydantic import Field, model_validator

from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.copies import copies_of
from neurotact.data.dataset import DatasetSpec, load_touches, until
from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.splits import SplitSpec, split_touches
from neurotact.data.windows import WindowSpec
from neurotact.encoders.afferents import AfferentSpec, AfferentType, Integration
from neurotact.encoders.calibration import calibrate, calibrate_causally
from neurotact.encoders.specs import pays_exact
from neurotact.errors import InputError, nearest
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import Spec
from neurotact.studies import automatic
from neurotact.studies.way import Arrays

CALIBRATED_AT_MS = 1.0
OWN_MS: float = AfferentSpec.model_fields["tau_mem_ms"].default
"""Membranes of the encoder, which those of a set are not shorter than."""


class SetSpec(Spec):
    """A set of touches, how they are conditioned and encoded, and the windows that are classified."""

    dataset: DatasetSpec
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

    @property
    def membrane_ms(self) -> float:
        """The time constant of the afferents' membranes.

        >>> SetSpec(dataset={"simulate": "gratings"}, window=WindowSpec(length_ms=600.0)).membrane_ms
        30.0
        """
        return automatic.membrane_ms(self.window.length_ms, OWN_MS) if self.tau_mem_ms == "auto" else self.tau_mem_ms

    @model_validator(mode="after")
    def _is_as_recorded(self) -> "SetSpec":
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
        check_named(self.set, self.sets)
        return self

    @property
    def chosen(self) -> SetSpec:
        return self.sets[self.set]

    def split_of(self, seed: int) -> SplitSpec:
        """The split of a seed."""
        return SplitSpec(seed=2 * seed, group=self.chosen.group if self.split == "groups" else ())


def check_named(name: str, sets: dict[str, Any]) -> None:
    """ValueError if a name is not one of the sets."""
    if name not in sets:
        raise ValueError(f"set: '{name}' is not one of the sets; {nearest(name, list(sets))}")


def load(data: WaysData) -> Arrays:
    """The recordings up to the end of their last window, or the spikes of events; or only the reason for their absence.

    Raises InputError if a user's own file does not exist, or was changed since the study began.
    """
    chosen = data.chosen
    try:
        if data.split == "groups" and not chosen.group:
            raise InputError("the set names no group to split by")
        touches = load_touches(chosen.dataset)
    except InputError as error:
        return left_out(data.set, error, chosen.dataset)
    window = chosen.window
    if isinstance(touches, Recordings):
        touches = touches.to_unit(chosen.unit)
        if window.align == "trial" and window.per_trial is not None:  # no window holds the signal after the last one
            touches = until(touches, window.start_ms + window.per_trial * (window.hop_ms or window.length_ms))
    return as_arrays(touches)


def bench_of(data: WaysData, network: RSNNSpec, seed: int, arrays: Arrays) -> Bench:
    """The inputs that all ways share on one set and seed; gains are calibrated on the training trials."""
    chosen, touches, spec = data.chosen, from_arrays(arrays, data.set), data.split_of(seed)
    split, seeds = split_touches(touches, (), spec), of_start(seed, spec)
    encoder, bare = None, replace(touches, conditions=touches.conditions[[LABEL]])
    if isinstance(touches, Recordings):
        known = replace(touches, conditions=touches.conditions[[LABEL, *spec.group]])
        training = known.select(copies_of(touches).distinct(split.train))
        encoder = _calibrated(training, chosen, step_ms(data, arrays), tuple(spec.group))
    return Bench(bare, encoder, split, chosen.window, network, seeds)


def _calibrated(training: Recordings, chosen: SetSpec, step_ms: float, group: tuple[str, ...]) -> AfferentSpec:
    """Afferents with gains fitted on training trials, on the set's clock and with refractory periods of a step.

    Gains are fitted on a clock of 1 ms, or on the set's clock if it is finer. They are per ms, so they apply to slower
    clocks, on which too many intervals would be of a single step. group: that of the split, which choices keep whole.
    """
    fine_ms = min(CALIBRATED_AT_MS, step_ms)
    least = AfferentType(gain=1.0, t_ref_ms=fine_ms)
    conditioning = chosen.conditioning.model_copy(update={"resample_Hz": 1e3 / fine_ms})
    integration = integration_of(chosen, training.sampling_rate_Hz)
    how = {"integration": integration, "tau_mem_ms": chosen.membrane_ms, "conditioning": conditioning}
    start = AfferentSpec(unit=chosen.unit, **how, sa1=least, ra1=least)
    if chosen.choose_baseline:
        choices = {choice: getattr(chosen, choice) for choice in ("choose_ema", "choose_opposite")}
        calibrated = calibrate_causally(training, start, **choices, group=group, tell=False).encoder
    else:
        calibrated = calibrate(training, start, tell=False).encoder
    parts = {part: getattr(calibrated, part).model_copy(update={"t_ref_ms": step_ms}) for part in ("sa1", "ra1")}
    slower = calibrated.conditioning.model_copy(update={"resample_Hz": 1e3 / step_ms})
    return calibrated.model_copy(update={"conditioning": slower, **parts})


def integration_of(chosen: SetSpec, recorded_Hz: float) -> Integration:
    """How the afferents of a set are computed, from recordings of that rate.

    >>> slow = SetSpec(dataset={"simulate": "gratings"}, conditioning=ConditioningSpec(resample_Hz=1000.0))
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
