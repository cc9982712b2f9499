"""A study says early when its networks take minutes."""

import pytest

from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training.epochs import Epoch
from neurotact.spec import Spec
from neurotact.studies import cell
from neurotact.studies.cell import LongTraining


@pytest.fixture
def epochs(monkeypatch):
    """Call a training's `progress` after each of some epochs of so many seconds."""
    now = [100.0]
    monkeypatch.setattr(cell, "perf_counter", lambda: now[0])

    def run(n: int, seconds: float, most: int) -> None:
        progress = LongTraining(lambda: RSNNSpec(training=TrainingSpec(epochs=most)))
        for number in range(1, n + 1):
            now[0] += seconds
            progress(Epoch(number, 1.0, 0.5, 1.0, 0.5))

    return run


def test_its_part_tells_losses_and_how_many_fits_there_are_without_a_hidden_layer(monkeypatch):
    now, told = iter([0.0, 2.0, 4.0, 6.0]), []
    monkeypatch.setattr(cell, "perf_counter", lambda: next(now))
    monkeypatch.setattr(cell, "at", lambda *parts: told.append(parts))
    for spec in (RSNNSpec(training=TrainingSpec(epochs=40)), RSNNSpec(hidden=0, readout="integrator", model="snn")):
        progress = LongTraining(lambda spec=spec: spec)
        progress(Epoch(1, 1.0, 0.5, 1.0, 0.5))
        progress(Epoch(2, 0.51234, 0.5, 1.0, 0.8125))
    note = ", loss 0.512, validation 81%"
    assert told == [("train", 1, 40, note), ("train", 1, 5, note)]


def test_a_network_that_is_a_part_is_trained_whether_or_not_it_tells_its_neurons(monkeypatch, capsys):
    own = RSNNSpec(training=TrainingSpec(epochs=4000))
    own._own = Spec()  # the keys of a part that tells no neurons
    now, told = iter([0.0, 100.0]), []
    monkeypatch.setattr(cell, "perf_counter", lambda: next(now))
    monkeypatch.setattr(cell, "at", lambda *parts: told.append(parts[:3]))
    progress = LongTraining(lambda: own)
    for number in (1, 2):
        progress(Epoch(number, 1.0, 0.5, 1.0, 0.5))
    assert told == [("train", 1, 4000)]
    assert "(4000 epochs)" in capsys.readouterr().err


def test_a_network_of_minutes_is_said_once_with_what_takes_less(epochs, capsys):
    epochs(100, 0.75, 1000)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("neurotact: a network takes up to 12 min (1000 epochs); fewer taxels, shorter windows")
    assert "`settings={'network.training.epochs': 250}`" in line


@pytest.mark.parametrize(("n", "seconds", "most"), [(100, 0.75, 300), (20, 0.75, 1000), (1, 50.0, 1000)])
def test_nothing_is_said_of_shorter_ones_or_before_it_is_known(epochs, capsys, n, seconds, most):
    epochs(n, seconds, most)
    assert capsys.readouterr().err == ""
