"""Fixed-point words by hand, and their laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.compliance.fixed_point import FixedPoint, fit_fixed_point

from neurotact.errors import InputError


@pytest.mark.parametrize(
    ("bits", "expected"),
    [
        # full scale 1000: a code is worth 1000/255 = 3.92, 1000/4095 = 0.2442, 1000/65535 = 0.015259
        (8, [0, 1, 127, 255]),
        (12, [0, 16, 2043, 4095]),
        (16, [0, 262, 32702, 65535]),
    ],
)
def test_codes_by_hand(bits, expected):
    values = np.array([0.0, 4.0, 499.0, 1000.0])
    assert fit_fixed_point(values, bits).codes(values).tolist() == expected


def test_one_scale_serves_all_features():
    small_and_large = np.array([[1.0, 101.0], [2.0, 200.0]])
    codes = fit_fixed_point(small_and_large, 8).codes(small_and_large)
    assert codes.tolist() == [[1, 129], [3, 255]]


@given(st.integers(0, 2**32), st.sampled_from([8, 12, 16]))
def test_rounding_is_within_half_a_code_and_saturates(seed, bits):
    rng = np.random.default_rng(seed)
    training, others = rng.uniform(0, 50, 30), rng.uniform(-20, 120, 30)
    scale = fit_fixed_point(training, bits)
    worth = scale.full_scale / scale.largest
    assert np.abs(scale.codes(training) * worth - training).max() <= worth / 2 * (1 + 1e-9)
    codes = scale.codes(others)
    assert (codes == np.rint(codes)).all()
    assert (codes[others >= scale.full_scale] == scale.largest).all()
    assert (codes[others <= 0] == 0).all()


def test_refuses_a_scale_that_holds_nothing():
    with pytest.raises(InputError, match="bits: must be >= 1"):
        fit_fixed_point(np.ones(3), 0)
    with pytest.raises(InputError, match="positive, finite"):
        fit_fixed_point(np.zeros(3), 8)
    assert FixedPoint(1, 2.0).codes(np.array([0.9, 1.1])).tolist() == [0, 1]
