"""Simulated grasps and real presses of the same laboratory's patch in one figure.

`python -m neurotact.papers.stiffness.beside_real -o stiffness-signals.png` reads `$NEUROTACT_DATA/pvdf-hardness`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurotact.data.readers import pvdf_hardness
from neurotact.data.recordings import Recordings
from neurotact.data.sources import expand
from neurotact.figures.style import save
from neurotact.papers.stiffness import simulator
from neurotact.papers.stiffness.figures import draw_beside_real
from neurotact.papers.stiffness.simulator import StiffnessSpec

DATA = "$NEUROTACT_DATA/pvdf-hardness"
SHOWN_TAXELS = 4
"""Channels to draw of a press, as many as the gripper has: those with the largest deviation."""


def liveliest(signal: np.ndarray, n: int = SHOWN_TAXELS) -> np.ndarray:
    """The `n` channels of `(time, channel)` that deviate most, in their own order.

    >>> liveliest(np.array([[0.0, 5.0, 1.0], [0.0, -5.0, 0.0]]), 2).tolist()
    [[5.0, 1.0], [-5.0, 0.0]]
    """
    return signal[:, np.sort(np.argsort(-signal.std(axis=0), kind="stable")[:n])]


def first_of_each(recordings: Recordings, labels: Sequence[str], n: int = SHOWN_TAXELS) -> dict[str, np.ndarray]:
    """The first trial of each label in mV, minus its median, its most active channels; `(time, channel)` by label."""
    found = recordings.to_unit("mV")
    of = found.conditions["label"].astype(str).to_numpy()
    signals = {label: np.asarray(found.signals[int(np.flatnonzero(of == label)[0])], float) for label in labels}
    return {label: liveliest(signal - np.median(signal, axis=0), n) for label, signal in signals.items()}


def main(arguments: list[str] | None = None) -> int:
    """Draw the figure."""
    parser = argparse.ArgumentParser(prog="python -m neurotact.papers.stiffness.beside_real", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("stiffness-signals.png"), help="the figure")
    parser.add_argument("--data", default=DATA, help="folder of the published presses")
    given = parser.parse_args(arguments)
    grasps = simulator.simulate(StiffnessSpec(grasps=1))
    presses = pvdf_hardness.read(expand(given.data))
    cubes = list(dict.fromkeys(presses.conditions["label"].astype(str)))
    objects = list(dict.fromkeys(grasps.conditions["label"].astype(str)))
    shown = [cubes[at] for at in np.linspace(0, len(cubes) - 1, len(objects)).round().astype(int)]
    simulated = {f"simulated, {label}": signal for label, signal in first_of_each(grasps, objects).items()}
    real = {f"real, {label}": signal for label, signal in first_of_each(presses, shown).items()}
    save(draw_beside_real(simulated, real, grasps.sampling_rate_Hz), given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
