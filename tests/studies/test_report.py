"""The report shows what a run holds, says what it lacks, and asks nothing of the network."""

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest
from made_run import GRATINGS, SUBSETS, grating_conditions, make_run

from neurotact.errors import InputError
from neurotact.spec import load
from neurotact.studies import report, study
from neurotact.studies.claims import Claim
from neurotact.studies.study import StudySpec

TINY = Path(__file__).parent / "tiny.toml"
CLAIMS = (
    Claim(name="Counts fall", source="Fig. 6", published="1&1 > 10&10", kind="order", table="encoding",
          measure="spikes_total_per_s", order=(({"pair": "1&1"},), ({"pair": "10&10"},))),
    Claim(name="1&1 is <accurate>", source="Fig. 11", published="99.9 %", kind="value", measure="accuracy_test",
          where={"pair": "1&1", "dataset": "mixed", "hidden": 30}, value=0.999, tolerance=0.001),
    Claim(name="7&7", source="Fig. 8", published="90 %", kind="at_least", measure="accuracy_test",
          where={"pair": "7&7"}, value=0.9),
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
        "encoder": load(study.PARTS["encoder"], "sa1-ra1-lif"),
        "network": load(study.PARTS["network"], "rsnn"),
    }
    return StudySpec.model_validate({**table, **changes})


class Page(HTMLParser):
    """What a test asks of a page: its links, pictures, heads of tables and text."""

    def __init__(self, path: Path):
        super().__init__()
        self.links, self.images, self.heads, self.ids, self.text = [], [], [], [], ""
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.links += [given[k] for k in ("href", "src") if k in given]
        self.ids += [given["id"]] if "id" in given else []
        if tag == "img":
            self.images.append(given)
        if tag == "th":
            self.heads.append(given.get("scope"))

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A whole run of gratings, its RA-I afferents heard, with its report."""
    folder = tmp_path_factory.mktemp("run")
    what = make_study()
    make_run(what, folder, grating_conditions())
    pd.DataFrame([{"dataset": "mixed", "n_test": 9, "accuracy_test": 0.456, "chance": 0.25}]).to_csv(
        folder / "baseline.csv", index=False
    )
    return report.write(what, folder)


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
    assert "1 of 2 claims reproduced, 1 not in this run" in text
    for claim in CLAIMS:
        assert claim.name in text
        assert claim.rule in text
    assert "✓ yes" in text
    assert "✗ no" in text


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
    results = report.with_setting(report.with_pair(pd.read_csv(written.parent / "results.csv")), [])
    table = report.means_table(results)
    assert len(table.rows) == 12
    rows = results[(results["dataset"] == "mixed") & (results["pair"] == "1&5") & (results["hidden"] == 30)]
    (shown,) = [row for row in table.rows if row[:3] == ["mixed", "1&5", "30"]]
    accuracy = 100 * rows["accuracy_test"]
    assert shown[5] == f"{accuracy.mean():.1f} ± {accuracy.std():.1f}"
    assert Page(written).text.count("10&10") > 4


def test_the_same_run_gives_the_same_report(written):
    before = written.read_bytes()
    assert report.write(make_study(), written.parent).read_bytes() == before


def test_one_seed_and_a_silent_population(tmp_path):
    what = make_study()
    what = what.model_copy(update={"sweep": {**what.sweep, "seed": [0]}})
    page = Page(report.write(what, make_run(what, tmp_path, grating_conditions(), silent_ra=True)))
    assert "1 seed," in page.text
    assert "±" not in "".join(cell for row in report.means_table(_results(tmp_path)).rows for cell in row)


@pytest.mark.parametrize("n_done", [1, 14])
def test_a_run_that_is_not_complete_says_so(tmp_path, n_done):
    what = make_study()
    page = Page(report.write(what, make_run(what, tmp_path, grating_conditions(), n_done=n_done)))
    assert f"{n_done} of 24" in page.text


@pytest.mark.parametrize("stratify", [[], ["finger"]])
def test_other_touch_than_gratings(tmp_path, stratify):
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 10]], "network.hidden": [30]}
    what = make_study(dataset={"file": "fabrics.h5", "stratify": stratify}, sweep=sweep, claims=())
    conditions = pd.DataFrame({"label": ["felt", "None"] * 4, "finger": ["left"] * 4 + ["right"] * 4})
    page = Page(report.write(what, make_run(what, tmp_path, conditions)))
    assert "felt" in page.text
    assert "claims" not in page.ids


def test_another_swept_key_tells_its_networks_apart(tmp_path):
    sweep = {"window.length_ms": [50.0, 100.0], "network.hidden": [20]}
    what = make_study(sweep=sweep, claims=())
    text = Page(report.write(what, make_run(what, tmp_path, grating_conditions()))).text
    assert "v1 mix, window.length 50 ms" in text


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"results\.csv.*no such file"):
        report.write(make_study(), tmp_path)


def _results(folder: Path) -> pd.DataFrame:
    return report.with_setting(report.with_pair(pd.read_csv(folder / "results.csv")), [])


@pytest.mark.slow
@pytest.mark.parametrize("width", [400, 1400])
def test_chromium_opens_the_report_without_a_complaint(written, tmp_path, width):
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no chromium on this machine")
    picture = tmp_path / "page.png"
    quiet = ["--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic"]
    opened = subprocess.run(
        [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", *quiet, "--enable-logging=stderr",
         f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},2000", f"--screenshot={picture}",
         written.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "CONSOLE" not in opened.stderr
