"""One quantity has one value in all tables of docs/data, and what a page shows of them stands in them."""

import csv
import re
import sys
from itertools import combinations, pairwise
from pathlib import Path

import pandas as pd
import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from PIL import Image

ROOT = Path(__file__).parents[1]
DATA = ROOT / "docs" / "data"
sys.path.insert(0, str(ROOT / "benchmarks"))
import pictures  # noqa: E402

sys.path.remove(str(ROOT / "benchmarks"))
NUMBER = re.compile(r"(?<![\w.])\d+(?:,\d{3})*(?:\.\d+)?")
DEFAULT = {"start": "repeated (default)"}
RANDOM = {"start": "random, earlier calibration"}
SAME = [
    (("training-length", "{t_ref}", ["accuracy (%)", "SOPs"], {**DEFAULT, "window (ms)": "150", "patience": "7"}),
     ("refractory-period-baselines", "{t_ref}", ["accuracy (%)", "SOPs"], {"baseline": "mean, the paper's: acausal"})),
    (("training-length", "{window (ms)}", ["accuracy (%)", "SOPs"], {**DEFAULT, "t_ref": "5&5", "patience": "7"}),
     ("minimal-duration", "{length (ms)}", ["accuracy (%)", "SOPs"], {**DEFAULT, "networks": "5&5, N = 30"})),
    (("network-selection-lengths", "{window (ms)}", ["test accuracy (%)"], DEFAULT),
     ("minimal-duration", "{length (ms)}", ["accuracy (%)"], {**DEFAULT, "networks": "1&1"})),
    (("start-position", "", ["1&1: accuracy of each seed (%)", "1&1: SOPs"], {"start": "mean over starts"}),
     ("refractory-period-over-starts", "", ["accuracy, mean over starts (%)", "SOPs"],
      {"data set": "mixed", "t_ref": "1&1"})),
    (("search-cells-random-start", "{data set}", ["test (%)", "SOPs"], {"what": "shipped network"}),
     ("training-length-refractory-period", "{data set}", ["patience 7: test accuracy (%)", "patience 7: SOPs"],
      RANDOM)),
    (("contact-materials-landing", "{task, set-up}", ["random landing (%)"], {}),
     ("contact-materials-all-four", "all four, {set-up}", ["ours"], {"classifier": "RLS", "quantity": "error (%)"})),
    (("contact-materials-landing", "{task, set-up}", ["random landing (%)"], {}),
     ("contact-materials-pairs", "{pair}, {set-up}", ["ours"], {"classifier": "RLS", "quantity": "test error (%)"})),
    (("stiffness-protocols", "{network} {features}", ["honest (%)"], {}),
     ("stiffness", "{network} {features}", ["ours"], {"quantity": "accuracy (%)"})),
    (("object-compliance-placing", "{inputs}", ["published (%)", "random, paper (%)", "random, honest (%)"], {}),
     ("object-compliance", "{sensor}, {moments}", ["published (%)", "paper (%)", "honest (%)"], {"bits": "12"})),
    (("texture-baselines", "{system}", ["150 ms"], {"start": "repeated"}),
     ("texture-baselines-lif-150-ms", "{system}", ["test accuracy (%)"], {})),
]  # fmt: skip
"""Pairs of a table, the name of its rows, columns and those rows alone: both sides have the same quantities."""
ELSEWHERE = {
    "benchmarks.md", "one-task-all-ways.md", "own-recordings.md", "public-scores.md", "real-sets.md",
    "results/saving.md", "touch-modality.md",
}  # fmt: skip
"""Pages whose tables also have settings, sums over the rows of a table, or runs of which no table is kept."""


def read(name: str) -> pd.DataFrame:
    return pd.read_csv(DATA / f"{name}.csv", dtype=str, keep_default_na=False)


def quantities(name: str, key: str, columns: list[str], where: dict[str, str]) -> dict[tuple[str, int], str]:
    """The first number of each cell, by the name of its row and the place of its column."""
    rows = [row for row in read(name).to_dict("records") if all(row[column] == is_ for column, is_ in where.items())]
    assert len({key.format(**row) for row in rows}) == len(rows) > 0, f"{name}: rows that are not told apart"
    cells = {
        (key.format(**row), place): NUMBER.search(row[column]) for row in rows for place, column in enumerate(columns)
    }
    return {cell: found[0] for cell, found in cells.items() if found}


def value(number: str) -> float:
    return float(number.replace(",", ""))


def unit(number: str) -> float:
    """The unit of the last digit that is written: 0.1 of 91.2, 10 of 6650."""
    digits = number.replace(",", "")
    return 10.0 ** (-len(digits.split(".")[1]) if "." in digits else len(digits) - len(digits.rstrip("0")))


def agree(one: str, other: str) -> bool:
    return abs(value(one) - value(other)) <= 0.5001 * max(unit(one), unit(other))


@pytest.mark.parametrize(("one", "other", "expected"), [
    ("91.2", "91.2", True), ("6654", "6650", True), ("91.25", "91.2", True), ("91.2", "91.3", False),
    ("6,654", "6645", False),
])  # fmt: skip
def test_numbers_agree_to_the_digits_that_are_told(one, other, expected):
    assert agree(one, other) == expected


@pytest.mark.parametrize(("one", "other"), SAME, ids=[f"{one[0]} and {other[0]}" for one, other in SAME])
def test_a_quantity_has_one_value_in_all_tables(one, other):
    left, right = quantities(*one), quantities(*other)
    both = left.keys() & right.keys()
    assert both
    assert not {cell: (left[cell], right[cell]) for cell in both if not agree(left[cell], right[cell])}


def test_a_claim_has_one_verdict_in_both_tables():
    both = read("claims-by-study").merge(read("texture-claims"), on=["study", "claim"], suffixes=("", " there"))
    assert len(both) > 50
    assert (both["published"] == both["published there"]).all()
    assert (both["reproduced"] == both["verdict"]).all()


def shown(page: str) -> list[tuple[str, str]]:
    """The numbers of a page's tables that have a decimal or four digits, outside code and links, by the row's name."""
    rows = [[plain(cell) for cell in line.strip("|").split("|")] for line in page.splitlines() if line[:1] == "|"]
    numbers = [(name, number) for name, *cells in rows for cell in cells for number in NUMBER.findall(cell)]
    return [(name, number) for name, number in numbers if "." in number or value(number) >= 1000]


def plain(cell: str) -> str:
    return re.sub(r"`[^`]*[0-9][^`]*`|\]\([^)]*\)|[`*\[\]]", "", cell).strip()


def test_numbers_of_a_page_are_those_of_its_tables_alone():
    page = "In 95.5 % of 1,234.\n| a | b |\n|---|---|\n| `c` 7.7 | `0.5` [12.5 ± 3](x-9.9.csv), 1,400 and 17 |\n"
    assert shown(page) == [("c 7.7", "12.5"), ("c 7.7", "1,400")]


WITH_TABLES = [
    page
    for page in sorted((ROOT / "docs").rglob("*.md"))
    if re.search(r"data/[\w.-]+\.csv", page.read_text(encoding="utf-8"))
    and str(page.relative_to(ROOT / "docs")) not in ELSEWHERE
]


@pytest.mark.parametrize("page", WITH_TABLES, ids=lambda page: page.stem)
def test_what_a_page_shows_stands_in_a_table_that_it_links(page):
    """In a table that has rows of the same name, in these."""
    text = page.read_text(encoding="utf-8")
    linked = sorted(set(re.findall(r"data/([\w.-]+\.csv)", text)))
    tables = [list(csv.reader((DATA / name).read_text(encoding="utf-8").splitlines())) for name in linked]
    missing = []
    for name, number in shown(text):
        rows = [row for table in tables for row in [row for row in table if name and name in row] or table]
        there = {value(found) for row in rows for cell in row for found in NUMBER.findall(cell)}
        places = len(number.partition(".")[2])
        missing += [] if value(number) in {round(other, places) for other in there} else [(name, number)]
    assert not missing


# --- pictures that are drawn from these tables ---------------------------------------------------------


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_a_picture_is_that_of_its_table_as_it_is_now(name):
    """If not: python benchmarks/pictures.py NAME."""
    with Image.open(ROOT / "docs" / "images" / f"{name}.png") as image:
        assert image.info["Description"] == pictures.PICTURES[name].hash()


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_a_page_with_a_picture_links_its_tables(name):
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md")]
    shown = [page for page in pages if f"images/{name}.png)" in page]
    assert any(all(f"data/{table}.csv)" in page for table in pictures.PICTURES[name].tables) for page in shown)


def texts_of(figure: Figure) -> list[Text]:
    """What is written in a figure: without labels of ticks that lie outside their axis."""
    outside = {
        label
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
        for label in (tick.label1, tick.label2)
        if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
    }
    every = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [text for text in every if text not in outside]


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_a_picture_has_letters_that_a_phone_shows_apart_from_each_other(name):
    """Of 9 pixels where a page of 400 leaves 368 for a picture."""
    with rc_context(pictures.RC):
        figure = pictures.PICTURES[name].figure()
        figure.draw_without_rendering()
        told = [(text.get_text(), text.get_fontsize(), text.get_window_extent()) for text in texts_of(figure)]
    assert len(told) > 2
    assert [words for words, points, _ in told if points / 72 / figure.get_figwidth() * 368 < 9] == []
    inside = figure.bbox.padded(1)
    assert [words for words, _, box in told if not (inside.contains(*box.min) and inside.contains(*box.max))] == []
    boxes = [(words, box.padded(-0.5)) for words, _, box in told]
    assert [(one, other) for (one, its), (other, box) in combinations(boxes, 2) if its.overlaps(box)] == []


DRAWN = {
    "braille-reading": ["published (%)", "best epoch on test letters (%)", "last epoch (%)"],
    "unknown-start": ["on random starts (%)"],
    "benchmarks": ["ratio"],
    "calibration-polarity": ["network, with the falling signal (%)"],
    "recipe-ablation": ["points lost, from"],
    "public-scores": ["published (%)"],
    "savings": ["memory-45nm_saved", "sops_saved", "lost_test"],
}
"""Columns of which a picture has every number."""


@pytest.mark.parametrize("name", DRAWN)
def test_a_picture_has_the_numbers_of_its_table(name):
    picture = pictures.PICTURES[name]
    table = pictures.read(picture.tables[0])
    drawn = {round(float(x), 6) for axes in picture.figure().axes for line in axes.lines for x in line.get_xdata()}
    expected = {
        round(number, 6) for column in DRAWN[name] for cell in table[column] for number in pictures.numbers(cell)
    }
    assert expected - drawn == set()


def test_a_line_of_training_length_has_its_accuracies():
    table = pictures.read("training-length")
    figure = pictures.PICTURES["training-length"].figure()
    rows = table[(table["start"] == "repeated (default)") & (table["t_ref"] == "1&1")]
    by_patience = {
        patience: [float(cell) for cell in cells] for patience, cells in rows.groupby("patience")["accuracy (%)"]
    }
    drawn = [list(container.lines[0].get_ydata()) for container in figure.axes[0].containers]
    assert drawn == [by_patience["7"], by_patience["30"]]


def test_bars_of_claims_count_the_verdicts_and_add_up():
    table = pictures.read("texture-claims")
    bars = [bar for bar in pictures.PICTURES["texture-claims"].figure().axes[0].patches if isinstance(bar, Rectangle)]
    assert sum(bar.get_width() for bar in bars) == len(table)
    assert sum(bar.get_width() for bar in bars[: len(bars) // 3]) == table["verdict"].str.startswith("yes").sum()
    thirds = [bars[first :: len(bars) // 3] for first in range(len(bars) // 3)]
    assert all(a.get_x() + a.get_width() == b.get_x() for row in thirds for a, b in pairwise(row))
