"""Tables hold the same rows whatever their suffix."""

import csv
import json
import re

import numpy as np
import pandas as pd
import pytest
from costs import sops_table
from hypothesis import given
from hypothesis import strategies as st

from neurotact.errors import InputError
from neurotact.metrics.synops import summary, summary_markdown
from neurotact.tables import (
    LATEX,
    ONE_PAGE,
    escaped,
    in_latex,
    latex_columns,
    read_table,
    to_latex,
    to_markdown,
    write_table,
)

TABLE = pd.DataFrame({"name": ["a|b", "é"], "n": [1, 2], "sops": [1 / 3, np.nan]})


def test_json_and_csv_keep_every_digit(tmp_path):
    for suffix in ("csv", "json"):
        write_table(TABLE, tmp_path / f"t.{suffix}")
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "t.csv"), TABLE, rtol=1e-15)
    assert json.loads((tmp_path / "t.json").read_text()) == [
        {"name": "a|b", "n": 1, "sops": 1 / 3},
        {"name": "é", "n": 2, "sops": None},
    ]


def test_markdown_begins_with_what_it_is_about(tmp_path):
    write_table(TABLE, tmp_path / "t.md", about="# Title\n")
    head, *rows = (tmp_path / "t.md").read_text().split("\n\n")[1].splitlines()
    assert (tmp_path / "t.md").read_text().startswith("# Title\n\n| name |")
    assert head == "| name | n | sops |"
    assert rows[1:] == ["| a\\|b | 1 | 0.333333 |", "| é | 2 | - |"]


def test_the_sops_of_single_windows_stand_under_their_means():
    table = sops_table(labels=["a", "b"], predicted=["b", "b"], steps=[300, 100], input_spikes=[10, 0],
                     hidden_spikes=[4, 0], n_hidden=30, n_readout=8, recurrent=True)  # fmt: skip
    told = summary_markdown(summary(table), "run, full window")
    assert "| all | 2 | 0.5 | 200 |" in told
    assert told.startswith("# Synaptic operations (SOPs) of run, full window")
    sides = summary_markdown(summary(table.assign(side=["test", "training"])), "run, full window")
    assert "the sides of the split apart" in sides
    assert "| training | all | 1 | 1 (seen in training) | 100 |" in sides
    assert "| test | all | 1 | 0 | 300 |" in sides


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"t\.xls.*\.csv, \.json, \.md"):
        write_table(TABLE, tmp_path / "t.xls")


NAMES = st.text(st.sampled_from("=+-@'\t\r\n1.eax|*_`<&;~[](\\ "), min_size=1, max_size=6)


@given(names=st.lists(NAMES.filter(lambda name: not looks_like_a_number(name)), min_size=1, max_size=5), column=NAMES)
def test_no_cell_of_a_csv_is_a_formula_and_every_name_comes_back(tmp_path, names, column):
    table = pd.DataFrame({"label": names, "n": range(len(names))}).rename(columns={"label": f"x{column}"})
    write_table(table, tmp_path / "t.csv")
    with open(tmp_path / "t.csv", newline="") as file:
        rows = list(csv.reader(file))
    assert not [cell for row in rows for cell in row if len(cell) > 1 and cell[0] in "=+-@\t\r\n"]
    again = read_table(tmp_path / "t.csv", dtype={f"x{column}": str}, keep_default_na=False)
    assert again.iloc[:, 0].tolist() == [one_line_end(name) for name in names]
    assert list(again) == [one_line_end(name) for name in table]


def one_line_end(name: str) -> str:
    return name.replace("\r\n", "\n").replace("\r", "\n")


def looks_like_a_number(name: str) -> bool:
    try:
        float(name)
    except ValueError:
        return False
    return True


SHOWN = {latex: letter for letter, latex in LATEX.items()}
LATEX_NAMES = st.text(st.sampled_from([*SHOWN.values(), *"a1 é-'"]), min_size=1, max_size=6)
ESCAPE = re.compile(
    "|".join(
        [*map(re.escape, sorted(SHOWN, key=len)[::-1]), r"(?<=-)\{\}(?=-)", "[^" + re.escape("".join(LATEX)) + "]"]
    )
)


def read_latex(cell: str) -> str:
    """What LaTeX shows for a cell, without spaces; an error for markup that is not escaped."""
    if stacked := re.fullmatch(r"\\shortstack\{(.*)\}", cell):
        return "".join(map(read_latex, stacked[1].split(r" \\ ")))
    parts = ESCAPE.findall(cell)
    assert "".join(parts) == cell
    assert "--" not in cell, "would be one dash"
    return "".join(SHOWN[part] if part in SHOWN else part.strip("{} ") for part in parts)


@given(st.lists(LATEX_NAMES, min_size=1, max_size=5), LATEX_NAMES)
def test_latex_shows_every_name_and_no_markup(names, column):
    table = pd.DataFrame({f"x{column}": [f"x{name}" for name in names], "n": range(len(names))})
    lines = to_latex(table, f"of x{column}").splitlines()
    assert read_latex(lines[3].removeprefix(r"\caption{").removesuffix("}")) == f"ofx{column}".replace(" ", "")
    cells = [line.removesuffix(r" \\").rsplit(" & ", 1) for line in (lines[6], *lines[8 : 8 + len(names)])]
    assert [read_latex(first) for first, _ in cells] == [
        name.replace(" ", "") for name in (f"x{column}", *table.iloc[:, 0])
    ]
    assert [last for _, last in cells] == ["n", *map(str, range(len(names)))]


@pytest.mark.parametrize("name", ["*a", "[2pt]"])
def test_no_row_of_latex_begins_with_an_option_of_the_row_before(name):
    lines = to_latex(pd.DataFrame({name: [name, name]})).splitlines()
    assert not [line for line in lines if line.startswith(("*", "["))]


def test_room_for_a_power_is_counted():
    ((_, plain, _), (_, power, _)) = latex_columns(pd.DataFrame({"a": [-1.25], "b": [-1.25e-12]}))
    assert (plain, power) == (5 + 1.5, 12 + 1.5)


def test_what_cannot_be_printed_is_a_question_mark_in_latex():
    assert in_latex("a\x07b\u200bc") == "a?b?c"


@pytest.mark.parametrize(("texts", "kind"), [
    ([1.5, 20.25], "S[table-format=2.2]"), ([-1e-12, 5.0], "S[table-format=-1.0e-2]"), ([1.0, 20.0], "r"),
    (["12,937", "99.0"], "r"), (["58.8 ± 2.1", "-"], "r"), (["1&1", "2"], "l"),
    (["a" * 33], r">{\raggedright\arraybackslash}p{16em}"), (["a" * 32], "l"),
])  # fmt: skip
def test_decimals_are_aligned_figures_stand_to_the_right_and_long_texts_may_break(texts, kind):
    assert [one for one, *_ in latex_columns(pd.DataFrame({"a": texts}))] == [kind]


def test_headings_break_where_words_do():
    ((_, width, (heading, _)),) = latex_columns(pd.DataFrame({"exit_sops_total_feedforward": [1]}))
    assert heading == r"\shortstack{exit\_ \\ sops\_ \\ total\_ \\ feedforward}"
    assert width == 11 + 1.5


@pytest.mark.parametrize(("length", "place"), [(20, "table"), (32, "table*")])
def test_a_table_too_wide_for_one_column_takes_both(length, place):
    table = pd.DataFrame({"name": ["a" * length], "n": ["b" * 20]})
    assert rf"\begin{{{place}}}" in to_latex(table).splitlines()


@pytest.mark.parametrize("rows", [0, 1, ONE_PAGE, ONE_PAGE + 1])
def test_a_latex_table_has_the_rules_of_booktabs_and_ends_what_it_begins(tmp_path, rows):
    write_table(
        pd.DataFrame({"label": ["a"] * rows, "n": [-2.5e-9] * rows}), tmp_path / "t.tex", "# Of `a`\\_b\n\nRest."
    )
    text = (tmp_path / "t.tex").read_text()
    assert re.findall(r"\\begin\{(.+?)\}", text) == re.findall(r"\\end\{(.+?)\}", text)[::-1]
    assert (r"\begin{longtable}" in text) == (rows > ONE_PAGE)
    assert [text.count(rf"\{rule}rule") for rule in ("top", "mid", "bottom")] == [1, 1, 1]
    assert text.count(r"a & -2.5e-09 \\") == rows
    assert r"\caption{Of a\_b}" in text


def test_latex_shows_numbers_as_in_print():
    lines = to_latex(pd.DataFrame({"n": [-5.0, 1e20, 0.25, np.nan]})).splitlines()
    assert lines[3:10:6] == [r"\begin{tabular}{S[table-format=-1.2e-2]}", r"0.25 \\"]
    assert lines[7:11] == [r"-5 \\", r"1e+20 \\", r"0.25 \\", r"{-} \\"]
    assert to_latex(pd.DataFrame({"n": [-5]})).splitlines()[7] == r"$-5$ \\"


def test_numbers_and_ordinary_names_are_written_as_they_are(tmp_path):
    table = pd.DataFrame({"-n": [-1.5, 2.0], "label": ["P0.5-a", "'felt'"], "t_ref_ms": ["-1e-3", "+2"]})
    write_table(table, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == "'-n,label,t_ref_ms\n-1.5,P0.5-a,-1e-3\n2.0,'felt',+2\n"
    assert list(read_table(tmp_path / "t.csv")) == ["-n", "label", "t_ref_ms"]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("sops_total", "sops_total"), ("1&1", "1&1"), ("a|b", "a\\|b"), ("*a*", "\\*a\\*"), ("_a_", "\\_a\\_"),
        ("`a`", "\\`a\\`"), ("<b>", "\\<b>"), ("a\nb\r\n| c", "a b \\| c"), ("[a](b)", "[a]\\(b)"), ("&lt;", "\\&lt;"),
        ("a\\|b", "a\\\\\\|b"), ("~~a~~", "\\~\\~a\\~\\~"),
    ],
)  # fmt: skip
def test_markup_is_escaped(text, shown):
    assert escaped(text) == shown
    assert to_markdown(pd.DataFrame({text: [text]})).splitlines()[::2] == [f"| {shown} |"] * 2
