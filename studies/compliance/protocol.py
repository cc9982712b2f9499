"""The compliance paper's chain: moment curves of two tactile arrays, four features per curve, k-means, 42 objects.

`paper` uses test data where the paper does or may: the repetition of k-means is chosen on the test set (its
Sec. 3.5), and the fixed-point scale and the PCA are fitted on all vectors, since the paper does not say. `honest` fits
both on training vectors and chooses on validation vectors.
"""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.compliance import figures as compliance_figures
from neurotact_parts.studies.compliance.centroid_kmeans import ClassCentroidKMeans, Init
from neurotact_parts.studies.compliance.curve_features import COMBINATIONS, curve_features, instants, select_features
from neurotact_parts.studies.compliance.fixed_point import fit_fixed_point
from neurotact_parts.studies.compliance.flops import CurveFeatures, Projection, TactileMoments
from neurotact_parts.studies.compliance.fpga_resources import published_accuracy
from neurotact_parts.studies.compliance.simulator import CHANNELS, SENSORS, ComplianceSpec, simulate, skin_of
from neurotact_parts.studies.compliance.tactile_moments import NAMES, moment_weights
from neurotact_parts.studies.task_data import TaskData
from pydantic import Field
from sklearn.decomposition import PCA

from neurotact.data.splits import SplitSpec, split_trials
from neurotact.figures.style import Drawn
from neurotact.metrics.flops import Cost, Layer, NearestPoints, cost
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View, heads

TEST_SHARE = 673 / 1974
"""673 of 1974 vectors are test vectors (compliance paper, Sec. 5.1)."""
VALIDATION_SHARE = 0.15
"""Share of all vectors, taken from the training side: ours, since the paper has no validation set."""
SHOWN = ("OBJ-2", "OBJ-17", "OBJ-38")
"""Objects whose curves the paper draws (Figs. 1 and 6)."""
TASK_STEP = 5
"""Samples per step of a task's sequence: 97 steps per second."""

SensorChoice = Literal["finger", "palm", "finger and palm"]


class Parameters(Spec):
    """One row block of Tables 3 and 5: a protocol, the sensors, the bits, with or without PCA."""

    data: ComplianceSpec = ComplianceSpec()
    protocol: Literal["honest", "paper"] = "honest"
    sensors: SensorChoice = "finger and palm"
    bits: int = Field(default=12, ge=1, le=32)
    """Bits of every feature (8, 12 and 16 in the paper)."""
    component_counts: tuple[int, ...] = (0,)
    """Candidate numbers of principal components; 0 is without PCA."""
    moment_counts: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    """Numbers of moments, in the order of Tables 3 and 5."""
    combinations: tuple[str, ...] = tuple(COMBINATIONS)
    """Candidate combinations of features (Table 2)."""
    repetitions: int = Field(default=100, ge=1)
    """Repetitions of k-means, of which the best is kept (Sec. 3.5)."""
    init: Init = "k-means++"
    seed: int = Field(default=0, ge=0)
    """Random seed of the split and of k-means."""


VIEW = View(
    ("protocol", "sensors", "bits", "moments", "combination", "components"),
    heads(
        "accuracy_test accuracy_validation accuracy_class_means accuracy_published inputs flops signal_ms",
        accuracy_class_means="test accuracy from class means (%)",
        accuracy_published="published (%)",
        inputs="inputs",
    ),
    "flops",
    "accuracy_test",
    "Rows of the protocol `paper` use test data: the best of the repetitions of k-means, the combination of "
    "features and the number of components are chosen by test accuracy, and the fixed-point scale and the PCA use all "
    "vectors. Rows of `honest` choose on validation vectors and fit on training vectors. `accuracy_class_means` starts "
    "k-means at the means of the classes, once. Published values are given for the rows in Tables 3 and 5.",
    apart=("protocol",),
    optimistic=("paper",),
)


class Sides(NamedTuple):
    """Indices of the vectors to fit the scale and the PCA, to train k-means, to choose, and to test."""

    fit: np.ndarray
    train: np.ndarray
    choose: np.ndarray
    test: np.ndarray


class Vectors(NamedTuple):
    """The input of the classifier, `(example, input)` for each of the three sides."""

    train: np.ndarray
    choose: np.ndarray
    test: np.ndarray


def load(data: ComplianceSpec) -> Arrays:
    """`features` (exploration, curve, AR MAX H1 H2), `labels`, and `curves` of one exploration of SHOWN."""
    touch = simulate(data)
    features = np.stack([curve_features(s, data.peak, data.sampling_rate_Hz) for s in touch.signals])
    labels = touch.conditions["label"].to_numpy(dtype=str)
    shown = [int(np.flatnonzero(labels == label)[0]) for label in SHOWN]
    return {
        "features": features,
        "labels": labels,
        "curves": np.asarray(touch.signals)[shown],
        "sampling_rate_Hz": np.array(data.sampling_rate_Hz),
        "peak": np.array(data.peak),
    }


def run(parameters: Parameters, arrays: Arrays) -> list[dict]:
    """A row for each number of moments, combination of features and number of components."""
    rows = []
    for moments in parameters.moment_counts:
        tried = [
            _row(parameters, arrays, moments, combination, components)
            for components in parameters.component_counts
            for combination in parameters.combinations
            if components <= n_features(parameters.sensors, moments, combination)
        ]
        by = "accuracy_test" if parameters.protocol == "paper" else "accuracy_validation"
        best = max(tried, key=lambda row: (row[by], -row["inputs"]), default=None)
        rows += [row | {"chosen": row is best} for row in tried]
    return rows


def _row(parameters: Parameters, arrays: Arrays, moments: int, combination: str, components: int) -> dict:
    sides = sides_of(arrays["labels"], parameters.protocol, parameters.seed)
    vectors = vectors_of(parameters, arrays["features"], sides, moments, combination, components)
    labels = arrays["labels"]
    fitted = fit_kmeans(parameters, vectors, labels, sides)
    means = ClassCentroidKMeans(init="class-mean").fit(vectors.train, labels[sides.train])
    cost_of = decision_cost(parameters, moments, combination, components)
    validation = None
    if parameters.protocol == "honest":
        validation = _accuracy(fitted, vectors.choose, labels[sides.choose])
    return {
        "protocol": parameters.protocol,
        "sensors": parameters.sensors,
        "bits": parameters.bits,
        "seed": parameters.seed,
        "moments": moments,
        "combination": combination,
        "components": components,
        "inputs": vectors.train.shape[1],
        "accuracy_test": _accuracy(fitted, vectors.test, labels[sides.test]),
        "accuracy_validation": validation,
        "accuracy_class_means": _accuracy(means, vectors.test, labels[sides.test]),
        "accuracy_published": _published(parameters, moments, combination, components),
        "n_test": len(sides.test),
        "repetitions": parameters.repetitions,
        **cost_of.columns("flops", "macs", "acs", "parameters", "signal_ms", "energy_estimate_nJ"),
    }


def sides_of(labels: np.ndarray, protocol: str, seed: int) -> Sides:
    """The vectors to fit, train, choose and test; stratified, with the same test side for both protocols.

    >>> labels = np.repeat(["kiwi", "pear"], 47)
    >>> [[len(side) for side in sides_of(labels, protocol, 0)] for protocol in ("honest", "paper")]
    [[48, 48, 14, 32], [94, 62, 32, 32]]
    """
    split = split_trials(labels, SplitSpec(validation=VALIDATION_SHARE, test=TEST_SHARE, seed=seed))
    if protocol == "honest":
        return Sides(split.train, split.train, split.validation, split.test)
    every, known = np.arange(len(labels)), np.sort(np.concatenate([split.train, split.validation]))
    return Sides(every, known, split.test, split.test)


def n_features(sensors: SensorChoice, moments: int, combination: str) -> int:
    """Features of an exploration: sensors x moments x features of the combination.

    >>> n_features("finger and palm", 1, "d5"), n_features("finger", 4, "d5")
    (4, 8)
    """
    return len(_chosen_sensors(sensors)) * moments * len(COMBINATIONS[combination])


def vectors_of(
    parameters: Parameters, features: np.ndarray, sides: Sides, moments: int, combination: str, components: int
) -> Vectors:
    """Quantise on one scale, select, and project: all three are fitted only on `sides.fit`.

    features: `(exploration, curve, 4)`, the curves as CHANNELS names them. The scale spans every curve and feature.
    """
    scale = fit_fixed_point(features[sides.fit], parameters.bits)
    curves = [
        CHANNELS.index(f"{sensor} {name}") for sensor in _chosen_sensors(parameters.sensors) for name in NAMES[:moments]
    ]
    codes = select_features(scale.codes(features[:, curves]), combination)
    if components:
        # Of codes; the components themselves are not quantised again.
        codes = PCA(components, svd_solver="full").fit(codes[sides.fit]).transform(codes)
    return Vectors(codes[sides.train], codes[sides.choose], codes[sides.test])


def fit_kmeans(parameters: Parameters, vectors: Vectors, labels: np.ndarray, sides: Sides) -> ClassCentroidKMeans:
    """The best of the repetitions on `sides.choose`, which is the test side for `paper`."""
    kmeans = ClassCentroidKMeans(parameters.init, parameters.repetitions, random_state=parameters.seed)
    return kmeans.fit(vectors.train, labels[sides.train], validation=(vectors.choose, labels[sides.choose]))


def decision_cost(parameters: Parameters, moments: int, combination: str, components: int) -> Cost:
    """The cost of one exploration, from the taxels to the label, and the required length of the signal."""
    data, names = parameters.data, COMBINATIONS[combination]
    frames = last_frame(data.peak, names, data.n_samples) + 1
    arrays = [skin_of(data, sensor) for sensor in _chosen_sensors(parameters.sensors)]
    features = n_features(parameters.sensors, moments, combination)
    layers: list[Layer] = [TactileMoments(skin.rows * skin.columns, frames, moments) for skin in arrays]
    layers.append(CurveFeatures(len(arrays) * moments, frames, "AR" in names, len(set(names) - {"AR"})))
    if components:
        layers.append(Projection(features, components))
    layers.append(NearestPoints(42, components or features))
    return cost(*layers, signal_ms=1e3 * frames / data.sampling_rate_Hz)


def last_frame(peak: int, names: tuple[str, ...], n_samples: int) -> int:
    """The sample after which all of `names` are known: AR at the end, H2 at 4/3 of the time to the turn.

    >>> [last_frame(582, names, 1165) for names in (("AR", "MAX"), ("MAX", "H1"), ("H1", "H2"))]
    [1164, 582, 776]
    """
    when = instants(peak)
    known = {"AR": n_samples - 1, "MAX": when.maximum, "H1": when.h1, "H2": when.h2}
    return max(known[name] for name in names)


def _accuracy(kmeans: ClassCentroidKMeans, vectors: np.ndarray, labels: np.ndarray) -> float:
    return float((kmeans.predict(vectors) == labels).mean())


def _chosen_sensors(sensors: SensorChoice) -> tuple[str, ...]:
    return SENSORS if sensors == "finger and palm" else (sensors,)


def _published(parameters: Parameters, moments: int, combination: str, components: int) -> float | None:
    """The accuracy of this case in Tables 3 and 5, if given."""
    named = published_accuracy()
    same = (
        (named["sensor"] == parameters.sensors)
        & (named["bits"] == parameters.bits)
        & (named["moments"] == moments)
        & (named["combination"] == combination)
        & (named["components"] == components)
    )
    return float(named.loc[same, "accuracy"].iloc[0]) if same.any() else None


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """The paper's Figs. 1, 6 and 10 to 15, with our results, and Tables 3 and 5 as curves."""
    rate_Hz, peak = float(arrays["sampling_rate_Hz"]), int(arrays["peak"])
    curves = dict(zip(SHOWN, arrays["curves"], strict=True))
    yield compliance_figures.draw_features(curves["OBJ-2"], peak, rate_Hz)
    yield compliance_figures.draw_curves({label: curves[label] for label in SHOWN[1:]}, rate_Hz)
    for with_pca in (False, True):
        some = results[(results["components"] > 0) == with_pca]
        if len(some):
            yield compliance_figures.draw_accuracy(some, with_pca)
    yield from compliance_figures.draw_merit(results)
    yield compliance_figures.draw_delay()
    yield compliance_figures.draw_projection(_projections(arrays), arrays["labels"])
    for components in (0, 3):
        predicted = _best_case(results, arrays, components)
        if predicted is not None:
            yield compliance_figures.draw_confusion(*predicted, components)


def _projections(arrays: Arrays) -> dict[str, np.ndarray]:
    """Three components of six moments, d5, 8 bits, fitted on training vectors, `(example, 3)` per choice of sensors."""
    sides = sides_of(arrays["labels"], "honest", 0)
    everyone = sides._replace(train=np.arange(len(arrays["labels"])))
    choices: tuple[SensorChoice, ...] = ("finger", "palm", "finger and palm")
    return {
        sensors: vectors_of(Parameters(sensors=sensors, bits=8), arrays["features"], everyone, 6, "d5", 3).train
        for sensors in choices
    }


def _best_case(results: pd.DataFrame, arrays: Arrays, components: int) -> tuple[np.ndarray, np.ndarray] | None:
    """True and predicted labels of the published best case (finger and palm, M00, d5, 12 bits) under `honest`."""
    same = (results["protocol"] == "honest") & (results["sensors"] == "finger and palm") & (results["bits"] == 12)
    case = (results["moments"] == 1) & (results["combination"] == "d5") & (results["components"] == components)
    rows = results[same & case]
    if rows.empty:
        return None
    row = rows.iloc[0]
    parameters = Parameters(repetitions=int(row["repetitions"]), seed=int(row["seed"]))
    sides = sides_of(arrays["labels"], "honest", parameters.seed)
    vectors = vectors_of(parameters, arrays["features"], sides, 1, "d5", components)
    fitted = fit_kmeans(parameters, vectors, arrays["labels"], sides)
    return arrays["labels"][sides.test], fitted.predict(vectors.test)


def task(data: ComplianceSpec) -> TaskData:
    """The task to classify which of 42 objects is squeezed.

    features: d13 (AR, H1, H2) of all six moments of both sensors.
    sequences: the twelve moment curves, each divided by the mean of its weights over the array, so that all have the
    scale of M00 (a constant, independent of the data), and averaged over TASK_STEP samples.
    """
    touch = simulate(data)
    signals = np.asarray(touch.signals)
    features = np.stack([select_features(curve_features(s, data.peak, data.sampling_rate_Hz), "d13") for s in signals])
    weights = [moment_weights(skin_of(data, sensor).rows, skin_of(data, sensor).columns) for sensor in SENSORS]
    scaled = signals / np.concatenate([w.mean(axis=0) for w in weights])
    n_steps = signals.shape[1] // TASK_STEP
    stepped = scaled[:, : n_steps * TASK_STEP].reshape(len(signals), n_steps, TASK_STEP, -1).mean(axis=2)
    return TaskData(
        features.reshape(len(signals), -1),
        stepped.astype(np.float32),
        data.sampling_rate_Hz / TASK_STEP,
        touch.unit,
        touch.conditions["label"].to_numpy(dtype=str),
        np.arange(len(signals)),
    )
