"""Sets of the field by their published layouts, on made-up files: read whole, and refused where a file differs."""

from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import torch
from neurotact_parts.readers import cost, stemnist, vt_snn

import neurotact as nt
from neurotact.errors import InputError

RNG = np.random.default_rng(1)


def _spikes(trains: nt.SpikeTrains, trial: int) -> list[tuple[int, str]]:
    pairs = zip(trains.steps[trial].tolist(), trains.units[trial].tolist(), strict=True)
    return [(step, trains.afferents[unit]) for step, unit in pairs]


# STEMNIST

EVENTS = [(0.0, 1, 1), (0.1, 1, -1), (119 / 120, 256, -1), (2.0, 2, 1)]
KINDS = np.dtype([("timestamp", "f8"), ("taxel_id", "i4"), ("polarity", "i1")])


def stemnist_set(folder: Path, events=EVENTS, kinds=KINDS, pressure=None, **attributes) -> Path:
    """An unpacked archive: A and 7 of two people, with events and with pressure."""
    root = folder / stemnist.ARCHIVE
    (root / stemnist.PRESSURE).mkdir(parents=True)
    for number, (person, label) in enumerate([("AT", "A"), ("LG", "7")], 1):
        (root / stemnist.SPIKES / label).mkdir(parents=True)
        with h5py.File(root / stemnist.SPIKES / label / f"{person}_{label}_{number}_spikes.h5", "w") as file:
            file["spikes"] = np.array(events, kinds)
            file.attrs.update({"sampling_rate": 120, "duration": 2.0} | attributes)
        with h5py.File(root / stemnist.PRESSURE / f"{person}_{label}_{number}.h5", "w") as file:
            made = RNG.integers(0, 256, (240, 16, 16)) if pressure is None else pressure
            file["pressure_data"] = made.astype(np.uint8 if pressure is None else made.dtype)
    return folder


def test_events_of_stemnist_are_on_the_clock_of_the_skin(tmp_path):
    trains = nt.read("stemnist", stemnist_set(tmp_path))
    assert _spikes(trains, 1) == [(0, "ON taxel1"), (12, "OFF taxel1"), (119, "OFF taxel256"), (239, "ON taxel2")]
    assert trains.trial_steps.tolist() == [240, 240]
    assert trains.sampling_rate_Hz == pytest.approx(120.0, abs=1e-9)
    assert len(trains.afferents) == 512
    assert trains.conditions.to_dict("list") == {
        "label": ["7", "A"], "person": ["LG", "AT"], "repetition": [2, 1],
        "file": ["7/LG_7_2_spikes.h5", "A/AT_A_1_spikes.h5"],
    }  # fmt: skip
    slow = nt.read("stemnist", tmp_path / stemnist.ARCHIVE / stemnist.SPIKES, step_ms=25.0)
    assert _spikes(slow, 0)[1:] == [(4, "OFF taxel1"), (39, "OFF taxel256"), (79, "ON taxel2")]


def test_pressure_of_stemnist_is_a_taxel_per_column(tmp_path):
    frames = np.arange(240)[:, None, None] % 7 + np.arange(256).reshape(16, 16) % 200
    unpacked = stemnist_set(tmp_path / stemnist.ARCHIVE, pressure=frames.astype(np.uint8))  # as fetch leaves it
    touches = nt.read("stemnist-pressure", unpacked.parent)
    assert touches.channels[17] == "r1c1"
    assert (touches.sampling_rate_Hz, touches.unit, touches.signals[0].shape) == (120.0, "count", (240, 256))
    assert touches.signals[0][5, 17] == frames[5, 1, 1]
    assert touches.conditions["label"].tolist() == ["A", "7"]


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"events": [(0.0, 257, 1)]}, "event 0 is not of taxel 1 to 256"),
        ({"events": [*EVENTS, (0.0, 0, 1)]}, "event 4 is not of taxel 1"),
        ({"events": [(0.0, 1, 0)]}, "polarity -1 or 1"),
        ({"events": [(2.1, 1, 1)]}, "0 to 2 s"),
        ({"events": [(float("nan"), 1, 1)]}, "event 0 is not"),
        ({"sampling_rate": 100}, "its sampling_rate is 100, not 120"),
        ({"duration": 3.0}, "its duration is 3.0, not 2"),
        ({"kinds": [("time", "f8"), ("taxel_id", "i4"), ("polarity", "i1")]}, "records of the numbers timestamp"),
        ({"kinds": [("timestamp", "S9"), ("taxel_id", "i4"), ("polarity", "i1")]}, "records of the numbers timestamp"),
    ],
)
def test_events_that_are_not_of_stemnist_are_refused(tmp_path, made, said):
    with pytest.raises(InputError, match=said):
        nt.read("stemnist", stemnist_set(tmp_path, **made))


@pytest.mark.parametrize("frames", [np.zeros((241, 16, 16), np.uint8), np.zeros((240, 16, 16), np.int16)])
def test_pressure_that_is_not_of_stemnist_is_refused(tmp_path, frames):
    with pytest.raises(InputError, match="is not 240 frames of 16 x 16 bytes"):
        nt.read("stemnist-pressure", stemnist_set(tmp_path, pressure=frames))


@pytest.mark.parametrize(
    ("name", "said"),
    [("A/AT_A_1.h5", "is not named"), ("A/AT_a_1_spikes.h5", "is not named"), ("A/AT_B_1_spikes.h5", "to that of B")],
)
def test_a_file_that_stemnist_does_not_name_so_is_refused(tmp_path, name, said):
    place = stemnist_set(tmp_path) / stemnist.ARCHIVE / stemnist.SPIKES
    (place / "A/AT_A_1_spikes.h5").rename(place / name)
    with pytest.raises(InputError, match=said):
        nt.read("stemnist", tmp_path)


def test_a_folder_without_stemnist_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no folder ProcessedSpikes"):
        nt.read("stemnist", tmp_path)
    (tmp_path / stemnist.SPIKES).mkdir()
    with pytest.raises(InputError, match=r"holds no \.h5 file"):
        nt.read("stemnist", tmp_path)


def test_pressure_of_all_is_refused_by_its_size_before_it_is_read(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUROTACT_MAX_MB", "0001")
    monkeypatch.setattr(stemnist, "_opened", None)
    for number in range(10):
        (tmp_path / stemnist.PRESSURE).mkdir(exist_ok=True)
        (tmp_path / stemnist.PRESSURE / f"AT_A_{number}.h5").touch()
    with pytest.raises(InputError, match="set NEUROTACT_MAX_MB"):
        nt.read("stemnist-pressure", tmp_path)


# VT-SNN

ROWS = "1 1 1500000000 500000000\n0 18 1500000001 0\n1 17 1500000001 0\n1 80 1500000009 0\n1 2 1499999999 0\n"
TIMES = "1499999990.0 1500000000.5 1500000001.0 1500000002.0 1500000003.0 1500000004.0"


def vt_snn_set(folder: Path, names=("107-a_pepsi_bottle_01", "110-e_coffee_can_02"), rows=ROWS, times=TIMES) -> Path:
    for part in (vt_snn.RECORDED, vt_snn.MOTIONS):
        (folder / part).mkdir()
    for number, name in enumerate(names):
        (folder / vt_snn.RECORDED / f"{name}.tact").write_text(rows + f"1 {number + 3} 1500000002 0\n")
        (folder / vt_snn.MOTIONS / f"{name}.startend").write_text(times)
    return folder


def test_a_recorded_trial_begins_when_the_robot_reaches(tmp_path):
    trains = nt.read("vt-snn", vt_snn_set(tmp_path))
    assert _spikes(trains, 0) == [(0, "ON cell1"), (25, "OFF cell18"), (75, "ON cell3")]
    assert _spikes(nt.read("vt-snn", tmp_path, step_ms=1.0), 1)[1:] == [(500, "OFF cell18"), (1500, "ON cell4")]
    assert trains.trial_steps.tolist() == [425, 425]
    assert len(trains.afferents) == 156
    assert trains.conditions.drop(columns="file").to_dict("list") == {
        "label": ["107-a_pepsi_bottle", "110-e_coffee_can"], "object": ["pepsi_bottle", "coffee_can"],
        "weight": ["a", "e"], "repetition": [1, 2],
    }  # fmt: skip


def test_trials_of_slip_are_short(tmp_path):
    rows = "1 1 1500000000 510000000\n1 1 1500000000 649400000\n1 1 1500000000 650000000\n"
    slips = vt_snn_set(tmp_path, ("stable_01", "rotate_01"), rows, "1499999990.0 1500000000.5 1500000001 1500000002")
    trains = nt.read("vt-snn", slips, step_ms=1.0)
    assert _spikes(trains, 0) == [(10, "ON cell1"), (149, "ON cell1")]
    assert trains.trial_steps.tolist() == [150, 150]
    assert trains.conditions["label"].tolist() == ["rotate", "stable"]


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"rows": "2 1 1500000000 0\n"}, "is not polarity 0 or 1"),
        ({"rows": "1 81 1500000000 0\n"}, "cell 1 to 80"),
        ({"rows": "1 0 1500000000 0\n"}, "cell 1 to 80"),
        ({"rows": "1 1 1500000000 1000000000\n"}, "seconds and nanoseconds"),
        ({"rows": "1 1 1500000000\n"}, "line 1 has 3 columns where 4"),
        ({"times": "1499999990.0"}, "not one row of the times of motions"),
        ({"names": ("107-a_pepsi_bottle_01", "107-f_pepsi_bottle_01")}, "is not named <name>_<n>.tact"),
        ({"names": ("107-a_pepsi_bottle_01", "stable_01")}, "is not named <name>_<n>.tact"),
        ({"names": ("107-a_pepsi_bottle_x",)}, "is not named <name>_<n>.tact"),
    ],
)
def test_a_trial_that_is_not_of_vt_snn_is_refused(tmp_path, made, said):
    with pytest.raises(InputError, match=said):
        nt.read("vt-snn", vt_snn_set(tmp_path, **made))


def test_a_trial_without_the_times_of_the_robot_is_refused(tmp_path):
    next((vt_snn_set(tmp_path) / vt_snn.MOTIONS).iterdir()).unlink()
    with pytest.raises(InputError, match=r"startend: there is no such file"):
        nt.read("vt-snn", tmp_path)
    with pytest.raises(InputError, match=r"holds neither tact\.pt nor aces_recordings"):
        nt.read("vt-snn", tmp_path / vt_snn.MOTIONS)


def prepared(folder: Path, values, test_rows: str = "1\t1\n", train_rows: str = "2\t0\n0\t0\n") -> Path:
    torch.save(values, folder / "tact.pt")
    (folder / "train_80_20_1.txt").write_text(train_rows)
    (folder / "test_80_20_1.txt").write_text(test_rows)
    return folder


def test_a_prepared_tensor_has_the_classes_of_its_split(tmp_path):
    values = torch.zeros(3, 78, 2, 10)
    values[0, 0, 0, 4] = values[1, 77, 1, 9] = values[2, 16, 0, 0] = 1
    trains = nt.read("vt-snn", prepared(tmp_path, values), step_ms=1.0)
    assert [_spikes(trains, trial) for trial in range(3)] == [
        [(4, "ON cell1")],
        [(9, "OFF cell80")],
        [(0, "ON cell18")],
    ]
    assert trains.conditions.to_dict("list") == {
        "label": ["stable", "rotate", "stable"], "split": ["train", "test", "train"],
    }  # fmt: skip
    assert (trains.trial_steps.tolist(), trains.sampling_rate_Hz) == ([10] * 3, 1000.0)


@pytest.mark.parametrize(
    ("values", "rows", "said"),
    [
        (torch.zeros(3, 78, 10), "1\t1\n", r"holds tact \(3, 78, 10\), not one tensor"),
        (torch.zeros(3, 2, 78, 10), "1\t1\n", "not one tensor of 0 and 1"),
        (torch.full((3, 78, 2, 10), 2.0), "1\t1\n", "not one tensor of 0 and 1"),
        (torch.zeros(3, 78, 2, 10), "1\t2\n", "name no class of 2 or 20 for each of the 3 samples"),
        (torch.zeros(4, 78, 2, 10), "1\t1\n", "each of the 4 samples"),
        (torch.zeros(3, 78, 2, 10), "2\t1\n", "each of the 3 samples"),
        (Path("an-object"), "1\t1\n", "never loaded"),
    ],
)
def test_a_tensor_that_is_not_of_vt_snn_is_refused(tmp_path, values, rows, said):
    with pytest.raises(InputError, match=said):
        nt.read("vt-snn", prepared(tmp_path, values, rows))


# CoST


def cost_table(touches=((1, 2, 14, 3), (1, 2, 14, 2), (2, 1, 1, 4))) -> pd.DataFrame:
    """Touches by subject, variant, gesture and their number of frames."""
    rows = [(*touch, frame + 1) for *touch, n_frames in touches for frame in range(n_frames)]
    table = pd.DataFrame(rows, columns=[*cost.TOUCH, "frame"])
    return table.assign(**{name: (np.arange(len(table)) + n) % 1024 for n, name in enumerate(cost.CHANNELS)})


def cost_file(folder: Path, table: pd.DataFrame) -> Path:
    table.to_csv(folder / cost.FILE, index=False)
    return folder


@pytest.mark.parametrize("at_once", [1, 4, 100])
@pytest.mark.parametrize("ending", ["", " "])
def test_a_touch_of_cost_is_its_frames(tmp_path, monkeypatch, at_once, ending):
    monkeypatch.setattr(cost, "ROWS", at_once)
    table = cost_table()
    turned = table[[*reversed(table.columns)]].rename(columns=lambda name: f" {name}{ending}")
    touches = nt.read("cost", cost_file(tmp_path, turned))
    assert [signal[:, 3].tolist() for signal in touches.signals] == [[3, 4, 5], [6, 7], [8, 9, 10, 11]]
    assert (touches.sampling_rate_Hz, touches.unit, touches.channels) == (135.0, "count", cost.CHANNELS)
    assert touches.conditions.to_dict("list") == {
        "label": ["tickle", "tickle", "grab"], "variant": ["normal", "normal", "gentle"], "subject": [1, 1, 2],
        "repetition": [1, 2, 1],
    }  # fmt: skip
    assert nt.read("cost", tmp_path / cost.FILE).signals[0].shape == (3, 64)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda table: table.drop(columns="ch64"), "has 67 columns where subject, variant"),
        (lambda table: table.rename(columns={"variant": "variation"}), "has a column 'variation' where"),
        (lambda table: table.assign(more=1), "has a column 'more' where"),
        (lambda table: table.assign(ch5=1024), "line 2, ch5 is 1024, not a whole number from 0 to 1023"),
        (lambda table: table.assign(ch5=-1), "line 2, ch5 is -1"),
        (lambda table: table.assign(ch5=0.5), "line 2, ch5 is 0.5"),
        (lambda table: table.assign(gesture=15), "gesture is 15, not a whole number from 1 to 14"),
        (lambda table: table.assign(variant=0), "variant is 0, not a whole number from 1 to 3"),
        (lambda table: table.assign(ch5=np.nan), "ch5 is nan"),
        (lambda table: table.assign(ch5="x"), "is no table of numbers"),
        (lambda table: table.drop(index=1), "line 3 is frame 3, not 2 of its touch"),
        (lambda table: table.drop(index=0), "line 2 is frame 2, not 1 of its touch"),
        (lambda table: table.drop(index=[5]), "line 7 is frame 2, not 1 of its touch"),
        (lambda table: table[:0], "holds no frame"),
    ],
)
def test_a_table_that_is_not_of_cost_is_refused(tmp_path, change, said):
    with pytest.raises(InputError, match=said):
        nt.read("cost", cost_file(tmp_path, change(cost_table())))


def test_touches_of_cost_beyond_the_memory_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUROTACT_MAX_MB", "1")
    with pytest.raises(InputError, match="set NEUROTACT_MAX_MB"):
        nt.read("cost", cost_file(tmp_path, cost_table(((1, 1, 1, 4000),))))
    (tmp_path / cost.FILE).write_bytes(b"\xff\xfe\0\1")
    with pytest.raises(InputError, match="is no table of numbers"):
        nt.read("cost", tmp_path)


# Cluster Haptic Texture

STAMPS_S = np.cumsum(np.tile([0.0001, 0.00013, 0.0001, 0.00013], 50))
FORCES = "texture_dataset/sensor_data/force"
SLIDES = ("0_135_40_500_0", "117_0_20_1000_1")


def texture_set(folder: Path, columns=("X", "Y", "Z"), names=SLIDES, suffix=".csv", sensor="accel") -> Path:
    """The folder `texture_dataset`, with a table for each slide."""
    for number, name in enumerate(names):
        place = folder / "texture_dataset/sensor_data" / sensor / name.partition("_")[0]
        place.mkdir(parents=True, exist_ok=True)
        values = {c: np.sin(300 * STAMPS_S + number + n).astype(np.float32) for n, c in enumerate(columns)}
        if suffix == ".csv":
            pd.DataFrame({"time": STAMPS_S, **values}).to_csv(place / (name + suffix), index=False)
        else:
            table = {"time_ns": np.rint(1e9 * STAMPS_S).astype(np.int64), **values}
            pd.DataFrame(table).to_parquet(place / (name + suffix))
    return folder


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("inside", ["", "texture_dataset", "texture_dataset/sensor_data/accel"])
def test_slides_of_the_cluster_textures_are_on_one_clock(tmp_path, suffix, inside):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow", reason="no pyarrow; pip install 'neurotact[parquet]'")
    slides = nt.read("cluster-haptic-texture", texture_set(tmp_path, suffix=suffix) / inside)
    assert (slides.channels, slides.unit) == (("X", "Y", "Z"), "g")
    assert slides.sampling_rate_Hz == pytest.approx(1 / 0.000115, rel=0.01)
    expected = np.sin(300 * (STAMPS_S[0] + np.arange(150) / slides.sampling_rate_Hz) + 1)
    assert np.abs(slides.signals[0][:150, 1] - expected).max() < 0.01
    assert slides.conditions.drop(columns="file").to_dict("list") == {
        "label": ["0", "117"], "direction_deg": [135, 0], "speed_mm_per_s": [40, 20], "force_mN": [500, 1000],
        "repetition": [0, 1],
    }  # fmt: skip


def test_the_forces_of_slides_are_read_from_their_folder(tmp_path):
    forces = nt.read("cluster-haptic-texture", texture_set(tmp_path, ("force",), sensor="force") / FORCES)
    assert (forces.channels, forces.unit) == (("force",), "N")


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"columns": ("X", "Y")}, "its columns are X, Y, not X, Y, Z of accelerations or force"),
        ({"columns": ("Z", "Y", "X")}, "its columns are Z, Y, X, not"),
        ({"names": ("0_135_40_500",)}, "its name does not fit the pattern"),
        ({"names": (SLIDES[0], "0_30_40_500_0")}, "0_30_40_500_0.csv: direction_deg is 30, not one of"),
        ({"names": (SLIDES[0], "0_135_10_500_0")}, "speed_mm_per_s is 10, not one of"),
        ({"names": (SLIDES[0], "0_135_20_50_0")}, "force_mN is 50, not one of"),
        ({"names": (SLIDES[0], "0_135_20_500_2")}, "repetition is 2, not one of"),
    ],
)
def test_slides_that_are_not_of_the_cluster_textures_are_refused(tmp_path, made, said):
    with pytest.raises(InputError, match=said):
        nt.read("cluster-haptic-texture", texture_set(tmp_path, **made))
