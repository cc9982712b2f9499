"""Peak memory of `encode` and `calibrate` over the size of the recordings.

    python benchmarks/memory.py --sizes-MB 100 500 1000 2000

Writes recordings of each size into a temporary folder, as many trials of 1.5 s and as few long ones, runs the command
line in processes of their own and prints the most memory that each of them held. `--source FOLDER` runs the
neurotact in another folder, to compare versions.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

RATE_HZ, N_TAXELS = 2000.0, 8
TRIAL_STEPS = 3000
RUN = "from neurotact.cli import main; main()"
CASES = (("encode", "many"), ("encode", "one"), ("calibrate", "many"), ("calibrate", "eight"))
"""Each command, and in how many trials the recordings are; calibration needs several of each class."""


def write(path: Path, n_bytes: int, n_trials: int | None) -> None:
    """Recordings of two textures that slide under eight taxels; trials of TRIAL_STEPS where no number is given."""
    n_samples = n_bytes // (4 * N_TAXELS)
    n_trials = n_trials or max(8, n_samples // TRIAL_STEPS)
    lengths = np.full(n_trials, n_samples // n_trials)
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        file.attrs["kind"] = "recordings"
        file.attrs["sampling_rate_Hz"] = RATE_HZ
        file.attrs["unit"] = "mV"
        file.attrs["channels"] = json.dumps([f"taxel{i + 1}" for i in range(N_TAXELS)])
        file.attrs["source"] = "benchmark"
        values = file.create_dataset("signals/values", (lengths.sum(), N_TAXELS), np.float32)
        at_once = 250_000
        for start in range(0, len(values), at_once):
            step = np.arange(start, min(start + at_once, len(values)))
            frequency_Hz = np.where(step // lengths[0] % 2 == 0, 20.0, 45.0)
            wave = 4.0 * np.sin(2 * np.pi * frequency_Hz * step / RATE_HZ)
            noise = rng.normal(0, 0.3, (len(step), N_TAXELS))
            values[step[0] : step[-1] + 1] = wave[:, None] * np.linspace(1.0, 0.5, N_TAXELS) + noise
        file["signals/lengths"] = lengths
        conditions = file.create_group("conditions")
        conditions.attrs["columns"] = json.dumps(["label"])
        labels = np.array(["coarse", "fine"], object)[np.arange(n_trials) % 2]
        conditions.create_dataset("label", data=labels, dtype=h5py.string_dtype())


def peak_of(arguments: list[str], source: Path | None) -> tuple[float, float]:
    """Most resident memory in MB, and seconds, of one call of the command line; its own output is not shown."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NEUROTACT_MAX_MB": "100000"}
    began = time.perf_counter()
    child = subprocess.Popen(  # of what is imported, the folder that it runs in comes first
        [sys.executable, "-c", RUN, *arguments],
        env=environment, cwd=source, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    said = child.stderr.read().decode() if child.stderr else ""
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{' '.join(arguments)}: exit code {child.returncode}\n{said}")
    return usage.ru_maxrss * 1024 / 1e6, time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes-MB", type=int, nargs="+", default=[100, 500, 1000, 2000])
    parser.add_argument("--source", type=Path, help="the folder of another neurotact")
    asked = parser.parse_args()
    print(f"neurotact list, which reads nothing: {peak_of(['list'], asked.source)[0]:.0f} MB\n")
    print("| command | trials | recordings (MB) | peak memory (MB) | time (s) |\n| --- | --- | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as folder:
        for size_MB in asked.sizes_MB:
            for command, shape in CASES:
                recordings, out = Path(folder) / "touch.h5", Path(folder) / "out"
                write(recordings, size_MB * 1_000_000, {"many": None, "one": 1, "eight": 8}[shape])
                peak_MB, seconds = peak_of([command, str(recordings), "-o", str(out)], asked.source)
                print(f"| {command} | {shape} | {size_MB} | {peak_MB:.0f} | {seconds:.0f} |", flush=True)
                out.unlink()


if __name__ == "__main__":
    main()
