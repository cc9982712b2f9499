"""Every simulator keeps to one form, so that the command line and studies need to know none of them."""

import tracemalloc

import numpy as np
import pytest

from neurotact import plugins
from neurotact.data.dataset import simulator
from neurotact.errors import InputError

SMALL = {
    "gratings": {"trials": 1, "duration_s": 0.3},
    "gratings-slips": {"recordings": 1, "duration_s": 6.0},
    "stiffness": {"placements": 1, "grasps": 1},
    "touch-modality": {"people": 1, "recording_s": 2.0, "duration_s": 0.5},
    "contact-materials": {"trials": 1},
    "compliance": {"trials": 1},
}


@pytest.mark.parametrize("name", plugins.names("simulators"))
def test_an_experiment_gives_its_trials_tells_its_progress_and_repeats(name):
    experiment = simulator(name)
    spec = experiment.model(**SMALL[name])
    told = []
    first = experiment.simulate(spec, lambda done, total: told.append((done, total)))
    again = experiment.simulate(spec, None)
    assert told[-1] == (spec.n_trials, spec.n_trials) == (len(first), len(first))
    assert [done for done, _ in told] == sorted({done for done, _ in told})
    assert all(np.array_equal(a, b) for a, b in zip(first.signals, again.signals, strict=True))


HUGE = {
    "gratings": [{"trials": 10**9}, {"trials": 1, "duration_s": 1e9}, {"trials": 1, "mount_damping": 1e-12}],
    "gratings-slips": [{"recordings": 10**9}, {"recordings": 1, "duration_s": 1e9}],
    "stiffness": [{"placements": 10**9}, {"placements": 1, "grasps": 1, "release_s": 1e9}],
    "touch-modality": [{"people": 10**9}, {"people": 1, "recording_s": 1e9}],
    "contact-materials": [{"trials": 10**9}, {"trials": 1, "sampling_rate_Hz": 1e12}],
    "compliance": [{"trials": 10**9}, {"trials": 1, "travel_mm": 1e9}],
}


@pytest.mark.parametrize(("name", "changes"), [(name, changes) for name in HUGE for changes in HUGE[name]])
def test_a_simulation_that_is_too_large_is_refused_before_it_begins(name, changes):
    experiment = simulator(name)
    spec = experiment.model(**changes)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"simulation: .* MB, more than the limit of 512 MB; .*NEUROTACT_MAX_MB"):
        experiment.simulate(spec, None)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_every_experiment_is_bounded():
    assert sorted(HUGE) == plugins.names("simulators")
