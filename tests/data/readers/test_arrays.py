"""One file of arrays: what was saved comes back from NPZ and HDF5, whatever its names and the order of its axes."""

import itertools

import h5py
import numpy as np
import pytest

import neurotact as nt
from neurotact.errors import InputError

SIGNALS = np.random.default_rng(2).normal(size=(4, 9, 3)).astype(np.float32)
CLASSES = ["rub", "tap", "rub", "tap"]


def write(path, **arrays):
    if path.suffix == ".npz":
        np.savez(path, **arrays)
        return path
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            texts = np.asarray(values).dtype.kind == "U"
            file[f"session/{name}"] = np.asarray(values).astype("S") if texts else values
    return path


def refused(message, *arguments, **options):
    with pytest.raises(InputError) as refusal:
        nt.read_arrays(*arguments, **options)
    assert message in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
@pytest.mark.parametrize("axes", list(itertools.permutations(("trial", "time", "taxel"))))
def test_arrays_come_back_in_any_order_of_axes(tmp_path, suffix, axes):
    there = SIGNALS.transpose([("trial", "time", "taxel").index(axis) for axis in axes])
    place = "" if suffix == ".npz" else "session/"
    path = write(
        tmp_path / f"a{suffix}", data=there, gesture=CLASSES, day=[1, 1, 2, 2], taxels=["l", "m", "r"], fs=100.0
    )
    found = nt.read_arrays(path, 100, "count", names={"label": f"{place}gesture"}, axes=",".join(axes))
    np.testing.assert_array_equal(found.signals, SIGNALS)
    assert found.conditions.to_dict("list") == {"label": CLASSES, "day": [1, 1, 2, 2]}
    assert found.channels == ("l", "m", "r")
    assert (found.sampling_rate_Hz, found.unit) == (100.0, "count")
    nt.save(found, tmp_path / "touches.h5")
    np.testing.assert_array_equal(nt.load(tmp_path / "touches.h5").signals, SIGNALS)


def test_classes_may_be_numbers_and_the_usual_names_are_known(tmp_path, caplog):
    found = nt.read_arrays(write(tmp_path / "a.npz", X=SIGNALS, y=[1.0, 0.0, 1.0, 0.0]), 100, "mV")
    assert found.conditions["label"].tolist() == ["1", "0", "1", "0"]
    assert found.channels == ("taxel1", "taxel2", "taxel3")
    assert not caplog.messages
    nt.read_arrays(write(tmp_path / "a.npz", X=SIGNALS.transpose(0, 2, 1), y=CLASSES), 100, "mV")
    assert "has 9 taxels of 3 samples each; if it is the other way round, use --axes" in caplog.text


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_arrays_that_say_too_little_are_refused(tmp_path, suffix):
    def saved(**arrays):
        return write(tmp_path / f"a{suffix}", **arrays)

    place = "" if suffix == ".npz" else "session/"
    refused(f"no array is called label ({place}kind); name the class", saved(X=SIGNALS, kind=CLASSES), 100, "mV")
    refused("holds 0 arrays with the axes trial, time and taxel", saved(X=SIGNALS[0], y=CLASSES), 100, "mV")
    refused("holds 2 arrays with the axes", saved(X=SIGNALS, Z=SIGNALS, y=CLASSES), 100, "mV")
    named = {"signals": f"{place}Z"}
    assert len(nt.read_arrays(saved(X=SIGNALS, Z=SIGNALS, y=CLASSES), 100, "mV", names=named)) == 4
    refused("has the shape (3,) where (4,) is expected", saved(X=SIGNALS, z=[1, 2, 3]), 100, "mV",
            names={"label": f"{place}z"})  # fmt: skip
    refused("holds no array 'z'", saved(X=SIGNALS, y=CLASSES), 100, "mV", names={"label": "z"})
    refused("'lable' is not a known name; did you mean 'label'?", saved(X=SIGNALS, y=CLASSES), 100, "mV",
            names={"lable": "y"})  # fmt: skip
    refused("axes must name trial, time and taxel", saved(X=SIGNALS, y=CLASSES), 100, "mV", axes="trial,time")
    refused("trial 1, sample 2, taxel1 is NaN", saved(X=np.where(np.arange(108).reshape(4, 9, 3) == 33, np.nan, 1.0),
            y=CLASSES), 100, "mV")  # fmt: skip
    refused("sampling_rate_Hz must be a positive number", saved(X=SIGNALS, y=CLASSES), 0, "mV")
    refused("the unit of the signals is empty", saved(X=SIGNALS, y=CLASSES), 100, " ")


def test_pickles_and_other_files_are_never_opened(tmp_path):
    np.savez(tmp_path / "a.npz", X=SIGNALS, y=np.array([{}, 1, 2, 3], object))
    refused("holds pickled Python objects", tmp_path / "a.npz", 100, "mV")
    (tmp_path / "a.pkl").write_text("")
    refused("is not a file of arrays by its suffix", tmp_path / "a.pkl", 100, "mV")
    (tmp_path / "a.h5").write_text("no HDF5")
    refused("cannot be read as arrays", tmp_path / "a.h5", 100, "mV")
    (tmp_path / "skin" / "felt").mkdir(parents=True)
    np.savez(tmp_path / "skin" / "felt" / "a.npz", X=SIGNALS)
    with pytest.raises(InputError, match="neurotact import arrays reads"):
        nt.read_folder(tmp_path / "skin", 100, "mV")
