"""What a study's cells share: the table of firing, and what it cannot be made of."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.opponents import scikit_learn

import neurotact as nt
from neurotact.baselines import opponents
from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.hdf5 import load_spikes
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.data.splits import Split, split_conditions
from neurotact.data.windows import Windows, WindowSpec, cut
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost
from neurotact.studies import preparation, study
from neurotact.studies.encoding_tables import encoding_table

CELL = next(study.cells(study.resolve("refractory-period", {"window.start_ms": 50, "window.length_ms": 100})))


def trains_of(seconds):
    signals = np.full((4, round(seconds * 2000), 2), 8.0) * np.sin(np.arange(round(seconds * 2000)) / 40.0)[:, None]
    table = pd.DataFrame({"label": ["felt", "felt", "silk", "silk"], "force_N": [3, 6, 3, 6]})
    return encode_recordings(Recordings(signals, 2000.0, "mV", table), CELL.encoder)


def test_the_table_of_firing_has_a_row_a_class_and_condition():
    trains = trains_of(0.5)
    table = encoding_table(trains, CELL, ["force_N"])
    assert table[["label", "force_N"]].values.tolist() == [["felt", 3], ["felt", 6], ["silk", 3], ["silk", 6]]
    # The one window of a trial lasts from 50 to 150 ms, the touch from 50 ms to its end; both at 2 kHz.
    for columns, last, seconds in (("", 300, 0.1), ("touch_", 1000, 0.45)):
        felt = [
            np.isin(u, np.flatnonzero(trains.is_sa)) & (s >= 100) & (s < last)
            for s, u in zip(trains.steps, trains.units, strict=True)
        ]
        np.testing.assert_allclose(table[f"{columns}spikes_sa_per_s"], [inside.sum() / seconds for inside in felt])
    assert set(table.stretch) == {"windows of 100 ms from 50 ms on"}
    np.testing.assert_allclose(table.spikes_total_per_s, table.spikes_sa_per_s + table.spikes_ra_per_s)


def cell_of(**changes):
    return CELL.model_copy(update=changes)


def one_train(steps, n_steps=100):
    """One trial at 1 kHz whose SA-I afferent spikes at these steps, and its RA-I afferent never."""
    raster = np.zeros((1, n_steps, 2), np.uint8)
    raster[0, steps, 0] = 1
    return from_rasters(raster, 1000.0, ("SA-I a", "RA-I a"), pd.DataFrame({"label": ["felt"]}))


def test_rates_and_intervals_are_of_the_classified_windows():
    """Windows from 10, 30 and 50 ms on, of 20 ms: spikes before, after and intervals across their ends do not count."""
    trains = one_train([5, 9, 10, 14, 29, 30, 36, 71, 99])
    cell = cell_of(window=WindowSpec(length_ms=20, start_ms=10, per_trial=3))
    (row,) = encoding_table(trains, cell, []).to_dict("records")
    assert row["spikes_sa_per_s"] == pytest.approx(5 / 0.060)
    assert row["isi_sa_ms"] == pytest.approx((4 + 15 + 6) / 3)
    assert row["touch_spikes_sa_per_s"] == pytest.approx(7 / 0.090)
    assert row["touch_isi_sa_ms"] == pytest.approx((99 - 10) / 6)
    assert (row["spikes_ra_per_s"], row["sa_share"]) == (0.0, 1.0)


def test_a_trial_that_ends_before_its_window_begins_changes_no_row_of_the_others():
    """Windows leave it out; so do the spikes of the touch, also where it is the only one of its class and condition."""
    long = np.zeros((100, 2), np.uint8)
    long[[5, 12, 40], 0] = 1
    rasters = [long[:8], *[long] * 20, long[:8], *[long] * 20]
    table = pd.DataFrame({"label": ["felt"] * 21 + ["silk"] * 21, "force_N": [1, *[3] * 20, 3, *[3] * 20]})
    trains = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), table)
    cell = cell_of(window=WindowSpec(length_ms=20, start_ms=10, per_trial=1))
    rows = encoding_table(trains, cell, ["force_N"]).set_index(["label", "force_N"])
    assert rows.loc[("silk", 3), "touch_spikes_sa_per_s"] == pytest.approx(2 / 0.090)
    assert rows.loc[("felt", 3), "touch_spikes_sa_per_s"] == pytest.approx(2 / 0.090)
    assert np.isnan(rows.loc[("felt", 1), "touch_spikes_sa_per_s"])


def test_windows_at_contact_are_told_so_and_the_touch_counts_from_there():
    """Contact comes after 60 and 80 ms of rest; each touch has a spike a ms for 20 ms and none in the last 20 ms."""
    raster = np.zeros((2, 120, 2), np.uint8)
    raster[0, 60:80, 0] = raster[1, 80:100, 0] = 1
    table = pd.DataFrame({"label": ["felt", "silk"]})
    trains = from_rasters(raster, 1000.0, ("SA-I a", "RA-I a"), table)
    window = WindowSpec(length_ms=10, per_trial=1, align="onset")
    onsets = trains.begins(window, np.arange(2))
    rows = encoding_table(trains, cell_of(window=window), [])
    assert set(rows.stretch) == {"windows of 10 ms from 0 ms after the onset of contact on"}
    left = [(raster[trial, first:, 0].sum(), 120 - first) for trial, first in enumerate(onsets)]
    assert rows["touch_spikes_sa_per_s"].tolist() == pytest.approx([1e3 * n / n_steps for n, n_steps in left])
    alone = encoding_table(trains, cell_of(window=window, network=None), [])
    assert set(alone.stretch) == {"from 0 ms after the onset of contact to the trial's end"}


def test_windows_that_overlap_each_count_their_spikes():
    cell = cell_of(window=WindowSpec(length_ms=20, hop_ms=10))
    (row,) = encoding_table(one_train([15], n_steps=40), cell, []).to_dict("records")
    assert row["spikes_sa_per_s"] == pytest.approx(2 / 0.060)  # windows from 0, 10 and 20 ms on, two of which hold it


def test_what_encodes_alone_has_the_rates_of_the_touch():
    trains = one_train([5, 50, 80])
    (row,) = encoding_table(trains, cell_of(network=None, window=WindowSpec(start_ms=10)), []).to_dict("records")
    assert row["spikes_sa_per_s"] == pytest.approx(2 / 0.090)
    assert row["stretch"] == "from 10 ms to the trial's end"
    assert not any(column.startswith("touch_") for column in row)


def test_the_rates_of_windows_are_the_input_spikes_of_results():
    """What the networks are fed and what the table says are the same spikes."""
    trains = trains_of(0.5)
    table = encoding_table(trains, CELL, [])
    windows = cut(trains.trial_steps, trains.sampling_rate_Hz, CELL.window)
    sent = trains.raster(windows).sum(axis=(1, 2)) / 0.1
    np.testing.assert_allclose(table.spikes_total_per_s, [sent[:2].mean(), sent[2:].mean()])


@given(
    lengths_ms=st.lists(st.floats(20, 200), min_size=1, max_size=3), start_ms=st.floats(0, 100),
    per_trial=st.none() | st.integers(1, 3),
)  # fmt: skip
@examples(6)
def test_spikes_after_the_last_window_are_not_kept_and_no_window_misses_them(lengths_ms, start_ms, per_trial):
    trains = trains_of(0.5)
    specs = [WindowSpec(length_ms=each, start_ms=start_ms, per_trial=per_trial) for each in lengths_ms]
    kept, cuts = trains.until(*specs), [*map(trains.cut, specs)]
    for windows in cuts:
        raster = trains.raster(windows)
        np.testing.assert_array_equal(kept.raster(windows), raster)
        np.testing.assert_array_equal(kept.counts(windows), raster.sum(axis=(1, 2)))
    end = max(int((windows.start + windows.n_steps).max()) for windows in cuts)
    assert max(steps.max(initial=0) for steps in kept.steps) < end
    np.testing.assert_array_equal(kept.trial_steps, trains.trial_steps)
    assert kept.until(*specs).steps[0].tolist() == kept.steps[0].tolist()
    is_cut = end < trains.trial_steps.max()
    assert kept.until_s == (end / trains.sampling_rate_Hz if is_cut else None)
    assert kept.until(*specs).until_s == kept.until_s
    if is_cut:
        with pytest.raises(InputError, match=r"window: ends at .* but the spikes are those of the first"):
            kept.cut(WindowSpec(length_ms=1e3 * int(trains.trial_steps.min()) / trains.sampling_rate_Hz))


def test_spikes_that_end_with_the_windows_say_so_wherever_they_are_shown(tmp_path):
    """The rate is that of the time whose spikes are held."""
    trains = trains_of(0.5)
    kept = trains.until(WindowSpec(length_ms=50, per_trial=1))
    lines = {}
    for name, each in {"whole": trains, "kept": kept}.items():
        nt.save(each, tmp_path / f"{name}.h5")
        lines[name] = []
        nt.describe(tmp_path / f"{name}.h5", show=lambda line, name=name: lines[name].append(str(line)))
        nt.save_raster(tmp_path / f"{name}.h5", tmp_path / f"{name}.csv", tell=lines[name].append)
        title = nt.plot_raster(nt.load_spikes(tmp_path / f"{name}.h5"))._suptitle.get_text()
        assert title.endswith("spikes of the first 0.05 s alone") == (name == "kept")
    told = "spikes of the first 0.05 s of a trial alone: a study keeps those of its windows"
    assert told in lines["kept"]
    assert lines["kept"][-1] == f"{tmp_path / 'kept.csv'}: {told}"
    assert lines["whole"][-1] == str(tmp_path / "whole.csv")
    assert not any(told in line for line in lines["whole"])
    held_s = 0.05 * len(kept)
    assert f"({sum(map(len, kept.steps)) / held_s / len(kept.afferents):.3g} Hz per afferent)" in repr(kept)


def test_the_file_of_a_study_holds_what_its_cells_use(tmp_path, monkeypatch):
    """All windows, also more of them for training."""
    table = pd.DataFrame({"label": ["felt", "silk"] * 20, "force_N": [3, 3, 6, 6] * 10})
    waves = 8.0 * np.sin(np.arange(1000) / 40.0)[:, None]
    touches = Recordings(waves + np.random.default_rng(0).normal(0, 1, (40, 1, 2)), 2000.0, "mV", table)
    monkeypatch.setattr(preparation, "load_recordings", lambda _: touches)
    changes = {
        "dataset.stratify": ["force_N"], "dataset.subsets": {"light": {"force_N": 3}}, "sweep.dataset": ["light"],
        "baselines": "none", "window.start_ms": 50, "window.length_ms": 100, "window.per_trial": 1,
    }  # fmt: skip
    ends = []
    for number, more in enumerate([{}, {"training_windows": 2}]):
        what = study.resolve("refractory-period", {**changes, **more})
        cells = [*study.cells(what)]
        preparation.prepare(tmp_path / f"{number}", what, cells)
        trains = load_spikes(tmp_path / f"{number}" / cells[0].given)
        whole = encode_recordings(touches, cells[0].encoder)
        ends.append(1 + max(int(steps.max()) for steps in trains.steps))
        assert trains.trial_steps.tolist() == whole.trial_steps.tolist()
    assert ends[0] <= 300 < ends[1] <= 500 < max(int(steps.max()) for steps in whole.steps)


def test_a_window_that_starts_past_the_end_is_refused():
    with pytest.raises(InputError, match=r"window\.start_ms: 50 ms is past the end of trial 0, which lasts 0\.040 s"):
        encoding_table(trains_of(0.04), CELL, [])


def test_a_split_is_balanced_over_the_conditions_it_is_told():
    table = pd.DataFrame({"label": ["felt", "silk"] * 40, "force_N": [3, 3, 6, 6] * 20})
    for side in split_conditions(table, ["force_N"], CELL.split):
        counts = table.iloc[side].value_counts()
        assert counts.max() == counts.min()
    with pytest.raises(InputError, match="there is no condition 'force'; did you mean 'force_N'"):
        split_conditions(table, ["force"], CELL.split)


@pytest.mark.parametrize("only_known", [False, True])
def test_gains_are_fitted_on_training_trials_alone(tmp_path, monkeypatch, only_known):
    """Of 40 trials 28 are for training, 14 of them with the known force; each trial's signal is its own number."""
    numbers = np.arange(40)
    table = pd.DataFrame({"label": ["felt", "silk"] * 20, "force_N": [3, 3, 6, 6] * 10})
    touches = Recordings(numbers[:, None, None] * np.ones((40, 400, 2)), 2000.0, "mV", table)
    changes = {
        "calibrate": True, "test_every_condition": only_known, "dataset.stratify": ["force_N"],
        "dataset.subsets": {"light": {"force_N": 3}}, "sweep.dataset": ["light"], "window.start_ms": 0,
    }  # fmt: skip
    what = study.resolve("refractory-period", changes)
    cell = next(study.cells(what))
    given = []

    def fitted(recordings, spec, *, rule, tell, progress):
        assert rule.spikes_per_s is None
        assert tell
        given.append(sorted({int(signal[0, 0]) for signal in recordings.signals}))
        return SimpleNamespace(encoder=spec.model_copy(update={"tau_mem_ms": 8.0}))

    monkeypatch.setattr(preparation, "calibration_for", lambda spec, given, **choices: (fitted, 1))
    monkeypatch.setattr(preparation, "load_recordings", lambda _: touches)
    preparation.prepare(tmp_path, what, [cell])
    train = split_conditions(table, ["force_N"], cell.split).train
    expected = [n for n in train.tolist() if not only_known or table.force_N[n] == 3]
    assert given == [expected]
    assert len(expected) == (14 if only_known else 28)
    made = load_spikes(tmp_path / cell.given).encoder
    assert made["tau_mem_ms"] == 8.0
    assert made["sa1"]["t_ref_ms"] == cell.encoder.sa1.t_ref_ms


@pytest.mark.parametrize(("rate_Hz", "length_ms"), [(2000.0, 201), (100.0, 2001)])
def test_a_window_longer_than_the_shortest_trial_is_refused_before_calibration(
    tmp_path, monkeypatch, rate_Hz, length_ms
):
    """The second skin is calibrated on a clock of 1 kHz, on which its 200 samples are 2 s."""
    table = pd.DataFrame({"label": ["felt", "silk"] * 20, "force_N": [3, 3, 6, 6] * 10})
    short = round(0.2 * rate_Hz) if rate_Hz == 2000.0 else 200
    signals = [np.ones((n, 2)) for n in [700] * 24 + [short] * 4 + [700] * 12]  # more than 5 %
    touches = Recordings(signals, rate_Hz, "mV", table)
    changes = {
        "calibrate": True, "window.start_ms": 0, "dataset.stratify": ["force_N"],
        "encoder.conditioning.ema_cutoff_Hz": None, "dataset.subsets": {"light": {"force_N": 3}},
        "sweep.dataset": ["light"],
    }  # fmt: skip
    lengths = [length_ms - 1, length_ms]  # the longer one is of another cell with the same spikes
    what = study.resolve("refractory-period", {**changes, "sweep.window.length_ms": lengths})
    monkeypatch.setattr(preparation, "load_recordings", lambda _: touches)

    def calibrated(*_, **__):
        raise AssertionError("calibration began")

    monkeypatch.setattr(preparation, "calibration_for", calibrated)
    refused = f"trial 24 lasts {(length_ms - 1) / 1e3:.3f} s, less than the {length_ms / 1e3:.3f} s"
    with pytest.raises(InputError, match=refused):
        preparation.prepare(tmp_path / "longer", what, [*study.cells(what)])
    fitting = study.resolve("refractory-period", {**changes, "window.length_ms": length_ms - 1})
    with pytest.raises(AssertionError, match="calibration began"):
        preparation.prepare(tmp_path / "fitting", fitting, [*study.cells(fitting)])


def test_the_linear_baseline_sees_the_windows_of_the_networks():
    """On a slow skin too: windows are cut on the encoder's clock, and their samples are those inside them."""
    signals = [np.arange(72.0)[:, None] * [1.0, 2.0], np.arange(90.0)[:, None] * [1.0, 2.0]]
    skin = Recordings(signals, 36.0, "mV", pd.DataFrame({"label": ["felt", "silk"]}))
    encoder = CELL.encoder.model_copy(update={"conditioning": ConditioningSpec(resample_Hz=1000.0)})
    trains = encode_recordings(skin, encoder)
    windows = cut(trains.trial_steps, trains.sampling_rate_Hz, WindowSpec(length_ms=500, start_ms=250))
    every = np.ones(len(windows), bool)
    cuts = opponents.Cuts(windows, trains.sampling_rate_Hz, (every, every, every))
    (moments,) = opponents.signal_inputs(skin, cuts, "linear")
    features = moments.features
    assert features.shape == (len(windows), 4)
    # From 250 ms on, 500 ms at 36 Hz: samples 9 to 26, then 27 to 44, and so on.
    means = [np.arange(9 + 18 * k, 27 + 18 * k).mean() for k in (0, 1, 2, 0, 1, 2, 3)]
    np.testing.assert_allclose(features[:, 0], means)
    np.testing.assert_allclose(features[:, 1], 2 * np.array(means))


@pytest.fixture
def told():
    """A window a trial whose one feature tells its class: rightly for training and validation at 3 N, the other way
    round for test trials and at 6 N. The row of a linear classifier, by the conditions of its trials.
    """
    table = pd.DataFrame({"label": ["felt", "silk"] * 12, "force_N": [3, 3, 6, 6] * 6})
    recordings = Recordings(np.zeros((24, 10, 1)), 1000.0, "mV", table)
    trials = np.arange(24)
    sides = Split(trials[:12], trials[12:16], trials[16:])
    is_turned = (table["force_N"] == 6).to_numpy() ^ (trials >= 16)
    features = np.where(recordings.labels.astype(bool) ^ is_turned, 1.0, -1.0)[:, None]
    told = opponents.Input("signals", "told", None, features, Cost(), {"linear": scikit_learn.LOGISTIC_REGRESSION})
    windows = Windows(trials, np.zeros(24, np.int64), 10)

    def rows(where):
        cuts = opponents.cuts_of(table, windows, 1000.0, sides, where)
        (row,) = opponents.rows([told], recordings.labels, cuts)
        return row

    return rows


def test_the_linear_baseline_learns_from_training_trials_and_keeps_the_sides_apart(told):
    row = told({"force_N": 3})
    assert (row["n_train"], row["n_test"]) == (6, 4)
    assert (row["accuracy_validation"], row["accuracy_test"]) == (1.0, 0.0)


def test_the_linear_baseline_of_a_subset_sees_that_subset_alone(told):
    rows = [told(where) for where in ({"force_N": 3}, {"force_N": 6}, {})]
    assert [row["n_train"] for row in rows] == [6, 6, 12]
    assert [row["accuracy_validation"] for row in rows] == [1.0, 1.0, 0.5]
