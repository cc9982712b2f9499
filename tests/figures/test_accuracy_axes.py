"""Nothing drawn of an accuracy passes 0 or 100 %: no bar of a mean ± deviation, and no axis."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from neurotact_parts.studies.comparison import figures as all_ways_figures
from neurotact_parts.studies.compliance import figures as compliance_figures
from neurotact_parts.studies.materials import figures as materials_figures
from neurotact_parts.studies.stiffness import figures as stiffness_figures
from neurotact_parts.studies.stiffness import pvdf_hardness_figures
from neurotact_parts.studies.texture import baselines_figures as texture_baselines_figures
from neurotact_parts.studies.texture import shortened_figures
from neurotact_parts.studies.touch_modality import figures as touch_figures

from neurotact.figures import networks as network_figures
from neurotact.figures.style import bars, keep_within, new_figure
from neurotact.report import ways as pages
from neurotact.studies.way import View

UNEVEN = (1.0, 0.7, 0.99, 0.02, 0.0, 1.0)
"""Means near either end whose deviations reach past it."""

shares = st.floats(0, 1)


@given(st.lists(st.tuples(shares, st.floats(0, 10) | st.just(float("nan"))), min_size=1))
def test_a_bar_ends_within_the_whole_and_is_the_deviation_where_there_is_room(points):
    mean, deviation = np.array(points).T
    below, above = bars(mean, deviation, 1.0)
    assert (below >= 0).all()
    assert (above >= 0).all()
    assert (mean - below >= -1e-12).all()
    assert (mean + above <= 1 + 1e-12).all()
    roomy = (mean - deviation >= 0) & (mean + deviation <= 1)
    np.testing.assert_allclose(below[roomy], deviation[roomy], atol=1e-12)
    np.testing.assert_allclose(above[roomy], deviation[roomy], atol=1e-12)


def test_what_is_no_share_keeps_its_deviation_and_what_is_absent_has_no_bar():
    assert bars([5.0, np.nan], [9.0, 1.0], None).tolist() == [[9.0, 0.0], [9.0, 0.0]]
    assert bars([np.nan, 5.0], [1.0, np.nan]).tolist() == [[0.0, 0.0], [0.0, 0.0]]


def crossed(**columns):
    """A row for every combination; accuracies go round `UNEVEN`."""
    rows = pd.DataFrame(list(product(*columns.values())), columns=list(columns))
    rows["accuracy_test"] = np.resize(UNEVEN, len(rows))
    return rows


def networks():
    rows = crossed(setting=["all"], pair=["1&1", "5&5"], hidden=[20, 30], seed=[0, 1, 2])
    return rows.assign(
        sops_total=np.arange(len(rows)) + 1e3, exit_sops_total=np.arange(len(rows)) + 5e2, exit_accuracy=1.0
    )


def ways():
    rows = crossed(task=["gratings", "fabrics"], family=["ELM", "SNN"], seed=[0, 1])
    return rows.assign(chance=0.1, energy_estimate_nJ=np.arange(len(rows)) + 1.0)


def before():
    rows = crossed(encoder=["LIF"], classifier=["kNN", "RSNN"], window_ms=[50.0, 150.0], seed=[0, 1, 2])
    return rows.assign(
        decision="window", features="rate", accuracy_validation=0.5, signal_ms=rows["window_ms"], flops=1e3
    )


def shortened():
    rows = crossed(panel=["1&1"], trained_ms=[50.0, 100.0], cut_ms=[50.0, 100.0], hidden=[20], seed=[0, 1, 2])
    return rows.assign(sops_total=1e3)


def pairs():
    rows = crossed(problem=["brass vs wood"], setup=["A", "C"], classifier=["RELM", "SVM"], seed=[0, 1, 2])
    return rows.assign(error_test=rows["accuracy_test"], units=10.0)


def presses():
    rows = crossed(protocol=["by trial"], chain=["RSNN"], features=["4F", "8F"], split=[0, 1, 2])
    return rows.assign(energy_estimate_nJ=1.0, n_train=100, n_test=20)


def folds():
    return crossed(network=["LSTM"], protocol=["paper"], steps=[8, 16], fold=[0, 1, 2])


def grasps():
    return crossed(protocol=["honest"], classifier=["R-FC"], features=["4F", "8F", "16F"], n_max=[100]).assign(
        flops=9e3
    )


def squeezes():
    names = {"protocol": ["paper", "honest"], "sensors": list(compliance_figures.SENSOR_CHOICES), "bits": [8]}
    return crossed(**names, moments=[1, 2])


LOG = pd.DataFrame({"epoch": [1, 2], "train_loss": [2.0, 1.0], "train_accuracy": [0.0, 1.0]}).assign(
    validation_loss=[2.1, 1.5], validation_accuracy=[0.0, 1.0]
)
PUBLISHED = pd.DataFrame({"sensor": [], "bits": [], "moments": [], "accuracy": [], "below": pd.Series(dtype=bool)})

DRAWN = {
    "networks": (lambda: network_figures.draw_accuracy_and_sops(networks(), chance=0.1), 100, "y"),
    "trade-off": (lambda: network_figures.draw_trade_off(networks()), 100, "y"),
    "training": (lambda: network_figures.draw_training(LOG, 1), 100, "y"),
    "all ways": (lambda: all_ways_figures.draw_trade_offs(ways(), "energy_estimate_nJ", "nJ"), 1, "y"),
    "over signal": (lambda: texture_baselines_figures.draw_over_signal(before()), 100, "y"),
    "over cost": (lambda: texture_baselines_figures.draw_over_cost(before(), 150.0), 100, "y"),
    "cut short": (lambda: shortened_figures.draw_cut_short(shortened()), 100, "y"),
    "materials": (lambda: materials_figures.draw_pairs(pairs()), 1, "y"),
    "hardness": (lambda: pvdf_hardness_figures.draw_accuracy_and_cost(presses()), 100, "x"),
    "touch": (lambda: touch_figures.draw_accuracy(folds(), {}, 2048.0), 100, "y"),
    "stiffness": (lambda: stiffness_figures.draw_by_n_max(grasps()), 100, "y"),
    "compliance": (lambda: compliance_figures._accuracy(squeezes(), PUBLISHED), 100, "y"),
}


@pytest.mark.parametrize("name", DRAWN)
def test_no_bar_and_no_axis_passes_the_ends(name):
    draw, whole, along = DRAWN[name]
    figure = draw()
    figure.canvas.draw()
    found = [axes for axes in figure.axes if is_of_accuracy(axes, along)]
    assert found
    for axes in found:
        low, high = axes.get_ylim() if along == "y" else axes.get_xlim()
        assert 0 <= low < high <= whole
        bars_of = [lines for lines in axes.collections if isinstance(lines, LineCollection)]
        ends = [point["xy".index(along)] for lines in bars_of for bar in lines.get_segments() for point in bar]
        assert all(-1e-9 <= end <= whole + 1e-9 for end in ends)


def is_of_accuracy(axes, along):
    """Whether the axis, or that of a panel which shares it, is named after accuracy or error."""
    shared = [axes, *axes.get_shared_y_axes().get_siblings(axes)]
    names = [other.get_ylabel() for other in shared] if along == "y" else [axes.get_xlabel()]
    return any(word in name for name in names for word in ("accuracy", "error"))


@pytest.mark.parametrize(("drawn", "limits"), [((60.0, 70.0), (59.5, 70.5)), ((0.0, 50.0), (0.0, 52.5))])
def test_limits_within_the_whole_stay(drawn, limits):
    axes = new_figure(1.0).subplots()
    axes.plot([0, 1], drawn)
    keep_within([axes])
    assert axes.get_ylim() == pytest.approx(limits)


def test_the_bars_of_a_protocols_page_end_within_the_whole():
    view = View(("kind",), {"accuracy": "accuracy (%)", "flops": "FLOPs"}, "flops", "accuracy")
    rows = pd.DataFrame({"kind": ["elm"] * 3 + ["svm"], "accuracy": [1.0, 1.0, 0.7, 0.5], "flops": 10.0})
    page = pages._page_data(pages.over_rows(rows, view), view, {})
    (below, above), alone = (point["bar"] for point in page["points"])
    assert (below, above) == (pytest.approx(100 * np.std([1, 1, 0.7], ddof=1)), pytest.approx(10.0))
    assert alone == [0.0, 0.0]
    assert page["whole"] == 100.0
    costs = View(("kind",), {"flops": "FLOPs"}, "flops", "flops")
    assert pages._page_data(pages.over_rows(rows, costs), costs, {})["whole"] is None
