"""TDMS files: what npTDMS writes is read, each group as a trial; damaged files, and a missing npTDMS, are named."""

import sys

import numpy as np
import pytest
from as_specs import of_folder
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.errors import InputError

SIGNAL = np.round(np.random.default_rng(5).normal(size=(30, 2)), 3)
HEAD = b"TDSm\x0e\0\0\0\x69\x12\0\0"


def attempt(read):
    """The recordings, or None and why they were refused."""
    try:
        return read(), ""
    except InputError as error:
        return None, str(error)


def written(path, groups: dict[str, dict[str, np.ndarray]], **properties):
    nptdms = pytest.importorskip("nptdms")
    path.parent.mkdir(parents=True, exist_ok=True)
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([
            nptdms.ChannelObject(group, name, values, properties=properties)
            for group, channels in groups.items() for name, values in channels.items()
        ])  # fmt: skip
    return path


def test_each_group_is_a_trial_and_each_channel_a_taxel(tmp_path):
    taxels = dict(zip(["left", "right"], SIGNAL.T, strict=True))
    written(tmp_path / "felt" / "a.tdms", {"one": taxels, "two": taxels}, wf_increment=0.002)
    written(tmp_path / "silk" / "b.tdms", {"one": taxels}, wf_increment=0.002)
    found = nt.read_folder(tmp_path, unit="V")
    assert found.conditions["file"].tolist() == ["felt/a.tdms:one", "felt/a.tdms:two", "silk/b.tdms:one"]
    assert (found.channels, found.sampling_rate_Hz) == (("left", "right"), 500.0)
    for signal in found.signals:
        np.testing.assert_array_equal(signal, SIGNAL.astype(np.float32))
    assert nt.read_folder(tmp_path, unit="V", layout=nt.Layout(array="one", columns="right")).channels == ("right",)
    assert nt.read_folder(tmp_path, 100, "V", layout=nt.Layout(columns="left")).sampling_rate_Hz == 100.0


def test_another_unit_than_a_channel_has_is_named(tmp_path, caplog):
    taxels = dict(zip(["left", "right"], SIGNAL.T, strict=True))
    written(tmp_path / "felt" / "a.tdms", {"one": taxels}, wf_increment=0.002, unit_string="mV")
    assert nt.read_folder(tmp_path, unit="V").unit == "V"
    assert caplog.messages == [f"{tmp_path}: says mV (left, right), but V is given and used"]


@pytest.mark.parametrize("name", ["t_ms", "clock"])
def test_a_channel_of_times_gives_the_rate(tmp_path, name, caplog):
    ms = 5 * np.arange(30)
    times = ms if name == "t_ms" else np.datetime64("2024-01-31T23:59:59") + ms * np.timedelta64(1, "ms")
    note = np.array(["a"] * 30)
    written(tmp_path / "felt" / "a.tdms", {"one": {"left": SIGNAL[:, 0], name: times, "note": note}})
    found = nt.read_folder(tmp_path, unit="V")
    assert (found.channels, found.sampling_rate_Hz) == (("left",), 200.0)
    assert caplog.messages == [f"{tmp_path}: holds no number, so no taxel: note"]


@pytest.mark.parametrize(
    ("groups", "options", "message"),
    [
        ({"one": {"a": np.arange(3.0), "b": np.arange(4.0)}}, {}, r"different lengths \(a 3, b 4\); choose the taxels"),
        ({"one": {"a": np.array(["x"])}}, {}, "holds no channel of numbers; save the samples"),
        ({"one": {"a": np.arange(3.0)}}, {"array": "two"}, "holds no group 'two' of numbers; known: one"),
        ({"one": {"a": np.arange(3.0)}}, {"columns": "b"}, "`columns`: there is no column 'b'"),
        ({"one": {"a": np.arange(3.0)}}, {"transpose": True}, "`transpose` is for NPZ and MATLAB files"),
        ({"one": {"a": np.array([0, np.nan])}}, {}, "group 'one': sample 1, channel 0 is nan; repair the gap"),
        ({"one": {"t": np.arange(3.0)}}, {}, "group 'one': has no channel besides the time"),
    ],
)
def test_channels_that_make_no_trial_are_named(tmp_path, groups, options, message):
    written(tmp_path / "felt" / "a.tdms", groups)
    with pytest.raises(InputError, match=message):
        nt.read_folder(tmp_path, 100, "V", **of_folder(options))


def test_channels_of_two_clocks_are_refused(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    (tmp_path / "felt").mkdir()
    with nptdms.TdmsWriter(tmp_path / "felt" / "a.tdms") as writer:
        writer.write_segment([
            nptdms.ChannelObject("one", name, np.arange(3.0), properties={"wf_increment": interval_s})
            for name, interval_s in (("a", 0.1), ("b", 0.2))
        ])  # fmt: skip
    with pytest.raises(InputError, match="has channels of different intervals; choose taxels of one with `columns`"):
        nt.read_folder(tmp_path, unit="V")


@given(cut=st.integers(0, 10**6), flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=3))
def test_a_damaged_file_is_read_or_refused_by_name(tmp_path_factory, cut, flips):
    folder = tmp_path_factory.getbasetemp() / "damaged"
    path = written(folder / "felt" / "a.tdms", {"one": {"left": np.arange(20.0)}}, wf_increment=0.01)
    content = bytearray(path.read_bytes())
    for place, byte in flips:
        content[place % len(content)] = byte
    path.write_bytes(content if flips else content[: cut % len(content)])
    found, refusal = attempt(lambda: nt.read_folder(folder, 100, "V"))
    if found is None:
        assert refusal.startswith(str(folder))
        assert "\n" not in refusal
    else:
        assert np.isfinite(found.signals[0]).all()


def test_a_file_that_was_cut_off_is_read_and_said(tmp_path, caplog, capfd):
    path = written(tmp_path / "felt" / "a.tdms", {"one": {"left": np.arange(20.0)}})
    path.write_bytes(path.read_bytes()[:-80])
    assert nt.read_folder(tmp_path, 100, "V").lengths.tolist() == [10]
    (said,) = caplog.messages
    assert said.startswith(f"{tmp_path}: npTDMS says: ")
    assert capfd.readouterr().err == ""


def test_without_nptdms_the_fix_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "nptdms", None)
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / "a.tdms").write_bytes(HEAD)
    with pytest.raises(InputError, match=r"npTDMS is needed to read TDMS files; pip install 'neurotact\[tdms\]'"):
        nt.read_folder(tmp_path, 100, "V")


def test_a_file_that_only_has_the_suffix_is_named(tmp_path):
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / "a.tdms").write_bytes(b"version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(InputError, match=r"a\.tdms: is a Git LFS pointer"):
        nt.read_folder(tmp_path, 100, "V")
