"""The encoder keys of a calibrated study: a key that calibration would ignore is refused, with the reason.

Calibration starts from the encoder of each cell and finds gains, standardisation and the baseline. All pairs of
refractory periods share one fit and its gains.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from neurotact.data.conditioning import ACAUSAL, check_used
from neurotact.encoders.model import EncoderSpec
from neurotact.encoders.sensitivity import sensitivities_of
from neurotact.encoders.specs import BY_CALIBRATION, FITTED, PAST
from neurotact.errors import InputError
from neurotact.spec import leaves, refuse
from neurotact.studies import sweeps

ENCODER = "encoder."
CONDITIONING = f"{ENCODER}conditioning"
_DECIDED = f"{BY_CALIBRATION}, or set calibrate=false"
DECIDED = {f"{ENCODER}{key}": _DECIDED for key in FITTED}
GRADES = ("encoder.sa1.grades", "encoder.ra1.grades")


def is_period(key: str) -> bool:
    """Whether a key of a study is a refractory period, which can be swept without a new fit of the gains.

    >>> is_period("encoder.sa1.t_ref_ms"), is_period("encoder.t_ref_ms"), is_period("encoder.sa1.gain")
    (True, True, False)
    """
    return key.startswith(ENCODER) and key.endswith(".t_ref_ms")


def start(point: Mapping[str, Any]) -> dict[str, Any]:
    """The changes of a point of the sweep to the encoder from which calibration starts, as keys of the cell.

    >>> start({"encoder.tau_mem_ms": 5.0, "encoder.sa1.t_ref_ms": 5, "seed": 0})
    {'calibrate.tau_mem_ms': 5.0}
    """
    changed = {key: value for key, value in point.items() if key.startswith(ENCODER) and not is_period(key)}
    return {f"calibrate.{key.removeprefix(ENCODER)}": value for key, value in changed.items()}


def check(given: Mapping[str, Any], sweep: Mapping[str, list[Any]], starts: Sequence[EncoderSpec]) -> None:
    """InputError for a key that is set or swept and that calibration would ignore.

    given: dotted keys that are set. starts: the encoder from which each cell is calibrated; empty without calibration.
    """
    if not starts:
        return
    swept = {key: sweeps.values(sweep, key) for key in sweeps.keys(sweep)}
    pairs = [*given.items(), *((key, value) for key, values in swept.items() for value in values)]
    for named in (leaves({key: value}) for key, value in pairs if key != "encoder"):
        refuse(
            named,
            DECIDED
            | {f"{ENCODER}{sensitivity.key}": _DECIDED for first in starts for sensitivity in sensitivities_of(first)},
        )
        _check_baseline(named.get("encoder.conditioning.baseline"))
    for key in GRADES:
        lengths = [len(grades) for grades in swept.get(key, []) if isinstance(grades, list)]
        if len(set(lengths)) < len(lengths):
            raise InputError(
                f"{key}: calibration replaces the grades but not their number, so lists of the same length give the "
                "same encoder; sweep lists of different lengths"
            )
    keys = {*leaves(given), *swept}
    for first in starts:
        baseline = first.conditioning.baseline
        gives_way = {f"{CONDITIONING}.start_ms"} if baseline in ACAUSAL else set()  # to `start`, perhaps
        check_used(keys - gives_way, baseline, CONDITIONING)


def _check_baseline(baseline: Any) -> None:
    if baseline in ACAUSAL:
        raise InputError(
            f"encoder.conditioning.baseline: '{baseline}' uses the whole trial, and a study that calibrates "
            f"replaces it by one of {', '.join(PAST)}; name a causal baseline, or leave it out"
        )
