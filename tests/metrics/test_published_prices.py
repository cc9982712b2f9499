"""The ledger beside a published one: Lemaire et al., ICONIP 2022 (arXiv 2210.13107), item by item.

Its equations are written here anew for fully connected layers, with its line of memory prices: an access to a memory of
n numbers of 32 bits takes 1.09e-5 * 32 n + 13.2 pJ, an addition 0.1 pJ, a multiplication 3.1 pJ.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.metrics.flops import Dense, SpikingLayer, cost
from neurotact.metrics.prices import price_list

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
