"""Training learns, stops, keeps the best weights, and repeats bit for bit from its seeds."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

from neurotact.errors import InputError
from neurotact.networks.definition import optimisers
from neurotact.networks.definition.rsnn import RSNN, Counts
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training.epochs import (
    Epoch,
    Examples,
    best_of,
    disturbed,
    evaluate,
    is_over,
    loss,
    partly_heard,
    train,
)
from neurotact.spec import build


def touches(n_trials, seed, n_steps=60):
    """Two classes that fire on different afferents."""
    generator = torch.Generator().manual_seed(seed)
    labels = torch.arange(n_trials) % 2
    rates = torch.where(labels[:, None] == torch.tensor([[0, 0, 1, 1]]), 0.3, 0.02)
    spikes = torch.rand(n_trials, n_steps, 4, generator=generator) < rates[:, None]
    return Examples(spikes.to(torch.uint8), labels)


def network(**training):
    spec = RSNNSpec(hidden=10, training=TrainingSpec(**{"epochs": 12, "batch": 16, "learning_rate": 0.01} | training))
    return RSNN(4, 2, spec, 2000.0, generator=torch.Generator().manual_seed(1))


def fit(net, seed=2):
    return train(net, touches(64, 0), touches(32, 1), generator=torch.Generator().manual_seed(seed))


def test_two_separable_touches_are_learned():
    net = network()
    fit(net)
    assert evaluate(net, touches(64, 9))[1] >= 0.95


def test_the_same_seeds_give_the_same_weights_bit_for_bit():
    first, second = network(), network()
    assert fit(first) == fit(second)
    for a, b in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(a, b)


def test_another_order_of_trials_gives_other_weights():
    first, second = network(), network()
    fit(first, seed=2), fit(second, seed=3)
    assert not torch.equal(first.w_in, second.w_in)


def test_the_network_keeps_the_weights_of_the_best_epoch():
    net = network(learning_rate=0.3)
    training = fit(net)
    assert training.best.validation_loss == min(e.validation_loss for e in training.epochs)
    assert evaluate(net, touches(32, 1))[0] == pytest.approx(training.best.validation_loss)


@pytest.mark.parametrize("batch", [7, 32, 64])
def test_what_an_epoch_tells_are_means_over_trials_whatever_the_batch(batch):
    still = {"learning_rate": 1e-12, "rate_penalty": 0.0, "population_penalty": 0.0}
    (epoch,) = fit(network(epochs=1, batch=batch, **still)).epochs
    whole = network(batch=64, **still)
    assert (epoch.train_loss, epoch.train_accuracy) == pytest.approx(evaluate(whole, touches(64, 0)))
    assert (epoch.validation_loss, epoch.validation_accuracy) == pytest.approx(evaluate(whole, touches(32, 1)))


def test_training_stops_after_patience_epochs_without_a_better_loss():
    training = fit(network(learning_rate=0.5, epochs=100, patience=3))
    assert len(training.epochs) < 100
    assert training.epochs[-1].epoch == training.best.epoch + 3


def test_the_loss_is_cross_entropy_and_two_rate_penalties():
    counts = Counts(torch.tensor([[2.0, 0.0], [0.0, 0.0]]), torch.tensor([[3.0, 1.0], [1.0, 1.0]]))
    spec = TrainingSpec(rate_penalty=0.1, population_penalty=0.01)
    cross_entropy = (torch.log(1 + torch.exp(torch.tensor(-2.0))) + torch.log(torch.tensor(2.0))) / 2
    # Mean hidden count 6 / 4; squared population counts (4^2 + 2^2) / 2.
    expected = cross_entropy + 0.1 * 1.5 + 0.01 * 10
    assert loss(counts, torch.tensor([0, 1]), spec).item() == pytest.approx(expected.item())


def test_a_temperature_multiplies_the_readout_alone():
    counts = Counts(torch.tensor([[3.0, 1.0], [0.0, 4.0]]), torch.tensor([[4.0, 0.0], [0.0, 2.0]]))
    labels, penalties = torch.tensor([0, 1]), {"rate_penalty": 0.1, "population_penalty": 0.01}
    scaled = Counts(0.25 * counts.readout, counts.hidden)
    found = loss(counts, labels, TrainingSpec(temperature=0.25, **penalties))
    assert found.item() == loss(scaled, labels, TrainingSpec(**penalties)).item()


def stepped(mean, size, gradient, spec):
    """The two running values of a gradient after a step (Kingma and Ba 2015, Algorithms 1 and 2)."""
    beta1, beta2 = spec.betas
    mean = beta1 * mean + (1 - beta1) * gradient
    if spec.optimiser == "Adamax":
        return mean, torch.maximum(beta2 * size, gradient.abs())
    return mean, beta2 * size + (1 - beta2) * gradient.square()


@pytest.mark.parametrize("optimiser", ["Adam", "Adamax"])
@pytest.mark.parametrize("betas", [(0.9, 0.995), (0.5, 0.1)])
def test_optimisers_step_as_published(optimiser, betas):
    spec = TrainingSpec(optimiser=optimiser, betas=betas, epochs=3, batch=64, learning_rate=0.02)
    net, same = network(**spec.model_dump()), network(**spec.model_dump())
    kept = []
    train(net, touches(64, 0), touches(32, 1), generator=torch.Generator().manual_seed(2), keep=kept.append)
    w, mean, size = same.w_in, torch.zeros_like(same.w_in), torch.zeros_like(same.w_in)
    for step, checkpoint in enumerate(kept, 1):
        same.zero_grad()
        examples = touches(64, 0)
        loss(same(examples.spikes), examples.labels, spec).backward()
        mean, size = stepped(mean, size, w.grad, spec)
        scale = size if optimiser == "Adamax" else (size / (1 - betas[1] ** step)).sqrt()
        expected = w.detach() - 0.02 * mean / (1 - betas[0] ** step) / (scale + 1e-8)
        assert torch.allclose(checkpoint.weights["w_in"], expected, atol=1e-5)
        same.load_state_dict(checkpoint.weights)


@pytest.mark.parametrize("model", ["rsnn", "snn"])
def test_only_weights_decay_and_as_the_optimiser_defines_it(model):
    def after_a_step(name, decay):
        training = TrainingSpec(optimiser=name, weight_decay=decay, epochs=1, batch=64, learning_rate=0.1)
        keys = {"model": model, "readout": "integrator", "learn": ["threshold"]}
        keys["training"] = training.model_dump(exclude_defaults=True)
        net = RSNN(4, 2, sampling_rate_Hz=2000.0, generator=torch.Generator().manual_seed(1), **keys)
        first = {key: value.clone() for key, value in net.named_parameters()}
        kept = []
        train(net, touches(64, 0), touches(32, 1), generator=torch.Generator().manual_seed(2), keep=kept.append)
        return first, kept[0].weights

    for name in ("AdamW", "SGD"):  # one step of both takes lr * decay of the weights away
        first, plain = after_a_step(name, 0.0)
        _, decayed = after_a_step(name, 0.5)
        for key, weights in plain.items():
            lost = 0.1 * 0.5 * first[key] if key.startswith("w_") else 0.0
            assert torch.allclose(decayed[key], weights - lost, atol=1e-6), (name, key)


def test_an_optimiser_is_found_by_its_name_in_any_case():
    assert TrainingSpec.model_validate({"optimiser": "adam"}) == TrainingSpec(optimiser="Adam") == TrainingSpec()
    for name, why in [("Adamm", "did you mean 'Adam'"), ("LBFGS", "take another"), ("SparseAdam", "dense")]:
        with pytest.raises(InputError, match=f"optimiser: .*{name}.*{why}"):
            build(TrainingSpec, {"optimiser": name}, source="mine.toml")


def test_options_that_an_optimiser_has_not_are_refused():
    for name, key, value in [("SGD", "betas", [0.5, 0.9]), ("Rprop", "weight_decay", 0.1)]:
        with pytest.raises(
            InputError, match=rf"training\.{key}.* has no effect with a training.optimiser that has none"
        ):
            RSNN(4, 2, sampling_rate_Hz=2000.0, training={"optimiser": name, key: value})


def test_an_optimiser_that_does_not_take_a_parameter_says_so():
    with pytest.raises(InputError, match=r"training\.optimiser: Muon does not train this network"):
        fit(RSNN(4, 2, sampling_rate_Hz=2000.0, readout="integrator", training={"optimiser": "muon"}))


def rates_seen(monkeypatch, net):
    """The learning rates of every step of a training, a list a step."""
    seen = []
    step = optimisers.kind_of("Adam").step
    monkeypatch.setattr(
        optimisers.kind_of("Adam"), "step", lambda self: (seen.append([g["lr"] for g in self.param_groups]), step(self))
    )
    fit(net)
    return seen


def test_a_cosine_falls_to_nothing_over_all_epochs(monkeypatch):
    seen = rates_seen(monkeypatch, network(epochs=3, patience=3, schedule="cosine"))
    assert len(seen) == 3 * 4
    expected = [0.01 * 0.5 * (1 + math.cos(math.pi * k / 12)) for k in range(12)]
    assert [rate for (rate,) in seen] == pytest.approx(expected)


def test_relative_rates_follow_each_matrix(monkeypatch):
    net = network(epochs=1, relative_learning_rate=0.05)
    with torch.no_grad():
        net.w_in *= 100.0
    expected = [0.05 * w.detach().square().mean().sqrt().item() for w in (net.w_in, net.w_rec, net.w_out)]
    assert rates_seen(monkeypatch, net)[0] == pytest.approx(expected)


def test_a_matrix_of_zeros_learns_at_the_absolute_rate(monkeypatch):
    net = network(epochs=1, relative_learning_rate=0.05)
    with torch.no_grad():
        net.w_rec.zero_()
    assert rates_seen(monkeypatch, net)[0][1] == 0.01


@given(seed=st.integers(0, 999), jitter=st.integers(0, 5), dropout=st.floats(0.0, 0.99))
def test_disturbed_spikes_are_some_of_them_moved_no_further_than_asked(seed, jitter, dropout):
    generator = torch.Generator().manual_seed(seed)
    given_spikes = (torch.rand(3, 40, 4, generator=generator) < 0.1).to(torch.uint8)
    found = disturbed(given_spikes, dropout, jitter, generator)
    near = torch.nn.functional.max_pool1d(given_spikes.float().transpose(1, 2), 2 * jitter + 1, 1, jitter)
    assert (found <= near.transpose(1, 2)).all()
    assert (found.sum(dim=1) <= given_spikes.sum(dim=1)).all()
    assert found.dtype == given_spikes.dtype


def test_nothing_is_disturbed_by_nothing_and_the_asked_share_is_left_out():
    many = (torch.rand(20, 100, 10, generator=torch.Generator().manual_seed(0)) < 0.5).to(torch.uint8)
    assert torch.equal(disturbed(many, 0.0, 0, torch.Generator()), many)
    left = disturbed(many, 0.3, 0, torch.Generator().manual_seed(1))
    assert (left <= many).all()
    assert float(left.sum() / many.sum()) == pytest.approx(0.7, abs=0.02)


def test_training_windows_alone_are_disturbed(monkeypatch):
    seen = []
    monkeypatch.setattr(
        "neurotact.networks.training.epochs.disturbed", lambda spikes, *rest: (seen.append(rest[:2]), spikes)[1]
    )
    fit(network(epochs=2, patience=2, input_dropout=0.2, input_jitter_ms=1.0))
    assert seen == 2 * 4 * [(0.2, 2)]


@given(st.integers(0, 999), st.floats(0.0, 0.9))
def test_hidden_neurons_that_are_heard_stand_in_for_those_that_are_not(seed, dropout):
    generator = torch.Generator().manual_seed(seed)
    counts = torch.randint(1, 9, (400, 50), generator=generator).float()
    heard = partly_heard(counts, dropout, generator)
    kept = heard != 0
    torch.testing.assert_close(heard[kept], counts[kept] / (1 - dropout))
    assert float(kept.float().mean()) == pytest.approx(1 - dropout, abs=0.03)


def test_an_integrator_hears_some_hidden_neurons_in_training_and_all_in_validation(monkeypatch):
    spec = TrainingSpec(epochs=1, batch=16, rate_penalty=0.0, readout_dropout=0.4)
    heard = []
    monkeypatch.setattr(
        "neurotact.networks.training.epochs.partly_heard",
        lambda hidden, share, _: (heard.append(share), 0 * hidden)[1],
    )
    told = {}
    for readout in ("integrator", "count"):
        heard.clear()
        made = RSNNSpec(hidden=10, readout=readout, training=spec)
        net = RSNN(4, 2, made, 2000.0, backend="reference", generator=torch.Generator().manual_seed(1))
        told[readout] = fit(net).epochs[0]
        assert heard == (4 * [0.4] if readout == "integrator" else [])
    assert told["integrator"].train_loss == pytest.approx(math.log(2), abs=1e-2)  # nothing was heard
    assert told["integrator"].validation_loss != pytest.approx(math.log(2), abs=1e-4)


def test_gradients_that_explode_are_said(monkeypatch):
    net = network(epochs=1)
    with torch.no_grad():
        net.w_in *= 1e3
    monkeypatch.setattr("neurotact.networks.training.epochs.EXPLODED", 0.0)
    with pytest.warns(UserWarning, match="gradients explode .* in epoch 1"):
        fit(net)


@pytest.mark.parametrize("name", ["alpha", "beta", "threshold"])
def test_learned_dynamics_move_and_stay_within_bounds(name):
    spec = RSNNSpec(hidden=10, learn=(name,), training=TrainingSpec(epochs=3, batch=16, learning_rate=0.05))
    net = RSNN(4, 2, spec, 2000.0, backend="reference", generator=torch.Generator().manual_seed(1))
    before = getattr(net, name).detach().clone()
    fit(net)
    after = getattr(net, name).detach()
    assert not torch.equal(before, after)
    assert (after > 0).all()
    assert name == "threshold" or (after <= 1).all()


def test_weights_that_are_not_finite_are_refused():
    net = network()
    with torch.no_grad():
        net.w_in.fill_(float("nan"))
    with pytest.raises(InputError, match="not finite after epoch 1"):
        fit(net)


def trained_state(net, training):
    return training, {name: tensor.numpy().tobytes() for name, tensor in net.state_dict().items()}


@examples(8)
@given(
    stop=st.integers(1, 5),
    learn=st.sets(st.sampled_from(["alpha", "beta", "threshold"])),
    model=st.sampled_from(["rsnn", "snn"]),
    patience=st.integers(1, 7),
    dtype=st.sampled_from([torch.float32, torch.float64]),
    readout=st.sampled_from(["count", "integrator"]),
    schedule=st.sampled_from(["constant", "cosine"]),
    dropout=st.sampled_from([0.0, 0.3]),
    optimiser=st.sampled_from(sorted({*optimisers.names()} - {"Muon"})),
    decay=st.sampled_from([0.0, 0.1]),
)
def test_a_training_that_goes_on_ends_as_one_that_was_not_interrupted(
    stop, learn, model, patience, dtype, readout, schedule, dropout, optimiser, decay
):
    training = TrainingSpec(epochs=5, batch=8, learning_rate=0.3, patience=patience, schedule=schedule)
    drops = {"input_dropout": dropout, "input_jitter_ms": 2 * dropout, "readout_dropout": dropout}
    training = training.model_copy(update={"optimiser": optimiser, "weight_decay": decay, **drops})
    spec = RSNNSpec(hidden=6, model=model, learn=tuple(sorted(learn)), readout=readout, training=training)

    def run(weights_seed, order_seed, **state):
        generator = torch.Generator().manual_seed(weights_seed)
        net = RSNN(4, 2, spec, 2000.0, backend="reference", generator=generator, dtype=dtype)
        order = torch.Generator().manual_seed(order_seed)
        return trained_state(net, train(net, touches(16, 0, 15), touches(8, 1, 15), generator=order, **state))

    kept = []
    whole = run(1, 2, keep=kept.append)
    assert whole == run(1, 2)  # keeping changes nothing
    assert tuple(len(checkpoint.epochs) for checkpoint in kept) == tuple(range(1, len(whole[0].epochs) + 1))
    start = kept[min(stop, len(kept)) - 1]
    told = []
    # Another network and another order: what goes on depends on the checkpoint alone, and leaves it as it is.
    assert run(8, 9, start=start, progress=told.append) == whole
    assert run(8, 9, start=start) == whole
    assert tuple(told) == whole[0].epochs[len(start.epochs) :]


def test_the_best_epoch_by_accuracy_is_of_the_most_accurate_the_one_of_lowest_loss():
    rows = [(0.5, 0.6), (0.9, 0.8), (0.7, 0.8), (0.7, 0.8), (0.4, 0.7)]
    log = [Epoch(number, 0.0, 0.0, *row) for number, row in enumerate(rows, 1)]
    assert best_of(log).epoch == 5
    assert best_of(log, "accuracy").epoch == 3
    assert not is_over(log, TrainingSpec(keep="accuracy", patience=3))
    assert is_over(log, TrainingSpec(keep="accuracy", patience=2))


def test_an_epoch_that_has_learned_nothing_is_not_the_best_of_both():
    """Of nine validation windows it names more by luck than any that has learned the training windows."""
    lucky, learned = Epoch(1, 2.0, 0.1, 1.5, 0.67), Epoch(2, 0.0, 1.0, 1.9, 0.56)
    surer = Epoch(3, 0.0, 1.0, 1.2, 0.56)
    assert best_of([lucky, learned], "accuracy") is lucky
    assert best_of([lucky, learned, surer], "both") is surer
    assert not is_over([lucky, learned], TrainingSpec(keep="both", patience=1))
    assert is_over([learned._replace(epoch=1), lucky._replace(epoch=2)], TrainingSpec(keep="both", patience=1))


def test_the_first_of_equal_epochs_is_the_best_and_patience_counts_from_it():
    log = [Epoch(i, 0.0, 0.0, loss, 0.0) for i, loss in enumerate([3.0, 2.0, 2.0, 5.0], 1)]
    assert best_of(log).epoch == 2
    over = [is_over(log[:n], TrainingSpec(epochs=9, patience=2)) for n in range(5)]
    assert over == [False, False, False, False, True]
    assert is_over(log[:2], TrainingSpec(epochs=2, patience=7))


@given(target_loss=st.sampled_from([0.01, 0.1, 0.3, 0.6]), seed=st.integers(0, 9))
@examples(6)
def test_a_training_with_a_target_is_the_whole_one_up_to_its_first_epoch_that_reaches_it(target_loss, seed):
    settings = {"rate_penalty": 0.0, "patience": 12}
    whole = fit(network(**settings), seed).epochs
    stopped = fit(network(**settings, target_loss=target_loss), seed).epochs
    assert stopped == whole[: len(stopped)]
    right = [epoch.train_accuracy == epoch.validation_accuracy == 1 for epoch in whole]
    sure = [max(epoch.train_loss, epoch.validation_loss) <= target_loss for epoch in whole]
    reached = [epoch.epoch for epoch, *both in zip(whole, right, sure, strict=True) if all(both)]
    assert len(stopped) == (reached[0] if reached else len(whole))


@pytest.mark.parametrize("part", ["train_loss", "validation_loss", "train_accuracy", "validation_accuracy"])
def test_a_target_is_of_losses_and_accuracies_of_training_and_validation(part):
    learned = Epoch(1, 0.01, 1.0, 0.01, 1.0)
    assert is_over([learned], TrainingSpec(target_loss=0.01))
    worse = learned._replace(**{part: 0.99 if "accuracy" in part else 0.011})
    assert not is_over([worse], TrainingSpec(target_loss=0.01))


def test_without_a_target_a_loss_of_0_ends_nothing():
    assert not is_over([Epoch(1, 0.0, 1.0, 0.0, 1.0)], TrainingSpec())
