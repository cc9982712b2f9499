"""The spiking classifier keeps scikit-learn's contract and trains as `train` does."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import check_estimator
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from neurotact.data.copies import equal_examples
from neurotact.data.splits import hold_out_groups
from neurotact.data.windowed import Origin, SpikeArray
from neurotact.encoders import specs
from neurotact.encoders.transformer import SpikeEncoder
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.training.trainer import begin
from neurotact.networks.use import fitted
from neurotact.networks.use.classifier import SpikingClassifier, spike_windows
from neurotact.spec import load

RATE_HZ = 1000.0
EXCEPTIONS = {
    "check_classifiers_train": "asks for 83 % on features of any scale; three epochs on their spike counts have less",
}
"""Checks of scikit-learn that cannot hold, and why."""


def touches(n: int = 40, seed: int = 0) -> tuple[SpikeArray, np.ndarray]:
    """Windows of two classes that differ in how often their afferents fire."""
    rng = np.random.default_rng(seed)
    y = np.tile(["hard", "soft"], n // 2)
    rates = np.where(y == "hard", 0.25, 0.02)[:, None, None]
    return SpikeArray.of((rng.random((n, 60, 4)) < rates).astype(np.uint8), RATE_HZ), y


def small(**changes) -> SpikingClassifier:
    given = {"hidden": 6, "epochs": 6, "batch": 8, "learning_rate": 0.02, "random_state": 0}
    return SpikingClassifier(**given | changes)


def test_it_trains_the_network_that_train_trains():
    X, y = touches()
    X_held, y_held = touches(seed=1)
    clf = small().fit(X, y, validation=(X_held, y_held))
    sides = [
        Examples(torch.from_numpy(np.asarray(a)), torch.from_numpy((b == "soft").astype(np.int64)))
        for a, b in ((X, y), (X_held, y_held))
    ]
    network = begin(sides[0].spikes, 2, clf.spec(), RATE_HZ, torch.Generator().manual_seed(0))
    log = train(network, *sides, generator=torch.Generator().manual_seed(1))
    assert log.epochs == clf.training_.epochs
    for name, value in network.state_dict().items():
        assert torch.equal(value, clf.network_.state_dict()[name]), name


def test_equal_seeds_give_equal_networks_and_others_do_not():
    X, y = touches()
    first, again, other = (small(random_state=seed).fit(X, y).network_.w_in for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_decision_is_counted_from_its_own_spikes():
    X, y = touches()
    clf = small(recurrent=True).fit(X, y)
    found = clf.decide(X)
    assert (found["steps"] == 60).all()
    assert found["ms"].tolist() == [60.0] * 40
    assert found["input_spikes"].tolist() == np.asarray(X).sum(axis=(1, 2)).tolist()
    hidden = found["hidden_spikes"]
    assert (found["sops_total"] == 6 * found["input_spikes"] + 6 * hidden + 2 * hidden).all()
    assert found["predicted"].tolist() == clf.predict(X).tolist()
    assert clf.sops(X).total.tolist() == found["sops_total"].tolist()
    early = clf.decide(X, early_exit=True)
    assert (early["steps"] <= found["steps"]).all()
    assert (early["sops_total"] <= found["sops_total"]).all()


@pytest.mark.parametrize("readout", [{"readout": "integrator", "readout_tau_ms": 15.0}, {"readout": "max"}])
def test_it_exits_early_and_reads_out_with_a_leak(readout):
    X, y = touches()
    clf = small(settings=readout, exit_tolerance=0.8).fit(X, y)
    assert clf.network_.leaks
    early, full = clf.decide(X, early_exit=True), clf.decide(X)
    assert early["steps"].sum() < full["steps"].sum()
    assert early["sops_total"].sum() < full["sops_total"].sum()
    decided = clf.network_.infer(torch.from_numpy(np.asarray(X)), clf.exit_rule_)
    assert early["steps"].tolist() == decided.steps.tolist()
    assert clf.decision_function(X).shape == (len(y),)


def test_early_exit_is_used_where_enough_validation_windows_bound_its_loss():
    X, y = touches()
    few, many = (small().fit(X, y, validation=touches(n, seed=1)) for n in (40, 400))
    assert all(clf.exit_choice_.rule == clf.exit_rule_ for clf in (few, many))
    assert len(few.exit_choice_.losses) == 40
    assert few.exit_choice_.is_refused
    assert (few.decide(X, early_exit=True)["steps"] == 60).all()
    assert (infer_rule(few).never, infer_rule(many)) == (True, many.exit_rule_)
    assert many.exit_choice_.used == many.exit_rule_
    steps = many.network_.infer(torch.from_numpy(np.asarray(X)), many.exit_rule_).steps
    assert many.decide(X, early_exit=True)["steps"].tolist() == steps.tolist()
    assert steps.min() < 60


def test_held_out_windows_of_a_group_are_one_trial():
    X, y = touches()
    clf = small(validation_fraction=0.3).fit(X, y, groups=np.arange(40) // 4)
    assert len(clf.exit_choice_.losses) == 4  # sixteen windows


def test_equal_validation_windows_are_one_trial():
    X, y = touches()
    X_held, y_held = touches(10, seed=1)
    spikes, labels = np.concatenate([np.asarray(X_held)] * 2), np.concatenate([y_held] * 2)
    found = small().fit(X, y, validation=(SpikeArray.of(spikes, RATE_HZ), labels)).exit_choice_
    assert {*found.losses} == {*equal_examples(spikes, labels)} < {*range(20)}


def infer_rule(clf: SpikingClassifier):
    """The rule by which whatever takes a fitted classifier decides."""
    return fitted.restore(clf).exits()


def test_probabilities_are_those_of_the_loss():
    X, y = touches()
    clf = small(settings={"training.temperature": 0.5}).fit(X, y)
    found = clf.predict_proba(X)
    assert found.sum(axis=1) == pytest.approx(1.0)
    assert (clf.classes_[found.argmax(axis=1)] == clf.predict(X)).all()
    lead = clf.decision_function(X)
    assert np.log(found[:, 1] / found[:, 0]) == pytest.approx(0.5 * lead)


def test_a_weight_counts_as_in_the_loss():
    """Equal weights are none, a weight of 0 leaves a window out, and a heavy class is found more often."""
    X, y = touches()
    plain, equal = (small().fit(X, y, sample_weight=w).network_.w_in for w in (None, np.full(40, 3.0)))
    assert torch.equal(plain, equal)
    keep = np.arange(40) % 5 > 0
    fewer, left_out = small().fit(X[keep], y[keep]), small().fit(X, y, sample_weight=keep)
    assert torch.equal(fewer.network_.w_in, left_out.network_.w_in)
    rng = np.random.default_rng(0)
    same = SpikeArray.of((rng.random((40, 60, 4)) < 0.1).astype(np.uint8), RATE_HZ)
    heavy = [
        small().fit(same, y, sample_weight=np.where(y == name, 20.0, 1.0)).predict(same) for name in ("hard", "soft")
    ]
    assert (heavy[0] == "hard").sum() > 20 < (heavy[1] == "soft").sum()


@pytest.mark.parametrize(
    ("weights", "words"), [([1.0], "has the shape"), ([-1.0] * 40, ">= 0"), ([0.0] * 40, "not all 0")]
)
def test_weights_that_cannot_be_used_are_refused(weights, words):
    X, y = touches()
    with pytest.raises(InputError, match=f"sample_weight: .*{words}"):
        small().fit(X, y, sample_weight=weights)


def test_verbose_prints_a_line_for_each_epoch(capsys):
    X, y = touches()
    clf = small(verbose=True).fit(X, y)
    assert capsys.readouterr().out.count("epoch ") == len(clf.training_.epochs)
    small().fit(X, y)
    assert capsys.readouterr().out == ""


def test_a_generator_is_a_source_of_seeds():
    X, y = touches()
    first, again = (small(random_state=np.random.default_rng(5)).fit(X, y).network_.w_in for _ in range(2))
    assert torch.equal(first, again)
    rng = np.random.default_rng(5)
    assert not torch.equal(*(small(random_state=rng).fit(X, y).network_.w_in for _ in range(2)))


def test_a_transposed_window_is_refused():
    X, y = touches()
    swapped = np.asarray(X).transpose(0, 2, 1)
    with pytest.raises(InputError, match=r"X: is \(window, afferent, time\), as 4 is the number of afferents"):
        small().fit(X, y).predict(swapped)
    named = SpikeArray.of(swapped, RATE_HZ, Origin(None, ("a", "b", "c", "d")))
    with pytest.raises(InputError, match=r"give X.transpose\(0, 2, 1\)"):
        small().fit(named, y)


def test_a_feed_forward_network_has_no_recurrent_operations():
    X, y = touches()
    clf = small(recurrent=False).fit(X, y)
    assert clf.network_.w_rec is None
    assert not clf.sops(X).recurrent.any()


def test_decision_function_agrees_with_predict():
    X, y = touches()
    clf = small().fit(X, y)
    assert (clf.classes_[(clf.decision_function(X) > 0).astype(int)] == clf.predict(X)).all()


@given(st.data())
def test_held_out_groups_stay_whole_and_leave_every_class_to_training(data):
    per_group = data.draw(st.lists(st.sampled_from("abc"), min_size=2, max_size=9))
    size = data.draw(st.integers(1, 4))
    y, groups = np.repeat(per_group, size), np.repeat(np.arange(len(per_group)), size)
    try:
        held = hold_out_groups(y, groups, 0.15, data.draw(st.integers(0, 99)))
    except InputError:
        assert min(per_group.count(name) for name in per_group) == 1  # only a class of one group can be lost
        return
    inside = np.setdiff1d(np.arange(len(y)), held)
    assert not set(groups[inside]) & set(groups[held])
    assert set(y[inside]) == set(y)
    assert len(held)


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        (np.zeros(40), "groups makes 1 group"),
        ((np.arange(40) % 2).tolist(), "no training trial of class"),
        (np.arange(3), "groups: has the shape"),
        (np.full(40, np.nan), "groups: trial 0 has no label"),
    ],
)
def test_groups_that_cannot_be_held_out_are_refused(groups, words):
    X, y = touches()
    with pytest.raises(InputError, match=words):
        small().fit(X, y, groups=groups)


@pytest.mark.parametrize(
    ("validation", "words"),
    [
        (lambda X, y: X, "validation: must be a pair"),
        (lambda X, y: (X[:, :20], y), "validation: windows have 20 steps, but training windows have 60"),
        (lambda X, y: (X, ["other"] * len(y)), "validation: class 'other' is not a class of training"),
        (lambda X, y: (X, y[:3]), "validation: has the shape"),
    ],
)
def test_validation_windows_that_do_not_fit_are_refused(validation, words):
    X, y = touches()
    with pytest.raises(InputError, match=words):
        small().fit(X, y, validation=validation(X, y))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("random_state", "luck"), ("random_state", -1), ("random_state", 1.5), ("random_state", 2**32),
        ("random_state", [0]), ("exit_tolerance", 1.0), ("exit_tolerance", "small"),
        ("validation_fraction", 0), ("validation_fraction", "x"), ("device", "tpuu"), ("settings", "hidden=3"),
        ("network", 3), ("sampling_rate_Hz", "1000"),
    ],
)  # fmt: skip
def test_a_wrong_parameter_is_refused_before_the_training(name, value, monkeypatch):
    X, y = touches()
    monkeypatch.setattr("neurotact.networks.use.classifier.ensemble.train", None)
    with pytest.raises(InputError, match=f"^(SpikingClassifier: )?{name}: |^{name}|: {name} "):
        small(**{name: value}).fit(np.asarray(X) if name == "sampling_rate_Hz" else X, y)


def test_a_spec_serves_as_its_name_does():
    X, y = touches()
    by_name = small(network="rsnn", settings={"reset": "subtract"}).fit(X, y)
    spec = load(RSNNSpec, "rsnn", {"reset": "subtract"})
    by_spec = clone(small(network=spec)).fit(X, y)
    assert by_spec.network_.spec == by_name.network_.spec
    assert torch.equal(by_spec.network_.w_in, by_name.network_.w_in)
    signals = 30.0 * np.sin(np.arange(400) / 30)[None, :, None] * np.ones((2, 1, 3))
    changed = {"sa1.t_ref_ms": 5}
    by_name = SpikeEncoder("sa1-ra1-lif", changed, sampling_rate_Hz=2000.0).fit_transform(signals)
    by_spec = SpikeEncoder(specs.load("sa1-ra1-lif", changed), sampling_rate_Hz=2000.0).fit_transform(signals)
    assert by_spec.any()
    assert (by_spec == by_name).all()
    for rate_Hz, words in ((None, "X does not say its clock"), ("2000", "must be a positive number")):
        with pytest.raises(InputError, match=words):
            SpikeEncoder(sampling_rate_Hz=rate_Hz).fit(signals)
    with pytest.raises(InputError, match="encoder: must be a name, a path or an encoder spec; got RSNNSpec"):
        SpikeEncoder(spec, sampling_rate_Hz=2000.0).fit(signals)


def test_held_out_windows_share_no_group_with_training():
    _, y = touches()
    clf = small()
    inside, held, of = clf._hold_out((y == "soft").astype(int), np.arange(40) // 4, 0)
    assert not set(inside // 4) & set(held // 4)
    assert of.tolist() == np.unique(held // 4, return_inverse=True)[1].tolist()  # four windows a trial
    assert sorted(set(of)) == list(range(len(held) // 4))
    assert sorted([*inside, *held]) == list(range(40))


def test_it_works_in_a_search_a_pipeline_and_cross_validation():
    X, y = touches()
    search = GridSearchCV(small(epochs=2), {"hidden": [3, 5]}, cv=2).fit(X, y)
    assert search.best_params_["hidden"] in (3, 5)
    scores = cross_val_score(small(), X, y, groups=np.arange(40) // 4, cv=GroupKFold(2))
    assert scores.shape == (2,)
    signals = np.where((y == "hard")[:, None, None], 12.0, 2.0) * np.ones((1, 200, 2))
    chain = make_pipeline(SpikeEncoder(sampling_rate_Hz=2000.0, calibrate=False), small(epochs=2))
    assert chain.fit(signals, y).predict(signals).shape == (40,)
    grid = {"spikeencoder__sa1__t_ref_ms": [0.5, 5], "spikingclassifier__training__rate_penalty": [0.1]}
    found = GridSearchCV(chain, grid, cv=2).fit(signals, y).best_estimator_
    assert found[0].spec_.sa1.t_ref_ms in (0.5, 5)
    assert found[1].network_.spec.training.rate_penalty == 0.1
    assert chain.get_params()["spikeencoder__settings"] is None
    with pytest.raises(ValueError, match="Invalid parameter 'sa2'"):
        chain.set_params(spikeencoder__sa2__t_ref_ms=5)


def test_the_clock_comes_from_the_array_or_the_parameter():
    X, y = touches()
    plain = np.asarray(X)
    assert small().fit(X, y).sampling_rate_Hz_ == RATE_HZ
    assert small(sampling_rate_Hz=500.0).fit(plain, y).sampling_rate_Hz_ == 500.0
    with pytest.raises(InputError, match="X does not say its clock"):
        small().fit(plain, y)
    with pytest.raises(InputError, match="is 500 but X is sampled at 1000 Hz"):
        small(sampling_rate_Hz=500.0).fit(X, y)
    fitted = small().fit(X, y)
    with pytest.raises(InputError, match="is sampled at 2000 Hz but the network was trained at 1000 Hz"):
        fitted.predict(SpikeArray.of(plain, 2000.0))


@pytest.mark.parametrize(
    ("X", "y", "words"),
    [
        (np.zeros((4, 5)), ["a", "b"] * 2, r"X: must be \(window, time, afferent\)"),
        (np.full((4, 5, 2), 0.5), ["a", "b"] * 2, "values other than 0 and 1"),
        (np.full((4, 5, 2), np.nan), ["a", "b"] * 2, "not finite"),
        (np.zeros((4, 5, 2)), ["a"] * 4, "holds one class, 'a'"),
        (np.zeros((4, 5, 2)), ["a", "b"], "4 trials"),
        (np.zeros((4, 5, 2)), ["a", "b", "b", "b"], "too few windows to hold one out"),
        ("spikes.h5", ["a", "b"], "X: must be"),
        ([[[1], [0]], [[1]]], ["a", "b"], "X: has windows of 1 to 2 samples where all must be equally long; cut them"),
        ([[[1], [0]], 1], ["a", "b"], "X: cannot be read as an array"),
        (torch.zeros(4, 5, 2, requires_grad=True), ["a", "b"] * 2, "X: cannot be read as an array"),
        (np.zeros((4, 5, 2)), [0.1, 0.2, 0.3, 0.4], "y: holds numbers that are not whole"),
        (np.zeros((4, 5, 2)), ["a", None, "a", "b"], "y: trial 1 has no label"),
        (np.zeros((4, 5, 2)), [0.0, np.nan, 1.0, 0.0], "y: trial 1 has no label"),
    ],
)
def test_what_it_cannot_take_is_refused_in_one_sentence(X, y, words):
    with pytest.raises(InputError, match=words):
        SpikingClassifier(sampling_rate_Hz=1000.0).fit(X, y)


@pytest.mark.parametrize(("name", "value"), [("hidden", -1), ("epochs", "many"), ("settings", {"hiden": 3})])
def test_a_wrong_parameter_is_named(name, value):
    X, y = touches()
    with pytest.raises(InputError, match="hidden" if name != "epochs" else "epochs"):
        SpikingClassifier(**{name: value}).fit(X, y)


def test_a_clone_has_the_parameters_and_nothing_learned():
    X, y = touches()
    copy = clone(small(settings={"reset": "subtract"}).fit(X, y))
    assert copy.get_params() == small(settings={"reset": "subtract"}).get_params()
    assert not hasattr(copy, "network_")


class OfTables(SpikingClassifier):
    """The classifier behind a code that turns each feature into a spike count, so that scikit-learn can feed it."""

    def fit(self, X, y):
        X, y = validate_data(self, X, y, dtype=np.float64)
        check_classification_targets(y)
        self.low_, self.high_ = X.min(axis=0), X.max(axis=0)
        super().fit(self._spikes(X), y)
        return self

    def _infer(self, X, rule):
        check_is_fitted(self)
        return super()._infer(self._spikes(validate_data(self, X, dtype=np.float64, reset=False)), rule)

    def _spikes(self, X):
        share = (X - self.low_) / np.maximum(self.high_ - self.low_, 1e-9)
        return (share[:, None, :] > np.linspace(0.05, 0.95, 20)[None, :, None]).astype(np.uint8)

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array, tags.input_tags.three_d_array = True, False
        return tags


def test_scikit_learns_checks_hold():
    """All checks of scikit-learn, but those listed here with the reason."""
    behind = OfTables(hidden=8, sampling_rate_Hz=1000.0, epochs=3, batch=16, random_state=0)
    failed = [
        found["check_name"]
        for found in check_estimator(behind, on_fail=None, on_skip=None)
        if found["status"] == "failed" and found["check_name"] not in EXCEPTIONS
    ]
    assert failed == []


def test_spikes_of_any_number_type_are_taken():
    values = np.array([[[0, 1], [1, 0]]])
    for kind in (bool, np.int64, np.float32, np.uint8):
        assert (spike_windows(values.astype(kind)) == values).all()


def test_afferents_are_matched_by_name_or_refused():
    X, y = touches()
    names = ("a", "b", "c", "d")
    known = SpikeArray.of(np.asarray(X), RATE_HZ, Origin(None, names))
    fitted = small().fit(known, y)
    order = [2, 0, 3, 1]
    assert (fitted.decision_function(known[..., order]) == fitted.decision_function(known)).all()
    assert (fitted.decision_function(np.asarray(known)) == fitted.decision_function(known)).all()
    other = SpikeArray.of(np.asarray(X), RATE_HZ, Origin(None, ("a", "b", "c", "e")))
    with pytest.raises(InputError, match="X: has the afferent 'e' where a, b, c, d are expected"):
        fitted.predict(other)
    side = known[:20], y[:20]
    again = small().fit(known, y, validation=(side[0][..., order], side[1]))
    assert again.training_.epochs == small().fit(known, y, validation=side).training_.epochs
    with pytest.raises(InputError, match="validation: has the afferent 'e'"):
        small().fit(known, y, validation=(other, y))


def test_masked_values_are_refused():
    X, y = touches()
    with pytest.raises(InputError, match="X: holds masked values"):
        small(sampling_rate_Hz=RATE_HZ).fit(np.ma.masked_where(np.asarray(X) > 0, np.asarray(X)), y)
