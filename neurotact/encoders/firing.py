"""Checks of an encoder on its data: afferents are not silent, not saturated and not refractory for a whole trial."""

import math
from collections.abc import Iterator

import numpy as np

from neurotact.data.spikes import populations_of
from neurotact.encoders.knobs import field_of
from neurotact.encoders.mechanoreceptor import LEAST_PC_Hz
from neurotact.encoders.specs import EncoderSpec, afferent_names, described, dotted, is_exact, populations, taxels_of
from neurotact.errors import InputError
from neurotact.spec import Spec

SATURATED = 0.9
"""Share of the highest rate that a refractory period allows; above it, the rate no longer follows the drive."""


class FiringWarning(UserWarning):
    """Warning about an encoder that does not fit its data.

    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", FiringWarning)  # a silent population ends the script
    """


def check_periods(encoder: EncoderSpec, trial_s: float) -> None:
    """InputError if a refractory period is as long as the shortest trial, which lasts `trial_s`.

    >>> from neurotact.encoders.specs import load
    >>> check_periods(load("sa1-ra1-lif", {"sa1.t_ref_ms": 20}), trial_s=0.01)
    Traceback (most recent call last):
    neurotact.errors.InputError: sa1.t_ref_ms: 20 ms is not shorter than the shortest trial, which lasts 10 ms; shorten it
    """  # noqa: E501
    for population in populations(encoder):
        t_ref_ms = described(encoder, population).t_ref_ms
        if t_ref_ms >= 1e3 * trial_s:
            key = dotted(population.part, "t_ref_ms")
            raise InputError(
                f"{key}: {t_ref_ms:g} ms is not shorter than the shortest trial, which lasts {1e3 * trial_s:g} ms; "
                "shorten it"
            )


def check_rate(encoder: EncoderSpec, sampling_rate_Hz: float) -> None:
    """InputError if an encoder has PC afferents and its recordings are too slow to contain what these feel.

    Resampling to a faster clock adds nothing to them.
    """
    if getattr(encoder, "pc", None) is not None and sampling_rate_Hz < LEAST_PC_Hz:
        raise InputError(
            f"pc: PC afferents need recordings of {LEAST_PC_Hz:g} Hz or more; these have {sampling_rate_Hz:g} Hz; "
            "leave pc out"
        )


def complaints(counts: np.ndarray, n_steps: int, clock_Hz: float, encoder: EncoderSpec) -> Iterator[str]:
    """A sentence for each population that is silent, or all of whose firing afferents are saturated.

    counts: spikes of each afferent in `n_steps` steps of the clock, `(afferent,)`, in the order of its output.

    >>> from neurotact.encoders.specs import load
    >>> list(complaints(np.array([0, 3]), n_steps=1000, clock_Hz=1000.0, encoder=load("sa1-ra1-lif")))
    ['no SA-I afferent fires in any trial; raise sa1.gain, or find gains for this sensor with neurotact calibrate']
    """
    table = encoder.model_dump()
    n_taxels = taxels_of(len(counts), table)
    of_each = populations_of(afferent_names([""] * n_taxels, table))
    for population in populations(encoder):
        name, part, fired = population.name, population.part, counts[of_each[population.name]]
        kind = described(encoder, population)
        silent_steps = max(0, math.ceil(kind.t_ref_ms * 1e-3 * clock_Hz - 1e-9))
        highest_Hz = clock_Hz / max(1, silent_steps + (not is_exact(encoder)))
        rates_Hz = fired[fired > 0] * clock_Hz / n_steps
        if not len(rates_Hz):
            yield f"no {name} afferent fires in any trial; {_remedy('raise', part, kind)}"
        elif rates_Hz.min() > SATURATED * highest_Hz:
            yield (
                f"every {name} afferent that fires does so at over {SATURATED:.0%} of the {highest_Hz:g} Hz that its "
                f"t_ref allows; {_remedy('lower', part, kind)}"
            )


def _remedy(verb: str, part: str, kind: Spec) -> str:
    """The remedy for a population that fires too little or too much; not every model has a gain or a threshold."""
    key = field_of(kind)
    if key is None:
        return f"change the keys of {part}" if part else "change the keys of the encoder"
    if key.startswith("threshold"):
        verb = {"raise": "lower", "lower": "raise"}[verb]
    return f"{verb} {dotted(part, key)}, or find gains for this sensor with neurotact calibrate"
