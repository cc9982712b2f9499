"""Every key of a calibrated study's encoder takes effect or is refused: none is ignored."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import neurotact as nt
from neurotact import cli
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders import calibration, gain_search
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.errors import InputError
from neurotact.report import front
from neurotact.spec import leaves
from neurotact.studies import loading, networks, preparation, study
from neurotact.tables import read_table

RULE = CalibrationRule(candidates=10, step=1.6, excerpt_s=0.4, trials_per_class=6, shuffles=1, max_silent_share=0.2)
SMALL = {
    "baselines": "quick",
    "sweep.seed": [0],
    "sweep.network.hidden": [4],
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]],
}
PERIODS = {**SMALL, "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 10]]}
FOUND = "calibration sets it from the training trials"


@pytest.fixture
def touches(tmp_path):
    rng = np.random.default_rng(0)
    time_s = np.arange(0, 0.4, 1e-3)
    signals = [
        np.sin(2 * np.pi * (4 + 6 * (n % 2)) * time_s + rng.uniform(0, 6))[:, None] * [9.0, 5.0]
        + rng.normal(0, 0.3, (len(time_s), 2))
        for n in range(20)
    ]
    path = tmp_path / "touches.h5"
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": ["felt", "silk"] * 10})), path)
    return path


def encoded(touches, monkeypatch, **changes):
    """The run folder, its study and the encoder with which each cell's spikes were made."""
    calibration_for = calibration.calibration_for

    def quickly(spec, given, **choices):
        fit, times = calibration_for(spec, given, **choices)
        return lambda recordings, spec, rule, **how: fit(recordings, spec, rule=RULE, **how), times

    monkeypatch.setattr(preparation, "calibration_for", quickly)
    what = loading.resolve("own-recordings", {**SMALL, **changes}, data=touches)
    folder = touches.parent / "run"
    preparation.prepare(folder, what, list(study.cells(what)))
    return folder, what, [hdf5.load_spikes(folder / cell.given).encoder for cell in study.cells(what)]


def test_calibration_keeps_the_groups_of_the_split_together(touches, monkeypatch):
    given, asked = hdf5.load_recordings(touches), []
    told = given.conditions.assign(subject=np.arange(len(given)) // 2 % 5)
    hdf5.save_recordings(replace(given, conditions=told), touches)
    calibrate = calibration.calibrate
    monkeypatch.setattr(calibration, "calibrate", lambda *a, **how: asked.append(calibrate(*a, **how)) or asked[-1])
    encoded(touches, monkeypatch, **{"split.group": "subject"})
    assert asked
    assert all(found.folds is not None for found in asked)


@pytest.mark.parametrize(
    ("changes", "choice"),
    [
        ({"sweep.choose_ema": [False, True]}, "choose_ema"),
        ({"sweep.augmentation.kind": ["none", "gain"], "split.test_where.size": 1}, "choose_grades"),
        ({"sweep.augmentation.kind": ["gain", "none"], "split.test_where.size": 1}, "choose_grades"),
    ],
)
def test_cells_that_let_calibration_choose_other_keys_have_their_own_encoder(touches, monkeypatch, changes, choice):
    asked = []

    def calibration_for(spec, _, **choices):
        asked.append(choices[choice])
        found = spec.model_copy(update={"tau_mem_ms": 10.0 + choices[choice]})
        return lambda *_, **__: SimpleNamespace(encoder=found), 1

    monkeypatch.setattr(preparation, "calibration_for", calibration_for)
    recordings = hdf5.load_recordings(touches)
    table = recordings.conditions.assign(size=np.arange(20) // 2 % 3)
    hdf5.save_recordings(replace(recordings, conditions=table), touches)
    cells = [*study.cells(loading.resolve("own-recordings", {**SMALL, **changes}, data=touches))]
    calibrated, recordings = {}, hdf5.load_recordings(touches)
    found = [preparation.encoder_of(cell, recordings, calibrated) for cell in cells]
    assert {getattr(cell, choice) for cell in cells} == {False, True}
    assert [encoder.tau_mem_ms for encoder in found] == [10.0 + getattr(cell, choice) for cell in cells]
    assert len(asked) == 2


def taxels(path, rate_Hz):
    """Touches of three classes in counts, on pressures of their own, of 1.2 s."""
    rng, time_s = np.random.default_rng(1), np.arange(round(1.2 * rate_Hz))[:, None] / rate_Hz
    signals = [
        400 + 30 * (n % 3) + [60, 25, 40] * np.sin(2 * np.pi * (1 + 2 * (n % 3)) * time_s + rng.uniform(0, 6, 3))
        + rng.normal(0, 4, (len(time_s), 3))
        for n in range(60)
    ]  # fmt: skip
    labels = pd.DataFrame({"label": [*("denim", "linen", "canvas")] * 20})
    hdf5.save_recordings(Recordings(signals, rate_Hz, "count", labels), path)
    return path


@pytest.mark.parametrize(
    ("rate_Hz", "given", "integration"),
    [
        (35.0, {}, "exact"),
        (35.0, {"integration": "clock"}, "clock"),
        (35.0, {"conditioning.resample_Hz": 2000.0}, "exact"),
        (2000.0, {"conditioning.resample_Hz": 1000.0}, "clock"),
    ],
)
def test_by_hand_the_encoder_is_that_of_the_study(tmp_path, monkeypatch, caplog, rate_Hz, given, integration):
    monkeypatch.setattr(gain_search, "CalibrationRule", lambda **_: RULE)
    touches = taxels(tmp_path / "touches.h5", rate_Hz)
    window = {"window.length_ms": 1200.0, "window.start_ms": 0.0, "split.seed": 0}
    of_study = {f"encoder.{key}": value for key, value in given.items()}
    _, what, (used,) = encoded(touches, monkeypatch, **window, **of_study)
    caplog.clear()
    by_hand = nt.calibrate(touches, settings={**given, "tau_mem_ms": what.encoder.tau_mem_ms})
    (cell,) = study.cells(what)
    made = nt.encode(nt.load(touches), by_hand)
    assert by_hand.integration == integration
    assert made.encoder == used
    assert made.sampling_rate_Hz == hdf5.load_spikes(tmp_path / "run" / cell.given).sampling_rate_Hz
    said = [record for record in caplog.records if "once per sample" in record.getMessage()]
    assert len(said) == (integration == "exact")


def test_a_comparison_takes_the_closed_form_too(tmp_path, monkeypatch):
    monkeypatch.setattr(gain_search, "CalibrationRule", lambda **_: RULE)
    assert nt.calibrate(taxels(tmp_path / "touches.h5", 35.0), compare=True).integration == "exact"


def test_swept_keys_are_those_of_the_encoder_of_each_cell(touches, monkeypatch):
    one = {"tau_mem_ms": 5.0, "v_threshold_mV": -58.0, "conditioning.ema_cutoff_Hz": 10.0, "sa1.opposite": False}
    other = {"tau_mem_ms": 20.0, "v_threshold_mV": -50.0, "conditioning.ema_cutoff_Hz": 40.0, "sa1.opposite": True}
    one, other = {**one, "conditioning.baseline": "none"}, {**other, "conditioning.baseline": "start"}
    axis = " & ".join(f"encoder.{key}" for key in one)
    sweep = {f"sweep.{axis}": [[*one.values()], [*other.values()]]}
    _, _, found = encoded(touches, monkeypatch, baselines="none", **sweep)
    for asked, made in zip((one, other), found, strict=True):
        assert ({"sa1.opposite": False} | leaves(made)).items() >= asked.items()
        assert made["sa1"]["gain"] != 3.2  # the spec's; calibration has found another


def test_pairs_of_refractory_periods_share_one_fit(touches, monkeypatch):
    _, _, (one, other) = encoded(touches, monkeypatch, **{**PERIODS, "baselines": "none"})
    assert (one["sa1"]["t_ref_ms"], other["sa1"]["t_ref_ms"]) == (1.0, 10.0)
    assert one["sa1"]["gain"] == other["sa1"]["gain"]
    assert one["conditioning"] == other["conditioning"]


def test_baselines_stand_beside_the_networks_of_their_encoder(touches, monkeypatch):
    swept = {"sweep.encoder.tau_mem_ms": [5.0, 20.0]}
    folder, what, _ = encoded(touches, monkeypatch, **swept)
    table = baselines_beside(folder, what)
    of_spikes = table["input"].str.startswith("spikes")
    assert set(table.loc[of_spikes, "encoder.tau_mem_ms"]) == {5.0, 20.0}
    assert table.loc[~of_spikes, "encoder.tau_mem_ms"].isna().all()
    for tau_ms in (5.0, 20.0):
        mine = table[~of_spikes | (table["encoder.tau_mem_ms"] == tau_ms)]
        found = front.baselines_of(what, {"baselines": table}, {"dataset": "all", "encoder.tau_mem_ms": tau_ms})
        energies = mine.set_index(["classifier", "input"])["energy_estimate_nJ"]
        assert sorted(one.nJ or 0.0 for one in found) == sorted(energies)


@pytest.fixture
def at_speeds(touches):
    """The touches, each second pair of them at another speed."""
    recordings = hdf5.load_recordings(touches)
    speeds = recordings.conditions.assign(speed=[*[1.0, 1.0, 2.0, 2.0] * 5])
    hdf5.save_recordings(Recordings(recordings.signals, 1000.0, "mV", speeds), touches)
    return touches


def baselines_beside(folder, what):
    beside = networks.ENGINE.beside(folder, what, list(study.cells(what)), True)
    beside.write(dict(enumerate(map(beside.run, beside.jobs))))
    return read_table(folder / "baselines.csv")


def test_baselines_on_spikes_have_the_encoder_of_their_own_data_set(at_speeds, monkeypatch):
    """Where conditions that are not known are tested, each data set has an encoder that knows no other trials."""
    sets = {"all": {}, "slow": {"speed": [1.0]}}
    known = {"dataset.subsets": sets, "dataset.stratify": ["speed"], "sweep.dataset": [*sets]}
    folder, what, found = encoded(at_speeds, monkeypatch, baselines="readout", test_every_condition=True, **known)
    assert found[0] != found[1]
    table = baselines_beside(folder, what)
    rows = sorted(zip(table["dataset"], table["input"].str.partition(":")[0], strict=True))
    assert rows == [(name, of) for name in ("all", "slow") for of in ("signals", "spikes")]


def test_baselines_learn_from_the_varied_copies_of_their_own_networks(at_speeds, monkeypatch):
    given = {"baselines": "readout", "split.test_where": {"speed": 2.0}, "choose_grades": False}
    kinds = {"sweep.augmentation.kind": ["none", "time"]}
    folder, what, _ = encoded(at_speeds, monkeypatch, **given, **kinds)
    assert [study.value_at(cell, "augmentation.kind") for cell in study.cells(what)] == ["none", "time"]
    table = baselines_beside(folder, what)
    assert table["augmentation.kind"].tolist() == ["none", "none", "time", "time"]
    assert (table["n_train"].diff().iloc[1:] > 0).tolist() == [False, True, False]
    for kind, rows in table.groupby("augmentation.kind"):
        found = front.baselines_of(what, {"baselines": table}, {"dataset": "all", "augmentation.kind": kind})
        assert [one.rows for one in found] == [(index,) for index in rows.index]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"encoder.sa1.gain": 3.0}, f"encoder.sa1.gain: {FOUND}"),
        ({"sweep.encoder.ra1.gain": [3.0, 5.0]}, f"encoder.ra1.gain: {FOUND}"),
        ({"sweep.encoder.sa1.gain & encoder.tau_mem_ms": [[3.0, 5.0]]}, f"encoder.sa1.gain: {FOUND}"),
        ({"encoder.sa1": {"gain": 3.0, "t_ref_ms": 5.0}}, f"encoder.sa1.gain: {FOUND}"),
        ({"encoder.unit": "N"}, f"encoder.unit: {FOUND}"),
        ({"encoder.conditioning": {"offset": [1.0, 2.0]}}, f"encoder.conditioning.offset: {FOUND}"),
        ({"sweep.encoder.conditioning.scale": [[1.0, 2.0]]}, f"encoder.conditioning.scale: {FOUND}"),
        ({"encoder.conditioning.baseline": "mean"}, "'mean' uses the whole trial"),
        ({"sweep.encoder.conditioning.baseline": ["none", "mean"]}, "'mean' uses the whole trial"),
        ({"encoder.conditioning.high_pass_Hz": 1.0}, "the baseline 'mean' ignores it"),
        (
            {"sweep.encoder.conditioning.start_ms": [50.0], "encoder.conditioning.baseline": "high-pass"},
            "the baseline 'high-pass' ignores it",
        ),
        ({"sweep.encoder.sa1.grades": [[0.5, 1.0], [0.2, 1.0]]}, "lists of the same length give the same encoder"),
        ({"encoder": "send-on-delta", "encoder.threshold": 2.0}, "encoder.threshold: calibration sets it"),
    ],
)
def test_a_key_that_would_be_ignored_is_refused(touches, changes, words):
    with pytest.raises(InputError, match=words):
        loading.resolve("own-recordings", changes, data=touches)


@pytest.mark.parametrize(
    "changes",
    [
        {"encoder.conditioning.start_ms": 50.0},
        {"encoder.conditioning.baseline": "high-pass", "sweep.encoder.conditioning.high_pass_Hz": [0.5, 1.0]},
        {"encoder.sa1.gain": 3.0, "calibrate": False},
        {"encoder": "sa1-ra1-lif-graded"},
    ],
)
def test_a_key_that_takes_effect_is_not_refused(touches, changes):
    plain = loading.resolve("own-recordings", SMALL, data=touches)
    changed = loading.resolve("own-recordings", {**SMALL, **changes}, data=touches)
    names = [{cell.spikes_name for cell in study.cells(one)} for one in (plain, changed)]
    assert not names[0] & names[1] - {next(iter(names[0]))}


@pytest.mark.parametrize(
    ("changes", "is_chosen"),
    [
        ({}, True),
        ({"encoder.conditioning.high_pass_Hz": 1.0, "encoder.conditioning.baseline": "high-pass"}, True),
        ({"encoder.conditioning.ema_cutoff_Hz": 50.0}, False),
        ({"encoder.conditioning": {"ema_cutoff_Hz": 50.0}}, False),
        ({"sweep.encoder.conditioning.ema_cutoff_Hz": [30.0, 50.0]}, False),
        ({"calibrate": False}, False),
        ({"choose_ema": False}, False),
    ],
)
def test_the_moving_average_is_chosen_unless_it_is_given(touches, changes, is_chosen):
    what = loading.resolve("own-recordings", {**SMALL, **changes}, data=touches)
    assert {cell.choose_ema for cell in study.cells(what)} == {is_chosen}


@pytest.mark.parametrize(
    ("changes", "is_chosen"),
    [
        ({}, True),
        ({"encoder.conditioning.ema_cutoff_Hz": 50.0}, True),
        ({"encoder.sa1.opposite": False}, False),
        ({"sweep.encoder.sa1.opposite": [False, True]}, False),
        ({"choose_opposite": False}, False),
    ],
)
def test_sa1_of_the_falling_signal_are_chosen_unless_they_are_given(touches, changes, is_chosen):
    what = loading.resolve("own-recordings", {**SMALL, **changes}, data=touches)
    assert {cell.choose_opposite for cell in study.cells(what)} == {is_chosen}


def test_the_choice_of_the_moving_average_decides_the_spikes_of_a_cell(touches, monkeypatch):
    """With the same encoder to begin with; and what is given reaches the calibration."""
    asked = []
    monkeypatch.setattr(calibration, "calibrate_causally", lambda *_, choose_ema, **__: asked.append(choose_ema))
    chosen, own = (
        next(study.cells(loading.resolve("own-recordings", {**SMALL, "choose_ema": on}, data=touches)))
        for on in (True, False)
    )
    assert (chosen.calibrate, chosen.seeds) == (own.calibrate, own.seeds)
    assert chosen.spikes_name != own.spikes_name
    assert chosen.digest() != own.digest()
    for cell in (chosen, own):
        with pytest.raises(AttributeError):  # None has no encoder
            preparation.encoder_of(cell, hdf5.load(touches), {})
    assert asked == [True, False]


@pytest.mark.parametrize(
    ("name", "key", "words"),
    [
        ("pvdf-hardness", "encoder.sa1.gain", FOUND),
        ("pvdf-hardness", "sweep.encoder.unit", FOUND),
        ("quantisation", "parameters.encoder.conditioning.scale", FOUND),
        ("quantisation", "encoder.sa1.t_ref_ms", "set t_ref_ms, as in"),
        ("ways-to-save", "data.sets.fabrics.conditioning.offset", "offset and scale are fitted"),
    ],
)
def test_protocols_that_calibrate_refuse_what_calibration_finds(name, key, words):
    with pytest.raises(InputError, match=words):
        loading.resolve(name, {key: [2.0]})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "sa1.gain=3"], "sa1.gain: " + FOUND),
        (["--compare", "--set", "conditioning.baseline=none"], "conditioning.baseline: --compare tries all of them"),
    ],
)
def test_the_command_refuses_what_it_finds_itself(touches, monkeypatch, capsys, options, words):
    argv = ["neurotact", "calibrate", str(touches), "-o", str(touches.parent / "mine.toml"), *options]
    monkeypatch.setattr(sys, "argv", argv)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 2
    assert words in capsys.readouterr().err
