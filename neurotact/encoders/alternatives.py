"""Comparison of baselines, polarities and rectification by how well the calibrated spikes separate the classes."""

from collections.abc import Callable
from itertools import product
from typing import Any, Literal, NamedTuple

import pandas as pd

from neurotact.data.conditioning import ACAUSAL, Baseline
from neurotact.data.recordings import Trials
from neurotact.encoders.calibration import Calibration, calibrate
from neurotact.encoders.gain_search import CalibrationRule, Progress
from neurotact.encoders.model import DrivenSpec, EncoderSpec
from neurotact.errors import InputError
from neurotact.metrics.decision import Decision

BASELINES: tuple[Baseline, ...] = ("none", "start", "high-pass", "mean")
Polarity = Literal["rising", "falling", "both"]
POLARITIES: tuple[Polarity, ...] = ("rising", "falling", "both")
"""The drive of SA-I: the signal's rise above the baseline, its fall below, or both (rectified)."""
COMPARED: dict[str, str] = dict.fromkeys(
    ("conditioning.baseline", "conditioning.rectify"),
    "`compare` tries all of them and would ignore a given value; leave out one of the two",
)
"""Keys of an encoder that a comparison decides."""
COARSE = {"candidates": 12, "step": 1.25**2, "trials_per_class": 24, "shuffles": 4}
"""Changes of the rule for the comparison: the range of the full search in half as many steps, on fewer trials."""


class _Compared(NamedTuple):
    """Each alternative, the most accurate first, and the calibration of the one that was chosen.

    table: baseline, polarity, accuracy (`Calibration.accuracy`), separation_sa and separation_ra (bit, at the chosen
    gains), acausal (whether windows contain information from later samples), chosen, and why_not (empty if it could be
    calibrated).
    """

    table: pd.DataFrame
    best: Calibration[Any]


def n_steps(rule: CalibrationRule) -> int:
    """The number of calls of `progress` by `compare`."""
    return len(BASELINES) * len(POLARITIES) * COARSE["candidates"] + rule.candidates


def compare(
    recordings: Trials,
    spec: EncoderSpec,
    progress: Progress | None = None,
    rule: CalibrationRule = CalibrationRule(),
    apart: tuple[str, ...] = (),
    group: tuple[str, ...] = (),
) -> _Compared:
    """Calibrate with each baseline and polarity, and in full with the causal one that is chosen.

    The table begins with the highest accuracy of logistic regression on the SA-I rates of training trials (ties: the
    better separation by ISIs). The first causal one, in the order of `BASELINES` and `POLARITIES`, within one standard
    error of the best is chosen. RA-I responds to changes of either sign, so polarity does not affect it.
    apart, group: as for `calibrate`.
    Raises InputError if no alternative can be calibrated, and for an encoder with both polarities.
    """
    if not isinstance(spec, DrivenSpec):
        raise InputError(f"compare: chooses a polarity of SA-I, and '{spec.model}' has its own drives; leave it out")
    if spec.is_signed:
        raise InputError("compare: chooses a polarity, and this encoder has both (sa1.opposite); leave one of them out")
    coarse = rule.model_copy(update=COARSE)
    between: dict[str, Any] = {"apart": apart, "group": group}
    rows, n_trials = [], 0
    for baseline, polarity in product(BASELINES, POLARITIES):
        row = {"baseline": baseline, "polarity": polarity, "acausal": baseline in ACAUSAL, "why_not": ""}
        counted = _Counted(progress, f"{baseline}, {polarity}")
        try:
            fitted = _with(recordings, spec, baseline, polarity, counted.advance, coarse, **between, tell=False)
            row["accuracy"], n_trials = fitted.accuracy, len(fitted.labels)
            row |= {f"separation_{kind}": _separation(fitted, name) for kind, name in (("sa", "SA-I"), ("ra", "RA-I"))}
        except InputError as error:
            row |= {
                "accuracy": float("nan"),
                "separation_sa": float("nan"),
                "separation_ra": float("nan"),
                "why_not": str(error),
            }
        counted.finish(coarse.candidates)
        rows.append(row)
    by = ["accuracy", "separation_sa"]
    table = pd.DataFrame(rows).sort_values(by, ascending=False, kind="stable", ignore_index=True)
    causal = table[~table["acausal"] & table["separation_sa"].notna()]
    if causal.empty:
        raise InputError(str(table["why_not"].iloc[0]) or "recordings: no causal baseline can be calibrated")
    names = {(baseline, polarity): row for row, baseline, polarity in causal[["baseline", "polarity"]].itertuples()}
    accuracy = {names[one]: causal.accuracy[names[one]] for one in product(BASELINES, POLARITIES) if one in names}
    found = Decision.of_shares("conditioning.baseline", accuracy, n_trials)
    best = causal.index[0] if causal.accuracy.isna().all() else found.chosen
    table["chosen"] = table.index == best
    first = table.loc[best]
    return _Compared(table, _with(recordings, spec, first["baseline"], first["polarity"], progress, rule, **between))


def _with(
    recordings: Trials,
    spec: EncoderSpec,
    baseline: Baseline,
    polarity: Polarity,
    progress: Progress | None,
    rule: CalibrationRule,
    **how: Any,
) -> Calibration[Any]:
    conditioning = spec.conditioning.model_copy(update={"baseline": baseline, "rectify": polarity == "both"})
    changed = spec.model_copy(update={"conditioning": conditioning})
    return calibrate(recordings, changed, progress, rule, inverted=polarity == "falling", steady=True, **how)


def _separation(fitted: Calibration[Any], afferent: str) -> float:
    table = fitted.table
    return float(table.separation[table.chosen & (table.afferent == afferent)].iloc[0])


class _Counted:
    """Progress of one alternative, which always counts the same number of steps."""

    def __init__(self, progress: Progress | None, note: str) -> None:
        self._progress: Callable[[int, str], None] = progress or (lambda n, note: None)
        self._note, self._done = note, 0

    def advance(self, n: int, note: str) -> None:
        """A step of the search is done."""
        del note
        self._done += n
        self._progress(n, self._note)

    def finish(self, n: int) -> None:
        """Count the skipped steps, for instance if it cannot be calibrated."""
        if n > self._done:
            self._progress(n - self._done, self._note)
