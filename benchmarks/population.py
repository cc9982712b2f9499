"""How fast a population trains on one GPU: the refractory-period study, a share of the paper's search, the kernels.

    python benchmarks/population.py --folder runs/population --json population.json
    python benchmarks/population.py --compile            # registers and memory of the kernels; needs no GPU

Refuses without a GPU. With TRITON_INTERPRET=1 everything runs in the interpreter, to test this script: its times mean
nothing (`--study tests/studies/tiny.toml --trainings 2 --set window.length_ms=5 ...`).
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from side_by_side import machine, versions

from neurotact import spec
from neurotact.errors import InputError
from neurotact.networks import fitting, tuning
from neurotact.networks.population.devices import device_of, interpreted
from neurotact.networks.population.population import TILE, Batch, Counts, Form, Population, packed
from neurotact.networks.population.training import Asked, Ended, train
from neurotact.networks.tuning import SearchSpec, Tuner
from neurotact.neurons import CubaLIF
from neurotact.studies import loading
from neurotact.studies.device import asked_of
from neurotact.studies.loading import engine_of

SEARCH = 57_600
"""Trainings of the texture paper's search: 6 pairs x 4 sizes x 3 data sets x 800 trials."""
REGISTERS, WARPS, SHARED = 65_536, 64, 233_472
"""Of a processor (SM) of sm_90: registers, warps, bytes of shared memory."""


def searched(asked: Sequence[Asked], n_trainings: int) -> list[Asked]:
    """As many trainings of the paper's search: the same number of random points for each cell (first seeds alone)."""
    first: dict[tuple, Asked] = {}
    for each in asked:
        first.setdefault((id(each.sides), each.spec.hidden), each)
    per_cell = -(-n_trainings // len(first))
    space = {key: value for key, value in tuning.load_space("texture").items() if key != "hidden"}
    found = []
    for number, each in enumerate(first.values()):
        tuner = Tuner(SearchSpec(space=space, tuner="random", trials=per_cell, batch=per_cell, seed=number))
        for proposal in tuner.ask():
            changed = tuning.apply(each.spec, proposal.parameters, "texture")
            found.append(each._replace(spec=changed, seeds=(proposal.id, 10_000 + number)))
    return found


def timed(asked: Sequence[Asked], most: int, device: torch.device) -> dict[str, Any]:
    """Seconds to train these from nothing, up to `most` at once."""
    ended: list[Ended] = []
    wait(device)
    began = time.perf_counter()
    for first in range(0, len(asked), most):
        ended += train([each.member() for each in asked[first : first + most]], device)
    wait(device)
    seconds = time.perf_counter() - began
    epochs = sum(len(each.training.epochs) for each in ended)
    accuracy = [each.training.best.validation_accuracy for each in ended if each.error is None]
    return {
        "trainings": len(asked), "at_once": min(most, len(asked)), "seconds": seconds, "epochs": epochs,
        "failed": len(asked) - len(accuracy), "accuracy_validation": sum(accuracy) / max(1, len(accuracy)),
    }  # fmt: skip


def wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def kernels_alone(asked: Sequence[Asked], n_networks: int, device: torch.device) -> list[dict[str, Any]]:
    """Milliseconds and bytes of one forward and one backward pass of so many networks, a row for each form."""
    rows = []
    forms: dict[Form, list[Asked]] = {}
    for each in asked:
        network, _ = fitting.new_network(each.trains, each.spec, each.seeds, each.sides.train.spikes)
        forms.setdefault(Form.of(network, each.sides.train.spikes.shape[1]), []).append(each)
    for form, members in forms.items():
        networks = [
            fitting.new_network(one.trains, one.spec, (seed, seed), one.sides.train.spikes)[0]
            for seed, one in ((seed, members[seed % len(members)]) for seed in range(n_networks))
        ]
        batch = min(members[0].spec.training.batch, len(members[0].sides.train.labels))
        some = members[0].sides.train.spikes[:batch]
        population = Population(networks, form, packed(some), device)
        numbers = torch.arange(n_networks), torch.arange(batch).expand(n_networks, -1), torch.full((n_networks,), batch)
        work = Batch(*(each.to(torch.int32).contiguous().to(device) for each in numbers))
        counts, tape = population.run(work, keep=True)
        assert tape is not None
        g = Counts(*(torch.ones_like(each) for each in counts))
        forward = best_ms(lambda p=population, w=work: p.run(w, keep=True), device)
        backward = best_ms(lambda p=population, w=work, t=tape, g=g: p.gradients(w, t, g), device)
        kept = sum(each.numel() * 4 for each in tape)
        rows.append(
            {
                "hidden": form.hidden,
                "networks": n_networks,
                "batch": batch,
                "steps": form.steps,
                "forward_ms": forward,
                "backward_ms": backward,
                "tape_bytes": kept,
                "bits_bytes": some.numel() // 8,
                "forward_GB_per_s": kept / forward / 1e6,
                "backward_GB_per_s": kept / backward / 1e6,
                "programs": n_networks * -(-batch // TILE),
            }
        )
    return rows


def best_ms(run, device: torch.device, repeats: int = 5) -> float:
    times = []
    for _ in range(repeats + 1):  # the first compiles
        wait(device)
        began = time.perf_counter()
        run()
        wait(device)
        times.append(1e3 * (time.perf_counter() - began))
    return min(times[1:])


def compiled() -> list[dict[str, Any]]:
    """What the compiler makes of the kernels for sm_90, and how many programs a processor holds for it."""
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    from neurotact.networks.population import kernels

    tools = Path(triton.__file__).parent / "backends" / "nvidia" / "bin"
    rows = []
    for hidden in (16, 32, 64):
        form = Form(16, hidden, 8, 300, CubaLIF(), True)
        for name, kernel, more in (("forward", kernels.forward, {"KEEP": True}), ("backward", kernels.backward, {})):
            constants = {**form.constants(), **more}
            kinds = dict.fromkeys(("spikes", "windows", "members", "sizes", "trials"), "*i32")
            kinds |= dict.fromkeys(("most_trials", "n_steps", "n_inputs", "n_tiles"), "i32")
            kinds |= dict.fromkeys(constants, "constexpr")
            signature = {argument: kinds.get(argument, "*fp32") for argument in kernel.arg_names}
            warps = form.warps[name]
            made = triton.compile(
                ASTSource(fn=kernel, signature=signature, constexprs=constants),
                target=GPUTarget("cuda", 90, 32),
                options={"num_warps": warps, "enable_fp_fusion": False},
            )
            with tempfile.NamedTemporaryFile(suffix=".cubin") as file:
                file.write(made.asm["cubin"])
                file.flush()
                words = [str(tools / "cuobjdump"), "-res-usage", file.name]
                said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
            registers, stack = map(int, re.findall(r"REG:(\d+) STACK:(\d+)", said)[0])
            of_registers = REGISTERS // (-(-registers // 8) * 8 * 32 * warps)
            of_memory = SHARED // (made.metadata.shared + 1024)
            programs = min(of_registers, of_memory, WARPS // warps)
            rows.append(
                {
                    "kernel": name,
                    "hidden": hidden,
                    "warps": warps,
                    "registers": registers,
                    "stack_bytes": stack,
                    "shared_bytes": made.metadata.shared,
                    "programs": programs,
                    "occupancy": programs * warps / WARPS,
                }
            )
    return rows


def table(rows: Sequence[dict[str, Any]]) -> None:
    print("| " + " | ".join(rows[0]) + " |\n|" + "---|" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()))
    print()


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--folder", type=Path, default=Path("runs/population"), help="where the study's spikes are kept"
    )
    parser.add_argument("--study", default="refractory-period")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="changes of the study")
    parser.add_argument("--trainings", type=int, default=2016, help="of the search's 57,600")
    parser.add_argument("--at-once", type=int, default=1024, help="the most networks of a population")
    parser.add_argument("--compile", action="store_true", help="what the compiler makes of the kernels; needs no GPU")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def main() -> None:
    given = arguments()
    if given.compile:
        found: dict[str, Any] = {"compiled": compiled()}
        table(found["compiled"])
    else:
        device = device_of("cuda")
        study = loading.resolve(given.study, spec.parse_assignments(given.set), quick=False)
        engine = engine_of(study)
        engine.prepare(given.folder)
        asked = asked_of(engine, engine.cells(), given.folder)
        share = searched(asked, given.trainings)
        rows = [
            {"what": given.study, **timed(asked, given.at_once, device)},
            {"what": "search", **timed(share, given.at_once, device)},
        ]
        alone = kernels_alone(asked, min(given.at_once, len(asked)), device)
        found = {"trained": rows, "kernels": alone, "interpreted": interpreted()}
        table(rows)
        table(alone)
        hours = rows[1]["seconds"] * SEARCH / len(share) / 3600
        print(f"{SEARCH:,} trainings at the rate of these {len(share):,}: {hours:.2f} h (arithmetic, not measured)")
    found |= {"machine": machine(), "versions": versions(("torch", "triton", "numpy"))}
    if torch.cuda.is_available():
        found["gpu"] = torch.cuda.get_device_name()
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(f"population: {error}", file=sys.stderr)
        sys.exit(2)
