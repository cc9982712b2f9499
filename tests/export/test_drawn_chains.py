"""Chains of several features at once run alike: the whole trial, a stream of either kind, and C or its refusal."""

import random

import numpy as np
import pytest
import torch
from compiled import chosen, compare_on
from drawn_chains import by_hand, draw_chain, draw_network, draw_rule
from hypothesis import example, given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_signal, offline, told
from neurotact_parts.exporters.c import proof
from neurotact_parts.streams.stream import Stream

from neurotact.backend import native
from neurotact.networks.definition.executors import lacking
from neurotact.networks.use.measuring import synops_of

BACKENDS = ["reference", *(["native"] if native else [])]
SEEDS = st.integers(0, 10_000)


def signal_for(chain, seed):
    n_samples = int(150 * chain.sampling_rate_Hz / chain.clock_Hz)
    return make_signal(n_samples, chain.n_taxels, seed=seed)


@given(SEEDS)
@examples(40)
def test_operations_until_a_decision_are_those_counted_synapse_by_synapse(seed):
    rng = random.Random(seed)
    network = draw_network(rng, rng.choice([1, 3, 7]), 1000.0)
    spikes = (np.random.default_rng(seed).random((3, rng.choice([7, 40]), network.n_inputs)) < 0.3).astype(np.uint8)
    decided = network.infer(torch.from_numpy(spikes), draw_rule(rng, network))
    counted = synops_of(decided, network)
    expected = by_hand(network, torch.from_numpy(spikes), decided.steps)
    assert np.stack(counted[:3], axis=1).tolist() == expected
    assert counted.total.tolist() == [sum(each) for each in expected]


@given(SEEDS)
@example(9857)  # pruned, with a path past the hidden layer
@examples(60)
def test_a_stream_of_a_drawn_chain_decides_as_the_whole_trial(seed):
    chain = draw_chain(seed)
    signal = signal_for(chain, seed)
    raster, expected = offline(chain, signal)
    expected = [(start, 0 if chain.tells_numbers else label, *rest) for start, label, *rest in expected]
    fits = chain.windows.starts(raster).tolist()
    windows = torch.from_numpy(np.stack([raster[i : i + chain.windows.length] for i in fits] or [raster[:1]]))
    decided = chain.network.infer(windows, chain.rule)
    spent = [sum(each) for each in by_hand(chain.network, windows, decided.steps)][: len(fits)]
    for backend in BACKENDS if Stream(chain)._compiled is not None else ["auto"]:
        found = sorted(Stream(chain, backend=backend).decide(np.array_split(signal, 1 + seed % 5)), key=by_window)
        found = [each for each in found if each.start_step + chain.windows.length <= len(raster)]
        assert told(found) == expected
        assert [each.sops for each in found] == spent
        if chain.tells_numbers:
            values = [[*(each.values or {}).values()] for each in found]
            np.testing.assert_allclose(values, decided.readout[: len(fits)].tolist(), rtol=1e-9, atol=1e-9)


def by_window(decision):
    return decision.window


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("integer", [False, True])
def test_c_of_a_drawn_chain_spikes_as_its_twin(seed, integer, tmp_path):
    if proof.missing("cc"):
        pytest.skip("there is no C compiler")
    chain = draw_chain(seed)
    if lacking("c-integer" if integer else "c-float", chain.subject):
        return  # refusals are tested in tests/export/test_executors.py
    signals = [signal_for(chain, seed + k) for k in range(2)]
    formats = chosen(chain, signals) if integer else None
    assert compare_on(signals, chain, tmp_path / "c", formats, flags=("-O0",))[0] is None
