"""The networks on images of the touch-modality paper: what they see, learn and cost, and that no test touch leaks."""

import numpy as np
import pandas as pd
import pytest
import torch
from neurotact_parts.studies.touch_modality import images
from neurotact_parts.studies.touch_modality.images import Parameters, convolutions, random_cnn
from neurotact_parts.studies.touch_modality.touches import TouchData, folds_of

from neurotact.errors import InputError
from neurotact.figures.style import save
from neurotact.metrics.flops import cost
from neurotact.spec import build

CLASSES = ("brushing", "rolling", "sliding")
SMALL = {"epochs": 3, "batch": 4, "folds": 1, "protocol": "paper"}


@pytest.fixture
def arrays():
    """Five touches of each class, which differ in the level of all taxels; two people."""
    rng = np.random.default_rng(0)
    labels = np.repeat(CLASSES, 5)
    level = np.repeat([-1.0, 0.0, 1.0], 5)[:, None, None]
    return {
        "patterns": (level + rng.normal(0, 0.1, (15, 6144, 16))).astype(np.float32),
        "labels": labels,
        "persons": np.tile([0, 1, 0, 1, 0], 3),
        "classes": np.array(CLASSES),
        "shown": np.array([0, 5, 10]),
        "sampling_rate_Hz": np.array(3000.0),
    }


@pytest.mark.parametrize("network", ["GRU", "CNN-LSTM"])
def test_touches_of_other_levels_are_told_apart(network, arrays):
    asked = build(Parameters, {**SMALL, "network": network, "epochs": 40}, source="test")
    (row,) = images.run(asked, arrays)
    assert row["accuracy_test"] == 1
    assert (row["patterns_train"], row["patterns_test"]) == (12, 3)


def test_a_conv_lstm_trains_on_images(arrays, monkeypatch):
    monkeypatch.setattr(images, "FILTERS", 2)
    asked = build(Parameters, {**SMALL, "network": "ConvLSTM", "epochs": 1}, source="test")
    (row,) = images.run(asked, arrays)
    assert 0 <= row["accuracy_test"] <= 1
    assert row["parameters_trained"] == row["parameters"] == 4 * 2 * 3 * 9 + 8 + (62 * 62 * 2 + 1) * 100 + 101 * 3


def test_the_published_conv_lstm_has_twelve_million_parameters():
    layers = images.NETWORKS["ConvLSTM"].layers(Parameters(), None, 3)
    assert cost(*layers).parameters == 4 * 32 * (1 + 32) * 9 + 4 * 32 + (62 * 62 * 32 + 1) * 100 + 101 * 3 == 12_339_347


def test_test_touches_do_not_change_the_training(arrays):
    asked = build(Parameters, {**SMALL, "network": "GRU"}, source="test")
    (before,) = images.run(asked, arrays)
    (fold,) = folds_of(asked.protocol, asked.data, arrays, asked.seed)[:1]
    patterns = arrays["patterns"].copy()
    patterns[fold.test] = 1e3
    (after,) = images.run(asked, {**arrays, "patterns": patterns})
    assert after["accuracy_train"] == before["accuracy_train"]


def test_each_fold_is_a_row_and_each_run_counts(arrays):
    asked = build(Parameters, {**SMALL, "network": "GRU", "folds": 2, "runs": 2, "epochs": 1}, source="test")
    rows = images.run(asked, arrays)
    assert [row["fold"] for row in rows] == [0, 1]
    once = images.run(asked.model_copy(update={"runs": 1}), arrays)
    assert [row["accuracy_train"] for row in rows] != [row["accuracy_train"] for row in once]


def test_convolutions_are_counted_by_hand():
    spent = cost(*convolutions(random_cnn(0)))
    assert spent.macs == 32 * 32 * 16 * 27 + 16 * 16 * 32 * 144 + 8 * 8 * 64 * 288 + 4 * 4 * 128 * 576
    grouped = torch.nn.Conv2d(3, 6, 3, stride=2, padding=1, groups=3)
    assert cost(*convolutions(grouped)).macs == 32 * 32 * 6 * 9


def test_a_random_cnn_depends_on_its_seed_alone():
    image = torch.ones(1, 3, 64, 64)
    first, again, other = (random_cnn(seed)(image) for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_trained_networks_need_their_weights(arrays):
    asked = build(Parameters, {**SMALL, "network": "CNN-LSTM", "cnn": "resnet50"}, source="test")
    with pytest.raises(InputError, match="weights: name a local safetensors file"):
        images.run(asked, arrays)


def test_what_is_loaded_can_be_drawn(arrays, tmp_path):
    loaded = images.load(TouchData.model_validate({"simulation": {"people": 1}}))
    assert loaded["patterns"].shape[1:] == (6144, 16)
    assert loaded["labels"][loaded["shown"]].tolist() == loaded["classes"].tolist()
    asked = build(Parameters, {**SMALL, "network": "GRU", "epochs": 1}, source="test")
    results = pd.DataFrame([{"network": "GRU", "protocol": "paper", **row} for row in images.run(asked, arrays)])
    for drawn in images.draw(results, arrays):
        save(drawn.figure, tmp_path / f"{drawn.name}.png")
        assert drawn.alt
