"""Features of signals and spikes that classifiers without a memory receive: sums and means in time bins, spectra."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from neurotact.metrics.flops import Cost, Layer, passed, with_weights


def bin_edges(n_samples: int, n_bins: int) -> np.ndarray:
    """The ends of `n_bins` time bins, as equal as whole samples allow, `(bin + 1,)`; each bin holds a sample.

    >>> bin_edges(5, 2).tolist()
    [0, 2, 5]
    """
    return np.linspace(0, n_samples, n_bins + 1).round().astype(int)


def averaged(pieces: Iterable[np.ndarray], n_bins: int, dtype: DTypeLike = np.float64) -> np.ndarray:
    """Means of each piece `(sample, taxel)` in time bins, `(window, bin, taxel)`; no piece is shorter than the bins.

    dtype: of the means; samples of float32 in bins of one sample each are exact in it.

    >>> averaged(np.arange(5.0).reshape(1, 5, 1), 2).ravel().tolist()
    [0.5, 3.0]
    """
    pieces = list(pieces)
    means = np.empty((len(pieces), n_bins, pieces[0].shape[1]), dtype)
    for piece, mean in zip(pieces, means, strict=True):
        edges = bin_edges(len(piece), n_bins)
        mean[:] = np.add.reduceat(piece, edges[:-1], axis=0, dtype=np.float64) / np.diff(edges)[:, None]
    return means


def counted(rasters: np.ndarray, n_bins: int) -> np.ndarray:
    """Spikes of rasters `(window, time, afferent)` in time bins, `(window, bin, afferent)`.

    >>> counted(np.array([[[1], [1], [0], [1], [1]]], np.uint8), 2).ravel().tolist()
    [2, 2]
    """
    return np.add.reduceat(rasters, bin_edges(rasters.shape[1], n_bins)[:-1], axis=1, dtype=np.int64)


def band_powers(piece: np.ndarray, n_bands: int) -> np.ndarray:
    """The logarithm of the power of each taxel in bands of frequency, `(band, taxel)`.

    piece: `(sample, taxel)`. The mean is removed; a Hann window; bands are about as wide in octaves, from the lowest
    frequency of the window to half of the sampling rate, and each has at least one frequency: at most half as many
    bands as samples.

    >>> time = np.arange(64)[:, None]
    >>> [int(band_powers(np.sin(2 * np.pi * time / period), 4).argmax()) for period in (32, 4)]
    [1, 3]
    """
    window = np.hanning(len(piece) + 2)[1:-1, None]
    lines = np.abs(np.fft.rfft((piece - piece.mean(axis=0)) * window, axis=0)[1:]) ** 2
    edges = np.geomspace(1, len(lines) + 1, n_bands + 1).round().astype(int) - 1
    edges = np.maximum(edges, np.arange(n_bands + 1))
    edges = np.minimum(edges, len(lines) - np.arange(n_bands, -1, -1))
    return np.log(np.add.reduceat(lines, edges[:-1], axis=0) / np.diff(edges)[:, None] + np.finfo(float).tiny)


@dataclass(frozen=True)
class BandPowers(Layer):
    """The logarithm of a signal's power in bands of frequency: a window, a real FFT, squares, sums.

    A real FFT of n samples takes n log2(n) multiplications and 1.5 n log2(n) additions (radix 2, half of the complex
    transform); the window is a multiplication per sample.

    >>> BandPowers(samples=256, bands=8, channels=2).cost().macs
    512.0
    """

    samples: int
    bands: int
    channels: int = 1

    def cost(self) -> Cost:
        n, transform = self.samples, self.samples * math.log2(max(2, self.samples))
        operations = {"macs": float(n), "acs": 1.5 * transform + n, "multiplications": transform + n}
        moved = {"states_accesses": 3 * n + 2 * transform, **passed(0, self.bands)}  # window, stages, squares
        one = Cost(**operations, exponentials=self.bands, **moved)
        return one.times(self.channels) + with_weights(0, self.channels * n)
