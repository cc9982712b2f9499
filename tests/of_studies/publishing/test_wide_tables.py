"""Tables in LaTeX fit the page: a wide one becomes several, and a LaTeX engine takes each without a complaint."""

import shutil
import string
import subprocess

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.publishing.wide_tables import MOST, PAGE, in_latex_parts, in_parts

from neurotact.tables import LATEX, PACKAGES, latex_columns, to_latex

HEADINGS = st.lists(st.text("ab_ ", min_size=1, max_size=30), min_size=1, max_size=40)


@given(HEADINGS, st.integers(1, 3))
def test_the_parts_have_every_column_and_fit_the_page(headings, n_names):
    names = {f"name {n}": ["all"] * 2 if n else ["a", "b"] for n in range(n_names)}
    table = pd.DataFrame(names | {f"{heading} {n}": [1.5, 2.5] for n, heading in enumerate(headings)})
    parts = in_parts(table)
    assert list(dict.fromkeys(column for part in parts for column in part)) == [*table]
    assert all(next(iter(part)) == "name 0" for part in parts)
    assert all(sum(width for _, width, _ in latex_columns(part)) <= PAGE for part in parts)
    assert all(len(part.columns) > 1 for part in parts)
    assert in_latex_parts(table, "a caption").count(r"\caption{a caption") == len(parts)


def test_columns_of_one_value_name_no_row():
    table = pd.DataFrame(
        {"dataset": ["all"] * 2, "label": ["a", "b"], **{f"measure {n}": [1.5, 2.5] for n in range(20)}}
    )
    first, *others = in_parts(table)
    assert [*first][:2] == ["dataset", "label"]
    assert {next(iter(part)) for part in others} == {"label"}


def test_a_table_that_no_paper_prints_stays_a_csv():
    assert in_latex_parts(pd.DataFrame({"n": range(MOST)}), "")
    assert in_latex_parts(pd.DataFrame({"n": range(MOST + 1)}), "") == ""


def has_latex() -> bool:
    """Whether LaTeX and the packages that tables need are here."""
    found = shutil.which("pdflatex") and shutil.which("kpsewhich")
    return bool(found) and subprocess.run(["kpsewhich", "siunitx.sty"], capture_output=True).returncode == 0


@pytest.mark.thorough
@pytest.mark.skipif(
    not has_latex(), reason="needs pdflatex with siunitx; the laws of tests/test_tables_on_disk.py hold"
)
def test_latex_takes_tables_with_all_signs_and_sizes_without_a_complaint(tmp_path):
    signs = [*LATEX, *string.printable.strip(), "äéñøß", "--", "''", "*a", "[b]", "\x07"]
    every = " ".join(signs)
    numbers = pd.DataFrame({
        "a name": [f"{n} {'long words ' * (n % 5)}" for n in range(15)],
        **{f"sops_of_column_{n}": 10.0 ** np.linspace(-n, n, 15) * (-1) ** n for n in range(20)},
    })  # fmt: skip
    tables = [
        to_latex(pd.DataFrame({every[:40]: signs[:30], "n": 1e-7, "nan": [np.nan, np.inf, -np.inf] * 10}), every),
        to_latex(pd.DataFrame({"sign": signs[30:60], "text": [every[:30]] * 30})),
        to_latex(pd.DataFrame({sign: ["a"] for sign in signs[:20]})),
        in_latex_parts(numbers, "Numbers"),
        "\\onecolumn",
        to_latex(pd.DataFrame({"sign": signs[60:] * 3, "n": [0.5] * 3 * len(signs[60:])}), "Long"),
    ]
    assert [table.count(r"\begin{longtable}") for table in tables] == [0, 0, 0, 0, 0, 1]
    text = "\n\\clearpage\n".join(tables)
    (tmp_path / "t.tex").write_text(
        f"\\documentclass[twocolumn]{{article}}\n{PACKAGES}\n\\begin{{document}}\n{text}\n\\end{{document}}\n"
    )
    done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "t"], cwd=tmp_path, capture_output=True)
    lines = done.stdout.decode(errors="replace").splitlines()
    bad = [line for line in lines if line.startswith(("!", "Overfull", "Missing", "LaTeX Warning: Float"))]
    assert (done.returncode, bad) == (0, [])
