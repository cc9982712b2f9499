"""The encoder specs (`encoders/*.toml`): `model` selects the neurons of the afferents."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeGuard

import numpy as np

from neurotact import plugins
from neurotact import spec as specs
from neurotact.data.conditioning import Baseline, ConditioningSpec, check_used
from neurotact.encoders import closed_form
from neurotact.encoders.afferents import LEAST_EXACT_MS, POPULATIONS, AfferentSpec, check_taxels, marks, under
from neurotact.encoders.closed_form import ExactState
from neurotact.encoders.model import SA_RA, EncoderSpec, Model, Population, checked, name_in, names, of_name, part_of
from neurotact.errors import InputError, nearest

CLOCK_HZ = 1000.0
"""A clock that can express a refractory period of 1 ms."""
PAST: tuple[Baseline, ...] = ("none", "start", "high-pass")
"""Baselines that `calibrate_causally` chooses from (ties: the first)."""
FITTED = ("unit", "sa1.gain", "ra1.gain", "pc.gain", "conditioning.offset", "conditioning.scale")
"""Keys of an encoder that calibration always sets."""
BY_CALIBRATION = "calibration sets it from the training trials and would ignore a given value; leave it out"


def populations(encoder: Mapping[str, Any] | EncoderSpec) -> tuple[Population, ...]:
    """The populations of an encoder, a spec or a table of one, in the order of its output.

    Spikes of a model that no installed package has are taken for SA-I and RA-I.

    >>> [population.name for population in populations(load("poisson"))]
    ['SA-I', 'RA-I']
    """
    name = encoder.model if isinstance(encoder, EncoderSpec) else name_in(encoder)
    if not plugins.has("encoders", name):
        return SA_RA
    model, table = of_name(name), encoder if isinstance(encoder, Mapping) else dict(encoder)
    return tuple(
        population
        for population in model.populations
        if not _is_optional(model, population.part) or table.get(population.part) is not None
    )


def _is_optional(model: Model, part: str) -> bool:
    return bool(part) and model.spec.model_fields[part].get_default(call_default_factory=True) is None


def described(encoder: EncoderSpec, population: Population) -> Any:
    """The keys of a population: its part of the spec, or the whole spec.

    >>> encoder = load("poisson")
    >>> [described(encoder, population).t_ref_ms for population in populations(encoder)]
    [0.0, 0.0]
    """
    return getattr(encoder, population.part) if population.part else encoder


def t_ref_ms_of(encoder: EncoderSpec, population: Population) -> float:
    """The refractory period of a population; 0 if its model has none.

    >>> t_ref_ms_of(load("sa1-ra1-lif"), SA_RA[0]), t_ref_ms_of(load("burst"), SA_RA[0])
    (1.0, 0.0)
    """
    return getattr(described(encoder, population), "t_ref_ms", 0.0)


def t_ref_pair_ms(encoder: EncoderSpec) -> tuple[float, float]:
    """The refractory periods of the first two populations, which results name t_ref_sa_ms and t_ref_ra_ms.

    Both are the same where a refractory period holds for a whole channel.

    >>> t_ref_pair_ms(load("sa1-ra1-lif", {"ra1.t_ref_ms": 5}))
    (1.0, 5.0)
    """
    periods: list[float] = [t_ref_ms_of(encoder, population) for population in populations(encoder)]
    return periods[0], periods[min(1, len(periods) - 1)]


def with_t_ref(encoder: Any, t_ref_ms: float) -> Any:
    """An encoder with one refractory period for all that have one; InputError for a model without any.

    >>> with_t_ref(load("send-on-delta"), 5.0).t_ref_ms
    5.0
    """
    has_one = False
    for population in populations(encoder):
        kind = described(encoder, population)
        if "t_ref_ms" in type(kind).model_fields:
            kind, has_one = kind.model_copy(update={"t_ref_ms": t_ref_ms}), True
            encoder = encoder.model_copy(update={population.part: kind}) if population.part else kind
    if not has_one:
        raise InputError(f"t_ref_ms: '{encoder.model}' has no refractory period; leave it out for this encoder")
    return encoder


def default_of(model: str) -> str:
    """The name of the shipped spec with a model's defaults.

    >>> default_of("lif"), default_of("burst")
    ('sa1-ra1-lif', 'burst')
    """
    return "sa1-ra1-lif" if model == "lif" else model


def dotted(part: str, key: str) -> str:
    """A key of a part of a spec, or of the spec itself if the part is empty, as a user writes it."""
    return f"{part}.{key}" if part else key


def period_keys(model: str) -> tuple[str, ...]:
    """The dotted keys of the refractory periods of a model's spec; of populations that are optional, none.

    >>> period_keys("lif"), period_keys("send-on-delta"), period_keys("burst")
    (('sa1.t_ref_ms', 'ra1.t_ref_ms'), ('t_ref_ms',), ())
    """
    row = of_name(model)
    parts = dict.fromkeys(population.part for population in row.populations)
    kinds = {part: part_of(row.spec, part) for part in parts if not _is_optional(row, part)}
    return tuple(
        dotted(part, "t_ref_ms") for part, kind in kinds.items() if kind is not None and "t_ref_ms" in kind.model_fields
    )


def with_t_refs(encoder: Any, other: EncoderSpec) -> Any:
    """An encoder with the refractory periods of another one of its model.

    >>> with_t_refs(load("sa1-ra1-lif"), load("sa1-ra1-lif", {"ra1.t_ref_ms": 5})).ra1.t_ref_ms
    5.0
    """
    for population in populations(encoder):
        kind, period = described(encoder, population), {"t_ref_ms": t_ref_ms_of(other, population)}
        if "t_ref_ms" in type(kind).model_fields:
            kind = kind.model_copy(update=period)
            encoder = encoder.model_copy(update={population.part: kind}) if population.part else kind
    return encoder


def afferent_names(taxels: Sequence[str], encoder: Mapping[str, Any] = MappingProxyType({})) -> tuple[str, ...]:
    """Names in the order of an encoder's output: its first population of every taxel, then the next one.

    encoder: its spec as a table. If a taxel has several afferents of a population, the first of every taxel come first.

    >>> afferent_names(("taxel1", "taxel2"))
    ('SA-I taxel1', 'SA-I taxel2', 'RA-I taxel1', 'RA-I taxel2')
    >>> afferent_names(("taxel1",), {"sa1": {"grades": [0.5, 1.0]}})
    ('SA-I taxel1 x0.5', 'SA-I taxel1 x1', 'RA-I taxel1')
    """
    kinds = [(population.name, encoder.get(population.part) or {}) for population in populations(encoder)]
    return tuple(
        f"{name} {taxels[index]}{mark}"
        for name, kind in kinds
        for mark in marks(kind)
        for index in under(kind, len(taxels))
    )


def taxel_names(afferents: Sequence[str], encoder: Mapping[str, Any]) -> tuple[str, ...] | None:
    """The names of the taxels of which an encoder, its spec as a table, named these afferents; None of other names.

    >>> taxel_names(("SA-I left", "SA-I right", "RA-I left", "RA-I right"), {})
    ('left', 'right')
    """
    if (recorded := encoder.get("recorded_taxels")) is not None:
        taxels = tuple(recorded)
    else:
        before, _, after = afferent_names(("\0",), encoder)[0].partition("\0")
        first = afferents[: taxels_of(len(afferents), encoder)]
        taxels = tuple(name.removeprefix(before).removesuffix(after) for name in first)
    return taxels if afferent_names(taxels, encoder) == tuple(afferents) else None


def n_afferents(encoder: EncoderSpec, n_taxels: int) -> int:
    """The number of an encoder's afferents under so many taxels.

    >>> n_afferents(load("sa1-ra1-lif"), 8), n_afferents(load("sa1-ra1-lif", {"sa1.taxels": [0, 2]}), 8)
    (16, 10)
    """
    return len(afferent_names([""] * n_taxels, encoder.model_dump()))


def taxels_of(n_afferents: int, encoder: Mapping[str, Any]) -> int:
    """The number of taxels for a number of afferents, by the encoder's spec as a table; at least one.

    Where all populations have only some taxels and the table does not say of how many, those up to the last one.

    >>> taxels_of(16, {}), taxels_of(50, {"sa1": {"grades": [0.5, 1.0, 2.0, 4.0]}})
    (8, 10)
    >>> taxels_of(10, {"sa1": {"taxels": [0, 2]}}), taxels_of(3, {"sa1": {"taxels": [0, 4]}, "ra1": {"taxels": [1]}})
    (8, 5)
    """
    if (known := known_taxels(encoder)) is not None:
        return known
    kinds = [encoder.get(population.part) or {} for population in populations(encoder)]
    whole = sum(len(marks(kind)) for kind in kinds if kind.get("taxels") is None)
    some = [(len(marks(kind)), kind["taxels"]) for kind in kinds if kind.get("taxels") is not None]
    if whole:
        return max(1, (n_afferents - sum(n * len(taxels) for n, taxels in some)) // whole)
    return 1 + max(index for _, taxels in some for index in taxels)


def known_taxels(encoder: Mapping[str, Any]) -> int | None:
    """The number of taxels of an encoder, its spec as a table, whose populations have only some; None if unknown.

    >>> known_taxels({}), known_taxels({"sa1": {"taxels": [0]}, "conditioning": {"offset": [1.0, 2.0]}})
    (None, 2)
    """
    kinds = [encoder.get(population.part) or {} for population in populations(encoder)]
    if all(kind.get("taxels") is None for kind in kinds):
        return None
    how = encoder.get("conditioning") or {}
    known = [encoder.get("recorded_taxels"), *(how.get(key) for key in ("taxels", "offset", "scale"))]
    return next((len(values) for values in known if values is not None), None)


def load(name: str | Path, overrides: Mapping[str, Any] | None = None) -> EncoderSpec:
    """Load the encoder spec called `name` (or at that path), after `overrides` of dotted keys.

    A model of another package has no file here: its name alone gives the defaults of its keys.

    >>> load("izhikevich").model, load("sa1-ra1-lif", {"sa1.t_ref_ms": 5}).sa1.t_ref_ms
    ('izhikevich', 5.0)
    """
    table, source = specs.table_of(EncoderSpec, name)
    table = specs.override(table, overrides or {})
    model = name_in(table)
    if not plugins.has("encoders", model):
        raise InputError(f"model: '{model}' is unknown; {nearest(model, names())} ({source})")
    built = specs.build(of_name(model).spec, table, source=source)
    check_used(overrides or {}, built.conditioning.baseline)
    return built


def resolve(what: str | Path | EncoderSpec, overrides: Mapping[str, Any] | None = None) -> EncoderSpec:
    """The encoder spec with the name or path `what`, or `what` itself, after `overrides`.

    >>> resolve(load("sa1-ra1-lif"), {"sa1.t_ref_ms": 5}).sa1.t_ref_ms
    5.0
    """
    if isinstance(what, (str, Path)):
        return load(what, overrides)
    if not isinstance(what, EncoderSpec):
        raise InputError(f"encoder: must be a name, a path or an encoder spec; got {type(what).__name__}")
    changed = specs.resolve(type(what), what, overrides)
    check_used(overrides or {}, changed.conditioning.baseline)
    return changed


def set_keys(what: str | Path | EncoderSpec, overrides: Mapping[str, Any] | None = None) -> set[str]:
    """The keys that the spec `what` and `overrides` set; of those in its tables, the tables' names.

    >>> "integration" in set_keys("sa1-ra1-lif"), "integration" in set_keys("sa1-ra1-lif", {"integration": "clock"})
    (False, True)
    """
    if isinstance(what, EncoderSpec):
        return {*what.model_fields_set, *(overrides or {})}
    return resolve(what, overrides).model_fields_set


def encode(signal: np.ndarray, sampling_rate_Hz: float, spec: EncoderSpec, state: Any = None) -> tuple[np.ndarray, Any]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, afferent)` uint8, as `afferent_names`.

    The state is an argument and a result, so that a recording encoded in pieces gives the spikes of the whole.
    A trial's spikes depend on its samples, the spec and its seed alone: not on other trials, nor on its index.

    >>> spikes, _ = encode(np.full((1, 200, 1), 10.0), 2000.0, load("sa1-ra1-lif"))
    >>> spikes.sum(axis=1).tolist()
    [[20, 0]]
    """
    model = of_name(spec.model)
    own: Callable[..., tuple[np.ndarray, Any]] = closed_form.encode if is_exact(spec) else model.encode
    kind = ExactState if is_exact(spec) else model.state
    if state is not None and kind is None:
        raise InputError(
            f"encoder: the model '{spec.model}' names no state, so that it cannot encode a signal in pieces"
        )
    if state is not None and kind is not None and not isinstance(state, kind):
        raise InputError(f"state: is a {type(state).__name__}, of another encoder; pass the one that encode returned")
    encoded = own(signal, sampling_rate_Hz, spec, state)
    if state is None and not plugins.is_ours("encoders", spec.model):
        _check_encoded(encoded, checked(signal).shape, spec)
    return encoded


def _check_encoded(encoded: Any, shape: tuple[int, ...], spec: EncoderSpec) -> None:
    """InputError if what the model of another package gives is no raster of its afferents and a state."""
    wanted = *shape[:2], n_afferents(spec, shape[2])
    if not (isinstance(encoded, tuple) and len(encoded) == 2):
        raise plugins.unfit("encoders", spec.model, "does not return spikes and a state")
    spikes = np.asarray(encoded[0])
    if spikes.dtype != np.uint8 or spikes.shape != wanted:
        got = f"{spikes.dtype} {spikes.shape} where uint8 {wanted} is expected"
        raise plugins.unfit("encoders", spec.model, f"returns spikes of the type {got}")


def encode_whole(signal: np.ndarray, sampling_rate_Hz: float, spec: EncoderSpec) -> np.ndarray:
    """The spikes of whole trials, to their end, as `encode` gives them piece by piece and then `finish`.

    >>> encode_whole(np.zeros((1, 200, 1)), 2000.0, load("sa1-ra1-lif")).shape
    (1, 200, 2)
    """
    if is_exact(spec):
        return closed_form.encode_whole(signal, sampling_rate_Hz, spec)
    return encode(signal, sampling_rate_Hz, spec)[0]


def finish(sampling_rate_Hz: float, spec: EncoderSpec, state: Any) -> np.ndarray | None:
    """The steps that the end of a trial adds to those of `encode`; None for encoders that step as their signal does.

    >>> finish(2000.0, load("sa1-ra1-lif"), encode(np.zeros((1, 200, 1)), 2000.0, load("sa1-ra1-lif"))[1])
    """
    if is_exact(spec) and isinstance(state, ExactState):
        return closed_form.finish(sampling_rate_Hz, spec, state)
    return None


def is_exact(spec: EncoderSpec) -> TypeGuard[AfferentSpec]:
    """Whether an encoder takes the samples of the sensor, and has its spikes on another clock.

    >>> is_exact(load("sa1-ra1-lif")), is_exact(load("sa1-ra1-lif", {"integration": "exact"}))
    (False, True)
    """
    return isinstance(spec, AfferentSpec) and spec.integration == "exact"


def pays_exact(spec: EncoderSpec, recorded_Hz: float, periods_ms: Iterable[object] = ()) -> bool:
    """Whether closed form is the default for recordings of that rate: it costs less, and allows each refractory period.

    It costs less for SA-I and RA-I whose sensor is slower than their clock. periods_ms: further periods that are tried.

    >>> spec = load("sa1-ra1-lif", {"conditioning.resample_Hz": 1000.0})
    >>> pays_exact(spec, 93.0, [5.0]), pays_exact(spec, 93.0, [0.0]), pays_exact(spec, 2000.0)
    (True, False, False)
    """
    clock_Hz = spec.conditioning.resample_Hz
    if not isinstance(spec, AfferentSpec) or clock_Hz is None or recorded_Hz >= clock_Hz:
        return False
    tried = [*t_ref_pair_ms(spec), *periods_ms]
    return all(isinstance(period, (int, float)) and period >= LEAST_EXACT_MS for period in tried)


def exact_note(clock_Hz: float, recorded_Hz: float) -> str:
    """What closed form means for recordings that are slower than the clock, in words.

    >>> exact_note(1000.0, 93.0)
    'clock of the spikes: 1000 Hz; afferents are computed once per sample, at 93 Hz'
    """
    return f"clock of the spikes: {clock_Hz:g} Hz; afferents are computed once per sample, at {recorded_Hz:.4g} Hz"


def conditioning_of(spec: EncoderSpec, recorded_Hz: float) -> ConditioningSpec:
    """The conditioning of the signal that an encoder takes, of a recording of that rate.

    Where membranes are in closed form, samples that are slower than the spikes' clock are not resampled to it.

    >>> spec = load("sa1-ra1-lif", {"conditioning.resample_Hz": 1000.0, "integration": "exact"})
    >>> [conditioning_of(spec, rate_Hz).resample_Hz for rate_Hz in (93.0, 2000.0)]
    [None, 1000.0]
    """
    if not is_exact(spec) or recorded_Hz > spec.conditioning.clock_Hz(recorded_Hz):
        return spec.conditioning
    return spec.conditioning.model_copy(update={"resample_Hz": None})


def recorded_at(spec: EncoderSpec, recorded_Hz: float, channels: Sequence[str]) -> EncoderSpec:
    """An encoder as spike trains carry it.

    With the rate of the recording, if its cost depends on that; with its taxels, if populations have only some.

    >>> print(recorded_at(load("sa1-ra1-lif"), 93.0, ["left", "right"]).recorded_Hz)
    None
    """
    if isinstance(spec, AfferentSpec) and not spec.has_all_taxels:
        check_taxels(spec.model_dump(), len(channels))
        spec = spec.model_copy(update={"recorded_taxels": tuple(channels)})
    return spec.model_copy(update={"recorded_Hz": recorded_Hz}) if is_exact(spec) else spec


def of_used(spec: EncoderSpec, n_taxels: int) -> tuple[list[int], EncoderSpec]:
    """The taxels that an encoder uses, and the encoder for recordings of these alone, which gives the same spikes.

    >>> of_used(load("sa1-ra1-lif", {"sa1.taxels": [2], "ra1.taxels": []}), 4)[0]
    [2]
    """
    return spec.of_used(n_taxels) if isinstance(spec, AfferentSpec) else ([*range(n_taxels)], spec)


def with_taxels_of(spec: Any, other: EncoderSpec | None = None) -> Any:
    """An encoder whose populations have the taxels that those of another one have; without it, all.

    >>> with_taxels_of(load("sa1-ra1-lif"), load("sa1-ra1-lif", {"sa1.taxels": [2]})).sa1.taxels
    (2,)
    """
    if not isinstance(spec, AfferentSpec):
        return spec
    chosen = {part: None if other is None else getattr(other, part).taxels for part in POPULATIONS}
    kinds = {part: getattr(spec, part).model_copy(update={"taxels": its}) for part, its in chosen.items()}
    return spec.model_copy(update=kinds)
