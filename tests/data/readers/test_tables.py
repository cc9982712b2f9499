"""Numbers out of delimited text: the fast parser and the careful one mean the same."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from neurotact.data.readers.table import cells as tables
from neurotact.data.readers.table.texts import read_text
from neurotact.errors import InputError

TABLES = st.integers(1, 4).flatmap(
    lambda width: st.lists(
        st.lists(st.floats(-1e30, 1e30) | st.integers(-(10**6), 10**6), min_size=width, max_size=width), min_size=1
    )
)


def attempt(read):
    """The table, or None and why it was refused."""
    try:
        return read(), ""
    except InputError as error:
        return None, str(error)


@given(TABLES, st.sampled_from([",", "\t"]), st.sampled_from(["", "\n", "\n\n"]))
def test_what_is_written_is_read(rows, separator, end):
    text = "\n".join(separator.join(map(repr, row)) for row in rows) + end
    np.testing.assert_allclose(tables.numbers(text, "a.csv", separator=separator), np.array(rows, float), rtol=1e-14)


@given(
    st.text("0123456789.,,,-+eEdx_ \t\n\n\"'#nainfNTrue\0\x0b\u0663", max_size=25),
    st.sampled_from([",", tables.BLANKS]),
)
@example("TruE", ",")
@example("1\0002,3", ",")
@example("1,2\n3,4,5\n6", ",")
def test_only_numbers_in_rows_of_one_length_are_read(text, separator):
    """Whatever pandas makes of a text, it is the numbers that its lines and cells hold, or it is refused."""
    found, _ = attempt(lambda: tables.numbers(text, "a.csv", separator=separator))
    if found is None:
        return
    rows = [tables.cells(line, separator) for line in text.rstrip("\n").split("\n")]
    assert all(tables.NUMBER.fullmatch(cell) for row in rows for cell in row)
    np.testing.assert_allclose(found, np.array(rows, float), rtol=1e-14)


@given(st.binary(max_size=60))
def test_any_bytes_are_numbers_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    table, refusal = attempt(lambda: tables.numbers(read_text(path), path))
    if table is None:
        assert refusal.startswith(str(path))
    else:
        assert table.ndim == 2
        assert np.isfinite(table).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: holds no row of numbers"),
        ("1,2\n\n3,4\n", "a.csv: line 8 is empty"),
        ("1,2\n3\n", "a.csv: line 8 has 1 column where 2 are expected"),
        ("1,2\n3,4,5\n", "a.csv: line 8 has 3 columns where 2 are expected"),
        ("1,2\n3,\n", "a.csv: line 8, column 2 (right) is empty"),
        ("1,2\n3,nan\n", "a.csv: line 8, column 2 (right) is nan"),
        ("1,2\n-Inf,4\n", "a.csv: line 8, column 1 (left) is -Inf"),
        ("1,2\n3,1e39\n", "a.csv: line 8, column 2 (right) is 1e39, more than float32 holds"),
        ("1,2\n3,1e999\n", "a.csv: line 8, column 2 (right) is 1e999, more than float32 holds"),
        ("1,2\n3,4 mV\n", "a.csv: line 8, column 2 (right) is '4 mV', not a number"),
        ("1,2\n3,1_000\n", "a.csv: line 8, column 2 (right) is '1_000', with separators of thousands"),
        ("1,2,3\n", "a.csv: line 7 has 3 columns where 2 are expected"),
    ],
)
def test_a_fault_is_named_by_line_and_column(text, message):
    with pytest.raises(InputError) as refusal:
        tables.numbers(text, "a.csv", first_line=7, names=["left", "right"])
    assert message in str(refusal.value)


def test_spreadsheet_habits_are_read(tmp_path):
    path = tmp_path / "sheet.csv"
    path.write_bytes(b'\xef\xbb\xbf"1.5", 2\r\n +3 ,"-4e0"\r\n')
    np.testing.assert_array_equal(tables.numbers(read_text(path), path), [[1.5, 2], [3, -4]])


def test_text_that_is_not_utf8_and_absent_files_are_refused(tmp_path):
    (tmp_path / "latin.csv").write_bytes("µV\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"latin\.csv: byte 0 is not UTF-8"):
        read_text(tmp_path / "latin.csv")
    with pytest.raises(InputError, match=r"none\.csv: there is no such file"):
        read_text(tmp_path / "none.csv")
