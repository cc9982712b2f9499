"""A network, with or without its encoder, as one NIR graph."""

from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.exporters.nir import afferents, layers, modules
from neurotact_parts.exporters.nir.nodes import Clock, graph
from neurotact_parts.exporters.nir.note import Note

from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import EncoderSpec
from neurotact.encoders.specs import n_afferents, taxels_of
from neurotact.errors import InputError, number_of
from neurotact.networks.definition.module import ModuleNetwork
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training.events import DetectorSpec


class Outside(NamedTuple):
    """What of a chain a graph does not hold.

    encoder: its encoder, if the graph begins with spikes, and `why`. step_ms: of the bins that the graph receives, of
    spikes on a clock of `input_Hz`; None: it receives spikes as they are. detector: of events in time.
    """

    encoder: EncoderSpec | None = None
    why: str = ""
    step_ms: float | None = None
    input_Hz: float | None = None
    detector: DetectorSpec | None = None

    def lines(self, encoder: AfferentSpec | None, rule: ExitRule) -> list[str]:
        """What stays outside, in words, with an `encoder` in the graph or none."""
        lines = (
            [] if encoder is None else ["conditioning: the graph takes the conditioned signal and its rate of change"]
        )
        if self.encoder is not None:
            lines.append(f"the encoder ({self.why}): the graph takes its spikes")
        if self.step_ms is not None:
            lines.append(
                f"bins of the clock: the graph takes spikes in bins of {self.step_ms:g} ms, at most one in each"
            )
        if not rule.never:
            lines.append("early exit: the graph computes whole windows")
        if rule.least_lead:
            lines.append(f"none of these: refuse a class that leads by less than {rule.least_lead:.6g} at the decision")
        if (own := self.detector) is not None:
            lead = f"it leads by more than {own.threshold:.6g} in {number_of(own.steps, 'step')}"
            lines.append(f"events in time: a label comes into force where {lead} of the network")
        return lines


def of(
    network: RSNN | ModuleNetwork,
    encoder: AfferentSpec | None = None,
    *,
    rule: ExitRule = FULL_WINDOW,
    classes: tuple[str, ...] | None = None,
    dt_s: float | None = None,
    plain: bool = False,
    lower_refractory: bool = False,
    outside: Outside = Outside(),
) -> Any:
    """The graph, from afferents' spikes or, with an encoder, from their signals, to the readout.

    network: on its own clock. outside: what of its chain the graph does not hold.

    dt_s: seconds per step in the file; None: 1 / clock. snnTorch uses 1e-4 for any file.
    plain, lower_refractory: see `layers` and `afferents`.
    """
    rate_Hz = network.sampling_rate_Hz
    clock = Clock(1.0 / rate_Hz if dt_s is None else dt_s)
    if not 1e-12 < clock.dt_s < 1e6:
        raise InputError(f"dt_s: must be a positive number of seconds; got {clock.dt_s:g}")
    if plain and lower_refractory:
        raise InputError("plain: has no node for a refractory period; leave out either it or lower_refractory")
    if is_rsnn := isinstance(network, RSNN):
        nodes, edges = layers.of_network(network, clock, plain=plain)
    else:
        nodes, edges = modules.of_module(network, clock)
    n_inputs, silent = network.n_inputs, None
    if encoder is not None:
        n_taxels = taxels_of(n_inputs, encoder.model_dump())
        if n_inputs != n_afferents(encoder, n_taxels):
            raise InputError(f"network: receives {n_inputs} afferents, not {n_afferents(encoder, 1)} under each taxel")
        front, links = afferents.of_encoder(encoder, n_taxels, rate_Hz, clock, lower_refractory=lower_refractory)
        n_inputs = 2 * n_taxels
        edges = links + [("afferents" if a == "input" else a, b) for a, b in edges]
        nodes = {**front, **nodes}
        silent = {key: encoder.neuron(getattr(encoder, key), rate_Hz).refractory_steps for key in ("sa1", "ra1")}
    elif lower_refractory and outside.encoder is not None:
        raise InputError(f"lower_refractory: the encoder stays outside the graph ({outside.why}); leave it out")
    elif lower_refractory:
        raise InputError("lower_refractory: the graph has no afferents; export it with its encoder")
    note = Note(
        dt_s=clock.dt_s,
        sampling_rate_Hz=rate_Hz,
        form="plain" if plain else "exact",
        differences=tuple(_differences(network, silent, plain=plain, lowered=lower_refractory)),
        network=network.spec.model_dump(mode="json"),
        **(_of_readout(network) if is_rsnn else {}),
        classes=classes or tuple(str(index) for index in range(network.n_classes)),
        encoder=None if encoder is None else encoder.model_dump(mode="json", exclude_none=True),
        refractory_steps=silent,
        lowered=lower_refractory,
        exit_patience=rule.patience,
        exit_from_first_spike=rule.from_first_spike,
        least_lead=rule.least_lead,
        exit_band=rule.band,
        outside=tuple(outside.lines(encoder, rule)),
        encoder_outside=None if outside.encoder is None else outside.encoder.model_dump(mode="json", exclude_none=True),
        step_ms=outside.step_ms,
        input_Hz=outside.input_Hz,
    )
    wide = network.stretches.number if plain and is_rsnn and network.stretches is not None else 1
    return graph(nodes, edges, n_inputs, wide * network.n_classes, note.metadata())


def _of_readout(network: RSNN) -> dict[str, Any]:
    """What a note says of the readout of an RSNN."""
    return {
        "unused": tuple(float(values[1].detach()) for values in (network.alpha, network.beta, network.threshold)),
        "bias": None if network.bias is None else tuple(network.bias.detach().tolist()),
    }


def _differences(
    network: RSNN | ModuleNetwork, silent: dict[str, int] | None, *, plain: bool, lowered: bool
) -> list[str]:
    lines = layers.differences(network) if plain and isinstance(network, RSNN) else []
    if silent is not None and not lowered and any(silent.values()):
        steps = " and ".join(f"{n} steps of {name}" for name, n in silent.items())
        lines.append(f"afferents have no refractory period ({steps}); `lower_refractory=True` adds them as nodes")
    return lines


def signals(conditioned: np.ndarray, clock_Hz: float) -> np.ndarray:
    """The input of a graph with afferents, `(trial, time, 2 taxel)`: the conditioned signal, then its change per ms.

    >>> signals(np.array([[[1.0], [3.0]]]), 1000.0).tolist()
    [[[1.0, 0.0], [3.0, 2.0]]]
    """
    change = np.abs(np.diff(conditioned, axis=1, prepend=conditioned[:, :1])) * (clock_Hz * 1e-3)
    return np.concatenate([conditioned, change], axis=2)
