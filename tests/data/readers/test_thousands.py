"""Separators of thousands: numbers are read as they were meant, or refused, and no advice makes others of them."""

import re
from pathlib import Path

import numpy as np
import pytest
from as_specs import of_folder, of_table
from hypothesis import assume, given
from hypothesis import strategies as st
from neurotact_parts.readers.events import files as event_files

import neurotact as nt
from neurotact.data.readers.table import cells as tables
from neurotact.data.readers.table.cells import THOUSANDS, grouping_of
from neurotact.errors import InputError

SIGNS = {"Germany": (".", ","), "the USA": (",", "."), "Switzerland": ("'", "."), "typeset": ("\u2019", "."),
         "France": ("\u202f", ","), "SI": ("\u2009", "."), "Excel": ("\u00a0", ","), "blanks": (" ", ","),
         "Python": ("_", "."), "India": (",", "."), "no country": ("", ".")}  # fmt: skip
"""The sign between thousands and the decimal one."""
OPTION = re.compile(r"`(decimal)='(,)'`|`(header_lines)=(\d+)`")


def written(value: float, locale: str, decimals: int) -> str:
    sign, point = SIGNS[locale]
    whole, _, rest = f"{abs(value):,.{decimals}f}".partition(".")
    groups = whole.split(",")
    if locale == "India" and len(groups) > 1:
        head = "".join(groups[:-1])
        pairs = [head[max(0, end - 2) : end] for end in range(len(head), 0, -2)][::-1]
        groups = [*pairs, groups[-1]]
    return "-" * (value < 0) + sign.join(groups) + (point + rest if rest else "")


class Written:
    """A file of one column per taxel, in the ways of a country."""

    def __init__(self, values, locale, decimals, separator, quoted, named):
        self.values = np.round(np.asarray(values, float), decimals)
        rows = [[written(value, locale, decimals) for value in row] for row in self.values.tolist()]
        quote = '"' if quoted else ""
        names = [f"{quote}p{column}{quote}" for column in range(self.values.shape[1])]
        lines = [*([names] if named else []), *([f"{quote}{cell}{quote}" for cell in row] for row in rows)]
        self.text = "\n".join(separator.join(line) for line in lines) + "\n"


COUNTS = st.one_of(st.integers(1, 5000), st.integers(-5000, 5_000_000))


@given(
    st.integers(1, 3).flatmap(lambda n: st.lists(st.lists(COUNTS, min_size=n, max_size=n), min_size=8, max_size=30)),
    st.sampled_from(sorted(SIGNS)), st.integers(0, 3), st.sampled_from([";", "\t", ",", "|", " "]), st.booleans(),
    st.booleans(), st.sampled_from(["folder", "table"]),
)  # fmt: skip
def test_numbers_are_read_as_they_were_written_or_refused(
    tmp_path_factory, values, locale, decimals, separator, quoted, named, kind
):
    """An option that a refusal names is given, again and again: the numbers are right or refused then, too."""
    are_apart = not {separator, ",", " "} & {*SIGNS[locale]}
    assume(named or quoted or kind == "table" or are_apart)  # else nothing tells where numbers end
    made = Written(values, locale, decimals, separator, quoted, named or kind == "table")
    folder = tmp_path_factory.mktemp("any")
    options: dict[str, str | int] = {}
    for _ in range(3):
        try:
            found = read(folder, made.text, separator, kind, options)
        except InputError as refusal:
            advised = OPTION.search(str(refusal))
            if advised is None or "header_lines" in advised.group():  # which says that the first row is no sample
                return
            name, value = (part for part in advised.groups() if part)
            options |= {name: int(value) if value.isdigit() else value}
        else:
            assert found.shape == made.values.shape
            np.testing.assert_allclose(found, made.values, rtol=1e-6, atol=1e-6)
            return
    pytest.fail("each refusal names another option")


def read(folder: Path, text: str, separator: str, kind: str, options) -> np.ndarray:
    if kind == "folder":
        (folder / "felt").mkdir(exist_ok=True)
        (folder / "felt" / "1.csv").write_text(text, encoding="utf-8")
        return np.asarray(nt.read_folder(folder, 100, "count", **of_folder(options)).signals[0])
    names, *rows = text.splitlines()
    lines = [separator.join(["trial", "label", names]), *(separator.join(["1", "felt", row]) for row in rows)]
    (folder / "all.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return np.asarray(
        nt.read_table(
            folder / "all.csv", 100, "count", **of_table(options | {"columns": named(names, separator)})
        ).signals[0]
    )


def named(names: str, separator: str) -> str:
    return ",".join(name.strip('"') for name in names.split(separator))


@pytest.mark.parametrize(("cells", "mark", "grouping"), [
    ("1.234 850 2.345", ".", "yes"), ("1.234 0 2.340", ".", "yes"), ("1.234.567 2.345", ".", "yes"),
    ("-1,234 -850", ",", "yes"), ("1.234,5 2.345", ".", "yes"), ("1.234 2.345", ".", "perhaps"),
    ("1.234 0 2.345", ".", "perhaps"), ("1.234 850.5", ".", "no"), ("0.234 5", ".", "no"), ("1.234 1850", ".", "no"),
    ("1.234 5.000e3 7", ".", "no"), ("850 1", ".", "no"), ("1.234 nan 850", ".", "yes"),
])  # fmt: skip
def test_what_stands_beside_tells_whether_a_sign_groups(cells, mark, grouping):
    assert grouping_of(cells.split(), mark) == grouping


@given(st.integers(1000, 10**9), st.sampled_from(sorted({*SIGNS} - {"no country"})), st.integers(0, 2))
def test_every_way_to_group_is_known(value, locale, decimals):
    assert THOUSANDS.fullmatch(written(value, locale, decimals))


@given(st.lists(st.integers(-999_999, 999_999), min_size=2, max_size=30), st.integers(0, 6))
def test_decimals_of_one_number_or_as_short_as_they_can_be_are_read(values, decimals):
    """What programs write is no column of thousands: all decimals, or none at the end that is zero."""
    numbers = [value / 10**decimals for value in values]
    for form in (f"{{:.{decimals}f}}", "{!r}", "{:g}"):
        cells = [form.format(number) for number in numbers]
        if grouping_of(cells, ".") == "yes":
            assert all(len(cell.partition(".")[2]) in (0, 3) for cell in cells)
            assert form != "{:.3f}"
            continue
        text = "\n".join(f"{cell},{cell}" for cell in cells)
        np.testing.assert_array_equal(tables.numbers(text, "a.csv")[:, 1], [float(cell) for cell in cells])


@pytest.mark.parametrize(("times", "message"), [
    (["850", "1.234", "2.345"], "has separators of thousands, as in '1.234'"),
    (["850", "1 234", "2 345"], "has separators of thousands, as in '1 234'"),
    (["850", "1_234", "2_345"], "has separators of thousands, as in '1_234'"),
    (["0,5", "1.25", "2,5"], "has decimal commas, as in 0,5; write decimal points"),
])  # fmt: skip
def test_times_of_events_are_read_as_they_were_written_or_refused(tmp_path, times, message):
    path = tmp_path / "events.csv"
    path.write_text("time_ms;channel;label\n" + "".join(f"{time};{n};felt\n" for n, time in enumerate(times)))
    with pytest.raises(InputError, match=re.escape(message)):
        event_files.read(path)


@pytest.mark.parametrize(("text", "message"), [
    ("p;q\n1.234;1\n850;2\n2.345;1\n", "line 2, column 1 (p) is '1.234', where '850' has no decimals, as if '.'"),
    ("p;q\n1.000;1\n2.000;2\n850;1\n", "line 2, column 1 (p) is '1.000', where '850' has no decimals, as if '.'"),
    ("p;q\n0;1\n1.234;2\n2.340;1\n", "line 3, column 1 (p) is '1.234', where '0' has no decimals, as if '.'"),
    ("p;q;r\n1,234;0,5;1\n850;1,5;2\n", "line 2, column 1 (p) is '1,234', with separators of thousands"),
    ("p;q\n1,234;1\n2,345;2\n", "line 2 has commas that are decimal or separate thousands, '1,234'; write decimal"),
    ('p,q\n"0,5",1\n"1,5",2\n', "line 2 has decimal commas; write decimal points"),
    ("1,034\n2,200\n1,040\n", "line 1, column 2 is '034', as the end of a number with a separator of thousands"),
    ("1 034.5\n2 200.5\n1 040.5\n", "line 1, column 2 is '034.5', as the end of a number with a separator of"),
    ("p,q\n3,814,2,803\n2,724,2,758\n", "write numbers without separators of thousands and with decimal points, or"),
])  # fmt: skip
def test_what_is_refused_names_no_option(tmp_path, text, message):
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / "1.csv").write_text(text)
    with pytest.raises(InputError, match=re.escape(message)) as refusal:
        nt.read_folder(tmp_path, 100, "V")
    assert "`decimal" not in str(refusal.value)
    assert "`header_lines" not in str(refusal.value)


def test_times_of_events_with_decimal_commas_are_those_with_points(tmp_path, caplog):
    path = tmp_path / "events.csv"
    path.write_text("time_ms;channel;label\n0,5;0;1,2\n1,25;1;1,2\n2,5;0;1,2\n")
    with_commas, said = event_files.read(path), caplog.messages[0]
    path.write_text("time_ms;channel;label\n0.5;0;1,2\n1.25;1;1,2\n2.5;0;1,2\n")
    found = [next(one.trials()).steps.tolist() for one in (with_commas, event_files.read(path))]
    assert found[0] == found[1]
    assert len({*found[0]}) == 3
    assert said == f"{path}: commas in numbers are decimal"
    assert with_commas.classes == ("1,2",)


def test_numbers_of_their_own_are_read(tmp_path):
    """Numbers with zeros at their beginning or of three digits, and decimal commas that are none of thousands."""
    (tmp_path / "felt").mkdir()
    for text, options, values in (
        ("1,034\n2,1\n", {}, [[1, 34], [2, 1]]),
        ("p;q\n0,234;1\n2,345;2\n", {"decimal": ","}, [[0.234, 1], [2.345, 2]]),
        ("p;q\n0,234;1,000\n2,345;2,000\n", {}, [[0.234, 1], [2.345, 2]]),
        ("p;q\n0;1,25\n1;1,5\n", {}, [[0, 1.25], [1, 1.5]]),
        ("p;q\n0;1,25\n1;1,5\n", {"decimal": ","}, [[0, 1.25], [1, 1.5]]),
        ("p;q\n1.234;850\n2.345;1\n", {}, [[1.234, 850], [2.345, 1]]),
    ):  # fmt: skip
        (tmp_path / "felt" / "1.csv").write_text(text)
        np.testing.assert_allclose(nt.read_folder(tmp_path, 100, "V", **of_folder(options)).signals[0], values)


def test_conditions_with_thousands_stay_texts():
    assert tables.values_of(np.array(["1.234", "850"])).tolist() == ["1.234", "850"]
    assert tables.values_of(np.array(["1.25", "850"])).tolist() == [1.25, 850]
