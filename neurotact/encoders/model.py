"""The door of encoders: what a model of afferents brings, how its name is found, and what models share.

A model is an entry point of the group `neurotact.encoders`, ours or another package's (`docs/plugins.md`).
"""

import logging
import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Annotated, Any, ClassVar, NamedTuple, Self, TypeVar, get_args

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, SerializeAsAny, ValidationError
from pydantic_core import InitErrorDetails, PydanticKnownError

from neurotact import plugins
from neurotact.data.conditioning import ConditioningSpec
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost
from neurotact.spec import Spec

LEAST_MS = 0.05
"""A shorter refractory period is refused, since it is rather one in seconds: afferents have about 1 ms. 0 is none."""
SENSITIVITY = ("gain", "threshold")
"""How the name of the key begins that sets how much a population fires."""
StateT = TypeVar("StateT")

log = logging.getLogger("neurotact")


class EncoderSpec(Spec):
    """What the specs of all models have (`encoders/*.toml`); each gives `model` its own name as the default."""

    folder: ClassVar[str] = "encoders"

    model: str
    """The model of the afferents."""
    unit: str = "mV"
    """The unit of the recordings."""
    conditioning: ConditioningSpec = ConditioningSpec()

    @classmethod
    def any_of(cls) -> Mapping[str, type[Spec]]:
        """The specs of all models that can be used, by the name of the model."""
        return {name: model.spec for name, model in usable().items()} if cls is EncoderSpec else {}

    @classmethod
    def of_parts(cls, asked: str | None) -> Mapping[str, Mapping[str, Any]]:
        """The name of a model gives the defaults of its keys."""
        plugins.has("encoders", asked)
        return {name: {"model": name} for name in names()}


class DrivenSpec(EncoderSpec):
    """The spec of SA-I and RA-I with a `gain` and a `t_ref_ms` each that knows their drives.

    The search for gains begins where the strongest drive just reaches `least_drive`.
    """

    @property
    def is_signed(self) -> bool:
        """Whether the signal below zero drives afferents as the signal above does."""
        return False

    @property
    def gain_units(self) -> dict[str, str]:
        """The unit of each type's gain on standardised signals, by the type's name."""
        raise NotImplementedError

    @property
    def for_search(self) -> Self:
        """The encoder whose spikes are counted in the search for gains."""
        return self

    def felt(self, part: str, signal: np.ndarray, sampling_rate_Hz: float) -> np.ndarray:
        """The drive of a type at a gain of 1, of a signal `(time, taxel)`; of a change, there is one value less.

        Where both signs drive it, or one of two that share the gain, the magnitude.
        """
        raise NotImplementedError

    def least_drive(self, part: str) -> float:
        """The drive of a type at which it just fires."""
        raise NotImplementedError

    def least_isi_steps(self, part: str, sampling_rate_Hz: float) -> int:
        """The shortest inter-spike interval of a type on a clock."""
        return max(1, math.floor(getattr(self, part).t_ref_ms * 1e-3 * sampling_rate_Hz + 1e-9))

    def floor_steps(self, part: str, sampling_rate_Hz: float) -> int:
        """The longest interval that counts as at the refractory floor."""
        return math.ceil(getattr(self, part).t_ref_ms * 1e-3 * sampling_rate_Hz - 1e-9)

    def at_gain(self, part: str, gain: float) -> Self:
        """With that gain of a type."""
        return self.model_copy(update={part: getattr(self, part).model_copy(update={"gain": gain})})


class Population(NamedTuple):
    """A population of an encoder.

    name: the first word of its afferents' names. part: the key of the spec that describes it; empty if the keys of the
    whole spec do. least_Hz: the rate of recordings that contain what it feels; slower ones are refused.
    """

    name: str
    part: str = ""
    least_Hz: float = 0.0


SA_RA = Population("SA-I", "sa1"), Population("RA-I", "ra1")
ON_OFF = Population("ON"), Population("OFF")


class Model(NamedTuple):
    """An encoder model, the part that an entry point of `neurotact.encoders` names.

    title: its afferents, in words. spec: its keys.
    encode: `encode(signal, sampling_rate_Hz, spec, state)` gives the spikes `(trial, time, afferent)` uint8 of a
        conditioned signal `(trial, time, taxel)`, and the state for its next piece; before the first it is None.
    state: the type of that state. Without it signals are not encoded in pieces, and so not in streams.
    populations: in the order of its output. One whose part of the spec is optional has no afferents without it.
    cost: `cost(spec as a table, taxels, steps, step_ms)`, beside that of the conditioning; None: it is not counted.
    decode: the signal that spikes stand for, `decode(ON minus OFF, step_ms, spec)`; None: they have no such meaning.
    repeats: whether an afferent fires at every step at which a condition holds, so that most of its intervals are the
        shortest possible.
    is_compared: whether the study `which-encoder` has it, as every model whose calibration takes seconds.
    not_streamed: why streams refuse it; empty if they take it.
    """

    title: str
    spec: type[EncoderSpec]
    encode: Callable[..., tuple[np.ndarray, Any]]
    state: type | None = None
    populations: tuple[Population, ...] = SA_RA
    cost: Callable[[Mapping[str, Any], int, int, float], Cost] | None = None
    decode: Callable[[np.ndarray, float, Any], np.ndarray] | None = None
    repeats: bool = False
    is_compared: bool = True
    not_streamed: str = ""


def names() -> list[str]:
    """The names of all models, ours first; nothing is imported.

    >>> names()[:2], "burst" in names()
    (['lif', 'izhikevich'], True)
    """
    return plugins.in_order("encoders")


@lru_cache
def of_name(name: str) -> Model:
    """The model of that name; InputError where there is none, or it cannot be used.

    >>> of_name("burst").title
    'burst afferents'
    """
    model = plugins.load("encoders", name, Model)
    if why := _unfit(name, model):
        raise plugins.unfit("encoders", name, why)
    return model


def _unfit(name: str, model: Model) -> str | None:
    """Why a model cannot be used, in words; None if it can."""
    if not (isinstance(model.spec, type) and issubclass(model.spec, EncoderSpec)):
        return "has a spec that is not an EncoderSpec"
    if model.spec.model_fields["model"].default != name:
        return f'has a spec whose `model` is not "{name}"'
    functions = {"encode": model.encode, "cost": model.cost, "decode": model.decode}
    for key, function in functions.items():
        if not callable(function) and (function is not None or key == "encode"):
            return f"has no function as its {key}"
    if not model.populations or not all(isinstance(population, Population) for population in model.populations):
        return "has no populations"
    for population in model.populations:
        if (kind := part_of(model.spec, population.part)) is None:
            return f"has a population {population.name} and no table '{population.part}' in its spec"
        if sensitivity_key(kind) is None:
            return f"has no key of {population.name} that begins with gain or threshold, which calibration sets"
    return None


def part_of(spec: type[EncoderSpec], part: str) -> type[Spec] | None:
    """The table that describes a population: a part of a spec, or the spec itself; None where it has no such table."""
    if not part:
        return spec
    field = spec.model_fields.get(part)
    kinds = () if field is None else (field.annotation, *get_args(field.annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Spec)), None)


def sensitivity_key(kind: type[Spec]) -> str | None:
    """The key of a population that sets how much it fires: the first gain or threshold; None if it has neither."""
    return next((key for key in kind.model_fields if key.startswith(SENSITIVITY)), None)


def usable() -> dict[str, Model]:
    """Every model that can be used, by its name; of another a warning is logged, once."""
    return {name: model for name in names() if (model := _usable(name)) is not None}


@lru_cache
def _usable(name: str) -> Model | None:
    try:
        return of_name(name)
    except InputError as error:
        log.warning("%s", error)
        return None


def name_in(table: Mapping[str, Any]) -> str:
    """The model that a table of an encoder names; LIF if it names none."""
    return str(table.get("model", "lif"))


def _built(value: Any) -> Any:
    """The spec of a table, by the model that it names; its errors say that model first, as those of a union do."""
    if not isinstance(value, Mapping):
        return value
    name, known = name_in(value), names()
    if name not in known:
        tags = {"discriminator": "model", "tag": name, "expected_tags": ", ".join(map(repr, known))}
        raise PydanticKnownError("union_tag_invalid", tags)
    try:
        return of_name(name).spec.model_validate(value)
    except ValidationError as error:
        lines = [
            InitErrorDetails(type=e["type"], loc=(name, *e["loc"]), input=e["input"], ctx=e.get("ctx", {}))
            for e in error.errors()
        ]
        raise ValidationError.from_exception_data(error.title, lines) from error


AnyEncoder = Annotated[SerializeAsAny[EncoderSpec], BeforeValidator(_built)]
"""A key of a spec that holds an encoder of any model."""


def _in_ms(t_ref_ms: float) -> float:
    if 0 < t_ref_ms < LEAST_MS:
        raise ValueError(f"must be 0 or at least {LEAST_MS:g} ms (did you mean {1e3 * t_ref_ms:g} ms?)")
    return t_ref_ms


RefractoryMs = Annotated[float, Field(ge=0), AfterValidator(_in_ms)]
"""A refractory period in ms, 0 for none."""


def checked(signal: np.ndarray) -> np.ndarray:
    """The signal, if it is a float array `(trial, time, taxel)`; else InputError."""
    signal = np.asarray(signal)
    if signal.ndim != 3 or signal.dtype.kind != "f":
        raise InputError(f"signal: must be a float array (trial, time, taxel); got {signal.dtype} {signal.shape}")
    return signal


def over_time(
    signal: np.ndarray,
    state: StateT,
    step: Callable[[np.ndarray, StateT], tuple[np.ndarray, StateT]],
    n_afferents: int,
) -> tuple[np.ndarray, StateT]:
    """The spikes of a step function over a signal `(trial, time, taxel)`, and the state after it.

    Spikes are `(trial, time, afferent)` uint8.
    step: from the samples of one time, `(trial, taxel)`, and a state to spikes `(trial, afferent)` and the next state.

    >>> over_time(np.ones((1, 3, 1)), 0, lambda x, n: (x > n, n + 1), 1)[0].ravel().tolist()
    [1, 0, 0]
    """
    spikes = np.empty((len(signal), signal.shape[1], n_afferents), np.uint8)
    for t in range(signal.shape[1]):
        spikes[:, t], state = step(signal[:, t], state)
    return spikes, state


def both(positive: np.ndarray, negative: np.ndarray) -> np.ndarray:
    """ON before OFF, `(trial, taxel)` each to `(trial, 2 taxel)`."""
    return np.concatenate([positive, negative], axis=1)
