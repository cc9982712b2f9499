"""Networks that tell numbers: what they learn, in which unit, and what runs them."""

import re

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from sklearn.linear_model import Ridge

import neurotact as nt
from neurotact import effects
from neurotact.baselines import opponent
from neurotact.data import hdf5
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError
from neurotact.files import read_json
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.exit.patience import ExitChoice, exits, is_right, upper_bound
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import comparison, ensemble, linear, losses, numbers, run_folder, tasks, trainer
from neurotact.networks.training.comparison import Trials
from neurotact.networks.training.tasks import Task
from neurotact.networks.use import inference

TRIALS, STEPS = 60, 60
EXIT = ExitRule(3, from_first_spike=True, band=(2.0, 4.0))
WINDOW = nt.Window(length_ms=STEPS)
CONDITIONS = pd.DataFrame(
    {
        "label": np.resize(["felt", "silk", "wool"], TRIALS),
        "force_N": np.linspace(2.0, 8.0, TRIALS)[np.random.default_rng(3).permutation(TRIALS)],
        "speed": np.resize([8.0, 16.0], TRIALS),
    }
)


def touches(conditions: pd.DataFrame = CONDITIONS):
    """Two afferents whose rates rise with the force and the speed, and one that says nothing."""
    force, speed = (CONDITIONS[name].to_numpy()[:, None, None] for name in ("force_N", "speed"))
    rates = np.concatenate([force / 10, speed / 20, np.full_like(force, 0.2)], axis=2)
    drawn = np.random.default_rng(0).random((TRIALS, STEPS, 3)) < rates
    return from_rasters(drawn.astype(np.uint8), 1000.0, ("SA-I 0", "SA-I 1", "RA-I 0"), conditions)


SPEC = RSNNSpec(
    model="snn", hidden=5, readout="integrator", input_deviation=1.0,
    training=TrainingSpec(epochs=3, batch=16, relative_learning_rate=0.05),
)  # fmt: skip
NONE = RSNNSpec(model="snn", hidden=0, readout="integrator", readout_stretches=2, readout_stretch_ms=30)


def told(spec: RSNNSpec, conditions: pd.DataFrame, *target: str) -> tuple[np.ndarray, RSNN]:
    """The values of a trained network on all trials, and the network."""
    trains, task = touches(conditions), Task(window=WINDOW, target=target)
    fitted, _ = trainer.fit(trains, spec, task, (0, 1))
    every, _ = tasks.examples_of(trains, np.arange(TRIALS), task)
    assert isinstance(fitted.network, RSNN)
    return fitted.network.infer(every.spikes).readout.numpy(), fitted.network


def test_why_keys_of_a_hidden_layer_have_no_effect_is_said_of_the_regression_of_numbers_too():
    assert {"logistic" in why for why in effects.voids(hidden=0).values()} == {False}
    assert "a regression fits the weights" in effects.voids(hidden=0)["reset"]


@pytest.mark.parametrize("spec", [SPEC, NONE], ids=["hidden", "no hidden"])
def test_another_unit_of_the_numbers_is_another_unit_of_the_values(spec):
    """A power of two changes no bit of what is learned, so that no spike is another."""
    values, _ = told(spec, CONDITIONS, "force_N", "speed")
    scaled = CONDITIONS.assign(force_N=CONDITIONS.force_N * 1024, speed=CONDITIONS.speed / 4)
    np.testing.assert_allclose(told(spec, scaled, "force_N", "speed")[0], values * [1024, 0.25], rtol=1e-5)


@pytest.mark.parametrize("a", [-3.0, 100.0])
def test_another_zero_of_the_numbers_is_another_zero_of_the_values(a):
    values, _ = told(NONE, CONDITIONS, "force_N")
    shifted, _ = told(NONE, CONDITIONS.assign(force_N=a + 5 * CONDITIONS.force_N), "force_N")
    np.testing.assert_allclose(shifted, a + 5 * values, atol=1e-3)


def test_a_network_without_a_hidden_layer_is_ridge_regression_on_counts():
    values, network = told(NONE.model_copy(update={"readout_stretches": 1}), CONDITIONS, "force_N", "speed")
    trains, task = touches(), Task(window=WINDOW, target=("force_N", "speed"))
    train = tasks.trials_of(trains, task).train
    counts = trains.raster(trains.cut(task.window)).sum(axis=1).astype(float)
    y, x = CONDITIONS[["force_N", "speed"]].to_numpy(), counts - counts[train].mean(axis=0)
    x /= np.sqrt(counts[train].var(axis=0).mean())
    found = [Ridge(alpha=1 / c).fit(x[train], y[train]).predict(x) for c in linear.INVERSE_PENALTIES]
    assert min(np.abs(one - values).max() for one in found) < 1e-4
    assert np.corrcoef(values[:, 0], y[:, 0])[0, 1] > 0.7
    assert network.bias is not None


@given(st.lists(st.floats(0.1, 50), min_size=2, max_size=2), st.lists(st.floats(-90, 90), min_size=2, max_size=2))
@examples(15)
def test_folding_gives_values_their_units_and_moves_no_spike(deviation, mean):
    generator = torch.Generator().manual_seed(0)
    spec = SPEC.model_copy(update={"readout_stretches": 3, "readout_stretch_ms": 20.0, "direct": True})
    network = RSNN(3, 2, spec, 1000.0, generator=generator)
    assert network.w_stretch is not None
    with torch.no_grad():
        network.w_stretch.normal_(generator=generator)
    spikes = (torch.rand(6, STEPS, 3, generator=generator) < 0.3).to(torch.uint8)
    before = network.infer(spikes)
    numbers.Scale(torch.tensor(mean).double(), torch.tensor(deviation).double()).fold(network)
    after = network.infer(spikes)
    expected = before.readout * torch.tensor(deviation).double() + torch.tensor(mean).double()
    torch.testing.assert_close(after.readout, expected, rtol=1e-4, atol=1e-3)
    assert torch.equal(after.hidden_spikes, before.hidden_spikes)


@given(st.integers(0, 99), st.integers(1, 3))
@examples(15)
def test_the_mean_score_is_r_squared_over_the_targets(seed, n_targets):
    rng = np.random.default_rng(seed)
    labels, values = rng.normal(5, 3, (2, 20, n_targets))
    spread = torch.from_numpy(labels.std(axis=0))
    score = float(opponent.right(torch.from_numpy(values), torch.from_numpy(labels), spread).mean())
    r2 = [numbers.errors(values, labels, [*"abc"[:n_targets]], np.arange(20))[f"r2_{x}"] for x in "abc"[:n_targets]]
    assert score == pytest.approx(np.mean(r2))


@given(st.lists(st.booleans(), min_size=12, max_size=12), st.lists(st.booleans(), min_size=12, max_size=12))
@examples(40)
def test_a_part_pays_by_scores_as_by_decisions(without, with_it):
    one, other = torch.tensor(without), torch.tensor(with_it)
    gained, lost = int((other & ~one).sum()), int((one & ~other).sum())
    assert ensemble.pays(one, other) == (gained - lost > (gained + lost) ** 0.5)
    assert ensemble.pays(one.double(), other.double()) == ensemble.pays(one, other)


def test_losses_of_numbers_are_means_over_targets_and_weighted_windows():
    values, wanted = torch.tensor([[1.0, 2.0], [0.0, 0.0]]), torch.tensor([[0.0, 0.0], [0.0, 4.0]])
    assert float(losses.of_scores("squared-error", values, wanted)) == (2.5 + 8) / 2
    assert float(losses.of_scores("absolute-error", values, wanted)) == (1.5 + 2) / 2
    assert float(losses.of_scores("absolute-error", values, wanted, torch.tensor([2.0, 0.0]))) == 1.5


def test_every_side_has_its_share_of_similar_numbers():
    split = tasks.trials_of(touches(), Task(window=WINDOW, target=("force_N",)))
    fifths = numbers.groups_of(CONDITIONS, ["force_N"])
    for side in split:
        n = np.bincount(fifths[side], minlength=5)
        assert n.max() - n.min() <= 1
    assert len({*numbers.groups_of(CONDITIONS, ["speed"])}) == 2  # equal numbers are not told apart
    one_class = touches(CONDITIONS.assign(label="touch"))  # which no network of classes would learn
    assert tasks.trials_of(one_class, Task(window=WINDOW, target=("force_N",))).test.tolist() == split.test.tolist()


def test_numbers_with_zeros_at_their_beginning_are_numbers():
    """File names give texts such as 03 and 012, whose order as texts is another."""
    of_numbers = CONDITIONS.assign(force_N=np.random.default_rng(4).permutation(TRIALS))
    written = of_numbers.assign(force_N=[f"0{force}" for force in of_numbers["force_N"]])
    task = Task(window=WINDOW, target=("force_N",))
    ours, theirs = (tasks.trials_of(touches(table), task) for table in (written, of_numbers))
    assert all(map(np.array_equal, ours, theirs))
    assert np.array_equal(numbers.of_trials(written, ["force_N"]), numbers.of_trials(of_numbers, ["force_N"]))
    with pytest.raises(InputError, match="all training trials have force_N = 7"):
        tasks.trials_of(touches(CONDITIONS.assign(force_N="07")), task)


@pytest.mark.parametrize(
    ("target", "column", "message"),
    [
        ("wet", ["01", "2 N"], "target: condition 'wet' holds no numbers, such as '01'"),
        ("forc_N", None, "target: there is no condition 'forc_N'; did you mean 'force_N'?"),
        ("label", None, "target: condition 'label' holds no numbers, such as 'felt'; leave `target` out"),
        ("wet", [True, False], "target: condition 'wet' holds no numbers"),
        ("mass", [1.0, np.nan], "target: trial 1 has no 'mass'; add it, or leave its trial out"),
        ("mass", [3.0], "target: all training trials have mass = 3, so that nothing can be learned"),
    ],
)
def test_what_is_no_number_of_every_trial_is_refused(target, column, message):
    table = CONDITIONS if column is None else CONDITIONS.assign(**{target: np.resize(column, TRIALS)})
    with pytest.raises(InputError, match=re.escape(message)):
        tasks.trials_of(touches(table), Task(window=WINDOW, target=(target,)))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "readout = 'count' tells classes; numbers need readout = 'integrator'"),
        ({"readout": "max"}, "readout = 'max' tells classes"),
        ({"recipe": "default", "readout": "count"}, "readout = 'count' tells classes"),
        (
            {"readout": "integrator", "training": {"loss": "hinge"}},
            "training.loss: 'hinge' is of classes; numbers need",
        ),
        ({"readout": "integrator", "training": {"temperature": 0.5}}, "training.temperature: scales scores of classes"),
        ({"hidden": [4, 2]}, "model = 'layered' learns classes alone"),
    ],
)
def test_a_network_without_a_value_in_units_is_refused(keys, message):
    with pytest.raises(InputError, match=re.escape(message)):
        numbers.spec_for(RSNNSpec.model_validate(keys), ("force_N",))


def test_a_loss_of_numbers_is_the_usual_one_and_needs_a_target():
    assert numbers.spec_for(RSNNSpec(recipe="default"), ("force_N",)).training.loss == "squared-error"
    asked = RSNNSpec.model_validate({"recipe": "default", "training": {"loss": "absolute-error"}})
    assert numbers.spec_for(asked, ("force_N",)) == asked
    with pytest.raises(InputError, match="'absolute-error' is of numbers; name them with `target`"):
        numbers.spec_for(asked, ())
    assert numbers.spec_for(RSNNSpec(), ()).training.loss == "cross-entropy"


def test_rivals_tell_the_same_numbers_and_a_better_one_is_found():
    """The network that answers with the mean is worse than ridge regression, and one that is always right is better."""
    trains, task = touches(), Task(window=WINDOW, target=("force_N", "speed"))
    sides = tasks.sides_of(trains, task)
    n = [np.arange(len(side.labels)) for side in sides]
    trials = Trials(n[1], n[2])
    found = {one.name: one.accuracy_test for one in comparison.opponents_of(sides, trials)}
    assert found.keys() == {
        f"{name} on {source}"
        for name in ("ridge regression", "SVR", "extra trees regression")
        for source in ("counts", "10 time bins")
    }
    assert found["ridge regression on counts"] > 0.6
    mean = opponent.right(sides.train.labels.mean(dim=0).expand(len(n[2]), 2), sides.test.labels, sides.test.deviation)
    worse = comparison.compare(mean.tolist(), sides, trials, 2)
    assert worse.verdict == "worse"
    assert worse.accuracy == pytest.approx(worse.commonest)
    assert worse.low < worse.accuracy < worse.high
    assert comparison.compare([1.0] * len(n[2]), sides, trials, 2).verdict == "better"
    alone = tasks.sides_of(trains, Task(window=WINDOW, target=("force_N",)))
    assert all(one.accuracy_test > 0.2 for one in comparison.opponents_of(alone, trials))
    with pytest.raises(InputError, match="'ridge regression' tells numbers, and classes are asked for"):
        opponent.load("ridge regression")
    assert {one.tells for one in opponent.joined("features", "all").values()} == {"classes"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder of a network of two numbers, and what its training said."""
    folder = tmp_path_factory.mktemp("numbers")
    nt.save(touches(), folder / "spikes.h5")
    said = []
    keys = {"hidden": 0}
    learn = nt.Learn(target=["force_N", "speed"])
    window = nt.Window(length_ms=STEPS)
    row = nt.train(folder / "spikes.h5", folder / "run", "default", keys, window=window, learn=learn, tell=said.append)
    return folder, row, said


def test_a_training_tells_errors_in_units_beside_rivals(run):
    folder, row, said = run
    table = nt.infer(folder / "run", folder / "spikes.h5", test_only=True)
    error = table["predicted_force_N"] - table["true_force_N"]
    assert row["rmse_force_N"] == pytest.approx(np.sqrt((error**2).mean()))
    assert row["mae_force_N"] == pytest.approx(error.abs().mean())
    assert row["rmse_force_N_low"] < row["rmse_force_N"] < row["rmse_force_N_high"]
    assert row["r2_speed"] > 0.5 < row["accuracy_test"]
    assert f"force_N: root-mean-square error {row['rmse_force_N']:.3g} (95 % interval " in "\n".join(map(str, said))
    assert "baselines: the mean of training " in "\n".join(map(str, said))
    assert not any(word in str(line) for line in said for word in ("chance", "confused"))
    assert re.search(r"with early exit .* ms, at a score of 0\.\d+$", "\n".join(map(str, said)), re.MULTILINE)
    assert read_json(folder / "run" / "network.json")["extra"]["classes"] == ["force_N", "speed"]


def test_decisions_have_both_numbers_and_their_summary_has_the_error(run):
    folder, _, _ = run
    table = nt.infer(folder / "run", folder / "spikes.h5")
    columns = ["trial", "side", "label", "true_force_N", "predicted_force_N", "true_speed", "predicted_speed", "steps"]
    assert table.columns[:8].tolist() == columns
    np.testing.assert_allclose(table["true_speed"], CONDITIONS["speed"])
    means = nt.summarise(table)
    of_test = table[(table.side == "test")]
    every = means[(means.side == "test") & (means.label == "all")].iloc[0]
    assert every["rmse_speed"] == pytest.approx(((of_test.true_speed - of_test.predicted_speed) ** 2).mean() ** 0.5)
    assert "accuracy" not in means


def short_touches(folder, until: int, **how):
    """A network of touches that end at a step of the window, in `folder`, and its decisions on whole windows and early.

    Returned with the rows of the training.
    """
    whole = touches()
    raster = whole.raster(whole.cut(WINDOW))
    raster[:, until:] = 0
    nt.save(from_rasters(raster, 1000.0, whole.afferents, CONDITIONS), folder / "spikes.h5")
    learn, keys = nt.Learn(target=["force_N", "speed"]), {"hidden": 0}
    row = nt.train(folder / "spikes.h5", folder / "run", "default", keys, window=WINDOW, learn=learn, **how)
    return row, *(nt.infer(folder / "run", folder / "spikes.h5", early_exit=early) for early in (False, True))


def test_numbers_that_have_settled_save_the_rest_of_a_window(tmp_path, capsys):
    row, whole, early = short_touches(tmp_path, 25)
    names = ["predicted_force_N", "predicted_speed", "input_spikes", "sops_total"]
    pd.testing.assert_frame_equal(early[names], whole[names])  # what comes later is silence
    assert (whole["steps"] == STEPS).all()
    assert 25 < early["steps"].mean() < 0.8 * STEPS
    assert "not used" not in capsys.readouterr().err
    tested = early[early["side"] == "test"]
    assert row["exit_steps"] == tested["steps"].mean()
    assert row["exit_accuracy"] == row["accuracy_test"]
    assert row["exit_loss_bound"] <= 0.01


@pytest.mark.parametrize(
    ("losses", "rule", "said"),
    [
        ({0: 0.5, 1: 0.0, 2: 0.0}, EXIT, "it may lose up to 0.43 of the score, of which 0.01 is allowed (95 % bound"),
        ({0: 0.001, 1: 0.0, 2: -0.001}, EXIT, ""),
        ({}, FULL_WINDOW, "no rule saves steps and loses as little as is allowed"),
    ],
)
def test_early_exit_of_numbers_that_may_lose_too_much_is_not_used_and_said_so(run, losses, rule, said, capsys):
    folder, _, _ = run
    restored, trains = run_folder.restore(folder / "run"), hdf5.load_spikes(folder / "spikes.h5")
    restored = restored._replace(rule=rule, held=ExitChoice(rule, losses, 0.01))
    whole, early = (inference.infer(restored, trains, early_exit=early) for early in (False, True))
    told = capsys.readouterr().err
    if said:
        assert f"early exit is not used, whole windows decide: {said}" in told
        pd.testing.assert_frame_equal(early, whole)
    else:
        assert "not used" not in told
        assert (early["steps"] <= whole["steps"]).all()
        assert early["steps"].mean() < whole["steps"].mean()
        assert early["sops_total"].mean() < whole["sops_total"].mean()


def test_a_run_keeps_its_rule_and_what_it_loses(tmp_path):
    row, *_ = short_touches(tmp_path, 25)
    restored = run_folder.restore(tmp_path / "run")
    assert restored.held is not None
    assert len(restored.rule.band) == 2
    assert restored.rule.patience == row["exit_patience"]
    assert restored.held.bound == row["exit_loss_bound"]
    ratio = restored.rule.band[0] / CONDITIONS["force_N"].std(ddof=0)
    assert any(ratio == pytest.approx(share, rel=0.2) for share in trainer.BANDS)


@given(st.integers(0, 30), st.integers(1, 20), st.sampled_from([0.0, 0.02, 0.5]), st.booleans())
@examples(15)
def test_exits_of_every_patience_are_those_of_decisions(seed, patience, band, leaks):
    generator = torch.Generator().manual_seed(seed)
    keys = {"readout_tau_ms": 9.0} if leaks else {"readout_stretches": 3, "readout_stretch_ms": 20.0}
    spec = RSNNSpec.model_validate(
        {"hidden": 4, "model": "snn", "readout": "integrator", "forward_weight_scale": 3.0, **keys}
    )
    network = RSNN(3, 2, spec, 1000.0, generator=generator)
    spikes = (torch.rand(5, 40, 3, generator=generator) < 0.2).to(torch.uint8)
    bands = (band, 2 * band)
    found = exits(network.simulate(spikes).readout, integration=network.integration, band=bands)
    decided = network.infer(spikes, ExitRule(patience, from_first_spike=True, band=bands))
    assert torch.equal(decided.steps, found.steps[:, patience - 1])
    assert torch.equal(decided.readout, found.labels[:, patience - 1])
    assert torch.equal(found.labels[:, -1], network.infer(spikes).readout)
    scores = is_right(found, decided.readout, torch.ones(2))
    assert (scores[:, patience - 1] == 1).all()
    assert (scores <= 1).all()


@given(st.lists(st.floats(-0.5, 0.9), min_size=1, max_size=30), st.floats(0.01, 100.0))
@examples(40)
def test_the_bound_of_scores_has_their_unit_and_is_not_below_their_mean(losses, unit):
    bound = float(upper_bound(losses, of_numbers=True))
    assert bound >= np.mean(losses) - 1e-12 or bound == pytest.approx(np.abs(losses).max())
    assert float(upper_bound(np.multiply(losses, unit), of_numbers=True)) == pytest.approx(unit * bound)


def test_touches_without_the_number_are_told_one(run):
    folder, _, _ = run
    unknown = touches(CONDITIONS.drop(columns="force_N").assign(label="new"))
    table = nt.infer(folder / "run", unknown)
    known = nt.infer(folder / "run", folder / "spikes.h5")
    assert table["true_force_N"].isna().all()
    np.testing.assert_array_equal(table["predicted_force_N"], known["predicted_force_N"])


def test_a_training_of_numbers_goes_on_where_it_was_interrupted(tmp_path):
    """A checkpoint holds the network as it learns, before its values have units."""
    trains, task, kept = touches(), Task(window=WINDOW, target=("force_N",)), []
    whole, _ = trainer.fit(trains, SPEC, task, (0, 1), keep=kept.append)
    again, _ = trainer.fit(trains, SPEC, task, (0, 1), start=kept[0])
    for name, weights in whole.network.state_dict().items():
        assert torch.equal(weights, again.network.state_dict()[name]), name


def test_what_needs_classes_refuses_a_network_of_numbers(run):
    folder, _, _ = run
    for use in (nt.fine_tune, nt.save_energy):
        with pytest.raises(InputError, match=r"tells numbers \(force_N, speed\), and .* needs classes"):
            use(folder / "run", folder / "other")


def test_a_network_of_classes_says_nothing_of_a_target():
    assert "target" not in Task(window=WINDOW).model_dump(mode="json")
    assert Task(window=WINDOW, target="force_N").model_dump()["target"] == ("force_N",)


def test_measurements_as_classes_are_told_how_to_ask_for_numbers():
    with pytest.raises(InputError, match=r"name no classes.*give them as a condition and train with `target`"):
        nt.Recordings(np.zeros((2, 9, 1)), 100.0, "mV", [0.5, 1.25])
