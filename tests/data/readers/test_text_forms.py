"""Text files as programs write them: each is read, or the sentence names what is there and what to do."""

import gzip
import io
import json
import logging
import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from as_specs import of_folder, of_table
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data.readers.table.headings import open_table
from neurotact.data.readers.table.texts import with_line_ends
from neurotact.errors import InputError

TOUCH = pd.DataFrame({"t": np.arange(6) * 0.01, "left": [1.5, 2, 3, 2, 1, 5], "right": [2, 3, 1, 5, 6, 7.25]})
SAMPLES = TOUCH[["left", "right"]].to_numpy()
LVM = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tNo\n"
    "***End_of_Header***\t\n\t\nChannels\t2\t\nSamples\t6\t6\t\nY_Unit_Label\tVolts\tVolts\nX_Dimension\tTime\tTime\n"
    "X0\t0,0E+0\t0\nDelta_X\t1,0E-2\t1,0E-2\n***End_of_Header***\t\t\t\nX_Value\tleft\tright\tComment\n"
)


def rows(separator=",", decimal=".", end="", table=TOUCH, begin="") -> str:
    lines = (separator.join(map(repr, row)).replace(".", decimal) for row in table.to_numpy().tolist())
    return "".join(begin + line + end + "\n" for line in lines)


def wide(head: str) -> str:
    """Columns of one width, as Fortran and many instruments write them."""
    return head + "".join(f"  {t:7.2f}   {left:6.2f}    {right:6.2f}\n" for t, left, right in TOUCH.to_numpy())


def savetxt(**options) -> str:
    stream = io.StringIO()
    np.savetxt(stream, TOUCH, **options)
    return stream.getvalue()


def bag(head: str, first: str) -> str:
    """Rows of a ROS topic: `first` is formatted with the number of a row."""
    lines = (f"{first.format(n, n * 10**7)},{left!r},{right!r}\n" for n, (left, right) in enumerate(SAMPLES.tolist()))
    return head + "".join(lines)


def folder_of(path: Path, content: str | bytes, name: str = "1.csv") -> Path:
    for label in ("felt", "silk"):
        (path / label).mkdir(parents=True)
        (path / label / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return path


READ: dict[str, str | bytes] = {
    "np.savetxt with commas": savetxt(header="t,left,right", delimiter=","),
    "MATLAB's comments": "% felt\n% t\tleft\tright\n" + rows("\t"),
    "comments of C": "// felt\nt,left,right\n" + rows(),
    "columns of one width": wide("   t    left   right\n"),
    "names in quotes": wide('"t s"   "left"   "right"\n'),
    "names far apart": wide("  t s    left    right\n"),
    "blanks and decimal commas": "t left right\n" + rows(" ", ","),
    "blanks and tabs": "t left right\n" + rows(" \t "),
    "Excel's first line": "sep=;\nt;left;right\n" + rows(";"),
    "Excel's first line, decimal commas": '"sep=;"\nt;left;right\n' + rows(";", ","),
    "upright lines": "t|left|right\n" + rows("|"),
    "UTF-16 without a mark": ("t,left,right\n" + rows()).encode("utf-16-le"),
    "UTF-16 of another order": ("t,left,right\n" + rows()).encode("utf-16-be"),
    "Excel's Unicode text": ("t\tleft\tright\r\n" + rows("\t")).encode("utf-16"),
    "UTF-32": ("t,left,right\n" + rows()).encode("utf-32"),
    "a mark": ("t,left,right\n" + rows()).encode("utf-8-sig"),
    "a separator ends lines": "t;left;right;\n" + rows(";", ".", ";"),
    "a separator ends the names": "t,left,right,\n" + rows(),
    "a separator ends the rows": "t,left,right\n" + rows(end=","),
    "quotes": "t,left,right\n" + rows(begin='"', separator='","', end='"'),
    "Windows' line ends": ("t,left,right\n" + rows()).replace("\n", "\r\n"),
    "old Macs' line ends": ("t,left,right\n" + rows()).replace("\n", "\r"),
    "line ends that were doubled": ("t,left,right\n" + rows()).replace("\n", "\r\r\n"),
    "an empty line below the names": "t,left,right\n\n" + rows(),
    "prose that is skipped": "Recorded by Bob\non Tuesday\nt,left,right\n" + rows(),
    "LabVIEW": LVM + rows("\t", ",", table=TOUCH[["left", "right"]], begin="\t"),
    "LabVIEW with times": LVM + rows("\t", ","),
}
"""Files of `TOUCH`."""
SAID: dict[str, tuple[str | bytes, str]] = {
    "units": (
        "t,left,right\nms,mV,mV\n" + rows(table=TOUCH.assign(t=TOUCH.t * 1e3)),
        "the line of units is no sample (ms, mV, mV)",
    ),
    "decimal commas": ("t;left;right\n" + rows(";", ","), "commas in numbers are decimal"),
    "decimal commas between blanks": ("t left right\n" + rows(" ", ","), "commas in numbers are decimal"),
    "units of some columns": ("t;left;right\ns;;\n" + rows(";"), "the line of units is no sample (s)"),
    "units in brackets": (
        "t;left;right\n[s];[N];[N]\n" + rows(";"), "the line of units is no sample ([s], [N], [N])",
    ),
    "np.savetxt": (savetxt(header="t left right"), "the comment in line 1 names the columns: t, left, right"),
    "two lines of np.savetxt": (
        savetxt(header="t,left,right\ns,mV,mV", delimiter=","), "the line of units is no sample (s, mV, mV)",
    ),
    "prose and units that are skipped": (
        "Recorded by Bob\nt,left,right\ns,V,V\n" + rows(), "the line of units is no sample (s, V, V)",
    ),
    "latin-1": (
        "# 20 °C\nt,left,right\n".encode("latin-1") + rows().encode(),
        "not UTF-8, so read as Windows-1252 (latin-1)",
    ),
    "comments of LabVIEW": (
        LVM + rows("\t", ",", "\tbumped", TOUCH[["left", "right"]], "\t"),
        "comments of LabVIEW are not read (6 lines)",
    ),
    "pandas": (TOUCH.to_csv(), "a column without a name numbers the rows and is no taxel"),
    "pandas twice": (
        pd.read_csv(io.StringIO(TOUCH.to_csv())).to_csv(), "a column without a name numbers the rows and is no taxel",
    ),
    "a text column": ("t,left,right,who\n" + rows(end=",Bob"), "holds no number, so no taxel: who ('Bob')"),
    "dates": ("day;t;left;right\n" + rows(";", begin="1.2.24;"), "holds no number, so no taxel: day ('1.2.24')"),
    "an empty column": ("dead,t,left,right\n" + rows(begin=","), "holds no number, so no taxel: dead ('')"),
    "rostopic echo -p": (
        bag("%time,field.header.seq,field.header.stamp,field.header.frame_id,left,right\n",
            "1612345678{1:09d},{0},9{0},tip"),
        "the header of the ROS message is no taxel: field.header.seq, field.header.stamp, field.header.frame_id",
    ),
    "bagpy": (
        bag("Time,header.seq,header.stamp.secs,header.frame_id,left,right\n", "{0}e-2,{0},7,tip"),
        "the header of the ROS message is no taxel: header.seq, header.stamp.secs, header.frame_id",
    ),
    "ros2 topic echo --csv": (
        bag("", "1612345678,{1},tip"), "columns 1 to 3 are the header of a ROS 2 message, whose stamp is the time",
    ),
}  # fmt: skip
"""Files of `TOUCH`, and what is said of them."""
REFUSED: dict[str, tuple[str | bytes, str]] = {
    "decimal commas": (
        "t;left\n0,00;1.5\n0,01;2.5\n", "line 2 has decimal commas; pass `decimal=','` or write decimal points",
    ),
    "blanks before commas": ("5 ,15\n6 ,20\n", "line 1 has decimal commas; pass `decimal=','` or write decimal points"),
    "decimal commas in one column": ("force\n0,5\n0,6\n", "if these are decimal commas, pass `decimal=','`)"),
    "decimal commas and others": ("t,left\n0,00,1,0\n", "put ; between columns and pass `decimal=','`)"),
    "thousands": (
        't,left\n0,"1,234.5"\n', "(left) is '1,234.5', with separators of thousands; write numbers without them",
    ),
    "thousands and decimal commas": ("t;left\n0;1.234,5\n", "'1.234,5', with separators of thousands"),
    "thousands of France": ("t;left\n0;1\u00a0234\n", "with separators of thousands"),
    "a sign for a gap": ("t,left\n0,1\n1,-\n", "line 3, column 2 (left) is '-', no value; repair the gap, fill it"),
    "a gap that is named": ("t,left\n0,1\n1,NaN\n", "line 3, column 2 (left) is NaN; repair the gap, fill it"),
    "a column of gaps": ("t,a,b\n0,nan,1\n1,nan,2\n", "line 2, column 2 (a) is nan; repair the gap, fill it"),
    "a gap": ("t,left\n0,1\n1,\n", "line 3, column 2 (left) is empty; repair the gap, fill it"),
    "units in cells": ("t,left\n0,1.5 mV\n", "(left) is '1.5 mV', not a number; write it without its unit, or choose"),
    "a chosen text": ("t,left,who\n0,1,Bob\n", "column 3 (who) is 'Bob', not a number"),
    "a first line that was cut": (
        "5,2\n" + rows(), "line 1 has 2 columns where 3 are expected, as a first line that was cut off; remove",
    ),
    "a cut line below the names": ("t,left,right\n5,2\n" + rows(), "line 2 has 2 columns where 3 are expected, as a"),
    "names and a line of no values": ("t,left,right\n,,\n" + rows(), "line 2 holds no value; remove the line"),
    "a line of more": ("t,left,right\n5,2,3,4\n" + rows(), "line 2 has 4 columns where 3 are expected; give all lines"),
    "thousands in the first row alone": (
        "left;right\n1'005;1'003\n" + "990;980\n" * 9, "line 2 has separators of thousands, as in \"1'005\"; write",
    ),
    "thousands in the first row alone, without names": (
        "1'005;1'003\n" + "990;980\n" * 9, "line 1 has separators of thousands, as in \"1'005\"; write",
    ),
    "thousands and decimals in the first row alone": (
        'left,right\n"1,005.5","1,003.5"\n' + "990.5,980.5\n" * 9, "line 2 has separators of thousands, as in '1,005",
    ),
    "a first line of noise": (b"\xff5\xfe,2\n" + rows().encode(), "line 1 has 2 columns where 3 are expected, as a"),
    "a last line that was cut": (rows() + "0.06,1\n", "line 7 has 2 columns where 3 are expected; remove the line"),
    "what a board says first": (
        "Booting...\nReady\n" + rows(),
        "lines 1 to 2 are no sample and no name of a column, 'Booting...'; skip the lines above the samples with "
        "`header_lines=2`",
    ),
    "prose": (
        "Recorded, by Bob\nt,left,right\n" + rows(),
        "line 1 is no sample and no name of a column, 'Recorded, by Bob'; skip the lines above the samples with "
        "`header_lines=2`",
    ),
    "keys and values": (
        "Sensor,A\nRate,100\n\nt,left,right\n" + rows(),
        "lines 1 to 2 are no sample and no name of a column, 'Sensor,A'; skip the lines above the samples with "
        "`header_lines=4`",
    ),
    "fewer names": ("t,left\n" + rows(), "line 2 has 3 columns where 2 are expected, the names in line 1; name each"),
    "names with blanks": ("Time (s) Left Right\n" + rows(" "), "names that contain blanks need quotes, or commas"),
    "a name twice": ("t,left,left\n" + rows(), "two columns are named 'left'; give each taxel its own name"),
    "a comment among samples": ("t,left\n0,1\n# paused\n1,2\n", "line 3 is a comment, '# paused'; remove the line"),
    "an empty line": ("t,left\n0,1\n\n1,2\n", "line 3 is empty; remove empty lines"),
    "tuples of Python": ("(1, 2)\n(3, 4)\n", "line 1 begins with a bracket, '(1, 2)'; write rows without brackets"),
    "a printed array": ("[[1. 2.]\n [3. 4.]]\n", "line 1 begins with a bracket"),
    "MATLAB's rows": ("1, 2;\n3, 4;\n", "line 1, column 1 is '1, 2', not a number"),
    "bytes that were never written": (rows().encode() + bytes(20), "line 7 holds a NUL, so it was not written to its"),
    "no row": ("t,left\n", "holds no row of numbers"),
    "blanks alone": (" \n \n", "holds no row of numbers"),
    "words": ("hello world\nthis is text\nno\n", "has no column of numbers for a taxel; line 2 is 'this is text'"),
    "two segments of LabVIEW": (
        LVM + "\t1\t2\n" + LVM.partition("***\t\n\t\n")[2],
        "line 17 begins a second segment; save each segment in a file of its own",
    ),
    "spectra of LabVIEW": (
        LVM.replace("\tTime\tTime", "\tFrequency\t") + "1\t2\n", "its X values are of 'Frequency', no times",
    ),
    "LabVIEW's points": (LVM.replace("r\t,", "r\t.") + "\t1\t2\n", "names '.' as its decimal separator; leave"),
    "LabVIEW without names": (LVM.partition("X_Value")[0], "names the columns, from X_Value on; save it with column"),
    "a pickle": (pickle.dumps([1]), "is a Python pickle, which is never loaded"),
    "JSON": (json.dumps([1, 2]), "is a JSON document; save it as CSV"),
    "gzip": (gzip.compress(b"1,2\n"), "is compressed by gzip; unpack it with gunzip"),
}  # fmt: skip
"""Files that cannot be read, and what the refusal says."""
OPTIONS: dict[str, dict] = {
    "blanks and decimal commas": {"decimal": ","}, "Excel's first line, decimal commas": {"decimal": ","},
    "prose that is skipped": {"header_lines": 3}, "prose and units that are skipped": {"header_lines": 3},
    "thousands and decimal commas": {"decimal": ","}, "LabVIEW's points": {"decimal": ","},
    "a chosen text": {"columns": "who"},
}  # fmt: skip
"""The options that a file needs."""


@pytest.mark.parametrize("name", READ)
def test_what_programs_write_is_read(tmp_path, name, caplog):
    content, options = READ[name], OPTIONS.get(name, {})
    found = nt.read_folder(folder_of(tmp_path, content, "1.txt"), unit="V", **of_folder(options))
    assert (found.channels, found.sampling_rate_Hz) == (("left", "right"), 100.0)
    np.testing.assert_array_equal(found.signals[1], SAMPLES)
    assert not caplog.messages


@pytest.mark.parametrize("name", SAID)
def test_what_is_no_sample_is_said_once(tmp_path, name, caplog):
    content, message = SAID[name]
    found = nt.read_folder(folder_of(tmp_path, content), unit="V", **of_folder(OPTIONS.get(name, {})))
    assert found.sampling_rate_Hz == 100.0
    np.testing.assert_array_equal(found.signals[1], SAMPLES)
    said, *others = caplog.messages
    assert said.startswith(f"{tmp_path}: ")
    assert message in said
    unit = next((unit for unit in ("mV", "N") if unit in message), None)
    assert others == [f"{tmp_path}: says {unit} (left, right), but V is given and used"] * (unit is not None)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_named_with_the_fix(tmp_path, name):
    content, message = REFUSED[name]
    with pytest.raises(InputError) as refusal:
        nt.read_folder(folder_of(tmp_path, content), 100, "V", **of_folder(OPTIONS.get(name, {})))
    assert message in str(refusal.value)
    assert str(refusal.value).startswith(f"{tmp_path / 'felt' / '1.csv'}: ")
    assert "\n" not in str(refusal.value)
    assert "drop" not in str(refusal.value)


@pytest.mark.parametrize(("decimal", "hand"), [(",", 1.2), (".", "1,2")])
def test_a_table_of_annotations_has_the_decimal_sign_of_its_samples(tmp_path, decimal, hand):
    (tmp_path / "all.csv").write_text("t;left;right\n" + rows(";", decimal))
    marks = "begin;end;label;hand\n0;0.035;tap;1,2\n0.035;0.06;rub;1,2\n".replace("0.0", f"0{decimal}0")
    (tmp_path / "marks.csv").write_text(marks)
    found = nt.read_table(tmp_path / "all.csv", unit="V", annotations=tmp_path / "marks.csv")
    np.testing.assert_array_equal(np.concatenate(found.signals), SAMPLES)
    assert found.conditions["hand"].tolist() == [hand] * 2


@pytest.mark.parametrize("name", READ)
def test_a_table_of_all_trials_is_read_alike(tmp_path, name):
    content, options = READ[name], OPTIONS.get(name, {})
    path = tmp_path / "all.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    marks = tmp_path / "marks.txt"
    marks.write_text("  begin  end   label\n  0      0.035 tap\n  0.035  0.06  rub\n")
    found = nt.read_table(path, unit="V", annotations=marks, **of_table(options))
    assert (found.channels, found.sampling_rate_Hz) == (("left", "right"), 100.0)
    np.testing.assert_array_equal(np.concatenate(found.signals), SAMPLES)


CELLS = st.floats(-1e6, 1e6, allow_nan=False).map(lambda value: round(value, 3))
TABLES = st.integers(2, 4).flatmap(
    lambda n: st.lists(st.lists(CELLS, min_size=n, max_size=n), min_size=2, max_size=12)
)  # fmt: skip


@given(
    TABLES,
    st.sampled_from([",", ";", "\t", "|", " ", "   ", " \t", ", "]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32"]),
    st.sampled_from(["\n", "\r\n", "\r", "\r\r\n"]),
    st.sampled_from(["", "# made by hand on a Tuesday\n", "% 1 2 3 4 5\n\n", "sep={}\n"]),
    st.booleans(), st.booleans(),
)  # fmt: skip
def test_every_way_to_write_a_table_is_read_back(
    tmp_path_factory, table, separator, encoding, end, above, named, units
):
    """Separator, encoding, line ends, comments, names and units are free of one another."""
    names = [f"taxel {'abcd'[column]}" if separator.strip(" ") else "abcd"[column] for column in range(len(table[0]))]
    lines = [separator.join(names)] * named + [separator.join(["mV"] * len(names))] * (named and units)
    lines += [separator.join(map(repr, row)) for row in table]
    above = above.format(separator.strip(" ") or " ") if separator in (",", ";", "\t", "|", " ") else ""
    path = tmp_path_factory.getbasetemp() / "any.txt"
    path.write_bytes((above + "\n".join(lines) + "\n").replace("\n", end).encode(encoding))
    found = open_table(path)
    assert found.names == (tuple(names) if named else ())
    assert found.units == (("mV",) * len(names) if named and units else ())
    assert found.first_line == 1 + above.count("\n") + len(lines) - len(table)
    assert [[float(cell) for cell in row] for _, row in found.rows()] == table


@given(st.text("1,\r\n", max_size=20))
def test_line_ends_become_one_kind(text):
    found = with_line_ends(text)
    assert "\r" not in found
    assert found.replace("\n", "") == text.replace("\r", "").replace("\n", "")


def test_files_of_one_kind_are_named_together(tmp_path, caplog):
    folder_of(tmp_path, "t,left,who\n0.00,1,Bob\n0.01,2,Bob\n")
    (tmp_path / "silk" / "1.csv").write_text("t,left\n0.00,1\n0.01,2\n")
    with caplog.at_level(logging.WARNING):
        nt.read_folder(tmp_path, 100, "V")
    assert f"{tmp_path}: holds no number, so no taxel: who ('Bob') (felt/1.csv)" in caplog.messages
