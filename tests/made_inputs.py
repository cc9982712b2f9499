"""A small file or folder for every command to read: recordings, spikes, networks and what can be imported."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import neurotact as nt
from neurotact.data.recordings import Recordings

N_TRIALS, N_SAMPLES, RATE_Hz = 30, 200, 1000.0
ENCODER = {"sa1.gain": 8.0, "ra1.gain": 120.0, "conditioning.baseline": "start", "conditioning.ema_cutoff_Hz": 200.0}
NETWORK = {"hidden": 4, "training.epochs": 2, "training.batch": 8, "forward_weight_scale": 3.0}


def touches(rate_Hz: float = RATE_Hz, n_trials: int = N_TRIALS, seed: int = 0) -> Recordings:
    """Two classes under two speeds: 60 ms of rest, then a level and a ripple that depend on the class and the speed."""
    rng = np.random.default_rng(seed)
    times_s = np.arange(round(N_SAMPLES * rate_Hz / RATE_Hz)) / rate_Hz
    trials = []
    for trial in range(n_trials):
        label, speed = trial % 2, (300, 450)[trial // 2 % 2]
        ripple_Hz = (20 + 25 * label) * speed / 300
        felt = 6 + 2 * label + 3 * np.sin(2 * np.pi * ripple_Hz * times_s + rng.uniform(0, 6))
        signal = np.where(times_s > 0.06, felt * (1 - np.exp(-(times_s - 0.06) / 0.01)), 0.0)
        trials.append(np.stack([signal, 0.6 * signal], axis=1) + rng.normal(0, 0.05, (len(times_s), 2)))
    conditions = pd.DataFrame({
        "label": [("felt", "silk")[trial % 2] for trial in range(n_trials)],
        "speed": [(300, 450)[trial // 2 % 2] for trial in range(n_trials)],
        "day": [trial // 6 for trial in range(n_trials)],
    })  # fmt: skip
    return Recordings(np.stack(trials).astype(np.float32), rate_Hz, "mV", conditions, source="a made sensor")


def make(folder: Path) -> None:
    """Write every input into `folder`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        _recorded_and_trained()
        _to_import()


def _recorded_and_trained() -> None:
    nt.save(touches(), "touch.h5")
    nt.save(touches(500.0), "slow.h5")
    nt.save(nt.encode(nt.load("touch.h5"), settings=ENCODER), "spikes.h5")
    nt.save(nt.encode(nt.load("touch.h5"), settings=ENCODER | {"sa1.t_ref_ms": 9}), "other-spikes.h5")
    nt.save(nt.encode(nt.load("slow.h5"), settings=ENCODER | {"conditioning.resample_Hz": 1000.0}), "slow-spikes.h5")
    for name, spikes in (("run", "spikes.h5"), ("slow-run", "slow-spikes.h5")):
        nt.train(spikes, name, "rsnn", NETWORK, window=nt.Window(length_ms=50, start_ms=80, per_trial=2))


def _to_import() -> None:
    """Twelve short trials in every form that is read."""
    recordings = touches(n_trials=12)
    signals = np.asarray(recordings.signals)[:, 40:100]
    times_ms = np.arange(60) * 1.0
    rows = []
    for trial, (signal, row) in enumerate(zip(signals, recordings.conditions.itertuples(), strict=True)):
        table = pd.DataFrame({"t_ms": times_ms, "p1": signal[:, 0], "p2": signal[:, 1]}).round(4)
        place = Path("csv", row.label)
        place.mkdir(parents=True, exist_ok=True)
        table.to_csv(place / f"F{row.speed}_{trial}.csv", index=False)
        for sort, array in (("npz", signal), ("across", signal.T)):
            there = Path(sort, row.label)
            there.mkdir(parents=True, exist_ok=True)
            np.savez(there / f"{trial}.npz", pressure=array, other=array * 2)
        rows.append(table.assign(label=row.label, speed=row.speed, trial=trial, gesture="AB"[trial % 2], turn=trial))
    whole = pd.concat(rows)
    whole.to_csv("table.csv", index=False)
    continuous = whole.assign(t_ms=np.arange(len(whole)) * 1.0)
    continuous.drop(columns=["trial", "turn", "speed", "gesture"]).to_csv("continuous.csv", index=False)
    continuous[["t_ms", "p1", "p2"]].to_csv("unlabelled.csv", index=False)
    begins = np.arange(12) * 60.0
    labels = recordings.conditions["label"]
    pd.DataFrame({"begin_ms": begins, "end_ms": begins + 50, "label": labels}).to_csv("annotations.csv", index=False)
    listed = [os.path.relpath(path, "csv") for path in sorted(Path("csv").rglob("*.csv"))]
    named = {"file": listed, "label": [f"{name[0]}-{k % 2}" for k, name in enumerate(listed)], "wet": ["no"] * 12}
    pd.DataFrame(named).to_csv("conditions.csv", index=False)
    pd.DataFrame({
        "t": np.tile([0.001, 0.004, 0.009], 12), "channel": np.tile([0, 1, 0], 12), "label": np.repeat(labels, 3),
        "trial": np.repeat(np.arange(12), 3),
    }).to_csv("events.csv", index=False)  # fmt: skip
    np.savez("arrays.npz", x=signals, gesture=labels.to_numpy(str), y=np.arange(12) % 3)
    pd.DataFrame(signals.reshape(-1, 2)).round(4).to_csv("samples.csv", index=False, header=False)
    stamped = pd.DataFrame(np.concatenate([signals[0], signals[1]])).round(4)
    stamped.insert(0, "t", np.arange(len(stamped)) / 1000)
    stamped.drop(index=[30, 31]).to_csv("stamped.csv", index=False, header=False)
    (signals.reshape(-1, 2) * 100).astype("<i2").tofile("samples.i16")
    signals.reshape(-1, 2).astype("<f4").tofile("samples.f32")


def make_public_sets(folder: Path) -> None:
    """A dense raster, and a few recordings of each public set in its own form, written into `folder`."""
    rng = np.random.default_rng(0)
    for name in ("Linen_F120_V50mmps_1.csv", "Silk_F120_V50mmps_0.csv"):
        channels = pd.DataFrame(rng.integers(0, 900, (40, 16)), columns=[f"channel{i + 1}" for i in range(16)])
        channels.insert(0, "timestamp", 28 * np.arange(40))
        channels.insert(1, "proximity1", 0)
        channels.insert(2, "proximity2", 65535)
        (folder / "fabrics").mkdir(exist_ok=True)
        channels.to_csv(folder / "fabrics" / name, index=False)
    for cube in (1, 2):
        for kind, columns in (("Voltage", 8), ("Force", 1)):
            path = folder / "presses" / f"Hardness_{kind}_Seq1_Sp300_Cube{cube}_t1.lvm"
            path.parent.mkdir(exist_ok=True)
            press = pd.DataFrame(rng.random((50, columns)).round(4), columns=list("abcdefgh"[:columns]))
            press.to_csv(path, sep="\t", index=False)
    for label in ("brushing", "rolling", "sliding"):
        path = folder / "modality" / label / "1.lvm"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(("\t".join(["1.65"] * 17) + "\n") * 30_000)
    raster = (rng.random((4, 50, 3)) < 0.2).astype(np.uint8)
    np.savez(folder / "dense.npz", raster=raster, label=["felt", "silk"] * 2, fs=1000.0)
    recordings, taxels = np.repeat([0, 1], 12), np.tile(np.arange(12), 2)
    np.savez(
        folder / "letters.npz", letter=["A", "B"], event_recording=recordings, event_taxel=taxels,
        event_polarity=np.zeros(24, int), event_time_s=rng.random(24),
    )  # fmt: skip
