"""Which networks fit a neuromorphic chip: the published limits that they exceed, and the cost of a change.

The limits are from the chips' public simulators and data sheets, named in `SOURCES`; nothing was run on the chips.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from neurotact.errors import InputError, nearest
from neurotact.lazily import lazily
from neurotact.progress import Tell, untold

with lazily():
    import pandas as pd
    from neurotact_parts.streams import chain as chains

    from neurotact.networks.definition import executors
    from neurotact.networks.definition import rsnn as recurrent
    from neurotact.networks.exit import rule as exit_rule
    from neurotact.networks.use import fitted


SOURCES = {
    "xyloaudio2": "rockpool.ai/devices/xylo-overview.html (16 inputs, 1000 hidden and 8 output neurons, 8-bit "
    "weights, bit-shift decays, subtractive reset, fan-out of 32 on average) and Rockpool's syns61201/xylo_mapper.py",
    "loihi2": "the bit-accurate LIF of Lava (lava-nc/lava, proc/lif/models.py: 12-bit decays, reset to 0 after a "
    "spike) and the emulator brian2-loihi (refractory period of 1 to 64 steps); neurons per core and 8-bit weights "
    "from Davies et al. 2018 (doi 10.1109/MM.2018.112130359), unverified; Loihi 2 also supports microcode",
    "spinnaker2": "SpiNNaker2 data sheet 0.03 of 2021 (SpiNNakerManchester/SpiNNMachine/files/14848134 on GitHub): 152 "
    "Cortex-M4F processors with 128 kB of local memory each, programmed in C: any membrane, reset and exit fits",
}
"""Each source was checked; limits that were not found there are marked unverified."""
PROCESSOR_BYTES = 128 * 1024
MOST_ROUNDING = 0.05
"""Weights fit up to this r.m.s. change by rounding, relative to their mean magnitude."""


class Finding(NamedTuple):
    """One requirement of a chip: whether a network meets it, and the cost of meeting it."""

    what: str
    here: str
    limit: str
    fits: bool
    cost: str


class Asked(NamedTuple):
    """The input of a check: a network, its encoder as a table, empty if a sensor sends events, and its exit rule."""

    network: "recurrent.RSNN"
    encoder: Mapping[str, Any] | None
    rule: "exit_rule.ExitRule"


def compare(
    network: "recurrent.RSNN", encoder: Mapping[str, Any] | None, rule: "exit_rule.ExitRule", target: str
) -> "pd.DataFrame":
    """One row per limit of a chip: what, here, limit, fits, and the cost of making it fit; empty if it fits.

    >>> net = recurrent.RSNN(16, 8, hidden=30, sampling_rate_Hz=2000.0)
    >>> found = compare(net, None, exit_rule.ExitRule(), "xyloaudio2")
    >>> found[~found.fits]["what"].tolist()[:4]
    ['membrane', 'reset', 'decay of the current', 'decay of the membrane']
    """
    if target not in CHECKS:
        raise InputError(f"`check={target!r}`: is unknown; {nearest(target, [*CHECKS])}")
    rows = list(CHECKS[target](Asked(network, encoder, rule)))
    return pd.DataFrame(
        [row._replace(cost="" if row.fits else row.cost) for row in rows], columns=list(Finding._fields)
    )


def title(target: str) -> str:
    """The heading of a check, with the source of its limits."""
    return f"Limits of {target}, from {SOURCES[target]}"


def _xylo(chain: Asked) -> Iterator[Finding]:
    network, spec = chain.network, chain.network.spec
    yield _at_most("inputs", network.n_inputs, 16, "fewer taxels, or one population of afferents")
    yield _at_most(
        "hidden neurons", spec.hidden, 1000, "train a smaller network: `nt.train(..., settings={'hidden': 1000})`"
    )
    yield _at_most("classes", network.n_classes, 8, "several chips, or a tree of networks of 8 classes each")
    yield _is(
        "membrane", spec.membrane, "immediate", "train again: `nt.train(..., settings={'membrane': 'immediate'})`"
    )
    yield _is(
        "reset",
        spec.reset,
        "subtract",
        "train again: `nt.train(..., settings={'reset': 'subtract'})`; a neuron may then spike again at once",
    )
    yield _fixed_thresholds(network, "train again: `nt.train(..., settings={'threshold_adaptation': 0})`")
    yield _is("readout", spec.readout, "count", "train again: `nt.train(..., settings={'readout': 'count'})`")
    yield _is(
        "recurrent delay",
        str(spec.recurrent_delay_steps if spec.recurrent else 0),
        "0",
        "train again: `nt.train(..., settings={'recurrent_delay_steps': 0})`",
    )
    for name, steps in _time_constants(network):
        yield _shift(name, steps, network.clock_Hz)
    yield from _weights(network, 8)
    there = network.synapses  # of a pruned network
    fan_out = spec.fan_among + network.n_classes
    fan_out = math.ceil(sum([*there.values()][1:]) / spec.hidden) if there else fan_out
    yield _at_most("fan-out of a hidden neuron, on average", fan_out, 32, "prune the recurrent weights")
    yield from _front_end(chain, "on a microcontroller next to the chip: the first half of the C export")
    yield from _exit(chain.rule, "the microcontroller that reads the output spikes counts them and resets the chip")


def _loihi(chain: Asked) -> Iterator[Finding]:
    network, spec = chain.network, chain.network.spec
    yield _at_most("neurons", spec.hidden + network.n_classes, 1024, "use more than one core")
    yield _is(
        "membrane",
        spec.membrane,
        "immediate",
        "train again: `nt.train(..., settings={'membrane': 'immediate'})`, or microcode on Loihi 2",
    )
    yield _is(
        "reset", spec.reset, "hard", "train again: `nt.train(..., settings={'reset': 'hard'})`, or microcode on Loihi 2"
    )
    yield _fixed_thresholds(
        network, "train again: `nt.train(..., settings={'threshold_adaptation': 0})`, or microcode on Loihi 2"
    )
    yield _is(
        "readout",
        spec.readout,
        "count",
        "train again: `nt.train(..., settings={'readout': 'count'})`, or microcode on Loihi 2",
    )
    delay = spec.recurrent_delay_steps if spec.recurrent else 0
    yield _is("recurrent delay", str(delay), "0", "a projection with delays, or train again without a recurrent delay")
    for name, steps in _time_constants(network):
        change = abs(round(4096 * (1 - math.exp(-1 / steps))) / 4096 / (1 - math.exp(-1 / steps)) - 1)
        cost = f"12 bits change the time constant by {100 * change:.1f} %: train again with a shorter one"
        yield Finding(f"decay of the {name}", f"{steps:.1f} steps", "12 bits, to within 5 %", change <= 0.05, cost)
    yield from _weights(network, 8)
    yield from _refractory(chain, 64)
    yield from _front_end(chain, "SA-I and RA-I as Loihi neurons with graded input, or on the embedded processor")
    yield from _exit(
        chain.rule, "a counter on the embedded processor, which also ends the run; it reads spikes every step"
    )


def _spinnaker(chain: Asked) -> Iterator[Finding]:
    network, spec = chain.network, chain.network.spec
    weights = sum(weights.numel() for weights in network.weights)
    states = 4 * (spec.hidden + network.n_classes) + (spec.hidden if network.adaptation is not None else 0)
    states += 0 if chain.encoder == {} else 2 * network.n_inputs  # membranes, refractory counters of the afferents
    n_bytes = 4 * weights + 4 * states + 8192
    yield _at_most("bytes of one processor", n_bytes, PROCESSOR_BYTES, "8-bit weights, or several processors")
    lacked = None
    if chain.encoder is not None:
        encoder = chains.encoder_of(chain.encoder, "run") if chain.encoder else None
        lacked = executors.lacking("c-float", executors.Subject(encoder, network, chain.rule))
    cost = "" if lacked is None else executors.FEATURES[lacked].instead
    here = "what C has" if lacked is None else lacked
    yield Finding("conditioning and afferents", here, "what the C export has", lacked is None, cost)


CHECKS = {"xyloaudio2": _xylo, "loihi2": _loihi, "spinnaker2": _spinnaker}


def _at_most(what: str, here: int, limit: int, cost: str) -> Finding:
    return Finding(what, str(here), f"at most {limit}", here <= limit, cost)


def _is(what: str, here: str, limit: str, cost: str) -> Finding:
    return Finding(what, here, limit, here == limit, cost)


def _fixed_thresholds(network: "recurrent.RSNN", cost: str) -> Finding:
    return _is("threshold adaptation", f"{network.spec.threshold_adaptation:g}", "0", cost)


def _time_constants(network: "recurrent.RSNN") -> Iterator[tuple[str, float]]:
    """What decays, and its time constant in steps: as it was learned, and of a readout that spikes if it differs."""
    for name, decays in (("current", network.alpha), ("membrane", network.beta)):
        hidden, readout = (-1 / math.log(min(max(decay, 1e-9), 1 - 1e-9)) for decay in decays.tolist())
        yield name, hidden
        if readout != hidden and network.bias is None:
            yield name, readout


def _shift(name: str, steps: float, clock_Hz: float) -> Finding:
    """A decay by x -> x - x / 2^k."""
    tau_ms, k = 1e3 * steps / clock_Hz, shift_of(steps)
    nearest_one = steps_of(k)
    change = nearest_one / steps - 1
    tau = 1e3 * nearest_one / clock_Hz
    return Finding(
        f"decay of the {name}",
        f"tau {tau_ms:g} ms",
        f"x - x / 2^k: {tau:.3g} ms (k = {k})",
        abs(change) <= 0.05,
        f"time constant changes by {100 * change:+.0f} %: train again with tau = {tau:.3g} ms",
    )


def steps_of(shift: int) -> float:
    """The time constant, in steps, of a decay x -> x - x / 2^shift."""
    return -1 / math.log(1 - 2.0**-shift)


def shift_of(steps: float) -> int:
    """The shift, of 1 to 15 bits, with the nearest time constant.

    >>> [shift_of(steps_of(k)) for k in (1, 7, 15)], shift_of(1e9)
    ([1, 7, 15], 15)
    """
    return min(range(1, 16), key=lambda shift: abs(math.log(steps_of(shift) / steps)))


def _weights(network: "recurrent.RSNN", bits: int) -> Iterator[Finding]:
    """Each projection in `bits`, with its own step: the largest weight fills the bits."""
    for name, w in (("input", network.w_in), ("recurrent", network.w_rec), ("readout", network.w_out)):
        if w is None:
            continue
        step = float(w.detach().abs().max()) / (2 ** (bits - 1) - 1) or 1.0
        rounding = (w.detach() - (w.detach() / step).round() * step).double().square().mean().sqrt()
        change = float(rounding / w.detach().double().abs().mean().clamp_min(1e-300))
        cost = "a few weights are much larger than the rest: train again with clipped or rounded weights"
        limit = f"{bits} bits, to within {100 * MOST_ROUNDING:g} %"
        yield Finding(f"{name} weights", f"rounding changes {100 * change:.2g} %", limit, change <= MOST_ROUNDING, cost)


def _refractory(chain: Asked, most: int) -> Iterator[Finding]:
    for part in ("sa1", "ra1"):
        t_ref_ms = ((chain.encoder or {}).get(part) or {}).get("t_ref_ms")
        if t_ref_ms is None:
            continue
        steps = math.ceil(t_ref_ms * 1e-3 * chain.network.sampling_rate_Hz - 1e-9)
        yield _at_most(f"refractory steps of {part}", steps, most, "a slower clock, or afferents outside the chip")


def _front_end(chain: Asked, cost: str) -> Iterator[Finding]:
    if chain.encoder != {}:
        yield Finding("conditioning and afferents", "analog signals", "spikes", False, cost)


def _exit(rule: "exit_rule.ExitRule", cost: str) -> Iterator[Finding]:
    yield Finding("early exit", _exit_words(rule), "whole windows", rule.never, cost)
    if rule.least_lead:
        lead = f"a lead of {rule.least_lead:.4g} at least"
        yield Finding("none of these", lead, "the largest count or value", False, "a comparison where it is read")


def _exit_words(rule: "exit_rule.ExitRule") -> str:
    return "none" if rule.patience is None else f"patience {rule.patience} steps"


def check_chip(run: "fitted.Fitted", check: str, *, tell: Tell = untold) -> "pd.DataFrame":
    """The limits of a chip ("xyloaudio2", "loihi2", "spinnaker2") for the network of a run.

    run: as of `export_c`.
    One row per limit: what, here, limit, fits, and the cost of making it fit. tell: called with what the command
    prints. Raises InputError for an unknown chip.

    >>> nt.check_chip("run", "loihi2").columns.tolist()
    ['what', 'here', 'limit', 'fits', 'cost']
    """
    restored = fitted.restore(run)
    findings = compare(recurrent.rsnn_of("chip", restored.network), restored.encoder, restored.exits(), check)
    tell(title(check))
    for row in findings.itertuples(index=False):
        parts = filter(None, (f"{'fits' if row.fits else 'NOT'}  {row.what}: {row.here}", row.limit, row.cost))
        tell("; ".join(parts))
    return findings
