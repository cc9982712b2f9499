"""Files of events: every layout keeps every event of a clock, every option acts or is refused, nothing goes unsaid."""

import inspect
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import torch
from as_specs import of_events, of_folder
from hypothesis import assume, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.readers.events.spikes import EventSpec
from neurotact_parts.readers.events.times import in_order
from neurotact_parts.studies.braille import reader as braille_letters
from typer.testing import CliRunner

import neurotact as nt
from neurotact.cli import app
from neurotact.cli import recordings as recordings_commands
from neurotact.data import hdf5
from neurotact.data.readers.clock.units import UNIT_S
from neurotact.data.readers.columns import OF_EVENTS
from neurotact.data.readers.specs import NamingSpec
from neurotact.errors import InputError

GRID = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "?")])


# --- every layout keeps the events of a clock -------------------------------------------------------


def structured(folder: Path, stamps: np.ndarray, unit: str, spec: dict) -> nt.SpikeTrains:
    for label in ("a", "b"):
        (folder / label).mkdir(exist_ok=True)
        array = np.zeros(len(stamps), [("t", stamps.dtype), ("x", "<u2"), ("y", "<u2"), ("p", "?")])
        array["t"] = stamps
        np.save(folder / label / "0.npy", array)
    return nt.read_events(folder, **of_events({**spec, "time_unit": unit}))


def arrays(folder: Path, stamps: np.ndarray, unit: str, spec: dict) -> nt.SpikeTrains:
    twice, trial = np.concatenate([stamps, stamps]), np.repeat([0, 1], len(stamps))
    np.savez(folder / "e.npz", **{f"event_time_{unit}": twice, "trial": trial, "unit": 0 * trial, "label": ["a", "b"]})
    return nt.read_events(folder / "e.npz", **of_events(spec))


def table(folder: Path, stamps: np.ndarray, unit: str, spec: dict) -> nt.SpikeTrains:
    rows = {f"time_{unit}": np.concatenate([stamps, stamps]), "trial": np.repeat([0, 1], len(stamps)), "channel": 0}
    made = pd.DataFrame(rows).assign(label=lambda t: np.where(t["trial"], "b", "a"))
    made.to_csv(folder / "e.csv", index=False)
    return nt.read_events(folder / "e.csv", **of_events(spec))


def heidelberg(folder: Path, stamps: np.ndarray, unit: str, spec: dict) -> nt.SpikeTrains:
    with h5py.File(folder / "e.h5", "w") as file:
        times = file.create_dataset("spikes/times", (3,), h5py.vlen_dtype(stamps.dtype))
        units = file.create_dataset("spikes/units", (3,), h5py.vlen_dtype(np.uint16))
        for trial in (0, 2):  # the second is silent
            times[trial], units[trial] = stamps, np.zeros(len(stamps), np.uint16)
        file["labels"] = np.array([0, 1, 1], np.uint8)
    return nt.read_events(folder / "e.h5", **of_events({**spec, "time_unit": unit}))


LAYOUTS = {"structured": structured, "arrays": arrays, "table": table, "heidelberg": heidelberg}


@given(
    st.sampled_from(sorted(LAYOUTS)), st.sampled_from([1000.0, 900.0, 30_000.0, 44_100.0]),
    st.sampled_from(["i4", "i8", "u4", "u8", "f4", "f8"]), st.sampled_from(["us", "ns", "s"]),
    st.booleans(), st.integers(0, 99),
)  # fmt: skip
@examples(40)
def test_every_layout_keeps_every_event_and_the_length_of_trials(
    tmp_path_factory, layout, rate_Hz, kind, unit, is_late, seed
):
    ticks = np.sort(np.random.default_rng(seed).choice(400, 120, replace=False))
    ticks[-1] = 399
    exact = ticks / rate_Hz / UNIT_S[unit]
    if kind[0] in "iu":
        unit = "us" if unit == "s" else unit
        exact = np.rint(ticks / rate_Hz / UNIT_S[unit]).astype(int)
        exact = exact + 1_700_000_000 * round(1 / UNIT_S[unit]) * (is_late and kind[1] == "8")
    stamps = exact.astype(kind)
    spec = {"step_ms": 1e3 / rate_Hz, "origin": "first" if is_late else "zero"}
    found = LAYOUTS[layout](tmp_path_factory.mktemp("law"), stamps, unit, spec)
    due = ticks - (ticks[0] if is_late else 0)
    assert [each.tolist() for each in found.steps if len(each)] == [due.tolist()] * 2
    assert set(found.trial_steps.tolist()) == {due[-1] + 1}


@pytest.mark.parametrize(("rate_Hz", "kind"), [(1000.0, "f4"), (30_000.0, "f8"), (2000.0, "f4")])
def test_spikes_of_sessions_keep_their_steps(tmp_path, rate_Hz, kind):
    """NWB and Neo, whose stamps count from the beginning of a session and may be rounded to whole microseconds."""
    ticks, start_s = np.arange(0, 600), 16.0 if kind == "f4" else 4000.0
    time_s = np.round(start_s + ticks / rate_Hz, 6).astype(kind)
    with h5py.File(tmp_path / "s.nwb", "w") as file:
        file["units/id"], file["units/spike_times"], file["units/spike_times_index"] = [0], time_s, [600]
        file["intervals/trials/id"], file["intervals/trials/label"] = [0], np.array(["a"], h5py.string_dtype())
        file["intervals/trials/start_time"], file["intervals/trials/stop_time"] = [start_s], [start_s + 600 / rate_Hz]
    found = nt.read_nwb(tmp_path / "s.nwb", step_ms=1e3 / rate_Hz)
    assert isinstance(found, nt.SpikeTrains)
    assert (found.steps[0].tolist(), found.trial_steps.tolist()) == (ticks.tolist(), [600])
    neo = pytest.importorskip("neo", reason="neo is not installed")
    for unit, times in (("s", time_s), ("ms", (1e3 * time_s.astype(float)).astype(kind))):
        scale = 1e3 if unit == "ms" else 1.0
        segment = neo.Segment(label="a")
        train = neo.SpikeTrain(
            times, units=unit, t_start=scale * start_s, t_stop=scale * (start_s + 600 / rate_Hz), dtype=kind
        )  # fmt: skip
        segment.spiketrains.append(train)
        block = neo.Block()
        block.segments.append(segment)
        again = nt.from_neo(block, step_ms=1e3 / rate_Hz)
        assert (again.steps[0].tolist(), again.trial_steps.tolist()) == (ticks.tolist(), [600])


def test_letters_of_single_precision_keep_their_steps(tmp_path):
    ticks = np.arange(1, 300)
    np.savez(
        tmp_path / "e.npz", letter=["A"], event_recording=0 * ticks, event_taxel=0 * ticks, event_polarity=0 * ticks,
        event_time_s=(ticks / 1000).astype("f4"),
    )  # fmt: skip
    assert braille_letters.read(tmp_path / "e.npz", 1.0).steps[0].tolist() == ticks.tolist()


def test_written_spikes_come_back_as_events(tmp_path):
    """The CSV of a raster, with its classes added, is the same spikes again."""
    rng = np.random.default_rng(0)
    raster = rng.random((4, 300, 3)) < 0.2
    raster[:, -1] = raster[:, 0] = True
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 2})
    steps, units = zip(*(np.nonzero(each) for each in raster), strict=True)
    trains = nt.SpikeTrains(steps, units, np.full(4, 300), 30_000.0, ("ON a", "ON b", "OFF c"), conditions, {})
    nt.save(trains, tmp_path / "spikes.h5")
    assert CliRunner().invoke(app, ["raster", f"{tmp_path}/spikes.h5", "-o", f"{tmp_path}/spikes.csv"]).exit_code == 0
    written = pd.read_csv(tmp_path / "spikes.csv")
    written.assign(label=conditions["label"][written["trial"]].to_numpy()).to_csv(tmp_path / "e.csv", index=False)
    names = {"channel": "afferent", "population": "type"}
    again = nt.read_events(tmp_path / "e.csv", names=names, events=nt.Events(step_ms=1 / 30, polarity="merge"))
    assert [each.tolist() for each in again.steps] == [each.tolist() for each in steps]
    assert again.trial_steps.tolist() == [300] * 4


# --- every option acts or is refused ----------------------------------------------------------------


def write(place: Path) -> dict[str, Path]:
    """Events of two classes in every layout, such that each option that a layout has a use for changes something."""
    rows = pd.DataFrame(
        {
            "trial": np.repeat([0, 1], 40), "time_us": np.tile(2000 + 1000 * np.arange(40), 2),
            "channel": np.tile([0, 1, 2, 1], 20), "edge": np.tile([0, 1], 40), "other": np.tile([2, 1, 0, 0, 1], 16),
            "block": np.repeat([3, 4], 40), "later_us": np.tile(9000 + 1000 * np.arange(40), 2),
        }
    )  # fmt: skip
    rows["polarity"] = rows["edge"]
    rows["label"], rows["kind_of"] = np.where(rows["trial"], "b", "a"), np.where(rows["trial"], "silk", "felt")
    rows.to_csv(place / "e.csv", index=False)
    of_trials = {"label": np.array(["a", "b"]), "kind_of": np.array(["felt", "silk"])}
    of_events = {name: rows[name].to_numpy() for name in rows.columns if name not in of_trials}
    np.savez(place / "e.npz", **of_events, **of_trials)
    grid = np.zeros(40, [*GRID.descr, ("later_us", "<i8"), ("other", "<u2"), ("edge", "?")])
    one = rows[rows["trial"] == 0]
    for name, column in (("t", "time_us"), ("x", "channel"), ("p", "polarity"), ("later_us", "later_us")):
        grid[name] = one[column]
    grid["other"], grid["edge"] = one["other"], 1 - one["edge"]
    np.savez(place / "grid.npz", a_0=grid, b_0=grid)
    for label, code in (("a", 0), ("b", 1)):
        for kind in ("tables", "grids"):
            (place / kind / label).mkdir(parents=True)
        part = rows[rows["trial"] == code].drop(columns=["trial", "label", "kind_of"])
        part.to_csv(place / "tables" / label / f"F{code}.csv", index=False)
        np.save(place / "grids" / label / f"F{code}.npy", grid)
    with h5py.File(place / "e.h5", "w") as file:
        times = file.create_dataset("spikes/times", (2,), h5py.vlen_dtype(np.float64))
        units = file.create_dataset("spikes/units", (2,), h5py.vlen_dtype(np.uint16))
        for trial in (0, 1):
            times[trial], units[trial] = one["time_us"].to_numpy() * 1e-6, one["channel"].to_numpy(np.uint16)
        file["labels"], file["extra/keys"] = np.array([0, 1], np.uint8), np.array([b"a", b"b"])
    for kind, suffix in (("tables", "csv"), ("grids", "npy")):
        named = {"file": [f"F0.{suffix}", f"F1.{suffix}"], "label": ["felt", "silk"]}
        pd.DataFrame(named).to_csv(place / f"{kind}.csv", index=False)
    layouts = {name: place / name for name in ("e.csv", "e.npz", "grid.npz", "tables", "grids", "e.h5")}
    return {name.replace("e.", "").replace("grid.", "grid_"): path for name, path in layouts.items()}


ALL = ("csv", "npz", "grid_npz", "tables", "grids", "h5")
FILES, FOLDERS, COLUMNS, GRIDS = ("csv", "npz", "grid_npz", "h5"), ("tables", "grids"), ("csv", "npz", "tables"), (
    "grid_npz", "grids")  # fmt: skip
HDF5_SAYS = "the Heidelberg layout has "
OPTIONS = [
    # option, settings, names, naming (or choice of trials), layouts in which it acts, what the others say
    ("step_ms", {"step_ms": 2.0, "merge_events": True}, {}, {}, ALL, ""),
    ("time_unit", {"time_unit": "ms", "merge_events": True}, {}, {}, ALL, ""),
    ("origin", {"origin": "first"}, {}, {}, ALL, ""),
    ("duration_ms", {"duration_ms": 20}, {}, {}, ALL, ""),
    ("polarity", {"polarity": "merge"}, {}, {}, (*COLUMNS, *GRIDS), HDF5_SAYS),
    ("polarity", {"polarity": "on"}, {}, {}, (*COLUMNS, *GRIDS), HDF5_SAYS),
    ("polarity", {"polarity": "off"}, {}, {}, (*COLUMNS, *GRIDS), HDF5_SAYS),
    ("polarities", {"polarities": "down,up"}, {}, {}, (*COLUMNS, *GRIDS), HDF5_SAYS),
    ("polarities", {"polarities": "down,up", "polarity": "on"}, {}, {}, (), "without a name; drop|" + HDF5_SAYS),
    ("polarities", {"polarities": "a,b,c"}, {}, {}, (), "has 2 polarities .* but 3 names|" + HDF5_SAYS),
    ("channels", {"channels": "l,m,r"}, {}, {}, (*COLUMNS, "h5"), "places x and y on a grid; drop `channels`"),
    ("n_channels", {"n_channels": 5}, {}, {}, (*COLUMNS, "h5"), "places x and y on a grid; drop `n_channels`"),
    ("n_channels", {"n_channels": 3, "channels": "l,m,r"}, {}, {}, (), "drop `(n_)?channels`"),
    ("sensor", {"sensor": "4x2"}, {}, {}, GRIDS, "drop `sensor`"),
    ("names", {}, {"time": "later_us"}, {}, (*COLUMNS, *GRIDS), HDF5_SAYS),
    ("names", {}, {"channel": "other"}, {}, (*COLUMNS, *GRIDS), HDF5_SAYS),
    ("names", {}, {"polarity": "other"}, {}, (), "has 3 polarities|" + HDF5_SAYS),
    ("names", {"polarities": "a,b,c"}, {"population": "other"}, {}, (*COLUMNS, *GRIDS), HDF5_SAYS),
    ("names", {}, {"polarity": "nowhere"}, {}, (), "`names={'polarity': ...}`: there is no 'nowhere'|" + HDF5_SAYS),
    ("names", {}, {"polarity": "edge", "population": "edge"}, {}, (), "are the same; give one of them"),
    ("names", {}, {"label": "kind_of"}, {}, ("csv", "npz"), "drop `names={'label': ...}`"),
    ("names", {}, {"trial": "block"}, {}, ("csv",), "must hold 0 to 1|drop `names={'trial': ...}`"),
    ("levels", {}, {}, {"levels": "cloth", "pattern": "F{label}"}, FOLDERS, "are for a folder"),
    ("pattern", {}, {}, {"pattern": "F{force}"}, FOLDERS, "are for a folder"),
    ("label", {}, {}, {"label": "force", "pattern": "F{force}"}, FOLDERS, "are for a folder"),
    ("conditions", {}, {}, {"conditions": "..."}, FOLDERS, "are for a folder"),
    ("where", {}, {}, {"where": {"label": "a"}}, ALL, ""),
    ("leave_out", {}, {}, {"leave_out": {"label": "a"}}, ALL, ""),
]  # fmt: skip


@pytest.fixture(scope="module")
def layouts(tmp_path_factory):
    return write(tmp_path_factory.mktemp("options"))


def content(trains: nt.SpikeTrains) -> tuple:
    spikes = [[each.tolist() for each in kind] for kind in (trains.steps, trains.units)]
    table = trains.conditions.to_dict("list")
    return trains.afferents, trains.trial_steps.tolist(), trains.sampling_rate_Hz, spikes, table


@pytest.mark.parametrize("option", OPTIONS, ids=lambda option: f"{option[0]}-{option[1] or option[2] or option[3]}")
def test_every_option_changes_the_spikes_or_is_refused(layouts, option):
    _, spec, names, naming, acting, refusal = option
    for layout, path in layouts.items():
        if "conditions" in naming:
            naming = {"conditions": f"{path}.csv"}
        given: dict[str, Any] = {"names": names, **naming}
        if layout in acting:
            plain, other = nt.read_events(path), nt.read_events(path, **of_events(spec), **of_folder(given))
            assert content(plain) != content(other), layout
            continue
        with pytest.raises(InputError, match=refusal) as refused:
            nt.read_events(path, **of_events(spec), **of_folder(given))
        assert str(refused.value).count("; ") >= 1, layout  # what to do follows what is wrong


def test_the_table_of_options_is_whole():
    """Each key of the spec and each option of the command is tried above, or below."""
    tried = {option[0] for option in OPTIONS} | {"merge_events"}
    given = set(inspect.signature(recordings_commands.import_events).parameters) - {"path", "out", "force"}
    assert tried == given
    keys = {*EventSpec.model_fields, *NamingSpec.model_fields} - {"table"}
    assert keys | {"names", "conditions", "where", "leave_out"} == tried
    assert {name for option in OPTIONS for name in option[2]} == {*OF_EVENTS, "polarity"}


@pytest.mark.parametrize("layout", ["csv", "npz", "h5"])
def test_options_of_polarity_are_refused_without_one(tmp_path, layouts, layout):
    rows = pd.read_csv(layouts["csv"])[["trial", "time_us", "channel", "label"]]
    rows.to_csv(tmp_path / "e.csv", index=False)
    np.savez(
        tmp_path / "e.npz", trial=rows["trial"], time_us=rows["time_us"], channel=rows["channel"], label=["a", "b"]
    )  # fmt: skip
    path = layouts["h5"] if layout == "h5" else tmp_path / f"e.{layout}"
    for spec in ({"polarity": "merge"}, {"polarity": "on"}, {"polarities": "OFF,ON"}):
        with pytest.raises(InputError, match=r"polarit"):
            nt.read_events(path, **of_events(spec))


def test_named_channels_and_populations_take_no_numbers(tmp_path):
    rows = pd.DataFrame({"time": [0.1, 0.2], "unit": ["left", "right"], "kind": ["PC", "RA"], "label": "a"})
    rows.to_csv(tmp_path / "e.csv", index=False)
    assert nt.read_events(tmp_path / "e.csv", events=nt.Events(channels="right,left")).afferents[0] == "PC right"
    for spec, message in (
        ({"n_channels": 2}, "channels have names"),
        ({"polarities": "a,b"}, "its populations have names"),
        ({"channels": "left,left"}, "'left' is there twice"),
    ):
        with pytest.raises(InputError, match=message):
            nt.read_events(tmp_path / "e.csv", **of_events(spec))


def test_polarities_of_three_values_can_be_merged(tmp_path):
    rows = pd.DataFrame({"time": [0.1, 0.2, 0.3], "channel": 0, "p": [-1, 0, 1], "label": "a"})
    rows.to_csv(tmp_path / "e.csv", index=False)
    assert nt.read_events(tmp_path / "e.csv", events=nt.Events(polarity="merge")).afferents == ("channel0",)
    with pytest.raises(InputError, match=r"has 3 populations, not two polarities; drop `polarity`"):
        nt.read_events(tmp_path / "e.csv", events=nt.Events(polarity="on"))


def test_a_name_is_given_once():
    with pytest.raises(InputError, match=r"--names time: is given twice"):
        recordings_commands._names(["time=a", "time=b"], ["time"])


@pytest.mark.parametrize("option", [["--step-ms", "1"], ["--name", "x"], ["--merge-events"]])
def test_options_of_spikes_are_refused_with_a_series(tmp_path, option):
    h5py.File(tmp_path / "a.nwb", "w").close()
    source, out = str(tmp_path / "a.nwb"), str(tmp_path / "o.h5")
    refused = CliRunner().invoke(app, ["import", "nwb", source, "-o", out, "--series", "force", *option]).exception
    assert isinstance(refused, InputError)
    assert f"`{option[0].strip('-').replace('-', '_')}` is for spikes of units; drop it" in str(refused)
    with pytest.raises(InputError, match="`unit` is for a time series"):
        nt.read_nwb(source, unit="V")


# --- nothing goes unsaid ----------------------------------------------------------------------------


def of_times(folder: Path, *columns, **others) -> Path:
    rows = pd.DataFrame({"time_ms": np.array(columns[0]), "channel": 0, "label": "a", **others})
    rows.to_csv(folder / "e.csv", index=False)
    return folder / "e.csv"


def test_events_that_become_one_spike_are_counted_and_beyond_one_percent_refused(tmp_path, caplog):
    few = of_times(tmp_path, sorted([*range(198), 5.25, 7.5]))
    assert len(nt.read_events(few).steps[0]) == 198
    assert caplog.messages == [f"{few}: 2 of 200 events (1 %) share a step of 1 ms and a channel with another and are "
                               "one spike with it"]  # fmt: skip
    many = of_times(tmp_path, sorted([*range(197), 5.25, 7.5, 9.5]))
    with pytest.raises(InputError, match=r"3 of 200 events \(1\.5 %\) .* shorter `step_ms`, .* `merge_events=True`"):
        nt.read_events(many)
    with pytest.raises(InputError, match=r"check the unit of the times"):
        nt.read_events(many, events=nt.Events(time_unit="us"))
    caplog.clear()
    assert len(nt.read_events(many, events=nt.Events(merge_events=True)).steps[0]) == 197
    assert len(caplog.messages) == 1
    caplog.clear()
    assert len(nt.read_events(many, events=nt.Events(step_ms=0.25)).steps[0]) == 200
    assert not caplog.messages


def test_a_heidelberg_file_that_is_loaded_as_it_is_says_what_it_merges(tmp_path, caplog):
    with pytest.raises(InputError, match=r"4 of 8 events \(50 %\)"):
        heidelberg(tmp_path, np.array([0.001, 0.0012, 0.003, 0.0035]), "s", {})
    assert len(hdf5.load_spikes(tmp_path / "e.h5").steps[0]) == 2
    assert [each.partition("e.h5: ")[2][:25] for each in caplog.messages] == [
        "its events are put on a c", "4 of 8 events (50 %) shar", "the median trial lasts 0."
    ]  # fmt: skip


def test_the_command_merges_with_a_flag(tmp_path):
    of_times(tmp_path, [1, 1.5, 3])
    run = ["import", "events", str(tmp_path / "e.csv"), "-o", str(tmp_path / "o.h5")]
    assert isinstance(CliRunner().invoke(app, run).exception, InputError)
    assert "2 spikes of 1 afferent" in CliRunner().invoke(app, [*run, "--merge-events"]).output


def test_events_after_the_given_length_are_counted(tmp_path, caplog):
    path = of_times(tmp_path, [0, 1, 2, 30, 30.5])
    assert nt.read_events(path, events=nt.Events(duration_ms=20)).trial_steps.tolist() == [20]
    assert caplog.messages == [f"{path}: 2 of 5 events are after `duration_ms` and left out"]


def test_stamps_that_go_back_and_counters_that_begin_again_are_named(tmp_path, caplog):
    path = of_times(tmp_path, [0, 1, 2, 9, 4, 5], channel=[0, 1] * 3)
    assert nt.read_events(path).steps[0].tolist() == [0, 1, 2, 4, 5, 9]
    assert "1 of 6 events are earlier than the one before them and are put in order of time" in caplog.messages[0]
    caplog.clear()
    events = np.zeros(6, GRID)
    events["t"] = (2**32 - 3000 + 1000 * np.arange(6)) % 2**32
    np.save(tmp_path / "e.npy", events)
    found = nt.read_events(tmp_path / "e.npy", events=nt.Events(origin="first"))
    assert found.steps[0].tolist() == [0, 1, 2, 3, 4, 5]
    assert "a counter begins again 1 times" in caplog.messages[0]


def events_of(path, time, name="time", n_trials=4, **columns):
    """Events `(trial, event)` of four channels in an archive."""
    rng = np.random.default_rng(0)
    time = np.asarray(time)
    arrays = {
        name: time.ravel(), "channel": rng.integers(4, size=time.size), "label": [*"abab"],
        "trial": np.repeat(np.arange(len(time)), time.shape[1]),
    }  # fmt: skip
    np.savez(path, **(arrays | columns))
    return path


@pytest.mark.parametrize("dtype", [np.int64, np.float64])
@pytest.mark.parametrize(("name", "options", "doubts"), [
    ("time", {}, ["the times are whole numbers without a unit, taken as seconds; give their unit", "the median trial"]),
    ("time_s", {}, ["the median trial lasts 59,9"]), ("time", {"time_unit": "ms"}, []),
    ("time", {"time_unit": "ns"}, ["the median trial lasts 0.001 s, which is short"]),
])  # fmt: skip
def test_sample_numbers_are_doubted_as_times(tmp_path, caplog, dtype, name, options, doubts):
    """Samples at 30 kHz of 2 s each: taken as seconds, trials last hours; the unit is asked for."""
    time = np.sort(np.random.default_rng(0).integers(0, 59_900, (4, 100)), axis=1).astype(dtype)
    time[:, -1] = 59_900
    nt.read_events(events_of(tmp_path / "e.npz", time, name), **of_events({**options, "merge_events": True}))
    lines = [line.partition("e.npz: ")[2] for line in caplog.messages if "share a step" not in line]
    assert len(lines) == len(doubts)
    for line, doubt in zip(lines, doubts, strict=True):
        assert line.startswith(doubt)
    assert not doubts or "give it with `time_unit`; divide sample numbers by their rate" in lines[-1]


@pytest.mark.parametrize("bits", [16, 20, 24, 28, 31, 32])
@given(rounds=st.integers(1, 3), seed=st.integers(0, 10**6))
def test_a_counter_of_any_bits_goes_on_when_it_begins_again(bits, rounds, seed):
    rng = np.random.default_rng(seed)
    step = 2**bits // 100
    time = np.cumsum(rng.integers(1, step, 200 * (rounds + 1)))
    steps, begins_again = np.diff(time), np.diff(time // 2**bits) > 0
    # The rule: counters of few bits begin again by a step no longer than others, since a clock may be set back, too.
    assume(not begins_again.any() or steps[begins_again].max() <= steps[~begins_again].max())
    found = in_order(time % 2**bits, np.zeros(len(time), int), [rng.integers(4, size=len(time))])
    assert np.array_equal(found.stamps - found.stamps[0], time - time[0])
    assert found.n_wraps == time[-1] // 2**bits - time[0] // 2**bits
    assert found.n_back == 0


@given(st.sampled_from([16, 20, 24, 28]), st.floats(0.55, 0.9))
def test_a_clock_of_few_bits_that_is_set_back_has_not_begun_again(bits, share):
    time = np.arange(0, int(share * 2**bits), 2**bits // 100)
    found = in_order(np.concatenate([time, time]), np.zeros(2 * len(time), int), [np.arange(2 * len(time)) % 4])
    assert (found.n_wraps, found.n_back) == (0, 1)


@pytest.mark.parametrize(("start_s", "step_ms", "is_coarse"), [
    (1000, 0.1, True), (1000, 0.2, False), (10_000, 1.0, True), (10_000, 4.0, False), (0, 0.1, False),
])  # fmt: skip
def test_times_coarser_than_half_a_step_are_doubted(tmp_path, caplog, start_s, step_ms, is_coarse):
    """A float32 time of 1000 s has a resolution of 61 us, one of 10,000 s of 977 us."""
    time = start_s + np.sort(np.random.default_rng(0).random((4, 100)) * 2, axis=1)
    for dtype, is_doubted in ((np.float32, is_coarse), (np.float64, False)):
        caplog.clear()
        path = events_of(tmp_path / "e.npz", time.astype(dtype), "time_s")
        nt.read_events(path, events=nt.Events(step_ms=step_ms, origin="first", merge_events=True))
        assert ("times have a resolution of" in caplog.text) == is_doubted


@pytest.mark.parametrize("kind", ["events", "raster", "heidelberg"])
def test_every_import_of_spikes_doubts_lengths(tmp_path, caplog, kind):
    if kind == "events":
        nt.read_events(events_of(tmp_path / "e.npz", np.linspace(0, 700, 400).reshape(4, 100), "time_s"))
    elif kind == "heidelberg":
        heidelberg(tmp_path, np.array([0.001, 2, 30, 700]), "s", {})
    else:
        raster = np.random.default_rng(0).random((4, 7000, 2)) < 0.01
        np.savez(tmp_path / "e.npz", raster=raster, label=[*"abab"])
        nt.read_raster(tmp_path / "e.npz", 10.0)
    assert "the median trial lasts 700" in caplog.text
    assert "which is long for touch; " in caplog.text


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (np.array([0.0, np.nan, np.nan]), r"event 1 of 'time' is 'nan', not a number, and so are 1 more; drop these"),
        (np.array([0.0, np.inf]), r"event 1 of 'time' is 'inf', not a number; drop the event"),
        (np.array([-0.001, 0.0]), r"an event is at -0.001 s, before zero; pass `origin='first'`"),
        (np.array([0, 5], "m8[us]"), r"'time' holds timedelta64\[us\], not numbers"),
    ],
)
def test_stamps_that_are_no_times_are_refused(tmp_path, times, message):
    np.savez(tmp_path / "e.npz", time=times, channel=np.zeros(len(times), int), label=["a"] * len(times))
    with pytest.raises(InputError, match=message):
        nt.read_events(tmp_path / "e.npz")


def test_a_polarity_that_is_no_number_is_refused(tmp_path):
    np.savez(tmp_path / "e.npz", time=[0.0, 1.0], channel=[0, 0], p=[1.0, np.nan], label=["a", "a"])
    with pytest.raises(InputError, match=r"event 1 of 'p' is nan; drop the event"):
        nt.read_events(tmp_path / "e.npz")


def test_arrays_and_files_that_are_not_read_are_named(tmp_path, caplog):
    np.savez(tmp_path / "e.npz", time=[0.0, 1.0], channel=[0, 0], label=["a", "a"], gain=np.ones((3, 3)))
    nt.read_events(tmp_path / "e.npz")
    assert "not used, because it has no value per event or trial: gain (3, 3)" in caplog.messages[0]
    caplog.clear()
    for label in "ab":
        (tmp_path / "in" / label).mkdir(parents=True)
        np.save(tmp_path / "in" / label / "1.npy", np.zeros(1, GRID))
        (tmp_path / "in" / label / "2.aedat4").write_bytes(b"#!AER-DAT4.0\r\n")
    nt.read_events(tmp_path / "in")
    assert "ignores 2 files (hidden, or not events): a/2.aedat4, b/2.aedat4" in caplog.messages[0]


def test_files_of_a_folder_say_the_same_about_their_events(tmp_path):
    for label, columns in (("a", "time,channel,p\n0,0,1\n"), ("b", "time,channel\n0,0\n")):
        (tmp_path / label).mkdir()
        (tmp_path / label / "1.csv").write_text(columns)
    with pytest.raises(InputError, match=r"a/1\.csv has a polarity, but .*b/1\.csv has none"):
        nt.read_events(tmp_path)


def test_a_table_of_places_is_a_grid_in_microseconds(tmp_path):
    (tmp_path / "e.csv").write_text("t,x,y,p,label\n1000,1,0,1,a\n3000,0,2,0,a\n")
    found = nt.read_events(tmp_path / "e.csv")
    assert (found.steps[0].tolist(), len(found.afferents)) == ([1, 3], 12)
    assert [found.afferents[unit] for unit in found.units[0]] == ["ON x1y0", "OFF x0y2"]


def test_a_field_s_name_gives_its_unit_and_names_apply_to_structured_arrays(tmp_path):
    array = np.zeros(40, [("t_ms", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
    array["t_ms"], array["x"], array["on"] = np.arange(40), np.arange(40) % 2, np.arange(40) % 3 == 0
    np.savez(tmp_path / "e.npz", a=array, b=array)
    found = nt.read_events(tmp_path / "e.npz", names={"polarity": "on"})
    assert {name: len(rows) for name, rows in found.populations.items()} == {"OFF": 2, "ON": 2}
    assert found.trial_steps.tolist() == [40, 40]


@pytest.mark.parametrize(
    ("name", "begin", "message"),
    [
        (
            "e.aedat4",
            b"#!AER-DAT4.0\r\n\x10\0\0\0",
            r"is a file of events \(AEDAT 4\); convert its events to CSV or NPZ",
        ),
        ("e.csv", b"#!AER-DAT4.0\r\n\x10\0\0\0", r"is a file of events \(AEDAT 4\); convert"),
        ("e.h5", b"#!AER-DAT3.1\r\n", r"old AEDAT format; convert"),
        ("e.csv", b'{"t": 0, "x": 1}\n{"t": 1, "x": 2}\n', r"is a file of JSON lines; save it as CSV"),
        ("e.jsonl", b'{"t": 0, "x": 1}\n{"t": 1, "x": 2}\n', r"is a file of JSON lines; save it as CSV"),
        ("e.npy", b"PK\x05\x06" + bytes(18), r"is a zip archive; unpack it"),
        ("e.raw", b"% evt 3.0\n% end\n", r"events of a Prophesee camera; convert"),
        ("e.mat", b"MATLAB 5.0 MAT-file", r"is not a MATLAB file of version 5 or later; save it in MATLAB with -v7"),
    ],
)
def test_files_of_other_kinds_are_known_by_their_content(tmp_path, name, begin, message):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / name).write_bytes(begin)
    with pytest.raises(InputError, match=message):
        nt.read_events(tmp_path / "in" / name)
    if name not in ("e.h5", "e.mat"):
        with pytest.raises(InputError, match=message):
            nt.read_events(tmp_path / "in", naming=nt.Naming(pattern="{label}"))


# --- what is no file of events ----------------------------------------------------------------------


def dense(folder: Path) -> dict[str, Path]:
    """One raster in each form in which it may be taken for events."""
    raster, time_s = np.random.default_rng(3).random((40, 3)) < 0.2, np.arange(40) / 1000
    rows = pd.DataFrame(raster.astype(int), columns=["left", "right", "top"])
    timed = pd.DataFrame({"trial": 0, "label": "felt", "time_s": time_s}).join(rows)
    np.savez(folder / "named.npz", raster=raster[None], label=["felt"], time_s=time_s, channel=["a", "b", "c"])
    np.savez(folder / "bare.npz", spikes=2 * raster[None].astype(float), label=["felt"])
    np.save(folder / "one.npy", raster)
    rows.to_csv(folder / "steps.csv", index=False)
    rows.to_csv(folder / "bare.csv", index=False, header=False)
    timed.to_csv(folder / "timed.csv", index=False)
    timed.rename(columns={"time_s": "step"}).assign(step=range(40)).to_csv(folder / "numbered.csv", index=False)
    return {path.name: path for path in folder.iterdir()}


def test_a_raster_that_is_read_as_events_is_refused_with_its_command(tmp_path):
    for path in dense(tmp_path).values():
        with pytest.raises(InputError) as refusal:
            nt.read_events(path)
        assert "holds no events but a raster" in str(refusal.value), path
        fix = "reads a folder of such files, one per trial" if path.suffix == ".csv" else "reads it"
        assert f"; neurotact import raster {fix}" in str(refusal.value), path


def test_that_command_reads_the_same_spikes_from_a_folder(tmp_path):
    files, spikes = dense(tmp_path), []
    for name in ("one.npy", "steps.csv", "bare.csv"):
        folder = tmp_path / name.partition(".")[0] / name[-3:] / "felt"
        folder.mkdir(parents=True)
        files[name].rename(folder / name)
        trains = nt.read_raster(folder.parent, 1000.0)
        spikes.append((trains.steps[0].tolist(), trains.units[0].tolist()))
    assert spikes[0] == spikes[1] == spikes[2]


def test_events_that_lack_a_column_are_taken_for_no_raster(tmp_path):
    for columns in ({"time_s": [0.1, 0.2], "place": [3, 4]}, {"channel": [0, 1], "when": [0.1, 0.2]}):
        pd.DataFrame(columns | {"trial": 0, "label": "a"}).to_csv(tmp_path / "e.csv", index=False)
        with pytest.raises(InputError, match="no column is called"):
            nt.read_events(tmp_path / "e.csv")


def test_the_table_of_the_raster_command_is_refused_with_what_comes_back_whole(tmp_path):
    """It has no classes; as .nwb the same spikes come back."""
    touch = nt.Recordings(np.random.default_rng(1).normal(size=(4, 200, 2)) * 20, 1000.0, "mV", ["a", "b"] * 2)
    felt = nt.encode(touch)
    hdf5.save_spikes(felt, tmp_path / "s.h5")
    for suffix in (".csv", ".nwb"):
        nt.save_raster(tmp_path / "s.h5", tmp_path / f"r{suffix}")
    with pytest.raises(InputError, match=r"neurotact raster wrote this table.*write that as .nwb"):
        nt.read_events(tmp_path / "r.csv")
    back = nt.read_nwb(tmp_path / "r.nwb")
    assert sum(map(len, felt.steps))
    assert [each.tolist() for each in back.steps] == [each.tolist() for each in felt.steps]
    assert back.labels.tolist() == felt.labels.tolist()


def test_trials_that_are_numbered_in_floats_have_their_conditions(tmp_path):
    """As the columns of one array of floats are saved."""
    of_trials = {"channel": [0, 1, 0], "time": [0.0, 0.1, 0.3], "label": ["a", "b"]}
    for numbers in ([0, 1, 1], [0.0, 1.0, 1.0]):
        np.savez(tmp_path / "e.npz", trial=numbers, **of_trials)
        assert nt.read_events(tmp_path / "e.npz").conditions["label"].tolist() == ["a", "b"]


def _structure(path: Path, columns: dict) -> None:
    scipy.io.savemat(path, {"td_data": {name: np.asarray(values) for name, values in columns.items()}})


def _tensors(path: Path, columns: dict) -> None:
    torch.save({name: torch.from_numpy(np.asarray(values)) for name, values in columns.items()}, path)


def _parquet(path: Path, columns: dict) -> None:
    pytest.importorskip("pyarrow", reason="no pyarrow; pip install 'neurotact[parquet]'")
    pd.DataFrame(columns).to_parquet(path)


@pytest.mark.parametrize(("write", "suffix"), [(_structure, "mat"), (_tensors, "pt"), (_parquet, "parquet")])
def test_fields_of_a_structure_tensors_and_parquet_are_columns(tmp_path, write, suffix):
    for number, label in enumerate(("felt", "silk")):
        (tmp_path / label).mkdir()
        columns = {"x": [0, 2, 1], "y": [1, 0, 1], "p": [1, -1, 1], "ts": [1000, 2000, 5000 + 1000 * number]}
        write(tmp_path / label / f"touch.{suffix}", columns)
    trains = nt.read_events(tmp_path)
    named = [(int(step), trains.afferents[unit]) for step, unit in zip(trains.steps[1], trains.units[1], strict=True)]
    assert named == [(1, "ON x0y1"), (2, "OFF x2y0"), (6, "ON x1y1")]
    assert trains.conditions["label"].tolist() == ["felt", "silk"]
    with pytest.raises(InputError, match=r"called label|without a class"):
        nt.read_events(tmp_path / "felt" / f"touch.{suffix}")


def test_a_structure_may_hold_all_trials_and_their_classes(tmp_path):
    labels = np.array(["felt", "felt", "silk"], object)
    _structure(tmp_path / "all.mat", {"ts": [1, 2, 1], "x": [0, 1, 0], "trial": [0, 0, 1], "label": labels})
    assert nt.read_events(tmp_path / "all.mat").conditions["label"].tolist() == ["felt", "silk"]


def test_a_structure_without_times_is_refused(tmp_path):
    (tmp_path / "felt").mkdir()
    _structure(tmp_path / "felt" / "touch.mat", {"x": [0, 2, 1], "y": [1, 0, 1]})
    with pytest.raises(InputError, match=r"holds 'td_data/x' of the shape \(3,\)"):
        nt.read_events(tmp_path)
