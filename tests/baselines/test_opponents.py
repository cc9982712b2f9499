"""Classical baselines of a study: what they see, counted by hand, and what they must and must not learn."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.opponents import pooled_gru, scikit_learn

from neurotact.baselines import opponents
from neurotact.baselines.features import band_powers
from neurotact.baselines.opponent import Opponent, Sides, best_of, joined, load
from neurotact.baselines.opponents import Cuts, Input
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.data.splits import Split
from neurotact.data.windows import WindowSpec, cut
from neurotact.encoders.cost import encoding_cost
from neurotact.metrics.flops import Cost

CONDITIONS = pd.DataFrame({"label": ["felt", "silk"] * 20})


def split() -> Split:
    return Split(np.arange(24), np.arange(24, 32), np.arange(32, 40))


def cuts(trial_steps, spec=None, clock_Hz=1000.0) -> Cuts:
    windows = cut(trial_steps, clock_Hz, spec or WindowSpec(length_ms=20))
    return opponents.cuts_of(CONDITIONS, windows, clock_Hz, split(), {})


def test_spikes_are_counted_over_the_window_and_in_its_tenths():
    rasters = np.zeros((40, 20, 2), np.uint8)
    rasters[0, [0, 1, 5, 19], 0] = 1
    rasters[split().test[:2], 3] = 1
    trains = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), CONDITIONS, {"model": "lif"})
    whole, binned = opponents.spike_inputs(trains, (1.0, 5.0), cuts(trains.trial_steps))
    assert whole.features[0].tolist() == [4.0, 0.0]
    assert binned.features[0].reshape(10, 2)[:, 0].tolist() == [2, 0, 1, 0, 0, 0, 0, 0, 0, 1]
    assert binned.words == "10 time bins"
    assert whole.pair == (1.0, 5.0)
    # Each spike is one addition on top of the encoding: 4 spikes in 8 test windows, whatever the others hold.
    assert whole.made.acs - encoding_cost(1, 20, 20.0, {}).acs == pytest.approx(0.5)
    in_sensor = opponents.spike_inputs(trains, (1.0, 5.0), cuts(trains.trial_steps), encoding=False)
    counted = [
        Cost(acs=0.5, signal_ms=20, states_accesses=1.0, buffers_accesses=n * 2, buffers_bytes=4 * n * 2)
        for n in (1, 10)
    ]
    assert [one.made for one in in_sensor] == counted
    events = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), CONDITIONS)
    of_events = list(opponents.spike_inputs(events, (1.0, 5.0), cuts(trains.trial_steps)))
    assert [one.made for one in of_events[:2]] == counted
    assert {one.made.signal_ms for one in of_events} == {20}


def test_signals_are_cut_on_the_encoders_clock():
    """At 100 Hz a window of 20 ms holds the samples at 0 and 10 ms, and the second one those at 20 and 30 ms."""
    signal = np.arange(4.0)[:, None] * np.ones((4, 1))
    recordings = Recordings([signal] * 40, 100.0, "mV", CONDITIONS)
    made = cuts(np.full(40, 31), WindowSpec(length_ms=15))
    moments, binned, *_ = opponents.signal_inputs(recordings, made, "quick")
    assert moments.features[:2].tolist() == [[0.5, 0.5], [2.0, 0.0]]  # from 15 ms on: the sample at 20 ms alone
    assert binned.features.shape == (80, 1)  # of the shortest window, one bin
    assert binned.words == "1 time bin"


def test_a_window_behind_the_last_sample_sees_the_last_one():
    recordings = Recordings([np.array([[1.0], [2.0]])] * 40, 10.0, "mV", CONDITIONS)
    made = cuts(np.full(40, 101), WindowSpec(length_ms=50))
    pieces = list(opponents.pieces_of(recordings, made.windows, 1000.0))
    assert all(len(piece) >= 1 for piece in pieces)


def rows_of(features, of=None):
    made = cuts(np.full(40, 20))
    labels = np.arange(40) % 2
    one = Input("signals", "made up", None, features, Cost(acs=7.0, signal_ms=20.0), of or joined("features", "quick"))
    return list(opponents.rows([one], labels, made))


def test_what_a_line_tells_apart_all_tell_apart():
    features = np.stack([np.arange(40) % 2 * 4.0, np.random.default_rng(0).normal(size=40)], axis=1)
    found = rows_of(features)
    assert [row["classifier"] for row in found] == ["logistic regression", "SVM", "ELM", "extra trees"]
    assert [row["accuracy_test"] for row in found] == [1.0, 1.0, 1.0, 1.0]
    assert {(row["n_train"], row["n_validation"], row["n_test"]) for row in found} == {(24, 8, 8)}
    # Standardising 2 features, and of two classes an output of 2 inputs: 2 + 2 MACs.
    assert found[0]["macs"] == 4
    assert found[0]["energy_estimate_nJ"] == pytest.approx(1e-3 * (4.6 * 4 + 0.9 * 7))


def test_test_windows_choose_nothing():
    """Other features of test windows change what is said of these windows alone."""
    rng = np.random.default_rng(1)
    features = rng.normal(size=(40, 3)) + np.arange(40)[:, None] % 2
    spoilt = features.copy()
    spoilt[32:] = rng.normal(size=(8, 3))
    for before, after in zip(rows_of(features), rows_of(spoilt), strict=True):
        assert before["right"]["test"].keys() == after["right"]["test"].keys()
        known = []
        for row in (before, after):
            of_validation = {side: of for side, of in row["right"].items() if side.startswith("validation")}
            same = {key: value for key, value in row.items() if not key.startswith("accuracy_test") and value == value}
            known.append({**same, "right": of_validation})
        assert known[0] == known[1]
        assert [*known[0]["right"]] == ["validation", "validation_8bit"]


@pytest.mark.parametrize("shape", [(3,), (5, 3)], ids=["features", "sequences"])
@pytest.mark.parametrize("source", ["signals", "spikes", "events"])
def test_every_classifier_receives_its_input_on_the_scale_of_the_training_windows(source, shape):
    seen = []

    class Always:
        def fit(self, x, y):
            pass

        def predict(self, x):
            return np.zeros(len(x), int)

    def grid(sides, seed):
        seen.append(sides)
        yield {}

    probe = Opponent("Always the first class.", Always, grid)
    place = np.arange(40.0).reshape(-1, *[1] * len(shape))
    values = np.random.default_rng(0).normal(size=(40, *shape)) * [1, 5, 0] + place  # the sides are not alike
    made, labels = cuts(np.full(40, 20)), np.arange(40) % 2
    list(opponents.rows([Input(source, "made up", None, values, Cost(), {"probe": probe})], labels, made))
    across = tuple(range(values.ndim - 1))
    offset, scale = values[:24].mean(axis=across), values[:24].std(axis=across)
    is_kept = source == "events" and len(shape) == 2  # a rare event stays as rare as it is
    wanted = values if is_kept else (values - offset) / scale
    for mine, own, side in zip(seen[0][:3], seen[0][3:], split(), strict=True):
        np.testing.assert_allclose(mine, wanted[side], atol=1e-12)
        np.testing.assert_array_equal(own, labels[side])


def test_many_windows_are_too_many_for_machines(capsys):
    features = np.arange(40.0)[:, None] % 2
    shipped = joined("features", "quick")
    left = rows_of(features, shipped | {"SVM": replace(scikit_learn.SVM, most_examples=23)})
    assert [row["classifier"] for row in left] == ["logistic regression", "ELM", "extra trees"]
    assert "no SVM on signals: made up: 24 training windows, at most 23" in capsys.readouterr().err
    assert len(rows_of(features, shipped | {"SVM": replace(scikit_learn.SVM, most_examples=24)})) == 4


def sequences_of(n_steps=60):
    """Two classes that differ in the frequency of one channel alone, at any phase: means and counts say nothing."""
    rng = np.random.default_rng(3)
    phase, period = rng.uniform(0, 2 * np.pi, 40)[:, None], np.where(np.arange(40) % 2, 5.0, 9.0)[:, None]
    waves = np.sin(2 * np.pi * np.arange(n_steps) / period + phase)
    return np.stack([waves, rng.normal(size=waves.shape)], axis=2)


def test_all_opponents_see_the_signals_as_sequences_too():
    recordings = Recordings(list(sequences_of()), 1000.0, "mV", CONDITIONS)
    made = cuts(np.full(40, 60), WindowSpec(length_ms=60))
    found = {one.words: one for one in opponents.signal_inputs(recordings, made, "all")}
    assert [*found] == ["mean and deviation", "10 time bins", "power in 8 bands", "samples", "20 ms bins"]
    assert found["samples"].features.shape == (40, 60, 2)
    assert found["20 ms bins"].features.shape == (40, 3, 2)
    np.testing.assert_allclose(found["20 ms bins"].features[0, 1], recordings.signals[0][20:40].mean(axis=0))
    quick = {one.words: one for one in opponents.signal_inputs(recordings, made, "quick")}
    assert found.keys() - quick.keys() == {"power in 8 bands", "20 ms bins"}
    assert [*quick["samples"].opponents] == ["MiniRocket"]
    assert len(opponents.SLOW) == 2  # what is left out is what is named
    assert "MiniRocket" in opponents.in_words("quick").partition("without")[0]
    assert all(word in opponents.without_slow() and word in opponents.in_words("all") for word in opponents.SLOW)
    (linear,) = opponents.signal_inputs(recordings, made, "linear")
    assert [*linear.opponents] == ["logistic regression"]


def test_what_only_time_tells_is_found_by_spectra_and_sequences(monkeypatch):
    monkeypatch.setattr(pooled_gru, "GRU_HIDDEN", (16,))
    made = cuts(np.full(40, 60), WindowSpec(length_ms=60))
    recordings = Recordings(list(sequences_of()), 1000.0, "mV", CONDITIONS)
    labels = np.arange(40) % 2
    inputs = opponents.signal_inputs(recordings, made, "all")
    told = {(row["classifier"], row["input"]): row for row in opponents.rows(inputs, labels, made)}
    assert told["logistic regression", "signals: power in 8 bands"]["accuracy_test"] == 1.0
    assert told["MiniRocket", "signals: samples"]["accuracy_test"] == 1.0
    assert told["logistic regression", "signals: mean and deviation"]["accuracy_test"] < 1.0
    assert told["GRU", "signals: 20 ms bins"]["parameters"] > 3 * 16 * (2 + 16)


def test_events_of_a_sensor_are_its_signal():
    rasters = (np.random.default_rng(0).random((40, 60, 2)) < 0.2).astype(np.uint8)
    trains = from_rasters(rasters, 1000.0, ("ON a", "OFF a"), CONDITIONS)
    made = cuts(trains.trial_steps, WindowSpec(length_ms=60))
    found = list(opponents.spike_inputs(trains, (0.0, 0.0), made, "all"))
    assert [one.column for one in found] == [
        "events: counts", "events: 10 time bins", "events: steps", "events: 20 ms bins",
    ]  # fmt: skip
    quick, linear = (opponents.spike_inputs(trains, (0.0, 0.0), made, which) for which in ("quick", "linear"))
    assert [one.column for one in quick] == ["events: counts", "events: 10 time bins", "events: steps"]
    assert [one.column for one in linear] == ["events: counts", "events: 10 time bins"]
    assert found[3].features.shape == (40, 3, 2)
    assert found[3].features[0, 0].tolist() == rasters[0, :20].sum(axis=0).tolist()


@given(st.integers(2, 400), st.integers(1, 8))
def test_bands_divide_all_frequencies_of_any_window(n_samples, n_bands):
    n_bands = min(n_bands, n_samples // 2)
    piece = np.random.default_rng(n_samples).normal(size=(n_samples, 1))
    powers = band_powers(piece, n_bands)
    assert powers.shape == (n_bands, 1)
    assert np.isfinite(powers).all()


def test_short_windows_have_no_minirocket_and_it_is_said(capsys):
    recordings = Recordings([np.ones((8, 1))] * 40, 1000.0, "mV", CONDITIONS)
    made = cuts(np.full(40, 8), WindowSpec(length_ms=8))
    assert "samples" not in [one.words for one in opponents.signal_inputs(recordings, made, "all")]
    assert "no MiniRocket: windows have 8 samples; it needs 9" in capsys.readouterr().err
    just = Recordings([np.ones((9, 1))] * 40, 1000.0, "mV", CONDITIONS)
    made = cuts(np.full(40, 9), WindowSpec(length_ms=9))
    assert "samples" in [one.words for one in opponents.signal_inputs(just, made, "all")]


def test_each_classifier_trains_on_the_copies_that_validation_prefers():
    """Training trials are mirrored; copies of the kind "time" are as validation and test trials are."""
    labels = np.arange(40) % 2
    told = np.where(labels == 1, 1.0, -1.0)[:, None] * np.where(np.arange(40) < 12, -1.0, 1.0)[:, None]
    made, trained = cuts(np.full(40, 20)), np.arange(40) < 12
    sides = (trained, np.arange(40) >= 24, np.arange(40) >= 32)
    made = made._replace(
        sides=sides,
        copies={"none": trained, "gain": np.arange(40) < 14, "time": (np.arange(40) >= 12) & (np.arange(40) < 24)},
    )
    asked = []

    def grid(sides, seed):
        asked.append(len(sides.y_train))
        return scikit_learn.LOGISTIC_REGRESSION.grid

    linear = scikit_learn.LOGISTIC_REGRESSION
    slow = replace(linear, grid=grid, joins="all")
    of = {"logistic regression": linear, "slow": slow, "quick": replace(slow, joins="quick")}
    one = Input("signals", "made up", None, told, Cost(signal_ms=20.0), of)
    rows = list(opponents.rows([one], labels, made))
    assert [row["settings"].rpartition("; ")[2] for row in rows] == ["varied copies: time"] * 3
    assert [row["accuracy_test"] for row in rows] == [1.0] * 3
    assert asked == [12, 12, 14, 12]  # the slow one is trained once, on the kind that was best before it


def test_a_choice_is_fitted_again_with_the_condition_of_validation():
    """The sign of the feature differs in the trials that validation leaves out; test trials are as these are."""
    labels = np.arange(40) % 2
    sign = np.where(np.arange(40) < 12, -1.0, 1.0)
    features = ((2 * labels - 1) * sign)[:, None]
    place = np.arange(40)
    sides = (place < 12, (place >= 12) & (place < 28), place >= 32)
    made = cuts(np.full(40, 20))._replace(sides=sides)
    last = made._replace(sides=((place >= 8) & (place < 28), (place >= 28) & (place < 32), place >= 32))
    family = {"logistic regression": scikit_learn.LOGISTIC_REGRESSION}
    one = Input("signals", "made up", None, features, Cost(signal_ms=20.0), family)
    (before,), (after,) = (list(opponents.rows([one], labels, each)) for each in (made, made._replace(last=last)))
    assert (before["accuracy_validation"], before["accuracy_test"]) == (0.0, 0.0)
    assert (after["accuracy_validation"], after["accuracy_test"]) == (0.0, 1.0)
    assert (after["n_train"], after["n_validation"], after["n_test"]) == (20, 16, 8)
    assert after["right"]["validation"] == before["right"]["validation"]
    assert after["right"]["test"].keys() == before["right"]["test"].keys()
    both = made._replace(copies={"none": sides[0]}, last=last._replace(copies={"none": last.sides[0]}))
    assert [row["accuracy_test"] for row in opponents.rows([one], labels, both)] == [1.0]
    assert both.most_trained("none") == 20


@pytest.mark.parametrize("name", ["logistic regression", "ELM", "MiniRocket"])
@pytest.mark.parametrize("n_classes", [2, 3])
def test_of_two_classes_a_machine_has_one_output(name, n_classes):
    """Its sign decides; a second would say the same, and cost as much again."""
    labels = np.arange(60) % n_classes
    rng, is_sequence = np.random.default_rng(0), name == "MiniRocket"
    x = rng.normal(size=(60, 12, 2) if is_sequence else (60, 7)).astype(np.float32)
    own = load(name)
    best = best_of(own, Sides(x, x, x, labels, labels, labels), 0)
    last = best.layers[-1]
    fitted = (
        best.fitted[-1] if name == "logistic regression" else best.fitted.ridge_[-1] if is_sequence else best.fitted
    )
    assert last.units == (1 if n_classes == 2 else 3)
    assert last.cost().macs == np.size(fitted.coef_)
