"""From recordings to spike trains: unit, conditioning and afferents of one encoder spec."""

from collections.abc import Callable, Iterable

import numpy as np

from neurotact.data.conditioning import condition
from neurotact.data.digests import recorded_digests
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.encoders.afferents import afferent_names
from neurotact.encoders.specs import EncoderSpec, encode
from neurotact.studies import firing

CHUNK_SAMPLES = 8_000_000


def encode_recordings(
    recordings: Recordings, spec: EncoderSpec, progress: Callable[[int], None] | None = None
) -> SpikeTrains:
    """Spike trains of whole trials.

    progress: called with the number of trials done since its last call.
    Raises InputError where the unit, the sampling rate, the taxels or the trials' length do not suit the spec.

    >>> import pandas as pd
    >>> from neurotact.encoders.specs import load
    >>> skin = Recordings([np.zeros((400, 8))], 2000.0, "mV", pd.DataFrame({"label": ["felt"]}))
    >>> trains = encode_recordings(skin, load("sa1-ra1-lif"))
    >>> len(trains), len(trains.afferents), int(trains.trial_steps[0])
    (1, 16, 400)
    """
    rasters: list[np.ndarray] = []
    rate_Hz = recordings.sampling_rate_Hz
    firing.check_periods(spec, min(map(len, recordings.signals)) / rate_Hz)
    for chunk in _chunks(recordings):
        felt = condition(recordings.select(chunk).to_unit(spec.unit), **spec.conditioning.model_dump())
        rate_Hz = felt.sampling_rate_Hz
        if isinstance(felt.signals, np.ndarray):
            rasters += list(encode(felt.signals, rate_Hz, spec, trials=chunk)[0])
        else:
            alone = zip(felt.signals, chunk, strict=True)
            rasters += [encode(signal[None], rate_Hz, spec, trials=trial[None])[0][0] for signal, trial in alone]
        if progress:
            progress(len(chunk))
    names = afferent_names(recordings.channels)
    encoder = spec.model_dump(mode="json", exclude_none=True)
    digests = recorded_digests(recordings)
    return from_rasters(rasters, rate_Hz, names, recordings.conditions, encoder, recordings.source, digests)


def _chunks(recordings: Recordings) -> Iterable[np.ndarray]:
    """Consecutive trials whose samples fit in memory several times over."""
    samples = np.array([s.size for s in recordings.signals])
    chunk_of = np.cumsum(samples) // CHUNK_SAMPLES
    return (np.flatnonzero(chunk_of == c) for c in np.unique(chunk_of))
