"""Rasters: what is dense comes back dense, from every kind of file; what is no count of spikes is refused."""

import numpy as np
import pytest
from as_specs import of_raster
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from levels import examples
from scipy.io import savemat
from typer.testing import CliRunner

import neurotact as nt
from neurotact.cli import app
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import Windows
from neurotact.errors import InputError

RASTER = (np.random.default_rng(1).random((4, 50, 3)) < 0.2).astype(np.uint8)
CLASSES = ["tap", "rub", "tap", "rub"]


def dense(trains: nt.Recordings | SpikeTrains) -> np.ndarray:
    """The raster of trials of one length, `(trial, time, afferent)`."""
    assert isinstance(trains, SpikeTrains)
    n_steps = int(trains.trial_steps[0])
    return trains.raster(Windows(np.arange(len(trains)), np.zeros(len(trains), np.int64), n_steps))


def refused(message, *arguments, **options):
    with pytest.raises(InputError) as refusal:
        nt.read_raster(*arguments, **of_raster(options))
    assert message in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


@given(
    raster=arrays.arrays(
        st.sampled_from([np.uint8, np.bool_, np.float64, np.int32]),
        st.tuples(st.integers(1, 4), st.integers(1, 30), st.integers(1, 5)), elements=st.integers(0, 1),
    ),
    suffix=st.sampled_from(["npz", "npy", "mat"]),
)  # fmt: skip
@examples(30)
def test_a_raster_comes_back_as_it_was(tmp_path_factory, raster, suffix):
    folder = tmp_path_factory.mktemp("raster")
    path = folder / f"a.{suffix}"
    label = np.arange(len(raster)) % 2
    if suffix == "npz":
        np.savez(path, raster=raster, label=label)
    elif suffix == "npy":
        np.save(path, raster)
        np.save(folder / "y.npy", label)
    else:
        if raster.shape[-1] == 1:  # MATLAB drops a last axis of one
            return
        savemat(path, {"raster": raster.astype(np.uint8), "label": label[:, None]})
    options = {"conditions": folder / "y.npy"} if suffix == "npy" else {}
    if not raster.any():
        refused("holds no spike; give at least one", path, 1000, **options)
        return
    found = nt.read_raster(path, 1000, **of_raster(options))
    np.testing.assert_array_equal(dense(found), raster)
    assert found.conditions["label"].tolist() == [str(each) for each in label]
    nt.save(found, folder / "spikes.h5")
    np.testing.assert_array_equal(dense(nt.load(folder / "spikes.h5")), raster)


def test_names_conditions_axes_and_grids_are_those_of_arrays(tmp_path):
    turned = RASTER.transpose(2, 0, 1)
    np.savez(
        tmp_path / "a.npz", spikes=turned, y=CLASSES, day=[1, 1, 2, 2], channels=["SA-I a", "SA-I b", "RA-I a"], fs=500
    )
    found = nt.read_raster(tmp_path / "a.npz", axes="taxel,trial,time", where={"day": 2})
    np.testing.assert_array_equal(dense(found), RASTER[2:])
    assert found.afferents == ("SA-I a", "SA-I b", "RA-I a")
    assert {*found.populations} == {"SA-I", "RA-I"}
    assert found.sampling_rate_Hz == 500.0
    grid = np.repeat(RASTER[..., None], 2, axis=3)
    np.savez(tmp_path / "b.npz", X=grid, y=CLASSES)
    found = nt.read_raster(tmp_path / "b.npz", 500)
    assert found.afferents[:3] == ("r0c0", "r0c1", "r1c0")
    np.testing.assert_array_equal(dense(found), grid.reshape(4, 50, 6))
    np.savez(tmp_path / "c.npz", X=RASTER, y=CLASSES)
    assert nt.read_raster(tmp_path / "c.npz", 500).afferents == ("channel0", "channel1", "channel2")


def test_a_folder_holds_a_raster_per_trial(tmp_path, caplog):
    for trial, label in enumerate(CLASSES):
        (tmp_path / "in" / label).mkdir(parents=True, exist_ok=True)
        np.save(tmp_path / "in" / label / f"{trial}.npy", RASTER[trial, : 30 + trial].astype(bool))
    found = nt.read_raster(tmp_path / "in", 1000)
    assert found.conditions["label"].tolist() == ["rub", "rub", "tap", "tap"]
    assert found.trial_steps.tolist() == [31, 33, 30, 32]
    for trial, number in enumerate((1, 3, 0, 2)):
        steps, units = np.nonzero(RASTER[number, : 30 + number])
        assert found.steps[trial].tolist() == steps.tolist()
        assert found.units[trial].tolist() == units.tolist()
    assert not caplog.messages  # what is asked for as spikes is not doubted as signals
    for path in (tmp_path / "in").rglob("*.npy"):
        np.save(path, np.load(path).T)
    turned = nt.read_raster(
        tmp_path / "in", 1000, naming=nt.Naming(pattern="{trial}.npy"), layout=nt.Layout(transpose=True)
    )
    assert [each.tolist() for each in turned.steps] == [each.tolist() for each in found.steps]
    assert turned.conditions["trial"].tolist() == [1, 3, 0, 2]
    refused("`names` and `axes` are for one file with all trials", tmp_path / "in", 1000, axes="trial,time,taxel")
    np.savez(tmp_path / "a.npz", X=RASTER, y=CLASSES)
    refused("`pattern` is for a folder with a file per trial", tmp_path / "a.npz", 1000, pattern="{label}.npz")


def test_counts_are_one_spike_and_said(tmp_path, caplog):
    counts = RASTER.copy()
    counts[0, 0, 0] = 2
    np.savez(tmp_path / "a.npz", X=counts, y=CLASSES)
    n_events = int(counts.sum())
    found = nt.read_raster(tmp_path / "a.npz", 1000)
    np.testing.assert_array_equal(dense(found), counts > 0)
    (said,) = caplog.messages
    assert f"1 of {n_events} events" in said
    np.savez(tmp_path / "a.npz", X=3 * RASTER, y=CLASSES)
    lost = 2 * int(RASTER.sum())
    refused(f"{lost} of {3 * int(RASTER.sum())} events (66.7 %) share a step of 1 ms", tmp_path / "a.npz", 1000)
    refused("`merge_events=True`", tmp_path / "a.npz", 1000)
    np.testing.assert_array_equal(dense(nt.read_raster(tmp_path / "a.npz", 1000, merge_events=True)), RASTER)


@pytest.mark.parametrize("value", [-1, 0.5, np.nan, np.inf])
def test_values_that_count_nothing_are_refused(tmp_path, value):
    wrong = RASTER.astype(float)
    wrong[2, 7, 1] = value
    np.savez(tmp_path / "a.npz", X=wrong, y=CLASSES)
    refused(f"trial 2, step 7, afferent 1 is {value:g}, which is no count of spikes", tmp_path / "a.npz", 1000)


def test_the_command_writes_spikes(tmp_path):
    np.savez(tmp_path / "a.npz", data=RASTER, gesture=CLASSES)
    words = [
        "import",
        "raster",
        str(tmp_path / "a.npz"),
        "--names",
        "signals=data,label=gesture",
        "--sampling-rate-Hz",
        "1000",
    ]
    done = CliRunner().invoke(app, [*words, "--leave-out", "rub", "-o", str(tmp_path / "spikes.h5")])
    assert done.exit_code == 0, done.exception
    assert f"2 trials of 1 class, {RASTER[::2].sum()} spikes of 3 afferents, 50 steps at 1000 Hz" in done.output
    np.testing.assert_array_equal(dense(nt.load(tmp_path / "spikes.h5")), RASTER[::2])
