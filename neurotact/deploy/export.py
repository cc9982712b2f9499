"""From a run folder to an export: the chain, and for whole numbers its formats from the training trials."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurotact.data import hdf5
from neurotact.deploy import fine_tuning, formats
from neurotact.deploy.chain import Chain, chain_of
from neurotact.deploy.formats import Formats, Ranges, Steps
from neurotact.errors import InputError
from neurotact.networks import tasks, trained

WEIGHT_BITS = 8
"""Of a network that was not fine-tuned for others."""
MOST_TRIALS = 256
"""Of the training trials, as many are looked at for the range of samples."""


class Exported(NamedTuple):
    """A chain, and its formats where it computes in whole numbers."""

    chain: Chain
    formats: Formats | None


class Recorded(NamedTuple):
    """What ranges are taken from, and what an export is tried on: signals of trials and their classes.

    training, test: signals `(sample, taxel)` in the encoder's unit. labels: class indices of the test trials.
    """

    training: list[np.ndarray]
    test: list[np.ndarray]
    labels: np.ndarray


def prepared(
    run: str | Path,
    *,
    integer: bool = True,
    recordings: str | Path | None = None,
    weight_bits: int | None = None,
    state_bits: int | None = None,
    lsb: float | None = None,
    **options: Any,
) -> Exported:
    """The chain of a run folder, ready to be written as C; options as for `chain_of`.

    integer: in whole numbers. recordings: that the run was trained on, where they moved since.
    weight_bits, state_bits, lsb: as for `formats.choose`; absent, weights of a fine-tuned run have the bits and steps
    that it was fine-tuned for, others 8 bits.
    """
    if not integer:
        return Exported(chain_of(run, **options), None)
    restored = trained.restore(run)
    signals = recorded(restored, recordings)
    if "sampling_rate_Hz" not in options or options["sampling_rate_Hz"] is None:
        options["sampling_rate_Hz"] = _rate(restored, recordings)
    chain = chain_of(run, **options)
    ranges = ranges_of(restored, chain, signals.training)
    return Exported(chain, formats.choose(chain, ranges, lsb=lsb, **_whole(restored, weight_bits, state_bits)))


def _whole(restored: trained.Restored, weight_bits: int | None, state_bits: int | None) -> dict[str, Any]:
    """Bits and steps of the weights and bits of the states, as asked for or as the run was fine-tuned for.

    With other weight bits, or fewer state bits, its weights are rounded again.
    """
    tuned = fine_tuning.tuned_of(restored)
    if tuned is None:
        return {"weight_bits": weight_bits or WEIGHT_BITS, "state_bits": state_bits}
    bits = {"weight_bits": weight_bits or tuned.weight_bits, "state_bits": state_bits or tuned.state_bits}
    keeps = bits["weight_bits"] == tuned.weight_bits and bits["state_bits"] >= tuned.state_bits
    return {**bits, "steps": Steps(*tuned.steps) if keeps else None}


def ranges_of(restored: trained.Restored, chain: Chain, training: list[np.ndarray]) -> Ranges:
    """Ranges of samples and of states, from the training trials and windows of a run."""
    trains = trained.load_spikes_of(restored)
    return formats.record(chain.network, tasks.sides_of(trains, restored.task).train.spikes, training)


def recorded(restored: trained.Restored, recordings: str | Path | None = None) -> Recorded:
    """The signals of a run's training and test trials, in the encoder's unit.

    Raises InputError where the recordings are not those that the run's spikes were encoded from.
    """
    trains = trained.load_spikes_of(restored)
    path = Path(recordings or trains.source)
    if recordings is None and not path.is_file():
        raise InputError(
            f"recordings: {trains.source or 'those of the run'} is not there; ranges are taken from what the run was "
            "trained on: name it with --recordings"
        )
    unit = str((restored.encoder or {}).get("unit", "mV"))
    split = tasks.trials_of(trains, restored.task)
    seen = split.train[np.linspace(0, len(split.train) - 1, min(len(split.train), MOST_TRIALS)).astype(int)]
    with hdf5.open_recordings(path) as stored:
        if len(stored) != len(trains) or list(stored.labels) != list(trains.labels):
            raise InputError(f"{path}: is not what the run's spikes were encoded from; name that with --recordings")
        parts = [list(stored.select(each).loaded().to_unit(unit).signals) for each in (seen, split.test)]
    return Recorded(parts[0], parts[1], trains.labels[split.test])


def _rate(restored: trained.Restored, recordings: str | Path | None) -> float | None:
    """Of samples, where the encoder resamples: that of the recordings."""
    resampled = ((restored.encoder or {}).get("conditioning") or {}).get("resample_Hz")
    if resampled is None:
        return None
    with hdf5.open_recordings(recordings or trained.load_spikes_of(restored).source) as stored:
        return stored.sampling_rate_Hz


def rate_of(restored: trained.Restored, recordings: str | Path | None = None) -> float:
    """Samples per second of what a run was trained on."""
    return _rate(restored, recordings) or restored.network.sampling_rate_Hz
