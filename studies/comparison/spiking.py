"""The spiking family on one task: afferents calibrated on training examples, the default network, early exit."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.task_data import TaskData

from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.encoders.afferents import AfferentSpec, AfferentType
from neurotact.encoders.calibration import calibrate
from neurotact.encoders.encoding import encode_recordings
from neurotact.metrics.flops import Cost
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit import truncated
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import trainer
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.use import measuring
from neurotact.networks.use.ledger import Afferents, network_cost

TRIED = (RSNNSpec(recipe="default", hidden=30), RSNNSpec(recipe="default", hidden=50))
"""Candidate networks, from which validation accuracy chooses: the default recipe in two sizes."""
FAMILY = "SNN"
EARLY = f"{FAMILY}, early exit"
EXIT_TOLERANCE = 0.01
"""Accuracy that early exit may lose on validation windows, and on validation and training windows together."""


class Decided(NamedTuple):
    """Accuracies of a network, and the mean costs of encoding and of the network, run in both ways, per decision."""

    name: str
    settings: str
    accuracy_validation: float
    accuracy_test: float
    encoder: Cost
    network: Cost
    network_by_events: Cost

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
    trains, seeds = encode(task, split.train), of_start(seed, SplitSpec(seed=seed))
    length_ms = 1e3 * int(trains.trial_steps[0]) / trains.sampling_rate_Hz
    how = Task(window=WindowSpec(length_ms=length_ms, per_trial=1), exit_tolerance=EXIT_TOLERANCE, exit_choice="steady")
    fits = [trainer.fit(trains, spec, how, seeds, split=split) for spec in TRIED]
    fitted, sides = max(fits, key=lambda fit: _validated(fit[0].network, fit[1]))
    network, choice = fitted.network, fitted.held
    assert choice is not None
    kind = "recurrent" if network.spec.recurrent else "feed-forward"
    settings = f"N {network.spec.hidden}, {kind}, tau {network.spec.tau_mem_ms:g} and {network.spec.tau_syn_ms:g} ms"
    refused = f"{settings}; early exit not used: whole windows" if choice.is_refused else settings
    return [
        Decided(name, told, _validated(network, sides, rule), *_measure(network, trains, sides, rule))
        for name, rule, told in ((FAMILY, FULL_WINDOW, settings), (EARLY, choice.used, refused))
    ]


def _validated(network: Network, sides: Sides, rule: ExitRule = FULL_WINDOW) -> float:
    return measuring.accuracy_of(network.infer(sides.validation.spikes, rule), sides.validation)


def _measure(network: Network, trains: SpikeTrains, sides: Sides, rule: ExitRule) -> tuple[float, Cost, Cost, Cost]:
    """Test accuracy, and the mean cost of encoding, of the network and of the network by events."""
    inferred = network.infer(sides.test.spikes, rule)
    measured = measuring.means(inferred, network, sides.test, {})
    measured |= measuring.touched(
        truncated.simulate_windows(network, sides.test), network.steps_per_bin, inferred.steps
    )
    steps = float(inferred.steps.double().mean())
    encoder = Afferents.of(trains).cost(steps, measured["sops_input"] / network.spec.hidden)
    sizes, signal_ms = (network.n_inputs, network.n_classes), 1e3 * steps / trains.sampling_rate_Hz
    clocked, by_events = (
        network_cost(network.spec, *sizes, measured, steps=steps, signal_ms=signal_ms, event_driven=event_driven)
        for event_driven in (False, True)
    )
    return measured["accuracy_test"], encoder, clocked, by_events
