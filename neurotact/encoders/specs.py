"""The encoder specs (`encoders/*.toml`): `model` selects the neurons of the afferents."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, TypeGuard

import numpy as np
from pydantic import Discriminator, Tag

from neurotact import spec as specs
from neurotact.data.conditioning import ConditioningSpec, check_used
from neurotact.encoders import (
    afferents,
    bens_spiker,
    burst,
    exact,
    izhikevich,
    latency,
    mechanoreceptor,
    moving_window,
    poisson,
    resonate_and_fire,
    send_on_delta,
    sigma_delta,
    step_forward,
)
from neurotact.encoders.afferents import LEAST_EXACT_MS, AfferentSpec, EncoderState, marks
from neurotact.encoders.bens_spiker import BensSpikerSpec, BensSpikerState
from neurotact.encoders.burst import BurstSpec, BurstState
from neurotact.encoders.exact import ExactState
from neurotact.encoders.izhikevich import IzhikevichEncoderState, IzhikevichSpec
from neurotact.encoders.latency import LatencySpec, LatencyState
from neurotact.encoders.mechanoreceptor import MechanoreceptorEncoderState, MechanoreceptorSpec
from neurotact.encoders.moving_window import MovingWindowSpec, MovingWindowState
from neurotact.encoders.poisson import PoissonSpec, PoissonState
from neurotact.encoders.resonate_and_fire import ResonateAndFireSpec, ResonateAndFireState
from neurotact.encoders.send_on_delta import SendOnDeltaSpec, SendOnDeltaState
from neurotact.encoders.sigma_delta import SigmaDeltaSpec, SigmaDeltaState
from neurotact.encoders.step_forward import StepForwardSpec, StepForwardState
from neurotact.errors import InputError, nearest
from neurotact.metrics.flops import (
    Afferents,
    DeltaEvents,
    LatencyAfferents,
    Layer,
    PoissonAfferents,
    ResonatorAfferents,
)
from neurotact.spec import Spec


class Population(NamedTuple):
    """A population of an encoder.

    name: the first word of its afferents' names. part: the key of the spec that describes it; empty if the keys of the
    whole spec do.
    """

    name: str
    part: str = ""


SA_RA = Population("SA-I", "sa1"), Population("RA-I", "ra1")
ON_OFF = Population("ON"), Population("OFF")


class Model(NamedTuple):
    """An encoder model: its spec, its state, and `encode(signal, sampling_rate_Hz, spec, state)`.

    title: its afferents, as the table of executors names them.
    layer: its layer in the cost ledger, `layer(spec as a table, taxels, steps, step_ms)`.
    populations: in the order of its output. One whose part of the spec is optional has no afferents without it.
    repeats: whether an afferent fires at every step at which a condition holds, so that most of its intervals are the
        shortest possible.
    is_compared: whether the study `which-encoder` has it, as every model whose calibration takes seconds.
    """

    title: str
    spec: Any
    state: type
    encode: Callable[..., tuple[np.ndarray, Any]]
    layer: Callable[[Mapping[str, Any], int, int, float], Layer]
    populations: tuple[Population, ...] = SA_RA
    repeats: bool = False
    is_compared: bool = True


def _of_size(layer: Callable[[int, int], Layer]) -> Callable[[Mapping[str, Any], int, int, float], Layer]:
    """The layer of a model whose cost depends only on the numbers of taxels and steps."""
    return lambda _spec, taxels, steps, _step_ms: layer(taxels, steps)


def _lif_layer(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Layer:
    del step_ms
    n_sa1, n_ra1 = (len(marks(spec.get(population.part) or {})) for population in SA_RA)
    onset = bool((spec.get("sa1") or {}).get("rate_ms"))
    return Afferents(taxels, steps, n_sa1, n_ra1, onset=onset)


MODELS = {
    "lif": Model("LIF afferents", AfferentSpec, EncoderState, afferents.encode, _lif_layer),
    "izhikevich": Model(
        "Izhikevich afferents", IzhikevichSpec, IzhikevichEncoderState, izhikevich.encode, izhikevich.layer
    ),
    "poisson": Model(
        "Poisson afferents", PoissonSpec, PoissonState, poisson.encode, _of_size(PoissonAfferents)
    ),
    "mechanoreceptor": Model(
        "fitted mechanoreceptors",
        MechanoreceptorSpec,
        MechanoreceptorEncoderState,
        mechanoreceptor.encode,
        mechanoreceptor.layer,
        populations=(*SA_RA, Population("PC", "pc")),
        is_compared=False,
    ),
    "send-on-delta": Model(
        "send-on-delta events", SendOnDeltaSpec, SendOnDeltaState, send_on_delta.encode, _of_size(DeltaEvents),
        populations=ON_OFF,
    ),
    "sigma-delta": Model(
        "sigma-delta pulses", SigmaDeltaSpec, SigmaDeltaState, sigma_delta.encode, _of_size(DeltaEvents),
        populations=ON_OFF,
    ),
    "step-forward": Model(
        "step-forward events", StepForwardSpec, StepForwardState, step_forward.encode, _of_size(DeltaEvents),
        populations=ON_OFF,
    ),
    "moving-window": Model(
        "moving-window events", MovingWindowSpec, MovingWindowState, moving_window.encode, moving_window.layer,
        populations=ON_OFF, repeats=True,
    ),
    "bens-spiker": Model(
        "Ben's spiker", BensSpikerSpec, BensSpikerState, bens_spiker.encode, bens_spiker.layer, populations=ON_OFF
    ),
    "latency": Model("latency afferents", LatencySpec, LatencyState, latency.encode, _of_size(LatencyAfferents)),
    "burst": Model("burst afferents", BurstSpec, BurstState, burst.encode, burst.layer),
    "resonate-and-fire": Model(
        "resonate-and-fire afferents", ResonateAndFireSpec, ResonateAndFireState, resonate_and_fire.encode,
        _of_size(ResonatorAfferents), populations=(Population("LOW", "low"), Population("HIGH", "high")),
    ),
}  # fmt: skip


def _model_of(value: Any) -> str:
    """The model that a table or a spec names; LIF if it names none."""
    return str(value.get("model", "lif") if isinstance(value, Mapping) else getattr(value, "model", "lif"))


EncoderSpec = Annotated[
    Annotated[AfferentSpec, Tag("lif")]
    | Annotated[IzhikevichSpec, Tag("izhikevich")]
    | Annotated[PoissonSpec, Tag("poisson")]
    | Annotated[MechanoreceptorSpec, Tag("mechanoreceptor")]
    | Annotated[SendOnDeltaSpec, Tag("send-on-delta")]
    | Annotated[SigmaDeltaSpec, Tag("sigma-delta")]
    | Annotated[StepForwardSpec, Tag("step-forward")]
    | Annotated[MovingWindowSpec, Tag("moving-window")]
    | Annotated[BensSpikerSpec, Tag("bens-spiker")]
    | Annotated[LatencySpec, Tag("latency")]
    | Annotated[BurstSpec, Tag("burst")]
    | Annotated[ResonateAndFireSpec, Tag("resonate-and-fire")],
    Discriminator(_model_of),
]
Calibrated = AfferentSpec | MechanoreceptorSpec
"""Encoders that know their drives, and where in them a search for gains begins."""
CALIBRATED = (AfferentSpec, MechanoreceptorSpec)
AnyState = (
    EncoderState
    | ExactState
    | IzhikevichEncoderState
    | PoissonState
    | MechanoreceptorEncoderState
    | SendOnDeltaState
    | SigmaDeltaState
    | StepForwardState
    | MovingWindowState
    | BensSpikerState
    | LatencyState
    | BurstState
    | ResonateAndFireState
)


def populations(encoder: Mapping[str, Any] | Spec) -> tuple[Population, ...]:
    """The populations of an encoder, a spec or a table of one, in the order of its output.

    Spikes of a model that is not among `MODELS` are taken for SA-I and RA-I.

    >>> [population.name for population in populations(load("poisson"))]
    ['SA-I', 'RA-I']
    """
    model = MODELS.get(_model_of(encoder))
    if model is None:
        return SA_RA
    table = encoder if isinstance(encoder, Mapping) else dict(encoder)

    def is_there(part: str) -> bool:
        return not part or model.spec.model_fields[part].is_required() or table.get(part) is not None

    return tuple(population for population in model.populations if is_there(population.part))


def described(encoder: Spec, population: Population) -> Any:
    """The keys of a population: its part of the spec, or the whole spec.

    >>> encoder = load("poisson")
    >>> [described(encoder, population).t_ref_ms for population in populations(encoder)]
    [0.0, 0.0]
    """
    return getattr(encoder, population.part) if population.part else encoder


def t_ref_pair_ms(encoder: Spec) -> tuple[float, float]:
    """The refractory periods of the first two populations, which results name t_ref_sa_ms and t_ref_ra_ms.

    Both are the same where a refractory period holds for a whole channel.

    >>> t_ref_pair_ms(load("sa1-ra1-lif", {"ra1.t_ref_ms": 5}))
    (1.0, 5.0)
    """
    periods: list[float] = [described(encoder, population).t_ref_ms for population in populations(encoder)]
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
    fields = MODELS[model].spec.model_fields
    parts = dict.fromkeys(population.part for population in MODELS[model].populations)
    kinds = {part: fields[part].annotation if part else MODELS[model].spec for part in parts}
    return tuple(
        dotted(part, "t_ref_ms") for part, kind in kinds.items() if "t_ref_ms" in getattr(kind, "model_fields", {})
    )


def with_t_refs(encoder: Any, other: Spec) -> Any:
    """An encoder with the refractory periods of another one of its model.

    >>> with_t_refs(load("sa1-ra1-lif"), load("sa1-ra1-lif", {"ra1.t_ref_ms": 5})).ra1.t_ref_ms
    5.0
    """
    for population in populations(encoder):
        kind, period = described(encoder, population), {"t_ref_ms": described(other, population).t_ref_ms}
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
    kinds = [(population.name, marks(encoder.get(population.part) or {})) for population in populations(encoder)]
    return tuple(f"{name} {taxel}{mark}" for name, its in kinds for mark in its for taxel in taxels)


def taxel_names(afferents: Sequence[str], encoder: Mapping[str, Any]) -> tuple[str, ...] | None:
    """The names of the taxels of which an encoder, its spec as a table, named these afferents; None of other names.

    >>> taxel_names(("SA-I left", "SA-I right", "RA-I left", "RA-I right"), {})
    ('left', 'right')
    """
    before, _, after = afferent_names(("\0",), encoder)[0].partition("\0")
    first = afferents[: taxels_of(len(afferents), encoder)]
    taxels = tuple(name.removeprefix(before).removesuffix(after) for name in first)
    return taxels if afferent_names(taxels, encoder) == tuple(afferents) else None


def n_per_taxel(encoder: Spec) -> int:
    """The number of an encoder's afferents under a taxel.

    >>> n_per_taxel(load("sa1-ra1-lif")), n_per_taxel(load("sa1-ra1-lif-graded"))
    (2, 5)
    """
    return len(afferent_names(("",), encoder.model_dump()))


def taxels_of(n_afferents: int, encoder: Mapping[str, Any]) -> int:
    """The number of taxels for a number of afferents, by the encoder's spec as a table; at least one.

    >>> taxels_of(16, {}), taxels_of(50, {"sa1": {"grades": [0.5, 1.0, 2.0, 4.0]}})
    (8, 10)
    """
    return max(1, n_afferents // len(afferent_names(("",), encoder)))


def load(name: str | Path, overrides: Mapping[str, Any] | None = None) -> EncoderSpec:
    """Load the encoder spec called `name` (or at that path), after `overrides` of dotted keys.

    >>> load("izhikevich").model, load("sa1-ra1-lif", {"sa1.t_ref_ms": 5}).sa1.t_ref_ms
    ('izhikevich', 5.0)
    """
    path = specs.find("encoders", name)
    table = specs.override(specs.read(path), overrides or {})
    model = _model_of(table)
    if model not in MODELS:
        raise InputError(f"model: '{model}' is unknown; {nearest(model, [*MODELS])} ({path})")
    built = specs.build(MODELS[model].spec, table, source=str(path))
    check_used(overrides or {}, built.conditioning.baseline)
    return built


def resolve(what: str | Path | EncoderSpec, overrides: Mapping[str, Any] | None = None) -> EncoderSpec:
    """The encoder spec with the name or path `what`, or `what` itself, after `overrides`.

    >>> resolve(load("sa1-ra1-lif"), {"sa1.t_ref_ms": 5}).sa1.t_ref_ms
    5.0
    """
    if isinstance(what, (str, Path)):
        return load(what, overrides)
    if not isinstance(what, tuple(model.spec for model in MODELS.values())):
        raise InputError(f"encoder: must be a name, a path or an encoder spec; got {type(what).__name__}")
    changed = specs.resolve(type(what), what, overrides)
    check_used(overrides or {}, changed.conditioning.baseline)
    return changed


def encode(
    signal: np.ndarray,
    sampling_rate_Hz: float,
    spec: EncoderSpec,
    state: AnyState | None = None,
) -> tuple[np.ndarray, AnyState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, afferent)` uint8, as `afferent_names`.

    The state is an argument and a result, so that a recording encoded in pieces gives the spikes of the whole.
    A trial's spikes depend on its samples, the spec and its seed alone: not on other trials, nor on its index.

    >>> spikes, _ = encode(np.full((1, 200, 1), 10.0), 2000.0, load("sa1-ra1-lif"))
    >>> spikes.sum(axis=1).tolist()
    [[20, 0]]
    """
    model = MODELS[spec.model]
    own: Callable[..., tuple[np.ndarray, Any]] = exact.encode if is_exact(spec) else model.encode
    kind = ExactState if is_exact(spec) else model.state
    if state is not None and not isinstance(state, kind):
        raise InputError(f"state: is a {type(state).__name__}, of another encoder; pass the one that encode returned")
    return own(signal, sampling_rate_Hz, spec, state)


def encode_whole(signal: np.ndarray, sampling_rate_Hz: float, spec: EncoderSpec) -> np.ndarray:
    """The spikes of whole trials, to their end, as `encode` gives them piece by piece and then `finish`.

    >>> encode_whole(np.zeros((1, 200, 1)), 2000.0, load("sa1-ra1-lif")).shape
    (1, 200, 2)
    """
    if is_exact(spec):
        return exact.encode_whole(signal, sampling_rate_Hz, spec)
    return encode(signal, sampling_rate_Hz, spec)[0]


def finish(sampling_rate_Hz: float, spec: EncoderSpec, state: AnyState) -> np.ndarray | None:
    """The steps that the end of a trial adds to those of `encode`; None for encoders that step as their signal does.

    >>> finish(2000.0, load("sa1-ra1-lif"), encode(np.zeros((1, 200, 1)), 2000.0, load("sa1-ra1-lif"))[1])
    """
    if is_exact(spec) and isinstance(state, ExactState):
        return exact.finish(sampling_rate_Hz, spec, state)
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


def recorded_at(spec: EncoderSpec, recorded_Hz: float) -> EncoderSpec:
    """An encoder as spike trains carry it: with the rate of the recording, if its cost depends on that.

    >>> print(recorded_at(load("sa1-ra1-lif"), 93.0).recorded_Hz)
    None
    """
    return spec.model_copy(update={"recorded_Hz": recorded_Hz}) if is_exact(spec) else spec
