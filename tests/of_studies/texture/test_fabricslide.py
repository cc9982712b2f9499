"""FabricSlide: the published files, and every way they may be damaged."""

import logging

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.texture import reader as fabricslide

from neurotact.errors import InputError

HEADER = ", ".join(fabricslide.COLUMNS)
NAME = "Denim_F150_V-20mmps_1.csv"
SHORT = examples(60)


def slide(n_rows=12, start_ms=500, interval_ms=28.08):
    """Rows as published: whole milliseconds, proximity, 16 counts."""
    counts = np.random.default_rng(n_rows).integers(2, 834, (n_rows, 16))
    return [[round(start_ms + i * interval_ms), 0, 65535, *counts[i]] for i in range(n_rows)]


def write(folder, rows, name=NAME):
    lines = [HEADER, *(",".join(map(str, row)) for row in rows)]
    (folder / name).write_text("\n".join(lines) + "\n")


def refused(folder, message):
    with pytest.raises(InputError) as refusal:
        fabricslide.read(folder)
    assert message in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


def attempt(read):
    """The recordings, or None and why they were refused."""
    try:
        return read(), ""
    except InputError as error:
        return None, str(error)


@given(n_rows=st.integers(30, 200), start_ms=st.integers(0, 10**7))
@SHORT
def test_what_is_written_is_read(tmp_path, n_rows, start_ms):
    rows = slide(n_rows, start_ms)
    write(tmp_path, rows)
    recordings = fabricslide.read(tmp_path)
    np.testing.assert_array_equal(recordings.signals[0], np.array(rows)[:, 3:])
    assert recordings.signals[0].dtype == np.float32
    assert recordings.sampling_rate_Hz == pytest.approx(1000 / 28.08, abs=0.005 + 36 / 28 / (n_rows - 1))
    assert recordings.conditions.to_dict("records") == [
        {"label": "Denim", "pressure_setpoint": 150, "speed_mm_per_s": -20.0, "repetition": 1, "file": NAME}
    ]


def test_slides_come_in_the_order_of_their_names_and_other_files_are_ignored(tmp_path):
    fabric = tmp_path / "data" / "fabric"
    fabric.mkdir(parents=True)
    for name in ("Linen_F120_V10mmps_0.csv", "Canvas_F120_V10mmps_0.csv", "Canvas_F120_V-10mmps_1.csv"):
        write(fabric, slide(), name)
    (fabric / "LICENSE").write_text("MIT")
    (fabric / "._Linen_F120_V10mmps_0.csv").write_bytes(b"\0\5")
    conditions = fabricslide.read(tmp_path).conditions
    assert list(conditions.file) == sorted(conditions.file)
    assert len(conditions) == 3


def test_a_repeated_timestamp_is_dropped_and_said(tmp_path, caplog):
    rows = slide()
    write(tmp_path, [*rows, rows[-1]])
    with caplog.at_level(logging.WARNING, "neurotact"):
        recordings = fabricslide.read(tmp_path)
    np.testing.assert_array_equal(recordings.signals[0], np.array(rows)[:, 3:])
    assert f"{NAME}: line 14 repeats the timestamp" in caplog.text


def test_missing_rows_and_time_that_runs_back_are_refused(tmp_path):
    rows = slide()
    write(tmp_path, rows[:5] + rows[6:])
    refused(tmp_path, f"{NAME}: line 7 comes 56 ms after the line before it where 28 ms is usual")
    write(tmp_path, [*rows[:5], rows[2], *rows[5:]])
    refused(tmp_path, f"{NAME}: line 7 comes -56 ms after")
    write(tmp_path, rows[::-1])
    refused(tmp_path, f"{NAME}: line 3 comes -28 ms after")
    write(tmp_path, [rows[0]] * 3)
    refused(tmp_path, f"{NAME}: holds a single time")


def test_a_file_of_another_sampling_rate_is_refused(tmp_path):
    for repetition in range(3):
        write(tmp_path, slide(100), f"Denim_F150_V20mmps_{repetition}.csv")
    write(tmp_path, slide(100, interval_ms=29.0), NAME)
    refused(tmp_path, f"{NAME}: has a row every 29.00 ms, the other files one every 28.08 ms")


@pytest.mark.parametrize("name", ["Denim.csv", "Denim_F150_V20_0.csv", "Denim_Fx_V20mmps_0.csv", "F1_V2mmps_0.csv"])
def test_another_name_is_refused_with_the_pattern(tmp_path, name):
    write(tmp_path, slide(), name)
    refused(tmp_path, f"{name}: is not named <Fabric>_F<set-point>_V<speed>mmps_<repetition>.csv")


def test_a_folder_without_slides_is_refused(tmp_path):
    refused(tmp_path, "holds no .csv file")
    refused(tmp_path / "absent", "there is no such folder")


@given(cut=st.integers(0, 10**6), flip=st.none() | st.integers(0, 255))
@example(cut=0, flip=None)
@SHORT
def test_a_cut_or_damaged_file_is_what_it_was_or_refused(tmp_path, cut, flip):
    rows = slide()
    write(tmp_path, rows)
    content = (tmp_path / NAME).read_bytes()
    cut %= len(content)
    damaged = content[:cut] if flip is None else content[:cut] + bytes([flip]) + content[cut + 1 :]
    (tmp_path / NAME).write_bytes(damaged)
    recordings, refusal = attempt(lambda: fabricslide.read(tmp_path))
    if recordings is None:
        assert NAME in refusal
        assert "\n" not in refusal
        return
    signal = recordings.signals[0]
    if flip is None:
        np.testing.assert_array_equal(signal, np.array(rows)[: len(signal), 3:])
    assert (signal != np.array(rows)[: len(signal), 3:]).sum() <= 1


@given(row=st.integers(0, 11), column=st.integers(0, 18), cell=st.sampled_from(["", "nan", "inf", "x", "1e400", "1;2"]))
@SHORT
def test_a_cell_that_is_no_number_is_named(tmp_path, row, column, cell):
    rows = slide()
    rows[row][column] = cell
    write(tmp_path, rows)
    refused(tmp_path, f"{NAME}: line {row + 2}, column {column + 1} ({fabricslide.COLUMNS[column]}) is")


@given(column=st.integers(0, 18), with_header=st.booleans())
@SHORT
def test_a_lost_column_is_refused(tmp_path, column, with_header):
    rows = [row[:column] + row[column + 1 :] for row in slide()]
    write(tmp_path, rows)
    if with_header:
        names = [name for i, name in enumerate(fabricslide.COLUMNS) if i != column]
        text = (tmp_path / NAME).read_text().replace(HEADER, ", ".join(names))
        (tmp_path / NAME).write_text(text)
    refused(tmp_path, f"{NAME}: line 1 must name" if with_header else f"{NAME}: line 2 has 18 columns where 19 are")


@pytest.fixture(scope="module")
def published(data_folder):
    return fabricslide.read(data_folder / "fabricslide")


def test_published_slides(published):
    assert len(published) == 644
    assert published.unit == "count"
    assert published.n_channels == 16
    assert published.sampling_rate_Hz == 35.61
    lengths = [len(signal) for signal in published.signals]
    assert (min(lengths), max(lengths)) == (141, 2117)
    assert published.conditions.label.value_counts().to_dict() == {
        "BeigeCotton": 120, "BrownCotton": 120, "Canvas": 120, "Linen": 120,
        "WovenFabric": 68, "Denim": 48, "DenimFlex": 48,
    }  # fmt: skip
    assert set(published.conditions.pressure_setpoint) == {120, 150, 180, 210, 250}
    assert set(published.conditions.speed_mm_per_s.abs()) == {10, 20, 50, 100, 120, 150}
    assert set(published.conditions.repetition) == {0, 1}


def test_published_slides_that_repeat_a_timestamp_lose_one_row(published, data_folder):
    shorter = []
    for file, signal in zip(published.conditions.file, published.signals, strict=True):
        content = (data_folder / "fabricslide" / "fabric" / file).read_bytes()
        if content.count(b"\n") - 1 != len(signal):
            shorter.append((file, content.count(b"\n") - 1 - len(signal)))
    assert shorter == [("BeigeCotton_F120_V20mmps_0.csv", 1), ("WovenFabric_F150_V-120mmps_0.csv", 1)]
