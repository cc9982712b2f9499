"""A taxel's size says nothing of its worth: small ones that tell classes apart count in full, noise does not."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

from neurotact.data.conditioning import Baseline
from neurotact.data.recordings import Recordings
from neurotact.encoders import scaling
from neurotact.encoders.scaling import QUIET, highest_of, spread_of, tells_classes
from neurotact.errors import InputError

CLASSES, TRIALS, SAMPLES = 3, 12, 60
LABELS = np.repeat(np.arange(CLASSES), TRIALS)


def touches(*taxels, labels=LABELS, seed=0):
    """Trials of taxels that are each a function of the class and a generator."""
    rng = np.random.default_rng(seed)
    return [np.stack([taxel(label, rng) for taxel in taxels], axis=1) for label in labels]


def level(label, rng):
    return label + rng.normal(0, 0.5, SAMPLES)


def vibration(label, rng):
    return (1 + label) * np.sin(np.arange(SAMPLES) * 0.9 + rng.uniform(0, 6)) + rng.normal(0, 0.1, SAMPLES)


def pace(label, rng):
    """Of one deviation in all classes; only how fast it changes tells them apart."""
    return np.sin(np.arange(SAMPLES) * 0.2 * (1 + label) + rng.uniform(0, 6)) + rng.normal(0, 0.05, SAMPLES)


def noise(label, rng):
    return rng.normal(0, 1, SAMPLES)


def still(label, rng):
    return np.full(SAMPLES, 7.0)


def fitted(excerpts, labels=LABELS, baseline: Baseline = "start"):
    names = tuple(f"t{index}" for index in range(excerpts[0].shape[1]))
    table = pd.DataFrame({"label": [f"class {label}" for label in labels]})
    recorded = Recordings(excerpts, 100.0, "count", table, names, "made")
    return spread_of(recorded, excerpts, highest_of(recorded)).scaling(baseline)


@pytest.mark.parametrize("taxel", [level, vibration, pace])
@pytest.mark.parametrize("small", [1e-4, 1e-2, 0.04])
def test_a_small_taxel_that_tells_classes_apart_is_scaled_by_its_own_deviation(taxel, small):
    excerpts = [signal * [1.0, small] for signal in touches(level, taxel)]
    found = fitted(excerpts)
    deviation = np.concatenate(excerpts)[:, 1].std()
    assert found.scale[1] == pytest.approx(deviation, rel=1e-5)
    assert found.small == ("t1",)
    assert found.noise == ()


@given(st.floats(1e-3, 1e3))
@examples(20)
def test_the_unit_of_a_taxel_does_not_matter(factor):
    excerpts = touches(level, vibration, pace)
    other = [signal * [1.0, factor, 1.0] for signal in excerpts]
    plain, changed = fitted(excerpts), fitted(other)
    assert changed.scale[1] == pytest.approx(factor * plain.scale[1], rel=1e-5)
    assert changed.scale[::2] == pytest.approx(plain.scale[::2], rel=1e-5)


@pytest.mark.parametrize("taxel", [noise, still])
def test_noise_beside_a_live_taxel_stays_small(taxel):
    excerpts = [signal * [1.0, 0.01] for signal in touches(level, taxel)]
    found = fitted(excerpts)
    assert found.scale[1] == pytest.approx(QUIET * found.scale[0], rel=1e-5)
    assert found.noise == ("t1",)
    assert found.small == ()


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.sampled_from([0.0, 1e-4, 0.05, 1.0]), st.floats(-1e3, 1e3))
def test_what_is_taken_of_excerpts_one_by_one_is_that_of_all(seed, n_taxels, small, zero):
    rng = np.random.default_rng(seed)
    size, own = np.array([*[1.0] * n_taxels, small]), rng.normal(0, 1, (TRIALS, n_taxels + 1))
    excerpts = [
        zero + size * rng.normal(level, 1, (n, level.size))
        for n, level in zip(rng.integers(2, 40, TRIALS), own, strict=True)
    ]
    excerpts = [signal.astype(np.float32) for signal in excerpts]
    names, labels = [f"t{index}" for index in range(n_taxels + 1)], np.arange(TRIALS) % 2
    recorded = Recordings(excerpts, 100.0, "count", pd.DataFrame({"label": labels.astype(str)}), tuple(names))
    spread, every = spread_of(recorded, excerpts, highest_of(recorded)), np.concatenate(excerpts).astype(np.float64)
    deviation = every.std(axis=0)
    still = np.abs(every - every.mean(axis=0)).max(axis=0) <= scaling.ROUNDING * np.abs(every).max(axis=0)
    quiet = still | (deviation < QUIET * deviation[~still].max())
    told = tells_classes(excerpts, labels)
    assert spread.mean == pytest.approx(every.mean(axis=0), abs=1e-9)
    assert (spread.noise.tolist(), spread.small.tolist()) == ((quiet & ~told).tolist(), (quiet & told).tolist())
    assert spread.scale == pytest.approx(np.where(spread.noise, QUIET * deviation.max(), deviation), rel=1e-9)


def test_it_is_the_classes_that_count_and_not_the_shape():
    excerpts = [signal * [1.0, 0.01] for signal in touches(level, vibration)]
    shuffled = np.random.default_rng(1).permutation(LABELS)
    assert fitted(excerpts, shuffled).noise == ("t1",)


def test_a_taxel_of_a_tenth_or_more_is_not_quiet():
    excerpts = [signal * [1.0, 0.5] for signal in touches(level, noise)]
    found = fitted(excerpts)
    assert found.noise == found.small == ()
    assert found.scale[1] == pytest.approx(np.concatenate(excerpts)[:, 1].std(), rel=1e-5)


def test_noise_is_rarely_taken_for_a_taxel():
    """At most `CHANCE`, over many taxels of noise."""
    told = tells_classes(touches(*[noise] * 1000), LABELS)
    assert told.mean() <= 2 * scaling.CHANCE


def test_a_slight_difference_is_no_reason_however_sure_it_is():
    labels = np.repeat([0, 1], 600)
    slight = touches(lambda label, rng: 0.04 * label + rng.normal(0, 1, SAMPLES), labels=labels)
    assert not tells_classes(slight, labels).any()
    clear = touches(lambda label, rng: 0.4 * label + rng.normal(0, 1, SAMPLES), labels=labels)
    assert tells_classes(clear, labels).all()


def test_one_trial_per_class_tells_nothing():
    labels = np.arange(CLASSES)
    assert not tells_classes(touches(level, vibration, labels=labels), labels).any()


def test_without_a_baseline_rest_lies_below_the_level_of_every_taxel_but_noise():
    excerpts = [signal * [1.0, 0.01, 0.01] + 5.0 for signal in touches(level, vibration, noise)]
    found = fitted(excerpts, baseline="none")
    mean = np.concatenate(excerpts).mean(axis=0)
    assert found.offset is not None
    below = (mean - np.array(found.offset)) / np.array(found.scale)
    assert below == pytest.approx([scaling.REST_SD, scaling.REST_SD, 0.0], abs=1e-3)


def test_trials_that_never_move_are_refused():
    with pytest.raises(InputError, match="made: the conditioned training trials are constant"):
        fitted(touches(still, still))


@pytest.mark.parametrize("sign", [-1, 1])
def test_one_sample_to_either_side_is_no_constant(sign):
    excerpts = [np.full((SAMPLES, 1), 1000.0) for _ in LABELS]
    excerpts[3][7] += sign * 0.1
    assert fitted(excerpts).scale[0] > 0
