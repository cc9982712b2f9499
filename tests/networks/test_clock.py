"""A network on its own clock: bins lose no spike while afferents rest as long, and all steps are the encoder's."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.exporters import chips
from neurotact_parts.studies.texture import shortened

from neurotact.errors import InputError
from neurotact.networks.definition import clock, initial
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit import truncated
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import epochs, trainer
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.ranges import record_states
from neurotact.networks.training.tasks import Sides
from neurotact.networks.use import measuring
from neurotact.networks.use.ledger import network_cost

RATE_Hz = 1000.0
READOUTS = ({"readout": "count"}, {"readout": "integrator"}, {"readout": "integrator", "readout_tau_ms": 9.0})


def resting(seed: int, n_steps: int, rest: int, n_afferents: int = 5) -> torch.Tensor:
    """Windows in which an afferent rests for `rest` steps after a spike."""
    generator = torch.Generator().manual_seed(seed)
    wants = torch.rand(3, n_steps, n_afferents, generator=generator) < 0.3
    left, spikes = torch.zeros(3, n_afferents), torch.zeros(3, n_steps, n_afferents, dtype=torch.uint8)
    for t in range(n_steps):
        fires = wants[:, t] & (left == 0)
        spikes[:, t] = fires
        left = torch.where(fires, float(rest), (left - 1).clamp(min=0))
    return spikes


def network(step_ms: float | None = 5.0, **keys) -> RSNN:
    generator = torch.Generator().manual_seed(0)
    recurrence = {} if keys.get("model") == "snn" else {"recurrent_weight_scale": 0.4}
    keys = {"hidden": 6, "forward_weight_scale": 3.0, **recurrence, **keys}
    return RSNN(5, 3, sampling_rate_Hz=RATE_Hz, generator=generator, step_ms=step_ms, **keys)


def slow_network(own: RSNN) -> RSNN:
    """The same network, whose input comes on its own clock."""
    slow = RSNN(5, 3, own.spec.model_copy(update={"step_ms": None}), RATE_Hz / 5)
    slow.load_state_dict(own.state_dict())
    return slow


@given(seed=st.integers(0, 200), rest=st.integers(0, 9), n_steps=st.integers(1, 60), n=st.integers(1, 12))
def test_bins_up_to_the_rest_and_a_step_lose_no_spike(seed, rest, n_steps, n):
    spikes = resting(seed, n_steps, rest)
    within = clock.binned(spikes, n)
    assert within.shape[1] == -(-n_steps // n)
    assert set(within.unique().tolist()) <= {0, 1}
    if n <= rest + 1:
        assert within.sum() == spikes.sum()
        assert clock.merged(spikes, n) == 0
    assert clock.apart(spikes) >= min(rest + 1, n_steps)
    assert clock.merged(spikes, clock.apart(spikes)) == 0


@given(seed=st.integers(0, 200), rest=st.integers(0, 3), n_steps=st.integers(1, 60), n=st.integers(1, 12))
def test_what_bins_of_any_length_merge_is_counted_at_once(seed, rest, n_steps, n):
    spikes = resting(seed, n_steps, rest)
    merged = tuple(clock.merged(spikes, each) for each in range(1, n + 1))
    since = [torch.cat([torch.zeros_like(spikes[:, :k]), spikes[:, :-k]], dim=1)[:, :n_steps] for k in range(1, n)]
    following = tuple(int((spikes & sum(since[:k], torch.zeros_like(spikes)).clamp(max=1)).sum()) for k in range(n))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(clock, "AT_ONCE", 2)
        assert clock.close(spikes, n) == clock.close(spikes.float() * 0.3, n) == (following, merged)
    assert all(most <= least for most, least in zip(merged, following, strict=True))


@given(seed=st.integers(0, 200), n_steps=st.integers(1, 60), n=st.integers(1, 12))
def test_a_bin_has_a_spike_where_one_of_its_steps_has(seed, n_steps, n):
    spikes = resting(seed, n_steps, 0)
    for dtype in (torch.uint8, torch.bool, torch.float32):
        within = clock.binned(spikes.to(dtype), n)
        assert within.dtype == dtype
        for k in range(within.shape[1]):
            assert torch.equal(within[:, k] > 0, (spikes[:, k * n : (k + 1) * n] > 0).any(dim=1))


@given(
    seed=st.integers(0, 50), n_steps=st.integers(1, 60), readout=st.sampled_from(READOUTS),
    rule=st.sampled_from([FULL_WINDOW, ExitRule(10, from_first_spike=True), ExitRule(2)]),
)  # fmt: skip
def test_a_network_on_its_clock_is_the_network_of_that_clock_on_bins(seed, n_steps, readout, rule):
    spikes, own = resting(seed, n_steps, 4), network(**readout)
    slow = slow_network(own)
    ours, theirs = own.infer(spikes, rule), slow.infer(clock.binned(spikes, 5), rule.in_bins(5))
    assert torch.equal(ours.steps, (theirs.steps * 5).clamp(max=n_steps))
    for part in ("labels", "input_spikes", "hidden_spikes", "readout"):
        assert torch.equal(getattr(ours, part), getattr(theirs, part))
    for ours, theirs in zip(own(spikes), slow(clock.binned(spikes, 5)), strict=True):
        assert torch.equal(ours, theirs)


def test_time_constants_stay_in_ms():
    assert float(network(5.0).beta[0].detach()) == pytest.approx(float(network(None).beta[0].detach()) ** 5, rel=1e-5)


def test_a_patience_is_in_steps_of_the_encoder_and_counts_whole_bins():
    own, spikes = network(readout="integrator", forward_weight_scale=9.0), resting(1, 200, 4)
    found = own.infer(spikes, ExitRule(20, from_first_spike=True))
    assert (found.steps % 5 == 0).all()
    assert (found.steps >= 25).all()
    assert (found.steps < 200).any()
    later = own.infer(spikes, ExitRule(24, from_first_spike=True))  # the same whole bins
    assert torch.equal(later.steps, found.steps)


def test_the_chosen_exit_saves_whole_steps_of_the_network_and_keeps_its_word():
    own, spikes = network(readout="integrator"), resting(2, 100, 4)
    examples = Examples(spikes, own.infer(spikes).labels)
    rule = trainer.exit_of(own, examples, 0.0).rule
    assert rule.patience is not None
    assert rule.patience % 5 == 0
    assert torch.equal(own.infer(spikes, rule).labels, examples.labels)


def test_what_is_measured_is_that_of_the_network_of_that_clock_with_longer_steps(monkeypatch):
    """Accuracy, SOPs, both early exits and the curve over patience; a window is a whole number of bins."""
    own = network(readout="integrator", forward_weight_scale=9.0)
    slow = slow_network(own)
    spikes = resting(5, 100, 4)
    sides = [Examples(each, torch.tensor([0, 1, 2])) for each in (spikes, clock.binned(spikes, 5))]
    rule = ExitRule(15, from_first_spike=True)
    rows = []
    for net, examples, patience in ((own, sides[0], 50), (slow, sides[1], 10)):
        monkeypatch.setattr(measuring, "ORACLE_PATIENCE", patience)
        done = epochs.Training((epochs.Epoch(1, 0.0, 0.0, 0.0, 0.0),), epochs.Epoch(1, 0.0, 0.0, 0.0, 0.0))
        trained = trainer.Trained(net, done, rule if net is own else rule.in_bins(5))
        rows.append(measuring.measure(trained, Sides(examples, examples, examples), {"SA-I": np.array([0])})["row"])
    ours, theirs = rows
    in_steps = {"exit_steps", "exit_steps_sd", "oracle_steps", "window_steps", "exit_patience", "steps_per_bin"}
    assert ours["exit_steps"] < 100
    for key, value in theirs.items():
        assert ours[key] == pytest.approx(5 * value if key in in_steps else value), key
    windows = [truncated.simulate_windows(net, each) for net, each in zip((own, slow), sides, strict=True)]
    curves = [
        shortened.exit_curve(net, each, each, patiences)
        for net, each, patiences in zip((own, slow), windows, ([5, 7, 10, 50, 200], [1, 2, 10, 40]), strict=True)
    ]
    in_steps = {"patience", "exit_steps", "exit_steps_sd", "exit_steps_right"}
    for one, other in zip(*curves, strict=True):
        for key, value in other.items():
            expected = (
                value
                if value is None or isinstance(value, str)
                else pytest.approx(5 * value if key in in_steps else value)
            )
            assert one[key] == expected, key
    cuts = [shortened.cut_short(net, each, [25.0, 100.0]) for net, each in zip((own, slow), windows, strict=True)]
    assert cuts[0] == cuts[1]
    assert record_states(own, spikes) == record_states(slow, clock.binned(spikes, 5))


def test_neurons_are_counted_on_their_clock_and_afferents_on_theirs():
    measured = {"sops_input": 900, "sops_recurrent": 300, "sops_readout": 80}
    for how in ({}, {"readout": "integrator", "readout_tau_ms": 30.0}, {"threshold_adaptation": 0.2}):
        every, fifth = (RSNNSpec.model_validate({"hidden": 30, "step_ms": step_ms, **how}) for step_ms in (None, 5.0))
        of = {"measured": measured, "signal_ms": 150.0}
        assert network_cost(fifth, 16, 8, steps=150, **of) == network_cost(every, 16, 8, steps=30, **of)


def test_spikes_of_bins_are_shown_at_their_last_step():
    hidden = network(readout="integrator").simulate(resting(3, 23, 4)).hidden
    fine = clock.spread(hidden, 5, 23)
    assert fine.sum() == hidden.sum() > 0
    assert torch.equal(clock.binned(fine, 5), hidden)
    assert set(fine.any(dim=2).nonzero()[:, 1].tolist()) <= {4, 9, 14, 19, 22}


@pytest.mark.parametrize("dropout", [0.0, 0.2])
def test_a_batch_is_put_into_bins_once(dropout, monkeypatch):
    own = network(training={"input_dropout": dropout})
    examples = Examples(resting(1, 60, 4), torch.tensor([0, 1, 2]))
    counts, seen = own.counts, []
    monkeypatch.setattr(own, "counts", lambda spikes, *more: seen.append(spikes.shape[1]) or counts(spikes, *more))
    epochs.train(own, examples, examples, generator=torch.Generator().manual_seed(0))
    assert {*seen} == {12}


def test_initial_weights_are_scaled_on_bins():
    own, spikes = network(input_deviation=1.0, model="snn"), resting(4, 200, 4)
    initial.start(own, spikes, torch.Generator().manual_seed(0))
    dynamics = float(own.alpha[0]), float(own.beta[0])
    deviation = initial.free_deviation(own.binned(spikes), own.w_in.detach(), own.neuron, *dynamics)
    torch.testing.assert_close(deviation, torch.ones_like(deviation))


@pytest.mark.parametrize("chip", ["xyloaudio2", "loihi2"])
def test_a_chip_steps_with_the_network(chip):
    own = network()
    ours, theirs = (chips.compare(net, None, FULL_WINDOW, chip) for net in (own, slow_network(own)))
    assert ours.equals(theirs)


def test_a_network_learns_on_its_clock():
    spikes = torch.cat([resting(k, 60, 4) * torch.tensor([1, 1, k, 1 - k, 0], dtype=torch.uint8) for k in (0, 1)])
    labels = torch.tensor([0, 0, 0, 1, 1, 1])
    own = network(training={"epochs": 40, "batch": 6, "learning_rate": 0.02, "patience": 40})
    done = epochs.train(
        own, Examples(spikes, labels), Examples(spikes, labels), generator=torch.Generator().manual_seed(0)
    )
    assert done.best.train_accuracy == 1.0


@pytest.mark.parametrize("step_ms", [0.4, 2.5, 4.9])
def test_a_step_between_two_of_the_encoder_is_refused(step_ms):
    with pytest.raises(InputError, match=r"step_ms: .* is not a whole number of steps at 1000 Hz"):
        network(step_ms)


def test_a_whole_number_of_steps_is_taken_at_a_rate_that_is_no_round_number():
    assert clock.steps_per_bin(3 * 1e3 / 93.0, 93.0) == 3
