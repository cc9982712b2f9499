"""The pooled GRU: parameters counted by hand, what it learns, what decides its weights."""

import numpy as np
import pytest
import torch
from neurotact_parts.opponents.pooled_gru import PooledGRUClassifier
from sklearn.base import clone

from neurotact.errors import InputError


def bursts(n=60, seed=0):
    """Two pulses in either order, at any time: the last state alone has forgotten them."""
    rng = np.random.default_rng(seed)
    X = 0.1 * rng.normal(size=(n, 14, 2))
    for trial in range(n):
        first = rng.integers(0, 10)
        X[trial, first, trial % 2] = X[trial, first + 3, 1 - trial % 2] = 3.0
    return X, np.array(["left", "right"])[np.arange(n) % 2]


SMALL = PooledGRUClassifier(hidden=12, learning_rate=0.02, epochs=30, random_state=0)


def test_it_learns_the_order_of_events_at_any_time():
    fitted = clone(SMALL).fit(*bursts(90))
    assert fitted.score(*bursts(60, seed=1)) > 0.9


def test_parameters_by_hand():
    fitted = clone(SMALL).set_params(epochs=1).fit(*bursts(8))
    assert fitted.n_parameters_ == 3 * 12 * (2 + 12 + 2) + 2 * (2 * 12 + 1)  # torch's GRU has two biases a gate
    assert fitted.epochs_ == 1


@pytest.mark.parametrize(
    ("n", "epochs"), [(8, 200), (320, 50), (3200, 40), (3840, 40), (3841, 39), (7680, 20), (30_000, 10)]
)
def test_few_trials_get_more_epochs_and_many_get_fewer(n, epochs, monkeypatch):
    """Batches of 8, 20 and 64: 1, 16 and 50 steps an epoch, 800 wanted, and 60 of 3,840 trials, of at most 2400."""
    monkeypatch.setattr(PooledGRUClassifier, "_train", lambda *_: None)
    fitted = PooledGRUClassifier(hidden=1).fit(np.zeros((n, 1, 1)), np.arange(n) % 2)
    assert fitted.epochs_ == epochs


def test_the_epoch_that_is_best_on_validation_trials_is_kept():
    """Validation trials with swapped classes: the fewer epochs, the better, so that it stays near its start."""
    X, y = bursts(60)
    swapped = np.where(y == "left", "right", "left")
    kept, last = clone(SMALL).fit(X, y, validation=(X, swapped)), clone(SMALL).fit(X, y)
    assert kept.score(X, swapped) > last.score(X, swapped) + 0.2


def test_the_same_seed_gives_the_same_weights_whatever_torch_drew_before():
    X, y = bursts(20)
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    one = clone(SMALL).set_params(epochs=2).fit(X, y)
    assert torch.equal(before, torch.random.get_rng_state())
    torch.manual_seed(6)
    other = clone(SMALL).set_params(epochs=2).fit(X, y)
    pairs = zip(one.network_.parameters(), other.network_.parameters(), strict=True)
    assert all(torch.equal(mine, its) for mine, its in pairs)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"hidden": 0}, "hidden"), ({"dropout": 1.5}, "dropout"), ({"learning_rate": 0}, "learning_rate"),
     ({"epochs": 0}, "epochs"), ({"weight_decay": -1}, "weight_decay")],
)  # fmt: skip
def test_parameters_out_of_range_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        clone(SMALL).set_params(**changes).fit(*bursts(8))


def test_other_channels_than_those_of_training_are_refused():
    fitted = clone(SMALL).set_params(epochs=1).fit(*bursts(8))
    with pytest.raises(InputError, match="has 3 channels, but training had 2"):
        fitted.predict(np.zeros((1, 40, 3)))


def test_it_ends_when_all_trials_are_learned_and_not_before():
    X, y = bursts(60)
    learned = clone(SMALL).set_params(dropout=0.0, epochs=200).fit(X, y, validation=(X, y))
    assert learned.epochs_ < 200
    assert learned.score(X, y) == 1
    wrong = np.where(np.arange(60) == 7, np.roll(y, 1), y)  # never all right: a trial of the other class
    assert clone(SMALL).fit(X, y, validation=(X, wrong)).epochs_ == 30
    assert clone(SMALL).fit(X, y).epochs_ == 30  # without validation trials there is nothing to judge by
