"""Encoding conditioned signals as SA-I and RA-I spikes, ours beside peers.

    python benchmarks/encoding.py --case paper --peers numpy brian2 --json encoding.json

Brian2 runs as a compiled C++ standalone, whose own clock gives the time of its loop alone, without loading. Where it
does not import beside our numpy, name a Python that has it: NEUROTACT_BRIAN2_PYTHON=/path/to/python.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from side_by_side import Row, Runner, best_of, missing, parse, publish

from neurotact.encoders.afferents import AfferentSpec, AfferentType, encode

RATE_HZ = 2000.0
SPEC = AfferentSpec(sa1=AfferentType(gain=3.2, t_ref_ms=2.0), ra1=AfferentType(gain=16.0, t_ref_ms=5.0))
PACKAGES = ("numpy", "torch", "norse", "brian2")


@dataclass(frozen=True)
class Case:
    trials: int
    steps: int = 2000
    taxels: int = 8


CASES = {"paper": Case(4800), "small": Case(480)}


def signals(case: Case) -> np.ndarray:
    """Slow random walks that drive both populations to some 20 spikes a second."""
    steps = np.random.default_rng(0).standard_normal((case.trials, case.steps, case.taxels), dtype=np.float32)
    return np.cumsum(steps, axis=1, dtype=np.float32) * np.float32(0.3)


def numpy_loop(signal: np.ndarray) -> list[Callable[[], object]]:
    """Vectorised over trials and afferents, in place: nothing is allocated in the loop."""
    n_trials, n_steps, n_taxels = signal.shape
    shape = n_trials, 2 * n_taxels
    neurons = SPEC.neuron(SPEC.sa1, RATE_HZ), SPEC.neuron(SPEC.ra1, RATE_HZ)
    decay, rest = np.float32(neurons[0].decay), np.float32(SPEC.v_rest_mV)
    reset, threshold = np.float32(SPEC.v_reset_mV), np.float32(SPEC.v_threshold_mV)
    silent_steps = np.repeat(np.array([n.refractory_steps for n in neurons], np.int16), n_taxels)
    gains = np.float32(SPEC.sa1.gain), np.float32(SPEC.ra1.gain * RATE_HZ * 1e-3)
    out = np.empty((n_trials, n_steps, 2 * n_taxels), np.uint8)
    target, membrane = np.empty(shape, np.float32), np.empty(shape, np.float32)
    silent, asleep, fired = np.empty(shape, np.int16), np.empty(shape, bool), np.empty(shape, bool)

    def run() -> np.ndarray:
        membrane.fill(rest)
        silent.fill(0)
        last = signal[:, 0]
        for t in range(n_steps):
            now = signal[:, t]
            slow, rapid = target[:, :n_taxels], target[:, n_taxels:]
            np.multiply(now, gains[0], out=slow)
            np.subtract(now, last, out=rapid)
            np.abs(rapid, out=rapid)
            np.multiply(rapid, gains[1], out=rapid)
            np.add(target, rest, out=target)
            np.subtract(membrane, target, out=membrane)
            np.multiply(membrane, decay, out=membrane)
            np.add(membrane, target, out=membrane)
            np.greater(silent, 0, out=asleep)
            np.copyto(membrane, reset, where=asleep)
            np.greater_equal(membrane, threshold, out=fired)
            np.copyto(membrane, reset, where=fired)
            np.subtract(silent, asleep, out=silent)
            np.copyto(silent, silent_steps, where=fired)
            out[:, t] = fired
            last = now
        return out

    assert np.array_equal(run(), encode(signal, RATE_HZ, SPEC)[0])
    return [run]


def norse(signal: np.ndarray) -> list[Callable[[], object]]:
    """Its refractory LIF cell, a step at a time, without gradients; the drive is formed for the whole window."""
    import norse.torch as nt

    parameters = nt.LIFRefracParameters(
        lif=nt.LIFParameters(
            tau_mem_inv=torch.tensor(1e3 / SPEC.tau_mem_ms), tau_syn_inv=torch.tensor(RATE_HZ), v_th=torch.tensor(10.0)
        ),
        rho_reset=torch.tensor(float(SPEC.neuron(SPEC.ra1, RATE_HZ).refractory_steps)),
    )
    cell = nt.LIFRefracCell(p=parameters, dt=1 / RATE_HZ)
    x = torch.from_numpy(signal)

    @torch.no_grad()
    def run() -> torch.Tensor:
        out = torch.empty(*x.shape[:2], 2 * x.shape[2], dtype=torch.uint8)
        state, last = None, x[:, 0]
        for t in range(x.shape[1]):
            now = x[:, t]
            drive = torch.cat([SPEC.sa1.gain * now, SPEC.ra1.gain * 2 * (now - last).abs()], dim=1)
            spikes, state = cell(drive, state)
            out[:, t] = spikes
            last = now
        return out

    run()
    return [run]


BRIAN2 = """
import sys
import numpy as np
from brian2 import *

folder, threads = sys.argv[1], int(sys.argv[2])
set_device("cpp_standalone", build_on_run=False)
prefs.devices.cpp_standalone.openmp_threads = threads if threads > 1 else 0
prefs.core.default_float_dtype = float32
prefs.codegen.cpp.extra_compile_args_gcc = ["-w", "-O3", "-ffast-math", "-march=native", "-std=c++11"]
signal = np.load(folder + "/signal.npy")
n_trials, n_steps, n_taxels = signal.shape
rate = float(sys.argv[3])
defaultclock.dt = second / rate
x = TimedArray(np.ascontiguousarray(signal.transpose(1, 0, 2).reshape(n_steps, -1)), dt=defaultclock.dt)
tau = float(sys.argv[4]) * ms
gain_sa, gain_ra, gap = float(sys.argv[5]), float(sys.argv[6]) * rate * 1e-3, float(sys.argv[7])
parts = []
for drive, t_ref in (("gain_sa * x(t, i)", sys.argv[8]), ("gain_ra * abs(x(t, i) - x(t - dt, i))", sys.argv[9])):
    group = NeuronGroup(
        n_trials * n_taxels,
        f"dv/dt = ({drive} - v) / tau : 1 (unless refractory)",
        threshold="v >= gap", reset="v = 0", refractory=float(t_ref) * ms, method="exponential_euler",
    )
    parts += [group, SpikeMonitor(group)]
net = Network(*parts)
net.run(n_steps * defaultclock.dt)
device.build(directory=folder + f"/threads{threads}", compile=True, run=False)
"""


def brian2(signal: np.ndarray) -> list[Callable[[], float]]:
    """Builds the standalone for one thread and for all; each run gives the milliseconds of its own loop."""
    python = os.environ.get("NEUROTACT_BRIAN2_PYTHON", sys.executable)
    try:
        subprocess.run([python, "-c", "import brian2"], check=True, capture_output=True)
    except (subprocess.CalledProcessError, OSError) as error:
        raise ImportError(f"{python} cannot import brian2; set NEUROTACT_BRIAN2_PYTHON") from error
    folder = Path(tempfile.mkdtemp(prefix="neurotact-brian2-"))
    np.save(folder / "signal.npy", signal)
    (folder / "build.py").write_text(BRIAN2)
    gap = SPEC.v_threshold_mV - SPEC.v_rest_mV
    numbers = [RATE_HZ, SPEC.tau_mem_ms, SPEC.sa1.gain, SPEC.ra1.gain, gap, SPEC.sa1.t_ref_ms, SPEC.ra1.t_ref_ms]
    runs = []
    for threads in sorted({1, os.cpu_count() or 1}):
        call = [python, str(folder / "build.py"), str(folder), str(threads), *map(str, numbers)]
        subprocess.run(call, check=True, capture_output=True)
        project = folder / f"threads{threads}"

        def run(project: Path = project) -> float:
            subprocess.run(["./main"], cwd=project, check=True, capture_output=True)
            return 1e3 * float((project / "results" / "last_run_info.txt").read_text().split()[0])

        runs.append(run)
    return runs


PEERS = {"numpy": numpy_loop, "norse": norse, "brian2": brian2}


def rows_of(name: str, peers: list[str], rounds: int) -> list[Row]:
    signal, threads = signals(CASES[name]), sorted({1, os.cpu_count() or 1})
    out = np.empty((*signal.shape[:2], 2 * signal.shape[2]), np.uint8)
    mine = [Runner("ours", lambda: encode(signal, RATE_HZ, SPEC, out=out, backend="native"), n) for n in threads]
    rows = []
    for peer in peers:
        try:
            runs = PEERS[peer](signal)
        except (ImportError, AttributeError) as error:
            missing(peer, error)
            continue
        if peer == "brian2":
            # Its clock, not ours; a run of ours before each of its own.
            ours_ms, peer_ms, note = *_brian2_turns(mine, runs, rounds), "C++ standalone, float32, better of 1 and all"
        else:
            best = best_of([*mine, *(Runner(peer, run, n) for run in runs for n in threads)], 0.2, rounds)
            ours_ms, peer_ms = best["ours"][0], best[peer][0]
            note = f"threads {best['ours'][1]} and {best[peer][1]}"
        share = 1e3 * float(out.mean())
        rows.append(Row(name, peer, ours_ms, peer_ms, peer_ms / ours_ms, f"{note}; {share:.0f} spikes in 1000 steps"))
    return rows


def _brian2_turns(mine: list[Runner], runs: list[Callable[[], float]], rounds: int) -> tuple[float, float]:
    times: list[list[float]] = [[] for _ in runs]
    ours = []
    for _ in range(rounds):
        ours.append(best_of(mine, 0.2, 1)["ours"][0])
        for run, taken in zip(runs, times, strict=True):
            taken.append(run())
    return float(np.median(ours)), min(float(np.median(taken)) for taken in times)


def main() -> None:
    asked = parse(tuple(CASES), tuple(PEERS), __doc__ or "")
    rows = [row for name in asked.case for row in rows_of(name, asked.peers, asked.rounds)]
    publish(rows, PACKAGES, asked.json)


if __name__ == "__main__":
    main()
