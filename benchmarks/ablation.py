"""Each way to save taken away from all ways together, from runs of `ways-to-save`; runs count as its seeds and sets.

    neurotact study run ways-to-save -o runs/saving
    python benchmarks/ablation.py runs/saving -o docs/data

Writes saving-ablation.csv: a row for all ways together, and one without each, on the seeds whose network has the way.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from energy_by_list import results_of
from neurotact_parts.studies.comparison import by_list, together
from neurotact_parts.studies.comparison.fronts import NOTHING, SOPS, interval_of
from neurotact_parts.studies.comparison.skipped import of_run

LISTS = ("arithmetic-45nm", "memory-45nm")


def left(part: pd.DataFrame, base: pd.DataFrame) -> dict[str, float]:
    """What is left of each cost, in % of the network that saves nothing on the same seeds."""
    costs = [SOPS, *LISTS]
    shares = 100 * part[costs].mean() / base.loc[part.index, costs].mean()
    return {f"{'SOPs' if name == SOPS else name} left, %": float(share) for name, share in shares.items()}


def of_set(rows: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """A row for all ways together, then one without each of them beside all on the same seeds."""
    rows = rows.assign(**by_list.energies(rows)[[*LISTS]]).set_index("seed")
    base, whole = rows[rows["way"] == NOTHING], rows[rows["way"] == together.TOGETHER]
    for way, part in rows[rows["way"].str.startswith(together.TOGETHER)].groupby("way", sort=False):
        beside, lost = (
            interval_of((one.loc[part.index, "accuracy_test"] - part["accuracy_test"]).to_numpy(), part)
            for one in (whole, base)
        )
        of_all = {f"{key}, all together": value for key, value in left(whole.loc[part.index], base).items()}
        yield {
            "way": way,
            "seeds": len(part),
            "accuracy, %": 100 * part["accuracy_test"].mean(),
            "points lost": 100 * lost.mean,
            "points lost, from": 100 * lost.low,
            "points lost, to": 100 * lost.high,
            "points more than all together": 0.0 - 100 * beside.mean,
            **left(part, base),
            **of_all,
        }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    parser.add_argument("-o", type=Path, required=True, metavar="FOLDER")
    given = parser.parse_args()
    rows = of_run(results_of(given.runs)["ways_to_save"])
    parts = [pd.DataFrame(of_set(part)).assign(set=name) for name, part in rows.groupby("set", sort=False)]
    table = pd.concat(parts)[lambda one: ["set", *one.columns.drop("set")]]
    table.to_csv(given.o / "saving-ablation.csv", index=False, float_format="%.4g")
    print(table.round(1).to_string())
