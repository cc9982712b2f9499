"""The measure `integers`: networks of a study as the C export computes them."""

import pytest
import torch
from made_chains import make_chain
from neurotact_parts.exporters.c import measured
from neurotact_parts.exporters.c.formats import layers_of
from neurotact_parts.exporters.c.integer import infer

from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.ranges import record_states
from neurotact.networks.training.tasks import Sides


def made(**kind):
    """A network, and windows whose labels on validation and test are the network's own choices."""
    network = make_chain({}, seed=3, **kind).network
    generator = torch.Generator().manual_seed(0)
    sides = []
    for n in (12, 30, 40):
        spikes = (torch.rand((n, 80, len(network.w_in)), generator=generator) < 0.1).to(torch.uint8)
        sides.append(Examples(spikes, network.infer(spikes).labels))
    return network, Sides(*sides)


def test_each_side_is_decided_by_the_integers_that_an_export_chooses():
    network, sides = made(step_ms=4.0)
    layers = layers_of(network, record_states(network, sides.train.spikes), weight_bits=8, state_bits=None, n_steps=80)
    labels = [infer(side.spikes.numpy(), layers, network.neuron, FULL_WINDOW, 4).labels for side in sides]
    # Right on validation, wrong on all test windows but the first.
    n_classes = network.n_classes
    of_validation, of_test = torch.tensor(labels[1]), (torch.tensor(labels[2]) + 1) % n_classes
    of_test[0] = labels[2][0]
    known = Sides(sides.train, Examples(sides.validation.spikes, of_validation), Examples(sides.test.spikes, of_test))
    (row,) = measured.in_integers(network, known)
    assert (row["accuracy_validation_8bit"], row["accuracy_test_8bit"]) == (1.0, 1 / 40)
    assert (row["weight_bits"], row["state_bits"]) == (8, layers.hidden.state_bits)


def test_integers_decide_nearly_as_the_network_does():
    network, sides = made()
    (row,) = measured.in_integers(network, sides)
    assert min(row["accuracy_validation_8bit"], row["accuracy_test_8bit"]) >= 0.8


def test_numbers_in_integers_have_the_score_of_their_values():
    network, sides = made(readout="integrator")
    spread = network.infer(sides.test.spikes).readout.std(dim=0).float()

    def of_numbers(side, moved=0.0):
        return Examples(side.spikes, network.infer(side.spikes).readout.float() + moved * spread, deviation=spread)

    (row,) = measured.in_integers(network, Sides(*(of_numbers(side) for side in sides)))
    assert 0.8 < row["accuracy_test_8bit"] < 1  # of units of their own, rounded
    (moved,) = measured.in_integers(network, Sides(*(of_numbers(side, 3.0) for side in sides)))
    assert moved["accuracy_test_8bit"] == pytest.approx(1 - 9, abs=3)


def test_a_network_without_an_integer_form_is_said_to_be_refused():
    network, sides = made(readout="max")
    (row,) = measured.in_integers(network, sides)
    assert [*row] == ["refused"]
    assert "no integer form" in row["refused"]
