"""Accuracy at conditions of training and at others, and what varied copies of the training trials gain."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from neurotact.data.augmentation import NONE
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.data.trial_choice import values_in_words
from neurotact.metrics.shares import wilson_interval
from neurotact.report.answer import Network
from neurotact.report.page import Table
from neurotact.report.wording import percent
from neurotact.studies.automatic import TESTED
from neurotact.studies.cell import RIGHT_SEEN
from neurotact.studies.store import result_of
from neurotact.studies.study import Cell, StudySpec
from neurotact.tables import LAYERS

REMEDIES = "remedies"
TRAINED = "at trained conditions"
GAINS = ("gained by copies (points)", "gained by the last training (points)")


def of_network(table: pd.DataFrame, network: Network) -> pd.DataFrame:
    """The rows of a table that belong to a network."""
    is_own = (table["pair"] == network.pair) & (table["hidden"] == network.hidden)
    return table[is_own & (table[LAYERS] == network.layers) if LAYERS in table and network.hidden else is_own]


def sentence(table: pd.DataFrame | None, network: Network) -> list[str]:
    """What is lost at untrained conditions, and what the copies gain, in one sentence; none if copies were not used.

    table: `remedies.csv` of one setting with the column `pair`.
    """
    if table is None:
        return []
    own = of_network(table, network)
    used = _used(own)
    unseen, seen = used["accuracy_test"].mean(), used["accuracy_seen"].mean()
    said = f"At untrained conditions the network is right in {percent(unseen)} of whole windows"
    if pd.notna(seen):
        lost = 100 * (seen - unseen)
        said += f", at trained ones in {percent(seen)}"
        said += f": {lost:.1f} points are lost" if lost > 0 else ": nothing is lost"
    if (used["augmentation"] != NONE).any() and pd.notna(gained := 100 * _gained_by_copies(own)):
        said += f"; varied copies of training trials {'gain' if gained >= 0 else 'lose'} {abs(gained):.1f} points"
        said += " before the last training" if not own[own["chosen"]]["last"].all() else ""
    return [f"{said}."]


def _used(table: pd.DataFrame) -> pd.DataFrame:
    """The trainings whose networks are used: the last of each network."""
    return table[table["last"]]


def _tried(table: pd.DataFrame) -> pd.DataFrame:
    """The trainings to the end that validation chooses among."""
    return table[(table["chosen"] | ~table["last"]) & table["accuracy_test"].notna()]


def _ruled_out(table: pd.DataFrame) -> str:
    """Which kinds of copies were not trained to the end, as a sentence behind a blank; empty for none."""
    out = table[table["ruled_out"].notna()] if "ruled_out" in table else table[:0]
    kinds = [f"{kind} in {len(part)}" for kind, part in out.groupby("augmentation", sort=False)]
    if not kinds:
        return ""
    return f" Ruled out early, behind another kind on validation trials after the same epochs: {', '.join(kinds)}."


def _gained_by_copies(table: pd.DataFrame) -> float:
    """Accuracy of the chosen copies less that without copies, of trainings alike; NaN without the latter."""
    tried = _tried(table)
    without = tried[tried["augmentation"] == NONE]["accuracy_test"].mean()
    return float(tried[tried["chosen"]]["accuracy_test"].mean() - without)


def _gained_by_last(table: pd.DataFrame) -> float:
    """Accuracy after the last training less that of the chosen one; NaN if that is the last."""
    if (table["chosen"] & table["last"]).all():
        return float("nan")
    return float(_used(table)["accuracy_test"].mean() - table[table["chosen"]]["accuracy_test"].mean())


def condition_of(study: StudySpec, row: Mapping[str, Any]) -> str:
    """The tested condition of a row in words, such as "speed = 150"."""
    swept = {key.removeprefix(TESTED): row[key] for key in row if str(key).startswith(TESTED)}
    return values_in_words({**study.split.test_where, **swept})


def by_class(folder: Path, cells: Sequence[Cell], trains: SpikeTrains | None) -> pd.DataFrame:
    """A row for each class and tested condition, and for each class at the conditions of training (`TRAINED`).

    cells: of one network, done, with a condition that is tested and not trained on. trains: of one of them.
    Columns: label, condition, trials, right (share of whole windows, a mean over trials). Empty without such cells.
    """
    shares = []
    for cell in cells if trains is not None else ():
        result = result_of(folder, cell)
        tested = values_in_words(cell.split.test_where)
        for condition, right in ((tested, "right"), (TRAINED, RIGHT_SEEN)):
            known = result.get(right, {}) if tested else {}
            shares += [(condition, int(trial), share) for trial, share in known.items()]
    if trains is None or not shares or max(trial for _, trial, _ in shares) >= len(trains):  # spikes of other trials
        return pd.DataFrame(columns=["label", "condition", "trials", "right"])
    by_trial = pd.DataFrame(shares, columns=["condition", "trial", "right"])
    once = by_trial.groupby(["condition", "trial"], sort=False)["right"].mean().reset_index()
    once["label"] = trains.conditions[LABEL].astype(str).to_numpy()[once["trial"]]
    found = once.groupby(["label", "condition"], sort=False)["right"].agg(["size", "mean"]).reset_index()
    return found.rename(columns={"size": "trials", "mean": "right"})


def hardest(classes: pd.DataFrame) -> list[str]:
    """The class that loses most at untrained conditions, in one sentence; none if chance may be the reason.

    classes: of `by_class`. It is named if it loses more than the others do by more than both of its intervals, at
    trained and at untrained conditions, which are wider since it is chosen among all classes.
    """
    both = {is_seen: part.assign(n_right=part["right"] * part["trials"]).groupby("label")[["n_right", "trials"]].sum()
            for is_seen, part in classes.groupby(classes["condition"] == TRAINED)}  # fmt: skip
    if len(both) < 2 or len(both[False]) < 2 or set(both[False].index) != set(both[True].index):
        return []
    unseen, seen = both[False], both[True]
    lost = seen["n_right"] / seen["trials"] - unseen["n_right"] / unseen["trials"]
    label = str(lost.idxmax())
    others = [one.drop(label).sum() for one in (unseen, seen)]
    at, at_seen = (float(one["n_right"] / one["trials"]) for one in others)
    own, own_seen = (float(one.loc[label, "n_right"] / one.loc[label, "trials"]) for one in (unseen, seen))
    n, n_seen = (int(one.loc[label, "trials"]) for one in (unseen, seen))
    _, high = wilson_interval(own, n, chosen_of=len(unseen))
    low, _ = wilson_interval(own_seen, n_seen, chosen_of=len(unseen))
    if high >= low - max(0.0, at_seen - at):
        return []
    return [
        f"'{label}' loses most at untrained conditions: it is right in {percent(own)} of {n} trials, at trained ones "
        f"in {percent(own_seen)} of {n_seen}; the other classes in {percent(at)} and {percent(at_seen)}."
    ]


def class_table(classes: pd.DataFrame, best: Network) -> list[Table]:
    """Each class at each untrained condition and at conditions of training; none without such conditions.

    classes: of `by_class`.
    """
    if classes.empty:
        return []
    conditions = sorted(dict.fromkeys(classes["condition"]), key=lambda name: name != TRAINED)
    cells = classes.set_index(["label", "condition"])
    rows = [
        [str(label), *(_with_trials(cells, (label, condition)) for condition in conditions)]
        for label in sorted(set(classes["label"]))
    ]
    caption = (
        f"Each class by {best.name}, of the answer: share of whole windows that are right, in %, and the number of "
        "trials."
    )
    return [Table(caption, ["class", *conditions], rows, 1)]


def _with_trials(cells: pd.DataFrame, key: tuple[str, str]) -> str:
    if key not in cells.index:
        return ""
    return f"{100 * cells.loc[key, 'right']:.1f} ({cells.loc[key, 'trials']:.0f})"


def tables(study: StudySpec, table: pd.DataFrame | None, best: Network) -> list[Table]:
    """The best network at each condition, and all networks with each kind of varied copies; table: of one setting."""
    if table is None:
        return []
    own = of_network(table, best)
    named = own.assign(condition=[condition_of(study, row) for row in own.to_dict("records")])
    heads = ["tested", "at trained conditions (%)", "at this one (%)", "lost (points)", *GAINS]
    rows = []
    for condition, part in named.groupby("condition", sort=False):
        used = _used(part)
        kinds = ", ".join(dict.fromkeys(used["augmentation"]))
        seen, unseen = used["accuracy_seen"].mean(), used["accuracy_test"].mean()
        shares = [seen, unseen, seen - unseen, _gained_by_copies(part), _gained_by_last(part)]
        rows.append([str(condition), *map(_share, shares), kinds])
    shown = [
        Table(
            f"{best.name}, of the answer, at each untrained condition: whole windows. At trained conditions: on "
            "trials that were kept for this test. The copies are chosen at a condition that validation leaves out; the "
            "last training has this condition, too.",
            [*heads, "copies"],
            rows,
            1,
        )
    ]
    tried = _tried(table)
    counted = tried.groupby("augmentation", sort=False)
    if len(counted) > 1:
        kinds = [
            [
                str(kind), *(_share(part[f"accuracy_{side}"].mean()) for side in ("validation", "seen", "test")),
                _sops(part["sops_total"].mean()), f"{part['n_train'].mean():,.0f}", f"{part['chosen'].sum()}",
            ]
            for kind, part in counted
        ]  # fmt: skip
        heads = ["validation (%)", "at trained conditions (%)", "at untrained ones (%)", "SOPs", "training windows"]
        shown.append(
            Table(
                f"Each kind of varied copies: means over {counted.size().max()} trainings, before the last one. "
                "Validation trials have a condition that training trials have not; they choose."
                f"{_ruled_out(table)}",
                ["copies", *heads, "chosen"],
                kinds,
                1,
            )
        )
    return shown


def _sops(value: float) -> str:
    return "not counted" if pd.isna(value) else f"{value:,.0f}"


def _share(value: float) -> str:
    return "" if pd.isna(value) else f"{100 * value:.1f}"
