"""A new class from five touches: each class of a set is left out of a training in turn, and then learned.

    python benchmarks/new_class.py /tmp/new-class -o docs/data [--epochs 40]

FabricSlide of $NEUROTACT_DATA, encoded as `calibrate` and `encode` do, the default network with 20 hidden neurons.
Writes new-class.csv: of each fabric the accuracy on the other six before, with the refitted readout and after, and on
the touches of the new one that were not learned; and beside them a network that was trained on all fabrics.
"""

import argparse
import os
from pathlib import Path

import numpy as np
import pandas as pd

import neurotact as nt
from neurotact.data.spikes import SpikeTrains

TOUCHES = 5
WINDOW = nt.Window(length_ms=2000)


def spikes_of(folder: Path) -> SpikeTrains:
    """The spikes of all fabrics, made once."""
    path = folder / "spikes.h5"
    if not path.is_file():
        data = Path(os.environ.get("NEUROTACT_DATA", "../shared/data"))
        touches = nt.read("fabricslide", data / "fabricslide")
        nt.save(nt.encode(touches, nt.calibrate(touches)), path)
    found = nt.load(path)
    assert isinstance(found, SpikeTrains)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", type=Path, default=Path("docs/data"))
    parser.add_argument("--epochs", type=int, default=40)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    trains, settings = spikes_of(given.folder), {"hidden": 20, "training.epochs": given.epochs}
    if not (given.folder / "every" / "result.json").is_file():
        nt.train(given.folder / "spikes.h5", given.folder / "every", settings=settings, window=WINDOW, force=True)
    whole = nt.infer(given.folder / "every", given.folder / "spikes.h5", test_only=True)
    rows = []
    for name in trains.classes:
        is_new = (trains.conditions["label"] == name).to_numpy()
        for part, at in (("known", ~is_new), ("new", is_new)):
            nt.save(trains.select(np.flatnonzero(at)), given.folder / f"{part}.h5", force=True)
        nt.train(given.folder / "known.h5", given.folder / "run", settings=settings, window=WINDOW, force=True)
        row = nt.learn(
            given.folder / "run", given.folder / "new.h5", given.folder / "learned", touches=TOUCHES, force=True
        )
        right = (whole["label"] == whole["predicted"])[whole["label"] == name]
        shown = {key: row[key] for key in ("old_before", "old_refitted", "old_after", "new", "new_low", "new_high")}
        rows.append({"fabric": name, **shown, "trained_on": float(right.mean())})
        print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    table.round(4).to_csv(given.o / "new-class.csv", index=False, lineterminator="\n")
    print(table.mean(numeric_only=True).round(3).to_dict())


if __name__ == "__main__":
    main()
