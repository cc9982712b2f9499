"""What the chosen network and its rivals cost by every price list: under which lists the order turns.

The report chooses the network and its most accurate rival on validation (`report.way_answer`). The cheapest rival, by
the list at hand, is on signals or events, and at most `NEAR` less accurate than the network on test windows.
"""

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison import by_list
from neurotact_parts.studies.comparison.skipped import of_run

from neurotact.baselines.opponents import SPIKES
from neurotact.metrics.decision import is_within
from neurotact.metrics.prices import ARITHMETIC_45NM
from neurotact.report import first_screen, way_answer
from neurotact.report.under_prices import times, turning
from neurotact.report.way_answer import WayAnswer
from neurotact.report.ways import over_rows
from neurotact.report.wording import energy
from neurotact.studies.way import Listed, View

CHEAPEST, MOST_ACCURATE = "cheapest rival", "most accurate rival"
KINDS = (CHEAPEST, MOST_ACCURATE)
NEAR = 0.02
"""The accuracy that the cheapest rival may lack."""
COLUMNS = ("setting", "prices", "network", "network_nJ", "rival", "name", "nJ", "kB", "ratio")


def outcomes(results: pd.DataFrame, view: View) -> list[WayAnswer]:
    """The answer of each setting of a run, without the ways that were skipped."""
    shown = of_run(results)
    return way_answer.answers(over_rows(shown, view), view, shown) if len(shown) else []


def ratios(results: pd.DataFrame, view: View) -> pd.DataFrame:
    """The energy of the network of each answer, of its rivals, and their ratio, by every price list that is installed.

    Columns: setting (of the answer, in words), prices (the list), network, network_nJ; rival (of `KINDS`), its name, nJ
    and kB (its parameters and state); ratio (network / rival). Rows whose energy the results do not hold are left out.
    """
    shown = of_run(results)
    if shown.empty:
        return pd.DataFrame(columns=COLUMNS)
    energies = by_list.energies(shown)
    stored = (shown["weights_bytes"] + shown["states_bytes"]) / 1024 if "states_bytes" in shown else math.nan
    groups = energies.assign(kB=stored).groupby([shown[name] for name in view.by], sort=False, dropna=False)
    spent = groups.mean().reset_index(drop=True)
    rows = [row for outcome in outcomes(results, view) for name in energies for row in _of(outcome, name, spent)]
    return pd.DataFrame(rows, columns=COLUMNS)


def _of(outcome: WayAnswer, prices: str, spent: pd.DataFrame) -> Iterator[dict]:
    network = outcome.spiking
    if network is None:
        return
    nJ = spent[prices]
    near = [one for one in outcome.others if is_within(one.accuracy, network.accuracy, NEAR)]
    counted = [one for one in near if f"{SPIKES}: " not in one.name and not np.isnan(nJ[one.index])]
    rivals = (min(counted, key=lambda one: nJ[one.index], default=None), outcome.baseline)
    for kind, rival in zip(KINDS, rivals, strict=True):
        if rival is not None and not np.isnan(ratio := nJ[network.index] / nJ[rival.index]):
            found = (outcome.setting, prices, network.name, nJ[network.index], kind, rival.name)
            yield dict(zip(COLUMNS, (*found, nJ[rival.index], spent["kB"][rival.index], ratio), strict=True))


def tables(results: pd.DataFrame, view: View) -> dict[str, tuple[Listed, ...]]:
    """Of each answer the best of each kind, and how many times the energy of its rivals the network takes."""
    found, answers = ratios(results, view), outcomes(results, view)
    return {one.setting: (_best(one), *_by_prices(found[found["setting"] == one.setting])) for one in answers}


def _best(outcome: WayAnswer) -> Listed:
    table = first_screen.table_of_configurations(outcome)
    return Listed(table.caption, pd.DataFrame(table.rows, columns=table.columns), table.named)


def _by_prices(rows: pd.DataFrame) -> Iterator[Listed]:
    if rows.empty:
        return
    table = {name: _cells(part) for name, part in rows.groupby("prices", sort=False)}
    caption = (
        "Energy of a decision by each price list, and how many times that of a rival the network takes. The "
        f"cheapest rival is of those on signals, or on events, at most {100 * NEAR:g} points less accurate on test "
        "windows; validation chooses the most accurate."
    )
    yield Listed(caption, pd.DataFrame([{"prices": name, **cells} for name, cells in table.items()]).fillna("-"))


def _cells(rows: pd.DataFrame) -> dict[str, str]:
    first = rows.iloc[0]
    said = {
        one.rival: f"{one.name}: {energy(one.nJ)}, {times(one.ratio)} times" for one in rows.itertuples(index=False)
    }
    return {first["network"]: energy(first["network_nJ"]), **said}


def turns(rows: pd.DataFrame, base: str = ARITHMETIC_45NM.name) -> str:
    """A sentence: under which lists the network costs less than its cheapest rival, or more, other than by `base`.

    rows: of `ratios`, of one setting. Empty where `base` does not count it.
    """
    own = {row.prices: row for row in rows[rows["rival"] == CHEAPEST].itertuples()}
    if base not in own:
        return ""
    ratios = {name: own[name].ratio for name in (base, *(name for name in own if name != base))}
    return turning(ratios, lambda name: _said(own[name], name, own[base])) if len(own) > 1 else ""


def _said(row, name: str, first) -> str:
    """A ratio, with the rival where it is another one than by the first list."""
    return f"{times(row.ratio)} times" if name != first.prices and row.name == first.name else _against(row)


def _against(row) -> str:
    return f"{times(row.ratio)} times the energy of {row.name}"
