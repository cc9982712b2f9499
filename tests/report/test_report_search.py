"""What a report says of searches is what their journals hold."""

import json

import pandas as pd
import pytest
from made_run import grating_conditions, make_run
from neurotact_parts.networks.search import search_tables, searches_figures
from neurotact_parts.networks.search import searches as report_search
from neurotact_parts.networks.search.journal import Trial
from test_report import Page, make_study

from neurotact.networks.definition.space import SearchSpec
from neurotact.report import networks
from neurotact.studies import study
from neurotact.studies.cell import SEARCH
from neurotact.studies.store import cell_folder

SPACE = {
    "tau_mem_ms": {"_type": "choice", "_value": [5, 10, 20]},
    "forward_weight_scale": {"_type": "uniform", "_value": [0.2, 2.0]},
}


def trials_of(seed: int) -> list[Trial]:
    """Six trials: one is stopped, one fails, the fifth is the best."""
    values = [0.4, 0.5, 0.45, 0.3, 0.6 + 0.01 * seed, 0.55]
    outcomes = ["finished", "finished", "finished", "stopped", "finished", "failed"]
    return [
        Trial(i, {"tau_mem_ms": [5, 10, 20][i % 3], "forward_weight_scale": 0.2 + 0.3 * i}, [value], outcome,
              *((value, 1e3, value) if outcome != "failed" else (None, None, None)))
        for i, (value, outcome) in enumerate(zip(values, outcomes, strict=True))
    ]  # fmt: skip


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """A study of four cells, each with a search, and its report."""
    folder = tmp_path_factory.mktemp("searched")
    axes = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 5]], "network.hidden": [20], "seed": [0, 1]}
    what = make_study(sweep=axes, claims=(), search={"space": SPACE, "trials": 6, "batch": 2})
    make_run(what, folder, grating_conditions())
    for cell in study.cells(what):
        place = cell_folder(folder, cell) / SEARCH
        place.mkdir(parents=True)
        search_tables.trials_table(trials_of(cell.seed)).to_csv(place / "trials.csv", index=False)
    return what, networks.write(what, folder)


@pytest.mark.thorough
def test_every_trial_stands_in_one_table_beside_its_cell(searched):
    what, path = searched
    table = pd.read_csv(path.parent / "searches.csv")
    assert len(table) == 4 * 6
    assert table["cell"].value_counts().tolist() == [6] * 4
    assert report_search.hyperparameters(table) == list(SPACE)
    for index, cell in enumerate(study.cells(what)):
        own = table[table["cell"] == index]
        assert set(own["seed"]) == {cell.seed}
        told = [trial.value for trial in trials_of(cell.seed)]
        assert own["value"].tolist()[:5] == told[:5]
    assert "searches.csv" in Page(path).downloads


@pytest.mark.thorough
def test_the_page_knows_each_cells_search(searched):
    for index, cell in enumerate(json.loads(Page(searched[1]).json)["cells"]):
        found = cell["search"]
        assert found["best"] == 4
        assert found["outcomes"].count("stopped") == 1
        assert found["values"][5] is None
        assert found["values"][4] == max(value for value in found["values"] if value is not None)
        assert found["chosen"] == {"tau_mem_ms": "10", "forward_weight_scale": "1.4"}
        assert cell["row"]["seed"] == index % 2


@pytest.mark.thorough
def test_the_page_shows_figures_and_what_was_chosen(searched):
    page = Page(searched[1])
    assert {"figure-searches", "figure-search-winners", "searches", "cell-search"} <= set(page.ids)
    assert "Choice of each cell's search" in page.text
    assert "TPE, 6 trials per cell in batches of 2, median-stop" in page.text
    assert "4/1" in page.text  # finished and stopped


@pytest.mark.thorough
def test_a_study_without_a_search_says_nothing_of_searches(tmp_path):
    what = make_study(sweep={"network.hidden": [20]}, claims=())
    page = Page(networks.write(what, make_run(what, tmp_path, grating_conditions())))
    assert not {"figure-searches", "searches", "cell-search"} & set(page.ids)
    assert not (tmp_path / "searches.csv").exists()


def test_winners_and_gains_by_hand():
    trials = pd.concat(
        [
            search_tables.trials_table(trials_of(seed)).rename(columns={"id": "trial"}).assign(cell=seed)
            for seed in (0, 1)
        ],
        ignore_index=True,
    )
    assert searches_figures.winners(trials)["trial"].tolist() == [4, 4]
    assert searches_figures.gains(trials).round(6).tolist() == [0.2, 0.21]
    assert list(report_search.drawings(pd.DataFrame(), SearchSpec(space=SPACE))) == []
