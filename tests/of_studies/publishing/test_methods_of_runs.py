"""The methods tell what ran: the networks, the fitted encoders, the rivals and the machine of a finished study."""

import pytest
from neurotact_parts.studies.publishing import methods
from neurotact_parts.studies.publishing.ran import Ran

from neurotact.studies import loading

PERIODS = loading.resolve("refractory-period")
TRAINING = {"optimiser": "AdamW", "epochs": 321, "loss": "hinge", "keep": "accuracy"}
LAYERED = {"model": "snn", "hidden": 20, "tau_mem_ms": 77.0, "recurrent_weight_scale": 0.1, "training": TRAINING}
NONE = {"model": "snn", "hidden": 0, "tau_mem_ms": 5.5, "training": {**TRAINING, "epochs": 9}}


def told(ran: Ran, study=PERIODS, facts=(), **changes) -> str:
    return methods.in_words(study.model_copy(update=changes), facts, ran)


def test_the_networks_that_ran_are_told_and_not_those_of_the_spec():
    text = told(Ran(networks=[LAYERED]))
    assert "by a feed-forward spiking network with membrane time constant 77 ms." in text
    assert "minimised the hinge; optimiser AdamW, epochs at most 321." in text
    assert "epoch of the highest validation accuracy" in text
    assert "recurrent" not in text
    assert "regression, with a penalty" not in text


def test_what_networks_do_not_share_is_told_by_size():
    wide = {**LAYERED, "hidden": 50, "tau_mem_ms": 88.0, "training": {**TRAINING, "batch": 7}}
    text = told(Ran(networks=[LAYERED, wide, {**wide, "training": {**TRAINING, "batch": 8}}]))
    assert "Networks of 20 hidden neurons had membrane time constant 77 ms." in text
    assert "Networks of 50 hidden neurons had membrane time constant 88 ms." in text
    assert "These differ between networks of one size: training batch 7 and 8." in text


@pytest.mark.parametrize(("target", "fit"), [((), "logistic"), (("force_N",), "ridge")])
def test_networks_without_a_hidden_layer_are_fitted_and_not_trained(target, fit):
    changes = {"way": "targets", "parameters": {"target": [*target]}} if target else {}
    text = told(Ran(networks=[NONE, LAYERED]), **changes)
    assert f"fitted by {fit} regression" in text
    assert "5.5 ms" not in text
    assert "epochs at most 321" in text
    alone = told(Ran(networks=[NONE]), **changes)
    assert f"fitted by {fit} regression" in alone
    assert "minimised" not in alone


@pytest.mark.parametrize(
    ("target", "expected", "left_out"),
    [
        (
            "force_N",
            ["used to tell force_N", "force_N was told by", "numbers have settled"],
            ["classified", "logistic"],
        ),
        ("events", ["Events were detected by", "without a reset"], ["classified", "Early exit", "logistic"]),
    ],
)
def test_a_study_of_numbers_or_events_classifies_nothing(target, expected, left_out):
    text = told(
        Ran(networks=[LAYERED], rivals={"signals: counts": ["ridge"]}),
        way="targets", parameters={"target": [target]}, notes=("Clock: 1.", "Gains: chosen by ranges."), calibrate=True,
    )  # fmt: skip
    expected = [*expected, "Gains: chosen by ranges.", "on signals (counts): ridge"]
    assert [words for words in expected if words not in text] == []
    assert [words for words in left_out if words in text] == []
    assert "Early exit" in told(Ran(networks=[LAYERED]))


def test_the_fitted_encoder_is_told():
    assert "moving average with a cut-off at 30 Hz" in told(Ran())
    fitted = {
        "model": "lif", "unit": "mV", "tau_mem_ms": 12.25, "sa1": {"gain": 45.1, "t_ref_ms": 1.0, "opposite": True},
        "conditioning": {"resample_Hz": 1000.0, "offset": [1.5], "scale": [2.5], "taxels": ["a"]},
    }  # fmt: skip
    other = {**fitted, "sa1": {**fitted["sa1"], "gain": 46.2}}
    text = told(Ran(encoders=[fitted, other, fitted], afferents=[24, 24, 24]), calibrate=True)
    assert "Signals were put on a clock of 1000 Hz and standardised, taxel by taxel" in text
    assert "membrane time constant 12.25 ms, SA-I (for the rising and the falling signal)" in text
    assert "These differ between the networks: SA-I (gain 45.1 and 46.2)." in text
    assert "There were 24 afferents." in text
    assert "smoothed" not in text


def test_calibration_may_choose_grades_only_with_varied_copies():
    study = loading.resolve("refractory-period", {"augmentation.kind": "time"})
    study = study.model_copy(update={"calibrate": True, "choose_grades": True})
    assert "of several thresholds" in told(Ran(), study)
    assert "of several thresholds" not in told(Ran(), study, augmentation=None)


def chosen_by_calibration(**changes) -> list[str]:
    study = loading.resolve("refractory-period", {key.replace("__", "."): value for key, value in changes.items()})
    study = study.model_copy(update={"calibrate": True, "choose_ema": True, "choose_opposite": True})
    said = told(Ran(), study).partition("These were chosen on the training trials alone: ")[2].partition(".")[0]
    return said.replace(" and ", ", ").split(", ")


def test_only_what_calibration_chose_of_this_encoder_is_told():
    whole = [
        "the baseline", "the standardisation", "the gains", "the cut-off of the moving average",
        "whether some SA-I follow the falling signal",
    ]  # fmt: skip
    assert chosen_by_calibration() == whole
    assert chosen_by_calibration(encoder__conditioning__baseline="start") == whole[1:3]
    assert chosen_by_calibration(encoder="izhikevich") == whole[:4]
    of_changes = chosen_by_calibration(encoder="send-on-delta", encoder__conditioning__baseline="mean")
    assert of_changes == [*whole[:2], "the thresholds", whole[3]]


@pytest.mark.parametrize(("trials", "is_told"), [("644", False), ("1,000", False), ("1001", True)])
def test_a_limit_of_trials_is_told_where_it_left_some_out(trials, is_told):
    dataset = PERIODS.dataset.model_copy(update={"at_most": 1000})
    assert ("At most 1000 trials" in told(Ran(), facts=[f"{trials} trials of 7 classes"], dataset=dataset)) is is_told
    assert "At most 1000 trials" in told(Ran(), dataset=dataset)


def test_starts_the_machine_and_the_rivals_are_told():
    versions = {"python": "3.11.7", "machine": "x86_64", "instructions": "AVX2", "backend": "native", "torch": "2.1"}
    text = told(
        Ran(versions=versions | {"nni": "3.0"}, rivals={"signals": ["SVM", "GRU"], "spikes: counts": ["SVM"]}),
        sweep={"seed": [0, 1, 2]},
    )
    assert "x86_64 with AVX2, by the native kernels, Python 3.11.7, torch 2.1." in text
    assert "tuned on the validation trials: on signals: SVM and GRU; on spikes (counts): SVM." in text
    assert "trained from 3 starts (seed 0, 1 and 2)" in text
    assert "nni 3.0" not in text
