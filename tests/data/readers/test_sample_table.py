"""One table with the samples of all trials: trials, classes, conditions and taxels are found, or the fix is named."""

import logging

import numpy as np
import pandas as pd
import pytest
from as_specs import of_table
from hypothesis import assume, given
from hypothesis import strategies as st
from levels import examples

import neurotact as nt
from neurotact.errors import InputError


def write(path, text):
    path.write_text(text)
    return path


TRIALS = st.lists(
    st.tuples(st.sampled_from(["felt", "silk", "01", "3"]), st.integers(0, 3), st.integers(1, 30)),
    min_size=1, max_size=6, unique_by=lambda trial: trial[:2],
)  # fmt: skip


@given(TRIALS, st.sampled_from([",.", ";.", ";,", "\t.", "\t,"]), st.integers(0, 2**31))
def test_a_table_is_read_back_trial_by_trial(tmp_path_factory, trials, marks, seed):
    separator, decimal = marks
    rng = np.random.default_rng(seed)
    signals = [rng.normal(size=(2 + n, 3)).astype(np.float32) for *_, n in trials]
    frames = [
        pd.DataFrame(
            {"class": label, "repetition": repetition, "force_N": 1.5, **dict(zip("abc", signal.T, strict=True))}
        )
        for (label, repetition, _), signal in zip(trials, signals, strict=True)
    ]
    path = tmp_path_factory.getbasetemp() / "table.csv"
    pd.concat(frames).to_csv(path, index=False, sep=separator, decimal=decimal)
    layout = nt.Layout() if seed % 2 else nt.Layout(decimal=decimal)  # found, or given
    found = nt.read_table(path, 100, "mV", trial="class,repetition", layout=layout)
    assert found.channels == ("a", "b", "c")
    assert found.conditions[["label", "repetition", "force_N"]].values.tolist() == [
        [label, repetition, 1.5] for label, repetition, _ in trials
    ]
    for signal, expected in zip(found.signals, signals, strict=True):
        np.testing.assert_allclose(signal, expected, rtol=1e-6)


def test_stamps_give_the_rate_and_go_on_over_trials(tmp_path, caplog):
    rows = [
        f"{trial},{'ab'[trial % 2]},{10 * (40 * trial + n)},{n % 5},{n % 3}" for trial in range(4) for n in range(40)
    ]
    path = write(tmp_path / "all.csv", "\n".join(["trial,label,timestamp,left,right", *rows]) + "\n")
    found = nt.read_table(path, unit="count")
    assert (found.sampling_rate_Hz, len(found), found.channels) == (100.0, 4, ("left", "right"))
    assert "the time stamps are taken as ms (trials of 0.39 s at 100 Hz)" in caplog.text
    assert (
        nt.read_table(path, 50, "count", layout=nt.Layout(columns="left", time_column="timestamp")).lengths.tolist()
        == [20] * 4
    )
    assert nt.read_table(path, 50, "count", layout=nt.Layout(columns="left")).lengths.tolist() == [40] * 4, (
        "the stamps are not read"
    )


@pytest.mark.parametrize("name", ["time", "logged"])
def test_times_of_day_may_cross_midnight_within_a_trial(tmp_path, name):
    rows = [
        f"{trial},{'ab'[trial % 2]},{date} {time},{n}"
        for trial in range(4)
        for n, (date, time) in enumerate([("31.1.24", "23:59:59.9"), ("1.2.24", "00:00:00"), ("1.2.24", "00:00:00.1")])
    ]
    path = write(tmp_path / "all.csv", "\n".join([f"trial,label,{name},left", *rows]) + "\n")
    found = nt.read_table(path, unit="count")
    assert (found.sampling_rate_Hz, found.channels, found.lengths.tolist()) == (10.0, ("left",), [3] * 4)


def test_columns_that_are_no_taxels_are_named(tmp_path, caplog):
    text = "subject,trial,label,note,left,dead,board\n"
    text += "".join(f"s{trial // 2},{trial},x{trial % 2},n{n},{n},0,{trial}\n" for trial in range(4) for n in range(3))
    path = write(tmp_path / "all.tsv", text)
    with caplog.at_level(logging.WARNING):
        found = nt.read_table(path, 100, "V")
    assert found.channels == ("left",)
    assert found.conditions.iloc[3].to_dict() == {"label": "x1", "trial": 3, "subject": "s1", "dead": 0, "board": 3}
    assert "constant within each trial, so conditions and not taxels: subject, dead, board; to change" in caplog.text
    assert "not used: note" in caplog.text
    assert nt.read_table(path, 100, "V", layout=nt.Layout(columns="left-dead")).channels == ("left", "dead")


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("trial,a\n1,2\n", {}, r"no column is called label \(trial, a\); name the class of a trial with `label`"),
        (
            "label,a\nx,2\n", {},
            r"no column is called trial \(label, a\); .* `trial='subject,repetition'`, or .* `segments=True`",
        ),
        (
            "trial,label,a\n1,x,2\n1,y,3\n", {},
            "'label' changes within a trial; .* `trial='label,trial'`, or .*segments",
        ),
        (
            "trial,label,a\n1,x,2\n1,x,3\n2,x,1\n2,x,2\n1,y,3\n", {},
            "trial 1 begins again at line 6; if trials are numbered anew .* as in `trial='label,trial'`; else sort",
        ),
        ("trial,label,a\n1,x,2\n1,x,oops\n", {"columns": "a"}, r"line 3, column 3 \(a\) is 'oops', not a number"),
        ("trial,label,a\n1,x,2\n1,x,inf\n", {}, r"line 3, column 3 \(a\) is inf; repair the gap, or choose other"),
        ("trial,label,a\n1,x,2\n1,x,2\n", {}, "no column of numbers changes within a trial; name the taxels"),
        ("trial,label,a\n1,x,2\n", {"label": "lable"}, "`label`: there is no column 'lable'; did you mean 'label'"),
        ("trial,label,a\n1,x,2\n", {"trial": "subject"}, "`trial`: there is no column 'subject'"),
        ("trial,label,a\n1,x,2\n", {"columns": "a,label"}, "name a column twice; name each once"),
        ("trial,label,a\n1,x,2\n1,x,3\n", {"sampling_rate_Hz": None}, "the sampling rate is not known; give"),
        ("trial,label,T,a\n1,x,21,3\n1,x,20,4\n", {"sampling_rate_Hz": None}, "'T' is named like time stamps, but"),
        ("1,x,2\n1,x,3\n", {}, "line 1 holds a row, but must name the columns, as in trial,time_s,label"),
        ("trial,label,a\n", {}, "holds no row below its header"),
        ("trial;label;a\n1;x;0,5\n1;x;2.5\n", {}, "line 2 has decimal commas; pass `decimal=','`"),
        ("trial,label,a\n1,x,2\n", {"decimal": ","}, "has commas between its columns, so there are no decimal commas"),
        ("trial,label,a\n1,x,2,5\n", {"decimal": ","}, "commas both in its numbers and between its columns; put ;"),
        ("# made by hand\n0,1,2\n", {"decimal": ","}, "commas between its columns, so there are no decimal commas"),
        ("trial,label,a\n0,1,x,2.5\n", {"decimal": ","}, "commas between its columns, so there are no decimal commas"),
        ("trial,a\n1,0,2,5\n", {"decimal": ","}, "commas both in its numbers and between its columns; put ; between"),
        ("trial,label,a\n1,x,2,5\n", {}, "line 2 has 4 columns where 3 are expected, the names in line 1; name each"),
        ("label,a\nx,2\nx,3\n", {"segments": True, "leave_out": "y"}, "`leave_out`: no trial has label = y; label is"),
        ("label,a\nx,2\nx,3\n", {"segments": True, "leave_out": "x"}, r"no trial is left of 1 \(without label = x\)"),
        ("label,a\nx,2\ny,3\n,4\n,5\n", {"segments": True}, "no trial has two samples of one class"),
        ("label,a\nx,2\nx,3\n", {"segments": True, "annotations": "m.csv"}, "leave out `segments` and `trial`"),
    ],
)  # fmt: skip
def test_a_table_that_cannot_be_read_is_named(tmp_path, text, options, message):
    path = write(tmp_path / "all.csv", text)
    with pytest.raises(InputError, match=message):
        nt.read_table(path, **of_table({"sampling_rate_Hz": 100, "unit": "mV", **options}))


def test_a_gap_is_named_with_its_line(tmp_path):
    times = [0, 1, 2, 3, 4, 5, 6, 50, 51]
    rows = [f"7,x,{time},{time % 3}" for time in times]
    path = write(tmp_path / "all.csv", "\n".join(["trial,label,t_ms,a", "6,x,0,1", "6,x,1,2", *rows]) + "\n")
    with pytest.raises(InputError, match=r"all\.csv, trial 7: line 11 comes 44 ms after the line before it"):
        nt.read_table(path, unit="mV")
    assert len(nt.read_table(path, unit="mV", layout=nt.Layout(max_gap_ms=50))) == 2


@pytest.mark.parametrize("text", ["", "trial,label\n", "a\n\x00\n", "trial;label;a\n1;x;1,5\n"])
def test_a_damaged_table_is_refused_by_name(tmp_path, text):
    path = write(tmp_path / "all.csv", text)
    with pytest.raises(InputError, match=r"all\.csv"):
        nt.read_table(path, 100, "mV")


STRETCHES = st.lists(st.tuples(st.sampled_from(["tap", "rub", "rest", ""]), st.integers(3, 30)), min_size=2, max_size=8)


@examples(15)
@given(STRETCHES, st.sampled_from(["time", "t_ms"]), st.sampled_from(["s", "ms"]), st.integers(0, 2**31))
def test_classes_of_samples_and_annotations_cut_the_same_trials(tmp_path_factory, stretches, stamps, unit, seed):
    stretches = [each for k, each in enumerate(stretches) if each[0] != [*stretches, ("", 0)][k - 1][0]]
    assume({label for label, _ in stretches} & {"tap", "rub"} and len(stretches) > 1)
    folder = tmp_path_factory.getbasetemp()
    ends = np.cumsum([n for _, n in stretches])
    rows = np.arange(ends[-1])
    taxels = dict(zip("ab", np.random.default_rng(seed).normal(size=(2, len(rows))).round(4), strict=True))
    label = np.repeat([label for label, _ in stretches], [n for _, n in stretches])
    recording = pd.DataFrame({stamps: rows * (10.0 if stamps == "t_ms" else 0.01), **taxels})
    recording.assign(label=label).to_csv(folder / "labelled.csv", index=False)
    recording.to_csv(folder / "recording.csv", index=False)
    scale = {"s": 0.01, "ms": 10.0}[unit]
    marks = {f"begin_{unit}": (ends - [n for _, n in stretches] - 0.5) * scale, f"end_{unit}": (ends - 0.5) * scale}
    pd.DataFrame({**marks, "label": [label for label, _ in stretches]}).to_csv(folder / "marks.csv", index=False)

    leave_out = "rest" if "rest" in label else ()
    by_class = nt.read_table(folder / "labelled.csv", unit="V", segments=True, leave_out=leave_out)
    by_mark = nt.read_table(folder / "recording.csv", unit="V", annotations=folder / "marks.csv", leave_out=leave_out)
    wanted = [(name, end - n, end) for (name, n), end in zip(stretches, ends, strict=True) if name in ("tap", "rub")]
    assert by_class.conditions.values.tolist() == [[name, k] for k, (name, *_) in enumerate(wanted, 1)]
    pd.testing.assert_frame_equal(by_mark.conditions, by_class.conditions)
    for one, other, (_, begin, end) in zip(by_class.signals, by_mark.signals, wanted, strict=True):
        np.testing.assert_array_equal(one, np.stack([each[begin:end] for each in taxels.values()], 1, dtype=np.float32))
        np.testing.assert_array_equal(one, other)


def test_a_segment_also_ends_where_a_trial_ends_and_one_sample_is_none(tmp_path, caplog):
    rows = "1,x,2\n1,x,3\n2,x,1\n2,x,2\n2,y,3\n2,x,5\n2,x,6\n"
    path = write(tmp_path / "all.csv", "session,label,a\n" + rows)
    found = nt.read_table(path, 100, "mV", trial="session", segments=True)
    assert found.conditions.values.tolist() == [["x", 1, 1], ["x", 2, 2], ["x", 2, 3]]
    assert [signal[:, 0].tolist() for signal in found.signals] == [[2, 3], [1, 2], [5, 6]]
    assert "fewer than two samples make no trial; left out: the segment from line 6" in caplog.text
    assert "1 of 7 rows are in no trial" in caplog.text


def test_rows_in_no_trial_are_counted(tmp_path, caplog):
    path = write(tmp_path / "all.csv", "a,label\n" + "1,\n" * 3 + "1,x\n2,x\n" + "3,\n" * 4 + "1,y\n2,y\n")
    assert nt.read_table(path, 100, "mV", segments=True).lengths.tolist() == [2, 2]
    assert "all.csv: 7 of 11 rows are in no trial" in caplog.text
    recording = write(tmp_path / "recording.csv", "a\n" + "".join(f"{n}\n" for n in range(10)))
    marks = write(tmp_path / "marks.csv", "begin_s,end_s,label\n0.01,0.05,x\n0.03,0.07,y\n")
    assert nt.read_table(recording, 100, "mV", annotations=marks).lengths.tolist() == [4, 4]
    assert "recording.csv: 4 of 10 rows are in no trial" in caplog.text


def test_annotations_cut_between_rows_that_share_a_stamp(tmp_path):
    """Whole seconds of a skin at 10 Hz, whose recording begins within a second."""
    rows = "".join(f"{n // 10},{n}\n" for n in range(7, 93))
    path = write(tmp_path / "all.csv", "time_s,a\n" + rows)
    marks = write(tmp_path / "marks.csv", "begin_s,end_s,label\n0.95,3.25,x\n3.55,5.25,y\n")
    found = nt.read_table(path, unit="mV", annotations=marks)
    assert found.sampling_rate_Hz == 10
    assert [signal[:, 0].tolist() for signal in found.signals] == [[*range(10, 33)], [*range(36, 53)]]


MARKS = "start,stop,class,force\n0,0.03,x,3\n0.05,0.09,y,6\n"


@pytest.mark.parametrize(
    ("marks", "rate_Hz", "recording", "lengths"),
    [
        (MARKS, 100, "a\n", [3, 4]),
        (MARKS, None, "time,a\n", [3, 4]),
        (MARKS.replace("start,stop", "Begin Time_s,End Time_s"), None, "t_ms,a\n", [3, 4]),
        (MARKS.replace(",", ";").replace("start", "onset").replace("stop", "duration"), 100, "a\n", [3, 5]),
        (MARKS.replace("0.09", "9"), 100, "a\n", [3, 5]),
    ],
)
def test_annotations_cut_a_recording(tmp_path, marks, rate_Hz, recording, lengths):
    scale = 10 if "ms" in recording else 0.01
    rows = "".join(f"{n * scale},{n}\n" if "," in recording else f"{n}\n" for n in range(10))
    path, annotations = write(tmp_path / "all.csv", recording + rows), write(tmp_path / "marks.csv", marks)
    found = nt.read_table(path, rate_Hz, "mV", annotations=annotations)
    assert found.conditions.to_dict("list") == {"label": ["x", "y"], "force": [3, 6], "segment": [1, 2]}
    assert found.lengths.tolist() == lengths
    assert [signal[0, 0] for signal in found.signals] == [0, 5]


@pytest.mark.parametrize("end", ["end_s", "duration_s"])
def test_times_that_are_rounded_lose_and_win_no_sample(tmp_path, end):
    rows = "".join(f"{10 * n},{n}\n" for n in range(400))
    path = write(tmp_path / "all.csv", "time_ms,a\n" + rows)
    begins = range(0, 390, 7)
    marks = "".join(f"{n / 100},{(n if end == 'end_s' else 0) / 100 + 0.03:.2f},x\n" for n in begins)
    found = nt.read_table(path, unit="mV", annotations=write(tmp_path / "marks.csv", f"begin_s,{end},label\n{marks}"))
    assert [signal[:, 0].tolist() for signal in found.signals] == [[n, n + 1, n + 2] for n in begins]


def test_a_condition_may_have_the_name_of_a_taxel(tmp_path):
    path = write(tmp_path / "all.csv", "force,label\n" + "".join(f"{n},z\n" for n in range(10)))
    found = nt.read_table(path, 100, "N", annotations=write(tmp_path / "marks.csv", MARKS))
    assert (found.channels, found.conditions["force"].tolist()) == (("force",), [3, 6])
    assert found.conditions["label"].tolist() == ["x", "y"]


def test_annotations_may_count_from_the_first_sample_and_overlap_with_a_warning(tmp_path, caplog):
    rows = "".join(f"2026-03-01 09:15:00.{n:02d},{n % 7}\n" for n in range(10))
    path = write(tmp_path / "all.csv", "when,a\n" + rows)
    marks = write(tmp_path / "marks.tsv", "onset\tduration\ttrial_type\n0\t0.05\ttap\n0.04\t0.03\trub\n")
    found = nt.read_table(path, unit="mV", annotations=marks)
    assert (found.sampling_rate_Hz, found.lengths.tolist()) == (100.0, [5, 3])
    assert "its times count from the first sample" in caplog.text
    assert "annotations that begin before another one ends: 1;" in caplog.text
    marks.write_text("begin,end,label\n09:15:00.02,09:15:00.05,tap\n")
    assert nt.read_table(path, unit="mV", annotations=marks).signals[0][:, 0].tolist() == [2, 3, 4]


@pytest.mark.parametrize(
    ("marks", "message"),
    [
        ("begin,end\n0,1\n", "there is no column of classes called label; name it with `label`, of begin, end"),
        ("begin,label\n0,x\n", r"no column is called end or duration \(begin, label\); rename the columns"),
        ("end,label\n1,x\n", "no column is called begin"),
        ("begin,end,label\n0.05,0.02,x\n", "line 2 ends before it begins"),
        (
            "begin,end,label\n0,0.05,x\n7,8,y\n",
            "marks.csv: line 3: 7 to 8 lies outside of .*all.csv, which goes from 0",
        ),
        ("begin,end,label\n0,soon,x\n", "line 2, column end is 'soon', not a time"),
        ("begin_ms,end_s,label\n0,1,x\n", "are in different units"),
        ("begin,end,label\n0,0.001,x\n", "no trial has two samples"),
        ("begin,end,label\n", "holds no row below its header"),
    ],
)
def test_annotations_that_cannot_be_used_are_named(tmp_path, marks, message):
    path = write(tmp_path / "all.csv", "a\n" + "".join(f"{n % 4}\n" for n in range(10)))
    with pytest.raises(InputError, match=message):
        nt.read_table(path, 100, "mV", annotations=write(tmp_path / "marks.csv", marks))
    with pytest.raises(InputError, match="no such file"):
        nt.read_table(path, 100, "mV", annotations=tmp_path / "absent.csv")
