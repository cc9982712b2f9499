"""Tables on disk: .csv and .json to be computed with, .md for people, .tex for papers.

A class may have any name. In a .csv, a text that a spreadsheet would run as a formula gets the prefix `'`, which
`read_table` removes again; in a .md and a .tex, markup is escaped.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from neurotact.errors import InputError
from neurotact.files import existing, whole
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


SUFFIXES = (".csv", ".json", ".md", ".tex")
NETWORK = ["setting", "pair", "hidden"]
LAYERS = "layers"
"""Column of results with a network of several hidden layers: the neurons of each, as 20+10; or `UNCOUNTED`."""
UNCOUNTED = "not counted"
FORMULA = re.compile(r"'*[=+\-@\t\r\n].", re.DOTALL)
"""A text that a spreadsheet runs as a formula, or that starts with ' already."""
NUMBER = re.compile(r"[+-](\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
MARKUP = re.compile(r"[\\|*`<~]|(?<![^\W_])_|_(?![^\W_])|(?<=\])\(|&(?=#?\w+;)")
"""Characters that Markdown reads as markup; an underscore within a word is not."""
SIGNS = "pm times cdot le ge approx to infty surd circ mu mu Omega Delta Sigma alpha beta gamma delta lambda sigma tau"
LATEX = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}", "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}",
    '"': r"{\char34}", "`": r"\textasciigrave{}", "[": "{[}", "]": "{]}", "*": "{*}", "²": "$^2$", "³": "$^3$",
    **{sign: f"$\\{name}$" for sign, name in zip("±×·≤≥≈→∞√°µμΩΔΣαβγδλστ", SIGNS.split(), strict=True)},  # noqa: RUF001
    "\N{MINUS SIGN}": "$-$", "…": r"\ldots{}",
}  # fmt: skip
"""What stands in LaTeX for its markup and for signs; after the end of a row, `[` and `*` would be its options."""
ONE_PAGE = 40
"""Lines of a LaTeX table that stays on one page."""
PACKAGES = r"\usepackage[T1]{fontenc} \usepackage{array,booktabs,longtable,siunitx}"
COLUMN, LONGEST, HEADING = 46, 32, 12
"""Characters in footnotesize of one column of a paper, and of a text or a heading of a table on one line."""
AMOUNT = re.compile(r"(-?)(\d+)(?:\.(\d+))?(?:e[+-]0*(\d+))?")
FIGURES = re.compile(r"[-\u2212+±\d.,% ]*\d[-\u2212+±\d.,% ]*|[-\u2013\u2014]?")
"""A text of figures alone, or none."""


def write_table(table: pd.DataFrame, path: str | Path, about: str = "") -> None:
    """Write a table in the format of its suffix, whole or not at all; a missing number is empty, or null in JSON.

    about: Markdown above the table in a .md file; its first paragraph is the caption in a .tex file.
    Raises InputError for a suffix that is not .csv, .json, .md or .tex.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: cannot be written as '{suffix}'; known: {', '.join(SUFFIXES)}")
    with whole(path) as draft:
        if suffix == ".csv":
            _with_text(table, _guarded).to_csv(draft, index=False, lineterminator="\n")
            return
        if suffix == ".md":
            text = "\n\n".join(filter(None, (about.strip(), to_markdown(table))))
        else:
            text = to_json(table) if suffix == ".json" else to_latex(table, _first_paragraph(about))
        draft.write_bytes(f"{text}\n".encode())


def read_table(path: str | Path, **how: Any) -> pd.DataFrame:
    """A .csv that `write_table` wrote, with its texts as they were; `how` as of pandas.read_csv.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "table.csv"
    >>> write_table(pd.DataFrame({"label": ["=1+1", "felt"], "n": [-1, 2]}), path)
    >>> path.read_text().splitlines()
    ['label,n', "'=1+1,-1", 'felt,2']
    >>> read_table(path)["label"].tolist()
    ['=1+1', 'felt']
    """
    return _with_text(pd.read_csv(existing(path), **how), _unguarded)


def _with_text(table: pd.DataFrame, change: Callable[[Any], Any]) -> pd.DataFrame:
    """The table with its texts and the names of its columns changed; the same where nothing changes."""
    columns = [change(column) for column in table.columns]
    changed = table if columns == list(table.columns) else table.set_axis(columns, axis=1)
    for index, kind in enumerate(table.dtypes):
        if pd.api.types.is_numeric_dtype(kind):
            continue
        column = table.iloc[:, index]
        new = {text: change(text) for text in column.unique() if isinstance(text, str) and change(text) != text}
        if new:
            changed = changed.copy() if changed is table else changed
            changed.isetitem(index, column.map(lambda value, new=new: new.get(value, value)))
    return changed


def _guarded(text: Any) -> Any:
    if isinstance(text, str) and "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")  # pandas quotes a line feed, and no carriage return
    return f"'{text}" if isinstance(text, str) and FORMULA.match(text) and not NUMBER.fullmatch(text) else text


def _unguarded(text: Any) -> Any:
    return text[1:] if isinstance(text, str) and text.startswith("'") and FORMULA.match(text) else text


def natural(value: object) -> list[tuple[int, float, str]]:
    """Sort key of numbers by their size, NaN last, and of texts with numbers in them in natural order.

    >>> sorted(["class 10", "class 2", "Class 1"], key=natural), sorted([3.5, math.nan, -20, 1], key=natural)
    (['Class 1', 'class 2', 'class 10'], [-20, 1, 3.5, nan])
    """
    if isinstance(value, Real):
        return [(1, math.inf if math.isnan(value) else float(value), "")]
    parts = re.split(r"([0-9]+)", str(value))
    return [(1, int(part), "") if part.isdecimal() and part.isascii() else (0, 0, part.casefold()) for part in parts]


def columns_of_network(results: pd.DataFrame) -> list[str]:
    """The columns that tell networks apart."""
    return [*NETWORK, *([LAYERS] if LAYERS in results else [])]


def size_of(row: Mapping[str, Any] | pd.Series) -> str:
    """The hidden neurons of the network of a row of results, of each layer where it has several.

    >>> size_of({"hidden": 30}), size_of({"hidden": 30, "layers": "20+10"})
    ('30', '20+10')
    """
    layers = row.get(LAYERS)
    return layers if layers and isinstance(layers, str) else f"{row['hidden']:.15g}"


def sized(row: Mapping[str, Any] | pd.Series) -> str:
    """The size of the network of a row of results, short.

    >>> sized({"hidden": 30}), sized({"hidden": 0}), sized({"hidden": 0, "layers": UNCOUNTED})
    ('N = 30', 'N = 0', 'N not counted')
    """
    size = size_of(row)
    return f"N {size}" if size == UNCOUNTED else f"N = {size}"


def in_words_of_size(row: Mapping[str, Any] | pd.Series, own_keys: object = None) -> str:
    """The size of a network where there is space; own_keys: of one that is a part, which may not count its neurons.

    >>> in_words_of_size({"hidden": 0}), in_words_of_size({"hidden": 0}, '{"model": "mine"}')
    ('no hidden layer', 'N not counted')
    """
    if row["hidden"] == 0:
        return f"N {UNCOUNTED}" if isinstance(own_keys, str) else "no hidden layer"
    return sized(row)


def means_over(table: pd.DataFrame, by: Sequence[str], measures: Iterable[str], counted: str) -> pd.DataFrame:
    """Means and standard deviations of the groups by `by`, in the order of the table.

    Columns: those of `by`, the number of rows as `counted`, and for each measure its mean under its own name and
    `<measure>_sd` (n - 1 in the denominator; NaN with one row).

    >>> rows = pd.DataFrame({"kind": ["elm", "elm"], "accuracy": [0.5, 1.0]})
    >>> means_over(rows, ["kind"], ["accuracy"], "rows").round(3).values.tolist()
    [['elm', 2, 0.75, 0.354]]
    """
    groups = table.groupby(list(by), sort=False, dropna=False)
    columns: dict[str, Any] = {counted: groups.size()}
    for measure in measures:
        columns[measure] = groups[measure].mean()
        columns[f"{measure}_sd"] = groups[measure].std()
    return pd.DataFrame(columns).reset_index()


def over_seeds(results: pd.DataFrame, measures: Sequence[str]) -> pd.DataFrame:
    """Mean, standard deviation over seeds and their number, for each network, in the order of the table.

    Columns: those of `columns_of_network`, seeds, and the measures as `means_over` gives them.

    >>> rows = {"setting": ["all"] * 2, "pair": ["1&1"] * 2, "hidden": [20] * 2, "accuracy_test": [0.8, 0.9]}
    >>> over_seeds(pd.DataFrame(rows), ["accuracy_test"]).round(3).to_dict("records")
    [{'setting': 'all', 'pair': '1&1', 'hidden': 20, 'seeds': 2, 'accuracy_test': 0.85, 'accuracy_test_sd': 0.071}]
    """
    return means_over(results, columns_of_network(results), measures, "seeds")


def to_json(table: pd.DataFrame) -> str:
    """A record a row, every digit of each number kept.

    >>> print(to_json(pd.DataFrame({"pair": ["1&1"], "sops": [0.1], "isi_ms": [float("nan")]})))
    [
     {"pair": "1&1", "sops": 0.1, "isi_ms": null}
    ]
    """
    rows = [json.dumps(record, allow_nan=False, ensure_ascii=False) for record in records(table)]
    return "[\n " + ",\n ".join(rows) + "\n]" if rows else "[]"


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """The rows as JSON holds them: plain numbers, text and lists of them; None for a missing value."""
    return [{str(key): _or_none(value) for key, value in row.items()} for row in table.to_dict("records")]


def _or_none(value: Any) -> Any:
    return None if pd.api.types.is_scalar(value) and pd.isna(value) else value


def to_markdown(table: pd.DataFrame) -> str:
    """A Markdown table; numbers to six digits, a dash for a missing value.

    >>> print(to_markdown(pd.DataFrame({"label": ["a|b"], "sops": [1234.5678], "exit": [float("nan")]})))
    | label | sops | exit |
    |:--|--:|--:|
    | a\\|b | 1234.57 | - |
    """
    sides = ["--:" if is_number else ":--" for is_number in _are_numbers(table)]
    head, *body = ("| " + " | ".join(map(escaped, line)) + " |" for line in _lines(table))
    return "\n".join([head, f"|{'|'.join(sides)}|", *body])


def _are_numbers(table: pd.DataFrame) -> list[bool]:
    return [pd.api.types.is_numeric_dtype(kind) for kind in table.dtypes]


def _lines(table: pd.DataFrame) -> list[list[str]]:
    """The names of the columns, then the rows."""
    return [list(map(str, table.columns)), *([_text(value) for value in row] for row in table.itertuples(index=False))]


def to_latex(table: pd.DataFrame, caption: str = "") -> str:
    """A LaTeX table with the rules of booktabs and aligned decimals, as `to_markdown` otherwise.

    One that is too wide for a column takes both; a long one may break over pages, in text of one column.

    >>> latex = to_latex(pd.DataFrame({"label": ["a_b"], "gain": [-1.5e-7]}), "Gains & more")
    >>> print(*latex.splitlines()[4:9:2], sep="\\n")
    \\begin{tabular}{lS[table-format=-1.1e-1]}
    label & {gain} \\\\
    a\\_b & -1.5e-07 \\\\
    """
    columns = latex_columns(table)
    head, *body = (" & ".join(line) + r" \\" for line in zip(*(lines for *_, lines in columns), strict=True))
    kinds, small = "".join(kind for kind, *_ in columns), r"\footnotesize\setlength{\tabcolsep}{3pt}"
    title = rf"\caption{{{in_latex(caption)}}}" if caption else ""
    lines, top = [*body, r"\bottomrule"], [r"\toprule", head, r"\midrule"]
    if sum(-(-max(map(len, row)) // LONGEST) for row in _lines(table)[1:]) > ONE_PAGE:
        above = [f"{{{small}", rf"\begin{{longtable}}{{{kinds}}}", title and rf"{title} \\", *top, r"\endhead"]
        lines += [r"\end{longtable}}"]
    else:
        place = "table" if sum(width for _, width, _ in columns) <= COLUMN else "table*"
        above = [rf"\begin{{{place}}}", rf"\centering{small}", title, rf"\begin{{tabular}}{{{kinds}}}", *top]
        lines += [r"\end{tabular}", rf"\end{{{place}}}"]
    return "\n".join(filter(None, [f"% {PACKAGES}", *above, *lines]))


def latex_columns(table: pd.DataFrame) -> list[tuple[str, float, list[str]]]:
    """Of each column: how LaTeX sets it, how many characters wide it is, and its heading and cells."""
    columns = zip(*_lines(table), strict=True)
    return [_latex_column(is_number, *column) for is_number, column in zip(_are_numbers(table), columns, strict=True)]


def _latex_column(is_number: bool, heading: str, *texts: str) -> tuple[str, float, list[str]]:
    broken = textwrap.wrap(heading.replace("_", "_\0 "), HEADING, break_long_words=False)
    broken = [part.replace("_\0 ", "_").removesuffix("\0") for part in broken]
    shown = [r" \\ ".join(map(in_latex, broken)), *map(in_latex, texts)]
    shown[0] = rf"\shortstack{{{shown[0]}}}" if len(broken) > 1 else in_latex(heading)
    amounts = [match for match in map(AMOUNT.fullmatch, texts) if is_number and match]
    width, kind = max(map(len, texts), default=0), "r" if is_number or all(map(FIGURES.fullmatch, texts)) else "l"
    if any(match[3] or match[4] for match in amounts):
        n_whole, n_part, n_power = (max(len(match[n] or "") for match in amounts) for n in (2, 3, 4))
        size = f"{'-' * any(match[1] for match in amounts)}{n_whole}.{n_part}{f'e-{n_power}' if n_power else ''}"
        kind, width = f"S[table-format={size}]", n_whole + n_part + 2 + 7 * bool(n_power)
        shown = [f"{{{shown[0]}}}", *(text if AMOUNT.fullmatch(text) else f"{{{in_latex(text)}}}" for text in texts)]
    elif width > LONGEST:
        kind, width = rf">{{\raggedright\arraybackslash}}p{{{LONGEST / 2:g}em}}", LONGEST
    return kind, 1.5 + max([width, *map(len, broken)]), shown


def in_latex(text: str) -> str:
    """One line of LaTeX that shows a text; a number as in print."""
    number = re.fullmatch(r"(-?)([\d.]+)(?:e([+-]\d+))?", text)
    if number and (number[1] or number[3]):
        power = rf" \times 10^{{{int(number[3])}}}" if number[3] else ""
        return f"${number[1]}{number[2]}{power}$"
    shown = (LATEX.get(letter, letter if letter.isprintable() else "?") for letter in " ".join(text.split()))
    return re.sub("(?<=-)-", "{}-", "".join(shown))  # two would become one dash


def _first_paragraph(markdown: str) -> str:
    """The first paragraph as plain text.

    >>> _first_paragraph("# Runs of a\\\\_b\\n\\nThe rest.")
    'Runs of a_b'
    """
    text = re.sub(r"\\(?=\W|_)|`", "", markdown.strip().partition("\n\n")[0].lstrip("# "))
    return " ".join(text.split())


def _text(value: Any) -> str:
    if isinstance(value, float):
        return "-" if pd.isna(value) else f"{value:.6g}"
    return str(value)


def escaped(text: str) -> str:
    """One line of Markdown that shows `text` as it is.

    >>> print(escaped("a_b | *c* <d>"), escaped("_e_"))
    a_b \\| \\*c\\* \\<d> \\_e\\_
    """
    return MARKUP.sub(r"\\\g<0>", " ".join(text.split()))
