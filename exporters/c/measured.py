"""Networks of a study in the integers of the C export: a column of accuracy beside that of rounded opponents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.studies.measures import INTEGERS, Measure

with lazily():  # a study that asks for it needs no torch to read its own keys
    from neurotact_parts.exporters.c import export, formats, integer

    from neurotact.baselines import opponent
    from neurotact.networks.definition import rsnn
    from neurotact.networks.exit import rule
    from neurotact.networks.training import ranges

if TYPE_CHECKING:
    from neurotact.networks.definition.network import Network
    from neurotact.networks.training.tasks import Sides


def in_integers(network: Network, sides: Sides, asked: bool = True) -> list[dict[str, Any]]:
    """Accuracy on whole validation and test windows with 8-bit weights and the state bits that an export chooses.

    Spikes are those of the encoder in float; of numbers, accuracies are mean scores. A network that has no integer form
    is `refused`, with the reason.
    """
    try:
        own, bits = rsnn.rsnn_of("c-integer", network), export.WEIGHT_BITS
        seen, n_steps = ranges.record_states(own, sides.train.spikes), sides.train.spikes.shape[1]
        options = {"weight_bits": bits, "state_bits": None, "n_steps": n_steps}
        layers = formats.layers_of(own, seen, tells_numbers=sides.train.labels.ndim > 1, **options)
    except InputError as refused:
        return [{"refused": str(refused)}]
    row: dict[str, Any] = {"weight_bits": bits, "state_bits": layers.hidden.state_bits}
    for name, side in (("validation", sides.validation), ("test", sides.test)):
        decided = integer.infer(side.spikes.numpy(), layers, own.neuron, rule.FULL_WINDOW, own.steps_per_bin)
        told, deviation = decided.readout * layers.readout.unit, side.deviation
        right = opponent.right(told, side.labels.numpy(), None if deviation is None else deviation.numpy())
        row[f"accuracy_{name}_{bits}bit"] = float(right.mean())
    return [row]


MEASURE = Measure(
    bool,
    "Also test each network in integers, with 8-bit weights: the table integers.csv.",
    INTEGERS,
    "each network in the integers of the C export",
    of_network=in_integers,
)
"""The entry point `integers` of the group `neurotact.measures`."""
