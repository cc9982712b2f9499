"""NWB: what is written comes back to the step, other programs' files are read as their schema means them."""

import json
import sys
from datetime import datetime

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.readers import nwb
from neurotact_parts.readers.nwb_output import EPOCH
from typer.testing import CliRunner

import neurotact as nt
from neurotact.cli import app
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError

LIF = {"model": "lif", "sa1": {"gain": 3.2, "t_ref_ms": 1.0}, "ra1": {"gain": 16.0, "t_ref_ms": 1.0}}


def trains_of(lengths, n_afferents=3, rate_Hz=1000.0, seed=0, density=0.1, **about) -> SpikeTrains:
    rng = np.random.default_rng(seed)
    events = [np.nonzero(rng.random((n, n_afferents)) < density) for n in lengths]
    conditions = pd.DataFrame(
        {
            "label": [("felt", "silk")[i % 2] for i in range(len(lengths))],
            "speed_mm_per_s": [0.1 + i / 3 for i in range(len(lengths))],
            "repetition": np.arange(len(lengths)),
            "Läufer": ["Ann", "Bé"][:1] * len(lengths),
        }
    )
    return SpikeTrains(
        [steps.astype(np.int64) for steps, _ in events], [units.astype(np.uint16) for _, units in events],
        np.array(lengths), rate_Hz, tuple(f"SA-I taxel{i} x0.5" for i in range(n_afferents)), conditions,
        **{"encoder": LIF, "source": "skin.h5", **about},
    )  # fmt: skip


def same(one: SpikeTrains, other: SpikeTrains) -> None:
    for mine, its in ((one.steps, other.steps), (one.units, other.units)):
        assert [each.tolist() for each in mine] == [each.tolist() for each in its]
    assert one.trial_steps.tolist() == other.trial_steps.tolist()
    assert (one.sampling_rate_Hz, one.afferents, one.encoder) == (
        other.sampling_rate_Hz, other.afferents, other.encoder
    )  # fmt: skip
    assert (one.source, one.trial_digests) == (other.source, other.trial_digests)
    assert one.recorded_Hz == other.recorded_Hz
    assert one.recorded_Hz == other.recorded_Hz
    pd.testing.assert_frame_equal(one.conditions, other.conditions)


def minimal(path, **changes) -> None:
    """An NWB file by its schema, of two units in two trials of 10 ms, the second of them 1.5 s later.

    changes: datasets by their place, with __ for /; None leaves one out.
    """
    texts = h5py.string_dtype()
    content = {
        "units/id": [7, 9], "units/spike_times": [0.0005, 0.0032, 1.5, 0.0099, 1.5021, 1.5024],
        "units/spike_times_index": [3, 6],
        "intervals/trials/id": [0, 1], "intervals/trials/start_time": [0.0, 1.5],
        "intervals/trials/stop_time": [0.01, 1.51], "intervals/trials/cloth": np.array(["felt", "silk"], texts),
        "acquisition/touch/data": np.arange(4000, dtype=np.int16).reshape(2000, 2),
        "acquisition/touch/starting_time": 0.0,
    }  # fmt: skip
    content |= {place.replace("__", "/"): value for place, value in changes.items()}
    with h5py.File(path, "w") as file:
        for place, value in content.items():
            if value is not None:
                file[place] = value if isinstance(value, h5py.ExternalLink) else np.asarray(value)
        if content["acquisition/touch/data"] is not None:
            file["acquisition/touch/data"].attrs.update({"conversion": 0.5, "offset": 1.0, "unit": "volts"})
        if content["acquisition/touch/starting_time"] is not None:
            file["acquisition/touch/starting_time"].attrs["rate"] = 1000.0


# --- what neurotact writes --------------------------------------------------------------------------


@given(
    lengths=st.lists(st.integers(1, 300), min_size=1, max_size=5),
    rate_Hz=st.sampled_from([35.61, 49.0, 1000.0, 1000 / 3, 2000.0, 44_100.0]),
    density=st.sampled_from([0.0, 0.02, 0.5]),
    seed=st.integers(0, 99),
    digests=st.booleans(),
)
@examples(12)
def test_spikes_come_back_to_the_step(tmp_path_factory, lengths, rate_Hz, density, seed, digests):
    pytest.importorskip("pynwb", reason="pynwb is not installed")
    about = {"trial_digests": tuple(f"{i:016x}" for i in range(len(lengths)))} if digests else {}
    trains = trains_of(
        lengths, rate_Hz=rate_Hz, seed=seed, density=density, **about, recorded_Hz=35.6 if digests else None
    )
    path = tmp_path_factory.mktemp("nwb") / "spikes.nwb"
    nt.to_nwb(trains, path)
    same(nt.read("nwb", path), trains)


def test_long_sessions_lose_no_step(tmp_path):
    """Hours into a session binary fractions are coarser than at its beginning."""
    pytest.importorskip("pynwb", reason="pynwb is not installed")
    steps = [np.arange(0, 200, 7) for _ in range(7)]
    steps[3] = np.array([0, 39_999_999])
    units = [np.zeros(len(each), np.uint16) for each in steps]
    lengths = np.array([200, 200, 200, 40_000_000, 200, 200, 200])
    trains = SpikeTrains(steps, units, lengths, 3000.0, ("SA-I a",), trains_of([1] * 7).conditions, {})
    nt.to_nwb(trains, tmp_path / "long.nwb")
    assert [each.tolist() for each in nt.read_nwb(tmp_path / "long.nwb").steps] == [each.tolist() for each in steps]


def test_the_file_is_valid_and_reads_in_pynwb(tmp_path):
    pynwb = pytest.importorskip("pynwb", reason="pynwb is not installed")
    trains = trains_of([50, 80])
    nt.to_nwb(trains, tmp_path / "spikes.nwb", about="a touch")
    assert not pynwb.validate(path=str(tmp_path / "spikes.nwb"))
    with pynwb.NWBHDF5IO(str(tmp_path / "spikes.nwb"), "r") as file:
        found = file.read()
        assert found.trials["label"][:].tolist() == ["felt", "silk"]
        assert found.trials["stop_time"][:].tolist() == [0.05, 0.13]
        assert found.units["afferent"][:].tolist() == list(trains.afferents)
        of_first = [(s + before) / 1000.0 for s, u, before in zip(trains.steps, trains.units, (0, 50), strict=True)]
        due = np.concatenate([t[u == 1] for t, u in zip(of_first, trains.units, strict=True)])
        np.testing.assert_allclose(found.units["spike_times"][1], due)
        assert found.units.resolution == 1e-3
        assert json.loads(found.notes)["neurotact"]["encoder"] == LIF
        assert found.session_description == "a touch"


def test_the_commands_write_and_read(tmp_path):
    pytest.importorskip("pynwb", reason="pynwb is not installed")
    trains = trains_of([50, 80], source="")
    nt.save(trains, tmp_path / "spikes.h5")
    spikes, out, back = (str(tmp_path / name) for name in ("spikes.h5", "spikes.nwb", "back.h5"))
    assert CliRunner().invoke(app, ["raster", spikes, "-o", out]).exit_code == 0
    refused = CliRunner().invoke(app, ["raster", spikes, "-o", out]).exception
    assert isinstance(refused, InputError)
    assert "already exists" in str(refused)
    found = CliRunner().invoke(app, ["import", "nwb", out, "-o", back])
    assert found.exit_code == 0, found.output
    mine, its = nt.load(spikes), nt.load(back)
    assert isinstance(mine, SpikeTrains)
    assert isinstance(its, SpikeTrains)
    assert [each.tolist() for each in its.steps] == [each.tolist() for each in mine.steps]
    assert its.encoder == mine.encoder


def test_what_nwb_cannot_hold_is_refused(tmp_path, monkeypatch):
    pytest.importorskip("pynwb", reason="pynwb is not installed")
    trains = trains_of([5])
    wrong = SpikeTrains(
        trains.steps, trains.units, trains.trial_steps, 1000.0, trains.afferents,
        trains.conditions.rename(columns={"repetition": "start_time"}), {},
    )  # fmt: skip
    with pytest.raises(InputError, match="'start_time' cannot be a column"):
        nt.to_nwb(wrong, tmp_path / "a.nwb")
    with pytest.raises(InputError, match="session_start: has no time zone"):
        nt.to_nwb(trains, tmp_path / "a.nwb", session_start=datetime(2026, 1, 1))
    with pytest.raises(InputError, match="an empty one, which NWB cannot store"):
        nt.to_nwb(trains_of([5, 0]), tmp_path / "a.nwb")
    monkeypatch.setitem(sys.modules, "pynwb", None)
    with pytest.raises(InputError, match=r"pip install 'neurotact\[neuro\]'"):
        nt.to_nwb(trains, tmp_path / "a.nwb")
    assert not list(tmp_path.iterdir())


# --- what others write ------------------------------------------------------------------------------


def test_units_are_cut_into_trials_by_hand(tmp_path):
    minimal(tmp_path / "theirs.nwb")
    with pytest.raises(InputError, match=r"theirs.nwb: 1 of 6 events \(16\.7 %\) share a step of 1 ms and a channel"):
        nt.read_nwb(tmp_path / "theirs.nwb", label="cloth")
    found = nt.read_nwb(tmp_path / "theirs.nwb", label="cloth", merge_events=True)
    assert isinstance(found, SpikeTrains)
    assert (found.afferents, found.sampling_rate_Hz, found.encoder) == (("unit7", "unit9"), 1000.0, {})
    assert found.conditions["label"].tolist() == ["felt", "silk"]
    assert [each.tolist() for each in found.steps] == [[0, 3, 9], [0, 2]]  # two spikes of unit9 stand in one step
    assert [each.tolist() for each in found.units] == [[0, 0, 1], [0, 1]]
    fine = nt.read_nwb(tmp_path / "theirs.nwb", label="cloth", step_ms=0.1)
    assert fine.steps[1].tolist() == [0, 21, 24]


def test_a_spike_where_one_trial_ends_belongs_to_the_next_and_overlapping_trials_share_theirs(tmp_path, caplog):
    asked = {"label": "cloth", "merge_events": True}  # three spikes of a unit are at 0
    times = {"intervals__trials__start_time": [0.0, 0.003], "intervals__trials__stop_time": [0.003, 0.012]}
    minimal(tmp_path / "one.nwb", units__spike_times=[0.003, 0.0051, 0.02, 0.0, 0.0, 0.0], **times)
    found = nt.read_nwb(tmp_path / "one.nwb", **asked)
    assert "1 of 6 spikes are in no trial and left out" in caplog.text
    assert "2 of 5 events (40 %) share a step of 1 ms and a channel with another and are one spike" in caplog.text
    assert [each.tolist() for each in found.steps] == [[0], [0, 2]]
    assert found.trial_steps.tolist() == [3, 9]
    times["intervals__trials__stop_time"] = [0.006, 0.012]
    minimal(tmp_path / "two.nwb", units__spike_times=[0.003, 0.0051, 0.02, 0.0, 0.0, 0.0], **times)
    found = nt.read_nwb(tmp_path / "two.nwb", **asked)
    assert [each.tolist() for each in found.steps] == [[0, 3, 5], [0, 2]]


def test_pynwb_s_own_tables_are_read(tmp_path):
    pynwb = pytest.importorskip("pynwb", reason="pynwb is not installed")
    made = pynwb.NWBFile(session_description="a session", identifier="id", session_start_time=EPOCH)
    made.add_unit_column(name="unit_name", description="name")
    for name, times in (("left", [0.1, 0.25]), ("right", []), ("both", [0.105])):
        made.add_unit(spike_times=times, unit_name=name)
    touches = pynwb.epoch.TimeIntervals(name="touches", description="touches of a finger")
    touches.add_column(name="kind", description="0 or 1")
    touches.add_column(name="strong", description="whether")
    for start, kind in ((0.1, 1), (0.2, 0)):
        touches.add_interval(start_time=start, stop_time=start + 0.1, kind=kind, strong=kind == 1)
    made.add_time_intervals(touches)
    with pynwb.NWBHDF5IO(str(tmp_path / "a.nwb"), "w") as file:
        file.write(made)
    found = nt.read_nwb(tmp_path / "a.nwb", trials="touches", label="kind", name="unit_name", step_ms=5)
    assert found.afferents == ("left", "right", "both")
    assert [each.tolist() for each in found.steps] == [[0, 1], [10]]
    assert found.conditions.to_dict("list") == {"label": ["1", "0"], "strong": [1, 0]}
    with pytest.raises(InputError, match=r"holds no intervals/trials \(there is touches\)"):
        nt.read_nwb(tmp_path / "a.nwb")


# --- time series ------------------------------------------------------------------------------------


def test_a_time_series_is_cut_into_recordings(tmp_path):
    minimal(tmp_path / "a.nwb")
    found = nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch")
    assert isinstance(found, Recordings)
    assert (found.unit, found.sampling_rate_Hz, found.n_channels) == ("V", 1000.0, 2)
    assert found.lengths.tolist() == [10, 10]
    np.testing.assert_allclose(found.signals[1][:2], [[3000 / 2 + 1, 3001 / 2 + 1], [3002 / 2 + 1, 3003 / 2 + 1]])
    again = nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="acquisition/touch", unit="mV")
    assert again.unit == "mV"


@pytest.mark.parametrize(
    ("said", "wanted", "factor"), [("newtons", "mN", 1e3), ("mN", "N", 1e-3), ("other", "mV", 1.0), ("N", "count", 1.0)]
)
def test_a_unit_that_is_asked_for_is_that_of_the_numbers(tmp_path, said, wanted, factor):
    minimal(tmp_path / "a.nwb")
    with h5py.File(tmp_path / "a.nwb", "a") as file:
        file["acquisition/touch/data"].attrs["unit"] = said
    own = nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch")
    asked = nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch", unit=wanted)
    assert asked.unit == wanted
    np.testing.assert_allclose(asked.signals, factor * np.array(own.signals), rtol=1e-6)


def test_a_unit_of_another_quantity_is_refused(tmp_path):
    minimal(tmp_path / "a.nwb")
    with pytest.raises(InputError, match="touch: is in V, which is not measured in mN; leave out `unit`"):
        nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch", unit="mN")


@pytest.mark.parametrize("is_stamped", [False, True])
def test_samples_whose_taxels_come_first_are_refused(tmp_path, is_stamped):
    data = np.arange(4000, dtype=np.int16).reshape(2, 2000)
    stamps = {"acquisition__touch__starting_time": None, "acquisition__touch__timestamps": np.arange(2000) / 1000}
    minimal(tmp_path / "a.nwb", acquisition__touch__data=data, **(stamps if is_stamped else {}))
    with pytest.raises(InputError, match=r"shape \(2, 2000\), which is \(taxel, time\) .* write the series transposed"):
        nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch")


def test_a_rate_that_is_none_of_touch_is_doubted(tmp_path, caplog):
    stops = {"intervals__trials__stop_time": [5000.0, 9000.0], "intervals__trials__start_time": [0.0, 5000.0]}
    minimal(tmp_path / "a.nwb", **stops)
    with h5py.File(tmp_path / "a.nwb", "a") as file:
        file["acquisition/touch/starting_time"].attrs["rate"] = 0.1
    nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch")
    assert "0.1 Hz is slow for touch" in caplog.text


def test_stamped_samples_come_to_a_clock(tmp_path):
    time_s = np.arange(2000) / 1000.0
    time_s[1::2] += 0.0002  # jitter
    minimal(tmp_path / "a.nwb", acquisition__touch__starting_time=None, acquisition__touch__timestamps=time_s,
            acquisition__touch__data=time_s)  # fmt: skip
    found = nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch")
    assert isinstance(found, Recordings)
    assert found.sampling_rate_Hz == pytest.approx(1000.0, rel=0.03)
    since_s = (found.signals[0][:, 0] - 1.0) / 0.5
    np.testing.assert_allclose(since_s, np.arange(len(since_s)) / found.sampling_rate_Hz, atol=1e-6)


def stamped_at(path, time_s, data=None):
    """A file whose series has these time stamps; its trials last from 0.5 to 3.5 s and from 3.5 to 6.5 s."""
    minimal(path, acquisition__touch__starting_time=None, acquisition__touch__timestamps=time_s,
            acquisition__touch__data=np.arange(float(len(time_s))) if data is None else data,
            intervals__trials__start_time=[0.5, 3.5], intervals__trials__stop_time=[3.5, 6.5])  # fmt: skip
    return path


def test_samples_that_share_a_stamp_are_kept_and_counted(tmp_path, caplog):
    path = stamped_at(tmp_path / "a.nwb", np.arange(80) // 10 * 1.0)
    found = nt.read_nwb(path, label="cloth", series="touch")
    assert isinstance(found, Recordings)
    assert (found.sampling_rate_Hz, found.lengths.tolist()) == (10, [30, 30])
    np.testing.assert_allclose((found.signals[0][:, 0] - 1.0) / 0.5, np.arange(5, 35))
    assert "a.nwb: 52 of 60 rows have the time stamp of the row before them (in 2 of 2 trials)" in caplog.text


def test_samples_that_were_written_twice_are_dropped_if_asked_for(tmp_path):
    twice = np.repeat(np.arange(80), 2)
    path = stamped_at(tmp_path / "a.nwb", twice * 0.1, np.random.default_rng(0).normal(size=80)[twice])
    asked = {"label": "cloth", "series": "touch"}
    with pytest.raises(
        InputError, match=r"60 of 120 rows repeat the row before them with its time stamp .*`drop_repeats=True`"
    ):
        nt.read_nwb(path, **asked)
    for options, expected in (({"drop_repeats": True}, [30, 30]), ({"sampling_rate_Hz": 20.0}, [60, 60])):
        found = nt.read_nwb(path, **asked, **options)
        assert isinstance(found, Recordings)
        assert found.lengths.tolist() == expected


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"series": "touch", "sampling_rate_Hz": 10.0}, "`sampling_rate_Hz`: acquisition/touch says its rate, 1000 Hz"),
        ({"series": "touch", "drop_repeats": True}, "`drop_repeats`: the samples have no time stamps; leave it out"),
        ({"series": "touch", "max_gap_ms": 3.0}, "`max_gap_ms`: the samples have no time stamps; leave it out"),
        ({"drop_repeats": True}, "`drop_repeats` is for a time series; drop it"),
        ({"sampling_rate_Hz": 9.0}, "`sampling_rate_Hz` is for a time series; drop it"),
    ],
)
def test_options_of_stamps_without_stamps_are_refused(tmp_path, settings, message):
    minimal(tmp_path / "a.nwb")
    with pytest.raises(InputError, match=message):
        nt.read_nwb(tmp_path / "a.nwb", **{"label": "cloth", **settings})


# --- what is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "settings", "message"),
    [
        ({"units__spike_times": None}, {}, r"no spike times of units; name a time series .*acquisition/touch"),
        ({"units__spike_times_index": [3, 5]}, {}, "spike_times_index does not fit 6 values of 2 rows"),
        ({"units__spike_times_index": [6, 3]}, {}, "spike_times_index does not fit 6 values of 2 rows"),
        ({"units__spike_times": [0.1, np.nan, 0, 0, 0, 0]}, {}, "spike 1 of 'unit7' is at nan s"),
        ({"units__id": [7, 7]}, {}, "two units are called 'unit7'"),
        ({}, {"name": "electrode"}, "no column electrode"),
        ({}, {"label": "fabric"}, r"no column of intervals/trials is called fabric \(cloth\); name the class"),
        ({}, {"trials": "epochs"}, r"no intervals/epochs \(there is trials\)"),
        ({"intervals__trials__stop_time": [0.0, 1.6]}, {}, "trial 0 lasts from 0 s to 0 s"),
        ({"intervals__trials__stop_time": [1.0]}, {}, "2 starts and 1 stops"),
        ({"intervals__trials__stop_time": [1e12, 2.0]}, {}, "give a longer `step_ms`"),
        ({}, {"step_ms": -1}, "step_ms: must be > 0"),
        ({}, {"series": "skin"}, r"no time series is called 'skin' \(there is acquisition/touch\)"),
        ({"intervals__trials__stop_time": [0.1, 9.0]}, {"series": "touch"}, "trial 1 lasts .* has no samples"),
        ({"acquisition__touch__data": np.zeros((5, 2, 2))}, {"series": "touch"}, "where .time, taxel. is expected"),
        ({"units": h5py.ExternalLink("other.h5", "units"), "units__id": None, "units__spike_times": None,
          "units__spike_times_index": None}, {}, "no spike times of units"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_refused_in_a_sentence(tmp_path, changes, settings, message):
    minimal(tmp_path / "other.h5")
    minimal(tmp_path / "a.nwb", **changes)
    with pytest.raises(InputError, match=message) as error:
        nt.read_nwb(tmp_path / "a.nwb", **{"label": "cloth", **settings})
    assert "\n" not in str(error.value)


def test_declared_sizes_are_refused_before_they_are_read(tmp_path):
    for place in ("units/spike_times", "intervals/trials/start_time", "acquisition/touch/data"):
        minimal(tmp_path / "a.nwb", **{place: None})
        with h5py.File(tmp_path / "a.nwb", "a") as file:
            file.create_dataset(place, (10**12,), "f8", chunks=(1000,))
        with pytest.raises(InputError, match=r"MB|NEUROTACT_MAX"):
            nt.read_nwb(tmp_path / "a.nwb", label="cloth", series="touch" if "touch" in place else None)


@pytest.mark.parametrize("content", [b"", b"no NWB", b"\x89HDF\r\n\x1a\n" + bytes(40)])
def test_other_bytes_are_refused(tmp_path, content):
    (tmp_path / "a.nwb").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.nwb"):
        nwb.read(tmp_path / "a.nwb")


@given(data=st.data())
@examples(60)
def test_spoilt_files_end_in_a_sentence(tmp_path_factory, data):
    place = tmp_path_factory.mktemp("spoilt") / "a.nwb"
    minimal(place)
    content = bytearray(place.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    place.write_bytes(bytes(content))
    for series in (None, "touch"):
        try:
            found = nt.read_nwb(place, label="cloth", series=series)
        except InputError:
            continue
        assert len(found) == 2
