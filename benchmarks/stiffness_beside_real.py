"""Simulated grasps and real presses of the same laboratory's patch in one figure.

`python benchmarks/stiffness_beside_real.py -o stiffness-signals.png` reads `$NEUROTACT_DATA/pvdf-hardness`.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from neurotact_parts.studies.stiffness import reader as pvdf_hardness
from neurotact_parts.studies.stiffness import simulator
from neurotact_parts.studies.stiffness.figures import channel_colour
from neurotact_parts.studies.stiffness.simulator import StiffnessSpec

from neurotact.data.conditioning import ema, ema_coefficient
from neurotact.data.dataset import expand
from neurotact.data.recordings import Recordings
from neurotact.figures.style import add_legend, new_figure, printed, save

DATA = "$NEUROTACT_DATA/pvdf-hardness"
SHOWN_TAXELS = 4
"""Channels to draw of a press, as many as the gripper has: those with the largest deviation."""
SMOOTHING_Hz = 30.0
"""Cut-off of the moving average in the sensor's electronics (texture paper, Sec. II-A)."""


@printed
def draw_beside_real(simulated: Mapping[str, np.ndarray], real: Mapping[str, np.ndarray], rate_Hz: float) -> Figure:
    """Simulated grasps above, real presses below: pale as recorded, dark after a moving average at 30 Hz.

    simulated, real: `(time, channel)` in mV by title, equally many of both; one colour per channel.
    """
    figure = new_figure(4.4)
    grid = figure.subplots(2, len(simulated), sharey="row", squeeze=False)
    for line, found in zip(grid, (simulated, real), strict=True):
        for axes, (title, signal) in zip(line, found.items(), strict=True):
            time_s = np.arange(len(signal)) / rate_Hz
            smoothed = ema(signal.astype(float), ema_coefficient(SMOOTHING_Hz, rate_Hz))
            for channel in range(signal.shape[1]):
                colour = channel_colour(channel)
                axes.plot(time_s, signal[:, channel], color=colour, lw=0.4, alpha=0.35)
            for channel in range(signal.shape[1]):
                style: Any = {"color": channel_colour(channel), "lw": 1.0}
                axes.plot(time_s, smoothed[:, channel], label=f"channel {channel + 1}", **style)
            axes.set(title=title, xlabel="time (s)")
            axes.grid(axis="y")
        highest = 1.15 * max(float(np.abs(line_of.get_ydata()).max()) for axes in line for line_of in axes.lines[-4:])
        line[0].set(ylabel="signal (mV)", ylim=(-highest, highest))
    add_legend(figure, grid.ravel(), ncols=4, handlelength=1.4)
    return figure


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
    parser = argparse.ArgumentParser(prog="python benchmarks/stiffness_beside_real.py", description=__doc__)
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
