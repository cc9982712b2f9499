"""SOP tables of counted spikes, and a cost without the accesses that `metrics/test_memory_by_loops.py` counts."""

from typing import Any

import numpy as np
import pandas as pd

from neurotact.metrics import synops
from neurotact.metrics.flops import FLOPS, Cost
from neurotact.metrics.prices import PRICED


def operations(counted: Cost) -> dict[str, float]:
    """Operations, parameters, bytes, SOPs and energy by the arithmetic alone."""
    return {name: value for name, value in counted.columns().items() if name not in PRICED[len(FLOPS) + 1 :]}


def sops_table(
    labels: Any, predicted: Any, steps: Any, input_spikes: Any, hidden_spikes: Any, **network: Any
) -> pd.DataFrame:
    """The SOP report of windows; network: `n_hidden`, `n_readout` and `recurrent`, and `trials` of the report."""
    trials = network.pop("trials", None)
    operations = synops.synops(np.asarray(input_spikes), np.asarray(hidden_spikes), **network)
    return synops.table_of(operations, labels, predicted, steps, input_spikes, hidden_spikes, trials)
