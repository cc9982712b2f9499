"""A selection follows Fig. 7's loop: a step asks for what the one before leaves open; validation alone decides."""

import shutil
from functools import partial
from pathlib import Path

import in_process
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.texture import selection
from neurotact_parts.studies.texture.selection import LENGTH, Network, Rule, by_length, by_network, follow, rule_of

from neurotact.errors import InputError
from neurotact.studies import loading, runner, study
from neurotact.studies.store import cell_folder
from neurotact.studies.study import Cell, StudySpec

LENGTHS_MS = [50.0, 100.0, 200.0]
PAIRS = [[1, 1], [5, 5], [1, 10]]
SWEEP = {LENGTH: LENGTHS_MS, study.PAIR: PAIRS, "network.hidden": [4, 6], "seed": [0, 1]}


def make_study(**changes) -> StudySpec:
    table = {
        "parameters": {"length_tolerance": 0.05, "accuracy_tolerance": 0.1, "networks": 2},
        **{f"sweep.{axis}": values for axis, values in SWEEP.items()},
    }
    resolved = loading.resolve("network-selection", table | changes)
    assert isinstance(resolved, StudySpec)
    return resolved


WHAT = make_study()
CELLS = list(study.cells(WHAT))


def row(cell: Cell, accuracy: float, sops: float) -> dict:
    """What a cell leaves; its test figures say the opposite of its validation figures."""
    assert cell.network is not None
    return {
        "dataset": cell.dataset, "hidden": cell.network.hidden, "seed": cell.seed,
        "accuracy_validation": accuracy, "accuracy_test": 1 - accuracy, "sops_validation": sops, "sops_total": -sops,
    }  # fmt: skip


def as_published(cell: Cell) -> dict:
    """Fig. 8 and Fig. 11: 100 ms are nearly as accurate as 200 ms; 5&5 and 1&10 cost fewer SOPs and some accuracy."""
    assert cell.network is not None
    loss = {"1&1": 0.0, "5&5": 0.05, "1&10": 0.07}[selection._network(cell).pair]
    at = {50.0: 0.6, 100.0: 0.88, 200.0: 0.92}[cell.window.length_ms]
    share = {"1&1": 1.0, "5&5": 0.72, "1&10": 0.6}[selection._network(cell).pair]
    return row(cell, at - loss, cell.window.length_ms * cell.network.hidden * share)


def found(what: StudySpec, row_of) -> selection.Selection:
    course = follow(rule_of(what), list(study.cells(what)), row_of)
    assert not course.due
    assert course.found is not None
    return course.found


def test_the_published_figures_give_the_published_choice():
    chosen = found(WHAT, as_published)
    assert chosen.lengths[LENGTH][chosen.lengths["chosen"]].tolist() == [100.0]
    assert chosen.last.chosen == [Network("1&10", 4), Network("5&5", 4)]
    assert chosen.last.persists == (True, True)


def _look_up(done: dict[str, dict], cell: Cell) -> dict | None:
    return done.get(cell.digest())


def test_each_step_waits_for_its_cells_and_asks_for_no_other():
    done: dict[str, dict] = {}
    asked = []
    while (course := follow(rule_of(WHAT), CELLS, partial(_look_up, done))).due:
        asked.append(course.steps[-1].name)
        done |= {cell.digest(): as_published(cell) for cell in course.due}
    assert asked == ["window lengths at 1&1", "trade-off at 100 ms", "persistence from 100 ms"]
    assert len(done) < len(CELLS)
    assert {(cell.window.length_ms, selection._network(cell)) for cell in CELLS if cell.digest() not in done} == {
        (length, Network(pair, 6)) for length in (50.0, 200.0) for pair in ("5&5", "1&10")
    }


def test_a_trade_off_that_does_not_persist_is_looked_for_at_the_next_length():
    def fades(cell: Cell) -> dict:
        """1&10 wants 200 ms."""
        wants_more = selection._network(cell).pair == "1&10" and cell.window.length_ms == 100.0
        return as_published(cell) | ({"accuracy_validation": 0.785} if wants_more else {})

    chosen = found(WHAT, fades)
    assert [attempt.length_ms for attempt in chosen.attempts] == [100.0, 200.0]
    assert chosen.attempts[0].persists == (False, True)
    assert all(chosen.last.persists)


def test_starts_are_averaged_as_seeds_are():
    starts = {"sweep.dataset.parameters.start_mm": [4.41, 9.41]}

    def by_start(cell: Cell) -> dict:
        """5&5 and 1&10 are accurate enough at one start each, and in the mean over both."""
        favoured = {"5&5": 4.41, "1&10": 9.41}.get(selection._network(cell).pair)
        here = study.value_at(cell, "dataset.parameters.start_mm") == favoured
        published = as_published(cell)
        return published | {"accuracy_validation": published["accuracy_validation"] + (0.1 if here else -0.1)}

    chosen, without = found(make_study(**starts), by_start), found(WHAT, as_published)
    assert (chosen.last.chosen, chosen.last.length_ms) == (without.last.chosen, without.last.length_ms)
    assert (chosen.last.networks["networks"] == 2 * without.last.networks["networks"]).all()


def test_test_trials_decide_nothing():
    def otherwise(cell: Cell) -> dict:
        return as_published(cell) | {"accuracy_test": np.random.default_rng(cell.seeds[0]).random(), "sops_total": 0.0}

    one, other = found(WHAT, as_published), found(WHAT, otherwise)
    assert one.last.chosen == other.last.chosen
    assert one.last.length_ms == other.last.length_ms


accuracies = st.lists(st.floats(0, 1), min_size=1, max_size=8)
tolerances = st.floats(0, 0.5)


@given(accuracies, tolerances, tolerances)
def test_a_larger_tolerance_never_gives_a_longer_window(values, one, other):
    rows = pd.DataFrame({LENGTH: np.arange(1.0, len(values) + 1), "accuracy_validation": values})
    chosen = [
        by_length(rows, Rule(length_tolerance=tolerance)).query("chosen")[LENGTH].tolist()
        for tolerance in sorted((one, other))
    ]
    assert [len(lengths) for lengths in chosen] == [1, 1]
    assert chosen[1][0] <= chosen[0][0]


@st.composite
def networks(draw) -> pd.DataFrame:
    pairs, sizes = ["1&1", "1&5", "5&5", "1&10"][: draw(st.integers(1, 4))], [20, 30][: draw(st.integers(1, 2))]
    shape = [(pair, size) for pair in pairs for size in sizes]
    draws = [(draw(st.sampled_from([0.7, 0.8, 0.85, 0.9])), draw(st.integers(1, 4))) for _ in shape]
    return pd.DataFrame(
        [
            {"pair": pair, "hidden": size, "accuracy_validation": accuracy, "sops_validation": 1e3 * sops}
            for (pair, size), (accuracy, sops) in zip(shape, draws, strict=True)
        ]
    )


@given(networks(), tolerances, st.integers(1, 3))
@examples(60)
def test_the_chosen_are_the_cheapest_of_the_accurate_ones_each_with_a_pair_of_its_own(rows, tolerance, n):
    table = by_network(rows, Rule(accuracy_tolerance=tolerance, networks=n))
    chosen = table[table["chosen"]].sort_values("rank")
    within = table[table["within"]]
    assert len(chosen) == min(n, within["pair"].nunique())
    assert chosen["pair"].is_unique
    assert chosen["within"].all()
    assert chosen["sops_validation"].is_monotonic_increasing
    assert chosen["sops_validation"].iloc[0] == within["sops_validation"].min()
    assert (within["accuracy_validation"] >= table["accuracy_validation"].max() - tolerance - 1e-9).all()
    assert table["best"].sum() == 1
    for _, network in chosen.iterrows():  # no accurate network of its pair costs less
        assert network["sops_validation"] == within[within["pair"] == network["pair"]]["sops_validation"].min()


def test_the_table_tells_every_step():
    table = selection.as_table(found(WHAT, told))
    assert table["step"].value_counts(sort=False).to_dict() == {
        "window length": 3, "trade-off": 6, "persistence": 9, "choice": 2
    }  # fmt: skip
    choice = table[table["step"] == "choice"]
    assert choice["pair"].tolist() == ["1&10", "5&5"]
    assert (choice[LENGTH] == 100.0).all()
    assert choice["persists"].tolist() == [1, 1]
    assert choice["oracle_share"].tolist() == [0.75, 0.75]


def told(cell: Cell) -> dict:
    """As published, with what is told of a network besides."""
    rest = dict.fromkeys(("exit_accuracy", "exit_sops_total", "oracle_accuracy", "oracle_sops_total"), 0.5)
    return as_published(cell) | rest | {"exit_steps": 80.0, "oracle_steps": 75.0, "window_steps": 100.0}


# --- the command ------------------------------------------------------------------------------------

TINY = Path(__file__).parents[2] / "studies" / "tiny.toml"
WORDS = (
    "study", "run", TINY, "--set", "way=selection", "--set", "parameters.networks=1",
    "--set", "sweep.window.length_ms=[20.0, 50.0, 100.0]",
)  # fmt: skip


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A selection as a user types it, in one process."""
    folder = tmp_path_factory.mktemp("selection") / "run"
    typed(*WORDS, "--workers", "1", "-o", folder)
    return folder


def typed(*words: object) -> str:
    done = in_process.typed(*words)
    assert done.code == 0, done.err
    return done.err


@pytest.mark.thorough
def test_a_run_leaves_the_selection_and_the_cells_that_it_asked_for(ran):
    table, results = pd.read_csv(ran / "selection.csv"), pd.read_csv(ran / "results.csv")
    length_ms = table[LENGTH][table["step"] == "choice"].item()
    asked = (results["t_ref_sa_ms"] == 1.0) | (results[LENGTH] == length_ms)
    rest = set(results["hidden"][~asked]) | set(table["hidden"][table["step"] == "choice"])
    assert len(results) < 24
    assert {row["step"] for _, row in table.iterrows()} >= {"window length", "trade-off", "persistence", "choice"}
    assert len(list((ran / "cells").iterdir())) == len(results)
    assert rest <= {4, 6}
    page = (ran / "report.html").read_text()
    for words in ("The selection, step by step", "1. Window length", "Early exit", f"T_min is {length_ms:g} ms"):
        assert words in page


@pytest.mark.slow
def test_a_selection_that_is_not_complete_says_what_it_waits_for(ran, tmp_path):
    shutil.copytree(ran, tmp_path / "part")
    results = pd.read_csv(ran / "results.csv")
    least = results[LENGTH].min()
    what = runner.load(tmp_path / "part")
    for cell in study.cells(what):
        if cell.window.length_ms == least and (cell_folder(tmp_path / "part", cell) / "result.json").is_file():
            shutil.rmtree(cell_folder(tmp_path / "part", cell))
    err = typed("study", "report", tmp_path / "part")
    assert "8 of 12 cells are done" in err
    assert "This step needs 12 cells" in (tmp_path / "part" / "report.html").read_text()
    typed("study", "resume", tmp_path / "part")
    assert (tmp_path / "part" / "selection.csv").read_bytes() == (ran / "selection.csv").read_bytes()


@pytest.mark.slow
def test_two_workers_select_by_the_same_bytes(ran, tmp_path):
    typed(*WORDS, "--workers", "2", "-o", tmp_path / "two")
    for name in ("results.csv", "selection.csv"):
        assert (tmp_path / "two" / name).read_bytes() == (ran / name).read_bytes()


@pytest.mark.parametrize("axis", [LENGTH, "network.hidden"])
def test_a_selection_needs_something_to_select_from(axis, tmp_path):
    lines = study.to_toml(WHAT).splitlines()
    (tmp_path / "lacking.toml").write_text("\n".join(line for line in lines if not line.startswith(f'"{axis}"')))
    with pytest.raises(InputError, match="selection needs a sweep of"):
        loading.resolve(tmp_path / "lacking.toml")


def test_a_selection_averages_over_no_key_of_the_network():
    with pytest.raises(InputError, match=r"beside them only seed and keys of dataset\.parameters"):
        make_study(**{"sweep.network.surrogate_scale": [5.0, 10.0]})
