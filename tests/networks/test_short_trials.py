"""A trial that is far shorter than the others shortens no window: it is left out, and named."""

import numpy as np
import pandas as pd
import pytest

import neurotact as nt
from neurotact.data.hdf5 import save_spikes
from neurotact.data.spikes import from_rasters

SHORT = "1 of 60 trials is shorter than a window and left out: trial 5, 60 ms"


def test_training_and_inference_leave_a_short_trial_out_and_name_it(tmp_path, caplog):
    rng = np.random.default_rng(0)
    rasters = [rng.random((60 if trial == 5 else 300, 2)) < (0.05, 0.2)[trial % 2] for trial in range(60)]
    names = pd.DataFrame({"label": ["felt", "silk"] * 30})
    save_spikes(from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), names), tmp_path / "s.h5")
    nt.train(tmp_path / "s.h5", tmp_path / "run", settings={"hidden": 3, "training.epochs": 1})
    assert [line for line in caplog.messages if "trial 5" in line] == [f"{SHORT}; to use them, shorten `length_ms`."]
    assert caplog.messages[0].startswith("Window: 300 ms (the shortest trial, 300 ms)")
    with pytest.warns(UserWarning, match=SHORT):
        decided = nt.infer(tmp_path / "run", tmp_path / "s.h5")
    assert sorted({*decided["trial"]}) == [*range(5), *range(6, 60)]
