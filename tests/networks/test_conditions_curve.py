"""How many conditions must be recorded: each number of values meets each tested one, with equally many trials."""

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies import conditions_curve

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.splits import SplitSpec
from neurotact.errors import InputError
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.training import trainer

QUICK = {"settings": {"hidden": 4, "training.epochs": 1}, "window": nt.Window(length_ms=100)}


@given(n=st.integers(3, 9))
def test_every_number_of_values_meets_every_tested_one_and_never_itself(n):
    table = pd.DataFrame({"label": ["felt", "silk"] * n, "speed": np.repeat(np.arange(n), 2)})
    plan = conditions_curve.plan(table, "speed")
    tested = sorted({value for value, _ in plan})
    assert len(tested) == min(n, conditions_curve.MOST_TESTED)
    assert (tested[0], tested[-1]) == (0, n - 1)
    assert len(plan) == len(tested) * (n - 1)
    for value, trained in plan:
        assert value not in trained
        assert trained == sorted(set(trained))


@pytest.fixture(scope="module")
def spikes(tmp_path_factory):
    place, rng = tmp_path_factory.mktemp("curve"), np.random.default_rng(0)
    signals = [rng.normal(0, 3, (300, 2)).cumsum(axis=0) for _ in range(48)]
    conditions = {
        "label": ["felt", "silk"] * 24,
        "speed": np.repeat([1, 2, 3, 4], 12),
        "day": [0, 0, 1, 1] * 12,
    }
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", pd.DataFrame(conditions)), place / "touches.h5")
    nt.encode_file(place / "touches.h5", place / "spikes.h5", augmentation="gain", copies=1)
    return place / "spikes.h5"


def test_trainings_have_as_many_trials_and_test_all_of_one_value(spikes, monkeypatch):
    splits, starts, fit = [], [], trainer.fit
    monkeypatch.setattr(
        trainer, "fit", lambda *a, **k: splits.append(k["split"]) or starts.append(a[3]) or fit(*a, **k)
    )
    table = nt.conditions_curve(spikes, "speed", "rsnn", **QUICK)
    speeds = nt.load_spikes(spikes).conditions["speed"].to_numpy()
    assert table["n_train"].max() - table["n_train"].min() <= 2
    for row, split in zip(table.to_dict("records"), splits, strict=True):
        assert speeds[split.test].tolist() == [row["tested"]] * 12
        trained = set(speeds[split.train])
        assert row["tested"] not in trained
        assert len(trained) == row["trained"]
        assert not set(split.train) & {*split.validation, *split.test}
    assert starts == [of_start(0, SplitSpec(test_where={"speed": value})) for value in table["tested"]]


@pytest.mark.thorough
def test_options_of_the_curve(spikes, tmp_path):
    """network, settings, length_ms, align, where, leave_out, augmentation, seed, out, figure, force: all act."""
    said = []
    three = {**QUICK, "augmentation": "none", "where": {"speed": [1, 2, 3]}}
    plain = nt.conditions_curve(
        spikes, "speed", "rsnn", **three, out=tmp_path / "a.csv", figure=tmp_path / "a.png", tell=said.append
    )
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "a.csv"), plain)
    assert matplotlib.image.imread(tmp_path / "a.png").std() > 0
    assert "At a value of speed that was not trained on" in said[1]
    with pytest.raises(InputError, match="already exists"):
        nt.conditions_curve(spikes, "speed", "rsnn", **QUICK, out=tmp_path / "a.csv")
    nt.conditions_curve(
        spikes, "speed", "rsnn", **{**three, "where": {"speed": [2, 3, 4]}}, out=tmp_path / "a.csv", force=True
    )
    assert sorted(set(pd.read_csv(tmp_path / "a.csv")["tested"])) == [2, 3, 4]
    others = [
        {"augmentation": "gain"}, {"seed": 3}, {"window": nt.Window(length_ms=100, align="onset")},
        {"window": nt.Window(length_ms=150)}, {"leave_out": {"day": 1}},
        {"settings": {"hidden": 7, "training.epochs": 1}},
    ]  # fmt: skip
    for other in others:
        found = nt.conditions_curve(spikes, "speed", "rsnn", **{**three, **other})
        assert found["sops_total"].tolist() != plain["sops_total"].tolist(), other
    snn = nt.conditions_curve(spikes, "speed", "snn", **three)
    assert snn["sops_total"].tolist() != plain["sops_total"].tolist()


@pytest.mark.parametrize(
    ("column", "words"), [("day", "needs three values of day"), ("sped", "no condition is called 'sped'")]
)
def test_a_condition_without_a_curve_is_refused(spikes, column, words):
    with pytest.raises(InputError, match=words):
        nt.conditions_curve(spikes, column, "rsnn", **QUICK)


@pytest.mark.parametrize(
    ("test", "seen", "words"),
    [
        ([0.5, 0.8], 0.95, "record more values"),
        ([0.8, 0.8], 0.95, "are not the remedy"),
        ([0.8, 0.95], 0.95, "these are enough"),
    ],
)
def test_the_advice_follows_the_curve(test, seen, words):
    rows = {"trained": [1, 2], "tested": 5, "accuracy_test": test, "accuracy_seen": seen, "sops_total": 1.0}
    assert words in conditions_curve.advice(pd.DataFrame(rows), "speed")
