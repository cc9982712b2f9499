"""The trials of an answer, over all of its splits."""

from types import SimpleNamespace

import numpy as np
import pandas as pd

from neurotact.data.spikes import from_rasters
from neurotact.data.splits import Split
from neurotact.report import front


def test_copies_count_once(monkeypatch):
    rasters = np.random.default_rng(0).random((20, 30, 2)) < 0.5
    rasters[12] = rasters[11]
    trains = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), pd.DataFrame({"label": ["felt", "silk"] * 10}))
    splits = [
        Split(np.arange(10), np.arange(10, 15), np.arange(15, 20)),  # 11 and 12 are copies: four validation trials
        Split(np.arange(5, 15), np.arange(15, 20), np.arange(5)),
    ]
    monkeypatch.setattr(front, "task_of", lambda cell: cell.split)
    monkeypatch.setattr(front.tasks, "trials_of", lambda trains, split: split)
    sides = front.sides_of(trains, [SimpleNamespace(split=split) for split in splits], [5, 5])
    assert (sides.trials.validation, sides.trials.test) == (9, 10)
    fewer = front.sides_of(trains, [SimpleNamespace(split=split) for split in splits], [5, 5], {0, 1, 2, 3, 16, 18})
    assert (fewer.trials.validation, fewer.trials.test) == (9, 6)
    assert fewer.tested == {"felt": 4, "silk": 2}


def test_without_the_trains_the_test_trials_stand_for_them():
    sides = front.sides_of(None, [], [5, 7])
    assert (sides.trials.validation, sides.trials.test) == (12, 12)
    windows = front.sides_of(None, [], [50, 70], {*range(12)})
    assert (windows.trials.validation, windows.trials.test) == (12, 12)
