"""The study of bits: a row for float and for each pair of bits, counted by hand."""

import numpy as np
import pandas as pd
import pytest
import torch
from neurotact_parts.studies.texture import quantisation
from neurotact_parts.studies.texture.quantisation import FLOAT, Parameters, QuantisationData

from neurotact.networks.training.epochs import Epoch, Training
from neurotact.spec import build


@pytest.fixture(scope="module")
def made():
    data = QuantisationData(simulation={"trials": 1, "duration_s": 0.4})
    table = {
        "data": data.model_dump(),
        "encoder": {
            "conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "start"}, "sa1": {"gain": 3.2}, "ra1": {"gain": 16.0}
        },
        "t_ref_ms": [5.0, 1.0], "network": {"hidden": 7, "training": {"epochs": 1}},
        "weight_bits": [8, 3], "state_bits": [16, 8], "fine_tune_epochs": 1,
    }  # fmt: skip
    parameters = build(Parameters, table, source="test")
    arrays = quantisation.load(data)
    assert arrays["signals"].shape == (48, 800, 8)
    return parameters, arrays


@pytest.fixture(scope="module")
def rows(made):
    return quantisation.run(*made)


def test_there_is_a_row_for_float_and_two_for_each_pair_of_bits(rows):
    expected = [
        (method, *bits) for bits in ((8, 16), (8, 8), (3, 16), (3, 8)) for method in ("rounding", "fine-tuning")
    ]
    found = [(row["method"], row["weight_bits"], row["state_bits"]) for row in rows]
    assert found == [("float", FLOAT, FLOAT), ("float, trained on", FLOAT, FLOAT), *expected]
    assert {row["pair"] for row in rows} == {"5&1"}


def test_bytes_are_counted(rows):
    n_weights, n_states = 16 * 7 + 7 * 7 + 7 * 8, 2 * (7 + 8)
    expected = {(32, 32): 4 * n_weights + 4 * n_states}
    expected |= {(8, bits): n_weights + n_states * bits // 8 for bits in (16, 8)}
    expected |= {(3, bits): np.ceil(3 * n_weights / 8) + n_states * bits // 8 for bits in (16, 8)}
    assert all(row["bytes"] == expected[row["weight_bits"], row["state_bits"]] for row in rows)
    assert all(row["bytes"] == row["weight_bytes"] + row["state_bytes"] for row in rows)


def test_measures_are_of_windows(rows):
    for row in rows:
        assert 0 <= row["exit_accuracy"] <= 1
        assert 0 < row["exit_steps"] <= 300
        assert row["exit_sops_total"] >= 0


def test_fine_tuning_of_no_epoch_is_left_out(made):
    parameters, arrays = made
    rows = quantisation.run(parameters.model_copy(update={"fine_tune_epochs": 0}), arrays)
    assert {row["method"] for row in rows} == {"float", "rounding"}


def test_rounding_rows_are_the_same_with_fine_tuning_beside_them(made, rows):
    parameters, arrays = made
    alone = quantisation.run(parameters.model_copy(update={"fine_tune_epochs": 0}), arrays)
    assert alone == [row for row in rows if row["method"] in ("float", "rounding")]


def test_float_is_trained_on_as_fine_tuning_is_and_the_trained_network_stays(made, monkeypatch):
    parameters, arrays = made
    given = []

    def looking(network, training, validation, grids, **options):
        given.append((network, {name: tensor.clone() for name, tensor in network.state_dict().items()}, grids, options))
        return Training((Epoch(0, 1.0, 1.0, 1.0, 1.0),), Epoch(0, 1.0, 1.0, 1.0, 1.0))

    monkeypatch.setattr(quantisation.fine_tuning, "train_rounded", looking)
    quantisation.run(parameters, arrays)
    first, *others = given
    assert first[2] == {}
    assert {grids["w_in"].most for _, _, grids, _ in others} == {127, 3}
    for network, weights, _, options in others:
        assert network is not first[0]
        assert all(torch.equal(weights[name], first[1][name]) for name in weights)
        assert options["epochs"] == first[3]["epochs"]
        assert options["generator"].initial_seed() == first[3]["generator"].initial_seed()


def test_figures_show_every_pair_and_way(rows):
    table = pd.concat([pd.DataFrame(rows), pd.DataFrame(rows).assign(pair="1&1", seed=1)])
    states, weights = (drawn.figure for drawn in quantisation.draw(table, {}))
    assert [axes.get_title() for axes in states.axes] == [
        f"t_ref {pair} ms, {way}" for way in ("rounding", "fine-tuning") for pair in ("5&1", "1&1")
    ]
    assert [axes.get_title() for axes in weights.axes] == ["t_ref 5&1 ms", "t_ref 1&1 ms", "bytes"]
    one = next(row for row in rows if row["method"] == "fine-tuning" and row["weight_bits"] == 3)
    drawn = [line.get_xydata() for line in weights.axes[0].lines if len(line.get_xdata()) == 2]
    assert any(np.allclose(points[0], (3, 100 * one["exit_accuracy"])) for points in drawn)
