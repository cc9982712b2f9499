"""A trained network is read back from its folder, and refused in one sentence where the folder is damaged."""

import contextlib
import json

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import run_folder, tasks, trainer
from neurotact.networks.training.run_folder import NETWORK

TASK = tasks.Task(window={"length_ms": 50.0})


def spikes(n_trials: int = 24) -> SpikeTrains:
    """Two classes that fire on different afferents."""
    labels = np.arange(n_trials) % 2
    rates = np.where(labels[:, None] == np.array([[0, 0, 1, 1]]), 0.3, 0.02)
    rasters = np.random.default_rng(0).random((n_trials, 60, 4)) < rates[:, None]
    names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
    return from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": [("felt", "silk")[i] for i in labels]}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a trained network."""
    run = tmp_path_factory.mktemp("trained") / "run"
    spec = RSNNSpec(hidden=5, training=TrainingSpec(epochs=2))
    fitted, _ = trainer.fit(spikes(), spec, TASK, (0, 1), backend="reference")
    run_folder.save(fitted, str(run), spikes(), str(run.parent / "spikes.h5"), TASK)
    return run


@pytest.fixture
def copied(folder, tmp_path):
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_a_folder_may_be_named_by_text(folder):
    by_text, by_path = run_folder.restore(str(folder)), run_folder.restore(folder)
    assert torch.equal(by_text.network.w_in, by_path.network.w_in)
    assert by_text[1:] == by_path[1:]
    assert by_text.classes == ("felt", "silk")
    assert by_text.spikes_path.resolve() == (folder.parent / "spikes.h5").resolve()


def rewrite(folder, **changes) -> None:
    """Change what `network.json` holds under `extra`; None removes a key."""
    table = json.loads((folder / NETWORK).read_text())
    table["extra"] = {key: value for key, value in {**table["extra"], **changes}.items() if value is not None}
    (folder / NETWORK).write_text(json.dumps(table))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        *(({key: None}, f"'{key}' is missing") for key in ("task", "classes", "spikes", "exit_patience")),
        ({"task": []}, "task: must be a"),
        ({"task": {"windw": {}}}, "task.windw: unknown key; did you mean 'window'"),
        ({"task": {"window": {"length_ms": -1}}}, "task.window.length_ms: must be > 0"),
        ({"classes": "felt"}, "classes: "),
        ({"classes": [1, 2]}, "classes.0: "),
        ({"classes": ["felt"]}, "names 1 class, but the network has 2"),
        ({"afferents": ["a"]}, r"names 1 afferent, but the network has \d+; make the network with"),
        ({"exit_band": [0.5]}, "exit_band: has 1 value, but the network tells classes; write the file again"),
        ({"exit_band": [-0.5]}, "exit_band.0: must be >= 0"),
        ({"spikes": 3}, "spikes: "),
        ({"exit_patience": 0}, "exit_patience: must be >= 1"),
        ({"exit_patience": "9"}, "exit_patience: "),
        ({"exit_patience": 10**30}, "exit_patience: must be <= "),
    ],
)
def test_a_damaged_table_is_refused(copied, changes, complaint):
    rewrite(copied, **changes)
    with pytest.raises(InputError, match=complaint) as refusal:
        run_folder.restore(copied)
    assert str(copied / NETWORK) in str(refusal.value)


JUNK = st.recursive(
    st.booleans() | st.integers() | st.just(10**400) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@given(st.sampled_from(["task", "classes", "spikes", "exit_patience", "best_epoch", "encoder"]), JUNK)
def test_junk_is_refused_or_read(copied, key, junk):
    rewrite(copied, **{key: junk})
    with contextlib.suppress(InputError):
        run_folder.restore(copied)


def test_patience_may_be_absent_as_none(copied):
    table = json.loads((copied / NETWORK).read_text())
    table["extra"]["exit_patience"] = None
    (copied / NETWORK).write_text(json.dumps(table))
    assert run_folder.restore(copied).rule.patience is None
