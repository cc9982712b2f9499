"""AR, MAX, H1 and H2 by hand, and the law that streaming equals batch."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.compliance.curve_features import (
    COMBINATIONS,
    FEATURES,
    curve_features,
    finish,
    instants,
    select_features,
    start,
    step,
)

from neurotact.errors import InputError


def test_features_of_a_known_curve_by_hand():
    # It turns at sample 6, so H1 is sample 4 and H2 sample 8. Its largest value comes later than the turn.
    curve = np.array([0, 1, 2, 3, 5, 7, 8, 9, 4, 3, 2, 1, 0.0])[:, None]
    features = dict(zip(FEATURES, curve_features(curve, peak=6, sampling_rate_Hz=10.0)[0], strict=True))
    assert features == {"AR": pytest.approx(45 / 10), "MAX": 8.0, "H1": 5.0, "H2": 4.0}


def streamed(curve, peak, rate_Hz):
    state = start(curve.shape[1])
    for values in curve:
        state = step(state, values, instants(peak))
    return finish(state, rate_Hz)


@examples(50)
@given(st.integers(0, 2**32), st.integers(2, 30), st.integers(1, 5), st.sampled_from([1.0, 485.0]))
def test_streaming_equals_batch_bit_for_bit(seed, peak, n_channels, rate_Hz):
    rng = np.random.default_rng(seed)
    n_samples = instants(peak).h2 + 1 + int(rng.integers(0, 20))
    curve = rng.normal(0, 10.0 ** rng.integers(-3, 8), (n_samples, n_channels)).astype(rng.choice(["f4", "f8"]))
    batch = curve_features(curve, peak, rate_Hz)
    np.testing.assert_array_equal(batch, streamed(curve, peak, rate_Hz))
    np.testing.assert_array_equal(batch, curve_features(curve[None], peak, rate_Hz)[0])


@given(st.integers(2, 10_000))
def test_instants_are_two_and_four_thirds_of_the_time_to_the_turn(peak):
    when = instants(peak)
    assert abs(when.h1 - 2 * peak / 3) <= 0.5
    assert abs(when.h2 - 4 * peak / 3) <= 0.5
    assert when.h1 < when.maximum < when.h2


@given(st.integers(2, 40))
def test_without_hysteresis_h1_equals_h2(third):
    peak = 3 * third
    curve = (peak - np.abs(np.arange(2 * peak + 1) - peak))[:, None]
    features = curve_features(curve, peak, 1.0)[0]
    assert features[FEATURES.index("H1")] == features[FEATURES.index("H2")]
    assert features[FEATURES.index("AR")] == peak**2


def test_combinations_are_those_of_table_2():
    assert list(COMBINATIONS) == [f"d{i}" for i in range(1, 16)]
    assert COMBINATIONS["d5"] == ("AR", "MAX")
    assert COMBINATIONS["d8"] == ("MAX", "H1")
    assert COMBINATIONS["d11"] == ("AR", "MAX", "H1")
    assert COMBINATIONS["d13"] == ("AR", "H1", "H2")
    assert COMBINATIONS["d15"] == FEATURES
    assert len(set(COMBINATIONS.values())) == 15  # every subset of the four but the empty one, once


def test_selected_features_stand_channel_by_channel():
    features = np.arange(2 * 3 * 4).reshape(2, 3, 4)
    chosen = select_features(features, "d9")
    assert chosen.tolist()[0] == [1, 3, 5, 7, 9, 11]
    with pytest.raises(InputError, match="not in Table 2"):
        select_features(features, "d16")


def test_refuses_curves_that_end_early():
    with pytest.raises(InputError, match="ends before H2"):
        curve_features(np.zeros((8, 2)), peak=6, sampling_rate_Hz=1.0)
    with pytest.raises(InputError, match="end before H2"):
        streamed(np.zeros((8, 2)), 6, 1.0)
    with pytest.raises(InputError, match="at least 2"):
        instants(1)
