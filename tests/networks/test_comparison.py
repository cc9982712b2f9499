"""What a test accuracy is compared with."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from neurotact_parts.opponents import scikit_learn

from neurotact.baselines import opponent
from neurotact.metrics import referee
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.training.comparison import Trials, compare, costs, lines, opponents_of
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.tasks import Sides


def examples(labels: list[int], tells: bool, seed: int = 0) -> Examples:
    """Windows of three afferents; the label's own fires more where it `tells`."""
    rates = np.full((len(labels), 1, 3), 0.2)
    if tells:
        rates[np.arange(len(labels)), 0, labels] = 0.8
    rasters = np.random.default_rng(seed).random((len(labels), 50, 3)) < rates
    return Examples(torch.from_numpy(rasters.astype(np.uint8)), torch.tensor(labels))


def sides_of(labels, tells):
    return Sides(*(examples(labels, tells, seed) for seed in range(3)))


def one_each(sides: Sides) -> Trials:
    """A trial for each window."""
    return Trials(*(np.arange(len(side.labels)) for side in (sides.validation, sides.test)))


@pytest.mark.parametrize("tells", [True, False])
def test_opponents_learn_what_counts_tell(tells):
    sides = sides_of([0, 1, 2] * 20, tells)
    found = {one.name: one for one in opponents_of(sides, one_each(sides))}
    assert len(found) == 2 * len(opponent.joined("features", "quick"))
    for name in ("logistic regression on counts", "SVM on 10 time bins"):
        shares = found[name].accuracy_validation, found[name].accuracy_test
        assert min(shares) > 0.9 if tells else shares[1] < 0.6
        assert np.mean([*found[name].test.values()]) == pytest.approx(shares[1])


def test_a_chosen_opponent_is_fitted_again_and_ranked_by_the_choice():
    labels = [0, 1, 2] * 20
    told, untold = sides_of(labels, True), sides_of(labels, False)
    choosing = Sides(untold.train, untold.validation, told.test)
    alone = [*opponents_of(choosing, one_each(told))]
    again = [*opponents_of(choosing, one_each(told), told)]
    for before, after in zip(alone, again, strict=True):
        assert (after.name, after.validation) == (before.name, before.validation)
        assert after.accuracy_validation < 0.6 < 0.8 < after.accuracy_test
        assert before.accuracy_test < 0.8
    right = [True] * len(labels)
    assert compare(right, choosing, one_each(told), 3, told).baseline_accuracy > 0.8


def test_when_spikes_come_is_seen_in_time_bins_alone():
    """Both classes have as many spikes; one has them in the first half, the other in the second."""
    labels = [0, 1] * 20
    rasters = np.zeros((40, 50, 1), np.uint8)
    rasters[::2, :20] = rasters[1::2, 25:45] = 1
    whole = Examples(torch.from_numpy(rasters), torch.tensor(labels))
    sides = Sides(whole, whole, whole)
    found = {one.name: one.accuracy_test for one in opponents_of(sides, one_each(sides))}
    assert found["logistic regression on 10 time bins"] == 1.0
    assert found["logistic regression on counts"] == 0.5


def test_more_than_255_spikes_are_counted():
    many = Examples(torch.ones(8, 600, 1, dtype=torch.uint8), torch.tensor([0, 1] * 4))
    many.spikes[::2, :256] = 0  # which leaves as many, were counts to wrap around
    sides = Sides(many, many, many)
    assert {one.accuracy_test for one in opponents_of(sides, one_each(sides)) if "logistic" in one.name} == {1.0}


def test_chance_and_the_commonest_class_are_told():
    train, test = examples([0, 0, 0, 1, 1, 2] * 3, True), examples([0, 1, 2, 0], True)
    sides = Sides(train, test, test)
    found = compare([True, True, True, False], sides, one_each(sides), 3)
    assert found.chance == pytest.approx(1 / 3)
    assert found.commonest == 0.5
    assert found.trials == 4
    told = " ".join(lines(found))
    for words in (
        "accuracy 75.0 % (95 % interval 30.1 % to 95.4 %, 4 test trials); one start of the weights",
        "chance 33.3 %",
    ):
        assert words in told


@pytest.mark.parametrize(("right", "tells", "verdict"), [(False, True, "worse"), (True, False, "better")])
def test_the_network_is_judged_by_the_referee(right, tells, verdict):
    sides = sides_of([0, 1, 2] * 20, tells)
    found = compare([right] * 60, sides, one_each(sides), 3)
    assert found.verdict == verdict
    assert found.p < 0.05
    assert ("is clearly better than the network" in lines(found)[1]) == (verdict == "worse")


def test_what_few_test_trials_cannot_show_is_said_in_place_of_no_difference():
    sides = sides_of([0, 1, 2] * 20, True)
    found = compare([True] * 60, sides, one_each(sides), 3)
    assert (found.verdict, found.trials, found.opponents > 1) == ("tie", 60, True)
    least = referee.least_difference(60, found.opponents)
    told = f"; too few test trials: only differences of {100 * least:.0f} points or more would show"
    assert lines(found)[1].endswith(told)
    assert lines(found._replace(trials=3))[1].endswith("; too few test trials: no difference would show")
    assert lines(found._replace(trials=60, opponents=1))[1].endswith("; no clear difference")


def test_many_windows_are_too_many_for_machines(monkeypatch, capsys):
    monkeypatch.setattr(scikit_learn, "SVM", replace(scikit_learn.SVM, most_examples=59))
    sides = sides_of([0, 1, 2] * 20, True)
    assert not any("SVM" in one.name for one in opponents_of(sides, one_each(sides)))
    assert "no SVM: 60 training windows, at most 59" in capsys.readouterr().err


def test_windows_of_a_trial_are_one_trial():
    sides = sides_of([0, 1, 2] * 20, True)
    trials = Trials(*(np.arange(60) // 3 for _ in range(2)))
    found = compare([True] * 60, sides, trials, 3)
    assert found.trials == 20
    assert wilson_interval(1.0, 20) == (found.low, found.high)


def test_the_spikes_of_every_population_are_counted():
    row = {"sops_total": 10.0, "window_steps": 100, "spikes_on": 3.0, "spikes_off": 4.0, "spikes_afferents": 5.0}
    early = {"exit_sops_total": 5.0, "exit_steps": 50.0, "exit_accuracy": 0.5}
    assert "12 input spikes" in costs({**row, **early}, 1.0)
