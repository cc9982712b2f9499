"""The ledger beside published ones: Lemaire et al., ICONIP 2022 (arXiv 2210.13107), item by item; cycles of Xylo.

Lemaire's equations are written here anew for fully connected layers, with its line of memory prices: an access to a
memory of n numbers of 32 bits takes 1.09e-5 * 32 n + 13.2 pJ, an addition 0.1 pJ, a multiplication 3.1 pJ.
"""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from neurotact.metrics.flops import Dense, SpikingLayer, cost
from neurotact.metrics.prices import price_list
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.use.ledger import network_cost

CYCLE_PJ = 291e-6 / 6.25e6 * 1e12
"""Of XyloAudio 2: its power in work by its clock."""
LIST = price_list("lemaire-2022")
ADD, MAC = 0.1, 3.2
sizes = st.integers(8, 400)


def access(numbers: int) -> float:
    return 1.09e-5 * 32 * numbers + 13.2


def formal(n_in: int, n_out: int) -> dict[str, float]:
    """Eqs. 2, 4, 6 and 12 of a fully connected layer without spikes, and its addressing, in pJ."""
    return {
        "weights": n_in * n_out * access(n_in * n_out),
        "biases": n_out * access(n_out),
        "inputs and outputs": n_in * access(n_in) + n_out * access(n_out),
        "products and sums": n_in * n_out * MAC,
        "additions of biases": n_out * ADD,
        "addressing": n_in * n_out * ADD,
    }


@given(sizes, sizes)
def test_a_dense_layer_is_within_five_percent(n_in, n_out):
    """What is left after addressing and the biases' additions, which we do not count, is where each number lies."""
    theirs, ours = formal(n_in, n_out), 1e3 * cost(Dense(n_in, n_out)).energy_nJ(LIST)
    assert ours == pytest.approx(sum(theirs.values()), rel=0.05)
    uncounted = theirs["additions of biases"] + theirs["addressing"]
    places = n_out * (access(n_in * n_out + n_out) - access(n_out))  # biases lie beside the weights
    places += n_in * n_out * (access(n_in * n_out + n_out) - access(n_in * n_out))
    places += n_in * (access(n_out) - access(n_in))  # and inputs in the buffer of the layer
    assert ours == pytest.approx(sum(theirs.values()) - uncounted + places, rel=1e-3)


@given(sizes, sizes, st.integers(5, 200), st.floats(0.01, 0.5))
def test_what_a_spiking_layer_differs_by(n_in, n_out, steps, rate_in):
    """Theirs updates a potential for every spike, in memory; ours once a step, and it has a current, too."""
    received = rate_in * n_in * steps
    sops = received * n_out
    theirs = {
        "weights": sops * access(n_in * n_out),
        "potentials": 2 * (sops + n_out) * access(n_out),
        "sums": sops * ADD,
        "leak": steps * n_out * MAC,
        "input": received * access(n_in),
        "comparisons": steps * n_out * ADD,
    }
    layer = cost(SpikingLayer(n_in, n_out, steps, sops, recurrent=False))
    ours = {
        "weights": sops * LIST.access_pJ(layer.weights_bytes),
        "potentials": layer.states_accesses * LIST.access_pJ(layer.states_bytes),
        "sums": layer.acs * ADD,
        "leak": layer.macs * MAC,
        "input": layer.buffers_accesses * LIST.access_pJ(layer.buffers_bytes),
        "comparisons": layer.comparisons * ADD,
    }
    assert sum(ours.values()) == pytest.approx(1e3 * layer.energy_nJ(LIST))
    for item in ("weights", "sums", "comparisons"):
        assert ours[item] == pytest.approx(theirs[item], rel=1e-3)
    assert ours["leak"] == pytest.approx(2 * theirs["leak"])  # of the current and of the potential
    assert ours["input"] == pytest.approx(2 * theirs["input"], rel=1e-3)  # also written, by the sender
    both, each_spike = 2 * 2 * steps * n_out, 2 * (sops + n_out)
    assert ours["potentials"] / theirs["potentials"] == pytest.approx(
        both * access(2 * n_out) / (each_spike * access(n_out)), rel=1e-3
    )


def cycles(n_in: int, hidden: int, n_out: int, shares: tuple[float, float], *, recurrent: bool) -> dict[str, float]:
    """Cycles of a time step of XyloAudio 2: `cycles_model` of Rockpool 3.1.0, without aliases.

    shares: of inputs and of hidden neurons that spike in a step.
    """
    p_in, p_hidden = shares
    fan_out = hidden if recurrent else 0
    return {
        "inputs": n_in * (p_in * hidden * 3.5 + 1),
        "currents": hidden * (fan_out * 7 * p_hidden + 3),
        "into the readout": hidden * p_hidden * (1 + 8 * n_out),
        "hidden neurons": hidden * (19 + 2 * p_hidden + p_hidden),
        "readout": n_out * 12,
    }


@given(
    st.integers(1, 16), st.integers(20, 1000), st.integers(1, 8), st.floats(0, 1), st.floats(0, 0.08), st.booleans(),
    st.integers(1, 500),
)  # fmt: skip
@example(16, 20, 8, 0.0, 0.0, False, 100)
def test_a_network_on_xylo_is_near_its_cycles(n_in, hidden, n_out, p_in, p_hidden, recurrent, steps):
    """Within 5 %, with recurrence 7.5 %: an operation of a hidden spike takes 7.5 cycles, theirs 7 among neurons."""
    theirs = steps * sum(cycles(n_in, hidden, n_out, (p_in, p_hidden), recurrent=recurrent).values()) * CYCLE_PJ
    sent = p_hidden * hidden * steps
    measured = {
        "sops_input": p_in * n_in * steps * hidden,
        "sops_recurrent": sent * hidden * recurrent,
        "sops_readout": sent * n_out,
    }
    spec = RSNNSpec(hidden=hidden, model="rsnn" if recurrent else "snn", readout="integrator")
    ours = network_cost(spec, n_in, n_out, measured, steps=steps, signal_ms=steps)
    assert 1e3 * ours.energy_nJ(price_list("xylo")) == pytest.approx(theirs, rel=0.075 if recurrent else 0.05)


def test_the_published_worst_case_of_xylo():
    """16 inputs, 100 hidden neurons and 8 classes, of which all spike in each step, without recurrence."""
    assert sum(cycles(16, 100, 8, (1.0, 1.0), recurrent=False).values()) == 14_712
