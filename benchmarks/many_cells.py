"""A study of many tiny cells: what each costs, and what of it is not training.

    python benchmarks/many_cells.py /tmp/many --cells 1000 [--workers 2]

A network of four neurons is trained for one epoch on twelve touches, for five refractory periods, four sizes and many
seeds. The seconds of `train` in timings.csv are those of all worker processes, so with two a clock has half of them.
Beside other work, compare the seconds of processors: those on a clock are not the study's own.
"""

import argparse
import json
import shutil
from pathlib import Path

import pandas as pd
from large_study import ran

TINY = """
title = "Many tiny cells"
encoder = "sa1-ra1-lif"
network = "rsnn"
[dataset]
simulate = "gratings"
parameters = {{ trials = 6, duration_s = 0.4, pitches_mm = [4.0, 0.5], forces_N = [12.0], speeds_mm_per_s = [8.6] }}
[window]
length_ms = 50.0
[set]
"network.training.epochs" = 1
[sweep]
"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms" = [[1, 1], [2, 2], [3, 3], [4, 4], [5, 5]]
"network.hidden" = [3, 4, 5, 6]
seed = {seeds}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cells", type=int, nargs="+", default=[20, 1000], help="in twenties")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    for n in asked.cells:
        spec, run = asked.folder / f"{n}.toml", asked.folder / f"{n}"
        spec.write_text(TINY.format(seeds=[*range(n // 20)]))
        shutil.rmtree(run, ignore_errors=True)
        took = ran(["study", "run", str(spec), "-o", str(run), "--workers", str(asked.workers)])
        parts = pd.read_csv(run / "timings.csv").groupby("part", sort=False)["seconds"].sum()
        beside = (took.seconds - parts["train"] / asked.workers) / n
        n_bytes = sum(path.stat().st_size for path in (run / "cells").rglob("*") if path.is_file())
        print(f"\n{n} cells: {took.seconds:.1f} s on a clock, {took.computed:.1f} s of processors", end=", ")
        print(f"{json.dumps(parts.round(2).to_dict())}, {n_bytes / n / 1e3:.1f} kB a cell", end=", ")
        print(f"{1e3 * beside:.0f} ms a cell on a clock beside training", flush=True)


if __name__ == "__main__":
    main()
