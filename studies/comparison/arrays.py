"""A set of touches as plain arrays, which a study keeps in one file, and back."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.spikes import SpikeTrains, TrialSpikes, from_trials

CONDITION = "condition "
"""Prefix of the stored arrays of conditions, `(trial,)`."""


def as_arrays(touches: Recordings | SpikeTrains) -> dict[str, np.ndarray]:
    """Trials of any lengths as plain arrays, which `from_arrays` reads.

    Of both `sampling_rate_Hz` and each condition, `(trial,)`. Of recordings `values`, `(sample, taxel)` float32,
    `lengths`, `(trial,)`, `unit`, `channels`; of spikes `steps` and `units`, `(spike,)`, `counts` and `trial_steps`,
    `(trial,)`, `afferents`.
    """
    conditions = touches.conditions
    texts = [name for name in conditions if name == LABEL or conditions[name].dtype.kind not in "iufb"]
    kept = conditions.assign(**{str(name): conditions[name].astype(str) for name in texts})
    shared = {
        "sampling_rate_Hz": np.array(touches.sampling_rate_Hz),
        **{f"{CONDITION}{name}": np.array(kept[name].tolist()) for name in kept},
    }
    if isinstance(touches, SpikeTrains):
        return {
            **shared,
            "steps": np.concatenate([np.asarray(steps, np.int64) for steps in touches.steps]),
            "units": np.concatenate([np.asarray(units, np.int64) for units in touches.units]),
            "counts": np.array([len(steps) for steps in touches.steps]),
            "trial_steps": touches.trial_steps,
            "afferents": np.array(touches.afferents),
        }
    return {
        **shared,
        # In the order of memory that every file has: sums over time in another order differ in their last bits.
        "values": np.ascontiguousarray(np.concatenate([np.asarray(one, np.float32) for one in touches.signals])),
        "lengths": touches.lengths,
        "unit": np.array(touches.unit),
        "channels": np.array(touches.channels),
    }


def from_arrays(stored: Mapping[str, np.ndarray], source: str) -> Recordings | SpikeTrains:
    """The trials of `as_arrays`; source: their name in messages."""
    conditions = pd.DataFrame({
        key.removeprefix(CONDITION): stored[key] for key in stored if key.startswith(CONDITION)
    })  # fmt: skip
    rate_Hz = float(stored["sampling_rate_Hz"])
    if "afferents" in stored:
        ends = np.cumsum(stored["counts"])[:-1]
        rows = np.split(stored["steps"], ends), np.split(stored["units"], ends), stored["trial_steps"].tolist()
        return from_trials(map(TrialSpikes, *rows), rate_Hz, tuple(stored["afferents"].tolist()), conditions)
    signals = np.split(stored["values"], np.cumsum(stored["lengths"])[:-1])
    return Recordings(signals, rate_Hz, str(stored["unit"]), conditions, tuple(stored["channels"].tolist()), source)
