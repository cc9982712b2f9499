"""What each saving costs: accuracy against spikes, SOPs and milliseconds."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.texture.shortened_figures import draw_costs

LENGTHS = (50.0, 150.0, 1000.0)


@pytest.fixture
def results():
    rows = [
        {
            "pair": pair, "hidden": 30, "seed": seed, "window.length_ms": length, "spikes_sa": length / 20,
            "spikes_ra": 1.0, "sops_total": 40.0 * length, "accuracy_test": accuracy - 0.01 * seed,
        }
        for pair in ("1&1", "5&5")
        for length, accuracy in zip(LENGTHS, (0.4, 0.8, 0.82), strict=True)
        for seed in (0, 1)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def points(axes):
    return [line.get_xydata() for line in axes.get_lines() if len(line.get_xdata()) == len(LENGTHS)]


def test_a_line_a_pair_meets_every_length_at_its_cost(results):
    spikes, sops, signal = draw_costs(results.sample(frac=1.0, random_state=0)).axes
    for axes, costs in ((spikes, [3.5, 8.5, 51.0]), (sops, [2.0, 6.0, 40.0]), (signal, LENGTHS)):
        assert len(points(axes)) == 2
        for line in points(axes):
            np.testing.assert_allclose(line[:, 0], costs)
            np.testing.assert_allclose(line[:, 1], [39.5, 79.5, 81.5])


def test_lengths_stand_beside_the_points_of_one_pair(results):
    spikes, _, signal = draw_costs(results).axes
    assert [text.get_text() for text in spikes.texts] == ["50 ms", "150 ms", "1000 ms"]
    assert not signal.texts
