"""Every simulator keeps to one form, so that the command line and studies need to know none of them."""

import numpy as np
import pytest

from neurotact.data.simulate.experiments import EXPERIMENTS

SMALL = {
    "gratings": {"trials": 1, "duration_s": 0.3},
    "stiffness": {"placements": 1, "grasps": 1},
    "touch-modality": {"people": 1, "recording_s": 2.0, "duration_s": 0.5},
    "contact-materials": {"trials": 1},
    "compliance": {"trials": 1},
}


@pytest.mark.parametrize("name", list(EXPERIMENTS))
def test_an_experiment_gives_its_trials_tells_its_progress_and_repeats(name):
    experiment = EXPERIMENTS[name]
    spec = experiment.model(**SMALL[name])
    told = []
    first = experiment.simulate(spec, lambda done, total: told.append((done, total)))
    again = experiment.simulate(spec, None)
    assert told[-1] == (spec.n_trials, spec.n_trials) == (len(first), len(first))
    assert [done for done, _ in told] == sorted({done for done, _ in told})
    assert all(np.array_equal(a, b) for a, b in zip(first.signals, again.signals, strict=True))
