"""What spikes give back of signals: of test trials, by a filter of training trials alone."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.encoders.survival.transfer import reconstructed

from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.recordings import Recordings
from neurotact.data.splits import Split
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import load

SPLIT = Split(train=np.arange(12), validation=np.arange(12, 16), test=np.arange(16, 28))


def felt(n_trials=28, n_samples=1200, n_taxels=2):
    """Two classes of slow waves with random phases, of some 100 counts."""
    rng, time_s = np.random.default_rng(0), np.arange(n_samples)[:, None] * 1e-3
    frequency_Hz = np.tile([3.0, 6.0], n_trials // 2)
    signals = [100 * np.sin(2 * np.pi * f * time_s + rng.uniform(0, 6, n_taxels)) for f in frequency_Hz]
    return Recordings(signals, 1000.0, "count", pd.DataFrame({"label": np.tile(["slow", "fast"], n_trials // 2)}))


def trains_of(recordings, model="step-forward", **changes):
    spec = load(model, changes).model_copy(update={"unit": "count", "conditioning": ConditioningSpec(baseline="none")})
    return encode_recordings(recordings, spec)


def test_more_spikes_give_more_of_the_signal_back():
    recordings = felt()
    found = [reconstructed(recordings, trains_of(recordings, threshold=x), SPLIT) for x in (5.0, 40.0, 80.0)]
    assert found[0].snr_dB > found[1].snr_dB > found[2].snr_dB > 0
    assert all(one.bits_per_s > 0 for one in found)


def test_spikes_of_other_trials_give_nothing_back():
    recordings = felt()
    trains = trains_of(recordings, threshold=5.0)
    turned = np.roll(np.arange(28), 1)
    other = replace(trains, steps=[trains.steps[t] for t in turned], units=[trains.units[t] for t in turned])
    assert reconstructed(recordings, other, SPLIT).snr_dB < 0.5


def test_the_filter_knows_training_trials_alone():
    """Training trials whose spikes are turned round give a filter that says the opposite on test trials."""
    recordings = felt()
    trains = trains_of(recordings, threshold=5.0)
    units = [(u + 2) % 4 if t in SPLIT.train else u for t, u in enumerate(trains.units)]  # ON for OFF
    assert reconstructed(recordings, replace(trains, units=units), SPLIT).snr_dB == pytest.approx(-6, abs=1)


def test_taxels_in_another_order_are_put_into_that_of_the_encoder():
    """Its offsets and scales are of named taxels."""
    named = replace(felt(), channels=("left", "right"))
    how = ConditioningSpec(offset=(50.0, -50.0), scale=(1.0, 40.0), taxels=named.channels)
    spec = load("step-forward", {"threshold": 2.0}).model_copy(update={"unit": "count", "conditioning": how})
    trains, turned = encode_recordings(named, spec), named.of_taxels([1, 0])
    assert reconstructed(turned, trains, SPLIT) == reconstructed(named, trains, SPLIT)


def test_silence_gives_nothing_back():
    recordings = felt()
    found = reconstructed(recordings, trains_of(recordings, threshold=1e6), SPLIT)
    assert found.snr_dB == pytest.approx(0, abs=1e-6)
    assert np.isnan(found.bits_per_spike)
