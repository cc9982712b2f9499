"""A study on a device: the cells are those of a study in processes. The device is the CPU by a name of its own."""

import json
from pathlib import Path

import pandas as pd
import pytest
from in_process import studies_here

from neurotact.errors import InputError
from neurotact.studies import device, loading, runner
from neurotact.studies.store import cell_folder

TINY = Path(__file__).parent / "tiny.toml"
SMALL = {
    "window.length_ms": 5.0,
    "network.training.epochs": 1,
    "network.training.batch": 8,
    "network.forward_weight_scale": 4.0,
    "sweep.seed": [0],
}


def resolved(**more):
    return loading.resolve(TINY, SMALL | more, quick=False)


@pytest.fixture(scope="module")
def on_device(tmp_path_factory):
    folder = tmp_path_factory.mktemp("device")
    runner.run(resolved(), folder, device="cpu:0")
    return folder


def test_a_study_trains_its_networks_at_once_to_the_same_results(on_device, tmp_path):
    with studies_here():
        runner.run(resolved(), tmp_path)
    found, wanted = (pd.read_csv(folder / "results.csv") for folder in (on_device, tmp_path))
    assert len(found) == 4
    pd.testing.assert_frame_equal(found, wanted, rtol=1e-6)


def test_the_run_folder_says_where_its_numbers_come_from(on_device, capsys):
    assert json.loads((on_device / "versions.json").read_text())["device"] == "cpu:0"
    runner.run(resolved(), on_device)  # nothing is left to do
    assert "resumes with other versions than at its start, numbers may differ: device cpu (was cpu:0)" in (
        capsys.readouterr().err
    )


def test_the_searches_of_a_study_train_their_batches_at_once(tmp_path):
    space = {"surrogate_scale": {"_type": "choice", "_value": [5, 10]}}
    what = resolved(
        **{
            "search": {"space": space, "trials": 2, "batch": 2},
            "sweep.network.hidden": [4],
            "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]],
        }
    )
    runner.run(what, tmp_path, device="cpu:0")
    (cell,) = loading.kind_of(what).cells(what)
    place = cell_folder(tmp_path, cell)
    assert len((place / "search" / "journal.jsonl").read_text().splitlines()) == 2
    assert json.loads((place / "search" / "search.json").read_text())["device"] == "cpu:0"


def test_a_protocol_without_spiking_networks_is_refused(tmp_path):
    with device.on_device("cpu:0") as map_cells, pytest.raises(InputError, match="trains no spiking networks"):
        [*map_cells(loading.PROTOCOL, ["a cell"], tmp_path)]  # pyright: ignore
