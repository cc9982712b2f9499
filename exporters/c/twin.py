"""The expected output of a chain in C for a trial: every spike and decision, from the twin in Python."""

from collections.abc import Sequence

import numpy as np
import torch
from neurotact_parts.exporters.c import integer
from neurotact_parts.exporters.c.formats import Formats
from neurotact_parts.exporters.c.proof import Spoken, spoken_of

from neurotact.data.conditioning import Conditioner
from neurotact.deploy.chain import Chain
from neurotact.encoders import afferents


def said_in_whole_numbers(chain: Chain, formats: Formats, trials: Sequence[np.ndarray]) -> list[Spoken]:
    """The output for trials of raw samples `(sample, taxel)` int16, together: shorter ones are padded and cut."""
    lengths = np.array([len(trial) for trial in trials])
    padded = np.stack(
        [np.concatenate([trial, np.repeat(trial[-1:], lengths.max() - len(trial), axis=0)]) for trial in trials]
    )
    rasters = integer.encode(padded, formats.front, lengths)
    spikes = [
        raster[: integer.n_steps(n_samples, formats.front)]
        for raster, n_samples in zip(rasters, lengths.tolist(), strict=True)
    ]
    cut, n = [_windows(chain, raster) for raster in spikes], chain.network.steps_per_bin
    made = integer.infer(np.concatenate([windows for _, windows in cut]), formats, chain.network.neuron, chain.rule, n)
    decided = np.stack([made.labels, made.steps, made.input_spikes, made.hidden_spikes, made.heard], axis=1)
    ends = np.cumsum([len(starts) for starts, _ in cut])[:-1]
    parts = zip(spikes, cut, np.split(made.hidden, ends), np.split(decided, ends), strict=True)
    return [spoken_of(raster, starts, hidden, rows, n) for raster, (starts, _), hidden, rows in parts]


@torch.no_grad()
def said_in_float(chain: Chain, trial: np.ndarray) -> Spoken:
    """The output for a whole trial of samples `(sample, taxel)` float32, in the encoder's unit."""
    conditioner = Conditioner(chain.sampling_rate_Hz, chain.encoder.conditioning)
    raster = afferents.encode(conditioner.whole(trial)[None], chain.clock_Hz, chain.lif)[0][0]
    starts, windows = _windows(chain, raster)
    inputs = torch.from_numpy(windows)
    made, (hidden, readout) = chain.network.infer(inputs, chain.rule), chain.network.simulate(inputs)
    n = chain.network.steps_per_bin
    is_simulated = torch.arange(hidden.shape[1]) * n < made.steps[:, None]
    fired = ((readout != 0).any(dim=2) & is_simulated).any(dim=1).long()
    decided = torch.stack([made.labels, made.steps, made.input_spikes, made.hidden_spikes, fired], dim=1)
    return spoken_of(raster, starts, hidden.numpy(), decided.numpy(), n)


def _windows(chain: Chain, raster: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    starts, length = chain.windows.starts(raster), chain.windows.length
    shape = (0, length, raster.shape[1])
    return starts, np.stack([raster[i : i + length] for i in starts]) if len(starts) else np.zeros(shape, np.uint8)
