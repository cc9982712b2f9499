"""A device learns a class from a few touches as `neurotact learn` does, to the last bit of float32 or the next."""

import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from driven import write_program
from neurotact_parts.exporters.c import boards, c_export, export, learning, proof, proving
from neurotact_parts.exporters.c.boards import Board
from neurotact_parts.networks import new_class

import neurotact as nt
from neurotact.baselines.opponent import part_of
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import run_folder
from neurotact.networks.training.sparsity import prune

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason="there is no C compiler")
ABSENT = proof.missing("arm-none-eabi-gcc", "qemu-system-arm")
NETWORK = {"hidden": 6, "readout": "integrator", "training.epochs": 2, "forward_weight_scale": 3.0, "recipe": None}
KINDS = {
    "plain": NETWORK,
    "stretches": {**NETWORK, "readout_stretches": 3, "readout_stretch_ms": 17.0},
    "past the hidden layer": {**NETWORK, "direct": True, "readout_stretches": 2, "readout_stretch_ms": 30.0},
    "slow clock": {**NETWORK, "step_ms": 3.0},
    "no hidden layer": {"hidden": 0, "readout": "integrator", "recipe": None},
}
NAMES = tuple(f"taxel{k}" for k in range(5))
BUSY = {"felt": (0, 1), "silk": (1, 2), "tweed": (2, 4), "wool": (2, 3)}
WINDOW = nt.Window(length_ms=50)
WORDS = {
    "event": "E",
    "time": "T",
    "learn": "L",
    "reset": "R",
    "forget": "F",
    "weights": "W",
    "counts": "C",
    "end": "Q",
}


def rasters_of(labels: list[str], seed: int) -> np.ndarray:
    """Spikes of five afferents `(touch, time, afferent)`, of which each class makes two busy."""
    rng = np.random.default_rng(seed)
    rasters = (rng.random((len(labels), 50, 5)) < 0.05).astype(np.uint8)
    for raster, label in zip(rasters, labels, strict=True):
        raster[:, BUSY[label]] |= (rng.random((50, 2)) < 0.25).astype(np.uint8)
    return rasters


def touches(labels: list[str], seed: int) -> nt.SpikeTrains:
    return from_rasters(rasters_of(labels, seed), 1000.0, NAMES, pd.DataFrame({"label": labels}))


NEW = ["wool", "tweed"] * 9


@pytest.fixture(scope="module")
def taught(tmp_path_factory):
    """For a kind: its folder, with a run, what it became by `nt.learn`, and new touches."""
    made: dict[str, Path] = {}

    def of(kind: str) -> Path:
        if kind not in made:
            folder = made[kind] = tmp_path_factory.mktemp("taught")
            nt.save(touches(["felt", "silk"] * 40, 0), folder / "spikes.h5")
            nt.save(touches(NEW, 1), folder / "new.h5")
            nt.train(folder / "spikes.h5", folder / "run", "rsnn", KINDS[kind], window=WINDOW)
            nt.learn(folder / "run", folder / "new.h5", folder / "learned")
        return made[kind]

    return of


class Learner:
    """A run that learns in C, compiled; and its answers to records."""

    def __init__(
        self, run: Path, folder: Path, board: Board | None = None, n_new: int = 2, hop_ms: float | None = None
    ) -> None:
        made = export.prepared(run, integer=False, streamed=nt.Streamed(hop_ms=hop_ms))
        self.able = learning.teachable(run_folder.restore(run), made.chain, n_new)
        context = self.able.context()
        self.shape = context["n_features"], context["n_classes"]
        c_export.write(self.able.chain, folder, None, name="skin", parts=c_export.HARNESS, taught=context)
        write_program(folder, (Path(__file__).parent / "learner.c").read_text())
        watched = {"skin_on_spikes": "const uint8_t *", "skin_on_hidden": "uint32_t, const uint8_t *"}
        with (folder / "harness.c").open("a") as file:
            for name, of in watched.items():
                last = of.split(", ")
                given = ", ".join(f"{kind} a{i}" for i, kind in enumerate([*last, "int"]))
                used = " ".join(f"(void)a{i};" for i in range(len(last) + 1))
                file.write(f"void {name}({given});\nvoid {name}({given}) {{ {used} }}\n")
        self.board = board
        flags = {"flags": proof.SANITIZERS}
        self.program = (
            proof.built_here(folder, "skin", **flags)
            if board is None
            else proof.build(folder, "skin", board, watched=True)
        )

    def answers(self, records: list[tuple]) -> tuple[list[tuple[int, ...]], list[tuple[np.ndarray, np.ndarray]]]:
        """Decisions as D, label and hidden spikes; what is learned as L, 0 or 1, and known classes; and readouts."""
        rows = [(ord(WORDS[what]), *given, *([0] * (2 - len(given)))) for what, *given in [*records, ("end",)]]
        data = np.array(rows, np.uint32).tobytes()
        output = proof.run(self.program, data) if self.board is None else proof.emulate(self.program, data, self.board)
        told, readouts, at = [], [], 0
        n_features, n_classes = self.shape
        n_weights = 4 * n_features * n_classes
        wanted = [what for what, *_ in records if what == "weights"]
        while at < len(output):
            row = np.frombuffer(output, "<u4", 3, at) if len(output) - at >= 12 else np.zeros(3)
            if row[0] in (ord("D"), ord("L"), ord("C")):
                told.append((chr(row[0]), int(row[1]), int(row[2])))
                at += 12
                continue
            assert len(readouts) < len(wanted)
            weights = np.frombuffer(output, "<f4", n_features * n_classes, at).reshape(n_features, n_classes)
            readouts.append((weights, np.frombuffer(output, "<f8", n_classes, at + n_weights)))
            at += n_weights + 8 * n_classes
        return told, readouts


def touched(raster: np.ndarray) -> list[tuple]:
    """A touch by itself."""
    return [("reset",), *(("event", int(t), int(k)) for t, k in zip(*np.nonzero(raster), strict=True)), ("time", 50)]


def lesson(n: int = 5) -> list[tuple]:
    """The touches that `nt.learn` learns of the new file: of each class in the order of names."""
    records, rasters = [], rasters_of(NEW, 1)
    for label, name in enumerate(["tweed", "wool"], start=2):
        own = np.flatnonzero(np.array(NEW) == name)
        for trial in own[part_of(np.zeros(len(own)), n)]:
            records += [*touched(rasters[trial]), ("learn", label, n)]
    return records


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How many float32 values lie between two, each."""
    as_ordered = [
        np.where(v.view(np.int32) < 0, -(v.view(np.int32) & 0x7FFFFFFF), v.view(np.int32)) for v in (one, other)
    ]
    return np.abs(as_ordered[0].astype(np.int64) - as_ordered[1])


@needs_compiler
@pytest.mark.filterwarnings("ignore:training. .*input spikes")  # of the slow clock
@pytest.mark.parametrize("kind", [*KINDS])
def test_a_device_learns_what_learn_learns(kind, taught, tmp_path):
    folder = taught(kind)
    device = Learner(folder / "run", tmp_path)
    after, _ = run_folder.load_network(folder / "learned")
    assert isinstance(after, nt.RSNN)
    assert after.bias is not None
    others = rasters_of(["felt", "silk", "tweed", "wool"] * 6, 7)
    records = [*lesson(), ("weights",), *(record for raster in others for record in touched(raster))]
    told, [(weights, bias)] = device.answers(records)
    expected = after.readout_weights.detach().numpy().reshape(weights.shape)
    far = [apart(weights, expected), apart(bias.astype(np.float32), after.bias.detach().numpy())]
    # Both compute in float64, in another order: what is near the middle of two float32 may be rounded to either.
    assert max(each.max() for each in far) <= 1
    assert np.mean(np.concatenate([each.ravel() for each in far]) == 0) > 0.97
    assert [row for row in told if row[0] == "L"] == [("L", 1, 3)] * 5 + [("L", 1, 4)] * 5
    found = after.infer(torch.from_numpy(others))
    assert [row[1:] for row in told[-len(others) :]] == [
        *zip(found.labels.tolist(), found.hidden_spikes.tolist(), strict=True)
    ]
    assert len({row[1] for row in told[-len(others) :]}) > 2


@pytest.mark.skipif(ABSENT is not None, reason=str(ABSENT))
def test_an_emulated_cortex_m0_learns_the_same(taught, tmp_path):
    folder = taught("stretches")
    records = [*lesson(), ("weights",), *touched(rasters_of(["wool"], 3)[0])]
    (tmp_path / "here").mkdir()
    told, [(weights, bias)] = Learner(folder / "run", tmp_path / "here").answers(records)
    board = boards.BOARDS["cortex-m0"]
    emulated = Learner(folder / "run", tmp_path, board)
    said, [other] = emulated.answers(records)
    proof.footprint(tmp_path, "skin", board)
    kept = subprocess.run(["arm-none-eabi-nm", tmp_path / "skin-whole.o"], capture_output=True, text=True, check=True)
    assert {"skin_learn", "skin_forget", "first_inverse"} <= {line.split()[-1] for line in kept.stdout.splitlines()}
    assert said == told
    assert (weights == other[0]).all()
    assert (bias == other[1]).all()


@pytest.fixture(scope="module")
def device(taught, tmp_path_factory):
    return Learner(taught("stretches") / "run", tmp_path_factory.mktemp("device"))


TOUCH = touched(rasters_of(["wool"], 5)[0])


@needs_compiler
def test_a_touch_is_learned_once_and_of_a_class_that_is_known_or_next(device):
    untouched = [("learn", 2, 5), *TOUCH[:-1], ("time", 49), ("learn", 2, 5), ("time", 50)]
    refused = [("learn", 3, 5), ("learn", 2, 0)]
    learned = [("learn", 2, 5), ("learn", 2, 5), *TOUCH, ("learn", 0, 5), *TOUCH, ("learn", 3, 1)]
    full = [*TOUCH, ("learn", 4, 1), *TOUCH, ("learn", 255, 1), *TOUCH, ("reset",), ("learn", 0, 1)]
    told, _ = device.answers([*untouched, *refused, *learned, *full])
    answers = [row[1:] for row in told if row[0] == "L"]
    assert answers == [(0, 2), (0, 2), (0, 2), (0, 2), (1, 3), (0, 3), (1, 3), (1, 4), (0, 4), (0, 4), (0, 4)]


@needs_compiler
def test_what_is_forgotten_is_the_lesson_and_nothing_else(device):
    told, [first, once, forgotten, again] = device.answers(
        [("weights",), *lesson(), ("weights",), ("forget",), ("weights",), *lesson(), ("weights",)]
    )
    known = 2
    for one, other in ((first, forgotten), (once, again)):
        n = known if one is first else None
        assert (one[0][:, :n] == other[0][:, :n]).all()
        assert (one[1][:n] == other[1][:n]).all()
    network = device.able.chain.network
    assert (first[0][:, :known] == network.readout_weights.detach().numpy().reshape(-1, known)).all()
    assert (once[0][:, :known] != first[0][:, :known]).any()
    assert [row[2] for row in told if row[0] == "L"] == [3] * 5 + [4] * 5 + [3] * 5 + [4] * 5


@needs_compiler
def test_a_known_class_learns_too_and_the_others_move(device):
    _, [before, after] = device.answers([("weights",), *TOUCH, ("learn", 0, 1), ("weights",)])
    readout = device.able.readout
    counts = new_class.features_of(device.able.chain.network, torch.from_numpy(rasters_of(["wool"], 5)))[0]
    expected = readout.after(counts, 0, readout.each).weights
    assert np.abs(after[0][:, :2] - expected[:-1]).max() < 1e-6
    assert (before[0][:, 1] != after[0][:, 1]).any()


@needs_compiler
def test_windows_under_way_are_dropped_and_an_old_one_is_not_learned(taught, tmp_path):
    """Windows of 50 steps, each 20: at its end one is decided, and another begins in its place 10 steps later."""
    device = Learner(taught("stretches") / "run", tmp_path, hop_ms=20.0)
    to_60 = [record for record in TOUCH if record[0] == "event"]
    told, _ = device.answers([*to_60, ("time", 50), ("learn", 2, 5), ("time", 109), ("counts",), ("time", 110)])
    assert [row[0] for row in told] == ["D", "L", "C", "D"]  # those from 20 and 40 on are gone; that from 60 is whole
    assert told[2] == ("C", 2, 1)
    told, _ = device.answers([("reset",), *to_60, ("time", 50), ("time", 61), ("learn", 2, 5)])
    assert told[-1] == ("L", 0, 2)
    told, _ = device.answers([("reset",), *to_60, ("time", 50), ("time", 60), ("learn", 2, 5)])
    assert told[-1] == ("L", 1, 3)


@needs_compiler
def test_an_export_that_learns_is_proven_and_says_what_learning_takes(taught, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(proving.boards, "BOARDS", {})
    folder, said, rendered, written = taught("stretches"), [], c_export.rendered, []

    def spy(context, *rest):
        written.append((context["learns"], context["patience"]))
        return rendered(context, *rest)

    monkeypatch.setattr(c_export, "rendered", spy)
    how = {"variant": "float", "new_classes": 2, "force": True, "spikes": folder / "spikes.h5"}
    nt.export_c(folder / "run", tmp_path, prove=3, tell=said.append, **how)
    rows = said[-1].set_index("what")["value"]
    assert rows["this machine, sanitizers"] == "every spike and decision equal"
    assert rows["windows"] == 3
    assert written == [(True, None)] * 2
    assert said[1].startswith("learning takes 2.6 kB of RAM and 1.9 kB of flash; early exit and refusal")
    header, readme = (tmp_path / "touch.h").read_text(), (tmp_path / "README.md").read_text()
    assert "#define TOUCH_KNOWN 2 /" in header
    assert "`touch_learn(&chain, 2, 5)`" in readme
    assert '"new class 1", "new class 2"' in (tmp_path / "touch.c").read_text()
    assert not caplog.records
    small = boards.NRF51._replace(ram=2_000)
    monkeypatch.setattr(proving.boards, "BOARDS", {"small": SimpleNamespace(chip=small)})
    nt.export_c(folder / "run", tmp_path, **how)
    assert "learning takes 2.6 kB of RAM and 1.9 kB of flash, more than on nRF51822 (1 kB and 256 kB)" in caplog.text


@needs_compiler
@pytest.mark.parametrize("kind", ["plain", "stretches"])
def test_the_bytes_of_learning_are_those_of_the_struct(kind, taught, tmp_path):
    run = taught(kind) / "run"
    sizes = []
    for more in ({"new_classes": 3}, {}):
        nt.export_c(run, tmp_path / str(len(sizes)), variant="float", **more)
        (tmp_path / str(len(sizes)) / "main.c").write_text(
            '#include <stdio.h>\n#include "touch.h"\nint main(void) { printf("%zu", sizeof(touch_chain)); return 0; }'
        )
        command = ["cc", "-std=c99", "touch.c", "main.c", "-o", "main"]
        subprocess.run(command, cwd=tmp_path / str(len(sizes)), check=True)
        sizes.append(int(subprocess.run([tmp_path / str(len(sizes)) / "main"], capture_output=True, check=True).stdout))
    exiting = export.prepared(run, integer=False).chain._replace(rule=ExitRule(5, from_first_spike=True, least_lead=1))
    able = learning.teachable(run_folder.restore(run), exiting, 3)
    assert able.chain.rule == FULL_WINDOW
    grown = 3 * able.chain.windows.at_once * 4  # counts of the new classes, in each window
    assert abs(sizes[0] - sizes[1] - able.bytes()[0] - 2 * grown) < 24


def test_a_run_that_learned_a_class_learns_another_on_the_device(taught):
    learned = run_folder.restore(taught("plain") / "learned")
    able = learning.teachable(learned, export.prepared(taught("plain") / "learned", integer=False).chain, 1)
    assert able.readout.weights.shape[1] == len(learned.classes)
    torch.testing.assert_close(able.chain.network.readout_weights, learned.network.readout_weights)


def test_what_cannot_learn_is_refused(taught, tmp_path):
    folder = taught("plain")
    for change, said in (
        ({"new_classes": 1, "variant": "integer"}, "`new_classes`: has no effect without `variant='float'`"),
        ({"new_classes": 0}, "new_classes: must be at least 1; got 0"),
    ):
        with pytest.raises(InputError, match=said):
            nt.export_c(folder / "run", tmp_path / "c", **{"variant": "float", **change})
    counting = {**NETWORK, "readout": "count", "hidden": 3}
    nt.train(folder / "spikes.h5", tmp_path / "counting", "rsnn", counting, window=WINDOW)
    with pytest.raises(InputError, match="its readout is no sum of spikes"):
        nt.export_c(tmp_path / "counting", tmp_path / "c", variant="float", new_classes=1)
    restored = run_folder.restore(folder / "run")
    chain = export.prepared(folder / "run", integer=False).chain
    prune(chain.network, 0.5)
    with pytest.raises(InputError, match="new_classes: a refitted readout has every synapse"):
        learning.teachable(restored, chain, 1)
    assert not (tmp_path / "c").exists()
