"""Less than the whole window: the laws that tie every cut and every patience to the network's own decisions."""

import numpy as np
import pytest
import torch
from neurotact_parts.studies.texture import shortened

from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit import truncated
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training.epochs import Examples

RATE_Hz, STEPS, CLASSES = 1000.0, 60, 4
CUTS_ms = (10.0, 30.0, 60.0)
PATIENCES = (1, 7, 20, STEPS)


def windows(seed, n=40):
    generator = torch.Generator().manual_seed(seed)
    spikes = (torch.rand((n, STEPS, 6), generator=generator) < 0.15).to(torch.uint8)
    return Examples(spikes, torch.arange(n) % CLASSES)


@pytest.fixture(scope="module")
def network():
    """Untrained, with weights that let every layer spike."""
    made = RSNN(6, CLASSES, RSNNSpec(hidden=12), RATE_Hz, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        made.w_in.abs_().mul_(3.0)
        made.w_out.mul_(12.0)
    return made


@pytest.fixture(scope="module")
def heard(network):
    return truncated.simulate_windows(network, windows(0))


def test_the_layers_spike_and_labels_differ(network, heard):
    """Without this the laws below would hold for nothing."""
    assert heard.hidden[:, -1].float().mean() > 5
    assert len(set(network.infer(windows(0).spikes).labels.tolist())) > 1


def test_a_cut_at_the_full_length_is_the_full_window(network, heard):
    full, test = network.infer(windows(0).spikes), windows(0)
    *_, whole = shortened.cut_short(network, heard, CUTS_ms)
    assert whole["accuracy_test"] == float((full.labels == test.labels).double().mean())
    assert whole["sops_input"] == 12 * float(full.input_spikes.double().mean())
    assert whole["sops_recurrent"] == 12 * float(full.hidden_spikes.double().mean())


@pytest.mark.parametrize("cut_ms", CUTS_ms)
def test_a_cut_is_what_the_network_does_with_windows_of_that_length(network, heard, cut_ms):
    (row,) = shortened.cut_short(network, heard, [cut_ms])
    short = network.infer(windows(0).spikes[:, : round(cut_ms)])
    assert row["accuracy_test"] == float((short.labels == windows(0).labels).double().mean())
    assert row["sops_total"] == pytest.approx(
        float((12 * short.input_spikes + (12 + CLASSES) * short.hidden_spikes).double().mean())
    )


def test_sops_grow_with_the_cut_and_cuts_past_the_end_are_left_out(network, heard):
    rows = shortened.cut_short(network, heard, [*CUTS_ms, 61.0])
    assert [row["cut_ms"] for row in rows] == list(CUTS_ms)
    for name in ("sops_input", "sops_recurrent", "sops_readout", "sops_total"):
        assert np.all(np.diff([row[name] for row in rows]) > 0)


@pytest.fixture(scope="module")
def curve(network, heard):
    return shortened.exit_curve(
        network, heard, truncated.simulate_windows(network, windows(1)), [*PATIENCES, STEPS + 1]
    )


def rows_of(curve, mode):
    return [row for row in curve if row["mode"] == mode]


def test_a_validated_exit_is_what_the_network_does_when_it_stops(network, curve):
    assert [row["patience"] for row in rows_of(curve, "validated")] == list(PATIENCES)
    for row in rows_of(curve, "validated"):
        early = network.infer(windows(0).spikes, ExitRule(row["patience"], from_first_spike=True))
        other = network.infer(windows(1).spikes, ExitRule(row["patience"], from_first_spike=True))
        assert row["exit_steps"] == float(early.steps.double().mean())
        assert row["accuracy_test"] == float((early.labels == windows(0).labels).double().mean())
        assert row["accuracy_validation"] == float((other.labels == windows(1).labels).double().mean())
        assert row["sops_input"] == pytest.approx(12 * float(early.input_spikes.double().mean()))


@pytest.mark.parametrize("mode", ["validated", "oracle"])
def test_the_longest_patience_saves_nothing_and_longer_ones_never_more(curve, mode):
    rows = rows_of(curve, mode)
    assert rows[-1]["steps_saved"] == rows[-1]["sops_saved"] == rows[-1]["accuracy_lost"] == 0.0
    assert rows[0]["steps_saved"] > 0
    assert np.all(np.diff([row["exit_steps"] for row in rows]) >= 0)
    assert np.all(np.diff([row["sops_total"] for row in rows]) >= 0)


def test_the_oracle_never_loses_accuracy_and_wrong_windows_run_to_their_end(curve):
    for row in rows_of(curve, "oracle"):
        assert row["accuracy_lost"] <= 0
        right = row["accuracy_test"]
        assert row["exit_steps"] == pytest.approx(right * row["exit_steps_right"] + (1 - right) * STEPS)
