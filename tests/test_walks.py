"""The walk from a refractory-period study to NIR and C: every command of its page runs, on the files beside it."""

import shutil
from pathlib import Path

import pytest
from walked import walk

from neurotact.studies import loading

WALKS = Path(__file__).parents[1] / "docs" / "walks"
PAGES = [*WALKS.glob("*.md"), WALKS.parent / "examples" / "packages" / "my_skin" / "README.md"]


def test_every_command_from_the_study_to_nir_and_c_runs(tmp_path):
    pytest.importorskip("nir")
    for file in WALKS.glob("*.toml"):
        shutil.copy(file, tmp_path)
    shorter = {
        "simulate": "--set trials=4 --set duration_s=0.6",
        "study run": "--set search.trials=1 --set network.training.epochs=1 --workers 1",
    }
    told = walk(WALKS / "periods-to-c.md", tmp_path, shorter)
    assert len(told) == 5
    assert not [line for line, said in told.items() if "acausal" in said]
    assert (tmp_path / "chain" / "example").exists() == bool(shutil.which("cc"))


def test_the_study_of_the_walk_searches_the_space_beside_it():
    study = loading.resolve(str(WALKS / "periods.toml"))
    assert study.search is not None
    assert {*study.search.space} == {"hidden", "tau_mem_ms", "training.weight_decay"}


@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_a_walk_is_short(page):
    assert len(page.read_text(encoding="utf-8").split()) <= 350
