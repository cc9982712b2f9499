"""Information about classes and signals: known channels, no bias from few trials, and what a filter cannot know."""

import numpy as np
import pytest
from neurotact_parts.encoders.survival.information import class_information
from neurotact_parts.encoders.survival.reconstruction import direct, linear, segments

from neurotact.errors import InputError


def test_a_binary_channel_with_errors_has_its_capacity():
    """One of ten trials fires wrongly: 1 - H(0.1) = 0.531 bit."""
    rng, labels = np.random.default_rng(0), np.tile([0, 1], 2000)
    counts = np.where(rng.random(4000) < 0.1, 1 - labels, labels)[:, None]
    assert class_information(counts, labels)[0] == pytest.approx(0.531, abs=0.03)


@pytest.mark.parametrize("n_trials", [24, 96])
def test_counts_that_tell_nothing_tell_nothing_of_few_trials_either(n_trials):
    rng = np.random.default_rng(1)
    counts, labels = rng.poisson(3, (n_trials, 300)), np.tile(np.arange(4), n_trials // 4)
    plugin_bias = 0.3 if n_trials == 24 else 0.08
    assert abs(class_information(counts, labels).mean()) < plugin_bias / 3


def test_many_counts_are_binned():
    labels = np.repeat([0, 1], 100)
    counts = (np.arange(200) + 1000 * labels)[:, None]
    assert class_information(counts, labels)[0] == pytest.approx(1, abs=0.03)


def test_the_noise_of_a_channel_is_the_noise_of_its_reconstruction():
    """Spikes as x plus noise of a tenth of its power: 10 dB, and log2(11) bits for each of the lines."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(400, 64, 2))
    heard = (x + rng.normal(0, np.sqrt(0.1), x.shape))[..., None]
    found, _ = linear(x, heard, np.arange(400), 128.0)
    assert found.snr_dB == pytest.approx(10 * np.log10(11), abs=0.3)  # of the optimal filter: 1 + signal / noise
    assert found.bits_per_s == pytest.approx(64 * np.log2(11), rel=0.07)  # 64 Hz


def test_spikes_of_something_else_give_nothing_on_other_trials():
    rng = np.random.default_rng(0)
    found, _ = linear(rng.normal(size=(300, 64, 1)), rng.normal(size=(300, 64, 1, 2)), np.arange(300), 128.0)
    assert -0.2 < found.snr_dB < 0.05


def test_a_decoder_without_a_fit_is_judged_without_the_mean():
    x = np.random.default_rng(0).normal(size=(5, 64, 2))
    assert direct(x, x + 7.0, 128.0).snr_dB > 100
    assert direct(x, 0 * x, 128.0).snr_dB == pytest.approx(0)


def test_trials_are_cut_into_segments_of_the_shortest():
    trials = [np.arange(100.0)[:, None], np.arange(130.0)[:, None]]
    cut, trial = segments(trials, 100.0)
    assert (cut.shape, trial.tolist()) == ((4, 50, 1), [0, 0, 1, 1])
    with pytest.raises(InputError, match="too few to decode"):
        segments([np.zeros((5, 1))], 100.0)
