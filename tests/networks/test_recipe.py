"""The rules by which a network is trained unless told otherwise."""

import math
import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.braille.reader import read as read_letters

from neurotact import spec as specs
from neurotact.data.windows import Windows
from neurotact.networks.definition import clock, initial, recipe
from neurotact.networks.definition import space as spaces
from neurotact.networks.definition.initial import free_deviation, scale_readout, scale_weights, start
from neurotact.networks.definition.recipe import Seen, choices, resolve
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training.trainer import begin
from neurotact.neurons import CubaLIF

DATA = Path(os.environ.get("NEUROTACT_DATA", Path(__file__).parents[3] / "shared" / "data"))
LETTERS = DATA / "braille-th10" / "events.npz"
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
    monkeypatch.setattr(initial, "LOOKED_AT", 3)
    looked = []
    monkeypatch.setattr(initial, "free_deviation", lambda some, *_: looked.append(some) or free_deviation(some, *_))
    begun(spikes(n_trials=9))
    assert torch.equal(looked[0], spikes(n_trials=9)[::3])


def test_silent_hidden_neurons_are_drawn_anew_and_said(monkeypatch):
    scaled = initial.scale_weights

    def silencing(net, some):
        """The first time, most neurons get weights that never fire."""
        scaled(net, some)
        if not calls:
            net.w_in[:, :10] = -net.w_in[:, :10].abs()
        calls.append(1)

    calls = []
    monkeypatch.setattr(initial, "scale_weights", torch.no_grad()(silencing))
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
    assert initial._gradient_norm(net, long) <= initial.EXPLODES * initial._gradient_norm(alone, long)


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
    assert all(disturbed) if given_seen.spikes < 5.99 else not any(disturbed) or given_seen.spikes < recipe.ENOUGH


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


def test_of_a_network_that_was_kept_what_has_an_effect_is_told_as_it_has_it():
    at = Seen(900, 1000, 1000.0, 50.0)
    kept = recipe.resolve(DEFAULT, at).model_copy(update={"hidden": 0, "direct": False, "readout_stretches": 8})
    told = [line.partition(" (")[0] for line in recipe.described(DEFAULT, at, kept)]
    assert {"hidden = 0", "readout_stretches = 8"} <= {*told}
    assert "hidden = 0 (that of the network which validation windows chose)" in recipe.described(DEFAULT, at, kept)
    assert not any(line.startswith(("training.", "tau_mem_ms", "surrogate")) for line in told)


def test_a_slower_clock_that_is_asked_for_says_what_it_merges():
    spikes = torch.zeros(4, 400, 2, dtype=torch.uint8)
    spikes[:, ::4] = 1
    with pytest.warns(UserWarning, match=r"training: 400 of 800 input spikes \(50 %\) .* step_ms = 4 merges none"):
        begin(spikes, 2, RSNNSpec(step_ms=8.0), 1000.0, torch.Generator())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        begin(spikes, 2, RSNNSpec(step_ms=4.0), 1000.0, torch.Generator())


def test_the_default_network_has_the_recipe_and_little_else():
    assert specs.load(RSNNSpec, "default").model_dump(mode="json") == {"recipe": "default"}


# --- the search space around the choices ------------------------------------------------------------------


@given(seen=seen, hidden=st.integers(1, 1024), effort=st.sampled_from(["quick", "default", "best"]))
def test_a_space_holds_what_is_chosen_and_nothing_that_a_network_cannot_have(seen, hidden, effort):
    hidden = max(1, hidden // 3) if effort == "best" else hidden
    asked = RSNNSpec(recipe="default", hidden=hidden, effort=effort)
    space = recipe.space(asked, seen)
    spaces.check(space, asked, source="space")
    chosen = spaces.values_of(recipe.first_of(asked, seen), space)
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
        (Seen(900, 1300, 1000.0, 2.0, apart=1), 5.0, 1, "auto"),  # 300 steps at most, whatever that merges
        (Seen(900, 651, 500.0, 2.0, apart=2), 6.0, 1, "auto"),
        (Seen(900, 1501, 1000.0, 2.0, apart=5), 5.0, 1, "snn"),  # too long to remember
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
    most = min(max(min(apart, longest * rate), math.ceil(steps / 300) if seen.must_remember else 0), steps // 30)
    assert network.steps_per_bin <= (1 if "step_ms" in keys else max(1, most))
    assert {key: getattr(chosen, key) for key in keys} == keys
    if network.stretches is not None:
        n_bins = -(-steps // network.steps_per_bin)
        assert network.stretches.of_step(n_bins - 1) <= network.stretches.number - 1
        assert network.stretches.steps * network.stretches.number >= n_bins


# --- a thousandth of the data -----------------------------------------------------------------------------


def chosen_at(seen: Seen, **given) -> dict:
    """Each key of the resolved network, dotted."""
    spec = specs.build(RSNNSpec, specs.override({"recipe": "default"}, given), "test")
    return specs.leaves(resolve(spec, seen).model_dump(mode="json"))


def resting(seed: int, n_steps: int, spikes: float, rest: int) -> torch.Tensor:
    """Events of 30 windows and afferents, `spikes` per window or fewer, which rest for some steps after each."""
    generator = torch.Generator().manual_seed(seed)
    events = (torch.rand(30, n_steps, 30, generator=generator) < spikes / n_steps).to(torch.uint8)
    for step in range(1, n_steps):
        events[:, step] &= 1 - events[:, max(0, step - rest) : step].amax(dim=1) if rest else 1
    return events


def perturbed(events: torch.Tensor, seed: int, sign: int) -> torch.Tensor:
    """A thousandth of the events, one at least, dropped (-1) or added (1)."""
    generator, changed = torch.Generator().manual_seed(seed), events.clone().flatten()
    among = (changed == (sign < 0)).nonzero()[:, 0]
    n_changed = max(1, int(1e-3 * int(events.sum())))
    changed[among[torch.randperm(len(among), generator=generator)[:n_changed]]] = int(sign > 0)
    return changed.view_as(events)


@given(
    seed=st.integers(0, 999), n_steps=st.integers(100, 2000), n_spikes=st.floats(1.0, 40.0), rest=st.integers(0, 8),
    sign=st.sampled_from([-1, 1]),
)  # fmt: skip
@examples(20)
def test_a_thousandth_of_the_events_decides_nothing(seed, n_steps, n_spikes, rest, sign):
    events = resting(seed, n_steps, n_spikes, rest)
    before, after = (Seen.of(each, 1000.0) for each in (events, perturbed(events, seed, sign)))
    assume(all(abs(before.spikes / edge - 1) > 0.01 for edge in (recipe.FEW, recipe.ENOUGH)))  # in the next tests
    if before.steps_per_bin != after.steps_per_bin:
        least, most = sorted((before.steps_per_bin, after.steps_per_bin))
        is_at_limit = abs(clock.close(events, most).following[least] / before.n_spikes - recipe.MERGED) < 1e-3
        assert most == least + 1
        assert is_at_limit or 0 < before.few < 1
    same_clock = {"step_ms": float(before.steps_per_bin)}
    ours, theirs = (chosen_at(each, **same_clock) for each in (before, after))
    assert ours.keys() == theirs.keys()
    for key, value in ours.items():
        assert theirs[key] == (pytest.approx(value, rel=1e-2, abs=1e-2) if isinstance(value, float) else value), key


@pytest.mark.parametrize("steps", [300, 1300, 4000])
@pytest.mark.parametrize("edge", [recipe.FEW, recipe.ENOUGH])
@pytest.mark.parametrize("apart", [1, 20])
def test_where_rules_begin_and_end_they_have_faded(apart, edge, steps):
    """Both sides differ in what validation decides, in stretches that hardly learn yet, and in a step of the clock."""
    fewer, more = (chosen_at(Seen(900, steps, 1000.0, edge + by, apart)) for by in (-1e-3, 1e-3))
    differing = {key for key in fewer.keys() | more.keys() if fewer.get(key) != more.get(key)}
    if edge == recipe.FEW:
        assert (fewer["readout_stretches"], more["readout_stretches"]) == (1, 4)
        assert more["training.stretch_rate"] < 1e-3 * fewer["training.stretch_rate"]
        differing -= {"readout_stretches", "training.stretch_rate"}
    else:
        assert (fewer["model"], more["model"]) == ("auto" if steps <= 1500 else "snn", "snn")
        differing -= {"model"}
    assert abs(more["step_ms"] - fewer["step_ms"]) <= 1
    for key in differing - {"step_ms", "readout_stretch_ms"}:
        assert more[key] == pytest.approx(fewer[key], rel=2e-3, abs=2e-2), key


@given(
    window_ms=st.integers(4, 260).map(lambda n: 10 * n), spikes=st.floats(0.0, 10.0),
    aparts=st.tuples(st.integers(1, 20), st.integers(1, 20)), rates_Hz=st.permutations([100.0, 200.0, 500.0, 1000.0]),
)  # fmt: skip
def test_recurrence_is_tried_whatever_the_clock_and_the_closest_spikes(window_ms, spikes, aparts, rates_Hz):
    one, other = (
        Seen(900, round(window_ms * 1e-3 * rate_Hz), rate_Hz, spikes, apart)
        for rate_Hz, apart in zip(rates_Hz, aparts, strict=False)
    )
    assert one.must_remember == other.must_remember
    assert one.must_remember == (window_ms <= 1500 and spikes < recipe.ENOUGH)
    assert {chosen_at(each)["model"] for each in (one, other)} == {"auto" if one.must_remember else "snn"}
    if one.few == 1 and one.must_remember:  # recurrence over more steps learns badly
        assert all(math.ceil(each.steps / each.steps_per_bin) <= 300 for each in (one, other))


def test_a_rare_pair_of_spikes_is_merged_and_counted_once():
    events = torch.zeros(4, 1000, 3, dtype=torch.uint8)
    events[:, ::10] = 1
    events[0, 1, 0] = 1
    at = Seen.of(events, 1000.0)
    assert (at.apart, at.n_spikes, at.merging[-1]) == (10, 1201, 1)
    told = "1 of 1,201 input spikes (0.083 %) lie in one step of the network with another of the same afferent, and"
    for spec in (DEFAULT, RSNNSpec(step_ms=10.0), RSNNSpec(recipe="default", step_ms=10.0)):
        assert sum(told in line for line in recipe.described(spec, at)) == 1
    assert not any("input spikes (" in line for line in recipe.described(RSNNSpec(recipe="default", step_ms=1.0), at))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        network = begin(events, 2, RSNNSpec(recipe="default", hidden=50), 1000.0, torch.Generator().manual_seed(0))
    assert network.steps_per_bin == 10
    events[:, 1] = 1  # one in a hundred is none that is rare
    assert Seen.of(events, 1000.0).apart == 1
    many = [*recipe.described(RSNNSpec(step_ms=10.0), Seen.of(events, 1000.0))]
    assert not any("input spikes (" in line for line in many)  # a warning says it


@pytest.mark.skipif(not LETTERS.exists(), reason="the Braille letters are not here; set NEUROTACT_DATA")
@pytest.mark.parametrize("step_ms", [1.0, 2.0, 5.0])
def test_letters_have_recurrence_tried_at_any_rate_of_import(step_ms):
    trains = read_letters(LETTERS, step_ms)
    some = trains.select(np.arange(0, len(trains), 32))
    windows = Windows(np.arange(len(some)), np.zeros(len(some), np.int64), int(some.trial_steps.min()))
    events = torch.from_numpy(some.raster(windows))
    for each in (events, perturbed(events, 0, -1), perturbed(events, 0, 1)):
        chosen = chosen_at(Seen.of(each, 1e3 / step_ms))
        assert (chosen["model"], chosen["readout_stretches"]) == ("auto", 1)
        assert 4 <= chosen["step_ms"] <= 6


# --- what is given is what the rules see ------------------------------------------------------------------

GIVEN: dict[str, tuple] = {
    "model": ("rsnn", {"surrogate_scale"}),
    "step_ms": (100.0, {"tau_mem_ms", "tau_syn_ms", "readout_stretch_ms"}),
    "readout": ("count", {"readout_stretches", "readout_stretch_ms"}),
    "readout_tau_ms": (9.0, {"readout_stretches", "readout_stretch_ms"}),
    "readout_stretches": (7, {"readout_stretch_ms"}),
    "readout_stretch_ms": (100.0, {"readout_stretches"}),
    "training.batch": (64, {"training.epochs", "training.patience"}),
    "training.epochs": (400, {"training.batch", "training.patience"}),
    "effort": ("quick", {"training.epochs", "training.patience"}),
}
"""Another value than the chosen one of each key that a rule reads, and the keys whose values follow it."""
FREE: dict[str, object] = {
    "hidden": 12, "membrane": "delayed", "reset": "hard", "recurrent_delay_steps": 1, "tau_mem_ms": 7.0,
    "tau_syn_ms": 7.0, "threshold_adaptation": 0.3, "surrogate": "arctan", "surrogate_scale": 7.0,
    "readout_surrogate_scale": 7.0,
    "forward_weight_scale": 7.0, "recurrent_weight_scale": 0.7, "recurrent_blocks": 5, "learn": ["alpha"],
    "input_deviation": 0.7, "training.optimiser": "Adamax", "training.betas": [0.8, 0.99],
    "training.weight_decay": 0.7, "training.loss": "hinge",
    "training.learning_rate": 0.7, "training.patience": 7, "training.target_loss": 0.7, "training.rate_penalty": 0.7,
    "training.population_penalty": 0.7, "training.temperature": 0.7, "training.sparsity": 0.7,
    "training.stretch_rate": 0.7,
    "training.relative_learning_rate": 0.7, "training.schedule": "constant", "training.keep": "loss",
    "training.input_dropout": 0.7, "training.input_jitter_ms": 0.7, "training.readout_dropout": 0.7,
    "training.members": 2, "direct": True,
}  # fmt: skip
"""A value of each key that no rule reads."""


def test_every_key_that_is_given_is_what_the_rules_see():
    fields = {f"training.{key}" for key in TrainingSpec.model_fields} | {*RSNNSpec.model_fields}
    assert {*GIVEN, *FREE} == fields - {"recipe", "training", "tau_adaptation_ms"}  # given with threshold_adaptation
    at = Seen(900, 1000, 1000.0, 50.0, apart=6)
    chosen = chosen_at(at)
    for key, (value, followers) in {**GIVEN, **{key: (value, set()) for key, value in FREE.items()}}.items():
        found = chosen_at(at, **{key: value})
        assert key == "effort" or found[key] == value, key
        differing = {name for name in found.keys() | chosen.keys() if found.get(name) != chosen.get(name)}
        own = {key, "tau_adaptation_ms"} if key == "threshold_adaptation" else {key}
        own |= {"direct"}  # of which the next test is
        assert differing - own == followers, key


@given(seen, st.sets(st.sampled_from(sorted({choice.key for choice in choices(Seen(900, 1000, 1000.0, 50.0))}))))
def test_to_give_what_is_chosen_changes_nothing(given_seen, keys):
    chosen = chosen_at(given_seen)
    keys -= {"readout_stretches", "readout_stretch_ms"}  # given stretches learn at the usual rate
    keys |= {"direct"}  # any key of hidden neurons says that these are wanted
    assert chosen_at(given_seen, **{key: chosen[key] for key in keys}) == chosen


OF_NEURONS = ["hidden", "model", "tau_mem_ms", "surrogate_scale", "threshold_adaptation", "learn"]


@pytest.mark.parametrize("key", ["", "training.epochs", "step_ms", *OF_NEURONS, "readout", "readout_tau_ms"])
def test_smaller_networks_are_tried_unless_hidden_neurons_are_asked_for(key):
    given_key = {key: {**GIVEN, **{name: (value, set()) for name, value in FREE.items()}}[key][0]} if key else {}
    found = chosen_at(Seen(900, 1000, 1000.0, 50.0), **given_key)
    assert found["hidden"] == given_key.get("hidden", 50)
    assert found.get("direct") == (None if key in (*OF_NEURONS, "readout", "readout_tau_ms") else "auto")


@pytest.mark.parametrize(("model", "scale"), [("snn", 10.0), ("rsnn", 20.0), ("auto", 20.0)])
def test_the_surrogate_is_that_of_the_model_that_is_given(model, scale):
    assert chosen_at(Seen(900, 1300, 1000.0, 2.0), model=model)["surrogate_scale"] == scale


def test_stretches_that_are_given_learn_at_the_usual_rate():
    at = Seen(900, 1300, 1000.0, 5.0)
    usual = TrainingSpec().stretch_rate
    assert chosen_at(at)["training.stretch_rate"] == usual / 2
    for given_key in ({"readout_stretches": 3}, {"readout_stretch_ms": 400.0}):
        assert chosen_at(at, **given_key)["training.stretch_rate"] == usual


@given(seen, st.sampled_from(["squared-error", "absolute-error"]))
def test_numbers_are_told_by_many_stretches_and_with_all_neurons(given_seen, loss):
    of_classes, of_numbers = chosen_at(given_seen), chosen_at(given_seen, training={"loss": loss})
    bins = math.ceil(given_seen.steps / given_seen.steps_per_bin)
    assert of_numbers["readout_stretches"] == min(16, bins)
    assert of_classes["readout_stretches"] in (1, 4)
    assert of_numbers["training.readout_dropout"] == 0
    usual = TrainingSpec().stretch_rate
    assert of_numbers.get("training.stretch_rate", usual) == usual
    keys = {
        "training.loss",
        "readout_stretches",
        "readout_stretch_ms",
        "training.readout_dropout",
        "training.stretch_rate",
    }
    assert all(of_numbers[key] == of_classes[key] for key in of_numbers.keys() & of_classes.keys() - keys)
    built = resolve(DEFAULT.model_copy(update={"training": TrainingSpec(loss=loss)}), given_seen)
    assert (built.readout_stretches, built.training.readout_dropout) == (of_numbers["readout_stretches"], 0)


def test_a_key_that_has_an_effect_in_some_windows_is_not_void():
    assert {"training.stretch_rate", "recurrent_weight_scale"}.isdisjoint(recipe.void_keys(DEFAULT))


def test_the_clock_is_that_of_a_refractory_period_wherever_bins_begin():
    events = torch.zeros(4, 1000, 3, dtype=torch.uint8)
    events[:, ::50] = 1
    events[0, [58, 158, 258], 0] = 1  # one spike in eighty follows after 8 steps, in no bin of 9 with the one before
    assert clock.merged(events, 9) == 0
    assert Seen.of(events, 1000.0).apart == 8


@pytest.mark.parametrize("kind", [torch.uint8, torch.float32])
def test_spikes_of_many_windows_are_counted_without_a_larger_copy(kind, monkeypatch):
    """Torch adds up bytes as a copy of eight times as many: of a set of 10,000 trials it took three gigabytes."""
    windows = (torch.rand(200, 500, 8, generator=torch.Generator().manual_seed(0)) < 0.1).to(kind)
    mean, summed, total = float(windows.sum()) / (200 * 8), [], torch.Tensor.sum
    monkeypatch.setattr(torch.Tensor, "sum", lambda of, *how, **more: summed.append(of) or total(of, *how, **more))
    assert Seen.of(windows, 1000.0).spikes == mean
    assert all(len(of) <= clock.AT_ONCE for of in summed if of.dtype == torch.uint8)
    assert sum(map(len, (of for of in summed if of.ndim == 3))) == 200
