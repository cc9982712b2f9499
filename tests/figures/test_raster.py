"""A raster shows every spike once, and its events survive being written."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.errors import InputError
from neurotact.figures import raster

NAMES = ("SA-I taxel1", "SA-I taxel2", "RA-I taxel1", "RA-I taxel2")
RATE_Hz = 1000.0


def trains_of(spikes: np.ndarray) -> SpikeTrains:
    conditions = pd.DataFrame({"label": ["felt"] * len(spikes), "force_N": [12.0] * len(spikes)})
    return from_rasters(spikes, RATE_Hz, NAMES, conditions)


@pytest.fixture
def trains():
    return trains_of((np.random.default_rng(0).random((3, 500, 4)) < 0.05).astype(np.uint8))


def strokes(axes, kind):
    """Times and rows of the ticks of one population."""
    (line,) = [line for line in axes.lines if line.get_gid() == kind]
    x, y = (np.asarray(values).reshape(-1, 3) for values in line.get_data())
    assert (x[:, 0] == x[:, 1]).all()
    return x[:, 0], np.rint(y[:, :2].mean(axis=1)).astype(int)


@given(arrays(np.uint8, (1, 30, 4), elements=st.integers(0, 1)))
def test_every_spike_is_one_tick_in_the_row_of_its_afferent(spikes):
    axes = raster.draw_raster(trains_of(spikes), 0).axes[0]
    drawn = {kind: set(zip(*map(np.ndarray.tolist, strokes(axes, kind)), strict=True)) for kind in ("SA-I", "RA-I")}
    expected = {(step / RATE_Hz, unit) for step, unit in np.argwhere(spikes[0])}
    assert drawn["SA-I"] == {event for event in expected if event[1] < 2}
    assert drawn["RA-I"] == {event for event in expected if event[1] >= 2}


def test_a_stretch_shows_its_spikes_alone(trains):
    axes = raster.draw_raster(trains, 1, start_s=0.1, stop_s=0.2).axes[0]
    times = np.concatenate([strokes(axes, kind)[0] for kind in ("SA-I", "RA-I")])
    assert len(times) == ((trains.steps[1] >= 100) & (trains.steps[1] < 200)).sum()
    assert axes.get_xlim() == (0.1, 0.2)


def test_the_signal_stands_above_with_its_unit_and_clock(trains):
    signal = np.random.default_rng(0).normal(size=(1000, 2))
    above, below = raster.draw_raster(trains, 0, (signal, 2000.0, "mV"), start_s=0.1).axes[:2]
    assert above.get_ylabel() == "signal (mV)"
    assert below.get_xlabel() == "time (s)"
    assert len(above.lines) == 2
    np.testing.assert_array_equal(above.lines[1].get_ydata(), signal[200:, 1])
    np.testing.assert_allclose(above.lines[1].get_xdata()[[0, -1]], [0.1, 0.4995])


def test_the_two_populations_have_two_colours(trains):
    colours = {line.get_gid(): line.get_color() for line in raster.draw_raster(trains, 0).axes[0].lines}
    assert colours == {"SA-I": raster.SA, "RA-I": raster.RA}


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_the_suffix_chooses_the_format_and_the_bytes_repeat(trains, tmp_path, suffix, start):
    paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for path in paths:
        raster.write_raster(trains, 0, path)
    first, second = (path.read_bytes() for path in paths)
    assert first.startswith(start)
    assert first == second


def test_a_silent_trial_and_hundreds_of_afferents_are_drawn(tmp_path):
    names = tuple(f"{kind} taxel{i}" for kind in ("SA-I", "RA-I") for i in range(100))
    silent = from_rasters(np.zeros((1, 50, 200), np.uint8), RATE_Hz, names, pd.DataFrame({"label": ["felt"]}))
    raster.write_raster(silent, 0, tmp_path / "silent.png")


@given(arrays(np.uint8, (2, 40, 4), elements=st.integers(0, 1)))
def test_written_events_read_back_as_the_same_spikes(tmp_path_factory, spikes):
    path = tmp_path_factory.mktemp("events") / "events.csv"
    raster.write_events(trains_of(spikes), path)
    table = pd.read_csv(path)
    assert list(table.columns) == ["trial", "afferent", "type", "time_s"]
    again = np.zeros_like(spikes)
    steps = np.rint(table["time_s"].to_numpy(float) * RATE_Hz).astype(int)
    again[table["trial"].to_numpy(int), steps, [NAMES.index(name) for name in table["afferent"]]] = 1
    np.testing.assert_array_equal(again, spikes)
    assert [name.split()[0] for name in table["afferent"]] == table["type"].tolist()


def test_chosen_trials_keep_their_numbers(trains, tmp_path):
    raster.write_events(trains, tmp_path / "events.csv", trials=[2])
    table = pd.read_csv(tmp_path / "events.csv")
    assert set(table["trial"]) == {2}
    assert len(table) == len(trains.steps[2])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda t, d: raster.write_raster(t, 0, d / "raster.jpg"), r"raster\.jpg.*\.png.*\.svg.*\.pdf.*\.csv"),
        (lambda t, d: raster.write_events(t, d / "events.txt"), r"events\.txt.*\.csv"),
        (lambda t, d: raster.write_raster(t, 7, d / "raster.png"), "trial 7.*0 to 2"),
        (lambda t, d: raster.write_events(t, d / "e.csv", trials=[-1]), "trial -1.*0 to 2"),
        (lambda t, d: raster.draw_raster(t, 0, start_s=0.6), "start 0.6 s.*0.5 s"),
        (lambda t, d: raster.draw_raster(t, 0, (np.zeros(5), 1000.0, "mV")), r"signal.*\(time, taxel\)"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_fix(trains, tmp_path, call, words):
    with pytest.raises(InputError, match=words):
        call(trains, tmp_path)
    assert list(tmp_path.iterdir()) == []
