"""A calibrated spiking study never looks at a test trial: not for gains, conditioning, weights, patience or selection.

The labels of the recordings are random. In the test trials alone the class is planted, as a loud tone on one taxel: who
fits gains or a standardisation on them gets another encoder, who trains or selects by them beats chance by far.
"""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from levels import thinned
from neurotact_parts.networks.search import journal

from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import split_conditions
from neurotact.encoders import calibration
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.networks.training import trainer
from neurotact.networks.training.tasks import Task
from neurotact.networks.use import measuring
from neurotact.studies import cell, preparation, study
from neurotact.studies.cell import SEARCH
from neurotact.studies.study import Cell

N_TRIALS, SECONDS, RATE_Hz = 40, 0.3, 1000.0
TONES_Hz = (10.0, 60.0)
RULE = CalibrationRule(candidates=8, step=1.7, excerpt_s=0.3, trials_per_class=10, shuffles=2)
SPLITS = (0, 1, 2)
STUDY = """
title = "Planted"
encoder = "sa1-ra1-lif"
network = "rsnn"
calibrate = true

[dataset]
file = "touch.h5"

[window]
length_ms = 100.0
start_ms = 50.0
per_trial = 2

[split]
validation = 0.2
test = 0.25

[set]
"network.hidden" = 12
"network.training.epochs" = 8
"network.training.batch" = 16
"network.training.learning_rate" = 0.01

[search]
trials = 3
batch = 3
assessor = "none"

[search.space]
forward_weight_scale = { _type = "uniform", _value = [1.0, 4.0] }

[sweep]
seed = [0]
"""


@pytest.fixture(autouse=True)
def _few_candidates(monkeypatch):
    """Fewer gains to try: the calibration is the study's own, at a third of the time."""
    monkeypatch.setattr(
        preparation,
        "calibration_for",
        lambda spec, given, **choices: (
            lambda recordings, spec, *, rule, **how: calibration.calibrate(recordings, spec, rule=RULE, **how),
            1,
        ),
    )


def noise() -> Recordings:
    """Noise of random labels, in which there is nothing to learn."""
    rng = np.random.default_rng(7)
    signals = rng.normal(0, 1, (N_TRIALS, round(SECONDS * RATE_Hz), 2)).cumsum(axis=1)
    return Recordings(
        signals, RATE_Hz, "mV", pd.DataFrame({"label": np.array(["a", "b"])[rng.permutation(N_TRIALS) % 2]})
    )


def planted(trials: np.ndarray, swapped: bool = False) -> Recordings:
    """The class of these trials as a loud tone on the second taxel; `swapped`, that of the other class."""
    recordings = noise()
    signals, time_s = np.array(recordings.signals), np.arange(round(SECONDS * RATE_Hz)) / RATE_Hz
    for trial in trials:
        tone_Hz = TONES_Hz[int(recordings.labels[trial]) ^ swapped]
        signals[trial, :, 1] = 60 * np.sin(2 * np.pi * tone_Hz * time_s)
    return replace(recordings, signals=signals)


def cell_of(folder, seed: int) -> Cell:
    (folder / "study.toml").write_text(STUDY)
    (found,) = study.cells(study.resolve(folder / "study.toml", {"split.seed": seed}))
    return found


def left_of(folder, recordings: Recordings, seed: int = 0) -> tuple[SpikeTrains, dict[str, bytes]]:
    """The spike trains of the study's one cell, prepared as a run does it, and all files that the cell leaves."""
    folder.mkdir()
    hdf5.save_recordings(recordings, folder / "touch.h5")
    one = cell_of(folder, seed)
    what = study.resolve(folder / "study.toml", {"split.seed": seed, "dataset.file": str(folder / "touch.h5")})
    preparation.prepare(folder, what, [one])
    trains = hdf5.load_spikes(folder / one.given)
    return trains, cell.run_cell(one, trains)


def row_of(left: dict[str, bytes]) -> dict[str, Any]:
    return json.loads(left["result.json"])["row"]


def task_of(one: Cell) -> Task:
    return Task(window=one.window, split=one.split)


def test_test_trials_decide_nothing_but_the_test(tmp_path):
    """Gains, standardisation, spikes, the search, weights, log and exit rule: the same to the byte."""
    one = cell_of(tmp_path, 0)
    sides = split_conditions(noise().conditions, (), one.split)
    plain, plant = (left_of(tmp_path / name, r) for name, r in (("plain", noise()), ("planted", planted(sides.test))))
    assert plant[0].encoder == plain[0].encoder
    known = np.sort(np.concatenate([sides.train, sides.validation]))
    for trial in known.tolist():
        np.testing.assert_array_equal(plant[0].steps[trial], plain[0].steps[trial])
        np.testing.assert_array_equal(plant[0].units[trial], plain[0].units[trial])
    files = [plain[1], plant[1]]
    for name in ("training.csv", f"{SEARCH}/{journal.JOURNAL}", f"{SEARCH}/best.toml", "weights.safetensors"):
        assert files[0][name] == files[1][name], name
    rows = [row_of(left) for left in files]
    decided = ["accuracy_validation", "exit_patience", "sops_validation", "trial", "network.forward_weight_scale"]
    assert [rows[0][key] for key in decided] == [rows[1][key] for key in decided]
    assert rows[0]["spikes_sa"] != rows[1]["spikes_sa"]  # the plant was there


@thinned("side", ["train", "validation"])
def test_what_a_study_may_look_at_does_change_it(tmp_path, side):
    """So the test above can fail: gains see the training trials, and training both."""
    one = cell_of(tmp_path, 0)
    sides = split_conditions(noise().conditions, (), one.split)
    plain = left_of(tmp_path / "plain", noise())
    plant = left_of(tmp_path / "planted", planted(getattr(sides, side)))
    assert (plant[0].encoder != plain[0].encoder) == (side == "train")
    assert plant[1]["training.csv"] != plain[1]["training.csv"]


@pytest.mark.slow
def test_labels_that_only_test_trials_betray_are_at_chance(tmp_path):
    """Mirrored: each split once with the tones of the classes and once with those exchanged, so that a network which
    takes a tone for a class by accident is as often right as wrong.
    """
    honest, leaked = [], []
    for seed in SPLITS:
        one = cell_of(tmp_path, seed)
        sides = split_conditions(noise().conditions, (), one.split)
        for swapped in (False, True):
            trains, left = left_of(tmp_path / f"{seed} {swapped}", planted(sides.test, swapped), seed)
            honest.append(row_of(left)["accuracy_test"])
            # The same network, had the test trials been those it learns from.
            seen = sides._replace(train=sides.test, validation=sides.test)
            fitted, its = trainer.fit(trains, one.network, task_of(one), one.seeds, split=seen)
            leaked.append(measuring.measure(fitted, its, trains.populations)["row"]["accuracy_test"])
    assert np.mean(leaked) > 0.8
    assert abs(np.mean(honest) - 0.5) < 0.1
