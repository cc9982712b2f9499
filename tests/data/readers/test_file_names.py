"""Names of files that hold conditions, which nobody named, and names that only number the files."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.readers.file_names import labelled, unnamed
from neurotact_parts.readers.folder import conditions_of

import neurotact as nt
from neurotact.cli.words import in_options
from neurotact.errors import InputError

WORDS = st.text("abcXYZé", min_size=1, max_size=4)


def said(caplog) -> str:
    return "\n".join(record.getMessage() for record in caplog.records if "not read" in record.getMessage())


def write(folder: Path, names: list[str]) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("a,b\n1,2\n3,5\n2,2\n")
    return folder


@given(
    st.lists(WORDS, min_size=1, max_size=3, unique=True),
    st.lists(st.integers(0, 900), min_size=2, max_size=3, unique=True),
    st.sampled_from("_- "),
    st.booleans(),
)
def test_the_pattern_that_is_proposed_reads_every_name(wears, forces, sign, has_folder):
    """Whatever the words, the numbers and the signs between them are, no name of a folder is outside the pattern."""
    files = [
        f"felt{'/' if has_folder else sign}{wear}{sign}F{force}{sign}{n:02}.csv"
        for wear in wears for force in forces for n in range(2)
    ]  # fmt: skip
    levels = ["label"] if has_folder else []
    found = unnamed(files, levels)
    assert found is not None
    if has_folder or len(wears) > 1:  # otherwise no word tells the class
        naming = nt.Naming(levels=levels, pattern=found.pattern if has_folder else labelled(files))
        read = conditions_of(files, naming, Path()).drop(columns="file")
        assert len(read.drop_duplicates()) == len(files)
    assert found.example[-1] == "00"


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        ([f"{n}" for n in range(3)], None),
        ([f"slide{n:02}" for n in range(3)], None),
        ([f"trial-{n}" for n in (0, 1, 2, 4)], None),
        (["1699", "4711", "9321"], "{number}"),  # the same numbers with gaps in each folder: values, no count
        (["wet", "dry"], "{part1}"),
        (["anna_3", "anna_6", "ben_3"], "{part1}_{number}"),
        (["speed150", "speed300", "speed450"], "speed{speed}"),
        (["F0.5_a", "F1.5_a", "F0.5_b"], "F{F}_{part2}"),
        (["F3_V-10mm_0", "F3_V20mm_0", "F6_V-10mm_1"], "F{F}_V{V}mm_{number}"),  # some numbers have a minus
        (["t-1_a", "t1_a", "t--1_a"], None),
        (["5mm/x1", "5mm/x2", "9mm/x1"], "{part1}mm/x{x}"),
        (["a3f9", "77b0"], "{part1}"),
        (["a", "b_2", "c-d"], None),  # no common form
        (["file3", "file30", "file300"], "file{number}"),
        (["part1_a", "part1_b", "part2_a"], "part{part}_{part2}"),
        (["x{1}a", "x{1}b"], None),
        (["one"], None),
    ],
)  # fmt: skip
def test_parts_are_told_where_they_may_be_conditions(names, pattern):
    files = [f"{label}/{name}.csv" for label in ("felt", "silk") for name in names]
    found = unnamed(files, ["label"])
    assert (found and found.pattern) == pattern
    if found is not None:
        conditions_of(files, nt.Naming(levels="label", pattern=found.pattern), Path())


def test_what_differs_between_folders_alone_is_told_by_these():
    assert unnamed(["felt/felt_1.csv", "felt/felt_2.csv", "silk/silk_1.csv", "silk/silk_2.csv"], ["label"]) is None
    assert unnamed([f"felt/hash{n}.csv" for n in (17, 2812)] + ["silk/hash9120.csv"], ["label"]) is None


def test_a_name_that_a_level_has_is_not_given_twice():
    found = unnamed(["9/speed3_1.csv", "9/speed3_2.csv", "9/speed5_1.csv", "8/speed3_1.csv"], ["{speed}"])
    assert found is not None
    assert found.pattern == "speed{part1}_{number}"


def test_an_import_says_which_parts_are_not_read_and_the_option_reads_them(tmp_path, caplog):
    folder = write(tmp_path, [f"{label}/F{force}_{n:02}.csv" for label in "ab" for force in (3, 6) for n in (0, 1)])
    nt.read_folder(folder, 100, "mV")
    message = said(caplog)
    assert message == (
        f"{folder}: parts of file names are not read as conditions, such as 3 and 00 of a/F3_00.csv; name them with "
        "`pattern`, as in `pattern='F{F}_{number}'`"
    )
    caplog.clear()
    found = nt.read_folder(folder, 100, "mV", naming=nt.Naming(pattern="F{F}_{number}"))
    assert found.conditions["F"].tolist() == [3, 3, 6, 6] * 2
    assert not said(caplog)
    typed_out = in_options(message, {"pattern": "--pattern"})
    assert typed_out.endswith("name them with --pattern, as in --pattern 'F{F}_{number}'")


def test_conditions_in_a_table_are_all_there_are(tmp_path, caplog):
    names = [f"F{force}_{n}.csv" for force in (3, 6) for n in (0, 1)]
    folder = write(tmp_path / "data", [f"a/{name}" for name in names])
    table = tmp_path / "table.csv"
    table.write_text("file,label\n" + "".join(f"a/{name},felt\n" for name in names))
    nt.read_folder(folder, 100, "mV", naming=nt.Naming(table=table))
    assert not said(caplog)


def test_the_class_of_a_pattern_is_a_word():
    assert labelled(["p01_felt_1.csv", "p02_silk_1.csv"]) == "p{p}_{label}_1"
    assert labelled(["p01_2N_1.csv", "p02_2N_2.csv"]) == ""
    assert labelled(["felt_wet_1", "silk_dry_1"]) == "{label}_{part2}_1"


def test_a_folder_without_sub_folders_is_told_its_own_pattern(tmp_path):
    folder = write(tmp_path, ["felt_F3_0.csv", "silk_F3_0.csv", "silk_F6_1.csv"])
    with pytest.raises(InputError, match=r"give the label with `pattern='\{label\}_F\{F\}_\{number\}'`"):
        nt.read_folder(folder, 100, "mV")
