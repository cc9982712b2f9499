"""Our rows of docs/public-scores.md, from runs that `neurotact train` wrote with nothing set.

    python benchmarks/public_scores.py runs/letters runs/fabrics runs/cubes -o docs/data

The commands of each run are on the page. Writes public-scores.csv, a row per run: accuracy on its test windows with the
95 % interval over its test trials; parameters, SOPs and the energy of a decision by the default price list, encoder
included; and NeuroBench's columns, empty for a network without a hidden layer, which snnTorch cannot hold.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import pandas as pd

import neurotact as nt
from neurotact.errors import InputError
from neurotact.files import read_json

COLUMNS = (
    "footprint_bytes", "connection_sparsity", "activation_sparsity", "effective_acs", "effective_macs",
    "membrane_updates",
)  # fmt: skip


def row_of(run: Path) -> dict[str, Any]:
    found, told = read_json(run / "result.json"), []
    compared = found["compared"]
    with tempfile.TemporaryDirectory() as folder:
        nt.sops(run, Path(folder) / "sops.csv", tell=told.append)
        costs = next(what for what in told if isinstance(what, pd.DataFrame))
        try:
            counted = nt.export(run, Path(folder) / "scores.csv", "neurobench").iloc[0].to_dict()
        except InputError as refused:
            print(f"{run}: {refused}")
            counted = {}
    whole = costs.iloc[-1]
    return {
        "set": run.name,
        "test_trials": compared["trials"],
        "accuracy": compared["accuracy"],
        "low": compared["low"],
        "high": compared["high"],
        "hidden": read_json(run / "network.json")["spec"]["hidden"],
        "sops": found["row"]["sops_total"],
        "energy_nJ": whole["energy_estimate_nJ"],
        "prices": whole["prices"],
        **{name: counted.get(name) for name in COLUMNS},
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("-o", type=Path, required=True)
    given = parser.parse_args()
    table = pd.DataFrame([row_of(run) for run in given.runs])
    table.to_csv(given.o / "public-scores.csv", index=False, float_format="%.6g", lineterminator="\n")
    print(table.to_string())
