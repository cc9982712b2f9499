"""Ablation of the default recipe: the same network with one choice removed or changed, on each set.

The sets, their splits and their encoders are the same as in `ways_to_save` (`sets.py`).
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from neurotact_parts.studies.comparison import fronts, sets
from neurotact_parts.studies.comparison.saving import Setting, cut, fit, row_of
from neurotact_parts.studies.comparison.sets import WaysData
from neurotact_parts.studies.comparison.skipped import SKIPPED, of_run, skipped_row
from pydantic import Field

from neurotact.errors import InputError, nearest, number_of
from neurotact.figures.style import INK, Drawn, new_figure, printed
from neurotact.metrics import referee
from neurotact.metrics.resampled import LEAST_SPLITS, Interval, resampled_p, sizes_of
from neurotact.networks.definition import recipe
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import Spec, build, override
from neurotact.studies.way import Arrays, Listed, Named, View, heads

WHOLE = "the recipe"
LEAST_POINTS = 5.0
"""Minimum range of the figure's axis on either side of 0; intervals beyond it are cut."""


class Parameters(Spec):
    """The recipe, and the recipe with one choice removed or changed, on one set."""

    data: WaysData
    without: dict[str, tuple[str, ...]] = {}
    """Keys that get the value of a network without a recipe, under the name of the removed choice."""
    instead: dict[str, dict[str, Any]] = {}
    """Keys with other values, under the name of the change."""
    network: RSNNSpec = RSNNSpec(recipe="default", hidden=50)
    seed: int = Field(default=0, ge=0)
    """Random seed of the split, the weights and the order of training."""


VIEW = View(
    by=("set", "change"),
    measures=heads("accuracy_test accuracy_validation sops_total hidden_spikes"),
    cost="sops_total",
    score="accuracy_test",
    note="Each seed has its own split, the same for all changes. A change that does not alter the network of a set has "
    "no row there. Sets whose recordings are not available are left out; the column `skipped` of results.csv gives the "
    "reason.",
    apart=("set",),
)

load = sets.load


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for the recipe, and one for each change that alters the network."""
    if SKIPPED in arrays:
        return [{"change": "", **skipped_row(arrays, VIEW.measures)}]
    bench = sets.bench_of(parameters.data, parameters.network, parameters.seed, arrays)
    own = cut(bench, Setting())
    whole = recipe.chosen_for(parameters.network, own.sides.train.spikes, own.trains.sampling_rate_Hz)
    networks = {WHOLE: whole, **variants(whole, parameters)}
    return [{"change": name, **row_of(fit(own, spec, bench.seeds)), SKIPPED: ""} for name, spec in networks.items()]


def variants(whole: RSNNSpec, parameters: Parameters) -> dict[str, RSNNSpec]:
    """The network of each change by its name, without changes that alter nothing.

    whole: the network that the recipe chose.

    >>> asked = Parameters(
    ...     data={"set": "a", "sets": {"a": {"dataset": {"simulate": "gratings"}}}}, without={"readout": ("readout",)},
    ...     instead={"feed-forward": {"model": "snn"}, "recurrent": {"model": "rsnn"}},
    ... )
    >>> found = variants(RSNNSpec(readout="integrator"), asked)
    >>> {name: (spec.readout, spec.model) for name, spec in found.items()}
    {'without readout': ('count', 'rsnn'), 'feed-forward': ('integrator', 'snn')}
    """
    table, plain = whole.model_dump(mode="json"), _plain()
    changed = {f"without {name}": {key: _of(plain, key) for key in keys} for name, keys in parameters.without.items()}
    changed |= parameters.instead
    tables = {name: override(table, values) for name, values in changed.items()}
    specs = {name: build(RSNNSpec, table, source=f"'{name}'") for name, table in tables.items()}
    return {name: spec for name, spec in specs.items() if spec != whole}


def _plain() -> dict[str, Any]:
    """Every key of a network without a recipe, dotted."""
    plain = RSNNSpec()
    return {**dict(plain), **{f"training.{key}": value for key, value in plain.training}}


def _of(plain: Mapping[str, Any], key: str) -> Any:
    if key not in plain:
        raise InputError(f"parameters.without: '{key}' is not a key of a network; {nearest(key, list(plain))}")
    return plain[key]


def _changes(results: pd.DataFrame) -> pd.DataFrame:
    """A row for each set and change: the accuracy that is lost compared with the recipe, seed by seed.

    results: rows with set, change, seed, n_train, n_test, accuracy_test and sops_total.
    Columns: set, change, seeds, accuracy_test (mean), lost (mean of the differences), low and high (95 % interval of
    `lost`, corrected for splits that share trials; NaN for one or two seeds), p (of `lost`, of this change alone; 1 for
    one or two seeds), share (of the recipe's SOPs).
    """
    rows = []
    for name, part in results.groupby("set", sort=False):
        whole = part[part["change"] == WHOLE].set_index("seed")
        for change, mine in part[part["change"] != WHOLE].groupby("change", sort=False):
            mine = mine.set_index("seed")
            both = whole.index.intersection(mine.index)
            lost = (whole.loc[both, "accuracy_test"] - mine.loc[both, "accuracy_test"]).to_numpy()
            share = float(mine.loc[both, "sops_total"].mean() / whole.loc[both, "sops_total"].mean())
            rows.append({"set": name, "change": change, "seeds": len(both), "share": share,
                         "accuracy_test": float(mine.loc[both, "accuracy_test"].mean()),
                         **fronts.interval_of(lost, mine)._asdict(), "p": _p(lost, mine)})  # fmt: skip
    return pd.DataFrame(rows, columns=None if rows else ["set"]).rename(columns={"mean": "lost"})


def _p(lost: np.ndarray, rows: pd.DataFrame) -> float:
    n_train, n_test, trials = sizes_of(rows)
    return resampled_p(lost, n_train, n_test, trials) if len(lost) >= LEAST_SPLITS else 1.0


def named(results: pd.DataFrame) -> dict[str, Named]:
    """Of each set whether a change is clearly better or worse; the first rows of its table are named in the picture."""
    return {name: _named(*both) for name, *both in _by_set(results)}


def tables(results: pd.DataFrame) -> dict[str, tuple[Listed]]:
    """Of each set what each change loses and saves, the largest loss first."""
    return {name: (_listed(*both),) for name, *both in _by_set(results)}


def _by_set(results: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame, pd.DataFrame]]:
    """Of each set the rows of the recipe, and its changes with the largest loss first."""
    for name, rows in of_run(results).groupby("set", sort=False):
        table = _changes(rows)
        order = table.sort_values("lost", ascending=False, kind="stable") if len(table) else table
        yield str(name), rows[rows["change"] == WHOLE], order


def _told(table: pd.DataFrame) -> list[int]:
    """The changes of the first screen: the three that lose most, and the one that loses least or gains most."""
    return sorted({*range(min(3, len(table))), *range(len(table))[-1:]})


def _named(whole: pd.DataFrame, table: pd.DataFrame) -> Named:
    labels = {(WHOLE,): WHOLE} | dict.fromkeys(((change,) for change in table.get("change", ())), "")
    for one in table.iloc[_told(table)].itertuples():
        labels[one.change,] = f"{one.change} {fronts.in_signs(one.share, one.lost)}"
    said, details = _answer(100 * whole["accuracy_test"].mean(), table)
    return Named(
        said, details, {VIEW.cost: labels}, "the recipe, and changes that lose most and least, with SOPs and points"
    )


def _answer(reached: float, table: pd.DataFrame) -> tuple[str, list[str]]:
    """The headline, and which changes are clear."""
    recipe, n = f"the recipe ({reached:.1f} %)", number_of(len(table), "change")
    if table.empty:
        return f"No change was tried on {recipe}.", []
    clear = table[np.array(referee.holm(table["p"].tolist())) < referee.LEVEL]
    worse, better = clear[clear["lost"] > 0], clear[clear["lost"] < 0]
    reach = (
        f"they reach from {_words(table.iloc[0])}, to {_words(table.iloc[-1])}"
        if len(table) > 1
        else _words(table.iloc[0])
    )
    details = [f"Clearly {how}, after correction for {n}: {', '.join(rows['change']) or 'none'}."
               for how, rows in (("worse", worse), ("better", better))]  # fmt: skip
    if (seeds := int(table["seeds"].min())) < LEAST_SPLITS:
        said = f"{fronts.in_seeds(seeds).capitalize()} cannot tell whether a change is better than {recipe}: {reach}."
    elif len(better):
        said = f"Change {recipe}: {_most(better[::-1], n, 'better')}."
    elif len(worse):
        said = f"Keep {recipe}: {_most(worse, n, 'worse')}, and none is clearly better."
    else:
        said = f"None of {n} is clearly better or worse than {recipe}: {reach}."
    return said, details


def _most(clear: pd.DataFrame, n: str, how: str) -> str:
    """How many changes are clear, and the first of them."""
    are, first = ("is", ":") if len(clear) == 1 else ("are", ", most of all")
    return f"{len(clear)} of {n} {are} clearly {how}{first} {_words(clear.iloc[0])}"


def _words(change: Any) -> str:
    points = fronts.in_points(Interval(change["lost"], change["low"], change["high"]))
    return f"'{change['change']}', {points} {'gained' if change['lost'] < 0 else 'lost'}"


def _listed(whole: pd.DataFrame, table: pd.DataFrame) -> Listed:
    base = {
        "change": WHOLE,
        "points gained": "-",
        "accuracy_test": whole["accuracy_test"].mean(),
        "share of SOPs": "100 %",
    }
    rows = [
        {"change": one["change"], "points gained": _signed(one), "accuracy_test": one["accuracy_test"],
         "share of SOPs": f"{100 * one['share']:.0f} %"}
        for one in table.to_dict("records")
    ]  # fmt: skip
    return Listed(
        "The recipe, and the points of test accuracy that each change gains over it, with the 95 % interval of that "
        "change alone. SOPs are a share of those of the recipe.",
        pd.DataFrame([base, *rows]),
        [0, *(1 + at for at in _told(table))],
    )


def _signed(change: Any) -> str:
    gained, low, high = (0.0 - 100 * change[name] for name in ("lost", "high", "low"))
    return f"{gained:+.1f}" + ("" if np.isnan(low) else f" ({low:.1f} to {high:.1f})")


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy lost by each change, a panel per set."""
    table = _changes(of_run(results))
    if table.empty:
        return
    yield Drawn(
        "recipe-ablation",
        "Accuracy lost by each change of the recipe",
        draw_changes(table),
        "Mean over seeds of the test accuracy that a change loses compared with the recipe, on the same split, with "
        "its 95 % interval if there are three seeds, cut at the ends of the axis. Left of 0 the change is better.",
        "A panel per set; a mark per change, right of the line at 0 if the change loses accuracy.",
    )


@printed
def draw_changes(table: pd.DataFrame) -> Figure:
    """A panel per set, a mark per change.

    table: of `_changes`.
    """
    kinds, names = list(table["set"].unique()), list(table["change"].unique())
    figure = new_figure(0.9 + 0.24 * len(names))
    panels = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0].tolist()
    for axes, name in zip(panels, kinds, strict=True):
        mine = table[table["set"] == name]
        ticks = [names.index(change) for change in mine["change"]]
        lost = 100 * mine["lost"]
        reach = [(lost - 100 * mine["low"]).fillna(0), (100 * mine["high"] - lost).fillna(0)]
        axes.errorbar(lost, ticks, xerr=np.array(reach), fmt="o", color=INK, ms=4, elinewidth=0.8)
        axes.axvline(0, color="0.6", lw=0.8)
        widest = max(LEAST_POINTS, 2 * float(lost.abs().max()))
        axes.set(title=name, xlabel="points lost", xlim=(-widest, widest))
        axes.grid(axis="x")
    panels[0].set_yticks(range(len(names)), names)
    panels[0].invert_yaxis()
    return figure
