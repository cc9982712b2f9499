"""A pruned chain: streams and C decide and count as its network does on whole windows."""

import re

import numpy as np
import pytest
import torch
from compiled import chosen, compare
from hypothesis import given
from hypothesis import strategies as st
from levels import examples, thinned
from made_chains import ADAPTING, make_chain, make_signal, offline, told
from neurotact_parts.exporters.c import c_export, proof
from neurotact_parts.exporters.c.matrices import matrices_of
from neurotact_parts.exporters.live import scores
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.stream import Stream

from neurotact.backend import native
from neurotact.errors import InputError
from neurotact.metrics.prices import MEMORY_45NM
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.training.sparsity import prune
from neurotact.networks.use import measuring
from neurotact.networks.use.ledger import network_cost

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason=str(proof.missing("cc")))
KINDS = {
    "spiking": {"patience": 5},
    "integrator": {"readout": "integrator", "patience": 4, "windows": {"length_ms": 30, "hop_ms": 9}},
    "stretches": {"readout": "stretches", "patience": 9},
    "delayed": {"membrane": "delayed", "reset": "subtract", "recurrent_delay_steps": 1, "patience": 5},
    "immediate": {"membrane": "immediate", "reset": "hard", "readout": "integrator", "step_ms": 4.0},
    "leaky": {"readout": "leaky", "patience": 6},
    "feed-forward": {"model": "snn", "patience": 5},
    "adapting": {**ADAPTING, "patience": 5},
    "many": {"hidden": 300, "forward_weight_scale": 2.0, "n_taxels": 130},
}
BACKENDS = ["reference", *(["native"] if native else [])]


def pruned(kind: str, share: float, **changes) -> Chain:
    chain = make_chain({}, **{"hidden": 20, "n_taxels": 6, **KINDS[kind], **changes})
    prune(chain.network, share)
    return chain


@given(st.sampled_from(sorted({*KINDS} - {"many"})), st.sampled_from([0.2, 0.8]), st.sampled_from(BACKENDS))
@examples(12)
def test_a_stream_counts_what_whole_windows_do(kind, share, backend):
    chain, signal = pruned(kind, share, hidden=9), make_signal(170, 6)
    stream = Stream(chain, backend=backend)
    first = [*stream.push(signal[:70])]
    saved = stream.state()
    other = Stream(chain, backend=BACKENDS[-1])
    other.restore(saved)
    rest = [*stream.push(signal[70:])]
    assert [*other.push(signal[70:])] == rest
    raster, windows = offline(chain, signal)
    decided = sorted([*first, *rest], key=lambda each: each.window)[: len(windows)]
    assert told(decided) == windows
    cut = np.stack([raster[start : start + chain.windows.length] for start, *_ in windows])
    found = chain.network.infer(torch.from_numpy(cut), chain.rule)
    totals = measuring.synops_of(found, chain.network).total.tolist()
    assert [each.sops for each in decided] == totals
    assert any(totals)


def test_the_live_page_pays_for_what_is_left():
    chain = pruned("integrator", 0.8)
    decision = next(iter(Stream(chain).push(make_signal(170, 6))))
    dense = chain._replace(
        network=RSNN(chain.network.n_inputs, 3, hidden=20, readout="integrator", sampling_rate_Hz=1e3)
    )
    assert 0 < scores.cost_nJ(chain, decision) < scores.cost_nJ(dense, decision)


@needs_compiler
@thinned("kind", [*KINDS], every=3)
@pytest.mark.parametrize("variant", ["float", "integer"])
@pytest.mark.parametrize("share", [0.4, 0.85])
def test_c_says_and_counts_what_its_twin_does(kind, variant, share, tmp_path):
    chain = pruned(kind, share)
    signals = [make_signal(150, chain.n_taxels, seed=k) for k in range(3)]
    if variant == "integer" and (chain.network.adaptation is not None or chain.network.leaks):
        pytest.skip("not in integers")
    formats = None if variant == "float" else chosen(chain, signals, state_bits=16)
    difference, expected = compare(chain, tmp_path, formats)
    assert difference is None
    assert sum(len(one.decisions) for one in expected) > 0
    assert all(row[5] > 0 for one in expected for row in one.decisions if row[4] > 0)
    text = (tmp_path / "skin.c").read_text()
    has_rows = variant == "float" or share > 0.5
    assert (" w_in_row[" in text) == has_rows


@needs_compiler
@pytest.mark.parametrize("variant", ["float", "integer"])
@pytest.mark.parametrize("whole", ["w_in", "w_rec", "w_out"])
def test_a_dense_matrix_stands_beside_sparse_ones(variant, whole, tmp_path):
    chain = make_chain({}, hidden=20, n_taxels=6, patience=5)
    kept = getattr(chain.network, whole).detach().clone()
    prune(chain.network, 0.85)
    getattr(chain.network, whole).data.copy_(kept)
    signals = [make_signal(150, 6, seed=k) for k in range(3)]
    formats = None if variant == "float" else chosen(chain, signals, state_bits=16)
    difference, _ = compare(chain, tmp_path, formats)
    assert difference is None
    text = (tmp_path / "skin.c").read_text()
    assert {name for name in ("w_in", "w_rec", "w_out") if f" {name}_row[" in text} == {"w_in", "w_rec", "w_out"} - {
        whole
    }


@needs_compiler
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_recurrence_may_have_no_synapse_left(variant, tmp_path):
    """As where its weights begin with 0: pruning leaves them there."""
    chain = make_chain({}, hidden=20, n_taxels=6, patience=5, recurrent_weight_scale=0.0)
    prune(chain.network, 0.85)
    formats = None if variant == "float" else chosen(chain, [make_signal(150, 6)])
    difference, expected = compare(chain, tmp_path, formats)
    assert difference is None
    assert expected[0].decisions


@given(st.integers(1, 20), st.integers(1, 300), st.floats(0.05, 0.99), st.sampled_from([1, 4]))
def test_rows_are_sparse_where_that_takes_less_flash(n_inputs, hidden, share, weight_bytes):
    net = RSNN(n_inputs, 3, hidden=hidden, model="snn", sampling_rate_Hz=1000.0)
    prune(net, share)
    matrix = matrices_of(net, weight_bytes)["w_in"]
    tables = matrix.indices("w_in").values()
    assert matrix.there is not None
    size = {sparse: weight_bytes * int(matrix.there.sum() if sparse else matrix.there.size) for sparse in (True, False)}
    for sparse in (True, False):
        for table in matrix._replace(sparse=sparse).indices("w_in").values():
            widest = {"uint8_t": 1, "uint16_t": 2, "uint32_t": 4}[c_export.unsigned(int(table.max()))]
            size[sparse] += widest * table.size
    if size[True] != size[False]:
        assert matrix.sparse == (size[True] < size[False]) or abs(size[True] - size[False]) <= 2 * hidden
    assert len([*tables]) == (2 if matrix.sparse else 1)


@pytest.mark.parametrize("variant", ["float", "integer"])
def test_a_dense_export_has_no_trace_of_pruning(variant, tmp_path):
    chain = make_chain({}, readout="stretches")
    signals = [make_signal(150, 2)]
    c_export.write(chain, tmp_path, None if variant == "float" else chosen(chain, signals))
    text = (tmp_path / "touch.c").read_text() + (tmp_path / "touch.h").read_text()
    assert not re.search(r"_row|_to\b|_fan|sops|gains\[|summed", text)


def test_operations_beyond_a_counter_are_refused(tmp_path):
    chain = pruned("spiking", 0.5, hidden=900, n_taxels=500, windows={"length_ms": 6000.0})
    with pytest.raises(InputError, match="synaptic operations may exceed"):
        c_export.write(chain, tmp_path)


@pytest.mark.parametrize("keys", [{"hidden": 0}, {"direct": True}])
def test_the_live_page_knows_which_operations_a_pruned_readout_has_of_afferents(keys):
    chain = pruned("integrator", 0.5, **keys)
    decision = next(iter(Stream(chain).push(make_signal(170, 6))))
    assert decision.input_spikes > 0
    whole = chain.network.synapses["synapses_readout"] / chain.network.spec.heard(chain.network.n_inputs)
    heard = decision.input_spikes + decision.hidden_spikes
    expected = decision.sops if not chain.network.spec.hidden else min(decision.sops, heard * whole)
    measured = {"sops_input": decision.sops - expected, "sops_recurrent": 0, "sops_readout": expected}
    measured |= {"input_spikes": decision.input_spikes, "hidden_spikes": decision.hidden_spikes}
    network = network_cost(
        chain.network.spec, chain.network.n_inputs, chain.network.n_classes, measured | chain.network.synapses,
        steps=decision.steps, signal_ms=decision.ms,
    )  # fmt: skip
    assert scores.cost_nJ(chain, decision) > network.energy_nJ(MEMORY_45NM) > 0
