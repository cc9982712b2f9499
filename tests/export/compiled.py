"""Chains in C, compiled and run here, beside their twins."""

from pathlib import Path

import numpy as np
import torch
from made_chains import make_signal

from neurotact.deploy import c_export, formats, proof
from neurotact.deploy.chain import Chain
from neurotact.deploy.formats import Formats
from neurotact.deploy.proof import Spoken
from neurotact.deploy.twin import said_in_float, said_in_whole_numbers
from neurotact.encoders import specs


def chosen(chain: Chain, signals: list[np.ndarray], **bits) -> Formats:
    """Formats from the ranges of these signals."""
    rasters = [raster_of(chain, signal) for signal in signals]
    length = min(chain.windows.length, *(len(raster) for raster in rasters))
    windows = torch.from_numpy(np.stack([raster[:length] for raster in rasters]))
    return formats.choose(chain, formats.record(chain.network, windows, signals), **bits)


def raster_of(chain: Chain, signal: np.ndarray) -> np.ndarray:
    """Afferent spikes of a signal that is conditioned already; good enough to see how far states go."""
    return specs.encode(signal[None], chain.clock_Hz, chain.encoder)[0][0]


def compare(chain: Chain, folder: Path, formats_: Formats | None, *, flags=("-O1",), n: int = 3, n_samples: int = 150):
    """The first difference between C and its twin over some trials, and what the twin said."""
    folder.mkdir(exist_ok=True, parents=True)
    signals = [make_signal(n_samples - 7 * k, chain.n_taxels, seed=k) for k in range(n)]
    c_export.write(chain, folder, formats_, name="skin", parts=c_export.HARNESS)
    if formats_ is None:
        trials, expected = signals, [said_in_float(chain, signal) for signal in signals]
    else:
        trials = [formats_.raw.samples(signal) for signal in signals]
        expected = said_in_whole_numbers(chain, formats_, trials)
    said = proof.on_host(folder, "skin", trials, flags=flags)
    return proof.first_difference(list(proof.cut_off(said, expected)), expected), expected


def spikes_of(said: list[Spoken]) -> tuple[int, int, int]:
    """How many spikes of afferents and of hidden neurons, and decisions, there were."""
    return (
        sum(len(step) for one in said for step in one.afferents),
        sum(len(step) for one in said for steps in one.hidden.values() for step in steps),
        sum(len(one.decisions) for one in said),
    )
