"""`neurotact learn`: recursive least squares, what stays of a network, and what its folder says."""

import shutil

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.networks import new_class

import neurotact as nt
from neurotact import files
from neurotact.data.spikes import end_to_end, from_rasters
from neurotact.networks.training import run_folder

SEEDS = st.integers(0, 2**32 - 1)
NETWORK = {"hidden": 6, "readout": "integrator", "readout_stretches": 2, "readout_stretch_ms": 25.0,
           "training.epochs": 3, "forward_weight_scale": 3.0, "recipe": None}  # fmt: skip
NAMES = tuple(f"taxel{k}" for k in range(4))
WINDOW = nt.Window(length_ms=50)
KINDS = {"felt": (0, 1), "silk": (1, 2), "wool": (2, 3), "mesh": (0, 3)}


def rasters_of(labels: list[str], seed: int = 0) -> np.ndarray:
    """Spikes of four afferents `(touch, time, afferent)`, of which each class makes two busy."""
    rng = np.random.default_rng(seed)
    rasters = (rng.random((len(labels), 50, 4)) < 0.04).astype(np.uint8)
    for raster, label in zip(rasters, labels, strict=True):
        raster[:, KINDS[label]] |= (rng.random((50, 2)) < 0.25).astype(np.uint8)
    return rasters


def touches(labels: list[str], seed: int = 0) -> nt.SpikeTrains:
    return from_rasters(rasters_of(labels, seed), 1000.0, NAMES, pd.DataFrame({"label": labels}))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("new-class")
    nt.save(touches(["felt", "silk"] * 40), folder / "spikes.h5")
    nt.save(touches(["wool", "felt", "wool"] * 8, seed=1), folder / "wool.h5")
    nt.train(folder / "spikes.h5", folder / "run", "rsnn", NETWORK, window=WINDOW)
    nt.learn(folder / "run", folder / "wool.h5", folder / "with-wool")
    return folder


@given(SEEDS, st.integers(1, 6), st.sampled_from([0.001, 1.0]))
def test_one_touch_after_the_other_is_the_regression_on_all(seed, n_new, penalty):
    rng = np.random.default_rng(seed)
    features = np.column_stack([rng.poisson(2, (40, 5)), np.ones(40)]).astype(float)
    labels, new = np.arange(40) % 3, np.column_stack([rng.poisson(4, (n_new, 5)), np.ones(n_new)]).astype(float)
    begun = new_class.fitted_to(features, labels, 3, penalty)
    readout = begun.with_class()
    for one in new:
        readout = readout.after(one, 3, begun.each / n_new)
    every, of_all = np.concatenate([features, new]), np.concatenate([labels, np.full(n_new, 3)])
    weights = np.concatenate([begun.each / np.bincount(labels)[labels], np.full(n_new, begun.each / n_new)])
    ridge = np.full(6, penalty * np.square(features[:, :5]).mean() * 40)
    ridge[-1] = 40e-6
    squares = every.T @ (weights[:, None] * every) + np.diag(ridge)
    targets = np.where(np.arange(4) == of_all[:, None], 1.0, -1.0)
    expected = np.linalg.solve(squares, (weights[:, None] * every).T @ targets)
    np.testing.assert_allclose(readout.weights, expected, atol=1e-7)
    np.testing.assert_allclose(readout.inverse, np.linalg.inv(squares), atol=1e-8)


def test_only_the_readout_changes_and_it_decides_as_the_regression_does(place):
    old, new = (run_folder.restore(place / name) for name in ("run", "with-wool"))
    assert new.classes == ("felt", "silk", "wool")
    for name in ("w_in", "w_rec", "alpha", "beta", "threshold"):
        assert torch.equal(getattr(new.network, name), getattr(old.network, name))
    spikes = torch.from_numpy(rasters_of(["wool", "silk"] * 5, seed=3))
    features = new_class.features_of(old.network, spikes)
    weights = torch.cat([new.network.readout_weights.flatten(0, 1), new.network.bias[None]]).double()
    values = new.network.infer(spikes).readout
    torch.testing.assert_close(values, torch.from_numpy(features) @ weights, atol=1e-4, rtol=1e-5)


def test_a_new_class_is_told_apart_and_the_known_ones_are_counted(place):
    row = files.read_json(place / "with-wool" / "result.json")["row"]
    assert row["touches"] == {"wool": 5}
    assert row["new_trials"] == 11
    assert row["new"] > 0.7
    assert row["new_low"] < row["new"] <= row["new_high"]
    assert min(row["old_refitted"], row["old_after"]) > 0.7
    before = nt.infer(place / "run", place / "spikes.h5")
    before = before[before["side"] == "test"]
    assert (before["label"] == before["predicted"]).mean() == pytest.approx(row["old_before"])
    again = nt.infer(place / "with-wool", place / "wool.h5")
    wool = again[again["label"] == "wool"]
    assert (wool["side"] == "training").sum() == 5
    others = wool[wool["side"] == "unseen"]
    assert (others["predicted"] == "wool").mean() == pytest.approx(row["new"])
    tested = nt.infer(place / "with-wool", place / "spikes.h5")
    tested = tested[tested["side"] == "test"]
    assert (tested["label"] == tested["predicted"]).mean() == pytest.approx(row["old_after"])


def test_one_class_after_the_other_is_both_at_once_and_the_spikes_of_training_stay_known(place, tmp_path):
    nt.save(touches(["mesh"] * 6, seed=2), tmp_path / "mesh.h5")
    nt.save(
        end_to_end([touches(["wool", "felt", "wool"] * 8, seed=1), touches(["mesh"] * 6, seed=2)]), tmp_path / "2.h5"
    )
    nt.learn(place / "with-wool", tmp_path / "mesh.h5", tmp_path / "one-by-one")
    row = nt.learn(place / "run", tmp_path / "2.h5", tmp_path / "at-once")
    one, both = (run_folder.restore(tmp_path / name) for name in ("one-by-one", "at-once"))
    assert (one.classes, both.classes) == (("felt", "silk", "wool", "mesh"), ("felt", "silk", "mesh", "wool"))
    order = [0, 1, 3, 2]
    torch.testing.assert_close(one.network.readout_weights, both.network.readout_weights[..., order])
    torch.testing.assert_close(one.network.bias, both.network.bias[order])
    assert list(one.taught) == ["wool", "mesh"]
    assert files.read_json(tmp_path / "one-by-one" / "result.json")["row"]["old_after"] == row["old_after"]
    assert len(run_folder.trained_spikes_of(one)) == 80
    again = nt.infer(tmp_path / "one-by-one", tmp_path / "2.h5")
    assert again.groupby("label")["side"].apply(lambda sides: (sides == "training").sum()).to_dict() == {
        "felt": 0, "mesh": 5, "wool": 5,
    }  # fmt: skip
    nt.save(touches(["felt", "silk"] * 40, seed=5), tmp_path / "others.h5")
    with pytest.raises(nt.InputError, match="no longer contains the trials"):
        nt.learn(place / "with-wool", tmp_path / "mesh.h5", tmp_path / "new", spikes=tmp_path / "others.h5")


def edited_touch(heard: dict, text: str, number: int = -1) -> dict:
    return {"wool": [*heard["wool"][:-1], " ".join([*heard["wool"][-1].split()[:number], *text.split()])]}


CHANGED = {
    "a word": lambda heard: edited_touch(heard, "a"),
    "no number": lambda heard: edited_touch(heard, "nan"),
    "one less": lambda heard: edited_touch(heard, ""),
    "all less": lambda heard: {"wool": [touch.rpartition(" ")[0] for touch in heard["wool"]]},
    "none": lambda heard: {"wool": []},
    "another class": lambda heard: {"mesh": heard["wool"]},
    "a trained class": lambda heard: {"silk": heard["wool"], **heard},
    "too many": lambda heard: {"mesh": heard["wool"], "felt": heard["wool"], "silk": heard["wool"], **heard},
}


@pytest.mark.parametrize("name", CHANGED)
def test_touches_that_were_changed_since_they_were_learned_are_refused(place, tmp_path, name):
    shutil.copytree(place / "with-wool", tmp_path / "with-wool")
    shutil.copy(place / "spikes.h5", tmp_path)
    path = tmp_path / "with-wool" / "network.json"
    table = files.read_json(path)
    table["extra"]["taught"] = CHANGED[name](table["extra"]["taught"])
    files.write_json(path, table)
    nt.save(touches(["mesh"] * 6, seed=2), tmp_path / "mesh.h5")
    with pytest.raises(nt.InputError, match=r"with-wool: the touches of the classes that it learned .* were changed"):
        nt.learn(tmp_path / "with-wool", tmp_path / "mesh.h5", tmp_path / "new")


@pytest.mark.parametrize("further", [nt.fine_tune, nt.save_energy])
def test_what_trains_again_names_the_classes_that_were_learned_later(place, tmp_path, further):
    with pytest.raises(nt.InputError, match="with-wool: learned wool after its training, and"):
        further(place / "with-wool", tmp_path / "new")


def test_trials_of_known_classes_are_named_and_the_run_cannot_be_overwritten(place, tmp_path):
    told = []
    nt.learn(place / "run", place / "wool.h5", tmp_path / "new", touches=2, tell=told.append)
    assert "8 trials of classes that the network knows are not used" in told[0]
    assert "learned wool from 2 touches; of 14 other touches" in told[1]
    with pytest.raises(nt.InputError, match="is the run that is to learn"):
        nt.learn(place / "run", place / "wool.h5", place / "run")


def test_a_loss_of_known_classes_is_told_with_what_to_do():
    row = {"old_before": 0.9, "old_refitted": 0.9, "old_after": 0.8, "old_windows": 9, "touches": {"wool": 1}}
    row |= {"new_trials": 0}
    assert new_class._lines(row)[1].endswith("10 points less: record more touches, or train again with all classes")
    assert new_class._lines(row | {"old_after": 0.86})[1].endswith("86.0 % with the new class")


def test_a_network_that_refuses_touches_refuses_none_with_another_readout(place, tmp_path):
    shutil.copytree(place / "run", tmp_path / "run")
    path = tmp_path / "run" / "network.json"
    table = files.read_json(path)
    table["extra"]["spikes"] = str(place / "spikes.h5")
    files.write_json(path, table)
    nt.refuse(tmp_path / "run", 0.3)
    nt.learn(tmp_path / "run", place / "wool.h5", tmp_path / "new")
    assert run_folder.restore(tmp_path / "new").refusal is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"touches": 0}, "touches: must be at least 1"),
        ({"touched": "spikes.h5"}, "spikes.h5: has no class that the network does not know"),
        ({"run": "counting"}, "readout is no sum of spikes"),
        ({"touched": "slow.h5"}, "sampled at 500 Hz"),
        ({"touched": "other.h5"}, "encode the recordings as in training$"),  # learn has no option to allow it
    ],
)
def test_what_cannot_be_learned_is_refused(place, tmp_path, change, said):
    if "counting" in change.values() and not (place / "counting").exists():
        counting = {"hidden": 4, "training.epochs": 1, "recipe": None}
        nt.train(place / "spikes.h5", place / "counting", "rsnn", counting, window=WINDOW)
    slow = from_rasters(rasters_of(["wool"] * 2), 500.0, NAMES, pd.DataFrame({"label": ["wool"] * 2}))
    nt.save(slow, place / "slow.h5", force=True)
    other = from_rasters(rasters_of(["wool"] * 2), 1000.0, NAMES[::-1], pd.DataFrame({"label": ["wool"] * 2}))
    nt.save(other, place / "other.h5", force=True)
    given_ = {"run": "run", "touched": "wool.h5"} | change
    run, touched = place / str(given_.pop("run")), place / str(given_.pop("touched"))
    with pytest.raises(nt.InputError, match=said):
        nt.learn(run, touched, tmp_path / "new", **given_)
