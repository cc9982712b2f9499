"""What a decision costs by every price list that is installed, from counts in the results: nothing is trained again.

A row has what is counted twice, as columns of `prices.PRICED`: of a network whose neurons are updated on every step,
and, from `events_` on, of the same network whose neurons are updated when a spike comes. Of a classifier without
neurons both are equal. A list takes what fits it (`PriceList.event_driven`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from neurotact.metrics.flops import Cost
from neurotact.metrics.prices import PRICED, PriceList, names, price_list

EVENTS = "events_"
"""Before the columns of what an event-driven network is counted by."""


def counted(clocked: Cost, event_driven: Cost) -> dict[str, float]:
    """The columns of what a network costs, run in both ways.

    >>> counted(Cost(macs=10), Cost(macs=2))["events_macs"]
    2
    """
    return {**clocked.columns(*PRICED), **_events(event_driven.columns(*PRICED))}


def the_same(row: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a classifier without neurons, also with the columns of events; without a column for SOPs it has none.

    >>> the_same({"macs": 10})
    {'macs': 10, 'sops': 0.0, 'events_macs': 10, 'events_sops': 0.0}
    """
    whole = {**row, "sops": row.get("sops", 0.0)}
    return {**whole, **_events({name: whole[name] for name in PRICED if name in whole})}


def _events(columns: Mapping[str, float]) -> dict[str, float]:
    return {f"{EVENTS}{name}": value for name, value in columns.items()}


def energies(rows: pd.DataFrame, lists: Sequence[PriceList] = ()) -> pd.DataFrame:
    """The energy of each row in nJ, a column for each list by its name; lists: all that are installed.

    NaN where a row does not hold what a list has a price of, such as rows of an earlier version.
    """
    chosen = lists or [price_list(name) for name in names()]
    return pd.DataFrame({one.name: _energy(rows, one) for one in chosen}, index=rows.index)


def _energy(rows: pd.DataFrame, prices: PriceList) -> pd.Series:
    before = EVENTS if prices.event_driven else ""
    own = {name: rows.get(f"{before}{name}") for name in PRICED}
    return prices.energy_nJ(pd.DataFrame(own, index=rows.index, dtype=float))
