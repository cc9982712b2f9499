"""Streams, C and NIR tell the numbers that a network tells of whole windows, value for value."""

import json
import re
import shutil
import struct

import numpy as np
import pandas as pd
import pytest
import torch
from compiled import chosen, compare
from in_process import typed
from levels import thinned
from made_chains import make_chain, make_signal, offline
from neurotact_parts.exporters.c import c_export, proof, proving
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.errors import InputError
from neurotact.files import read_json
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import run_folder
from neurotact.networks.training.sparsity import prune

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason=str(proof.missing("cc")))
KINDS = {
    "integrator": {"readout": "integrator", "windows": {"length_ms": 30, "hop_ms": 9}},
    "stretches": {"readout": "stretches", "step_ms": 2.0},
    "no hidden layer": {"readout": "stretches", "hidden": 0},
    "past the layer": {"readout": "integrator", "direct": True},
    "leaky": {"readout": "leaky"},
    "pruned": {"readout": "integrator", "hidden": 20},
}
NAMES = ("force_N", "speed_mm_per_s", "friction")
UNITS = (100.0, 1.0, 0.01)


EXIT = ExitRule(4, from_first_spike=True, band=(150.0, 1.5, 0.015))


def telling(kind: str, rule: ExitRule = FULL_WINDOW) -> Chain:
    """A chain of numbers of different units, as training folds them into the readout."""
    chain = make_chain({}, **KINDS[kind])
    network = chain.network
    assert network.bias is not None
    with torch.no_grad():
        for weights in (network.w_out, network.w_stretch):
            if weights is not None:
                weights *= torch.tensor(UNITS)
        network.bias.copy_(torch.tensor([3.0, -20.0, 0.5]))
    if kind == "pruned":
        prune(network, 0.6)
    return chain._replace(tells_numbers=True, classes=NAMES, rule=rule)


def whole(chain: Chain, signal: np.ndarray) -> np.ndarray:
    """The numbers of a trial's windows as the network tells them, `(window, target)`."""
    raster, windows = offline(chain, signal)
    cut = np.stack([raster[start : start + chain.windows.length] for start, *_ in windows])
    return chain.network.infer(torch.from_numpy(cut), chain.rule).readout.numpy()


@torch.no_grad()
def by_hand(chain: Chain, signal: np.ndarray) -> list[int]:
    """Steps of each window until no number has left its band for one step more than the patience."""
    raster, windows = offline(chain, signal)
    n, length, integration, found = chain.network.steps_per_bin, chain.windows.length, chain.network.integration, []
    patience = chain.rule.in_bins(n).patience
    assert integration is not None
    assert patience is not None
    for start, *_ in windows:
        gained = chain.network.simulate(torch.from_numpy(raster[None, start : start + length])).readout
        heard = gained[0].any(dim=1).tolist()
        anchor, began, step = integration.level.numpy(), 1, 0
        for step, value in enumerate(integration.over(gained), 1):
            if (np.abs(value[0].numpy() - anchor) > chain.rule.band).any():
                anchor, began = value[0].numpy(), step
            if any(heard[:step]) and step - max(began, heard.index(True) + 1) >= patience:
                break
        found.append(min(step * n, length))
    return found


@pytest.mark.parametrize("kind", [*KINDS])
def test_numbers_that_have_settled_end_a_window_and_later_steps_do_not_count(kind):
    chain = telling(kind, EXIT)
    signals = [make_signal(150, seed=seed) for seed in range(3)]
    rows, full = ([row for one in signals for row in offline(each, one)[1]] for each in (chain, telling(kind)))
    assert [row[2] for row in rows] == [step for one in signals for step in by_hand(chain, one)]
    assert len({row[2] for row in rows}) > 2
    saved = [other[3] - row[3] for row, other in zip(rows, full, strict=True)]
    assert min(saved) >= 0 < sum(saved)


@pytest.mark.parametrize("rule", [FULL_WINDOW, EXIT], ids=["whole", "early"])
@pytest.mark.parametrize("kind", [*KINDS])
def test_a_stream_tells_what_whole_windows_tell(kind, rule):
    chain, signal = telling(kind, rule), make_signal(150)
    stream = Stream(chain)
    first = stream.push(signal[:70])
    other = Stream(chain)
    other.restore(stream.state())
    rest = stream.push(signal[70:])
    assert other.push(signal[70:]) == rest
    decided = sorted([*first, *rest], key=lambda each: each.window)
    expected = whole(chain, signal)
    rows = offline(chain, signal)[1]
    assert [(d.steps, d.input_spikes, d.hidden_spikes) for d in decided[: len(rows)]] == [row[2:] for row in rows]
    for decision, row in zip(decided, expected, strict=False):
        assert decision.values is not None
        assert [*decision.values] == [*NAMES]
        assert [*decision.values.values()] == row.tolist()
        assert decision.label == ", ".join(f"{name} = {value:.6g}" for name, value in decision.values.items())
    assert len({row[0] for row in expected.tolist()}) > 1


def test_a_stream_of_classes_has_no_values():
    decided = Stream(make_chain({}, readout="integrator")).push(make_signal(60))
    assert decided
    assert all(decision.values is None for decision in decided)


@needs_compiler
@thinned("kind", [*KINDS], every=2)
@pytest.mark.parametrize("rule", [FULL_WINDOW, EXIT], ids=["whole", "early"])
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_c_tells_what_its_twin_tells(kind, variant, rule, tmp_path):
    chain, signals = telling(kind, rule), [make_signal(150, seed=k) for k in range(3)]
    if variant == "integer" and chain.network.leaks:
        return
    formats = None if variant == "float" else chosen(chain, signals, state_bits=16)
    difference, expected = compare(chain, tmp_path, formats)
    assert difference is None
    rows = [row for trial in expected for row in trial.decisions]
    assert {row[-4] for row in rows} == {0}  # no class
    told = np.array([row[-3:] for row in rows])
    assert len(np.unique(told, axis=0)) > 1
    assert (len({row[2] for row in rows}) > 2) == (not rule.never)
    wrong = [trial._replace(decisions=[(*row[:-1], row[-1] + 1) for row in trial.decisions]) for trial in expected]
    assert proof.first_difference(wrong, expected) is not None


@pytest.mark.parametrize("rule", [FULL_WINDOW, EXIT], ids=["whole", "early"])
@pytest.mark.parametrize("kind", ["integrator", "stretches", "no hidden layer"])
def test_float_c_tells_the_numbers_of_the_network(kind, rule):
    chain, signal = telling(kind, rule), make_signal(150)
    (trial,) = proving.twin_of(chain, None, [signal], np.zeros((1, 3)), None).expected
    assert [list(row[-3:]) for row in trial.decisions] == whole(chain, signal).tolist()


def test_integers_tell_each_number_in_a_unit_of_its_own():
    """With one for all, the weights of the number with the smallest ones would all be 0."""
    chain, signals = telling("no hidden layer"), [make_signal(150, seed=k) for k in range(3)]
    formats = chosen(chain, signals, state_bits=16)
    assert (np.abs(formats.readout.w).reshape(-1, 3).max(axis=0) == 127).all()
    trials = proving.twin_of(chain, formats, signals, np.zeros((3, 3)), None)
    told = np.concatenate([[row[-3:] for row in trial.decisions] for trial in trials.expected]) * trials.unit
    wanted = np.concatenate(
        [whole(chain, signal)[: len(trial.decisions)] for signal, trial in zip(signals, trials.expected, strict=True)]
    )
    spread = wanted.std(axis=0)
    assert (np.abs(told - wanted).mean(axis=0) < 0.2 * spread).all()
    for alike in (chain._replace(tells_numbers=False),):
        assert np.ndim(chosen(alike, signals, state_bits=16).readout.unit) == 0


def test_the_header_names_the_numbers_and_their_units(tmp_path):
    chain, signals = telling("integrator"), [make_signal(150)]
    c_export.write(chain, tmp_path, chosen(chain, signals, state_bits=16), name="touch")
    header, code = ((tmp_path / f"touch.{end}").read_text() for end in "hc")
    assert (
        "int32_t values[TOUCH_CLASSES]; /* of touch_class_names, each times touch_value_units, in their units */"
        in header
    )
    found = re.search(r"touch_value_units\[CLASSES\] = \{ (.*) \};", code)
    assert found is not None
    assert [float(unit) for unit in found[1].split(", ")] == pytest.approx(chosen(chain, signals).readout.unit)
    c_export.write(chain, tmp_path, None, name="press")
    assert (
        "double values[PRESS_CLASSES]; /* of press_class_names, in their units */" in (tmp_path / "press.h").read_text()
    )
    c_export.write(chain._replace(tells_numbers=False), tmp_path, None, name="plain")
    assert "values[" not in (tmp_path / "plain.h").read_text()
    assert proof._values("press", tmp_path) == "3d"
    assert struct.calcsize("<7I" + proof._values("touch", tmp_path)) == 40


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of numbers, with the recordings that it was trained on."""
    folder = tmp_path_factory.mktemp("run")
    force = np.linspace(1.0, 4.0, 40)
    signals = [make_signal(130, seed=k) * np.float32(value) for k, value in enumerate(force)]
    conditions = pd.DataFrame({"label": "press", "force_N": force, "depth_mm": force**2})
    nt.save(nt.Recordings(signals, 1000.0, "mV", conditions), folder / "skin.h5")
    nt.encode_file(folder / "skin.h5", folder / "spikes.h5", settings={"conditioning.baseline": "start"})
    learn = nt.Learn(target=("force_N", "depth_mm"))
    nt.train(folder / "spikes.h5", folder / "run", settings={"hidden": 0}, window=nt.Window(length_ms=120), learn=learn)
    return folder


def test_a_run_streams_its_numbers(run):
    table = nt.infer(run / "run", run / "spikes.h5")
    stored = nt.load(run / "skin.h5")
    assert isinstance(stored, nt.Recordings)
    for trial in range(3):
        (decision,) = Stream(run / "run").push(stored.signals[trial])
        own = table[table.trial == trial].iloc[0]
        assert decision.values == {name: own[f"predicted_{name}"] for name in ("force_N", "depth_mm")}


@needs_compiler
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_a_proof_says_the_error_in_units(run, variant, tmp_path, monkeypatch):
    monkeypatch.setattr(proving.boards, "BOARDS", {})
    said = []
    nt.export_c(run / "run", tmp_path, variant=variant, prove=5, tell=said.append)
    rows = said[-1].set_index("what")["value"]
    table = nt.infer(run / "run", run / "spikes.h5", test_only=True).head(5)
    error = ((table.true_depth_mm - table.predicted_depth_mm) ** 2).mean() ** 0.5
    told = rows["root-mean-square error of depth_mm on windows as in training"]
    assert told == pytest.approx(error, rel=1e-5 if variant == "float" else 0.1)


def test_nir_holds_the_numbers(run):
    found = nt.from_nir(nt.to_nir(run / "run", network_only=True))
    network, again = nt.load_network(run / "run"), found.network
    spikes = (torch.rand(4, 120, network.n_inputs, generator=torch.Generator().manual_seed(0)) < 0.2).to(torch.uint8)
    assert torch.equal(again.infer(spikes).readout, network.infer(spikes).readout)
    assert found.classes == ("force_N", "depth_mm")


def test_streams_and_nir_take_the_rule_of_a_run(run, tmp_path):
    shutil.copytree(run / "run", tmp_path / "run")
    table = read_json(tmp_path / "run" / "network.json")
    table["extra"] |= {"exit_patience": 3, "exit_band": [0.5, 2.0], "exit_losses": {"0": 0.0, "1": 0.0}}
    (tmp_path / "run" / "network.json").write_text(json.dumps(table))
    rule = ExitRule(3, from_first_spike=True, band=(0.5, 2.0))
    assert nt.from_nir(nt.to_nir(tmp_path / "run", network_only=True)).rule == rule
    stored, own = nt.load(run / "skin.h5"), nt.infer(tmp_path / "run", run / "spikes.h5", early_exit=True)
    assert isinstance(stored, nt.Recordings)
    decided = [Stream(tmp_path / "run").push(signal)[0] for signal in stored.signals[:5]]
    assert [d.steps for d in decided] == own["steps"].tolist()[:5]
    assert [d.values["force_N"] for d in decided if d.values] == own["predicted_force_N"].tolist()[:5]
    assert len({d.steps for d in decided}) > 1


@pytest.mark.parametrize(("band", "said"), [([0.5], "has 1 value"), ([0.5, 2.0, 1.0], "has 3 values")])
def test_a_band_of_another_length_is_refused(band, said, run, tmp_path):
    shutil.copytree(run / "run", tmp_path / "run")
    path, said = tmp_path / "run" / "network.json", f"exit_band: {said}, but the network tells 2 numbers; write"
    table = read_json(path)
    table["extra"] |= {"exit_patience": 3, "exit_band": band}
    path.write_text(json.dumps(table))
    done = typed("infer", tmp_path / "run", run / "spikes.h5", "--early-exit")
    assert done.code == 2
    assert said in done.err
    assert len(done.err.splitlines()) == 1
    graph = nt.to_nir(run / "run", network_only=True)
    graph.metadata["neurotact"] = json.dumps(json.loads(graph.metadata["neurotact"]) | {"exit_band": band})
    with pytest.raises(InputError, match=said):
        nt.from_nir(graph)


def test_targets_of_another_number_are_refused(run, tmp_path):
    shutil.copytree(run / "run", tmp_path / "run")
    path = tmp_path / "run" / "network.json"
    table = read_json(path)
    table["extra"]["task"]["target"], table["extra"]["exit_band"] = ["force_N"], []
    path.write_text(json.dumps(table))
    with pytest.raises(
        InputError, match="names 1 number, but the network has 2; make the network with neurotact train"
    ):
        run_folder.restore(tmp_path / "run")


@pytest.mark.parametrize(
    "use",
    [lambda run: nt.live(run / "run", run / "skin.h5"), lambda run: nt.export(run / "run", run / "chip", "xyloaudio2")],
)
def test_what_decides_classes_refuses_numbers(run, use):
    with pytest.raises(InputError, match="tells numbers"):
        use(run)
