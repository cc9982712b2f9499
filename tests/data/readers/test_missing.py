"""Missing samples: every file with one is named, they are interpolated or their trials dropped, within limits."""

import logging

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.errors import InputError

TIMES = np.arange(100) / 100


def write(folder, label: str, number: int, changes: dict[int, str | None], *, stamped: bool = True) -> None:
    """A file of two taxels on lines, with other lines in place of some; None: the line is empty."""
    (folder / label).mkdir(parents=True, exist_ok=True)
    rows = [f"{t:.2f},{2 * t:.4f},{1 - t:.4f}" if stamped else f"{2 * t:.4f},{1 - t:.4f}" for t in TIMES]
    for row, text in changes.items():
        rows[row] = text or ""
    head = "t,left,right\n" if stamped else "left,right\n"
    (folder / label / f"{number}.csv").write_text(head + "\n".join(rows) + "\n")


def eight(folder, faults: dict[str, dict[int, str | None]], *, stamped: bool = True):
    for label in "ab":
        for number in range(4):
            write(folder, label, number, faults.get(f"{label}{number}", {}), stamped=stamped)
    return folder


GAPS = {"a1": {10: "0.10,,0.9"}, "a2": {20: "0.20,NaN,0.8"}, "b1": {99: "0.99,1.9"}, "b3": {5: None}}


def test_every_file_with_a_fault_is_named_at_once(tmp_path):
    with pytest.raises(InputError) as refused:
        nt.read_folder(eight(tmp_path, GAPS), unit="V")
    said = str(refused.value)
    assert said.startswith(
        f"{tmp_path}/a/1.csv: line 12, column 2 (left) is empty; repair the gap, fill it with `missing="
    )
    assert "3 other files have faults: a/2.csv (line 22, column 2 (left) is NaN), b/1.csv (line 101 has 2 col" in said
    assert said.endswith("b/3.csv (line 7 is empty)")


def test_after_many_files_with_faults_no_more_are_read(tmp_path):
    for number in range(30):
        write(tmp_path, "a", number, {number % 7 + 1: "x,y,z"})
    with pytest.raises(InputError, match=r"at least 19 other files have faults: a/1\.csv"):
        nt.read_folder(tmp_path, unit="V")


def test_a_fault_that_all_files_have_is_told_once(tmp_path):
    for number in range(30):
        write(tmp_path, "a", number, {3: "x,y,z"})
    with pytest.raises(InputError, match=r"with `columns`; at least 19 other files have the same fault$"):
        nt.read_folder(tmp_path, unit="V")


def test_missing_samples_are_interpolated_and_counted(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        found = nt.read_folder(
            eight(tmp_path, {"a1": GAPS["a1"], "a2": GAPS["a2"]}), unit="V", layout=nt.Layout(missing="interpolate")
        )
    assert "2 of 1,600 samples are missing and interpolated, in 2 of 8 trials (a/1.csv, a/2.csv)" in caplog.text
    for signal in found.signals:
        assert np.abs(signal - np.stack([2 * TIMES, 1 - TIMES], axis=1)).max() < 1e-4


@given(st.sets(st.integers(0, 99), min_size=1, max_size=5), st.sampled_from(["", "nan", "NA", "-", "null"]))
def test_an_interpolated_sample_is_on_the_line_of_its_neighbours(tmp_path_factory, rows, word):
    folder = eight(tmp_path_factory.mktemp("gaps"), {"b2": {row: f"{TIMES[row]:.2f},{word},{1 - TIMES[row]:.4f}"
                                                            for row in rows}})  # fmt: skip
    found = np.asarray(nt.read_folder(folder, unit="V", layout=nt.Layout(missing="interpolate")).signals[6])
    whole = sorted({*range(100)} - rows)
    expected = np.interp(np.arange(100), whole, 2 * TIMES[whole])
    assert np.abs(found[:, 0] - expected).max() < 1e-4
    assert np.abs(found[:, 1] - (1 - TIMES)).max() < 1e-4


def test_a_line_that_is_cut_is_a_missing_sample_where_no_stamp_shows_its_place(tmp_path):
    faults: dict[str, dict[int, str | None]] = {"b1": {99: "1.9"}, "b3": {5: None}}
    found = nt.read_folder(eight(tmp_path, faults, stamped=False), 100.0, "V", layout=nt.Layout(missing="interpolate"))
    assert found.lengths.tolist() == [100] * 8
    assert abs(found.signals[7][5, 0] - 0.1) < 1e-4


def test_too_many_are_refused(tmp_path):
    faults: dict[str, dict[int, str | None]] = {"a1": {row: f"{TIMES[row]:.2f},,0" for row in range(10, 16)}}
    with pytest.raises(InputError, match=r"a/1.csv: 6.0 % of the samples of left are missing, more than 5 % to"):
        nt.read_folder(eight(tmp_path, faults), unit="V", layout=nt.Layout(missing="interpolate"))
    with pytest.raises(InputError, match=r"4 of 8 trials have missing samples .*, more than 20 % to drop"):
        nt.read_folder(eight(tmp_path, GAPS), unit="V", layout=nt.Layout(missing="drop-trial"))


def test_trials_with_missing_samples_are_dropped_with_their_conditions(tmp_path, caplog):
    found = nt.read_folder(eight(tmp_path, {"b3": GAPS["b3"]}), unit="V", layout=nt.Layout(missing="drop-trial"))
    assert "1 of 8 trials have missing samples and are dropped (b/3.csv)" in caplog.text
    assert found.conditions["file"].tolist() == [
        "a/0.csv",
        "a/1.csv",
        "a/2.csv",
        "a/3.csv",
        "b/0.csv",
        "b/1.csv",
        "b/2.csv",
    ]
    assert found.conditions["label"].tolist() == [*"aaaabbb"]


@pytest.mark.parametrize("how", ["interpolate", "drop-trial"])
def test_an_option_without_effect_is_refused(tmp_path, how):
    with pytest.raises(InputError, match="no sample is missing; leave it out"):
        nt.read_folder(eight(tmp_path, {}), unit="V", layout=nt.Layout(missing=how))


def test_other_faults_stay_faults(tmp_path):
    for cell in ("inf", "1.5 mV", "x"):
        with pytest.raises(InputError, match="column 2"):
            nt.read_folder(
                eight(tmp_path, {"a1": {10: f"0.10,{cell},0.9"}}), unit="V", layout=nt.Layout(missing="interpolate")
            )


@pytest.mark.parametrize("how", ["interpolate", "drop-trial"])
def test_a_table_of_all_trials_may_lack_samples(tmp_path, how):
    rows = [f"{trial},{'ab'[trial % 2]},{2 * t:.4f},{1 - t:.4f}" for trial in range(6) for t in TIMES]
    rows[250] = "2,a,,0.5"
    (tmp_path / "all.csv").write_text("trial,label,left,right\n" + "\n".join(rows) + "\n")
    with pytest.raises(InputError, match="is empty; repair the gap, fill it with"):
        nt.read_table(tmp_path / "all.csv", 100.0, "V")
    found = nt.read_table(tmp_path / "all.csv", 100.0, "V", layout=nt.Layout(missing=how))
    assert found.conditions["trial"].tolist() == ([*range(6)] if how == "interpolate" else [0, 1, 3, 4, 5])
    if how == "interpolate":
        assert abs(found.signals[2][50, 0] - 1.0) < 1e-4


def test_a_text_that_differs_between_files_is_a_condition(tmp_path, caplog):
    for label in "ab":
        (tmp_path / label).mkdir()
        for number in range(4):
            session = ("mon", "tue")[number % 2]
            rows = "".join(f"{t:.2f},{t},{session},V\n" for t in TIMES)
            (tmp_path / label / f"{number}.csv").write_text("t,left,session,unit\n" + rows)
    found = nt.read_folder(tmp_path, unit="V")
    assert found.conditions["session"].tolist() == ["mon", "tue"] * 4
    assert found.channels == ("left",)
    assert "unit" not in found.conditions
    assert "`split=nt.Split(group='session')`" in caplog.text
    assert "holds no number, so no taxel: unit ('V')" in caplog.text


def test_columns_that_are_empty_to_the_end_change_no_other(tmp_path):
    for label in "ab":
        (tmp_path / label).mkdir()
        rows = "".join(f"{t:.2f},{t},{'x' if label == 'a' else 'y'}{',' * 15}\n" for t in TIMES)
        (tmp_path / label / "0.csv").write_text("t,left,who" + "".join(f",c{n}" for n in range(15)) + "\n" + rows)
    found = nt.read_folder(tmp_path, unit="V")
    assert found.channels == ("left",)
    assert found.conditions["who"].tolist() == ["x", "y"]
    assert np.abs(found.signals[1][:, 0] - TIMES).max() < 1e-6
