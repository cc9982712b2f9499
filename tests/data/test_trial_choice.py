"""Trials chosen by their conditions: the same from every command and call, before anything is learned of the others."""

import json
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from as_specs import of_table
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.exporters import trials as export
from typer.testing import CliRunner

import neurotact as nt
from neurotact import workers
from neurotact.cli import app
from neurotact.data.dataset import load_recordings
from neurotact.data.splits import SplitSpec, split_conditions
from neurotact.data.trial_choice import LEAST_OF_CLASS, TrialChoice, chosen_trials, evenly_of, fewer_trials
from neurotact.errors import InputError
from neurotact.networks.training import run_folder
from neurotact.spec import parse_choice
from neurotact.studies import loading

QUICK = {"hidden": 4, "training.epochs": 1}


def touches(n=24, n_samples=60, seed=0) -> nt.Recordings:
    """Trials of three classes at two speeds, the classes told apart by the strength of a vibration."""
    rng = np.random.default_rng(seed)
    table = pd.DataFrame(
        {"label": ["felt", "silk", "rest"] * (n // 3), "speed": [300] * (n // 2) + [450] * (n // 2),
         "subject": [f"s{i % 4}" for i in range(n)]}
    )  # fmt: skip
    strength = table["label"].map({"felt": 20.0, "silk": 60.0, "rest": 1.0}).to_numpy()
    signals = strength[:, None, None] * rng.normal(size=(n, n_samples, 2))
    return nt.Recordings(signals, 1000.0, "mV", table, source="t.h5")


tables = st.lists(
    st.tuples(st.sampled_from("ab"), st.sampled_from([1, 2, 3]), st.booleans()), min_size=1, max_size=12
).map(lambda rows: pd.DataFrame(rows, columns=["label", "speed", "dry"]))


@given(tables, st.data())
def test_what_is_kept_by_a_condition_and_what_is_left_out_by_it_part_the_trials(table, data):
    column = data.draw(st.sampled_from([*table]))
    known = table[column].drop_duplicates().tolist()
    wanted = data.draw(st.lists(st.sampled_from(known), min_size=1, unique=True))
    kept = TrialChoice.of({column: wanted}).keeps(table, "t")
    assert kept.tolist() == [value in wanted for value in table[column].tolist()]
    if kept.all():
        with pytest.raises(InputError, match=r"t: no trial is left of \d+ \(without "):
            TrialChoice.of(None, {column: wanted}).keeps(table, "t")
        return
    np.testing.assert_array_equal(TrialChoice.of(None, {column: wanted}).keeps(table, "t"), ~kept)
    where, leave_out = parse_choice([f"{column}!={','.join(map(_typed, wanted))}"], [], "label")
    np.testing.assert_array_equal(TrialChoice.of(where, leave_out).keeps(table, "t"), ~kept)


def _typed(value):
    return json.dumps(value) if isinstance(value, bool) else str(value)


@given(tables, st.data())
def test_several_conditions_are_all_wanted_and_any_of_them_leaves_out(table, data):
    row = data.draw(st.sampled_from(range(len(table))))
    both = {name: table[name].tolist()[row] for name in ("label", "speed")}
    each = [(table[name] == value).to_numpy() for name, value in both.items()]
    np.testing.assert_array_equal(TrialChoice.of(both).keeps(table, "t"), each[0] & each[1])
    if not (each[0] | each[1]).all():
        np.testing.assert_array_equal(TrialChoice.of(None, both).keeps(table, "t"), ~(each[0] | each[1]))


def test_a_choice_made_in_two_parts_is_the_choice():
    table = touches().conditions
    choice = TrialChoice.of({"speed": 300, "subject": ["s0", "s1"]}, {"label": "rest"})
    among, beyond = choice.among(["label", "speed"]), choice.beyond(["label", "speed"])
    assert (among.where, beyond.where, among.leave_out, beyond.leave_out) == (
        {"speed": 300}, {"subject": ["s0", "s1"]}, {"label": "rest"}, {},
    )  # fmt: skip
    first = among.keeps(table, "t")
    second = beyond.keeps(table[first], "t")
    assert np.flatnonzero(first)[second].tolist() == np.flatnonzero(choice.keeps(table, "t")).tolist()


@pytest.mark.parametrize(
    ("where", "leave_out", "message"),
    [
        (["sped=300"], [], r"t\.h5: `where`: there is no condition 'sped'; did you mean 'speed'\?"),
        (["speed=300,310"], [], r"t\.h5: `where`: no trial has speed = 310; speed is 300, 450"),
        ([], ["label=sillk"], r"`leave_out`: no trial has label = sillk; did you mean 'silk'\? label is felt, "),
        ([], ["rst"], r"`leave_out`: no trial has label = rst; did you mean 'rest'\?"),
        (["speed=300"], ["speed=300"], r"no trial is left of 24 \(speed = 300 without speed = 300\)"),
        (["speed"], [], "`where` speed: must read CONDITION=VALUE"),
        (["speed>=300"], [], "`where` speed>=300: must read CONDITION=VALUE, as in speed=450 or speed=300,450"),
        (["speed!="], [], "`where` speed=: must read CONDITION=VALUE"),
    ],
)  # fmt: skip
def test_what_no_trial_has_is_refused_with_what_they_have(where, leave_out, message):
    with pytest.raises(InputError, match=message):
        chosen_trials(touches(), TrialChoice.of(*parse_choice(where, leave_out, "label")), "t.h5")


def test_python_refuses_another_kind_of_choice():
    for where, leave_out, message in (
        ("speed=300", None, "where: must map conditions to values"),
        ({"speed": []}, None, "where, leave_out: speed must be a value or a list"),
        ({3: 1}, None, "where: must map conditions"), (None, 3, "leave_out: must map conditions"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            nt.encode(touches(), where=where, leave_out=leave_out)


def test_how_many_trials_are_kept_is_said_once(caplog):
    found = nt.encode(touches(), where={"speed": 300}, leave_out="rest")
    assert caplog.messages == ["t.h5: 8 of 24 trials are kept: speed = 300 without label = rest"]
    assert found.classes == ("felt", "silk")
    assert found.conditions["speed"].tolist() == [300] * 8
    caplog.clear()
    assert len(nt.encode(touches())) == 24
    assert not caplog.messages


# --- every command and call -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with recordings, their spikes, and the spikes of the chosen trials alone."""
    folder = tmp_path_factory.mktemp("choice")
    nt.save(touches(60), folder / "touches.h5")
    stored = nt.load(folder / "touches.h5")
    nt.save(nt.encode(stored), folder / "spikes.h5")
    kept = ((stored.conditions["speed"] == 450) & (stored.conditions["label"] != "rest")).to_numpy()
    nt.save(stored.select(kept), folder / "some.h5")
    nt.save(nt.encode(stored.select(kept)), folder / "some-spikes.h5")
    return folder


WORDS = ["--where", "speed=450", "--leave-out", "rest"]
CHOICE = {"where": {"speed": 450}, "leave_out": "rest"}


def done(*words):
    found = CliRunner().invoke(app, list(map(str, words)))
    assert found.exit_code == 0, found.exception
    return found.output


def test_encode_and_calibrate_know_nothing_of_the_other_trials(place, tmp_path):
    done("encode", place / "touches.h5", *WORDS, "-o", tmp_path / "spikes.h5")
    due, found = nt.load(place / "some-spikes.h5"), nt.load(tmp_path / "spikes.h5")
    assert [each.tolist() for each in found.steps] == [each.tolist() for each in due.steps]
    pd.testing.assert_frame_equal(found.conditions, due.conditions)
    start = ("--set", "conditioning.baseline=start")
    done("calibrate", place / "touches.h5", *WORDS, *start, "-o", tmp_path / "mine.toml")
    mine = nt.calibrate(nt.load(place / "some.h5"), settings={"conditioning.baseline": "start"})
    assert nt.AfferentSpec.model_validate(loading.specs.read(tmp_path / "mine.toml")) == mine
    every = nt.calibrate(nt.load(place / "touches.h5"), settings={"conditioning.baseline": "start"}, **CHOICE)
    assert every == mine


def test_a_network_is_trained_and_decides_as_if_the_others_were_not_in_the_file(place, tmp_path):
    mine = nt.train(place / "spikes.h5", tmp_path / "mine", "rsnn", QUICK, **CHOICE)
    alone = nt.train(place / "some-spikes.h5", tmp_path / "alone", "rsnn", QUICK)
    assert mine["trials"] == alone["trials"]
    weights = [(tmp_path / name / "weights.safetensors").read_bytes() for name in ("mine", "alone")]
    assert weights[0] == weights[1]
    changes = [word for key, value in QUICK.items() for word in ("--set", f"{key}={value}")]
    done("train", place / "spikes.h5", "--network", "rsnn", *changes, *WORDS, "-o", tmp_path / "theirs")
    assert (tmp_path / "theirs" / "weights.safetensors").read_bytes() == weights[0]
    with pytest.raises(InputError, match="was started with "):
        nt.train(place / "spikes.h5", tmp_path / "mine", "rsnn", QUICK, resume=True, where={"speed": 450})
    restored = run_folder.restore(tmp_path / "mine")
    assert restored.classes == ("felt", "silk")
    assert len(run_folder.load_spikes_of(restored)) == 20
    done("infer", tmp_path / "mine", place / "spikes.h5", *WORDS, "-o", tmp_path / "found.csv")
    found = pd.read_csv(tmp_path / "found.csv")
    pd.testing.assert_frame_equal(found, nt.infer(tmp_path / "mine", place / "some-spikes.h5"), check_dtype=False)
    pd.testing.assert_frame_equal(found, nt.infer(tmp_path / "mine", place / "spikes.h5", **CHOICE), check_dtype=False)
    with pytest.raises(InputError, match="class 'rest' is not a class of the network"):
        nt.infer(tmp_path / "mine", place / "spikes.h5", where={"speed": 450})


@contextmanager
def in_this_process(_):
    """A pool of workers without a process: starting one takes seconds."""
    yield map


def test_a_search_uses_the_chosen_trials_in_its_workers_too(place, tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(workers, "pool", in_this_process)
    space = {"hidden": {"_type": "choice", "_value": [3, 4]}}
    asked = {"search": nt.Search(space=space, trials=2), "workers": 1, "settings": {"training.epochs": 1}}
    mine = nt.tune(place / "spikes.h5", tmp_path / "mine", "rsnn", **asked, **CHOICE)
    assert [line for line in caplog.messages if "trials are kept" in line] == [
        f"{place / 'spikes.h5'}: 20 of 60 trials are kept: speed = 450 without label = rest"
    ]
    alone = nt.tune(place / "some-spikes.h5", tmp_path / "alone", "rsnn", **asked)
    assert mine["hidden"].tolist() == alone["hidden"].tolist()
    assert run_folder.restore(tmp_path / "mine" / "best").classes == ("felt", "silk")


def test_recordings_are_found_again_by_their_content(place, tmp_path):
    """An export takes the ranges of its samples from the recordings, of which the spikes are a choice."""
    nt.train(place / "spikes.h5", tmp_path / "run", "rsnn", QUICK, **CHOICE)
    restored = run_folder.restore(tmp_path / "run")
    found = export.recorded(restored, place / "touches.h5")
    due = export.recorded(restored, place / "some.h5")
    for mine, its in zip((*found.training, *found.test), (*due.training, *due.test), strict=True):
        np.testing.assert_array_equal(mine, its)
    nt.save(touches(60, seed=5), tmp_path / "others.h5")
    with pytest.raises(InputError, match=r"does not hold the recordings that .*spikes\.h5 was encoded from"):
        export.recorded(restored, tmp_path / "others.h5")
    spikes = place / "some-spikes.h5"
    done("raster", spikes, "--recordings", place / "touches.h5", "--trial", 3, "-o", tmp_path / "a.png")
    with pytest.raises(InputError, match="does not hold the recordings that"):
        CliRunner().invoke(
            app, ["raster", str(spikes), "--recordings", str(tmp_path / "others.h5"), "-o", str(tmp_path / "b.png")],
            catch_exceptions=False,
        )  # fmt: skip


@examples(40)
@given(
    sizes=st.lists(st.lists(st.integers(1, 40), min_size=2, max_size=2), min_size=1, max_size=4),
    n=st.integers(2, 200),
    seed=st.integers(0, 9),
)
def test_fewer_trials_keep_the_share_of_each_class_and_condition(sizes, n, seed):
    rows = [(label, speed, i) for label, each in enumerate(sizes) for speed, k in enumerate(each) for i in range(k)]
    table = pd.DataFrame(rows, columns=["label", "speed", "file"]).sample(frac=1, random_state=seed)
    table = table.reset_index(drop=True)
    kept = evenly_of(table, n)
    assert kept.tolist() == sorted(set(kept.tolist()))
    if n >= len(table):
        assert len(kept) == len(table)
        return
    assert n - len(sizes) <= len(kept) <= n
    total, left = table["label"].value_counts(), table.iloc[kept]["label"].value_counts()
    for label, size in total.items():
        if n >= len(sizes) * LEAST_OF_CLASS:
            assert left[label] >= min(size, LEAST_OF_CLASS)
        both = table[table["label"] == label]["speed"].value_counts()
        of_label = table.iloc[kept].query("label == @label")["speed"].value_counts()
        for speed, count in both.items():
            assert abs(of_label.get(speed, 0) - left.get(label, 0) * count / size) <= 1


def test_no_value_of_a_condition_is_passed_over_again_and_again():
    """With as many subjects as lie between two trials of an even choice, it was the same one in every speed."""
    rows = [(label, speed, subject, n)
            for label in ("felt", "silk") for speed in range(4) for subject in range(25) for n in range(4)]  # fmt: skip
    table = pd.DataFrame(rows, columns=["label", "speed", "subject", "n"])
    kept = table.iloc[evenly_of(table, 32)]
    assert kept.groupby(["label", "speed"]).size().tolist() == [4] * 8
    assert kept["subject"].nunique() >= 15


@pytest.mark.parametrize(("sizes", "least"), [((20, 20), 6), ((20, 20, 20, 20), 12), ((3, 300), 6), ((2, 40), 5)])
def test_too_few_trials_of_many_are_refused_with_the_least_that_work(sizes, least):
    conditions = pd.DataFrame({"label": np.repeat([*"abcd"][: len(sizes)], sizes)})
    many = nt.Recordings([np.zeros((9, 1)) for _ in conditions.index], 1000.0, "mV", conditions)
    said = f"dataset.at_most: {least - 1} trials of {len(sizes)} classes are too few .* give at least {least} "
    with pytest.raises(InputError, match=said):
        fewer_trials(many, least - 1)
    kept = fewer_trials(many, least).conditions["label"].value_counts()
    assert sorted(kept) == sorted(min(size, 3) for size in sizes)
    if min(kept) == 3:
        split_conditions(fewer_trials(many, least).conditions, (), SplitSpec())  # has every class on every side


def test_a_study_of_too_few_trials_names_the_key_that_leaves_them(place):
    with pytest.raises(InputError, match=r"^dataset\.at_most: 8 trials of 3 classes .* give at least 9 "):
        loading.resolve("own-recordings", {"dataset.at_most": 8}, data=place / "touches.h5")
    nine = loading.resolve("own-recordings", {"dataset.at_most": 9}, data=place / "touches.h5")
    assert len(load_recordings(nine.dataset)) == 9


def test_a_first_look_at_many_trials_takes_some_and_says_so(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 20, "speed": np.repeat([1, 2], 20)})
    path = tmp_path / "many.h5"
    nt.save(nt.Recordings([rng.normal(size=(60, 2)) for _ in range(40)], 1000.0, "mV", conditions), path)
    quick = loading.resolve("own-recordings", {"dataset.at_most": 24}, quick=True, data=path)
    said = "Trials: 24 of 40, evenly spaced within each class and condition, for an answer in one sitting; all:"
    assert [note.startswith(said) for note in quick.notes].count(True) == 1
    loaded = load_recordings(quick.dataset)
    assert loaded.conditions.groupby(["label", "speed"]).size().tolist() == [6] * 4
    every = loading.resolve("own-recordings", {}, quick=True, data=path)
    assert every.dataset.at_most == 1000
    assert not any(note.startswith("Trials") for note in every.notes)
    assert len(load_recordings(every.dataset)) == 40
    assert loading.resolve("own-recordings", {}, data=path).dataset.at_most is None


def test_a_study_uses_the_chosen_trials_and_says_which(place, caplog):
    changes = loading.choice_changes(**TrialChoice.of(**CHOICE)._asdict())
    what = loading.resolve("own-recordings", changes, data=place / "touches.h5")
    assert what.notes[0] == "Trials: speed = 450 without label = rest."
    assert not caplog.messages
    found = load_recordings(what.dataset)
    assert caplog.messages == [f"{place / 'touches.h5'}: 20 of 60 trials are kept: speed = 450 without label = rest"]
    pd.testing.assert_frame_equal(found.conditions, nt.load(place / "some.h5").conditions)
    whole = loading.resolve("own-recordings", data=place / "touches.h5")
    assert "where" in what.dataset.identity()
    assert "where" not in whole.dataset.identity()


def test_a_study_of_ways_to_save_uses_the_chosen_trials(place):
    changes = loading.choice_changes(**TrialChoice.of(**CHOICE)._asdict())
    mine = loading.resolve("ways-to-save", changes, data=place / "touches.h5")
    alone = loading.resolve("ways-to-save", data=place / "some.h5")
    assert mine.notes == ("Trials: speed = 450 without label = rest.", *alone.notes)
    sets = [next(iter(each.parameters["data"]["sets"].values())) for each in (mine, alone)]
    assert sets[0]["dataset"]["content"] == sets[1]["dataset"]["content"]
    module = loading.way_study.module_of("ways_to_save")
    cell = next(iter(loading.way_study.cells(mine)))
    arrays = module.load(cell.built().data)
    assert sorted(set(arrays["condition label"].tolist())) == ["felt", "silk"]
    with pytest.raises(InputError, match=r"`where`, `leave_out`: ways-to-save\.toml makes or reads its own recordings"):
        loading.resolve("ways-to-save", changes)


@examples(10)
@given(st.lists(st.sampled_from(["felt", "silk", "rest"]), min_size=2, max_size=6), st.sampled_from([None, "rest"]))
def test_a_table_is_read_without_the_trials_that_are_left_out(tmp_path_factory, labels, leave_out):
    """Whether they are left out while the table is read or afterwards, the others are the same."""
    rows = [f"{trial},{name},{1 + trial % 2},{trial + step},{step % 3}" for trial, name in enumerate(labels)
            for step in range(4)]  # fmt: skip
    path = tmp_path_factory.mktemp("t") / "all.csv"
    path.write_text("\n".join(["trial,label,speed,left,right", *rows]))
    every = nt.read_table(path, 100, "mV")
    choice = TrialChoice.of({"speed": 1}, leave_out if leave_out in labels else None)
    keep = ((every.conditions["speed"] == 1) & (every.conditions["label"] != (leave_out or ""))).to_numpy()
    if not keep.any():
        with pytest.raises(InputError, match=r"no trial (is left of|has speed = 1)"):
            nt.read_table(path, 100, "mV", **of_table(choice._asdict()))
        return
    found = nt.read_table(path, 100, "mV", **of_table(choice._asdict()))
    pd.testing.assert_frame_equal(found.conditions, every.select(keep).conditions)


def test_every_import_takes_the_choice(tmp_path):
    kinds = {
        "folder": ["--sampling-rate-Hz", "100", "--unit", "V"], "table": ["--sampling-rate-Hz", "100", "--unit", "V"],
        "arrays": ["--sampling-rate-Hz", "100", "--unit", "V"], "events": [],
    }  # fmt: skip
    rng = np.random.default_rng(0)
    for name in ("felt", "silk"):
        (tmp_path / "folder" / name).mkdir(parents=True)
        np.savez(tmp_path / "folder" / name / "a.npz", a=rng.normal(size=(30, 2)), b=rng.normal(size=(30, 2)))
    rows = [f"{trial},{('felt', 'silk')[trial % 2]},{rng.normal()}" for trial in range(4) for _ in range(9)]
    (tmp_path / "table").write_text("\n".join(["trial,label,left", *rows]))
    np.savez(tmp_path / "arrays.npz", X=rng.normal(size=(4, 9, 2)), label=["felt", "silk"] * 2)
    np.savez(
        tmp_path / "events.npz", time_s=np.arange(40) / 100, channel=np.arange(40) % 3, trial=np.repeat(range(4), 10),
        label=["felt", "silk"] * 2,
    )  # fmt: skip
    (tmp_path / "table").rename(tmp_path / "table.csv")
    places = {"folder": "folder", "table": "table.csv", "arrays": "arrays.npz", "events": "events.npz"}
    for kind, more in kinds.items():
        done("import", kind, tmp_path / places[kind], *more, "--where", "label=silk", "-o", tmp_path / f"{kind}.h5")
        assert nt.load(tmp_path / f"{kind}.h5").conditions["label"].tolist() == ["silk", "silk"], kind
