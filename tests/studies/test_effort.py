"""A study over the effort of the recipe: its rows, its ledger and its report know what was joined."""

import json
from pathlib import Path

import pandas as pd
import pytest

from neurotact.report import details, report
from neurotact.studies import runner, study

TINY = Path(__file__).parent / "tiny.toml"
SETTINGS = {
    "network": "default", "network.model": "rsnn", "network.training.epochs": 2,
    "sweep.network.hidden": [4], "sweep.seed": [0], "sweep.network.effort": ["default", "best"],
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[5, 10]],
}  # fmt: skip

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def folder(tmp_path_factory, told):
    folder = tmp_path_factory.mktemp("efforts")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "say", told.append)
        runner.run(study.resolve(TINY, SETTINGS), folder, workers=1)
    report.write(folder)
    return folder


def test_what_joined_networks_cost_is_said_once(folder, told):
    assert [line for line in told if "joined" in line] == [
        "3 networks of 4 neurons are joined into one of 12: up to 3 times the training time, and 3 times the SOPs "
        "and energy"
    ]


def test_a_row_is_of_the_joined_network(folder):
    usual, best = pd.read_csv(folder / "results.csv").to_dict("records")
    assert (usual["hidden"], best["hidden"], best["members"], best["recurrent_blocks"]) == (4, 12, 3, 3)
    for row in (usual, best):
        assert row["sops_input"] == pytest.approx(row["hidden"] * (row["spikes_sa"] + row["spikes_ra"]))
    n_classes = len(json.loads(next(folder.glob("cells/*/result.json")).read_text())["confusion"])
    assert best["sops_recurrent"] / best["sops_readout"] == pytest.approx(4 / n_classes)
    assert best["epochs"] == 3 * usual["epochs"] == 6


def test_the_ledger_counts_the_synapses_that_exist(folder):
    ledger = pd.read_csv(folder / "ledger.csv").set_index("name")
    usual, best = (ledger[ledger.index.str.contains(f"effort {effort}")].iloc[0] for effort in ("default", "best"))
    alone = ledger[ledger.index.str.contains("alone")].iloc[0]
    n_classes = len(json.loads(next(folder.glob("cells/*/result.json")).read_text())["confusion"])
    assert best["parameters"] - alone["parameters"] == 3 * (usual["parameters"] - alone["parameters"]) - 2 * n_classes


def test_a_report_shows_the_training_of_the_first_network(folder):
    logs = [details._training(folder, cell) for cell in study.cells(study.resolve(TINY, SETTINGS))]
    assert [log and log.get("members") for log in logs] == [None, 3]
    assert [log and log["epoch"] for log in logs] == [[1.0, 2.0]] * 2
