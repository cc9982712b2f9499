"""Calibration of fitted mechanoreceptors: a depth for each unit of any sensor, in a spec that encodes."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.encoders.mechanoreceptor import MechanoreceptorSpec
from test_calibration import RULE, slides

from neurotact import spec as specs
from neurotact.encoders.calibration import calibrate, calibration_for
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.gain_search import suited_rule
from neurotact.errors import InputError
from neurotact.figures.calibration import draw_calibration


def load(name, changes=None) -> MechanoreceptorSpec:
    return specs.load(MechanoreceptorSpec, name, changes)


SPEC = load("mechanoreceptor", {"conditioning.resample_Hz": 1000.0})
QUICK = RULE.model_copy(update={"candidates": 9, "step": 1.8, "trials_per_class": 4, "taxels": 2})


def fit(recordings, spec=SPEC):
    return calibrate(recordings, spec, rule=QUICK)


@pytest.fixture(scope="module")
def fitted():
    return fit(slides())


def test_a_gain_is_found_for_each_population_and_the_encoder_fires(fitted, tmp_path):
    assert fitted.table[fitted.table.chosen].afferent.tolist() == ["SA-I", "RA-I"]
    path = tmp_path / "mine.toml"
    path.write_text(specs.to_toml(fitted.encoder.model_dump(mode="json", exclude_none=True)))
    again = load(path)
    assert again == fitted.encoder
    assert again.noise  # the search alone is without
    trains = encode_recordings(slides(), again)
    counts = np.bincount(np.concatenate(trains.units), minlength=6)
    assert (counts > 0).all()


def test_scaling_a_sensor_leaves_its_spikes_unchanged(fitted):
    recordings = slides()
    scaled = replace(recordings, signals=[s * np.float32(2.0**7) for s in recordings.signals], unit="count")
    other = fit(scaled).encoder
    ours, theirs = encode_recordings(recordings, fitted.encoder), encode_recordings(scaled, other)
    assert all(np.array_equal(a, b) for a, b in zip(ours.steps, theirs.steps, strict=True))


def test_three_populations_are_calibrated_and_drawn():
    with_pc = load("mechanoreceptor-pc", {"conditioning.resample_Hz": 1000.0, "sa1.fits": [1, 2]})
    found = fit(slides((20.0, 60.0)), with_pc)
    assert isinstance(found.encoder, MechanoreceptorSpec)
    assert found.encoder.sa1.fits == (1, 2)
    assert found.table[found.table.chosen].afferent.tolist() == ["SA-I", "RA-I", "PC"]
    titles = {axes.get_title() for axes in draw_calibration(found.table, found.isi, found.encoder.gain_units).axes}
    assert {"SA-I", "RA-I", "PC"} <= titles


def test_a_slow_sensor_has_no_pc_and_a_slow_search_has_fewer_trials():
    with_pc = load("mechanoreceptor-pc")
    slow = replace(slides(rate_Hz=200.0), conditions=pd.DataFrame({"label": ["a", "b"] * 8}))
    with pytest.raises(InputError, match="PC afferents need recordings of 500 Hz or more"):
        calibrate(slow, with_pc, rule=QUICK)
    assert suited_rule(with_pc, RULE.model_copy(update={"trials_per_class": 64}), n_classes=8).trials_per_class == 16
    with pytest.raises(InputError, match=r"pc\.gain: calibration sets it"):
        calibration_for(with_pc, {"pc.gain": 1.0})
