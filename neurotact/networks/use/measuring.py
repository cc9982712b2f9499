"""Results of a trained network on its test windows, also under each condition: accuracy, SOPs, early exit."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import torch
from sklearn.metrics import confusion_matrix

from neurotact.baselines.opponent import right
from neurotact.data.recordings import select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import split_touches
from neurotact.metrics import synops
from neurotact.networks.definition.network import CountedInference, Inference, Network
from neurotact.networks.exit import truncated
from neurotact.networks.exit.patience import oracle_exit
from neurotact.networks.exit.rule import leads
from neurotact.networks.training.epochs import GAINS, Examples
from neurotact.networks.training.tasks import Sides, Task, examples_of
from neurotact.networks.training.trainer import Trained
from neurotact.tables import records

OWN_KEYS = "network_keys"
"""Column of results: the keys of a network that is no RSNN, which have no column of their own."""
TOUCHED = ("touched_hidden", "touched_readout")
"""Columns of results: neurons and steps in which a spike comes, the mean of a decision."""
SPIKES = ("input_spikes", "hidden_spikes")
"""Of a decision, the spikes that arrive and those of hidden neurons, by their names in an `Inference`."""
ORACLE_PATIENCE = 120
"""The patience that the texture paper's Algorithm 1 starts from (Table V), in steps."""


def measure(trained: Trained, sides: Sides, populations: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Accuracy, SOPs and early exit on the test windows, the confusion matrix, and whether each window is right.

    populations: afferents of each one, as `SpikeTrains.populations`. SOPs, spikes and steps are means over windows.
    `right` and `exit_right` are of each test window, on the whole window and with early exit; `exit_losses` of each
    validation trial (`patience.ExitChoice`). Of numbers, accuracies are mean scores, the matrix is empty, and `values`
    are those of the test windows, `(window, target)`, and `exit_values` with early exit.
    """
    network, test = trained.network, sides.test
    spikes = test.spikes.to(network.device)
    full, early = network.infer(spikes), network.infer(spikes, trained.rule)
    exit_cost, steps = synops_of(early, network), early.steps.double()
    windows = truncated.simulate_windows(network, test)
    row = {
        "accuracy_validation": trained.training.best.validation_accuracy,
        "exit_accuracy_validation": exit_accuracy(trained, sides.validation),
        **({} if (held := trained.held) is None else {"exit_loss_bound": held.bound}),
        **means(full, network, test, populations),
        **_answered(trained, full, early, test),
        "exit_steps": float(steps.mean()),
        "exit_accuracy": accuracy_of(early, test),
        "exit_sops_total": float(exit_cost.total.mean()),
        "exit_steps_sd": float(steps.std(correction=0)),
        **{f"exit_sops_{n}": float(v.mean()) for n, v in exit_cost._asdict().items() if n != "total"},
        "exit_patience": trained.rule.patience,
        **touched(windows, network.steps_per_bin),
        **{f"exit_{name}": value for name, value in touched(windows, network.steps_per_bin, early.steps).items()},
        **({} if test.labels.ndim > 1 else _oracle(network, windows)),
        **({} if network.spec.own is None else {OWN_KEYS: network.spec.own_keys}),
        **(_spikes_of(network, full, early) if network.spec.own is not None or not network.spec.hidden else {}),
        **(network.synapses and {**network.synapses, **_spikes("", full), **_spikes("exit_", early)}),
        "window_steps": test.spikes.shape[1],
        "steps_per_bin": network.steps_per_bin,
        "readout_stretches": network.spec.readout_stretches,
        "epochs": len(trained.training.epochs),
        **({} if (n := trained.training.n_members) == 1 else {"members": n}),
        **{name: gain for name in GAINS if (gain := getattr(trained.training, name)) is not None},
        **({} if (blocks := network.spec.recurrent_blocks) == 1 else {"recurrent_blocks": blocks}),
        **({"direct": 1} if network.spec.direct and network.spec.hidden else {}),
    }
    right, exit_right = (right_of(result, test) for result in (full, early))
    losses = {} if held is None else {"exit_losses": {**held.losses}}
    found = {"row": row, "right": right, "exit_right": exit_right, **losses}
    if test.labels.ndim > 1:
        values, early_values = (result.readout.cpu().numpy() for result in (full, early))
        return {**found, "confusion": [], "values": values, "exit_values": early_values}
    found["confusion"] = confusion_matrix(test.labels, full.labels.cpu(), labels=range(network.n_classes)).tolist()
    return found


def _spikes_of(network: Network, full: Inference, early: Inference) -> dict[str, float]:
    """The mean spikes into a network, where operations do not tell them, and of its layers, if these are its own."""
    names = SPIKES[: 1 if network.spec.own is None else 2]
    return {**_spikes("", full, names), **_spikes("exit_", early, names)}


def _answered(trained: Trained, full: Inference, early: Inference, test: Examples) -> dict[str, float]:
    """The share of test windows that are not refused, and the accuracy of these; nothing if none may be refused."""
    row, refusal = {}, trained.refusal
    for before, found, least in () if refusal is None else (("", full, refusal.whole), ("exit_", early, refusal.early)):
        answered = (leads(found.readout) >= least).cpu().numpy()
        right = np.array(right_of(found, test))[answered]
        row |= {f"{before}answered": float(answered.mean()), f"{before}accuracy_answered": float(right.mean())}
    return row


def _spikes(before: str, decided: Inference, names: Sequence[str] = SPIKES) -> dict[str, float]:
    """Means of spikes of decisions, as columns."""
    return {f"{before}{name}": float(getattr(decided, name).double().mean()) for name in names}


def exit_accuracy(trained: Trained, validation: Examples) -> float:
    """The accuracy of early exit on validation windows, by which networks with early exit are chosen."""
    spikes = validation.spikes.to(trained.network.device)
    return accuracy_of(trained.network.infer(spikes, trained.rule), validation)


def means(
    inference: Inference, network: Network, examples: Examples, populations: Mapping[str, np.ndarray]
) -> dict[str, float]:
    """Accuracy, SOPs and spikes of each population, means over windows that were decided."""
    cost, spikes = synops_of(inference, network), examples.spikes.sum(dim=(0, 1)).numpy() / len(examples.labels)
    return {
        "accuracy_test": accuracy_of(inference, examples),
        **{f"sops_{name}": float(values.mean()) for name, values in cost._asdict().items()},
        **{spikes_column(name): float(spikes[afferents].sum()) for name, afferents in populations.items()},
    }


def spikes_column(population: str) -> str:
    """The column of results that holds the spikes of a population per window.

    >>> [spikes_column(name) for name in ("SA-I", "RA-I", "PC", "ON")]
    ['spikes_sa', 'spikes_ra', 'spikes_pc', 'spikes_on']
    """
    return f"spikes_{re.sub('[^a-z0-9]+', '_', population.removesuffix('-I').lower()).strip('_') or 'afferents'}"


def mean_sops(network: Network, examples: Examples) -> float:
    """Synaptic operations per window, the mean over all windows."""
    return float(synops_of(network.infer(examples.spikes.to(network.device)), network).total.mean())


def touched(
    windows: truncated.SimulatedWindows, steps_per_bin: int, decided: torch.Tensor | None = None
) -> dict[str, float]:
    """Neurons and steps that a spike reaches, means over windows, as columns of `TOUCHED`; none if not counted.

    decided: steps of the encoder's clock until each decision, `(window,)`; None: whole windows.
    """
    n, steps = windows.readout.shape[:2]
    until = torch.full((n,), steps) if decided is None else -(-decided.cpu() // steps_per_bin)
    found = windows.touched_until(until)
    return {} if found is None else dict(zip(TOUCHED, found.tolist(), strict=True))


def _oracle(network: Network, windows: truncated.SimulatedWindows) -> dict[str, float]:
    """Steps, accuracy and SOPs of the paper's early exit, which knows the true labels (Algorithm 1)."""
    n = network.steps_per_bin
    patience = min(max(1, ORACLE_PATIENCE // n), windows.readout.shape[1])
    steps, labels, _ = oracle_exit(windows.readout, windows.labels, patience, windows.integration)
    row = truncated.judged(network, windows, steps, labels)
    return {
        "oracle_steps": n * float(steps.double().mean()),
        "oracle_accuracy": row["accuracy_test"],
        "oracle_sops_total": row["sops_total"],
    }


def synops_of(inference: Inference, network: Network) -> synops.Synops:
    """The synaptic operations of each window that was decided."""
    sops = inference.sops.cpu().numpy() if isinstance(inference, CountedInference) else None
    return network.operations(inference.input_spikes.cpu().numpy(), inference.hidden_spikes.cpu().numpy(), sops)


def right_of(inference: Inference, examples: Examples) -> list[float]:
    """`opponent.right` of each window that was decided."""
    return right(inference.readout.cpu(), examples.labels, examples.deviation).tolist()


def accuracy_of(inference: Inference, examples: Examples) -> float:
    """The share of windows that were decided correctly, or the mean score of numbers."""
    return float(np.mean(right_of(inference, examples)))


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
            examples, _ = examples_of(trains, trials[known[trials] == is_known], task)
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
