"""The Braille-reading study: data as published, a row per training, the epoch chosen by the letters that it says."""

import numpy as np
import pytest
from neurotact_parts.studies.braille import protocol
from neurotact_parts.studies.braille.protocol import BrailleData, Parameters

from neurotact.errors import InputError
from neurotact.spec import build

LETTERS, EACH = ("A", "B", "Space"), 20


@pytest.fixture(scope="module")
def arrays(tmp_path_factory):
    """Letters whose events lie on taxels of their own, with a slip now and then."""
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("letters") / "events.npz"
    rows = []
    for number in range(len(LETTERS) * EACH):
        for _ in range(12):
            taxel = rng.integers(12) if rng.random() < 0.2 else number // EACH
            rows.append((number, taxel, rng.integers(2), rng.uniform(0, 0.25)))
    recording, taxel, polarity, time_s = (np.array(column) for column in zip(*rows, strict=True))
    np.savez(
        path, letter=np.repeat(LETTERS, EACH), event_recording=recording, event_taxel=taxel,
        event_polarity=polarity, event_time_s=time_s,
    )  # fmt: skip
    return protocol.load(BrailleData(path=str(path), length_ms=270.0))


def parameters(**changes) -> Parameters:
    training = {"epochs": 12, "patience": 12, "batch": 16, "keep": "accuracy", "optimiser": "Adamax"}
    training["learning_rate"] = 0.01
    network = {"hidden": 12, "tau_mem_ms": 70, "tau_syn_ms": 7, "training": training}
    return build(Parameters, {"network": network, "outputs": 4, **changes}, source="test")


def test_letters_last_as_long_as_published(arrays):
    assert arrays["spikes"].shape == (60, 54, 24)
    assert np.bincount(arrays["labels"]).tolist() == [EACH] * 3


def test_published_chooses_on_test_letters_and_honest_on_others(arrays):
    labels = arrays["labels"]
    for how in ("published", "honest"):
        train, chosen_on, test = (set(side.tolist()) for side in protocol.sides_of(labels, how))
        assert len(test) == 12
        assert not train & test
        assert not train & chosen_on
        assert (chosen_on == test) == (how == "published")
        assert len(train | chosen_on | test) == len(labels)


def test_a_training_is_a_row(arrays):
    for how in ("published", "honest"):
        (row,) = protocol.run(parameters(protocol=how), arrays)
        assert row["accuracy_test"] >= 0.75  # one in three by chance
        assert row["n_test"] == 12
        assert row["n_train"] == (48 if how == "published" else 42)
        assert row["epochs"] == 12
        if how == "published":  # the best of all epochs, the last one among them
            assert row["accuracy_test"] >= row["accuracy_last"]


def test_copies_hear_the_same_spikes_and_count_as_operations(arrays):
    one, two = (protocol.run(parameters(copies=n, seed=3), arrays)[0] for n in (1, 2))
    sent = arrays["spikes"][protocol.sides_of(arrays["labels"], "published")[2]].sum(axis=(1, 2)).mean()
    for copies, row in ((1, one), (2, two)):
        hidden = row["hidden_spikes"] * (12 + 4)
        assert row["sops_total"] == pytest.approx(12 * copies * sent + hidden)


def test_fewer_outputs_than_letters_are_refused(arrays):
    with pytest.raises(InputError, match="outputs: must be 3 or more"):
        protocol.run(parameters(outputs=2), arrays)
