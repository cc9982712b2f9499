"""Early exit over patience, on a clock: milliseconds, with steps beside them."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.texture.shortened_figures import MODES, draw_exit_curves

STEP_ms = 0.5
WINDOW_steps = 300


@pytest.fixture
def drawn():
    rows = [
        {
            "panel": "mixed, 5&5 ms", "mode": mode, "patience": patience, "hidden": 30, "seed": seed,
            "exit_steps": patience + 10.0 * seed, "steps_saved": 1 - (patience + 10.0 * seed) / WINDOW_steps,
            "accuracy_lost": 0.2 - 0.001 * patience, "sops_saved": 0.5,
        }
        for mode, patience, seed in product(MODES, (20, 100, 200), (0, 1))
    ]  # fmt: skip
    chosen = pd.DataFrame({"panel": ["mixed, 5&5 ms"], "exit_patience": [140]})
    published = pd.DataFrame({"panel": ["mixed, 5&5 ms"], "patience": [120], "steps": [220.0]})
    return draw_exit_curves(pd.DataFrame(rows), chosen, published, STEP_ms)


def test_patience_and_decision_stand_in_milliseconds(drawn):
    _, decision, _ = drawn.axes
    curves = [line for line in decision.lines if line.get_label() in MODES.values()]
    assert len(curves) == len(MODES)
    for curve in curves:
        np.testing.assert_allclose(curve.get_xdata(), [10.0, 50.0, 100.0])
        np.testing.assert_allclose(curve.get_ydata(), [12.5, 52.5, 102.5])
    lines = {line.get_label(): line for line in decision.lines}
    assert lines["whole window"].get_ydata()[0] == pytest.approx(WINDOW_steps * STEP_ms)
    assert lines["chosen on validation trials"].get_xdata()[0] == pytest.approx(70.0)
    np.testing.assert_allclose(lines["published, Algorithm 1"].get_xydata(), [[60.0, 110.0]])


def test_steps_stand_above_their_milliseconds(drawn):
    drawn.draw_without_rendering()
    for axes in drawn.axes:
        (above,) = axes.child_axes
        assert above.get_xlabel() == "patience (steps)"
        np.testing.assert_allclose(np.array(above.get_xlim()) * STEP_ms, axes.get_xlim())
    assert [axes.get_xlabel() for axes in drawn.axes] == ["patience (ms)"] * 3


def test_published_and_measured_do_not_share_a_colour(drawn):
    lines = {line.get_label(): line for line in drawn.axes[1].lines}
    measured = {lines[name].get_color() for name in MODES.values()}
    assert lines["published, Algorithm 1"].get_markeredgecolor() not in measured
