"""What stands in the first rows of exports, and whole numbers that float32 does not hold."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data.readers.table.cells import lost_digits
from neurotact.errors import InputError

OPTIONS = re.compile(r"`(header_lines|sampling_rate_Hz)=([\d.]+)`")
UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def folder_of(folder, rows, name="felt/1.csv", form="{:.3f}"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(",".join(form.format(cell) for cell in row) for row in rows) + "\n")
    return folder


@given(
    st.integers(1, 3), st.sampled_from([4.0, 32.0, 64.0, 1000.0]), st.sampled_from([*UNITS]),
    st.sampled_from(["two rows", "one row", "no rate"]), st.floats(1e9, 2e9),
    st.sampled_from(["", "# Empatica\n", "x"]), st.booleans(),
)  # fmt: skip
def test_a_start_time_is_no_sample_and_the_advice_is_right(
    tmp_path_factory, n, rate_Hz, unit, kind, start_s, above, is_whole
):
    """First the start time, then the rate, in all columns or beside one another, as devices on the wrist write them."""
    n = max(n, 2) if kind == "one row" else n
    samples = np.round(3 * np.random.default_rng(0).random((50, n)) - 1, 3)
    samples = np.round(60 * samples) if is_whole else samples
    start = float(int(start_s)) * UNITS[unit]
    heads = {
        "two rows": [[start] * n, [rate_Hz] * n],
        "one row": [[start, *[rate_Hz] * (n - 1)]],
        "no rate": [[start] * n],
    }
    if kind == "one row" and rate_Hz <= np.abs(samples).max():
        heads["one row"] = heads["no rate"]
    folder = folder_of(
        tmp_path_factory.mktemp("rows"), [*heads[kind], *samples], form="{:.0f}" if is_whole else "{:.3f}"
    )
    path = folder / "felt" / "1.csv"
    names = ",".join(f"p{column}" for column in range(n)) + "\n"
    path.write_text((names if above == "x" else above) + path.read_text())
    with pytest.raises(InputError, match=r"line \d holds a start time") as refusal:
        nt.read_folder(folder, 100, "V")
    if not OPTIONS.search(str(refusal.value)):  # a whole number may be a sample or the rate
        assert is_whole or n == 1
        assert "remove it, and line" in str(refusal.value)
        return
    advised = {name: float(value) for name, value in OPTIONS.findall(str(refusal.value))}
    found = nt.read_folder(
        folder, advised.get("sampling_rate_Hz", 100), "V", layout=nt.Layout(header_lines=int(advised["header_lines"]))
    )
    np.testing.assert_array_equal(found.signals[0], samples.astype(np.float32))
    if len(heads[kind]) == 2:
        assert found.sampling_rate_Hz == rate_Hz


def test_a_rate_beside_the_start_time_leaves_the_row_below(tmp_path):
    samples = np.vstack([[5.0, 5.0], np.random.default_rng(0).random((50, 2))])
    folder = folder_of(tmp_path, [[1.6e9, 64.0], *samples])
    with pytest.raises(InputError, match=r"the sampling rate is 64 Hz; skip what is no sample with `header_lines=1`"):
        nt.read_folder(folder, 100, "V")
    folder_of(tmp_path, [[1.6e9, 1.6e9], *(1.6e9 + np.cumsum(samples, axis=0))])
    nt.read_folder(folder, 100, "V")  # samples that are as large


@pytest.mark.parametrize("decimals", [0, 3])
def test_what_may_be_a_sample_is_left_to_the_reader(tmp_path, decimals):
    samples = np.round(100 * np.random.default_rng(0).random((50, 1)), decimals)
    samples[0] = 32
    with pytest.raises(
        InputError, match=r"a start time, .*; remove it, and line 2, too, if that is the sampling rate$"
    ):
        nt.read_folder(folder_of(tmp_path, [[1.6e9], *samples]), 100, "V")


def test_a_start_time_in_arrays_is_refused(tmp_path):
    samples = np.random.default_rng(0).random((3, 50, 2))
    samples[1, :2] = [[1.6e9], [64.0]]
    np.savez(tmp_path / "a.npz", X=samples, y=[*"aba"])
    message = (
        r"trial 1: sample 0 holds a start time, 1.6e\+09 s since 1970, .* 64 Hz; remove the first 2 rows, and give"
    )
    with pytest.raises(InputError, match=message):
        nt.read_arrays(tmp_path / "a.npz", 100, "V")
    np.save(tmp_path / "b.npy", samples[1])
    (tmp_path / "felt").mkdir()
    (tmp_path / "b.npy").rename(tmp_path / "felt" / "b.npy")
    (tmp_path / "a.npz").unlink()
    with pytest.raises(InputError, match="holds a start time"):
        nt.read_folder(tmp_path, 100, "V")


@pytest.mark.parametrize(("first", "rate_Hz", "is_doubted"), [
    (1000.0, 100, True), (100.0, 100, True), (3.0, 100, False), (1000.5, 100, False), (50.0, 100, False),
])  # fmt: skip
def test_a_rate_above_the_samples_is_doubted(tmp_path, caplog, first, rate_Hz, is_doubted):
    samples = np.random.default_rng(0).normal(size=(50, 2))
    nt.read_folder(folder_of(tmp_path, [[first] * 2, *samples]), rate_Hz, "V")
    assert ("the first row of 1 of 1 trials looks like a sampling rate" in caplog.text) == is_doubted
    assert not is_doubted or "skip it with `header_lines=1`" in caplog.text


@given(st.lists(st.integers(-(2**31), 2**32), min_size=1, max_size=9))
def test_whole_numbers_are_kept_or_refused(values):
    array = np.array(values)
    assert bool(lost_digits(array)) == (array.astype(np.float32).astype(np.int64) != array).any()
    assert lost_digits(array.astype(float)) == lost_digits(array)
    assert not lost_digits(array + 0.5)


@pytest.mark.parametrize("kind", ["folder", "arrays", "table", "npy"])
def test_every_import_refuses_counts_that_lose_digits(tmp_path, kind):
    counts = 2**28 + np.random.default_rng(0).integers(0, 100, (40, 2))
    folder = tmp_path / "felt"
    folder.mkdir()
    rows = [["trial", "label", "p", "q"], *([1, "felt", *row] for row in counts.tolist())]
    readers = {
        "folder": lambda: nt.read_folder(folder_of(tmp_path, counts.tolist(), form="{}"), 100, "count"),
        "table": lambda: nt.read_table(folder_of(tmp_path, rows, "a.csv", "{}") / "a.csv", 100, "count"),
        "npy": lambda: np.save(folder / "1.npy", counts) or nt.read_folder(tmp_path, 100, "count"),
        "arrays": lambda: nt.read_arrays(tmp_path / "a.npz", 100, "count"),
    }
    if kind == "arrays":
        np.savez(tmp_path / "a.npz", X=counts.reshape(2, 20, 2), y=[*"ab"])
    with pytest.raises(InputError, match=r"of which float32 keeps 268435\d\d\d; subtract an offset"):
        readers[kind]()


def test_half_floats_hold_no_number_that_is_too_long_and_warn_of_none():
    """The limit is beyond their range; a warning is an error here."""
    assert lost_digits(np.array([[1.5, 65504.0]], np.float16)) == ""
