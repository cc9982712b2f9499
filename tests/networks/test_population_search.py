"""A search on a device: the journal, the resume and the refusals of a search. The device is the CPU by another name."""

import json
import sys
from pathlib import Path

import pytest

from neurotact import cli, spec
from neurotact.data import hdf5
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.networks.search import journal, search
from neurotact.networks.search.tuning import Proposal
from neurotact.studies import preparation, study

TINY = Path(__file__).parents[1] / "studies" / "tiny.toml"
SPACE = {
    "hidden": {"_type": "choice", "_value": [4, 6]},
    "training.batch": {"_type": "choice", "_value": [4, 8]},
}
DEVICE = "cpu:0"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Spike trains and a space, in files."""
    place = tmp_path_factory.mktemp("population")
    what = study.resolve(TINY)
    hdf5.save_spikes(encode_recordings(preparation.load_dataset(what.dataset), what.encoder), place / "spikes.h5")
    (place / "space.toml").write_text(spec.to_toml(SPACE))
    return place


def words(folder, out, *more):
    """A search of the default network over windows of 10 steps."""
    few = ("--trials", "5", "--batch", "4", "--seed", "3", "--tuner", "random")
    window = ("--window-ms", "5", "--start-ms", "100", "--per-trial", "1")
    where = (str(folder / "spikes.h5"), "-o", str(out), "--space", str(folder / "space.toml"))
    return ["neurotact", "tune", *where, *few, *window, "--set", "training.epochs=2", *more]


@pytest.fixture(scope="module")
def tuned(folder):
    """What `neurotact tune --device` leaves, and the lines of its journal."""
    out = folder / "tuned"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", words(folder, out, "--device", DEVICE))
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert end.value.code == 0
    return out, (out / journal.JOURNAL).read_text().splitlines()


def problem_in(out) -> search.Problem:
    return spec.build(
        search.Problem, spec.unsaved(json.loads((out / "search.json").read_text()), "", ""), source="search.json"
    )


def close(mine, theirs) -> bool:
    """Whether two lines of a journal agree except for rounding."""
    numbers = "accuracy", "sops", "value", "epochs"
    return {**mine, **dict.fromkeys(numbers)} == {**theirs, **dict.fromkeys(numbers)} and all(
        mine.get(key) == pytest.approx(theirs.get(key), rel=1e-3) for key in numbers
    )


def test_the_journal_is_that_of_a_search_in_processes(folder, tuned, tmp_path):
    out, lines = tuned
    problem = problem_in(out).model_copy(update={"device": "cpu"})
    search.search(problem, tmp_path, search.here(hdf5.load_spikes(folder / "spikes.h5"), problem.task))
    wanted = (tmp_path / journal.JOURNAL).read_text().splitlines()
    assert len(lines) == 5
    for mine, theirs in zip(lines, wanted, strict=True):
        assert close(json.loads(mine), json.loads(theirs))


def test_the_best_network_is_the_one_that_the_search_saw(tuned):
    out, _ = tuned
    best = journal.best_of(journal.read_journal(out / journal.JOURNAL))
    row = json.loads((out / "best" / "result.json").read_text())["row"]
    assert row["accuracy_validation"] == best.accuracy
    assert problem_in(out).device == DEVICE


def test_resumed_in_a_batch_the_journal_is_that_of_the_uninterrupted_search(folder, tuned, tmp_path):
    out, lines = tuned
    (tmp_path / "search.json").write_bytes((out / "search.json").read_bytes())
    (tmp_path / journal.JOURNAL).write_text(lines[0] + "\n")
    problem = problem_in(out)
    with search.runner(problem, folder / "spikes.h5", 1, DEVICE) as run:
        search.search(problem, tmp_path, run)
    found = (tmp_path / journal.JOURNAL).read_text().splitlines()
    assert all(close(json.loads(mine), json.loads(theirs)) for mine, theirs in zip(found, lines, strict=True))


def test_a_trial_stops_where_the_median_says_so(folder, tuned):
    """By the rule's own words: after the first epoch."""

    class Impatient:
        def stops(self, trial, values):
            return True

    problem = problem_in(tuned[0])
    proposal = Proposal(0, {"hidden": 4, "training.batch": 4})
    with search.runner(problem, folder / "spikes.h5", 1, DEVICE) as run:
        (trial,) = run([search.Job(problem, proposal, Impatient())])  # pyright: ignore
    assert (trial.outcome, len(trial.epochs)) == (journal.STOPPED, 1)
    assert trial.accuracy == trial.epochs[-1]


def test_a_device_that_torch_cannot_use_is_refused(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", words(folder, tmp_path / "out", "--device", "tpu9"))
    with pytest.raises(SystemExit) as end:
        cli.main()
    err = capsys.readouterr().err
    assert end.value.code == 2
    assert "--device tpu9: torch cannot use it here" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_search_in_processes_is_not_gone_on_with_on_a_device(tuned):
    out, _ = tuned
    in_processes = problem_in(out).model_copy(update={"device": "cpu"})
    with pytest.raises(InputError, match="holds another search"):
        search.search(in_processes, out, lambda jobs: iter(()))
