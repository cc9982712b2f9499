"""The ledger of spiking chains, from SOPs counted by hand."""

import numpy as np
import pandas as pd
import pytest
from costs import sops_table

from neurotact.data.conditioning import ConditioningSpec
from neurotact.encoders import specs as encoders
from neurotact.encoders.cost import encoding_cost
from neurotact.metrics import synops
from neurotact.metrics.flops import Cost, NotCounted
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.use import ledger
from neurotact.networks.use.ledger import Afferents

SMOOTHED = {"model": "lif", "conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "none", "rectify": False}}


def test_a_network_by_hand():
    # 2 afferents, 3 hidden neurons, 4 readouts, 10 steps; 5 input spikes and 2 hidden ones: 15 + 6 + 8 SOPs.
    table = sops_table(
        labels=["a"], predicted=["a"], steps=[10], input_spikes=[5], hidden_spikes=[2], n_hidden=3, n_readout=4,
        recurrent=True,
    )  # fmt: skip
    costs = ledger.decision_ledger(RSNNSpec(hidden=3), 2, 4, 2000.0, synops.summary(table), encoder=SMOOTHED).set_index(
        "name"
    )
    network = costs.loc["network"]
    assert (network.macs, network.acs, network.sops) == (2 * 10 * 7, 29, 29)
    assert network.parameters == 2 * 3 + 3 * 3 + 3 * 4
    assert network.energy_estimate_nJ == pytest.approx(1e-3 * (140 * 4.6 + (29 + 70) * 0.9))
    # One taxel, smoothed, a step: the average a MAC and a product; the two afferents four MACs, a difference and three
    # others.
    assert (costs.loc["encoder"].macs, costs.loc["encoder"].acs) == (10 * 5, 10)
    assert costs.loc["both"].macs == costs.loc["encoder"].macs + network.macs
    assert costs["signal_ms"].tolist() == [5.0, 5.0, 5.0]


def test_a_study_has_the_baseline_the_encoding_and_each_network():
    rows = [
        {"setting": "all", "pair": "1&1", "hidden": 20, "seed": seed, "window_steps": 300, "sops_input": 100.0 + seed,
         "sops_recurrent": 10.0, "sops_readout": 5.0}
        for seed in (0, 1)
    ]  # fmt: skip
    results = pd.DataFrame(rows)
    made_by = Afferents(16, SMOOTHED, 2000.0)
    spent = {"macs": 36.0, "acs": 40.0, "multiplications": 10.0, "parameters": 23, "bytes": 92, "signal_ms": 150.0}
    baselines = pd.DataFrame([{"classifier": "SVM", "input": "signals: 10 time bins", **spent}] * 2)
    table = ledger.study_ledger(RSNNSpec(), results, baselines, afferents=[made_by] * 2, n_classes=8)
    assert table["name"].tolist() == [
        "SVM on signals: 10 time bins",
        "conditioning and encoding alone, 150 ms",
        "spiking: all, t_ref 1&1 ms, N = 20",
    ]
    assert table["sops"].tolist() == [0.0, 0.0, 115.5]
    assert (table["signal_ms"] == 150).all()
    assert table["energy_estimate_nJ"].iloc[0] == pytest.approx(1e-3 * (36 * 4.6 + 40 * 0.9 + 10 * 3.7))
    unknown = pd.DataFrame(
        [{"classifier": "mine", "input": "signals", **dict.fromkeys(spent, np.nan), "signal_ms": 150.0}]
    )
    both = pd.concat([baselines, unknown])
    counted = ledger.study_ledger(RSNNSpec(), results, both, afferents=[made_by] * 2, n_classes=8).set_index("name")
    assert counted.loc["mine on signals"].drop("prices").isna().all()
    pd.testing.assert_frame_equal(counted.drop("mine on signals").reset_index(), table, check_dtype=False)
    assert len(ledger.study_ledger(RSNNSpec(), results, None, afferents=[made_by] * 2, n_classes=8)) == 2


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
    made_by = Afferents(16, SMOOTHED, 2000.0)
    table = ledger.study_ledger(RSNNSpec(), pd.DataFrame(rows), None, afferents=[made_by] * len(rows), n_classes=8)
    of_networks = table[table["name"].str.startswith("spiking")]
    assert of_networks["sops"].tolist() == [12.0, 2.0]
    assert of_networks["parameters"].diff().iloc[1] == -20 * 20


@pytest.mark.parametrize("spec", [RSNNSpec(), RSNNSpec(recipe="default")])
@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("readout", ["count", "integrator", "max"]),
        ("readout_tau_ms", [5.0, 50.0]),
        ("threshold_adaptation", [0.0, 0.5]),
    ],
)
def test_a_study_that_sweeps_what_neurons_compute_counts_each_network_as_it_is(spec, key, values):
    """A readout that spikes decays two states a step; one that adds up none; an adapting threshold takes two MACs."""
    own = {"readout": "integrator"} if key == "readout_tau_ms" else {}
    spec = spec.model_copy(update=own)
    row = {"pair": "1&1", "hidden": 20, "seed": 0, "window_steps": 300, "sops_input": 1.0, "sops_readout": 1.0}
    rows = [
        {**row, "setting": f"all, {value}", "sops_recurrent": 1.0, f"network.{key}": value, "steps_per_bin": 1}
        for value in values
    ]
    made_by = [Afferents(16, SMOOTHED, 2000.0)] * len(rows)
    table = ledger.study_ledger(spec, pd.DataFrame(rows), None, afferents=made_by, n_classes=8)
    of_networks = table[table["name"].str.startswith("spiking")]["macs"].tolist()
    each = [spec.model_copy(update={key: value}) for value in values]
    plain = {name: value for name, value in rows[0].items() if name != f"network.{key}"}
    assert of_networks == [ledger.row_cost(one, plain, made_by[0], n_classes=8).macs for one in each]
    if key == "readout":
        assert [macs - of_networks[1] for macs in of_networks] == [2 * 8 * 300, 0, 8 * 300]
    if key == "threshold_adaptation":
        assert of_networks[1] - of_networks[0] == 2 * 20 * 300


@pytest.mark.parametrize(("steps", "sops", "recurrent"), [(300, 5.0, 20 * 20), (300, 0.0, 0), (1000, 0.0, 0)])
def test_a_study_by_a_recipe_counts_what_the_recipe_and_training_chose(steps, sops, recurrent):
    row = {"pair": "1&1", "hidden": 20, "seed": 0, "window_steps": steps, "setting": "all"}
    rows = [{**row, "sops_input": 1.0, "sops_recurrent": sops, "sops_readout": 1.0}]
    made_by = Afferents(16, SMOOTHED, 2000.0)
    table = ledger.study_ledger(
        RSNNSpec(recipe="default"), pd.DataFrame(rows), None, afferents=[made_by] * len(rows), n_classes=8
    )
    alone, chain = (table[table["name"].str.startswith(name)].iloc[0] for name in ("conditioning", "spiking"))
    assert chain["parameters"] - alone["parameters"] == 16 * 20 + recurrent + (20 + 1) * 8


def test_a_mean_over_networks_has_their_mean_parameters_where_recurrence_stayed_in_some():
    # 1250 steps of the encoder are 105 of the network, few enough for recurrence, which two of three keep.
    row = {"pair": "1&1", "hidden": 20, "window_steps": 1250, "steps_per_bin": 12, "setting": "all"}
    rows = [
        {**row, "seed": seed, "sops_input": 6.0, "sops_recurrent": sops, "sops_readout": 3.0, "readout_stretches": n}
        for seed, (sops, n) in enumerate([(0.0, 1), (9.0, 1), (3.0, 4)])
    ]
    made_by = Afferents(16, SMOOTHED, 1000.0)
    spec, results = RSNNSpec(recipe="default"), pd.DataFrame(rows)
    table = ledger.study_ledger(spec, results, None, afferents=[made_by] * len(rows), n_classes=8)
    alone, chain = (table[table["name"].str.startswith(name)].iloc[0] for name in ("conditioning", "spiking"))
    own = [16 * 20 + (20 + 1) * 8, 16 * 20 + 20 * 20 + (20 + 1) * 8, 16 * 20 + 20 * 20 + (4 * 20 + 1) * 8]
    assert chain["parameters"] - alone["parameters"] == round(np.mean(own))
    assert chain["sops"] == pytest.approx(6.0 + 4.0 + 3.0)


def test_each_training_counts_its_own_afferents():
    """Calibrated for each split, encoders may differ, as in the thresholds under a taxel; a network has their mean."""
    row = {
        "setting": "all",
        "pair": "1&1",
        "hidden": 20,
        "window_steps": 300,
        "sops_recurrent": 10.0,
        "sops_readout": 5.0,
    }
    rows = pd.DataFrame([{**row, "seed": turn, "sops_input": 100.0 * (1 + turn)} for turn in (0, 1, 2)])
    graded = {**SMOOTHED, "sa1": {"grades": [1.0, 0.5]}}
    made_by = [Afferents(16, SMOOTHED, 2000.0), Afferents(24, graded, 2000.0), Afferents(16, SMOOTHED, 2000.0)]
    table = ledger.study_ledger(RSNNSpec(), rows, None, afferents=made_by, n_classes=8).set_index("name")
    each = [
        ledger.row_cost(RSNNSpec(), row, own, n_classes=8)
        for row, own in zip(rows.to_dict("records"), made_by, strict=True)
    ]
    found = table.loc["spiking: all, t_ref 1&1 ms, N = 20"]
    assert each[1].parameters > each[0].parameters
    for key in ("macs", "acs", "sops", "energy_estimate_nJ"):
        assert found[key] == pytest.approx(np.mean([getattr(one, key) for one in each]))
    alone = table.loc["conditioning and encoding alone, 150 ms"]
    assert alone["macs"] == pytest.approx(np.mean([own.cost(300, 5.0).macs for own in made_by]))


def test_encoding_alone_has_a_row_for_each_refractory_period_where_its_spikes_cost_something():
    row = {"setting": "all", "hidden": 20, "seed": 0, "window_steps": 300, "sops_recurrent": 0.0, "sops_readout": 0.0}
    rows = pd.DataFrame([{**row, "pair": pair, "sops_input": 20.0 * n} for pair, n in (("1&1", 90), ("5&5", 40))])
    alone = "conditioning and encoding alone"
    for integration, names in (
        ("exact", [f"{alone}: all, t_ref {pair} ms, 300 ms" for pair in ("1&1", "5&5")]),
        ("clock", [f"{alone}, 300 ms"]),
    ):
        own = Afferents(16, {**SMOOTHED, "integration": integration}, 1000.0, 100.0)
        table = ledger.study_ledger(RSNNSpec(), rows, None, afferents=[own] * 2, n_classes=8).set_index("name")
        assert [name for name in table.index if name.startswith(alone)] == names
        for name, n in zip(names, (90, 40), strict=False):
            assert table.loc[name, "macs"] == own.cost(300, n).macs
        whole = table.loc["spiking: all, t_ref 5&5 ms, N = 20", "energy_estimate_nJ"]
        assert table.loc[names[-1], "energy_estimate_nJ"] < whole


def test_encoding_in_the_sensor_costs_a_decision_nothing():
    row = {"hidden": 3, "window_steps": 10.0, "exit_steps": 10.0, "sops_input": 6.0, "sops_recurrent": 0.0,
           "sops_readout": 4.0}  # fmt: skip
    sizes = {"afferents": Afferents(2, SMOOTHED, 2000.0), "n_classes": 4}
    both, alone = (ledger.row_cost(RSNNSpec(hidden=3), row, **sizes, encoding=counts) for counts in (True, False))
    assert both.macs - alone.macs == encoding_cost(1, 10, 5.0, SMOOTHED).macs
    assert both.sops == alone.sops == 10.0


def test_encoding_in_the_sensor_costs_nothing_in_the_ledger_of_a_study():
    row = {"dataset": "all", "setting": "all", "pair": "1&1", "hidden": 3, "seed": 0, "window_steps": 10.0,
           "sops_input": 6.0, "sops_recurrent": 0.0, "sops_readout": 4.0}  # fmt: skip
    own, how = Afferents(2, SMOOTHED, 2000.0), {"n_classes": 4}
    results = pd.DataFrame([row])
    for counts in (True, False):
        table = ledger.study_ledger(RSNNSpec(), results, None, afferents=[own], encoding=counts, **how)
        assert table["name"].str.contains("encoding alone").any() == counts
        spent = ledger.row_cost(RSNNSpec(), row, own, encoding=counts, **how)
        assert table["energy_estimate_nJ"].iloc[-1] == pytest.approx(spent.energy_estimate_nJ)


def test_a_row_of_a_slower_clock_counts_a_step_in_five():
    row = {"hidden": 3, "window_steps": 100.0, "sops_input": 6.0, "sops_recurrent": 0.0, "sops_readout": 4.0}
    sizes = {"afferents": Afferents(2, SMOOTHED, 2000.0), "n_classes": 4, "encoding": False}
    found = {n: ledger.row_cost(RSNNSpec(hidden=3), {**row, "steps_per_bin": n}, **sizes) for n in (1, 5)}
    by_hand = ledger.network_cost(RSNNSpec(hidden=3), 2, 4, row, steps=20, signal_ms=50.0)
    assert found[5] == by_hand
    assert found[1].macs == 5 * by_hand.macs


def test_encoders_by_hand():
    # A taxel, ten steps of 0.5 ms, as recorded.
    izhikevich = encoding_cost(1, 10, 5.0, {"model": "izhikevich", "euler_step_ms": 0.1})
    assert (izhikevich.macs, izhikevich.acs) == (4 * 100, 3 * 100 + 10)
    assert izhikevich.other_flops == 2 * 100 + 3 * 10
    delta, window, spiker, latency, burst, resonator = (
        encoding_cost(1, 10, 10.0, {"model": model, **keys})
        for model, keys in {
            "step-forward": {}, "moving-window": {"window_ms": 3.0}, "bens-spiker": {"filter_ms": 4.0}, "latency": {},
            "burst": {"cycle_ms": 5.0}, "resonate-and-fire": {},
        }.items()
    )  # fmt: skip
    assert (delta.macs, delta.acs, delta.other_flops, delta.parameters) == (0, 10, 20, 1)
    assert (window.acs, window.other_flops) == (30, 30)  # in, out, minus the mean; mean, above, below
    assert window.bytes == 4 * (1 + 3 + 2)  # the threshold; three samples, their sum, the refractory counter
    # Two parts, 10 steps, 4 taps: a difference and two sums a tap, and one difference; two magnitudes a tap, the gain,
    # the part, the comparison.
    assert (spiker.acs, spiker.other_flops) == (20 * 13, 20 * 11)
    assert (latency.acs, latency.other_flops) == (10, 40 + 10 + 10)
    assert (burst.macs, burst.acs, burst.other_flops) == (4, 30, 30 + 4 * 6)  # two bursts of two afferents
    assert (resonator.macs, resonator.other_flops) == (120, 20)
    poisson = encoding_cost(1, 10, 5.0, {"model": "poisson"})
    assert (poisson.macs, poisson.acs, poisson.other_flops) == (20, 10, 50)
    lif = encoding_cost(1, 10, 5.0, {"model": "lif"})
    assert (lif.macs, lif.acs, lif.other_flops) == (40, 10, 30)
    assert lif == encoding_cost(1, 10, 5.0, {})


# What conditioning adds to 2 taxels and 10 steps: MACs, ACs, others, parameters, bytes.
ADDED = [
    ({"ema_cutoff_Hz": 30.0}, (20, 0, 20, 0, 4 * 2)),  # a MAC and a product a sample; the output before
    ({"resample_Hz": 2000.0}, (20, 20 + 10, 10, 0, 4 * 5)),  # a MAC and a difference each; the position once a step
    ({"baseline": "mean"}, (0, 20 + 20, 2, 0, 4 * 2)),
    ({"baseline": "start", "start_ms": 2.0}, (0, 20 + 8, 8 * 4, 0, 4 * 2)),  # the mean so far, in the first four steps
    ({"baseline": "start"}, (0, 20 + 20, 20 * 4, 0, 4 * 2)),  # a sum and a division each, in all
    ({"baseline": "high-pass", "high_pass_Hz": 1.0}, (20, 20, 20, 0, 4 * 2)),  # an EMA and a difference
    ({"scale": [2.0, 3.0]}, (0, 0, 20, 2, 4 * 2)),
    ({"offset": [1.0, 1.0], "scale": [2.0, 3.0]}, (20, 0, 0, 4, 4 * 4)),
    ({"rectify": True}, (0, 0, 20, 0, 0)),
    ({"taxels": ["left", "right"]}, (0, 0, 0, 0, 0)),
    ({"baseline": "none", "rectify": False}, (0, 0, 0, 0, 0)),
]


@pytest.mark.parametrize(("conditioning", "added"), ADDED, ids=lambda value: "" if isinstance(value, tuple) else None)
def test_each_step_of_conditioning_is_counted(conditioning, added):
    plain = encoding_cost(2, 10, 5.0, {})
    slow = "resample_Hz" in conditioning
    counted = encoding_cost(2, 10, 5.0, {"conditioning": conditioning}, recorded_Hz=500.0 if slow else None)
    names = ("macs", "acs", "other_flops", "parameters", "bytes")
    assert tuple(getattr(counted, name) - getattr(plain, name) for name in names) == added


def test_an_integrating_readout_costs_its_operations_alone():
    measured = {"sops_input": 900, "sops_recurrent": 300, "sops_readout": 80}
    of = {"measured": measured, "steps": 300, "signal_ms": 150}
    counting = ledger.network_cost(RSNNSpec(hidden=30), 16, 8, **of)
    adding = ledger.network_cost(RSNNSpec(hidden=30, readout="integrator"), 16, 8, **of)
    assert counting.macs - adding.macs == 2 * 8 * 300
    assert counting.acs == adding.acs
    assert adding.parameters == counting.parameters + 8


@pytest.mark.parametrize(
    ("keys", "of_neurons"), [({"hidden": 0}, 0), ({"hidden": 30}, 80), ({"hidden": 30, "direct": True}, 80 - 8 * 3)]
)
def test_a_chip_charges_operations_of_afferents_in_the_readout_as_such(keys, of_neurons):
    """Three spikes arrive; eight readout neurons hear them, or those of hidden neurons, or both."""
    hidden = keys["hidden"]
    into_readout = 80 if hidden else 8 * 3
    measured = {"sops_input": 3 * hidden, "sops_recurrent": 0, "sops_readout": into_readout}
    spec = RSNNSpec(readout="integrator", model="snn", **keys)
    found = ledger.network_cost(spec, 16, 8, measured, steps=300, signal_ms=150)
    assert found.sops_sent == pytest.approx(of_neurons)
    assert found.sops == 3 * hidden + into_readout


def test_a_leak_costs_a_mac_and_a_maximum_a_comparison_more_per_class_and_step():
    measured = {"sops_input": 900, "sops_recurrent": 300, "sops_readout": 80}
    of = {"measured": measured, "steps": 300, "signal_ms": 150}
    adding, leaky, largest = (
        ledger.network_cost(RSNNSpec(hidden=30, **readout), 16, 8, **of)
        for readout in ({"readout": "integrator"}, {"readout": "integrator", "readout_tau_ms": 5.0}, {"readout": "max"})
    )
    assert leaky.macs - adding.macs == largest.macs - adding.macs == 8 * 300
    assert (leaky.other_flops - adding.other_flops, largest.other_flops - leaky.other_flops) == (0, 8 * 300)
    assert leaky.sops == largest.sops == adding.sops
    assert leaky.bytes == adding.bytes == largest.bytes - 4 * 8


def test_every_key_of_conditioning_has_its_cost():
    """A new step of conditioning must be counted here too."""
    counted = {key for conditioning, _ in ADDED for key in conditioning}
    assert counted == set(ConditioningSpec.model_fields)


def test_the_shipped_encoder_of_fabrics_by_hand():
    """16 taxels, resampled and standardised, as spike trains carry the spec: 32 offsets and scales and two gains."""
    encoder = encoders.load("fabric-sa1-ra1-lif").model_dump(mode="json", exclude_none=True)
    counted = encoding_cost(16, 1000, 1000.0, encoder, recorded_Hz=400.0)
    assert counted.parameters == 16 + 16 + 2
    each = 16 * 1000
    # Interpolation and standardisation a MAC each, the two afferents four.
    assert counted.macs == 6 * each
    assert counted.acs == (each + 1000) + each
    assert counted.other_flops == 1000 + 3 * each


def test_a_mean_with_what_is_not_counted_is_not_counted():
    mean = ledger._mean([(Cost(macs=3, bytes=4, signal_ms=50), 1), (NotCounted(signal_ms=100), 1)])
    assert np.isnan([mean.macs, mean.bytes, mean.energy_estimate_nJ]).all()
    assert mean.signal_ms == 75


def test_events_of_a_sensor_cost_no_encoding():
    table = pd.DataFrame(
        [{"steps": 60, "sops_input": 90.0, "sops_recurrent": 0.0, "sops_readout": 12.0, "sops_total": 102.0}]
    )
    spent = [
        ledger.decision_ledger(RSNNSpec(hidden=3), 2, 4, 2000.0, table, encoder=encoder)
        for encoder in (None, {}, SMOOTHED)
    ]
    assert spent[0].equals(spent[1])
    assert [list(each["name"]) for each in spent[1:]] == [["network"], ["encoder", "network", "both"]]
    assert Afferents(16, {}, 2000.0).cost(60) == Cost()
    assert Afferents(16, SMOOTHED, 2000.0).cost(60) != Cost()
