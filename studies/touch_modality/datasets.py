"""Datasets A, B and C of the touch-modality paper (Sec. IV-A): the same touches, organised for three kinds of network.

A, which `touches.touches_of` cuts, is 2 s of touch, `(pattern, 6144, 16)`; B is A as images for convolutions,
`(pattern, 24, 64, 64)`; C is A averaged over N overlapping windows, `(pattern, N, 16)`, for recurrent networks.
"""

from typing import Literal

import numpy as np

from neurotact.errors import InputError

TOUCH_SAMPLES = 6144
"""Samples of a pattern of Dataset A: about 2 s of touch, and a multiple of an image of B."""
STEP_COUNTS = (8, 10, 16, 20, 50, 100, 200, 256)
"""N of Dataset C."""
ARRAY_SIDE = 4
IMAGE_SIDE = 64

WindowRule = Literal["overlap", "printed"]


def dataset_b(patterns: np.ndarray) -> np.ndarray:
    """Images `(pattern, image, 64, 64)` of patterns `(pattern, time, 16)`, 256 frames per image.

    Each 4 x 4 frame becomes a block of the image; blocks follow one another as a convolution's filter slides, along
    a row of blocks and then down, so that time runs in the order in which features are computed.

    Raises InputError for patterns whose length is not a multiple of 256 or that do not have 16 channels.

    >>> frames = np.arange(256)[None, :, None] * np.ones(16)
    >>> image = dataset_b(frames)[0, 0]
    >>> image[0, :12].tolist(), image[4, 0]
    ([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0], np.float64(16.0))
    """
    blocks = IMAGE_SIDE // ARRAY_SIDE
    n_patterns, n_samples, n_channels = patterns.shape
    if n_channels != ARRAY_SIDE**2 or n_samples % blocks**2:
        raise InputError(
            f"dataset B: patterns of {n_samples} samples and {n_channels} channels do not fill images; "
            f"give a multiple of {blocks**2} samples of {ARRAY_SIDE**2} channels"
        )
    framed = patterns.reshape(n_patterns, -1, blocks, blocks, ARRAY_SIDE, ARRAY_SIDE)
    return framed.transpose(0, 1, 2, 4, 3, 5).reshape(n_patterns, -1, IMAGE_SIDE, IMAGE_SIDE)


def window_bounds(n_samples: int, n_steps: int, rule: WindowRule = "overlap") -> np.ndarray:
    """First and one past the last sample of each of `n_steps` windows, `(step, 2)`.

    rule `overlap`: windows of 2 floor(K/N) samples, a hop of floor(K/N) apart, the last to the end: 50 % overlap over
        the whole pattern of K samples, as the authors' public code has for N = 20.
    rule `printed`: Algorithm 1 exactly as printed in the paper: its slot is K/N and its hop slot/2 (both rounded down
        here), bounds are inclusive, and the last window contains the rest, more than half of the pattern.

    Raises InputError when a window or a hop would have no samples.

    >>> window_bounds(12, 3).tolist()
    [[0, 8], [4, 12], [8, 12]]
    >>> window_bounds(12, 3, "printed").tolist()
    [[0, 5], [2, 7], [4, 12]]
    """
    slot = n_samples // n_steps if n_steps > 0 else 0
    hop, length = (slot, 2 * slot) if rule == "overlap" else (slot // 2, slot + 1)
    if hop < 1:
        raise InputError(f"dataset C: {n_samples} samples are too few for {n_steps} windows; choose fewer windows")
    start = hop * np.arange(n_steps)
    bounds = np.stack([start, np.minimum(start + length, n_samples)], axis=1)
    bounds[-1, 1] = n_samples
    return bounds


def dataset_c(patterns: np.ndarray, n_steps: int, rule: WindowRule = "overlap") -> np.ndarray:
    """The mean of each window of `window_bounds`, `(pattern, n_steps, channel)` float32.

    >>> ramp = np.arange(12.0)[None, :, None]
    >>> dataset_c(ramp, 3).ravel().tolist()
    [3.5, 7.5, 9.5]
    """
    bounds = window_bounds(patterns.shape[1], n_steps, rule)
    means = [patterns[:, first:stop].mean(axis=1, dtype=np.float64) for first, stop in bounds]
    return np.stack(means, axis=1).astype(np.float32)
