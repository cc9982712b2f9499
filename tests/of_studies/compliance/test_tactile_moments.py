"""Raw moments against a known image, by hand, and their laws."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.compliance.tactile_moments import NAMES, ORDERS, moment_weights

# rows x = 1, 2; columns y = 1, 2, 3
KNOWN = np.array([[1, 0, 4], [0, 2, 5]])


def raw_moments(images: np.ndarray) -> np.ndarray:
    """Those of images `(..., row, column)`, `(..., moment)`."""
    rows, columns = images.shape[-2:]
    return images.reshape(*images.shape[:-2], rows * columns) @ moment_weights(rows, columns)


def test_moments_of_a_known_image_by_hand():
    expected = {
        "M00": 1 + 4 + 2 + 5,
        "M01": 1 * 1 + 3 * 4 + 2 * 2 + 3 * 5,
        "M10": 1 * 1 + 1 * 4 + 2 * 2 + 2 * 5,
        "M02": 1 * 1 + 9 * 4 + 4 * 2 + 9 * 5,
        "M20": 1 * 1 + 1 * 4 + 4 * 2 + 4 * 5,
        "M11": 1 * 1 * 1 + 1 * 3 * 4 + 2 * 2 * 2 + 2 * 3 * 5,
    }
    assert dict(zip(NAMES, raw_moments(KNOWN).tolist(), strict=True)) == expected


def test_orders_are_those_of_the_tables():
    assert ORDERS == ((0, 0), (0, 1), (1, 0), (0, 2), (2, 0), (1, 1))
    assert all(p + q <= 2 for p, q in ORDERS)


images = st.integers(0, 2**16).map(lambda s: np.random.default_rng(s).integers(0, 4096, (3, 5, 4)))


@given(images, st.integers(-3, 3), st.integers(-3, 3))
def test_moments_are_linear_in_the_image(image, a, b):
    other = np.flip(image, axis=1)
    np.testing.assert_array_equal(raw_moments(a * image + b * other), a * raw_moments(image) + b * raw_moments(other))


@given(images)
def test_transposing_an_image_swaps_its_orders(image):
    swapped = [ORDERS.index((q, p)) for p, q in ORDERS]
    np.testing.assert_array_equal(raw_moments(np.swapaxes(image, -1, -2)), raw_moments(image)[..., swapped])


@given(images)
def test_a_shift_moves_the_centroid_by_one(image):
    shifted = np.concatenate([np.zeros_like(image[:, :1]), image], axis=1)
    before, after = raw_moments(image), raw_moments(shifted)
    m00, m10 = NAMES.index("M00"), NAMES.index("M10")
    np.testing.assert_array_equal(after[:, m10], before[:, m10] + before[:, m00])


def test_weights_go_row_by_row():
    weights = moment_weights(2, 3)
    np.testing.assert_array_equal(weights[:, NAMES.index("M10")], [1, 1, 1, 2, 2, 2])
    np.testing.assert_array_equal(weights[:, NAMES.index("M01")], [1, 2, 3, 1, 2, 3])
