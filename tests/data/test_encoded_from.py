"""What a file names is tried beside it and in the current folder, and its content decides."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

import neurotact as nt
from neurotact.data import encoded_from, hdf5
from neurotact.data.dataset import DatasetSpec
from neurotact.data.encoded_from import AbsentError, find
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.networks.training import run_folder
from neurotact.studies import loading

ALL = np.arange(24)
QUICK = {"hidden": 4, "training.epochs": 1}


def touches(seed: int) -> Recordings:
    rng = np.random.default_rng(seed)
    signals = np.cumsum(rng.normal(size=(24, 60, 2)), axis=1)
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": [("felt", "silk")[k % 2] for k in range(24)]}))


def encode(recordings: str, spikes: str) -> None:
    settings = {"sa1.gain": 30.0, "ra1.gain": 30.0, "conditioning.baseline": "start"}
    nt.save(nt.encode(nt.load(recordings), settings=settings), spikes)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """`data/touch.h5`, `out/spikes.h5` encoded from it, and `run/` trained on these."""
    work = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(work)
        for name in ("data", "out", "elsewhere"):
            (work / name).mkdir()
        nt.save(touches(0), "data/touch.h5")
        encode("data/touch.h5", "out/spikes.h5")
        nt.train("out/spikes.h5", "run", "rsnn", QUICK, window=nt.Window(length_ms=50))
    return work


@pytest.fixture
def here(made, tmp_path, monkeypatch) -> Path:
    """A copy of what was made, as the current folder."""
    work = shutil.copytree(made, tmp_path / "work")
    monkeypatch.chdir(work)
    return work


def found(spikes: str, given: str | None = None) -> Path:
    return find(spikes, hdf5.load_spikes(spikes), ALL, given).path.resolve()


def test_recordings_are_found_from_any_folder_and_after_all_was_moved(here, monkeypatch, tmp_path):
    assert found("out/spikes.h5") == here / "data" / "touch.h5"
    monkeypatch.chdir(here / "elsewhere")
    assert found("../out/spikes.h5") == here / "data" / "touch.h5"
    assert nt.load("../out/spikes.h5").source == "../out/../data/touch.h5"
    shutil.move(here, tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    assert found("moved/out/spikes.h5") == tmp_path / "moved" / "data" / "touch.h5"


def test_spikes_that_are_saved_again_elsewhere_name_the_same_recordings(here, monkeypatch):
    (here / "deep" / "er").mkdir(parents=True)
    nt.save(nt.load("out/spikes.h5"), "deep/er/again.h5")
    monkeypatch.chdir("elsewhere")
    assert found("../deep/er/again.h5") == here / "data" / "touch.h5"
    assert hdf5.source_of("../deep/er/again.h5") == "../../data/touch.h5"


def test_a_path_from_the_current_folder_of_then_is_found_in_that_of_now(here):
    """As earlier versions wrote it."""
    rename_source("out/spikes.h5", "data/touch.h5")
    assert found("out/spikes.h5") == here / "data" / "touch.h5"


def rename_source(spikes: str, name: str) -> None:
    with h5py.File(spikes, "r+") as file:
        file.attrs["source"] = name


def test_of_two_files_of_one_name_the_content_decides(here):
    nt.save(touches(1), "out/touch.h5")
    shutil.copy("data/touch.h5", "touch.h5")
    rename_source("out/spikes.h5", "touch.h5")
    assert found("out/spikes.h5") == here / "touch.h5"
    shutil.move("out/touch.h5", "swap.h5")
    shutil.move("touch.h5", "out/touch.h5")
    shutil.move("swap.h5", "touch.h5")
    assert found("out/spikes.h5") == here / "out" / "touch.h5"


def test_recordings_of_another_content_are_refused_and_all_places_named(here):
    nt.save(touches(1), "data/touch.h5", force=True)
    with pytest.raises(InputError, match=r"^out/\.\./data/touch\.h5: does not hold .* name the file that was encoded"):
        found("out/spikes.h5")
    rename_source("out/spikes.h5", "touch.h5")
    for place in ("out/touch.h5", "touch.h5"):
        shutil.copy("data/touch.h5", place)
    with pytest.raises(InputError, match=r"^out/touch\.h5 and touch\.h5: does not hold the recordings"):
        found("out/spikes.h5")
    with pytest.raises(InputError, match=r"^data/touch\.h5: does not hold the recordings that out/spikes\.h5 was"):
        found("out/spikes.h5", "data/touch.h5")


def test_absent_recordings_are_named_with_the_option(here):
    (here / "data" / "touch.h5").unlink()
    with pytest.raises(AbsentError, match=r"^'\.\./data/touch\.h5', from which out/spikes\.h5 was encoded, is neither"):
        found("out/spikes.h5")
    with pytest.raises(InputError, match="neither beside it nor in the current folder; name it with `recordings`"):
        nt.export_c("run", "chain", prove=1)
    with pytest.raises(InputError, match=r"data/touch\.h5: there is no such file"):
        found("out/spikes.h5", "data/touch.h5")


def test_a_file_that_holds_no_recordings_is_no_candidate(here):
    (here / "out" / "touch.h5").write_text("dear diary")
    shutil.copy("data/touch.h5", "touch.h5")
    rename_source("out/spikes.h5", "touch.h5")
    assert found("out/spikes.h5") == here / "touch.h5"


def test_only_the_trials_that_are_used_are_compared(here):
    """So that a raster of a large file is quick; the trials are those that were asked for."""
    changed = touches(0)
    changed.signals[5] += 1
    nt.save(changed, "changed.h5")
    trains = hdf5.load_spikes("out/spikes.h5")
    assert find("out/spikes.h5", trains, np.array([7, 2]), "changed.h5").trials.tolist() == [7, 2]
    nt.save(changed.select(np.array([7, 2, 9])), "few.h5")
    assert find("out/spikes.h5", trains, np.array([7, 2]), "few.h5").trials.tolist() == [0, 1]
    with pytest.raises(InputError, match="does not hold"):
        find("out/spikes.h5", trains, np.array([7, 5]), "changed.h5")


def test_an_export_from_any_folder_is_the_same(here, monkeypatch):
    nt.export_c("run", "chain")
    monkeypatch.chdir("elsewhere")
    nt.export_c("../run", "chain")
    for name in ("touch.c", "touch.h"):
        assert (here / "chain" / name).read_bytes() == (here / "elsewhere" / "chain" / name).read_bytes()


def test_the_spikes_of_a_run_are_those_of_its_training_wherever_they_are(here, monkeypatch):
    assert run_folder.restore("run").spikes_path == Path("run/../out/spikes.h5")
    shutil.move(here / "out", here / "run" / "out")  # beside the network: not where it names them
    with pytest.raises(InputError, match=r"run/\.\./out/spikes\.h5: the spikes .* name them with `spikes`"):
        nt.fine_tune("run", "tuned", epochs=1)
    nt.fine_tune("run", "tuned", epochs=1, spikes="run/out/spikes.h5")
    nt.export_c("run", "chain", spikes="run/out/spikes.h5", recordings="data/touch.h5")
    nt.save(touches(1), "other.h5")
    encode("other.h5", "other-spikes.h5")
    with pytest.raises(InputError, match=r"other-spikes\.h5: no longer contains the trials that the network"):
        nt.export_c("run", "another", spikes="other-spikes.h5", recordings="other.h5")


def test_of_two_files_of_spikes_that_a_network_may_name_its_own_is_taken(here, monkeypatch):
    (here / "elsewhere" / "run").mkdir()
    monkeypatch.chdir("elsewhere/run")
    (here / "elsewhere" / "out").mkdir()
    shutil.copy(here / "out" / "spikes.h5", "../out/spikes.h5")
    nt.save(touches(1), "other.h5")
    (here / "out" / "spikes.h5").unlink()
    encode("other.h5", str(here / "out" / "spikes.h5"))
    assert run_folder.restore(here / "run").spikes_path == Path("../out/spikes.h5")
    shutil.move("../out/spikes.h5", "swap.h5")
    assert run_folder.restore(here / "run").spikes_path == here / "run" / "../out/spikes.h5"


STUDY = """
title = "Mine"
encoder = "sa1-ra1-lif"
network = "rsnn"
dataset = { file = "touch.h5" }
window = { length_ms = 50.0 }
sweep = { seed = [0] }
"""


def test_a_file_that_a_study_names_is_beside_it_or_in_the_current_folder(here, monkeypatch):
    (here / "data" / "mine.toml").write_text(STUDY)
    assert loading.resolve("data/mine.toml").dataset.file == str(here / "data" / "touch.h5")
    shutil.move("data/touch.h5", "touch.h5")
    assert loading.resolve("data/mine.toml").dataset.file == str(here / "touch.h5")
    monkeypatch.chdir("data")
    shutil.move("../touch.h5", "touch.h5")
    assert loading.resolve("mine.toml").dataset.file == str(here / "data" / "touch.h5")
    given = loading.resolve("mine.toml", {"dataset.file": "../data/touch.h5"}).dataset.recordings
    assert given is not None
    assert given.samefile("touch.h5")


def test_recordings_in_the_folder_of_the_environment_are_named_whole(monkeypatch):
    monkeypatch.setenv("NEUROTACT_DATA", "/tactile sets")
    assert DatasetSpec(file="$NEUROTACT_DATA/a.h5").recordings == Path("/tactile sets/a.h5")


def test_content_is_asked_for_only_as_far_as_a_place_is_tried(here, monkeypatch):
    read = []
    monkeypatch.setattr(encoded_from, "recorded_trials", lambda stored, *_: read.append(stored.source) or ALL)
    shutil.copy("data/touch.h5", "touch.h5")
    shutil.copy("data/touch.h5", "out/touch.h5")
    rename_source("out/spikes.h5", "touch.h5")
    found("out/spikes.h5")
    assert read == ["out/touch.h5"]
