"""The spikes of the window that a report draws."""

import numpy as np
from made_chains import make_run

from neurotact.data.hdf5 import load_spikes
from neurotact.figures.encoding import Classes
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.training import run_folder
from neurotact.report import details


def test_a_network_on_a_slower_clock_spikes_at_the_ends_of_its_steps(tmp_path):
    restored = run_folder.restore(make_run(tmp_path) / "run")
    trains = load_spikes(tmp_path / "spikes.h5")
    spec = restored.network.spec.model_copy(update={"step_ms": 5.0})
    slow = RSNN(restored.network.n_inputs, restored.network.n_classes, spec, trains.sampling_rate_Hz)
    slow.load_state_dict(restored.network.state_dict())
    names = {label: label for label in ("felt", "silk")}
    classes = Classes("material", tuple(names), names, names)
    drawn = details._raster(restored._replace(network=slow), trains, (0, 0), classes, 10_000)
    assert drawn["steps"] == 40
    steps = np.concatenate([np.array(neuron, int) for neuron in drawn["hidden"]])
    assert len(steps)
    assert set(steps % 5) == {4}
