"""Chains in C, compiled and run here, beside their twins."""

from pathlib import Path

import numpy as np
import torch
from made_chains import make_chain, make_signal
from neurotact_parts.exporters.c import c_export, formats, proof
from neurotact_parts.exporters.c.boards import Board
from neurotact_parts.exporters.c.formats import Formats
from neurotact_parts.exporters.c.proof import Spoken
from neurotact_parts.exporters.c.proving import twin_of
from neurotact_parts.streams.chain import Chain
from neurotact_parts.studies.stiffness.reader import VOLTS_PER_ADC_COUNT

from neurotact.encoders import specs
from neurotact.networks.training.ranges import record


def chosen(chain: Chain, signals: list[np.ndarray], **bits) -> Formats:
    """Formats from the ranges of these signals."""
    rasters = [raster_of(chain, signal) for signal in signals]
    length = min(chain.windows.length, *(len(raster) for raster in rasters))
    windows = torch.from_numpy(np.stack([raster[:length] for raster in rasters]))
    return formats.choose(chain, record(chain.network, windows, signals), **bits)


def raster_of(chain: Chain, signal: np.ndarray) -> np.ndarray:
    """Afferent spikes of a signal that is conditioned already; good enough to see how far states go."""
    return specs.encode(signal[None], chain.clock_Hz, chain.encoder)[0][0]


def given_to(chain: Chain, n_samples: int, seed: int = 0) -> np.ndarray:
    """A trial of a made signal, or of the spikes of a network that takes events."""
    if chain.takes_events:
        return (np.random.default_rng(seed).random((n_samples, chain.n_taxels)) < 0.3).astype(np.float32)
    return make_signal(n_samples, chain.n_taxels, seed=seed)


def compare(chain: Chain, folder: Path, formats_: Formats | None, *, flags=("-O1",), n: int = 3, n_samples: int = 150):
    """The first difference between C and its twin over some made trials, and what the twin said."""
    signals = [given_to(chain, n_samples - 7 * k, seed=k) for k in range(n)]
    return compare_on(signals, chain, folder, formats_, flags=flags)


def compare_on(
    signals: list[np.ndarray],
    chain: Chain,
    folder: Path,
    formats_: Formats | None,
    *,
    flags=("-O1",),
    board: Board | None = None,
):
    """The same over these trials; on a board in the emulator, if one is given."""
    folder.mkdir(exist_ok=True, parents=True)
    c_export.write(chain, folder, formats_, name="skin", parts=c_export.HARNESS)
    trials, expected, *_ = twin_of(chain, formats_, signals, np.zeros(len(signals), int), None)
    if board is None:
        said = proof.on_host(folder, "skin", trials, flags=flags)
    else:
        said, _ = proof.on_board(folder, "skin", trials, board)
    return proof.first_difference(list(proof.cut_off(said, expected)), expected), expected


def pressed(data_folder: Path) -> tuple[Chain, list[np.ndarray]]:
    """A chain with SA-I of both polarities under 8 taxels, and 1.5 s of two real presses in mV.

    A press is a negative peak and its release a positive one.
    """
    chain = make_chain(
        {"baseline": "start", "ema_cutoff_Hz": 30.0}, rate_Hz=2000.0, n_taxels=8, windows={"length_ms": 150},
        afferents={"sa1.opposite": True, "sa1.gain": 15.0, "ra1.gain": 150.0}, forward_weight_scale=1.0, patience=60,
    )  # fmt: skip
    with np.load(data_folder / "pvdf-hardness" / "cube03.npz") as stored:
        counts = [stored[key][4000:7000] for key in ("c03_s1_v300_t01_adc", "c03_s1_v300_t02_adc")]
    return chain, [(1e3 * VOLTS_PER_ADC_COUNT * each).astype(np.float32) for each in counts]


def kinds_of(said: list[Spoken], chain: Chain) -> set[int]:
    """Which afferents of a taxel spiked: 0 is the first SA-I."""
    return {afferent // chain.n_taxels for one in said for step in one.afferents for afferent in step}


def spikes_of(said: list[Spoken]) -> tuple[int, int, int]:
    """How many spikes of afferents and of hidden neurons, and decisions, there were."""
    return (
        sum(len(step) for one in said for step in one.afferents),
        sum(len(step) for one in said for steps in one.hidden.values() for step in steps),
        sum(len(one.decisions) for one in said),
    )
