"""Costs counted by hand."""

import numpy as np
import pytest
from costs import operations
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.opponents.kernel_machines import RBFExpansion, SupportVectorMachines
from neurotact_parts.opponents.pooled_gru import GRU
from neurotact_parts.opponents.scikit_learn import Trees
from neurotact_parts.studies import published_flops
from neurotact_parts.studies.compliance.flops import Projection
from neurotact_parts.studies.stiffness.slfn_chain import BinaryInputDense, PowerOfTwoDense
from neurotact_parts.studies.touch_modality.cnn_features import Conv2d
from neurotact_parts.studies.touch_modality.conv_lstm import ConvLSTM
from neurotact_parts.studies.touch_modality.recurrent import LSTM
from sklearn.svm import SVC

from neurotact.errors import InputError
from neurotact.metrics import flops
from neurotact.metrics.flops import (
    LEDGER_COLUMNS,
    Cost,
    Dense,
    Integrator,
    Layer,
    Moments,
    MovingAverage,
    NearestPoints,
    SpikingLayer,
    Standardise,
    cost,
    ledger_table,
)

EVERY_LAYER = [
    Dense(8, 3),
    PowerOfTwoDense(8, 3),
    BinaryInputDense(8, 3),
    LSTM(16, 10),
    GRU(16, 10),
    Conv2d(4, 4, 1, 2, 3),
    ConvLSTM(4, 4, 1, 2, 3),
    RBFExpansion(5, 4),
    SupportVectorMachines(5, 4, 3),
    NearestPoints(3, 4),
    MovingAverage(150, 4),
    Moments(150, 4),
    Standardise(16),
    Projection(16, 3),
    SpikingLayer(16, 30, 300, 1000.0, recurrent=True),
    Integrator(30, 8, 1000.0),
    Trees(200, 5.5, 900, 8),
]


def test_dense_by_hand():
    # 3 inputs to 2 units: 6 products, each added; 6 weights and 2 biases; a comparison for each ReLU.
    counted = cost(Dense(3, 2, "relu"))
    assert operations(counted) == operations(Cost(macs=6, comparisons=2, parameters=8, bytes=32))
    assert counted.flops == 14
    assert cost(Dense(3, 2, bias=False)).parameters == 6


def test_kernel_expansion_by_hand():
    # 3 units of 2 features, 2 machines: 6 differences, 6 squares added, 3 times (gamma and exp), 6 weighted terms.
    by_hand = Cost(macs=12, acs=6, multiplications=3, exponentials=3, parameters=6 + 6 + 1, bytes=4 * 13)
    assert operations(cost(RBFExpansion(3, 2, outputs=2))) == operations(by_hand)
    assert cost(RBFExpansion(3, 2, bias=True)).parameters == 6 + 3 + 1 + 1


def test_nearest_points_by_hand():
    # 3 centroids of 2 features: 6 differences, 6 squares added, 3 comparisons.
    by_hand = Cost(macs=6, acs=6, comparisons=3, parameters=6, bytes=24)
    assert operations(cost(NearestPoints(3, 2))) == operations(by_hand)
    assert cost(NearestPoints(3, 2, neighbours=2)).other_flops == 6


@pytest.mark.parametrize("classes", [2, 3, 4, 8])
def test_support_vector_machines_store_what_scikit_learn_stores(classes):
    rng = np.random.default_rng(0)
    labels = np.arange(60) % classes
    machine = SVC(gamma=0.5).fit(rng.normal(size=(60, 3)) + labels[:, None], labels)
    counted = cost(SupportVectorMachines(len(machine.support_), 3, classes))
    stored = machine.support_vectors_.size + machine.dual_coef_.size + machine.intercept_.size
    assert counted.parameters == stored + 1  # and gamma
    assert counted.macs == machine.support_vectors_.size + machine.dual_coef_.size
    with pytest.raises(InputError, match="at least 2; got 1"):
        cost(SupportVectorMachines(3, 3, 1))


def test_projection_and_scaling_by_hand():
    assert operations(cost(Projection(4, 2))) == operations(Cost(macs=8, acs=4, parameters=12, bytes=48))
    assert operations(cost(Standardise(4))) == operations(Cost(macs=4, parameters=8, bytes=32))


def test_an_integrator_by_hand():
    # 3 hidden neurons send 2 spikes to 4 classes; 12 weights and 4 biases; 4 sums are kept.
    counted = cost(Integrator(3, 4, sops=8))
    assert (counted.acs, counted.sops, counted.macs, counted.other_flops) == (8, 8, 0, 0)
    assert (counted.parameters, counted.bytes) == (16, 4 * (16 + 4))


@pytest.mark.parametrize("sops", [-1.0, float("nan")])
def test_an_integrator_of_impossible_operations_is_refused(sops):
    with pytest.raises(InputError, match="Integrator: sops and steps must be >= 0"):
        Integrator(3, 4, sops=sops)


def test_spiking_network_by_hand():
    # 2 afferents, 3 hidden neurons, 4 readouts, 3 steps; SOPs as counted by hand in test_synops: 15, 6 and 8.
    hidden = SpikingLayer(2, 3, steps=3, sops=15 + 6, recurrent=True)
    readout = SpikingLayer(3, 4, steps=3, sops=8, recurrent=False)
    counted = cost(hidden, readout, signal_ms=1.5)
    assert counted.acs == counted.sops == 29
    assert counted.macs == 2 * 3 * (3 + 4)
    assert counted.other_flops == 3 * (3 + 4)
    assert counted.parameters == 2 * 3 + 3 * 3 + 3 * 4
    assert counted.signal_ms == 1.5
    # 42 MACs at 4.6 pJ, 29 ACs and 21 comparisons at 0.9 pJ.
    assert counted.energy_estimate_nJ == pytest.approx(1e-3 * (42 * 4.6 + 50 * 0.9))


@given(st.integers(1, 10**5), st.integers(1, 64))
def test_moments_and_average_are_the_papers_tables_i(n, channels):
    each = [
        published_flops.mean_flops(n),
        published_flops.std_flops(n),
        published_flops.skewness_flops(n),
        published_flops.kurtosis_flops(n),
    ]
    for order in (1, 2, 3, 4):
        assert cost(Moments(n, channels, order)).flops == channels * sum(each[:order])
    assert cost(MovingAverage(n, channels)).flops == channels * published_flops.moving_average_flops(n)


@given(st.integers(1, 300), st.integers(1, 64), st.integers(1, 42))
def test_networks_are_the_papers_table_ii_but_for_its_relu(N, nf, nc):
    output = Dense(N, nc, bias=False)
    assert cost(Dense(nf, N, "sigmoid"), output).flops == published_flops.slfn_flops("S-ELM", N, nf, nc)
    # The paper takes two FLOPs for a ReLU, the ledger the one comparison.
    assert cost(Dense(nf, N, "relu"), output).flops == published_flops.slfn_flops("R-ELM", N, nf, nc) - N
    binary = cost(PowerOfTwoDense(nf, N), BinaryInputDense(N, nc, bias=False))
    assert binary.flops == published_flops.slfn_flops("H-ELM", N, nf, nc)
    assert binary.macs == 0


@given(st.lists(st.sampled_from(EVERY_LAYER), max_size=5), st.lists(st.sampled_from(EVERY_LAYER), max_size=5))
def test_costs_of_chains_add_up_and_the_longest_signal_stands(first, second):
    joined = cost(*first, signal_ms=50) + cost(*second, signal_ms=75)
    whole = cost(*first, *second, signal_ms=75)
    for name in ("macs", "acs", "other_flops", "flops", "parameters", "bytes", "sops", "signal_ms"):
        assert getattr(joined, name) == pytest.approx(getattr(whole, name))


LONE = {
    "RBFExpansion": 5,  # gamma
    "SupportVectorMachines": 5,
    "LSTM": 2 * 10,
    "GRU": 10,
    "ConvLSTM": 2 * 2 * 16,
    "MovingAverage": 150 * 4,
    "Moments": 4 * (1 + 1 + 3 + 1),
}
"""The multiplications of `EVERY_LAYER` whose product is not added; other layers have none."""


@pytest.mark.parametrize("layer", EVERY_LAYER, ids=lambda layer: type(layer).__name__)
def test_multiplications_whose_product_is_not_added_have_their_own_price(layer):
    counted = cost(layer)
    assert counted.multiplications == LONE.get(type(layer).__name__, 0)
    cheap, costly = counted.acs + counted.comparisons, counted.divisions * 4 + counted.exponentials * 8
    by_hand = 4.6 * counted.macs + 0.9 * cheap + 3.7 * counted.multiplications + 2.3 * costly
    assert counted.energy_estimate_nJ == pytest.approx(1e-3 * by_hand)


def test_divisions_and_exponentials_are_told_from_comparisons():
    kinds = ("comparisons", "divisions", "exponentials")
    assert [getattr(cost(Dense(1, 1, "sigmoid")), kind) for kind in kinds] == [2, 1, 1]
    assert [getattr(cost(Dense(1, 1, "softmax")), kind) for kind in kinds] == [1, 1, 1]


@pytest.mark.parametrize("layer", EVERY_LAYER, ids=lambda layer: type(layer).__name__)
def test_no_layer_counts_zero(layer):
    assert cost(layer).flops > 0


def test_every_layer_of_the_module_is_tested():
    found = {c for c in vars(flops).values() if isinstance(c, type) and issubclass(c, Layer) and c is not Layer}
    assert found == {type(layer) for layer in EVERY_LAYER if type(layer).__module__ == flops.__name__}


@pytest.mark.parametrize("unknown", [object(), "LSTM", None, Dense])
def test_an_unknown_layer_raises(unknown):
    with pytest.raises(InputError, match="no layer that the ledger can count"):
        cost(Dense(1, 1), unknown)  # type: ignore[arg-type]


def test_a_layer_of_your_own_counts():
    class Doubling(Layer):
        def cost(self) -> Cost:
            return Cost(acs=1)

    assert cost(Doubling(), Doubling()).acs == 2


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Dense(0, 3), r"Dense.inputs: must be a whole number, at least 1; got 0"),
        (lambda: LSTM(16, 10, steps=-1), "LSTM.steps"),
        (lambda: GRU(16, 1.5), "GRU.units"),  # type: ignore[arg-type]
        (lambda: SpikingLayer(1, 1, steps=3, sops=-1.0, recurrent=False), "sops must be >= 0"),
        (lambda: SpikingLayer(1, 1, steps=3, sops=float("nan"), recurrent=False), "sops must be >= 0"),
        (lambda: cost(Dense(1, 1, "swish")), "'swish' is not known"),  # type: ignore[arg-type]
        (lambda: cost(Moments(10, 1, 5)), "four moments"),
        (lambda: Cost(macs=-1), "cost.macs"),
        (lambda: Cost(signal_ms=float("inf")), "cost.signal_ms"),
    ],
)
def test_what_cannot_be_is_refused(make, complaint):
    with pytest.raises(InputError, match=complaint):
        make()


def test_the_table_has_a_row_a_cost_in_the_order_given():
    table = ledger_table([("b", Cost(macs=1)), ("a", Cost(acs=2, sops=2))])
    assert table["name"].tolist() == ["b", "a"]
    assert list(table.columns) == ["name", *LEDGER_COLUMNS, "prices"]
    assert table["energy_estimate_nJ"].tolist() == [pytest.approx(4.6e-3), pytest.approx(1.8e-3)]
    assert list(ledger_table({}).columns) == ["name", *LEDGER_COLUMNS, "prices"]
