"""What a test accuracy is compared with."""

import numpy as np
import pytest
import torch

from neurotact.networks.comparison import compare, costs, linear_accuracy, lines
from neurotact.networks.tasks import Sides
from neurotact.networks.training import Examples


def examples(labels: list[int], tells: bool, seed: int = 0) -> Examples:
    """Windows of three afferents; the label's own fires more where it `tells`."""
    rates = np.full((len(labels), 1, 3), 0.2)
    if tells:
        rates[np.arange(len(labels)), 0, labels] = 0.8
    rasters = np.random.default_rng(seed).random((len(labels), 50, 3)) < rates
    return Examples(torch.from_numpy(rasters.astype(np.uint8)), torch.tensor(labels))


@pytest.mark.parametrize("tells", [True, False])
def test_the_linear_classifier_learns_what_counts_tell(tells):
    found = linear_accuracy(examples([0, 1, 2] * 20, tells), examples([0, 1, 2] * 20, tells, seed=1))
    assert found == 1.0 if tells else found < 0.6


def test_more_than_255_spikes_are_counted():
    many = Examples(torch.ones(4, 600, 1, dtype=torch.uint8), torch.tensor([0, 1, 0, 1]))
    many.spikes[::2, :256] = 0  # which leaves as many, were counts to wrap around
    assert linear_accuracy(many, many) == 1.0


def test_chance_and_the_commonest_class_are_told():
    train, test = examples([0, 0, 0, 1, 1, 2], True), examples([0, 1, 2, 0], True)
    found = compare(0.75, Sides(train, test, test), 4, 3)
    assert found.chance == pytest.approx(1 / 3)
    assert found.commonest == 0.5
    assert found.trials == 4
    told = " ".join(lines(found))
    for words in ("accuracy 75.0 % (95 % interval 30.1 % to 95.4 %, 4 test trials)", "chance 33.3 %"):
        assert words in told


def test_the_spikes_of_every_population_are_counted():
    row = {"sops_total": 10.0, "window_steps": 100, "spikes_on": 3.0, "spikes_off": 4.0, "spikes_afferents": 5.0}
    early = {"exit_sops_total": 5.0, "exit_steps": 50.0, "exit_accuracy": 0.5}
    assert "12 input spikes" in costs({**row, **early}, 1.0)
