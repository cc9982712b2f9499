"""Splits: every trial on one side, every class on every side, the same for the same seed."""

import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from levels import examples

from neurotact.data.recordings import select_conditions
from neurotact.data.splits import (
    LEAST_APART,
    SplitSpec,
    aside_of,
    check_each,
    each_left_out,
    split_conditions,
    split_trials,
    turns_of,
    validation_note,
)  # fmt: skip
from neurotact.data.windows import WindowSpec, cut
from neurotact.errors import InputError
from neurotact.spec import build

SPECS = st.builds(
    SplitSpec, validation=st.floats(0.05, 0.45), test=st.floats(0.05, 0.45), seed=st.integers(0, 2**31)
)  # fmt: skip
ANY_LABELS = st.lists(st.sampled_from(["felt", "silk", "jute", "lace 3 N"]), min_size=1, max_size=80).map(np.array)
BALANCED = st.builds(
    lambda n_classes, each, random: np.array(random.sample([*range(n_classes)] * each, n_classes * each)),
    st.integers(1, 6), st.integers(7, 40), st.randoms(use_true_random=False),
)  # fmt: skip


def attempt(labels, spec, split=split_trials):
    """The split, or None and why there is none."""
    try:
        return split(labels, spec), ""
    except InputError as error:
        return None, str(error)


@given(ANY_LABELS, SPECS)
def test_a_split_has_every_class_on_every_side_or_names_the_class_that_is_too_small(labels, spec):
    split, refusal = attempt(labels, spec)
    if split is None:
        assert "\n" not in refusal
        least = int(re.search(r"too few .* at least (\d+) trials per class", refusal)[1])
        values, counts = np.unique(labels, return_counts=True)
        assert counts.min() < least
        for each in range(counts.min(), least + 1):
            enough = np.append(labels, np.repeat(values, (each - counts).clip(0)))
            assert (attempt(enough, spec)[0] is not None) == (each == least)
        return
    for side in split:
        assert set(labels[side]) == set(labels)
        assert (np.diff(side) > 0).all()
    assert sorted(np.concatenate(split)) == list(range(len(labels)))


@given(BALANCED, SPECS)
def test_the_shares_hold_in_each_class_to_one_trial(labels, spec):
    split, _ = attempt(labels, spec)
    assume(split is not None)  # shares that leave too few trials for training are refused
    n_classes, each = len(set(labels)), np.bincount(labels)[0]
    for side, share in ((split.validation, spec.validation), (split.test, spec.test)):
        assert len(side) == max(n_classes, round(share * len(labels)))
        assert np.abs(np.bincount(labels[side]) - max(1.0, share * each)).max() <= 1.0 + 1e-9


@given(BALANCED, SPECS)
def test_the_same_seed_gives_the_same_split(labels, spec):
    assume(attempt(labels, spec)[0] is not None)  # shares that leave too few trials for training are refused
    for one, other in zip(split_trials(labels, spec), split_trials(labels, spec), strict=True):
        np.testing.assert_array_equal(one, other)


def test_another_seed_gives_another_split():
    labels = np.repeat([0, 1], 30)
    assert len({tuple(split_trials(labels, SplitSpec(seed=seed)).test) for seed in range(20)}) == 20


@given(BALANCED, SPECS, st.integers(1, 4))
def test_the_windows_of_a_trial_are_never_on_two_sides(labels, spec, n_windows):
    windows = cut(np.full(len(labels), n_windows * 10), 1000.0, WindowSpec(length_ms=10))
    sides = [set(np.flatnonzero(np.isin(windows.trial, side))) for side in split_trials(labels, spec)]
    assert sum(map(len, sides)) == len(set.union(*sides)) == len(windows)
    trials = [set(windows.trial[list(side)]) for side in sides]
    assert sum(map(len, trials)) == len(set.union(*trials)) == len(labels)


@pytest.mark.parametrize("counts", [(2, 20), (1, 1), (1, 0), (3, 300), (2, 2)])
def test_a_class_with_too_few_trials_is_named(counts):
    labels = np.repeat(["felt", "silk"], counts)
    with pytest.raises(InputError, match=rf"split: class 'felt' has {counts[0]} trials?, too few"):
        split_trials(labels, SplitSpec())


def test_three_trials_a_class_are_enough():
    assert [len(side) for side in split_trials(np.repeat([0, 1], 3), SplitSpec())] == [2, 2, 2]


def test_more_shares_than_trials_are_refused():
    with pytest.raises(InputError, match=r"has 3 trials, too few .* at least \d+ trials per class for these shares$"):
        split_trials(np.repeat([0, 1], 3), SplitSpec(validation=0.49, test=0.49))


@pytest.mark.parametrize(
    "table", [{"validation": 0}, {"test": 1}, {"test": -0.1}, {"seed": -1}, {"validation": 0.5, "test": 0.5}]
)
def test_shares_that_leave_nothing_are_no_spec(table):
    with pytest.raises(InputError, match=r"study\.toml"):
        build(SplitSpec, table, "study.toml")


TABLES = st.builds(
    lambda n, random: pd.DataFrame(
        {
            "label": [random.choice(["felt", "silk", "jute"]) for _ in range(n)],
            "subject": [random.choice(["ann", "bob", "cem", "dea", "eva"]) for _ in range(n)],
            "speed": [random.choice([100, 300, 450]) for _ in range(n)],
            "day": [random.random() for _ in range(n)],
        }
    ),
    st.integers(1, 120), st.randoms(use_true_random=False),
)  # fmt: skip
PLACES = [{"speed": 450}, {"speed": [100, 450]}, {"speed": 300, "subject": ["ann", "bob"]}]
WAYS = st.one_of(
    st.fixed_dictionaries({"group": st.sampled_from([("subject",), ("subject", "speed"), ("label", "subject")])}),
    st.fixed_dictionaries({"test_where": st.sampled_from(PLACES)}),
    st.fixed_dictionaries({"test_where": st.sampled_from(PLACES), "leave_aside": st.just(True)}),
    st.builds(lambda who: {"group": ("subject",), "test_where": {"subject": who}}, st.sampled_from(["ann", "bob"])),
    st.builds(
        lambda n, group: {"folds": n, "fold": n // 2, "group": group},
        st.integers(2, 6), st.sampled_from([(), ("subject",)]),
    ),
    st.fixed_dictionaries({"order": st.sampled_from(["trial", "day", "subject"])}),
)  # fmt: skip


@examples(150)
@given(TABLES, WAYS, st.integers(0, 2**31), st.sampled_from([(), ("speed",)]))
def test_no_trial_and_no_group_stands_on_two_sides(table, way, seed, stratify):
    """Whatever is asked, the sides are all trials, each once; training knows every class; groups stay whole."""
    spec = SplitSpec(seed=seed, **way)
    split, refusal = attempt(table, spec, lambda table, spec: split_conditions(table, stratify, spec))
    if split is None:
        assert "\n" not in refusal
        assert refusal.startswith(("split", "dataset.stratify"))
        return
    sides = np.concatenate(split)
    assert sorted(sides) == (sorted({*sides}) if spec.leave_aside else list(range(len(table))))
    assert all(len(side) and (np.diff(side) > 0).all() for side in split)
    assert set(table.label[split.train]) == set(table.label)
    if spec.group:
        groups = [set(table.iloc[side][list(spec.group)].itertuples(index=False, name=None)) for side in split]
        assert sum(map(len, groups)) == len(set.union(*groups))
    if spec.test_where:
        np.testing.assert_array_equal(split.test, np.flatnonzero(select_conditions(table, spec.test_where)))
    if spec.order == "day":
        for _, rows in table.groupby(["label", *stratify]):
            of_side = [rows.loc[rows.index.isin(side), "day"] for side in split]
            assert of_side[0].max() <= of_side[1].min() <= of_side[1].max() <= of_side[2].min()
    for one, other in zip(split, split_conditions(table, stratify, spec), strict=True):
        np.testing.assert_array_equal(one, other)


def table_of(n_each: int = 20, n_subjects: int = 5) -> pd.DataFrame:
    """Two classes, each by every subject, n_each times."""
    rows = [
        (label, f"s{subject}", i) for label in ("felt", "silk") for subject in range(n_subjects) for i in range(n_each)
    ]
    return pd.DataFrame(rows, columns=["label", "subject", "repetition"])


@pytest.mark.parametrize("group", [(), ("subject",)])
def test_the_folds_are_all_trials_each_tested_once(group):
    table = table_of()
    tests = [split_conditions(table, (), SplitSpec(folds=5, fold=fold, group=group, seed=3)).test for fold in range(5)]
    assert sorted(np.concatenate(tests)) == list(range(len(table)))
    for test in tests:  # equal subjects, so that folds are equal too
        assert np.bincount(table.label[test] == "felt").tolist() == [20, 20]
        assert not group or table.subject[test].nunique() == 1


def test_another_seed_draws_other_folds():
    first = {tuple(split_conditions(table_of(), (), SplitSpec(folds=5, seed=seed)).test) for seed in range(10)}
    assert len(first) == 10


def test_groups_make_about_the_asked_shares():
    split = split_conditions(table_of(n_each=4, n_subjects=40), (), SplitSpec(group=("subject",), seed=1))
    shares = [len(side) / 320 for side in split]
    np.testing.assert_allclose(shares, [0.7, 0.15, 0.15], atol=0.03)


def test_validation_by_group_is_a_share_of_all_trials_also_where_the_test_has_taken_its_own():
    """15 of 100 equal groups, not 15 % of the 85 that the test leaves."""
    sizes = [
        [
            len(side)
            for side in split_conditions(
                table_of(n_each=1, n_subjects=100), (), SplitSpec(group=("subject",), seed=seed)
            )
        ]
        for seed in range(8)
    ]
    np.testing.assert_allclose(np.mean(sizes, axis=0) / 200, [0.7, 0.15, 0.15], atol=0.011)


def test_validation_is_a_share_of_what_is_not_tested():
    table = table_of()
    split = split_conditions(
        table, (), SplitSpec(test_where={"subject": ["s0", "s1", "s2"]}, validation=0.25, nested=False)
    )
    assert [len(side) for side in split] == [60, 20, 120]
    assert not set(table.subject[np.concatenate(split[:2])]) & {"s0", "s1", "s2"}


@given(st.integers(0, 50), st.sampled_from([["s0"], ["s1", "s2"], ["s4"]]))
def test_validation_leaves_out_a_condition_as_the_test_does(seed, tested):
    """Each seed another subject; every subject that is not tested has its turn."""
    table, spec = table_of(n_each=2), SplitSpec(test_where={"subject": tested}, seed=seed)
    split = split_conditions(table, (), spec)
    subjects = [set(table.subject[side]) for side in split]
    assert subjects[2] == set(tested)
    assert len(subjects[1]) == 1
    assert not subjects[0] & (subjects[1] | subjects[2])
    turns = turns_of(table, spec)
    assert [f"subject = {name}" for name in sorted(subjects[0] | subjects[1])] == [turn.held[0] for turn in turns]
    assert subjects[1] == {turns[seed % len(turns)].held[0].removeprefix("subject = ")}


def test_many_values_are_left_out_several_at_a_time():
    table, spec = table_of(n_each=1, n_subjects=20), SplitSpec(test_where={"subject": "s0"})
    turns = turns_of(table, spec)
    assert sorted(len(turn.held) for turn in turns) == [2, 2, 3, 3, 3, 3, 3]
    assert len(split_conditions(table, (), spec).validation) == 6


@pytest.mark.parametrize("where", [{"subject": ["s1", "s2"]}, {"subject": "s2"}])
def test_where_no_condition_can_be_left_out_trials_are_drawn(where):
    """One subject is left, or one of the two left is the only one that touched jute."""
    table = table_of(n_each=8, n_subjects=3)
    table.loc[(table.subject == "s0") & (table.repetition < 4), "label"] = "jute"
    spec = SplitSpec(test_where=where)
    split = split_conditions(table, (), spec)
    left = {turn.held[0] for turn in turns_of(table, spec)}
    assert left == (set() if "s1" in where["subject"] else {"subject = s1"})
    assert len(split.train)
    assert set(table.label[split.train]) == set(table.label[np.concatenate(split[:2])])


# --- pairs of conditions ------------------------------------------------------------------------------

GRIDS = st.builds(
    lambda speeds, forces, n_each, random: pd.DataFrame(
        [
            {"label": label, "speed": speed, "day": f"d{force}", "drawn": random.random()}
            for label in ("felt", "silk") for speed in range(speeds) for force in range(forces) for _ in range(n_each)
        ]
    ).sort_values("drawn", ignore_index=True),
    st.integers(2, 9), st.integers(2, 5), st.integers(1, 3), st.randoms(use_true_random=False),
)  # fmt: skip
PAIR = ["speed", "day"]


def grid(speeds=3, forces=3, n_each=2):
    rows = [(label, speed, force) for label in ("felt", "silk") for speed in range(speeds) for force in range(forces)]
    return pd.DataFrame(rows * n_each, columns=["label", "speed", "force"])


def specs_of(table, seed=0):
    tests = each_left_out(table, PAIR)
    return tests, [SplitSpec(test_where=test, leave_aside=True, seed=seed, validation=0.3) for test in tests]


@examples(40)
@given(GRIDS, st.integers(0, 60))
@example(grid(3, 3).rename(columns={"force": "day"}), 0)
def test_of_a_tested_pair_no_value_is_trained_or_validated(table, seed):
    """Each pair is tested once; each trial is on one side or left aside, where it shares a value."""
    assume(len(table) >= 24)
    tests, specs = specs_of(table, seed)
    assert len({*map(str, tests)}) == len(tests) == len(table.groupby(PAIR))
    found = [split_conditions(table, (), spec) for spec in specs]
    assert sorted(np.concatenate([split.test for split in found])) == [*range(len(table))]
    for test, spec, (train, validation, tested) in zip(tests, specs, found, strict=True):
        np.testing.assert_array_equal(tested, np.flatnonzero(select_conditions(table, test)))
        of_side = [table.iloc[side] for side in (train, validation)]
        assert all(len(side) and not (side[PAIR] == [*test.values()]).any(axis=None) for side in of_side)
        aside = np.setdiff1d(np.arange(len(table)), np.concatenate([train, validation, tested]))
        is_apart = any(turn.aside for turn in turns_of(table, spec))
        if is_apart:
            assert all({*of_side[0][column]}.isdisjoint(of_side[1][column]) for column in PAIR)
            assert len(train) >= LEAST_APART * (len(train) + len(validation) + len(aside) - aside_of(table, spec).sum())
        else:
            np.testing.assert_array_equal(aside, np.flatnonzero(aside_of(table, spec)))


def test_validation_leaves_out_a_further_pair_and_what_shares_its_values_if_something_is_left():
    spec = SplitSpec(test_where={"speed": 0, "force": 0}, leave_aside=True)
    wide = split_conditions(grid(4, 4), (), spec)
    assert [len(side) for side in wide] == [16, 4, 4]  # of 4 x 4 pairs with 4 trials: 2 x 2, one, one
    narrow = split_conditions(grid(3, 3), (), spec)
    assert [len(side) for side in narrow] == [4, 4, 4]  # of 3 x 3: one pair each
    assert turns_of(grid(2, 3), spec) == []  # one speed is left: nothing tells what another one needs
    assert [len(side) for side in split_conditions(grid(2, 3, 5), (), spec)] == [17, 3, 10]  # at random


def test_successive_seeds_validate_on_other_values_of_both_conditions():
    spec = SplitSpec(test_where={"speed": 0, "force": 0}, leave_aside=True)
    sides = [split_conditions(grid(4, 4), (), spec.model_copy(update={"seed": seed})).validation for seed in range(3)]
    pairs = [grid(4, 4).iloc[side][["speed", "force"]].drop_duplicates().values.tolist() for side in sides]
    assert pairs == [[[1, 1]], [[2, 2]], [[3, 3]]]


def test_a_pair_that_leaves_too_little_is_named():
    table = grid()
    table = table[(table.label == "felt") | (table.speed == 1)]  # silk at one speed alone
    with pytest.raises(InputError, match=r"cannot test speed = 1, force = 0, .*left aside .*'silk'.*`test_where`"):
        check_each(table, each_left_out(table, ["speed", "force"]), SplitSpec())
    others = each_left_out(table, ["speed", "force"], {"speed": [0, 2]})
    assert "6 pairs" in check_each(table, others, SplitSpec())[0]


def test_the_number_of_pairs_is_said_and_how_to_have_fewer():
    (line,) = check_each(grid(4, 4), each_left_out(grid(4, 4), ["speed", "force"]), SplitSpec())
    assert line.startswith("16 pairs of speed and force are tested in turn; ")
    assert line.endswith(
        "that share a tested or validated value are left aside: 40 of 64. `test_where={'speed': 0}` tests fewer"
    )
    fewer = each_left_out(grid(4, 4), ["speed", "force"], {"speed": [0, 3], "force": 2})
    assert fewer == [{"speed": 0, "force": 2}, {"speed": 3, "force": 2}]
    assert "2 pairs" in check_each(grid(4, 4), fewer, SplitSpec())[0]
    assert check_each(grid(), each_left_out(grid(), ["speed"]), SplitSpec()) == []


def test_pairs_that_no_trial_has_are_not_tested():
    table = pd.DataFrame({"label": ["felt", "silk"] * 4, "subject": list("aabbccdd"), "day": [1, 1, 2, 2, 3, 3, 4, 4]})
    tests = each_left_out(table, ["subject", "day"])
    assert [(*test.values(),) for test in tests] == [("a", 1), ("b", 2), ("c", 3), ("d", 4)]
    assert "left aside: 0 of 8" in check_each(table, tests, SplitSpec())[0]


@pytest.mark.parametrize(
    ("columns", "where", "said"),
    [
        (["speed", "force", "force"], None, "names 'force' twice"),
        (["speed", "forse"], None, "no condition is called 'forse'; did you mean 'force'"),
        (["label", "speed"], None, "'label' is the class, and every class is trained on"),
        (["speed"], {"force": 1}, "`test_where`: .* it chooses among the values of speed; drop 'force'"),
        (["speed", "force"], {"speed": 9}, "no trial has speed = 9"),
    ],
)  # fmt: skip
def test_what_cannot_be_left_out_is_refused(columns, where, said):
    with pytest.raises(InputError, match=said):
        each_left_out(grid(), columns, where)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "leaves out one speed"),
        ({"nested": False}, "ranks nothing for this test: split.nested is false"),
        ({"group": ["force"]}, "ranks nothing for this test: split.group keeps trials of one force together"),
        ({"test_where": {"speed": [0, 1]}}, "ranks nothing .*: training trials have too few values of speed"),
        ({"test_where": {"speed": 0, "force": 0}, "leave_aside": True}, "one pair .* all trials that share a value"),
    ],
)  # fmt: skip
def test_what_validation_does_is_said_with_its_reason(keys, said):
    assert re.search(said, validation_note(grid(), SplitSpec(**{"test_where": {"speed": 0}, **keys})))


@pytest.mark.parametrize("again", [True, False])
def test_what_is_trained_on_after_the_choice_is_said_where_it_is(again):
    said = validation_note(grid(), SplitSpec(test_where={"speed": 0}), again=again)
    assert ("after the choice all are trained on" in said) is again


def test_trials_without_the_condition_are_named():
    table = grid().assign(speed=[float("nan"), *[1.0, 2.0] * 17, 1.0])
    with pytest.raises(InputError, match="trial 0 has no 'speed'"):
        each_left_out(table, ["speed"])


def test_a_copy_of_a_trial_that_is_left_aside_is_refused_on_another_side():
    table, first = grid(), np.arange(len(grid()))
    first[4] = 1  # (felt, 1, 1) is a copy of (felt, 0, 1)
    with pytest.raises(InputError, match="is a copy of"):
        split_conditions(table, (), SplitSpec(test_where={"speed": 0, "force": 0}, leave_aside=True), first)


def test_the_last_trials_as_recorded_are_tested():
    table = table_of(n_each=10, n_subjects=1)
    split = split_conditions(table, (), SplitSpec(order="trial", validation=0.2, test=0.3))
    assert split.test.tolist() == [7, 8, 9, 17, 18, 19]
    assert split.validation.tolist() == [5, 6, 15, 16]
    by_condition = split_conditions(table.assign(repetition=-table.repetition), (), SplitSpec(order="repetition"))
    assert by_condition.test.tolist() == [0, 1, 10, 11]


def test_a_class_of_one_group_is_never_taken_from_training():
    """Only ann touched jute, so that the groups of the others are tested, whatever the seed."""
    table = pd.DataFrame({"subject": ["ann", "ann", "bob", "bob", "cem", "cem"] * 3, "label": ["felt", "silk"] * 9})
    table = pd.concat([table, pd.DataFrame({"subject": ["ann"] * 3, "label": ["jute"] * 3})], ignore_index=True)
    for seed in range(20):
        split = split_conditions(table, (), SplitSpec(group=("subject",), seed=seed))
        assert set(table.subject[split.train]) == {"ann"}


@pytest.mark.parametrize(
    ("way", "complaint"),
    [
        (
            {"test_where": {"speed": 450}},
            r"split\.test_where: there is no condition 'speed'; known: label, subject, rep",
        ),
        ({"test_where": {"subject": ["s1", "s9"]}}, r"no trial has subject = s9; subject is s0, s1, s2, s3, s4$"),
        ({"test_where": {"label": "felt"}}, "no training trial of class 'felt' is left"),
        (
            {"test_where": {"repetition": 3}, "group": ("subject",)},
            r"the group s0 \(subject\) has trials on both sides",
        ),
        ({"group": ("label",)}, "no training trial of class 'silk' is left"),
        ({"group": ("subjekt",)}, r"split\.group: there is no condition 'subjekt'; did you mean 'subject'\?"),
        ({"group": ("subject",), "folds": 6}, "subject makes 5 groups where 6 are needed"),
        (
            {"group": ("half",)},
            r"half has 2 values \(a, b\) where at least three .*`test_where=.*b.*` in place",
        ),
        ({"group": ("half",), "folds": 2}, "half has 2 values"),
        ({"group": ("half",), "test_where": {"half": "b"}}, "without the test trials one value of half is left"),
        ({"folds": 101}, r"class 'felt' has 100 trials?, fewer than the 101 folds"),
        ({"order": "when"}, r"split\.order: there is no condition 'when'"),
    ],
)
def test_what_cannot_be_split_is_named(way, complaint):
    table = table_of()
    table["half"] = np.where(table["subject"] == "s0", "a", "b")
    with pytest.raises(InputError, match=complaint):
        split_conditions(table, (), SplitSpec(**way))


# --- copies -------------------------------------------------------------------------------------------


@examples(150)
@given(TABLES, WAYS, st.integers(0, 2**31), st.sampled_from([(), ("speed",)]), st.randoms(use_true_random=False))
def test_copies_stand_on_one_side_for_any_structure(table, way, seed, stratify, random):
    """Copies may be of other classes, groups and conditions: the sides are whole, or one sentence says why not."""
    spec, n = SplitSpec(seed=seed, **way), len(table)
    touch = np.array([random.randrange(max(1, n // 2)) for _ in range(n)])
    first = np.array([touch.tolist().index(number) for number in touch])
    split, refusal = attempt(table, spec, lambda table, spec: split_conditions(table, stratify, spec, first))
    if split is None:
        assert "\n" not in refusal
        assert refusal.startswith(("split", "dataset.stratify"))
        return
    assert spec.leave_aside or sorted(np.concatenate(split)) == list(range(n))
    groups = table[list(spec.group)].astype(str).agg(", ".join, axis=1).to_numpy() if spec.group else touch
    for names in (touch, groups):
        sides = [set(names[side]) for side in split]
        assert sum(map(len, sides)) == len(set.union(*sides))
    assert set(table.label[split.train]) == set(table.label)


@examples(100)
@given(TABLES, WAYS, st.integers(0, 2**31), st.sampled_from([(), ("speed",)]))
def test_without_copies_the_split_is_that_of_trials_alone(table, way, seed, stratify):
    spec, none = SplitSpec(seed=seed, **way), np.arange(len(table))
    with_first = attempt(table, spec, lambda table, spec: split_conditions(table, stratify, spec, none))
    without = attempt(table, spec, lambda table, spec: split_conditions(table, stratify, spec))
    assert with_first[1] == without[1]
    assert without[0] is None or all(map(np.array_equal, with_first[0], without[0]))


@given(BALANCED, SPECS, st.integers(1, 3))
def test_trials_saved_several_times_are_divided_as_if_saved_once(labels, spec, times):
    once, _ = attempt(labels, spec)
    assume(once is not None)
    n = len(labels)
    split = split_trials(np.tile(labels, times), spec, np.tile(np.arange(n), times))
    for side, alone in zip(split, once, strict=True):
        np.testing.assert_array_equal(side, np.concatenate([alone + n * copy for copy in range(times)]))


def test_a_copy_joins_groups():
    """Of five subjects two share a trial, so that four groups are left, and no fold parts those two."""
    table = table_of(n_each=4)
    first = np.arange(len(table))
    first[table.index[table.subject == "s1"][0]] = table.index[table.subject == "s0"][0]
    for fold in range(4):
        split = split_conditions(table, (), SplitSpec(folds=4, fold=fold, group=("subject",)), first)
        assert len({"s0", "s1"} & set(table.subject[split.test])) in (0, 2)
    with pytest.raises(InputError, match=r"makes 4 groups where 5 .* \(of the 40 trials 1 is a copy and does"):
        split_conditions(table, (), SplitSpec(folds=5, group=("subject",)), first)


def test_copies_of_few_touches_are_named_as_the_reason():
    labels, first = np.repeat(["felt", "silk"], 9), np.repeat([0, 9], 9)
    with pytest.raises(InputError, match=r"'felt' has 1 trial, too few .* \(of the 18 trials 16 are copies and do"):
        split_trials(labels, SplitSpec(), first)


@pytest.mark.parametrize(
    ("way", "complaint"),
    [
        (
            {"test_where": {"day": 2}},
            r"^split\.test_where: b\.csv is a copy of a\.csv, but only one of them has day = 2; remove the one with "
            r"the wrong condition, or split otherwise$",
        ),
        ({"order": "day"}, r"^split\.order: b\.csv is a copy of a\.csv, but they have different values of 'day'; rem"),
    ],
)
def test_copies_on_two_sides_of_a_condition_are_refused(way, complaint):
    files = ["a.csv", "b.csv", *(f"{at}.csv" for at in range(18))]
    table = pd.DataFrame({"label": ["felt"] * 10 + ["silk"] * 10, "day": [1, 2] * 10, "file": files})
    first = np.array([0, 0, *range(2, 20)])
    with pytest.raises(InputError, match=complaint):
        split_conditions(table, (), SplitSpec(**way), first)
    table.loc[1, "day"] = 1
    split = split_conditions(table, (), SplitSpec(**way), first)
    assert len({0, 1} & set(split.train)) in (0, 2)


def test_in_the_order_of_the_file_a_copy_counts_where_its_first_is():
    labels = pd.DataFrame({"label": ["felt", "silk"] * 10})
    first = np.array([*range(18), 0, 1])  # the first trials saved again at the end
    split = split_conditions(labels, (), SplitSpec(order="trial"), first)
    assert {0, 1, 18, 19} <= set(split.train)
    assert set(split.test) == {16, 17}


@pytest.mark.parametrize(
    ("way", "complaint"),
    [
        ({"folds": 3, "test_where": {"speed": 1}}, "test_where and folds both select the test trials"),
        ({"order": "trial", "group": ["subject"]}, "may split a group"),
        ({"folds": 3, "fold": 3}, "fold must be 0 to 2; got 3"),
        ({"fold": 1}, "fold must be given together with folds"),
    ],
)
def test_contradictory_ways_are_no_spec(way, complaint):
    with pytest.raises(InputError, match=complaint):
        build(SplitSpec, way, "study.toml")


def test_a_split_is_read_back_equal():
    split = SplitSpec(test_where={"speed": [1, 2]}, group=("a",))
    assert SplitSpec.model_validate(split.model_dump(mode="json")) == split
