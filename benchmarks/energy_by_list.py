"""Energies by every price list, from runs of the comparison studies; runs of the same study count as its seeds.

Writes energy-by-list.csv (networks and their rivals) and ways-by-list.csv (what each way to save leaves), for the runs
that are given, and prints ratios and shares:

    neurotact study run real-sets -o runs/real          # also one-task-all-ways, ways-to-save
    python benchmarks/energy_by_list.py runs/real runs/one runs/saving -o docs/data
"""

import argparse
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from neurotact_parts.studies.comparison import fronts, protocol, real_sets, rivals, together
from neurotact_parts.studies.comparison.skipped import of_run

VIEWS = {"real_sets": real_sets.VIEW, "all_ways": protocol.VIEW}


def results_of(folders: list[Path]) -> dict[str, pd.DataFrame]:
    """The rows of runs, by the way of their study."""
    ways = [tomllib.loads((folder / "study.toml").read_text())["way"] for folder in folders]
    tables = [pd.read_csv(folder / "results.csv") for folder in folders]
    return {way: pd.concat([one for own, one in zip(ways, tables, strict=True) if own == way]) for way in ways}


def of_rivals(results: dict[str, pd.DataFrame]) -> Iterator[pd.DataFrame]:
    for way, view in VIEWS.items():
        if way in results:
            seeds = of_run(results[way])["seed"].nunique()
            yield rivals.ratios(results[way], view).assign(study=way, seeds=seeds)


def of_ways(results: pd.DataFrame) -> Iterator[pd.DataFrame]:
    for name, rows in together.alone(of_run(results)).groupby("set", sort=False):
        yield fronts.energies_of_ways(rows).assign(set=name, seeds=rows["seed"].nunique())


def write(table: pd.DataFrame, first: list[str], path: Path) -> None:
    table = table[[*first, *(name for name in table if name not in first)]]
    table.to_csv(path, index=False, float_format="%.4g")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Energies by every price list, from runs of comparison studies.")
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    parser.add_argument("-o", type=Path, required=True, metavar="FOLDER")
    given = parser.parse_args()
    found = results_of(given.runs)
    if networks := [*of_rivals(found)]:
        table = pd.concat(networks)
        write(table, ["study", "setting", "seeds"], given.o / "energy-by-list.csv")
        ratios = table.pivot_table(index=["study", "setting", "rival"], columns="prices", values="ratio", sort=False)
        print(ratios.map(rivals.times).to_string())
    if "ways_to_save" in found:
        table = pd.concat(of_ways(found["ways_to_save"]))
        write(table, ["set", "seeds"], given.o / "ways-by-list.csv")
        print(table.pivot_table(index=["set", "way"], columns="prices", values="left", sort=False).round(3).to_string())
