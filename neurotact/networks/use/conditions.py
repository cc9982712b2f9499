"""Results of a trained network under each condition of a data set, also those that it was not trained on."""

from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.recordings import select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import split_touches
from neurotact.networks.definition.network import Network
from neurotact.networks.training.tasks import Task, examples_of
from neurotact.networks.use.measuring import means
from neurotact.tables import records


def by_condition(network: Network, trains: SpikeTrains, task: Task) -> list[dict[str, Any]]:
    """Accuracy and mean SOPs on the test trials of each combination of the conditions in `task.stratify`.

    Columns: those conditions, known (whether the network was trained on such trials), n_test (windows),
    accuracy_test, sops_* and spikes_sa, spikes_ra as in results.csv. The test side is that of the whole data set's
    split: each condition is tested on the same trials, whatever a network was trained on.
    """
    table = trains.conditions
    known = select_conditions(table, task.subset)
    test = split_touches(trains, task.stratify, task.split).test
    rows = []
    for values, group in table.iloc[test].groupby(list(task.stratify), sort=True):
        trials = np.sort(group.index.to_numpy())
        for is_known in sorted(set(known[trials].tolist())):
            examples, _ = examples_of(trains, trials[known[trials] == is_known], task.window)
            inference = network.infer(examples.spikes.to(network.device))
            rows.append(
                {
                    **dict(zip(task.stratify, values, strict=True)),
                    "known": is_known,
                    "n_test": len(examples.labels),
                    **means(inference, network, examples, trains.populations),
                }
            )
    return records(pd.DataFrame(rows))
