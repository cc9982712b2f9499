"""Hardness of five real cubes under a P(VDF-TrFE) patch: the stiffness paper's chain and a spiking one, side by side.

Recordings of the University of Genoa's COSMIC lab (see `neurotact_parts.studies.stiffness.reader`). Both chains use the
same stretch of each press, on the same splits.
"""

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd
from neurotact_parts.studies.published_flops import SLFN, FeatureSet, preprocessing_flops, slfn_flops
from neurotact_parts.studies.stiffness import pvdf_hardness_figures
from neurotact_parts.studies.stiffness import reader as cubes
from neurotact_parts.studies.stiffness.moments import moments
from neurotact_parts.studies.stiffness.peaks import PeakSpec, find_peaks
from neurotact_parts.studies.stiffness.slfn_chain import SLFNSpec, choices, unit_cost
from neurotact_parts.studies.task_data import TaskData
from pydantic import Field

from neurotact.data.conditioning import ema, ema_coefficient
from neurotact.data.copies import equal_examples, joined
from neurotact.data.dataset import expand
from neurotact.data.recordings import Recordings
from neurotact.data.splits import Split, SplitSpec, split_trials
from neurotact.data.windows import WindowSpec
from neurotact.encoders.afferents import AfferentSpec, AfferentType
from neurotact.encoders.calibration import calibrate
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import BY_CALIBRATION, FITTED
from neurotact.errors import InputError
from neurotact.figures.style import Drawn
from neurotact.metrics.flops import MovingAverage, cost
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import tasks, trainer
from neurotact.networks.use import ledger, measuring
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View, heads

SET_OF: dict[int, FeatureSet] = {1: "4F", 2: "8F", 4: "16F"}
"""Moments per channel (mean; with deviation; with skewness and kurtosis), by the paper's names for four channels."""
EARLY = "RSNN, early exit"
Rule = Literal["by trial", "by sequence"]


class HardnessData(Spec):
    """The presses, and the stretch of each."""

    path: str = "$NEUROTACT_DATA/pvdf-hardness"
    """The folder to read; `$NEUROTACT_DATA` stands for its value, by default ../shared/data."""
    smoothing_Hz: float = Field(default=30.0, gt=0)
    """Cut-off of the moving average (30 Hz in the sensor's electronics, texture paper, Sec. II-A)."""
    rest_samples: int = Field(default=400, ge=1)
    """Each taxel's median over these first samples is its level at rest, and is subtracted."""
    peaks: PeakSpec = PeakSpec(threshold=1.0, before=200, after=400, search=600, rest=100_000)
    """Presses of this robot are slower than the paper's grasps, so the stretch is longer: 0.1 + 0.2 s. The
    threshold, in mV, is above the smoothed jerk when the arm starts (at most 0.93 mV) and below every press."""


class Parameters(Spec):
    """One chain, on every split."""

    decided: ClassVar[Mapping[str, str]] = {f"encoder.{key}": BY_CALIBRATION for key in FITTED}

    data: HardnessData = HardnessData()
    chain: SLFN | Literal["RSNN"]
    protocol: Rule = "by trial"
    """`by trial` splits presses at random; `by sequence` tests on one height of the robot that is on no other side."""
    splits: int = Field(default=10, ge=2)
    """70/15/15 of the presses, balanced over cubes; by sequence there are as many as sequences."""
    network: SLFNSpec = SLFNSpec(n_max=(100,))
    """Settings of the five single-layer networks."""
    encoder: AfferentSpec = AfferentSpec(sa1=AfferentType(gain=1.0), ra1=AfferentType(gain=1.0))
    """Encoder of the spiking chain; standardisation and gains are fitted on the training presses of each split."""
    spiking: RSNNSpec = RSNNSpec()
    starts: int = Field(default=3, ge=1)
    """Initialisations of the spiking network; the best on validation presses is kept, since some do not learn."""
    seed: int = Field(default=0, ge=0)


VIEW = View(
    by=("chain", "features", "protocol"),
    measures=heads(
        "accuracy_test accuracy_validation energy_estimate_nJ macs acs sops flops flops_published "
        "parameters bytes signal_ms neurons",
        flops="FLOPs (ledger)",
        flops_published="FLOPs (stiffness paper's count)",
    ),
    cost="energy_estimate_nJ",
    score="accuracy_test",
    note="Real presses. By trial: every press is on one side of a random split; by sequence: the tested height of "
    "the robot is on no other side. Standardisation, gains, N, penalties and exit "
    "patience are fitted or chosen on training and validation presses alone. Energy is an estimate of the arithmetic, "
    "from the trigger on.",
    apart=("protocol",),
    spiking=("chain", ("RSNN", EARLY)),
    splits=("split",),
)


def load(data: HardnessData) -> Arrays:
    """The smoothed stretch of every press in mV, its moments, its cube, sequence and highest force."""
    recordings = cubes.read(expand(data.path)).to_unit("mV")
    weight = ema_coefficient(data.smoothing_Hz, recordings.sampling_rate_Hz)
    found_peaks = []
    for signal in recordings.signals:
        resting = np.median(signal[: data.rest_samples], axis=0)
        found_peaks.append(find_peaks(ema(signal - resting.astype(signal.dtype), weight), data.peaks))
    has_peak = np.array([len(peaks.minimum) > 0 for peaks in found_peaks])
    if not has_peak.any():
        raise InputError(f"peaks.threshold: no press reaches {data.peaks.threshold:g} mV; lower it")
    presses = np.stack([peaks.samples[0] for peaks in found_peaks if len(peaks.minimum)]).astype(np.float32)
    conditions = recordings.conditions[has_peak]
    return {
        "presses": presses,
        "features": moments(presses).reshape(len(presses), -1),
        "labels": conditions["label"].to_numpy(dtype=str),
        "sequence": conditions["sequence"].to_numpy(),
        "force_max_N": conditions["force_max_N"].to_numpy(float),
        "unfelt": np.array(int((~has_peak).sum())),
        "sampling_rate_Hz": np.array(recordings.sampling_rate_Hz),
    }


def splits_of(
    labels: np.ndarray, sequence: np.ndarray, rule: Rule, n_splits: int, seed: int, first: np.ndarray | None = None
) -> list[Split]:
    """Splits of presses, the same for every chain.

    By trial: at random, balanced over cubes. By sequence: each sequence is the test side once, and the others are
    divided at random into training and validation, by trial. first: the first press that each one equals; copies are
    on one side.
    """
    first = np.arange(len(labels)) if first is None else first
    if rule == "by trial":
        return [split_trials(labels, SplitSpec(seed=2 * (seed * n_splits + i)), first) for i in range(n_splits)]
    splits, sequence = [], sequence[first]
    for index, held in enumerate(np.unique(sequence)):
        rest = np.flatnonzero(sequence != held)
        shares = SplitSpec(seed=2 * (seed * 100 + index), validation=0.1, test=0.1)
        inner = split_trials(labels[rest], shares, joined(first[rest]))
        sides = np.concatenate([inner.train, inner.test]), inner.validation
        splits.append(Split(np.sort(rest[sides[0]]), rest[sides[1]], np.flatnonzero(sequence == held)))
    return splits


def run(parameters: Parameters, arrays: Arrays) -> list[dict]:
    """A row per split and set of features: accuracies and the cost of a decision."""
    if parameters.chain == "RSNN":
        return _spiking_rows(parameters, arrays)
    return _slfn_rows(parameters.chain, parameters, arrays)


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy with its confidence interval against the energy estimate; the presses of each cube."""
    yield pvdf_hardness_figures.accuracy_and_cost(results)
    yield pvdf_hardness_figures.presses(arrays)


def task(data: HardnessData) -> TaskData:
    """The smoothed presses as sequences, their four moments as features; every press is a group."""
    arrays = load(data)
    labels = arrays["labels"]
    rate_Hz = float(arrays["sampling_rate_Hz"])
    return TaskData(arrays["features"], arrays["presses"], rate_Hz, "mV", labels, np.arange(len(labels)))


def _splits(parameters: Parameters, arrays: Arrays) -> list[Split]:
    given = arrays["labels"], arrays["sequence"], parameters.protocol, parameters.splits, parameters.seed
    return splits_of(*given, equal_examples(arrays["presses"]))


def _slfn_rows(classifier: SLFN, parameters: Parameters, arrays: Arrays) -> list[dict]:
    _, samples, channels = arrays["presses"].shape
    labels = arrays["labels"]
    n_classes = len(np.unique(labels))
    sides = _splits(parameters, arrays)
    rows = []
    for order in SET_OF:
        width = order * channels
        chosen = choices(classifier, arrays["features"][:, :width], labels, sides, parameters.network, parameters.seed)
        for choice in chosen:
            sizes = {"samples": samples, "channels": channels, "order": order, "n_classes": n_classes}
            neurons = round(choice.neurons)
            signal_ms = 1e3 * samples / float(arrays["sampling_rate_Hz"])
            unit = unit_cost(classifier, **sizes, neurons=neurons, signal_ms=signal_ms)
            published = preprocessing_flops(SET_OF[order], samples, channels)
            published += slfn_flops(classifier, choice.neurons, width, n_classes)
            row = {
                "chain": classifier,
                "features": f"{width}F",
                "protocol": parameters.protocol,
                "split": choice.split,
                "n_max": choice.n_max,
                "neurons": choice.neurons,
                "accuracy_validation": choice.accuracy_validation,
                "accuracy_test": choice.accuracy_test,
                **{f"n_{side}": len(getattr(sides[choice.split], side)) for side in Split._fields},
                "flops_published": published,
            }
            rows.append({**row, **unit.columns()})
    return rows


def _spiking_rows(parameters: Parameters, arrays: Arrays) -> list[dict]:
    conditions = pd.DataFrame({"label": arrays["labels"], "sequence": arrays["sequence"]})
    recorded = Recordings(arrays["presses"], float(arrays["sampling_rate_Hz"]), "mV", conditions, source="presses")
    splits = _splits(parameters, arrays)
    return [row for number, split in enumerate(splits) for row in _spiking_split(parameters, recorded, number, split)]


def _spiking_split(parameters: Parameters, recorded: Recordings, number: int, split: Split) -> Iterator[dict]:
    """The spiking chain on one split, over the full window and with early exit."""
    encoder = calibrate(recorded.select(split.train), parameters.encoder).encoder
    trains = encode_recordings(recorded, encoder)
    window_ms = 1e3 * int(trains.trial_steps[0]) / trains.sampling_rate_Hz
    what = tasks.Task(window=WindowSpec(length_ms=window_ms))
    seeds = np.random.SeedSequence([parameters.seed, number]).generate_state(2 * parameters.starts).tolist()
    pairs = list(zip(seeds[::2], seeds[1::2], strict=True))
    networks = [trainer.fit(trains, parameters.spiking, what, pair, split=split) for pair in pairs]
    fitted, sides = max(networks, key=lambda both: both[0].training.best.validation_accuracy)
    row: dict[str, Any] = measuring.measure(fitted, sides, trains.populations)["row"]
    for chain, accuracy, prefix, steps in (
        ("RSNN", "accuracy_test", "sops", row["window_steps"]),
        (EARLY, "exit_accuracy", "exit_sops", row["exit_steps"]),
    ):
        measured = {f"sops_{name}": row[f"{prefix}_{name}"] for name in ("input", "recurrent", "readout")}
        signal_ms = 1e3 * steps / trains.sampling_rate_Hz
        samples = max(1, round(1e-3 * signal_ms * recorded.sampling_rate_Hz))
        smoothing = cost(MovingAverage(samples, recorded.n_channels))  # `load` applied it, for all chains
        encoding = ledger.Afferents.of(trains).cost(steps, measured["sops_input"] / fitted.network.spec.hidden)
        sizes = len(trains.afferents), len(trains.classes)
        network = ledger.network_cost(fitted.network.spec, *sizes, measured, steps=steps, signal_ms=signal_ms)
        yield {
            "chain": chain,
            "features": "spikes",
            "protocol": parameters.protocol,
            "split": number,
            "n_max": fitted.network.spec.hidden,
            "neurons": float(fitted.network.spec.hidden),
            "accuracy_validation": row["accuracy_validation"],
            "accuracy_test": row[accuracy],
            **{f"n_{side}": len(getattr(split, side)) for side in Split._fields},
            "flops_published": float("nan"),
            **(smoothing + encoding + network).columns(),
        }
