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
    assert "has 9 taxels of 3 samples each; if it is the other way round, use `axes`" in caplog.text


def test_an_array_per_trial_names_the_import_of_folders(tmp_path):
    path = write(tmp_path / "many.npz", a0=np.zeros((240, 12)), a1=np.zeros((310, 12)), a2=np.zeros((280, 12)))
    with pytest.raises(InputError, match=r"3 arrays such as 'a0' look like one trial.*neurotact import folder"):
        nt.read_arrays(path, 200, "count")


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
    refused("has the shape (5,) where (4,) is expected", saved(X=SIGNALS, z=[1, 2, 3, 4, 5]), 100, "mV",
            names={"label": f"{place}z"})  # fmt: skip
    refused("holds no array 'z'", saved(X=SIGNALS, y=CLASSES), 100, "mV", names={"label": "z"})
    refused("'lable' is not a known name; did you mean 'label'?", saved(X=SIGNALS, y=CLASSES), 100, "mV",
            names={"lable": "y"})  # fmt: skip
    refused("axes must name trial, time and taxel", saved(X=SIGNALS, y=CLASSES), 100, "mV", axes="trial,when,taxel")
    refused(
        "(4, 9, 3), so 2 axes do not fit (trial,time); name each axis",
        saved(X=SIGNALS, y=CLASSES),
        100,
        "mV",
        axes="trial,time",
    )
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


# --- grids of taxels --------------------------------------------------------------------------------

GRID = np.random.default_rng(3).normal(size=(4, 30, 3, 2)).astype(np.float32)
FLAT = GRID.reshape(4, 30, 6)
NAMES = ("r0c0", "r0c1", "r1c0", "r1c1", "r2c0", "r2c1")
AXES = ("trial", "time", "row", "column")


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
@pytest.mark.parametrize("axes", [("trial", "time", "row", "column"), ("trial", "row", "column", "time")])
def test_a_grid_of_taxels_is_read_row_by_row(tmp_path, suffix, axes, caplog):
    there = GRID.transpose([AXES.index(axis) for axis in axes])
    path = write(tmp_path / f"a{suffix}", X=there, y=CLASSES)
    found = nt.read_arrays(path, 100, "count")
    np.testing.assert_array_equal(found.signals, FLAT)
    assert found.channels == NAMES
    (said,) = caplog.messages
    assert f"has the axes {', '.join(axes)}: 6 taxels, named r0c0 to r2c1 row by row" in said


@pytest.mark.parametrize("axes", list(itertools.permutations(AXES))[::5])
def test_a_grid_is_read_in_any_order_of_axes_that_is_named(tmp_path, axes):
    path = write(tmp_path / "a.npz", X=GRID.transpose([AXES.index(axis) for axis in axes]), y=CLASSES)
    found = nt.read_arrays(path, 100, "count", axes=",".join(axes))
    np.testing.assert_array_equal(found.signals, FLAT)
    assert found.channels == NAMES


def test_a_grid_whose_time_is_not_clear_must_name_it(tmp_path):
    for shape in ((4, 6, 8, 10), (4, 10, 8, 6), (4, 8, 8, 8), (4, 9, 2, 8)):
        path = write(tmp_path / "a.npz", X=np.ones(shape), y=CLASSES)
        refused("no axis is clearly the time; give `axes='trial,time,row,column'` or `axes='trial,row,column,time'`",
                path, 100, "V")  # fmt: skip
    assert nt.read_arrays(path, 100, "V", axes="trial,time,row,column").lengths.tolist() == [9] * 4


def test_named_taxels_of_a_grid_keep_their_names(tmp_path, caplog):
    found = nt.read_arrays(write(tmp_path / "a.npz", X=GRID, y=CLASSES, channels=[*"abcdef"]), 100, "count")
    assert found.channels == tuple("abcdef")
    assert not caplog.messages


# --- what else a file says --------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
@pytest.mark.parametrize("name", ["fs", "Fs", "sampling_rate", "sampling_rate_Hz", "SamplingRate"])
def test_the_sampling_rate_of_the_file_is_used_and_a_contradiction_named(tmp_path, suffix, name, caplog):
    path = write(tmp_path / f"a{suffix}", X=SIGNALS, y=CLASSES, **{name: 250.0})
    assert nt.read_arrays(path, unit="V").sampling_rate_Hz == 250.0
    assert "the sampling rate is 250 Hz, as " in caplog.text
    caplog.clear()
    assert nt.read_arrays(path, 250, "V").sampling_rate_Hz == 250.0
    assert not caplog.messages
    assert nt.read_arrays(path, 100, "V").sampling_rate_Hz == 100.0
    assert f"{name} = 250, but 100 Hz is given and used" in caplog.text


def say_by_attribute(path, **attributes):
    with h5py.File(path, "a") as file:
        (file["session/X"] if "units" in attributes else file).attrs.update(attributes)
    return path


@pytest.mark.parametrize(
    ("suffix", "arrays", "attributes", "said"),
    [
        (".npz", {"unit": "mV"}, {}, "unit"),
        (".h5", {"units": "mV"}, {}, "session/units"),
        (".h5", {}, {"unit": "mV"}, "attribute unit"),
        (".h5", {}, {"units": "mV"}, "attribute units of session/X"),
        (".npz", {"taxels": ["l_mV", "m_mV", "r_mV"]}, {}, "l_mV, m_mV and 1 more"),
    ],
)
def test_another_unit_than_the_file_says_is_named(tmp_path, suffix, arrays, attributes, said, caplog):
    path = write(tmp_path / f"a{suffix}", X=SIGNALS, y=CLASSES, fs=100.0, **arrays)
    if attributes:
        say_by_attribute(path, **attributes)
    assert nt.read_arrays(path, 100, "V").unit == "V"
    assert caplog.messages == [f"{path}: says mV ({said}), but V is given and used"]
    caplog.clear()
    for unit in ("mV", "[mv]"):
        assert nt.read_arrays(path, 100, unit).unit == unit
    assert not caplog.messages


@pytest.mark.parametrize(
    "more", [{"unit": "a.b."}, {"unit": np.array([1, 2])}, {"taxels": ["pad_A", "pad_B", "pad_N"]}, {"unit": 5}]
)
def test_what_is_no_unit_of_the_signals_is_not_compared(tmp_path, more, caplog):
    nt.read_arrays(write(tmp_path / "a.npz", X=SIGNALS, y=CLASSES, fs=100.0, **more), 100, "V")
    assert "is given and used" not in caplog.text


def test_a_rate_that_is_not_known_or_said_twice_is_asked_for(tmp_path):
    refused("the sampling rate is not known; give `sampling_rate_Hz`, or save it as fs",
            write(tmp_path / "a.npz", X=SIGNALS, y=CLASSES), None, "V")  # fmt: skip
    refused("says fs = 250, Fs = 100; give the rate with `sampling_rate_Hz`",
            write(tmp_path / "a.npz", X=SIGNALS, y=CLASSES, fs=250, Fs=100), None, "V")  # fmt: skip
    refused("fs: sampling_rate_Hz must be a positive number; got 0.0",
            write(tmp_path / "a.npz", X=SIGNALS, y=CLASSES, fs=0), None, "V")  # fmt: skip


def test_what_is_not_used_is_named(tmp_path, caplog):
    path = write(tmp_path / "a.npz", X=SIGNALS, y=[[each] for each in CLASSES], t=np.arange(9) / 100, hot=np.eye(4, 2))
    assert nt.read_arrays(path, 100, "V").conditions.to_dict("list") == {"label": CLASSES}  # a column is a vector
    assert "not used: t (9,), hot (4, 2)" in caplog.text


def test_an_npy_file_has_its_classes_in_a_file_beside_it(tmp_path):
    np.save(tmp_path / "press.npy", SIGNALS)
    np.save(tmp_path / "y.npy", np.array([1.0, 0.0, 1.0, 0.0]))
    (tmp_path / "trials.csv").write_text("class,force_N\nrub,3\ntap,3\nrub,6\ntap,6\n")
    refused("no array is called label (none has one value per trial); name the class with "
            "`names={'label': ...}`, or give a table that has it with `conditions`",
            tmp_path / "press.npy", 100, "V")  # fmt: skip
    found = nt.read_arrays(tmp_path / "press.npy", 100, "V", conditions=tmp_path / "y.npy")
    np.testing.assert_array_equal(found.signals, SIGNALS)
    assert found.conditions["label"].tolist() == ["1", "0", "1", "0"]
    found = nt.read_arrays(tmp_path / "press.npy", 100, "V", conditions=tmp_path / "trials.csv")
    assert found.conditions.to_dict("list") == {"label": CLASSES, "force_N": [3, 3, 6, 6]}
    np.savez(tmp_path / "a.npz", X=SIGNALS, label=CLASSES)
    refused("'label' is an array here and a column of `conditions`; drop one of them", tmp_path / "a.npz", 100, "V",
            conditions=tmp_path / "trials.csv")  # fmt: skip
    (tmp_path / "trials.csv").write_text("class,force_N\nrub,3\ntap,3\n")
    rows = "material,force\ncork,1\ndenim,2\ncork,3\ndenim,4\n"
    (tmp_path / "named.csv").write_text(rows)
    found = nt.read_arrays(
        tmp_path / "press.npy", 100, "V", conditions=tmp_path / "named.csv", names={"label": "material"}
    )
    assert found.conditions.to_dict("list") == {"label": ["cork", "denim"] * 2, "force": [1, 2, 3, 4]}
    refused("trials.csv: has 2 rows, but ", tmp_path / "press.npy", 100, "V", conditions=tmp_path / "trials.csv")
    np.save(tmp_path / "p.npy", np.array([{}, 1], object))
    refused("p.npy: holds pickled Python objects", tmp_path / "p.npy", 100, "V")
    (tmp_path / "p.npy").write_bytes((tmp_path / "press.npy").read_bytes()[:-9])
    refused("p.npy: cannot be read as an array", tmp_path / "p.npy", 100, "V")


@pytest.mark.parametrize("more", [{}, {"speed": np.arange(4)}])
def test_classes_of_another_number_than_the_trials_are_named(tmp_path, more):
    path = write(tmp_path / "a.npz", X=SIGNALS, label=[*CLASSES, "tap"], **more)
    refused("'label' has the shape (5,), but there are 4 trials; give one value per trial, or name another array with "
            "`names={'label': ...}`", path, 100, "V")  # fmt: skip


def test_trials_on_another_axis_are_told_by_the_number_of_classes(tmp_path):
    """MATLAB's habit: the trial is the last axis."""
    path = write(tmp_path / "a.npz", X=SIGNALS.transpose(1, 2, 0), y=CLASSES)
    refused("'y' has 4 values, as many as axis 3 of 'X' (9, 3, 4) is long; if these are the trials, use "
            "`axes='time,taxel,trial'`", path, 100, "V")  # fmt: skip
    np.testing.assert_array_equal(nt.read_arrays(path, 100, "V", axes="time,taxel,trial").signals, SIGNALS)


def test_a_matrix_is_one_taxel_or_features(tmp_path):
    path = write(tmp_path / "a.npz", X=SIGNALS[..., 0], y=CLASSES)
    refused("'X' is read as the signals of one taxel with `axes='trial,time'`, but features of each trial have no time",
            path, 100, "V")  # fmt: skip
    np.testing.assert_array_equal(nt.read_arrays(path, 100, "V", axes="trial,time").signals, SIGNALS[..., :1])
