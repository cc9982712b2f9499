"""Warnings are folded into one line only where they say the same of other files."""

import pytest

from neurotact.repeated_warnings import in_few_lines, log


def said(caplog, *warnings) -> list[str]:
    caplog.clear()
    in_few_lines(lambda: [log.warning(*warning) for warning in warnings])()
    return caplog.messages


@pytest.mark.parametrize(
    ("form", "places", "words"),
    [("%s: %s", ("touches",), ()), ("%s: %s%s", ("touches",), (" (a.csv)",)), ("%s", (), ())],
)
def test_different_warnings_are_all_said_also_where_their_words_are_arguments(caplog, form, places, words):
    different = "names of 2 kinds", "a taxel has one value", "the trials are long"
    assert len(said(caplog, *((form, *places, text, *words) for text in different))) == len(different)
    same = [(form, *(f"{place}{n}" for place in places), f"{n} rows are dropped", *words) for n in (1, 20, 300)]
    same += [(form, *(f"silk {place}" for place in places), "4 rows are dropped", *words)]
    (line,) = said(caplog, *same)
    assert line.endswith("(and 3 more such lines)")
    assert "1 rows are dropped" in line


def test_the_same_sentence_of_other_files_is_one_line(caplog):
    (line,) = said(caplog, *(("%s: two rows of %s are dropped", name, name[0]) for name in ("a.csv", "b.csv")))
    assert line == "a.csv: two rows of a are dropped (and 1 more such lines)"
