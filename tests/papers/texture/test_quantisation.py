"""The study of bits: a row for float and for each pair of bits, counted by hand."""

import numpy as np
import pytest

from neurotact.papers.texture import quantisation
from neurotact.papers.texture.quantisation import FLOAT, Parameters, QuantisationData
from neurotact.spec import build


@pytest.fixture(scope="module")
def rows():
    data = QuantisationData(simulation={"trials": 1, "duration_s": 0.4})
    table = {
        "data": data.model_dump(),
        "encoder": {
            "conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "start"}, "sa1": {"gain": 3.2}, "ra1": {"gain": 16.0}
        },
        "t_ref_ms": [5.0, 1.0], "network": {"hidden": 7, "training": {"epochs": 1}},
        "weight_bits": [8, 3], "state_bits": [16],
    }  # fmt: skip
    parameters = build(Parameters, table, source="test")
    arrays = quantisation.load(data)
    assert arrays["signals"].shape == (48, 800, 8)
    return quantisation.run(parameters, arrays)


def test_there_is_a_row_for_float_and_for_each_pair_of_bits(rows):
    assert [(row["weight_bits"], row["state_bits"]) for row in rows] == [(FLOAT, FLOAT), (8, 16), (3, 16)]
    assert {row["pair"] for row in rows} == {"5&1"}


def test_bytes_are_counted(rows):
    n_weights, n_states = 16 * 7 + 7 * 7 + 7 * 8, 2 * (7 + 8)
    assert [row["bytes"] for row in rows] == [
        4 * n_weights + 4 * n_states, n_weights + 2 * n_states, np.ceil(3 * n_weights / 8) + 2 * n_states
    ]  # fmt: skip


def test_measures_are_of_windows(rows):
    for row in rows:
        assert 0 <= row["exit_accuracy"] <= 1
        assert 0 < row["exit_steps"] <= 300
        assert row["exit_sops_total"] >= 0
