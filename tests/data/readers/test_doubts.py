"""Doubts about recordings: nonsense is named with its fix, and what a sensor of touch records is not."""

import h5py
import in_process
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.readers.doubts import Fixes, doubts, kinds_of_names
from neurotact_parts.readers.one_table import FEATURES

import neurotact as nt
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError

FIXES = Fixes("drop it", "or name the time, ", "use `axes`")
RNG = np.random.default_rng(5)


def touches(n_trials=8, n_samples=60, n_taxels=3, rate_Hz=500.0, **columns) -> Recordings:
    """Pressure that rises from a rest and falls again, with noise, as whole counts of a converter of 12 bits.

    columns: samples of further taxels, `(trial, time)` or one that fits.
    """
    shape = np.sin(np.linspace(0, np.pi, n_samples))[:, None] * np.linspace(1.0, 2.0, n_taxels)
    signals = np.round(400 * shape + 300 + 20 * RNG.normal(size=(n_trials, n_samples, n_taxels)))
    more = [np.broadcast_to(np.asarray(each, float), (n_trials, n_samples))[..., None] for each in columns.values()]
    names = (*(f"p{i}" for i in range(n_taxels)), *columns)
    table = pd.DataFrame({"label": ["felt", "silk"] * (n_trials // 2)})
    return Recordings(np.concatenate([signals, *more], axis=2), rate_Hz, "count", table, names)


def said(recordings, **options):
    return list(doubts(recordings, FIXES, **options))


@given(st.integers(20, 200), st.sampled_from([20.0, 93.0, 1000.0, 20_000.0]), st.integers(1, 20), st.booleans())
def test_touch_is_not_doubted(n_samples, rate_Hz, n_taxels, is_volts):
    n_samples = max(n_samples, n_taxels, int(rate_Hz * 0.02) + 1)
    found = touches(4, n_samples, n_taxels, rate_Hz)
    signals = np.asarray(found.signals) / 4096 * 3.3 if is_volts else found.signals
    assert not said(Recordings(signals, rate_Hz, "V", found.conditions))


SAMPLES = np.arange(60)
CASES = {
    "a counter": (touches(number=SAMPLES), "number rises throughout every trial, as time stamps or a counter do; "),
    "time stamps": (touches(clock=17.5 + SAMPLES * 2e-3), "clock rises throughout every trial"),
    "the label": (touches(kind=np.array([[3.0], [7.0]] * 4)), "kind has one value for each class, as a label does"),
    "a dead taxel": (touches(dead=512.0), "every sample has the same value in dead; drop it"),
    "nothing": (Recordings(np.full((4, 60, 2), 7.0), 500.0, "V", ["a", "b"] * 2), "every sample is 7, so nothing was"),
    "a raster": (
        Recordings((RNG.random((4, 60, 9)) < 0.2).astype(float), 500.0, "V", ["a", "b"] * 2),
        "every sample is 0 or 1, as of a raster; neurotact import raster reads spikes, of arrays or of a folder of",
    ),
    "counted spikes": (
        Recordings(RNG.poisson(0.05, (4, 60, 9)).astype(float), 500.0, "V", ["a", "b"] * 2),
        "every sample is a whole number from 0 to ",
    ),
    "features": (
        Recordings(RNG.normal(size=(40, 1, 20)), 100.0, "V", ["a", "b"] * 20), "every trial has one sample, as ",
    ),
    "axes": (Recordings(RNG.normal(size=(4, 8, 60)), 100.0, "V", ["a", "b"] * 2), "has 60 taxels of 8 samples each; "),
    "kHz": (touches(n_samples=600, rate_Hz=0.5), "0.5 Hz is slow for touch; check `sampling_rate_Hz`"),
    "ns": (touches(rate_Hz=1e9), "1e+09 Hz is fast for touch"),
    "a short trial": (touches(rate_Hz=50_000.0), "the median trial lasts 0.0012 s at 50000 Hz, which is short"),
    "a long trial": (touches(n_samples=9000, rate_Hz=10.0), "the median trial lasts 900 s at 10 Hz, which is long"),
    "numbers of trials": (
        Recordings(RNG.normal(size=(12, 60, 2)), 500.0, "V", [f"{i / 7}" for i in range(12)]),
        "each of the 12 trials has a class of its own (0.0, ",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_nonsense_is_doubted_once_with_the_fix(case):
    recordings, sentence = CASES[case]
    (doubt,) = said(recordings)
    assert doubt.startswith(sentence)
    assert ";" in doubt


def with_exception(values, trial=2, sample=30, by=1e4):
    """The values of a taxel, `(trial, time)`, with a glitch in one trial."""
    its = np.array(np.broadcast_to(np.asarray(values, float), (8, 60)))
    its[trial, sample] += by
    return its


def with_a_pause(values, lasts, trials=slice(2, 3)):
    """Time stamps of trials in some of which the clock jumps by `lasts`."""
    its = np.array(np.broadcast_to(np.asarray(values, float), (8, len(values))))
    its[trials, 30:] += lasts
    return its


RASTER = (RNG.random((8, 60, 9)) < 0.2).astype(float)
GLITCH = np.zeros_like(RASTER)
GLITCH[3, 7, 2] = 40
NOISE = 300 + 100 * RNG.normal(size=60)
EXCEPTIONS = {
    "a clock that pauses": (touches(clock=with_a_pause(SAMPLES, 900)), "clock rises throughout every trial"),
    "a clock that always pauses": (touches(clock=with_a_pause(SAMPLES, 900, slice(8))), "clock rises throughout"),
    "a counter that begins again": (
        touches(n_samples=200, n=with_a_pause(np.arange(200), -80, slice(8))), "n rises throughout every trial"
    ),
    "a clock but in one trial": (
        touches(clock=np.where(np.arange(8)[:, None] == 5, NOISE, SAMPLES)), "clock rises throughout every trial"
    ),
    "a label with a glitch": (
        touches(kind=with_exception(np.array([[3.0], [7.0]] * 4))), "kind has one value for each class"
    ),
    "a label with a wrong trial": (touches(kind=np.array([[3.0], [7.0]] * 3 + [[3.0], [3.0]])), "kind has one value"),
    "a dead taxel with a glitch": (touches(dead=with_exception(512.0)), "every sample has the same value in dead"),
    "a raster with a glitch": (
        Recordings(RASTER + GLITCH, 500.0, "V", ["a", "b"] * 4), "nearly every sample is 0 or 1, as of a raster"
    ),
    "nothing but a glitch": (
        Recordings(7 + GLITCH, 500.0, "V", ["a", "b"] * 4), "nearly every sample is 7, so nothing was recorded"
    ),
    "axes, but of one trial": (
        Recordings([RNG.normal(size=(8 if i else 99, 60)) for i in range(4)], 100.0, "V", ["a", "b"] * 2),
        "has 60 taxels of 8 samples each",
    ),
    "classes but for two trials": (
        Recordings(RNG.normal(size=(12, 60, 2)), 500.0, "V", [f"{max(i, 1) / 7}" for i in range(12)]),
        "nearly each of the 12 trials has a class of its own",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", EXCEPTIONS)
def test_an_exception_removes_no_doubt(case):
    recordings, sentence = EXCEPTIONS[case]
    doubts_said = said(recordings)
    assert [doubt for doubt in doubts_said if doubt.startswith(sentence)], doubts_said


@pytest.mark.parametrize(("bits", "signed"), [(8, False), (10, False), (12, False), (16, True), (24, True)])
def test_samples_at_the_end_of_a_converter_are_doubted(bits, signed):
    top = 2 ** (bits - signed) - 1
    low = -top - 1 if signed else 0
    share = 0.5 + 0.9 * np.sin(np.linspace(0, 6, 400))[:, None] * np.ones(3)
    cut = np.round(np.clip(low + (top - low) * share + RNG.normal(size=(4, 400, 3)), low, top))
    # float32 holds 24 bits
    (doubt,) = said(Recordings(cut, 500.0, "count", ["a", "b"] * 2))
    assert doubt.endswith("lower the sensor's gain, or drop these trials")
    assert f"{float(top):g}" in doubt
    few = cut.copy()
    few[few == top] = np.where(RNG.random((few == top).sum()) < 0.05, top, top - 5)
    few[few == low] = low + 5
    assert not said(Recordings(few, 500.0, "count", ["a", "b"] * 2))


def test_what_only_looks_like_nonsense_is_not_doubted():
    assert not said(touches(step=(SAMPLES > 30) * 5.0))  # a contact that holds to the end
    falling = SAMPLES * np.array([[1.0], [1.0], [-1.0], [1.0]] * 2)
    assert not said(touches(drift=falling))  # one trial that falls shows a signal
    assert not said(touches(session=np.array([[3.0], [7.0], [3.0], [3.0]] * 2)))  # steady, but tells no class
    mixed = Recordings([np.ones((1, 2)), RNG.normal(size=(90, 2))], 500.0, "V", ["a", "b"])
    assert said(mixed) == ["1 of 2 trials have one sample; leave them out, or check the trials"]
    (doubt,) = said(touches(rate_Hz=5.0), rate_is_given=False)  # stamps have their own fix
    assert doubt.endswith("give it with `time_unit`")
    squeezes = np.clip(RNG.integers(-200, 6, (4, 60, 9)), 0, None).astype(
        float
    )  # a mat of few levels, mostly untouched
    squeezes[0, 0, 0] = 40
    assert not said(Recordings(squeezes, 500.0, "count", ["a", "b"] * 2))


@pytest.mark.parametrize(("unit", "fits"), [("count", False), ("LSB", False), ("kPa", True)])
def test_counts_are_whole(tmp_path, unit, fits, caplog):
    """All numbers have three decimals: only the unit says that they are thousands, else it is a doubt."""
    rng = np.random.default_rng(0)
    rows = rng.integers(1000, 4096, (40, 2)) / 1000
    (tmp_path / "felt").mkdir()
    np.savetxt(tmp_path / "felt" / "1.csv", rows, fmt="%.3f", delimiter=";")
    if fits:
        nt.read_folder(tmp_path, 100, unit)
        assert "as if separators of thousands were read as decimal points" in caplog.text
    else:
        with pytest.raises(InputError, match=f"the samples are in {unit}, but have three decimals"):
            nt.read_folder(tmp_path, 100, unit)
    caplog.clear()
    np.savetxt(tmp_path / "felt" / "1.csv", np.floor(8000 * rows) / 8, fmt="%.3f", delimiter=";")  # means of eight
    nt.read_folder(tmp_path, 100, unit)
    assert "thousands" not in caplog.text


@pytest.mark.parametrize("kind", ["folder", "arrays", "table"])
def test_every_import_says_them(tmp_path, kind, caplog):
    raster = (np.random.default_rng(0).random((4, 60, 3)) < 0.2).astype(np.int8)
    labels = ["felt", "silk"] * 2
    if kind == "folder":
        for trial, label in enumerate(labels):
            (tmp_path / label).mkdir(exist_ok=True)
            np.savez(tmp_path / label / f"{trial}.npz", raster[trial])
        nt.read_folder(tmp_path, 500, "V")
    elif kind == "arrays":
        np.savez(tmp_path / "a.npz", X=raster, y=labels)
        nt.read_arrays(tmp_path / "a.npz", 500, "V")
    else:
        rows = [",".join(map(str, (trial, labels[trial], *row))) for trial in range(4) for row in raster[trial]]
        (tmp_path / "a.csv").write_text("\n".join(["trial,label,a,b,c", *rows]))
        nt.read_table(tmp_path / "a.csv", 500, "V")
    (message,) = caplog.messages
    assert message.startswith(str(tmp_path))
    assert "every sample is 0 or 1, as of a raster; neurotact import raster" in message


# --- a table with one row per touch -----------------------------------------------------------------


def features(path, order, trial=False):
    """Sixty touches of three classes, a row of five features each, without time stamps."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame(rng.normal(size=(60, 5)), columns=[*"abcde"]).assign(label=np.repeat(["x", "y", "z"], 20))
    table = table.assign(trial=range(60)) if trial else table
    table.iloc[order].to_csv(path, index=False)
    return path


def test_a_row_per_touch_is_no_continuous_recording(tmp_path, caplog):
    by_class, shuffled = np.arange(60), np.random.default_rng(1).permutation(60)
    path = features(tmp_path / "a.csv", by_class)
    with pytest.raises(nt.InputError, match=r"with `segments=True`; if each row is a touch of its own, give a row per"):
        nt.read_table(path, unit="V")
    nt.read_table(path, 100, "V", segments=True)
    assert f"{path}: each of the 3 classes is one stretch of rows; {FEATURES}" in caplog.messages
    path = features(tmp_path / "b.csv", shuffled)
    nt.read_table(path, 100, "V", segments=True)
    assert f"{path}: most stretches of a class have fewer than 5 rows; {FEATURES}" in caplog.messages
    with pytest.raises(nt.InputError) as refusal:
        nt.read_table(features(tmp_path / "c.csv", by_class, trial=True), 100, "V")
    assert str(refusal.value) == f"{tmp_path / 'c.csv'}: every trial has one row; {FEATURES}"


def test_a_table_with_the_samples_of_a_touch_in_each_row_is_read_as_its_refusal_says(tmp_path):
    samples = np.random.default_rng(0).normal(size=(20, 200)).cumsum(axis=1)
    table = pd.DataFrame(samples, columns=[f"t{n}" for n in range(200)]).assign(label=["felt", "silk"] * 10)
    table.to_csv(tmp_path / "wide.csv", index=False)
    said = in_process.typed("import", "table", tmp_path / "wide.csv", "--unit", "V", "-o", tmp_path / "no.h5").err
    command = said.partition("signals (trial, time) and label for neurotact ")[2].partition(" (features")[0]
    np.savez(tmp_path / "touches.npz", signals=samples, label=table["label"].to_numpy(str))
    words = command.replace("touches.npz", str(tmp_path / "touches.npz")).split()
    in_process.typed(*words, "--sampling-rate-Hz", "100", "--unit", "V", "-o", tmp_path / "touches.h5")
    read = nt.load_recordings(tmp_path / "touches.h5")
    assert [*read.labels] == [0, 1] * 10
    np.testing.assert_allclose(np.stack(read.signals)[..., 0], samples, rtol=1e-5)


def test_a_recording_with_a_class_per_sample_is_not_doubted(tmp_path, caplog):
    rng = np.random.default_rng(0)
    labels = np.repeat(["rest", "x", "rest", "y", "rest", "x"], 20)
    table = pd.DataFrame(rng.normal(size=(120, 2)), columns=["a", "b"]).assign(label=labels)
    table.to_csv(tmp_path / "a.csv", index=False)
    nt.read_table(tmp_path / "a.csv", 100, "V", segments=True)
    table.assign(time_s=np.arange(120) / 100).iloc[:60].to_csv(tmp_path / "b.csv", index=False)
    nt.read_table(tmp_path / "b.csv", unit="V", segments=True, leave_out="rest")
    assert not [line for line in caplog.messages if FEATURES in line]


CHANNELS = tuple(f"channel{number}" for number in range(1, 6))


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (
            (*CHANNELS, "proximity1", "proximity2"),
            ("channel1 to channel5, proximity1 to proximity2;", "channel1-channel5"),
        ),
        (
            ("proximity", *CHANNELS),
            ("2 kinds are all taken as taxels: proximity, channel1 to channel5;", "channel1-channel5"),
        ),
        (("p1", "heat1", "p2", "heat2", "p3"), ("p1 to p3, heat1 to heat2;", None)),
        (("acc_x", "acc_y", "acc_z", "P1", "p2"), ("acc_x to acc_z, P1 to p2;", "P1-p2")),
    ],
)
def test_columns_of_two_kinds_are_doubted_once_and_one_can_be_left_out(tmp_path, caplog, names, expected):
    shown, choice = expected
    rows = np.round(RNG.normal(size=(40, len(names))), 3)
    table = pd.DataFrame(rows, columns=names)
    for path in (tmp_path / "set" / "felt" / "a.csv", tmp_path / "set" / "silk" / "b.csv"):
        path.parent.mkdir(parents=True)
        table.to_csv(path, index=False)
    trials = np.repeat([1, 2], 20)
    table.assign(trial=trials, label=trials).to_csv(tmp_path / "all.csv", index=False)
    for read, path in ((nt.read_folder, tmp_path / "set"), (nt.read_table, tmp_path / "all.csv")):
        caplog.clear()
        found = read(path, 100.0, "mV")
        (line,) = [line for line in caplog.messages if "kinds are all" in line]
        assert found.channels == names
        assert shown in line
        assert line.endswith("the taxels with `columns`" + (f", as in `columns='{choice}'`" if choice else ""))
        if choice:
            caplog.clear()
            first, _, last = choice.partition("-")
            kept = read(path, 100.0, "mV", layout=nt.Layout(columns=choice))
            assert kept.channels == names[names.index(first) : names.index(last) + 1]
            assert read(path, 100.0, "mV", layout=nt.Layout(columns=names)).channels == names
            assert "kinds are all" not in caplog.text


@pytest.mark.parametrize(
    "names", [CHANNELS, ("left", "right", "thumb"), ("x1", "y1", "z1", "x2", "y2", "z2"), ("r0c0", "r1c2")]
)
def test_columns_of_one_kind_are_not_doubted(names):
    assert not kinds_of_names(names)


def test_afferents_of_two_kinds_are_not_doubted(tmp_path, caplog):
    (tmp_path / "felt").mkdir()
    raster = pd.DataFrame((RNG.random((40, 7)) < 0.2).astype(int), columns=(*CHANNELS, "heat1", "heat2"))
    raster.to_csv(tmp_path / "felt" / "a.csv", index=False)
    assert nt.read_raster(tmp_path, 1000.0).afferents == tuple(raster)
    assert "kinds are all" not in caplog.text


def test_a_text_of_any_program_may_be_named_as_those_of_labview(tmp_path):
    (tmp_path / "all.lvm").write_text("trial;label;left\n" + "".join(f"{n // 20};felt;{n % 7},5\n" for n in range(40)))
    assert nt.read_table(tmp_path / "all.lvm", 100.0, "mV", layout=nt.Layout(decimal=",")).channels == ("left",)


def test_links_of_a_file_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "all.h5", "w") as file:
        file["data"], file["label"] = RNG.normal(size=(4, 50, 2)), [0, 0, 1, 1]
        file["again"] = h5py.SoftLink("/data")
    assert len(nt.read_arrays(tmp_path / "all.h5", 100.0, "mV")) == 4
