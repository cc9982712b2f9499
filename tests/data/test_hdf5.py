"""HDF5 files: what is written is read, and what cannot be read is named."""

import io
import json
import os
import zlib
from dataclasses import replace

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from neurotact.data import hdf5, hdf5_input
from neurotact.data.hdf5 import (
    load_recordings,
    load_spikes,
    open_recordings,
    save_recordings,
    save_spikes,
    spike_writer,
)
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, TrialSpikes, from_rasters
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
    columns = {"label": TEXT.filter(str.strip), **{name: COLUMNS[name] for name in chosen}}
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
    trains = from_rasters(rasters, rate_Hz, tuple(names), draw(tables(n_trials)), encoder, source, tuple(digests))
    return replace(trains, touch_s=draw(st.none() | st.floats(0, 1e3)))


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
    for name in ("sampling_rate_Hz", "afferents", "encoder", "source", "classes", "trial_digests", "touch_s"):
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


def test_spikes_lie_end_to_end(tmp_path):
    save_spikes(small_trains(), tmp_path / "spikes.h5")
    with h5py.File(tmp_path / "spikes.h5") as file:
        assert file["spikes/steps"][()].tolist() == file["spikes/units"][()].tolist() == [0, 1, 2, 3] * 2
        assert file["spikes/lengths"][()].tolist() == [4, 4]
        assert file["labels"][()].tolist() == [0, 1]
        assert file.attrs["dt_s"] == 0.001


def as_earlier(file: h5py.File) -> None:
    """The spikes of a file as earlier versions wrote them: a row of variable length for each trial, as in the SHD."""
    ends = np.cumsum(file["spikes/lengths"][()])[:-1]
    times, units = file["spikes/steps"][()] / file.attrs["sampling_rate_Hz"], file["spikes/units"][()]
    del file["spikes"], file.attrs["layout"]
    for name, values, kind in (("times", times, np.float64), ("units", units, np.uint16)):
        rows = file.create_dataset(f"spikes/{name}", (len(ends) + 1,), h5py.vlen_dtype(kind))
        for trial, row in enumerate(np.split(values, ends)):
            rows[trial] = row
    for name in file["conditions"]:
        column = file["conditions"][name]
        if column.dtype.kind == "S":
            replaced(f"conditions/{name}", column.asstr()[()])(file)


@given(trains=spike_trains())
def test_files_of_earlier_versions_are_read(tmp_path, trains):
    path = tmp_path / "spikes.h5"
    save_spikes(trains, path)
    now = load_spikes(path)
    with h5py.File(path, "a") as file:
        as_earlier(file)
    before = load_spikes(path)
    for name in ("steps", "units"):
        for one, other in zip(getattr(before, name), getattr(now, name), strict=True):
            np.testing.assert_array_equal(one, other, strict=True)
    pd.testing.assert_frame_equal(before.conditions, now.conditions)


def test_steps_of_any_kind_of_integer_are_read_as_int64(tmp_path):
    path = broken(tmp_path, save_spikes, replaced("spikes/steps", np.array([0, 1, 2, 3] * 2, np.uint16)))
    assert {steps.dtype for steps in load_spikes(path).steps} == {np.dtype(np.int64)}


def test_spikes_and_tables_of_many_trials_are_small(tmp_path):
    """At most 2.5 bytes a spike where there are 50 in a trial, of which a time and a unit took 10 alone."""
    rng = np.random.default_rng(0)
    n_trials, n_spikes = 2000, 50
    trials = [TrialSpikes(np.sort(rng.integers(0, 1000, n_spikes)), rng.integers(0, 16, n_spikes), 1000)] * n_trials
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 1000, "speed": np.repeat([1.5, 2.5], 1000)})
    path, names = tmp_path / "spikes.h5", tuple(f"SA-I {taxel}" for taxel in range(16))
    with spike_writer(path, conditions, 1000.0, names, {}, "") as writer:
        for trial in trials:
            writer.append(trial)
    assert path.stat().st_size < 2.5 * n_trials * n_spikes
    again = load_spikes(path)
    for trial in (0, 999, 1000, 1999):
        assert (again.steps[trial] == trials[trial].steps).all()
        assert (again.units[trial] == trials[trial].units).all()


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
    for other, found in (("absent.h5", "there is no such file"), (".", "is a folder; name a file")):
        with pytest.raises(InputError, match=found):
            load(tmp_path / other)


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
        (replaced("conditions/label", ["felt"]), "2 trials but 1 row of conditions"),
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
        as_earlier(file)
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
        (replaced("spikes/steps", [0, 1, 2, 4, 0, 1, 2, 3]), "trial 0 has spikes"),
        (replaced("spikes/steps", [0, 1, 2, 3, 0, 2, 1, 3]), "trial 1 has spikes out of order"),
        (replaced("spikes/steps", [0, 1, 2, 3, -1, 0, 1, 2]), "trial 1 has spikes"),
        (replaced("spikes/steps", np.zeros(8)), "cannot be read as spikes"),
        (replaced("spikes/units", [0, 1, 2, 4, 0, 1, 2, 3]), "trial 0 has spikes"),
        (replaced("spikes/units", [0, 1, 2]), "holds 8 and 3 spikes of 8; it is damaged"),
        (replaced("spikes/lengths", [4, 5]), "holds 8 and 8 spikes of 9; it is damaged"),
        (replaced("spikes/lengths", [9, -1]), "holds 8 and 8 spikes of 8; it is damaged"),
        (replaced("spikes/lengths", [8]), "differ in number of trials"),
        (lambda f: f.attrs.update(layout=3), "has layout 3, of a later neurotact; update this one"),
        (lambda f: f.attrs.update(layout="new"), "cannot be read as spikes"),
        (lambda f: f.attrs.update(sampling_rate_Hz=np.nan), "sampling_rate_Hz must be a positive number"),
        (lambda f: f.pop("labels") and f.pop("trial_steps"), "cannot be read as spikes"),
        (lambda f: f.attrs.update(touch_s=-0.1), "touch_s: must be a time in s, at least 0"),
        (lambda f: f.attrs.update(touch_s=np.nan), "touch_s: must be a time in s, at least 0"),
        (lambda f: f.attrs.update(touch_s="late"), "cannot be read as spikes"),
        (lambda f: f["conditions"].move("label", "lable"), "cannot be read as spikes"),
        (lambda f: f.attrs.update(encoder="[]"), "cannot be read as spikes (holds [] where a table is expected)"),
        (lambda f: f.create_dataset("trial_digests", data=[b"0" * 16]), "trial_digests differ in number of trials"),
        (lambda f: f.create_dataset("trial_digests", data=np.ones((2, 2))), "cannot be read as spikes"),
        (lambda f: f.create_dataset("trial_digests", data=b"0" * 16), "cannot be read as spikes"),
        (lambda f: f.create_dataset("trial_digests", data=[b"\xff", b"\xff"]), "trial_digests holds"),
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


# --- what a file declares ---------------------------------------------------------------------------


def declared(name, shape, kind=np.float32, **options):
    """The dataset in the place of another, declared and never written."""

    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file.create_dataset(name, shape, kind, **options)

    return change


def both(*changes):
    def change(file: h5py.File) -> None:
        for one in changes:
            one(file)

    return change


def inflated(times):
    """A gzip chunk that holds so many times what it declares."""

    def change(file: h5py.File) -> None:
        del file["signals/values"]
        values = file.create_dataset("signals/values", (7, 2), np.float32, chunks=(7, 2), compression="gzip")
        values.id.write_direct_chunk((0, 0), zlib.compress(bytes(7 * 2 * 4 * times)))

    return change


def one_row_many_times(file: h5py.File) -> None:
    """Rows that all point to the same megabyte of the file: a few bytes each, and together far more than the file."""
    as_earlier(file)
    n_rows, row = 2000, np.zeros(131_072)
    for name in ("spikes/times", "spikes/units", "trial_steps", "conditions/label", "labels"):
        del file[name]
    times = file.create_dataset("spikes/times", (n_rows,), h5py.vlen_dtype(np.float64))
    times[0] = row
    file.flush()
    place = times.id.get_offset()
    with open(file.filename, "r+b") as raw:
        raw.seek(place)
        reference = raw.read(16)
        raw.seek(place)
        raw.write(reference * n_rows)
    file.create_dataset("spikes/units", (n_rows,), h5py.vlen_dtype(np.uint16))
    file["trial_steps"] = np.full(n_rows, 10**6)
    file["conditions"].create_dataset("label", data=["felt"] * n_rows, dtype=h5py.string_dtype())


def elsewhere(name):
    """The dataset in the place of a link to one in another file."""

    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = h5py.ExternalLink("/dev/zero", "values")

    return change


def columns(*found):
    return lambda file: file["conditions"].attrs.update(columns=json.dumps(found))


LARGE = 750_000_000

BOMBS = {
    "much declared": (
        both(declared("signals/values", (LARGE, 1)), replaced("signals/lengths", [LARGE])),
        "signals/values declares 3,000 MB in a file of 0.0 MB; write it again, or set NEUROTACT_MAX_MB",
    ),
    "much declared in chunks": (
        both(
            declared("signals/values", (LARGE, 1), chunks=(1000, 1), compression="gzip"),
            replaced("signals/lengths", [LARGE]),
        ),
        "signals/values declares 3,000 MB",
    ),
    "large chunks": (
        declared("signals/values", (10**8, 1), chunks=(10**8, 1), compression="gzip"),
        "signals/values is stored in chunks of 400 MB, more than 32 MB",
    ),
    "chunks side by side": (
        declared("signals/values", (10**5, 90), chunks=(10**5, 1)),
        "signals/values is stored in chunks of 36 MB, more than 32 MB",
    ),
    "a chunk that inflates": (inflated(1000), "signals/values inflates to more than it declares"),
    "another compression": (
        declared("signals/values", (7, 2), chunks=(7, 2), compression="lzf"),
        "signals/values is compressed in a way that neurotact does not read",
    ),
    "many lengths": (
        declared("signals/lengths", (10**9,), np.int64),
        "holds 8,000 MB, more than the limit of 512 MB",
    ),
    "lengths below 0": (replaced("signals/lengths", [-1, 8]), "holds 7 samples of 7; it is damaged"),
    "lengths that overflow": (replaced("signals/lengths", [2**62, 2**62, 2**62, 2**62 + 7]), "it is damaged"),
    "lengths that are no integers": (replaced("signals/lengths", [4.0, 3.0]), "signals/lengths holds float64"),
    "no trials": (
        both(replaced("signals/lengths", np.zeros(0, np.int64)), declared("signals/values", (0, 2))),
        "holds no trial",
    ),
    "another file": (elsewhere("signals/values"), "signals/values is not in the file"),
    "another group": (elsewhere("conditions"), "conditions is not in the file"),
    "external storage": (
        declared("signals/values", (7, 2), external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)]),
        "signals/values lies in another file",
    ),
    "a column twice": (columns("label", "label"), "a condition occurs twice in its table"),
    "a column of another length": (
        declared("conditions/label", (10**9,), np.int64),
        "2 trials but 1000000000 rows of conditions in conditions/label",
    ),
    "a label that is not UTF-8": (
        replaced("conditions/label", np.array([b"felt", b"caf\xe9"])),
        r"conditions/label holds b'caf\xe9', which is not UTF-8; rename it",
    ),
    "a unit that is not UTF-8": (
        lambda f: f.attrs.update(unit=np.bytes_(b"caf\xe9")),
        r"unit holds b'caf\xe9', which is not UTF-8; rename it",
    ),
    "channels that are no names": (lambda f: f.attrs.update(channels="[1, 2]"), "holds 1 where a name is expected"),
    "channels of one name": (lambda f: f.attrs.update(channels='["a", "a"]'), "two channels are called 'a'"),
    "deep nesting": (lambda f: f.attrs.update(channels="[" * 30_000), "cannot be read as recordings"),
    "an attribute of many values": (
        lambda f: f.attrs.update(unit=np.array(["mV"] * 3, object)),
        "unit is not a single value",
    ),
}


@pytest.mark.parametrize("load", [load_recordings, lambda path: open_recordings(path).__enter__()])
@pytest.mark.parametrize("name", BOMBS)
def test_recordings_that_declare_what_they_do_not_hold_are_refused(tmp_path, name, load):
    change, message = BOMBS[name]
    path = broken(tmp_path, save_recordings, change)
    with pytest.raises(InputError) as refusal:
        load(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert message in str(refusal.value)
    assert len(str(refusal.value)) < 600
    assert str(refusal.value).isprintable()


SPIKE_BOMBS = {
    "long trials": (replaced("trial_steps", [2**62, 2**62]), "trial_steps: must lie between 0 and 2^40 steps"),
    "trials below 0": (replaced("trial_steps", [-1, 4]), "trial_steps: must lie between 0 and 2^40 steps; got -1"),
    "a table of lengths": (replaced("trial_steps", [[4, 4], [4, 4]]), "trial_steps has the shape (2, 2)"),
    "lengths that are no integers": (replaced("trial_steps", [4.0, 4.0]), "trial_steps: must be a whole number"),
    "one row many times": (one_row_many_times, "MB, more than the limit of 512 MB"),
    "times that are no times": (events("spikes/times", [np.nan] * 4, [np.inf] * 4), "trial 0 has spikes"),
    "rows of texts": (
        both(as_earlier, declared("spikes/units", (2,), h5py.string_dtype())),
        "spikes/units does not hold rows of numbers",
    ),
    "many spikes": (
        both(declared("spikes/steps", (10**9,), np.int64), replaced("spikes/lengths", [10**9, 0])),
        "holds 8,000 MB, more than the limit of 512 MB",
    ),
    "lengths that overflow": (replaced("spikes/lengths", [2**62, 2**62, 2**62, 2**62 + 8]), "it is damaged"),
    "an encoder that is no table": (
        lambda f: f.attrs.update(encoder="[]"),
        "cannot be read as spikes (holds [] where a table is expected)",
    ),
    "afferents that are no names": (lambda f: f.attrs.update(afferents="[1, 2]"), "holds 1 where a name is expected"),
    "afferents that no file can hold": (
        lambda f: f.attrs.update(afferents=json.dumps(["SA-I \udce9", "b", "c", "d"])),
        "cannot be read as spikes",
    ),
}


@pytest.mark.parametrize("name", SPIKE_BOMBS)
def test_spikes_that_declare_what_they_do_not_hold_are_refused(tmp_path, name):
    change, message = SPIKE_BOMBS[name]
    path = broken(tmp_path, save_spikes, change)
    with pytest.raises(InputError) as refusal:
        load_spikes(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert message in str(refusal.value)
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize(
    "options", [{}, {"shuffle": True}, {"shuffle": True, "fletcher32": True}, {"compression": None}], ids=str
)
def test_recordings_compressed_with_gzip_are_read(tmp_path, options):
    touch = small_recordings()
    values = np.concatenate(touch.signals)

    def compressed(file: h5py.File) -> None:
        del file["signals/values"]
        file.create_dataset("signals/values", data=values, chunks=(3, 1), **{"compression": "gzip", **options})

    again = load_recordings(broken(tmp_path, save_recordings, compressed))
    np.testing.assert_array_equal(np.concatenate(again.signals), values)


@given(touch=recordings(), data=st.data())
def test_stored_recordings_are_those_in_memory(tmp_path, touch, data):
    path = tmp_path / "touch.h5"
    save_recordings(touch, path)
    chosen = np.array(data.draw(st.lists(st.integers(0, len(touch) - 1), min_size=1, max_size=6)))
    with open_recordings(path) as stored:
        part, expected = stored.select(chosen), touch.select(chosen)
        assert (part.classes, part.channels, part.unit) == (expected.classes, expected.channels, expected.unit)
        assert part.lengths.tolist() == expected.lengths.tolist()
        for one, other in zip(part.loaded().signals, expected.signals, strict=True):
            np.testing.assert_array_equal(one, other, strict=True)
        trial, begin, end = data.draw(st.tuples(st.integers(0, len(chosen) - 1), st.integers(0, 7), st.integers(0, 7)))
        np.testing.assert_array_equal(part.piece(trial, begin, end), expected.piece(trial, begin, end), strict=True)
        same_conditions(part.conditions, expected.conditions)
        mask = np.isin(np.arange(len(touch)), chosen)
        assert stored.select(mask).lengths.tolist() == touch.select(mask).lengths.tolist()


def test_a_file_larger_than_the_limit_is_read_in_pieces_but_not_whole(tmp_path, monkeypatch):
    touch = Recordings([np.ones((300_000, 1))] * 2, 1000.0, "mV", pd.DataFrame({"label": ["felt", "silk"]}))
    save_recordings(touch, tmp_path / "touch.h5")
    monkeypatch.setenv("NEUROTACT_MAX_MB", "1")
    with open_recordings(tmp_path / "touch.h5") as stored:
        assert stored.piece(1, 299_998, 300_000).tolist() == [[1], [1]]
    with pytest.raises(InputError, match=r"touch\.h5: holds 2 MB, more than the limit of 1 MB; set NEUROTACT_MAX_MB"):
        load_recordings(tmp_path / "touch.h5")


@pytest.mark.parametrize("place", [0, 1, 6, 1020, 1021, 1022, 1023, 1024, 1025, 1026, 1027, 3000, 3071])
def test_heaps_are_found_wherever_they_begin(monkeypatch, place):
    monkeypatch.setattr(hdf5_input, "BLOCK_BYTES", 1024)
    content = bytes(place) + hdf5_input.HEAP + bytes(500) + hdf5_input.HEAP
    assert set(hdf5_input._heaps(io.BytesIO(content))) == {place, place + 508}
    assert not [*hdf5_input._heaps(io.BytesIO(content.replace(b"GCOL", b"GCOM")))]


@pytest.mark.skipif(not hasattr(os, "SEEK_DATA"), reason="the system knows no holes")
@pytest.mark.parametrize("place", [0, 5000, 2**38 + 4093])
def test_a_heap_is_found_beside_holes_of_any_size_which_are_not_read(tmp_path, place):
    path = tmp_path / "sparse.h5"
    with path.open("wb") as file:
        file.seek(place)
        file.write(hdf5_input.HEAP + (8).to_bytes(8, "little"))
        file.truncate(2**39)  # 512 GB: reading it would outlast the suite
    hdf5_input.check_heaps(path)
    with path.open("r+b") as file:
        file.seek(place + 8)
        file.write((2**20).to_bytes(8, "little"))  # its first object is a hole, of the size 0
    with pytest.raises(OSError, match=f"the heap at byte {place} of sparse.h5 is damaged"):
        hdf5_input.check_heaps(path)


def test_a_file_is_opened_once(tmp_path, monkeypatch):
    checked = []
    monkeypatch.setattr(hdf5_input, "check_heaps", checked.append)
    signals, conditions = np.zeros((1, 3, 1)), pd.DataFrame({"label": ["felt"]})
    save_recordings(Recordings(signals, 1000.0, "mV", conditions, ("taxel1",), "made"), tmp_path / "touch.h5")
    assert isinstance(hdf5.load(tmp_path / "touch.h5"), Recordings)
    assert checked == [tmp_path / "touch.h5"]


@pytest.mark.parametrize("load", [load_spikes, hdf5.load])
def test_a_heap_that_would_be_read_for_ever_is_refused(tmp_path, load):
    conditions = pd.DataFrame({"label": ["felt", "silk"]})
    trains = from_rasters(np.eye(4, dtype=np.uint8)[None].repeat(2, 0), 1000.0, ("SA-I a",) * 4, conditions)
    save_spikes(trains, tmp_path / "spikes.h5")
    content = bytearray((tmp_path / "spikes.h5").read_bytes())
    heap = content.index(b"GCOL\x01")
    content[heap + 16 : heap + 32] = bytes(16)  # the first object becomes free space of the size 0
    (tmp_path / "spikes.h5").write_bytes(content)
    with pytest.raises(InputError, match=r"the heap at byte \d+ of spikes.h5 is damaged"):
        load(tmp_path / "spikes.h5")


@pytest.mark.parametrize("name", ["encoder", "columns"])
def test_a_text_that_is_longer_than_its_file_is_refused_before_it_is_read(tmp_path, name):
    save_spikes(small_trains(), tmp_path / "spikes.h5")
    content = bytearray((tmp_path / "spikes.h5").read_bytes())
    at = content.index(b"\x01\0" + (len(name) + 1).to_bytes(2, "little") + b"\x14\0\x08\0" + name.encode())
    length = at + 8 + 8 + 24 + 8  # after the sizes, and the padded name, type and space
    assert 0 < int.from_bytes(content[length : length + 4], "little") < 2000
    content[length : length + 4] = (2**31).to_bytes(4, "little")
    (tmp_path / "spikes.h5").write_bytes(content)
    with pytest.raises(InputError, match=f"the length of {name} is damaged"):
        load_spikes(tmp_path / "spikes.h5")


@pytest.mark.parametrize("stored", [{}, {"chunks": (2,)}, {"chunks": (2,), "compression": "gzip", "shuffle": True}])
def test_a_row_that_is_longer_than_its_file_is_refused_before_it_is_read(tmp_path, stored):
    """libhdf5 would take 16 GB for it."""
    path = tmp_path / "rows.h5"
    with h5py.File(path, "w") as file:
        rows = file.create_dataset("rows", (3,), h5py.vlen_dtype(np.float64), **stored)
        for index in range(3):
            rows[index] = np.arange(5.0 + index)
        if not stored:
            at = rows.id.get_offset()
        else:
            rows.id.write_direct_chunk((0,), _damaged(rows.id.read_direct_chunk((0,))[1], stored))
    if not stored:
        content = bytearray(path.read_bytes())
        content[at : at + 4] = (2**31).to_bytes(4, "little")
        path.write_bytes(content)
    with h5py.File(path, "r") as file, pytest.raises(OSError, match="the length of rows is damaged"):
        hdf5_input.Declared(file, path).rows("rows", "f")


def test_rows_of_variable_length_are_read_compressed_too(tmp_path):
    path = tmp_path / "rows.h5"
    with h5py.File(path, "w") as file:
        stored = file.create_dataset("rows", (3,), h5py.vlen_dtype(np.float64), chunks=(2,), compression="gzip")
        for index in range(3):
            stored[index] = np.arange(5.0 + index)
    with h5py.File(path, "r") as file:
        rows = hdf5_input.Declared(file, path).rows("rows", "f")
    assert [row.tolist() for row in rows] == [[*range(5 + index)] for index in range(3)]


def _damaged(chunk: bytes, stored: dict) -> bytes:
    """A chunk of references whose first has an impossible length."""
    is_packed = "compression" in stored
    cells = np.frombuffer(zlib.decompress(chunk) if is_packed else chunk, np.uint8)
    cells = cells.reshape(16, -1).T.copy() if is_packed else cells.reshape(-1, 16).copy()
    cells[0, :4] = np.frombuffer((2**31).to_bytes(4, "little"), np.uint8)
    return zlib.compress(cells.T.tobytes()) if is_packed else cells.tobytes()
