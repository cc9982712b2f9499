"""Many networks trained at once (`networks.population`) and one after another, by the reference and by the kernels.

    python benchmarks/population.py --networks 1 8 32 --json population.json
    python benchmarks/population.py --device cuda --networks 32 256 1024

Windows are random spikes: times depend on shapes and rates, and not on what is learned. Each network has its own size
(20 to 50 hidden neurons) and time constants, as in a search; all have the same batches.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from side_by_side import machine, versions

from neurotact.backend import Backend, native
from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.training import population
from neurotact.networks.training.training import Course, Examples, Training, alone, course

N_INPUTS, N_CLASSES, RATE_Hz, DENSITY = 16, 8, 2000.0, 0.12


def examples(n: int, n_steps: int, seed: int) -> Examples:
    generator = torch.Generator().manual_seed(seed)
    spikes = torch.rand(n, n_steps, N_INPUTS, generator=generator) < DENSITY
    return Examples(spikes.to(torch.uint8), torch.randint(0, N_CLASSES, (n,), generator=generator))


def courses(given: argparse.Namespace, n: int, backend: Backend, device: str) -> list[Course[Training]]:
    training, validation = examples(given.windows, given.steps, 0), examples(given.windows // 4, given.steps, 1)
    found = []
    for seed in range(n):
        net = RSNN(
            N_INPUTS, N_CLASSES, sampling_rate_Hz=RATE_Hz, backend=backend, hidden=20 + seed * 7 % 31,
            tau_mem_ms=10.0 + seed % 30, readout=given.readout,
            training={"epochs": 1, "batch": given.batch, "learning_rate": 1e-3},
            generator=torch.Generator().manual_seed(seed),
        )  # fmt: skip
        found.append(course(net.to(device), training, validation, generator=torch.Generator().manual_seed(seed)))
    return found


def seconds(run: Callable[[], Any], device: str) -> float:
    """Processor time on the CPU, which other programs hardly change with one thread; else time on the wall."""
    clock = time.process_time if device.startswith("cpu") else time.perf_counter
    began = clock()
    run()
    if device.startswith("cuda"):
        torch.cuda.synchronize(device)
    return clock() - began


def measured(given: argparse.Namespace, n: int) -> dict[str, Any]:
    """Seconds of an epoch of `n` networks at once, and of each of a few of them one after another."""
    together = courses(given, n, "reference", given.device)
    few = min(n, given.alone)
    ways: dict[str, Backend] = {"reference": "reference", **({"kernels": "native"} if native is not None else {})}
    row: dict[str, Any] = {"networks": n, "together (s)": seconds(lambda: population.run(together), given.device)}
    row["s/network"] = row["together (s)"] / n
    for name, backend in ways.items():
        lonely = courses(given, few, backend, "cpu")
        row[f"{name}, s/network"] = seconds(lambda lonely=lonely: [alone(each) for each in lonely], "cpu") / few
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", type=int, nargs="+", default=[1, 8, 32])
    parser.add_argument("--device", default="cpu", help="of the networks that are trained together")
    parser.add_argument("--windows", type=int, default=256)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--readout", default="integrator", choices=("count", "integrator", "max"))
    parser.add_argument("--alone", type=int, default=2, help="networks that are trained one after another")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    population.device_of(given.device)
    for each in courses(argparse.Namespace(**{**vars(given), "steps": 5}), 2, "auto", "cpu"):
        alone(each)  # loads what is loaded once
    rows = [measured(given, n) for n in given.networks]
    print("| " + " | ".join(rows[0]) + " |\n|" + "---:|" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(f"{value:.3g}" for value in row.values()) + " |")
    if given.json:
        settings = {key: value for key, value in vars(given).items() if key != "json"}
        found = {"settings": settings, "rows": rows, "machine": machine(), "versions": versions(("torch", "numpy"))}
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"population: {error}") from error
