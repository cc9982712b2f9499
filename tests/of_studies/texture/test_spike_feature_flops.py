"""The costs of spike features, counted by hand, and spikes that are counted where they are used."""

import pytest
from neurotact_parts.studies.texture import spike_feature_flops as layers

from neurotact.errors import InputError
from neurotact.metrics.flops import Layer, cost
from neurotact.metrics.prices import price_list

EVERY = [
    layers.Rates(2, 10),
    layers.Intervals(2, 10),
    layers.BinFanoFactors(2, 10, bins=5),
    layers.CoOccurrences(2, 10, pairs=7),
    layers.DelayedTraces(2, 10, steps=100, delays=3),
    layers.GreyImages(2, 10, columns=4),
    layers.VanRossum(2, 10, steps=100, references=3, reference_spikes=30),
    layers.VictorPurpura(2, 10, references=3, reference_spikes=30, pairs=150),
    layers.NearestOf(5, 3),
]


def test_by_hand():
    counted = [layer.cost() for layer in EVERY]
    assert [(c.macs, c.acs, c.other_flops) for c in counted] == [
        (0, 10, 2),  # a count a spike, a product an afferent
        (12, 20, 24),  # 10 squares and a mean square each; difference and sum a spike; two divisions and a root each
        (12, 10, 10),  # 5 bins and a mean square each; a count a spike; a product and a division each
        (0, 14, 7),  # a difference and a count a pair; a comparison a pair
        (0, 10, 200),  # a rise a spike; a decay a step and afferent
        (0, 10, 16),  # a count a spike; two for each of 8 pixels
        (400, 36, 15),  # both filters; a read a reference spike, two sums a reference; a product and a root each
        (0, 456, 450),
        (0, 0, 15),
    ]
    assert [(c.multiplications, c.divisions) for c in counted] == [
        (2, 0), (0, 6), (2, 2), (0, 0), (200, 0), (8, 0), (3, 3), (0, 0), (0, 0)
    ]  # fmt: skip


def test_what_is_read_and_written_by_hand():
    """Of states, of what is stored, and of the buffer of spikes and features; a list with memory prices all."""
    counted = [layer.cost() for layer in EVERY]
    assert [(c.states_accesses, c.weights_accesses, c.buffers_accesses) for c in counted] == [
        (20, 0, 10 + 2),  # a count a spike
        (80, 0, 10 + 2),  # last spike, count, sum and sum of squares a spike
        (20 + 40, 0, 10 + 2),  # a count a spike; it and a sum of squares in 10 bins
        (14 + 7 + 10, 0, 10 + 3),  # a count a pair, the time of the other spike; each time is written
        (400 + 20, 0, 10 + 6),  # a trace a step and afferent; a spike
        (20, 0, 10 + 8),
        (800 + 30, 30 + 3, 10 + 3),  # both filters; a trace a reference spike; references and their norms
        (450, 30, 10 + 3),  # a sum and a time a pair
        (0, 0, 5 + 3),
    ]
    assert [c.states_bytes for c in counted] == [8, 32, 24, 52, 32, 8, 800, 80, 0]
    assert [c.weights_bytes for c in counted] == [0, 0, 0, 0, 0, 0, 132, 120, 0]
    assert all(c.energy_nJ(price_list("memory-45nm")) > c.energy_nJ() for c in counted)


def test_the_mean_alone_is_cheaper_than_mean_and_variation():
    assert cost(layers.Intervals(2, 10, variation=False)).flops < cost(layers.Intervals(2, 10)).flops


def test_every_layer_is_tested():
    found = {
        c for name, c in vars(layers).items()
        if isinstance(c, type) and issubclass(c, Layer) and c is not Layer and not name.startswith("_")
    }  # fmt: skip
    assert found == {type(layer) for layer in EVERY}


def test_counts_that_cannot_be_are_refused():
    with pytest.raises(InputError, match=r"Rates\.spikes: must be >= 0"):
        layers.Rates(2, -1.0)
    with pytest.raises(InputError, match=r"Rates\.afferents"):
        layers.Rates(0, 1.0)
