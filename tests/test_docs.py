"""The pages: their links, their code, their commands, and the references that are written from the program."""

import ast
import re
import shlex
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from itertools import chain, pairwise
from pathlib import Path
from typing import get_args
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
import typer
from browser import browser
from markdown_it import MarkdownIt
from markdown_it.token import Token
from typer.main import get_command

import neurotact as nt
from neurotact import cli, plugins
from neurotact.cli import COMMANDS
from neurotact.data import spikes as spike_trains
from neurotact.data.dataset import simulator
from neurotact.encoders.model import usable
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.studies import measures
from neurotact.studies.claims import Claim
from neurotact.studies.study import StudySpec
from neurotact.studies.way_study import WayStudy

ROOT = Path(__file__).parents[1]
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")])
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
WRITTEN = "<!-- written by make docs -->"
NOT_RUN = "<!-- not run: "
"""Stands before Python that is not run, with the reason."""
THEIRS = {"my-skin", "my-press"}
"""Commands that the pages let a reader's own package bring."""
SMALLER = {
    "README.md": {"trials=10": "trials=2, duration_s=0.5", "random_state=0)": "epochs=2, random_state=0)"},
    "docs/compliance-simulator.md": {"trials=10": "trials=1"},
    "docs/contact-materials-simulator.md": {"trials=2": "trials=1"},
    "docs/devices.md": {
        'nt.Stream("run")': "nt.Stream(chain, streamed=nt.Streamed(length_ms=5))",
        'nt.Stream("run-on-events")': "nt.Stream((None, nt.RSNN(4, 2, hidden=4, sampling_rate_Hz=1000.0)))",
    },
    "docs/gratings-simulator.md": {"trials=10": "trials=1, duration_s=0.3"},
    "docs/splits.md": {'"run", split': '"run", settings={"training.epochs": 1}, split'},
    "docs/stiffness-simulator.md": {"grasps=5": "grasps=1"},
    "docs/touch-modality-simulator.md": {"people=10": "people=1", "TouchModalitySpec()": "TouchModalitySpec(people=1)"},
}
"""What of the code of a page is changed so that it takes a moment."""
SPECS = [model.spec for model in usable().values()] + [RSNNSpec, SearchSpec, StudySpec, WayStudy, Claim]
SPECS += [measures.every(), *(simulator(name).model for name in plugins.names("simulators"))]


@pytest.fixture(scope="module")
def site():
    """The modules that write the site's references, by name."""
    sys.path.insert(0, str(ROOT / "docs" / "site"))
    yield __import__
    sys.path.remove(str(ROOT / "docs" / "site"))


# --- what stands in a page --------------------------------------------------------------------------


@cache
def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


@cache
def tokens_of(page: Path) -> tuple[Token, ...]:
    return tuple(MarkdownIt().enable("table").parse(text_of(page)))


def inline_of(page: Path) -> Iterator[Token]:
    """Links, pictures and code within the lines of a page."""
    return chain.from_iterable(token.children or () for token in tokens_of(page))


def slugs(text: str) -> set[str]:
    """The anchors of a page's headings, as code hosts make them."""
    found: dict[str, int] = {}
    tokens = MarkdownIt().parse(text)
    for before, token in pairwise(tokens):
        if before.type == "heading_open":
            said = "".join(part.content for part in token.children or () if part.type in ("text", "code_inline"))
            slug = re.sub(r"[^\w\- ]", "", said.lower()).replace(" ", "-")
            found[slug] = found.get(slug, -1) + 1
    return {f"{slug}-{number}" if number else slug for slug, last in found.items() for number in range(last + 1)}


def commands_of(page: Path) -> Iterator[tuple[str, bool]]:
    """Every `neurotact ...` of a page, and whether it is one that is typed as it stands."""
    for token in tokens_of(page):
        if token.type in ("fence", "code_block") and token.info in ("sh", "console"):
            for line in token.content.replace("\\\n", " ").splitlines():
                typed = re.fullmatch(r"\s*(?:\$ )?(?:\w+=\S+ )*(neurotact .*)", line)
                if typed:
                    yield typed[1], True
    for token in inline_of(page):
        if token.type == "code_inline" and token.content.startswith("neurotact "):
            yield token.content, False


# --- pages ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_within_the_pages_lead_somewhere(page, site):
    targets = [str(token.attrs.get("href") or token.attrs.get("src") or "") for token in inline_of(page)]
    broken = []
    for target in (target for target in targets if target and not re.match(r"\w+:", target)):
        path, _, anchor = unquote(target).partition("#")
        to = (page.parent / path).resolve() if path else page
        if not to.exists():
            broken.append(target)
        elif anchor:
            name = str(to.relative_to(ROOT / "docs").with_suffix("")) if to.is_relative_to(ROOT / "docs") else ""
            whole = text_of(to)
            if WRITTEN in whole:
                whole = whole.replace(WRITTEN, site("written").WRITTEN[name]())
            broken += [target] if anchor not in slugs(whole) else []
    assert not broken


def test_every_page_is_in_the_navigation_of_the_site():
    listed = [line for token in tokens_of(ROOT / "docs" / "index.md") if token.info == "{toctree}"
              for line in token.content.splitlines() if line and not line.startswith(":")]  # fmt: skip
    docs = ROOT / "docs"
    pages = {str(path.relative_to(docs).with_suffix("")) for path in docs.rglob("*.md")}
    pages = {page for page in pages if not page.startswith("examples/")}  # of packages to copy, which the site links
    written = {page for page in pages if page.startswith("reference/python/")}  # listed by the page of all subjects
    assert sorted({*listed} - {"gallery_of_examples/index"}) == sorted(pages - {"index"} - written)
    assert len(listed) == len({*listed})


def groups() -> dict[str, list[Path]]:
    """The pages of each group of the navigation."""
    found = {}
    for token in tokens_of(ROOT / "docs" / "index.md"):
        if token.info == "{toctree}":
            caption, *listed = [line for line in token.content.splitlines() if line and line != ":hidden:"]
            paths = [ROOT / "docs" / f"{name}.md" for name in listed]
            found[caption.removeprefix(":caption: ")] = [path for path in paths if path.is_file()]
    return found


GUIDANCE = [page for name in ("Start here", "How to", "Concepts") for page in groups()[name]]
MOST_NUMBERS = 0.05
"""Numbers a word of a page that guides; tables and diaries of what was measured stand in a page of results."""


def numbers_of(text: str) -> tuple[int, int]:
    """How many words a text has, outside code and math, and how many of them are numbers.

    >>> numbers_of("Of `100` trials 12 (5 %) have SA-1 afferents.")
    (7, 2)
    """
    said = " ".join(
        part.content
        for token in MarkdownIt().enable("table").parse(text)
        for part in (token.children or ())
        if part.type == "text"
    )
    words = re.findall(r"\S*\w\S*", re.sub(r"\$[^$]*\$", " ", said))
    return len(words), sum(bool(re.search(r"(?<![A-Za-z-])\d", word)) for word in words)


@pytest.mark.parametrize("page", GUIDANCE, ids=[str(page.relative_to(ROOT)) for page in GUIDANCE])
def test_a_page_that_guides_has_few_numbers(page):
    words, numbers = numbers_of(text_of(page))
    assert numbers <= MOST_NUMBERS * words, f"{numbers} numbers in {words} words"


RESULTS = [page for page in sorted((ROOT / "docs" / "results").glob("*.md")) if page.stem != "negatives"]
"""Each is behind a page of its name; what did not help is of all pages."""


@pytest.mark.parametrize("page", RESULTS, ids=lambda page: page.stem)
def test_a_page_of_results_and_the_page_that_it_is_behind_name_each_other(page):
    guide = page.parents[1] / page.name
    assert f"results/{page.name}" in text_of(guide)
    assert f"../{page.name}" in text_of(page)


VERDICTS = {
    "reproduced": r"yes", "not": r"no$", "without the effect too": r".*without the effect too",
    "baseline too": r".*baseline too", "fit": r".*fit", "too few rows": r".*too few rows", "not tried": r".*not tried",
}  # fmt: skip
"""How the verdict of a claim begins, by the column that counts it."""


def test_the_page_of_claims_counts_those_of_their_table():
    claims = pd.read_csv(ROOT / "docs" / "data" / "texture-claims.csv", dtype=str)
    lines = text_of(ROOT / "docs" / "texture-claims.md").splitlines()
    heads, _, *rows = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines if line[:1] == "|"]
    assert heads == ["study", "claims", *VERDICTS]
    for study, *counts in rows:
        told = claims["verdict"][(claims["study"] == study) | (study == "all")]
        expected = [len(told), *(int(told.str.match(verdict).sum()) for verdict in VERDICTS.values())]
        assert [int(count) for count in counts] == expected, study
    assert {study for study, *_ in rows} == {"all", *claims["study"]}


def test_what_did_not_help_is_told_with_its_result_and_its_page(site):
    table = pd.read_csv(ROOT / "docs" / "data" / "negatives.csv", dtype=str)
    assert list(table) == ["idea", "set", "result", "where"]
    assert table.notna().all(axis=None)
    assert not table.duplicated(["idea", "set", "where"]).any()
    assert {where for where in table["where"] if not (ROOT / "docs" / f"{where}.md").is_file()} == set()
    rows = [
        token for token in MarkdownIt().enable("table").parse(site("written").negatives()) if token.type == "tr_open"
    ]
    assert len(rows) == 1 + len(table)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_the_commands_of_a_page_are_those_of_the_program(page):
    wrong = {line: why for line, whole in commands_of(page) if (why := complaint(line, whole=whole))}
    assert not wrong


def complaint(line: str, *, whole: bool) -> str:
    """What the command line would say of a command, nothing being run; of a part of one, of its names alone."""
    words = shlex.split(re.split(r"\s(?:\||#|>|<|&&|;)\s?", line)[0], comments=True)[1:]
    if not whole:  # what follows a stand-in, such as NAME or ..., is not known
        words = words[: next((k for k, word in enumerate(words) if re.search(r"^[A-Z_]+$|…|\.\.\.", word)), len(words))]
    command, context = get_command(cli.app), None
    try:
        while hasattr(command, "commands"):
            own = [word for word in words if word.startswith("-")] if not words or words[0].startswith("-") else []
            if own or not words:
                return "" if set(own) <= {"--help", "--version", "--quiet"} else f"no such option: {own}"
            if words[0] not in command.commands:
                return "" if words[0] in THEIRS else f"no such command: {words[0]}"
            command, words = command.commands[words[0]], words[1:]
        context = command.make_context("neurotact", list(words))
    except typer.TyperException as error:
        missing = error.format_message().startswith("Missing ")
        return "" if missing and not whole else error.format_message()
    except typer.Exit:
        return ""
    finally:
        if context is not None:
            context.close()
    return ""


@pytest.mark.parametrize(
    ("line", "whole", "expected"),
    [
        ("neurotact train spikes.h5 -o run/ --windw-ms 150", True, "--windw-ms"),
        ("neurotact trian", False, "trian"),
        ("neurotact train spikes.h5", True, "Missing option"),
        ("neurotact train spikes.h5", False, ""),
        ("neurotact simulate NAME --set x=1", False, ""),
        ("neurotact study run own-recordings --data a.h5 -o runs/mine   # --quick: a first look", True, ""),
        ("neurotact stream run/ --from - | head", True, ""),
        ("neurotact train spikes.h5 -o run/ --window-ms long", True, "--window-ms"),
    ],
)
def test_a_command_that_would_be_refused_is_found(line, whole, expected):
    assert expected in complaint(line, whole=whole)
    assert bool(complaint(line, whole=whole)) == bool(expected)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_the_names_of_a_page_are_those_of_the_package(page):
    if page.name == "CHANGELOG.md":
        pytest.skip("tells of names that were")
    named = [token.content for token in inline_of(page) if token.type == "code_inline"]
    for name in (name for name in named if re.fullmatch(r"neurotact(\.\w+)+", name)):
        module, _, attribute = name.rpartition(".")
        try:
            import_module(name)
        except ModuleNotFoundError:
            if attribute not in get_args(plugins.Group):
                assert hasattr(import_module(module), attribute), name


@pytest.fixture
def prepared(tmp_path, monkeypatch):
    """What the code of the pages speaks of: spikes of conditions, a chain, samples, a signal and its pieces."""
    from neurotact.encoders import specs

    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 30, "speed": [300, 300, 450] * 20})
    conditions["subject"] = [f"s{number // 6}" for number in range(60)]
    rasters = (rng.random((60, 300, 4)) < 0.1).astype(np.uint8)
    spikes = spike_trains.from_rasters(rasters, 1000.0, ("SA-I a", "SA-I b", "RA-I a", "RA-I b"), conditions)
    nt.save(spikes, "spikes.h5")
    encoder = specs.load("sa1-ra1-lif", {"conditioning.baseline": "start"})
    network = nt.RSNN(16, 2, hidden=4, sampling_rate_Hz=2000.0)
    press = 5 * np.exp(-((np.linspace(0, 3, 6000) - 1) ** 2) / 0.01)
    signal = np.repeat(press[:, None], 4, axis=1).astype(np.float32)
    samples, pieces = np.zeros((25, 8)), np.array_split(signal, 3)
    return {
        "nt": nt,
        "spikes": spikes,
        "chain": (encoder, network),
        "samples": samples,
        "signal": signal,
        "pieces": pieces,
    }


def run_code(page: Path, found: dict) -> dict:
    """Run the Python of a page, block by block in one namespace, as small as `SMALLER` makes it."""
    before = ""
    for token in tokens_of(page):
        if token.type == "fence" and token.info == "python" and not before.startswith(NOT_RUN):
            code = token.content
            for large, small in SMALLER.get(str(page.relative_to(ROOT)), {}).items():
                code = code.replace(large, small)
            exec(compile(ast.parse(code), str(page), "exec"), found)
        before = token.content
    return found


WITH_CODE = [page for page in PAGES if "```python\n" in text_of(page)]


@pytest.mark.parametrize("page", WITH_CODE, ids=[str(page.relative_to(ROOT)) for page in WITH_CODE])
def test_the_python_of_a_page_runs(page, prepared):
    found = run_code(page, prepared)
    if page.name == "README.md" and page.parent == ROOT:
        assert isinstance(found["net"], nt.RSNN)
        assert found["data"].X.shape[1:] == (300, 16)


def test_what_is_made_smaller_stands_in_the_pages():
    for name, changes in SMALLER.items():
        assert all(large in text_of(ROOT / name) for large in changes), name


# --- references -------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", SPECS, ids=lambda model: model.__name__)
def test_every_key_of_a_spec_says_what_it_takes_and_means(model, site):
    rows = list(site("spec_reference").rows_of(model))
    assert not [key for key, _, takes, meaning in rows if not (takes and meaning)]
    assert {key.split(".")[0] for key, *_ in rows} == {*model.model_fields}


def test_a_row_of_a_spec_has_default_unit_and_range(site):
    rows = {key: (default, takes) for key, default, takes, _ in site("spec_reference").rows_of(StudySpec)}
    assert rows["window.length_ms"] == ("`150.0`", "number, ms, > 0")
    assert rows["encoder"] == ("required", ["table: [encoders](#encoders)", "[encoders](#encoders)"][0])
    assert rows["window.align"] == ('`"trial"`', '`"trial"`, `"onset"`')
    assert rows["augmentation"] == ("", "table")
    further = {key: (default, takes) for key, default, takes, _ in site("spec_reference").rows_of(measures.every())}
    assert further["cut_short_ms"] == ("required", "list of numbers, ms, > 0")


def test_a_table_within_a_spec_has_the_defaults_that_it_has_there(site):
    palm, finger = (
        {key.removeprefix(f"{skin}."): default for key, default, *_ in site("spec_reference").rows_of(compliance)}
        for compliance in [simulator("compliance").model] for skin in ("palm", "finger")
    )  # fmt: skip
    assert (palm["rows"], finger["rows"]) == ("`16`", "`11`")


def test_every_name_of_the_front_door_is_in_the_python_reference_once(site):
    reference = site("python_reference")
    page = "\n".join(reference.page(name) for name in reference.SUBJECTS)
    for name in {*nt.__all__} - {"__version__"}:
        assert page.count(f":: neurotact.{name}\n") == 1, name
    for room in PUBLIC_ROOMS[1:]:
        for name in import_module(room).__all__:
            assert page.count(f":: {room}.{name}\n") == 1, name
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


EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
PUBLIC_ROOMS = ("neurotact", "neurotact.baselines", "neurotact_parts.opponents")


@pytest.mark.parametrize("example", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_example_is_short_and_imports_public_names_alone(example):
    text = example.read_text(encoding="utf-8")
    tree = ast.parse(text)
    title, line = (ast.get_docstring(tree) or "").splitlines()[:2]
    assert len(line) == len(title) > 0
    assert set(line) == {"="}
    assert len(text.splitlines()) < 60
    assert "plt.show()" in text or "figure = nt.plot_raster(" in text
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            assert {each.name for each in node.names if each.name.startswith("neurotact")} <= {"neurotact"}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("neurotact"):
            assert node.module in PUBLIC_ROOMS
            assert {each.name for each in node.names} <= set(import_module(node.module).__all__)


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "theme", "is_dark"), [
    ("dark", "auto", True), ("light", "auto", False), ("light", "dark", True), ("dark", "light", False),
])  # fmt: skip
def test_in_a_browser_pictures_are_dark_where_the_site_is(scheme, theme, is_dark, tmp_path):
    style = (ROOT / "docs" / "site" / "static" / "site.css").read_text()
    (tmp_path / "page.html").write_text(
        f"<style>{style}</style><body data-theme={theme}><article class=content><img><pre>{'command ' * 40}</pre>"
    )
    with browser(tmp_path / "profile") as chromium:
        chromium.open(tmp_path / "page.html", 400, scheme=scheme)
        drawn = chromium.evaluate("getComputedStyle(document.querySelector('img')).filter")
        assert ("invert" in drawn) == is_dark
        assert chromium.evaluate("document.documentElement.scrollWidth") <= 400


def test_there_are_examples():
    assert len(EXAMPLES) >= 15


def test_a_page_is_reachable_by_keyboard_and_screen_reader(site):
    change = site("reachable").reachable
    signature = "<dt>f(<dl>\n<dd><em>a</em>,</dd>\n<dd><em>b</em></dd>\n</dl>)</dt>"
    page = f'<p role="heading">x</p><pre>y</pre><dl class="py function">{signature}<dd>z</dd></dl>'
    made = change(page)
    assert made.count("<dd>") == 1
    assert made.count('class="sig-line"') == 2
    assert '<pre tabindex="0">' in made
    assert 'aria-level="2"' in made
    corner = '<th class="head"><p></p></th><th class="head text-right"></th><th class="head"><p>ms</p></th>'
    assert change(corner) == '<td class="head"></td><td class="head text-right"></td><th class="head"><p>ms</p></th>'
    assert change("<th></th><th>pitch</th>") == "<td></td><th>pitch</th>"
    assert change('<p><img alt="x" src="_images/x.png" />\n</p>') == (
        '<p><a href="_images/x.png"><img alt="x" src="_images/x.png" /></a></p>'
    )
    linked = '<p><a href="x.html"><img alt="x" src="x.png" /></a></p>'
    assert change(linked) == linked
    results = change('<div id="search-results"></div>')
    assert results.startswith("<h1>Search</h1>")
    assert change(made + results) == made + results
