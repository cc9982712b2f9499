"""Every shipped spec loads, builds and says what it is; so does what the README names."""

import re
import warnings
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from neurotact import spec
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders import specs as encoders
from neurotact.encoders.specs import afferent_names
from neurotact.networks.definition import module
from neurotact.networks.definition import space as spaces
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.studies import loading, study

ROOT = Path(__file__).parents[1]
SHIPPED = [path for kind in spec.KINDS for path in spec.shipped(kind)]
of_kind = {kind: [path.stem for path in spec.shipped(kind)] for kind in spec.KINDS}


def test_there_is_a_spec_of_every_kind():
    assert all(of_kind.values())


def test_a_name_stands_for_one_spec():
    names = [path.stem for path in SHIPPED]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_spec_begins_with_a_line_about_it(path):
    assert re.match(r"# \S.{10,}", path.read_text(encoding="utf-8").splitlines()[0])


@pytest.mark.parametrize("name", of_kind["encoders"])
def test_an_encoder_encodes_without_a_warning(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        encoder = encoders.load(name)
        spikes, _ = encoders.encode(np.zeros((1, 10, 2), np.float32), 2000.0, encoder)
    assert spikes.shape == (1, 10, len(afferent_names(("a", "b"), encoder.model_dump())))


@pytest.mark.parametrize("name", of_kind["networks"])
def test_a_network_builds_and_runs(name):
    network = module.new(16, 8, spec.load(RSNNSpec, name), 2000.0, backend="reference")
    assert network.counts(torch.zeros(2, 10, 16)).readout.shape == (2, 8)


@pytest.mark.parametrize("name", of_kind["networks/spaces"])
def test_a_search_space_suits_the_network(name):
    space = spaces.SearchSpec(space=spaces.load_space(name)).space
    spaces.check(space, spec.load(RSNNSpec, "rsnn"), source=name)


@pytest.fixture(scope="module")
def resolve(tmp_path_factory):
    """Resolves a study, one that names no recordings with a file of some."""
    path = tmp_path_factory.mktemp("data") / "touches.h5"
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 6})
    hdf5.save_recordings(Recordings(np.zeros((12, 250, 2), np.float32), 500.0, "mV", conditions), path)

    @cache
    def resolved(name, quick):
        is_open = not any(spec.read(spec.find("studies", name)).get("dataset", {"read": "its own"}).values())
        return loading.resolve(name, quick=quick, data=path if is_open else None)

    return resolved


@pytest.mark.parametrize("quick", [False, True], ids=["full", "quick"])
@pytest.mark.parametrize("name", of_kind["studies"])
def test_a_study_has_cells_that_differ(name, quick, resolve):
    what = resolve(name, quick)
    digests = [cell.digest() for cell in loading.engine_of(what).cells(what)]
    assert len(set(digests)) == len(digests) > 1


@pytest.mark.parametrize("name", of_kind["studies"])
def test_a_quick_study_is_a_smaller_sweep_of_the_same_kind(name, resolve):
    full, quick = resolve(name, False), resolve(name, True)
    assert quick != full
    assert len([*loading.engine_of(quick).cells(quick)]) <= len([*loading.engine_of(full).cells(full)])
    folds = {"split.fold"} - {*quick.sweep}  # of few recordings; a first look has one split
    assert list(quick.sweep) == [axis for axis in full.sweep if axis not in folds]
    for axis, values in quick.sweep.items():
        assert all(value in full.sweep[axis] for value in values)


@pytest.mark.parametrize("quick", [False, True], ids=["full", "quick"])
@pytest.mark.parametrize("name", of_kind["studies"])
def test_a_resolved_study_reads_back_equal(name, quick, tmp_path, resolve):
    what = resolve(name, quick)
    (tmp_path / "study.toml").write_text(study.to_toml(what), encoding="utf-8")
    assert loading.resolve(tmp_path / "study.toml") == what


@pytest.mark.parametrize(
    ("load", "names"), [(encoders.load, of_kind["encoders"]), (partial(spec.load, RSNNSpec), of_kind["networks"])]
)
def test_a_spec_written_out_reads_back_equal(load, names, tmp_path):
    for name in names:
        loaded = load(name)
        text = spec.to_toml(loaded.model_dump(mode="json", exclude_none=True))
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
        assert load(tmp_path / f"{name}.toml") == loaded


def test_the_paths_that_the_readme_names_are_there():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = re.findall(
        r"(?<![\w./-])((?:neurotact|encoders|networks|studies|tests|native|benchmarks|docs)/[\w./-]*\w/?)", text
    )
    missing = [path for path in named if not (ROOT / path).exists()]
    assert not missing


def test_the_specs_that_the_readme_names_are_shipped():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = re.findall(r"neurotact (?:show|copy|study run) ([\w-]+)|--(?:encoder|network) ([\w-]+)(?![\w.-])", text)
    named = {one or other for one, other in commands}
    assert named <= {path.stem for path in SHIPPED}
