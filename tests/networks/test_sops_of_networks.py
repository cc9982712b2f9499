"""SOPs of trained networks, counted by hand wherever studies count them: feed-forward, recurrent, with early exit.

The network is wired by hand and forgets its currents at once: a spike at the one afferent makes both hidden neurons
spike two steps later, and the first class two steps after that. So what is sent, and when, stands on paper:

    step            0 1 2 3 4 5 6 7 8 9
    afferent        x . . x . . x . . .     3 input spikes
    hidden (both)   . . x . . x . . x .     6 hidden spikes
    class 0         . . . . x . . x . .

SOPs of the whole window: input 3 x 2 = 6, recurrent 6 x 2 = 12 (none without recurrence), readout 6 x 3 = 18.
"""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from neurotact_parts.studies.comparison import spiking as spiking_family
from neurotact_parts.studies.texture import shortened

from neurotact.data.spikes import from_rasters
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit import truncated
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training import tasks, trainer
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.tasks import Sides
from neurotact.networks.use import measuring

RATE_Hz, STEPS, HIDDEN, CLASSES = 1000.0, 10, 2, 3
WHOLE = {"rsnn": (6, 12, 18, 36, 24), "snn": (6, 0, 18, 24, 24)}
"""Input, recurrent, readout, total and total without recurrence."""
NAMES = ("input", "recurrent", "readout", "total", "total_feedforward")
POPULATIONS = {"SA-I": np.array([True]), "RA-I": np.array([False])}


def wired(model):
    """One afferent, two hidden neurons that do not move one another, three classes of which the first alone spikes."""
    spec = RSNNSpec(model=model, hidden=HIDDEN, tau_syn_ms=0.01)
    network = RSNN(1, CLASSES, spec, RATE_Hz)
    with torch.no_grad():
        network.w_in[:] = 2.0
        network.w_out.zero_()
        network.w_out[:, 0] = 2.0
        if network.w_rec is not None:
            network.w_rec.zero_()
    return network


def window(n=4):
    spikes = torch.zeros((n, STEPS, 1), dtype=torch.uint8)
    spikes[:, [0, 3, 6]] = 1
    return Examples(spikes, torch.zeros(n, dtype=torch.int64))


def alike(examples: Examples) -> tasks.Sides:
    """The same windows for training, validation and test."""
    return tasks.Sides(examples, examples, examples)


each_model = pytest.mark.parametrize("model", ["rsnn", "snn"])


@each_model
def test_the_network_does_what_stands_on_paper(model):
    rasters = wired(model).simulate(window(1).spikes)
    assert rasters.hidden[0].nonzero().tolist() == [[t, neuron] for t in (2, 5, 8) for neuron in range(HIDDEN)]
    assert rasters.readout[0].nonzero().tolist() == [[4, 0], [7, 0]]


@each_model
def test_a_whole_window(model):
    network = wired(model)
    counted = measuring.synops_of(network.infer(window().spikes), network)
    assert tuple(int(counted._asdict()[name][0]) for name in NAMES) == WHOLE[model]


@each_model
def test_every_way_of_counting_agrees_with_paper(model):
    """Results, networks cut short, networks by condition: one network, one number."""
    network, test = wired(model), window()
    whole = dict(zip((f"sops_{name}" for name in NAMES), WHOLE[model], strict=True))
    (cut,) = shortened.cut_short(network, truncated.simulate_windows(network, test), [STEPS])
    table = pd.DataFrame({"label": ["a", "b", "c"] * 20, "force_N": [3.0] * 60})
    trains = from_rasters(window(60).spikes.numpy(), RATE_Hz, ("SA-I taxel1",), table)
    task = tasks.Task(window=WindowSpec(length_ms=STEPS), split=SplitSpec(), stratify=("force_N",))
    (under,) = measuring.by_condition(network, trains, task)
    row = measuring.measure(fitted(network, patience=STEPS), alike(test), POPULATIONS)["row"]
    for found in (cut, under, row):
        assert {name: found[name] for name in whole} == whole


def fitted(network, patience):
    training = SimpleNamespace(
        best=SimpleNamespace(validation_accuracy=1.0),
        epochs=[],
        n_members=1,
        recurrence_gain=None,
        smallest_accuracy=None,
        layer_gain=None,
        path_gain=None,
    )
    return trainer.Trained(network, training, ExitRule(patience, from_first_spike=True))  # pyright: ignore


@each_model
def test_an_early_exit_counts_the_steps_that_were_simulated_alone(model):
    """The readout spikes at step 4; with patience 1 the network stops after step 5, before the last input spike.

    Until then: 2 input spikes, 4 hidden ones.
    """
    network = wired(model)
    row = measuring.measure(fitted(network, patience=1), alike(window()), POPULATIONS)["row"]
    recurrent = 8 if model == "rsnn" else 0
    assert row["exit_steps"] == 6
    found = tuple(row[f"exit_sops_{name}"] for name in NAMES)
    assert found == (4, recurrent, 12, 16 + recurrent, 16)
    assert row["sops_total"] == WHOLE[model][3]
    curve = shortened.exit_curve(network, *[truncated.simulate_windows(network, window())] * 2, patiences=[1])
    (validated,) = (line for line in curve if line["mode"] == "validated")
    assert tuple(validated[f"sops_{name}"] for name in NAMES) == found
    assert validated["sops_saved"] == pytest.approx(1 - (16 + recurrent) / WHOLE[model][3])


@each_model
def test_the_papers_exit_counts_the_steps_that_were_simulated_alone(model, monkeypatch):
    """Algorithm 1 with a patience of 1 stops within the window, and pays for the steps until then."""
    monkeypatch.setattr(measuring, "ORACLE_PATIENCE", 1)
    network = wired(model)
    row = measuring.measure(fitted(network, patience=STEPS), alike(window()), POPULATIONS)["row"]
    steps = int(row["oracle_steps"])
    assert 0 < steps < 6
    sent, heard = sum(t < steps for t in (0, 3, 6)), HIDDEN * sum(t < steps for t in (2, 5, 8))
    reached = CLASSES + (HIDDEN if model == "rsnn" else 0)
    assert row["oracle_sops_total"] == HIDDEN * sent + reached * heard


@each_model
def test_the_spiking_family_pays_for_the_weights_that_its_network_has(model):
    network = wired(model)
    trains = from_rasters(window().spikes.numpy().repeat(2, axis=2), RATE_Hz, ("SA-I a", "RA-I a"), labels_of(4))
    both = RSNN(2, CLASSES, network.spec, RATE_Hz)
    test = Examples(torch.zeros((4, STEPS, 2)), window().labels)
    _, _, cost, by_events = spiking_family._measure(both, trains, Sides(test, test, test), exit_())
    assert cost.parameters == 2 * HIDDEN + HIDDEN * CLASSES + (HIDDEN * HIDDEN if model == "rsnn" else 0)
    assert by_events.parameters == cost.parameters
    assert by_events.sops == cost.sops


def labels_of(n):
    return pd.DataFrame({"label": ["a"] * n})


def exit_():
    return ExitRule(STEPS, from_first_spike=True)
