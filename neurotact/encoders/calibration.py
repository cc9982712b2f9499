"""Gains of an encoder for another sensor, from training trials (`docs/calibration.md`).

The texture paper (Sec. III-A) weighs gains by the inter-spike intervals (ISIs) of its gratings: too high, and all
ISIs crowd at the refractory period, where the gratings overlap; too low, and afferents fall silent. Here that is a
rule: among the gains with few silent trials and few ISIs at the floor, the one whose ISI distributions separate the
classes best. Only the given trials are used.
"""

import contextlib
import logging
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any, Generic, TypeVar

import numpy as np
import pandas as pd

from neurotact.data.conditioning import ACAUSAL, Baseline, ConditioningSpec
from neurotact.data.onset import common_onset_s
from neurotact.data.recordings import Trials, default_channels
from neurotact.data.splits import folds_of_groups, groups_of
from neurotact.data.spool import Spool
from neurotact.data.window_choice import RESTS
from neurotact.encoders import firing
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.excerpts import Excerpts, cut, draw, liveliest, numbers_of, standardise
from neurotact.encoders.gain_search import (
    CalibrationRule,
    Progress,
    Tried,
    choose,
    drives,
    part_of,
    rates_of,
    search,
    suited_rule,
)
from neurotact.encoders.model import DrivenSpec, EncoderSpec
from neurotact.encoders.scaling import REST_SD, Scaling, Spread, highest_of, spread_of
from neurotact.encoders.sensitivity import Sensitivity, adjusted, sensitivities_of
from neurotact.encoders.specs import (
    BY_CALIBRATION,
    CLOCK_HZ,
    FITTED,
    PAST,
    SA_RA,
    conditioning_of,
    exact_note,
    is_exact,
    pays_exact,
    populations,
    with_taxels_of,
)
from neurotact.errors import InputError, some
from neurotact.metrics.decision import Decision, otherwise
from neurotact.metrics.linear import FOLDS, cross_validated_accuracy
from neurotact.spec import refuse

NEAR = 0.2
"""Difference from a requested rate, as a share of it, that is not worth a note."""
WIDER, MOST_CUTOFFS = 4.0, 3
"""Cut-offs of the moving average that are tried: the encoder's own, `WIDER` times that, and none."""

KEPT = "each taxel keeps its level, which another day or mounting may change"
MEASURED = "accuracy of logistic regression on the {} rates of the training trials"
MEASURED_ON_BOTH = MEASURED.format("SA-I and RA-I")
ONE_GRADE, GRADES = (1.0,), (0.5, 1.0)
"""The grades of an encoder with one SA-I under each taxel, and those to begin with where several are tried."""
MORE_RESTLESS = 0.1
"""Share of the afferents that may fire at rest, beyond those that do so without the falling signal."""

CLOCKED = "integration = 'clock'"

_MOST_VALUES = 1_000_000
"""Steps of a trial that are sampled; in a longer trial every second step, or every third, and so on."""


log = logging.getLogger("neurotact")

Key = TypeVar("Key")
Encoder = TypeVar("Encoder", bound=EncoderSpec)


@dataclass(frozen=True)
class Calibration(Generic[Encoder]):
    """An encoder for a sensor, and the search for its gains.

    encoder: the fitted spec, for recordings with the unit, taxels and rate of the training trials.
    table: one row per population and candidate gain that was tried (`gain_search.following`): `afferent` ("SA-I",
        "RA-I", "PC"), `gain` (of LIF mV per standard deviation, and per ms for RA-I; of mechanoreceptors mm per
        standard deviation), `silent_share`, `floor_share`, `separation` (bit), `spikes_per_s` (of one afferent),
        `admissible`, `chosen`.
    isi: one row per population, gain, label and bin: `afferent`, `gain`, `label`, `isi_ms` (the bin's geometric middle,
        infinite for trials without an interval), `share`, over trials and afferents.
    rates, rates_ra: of SA-I and RA-I at the chosen gains, in spikes per second, `(trial, afferent)`, of the taxels on
        which the gains were chosen.
    labels: the classes, `(trial,)`.
    notes: the changes of the spec, and warnings.
    apart: what `accuracy` tests by the trials of other values, `(trial,)`, or None.
    order: random numbers of the trials, `(trial,)`, by which `accuracy` deals them into folds, or None.
    folds: of the trials, `(trial,)`, which keep groups whole, for `accuracy` without values of `apart`; or None.
    """

    encoder: Encoder
    table: pd.DataFrame
    isi: pd.DataFrame
    rates: np.ndarray
    rates_ra: np.ndarray
    labels: np.ndarray
    notes: tuple[str, ...]
    apart: np.ndarray | None = None
    order: np.ndarray | None = None
    folds: np.ndarray | None = None

    @cached_property
    def accuracy(self) -> float:
        """The cross-validated accuracy of logistic regression on `rates` of the training trials.

        NaN if a class has one trial.
        """
        return self._accuracy_on(self.rates)

    @cached_property
    def accuracy_of_both(self) -> float:
        """As `accuracy`, on the rates of SA-I and RA-I."""
        return self._accuracy_on(np.hstack([self.rates, self.rates_ra]))

    def _accuracy_on(self, rates: np.ndarray) -> float:
        by = self.apart if self.is_apart else self.folds
        return cross_validated_accuracy(rates, self.labels, by, self.order)

    @property
    def is_apart(self) -> bool:
        """Whether these accuracies are of each value of a condition by the trials of the others."""
        return self.apart is not None and len(np.unique(self.apart)) > 1


class DrawnTrials:
    """The trials on which gains are fitted, and what the fits of several encoders of one kind share.

    trials, numbers: those that are drawn. drawn_by: the numbers by which excerpts and labels are; None: at random.
    tried: the `known` of `search`.
    """

    def __init__(self, recordings: Trials, rule: CalibrationRule, *, steady: bool) -> None:
        self.rng, numbers = np.random.default_rng(rule.seed), numbers_of(recordings, rule.seed)
        chosen = draw(recordings.labels, rule.trials_per_class, self.rng, numbers if steady else None)
        self.trials, self.numbers = recordings.select(chosen), numbers[chosen]
        self.drawn_by = self.numbers if steady else None
        self.tried: Tried = {}
        self._highest = highest_of(self.trials)
        self._cuts: dict[ConditioningSpec, tuple[Spool, Spread]] = {}

    def cut(self, how: ConditioningSpec, longest_s: float) -> tuple[Spool, Spread]:
        """The excerpts before standardisation, and how far their taxels spread; cut once for each conditioning."""
        if how not in self._cuts:
            excerpts = cut(self.trials, how, longest_s, self.rng, self.drawn_by)
            self._cuts[how] = excerpts, spread_of(self.trials, excerpts, self._highest)
        return self._cuts[how]


def calibrate(
    recordings: Trials,
    spec: Encoder,
    progress: Progress | None = None,
    rule: CalibrationRule = CalibrationRule(),
    *,
    inverted: bool = False,
    apart: tuple[str, ...] = (),
    group: tuple[str, ...] = (),
    tell: bool = True,
    steady: bool = False,
    share: Callable[..., DrawnTrials] = DrawnTrials,
) -> Calibration[Encoder]:
    """Fit standardisation and gains of `spec` on recorded training trials of any unit and rate.

    Gains are those of afferents under all taxels, also where populations have only some (`sa1.taxels`).

    The spec's smoothing, clock and baseline stay, but for what the recordings cannot take: an EMA whose cut-off is
    not below their Nyquist frequency is dropped, and a recording below 1 kHz without `resample_Hz` gets a 1 kHz clock.
    Then each taxel is scaled by its standard deviation, and the gain of each population is searched separately. The
    same trials, spec and rule give the same encoder.

    A threshold that populations share is searched for all of them. Other models than LIF are searched on fewer trials
    and seconds (`suited_rule`); mechanoreceptors without their noise, with the first fit of each type: the gain is that
    of the whole population.

    progress: called with 1 and a note at each of the `rule.candidates` steps.
    inverted: SA-I is driven by the signal's fall instead of its rise: the scales are negative.
    apart: conditions that the test leaves out; `Calibration.accuracy` tests each of their values by the others.
    group: conditions that name groups, which the split and the folds of `Calibration.accuracy` keep whole.
    tell: log the notes, too.
    steady: trials and their excerpts are drawn by what is in them, so that one that is left out moves no other.
    share: makes the trials that are fitted on, or, with `steady`, returns those of another fit of these recordings.
    Raises InputError for less than two classes, for constant signals, and if every gain that gives spikes
    puts too many ISIs at the refractory floor.

    >>> from neurotact.data.recordings import Recordings
    >>> from neurotact.spec import build
    >>> time_s, rng = np.arange(0, 1, 1e-3)[:, None], np.random.default_rng(0)
    >>> slide = lambda f: np.sin(2 * np.pi * f * time_s + rng.uniform(0, 6)) + rng.normal(0, 0.1, time_s.shape)
    >>> trials = Recordings([slide(f) for f in (2, 2, 2, 8, 8, 8)], 1000.0, "count",
    ...                     pd.DataFrame({"label": [*"aaabbb"]}))
    >>> start = build(AfferentSpec, {"sa1": {"gain": 1}, "ra1": {"gain": 1}}, "an example")
    >>> fitted = calibrate(trials, start, rule=CalibrationRule(candidates=16))
    >>> fitted.encoder.unit, fitted.table[fitted.table.chosen].afferent.tolist()
    ('count', ['SA-I', 'RA-I'])
    """
    if len(recordings.classes) < 2:
        raise InputError(
            f"{_source(recordings)}: holds one class, '{''.join(recordings.classes)}', and gains are chosen by how "
            "well they separate classes; give training trials of at least two"
        )
    firing.check_rate(spec, recordings.sampling_rate_Hz)
    asked, spec = spec, with_taxels_of(spec)
    rule = suited_rule(spec, rule, len(recordings.classes))
    conditioning, notes = _suited(spec, recordings)
    shared = share(recordings, rule, steady=steady)
    drawn = shared.trials
    how = conditioning_of(spec.model_copy(update={"conditioning": conditioning}), recordings.sampling_rate_Hz)
    excerpts, spread = shared.cut(how, rule.excerpt_s)
    # Where the signal below zero drives afferents, too, the mean is the zero.
    rest_sd = 0.0 if _is_signed(spec) else REST_SD
    scaling = spread.scaling(conditioning.baseline, inverted=inverted, rest_sd=rest_sd)
    names = None if drawn.channels == default_channels(drawn.n_channels) else drawn.channels
    conditioning = conditioning.model_copy(update={"offset": scaling.offset, "scale": scaling.scale, "taxels": names})
    fitted = spec.model_copy(update={"unit": recordings.unit, "conditioning": conditioning})
    standardised = standardise(excerpts, conditioning)
    if drawn.n_channels > rule.taxels:
        taxels = liveliest(standardised, rule.taxels)
        standardised = standardised.then(lambda signal: signal[:, taxels])
        notes.append(
            f"gains are chosen on {rule.taxels} of the {drawn.n_channels} taxels, those that vary most in one trial "
            "after the other"
        )
    conditioned = Excerpts(
        standardised,
        drawn.labels,
        drawn.classes,
        how.clock_Hz(recordings.sampling_rate_Hz),
        _source(recordings),
        shared.drawn_by,
    )

    searched = part_of(conditioned, rule)
    table, isi, tried = search(searched, fitted, rule, shared.rng, progress, shared.tried)
    best = _chosen(table, sensitivities_of(fitted), rule, _source(recordings))
    table.loc[[*best.values()], "chosen"] = True
    turned_to, gains = fitted, {sensitivity: float(table.gain[row]) for sensitivity, row in best.items()}
    rates = {sensitivity.name: tried[sensitivity.name, gain] for sensitivity, gain in gains.items()}
    if searched is not conditioned:
        notes.append(_on_part(searched, conditioned))
        rates = rates_of(conditioned, fitted, gains)
    for sensitivity, row in best.items():
        if not table.admissible[row] and rule.spikes_per_s is None:
            notes.append(_on_silence(conditioned, rates[sensitivity.name], sensitivity.name, rule))
        turned_to, n_lost = _turned(conditioned, turned_to, sensitivity, gains[sensitivity])
        if n_lost:
            notes.append(f"{sensitivity.name}: {n_lost} of the grades would equal others, and are dropped")
        notes += _on_ends(table[table.afferent == sensitivity.name], row, sensitivity, rule)
    notes += _on_scaling(scaling)
    if tell:
        _log(notes, recordings)
    if isinstance(turned_to, AfferentSpec) and not turned_to.has_one_grade:
        rates = rates_of(conditioned, turned_to)
    first, *others = rates.values()
    others = others[0] if others else first[:, :0]
    if populations(spec)[0] not in SA_RA:  # all populations choose the baseline
        first, others = np.hstack([first, others]), first[:, :0]
    values, groups = (groups_of(drawn.conditions, columns) for columns in (apart, group))
    folds = None if groups is None else folds_of_groups(drawn.labels, groups, FOLDS, rule.seed)
    of_trials = values, shared.numbers, folds
    turned_to = with_taxels_of(turned_to, asked)
    return Calibration(turned_to, table, isi, first, others, conditioned.labels, tuple(notes), *of_trials)


def calibrate_causally(
    recordings: Trials,
    spec: Encoder,
    progress: Progress | None = None,
    rule: CalibrationRule = CalibrationRule(),
    *,
    choose_ema: bool = False,
    choose_opposite: bool = False,
    choose_grades: bool = False,
    apart: tuple[str, ...] = (),
    group: tuple[str, ...] = (),
    tell: bool = True,
) -> Calibration[Encoder]:
    """`calibrate` with the baseline of `PAST` that gives the best separation of the classes by SA-I.

    Without a baseline, the static level drives SA-I, which separates many surfaces; the mean of each trial's start
    removes drift between touches, and a high-pass drift within one. The first one whose `Calibration.accuracy` is
    within one standard error of the highest is chosen. ISI distributions, which choose the gains, cannot decide this:
    they are finer if an afferent fires less, whatever the baseline removes. RA-I responds to changes, which a baseline
    hardly affects. Trials, excerpts and folds are drawn by what is in each trial (`calibrate`, steady): drawn anew for
    one trial less, they would move an accuracy by most of its standard error, and with it the choice.

    choose_ema: also choose the moving average, after the baseline and the polarity, which are chosen with its own: its
        own cut-off, `WIDER` times that, or none. The first one whose `Calibration.accuracy_of_both` is within one
        standard error of the highest is chosen, so that a sensor of vibrations above the cut-off keeps them. Without
        the polarity that suits, a wider one may seem better only for want of it.
    choose_opposite: also choose whether SA-I of the falling signal are added (`sa1.opposite`): if without them
        `Calibration.accuracy_of_both` is more than one standard error below, with the best baseline by that accuracy of
        those with which they do not fire at rest.
        Only of LIF afferents without them.
    choose_grades: with `apart`, also choose whether several SA-I of different thresholds are under each taxel
        (`sa1.grades`): by the same rule, or, where training trials have one value of the conditions, without a
        comparison. At another condition thresholds tell the size of a touch from its timing, if a network also learns
        from varied copies (`data.augmentation`); without them it learns the sizes of one condition. Only of LIF
        afferents with one grade.
    apart: conditions that the test leaves out: with several values of them, the accuracies are those of each value by
        the trials of the others, so that the choices are made for untrained ones.
    group: as for `calibrate`.
    progress: called with 1 and a note at each of `rule.candidates` steps of each combination. tell: log the notes, too.
    Raises InputError if none of them can be calibrated.
    """
    own_Hz, asked, spec = spec.conditioning.ema_cutoff_Hz, spec, with_taxels_of(spec)
    cutoffs_Hz = _cutoffs(own_Hz, recordings.sampling_rate_Hz) if choose_ema else [own_Hz]

    how: dict[str, Any] = {"apart": apart, "group": group, "tell": False, "steady": True, "share": cache(DrawnTrials)}
    fits: list[tuple[Encoder, Calibration[Encoder]]] = []
    at_rest = _AtRest(recordings)

    def fit(tried: Encoder) -> Calibration[Encoder]:
        short = rule.model_copy(update={"every": False})
        found = calibrate(recordings, tried, progress, short, **how)
        fits.append((tried, found))
        return found

    best, on_baseline = _of_baselines(fit, spec, cutoffs_Hz)
    notes: tuple[str, ...] = (on_baseline,)
    if choose_opposite and (signed := with_opposite(spec)) is not None:
        with contextlib.suppress(InputError):  # no gain suits the falling signal: the encoder stays as it is
            rises = best.encoder
            both, on_its_baseline = _of_baselines(
                fit, signed, cutoffs_Hz, by_both=True, refused=lambda tried: _wakes(at_rest, rises, tried)
            )
            best, notes = _of_polarities(at_rest, (best, both), notes, on_its_baseline)
    if len(cutoffs_Hz) > 1:
        best, on_ema = _of_cutoffs(fit, best, _refit(spec, best.encoder), cutoffs_Hz)
        notes = *on_ema, *notes
    if choose_ema and progress:
        progress((MOST_CUTOFFS - len(cutoffs_Hz)) * rule.candidates, "")
    if choose_grades and apart and (graded := _with_grades(_refit(spec, best.encoder))) is not None:
        with contextlib.suppress(InputError):
            best, notes = _of_grades((best, fit(graded)), notes)
    if rule.every:
        start = next(tried for tried, found in fits if found is best)
        best = calibrate(recordings, start, None, rule, **how)
    notes = *best.notes, *notes
    if best.is_apart:
        notes = *notes, f"these accuracies are of each value of {', '.join(apart)} by the training trials of the others"
    elif best.folds is not None:
        notes = *notes, f"these accuracies are of training trials by those of other groups ({', '.join(group)})"
    if tell:
        _log(notes, recordings)
    return replace(best, notes=notes, encoder=with_taxels_of(best.encoder, asked))


def _of_baselines(
    fit: Callable[[Encoder], Calibration[Encoder]],
    spec: Encoder,
    cutoffs_Hz: Iterable[float | None],
    *,
    by_both: bool = False,
    refused: Callable[[Encoder], bool] = lambda tried: False,
) -> tuple[Calibration[Encoder], str]:
    """The calibration with the best baseline of `PAST`, and the note on it, at the first cut-off that has one.

    by_both: by the accuracy of both populations, as polarities are chosen: by another one, a baseline that is chosen by
    a hair decides the polarity. refused: what may not be chosen beside one that may, however accurate it is.
    """
    errors: list[InputError] = []
    for cutoff_Hz in cutoffs_Hz:
        tried: dict[Baseline, Encoder] = {base: _with(spec, base, cutoff_Hz) for base in PAST}
        calibrated, failed = _each(fit, tried)
        if calibrated:
            allowed = {base: one for base, one in calibrated.items() if not refused(one.encoder)} or calibrated
            accuracy = {base: one.accuracy_of_both if by_both else one.accuracy for base, one in allowed.items()}
            accuracy |= dict.fromkeys(failed, np.nan)
            found = Decision.of_shares("conditioning.baseline", accuracy, len(next(iter(calibrated.values())).labels))
            return calibrated[found.chosen], _on_baseline(found, spec, 1 + by_both)
        errors.append(failed[PAST[-1]])
    raise errors[0]


def _of_cutoffs(
    fit: Callable[[Encoder], Calibration[Encoder]],
    best: Calibration[Encoder],
    start: Encoder,
    cutoffs_Hz: list[float | None],
) -> tuple[Calibration[Encoder], list[str]]:
    """The calibration with the best moving average, and the note on another one than the encoder's own.

    best: that of the first cut-off that can be calibrated. start: the encoder to calibrate with those that follow.
    """
    known = best.encoder.conditioning
    wider_Hz = cutoffs_Hz[cutoffs_Hz.index(known.ema_cutoff_Hz) + 1 :]
    others, _ = _each(fit, {cutoff_Hz: _with(start, known.baseline, cutoff_Hz) for cutoff_Hz in wider_Hz})
    calibrated = {known.ema_cutoff_Hz: best, **others}
    key = "conditioning.ema_cutoff_Hz"
    found = _by_both(key, calibrated)
    note = found.note(_measured(start, 2), override=f"{key} = {cutoffs_Hz[0]:g}")
    return calibrated[found.chosen], [] if found.chosen == cutoffs_Hz[0] else [note]


def _of_polarities(
    at_rest: "_AtRest",
    without_and_with: tuple[Calibration[Encoder], Calibration[Encoder]],
    notes: tuple[str, ...],
    on_its_baseline: str,
) -> tuple[Calibration[Encoder], tuple[str, ...]]:
    """The calibration without or with SA-I of the falling signal, and the notes; the last one is on the baseline."""
    best, both = without_and_with
    found = _by_both("sa1.opposite", {False: best, True: both})
    if not found.chosen:
        return best, notes
    if _wakes(at_rest, best.encoder, both.encoder):
        why = f"SA-I of the falling signal would fire at rest and are left out; {found.compared(MEASURED_ON_BOTH)}"
        return best, (*notes, f"{why}; {otherwise('sa1.opposite = true')}")
    effect = "a second SA-I under each taxel receives the falling signal"
    return both, (*notes[:-1], on_its_baseline, found.note(MEASURED_ON_BOTH, effect, "sa1.opposite = false"))


def _of_grades(
    without_and_with: tuple[Calibration[Encoder], Calibration[Encoder]], notes: tuple[str, ...]
) -> tuple[Calibration[Encoder], tuple[str, ...]]:
    """The calibration without or with several grades, and the notes."""
    best, several = without_and_with
    assert isinstance(several.encoder, AfferentSpec)
    grades = several.encoder.sa1.grades
    found = _by_both("sa1.grades", {ONE_GRADE: best, grades: several})
    if best.is_apart and found.chosen == ONE_GRADE:
        return best, notes
    effect = (
        f"{len(grades)} SA-I of different thresholds under each taxel tell the size of a touch at another condition, "
        "for as many times the SA-I to compute"
    )
    if best.is_apart:
        return several, (*notes, found.note(MEASURED_ON_BOTH, effect, "sa1.grades = [1.0]"))
    why = "no training trials are of another condition, by which they could be compared"
    return several, (*notes, f"sa1.grades: {effect}; {why}; {otherwise('sa1.grades = [1.0]')}")


def _by_both(key: str, tried: Mapping[Key, Calibration[Encoder]]) -> Decision[Key]:
    """The choice among calibrations by their accuracy of both populations."""
    shares = {candidate: one.accuracy_of_both for candidate, one in tried.items()}
    return Decision.of_shares(key, shares, len(next(iter(tried.values())).labels))


def with_opposite(spec: Encoder) -> Encoder | None:
    """The encoder with SA-I of the falling signal, too; None if it has them already, or cannot have them.

    >>> from neurotact.spec import load
    >>> signed = with_opposite(load(AfferentSpec, "sa1-ra1-lif"))
    >>> signed.sa1.opposite, with_opposite(signed)
    (True, None)
    """
    if not isinstance(spec, AfferentSpec) or spec.sa1.opposite or spec.conditioning.rectify:
        return None
    return spec.model_copy(update={"sa1": spec.sa1.model_copy(update={"opposite": True})})


def _with_grades(spec: Encoder) -> Encoder | None:
    """The encoder with several SA-I of different thresholds under each taxel; None if it has or cannot have them.

    >>> from neurotact.spec import load
    >>> graded = _with_grades(load(AfferentSpec, "sa1-ra1-lif"))
    >>> graded.sa1.grades, _with_grades(graded)
    ((0.5, 1.0), None)
    """
    if not isinstance(spec, AfferentSpec) or not spec.has_one_grade:
        return None
    return spec.model_copy(update={"sa1": spec.sa1.model_copy(update={"grades": GRADES})})


def _refit(spec: Encoder, fitted: Encoder) -> Encoder:
    """The encoder to calibrate again with what was chosen: baseline, moving average and polarities."""
    chosen = fitted.conditioning
    again = _with(spec, chosen.baseline, chosen.ema_cutoff_Hz)
    is_signed = isinstance(fitted, AfferentSpec) and fitted.sa1.opposite
    return with_opposite(again) or again if is_signed else again


class _AtRest:
    """Trials before touch, and the share of an encoder's afferents that fire there, counted once for each encoder."""

    def __init__(self, recordings: Trials) -> None:
        self._recordings = recordings
        self._shares: dict[EncoderSpec, float] = {}

    @cached_property
    def rest_ms(self) -> float:
        """How long trials rest; 0 if they begin in contact."""
        return 1e3 * RESTS * common_onset_s(self._recordings)

    def share(self, encoder: EncoderSpec) -> float:
        if encoder not in self._shares:
            table = firing.resting_table(self._recordings, encoder, self.rest_ms)
            self._shares[encoder] = float(table["restless"].mean())
        return self._shares[encoder]


def _wakes(at_rest: _AtRest, without: EncoderSpec, signed: EncoderSpec) -> bool:
    """Whether SA-I of the falling signal fire at rest, where the afferents without them do not.

    The zero of a sensor whose signal only rises may lie above its rest: then touch begins with no spike. False if
    trials begin in contact.
    """
    return bool(at_rest.rest_ms) and at_rest.share(signed) > at_rest.share(without) + MORE_RESTLESS


def _on_baseline(found: Decision[Baseline], spec: EncoderSpec, n_populations: int) -> str:
    """The note on the baseline, with the accuracy of each, by the spikes of so many populations."""
    if np.isnan(found.merits[found.chosen]):
        return (
            f"conditioning.baseline = '{found.chosen}' is chosen without a comparison: a class has one training trial, "
            "so none can be held out for testing; add trials of it, or set conditioning.baseline"
        )
    return found.note(_measured(spec, n_populations), KEPT if found.chosen == PAST[0] else "")


def _measured(spec: EncoderSpec, most: int) -> str:
    """What the accuracies are: of the rates of SA-I, and RA-I, or of all populations of another model."""
    names = [population.name for population in populations(spec)]
    judged = " and ".join(names[:most] if populations(spec)[0] in SA_RA else names)
    return MEASURED.format(judged)


def _cutoffs(own_Hz: float | None, sampling_rate_Hz: float) -> list[float | None]:
    """The cut-offs to try, the encoder's own first; only that one if there is no moving average or none is possible.

    >>> _cutoffs(30.0, 1000.0), _cutoffs(30.0, 100.0), _cutoffs(30.0, 50.0)
    ([30.0, 120.0, None], [30.0, None], [30.0])
    """
    highest_Hz = sampling_rate_Hz / 2
    if own_Hz is None or own_Hz >= highest_Hz:
        return [own_Hz]
    return [own_Hz, *([WIDER * own_Hz] if WIDER * own_Hz < highest_Hz else []), None]


def _with(spec: Encoder, baseline: Baseline, cutoff_Hz: float | None) -> Encoder:
    change = {"baseline": baseline, "ema_cutoff_Hz": cutoff_Hz}
    return spec.model_copy(update={"conditioning": spec.conditioning.model_copy(update=change)})


def _each(
    fit: Callable[[Encoder], Calibration[Encoder]], specs: Mapping[Key, Encoder]
) -> tuple[dict[Key, Calibration[Encoder]], dict[Key, InputError]]:
    """The calibrations of several encoders, and the errors of those that cannot be calibrated."""
    calibrated, errors = {}, {}
    for key, spec in specs.items():
        try:
            calibrated[key] = fit(spec)
        except InputError as error:
            errors[key] = error
    return calibrated, errors


def calibration_for(
    spec: EncoderSpec,
    given: Mapping[str, Any],
    *,
    choose_ema: bool = True,
    choose_opposite: bool = True,
    choose_grades: bool = False,
    apart: tuple[str, ...] = (),
    group: tuple[str, ...] = (),
) -> tuple[Callable[..., Calibration[Any]], int]:
    """The calibration of an encoder, and how many times at most it goes through all candidates of its rule.

    A baseline that uses the whole trial is replaced by a causal one, and then the moving average (`choose_ema`) and
    SA-I of the falling signal (`choose_opposite`) are chosen, too, and for other conditions (`apart`) their grades
    (`choose_grades`), unless their keys are among `given`, the dotted keys that were set. Raises InputError if one of
    them is in `FITTED`, or a gain or threshold that calibration finds.

    >>> from neurotact.spec import load
    >>> paper = load(AfferentSpec, "sa1-ra1-lif")
    >>> given = {}, {"conditioning.ema_cutoff_Hz": 50.0}, {"conditioning.baseline": "mean"}
    >>> [calibration_for(paper, keys)[1] for keys in given]
    [8, 6, 1]
    """
    refuse(
        given, dict.fromkeys((*FITTED, *(sensitivity.key for sensitivity in sensitivities_of(spec))), BY_CALIBRATION)
    )
    if spec.conditioning.baseline not in ACAUSAL or "conditioning.baseline" in given:
        return partial(calibrate, apart=apart, group=group), 1
    choose_ema = choose_ema and "conditioning.ema_cutoff_Hz" not in given
    choose_opposite = choose_opposite and "sa1.opposite" not in given and with_opposite(spec) is not None
    is_graded = {"sa1.grades", "ra1.grades"} & {*given} or _with_grades(spec) is None
    choose_grades = choose_grades and bool(apart) and not is_graded
    n_times = len(PAST) * (2 if choose_opposite else 1) + (MOST_CUTOFFS - 1 if choose_ema else 0) + choose_grades
    how = {"choose_ema": choose_ema, "choose_opposite": choose_opposite, "choose_grades": choose_grades}
    return partial(calibrate_causally, **how, apart=apart, group=group), n_times


def with_integration(spec: Encoder, given: Container[str], recorded_Hz: float) -> tuple[Encoder, list[str]]:
    """The encoder to calibrate, in closed form where `pays_exact`, and the note on it.

    One whose `integration` is among `given`, the keys that were set, stays as it is.

    >>> from neurotact.spec import load
    >>> paper = load(AfferentSpec, "sa1-ra1-lif")
    >>> [with_integration(paper, given, 93.0)[0].integration for given in ([], ["integration"])]
    ['exact', 'clock']
    """
    how = spec.conditioning.model_copy(update={"resample_Hz": spec.conditioning.resample_Hz or CLOCK_HZ})
    clocked = spec.model_copy(update={"conditioning": how})
    if "integration" in given or not pays_exact(clocked, recorded_Hz):
        return spec, []
    note = f"{exact_note(how.clock_Hz(recorded_Hz), recorded_Hz)}; {otherwise(CLOCKED)}"
    return clocked.model_copy(update={"integration": "exact"}), [note]


def _log(notes: Iterable[str], recordings: Trials) -> None:
    for note in notes:
        log.warning("%s: %s", _source(recordings), note)


def _chosen(
    table: pd.DataFrame, sensitivities: Iterable[Sensitivity], rule: CalibrationRule, source: str
) -> dict[Sensitivity, int]:
    """The chosen row of each sensitivity."""
    return {
        sensitivity: choose(
            table[table.afferent == sensitivity.name], rule, f"{source}: {sensitivity.name}", sensitivity.kind
        )
        for sensitivity in sensitivities
    }


def _on_scaling(scaling: Scaling) -> Iterator[str]:
    """The notes on taxels that vary little."""
    less = "less than a tenth of that of the most active taxel"
    if scaling.noise:
        yield f"treated as noise, since its deviation is {less} and similar in all classes: {some(scaling.noise)}"
    if scaling.small:
        own = f"scaled by its own deviation, which is {less} but differs between classes"
        yield f"{own}: {some(scaling.small)}"


def _on_part(searched: Excerpts, every: Excerpts) -> str:
    """The note on the part of the excerpts on which gains are searched."""
    trials, taxels = (
        f"{n} of the {whole} {what}" if n < whole else f"all {whole} {what}"
        for n, whole, what in (
            (len(searched.labels), len(every.labels), "training excerpts"),
            (searched.n_channels, every.n_channels, "taxels"),
        )
    )
    return f"gains are searched on {trials} and {taxels}"


def _on_silence(conditioned: Excerpts, rates: np.ndarray, afferent: str, rule: CalibrationRule) -> str:
    """The note on trials that stay silent because no gain satisfies both limits, and their most frequent class."""
    silent = np.logical_not(rates.any(axis=1))
    most = int(np.bincount(conditioned.labels[silent]).argmax())
    rests = f"{silent[conditioned.labels == most].mean():.0%} of '{conditioned.classes[most]}'"
    return (
        f"{afferent}: silent in {silent.mean():.0%} of the training trials (in {rests}); no gain gives spikes in more "
        f"without putting over {rule.max_floor_share:.0%} of the intervals at the refractory period; leave trials "
        "without contact out, unless that is a class"
    )


def _on_ends(table: pd.DataFrame, best: int, sensitivity: Sensitivity, rule: CalibrationRule) -> list[str]:
    """The note on a value at the end of what was tried, or on a rate that is far from the requested one."""
    what, rate = sensitivity.kind, float(table.spikes_per_s[best])
    if rule.spikes_per_s is None:
        most = "smallest" if sensitivity.is_threshold else "largest"
        more = f"{sensitivity.name}: the chosen {what} is the {most} tried; more candidates may find a better one"
        return [more] if best == table.index[-1] else []
    if abs(rate / rule.spikes_per_s - 1) <= NEAR:
        return []
    nearest = f"{rate:.3g} spikes per second, the nearest to {rule.spikes_per_s:g}"
    return [
        f"{sensitivity.name}: no {what} that was tried gives an afferent more than {nearest}"
        if rate < rule.spikes_per_s
        else f"{sensitivity.name}: no {what} that was tried gives an afferent fewer than {nearest}"
    ]


def _is_signed(spec: EncoderSpec) -> bool:
    """Whether the signal below zero drives afferents as the signal above does."""
    return spec.is_signed if isinstance(spec, DrivenSpec) else populations(spec)[0] not in SA_RA


def _turned(conditioned: Excerpts, spec: Encoder, sensitivity: Sensitivity, value: float) -> tuple[Encoder, int]:
    """The encoder with a sensitivity at its chosen value, new grades, and how many of the grades are lost."""
    if not isinstance(spec, AfferentSpec) or len(getattr(spec, sensitivity.part).grades) == 1:
        return adjusted(spec, sensitivity, value), 0
    kind = getattr(spec, sensitivity.part)
    values = _sample(*drives(conditioned.signals, conditioned.sampling_rate_Hz, spec)[sensitivity.part])
    grades = _fit_grades(values, spec, value, len(kind.grades))
    kind = kind.model_copy(update={"gain": value, "grades": grades})
    return spec.model_copy(update={sensitivity.part: kind}), len(getattr(spec, sensitivity.part).grades) - len(grades)


def _suited(spec: EncoderSpec, recordings: Trials) -> tuple[ConditioningSpec, list[str]]:
    """Conditioning for recordings of this rate, without standardisation, and the changes.

    Where membranes are in closed form, the clock is that of the spikes alone.
    """
    conditioning, rate_Hz, notes = spec.conditioning, recordings.sampling_rate_Hz, []
    change: dict[str, float | None] = {"offset": None, "scale": None, "taxels": None}
    cutoff_Hz = conditioning.ema_cutoff_Hz
    if cutoff_Hz is not None and cutoff_Hz >= rate_Hz / 2:
        change["ema_cutoff_Hz"] = None
        notes.append(f"the EMA at {cutoff_Hz:g} Hz is left out: {rate_Hz:g} Hz recordings end at {rate_Hz / 2:g} Hz")
    if conditioning.resample_Hz is None and rate_Hz < CLOCK_HZ:
        change["resample_Hz"] = CLOCK_HZ
        note = f"signals are resampled from {rate_Hz:g} to {CLOCK_HZ:g} Hz, the clock of the spikes"
        if is_exact(spec):
            note = exact_note(CLOCK_HZ, rate_Hz)
        elif with_integration(spec, (), rate_Hz)[1]:
            note += "; closed form, which costs less on a slow sensor, is integration = 'exact'"
        notes.append(note)
    return conditioning.model_copy(update=change), notes


def _source(recordings: Trials) -> str:
    return recordings.source or "recordings"


def _sample(drive: Iterable[np.ndarray], n_values: int) -> np.ndarray:
    """The positive values of trials `(time, taxel)` with `n_values` values in all, at most `_MOST_VALUES`.

    >>> _sample([np.array([[1.0, -1.0], [2.0, 3.0]])], 4).tolist()
    [1.0, 2.0, 3.0]
    """
    every = -(-n_values // _MOST_VALUES)
    parts = [signal[::every] for signal in drive]
    return np.concatenate([part[part > 0] for part in parts])


def _fit_grades(drive: np.ndarray, spec: AfferentSpec, gain: float, n_grades: int) -> tuple[float, ...]:
    """Grades of a gain whose thresholds are at even quantiles of the positive drive.

    The i-th of k thresholds lies at the quantile (i - 1/2)/k: a constant signal of that size, times gain and grade,
    just reaches the threshold of the membrane. Rounded to three digits; equal grades are merged.
    drive: positive values, in the unit of the gain.

    >>> spec = AfferentSpec.model_validate({"sa1": {"gain": 1}, "ra1": {"gain": 1}})
    >>> _fit_grades(np.linspace(0, 8, 1001), spec, gain=5.0, n_grades=4)
    (0.286, 0.4, 0.667, 2.0)
    """
    if not len(drive):
        return (1.0,)
    places = (np.arange(n_grades) + 0.5) / n_grades
    levels = np.quantile(drive, places) * gain / (spec.v_threshold_mV - spec.v_rest_mV)
    return tuple(sorted({float(f"{1 / level:.3g}") for level in levels}))
