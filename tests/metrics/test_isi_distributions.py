"""Bins of inter-spike intervals cover what they promise, and an overlap is one of distributions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.texture.firing import histograms, overlap

from neurotact.errors import InputError
from neurotact.metrics.isi_distributions import bin_edges

some_counts = st.lists(st.lists(st.integers(0, 20), min_size=4, max_size=4), min_size=2, max_size=5).map(np.array)


@given(st.integers(1, 200), st.integers(1, 5000))
def test_bins_cover_every_interval_and_none_is_narrower_than_a_step(shortest, longest):
    edges = bin_edges(shortest, longest)
    assert edges[0] == shortest - 0.5
    assert edges[-1] >= max(longest, shortest + 1) - 0.5
    assert (np.diff(edges) >= 1).all()
    assert (np.diff(edges) == np.round(np.diff(edges))).all()


@given(st.lists(st.tuples(st.integers(1, 400), st.integers(0, 2)), max_size=60))
def test_every_interval_is_counted_once_in_its_bin(found):
    isi, group = np.array([f[0] for f in found], int), np.array([f[1] for f in found], int)
    edges = bin_edges(1, 100)
    counts = histograms(isi, group, 3, edges)
    assert counts.sum(axis=1).tolist() == [(group == g).sum() for g in range(3)]
    for g in range(3):
        mine = np.minimum(isi[group == g], edges[-1] - 0.1)  # longer ones are counted in the last bin
        assert counts[g].tolist() == np.histogram(mine, edges)[0].tolist()


def test_an_interval_below_the_bins_is_refused():
    with pytest.raises(InputError, match="2 is below the first edge"):
        histograms(np.array([2, 9]), np.array([0, 0]), 1, bin_edges(5, 20))


@given(some_counts)
def test_an_overlap_is_a_share_that_neither_order_nor_numbers_of_intervals_change(counts):
    found = overlap(counts)
    if (counts.sum(axis=1) > 0).sum() < 2:
        assert np.isnan(found)
        return
    assert 0 <= found <= 1 + 1e-12
    assert overlap(counts[::-1]) == pytest.approx(found)
    assert overlap(7 * counts) == pytest.approx(found)


def test_equal_distributions_overlap_wholly_and_disjoint_ones_not_at_all():
    assert overlap(np.array([[1, 3, 0], [2, 6, 0]])) == 1.0
    assert overlap(np.array([[1, 3, 0], [0, 0, 5]])) == 0.0
    assert overlap(np.array([[1, 0], [1, 0], [0, 1]])) == pytest.approx(1 / 3)  # of three pairs one is equal
