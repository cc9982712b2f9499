"""Pictures of the pages, drawn from the tables beside them: python benchmarks/pictures.py [NAME...]

`docs/images/NAME.png` is drawn from tables of `docs/data`, or shows an idea; its description holds their hash, or that
of the code that draws the idea.
"""

import inspect
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from PIL import Image, PngImagePlugin
from torch import linspace

from neurotact.figures.style import MUTED, PALE, RC, add_legend, new_figure, series_style
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.definition.surrogate import FastSigmoid, fast_sigmoid

DOCS = Path(__file__).parents[1] / "docs"
WIDTH_in, DPI = 4.2, 175
"""Narrower than print: the smallest letters have 9 pixels on a phone of 400, and about those of the text elsewhere."""
LEGEND = 66
"""Letters in a line of a legend."""
Marks = Sequence[Sequence[float]]
"""The values of each row; several are single splits, seeds or settings."""
Draw = Callable[..., Figure]


class Picture(NamedTuple):
    """What is drawn, and from which tables; an idea has none."""

    tables: tuple[str, ...]
    draw: Draw

    def figure(self) -> Figure:
        """The picture of its tables as they are now."""
        return self.draw(*map(read, self.tables))

    def hash(self) -> str:
        """What its file holds."""
        of = b"".join((DOCS / "data" / f"{table}.csv").read_bytes() for table in self.tables)
        return sha256(of or inspect.getsource(self.draw).encode()).hexdigest()


PICTURES: dict[str, Picture] = {}


def picture(name: str, *tables: str) -> Callable[[Draw], Draw]:
    """A function that draws `docs/images/NAME.png` from each `docs/data/TABLE.csv`."""

    def kept(draw: Draw) -> Draw:
        PICTURES[name] = Picture(tables, draw)
        return draw

    return kept


def read(table: str) -> pd.DataFrame:
    """A table of docs/data, as text."""
    return pd.read_csv(DOCS / "data" / f"{table}.csv", dtype=str, keep_default_na=False)


def numbers(cell: str) -> list[float]:
    """The numbers of a cell.

    >>> numbers("93.8 / 89.4"), numbers("1,393 (844)")
    ([93.8, 89.4], [1393.0, 844.0])
    """
    return [float(found.replace(",", "")) for found in re.findall(r"-?\d+(?:,\d{3})*(?:\.\d+)?", cell)]


def first(cells: Sequence[str]) -> list[list[float]]:
    """The first number of each cell, a row each."""
    return [numbers(cell)[:1] for cell in cells]


# --- kinds of pictures --------------------------------------------------------------------------------


def legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend above all panels, in as many columns as there is room for."""
    names = list(dict.fromkeys(name for axes in panels for name in axes.get_legend_handles_labels()[1]))
    columns = len(names)
    while columns > 1 and sum(map(letters, np.array_split(names, columns))) > LEGEND:
        columns -= 1
    add_legend(figure, panels, columns)


def letters(names: Sequence[str]) -> int:
    """The width of a column of a legend, with the marks.

    >>> letters(["a", "ten\nletters"])
    13
    """
    return 6 + max(len(line) for name in names for line in name.split("\n"))


def of_all(figure: Figure, panels: Sequence[Axes], words: str) -> None:
    """What all x axes have, once: below a single panel, or below all of them."""
    if len(panels) == 1:
        panels[0].set_xlabel(words)
    else:
        figure.supxlabel(words, fontsize=RC["axes.labelsize"])


def stacked(parts: Sequence[tuple[str, str, pd.Series]], words: str, height_in: float) -> Figure:
    """A bar for each name, of parts end to end. parts: words, colour and values by name of each."""
    figure = new_figure(height_in, WIDTH_in)
    axes = figure.subplots()
    left = pd.Series(0, index=parts[0][2].index)
    for label, colour, values in parts:
        axes.barh(values.index, values, left=left, color=colour, label=label)
        left = left + values
    axes.invert_yaxis()
    axes.set_xlabel(words)
    axes.grid(axis="x")
    legend(figure, [axes])
    return figure


def rows_of_dots(
    panels: Mapping[str, Mapping[str, Marks]],
    names: Sequence[str],
    words: str | Sequence[str],
    *,
    columns: int = 2,
    intervals: Mapping[tuple[str, str], Marks] | None = None,
    is_log: bool = False,
) -> Figure:
    """A row for each name, a panel for each title, a colour for each series.

    words: of the x axis. intervals: low and high of a panel's series, by both names.
    """
    columns = min(columns, len(panels))
    n_rows = -(-len(panels) // columns)
    figure = new_figure(0.75 + n_rows * (0.55 + 0.21 * len(names)), WIDTH_in)
    grid = figure.subplots(n_rows, columns, squeeze=False, sharey=True).ravel().tolist()
    labels = [""] * len(panels) if isinstance(words, str) else words
    for axes, (title, series), label in zip(grid, panels.items(), labels, strict=False):
        for index, (name, marks) in enumerate(series.items()):
            style = series_style(index)
            shift = 0.16 * (index - (len(series) - 1) / 2)
            points = [(value, row + shift) for row, values in enumerate(marks) for value in values]
            axes.plot(*zip(*points, strict=True), ls="", ms=4.5, label=name, clip_on=False, **style)
            for row, ends in enumerate((intervals or {}).get((title, name), ())):
                axes.plot(ends, [row + shift] * len(ends), color=style["color"], lw=1.0)
        axes.set(title=title, ylim=(len(names) - 0.5, -0.5), xscale="log" if is_log else "linear")
        axes.set_yticks(range(len(names)), names)
        axes.set_xlabel(label)
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)
        if is_log:
            plain_powers(axes)
        else:
            axes.xaxis.set_major_locator(MaxNLocator(5 if columns == 1 else 3))
    for spare in grid[len(panels) :]:
        spare.remove()
    if isinstance(words, str):
        of_all(figure, grid[: len(panels)], words)
    if max(map(len, panels.values())) > 1:
        legend(figure, grid[: len(panels)])
    return figure


def plain_powers(axes: Axes) -> None:
    """A logarithmic x axis with whole numbers."""
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axes.xaxis.set_minor_formatter("")


def lines(panels: Mapping[str, Mapping[str, Sequence[tuple[float, float, float]]]], x: str, y: str) -> Figure:
    """A panel for each title, a line for each series of `(x, y, deviation)`; `y` may be logarithmic: "log ..."."""
    figure = new_figure(2.6, WIDTH_in)
    grid = figure.subplots(1, len(panels), squeeze=False, sharey=not y.startswith("log ")).ravel().tolist()
    for axes, (title, series) in zip(grid, panels.items(), strict=True):
        for index, (name, points) in enumerate(series.items()):
            at, mean, deviation = zip(*points, strict=True)
            axes.errorbar(at, mean, deviation, ms=4.5, lw=1.2, capsize=2, label=name, **series_style(index))
        axes.set(title=title)
        if y.startswith("log "):
            axes.set_yscale("log")
            low, high = axes.get_ylim()
            axes.set_yticks([tick for tick in (2, 3, 4, 5, 6, 10, 20, 50, 100, 200) if low <= tick <= high])
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.yaxis.set_minor_locator(NullLocator())
        axes.grid()
    grid[0].set_ylabel(y.removeprefix("log "))
    of_all(figure, grid, x)
    legend(figure, grid)
    return figure


# --- pictures -----------------------------------------------------------------------------------------


@picture("braille-reading", "braille-reading")
def braille_reading(table: pd.DataFrame) -> Figure:
    names = [
        re.sub(r" \(the.*|: .*", "", name).replace(", ", ",\n").replace("recurrent note", "note")
        for name in table["network"]
    ]
    series = {
        "published": "published (%)",
        "best epoch on test letters": "best epoch on test letters (%)",
        "last epoch": "last epoch (%)",
    }
    return rows_of_dots(
        {"": {name: first(table[column]) for name, column in series.items()}}, names, "accuracy on test letters (%)"
    )


@picture("training-length", "training-length")
def training_length(table: pd.DataFrame) -> Figure:
    table = table[table["start"] == "repeated (default)"]
    panels = {}
    for pair, of_pair in table.groupby("t_ref"):
        panels[f"{pair} ms"] = {
            f"patience {patience}": [
                (float(row["window (ms)"]), float(row["accuracy (%)"]), float(row["accuracy (%), deviation"]))
                for _, row in rows.iterrows()
            ]
            for patience, rows in sorted(of_pair.groupby("patience"), key=lambda group: float(group[0]))
        }
    return lines(panels, "window (ms)", "test accuracy (%)")


@picture("start-position", "start-position")
def start_position(table: pd.DataFrame) -> Figure:
    rows = table[table["start"].str.endswith("mm") | table["start"].isin(["at random", "published (N = 30)"])]
    names = [
        name.replace("published (N = 30)", "published").replace("at random", "random starts") for name in rows["start"]
    ]
    panels = {
        f"{pair} ms": {"a seed": [numbers(cell) for cell in rows[f"{pair}: accuracy of each seed (%)"]]}
        for pair in ("1&1", "5&5")
    }
    return rows_of_dots(panels, names, "test accuracy (%)")


@picture("unknown-start", "unknown-start")
def unknown_start(table: pd.DataFrame) -> Figure:
    names = list(dict.fromkeys(table["trained on"]))
    panels, intervals = {}, {}
    for window, rows in sorted(table.groupby("window (ms)"), key=lambda group: float(group[0])):
        title = f"windows of {window} ms"
        panels[title] = {}
        for network, cells in rows.groupby("network", sort=False):
            name = f"{network} network"
            mean, deviation = cells["on random starts (%)"].astype(float), cells["deviation, random"].astype(float)
            panels[title][name] = [[value] for value in mean]
            intervals[title, name] = list(zip(mean - deviation, mean + deviation, strict=True))
    return rows_of_dots(panels, names, "accuracy on random starts (%)", intervals=intervals)


@picture("texture-claims", "texture-claims")
def texture_claims(table: pd.DataFrame) -> Figure:
    shades = {
        "yes": ("reproduced", "#0072B2"),
        "holds": ("holds, which shows nothing", "#a9cfe6"),
        "no": ("fails", "#d9d9d9"),
    }
    verdicts = table["verdict"].str.extract(r"^(\w+)")[0]
    names = list(dict.fromkeys(table["study"]))
    counts = {
        verdict: table[verdicts == verdict].groupby("study").size().reindex(names, fill_value=0) for verdict in shades
    }
    return stacked([(*shades[verdict], count) for verdict, count in counts.items()], "claims", 2.4)


@picture("benchmarks", "benchmark-training-step")
def benchmarks(table: pd.DataFrame) -> Figure:
    peers = {"snntorch": "snnTorch", "spikingjelly": "SpikingJelly", "norse": "Norse", "jax": "JAX"}
    cases = {"paper": "16-30-8", "paper-subtract": "the same, subtract", "large": "48-450-27"}
    ratio = {(row["case"], row["peer"]): float(row["ratio"]) for _, row in table.iterrows()}
    series = {
        words: [[ratio[case, peer]] if (case, peer) in ratio else [] for peer in peers] for case, words in cases.items()
    }
    return rows_of_dots({"": series}, list(peers.values()), "times as long as neurotact", is_log=True)


@picture("calibration-polarity", "calibration-polarity")
def calibration_polarity(table: pd.DataFrame) -> Figure:
    table = table[table["network, with the falling signal (%)"] != ""]
    names = [re.sub(r", [\d.]+ k?Hz", "", name) for name in table["recordings"]]
    series = {
        "plain": [numbers(cell) for cell in table["network, plain (%)"]],
        "with the falling signal": [numbers(cell) for cell in table["network, with the falling signal (%)"]],
    }
    return rows_of_dots({"": series}, names, "test accuracy (%), two splits")


@picture("which-encoder", "which-encoder")
def which_encoder(table: pd.DataFrame) -> Figure:
    table = table[table["encoder"] != "poisson"]
    fabrics = table[table["set"] == "fabrics"].assign(best=lambda rows: rows["network (%)"].astype(float))
    names = list(fabrics.groupby("encoder")["best"].max().sort_values(ascending=False).index)
    panels, words = {}, []
    for kind, column, label in (
        ("", "network (%)", "accuracy\n(%)"),
        (" ", "energy (nJ)", "energy\n(nJ)"),
    ):
        for name, rows in table.groupby("set", sort=False):
            by_encoder = rows.groupby("encoder")[column].apply(lambda cells: [float(cell) for cell in cells])
            panels[f"{name}{kind}"] = {"a refractory period": [by_encoder[encoder] for encoder in names]}
            words.append(label)
    figure = rows_of_dots(panels, names, words, columns=4)
    for axes in figure.axes[4:]:
        axes.set_xscale("log")
        axes.set_xlim(100, 60000)
        axes.set_xticks([100, 10000], ["100", "10k"])
        axes.xaxis.set_minor_formatter("")
    for axes in figure.axes[:4]:
        axes.set_xlim(40, 100)
        axes.set_xticks([40, 70, 100])
    return figure


@picture("clock", "clock-network")
def clock(table: pd.DataFrame) -> Figure:
    table = table[~table["clock"].str.contains("one readout")].assign(
        is_default=lambda rows: rows["clock"].str.contains("default")
    )
    names = list(dict.fromkeys(table["set, window"]))
    parts = {"the encoder's clock": table[~table["is_default"]], "the default clock": table[table["is_default"]]}
    panels = {
        "energy of the network": {name: first(rows["energy of the network (nJ)"]) for name, rows in parts.items()},
        "accuracy": {name: [numbers(cell) for cell in rows["accuracy (%)"]] for name, rows in parts.items()},
    }
    short = [name.replace(", simulated", "").replace(" from the contact", "") for name in names]
    figure = rows_of_dots(panels, short, ["nJ", "% on each split"])
    figure.axes[0].set_xlim(0, None)
    return figure


@picture("recipe-ablation", "recipe-ablation")
def recipe_ablation(table: pd.DataFrame) -> Figure:
    table = table[~table["change"].isin(["the recipe", "the other five changes"])]
    table = table.assign(change=table["change"].replace(
        {"feed-forward": "the other choice of recurrence", "recurrent": "the other choice of recurrence",
         "surrogate scale 10": "the other surrogate scale", "surrogate scale 20": "the other surrogate scale"}
    ))  # fmt: skip
    names = list(dict.fromkeys(table["change"]))
    panels, intervals = {}, {}
    for name, rows in table.groupby("set", sort=False):
        title = name.split(",")[0]
        of_change = rows.set_index("change")
        panels[title] = {"": [first([of_change["points lost"].get(change, "")])[0] for change in names]}
        intervals[title, ""] = [
            [
                *numbers(of_change["points lost, from"].get(change, "")),
                *numbers(of_change["points lost, to"].get(change, "")),
            ]
            for change in names
        ]
    figure = rows_of_dots(panels, names, "points lost", intervals=intervals)
    for axes in figure.axes:
        axes.axvline(0, color=MUTED, lw=0.8)
        axes.set_xlim(-10, 45)
    return figure


@picture("kernel-peers", "kernel-peers")
def kernel_peers(table: pd.DataFrame) -> Figure:
    widths = [(int(numbers(column)[0]), column) for column in table.columns[1:]]
    panels = {
        peer: {
            f"{row['readout neurons']} readout": [(width, numbers(row[column])[place], 0.0) for width, column in widths]
            for _, row in table.iterrows()
        }
        for place, peer in enumerate(("snnTorch", "JAX"))
    }
    return lines(panels, "hidden neurons", "log times as long as neurotact")


@picture("numbers", "numbers")
def numbers_of_a_touch(table: pd.DataFrame) -> Figure:
    titles = {("gratings", "speed_mm_per_s"): "gratings, speed", ("gratings", "force_N"): "gratings, force",
              ("cubes", "force_max_N"): "cubes, force"}  # fmt: skip
    table = table.assign(score=table["accuracy_test"].astype(float), nJ=table["energy_estimate_nJ"].astype(float))
    figure = new_figure(2.7, WIDTH_in)
    grid = figure.subplots(1, 3, sharey=True).tolist()
    for axes, ((name, target), title) in zip(grid, titles.items(), strict=True):
        rows = table[(table["set"] == name) & (table["target"] == target)]
        is_network, on_spikes = rows["who"] == "network", rows["input"].str.startswith("spikes")
        for index, (words, of_kind) in enumerate({
            "rivals on signals": ~on_spikes, "rivals on spikes": on_spikes & ~is_network, "network": is_network,
        }.items()):  # fmt: skip
            axes.plot(
                rows[of_kind]["nJ"], rows[of_kind]["score"], ls="", ms=5, label=words, **series_style((0, 1, 4)[index])
            )
        axes.set(title=title, xscale="log", xlim=(5, 2e5), ylim=(0.5, 1.02))
        axes.set_xticks([10, 1000, 100000], ["10", "1k", "100k"])
        axes.grid()
    grid[0].set_ylabel("score on test windows")
    of_all(figure, grid, "nJ a decision")
    legend(figure, grid)
    return figure


@picture("own-three-sets", "own-three-sets")
def own_three_sets(table: pd.DataFrame) -> Figure:
    figure = new_figure(2.9, WIDTH_in)
    groups = list(table.groupby("recordings", sort=False))
    grid = figure.subplots(1, len(groups), sharey=True).tolist()
    columns = {
        "network, whole window": "network, whole window", "network, early exit": "with early exit",
        "cheapest that validation\ncannot tell from the best": "the cheapest that validation cannot tell from the best",
        "a cheaper one": "a cheaper one that validation ranks lower",
    }  # fmt: skip
    for axes, (name, rows) in zip(grid, groups, strict=True):
        for index, (words, column) in enumerate(columns.items()):
            points = [numbers(cell.split(":")[-1]) for cell in rows[column] if cell]
            if points:
                accuracy, energy = zip(*points, strict=True)
                axes.plot(energy, accuracy, ls="", ms=5, label=words, **series_style(index))
        title = name.rpartition(",")[0].replace(" at", "\nat").replace(", ", ",\n")
        axes.set(title=title, xscale="log", xlim=(5, 2000))
        axes.set_xticks([10, 100, 1000], ["10", "100", "1k"])
        axes.grid()
    grid[0].set_ylabel("test accuracy (%)")
    of_all(figure, grid, "nJ a decision")
    legend(figure, grid)
    return figure


@picture("savings", "savings")
def savings(table: pd.DataFrame) -> Figure:
    names = list(dict.fromkeys(table["set"]))
    columns = {"energy saved": "memory-45nm_saved", "SOPs saved": "sops_saved", "accuracy lost": "lost_test"}
    panels = {
        title: {
            "": [[value for cell in table[table["set"] == name][column] for value in numbers(cell)] for name in names]
        }
        for title, column in columns.items()
    }
    figure = rows_of_dots(panels, names, ["%", "%", "points"], columns=3)
    for axes in figure.axes[:2]:
        axes.set_xlim(0, 100)
    return figure


@picture("scale-workers", "scale-workers")
def scale_workers(table: pd.DataFrame) -> Figure:
    table = table[table["what"].str.contains("cells|before|after")]
    ways = list(table.columns[1:])
    order = ("before: start, simulation, six encodings", "the cells, first to last", "after: tables, figures, report")
    parts = []
    for what, colour in zip(order, ("#d9d9d9", "#0072B2", "#a9cfe6"), strict=True):
        seconds = pd.Series([numbers(cell)[0] for cell in table[table["what"] == what][ways].iloc[0]], index=ways)
        parts.append((what.split(":")[0].split(",")[0], colour, seconds))
    return stacked(parts, "seconds", 1.9)


@picture("untrained-remedies", "untrained-remedies")
def untrained_remedies(table: pd.DataFrame) -> Figure:
    tested = [column for column in table.columns[1:] if column != "iCub"]
    rows = table.set_index("remedy")
    series = {
        "no remedy": "nothing", "the default": "the default",
        "best opponent": "best opponent on the test, with the default's windows and copies",
        "trained there": "trained on half of the tested trials, the ceiling",
    }  # fmt: skip
    names = [column.replace("starts", "gratings, start") for column in tested]
    return rows_of_dots(
        {"": {name: first(rows.loc[row, tested]) for name, row in series.items()}},
        names,
        "accuracy where not trained (%)",
    )


@picture("public-scores", "published-scores", "public-scores")
def public_scores(published: pd.DataFrame, own: pd.DataFrame) -> Figure:
    ours = own.set_index("set").loc[:, ["accuracy", "low", "high"]].astype(float) * 100
    rows = [ours.loc[name].tolist() if name in ours.index else [] for name in published["ours"]]
    series = {"published": [numbers(cell) for cell in published["published (%)"]], "ours": [row[:1] for row in rows]}
    names = [name.replace(" (P(VDF-TrFE))", "") for name in published["set"]]
    return rows_of_dots({"": series}, names, "test accuracy (%)", intervals={("", "ours"): [row[1:] for row in rows]})


# --- drawings of an idea ------------------------------------------------------------------------------


@picture("surrogate-gradient")
def surrogate_gradient() -> Figure:
    figure = new_figure(2.5, WIDTH_in)
    panels = figure.subplots(1, 2).tolist()
    membrane = linspace(-0.5, 0.5, 401)
    panels[0].plot(membrane, FastSigmoid()(membrane), color=series_style(0)["color"], label="real")
    panels[1].axhline(0, color=series_style(0)["color"])
    for index, (words, scale) in enumerate({"surrogate": 10.0, "steeper surrogate": 40.0}.items(), 3):
        panels[1].plot(membrane, fast_sigmoid(membrane, scale), color=series_style(index)["color"], label=words)
    for axes, title in zip(panels, ("forward: a spike", "backward: its slope"), strict=True):
        axes.set(title=title, xticks=[0], xticklabels=["threshold"], yticks=[0, 1])
        axes.grid()
    of_all(figure, panels, "membrane")
    legend(figure, panels)
    return figure


@picture("test-trials")
def interval_by_trials() -> Figure:
    figure = new_figure(2.5, WIDTH_in)
    axes = figure.subplots()
    trials, share = np.unique(np.geomspace(10, 3000, 200).astype(int)), 0.9
    low, high = 100 * np.array([wilson_interval(share, n) for n in trials.tolist()]).T
    axes.fill_between(trials, low, high, color=PALE, label="95 % interval")
    axes.axhline(100 * share, color=series_style(0)["color"], label="what the test shows")
    axes.set(xscale="log", ylabel="accuracy (%)", ylim=(50, 100), xlim=(10, 3000))
    axes.set_xlabel("test trials")
    plain_powers(axes)
    axes.grid()
    legend(figure, [axes])
    return figure


def draw(name: str) -> None:
    """Write a picture, with its hash."""
    path = DOCS / "images" / f"{name}.png"
    with rc_context(RC):
        PICTURES[name].figure().savefig(path, dpi=DPI)
    held = PngImagePlugin.PngInfo()
    held.add_text("Description", PICTURES[name].hash())
    with Image.open(path) as image:
        image.load()
        image.convert("RGB").quantize(64).save(path, pnginfo=held, optimize=True)


if __name__ == "__main__":
    for each in sys.argv[1:] or PICTURES:
        draw(each)
