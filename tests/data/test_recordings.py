"""Recordings: what does not fit together is refused by trial, sample and taxel."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

import neurotact as nt
from neurotact.data.description import lengths_line, marks_line
from neurotact.data.recordings import Recordings, select_conditions
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError

RAGGED = [np.arange(8.0).reshape(4, 2), np.ones((6, 2)), np.zeros((1, 2))]


def recordings(signals=RAGGED, labels=("silk", "felt", "silk"), **changes) -> Recordings:
    table = pd.DataFrame({"label": list(labels), "force_N": [3, 6, 12][: len(labels)]})
    return Recordings(**{"signals": signals, "sampling_rate_Hz": 2000.0, "unit": "mV", "conditions": table, **changes})


def refused(message: str, **changes) -> None:
    with pytest.raises(InputError) as refusal:
        recordings(**changes)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_trials_keep_their_lengths_and_become_float32():
    touch = recordings()
    assert [s.shape for s in touch.signals] == [(4, 2), (6, 2), (1, 2)]
    assert {s.dtype for s in touch.signals} == {np.dtype(np.float32)}
    assert recordings(signals=np.ones((3, 5, 2))).signals.dtype == np.float32  # ty: stacked


def test_labels_index_the_sorted_classes():
    touch = recordings()
    assert touch.classes == ("felt", "silk")
    assert touch.labels.tolist() == [1, 0, 1]


def test_numbers_serve_as_labels():
    touch = recordings(labels=(10, 9, 10))
    assert touch.classes == ("10", "9")
    assert touch.labels.tolist() == [0, 1, 0]


def test_a_selection_by_mask_is_that_by_index():
    for signals in (RAGGED, np.arange(30.0).reshape(3, 5, 2)):
        touch = recordings(signals=signals)
        by_mask, by_index = touch.select(np.array([True, False, True])), touch.select(np.array([0, 2]))
        for one, other in zip(by_mask.signals, by_index.signals, strict=True):
            np.testing.assert_array_equal(one, other)
        pd.testing.assert_frame_equal(by_mask.conditions, by_index.conditions)
        assert by_mask.conditions.force_N.tolist() == [3, 12]
        assert by_mask.conditions.index.tolist() == [0, 1]


@given(st.permutations(range(3)))
def test_a_selection_keeps_signal_and_condition_together(order):
    touch = recordings()
    shuffled = touch.select(np.array(order))
    for place, trial in enumerate(order):
        np.testing.assert_array_equal(shuffled.signals[place], touch.signals[trial])
        assert shuffled.conditions.force_N[place] == touch.conditions.force_N[trial]


@pytest.mark.parametrize(("unit", "factor"), [("V", 1e-3), ("mV", 1.0), ("uV", 1e3)])
def test_volts_convert(unit, factor):
    for signals in (RAGGED, np.arange(30.0).reshape(3, 5, 2)):
        converted = recordings(signals=signals).to_unit(unit)
        assert converted.unit == unit
        for signal, original in zip(converted.signals, signals, strict=True):
            np.testing.assert_allclose(signal, np.asarray(original) * factor, rtol=1e-6)


@pytest.mark.parametrize(("unit", "wanted"), [("count", "mV"), ("mV", "count"), ("mV", "N")])
def test_other_units_do_not(unit, wanted):
    touch = recordings(unit=unit, source="skin.h5")
    with pytest.raises(InputError, match=f"skin.h5: signals are in '{unit}' but '{wanted}' is needed"):
        touch.to_unit(wanted)


@given(
    trial=st.integers(0, 2), sample=st.integers(0, 4), taxel=st.integers(0, 1),
    value=st.sampled_from([np.nan, np.inf, -np.inf, 1e300]), stacked=st.booleans(),
)  # fmt: skip
def test_nan_and_infinity_are_named_by_trial_sample_and_taxel(trial, sample, taxel, value, stacked):
    signals = np.zeros((3, 5, 2))
    signals[trial, sample, taxel] = value
    refused(
        f"skin.h5: trial {trial}, sample {sample}, taxel{taxel + 1} is NaN or infinite",
        signals=signals if stacked else list(signals), source="skin.h5",
    )  # fmt: skip


@given(st.data())
def test_a_selection_is_that_of_numpy_or_is_refused(data):
    touch = recordings()
    keep = data.draw(st.lists(st.booleans(), max_size=4) | st.lists(st.integers(-5, 5), max_size=4))
    try:
        expected = np.arange(3)[np.array(keep, int if not keep or isinstance(keep[0], int) else bool)]
    except IndexError:
        expected = []
    if isinstance(next(iter(keep), 0), bool):
        expected = np.flatnonzero(keep) if len(keep) == 3 else []
    if len(expected):
        assert touch.select(keep).conditions.force_N.tolist() == touch.conditions.force_N[expected].tolist()
    else:
        with pytest.raises(InputError, match=r"^select: "):
            touch.select(keep)


@pytest.mark.parametrize("keep", [np.array([0.0, 1.0]), np.array([[0, 1]]), ["felt"], 0])
def test_a_selection_by_anything_else_is_refused(keep):
    with pytest.raises(InputError, match="select: takes a boolean mask or whole numbers"):
        recordings().select(keep)


def test_conditions_are_a_table_its_columns_or_the_class_of_each_trial():
    table = recordings().conditions[["label"]]
    for conditions in (table, dict(table), {"label": ["silk", "felt", "silk"]}, ["silk", "felt", "silk"], table.label):
        pd.testing.assert_frame_equal(recordings(conditions=conditions).conditions, table)
    refused("conditions must be a table, a mapping of columns or the class of each trial", conditions=None)
    refused("conditions must be a table", conditions="felt")
    refused("the conditions make no table", conditions={"label": ["silk"] * 3, "force_N": [3]})


def test_a_unit_and_the_names_of_channels_are_text():
    assert recordings(channels=["left", "right"]).channels == ("left", "right")
    refused("unit must be text, such as 'mV'; got None", unit=None)
    refused("the name of a channel must be text; got 1", channels=[1, 2])


def test_recordings_are_equal_to_themselves_alone():
    touch = recordings()
    assert touch == touch
    assert touch != recordings()
    assert len({touch, recordings()}) == 2


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, "1000", None, True])
def test_a_rate_that_is_no_positive_number_is_refused(rate):
    refused("sampling_rate_Hz must be a positive number", sampling_rate_Hz=rate)


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ([], "holds no trial"),
        (np.zeros((0, 5, 2)), "holds no trial"),
        ([np.ones((4, 2)), np.ones((4, 3)), np.ones((4, 2))], "trial 1 has 3 channels where 2 are expected"),
        ([np.ones((4, 2)), np.ones((0, 2)), np.ones((4, 2))], "trial 1 has shape (0, 2)"),
        (np.ones((3, 4, 2)) * 1j, "a signal is not a table of numbers (complex numbers)"),
        (np.ones((3, 4)), "trial 0 has shape (4,)"),
        (np.ones(3), "trial 0 has shape ()"),
        ([1.0, 2.0, 3.0], "trial 0 has shape ()"),
        (np.ones((3, 4, 0)), "trial 0 has shape (4, 0)"),
        ([["felt"]] * 3, "a signal is not a table of numbers"),
        ([[[1.0, 2.0], [3.0]]] * 3, "a signal is not a table of numbers"),
    ],
)
def test_signals_that_are_no_trials_are_refused(signals, message):
    refused(message, signals=signals)


def test_conditions_have_a_label_and_a_row_a_trial():
    refused("3 trials but 2 rows of conditions", labels=("felt", "silk"))
    refused("has no column 'label'", conditions=pd.DataFrame({"lable": ["a", "b", "c"]}))


def test_channels_are_named_once_each():
    assert recordings(channels=("left", "right")).channels == ("left", "right")
    refused("trial 0 has 2 channels where 1 are expected", channels=("left",))


def test_conditions_are_selected_by_value_and_by_any_of_several():
    table = recordings().conditions
    assert select_conditions(table, {}).tolist() == [True] * 3
    assert select_conditions(table, {"label": "silk", "force_N": [3, 6]}).tolist() == [True, False, False]
    assert select_conditions(table, {"force_N": 3.0}).tolist() == [True, False, False]
    with pytest.raises(InputError, match="there is no condition 'force'; did you mean 'force_N'"):
        select_conditions(table, {"force": 3})
    with pytest.raises(InputError, match="no trial has"):
        select_conditions(table, {"force_N": 4})


@given(st.integers(-99, 99), st.sampled_from(["{}", "{}.0", "{}e0", "{:04d}", "{:+d}"]), st.booleans())
def test_a_number_is_found_however_it_and_the_level_are_written(number, form, is_numeric):
    every = [number, float(number), *(way.format(number) for way in ("{}", "{}.0", "{:04d}", "{}e0"))]
    levels = [form.format(number), form.format(number + 1), form.format(number)]
    table = pd.DataFrame({"p": [float(level) for level in levels] if is_numeric else [*levels[:2], levels[0]]})
    for wanted in every:
        assert select_conditions(table, {"p": wanted}).tolist() == [True, False, True]
    with pytest.raises(InputError, match="no trial has"):
        select_conditions(table, {"p": f"{number}x"})


def test_a_number_that_is_several_levels_is_refused_unless_one_is_written_so():
    table = pd.DataFrame({"p": ["03", "3.0", "x", "nan", "03"]})
    with pytest.raises(InputError, match=r"where: p = 3 may be 03 or 3\.0; write one of these, as in '03'$"):
        select_conditions(table, {"p": 3}, "where")
    assert select_conditions(table, {"p": 3.0}).tolist() == [False, True, False, False, False]
    assert select_conditions(table, {"p": ["03", "x"]}).tolist() == [True, False, True, False, True]
    with pytest.raises(InputError, match="no trial has p = inf"):
        select_conditions(table, {"p": float("inf")})
    with pytest.raises(InputError, match="no trial has p = x"):
        select_conditions(pd.DataFrame({"p": [3.0, np.nan]}), {"p": "x"})


@pytest.mark.parametrize("label", ["", " ", None, np.nan])
def test_a_trial_without_a_class_is_refused(label):
    refused("skin.h5: trial 1 has an empty label", labels=("felt", label, "silk"), source="skin.h5")


def test_channels_of_one_name_are_refused():
    refused("skin.h5: two channels are called 'left'", channels=("left", "left"), source="skin.h5")


def test_names_that_no_file_can_hold_are_refused():
    labels = pd.Series(("felt", "caf\udce9", "silk"), dtype=object)  # where pyarrow is installed no other type holds it
    refused(r"the label 'caf\udce9' is not UTF-8; rename it", conditions=pd.DataFrame({"label": labels}))
    refused(r"the channel 'caf\udce9' is not UTF-8; rename it", channels=("caf\udce9", "right"))


def test_recordings_are_read_by_the_piece_as_stored_ones_are():
    touch = recordings()
    assert touch.lengths.tolist() == [4, 6, 1]
    np.testing.assert_array_equal(touch.piece(0, 1, 3), RAGGED[0][1:3])
    assert touch.piece(0, 3, 9).tolist() == [[6, 7]]
    assert touch.loaded() is touch


def test_tables_are_put_into_the_order_of_the_first_by_name():
    left, right = np.arange(3.0), np.arange(3.0) + 10
    tables = [pd.DataFrame({"left": left, "right": right}), pd.DataFrame({"right": right, "left": left})]
    read = Recordings(tables, 100.0, "mV", ["a", "b"])
    assert read.channels == ("left", "right")
    assert (read.signals[0] == read.signals[1]).all()
    assert Recordings(tables, 100.0, "mV", ["a", "b"], ("right", "left")).signals[1][0].tolist() == [10, 0]
    with pytest.raises(InputError, match="trial 1: has the column 'top' where left, right are expected"):
        Recordings([tables[0], tables[0].set_axis(["left", "top"], axis=1)], 100.0, "mV", ["a", "b"])


def test_masked_samples_are_refused():
    with pytest.raises(InputError, match="masked values"):
        Recordings([np.ma.masked_less(np.arange(6.0).reshape(3, 2), 2)], 100.0, "mV", ["a"])


@pytest.mark.parametrize("wanted", [True, "true", ["true"]])
def test_truth_is_chosen_as_it_is_and_as_it_is_written(wanted):
    table = pd.DataFrame({"label": ["a", "b"], "wet": [True, False]})
    assert select_conditions(table, {"wet": wanted}).tolist() == [True, False]


@pytest.mark.parametrize("of", ["recordings", "spikes", "array", "column"])
@given(labels=st.lists(st.floats(-9, 9).map(lambda x: round(x, 2)), min_size=3, max_size=6, unique=True))
@examples(20)
def test_measurements_name_no_classes(tmp_path_factory, of, labels):
    """The rule is one for all ways to give them: a number that is not whole. Whole ones are classes."""
    n, signals = len(labels), np.random.default_rng(0).normal(size=(len(labels), 30, 2))
    folder = tmp_path_factory.mktemp("given")
    np.savez(folder / "a.npz", signals=signals, label=labels)
    rows = pd.DataFrame({"trial": np.repeat(range(n), 30), "label": np.repeat(labels, 30)})
    rows.assign(left=signals[..., 0].ravel(), right=signals[..., 1].ravel()).to_csv(folder / "t.csv", index=False)
    raster = signals > 1
    read = {
        "recordings": lambda: nt.Recordings(signals, 1000.0, "mV", labels),
        "spikes": lambda: from_rasters(
            raster, 1000.0, ("ON a", "OFF a"), pd.DataFrame({"label": labels})
        ),
        "array": lambda: nt.read_arrays(folder / "a.npz", sampling_rate_Hz=1000, unit="mV"),
        "column": lambda: nt.read_table(folder / "t.csv", sampling_rate_Hz=1000, unit="mV"),
    }[of]  # fmt: skip
    if all(label == int(label) for label in labels):
        assert len(read().classes) == n
        return
    with pytest.raises(InputError, match=r"the label holds numbers that are not whole, such as .*; give each trial"):
        read()


def test_numbers_that_several_trials_share_are_classes_of_a_file(tmp_path):
    """As 0.5 and 1.5 mm; a file holds texts alone."""
    rows = pd.DataFrame({"trial": np.repeat(range(4), 9), "label": np.repeat([0.5, 1.5, 0.5, 1.5], 9), "p": range(36)})
    rows.to_csv(tmp_path / "t.csv", index=False)
    assert nt.read_table(tmp_path / "t.csv", sampling_rate_Hz=100, unit="mV").classes == ("0.5", "1.5")


@pytest.mark.parametrize("suffix", ["csv", "events"])
def test_measurements_in_the_table_of_a_folder_name_no_classes(tmp_path, suffix):
    (tmp_path / "in").mkdir()
    for number in range(3):
        rows = {"csv": "left,right\n1,2\n3,4\n", "events": "time_s,channel\n0.1,1\n0.2,0\n"}[suffix]
        (tmp_path / "in" / f"{number}.csv").write_text(rows)
    (tmp_path / "t.csv").write_text("file,label\n0.csv,0.31\n1.csv,1.5\n2.csv,2\n")
    read = {
        "csv": lambda: nt.read_folder(tmp_path / "in", 100, "mV", naming=nt.Naming(table=tmp_path / "t.csv")),
        "events": lambda: nt.read_events(tmp_path / "in", naming=nt.Naming(table=tmp_path / "t.csv")),
    }[suffix]
    with pytest.raises(InputError, match=r"no two trials share a label, .* such as 0.31, which name no classes"):
        read()


def test_long_recordings_are_described_without_an_exponent():
    conditions, whole = pd.DataFrame({"label": ["felt", "silk"]}), np.zeros((1, 2), np.float32)
    long = Recordings([np.zeros((12_340, 2)), whole.repeat(4_000, 0)], 10.0, "mV", conditions)
    assert "(400 to 1,234 s)" in repr(long)
    assert "trials of 400 to 1,234 s" in lengths_line(long.lengths, 10.0)
    marks = pd.DataFrame({"trial": [0], "start_s": [0.0], "stop_s": [1500.0], "label": ["press"]})
    assert marks_line(marks, 1500.0) == "marks in time: press (1, 1,500 s long); 100 % of the time has one"
    spikes = from_rasters(np.zeros((2, 20_000, 1), np.uint8), 10.0, ("SA-I a",), conditions)
    assert "0 spikes in 4,000 s" in repr(spikes)
