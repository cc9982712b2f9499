"""What the figures of the papers must tell by themselves: legends, units, milliseconds, marks that can be read."""

from itertools import product

import compliance_calibration as squeezes
import numpy as np
import pandas as pd
import pytest
import stiffness_beside_real as beside_real
from matplotlib.colors import to_rgba
from neurotact_parts.studies.comparison import figures as comparison
from neurotact_parts.studies.compliance import figures as compliance
from neurotact_parts.studies.materials import figures as materials
from neurotact_parts.studies.stiffness import figures as stiffness
from neurotact_parts.studies.stiffness import pvdf_hardness_figures, simulator
from neurotact_parts.studies.texture import baselines_figures as before
from neurotact_parts.studies.touch_modality import figures as touch

from neurotact.figures.style import INK

RNG = np.random.default_rng(0)


def legend_of(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def rows_of(**columns):
    return pd.DataFrame(list(product(*columns.values())), columns=list(columns))


@pytest.fixture
def machines():
    rows = rows_of(setup=["A", "B", "C"], classifier=list(materials.CLASSIFIERS), seed=[0, 1])
    return rows.assign(error_test=0.2 + 0.01 * rows["seed"], units=500.0)


def test_published_errors_have_the_shape_of_their_classifier(machines):
    errors, units = materials.draw_multiclass(machines).axes
    for axes, table in ((errors, materials.PUBLISHED_ERROR), (units, materials.PUBLISHED_UNITS)):
        published = [line for line in axes.lines if line.get_gid() == "published"]
        ours = [container.lines[0] for container in axes.containers]
        assert [line.get_marker() for line in published] == [line.get_marker() for line in ours]
        assert len({line.get_marker() for line in published}) == 3
        for at, line in enumerate(published):
            np.testing.assert_allclose(line.get_ydata(), [table[setup][at] for setup in "ABC"])
    assert "support vectors" in units.get_xlabel()


def test_no_axis_of_the_materials_is_longer_named_than_it_is(machines):
    features = np.array([(f, 0.2, RNG.normal(), 40.0) for f in (5.0, 15.0, 70.0) for _ in range(8)])
    labels = np.array(list(materials.ORDER) * 6)
    figure = materials.draw_patterns({"features": features, "labels": labels, "set_force_N": np.full(24, 0.2)})
    for drawn in (figure, materials.draw_multiclass(machines)):
        drawn.draw_without_rendering()
        for axes in drawn.axes:
            assert axes.yaxis.label.get_window_extent().height <= 1.02 * axes.get_window_extent().height


def test_patterns_stand_at_their_frequency():
    frequencies = (5.0, 15.0, 70.0)
    features = np.array([(f, 0.2, RNG.normal(), 10.0 * f) for f in frequencies for _ in materials.ORDER])
    labels = np.array(list(materials.ORDER) * len(frequencies))
    _, amplitude = materials.draw_patterns(
        {"features": features, "labels": labels, "set_force_N": np.full(len(features), 0.2)}
    ).axes
    assert [tick.get_text() for tick in amplitude.get_xticklabels()] == ["5", "15", "70"]
    for line in amplitude.lines:
        np.testing.assert_array_equal(np.round(line.get_xdata()), [0, 1, 2])
        np.testing.assert_allclose(line.get_ydata(), [50.0, 150.0, 700.0])


def test_curves_on_each_other_differ_in_their_dashes():
    waveforms = np.cos(2 * np.pi * 30 * np.arange(400) / 2000)[None, :, None] * np.ones((4, 1, 2))
    arrays = {"waveforms": waveforms, "waveform_labels": np.array(materials.ORDER),
              "waveform_frequency_Hz": np.array(30.0), "sampling_rate_Hz": np.array(2000.0)}  # fmt: skip
    for axes in materials.draw_waveforms(arrays).axes:
        assert len({line._dash_pattern[1] and tuple(line._dash_pattern[1]) for line in axes.lines}) == 4


def test_accuracy_by_n_max_is_ours_above_and_published_below():
    rows = rows_of(classifier=list(stiffness.CLASSIFIERS), features=list(stiffness.FEATURES), n_max=[50, 300])
    figure = stiffness.draw_by_n_max(rows.assign(accuracy_test=0.8))
    above, below = figure.axes[:3], figure.axes[3:]
    for ours, published, features in zip(above, below, stiffness.FEATURES, strict=True):
        assert len(ours.lines) == len(published.lines) == len(stiffness.CLASSIFIERS)
        assert all(set(line.get_ydata()) == {80.0} for line in ours.lines)
        for line, classifier in zip(published.lines, stiffness.CLASSIFIERS, strict=True):
            np.testing.assert_allclose(line.get_ydata(), stiffness.PUBLISHED_ACCURACY[classifier, features])


def test_channels_and_peaks_have_a_legend():
    arrays = {"shown": RNG.normal(size=(2, 300, 4)), "shown_labels": np.array(["SR", "RW"]),
              "labels": np.array(["SR", "SR", "RW", "RW"]), "sampling_rate_Hz": np.array(2000.0),
              "peaks": RNG.normal(size=(4, 150, 4))}  # fmt: skip
    channels = [f"channel {i}" for i in (1, 2, 3, 4)]
    assert set(legend_of(stiffness.draw_signals(arrays))) == {*channels, "their mean", "middle half of the peaks"}
    one = {"a": RNG.normal(size=(300, 4))}
    assert legend_of(beside_real.draw_beside_real(one, one, 2000.0)) == channels


def test_grasps_stand_above_presses_with_their_liveliest_taxels():
    grasps = simulator.simulate(simulator.StiffnessSpec(placements=1, grasps=1))
    found = beside_real.first_of_each(grasps, ["RW"], n=2)["RW"]
    every = np.asarray(grasps.to_unit("mV").signals[list(grasps.conditions["label"]).index("RW")], float)
    spread = every.std(axis=0)
    np.testing.assert_allclose(np.sort(found.std(axis=0)), np.sort(spread)[-2:], rtol=1e-6)
    np.testing.assert_allclose(np.median(found, axis=0), 0.0, atol=1e-6)


def test_parts_of_a_cost_and_their_sum_are_marks():
    rows = rows_of(encoder=["LIF"], features=["spikes"], classifier=["SNN", "RSNN"]).assign(
        window_ms=150.0, decision="window", as_in="", flops_encoder=4e4, flops_features=0.0, flops_classifier=6e4
    )
    figure = before.draw_parts(rows, 150.0)
    (axes,) = figure.axes
    assert not axes.patches  # no bar on a logarithmic axis
    values = {line.get_label(): np.asarray(line.get_xdata()) for line in axes.lines}
    np.testing.assert_allclose(values["all of them"], 1e5)
    np.testing.assert_allclose(values["encoder"], 4e4)
    assert np.isnan(values["features"]).all()
    assert "150 ms" in axes.get_xlabel()


def test_chance_and_early_exit_are_in_the_legend():
    rows = rows_of(encoder=["LIF"], features=["rate"], classifier=["kNN"], window_ms=[50.0, 150.0]).assign(
        decision="window", accuracy_test=0.5, accuracy_validation=0.5, flops=1e4, as_in=""
    )
    rows = rows.assign(signal_ms=rows["window_ms"])
    assert {"chance", "early exit"} <= set(legend_of(before.draw_over_signal(rows)))
    assert "early exit" in legend_of(before.draw_over_cost(rows, 150.0))
    assert "%" in before.draw_grid(rows, 150.0).axes[0].get_title()
    ways = rows_of(task=["gratings"], family=["ELM", "RSNN"]).assign(accuracy_test=0.5, chance=0.1, nJ=10.0)
    assert "chance" in legend_of(comparison.draw_trade_offs(ways, "nJ", "energy (nJ)"))


def test_readings_of_a_squeeze_have_one_scale_with_a_unit():
    one = squeezes.Shown("OBJ-1", np.array([0.0, 6.0, 12.0, 6.0]), np.arange(4.0), np.eye(3), 9 * np.eye(4))
    figure = squeezes.draw_squeezes([one, one._replace(finger=5 * np.eye(3))])
    images = [image for axes in figure.axes for image in axes.images]
    assert {image.get_clim() for image in images} == {(0.0, 9.0)}
    assert "counts" in figure.axes[-1].get_ylabel()


def test_bounds_of_the_compliance_paper_are_in_the_legend():
    published = pd.DataFrame(
        {"sensor": ["finger"] * 2, "bits": [8] * 2, "moments": [1, 2], "accuracy": [0.3, 0.8], "below": [True, False]}
    )
    ours = rows_of(protocol=["honest"], sensors=list(compliance.SENSOR_CHOICES), bits=[8], moments=[1, 2])
    figure = compliance._accuracy(ours.assign(accuracy_test=0.5), published)
    assert any("less than" in words for words in legend_of(figure))


def test_hardness_says_what_its_marks_are():
    rows = rows_of(protocol=["by trial"], chain=["RSNN"], features=["spikes"], split=[0, 1]).assign(
        accuracy_test=[0.8, 0.9], energy_estimate_nJ=1.0, n_train=100, n_test=20
    )
    found = legend_of(pvdf_hardness_figures.draw_accuracy_and_cost(rows))
    assert set(found) == {"single splits", "mean and its 95 % interval"}


def test_steps_of_a_touch_have_their_milliseconds():
    rows = rows_of(network=["LSTM(10)"], protocol=["paper"], steps=[8, 256], fold=[0, 1]).assign(accuracy_test=0.5)
    (panel,) = touch.draw_accuracy(rows, {}, 2048.0).axes
    (above,) = panel.child_axes
    assert "(ms)" in above.get_xlabel()
    at = dict(zip(above.get_xticks(), (tick.get_text() for tick in above.get_xticklabels()), strict=True))
    assert (at[8], at[256]) == ("256", "8")
    rows = rows.assign(used_on_8=0.5, used_on_256=0.5)
    named = touch.draw_other_steps(rows, (8, 256), 2048.0).axes[0].get_yticklabels()
    assert [tick.get_text() for tick in named] == ["8 (256 ms)", "256 (8 ms)"]


def test_averages_of_a_touch_stand_in_its_time():
    patterns = RNG.normal(1.65, 0.01, (1, 6000, 5))
    figure = touch.draw_touches(patterns, RNG.normal(1.65, 0.01, (1, 20, 5)), ["rolling"], 3000.0, (1.6, 1.7))
    upper, lower = figure.axes[:2]
    assert lower.images[0].get_extent()[:2] == [0.0, 2.0]
    assert "20 steps of 100 ms" in lower.get_xlabel()
    assert {*touch.RANKS, "rest", "other taxels"} == set(legend_of(figure))
    strongest = int(np.ptp(patterns[0], axis=0).argmax())
    drawn = next(line for line in upper.lines if line.get_label() == touch.RANKS[0])
    np.testing.assert_allclose(drawn.get_ydata(), patterns[0][:, strongest])
    assert to_rgba(drawn.get_color()) != to_rgba(INK)
