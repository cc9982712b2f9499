"""The exporter of the chip XyloAudio 2."""

from pathlib import Path

from neurotact.lazily import lazily
from neurotact.networks.use.exporters import Exporter
from neurotact.progress import Tell, untold

with lazily():
    from neurotact_parts.exporters.xylo import chip, export

    from neurotact.networks.use import fitted


def export_xylo(
    run: "fitted.Fitted",
    path: str | Path,
    *,
    prove: int = 0,
    spikes: str | Path | None = None,
    force: bool = False,
    tell: Tell = untold,
) -> "chip.Chip":
    """Write the network of a run as a JSON file of the arguments of Rockpool's `XyloSim.from_specification`.

    The file holds the network alone, in the chip's neurons and bits (`conversion`). Each conversion is named.
    run: the folder. prove: run this many test trials in our integers and in XyloSim, where it is installed, and compare
    every spike and state, and the decisions with those of `infer`.
    spikes: that the run was trained on, where they moved since. force: replace a file.
    Raises InputError for a network that does not fit, and for a file that exists.

    >>> chip = export_xylo("run", "chip.json")  # doctest: +SKIP
    """
    return export.export(run, path, prove, spikes, force=force, tell=tell)


EXPORTER = Exporter("a JSON file for Rockpool: the network in the bits of the chip XyloAudio 2", export_xylo)
