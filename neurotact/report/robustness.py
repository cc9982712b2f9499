"""Accuracy at conditions of training and at others, and what varied copies of the training trials gain."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from neurotact.data.augmentation import NONE
from neurotact.report.answer import Network, percent
from neurotact.report.page import Table
from neurotact.studies.study import StudySpec
from neurotact.studies.suited import TESTED

REMEDIES = "remedies"


def of_network(table: pd.DataFrame, network: Network) -> pd.DataFrame:
    """The rows of a table that belong to a network."""
    return table[(table["pair"] == network.pair) & (table["hidden"] == network.hidden)]


def sentence(table: pd.DataFrame | None, network: Network) -> list[str]:
    """What is lost at untrained conditions, and what the copies gain, in one sentence; none if copies were not used.

    table: `remedies.csv` with the column `pair`.
    """
    if table is None:
        return []
    own = of_network(table, network)
    chosen = own[own["chosen"]]
    unseen, seen = chosen["accuracy_test"].mean(), chosen["accuracy_seen"].mean()
    said = f"At untrained conditions the network is right in {percent(unseen)} of whole windows"
    if pd.notna(seen):
        lost = 100 * (seen - unseen)
        said += f", at trained ones in {percent(seen)}"
        said += f": {lost:.1f} points are lost" if lost > 0 else ": nothing is lost"
    without = own[own["augmentation"] == NONE]
    if len(without) and (chosen["augmentation"] != NONE).any():
        said += f"; without varied copies it is right in {percent(without['accuracy_test'].mean())}"
    return [f"{said}."]


def condition_of(study: StudySpec, row: Mapping[str, Any]) -> str:
    """The tested condition of a row in words, such as "speed = 150"."""
    swept = {key.removeprefix(TESTED): row[key] for key in row if str(key).startswith(TESTED)}
    return ", ".join(f"{name} = {value}" for name, value in {**study.split.test_where, **swept}.items())


def tables(study: StudySpec, table: pd.DataFrame | None, networks: Sequence[Network], best: Network) -> list[Table]:
    """The best network at each condition, and all networks with each kind of varied copies."""
    if table is None:
        return []
    own = of_network(table, best)
    named = own.assign(condition=[condition_of(study, row) for row in own.to_dict("records")])
    rows = []
    for condition, part in named.groupby("condition", sort=False):
        chosen, without = part[part["chosen"]], part[part["augmentation"] == NONE]
        kinds = ", ".join(dict.fromkeys(chosen["augmentation"]))
        shares = [chosen["accuracy_seen"].mean(), chosen["accuracy_test"].mean(), without["accuracy_test"].mean()]
        rows.append([str(condition), *map(_share, shares), kinds])
    shown = [
        Table(
            f"The best network, {best.name}, at each untrained condition: whole windows. At trained conditions: on "
            "trials that were kept for this test.",
            ["tested", "at trained conditions (%)", "at this one (%)", "without varied copies (%)", "copies"],
            rows,
            1,
        )
    ]
    counted = table.groupby("augmentation", sort=False)
    if len(counted) > 1:
        kinds = [
            [
                str(kind), *(_share(part[f"accuracy_{side}"].mean()) for side in ("validation", "seen", "test")),
                f"{part['sops_total'].mean():,.0f}", f"{part['n_train'].mean():,.0f}", f"{part['chosen'].sum()}",
            ]
            for kind, part in counted
        ]  # fmt: skip
        heads = ["validation (%)", "at trained conditions (%)", "at untrained ones (%)", "SOPs", "training windows"]
        shown.append(
            Table(
                f"Each kind of varied copies: means over {len(table) // len(counted)} trainings. Validation trials "
                "have a condition that training trials have not; they choose.",
                ["copies", *heads, "chosen"],
                kinds,
                1,
            )
        )
    return shown


def _share(value: float) -> str:
    return "" if pd.isna(value) else f"{100 * value:.1f}"
