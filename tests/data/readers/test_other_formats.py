"""Formats of other programs: what they write is read as trials; a missing package and a damaged file are named."""

import sys

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import wavfile

import neurotact as nt
from neurotact.errors import InputError
from neurotact.files import MAX_MB

SIGNAL = np.random.default_rng(3).integers(-900, 900, size=(40, 2)).astype(np.int16)
BAG_TYPES = ("std_msgs/msg/Float32MultiArray", "std_msgs/msg/MultiArrayLayout")


def attempt(read):
    """The recordings, or None and why they were refused."""
    try:
        return read(), ""
    except InputError as error:
        return None, str(error)


def parquet(path):
    pytest.importorskip("pyarrow")
    pd.DataFrame({"t_ms": 5 * np.arange(len(SIGNAL)), "left": SIGNAL[:, 0], "right": SIGNAL[:, 1]}).to_parquet(path)


def sound(path):
    wavfile.write(path, 200, SIGNAL)


def flac(path):
    pytest.importorskip("soundfile").write(path, SIGNAL, 200, subtype="PCM_16")


def bag(path, n_numbers=lambda row: 2):
    """A bag of ROS 1, or one of ROS 2 in a folder of its own, in which the file has the name of the folder."""
    rosbag1, rosbag2 = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.rosbag2")
    stores = pytest.importorskip("rosbags.typesys")
    is_first = path.suffix == ".bag"
    types = stores.get_typestore(stores.Stores.ROS1_NOETIC if is_first else stores.Stores.LATEST)
    message, layout = (types.types[name] for name in BAG_TYPES)
    place = path if is_first else path.with_suffix("")
    storage = {".db3": "SQLITE3", ".mcap": "MCAP"}.get(path.suffix)
    options = {} if is_first else {"version": 9, "storage_plugin": rosbag2.StoragePlugin[storage]}
    with (rosbag1 if is_first else rosbag2).Writer(place, **options) as writer:
        to = writer.add_connection("/touch", message.__msgtype__, typestore=types)
        for row, values in enumerate(SIGNAL.astype(np.float32)):
            made = message(layout([], 0), values[: n_numbers(row)])
            raw = types.serialize_ros1(made, BAG_TYPES[0]) if is_first else types.serialize_cdr(made, BAG_TYPES[0])
            writer.write(to, 1_700_000_000_000_000_000 + 5_000_000 * row, raw)
    return path if is_first else next(place.glob(f"*{path.suffix}"))


@pytest.mark.parametrize(
    ("write", "suffix", "channels"),
    [
        (parquet, ".parquet", ("left", "right")),
        (sound, ".wav", ("channel1", "channel2")),
        (flac, ".flac", ("channel1", "channel2")),
        (bag, ".bag", ("data.0", "data.1")),
        (bag, ".db3", ("data.0", "data.1")),
        (bag, ".mcap", ("data.0", "data.1")),
    ],
)
def test_a_file_is_a_trial_at_the_rate_that_it_says(tmp_path, write, suffix, channels):
    for label in ("felt", "silk"):
        (tmp_path / label).mkdir()
        write(tmp_path / label / f"a{suffix}")
    found = nt.read_folder(tmp_path, unit="count")
    assert (found.channels, found.sampling_rate_Hz, found.classes) == (channels, 200.0, ("felt", "silk"))
    for signal in found.signals:
        np.testing.assert_array_equal(signal, SIGNAL.astype(np.float32))
    assert nt.read_folder(tmp_path, unit="count", layout=nt.Layout(columns=channels[1])).channels == channels[1:]
    if write is not bag:
        assert found.conditions["file"].tolist() == [f"felt/a{suffix}", f"silk/a{suffix}"]


@pytest.mark.parametrize("held", [{"a": SIGNAL, "b": -SIGNAL}, [SIGNAL, -SIGNAL], SIGNAL])
def test_each_tensor_is_a_trial(tmp_path, held):
    (tmp_path / "felt").mkdir()
    arrays = [*held.values()] if isinstance(held, dict) else held if isinstance(held, list) else [held]
    tensors = [torch.from_numpy(array) for array in arrays]
    saved = (
        dict(zip(held, tensors, strict=True)) if isinstance(held, dict) else tensors if len(tensors) > 1 else tensors[0]
    )
    torch.save(saved, tmp_path / "felt" / "t.pt")
    found = nt.read_folder(tmp_path, 200, "count")
    np.testing.assert_array_equal(np.stack([*found.signals]), np.stack(arrays).astype(np.float32))


def test_tensors_of_all_trials_are_read_as_arrays(tmp_path):
    stack = torch.stack([torch.from_numpy(SIGNAL)] * 2).to(torch.bfloat16)
    torch.save({"data": stack, "label": torch.tensor([0, 1])}, tmp_path / "all.pt")
    found = nt.read_arrays(tmp_path / "all.pt", 200, "count")
    assert found.classes == ("0", "1")
    np.testing.assert_array_equal(found.signals[1], stack[1].float().numpy())


@pytest.mark.parametrize("held", [{"model": object()}, {"a": "text"}, {}, {"a": torch.ones(3).to_sparse()}])
def test_what_is_no_tensor_is_never_loaded(tmp_path, held):
    torch.save(held, tmp_path / "all.pt")
    with pytest.raises(InputError, match=r"all\.pt: .*; save a tensor, or a dict of tensors, with torch\.save"):
        nt.read_arrays(tmp_path / "all.pt", 200, "count")


def test_a_parquet_file_holds_all_trials(tmp_path):
    pytest.importorskip("pyarrow")
    rows = pd.DataFrame({"trial": np.repeat([0, 1], 20), "label": np.repeat(["felt", "silk"], 20), "speed": 5})
    rows = rows.assign(
        when=pd.Timestamp("2024-01-31") + pd.to_timedelta(5 * np.arange(40), "ms"), left=SIGNAL[:, 0], ok=True
    )
    rows.to_parquet(tmp_path / "all.parquet")
    found = nt.read_table(tmp_path / "all.parquet", unit="count")
    assert (found.channels, found.sampling_rate_Hz, found.lengths.tolist()) == (("left",), 200.0, [20, 20])
    assert found.conditions[["label", "speed"]].values.tolist() == [["felt", 5], ["silk", 5]]
    rows["left"] = rows["left"].where(rows.index != 7)
    rows.to_parquet(tmp_path / "all.parquet")
    with pytest.raises(InputError, match=r"sample 7, column 5 \(left\) is nan; repair the gap"):
        nt.read_table(tmp_path / "all.parquet", unit="count")
    assert nt.read_table(
        tmp_path / "all.parquet", unit="count", layout=nt.Layout(missing="interpolate")
    ).lengths.tolist() == [20, 20]


def test_annotations_cut_a_sound(tmp_path):
    sound(tmp_path / "all.wav")
    (tmp_path / "marks.csv").write_text("begin_s,end_s,label\n0.01,0.05,felt\n0.1,0.15,silk\n")
    found = nt.read_table(tmp_path / "all.wav", unit="count", annotations=tmp_path / "marks.csv")
    assert (found.sampling_rate_Hz, found.lengths.tolist(), found.classes) == (200.0, [8, 10], ("felt", "silk"))
    np.testing.assert_array_equal(found.signals[0], SIGNAL[2:10])
    with pytest.raises(InputError, match="`decimal` is for text files"):
        nt.read_table(
            tmp_path / "all.wav", unit="count", annotations=tmp_path / "marks.csv", layout=nt.Layout(decimal=",")
        )


def test_the_header_of_a_message_says_its_time(tmp_path):
    rosbag1, stores = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.typesys")
    types = stores.get_typestore(stores.Stores.ROS1_NOETIC)
    names = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench", "geometry_msgs/msg/Vector3")
    stamped, wrench, vector = (types.types[name] for name in names)
    header, time = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    (tmp_path / "felt").mkdir()
    with rosbag1.Writer(tmp_path / "felt" / "a.bag") as writer:
        to = writer.add_connection("/force", stamped.__msgtype__, typestore=types)
        for row, (x, y) in enumerate(SIGNAL.astype(float).tolist()):
            at = time(7 + row // 20, 50_000_000 * (row % 20))
            made = stamped(header(row, at, "tip"), wrench(vector(x, y, float(row)), vector(0.0, 0.0, float(row % 3))))
            writer.write(to, 10**18 + 10**9 * row, types.serialize_ros1(made, names[0]))
    found = nt.read_folder(tmp_path, unit="N", layout=nt.Layout(columns="wrench.force.x,wrench.force.y"))
    assert (found.sampling_rate_Hz, found.conditions["file"].tolist()) == (20.0, ["felt/a.bag:force"])
    np.testing.assert_array_equal(found.signals[0], SIGNAL.astype(np.float32))
    assert nt.read_folder(tmp_path, unit="N").channels[-1] == "wrench.torque.z"


@pytest.mark.parametrize(
    ("write", "suffix", "n_rows"), [(parquet, ".parquet", 70_000), (flac, ".flac", 300_000), (bag, ".bag", 5_000)]
)
def test_what_would_take_more_than_the_limit_is_refused(tmp_path, monkeypatch, write, suffix, n_rows):
    monkeypatch.setitem(globals(), "SIGNAL", np.zeros((n_rows, 2), np.int16))
    (tmp_path / "felt").mkdir()
    write(tmp_path / "felt" / f"a{suffix}")
    assert (tmp_path / "felt" / f"a{suffix}").stat().st_size < 1e6
    monkeypatch.setenv(MAX_MB, "1")
    with pytest.raises(InputError, match=rf"a{suffix}: .*more than the limit of 1 MB"):
        nt.read_folder(tmp_path, unit="count")


def test_an_index_is_a_column_and_a_class_that_is_missing_is_empty(tmp_path):
    pytest.importorskip("pyarrow")
    rows = pd.DataFrame({"t_ms": 5 * np.arange(40), "trial": np.repeat([0, 1], 20), "left": SIGNAL[:, 0]})
    rows["label"] = [None] * 20 + ["silk"] * 20
    rows.set_index("t_ms").to_parquet(tmp_path / "all.parquet")
    with pytest.raises(InputError, match="trial 0 has an empty label"):
        nt.read_table(tmp_path / "all.parquet", unit="count")
    found = nt.read_table(tmp_path / "all.parquet", unit="count", segments=True, trial="label")
    assert (found.sampling_rate_Hz, found.classes) == (200.0, ("silk",))


def test_a_topic_of_other_numbers_in_each_message_is_no_trial(tmp_path):
    (tmp_path / "felt").mkdir()
    bag(tmp_path / "felt" / "a.bag", n_numbers=lambda row: 1 + row % 2)
    with pytest.raises(InputError, match="holds no topic whose messages all have the same numbers"):
        nt.read_folder(tmp_path, unit="count")


@pytest.mark.parametrize(
    ("suffix", "head", "package", "extra"),
    [
        (".parquet", b"PAR1", "pyarrow.parquet", "parquet"),
        (".flac", b"fLaC", "soundfile", "flac"),
        (".bag", b"#ROSBAG V2.0\n", "rosbags.highlevel", "ros"),
    ],
)
def test_a_missing_package_is_named(tmp_path, monkeypatch, suffix, head, package, extra):
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / f"a{suffix}").write_bytes(head)
    with pytest.raises(InputError, match=rf"a{suffix}: .* is needed to read .*; pip install 'neurotact\[{extra}\]'$"):
        nt.read_folder(tmp_path, unit="count")


@pytest.mark.parametrize(("write", "suffix"), [(parquet, ".parquet"), (sound, ".wav"), (flac, ".flac"), (bag, ".bag")])
@settings(max_examples=25)
@given(cut=st.integers(0, 10**6), flips=st.lists(st.tuples(st.integers(4, 10**6), st.integers(0, 255)), max_size=3))
def test_a_damaged_file_is_read_or_refused_by_name(tmp_path_factory, write, suffix, cut, flips):
    folder = tmp_path_factory.getbasetemp() / f"damaged{suffix[1:]}"
    path = folder / "felt" / f"a{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    write(path)
    content = bytearray(path.read_bytes())
    for place, byte in flips:
        content[max(4, place % len(content))] = byte
    path.write_bytes(content if flips else content[: cut % len(content)])
    found, refusal = attempt(lambda: nt.read_folder(folder, unit="count"))
    if found is None:
        assert refusal.startswith(str(folder))
        assert "\n" not in refusal
    else:
        assert np.isfinite(found.signals[0]).all()


def test_one_of_several_tables_is_no_table_of_all_trials(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    (tmp_path / "felt").mkdir()
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject(group, "left", SIGNAL[:, 0]) for group in ("one", "two")])
    with pytest.raises(InputError, match=r"holds 2 tables \(one, two\); neurotact import folder reads each"):
        nt.read_table(tmp_path / "a.tdms", unit="V")
    (tmp_path / "a.tdms").rename(tmp_path / "felt" / "a.tdms")
    assert nt.read_folder(tmp_path, 100, "V", layout=nt.Layout(array="two")).conditions["file"].tolist() == [
        "felt/a.tdms:two"
    ]


def test_options_and_faults_of_samples_are_those_of_text(tmp_path, caplog):
    pytest.importorskip("pyarrow")
    (tmp_path / "felt").mkdir()
    rows = pd.DataFrame({"left": SIGNAL[:, 0].astype(float), "right": SIGNAL[:, 1], "t_ms": 5 * np.arange(40)})
    rows["left"] = rows["left"].where(rows.index != 7)
    rows.to_parquet(tmp_path / "felt" / "a.parquet")
    with pytest.raises(InputError, match="sample 7, channel 0 is nan; repair the gap"):
        nt.read_folder(tmp_path, unit="count")
    found = nt.read_folder(tmp_path, unit="count", layout=nt.Layout(missing="interpolate"))
    assert "left out" not in caplog.text
    assert found.signals[0][7, 0] == np.float32((rows["left"][6] + rows["left"][8]) / 2)
    with pytest.raises(InputError, match=r"a\.parquet: `header_lines` is for text files; leave it out"):
        nt.read_folder(tmp_path, 200, "count", layout=nt.Layout(header_lines=1))
    rows[["right", "t_ms"]].to_parquet(tmp_path / "felt" / "b.parquet")
    with pytest.raises(InputError, match=r"felt/b\.parquet: has 1 channel where felt/a\.parquet has 2"):
        nt.read_folder(tmp_path, 200, "count", layout=nt.Layout(missing="interpolate"))
