"""Is a refractory period the cheapest way to save? Ten ways on one axis of accuracy over SOPs, for several sets.

A way is a list of settings (`saving.Setting`); all of them share recordings, split, seeds and the network's recipe.
"""

from collections.abc import Iterator
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from pydantic import Field, model_validator

from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.sources import expand, reader, simulator
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.data.splits import SplitSpec, split_conditions
from neurotact.data.windows import Windows, WindowSpec
from neurotact.encoders.afferents import AfferentSpec, AfferentType
from neurotact.encoders.calibration import calibrate
from neurotact.errors import InputError, nearest
from neurotact.figures.style import INK, MUTED, Drawn, add_legend, new_figure, printed, write_out_log_ticks
from neurotact.networks.specs import RSNNSpec
from neurotact.papers.comparison import fronts
from neurotact.papers.comparison.fronts import NOTHING
from neurotact.papers.comparison.saving import Bench, Fitted, Setting, measured
from neurotact.papers.comparison.skipped import SKIPPED, left_out, of_run, skipped_row
from neurotact.spec import Spec
from neurotact.studies.protocol import Arrays, View, heads

CALIBRATED_AT_MS = 1.0
COLOURS = (
    "#E06C00", "#0072B2", "#56B4E9", "#009E73", "#7fb800", "#999999", "#CC79A7", "#882255", "#332288", "#c4a000"
)  # fmt: skip
MARKS = ("o", "s", "^", "v", "P", "X", "D", "d", "<", ">")
"""Of each way, in turn."""


class SetSpec(Spec):
    """A set of touches: simulated, or read in a published format."""

    later_keys: ClassVar[tuple[str, ...]] = ("group",)
    simulate: str | None = None
    simulation: dict[str, Any] = {}
    """Keys of the simulator that differ from their defaults."""
    read: str | None = None
    path: str | None = None
    unit: str = "mV"
    conditioning: ConditioningSpec = ConditioningSpec()
    """Before the afferents; `resample_Hz` is their clock. Events have none."""
    window: WindowSpec = WindowSpec()
    group: tuple[str, ...] = ()
    """Conditions that name a group: trials that agree in them stand on one side where `split` is by groups."""

    @model_validator(mode="after")
    def _has_one_source_as_recorded(self) -> "SetSpec":
        if (self.simulate is None) == (self.read is None) or (self.read is not None and self.path is None):
            raise ValueError("give simulate, or read with its path")
        if self.conditioning.offset is not None or self.conditioning.scale is not None:
            raise ValueError("conditioning: offset and scale are fitted on the training trials; leave them out")
        return self


class WaysData(Spec):
    """One of several sets."""

    later_keys: ClassVar[tuple[str, ...]] = ("split",)
    set: str
    sets: dict[str, SetSpec]
    split: Literal["trials", "groups"] = "trials"
    """What stands on one side of a split, drawn at random: single trials, or the set's groups."""

    @model_validator(mode="after")
    def _names_a_set(self) -> "WaysData":
        if self.set not in self.sets:
            raise ValueError(f"set: '{self.set}' is none of the sets; {nearest(self.set, list(self.sets))}")
        return self

    @property
    def chosen(self) -> SetSpec:
        return self.sets[self.set]


class Parameters(Spec):
    """Every way on one set."""

    data: WaysData
    ways: dict[str, tuple[Setting, ...]]
    """The settings of each way, besides `nothing saved`."""
    network: RSNNSpec = RSNNSpec(recipe="default", hidden=50)
    seed: int = Field(default=0, ge=0)
    """Of the split, the weights and the order of training."""

    @model_validator(mode="after")
    def _leaves_the_name_of_nothing(self) -> "Parameters":
        if NOTHING in self.ways:
            raise ValueError(f"ways: '{NOTHING}' is what all ways are compared with; name the way otherwise")
        return self


VIEW = View(
    by=("set", "way", "setting"),
    measures=heads(
        "accuracy_test accuracy_validation sops_total energy_estimate_nJ signal_ms input_spikes hidden_spikes"
    ),
    cost="sops_total",
    score="accuracy_test",
    note="Each seed has a split of its own, the same for all ways. A refractory period holds for both populations "
    "where one is given; events have a dead time. SOPs of pruned networks count the weights that remain. Energy is an "
    "estimate of the arithmetic of afferents and network, without memory: both work at every step, whatever they send. "
    "Sets whose recordings are not at hand are left out; the column `skipped` of results.csv says why.",
    apart=("set",),
)


def load(data: WaysData) -> Arrays:
    """The recordings up to the end of their last window, or the spikes of events; or only why they are left out."""
    chosen = data.chosen
    try:
        if data.split == "groups" and not chosen.group:
            raise InputError("the set names no group to split by")
        if chosen.simulate is not None:
            source = simulator(chosen.simulate)
            felt: Recordings | SpikeTrains = source.simulate(source.build(chosen.simulation, data.set), None)
        else:
            assert chosen.read is not None
            assert chosen.path is not None
            felt = reader(chosen.read).read(expand(chosen.path))
    except InputError as error:
        return left_out(data.set, error)
    return _arrays_of(felt, chosen)


def _arrays_of(felt: Recordings | SpikeTrains, chosen: SetSpec) -> Arrays:
    window = chosen.window
    rate_Hz = felt.sampling_rate_Hz
    last_ms = window.start_ms + (window.per_trial or 1) * (window.hop_ms or window.length_ms)
    conditions = felt.conditions[[LABEL, *chosen.group]].astype(str)
    shared = {"labels": conditions[LABEL].to_numpy(dtype=str), "sampling_rate_Hz": np.array(rate_Hz)}
    if chosen.group:
        shared["groups"] = conditions[list(chosen.group)].agg(", ".join, axis=1).to_numpy(dtype=str)
    if isinstance(felt, SpikeTrains):
        whole = Windows(np.arange(len(felt)), np.zeros(len(felt), np.int64), int(felt.trial_steps.min()))
        return {**shared, "raster": felt.raster(whole), "afferents": np.array(felt.afferents)}
    felt = felt.to_unit(chosen.unit)
    # One sample more than the windows need, so that a slower clock does not end within the last window.
    n_samples = int(np.ceil(last_ms * 1e-3 * rate_Hz)) + 1
    shortest = min(len(signal) for signal in felt.signals)
    if shortest < last_ms * 1e-3 * rate_Hz:
        raise InputError(
            f"{felt.source}: the shortest trial lasts {1e3 * shortest / rate_Hz:.0f} ms, which does not hold windows "
            f"up to {last_ms:g} ms; shorten the window"
        )
    longest = min(n_samples, shortest)
    return {**shared, "signals": np.stack([np.asarray(signal[:longest], np.float32) for signal in felt.signals])}


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for each setting of each way, after that of the network that saves nothing.

    `no recurrence` is left out where the network has none to begin with.
    """
    if SKIPPED in arrays:
        return [{"way": "", "setting": "", **skipped_row(arrays, VIEW.measures)}]
    bench = bench_of(parameters.data, parameters.network, parameters.seed, arrays)
    step_ms = _step_ms(parameters.data, arrays)
    known: dict[str, Fitted] = {}
    rows = []
    for way, settings in {NOTHING: (Setting(),), **parameters.ways}.items():
        for setting in settings:
            if not setting.recurrence and not known[Setting().first_training()].network.spec.recurrent:
                continue  # the recipe chose a feed-forward network
            name = named(setting, step_ms, bench.encoder is None)
            rows.append({"way": way, "setting": name, **measured(bench, setting, known), SKIPPED: ""})
    return rows


def bench_of(data: WaysData, network: RSNNSpec, seed: int, arrays: Arrays) -> Bench:
    """What all ways share on one set and seed: gains are calibrated on the training trials."""
    chosen = data.chosen
    rate_Hz = float(arrays["sampling_rate_Hz"])
    conditions = pd.DataFrame({LABEL: arrays["labels"]})
    groups = conditions.assign(group=arrays["groups"]) if data.split == "groups" else conditions
    by = ("group",) if data.split == "groups" else ()
    split = split_conditions(groups, (), SplitSpec(seed=2 * seed, group=by))
    seeds = (2 * seed, 2 * seed + 1)
    if "raster" in arrays:
        trains = from_rasters(arrays["raster"], rate_Hz, tuple(arrays["afferents"].tolist()), conditions)
        return Bench(trains, None, split, chosen.window, network, seeds)
    felt = Recordings(list(arrays["signals"]), rate_Hz, chosen.unit, conditions, source=data.set)
    encoder = _calibrated(felt.select(split.train), chosen, _step_ms(data, arrays))
    return Bench(felt, encoder, split, chosen.window, network, seeds)


def _calibrated(training: Recordings, chosen: SetSpec, step_ms: float) -> AfferentSpec:
    """Afferents with gains fitted on training trials, on the set's clock and with refractory periods of a step.

    Gains are fitted on a clock of 1 ms, or the set's where that is finer: they are per ms, so that they hold on slower
    ones, where too many intervals would be of a single step.
    """
    fine_ms = min(CALIBRATED_AT_MS, step_ms)
    least = AfferentType(gain=1.0, t_ref_ms=fine_ms)
    conditioning = chosen.conditioning.model_copy(update={"resample_Hz": 1e3 / fine_ms})
    start = AfferentSpec(unit=chosen.unit, conditioning=conditioning, sa1=least, ra1=least)
    found = calibrate(training, start, tell=False).encoder
    parts = {part: getattr(found, part).model_copy(update={"t_ref_ms": step_ms}) for part in ("sa1", "ra1")}
    slower = found.conditioning.model_copy(update={"resample_Hz": 1e3 / step_ms})
    return found.model_copy(update={"conditioning": slower, **parts})


def _step_ms(data: WaysData, arrays: Arrays) -> float:
    """A step of the clock that afferents or events are on."""
    return 1e3 / (data.chosen.conditioning.resample_Hz or float(arrays["sampling_rate_Hz"]))


def named(setting: Setting, step_ms: float, events: bool) -> str:
    """A setting in words.

    >>> named(Setting(t_ref_steps=(1, 5)), 2.0, False), named(Setting(prune=0.5, train_on=True), 2.0, False)
    ('2 & 10 ms', '50 % of the weights, trained on')
    """
    parts = []
    if setting.t_ref_steps is not None:
        periods = setting.t_ref_steps[:1] if events else setting.t_ref_steps
        parts.append(" & ".join(f"{n * step_ms:g}" for n in periods) + " ms")
    if setting.rate_penalty is not None:
        parts.append(f"penalty {setting.rate_penalty:g}")
    if setting.time_constants != 1:
        parts.append(f"{setting.time_constants:g} times")
    for what in ("taxels", "window", "hidden"):
        if getattr(setting, what) != 1:
            parts.append(f"{100 * getattr(setting, what):g} % {'of the window' if what == 'window' else what}")
    if not setting.recurrence:
        parts.append("feed-forward")
    if setting.prune is not None:
        parts.append(f"{100 * setting.prune:g} % of the weights" + (", trained on" if setting.train_on else ""))
    if setting.exit_tolerance is not None:
        parts.append(f"{100 * setting.exit_tolerance:g} points")
    return ", ".join(parts) or "-"


def answers(results: pd.DataFrame) -> list[str]:
    """One sentence for each set that was run: what it costs to save half of the SOPs."""
    return fronts.answers(of_run(results))


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy over SOPs, a panel per set and a line per way."""
    shown = of_run(results)
    if shown.empty:
        return
    yield Drawn(
        "ways-to-save",
        "Accuracy over SOPs, way by way",
        draw_fronts(fronts.fronts(shown)),
        "Mean test accuracy over seeds with its 95 % interval. Joined: neither another setting of the same way nor the "
        "network that saves nothing (star) has both fewer SOPs and higher accuracy. Dashed: the front of all ways.",
        "A panel per set; each way to save is a line of marks from the network that saves nothing to fewer SOPs.",
    )


@printed
def draw_fronts(points: pd.DataFrame) -> Figure:
    """A panel per set, a line per way.

    points: of `fronts.fronts`.
    """
    names = list(points["set"].unique())
    n_rows = -(-len(names) // 2)
    figure = new_figure(0.9 + 2.9 * n_rows)
    panels = figure.subplots(n_rows, min(2, len(names)), squeeze=False).ravel().tolist()
    ways = [way for way in points["way"].unique() if way != NOTHING]
    for axes, name in zip(panels, names, strict=False):
        _draw_set(axes, points[points["set"] == name], ways)
        axes.set_title(name)
    for spare in panels[len(names) :]:
        spare.remove()
    add_legend(figure, panels[: len(names)], ncols=4)
    return figure


def _draw_set(axes: Axes, points: pd.DataFrame, ways: list[str]) -> None:
    for index, way in enumerate(ways):
        rows = points[points["way"] == way].sort_values("sops_total")
        style = {"color": COLOURS[index % len(COLOURS)], "marker": MARKS[index % len(MARKS)], "ls": "none", "ms": 4.5}
        axes.errorbar(rows["sops_total"], rows["accuracy_test"], _whiskers(rows), elinewidth=0.5, capsize=0, mfc="none",
                      alpha=0.6, label=way, **style)  # fmt: skip
        best = rows[rows["on_own_front"]]
        axes.plot(best["sops_total"], best["accuracy_test"], **{**style, "ls": "-", "lw": 0.9})
    base = points[points["way"] == NOTHING]
    axes.plot(base["sops_total"], base["accuracy_test"], marker="*", ms=11, color=INK, ls="none", label=NOTHING)
    front = points[points["on_front"]].sort_values("sops_total")
    style: Any = {"where": "post", "color": MUTED, "ls": "--", "lw": 0.8, "zorder": 0}
    axes.step(front["sops_total"], front["accuracy_test"], label="front of all ways", **style)
    axes.plot([], [], "o", mfc="none", color=MUTED, ms=4.5, label="beaten by its own way")
    axes.set(xscale="log", xlabel="SOPs per window", ylabel="test accuracy")
    write_out_log_ticks(axes.xaxis)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.grid(axis="y")


def _whiskers(rows: pd.DataFrame) -> np.ndarray:
    """How far the interval reaches below and above each mean, within 0 to 100 %; nothing where there is none."""
    mean = rows["accuracy_test"]
    low, high = (rows[bound].clip(0, 1).fillna(mean) for bound in ("low", "high"))
    return np.array([mean - low, high - mean])
