"""What a refractory period of n steps means, here and elsewhere: the table of docs/refractory-conventions.md.

    python benchmarks/conformance.py --json conformance.json

Each simulator runs one leaky integrate-and-fire neuron (tau_mem 10 ms, threshold 10 mV above rest) on a clock of 0.5 ms
with a refractory period of 5 ms, n = 10 steps. It is driven so hard that one step passes the threshold. What does not
import is left out, with the reason. Norse: pip install --no-deps norse nir nirtorch. Brian2 needs an older numpy: name
a Python that has it in NEUROTACT_BRIAN2_PYTHON.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from side_by_side import machine, missing, versions

DT_ms, TAU_ms, T_REF_ms, GAP_mV = 0.5, 10.0, 5.0, 10.0
N = round(T_REF_ms / DT_ms)
STRONG_mV = 1000.0
"""One step of it passes the threshold: 1 - exp(-0.05) of it is 49 mV."""
NEARLY_mV = 0.9 * GAP_mV / (1 - np.exp(-DT_ms / TAU_ms))
"""One step of it brings a resting neuron nine tenths of the way."""
MODERATE_mV = 20.0
"""Of it a neuron needs ln(2) tau_mem, 13.9 steps, from rest to threshold."""
PACKAGES = ("neurotact", "numpy", "torch", "snntorch", "norse", "nengo", "brian2")
Run = Callable[[np.ndarray], np.ndarray]
"""The steps at which a neuron fires, `(spike,)`, for a drive in mV, `(time,)`."""


class Found(NamedTuple):
    """What one simulator does, all in steps.

    shortest_isi: under the strong drive. resumes: so many steps after a spike a drive moves the membrane again.
    moderate_isi: at constant moderate drive, the shortest and the longest. drift: by how far the last spike of the
    strong drive lies from a whole number of shortest intervals.
    """

    shortest_isi: int
    resumes: int
    moderate_isi: tuple[int, int]
    steps: int
    drift: int


def ours() -> Run:
    from neurotact.encoders.afferents import AfferentSpec, AfferentType, encode

    spec = AfferentSpec(sa1=AfferentType(gain=1.0, t_ref_ms=T_REF_ms), ra1=AfferentType(gain=1.0), tau_mem_ms=TAU_ms)

    def run(drive_mV: np.ndarray) -> np.ndarray:
        spikes, _ = encode(drive_mV[None, :, None], 1e3 / DT_ms, spec)
        return np.flatnonzero(spikes[0, :, 0])

    return run


def snntorch_masked() -> Run:
    """There is no refractory period; a common way to add one is to discard what the neuron sends for n steps."""
    import snntorch
    import torch

    neuron = snntorch.Leaky(beta=float(np.exp(-DT_ms / TAU_ms)), threshold=GAP_mV, reset_mechanism="zero")

    def run(drive_mV: np.ndarray) -> np.ndarray:
        inputs = torch.tensor(drive_mV * (1 - np.exp(-DT_ms / TAU_ms)), dtype=torch.float32)
        membrane, silent, steps = neuron.reset_mem(), 0, []
        with torch.no_grad():
            for t in range(len(inputs)):
                spike, membrane = neuron(inputs[t], membrane)
                if spike.item() and not silent:
                    steps.append(t)
                    silent = N
                else:
                    silent = max(silent - 1, 0)
        return np.array(steps)

    return run


def norse() -> Run:
    """`LIFRefracCell`, its synaptic current so fast that it is gone after a step."""
    import torch
    from norse.torch.functional.lif import LIFParameters
    from norse.torch.functional.lif_refrac import LIFRefracParameters
    from norse.torch.module.lif_refrac import LIFRefracCell

    dt_s = 1e-3 * DT_ms
    parameters = LIFParameters(
        tau_syn_inv=torch.tensor(1.0 / dt_s), tau_mem_inv=torch.tensor(1e3 / TAU_ms), v_th=torch.tensor(GAP_mV)
    )
    cell = LIFRefracCell(LIFRefracParameters(parameters, rho_reset=torch.tensor(float(N))), dt=dt_s)

    def run(drive_mV: np.ndarray) -> np.ndarray:
        inputs, state, steps = torch.tensor(drive_mV, dtype=torch.float32), None, []
        with torch.no_grad():
            for t in range(len(inputs)):
                spike, state = cell(inputs[t].reshape(1, 1), state)
                if spike.item():
                    steps.append(t)
        return np.array(steps)

    return run


def nengo() -> Run:
    """`nengo.LIF`, stepped by itself; its drive is in thresholds."""
    import nengo

    neuron = nengo.LIF(tau_rc=1e-3 * TAU_ms, tau_ref=1e-3 * T_REF_ms)

    def run(drive_mV: np.ndarray) -> np.ndarray:
        state = {"voltage": np.zeros(1), "refractory_time": np.zeros(1)}
        output, steps = np.zeros(1), []
        for t, drive in enumerate(drive_mV / GAP_mV):
            neuron.step(1e-3 * DT_ms, np.array([drive]), output, **state)
            if output[0]:
                steps.append(t)
        return np.array(steps)

    return run


BRIAN2 = """
import sys
import numpy as np
from brian2 import *

folder, dt, tau, t_ref, gap = sys.argv[1], *map(float, sys.argv[2:])
prefs.codegen.target = "numpy"
defaultclock.dt = dt * ms
drive = np.load(folder + "/drive.npy")
D = TimedArray(drive, dt=defaultclock.dt)
group = NeuronGroup(
    1, "dv/dt = (D(t) - v) / (%s * ms) : 1 (unless refractory)" % tau, threshold="v >= %s" % gap, reset="v = 0",
    refractory=t_ref * ms, method="exponential_euler",
)
spikes = SpikeMonitor(group)
run(len(drive) * defaultclock.dt)
np.save(folder + "/steps.npy", np.round(spikes.t / defaultclock.dt).astype(int))
"""


def brian2() -> Run:
    """In a Python of its own; with it the authors of the texture paper encode."""
    python = os.environ.get("NEUROTACT_BRIAN2_PYTHON", sys.executable)
    try:
        subprocess.run([python, "-c", "import brian2"], check=True, capture_output=True)
    except (subprocess.CalledProcessError, OSError) as error:
        raise ImportError(f"{python} cannot import brian2; set NEUROTACT_BRIAN2_PYTHON") from error

    def run(drive_mV: np.ndarray) -> np.ndarray:
        with tempfile.TemporaryDirectory(prefix="neurotact-brian2-") as folder:
            np.save(f"{folder}/drive.npy", drive_mV)
            numbers = map(str, (DT_ms, TAU_ms, T_REF_ms, GAP_mV))
            subprocess.run([python, "-c", BRIAN2, folder, *numbers], check=True, capture_output=True)
            return np.load(f"{folder}/steps.npy")

    return run


SYSTEMS: dict[str, Callable[[], Run]] = {
    "neurotact": ours,
    "Brian2": brian2,
    "Nengo": nengo,
    "Norse": norse,
    "snnTorch, masked": snntorch_masked,
}


def is_felt(run: Run, after: int) -> bool:
    """Whether a drive so many steps after a spike is felt: with a later one, it makes the neuron fire."""
    drive = np.zeros(30 + 3 * N)
    drive[20] = STRONG_mV
    drive[[20 + after, 20 + N + 4]] = NEARLY_mV
    return len(run(drive)) == 2


def examine(run: Run, steps: int) -> Found:
    """Measure one simulator."""
    fired = run(np.full(steps, STRONG_mV))
    intervals = np.diff(fired)
    shortest = int(intervals.min())
    resumes = next(after for after in range(1, N + 4) if is_felt(run, after))
    moderate = np.diff(run(np.full(2000, MODERATE_mV)))
    drift = int(fired[-1] - fired[0] - shortest * len(intervals))
    return Found(shortest, resumes, (int(moderate.min()), int(moderate.max())), steps, drift)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", choices=SYSTEMS, nargs="+", default=list(SYSTEMS))
    parser.add_argument("--steps", type=int, default=1_000_000, help="of the strong drive")
    parser.add_argument("--json", type=Path, help="write the table, machine and versions there")
    asked = parser.parse_args()
    found: dict[str, Found] = {}
    for name in asked.systems:
        try:
            found[name] = examine(SYSTEMS[name](), asked.steps)
        except ImportError as error:
            missing(name, error)
    print("| | shortest ISI | integrates again after | ISI at 20 mV | drift |\n|---|---:|---:|---:|---:|")
    for name, row in found.items():
        low, high = row.moderate_isi
        moderate = f"{low}" if low == high else f"{low} to {high}"
        print(f"| {name} | {row.shortest_isi} | {row.resumes} | {moderate} | {row.drift} in {row.steps:,} |")
    result = {"n": N, "rows": {name: row._asdict() for name, row in found.items()}, "machine": machine()}
    print("versions:", json.dumps(versions(PACKAGES)))
    if asked.json is not None:
        asked.json.write_text(json.dumps(result | {"versions": versions(PACKAGES)}, indent=2) + "\n")


if __name__ == "__main__":
    main()
