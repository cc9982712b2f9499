"""A touch that is none of the classes is refused by its lead, alike in every executor, for a stated share."""

import json
import shutil
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest
import torch
from compiled import chosen
from compiled import compare as compare_in_c
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS, make_chain, make_run, make_signal, offline, told
from neurotact_parts.exporters import chips
from neurotact_parts.exporters.c import proof
from neurotact_parts.exporters.c.formats import Integrator
from neurotact_parts.exporters.c.integer import least_lead as least_lead_in_integers
from neurotact_parts.exporters.live.scores import Scores
from neurotact_parts.exporters.nir import graph, note
from neurotact_parts.streams import stream_file
from neurotact_parts.streams.chain import Chain, chain_of
from neurotact_parts.streams.stream import Stream
from neurotact_parts.streams.stream_file import fingerprint

import neurotact as nt
from neurotact.backend import native
from neurotact.data import hdf5
from neurotact.errors import InputError
from neurotact.metrics import synops
from neurotact.networks.exit.refusal import Refusal, least_lead
from neurotact.networks.exit.rule import ExitRule, leads
from neurotact.networks.training import model_selection, run_folder, tasks, trainer
from neurotact.networks.training.epochs import Examples, Training
from neurotact.networks.use import inference

BACKENDS = ["reference", *(["native"] if native else [])]
WINDOWS = {"length_ms": 30, "hop_ms": 9}
SHARES = st.sampled_from([0.01, 0.05, 0.1, 0.25, 0.5, 0.9])


@given(st.lists(st.integers(0, 30), min_size=2, max_size=60), SHARES)
@examples(100)
def test_of_known_touches_at_most_the_stated_share_is_refused_whatever_the_leads(values, share):
    """Each of n + 1 touches in turn is the new one, of which none is likelier than another."""
    known = np.array(values, float)
    refused = [known[i] < least_lead(np.delete(known, i), share) for i in range(len(known))]
    assert sum(refused) <= share * len(known) + 1e-6


@given(st.sets(st.integers(1, 10**6), min_size=2, max_size=60), SHARES)
@examples(100)
def test_it_is_the_stated_share_to_one_touch_where_no_leads_are_equal(values, share):
    known = np.array(sorted(values), float)
    refused = [known[i] < least_lead(np.delete(known, i), share) for i in range(len(known))]
    assert sum(refused) == int(share * len(known) + 1e-6)


def test_the_interval_holds_the_share_that_is_refused_as_often_as_it_says():
    """Leads that are even from 0 to 1: the share that is refused is the least lead itself."""
    rng, share, n = np.random.default_rng(0), 0.1, 60
    low, high = Refusal(share, 0.0, 0.0, n).interval
    refused = np.array([least_lead(rng.random(n), share) for _ in range(2000)])
    assert abs(((low <= refused) & (refused <= high)).mean() - 0.95) < 0.02
    assert abs(refused.mean() - int(share * (n + 1)) / (n + 1)) < 0.005


def test_too_few_trials_refuse_nothing_and_say_how_many_are_needed():
    for share, least in ((0.05, 19), (0.1, 9), (0.3, 3)):
        readouts = {n: torch.arange(1.0, 2 * n + 1).view(n, 2).cumprod(1) for n in (least - 1, least)}
        few, enough = (Refusal.of(share, readout, readout, n) for n, readout in readouts.items())
        assert (few.whole, few.early, few.interval) == (0.0, 0.0, (0.0, 0.0))
        assert f"need {least} validation trials, not {least - 1};" in few.in_words
        assert enough.whole > 0
        assert "have no lead" in enough._replace(whole=0.0).in_words
        assert "are refused: of new ones" in enough.in_words


def test_many_windows_of_few_trials_refuse_nothing():
    readout = torch.arange(1.0, 201.0).view(100, 2).cumprod(1)
    assert Refusal.of(0.05, readout, readout, 100).early == Refusal.of(0.05, readout, readout, 19).whole > 0
    assert Refusal.of(0.05, readout, readout, 18)[1:3] == (0.0, 0.0)


def refusing(chain: Chain, n_samples: int) -> tuple[Chain, list[tuple]]:
    """The chain with the median lead of a signal's windows as the least one, and what it decides of the whole trial."""
    signal = make_signal(n_samples)
    raster, _ = offline(chain, signal)
    starts = chain.windows.starts(raster)
    windows = torch.from_numpy(np.stack([raster[start : start + chain.windows.length] for start in starts.tolist()]))
    its = leads(chain.network.infer(windows, chain.rule).readout).double()
    chain = chain._replace(rule=replace(chain.rule, least_lead=float(its.median()) + 1e-3))
    expected = offline(chain, signal)[1]
    labels = [row[1] for row in expected]
    assert [label == 3 for label in labels] == (its < chain.rule.least_lead).tolist()
    assert {True, False} == {label == 3 for label in labels}
    return chain, expected


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("patience", [None, 5])
@pytest.mark.parametrize("readout", [*READOUTS])
def test_a_stream_refuses_what_the_whole_trial_refuses(readout, patience, backend):
    chain = make_chain(
        {"baseline": "start"}, readout=readout, patience=patience, windows={"length_ms": 30, "hop_ms": 9}
    )
    chain, expected = refusing(chain, 300)
    decided = [*Stream(chain, backend=backend).push(make_signal(300))]
    assert told(decided)[: len(expected)] == expected
    assert {d.label for d in decided if d.index == 3} == {"none"}
    assert {d.label for d in decided if d.index < 3} <= {*chain.classes}


@pytest.mark.slow
@pytest.mark.parametrize("integer", [False, True])
@pytest.mark.parametrize(("readout", "patience"), [("count", None), ("count", 5), ("integrator", 5), ("leaky", None)])
def test_c_refuses_what_its_twin_refuses(readout, patience, integer, tmp_path):
    if proof.missing("cc"):
        pytest.skip("there is no C compiler")
    if integer and readout == "leaky":
        return
    chain = make_chain(
        {"baseline": "start"}, readout=readout, patience=patience, windows={"length_ms": 30, "hop_ms": 9}
    )
    chain, _ = refusing(chain, 150)
    formats = chosen(chain, [make_signal(150, seed=k) for k in range(2)]) if integer else None
    difference, expected = compare_in_c(chain, tmp_path / "c", formats, n=2, flags=("-O0",))
    assert difference is None
    assert {True, False} == {row[-1] == 3 for said in expected for row in said.decisions}
    assert "#define SKIN_NONE 3 " in (tmp_path / "c" / "skin.h").read_text()


def test_a_lead_that_another_order_of_sums_rounds_is_refused_in_neither():
    known = np.arange(1.0, 20.0) / 7
    least = least_lead(known, 0.1)
    assert known[0] < least < np.nextafter(known[1], 0)


@given(st.integers(-2, 2), st.floats(1e-3, 1e3), st.floats(1e-3, 10))
@examples(100)
def test_in_whole_units_a_lead_is_less_if_and_only_if_it_is_less(apart, least, unit):
    lead = int(least / unit) + apart
    readout = Integrator(unit, np.zeros((1, 2)), np.zeros(2))
    assert (lead < least_lead_in_integers(readout, ExitRule(least_lead=least))) == (lead < least / unit)


def test_without_a_least_lead_nothing_is_written_of_it(tmp_path, monkeypatch):
    folder = make_run(tmp_path)
    table = json.loads((folder / "run" / "network.json").read_text())["extra"]
    assert "refusal" not in table
    assert "refuse" not in table["task"]
    chain = chain_of(folder / "run")
    assert chain.rule.least_lead == 0
    nt.export_c(folder / "run", tmp_path / "c", variant="float")
    assert "_NONE" not in (tmp_path / "c" / "touch.h").read_text()
    with_lead = chain._replace(rule=replace(chain.rule, least_lead=1.0))
    assert fingerprint(with_lead) != fingerprint(chain)
    before = {key: value for key, value in asdict(chain.rule).items() if key != "least_lead"}
    found = fingerprint(chain)
    monkeypatch.setattr(stream_file, "asdict", lambda part: before if part is chain.rule else asdict(part))
    assert fingerprint(chain) == found


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of `make_run`, with `refusing`, a run that refuses, and what training told."""
    folder, said = make_run(tmp_path_factory.mktemp("refusing"), n_trials=60), []
    settings = {"hidden": 5, "training.epochs": 2, "forward_weight_scale": 3.0, "readout": "integrator"}
    result = nt.train(
        folder / "spikes.h5", folder / "refusing", "rsnn", settings, window=nt.Window(length_ms=40),
        learn=nt.Learn(refuse=0.3), tell=said.append,
    )  # fmt: skip
    return folder, result, said


def test_a_trained_network_refuses_by_its_validation_windows(made):
    folder, result, said = made
    restored = run_folder.restore(folder / "refusing")
    trains = hdf5.load_spikes(folder / "spikes.h5")
    side = tasks.sides_of(trains, restored.task).validation
    refusal = restored.refusal
    assert refusal is not None
    assert refusal.share == restored.task.refuse == 0.3
    assert refusal.trials == len(tasks.trials_of(trains, restored.task).validation)
    for least, rule in ((refusal.whole, ExitRule()), (refusal.early, restored.rule)):
        its = leads(restored.network.infer(side.spikes, rule).readout).numpy()
        assert least == least_lead(its, 0.3) > 0
    assert restored.exits(early_exit=False) == ExitRule(least_lead=refusal.whole)
    assert restored._replace(held=None).exits() == replace(restored.rule, least_lead=refusal.early)
    table = nt.infer(folder / "refusing", folder / "spikes.h5", test_only=True)
    answered = table["predicted"] != "none"
    assert answered.mean() == result["answered"] < 1
    right = table["predicted"] == table["label"]
    assert right[answered].mean() == result["accuracy_answered"]
    assert any(f"{result['answered']:.1%} of test windows answered" in str(line) for line in said)
    means = nt.summarise(table).iloc[-1]
    assert means["answered"] == answered.mean()
    assert means["accuracy_answered"] == pytest.approx(right[answered].mean(), rel=1e-12)
    assert means["accuracy"] == right.mean()
    plain = inference.infer(restored._replace(refusal=None), trains, early_exit=False, test_only=True)
    pd.testing.assert_frame_equal(table.drop(columns="predicted"), plain.drop(columns="predicted"))
    assert (table["predicted"] == plain["predicted"])[answered].all()
    assert not {"answered", "accuracy_answered"} & {*nt.summarise(plain)}
    assert "refusal" not in nt.summarise(plain)


def test_touches_of_an_unknown_class_are_taken_by_a_network_that_refuses_alone(made):
    folder, _, _ = made
    trains = hdf5.load_spikes(folder / "spikes.h5")
    conditions = trains.conditions.assign(label=["wool"] * 30 + ["silk"] * 30)
    unknown = replace(trains, conditions=conditions)
    table = nt.infer(folder / "refusing", unknown)
    assert {*table["label"]} == {"wool", "silk"}
    assert "none" in set(table["predicted"]) <= {"none", "felt", "silk"}
    with pytest.raises(InputError, match="class 'wool' is not a class of the network"):
        nt.infer(folder / "run", unknown)


@pytest.mark.parametrize("early_exit", [False, True])
def test_a_stream_of_a_run_refuses_what_infer_refuses(made, early_exit):
    folder, _, _ = made
    restored = run_folder.restore(folder / "refusing")._replace(held=None)
    table = inference.infer(restored, hdf5.load_spikes(folder / "spikes.h5"), early_exit=early_exit)
    first = table[table["trial"] == table["trial"].min()]
    signal = hdf5.load_recordings(folder / "skin.h5").signals[0]
    stream = Stream(chain_of(restored, nt.Streamed(full_window=not early_exit)))
    decided = sorted(stream.push(signal), key=lambda each: each.window)[: len(first)]
    assert [d.label for d in decided] == first["predicted"].tolist()


def test_a_trained_network_refuses_as_if_it_had_been_trained_to(made, tmp_path):
    folder, _, _ = made
    before, said = (folder / "run" / "network.json").read_bytes(), []
    shutil.copytree(folder / "refusing", tmp_path / "refusing")
    spikes = folder / "spikes.h5"
    assert nt.refuse(tmp_path / "refusing", None, spikes=spikes) is None
    assert run_folder.restore(tmp_path / "refusing").refusal is None
    assert run_folder.restore(tmp_path / "refusing").task.refuse is None
    found = nt.refuse(tmp_path / "refusing", 0.3, spikes=spikes, tell=said.append)
    assert said == [found.in_words]
    again, trained = (json.loads((each / "refusing" / "network.json").read_text()) for each in (tmp_path, folder))
    assert again == trained
    assert nt.refuse(folder / "run", 0.5).share == 0.5
    assert (folder / "run" / "network.json").read_bytes() != before
    nt.refuse(folder / "run", None)
    assert (folder / "run" / "network.json").read_bytes() == before
    with pytest.raises(InputError, match="refuse: must be < 1"):
        nt.refuse(folder / "run", 1.0)


@pytest.mark.thorough
def test_a_last_training_and_a_fine_tuned_network_refuse_by_their_own_leads(made, tmp_path):
    """Where the test is at another condition, a training before the last one chooses the rule of early exit."""
    folder, _, _ = made
    trains = hdf5.load_spikes(folder / "spikes.h5")
    trains = replace(trains, conditions=trains.conditions.assign(speed=np.repeat([1, 2, 3], 20)))
    hdf5.save_spikes(trains, tmp_path / "spikes.h5")
    settings = {"hidden": 5, "training.epochs": 2, "forward_weight_scale": 3.0, "readout": "integrator"}
    split, window = nt.Split(test_where={"speed": 3}), nt.Window(length_ms=40)
    run = tmp_path / "run"
    nt.train(tmp_path / "spikes.h5", run, "rsnn", settings, window=window, split=split, learn=nt.Learn(refuse=0.3))
    table = json.loads((run / "network.json").read_text())
    patience = 3 if table["extra"]["exit_patience"] != 3 else 4
    (run / "network.json").write_text(json.dumps({**table, "extra": {**table["extra"], "exit_patience": patience}}))
    nt.refuse(run, 0.3)
    nt.fine_tune(run, tmp_path / "tuned", epochs=1)
    for each in (run, tmp_path / "tuned"):
        restored = run_folder.restore(each)
        assert not restored.has_own_rule
        assert restored.rule.patience == patience
        spikes = tasks.sides_of(trains, restored.task).validation.spikes
        its = [leads(restored.network.infer(spikes, rule).readout) for rule in (ExitRule(), restored.rule)]
        assert restored.refusal is not None
        assert restored.refusal[1:3] == tuple(least_lead(each.numpy(), 0.3) for each in its)


def test_the_last_training_refuses_by_the_rule_that_one_before_it_chose(monkeypatch):
    generator = torch.Generator().manual_seed(0)
    network = nt.RSNN(2, 3, hidden=4, sampling_rate_Hz=1000.0, readout="integrator", generator=generator)
    spikes = (torch.rand(30, 40, 2, generator=generator) < 0.3).to(torch.uint8)
    side, rule = Examples(spikes, torch.zeros(30, dtype=torch.int64)), ExitRule(5, from_first_spike=True)
    task, choice = tasks.Task(refuse=0.3), model_selection.Choice.model_construct(network=network.spec, exit_patience=5)
    own = trainer.Trained(network, Training((), None), ExitRule(20, from_first_spike=True))  # pyright: ignore
    monkeypatch.setattr(trainer, "fit", lambda *_, **__: (own, tasks.Sides(side, side, side)))
    found, _ = model_selection.last(None, choice, task, (0, 1))  # pyright: ignore[reportArgumentType]
    assert found.refusal == trainer.refusal_of(network, rule, side, task)
    assert found.refusal != trainer.refusal_of(network, own.rule, side, task)


def test_a_share_that_needs_more_trials_is_a_caution_and_said_of_each_report(made, capsys):
    settings, folder = {"hidden": 2, "training.epochs": 1}, made[0]
    options = {"window": nt.Window(length_ms=40), "learn": nt.Learn(refuse=0.01)}
    told: list[object] = []
    result = nt.train(folder / "spikes.h5", folder / "few", "rsnn", settings, tell=told.append, **options)
    assert not any("none of these" in str(line) for line in told)  # once is enough
    assert any("nothing is refused: 1 % of known touches need 99" in line for line in result["cautions"])
    assert (result["answered"], result["accuracy_answered"]) == (1.0, result["accuracy_test"])
    capsys.readouterr()
    nt.infer(folder / "few", folder / "spikes.h5")
    assert capsys.readouterr().err.count("nothing is refused: 1 % of known touches need 99") == 1
    saved = folder / "few" / "network.json"
    table = json.loads(saved.read_text())
    table["extra"]["refusal"]["whole"] = 1.0
    saved.write_text(json.dumps(table))
    nt.infer(folder / "few", folder / "spikes.h5")
    assert "refused" not in capsys.readouterr().err


def test_numbers_are_not_refused(made):
    trains = hdf5.load_spikes(made[0] / "spikes.h5")
    with pytest.raises(InputError, match="a target is of numbers"):
        tasks.check_refuse(trains, tasks.Task(refuse=0.1, target=("force_N",)))


@pytest.mark.parametrize("least", [0.0, 1.5])
def test_formats_without_decisions_keep_the_least_lead_and_say_so(least):
    network = nt.RSNN(2, 3, hidden=4, sampling_rate_Hz=1000.0)
    rule = ExitRule(7, from_first_spike=True, least_lead=least)
    rows = chips.compare(network, None, rule, "loihi2")
    assert ("none of these" in set(rows["what"])) == (least > 0)
    pytest.importorskip("nir")
    made = graph.of(network, rule=rule)
    said = note.of(made, "graph")
    assert said is not None
    assert said.rule == rule
    assert any("refuse a class that leads by less than 1.5" in line for line in said.outside) == (least > 0)
    assert ("least_lead" in json.dumps(made.metadata)) == (least > 0)


def test_a_class_called_none_cannot_be_refused_for(made):
    folder, _, _ = made
    trains = hdf5.load_spikes(folder / "spikes.h5")
    other = replace(trains, conditions=trains.conditions.assign(label=["none", "silk"] * 30))
    hdf5.save_spikes(other, folder / "none.h5")
    with pytest.raises(InputError, match="'none' is a class already"):
        nt.train(folder / "none.h5", folder / "not", learn=nt.Learn(refuse=0.1))


def test_live_counts_refused_windows_beside_nothing(made):
    folder, _, _ = made
    chain = chain_of(folder / "refusing")
    decided = Stream(chain).push(hdf5.load_recordings(folder / "skin.h5").signals[0])[0]
    scores = Scores(chain.classes, refuses=True)
    scores.label("silk", 0)
    others = {"heard": False}, {"index": 2, "label": "none"}, {"index": 1, "label": "silk"}
    rows = scores.take(chain, [decided._replace(**{"heard": True, **change}) for change in others])
    assert [row.is_right for row in rows] == [False, False, True]
    assert scores.confusion.tolist() == [[0, 0, 0, 0], [0, 1, 1, 1]]


def test_a_report_of_another_side_has_the_columns_too():
    spikes = np.array([1, 1, 1])
    operations = synops.synops(spikes, spikes, n_hidden=2, n_readout=2, recurrent=False)
    table = synops.table_of(operations, ["a", "b", "a"], ["a", "none", "a"], spikes, spikes, spikes)
    table.insert(1, "side", ["training", "training", "test"])
    called_none = table.assign(label=["a", "none", "a"])
    assert "answered" not in synops.summary(called_none)
    means = synops.summary(table)
    assert means[means.label == "all"]["answered"].tolist() == [0.5, 1.0]
    assert means[means.label == "all"]["accuracy_answered"].tolist() == [1.0, 1.0]
    assert np.isnan(means[means.label == "b"]["accuracy_answered"]).all()
