"""A plain folder: what is written is read, and what cannot be is refused by name."""

import logging
import os
import socket
import tracemalloc
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.readers import arrays, folder

from neurotact.data import hdf5
from neurotact.errors import InputError
from neurotact.files import MAX_MB

KINDS = f"{', '.join(folder.every_suffix()[:-1])} or {folder.every_suffix()[-1]}"

SHORT = examples(80)
SIGNAL = np.round(np.random.default_rng(5).normal(size=(15, 3)), 3)


def write(place, name, signal: np.ndarray = SIGNAL, header="a,b,c", end="\n"):
    place.mkdir(parents=True, exist_ok=True)
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


def test_a_label_that_names_what_is_the_label_anyway_changes_nothing(tmp_path):
    """By sub-folder, by the name of the file, by a level."""
    for name in ("felt", "silk"):
        write(tmp_path / name, f"{name}_1.csv")
    for naming in ({}, {"pattern": "{label}_{n}.csv"}, {"levels": "label"}):
        unsaid, said = (folder.read(tmp_path, 100, "mV", naming=naming | own) for own in ({}, {"label": "label"}))
        assert said.conditions.equals(unsaid.conditions)
        assert said.classes == ("felt", "silk")


def test_a_label_that_names_no_condition_is_refused_with_what_names_it(tmp_path):
    write(tmp_path / "felt", "a_1.csv")
    for naming, expected in (
        ({"label": "material"}, "name the sub-folders with `levels='material'`, or leave out `label`"),
        ({"label": "material", "pattern": "{matter}_{n}.csv"}, "no condition is called material; "),
        ({"label": "label", "levels": "material"}, "no condition is called label; "),
    ):
        with pytest.raises(InputError) as refusal:
            folder.read(tmp_path, 100, "mV", naming=naming)
        assert expected in str(refusal.value)
        assert not str(refusal.value).endswith("known: ")


def test_trials_come_label_by_label_in_the_order_of_the_files(tmp_path, caplog):
    for name in ("b.csv", "a.CSV"):
        write(tmp_path / "silk", name)
    write(tmp_path / "felt", "z.csv", header="")
    np.savez(tmp_path / "felt" / "y.npz", two=SIGNAL, one=SIGNAL[:4])
    for stray in ("silk/notes.txt", "silk/.b.csv", "README", "a/deeper/one.lvm", ".git/a.csv", "__MACOSX/felt/z.csv"):
        (tmp_path / stray).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / stray).write_text("stray")
    write(tmp_path / "a" / "deeper", "two.csv")
    with caplog.at_level(logging.WARNING, "neurotact"):
        touch = folder.read(tmp_path, 100, "mV")
    assert caplog.messages == [
        f"{tmp_path}: ignores 6 files (hidden, or not recordings): "
        ".git, README, __MACOSX, a/deeper/one.lvm, silk/.b.csv and 1 more"
    ]
    assert list(touch.conditions.file) == [
        "a/deeper/two.csv", "felt/y.npz:two", "felt/y.npz:one", "felt/z.csv", "silk/a.CSV", "silk/b.csv"
    ]  # fmt: skip
    assert list(touch.conditions.label) == ["a"] + ["felt"] * 3 + ["silk"] * 2
    assert touch.channels == ("a", "b", "c")
    assert [len(s) for s in touch.signals] == [15, 15, 4, 15, 15, 15]


@given(places=st.lists(st.lists(st.sampled_from("abc"), min_size=1, max_size=4), min_size=1, max_size=12))
@SHORT
def test_no_nested_file_is_lost(tmp_path_factory, places):
    root = tmp_path_factory.mktemp("nested")
    for i, place in enumerate(places):
        root.joinpath(*place).mkdir(parents=True, exist_ok=True)
        write(root.joinpath(*place), f"{i}.csv", SIGNAL + i)
    touch = folder.read(root, 100, "mV")
    read = {(row.label, row.file): touch.signals[i][0, 0] for i, row in touch.conditions.iterrows()}
    written = {(place[0], f"{'/'.join(place)}/{i}.csv"): np.float32(SIGNAL[0, 0] + i) for i, place in enumerate(places)}
    assert read == written


def test_a_data_file_that_would_be_lost_is_refused(tmp_path):
    write(tmp_path / "felt", "a.csv")
    write(tmp_path, "b.CSV")
    refused(tmp_path, "b.CSV: is beside the sub-folders and has no label; put it in the sub-folder of its class")
    (tmp_path / "b.CSV").unlink()
    np.savez(tmp_path / "c.npz", press=SIGNAL)
    refused(tmp_path, "c.npz: is beside the sub-folders")


def test_links_are_followed_and_loops_are_named(tmp_path):
    root, elsewhere = tmp_path / "in", tmp_path / "elsewhere"
    write(elsewhere, "a.csv")
    root.mkdir()
    (root / "felt").symlink_to(elsewhere)
    assert list(folder.read(root, 100, "mV").conditions.file) == ["felt/a.csv"]
    for target in (root, elsewhere):
        (elsewhere / "loop").symlink_to(target)
        refused(root, "loop: leads to ")
        (elsewhere / "loop").unlink()


@pytest.mark.parametrize("order", ["C", "F"])
def test_each_npy_file_is_a_trial(tmp_path, order):
    for label in ("felt", "silk"):
        (tmp_path / label).mkdir()
        np.save(tmp_path / label / "a.npy", np.asarray(SIGNAL, order=order))
    touch = folder.read(tmp_path, 100, "mV")
    assert list(touch.conditions.file) == ["felt/a.npy:a", "silk/a.npy:a"]
    np.testing.assert_array_equal(touch.signals[1], SIGNAL.astype(np.float32))
    turned = folder.read(tmp_path, 100, "mV", layout={"transpose": True})
    np.testing.assert_array_equal(turned.signals[0], SIGNAL.T.astype(np.float32))


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (SIGNAL[:, 0], "a.npy, key 'a': has shape (15,); save a (time, channel) array"),
        (
            SIGNAL[None],
            "a.npy, key 'a': has shape (1, 15, 3); save a (time, channel) array that is not empty; neurotact",
        ),
        (SIGNAL.astype(str), "a.npy, key 'a': holds <U"),
        (np.array([[{}]]), "a.npy: holds pickled Python objects, which are never loaded; save plain arrays"),
        (np.where(np.arange(45).reshape(15, 3) == 7, np.nan, SIGNAL), "a.npy, key 'a': sample 2, channel 1 is nan"),
    ],
)
def test_an_npy_file_that_is_no_trial_is_named(tmp_path, array, message):
    (tmp_path / "felt").mkdir()
    np.save(tmp_path / "felt" / "a.npy", array)
    refused(tmp_path, message)


def test_an_npy_file_is_bounded_by_what_it_declares(tmp_path, monkeypatch):
    monkeypatch.setenv(MAX_MB, "50")
    (tmp_path / "felt").mkdir()
    path = tmp_path / "felt" / "a.npy"
    path.write_bytes(npy_header("(1000000, 1000000)") + bytes(80))
    refused(tmp_path, "a.npy: holds 8,000,000 MB, more than the limit of 50 MB")
    path.write_bytes(npy_header("(100, 3)") + bytes(80))
    refused(tmp_path, "a.npy: cannot be read as an array (")


def test_text_files_of_labview_come_before_other_text(tmp_path, caplog):
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / "notes.txt").write_text("pressed twice\n")
    (tmp_path / "felt" / "a.lvm").write_text("left\tright\n1\t2\n3\t4\n")
    with caplog.at_level(logging.WARNING, "neurotact"):
        touch = folder.read(tmp_path, 100, "mV")
    assert (touch.channels, list(touch.conditions.file)) == (("left", "right"), ["felt/a.lvm"])
    assert caplog.messages == [f"{tmp_path}: ignores 1 file (hidden, or not recordings): felt/notes.txt"]


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n"


@pytest.mark.parametrize("suffix", folder.every_suffix())
def test_a_pointer_is_named_whatever_its_suffix(tmp_path, suffix):
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / f"a{suffix}").write_bytes(POINTER)
    refused(tmp_path, f"a{suffix}: is a Git LFS pointer, not the file itself; fetch the file with git lfs pull")


@pytest.mark.parametrize("suffix", [".h5", ".npz", ".mat"])
def test_a_pointer_in_place_of_arrays_or_recordings_is_named(tmp_path, suffix):
    (tmp_path / f"a{suffix}").write_bytes(POINTER)
    with pytest.raises(InputError, match="is a Git LFS pointer, not the file itself; fetch the file with git lfs pull"):
        arrays.read(tmp_path / f"a{suffix}", 100, "mV")
    (tmp_path / "a.csv").write_text("PAR1\n")
    with pytest.raises(InputError, match="is not HDF5 and cannot be read as recordings, but a Parquet table"):
        hdf5.load_recordings(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xlsx", b"PK\x03\x04", "but a.xlsx, which is a zip archive; unpack it and give the folder"),
        ("a.orc", b"ORC\x08\x03", "but a.orc, which is an ORC table; save it as CSV, in Python with pandas.read_orc"),
        ("a.csv.gz", b"\x1f\x8b", "but a.csv.gz, which is compressed by gzip; unpack it with gunzip"),
        ("a.dat", b"1 2\n3 4\n", "but a.dat; if it is a table of samples as text, name it .csv"),
    ],
)
def test_a_folder_says_what_it_holds_instead(tmp_path, name, content, message):
    write(tmp_path / "felt", "a.csv")
    (tmp_path / "silk").mkdir()
    (tmp_path / "silk" / name).write_bytes(content)
    refused(tmp_path, f"{tmp_path / 'silk'}: holds no {KINDS} file, {message}")
    (tmp_path / "felt" / "a.csv").unlink()
    with pytest.raises(InputError, match=r"\.db3 file, but silk/a\."):
        folder.read(tmp_path, 100, "mV", naming={"levels": "label"})


@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "nothing"])
def test_what_is_no_regular_file_is_never_opened(tmp_path, monkeypatch, kind):
    (tmp_path / "felt").mkdir()
    for suffix in folder.every_suffix():
        path = tmp_path / "felt" / f"a{suffix}"
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "socket":
            with socket.socket(socket.AF_UNIX) as server:
                monkeypatch.chdir(path.parent)  # the path of a socket is short
                server.bind(path.name)
        else:
            path.symlink_to("/dev/zero" if kind == "device" else "absent")
        refused(tmp_path, f"{path}: " + ("there is no such file" if kind == "nothing" else "is not a regular file"))
        path.unlink()


@pytest.mark.parametrize("name", ["fe\nlt", "fe\x1blt", os.fsdecode(b"fe\xfflt")])
def test_a_name_that_cannot_be_shown_is_refused(tmp_path, name):
    write(tmp_path / name, "a.csv")
    refused(tmp_path, "is not printable UTF-8 text; rename that file or folder")


def test_columns_are_bounded_and_compared_at_once(tmp_path):
    def header(n):
        return ",".join(f"t{i}x" for i in range(n)) + "\n" + ",".join("1" * n) + "\n"

    (tmp_path / "felt").mkdir()
    path = tmp_path / "felt" / "a.csv"
    path.write_text(header(10_000))
    assert folder.read(tmp_path, 100, "mV").n_channels == 10_000
    path.write_text(header(50_000))
    refused(tmp_path, "a.csv: has 10001 columns, more than 10000 taxels")
    path.write_text(",".join("1" * 50_000))
    refused(tmp_path, "columns, more than 10000 taxels")
    path.unlink()
    np.savez(tmp_path / "felt" / "a.npz", press=np.zeros((2, 10_001)))
    refused(tmp_path, "a.npz, key 'press': has 10001 columns, more than 10000 taxels")


def npy_header(shape: str, descr: str = "<f8") -> bytes:
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


@pytest.mark.parametrize("bomb", ["one member", "many members", "a header that lies", "a huge header", "text"])
def test_an_archive_is_bounded_by_what_it_declares(tmp_path, monkeypatch, bomb):
    monkeypatch.setenv(MAX_MB, "50")
    (tmp_path / "felt").mkdir()
    path = tmp_path / "felt" / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        if bomb == "one member":
            archive.writestr("x.npy", npy_header("(7000000, 1)") + bytes(56_000_000))
        elif bomb == "many members":
            for i in range(6):
                archive.writestr(f"x{i}.npy", npy_header("(1250000, 1)") + bytes(10_000_000))
        elif bomb == "text":
            archive.writestr("x", bytes(56_000_000))
        else:
            shape = "(10**6, 10**6)" if bomb == "a huge header" else "(1000000, 1000000)"
            archive.writestr("x.npy", npy_header(shape) + bytes(80))
    assert path.stat().st_size < 200_000
    tracemalloc.start()
    is_damaged = bomb == "a huge header"  # numpy reads shapes as literals
    refused(tmp_path, "a.npz: is a damaged" if is_damaged else "MB, more than the limit of 50 MB; set NEUROTACT_MAX_MB")
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()


def test_a_table_is_bounded_by_its_size_and_by_that_of_its_numbers(tmp_path, monkeypatch):
    monkeypatch.setenv(MAX_MB, "1")
    (tmp_path / "felt").mkdir()
    path = tmp_path / "felt" / "a.csv"
    for content, n_bytes in ((b"1\n" * 200_000, 8 * 200_000), (b"0.00000000001\n" * 120_000, 14 * 120_000)):
        path.write_bytes(content)
        refused(tmp_path, f"{path}: holds {n_bytes / 1e6:,.0f} MB, more than the limit of 1 MB")
    path.unlink()
    for i in range(5):
        (tmp_path / "felt" / f"{i}.csv").write_bytes(b"1\n" * 60_000)
    refused(tmp_path, f"{tmp_path}: holds 1 MB, more than the limit of 1 MB")


def test_trials_of_other_taxels_are_refused(tmp_path):
    write(tmp_path / "felt", "a.csv")
    write(tmp_path / "silk", "b.csv", SIGNAL[:, :2], "a,b")
    fix = "move the file away, or name taxels that all files have with `columns`"
    refused(tmp_path, f"silk/b.csv: has 2 channels where felt/a.csv has 3 (c is not in silk/b.csv); {fix}")
    for name, columns in (("felt/a", "a,b,c"), ("silk/b", "a,c")):
        write((tmp_path / name).parent, f"{name[5:]}.csv", SIGNAL[:, : len(columns.split(","))], columns)
    refused(tmp_path, f"silk/b.csv: has 2 channels where felt/a.csv has 3 (b is not in silk/b.csv); {fix}")
    write(tmp_path / "silk", "b.csv", header="a,c,b")
    refused(tmp_path, "silk/b.csv: column 2 is 'c' where felt/a.csv has 'b'")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: holds no row"),
        ("a,b\n", "a.csv: holds no row"),
        ("a,b\n1,2\n3\n", "a.csv: line 3 has 1 column where 2 are expected"),
        ("a,b\n1,2,3\n", "a.csv: line 2 has 3 columns where 2 are expected"),
        ("1,2\n3,x\n", "a.csv: line 2, column 2 is 'x'"),
        ("1,x\n3,4\n", "a.csv: line 1, column 2 is 'x'"),
        ("a,b\n1,nan\n", "a.csv: line 2, column 2 (b) is nan"),
        ("nan,nan\n1,2\n", "a.csv: line 1, column 1 is nan"),
        ("a,b,\n1,2,3\n", "a.csv: line 2 has 3 columns where 2 are expected"),
        ("a,a\n1,2\n", "a.csv: two columns are named 'a'"),
        ("0,1,2\n1,2,3\n", "a.csv: line 1 counts 0 to 2, which looks like column numbers"),
        ("a;b\n1,5;2.5\n", "a.csv: line 2 has decimal commas; pass `decimal=','` or write decimal points"),
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
    refused(tmp_path, f"silk: holds no {KINDS} file; add one or remove")


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
