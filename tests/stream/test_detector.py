"""A detector: its rule step by step and on whole recordings, its choice and its test, and the stream that is equal."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.exporters.c import proof, proving
from neurotact_parts.exporters.nir import note
from neurotact_parts.streams import detector
from neurotact_parts.streams.chain import chain_of
from neurotact_parts.streams.detector import BEGUN, COLUMNS, FALSE_ALARM, HIT, MISS, REPEAT, Heard, Standing
from neurotact_parts.streams.stream import Stream
from neurotact_parts.studies.texture import slips

import neurotact as nt
from neurotact.errors import InputError
from neurotact.files import read_json
from neurotact.networks.training import run_folder, trainer
from neurotact.networks.training.events import DetectorSpec
from neurotact.networks.training.tasks import Task

ENCODER = {"conditioning.resample_Hz": 500.0, "conditioning.baseline": "start", "sa1.gain": 10.0, "ra1.gain": 80.0,
           "sa1.t_ref_ms": 2.0, "ra1.t_ref_ms": 2.0}  # fmt: skip
SETTINGS = {"hidden": 8, "training.epochs": 12, "step_ms": 4.0}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a small detector, with its recordings in `long.h5` and their spikes in `spikes.h5`."""
    folder = tmp_path_factory.mktemp("detector")
    recordings = nt.simulate("gratings-slips", recordings=4, duration_s=9, sampling_rate_Hz=500)
    nt.save(recordings, folder / "long.h5")
    nt.save(nt.encode(recordings, "sa1-ra1-lif", ENCODER), folder / "spikes.h5")
    learn = nt.Learn(target="events", balance="classes", false_alarms_per_h=200)
    nt.train(folder / "spikes.h5", folder / "run", learn=learn, settings=SETTINGS, window=nt.Window(length_ms=240))
    return folder / "run"


VALUES = st.lists(st.lists(st.integers(0, 3), min_size=3, max_size=3), min_size=1, max_size=60)
RULES = st.builds(DetectorSpec, threshold=st.sampled_from([0.0, 1.0]), steps=st.integers(1, 4))


@given(VALUES, RULES)
@examples(200)
def test_whole_recordings_change_labels_as_step_by_step(values, rule):
    values, standing, told = np.array(values, float), Standing(), []
    for step, row in enumerate(values):
        after = standing.after(row, rule)
        if after.current != standing.current:
            told.append((step, after.current))
        standing = after
    assert [*detector.changes(values, rule)] == told


def test_a_label_begins_when_it_has_led_for_so_many_steps_by_more_than_the_threshold():
    values = np.array([[1, 2, 0], [1, 2.5, 0], [1, 2.5, 0], [1, 2.5, 0], [3, 0, 0], [1, 2.5, 0], [3, 0, 0], [3, 0, 0]])
    assert [*detector.changes(values, DetectorSpec(threshold=1, steps=2))] == [(2, 1), (7, 0)]
    assert [*detector.changes(values, DetectorSpec(threshold=0, steps=1))] == [(0, 1), (4, 0), (5, 1), (6, 0)]
    assert [*detector.changes(values, DetectorSpec(threshold=1.5, steps=1))] == [(4, 0)][:0]


def of_labels(labels, marked):
    return Heard(7, np.eye(3)[labels], 0.1, 0.1 * len(labels), marked)


def test_marks_and_detections_are_told_apart():
    labels = [1, 0, 2, 2, 0, 2, 0, 1, 1, 0, 2, 0]  # a label is in force from the end of its step on
    one = of_labels(labels, [(1, 0.0, 0.15), (2, 0.25, 0.65), (1, 0.75, 0.95), (2, 0.95, 1.05)])
    rule = DetectorSpec(threshold=0.5, steps=1)
    table = pd.DataFrame(detector.rows_of(one, rule), columns=COLUMNS)
    assert table["outcome"].tolist() == [BEGUN, HIT, REPEAT, HIT, FALSE_ALARM, MISS]
    assert np.allclose(table["delay_ms"], [math.nan, 50, math.nan, 50, math.nan, math.nan], equal_nan=True)
    assert np.allclose(table["detected_s"][:5], [0.1, 0.3, 0.6, 0.8, 1.1])
    assert np.allclose(table["ended_s"][:5], [0.2, 0.5, 0.7, 1.0, 1.2])
    found = detector.tally([one], rule)
    assert (len(found.delays_ms), found.missed, found.false_alarms) == (2, 1, 1)
    assert (found.per_h, found.share, found.delay_ms) == pytest.approx((1 / (1.2 / 3600), 2 / 3, 50))


WINDOW = nt.Window(length_ms=3200)
STEPS = 1, 2, 4, 8, 16


def of_noise(rng, n, seconds=40):
    """Recordings of noise, in which a slip of 2 s begins every 3.8 s, steps of 100 ms."""
    values = rng.standard_normal((n, 10 * seconds, 3))
    starts = range(20, 10 * seconds - 20, 38)
    for start in starts:
        values[:, start : start + 20, 2] += np.linspace(0, 5, 20)
    marked = [(2, start / 10, start / 10 + 2) for start in starts]
    return [Heard(i, part, 0.1, float(seconds), marked) for i, part in enumerate(values)]


def ruled(recordings, most):
    return detector.rule_for(recordings, Task(target=("events",), false_alarms_per_h=most, window=WINDOW))


def tried(recordings):
    """Every rule, what it comes to, and whether the line through counts allows one false alarm, or so many more."""
    least, hours = detector.thresholds(recordings), sum(one.lasts_s for one in recordings) / 3600
    for steps in STEPS:
        rules = [DetectorSpec(threshold=one, steps=steps) for one in least]
        found = [detector.tally(recordings, rule) for rule in rules]
        for rule, one in zip(rules, found, strict=True):
            counts = [each.false_alarms for each in found]
            yield (
                one,
                lambda most, rule=rule, counts=counts: (
                    rule.threshold >= detector.rare_from(least, counts, most * hours)
                ),
            )


def test_the_rule_for_so_many_false_alarms_has_most_hits_and_the_least_delay():
    recordings, missed = of_noise(np.random.default_rng(0), 2), []
    for most in (0.0, 100.0, 2000.0):
        rule = ruled(recordings, most)
        found = detector.tally(recordings, rule)
        assert found.per_h <= most
        assert (rule.heard_s, rule.false_alarms) == (80.0, found.false_alarms)
        missed.append(found.missed)
        for other, is_rare in tried(recordings):
            if other.per_h <= most and is_rare(most):
                assert (other.missed, other.delays_ms.sum()) >= (found.missed, found.delays_ms.sum())
    assert missed == sorted(missed, reverse=True)
    wrong = [one._replace(values=np.tile(np.eye(3)[[1, 0]], (200, 1))) for one in recordings]  # false alarms all along
    assert detector.tally(wrong, ruled(wrong, 0.0)).per_h == min(other.per_h for other, _ in tried(wrong))


def test_many_recordings_have_as_many_false_alarms_as_were_allowed_on_few():
    rng, most, rates, lucky = np.random.default_rng(1), 30.0, [], []
    other = of_noise(rng, 12)
    for _ in range(12):
        few = of_noise(rng, 3)
        rates.append(detector.tally(other, ruled(few, most)).per_h)
        allowed = [(one.missed, one.delays_ms.sum(), i) for i, (one, _) in enumerate(tried(few)) if one.per_h <= most]
        steps, least = divmod(min(allowed)[-1], len(detector.thresholds(few)))
        rule = DetectorSpec(threshold=detector.thresholds(few)[least], steps=STEPS[steps])
        lucky.append(detector.tally(other, rule).per_h)
    assert np.mean(rates) < 1.25 * most
    assert np.mean(lucky) > 1.25 * np.mean(rates)


@given(st.lists(st.integers(0, 400), min_size=2, max_size=12), st.floats(0, 30))
@example([6, 2, 0, 5], 2.0)  # a line that rises
def test_where_false_alarms_are_rare_is_among_the_thresholds_and_rises_as_fewer_are_allowed(counts, most):
    least = [*np.linspace(0, 2, len(counts))]
    found, fewer = (detector.rare_from(least, counts, each) for each in (most, most / 2))
    assert found <= fewer <= least[-1]
    assert detector.rare_from(least, counts, 0.0) == detector.rare_from(least, counts, 1.0)
    assert detector.rare_from([0.0, 1.0, 2.0, 3.0], [80, 40, 20, 10], 40.0) == pytest.approx(1.0)
    assert detector.rare_from([0.0, 1.0, 2.0, 3.0], [8, 4, 1, 1], 2.0) == pytest.approx(2.0)
    assert detector.rare_from([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [2, 16, 8, 4, 2, 0, 0], 0.1) == pytest.approx(5.0)


def test_parts_that_are_left_out_hold_each_training_recording_once_and_whole_groups(run):
    restored = run_folder.restore(run)
    trains, task = run_folder.load_spikes_of(restored), restored.task
    split = run_folder.trials_of(trains, task)
    short = [Heard(0, np.zeros((1, 3)), 0.1, 1.0, [])]
    grouped = task.model_copy(update={"split": task.split.model_copy(update={"group": ("recording",)})})
    for each in (task, grouped):
        parts = [*detector.turns(trains, split, each, short)]
        assert len(parts) == detector.TURNS
        assert sorted(np.concatenate([part.validation for part in parts])) == split.train.tolist()
        for part in parts:
            assert sorted([*part.train, *part.validation]) == split.train.tolist()
            assert part.test.tolist() == split.test.tolist()
            sides = [{*trains.conditions["recording"].iloc[side]} for side in part[:2]]
            assert bool(sides[0] & sides[1]) == (each is task)
    # with 200 allowed an hour, 54 s hold three
    assert [len([*detector.turns(trains, split, task, [short[0]._replace(lasts_s=s)])]) for s in (53.9, 54.1)] == [3, 0]
    alone = split._replace(train=split.train[:1])
    assert [*detector.turns(trains, alone, task, short)] == []
    assert trains.marks is not None
    one = replace(trains, marks=trains.marks[trains.marks["trial"] == split.train[0]])
    assert len([*detector.turns(one, split, task, short)]) == detector.TURNS - 1  # without it there is one label


def test_a_threshold_is_chosen_on_recordings_that_its_networks_were_not_trained_on(run, monkeypatch):
    restored = run_folder.restore(run)
    trains, task, spec = run_folder.load_spikes_of(restored), restored.task, restored.network.spec
    split, listened, trained = run_folder.trials_of(trains, task), [], []
    ours, sides_of = detector.heard, trainer.sides_of

    def heard(network, *given):
        listened.append((network, [*given[1]]))
        return ours(network, *given)

    def sides(trains, task, turn=None):
        trained.append(turn)
        return sides_of(trains, task, turn)

    monkeypatch.setattr(detector, "heard", heard)
    monkeypatch.setattr(trainer, "sides_of", sides)
    short = spec.model_copy(update={"training": spec.training.model_copy(update={"epochs": 1})})
    fitted, _ = trainer.fit(trains, short, task, (0, 1))
    assert listened[0] == (fitted.network, split.validation.tolist())
    assert len({id(network) for network, _ in listened}) == 1 + detector.TURNS
    for turn, (_, trials) in zip(trained[1:], listened[1:], strict=True):
        assert turn.validation.tolist() == trials
        assert not {*turn.train} & {*trials, *split.validation, *split.test}
    assert fitted.detector is not None
    every = np.concatenate([split.train, split.validation])
    assert fitted.detector.heard_s == pytest.approx(trains.trial_steps[every].sum() / trains.sampling_rate_Hz)


def test_the_results_are_those_of_the_events_that_are_listed(run):
    row, table = nt.result(run), pd.read_csv(run / "events.csv")
    counts = table["outcome"].value_counts()
    for name, outcome in (("hits", HIT), ("misses", MISS), ("false_alarms", FALSE_ALARM)):
        assert row[name] == counts.get(outcome, 0)
    assert row["events_test"] == row["hits"] + row["misses"] > 0
    assert row["hits"] > 0
    assert row["delay_ms_low"] <= row["delay_ms"] <= row["delay_ms_high"]
    assert row["hit_share_low"] <= row["hit_share"] <= row["hit_share_high"]
    assert row["false_alarms_per_h_low"] <= row["false_alarms_per_h"] <= row["false_alarms_per_h_high"]
    assert row["false_alarms_per_h"] == pytest.approx(row["false_alarms"] / row["tested_s"] * 3600)
    hits = table[table["outcome"] == HIT]
    assert hits["delay_ms"].mean() == pytest.approx(row["delay_ms"])
    assert np.allclose(1e3 * (hits["detected_s"] - hits["start_s"]), hits["delay_ms"])
    known = nt.load(run.parent / "long.h5").marks
    listed = table.dropna(subset="start_s")
    found = pd.merge(listed, known, on=["trial", "label"], suffixes=("", "_known"))
    assert (np.isclose(found["start_s"], found["start_s_known"])).sum() >= len(
        listed.drop_duplicates(["trial", "start_s"])
    )
    curve = pd.read_csv(run / "operating_curve.csv")
    assert curve["threshold"].is_monotonic_increasing
    assert {*curve["steps"]} == {row["detector_steps"]}


def test_a_run_keeps_the_rule_and_what_it_was_chosen_on(run):
    restored, row = run_folder.restore(run), nt.result(run)
    assert restored.detector is not None
    assert (row["detector_threshold"], row["detector_steps"]) == (restored.detector.threshold, restored.detector.steps)
    assert (row["chosen_on_s"], row["chosen_with_false_alarms"]) == (
        restored.detector.heard_s, restored.detector.false_alarms
    )  # fmt: skip
    assert row["chosen_with_false_alarms"] <= 200 * row["chosen_on_s"] / 3600
    assert restored.task.false_alarms_per_h == 200
    assert restored.classes == ("none", "contact", "slip")


def test_a_graph_of_nir_says_that_the_rule_stays_outside(run, caplog):
    pytest.importorskip("nir")
    rule = run_folder.restore(run).detector
    assert rule is not None
    said = rf"events in time: .* by more than {re.escape(f'{rule.threshold:.6g}')} in {rule.steps} step"
    written = note.of(nt.to_nir(run), "graph")
    assert written is not None
    assert [bool(re.match(said, line)) for line in written.outside].count(True) == 1
    assert re.search(said, caplog.text)


def test_results_in_words_tell_what_a_threshold_was_chosen_on_and_the_operating_curve(run):
    recordings = of_noise(np.random.default_rng(2), 3)
    rule = DetectorSpec(threshold=0.5, steps=1, heard_s=900.0, false_alarms=2)
    trains = run_folder.load_spikes_of(run_folder.restore(run))
    row, tables, lines = detector.judged(trains, recordings, rule)
    low, high = detector.rates_of(2, 0.25)
    assert (
        f"chosen on 900 s without training, with 2 false alarms there (95 % interval {low:.3g} to {high:.3g}"
        in lines[2]
    )
    curve, points = tables["operating_curve.csv"], re.findall(r"(\d+)% at ([\d.,]+) \((\d+) ms\)", lines[3])
    assert len(points) > 2
    for share, rate, delay in points:
        enough = curve[curve["hit_share"] >= int(share) / 100]
        best = enough[enough["false_alarms_per_h"] == enough["false_alarms_per_h"].min()]
        assert float(rate.replace(",", "")) == pytest.approx(best["false_alarms_per_h"].iloc[0], rel=0.01)
        assert float(delay) == pytest.approx(best["delay_ms"].iloc[0], abs=0.51)
    unknown = DetectorSpec(threshold=0.5, steps=1)
    assert not [line for line in detector.judged(trains, recordings, unknown)[2] if line.startswith("threshold")]
    assert row["chosen_with_false_alarms"] == 2


def test_infer_lists_the_events_of_each_side_and_of_other_recordings(run):
    table = nt.infer(run, run.parent / "spikes.h5")
    tested = table[table["side"] == "test"].drop(columns="side").reset_index(drop=True)
    pd.testing.assert_frame_equal(tested, pd.read_csv(run / "events.csv"), check_dtype=False)
    only = nt.infer(run, run.parent / "spikes.h5", test_only=True)
    assert len(only) == len(tested)
    other = nt.simulate("gratings-slips", recordings=1, duration_s=12, sampling_rate_Hz=500, seed=5)
    strange = nt.infer(run, nt.encode(other, "sa1-ra1-lif", ENCODER))
    assert {*strange["side"]} == {"unseen"}
    assert strange["detected_s"].max() > 8  # it is not cut
    unmarked = nt.Recordings(other.signals, 500.0, "mV", ["session"])
    found = nt.infer(run, nt.encode(unmarked, "sa1-ra1-lif", ENCODER))
    assert found["detected_s"].tolist() == strange["detected_s"].dropna().tolist()
    assert {*found["outcome"]} == {""}


def offline(run, recordings):
    """The detector's chain, and its values on a recording, `(step, label)`."""
    restored, trains = run_folder.restore(run), nt.encode(recordings, "sa1-ra1-lif", ENCODER)
    return restored, detector.values_of(restored.network, trains, 0)


@pytest.mark.parametrize("block", [1, 7, 10_000])
def test_a_stream_equals_whole_recordings_value_for_value(run, block):
    recordings = nt.simulate("gratings-slips", recordings=1, duration_s=6, sampling_rate_Hz=500, seed=3)
    restored, values = offline(run, recordings)
    assert restored.detector is not None
    stream, decisions, found = Stream(run), [], []
    for first in range(0, 3000, block):
        decisions += stream.push(recordings.signals[0][first : first + block])
        (state,) = stream.state().windows
        if block == 1 and state.steps % restored.network.steps_per_bin == 0 and state.steps:
            found.append(state.leader.counts[0].numpy())
    if found:
        assert (np.array(found) == values[: len(found)]).all()
        assert len(values) - len(found) <= 1
    decisions += stream.finish()
    expected = [*detector.changes(values, restored.detector)]
    assert expected
    step_s = restored.network.steps_per_bin / 500.0
    assert [(decision.index, decision.label) for decision in decisions] == [
        (i, restored.classes[i]) for _, i in expected
    ]
    assert np.allclose([decision.time_s for decision in decisions], [(step + 1) * step_s for step, _ in expected])
    assert [decision.window for decision in decisions] == [*range(len(expected))]
    assert sum(decision.ms for decision in decisions) == pytest.approx(1e3 * decisions[-1].time_s)
    assert stream.tally.unfinished == 0
    assert stream.tally.decisions == len(expected)


def test_the_delay_in_a_stream_is_the_one_that_is_reported(run):
    recordings = nt.simulate("gratings-slips", recordings=1, duration_s=9, sampling_rate_Hz=500, seed=4)
    nt.save(recordings, path := run.parent / "other.h5", force=True)
    told = [decision for decision in nt.stream(run, path).decisions if decision.label != "none"]
    table = nt.infer(run, nt.encode(recordings, "sa1-ra1-lif", ENCODER)).dropna(subset="detected_s")
    assert [decision.time_s for decision in told] == pytest.approx(table["detected_s"].tolist())
    assert [decision.label for decision in told] == table["label"].tolist()
    hits = table[table["outcome"] == HIT]
    assert len(hits)
    delays = [
        1e3 * (told[place].time_s - table["start_s"].iloc[place]) for place in np.flatnonzero(table["outcome"] == HIT)
    ]
    assert delays == pytest.approx(hits["delay_ms"].tolist())


def test_a_saved_stream_of_a_detector_goes_on(run, tmp_path):
    recordings = nt.simulate("gratings-slips", recordings=1, duration_s=6, sampling_rate_Hz=500, seed=3)
    signal, whole = recordings.signals[0], Stream(run)
    expected = whole.push(signal)
    for cut in (777, 1500, 2222):
        first = Stream(run)
        decisions = first.push(signal[:cut])
        first.save(tmp_path / f"{cut}.state")
        second = Stream(run)
        second.load(tmp_path / f"{cut}.state")
        assert decisions + second.push(signal[cut:]) == expected
    other = chain_of(run)._replace(detector=DetectorSpec(threshold=9, steps=1))
    with pytest.raises(InputError, match="another chain"):
        Stream(other).load(tmp_path / "777.state")


def test_spikes_and_operations_are_counted_from_one_event_to_the_next(run):
    recordings = nt.simulate("gratings-slips", recordings=1, duration_s=6, sampling_rate_Hz=500, seed=3)
    restored, values = offline(run, recordings)
    decisions = Stream(run).push(recordings.signals[0])
    trains = nt.encode(recordings, "sa1-ra1-lif", ENCODER)
    end = round(decisions[-1].time_s * 500)
    window = nt.windows(trains, window=nt.Window(length_ms=2.0 * end, per_trial=1)).X
    inference = restored.network.infer(torch.from_numpy(np.asarray(window)))
    assert sum(decision.input_spikes for decision in decisions) == int(inference.input_spikes)
    assert sum(decision.hidden_spikes for decision in decisions) == int(inference.hidden_spikes)
    assert len(values) >= end // restored.network.steps_per_bin


def test_a_detector_is_refused_where_windows_are_decided(run, tmp_path):
    S = nt.Streamed
    for streamed in (S(hop_ms=20), S(contact=True), S(length_ms=50), S(full_window=True), S(start_ms=1)):
        with pytest.raises(InputError, match="runs on without windows"):
            chain_of(run, streamed)
    with pytest.raises(InputError, match=r"events in time: C in integers .* export it in float32"):
        nt.export(run, tmp_path / "c", "c")
    with pytest.raises(InputError, match=r"detects events, and .* needs classes"):
        run_folder.restore(run).of_classes("the bill in C")


def test_c_is_proven_on_whole_test_recordings(run, tmp_path, monkeypatch):
    """On those of which a part is a trial of the test."""
    if proof.missing("cc"):
        pytest.skip("there is no C compiler")
    monkeypatch.setattr(proving.boards, "BOARDS", {})
    said = []
    where = {"recordings": run.parent / "long.h5"}
    made = nt.export_c(run, tmp_path, variant="float", prove=2, tell=said.append, **where)
    rows = said[-1].set_index("what")["value"]
    assert rows["this machine, sanitizers"] == "every spike and decision equal"
    restored = run_folder.restore(run)
    assert restored.task.parts > 1
    trials = proving.trials_of(run, made.chain, None, 2, **where)
    assert {len(trial) for trial in trials.given} == {4500}
    assert rows["changes of the label in force"] == sum(len(trial.decisions) for trial in trials.expected) > 0
    assert not [name for name in rows.index if "accuracy" in name]


def test_commands_tell_of_events(run, capsys, monkeypatch):
    from neurotact.cli import main

    monkeypatch.setattr("sys.argv", ["neurotact", "infer", str(run), str(run.parent / "spikes.h5")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (0, None)
    out = capsys.readouterr().out
    assert "test" in out
    assert "hit" in out
    result = read_json(run / "result.json")
    assert json.dumps(result)


def test_slips_have_the_signals_of_slides_and_their_onsets():
    spec = slips.SlipsSpec(recordings=1)
    finger, rng = spec.finger, np.random.default_rng(1)
    for pitch in (4.0, 1.0):
        slide = slips.Slide(pitch, 12.0, 9.0, 20.0, np.array(finger.taxel_gains))
        sliding = slips.simulator.record(finger.model_copy(update={"duration_s": 4.0}), slide, rng)
        signal = slips.record(spec, [slips.Touch(0.5, 1.5, 6.5, 7.0, slide)], 16_000, rng)
        assert signal[:990].std(axis=0) == pytest.approx(finger.noise_mV_rms, rel=0.1)
        assert signal[5000:12_000].std(axis=0) == pytest.approx(sliding.std(axis=0), rel=0.15)
        loud = np.abs(finger.taxel_gains) > 0.5
        assert (np.abs(signal[1000:1300]).max(axis=0)[loud].max() > 5 * np.abs(signal[:990]).max()).all()
        assert signal[2600:3000].std(axis=0)[loud].max() < 0.25 * sliding.std(axis=0)[loud].min()


def test_slips_of_a_number_depend_on_it_alone():
    few, more = (nt.simulate("gratings-slips", recordings=n, duration_s=6, sampling_rate_Hz=500) for n in (1, 2))
    assert (few.signals[0] == more.signals[0]).all()
    assert (few.signals[0] != more.signals[1]).any()
    assert more.marks is not None
    assert {*more.marks["label"]} == {"contact", "slip"}
