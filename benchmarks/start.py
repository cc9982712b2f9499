"""How long a command takes to begin: processor seconds (user and system, one thread), the least of some runs.

    python benchmarks/start.py --repeats 3

A loaded machine changes them less than seconds on a clock.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

COMMANDS = (
    "--help", "list", "show sa1-ra1-lif", "fetch", "train --help", "tune --help", "save --help", "infer --help",
    "conditions-curve --help", "fine-tune --help", "export --help", "stream --help", "live --help", "calibrate --help",
    "encode --help", "study run --help", "simulate --help", "import --help", "import table --help",
    "import table touches.csv --unit mV --time-column t_ms -o touches.h5 --force", "info touches.h5",
    "encode touches.h5 -o spikes.h5 --force", "info spikes.h5",
)  # fmt: skip
TRAINING = """
import torch
from neurotact.networks.definition import optimisers
optimisers.state_shapes("Adam", (2, 3))
"""
STUDY = """
import tempfile
import neurotact as nt
nt.run_study("tiny.toml", tempfile.mkdtemp(dir="."))
"""
TINY = """
title = "Tiny"
encoder = "sa1-ra1-lif"
network = "rsnn"
[dataset]
simulate = "gratings"
parameters = { trials = 6, duration_s = 0.4, pitches_mm = [4.0, 0.5], forces_N = [12.0], speeds_mm_per_s = [8.6] }
[window]
length_ms = 50.0
[set]
"network.training.epochs" = 1
[sweep]
"network.hidden" = [4]
seed = [0]
"""
"""A cell; of a study only its own process counts, and not the server of processes, which loads torch for all."""


def seconds(words: list[str], folder: str) -> float:
    """Processor seconds of a process and of its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, *words], cwd=folder, check=True, capture_output=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    repeats = range(parser.parse_args().repeats)
    named = {command: ["-m", "neurotact", *command.split()] for command in COMMANDS}
    scripts = {"import neurotact": "import neurotact", "import torch": "import torch", "first Adam": TRAINING}
    scripts["own process of a study"] = STUDY
    named |= {name: ["-c", script] for name, script in scripts.items()}
    with tempfile.TemporaryDirectory() as folder:
        rows = [f"{trial},{'ab'[trial % 2]},{row},{trial + row % 7}" for trial in range(12) for row in range(60)]
        (Path(folder) / "touches.csv").write_text("\n".join(["trial,label,t_ms,p1", *rows]))
        (Path(folder) / "tiny.toml").write_text(TINY)
        print("| what | s |\n|---|---|")
        for name, words in named.items():
            print(f"| {name} | {min(seconds(words, folder) for _ in repeats):.2f} |", flush=True)


if __name__ == "__main__":
    main()
