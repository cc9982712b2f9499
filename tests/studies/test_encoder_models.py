"""A study of Izhikevich or Poisson afferents, with or without recurrence, goes the whole way to its report."""

import json
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pytest
from levels import thinned

from neurotact.encoders.specs import load, period_keys
from neurotact.report import report
from neurotact.spec import read, shipped, to_toml
from neurotact.studies import loading, runner

TINY = Path(__file__).parent / "tiny.toml"


def study_of(tmp_path: Path, **parts) -> Path:
    """The tiny study with other parts and a sweep of its own, as a file."""
    table = {**read(TINY), **parts}
    (tmp_path / "mine.toml").write_text(to_toml(table), encoding="utf-8")
    return tmp_path / "mine.toml"


@contextmanager
def in_this_process(workers, scheduler):
    yield lambda kind, cells, folder, _: (
        (cell, kind.run(cell, kind.load(folder / cell.given), None, False)) for cell in cells
    )


@pytest.mark.thorough
@thinned(("encoder", "gain"), [("izhikevich", "gain_mV_per_ms"), ("poisson", "gain_Hz")])
def test_a_study_of_other_afferents_reports(encoder, gain, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "executor", in_this_process)
    monkeypatch.setattr(runner, "in_a_process", lambda function, *arguments: function(*arguments))
    sweep = {f"encoder.sa1.{gain}": [3.0, 12.0], "seed": [0]}
    path = study_of(tmp_path, encoder=encoder, network="snn", sweep=sweep, quick={})
    out = tmp_path / "run"
    runner.run(loading.resolve(path, {"network.hidden": 4, "network.training.epochs": 1}), out)
    report.write(out)
    results = pd.read_csv(out / "results.csv")
    assert results[f"encoder.sa1.{gain}"].tolist() == [3.0, 12.0]
    assert results["spikes_sa"][0] < results["spikes_sa"][1]
    assert (results["sops_recurrent"] == 0).all()
    assert (results["t_ref_sa_ms"] == 0).all()
    assert (out / "report.html").is_file()
    ledger = pd.read_csv(out / "ledger.csv")
    # 16 afferents, 4 hidden, 2 classes, and a gain for each population; nothing among the hidden neurons.
    assert ledger["parameters"].iloc[-1] == 16 * 4 + 4 * 2 + 2


@pytest.mark.thorough
@thinned("encoder", ["send-on-delta", *(path.stem for path in shipped("encoders") if path.stem != "send-on-delta")])
def test_a_study_of_every_encoder_gives_one_answer(encoder, tmp_path, monkeypatch):
    """The referee chooses among the refractory periods of any encoder; tables name them as the spec does."""
    monkeypatch.setattr(runner, "executor", in_this_process)
    monkeypatch.setattr(runner, "in_a_process", lambda function, *arguments: function(*arguments))
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[2, 2], [2, 5]], "seed": [0]}
    path = study_of(tmp_path, sweep=sweep, calibrate=True, baselines="linear", network="snn", quick={}, claims=[])
    few = {"network.hidden": 4, "network.training.epochs": 1, "encoder.conditioning.resample_Hz": 1000.0}
    out = tmp_path / "run"
    runner.run(loading.resolve(path, {"encoder": encoder, **few}), out)
    report.write(out)
    (answer,) = json.loads((out / "answer.json").read_text())["answers"]
    keys, results = period_keys(load(encoder).model), pd.read_csv(out / "results.csv")
    pairs = {0: ["-"], 1: ["2", "5"], 2: ["2&2", "2&5"]}[len(keys)]
    assert [network["pair"] for network in answer["networks"]] == pairs
    own = [f"encoder.{key}" for key in keys if key not in ("sa1.t_ref_ms", "ra1.t_ref_ms")]
    assert [key for key in results if "t_ref" in key] == ["t_ref_ra_ms", "t_ref_sa_ms", *own[::-1]]


@pytest.mark.thorough
def test_a_calibrated_study_of_several_afferents_a_taxel_reports(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "executor", in_this_process)
    monkeypatch.setattr(runner, "in_a_process", lambda function, *arguments: function(*arguments))
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1], [5, 10]], "seed": [0]}
    path = study_of(tmp_path, sweep=sweep, calibrate=True, quick={})
    out, several = tmp_path / "run", {"encoder": "sa1-ra1-lif-graded", "encoder.sa1.opposite": True}
    runner.run(loading.resolve(path, {**several, "network.hidden": 4, "network.training.epochs": 1}), out)
    report.write(out)
    results = pd.read_csv(out / "results.csv")
    assert (results["spikes_sa"] > 0).all()
    assert (out / "report.html").is_file()
    ledger = pd.read_csv(out / "ledger.csv")
    # 8 taxels: 8 SA-I and an RA-I under each, a gain for each of the nine, and a scale of each taxel.
    assert ledger["parameters"].iloc[-1] - (72 * 4 + 4 * 4 + 4 * 2 + 9) in (8, 16)


def test_a_sweep_of_refractory_periods_that_the_model_lacks_is_left_out_and_said(tmp_path, caplog):
    what = loading.resolve(study_of(tmp_path, encoder="izhikevich"))
    assert not [key for key in what.sweep if "t_ref_ms" in key]
    assert "izhikevich afferents have no refractory period; the sweep of pairs is left out" in caplog.text


@pytest.mark.thorough
def test_a_calibrated_study_of_mechanoreceptors_with_pc_reports(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "executor", in_this_process)
    monkeypatch.setattr(runner, "in_a_process", lambda function, *arguments: function(*arguments))
    sweep = {"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1.2, 1.2], [5, 10]], "seed": [0]}
    path = study_of(tmp_path, sweep=sweep, calibrate=True, encoder="mechanoreceptor-pc", quick={})
    out = tmp_path / "run"
    runner.run(loading.resolve(path, {"network.hidden": 4, "network.training.epochs": 1}), out)
    report.write(out)
    results = pd.read_csv(out / "results.csv")
    assert (results[["spikes_sa", "spikes_ra", "spikes_pc"]] > 0).all(axis=None)
    assert results["t_ref_sa_ms"].tolist() == [1.2, 10.0]
    assert (out / "report.html").is_file()
    ledger = pd.read_csv(out / "ledger.csv")
    # 8 taxels with three afferents each; of the encoder three gains and a scale of each taxel.
    assert ledger["parameters"].iloc[-1] - (24 * 4 + 4 * 4 + 4 * 2 + 3) in (8, 16)
