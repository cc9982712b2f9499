"""Early exit is used where a bound of its loss, on trials that did not choose its rule, is within the tolerance."""

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from scipy.stats import binom

from neurotact.data.spikes import from_rasters
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit import patience
from neurotact.networks.exit.patience import ExitChoice, Judged, choose, losses, steady, upper_bound
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import tasks, trainer
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.tasks import Task


def judged(right: np.ndarray, per_trial: int = 1, classes: int = 3) -> Judged:
    trial = np.arange(len(right)) // per_trial
    return Judged(right.astype(bool), trial % classes, trial + 7)


@st.composite
def decisions(draw, most_trials: int = 9) -> Judged:
    n, per_trial, rules = draw(st.integers(2, most_trials)), draw(st.integers(1, 3)), draw(st.integers(2, 6))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    right = random.random((n * per_trial, rules)) < random.random(rules)
    order = random.permutation(len(right))
    return Judged(*(part[order] for part in judged(right, per_trial)))


TOLERANCES = st.sampled_from([0.0, 0.01, 0.1, 0.3])
TRAINING = st.none() | st.integers(0, 2**32)


def seen(seed: int | None, rules: int) -> tuple[torch.Tensor, int] | None:
    return None if seed is None else (torch.from_numpy(np.random.default_rng(seed).integers(0, 50, rules)), 50)


@pytest.mark.parametrize("helped", [False, True])
@given(decisions(), TOLERANCES, st.integers(0, 2**32))
def test_a_trial_is_judged_by_the_rule_that_the_other_trials_choose(helped, validation, tolerance, seed):
    """Of up to ten trials each is a fold; windows of one trial stay together."""
    training, expected = seen(seed if helped else None, validation.right.shape[1]), {}
    for trial in np.unique(validation.trial):
        own = validation.trial == trial
        rule = choose(Judged(*(part[~own] for part in validation)), tolerance, training)
        expected[int(trial)] = float(np.mean(validation.right[own, -1] * 1.0 - validation.right[own, rule]))
    assert losses(validation, tolerance, training) == pytest.approx(expected)


@given(st.integers(11, 60), st.integers(0, 2**32))
def test_of_many_trials_a_tenth_is_judged_at_once_and_each_once(n, seed):
    right = np.random.default_rng(seed).random((n, 4)) < 0.7
    found = judged(right, classes=5)
    fold = patience._folds(found)
    assert {*losses(found, 0.1)} == {*found.trial.tolist()}
    assert sorted(np.unique(fold)) == [*range(patience.FOLDS)]
    for label in range(5):  # as many of each class in each fold as can be
        chosen = np.bincount(fold[found.labels == label], minlength=patience.FOLDS)
        assert chosen.max() - chosen.min() <= 1


@given(st.integers(299, 2000), st.integers(2, 8), st.integers(0, 2**32), TRAINING)
@examples(40)
def test_a_patience_that_loses_nothing_on_enough_trials_is_used(n, rules, seed, training):
    right = np.repeat(np.random.default_rng(seed).random((n, 1)) < 0.8, rules, axis=1)
    found = losses(judged(right), 0.01, seen(training, rules))
    choice = ExitChoice(ExitRule(3), found, 0.01)
    assert choice.used == choice.rule


@given(st.integers(40, 100), st.integers(0, 2**32))
def test_a_loss_that_luck_hides_from_the_choice_is_refused(n, seed):
    """Each of many rules loses 15 points; the luckiest one loses few on the trials that choose it."""
    right = np.random.default_rng(seed).random((n, 400)) < 0.85
    right[:, -1] = True
    found = judged(right)
    choice = ExitChoice(ExitRule(3), losses(found, 0.08), 0.08)
    assert choose(found, 0.08) < 399
    assert choice.used == FULL_WINDOW


@given(st.integers(300, 900), st.integers(0, 2**32))
def test_with_enough_trials_the_steady_rule_has_a_bound_within_the_tolerance(n, seed):
    """And so has every rule after it; the rule on the observed loss alone is never later."""
    needs = np.random.default_rng(seed).exponential(4.0, n)
    right = np.arange(60) >= np.minimum(needs, 59)[:, None]
    found, training = judged(right), (torch.full((60,), 50), 50)
    index = choose(found, 0.05, training)
    bounds = upper_bound(1.0 - right)
    assert 0 < index < 59
    assert (bounds[index:-1] <= 0.05).all()
    assert bounds[index - 1] > 0.05
    assert choose(found, 0.05) <= index


@given(st.integers(2, 50), st.integers(0, 2**32))
def test_with_too_few_trials_for_a_bound_it_is_the_steady_rule_itself(n, seed):
    right, training = np.random.default_rng(seed).random((n, 6)) < 0.9, seen(seed, 6)
    expected = steady(torch.from_numpy(right.sum(axis=0)), n, *training, 0.05)
    assert choose(judged(right), 0.05, training) == expected


def test_a_rule_that_loses_much_in_training_is_not_made_safe_by_validation():
    right, training = np.ones((400, 3)), (torch.tensor([0, 400, 400]), 400)
    assert choose(judged(right), 0.05, training) == 1


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=40))
def test_a_bound_is_above_the_mean_and_falls_with_more_of_the_same_trials(lost):
    assert np.mean(lost) - 1e-9 <= upper_bound(lost) <= 1
    assert upper_bound(lost * 4) <= upper_bound(lost) + 1e-9
    assert upper_bound(lost) == pytest.approx(upper_bound(np.array([lost]).T)[0])


@pytest.mark.parametrize("n", [5, 30, 150, 400])
def test_the_bound_of_a_loss_without_gains_is_too_low_in_five_cases_of_a_hundred(n):
    bounds = np.array([float(upper_bound([1.0] * lost + [0.0] * (n - lost))) for lost in range(n + 1)])
    for true in np.linspace(0.002, 0.9, 60):
        assert binom.pmf(np.arange(n + 1), n, true)[bounds < true].sum() <= 1 - patience.CONFIDENCE + 1e-9


def test_losses_that_gains_outweigh_are_not_certain():
    """As many lost as gained: the bound is that of a mean of 0 with their spread."""
    lost = [1.0] * 30 + [-1.0] * 30 + [0.0] * 140
    assert upper_bound(lost) == pytest.approx(1.645 * (60 / 200 / 200) ** 0.5, rel=0.02)
    assert upper_bound(lost) > 4 * upper_bound([0.0] * 200)


def test_without_other_trials_nothing_is_known():
    alone = judged(np.ones((4, 2)), per_trial=4)
    assert losses(alone, 0.5) == {}
    assert ExitChoice(ExitRule(3), {}, 0.99).used == FULL_WINDOW


def test_exactly_at_the_tolerance_is_within_it():
    found = dict.fromkeys(range(40), 0.0)
    at = float(upper_bound([*found.values()]))
    assert not ExitChoice(ExitRule(3), found, at).used.never
    assert ExitChoice(ExitRule(3), found, np.nextafter(at, 0)).used.never


# --- the lines that use it -----------------------------------------------------------------------------------


def relay(n: int) -> RSNN:
    """A network whose readout repeats its input."""
    network = RSNN(n, n, RSNNSpec(hidden=n, membrane="immediate", reset="subtract"), 1000.0, backend="reference")
    with torch.no_grad():
        for weights, value in ((network.w_in, 3.0), (network.w_rec, 0.0), (network.w_out, 3.0)):
            weights.copy_(value * torch.eye(n))
        network.alpha.zero_()
        network.beta.zero_()
    return network


def late(n: int, every: int = 4) -> Examples:
    """Two windows a trial: one of so many windows first speaks for the wrong class."""
    spikes = torch.zeros(2 * n, 20, 2, dtype=torch.uint8)
    labels = torch.arange(2 * n) // 2 % 2
    spikes[torch.arange(2 * n), :, labels] = 1
    spikes[::every, :4] = spikes[::every, :4].flip(2)
    return Examples(spikes, labels, of=torch.arange(2 * n) // 2)


@pytest.mark.parametrize("with_training", [False, True])
def test_a_network_is_judged_by_trials_and_not_by_windows(with_training):
    side = late(6)
    network, training = relay(2), late(6, every=1) if with_training else None
    choice = trainer.exit_of(network, side, 0.3, training)
    assert choice.rule == trainer.exit_of(network, side, 0.3, training).rule
    assert (choice.tolerance, [*choice.losses]) == (0.3, [*range(6)])
    for trial in range(6):
        kept = side.of != trial
        others = Examples(side.spikes[kept], side.labels[kept], of=side.of[kept])
        rule, own = trainer.exit_of(network, others, 0.3, training).rule, side.spikes[~kept]
        right = [network.infer(own, one).labels == side.labels[~kept] for one in (FULL_WINDOW, rule)]
        assert choice.losses[trial] == float((right[0] * 1.0 - right[1] * 1.0).mean())


def test_copies_of_a_validation_trial_are_one_trial():
    rasters = np.random.default_rng(0).random((20, 30, 2)) < 0.5
    rasters[10:14] = rasters[10]
    names, conditions = ("SA-I a", "RA-I a"), pd.DataFrame({"label": ["felt"] * 10 + ["silk"] * 10})
    trains = from_rasters(rasters, 1000.0, names, conditions)
    split = tasks.Split(np.r_[5:10, 15:20], np.arange(10, 15), np.arange(5))
    sides = tasks.sides_of(trains, Task(window={"length_ms": 15.0}), split)
    assert sides.validation.of.tolist() == [10] * 8 + [14] * 2
