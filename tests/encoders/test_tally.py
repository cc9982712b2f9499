"""Spikes that are tallied while they are computed are those of the raster, whatever their encoder."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data import conditioning
from neurotact.data.spool import Spool
from neurotact.encoders import tally
from neurotact.encoders.specs import afferent_names, encode, load
from neurotact.encoders.tally import Asked, Group, Groups
from neurotact.metrics.isi_distributions import MOST_PAIRS, bin_edges, separation
from neurotact.metrics.spike_trains import events_of_raster, isis_ms, spike_counts

SPECS = {
    "clock": ("sa1-ra1-lif", 1000.0, {"sa1.t_ref_ms": 3.0}),
    "exact": ("sa1-ra1-lif", 200.0, {"integration": "exact", "conditioning.resample_Hz": 1000.0, "ra1.t_ref_ms": 4.0}),
    "no whole number of steps": ("sa1-ra1-lif", 93.0, {"integration": "exact", "conditioning.resample_Hz": 1000.0}),
    "both polarities": ("sa1-ra1-lif", 1000.0, {"sa1.opposite": True}),
    "grades in closed form": (
        "sa1-ra1-lif",
        200.0,
        {"integration": "exact", "conditioning.resample_Hz": 1000.0, "sa1.opposite": True, "sa1.grades": [0.5, 1.0]},
    ),
    "onsets": ("sa1-ra1-lif", 1000.0, {"sa1.rate_ms": 2.0}),
    "ON and OFF": ("send-on-delta", 1000.0, {}),
}


@pytest.mark.parametrize("how", SPECS)
@given(st.integers(1, 6), st.integers(1, 11), st.integers(0, 2**32 - 1))
def test_a_tally_is_that_of_the_spikes_of_each_trial_to_its_end(how, n_trials, n_taxels, seed):
    name, rate_Hz, given_ = SPECS[how]
    spec, rng = load(name, given_), np.random.default_rng(seed)
    signals = [rng.normal(2, 4, (n, n_taxels)).astype(np.float32) for n in rng.integers(2, 60, n_trials)]
    n_afferents, edges = len(afferent_names([""] * n_taxels, spec.model_dump())), bin_edges(2, 40)
    n_first = n_afferents - n_taxels
    asked = [Asked("sa1", 0, n_first, edges, 5), Asked("ra1", n_first, n_afferents, edges, 2)]
    group = Group(signals)
    raster, _ = encode(group.signal, rate_Hz, spec)
    per_sample = spec.conditioning.clock_Hz(rate_Hz) / rate_Hz
    for trial, signal in enumerate(signals):
        raster[trial, int(np.ceil(len(signal) * per_sample)) :] = 0
    for backend in ("auto", "reference"):
        for one, found in zip(asked, group.tallies(spec, rate_Hz, asked, backend), strict=True):
            spikes = events_of_raster(raster[..., one.first : one.last])
            isi = isis_ms(spikes, 1e3)
            steps = isi.isi_ms.astype(int)
            assert found.counts.tolist() == spike_counts(spikes).tolist()
            assert found.at_floor.tolist() == np.bincount(isi.trial[steps <= one.floor], minlength=n_trials).tolist()
            bins = np.histogram(np.clip(steps, edges[0], edges[-1] - 0.1), edges)[0]
            assert found.intervals.sum(axis=(0, 1)).tolist() == [*bins, 0]


def test_signals_that_do_not_fit_in_memory_are_read_anew_in_the_same_groups():
    signals = Spool(np.full((n, 2), n, np.float32) for n in (3, 30, 4, 5, 50))
    with patch.object(conditioning, "PIECE_VALUES", 40), patch.object(tally, "HELD_PIECES", 100):
        groups = Groups(signals, 1.0)
        assert all(one is other for one, other in zip(groups, groups, strict=True))
        held = [group.n_samples.tolist() for group in groups]
        assert [signal.tolist() for signal in groups.signals] == [signal.tolist() for signal in signals]
        with patch.object(tally, "HELD_PIECES", 0):
            anew = Groups(signals, 1.0)
            assert next(iter(anew)) is not next(iter(anew))
            assert anew.signals is signals
            assert [[group.n_samples.tolist() for group in anew] for _ in range(2)] == [held, held]
    assert held == [[3], [30], [4, 5], [50]]


def _of_all_pairs(shares: np.ndarray, labellings: list[np.ndarray]) -> float:
    """The definition of `separation`, a pair of classes after the other."""

    def entropy(p: np.ndarray) -> np.ndarray:
        return -(p * np.log2(np.where(p > 0, p, 1))).sum(axis=-1)

    def divergence(labels: np.ndarray) -> float:
        means = [shares[labels == label].mean(axis=0) for label in np.unique(labellings[0])]
        pairs = [(p, q) for k, p in enumerate(means) for q in means[k + 1 :]]
        return float(np.mean([entropy((p + q) / 2) - (entropy(p) + entropy(q)) / 2 for p, q in pairs]))

    true, *shuffled = map(divergence, labellings)
    return true - float(np.mean(shuffled))


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("n_classes", [2, 7, 27])
def test_the_separation_is_the_mean_divergence_of_all_pairs_less_that_by_chance(n_classes, compiled):
    rng = np.random.default_rng(n_classes)
    labels = np.repeat(np.arange(n_classes), 3)
    shares = rng.dirichlet(np.full(5, 0.3), (len(labels), 4))
    labellings = [labels, *(rng.permutation(labels) for _ in range(3))]
    with patch("neurotact.metrics.isi_distributions.native", tally.native.native if compiled else None):
        assert separation(shares, labellings) == pytest.approx(_of_all_pairs(shares, labellings), abs=1e-12)


def test_the_chance_of_many_classes_is_that_of_a_part_of_their_pairs():
    rng, n_classes = np.random.default_rng(0), 60
    labels = np.repeat(np.arange(n_classes), 4)
    assert n_classes * (n_classes - 1) / 2 > 4 * MOST_PAIRS
    shares = rng.dirichlet(np.full(8, 0.5), (len(labels), 4)) + 0.3 * (labels[:, None, None] % 7 == np.arange(8))
    shares /= shares.sum(axis=-1, keepdims=True)
    labellings = [labels, *(rng.permutation(labels) for _ in range(8))]
    assert separation(shares, labellings) == pytest.approx(_of_all_pairs(shares, labellings), rel=0.01)
