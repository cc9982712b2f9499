"""Events of any sensor: the same from every kind of file, populations as the data name them, nothing unpickled."""

import os
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from as_specs import of_events
from hypothesis import given
from hypothesis import strategies as st
from in_process import typed
from levels import examples
from neurotact_parts.readers.events.spikes import Events, EventSpec, to_trains

import neurotact as nt
from neurotact.cli import recordings as recordings_commands
from neurotact.errors import InputError
from neurotact.figures.raster import painted_populations
from neurotact.networks.use.measuring import spikes_column

N_TRIALS, N_CHANNELS = 6, 4
DATA = Path(os.environ.get("NEUROTACT_DATA", "../shared/data"))


def made(seed: int = 0) -> pd.DataFrame:
    """Events of six touches, in no order; every trial and channel has one."""
    rng = np.random.default_rng(seed)
    n = 200
    table = pd.DataFrame({"trial": rng.integers(0, N_TRIALS, n), "time_ms": rng.integers(0, 500, n) + 0.5})
    table["channel"], table["polarity"] = rng.integers(0, N_CHANNELS, n), rng.integers(0, 2, n)
    table.loc[: N_TRIALS - 1, "trial"] = range(N_TRIALS)
    table.loc[: N_CHANNELS - 1, "channel"] = range(N_CHANNELS)
    return table.assign(label=np.where(table["trial"] % 2, "silk", "felt"), force_N=table["trial"] * 0.5)


def raster_of(trains) -> np.ndarray:
    found = np.zeros((len(trains), int(trains.trial_steps.max()), len(trains.afferents)), bool)
    for trial, (steps, units) in enumerate(zip(trains.steps, trains.units, strict=True)):
        found[trial, steps, units] = True
    return found


def expected_of(table: pd.DataFrame, step_ms: float = 1.0) -> np.ndarray:
    steps = np.floor(table["time_ms"] / step_ms).astype(int)
    found = np.zeros((N_TRIALS, steps.max() + 1, 2 * N_CHANNELS), bool)
    found[table["trial"], steps, table["polarity"] * N_CHANNELS + table["channel"]] = True
    return found


@given(st.integers(0, 2**31), st.sampled_from([0.5, 1.0, 7.0]))
@examples(20)
def test_a_table_and_arrays_are_the_same_events(tmp_path_factory, seed, step_ms):
    """CSV with text, NPZ with one value per trial: the spikes are those that are counted by hand."""
    table, place = made(seed), tmp_path_factory.mktemp("events")
    table.sort_values("trial", kind="stable").to_csv(place / "events.csv", index=False)
    columns = {f"event_{name}": table[name].to_numpy() for name in ("trial", "time_ms", "channel", "polarity")}
    per_trial = table.drop_duplicates("trial").sort_values("trial")
    np.savez(place / "events.npz", **columns, letter=per_trial["label"].to_numpy(str), force_N=per_trial["force_N"])
    spec = {"step_ms": step_ms, "merge_events": True}
    one = nt.read_events(place / "events.csv", **of_events(spec))
    other = nt.read_events(place / "events.npz", **of_events(spec), names={"label": "letter"})
    for found in (one, other):
        np.testing.assert_array_equal(raster_of(found), expected_of(table, step_ms))
        assert found.afferents[:5] == ("OFF channel0", "OFF channel1", "OFF channel2", "OFF channel3", "ON channel0")
        assert found.conditions["label"].tolist() == ["felt", "silk"] * 3
        assert found.conditions["force_N"].tolist() == [0, 0.5, 1, 1.5, 2, 2.5]
    nt.save(one, place / "spikes.h5")
    again = nt.load(place / "spikes.h5")
    np.testing.assert_array_equal(raster_of(again), raster_of(one))


@pytest.mark.parametrize(("polarity", "chosen"), [("merge", [0, 1]), ("on", [1]), ("off", [0])])
def test_a_polarity_is_chosen_or_both_are_one(tmp_path, polarity, chosen):
    table = made()
    table.to_csv(tmp_path / "e.csv", index=False)
    found = nt.read_events(
        tmp_path / "e.csv", events=nt.Events(polarity=polarity, channels="a,b,c,d", duration_ms=500, merge_events=True)
    )
    assert found.afferents == (("a", "b", "c", "d"))
    expected = np.zeros((N_TRIALS, 500, N_CHANNELS), bool)
    some = table[table["polarity"].isin(chosen)]
    expected[some["trial"], some["time_ms"].astype(int), some["channel"]] = True
    order = list(dict.fromkeys(table["trial"]))  # trials in the order in which they come
    np.testing.assert_array_equal(raster_of(found), expected[order])


def heidelberg(path, *, n: int = 5) -> list[tuple[np.ndarray, np.ndarray]]:
    """A file as the Digits are published: half precision, gzip, keys, speakers, and a group of notes."""
    rng = np.random.default_rng(0)
    trials = [(np.sort(rng.random(20)).astype(np.float16), rng.integers(0, 70, 20).astype(np.uint16)) for _ in range(n)]
    with h5py.File(path, "w") as file:
        times = file.create_dataset("spikes/times", (n,), h5py.vlen_dtype(np.float16))
        units = file.create_dataset("spikes/units", (n,), h5py.vlen_dtype(np.uint16))
        for i, (time, unit) in enumerate(trials):
            times[i], units[i] = time, unit
        file["labels"] = np.arange(n, dtype=np.uint8) % 2
        file["extra/keys"] = np.array([b"zero", b"one"])
        file["extra/speaker"] = np.arange(n, dtype=np.uint8)
        file.create_group("extra/meta_info")
    return trials


def test_a_polarity_of_another_name_is_not_lost_silently(tmp_path, caplog):
    events = made().drop_duplicates(["trial", "time_ms", "channel"])
    events.rename(columns={"polarity": "edge"}).to_csv(tmp_path / "e.csv", index=False)
    named = nt.read_events(tmp_path / "e.csv", names={"polarity": "edge"})
    np.testing.assert_array_equal(raster_of(named), expected_of(events))
    assert not caplog.messages
    merged = nt.read_events(tmp_path / "e.csv")
    assert len(merged.afferents) == N_CHANNELS
    (message,) = caplog.messages
    assert "not used, because the value changes within a trial: edge;" in message


def test_names_are_given_one_an_option_or_several_at_once():
    known = ["time", "channel", "trial", "label", "polarity"]

    def parse(given):
        return recordings_commands._names(given, known)

    several = parse(["time=ts_us,channel=idx, old,label=shape", "polarity=edge"])
    assert several == {"time": "ts_us", "channel": "idx, old", "label": "shape", "polarity": "edge"}
    assert parse(["time=ts_us", "channel=idx, old", "label=shape", "polarity=edge"]) == several
    for wrong in ("tim=ts", "time=", "time"):
        with pytest.raises(InputError, match="must read WHAT=NAME"):
            parse([wrong])


@pytest.mark.parametrize(("command", "said"), [
    ("arrays", "signals, label, channels"), ("raster", "signals, label, channels"),
    ("events", "time, channel, population, trial, label, polarity"),
])  # fmt: skip
def test_an_import_says_what_names_it_takes(command, said, tmp_path):
    np.savez(tmp_path / "a.npz", X=np.ones((2, 20, 2)))
    unit = ["--unit", "mV"] if command == "arrays" else []
    words = ["import", command, tmp_path / "a.npz", *unit, "--names", "a=b", "-o", tmp_path / "a.h5"]
    assert typed(*words).err.endswith(f"where WHAT is one of {said}\n")


def test_a_heidelberg_file_loads_as_it_is(tmp_path, caplog):
    trials = heidelberg(tmp_path / "shd.h5")
    found = nt.load(tmp_path / "shd.h5")
    assert "clock of 1 ms" in caplog.text
    assert found.conditions.values.tolist() == [["zero", 0], ["one", 1], ["zero", 2], ["one", 3], ["zero", 4]]
    assert found.sampling_rate_Hz == 1000.0
    assert found.populations.keys() == {"afferents"}
    for (time, unit), steps, units in zip(trials, found.steps, found.units, strict=True):
        expected = {(int(np.floor(t * 1000.0 + 1e-9)), int(u)) for t, u in zip(time.astype(float), unit, strict=True)}
        assert set(zip(steps.tolist(), units.tolist(), strict=True)) == expected
    coarse = nt.read_events(tmp_path / "shd.h5", events=nt.Events(step_ms=100, n_channels=700))
    assert (coarse.trial_steps[0], len(coarse.afferents)) == (10, 700)


@pytest.mark.parametrize("what", ["labels", "units", "keys"])
def test_a_heidelberg_file_that_disagrees_with_itself_is_refused(tmp_path, what):
    heidelberg(tmp_path / "shd.h5")
    with h5py.File(tmp_path / "shd.h5", "a") as file:
        if what == "labels":
            del file["labels"]
            file["labels"] = np.zeros(3, np.uint8)
        elif what == "units":
            file["spikes/units"][0] = np.zeros(3, np.uint16)
        else:
            file["labels"][0] = 7
    with pytest.raises(InputError, match=r"shd\.h5: .*(labels|differ in length)"):
        nt.read_events(tmp_path / "shd.h5")


def test_structured_arrays_of_a_grid(tmp_path):
    """x, y, t in us and p, one file per trial, with stamps that count from long before."""
    kind = np.dtype([("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "?")])
    for label, x in (("felt", 2), ("silk", 0)):
        (tmp_path / label).mkdir()
        np.save(tmp_path / label / "0.npy", np.array([(x, 1, 10**9, True), (0, 0, 10**9 + 3500, False)], kind))
    found = nt.read_events(tmp_path, events=nt.Events(origin="first", sensor="3x2"))
    assert found.conditions["label"].tolist() == ["felt", "silk"]
    assert [found.afferents[unit] for unit in found.units[0]] == ["ON x2y1", "OFF x0y0"]
    assert [found.afferents[unit] for unit in found.units[1]] == ["ON x0y1", "OFF x0y0"]
    assert found.steps[0].tolist() == [0, 3]
    assert len(found.afferents) == 12
    with pytest.raises(InputError, match=r"a grid of 3x2, but `sensor` is 2x2"):
        nt.read_events(tmp_path, events=nt.Events(origin="first", sensor="2x2"))


def test_populations_are_those_of_the_data(tmp_path):
    table = made().assign(population=lambda t: np.where(t["polarity"], "PC", "SA1")).drop(columns="polarity")
    table.to_csv(tmp_path / "e.csv", index=False)
    found = nt.read_events(tmp_path / "e.csv")
    assert {name: len(its) for name, its in found.populations.items()} == {"PC": 4, "SA1": 4}
    assert [spikes_column(name) for name in found.populations] == ["spikes_pc", "spikes_sa1"]
    assert len({colour for _, colour, _ in painted_populations(found)}) == 2


def test_a_pickle_is_never_opened(tmp_path):
    np.save(tmp_path / "e.npy", np.array([{"t": 1}], object), allow_pickle=True)
    np.savez(tmp_path / "e.npz", t=np.array([{"t": 1}], object))
    for name in ("e.npy", "e.npz"):
        with pytest.raises(InputError, match="pickled"):
            nt.read_events(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("trial,time,channel\n0,0.1,2\n", {}, "no column is called label"),
        ("trial,time,label\n0,0.1,a\n", {}, "no column is called channel"),
        ("0,0.1,2\n0,0.2,1\n", {}, "line 1 holds a row, but must name the columns"),
        ("trial,time,channel,label\n0,x,2,a\n", {}, r"event 0 of 'time' is 'x', not a number"),
        ("trial,time,channel,label\n0,nan,2,a\n", {}, "not a number|is nan"),
        ("trial,time,channel,label\n0,-1,2,a\n", {}, "before zero; pass `origin='first'`"),
        ("trial,time,channel,label\n0,1,-2,a\n", {}, "channel -2 is negative"),
        ("trial,time,channel,label\n0,1,2,a\n0,2,2,b\n", {}, "'label' changes within a trial"),
        ("trial,time,channel,label\n0,1e12,2,a\n", {}, "beyond any clock of 1 ms"),
        ("trial,time,channel,label\n0,1,2,a\n", {"n_channels": 2}, "channel 2 has events, but there are 2 channels"),
        ("trial,time,channel,label\n0,1,2,a\n", {"polarity": "on"}, "holds no polarity"),
        ("trial,time,channel,p,label\n0,1,2,1,a\n0,1,2,2,a\n0,1,2,3,a\n", {}, "has 3 polarities"),
        ("trial,time,channel,label\n", {}, "holds no row below its header"),
        (
            "trial,time,channel,label\n0,1,2,a,7,8\n",
            {},
            "line 2 has 6 columns where 4 are expected, the names",
        ),
    ],
)
def test_events_that_cannot_be_read_are_named(tmp_path, text, options, message):
    (tmp_path / "e.csv").write_text(text)
    with pytest.raises(InputError, match=message) as refusal:
        nt.read_events(tmp_path / "e.csv", **of_events(options))
    assert "\n" not in str(refusal.value)


def test_an_event_belongs_to_the_step_that_it_falls_into():
    """0.3 ms is the third step of 0.1 ms although 0.3 / 0.1 is a little less than 3 in binary."""
    one = Events(np.array([0.0003]), np.array([0]), None, np.array([0]), pd.DataFrame({"label": ["felt"]}))
    assert to_trains(one, EventSpec(step_ms=0.1), "e.csv").steps[0].tolist() == [3]


@pytest.mark.thorough
def test_braille_letters_are_ordinary_events():
    path = DATA / "braille-th10" / "events.npz"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    found = nt.read_events(
        path, names={"label": "letter"}, events=nt.Events(step_ms=5, polarities="ON,OFF", n_channels=12)
    )
    published = nt.read("braille-letters", path)
    assert found.conditions["label"].tolist() == published.conditions["label"].tolist()
    for steps, units, theirs, its in zip(found.steps, found.units, published.steps, published.units, strict=True):
        np.testing.assert_array_equal(steps, theirs)
        np.testing.assert_array_equal(units, its)
