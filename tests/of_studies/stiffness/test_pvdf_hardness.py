"""P(VDF-TrFE) hardness: both layouts, what they share, and every way they may be damaged."""

import logging
import os
import zipfile

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.stiffness import reader as pvdf_hardness

from neurotact.errors import InputError

HEADER = "Loadcell \t\t\t\tPVDF \n"
VOLTAGE = "Hardness_Voltage_Seq1_Sp300_Cube3_t2.lvm"
FORCE = "Hardness_Force_Seq1_Sp300_Cube3_t2.lvm"
KEY = "c03_s1_v300_t02"
SHORT = examples(80)

ADC = np.random.default_rng(3).integers(26195, 31501, (20, 8)).astype(np.uint16)
FORCE_N = np.random.default_rng(4).uniform(0, 12, 21)


def write_lvm(folder):
    def table(values):
        return HEADER + "".join("\t".join(map(repr, row)) + "\n" for row in values.tolist())

    place = folder / "Cube3" / "Seq1-3-15-3"
    place.mkdir(parents=True, exist_ok=True)
    (place / VOLTAGE).write_text(table(ADC * pvdf_hardness.VOLTS_PER_ADC_COUNT))
    (place / FORCE).write_text(table(FORCE_N[:, None]))
    return place


def write_npz(folder, name: str = "cube03.npz", **arrays: np.ndarray):
    arrays = arrays or {f"{KEY}_adc": ADC, f"{KEY}_force": FORCE_N.astype(np.float32)}
    np.savez_compressed(folder / name, **arrays)


def attempt(read):
    """The recordings, or None and why they were refused."""
    try:
        return read(), ""
    except InputError as error:
        return None, str(error)


def refused(folder, message):
    with pytest.raises(InputError) as refusal:
        pvdf_hardness.read(folder)
    assert message in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


def is_the_press(recordings):
    assert len(recordings) == 1
    assert recordings.signals[0].dtype == np.float32
    np.testing.assert_allclose(recordings.signals[0], ADC * pvdf_hardness.VOLTS_PER_ADC_COUNT, rtol=1e-7)
    row = recordings.conditions.drop(columns=["file", "force_max_N"]).to_dict("records")[0]
    return row == {"label": "cube3", "cube": 3, "sequence": 1, "speed": 300, "trial": 2}


@pytest.mark.parametrize("write", [write_lvm, write_npz])
def test_both_layouts_are_read(tmp_path, write):
    write(tmp_path)
    recordings = pvdf_hardness.read(tmp_path)
    assert is_the_press(recordings)
    assert (recordings.unit, recordings.sampling_rate_Hz) == ("V", 2000.0)
    assert recordings.conditions.force_max_N[0] == pytest.approx(FORCE_N.max(), rel=1e-6)


@pytest.mark.parametrize("write", [write_lvm, write_npz])
def test_trials_come_in_the_order_of_their_numbers(tmp_path, write):
    if write is write_npz:
        write_npz(tmp_path, "cube.npz", **{f"c{c}_s1_v300_t{t}_adc": ADC for c, t in [(11, 1), (3, 10), (3, 2)]})
    else:
        place = write_lvm(tmp_path)
        for name in ("Cube11_t1", "Cube3_t10"):
            os.link(place / VOLTAGE, place / VOLTAGE.replace("Cube3_t2", name))
        (place / FORCE).unlink()
    conditions = pvdf_hardness.read(tmp_path).conditions
    assert list(zip(conditions.cube, conditions.trial, strict=True)) == [(3, 2), (3, 10), (11, 1)]
    assert conditions.force_max_N.isna().all()


def test_a_force_without_voltages_is_left_out_and_said(tmp_path, caplog):
    place = write_lvm(tmp_path)
    (place / FORCE).rename(place / FORCE.replace("t2", "t3"))
    with caplog.at_level(logging.WARNING, "neurotact"):
        assert is_the_press(pvdf_hardness.read(tmp_path))
    assert "_t3.lvm' is dropped: the voltages of its trial are missing" in caplog.text
    (place / VOLTAGE).unlink()
    refused(tmp_path, "holds force recordings only")


def test_a_folder_of_neither_layout_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("1")
    refused(tmp_path, f"{tmp_path}: holds neither cube<N>.npz nor Hardness_<Voltage or Force>_")
    refused(tmp_path / "absent", "there is no such folder")


def test_odd_names_and_the_same_trial_twice_are_refused(tmp_path):
    place = write_lvm(tmp_path)
    (tmp_path / VOLTAGE).write_bytes((place / VOLTAGE).read_bytes())
    refused(tmp_path, "are the same trial; keep one of them")
    (tmp_path / VOLTAGE).rename(tmp_path / "Hardness.lvm")
    refused(tmp_path, "'Hardness.lvm' is not named Hardness_")
    write_npz(tmp_path)
    write_npz(tmp_path, "cube04.npz")
    refused(tmp_path, f"cube04.npz: '{KEY}_adc' is also cube03.npz:{KEY}_adc")
    write_npz(tmp_path, "cube04.npz", press=ADC)
    refused(tmp_path, "cube04.npz: 'press' is not named c<cube>_s<sequence>_")


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({f"{KEY}_adc": ADC[:, :7]}, f"cube03.npz, key '{KEY}_adc': holds uint16 (20, 7), not uint16 (time, 8)"),
        ({f"{KEY}_adc": ADC.astype(float)}, "holds float64 (20, 8), not uint16"),
        ({f"{KEY}_adc": ADC[:0]}, "has shape (0, 8)"),
        ({f"{KEY}_adc": ADC, f"{KEY}_force": np.array([1, np.nan])}, f"key '{KEY}_force': sample 1, channel 0 is nan"),
        ({f"{KEY}_adc": ADC, f"{KEY}_force": np.ones((2, 2))}, "has shape (2, 2), not (time,)"),
        ({f"{KEY}_adc": np.array([{}])}, "cube03.npz: holds pickled Python objects, which are never loaded"),
    ],
)
def test_arrays_of_another_kind_are_refused(tmp_path, arrays, message):
    write_npz(tmp_path, "cube03.npz", **arrays)
    refused(tmp_path, message)


def test_a_file_that_is_no_archive_is_refused(tmp_path):
    np.save(tmp_path / "cube03.npy", ADC)
    (tmp_path / "cube03.npy").rename(tmp_path / "cube03.npz")
    refused(tmp_path, "cube03.npz: is not an .npz archive")
    with zipfile.ZipFile(tmp_path / "cube03.npz", "w") as archive:
        archive.writestr(f"{KEY}_adc", "1,2")
    refused(tmp_path, f"cube03.npz: member '{KEY}_adc' is not a NumPy array")


def test_tables_of_another_shape_are_refused(tmp_path):
    place = write_lvm(tmp_path)
    (place / FORCE).write_bytes((place / VOLTAGE).read_bytes())
    refused(tmp_path, f"{FORCE}: line 2 has 8 columns where 1 is expected")
    (place / FORCE).write_text("0.5\n0.6\n")
    refused(tmp_path, f"{FORCE}: line 1 holds numbers instead of the header")
    (place / FORCE).write_text(HEADER)
    refused(tmp_path, f"{FORCE}: holds no row of numbers")


@example(name=VOLTAGE, cut=len(HEADER) - 1, flip=0)
@example(name=FORCE, cut=len(HEADER) - 1, flip=0)
@given(name=st.sampled_from([VOLTAGE, FORCE]), cut=st.integers(0, 10**6), flip=st.none() | st.integers(0, 255))
@SHORT
def test_a_cut_or_damaged_table_is_what_it_was_or_refused(tmp_path, name, cut, flip):
    place = write_lvm(tmp_path)
    content = (place / name).read_bytes()
    cut %= len(content)
    damaged = content[:cut] if flip is None else content[:cut] + bytes([flip]) + content[cut + 1 :]
    (place / name).write_bytes(damaged)
    recordings, refusal = attempt(lambda: pvdf_hardness.read(tmp_path))
    if recordings is None:
        assert name in refusal
        assert "\n" not in refusal
        return
    signal = recordings.signals[0]
    volts = (ADC * pvdf_hardness.VOLTS_PER_ADC_COUNT)[: len(signal)].astype(np.float32)
    assert (signal != volts).sum() <= (flip is not None)


@given(cut=st.integers(0, 10**6), flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=3))
@SHORT
def test_a_cut_or_damaged_archive_is_what_it_was_or_refused(tmp_path, cut, flips):
    write_npz(tmp_path)
    content = bytearray((tmp_path / "cube03.npz").read_bytes())
    for place, byte in flips:
        content[place % len(content)] = byte
    (tmp_path / "cube03.npz").write_bytes(content if flips else content[: cut % len(content)])
    recordings, refusal = attempt(lambda: pvdf_hardness.read(tmp_path))
    if recordings is None:
        assert "cube03.npz" in refusal
        assert "\n" not in refusal
        return
    assert is_the_press(recordings)


@pytest.fixture(scope="module")
def published(data_folder):
    return pvdf_hardness.read(data_folder / "pvdf-hardness")


def test_published_repack(published):
    assert len(published) == 199
    assert published.n_channels == 8
    assert published.conditions.label.value_counts().to_dict() == {
        "cube3": 39, "cube5": 40, "cube7": 40, "cube10": 40, "cube11": 40,
    }  # fmt: skip
    lengths = [len(signal) for signal in published.signals]
    assert (min(lengths), max(lengths)) == (10710, 12740)
    assert set(published.conditions.sequence) == {1, 2, 3, 4}
    assert set(published.conditions.speed) == {300}
    means = np.array([signal.mean() for signal in published.signals])
    assert means.min() > 1.81
    assert means.max() < 1.83


def test_both_layouts_of_one_trial_agree(published, data_folder):
    native = pvdf_hardness.read(data_folder / "pvdf-hardness" / "native")
    assert list(native.conditions.label) == ["cube3", "cube3", "cube11", "cube11"]
    keys = ["cube", "sequence", "speed", "trial"]
    for i in range(len(native)):
        press = native.conditions.iloc[i]
        (j,) = np.flatnonzero((published.conditions[keys] == press[keys]).all(axis=1))
        np.testing.assert_allclose(native.signals[i], published.signals[j], rtol=0, atol=1.2e-7)  # 1 ulp of float32
        assert published.conditions.force_max_N[j] == pytest.approx(press.force_max_N, rel=1e-6)
