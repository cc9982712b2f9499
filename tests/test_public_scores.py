"""The page of public scores: its rows of ours are those of the data, and each has its commands."""

import re
import runpy
from pathlib import Path

import pandas as pd
import pytest
from made_chains import make_event_run

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGE = (DOCS / "public-scores.md").read_text()
OURS = pd.read_csv(DOCS / "data" / "public-scores.csv").set_index("set")
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in PAGE.splitlines() if line.startswith("|")]
HEAD, SCORES = ROWS[0], [dict(zip(ROWS[0], row, strict=True)) for row in ROWS[2:]]
NAMES = {"letters": "Braille letters, 27", "fabrics": "FabricSlide, 7", "cubes": "Cubes (P(VDF-TrFE)), 5"}
NOT_MEASURED = {"ours, hidden neurons": "not measured", "SOPs": "", "effective ACs": "", "energy": ""}


@pytest.mark.parametrize("name", OURS.index)
def test_a_row_of_ours_is_that_of_the_data(name):
    (shown,), own = [row for row in SCORES if row["set, classes"] == NAMES[name]], OURS.loc[name]
    accuracy, low, high = (f"{100 * own[key]:.1f}" for key in ("accuracy", "low", "high"))
    assert shown["ours, hidden neurons"] == f"{accuracy} ({low} to {high}), {own['hidden']:.0f}"
    assert shown["SOPs"] == f"{own['sops']:,.0f}"
    assert shown["effective ACs"] == ("none" if pd.isna(own["effective_acs"]) else f"{own['effective_acs']:,.0f}")
    assert shown["energy"] == f"{own['energy_nJ']:,.0f} nJ"
    assert f"`{own['prices']}`" in PAGE
    assert re.search(rf"^neurotact train \S+ -o runs/{name}( |$)", PAGE, re.MULTILINE)
    assert re.search(rf"benchmarks/public_scores\.py .*runs/{name}\b.* -o docs/data$", PAGE, re.MULTILINE)


def test_every_row_of_the_data_is_shown_and_nothing_else_is_called_measured():
    measured = [row["set, classes"] for row in SCORES if row["ours, hidden neurons"] != "not measured"]
    assert sorted(measured) == sorted(NAMES[name] for name in OURS.index)
    others = [row for row in SCORES if row["set, classes"] not in measured]
    assert all(row.items() >= NOT_MEASURED.items() for row in others)


@pytest.mark.parametrize("row", SCORES, ids=lambda row: row["set, classes"])
def test_a_published_score_has_a_source(row):
    assert row["published"] == "none found" or re.search(r"\d", row["published"])
    assert re.search(r"\]\(https://\S+\)", row["whose, size, hardware"])


def test_the_picture_has_the_published_scores_of_the_table():
    drawn = pd.read_csv(DOCS / "data" / "published-scores.csv", dtype=str, keep_default_na=False)
    assert drawn["set"].tolist() == [row["set, classes"] for row in SCORES]
    assert drawn["published (%)"].tolist() == [row["published"] for row in SCORES]
    assert {own: name for name, own in drawn[["set", "ours"]].to_numpy() if own} == NAMES


def test_nothing_is_set_where_the_page_says_so():
    assert "nothing set" in PAGE
    assert not re.search(r"^neurotact (train|encode|calibrate) .*--(set|network|seed|window)", PAGE, re.MULTILINE)


def test_the_page_is_short_and_has_one_table():
    assert len(re.findall(r"\S*\w\S*", PAGE)) <= 500
    assert PAGE.count("|---") == len(HEAD)


@pytest.mark.parametrize("settings", [{}, {"reset": "hard"}], ids=["in snnTorch", "not in snnTorch"])
def test_the_script_makes_the_columns_of_the_data(tmp_path, settings):
    run = make_event_run(tmp_path, **settings) / "run"
    row = runpy.run_path(str(ROOT / "benchmarks" / "public_scores.py"))["row_of"](run)
    assert [*row] == [OURS.index.name, *OURS.columns]
    assert (row["effective_acs"] is None) == bool(settings)
    assert row["low"] < row["accuracy"] < row["high"]
    assert row["energy_nJ"] > 0
