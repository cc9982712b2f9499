"""Figures hold the numbers that they are given, with units on their axes, whatever is missing."""

from io import BytesIO
from itertools import product

import matplotlib
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import thinned
from matplotlib.text import Text

from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError
from neurotact.figures import encoding as encoding_figures
from neurotact.figures import networks as network_figures
from neurotact.figures import style
from neurotact.figures.networks import Published
from neurotact.figures.raster import draw_raster
from neurotact.metrics.fronts import pareto_front
from neurotact.tables import over_seeds

PAIRS = ("1&1", "1&5", "10&10")


def make_results(settings=("v1 mix", "mixed"), sizes=(20, 30), seeds=(0, 1)) -> pd.DataFrame:
    generator = np.random.default_rng(0)
    rows = pd.DataFrame(list(product(settings, PAIRS, sizes, seeds)), columns=["setting", "pair", "hidden", "seed"])
    rows["accuracy_test"] = generator.uniform(0.5, 0.9, len(rows))
    rows["sops_total"] = generator.uniform(4e3, 2e4, len(rows))
    rows["exit_accuracy"] = rows["accuracy_test"] - 0.01
    rows["exit_sops_total"] = 0.8 * rows["sops_total"]
    return rows


def make_encoding(forces=(3.0, 12.0), labels=("felt", "silk", "wool", "linen")) -> pd.DataFrame:
    rows = pd.DataFrame(list(product(PAIRS, labels, forces)), columns=["pair", "label", "force_N"])
    rows["spikes_sa_per_s"] = np.arange(len(rows), dtype=float)
    rows["spikes_ra_per_s"] = 2.0 * np.arange(len(rows))
    rows["spikes_total_per_s"] = rows["spikes_sa_per_s"] + rows["spikes_ra_per_s"]
    rows["isi_sa_ms"] = 50.0 / (1 + np.arange(len(rows)))
    rows["isi_ra_ms"] = 30.0
    return rows


def classes_of(table: pd.DataFrame) -> encoding_figures.Classes:
    order = tuple(dict.fromkeys(table["label"]))
    names = {label: label for label in order}
    return encoding_figures.Classes("fabric", order, names, names)


def render(figure) -> None:
    """Lay it out as when it is saved: a warning there is an error here."""
    figure.savefig(BytesIO(), format="svg")


points = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=20)


@given(points)
def test_no_point_of_the_front_is_beaten_and_every_other_is(found):
    cost, gain = np.array(found, float).T
    front = pareto_front(cost, gain)

    def is_beaten(i):
        return any(
            cost[j] <= cost[i] and gain[j] >= gain[i] and (cost[j] < cost[i] or gain[j] > gain[i])
            for j in range(len(cost))
        )

    assert [not is_beaten(i) for i in range(len(cost))] == front.tolist()
    assert front.any()


def test_nan_is_never_on_the_front():
    assert pareto_front(np.array([1.0, np.nan]), np.array([np.nan, 1.0])).tolist() == [False, False]


def test_means_over_seeds_are_in_the_order_of_the_table_and_count_their_seeds():
    results = make_results(settings=("b", "a"))
    networks = over_seeds(results, ["accuracy_test"])
    assert list(dict.fromkeys(networks["setting"])) == ["b", "a"]
    assert (networks["seeds"] == 2).all()
    first = results["accuracy_test"].iloc[:2]
    assert networks["accuracy_test"][0] == pytest.approx(first.mean())
    assert networks["accuracy_test_sd"][0] == pytest.approx(abs(first[0] - first[1]) / np.sqrt(2))


def test_accuracy_and_sops_draw_every_network_every_seed_and_what_is_published():
    results = make_results()
    marks = [Published("mixed", "1&5", 30, "accuracy_test", 0.867), Published("mixed", "1&1", None, "sops_total", 1e4)]
    figure = network_figures.draw_accuracy_and_sops(results, marks, chance=0.125)
    render(figure)
    panels = figure.axes
    assert [p.get_ylabel() for p in panels[:2]] == ["test accuracy (%)", "SOPs per sample (thousands)"]
    assert "(ms)" in panels[-1].get_xlabel()
    seeds = [y for line in panels[2].lines if line.get_gid() == "seed" for y in line.get_ydata()]
    expected = 100 * results[results["setting"] == "mixed"]["accuracy_test"]
    np.testing.assert_allclose(sorted(seeds), sorted(expected))
    diamonds = [[line.get_xydata().tolist() for line in p.lines if line.get_gid() == "published"] for p in panels]
    assert diamonds == [[], [], [[[pytest.approx(1.3), pytest.approx(86.7)]]], [[[0.0, 10.0]]]]


def test_the_trade_off_draws_both_fronts_and_labels_the_full_one():
    results = make_results(settings=("all",), seeds=(0,))
    figure = network_figures.draw_trade_off(results)
    render(figure)
    axes = figure.axes[0]
    assert axes.get_xlabel() == "SOPs per sample (thousands)"
    assert axes.get_ylabel() == "test accuracy (%)"
    front = pareto_front(results["sops_total"].to_numpy(), results["accuracy_test"].to_numpy())
    by_cost = results[front].sort_values("sops_total")
    (line,) = [line for line in axes.lines if line.get_gid() == "Pareto front, full window"]
    np.testing.assert_allclose(line.get_xdata(), by_cost["sops_total"] / 1e3)
    np.testing.assert_allclose(line.get_ydata(), 100 * by_cost["accuracy_test"])
    labels = [text.get_text() for text in axes.texts if text.get_gid() == "front label"]
    assert labels == [f"N = {hidden}" for hidden in by_cost["hidden"]]
    joined = [line for line in axes.lines if line.get_gid() == "exit"]
    ends = np.concatenate([line.get_xydata().reshape(-1, 3, 2)[:, :2] for line in joined])
    expected = results.sort_values(["sops_total"])[["sops_total", "exit_sops_total"]] / 1e3
    np.testing.assert_allclose(ends[np.argsort(ends[:, 0, 0]), :, 0], expected)


def test_a_level_far_below_the_points_is_told_and_does_not_squeeze_them():
    results = make_results()
    results[["accuracy_test", "exit_accuracy"]] = 0.9 + 0.05 * results[["accuracy_test", "exit_accuracy"]]
    setting = results["setting"].iloc[0]
    low = results["accuracy_test"].min()
    for level, is_drawn in ((low - 0.01, True), (low / 100, False)):
        figure = network_figures.draw_trade_off(results, {setting: {"best other classifier": low, "guessing": level}})
        axes = figure.axes[0]
        lines = [line.get_ydata()[0] for line in axes.get_lines() if line.get_gid() == "level"]
        assert lines == pytest.approx([100 * low, 100 * level] if is_drawn else [100 * low])
        words = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
        assert ("guessing" in words) == is_drawn
        assert (f"guessing: {100 * level:.3g} %, below" in words) != is_drawn


@thinned("n_settings", [3, 1, 2, 5])
def test_a_panel_for_each_setting(n_settings):
    figure = network_figures.draw_trade_off(make_results(settings=tuple("abcde"[:n_settings])))
    render(figure)
    assert sum(axes.get_visible() for axes in figure.axes) == n_settings


def test_a_sweep_with_holes_is_drawn():
    holes = make_results().iloc[[0, 3, 5, 11, 12]]
    render(network_figures.draw_accuracy_and_sops(holes))
    render(network_figures.draw_trade_off(holes))


def test_spike_counts_are_the_bars():
    table = make_encoding(forces=(12.0,))
    figure = encoding_figures.draw_spike_counts(table, ["felt", "wool"], classes_of(table))
    render(figure)
    assert [axes.get_title() for axes in figure.axes] == ["felt", "wool"]
    heights = [[bar.get_height() for bar in bars] for bars in figure.axes[1].containers]
    wool = table[table["label"] == "wool"]
    assert heights == [wool[f"spikes_{kind}_per_s"].tolist() for kind in ("sa", "ra", "total")]
    assert figure.axes[0].get_ylabel() == "spikes per second of touch"


def test_rates_are_shares_of_the_highest_of_each_population():
    table = make_encoding()
    table = table[table["pair"] == "1&1"]
    figure = encoding_figures.draw_rates(table, ["force_N"], classes_of(table))
    render(figure)
    shares = np.array(figure.axes[1].collections[0].get_array()).reshape(4, 2)
    np.testing.assert_allclose(shares, table["spikes_ra_per_s"].to_numpy().reshape(4, 2) / 14.0)
    assert [tick.get_text() for tick in figure.axes[0].get_xticklabels()] == ["3 N", "12 N"]
    assert figure.axes[1].get_title() == "RA-I (1 = 14 spikes/s)"


def test_intervals_are_drawn_by_force_and_a_silent_population_says_so():
    table = make_encoding().assign(isi_ra_ms=np.nan)
    table = table[table["pair"] == "1&1"]
    figure = encoding_figures.draw_isis(table, "force_N", classes_of(table))
    render(figure)
    slow, rapid = figure.axes
    assert slow.get_ylabel() == "mean inter-spike interval (ms)"
    np.testing.assert_allclose(slow.lines[1].get_ydata(), table[table["force_N"] == 12.0]["isi_sa_ms"])
    assert [text.get_text() for text in rapid.texts] == ["silent"]


def test_silent_populations_and_no_condition_are_drawn():
    table = make_encoding(forces=(3.0,)).assign(isi_ra_ms=np.nan, isi_sa_ms=np.nan, spikes_ra_per_s=0.0)
    render(encoding_figures.draw_rates(table, [], classes_of(table)))
    render(encoding_figures.draw_isis(table, None, classes_of(table)))


def test_a_confusion_matrix_shows_its_counts():
    figure = network_figures.draw_confusion(np.array([[5, 1], [0, 0]]), ["felt", "silk"], "best")
    render(figure)
    assert [text.get_text() for text in figure.axes[0].texts] == ["5", "1"]


def test_training_marks_the_kept_epoch():
    log = pd.DataFrame({"epoch": [1, 2], "train_loss": [2.0, 1.0], "train_accuracy": [0.5, 0.6]})
    log = log.assign(validation_loss=[2.1, 1.5], validation_accuracy=[0.4, 0.5])
    figure = network_figures.draw_training(log, kept=1)
    render(figure)
    assert [line.get_label() for line in figure.axes[0].lines] == ["training", "validation", "kept"]
    assert list(figure.axes[1].lines[2].get_xdata()) == [1, 1]
    assert figure.axes[1].get_ylabel() == "accuracy (%)"


def test_rasters_hold_each_trials_spikes_and_say_where_there_are_none():
    spikes = np.zeros((2, 100, 2), np.uint8)
    spikes[0, [10, 50], 0] = spikes[0, 60, 1] = 1
    labels = pd.DataFrame({"label": ["felt", "silk"]})
    trains = from_rasters(spikes, 1000.0, ("SA-I taxel1", "RA-I taxel1"), labels)
    figure = encoding_figures.draw_rasters(trains, [[0, 1, None]], [""], ["felt", "silk", "wool"], 0.0, 0.1, 0.05)
    render(figure)
    events = [{line.get_gid(): len(line.get_xdata()) // 3 for line in a.lines if line.get_gid()} for a in figure.axes]
    assert events == [{"SA-I": 2, "RA-I": 1}, {"SA-I": 0, "RA-I": 0}, {}]
    assert [[text.get_text() for text in axes.texts] for axes in figure.axes] == [[], ["silent"], ["no trial"]]
    assert figure.axes[0].get_xlabel() == "time (s)"


def test_figures_leave_matplotlib_as_they_found_it(tmp_path):
    before = dict(matplotlib.rcParams)
    figure = network_figures.draw_trade_off(make_results())
    style.save(figure, tmp_path / "figure.svg")
    assert dict(matplotlib.rcParams) == before
    assert "matplotlib.pyplot" not in figure.__class__.__module__


def test_an_unknown_suffix_names_the_known_ones(tmp_path):
    with pytest.raises(InputError, match=r"figure\.jpg.*\.png, \.svg, \.pdf"):
        style.save(style.new_figure(1.0), tmp_path / "figure.jpg")


NAMES = [r"$\frac{$", "$5 & $6", r"\alpha $x_1$", "a\x00b", "a\x1bb", "a\nb", "x" * 5000]


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
@thinned("suffix", [*style.SUFFIXES])
def test_a_name_is_shown_as_it_is_and_never_read_as_a_formula(tmp_path, name, suffix):
    raster = np.eye(4, 2, dtype=np.uint8)[None]
    trains = from_rasters(raster, 1000.0, (f"SA-I {name}", f"RA-I {name}"), pd.DataFrame({"label": [name]}))
    table = make_encoding(labels=(name, "silk"))
    for figure in (draw_raster(trains, 0), encoding_figures.draw_isis(table, "force_N", classes_of(table))):
        style.save(figure, tmp_path / f"a{suffix}")
        shown = [text for text in figure.findobj(Text) if "$" in text.get_text()]
        assert not any(text.get_parse_math() for text in shown if "t_\\mathrm" not in text.get_text())


def test_our_own_symbols_and_powers_of_ten_are_formulas(tmp_path):
    figure = style.new_figure(2.0)
    axes = figure.subplots()
    axes.plot([1, 1e6], [1, 1e6])
    axes.set(xscale="log", xlabel=style.PAIR_AXIS, ylabel=f"$a$ at {style.SYMBOLS[0]}", title="$a$ and $b$")
    style.save(figure, tmp_path / "a.svg")
    ticks = [label for label in axes.get_xticklabels() if "10^" in label.get_text()]
    assert len(ticks) > 1
    assert all(label.get_parse_math() for label in (*ticks, axes.xaxis.label))
    assert not axes.yaxis.label.get_parse_math()
    assert not axes.title.get_parse_math()


def test_a_figure_brings_its_picture_along_without_pyplot():
    figure = style.new_figure(1.5)
    axes = figure.subplots()
    axes.set_title("felt $x$")
    picture = figure._repr_png_()  # what IPython asks an object for
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = (int.from_bytes(picture[at : at + 4]) for at in (16, 20))
    assert (width, height) == (round(style.WIDTH_in * style.SHOWN_dpi), round(1.5 * style.SHOWN_dpi))
    assert not axes.title.get_parse_math()


def test_a_thin_line_has_a_colour_that_is_seen_in_the_legend():
    figure = style.new_figure(2.0)
    axes = figure.subplots()
    axes.plot([0, 1], lw=0.5, label="thin")
    axes.plot([1, 0], lw=2.0, label="thick")
    style.add_legend(figure, [axes], 2)
    assert [line.get_linewidth() for line in figure.legends[0].get_lines()] == [style.RC["lines.linewidth"], 2.0]
    assert axes.lines[0].get_linewidth() == 0.5
