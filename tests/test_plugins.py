"""Parts of other packages: one that cannot be used ends in a sentence that names its package, and harms no other."""

import sys

import numpy as np
import pytest
import torch

import neurotact as nt
from neurotact import cli, plugins
from neurotact.errors import InputError
from neurotact.networks.definition import rsnn
from neurotact.networks.training import checkpoint
from neurotact.studies import loading

READER = "from neurotact.data.sources import Reader\nREADER = Reader('Touches of my skin.', print)\n"


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
    for kept in (plugins._found, plugins._loaded, rsnn._say_once):
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


SIMULATOR = (
    "from neurotact.data.sources import Simulator\nfrom neurotact.spec import Spec\n"
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


@pytest.mark.parametrize(
    ("module", "why"),
    [
        ("class Parameters: pass", "has no VIEW"),
        ("Parameters = VIEW = load = run = draw = 1", "has Parameters that are not a Spec"),
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
    "from neurotact.data.sources import Reader, Simulator\nfrom neurotact.spec import Spec\n"
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
    checkpoint.save(net, tmp_path / "net")
    assert checkpoint.load(tmp_path / "net")[0].spike == net.spike != nt.RSNN(2, 2, sampling_rate_Hz=1000.0).spike
    with pytest.raises(InputError, match="another surrogate: the native kernels does not run it"):
        nt.RSNN(2, 2, sampling_rate_Hz=1000.0, surrogate="triangle", backend="native")(torch.zeros(1, 5, 2))
