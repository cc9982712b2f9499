"""The command as a user types it: what it writes, and one line with exit code 2 for what it cannot use."""

import io
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import h5py
import in_process
import numpy as np
import pandas as pd
import pytest
import torch
from levels import thinned
from typer.main import get_command

from neurotact import __version__, cli, files, plugins, spec
from neurotact.api import encoding
from neurotact.api import studies as api
from neurotact.cli import commands
from neurotact.cli.studies import _print_answer
from neurotact.data import dataset
from neurotact.data.hdf5 import load_recordings, load_spikes, save_recordings
from neurotact.data.recordings import Recordings
from neurotact.data.splits import SplitSpec
from neurotact.errors import InputError
from neurotact.networks.definition import seeds
from neurotact.networks.training import run_folder, trainer
from neurotact.studies import runner

ROOT = Path(__file__).parents[1]
RATE_Hz = 1000.0
N_TRIALS, N_TAXELS, SECONDS = 24, 2, 0.3
QUICK = ("--set", "training.epochs=2", "--set", "hidden=6", "--window-ms", "100")


@pytest.fixture
def neurotact(monkeypatch, capsys):
    """Run the command line in this process: `neurotact("encode", path, ...)` gives (exit code, stdout, stderr)."""

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["neurotact", *map(str, words)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main()
        return (int(end.value.code or 0), *capsys.readouterr())

    return run


@pytest.fixture
def refused(neurotact):
    """Run a command that must end with exit code 2 and exactly one line on stderr that holds all the given words."""

    def run(words: tuple, *expected: object) -> str:
        code, out, err = neurotact(*words)
        assert code == 2, out + err
        assert not out
        assert err.endswith("\n")
        assert err.count("\n") == 1
        assert err.startswith("neurotact: ")
        for piece in expected:
            assert str(piece) in err
        return err

    return run


def touch(n_trials=N_TRIALS, n_taxels=N_TAXELS, seconds=SECONDS, rate_Hz=RATE_Hz, unit="mV") -> Recordings:
    """Sines of two frequencies, told apart easily."""
    time_s = np.arange(round(seconds * rate_Hz)) / rate_Hz
    rng = np.random.default_rng(0)
    signals = np.empty((n_trials, len(time_s), n_taxels))
    for trial in range(n_trials):
        phase = rng.random() * 2 * np.pi
        signals[trial] = 12 * np.sin(2 * np.pi * (8, 30)[trial % 2] * time_s + phase)[:, None]
    labels = [("coarse", "fine")[i % 2] for i in range(n_trials)]
    forces_N = [(3, 6)[i // 2 % 2] for i in range(n_trials)]
    return Recordings(signals, rate_Hz, unit, pd.DataFrame({"label": labels, "force_N": forces_N}))


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """A folder with touch.h5, spikes.h5 and a trained network in run/, made by the command itself."""
    folder = tmp_path_factory.mktemp("made")
    save_recordings(touch(), folder / "touch.h5")
    for words in (
        ("encode", folder / "touch.h5", "-o", folder / "spikes.h5"),
        ("train", folder / "spikes.h5", "-o", folder / "run", *QUICK, "--start-ms", 50, "--stratify", "force_N"),
    ):
        done = in_process.typed(*words, cwd=folder)
        assert done.code == 0, done.err
    return folder


def typed(*words: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", "from neurotact.cli import main; main()", *map(str, words)],
        cwd=cwd, env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


# --- what it does -----------------------------------------------------------------------------------


def test_simulated_recordings_become_spikes(neurotact, tmp_path):
    options = ("--set", "trials=1", "--set", "duration_s=0.2", "--set", "forces_N=[12]", "--set", "seed=3")
    code, out, _ = neurotact("simulate", "gratings", *options, "-o", tmp_path / "gratings.h5")
    assert (code, out) == (0, f"{tmp_path}/gratings.h5: 16 trials of 8 classes, 8 taxels, 3.2 s at 2000 Hz, in mV\n")
    code, out, _ = neurotact("encode", tmp_path / "gratings.h5", "-o", tmp_path / "spikes.h5")
    assert code == 0
    trains = load_spikes(tmp_path / "spikes.h5")
    n_spikes = sum(map(len, trains.steps))
    told, acausal = out.splitlines()
    assert told == f"{tmp_path}/spikes.h5: 16 trials, {n_spikes} spikes of 16 afferents in 3.2 s"
    assert acausal.startswith("acausal: the baseline is the mean of each whole trial")
    assert n_spikes > 0


def test_every_command_is_called_as_it_is_typed():
    """Typer's own reference of the commands takes the names from them."""

    def misnamed(group) -> list[tuple[str, str]]:
        found = [(name, group.commands[name]) for name in group.commands]
        inner = [pair for _, command in found if hasattr(command, "commands") for pair in misnamed(command)]
        return [(name, command.name) for name, command in found if command.name != name] + inner

    root = get_command(cli.app)
    assert {"list", "simulate", "train"} <= {*root.commands}
    assert not misnamed(root)


def test_a_change_within_a_nested_table_keeps_the_rest_of_it(neurotact, tmp_path):
    options = ("--set", "trials=1", "--set", "film.thickness_um=50", "--set", "probes.wood.loss_factor=0.03")
    code, out, _ = neurotact("simulate", "contact-materials", *options, "-o", tmp_path / "materials.h5")
    assert (code, out) == (
        0,
        f"{tmp_path}/materials.h5: 40 trials of 4 classes, 2 taxels, 80.0 s at 2000 Hz, in V\n",
    )
    assert load_recordings(tmp_path / "materials.h5").channels == ("force", "output")


@pytest.mark.parametrize("name", plugins.names("simulators"))
def test_help_of_a_simulation_lists_each_key_as_it_is_typed(neurotact, name):
    code, out, _ = neurotact("simulate", name, "--help")
    listed = out.partition("Keys of --set, with their defaults:")[2].partition("Options:")[0].split("\n")
    typed = spec.parse_assignments([line.strip() for line in listed if line.strip()])
    experiment = plugins.load("simulators", name)
    assert code == 0
    assert [*typed] == [*spec.leaves(experiment.model().model_dump(mode="json"))]
    assert experiment.build(typed, "typed") == experiment.model()


def test_simulated_grasps_are_saved(neurotact, tmp_path):
    options = ("--set", "placements=1", "--set", "grasps=1", "--set", "objects.SR.stiffness_N_per_mm=0.7")
    code, out, _ = neurotact("simulate", "stiffness", *options, "-o", tmp_path / "grasps.h5")
    assert (code, out) == (0, f"{tmp_path}/grasps.h5: 3 trials of 3 classes, 4 taxels, 9.0 s at 2000 Hz, in mV\n")


def test_simulated_touches_are_saved(neurotact, tmp_path):
    options = ("--set", "people=1", "--set", "recording_s=2", "--set", "duration_s=0.5")
    code, out, _ = neurotact("simulate", "touch-modality", *options, "-o", tmp_path / "touch.h5")
    assert (code, out) == (0, f"{tmp_path}/touch.h5: 12 trials of 3 classes, 16 taxels, 24.0 s at 3000 Hz, in V\n")


def test_published_touches_are_imported(neurotact, tmp_path):
    for label in ("brushing", "rolling", "sliding"):
        (tmp_path / "in" / label).mkdir(parents=True)
        (tmp_path / "in" / label / "1.lvm").write_text(("\t".join(["1.65"] * 17) + "\n") * 30000)
    code, out, _ = neurotact("import", "touch-modality", tmp_path / "in", "-o", tmp_path / "out.h5")
    assert (code, out) == (0, f"{tmp_path}/out.h5: 3 trials of 3 classes, 16 taxels, 30.0 s at 3000 Hz, in V\n")


def test_a_folder_is_imported(neurotact, tmp_path):
    for label, rows in (("felt", "1,2\n3,4\n5,6\n"), ("silk", "6,1\n2,9\n0,3\n")):
        (tmp_path / "in" / label).mkdir(parents=True)
        (tmp_path / "in" / label / "a.csv").write_text(f"left,right\n{rows}")
    words = ("import", "folder", tmp_path / "in", "--sampling-rate-Hz", 3, "--unit", "V", "-o", tmp_path / "out.h5")
    code, out, _ = neurotact(*words)
    assert (code, out) == (0, f"{tmp_path}/out.h5: 2 trials of 2 classes, 2 taxels, 2.0 s at 3 Hz, in V\n")
    assert load_recordings(tmp_path / "out.h5").channels == ("left", "right")


def test_a_longer_refractory_period_gives_fewer_spikes(neurotact, made, tmp_path):
    counts = []
    for t_ref_ms in (1, 5, 20):
        out = tmp_path / f"{t_ref_ms}.h5"
        words = ("--set", f"sa1.t_ref_ms={t_ref_ms}", "--set", f"ra1.t_ref_ms={t_ref_ms}", "-o", out)
        assert neurotact("encode", made / "touch.h5", *words)[0] == 0
        trains = load_spikes(out)
        assert trains.encoder["sa1"]["t_ref_ms"] == t_ref_ms
        counts.append(sum(map(len, trains.steps)))
    assert counts[0] > counts[1] > counts[2] > 0


@thinned(("baseline", "is_acausal"), [("mean", True), ("start", False), ("none", False)], every=2)
def test_results_of_a_baseline_that_knows_the_future_are_marked(neurotact, made, tmp_path, baseline, is_acausal):
    spikes, run = tmp_path / "spikes.h5", tmp_path / "run"
    encoded = neurotact("encode", made / "touch.h5", "--set", f"conditioning.baseline={baseline}", "-o", spikes)
    trained = neurotact("train", spikes, "-o", run, *QUICK, "--seed", 1)
    inferred, counted = neurotact("infer", run, spikes), neurotact("sops", run, "-o", tmp_path / "sops.csv")
    for code, out, _ in (encoded, trained, inferred, counted):
        assert code == 0
        assert ("acausal: the baseline is the mean of each whole trial" in out) == is_acausal


def test_calibration_leaves_a_baseline_that_knows_the_future_unless_it_is_asked_for(neurotact, made, tmp_path):
    for words, expected in (((), ("none", "start")), (("--set", "conditioning.baseline=mean"), ("mean",))):
        mine = tmp_path / f"{expected[0]}.toml"
        assert neurotact("calibrate", made / "touch.h5", *words, "-o", mine)[0] == 0
        assert spec.read(mine)["conditioning"]["baseline"] in expected


def test_calibration_writes_an_encoder_for_this_sensor(neurotact, made, tmp_path):
    mine = tmp_path / "mine.toml"
    code, out, _ = neurotact("calibrate", made / "touch.h5", "--stratify", "force_N", *ONE_FIT, "-o", mine)
    assert code == 0
    assert out.startswith(f"{mine}: sa1.gain = ")
    assert neurotact("encode", made / "touch.h5", "--encoder", mine, "-o", tmp_path / "spikes.h5")[0] == 0
    assert sum(map(len, load_spikes(tmp_path / "spikes.h5").steps)) > 0


@thinned(("suffix", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_a_raster_is_drawn(neurotact, made, tmp_path, suffix, magic):
    out = tmp_path / f"raster{suffix}"
    words = ("raster", made / "spikes.h5", "-o", out, "--trial", 1, "--start-s", 0.05, "--stop-s", 0.2)
    assert neurotact(*words) == (0, f"{out}\n", "")
    assert out.read_bytes().startswith(magic)


def test_a_raster_without_its_recordings_says_so(neurotact, made, tmp_path, caplog):
    with h5py.File(tmp_path / "moved.h5", "w") as target, h5py.File(made / "spikes.h5") as source:
        for name in source:
            source.copy(name, target)
        target.attrs.update({**source.attrs, "source": "gone.h5"})
    assert neurotact("raster", tmp_path / "moved.h5", "-o", tmp_path / "raster.svg")[0] == 0
    assert caplog.messages == [
        f"the signal is left out: 'gone.h5', from which {tmp_path / 'moved.h5'} was encoded, is neither beside it nor "
        "in the current folder; name it with `recordings`"
    ]


def test_events_are_written_as_a_table(neurotact, made, tmp_path):
    assert neurotact("raster", made / "spikes.h5", "-o", tmp_path / "events.csv")[0] == 0
    table, trains = pd.read_csv(tmp_path / "events.csv"), load_spikes(made / "spikes.h5")
    assert list(table) == ["trial", "afferent", "type", "time_s"]
    assert len(table) == sum(map(len, trains.steps))
    assert set(table.type) == {"SA-I", "RA-I"}
    first = table[table.trial == 1].time_s.to_numpy()
    np.testing.assert_allclose(first, trains.steps[1] / RATE_Hz, atol=1e-12)


def test_training_leaves_a_network_with_its_log_and_its_result(made):
    names = {path.name for path in (made / "run").iterdir()}
    assert names >= {"network.json", "weights.safetensors", "training.csv", "result.json"}
    log = pd.read_csv(made / "run" / "training.csv")
    assert log.groupby("member").size().to_dict() == {1: 2, 0: 2}  # with and without recurrence, of few spikes


@pytest.mark.thorough
def test_the_same_seed_trains_the_same_network(neurotact, made, tmp_path):
    assert neurotact("train", made / "spikes.h5", "-o", tmp_path / "again", *QUICK, "--seed", 3)[0] == 0
    assert neurotact("train", made / "spikes.h5", "-o", tmp_path / "same", *QUICK, "--seed", 3)[0] == 0
    assert neurotact("train", made / "spikes.h5", "-o", tmp_path / "other", *QUICK, "--seed", 4)[0] == 0
    again, same, other = ((tmp_path / n / "weights.safetensors").read_bytes() for n in ("again", "same", "other"))
    assert again == same != other


@pytest.mark.parametrize("early_exit", [(), ("--early-exit",)])
def test_inference_decides_every_window(neurotact, made, tmp_path, early_exit):
    code, out, _ = neurotact("infer", made / "run", made / "spikes.h5", "-o", tmp_path / "labels.csv", *early_exit)
    assert code == 0
    assert out.splitlines()[0].startswith("training windows: seen in training")
    assert out.splitlines()[1].split()[:4] == ["label", "windows", "accuracy", "steps"]
    table = pd.read_csv(tmp_path / "labels.csv")
    assert len(table) == N_TRIALS * 2  # two windows of 100 ms after 50 ms of 300 ms
    assert set(table.label) == {"coarse", "fine"}
    assert (table.steps == 100).all() or early_exit
    assert table.side.value_counts().to_dict() == {"training": 32, "validation": 8, "test": 8}  # of 24: 16, 4 and 4
    of_windows = [line for line in out.splitlines() if " windows" in line and "label" not in line]
    heads = [line.split()[0] for line in of_windows if not line.startswith("acausal: ")]
    every = [line.split() for line in out.splitlines() if line.split()[:1] == ["all"]]
    assert heads == ["training", "validation", "test"]
    assert [line[1] for line in every] == ["32", "8", "8"]
    for side, line in zip(heads, every, strict=True):
        mine = table[table.side == side]
        assert float(line[2]) == pytest.approx((mine.label == mine.predicted).mean(), abs=1e-3)
    assert (table.sops_total == table.sops_input + table.sops_recurrent + table.sops_readout).all()


def test_early_exit_never_costs_more(neurotact, made, tmp_path):
    for name, words in (("full", ()), ("early", ("--early-exit",))):
        assert neurotact("sops", made / "run", "-o", tmp_path / f"{name}.csv", *words)[0] == 0
    full, early = (pd.read_csv(tmp_path / f"{name}.csv") for name in ("full", "early"))
    assert full.trial.tolist() == early.trial.tolist()
    assert (early.steps <= full.steps).all()
    assert (early.sops_total <= full.sops_total).all()


def test_the_sops_are_those_of_the_test_trials(neurotact, made, tmp_path):
    assert neurotact("sops", made / "run", "-o", tmp_path / "sops.json")[0] == 0
    table = pd.read_json(tmp_path / "sops.json")
    assert table.trial.nunique() == 4  # 15 % of 24
    assert (table.sops_input == 6 * table.input_spikes).all()


@pytest.mark.parametrize(("memory", "is_told"), [("[[1, 1.0], [100000, 100.0]]", True), ("[[1, 1], [2, 1]]", False)])
def test_the_energy_of_both_says_why_it_is_more_than_its_parts(neurotact, made, tmp_path, memory, is_told):
    (tmp_path / "my.toml").write_text(f'like = "arithmetic-45nm"\nmemory_pJ = {memory}\n')
    words = ("sops", made / "run", "-o", tmp_path / "sops.csv", "--prices", tmp_path / "my.toml")
    code, out, _ = neurotact(*words)
    assert code == 0
    assert ("both lie in one memory" in out) == is_told


def test_specs_are_listed_shown_and_copied(neurotact, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = neurotact("list")
    assert (code, err) == (0, "")
    for path in (path for kind in spec.KINDS for path in spec.shipped(kind)):
        assert path.stem in out
        assert neurotact("show", path.stem) == (0, path.read_text(), "")
    assert neurotact("copy", "sa1-ra1-lif") == (0, "sa1-ra1-lif.toml\n", "")
    assert Path("sa1-ra1-lif.toml").read_text() == spec.find("encoders", "sa1-ra1-lif").read_text()
    assert neurotact("show", "./sa1-ra1-lif.toml")[0] == 0


def test_a_copied_spec_serves_where_a_name_does(neurotact, made, tmp_path):
    copied = tmp_path / "mine.toml"
    assert neurotact("copy", "sa1-ra1-lif", "-o", copied)[0] == 0
    assert neurotact("encode", made / "touch.h5", "--encoder", copied, "-o", tmp_path / "spikes.h5")[0] == 0
    one, other = load_spikes(tmp_path / "spikes.h5"), load_spikes(made / "spikes.h5")
    assert all((a == b).all() for a, b in zip(one.steps, other.steps, strict=True))


COMMANDS = [
    (), ("list",), ("show",), ("copy",), ("simulate",), ("simulate", "gratings"),
    ("simulate", "contact-materials"), ("simulate", "touch-modality"), ("simulate", "stiffness"),
    ("simulate", "compliance"), ("import",), ("import", "touch-modality"),
    ("import", "fabricslide"), ("import", "pvdf-hardness"), ("import", "folder"), ("import", "braille-letters"),
    ("import", "arrays"), ("info",), ("calibrate",), ("encode",),
    ("raster",), ("train",), ("infer",), ("sops",), ("fine-tune",), ("study",), ("study", "run"), ("study", "resume"),
    ("study", "report"),
]  # fmt: skip


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_help(neurotact, words):
    code, out, err = neurotact(*words, "--help")
    assert (code, err) == (0, "")
    assert out.startswith(f"Usage: {' '.join(('neurotact', *words))} ")
    assert "--help" in out


def test_nothing_typed_is_help(neurotact):
    assert neurotact() == neurotact("--help")


def test_the_version_is_that_of_the_package(neurotact):
    assert neurotact("--version") == (0, f"{__version__}\n", "")


@pytest.mark.filterwarnings("default")
def test_a_rounded_refractory_period_is_said_in_one_line(neurotact, made, tmp_path):
    words = ("encode", made / "touch.h5", "-o", tmp_path / "s.h5", "--set", "sa1.t_ref_ms=0.3")
    code, _, err = neurotact(*words)
    assert code == 0
    assert "neurotact: t_ref of 0.3 ms is 0.3 steps at 1000 Hz; rounded up to 1 (1 ms)" in err.splitlines()


INTERRUPTED_BY_IMPORT = """
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
from neurotact.__main__ import main
sys.meta_path.insert(0, Interrupt())
sys.argv = ["neurotact", "train", "spikes.h5", "-o", "run"]
main()
"""


SLOWER = [pytest.param(module, marks=pytest.mark.slow) for module in ("typer", "numpy.random")]


@pytest.mark.usefixtures("ctrl_c")
@thinned("module", ["torch._C", "neurotact.cli", "neurotact.networks.training.run_folder", *SLOWER])
def test_ctrl_c_while_modules_load_ends_with_one_line(tmp_path, module):
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_BY_IMPORT.format(module=module)],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "neurotact: interrupted\n")


def test_the_command_begins_where_ctrl_c_is_heard():
    with open(ROOT / "pyproject.toml", "rb") as file:
        assert tomllib.load(file)["project"]["scripts"]["neurotact"] == "neurotact.__main__:main"
    done = subprocess.run(
        [sys.executable, "-m", "neurotact", "--version"],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{__version__}\n", "")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (("sa1.gain=1e-6",), ["no SA-I afferent fires in any trial; raise sa1.gain, or"]),
        (("ra1.gain=1e-6",), ["no RA-I afferent fires in any trial; raise ra1.gain, or"]),
        (("sa1.gain=1e-6", "ra1.gain=1e-6"), ["no SA-I afferent fires", "no RA-I afferent fires"]),
        (
            ("ra1.gain=1e6",),
            ["RA-I afferent that fires does so at over 90% of the 500 Hz that its t_ref allows;"],
        ),
        (("ra1.gain=1e6", "ra1.t_ref_ms=0"), ["at over 90% of the 1000 Hz"]),
        ((), []),
    ],
)
def test_a_gain_that_silences_or_saturates_is_said(neurotact, made, tmp_path, caplog, changes, expected):
    options = [word for change in changes for word in ("--set", change)]
    caplog.clear()
    assert neurotact("encode", made / "touch.h5", *options, "-o", tmp_path / "s.h5")[0] == 0
    for line, words in zip(caplog.messages, expected, strict=True):
        assert words in line
        assert line.endswith("or find gains for this sensor with neurotact calibrate")


def test_a_terminal_that_knows_no_letter_of_a_unit_is_written_to(tmp_path, monkeypatch, capsys):
    (tmp_path / "in" / "felt").mkdir(parents=True)
    (tmp_path / "in" / "felt" / "a.csv").write_text("1,2\n3,4\n")
    words = ("import", "folder", "in", "--sampling-rate-Hz", "20", "--unit", "µV", "-o", "x.h5")
    shown = io.BytesIO()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["neurotact", *words])
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, encoding="ascii", write_through=True))
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert (end.value.code, capsys.readouterr().err) == (0, "")
    assert shown.getvalue() == b"x.h5: 1 trial of 1 class, 2 taxels, 0.1 s at 20 Hz, in \\xb5V\n"


@pytest.mark.parametrize("write_through", [False, True], ids=["buffered", "at once"])
@pytest.mark.parametrize("words", ["--help", "encode --help", "list", "info touch.h5", "infer run spikes.h5"])
def test_a_reader_that_leaves_ends_the_command_quietly(monkeypatch, capfd, made, words, write_through):
    """As under `head`: nobody reads the pipe, of which a file that is open meanwhile has no fault."""
    reader, writer = os.pipe()
    os.close(reader)
    monkeypatch.chdir(made)
    monkeypatch.setattr(sys, "argv", ["neurotact", *words.split()])
    raw = io.FileIO(writer, "wb")
    with io.TextIOWrapper(raw if write_through else io.BufferedWriter(raw), write_through=write_through) as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert (end.value.code, capfd.readouterr().err) == (0, "")


def test_a_fault_after_the_reader_has_left_keeps_its_exit_code(monkeypatch, capfd, made):
    def printed(*_):
        print("one line")
        raise InputError("a fault")

    reader, writer = os.pipe()
    os.close(reader)
    monkeypatch.setattr(encoding, "write_encoded", printed)
    monkeypatch.setattr(sys, "argv", ["neurotact", "encode", str(made / "touch.h5"), "-o", "none.h5"])
    with open(writer, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert (end.value.code, capfd.readouterr().err) == (2, "neurotact: a fault\n")


def test_nothing_is_said_at_the_end_of_a_process_without_a_reader(made):
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "neurotact", "info", "touch.h5"]
    done = subprocess.run(words, cwd=made, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


def test_ctrl_c_ends_with_one_line(neurotact, monkeypatch, made, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(encoding, "write_encoded", interrupted)
    assert neurotact("encode", made / "touch.h5", "-o", tmp_path / "s.h5") == (130, "", "neurotact: interrupted\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ctrl_c_does", [signal.default_int_handler, signal.SIG_IGN], ids=["heard", "ignored"])
def test_the_end_of_a_time_limit_leaves_nothing_half_written(neurotact, monkeypatch, made, tmp_path, ctrl_c_does):
    def ended(*_):
        with files.whole(tmp_path / "s.h5") as draft:
            draft.write_text("half")
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(encoding, "write_encoded", ended)
    before = signal.signal(signal.SIGINT, ctrl_c_does)
    try:
        assert neurotact("encode", made / "touch.h5", "-o", tmp_path / "s.h5") == (130, "", "neurotact: interrupted\n")
    finally:
        signal.signal(signal.SIGINT, before)
    assert not list(tmp_path.iterdir())


def test_a_fault_of_ours_is_not_hidden(monkeypatch, made, tmp_path):
    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(encoding, "write_encoded", broken)
    monkeypatch.setattr(sys, "argv", ["neurotact", "encode", str(made / "touch.h5"), "-o", str(tmp_path / "s.h5")])
    with pytest.raises(ZeroDivisionError):
        cli.main()


# --- what it refuses --------------------------------------------------------------------------------


def test_an_error_is_one_line_of_a_length_that_is_read(refused, tmp_path):
    line = refused(("encode", tmp_path / ("x/" * 2000), "-o", tmp_path / "s.h5"))
    assert len(line) < 530
    assert line.endswith("there is no such file; check the path\n")
    assert refused(("show", "a\x1b[31m\nb")).startswith("neurotact: a\\x1b[31m b: there is no such spec")


@pytest.mark.parametrize(
    "words",
    [
        ("train", "x.h5", "-o", "y", "--seed", 10**30),
        ("train", "x.h5", "-o", "y", "--split-seed", 2**32),
        ("train", "x.h5", "-o", "y", "--window-ms", "1" + 400 * "0"),
        ("calibrate", "x.h5", "-o", "y", "--split-seed", 10**30),
        ("study", "run", "x", "-o", "y", "--workers", 10**9),
        ("raster", "x.h5", "-o", "y.png", "--trial", "1" + 5000 * "0"),
    ],
    ids=lambda words: f"{words[0]} {words[-2]}",
)
def test_a_number_that_is_too_large_is_refused(refused, made, monkeypatch, words):
    monkeypatch.chdir(made)
    refused(tuple("spikes.h5" if word == "x.h5" else word for word in words))


@pytest.mark.parametrize(
    "words",
    [
        ("encode", "touch.h5", "-o", "\udcff.h5"),
        ("encode", "\udcff.h5", "-o", "s.h5"),
        ("import", "folder", "in", "--sampling-rate-Hz", 3, "--unit", "\udcff", "-o", "s.h5"),
        ("import", "fabricslide", "fabrics", "-o", "s.h5"),
    ],
)
def test_what_is_not_utf8_is_refused(refused, made, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    for name in ("touch.h5", "\udcff.h5"):
        shutil.copy(made / "touch.h5", name)
    Path("in/felt").mkdir(parents=True)
    Path("in/felt/a.csv").write_text("1,2\n")
    Path("fabrics").mkdir()
    Path("fabrics/\udcff_F120_V10mmps_0.csv").write_text("1,2\n")
    refused(words, "\\udcff", "is not UTF-8 text; rename it")


@pytest.mark.parametrize("name", plugins.names("simulators"))
def test_each_key_of_a_simulation_that_is_typed_as_an_option_is_shown_as_a_setting(refused, name):
    own = {"out", "set", "force", "help"}
    for key in spec.leaves(dataset.simulator(name).model().model_dump()):
        assert key not in own
        refused(("simulate", name, "-o", "x.h5", f"--{key}", 2), f"a key of the spec: --set {key}=2; see neurotact")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("simulate gratings --trials=2 -o x.h5", "--set trials=2; see"),
        ("simulate gratings -o x.h5 --trials", "--set trials=VALUE; see"),
        ("simulate gratings --trials -o x.h5", "--set trials=VALUE; see"),
        ("encode x.h5 -o s.h5 --sa1.gain -1", "--set sa1.gain=-1; see"),
        ("calibrate x.h5 -o s.toml --sa1.t-ref-ms 5", "--set sa1.t_ref_ms=5; see"),
        ("train x.h5 -o r --epochs 5", "--set training.epochs=5; see"),
        ("study run own-recordings -o r --network.hidden 5", "--set network.hidden=5; see"),
        ("study run own-recordings -o r --data=x --hidden 'a b'", "--set 'network.hidden=a b'; see"),
    ],
)
def test_a_key_that_is_typed_as_an_option_is_shown_as_a_setting(refused, words, expected):
    refused(tuple(shlex.split(words)), "No such option: ", f"it is a key of the spec: {expected}")


@pytest.mark.parametrize(
    "words",
    ["info x.h5 --hidden 5", "train x.h5 -o r --idden 5", "simulate gratings -o x --ials 5", "live run --hidden 5"],
)
def test_an_option_that_is_no_key_of_its_command_is_shown_as_no_setting(refused, words):
    assert "--set" not in refused(tuple(words.split()), "No such option")


def test_a_refusal_as_a_user_meets_it(made):
    done = typed("encode", "touch.h5", "--set", "sa1.t_ref_ms=-1", "-o", "s.h5", cwd=made)
    assert done.returncode == 2
    assert done.stdout == ""
    encoder = spec.find("encoders", "sa1-ra1-lif")
    assert done.stderr == f"neurotact: sa1.t_ref_ms: must be >= 0; got -1 ({encoder})\n"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("encod",), ("No such command 'encod'", "did you mean 'encode'", "neurotact --help")),
        (("study",), ("Missing command", "neurotact study --help")),
        (("study", "rum"), ("'run'", "neurotact study --help")),
        (("encode",), ("Missing argument 'recordings'", "neurotact encode --help")),
        (("encode", "x.h5"), ("Missing option '-o' / '--out'", "neurotact encode --help")),
        (("encode", "x.h5", "-o"), ("'-o' requires an argument", "neurotact")),
        (("encode", "x.h5", "-o", "y.h5", "--encodr", "z"), ("--encodr", "--encoder")),
        (("train", "x.h5", "-o", "y", "--window-ms", "long"), ("--window-ms", "number", "neurotact train --help")),
        (("train", "x.h5", "-o", "y", "--seed", "-1"), ("--seed", "greater than or equal to 0")),
        (("raster", "x.h5", "-o", "y.png", "--trial", "1.5"), ("--trial", "integer")),
        (("study", "run", "x", "-o", "y", "--workers", "0"), ("--workers", "greater than or equal to 1")),
        (("import", "folder", ".", "-o", "y.h5"), ("Missing option '--unit'", "neurotact import folder --help")),
    ],
)
def test_a_wrong_command_line_is_one_line_that_names_the_help(refused, words, expected):
    line = refused(words).lower()
    assert all(piece.lower() in line for piece in expected)


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("sa1.t_ref=5", "sa1.t_ref: unknown key; did you mean 't_ref_ms'?"),
        ("sa3.t_ref_ms=5", "sa3: unknown key; did you mean 'sa1'?"),
        ("sa1.t_ref_ms=-1", "sa1.t_ref_ms: must be >= 0; got -1"),
        ("sa1.t_ref_ms=300", "sa1.t_ref_ms: 300 ms is not shorter than the shortest trial, which lasts 300 ms"),
        ("ra1.t_ref_ms=1e9", "ra1.t_ref_ms: 1e+09 ms is not shorter than the shortest trial"),
        ("sa1.t_ref_ms=1e999", "sa1.t_ref_ms: must be a finite number; got inf (--set)"),
        (f"sa1.t_ref_ms={10**400}", "sa1.t_ref_ms: must be a number within 64 bits"),
        (f"sa1.t_ref_ms={'[' * 5000}", "--set sa1.t_ref_ms=["),
        ("conditioning.resample_Hz=1e12", "resample_Hz: 1e+12 Hz is over 1,000 times the sampling rate of 1000 Hz"),
        ("sa1.t_ref_ms=nan", "sa1.t_ref_ms: must be a finite number; got nan"),
        ("sa1.t_ref_ms=soon", "sa1.t_ref_ms: must be a number; got 'soon'"),
        ("sa1=5", "sa1: must be a table; got 5"),
        ("sa1.t_ref_ms", "--set sa1.t_ref_ms: must read KEY=VALUE"),
        ("unit.name=mV", "unit.name: 'unit' is a value, not a table"),
        ("unit=V", None),
        ("unit=N", "signals are in 'mV' but 'N' is needed"),
        ("conditioning.ema_cutoff_Hz=500", "ema_cutoff_Hz: 500 Hz is not below the Nyquist frequency of 500 Hz"),
        ("conditioning.offset=[1, 2, 3]", "touch.h5: has 2 channels but the encoder's conditioning has 3 offsets"),
    ],
)
def test_a_wrong_key_or_value_is_named(neurotact, refused, made, tmp_path, assignment, expected):
    words = ("encode", made / "touch.h5", "--set", assignment, "-o", tmp_path / "s.h5")
    if expected is None:
        assert neurotact(*words)[0] == 0
        return
    refused(words, expected)
    assert not list(tmp_path.iterdir())


def test_a_wrong_key_in_a_file_is_named_with_the_file(refused, made, tmp_path):
    mine = tmp_path / "mine.toml"
    text = spec.find("encoders", "sa1-ra1-lif").read_text()
    words = ("encode", made / "touch.h5", "--encoder", mine, "-o", tmp_path / "s.h5")
    for change, expected in (
        (("t_ref_ms", "tref_ms"), "sa1.tref_ms: unknown key; did you mean 't_ref_ms'?"),
        (("t_ref_ms = 1.0", "t_ref_ms = -1.0"), "sa1.t_ref_ms: must be >= 0; got -1.0"),
        (("gain = 3.2", "gain = inf"), "sa1.gain: must be a finite number"),
        (("gain = 3.2", "gain = "), "is not valid TOML"),
    ):
        mine.write_text(text.replace(*change))
        refused(words, expected, mine)


def test_a_spec_that_is_not_there_is_named(refused, made, tmp_path):
    out = ("-o", tmp_path / "out")
    refused(("encode", made / "touch.h5", "--encoder", "sa1-ra1-lf", *out), "sa1-ra1-lf", "did you mean 'sa1-ra1-lif'?")
    refused(("train", made / "spikes.h5", "--network", "rsn", *out), "rsn", "did you mean 'rsnn'?")
    refused(("study", "run", "refractory", *out), "refractory", "did you mean 'refractory-period'?")
    refused(("show", "sa1-ra1-lf"), "sa1-ra1-lf: there is no such spec", "did you mean 'sa1-ra1-lif'?")
    refused(("show", tmp_path / "mine.toml"), "mine.toml: there is no such file")
    refused(("train", made / "spikes.h5", "--network", tmp_path / "a.toml", *out), "a.toml: there is no such file")


def test_a_copy_overwrites_nothing(refused, tmp_path):
    (tmp_path / "mine.toml").write_text("precious")
    refused(("copy", "rsnn", "-o", tmp_path / "mine.toml"), "mine.toml: already exists", "--force")
    assert (tmp_path / "mine.toml").read_text() == "precious"


ONE_FIT = ("--set", "conditioning.baseline=none")
"""Of a calibration that chooses no baseline."""
WRITERS = [
    ("simulate", "gratings", "--set", "trials=1", "--set", "duration_s=0.1", "--set", "forces_N=[3]", "-o", "x.h5"),
    ("import", "folder", "in", "--sampling-rate-Hz", 3, "--unit", "V", "-o", "x.h5"),
    ("calibrate", "touch.h5", *ONE_FIT, "-o", "x.toml"),
    ("calibrate", "touch.h5", *ONE_FIT, "-o", "y.toml", "--figure", "x.png"),
    ("encode", "touch.h5", "-o", "x.h5"),
    ("raster", "spikes.h5", "-o", "x.svg"),
    ("raster", "spikes.h5", "-o", "x.csv"),
    ("infer", "run", "spikes.h5", "-o", "x.csv"),
    ("sops", "run", "-o", "x.json"),
    ("copy", "rsnn", "-o", "x.toml"),
]


@pytest.mark.parametrize("words", WRITERS, ids=lambda words: " ".join(map(str, words[:2])))
def test_an_output_that_exists_is_refused_and_force_replaces_it(neurotact, refused, made, tmp_path, monkeypatch, words):
    for path in made.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "in" / "felt").mkdir(parents=True)
    (tmp_path / "in" / "felt" / "a.csv").write_text("left,right\n1,2\n3,4\n5,6\n")
    monkeypatch.chdir(tmp_path)
    out = next(tmp_path / str(word) for word in words if str(word).startswith("x."))
    out.write_text("precious")
    refused(words, f"{out.name}: already exists; choose another output or pass --force to replace it")
    assert out.read_text() == "precious"
    assert neurotact(*words, "--force")[0] == 0
    assert out.read_bytes() != b"precious"


INPUTS = [
    ("encode", "touch.h5", "-o", "touch.h5"),
    ("encode", "touch.h5", "--encoder", "mine.toml", "-o", "mine.toml"),
    ("calibrate", "touch.h5", "-o", "linked.h5"),
    ("calibrate", "touch.h5", "--encoder", "mine.toml", "-o", "mine.toml"),
    ("calibrate", "touch.h5", "-o", "x.toml", "--figure", "touch.h5"),
    ("raster", "spikes.h5", "-o", "spikes.h5"),
    ("raster", "spikes.h5", "--recordings", "mine.toml", "-o", "mine.toml"),
    ("infer", "run", "spikes.h5", "-o", "spikes.h5"),
    ("infer", "run", "spikes.h5", "-o", "run/network.json"),
    ("sops", "run", "-o", "spikes.h5"),
    ("sops", "run", "-o", "run/network.json"),
    ("copy", "mine.toml", "-o", "./mine.toml"),
    ("import", "folder", "in", "--sampling-rate-Hz", 3, "--unit", "V", "-o", "in/felt/a.csv"),
    ("import", "table", "in/felt/a.csv", "--annotations", "mine.toml", "--unit", "V", "-o", "mine.toml"),
]


@pytest.mark.parametrize("words", INPUTS, ids=lambda words: " ".join(map(str, words)))
def test_an_output_never_replaces_an_input(refused, made, tmp_path, monkeypatch, words):
    shutil.copytree(made, tmp_path / "made")
    monkeypatch.chdir(tmp_path / "made")
    Path("mine.toml").write_text(spec.find("encoders", "sa1-ra1-lif").read_text())
    Path("linked.h5").symlink_to("touch.h5")
    Path("in/felt").mkdir(parents=True)
    Path("in/felt/a.csv").write_text("left,right\n1,2\n3,4\n5,6\n")
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    refused((*words, "--force"), "is an input of this command; choose another output")
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


def test_two_outputs_of_a_command_are_two_files(refused, made, tmp_path):
    words = ("calibrate", made / "touch.h5", "-o", tmp_path / "x.png", "--figure", tmp_path / "." / "x.png", "--force")
    refused(words, "x.png: is the path of two outputs of this command")


def test_a_name_that_is_too_long_is_refused_before_any_work(refused, made, tmp_path, monkeypatch):
    monkeypatch.setattr(encoding, "write_encoded", lambda *_: pytest.fail("it worked"))
    refused(("encode", made / "touch.h5", "-o", tmp_path / ("x" * 300)), "File name too long")
    refused(("train", made / "spikes.h5", *QUICK, "-o", tmp_path / ("x" * 300)), "File name too long")


def test_a_file_that_is_not_there_is_named(refused, made, tmp_path):
    out, absent = ("-o", tmp_path / "out.csv"), tmp_path / "absent"
    for words in (
        ("encode", absent, *out), ("train", absent, *out), ("raster", absent, *out), ("infer", made / "run", absent),
        ("infer", absent, made / "spikes.h5"), ("sops", absent, *out), ("calibrate", absent, *out),
        ("sops", made / "run", "--spikes", absent, *out), ("import", "fabricslide", absent, *out),
        ("import", "pvdf-hardness", absent, *out), ("study", "resume", absent), ("study", "report", absent),
        ("import", "folder", absent, *out, "--sampling-rate-Hz", 9, "--unit", "V"),
        ("raster", made / "spikes.h5", "--recordings", absent, "-o", tmp_path / "r.png"),
    ):  # fmt: skip
        refused(words, "absent: there is no such f")  # file or folder
    assert not list(tmp_path.iterdir())


def test_a_damaged_file_is_named(refused, made, tmp_path):
    for name, words in (
        ("touch.h5", ("encode", tmp_path / "touch.h5", "-o", tmp_path / "out")),
        ("spikes.h5", ("train", tmp_path / "spikes.h5", "-o", tmp_path / "out")),
    ):
        content = (made / name).read_bytes()
        for damaged in (content[: len(content) // 2], content[:-1], b"", b"label,force_N\n"):
            (tmp_path / name).write_bytes(damaged)
            refused(words, f"{tmp_path / name}: cannot be read as", "write it again with neurotact")


def test_a_file_of_another_kind_is_named(refused, made, tmp_path):
    refused(("encode", made / "spikes.h5", "-o", tmp_path / "s.h5"), "spikes.h5: holds spikes, not recordings")
    refused(("train", made / "touch.h5", "-o", tmp_path / "run"), "touch.h5: holds recordings, not spikes")
    refused(("infer", tmp_path, made / "spikes.h5"), "network.json: there is no such file")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a,b\n1,2\n3\n", "line 3 has 1 column where 2 are expected"),
        ("", "holds no row"),
        ("a,b\n", "holds no row"),
        ("a,b\n1,nan\n", "line 2, column 2 (b) is nan"),
        ("a,b\n1,inf\n", "line 2, column 2 (b) is inf"),
        ("a,b\n1,wet\n", "line 2, column 2 (b) is 'wet'"),
    ],
)
def test_a_csv_that_cannot_be_read_is_named_by_line_and_column(refused, tmp_path, text, expected):
    (tmp_path / "in" / "felt").mkdir(parents=True)
    (tmp_path / "in" / "felt" / "a.csv").write_text(text)
    words = ("import", "folder", tmp_path / "in", "--sampling-rate-Hz", 100, "--unit", "mV", "-o", tmp_path / "o.h5")
    refused(words, "felt/a.csv: ", expected)


@pytest.mark.parametrize("rate", ["0", "-5", "nan", "inf"])
def test_a_wrong_rate_is_refused(refused, tmp_path, rate):
    words = ("import", "folder", tmp_path, "--sampling-rate-Hz", rate, "--unit", "mV", "-o", tmp_path / "o.h5")
    refused(words, "sampling_rate_Hz must be a positive number")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_signal_that_is_no_number_is_named(refused, tmp_path, value):
    save_recordings(touch(), tmp_path / "touch.h5")
    with h5py.File(tmp_path / "touch.h5", "a") as file:
        file["signals/values"][310, 1] = value
    words = ("encode", tmp_path / "touch.h5", "-o", tmp_path / "s.h5")
    refused(words, "touch.h5: trial 1, sample 10, taxel2 is NaN or infinite")


def test_spikes_of_another_sensor_or_clock_are_refused(neurotact, refused, made, tmp_path):
    for name, changes, expected in (
        ("wide", {"n_taxels": 3}, ("spikes: come from 6 afferents", "trained on 4", "same taxels")),
        ("fast", {"rate_Hz": 2000.0}, ("sampled at 2000 Hz", "trained at 1000 Hz")),
        ("short", {"seconds": 0.1}, ("trial 0 lasts 0.100 s", "0.150 s of start_ms + length_ms")),
    ):
        save_recordings(touch(**changes), tmp_path / f"{name}.h5")
        spikes = tmp_path / f"{name}-spikes.h5"
        assert neurotact("encode", tmp_path / f"{name}.h5", "-o", spikes)[0] == 0
        refused(("infer", made / "run", spikes), *expected)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("command", ["infer", "sops"])
def test_spikes_of_another_encoder_are_refused_unless_they_are_meant(neurotact, refused, made, tmp_path, command):
    spikes = tmp_path / "slow.h5"
    assert neurotact("encode", made / "touch.h5", "--set", "sa1.t_ref_ms=5", "-o", spikes)[0] == 0
    words = {
        "infer": ("infer", made / "run", spikes),
        "sops": ("sops", made / "run", "--spikes", spikes, "-o", tmp_path / "sops.csv"),
    }[command]
    told = "spikes: sa1.t_ref_ms is 5.0 but was 1.0 in training; "
    refused(words, told, "pass --allow-other-encoder")
    assert not (tmp_path / "sops.csv").exists()
    code, out, err = neurotact(*words, "--allow-other-encoder")
    assert (code, err.count("\n")) == (0, 1)
    assert err.startswith(f"neurotact: {told}")
    assert "test" in out


def test_another_recording_is_unseen_and_the_sops_are_those_of_the_networks_own_trials(
    neurotact, refused, made, tmp_path
):
    other = touch()
    backwards = [signal[::-1] for signal in other.signals]
    save_recordings(Recordings(backwards, RATE_Hz, "mV", other.conditions), tmp_path / "other.h5")
    assert neurotact("encode", tmp_path / "other.h5", "-o", tmp_path / "spikes.h5")[0] == 0
    code, _, _ = neurotact("infer", made / "run", tmp_path / "spikes.h5", "-o", tmp_path / "labels.json")
    assert code == 0
    assert set(pd.read_json(tmp_path / "labels.json").side) == {"unseen"}
    words = ("sops", made / "run", "--spikes", tmp_path / "spikes.h5", "-o", tmp_path / "sops.csv")
    refused(words, "spikes: hold none of the network's test trials")


def test_spikes_that_moved_are_still_known(neurotact, made, tmp_path):
    (tmp_path / "moved.h5").write_bytes((made / "spikes.h5").read_bytes())
    assert neurotact("sops", made / "run", "--spikes", tmp_path / "moved.h5", "-o", tmp_path / "moved.csv")[0] == 0
    assert neurotact("sops", made / "run", "-o", tmp_path / "sops.csv")[0] == 0
    assert (tmp_path / "moved.csv").read_bytes() == (tmp_path / "sops.csv").read_bytes()


def test_the_sop_report_counts_windows_and_names_the_side(neurotact, made, tmp_path):
    code, out, _ = neurotact("sops", made / "run", "-o", tmp_path / "sops.md")
    assert code == 0
    assert out.splitlines()[0].rstrip() == "test windows"
    text = (tmp_path / "sops.md").read_text()
    assert "| side | label | windows | accuracy |" in text
    assert "| test | all | 8 |" in text


@pytest.mark.parametrize("command", [("train", *QUICK), ("tune", "--trials", 1, *QUICK)])
def test_a_single_class_is_refused(neurotact, refused, tmp_path, command):
    alone = touch()
    table = alone.conditions.assign(label="felt")
    save_recordings(Recordings(alone.signals, RATE_Hz, "mV", table), tmp_path / "alone.h5")
    assert neurotact("encode", tmp_path / "alone.h5", "-o", tmp_path / "spikes.h5")[0] == 0
    words = (command[0], tmp_path / "spikes.h5", *command[1:], "-o", tmp_path / "run")
    refused(words, "spikes: the training trials hold too few classes (felt); give at least two")


def test_thresholds_that_adapt_are_trained_and_refused_where_they_mean_nothing(neurotact, refused, made, tmp_path):
    run = tmp_path / "run"
    train = ("train", made / "spikes.h5", "-o", run, *QUICK)
    refused((*train, "--set", "tau_adaptation_ms=50"), "tau_adaptation_ms needs threshold_adaptation above 0; set that")
    refused((*train, "--set", "threshold_adaptation=-1"), "threshold_adaptation", "0")
    adapting = ("--set", "threshold_adaptation=0.3", "--set", "tau_adaptation_ms=50")
    assert neurotact(*train, *adapting)[0] == 0
    assert run_folder.restore(run).network.adaptation is not None
    words = ("export", run, "--to", "nir", "--network-only", "-o", tmp_path / "a.nir")
    refused(words, "adaptive thresholds: NIR does not run it")


@pytest.mark.filterwarnings("default")
def test_training_without_a_spike_is_said_in_one_line(neurotact, made, tmp_path):
    words = ("encode", made / "touch.h5", "--set", "sa1.gain=0.001", "--set", "ra1.gain=0.001")
    assert neurotact(*words, "-o", tmp_path / "silent.h5")[0] == 0
    code, _, err = neurotact("train", tmp_path / "silent.h5", "-o", tmp_path / "run", *QUICK)
    assert code == 0
    first, near_chance, *_ = (line for line in err.splitlines() if line.startswith("neurotact: "))
    assert first.startswith("neurotact: training: none of the 48 training windows holds a spike")
    assert "is not clearly above chance (50.0 %)" in near_chance


def test_the_seed_of_a_training_gives_one_seed_for_the_weights_and_another_for_the_order(neurotact, made, tmp_path):
    assert neurotact("train", made / "spikes.h5", "-o", tmp_path / "run", *QUICK, "--seed", 5)[0] == 0
    trains, restored = load_spikes(made / "spikes.h5"), run_folder.restore(tmp_path / "run")
    weights, order = seeds.of_start(5, restored.task.split)
    own, same = (trainer.fit(trains, restored.network.spec, restored.task, (weights, n))[0] for n in (order, weights))
    assert torch.equal(restored.network.w_in, own.network.w_in)
    assert not torch.equal(restored.network.w_in, same.network.w_in)


def test_classes_that_the_network_does_not_know_are_refused(neurotact, refused, made, tmp_path):
    other = touch()
    table = other.conditions.replace("fine", "smooth")
    save_recordings(Recordings(other.signals, RATE_Hz, "mV", table), tmp_path / "other.h5")
    assert neurotact("encode", tmp_path / "other.h5", "-o", tmp_path / "spikes.h5")[0] == 0
    refused(("infer", made / "run", tmp_path / "spikes.h5"), "class 'smooth' is not a class of the network")


def test_recordings_of_other_trials_are_not_drawn(refused, made, tmp_path):
    other = touch()
    backwards = [signal[::-1] for signal in other.signals]
    save_recordings(Recordings(backwards, RATE_Hz, "mV", other.conditions), tmp_path / "other.h5")
    words = ("raster", made / "spikes.h5", "--recordings", tmp_path / "other.h5", "-o", tmp_path / "r.png")
    refused(words, "other.h5", "does not hold the recordings")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--window-ms", 1000), ("lasts 0.300 s, less than the 1.000 s", "shorten the window")),
        (("--window-ms", 0.1), ("window.length_ms: 0.1 ms is less than one step", "in milliseconds, not in seconds")),
        (("--window-ms", -5), ("--window-ms: must be > 0; got -5",)),
        (("--window-ms", 150, "--start-ms", 290), ("lasts 0.300 s, less than the 0.440 s of start_ms + length_ms",)),
        (("--start-ms", 300), ("window.start_ms: trial 0 lasts 300 ms, so no window can start at 300 ms",)),
        (("--per-trial", 0), ("'--per-trial': Input should be greater than or equal to 1",)),
        (("--exit-tolerance", -1), ("exit_tolerance: must be >= 0; got -1",)),
        (("--tolerance", "nan"), ("exit_tolerance: must be a finite number",)),
        (("--set", "readout=count", "--set", "readout_tau_ms=0"), ("readout_tau_ms: must be > 0",)),
        (("--stratify", "force"), ("there is no condition 'force'", "force_N")),
        (("--device", "tpu9"), ("--device tpu9: torch cannot use it here", "try cpu")),
        (("--device", "cuda:99"), ("--device cuda:99: torch cannot use it here", "try cpu")),
        (("--set", "hiden=5"), ("hiden: unknown key; did you mean 'hidden'?", "default.toml")),
        (("--set", "hidden=-1"), ("hidden: must be >= 0; got -1", "default.toml")),
        (("--set", "hidden=0", "--set", "readout=count"), ("hidden = 0 needs readout = 'integrator'", "default.toml")),
        (("--set", "reset=none"), ("reset: must be 'zero', 'subtract' or 'hard'; got 'none'",)),
    ],
)  # fmt: skip
def test_a_training_that_cannot_be_is_refused(refused, made, tmp_path, words, expected):
    refused(("train", made / "spikes.h5", "-o", tmp_path / "run", *words), *expected)
    assert not (tmp_path / "run").exists()


def test_a_class_with_too_few_trials_is_named(neurotact, refused, tmp_path):
    save_recordings(touch(n_trials=5), tmp_path / "few.h5")
    assert neurotact("encode", tmp_path / "few.h5", "-o", tmp_path / "spikes.h5")[0] == 0
    words = ("train", tmp_path / "spikes.h5", "-o", tmp_path / "run")
    refused(words, "split: class 'fine' has 2 trials, too few", "give at least 3 trials per class for")


def test_an_output_folder_that_is_not_free_is_left_alone(refused, made, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("precious")
    for place in (tmp_path / "full", tmp_path / "full" / "thesis.txt"):
        reason = "already exists and is not empty" if place.is_dir() else "is a file; name a folder"
        refused(("train", made / "spikes.h5", "-o", place), f"{place}: {reason}")
        reason = "is not empty and holds no study" if place.is_dir() else "is a file; name a folder"
        refused(("study", "run", "refractory-period", "-o", place), f"{place}: {reason}")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.txt"]


def test_a_folder_in_place_of_a_file_is_named(refused, made, tmp_path):
    refused(("encode", made / "touch.h5", "-o", tmp_path), "'-o' / '--out'", f"'{tmp_path}' is a directory")


def test_a_figure_of_an_unknown_kind_is_named(refused, made, tmp_path):
    refused(("raster", made / "spikes.h5", "-o", tmp_path / "r.bmp"), "r.bmp", ".png", ".csv")
    refused(("sops", made / "run", "-o", tmp_path / "sops.xls"), "sops.xls", ".csv")
    refused(("infer", made / "run", made / "spikes.h5", "-o", tmp_path / "i.xls"), "i.xls", ".csv")


def test_a_trial_or_a_stretch_that_is_not_there_is_named(refused, made, tmp_path):
    words = ("raster", made / "spikes.h5", "-o", tmp_path / "r.png")
    refused((*words, "--trial", N_TRIALS), f"--trial {N_TRIALS}", f"0 to {N_TRIALS - 1}")
    refused((*words, "--start-s", 9), "start 9 s must be >= 0 and before the end at 0.3 s")


@pytest.mark.parametrize("name", ["network.json", "weights.safetensors"])
def test_a_damaged_network_is_named(refused, made, tmp_path, name):
    for path in (made / "run").iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / name).write_bytes((made / "run" / name).read_bytes()[:-9])
    refused(("infer", tmp_path, made / "spikes.h5"), f"{tmp_path / name}: is ")
    (tmp_path / name).unlink()
    refused(("infer", tmp_path, made / "spikes.h5"), f"{tmp_path / name}: there is no such file")


# --- studies ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("network.hiden=5", "network.hiden: unknown key; did you mean 'hidden'?"),
        ("encoder.sa1.gain=-1", "encoder.sa1.gain: must be > 0; got -1"),
        ("network.hidden=-1", "network.hidden: must be >= 0; got -1"),
        ("network=5", "network: must be a table; got 5"),
        ("seed=-1", "sweep.seed must be whole numbers >= 0"),
        ("dataset=v3", "'v3' is not a subset"),
        ("sweep.dataset=[[1]]", "'[1]' is not a subset"),
        ("sweep.seed=[]", "sweep of 'seed' has no value"),
        ("sweep.seed=3", "sweep.seed: must be a list; got 3"),
        ("sweep=3", "sweep: must be a table; got 3"),
        ("encoder.sa1.t_ref_ms=5", "is swept as"),
        ("dataset.parameters.trails=5", "trails: unknown key; did you mean 'trials'?"),
        ("dataset.parameters.noise_mV_rms=nan", "noise_mV_rms: must be a finite number"),
        ("dataset.simulate=felt", "dataset.simulate: there is no such simulation; known: compliance"),
        ("dataset.subsets=3", "dataset.subsets: must be a table; got 3"),
        ("window.length_ms=0", "window.length_ms: must be > 0; got 0"),
        ("split.test=0.9", "split: validation + test must be below 1"),
        ("quick=3", "quick: unknown key"),
        ("titel=x", "titel: unknown key; did you mean 'title'?"),
    ],
)
def test_a_wrong_study_is_refused_before_anything_runs(refused, tmp_path, assignment, expected):
    words = ("study", "run", "refractory-period", "--quick", "--set", assignment, "-o", tmp_path / "run")
    refused(words, expected)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("[quick]", "[quik]"), "quik: unknown key"),
        (("[dataset]", "sweep = 3\n[dataset]"), "is not valid TOML"),
        (('encoder = "sa1-ra1-lif"', 'encoder = "sa1"'), "sa1: there is no such spec in encoders"),
        (('network = "rsnn"', 'network = "mine.toml"'), "mine.toml: there is no such file"),
        (('encoder = "sa1-ra1-lif"', ""), "encoder: is missing"),
        (("[window]", "[windows]"), "windows: unknown key; did you mean 'window'?"),
        (("[1, 1], [1, 5]", "[1, 1], [1]"), "needs a list of 2 values for each point"),
        (("[1, 1], [1, 5]", "[1, 1], [1, -5]"), "encoder.sa1.t_ref_ms: must be >= 0; got -5"),
        (('"network.hidden" =', '"network.hiden" ='), "network.hiden: unknown key; did you mean 'hidden'?"),
    ],
)
def test_a_wrong_study_file_is_refused_before_anything_runs(refused, tmp_path, change, expected):
    text = spec.find("studies", "refractory-period").read_text()
    assert change[0] in text
    (tmp_path / "study.toml").write_text(text.replace(*change))
    refused(("study", "run", tmp_path / "study.toml", "-o", tmp_path / "run"), expected)
    assert not (tmp_path / "run").exists()


def test_a_study_divides_trials_as_train_does(neurotact, monkeypatch, tmp_path):
    asked = []
    save_recordings(touch(), tmp_path / "touch.h5")
    monkeypatch.setattr(runner, "run", lambda what, *_: asked.append(what) or sys.exit(0))
    words = ("study", "run", "own-recordings", "--data", tmp_path / "touch.h5", "-o", tmp_path / "run")
    ways = ((), ("--test-where", "force_N=3,6"), ("--group", "force_N"), ("--order", "trial"), ("--folds", "3"))
    for further in ways:
        code, out, err = neurotact(*words, *further)
        assert code == 0, out + err
    splits = [what.split for what in asked]
    given = (
        {"folds": 5},
        {"test_where": {"force_N": [3, 6]}},
        {"group": ("force_N",)},
        {"order": "trial"},
        {"folds": 3},
    )
    assert splits == [SplitSpec(**each) for each in given]
    assert asked[-1].sweep["split.fold"] == [0, 1, 2]


@pytest.mark.thorough
def test_a_file_of_ones_own_is_one_command_for_ways_to_save(neurotact, tmp_path, caplog):
    save_recordings(touch(), tmp_path / "touch.h5")
    small = (
        "--set", "ways={pruning=[{prune=0.5}]}", "--set", "network={recipe='default',hidden=4,training={epochs=1}}",
        "--window-ms", "100",
    )  # fmt: skip
    words = ("study", "run", "ways-to-save", "--data", tmp_path / "touch.h5", "-o", tmp_path / "run", "--quick")
    code, out, err = neurotact(*words, *small, "--workers", "1")
    assert code == 0, out + err
    assert "Window: 100 ms (as given)" in caplog.text
    assert "a first look" in err
    assert "Nothing was learned, so no saving means anything" in out
    assert f"{tmp_path / 'run' / 'report.html'}\n" in out
    code, again, _ = neurotact("study", "report", tmp_path / "run", "--json")
    assert code == 0
    found = json.loads(again)
    assert found["answers"][0]["headline"] in out
    assert found["tables"][0]["columns"][0] == "way"


@pytest.mark.parametrize(
    ("name", "further", "expected"),
    [
        ("ways-to-save", ("--data", "away.h5"), "--data away.h5: there is no such file; neurotact import folder"),
        ("ways-to-save", ("--data", "junk.h5"), "junk.h5: cannot be read as recordings"),
        ("ways-to-save", ("--data", "touch.h5", "--folds", "3"), "split.folds: this study draws its test trials"),
        ("ways-to-save", ("--data", "touch.h5", "--group", "person"), "--group: there is no condition 'person'"),
        ("ways-to-save", ("--data", "touch.h5", "--window-ms", "9000"), "less than the 9.000 s of start_ms"),
        ("real-sets", ("--data", "touch.h5"), "real-sets.toml makes or reads its own recordings; leave --data out"),
    ],
)
def test_a_file_that_does_not_fit_a_study_is_refused(refused, tmp_path, monkeypatch, name, further, expected):
    monkeypatch.chdir(tmp_path)
    save_recordings(touch(), "touch.h5")
    Path("junk.h5").write_text("label,taxel1")
    refused(("study", "run", name, *further, "-o", "run"), expected)
    assert not Path("run").exists()


def test_a_folder_that_holds_another_study_is_refused(refused, tmp_path):
    from neurotact.studies import runner, study

    runner._claim(tmp_path / "run", study.resolve("refractory-period", quick=True))
    (tmp_path / "run" / runner.CELLS).mkdir()  # as when its first cell begins
    words = ("study", "run", "refractory-period", "-o", tmp_path / "run")
    message = refused(words, f"{tmp_path / 'run'}: already holds another study")
    assert "(dataset.parameters.trials = 25, here 100; " in message
    assert message.endswith(" more); choose another folder or remove it\n")


def test_a_folder_without_a_study_cannot_be_resumed(refused, tmp_path):
    for command in ("resume", "report"):
        refused(("study", command, tmp_path), f"{tmp_path}: holds no study; start one with neurotact study run")
    (tmp_path / "study.toml").write_text("schema = 2\ntitle = 3")
    refused(("study", "resume", tmp_path), f"{tmp_path / 'study.toml'}")


@pytest.mark.parametrize("command", ["show", "copy"])
@pytest.mark.parametrize(("content", "expected"), [(b"\xa0", "is not UTF-8"), (b"#" * 2**21, "is longer than")])
def test_a_file_that_is_no_spec_is_neither_shown_nor_copied(refused, tmp_path, command, content, expected):
    (tmp_path / "given.toml").write_bytes(content)
    refused((command, tmp_path / "given.toml", *(() if command == "show" else ("-o", tmp_path / "new.toml"))), expected)


def test_the_folder_of_a_network_that_cannot_be_named_is_refused(refused, tmp_path):
    refused(("sops", "x/" * 3000, "-o", tmp_path / "out.csv"), "there is no such folder")


def test_info_says_what_recordings_and_spikes_hold(neurotact, refused, made, tmp_path):
    code, out, err = neurotact("info", made / "touch.h5")
    assert (code, err) == (0, "")
    data = load_recordings(made / "touch.h5")
    assert out.startswith(f"{made / 'touch.h5'}: {len(data)} trials of {len(data.classes)} classes, ")
    pooled = np.concatenate([*data.signals])[:, 0].astype(float)
    deviation = np.sqrt(np.mean(np.concatenate([signal[:, 0] - signal[:, 0].mean() for signal in data.signals]) ** 2))
    row = next(line.split() for line in out.splitlines() if line.startswith(f" {data.channels[0]} "))
    shown = [float(cell) for cell in row[1:]]
    assert shown == pytest.approx([pooled.min(), pooled.mean(), pooled.max(), deviation], rel=2e-3, abs=1e-3)
    code, out, err = neurotact("info", made / "spikes.h5")
    assert (code, err) == (0, "")
    assert f"{sum(map(len, load_spikes(made / 'spikes.h5').steps)):,} spikes" in out
    assert " SA-I " in out
    (tmp_path / "a.csv").write_text("1,2")
    refused(("info", tmp_path / "a.csv"), "cannot be read as recordings or spikes")


def test_info_summarises_many_taxels_and_names_constant_ones(neurotact, tmp_path):
    signals = np.random.default_rng(0).normal(0, 1, (4, 20, 50)) + np.arange(50.0)
    signals[:, :, [3, 7]] = np.arange(4.0)[:, None, None]  # another value in each trial
    save_recordings(Recordings(signals, 100.0, "mV", {"label": ["felt", "silk"] * 2}), tmp_path / "grid.h5")
    out = neurotact("info", tmp_path / "grid.h5")[1]
    row = next(line.split() for line in out.splitlines() if line.startswith(" median "))
    means = signals.mean(axis=(0, 1))
    assert float(row[2]) == pytest.approx(np.median(means), rel=1e-3)
    assert "constant within every trial: taxel4, taxel8\n" in out
    assert " taxel9 " not in out
    assert " taxel9 " in neurotact("info", tmp_path / "grid.h5", "--all")[1]


def test_info_says_when_the_touch_begins(neurotact, tmp_path):
    rng = np.random.default_rng(0)
    signals = rng.normal(0, 0.1, (12, 150, 2))
    for begin, path in ((45, tmp_path / "rest.h5"), (0, tmp_path / "contact.h5")):
        signals[:, begin:] += rng.normal(0, 5, (12, 1, 2))
        save_recordings(Recordings(signals, 100.0, "mV", {"label": ["felt", "silk"] * 6}), path)
    said = "the touch begins about 450 ms after the start of a trial (neurotact train ... --start-ms VALUE)\n"
    assert said in neurotact("info", tmp_path / "rest.h5")[1]
    assert "the touch begins" not in neurotact("info", tmp_path / "contact.h5")[1]


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_a_command_and_the_list_of_commands_say_the_same(name):
    assert " ".join(commands._load(name).help.split("\n\n")[0].split()) == cli.COMMANDS[name].help


@pytest.mark.parametrize(("dataset", "begin"), [("", "a verdict"), ("hard", "hard: a verdict")])
def test_an_answer_begins_with_its_data_set_if_that_has_a_name(monkeypatch, capsys, dataset, begin):
    one = {"dataset": dataset, "headline": "a verdict", "details": []}
    answer = {"answers": [one, one], "cautions": [], "report": "run/report.html"}
    monkeypatch.setattr(api, "study_answer", lambda folder: answer)
    _print_answer(Path("run"), as_json=False)
    assert capsys.readouterr().out.splitlines()[-2:] == [begin, begin]


def test_the_verdict_stands_last_after_the_numbers_and_the_next_command(monkeypatch, capsys):
    figure = {"what": "accuracy", "value": "9 %", "of": "few", "against": "SVM"}
    then = {"words": "Go on:", "commands": ["neurotact list"]}
    said = {"headline": "it is long", "short": "It is short", "untold": "Nobody knows", "period": "Use 5 ms."}
    one = {"dataset": "", **said, "details": ["a detail"], "figures": [figure], "next": then, "folder": "cells/a"}
    monkeypatch.setattr(
        api, "study_answer", lambda folder: {"answers": [one], "cautions": [], "report": "run/report.html"}
    )
    _print_answer(Path("run"), as_json=False)
    *_, figures, network, words, command, verdict, period = capsys.readouterr().out.splitlines()
    assert (figures, words, command) == ("accuracy: 9 % (few); SVM", "Go on:", "  neurotact list")
    assert network == "network of these numbers: run/cells/a"
    assert (verdict, period) == ("Nobody knows. It is short.", "Use 5 ms.")
