"""Each way to save changes what it names and nothing else, on touches small enough to count by hand."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison import by_list, saving, ways_to_save
from neurotact_parts.studies.comparison.fronts import NOTHING
from neurotact_parts.studies.comparison.saving import Bench, Setting, changed, cut, measured
from neurotact_parts.studies.comparison.sets import WaysData, bench_of
from neurotact_parts.studies.comparison.ways_to_save import Parameters, in_words

from neurotact.data.spikes import from_rasters
from neurotact.data.splits import Split, SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.encoders.closed_form import cost_of_spikes
from neurotact.encoders.cost import encoding_cost
from neurotact.errors import InputError
from neurotact.metrics import synops
from neurotact.metrics.prices import price_list
from neurotact.networks.definition.recipe import Seen
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training import ensemble, trainer
from neurotact.networks.use import measuring
from neurotact.networks.use.ledger import decision_ledger, network_cost
from neurotact.spec import build

WAYS = {
    "refractory period": [{"t_ref_ms": [20, 20]}],
    "refractory period, longest steps": [{"t_ref_ms": [20, 20], "longest_steps": True}],
    "slower clock": [{"step_ms": 10.0}],
    "rate penalty": [{"rate_penalty": 50.0}],
    "fewer taxels": [{"taxels": 0.25}],
    "shorter windows": [{"window": 0.5}],
    "no recurrence": [{"recurrence": False}],
    "fewer hidden neurons": [{"hidden": 0.5}],
    "pruning": [{"prune": 0.5}],
    "pruning, trained on": [{"prune": 0.5, "train_on": True}],
    "early exit": [{"exit_tolerance": 0.9}],
}
SETS = {
    "gratings": {
        "dataset": {"simulate": "gratings", "parameters": {"trials": 1, "duration_s": 0.4}},
        "conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "start", "resample_Hz": 500.0},
        "window": {"length_ms": 100.0, "start_ms": 250.0, "per_trial": 1},
    },
    "letters": {
        "dataset": {"read": "braille-letters", "path": "set below"}, "window": {"length_ms": 200.0, "per_trial": 1},
    },
}  # fmt: skip
N_TAXELS = 8
NETWORK = {
    "model": "rsnn", "hidden": 10, "readout": "integrator", "input_deviation": 1.0, "tau_mem_ms": 20.0,
    "tau_syn_ms": 10.0, "training": {"epochs": 8, "patience": 8, "batch": 8, "relative_learning_rate": 0.05},
}  # fmt: skip


def letters(folder):
    """Two letters on taxels of their own."""
    rng = np.random.default_rng(0)
    number = np.repeat(np.arange(30), 20)
    taxel = rng.integers(2, size=len(number)) + 2 * (number // 15)
    path = folder / "events.npz"
    np.savez(
        path, letter=np.repeat(["A", "B"], 15), event_recording=number, event_taxel=taxel,
        event_polarity=rng.integers(2, size=len(number)), event_time_s=rng.uniform(0, 0.2, len(number)),
    )  # fmt: skip
    return str(path)


def at(path):
    return {**SETS["letters"], "dataset": {"read": "braille-letters", "path": str(path)}}


def ran(name, folder, ways=WAYS, network=NETWORK, **more):
    sets = {**SETS, "letters": at(letters(folder))}
    table = {"data": {"set": name, "sets": sets}, "ways": ways, "network": network, **more}
    parameters = build(Parameters, table, source="test")
    arrays = ways_to_save.load(parameters.data)
    return parameters, arrays, {row["way"]: row for row in ways_to_save.run(parameters, arrays)}


@pytest.fixture(scope="module", params=["gratings", "letters"])
def rows(request, tmp_path_factory):
    return ran(request.param, tmp_path_factory.mktemp("ways"))[2]


def test_every_way_leaves_a_row(rows):
    assert list(rows) == [NOTHING, *WAYS]
    for row in rows.values():
        assert 0 <= row["accuracy_test"] <= 1
        assert (
            row["n_validation"] / row["validation_trials"] == row["n_test"] / row["test_trials"]
        )  # windows of a trial
        assert row["sops_total"] == pytest.approx(row["sops_input"] + row["sops_recurrent"] + row["sops_readout"])


def test_rows_hold_what_every_price_list_needs(rows):
    table = pd.DataFrame([*rows.values()], index=pd.Index(rows))
    energies = by_list.energies(table)
    assert energies.notna().all(axis=None)
    assert energies["arithmetic-45nm"].to_numpy() == pytest.approx(table["energy_estimate_nJ"].to_numpy())
    assert table["sops"].to_numpy() == pytest.approx(table["sops_total"].to_numpy())
    # Each hidden neuron in each step, or where a spike comes.
    steps = table["signal_ms"] / table["network_step_ms"]
    hidden = pd.Series(10, rows).where(table.index != "fewer hidden neurons", 5)
    assert table["neuron_updates"].to_numpy() == pytest.approx((hidden * steps).to_numpy())
    assert (table["events_neuron_updates"] == table["touched_hidden"]).all()
    assert (table["touched_hidden"] <= hidden * np.ceil(steps)).all()  # the last step may begin within the window
    assert table["touched_hidden"]["early exit"] < table["touched_hidden"][NOTHING]
    assert table["touched_hidden"]["pruning"] < table["touched_hidden"][NOTHING]
    if (table["afferents"] == "events").all():  # nothing is encoded; a spike comes from a queue, and goes back
        queued = 2 * table["input_spikes"] + (2 + (table["sops_recurrent"] > 0)) * table["hidden_spikes"]
        assert table["buffers_accesses"].to_numpy() == pytest.approx(queued.to_numpy())


def test_a_list_of_events_prices_a_network_that_is_updated_by_events(tmp_path):
    network = {**NETWORK, "training": {**NETWORK["training"], "epochs": 1, "patience": 1}}
    _, _, found = ran("letters", tmp_path, {}, network, prices="memory-45nm-events")
    row = found[NOTHING]
    energies = by_list.energies(pd.DataFrame([row])).iloc[0]
    assert energies["memory-45nm-events"] == pytest.approx(row["energy_estimate_nJ"])
    assert energies["memory-45nm"] != pytest.approx(row["energy_estimate_nJ"])
    (drawn,) = ways_to_save.draw(pd.DataFrame([{"set": "a", "seed": 0, **row}]), {})
    assert "Energy is an estimate by the price list memory-45nm-events." in drawn.caption


def test_refractory_periods_save_input_spikes_and_penalties_hidden_ones(rows):
    assert rows["refractory period"]["input_spikes"] < 0.9 * rows[NOTHING]["input_spikes"]
    assert rows["rate penalty"]["hidden_spikes"] < 0.9 * rows[NOTHING]["hidden_spikes"]
    assert rows["rate penalty"]["input_spikes"] == rows[NOTHING]["input_spikes"]


def test_a_refractory_period_of_20_ms_allows_steps_of_20_ms_which_merge_no_spikes(rows):
    own, longest, slower = (
        rows[way] for way in ("refractory period", "refractory period, longest steps", "slower clock")
    )
    assert longest["network_step_ms"] >= 20.0 > 10.0 == slower["network_step_ms"] > own["network_step_ms"]
    assert longest["energy_estimate_nJ"] < own["energy_estimate_nJ"]
    assert longest["input_spikes"] == pytest.approx(own["input_spikes"], rel=0.02)  # those of training windows, all
    assert slower["input_spikes"] < rows[NOTHING]["input_spikes"]


def test_a_quarter_of_the_taxels_and_half_the_window_send_less(rows):
    assert 0 < rows["fewer taxels"]["input_spikes"] < rows[NOTHING]["input_spikes"]
    assert 0 < rows["shorter windows"]["input_spikes"] < rows[NOTHING]["input_spikes"]
    assert rows["shorter windows"]["signal_ms"] == pytest.approx(rows[NOTHING]["signal_ms"] / 2)
    assert rows["fewer taxels"]["signal_ms"] == rows[NOTHING]["signal_ms"]


def test_smaller_networks_count_less_for_each_spike(rows):
    whole, half = rows[NOTHING], rows["fewer hidden neurons"]
    assert whole["sops_input"] == pytest.approx(10 * whole["input_spikes"])
    assert half["sops_input"] == pytest.approx(5 * half["input_spikes"])
    assert rows["no recurrence"]["sops_recurrent"] == 0 < whole["sops_recurrent"]


@pytest.mark.parametrize(("model", "pays"), [("auto", True), ("auto", False), ("snn", False)])
def test_no_recurrence_has_a_row_in_every_seed_in_which_training_decides(model, pays, monkeypatch, tmp_path):
    monkeypatch.setattr(ensemble, "pays", lambda without, with_it: pays)
    ways = {"no recurrence": [{"recurrence": False}, {"recurrence": False, "hidden": 0.5}]}
    network = {**NETWORK, "model": model, "training": {**NETWORK["training"], "epochs": 2, "patience": 2}}
    parameters, arrays, _ = ran("letters", tmp_path, ways, network)
    rows = ways_to_save.run(parameters, arrays)
    assert [row["way"] for row in rows] == [NOTHING, *["no recurrence"] * (2 if model == "auto" else 0)]
    for whole, none, fewer in [rows] if model == "auto" else []:
        assert none["sops_recurrent"] == fewer["sops_recurrent"] == 0
        assert 2 * fewer["sops_input"] == none["sops_input"] == whole["sops_input"]
        assert (none["sops_total"] == whole["sops_total"]) == (not pays)
        assert none["setting"] == "feed-forward"


def test_pruning_changes_no_spike_that_comes_in_and_counts_what_remains(rows):
    for way in ("pruning", "pruning, trained on"):
        assert rows[way]["input_spikes"] == rows[NOTHING]["input_spikes"]
        assert 0 < rows[way]["sops_input"] < rows[NOTHING]["sops_input"]
    assert rows["pruning, trained on"]["sops_total"] != rows["pruning"]["sops_total"]


def test_a_pruned_network_pays_for_the_memory_of_what_is_left():
    """As its run folder does (`neurotact sops`)."""
    table = {"data": {"set": "gratings", "sets": SETS}, "ways": {}, "network": NETWORK}
    parameters, known = build(Parameters, table, source="test"), {}
    bench = bench_of(parameters.data, parameters.network, 0, ways_to_save.load(parameters.data))
    setting, prices = Setting(sparsity=0.75), price_list("memory-45nm")
    row = measured(bench, setting, known, prices)
    network, trains, sides, *_ = known[setting.first_training()]
    found = network.infer(sides.test.spikes)
    labels = found.labels.numpy()
    counted = [part.numpy() for part in (found.steps, found.input_spikes, found.hidden_spikes)]
    means = synops.summary(synops.table_of(measuring.synops_of(found, network), labels, labels, *counted))
    sizes = network.n_inputs, network.n_classes, trains.sampling_rate_Hz
    made_by = {"encoder": trains.encoder, "recorded_Hz": trains.recorded_Hz, "synapses": network.synapses}
    spent = decision_ledger(network.spec, *sizes, means, prices=prices, **made_by).set_index("name").loc["both"]
    assert row["weights_bytes"] == pytest.approx(spent["weights_bytes"])
    assert row["energy_estimate_nJ"] == pytest.approx(spent["energy_estimate_nJ"])


def test_early_exit_is_used_where_validation_bounds_its_loss_alone(monkeypatch):
    table = {"data": {"set": "gratings", "sets": SETS}, "ways": {}, "network": NETWORK}
    parameters = build(Parameters, table, source="test")
    bench = bench_of(parameters.data, parameters.network, 0, ways_to_save.load(parameters.data))
    known, seen = {}, []
    monkeypatch.setattr(saving, "row_of", lambda fitted, rule, **how: seen.append((fitted, rule)) or {})
    for tolerance in (0.0, 0.01, 0.9):
        measured(bench, Setting(exit_tolerance=tolerance), known)
        fitted, rule = seen[-1]
        choice = trainer.exit_of(fitted.network, fitted.sides.validation, tolerance)
        assert rule == (choice.rule if choice.bound <= tolerance else FULL_WINDOW)
    assert [rule.never for _, rule in seen] == [True, True, False]


def test_windows_of_one_trial_are_no_further_trials_of_that_bound():
    conditions = pd.DataFrame({"label": list("ab") * 3})
    trains = from_rasters(np.ones((6, 40, 2), bool), 1000.0, ("SA-I a", "RA-I a"), conditions)
    split, network = Split(*np.arange(6).reshape(3, 2)), build(RSNNSpec, NETWORK, source="test")
    own = cut(Bench(trains, None, split, WindowSpec(length_ms=10.0), network, (0, 1)), Setting())
    assert own.sides.validation.of.tolist() == [2] * 4 + [3] * 4


def test_early_exit_waits_less(rows):
    assert rows["early exit"]["signal_ms"] < rows[NOTHING]["signal_ms"]
    assert rows["early exit"]["sops_total"] < rows[NOTHING]["sops_total"]
    assert rows["early exit"]["energy_estimate_nJ"] < rows[NOTHING]["energy_estimate_nJ"]


@pytest.mark.parametrize("seed", [0, 3])
def test_a_seed_starts_as_any_training_on_its_split(seed):
    table = {"data": {"set": "gratings", "sets": SETS}, "ways": {}, "network": NETWORK}
    parameters = build(Parameters, table, source="test")
    bench = bench_of(parameters.data, parameters.network, seed, ways_to_save.load(parameters.data))
    assert bench.seeds == of_start(seed, SplitSpec(seed=2 * seed))


def test_a_moving_average_costs_at_the_rate_of_the_sensor():
    table = {"data": {"set": "gratings", "sets": SETS}, "ways": {}, "network": {**NETWORK, "model": "snn"}}
    parameters, known = build(Parameters, table, source="test"), {}
    bench = bench_of(parameters.data, parameters.network, 0, ways_to_save.load(parameters.data))
    row = measured(bench, Setting(), known)
    network, trains, *_ = known[Setting().first_training()]
    alone = network_cost(network.spec, network.n_inputs, network.n_classes, row, steps=50, signal_ms=100.0)
    encoding = encoding_cost(N_TAXELS, 50, 100.0, trains.encoder, recorded_Hz=2000.0)
    assert row["energy_estimate_nJ"] == pytest.approx((alone + encoding).energy_estimate_nJ)
    assert encoding.multiplications == (200 + 50) * N_TAXELS  # and the scales


SLOW = {**SETS["gratings"], "conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "start", "resample_Hz": 4000.0}}


def test_in_closed_form_samples_and_all_spikes_that_are_sent_cost():
    network = {**NETWORK, "model": "snn"}
    table = {"data": {"set": "slow", "sets": {"slow": SLOW}}, "ways": {}, "network": network}
    parameters = build(Parameters, table, source="test")
    bench = bench_of(parameters.data, parameters.network, 0, ways_to_save.load(parameters.data))
    assert bench.encoder is not None
    assert bench.encoder.integration == "exact"
    sent, known = float(cut(bench, Setting()).sides.test.spikes.sum(dim=(1, 2)).double().mean()), {}
    for setting in (Setting(), Setting(step_ms=10.0), Setting(prune=0.5)):  # bins merge, and pruned weights count less
        row = measured(bench, setting, known)
        network, trains, *_ = known[setting.first_training()]
        alone = network_cost(network.spec, network.n_inputs, network.n_classes, row, steps=400, signal_ms=100.0)
        encoder = {**trains.encoder, "integration": "clock", "conditioning": {**trains.encoder["conditioning"]}}
        del encoder["conditioning"]["resample_Hz"]
        encoding = encoding_cost(N_TAXELS, 200, 100.0, encoder) + cost_of_spikes(sent)  # samples at 2 kHz
        assert row["energy_estimate_nJ"] == pytest.approx((alone + encoding).energy_estimate_nJ)


@given(
    t_ref_ms=st.tuples(*[st.floats(0, 200)] * 2), own_ms=st.none() | st.floats(0.01, 50),
    clock_ms=st.sampled_from([0.5, 1.0, 2.0, 5.0]), is_events=st.booleans(),
)  # fmt: skip
def test_times_of_a_setting_are_whole_steps_once_and_for_all(t_ref_ms, own_ms, clock_ms, is_events):
    setting = Setting(t_ref_ms=t_ref_ms, step_ms=own_ms).on(clock_ms, is_events=is_events)
    assert setting.on(clock_ms, is_events=is_events) == setting
    for period in setting.t_ref_ms or ():
        assert period / clock_ms == round(period / clock_ms)
        assert period >= clock_ms * (not is_events)
    assert setting.step_ms is None or setting.step_ms > clock_ms
    assert in_words(setting, is_events=is_events) == "-" if setting == Setting() else True


def test_the_longest_steps_may_be_tried_with_the_shortest_refractory_period():
    shortest = Setting(t_ref_ms=(5, 5), longest_steps=True).on(5.0, is_events=False)
    assert in_words(shortest) == "5 & 5 ms, longest steps"
    assert Setting(t_ref_ms=(5, 5)).on(5.0, is_events=False) == Setting()
    with pytest.raises(InputError, match="longest_steps: the clock has steps of step_ms"):
        Setting(longest_steps=True, step_ms=5.0)


def test_a_run_of_several_sets_is_drawn_over_operations_and_over_energy():
    row = {"seed": 0, "accuracy_validation": 0.9, "accuracy_test": 0.9, "signal_ms": 10.0, "n_train": 70, "n_test": 15}
    costs = {"sops_total": 1000.0, "energy_estimate_nJ": 100.0}
    results = pd.DataFrame(
        [{"set": name, "way": way, "setting": "-", **row, **costs} for name in "ab" for way in (NOTHING, *WAYS)]
    )
    drawn = list(ways_to_save.draw(results, {}))
    assert [one.name for one in drawn] == ["ways-to-save", "ways-to-save-energy"]
    assert len(list(ways_to_save.draw(results[results["set"] == "a"], {}))) == 1


def test_taxels_that_vary_stay(tmp_path):
    # Taxels 5 to 12 send nothing: a third of twelve is those that send.
    _, _, found = ran("letters", tmp_path, {"fewer taxels": [{"taxels": 1 / 3}]})
    assert found["fewer taxels"]["input_spikes"] == found[NOTHING]["input_spikes"]


def test_a_shorter_window_leaves_recurrence_as_it_is():
    asked, seen = RSNNSpec(recipe="default"), Seen(100, 300, 1000.0, 3.0)
    for whole_steps, model, scale in ((300, "auto", 20.0), (2000, "snn", 10.0)):
        spec = changed(asked, Setting(window=0.5), seen, whole_steps)
        assert (spec.model, spec.surrogate_scale, spec.tau_mem_ms) == (model, scale, 15.0)


@pytest.mark.parametrize("decided", ["rsnn", "snn"])
def test_whether_a_network_is_recurrent_is_decided_where_nothing_is_saved(decided, monkeypatch):
    raster = np.zeros((40, 60, 2), np.uint8)
    raster[:20, 10::20, 0] = raster[20:, 10::20, 1] = 1
    trains = from_rasters(raster, 1000.0, ("a", "b"), pd.DataFrame({"label": ["felt", "silk"] * 20}))
    split = Split(np.arange(24), np.arange(24, 32), np.arange(32, 40))
    network = build(RSNNSpec, {"recipe": "default", "hidden": 4, "training": {"epochs": 1}}, source="test")
    bench = Bench(trains, None, split, WindowSpec(length_ms=60.0, per_trial=1), network, (0, 1))
    monkeypatch.setattr(ensemble, "pays", lambda without, with_it: decided == "rsnn")
    known: dict = {}
    measured(bench, Setting(), known)
    monkeypatch.setattr(ensemble, "pays", lambda without, with_it: pytest.fail("is decided already"))
    measured(bench, Setting(hidden=0.5), known)
    assert [fitted.network.spec.model for fitted in known.values()] == [decided, decided]


def test_a_shorter_window_leaves_the_clock_as_it_is():
    asked, seen = RSNNSpec(recipe="default"), Seen(100, 60, 1000.0, 20.0, apart=6)
    spec = changed(asked, Setting(window=0.5), seen, 120)
    assert (spec.step_ms, spec.readout_stretch_ms) == (4.0, 16.0)


def test_half_of_the_window_has_the_clock_of_the_whole_one():
    raster = np.zeros((40, 300, 2), np.uint8)
    raster[:20, ::10, 0] = raster[20:, ::10, 1] = 1
    raster[:, 281, :] |= raster[:, 280, :]  # spikes of neighbouring steps in the second half alone
    trains = from_rasters(raster, 1000.0, ("a", "b"), pd.DataFrame({"label": ["felt", "silk"] * 20}))
    split = Split(np.arange(24), np.arange(24, 32), np.arange(32, 40))
    network = build(RSNNSpec, {"recipe": "default", "hidden": 4, "training": {"epochs": 1}}, source="test")
    bench = Bench(trains, None, split, WindowSpec(length_ms=300.0, per_trial=1), network, (0, 1))
    assert [measured(bench, Setting(window=share), {})["network_step_ms"] for share in (1.0, 0.5)] == [1.0, 1.0]


def test_thresholds_adapt_where_a_setting_says_so():
    seen = Seen(900, 200, 1000.0, 50.0)
    asked = RSNNSpec(recipe="default", hidden=20)
    assert changed(asked, Setting(adaptation=0.3), seen, 200).threshold_adaptation == 0.3
    assert changed(asked, Setting(), seen, 200).threshold_adaptation == 0.0
    assert Setting(adaptation=0.3).first_training() != Setting().first_training()


def test_gains_hold_on_the_set_s_clock(tmp_path):
    parameters, arrays, _ = ran("gratings", tmp_path, {})
    bench = bench_of(parameters.data, parameters.network, parameters.seed, arrays)
    assert bench.encoder is not None
    assert bench.encoder.conditioning.resample_Hz == 500.0
    assert bench.encoder.sa1.t_ref_ms == bench.encoder.ra1.t_ref_ms == 2.0


def test_a_way_is_priced_by_the_list_that_is_named(tmp_path):
    chip = tmp_path / "chip.toml"
    chip.write_text("source = 'a test'\nmultiplication_pJ = 7.4\naddition_pJ = 1.8\n")
    usual, dear = (
        ran("letters", tmp_path, {}, {**NETWORK, "training": {"epochs": 1}}, **how)[2][NOTHING]
        for how in ({}, {"prices": str(chip)})
    )
    assert dear["energy_estimate_nJ"] == pytest.approx(2 * usual["energy_estimate_nJ"])
    assert (usual["prices"], dear["prices"]) == ("arithmetic-45nm", "chip")


def test_a_set_that_is_not_at_hand_is_left_out(tmp_path):
    sets = {"letters": at(tmp_path / "nowhere.npz")}
    parameters = build(Parameters, {"data": {"set": "letters", "sets": sets}, "ways": {}}, source="test")
    (row,) = ways_to_save.run(parameters, ways_to_save.load(parameters.data))
    assert row["skipped"].startswith("letters is left out: ")
    assert np.isnan(row["accuracy_test"])


def test_what_fits_no_set_or_way_is_refused():
    with pytest.raises(InputError, match=r"'lettres' is not one of the sets.*letters"):
        WaysData(set="lettres", sets=SETS)
    with pytest.raises(InputError, match="train_on trains a pruned network further"):
        Setting(train_on=True)
    with pytest.raises(InputError, match="use another name"):
        build(Parameters, {"data": {"set": "letters", "sets": SETS}, "ways": {NOTHING: [{}]}}, source="test")
