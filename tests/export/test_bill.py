"""The bill of a decision: opponents in C decide as in Python, and what is counted is what is run."""

import shutil
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from made_chains import make_chain, make_run, make_signal
from neurotact_parts.exporters.c import bill, boards, opponents, proof
from neurotact_parts.exporters.c.formats import Raw
from neurotact_parts.exporters.c.opponents import Standard
from neurotact_parts.exporters.c.proving import twin_of
from neurotact_parts.opponents import minirocket
from neurotact_parts.streams.stream import Stream
from sklearn.linear_model import Ridge
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.tree import DecisionTreeClassifier

import neurotact as nt
from neurotact.baselines.opponent import load
from neurotact.errors import InputError

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason=str(proof.missing("cc")))
ABSENT = proof.missing(*bill.TOOLS)
needs_board = pytest.mark.skipif(ABSENT is not None, reason=str(ABSENT))
SETTINGS = {
    "logistic regression": {},
    "SVM": {"gamma": 0.05},
    "ELM": {"hidden": 15, "random_state": 0},
    "extra trees": {"n_estimators": 12, "min_samples_leaf": 2, "random_state": 0},
    "kNN": {"n_neighbors": 3},
    "GRU": {"hidden": 12, "epochs": 40, "learning_rate": 0.02, "random_state": 0},
    "MiniRocket": {"features": 2 * 84, "random_state": 0},
}
ROCKET = bill.ROCKET
RAW = Raw(2e-4, 1.8)
"""Samples of a sensor with a large level, whose sums in float would lose what tells the classes apart."""


def made(name: str, n_classes: int, n_samples: int = 23, n_bins: int = 5):
    """An opponent on made windows of two taxels, with what `opponents.write` takes, the samples and its decisions."""
    rng = np.random.default_rng(n_classes)
    labels = np.arange(60) % n_classes
    course = np.outer(np.arange(n_classes) - 1.0, np.linspace(0, 1, n_samples))[labels]
    samples = 1.8 + 3e-3 * (course[:, :, None] + rng.normal(size=(60, n_samples, 2)))
    given = RAW.samples(samples)
    signals = given * RAW.lsb + RAW.zero
    opponent = load(name)
    standard = Standard.of(signals[:40], n_bins, is_sequence=opponent.takes != "features")
    inputs = standard.input(signals)
    fitted = opponent.build(**SETTINGS[name]).fit(inputs[:40], labels[:40])
    classes = [f"P{k}" for k in range(n_classes)]
    return (fitted, standard, RAW, classes, n_samples), list(given), fitted.predict(inputs)


@needs_compiler
@pytest.mark.parametrize("n_classes", [2, 5])
@pytest.mark.parametrize(
    ("name", "n_bins"), [*((name, 5) for name in SETTINGS if name != ROCKET), (ROCKET, 23), (ROCKET, 11)]
)
def test_an_opponent_in_c_decides_as_in_python(name, n_bins, n_classes, tmp_path):
    """Of 23 samples in 11 time bins, the bins differ in length."""
    parts, given, expected = made(name, n_classes, n_bins=n_bins)
    opponents.write(*parts, tmp_path)
    windows = [np.concatenate(given[:7]), *given[7:]]  # windows follow each other
    said = proof.on_host(tmp_path, "touch", windows, flags=proof.SANITIZERS)
    assert [row[-1] for spoken in said for row in spoken.decisions] == expected.tolist()
    assert [row[0] for row in said[0].decisions] == [*range(7)]
    assert len(np.unique(expected)) == n_classes


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            {0: DecisionTreeClassifier().fit([[0], [1]], [0, 1])},
            "DecisionTreeClassifier has no C here; choose among P",
        ),
        ({0: Ridge()}, "Ridge tells numbers, and opponents have C for classes alone; export the network"),
        ({0: make_pipeline(Ridge()).fit([[0], [1]], [0, 1])}, "Pipeline tells numbers, and opponents have C for"),
        ({3: ["a", "b", "c"]}, "knows 2 of 3 classes"),
        ({4: 2**19}, "windows: have 524288 samples, of which a sum may exceed 32 bits"),
    ],
)
def test_what_has_no_c_is_refused(change, why, tmp_path):
    parts: list[Any] = list(made("kNN", 2)[0])
    for index, value in change.items():
        parts[index] = value
    with pytest.raises(InputError, match=why):
        opponents.write(*tuple[Any, Any, Any, Any, Any](parts), tmp_path)


def test_an_elm_of_other_neurons_is_refused(tmp_path):
    parts, _, _ = made("ELM", 2)
    parts[0].activation = "relu"
    with pytest.raises(InputError, match="an ELM of relu neurons has no C here"):
        opponents.write(*parts, tmp_path)


@pytest.mark.parametrize(("is_sequence", "axes"), [(False, 0), (True, (0, 1))])
def test_a_sequence_has_one_scale_of_a_taxel_and_features_have_their_own(is_sequence, axes):
    samples = np.random.default_rng(0).normal(size=(50, 21, 3)) * np.linspace(1, 9, 21)[:, None] + 4.0
    samples[:, :, 2] = 7.0  # a dead taxel
    standard = opponents.Standard.of(samples, 7, is_sequence=is_sequence)
    made = standard.input(samples).reshape(50, 7, 3)
    assert made.mean(axis=axes) == pytest.approx(np.zeros(made.mean(axis=axes).shape), abs=1e-12)
    assert made[:, :, :2].std(axis=axes) == pytest.approx(np.ones(made[:, :, :2].std(axis=axes).shape))
    assert (standard.scale[:, 2] == 1).all()
    assert standard.input(samples).ndim == (3 if is_sequence else 2)


@needs_board
def test_instructions_grow_with_the_model_also_beyond_a_timer_of_24_bits(tmp_path):
    parts, given, _ = made("kNN", 2)
    spent = []
    for n in (500, 1000, 2000):
        x = np.random.default_rng(0).normal(size=(n, parts[1].mean.size))
        opponents.write(KNeighborsClassifier(1).fit(x, np.arange(n) % 2), *parts[1:], tmp_path)
        _, ticks = proof.on_board(tmp_path, "touch", given[:1], boards.ROOMY["cortex-m0"], counting=True)
        assert len(ticks.of[0]) == len(given[0])
        assert ticks.of[0][:-1].max() < 200  # a sample is added to the sums, and no more
        spent.append(ticks.total)
    assert spent[2] - spent[1] == pytest.approx(2 * (spent[1] - spent[0]), rel=0.05)
    assert spent[2] > 2**24 / 25.6


@needs_board
def test_a_bill_of_a_run_has_each_on_both_processors(tmp_path, monkeypatch):
    monkeypatch.setattr(bill.classifiers, "joined", lambda takes, level: ["logistic regression"])
    monkeypatch.setattr(bill, "SLOW", (ROCKET,))
    monkeypatch.setattr(minirocket, "FEATURES", 84)
    run, told = make_run(tmp_path, 30) / "run", []
    table = nt.export(run, tmp_path / "bill", "bill", tell=told.append)
    counted = table.set_index(["what", "processor"])
    every = [bill.INTEGERS, bill.ENCODING, bill.FLOATS, "logistic regression", "kNN", ROCKET]
    assert [*counted.index.unique("what")] == every
    assert (table["as_in_python"] == table["decisions"]).all()
    assert (table.loc[table["what"] != bill.ENCODING, "decisions"] > 2).all()
    m0, m4 = (counted.xs(name, level="processor")["instructions"] for name in ("Cortex-M0", "Cortex-M4F"))
    assert (m0 > m4).all()  # which has all instructions of the other and more
    assert m0[bill.ENCODING] < m0[bill.INTEGERS] < m0[bill.FLOATS]
    assert table["fits"].all()
    assert pd.read_csv(tmp_path / "bill" / "bill.csv").shape == table.shape
    assert len(told) == len(every) + 2
    assert told[-1].startswith("On an emulated Cortex-M4F the network in integers takes ")
    assert (tmp_path / "bill" / "bill.txt").read_text().splitlines() == told[-2:]
    with pytest.raises(InputError, match=r"bill\.csv: already exists"):
        nt.export(run, tmp_path / "bill", "bill")


@needs_board
def test_a_program_that_no_machine_holds_is_not_run(tmp_path, monkeypatch):
    parts, given, expected = made("SVM", 2)
    opponents.write(*parts, tmp_path)
    windows = [(i, 0, len(one)) for i, one in enumerate(given)]
    program = bill.Program("SVM", tmp_path, 1.0, 10.0, given, windows, expected)
    assert bill._row(program, "cortex-m4")["as_in_python"] == 60
    begun = program._replace(windows=[(0, 0, 3)], decided=np.array([]))
    assert bill._row(begun, "cortex-m4")["instructions"] < 3 * 100  # three samples are added up, nothing is decided
    narrow = boards.ROOMY["cortex-m4"]._replace(chip=boards.ROOMY["cortex-m4"].chip._replace(flash=2048))
    monkeypatch.setitem(boards.ROOMY, "cortex-m4", narrow)
    row = bill._row(program, "cortex-m4")
    assert row["instructions"] > 0
    assert not row["fits"]
    assert np.isnan(bill._row(program._replace(fits_only=True), "cortex-m4")["instructions"])
    small = boards.ROOMY["cortex-m4"]._replace(flash=2048)
    monkeypatch.setitem(boards.ROOMY, "cortex-m4", small._replace(chip=small.chip._replace(flash=2048)))
    row = bill._row(program, "cortex-m4")
    assert np.isnan(row["instructions"])
    assert not row["fits"]
    assert row["flash_bytes"] > 2048


def test_what_is_not_installed_is_named_with_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda tool: None)
    with pytest.raises(
        InputError, match=r"^bill: arm-none-eabi-gcc, .*qemu-system-arm is not installed; .*apt install"
    ):
        nt.export("run", tmp_path / "bill", "bill")


def test_a_run_of_events_has_no_bill(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda tool: tool)
    restored = SimpleNamespace(encoder={}, of_classes=lambda what: restored)
    monkeypatch.setattr(bill.fitted, "restore", lambda run, spikes: restored)
    with pytest.raises(InputError, match=r"^run: was trained on the events of a sensor; a bill needs signals"):
        nt.export("run", tmp_path / "bill", "bill")


def test_a_window_has_the_samples_that_its_opponents_get():
    """35.6 Hz under a clock of 1 kHz, and 2 kHz under one of 200 Hz; none is beyond the trial's end."""
    assert bill._samples(1000, 1000, 0.0356, 500) == (36, 72)
    assert bill._samples(200, 800, 10.0, 9990) == (2000, 9990)


@pytest.mark.parametrize("rate_Hz", [1000.0, 250.0, 2000.0])
def test_an_early_decision_is_billed_up_to_the_sample_that_decides_it(rate_Hz):
    """As the ledger counts its steps, also where a sample is several steps, or a step several samples."""
    chain = make_chain({"baseline": "start", "resample_Hz": 1000.0}, rate_Hz=rate_Hz, patience=5)
    signals = [make_signal(int(0.15 * rate_Hz), seed=k) for k in range(3)]
    twin = twin_of(chain, None, signals, np.zeros(3, int), None)
    given, windows, _ = bill._of_chain(chain, twin)
    for (trial, first, last), row in zip(windows, [row for one in twin.expected for row in one.decisions], strict=True):
        stream = Stream(chain)
        stream.push(given[trial][: last - 1])
        before = [decision.window for decision in stream.push(given[trial][last - 1 : last])]
        assert row[0] in before or last == first + int(40 * rate_Hz / 1000)
    assert min(last - first for _, first, last in windows) < 30 * rate_Hz / 1000


def test_a_line_says_what_has_no_room_and_what_python_decides_otherwise():
    row = {"what": "SVM", "processor": "M0", "instructions": 1234.4, "decisions": 20, "as_in_python": 20}
    assert bill._line([row]) == "SVM: instructions a decision 1,234 on M0"
    said = bill._line([row | {"as_in_python": 19}, row | {"processor": "M4", "instructions": np.nan}])
    assert said.startswith("SVM: instructions a decision 1,234 on M0, M4 has no room; 1 of 20 decisions are not those")


def test_a_summary_names_the_cheapest_and_the_order_of_the_ledger():
    rows = [
        (bill.INTEGERS, 800.0, 100.0), (bill.FLOATS, 9000.0, 100.0), (bill.ENCODING, 1.0, 900.0),
        ("SVM", 400.0, 200.0), ("ELM", 200.0, 20.0), ("kNN", np.nan, 1.0),
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["what", "instructions", "ledger_flops"]).assign(processor="Cortex-M0")
    (line,) = bill.summary(table)
    assert line == (
        "On an emulated Cortex-M0 the network in integers takes 4 times the instructions of ELM, the cheapest "
        "opponent; rank correlation with the ledger's FLOPs 0.50, 2 to 10 instructions per FLOP."
    )
    assert [*bill.summary(table[:3])] == []


@pytest.mark.parametrize("name", boards.ROOMY)
def test_a_timer_holds_a_decision_of_two_thousand_million_instructions(name):
    board = boards.ROOMY[name]
    assert 2**32 / (board.clock_Hz * 2**board.shift * 1e-9) > 2e9
