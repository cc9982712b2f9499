"""The materials paper: SVM, RLS and RELM classify four contact materials, in pairs and all at once (Tables I to VI).

Patterns are split 150/50/100 (two classes) or 300/100/200 (four) into training, validation and test (its Sec. IV-A);
its "validation errors" are errors on the test set. Scaling is fitted only on the training patterns, and grids are
judged on validation patterns (ties: the fewest units, then the smoothest).
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import combinations
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.opponents.elm import ELMClassifier
from neurotact_parts.opponents.kernel_machines import RBFExpansion
from neurotact_parts.opponents.targets import decide, signed
from neurotact_parts.studies.materials import figures
from neurotact_parts.studies.materials.rls import RLSClassifier
from neurotact_parts.studies.materials.simulator import PATTERN, ContactMaterialsSpec, patterns, simulate
from pydantic import Field
from sklearn.preprocessing import MinMaxScaler
from sklearn.svm import SVC

from neurotact.data.recordings import LABEL, select_conditions
from neurotact.data.splits import SplitSpec, split_trials
from neurotact.figures.style import Drawn
from neurotact.metrics.flops import Cost, Dense, cost
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View, heads

SETUPS = {"A": PATTERN, "B": tuple(c for c in PATTERN if c != "force_N"), "C": PATTERN[2:]}
"""Features of each problem set-up (Sec. IV-A)."""
SHARES: dict[str, Any] = {"validation": 1 / 6, "test": 1 / 3}
SHOWN = {"frequency_Hz": 30.0, "set_force_N": 0.4, "trial": 0}
"""Conditions of the trials whose waveforms the report shows, if the data have them."""


class Parameters(Spec):
    """One cell: a classifier on one set-up, over all pairs of materials or over all four at once."""

    data: ContactMaterialsSpec = ContactMaterialsSpec()
    classifier: Literal["RELM", "RLS", "SVM"] = "SVM"
    setup: Literal["A", "B", "C"] = "A"
    """A: all four features; B: without the input force; C: phase and amplitude."""
    classes: Literal["two", "four"] = "two"
    seed: int = Field(default=0, ge=0)
    """Random seed of the split and of the hidden weights; the paper repeats the four-class problem five times."""


class Grid(NamedTuple):
    """Candidate values, those of the smoothest functions first (Sec. IV-A); `penalties` are 1 / C for an SVM."""

    penalties: tuple[float, ...]
    sigmas: tuple[float, ...] = ()
    hidden: tuple[int, ...] = ()


class Machines(NamedTuple):
    """One setting with its result: `scores` `(example, machine)` of one machine, or of one for each class."""

    settings: Grid
    units: tuple[int, ...]
    scores: np.ndarray


def powers(first: int, last: int) -> tuple[float, ...]:
    """Powers of two, the largest first.

    >>> powers(-1, 1)
    (2.0, 1.0, 0.5)
    """
    return tuple(2.0**power for power in range(last, first - 1, -1))


GRIDS = {
    ("RELM", "two"): Grid(powers(-16, 15), hidden=tuple(range(5, 201, 10))),
    ("RLS", "two"): Grid(powers(-12, 0), sigmas=powers(-12, 12)),
    ("SVM", "two"): Grid(powers(-12, 0), sigmas=powers(-12, 12)),
    ("RELM", "four"): Grid(powers(-12, 0), hidden=tuple(range(5, 301, 5))),
    ("RLS", "four"): Grid(powers(-12, -3), sigmas=powers(-12, 6)),
    ("SVM", "four"): Grid(powers(-12, 0), sigmas=powers(-12, 6)),
}


def load(data: ContactMaterialsSpec) -> Arrays:
    """The arrays of a cell: features `(pattern, 4)` in the order of `PATTERN`, labels and set_force_N `(pattern,)`; and
    for the report waveforms `(material, time, channel)` in V, their materials, frequency and sampling rate.
    """
    recordings = simulate(data)
    conditions = recordings.conditions
    table = patterns(recordings, data.force_V_per_N)
    wanted = {**SHOWN, "frequency_Hz": data.frequencies_Hz[len(data.frequencies_Hz) // 2]}
    wanted["set_force_N"] = data.forces_N[-1]
    shown = np.flatnonzero(select_conditions(conditions, wanted))
    return {
        "features": table[list(PATTERN)].to_numpy(float),
        "labels": table[LABEL].to_numpy(str),
        "set_force_N": conditions["set_force_N"].to_numpy(float),
        "waveforms": np.asarray(recordings.signals)[shown],
        "waveform_labels": conditions[LABEL].to_numpy(str)[shown],
        "waveform_frequency_Hz": np.array(wanted["frequency_Hz"]),
        "sampling_rate_Hz": np.array(recordings.sampling_rate_Hz),
    }


def run(parameters: Parameters, arrays: Arrays) -> list[dict]:
    """A row for each pair of materials, or one for all four."""
    labels = arrays["labels"]
    columns = [PATTERN.index(name) for name in SETUPS[parameters.setup]]
    materials = list(dict.fromkeys(labels.tolist()))
    problems = combinations(materials, 2) if parameters.classes == "two" else [tuple(materials)]
    rows = []
    for problem in problems:
        inside = np.isin(labels, problem)
        indices = np.searchsorted(sorted(problem), labels[inside])
        row = evaluate(parameters, arrays["features"][inside][:, columns], indices)
        name = " vs ".join(problem) if len(problem) == 2 else "all"
        rows.append({"problem": name, **row, "signal_ms": 1e3 * parameters.data.duration_s})
    return rows


def evaluate(parameters: Parameters, features: np.ndarray, indices: np.ndarray) -> dict:
    """Choose settings on validation patterns, and compute their costs and their errors on test patterns.

    features `(pattern, feature)` as measured; indices `(pattern,)`, the class of each.
    """
    split = split_trials(indices, SplitSpec(**SHARES, seed=parameters.seed))
    scaled = parameters.classes == "two" or parameters.classifier != "RELM"
    scaler = MinMaxScaler((-1, 1)).fit(features[split.train]) if scaled else None
    train, validation, test = (
        scaler.transform(features[part]) if scaler else features[part]
        for part in (split.train, split.validation, split.test)
    )
    family, grid = FAMILIES[parameters.classifier], GRIDS[parameters.classifier, parameters.classes]
    targets = signed(indices[split.train], indices[split.train].max() + 1)
    best = least_error(family(train, targets, validation, grid, parameters.seed), indices[split.validation])
    tested = next(family(train, targets, test, best.settings, parameters.seed))
    error_test = error(tested.scores, indices[split.test])
    spent = cost_of(parameters.classifier, best.units, features.shape[1])
    return {
        "error_validation": error(best.scores, indices[split.validation]),
        "error_test": error_test,
        "accuracy_test": 1.0 - error_test,
        "units": sum(best.units),
        "units_per_machine": float(np.mean(best.units)),
        "penalty": best.settings.penalties[0],
        "sigma": best.settings.sigmas[0] if best.settings.sigmas else float("nan"),
        **spent.columns("macs", "flops", "parameters", "energy_estimate_nJ"),
    }


def error(scores: np.ndarray, indices: np.ndarray) -> float:
    """Share of patterns classified wrongly by the largest score (for two classes: by the sign)."""
    return float((decide(scores) != indices).mean())


def least_error(tried: Iterable[Machines], indices: np.ndarray) -> Machines:
    """The settings with the smallest error (ties: the fewest units, then the first tried)."""
    return min(tried, key=lambda machines: (error(machines.scores, indices), sum(machines.units)))


def relm(train: np.ndarray, targets: np.ndarray, seen: np.ndarray, grid: Grid, seed: int) -> Iterator[Machines]:
    """Regularised ELMs with sigmoids and an unpenalised output bias (Eqs. 4 and 5), each with its own neurons."""
    for hidden in grid.hidden:
        paths = []
        for machine, target in enumerate(targets.T):
            state = int(np.random.SeedSequence([seed, hidden, machine]).generate_state(1)[0])
            elm = ELMClassifier(hidden, "sigmoid", grid.penalties[0], output_bias=True, random_state=state)
            paths.append(elm.fit(train, target).decision_path(grid.penalties, seen)[..., 0])
        for penalty, scores in zip(grid.penalties, np.stack(paths, axis=-1), strict=True):
            yield Machines(Grid((penalty,), hidden=(hidden,)), (hidden,) * targets.shape[1], scores)


def rls(train: np.ndarray, targets: np.ndarray, seen: np.ndarray, grid: Grid, seed: int) -> Iterator[Machines]:
    """Regularised least squares (Eqs. 1 and 2): every training pattern is a unit of every machine."""
    indices = targets.argmax(axis=1) if targets.shape[1] > 1 else (targets[:, 0] > 0).astype(int)
    for sigma in grid.sigmas:
        paths = RLSClassifier(grid.penalties[0], sigma).fit(train, indices).decision_path(grid.penalties, seen)
        for penalty, scores in zip(grid.penalties, paths, strict=True):
            yield Machines(Grid((penalty,), (sigma,)), (len(train),) * targets.shape[1], scores)


def svm(train: np.ndarray, targets: np.ndarray, seen: np.ndarray, grid: Grid, seed: int) -> Iterator[Machines]:
    """Support vector machines (Eq. 3), C = 1 / penalty; the units are the support vectors of each machine."""
    for sigma in grid.sigmas:
        for penalty in grid.penalties:
            machines = [SVC(C=1 / penalty, gamma=1 / (2 * sigma**2)).fit(train, target) for target in targets.T]
            scores = np.stack([machine.decision_function(seen) for machine in machines], axis=1)
            units = tuple(int(machine.n_support_.sum()) for machine in machines)
            yield Machines(Grid((penalty,), (sigma,)), units, scores)


FAMILIES: dict[str, Callable[..., Iterator[Machines]]] = {"RELM": relm, "RLS": rls, "SVM": svm}


def cost_of(classifier: str, units: tuple[int, ...], n_features: int) -> Cost:
    """The cost of a decision after the four measures. RLS machines share their kernels, the others do not."""
    if classifier == "RLS":
        return cost(RBFExpansion(units[0], n_features, outputs=len(units)))
    if classifier == "SVM":
        return cost(*(RBFExpansion(n, n_features, bias=True) for n in units))
    return cost(*(layer for n in units for layer in (Dense(n_features, n, "sigmoid"), Dense(n, 1))))


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """The signals, the patterns, and both kinds of problem with the published tables."""
    yield Drawn(
        "waveforms",
        "Signals",
        figures.draw_waveforms(arrays),
        "The measured force and the charge amplifier's output under each probe, three periods.",
        "Sinusoids of force, equal for all probes, and of output voltage, smaller for plastic and wood.",
    )
    yield Drawn(
        "patterns",
        "Patterns",
        figures.draw_patterns(arrays),
        "Phase and amplitude of every pattern over the shaker's frequency; lines join the means.",
        "Amplitude falls from brass over lead and wood to plastic; the phase falls with frequency for all of them.",
    )
    two = results[results["classes"] == "two"]
    if len(two):
        yield Drawn(
            "two-class-errors",
            "Pairs of materials (Tables I to III)",
            figures.draw_pairs(two),
            "Error on test patterns: ours with its deviation over the splits, published as open marks.",
            "Bars of test errors for six pairs of materials, three classifiers and three set-ups.",
        )
    four = results[results["classes"] == "four"]
    if len(four):
        yield Drawn(
            "multiclass",
            "All four materials (Tables IV to VI)",
            figures.draw_multiclass(four),
            "Error and units of all machines, with their deviations over the splits; published as open marks.",
            "Test errors and numbers of units of three classifiers in three set-ups.",
        )


VIEW = View(
    by=("problem", "setup", "classifier"),
    measures=heads(
        "error_validation error_test accuracy_test units flops energy_estimate_nJ",
        error_validation="validation error (%)",
        error_test="test error (%)",
        units="neurons, support vectors or kernels",
    ),
    cost="flops",
    score="accuracy_test",
    apart=("problem", "setup"),
)
