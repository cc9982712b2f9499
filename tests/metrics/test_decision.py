"""Choices: the first candidate within the error of the best, whatever the last bits of the merits are."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from neurotact.metrics.decision import ROUNDING, Decision, is_within

MERITS = st.lists(st.integers(0, 100).map(lambda percent: percent / 100), min_size=1, max_size=6)
ERRORS = st.integers(0, 20).map(lambda percent: percent / 100)


def decision(merits, error):
    return Decision("a.key", dict(enumerate(merits)), error)


@given(MERITS, ERRORS)
def test_the_chosen_one_is_the_first_that_the_error_does_not_tell_from_the_best(merits, error):
    chosen = decision(merits, error).chosen
    assert max(merits) - merits[chosen] <= error + 1e-12
    assert all(max(merits) - earlier > error + 1e-12 for earlier in merits[:chosen])


@given(MERITS, ERRORS, st.data())
def test_a_choice_flips_no_earlier_than_a_merit_reaches_the_error(merits, error, data):
    """Merits that move by less than half of the distance to the threshold, or by rounding, change nothing."""
    apart = [abs(max(merits) - merit - error) for merit in merits]
    least = min((distance for distance in apart if distance > 1e-12), default=1.0)
    most = ROUNDING / 2 if any(distance <= 1e-12 for distance in apart) else 0.49 * least
    moved = [merit + data.draw(st.floats(-0.5 * most, 0.5 * most)) for merit in merits]
    assert decision(moved, error).chosen == decision(merits, error).chosen


@given(MERITS, ERRORS)
def test_an_unknown_merit_is_never_chosen_beside_a_known_one(merits, error):
    known = decision([math.nan, *merits, math.nan], error)
    assert known.chosen == decision(merits, error).chosen + 1
    assert decision([math.nan, math.nan], error).chosen == 0


@given(
    st.dictionaries(st.sampled_from(["none", "start", 30.0, True]), st.floats(0, 1), min_size=1), st.integers(1, 500)
)
def test_the_note_names_the_key_the_choice_every_merit_and_how_to_choose_otherwise(shares, n):
    assume(len(shares) == len({*map(str, shares)}))
    found = Decision.of_shares("conditioning.baseline", shares, n)
    words = found.note("accuracy on the training trials", "it does this")
    assert words.startswith("conditioning.baseline = ")
    assert words.endswith("; to choose otherwise, set conditioning.baseline")
    assert all(f" {100 * share:.0f} %" in words for share in shares.values())
    assert found.note("x", override="a.key = 3").endswith("set a.key = 3")


def test_more_trials_tell_smaller_differences_apart():
    shares = {"first": 0.85, "second": 0.88}
    assert [Decision.of_shares("key", shares, n).chosen for n in (100, 10_000)] == ["first", "second"]
    assert not is_within(math.nan, 0.5, 1.0)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "key is left out"),
        (True, "key = true is chosen"),
        (30.0, "key = 30 is"),
        ((0.5, 1.0), "key = [0.5, 1] is"),
    ],
)
def test_a_choice_is_written_as_a_value_of_the_key(value, words):
    assert words in Decision("key", {value: 0.5}).note("accuracy")
