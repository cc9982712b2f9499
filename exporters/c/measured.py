"""Networks of a study in the integers of the C export: a column of accuracy beside that of rounded opponents."""

from typing import Any

from neurotact_parts.exporters.c import integer
from neurotact_parts.exporters.c.export import WEIGHT_BITS
from neurotact_parts.exporters.c.formats import layers_of

from neurotact.errors import InputError
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import rsnn_of
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training.ranges import record_states
from neurotact.networks.training.tasks import Sides
from neurotact.studies.measures import INTEGERS, Measure


def in_integers(network: Network, sides: Sides, asked: bool = True) -> list[dict[str, Any]]:
    """Accuracy on whole validation and test windows with 8-bit weights and the state bits that an export chooses.

    Spikes are those of the encoder in float. A network that has no integer form is `refused`, with the reason.
    """
    try:
        own = rsnn_of("c-integer", network)
        seen, n_steps = record_states(own, sides.train.spikes), sides.train.spikes.shape[1]
        layers = layers_of(own, seen, weight_bits=WEIGHT_BITS, state_bits=None, n_steps=n_steps)
    except InputError as refused:
        return [{"refused": str(refused)}]
    row: dict[str, Any] = {"weight_bits": WEIGHT_BITS, "state_bits": layers.hidden.state_bits}
    for name, side in (("validation", sides.validation), ("test", sides.test)):
        decided = integer.infer(side.spikes.numpy(), layers, own.neuron, FULL_WINDOW, own.steps_per_bin)
        row[f"accuracy_{name}_{WEIGHT_BITS}bit"] = float((decided.labels == side.labels.numpy()).mean())
    return [row]


MEASURE = Measure(
    bool,
    "Also test each network in integers, with 8-bit weights: the table integers.csv.",
    INTEGERS,
    "each network in the integers of the C export",
    of_network=in_integers,
)
"""The entry point `integers` of the group `neurotact.measures`."""
