"""The encoder specs (`encoders/*.toml`): `model` selects the neurons of the afferents."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Discriminator, Tag

from neurotact import spec as specs
from neurotact.data.conditioning import check_used
from neurotact.encoders import afferents, izhikevich, poisson
from neurotact.encoders.afferents import POPULATIONS, AfferentSpec, EncoderState, marks
from neurotact.encoders.izhikevich import IzhikevichEncoderState, IzhikevichSpec
from neurotact.encoders.poisson import PoissonSpec, PoissonState
from neurotact.errors import InputError, nearest
from neurotact.metrics.flops import Afferents, Layer, PoissonAfferents


class Model(NamedTuple):
    """An encoder model: its spec, its state, and `encode(signal, sampling_rate_Hz, spec, state)`.

    layer: its layer in the cost ledger, `layer(spec as a table, taxels, steps, step_ms)`.
    is_random: whether its `encode` also takes `trials`, the numbers that seed it.
    """

    spec: Any
    state: type
    encode: Callable[..., tuple[np.ndarray, Any]]
    layer: Callable[[Mapping[str, Any], int, int, float], Layer]
    is_random: bool = False


def _of_size(layer: Callable[[int, int], Layer]) -> Callable[[Mapping[str, Any], int, int, float], Layer]:
    """The layer of a model whose cost depends only on the numbers of taxels and steps."""
    return lambda _spec, taxels, steps, _step_ms: layer(taxels, steps)


def _lif_layer(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Layer:
    del step_ms
    n_sa1, n_ra1 = (len(marks(spec.get(part) or {})) for part in POPULATIONS)
    return Afferents(taxels, steps, n_sa1, n_ra1)


MODELS = {
    "lif": Model(AfferentSpec, EncoderState, afferents.encode, _lif_layer),
    "izhikevich": Model(IzhikevichSpec, IzhikevichEncoderState, izhikevich.encode, izhikevich.layer),
    "poisson": Model(PoissonSpec, PoissonState, poisson.encode, _of_size(PoissonAfferents), is_random=True),
}


def _model_of(value: Any) -> str:
    """The model that a table or a spec names; LIF if it names none."""
    return str(value.get("model", "lif") if isinstance(value, Mapping) else getattr(value, "model", "lif"))


EncoderSpec = Annotated[
    Annotated[AfferentSpec, Tag("lif")]
    | Annotated[IzhikevichSpec, Tag("izhikevich")]
    | Annotated[PoissonSpec, Tag("poisson")],
    Discriminator(_model_of),
]
AnyState = EncoderState | IzhikevichEncoderState | PoissonState


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
    *,
    trials: np.ndarray | None = None,
) -> tuple[np.ndarray, AnyState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, afferent)` uint8, SA-I first.

    The state is an argument and a result, so that a recording encoded in pieces gives the spikes of the whole.
    trials: numbers of the trials, `(trial,)`, which seed random encoders; 0, 1, ... when absent.

    >>> spikes, _ = encode(np.full((1, 200, 1), 10.0), 2000.0, load("sa1-ra1-lif"))
    >>> spikes.sum(axis=1).tolist()
    [[20, 0]]
    """
    model = MODELS[spec.model]
    if state is not None and not isinstance(state, model.state):
        raise InputError(f"state: is a {type(state).__name__}, of another encoder; pass the one that encode returned")
    further = {"trials": trials} if model.is_random else {}
    return model.encode(signal, sampling_rate_Hz, spec, state, **further)
