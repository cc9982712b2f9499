"""The report shows what a run holds, says what it lacks, and asks nothing of the network."""

import json
import re
import shlex
import shutil
from base64 import b64decode
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from browser import APART, browser
from hypothesis import given
from hypothesis import strategies as st
from in_process import without_pictures
from levels import thinned
from made_run import GRATINGS, SUBSETS, grating_conditions, make_run, make_trains, row_of

import neurotact as nt
from neurotact.data.hdf5 import load_spikes
from neurotact.errors import InputError
from neurotact.files import read_json
from neurotact.metrics.prices import ARITHMETIC_45NM, PriceList
from neurotact.networks.definition.specs import TrainingSpec
from neurotact.networks.exit.patience import upper_bound
from neurotact.networks.training import run_folder, tasks
from neurotact.networks.training.epochs import Epoch
from neurotact.networks.use.measuring import OWN_KEYS
from neurotact.report import details, front, networks, period_choice, sentences, tables
from neurotact.report.answer import Network
from neurotact.report.details import SOPS_COLUMNS
from neurotact.report.encoding_drawings import name_classes
from neurotact.report.tables import kept_epoch
from neurotact.studies import store, study
from neurotact.studies.cell import task_of
from neurotact.studies.claims import Claim
from neurotact.studies.store import cell_folder
from neurotact.studies.study import StudySpec
from neurotact.tables import in_words_of_size, over_seeds, sized

TINY = Path(__file__).parents[1] / "studies" / "tiny.toml"
CLAIMS = (
    Claim(name="Counts fall", source="Fig. 6", published="1&1 > 10&10", kind="order", table="encoding",
          measure="spikes_total_per_s", order=(({"pair": "1&1"},), ({"pair": "10&10"},))),
    Claim(name="1&1 is <accurate>", source="Fig. 11", published="99.9 %", kind="value", measure="accuracy_test",
          where={"pair": "1&1", "dataset": "mixed", "hidden": 30}, value=0.999, tolerance=0.001,
          why="Chance & noise."),
    Claim(name="7&7", source="Fig. 8", published="90 %", kind="at_least", measure="accuracy_test",
          where={"pair": "7&7"}, value=0.9, why="Untold."),
    Claim(name="10&10 is not accurate", source="Fig. 11", published="< 83 %", kind="at_most", measure="accuracy_test",
          where={"pair": "10&10"}, value=0.83, why="It is."),
)  # fmt: skip


def make_study(**changes) -> StudySpec:
    sweep = {
        "dataset": ["v1 mix", "mixed"],
        "encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [1, 5], [10, 10]],
        "network.hidden": [20, 30],
        "seed": [0, 1],
    }
    table = {
        "title": "A study of <gratings>",
        "about": "First paragraph.\n\nSecond.",
        "dataset": {**GRATINGS, "subsets": SUBSETS},
        "window": {"length_ms": 150.0, "start_ms": 100.0},
        "sweep": sweep,
        "claims": CLAIMS,
        "encoder": study.PARTS["encoder"]("sa1-ra1-lif"),
        "network": study.PARTS["network"]("rsnn"),
    }
    return StudySpec.model_validate({**table, **changes})


class Page(HTMLParser):
    """What a test asks of a page: its links, pictures, heads of tables, text, and the data of its script."""

    def __init__(self, path: Path):
        super().__init__()
        self.links, self.images, self.heads, self.ids, self.text = [], [], [], [], ""
        self.landmarks = []
        self.downloads, self.handlers, self.json, self._in_script = {}, [], "", None
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.links += [given[k] for k in ("href", "src") if k in given]
        self.ids += [given["id"]] if "id" in given else []
        if tag == "img":
            self.images.append(given)
        if given.get("role") == "region":
            self.landmarks.append(given["aria-label"])
        if tag == "th":
            self.heads.append(given.get("scope"))
        if "download" in given:
            self.downloads[given["download"]] = given["href"]
        self.handlers += [name for name in given if name.startswith("on")]
        self._in_script = given.get("id", "") if tag == "script" else None

    def handle_endtag(self, tag):
        self._in_script = None if tag == "script" else self._in_script

    def handle_data(self, data):
        if self._in_script == "study-data":
            self.json += data
        elif self._in_script is None:
            self.text += data


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A whole run of gratings, its RA-I afferents heard, with its report."""
    folder = tmp_path_factory.mktemp("run")
    what = make_study(baselines="linear", as_shipped=True)
    make_run(what, folder, grating_conditions())
    named = {"dataset": "mixed", "classifier": "logistic regression", "input": "signals: mean and deviation",
             "t_ref_ra_ms": None, "t_ref_sa_ms": None, "settings": "C 1"}  # fmt: skip
    measured = {"accuracy_validation": 0.5, "accuracy_test": 0.456, "macs": 100.0, "flops": 200.0, "parameters": 9,
                "energy_estimate_nJ": 0.46}  # fmt: skip
    pd.DataFrame([{**named, **measured}]).to_csv(folder / "baselines.csv", index=False)
    return networks.write(what, folder)


@pytest.fixture(scope="module")
def rivalled(tmp_path_factory):
    """A run whose networks are as accurate as a rival."""
    folder = tmp_path_factory.mktemp("rivalled")
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [1, 5], [10, 10]], "network.hidden": [20, 30]}
    what = make_study(baselines="linear", claims=(), sweep={**sweep, "seed": [0, 1]},
                      dataset={**GRATINGS, "subsets": {"mixed": {}}})  # fmt: skip
    make_run(what, folder, grating_conditions())
    row = {"dataset": "mixed", "classifier": "logistic regression", "input": "signals: mean and deviation",
           "t_ref_ra_ms": None, "t_ref_sa_ms": None, "settings": "C 1", "accuracy_validation": 0.88,
           "accuracy_test": 0.9, "macs": 100.0, "flops": 200.0, "parameters": 9}  # fmt: skip
    pd.DataFrame([row | {"energy_estimate_nJ": 0.46}]).to_csv(folder / "baselines.csv", index=False)
    return networks.write(what, folder)


@pytest.fixture
def text_alone(monkeypatch):
    without_pictures(monkeypatch)


def energies_of(folder: Path) -> list[float]:
    """Of the rows of ledger.csv, of the networks and of the baselines on the page."""
    answer = json.dumps(json.loads((folder / "answer.json").read_text()))
    shown = [float(number) for number in re.findall(r'"(?:nJ|energy_nJ)": ([0-9.e+-]+)', answer)]
    return [*pd.read_csv(folder / "ledger.csv")["energy_estimate_nJ"], *shown]


def test_a_report_prices_networks_and_baselines_by_the_list_of_its_study(written, text_alone, tmp_path):
    folder, what = tmp_path / "run", {"baselines": "linear", "as_shipped": True}
    shutil.copytree(written.parent, folder)
    networks.write(make_study(**what, prices=ARITHMETIC_45NM), folder)
    before = energies_of(folder)
    both = {"multiplication_pJ": 2 * 3.7, "addition_pJ": 2 * 0.9}
    twice = PriceList(name="twice", source="a test", **both)
    page = networks.write(make_study(**what, prices=twice), folder)
    assert energies_of(folder) == pytest.approx([2 * nJ for nJ in before])
    assert "by the price list twice: 9.2 pJ per MAC" in page.read_text()
    assert set(pd.read_csv(folder / "ledger.csv")["prices"]) == {"twice"}
    details = [one["details"] for one in read_json(folder / "answer.json")["answers"]]
    assert all("Energies are by the price list twice." in one for one in details)


def test_the_ledger_has_each_baseline_on_spikes_at_its_own_refractory_periods(tmp_path, text_alone):
    pairs = [[1, 1], [10, 10]]
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": pairs, "encoder.tau_mem_ms": [5.0, 20.0]}
    what = make_study(baselines="linear", claims=(), sweep={**sweep, "network.hidden": [20]})
    make_run(what, tmp_path, grating_conditions())
    row = {"dataset": "mixed", "classifier": "SVM", "settings": "C 1", "accuracy_validation": 0.5, "flops": 9.0,
           "accuracy_test": 0.4, "energy_estimate_nJ": 0.46}  # fmt: skip
    rows = [{**row, "input": "signals: x", "macs": 3.0}]
    for n, (ms, tau_ms) in enumerate([(1, 5.0), (1, 20.0), (10, 5.0), (10, 20.0)]):
        own = {"input": "spikes: counts", "t_ref_ra_ms": ms, "t_ref_sa_ms": ms, "encoder.tau_mem_ms": tau_ms}
        rows += [{**row, **own, "macs": 100.0 * n}] * 2
    pd.DataFrame(rows).to_csv(tmp_path / "baselines.csv", index=False)
    networks.write(what, tmp_path)
    ledger = pd.read_csv(tmp_path / "ledger.csv").set_index("name")["macs"]
    assert ledger[ledger.index.str.startswith("SVM")].to_dict() == {
        "SVM on signals: x": 3.0,
        "SVM on spikes: counts, t_ref 1&1 ms, tau mem 5 ms": 0.0,
        "SVM on spikes: counts, t_ref 1&1 ms, tau mem 20 ms": 100.0,
        "SVM on spikes: counts, t_ref 10&10 ms, tau mem 5 ms": 200.0,
        "SVM on spikes: counts, t_ref 10&10 ms, tau mem 20 ms": 300.0,
    }


def test_a_report_shows_the_first_line_of_the_bill_of_its_run(written, text_alone, tmp_path):
    folder, line = tmp_path / "run", "On an emulated Cortex-M0 the network takes 7 times the instructions."
    shutil.copytree(written.parent, folder)
    assert line not in written.read_text()
    (folder / "bill").mkdir()
    (folder / front.BILL).write_text(f"{line}\nOn another.\n")
    networks.write(make_study(baselines="linear", as_shipped=True), folder)
    told = [one["details"] for one in read_json(folder / "answer.json")["answers"]]
    assert all(line in details and "On another." not in details for details in told)


def test_the_report_needs_nothing_from_the_network(written):
    text = written.read_text()
    assert not re.search(r"(src|href|url\()\s*=?\s*[\"']?\s*(https?:)?//", text)
    for link in Page(written).links:
        assert link.startswith(("data:", "#")) or (written.parent / link).is_file(), link


def test_links_inside_the_page_lead_somewhere_and_ids_are_unique(written):
    page = Page(written)
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)


def test_each_figure_is_in_the_page_with_its_text_and_beside_it_twice(written):
    page = Page(written)
    names = [
        "rasters", "spike-counts", "rates", "isis", "accuracy-and-sops", "trade-off", "confusion", "training",
    ]  # fmt: skip
    assert [i.removeprefix("figure-") for i in page.ids if i.startswith("figure-")] == names
    assert all(image["alt"] and image["src"].startswith("data:image/svg+xml;base64,") for image in page.images)
    found = {path.name for path in (written.parent / "figures").iterdir()}
    assert found == {f"{name}{suffix}" for name in names for suffix in (".svg", ".png")}


def test_each_claim_is_told_with_its_verdict(written):
    text = Page(written).text
    assert "1 of 3 claims reproduced; 1 holds for a baseline too; 1 need cells that this run does not hold" in text
    assert "✗ no: holds for a baseline too" in text
    assert re.search(r"✓ yes, p [=<] 0\.\d+", text)
    for claim in CLAIMS[:2]:
        assert claim.name in text
        assert claim.rule in text
    assert CLAIMS[2].rule not in text
    assert "✗ no: Chance & noise." in text
    assert "no: Untold." not in text
    assert text.count("✗ no") == 2


def test_an_answer_has_the_same_bytes_in_any_place_and_commands_of_its_own(written, text_alone, tmp_path):
    folder = tmp_path / "my runs" / "copy"
    shutil.copytree(written.parent, folder)
    networks.write(make_study(baselines="linear", as_shipped=True), folder)
    assert (folder / "answer.json").read_bytes() == (written.parent / "answer.json").read_bytes()
    commands = [command for one in nt.study_answer(folder)["answers"] for command in one["next"]["commands"]]
    assert commands
    assert all(str(folder) in word for command in commands for word in shlex.split(command) if "/" in word)


def test_the_next_step_knows_what_the_encoding_loses_and_is_the_only_one(written, text_alone, tmp_path, monkeypatch):
    folder = tmp_path / "copy"
    shutil.copytree(written.parent, folder)
    monkeypatch.setattr(sentences, "lost_in_encoding", lambda outcome: f"lost by {outcome.best.name}")
    told_few = []
    monkeypatch.setattr(period_choice, "next_step", lambda *given, few: told_few.append(few) or (given[3], []))
    networks.write(make_study(baselines="linear", as_shipped=True), folder)
    answer = read_json(folder / "answer.json")
    assert told_few == [one["kind"] == "too few trials" for one in answer["answers"]]
    told = [one["next"]["words"] for one in answer["answers"]]
    assert told
    assert all(re.fullmatch(r"lost by .* with \d+ neurons", words) for words in told)


def test_a_warning_of_few_test_trials_says_what_to_do_where_no_next_step_does():
    few = front.Front("all", SimpleNamespace(is_above_chance=True), (), (), (), sides=front.Sides(None, {"felt": 2}))
    (alone,), (beside,) = (
        [*front._of_front(one, SimpleNamespace())] for one in (few, few._replace(next=("Train more:", [])))
    )
    assert alone == f"{beside}; record more, or test every trial once with `split=nt.Split(folds=5)`"


@given(st.text("ab c'-&$", min_size=1, max_size=5), st.text("ab c'", min_size=1, max_size=5))
def test_commands_move_with_their_study_and_its_recordings(name, file):
    run, recordings = f"/runs/{name}", f"/data/{file}.h5"
    command = shlex.join(["neurotact", "save", f"{run}/cells/1", "--recordings", recordings, "-o", f"{run}-saved"])
    kept = store.moved(command, {recordings: store.RECORDINGS, run: store.STUDY})
    assert kept == "neurotact save STUDY/cells/1 --recordings RECORDINGS -o STUDY-saved"
    assert store.moved(kept, {store.STUDY: run, store.RECORDINGS: recordings}) == command


@pytest.mark.thorough
@pytest.mark.usefixtures("text_alone")
def test_reasons_are_those_of_the_study_as_it_ships_alone(tmp_path):
    what = make_study()
    text = Page(networks.write(what, make_run(what, tmp_path, grating_conditions()))).text
    assert "✗ no" in text
    assert (
        "Chance & noise."
        not in text.partition("Downloads")[0].partition("Published and our results")[2].partition("Whole study")[0]
    )


def test_what_was_run_is_told(written):
    text = Page(written).text
    assert "A study of <gratings>" in text
    assert "0" * 64 in text
    assert "torch" in text
    assert "t_ref_ms" in text
    assert "24 cells took 1 min 24 s" in text
    assert "45.6" in text


def test_heads_of_tables_have_a_scope(written):
    assert set(Page(written).heads) == {"col", "row"}


def test_tables_hold_the_numbers(written):
    results = _results(written.parent)
    table = networks.means_table(results, make_study())
    assert len(table.rows) == 12
    rows = results[(results["dataset"] == "mixed") & (results["pair"] == "1&5") & (results["hidden"] == 30)]
    (shown,) = [row for row in table.rows if row[:3] == ["mixed", "1&5", "30"]]
    accuracy = 100 * rows["accuracy_test"]
    assert shown[5] == f"{accuracy.mean():.1f} ± {accuracy.std():.1f}"
    assert Page(written).text.count("10&10") > 4


def test_the_row_of_a_network_tells_which_pair_of_conditions_it_tests():
    sweep = {
        "split.test_where.force_N & split.test_where.speed_mm_per_s": [[3.0, 8.6], [3.0, 13.7], [12.0, 8.6]],
        "seed": [0],
    }
    what = make_study(sweep=sweep, claims=())
    rows = [
        row_of(cell, np.random.default_rng(0))
        | {"early_ms": 1.0}
        | {f"split.test_where.{column}": value for column, value in cell.split.test_where.items()}
        for cell in study.cells(what)
    ]
    results = tables.with_setting(tables.with_pair(pd.DataFrame(rows), what), what)
    heads = [*networks.network_columns(what).values()]
    shown = [[entry.text for entry in row] for row in networks.networks_table(results, what)]
    assert {len(row) for row in shown} == {len(heads)}
    places = [heads.index(head) for head in ("tested force (N)", "tested speed (mm/s)")]
    assert [[row[place] for place in places] for row in shown] == [["3.0", "8.6"], ["3.0", "13.7"], ["12.0", "8.6"]]


def test_neurons_that_a_network_does_not_count_are_said_not_to_be():
    what, own = make_study(), {"hidden": 0, OWN_KEYS: '{"model": "mine"}', "early_ms": 1.0}
    rows = pd.DataFrame([row_of(cell, np.random.default_rng(0)) | own for cell in study.cells(what)])
    results = tables.with_setting(tables.with_pair(rows, what), what)
    assert {row[2] for row in networks.means_table(results, what).rows} == {"not counted"}
    place = [*networks.network_columns(what)].index("hidden")
    assert {row[place].text for row in networks.networks_table(results, what)} == {"not counted"}
    assert all(", N not counted, " in details.cell_name(row) for _, row in results.iterrows())
    first = over_seeds(results, ["accuracy_test"]).iloc[0]
    assert (sized(first), in_words_of_size(first, '{"model": "mine"}')) == ("N not counted", "N not counted")


def test_settings_are_named_by_what_is_swept_and_encoders_by_their_specs():
    what = make_study(sweep={"encoder & t_ref_ms": [["sa1-ra1-lif", 5.0], ["send-on-delta", 5.0]], "seed": [0]})
    rows = pd.DataFrame({"dataset": ["all", "all"], "encoder": ["lif", "send-on-delta"]})
    rows = rows.assign(t_ref_ra_ms=5.0, t_ref_sa_ms=5.0)
    assert tables.with_setting(rows, what)["setting"].tolist() == ["encoder sa1-ra1-lif", "encoder send-on-delta"]
    several = pd.concat([rows, rows.assign(dataset="one speed")])
    assert tables.with_setting(several, what)["setting"].iloc[0] == "all, encoder sa1-ra1-lif"
    assert {*tables.with_setting(rows, make_study())["setting"]} == {"all"}


@pytest.mark.thorough
def test_the_same_run_gives_the_same_report(written):
    before = written.read_bytes()
    assert networks.write(make_study(baselines="linear", as_shipped=True), written.parent).read_bytes() == before


@pytest.mark.thorough
def test_one_seed_and_a_silent_population(tmp_path):
    what = make_study()
    what = what.model_copy(update={"sweep": {**what.sweep, "seed": [0]}})
    page = Page(networks.write(what, make_run(what, tmp_path, grating_conditions(), silent_ra=True)))
    assert "by pair and hidden size N" in page.text
    assert "mean ± SD over 1 seed" not in page.text
    assert "±" not in "".join(cell for row in networks.means_table(_results(tmp_path), what).rows for cell in row)


@pytest.mark.thorough
@pytest.mark.usefixtures("text_alone")
def test_the_report_shows_the_encoder_that_was_calibrated(tmp_path):
    what = make_study()
    folder = make_run(what, tmp_path, grating_conditions())
    assert "calibrated on the training" not in Page(networks.write(what, folder)).text
    fitted = what.model_copy(update={"calibrate": True})
    trains = SimpleNamespace(encoder={"unit": "kPa", "sa1": {"gain": 7.2, "grades": None}})
    shown = networks._specs(fitted, trains)
    assert shown[networks.CALIBRATED] == 'unit = "kPa"\n\n[sa1]\ngain = 7.2\n'
    assert "Encoder" not in shown


@thinned("keep", ["both", "loss"])
def test_the_epoch_that_was_kept_is_the_one_that_is_told(tmp_path, keep):
    """An epoch of a low loss that has learned nothing is not the one that `both` keeps."""
    what = make_study()
    cell = next(study.cells(what))
    network = cell.network.model_copy(update={"training": cell.network.training.model_copy(update={"keep": keep})})
    cell = cell.model_copy(update={"network": network})
    log = pd.DataFrame([Epoch(1, 2.0, 0.1, 1.5, 0.67), Epoch(2, 0.1, 1.0, 1.9, 0.56)])
    path = cell_folder(tmp_path, cell) / "training.csv"
    path.parent.mkdir(parents=True)
    log.to_csv(path, index=False)
    assert kept_epoch(tmp_path, cell) == {"loss": 1, "both": 2}[keep]


@pytest.mark.usefixtures("text_alone")
@thinned("n_done", [1, 14])
def test_a_run_that_is_not_complete_says_so(tmp_path, n_done):
    what = make_study()
    page = Page(networks.write(what, make_run(what, tmp_path, grating_conditions(), n_done=n_done)))
    assert f"{n_done} of 24" in page.text


@pytest.mark.usefixtures("text_alone")
@thinned("stratify", [["finger"], []])
def test_other_touch_than_gratings(tmp_path, stratify):
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 10]], "network.hidden": [30]}
    what = make_study(dataset={"file": "fabrics.h5", "stratify": stratify}, sweep=sweep, claims=())
    conditions = pd.DataFrame({"label": ["felt", "None"] * 4, "finger": ["left"] * 4 + ["right"] * 4})
    page = Page(networks.write(what, make_run(what, tmp_path, conditions)))
    assert "felt" in page.text
    assert "claims" not in page.ids


@pytest.mark.thorough
@pytest.mark.usefixtures("text_alone")
def test_a_reason_that_claims_share_stands_once(tmp_path):
    claims = tuple(CLAIMS[1].model_copy(update={"name": name, "why": "Shared & told once."}) for name in ("a", "b"))
    what = make_study(claims=(*claims, CLAIMS[1]), as_shipped=True)
    page = Page(networks.write(what, make_run(what, tmp_path, grating_conditions())))
    claims_told = page.text.partition("Published and our results")[2].partition("Figures")[0]
    assert claims_told.count("Shared & told once.") == 1
    assert claims_told.count("reason 1") == 2
    assert "reason-1" in page.ids
    assert "no: Chance & noise." in " ".join(claims_told.split())


@pytest.mark.thorough
@pytest.mark.usefixtures("text_alone")
def test_another_swept_key_tells_its_networks_apart(tmp_path):
    sweep = {"window.length_ms": [50.0, 100.0], "network.hidden": [20]}
    what = make_study(sweep=sweep, claims=())
    text = Page(networks.write(what, make_run(what, tmp_path, grating_conditions()))).text
    assert "v1 mix, window length 50 ms" in text


@pytest.mark.thorough
@pytest.mark.usefixtures("text_alone")
def test_splits_are_averaged_as_seeds_are(tmp_path):
    sweep = {"network.hidden": [20], "split.seed": [0, 1]}
    what = make_study(sweep=sweep, claims=(), split={"seed": 0, "validation": 0.25, "test": 0.25})
    page = Page(networks.write(what, make_run(what, tmp_path, grating_conditions(trials=5))))
    (answer,) = read_json(tmp_path / "answer.json")["answers"]
    (network,) = answer["networks"]
    results = pd.read_csv(tmp_path / "results.csv")
    assert network["seeds"] == 2
    assert network["whole"]["accuracy"] == pytest.approx(results["accuracy_test"].mean())
    trains = [load_spikes(tmp_path / cell.given) for cell in study.cells(what)]
    parts = [tasks.trials_of(one, task_of(cell)) for one, cell in zip(trains, study.cells(what), strict=True)]
    tested = [part.test for part in parts]
    assert set(tested[0]) != set(tested[1])
    assert answer["test_trials"] == len({*tested[0], *tested[1]})
    assert "Means over seeds and splits" in page.text
    assert all(f"split seed {seed}" in page.json for seed in (0, 1))


def test_a_baseline_is_the_mean_of_those_of_each_split():
    made = {"dataset": "all", "classifier": "SVM", "input": "signals: counts", "t_ref_ra_ms": None, "t_ref_sa_ms": None}
    shares = [{"accuracy_validation": 0.5, "accuracy_test": 0.6}, {"accuracy_validation": 0.7, "accuracy_test": 0.8}]
    table = pd.DataFrame([{**made, "split.fold": n, **two, "energy_estimate_nJ": 2.0} for n, two in enumerate(shares)])
    (found,) = front.baselines_of(make_study(), {"baselines": table}, {"dataset": "all"})
    assert found == front.Baseline("SVM on signals (counts)", 0.6, pytest.approx(0.7), 2.0, rows=(0, 1))
    uncounted = table.assign(energy_estimate_nJ=float("nan"))
    assert front.baselines_of(make_study(), {"baselines": uncounted}, {"dataset": "all"})[0].nJ is None


def test_a_study_that_sweeps_its_windows_by_any_key_compares_no_baselines():
    """Baselines have the windows of the first cell alone."""
    made = {"dataset": "all", "classifier": "SVM", "input": "signals: counts", "t_ref_ra_ms": None, "t_ref_sa_ms": None}
    table = pd.DataFrame([{**made, "accuracy_validation": 0.5, "accuracy_test": 0.6, "energy_estimate_nJ": 2.0}])
    joined = {"window.length_ms & network.hidden": [[50.0, 20], [100.0, 30]]}
    for sweep, n in (({"window.start_ms": [0.0, 100.0]}, 0), (joined, 0), ({"network.hidden": [20, 30]}, 1)):
        what = make_study(sweep=sweep, claims=())
        assert len(front.baselines_of(what, {"baselines": table}, {"dataset": "all"})) == n


@pytest.mark.usefixtures("text_alone")
def test_what_copies_gain_is_told_of_each_data_set_apart(tmp_path):
    sweep = {"dataset": ["v1 mix", "mixed"], "network.hidden": [20], "seed": [0]}
    what = make_study(sweep=sweep, claims=(), augmentation={"kind": "none"})
    make_run(what, tmp_path, grating_conditions())
    rows = pd.read_csv(tmp_path / "results.csv")[["dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed"]]
    told = {"augmentation": "none", "accuracy_validation": 0.9, "sops_total": 1.0, "n_train": 9, "chosen": True}
    seen, unseen = [0.9, 0.7], [0.8, 0.4]
    remedies = rows.assign(**told, last=True, accuracy_seen=seen, accuracy_test=unseen)
    remedies.to_csv(tmp_path / "remedies.csv", index=False)
    networks.write(what, tmp_path)
    answers = read_json(tmp_path / "answer.json")["answers"]
    said = [line for one in answers for line in one["details"] if line.startswith("At untrained conditions")]
    assert ["80.0 %" in said[0], "40.0 %" in said[1]] == [True, True]
    assert "60.0" not in "".join(said)


@pytest.mark.usefixtures("text_alone")
def test_trials_are_those_of_the_recordings_of_each_answer(tmp_path, monkeypatch):
    """A sweep of the simulation may make more trials, of which more are tested."""
    sweep = {"dataset.parameters.trials": [4, 8], "network.hidden": [20]}
    what = make_study(sweep=sweep, claims=(), dataset={**GRATINGS, "subsets": {"mixed": {}}})
    make_run(what, tmp_path, grating_conditions(trials=4))
    more = make_trains(grating_conditions(trials=8), next(study.cells(what)), 400.0, 0.6, False)
    monkeypatch.setattr(front, "first_spikes", lambda _, own: more if own[0].source["parameters"]["trials"] == 8 else 0)
    networks.write(what, tmp_path)
    one, other = (answer["test_trials"] for answer in read_json(tmp_path / "answer.json")["answers"])
    assert one < other


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"results\.csv.*no such file"):
        networks.write(make_study(), tmp_path)


def test_texts_are_downloaded_from_the_page_itself(written):
    downloads = Page(written).downloads
    for name in ("results.csv", "results.json", "sops.csv", "sops.json", "sops.md", "encoding.csv", "study.toml"):
        kind, _, content = downloads[name].partition(";base64,")
        assert kind.startswith("data:")
        assert b64decode(content) == (written.parent / name).read_bytes()


def test_results_as_json_are_those_of_the_csv(written):
    table = pd.read_csv(written.parent / "results.csv")
    assert read_json(written.parent / "results.json") == table.to_dict("records")


def test_the_sop_report_is_the_same_in_three_forms_and_adds_up(written):
    table = pd.read_csv(written.parent / "sops.csv")
    keys, input_spikes = ["dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed"], ["spikes_sa", "spikes_ra"]
    assert list(table.columns) == [*keys, *SOPS_COLUMNS[:2], *input_spikes, *SOPS_COLUMNS[2:]]
    assert len(table) == 24
    assert read_json(written.parent / "sops.json") == table.to_dict("records")
    assert (written.parent / "sops.md").read_text().count("\n|") == 26
    assert np.allclose(table.sops_total, table.sops_input + table.sops_recurrent + table.sops_readout)
    assert (table.exit_sops_input < table.sops_input.max()).all()


def test_the_page_knows_of_each_cell_what_its_network_does(written):
    """One cell by hand: its raster is the network's."""
    data = json.loads(Page(written).json)
    cells = list(study.cells(make_study()))
    assert [cell["row"]["seed"] for cell in data["cells"]] == [cell.seed for cell in cells]
    assert data["cells"][23]["name"] == "mixed, t_ref 10&10 ms, N = 30, seed 1"
    assert (data["pairWord"], data["populations"]) == ("t_ref RA-I & SA-I", ["SA-I", "RA-I"])
    shown, place = data["cells"][23], cell_folder(written.parent, cells[23])
    restored = run_folder.restore(place)
    trains = load_spikes(restored.spikes_path)
    raster = shown["raster"]
    trial, windows = tasks.examples_of(trains, np.array([raster["trial"]]), restored.task)
    first = round(raster["start_ms"] * 1e-3 * trains.sampling_rate_Hz) == windows.start
    with torch.no_grad():
        spikes = restored.network.simulate(trial.spikes[first])
    assert [list(np.flatnonzero(neuron)) for neuron in spikes.hidden[0].numpy().T] == raster["hidden"]
    assert sum(map(len, raster["input"])) == trial.spikes[first].sum()
    assert sum(map(len, raster["readout"])) == spikes.readout.sum()
    assert len({cell["raster"]["trial"] for cell in data["cells"] if cell["setting"] == "mixed"}) == 1


@pytest.mark.thorough
@pytest.mark.usefixtures("text_alone")
def test_without_its_networks_a_run_is_still_reported(tmp_path):
    what = make_study()
    make_run(what, tmp_path, grating_conditions())
    for path in tmp_path.glob("cells/*/network.json"):
        path.unlink()
    data = json.loads(Page(networks.write(what, tmp_path)).json)
    assert not any("raster" in cell for cell in data["cells"])
    assert all(cell["training"] for cell in data["cells"])


@pytest.mark.usefixtures("text_alone")
def test_a_name_cannot_leave_the_script_that_holds_it(tmp_path):
    name = "</script><script>alert('&')</script>"
    sweep = {"dataset": [name], "network.hidden": [20]}
    what = make_study(dataset={**GRATINGS, "subsets": {name: {}}}, sweep=sweep, claims=())
    page = Page(networks.write(what, make_run(what, tmp_path, grating_conditions())))
    assert json.loads(page.json)["cells"][0]["setting"] == name
    assert not page.handlers


def _results(folder: Path) -> pd.DataFrame:
    return tables.with_setting(tables.with_pair(pd.read_csv(folder / "results.csv"), make_study()), make_study())


CHOSEN = "document.getElementById('cell-name').textContent"
DRAWN = "document.querySelector('#plot .points path')"


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("chromium") / "profile") as opened:
        yield opened


def assert_quiet(chromium, page: Path):
    assert chromium.complaints == []
    asked = {url for url in chromium.requests if not url.startswith(("data:", "blob:"))}
    assert asked == {page.as_uri()}


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(400, "dark"), (1400, "light")])
def test_in_a_browser_a_point_is_clicked_and_its_network_shown(chromium, written, width, scheme):
    chromium.open(written, width, scheme=scheme)
    chromium.wait_for(DRAWN)
    assert chromium.evaluate("document.documentElement.scrollWidth") <= width
    assert chromium.evaluate("document.getElementById('one').value !== document.getElementById('other').value")
    # The first point of the first pair's trace: a cell of the data set that is shown.
    place = chromium.evaluate(
        "(() => { const host = document.getElementById('plot'); host.scrollIntoView();"
        "const at = host.data.findIndex((trace) => trace.customdata?.length);"
        "const { left, top } = host.getBoundingClientRect(), { xaxis, yaxis } = host._fullLayout;"
        "return [host.data[at].customdata[0], left + xaxis._offset + xaxis.d2p(host.data[at].x[0]),"
        "top + yaxis._offset + yaxis.d2p(host.data[at].y[0])]; })()"
    )
    chromium.click(*place[1:])
    cell = json.loads(Page(written).json)["cells"][place[0]]
    chromium.wait_for(f"{CHOSEN} === {json.dumps(cell['name'])}")
    assert chromium.evaluate("document.querySelectorAll('#cell svg').length") == 3
    assert chromium.evaluate("document.querySelectorAll('#cell-confusion tbody tr').length") == 4
    ledger = chromium.evaluate("document.querySelector('#cell-sops').textContent")
    assert f"{cell['row']['sops_total']:,.0f}" in ledger
    assert_quiet(chromium, written)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(400, "dark"), (1400, "light")])
def test_in_a_browser_a_report_is_accessible(chromium, written, width, scheme):
    chromium.open(written, width, scheme=scheme)
    chromium.wait_for(DRAWN)
    chromium.assert_accessible()


OVER = """(() => {
  const boxes = (parts) => [...document.querySelectorAll(parts)].map((part) => part.getBoundingClientRect());
  const meet = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const names = boxes("#plot .annotation-text");
  return [names.length, names.filter((name) => boxes("#plot .points path").some((mark) => meet(name, mark))).length];
})()"""


@pytest.mark.slow
@pytest.mark.parametrize("width", [400, 1400])
@pytest.mark.parametrize("cost", ["sops", "ms", "nJ", "spikes"])
def test_in_a_browser_a_line_has_the_name_of_the_verdict_and_no_mark_in_it(chromium, rivalled, width, cost):
    chromium.open(f"{rivalled.as_uri()}#cost={cost}", width)
    chromium.wait_for(f"{DRAWN} && document.querySelector('#plot .annotation-text')")
    name = chromium.evaluate("document.getElementById('plot').layout.annotations[0].text")
    assert "logistic regression on signals (mean and deviation) 90.0" in name.replace("<br>", " ")
    assert "logistic regression on signals (mean and deviation): 90.0" in Page(rivalled).text.replace("\xa0", " ")
    assert chromium.evaluate(OVER) == [1, 0]


OVER_LINES = """(() => {
  const names = [...document.querySelectorAll("#plot .annotation-text")].map((part) => part.getBoundingClientRect());
  const points = [...document.querySelectorAll("#plot .scatterlayer .lines path")].flatMap((path) => {
    const n = Math.ceil(path.getTotalLength() / 2), place = path.getScreenCTM();
    return Array.from({ length: n + 1 }, (_, i) => path.getPointAtLength(2 * i).matrixTransform(place));
  });
  return names.filter(({ left, right, top, bottom }) =>
    points.some(({ x, y }) => left < x && x < right && top < y && y < bottom)).length;
})()"""


@pytest.mark.slow
@pytest.mark.parametrize("width", [400, 1400])
def test_in_a_browser_the_name_of_a_line_along_the_front_hides_neither_marks_nor_the_front(
    chromium, rivalled, width, tmp_path
):
    """The front rises around the rival's line from one end of the picture to the other."""
    data = json.loads(Page(rivalled).json)
    front = next(iter(data["fronts"].values()))
    one, level = front["networks"][front["best"]], front["beside"]["accuracy"]
    around = [{"accuracy": level + 0.001 * (at - 30), "nJ": 100.0 + 10 * at} for at in range(60)]
    around += [{"accuracy": level - 0.004 + 0.008 * (at % 2), "nJ": 100.0 + 10 * at} for at in range(60)]
    front["networks"] = [one | {"early": None, "whole": one["whole"] | reached} for reached in around]
    front |= {"best": 59, "used": "whole", "cost": "nJ", "guess": 0.0}
    page, (before, _, after) = tmp_path / "report.html", rivalled.read_text().partition(Page(rivalled).json)
    page.write_text(before + json.dumps(data) + after)
    chromium.open(f"{page.as_uri()}#cost=nJ", width)
    chromium.wait_for(f"{DRAWN} && document.querySelector('#plot .annotation-text')")
    assert chromium.evaluate(OVER) == [1, 0]
    assert chromium.evaluate(OVER_LINES) == 0
    assert_quiet(chromium, page)


@pytest.mark.slow
@pytest.mark.parametrize("width", [400, 1400])
def test_in_a_browser_encoders_side_by_side_have_names_that_hide_nothing(chromium, rivalled, width, tmp_path):
    data = json.loads(Page(rivalled).json)
    setting, front = next(iter(data["fronts"].items()))
    one, names = front["networks"][front["best"]], [f"encoder-{at}, 10&10 ms" for at in range(13)]
    crowded = [
        {"accuracy": 0.91 + 0.02 * (at % 5), "nJ": 90.0 + 30.0 * (at % 7) + 900.0 * (at > 9)} for at in range(13)
    ]
    networks = [
        one | {"used": "whole", "early": None, "series": name, "label": name, "whole": one["whole"] | reached}
        for name, reached in zip(names, crowded, strict=True)
    ]
    of = dict(zip([setting, *map(str, range(12))], names, strict=True))
    every = front | {"networks": networks, "best": 0, "used": "whole", "of": of, "cost": "nJ", "scale": "log"}
    data["fronts"] = {"every encoder": every} | data["fronts"]
    page, (before, _, after) = tmp_path / "report.html", rivalled.read_text().partition(Page(rivalled).json)
    page.write_text(before + json.dumps(data) + after)
    chromium.open(page, width)
    chromium.wait_for(f"{DRAWN} && document.querySelector('#plot .annotation-text')")
    shown = chromium.evaluate("document.getElementById('plot').layout.annotations.map((one) => one.text)")
    told = {text.replace("<br>", " ").replace("&amp;", "&") for text in shown}
    items = "#plot + ol:not([hidden]) li"
    listed = chromium.evaluate(f"[...document.querySelectorAll('{items}')].map((one) => one.innerText)")
    assert {*names} <= (told if width == 1400 else {*listed})
    assert {str(at + 1) for at in range(len(listed))} <= told
    assert len(listed) == (0 if width == 1400 else len(names))
    assert chromium.evaluate(APART) == [len(shown), 0, 0]
    assert len(shown) == len(names) + 1  # the rival
    assert chromium.evaluate("document.querySelectorAll('#plot .legend .traces').length") <= 3
    assert_quiet(chromium, page)


@pytest.mark.slow
def test_in_a_browser_a_window_of_another_size_keeps_the_whole_picture(chromium, rivalled):
    chromium.open(rivalled, 1400)
    chromium.wait_for(DRAWN)
    for width, height in ((400, 900), (400, 1200), (1400, 900)):
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        chromium.call("Emulation.setDeviceMetricsOverride", **size)
        plot = "document.getElementById('plot')"
        chromium.wait_for(f"Math.abs({plot}._fullLayout.width - {plot}.clientWidth) < 2")
        chromium.wait_for(f"{plot}._fullLayout.height === {plot}.clientHeight && {plot}.clientHeight > 440")
        chromium.wait_for("document.querySelector('#plot .annotation-text')")
        assert chromium.evaluate(OVER) == [1, 0]


@pytest.mark.slow
@pytest.mark.parametrize("folded", [False, True])
def test_in_a_browser_no_table_of_the_answer_is_wider_than_a_phone(chromium, rivalled, folded):
    chromium.open(rivalled, 400)
    chromium.wait_for(DRAWN)
    opened = f"document.querySelectorAll('#answer details').forEach((one) => {{ one.open = {str(folded).lower()}; }})"
    chromium.evaluate(opened)
    widths = "[...document.querySelectorAll('#answer .scroll')].map((one) => one.scrollWidth - one.clientWidth)"
    assert set(chromium.evaluate(widths)) == {0}


@pytest.mark.slow
@pytest.mark.parametrize("width", [400, 1400])
def test_in_a_browser_names_of_a_legend_end_before_the_next_column(chromium, rivalled, width):
    chromium.open(rivalled, width)
    chromium.wait_for(DRAWN)
    ends = (
        "[...document.querySelectorAll('#plot .legend .traces')].map((entry) => {"
        "const text = entry.querySelector('.legendtext').getBoundingClientRect();"
        "return [text.left, text.right, text.top, text.bottom]; })"
    )
    entries = chromium.evaluate(ends)
    assert len(entries) > 4
    for left, right, top, bottom in entries:
        beside = [one[0] for one in entries if one[0] > left and one[2] < bottom and top < one[3]]
        assert right < min([*beside, float(width)])
    lefts = sorted(entry[0] for entry in entries)
    assert sum(left - before > 2 for before, left in pairwise(lefts)) == 1  # two columns, each to the pixel


@pytest.mark.slow
def test_in_a_browser_the_keyboard_sorts_the_table_and_shows_a_network(chromium, written):
    chromium.open(written, 1400)
    chromium.wait_for(DRAWN)
    head = "document.querySelector('#networks thead th:nth-child(6)')"
    column = "[...document.querySelectorAll('#networks tbody td:nth-child(6)')].map((cell) => Number(cell.textContent))"
    chromium.evaluate(f"{head}.querySelector('button').focus()")
    for direction, is_reversed in (("ascending", False), ("descending", True)):
        chromium.press("Enter")
        assert chromium.evaluate(f"{head}.getAttribute('aria-sort')") == direction
        values = chromium.evaluate(column)
        assert values == sorted(values, reverse=is_reversed)
    for _ in range(5):  # four more heads, then the one row that Tab reaches
        chromium.press("Tab")
    assert chromium.evaluate("document.activeElement.localName") == "tr"
    chromium.press("ArrowUp")
    index = chromium.evaluate("document.activeElement.dataset.cell")
    chromium.press("Enter")
    assert chromium.evaluate(CHOSEN) == json.loads(Page(written).json)["cells"][int(index)]["name"]
    assert chromium.evaluate("document.activeElement.id") == "cell-name"
    assert_quiet(chromium, written)


@pytest.mark.slow
def test_a_browser_that_cannot_unpack_the_library_still_shows_networks(chromium, written):
    script = chromium.call("Page.addScriptToEvaluateOnNewDocument", source="delete window.DecompressionStream")
    chromium.open(written, 1400)
    chromium.wait_for("!document.getElementById('plot-note').hidden")
    chromium.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script["identifier"])
    assert "cannot draw the points" in chromium.evaluate("document.getElementById('plot-note').textContent")
    chromium.evaluate("document.querySelector('#networks tbody tr').click()")
    assert chromium.evaluate(CHOSEN) == json.loads(Page(written).json)["cells"][0]["name"]


def test_the_first_screen_answers(written):
    html = Page(written)
    text = " ".join(html.text.split())
    answer = nt.study_answer(written.parent)
    assert [one["dataset"] for one in answer["answers"]] == ["v1 mix", "mixed"]
    for one in answer["answers"]:
        assert f"{one['dataset']}: {one['short']}." in text.replace("\xa0", " ")
        assert one["headline"].partition(": ")[2].removeprefix("t") in text.replace("\xa0", " ")
        for figure in one["figures"]:
            assert f"{figure['what']}{figure['value']}{figure['of']}" in text.replace("\xa0", " ")
        rows = [network for network in one["networks"] if network["pair"] == "1&1"]
        assert {row["hidden"] for row in rows} == {20, 30}
        # 300 steps of 2.5 ms; early exit after 220 of them
        assert all(row["whole"]["ms"] == 750.0 and row["early"]["ms"] == 550.0 for row in rows)
        best = one["networks"][one["best"]]
        assert best["low"] < best["whole"]["accuracy"] < best["high"]
        assert one["best"] == one["cheapest"]
        assert max(network["validation"] for network in one["networks"]) - best["validation"] < 0.1
        assert one["period"].replace("\xa0", " ") in text.replace("\xa0", " ")
        assert one["next"]["words"] in text
        assert all(command in text for command in one["next"]["commands"])
    assert html.text.index("Explore the networks") > html.text.index(answer["answers"][0]["short"][:20])


@pytest.mark.thorough
@pytest.mark.usefixtures("text_alone")
def test_what_to_beware_of_is_told_with_the_number_of_networks(tmp_path):
    what = make_study(network=study.PARTS["network"]("rsnn").model_copy(update={"training": TrainingSpec(epochs=20)}))
    networks.write(what, make_run(what, tmp_path, grating_conditions()))
    cautions = read_json(tmp_path / "answer.json")["cautions"]
    assert any(line.startswith("24 of 24 networks: training stopped after epoch 20, its last") for line in cautions)


@pytest.mark.usefixtures("text_alone")
@pytest.mark.parametrize(
    ("bounded", "changes", "is_used"),
    [(299, {}, True), (298, {}, False), (298, {"tolerance": 0.02}, True), (0, {}, False), (299, {"saved": 0}, False),
     (299, {"untold": "validation cannot choose"}, False)],
)  # fmt: skip
def test_early_exit_answers_only_where_its_loss_is_bounded(tmp_path, monkeypatch, bounded, changes, is_used):
    """Validation trials of two seeds are the same ones, and count once."""
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]], "network.hidden": [20], "seed": [0, 1]}
    exits = {"tolerance": changes.get("tolerance", 0.01)}
    what = make_study(
        sweep=sweep, claims=(), dataset={"simulate": "gratings", "subsets": {"mixed": {}}}, early_exit=exits
    )
    make_run(what, tmp_path, grating_conditions(), bounded=bounded)
    if "saved" in changes:
        table = pd.read_csv(tmp_path / "results.csv")
        table["exit_steps"], table["exit_sops_total"] = table["window_steps"], table["sops_total"]
        table.to_csv(tmp_path / "results.csv", index=False)
    monkeypatch.setattr(front, "untold", lambda *_: changes.get("untold", ""))
    networks.write(what, tmp_path)
    (found,) = read_json(tmp_path / "answer.json")["answers"]
    assert found["used"] == ("early" if is_used else "whole")
    assert ("early exit" in found["headline"]) == is_used


@pytest.mark.usefixtures("text_alone")
def test_advice_on_a_loss_in_encoding_is_of_the_encoder_of_the_study(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(front.sentences, "where_lost", lambda _, more: asked.append(more) or [])
    both = study.PARTS["encoder"]("sa1-ra1-lif-polarities")
    what = make_study(claims=(), dataset={"simulate": "gratings", "subsets": {"mixed": {}}}, encoder=both,
                      sweep={"network.hidden": [20]})  # fmt: skip
    networks.write(what, make_run(what, tmp_path, grating_conditions()))
    (said,) = asked
    assert len(said) == 2
    assert "encoder.tau_mem_ms" in said[0]
    assert "sa1-ra1-lif-graded" in said[1]  # and no comparison of polarities, of which it has both


@pytest.mark.usefixtures("text_alone")
@pytest.mark.parametrize("hidden", [20, 30])
def test_the_folder_that_is_named_is_that_of_the_chosen_network(tmp_path, monkeypatch, hidden):
    """It may differ from the leader, the best on validation trials."""
    ours = ("5&5", hidden)
    monkeypatch.setattr(
        front.period_choice, "chosen", lambda all_, _: next(one for one in all_ if (one.pair, one.hidden) == ours)
    )
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 5]], "network.hidden": [20, 30]}
    what = make_study(sweep=sweep, claims=(), dataset={"simulate": "gratings", "subsets": {"mixed": {}}})
    page = Page(networks.write(what, make_run(what, tmp_path, grating_conditions())))
    (found,) = read_json(tmp_path / "answer.json")["answers"]
    rows = pd.read_csv(tmp_path / "results.csv")
    (place,) = rows.index[(rows["t_ref_sa_ms"] == 5) & (rows["hidden"] == hidden)]
    folder = f"cells/{[*study.cells(what)][place].digest()}"
    assert found["chosen"].startswith(f"5&5 ms with {hidden} neurons")
    assert found["folder"] == folder
    assert f"The chosen network is in {folder}." in page.text


@pytest.mark.usefixtures("text_alone")
def test_a_swept_tolerance_is_that_of_its_networks(tmp_path):
    sweep = {"network.hidden": [20], "early_exit.tolerance": [0.01, 0.02]}
    what = make_study(sweep=sweep, claims=(), dataset={"simulate": "gratings", "subsets": {"mixed": {}}})
    networks.write(what, make_run(what, tmp_path, grating_conditions(), bounded=298))
    answers = read_json(tmp_path / "answer.json")["answers"]
    assert [one["used"] for one in answers] == ["whole", "early"]
    assert [one["networks"][0]["tolerance"] for one in answers] == [0.01, 0.02]


@pytest.mark.usefixtures("text_alone")
def test_the_loss_of_a_network_is_bounded_by_its_own_trainings(tmp_path, monkeypatch):
    asked, bounded = [], front.with_exit_bound
    monkeypatch.setattr(front, "with_exit_bound", lambda *given: asked.append(given) or bounded(*given))
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]], "network.hidden": [20, 30], "seed": [0, 1]}
    what = make_study(sweep=sweep, claims=(), dataset={"simulate": "gratings", "subsets": {"mixed": {}}})
    networks.write(what, make_run(what, tmp_path, grating_conditions()))
    assert [(network.hidden, [cell.network.hidden for cell in cells]) for network, _, cells, _ in asked] == [
        (20, [20, 20]), (30, [30, 30]),
    ]  # fmt: skip


def test_trials_of_all_trainings_bound_the_loss_together(monkeypatch):
    losses = {"a": {"1": 1.0, "2": 0.0}, "b": {"2": 0.0, "3": 0.0}, "c": {"1": 0.0}}
    monkeypatch.setattr(front, "result_of", lambda folder, cell: {"exit_losses": losses.get(cell)})
    network = Network("1&1", 20, 1, 0.9, None, None)

    def bound(*cells: str) -> float | None:
        found = front.with_exit_bound(network, None, cells, 0.03)
        assert found.tolerance == 0.03
        return found.exit_bound

    assert bound("a", "b", "c") == upper_bound([0.5, 0.0, 0.0])
    assert bound("b") == upper_bound([0.0, 0.0])
    assert bound("a", "of an earlier version") is bound() is None


def test_no_two_landmarks_of_a_page_have_one_name(written):
    named = Page(written).landmarks
    assert len(named) == len({*named}) > 3


def test_classes_stand_in_their_natural_order():
    encoding = pd.DataFrame({"label": ["class 10", "class 2", "class 1"]})
    assert name_classes(encoding, None).order == ("class 1", "class 2", "class 10")


STATE = "JSON.stringify({cost: document.getElementById('cost').value, scale: document.getElementById('scale').value})"


@pytest.mark.slow
def test_in_a_browser_the_address_holds_what_is_chosen(chromium, written):
    chromium.open(written, 1400)
    chromium.wait_for(DRAWN)
    choose = (
        "((id, value) => { const one = document.getElementById(id);"
        "one.value = value; one.dispatchEvent(new Event('change')); })"
    )
    for name, value in (("setting", "v1 mix"), ("cost", "ms"), ("scale", "log"), ("points", "seeds"), ("one", "2")):
        chromium.evaluate(f"{choose}('{name}', '{value}')")
    chromium.evaluate("document.querySelector('#pairs input').click()")
    address = chromium.evaluate("window.location.hash")
    expected = {"setting=v1+mix", "cost=ms", "scale=log", "points=seeds", "one=2", "without=1%261"}
    assert set(address[1:].split("&")) >= expected
    chromium.evaluate("window.isOld = true; window.location.reload()")
    chromium.wait_for(f"!window.isOld && document.readyState === 'complete' && {DRAWN}")
    assert set(chromium.evaluate("window.location.hash")[1:].split("&")) >= expected
    assert json.loads(chromium.evaluate(STATE)) == {"cost": "ms", "scale": "log"}
    assert chromium.evaluate("document.getElementById('plot')._fullLayout.xaxis.type") == "log"
    assert not chromium.evaluate("document.querySelector('#pairs input').checked")
    drawn = "document.getElementById('plot').data.flatMap((trace) => trace.customdata ?? [])"
    cells = json.loads(Page(written).json)["cells"]
    found = {(cells[i]["setting"], cells[i]["pair"]) for i in chromium.evaluate(drawn)}
    assert found == {("v1 mix", "1&5"), ("v1 mix", "10&10")}
    shown = (
        "[...document.querySelectorAll('.answer')].filter((part) => !part.hidden).map((part) => part.dataset.setting)"
    )
    assert set(chromium.evaluate(shown)) == {"v1 mix"}
    assert "A: 1&5 ms, 20 neurons" in chromium.evaluate("document.getElementById('compared').textContent")
    assert_quiet(chromium, written)


HOSTILE = (
    "<img src=x onerror=hacked=1>", "</script><script>hacked=1</script>", '"><svg onload=hacked=1>',
    '<a href="javascript:hacked=1">felt</a>',
)  # fmt: skip
"""Names that a page takes for markup if it forgets to escape them; figures know some markup, too."""


@pytest.mark.slow
def test_in_a_browser_names_are_text_and_nothing_of_them_runs(chromium, tmp_path):
    subsets = {name: {} for name in HOSTILE}
    dataset = {**GRATINGS, "subsets": subsets}
    sweep = {
        "dataset": [*HOSTILE],
        "encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [10, 10]],
        "network.hidden": [20, 30],
        "seed": [0],
    }
    what = make_study(title=HOSTILE[0], about=HOSTILE[1], notes=HOSTILE, dataset=dataset, sweep=sweep, claims=())
    conditions = grating_conditions(pitches_mm=(4.0, 2.0, 1.0, 0.5)).drop(columns="grating")  # named by their labels
    conditions["label"] = conditions["label"].map(dict(zip(conditions["label"].unique(), HOSTILE, strict=True)))
    make_run(what, tmp_path, conditions)
    page = networks.write(what, tmp_path)
    chromium.open(page, 1400)
    chromium.wait_for(DRAWN)
    for name in HOSTILE:  # each is shown, in the list and in the figure
        chromium.evaluate(
            "(() => { for (const list of document.querySelectorAll('select')) for (const one of list.options)"
            f" if (one.textContent.trim() === {json.dumps(name)}) {{ list.value = one.value;"
            " list.dispatchEvent(new Event('change', { bubbles: true })); } })()"
        )
        chromium.wait_for(DRAWN)
        assert chromium.evaluate("typeof hacked") == "undefined"
    for index in range(4):
        chromium.evaluate(f"document.querySelectorAll('#networks tbody tr')[{index}].click()")
    heads = chromium.evaluate("[...document.querySelectorAll('#cell-confusion th')].map((cell) => cell.textContent)")
    assert set(HOSTILE) <= {head.strip() for head in heads}
    assert (
        chromium.evaluate(
            "document.querySelectorAll('img[src=x], [onerror], [onload], [href^=\"javascript:\"]').length"
        )
        == 0
    )
    assert chromium.evaluate("[...document.scripts].filter((one) => one.textContent.startsWith('hacked')).length") == 0
    assert chromium.evaluate("[...document.querySelectorAll('a')].every((one) => !String(one.getAttributeNS("
                             "'http://www.w3.org/1999/xlink', 'href')).startsWith('javascript'))")  # fmt: skip
    assert chromium.evaluate("typeof hacked") == "undefined"
    assert_quiet_of(chromium, page)


def assert_quiet_of(chromium, page: Path) -> None:
    """As `assert_quiet`, for a browser that showed other pages before."""
    assert chromium.complaints == []
    last = max(place for place, url in enumerate(chromium.requests) if url == page.as_uri())
    assert not [url for url in chromium.requests[last + 1 :] if not url.startswith(("data:", "blob:"))]
