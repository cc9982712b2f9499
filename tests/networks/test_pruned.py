"""Operations and memory of a pruned network are those of the weights that are left, wherever they are counted."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS

from neurotact import backend as backends
from neurotact.metrics import flops, synops
from neurotact.metrics.flops import Integrator, SpikingLayer
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit import truncated
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import trainer
from neurotact.networks.training.epochs import Epoch, Examples, Training
from neurotact.networks.training.sparsity import prune
from neurotact.networks.training.tasks import Sides
from neurotact.networks.use import ledger, measuring
from neurotact.networks.use.ledger import Afferents

BACKENDS = ["reference", *(["native"] if backends.native else [])]
NAMES = ("input", "recurrent", "readout")
readouts = st.sampled_from(sorted(READOUTS))


def network(readout: str, share: float, seed: int = 0, backend: backends.Backend = "reference", **keys) -> RSNN:
    keys = {"hidden": 6, "forward_weight_scale": 3.0, **READOUTS[readout], **keys}
    made = RSNN(4, 3, sampling_rate_Hz=1000.0, backend=backend, generator=torch.Generator().manual_seed(seed), **keys)
    if share:
        prune(made, share)
    return made


def windows(n: int = 5, n_steps: int = 40, seed: int = 0) -> torch.Tensor:
    return (torch.rand(n, n_steps, 4, generator=torch.Generator().manual_seed(seed)) < 0.3).to(torch.uint8)


def by_hand(net: RSNN, spikes: torch.Tensor, steps: torch.Tensor) -> list[list[int]]:
    """Operations of each projection in so many steps of each window: every spike at every weight that is not 0."""
    sent, out = net.simulate(spikes).hidden, net.readout_weights.reshape(-1, net.spec.hidden, 3)
    received, found = net.binned(spikes), []
    for trial, n in enumerate((-(-steps // net.steps_per_bin)).tolist()):
        counts = [0, 0, 0]
        for t in range(n):
            for i in received[trial, t].nonzero().ravel().tolist():
                counts[0] += int((net.w_in[i] != 0).sum())
            for i in sent[trial, t].nonzero().ravel().tolist():
                counts[1] += 0 if net.w_rec is None else int((net.w_rec[i] != 0).sum())
                counts[2] += int((out[:, i] != 0).any(dim=0).sum())
        found.append(counts)
    return found


@given(
    readouts,
    st.sampled_from(["rsnn", "snn", "blocks"]),
    st.sampled_from([0.0, 0.3, 0.8]),
    st.sampled_from([None, 1, 6]),
    st.sampled_from(BACKENDS),
    st.sampled_from([{}, {"step_ms": 4.0}, {"membrane": "immediate"}]),
)
@examples(30)
def test_operations_are_those_counted_one_by_one(readout, model, share, patience, backend, keys):
    keys = keys | {"rsnn": {}, "snn": {"model": "snn"}, "blocks": {"recurrent_blocks": 2}}[model]
    net, spikes = network(readout, share, backend=backend, **keys), windows()
    found = net.infer(spikes, FULL_WINDOW if patience is None else ExitRule(patience))
    counted = measuring.synops_of(found, net)
    assert [*zip(*(getattr(counted, name).tolist() for name in NAMES), strict=True)] == [
        tuple(row) for row in by_hand(net, spikes, found.steps)
    ]
    whole = counted.input + counted.recurrent + counted.readout
    assert (counted.total == whole).all()
    assert (counted.total_feedforward == counted.input + counted.readout).all()
    simulated = truncated.simulate_windows(net, Examples(spikes, torch.zeros(5, dtype=torch.int64)))
    bins = -(-found.steps // net.steps_per_bin)
    assert truncated.judged(net, simulated, bins, found.labels)["sops_total"] == pytest.approx(float(whole.mean()))


def test_a_dense_network_with_zeros_counts_as_ever():
    net, spikes = network("integrator", 0.0), windows()
    before = measuring.synops_of(net.infer(spikes), net)
    with torch.no_grad():
        net.w_rec[net.w_rec.abs() < 1e-9] = 0.0
        net.w_out[0] = 0.0
    assert net.synapses == {}
    assert [*map(np.ndarray.tolist, before)] == [*map(np.ndarray.tolist, measuring.synops_of(net.infer(spikes), net))]


def test_more_windows_than_fit_at_once_count_alike(monkeypatch):
    net, spikes = network("stretches", 0.6), windows(7)
    whole = measuring.synops_of(net.infer(spikes, ExitRule(4)), net)
    monkeypatch.setattr("neurotact.networks.definition.rsnn.RASTER_VALUES", 2 * 40 * 13)
    parts = measuring.synops_of(net.infer(spikes, ExitRule(4)), net)
    assert whole.total.tolist() == parts.total.tolist()


# The ledger.


def bytes_by_hand(rows: int, columns: int, n: int, values: int = 1) -> int:
    """Values of 4 bytes; a column beside each synapse and the first place of each row, in the bytes that they take."""
    wide = [1 if largest < 256 else 2 if largest < 65536 else 4 for largest in (columns - 1, n)]
    return min(4 * values * rows * columns, n * (4 * values + wide[0]) + (rows + 1) * wide[1])


@given(
    st.integers(1, 300), st.integers(1, 300), st.floats(0, 1), st.integers(1, 4), st.sampled_from(["spikes", "adds up"])
)
def test_memory_is_that_of_values_and_indices_or_of_all_values(rows, columns, share, values, kind):
    n = round(share * rows * columns)
    if kind == "spikes":
        whole, pruned = (
            SpikingLayer(rows, columns, 9, 5, recurrent=False, synapses=(one, None)).cost() for one in (None, n)
        )
        values = 1
    else:
        whole, pruned = (Integrator(rows, columns, 5, stretches=values, synapses=one).cost() for one in (None, n))
    assert whole.bytes - pruned.bytes == 4 * values * rows * columns - bytes_by_hand(rows, columns, n, values)
    assert whole.parameters - pruned.parameters == values * (rows * columns - n)
    assert whole.columns("macs", "acs", "sops") == pruned.columns("macs", "acs", "sops")


def test_weights_among_hidden_neurons_are_stored_apart():
    layer = SpikingLayer(7, 300, 9, 5, recurrent=True, synapses=(400, 9000)).cost()
    assert layer.bytes == bytes_by_hand(7, 300, 400) + bytes_by_hand(300, 300, 9000) + 2 * 4 * 300


def trained(net: RSNN) -> tuple[trainer.Trained, Sides]:
    some = Examples(windows(), torch.arange(5) % 3)
    training = Training((), Epoch(1, 0.0, 0.0, 0.0, 0.0))
    return trainer.Trained(net, training, ExitRule(3)), Sides(some, some, some)


@pytest.mark.parametrize("readout", ["integrator", "count", "stretches"])
def test_results_hold_what_the_ledger_needs_and_dense_ones_do_not(readout):
    made_by = Afferents(4, {}, 1000.0, 1000.0)
    rows = {share: measuring.measure(*trained(network(readout, share)), {})["row"] for share in (0.0, 0.7)}
    assert set(rows[0.7]) - set(rows[0.0]) == {
        *flops.SYNAPSES, "input_spikes", "hidden_spikes", "exit_input_spikes", "exit_hidden_spikes",
    }  # fmt: skip
    assert [rows[0.7][name] for name in flops.SYNAPSES] == [24 - 17, 36 - 25, 18 - 13]
    net = network(readout, 0.7)
    for early in (False, True):
        spec, row = net.spec, rows[0.7] | {"hidden": 6, "network.model": "rsnn"}
        cost = ledger.row_cost(spec, row, made_by, n_classes=3, early=early, encoding=False)
        before, steps = "exit_" if early else "", row["exit_steps" if early else "window_steps"]
        values = [7, 11, 5]
        n_stretches = spec.readout_stretches
        assert cost.sops == row[f"{before}sops_total"]
        sizes = (4, 6), (6, 6), (6, 3)
        weights = sum(
            bytes_by_hand(*size, n, n_stretches if size == (6, 3) else 1) for size, n in zip(sizes, values, strict=True)
        )
        biases = 3 if spec.integrates else 0
        assert cost.weights_bytes == weights + 4 * biases
        assert cost.parameters == 7 + 11 + 5 * n_stretches + biases
        spikes = row[f"{before}input_spikes"], row[f"{before}hidden_spikes"]
        measured = {f"sops_{name}": row[f"{before}sops_{name}"] for name in NAMES} | net.synapses
        measured |= dict(zip(ledger.SPIKES, spikes, strict=True))
        alone = ledger.network_cost(spec, 4, 3, measured, steps=steps, signal_ms=steps)
        assert alone == cost
        assert cost.buffers_accesses == pytest.approx(2 * spikes[0] + 3 * spikes[1])


def test_a_classifier_and_a_summary_pay_for_what_is_left():
    net, spikes = network("integrator", 0.7), windows()
    found = net.infer(spikes)
    labels = found.labels.numpy()
    counted = [part.numpy() for part in (found.steps, found.input_spikes, found.hidden_spikes)]
    table = synops.table_of(measuring.synops_of(found, net), labels, labels, *counted)
    how = {"encoder": None, "synapses": net.synapses}
    spent = ledger.decision_ledger(net.spec, 4, 3, 1000.0, synops.summary(table), **how).iloc[0]
    assert spent["parameters"] == 7 + 11 + 5 + 3
    assert spent["sops"] == table["sops_total"].mean()
    dense = ledger.decision_ledger(RSNNSpec(hidden=6), 4, 3, 1000.0, synops.summary(table), encoder=None).iloc[0]
    assert dense["parameters"] == 24 + 36 + 18
