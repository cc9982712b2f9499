"""The pages and the references that are written from the program."""

import sys
from pathlib import Path

import pytest

import neurotact as nt
from neurotact import plugins
from neurotact.cli import COMMANDS
from neurotact.data.sources import simulator
from neurotact.encoders.specs import MODELS
from neurotact.networks.specs import RSNNSpec
from neurotact.networks.tuning import SearchSpec
from neurotact.studies.claims import Claim
from neurotact.studies.protocol_study import ProtocolStudy
from neurotact.studies.study import StudySpec

ROOT = Path(__file__).parents[1]
SPECS = [model.spec for model in MODELS.values()] + [RSNNSpec, SearchSpec, StudySpec, ProtocolStudy, Claim]
SPECS += [simulator(name).model for name in plugins.names("simulators")]


@pytest.fixture(scope="module")
def site():
    """The modules that write the site's references, by name."""
    sys.path.insert(0, str(ROOT / "docs" / "site"))
    yield __import__
    sys.path.remove(str(ROOT / "docs" / "site"))


# --- references -------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", SPECS, ids=lambda model: model.__name__)
def test_every_key_of_a_spec_says_what_it_takes_and_means(model, site):
    rows = list(site("spec_reference").rows_of(model))
    assert not [key for key, _, takes, meaning in rows if not (takes and meaning)]
    assert {key.split(".")[0] for key, *_ in rows} == {*model.model_fields}


def test_a_row_of_a_spec_has_default_unit_and_range(site):
    rows = {key: (default, takes) for key, default, takes, _ in site("spec_reference").rows_of(StudySpec)}
    assert rows["window.length_ms"] == ("`150.0`", "number, ms, > 0")
    assert rows["cut_short_ms"] == ("", "list of numbers, ms, > 0")
    assert rows["encoder"] == ("required", ["table: [encoders](#encoders)", "[encoders](#encoders)"][0])
    assert rows["window.align"] == ('`"trial"`', '`"trial"`, `"onset"`')
    assert rows["selection"] == ("", "table")


def test_a_table_within_a_spec_has_the_defaults_that_it_has_there(site):
    palm, finger = (
        {key.removeprefix(f"{skin}."): default for key, default, *_ in site("spec_reference").rows_of(compliance)}
        for compliance in [simulator("compliance").model] for skin in ("palm", "finger")
    )  # fmt: skip
    assert (palm["rows"], finger["rows"]) == ("`16`", "`11`")


def test_every_name_of_the_front_door_is_in_the_python_reference_once(site):
    page = site("python_reference").page()
    for name in {*nt.__all__} - {"__version__"}:
        assert page.count(f":: neurotact.{name}\n") == 1, name
    for name in nt.baselines.__all__:
        assert page.count(f":: neurotact.baselines.{name}\n") == 1, name
    assert ":: neurotact.data.Recordings" not in page


def test_every_command_is_in_the_reference_of_the_command_line(site):
    page = site("command_line").page()
    for command in COMMANDS:
        assert f"\n## `neurotact {command}`\n" in page
    for inner in ("simulate gratings", "import folder", "study resume"):
        assert f"\n### `neurotact {inner}`\n" in page
    assert "\n* `--window-ms <float>`: " in page
    assert "..." not in page.replace("ARGS]...", "")


@pytest.mark.parametrize(
    ("written", "read"),
    [
        (["x: `(trial,)`.", "y_: its *", "  output."], ["- ``x``: ``(trial,)``.", r"- ``y_``: its \* output.", ""]),
        (["a: one. b, c: two.", "Raises it."], ["- ``a``: one.", "- ``b, c``: two.", "", "Raises it.", ""]),
        (["Parameters", "------", "seed : a number."], ["**Parameters**", "", "- ``seed``: a number.", ""]),
        (["Of `nt.RSNN`s."], [r"Of :py:obj:`nt.RSNN <neurotact.RSNN>`\ s.", ""]),
        ([">>> a_ * b", "1"], [">>> a_ * b", "1", ""]),
        (["A sentence: no list."], ["A sentence: no list.", ""]),
    ],
)  # fmt: skip
def test_docstrings_are_read_as_they_are_written(written, read, site):
    assert site("docstrings").to_rest(written) == read


# --- the site ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("page", "asks"),
    [
        ('<script src="https://cdn.test/a.js"></script>', 1),
        ("<img alt='x' src='//cdn.test/a.png'>", 1),
        ('<link rel="stylesheet" href="https://cdn.test/a.css">', 1),
        ("<style>@import url(https://fonts.test/a.css)</style>", 1),
        ('<a href="https://example.test">read on</a><link rel="next" href="https://here.test/b.html">', 0),
        ('<script src="_static/a.js"></script><img src="_images/a.png">', 0),
    ],
)
def test_a_page_that_asks_another_host_is_found(page, asks, site, tmp_path):
    (tmp_path / "page.html").write_text(page)
    assert len(site("local").requests(tmp_path)) == asks
