"""A protocol study resolves, runs, resumes and reports as any study does."""

import json
import re
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from toy import bring

from neurotact import plugins
from neurotact.errors import InputError
from neurotact.report import first_screen, report, sentences, way_answer
from neurotact.studies import loading, runner, study, way, way_cells, way_study
from neurotact.studies.engine import Engine
from neurotact.studies.store import is_done, write_cell
from neurotact.tables import read_table

HERE = Path(__file__).parent
COINS = HERE / "coins.toml"


@pytest.fixture(autouse=True)
def _toy_protocols(monkeypatch):
    bring(monkeypatch)


def run_here(what: way_study.WayStudy, folder: Path, n_cells: int | None = None) -> Path:
    """As `runner.run`, in this process, which alone knows the toy protocol."""
    runner._claim(folder, what)
    cells = list(way_study.cells(what))
    way_cells.prepare(folder, what, cells)
    for cell in cells[:n_cells]:
        if not is_done(folder, cell):
            given = way_cells.load_arrays(folder / cell.given)
            write_cell(way_cells.run_cell(cell, given), cell, folder)
    runner.write_tables(folder)
    return report.write(folder)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        bring(patch)
        folder = tmp_path_factory.mktemp("coins")
        run_here(loading.resolve(COINS), folder)
        yield folder


def test_cells_are_the_product_of_the_sweep_with_every_parameter_whole():
    cells = list(way_study.cells(loading.resolve(COINS)))
    assert len({cell.digest() for cell in cells}) == len(cells) == 8
    assert [(c.parameters["rule"], c.parameters["data"]["heads"], c.parameters["seed"]) for c in cells[:3]] == [
        ("toss", 0.2, 0), ("toss", 0.2, 1), ("toss", 0.9, 0),
    ]  # fmt: skip
    assert {cell.parameters["repetitions"] for cell in cells} == {3}
    assert len({cell.data_name for cell in cells}) == 2


@pytest.mark.parametrize("quick", [False, True])
def test_a_resolved_study_reads_back_equal(tmp_path, quick):
    what = loading.resolve(COINS, quick=quick)
    (tmp_path / "study.toml").write_text(study.to_toml(what))
    assert loading.resolve(tmp_path / "study.toml") == loading.read_back(tmp_path / "study.toml") == what


@pytest.mark.parametrize("key", ["data.tosses", "parameters.data.tosses"])
def test_an_override_reaches_the_parameters(key):
    what = loading.resolve(COINS, {key: 7, "rule": "heads"}, quick=True)
    assert [(c.parameters["rule"], c.parameters["data"]["tosses"]) for c in way_study.cells(what)] == [
        ("heads", 7), ("heads", 7),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"repetitons": 3}, "repetitons: unknown key; did you mean 'repetitions'?"),
        ({"data.tosses": 0}, "data.tosses: must be >= 1; got 0"),
        ({"sweep.data.heads": [0.5, 2.0]}, "data.heads: must be <= 1; got 2.0"),
        ({"sweep.seed": []}, "sweep of 'seed' has no value"),
    ],
)
def test_what_is_wrong_is_refused_before_anything_runs(overrides, words):
    with pytest.raises(InputError, match=re.escape(words)):
        loading.resolve(COINS, overrides)


def test_a_protocol_that_takes_no_file_refuses_one(tmp_path):
    (tmp_path / "touches.h5").write_text("")
    with pytest.raises(InputError, match=r"`data`: coins\.toml makes or reads its own recordings; leave `data` out"):
        loading.resolve(COINS, data=tmp_path / "touches.h5")


def test_a_protocol_says_what_a_file_becomes(tmp_path, monkeypatch):
    asked = []

    def own(path, given):
        asked.append((path, dict(given)))
        return way.Own({**given, "data.path": str(path), "sweep.seed": [4]}, ("Seeds: one.",))

    monkeypatch.setattr(way.module_of("coins"), "own", own, raising=False)
    (tmp_path / "touches.h5").write_text("0")
    table = (
        COINS.read_text() + '\n[with_data]\ntitle = "Mine"\n"data.tosses" = 9\n[with_data.quick]\n"data.tosses" = 3\n'
    )
    (tmp_path / "coins.toml").write_text(table)
    what = loading.resolve(tmp_path / "coins.toml", {"rule": "heads"}, data=tmp_path / "touches.h5")
    assert asked == [(tmp_path / "touches.h5", {"data.tosses": 9, "rule": "heads"})]
    assert (what.title, what.notes, what.sweep["seed"]) == ("Mine", ("Seeds: one.",), [4])
    assert what.parameters["data"]["path"] == str(tmp_path / "touches.h5")
    (tmp_path / "study.toml").write_text(study.to_toml(what))
    assert loading.resolve(tmp_path / "study.toml") == what
    first = loading.resolve(tmp_path / "coins.toml", quick=True, data=tmp_path / "touches.h5")
    assert (first.parameters["data"]["tosses"], first.first_look) == (3, True)
    assert loading.resolve(tmp_path / "coins.toml") == loading.resolve(COINS)
    with pytest.raises(InputError, match=r"`data='.*away\.h5'`: there is no such file"):
        loading.resolve(tmp_path / "coins.toml", data=tmp_path / "away.h5")


def test_a_path_decides_nothing_where_the_content_is_named():
    def cell(**data):
        return way_study.WayCell(way="coins", parameters={"data": {"tosses": 3, **data}})

    here, there, other = (cell(path=path, content=content) for path, content in (("a", "1"), ("b", "1"), ("a", "2")))
    assert (here.digest(), here.given) == (there.digest(), there.given)
    assert here.digest() != other.digest()
    assert here.given != other.given
    assert cell(path="a").digest() != cell(path="b").digest()


def test_an_unknown_protocol_is_refused_by_its_nearest_name(tmp_path):
    (tmp_path / "study.toml").write_text(COINS.read_text().replace('"coins"', '"coin"'))
    with pytest.raises(InputError, match="there is none called 'coin'; did you mean 'coins'"):
        loading.resolve(tmp_path / "study.toml")


def test_results_have_a_row_for_each_that_a_cell_gives_and_what_was_swept_first(finished):
    results = pd.read_csv(finished / "results.csv")
    given = ["repetition", "accuracy_test", "flops", "n_train", "n_test"]
    assert list(results.columns) == ["rule", "heads", "seed", *given]
    assert len(results) == 8 * 3
    fell = np.random.default_rng(0).random(30) < 0.9
    rows = results[(results["rule"] == "heads") & (results["heads"] == 0.9)]
    assert rows["accuracy_test"].tolist() == pytest.approx([fell.mean()] * 6)


def test_the_rows_stand_in_the_order_of_the_sweep(finished):
    swept = pd.read_csv(finished / "results.csv")[["rule", "heads", "seed"]].drop_duplicates()
    sweep = loading.resolve(COINS).sweep
    assert swept.values.tolist() == [list(point) for point in product(*sweep.values())]


def test_swept_keys_that_end_alike_keep_their_whole_names():
    what = way_study.WayStudy(
        title="T", way="coins", sweep={"small.size": [1], "large.size": [2], "network.hidden": [3], "seed": [0]}
    )
    parameters = {"small": {"size": 1}, "large": {"size": 2}, "network": {"hidden": 3}, "seed": 0}
    cell = way_study.WayCell(way="coins", parameters=parameters)
    assert way_study.swept_values(what, cell) == {"small.size": 1, "large.size": 2, "hidden": 3, "seed": 0}


def test_an_interrupted_study_goes_on_to_the_same_bytes(finished, tmp_path):
    what = loading.resolve(COINS)
    run_here(what, tmp_path, n_cells=3)
    assert len(pd.read_csv(tmp_path / "results.csv")) == 3 * 3
    run_here(what, tmp_path)
    for name in ("results.csv", "means.csv", "means.md", "results.json", "data.json", "study.toml"):
        assert (tmp_path / name).read_bytes() == (finished / name).read_bytes(), name


def test_recordings_that_changed_are_refused(finished, tmp_path, monkeypatch):
    what = loading.resolve(COINS)
    run_here(what, tmp_path, n_cells=1)
    for path in (tmp_path / "data").glob("*.npz"):
        path.unlink()
    monkeypatch.setattr(way.module_of("coins"), "load", lambda data: {"fell": np.zeros(data.tosses)})
    with pytest.raises(InputError, match="the recordings changed since this study began"):
        run_here(what, tmp_path)


def test_means_are_over_the_rows_of_a_configuration(finished):
    means, results = pd.read_csv(finished / "means.csv"), pd.read_csv(finished / "results.csv")
    groups = results.groupby(["rule", "heads"], sort=False)["accuracy_test"]
    assert means["rows"].tolist() == [6] * 4
    assert means["accuracy_test"].tolist() == pytest.approx(groups.mean().tolist())
    assert means["accuracy_test_sd"].tolist() == pytest.approx(groups.std().tolist())


def test_the_report_shows_claims_figures_and_every_configuration(finished):
    page = (finished / "report.html").read_text()
    assert "1 of 2 claims reproduced" in page
    assert "A toss knows nothing." in page
    assert 'id="figure-tosses"' in page
    assert len(re.findall(r"<tr data-cell=", page)) == 4
    assert "Coins.\n" in page
    assert not re.search(r"(src|href|url\()\s*=?\s*[\"']?\s*(https?:)?//", page)


def test_a_way_opens_with_its_sentence_its_picture_and_five_rows_and_folds_the_rest(finished, tmp_path, monkeypatch):
    shutil.copytree(finished, tmp_path / "run")
    labels = {("toss", "0.2"): "a toss of 30 %", ("heads", "0.9"): "", ("heads", "0.2"): ""}
    said = way.Named("80 % of <all> tosses are foreseen.", ["None is best; all fall."], {"flops": labels}, "a rule")
    rows = pd.DataFrame({"rule": [f"rule {number}" for number in range(9)]})
    monkeypatch.setattr(way.module_of("coins"), "named", lambda _: {"": said}, raising=False)
    monkeypatch.setattr(
        way.module_of("coins"), "tables", lambda _: {"": (way.Listed("Rules.", rows, [8, 2]),) * 2}, raising=False
    )
    report.write(tmp_path / "run")
    page = (tmp_path / "run" / "report.html").read_text()
    first = re.search(r'<section id="answer".*?</section>', page, re.DOTALL)[0]
    seen = re.sub(r"<details.*?</details>", "", first, flags=re.DOTALL)
    assert re.findall(r'class="headline">(.*?)</p>', seen) == ["80\u00a0% of &lt;all&gt; tosses are foreseen."]
    assert re.findall(r"rule \d", seen) == ["rule 2", "rule 8"]
    assert "None is best; all fall." in first.replace(seen, "")
    assert "None is best" not in seen
    drawn = json.loads(re.search(r'id="study-data">(.*?)</script>', page)[1])
    assert drawn["fronts"][""]["named"] == "a rule"
    of_points = {point["name"]: point["labels"] for point in drawn["points"]}
    assert of_points["rule toss, heads 0.2"] == {"": {"flops": "a toss of 30 %"}}
    assert of_points["rule heads, heads 0.9"] == {"": {"flops": ""}}
    assert of_points["rule toss, heads 0.9"] == {"": {}}  # not drawn
    answer = json.loads((tmp_path / "run" / "answer.json").read_text())
    told = {"dataset": "", "headline": said.headline, "details": said.details}
    assert answer["answers"] == [told | {"next": {"words": "", "commands": []}}]
    assert [(len(table["rows"]), table["named"]) for table in answer["tables"]] == [(9, [2, 8])] * 2


def test_the_first_screen_answers_before_anything_else(finished):
    page = (finished / "report.html").read_text()
    view = way.module_of("coins").VIEW
    results = read_table(finished / "results.csv")
    (found,) = way_answer.answers(read_table(finished / "means.csv"), view, results)
    assert found.kind == "worse"  # of the rule that is right where heads fall
    said = sentences.evidence(found).replace(" %", "\u00a0%")
    assert "The comparison is of 30 test trials of one split, and says nothing of other splits." in page
    assert found.best.name.startswith("heads")
    parts = (sentences.verdict(found), 'id="plot"', "The best of each kind", said, "Explore every", 'id="claims"')
    order = [page.index(part) for part in parts]
    assert order == sorted(order)
    drawn = json.loads(re.search(r'id="study-data">(.*?)</script>', page)[1])
    assert drawn["fronts"] == {
        "": {"best": found.best.index, "cheapest": found.cheapest.index, "chance": None, "named": ""}
    }
    assert drawn["points"][found.best.index]["costs"] == {"flops": 1.0}
    assert drawn["points"][found.best.index]["y"] == pytest.approx(100 * found.best.accuracy)


def test_a_way_without_sentences_leaves_the_answer_of_its_page(finished):
    answer, view = json.loads((finished / "answer.json").read_text()), way.module_of("coins").VIEW
    (found,) = way_answer.answers(read_table(finished / "means.csv"), view, read_table(finished / "results.csv"))
    (said,) = answer["answers"]
    assert (said["headline"], said["short"]) == (sentences.headline(found), sentences.verdict(found))
    assert said["details"] == [*sentences.details(found)]
    assert [figure["what"] for figure in said["figures"]] == ["test accuracy", "FLOPs"]
    (table,) = answer["tables"]
    assert (table["setting"], table["rows"]) == ("", first_screen.table_of_configurations(found).rows)


def test_the_protocols_that_ship_hold_what_a_protocol_holds(monkeypatch):
    monkeypatch.undo()
    modules = [name for name in plugins.names("ways") if not isinstance(plugins.load("ways", name), Engine)]
    assert {*plugins.names("ways")} - {*modules} == {"networks", "targets", "afferents", "selection"}
    for name in modules:
        module = way.module_of(name)
        assert "data" in module.Parameters.model_fields, name
        view = module.VIEW
        assert {view.cost, view.score} <= set(view.measures), name
        assert set(view.apart) < set(view.by), name
        assert view.spiking is None or view.spiking[0] in set(view.by) - set(view.apart), name
        assert view.spiking is None or view.splits is not None, name  # otherwise its verdict is never tested
        assert all(callable(getattr(module, part)) for part in ("load", "run", "draw")), name
