"""The first screen: its three figures are rows of its table, and it says where the choice is not the best test row."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.report import first_screen, page
from neurotact.report.answer import Baseline, Decision, Network, Trials, answer
from neurotact.report.first_screen import HEADS

TRIALS = Trials(validation=40, test=40)
SHARE = st.floats(0, 1)
DECISIONS = st.builds(
    Decision, SHARE, st.floats(1, 1e6), st.floats(1, 2000), st.floats(0, 1e4), st.none() | st.floats(0.1, 1e5)
)
NETWORKS = st.lists(
    st.builds(Network, st.sampled_from(["1&1", "5&5"]), st.integers(1, 99), st.just(1), SHARE, DECISIONS,
              st.none() | DECISIONS, st.none() | SHARE,
              starts=st.just(1), apart=st.none(), apart_early=st.none()),
    min_size=1, max_size=4, unique_by=lambda one: (one.pair, one.hidden),
)  # fmt: skip
BASELINES = st.lists(
    st.builds(Baseline, st.sampled_from([f"{name} on {source} (counts)" for name in ("SVM", "ELM")
                                         for source in ("signals", "1&1 ms spikes")]),
              SHARE, SHARE, st.none() | st.floats(0.1, 1e4), st.just(()), st.none()),
    max_size=4, unique_by=lambda one: one.name,
)  # fmt: skip


@given(NETWORKS, BASELINES)
def test_the_figures_are_those_of_the_row_of_the_best_network(networks, baselines):
    found = answer(networks, baselines, 0.25, TRIALS)
    rows = [dict(zip(HEADS, row, strict=True)) for row in first_screen.table(found).rows]
    (best,) = [row for row in rows if "best on validation" in row[HEADS[0]]]
    shown = {figure.what: figure for figure in first_screen.figures(found)}
    accuracy = shown["test accuracy"]
    low, high = accuracy.of.removeprefix("95 % interval ").split(" %")[0].split(" to ")
    assert best[HEADS[1]] == f"{accuracy.value} ({low} to {high})"
    assert shown["time to decision"].value == f"{best['ms to decision']} ms"
    assert ("energy per decision" in shown) == (best["energy estimate"] != "-")
    if "energy per decision" in shown:
        assert shown["energy per decision"].value == best["energy estimate"]
    if found.beside is not None:
        (rival,) = [row for row in rows if row[HEADS[0]].partition(": ")[0] == found.beside.name]
        assert accuracy.against.startswith(f"{found.beside.name}: {rival[HEADS[1]]}")


@given(NETWORKS, BASELINES)
def test_the_first_five_rows_hold_what_the_verdict_rests_on(networks, baselines):
    found = answer(networks, baselines, 0.25, TRIALS)
    whole = first_screen.table(found)
    rows, names = whole.few.rows, [row[0].partition(": ")[0] for row in whole.few.rows]
    assert len(rows) <= 5
    assert rows == [row for row in whole.rows if row in rows]
    assert sum("best on validation" in row[0] for row in rows) == 1
    assert names[-1] == "guessing"
    assert {one.name for one in (found.beside, found.comparable) if one is not None} <= set(names)


@given(NETWORKS, BASELINES)
def test_a_row_that_is_better_on_test_trials_is_named_with_the_choice(networks, baselines):
    found = answer(networks, baselines, 0.25, TRIALS)
    said = first_screen.chosen(found)
    shares = [float(row[1].partition(" %")[0]) for row in first_screen.table(found).rows[:-1]]
    named = {found.best.used.accuracy} | ({found.beside.accuracy} if found.beside else set())
    assert ("would flatter" in said) >= (max(shares) > 100 * max(named) + 0.06)
    assert "chosen on validation trials" in said


def test_without_spike_trains_time_and_energy_are_not_made_up():
    used = Decision(0.9, 1000.0, math.nan, 80.0, None)
    found = answer([Network("1&1", 50, 1, 0.9, used, None)], [], 0.25, TRIALS)
    assert [figure.what for figure in first_screen.figures(found)] == ["test accuracy"]
    assert "no other classifier" in page.typed(first_screen.sentences.verdict(found), "-o")


@pytest.mark.parametrize("text", ["`settings={'a': }`", "`settings={1}`", "no settings, 5 of 6"])
def test_what_is_no_table_of_settings_stays(text):
    assert page.typed(text, "-o") == text
    assert page.typed("test every trial with `split=nt.Split(folds=5)`", "-o") == "test every trial with `--folds 5`"
