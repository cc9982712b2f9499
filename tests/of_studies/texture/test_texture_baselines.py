"""The work before the texture paper: one window and one split for all, no test trial seen, costs that add up."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.texture import baselines as protocol
from neurotact_parts.studies.texture import baselines_figures as figures
from neurotact_parts.studies.texture import spike_features
from neurotact_parts.studies.texture.baselines import GratingSpikesSpec, Parameters
from neurotact_parts.studies.texture.simulator import GratingsSpec
from neurotact_parts.studies.texture.spike_distances import van_rossum

from neurotact.data.splits import Split
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.specs import load
from neurotact.errors import InputError
from neurotact.metrics.spike_trains import spike_counts
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec

DATA = GratingSpikesSpec(
    gratings=GratingsSpec(
        trials=8, pitches_mm=(4.0, 1.5, 0.5), forces_N=(12.0,), speeds_mm_per_s=(8.6, 13.7), duration_s=0.5
    ),
    start_ms=100.0,
    longest_ms=300.0,
)
NETWORK = RSNNSpec(hidden=6, training=TrainingSpec(epochs=2, batch=8))


@pytest.fixture(scope="module")
def arrays():
    return protocol.load(DATA)


def parameters(**values) -> Parameters:
    table = {"data": DATA, "window_ms": 200.0, "network": NETWORK, "taus_ms": (5.0,), "seeds": (0,), "batch": 8}
    return Parameters(**{**table, **values})


def shuffled_test(arrays, given: Parameters):
    """The same arrays, but the spikes of the test trials belong to other test trials."""
    split = protocol.seen_of(given, arrays).split
    number = np.arange(len(arrays["label"]))
    number[split.test] = np.roll(split.test, 1)
    changed = dict(arrays)
    name = given.encoder
    trial = number[arrays[f"{name}/trial"]]
    order = np.lexsort((arrays[f"{name}/step"], arrays[f"{name}/afferent"], trial))
    changed[f"{name}/trial"] = trial[order].astype(np.int32)
    for key in ("afferent", "step"):
        changed[f"{name}/{key}"] = arrays[f"{name}/{key}"][order]
    return changed


def test_the_arrays_hold_every_encoder_s_spikes_of_the_longest_window(arrays):
    assert {key.partition("/")[0] for key in arrays if "/" in key} == {"LIF", "Izhikevich", "Poisson"}
    for name in DATA.encoders:
        assert arrays[f"{name}/step"].max() < 600
        assert len(arrays[f"{name}/step"]) > 100
    assert len(arrays["label"]) == 48


def test_a_window_is_the_beginning_of_a_longer_one(arrays):
    short, long = (protocol.seen_of(parameters(window_ms=ms), arrays) for ms in (100.0, 300.0))
    inside = long.events.step < 200
    assert np.array_equal(short.events.step, long.events.step[inside])
    assert short.n_steps == 200
    assert all(np.array_equal(a, b) for a, b in zip(short.split, long.split, strict=True))


def test_every_system_sees_the_same_split_balanced_over_the_conditions(arrays):
    splits = [protocol.seen_of(parameters(encoder=name), arrays).split for name in DATA.encoders]
    for split in splits[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(split, splits[0], strict=True))
    conditions = protocol.conditions_of(arrays).iloc[splits[0].test]
    assert (conditions.groupby(["label", "speed_mm_per_s"]).size() >= 1).all()


@pytest.mark.parametrize("name", protocol.VECTORS)
def test_features_are_finite_and_their_cost_is_counted(arrays, name):
    table, layers = protocol.feature_table(name, protocol.seen_of(parameters(), arrays))
    assert table.shape[0] == 48
    assert np.isfinite(table).all()
    assert all(layer.cost().flops > 0 for layer in layers)


SYSTEMS = [("statistics", "kNN"), ("rate, CV", "SVM"), ("delays", "ELM"), ("image", "kNN"), ("van Rossum", "kNN")]
SYSTEMS += [("Victor-Purpura", "kNN"), ("spikes", "SNN"), ("spikes", "RSNN")]


@pytest.mark.parametrize(("features", "classifier"), SYSTEMS)
def test_nothing_that_is_chosen_depends_on_test_trials(arrays, features, classifier):
    given = parameters(features=features, classifier=classifier)
    rows, others = (protocol.run(given, a) for a in (arrays, shuffled_test(arrays, given)))
    for row, other in zip(rows, others, strict=True):
        assert row["chosen"] == other["chosen"]
        np.testing.assert_equal(row["accuracy_validation"], other["accuracy_validation"])
        assert 0 <= row["accuracy_test"] <= 1
        parts = row["flops_encoder"] + row["flops_features"] + row["flops_classifier"]
        assert row["flops"] == pytest.approx(parts)
        assert row["parameters"] > 0
    assert protocol.run(given, arrays)[0]["accuracy_test"] == rows[0]["accuracy_test"]


def test_features_are_scaled_by_training_trials_alone(arrays, monkeypatch):
    given = []

    def look(features, labels, split, seed):
        given.append((features, split))
        return 0.5, 0.5, "", []

    monkeypatch.setitem(protocol.FAMILIES, "kNN", look)
    protocol.run(parameters(features="rate", classifier="kNN"), arrays)
    ((features, split),) = given
    moves = features[split.train].std(axis=0) > 0
    np.testing.assert_allclose(features[split.train].mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(features[split.train].std(axis=0)[moves], 1.0)
    assert np.abs(features[split.test].mean(axis=0)).max() > 1e-3


def test_the_brightest_pixel_is_that_of_a_training_trial(arrays):
    """The trial with the fullest bin is tested on: the images of the others are as bright as without it."""
    seen = protocol.seen_of(parameters(), arrays)
    counts = spike_features.grey_images(seen.events, protocol.COLUMNS, white=255).reshape(len(seen.labels), -1)
    fullest = int(counts.max(axis=1).argmax())
    others = np.delete(np.arange(len(counts)), fullest)
    others = others[counts[others].max(axis=1) < counts[fullest].max()]
    images, _ = protocol.feature_table("image", seen._replace(split=Split(others, others, np.array([fullest]))))
    assert images[others].max() == 255


def test_features_wait_for_the_window_and_networks_may_not(arrays):
    rows = pd.DataFrame(protocol.run(parameters(features="spikes", classifier="RSNN", seeds=(0, 1)), arrays))
    sides = protocol.seen_of(parameters(features="spikes", classifier="RSNN"), arrays).split
    sizes = rows[["n_train", "n_validation", "n_test"]].drop_duplicates().to_numpy().tolist()
    assert sizes == [[len(side) for side in sides]]
    assert rows["decision"].tolist() == ["window", "early exit"] * 2
    assert (rows["signal_ms"][rows["decision"] == "window"] == 200.0).all()
    assert (rows["signal_ms"] <= 200.0).all()
    assert (rows["flops_features"] == 0).all()
    whole = protocol.run(parameters(features="rate", classifier="SVM", seeds=(0, 1)), arrays)
    assert [row["signal_ms"] for row in whole] == [200.0]  # nothing is drawn, so there is one row


def test_a_moving_average_is_counted_at_the_rate_of_the_skin():
    encoder = load("sa1-ra1-lif", {"conditioning.resample_Hz": 500.0, "sa1.t_ref_ms": 2.0, "ra1.t_ref_ms": 2.0})
    slow = DATA.model_copy(update={"encoders": {"LIF": encoder}})
    (row, *_) = protocol.run(parameters(data=slow, features="rate"), protocol.load(slow))
    spent = encoding_cost(8, 100, 200.0, encoder.model_dump(mode="json"), recorded_Hz=2000.0)
    assert row["flops_encoder"] == spent.flops
    seen = protocol.seen_of(parameters(data=slow), made := protocol.load(slow))
    assert protocol.trains_of(parameters(data=slow), seen, made).recorded_Hz == 2000.0


def test_only_recurrence_tells_the_networks_apart(arrays):
    recurrent, forward = (
        protocol.run(parameters(features="spikes", classifier=name), arrays)[0] for name in ("RSNN", "SNN")
    )
    assert recurrent["parameters"] - forward["parameters"] == 6 * 6
    assert recurrent["flops_encoder"] == forward["flops_encoder"]


def test_nearest_trains_are_those_of_the_distance(arrays):
    seen = protocol.seen_of(parameters(), arrays)
    train, test = seen.split.train, seen.split.test
    everything = van_rossum(seen.events, seen.rate_Hz, tau_ms=10.0)
    some = van_rossum(protocol.select(seen.events, test), seen.rate_Hz, tau_ms=10.0,
                      others=protocol.select(seen.events, train))  # fmt: skip
    np.testing.assert_allclose(some, everything[np.ix_(test, train)], atol=1e-6)
    assert np.array_equal(spike_counts(protocol.select(seen.events, test)), spike_counts(seen.events)[test])


def test_networks_get_the_events_of_the_cell(arrays):
    given = parameters()
    seen = protocol.seen_of(given, arrays)
    trains = protocol.trains_of(given, seen, arrays)
    assert all((np.diff(steps) >= 0).all() for steps in trains.steps)
    counts = [np.bincount(units, minlength=16) for units in trains.units]
    assert np.array_equal(counts, spike_counts(seen.events))
    assert trains.classes == ("P0.5", "P1.5", "P4.0")


def test_encoders_and_networks_may_be_named():
    assert Parameters(network="snn").network.model == "snn"
    assert GratingSpikesSpec(encoders={"mine": "poisson"}).encoders["mine"].model == "poisson"
    whole = Parameters().model_dump(mode="json", exclude_none=True)
    assert Parameters.model_validate(whole) == Parameters()


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"encoder": "LFI"}, "encoder: 'LFI' is not in data.encoders; did you mean 'LIF'"),
        ({"window_ms": 400.0}, "more than data.longest_ms"),
        ({"features": "spikes", "classifier": "kNN"}, "kNN does not take spikes"),
        ({"features": "rate", "classifier": "SNN"}, "SNN does not take rate"),
        ({"features": "van Rossum", "classifier": "SVM"}, "SVM does not take van Rossum"),
    ],
)
def test_what_does_not_go_together_is_refused(arrays, changes, complaint):
    with pytest.raises(InputError, match=complaint):
        protocol.run(parameters(**changes), arrays)


def test_windows_that_the_slide_does_not_hold_are_refused():
    with pytest.raises(InputError, match=r"lengthen gratings\.duration_s"):
        protocol.load(DATA.model_copy(update={"longest_ms": 500.0}))


def test_the_figures_show_every_system(arrays):
    cells = [("rate", "kNN"), ("image", "kNN"), ("van Rossum", "kNN"), ("spikes", "RSNN")]
    rows = [
        row
        for encoder in ("LIF", "Izhikevich")
        for window_ms in (100.0, 200.0)
        for features, classifier in cells
        for row in protocol.run(
            parameters(encoder=encoder, window_ms=window_ms, features=features, classifier=classifier), arrays
        )
    ]
    results = pd.DataFrame(rows)
    assert figures.window_shown(results) == 100.0
    drawn = list(protocol.draw(results, arrays))
    assert len({d.name for d in drawn}) == len(drawn) == 4
    over_signal, grid, _, parts = (d.figure for d in drawn)
    assert [axes.get_title() for axes in over_signal.axes] == ["LIF", "Izhikevich"]
    assert [label.get_text() for label in grid.axes[0].get_yticklabels()] == [f"{f} → {c}" for f, c in cells]
    named = [label.get_text() for label in parts.axes[0].get_yticklabels()]
    assert "Izhikevich, van Rossum → kNN [17]" in named
    assert "LIF, RSNN [this work]" in named
