"""The report of a study on touches that begin at different times names the options that follow each onset."""

import ast
import json
import re

import numpy as np
import pandas as pd
import pytest

from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.report import report
from neurotact.studies import loading, runner

SMALL = {
    "baselines": "quick",
    "sweep.seed": [0],
    "sweep.network.hidden": [4],
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]],
    "network.training.epochs": 1,
    "encoder.tau_mem_ms": 10,  # with longer membranes even this network is as accurate as others, and nothing is to say
}
SETTINGS = re.compile(r"`settings=(\{.+\})`")


@pytest.fixture
def squeezes(tmp_path):
    """30 trials of 4 s at 100 Hz: noise, and after a random rest a squeeze of 0.6 s whose level shows its class."""
    rng = np.random.default_rng(0)
    signals = rng.normal(0, 0.02, (30, 400, 3))
    for trial, onset in enumerate(rng.integers(60, 320, 30)):
        signals[trial, onset : onset + 60] += rng.uniform(0.9, 1.1) * np.array([2 + trial % 2, 3 - trial % 2, 2])
    conditions = pd.DataFrame({"label": ["ball", "cube"] * 15})
    hdf5.save_recordings(Recordings(list(signals.astype(np.float32)), 100.0, "N", conditions), tmp_path / "touches.h5")
    return tmp_path / "touches.h5"


@pytest.mark.thorough
def test_a_study_of_late_touches_names_options_that_its_spec_takes(squeezes, tmp_path):
    runner.run(loading.resolve("own-recordings", SMALL, data=squeezes), tmp_path / "run")
    report.write(tmp_path / "run")
    cautions = json.loads((tmp_path / "run" / "answer.json").read_text())["cautions"]
    (line,) = [line for line in cautions if line.startswith("Touches begin at different times, in ")]
    named = ast.literal_eval(SETTINGS.findall(line)[0])
    window = loading.resolve("own-recordings", SMALL | named, data=squeezes).window
    assert (window.align, window.per_trial) == ("onset", 1)
    assert 0 < window.onset.rest_ms < 1000
