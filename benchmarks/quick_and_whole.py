"""How often a first look (`own-recordings --quick`) says something else than the whole study.

    python benchmarks/quick_and_whole.py runs/quick-and-whole -o docs/data [--sets fabrics clear ...]

Each set, real ones in $NEUROTACT_DATA among them, is run twice: as a first look, and whole, but with the pairs and the
one split of the first look and three seeds (`REDUCED`), on at most `MOST` trials, evenly spaced within each class.
Finished studies are not run again.
Writes quick-and-whole.csv, a row per set, and prints how often what is said differs.
"""

import argparse
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from made_sets import SETS, touches
from steady_choices import READ, recordings_of

import neurotact as nt
from neurotact.data.recordings import Recordings
from neurotact.data.trial_choice import fewer_trials
from neurotact.files import read_json

REDUCED = {"sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": "auto equal", "sweep.seed": [0, 1, 2]}
MOST = 240
REAL = (*READ, "icub", "gratings")
MADE = ("clear", "unclear", "nothing", "few", "slow", "fast")
CLAIMS = {"better", "worse", "nothing learned"}
"""Kinds of answers that claim something; the others say that these trials cannot tell."""
FACTOR = 1.5
"""Ratios of energies that differ by less say the same."""
UNSURE = "cannot tell"
PERIODS = {"Use ": "use", "No refractory period pays": "none pays", "These recordings cannot tell": UNSURE}
"""What is said of refractory periods, by how the sentence begins."""


def of_set(name: str) -> Recordings:
    """The recordings of a set, at most `MOST` trials."""
    if name == "gratings":
        every = nt.simulate("gratings", trials=MOST // 48)
    else:
        every = touches(SETS[name]) if name in SETS else recordings_of(name)
    assert isinstance(every, Recordings)
    fewer = fewer_trials(every, MOST)
    assert isinstance(fewer, Recordings)
    return fewer


def answer_of(name: str, folder: Path, *, quick: bool) -> dict[str, Any]:
    """The answer of a study of a set; the study is run first if it was not run before."""
    data, run = folder / f"{name}.h5", folder / f"{name}-{'quick' if quick else 'whole'}"
    if not (run / "answer.json").is_file():
        nt.save(of_set(name), data, force=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            nt.run_study("own-recordings", run, data=data, quick=quick, settings={} if quick else REDUCED)
    return read_json(run / "answer.json")["answers"][0]


def said(answer: dict[str, Any]) -> dict[str, Any]:
    """What an answer says, in a few values."""
    networks, rival = answer["networks"], answer["comparable"]
    best, cheapest = networks[answer["best"]], networks[answer["cheapest"]]
    used = best["early" if best["used"] == "early exit" else "whole"]
    return {
        "kind": answer["kind"],
        "best": best["pair"],
        "cheapest": cheapest["pair"],
        "period": next(said for begins, said in PERIODS.items() if answer["period"].startswith(begins)),
        "accuracy": used["accuracy"],
        "rival": "" if rival is None else rival["name"],
        "ratio": np.nan if rival is None else used["nJ"] / rival["nJ"],
        "of_rival": np.nan if answer["baseline"] is None else answer["baseline"]["accuracy"],
    }


def compared(name: str, folder: Path) -> dict[str, Any]:
    """A row of the table: what both say, and where they differ."""
    quick, whole = (said(answer_of(name, folder, quick=quick)) for quick in (True, False))
    ratios = np.array([quick["ratio"], whole["ratio"]])
    is_near = bool(np.isnan(ratios).all() or abs(np.log(ratios[0] / ratios[1])) <= np.log(FACTOR))
    return {
        "set": name,
        **{f"{key}_{which}": one[key] for key in quick for which, one in (("quick", quick), ("whole", whole))},
        "same_kind": quick["kind"] == whole["kind"],
        "claims_otherwise": quick["kind"] in CLAIMS and quick["kind"] != whole["kind"],
        "periods_otherwise": quick["period"] not in (UNSURE, whole["period"]),
        "same_cheapest": quick["cheapest"] == whole["cheapest"],
        "same_rival": quick["rival"] == whole["rival"],
        "near_ratio": is_near,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--sets", nargs="+", default=[*MADE, *REAL])
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame([compared(name, given.folder) for name in given.sets])
    table.to_csv(given.o / "quick-and-whole.csv", index=False, float_format="%.4g")
    print(table.to_string())
    print(table.select_dtypes(bool).sum(), len(table))
