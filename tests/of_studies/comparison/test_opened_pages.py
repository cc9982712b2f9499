"""What a reader of these studies meets first: one sentence, one picture with names, five rows, and no more."""

import html
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from browser import APART, browser
from in_process import studies_here, typed, without_pictures
from neurotact_parts.studies.comparison import real_sets, recipe_ablation, untrained

SHARED = {"n_train": 400, "n_test": 100, "test_trials": 100, "skipped": ""}
CLASSIFIERS = {
    ("RSNN", "spikes: every step"): (0.9, 300.0), ("SNN", "spikes: every step"): (0.88, 200.0),
    ("MiniRocket", "signals"): (0.97, 5000.0), ("SVM", "signals: mean"): (0.965, 20.0),
    ("SVM", "signals: 10 time bins"): (0.9, 40.0), ("extra trees", "signals: mean"): (0.85, 5.0),
    ("extra trees", "signals: 10 time bins"): (0.8, 6.0), ("ELM", "signals: mean"): (0.7, 1.0),
}  # fmt: skip
CHANGES = (0.9, 0.6, 0.7, 0.8, 0.85, 0.91, 0.9, 0.89)
REMEDIES = (
    "nothing",
    "copies in time",
    "copies in gain",
    "start shifts",
    "falling signal",
    "the default",
    "trained on it",
)


def of_classifiers(parameters):
    at = SETS.index((parameters.data.set, parameters.data.split))
    for (classifier, source), (share, nJ) in CLASSIFIERS.items():
        reached = share + 0.01 * (parameters.seed - 1) - 0.04 * at
        yield {
            "classifier": classifier, "input": source, "accuracy_test": reached, "accuracy_validation": reached,
            "energy_estimate_nJ": nJ * 2**at, "signal_ms": 300.0, "sops_total": 100.0, "flops": 10.0, "parameters": 9,
        }  # fmt: skip


def of_changes(parameters):
    for at, share in enumerate(CHANGES):
        reached = share + 0.01 * (parameters.seed - 1)
        yield {
            "change": f"without part {at}" if at else recipe_ablation.WHOLE, "accuracy_test": reached,
            "accuracy_validation": reached, "sops_total": 1000.0 - 50 * at, "hidden_spikes": 10.0,
        }  # fmt: skip


def of_remedies(parameters):
    share = 0.5 + 0.05 * REMEDIES.index(parameters.remedy)
    for classifier, source, more, nJ in (("RSNN", "spikes", 0.0, 90.0), ("SVM", "signals", 0.05, 20.0)):
        yield {
            "tested": f"cubes by {parameters.condition}", "split": str(parameters.value), "classifier": classifier,
            "input": source, "accuracy_test": share + more, "accuracy_seen": 0.95, "validated": 0.9, "ranked": True,
            "accuracy_validation": 0.9 if parameters.remedy == "the default" else np.nan, "sops_total": 100.0,
            "energy_estimate_nJ": nJ + 100 * share, "signal_ms": 300.0, "exit_accuracy": share, "exit_ms": 200.0,
        }  # fmt: skip


class Made(NamedTuple):
    """A study, the rows that its cells give, its settings, and what must be found.

    named: what the picture names, with the number of each. said: whose numbers the first sentence has.
    """

    module: Any
    rows: Callable[[Any], Any]
    settings: dict[str, Any]
    named: dict[str, str]
    said: list[str]


SETS = (("cubes", "trials"), ("cubes", "groups"), ("fabrics", "trials"), ("fabrics", "groups"), ("letters", "trials"))
STUDIES = {
    "real-sets": Made(
        real_sets, of_classifiers, {"data.set & data.split": [["cubes", "trials"]]},
        {"RSNN, spikes: every step": "90.0", "MiniRocket, signals": "97.0", "SVM, signals: mean": "96.5"},
        ["MiniRocket, signals", "SVM, signals: mean"],
    ),
    "real-sets, all": Made(
        real_sets, of_classifiers, {"data.set & data.split": [[*one] for one in SETS]},
        {", ".join(one): "" for one in SETS}, [],
    ),
    "recipe-ablation": Made(
        recipe_ablation, of_changes, {"data.set": ["gratings"]},
        {"the recipe": "", "without part 1": "30", "without part 2": "20", "without part 3": "10",
         "without part 5": "1"},
        ["without part 1"],
    ),
    "untrained-conditions": Made(
        untrained, of_remedies,
        {"data.set & condition & value": [["cubes", "sequence", at] for at in (1.0, 2.0, 3.0)], "remedy": REMEDIES},
        {**{name: f"{50 + 5 * at}.0" for at, name in enumerate(REMEDIES)}, "SVM on signals": "80.0"},
        ["SVM on signals"],
    ),
}  # fmt: skip


class Opened(NamedTuple):
    """A report as it opens: its page, its first section without what is folded, and the data of its picture; what the
    command printed, and `answer.json`.
    """

    made: Made
    page: Path
    section: str
    data: dict
    printed: str
    answer: dict

    @property
    def headlines(self):
        return [words(said) for said in re.findall(r'class="headline">(.*?)</p>', self.section)]

    @property
    def rows(self):
        """The rows of the first answer's table."""
        shown = re.search(r"<tbody>(.*?)</tbody>", self.section, re.DOTALL)[1]
        return [words(row) for row in re.findall(r"<tr>(.*?)</tr>", shown)]

    @property
    def names(self):
        """The names of points of the first answer, over its first cost."""
        first = next(iter(self.data["fronts"]))
        labels = [point["labels"].get(first, {}) for point in self.data["points"]]
        return [plain(label) for each in labels for label in [*each.values()][:1] if label]


def plain(text):
    return text.replace("\xa0", " ")


def words(markup):
    return plain(html.unescape(re.sub(r"<[^>]*>", "", markup.replace("</t", " </t")))).strip()


@pytest.fixture(scope="module", params=STUDIES)
def opened(request, tmp_path_factory):
    made, folder = STUDIES[request.param], tmp_path_factory.mktemp(request.param) / "run"
    settings = [f"sweep.{key}={json.dumps(value)}" for key, value in {**made.settings, "seed": [0, 1, 2]}.items()]
    with studies_here() as patch:
        without_pictures(patch)
        patch.setattr(made.module, "load", lambda data: {"signal": np.zeros(1)})
        patch.setattr(made.module, "run", lambda parameters, arrays: [row | SHARED for row in made.rows(parameters)])
        changes, study = (part for one in settings for part in ("--set", one)), request.param.split(",")[0]
        done = typed("study", "run", study, *changes, "-o", folder)
    assert done.code == 0, done.err
    page = (folder / "report.html").read_text()
    section = re.search(r'<section id="answer".*?</section>', page, re.DOTALL)[0]
    seen = re.sub(r"<details.*?</details>", "", section, flags=re.DOTALL)
    data = json.loads(re.search(r'id="study-data">(.*?)</script>', page)[1])
    return Opened(made, folder / "report.html", seen, data, done.out, json.loads((folder / "answer.json").read_text()))


def test_a_report_opens_with_one_sentence_and_five_rows_and_folds_all_else(opened):
    settings, answers = [*opened.data["fronts"]], opened.answer["answers"]
    assert [one["dataset"] for one in answers] == settings
    several = len(settings) > 1
    assert opened.headlines == [
        f"{one['dataset']}: {one['headline']}" if several else one["headline"] for one in answers
    ]
    for one in answers:
        assert one["details"]
        assert not re.search(r"\.\s", one["headline"])
        assert len(one["headline"].split()) < 60
        assert not any(detail in words(opened.section) for detail in one["details"])
    assert len(opened.rows) == 5


def test_the_picture_the_sentence_and_the_rows_name_the_same_with_the_same_numbers(opened):
    named, told = opened.made.named, {}
    for name in opened.names:
        told |= {what: name for what in named if name.startswith(what)}
        assert name in told.values(), name
    assert told.keys() == named.keys()
    assert all(number in told[what] for what, number in named.items())
    rows = {what: row for row in opened.rows for what in named if row.startswith(what)}
    assert len(rows) >= 3
    assert all(named[what] in row for what, row in rows.items())
    for what in opened.made.said:
        assert what in opened.headlines[0]
        assert named[what] in opened.headlines[0] or what == "MiniRocket, signals"  # of that one the difference is said
        assert what in rows or what == "SVM on signals"  # which stands in a column


def test_the_command_prints_the_same_sentences_and_rows_and_no_more(opened):
    printed = " ".join(opened.printed.split())
    for one in opened.answer["answers"]:
        assert one["headline"] in printed
        assert not any(detail in printed for detail in one["details"])
    tables = {table["setting"]: table for table in reversed(opened.answer["tables"])}
    for table in tables.values():
        assert len(table["named"]) == 5
        for at, row in enumerate(table["rows"]):
            is_printed = " ".join(row[:2]) in printed
            assert is_printed == (at in table["named"]), row


CUT = """[...document.querySelectorAll("#answer .scroll")].filter((part) => part.offsetParent)
  .filter((part) => part.scrollWidth > part.clientWidth).length"""


@pytest.mark.slow
def test_in_a_browser_every_name_has_its_place_and_nothing_is_cut_off(opened, tmp_path):
    with browser(tmp_path / "profile") as chromium:
        for width, scheme in ((1400, "light"), (400, "dark")):
            chromium.open(opened.page, width, scheme=scheme)
            chromium.wait_for("document.querySelector('#plot .annotation-text')")
            assert chromium.evaluate(APART) == [len(opened.made.named), 0, 0]
            assert chromium.evaluate(CUT) == 0
            assert chromium.evaluate("document.documentElement.scrollWidth") <= width
            assert len(chromium.evaluate("document.querySelector('main').innerText").split()) < 1500
        chromium.evaluate("document.querySelector('#explore details').open = false")
        chromium.evaluate("document.getElementById('plot').emit('plotly_click', { points: [{ customdata: 1 }] })")
        assert chromium.evaluate("document.querySelector('#explore tr[aria-current]').checkVisibility()")
        assert chromium.complaints == []
