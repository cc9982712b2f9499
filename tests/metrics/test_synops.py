import numpy as np
import pytest
import torch
from costs import sops_table

from neurotact.errors import InputError
from neurotact.metrics.synops import COLUMNS, summary, synops
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec

# Trial 0: 2 afferents send 5 spikes, of 3 hidden neurons come 2, there are 4 readout neurons.
#   input to hidden   5 spikes reach 3 neurons each   15
#   hidden to hidden  2 spikes reach 3 neurons each    6
#   hidden to readout 2 spikes reach 4 neurons each    8
INPUT = np.array([[[1, 0], [1, 1], [1, 1]], [[0, 0], [0, 0], [0, 0]]])
HIDDEN = np.array([[[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 0, 0], [0, 0, 0], [0, 0, 0]]])


def table(**changes):
    given = {
        "labels": ["rough", "smooth", "rough"],
        "predicted": ["rough", "rough", "smooth"],
        "steps": [300, 100, 200],
        "input_spikes": [5, 0, 1],
        "hidden_spikes": [2, 0, 4],
        "n_hidden": 3,
        "n_readout": 4,
        "recurrent": True,
    }
    return sops_table(**{**given, **changes})


def test_sops_counted_by_hand():
    counted = synops(INPUT.sum(axis=(1, 2)), HIDDEN.sum(axis=(1, 2)), n_hidden=3, n_readout=4, recurrent=True)
    assert counted.input.tolist() == [15, 0]
    assert counted.recurrent.tolist() == [6, 0]
    assert counted.readout.tolist() == [8, 0]
    assert counted.total.tolist() == [29, 0]
    assert counted.total_feedforward.tolist() == [23, 0]


@pytest.mark.parametrize(("membrane", "delay", "sent"), [("immediate", 0, 1), ("immediate", 1, 1), ("delayed", 1, 0)])
def test_a_spike_counts_in_the_step_that_sends_it(membrane, delay, sent):
    # A window of one step: under `immediate` both hidden neurons spike in it, and their spikes come back after it;
    # under `delayed` they would spike after it.
    spec = RSNNSpec(hidden=2, membrane=membrane, recurrent_delay_steps=delay)
    net = RSNN(1, 3, spec, 2000.0, dtype=torch.float64)
    with torch.no_grad():
        net.w_in.fill_(16.0)
    decided = net.infer(torch.ones(1, 1, 1))
    counted = synops(decided.input_spikes, decided.hidden_spikes, n_hidden=2, n_readout=3, recurrent=True)
    assert counted.input.tolist() == [2]
    assert counted.recurrent.tolist() == [2 * 2 * sent]
    assert counted.readout.tolist() == [2 * 3 * sent]


def test_tensors_count_as_arrays_and_do_not_overflow():
    counted = synops(torch.tensor([5, 0]), torch.tensor([2, 0]), 3, 4, recurrent=True)
    assert counted.total.tolist() == [29, 0]
    many = synops(np.array([2**31 - 1], np.int32), np.array([0], np.int32), 1024, 8, recurrent=True)
    assert many.input.tolist() == [1024 * (2**31 - 1)]


def test_every_operation_is_a_spike_at_a_neuron_that_receives_it():
    rng = np.random.default_rng(1)
    sent, heard = rng.integers(0, 2, (6, 20, 5)), rng.integers(0, 2, (6, 20, 7))
    w_in, w_rec, w_out = np.ones((5, 7)), np.ones((7, 7)), np.ones((7, 3))
    counted = synops(sent.sum(axis=(1, 2)), heard.sum(axis=(1, 2)), 7, 3, recurrent=True)
    # With all weights 1, what arrives is what was operated.
    np.testing.assert_array_equal(counted.input, (sent @ w_in).sum(axis=(1, 2)))
    np.testing.assert_array_equal(counted.recurrent, (heard @ w_rec).sum(axis=(1, 2)))
    np.testing.assert_array_equal(counted.readout, (heard @ w_out).sum(axis=(1, 2)))


def test_the_report_has_a_row_a_window_and_the_agreed_columns():
    report = table(trials=np.array([7, 8, 9]))
    assert tuple(report.columns) == COLUMNS
    assert report.iloc[0].tolist() == [7, "rough", "rough", 300, 5, 2, 15, 6, 8, 29, 23]
    assert table()["trial"].tolist() == [0, 1, 2]


def test_summary_is_the_mean_of_each_class_and_of_all_windows():
    means = summary(table()).set_index("label")
    assert means.index.tolist() == ["rough", "smooth", "all"]
    assert means["windows"].tolist() == [2, 1, 3]
    assert means["accuracy"].tolist() == [0.5, 0.0, pytest.approx(1 / 3)]
    assert means.loc["rough", "steps"] == 250
    # SOPs: 15 + 6 + 8 = 29, none, 3 + 12 + 16 = 31.
    assert means["sops_total"].tolist() == [30.0, 0.0, 20.0]


def test_summary_of_numbered_classes_and_of_nothing():
    assert summary(table(labels=[10, 2, 10], predicted=[10, 2, 2]))["label"].tolist() == ["2", "10", "all"]
    nothing = table(labels=[], predicted=[], steps=[], input_spikes=[], hidden_spikes=[])
    assert summary(nothing)["windows"].tolist() == [0]
    assert summary(nothing.assign(side=[]))["windows"].tolist() == [0]


def test_summary_counts_windows_and_not_the_trials_that_they_come_from():
    assert summary(table(trials=np.array([7, 7, 7])))["windows"].tolist() == [2, 1, 3]


def test_sides_are_summarised_apart_and_never_mixed():
    report = table().assign(side=["test", "training", "test"])
    means = summary(report)
    assert means.columns[0] == "side"
    # Training holds the one window of `smooth`, taken for rough; test the two of `rough`, of which one is right.
    assert means[["side", "label", "windows", "accuracy"]].values.tolist() == [
        ["training", "smooth", 1, 0.0], ["training", "all", 1, 0.0],
        ["test", "rough", 2, 0.5], ["test", "all", 2, 0.5],
    ]  # fmt: skip
    every = report.assign(side=["unseen", "elsewhere", "validation"])
    assert summary(every)["side"].unique().tolist() == ["validation", "unseen", "elsewhere"]


@pytest.mark.parametrize(
    ("input_spikes", "hidden_spikes", "complaint"),
    [
        ([1, 2], [1], "2 windows but hidden"),
        ([[1, 2]], [[1, 2]], "one number a window"),
        ([-1], [0], "whole numbers"),
        ([0.5], [0], "whole numbers"),
        ([np.nan], [0], "whole numbers"),
    ],
)
def test_counts_that_are_none_are_refused(input_spikes, hidden_spikes, complaint):
    with pytest.raises(InputError, match=complaint):
        synops(np.array(input_spikes), np.array(hidden_spikes), 3, 4, recurrent=True)


def test_reports_that_do_not_fit_together_are_refused():
    with pytest.raises(InputError, match="'label'"):
        table(labels=["rough"])
    with pytest.raises(InputError, match="'steps'"):
        table(steps=[300])
    with pytest.raises(InputError, match="'predicted'"):
        summary(table().drop(columns="predicted"))
    with pytest.raises(InputError, match="at least one neuron"):
        synops(np.array([1]), np.array([1]), 0, 4, recurrent=True)


def test_without_recurrence_hidden_spikes_reach_the_readout_alone():
    found = synops(np.array([10, 3]), np.array([4, 0]), n_hidden=5, n_readout=2, recurrent=False)
    assert found.recurrent.tolist() == [0, 0]
    assert found.total.tolist() == found.total_feedforward.tolist() == [58, 15]
