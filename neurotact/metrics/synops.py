"""Synaptic operations (SOPs): each spike is one operation at every neuron that receives it.

Texture paper, Eqs. 8 and 9, per projection: input to hidden, hidden to hidden, hidden to readout. The paper
leaves open whether the recurrent fan-out counts, so both totals are given. Only steps that were simulated count.
A spike counts whole in the step that sends it, also where it comes back to the hidden layer a step or two later (under
the membrane `immediate`, with a recurrent delay) and the window has ended by then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from neurotact.errors import InputError, number_of
from neurotact.lazily import lazily
from neurotact.notebook import html_of
from neurotact.tables import escaped, to_markdown

with lazily():
    import pandas as pd


OF_NUMBERS = "predicted_"
"""Begin of the columns of numbers that are told."""
SIDE = "side"
"""The column of a report that says where a network met each window's trial before, where it has one."""
TRAINING, VALIDATION, TEST, UNSEEN, UNKNOWN = SIDES = ("training", "validation", "test", "unseen", "unknown")
"""From the most seen to the least: the sides of the split; trials on none of them; trials of an unknown side."""
REFUSED = "none"
"""In place of the class of a window that is none of the classes."""
COLUMNS = (
    "trial",
    "label",
    "predicted",
    "steps",
    "input_spikes",
    "hidden_spikes",
    "sops_input",
    "sops_recurrent",
    "sops_readout",
    "sops_total",
    "sops_total_feedforward",
)


class Synops(NamedTuple):
    """SOPs of each window, `(window,)` int64.

    input: input to hidden; recurrent: hidden to hidden; readout: hidden to readout, and input to readout.
    total: all three; total_feedforward: without the recurrent ones.
    """

    input: np.ndarray
    recurrent: np.ndarray
    readout: np.ndarray
    total: np.ndarray
    total_feedforward: np.ndarray

    @classmethod
    def of(cls, into_hidden: np.ndarray, among_hidden: np.ndarray, into_readout: np.ndarray) -> Synops:
        """With both totals."""
        feedforward = into_hidden + into_readout
        return cls(into_hidden, among_hidden, into_readout, feedforward + among_hidden, feedforward)

    def __repr__(self) -> str:
        if np.isnan(self.total).any():
            return f"Synops({number_of(len(self.total), 'window')}; not counted)"
        means = ", ".join(f"{name} {np.mean(part):,.0f}" for name, part in self._asdict().items() if len(self.total))
        return f"Synops({number_of(len(self.total), 'window')}; means: {means or 'none'})"

    def table(self) -> pd.DataFrame:
        """A row for each window, and a column for each part.

        >>> found = synops(np.array([10]), np.array([4]), n_hidden=30, n_readout=8, recurrent=True)
        >>> found
        Synops(1 window; means: input 300, recurrent 120, readout 32, total 452, total_feedforward 332)
        >>> found.table()["total"].tolist()
        [452]
        """
        return pd.DataFrame(self._asdict())

    def _repr_html_(self) -> str:
        return html_of(self, table=self.table().describe().loc[["mean", "min", "max"]].to_html())


class _NetworkSpec(Protocol):
    """What of a network's spec decides where a hidden spike goes."""

    @property
    def hidden(self) -> int: ...
    @property
    def fan_among(self) -> int: ...
    @property
    def hears_afferents(self) -> bool: ...


class _Network(Protocol):
    """A network as far as its spikes are counted, such as `networks.definition.rsnn.RSNN`."""

    @property
    def spec(self) -> _NetworkSpec: ...
    @property
    def n_classes(self) -> int: ...


def in_words(sops: float | None) -> str:
    """Synaptic operations in words.

    >>> in_words(1234.5), in_words(float("nan"))
    ('1,234 SOPs', 'SOPs not counted')
    """
    return "SOPs not counted" if sops is None or np.isnan(sops) else f"{sops:,.0f} SOPs"


def not_counted(n_windows: int) -> Synops:
    """SOPs of windows on a network that does not count them: NaN each."""
    return Synops(*np.full((len(Synops._fields), n_windows), np.nan))


def of_network(network: _Network, input_spikes: np.ndarray, hidden_spikes: np.ndarray) -> Synops:
    """SOPs of trials on a network: `synops` with its own sizes and its own recurrence.

    >>> from types import SimpleNamespace
    >>> spec = SimpleNamespace(hidden=30, fan_among=0, hears_afferents=False)
    >>> of_network(SimpleNamespace(spec=spec, n_classes=8), np.array([10]), np.array([4])).total.tolist()
    [332]
    """
    spec, n = network.spec, network.n_classes
    return synops(input_spikes, hidden_spikes, spec.hidden, n, recurrent=spec.fan_among, direct=spec.hears_afferents)


def synops(
    input_spikes: np.ndarray,
    hidden_spikes: np.ndarray,
    n_hidden: int,
    n_readout: int,
    *,
    recurrent: bool | int,
    direct: bool = False,
) -> Synops:
    """SOPs of windows, from what their input and hidden layers sent (texture paper, Eqs. 8 and 9).

    input_spikes, hidden_spikes: spikes of each window, summed over neurons and simulated steps, `(window,)`.
    n_hidden, n_readout: neurons that an input spike and a hidden spike reach.
    recurrent: whether a hidden spike also reaches all hidden neurons, or how many of them it reaches.
    direct: whether an input spike also reaches the readout; such operations are those of the readout.
    Raises InputError for counts that are negative, not whole or of two shapes.

    >>> synops(np.array([10]), np.array([4]), n_hidden=30, n_readout=8, recurrent=True).total.tolist()
    [452]
    >>> synops(np.array([10]), np.array([4]), n_hidden=30, n_readout=8, recurrent=10).recurrent.tolist()
    [40]
    """
    sent, hidden = (_counts(v, what) for v, what in ((input_spikes, "input"), (hidden_spikes, "hidden")))
    if sent.shape != hidden.shape:
        raise InputError(f"synops: input spikes of {sent.size} windows but hidden spikes of {hidden.size}")
    if n_hidden < (not direct) or n_readout < 1:
        raise InputError(f"synops: a network has at least one neuron a layer; got {n_hidden} and {n_readout}")
    n_among = n_hidden * recurrent if isinstance(recurrent, bool) else recurrent
    return Synops.of(n_hidden * sent, n_among * hidden, n_readout * (hidden + direct * sent))


def table_of(
    operations: Synops,
    labels: Sequence | np.ndarray,
    predicted: Sequence | np.ndarray,
    steps: Sequence | np.ndarray,
    input_spikes: np.ndarray,
    hidden_spikes: np.ndarray,
    trials: np.ndarray | None = None,
) -> pd.DataFrame:
    """The SOP report: one row per window, with the columns of `COLUMNS`.

    operations: NaN where they are not counted, as `hidden_spikes` then are.
    labels, predicted: classes of each window, names or indices alike, `(window,)`.
    steps: simulated steps of each window; input_spikes, hidden_spikes: as for `synops`.
    trials: number of the trial that each window was cut from, `(window,)`; 0, 1, ... when absent.
    """
    n_windows = len(operations.total)
    named = np.arange(n_windows) if trials is None else np.asarray(trials)
    given = (named, np.asarray(labels), np.asarray(predicted), _counts(steps, "steps of"))
    for what, values in zip(COLUMNS, given, strict=False):
        if values.shape != (n_windows,):
            raise InputError(f"synops: '{what}' has shape {values.shape} where ({n_windows},) is expected")
    hidden = np.asarray(hidden_spikes)
    spikes = (_counts(input_spikes, "input"), hidden if np.isnan(hidden).any() else _counts(hidden, "hidden"))
    return pd.DataFrame(dict(zip(COLUMNS, (*given, *spikes, *operations), strict=True)))


def _refuses(table: pd.DataFrame) -> bool:
    """Whether a SOP report has windows that are none of the classes."""
    told = "predicted" in table and (table["predicted"] == REFUSED).any()
    return bool(told) and not (table["label"] == REFUSED).any()


def summary(table: pd.DataFrame, *, of_refusing: bool = False) -> pd.DataFrame:
    """Means of a SOP report for each class, in order of the labels, and for `all` windows in the last row.

    Columns: label, windows (how many), accuracy, and the means of steps, spikes and SOPs; where numbers are told,
    `rmse_NAME`, the root-mean-square error of each, in place of the accuracy. A report with the column `side` is
    summarised side by side, in the order from the most seen to the least: its `all` rows stand within a side, since one
    accuracy over training and test windows means nothing. Where windows are refused, `answered` is the share of the
    others, and `accuracy_answered` the accuracy of these; in `accuracy` a refused window is not right. of_refusing:
    whether windows of other sides are refused.

    >>> sent, hidden = np.array([10, 0]), np.array([4, 0])
    >>> operations = synops(sent, hidden, n_hidden=30, n_readout=8, recurrent=True)
    >>> table = table_of(operations, ["a", "b"], ["b", "b"], [300, 100], sent, hidden)
    >>> summary(table)[["label", "windows", "accuracy", "steps", "sops_total"]].values.tolist()
    [['a', 1, 0.0, 300.0, 452.0], ['b', 1, 1.0, 100.0, 0.0], ['all', 2, 0.5, 200.0, 226.0]]
    """
    targets = [str(column).removeprefix(OF_NUMBERS) for column in table if str(column).startswith(OF_NUMBERS)]
    missing = [column for column in COLUMNS if column not in table and not (targets and column == "predicted")]
    if missing:
        raise InputError(f"synops: the report lacks the column '{missing[0]}'; write it again with neurotact sops")
    if SIDE in table and len(table):
        return pd.concat([_summary_of_side(table, side) for side in _sides_in(table)], ignore_index=True)
    counted = list(COLUMNS[COLUMNS.index("steps") :])
    parts, refuses = [*table.groupby("label", sort=True), ("all", table)], _refuses(table) or of_refusing
    rows = [
        {
            "label": str(label),
            "windows": len(part),
            **_judged(part, targets, refuses=refuses),
            **part[counted].mean().to_dict(),
        }
        for label, part in parts
    ]
    return pd.DataFrame(rows)


def _judged(part: pd.DataFrame, targets: Sequence[str], *, refuses: bool) -> dict[str, float]:
    """The accuracy of decisions, of all and of answered ones, or the root-mean-square error of each target."""
    if targets:
        squares = {name: (part[f"{OF_NUMBERS}{name}"] - part[f"true_{name}"]) ** 2 for name in targets}
        return {f"rmse_{name}": float(values.mean() ** 0.5) for name, values in squares.items()}
    accuracy, answered = (part["label"] == part["predicted"]).mean(), (part["predicted"] != REFUSED).mean()
    of_answered = {"answered": answered, "accuracy_answered": accuracy / answered if answered else np.nan}
    return {"accuracy": accuracy, **(of_answered if refuses else {})}


def summary_markdown(means: pd.DataFrame, what: str) -> str:
    """Markdown that stands above the SOPs of single windows: their means for each class.

    means: of `summary`.
    """
    apart = ", the sides of the split apart" if SIDE in means else ""
    shown = f"Means over windows for each class{apart}:\n\n{to_markdown(_marked(means))}"
    return f"# Synaptic operations (SOPs) of {escaped(what)}\n\n{shown}\n\nEach window:"


def _marked(means: pd.DataFrame) -> pd.DataFrame:
    """A SOP summary as it is shown: the accuracy of windows that a network was trained on says so.

    >>> seen = pd.DataFrame({"side": ["training", "test"], "windows": [70, 15], "accuracy": [0.875, 0.75]})
    >>> _marked(seen).values.tolist()
    [['training', 70, '0.875 (seen in training)'], ['test', 15, '0.75']]
    """
    if SIDE not in means or "accuracy" not in means:
        return means
    notes = np.where(means[SIDE] == TRAINING, " (seen in training)", "")
    return means.assign(accuracy=[f"{share:.6g}{note}" for share, note in zip(means["accuracy"], notes, strict=True)])


def _sides_in(table: pd.DataFrame) -> list[str]:
    sides = set(table[SIDE])
    return [side for side in SIDES if side in sides] + sorted(sides - {*SIDES}, key=str)


def _summary_of_side(table: pd.DataFrame, side: str) -> pd.DataFrame:
    means = summary(table[table[SIDE] == side].drop(columns=SIDE), of_refusing=_refuses(table))
    means.insert(0, SIDE, side)
    return means


def _counts(values: Sequence | np.ndarray, what: str) -> np.ndarray:
    counts = np.asarray(values)
    if counts.ndim != 1:
        raise InputError(f"synops: {what} spikes have shape {counts.shape}; sum them to one number a window")
    if counts.size and not ((counts >= 0) & (counts == np.floor(counts))).all():
        raise InputError(f"synops: {what} spikes must be whole numbers >= 0")
    return counts.astype(np.int64)
