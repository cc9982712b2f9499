import numpy as np
import pytest
import torch
from neurotact_parts.studies.stiffness.slfn import SLFNClassifier, fit_many
from sklearn.base import clone
from sklearn.neural_network import MLPClassifier
from sklearn.utils.estimator_checks import parametrize_with_checks

from neurotact.errors import InputError


def grasps(n_examples=90, n_features=4, seed=0, spread=1.0):
    rng = np.random.default_rng(seed)
    indices = np.arange(n_examples) % 3
    return 2 * np.eye(3, n_features)[indices] + spread * rng.normal(size=(n_examples, n_features)), indices


def split(seed, n_train=60):
    X, y = grasps(seed=seed)
    return (X[:n_train], y[:n_train]), (X[n_train:], y[n_train:])


def weights_of(net):
    return [net.hidden_weights_, net.hidden_biases_, net.coef_, net.intercept_]


@parametrize_with_checks([SLFNClassifier(epochs=20)])
def test_scikit_learns_checks(estimator, check):
    check(estimator)


@pytest.mark.thorough
@parametrize_with_checks([SLFNClassifier(activation="sigmoid")])
def test_scikit_learns_checks_of_the_other_activation(estimator, check):
    check(estimator)


@pytest.mark.parametrize("activation", ["sigmoid", "relu"])
def test_many_at_once_equal_each_alone(activation):
    prototype = SLFNClassifier(12, activation, epochs=60, patience=6, batch=16)
    splits, seeds = [split(0), split(0), split(1), split(2), split(3)], [0, 1, 2, 3, 4]
    together = fit_many(prototype, splits, seeds)
    for net, (training, validation), seed in zip(together, splits, seeds, strict=True):
        alone = clone(prototype).set_params(random_state=seed).fit(*training, validation=validation)
        assert (net.n_epochs_, net.best_epoch_) == (alone.n_epochs_, alone.best_epoch_)
        assert net.validation_accuracy_ == alone.validation_accuracy_
        for ours, theirs in zip(weights_of(net), weights_of(alone), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5)
    assert len({net.n_epochs_ for net in together}) > 1  # some stopped and left while others went on


def test_splits_of_unlike_sizes_keep_their_places():
    splits = [split(0, 60), split(1, 50), split(2, 60)]
    prototype = SLFNClassifier(5, epochs=4)
    together = fit_many(prototype, splits, [0, 1, 2])
    for seed, (net, (training, validation)) in enumerate(zip(together, splits, strict=True)):
        alone = clone(prototype).set_params(random_state=seed).fit(*training, validation=validation)
        np.testing.assert_allclose(net.coef_, alone.coef_, atol=1e-6)


def test_starts_uniform_and_each_seed_elsewhere():
    (X, y), validation = split(0)
    nets = [SLFNClassifier(200, epochs=1, learning_rate=1e-12, random_state=s).fit(X, y, validation) for s in (0, 0, 1)]
    start = np.append(nets[0].hidden_weights_, nets[0].coef_)
    assert -1 <= start.min() < -0.98
    assert 0.98 < start.max() <= 1
    assert abs(start.var() - 1 / 3) < 0.03
    np.testing.assert_allclose(nets[0].hidden_biases_, 0, atol=1e-9)
    assert np.array_equal(nets[0].coef_, nets[1].coef_)
    assert not np.allclose(nets[0].coef_, nets[2].coef_)


def test_one_step_is_adams_on_the_cross_entropy():
    (X, y), validation = split(0)
    before = SLFNClassifier(6, "sigmoid", epochs=1, batch=60, learning_rate=1e-12, random_state=3)
    after = SLFNClassifier(6, "sigmoid", epochs=1, batch=60, learning_rate=0.01, random_state=3)
    start = [torch.tensor(w, requires_grad=True) for w in weights_of(before.fit(X, y, validation))]
    hidden = torch.sigmoid(torch.tensor(X) @ start[0] + start[1])
    torch.nn.functional.cross_entropy(hidden @ start[2] + start[3], torch.tensor(y)).backward()
    torch.optim.Adam(start, lr=0.01).step()
    for ours, expected in zip(weights_of(after.fit(X, y, validation)), start, strict=True):
        np.testing.assert_allclose(ours, expected.detach().numpy(), rtol=0, atol=1e-6)


def test_keeps_the_first_of_the_best_epochs_and_waits_its_patience():
    (X, y), validation = split(5)
    net = SLFNClassifier(8, patience=5, random_state=0).fit(X, y, validation)
    assert net.n_epochs_ == net.best_epoch_ + 5
    assert net.score(*validation) == pytest.approx(net.validation_accuracy_)
    shorter = clone(net).set_params(epochs=net.best_epoch_).fit(X, y, validation)
    assert np.array_equal(shorter.coef_, net.coef_)
    for epochs in range(1, net.best_epoch_):
        assert (
            clone(net).set_params(epochs=epochs).fit(X, y, validation).validation_accuracy_ < net.validation_accuracy_
        )


def test_learns_about_as_well_as_scikit_learns_network():
    X, y = grasps(600)
    X, y, new, truth = X[:400], y[:400], X[400:], y[400:]
    ours = np.mean([SLFNClassifier(20, random_state=s).fit(X, y).score(new, truth) for s in range(4)])
    peer = MLPClassifier(20, learning_rate_init=0.01, max_iter=300, early_stopping=True, n_iter_no_change=20)
    theirs = np.mean([clone(peer).set_params(random_state=s).fit(X, y).score(new, truth) for s in range(4)])
    assert abs(ours - theirs) < 0.03
    assert ours > 0.8


def test_validation_labels_reach_no_weight_but_through_the_choice_of_the_epoch():
    (X, y), (held, truth) = split(0)
    net = SLFNClassifier(8, epochs=1, random_state=0)
    right, wrong = clone(net).fit(X, y, (held, truth)), clone(net).fit(X, y, (held, (truth + 1) % 3))
    assert np.array_equal(right.coef_, wrong.coef_)
    assert right.validation_accuracy_ != wrong.validation_accuracy_


def test_refusals():
    X, y = grasps()
    with pytest.raises(InputError, match="y: holds one class"):
        SLFNClassifier().fit(X, np.zeros(len(X), int))
    with pytest.raises(InputError, match="did you mean 'sigmoid'"):
        SLFNClassifier(activation="sigmod").fit(X, y)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="patience: must be a whole number >= 1"):
        SLFNClassifier(patience=0).fit(X, y)
    with pytest.raises(InputError, match="validation_fraction: must lie between 0 and 1"):
        SLFNClassifier(validation_fraction=1.0).fit(X, y)
    with pytest.raises(InputError, match="too few to split off validation"):
        SLFNClassifier().fit(X[:3], y[:3])
    with pytest.raises(InputError, match="class '5' was not among the training examples"):
        SLFNClassifier().fit(X, y, validation=(X[:1], [5]))
