"""Calibration turns the sensitivity of every model: rates asked for, a note where none is near."""

import numpy as np
import pandas as pd
import pytest

from neurotact.data.recordings import Recordings
from neurotact.encoders.calibration import calibrate, calibration_for
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.encoders.model import usable
from neurotact.encoders.sensitivity import sensitivities_of, value_of
from neurotact.encoders.specs import load
from neurotact.errors import InputError

SEARCHED = [model for model in usable() if model not in ("lif", "mechanoreceptor")]
QUICK = {"candidates": 12, "step": 1.6, "shuffles": 2}


def waves(n_trials=6, n_samples=600, n_taxels=2):
    """Two classes: slow and fast waves of some 100 counts, each with its phase and noise."""
    rng, time_s = np.random.default_rng(0), np.arange(n_samples)[:, None] * 1e-3
    frequency_Hz = np.repeat([3.0, 9.0], n_trials // 2)
    signals = [
        100 * np.sin(2 * np.pi * f * time_s + rng.uniform(0, 6, n_taxels)) + rng.normal(0, 5, (n_samples, n_taxels))
        for f in frequency_Hz
    ]
    labels = pd.DataFrame({"label": np.repeat(["slow", "fast"], n_trials // 2)})
    return Recordings(signals, 1000.0, "count", labels)


def start_of(model):
    return load(model, {"conditioning.baseline": "none", **({"filter_ms": 15.0} if model == "bens-spiker" else {})})


LIMITED: set[str] = set()
"""Models whose rate has a limit below ten spikes a second on these signals."""


@pytest.mark.parametrize("model", [model for model in SEARCHED if model not in LIMITED])
def test_a_rate_that_is_asked_for_is_found(model):
    """Ten spikes a second of an afferent: of the fitted encoder, on its training trials."""
    felt = waves()
    found = calibrate(felt, start_of(model), rule=CalibrationRule(spikes_per_s=10, **QUICK), tell=False)
    trains = encode_recordings(felt, found.encoder)
    rate = sum(map(len, trains.steps)) / (6 * 0.6 * len(trains.afferents))
    assert rate == pytest.approx(10, rel=0.3)
    assert found.encoder.unit == "count"
    assert found.rates.shape[0] == found.rates_ra.shape[0] == 6


@pytest.mark.parametrize("model", ["send-on-delta", "poisson", "latency", "moving-window"])
def test_values_are_searched_from_silence_on(model):
    found = calibrate(waves(), start_of(model), rule=CalibrationRule(every=True, **QUICK), tell=False)
    assert calibrate(waves(), start_of(model), rule=CalibrationRule(**QUICK), tell=False).encoder == found.encoder
    for sensitivity in sensitivities_of(found.encoder):
        mine = found.table[found.table.afferent == sensitivity.name]
        assert mine.spikes_per_s.iloc[0] == 0
        assert mine.spikes_per_s.is_monotonic_increasing or model == "poisson"
        assert mine.gain.is_monotonic_increasing is not sensitivity.is_threshold
        assert mine.gain[mine.chosen].tolist() == [value_of(found.encoder, sensitivity)]


def test_a_rate_beyond_what_a_model_gives_is_noted():
    rule = CalibrationRule(spikes_per_s=100, **QUICK)
    found = calibrate(waves(), start_of("latency"), rule=rule, tell=False)
    assert sum("no gain that was tried gives an afferent more than" in note for note in found.notes) == 2


def test_where_both_signs_fire_the_zero_is_the_mean():
    rule = CalibrationRule(spikes_per_s=10, **QUICK)
    offsets = [
        np.array(calibrate(waves(), start_of(model), rule=rule, tell=False).encoder.conditioning.offset or ())
        for model in ("sigma-delta", "burst")
    ]
    assert np.abs(offsets[0]).max() < 15 < -np.max(offsets[1])


@pytest.mark.parametrize(("model", "key"), [("send-on-delta", "threshold"), ("burst", "ra1.gain")])
def test_a_value_that_calibration_finds_is_refused(model, key):
    with pytest.raises(InputError, match=f"{key}: calibration sets it"):
        calibration_for(load(model), {key: 2.0})
