"""The package that docs/plugins.md shows: installed apart from neurotact, each of its parts is used by its name."""

import json
import re
import runpy
import shutil
import sys
import tomllib
from html import unescape
from pathlib import Path

import pandas as pd
import pytest
from in_process import studies_here, typed, without_pictures
from test_plugins import forget
from walked import walk

import neurotact as nt
from neurotact import plugins
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import load
from neurotact.studies import loading

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "docs" / "examples" / "packages" / "my_skin"
PROJECT = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ENTRIES = PROJECT["entry-points"]
pytestmark = pytest.mark.filterwarnings("default:the cost of .* is not counted")  # of the network, which says none
SHORT = ("--set", "training.loss=squares", "--set", "training.epochs=2")


@pytest.fixture(scope="module", autouse=True)
def _installed(tmp_path_factory):
    """The package where `pip install` puts it, with the entry points of its `pyproject.toml`."""
    site = tmp_path_factory.mktemp("site")
    shutil.copytree(PACKAGE / "my_skin", site / "my_skin")
    about = site / f"my_skin-{PROJECT['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {PROJECT['name']}\nVersion: {PROJECT['version']}\n")
    groups = [
        "\n".join([f"[{group}]", *(f"{name} = {value}" for name, value in its.items())])
        for group, its in ENTRIES.items()
    ]
    (about / "entry_points.txt").write_text("\n".join(groups))
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        forget()
        yield
    forget()


@pytest.fixture(scope="module")
def touches(tmp_path_factory):
    """The folder of the README."""
    folder = tmp_path_factory.mktemp("touches")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["record.py", str(folder)])
        runpy.run_path(str(PACKAGE / "record.py"))
    return folder


@pytest.fixture(scope="module")
def recorded(touches):
    return _done("import", "my-skin", touches, "-o", touches / "touches.h5") and touches / "touches.h5"


@pytest.fixture(scope="module")
def spikes(recorded):
    path = recorded.with_name("spikes.h5")
    return _done("encode", recorded, "--encoder", "crossings", "-o", path) and path


def _done(*words):
    """What a command prints, which it must end well with."""
    done = typed(*words)
    assert done.code == 0, done.err
    return done.out + done.err


def test_every_part_of_the_package_is_short_and_named_once():
    files = [path.stem for path in (PACKAGE / "my_skin").glob("*.py") if path.stem != "__init__"]
    named = [value.partition(":")[0] for its in ENTRIES.values() for value in its.values()]
    assert sorted(named) == sorted(f"my_skin.{file}" for file in files)
    for path in (PACKAGE / "my_skin").glob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 40, path.name
    for group, its in ENTRIES.items():
        for name in its:
            assert plugins.load(group.removeprefix("neurotact."), name) is not None


def test_the_page_of_parts_leads_to_every_file_of_the_package():
    page = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8")
    files = [*(PACKAGE / "my_skin").glob("*.py"), PACKAGE / "pyproject.toml"]
    wanted = {str(path.relative_to(ROOT / "docs")) for path in files if path.stem != "__init__"}
    assert not {path for path in wanted if f"]({path})" not in page}


def test_the_list_of_specs_has_those_of_the_package():
    said = _done("list").splitlines()
    for kind, name in (("encoders", "crossings"), ("networks", "two-layers"), ("prices", "my-chip")):
        assert nt.spec_names(kind)[-1] == name
        assert [line.split() for line in said if name in line.split()] == [[name, "Of", "the", "package", "my-skin."]]


def test_the_commands_of_the_readme_work(tmp_path):
    shorter = {"train": "--set training.epochs=2", "study": "--set network.training.epochs=2"}
    told = walk(PACKAGE / "README.md", tmp_path, shorter)
    assert nt.load(tmp_path / "touches.h5").conditions["label"].tolist().count("felt") == 20
    assert ["my-chip" in said for line, said in told.items() if "sops" in line] == [True]
    with pytest.raises(InputError, match=r"holds no <class>_<number>\.npy file"):
        nt.read("my-skin", tmp_path)


def test_a_classifier_takes_the_network_by_its_name(spikes):
    trains = nt.load(spikes)
    windows = nt.windows(trains, nt.Window(length_ms=300))
    fitted = nt.SpikingClassifier(network="two-layers", epochs=2, sampling_rate_Hz=500.0)
    assert set(fitted.fit(windows.X, windows.y).predict(windows.X)) <= {"felt", "mesh", "silk"}


def test_the_name_of_a_network_is_that_of_a_spec_with_its_defaults_and_the_recipe():
    assert load(RSNNSpec, "two-layers") == RSNNSpec(model="two-layers", recipe="default")
    assert load(RSNNSpec, "two-layers", {"units": 3}).own.units == 3
    with pytest.raises(InputError, match="there is no such spec in networks; did you mean 'two-layers'"):
        load(RSNNSpec, "two-layer")


@pytest.mark.parametrize("named", [{"network": "two-layers"}, {"network.model": "two-layers"}])
def test_a_study_leaves_its_hidden_neurons_out_where_the_network_has_none(recorded, caplog, named):
    for name in ("own-recordings", "which-encoder"):
        study = loading.resolve(name, named, quick=True, data=recorded)
        assert "network.hidden" not in study.sweep
        assert study.network.own.units == 20
        assert caplog.messages.count(
            "network: 'two-layers' has no key hidden; the study's numbers of hidden neurons are left out"
        )
        caplog.clear()
    for key, value in (("network.hidden", 5), ("sweep.network.hidden", [5])):
        with pytest.raises(InputError, match="hidden: unknown key; known: units"):
            loading.resolve("own-recordings", {**named, key: value}, data=recorded)
    layers = loading.resolve("own-recordings", {"network": "layered"}, quick=True, data=recorded)
    assert layers.sweep["network.hidden"] == [20]


@pytest.mark.thorough
def test_a_study_of_own_recordings_takes_every_part(recorded, tmp_path):
    settings = ("encoder=crossings", "network=two-layers", "prices=my-chip", "network.training.epochs=2")
    words = [word for setting in settings for word in ("--set", setting)]
    with studies_here() as patch:
        without_pictures(patch)
        _done("study", "run", "own-recordings", "--quick", "--data", recorded, *words, "-o", tmp_path / "run")
    assert "nearest" in pd.read_csv(tmp_path / "run" / "baselines.csv")["classifier"].tolist()
    ledger = pd.read_csv(tmp_path / "run" / "ledger.csv")
    assert set(ledger["prices"]) == {"my-chip"}
    assert not ledger.loc[ledger["name"].str.startswith("nearest"), "energy_estimate_nJ"].isna().any()
    assert "my-chip" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


@pytest.mark.thorough
def test_the_study_of_encoders_has_a_row_of_the_package(recorded, tmp_path):
    changes = {"sweep.encoder & t_ref_ms": [["send-on-delta", "own"], ["crossings", "own"]],
               "network.training.epochs": 2}  # fmt: skip
    with studies_here() as patch:
        without_pictures(patch)
        nt.run_study("which-encoder", tmp_path / "run", changes, data=recorded, quick=True, workers=1)
    table = pd.read_csv(tmp_path / "run" / "encoders.csv").set_index("encoder")
    assert table["energy_estimate_nJ"].notna().to_dict() == {"send-on-delta": True, "crossings": True}
    page = unescape((tmp_path / "run" / "report.html").read_text())
    (headline,) = re.search(r'<p class="headline">(.*?)</p>\n<dl class="big">', page).groups()
    assert re.match(r"(No encoder|send-on-delta|crossings) ", headline)
    assert re.fullmatch(r"[^;]*[^.;]\.", headline)  # one sentence
    data = json.loads(re.search(r'id="study-data">(.*?)</script>', page)[1])
    every = data["fronts"]["every encoder"]
    assert {one["label"].partition(",")[0] for one in every["networks"]} >= {"send-on-delta", "crossings"}
    assert data["cells"][data["best"]]["setting"] in every["of"]


@pytest.mark.thorough
def test_a_search_takes_the_network(spikes, tmp_path):
    _done("tune", spikes, "--network", "two-layers", *SHORT, "--trials", 2, "--workers", 1, "-o", tmp_path / "found")
