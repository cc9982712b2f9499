"""A plain folder: what is written is read, and what cannot be is refused by name."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from neurotact.data.readers import folder
from neurotact.errors import InputError

SHORT = settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SIGNAL = np.round(np.random.default_rng(5).normal(size=(15, 3)), 3)


def write(place, name, signal: np.ndarray = SIGNAL, header="a,b,c", end="\n"):
    place.mkdir(exist_ok=True)
    lines = [header] * bool(header) + [",".join(map(repr, row)) for row in np.asarray(signal).tolist()]
    (place / name).write_text("\n".join(lines) + end)


def attempt(read):
    """The recordings, or None and why they were refused."""
    try:
        return read(), ""
    except InputError as error:
        return None, str(error)


def refused(place, message, rate=100.0, unit="mV"):
    with pytest.raises(InputError) as refusal:
        folder.read(place, rate, unit)
    assert message in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


@given(
    signals=st.integers(1, 5).flatmap(
        lambda width: st.lists(
            st.lists(st.lists(st.floats(-1e6, 1e6, width=32), min_size=width, max_size=width), min_size=1, max_size=6),
            min_size=1,
            max_size=4,
        )
    ),
    header=st.booleans(),
    end=st.sampled_from(["", "\n", "\n\n"]),
)
@SHORT
def test_csv_and_npz_come_back_alike(tmp_path_factory, signals, header, end):
    text, binary = tmp_path_factory.mktemp("text"), tmp_path_factory.mktemp("binary")
    arrays = [np.array(signal, dtype=np.float32) for signal in signals]
    for i, array in enumerate(arrays):
        names = ",".join(f"taxel{c + 1}" for c in range(array.shape[1])) if header else ""
        write(text / f"class{i}", "touch.csv", array, names, end)
        (binary / f"class{i}").mkdir()
        np.savez(binary / f"class{i}" / "touch.npz", press=array)
    one, other = folder.read(text, 250, "mV"), folder.read(binary, 250, "mV")
    assert one.channels == other.channels
    assert one.sampling_rate_Hz == 250.0
    assert list(one.conditions.label) == list(other.conditions.label) == [f"class{i}" for i in range(len(arrays))]
    for a, b, array in zip(one.signals, other.signals, arrays, strict=True):
        np.testing.assert_array_equal(a, array)
        np.testing.assert_array_equal(b, array)


def test_trials_come_label_by_label_in_the_order_of_the_files(tmp_path):
    for name in ("b.csv", "a.CSV"):
        write(tmp_path / "silk", name)
    write(tmp_path / "felt", "z.csv", header="")
    np.savez(tmp_path / "felt" / "y.npz", two=SIGNAL, one=SIGNAL[:4])
    for stray in ("silk/notes.txt", "silk/.b.csv", "readme.csv"):
        (tmp_path / stray).write_text("stray")
    (tmp_path / ".git").mkdir()
    (tmp_path / "__MACOSX").mkdir()
    touch = folder.read(tmp_path, 100, "mV")
    assert list(touch.conditions.file) == [
        "felt/y.npz:two", "felt/y.npz:one", "felt/z.csv", "silk/a.CSV", "silk/b.csv"
    ]  # fmt: skip
    assert list(touch.conditions.label) == ["felt"] * 3 + ["silk"] * 2
    assert touch.channels == ("a", "b", "c")
    assert [len(s) for s in touch.signals] == [15, 4, 15, 15, 15]


def test_trials_of_other_taxels_are_refused(tmp_path):
    write(tmp_path / "felt", "a.csv")
    write(tmp_path / "silk", "b.csv", SIGNAL[:, :2], "a,b")
    refused(tmp_path, "silk/b.csv: has 2 channels where felt/a.csv has 3")
    write(tmp_path / "silk", "b.csv", header="a,c,b")
    refused(tmp_path, "silk/b.csv: column 2 is 'c' where felt/a.csv has 'b'")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: holds no row"),
        ("a,b\n", "a.csv: holds no row"),
        ("a,b\n1,2\n3\n", "a.csv: line 3 has 1 columns where 2 are expected"),
        ("a,b\n1,2,3\n", "a.csv: line 2 has 3 columns where 2 are expected"),
        ("1,2\n3,x\n", "a.csv: line 2, column 2 is 'x'"),
        ("1,x\n3,4\n", "a.csv: line 1, column 2 is 'x'"),
        ("a,b\n1,nan\n", "a.csv: line 2, column 2 (b) is nan"),
        ("nan,nan\n1,2\n", "a.csv: line 1, column 1 is nan"),
        ("a,b,\n1,2,3\n", "a.csv: line 1, column 1 is 'a'"),
        ("a,a\n1,2\n", "a.csv: two columns are named 'a'"),
        ("t (ms),a\n1,2\n", "a.csv: column 1 is 't (ms)', but every column is a taxel"),
        ("Timestamp,a\n1,2\n", "a.csv: column 1 is 'Timestamp', but every column is a taxel"),
        ("0,1,2\n1,2,3\n", "a.csv: line 1 counts 0 to 2, which looks like column numbers"),
        ("a;b\n1,5;2,5\n", "a.csv: line 2 has 3 columns where 1 are expected"),
    ],
)
def test_a_table_that_cannot_be_read_is_named(tmp_path, text, message):
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / "a.csv").write_text(text)
    refused(tmp_path, message)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({}, "a.npz: holds no array"),
        ({"x": SIGNAL[:, 0]}, "a.npz, key 'x': has shape (15,); save a (time, channel) array"),
        ({"x": SIGNAL[:0]}, "a.npz, key 'x': has shape (0, 3)"),
        ({"x": SIGNAL.astype(str)}, "a.npz, key 'x': holds <U"),
        ({"x": SIGNAL * 1j}, "a.npz, key 'x': holds complex128, not numbers"),
        (
            {"x": np.where(np.arange(45).reshape(15, 3) == 7, np.inf, SIGNAL)},
            "a.npz, key 'x': sample 2, channel 1 is inf",
        ),
        ({"x": SIGNAL * 1e60}, "a.npz, key 'x': sample 0, channel 0 is"),
        ({"x": np.array([[{}]])}, "a.npz: holds pickled Python objects, which are never loaded"),
    ],
)
def test_an_archive_that_cannot_be_read_is_named(tmp_path, arrays, message):
    (tmp_path / "felt").mkdir()
    np.savez(tmp_path / "felt" / "a.npz", **arrays)
    refused(tmp_path, message)


def test_folders_rates_and_units_that_say_nothing_are_refused(tmp_path):
    refused(tmp_path / "absent", "there is no such folder")
    refused(tmp_path, "holds no sub-folder; put the files of each class in a sub-folder")
    write(tmp_path / "felt", "a.csv")
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        refused(tmp_path, "sampling_rate_Hz must be a positive number", rate=rate)
    refused(tmp_path, "the unit of the signals is empty", unit=" ")
    (tmp_path / "silk").mkdir()
    refused(tmp_path, "silk: holds no .csv or .npz file")


@given(cut=st.integers(0, 10**6), flip=st.none() | st.integers(0, 255))
@SHORT
def test_a_damaged_table_is_read_or_refused_by_name(tmp_path, cut, flip):
    write(tmp_path / "felt", "a.csv")
    content = (tmp_path / "felt" / "a.csv").read_bytes()
    cut %= len(content)
    damaged = content[:cut] if flip is None else content[:cut] + bytes([flip]) + content[cut + 1 :]
    (tmp_path / "felt" / "a.csv").write_bytes(damaged)
    recordings, refusal = attempt(lambda: folder.read(tmp_path, 100, "mV"))
    if recordings is None:
        assert "a.csv" in refusal
        assert "\n" not in refusal
        return
    (signal,) = recordings.signals
    if flip is None and signal.shape[1] == 3:  # a last number that lost digits is still a number
        np.testing.assert_array_equal(signal.ravel()[:-1], SIGNAL.astype(np.float32)[: len(signal)].ravel()[:-1])
    assert np.isfinite(signal).all()


@given(
    row=st.integers(0, 14), column=st.integers(0, 2), cell=st.sampled_from(["", "NaN", "-inf", "felt", "1 2", "--1"])
)
@SHORT
def test_a_cell_that_is_no_number_is_named(tmp_path, row, column, cell):
    table = SIGNAL.astype(object)
    table[row, column] = cell
    (tmp_path / "felt").mkdir(exist_ok=True)
    lines = ["a,b,c", *(",".join(map(str, line)) for line in table)]
    (tmp_path / "felt" / "a.csv").write_text("\n".join(lines))
    refused(tmp_path, f"a.csv: line {row + 2}, column {column + 1} ({'abc'[column]}) is")


@given(cut=st.integers(0, 10**6), flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=3))
@SHORT
def test_a_damaged_archive_is_what_it_was_or_refused(tmp_path, cut, flips):
    (tmp_path / "felt").mkdir(exist_ok=True)
    path = tmp_path / "felt" / "a.npz"
    np.savez(path, x=SIGNAL)
    content = bytearray(path.read_bytes())
    for place, byte in flips:
        content[place % len(content)] = byte
    path.write_bytes(content if flips else content[: cut % len(content)])
    recordings, refusal = attempt(lambda: folder.read(tmp_path, 100, "mV"))
    if recordings is None:
        assert "a.npz" in refusal
        assert "\n" not in refusal
        return
    (signal,) = recordings.signals
    np.testing.assert_array_equal(signal, SIGNAL.astype(np.float32))
