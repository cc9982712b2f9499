"""A search on `--device cuda`, in Triton's interpreter: the journal, the refusals and the resume of a search."""

import ast
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from neurotact import cli, spec
from neurotact.data import hdf5
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.networks import search, search_journal
from neurotact.networks.population import devices, trials
from neurotact.networks.population.training import Ended
from neurotact.networks.specs import RSNNSpec
from neurotact.networks.tasks import Task
from neurotact.networks.training import Epoch, Training
from neurotact.studies import preparation, study

TINY = Path(__file__).parents[2] / "studies" / "tiny.toml"
SPACE = {
    "hidden": {"_type": "choice", "_value": [4, 6, 65]},
    "training.batch": {"_type": "choice", "_value": [4, 8]},
}
TRIALS = 5
ONLY = "--device cuda: "


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Spike trains and a space, in files."""
    place = tmp_path_factory.mktemp("population")
    what = study.resolve(TINY)
    hdf5.save_spikes(encode_recordings(preparation.load_dataset(what.dataset), what.encoder), place / "spikes.h5")
    (place / "space.toml").write_text(spec.to_toml(SPACE))
    return place


def words(folder, out, *more):
    """A search over windows of 10 steps."""
    few = ("--trials", str(TRIALS), "--batch", "4", "--seed", "3", "--tuner", "random", "--workers", "1")
    window = ("--window-ms", "5", "--start-ms", "100", "--per-trial", "1")
    net = ("--network", "rsnn", "--set", "training.epochs=2", "--set", "forward_weight_scale=4.0")
    where = (str(folder / "spikes.h5"), "-o", str(out), "--space", str(folder / "space.toml"))
    return ["neurotact", "tune", *where, *few, *window, *net, *more]


@pytest.fixture(scope="module")
def tuned(folder):
    """What `neurotact tune --device cuda` leaves, and the lines of its journal."""
    pytest.importorskip("triton", reason="Triton is not installed: pip install 'neurotact[gpu]'")
    out = folder / "cuda"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", words(folder, out, "--device", "cuda"))
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert end.value.code == 0
    return out, [json.loads(line) for line in (out / search_journal.JOURNAL).read_text().splitlines()]


def problem_in(out) -> search.Problem:
    return spec.build(search.Problem, json.loads((out / "search.json").read_text()), source="search.json")


def test_the_journal_is_that_of_a_search_on_the_cpu(folder, tuned, tmp_path):
    out, found = tuned
    problem = problem_in(out).model_copy(update={"device": "cpu"})
    search.search(problem, tmp_path, search.here(hdf5.load_spikes(folder / "spikes.h5"), problem.task))
    wanted = [json.loads(line) for line in (tmp_path / search_journal.JOURNAL).read_text().splitlines()]
    assert {line["outcome"] for line in found} == {"finished", "failed"}
    for mine, theirs in zip(found, wanted, strict=True):
        assert mine["parameters"] == theirs["parameters"]
        if mine["parameters"]["hidden"] == 65:
            assert "65 hidden (at most 64)" in mine["error"]
        else:
            assert mine == theirs


def test_the_best_network_is_the_one_that_the_search_saw(tuned):
    out, _ = tuned
    best = search_journal.best_of(search_journal.read_journal(out / search_journal.JOURNAL))
    row = json.loads((out / "best" / "result.json").read_text())["row"]
    assert row["accuracy_validation"] == best.accuracy
    assert json.loads((out / "search.json").read_text())["device"] == "cuda"
    assert (out / "search.png").is_file()


@pytest.mark.parametrize("kept", [1, 4])
def test_resumed_after_some_trials_the_journal_is_that_of_the_uninterrupted_search(folder, tuned, kept, tmp_path):
    """Though the rest of a batch is another population than the whole batch was."""
    out, _ = tuned
    (tmp_path / "search.json").write_bytes((out / "search.json").read_bytes())
    lines = (out / search_journal.JOURNAL).read_text().splitlines(keepends=True)
    (tmp_path / search_journal.JOURNAL).write_text("".join(lines[:kept]))
    problem = problem_in(out)
    with trials.runner(problem, folder / "spikes.h5", 1, "cuda") as run:
        search.search(problem, tmp_path, run)
    assert (tmp_path / search_journal.JOURNAL).read_text() == "".join(lines)


def test_a_batch_stops_where_the_median_says_so(folder, tuned):
    """At once, by the rule's own words: every trial after the first epoch."""
    out, _ = tuned
    problem = problem_in(out)

    class Impatient:
        def stops(self, trial, values):
            return True

    job = search.Job(problem, search.Proposal(0, {"hidden": 4}), Impatient())  # pyright: ignore
    with trials.runner(problem, folder / "spikes.h5", 1, "cuda") as run:
        (trial,) = run([job])
    assert (trial.outcome, len(trial.epochs)) == (search_journal.STOPPED, 1)
    assert trial.accuracy == trial.epochs[-1]


def test_a_stopped_member_has_the_accuracy_of_its_last_epoch_though_another_was_better(monkeypatch):
    best, last = Epoch(1, 0.7, 0.5, 0.6, 0.75), Epoch(2, 0.6, 0.6, 0.7, 0.25)
    given = []
    monkeypatch.setattr(search, "trial_of", lambda job, network, accuracy, outcome, *_: given.append(accuracy))
    for stopped, leader in ((True, last), (False, best)):
        end = Ended(Training((best, last), leader), stopped=stopped)
        trials._trial(None, SimpleNamespace(network=None), end, None, [0.75, 0.25])
    assert given == [0.25, 0.75]


def refused(folder, out, monkeypatch, capsys, *more) -> str:
    monkeypatch.setattr(sys, "argv", words(folder, out, *more))
    with pytest.raises(SystemExit) as end:
        cli.main()
    err = capsys.readouterr().err
    assert end.value.code == 2
    assert err.count("\n") == 1
    assert not out.exists()
    return err


def test_without_triton_it_says_what_to_install(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(devices, "find_spec", lambda name: None)
    err = refused(folder, tmp_path / "out", monkeypatch, capsys, "--device", "cuda")
    assert ONLY + "needs Triton, which is not installed; pip install 'neurotact[gpu]'" in err


def test_without_a_device_it_is_refused(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("TRITON_INTERPRET")
    monkeypatch.setattr(devices, "find_spec", lambda name: True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert ONLY + "PyTorch finds no CUDA device here" in refused(
        folder, tmp_path / "out", monkeypatch, capsys, "--device", "cuda"
    )
    assert "--device mps: " in refused(folder, tmp_path / "out", monkeypatch, capsys, "--device", "mps")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(InputError, match="cuda:3: is one of 1 device"):
        devices.device_of("cuda:3")


def test_a_network_that_is_not_trained_so_is_refused(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(devices, "find_spec", lambda name: True)
    err = refused(folder, tmp_path / "out", monkeypatch, capsys, "--device", "cuda", "--set", "readout=integrator")
    assert "readout = 'count'" in err


def test_a_folder_of_a_search_on_the_cpu_is_not_gone_on_with_on_a_gpu(folder, tuned, tmp_path):
    out, _ = tuned
    problem = problem_in(out)
    on_cpu = problem.model_copy(update={"device": "cpu"})
    assert "device" not in on_cpu.model_dump(mode="json")
    with pytest.raises(InputError, match="holds another search"):
        search.search(on_cpu, out, lambda jobs: iter(()))


def test_nothing_but_the_kernels_imports_triton_and_nothing_imports_them_before_they_run():
    package = Path(trials.__file__).parents[2]
    for path in package.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        at_import = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
        text = "\n".join(map(ast.unparse, at_import))
        assert ("import triton" in text) == (path.parent.name == "population" and path.name == "kernels.py")
        assert "population.kernels" not in text
        assert "population import kernels" not in text


def test_the_default_network_has_no_population(folder):
    what = search.problem_of(
        hdf5.load_spikes(folder / "spikes.h5"),
        spec.build(search.SearchSpec, {"space": {"hidden": SPACE["hidden"]}}, source="test"),
        spec.load(RSNNSpec, "default", {}),
        Task(),
    )
    with pytest.raises(InputError, match="pass --network rsnn"):
        trials.on_device(what, hdf5.load_spikes(folder / "spikes.h5"), torch.device("cpu"))
