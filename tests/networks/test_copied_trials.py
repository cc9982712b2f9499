"""Copies of trials from the import to the decision: named, on one side, counted once, recognised under another name."""

import sys

import numpy as np
import pandas as pd
import pytest

import neurotact as nt
from neurotact import cli
from neurotact.data.hdf5 import save_spikes
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import resumable, run_folder, tasks
from neurotact.networks.use.classifier import SpikingClassifier

NAMES = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
NETWORK = RSNNSpec(hidden=5, training=TrainingSpec(epochs=2, batch=8, learning_rate=0.05))


@pytest.fixture
def typed(monkeypatch, capsys):
    """Run a command; returns its exit code, and what it printed and said."""

    def call(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["neurotact", "--quiet", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        said = capsys.readouterr()
        return int(end.value.code or 0), said.out, said.err

    return call


def folder_of(place, copies=("{}_copy",), n=8, classes=("felt", "silk")):
    """Random walks of classes that do not differ, each saved again under other names."""
    rng = np.random.default_rng(0)
    for label in classes:
        (place / label).mkdir(parents=True)
        for number in range(n):
            walk = rng.standard_normal((150, 3)).cumsum(axis=0)
            for name in ("{}", *copies):
                np.savetxt(place / label / f"{name.format(number)}.csv", walk, delimiter=",", fmt="%.8f")
    return place


def test_copies_are_named_at_import_counted_in_training_and_known_by_infer(typed, tmp_path, caplog):
    folder_of(tmp_path / "in", ("{}_copy", "again{}"))
    given = ["folder", tmp_path / "in", "--unit", "mV", "--sampling-rate-Hz", 1000, "-o", tmp_path / "t.h5"]
    assert typed("import", *given)[0] == 0
    words = "32 of 48 trials are copies of others: felt/0_copy.csv of felt/0.csv, felt/1_copy.csv of felt/1.csv"
    assert words in caplog.text
    assert words in typed("info", tmp_path / "t.h5")[1]
    assert typed("encode", tmp_path / "t.h5", "-o", tmp_path / "s.h5", "--set", "sa1.gain=30")[0] == 0
    assert "32 of 48 trials are copies of others" in typed("info", tmp_path / "s.h5")[1]
    _, printed, said = typed("train", tmp_path / "s.h5", "-o", tmp_path / "r", "--set", "training.epochs=1")
    assert "32 of 48 trials are copies of others (neurotact info); copies are on one side, and intervals" in said
    assert ", 2 test trials)" in printed
    sides = [side for _, side in run_folder.restore(tmp_path / "r").provenance.trials]
    for kind in ("recorded", "spikes"):
        digests = [set(getattr(side, kind)) for side in sides]
        assert sum(map(len, digests)) == len(set.union(*digests)) == 16
        assert [len(getattr(side, kind)) for side in sides] == [3 * len(each) for each in digests]
    for path in (tmp_path / "in").glob("*/*_copy.csv"):
        path.rename(path.with_name(f"z{path.name}"))
    for path in (tmp_path / "in").glob("*/[0-7].csv"):
        path.unlink()
    renamed = nt.encode(nt.read_folder(tmp_path / "in", 1000, "mV"), settings={"sa1.gain": 30})
    assert nt.infer(tmp_path / "r", renamed).groupby("side")["trial"].nunique().to_dict() == {
        "training": 24, "validation": 4, "test": 4
    }  # fmt: skip


def test_a_copy_in_the_folder_of_another_class_is_refused(typed, tmp_path):
    folder_of(tmp_path / "in", ())
    (tmp_path / "in/silk/new.csv").write_text((tmp_path / "in/felt/3.csv").read_text())
    given = ["folder", tmp_path / "in", "--unit", "mV", "--sampling-rate-Hz", 1000, "-o", tmp_path / "t.h5"]
    code, _, said = typed("import", *given)
    sentence = "silk/new.csv of class 'silk' is a copy of felt/3.csv of class 'felt'; keep the one with the right class"
    assert (code, sentence in said, said.count("\n")) == (2, True, 1)
    assert not (tmp_path / "t.h5").exists()
    with pytest.raises(InputError, match=sentence):
        nt.save(nt.read_folder(tmp_path / "in", 1000, "mV"), tmp_path / "t.h5")
    assert typed("import", *given, "--leave-out", "file=silk/new.csv")[0] == 0


@pytest.mark.parametrize("reader", ["table", "arrays", "events"])
def test_every_import_names_copies_and_classes_with_two_names(reader, typed, tmp_path, caplog):
    rng = np.random.default_rng(0)
    walks = rng.standard_normal((4, 60, 2)).cumsum(axis=1)
    trials, labels = [*walks, walks[1]], ["Wood", "felt", "WOOD", "felt", "felt"]
    if reader == "table":
        parts = [
            pd.DataFrame(walk, columns=["a", "b"]).assign(trial=at, label=labels[at]) for at, walk in enumerate(trials)
        ]
        pd.concat(parts).to_csv(tmp_path / "all.csv", index=False)
        given = ["table", tmp_path / "all.csv", "--unit", "mV", "--sampling-rate-Hz", 1000]
        found = nt.read_table(tmp_path / "all.csv", 1000, "mV")
    elif reader == "arrays":
        np.savez(tmp_path / "all.npz", signals=np.stack(trials), label=labels)
        given = ["arrays", tmp_path / "all.npz", "--unit", "mV", "--sampling-rate-Hz", 1000]
        found = nt.read_arrays(tmp_path / "all.npz", 1000, "mV")
    else:
        events = [(at, t, t % 3, labels[at]) for at, which in enumerate([0, 1, 2, 3, 1])
                  for t in np.random.default_rng(which).permutation(200)[:20]]  # fmt: skip
        table = pd.DataFrame(events, columns=["trial", "t_ms", "channel", "label"])
        table.sort_values(["trial", "t_ms"]).to_csv(tmp_path / "events.csv", index=False)
        given = ["events", tmp_path / "events.csv"]
        found = nt.read_events(tmp_path / "events.csv")
    caplog.clear()
    for save in (lambda: typed("import", *given, "-o", tmp_path / "a.h5"), lambda: nt.save(found, tmp_path / "b.h5")):
        save()
        copies, classes = caplog.messages[-2:]
        assert "1 of 5 trials is a copy of another one: trial 4 of trial 1" in copies
        assert "the classes 'WOOD', 'Wood' differ only in case or blanks" in classes


def test_the_interval_counts_touches_and_not_their_copies(tmp_path):
    rng = np.random.default_rng(0)
    rasters = (rng.random((40, 40, 4)) < 0.2).astype(np.uint8)
    labels = ["felt", "silk"] * 20
    for times in (1, 3):
        table = pd.DataFrame({"label": labels * times})
        trains = from_rasters(np.concatenate([rasters] * times), 1000.0, NAMES, table)
        save_spikes(trains, tmp_path / f"{times}.h5")
        done = resumable.run(
            tmp_path / f"{times}.h5", tmp_path / f"r{times}", NETWORK, tasks.Task(window={"length_ms": 40})
        )
        assert done is not None
        assert done.compared.trials == 6
        counted = [line for line in done.cautions if "copies" in line]
        assert bool(counted) == (times == 3)
        if counted:
            assert counted == [
                "80 of 120 trials are copies of others (neurotact info); copies are on one side, and intervals count "
                "them once"
            ]


def test_validation_windows_of_an_estimator_are_no_copies_of_training_windows():
    rng = np.random.default_rng(0)
    X, y = (rng.random((20, 40, 4)) < 0.3).astype(np.uint8), np.repeat([0, 1], 10)
    twice = np.concatenate([X, X]), np.concatenate([y, y])
    seen = {}

    class Watched(SpikingClassifier):
        def _hold_out(self, *given):
            sides = super()._hold_out(*given)
            seen["inside"], seen["held"], _ = sides
            return sides

    for groups in (None, np.arange(40)):
        Watched(epochs=1, hidden=3, network="rsnn", sampling_rate_Hz=1000.0, random_state=0).fit(*twice, groups=groups)
        assert not set(seen["inside"] % 20) & set(seen["held"] % 20)
        assert sorted([*seen["inside"], *seen["held"]]) == list(range(40))
    patterns = np.repeat(X[[0, 10]], 20, axis=0), np.repeat([0, 1], 20)  # no copies: each class is one pattern
    Watched(epochs=1, hidden=3, network="rsnn", sampling_rate_Hz=1000.0, random_state=0).fit(
        *patterns, groups=np.arange(40) // 2
    )
    assert len(seen["held"])
