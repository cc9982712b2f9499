"""How many conditions must be recorded: accuracy at an untrained one, over the number of those trained on."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurotact import files, spec
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, Splits, SplitSpec, values_to_leave_out
from neurotact.data.window_choice import ARGUMENTS
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.networks.definition import seeds
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.progress import Tell, track, untold
from neurotact.spec import takes_specs
from neurotact.tables import write_table

with lazily():
    import pandas as pd

    from neurotact.figures import style
    from neurotact.networks.training import model_selection, tasks, trainer
    from neurotact.networks.use import measuring


MOST_TESTED = 4
"""Values of a condition that are tested at most, evenly spaced."""
VALIDATION = 0.15
"""Share of the training trials that is for validation."""
ENOUGH = 0.01
"""Accuracy that one more trained value must gain to be worth recording."""


def _evenly(values: Sequence[Any], n: int) -> list[Any]:
    """Of some values in their order, n that are evenly spaced, with both ends; the middle one alone.

    >>> _evenly([10, 20, 30, 40, 50], 3), _evenly([10, 20, 30], 1)
    ([10, 30, 50], [20])
    """
    places = [(len(values) - 1) / 2] if n == 1 else np.linspace(0, len(values) - 1, n)
    return [values[int(position)] for position in np.round(places)]


def plan(conditions: "pd.DataFrame", column: str) -> list[tuple[Any, list[Any]]]:
    """The trainings: the value that is tested, and those that are trained on.

    Every number of values occurs with every tested one. Raises InputError for fewer than three values.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 3, "speed": [1, 1, 2, 2, 3, 3]})
    >>> plan(table, "speed")
    [(1, [2]), (1, [2, 3]), (2, [1]), (2, [1, 3]), (3, [1]), (3, [1, 2])]
    """
    values = values_to_leave_out(conditions, column)
    if len(values) < 3:
        listed = ", ".join(map(str, values))
        raise InputError(f"`column`: a curve needs three values of {column}, and trials have {listed}; record another")
    tested = _evenly(values, min(MOST_TESTED, len(values)))
    others = {value: [one for one in values if one != value] for value in tested}
    return [(value, _evenly(others[value], n)) for value in tested for n in range(1, len(values))]


def curve(
    trains: SpikeTrains, spec: RSNNSpec, task: "tasks.Task", column: str, seed: int = 0
) -> Iterator[dict[str, Any]]:
    """A row for each training of the plan: tested, trained (how many values), accuracy_seen, accuracy_test, sops_total.

    task: its split is not used: test trials are all of the tested value, and training has as many trials whatever the
    number of values, so that a further value does not count as more data.
    """
    pairs = plan(trains.conditions, column)
    values, labels = trains.conditions[column].to_numpy(), trains.labels
    rng = np.random.default_rng(seed)
    least = min(int((values == value).sum()) for value in set(values.tolist()))
    for tested, trained_on in pairs:
        pool = np.flatnonzero(np.isin(values, trained_on))
        pool = np.sort(_some(rng, pool, labels, values, least))
        kept = tasks.held_out(trains, pool, model_selection.SEEN, seed)
        rest = np.setdiff1d(pool, kept)
        validation = tasks.held_out(trains, rest, VALIDATION, seed + 1)
        split = Split(np.setdiff1d(rest, validation), validation, np.flatnonzero(values == tested))
        start = seeds.of_start(seed, SplitSpec(test_where={column: tested}))
        fitted, sides = trainer.fit(trains, spec, task, start, split=split)
        inferred = fitted.network.infer(sides.test.spikes)
        seen, _ = tasks.examples_of(trains, kept, task)
        yield {
            "tested": tested,
            "trained": len(trained_on),
            "accuracy_seen": measuring.accuracy_of(fitted.network.infer(seen.spikes), seen),
            "accuracy_test": measuring.accuracy_of(inferred, sides.test),
            "sops_total": float(measuring.synops_of(inferred, fitted.network).total.mean()),
            "n_train": len(split.train),
        }


def _some(rng: np.random.Generator, pool: np.ndarray, labels: np.ndarray, values: np.ndarray, n: int) -> np.ndarray:
    """About n trials of a pool, drawn within each class, from all values in turn."""
    if n >= len(pool):
        return pool
    parts = []
    for label in np.unique(labels[pool]):
        part = rng.permutation(pool[labels[pool] == label])
        turn = pd.Series(values[part]).groupby(values[part]).cumcount().to_numpy()
        parts.append(part[np.argsort(turn, kind="stable")][: max(3, round(n * len(part) / len(pool)))])
    return np.concatenate(parts)


def means(table: "pd.DataFrame") -> "pd.DataFrame":
    """Means over the tested values, one row for each number of trained ones; `least` is the worst tested value."""
    groups = table.groupby("trained", sort=True)
    mean = groups[["accuracy_seen", "accuracy_test", "sops_total"]].mean()
    mean.insert(2, "least", groups["accuracy_test"].min())
    return mean.reset_index()


def advice(table: "pd.DataFrame", column: str) -> str:
    """What the curve says, and whether to record more values, in two sentences.

    >>> rows = {"trained": [1, 2], "accuracy_seen": 0.98, "accuracy_test": [0.6, 0.9], "sops_total": 1e3, "tested": 5}
    >>> advice(pd.DataFrame(rows), "speed")
    'At a value of speed that was not trained on, accuracy is 60.0 % with 1 trained value, 90.0 % with 2, and 98.0 % at trained ones. The last one gained 30.0 points: record more values.'
    """  # noqa: E501
    mean = means(table)
    shares = [
        f"{100 * row.accuracy_test:.1f} % with {row.trained}{' trained value' if index == 0 else ''}"
        for index, row in enumerate(mean.itertuples())
    ]
    last, seen = mean["accuracy_test"].iloc[-1], mean["accuracy_seen"].iloc[-1]
    said = (
        f"At a value of {column} that was not trained on, accuracy is {', '.join(shares)}, and {100 * seen:.1f} % at "
        "trained ones."
    )
    gained = last - mean["accuracy_test"].iloc[-2]
    if seen - last <= ENOUGH:
        return f"{said} Nothing is lost at untrained values: these are enough."
    if gained > ENOUGH:
        return f"{said} The last one gained {100 * gained:.1f} points: record more values."
    return (
        f"{said} The last one gained no more than {100 * ENOUGH:g} point: more values of {column} are not the remedy; "
        "encode varied copies, or take other windows."
    )


@takes_specs
def conditions_curve(
    spikes: str | Path,
    column: str,
    network: str | Path | RSNNSpec = "default",
    settings: Mapping[str, Any] | None = None,
    *,
    window: WindowSpec = WindowSpec(),
    where: Mapping[str, Any] | None = None,
    leave_out: str | Sequence[str] | Mapping[str, Any] | None = None,
    augmentation: str | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    figure: str | Path | None = None,
    force: bool = False,
    tell: Tell = untold,
) -> "pd.DataFrame":
    """How many values of a condition must be recorded: accuracy at an untrained one over the number of trained ones.

    A network is trained on one, two, ... of the other values and tested on all trials of one; up to four values are
    tested. Each training has as many trials, so that a further value does not count as more data.

    column: the condition, such as "speed", with three values or more. network, settings, window, where, leave_out,
        augmentation: as of `train`. seed: of the weights, and of the trials that are drawn.
    out: also write the table (.csv, .json, .md, .tex). figure: also draw the curve (.png, .svg, .pdf).
    force: replace them.
    tell: called with what `neurotact conditions-curve` prints: the means, and the advice.
    Returns a row for each training: `tested`, `trained` (how many values), `accuracy_seen` (on other trials of trained
    values), `accuracy_test`, `sops_total` and `n_train`.
    Raises InputError for an unknown condition, and for one with fewer than three values.

    >>> settings, window = {"hidden": 4, "training.epochs": 1}, nt.Window(length_ms=50)
    >>> table = nt.conditions_curve("spikes.h5", "day", "rsnn", settings, window=window)  # doctest: +SKIP
    >>> table["trained"].unique().tolist()  # doctest: +SKIP
    [1, 2, 3, 4]
    """
    outputs = [Path(file) for file in (out, figure) if file is not None]
    for file in outputs:
        files.check_new(file, force=force, inputs=[spikes])
    path = tasks.path_of(spikes)
    task = tasks.task_of("conditions_curve", window, Splits(), where=where, leave_out=leave_out)
    trains = tasks.load_spikes(path, task, tell=True)
    kind = tasks.kind_of_copies(trains, augmentation, tell)
    task = tasks.with_suited_window(task.model_copy(update={"augmentation": kind}), trains, ARGUMENTS)
    what, n = spec.resolve(RSNNSpec, network, settings), len(plan(trains.conditions, column))
    rows = []
    with track("networks", n) as advance:
        for row in curve(trains, what, task, column, seed):
            rows.append(row)
            advance(1, "")
    table = pd.DataFrame(rows)
    if out is not None:
        write_table(table, Path(out))
    if figure is not None:
        style.save(style.printed(_drawn)(table, column), Path(figure))
    tell(means(table))
    tell(advice(table, column))
    for file in outputs:
        tell(f"saved in {file}")
    return table


def _drawn(table: "pd.DataFrame", column: str) -> "style.Figure":
    """Accuracy of each tested value over the number of trained ones, their mean, and that at trained values."""
    from matplotlib.ticker import MaxNLocator

    figure = style.new_figure(3.2, 5.2)
    axes = figure.add_subplot()
    for tested, rows in table.groupby("tested", sort=False):
        axes.plot(rows["trained"], 100 * rows["accuracy_test"], color=style.MUTED, linewidth=0.8, alpha=0.8)
        axes.annotate(
            f"{tested:g}" if isinstance(tested, (int, float)) else str(tested),
            (rows["trained"].iloc[-1], 100 * rows["accuracy_test"].iloc[-1]),
            xytext=(4, 0), textcoords="offset points", va="center", fontsize=7, color=style.MUTED,
        )  # fmt: skip
    means = table.groupby("trained")[["accuracy_test", "accuracy_seen"]].mean()
    axes.plot(means.index, 100 * means["accuracy_test"], label="untrained values, mean", **style.series_style(0))
    axes.plot(means.index, 100 * means["accuracy_seen"], label="trained values", **style.series_style(1))
    axes.set_xlabel(f"trained values of {column}")
    axes.set_ylabel("test accuracy (%)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(0, 103)
    style.add_legend(figure, [axes], 2)
    return figure
