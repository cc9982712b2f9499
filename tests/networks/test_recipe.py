"""The rules by which a network is trained unless told otherwise."""

import math
import re
import warnings

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

from neurotact import spec as specs
from neurotact.networks.definition import recipe
from neurotact.networks.definition.recipe import (
    Seen,
    choices,
    free_deviation,
    resolve,
    scale_readout,
    scale_weights,
    start,
)
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.search import tuning
from neurotact.networks.training.fitting import begin
from neurotact.neurons import CubaLIF

DEFAULT = RSNNSpec(recipe="default")
seen = st.builds(Seen, st.integers(1, 100_000), st.integers(1, 100_000), st.floats(1.0, 1e5), st.floats(0.0, 1e4))


def spikes(seed: int = 0, n_trials: int = 12, n_steps: int = 30, n_in: int = 5) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    rates = torch.rand(n_trials, 1, n_in, generator=generator)
    return (torch.rand(n_trials, n_steps, n_in, generator=generator) < rates).to(torch.uint8)


def free_membranes(given_spikes, weights, neuron, alpha, beta):
    """By the equations, a step at a time: `(trial, time, neuron)`."""
    current = membrane = torch.zeros(len(given_spikes), weights.shape[1], dtype=torch.float64)
    found = []
    for arriving in given_spikes.double().unbind(dim=1):
        before, current = current, alpha * current + arriving @ weights
        if neuron.membrane == "eq4":
            membrane = beta * (membrane + before)
        elif neuron.membrane == "delayed":
            membrane = beta * membrane + before
        else:
            membrane = beta * membrane + current
        found.append(membrane)
    return torch.stack(found, dim=1)


@given(
    seed=st.integers(0, 999),
    membrane=st.sampled_from(["eq4", "delayed", "immediate"]),
    reset=st.sampled_from(["zero", "subtract", "hard"]),
    decays=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
)
@examples(25)
def test_the_deviation_is_that_of_membranes_that_never_fire(seed, membrane, reset, decays):
    neuron, weights = CubaLIF(membrane, reset), torch.randn(5, 3, dtype=torch.float64)
    found = free_deviation(spikes(seed), weights, neuron, *decays)
    flat = free_membranes(spikes(seed), weights, neuron, *decays).flatten(0, 1)
    torch.testing.assert_close(found, flat.std(dim=0, correction=0))


@given(seed=st.integers(0, 999), g=st.floats(1e-3, 1e3), deviation=st.floats(0.1, 10.0))
@examples(25)
def test_every_hidden_neuron_deviates_as_asked_whatever_was_drawn(seed, g, deviation):
    table = {"hidden": 6, "readout": "integrator", "input_deviation": deviation, "forward_weight_scale": g}
    net = RSNN(5, 3, RSNNSpec(**table), 400.0, backend="reference", generator=torch.Generator().manual_seed(seed))
    scale_weights(net, spikes(seed))
    scale_readout(net, spikes(seed))
    alpha, beta = float(net.alpha[0]), float(net.beta[0])
    flat = free_membranes(spikes(seed), net.w_in.detach().double(), net.neuron, alpha, beta).flatten(0, 1)
    torch.testing.assert_close(flat.std(dim=0, correction=0), torch.full((6,), deviation).double(), rtol=1e-4, atol=0)
    with torch.no_grad():
        sums = net(spikes(seed))
    if sums.hidden.std(dim=0).any():
        assert float(sums.readout.std(dim=0, correction=0).mean()) == pytest.approx(1.0, rel=1e-3)


def begun(given_spikes: torch.Tensor, seed: int = 0, **table) -> tuple[RSNN, dict[str, torch.Tensor]]:
    """A network after `start`, and its weights before."""
    generator = torch.Generator().manual_seed(seed)
    spec = RSNNSpec(**{"readout": "integrator", "input_deviation": 1.0, "hidden": 12} | table)
    net = RSNN(5, 3, spec, 400.0, backend="reference", generator=generator)
    before = {name: tensor.clone() for name, tensor in net.state_dict().items()}
    start(net, given_spikes, generator)
    return net, before


def test_where_nothing_is_heard_the_weights_stay():
    net, before = begun(torch.zeros(4, 30, 5, dtype=torch.uint8))
    assert all(torch.equal(tensor, before[name]) for name, tensor in net.state_dict().items())


def test_weights_stay_as_drawn_unless_a_deviation_is_asked_for():
    net, before = begun(spikes(), input_deviation=None)
    assert all(torch.equal(tensor, before[name]) for name, tensor in net.state_dict().items())


def test_the_windows_that_are_looked_at_are_spread_over_all(monkeypatch):
    monkeypatch.setattr(recipe, "LOOKED_AT", 3)
    looked = []
    monkeypatch.setattr(recipe, "free_deviation", lambda some, *_: looked.append(some) or free_deviation(some, *_))
    begun(spikes(n_trials=9))
    assert torch.equal(looked[0], spikes(n_trials=9)[::3])


def test_silent_hidden_neurons_are_drawn_anew_and_said(monkeypatch):
    scaled = recipe.scale_weights

    def silencing(net, some):
        """The first time, most neurons get weights that never fire."""
        scaled(net, some)
        if not calls:
            net.w_in[:, :10] = -net.w_in[:, :10].abs()
        calls.append(1)

    calls = []
    monkeypatch.setattr(recipe, "scale_weights", torch.no_grad()(silencing))
    with pytest.warns(UserWarning, match="1[0-2] of 12 hidden neurons were silent"):
        net, _ = begun(spikes(n_steps=200))
    with torch.no_grad():
        assert int(net(spikes(n_steps=200)).hidden.any(dim=0).sum()) >= 10


@pytest.mark.filterwarnings("default")
def test_recurrence_that_explodes_begins_smaller_and_is_said():
    long = spikes(n_steps=200)
    wild = {"model": "rsnn", "recurrent_weight_scale": 30.0, "tau_mem_ms": 200.0, "surrogate_scale": 1.0}
    with pytest.warns(UserWarning, match="recurrent weights are [0-9]+ times smaller"):
        net, before = begun(long, **wild)
    ratio = (before["w_rec"] / net.w_rec.detach()).flatten()
    assert ratio[0] >= 2
    torch.testing.assert_close(ratio, ratio[0].expand_as(ratio))
    with torch.no_grad():
        alone = RSNN(5, 3, net.spec.model_copy(update={"model": "snn"}), 400.0, backend="reference")
        alone.load_state_dict({k: v for k, v in net.state_dict().items() if k != "w_rec"})
    assert recipe._gradient_norm(net, long) <= recipe.EXPLODES * recipe._gradient_norm(alone, long)


def test_a_recurrence_that_does_not_explode_stays_as_drawn():
    net, before = begun(spikes(), model="rsnn")
    assert torch.equal(net.w_rec, before["w_rec"])


@given(seen)
def test_every_choice_is_a_spec_without_a_recipe(given_seen):
    chosen = resolve(DEFAULT, given_seen)
    assert chosen.recipe is None
    assert resolve(chosen, given_seen) is chosen
    assert specs.build(RSNNSpec, chosen.model_dump(mode="json"), "saved") == chosen


@given(seen, st.integers(1, 20))
def test_constants_are_shares_of_the_window_on_any_clock(given_seen, finer):
    coarse = resolve(DEFAULT, given_seen)
    steps, rate_Hz = finer * given_seen.steps, finer * given_seen.sampling_rate_Hz
    on_finer = given_seen._replace(steps=steps, sampling_rate_Hz=rate_Hz)
    fine = resolve(DEFAULT, on_finer)
    if given_seen.steps >= 50:  # else a step bounds them
        assert fine.tau_mem_ms == pytest.approx(coarse.tau_mem_ms, rel=1e-3)
        assert fine.tau_syn_ms == pytest.approx(coarse.tau_syn_ms, rel=1e-3)
    step_ms = 1e3 / given_seen.sampling_rate_Hz
    assert min(coarse.tau_mem_ms, coarse.tau_syn_ms) >= step_ms * (1 - 1e-3)


@given(seen)
def test_spikes_are_disturbed_where_they_are_few(given_seen):
    training = resolve(DEFAULT, given_seen).training
    disturbed = (training.input_dropout, training.input_jitter_ms, training.readout_dropout)
    assert all(disturbed) if given_seen.spikes < recipe.SPARSE else not any(disturbed)


@given(seen)
def test_a_small_set_is_trained_for_as_many_steps_as_a_large_one(given_seen):
    training = resolve(DEFAULT, given_seen).training
    steps = training.epochs * math.ceil(given_seen.windows / training.batch)
    assert steps >= recipe.LEAST_STEPS
    assert training.epochs >= recipe.EPOCHS
    assert training.patience >= training.epochs
    assert training.epochs == recipe.EPOCHS or steps < recipe.LEAST_STEPS + math.ceil(given_seen.windows / 32)
    assert steps <= recipe.MOST_STEPS


@pytest.mark.parametrize(
    "given_keys",
    [
        {"tau_mem_ms": 20.0},  # also where it is what the model has without a recipe
        {"model": "rsnn", "readout": "count"},
        {"training": {"epochs": 3, "schedule": "constant"}},
    ],
)
def test_what_is_given_is_not_chosen(given_keys):
    asked = specs.build(RSNNSpec, {"recipe": "default", **given_keys}, "test")
    again = specs.build(RSNNSpec, asked.model_dump(mode="json"), "written and read")
    at = Seen(900, 1000, 1000.0, 50.0)
    for spec in (asked, again):
        chosen = resolve(spec, at).model_dump()
        flat = given_keys | {"training": {}} | {f"training.{k}": v for k, v in given_keys.get("training", {}).items()}
        for key, value in flat.items():
            if key.startswith("training."):
                assert getattr(resolve(spec, at).training, key.removeprefix("training.")) == value
            elif key != "training":
                assert getattr(resolve(spec, at), key) == value
        told = " ".join(recipe.described(spec, at))
        assert not any(f"{key} = " in told for key in flat if key != "training")
        assert chosen["training"]["relative_learning_rate"] == 0.05


def test_what_is_chosen_is_told_line_by_line():
    at = Seen(900, 1000, 1000.0, 50.0)
    told = list(recipe.described(DEFAULT, at))
    assert len(told) == len(choices(at))
    assert "tau_mem_ms = 50.0 (a twentieth of the window, at least one step)" in told
    assert list(recipe.described(RSNNSpec(), at)) == []


def test_a_slower_clock_that_is_asked_for_says_what_it_merges():
    spikes = torch.zeros(4, 400, 2, dtype=torch.uint8)
    spikes[:, ::4] = 1
    with pytest.warns(UserWarning, match=r"training: 50 % of the input spikes .* step_ms = 4 merges none"):
        begin(spikes, 2, RSNNSpec(step_ms=8.0), 1000.0, torch.Generator())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        begin(spikes, 2, RSNNSpec(step_ms=4.0), 1000.0, torch.Generator())


def test_the_default_network_has_the_recipe_and_little_else():
    assert specs.load(RSNNSpec, "default").model_dump(mode="json") == {"recipe": "default", "hidden": 50}


# --- the search space around the choices ------------------------------------------------------------------


@given(seen=seen, hidden=st.integers(1, 1024), effort=st.sampled_from(["quick", "default", "best"]))
def test_a_space_holds_what_is_chosen_and_nothing_that_a_network_cannot_have(seen, hidden, effort):
    hidden = max(1, hidden // 3) if effort == "best" else hidden
    asked = RSNNSpec(recipe="default", hidden=hidden, effort=effort)
    space = recipe.space(asked, seen)
    tuning.check(space, asked, source="space")
    chosen = tuning.values_of(recipe.first_of(asked, seen), space)
    assert {*chosen} == {*space}
    assert all(chosen[key] in dimension["_value"] for key, dimension in space.items())
    assert all(len(dimension["_value"]) > 1 for dimension in space.values() if hidden > 1)
    assert min(space["tau_syn_ms"]["_value"]) >= recipe._short(1e3 / seen.sampling_rate_Hz)


def test_what_is_given_is_not_searched_and_recurrence_only_where_it_is_chosen():
    asked = RSNNSpec.model_validate({"recipe": "default", "tau_mem_ms": 7.0, "training": {"input_dropout": 0.3}})
    short, long = (recipe.space(asked, Seen(100, steps, 1000.0, 3.0)) for steps in (200, 2000))
    assert not {"tau_mem_ms", "training.input_dropout"} & {*short, *long}
    assert {*short} - {*long} == {"model", "training.rate_penalty"}


@pytest.mark.parametrize("n_spikes", [3.0, 30.0])
@pytest.mark.parametrize("rate_Hz", [35.61, 93.0, 150.0, 200.0, 1000.0])
def test_the_reason_of_the_clock_names_no_bound_that_it_exceeds(rate_Hz, n_spikes):
    (clock,) = (one for one in recipe.choices(Seen(90, round(rate_Hz), rate_Hz, n_spikes, 9)) if one.key == "step_ms")
    named = re.match(r"at most ([\d.]+) ms", clock.why)
    assert (named is None) == (1e3 / rate_Hz > (5 if n_spikes < 5 else 10))
    assert named is None or clock.value <= float(named[1])


@pytest.mark.parametrize(
    ("seen", "step_ms", "stretches", "model"),
    [
        (Seen(900, 1000, 1000.0, 50.0, apart=12), 10.0, 4, "snn"),  # a hundredth of the window at most
        (Seen(900, 4000, 1000.0, 50.0, apart=40), 20.0, 4, "snn"),  # 20 ms at most
        (Seen(900, 300, 1000.0, 50.0, apart=12), 5.0, 4, "snn"),  # 5 ms in short windows
        (Seen(900, 1000, 1000.0, 50.0, apart=3), 3.0, 4, "snn"),  # no spike is lost
        (Seen(900, 300, 2000.0, 20.0, apart=20), 5.0, 4, "snn"),
        (Seen(900, 60, 1000.0, 20.0, apart=6), 2.0, 4, "snn"),  # 30 steps at least
        (Seen(900, 1300, 1000.0, 2.0, apart=12), 5.0, 1, "auto"),  # ... and is kept
        (Seen(900, 4000, 1000.0, 2.0, apart=40), 20.0, 1, "snn"),  # too long to remember at 5 ms
        (Seen(900, 260, 200.0, 2.0, apart=9), 5.0, 1, "auto"),  # few spikes: an order may have to be remembered
        (Seen(900, 1300, 1000.0, 2.0, apart=1), 1.0, 1, "snn"),  # too many steps to remember
    ],
)
def test_the_clock_the_stretches_and_recurrence_follow_the_spikes(seen, step_ms, stretches, model):
    chosen = recipe.resolve(RSNNSpec(recipe="default"), seen)
    assert (chosen.step_ms, chosen.readout_stretches, chosen.model) == (step_ms, stretches, model)


@given(
    steps=st.integers(1, 3000), rate=st.sampled_from([35.6, 93.0, 200.0, 1000.0, 2000.0, 2713.7]),
    apart=st.integers(1, 40), spikes=st.floats(0, 100), keys=st.sampled_from([
        {}, {"readout": "count"}, {"readout": "max"}, {"readout_tau_ms": 9.0}, {"readout_stretches": 7},
        {"readout": "integrator", "readout_stretches": 1}, {"step_ms": "encoder"},
    ]),
)  # fmt: skip
@examples(60)
def test_what_is_chosen_beside_given_keys_is_a_network(steps, rate, apart, spikes, keys):
    seen = Seen(100, steps, rate, spikes, apart)
    chosen = recipe.resolve(RSNNSpec(recipe="default", **keys), seen)
    network = RSNN(2, 2, recipe.first_of(chosen, seen), rate)
    longest = max(5e-3, min(20e-3, steps / rate / 100))
    assert network.steps_per_bin <= (1 if "step_ms" in keys else max(1, min(apart, steps // 30, longest * rate)))
    assert {key: getattr(chosen, key) for key in keys} == keys
    if network.stretches is not None:
        n_bins = -(-steps // network.steps_per_bin)
        assert network.stretches.of_step(n_bins - 1) <= network.stretches.number - 1
        assert network.stretches.steps * network.stretches.number >= n_bins
