"""van Rossum and Victor-Purpura distances: by hand, by plain loops, by their laws, and beside Elephant."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.texture import spike_distances
from neurotact_parts.studies.texture.spike_distances import van_rossum, victor_purpura

from neurotact.errors import InputError
from neurotact.metrics.spike_trains import events, events_of_raster

RATE_HZ = 2000.0
BOTH = {
    "van Rossum": partial(van_rossum, sampling_rate_Hz=RATE_HZ, tau_ms=5.0),
    "Victor-Purpura": partial(victor_purpura, sampling_rate_Hz=RATE_HZ, shift_cost_per_s=150.0),
}
each_distance = pytest.mark.parametrize("distance", BOTH.values(), ids=BOTH.keys())


@st.composite
def rasters(draw, n_afferents: int | None = None) -> np.ndarray:
    afferents = st.integers(1, 3) if n_afferents is None else st.just(n_afferents)
    shape = draw(st.tuples(st.integers(1, 6), st.integers(1, 40), afferents))
    density = draw(st.floats(0, 0.6))
    return (np.random.default_rng(draw(st.integers(0, 2**32))).random(shape) < density).astype(np.uint8)


def edit_cost(a: np.ndarray, b: np.ndarray, cost: float) -> float:
    """Victor and Purpura's recursion, spike by spike; times in seconds."""
    table = np.add.outer(np.arange(len(a) + 1.0), np.arange(len(b) + 1.0))
    for i in range(len(a)):
        for j in range(len(b)):
            shift = table[i, j] + cost * abs(a[i] - b[j])
            table[i + 1, j + 1] = min(table[i, j + 1] + 1, table[i + 1, j] + 1, shift)
    return table[-1, -1]


def integrated(a: np.ndarray, b: np.ndarray, tau_s: float) -> float:
    """Van Rossum's squared distance by a fine sum over time, scaled so that a lone spike is at 1."""
    dt = 1e-5
    t = np.arange(0, 0.04 + 12 * tau_s, dt)
    traces = [sum((np.exp(-(t - s) / tau_s) * (t >= s) for s in train), np.zeros_like(t)) for train in (a, b)]
    return 2 / tau_s * ((traces[0] - traces[1]) ** 2).sum() * dt


def trains(raster: np.ndarray) -> list[list[np.ndarray]]:
    return [[np.flatnonzero(train) / RATE_HZ for train in trial.T] for trial in raster]


@given(rasters())
@examples(30)
def test_victor_purpura_is_the_least_cost_of_every_pair(raster):
    found = BOTH["Victor-Purpura"](raster)
    for i, mine in enumerate(trains(raster)):
        for j, its in enumerate(trains(raster)):
            expected = sum(edit_cost(a, b, 150.0) for a, b in zip(mine, its, strict=True))
            assert found[i, j] == pytest.approx(expected, abs=1e-9)


def test_van_rossum_is_the_integral():
    raster = (np.random.default_rng(1).random((3, 60, 2)) < 0.1).astype(np.uint8)
    found = BOTH["van Rossum"](raster)
    for i, mine in enumerate(trains(raster)):
        for j, its in enumerate(trains(raster)):
            expected = sum(integrated(a, b, 5e-3) for a, b in zip(mine, its, strict=True))
            assert found[i, j] ** 2 == pytest.approx(expected, rel=0.02, abs=1e-9)


def test_by_hand():
    # One spike at 1 ms, one at 2 ms, none; tau = 5 ms; a shift of 1 ms costs 0.15.
    raster = np.zeros((3, 10, 1), np.uint8)
    raster[0, 2] = raster[1, 4] = 1
    moved = np.sqrt(2 * (1 - np.exp(-1 / 5)))
    np.testing.assert_allclose(BOTH["van Rossum"](raster), [[0, moved, 1], [moved, 0, 1], [1, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(BOTH["Victor-Purpura"](raster), [[0, 0.15, 1], [0.15, 0, 1], [1, 1, 0]], atol=1e-12)


@each_distance
@given(raster=rasters())
@examples(30)
def test_a_distance_is_a_metric(distance, raster):
    found = distance(raster)
    np.testing.assert_allclose(found, found.T, atol=1e-9)
    assert (np.diag(found) == 0).all()
    assert (found[:, :, None] <= found[:, None, :] + found.T[None, :, :] + 1e-7).all()
    alike = (raster[:, None] == raster[None, :]).all(axis=(2, 3))
    assert np.array_equal(found < 1e-6, alike)


@each_distance
@given(data=st.data())
@examples(30)
def test_some_against_others_are_a_part_of_all_against_all(distance, data):
    raster = data.draw(rasters())
    cut = data.draw(st.integers(0, len(raster)))
    every = distance(raster)
    np.testing.assert_allclose(distance(raster[:cut], others=raster[cut:]), every[:cut, cut:], atol=1e-6)
    np.testing.assert_array_equal(distance(events_of_raster(raster)), every)


def test_blocks_do_not_show(monkeypatch):
    raster = (np.random.default_rng(0).random((9, 50, 3)) < 0.2).astype(np.uint8)
    whole = BOTH["Victor-Purpura"](raster)
    monkeypatch.setattr(spike_distances, "ROWS", 2)
    monkeypatch.setattr(spike_distances, "COLUMNS", 3)
    np.testing.assert_array_equal(BOTH["Victor-Purpura"](raster), whole)


def test_the_limits_of_the_costs():
    raster = (np.random.default_rng(0).random((6, 60, 2)) < 0.2).astype(np.uint8)
    counts = raster.sum(axis=1, dtype=int)
    # Free shifts leave the difference of counts; dear ones delete all that do not coincide.
    free = victor_purpura(raster, RATE_HZ, shift_cost_per_s=0.0)
    np.testing.assert_allclose(free, abs(counts[:, None] - counts[None, :]).sum(axis=2))
    dear = victor_purpura(raster, RATE_HZ, shift_cost_per_s=1e9)
    np.testing.assert_allclose(dear, (raster[:, None] != raster[None, :]).sum(axis=(2, 3)))
    # So does a short time constant, whose distance is the root of that number; a long one compares counts.
    short = van_rossum(raster, RATE_HZ, tau_ms=1e-3)
    np.testing.assert_allclose(short**2, (raster[:, None] != raster[None, :]).sum(axis=(2, 3)), atol=1e-9)
    long = van_rossum(raster, RATE_HZ, tau_ms=1e9)
    np.testing.assert_allclose(long**2, ((counts[:, None] - counts[None, :]) ** 2).sum(axis=2), atol=1e-3)


@pytest.mark.parametrize("density", [0.01, 0.05])
def test_the_distances_are_those_of_elephant(density):
    dissimilarity = pytest.importorskip("elephant.spike_train_dissimilarity")
    neo, pq = pytest.importorskip("neo"), pytest.importorskip("quantities")
    raster = (np.random.default_rng(2).random((12, 300, 1)) < density).astype(np.uint8)
    raster[3] = 0
    theirs = [neo.SpikeTrain(np.flatnonzero(r[:, 0]) / RATE_HZ * pq.s, t_stop=0.15 * pq.s) for r in raster]
    for tau_ms in (1.0, 10.0, 100.0):
        mine = van_rossum(raster, RATE_HZ, tau_ms=tau_ms)
        np.testing.assert_allclose(mine, dissimilarity.van_rossum_distance(theirs, tau_ms * pq.ms), atol=1e-6)
    for cost in (5.0, 50.0, 500.0):
        mine = victor_purpura(raster, RATE_HZ, shift_cost_per_s=cost)
        np.testing.assert_allclose(mine, dissimilarity.victor_purpura_distance(theirs, cost / pq.s), atol=1e-9)


@pytest.mark.filterwarnings("ignore:The 'copy' argument")  # Elephant's, to a library of its own
def test_the_statistics_are_those_of_elephant():
    statistics = pytest.importorskip("elephant.statistics")
    pq, neo = pytest.importorskip("quantities"), pytest.importorskip("neo")
    from neurotact_parts.studies.texture.spike_features import isi_cv, isi_mean_ms

    from neurotact.metrics.spike_trains import rates_Hz

    raster = (np.random.default_rng(3).random((8, 400, 1)) < 0.04).astype(np.uint8)
    theirs = [neo.SpikeTrain(np.flatnonzero(r[:, 0]) / RATE_HZ * pq.s, t_stop=0.2 * pq.s) for r in raster]
    intervals = [statistics.isi(train) for train in theirs]
    np.testing.assert_allclose(isi_cv(raster)[:, 0], [statistics.cv(isi) for isi in intervals])
    np.testing.assert_allclose(isi_mean_ms(raster, RATE_HZ)[:, 0], [float(i.mean().rescale(pq.ms)) for i in intervals])
    rates = [float(statistics.mean_firing_rate(train).rescale(pq.Hz)) for train in theirs]
    np.testing.assert_allclose(rates_Hz(raster, RATE_HZ)[:, 0], rates)


@each_distance
def test_trials_without_spikes_or_of_other_lengths(distance):
    assert distance(np.zeros((0, 5, 2), np.uint8)).shape == (0, 0)
    assert (distance(np.zeros((2, 5, 2), np.uint8)) == 0).all()
    short = events([np.array([3])], [np.array([0])], np.array([5]), 1)
    long = events([np.array([3]), np.array([90])], [np.array([0]), np.array([0])], np.array([100, 100]), 1)
    assert distance(short, others=long)[0, 0] == pytest.approx(0.0, abs=1e-9)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(InputError, match="3 afferents, the trials 2"):
        BOTH["van Rossum"](np.zeros((1, 5, 2), np.uint8), others=np.zeros((1, 5, 3), np.uint8))
    with pytest.raises(InputError, match="tau_ms: must be > 0"):
        van_rossum(np.zeros((1, 5, 2), np.uint8), RATE_HZ, tau_ms=0.0)
    with pytest.raises(InputError, match="shift_cost_per_s: must be >= 0"):
        victor_purpura(np.zeros((1, 5, 2), np.uint8), RATE_HZ, shift_cost_per_s=-1.0)
