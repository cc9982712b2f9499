"""One training step over the widths of a network and the kinds of it, ours beside snnTorch and JAX.

    python benchmarks/widths.py --hidden 16 30 64 65 128 --classes 3 8 17 64 --peers snntorch jax --json widths.json

16 inputs, 300 steps, batch 128, input density 0.12, as the `paper` case of rsnn_training.py, whose sides these are.
"""

import argparse
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import rsnn_training
import torch
from side_by_side import Row, Runner, best_of, missing, publish

PAPER = rsnn_training.CASES["paper"]
KINDS = {
    "recurrent": {},
    "feed-forward": {"recurrent": False},
    "subtract": {"reset": "subtract"},
    "integrator": {"readout": "integrator"},
    "feed-forward integrator": {"recurrent": False, "readout": "integrator"},
    "learned constants": {"learn": ("alpha", "beta", "threshold")},
}


def products(case: rsnn_training.Case) -> list[Callable[[], object]]:
    """No peer but a limit: the products of matrices that no training step can leave out, by BLAS, and nothing else.

    At each step the gradients at all hidden neurons go back through the recurrent weights. Surrogate derivatives are
    nowhere 0, so that this product is dense, whatever spikes. Without recurrence there is none.
    """
    gradient, weights = torch.randn(case.batch, case.hidden), torch.randn(case.hidden, case.hidden)
    back = torch.empty_like(gradient)

    def run() -> object:
        for _ in range(case.steps if case.recurrent else 0):
            torch.mm(gradient, weights, out=back)
        return back

    return [run]


SIDES = {**rsnn_training.PEERS, "products": products}


def rows_of(case: rsnn_training.Case, kind: str, membrane: str, peers: list[str], rounds: int) -> list[Row]:
    threads = sorted({1, os.cpu_count() or 1})
    run, _ = rsnn_training.ours(case, membrane)
    runners = [Runner("ours", run, n) for n in threads]
    there = []
    for peer in peers:
        try:
            found = SIDES[peer](case)
        except (ImportError, AttributeError) as error:
            missing(peer, error)
            continue
        there.append(peer)
        runners += [Runner(peer, run, n) for run in found[:1] for n in (threads if peer != "jax" else threads[-1:])]
    best = best_of(runners, seconds=0.05, rounds=rounds)
    name = f"16-{case.hidden}-{case.classes} {kind}, {membrane}"
    ours_ms, ours_threads = best["ours"]
    note = f"threads {ours_threads}"
    if not there:
        return [Row(name, "none", ours_ms, float("nan"), float("nan"), note)]
    return [Row(name, peer, ours_ms, best[peer][0], best[peer][0] / ours_ms, note) for peer in there]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hidden", type=int, nargs="+", default=[16, 30, 32, 50, 64, 65, 96, 128, 256])
    parser.add_argument("--classes", type=int, nargs="+", default=[3, 8, 16, 17, 32, 64])
    parser.add_argument("--kinds", choices=tuple(KINDS), nargs="+", default=["recurrent", "feed-forward"])
    parser.add_argument("--membranes", choices=("eq4", "delayed", "immediate"), nargs="+", default=["eq4"])
    parser.add_argument("--peers", choices=tuple(SIDES), nargs="*", default=["snntorch", "jax"])
    parser.add_argument("--rounds", type=int, default=5, help="turns of each runner")
    parser.add_argument("--json", type=Path, help="write rows, machine and versions there")
    asked = parser.parse_args()
    rows = [
        row
        for kind in asked.kinds
        for membrane in asked.membranes
        for hidden in asked.hidden
        for classes in asked.classes
        for row in rows_of(
            replace(PAPER, hidden=hidden, classes=classes, **KINDS[kind]), kind, membrane, asked.peers, asked.rounds
        )
    ]
    publish(rows, rsnn_training.PACKAGES, asked.json)


if __name__ == "__main__":
    main()
