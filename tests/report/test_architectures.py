"""Networks of several layers have rows of their own; networks that count nothing, an axis that has numbers."""

import json
import math
from pathlib import Path

import pandas as pd
import pytest
from in_process import studies_here, without_pictures
from made_run import grating_conditions, make_run
from test_report import DRAWN, Page, assert_quiet, chromium, make_study  # noqa: F401

import neurotact as nt
from neurotact.errors import InputError
from neurotact.figures import networks as figures
from neurotact.networks.use import ledger
from neurotact.report import networks, period_choice
from neurotact.report.answer import Decision, Network, Trials, answer
from neurotact.studies import loading

TINY = Path(__file__).parents[1] / "studies" / "tiny.toml"
SIZES = [[3, 1], [1, 3], 4]
ONE = {"simulate": "gratings", "subsets": {"mixed": {}}}


@pytest.fixture(scope="module")
def layered(tmp_path_factory):
    """A real run of two networks of equal sum, and of one with a single layer of as many neurons."""
    folder = tmp_path_factory.mktemp("layered") / "run"
    few = {"sweep.network.hidden": SIZES, "sweep.seed": [0, 1], "network.training.epochs": 1}
    with studies_here() as patch:
        without_pictures(patch)
        nt.run_study(TINY, folder, few)
    return folder


def test_layers_of_equal_sum_are_different_networks_in_every_table(layered):
    results = pd.read_csv(layered / "results.csv", keep_default_na=False)
    assert results["hidden"].tolist() == [4] * 12
    assert results["layers"].tolist() == ["3+1", "3+1", "1+3", "1+3", "", ""] * 2
    assert pd.read_csv(layered / "sops.csv", keep_default_na=False)["layers"].tolist() == results["layers"].tolist()
    named = pd.read_csv(layered / "ledger.csv")["name"]
    spiking = named[named.str.startswith("spiking")].tolist()
    assert len({*spiking}) == len(spiking) == 6
    assert [name.rpartition("N = ")[2] for name in spiking] == ["3+1", "1+3", "4"] * 2


def test_the_answer_averages_seeds_and_no_architectures(layered):
    (found,) = nt.study_answer(layered)["answers"]
    results = pd.read_csv(layered / "results.csv", keep_default_na=False)
    for one in found["networks"]:
        ra_ms = float(one["pair"].partition("&")[0])
        own = results[(results["t_ref_ra_ms"] == ra_ms) & (results["layers"] == one["layers"])]
        assert (one["seeds"], one["starts"], len(own)) == (2, 2, 2)
        assert one["whole"]["sops"] == pytest.approx(own["sops_total"].mean())
        assert one["cell"] in own.index
        assert f"{one['layers'] or 4} neurons" in one["name"]
    assert len(found["networks"]) == 6


def test_the_page_names_each_architecture(layered):
    html = Page(layered / "report.html")
    data = json.loads(html.json)
    assert (data["sizes"], data["architectures"]) == ([4], ["3+1", "1+3", "4"])
    assert [cell["layers"] for cell in data["cells"]] == ["3+1", "3+1", "1+3", "1+3", "", ""] * 2
    assert len({cell["name"] for cell in data["cells"]}) == 12
    text = " ".join(html.text.split())
    assert "12 networks: 2 pairs of refractory periods, 3 sizes" in text
    assert "N = 3+1" in text


@pytest.mark.parametrize("values", [[4, [4]], [[3, 1], [3, 1]], [4, 4]])
def test_an_axis_refuses_a_value_that_it_has_twice(values):
    with pytest.raises(InputError, match=r"sweep of 'network.hidden' has \S.* twice; drop one"):
        loading.resolve(TINY, {"sweep.network.hidden": values})


@pytest.fixture
def uncounted(tmp_path, monkeypatch):
    """The page of a run whose networks count no operations."""
    without_pictures(monkeypatch)
    monkeypatch.setattr(ledger, "is_row_counted", lambda *_: False)
    monkeypatch.setattr(networks, "_ledger", lambda *_: None)
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [10, 10]], "network.hidden": [20], "seed": [0]}
    what = make_study(sweep=sweep, claims=(), dataset=ONE)
    folder = make_run(what, tmp_path, grating_conditions())
    table = pd.read_csv(folder / "results.csv")
    table["input_spikes"], table["exit_input_spikes"] = table["sops_input"] / 20, table["exit_sops_input"] / 20
    table[[name for name in table if "sops" in name]] = math.nan
    table.to_csv(folder / "results.csv", index=False)
    return networks.write(what, folder)


def test_a_page_without_operations_says_so_and_shows_another_cost(uncounted):
    text = " ".join(Page(uncounted).text.split())
    assert "Total SOPs are not counted. SOPs from afferents to hidden neurons are not counted." in text
    assert "Accuracy against input spikes" in text
    (found,) = nt.study_answer(uncounted.parent)["answers"]
    assert "of the SOPs" not in found["period"]


@pytest.mark.slow
def test_in_a_browser_the_first_plot_has_a_cost_that_is_counted(chromium, uncounted):  # noqa: F811
    chromium.open(uncounted, 1400)
    chromium.wait_for(DRAWN)
    assert chromium.evaluate("document.getElementById('cost').value") == "spikes"
    options = "[...document.getElementById('cost').options].map((one) => [one.value, one.disabled, one.text])"
    assert chromium.evaluate(options) == [
        ["sops", True, "SOPs: not counted"], ["nJ", True, "energy (estimate): not counted"],
        ["spikes", False, "input spikes"], ["ms", False, "ms to decision"],
    ]  # fmt: skip
    assert_quiet(chromium, uncounted)


@pytest.mark.parametrize(("counted", "axis"), [("sops_total", "SOPs"), ("whole_nJ", "energy"), ("whole_ms", "time")])
def test_the_picture_has_the_first_cost_that_is_counted(counted, axis):
    rows = {"setting": ["all"] * 2, "pair": ["1&1", "5&5"], "hidden": [20] * 2, "accuracy_test": [0.8, 0.9],
            "exit_accuracy": [0.7, 0.8], "sops_total": [math.nan] * 2, "exit_sops_total": [math.nan] * 2,
            "early_nJ": [1.0, 2.0], "early_ms": [1.0, 2.0]}  # fmt: skip
    figure = figures.draw_trade_off(pd.DataFrame({**rows, counted: [2e3, 3e3]}))
    assert figure.axes[0].get_xlabel().startswith(axis)


def test_a_network_that_counts_nothing_saves_nothing_that_is_told():
    spent = Decision(0.9, math.nan, 500.0, 80.0, None)
    rows = [Network(pair, 0, 3, right, spent, None, is_part=True) for pair, right in (("1&1", 0.9), ("5&5", 0.95))]
    table = pd.DataFrame({"pair": ["1&1", "5&5"], "hidden": [0, 0], "seed": [0, 0], "accuracy_validation": [0.9, 0.95],
                          "accuracy_test": [0.9, 0.9], "whole_sops": math.nan, "whole_nJ": math.nan})  # fmt: skip
    found = answer(rows, [], 0.25, Trials(96, 100), chosen=rows[1])
    compared = period_choice.Comparison(table, lambda _: None, (), (96, 100, 100.0))
    choice = period_choice.choose(found, compared)
    assert (choice.kind, choice.why) == ("unclear", "what their decisions cost is not counted")
    said = period_choice.in_words(choice, period_choice.Sure(100, 1, 3, 20))
    assert "SOPs" not in said
    assert "loses 0.0 points" in said
