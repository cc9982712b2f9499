"""The ledger of spiking chains, from SOPs counted by hand."""

import pandas as pd
import pytest

from neurotact.metrics import synops
from neurotact.networks.specs import RSNNSpec
from neurotact.studies import ledger


def test_a_network_by_hand():
    # 2 afferents, 3 hidden neurons, 4 readouts, 10 steps; 5 input spikes and 2 hidden ones: 15 + 6 + 8 SOPs.
    table = synops.to_table(
        labels=["a"], predicted=["a"], steps=[10], input_spikes=[5], hidden_spikes=[2], n_hidden=3, n_readout=4,
        recurrent=True,
    )  # fmt: skip
    costs = ledger.decision_ledger(RSNNSpec(hidden=3), 2, 4, 2000.0, synops.summary(table)).set_index("name")
    network = costs.loc["network"]
    assert (network.macs, network.acs, network.sops) == (2 * 10 * 7, 29, 29)
    assert network.parameters == 2 * 3 + 3 * 3 + 3 * 4
    assert network.energy_estimate_nJ == pytest.approx(1e-3 * (140 * 4.6 + (29 + 70) * 0.9))
    # One taxel: the average a MAC and a product, the two afferents four MACs, a difference and three others, a step.
    assert (costs.loc["encoder"].macs, costs.loc["encoder"].acs) == (10 * 5, 10)
    assert costs.loc["both"].macs == costs.loc["encoder"].macs + network.macs
    assert costs["signal_ms"].tolist() == [5.0, 5.0, 5.0]


def test_the_linear_baseline_by_hand():
    # 2 taxels, 10 samples, 3 classes: mean 10 ACs, deviation 10 ACs and 10 MACs, a taxel; 4 features; 12 weights.
    counted = ledger.linear_cost(2, 10, 3, 5.0)
    assert (counted.macs, counted.acs) == (20 + 4 + 12, 40)
    assert counted.parameters == 8 + 15


def test_a_study_has_the_baseline_the_encoding_and_each_network():
    rows = [
        {"setting": "all", "pair": "1&1", "hidden": 20, "seed": seed, "window_steps": 300, "sops_input": 100.0 + seed,
         "sops_recurrent": 10.0, "sops_readout": 5.0}
        for seed in (0, 1)
    ]  # fmt: skip
    results = pd.DataFrame(rows)
    sizes = {"n_afferents": 16, "n_classes": 8, "rate_Hz": 2000.0}
    table = ledger.study_ledger(RSNNSpec(), results, pd.DataFrame({"samples": [300]}), **sizes)
    assert table["name"].tolist() == [
        "linear baseline",
        "conditioning and encoding alone, 150 ms",
        "spiking: all, t_ref 1&1 ms, N = 20",
    ]
    assert table["sops"].tolist() == [0.0, 0.0, 115.5]
    assert (table["signal_ms"] == 150).all()
    older = pd.DataFrame({"accuracy_test": [0.5]})
    assert ledger.study_ledger(RSNNSpec(), results, older, **sizes)["name"].iloc[0].startswith("conditioning")
    assert len(ledger.study_ledger(RSNNSpec(), results, None, **sizes)) == 2


def test_a_feed_forward_network_has_no_recurrent_weights():
    measured = {"sops_input": 15.0, "sops_recurrent": 0.0, "sops_readout": 8.0}
    counted = ledger.network_cost(RSNNSpec(hidden=3, model="snn"), 2, 4, measured, steps=10, signal_ms=5.0)
    assert counted.parameters == 2 * 3 + 3 * 4
    assert counted.sops == 23


def test_a_study_that_sweeps_recurrence_counts_each_network_as_it_is():
    # 16 afferents, 20 hidden neurons, 8 readouts; LIF encoders keep 2 parameters beside.
    row = {"pair": "1&1", "hidden": 20, "seed": 0, "window_steps": 300, "sops_input": 1.0, "sops_readout": 1.0}
    rows = [
        {**row, "setting": f"all, model {model}", "network.model": model, "sops_recurrent": sops}
        for model, sops in (("rsnn", 10.0), ("snn", 0.0))
    ]
    table = ledger.study_ledger(RSNNSpec(), pd.DataFrame(rows), None, n_afferents=16, n_classes=8, rate_Hz=2000.0)
    of_networks = table[table["name"].str.startswith("spiking")]
    assert of_networks["sops"].tolist() == [12.0, 2.0]
    assert of_networks["parameters"].diff().iloc[1] == -20 * 20


def test_encoders_by_hand():
    # A taxel, ten steps of 0.5 ms: smoothing takes 10 MACs and 10 products.
    izhikevich = ledger.encoding_cost(1, 10, 5.0, {"model": "izhikevich", "euler_step_ms": 0.1})
    assert (izhikevich.macs, izhikevich.acs) == (10 + 4 * 100, 3 * 100 + 10)
    assert izhikevich.other_flops == 10 + 2 * 100 + 3 * 10
    poisson = ledger.encoding_cost(1, 10, 5.0, {"model": "poisson"})
    assert (poisson.macs, poisson.acs, poisson.other_flops) == (10 + 20, 10, 10 + 50)
    assert ledger.encoding_cost(1, 10, 5.0, {"model": "lif"}) == ledger.encoding_cost(1, 10, 5.0)
