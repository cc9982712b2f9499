"""New classes from a few touches on the device itself, as `neurotact learn` learns them on a computer.

The readout and the inverse that recursive least squares needs are state. All of it is computed in float64, and the
inverse, which is symmetric, is kept by its lower triangle: as many bytes as of the whole in float32. The weights that
decide are rounded to float32, as `neurotact learn` saves them.
"""

import logging
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.exporters.c import boards
from neurotact_parts.exporters.c.c_export import Table, wrapped
from neurotact_parts.networks import new_class
from neurotact_parts.streams.chain import Chain

from neurotact.errors import InputError
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training.run_folder import Restored

log = logging.getLogger("neurotact")


class Teachable(NamedTuple):
    """A chain whose readout is refitted, that readout, and how many classes it may learn."""

    chain: Chain
    readout: new_class.Readout
    n_new: int

    def context(self) -> dict[str, Any]:
        """The variables of the templates, in place of those of the chain."""
        network, n_classes = self.chain.network, self.chain.network.n_classes + self.n_new
        size = len(self.readout.weights)
        tables = (
            ("inverse", "Inverse of the sum of squares of old touches: its lower triangle by rows.",
             self.readout.inverse[np.tril_indices(size)]),
            ("moment", "Weighted sum of old touches.", self.readout.moment),
            ("weights", "Weights to the known classes, one row for each that is heard and one for 1.",
             self.readout.weights.ravel()),
        )  # fmt: skip
        return {
            "n_new": self.n_new, "n_classes": n_classes, "n_features": size - 1,
            "heard": len(network.w_out), "touch_weight": float(self.readout.each).hex(),
            "taught_tables": [
                Table(about, "double", f"first_{name}", len(values), [*wrapped(float(v).hex() for v in values)])
                for name, about, values in tables
            ],
        }  # fmt: skip

    def bytes(self) -> tuple[int, int]:
        """What learning takes of RAM and of flash, without code."""
        size, known = self.readout.weights.shape
        n_classes = known + self.n_new
        counts = self.chain.windows.at_once * (size - 1) * (2 if self.chain.windows.length < 2**16 else 4)
        kept, rounded = 8 * (size * (size + 1) // 2 + size), 4 * (size - 1) + 8
        return kept + (8 * size + rounded) * n_classes + counts, kept + 8 * size * known


def teachable(restored: Restored, chain: Chain, n_new: int) -> Teachable:
    """A chain that can learn so many classes, without early exit and refusal, which were chosen for its old readout.

    InputError for a network whose readout cannot be refitted.
    """
    if n_new < 1:
        raise InputError(f"new_classes: must be at least 1; got {n_new}")
    if chain.network.synapses:
        raise InputError(
            "new_classes: a refitted readout has every synapse, and the network is pruned; train it without sparsity"
        )
    readout = new_class.teachable(restored)[1]
    network = new_class.with_readout(chain.network, readout)
    return Teachable(chain._replace(network=network, rule=FULL_WINDOW), readout, n_new)


def warn(made: Teachable) -> str:
    """What learning takes, in words; a warning of the chips that have no room for it."""
    ram, flash = made.bytes()
    chips = [board.chip for board in boards.BOARDS.values()]
    full = [chip for chip in chips if ram > chip.ram or flash > chip.flash]
    said = f"learning takes {ram / 1024:.1f} kB of RAM and {flash / 1024:.1f} kB of flash"
    if full:
        rooms = " and ".join(f"{chip.name} ({chip.ram // 1024} kB and {chip.flash // 1024} kB)" for chip in full)
        log.warning("%s, more than on %s: use fewer hidden neurons, or readout_stretches = 1.", said, rooms)
    return f"{said}; early exit and refusal, chosen for the old readout, are not used"
