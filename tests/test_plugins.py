"""Parts of other packages: one that cannot be used ends in a sentence that names its package, and harms no other."""

import sys

import made_chains
import numpy as np
import pandas as pd
import pytest
import torch
from neurotact_parts.studies.comparison import protocol

import neurotact as nt
from neurotact import cli, plugins
from neurotact.baselines import opponent, opponents
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.splits import Split
from neurotact.data.windows import WindowSpec, cut
from neurotact.encoders import model
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.specs import encode, load, populations
from neurotact.errors import InputError
from neurotact.metrics.prices import price_list
from neurotact.networks.definition import rsnn
from neurotact.networks.training import comparison, run_folder
from neurotact.networks.training.epochs import Examples
from neurotact.report import report
from neurotact.studies import loading, runner

READER = "from neurotact.data.dataset import Reader\nREADER = Reader('Touches of my skin.', print)\n"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Installs a package called my-skin with these entry points, by group, and this module `my_skin`."""

    def install(entries: dict[str, str], module: str = "") -> None:
        about = tmp_path / "my_skin-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-skin\nVersion: 1.0\n")
        lines = [f"[neurotact.{group}]\n{entry}\n" for group, entry in entries.items()]
        (about / "entry_points.txt").write_text("\n".join(lines))
        (tmp_path / "my_skin.py").write_text(module)
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.delitem(sys.modules, "my_skin", raising=False)
        forget()

    yield install
    sys.modules.pop("my_skin", None)
    forget()


def forget() -> None:
    for kept in (plugins._found, plugins._loaded, rsnn._say_once, model.of_name, model._usable):
        kept.cache_clear()


def said_by(monkeypatch, capsys, *words: str) -> tuple[int, str]:
    """The exit code of a command, and what it printed."""
    monkeypatch.setattr(sys, "argv", ["neurotact", *words])
    try:
        cli.main()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    return code, "".join(capsys.readouterr())


UNUSABLE = {
    "raise ValueError('no driver\\nat all')": r"cannot be imported \(ValueError: no driver\)",
    "import a_driver": r"cannot be imported \(ModuleNotFoundError: No module named 'a_driver'\)",
    "import sys; sys.exit(3)": r"cannot be imported \(SystemExit: 3\)",
    "READER = 1 / 0": r"cannot be imported \(ZeroDivisionError: ",
    "": r"cannot be imported \(AttributeError: module 'my_skin' has no attribute 'READER'\)",
    "READER = print": "is of the type builtin_function_or_method where a Reader is expected",
    READER.replace("print", "None"): "has nothing to call",
}


@pytest.mark.parametrize("module", UNUSABLE)
def test_a_reader_that_cannot_be_used_is_named_with_its_package(package, monkeypatch, capsys, tmp_path, module):
    package({"readers": "my-skin = my_skin:READER"}, module)
    said = rf"readers: 'my-skin' of the package my-skin \(my_skin:READER\) {UNUSABLE[module]}"
    with pytest.raises(InputError, match=rf"^{said}.*; update or remove it$"):
        nt.read("my-skin", tmp_path)
    code, line = said_by(monkeypatch, capsys, "import", "my-skin", str(tmp_path), "-o", "touches.h5")
    assert (code, line.count("\n")) == (2, 1)
    assert line.startswith("neurotact: readers: 'my-skin' of the package my-skin")


def test_the_help_shows_the_others_beside_one_that_cannot_be_used(package, monkeypatch, capsys):
    package({"readers": "my-skin = my_skin:READER"}, "import a_driver")
    code, text = said_by(monkeypatch, capsys, "import", "--help")
    assert code == 0
    words = " ".join(text.split())
    assert "Cannot be used: readers: 'my-skin' of the package my-skin" in words
    assert "fabricslide" in words


NEAREST = """
import sys
from sklearn.neighbors import KNeighborsClassifier
from neurotact.baselines import Opponent
from neurotact.metrics.flops import NearestPoints
GRID = [{"n_neighbors": k} for k in (1, 3)]
def layers(fitted, x):
    return (NearestPoints(len(x), x.shape[1], fitted.n_neighbors),)
def fails(n_neighbors):
    raise ValueError("no neighbours\\nat all")
COUNTED = Opponent("The nearest examples.", KNeighborsClassifier, GRID, layers=layers)
OPPONENT = Opponent("The nearest examples.", KNeighborsClassifier, GRID)
ASKED = Opponent("The nearest examples.", KNeighborsClassifier, GRID, joins="named")
BROKEN = Opponent("The nearest examples.", fails, GRID)
LEAVES = Opponent("Ends the process.", lambda n_neighbors: sys.exit(3), GRID)
"""
LABELS = np.arange(40) % 2
WAVES = Recordings(
    list(np.random.default_rng(0).normal(size=(40, 200, 2)) + LABELS[:, None, None]), 500.0, "mV",
    pd.DataFrame({"label": ["felt", "silk"] * 20}),
)  # fmt: skip


def rows_of_opponents(level="quick"):
    windows = cut(np.full(40, 200), 500.0, WindowSpec(length_ms=400))
    parts = Split(np.arange(24), np.arange(24, 32), np.arange(32, 40))
    cuts = opponents.cuts_of(WAVES.conditions, windows, 500.0, parts, {})
    moments = next(opponents.signal_inputs(WAVES, cuts, level))
    return {row["classifier"]: row for row in opponents.rows([moments], LABELS, cuts)}


def test_an_opponent_of_another_package_takes_part_after_those_that_ship(package):
    package({"opponents": "nearest = my_skin:COUNTED\nasked = my_skin:ASKED"}, NEAREST)
    found = rows_of_opponents()
    assert [*found] == ["logistic regression", "SVM", "ELM", "extra trees", "nearest"]
    assert found["nearest"]["settings"] == "n_neighbors 1"
    assert found["nearest"]["macs"] > 24 * 4
    assert [*rows_of_opponents("linear")] == ["logistic regression"]
    assert "extra trees and nearest, on signals" in opponents.in_words("quick")
    sides = comparison.Sides(*(Examples(torch.from_numpy(TOUCHES[0]), torch.arange(24) // 12) for _ in range(3)))
    beside = comparison.opponents_of(sides, comparison.Trials(np.arange(24), np.arange(24)))
    assert [one.name for one in beside if "nearest" in one.name] == ["nearest on counts", "nearest on 10 time bins"]


def test_an_opponent_that_is_not_counted_costs_nothing_known(package):
    package({"opponents": "nearest = my_skin:OPPONENT"}, NEAREST)
    row = rows_of_opponents()["nearest"]
    assert (row["accuracy_test"], row["signal_ms"]) == (1.0, 400.0)
    assert np.isnan([row[name] for name in ("macs", "flops", "parameters", "energy_estimate_nJ")]).all()


@pytest.mark.parametrize(
    ("module", "why"),
    [
        ("OPPONENT = 1 / 0", r"cannot be imported \(ZeroDivisionError"),
        ("OPPONENT = print", "is of the type builtin_function_or_method where a Opponent is expected"),
        (NEAREST + "OPPONENT = BROKEN",
         r"cannot be fitted \(ValueError: no neighbours\)"),
        (NEAREST + "OPPONENT = LEAVES", r"cannot be fitted \(SystemExit: 3\)"),
    ],
)  # fmt: skip
def test_an_opponent_that_cannot_be_used_is_named_with_its_package(package, module, why):
    package({"opponents": "nearest = my_skin:OPPONENT"}, module)
    with pytest.raises(InputError, match=rf"^opponents: 'nearest' of the package my-skin \(my_skin:OPPONENT\) {why}"):
        rows_of_opponents()


def test_what_goes_wrong_in_an_opponent_that_ships_is_not_laid_on_its_package():
    with pytest.raises(ZeroDivisionError), opponent.named("kNN"):
        1 / 0  # noqa: B018


@pytest.mark.thorough
def test_an_opponent_of_another_package_stands_in_the_report_of_own_recordings(package, tmp_path):
    package({"opponents": "nearest = my_skin:OPPONENT"}, NEAREST)
    hdf5.save_recordings(WAVES, tmp_path / "touches.h5")
    small = {"sweep.seed": [0], "sweep.network.hidden": [4], "network.training.epochs": 2, "window.length_ms": 200.0,
             "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]], "window.per_trial": 1,
             "baselines": "quick"}  # fmt: skip
    runner.run(loading.resolve("own-recordings", small, data=tmp_path / "touches.h5"), tmp_path / "run")
    page = report.write(tmp_path / "run").read_text(encoding="utf-8")
    table = pd.read_csv(tmp_path / "run" / "baselines.csv")
    assert table["energy_estimate_nJ"].isna().tolist() == (table["classifier"] == "nearest").tolist()
    assert "nearest" in table["classifier"].tolist()
    ledger = pd.read_csv(tmp_path / "run" / "ledger.csv").set_index("name")
    assert ledger.loc["nearest on signals: mean and deviation"].drop("prices").isna().all()
    assert "not counted" in page
    assert ">nan<" not in page


def test_an_opponent_of_another_package_is_a_way_of_one_task(package):
    package({"opponents": "nearest = my_skin:OPPONENT"}, NEAREST)
    rng = np.random.default_rng(0)
    arrays = {
        "features": rng.normal(size=(60, 2)) + 4 * (np.arange(60) % 2)[:, None],
        "sequences": rng.normal(size=(60, 20, 2)),
        "labels": np.array(["a", "b"] * 30), "groups": np.arange(60), "sampling_rate_Hz": np.array(100.0),
        "unit": np.array("mV"), **{f"before_{kind}": np.zeros(len(protocol.COUNTED))
                                  for kind in ("features", "sequences")},
    }  # fmt: skip
    (row,) = protocol.run(protocol.Parameters(family="nearest"), arrays)
    assert row["accuracy_test"] == 1.0
    assert np.isnan(row["energy_estimate_nJ"])
    assert row["signal_ms"] == 200.0
    with pytest.raises(ValueError, match="there is none called 'nearst'; did you mean 'nearest'"):
        protocol.Parameters(family="nearst")


SIMULATOR = (
    "from neurotact.data.dataset import Simulator\nfrom neurotact.spec import Spec\n"
    "class Mine(Spec):\n    n_trials: int = 1\nSIMULATOR = Simulator('', Mine, print)\n"
)


@pytest.mark.parametrize(
    ("module", "why"),
    [
        ("SIMULATOR = {}", "is of the type dict where a Simulator is expected"),
        (SIMULATOR.replace("Mine, print", "dict, print"), "has a model that is not a Spec, or nothing to call"),
        (SIMULATOR.replace("Mine, print", "Mine, 3"), "has a model that is not a Spec, or nothing to call"),
    ],
)
def test_a_simulator_that_cannot_be_used_is_named_with_its_package(package, module, why):
    package({"simulators": "mine = my_skin:SIMULATOR"}, module)
    with pytest.raises(InputError, match=f"^simulators: 'mine' of the package my-skin .* {why}"):
        nt.simulate("mine")


WAY = """
from neurotact.spec import Spec
class Parameters(Spec): ...
VIEW = load = run = draw = 1
def named(results): ...
def _helper(results): ...
"""


@pytest.mark.parametrize(
    ("module", "why"),
    [
        ("class Parameters: pass", "has no VIEW"),
        ("Parameters = VIEW = load = run = draw = 1", "has Parameters that are not a Spec"),
        (f"{WAY}\ndef answers(results): ...", "has a function 'answers' of the results that no study calls"),
        ("raise OSError", r"cannot be imported \(OSError\)"),
    ],
)
def test_a_protocol_that_cannot_be_used_is_named_with_its_package(package, tmp_path, module, why):
    package({"ways": "mine = my_skin"}, module)
    (tmp_path / "mine.toml").write_text('title = "Mine"\nway = "mine"\n')
    with pytest.raises(InputError, match=f"^ways: 'mine' of the package my-skin .* {why}"):
        loading.resolve(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("group", "name", "command"),
    [("readers", "fabricslide", "import"), ("readers", "folder", "import"), ("simulators", "gratings", "simulate")],
)
def test_a_name_that_neurotact_has_is_refused_and_the_other_package_named(
    package, monkeypatch, capsys, tmp_path, group, name, command
):
    package({group: f"{name} = my_skin:READER"}, READER)
    source = [str(tmp_path)] if group == "readers" else []
    code, line = said_by(monkeypatch, capsys, command, name, *source, "-o", str(tmp_path / "touches.h5"))
    assert code == 2
    assert line == f"neurotact: {group}: '{name}' is provided by my-skin and neurotact; uninstall my-skin\n"


def test_two_other_packages_with_one_name_are_both_named(package, tmp_path):
    other = tmp_path / "their_skin-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: their-skin\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[neurotact.readers]\nskin = their_skin:READER\n")
    package({"readers": "skin = my_skin:READER"}, READER)
    with pytest.raises(InputError, match=r"'skin' is provided by my-skin and their-skin; uninstall one of them$"):
        nt.read("skin", tmp_path)


READS = (
    "import numpy as np, pandas as pd\nfrom neurotact.data.recordings import Recordings\n"
    "from neurotact.data.dataset import Reader, Simulator\nfrom neurotact.spec import Spec\n"
    "class Mine(Spec):\n    n_trials: int = 4\n"
    "def made(n): return Recordings([np.random.default_rng(i).normal(size=(50, 2)) for i in range(n)], 500.0, 'mV',"
    " pd.DataFrame({'label': ['a', 'b'] * (n // 2)}), source='my skin')\n"
    "READER = Reader('Touches of my skin.', lambda path: made(4))\n"
    "SIMULATOR = Simulator('Touches of my skin.', Mine, lambda spec, progress: made(spec.n_trials))\n"
)


def test_the_command_line_takes_parts_of_another_package(package, monkeypatch, capsys, tmp_path):
    package({"readers": "my-skin = my_skin:READER", "simulators": "my-finger = my_skin:SIMULATOR"}, READS)
    out = str(tmp_path / "touches.h5")
    assert said_by(monkeypatch, capsys, "import", "my-skin", str(tmp_path), "-o", out)[0] == 0
    assert len(nt.load(out)) == 4
    code, _ = said_by(monkeypatch, capsys, "simulate", "my-finger", "--set", "n_trials=6", "-o", out, "--force")
    assert (code, len(nt.load(out))) == (0, 6)


@pytest.mark.parametrize("command", ["show", "copy"])
@pytest.mark.parametrize("group", ["encoders", "networks", "prices"])
def test_a_part_is_told_from_a_spec_that_can_be_shown(package, monkeypatch, capsys, tmp_path, group, command):
    monkeypatch.chdir(tmp_path)
    package({group: "my-own = my_skin:PART"})
    assert said_by(monkeypatch, capsys, command, "my-own") == (
        2, "neurotact: my-own: is Python of the package my-skin, not a spec; its keys stand there\n"
    )  # fmt: skip
    assert "did you mean" in said_by(monkeypatch, capsys, command, "sa1-ra1-lft")[1]


def test_a_part_that_can_be_used_is_used(package, capsys, tmp_path):
    package({"readers": "my-skin = my_skin:READER"}, READER)
    assert "my-skin" in plugins.names("readers")
    nt.read("my-skin", tmp_path)
    assert capsys.readouterr().out == f"{tmp_path}\n"


LEARNING = """
import torch
def triangle(x, scale):
    return (1 - scale * x.abs()).clamp(min=0)
def squares(scores, labels):
    hot = torch.nn.functional.one_hot(labels, scores.shape[1])
    return (scores.softmax(dim=1) - hot).square().sum(dim=1).mean()
def each(scores, labels):
    return scores[:, 0]
NOT_CALLABLE = 3
"""
FUNCTIONS = {
    "surrogates": "triangle = my_skin:triangle\nnumber = my_skin:NOT_CALLABLE",
    "losses": "squares = my_skin:squares\neach = my_skin:each",
}
RATES = np.repeat([0.05, 0.3], 12)[:, None, None]
TOUCHES = (np.random.default_rng(0).random((24, 40, 2)) < RATES).astype(np.uint8), np.repeat(["a", "b"], 12)


def classifier(**settings):
    how = {"network": "snn", "epochs": 3, "sampling_rate_Hz": 1000.0, "random_state": 0}
    return nt.SpikingClassifier(5, **how, settings={"input_deviation": 1.0, "training.learning_rate": 0.05, **settings})


def test_a_surrogate_and_a_loss_of_another_package_train_a_network(package, capsys):
    package(FUNCTIONS, LEARNING)
    plain = classifier().fit(*TOUCHES)
    capsys.readouterr()
    for settings in ({"surrogate": "triangle"}, {"training.loss": "squares"}):
        found = classifier(**settings).fit(*TOUCHES)
        assert found.training_.epochs != plain.training_.epochs, settings
        assert capsys.readouterr().err.count("which is slower") == ("surrogate" in settings)
    found = classifier(**{"training.loss": "squares", "training.rate_penalty": 0.0}).fit(*TOUCHES)
    assert 0 < found.training_.best.train_loss <= 2  # as squares of probabilities are, and no cross-entropy need be
    with pytest.raises(InputError, match=r"^training\.loss: 'squares' takes no weights"):
        classifier(**{"training.loss": "squares"}).fit(*TOUCHES, sample_weight=np.arange(1, 25))


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"surrogate": "number"}, r"^surrogates: 'number' of the package my-skin .* is of the type int"),
        ({"training.loss": "each"}, r"^losses: 'each' of the package my-skin .* does not give a scalar"),
        ({"surrogate": "triange"}, r"surrogate: .*there is none called 'triange'; did you mean 'triangle'"),
        ({"training.loss": "square"}, r"loss: .*there is none called 'square'; did you mean 'squares'"),
    ],
)
def test_a_function_that_cannot_be_used_is_named(package, settings, why):
    package(FUNCTIONS, LEARNING)
    with pytest.raises(InputError, match=why):
        classifier(**settings).fit(*TOUCHES)


def test_a_network_with_a_surrogate_of_another_package_is_saved_and_needs_it(package, tmp_path):
    package(FUNCTIONS, LEARNING)
    net = nt.RSNN(2, 2, sampling_rate_Hz=1000.0, hidden=3, surrogate="triangle")
    run_folder.save_network(net, tmp_path / "net")
    assert (
        run_folder.load_network(tmp_path / "net")[0].spike == net.spike != nt.RSNN(2, 2, sampling_rate_Hz=1000.0).spike
    )
    with pytest.raises(InputError, match="another surrogate: the native kernels does not run it"):
        nt.RSNN(2, 2, sampling_rate_Hz=1000.0, surrogate="triangle", backend="native")(torch.zeros(1, 5, 2))


ENCODER = """
from typing import Literal, NamedTuple
import numpy as np
from neurotact.encoders.model import ON_OFF, EncoderSpec, Model, both, over_time
class LevelSpec(EncoderSpec):
    model: Literal["level"] = "level"
    threshold: float = 1.0
class State(NamedTuple):
    above: np.ndarray
def encode(signal, sampling_rate_Hz, spec, state=None):
    def step(x, state):
        above = x > spec.threshold
        return both(above & ~state.above, ~above & state.above), State(above)
    state = State(np.zeros((len(signal), signal.shape[2]), bool)) if state is None else state
    return over_time(signal, state, step, 2 * signal.shape[2])
MODEL = Model("level crossings", LevelSpec, encode, State, ON_OFF)
"""
LEVEL = {"encoders": "level = my_skin:MODEL"}


@pytest.fixture
def touches(tmp_path):
    """A file of vibrations of two frequencies, twelve trials each."""
    rng, time_s = np.random.default_rng(0), np.arange(300)[:, None] / 1000
    labels = np.repeat(["slow", "fast"], 12)
    signals = [
        5 * np.sin(2 * np.pi * {"slow": 12, "fast": 45}[label] * time_s + rng.uniform(0, 6, 2)) for label in labels
    ]
    path = tmp_path / "touches.h5"
    nt.save(Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": labels})), path)
    return path


@pytest.mark.filterwarnings("default:encoding is not counted")
def test_an_encoder_of_another_package_is_encoded_calibrated_and_trained_on(
    package, monkeypatch, capsys, tmp_path, touches, caplog
):
    package(LEVEL, ENCODER)
    assert load("level", {"threshold": 2}).threshold == 2
    assert (model.names()[0], model.names()[-1]) == ("lif", "level")
    trains = nt.encode(nt.load(touches), "level", {"threshold": 2})
    assert trains.afferents == ("ON taxel1", "ON taxel2", "OFF taxel1", "OFF taxel2")
    fitted = nt.calibrate(nt.load(touches), "level")
    assert fitted.threshold != 1.0
    spikes, run = str(tmp_path / "spikes.h5"), str(tmp_path / "run")
    assert said_by(monkeypatch, capsys, "encode", str(touches), "--encoder", "level", "-o", spikes)[0] == 0
    words = ("train", spikes, "--network", "snn", "--set", "training.epochs=2", "-o", run)
    assert said_by(monkeypatch, capsys, *words)[0] == 0
    code, said = said_by(monkeypatch, capsys, "sops", run, "-o", str(tmp_path / "sops.csv"))
    assert code == 0
    assert "encoding is not counted, because the model 'level' declares no cost" in said
    rows = [line.split() for line in said.splitlines() if line.strip().startswith(("encoder", "both"))]
    assert [row[1] for row in rows] == ["not", "not"]  # counted, which is folded
    with pytest.raises(InputError, match="afferents of another package: a stream does not run it: only models of"):
        nt.Stream(run, streamed=nt.Streamed(sampling_rate_Hz=1000.0))
    with pytest.raises(InputError, match="afferents of another package: a stream"):
        nt.export_c(run, tmp_path / "c", variant="float")
    nt.export_nir(run, tmp_path / "chain.nir")
    assert "the encoder (afferents of another package: NIR does not run it: it has no nodes" in caplog.text


def test_an_encoder_is_found_where_the_list_of_parts_was_read_before_its_package_came(package):
    """As in a worker that is forked from a process of before."""
    package(LEVEL, ENCODER)
    plugins._found("encoders").pop("level")
    assert [population.name for population in populations({"model": "level"})] == ["ON", "OFF"]
    plugins._found("encoders").pop("level")
    assert load("level").model == "level"


def test_an_encoder_of_another_package_costs_what_is_not_counted(package):
    package(LEVEL, ENCODER)
    table = load("level", {"conditioning.baseline": "start"}).model_dump(mode="json")
    spent = encoding_cost(2, 100, 100.0, table)
    assert np.isnan([spent.flops, spent.energy_estimate_nJ, (spent + spent).macs]).all()
    assert spent.signal_ms == 100


def test_a_study_takes_an_encoder_of_another_package_and_does_not_count_its_cost(package, tmp_path, touches):
    package(LEVEL, ENCODER)
    settings = {"sweep.encoder & t_ref_ms": [["sa1-ra1-lif", "own"], ["level", "own"]], "network.training.epochs": 1}
    results = nt.run_study("which-encoder", tmp_path / "study", settings, data=touches, quick=True, workers=1)
    assert {*results["encoder"]} == {"lif", "level"}
    table = pd.read_csv(tmp_path / "study" / "encoders.csv").set_index("encoder")
    assert table["energy_estimate_nJ"].isna().to_dict() == {"sa1-ra1-lif": False, "level": True}
    page = (tmp_path / "study" / "report.html").read_text()
    assert "not counted" in page


UNFIT = {
    "MODEL = 3": "is of the type int where a Model is expected",
    ENCODER.replace("class LevelSpec(EncoderSpec)", "from neurotact.spec import Spec\nclass LevelSpec(Spec)"): (
        "has a spec that is not an EncoderSpec"
    ),
    ENCODER.replace('"level"', '"other"'): 'has a spec whose `model` is not "level"',
    ENCODER.replace("LevelSpec, encode", "LevelSpec, 3"): "has no function as its encode",
    ENCODER.replace("ON_OFF)\n", "ON_OFF, 3)\n"): "has no function as its cost",
    ENCODER.replace("State, ON_OFF", "State, ()"): "has no populations",
    ENCODER.replace("State, ON_OFF", "State"): "has a population SA-I and no table 'sa1' in its spec",
    ENCODER.replace("threshold", "level"): "has no key of ON that begins with gain or threshold",
    ENCODER.replace("2 * signal", "signal").replace("both(", "np.logical_or("): r"returns spikes .* \(1, 50, 4\)",
}


@pytest.mark.parametrize("module", UNFIT)
def test_an_encoder_that_cannot_be_used_is_named_with_its_package_and_harms_no_other(package, caplog, module):
    package(LEVEL, module)
    with pytest.raises(InputError, match=f"^encoders: 'level' of the package my-skin .* {UNFIT[module]}"):
        encode(np.zeros((1, 50, 2)), 1000.0, load("level"))
    assert ("level" in model.usable()) == ("returns" in UNFIT[module])
    assert len(caplog.messages) == ("returns" not in UNFIT[module])


def test_a_model_without_a_state_encodes_no_pieces(package):
    package(LEVEL, ENCODER.replace("encode, State, ON_OFF", "encode, populations=ON_OFF"))
    _, state = encode(np.zeros((1, 5, 2)), 1000.0, load("level"))
    with pytest.raises(InputError, match="the model 'level' names no state"):
        encode(np.zeros((1, 5, 2)), 1000.0, load("level"), state)


PRICES = """
from neurotact.metrics.prices import PriceList
CHIP = PriceList(source="a data sheet", multiplication_pJ=20.0, addition_pJ=1.0, mac_pJ=30.0)
"""


def test_a_price_list_of_another_package_prices_costs_and_is_named(package, tmp_path):
    package({"prices": "my-chip = my_skin:CHIP"}, PRICES)
    fitted = classifier().fit(*TOUCHES)
    (costs,) = fitted.costs(TOUCHES[0], prices="my-chip").to_dict("records")
    others = ("comparisons", "divisions", "exponentials")
    spent_pJ = 30 * costs["macs"] + costs["acs"] + 20 * costs["multiplications"]
    spent_pJ += sum(price * costs[kind] for kind, price in zip(others, (1, 60, 120), strict=True))
    assert costs["energy_estimate_nJ"] == pytest.approx(1e-3 * spent_pJ)
    assert (costs["prices"], fitted.costs(TOUCHES[0])["prices"][0]) == ("my-chip", "memory-45nm")
    copied = tmp_path / "mine.toml"
    copied.write_text("source = 'me'\nmultiplication_pJ = 3.7\naddition_pJ = 1.8\n")
    (mine,) = fitted.costs(TOUCHES[0], prices=copied).to_dict("records")
    assert mine["prices"] == "mine"
    with pytest.raises(InputError, match=r"^prices: there is none called 'my-chop'; did you mean 'my-chip'\?$"):
        fitted.costs(TOUCHES[0], prices="my-chop")


@pytest.mark.parametrize(
    ("module", "why"),
    [
        (PRICES.replace("20.0", "-20.0"), r"cannot be imported \(InputError: multiplication_pJ: must be >= 0; got -20"),
        (PRICES.replace("30.0", "float('nan')"), r"cannot be imported \(InputError: mac_pJ: must be a finite number"),
        (PRICES.replace("addition_pJ=1.0, ", ""), r"cannot be imported \(InputError: addition_pJ: is missing; add it"),
        ("CHIP = {'addition_pJ': 1.0}", "is of the type dict where a PriceList is expected"),
    ],
)
def test_a_price_list_that_cannot_be_used_is_named_with_its_package(package, module, why):
    package({"prices": "my-chip = my_skin:CHIP"}, module)
    with pytest.raises(InputError, match=rf"^prices: 'my-chip' of the package my-skin \(my_skin:CHIP\) {why}"):
        price_list("my-chip")


EXPORTS = """
from pathlib import Path
from neurotact_parts.streams.chain import chain_of
from neurotact.networks.use.exporters import Exporter
from neurotact.errors import InputError
def export(run, out, *, digits: int = 3, upper: bool = False, kind: str | None = None, tell=print):
    if digits > 9:
        raise InputError("digits: a float32 has no more than 9; give fewer")
    chain = chain_of(run)
    text = f"{', '.join(chain.classes)} {float(chain.network.w_in.detach().abs().max()):.{digits}f}"
    Path(out).write_text(text.upper() if upper else text)
    tell(f"{out}: {digits} digits")
    return chain.classes
THEIRS = Exporter("the classes, as text", export, {"digits": "digits of the largest weight.", "upper": "in capitals."})
WRONG = Exporter("nothing", export, {"colour": "of it."})
NOTHING = Exporter("nothing", None)
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return made_chains.make_run(tmp_path_factory.mktemp("run")) / "run"


def test_an_exporter_of_another_package_is_used_with_its_options(package, monkeypatch, capsys, tmp_path, run):
    package({"exporters": "theirs = my_skin:THEIRS"}, EXPORTS)
    out = tmp_path / "classes.txt"
    code, said = said_by(monkeypatch, capsys, "export", str(run), "--to", "theirs", "-o", str(out))
    assert (code, said) == (0, f"{out}: 3 digits\n")
    words = ["export", str(run), "--to", "theirs", "-o", str(out), "--digits", "5", "--upper"]
    code, line = said_by(monkeypatch, capsys, *words)
    assert (code, line.partition(";")[0]) == (2, f"neurotact: {out}: already exists")
    assert said_by(monkeypatch, capsys, *words, "--force") == (0, f"{out}: 5 digits\n")
    assert out.read_text().startswith("FELT, SILK ")
    assert nt.export(run, tmp_path / "again.txt", "theirs", digits=1) == ("felt", "silk")
    with pytest.raises(InputError, match=r"`plain`: has no effect with `to='theirs'`; it belongs to `to='nir'`; leave"):
        nt.export(run, tmp_path / "other.txt", "theirs", plain=False)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--to", "theirs", "--digits", "10"], "digits: a float32 has no more than 9; give fewer"),
        (
            ["--to", "c", "--digits", "4"],
            "--digits: has no effect with --to c; it belongs to --to theirs; leave it out",
        ),
        (
            ["--to", "theirs", "--full-window"],
            "--full-window: has no effect with --to theirs; it belongs to --to c; leave it out",
        ),
        (["--to", "their"], "exporters: there is none called 'their'; did you mean 'theirs'?"),
        (["--check", "loihi2", "--upper"], "--upper: has no effect with --check, which writes nothing; leave it out"),
    ],
)  # fmt: skip
def test_a_refusal_of_an_export_is_one_line(package, monkeypatch, capsys, tmp_path, run, words, line):
    package({"exporters": "theirs = my_skin:THEIRS"}, EXPORTS)
    out = [] if "--check" in words else ["-o", str(tmp_path / "out")]
    assert said_by(monkeypatch, capsys, "export", str(run), *words, *out) == (2, f"neurotact: {line}\n")
    assert not (tmp_path / "out").exists()


def test_the_help_of_export_shows_the_options_of_every_exporter_that_can_be_used(package, monkeypatch, capsys):
    package({"exporters": "theirs = my_skin:THEIRS\nbroken = my_skin:ABSENT"}, EXPORTS)
    words = " ".join(said_by(monkeypatch, capsys, "export", "--help")[1].split())
    assert "theirs: the classes, as text" in words
    assert "broken: cannot be used: exporters: 'broken' of the package my-skin" in words
    assert "--digits <int> With --to theirs: digits of the largest weight. [default: (3)]" in words
    assert "--kind" not in words


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        ("WRONG", r"describes the option 'colour', which it does not have"),
        ("NOTHING", "has nothing to call"),
        ("EXPORTS", "cannot be imported"),
        ("export", "is of the type function where a Exporter is expected"),
    ],
)
def test_an_exporter_that_cannot_be_used_is_named_with_its_package(package, tmp_path, run, entry, why):
    package({"exporters": f"mine = my_skin:{entry}"}, EXPORTS)
    with pytest.raises(InputError, match=rf"^exporters: 'mine' of the package my-skin \(my_skin:{entry}\) {why}"):
        nt.export(run, tmp_path / "out", "mine")


FORMATS = """
import numpy as np
from neurotact.data.readers.formats import Arrays, Format
from neurotact.data.readers.table.cells import table_of

ABOUT = "a touch of my skin", "record it again"

def columns(path):
    return {"": table_of(path, dict(zip(("left", "right"), np.loadtxt(path).T)), [0.005, 0.005])}

def arrays(path):
    return Arrays({"signals": np.loadtxt(path)[None], "label": np.array(["felt"]), "fs": np.array(200)})

TABLES = Format(*ABOUT, columns)
ARRAYS = Format(*ABOUT, arrays, "arrays")
OTHER = Format(*ABOUT, arrays)
NEITHER = Format(*ABOUT, columns, "lines")
"""


def test_a_format_of_another_package_is_read_by_its_suffix(package, tmp_path):
    package({"formats": "skin = my_skin:TABLES\nskins = my_skin:ARRAYS"}, FORMATS)
    signal = np.arange(20.0).reshape(10, 2) ** 2
    for path in (tmp_path / "set" / "felt" / "a.skin", tmp_path / "set" / "silk" / "b.skin", tmp_path / "all.SKINS"):
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, signal)
    read = nt.read_folder(tmp_path / "set", unit="mV", naming=nt.Naming(pattern="{name}.skin"))
    assert (read.channels, read.sampling_rate_Hz, read.classes) == (("left", "right"), 200.0, ("felt", "silk"))
    for signals in (read.signals, nt.read_arrays(tmp_path / "all.SKINS", unit="mV").signals):
        np.testing.assert_array_equal(signals[0], signal.astype(np.float32))
    (tmp_path / "set" / "felt" / "a.skin").write_text("1 2\n3 x\n")
    said = r"a\.skin: cannot be read as a touch of my skin \(could not convert .*\); record it again$"
    with pytest.raises(InputError, match=said):
        nt.read_folder(tmp_path / "set", unit="mV")
    with pytest.raises(InputError, match=r"give one that ends with \.npz, \.npy, \.mat, \.pt, \.pth, \.skins, \.h5 or"):
        nt.read_arrays(tmp_path / "set" / "silk" / "b.skin", unit="mV")


@pytest.mark.parametrize(
    ("part", "why"),
    [
        ("READER", "is of the type Reader where a Format is expected"),
        ("OTHER", "gives a Arrays where tables are expected"),
        ("NEITHER", "has nothing to call, or holds neither tables nor arrays"),
    ],
)
def test_a_format_of_another_kind_is_refused(package, tmp_path, part, why):
    package({"formats": f"skin = my_skin:{part}"}, READER + FORMATS)
    (tmp_path / "a.skin").write_text("1 2\n3 4\n")
    with pytest.raises(InputError, match=rf"^formats: 'skin' of the package my-skin \(my_skin:{part}\) {why}"):
        nt.read_table(tmp_path / "a.skin", unit="mV")
