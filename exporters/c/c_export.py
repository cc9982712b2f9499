"""A chain as C99: one header, one source, an example and a README; in float or in integers.

Of the network of a sensor that sends events, from an event to a decision.

The float variant gives the same spikes as `stream`, the integer variant the same as `integer`.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np
from neurotact_parts.exporters.c import formats as whole
from neurotact_parts.exporters.c.formats import Formats, Integrator
from neurotact_parts.exporters.c.integer import CURVES, least_lead, whole_band
from neurotact_parts.exporters.c.matrices import Matrix, matrices_of
from neurotact_parts.streams.chain import LARGEST, Chain
from neurotact_parts.streams.events import afferents_of
from neurotact_parts.streams.native import columns_of, numbers_of

from neurotact import __version__, files
from neurotact.data.conditioning import HALF
from neurotact.encoders.afferents import POPULATIONS, AfferentType, marks
from neurotact.encoders.closed_form import AT_ONCE
from neurotact.encoders.specs import is_exact
from neurotact.errors import InputError, number_of, some
from neurotact.metrics.synops import REFUSED
from neurotact.networks.definition.executors import require
from neurotact.progress import printable

MOST_STEPS, MOST_COUNT = 2**31 - 1, 2**32 - 1
HOLD_MS = 5.0
"""For how long the last values stand in for missing ones, as in `Stream`; a macro of the export changes it."""
LINE = 110


class Table(NamedTuple):
    """A constant array in the C source."""

    about: str
    type: str
    name: str
    size: int
    lines: list[str]


EXPORTED = (("chain.h", "{}.h"), ("chain.c", "{}.c"), ("example.c", "example.c"), ("README.md", "README.md"))
HARNESS = (*EXPORTED[:2], ("harness.h", "harness.h"), ("harness.c", "harness.c"))
"""The files that `proof` compiles."""
RESERVED = ("example", "harness", "stub")


def write(
    chain: Chain,
    folder: Path,
    formats: Formats | None = None,
    *,
    name: str = "touch",
    parts: Sequence[tuple[str, str]] = EXPORTED,
    taught: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Write `NAME.h`, `NAME.c`, `example.c` and `README.md` into a folder, and return their paths.

    formats: of the integer variant; None: the float variant.
    name: prefix of every name in C. parts: pairs of a template and its file.
    taught: of a chain that learns, `learning.Teachable.context`.
    Raises InputError for what C cannot represent.
    """
    paths(folder, name)
    return rendered(with_learning(context_of(chain, formats, name), taught), folder, name, parts)


def with_learning(context: dict[str, Any], taught: Mapping[str, Any] | None) -> dict[str, Any]:
    """The variables of the templates, where the readout is state if it learns and else a table."""
    if taught is None:
        return {**context, "learns": False}
    names = [text(f"new class {number + 1}") for number in range(taught["n_new"])]
    tables = [table for table in context["tables"] if table.name not in ("w_out", "bias")]
    return {
        **context, **taught, "learns": True, "class_names": [*context["class_names"], *names],
        "tables": [*tables, *taught["taught_tables"]], "class_type": unsigned(taught["n_classes"]),
    }  # fmt: skip


def rendered(context: dict[str, Any], folder: Path, name: str, parts: Sequence[tuple[str, str]]) -> list[Path]:
    """Write each template of `parts` with these variables as its file, and return the paths."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("neurotact_parts.exporters.c", "templates"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    written = []
    for template, file in parts:
        path, own = folder / file.format(name), f"events_{template}.jinja"
        chosen = own if context["events"] and own in environment.list_templates() else f"{template}.jinja"
        files.write_text(path, environment.get_template(chosen).render(context))
        written.append(path)
    return written


def context_of(chain: Chain, formats: Formats | None, name: str) -> dict[str, Any]:
    """The variables of the templates."""
    require("c-float" if formats is None else "c-integer", chain.subject)
    network, plan, encoder = chain.network, chain.windows, chain.lif
    columns, used = chain.of_used()
    spec, conditioning = network.spec, encoder.conditioning
    n_taxels, integrator = chain.n_taxels, network.bias is not None
    detector, length = chain.detector, plan.length if chain.detector is None else 0  # counts of a detector go on at 0
    if max(length, plan.start, plan.quiet) > MOST_STEPS or (plan.hop > MOST_STEPS and detector is None):
        raise InputError("windows: are longer than 2^31 - 1 steps; shorten them")
    if length * max(network.n_inputs, spec.hidden) > MOST_COUNT:
        raise InputError("windows: their spikes may exceed a counter of 32 bits; shorten them")
    if length * sum(network.synapses.values()) > MOST_COUNT:
        raise InputError("windows: their synaptic operations may exceed a counter of 32 bits; shorten them")
    matrices = matrices_of(network, 4 if formats is None else 1)
    n_start = whole.conditioner_of(chain).n_start
    if n_start > MOST_STEPS:
        raise InputError("conditioning.start_ms: is longer than 2^31 - 1 steps; shorten it")
    heard = "(HIDDEN + AFFERENTS)" if spec.hears_afferents else "HIDDEN"
    per_sample = max(1, int(np.ceil(chain.clock_Hz / chain.sampling_rate_Hz)))
    return {
        "events": chain.takes_events, "step_ms": f"{1e3 / chain.clock_Hz:g}", "step_us": f"{1e6 / chain.clock_Hz:.0f}",
        "afferents": printable(some(list(afferents_of(chain)), 12)),
        "title": title_of(chain, formats), "version": __version__, "name": name, "macro": name.upper(),
        "spiking": True, "integer": formats is not None, "unit": _in_comment(encoder.unit),
        "sampling_rate_Hz": f"{chain.sampling_rate_Hz:g}",
        "n_taxels": n_taxels, "n_afferents": network.n_inputs,
        "n_hidden": spec.hidden, "n_classes": network.n_classes,
        "class_names": [text(name) for name in (*chain.classes, *([REFUSED] if chain.rule.least_lead else []))],
        "length": length, "start": plan.start, "hop": plan.hop if detector is None else 0, "quiet": plan.quiet,
        "at_once": plan.at_once, "detector": detector, "least": float(detector.threshold).hex() if detector else None,
        "most_decisions": plan.at_once * per_sample,
        "hold": max(1, int(HOLD_MS * 1e-3 * chain.sampling_rate_Hz)), "hold_ms": f"{HOLD_MS:g}",
        "afferent_type": unsigned(network.n_inputs), "neuron_type": unsigned(spec.hidden),
        "class_type": unsigned(network.n_classes),
        "numbers": chain.tells_numbers, "value_units": _value_units(formats),
        "integrator": integrator, "adapts": network.adaptation is not None, "recurrent": spec.recurrent,
        "direct": spec.hears_afferents,
        "membrane_kind": spec.membrane, "reset": spec.reset,
        "delay": spec.recurrent and spec.recurrent_delay_steps,
        "bin": network.steps_per_bin,
        "stretches": 1 if network.stretches is None else network.stretches.number,
        "stretch_steps": 1 if network.stretches is None else network.stretches.steps,
        "weight": "float" if formats is None else "int8_t", "felt_type": _count(chain),
        "patience": chain.rule.in_bins(network.steps_per_bin).patience, "from_first_spike": chain.rule.from_first_spike,
        "resampled": chain.sampling_rate_Hz != chain.signal_Hz, "finishes": chain.sampling_rate_Hz != chain.clock_Hz,
        "exact": is_exact(encoder), "rows": int(np.ceil(chain.clock_Hz / chain.signal_Hz)) + 1,
        "words": -(-network.n_inputs // 32), "baseline": conditioning.baseline,
        "rectify": conditioning.rectify,
        "columns": columns if len(columns) < n_taxels else [], "taxel_type": unsigned(n_taxels),
        "pruned": bool(network.synapses), "sparse": [name for name, matrix in matrices.items() if matrix.sparse],
        "weights_out": int(network.fans[2].sum()) if matrices["w_out"].sparse else f"({heard} * CLASSES)",
        **_with_numbers(_in_float(used, matrices) if formats is None else _in_integers(used, formats, matrices), used),
    }  # fmt: skip


def _value_units(formats: Formats | None) -> list[str]:
    """What 1 of each number stands for, in its unit."""
    return [] if formats is None else [f"{unit:.17g}" for unit in np.atleast_1d(formats.readout.unit).tolist()]


def _with_numbers(context: dict[str, Any], used: Chain) -> dict[str, Any]:
    """The variables with the number of each kind's afferent under taxel `i`, and a table of them where some have none.

    used: the chain of the taxels that an afferent uses.
    """
    each = numbers_of(columns_of(used), used.n_taxels)
    for index, (kind, numbers) in enumerate(zip(context["kinds"], each, strict=True)):
        kind["table"] = f"number_{index}" if (numbers < 0).any() else ""
        kind["number"] = f"{kind['table']}[i]" if kind["table"] else f"{numbers[0]} + i" if index else "i"
        if kind["table"]:
            lines = [*wrapped(map(str, numbers.tolist()))]
            about = f"numbers of the {kind['about']}, -1 where a taxel has none"
            context["tables"].append(Table(about, "int16_t", kind["table"], len(numbers), lines))
    return {**context, "moves": any("change" in kind["target"] for kind in context["kinds"])}


def paths(folder: Path, name: str) -> list[Path]:
    """The files that `write` writes; InputError for a name that is not valid in C or is reserved."""
    if not (name.isidentifier() and name.isascii()) or name in RESERVED:
        raise InputError(
            f"`name={name!r}`: must be a C name (letters, digits, underscores), not {' or '.join(RESERVED)}"
        )
    return [folder / file.format(name) for _, file in EXPORTED]


def title_of(chain: Chain, formats: Formats | None) -> str:
    """One line about an export."""
    spec = chain.network.spec
    end = "decision" if chain.detector is None else "events in time"
    kind = "float" if formats is None else f"{formats.weight_bits}-bit weights, {formats.state_bits}-bit states"
    sizes = f"{chain.network.n_inputs}-{spec.hidden}-{chain.network.n_classes}"
    if chain.takes_events:
        return f"A chain from events to {end}: {sizes} neurons, {kind}."
    return f"A chain from touch to {end}: {number_of(chain.n_taxels, 'taxel')}, {sizes} neurons, {kind}."


def _in_float(chain: Chain, kept: Mapping[str, Matrix]) -> dict[str, Any]:
    encoder, network = chain.lif, chain.network
    conditioning = encoder.conditioning
    conditioner, exact = whole.conditioner_of(chain), is_exact(encoder)
    alpha, beta, threshold = (np.asarray(p.detach()) for p in (network.alpha, network.beta, network.threshold))
    matrices = {"w_in": network.w_in, "w_rec": network.w_rec, "w_out": network.readout_weights}
    tables = [
        table
        for key, matrix in matrices.items()
        if key in kept
        for table in (_floats(key, kept[key].weights(matrix.detach().numpy())), *_indices(key, kept[key]))
    ]
    offset, scale = conditioning.offset is not None, conditioning.scale is not None
    for key, values in (("offset", conditioning.offset), ("scale", conditioning.scale)):
        tables += [] if values is None else [_floats(key, np.array(values, np.float32))]
    integration = network.integration
    if network.bias is not None:
        tables.append(_table("bias", "double", [float(b).hex() for b in network.bias.detach().double()]))
    indices = [*([0] if network.spec.hidden else []), *([1] if network.bias is None else [])]
    layers = [_float_layer(chain, index, alpha, beta, threshold) for index in indices]
    smoothing, smoothing_keep = _ema_weights(conditioner.smoothing)
    baseline_weight, baseline_keep = _ema_weights(conditioner.following)
    return {
        "value": "float", "sum": "double", "state": "float", "wide": "float",
        "largest": f"{LARGEST:g}", "largest_bits": f"0x{int(np.float32(LARGEST).view(np.uint32)):08x}",
        "count": "double" if network.bias is not None else _count(chain),
        "lead": "double", "least_lead": float(chain.rule.least_lead).hex() if chain.rule.least_lead else None,
        "band": [most.hex() for most in chain.rule.band],
        "readout_leak": float(integration.decay).hex() if integration is not None and integration.leaks else None,
        "peak": integration is not None and integration.peak,
        **(_closed_form(chain) if exact else _on_a_clock(chain)),
        "smoothing": smoothing, "smoothing_keep": smoothing_keep,
        "baseline_weight": baseline_weight, "baseline_keep": baseline_keep,
        "baseline_steps": f"{conditioner.n_start}u",
        "stride": (chain.sampling_rate_Hz / chain.signal_Hz).hex(), "half": HALF.hex(),
        "rate": float(chain.sampling_rate_Hz).hex(), "clock": float(chain.clock_Hz).hex(),
        "offset": offset, "scale": scale, "sign": False, "plain": True,
        "tables": tables, "layers": layers,
        "threshold_out": literal(threshold[1]),
    }  # fmt: skip


def _on_a_clock(chain: Chain) -> dict[str, Any]:
    """The afferents under each taxel, computed at each step of the clock: levels and steps."""
    encoder = chain.lif
    neurons = {part: encoder.neuron(getattr(encoder, part), chain.clock_Hz) for part in POPULATIONS}
    one = neurons["sa1"]
    own = {"threshold": literal(one.v_threshold_mV), "reset": literal(one.v_reset_mV)}
    return {
        "silent_type": unsigned(max(neuron.refractory_steps for neuron in neurons.values()) + 1),
        "membrane": "float", "leak": literal(one.decay), "v_rest": literal(one.v_rest_mV),
        "kinds": [
            {**kind, **own, "target": f"{literal(one.v_rest_mV)} + {drive}", "silent": neurons[part].refractory_steps}
            for part, drive, kind in _float_kinds(chain, chain.clock_Hz)
        ],
    }  # fmt: skip


def _closed_form(chain: Chain) -> dict[str, Any]:
    """The afferents under each taxel, computed once per sample, in double precision: levels, ms and steps."""
    encoder, rate_Hz, clock_Hz = chain.lif, chain.signal_Hz, chain.clock_Hz
    numbers = {
        "v_rest": encoder.v_rest_mV, "v_reset": encoder.v_reset_mV, "v_threshold": encoder.v_threshold_mV,
        "v_below": math.nextafter(encoder.v_threshold_mV, -math.inf), "tau_ms": encoder.tau_mem_ms,
        "sample_ms": 1e3 / rate_Hz, "decay": math.exp(-1e3 / rate_Hz / encoder.tau_mem_ms),
        "steps_per_ms": 1e-3 * clock_Hz, "steps_per_sample": clock_Hz / rate_Hz, "at_once": AT_ONCE,
    }  # fmt: skip
    v_rest = encoder.v_rest_mV.hex()
    return {
        "silent_type": "double", "membrane": "double", "v_rest": v_rest,
        "closed": {key: float(number).hex() for key, number in numbers.items()},
        "kinds": [
            {**kind, "target": f"{v_rest} + (double)({drive})", "silent": float(getattr(encoder, part).t_ref_ms).hex()}
            for part, drive, kind in _float_kinds(chain, rate_Hz)
        ],
    }  # fmt: skip


def _float_kinds(chain: Chain, signal_Hz: float) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """The type of each afferent under a taxel, its drive by samples of that rate, and words for it."""
    encoder = chain.lif
    felt = ("sa1", "felt"), ("ra1", "magnitude(change)")
    columns = encoder.columns(chain.n_taxels)
    for (part, what), gains, taxels in zip(felt, encoder.gains_at(signal_Hz), columns, strict=True):
        for gain, about in zip(gains, _words(getattr(encoder, part), part), strict=True) if taxels else ():
            yield part, f"{literal(gain)} * {what}", {"about": about}


def _words(kind: AfferentType, part: str) -> list[str]:
    """A word for each afferent of a type under a taxel, as `SA-I falling x0.5`."""
    return [("SA-I" if part == "sa1" else "RA-I") + mark for mark in marks(kind.model_dump())]


def _float_layer(chain: Chain, index: int, alpha: np.ndarray, beta: np.ndarray, threshold: np.ndarray) -> dict:
    decay = literal(beta[index])
    next_membrane = {
        "eq4": f"{decay} * (carried + before)",
        "delayed": f"{decay} * carried + before",
        "immediate": f"{decay} * carried + now",
    }[chain.network.spec.membrane]
    layer = _layer(chain, index) | {
        "alpha": literal(alpha[index]), "threshold": literal(threshold[index]), "next": next_membrane
    }  # fmt: skip
    if (adapted := chain.network.adaptation_of(index)) is None:
        return layer
    strength, decay = map(float, adapted)
    return layer | {"adapts": True, "strength": literal(strength), "adaptation_decay": literal(decay)}


def _in_integers(chain: Chain, formats: Formats, kept: Mapping[str, Matrix]) -> dict[str, Any]:
    front, raw, hidden, readout = formats.front, formats.raw, formats.hidden, formats.readout
    matrices = {"w_in": hidden.w, "w_rec": hidden.v, "w_out": readout.w}
    tables = [
        table
        for key, matrix in matrices.items()
        if key in kept
        for table in (_integers(key, kept[key].weights(matrix), "int8_t"), *_indices(key, kept[key]))
    ]
    levels = {kind.name: kind for kind in front.kinds}  # SA-I of the falling signal have those of the rising one
    levels = {} if chain.takes_events else levels
    for what in ("threshold", "reset"):
        tables += [_integers(f"{what}_{name}", getattr(kind, what), "int32_t") for name, kind in levels.items()]
    if front.closed:
        tables += [_integers(name, values, "uint32_t") for name, values in zip(("logs", "powers"), CURVES, strict=True)]
    has_offset = bool(front.offset.any())
    tables += [_integers("offset", front.offset, "int32_t")] if has_offset else []
    has_sign = bool((front.sign < 0).any())
    tables += [_integers("sign", front.sign, "int8_t")] if has_sign else []
    if isinstance(readout, Integrator):
        tables.append(_integers("bias", readout.bias, "int32_t"))
    layers = [_integer_layer(chain, 0, hidden)] if hidden.w.size else []
    layers += [] if isinstance(readout, Integrator) else [_integer_layer(chain, 1, readout)]
    stride = front.stride or (0, 0)
    return {
        "value": "int32_t", "membrane": "int32_t", "sum": "int64_t", "wide": "int32_t",
        "state": "int16_t" if formats.state_bits <= 16 else "int32_t",
        "count": "int32_t" if isinstance(readout, Integrator) else _count(chain),
        "lead": "int64_t", "least_lead": least_lead(readout, chain.rule) if chain.rule.least_lead else None,
        "band": whole_band(readout, chain.rule), "readout_leak": None, "peak": False,
        "silent_type": "uint32_t" if front.closed else unsigned(max(kind.silent for kind in front.kinds) + 1),
        "closed": front.closed, "octave": whole.OCTAVE, "tick": whole.TICK, "piece": whole.PIECE,
        "kinds": _integer_kinds(chain, front),
        "smoothing": front.smoothing, "baseline_weight": front.baseline_weight,
        "baseline_steps": f"{front.baseline_steps}u",
        "stride_whole": stride[0], "stride_part": stride[1], "stride": stride[0] * 2**32 + stride[1],
        "offset": has_offset, "scale": False, "sign": has_sign, "leak": front.leak,
        "lsb": f"{raw.lsb:.9g}", "zero": f"{raw.zero:.9g}", "plain": raw.is_plain, "fraction": whole.FRACTION,
        "mantissa": whole.MANTISSA, "most_state": 2 ** (formats.state_bits - 1) - 1,
        "weight_bits": formats.weight_bits, "state_bits": formats.state_bits,
        "tables": tables, "layers": layers,
        "threshold_out": 0 if isinstance(readout, Integrator) else readout.threshold,
    }  # fmt: skip


def _integer_kinds(chain: Chain, front: whole.FrontEnd) -> list[dict[str, Any]]:
    """As `_float_kinds`."""
    drives = {"signal": "felt", "falling": "-felt", "change": "change < 0 ? -change : change"}
    kinds = zip(("sa1", "ra1"), chain.lif.columns(chain.n_taxels), strict=True)
    words = [word for part, taxels in kinds if taxels for word in _words(getattr(chain.lif, part), part)]
    return [
        {
            "about": about, "target": drives[kind.drive], "threshold": f"threshold_{kind.name}[i]",
            "reset": f"reset_{kind.name}[i]", "silent": kind.silent,
        }
        for kind, about in zip(front.kinds, words, strict=True)
    ]  # fmt: skip


def _integer_layer(chain: Chain, index: int, layer: whole.Layer) -> dict[str, Any]:
    def decayed(what: str, factor: int) -> str:
        if layer.state_bits <= 16:
            return f"{what} * {factor} / {2**layer.decay_bits}"
        return f"(int32_t)((int64_t){what} * {factor} / {2**layer.decay_bits})"

    next_membrane = {
        "eq4": decayed("(carried + before)", layer.beta),
        "delayed": decayed("carried", layer.beta) + " + before",
        "immediate": decayed("carried", layer.beta) + " + now",
    }[chain.network.spec.membrane]
    return _layer(chain, index) | {
        "decay_current": decayed("before", layer.alpha), "threshold": layer.threshold, "next": next_membrane,
        "shift": layer.shift, "shift_rec": layer.shift_rec,
    }  # fmt: skip


def _layer(chain: Chain, index: int) -> dict[str, Any]:
    spec, n_afferents = chain.network.spec, chain.network.n_inputs
    if index == 0:
        return {
            "name": "hidden", "about": "hidden layer", "size": "HIDDEN", "recurrent": spec.recurrent, "adapts": False,
            "from_type": unsigned(n_afferents), "to_type": unsigned(spec.hidden), "w": "w_in", "v": "w_rec",
        }  # fmt: skip
    return {
        "name": "readout", "about": "readout", "size": "CLASSES", "recurrent": False, "adapts": False,
        "from_type": unsigned(spec.hidden), "to_type": unsigned(chain.network.n_classes), "w": "w_out", "v": "",
    }  # fmt: skip


ABOUT = {
    "w_in": "Weights from afferents to hidden neurons, one row per afferent.",
    "w_rec": "Weights from hidden neurons to hidden neurons, one row per presynaptic neuron.",
    "w_out": "Weights to classes, one row per hidden neuron, then per afferent if it hears them (of each stretch).",
    "to": "Neurons that these weights reach: only synapses that are left.",
    "row": "First weight of each row, and the end of the last.",
    "fan": "Synapses of each row, which synaptic operations count.",
    "bias": "Initial values of the readout.",
    "offset": "Subtracted from each taxel's signal.",
    "scale": "Divisors of each taxel's signal.",
    "sign": "Signs of each taxel's signal: -1 if it falls on contact.",
    "threshold_sa1": "Thresholds of SA-I afferents above rest, divided by their gains.",
    "threshold_ra1": "Thresholds of RA-I afferents above rest, divided by their gains.",
    "reset_sa1": "Reset values of SA-I afferents, in the same unit.",
    "logs": "Logarithms to the base 2 from 1 to 2, in equal pieces.",
    "powers": "2^-x for x from 0 to 1, in equal pieces.",
    "reset_ra1": "Reset values of RA-I afferents, in the same unit.",
}
"""What a table is, by its name; those of the second and later grades have a number after it."""


def _table(name: str, kind: str, values: Sequence[str]) -> Table:
    about = ABOUT.get(name.rpartition("_")[2]) or ABOUT[re.sub(r"(?<=1)_\d+$", "", name)]
    return Table(about, kind, name, len(values), list(wrapped(values)))


def _indices(name: str, matrix: Matrix) -> Iterator[Table]:
    for key, values in matrix.indices(name).items():
        yield _integers(key, values, unsigned(int(values.max())))


def _integers(name: str, values: np.ndarray, kind: str) -> Table:
    return _table(name, kind, [str(value) for value in values.ravel().tolist()])


def _floats(name: str, values: np.ndarray) -> Table:
    return _table(name, "float", [literal(value) for value in values.ravel()])


def wrapped(values: Iterable[str]) -> Iterable[str]:
    """Values of a table as lines of C."""
    line = ""
    for value in values:
        if len(line) + len(value) + 2 > LINE:
            yield line.rstrip()
            line = ""
        line += f"{value}, "
    yield line.rstrip().rstrip(",")


def literal(value: float | np.floating) -> str:
    """The shortest literal of a float32.

    >>> literal(0.1), literal(-65.0)
    ('1.e-01f', '-6.5e+01f')
    """
    return f"{np.format_float_scientific(np.float32(value), unique=True)}f"


def _ema_weights(weight: float | None) -> tuple[str | None, str | None]:
    """The weights of a moving average: of the newest sample, and of the average before."""
    return (None, None) if weight is None else (literal(weight), literal(1.0 - weight))


def unsigned(n: int) -> str:
    """The smallest type for the numbers 0 to n.

    >>> unsigned(255), unsigned(256)
    ('uint8_t', 'uint16_t')
    """
    return "uint8_t" if n < 2**8 else "uint16_t" if n < 2**16 else "uint32_t"


def _count(chain: Chain) -> str:
    return "uint16_t" if chain.windows.length < 2**16 else "uint32_t"


def text(text: str) -> str:
    """A C string; characters other than ASCII are octal escapes, which end after three digits.

    Half a surrogate pair, which is no UTF-8, is written as its escape in Python.
    """
    content = text.encode(errors="backslashreplace")
    plain = "".join(chr(b) if 32 <= b < 127 and b not in b'"\\?' else f"\\{b:03o}" for b in content)
    return f'"{plain}"'


def _in_comment(text: str) -> str:
    """A text in a comment of C, on one line, which it neither ends nor begins anew.

    >>> _in_comment("mV */ int x;")
    'mV * / int x;'
    """
    return printable(text).replace("*/", "* /").replace("/*", "/ *")
