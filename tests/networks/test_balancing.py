"""Training windows that count the same for each class, and for each condition within a class."""

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from in_process import typed

import neurotact as nt
from neurotact.cli.words import in_options, options_of
from neurotact.data import hdf5
from neurotact.data.augmentation import AugmentationSpec
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.encoders import specs
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import Counts
from neurotact.networks.definition.specs import TrainingSpec
from neurotact.networks.training import balancing, epochs, tasks
from neurotact.networks.training.tasks import Task
from neurotact.studies import loading, study

SMALL = {"hidden": 4, "training.epochs": 2}
TABLES = st.lists(
    st.tuples(st.sampled_from(["felt", "silk", "jute"]), st.integers(0, 2), st.sampled_from(["ann", "bob"])),
    min_size=1,
    max_size=60,
).map(lambda rows: pd.DataFrame(rows, columns=["label", "speed", "subject"]))


@given(TABLES)
def test_weights_of_classes_and_of_conditions_within_them_have_equal_sums(table):
    for balance, columns in (("classes", []), ("conditions", ["speed"]), ("conditions", ["speed", "subject"])):
        found = balancing.weights(table, balance, columns)
        weights = pd.Series(np.ones(len(table)) if found is None else found)
        assert weights.mean() == pytest.approx(1)
        of_class = weights.groupby(table["label"]).sum()
        assert np.ptp(of_class) == pytest.approx(0, abs=1e-9)
        for _, inside in weights.groupby(table["label"]):
            kinds = table.loc[inside.index, columns].astype(str).agg(" ".join, axis=1) if columns else table["label"]
            assert np.ptp(inside.groupby(kinds).sum()) == pytest.approx(0, abs=1e-9)


@given(TABLES, st.integers(2, 3))
def test_a_class_that_is_repeated_has_the_loss_of_once(table, times):
    """A balanced loss is that of the classes, whatever the number of windows of each."""
    labels = torch.from_numpy(np.unique(table["label"], return_inverse=True)[1])
    if len(labels.unique()) < 2:
        return
    readout = torch.from_numpy(np.random.default_rng(0).normal(size=(len(labels), 3)))
    repeated = torch.cat([torch.arange(len(labels)), *[torch.nonzero(labels == 0).ravel()] * (times - 1)])

    def loss_of(chosen):
        found = balancing.weights(table.iloc[chosen.numpy()], "classes", [])
        weights = None if found is None else torch.from_numpy(found)
        counts = Counts(readout[chosen], torch.zeros(len(chosen), 1, dtype=torch.float64))
        return float(epochs.loss(counts, labels[chosen], TrainingSpec(rate_penalty=0), weights))

    assert loss_of(repeated) == pytest.approx(loss_of(torch.arange(len(labels))))


def spikes_of(path, n_silk, n_felt=24):
    rng = np.random.default_rng(0)
    labels = ["felt"] * n_felt + ["silk"] * n_silk
    table = pd.DataFrame({"label": labels, "speed": [trial % 3 for trial in range(len(labels))]})
    rasters = [rng.random((60, 2)) < (0.2 if label == "felt" else 0.4) for label in labels]
    hdf5.save_spikes(from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), table), path)
    return path


def test_copies_and_windows_are_weighted_by_their_trial(tmp_path):
    trains = hdf5.load_spikes(spikes_of(tmp_path / "spikes.h5", 9))
    where = SplitSpec(test_where={"speed": 2})
    task = Task(window=WindowSpec(length_ms=20), split=where, balance="conditions")
    train, validation, test = tasks.sides_of(trains, task)
    assert train.weights is not None
    assert validation.weights is None
    assert test.weights is None
    for label in train.labels.unique():
        assert float(train.weights[train.labels == label].sum()) == pytest.approx(len(train.labels) / 2)


def test_the_note_counts_windows_without_a_raster(tmp_path, monkeypatch):
    recordings = hdf5.load_recordings(touches(tmp_path / "touches.h5"))
    encoded = encode_recordings(
        recordings, specs.resolve("sa1-ra1-lif"), augmentation=AugmentationSpec(kind="gain", copies=2)
    )
    task = Task(window=WindowSpec(length_ms=300), balance="classes", augmentation="gain")
    train = tasks.sides_of(encoded, task).train
    assert len(train.labels) == 3 * len(tasks.trials_of(encoded, task).train)  # with two copies of each
    monkeypatch.setattr(type(encoded), "raster", lambda *_: pytest.fail("a raster was made"))
    (line,) = tasks.balance_note(encoded, task)
    assert train.weights is not None
    assert f"windows count {float(train.weights.min()):.3g} to {float(train.weights.max()):.3g} times" in line


def test_training_differs_where_classes_do_and_is_the_same_where_they_do_not(tmp_path):
    for n_silk, changes in ((9, True), (24, False)):
        path, lines = spikes_of(tmp_path / f"{n_silk}.h5", n_silk), []
        for balance in ("none", "classes"):
            how = {"window": nt.Window(length_ms=60), "learn": nt.Learn(balance=balance), "tell": lines.append}
            nt.train(path, tmp_path / f"{n_silk}-{balance}", "rsnn", SMALL, **how)
        weights = [(tmp_path / f"{n_silk}-{name}" / "weights.safetensors").read_bytes() for name in ("none", "classes")]
        assert (weights[0] != weights[1]) == changes
        assert any("`balance='classes'` changes nothing" in str(line) for line in lines) != changes
        assert any("so that each class counts the same" in str(line) for line in lines) == changes


def test_conditions_that_no_split_names_are_refused(tmp_path):
    path = spikes_of(tmp_path / "spikes.h5", 9)
    words = f"train {path} -o {tmp_path / 'run'} --network rsnn --window-ms 60 --balance conditions"
    done = typed(*words.split())
    assert done.code == 2
    assert done.err.endswith(
        "neurotact: --balance conditions: balances the conditions that the split names, and it names none; give "
        "--balance classes, or a condition with --test-where, --group or --stratify\n"
    )


def test_a_study_names_what_is_typed_to_balance(tmp_path):
    path = touches(tmp_path / "equal.h5", 24)
    words = f"study run own-recordings --data {path} -o {tmp_path / 'run'} --set balance=conditions"
    assert typed(*words.split()).err.endswith(
        "neurotact: --set balance=conditions: balances the conditions that the split names, and it names none; give "
        "--set balance=classes, or a condition with --test-where, --group or --set dataset.stratify=VALUE\n"
    )
    notes = loading.resolve("own-recordings", {"balance": "classes"}, data=path).notes
    said = [in_options(note, options_of(["study", "run"])) for note in notes]
    assert "Training: --set balance=classes changes nothing, since each class has as many windows already." in said


@pytest.mark.parametrize("command", ["train {} -o run --window-ms 60", "tune {} -o run --window-ms 60"])
def test_an_unknown_condition_to_stratify_is_named_as_it_is_typed(tmp_path, command):
    path = spikes_of(tmp_path / "spikes.h5", 9)
    done = typed(*command.format(path).split(), "--network", "rsnn", "--stratify", "sped", cwd=tmp_path)
    assert done.err.endswith("neurotact: --stratify: there is no condition 'sped'; did you mean 'speed'?\n")


def touches(path, n_silk=9):
    labels = ["felt"] * 24 + ["silk"] * n_silk
    table = pd.DataFrame({"label": labels, "speed": [trial % 3 for trial in range(len(labels))]})
    signals = np.zeros((len(labels), 300, 2), np.float32)
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", table), path)
    return path


def test_a_study_weights_each_network_and_keeps_its_seeds(tmp_path):
    path = touches(tmp_path / "touches.h5")
    plain, balanced = (
        loading.resolve("own-recordings", {"balance": balance}, data=path) for balance in ("none", "classes")
    )
    cells = [[*study.cells(what)] for what in (plain, balanced)]
    assert {cell.balance for cell in cells[1]} == {"classes"}
    assert [cell.seeds for cell in cells[0]] == [cell.seeds for cell in cells[1]]
    assert not any("count" in note and "class" in note for note in plain.notes)
    assert any("times, so that each class counts the same" in note for note in balanced.notes)
    with pytest.raises(InputError, match="balances the conditions that the split names"):
        loading.resolve("own-recordings", {"balance": "conditions"}, data=path)
    each = {"balance": "conditions", "sweep.split.test_where.speed": [0, 1, 2]}
    assert any("each class, and within it each speed" in note for note in loading.resolve(
        "own-recordings", each, data=path).notes)  # fmt: skip
    equal = loading.resolve("own-recordings", {"balance": "classes"}, data=touches(tmp_path / "equal.h5", 24))
    assert any("`settings={'balance': 'classes'}` changes nothing" in note for note in equal.notes)
