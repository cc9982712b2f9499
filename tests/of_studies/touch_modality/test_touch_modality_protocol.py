"""The touch-modality study: what it trains and chooses, what it costs, and that no test pattern leaks."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from levels import thinned
from neurotact_parts.studies.touch_modality import protocol
from neurotact_parts.studies.touch_modality.datasets import STEP_COUNTS
from neurotact_parts.studies.touch_modality.folds import Fold
from neurotact_parts.studies.touch_modality.protocol import Parameters, Trained
from neurotact_parts.studies.touch_modality.simulator import TouchModalitySpec, simulate
from neurotact_parts.studies.touch_modality.touches import TouchData, fit_standardisation, folds_of

from neurotact.data.hdf5 import save_recordings
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.figures.style import save
from neurotact.spec import build

CLASSES = ("brushing", "rolling", "sliding")
SMALL = {"runs": 2, "epochs": (1, 2), "steps": 8}
FEW = TouchData(simulation=TouchModalitySpec(people=2))


@pytest.fixture(scope="module")
def arrays():
    """Ten people, six touches each, whose class is the level of every channel."""
    rng = np.random.default_rng(0)
    labels = np.sort(np.tile(CLASSES, 20))
    level = np.searchsorted(CLASSES, labels)[:, None, None] - 1.0
    sequences = {f"steps_{n}": (level + rng.normal(0, 0.1, (60, n, 16))).astype(np.float32) for n in STEP_COUNTS}
    return {
        **sequences,
        "labels": labels,
        "persons": np.tile(np.repeat(np.arange(10), 2), 3),
        "classes": np.array(CLASSES),
        "recorded": np.array([21, 22, 20]),
        "silent": np.array([1, 2, 0]),
        "activity_s": rng.uniform(1, 3, 60),
        "shown": rng.normal(1.65, 0.1, (3, 6144, 16)).astype(np.float32),
        "band_V": np.array([1.62, 1.68]),
        "sampling_rate_Hz": np.array(3000.0),
        "windows": np.array("overlap"),
    }


@pytest.fixture(scope="module")
def loaded():
    return protocol.load(FEW)


def test_simulated_touches_become_all_numbers_of_steps(loaded):
    n_patterns = len(loaded["labels"])
    assert n_patterns == (loaded["recorded"] - loaded["silent"]).sum() <= 24
    for n in STEP_COUNTS:
        assert loaded[f"steps_{n}"].shape == (n_patterns, n, 16)
    assert loaded["labels"].tolist() == sorted(loaded["labels"].tolist())
    assert loaded["classes"].tolist() == list(CLASSES)
    assert loaded["recorded"].tolist() == [8, 8, 8]
    assert set(loaded["persons"]) <= {0, 1}
    assert loaded["shown"].shape == (3, 6144, 16)


def test_a_recording_file_gives_what_the_simulation_gives(loaded, tmp_path):
    touches = simulate(FEW.simulation)
    save_recordings(touches, tmp_path / "touch.h5")
    read = protocol.load(TouchData(recordings=str(tmp_path / "touch.h5")))
    assert sorted(read) == sorted(loaded)
    for name, values in loaded.items():
        np.testing.assert_array_equal(read[name], values)
    unknown = Recordings(touches.signals, 3000.0, "V", touches.conditions[["label"]])
    save_recordings(unknown, tmp_path / "unknown.h5")
    arrays = protocol.load(TouchData(recordings=str(tmp_path / "unknown.h5")))
    assert "persons" not in arrays
    unnamed = TouchData(recordings="unknown.h5")
    with pytest.raises(InputError, match=r"unknown\.h5: has no condition 'person'.*set protocol = paper"):
        folds_of("honest", unnamed, arrays, 0)


def test_a_task_holds_every_touch_as_features_and_as_a_sequence(loaded):
    task = protocol.task(FEW)
    n_patterns = len(loaded["labels"])
    assert task.features.shape == (n_patterns, 256)
    assert task.sequences.shape == (n_patterns, 512, 16)
    assert task.sequences.dtype == np.float32
    assert (task.unit, task.sampling_rate_Hz) == ("mV", 250.0)
    np.testing.assert_array_equal(task.labels, loaded["labels"])
    np.testing.assert_array_equal(task.groups, loaded["persons"])
    np.testing.assert_allclose(task.features[:, :128], loaded["steps_8"].reshape(n_patterns, -1), atol=1e-4)


@pytest.mark.parametrize("name", ["paper", "honest"])
@thinned("network", ["LSTM(10)", "GRU(12)"])
def test_a_cell_gives_a_row_a_fold_and_its_costs(arrays, name, network):
    rows = protocol.run(Parameters(protocol=name, network=network, **SMALL), arrays)
    assert [row["fold"] for row in rows] == list(range(5))
    for row in rows:
        pairs = {f"accuracy_b{b}_e{e}" for b, e in product((48, 69), (1, 2))}
        assert pairs <= set(row)
        chosen = row[f"accuracy_b{row['batch']}_e{row['epochs_trained']}"]
        assert row["accuracy_test"] == chosen == pytest.approx(row["used_on_8"])
        assert np.isnan(row["accuracy_validation"]) == (name == "paper")
        assert row["patterns_test"] == 12
        assert row["parameters"] == {"LSTM(10)": 1113, "GRU(12)": 1083}[network]
        assert row["flops_published"] == {"LSTM(10)": 2950, "GRU(12)": 2960}[network] * 8
        assert row["signal_ms"] == 2048.0
        # 7 windows of 1536 samples and one of 768, each summed and multiplied once, on 16 channels
        assert row["flops_windows"] == 16 * (7 * 1537 + 769)
    again = protocol.run(Parameters(protocol=name, network=network, **SMALL), arrays)
    pd.testing.assert_frame_equal(pd.DataFrame(rows), pd.DataFrame(again))


def test_what_can_be_learned_is_learned(arrays):
    quickly = {"runs": 1, "epochs": (20,), "batches": (48,), "learning_rate": 0.02, "steps": 8}
    for name in ("paper", "honest"):
        rows = protocol.run(Parameters(protocol=name, network="GRU(10)", **quickly), arrays)
        assert np.mean([row["accuracy_test"] for row in rows]) > 0.95


# --- nothing leaks ---------------------------------------------------------------------------------------


def planted(n=60):
    """Classes that are levels about a side's own mean: in the test patterns that mean is fifty deviations away."""
    rng = np.random.default_rng(1)
    index = np.tile(np.arange(3), n // 3)
    fold = Fold(np.arange(n // 2), np.array([], int), np.arange(n // 2, n))
    offset = np.zeros(n)
    offset[fold.test] = 50.0
    sequences = (index - 1.0 + offset)[:, None, None] + rng.normal(0, 0.1, (n, 8, 16))
    return sequences.astype(np.float32), np.array(CLASSES)[index], fold


def test_labels_that_only_test_statistics_tell_are_told_at_chance():
    sequences, labels, fold = planted()
    parameters = Parameters(
        runs=3, epochs=(40,), batches=(48,), learning_rate=0.02, steps=8, network="GRU(10)", protocol="honest"
    )
    (trained,) = protocol.train_folds(parameters, sequences, labels, [fold])
    assert np.mean(trained.test) == pytest.approx(1 / 3, abs=0.02)
    # The plant is real: whoever normalises the test patterns by their own statistics reads the labels off.
    leaky = protocol.Normalisation(*fit_standardisation(list(sequences[fold.test])))
    (networks,) = trained.networks.values()
    seen = leaky.apply(sequences[fold.test])
    assert np.mean([(net.predict(seen) == labels[fold.test]).mean() for net in networks]) > 0.95


def test_whatever_stands_in_the_test_patterns_training_and_choice_are_the_same(arrays):
    parameters = Parameters(protocol="honest", network="GRU(10)", **SMALL)
    folds = folds_of(parameters.protocol, parameters.data, arrays, parameters.seed)[:1]
    sequences = arrays["steps_8"]
    other = sequences.copy()
    other[folds[0].test] = 1e3 * np.random.default_rng(2).normal(size=other[folds[0].test].shape)
    both = [protocol.train_folds(parameters, x, arrays["labels"], folds) for x in (sequences, other)]
    assert both[0][0].normalisation == both[1][0].normalisation
    np.testing.assert_array_equal(both[0][0].validation, both[1][0].validation)
    assert protocol.choose("honest", both[0]) == protocol.choose("honest", both[1])
    for pair, networks in both[0][0].networks.items():
        for one, two in zip(networks, both[1][0].networks[pair], strict=True):
            np.testing.assert_array_equal(one.input_weights_, two.input_weights_)
    assert not np.array_equal(both[0][0].test, both[1][0].test)


@given(seed=st.integers(0, 10**6))
def test_the_honest_choice_sees_no_test_accuracy_and_the_published_one_nothing_else(seed):
    rng = np.random.default_rng(seed)
    drawn = [Trained({}, protocol.Normalisation((), ()), rng.random((4, 3)), rng.random((4, 3))) for _ in range(5)]
    other = [one._replace(test=rng.random((4, 3))) for one in drawn]
    assert protocol.choose("honest", drawn) == protocol.choose("honest", other)
    assert protocol.choose("honest", drawn) == [int(one.validation.mean(axis=1).argmax()) for one in drawn]
    paper = protocol.choose("paper", drawn)
    assert len(set(paper)) == 1
    means = np.mean([one.test.mean(axis=1) for one in drawn], axis=0)
    assert means[paper[0]] == means.max()


def test_on_labels_at_random_the_published_choice_shows_more_than_chance():
    """Accuracies of guessing, 4 pairs, 10 runs, 5 folds of 156 patterns: choosing on the test folds adds to them."""
    rng = np.random.default_rng(3)
    gained = {"paper": [], "honest": []}
    for _ in range(200):
        guessed = [
            Trained({}, protocol.Normalisation((), ()), *(rng.binomial(156, 1 / 3, (4, 10)) / 156 for _ in range(2)))
            for _ in range(5)
        ]
        for name, values in gained.items():
            pairs = protocol.choose(name, guessed)
            values.append(np.mean([one.test[pair].mean() for one, pair in zip(guessed, pairs, strict=True)]))
    error = np.std(gained["honest"]) / np.sqrt(200)
    assert np.mean(gained["honest"]) == pytest.approx(1 / 3, abs=3 * error)
    assert np.mean(gained["paper"]) > 1 / 3 + 10 * error


# --- what is drawn ---------------------------------------------------------------------------------------


def test_the_report_draws_its_figures(arrays, tmp_path):
    rng = np.random.default_rng(4)
    cells = product((8, 20, 50), protocol.NETWORKS, ("paper", "honest"), range(5))
    names = [f"used_on_{n}" for n in STEP_COUNTS]
    results = pd.DataFrame(
        [
            {"steps": n, "network": net, "protocol": p, "fold": f, "accuracy_test": rng.uniform(0.4, 0.8)}
            | dict.fromkeys(names, 0.5)
            for n, net, p, f in cells
        ]
    )
    drawn = list(protocol.draw(results, arrays))
    assert [one.name for one in drawn] == ["touches", "accuracy", "other-steps", "scaling"]
    assert "1 of 21 brushing, 2 of 22 rolling, 0 of 20 sliding" in drawn[0].caption
    save(drawn[0].figure, tmp_path / "touches.png")
    assert (tmp_path / "touches.png").stat().st_size > 10_000
    panels = drawn[1].figure.axes
    assert len(panels) == 6
    lines = {line.get_label(): line for line in panels[0].lines}
    first = results[(results.network == "LSTM(10)") & (results.protocol == "paper") & (results.fold == 0)]
    np.testing.assert_allclose(np.asarray(lines["fold 0"].get_ydata()), 100 * first.accuracy_test)
    np.testing.assert_allclose(np.asarray(lines["published mean"].get_ydata())[0], 74.506, atol=1e-9)


def test_table_1_is_whole():
    """Means of the printed folds against the printed averages; the paper cuts where it does not round."""
    averages = {("LSTM(10)", 8): 74.51, ("LSTM(10)", 256): 59.47, ("GRU(10)", 20): 72.06, ("GRU(12)", 16): 73.01}
    assert len(protocol.TABLE_I) == len(STEP_COUNTS) * len(protocol.NETWORKS)
    for key, average in averages.items():
        assert np.mean(protocol.TABLE_I[key]) == pytest.approx(average, abs=0.011)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"steps": 12}, "steps: must be"),
        ({"network": "LSTM"}, "network: must be"),
        ({"protocol": "fair"}, "protocol: must be"),
        ({"runs": 0}, "runs: must be >= 1"),
        ({"data": {"windows": "half"}}, "data.windows: must be"),
        ({"data": {"recording": "x"}}, "did you mean 'recordings'"),
        ({"batches": [0]}, r"batches\.0: must be >= 1"),
    ],
)
def test_parameters_refuse_what_does_not_fit(table, words):
    with pytest.raises(InputError, match=words):
        build(Parameters, table, "here")


VALUES = st.floats(-1e3, 1e3, width=32)


@given(st.lists(hnp.arrays(float, st.tuples(st.integers(2, 40), st.just(1)), elements=VALUES), min_size=1, max_size=4))
def test_standardised_training_trials_have_mean_0_and_deviation_1(signals):
    offset, scale = fit_standardisation(signals)
    felt = (np.concatenate(signals) - offset) / scale
    if np.concatenate(signals).std() > 1e-3:
        assert felt.mean() == pytest.approx(0.0, abs=1e-6)
        assert felt.std() == pytest.approx(1.0, rel=1e-6)


@given(st.lists(st.integers(1, 9), min_size=1, max_size=4), VALUES)
def test_a_taxel_that_never_moves_stays_silent(lengths, level):
    offset, scale = fit_standardisation([np.full((n, 2), level) for n in lengths])
    assert scale == (1.0, 1.0)
    np.testing.assert_allclose(offset, level, rtol=1e-12)
