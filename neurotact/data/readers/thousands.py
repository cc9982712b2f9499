"""Signs between thousands: `1.234` and `1,234` may be 1234 or 1.234, which the other cells of a column tell."""

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np

SIGNS = ".,'\u2019`\u00b4\u00b7\u02d9_ \u00a0\u2007\u2008\u2009\u200a\u202f\u066c"
"""Signs that separate thousands: points, commas, apostrophes, underscores and blanks of any width."""
THOUSANDS = re.compile(
    rf"[+-]?(\d{{1,3}}([{SIGNS}])\d{{3}}(\2\d{{3}})*|\d{{1,2}}([{SIGNS}])\d{{2}}(\4\d{{2}})*\4\d{{3}})([.,]\d*)?",
    re.ASCII,
)
"""A number with signs between its thousands, those of India included; `1.234` is one, too."""
CUT, END = re.compile(r"[+-]?\d{1,3}", re.ASCII), re.compile(r"\d{2,3}([.,]\d*)?", re.ASCII)
"""A number that ends at a separator of thousands, and what stands after it."""
NUMBER_OF_ANY_SIGN = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
LOOKED_AT = 1000
"""Values of a column that tell at once that most columns have no separators of thousands."""
NEAR_IN_FLOAT32 = 0.05
"""Error of a thousandth of a number below 1000 in float32."""

Grouping = Literal["no", "perhaps", "yes"]


def grouping_of(cells: Iterable[str], mark: str) -> Grouping:
    """Whether `mark` separates the thousands in the cells of a column.

    It does not if a number has another number of digits after it, begins with a zero, or has four digits without it.
    It does if another number has no mark, but for zero: a program that writes decimals writes them in all numbers, or
    leaves out zeros at their end.

    >>> grouping_of(["1.234", "850"], "."), grouping_of(["1.234", "850.5"], "."), grouping_of(["1.234", "2.000"], ".")
    ('yes', 'no', 'perhaps')
    """
    marked, repeated = _marked(mark)
    n_marked = n_plain = n_zeros = n_sure = n_ends = 0
    for cell in cells:
        if marked.fullmatch(cell):
            n_marked += 1
            n_ends += cell.endswith("0")
        elif CUT.fullmatch(cell):
            is_zero = not cell.strip("+-0")
            n_zeros += is_zero
            n_plain += not is_zero
        elif repeated.fullmatch(cell):
            n_sure += 1
        elif NUMBER_OF_ANY_SIGN.fullmatch(cell):
            return "no"
    if n_sure or (n_marked and (n_plain or (n_zeros and n_ends))):
        return "yes"
    return "perhaps" if n_marked else "no"


@lru_cache
def _marked(mark: str) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Numbers with one mark, and those with several marks or with decimals."""
    sign = re.escape(mark)
    one = re.compile(rf"[+-]?[1-9]\d{{0,2}}{sign}\d{{3}}", re.ASCII)
    more = rf"({sign}\d{{3}}){{2,}}([.,]\d*)?|({sign}\d{{3}})+[{'.' if mark == ',' else ','}]\d*"
    return one, re.compile(rf"[+-]?[1-9]\d{{0,2}}({more})", re.ASCII)


def splits_thousands(row: Sequence[str], n_columns: int) -> bool:
    """Whether the cells of a row may be those of `n_columns` numbers, cut at their separators of thousands.

    >>> splits_thousands(["1", "234", "850"], 2), splits_thousands(["1", "2", "850"], 1)
    (True, False)
    """
    n_ends = sum(bool(CUT.fullmatch(before) and END.fullmatch(after)) for before, after in pairwise(row))
    return n_ends >= len(row) - n_columns > 0


def may_be_grouped(values: np.ndarray) -> bool:
    """Whether numbers may be whole ones of which a separator of thousands made decimals: below 1000, none between 0
    and 1, with three decimals at most.

    >>> may_be_grouped(np.array([1.234, 850.0])), may_be_grouped(np.array([1.2345])), may_be_grouped(np.array([0.5]))
    (True, False, False)
    """
    for some in (values[:LOOKED_AT], values):
        size = np.abs(some)
        if not ((size < 1000) & ((size >= 1) | (size == 0))).all() or not has_decimals(size, 3).all():
            return False
    return len(values) > 0


def has_decimals(size: np.ndarray, decimals: int, near: float = 1e-6) -> np.ndarray:
    """Of each number below 1000, whether it has so many decimals at most, to `near` of the last one."""
    scaled = size * 10.0**decimals
    return np.abs(scaled - np.rint(scaled)) < near


def telling(values: np.ndarray, n_each: int = 500) -> np.ndarray:
    """The places of some values whose cells tell whether they are grouped: without decimals, with few, and others."""
    size = np.abs(values)
    is_whole, is_short = has_decimals(size, 0), has_decimals(size, 2)
    kinds = (is_whole, is_short & ~is_whole, ~is_short)
    return np.unique(np.concatenate([np.flatnonzero(kind)[:n_each] for kind in kinds]))
