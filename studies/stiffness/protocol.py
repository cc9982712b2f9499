"""Stiffness of grasped objects, by single-layer networks on moments of the grasp peak (stiffness paper, Table III)."""

from collections.abc import Iterator
from typing import Literal

import numpy as np
import pandas as pd
from neurotact_parts.studies.published_flops import MOMENTS_OF, SLFN, FeatureSet, slfn_unit_flops
from neurotact_parts.studies.stiffness import figures as stiffness_figures
from neurotact_parts.studies.stiffness import simulator as grasps
from neurotact_parts.studies.stiffness.moments import peak_features
from neurotact_parts.studies.stiffness.peaks import PeakSpec, find_peaks
from neurotact_parts.studies.stiffness.slfn_chain import SLFNSpec, choices, unit_cost
from neurotact_parts.studies.task_data import TaskData
from pydantic import Field

from neurotact.data.conditioning import ema
from neurotact.data.splits import Split, SplitSpec, split_trials
from neurotact.errors import InputError
from neurotact.figures.style import Drawn
from neurotact.metrics.flops import FLOPS
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View, heads

Rule = Literal["honest", "paper", "by placement"]


class StiffnessData(Spec):
    """The grasps, and the cut and smoothing of their peaks."""

    simulation: grasps.StiffnessSpec = grasps.StiffnessSpec()
    peaks: PeakSpec = PeakSpec(threshold=1.5)
    """The threshold, in mV, is above the noise and below the smallest peaks; the paper gives none."""
    alpha: float = Field(default=0.5, gt=0, le=1)
    """Weight of the newest sample in the moving average; the paper gives none."""


class Parameters(Spec):
    """One classifier on one set of features."""

    data: StiffnessData = StiffnessData()
    classifier: SLFN
    features: FeatureSet
    protocol: Rule = "honest"
    """`paper` standardises on all grasps before they are split; `honest` on the training grasps; `by placement` is
    honest, and no placement is on two sides of a split."""
    splits: int = Field(default=10, ge=1)
    """70/15/15 (Sec. IV-C)."""
    network: SLFNSpec = SLFNSpec()
    seed: int = Field(default=0, ge=0)


VIEW = View(
    by=("classifier", "features", "n_max", "protocol"),
    measures=heads(
        "accuracy_test accuracy_validation neurons flops macs acs energy_estimate_nJ parameters signal_ms",
        flops="FLOPs (paper's count)",
    ),
    cost="flops",
    score="accuracy_test",
    note="Protocol 'paper' standardises on all grasps, test grasps included, before they are split; 'honest' on the "
    "training grasps only; 'by placement' is honest and keeps every placement on one side of the split. FLOPs are "
    "the paper's (Tables I and II) for the whole unit; MACs, ACs and energy are the ledger's.",
    apart=("protocol",),
    optimistic=("paper",),
    splits=("split",),
)


def load(data: StiffnessData) -> Arrays:
    """The peak of every grasp, its label and placement; three whole recordings for the figures."""
    recordings = grasps.simulate(data.simulation)
    found_peaks = [find_peaks(signal, data.peaks) for signal in recordings.signals]
    has_peak = np.array([len(peaks.minimum) > 0 for peaks in found_peaks])
    if not has_peak.any():
        raise InputError(f"peaks.threshold: no grasp reaches {data.peaks.threshold:g} mV; lower it")
    peaks = np.stack([peaks.samples[0] for peaks in found_peaks if len(peaks.minimum)])
    conditions = recordings.conditions
    labels = conditions["label"].to_numpy(dtype=str)
    placement = pd.factorize(conditions["label"] + " " + conditions["placement"].astype(str))[0]
    shown = [int(np.flatnonzero(labels == label)[0]) for label in data.simulation.objects]
    return {
        "features": peak_features(peaks, data.alpha),
        "peaks": ema(peaks, data.alpha).astype(np.float32),
        "labels": labels[has_peak],
        "placement": placement[has_peak],
        "unfelt": np.array(int((~has_peak).sum())),
        "shown": np.asarray(recordings.signals)[shown],
        "shown_labels": labels[shown],
        "sampling_rate_Hz": np.array(recordings.sampling_rate_Hz),
    }


def splits_of(labels: np.ndarray, placement: np.ndarray, rule: Rule, n_splits: int, seed: int) -> list[Split]:
    """Splits of grasps, 70/15/15 and balanced over classes; whole placements by the rule `by placement`."""
    specs = [SplitSpec(seed=2 * (seed * n_splits + i)) for i in range(n_splits)]
    if rule != "by placement":
        return [split_trials(labels, spec) for spec in specs]
    places, first = np.unique(placement, return_index=True)
    return [
        Split(*(np.flatnonzero(np.isin(placement, places[side])) for side in split_trials(labels[first], spec)))
        for spec in specs
    ]


def run(parameters: Parameters, arrays: Arrays) -> list[dict]:
    """A row per split and N_max: accuracies (means over draws), mean N, and the cost of the unit."""
    order = MOMENTS_OF[parameters.features]
    channels = arrays["peaks"].shape[2]
    n_classes = len(np.unique(arrays["labels"]))
    sides = splits_of(arrays["labels"], arrays["placement"], parameters.protocol, parameters.splits, parameters.seed)
    chosen = choices(
        parameters.classifier,
        arrays["features"][:, : order * channels],
        arrays["labels"],
        sides,
        parameters.network,
        parameters.seed,
        standardise_on="all" if parameters.protocol == "paper" else "training",
    )
    samples = arrays["peaks"].shape[1]
    # Grasps of a placement resemble each other: where they are split as a whole, a placement is a trial.
    trial = arrays["placement"] if parameters.protocol == "by placement" else np.arange(len(arrays["labels"]))
    rows = []
    for choice in chosen:
        unit = unit_cost(
            parameters.classifier,
            samples=samples,
            channels=channels,
            order=order,
            neurons=round(choice.neurons),
            n_classes=n_classes,
            signal_ms=1e3 * samples / float(arrays["sampling_rate_Hz"]),
        )
        rows.append(
            {
                "classifier": parameters.classifier,
                "features": parameters.features,
                "protocol": parameters.protocol,
                **choice._asdict(),
                **{f"n_{side}": len(getattr(sides[choice.split], side)) for side in Split._fields},
                "validation_trials": len(np.unique(trial[sides[choice.split].validation])),
                "test_trials": len(np.unique(trial[sides[choice.split].test])),
                "flops": slfn_unit_flops(
                    parameters.classifier, parameters.features, choice.neurons, n_classes, samples, channels
                ),
                **unit.columns(*FLOPS, "energy_estimate_nJ", "parameters", "bytes", "signal_ms"),
            }
        )
    return rows


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """The trade-off of Fig. 6, accuracy by N_max (Table III), and the signals (Figs. 2 and 5)."""
    yield stiffness_figures.trade_off(results)
    yield stiffness_figures.by_n_max(results)
    yield stiffness_figures.signals(arrays)


def task(data: StiffnessData) -> TaskData:
    """The smoothed peaks as sequences, their 16 moments as features; whole placements are the groups."""
    arrays = load(data)
    return TaskData(
        arrays["features"],
        arrays["peaks"],
        float(arrays["sampling_rate_Hz"]),
        "mV",
        arrays["labels"],
        arrays["placement"],
    )
