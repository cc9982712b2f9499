"""Warnings of a training: each where it must come, and none where nothing is wrong."""

import numpy as np
import pandas as pd
import pytest

from neurotact.data.splits import SplitSpec
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.exit.patience import ExitChoice
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import cautions
from neurotact.networks.training.comparison import Comparison


def compared(low, high, verdict="worse", rival=0.9) -> Comparison:
    """With a classifier on the same spikes that the referee finds clearly better, or not."""
    own = (low + high) / 2, low, high, 100, 0.25, 0.4
    return Comparison(*own, "SVM on counts", 0.5, verdict, "extra trees on 10 time bins", rival, 0.01)


@pytest.mark.parametrize(
    ("low", "high", "verdict", "expected"),
    [
        (0.6, 0.8, "tie", []),
        (0.6, 0.8, "better", []),
        (0.6, 0.8, "worse", ["extra trees on 10 time bins of the same spikes is better, 90.0 % against 70.0 %"]),
        (0.4, 0.8, "tie", ["not clearly above chance (40.0 %)"]),
        (0.1, 0.3, "worse", ["not clearly above chance", "extra trees"]),
    ],
)
def test_a_network_that_stays_behind_is_named(low, high, verdict, expected):
    one = compared(low, high, verdict)
    behind = cautions.worse_than_baseline(one, RSNNSpec())
    found = [*cautions.not_learned(one.accuracy, one.low, one.commonest), *behind]
    assert len(found) == len(expected)
    assert all(words in line for words, line in zip(expected, found, strict=True))


@pytest.mark.parametrize(("given", "expected"), [
    ({"hidden": 30}, "try `network='default'` or more hidden neurons (`settings={'hidden': 60}`) or `nt.tune`"),
    ({"hidden": 128, "input_deviation": 1.0}, "try more hidden neurons (`settings={'hidden': 256}`) or `nt.tune`"),
    ({"hidden": 600, "input_deviation": 1.0}, "; try `nt.tune`"),
    ({"hidden": 600, "input_deviation": 1.0, "readout": "integrator"}, "; try `nt.tune`"),
    (
        {"hidden": 60, "input_deviation": 1.0, "readout": "integrator"},
        "(`settings={'hidden': 120}`) or 3 networks joined (`settings={'effort': 'best'}`) or `nt.tune`",
    ),
])  # fmt: skip
def test_the_remedy_for_a_network_behind_a_classifier_changes_this_network(given, expected):
    one = compared(0.6, 0.8)
    (line,) = cautions.worse_than_baseline(one, RSNNSpec(**given))
    assert expected in line


def test_more_neurons_are_those_of_each_network_that_is_joined():
    spec = RSNNSpec(hidden=150, input_deviation=1.0, readout="integrator")
    (line,) = cautions.worse_than_baseline(compared(0.6, 0.8), spec, members=3)
    assert line.endswith("try more hidden neurons (`settings={'hidden': 100}`) or `nt.tune`")


def test_a_log_of_joined_networks_is_judged_network_by_network():
    good, bad = log([2.0, 0.5]).assign(member=1), log([2.0, 0.5, 2.1]).assign(member=2)
    spec = TrainingSpec(schedule="cosine")
    (line,) = cautions.training(pd.concat([good, bad, good.assign(member=3)]), spec)
    assert line.startswith("1 of 3 networks: training diverged")


@pytest.mark.parametrize(("n", "warned"), [(4, True), (5, False)])
def test_five_test_trials_of_a_class_are_enough(n, warned):
    assert bool([*cautions.few_test_trials({"felt": n, "silk": 12}, SplitSpec())]) is warned


def test_a_remedy_names_only_what_its_command_has():
    """A search does not advise a search, and what is fine-tuned is trained again."""
    one = compared(0.1, 0.4)
    (line,) = cautions.worse_than_baseline(one, RSNNSpec(hidden=30), "tune")
    remedies = "`network='default'` or more hidden neurons (`settings={'hidden': 60}`) or more trials (`trials`)"
    assert line.endswith(f"try {remedies}")
    (line,) = cautions.worse_than_baseline(one, RSNNSpec(hidden=30), "tune", ["hidden", "tau_syn_ms"])
    assert line.endswith("try `network='default'` or more trials (`trials`)")
    split = SplitSpec()
    (line,) = cautions.few_test_trials({"felt": 1}, split, "tune")
    assert line.endswith("with `nt.train(..., split=nt.Split(folds=5))`")
    diverged = log([2.0, 0.5, 2.1])
    again = [
        *cautions.not_learned(0.3, 0.1, 0.4, "fine-tune"),
        *cautions.worse_than_baseline(one, RSNNSpec(hidden=30), "fine-tune"),
        *cautions.training(diverged, TrainingSpec(), command="fine-tune"),
    ]
    assert len(again) == 3
    assert all("; train the run again with " in line for line in again)
    (line,) = cautions.few_test_trials({"felt": 1}, split, "fine-tune")
    assert line.endswith("with `nt.train(..., split=nt.Split(folds=5))`")


@pytest.mark.parametrize(
    ("per_class", "expected"),
    [
        ({"felt": 5, "silk": 10}, []),
        ({"felt": 4, "silk": 11}, ["class 'felt' has 4 test trials", "25.0 points of its", "6.7 points of all 15"]),
        ({"felt": 1, "silk": 9}, ["class 'felt' has 1 test trial:", "10.0 points of all 10"]),
        ({"felt": 0, "silk": 20}, ["class 'felt' has 0 test trials", "5.0 points of all 20"]),
        ({"felt": 4, "silk": 3, "wool": 9}, ["2 of 3 classes", "class 'silk' has 3"]),
    ],
)  # fmt: skip
def test_a_class_with_few_test_trials_is_named(per_class, expected):
    found = list(cautions.few_test_trials(per_class, SplitSpec()))
    assert len(found) == bool(expected)
    assert all(words in found[0] for words in expected)


@pytest.mark.parametrize(
    ("split", "helps"),
    [({}, True), ({"group": "subject"}, True), ({"folds": 3}, False), ({"order": "day"}, False),
     ({"test_where": {"speed": 450}}, False)],
)  # fmt: skip
def test_folds_are_named_where_test_trials_are_drawn_at_random(split, helps):
    (found,) = cautions.few_test_trials({"felt": 4, "silk": 20}, SplitSpec.model_validate(split))
    assert found.endswith("`split=nt.Split(folds=5)`") == helps


def test_an_exit_whose_loss_few_trials_bound_is_named():
    few, enough = (ExitChoice(ExitRule(9), dict.fromkeys(range(n), 0.0), 0.01) for n in (298, 299))
    assert len(list(cautions.exit_not_used(few))) == 1
    for choice in (enough, few._replace(rule=FULL_WINDOW), None):
        assert list(cautions.exit_not_used(choice)) == []


def log(losses) -> pd.DataFrame:
    return pd.DataFrame({"epoch": range(len(losses)), "train_loss": losses})


@pytest.mark.parametrize(
    ("losses", "schedule", "epochs", "expected"),
    [
        ([2.0, 1.0, 0.5], "cosine", 3, None),  # the rates fell to 0: all epochs are meant to run
        ([2.0, 1.0, 0.5], "constant", 100, None),
        ([2.0, 1.0, 0.5], "constant", 3, "stopped after epoch 3, its last"),
        ([2.0, np.inf, 0.5], "cosine", 3, "became infinite"),
        ([2.0, np.nan], "cosine", 3, "became infinite"),
        ([2.0, 0.5, 2.1], "cosine", 3, "diverged"),
        ([2.0, 0.5, 1.9], "cosine", 3, None),
        ([], "constant", 3, None),
    ],
)
def test_a_training_that_diverged_or_was_cut_is_named(losses, schedule, epochs, expected):
    found = list(cautions.training(log(losses), TrainingSpec(schedule=schedule, epochs=epochs)))
    assert len(found) == (expected is not None)
    assert all(expected in line for line in found)
