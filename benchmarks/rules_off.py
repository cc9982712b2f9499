"""What the rules of the network's family and of the encoder's baseline gain: each one off, on the same splits.

    python benchmarks/rules_off.py runs/rules -o docs/data [--seeds 0 1 2 3 4] [--sets ...] [--rules ...]

Runs the study `recipe-ablation` with these rules on, and off: 50 hidden neurons in place of the smallest network that
no larger one clearly beats, and a fixed baseline in place of a chosen one. Writes rules-off.csv. Finished runs are not
run again.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from neurotact_parts.studies.comparison import by_list
from neurotact_parts.studies.comparison.fronts import SOPS, interval_of
from neurotact_parts.studies.comparison.recipe_ablation import WHOLE
from neurotact_parts.studies.comparison.skipped import of_run

import neurotact as nt

SETS = ("gratings", "fabrics", "cubes", "letters")
EVENTS = ("letters",)
SMALLEST = {"from the smallest up": {"direct": "auto"}}
BASELINES = ("none", "start", "high-pass")
LISTS = ("arithmetic-45nm", "memory-45nm")


def results_of(name: str, seeds: list[int], folder: Path, changes: dict[str, Any]) -> pd.DataFrame:
    """The rows of a run of `recipe-ablation` on one set, by change and seed, with the energy by each list."""
    settings = {"sweep.data.set": [name], "sweep.seed": seeds, "parameters.without": {}, "parameters.instead": {}}
    rows = of_run(nt.run_study("recipe-ablation", folder, settings | changes, workers=1))
    return rows.assign(**by_list.energies(rows)[[*LISTS]]).set_index("seed")


def row(name: str, change: str, rows: pd.DataFrame, rule: pd.DataFrame) -> dict[str, Any]:
    """A row of the table: what a change loses to the rule, seed by seed. rows, rule: by seed."""
    lost = interval_of((rule["accuracy_test"] - rows["accuracy_test"]).to_numpy(), rows)
    names = ("points lost", "points lost, from", "points lost, to")
    costs = [SOPS, *LISTS]
    shares = 100 * rows[costs].mean() / rule[costs].mean()
    return {
        "set": name,
        "change": change,
        "seeds": len(rows),
        "accuracy, %": 100 * rows["accuracy_test"].mean(),
        **({} if rows is rule else dict(zip(names, 100 * np.array(lost), strict=True))),
        **{f"{'SOPs' if cost == SOPS else cost}, %": share for cost, share in shares.items()},
    }


def of_family(name: str, seeds: list[int], folder: Path) -> Iterator[dict[str, Any]]:
    """The rows of a set with the rule of the family, and with 50 hidden neurons."""
    rows = results_of(name, seeds, folder / f"{name}-family", {"parameters.instead": SMALLEST})
    rule, fixed = (rows[rows["change"] == change] for change in (*SMALLEST, WHOLE))
    yield row(name, "the rule of the family", rule, rule)
    yield row(name, "50 hidden neurons", fixed, rule)


def of_baseline(name: str, seeds: list[int], folder: Path) -> Iterator[dict[str, Any]]:
    """The rows of a set with the rule of the baseline, and with each baseline."""
    if name in EVENTS:
        return
    key = f"parameters.data.sets.{name}"
    rule = results_of(name, seeds, folder / f"{name}-chosen", {f"{key}.choose_baseline": True})
    yield row(name, "the rule of the baseline, 50 hidden neurons", rule, rule)
    for baseline in BASELINES:
        changes = {f"{key}.conditioning.baseline": baseline}
        yield row(name, f"baseline {baseline}", results_of(name, seeds, folder / f"{name}-{baseline}", changes), rule)


RULES = {"family": of_family, "baseline": of_baseline}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--sets", nargs="+", default=SETS)
    parser.add_argument("--rules", nargs="+", default=RULES, choices=RULES)
    given = parser.parse_args()
    of_each = ((RULES[rule], name) for rule in given.rules for name in given.sets)
    table = pd.DataFrame([one for rows, name in of_each for one in rows(name, given.seeds, given.folder)])
    table.to_csv(given.o / "rules-off.csv", index=False, float_format="%.4g")
    print(table.round(1).to_string())
