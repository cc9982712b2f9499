"""HDF5 files: what is written is read, and what cannot be read is named."""

import json

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from neurotact.data.hdf5 import load_recordings, load_spikes, save_recordings, save_spikes
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.errors import InputError

TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=12)
FINITE = st.floats(-1e6, 1e6, width=32)
COLUMNS = {
    "force_N": st.integers(-(2**63), 2**63 - 1),
    "speed_mm_per_s": st.floats(),
    "wet": st.booleans(),
    "who touched it?": TEXT,
}


@st.composite
def tables(draw, n_trials: int) -> pd.DataFrame:
    chosen = draw(st.lists(st.sampled_from(sorted(COLUMNS)), unique=True))
    columns = {"label": TEXT, **{name: COLUMNS[name] for name in chosen}}
    return pd.DataFrame(
        {name: draw(st.lists(values, min_size=n_trials, max_size=n_trials)) for name, values in columns.items()}
    )


@st.composite
def recordings(draw) -> Recordings:
    n_trials, n_taxels = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    lengths = st.just(draw(st.integers(1, 6))) if draw(st.booleans()) else st.integers(1, 6)
    signals = [draw(hnp.arrays(np.float32, (draw(lengths), n_taxels), elements=FINITE)) for _ in range(n_trials)]
    channels = draw(st.lists(TEXT, min_size=n_taxels, max_size=n_taxels, unique=True))
    stacked = len({len(s) for s in signals}) == 1 and draw(st.booleans())
    return Recordings(
        np.stack(signals) if stacked else signals,
        draw(st.floats(1e-3, 1e6)), draw(TEXT), draw(tables(n_trials)), tuple(channels), draw(TEXT),
    )  # fmt: skip


@st.composite
def spike_trains(draw) -> SpikeTrains:
    n_trials, n_afferents = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    rasters = [draw(hnp.arrays(np.uint8, (draw(st.integers(1, 8)), n_afferents), elements=st.integers(0, 1)))
               for _ in range(n_trials)]  # fmt: skip
    names = draw(st.lists(TEXT, min_size=n_afferents, max_size=n_afferents, unique=True))
    rate_Hz = draw(st.sampled_from([35.6, 1000.0, 2000.0]) | st.floats(1e-3, 1e6))
    digest = st.text("0123456789abcdef", min_size=16, max_size=16)
    digests = draw(st.just([]) | st.lists(digest, min_size=n_trials, max_size=n_trials))
    encoder, source = {"sa1": {"gain": 3.2}}, draw(TEXT)
    return from_rasters(rasters, rate_Hz, tuple(names), draw(tables(n_trials)), encoder, source, tuple(digests))


def same_conditions(found: pd.DataFrame, given_: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(found, given_, check_dtype=False)
    for column in given_:
        assert found[column].dtype.kind == given_[column].dtype.kind, column


@given(touch=recordings())
def test_recordings_come_back_equal(tmp_path, touch):
    path = tmp_path / "touch.h5"
    save_recordings(touch, path)
    again = load_recordings(path)
    for name in ("sampling_rate_Hz", "unit", "channels", "classes"):
        assert getattr(again, name) == getattr(touch, name)
    for one, other in zip(again.signals, touch.signals, strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
    same_conditions(again.conditions, touch.conditions)
    assert again.source == str(path)


@given(trains=spike_trains())
def test_spike_trains_come_back_equal(tmp_path, trains):
    save_spikes(trains, tmp_path / "spikes.h5")
    again = load_spikes(tmp_path / "spikes.h5")
    for name in ("sampling_rate_Hz", "afferents", "encoder", "source", "classes", "trial_digests"):
        assert getattr(again, name) == getattr(trains, name)
    for name in ("trial_steps", "labels", "is_sa"):
        np.testing.assert_array_equal(getattr(again, name), getattr(trains, name))
    for name in ("steps", "units"):
        for one, other in zip(getattr(again, name), getattr(trains, name), strict=True):
            np.testing.assert_array_equal(one, other, strict=True)
    same_conditions(again.conditions, trains.conditions)


@pytest.mark.parametrize("name", ["a/b", "", ".", "/", "a\x00b", "label/x"])
def test_a_condition_whose_name_hdf5_cannot_hold_is_refused(tmp_path, name):
    table = pd.DataFrame({"label": ["felt"], name: [1]})
    touch = Recordings([np.ones((4, 2))], 100.0, "mV", table)
    with pytest.raises(InputError, match="HDF5 cannot name a condition so"):
        save_recordings(touch, tmp_path / "touch.h5")
    assert not (tmp_path / "touch.h5").exists()


def small_recordings() -> Recordings:
    return Recordings([np.ones((4, 2)), np.zeros((3, 2))], 100.0, "mV", pd.DataFrame({"label": ["felt", "silk"]}))


def small_trains() -> SpikeTrains:
    rasters = [np.eye(4, dtype=np.uint8)] * 2
    names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
    return from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": ["felt", "silk"]}))


def test_spikes_lie_as_in_the_heidelberg_digits(tmp_path):
    save_spikes(small_trains(), tmp_path / "spikes.h5")
    with h5py.File(tmp_path / "spikes.h5") as file:
        assert file["spikes/times"][0].tolist() == [0.0, 0.001, 0.002, 0.003]
        assert file["spikes/units"][1].tolist() == [0, 1, 2, 3]
        assert file["labels"][()].tolist() == [0, 1]
        assert file.attrs["dt_s"] == 0.001


@pytest.fixture(scope="module", params=["recordings", "spikes"])
def written(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("written") / "file.h5"
    if request.param == "recordings":
        save_recordings(small_recordings(), path)
        return path.read_bytes(), load_recordings
    save_spikes(small_trains(), path)
    return path.read_bytes(), load_spikes


@given(share=st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_named(written, tmp_path, share):
    content, load = written
    path = tmp_path / "cut.h5"
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError) as refusal:
        load(path)
    assert str(refusal.value).startswith(f"{path}: cannot be read as")
    assert "; write it again with neurotact" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_file_of_another_kind_is_named(tmp_path):
    save_recordings(small_recordings(), tmp_path / "touch.h5")
    save_spikes(small_trains(), tmp_path / "spikes.h5")
    h5py.File(tmp_path / "other.h5", "w").close()
    for load, name, found in (
        (load_recordings, "spikes.h5", "holds spikes, not recordings"),
        (load_spikes, "touch.h5", "holds recordings, not spikes; make one with neurotact encode"),
        (load_spikes, "other.h5", "holds something else, not spikes"),
    ):
        with pytest.raises(InputError, match=f"{name}: {found}"):
            load(tmp_path / name)


@pytest.mark.parametrize("load", [load_recordings, load_spikes])
def test_a_file_that_is_no_hdf5_is_named(tmp_path, load):
    (tmp_path / "text.h5").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"text\.h5: cannot be read as"):
        load(tmp_path / "text.h5")
    for absent in (tmp_path / "absent.h5", tmp_path):
        with pytest.raises(InputError, match="there is no such file"):
            load(absent)


def broken(tmp_path, save, change):
    path = tmp_path / "file.h5"
    save(small_recordings() if save is save_recordings else small_trains(), path)
    with h5py.File(path, "a") as file:
        change(file)
    return path


def replaced(name, value):
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.pop("signals"), "cannot be read as recordings"),
        (lambda f: f.pop("conditions"), "cannot be read as recordings"),
        (lambda f: f.attrs.pop("unit"), "cannot be read as recordings"),
        (lambda f: f.attrs.update(channels="["), "cannot be read as recordings"),
        (lambda f: f.attrs.update(sampling_rate_Hz="fast"), "cannot be read as recordings"),
        (lambda f: f.attrs.update(sampling_rate_Hz=-1.0), "sampling_rate_Hz must be a positive number; got -1.0"),
        (lambda f: f.attrs.update(channels=json.dumps(["one"])), "trial 0 has 2 channels where 1 are expected"),
        (replaced("signals/lengths", [4, 4]), "holds 7 samples of 8; it is damaged"),
        (replaced("signals/lengths", 7), "cannot be read as recordings"),
        (replaced("signals/lengths", b"x"), "cannot be read as recordings"),
        (replaced("signals/values", np.ones(7)), "trial 0 has shape (4,)"),
        (replaced("signals/values", np.full((7, 2), np.nan)), "trial 0, sample 0, taxel1 is NaN"),
        (replaced("conditions/label", ["felt"]), "2 trials but 1 rows of conditions"),
        (lambda f: f["conditions"].attrs.update(columns="[]"), "has no column 'label'"),
    ],
)
def test_recordings_that_do_not_fit_together_are_named(tmp_path, change, message):
    path = broken(tmp_path, save_recordings, change)
    with pytest.raises(InputError) as refusal:
        load_recordings(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert message in str(refusal.value)


def vlen(*trials, kind=np.float64):
    boxed = np.empty(len(trials), object)
    boxed[:] = [np.array(trial, kind) for trial in trials]
    return boxed


def events(name, *trials, kind=np.float64):
    def change(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, data=vlen(*trials, kind=kind), dtype=h5py.vlen_dtype(kind))

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (events("spikes/times", [0.0, 0.001, 0.002, 0.003]), "differ in number of trials"),
        (events("spikes/times", [0, 0.001, 0.002, 0.004], [0, 0, 0, 0]), "trial 0 has spikes"),
        (events("spikes/times", [0, 0, 0, 0], [-0.001, 0, 0, 0]), "trial 1 has spikes"),
        (events("spikes/times", [0, 0, 0, 0], [0, 0.002, 0.001, 0.003]), "trial 1 has spikes out of order"),
        (events("spikes/times", [0, 0, 0], [0, 0, 0, 0]), "trial 0 has spikes"),
        (events("spikes/units", [0, 1, 2, 4], [0, 1, 2, 3], kind=np.uint16), "trial 0 has spikes"),
        (events("spikes/units", [0, 1, 2, 3], [0, 1, 2, -3], kind=np.int64), "trial 1 has spikes"),
        (lambda f: f.attrs.update(sampling_rate_Hz=np.nan), "sampling_rate_Hz must be a positive number"),
        (lambda f: f.pop("labels") and f.pop("trial_steps"), "cannot be read as spikes"),
        (lambda f: f["conditions"].move("label", "lable"), "cannot be read as spikes"),
        (lambda f: f.attrs.update(encoder="[]"), "the encoder is no table"),
        (lambda f: f.create_dataset("trial_digests", data=[b"0" * 16]), "trial_digests differ in number of trials"),
        (lambda f: f.create_dataset("trial_digests", data=np.ones((2, 2))), "cannot be read as spikes"),
        (lambda f: f.create_dataset("trial_digests", data=b"0" * 16), "cannot be read as spikes"),
        (lambda f: f.create_dataset("trial_digests", data=[b"\xff", b"\xff"]), "cannot be read as spikes"),
    ],
)
def test_spikes_that_do_not_fit_together_are_named(tmp_path, change, message):
    path = broken(tmp_path, save_spikes, change)
    with pytest.raises(InputError) as refusal:
        load_spikes(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert message in str(refusal.value)


def test_spikes_without_labels_are_named(tmp_path):
    trains = small_trains()
    save_spikes(trains, tmp_path / "spikes.h5")
    with h5py.File(tmp_path / "spikes.h5", "a") as file:
        file["conditions"].attrs["columns"] = json.dumps(["lable"])
        file["conditions"].move("label", "lable")
    with pytest.raises(InputError, match="has no column 'label'"):
        load_spikes(tmp_path / "spikes.h5")
