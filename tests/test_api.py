"""The front door: `import neurotact as nt`."""

import inspect
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import torch
from in_process import typed

import neurotact as nt
from neurotact.errors import InputError
from neurotact.spec import to_toml

HEAVY = ("torch", "numpy", "pandas", "sklearn", "h5py", "matplotlib", "nni", "snntorch", "scipy", "typer")
SMALL = {"trials": 1, "duration_s": 0.5}
QUICK = {"hidden": 6, "training.epochs": 2}


@pytest.fixture(scope="module")
def touches():
    return nt.simulate("gratings", **SMALL)


@pytest.fixture(scope="module")
def spikes(touches):
    return nt.encode(touches)


@pytest.fixture
def saved(spikes, tmp_path):
    nt.save(spikes, tmp_path / "spikes.h5")
    return tmp_path / "spikes.h5"


def test_the_import_loads_nothing_heavy():
    ask = f"import sys, neurotact; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_front_door_loads_tools_when_they_are_used():
    ask = (
        "import pkgutil, sys; from importlib import import_module; from neurotact import api\n"
        "for room in pkgutil.iter_modules(api.__path__): import_module(f'neurotact.api.{room.name}')\n"
        "rooms = {name.split('.')[1] for name in sys.modules if name.startswith('neurotact_parts.')}\n"
        "print(sorted(rooms - {'encoders'}))"  # whose specs say what an encoder may be
    )
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_type_checkers_see_the_tools_that_are_loaded():
    """`tools.pyi` names their modules, which `tools.py` finds by entry points."""
    stub = (Path(nt.__file__).parent / "api" / "tools.pyi").read_text(encoding="utf-8")
    seen: dict[str, Any] = {}
    exec(stub, seen)
    names = {name for name in nt.__all__ if name in seen}
    assert names >= {"Decision", "Flow", "Samples", "Stream", "Streamed", "stream", "tune"}
    assert {name for name in names if seen[name] is not getattr(nt, name)} == set()


def test_every_name_is_there_and_says_what_it_is():
    for name in nt.__all__:
        found = getattr(nt, name)
        assert name == "__version__" or inspect.getdoc(found), name
    assert {*nt.__all__} - {"__version__"} <= {*dir(nt)}


@pytest.mark.parametrize("package", ["baselines", "data", "encoders", "networks"])
def test_each_package_exports_what_it_is_for(package):
    module = getattr(__import__(f"neurotact.{package}"), package)
    assert module.__all__
    assert all(inspect.getdoc(getattr(module, name)) for name in module.__all__)


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="spikify"):
        nt.spikify  # noqa: B018


def test_recordings_and_spikes_are_saved_and_loaded_as_they_are(touches, spikes, tmp_path):
    for what, name in ((touches, "touch.h5"), (spikes, "spikes.h5")):
        nt.save(what, tmp_path / name)
        assert type(nt.load(tmp_path / name)) is type(what)
        with pytest.raises(InputError, match="already exists"):
            nt.save(what, tmp_path / name)
    again = nt.load(tmp_path / "spikes.h5")
    assert all(np.array_equal(a, b) for a, b in zip(again.steps, spikes.steps, strict=True))


def test_encoding_warns_of_afferents_that_never_fire(touches):
    with pytest.warns(nt.FiringWarning, match=r"no SA-I afferent fires in any trial; raise sa1\.gain"):
        nt.encode(touches, settings={"sa1.gain": 1e-9})


def test_train_does_what_the_command_line_does(saved, tmp_path):
    window = nt.Window(length_ms=100.0, start_ms=100.0, per_trial=2)
    row = nt.train(saved, tmp_path / "mine", "rsnn", QUICK, window=window)
    words = ["--window-ms", "100", "--start-ms", "100", "--per-trial", "2"]
    changes = [word for key, value in QUICK.items() for word in ("--set", f"{key}={value}")]
    command = ["train", str(saved), "--network", "rsnn", *words, *changes, "-o", str(tmp_path / "theirs")]
    assert typed(*command).code == 0
    for name in ("result.json", "weights.safetensors"):
        assert (tmp_path / "mine" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes()
    assert 0 <= row["low"] <= row["accuracy_test"] <= row["high"] <= 1
    assert row["chance"] == 1 / 8
    assert 0 <= row["baseline_accuracy"] <= 1
    assert any("epochs" in caution for caution in row["cautions"])


def test_the_command_line_prints_as_json_what_train_returns(saved, tmp_path):
    row = nt.train(saved, tmp_path / "mine", "rsnn", QUICK, window=nt.Window(length_ms=100.0))
    changes = [word for key, value in QUICK.items() for word in ("--set", f"{key}={value}")]
    command = ["train", str(saved), "--network", "rsnn", "--window-ms", "100", *changes, "--json"]
    done = typed(*command, "-o", tmp_path / "theirs")
    assert done.code == 0
    assert json.loads(done.out) == [row]


def test_a_trained_network_decides_and_is_loaded(saved, spikes, tmp_path):
    nt.train(saved, tmp_path / "run", "rsnn", QUICK, window=nt.Window(length_ms=100.0))
    table = nt.infer(tmp_path / "run", spikes, test_only=True)
    assert set(table["side"]) == {"test"}
    pd.testing.assert_frame_equal(nt.infer(tmp_path / "run", saved, test_only=True), table)
    net = nt.load_network(tmp_path / "run")
    nt.save_network(net, tmp_path / "copy")
    assert torch.equal(nt.load_network(tmp_path / "copy").w_in, net.w_in)
    with pytest.raises(InputError, match="already exists"):
        nt.save_network(net, tmp_path / "copy")


@pytest.mark.thorough
def test_a_search_goes_on_where_it_was_and_leaves_what_the_command_leaves(saved, tmp_path):
    space = {"hidden": {"_type": "choice", "_value": [4, 5]}}
    given: dict[str, Any] = {"workers": 1, "settings": {"training.epochs": 1}}
    given |= {"window": nt.Window(length_ms=100.0), "search": nt.Search(space=space, trials=2)}
    found = nt.tune(saved, tmp_path / "mine", **given)
    assert len(found) == 2
    pd.testing.assert_frame_equal(nt.tune(saved, tmp_path / "mine", **given), found)
    (tmp_path / "space.toml").write_text(to_toml(space))
    words = ["--trials", "2", "--window-ms", "100", "--workers", "1", "--set", "training.epochs=1"]
    command = ["tune", str(saved), "--space", str(tmp_path / "space.toml"), *words, "-o", str(tmp_path / "theirs")]
    assert typed(*command).code == 0
    left = {path.relative_to(tmp_path / "theirs") for path in (tmp_path / "theirs").rglob("*") if path.is_file()}
    assert {path.relative_to(tmp_path / "mine") for path in (tmp_path / "mine").rglob("*") if path.is_file()} == left
    for path in left:
        assert (tmp_path / "mine" / path).read_bytes() == (tmp_path / "theirs" / path).read_bytes(), path


@pytest.mark.slow
def test_a_study_runs_and_reports(tmp_path):
    tiny = Path(__file__).parent / "studies" / "tiny.toml"
    results = nt.run_study(tiny, tmp_path / "run", {"network.training.epochs": 1}, quick=True, workers=1)
    assert (tmp_path / "run" / "report.html").is_file()
    pd.testing.assert_frame_equal(nt.report_study(tmp_path / "run"), results)
    timings = pd.read_csv(tmp_path / "run" / "timings.csv")
    assert timings[timings["cell"].isna()]["part"].tolist()[-1] == "report"
    assert {"read", "encode", "train"} <= {*timings["part"]}


def test_settings_are_a_mapping_of_keys(touches):
    for call in (
        lambda: nt.simulate("gratings", ["trials"]),
        lambda: nt.encode(touches, settings=["sa1.t_ref_ms=5"]),
        lambda: nt.encode(touches, settings={1: 5}),
        lambda: nt.calibrate(touches, settings="group"),
    ):
        with pytest.raises(InputError, match="settings: must map dotted keys to values"):
            call()
    with pytest.raises(InputError, match="encoder: must be a name, a path or an encoder spec; got int"):
        nt.encode(touches, 3)
    with pytest.raises(InputError, match="encoder: must be a name, a path or an encoder spec; got RSNNSpec"):
        nt.calibrate(touches, nt.RSNNSpec())
    assert nt.encode(touches, settings={"sa1.t_ref_ms": np.float32(5)}).encoder["sa1"]["t_ref_ms"] == 5.0


def test_what_is_trained_lies_in_a_file(spikes, tmp_path):
    for call in (nt.train, nt.tune):
        with pytest.raises(InputError, match=r"spikes: must be the path of a file; got SpikeTrains; nt\.save"):
            call(spikes, tmp_path / "run")


def test_a_network_has_inputs_classes_and_a_clock():
    for given, words in (((0, 8, 2000.0), "n_inputs"), ((16, 1.5, 2000.0), "n_classes"), ((16, 8, 0.0), "RSNN")):
        with pytest.raises(InputError, match=f"^{words}: "):
            nt.RSNN(given[0], given[1], sampling_rate_Hz=given[2])


def test_a_raster_is_a_figure(touches, spikes):
    figure = nt.plot_raster(spikes, trial=1, recordings=touches)
    assert figure.axes
    plt.close(figure)
    figure = nt.plot_raster(spikes, trial=1, recordings=touches.select(np.array([1, 0])))
    drawn = [line.get_ydata() for line in figure.axes[0].lines]
    np.testing.assert_array_equal(np.stack(drawn, axis=1), touches.signals[1])
    plt.close(figure)
    with pytest.raises(InputError, match="recordings: do not hold trial 2 of the spikes"):
        nt.plot_raster(spikes, trial=2, recordings=touches.select(np.array([0, 1])))
    for trial in (len(spikes), -1, 1.5):
        for recordings in (None, touches):
            with pytest.raises(InputError, match=f"trial {trial}: there is no such trial; trials count from 0 to 47"):
                nt.plot_raster(spikes, trial, recordings)


def test_a_network_is_built_from_keys():
    net = nt.RSNN(16, 8, hidden=12, tau_mem_ms=40, sampling_rate_Hz=2000.0)
    assert (net.spec.hidden, net.spec.tau_mem_ms) == (12, 40)
    changed = nt.RSNN(16, 8, net.spec, 2000.0, hidden=4)
    assert (changed.spec.hidden, changed.spec.tau_mem_ms) == (4, 40)
    with pytest.raises(InputError, match=r"hiden: unknown key; did you mean 'hidden'\?"):
        nt.RSNN(16, 8, hiden=12, sampling_rate_Hz=2000.0)
    with pytest.raises(InputError, match="sampling_rate_Hz: the time constants need a clock"):
        nt.RSNN(16, 8, hidden=12)


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda: nt.simulate("grating"), "did you mean 'gratings'"),
        (lambda: nt.simulate(3), "name: must be text; got int"),
        (lambda: nt.encode("touches.h5"), "recordings: must be Recordings; got str"),
        (lambda: nt.plot_raster([1]), "spikes: must be SpikeTrains; got list"),
        (lambda: nt.save([1], "x.h5"), "takes recordings or spike trains; got list"),
        (lambda: nt.read("fabricslid", "."), "did you mean 'fabricslide'"),
        (lambda: nt.load("absent.h5"), "there is no such file"),
    ],
)
def test_what_cannot_be_used_is_refused_with_the_fix(call, expected):
    with pytest.raises(InputError, match=expected):
        call()


def test_what_is_shown_is_short_and_says_sizes_rates_and_units(touches, spikes):
    assert repr(touches) == "Recordings(48 trials x 8 taxels, 1000 samples at 2000 Hz (0.5 s), mV, 8 classes)"
    assert repr(spikes).startswith("SpikeTrains(48 trials x 16 afferents, ")
    assert "clock 2000 Hz" in repr(spikes)
    for what in (touches, spikes):
        assert "<code>" in what._repr_html_()


@pytest.fixture
def of_two(touches):
    """Two of the gratings: a calibration takes half of the time."""
    return touches.select(np.flatnonzero(touches.labels < 2))


def test_calibrate_leaves_a_baseline_that_knows_the_future(of_two):
    assert nt.calibrate(of_two).conditioning.baseline in ("none", "start")
    assert nt.calibrate(of_two, settings={"conditioning.baseline": "mean"}).conditioning.baseline == "mean"


def test_calibrate_compares_baselines_if_asked(of_two):
    """What the comparison decides cannot be set."""
    found = nt.calibrate(of_two, compare=True)
    assert found.conditioning.baseline != "mean"
    assert found.conditioning.scale is not None
    with pytest.raises(InputError, match=r"conditioning.baseline: "):
        nt.calibrate(of_two, settings={"conditioning.baseline": "start"}, compare=True)


@pytest.mark.filterwarnings("ignore:window.align")
def test_a_condition_is_tested_alike_from_python_and_the_command_line(saved, tmp_path):
    """All trials at one force are tested, no other is, and the network remembers them as its test trials."""
    force = sorted(nt.load(saved).conditions["force_N"].unique())[-1]
    nt.train(
        saved,
        tmp_path / "mine",
        "rsnn",
        QUICK,
        window=nt.Window(align="onset"),
        split=nt.Split(test_where={"force_N": force}),
    )
    changes = [word for key, value in QUICK.items() for word in ("--set", f"{key}={value}")]
    command = ["train", str(saved), "--network", "rsnn", *changes, "-o", str(tmp_path / "theirs")]
    where = ["--test-where", f"force_N={force}", "--align", "onset"]
    assert typed(*command, *where).code == 0
    assert (tmp_path / "mine/weights.safetensors").read_bytes() == (
        tmp_path / "theirs/weights.safetensors"
    ).read_bytes()
    trains = nt.load(saved)
    found = nt.infer(tmp_path / "theirs", trains)
    tested = found["trial"][found["side"] == "test"].unique()
    np.testing.assert_array_equal(tested, np.flatnonzero(trains.conditions["force_N"] == force))


def test_gains_know_nothing_of_the_condition_that_is_tested(touches):
    """Calibrated for one force held out, an encoder is the same whatever was recorded at that force."""
    table = touches.conditions
    force = float(table["force_N"].max())
    wild = [
        signal * (3 if held_out else 1)
        for signal, held_out in zip(touches.signals, table["force_N"] == force, strict=True)
    ]
    other = nt.Recordings(wild, touches.sampling_rate_Hz, touches.unit, table, touches.channels)
    where = {"force_N": force}
    changes = {"conditioning.baseline": "start"}
    mine, theirs = (nt.calibrate(each, settings=changes, split=nt.Split(test_where=where)) for each in (touches, other))
    assert mine == theirs
    assert nt.calibrate(other, settings=changes) != nt.calibrate(touches, settings=changes)
