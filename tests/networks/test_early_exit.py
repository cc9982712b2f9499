import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.networks.exit.patience import (
    exits,
    is_right,
    least,
    oracle_exit,
    patience_rule,
    printed_exits,
    steady,
)
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule


def right_of(decisions, true) -> torch.Tensor:
    return is_right(decisions, true).sum(dim=0)


def least_rule(raster, true, tolerance: float = 0.0) -> ExitRule:
    return patience_rule(least(right_of(exits(raster), true), len(true), tolerance))


def algorithm_1_for_loop(T_D: np.ndarray, Patience: int, *, resets_count: bool = True) -> tuple[int, int] | None:
    """Lines 2 to 20 of the texture paper's Algorithm 1: (Time_new, index_op); line 17 is read as count = 0, or not."""
    M = T_D[0]
    i_max_prev = int(np.argmax(M))
    count = 0
    for i in range(2, len(T_D) + 1):
        M = T_D[:i].sum(axis=0)
        i_max = int(np.argmax(M))
        if i_max == i_max_prev:
            count += 1
            if count == Patience:
                return i, i_max
        else:
            count = 0 if resets_count else count
            i_max_prev = i_max
    return None


def algorithm_1(T_D: np.ndarray, index_true: int, Patience: int) -> tuple[int, int]:
    """The whole of it, Patience adjusted by one upward; no exit is the full window."""
    full = len(T_D), int(np.argmax(T_D.sum(axis=0)))
    while True:
        Time_new, index_op = algorithm_1_for_loop(T_D, Patience) or full
        if index_op == index_true or Patience > len(T_D):
            return Time_new, index_op
        Patience += 1


def from_first_spike(T_D: np.ndarray, Patience: int) -> tuple[int, int]:
    """`validated`: the same loop over what follows the first readout spike."""
    full = len(T_D), int(np.argmax(T_D.sum(axis=0)))
    if not T_D.any():
        return full
    silent = int(np.argmax(T_D.any(axis=1)))
    found = algorithm_1_for_loop(T_D[silent:], Patience)
    return full if found is None else (silent + found[0], found[1])


def by_rule(T_D: np.ndarray, rule: ExitRule) -> tuple[int, int]:
    if rule.patience is None:
        return len(T_D), int(np.argmax(T_D.sum(axis=0)))
    if rule.from_first_spike:
        return from_first_spike(T_D, rule.patience)
    return algorithm_1_for_loop(T_D, rule.patience) or (len(T_D), int(np.argmax(T_D.sum(axis=0))))


@st.composite
def readouts(draw, most_steps: int = 25) -> np.ndarray:
    """Rasters of readouts, often silent for a while, with leads that change."""
    shape = draw(st.integers(1, 6)), draw(st.integers(1, most_steps)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    raster = rng.random(shape) < draw(st.sampled_from([0.02, 0.1, 0.3, 0.6]))
    raster[:, : draw(st.integers(0, shape[1]))] = 0
    return raster.astype(np.uint8)


rules = st.builds(ExitRule, st.none() | st.integers(1, 27), st.booleans())


def relay(n: int) -> RSNN:
    """A network whose readout repeats its input in the same step, so that any raster can be raced."""
    spec = RSNNSpec(hidden=n, membrane="immediate", reset="subtract")
    network = RSNN(n, n, spec, 2000.0, backend="reference")
    with torch.no_grad():
        for weights, value in ((network.w_in, 3.0), (network.w_rec, 0.0), (network.w_out, 3.0)):
            weights.copy_(value * torch.eye(n))
        network.alpha.zero_()
        network.beta.zero_()
    # U = 3 x, and 3 x - 1 after a spike: above 1 with an input, not without, whatever came before.
    return network


def lively(seed: int = 0, **spec) -> tuple[RSNN, torch.Tensor]:
    spec = RSNNSpec(hidden=12, forward_weight_scale=3.0, recurrent_weight_scale=0.3, **spec)
    generator = torch.Generator().manual_seed(seed)
    network = RSNN(6, 4, spec, 2000.0, backend="reference", generator=generator, dtype=torch.float64)
    return network, (torch.rand(20, 80, 6, generator=generator) < 0.2).to(torch.uint8)


@given(readouts(), rules)
@examples(80)
def test_inference_stops_where_algorithm_1_does(raster, rule):
    network = relay(raster.shape[2])
    spikes = torch.from_numpy(raster)
    assert torch.equal(network.simulate(spikes).readout, spikes.float())
    decided = network.infer(spikes, rule)
    for trial, T_D in enumerate(raster):
        steps, label = by_rule(T_D, rule)
        assert decided.steps[trial] == steps
        assert decided.labels[trial] == label
        assert decided.readout[trial].tolist() == T_D[:steps].sum(axis=0).tolist()
        assert decided.input_spikes[trial] == T_D[:steps].sum()


@given(readouts(), st.booleans())
@examples(60)
def test_exits_of_every_patience_are_those_of_algorithm_1(raster, since_spike):
    found = exits(raster, from_first_spike=since_spike)
    assert found.steps.shape == raster.shape[:2]
    for trial, T_D in enumerate(raster):
        for patience in range(1, raster.shape[1] + 1):
            at = int(found.steps[trial, patience - 1]), int(found.labels[trial, patience - 1])
            assert at == by_rule(T_D, ExitRule(patience, since_spike))


@given(readouts(), st.integers(1, 30), st.integers(0, 2**32))
@examples(80)
def test_the_oracle_is_algorithm_1_with_the_true_label(raster, patience, seed):
    true = np.random.default_rng(seed).integers(0, raster.shape[2], len(raster))
    found = oracle_exit(raster, true, patience)
    for trial, T_D in enumerate(raster):
        at = int(found.steps[trial]), int(found.labels[trial])
        assert at == algorithm_1(T_D, int(true[trial]), patience)


@given(readouts(), st.integers(0, 2**32), st.sampled_from([0.0, 0.01, 0.2, 1.0]))
@examples(60)
def test_the_rule_is_the_least_that_keeps_the_accuracy(raster, seed, tolerance):
    true = np.random.default_rng(seed).integers(0, raster.shape[2], len(raster))

    def right(rule: ExitRule) -> int:
        return sum(by_rule(T_D, rule)[1] == label for T_D, label in zip(raster, true, strict=True))

    rule = least_rule(raster, true, tolerance)
    assert rule.from_first_spike
    assert rule.patience is not None
    floor = right(FULL_WINDOW) - tolerance * len(raster) - 1e-9
    assert right(rule) >= floor
    assert all(right(ExitRule(p, True)) < floor for p in range(1, rule.patience))


@given(readouts(), readouts(), st.integers(0, 2**32), st.sampled_from([0.0, 0.1, 0.34]))
def test_no_patience_above_the_steady_one_loses_more_than_it_may(one, other, seed, tolerance):
    """And it is the least of that kind, at least what `least` takes."""
    steps, classes = (min(a, b) for a, b in zip(one.shape[1:], other.shape[1:], strict=True))
    draw, right, sizes = np.random.default_rng(seed), [], []
    for raster in (one[:, :steps, :classes], other[:, :steps, :classes]):
        true = torch.from_numpy(draw.integers(0, classes, len(raster)))
        right.append(right_of(exits(raster), true))
        sizes.append(len(raster))
        assert right[-1].tolist() == (exits(raster).labels == true[:, None]).sum(dim=0).tolist()
        if len(right) == 1:
            lowest = least_rule(raster, true, tolerance)
    patience = patience_rule(steady(right[0], sizes[0], right[1], sizes[1], tolerance)).patience
    lost = [
        max((w[-1] - w[p]).item() / n for w, n in ((right[0], sizes[0]), (right[0] + right[1], sum(sizes))))
        for p in range(steps)
    ]
    assert all(loss <= tolerance + 1e-9 for loss in lost[patience - 1 :])
    assert patience == 1 or lost[patience - 2] > tolerance
    assert patience >= lowest.patience


@pytest.mark.parametrize("n_right", range(1, 11))
def test_a_loss_of_exactly_the_tolerance_is_accepted(n_right):
    """One trial of ten, which float32 makes 0.10000002 for some counts."""
    losing, none = torch.tensor([n_right - 1, n_right]), torch.zeros(2, dtype=torch.int64)
    assert steady(losing, 10, none, 0, 0.1) == least(losing, 10, 0.1) == 0
    assert steady(losing, 10, none, 0, 0.09) == least(losing, 10, 0.09) == 1


def test_the_curve_of_exits_worked_by_hand():
    # Class 1 leads from step 1, class 0 draws level at step 4 and, being lower, leads; then class 1 again at 6.
    one = [[0, 1], [0, 0], [0, 0], [1, 0], [0, 0], [0, 1]]
    found = exits(torch.tensor([one]))
    assert found.steps.tolist() == [[2, 3, 6, 6, 6, 6]]
    assert right_of(found, torch.tensor([1])).tolist() == [1] * 6
    assert least_rule(torch.tensor([one]), torch.tensor([1])) == ExitRule(1, from_first_spike=True)
    # Two trials: the second is led by class 1 until its last step, and truly class 0.
    other = [[0, 1], [0, 0], [0, 0], [0, 0], [0, 0], [1, 0]]
    found = exits(torch.tensor([one, other]))
    assert found.steps.sum(dim=0).tolist() == [4, 6, 10, 11, 12, 12]
    assert right_of(found, torch.tensor([1, 0])).tolist() == [1, 1, 1, 1, 2, 2]
    assert least_rule(torch.tensor([one, other]), torch.tensor([1, 0])).patience == 5
    assert least_rule(torch.tensor([one, other]), torch.tensor([1, 0]), tolerance=0.5).patience == 1


@given(readouts())
@examples(40)
def test_algorithm_1_to_the_letter_counts_every_unchanged_step(raster):
    """It never exits later than with a count that is reset."""
    found, meant = printed_exits(raster), exits(raster, from_first_spike=False)
    for trial, T_D in enumerate(raster):
        full = len(T_D), int(np.argmax(T_D.sum(axis=0)))
        for patience in range(1, len(T_D) + 1):
            at = int(found.steps[trial, patience - 1]), int(found.labels[trial, patience - 1])
            assert at == (algorithm_1_for_loop(T_D, patience, resets_count=False) or full)
    assert (found.steps <= meant.steps).all()


def test_the_oracle_worked_by_hand():
    raster = torch.tensor([[[0, 0], [0, 0], [0, 1], [0, 0], [0, 0]]] * 2)
    found = oracle_exit(raster, torch.tensor([1, 0]), patience=1)
    # A silent readout is led by class 0: at once right for trial 1. Trial 0 exits wrongly with patience 1; with 2,
    # class 1 leads from step 3 and has stood two steps more at 5.
    assert found.steps.tolist() == [5, 2]
    assert found.labels.tolist() == [1, 0]
    assert found.patience.tolist() == [2, 1]
    never = oracle_exit(torch.tensor([[[0, 1], [0, 0], [0, 0]]]), torch.tensor([0]), patience=1)
    assert [int(part) for part in never] == [3, 1, 3]


@pytest.mark.parametrize("membrane", ["eq4", "delayed", "immediate"])
@pytest.mark.parametrize("since_spike", [False, True])
@pytest.mark.parametrize("delay", [0, 1])
def test_infinite_patience_is_the_full_window(membrane, since_spike, delay):
    network, spikes = lively(membrane=membrane, recurrent_delay_steps=delay)
    counts, rasters = network(spikes), network.simulate(spikes)
    full = network.infer(spikes)
    for rule in (FULL_WINDOW, ExitRule(None, since_spike), ExitRule(80, since_spike)):
        decided = network.infer(spikes, rule)
        assert all(torch.equal(a, b) for a, b in zip(decided, full, strict=True))
    assert (full.steps == 80).all()
    assert torch.equal(full.labels, counts.readout.argmax(dim=1))
    assert torch.equal(full.readout, counts.readout.long())
    assert torch.equal(full.input_spikes, spikes.sum(dim=(1, 2)))
    assert torch.equal(full.hidden_spikes, rasters.hidden.sum(dim=(1, 2)).long())
    assert full.readout.sum() > 100  # the network did speak


@pytest.mark.parametrize("delay", [0, 1])
def test_only_simulated_steps_are_computed_and_counted(delay):
    network, spikes = lively(recurrent_delay_steps=delay)
    rasters, rule = network.simulate(spikes), ExitRule(15, from_first_spike=True)
    worked = 0

    def counting(x: torch.Tensor) -> torch.Tensor:
        nonlocal worked
        worked += len(x)
        return FastSigmoid()(x)

    network.spike = counting
    decided = network.infer(spikes, rule)
    assert 16 < decided.steps.min() < decided.steps.max()
    assert decided.steps.double().mean() < 60
    assert worked == 2 * decided.steps.sum()  # two layers, a row for each trial that still runs
    for trial, steps in enumerate(decided.steps.tolist()):
        T_D = rasters.readout[trial].detach().numpy()
        assert (steps, int(decided.labels[trial])) == by_rule(T_D, rule)
        assert decided.input_spikes[trial] == spikes[trial, :steps].sum()
        assert decided.hidden_spikes[trial] == rasters.hidden[trial, :steps].sum()
        assert decided.readout[trial].tolist() == rasters.readout[trial, :steps].sum(dim=0).tolist()


def test_exits_agree_with_inference_of_a_real_network():
    network, spikes = lively(seed=3)
    found = exits(network.simulate(spikes).readout)
    for patience in (1, 7, 30):
        decided = network.infer(spikes, ExitRule(patience, from_first_spike=True))
        assert torch.equal(decided.steps, found.steps[:, patience - 1])
        assert torch.equal(decided.labels, found.labels[:, patience - 1])


def test_a_window_of_no_steps_decides_the_first_class():
    network, spikes = lively()
    decided = network.infer(spikes[:, :0])
    assert not any(part.any() for part in decided)


def test_what_makes_no_sense_is_refused():
    raster, labels = torch.zeros(2, 5, 3), torch.zeros(2, dtype=torch.int64)
    with pytest.raises(InputError, match="patience: must be >= 1"):
        ExitRule(0)
    with pytest.raises(InputError, match="patience: must be >= 1"):
        oracle_exit(raster, labels, 0)
    with pytest.raises(InputError, match="tolerance"):
        least_rule(raster, labels, -0.1)
    with pytest.raises(InputError, match="labels: have shape"):
        least_rule(raster, labels[:1])
    with pytest.raises(InputError, match="zeros and ones"):
        exits(raster + 2)
    with pytest.raises(InputError, match="rasters: have shape"):
        exits(raster[:, :0])
