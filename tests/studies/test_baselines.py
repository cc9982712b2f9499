"""Classical baselines of a study: what they see, counted by hand, and what they must and must not learn."""

import numpy as np
import pandas as pd
import pytest

from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.data.splits import Split
from neurotact.data.windows import WindowSpec, cut
from neurotact.metrics.flops import Cost
from neurotact.networks.ledger import encoding_cost
from neurotact.studies import baselines
from neurotact.studies.baselines import Cuts, Input

CONDITIONS = pd.DataFrame({"label": ["felt", "silk"] * 20})


def split() -> Split:
    return Split(np.arange(24), np.arange(24, 32), np.arange(32, 40))


def cuts(trial_steps, spec=None, clock_Hz=1000.0) -> Cuts:
    windows = cut(trial_steps, clock_Hz, spec or WindowSpec(length_ms=20))
    return baselines.cuts_of(CONDITIONS, windows, clock_Hz, split(), {})


def test_spikes_are_counted_over_the_window_and_in_its_tenths():
    rasters = np.zeros((40, 20, 2), np.uint8)
    rasters[0, [0, 1, 5, 19], 0] = 1
    trains = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), CONDITIONS, {"model": "lif"})
    whole, binned = baselines.spike_inputs(trains, (1.0, 5.0), cuts(trains.trial_steps))
    assert whole.features[0].tolist() == [4.0, 0.0]
    assert binned.features[0].reshape(10, 2)[:, 0].tolist() == [2, 0, 1, 0, 0, 0, 0, 0, 0, 1]
    assert binned.words == "10 time bins"
    assert whole.pair == (1.0, 5.0)
    # Each spike is one addition on top of the encoding: 4 spikes in 40 windows.
    assert whole.made.acs - encoding_cost(1, 20, 20.0, {}).acs == pytest.approx(0.1)
    events = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), CONDITIONS)
    assert next(baselines.spike_inputs(events, (1.0, 5.0), cuts(trains.trial_steps))).made == Cost(acs=0.1)


def test_signals_are_cut_on_the_encoders_clock():
    """At 100 Hz a window of 20 ms holds the samples at 0 and 10 ms, and the second one those at 20 and 30 ms."""
    signal = np.arange(4.0)[:, None] * np.ones((4, 1))
    recordings = Recordings([signal] * 40, 100.0, "mV", CONDITIONS)
    made = cuts(np.full(40, 31), WindowSpec(length_ms=15))
    moments, binned = baselines.signal_inputs(recordings, made)
    assert moments.features[:2].tolist() == [[0.5, 0.5], [2.0, 0.0]]  # from 15 ms on: the sample at 20 ms alone
    assert binned.features.shape == (80, 1)  # of the shortest window, one bin
    assert binned.words == "1 time bin"


def test_a_window_behind_the_last_sample_sees_the_last_one():
    recordings = Recordings([np.array([[1.0], [2.0]])] * 40, 10.0, "mV", CONDITIONS)
    made = cuts(np.full(40, 101), WindowSpec(length_ms=50))
    pieces = list(baselines.pieces_of(recordings, made.windows, 1000.0))
    assert all(len(piece) >= 1 for piece in pieces)


def rows_of(features, stronger=True, **limits):
    made = cuts(np.full(40, 20))
    labels = np.arange(40) % 2
    one = Input("signals", "made up", None, features, Cost(acs=7.0, signal_ms=20.0))
    return list(baselines.rows([one], labels, made, stronger=stronger, **limits))


def test_what_a_line_tells_apart_all_tell_apart():
    features = np.stack([np.arange(40) % 2 * 4.0, np.random.default_rng(0).normal(size=40)], axis=1)
    found = rows_of(features)
    assert [row["classifier"] for row in found] == ["logistic regression", "SVM", "ELM"]
    assert [row["accuracy_test"] for row in found] == [1.0, 1.0, 1.0]
    assert {(row["n_train"], row["n_validation"], row["n_test"]) for row in found} == {(24, 8, 8)}
    # Standardising 2 features and 2 outputs of 2 inputs: 2 + 4 MACs.
    assert found[0]["macs"] == 6
    assert found[0]["energy_estimate_nJ"] == pytest.approx(1e-3 * (4.6 * 6 + 0.9 * 7))
    assert [row["classifier"] for row in rows_of(features, stronger=False)] == ["logistic regression"]


def test_test_windows_choose_nothing():
    """Other features of test windows change what is said of these windows alone."""
    rng = np.random.default_rng(1)
    features = rng.normal(size=(40, 3)) + np.arange(40)[:, None] % 2
    spoilt = features.copy()
    spoilt[32:] = rng.normal(size=(8, 3))
    for before, after in zip(rows_of(features), rows_of(spoilt), strict=True):
        of_test = {"accuracy_test": 0, "right": {}}
        assert {**before, **of_test} == {**after, **of_test}
        assert before["right"].keys() == after["right"].keys()


def test_many_windows_are_too_many_for_machines():
    features = np.arange(40.0)[:, None] % 2
    assert [row["classifier"] for row in rows_of(features, most_machines=23)] == ["logistic regression", "ELM"]
    assert len(rows_of(features, most_machines=24)) == 3
