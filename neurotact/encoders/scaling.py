"""The scaling of taxels in calibration: each by its own deviation, unless it is noise compared with others."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import f_oneway

from neurotact.data.conditioning import Baseline, pieces
from neurotact.data.recordings import Trials
from neurotact.errors import InputError

REST_SD = 2.0
"""Without a baseline, a taxel's rest is this many standard deviations below its mean level."""
QUIET = 0.1
"""A taxel with less than this share of the largest deviation is quiet: small, noise, or without contact."""
CHANCE, SHARE = 0.01, 0.1
"""A quiet taxel separates classes if the p-value is below this, and classes explain at least this share of the
variance between trials."""
ROUNDING = 1e-5
"""Changes below this share of a taxel's level are float32 rounding."""


class Scaling(NamedTuple):
    """Offset and scale of each taxel, and the quiet taxels.

    offset: `(taxel,)`, None if a baseline is the zero. scale: `(taxel,)`.
    small: names of quiet taxels that separate classes, and are scaled as all others. noise: those that do not.
    """

    offset: tuple[float, ...] | None
    scale: tuple[float, ...]
    small: tuple[str, ...]
    noise: tuple[str, ...]


class Spread(NamedTuple):
    """What a scaling takes from the excerpts, `(taxel,)` each.

    mean, scale: the rest above which each taxel's signal is measured in deviations. noise, small: as in `Scaling`.
    """

    names: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    noise: np.ndarray
    small: np.ndarray

    def scaling(self, baseline: Baseline, *, inverted: bool = False, rest_sd: float = REST_SD) -> Scaling:
        """Scale each taxel by its standard deviation over the excerpts.

        A baseline already defines each trial's zero, so nothing more is subtracted. Without one, the level itself
        drives SA-I: measured from the mean, it would silence SA-I in every trial of less than mean pressure.

        inverted: the scales are negative. rest_sd: a taxel's rest without a baseline, in deviations below its mean.
        """
        scale = self.scale * (-1 if inverted else 1)
        rest = np.where(self.noise, self.mean, self.mean - rest_sd * scale)
        small, noise = (tuple(self.names[which].tolist()) for which in (self.small, self.noise))
        return Scaling(_short(rest) if baseline == "none" else None, _short(scale), small, noise)


def highest_of(recorded: Trials) -> np.ndarray:
    """The largest magnitude of each taxel as recorded, `(taxel,)`."""
    return np.max([np.abs(x).max(axis=0) for trial in range(len(recorded)) for x in pieces(recorded, trial)], axis=0)


def spread_of(recorded: Trials, excerpts: Sequence[np.ndarray], highest: np.ndarray) -> Spread:
    """What a scaling takes from the excerpts, `(time, taxel)`, one per trial; each is read once, quiet taxels twice.

    A quiet taxel counts as noise, and is scaled by a tenth of the largest deviation so that it stays small,
    unless its level, its deviation or its change between samples differs between the classes: a sensor may have
    channels of another kind, with tens of counts instead of thousands.

    recorded: the recorded trials. highest: of `highest_of` them.
    Raises InputError for constant signals.
    """
    lengths, means, deviations, least, most = np.stack([_moments(signal) for signal in excerpts], axis=1)
    weights = lengths / lengths.sum(axis=0)
    mean = (weights * means).sum(axis=0)
    scale = np.sqrt((weights * (deviations**2 + (means - mean) ** 2)).sum(axis=0))
    scale[scale <= 1e-12 * np.maximum(1.0, np.abs(mean))] = 1.0
    still = np.maximum(most.max(axis=0) - mean, mean - least.min(axis=0)) <= ROUNDING * highest
    if still.all():
        raise InputError(
            f"{recorded.source or 'recordings'}: the conditioned training trials are constant, so there is nothing to "
            "calibrate on; check the sensor, the columns that were read and the encoder's baseline"
        )
    liveliest = scale[~still].max()
    noise = quiet = still | (scale < QUIET * liveliest)
    if (quiet & ~still).any():
        noise = quiet.copy()
        noise[quiet] = ~tells_classes((signal[:, quiet] for signal in excerpts), recorded.labels)
    scale = np.where(noise, QUIET * liveliest, scale)
    return Spread(np.array(recorded.channels), mean, scale, noise, quiet & ~noise)


def tells_classes(excerpts: Iterable[np.ndarray], labels: np.ndarray) -> np.ndarray:
    """Whether a taxel differs between classes, `(taxel,)` bool.

    Three numbers of each excerpt `(time, taxel)` are compared: the mean level, and the logarithms of the deviation and
    of the mean change between samples. One of them is enough: F test (p below `CHANCE`, over the three) and the
    share of the variance between trials that classes explain (adjusted for their number, `SHARE` or more). False if no
    test is possible, as with one trial per class.

    >>> rng = np.random.default_rng(0)
    >>> labels = np.repeat([0, 1], 20)
    >>> excerpts = [np.stack([rng.normal(label, 1, 50), rng.normal(0, 1, 50)], axis=1) for label in labels]
    >>> tells_classes(excerpts, labels).tolist()
    [True, False]
    """
    features = np.array([_features(np.asarray(signal, np.float64)) for signal in excerpts])
    classes = [features[labels == label] for label in np.unique(labels)]
    n_trials, n_classes = len(features), len(classes)
    if n_classes < 2 or n_trials <= n_classes:
        return np.zeros(features.shape[2], bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = np.asarray(f_oneway(*classes, axis=0).pvalue)
        within = sum(((trials - trials.mean(axis=0)) ** 2).sum(axis=0) for trials in classes) / (n_trials - n_classes)
        share = 1 - within / features.var(axis=0, ddof=1)
    return ((p < CHANCE / len(p)) & (share >= SHARE)).any(axis=0)


def _features(signal: np.ndarray) -> np.ndarray:
    """Level, log of deviation and log of change of each taxel, `(3, taxel)`."""
    tiny = np.finfo(np.float64).tiny
    change = np.abs(np.diff(signal, axis=0)).mean(axis=0) if len(signal) > 1 else np.zeros(signal.shape[1])
    return np.stack([signal.mean(axis=0), np.log(signal.std(axis=0) + tiny), np.log(change + tiny)])


def _moments(signal: np.ndarray) -> np.ndarray:
    """Length, mean, deviation, minimum and maximum of each taxel, `(5, taxel)`.

    In float64, from the first sample, so that a constant has no deviation; a taxel's samples lie side by side.
    """
    first = signal[0].astype(np.float64)
    by_taxel = np.subtract(signal.T, first[:, None], dtype=np.float64, order="C")
    mean, least, most = by_taxel.mean(axis=1), by_taxel.min(axis=1), by_taxel.max(axis=1)
    by_taxel -= mean[:, None]
    deviation = np.sqrt(np.einsum("ij,ij->i", by_taxel, by_taxel) / len(signal))
    return np.stack([np.full(len(first), len(signal)), first + mean, deviation, first + least, first + most])


def _short(values: np.ndarray) -> tuple[float, ...]:
    """The same float32 numbers with as few digits as possible."""
    return tuple(float(str(value)) for value in values.astype(np.float32))
