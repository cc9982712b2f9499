"""One table with the samples of all trials: trials, classes, conditions and taxels are found, or the fix is named."""

import logging

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
    found = nt.read_table(path, 100, "mV", trial="class,repetition", decimal=decimal)
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
    assert nt.read_table(path, 50, "count", columns="left", time_column="timestamp").lengths.tolist() == [20] * 4
    assert nt.read_table(path, 50, "count", columns="left").lengths.tolist() == [40] * 4, "the stamps are not read"


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
    assert nt.read_table(path, 100, "V", columns="left-dead").channels == ("left", "dead")


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("trial,a\n1,2\n", {}, r"no column is called label \(trial, a\); name the class of a trial with --label"),
        ("label,a\nx,2\n", {}, r"no column is called trial \(label, a\); name .* --trial subject,repetition"),
        ("trial,label,a\n1,x,2\n1,y,3\n", {}, "'label' changes within a trial; .* as in --trial label,trial"),
        (
            "trial,label,a\n1,x,2\n1,x,3\n2,x,1\n2,x,2\n1,y,3\n", {},
            "trial 1 begins again at line 6; if trials are numbered anew .* as in --trial label,trial; else sort",
        ),
        ("trial,label,a\n1,x,2\n1,x,oops\n", {"columns": "a"}, "line 3, column a is 'oops', not a number"),
        ("trial,label,a\n1,x,2\n1,x,inf\n", {}, "line 3, column a is inf; repair the gap"),
        ("trial,label,a\n1,x,2\n1,x,2\n", {}, "no column of numbers changes within a trial; name the taxels"),
        ("trial,label,a\n1,x,2\n", {"label": "lable"}, "--label: there is no column 'lable'; did you mean 'label'"),
        ("trial,label,a\n1,x,2\n", {"trial": "subject"}, "--trial: there is no column 'subject'"),
        ("trial,label,a\n1,x,2\n", {"columns": "a,label"}, "name a column twice; name each once"),
        ("trial,label,a\n1,x,2\n1,x,3\n", {"sampling_rate_Hz": None}, "the sampling rate is not known; give"),
        ("trial,label,T,a\n1,x,21,3\n1,x,20,4\n", {"sampling_rate_Hz": None}, "'T' is named like time stamps, but"),
        ("1,x,2\n1,x,3\n", {}, "no column is called label"),
        ("trial,label,a\n", {}, "holds no row below its header"),
        ("trial;label;a\n1;x;0,5\n1;x;2\n", {}, "column a has decimal commas; pass --decimal ,"),
        ("trial,label,a\n1,x,2\n", {"decimal": ","}, "has commas between its columns, so there are no decimal commas"),
        ("trial,label,a\n1,x,2,5\n", {}, "cannot be read as a table"),
    ],
)  # fmt: skip
def test_a_table_that_cannot_be_read_is_named(tmp_path, text, options, message):
    path = write(tmp_path / "all.csv", text)
    with pytest.raises(InputError, match=message):
        nt.read_table(path, **{"sampling_rate_Hz": 100, "unit": "mV", **options})


def test_a_gap_is_named_with_its_line(tmp_path):
    times = [0, 1, 2, 3, 4, 5, 6, 50, 51]
    rows = [f"7,x,{time},{time % 3}" for time in times]
    path = write(tmp_path / "all.csv", "\n".join(["trial,label,t_ms,a", "6,x,0,1", "6,x,1,2", *rows]) + "\n")
    with pytest.raises(InputError, match=r"all\.csv, trial 7: line 11 comes 44 ms after the line before it"):
        nt.read_table(path, unit="mV")
    assert len(nt.read_table(path, unit="mV", max_gap_ms=50)) == 2


@pytest.mark.parametrize("text", ["", "trial,label\n", "a\n\x00\n", "trial;label;a\n1;x;1,5\n"])
def test_a_damaged_table_is_refused_by_name(tmp_path, text):
    path = write(tmp_path / "all.csv", text)
    with pytest.raises(InputError, match=r"all\.csv"):
        nt.read_table(path, 100, "mV")
