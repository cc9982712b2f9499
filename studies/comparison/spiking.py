"""The spiking family on one task: afferents calibrated on training examples, the default network, early exit."""

from typing import NamedTuple

import numpy as np
import pandas as pd
import torch

from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, SplitSpec
from neurotact.data.windows import Windows
from neurotact.encoders.afferents import AfferentSpec, AfferentType
from neurotact.encoders.calibration import calibrate
from neurotact.encoders.encoding import encode_recordings
from neurotact.metrics.flops import Cost
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.early_exit import FULL_WINDOW, ExitRule
from neurotact.networks.training import fitting
from neurotact.networks.training.training import Examples
from neurotact.networks.use import measuring
from neurotact.networks.use.ledger import Afferents, network_cost
from neurotact.studies.protocol import TaskData

TRIED = (RSNNSpec(recipe="default", hidden=30), RSNNSpec(recipe="default", hidden=50))
"""Candidate networks, from which validation accuracy chooses: the default recipe in two sizes."""
FAMILY = "SNN"
EARLY = f"{FAMILY}, early exit"
EXIT_TOLERANCE = 0.01
"""Accuracy that early exit may lose on validation windows, and on validation and training windows together."""


class Decided(NamedTuple):
    """Accuracies of a network, and the mean costs of encoding and of the network per decision."""

    name: str
    settings: str
    accuracy_validation: float
    accuracy_test: float
    encoder: Cost
    network: Cost

    @property
    def cost(self) -> Cost:
        """The total cost."""
        return self.encoder + self.network


def encode(task: TaskData, train_examples: np.ndarray) -> SpikeTrains:
    """Spike trains of all examples, from afferents whose standardisation and gains are fitted on training examples."""
    conditions = pd.DataFrame({LABEL: task.labels})
    recordings = Recordings(task.sequences, task.sampling_rate_Hz, task.unit, conditions, source="task")
    start = AfferentSpec(unit=task.unit, sa1=AfferentType(gain=1.0), ra1=AfferentType(gain=1.0))
    return encode_recordings(recordings, calibrate(recordings.select(train_examples), start).encoder)


def decide(task: TaskData, split: Split, seed: int) -> list[Decided]:
    """The network with the best validation accuracy, over the whole window and with early exit as it is used.

    Where validation examples do not bound its loss within the tolerance, early exit decides on whole windows, too.

    Costs count conditioning and afferents of every taxel on every step until the decision, and the network by its
    measured SOPs.
    """
    trains = encode(task, split.train)
    training, validation, test = (_examples(trains, side) for side in split)
    fits = [_fit(trains, spec, training, validation, seed) for spec in TRIED]
    best = max(range(len(fits)), key=lambda i: fits[i][1])
    network, accuracy_validation = fits[best]
    choice = fitting.exit_of(network, validation, EXIT_TOLERANCE, training)
    kind = "recurrent" if network.spec.recurrent else "feed-forward"
    settings = f"N {network.spec.hidden}, {kind}, tau {network.spec.tau_mem_ms:g} and {network.spec.tau_syn_ms:g} ms"
    decided = []
    refused = f"{settings}; early exit not used: whole windows" if choice.is_refused else settings
    for name, rule, told in ((FAMILY, FULL_WINDOW, settings), (EARLY, choice.used, refused)):
        accuracy_exit = accuracy_validation if rule is FULL_WINDOW else _accuracy(network, validation, rule)
        decided.append(Decided(name, told, accuracy_exit, *_measure(network, trains, test, rule)))
    return decided


def _examples(trains: SpikeTrains, side: np.ndarray) -> Examples:
    windows = Windows(side, np.zeros(len(side), np.int64), int(trains.trial_steps[0]))
    return Examples(torch.from_numpy(trains.raster(windows)), torch.from_numpy(trains.labels[side]))


def _fit(
    trains: SpikeTrains, spec: RSNNSpec, training: Examples, validation: Examples, seed: int
) -> tuple[Network, float]:
    network, _ = fitting.new_trained(trains, spec, of_start(seed, SplitSpec(seed=seed)), training, validation)
    return network, _accuracy(network, validation, FULL_WINDOW)


def _accuracy(network: Network, examples: Examples, rule: ExitRule) -> float:
    return measuring.accuracy_of(network.infer(examples.spikes, rule), examples)


def _measure(network: Network, trains: SpikeTrains, test: Examples, rule: ExitRule) -> tuple[float, Cost, Cost]:
    """Test accuracy, and the mean cost of encoding and of the network."""
    inferred = network.infer(test.spikes, rule)
    measured = {f"sops_{name}": float(v.mean()) for name, v in measuring.synops_of(inferred, network)._asdict().items()}
    steps = float(inferred.steps.double().mean())
    signal_ms = 1e3 * steps / trains.sampling_rate_Hz
    encoder = Afferents.of(trains).cost(steps, measured["sops_input"] / network.spec.hidden)
    sizes = len(trains.afferents), network.n_classes
    network_spent = network_cost(network.spec, *sizes, measured, steps=steps, signal_ms=signal_ms)
    return measuring.accuracy_of(inferred, test), encoder, network_spent
