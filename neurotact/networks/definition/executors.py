"""What runs where: the features of a chain, the programs that execute it, and the one table of what each of them lacks.

The reference in torch runs everything and defines what is right. Every other executor gives the same spikes and
decisions, or refuses a feature with the sentence of this table. Tests, refusals and the page of executors are made from
it, so that a new feature is entered here and nowhere else.
"""

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import torch

from neurotact import plugins
from neurotact.data.conditioning import ACAUSAL, ConditioningSpec
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import EncoderSpec, names, of_name
from neurotact.encoders.specs import is_exact
from neurotact.errors import InputError
from neurotact.networks.definition import native
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.neurons import FAST_SIGMOID


class Subject(NamedTuple):
    """What is to be executed: an encoder, unless spikes are the input, a network, and an exit rule, or a detector's."""

    encoder: EncoderSpec | None
    network: native.Network
    rule: ExitRule = FULL_WINDOW
    detects: bool = False

    @property
    def conditioning(self) -> ConditioningSpec:
        """The conditioning of the encoder."""
        return ConditioningSpec() if self.encoder is None else self.encoder.conditioning


class _Feature(NamedTuple):
    """A feature of a chain.

    part: `conditioning`, `encoder`, `network`, `readout` or `exit`. keys: the keys of a spec that set it, as a user
    writes them. present: whether a subject has it. instead: what to do where it is refused.
    """

    part: str
    keys: tuple[str, ...]
    present: Callable[[Subject], bool]
    instead: str


class _Executor(NamedTuple):
    """A program that executes chains.

    what: its name in sentences. parts: the parts of a chain that it executes; the others come before or after it.
    lacks: for each feature that it refuses, the reason. leaves: for each feature without whose part it executes the
    rest of the chain, the reason. is_equal: whether it spikes as the reference does; otherwise what it writes names the
    differences.
    """

    what: str
    parts: tuple[str, ...]
    lacks: Mapping[str, str]
    leaves: Mapping[str, str] = MappingProxyType({})
    is_equal: bool = True


def _lif(subject: Subject) -> AfferentSpec | None:
    return subject.encoder if isinstance(subject.encoder, AfferentSpec) else None


def _of_model(model: str) -> Callable[[Subject], bool]:
    """Whether an encoder is of a model."""
    return lambda subject: subject.encoder is not None and subject.encoder.model == model


def _is_of_another_package(subject: Subject) -> bool:
    return subject.encoder is not None and not plugins.is_ours("encoders", subject.encoder.model)


def _of_spec(key: str, *values: object) -> Callable[[Subject], bool]:
    """Whether a key of the network's spec has one of these values."""
    return lambda subject: getattr(subject.network.spec, key) in values


def _has_grades(subject: Subject) -> bool:
    lif = _lif(subject)
    return lif is not None and not lif.has_one_grade


CHAIN = ("conditioning", "encoder", "network", "readout", "exit")
EVENTS, OTHER = "events of a sensor", "network of another model"
LAYERS, IN_NODES = "several layers, or a graph", ("layered", "graph")
IN_TIME, SETTLED = "events in time", "exit of settled numbers"
NO_LAYER, PAST = "no hidden layer", "path past the hidden layer"
CAUSAL_INSTEAD = "encode and train with conditioning.baseline start, high-pass or none"
LIF_INSTEAD = "encode and train with sa1-ra1-lif"
OUR_MODELS = {name: of_name(name) for name in names() if plugins.is_ours("encoders", name) and name != "lif"}
OF_ANOTHER_PACKAGE = "afferents of another package"
OTHER_MODELS = {
    **{
        model.title: _Feature("encoder", ("model",), _of_model(name), LIF_INSTEAD) for name, model in OUR_MODELS.items()
    },
    OF_ANOTHER_PACKAGE: _Feature("encoder", ("model",), _is_of_another_package, LIF_INSTEAD),
}
"""Every encoder model but LIF."""
COMPILED = {model.title for model in OUR_MODELS.values() if "backend" in model.encode.__annotations__}
"""Of these, those with a kernel."""
FEATURES: dict[str, _Feature] = {
    "moving average": _Feature(
        "conditioning", ("ema_cutoff_Hz",), lambda s: s.conditioning.ema_cutoff_Hz is not None, "leave it out"
    ),
    "resampling": _Feature(
        "conditioning", ("resample_Hz",), lambda s: s.conditioning.resample_Hz is not None, "record at the clock"
    ),
    "baseline of the past": _Feature(
        "conditioning",
        ("baseline", "start_ms", "high_pass_Hz"),
        lambda s: s.conditioning.baseline not in (*ACAUSAL, "none"),
        "leave it out",
    ),
    "baseline of the whole trial": _Feature(
        "conditioning", ("baseline",), lambda s: s.conditioning.baseline in ACAUSAL, CAUSAL_INSTEAD
    ),
    "standardisation": _Feature(
        "conditioning",
        ("offset", "scale"),
        lambda s: s.conditioning.offset is not None or s.conditioning.scale is not None,
        "leave it out",
    ),
    "rectification": _Feature("conditioning", ("rectify",), lambda s: s.conditioning.rectify, "leave it out"),
    "LIF afferents": _Feature(
        "encoder",
        ("model", "v_rest_mV", "v_reset_mV", "v_threshold_mV", "tau_mem_ms", "gain", "t_ref_ms"),
        lambda s: _lif(s) is not None,
        LIF_INSTEAD,
    ),
    "several grades a taxel": _Feature("encoder", ("grades",), _has_grades, "train without sa1.grades and ra1.grades"),
    "SA-I of the falling signal": _Feature(
        "encoder",
        ("opposite",),
        lambda s: (lif := _lif(s)) is not None and lif.sa1.opposite,
        "train without sa1.opposite",
    ),
    "afferents under some taxels": _Feature(
        "encoder",
        ("taxels", "recorded_taxels"),
        lambda s: (lif := _lif(s)) is not None and not lif.has_all_taxels,
        "train without sa1.taxels and ra1.taxels",
    ),
    "half-wave rate of change": _Feature(
        "encoder",
        ("change",),
        lambda s: (lif := _lif(s)) is not None and lif.ra1.change != "rectified",
        "stream it, or train without ra1.change",
    ),
    "rise in SA-I": _Feature(
        "encoder",
        ("rate_ms",),
        lambda s: (lif := _lif(s)) is not None and lif.sa1.rate_ms > 0,
        "stream it, or train without sa1.rate_ms",
    ),
    "membranes in closed form": _Feature(
        "encoder",
        ("integration", "recorded_Hz"),
        lambda s: s.encoder is not None and is_exact(s.encoder),
        "stream it, or train with integration = 'clock'",
    ),
    **OTHER_MODELS,
    EVENTS: _Feature("encoder", (), lambda s: s.encoder is None, LIF_INSTEAD),
    LAYERS: _Feature("network", ("model",), _of_spec("model", *IN_NODES), "train with model = 'rsnn' or 'snn'"),
    OTHER: _Feature(
        "network",
        ("model",),
        lambda s: s.network.spec.own is not None and s.network.spec.model not in IN_NODES,
        "train with model = 'rsnn' or 'snn'",
    ),
    NO_LAYER: _Feature(
        "network",
        ("hidden",),
        lambda s: s.network.spec.own is None and not s.network.spec.hidden,
        "train with hidden neurons, as in hidden = 20",
    ),
    "clock of the network": _Feature(
        "network", ("step_ms",), lambda s: s.network.steps_per_bin > 1, "train with step_ms = 'encoder'"
    ),
    "clock slower than its encoder's": _Feature(
        "encoder",
        ("step_ms",),
        lambda s: s.encoder is not None and s.network.steps_per_bin > 1,
        "export the network alone, on whose own clock spikes then arrive, or train with step_ms = 'encoder'",
    ),
    "recurrence": _Feature(
        "network", ("model", "recurrent_weight_scale"), lambda s: s.network.spec.recurrent, "train with model = 'snn'"
    ),
    "recurrence in blocks": _Feature(
        "network",
        ("recurrent_blocks",),
        lambda s: s.network.spec.recurrent and s.network.spec.recurrent_blocks > 1,
        "train with recurrent_blocks = 1 and training.members = 1",
    ),
    "recurrent delay": _Feature(
        "network",
        ("recurrent_delay_steps",),
        lambda s: s.network.spec.recurrent and s.network.spec.recurrent_delay_steps > 0,
        "train with recurrent_delay_steps = 0",
    ),
    "membrane eq4": _Feature("network", ("membrane",), _of_spec("membrane", "eq4"), "train with another membrane"),
    "membrane delayed": _Feature(
        "network", ("membrane",), _of_spec("membrane", "delayed"), "train with another membrane"
    ),
    "membrane immediate": _Feature(
        "network", ("membrane",), _of_spec("membrane", "immediate"), "train with another membrane"
    ),
    "reset zero": _Feature("network", ("reset",), _of_spec("reset", "zero"), "train with another reset"),
    "reset subtract": _Feature("network", ("reset",), _of_spec("reset", "subtract"), "train with another reset"),
    "reset hard": _Feature("network", ("reset",), _of_spec("reset", "hard"), "train with reset = 'zero' or 'subtract'"),
    "adaptive thresholds": _Feature(
        "network",
        ("threshold_adaptation", "tau_adaptation_ms"),
        lambda s: s.network.spec.threshold_adaptation > 0,
        "train with threshold_adaptation = 0",
    ),
    "learned constants": _Feature("network", ("learn",), lambda s: bool(s.network.spec.learn), "train with learn = []"),
    "another surrogate": _Feature(
        "network",
        ("surrogate",),
        lambda s: s.network.spec.surrogate != FAST_SIGMOID,
        "train with surrogate = 'fast-sigmoid'",
    ),
    "double precision": _Feature("network", (), lambda s: s.network.w_in.dtype == torch.float64, "train it in float32"),
    "readout count": _Feature("readout", ("readout",), _of_spec("readout", "count"), "train with another readout"),
    "readout integrator": _Feature(
        "readout",
        ("readout",),
        lambda s: s.network.spec.readout == "integrator" and s.network.spec.readout_leak_ms is None,
        "train with another readout",
    ),
    "readout that leaks": _Feature(
        "readout",
        ("readout", "readout_tau_ms"),
        lambda s: s.network.spec.readout == "integrator" and s.network.spec.readout_leak_ms is not None,
        "train with another readout",
    ),
    "readout max": _Feature("readout", ("readout",), _of_spec("readout", "max"), "train with readout = 'integrator'"),
    "readout of stretches": _Feature(
        "readout",
        ("readout_stretches", "readout_stretch_ms"),
        lambda s: s.network.stretches is not None,
        "train with readout_stretches = 1",
    ),
    PAST: _Feature(
        "readout",
        ("direct",),
        lambda s: s.network.spec.hears_afferents and s.network.spec.hidden > 0,
        "train with direct = false",
    ),
    IN_TIME: _Feature("exit", (), lambda s: s.detects, "export it in float32"),
    "exit by patience": _Feature("exit", (), lambda s: s.rule.patience is not None, "decide at the end of a window"),
    SETTLED: _Feature("exit", (), lambda s: bool(s.rule.band), "decide at the end of a window"),
    "none of these": _Feature("exit", ("refuse",), lambda s: s.rule.least_lead > 0, "train without refuse"),
}
"""Every feature of a chain, in the order of its parts."""

SETTINGS = frozenset({
    "hidden", "tau_mem_ms", "tau_syn_ms", "surrogate_scale", "readout_surrogate_scale", "forward_weight_scale",
    "input_deviation", "recipe", "effort", "training", "unit", "conditioning", "sa1", "ra1",
    "taxels",
})  # fmt: skip
"""Keys of specs of networks, LIF afferents and conditioning that are sizes, constants or how a network is trained."""

_ONE_LAYER = dict.fromkeys((LAYERS, OTHER), "it runs only one hidden layer of CUBA-LIF neurons")
_STREAMED = {
    **_ONE_LAYER,
    **{model.title: model.not_streamed for model in OUR_MODELS.values() if model.not_streamed},
    OF_ANOTHER_PACKAGE: "only models of neurotact are tested to spike in pieces as in the whole",
    "baseline of the whole trial": "a stream has not received the whole trial yet",
    "double precision": "a chain is deployed in float32",
}
_IN_INTEGERS = {
    IN_TIME: "its readout must leak, and a leak has no integer form",
    "adaptive thresholds": "they have no integer form; export it in float32",
    "readout that leaks": "a leak has no integer form; export it in float32",
    "readout max": "a leak has no integer form; export it in float32",
}
_IN_C = {
    **dict.fromkeys(OTHER_MODELS, "C has LIF afferents alone"),
    "half-wave rate of change": "the RA-I of C are driven by rise and fall alike",
    "rise in SA-I": "the SA-I of C are driven by the signal alone",
}
_NOT_IN_NIR = {
    OTHER: "it has nodes for the networks of neurotact",
    "adaptive thresholds": "it has no neuron whose threshold adapts",
}
_OUTSIDE_NIR = {
    "clock slower than its encoder's": "it has no node that puts spikes into bins",
    "half-wave rate of change": "its graph rectifies the rate of change",
    "rise in SA-I": "its graph drives SA-I by the signal alone",
    "membranes in closed form": "its neurons step on a clock",
    **dict.fromkeys(OTHER_MODELS, "it has no nodes for them"),
}
EXECUTORS: dict[str, _Executor] = {
    "reference": _Executor("the reference", CHAIN, {}),
    "native": _Executor(
        "the native kernels",
        ("encoder", "network", "readout", "exit"),
        {
            **{title: "NumPy computes them" for title in OTHER_MODELS if title not in COMPILED},
            "another surrogate": "they have the fast sigmoid alone",
        },
    ),
    "stream": _Executor("a stream", CHAIN, _STREAMED),
    "c-float": _Executor("C in float32", CHAIN, {**_STREAMED, **_IN_C}),
    "c-integer": _Executor("C in integers", CHAIN, {**_STREAMED, **_IN_C, **_IN_INTEGERS}),
    "nir": _Executor(
        "NIR",
        ("encoder", "network", "readout"),
        {**_NOT_IN_NIR, "readout max": "it has no node for a maximum over time, except in the plain form"},
        _OUTSIDE_NIR,
    ),
    "nir-plain": _Executor(
        "plain NIR",
        ("encoder", "network", "readout"),
        {**_NOT_IN_NIR, **dict.fromkeys((LAYERS, NO_LAYER, PAST), "its form is a chain of two layers of neurons")},
        _OUTSIDE_NIR,
        is_equal=False,
    ),
    "snntorch": _Executor(
        "snnTorch",
        ("network", "readout"),
        {
            **_ONE_LAYER,
            NO_LAYER: "it exchanges layers of its neurons",
            "reset hard": "its neurons have only 'zero' and 'subtract'",
            "adaptive thresholds": "its Synaptic has fixed thresholds",
            "double precision": "its spikes are float32",
        },
    ),
}
"""Every program that executes chains, the reference first."""


def require(executor: str, subject: Subject) -> None:
    """InputError with the feature, the reason and what to do instead, for the first one that an executor lacks.

    >>> from neurotact.networks.definition.rsnn import RSNN
    >>> network = RSNN(2, 3, sampling_rate_Hz=1000.0, hidden=4, reset="hard")
    >>> require("snntorch", Subject(None, network))
    Traceback (most recent call last):
    neurotact.errors.InputError: reset hard: snnTorch does not run it: its neurons have only 'zero' and 'subtract'; ...
    """
    name = lacking(executor, subject)
    if name is not None:
        raise refusal(executor, name)


def refusal(executor: str, name: str) -> InputError:
    """The error for a feature that an executor lacks."""
    return InputError(f"{_why(executor, name, EXECUTORS[executor].lacks)}; {FEATURES[name].instead}")


def lacking(executor: str, subject: Subject) -> str | None:
    """The first feature of a subject that an executor lacks; None if it runs all."""
    return _first(EXECUTORS[executor].lacks, subject)


def left_outside(executor: str, subject: Subject) -> str | None:
    """The first feature for which an executor leaves the encoder outside, and the reason; None if it runs it.

    >>> from neurotact.encoders.specs import load
    >>> from neurotact.networks.definition.rsnn import RSNN
    >>> network = RSNN(2, 3, sampling_rate_Hz=1000.0, hidden=4, step_ms=5.0)
    >>> left_outside("nir", Subject(load("sa1-ra1-lif"), network))
    "clock slower than its encoder's: NIR does not run it: it has no node that puts spikes into bins"
    """
    name = _first(EXECUTORS[executor].leaves, subject)
    return None if name is None else _why(executor, name, EXECUTORS[executor].leaves)


def _first(names: Iterable[str], subject: Subject) -> str | None:
    return next((name for name in names if FEATURES[name].present(subject)), None)


def _why(executor: str, name: str, reasons: Mapping[str, str]) -> str:
    return f"{name}: {EXECUTORS[executor].what} does not run it: {reasons[name]}"


def table() -> list[tuple[str, ...]]:
    """Rows for the page: a feature, its part, and for each executor `equal`, `differs`, `outside`, or why not.

    >>> table()[0][:3]
    ('moving average', 'conditioning', 'equal')
    """
    return [
        (name, feature.part, *(_cell(executor, name, feature) for executor in EXECUTORS.values()))
        for name, feature in FEATURES.items()
    ]


def _cell(executor: _Executor, name: str, feature: _Feature) -> str:
    if name in executor.lacks:
        return f"no: {executor.lacks[name]}"
    if name in executor.leaves:
        return f"outside, with the encoder: {executor.leaves[name]}"
    if feature.part not in executor.parts:
        return "outside"
    return "equal" if executor.is_equal else "differs"
