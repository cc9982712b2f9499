"""Tables in LaTeX that fit the page of a paper: one that is wider becomes several, which repeat what names a row."""

from neurotact.lazily import lazily
from neurotact.tables import latex_columns, to_latex

with lazily():
    import pandas as pd

PAGE = 96
"""Characters in footnotesize across a page of two columns."""
MOST = 200
"""Rows that a paper prints; single trials are for programs."""


def in_parts(table: "pd.DataFrame") -> "list[pd.DataFrame]":
    """The table, or its columns in several tables that are narrow enough; each begins with the columns that name a row.

    >>> wide = pd.DataFrame({"name": ["a", "b"], **{f"measure {n}": [1.5, 2.5] for n in range(20)}})
    >>> [(part.columns[0], len(part.columns)) for part in in_parts(wide)]
    [('name', 9), ('name', 9), ('name', 5)]
    """
    widths = [width for _, width, _ in latex_columns(table)]
    n_names = next((n for n in range(1, len(widths)) if not table.iloc[:, :n].duplicated().any()), 1)
    names = [n for n in range(n_names) if table.iloc[:, n].nunique(dropna=False) > 1]
    parts: list[list[int]] = [[]]
    for column in range(len(widths)):
        if parts[-1] and sum(widths[one] for one in {*names, *parts[-1], column}) > PAGE:
            parts.append([*names] if column not in names else [])
        parts[-1].append(column)
    return [table.iloc[:, part] for part in parts]


def in_latex_parts(table: "pd.DataFrame", caption: str) -> str:
    """LaTeX tables of all columns that fit the page, each with the caption; empty for one of more than `MOST` rows."""
    if len(table) > MOST:
        return ""
    parts = in_parts(table)
    numbered = [f"{caption} ({n} of {len(parts)})" if len(parts) > 1 else caption for n in range(1, len(parts) + 1)]
    return "\n".join(to_latex(part, name) for part, name in zip(parts, numbered, strict=True)) + "\n"
