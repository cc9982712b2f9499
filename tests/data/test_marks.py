"""Marks, the annotations in time of long recordings: what they may be, and that nothing on the way loses them."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data import marks
from neurotact.data.augmentation import AugmentationSpec
from neurotact.data.hdf5 import open_recordings
from neurotact.encoders.encoding import encode_file, encode_recordings
from neurotact.encoders.specs import load

MARKS = {
    "trial": [2, 0, 0], "start_s": [0.1, 0.25, 0.05], "stop_s": [0.3, 0.3, 0.25], "label": ["slip", "slip", "contact"]
}  # fmt: skip
SORTED = [[0, 0.05, 0.25, "contact"], [0, 0.25, 0.3, "slip"], [2, 0.1, 0.3, "slip"]]


def marks_of(one) -> pd.DataFrame:
    assert one.marks is not None
    return one.marks


def rows_of(one) -> list[list]:
    return marks_of(one).values.tolist()


def long_recordings(**changes):
    noise = np.random.default_rng(0).standard_normal((3, 300, 2))
    return nt.Recordings(noise, 1000.0, "mV", ["session"] * 3, marks={**MARKS, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trial": [3, 0, 0]}, "trial that is none of the 3"),
        ({"stop_s": [0.31, 0.3, 0.25]}, "does not lie within its trial"),
        ({"start_s": [0.3, 0.25, 0.05]}, "does not lie within its trial"),
        ({"start_s": [-0.1, 0.25, 0.05]}, "does not lie within its trial"),
        ({"start_s": [np.nan, 0.25, 0.05]}, "does not lie within its trial"),
        ({"stop_s": [0.3, 0.3, 0.26]}, "overlaps the next one"),
        ({"label": ["none", "slip", "contact"]}, "no label of its own"),
        ({"start_s": ["soon", 0.25, 0.05]}, "marks need the columns"),
    ],
)
def test_marks_that_cannot_be_are_refused(changes, message):
    with pytest.raises(nt.InputError, match=message):
        long_recordings(**changes)


def test_marks_without_a_column_are_refused():
    with pytest.raises(nt.InputError, match=r"marks need the columns .*stop_s"):
        nt.Recordings(np.ones((1, 9, 1)), 9.0, "mV", ["a"], marks={"trial": [0], "start_s": [0], "label": ["b"]})


def test_files_selections_and_spikes_keep_marks(tmp_path):
    recordings, encoder = long_recordings(), load("sa1-ra1-lif", {"conditioning.baseline": "start"})
    nt.save(recordings, tmp_path / "a.h5")
    with open_recordings(tmp_path / "a.h5") as stored:
        encode_file(stored, encoder, tmp_path / "b.h5")
        of_file = [stored, stored.loaded(), stored.in_order(["taxel2", "taxel1"])]
        assert rows_of(stored.select([2])) == [[0, 0.1, 0.3, "slip"]]
    spikes = encode_recordings(recordings, encoder)
    nt.save(spikes, tmp_path / "c.h5")
    kept = [recordings, recordings.to_unit("V"), *of_file, spikes, *map(nt.load, tmp_path.glob("*.h5"))]
    assert all(rows_of(one) == SORTED for one in kept)
    for one in (recordings, spikes):
        assert rows_of(one.select([2, 1, 0])) == [
            [0, 0.1, 0.3, "slip"],
            *([2, *r[1:]] for r in SORTED[:2]),
        ]
    varied = encode_recordings(recordings, encoder, augmentation=AugmentationSpec(kind="gain", copies=1))
    assert rows_of(varied) == SORTED
    nt.save(varied, tmp_path / "varied.h5")
    assert rows_of(nt.load(tmp_path / "varied.h5")) == SORTED


def test_a_trial_without_marks_stays_annotated(tmp_path):
    nt.save(long_recordings().select([1]), tmp_path / "a.h5")
    assert rows_of(nt.load(tmp_path / "a.h5")) == []
    assert not [line for line in described(tmp_path / "a.h5") if line.startswith("marks")]


def described(path):
    lines = []
    nt.describe(path, show=lambda line: lines.append(str(line)))
    return lines


def test_the_marks_of_a_file_are_told_with_how_long_they_last(tmp_path):
    recordings = long_recordings()
    nt.save(recordings, tmp_path / "a.h5")
    (line,) = (line for line in described(tmp_path / "a.h5") if line.startswith("marks"))
    for label in {row[3] for row in SORTED}:
        lasts = [stop - start for _, start, stop, its in SORTED if its == label]
        ends = " to ".join(dict.fromkeys(f"{end:.3g}" for end in (min(lasts), max(lasts))))
        assert f"{label} ({len(lasts)}, {ends} s long)" in line
    share = sum(stop - start for _, start, stop, _ in SORTED) / (recordings.lengths.sum() / recordings.sampling_rate_Hz)
    assert f"; {100 * share:.2g} % of the time has one (`nt.train(" in line


@given(st.lists(st.integers(1, 9), min_size=2, max_size=9), st.integers(0, 1))
def test_the_label_in_force_is_that_of_the_last_mark_that_began(lengths, first):
    edges = np.cumsum([0, *lengths])
    spans = [*pairwise(edges)][first::2]
    table = pd.DataFrame([(0, a, b, f"m{a}") for a, b in spans], columns=marks.COLUMNS)
    times = np.arange(edges[-1] + 2)
    expected = [next((f"m{a}" for a, b in spans if a <= t < b), marks.NONE) for t in times]
    assert marks.labels_at(table, np.zeros(len(times), int), times).tolist() == expected


@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_a_continuous_recording_is_kept_whole_with_its_marks(tmp_path, scale):
    rows = pd.DataFrame({
        "t": np.arange(400) / 1000 * scale, "p": np.random.default_rng(0).standard_normal(400),
        "label": np.repeat(["rest", "contact", "slip", "rest"], [50, 150, 100, 100]),
    })  # fmt: skip
    rows.rename(columns={"t": "t_s" if scale == 1 else "t_ms"}).to_csv(tmp_path / "all.csv", index=False)
    cut = nt.read_table(tmp_path / "all.csv", unit="mV", segments=True, leave_out="rest")
    whole = nt.read_table(tmp_path / "all.csv", unit="mV", segments=True, leave_out="rest", keep_whole=True)
    assert len(whole) == 1
    assert marks_of(whole)["label"].tolist() == cut.conditions["label"].tolist() == ["contact", "slip"]
    assert np.allclose(marks_of(whole)[["start_s", "stop_s"]], [[0.05, 0.2], [0.2, 0.3]])
    assert (whole.signals[0][50:200] == cut.signals[0]).all()


def test_recordings_of_one_table_and_annotations_are_kept_whole(tmp_path):
    rows = pd.DataFrame({
        "p": np.random.default_rng(0).standard_normal(400), "session": np.repeat(["b", "a"], 200),
        "label": np.tile(np.repeat(["none", "slip"], [120, 80]), 2),
    })  # fmt: skip
    rows.to_csv(tmp_path / "all.csv", index=False)
    rows[["p"]].to_csv(tmp_path / "one.csv", index=False)
    pd.DataFrame({"begin": [0.1, 0.35], "end": [0.2, 0.4], "label": ["slip", "lift"]}).to_csv(
        tmp_path / "marks.csv", index=False
    )
    how = {"unit": "mV", "sampling_rate_Hz": 1000.0, "keep_whole": True}
    two = nt.read_table(tmp_path / "all.csv", trial="session", segments=True, leave_out="none", **how)
    assert two.conditions["session"].tolist() == ["b", "a"]
    assert np.allclose(marks_of(two)[marks.COLUMNS[:3]], [[0, 0.12, 0.2], [1, 0.12, 0.2]])
    one = nt.read_table(tmp_path / "one.csv", annotations=tmp_path / "marks.csv", **how)
    assert np.allclose(marks_of(one)[marks.COLUMNS[:3]], [[0, 0.1, 0.2], [0, 0.35, 0.4]])
    with pytest.raises(nt.InputError, match="keep_whole"):
        nt.read_table(tmp_path / "all.csv", trial="session", **how)
