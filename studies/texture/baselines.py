"""The systems before the texture paper (its Table I) and its RSNN, on the gratings and the split of the RSNN studies.

Each system is an encoder, features of whole windows and a classifier; or a spiking network, which reads the spikes as
they arrive and may decide early. Everything fitted or chosen (standardisation, grids, time constants, exit rule) uses
only training and validation trials. The published values are from other sensors and textures: context, not claims.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.opponents.elm import ELMClassifier
from neurotact_parts.opponents.kernel_machines import SupportVectorMachines
from neurotact_parts.studies.texture import baselines_figures as figures
from neurotact_parts.studies.texture import spike_feature_flops as spent
from neurotact_parts.studies.texture import spike_features
from neurotact_parts.studies.texture.simulator import GratingsSpec, simulate
from neurotact_parts.studies.texture.spike_distances import van_rossum, victor_purpura
from pydantic import BeforeValidator, Field
from sklearn.neighbors import KNeighborsClassifier
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from neurotact import spec as specs
from neurotact.data.recordings import LABEL, class_indices
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, SplitSpec, split_conditions
from neurotact.data.windows import Windows, WindowSpec
from neurotact.encoders import specs as encoders
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import AnyEncoder
from neurotact.errors import InputError, nearest
from neurotact.figures.style import Drawn
from neurotact.metrics.flops import Cost, Dense, Layer, NearestPoints, Standardise, cost
from neurotact.metrics.spike_trains import Events, events_of_raster, rates_Hz, spike_counts
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import trainer
from neurotact.networks.training.tasks import Task
from neurotact.networks.use import ledger, measuring
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View, heads

SIDES = ("force_N", "speed_mm_per_s")
"""Conditions balanced in the split, as in the studies of the RSNN."""
LAG_ms = 10.0
BIN_ms = 10.0
DELAYS = 10
COLUMNS = 16
TAUS_ms = (3.0, 10.0, 30.0, 100.0)
SHIFT_COSTS_per_s = (10.0, 30.0, 100.0, 300.0)
NEIGHBOURS = (1, 3, 5, 9, 15)
SVM_C = (1.0, 10.0, 100.0, 1000.0)
SVM_GAMMA = (0.3, 1.0, 3.0)
"""Gamma times the number of features, as scikit-learn's `scale` for standardised features."""
ELM_HIDDEN = (100, 400, 1000)
ELM_ALPHAS = tuple(10.0**power for power in range(-6, 4))

Features = Literal[
    "spikes", "rate", "rate, CV", "ISI, rate", "statistics", "delays", "image", "van Rossum", "Victor-Purpura"
]
Classifier = Literal["kNN", "SVM", "ELM", "SNN", "RSNN"]


def _named(load: Callable[[str], Spec]) -> BeforeValidator:
    """A spec that may be given by its name; a resolved study holds it in full."""
    return BeforeValidator(lambda value: load(value) if isinstance(value, str) else value)


NamedEncoder = Annotated[AnyEncoder, _named(encoders.load)]
NamedNetwork = Annotated[RSNNSpec, _named(partial(specs.load, RSNNSpec))]


class GratingSpikesSpec(Spec):
    """Simulated gratings, and the spikes of each encoder in the longest window."""

    gratings: GratingsSpec = GratingsSpec()
    encoders: dict[str, NamedEncoder] = Field(
        default={"LIF": "sa1-ra1-lif", "Izhikevich": "izhikevich", "Poisson": "poisson"},  # pyright: ignore
        validate_default=True,
    )
    """Encoders by their names in the results."""
    start_ms: float = Field(default=250.0, ge=0)
    """Start of every window."""
    longest_ms: float = Field(default=1000.0, gt=0)


class Parameters(Spec):
    """One cell: an encoder, a window, features of it and a classifier."""

    data: GratingSpikesSpec = GratingSpikesSpec()
    encoder: str = "LIF"
    window_ms: float = Field(default=150.0, gt=0)
    features: Features = "rate, CV"
    """`spikes` for the spiking networks."""
    classifier: Classifier = "kNN"
    network: NamedNetwork = Field(default="rsnn", validate_default=True)  # pyright: ignore[reportAssignmentType]
    """Network spec of RSNN and SNN, which differ only in recurrence."""
    taus_ms: tuple[Annotated[float, Field(gt=0)], ...] = Field(default=(5.0, 20.0), min_length=1)
    """Candidate time constants of membrane and synapse of a spiking network, chosen on validation trials."""
    batch: int = Field(default=128, ge=1)
    """Windows in a training batch of the networks, in place of their spec's value."""
    split: SplitSpec = SplitSpec()
    seeds: tuple[int, ...] = Field(default=(0, 1, 2), min_length=1)
    """Random seeds of the hidden weights of ELMs and of the networks; kNN and SVM have none, and one row."""


class Seen(NamedTuple):
    """The trials of a cell: their spikes in the window, class indices, and the split."""

    events: Events
    labels: np.ndarray
    split: Split
    rate_Hz: float

    @property
    def n_steps(self) -> int:
        return int(self.events.trial_steps[0])

    @property
    def spikes(self) -> float:
        """Mean number of spikes of a test window."""
        return float(spike_counts(self.events)[self.split.test].sum(axis=1).mean())


class Decided(NamedTuple):
    """The results of one system: accuracies, choices, costs of features and classifier, length of the signal."""

    decision: str
    accuracy_validation: float
    accuracy_test: float
    chosen: str
    features: Cost
    classifier: Cost
    signal_ms: float
    seed: int = 0


# --- data --------------------------------------------------------------------------------------------


def load(data: GratingSpikesSpec) -> Arrays:
    """Conditions `(trial,)`; and for each encoder `NAME/trial`, `NAME/afferent` and `NAME/step` `(spike,)`, steps from
    the windows' start on, in the order of trial, afferent and step. `clock_Hz`, `afferents` and `recorded_Hz`, samples
    of the recordings per second, are the same for all.
    """
    recordings = simulate(data.gratings)
    arrays = {name: recordings.conditions[name].to_numpy() for name in SIDES}
    arrays["recorded_Hz"] = np.array(recordings.sampling_rate_Hz)
    arrays[LABEL] = recordings.conditions[LABEL].to_numpy(str)
    for name, encoder in data.encoders.items():
        trains = encode_recordings(recordings, encoder)
        clock = arrays.setdefault("clock_Hz", np.array(trains.sampling_rate_Hz))
        if clock != trains.sampling_rate_Hz:
            raise InputError(f"encoders.{name}: runs at {trains.sampling_rate_Hz:g} Hz, another at {clock:g} Hz; match")
        arrays["afferents"] = np.array(trains.afferents)
        start, length = (round(ms * 1e-3 * trains.sampling_rate_Hz) for ms in (data.start_ms, data.longest_ms))
        if start + length > trains.trial_steps.min():
            raise InputError("longest_ms: windows end after the slide; lengthen gratings.duration_s or shorten them")
        every = Windows(np.arange(len(trains)), np.full(len(trains), start), length)
        events = events_of_raster(trains.raster(every))
        arrays |= {f"{name}/{key}": getattr(events, key).astype(np.int32) for key in ("trial", "afferent", "step")}
    return arrays


def seen_of(parameters: Parameters, arrays: Arrays) -> Seen:
    """The input of a cell: its encoder's spikes in the first `window_ms`."""
    name, n_trials = parameters.encoder, len(arrays[LABEL])
    if name not in parameters.data.encoders:
        raise InputError(f"encoder: '{name}' is not in data.encoders; {nearest(name, [*parameters.data.encoders])}")
    if parameters.window_ms > parameters.data.longest_ms:
        raise InputError(f"window_ms: {parameters.window_ms:g} is more than data.longest_ms; shorten it")
    rate_Hz = float(arrays["clock_Hz"])
    n_steps = round(parameters.window_ms * 1e-3 * rate_Hz)
    trial, afferent, step = (arrays[f"{name}/{key}"].astype(np.int64) for key in ("trial", "afferent", "step"))
    inside = step < n_steps
    lengths = np.full(n_trials, n_steps, np.int64)
    events = Events(trial[inside], afferent[inside], step[inside], lengths, len(arrays["afferents"]))
    conditions = conditions_of(arrays)
    split = split_conditions(conditions, SIDES, parameters.split)
    return Seen(events, class_indices(conditions), split, rate_Hz)


def conditions_of(arrays: Arrays) -> pd.DataFrame:
    """One row per trial: label, force and speed."""
    return pd.DataFrame({name: arrays[name] for name in (LABEL, *SIDES)})


# --- features ----------------------------------------------------------------------------------------


def feature_table(name: str, seen: Seen) -> tuple[np.ndarray, list[Layer]]:
    """Features of every trial, `(trial, feature)`, and their cost."""
    events, rate_Hz, n_steps = seen.events, seen.rate_Hz, seen.n_steps
    of = events.n_afferents, seen.spikes
    rates, counting = rates_Hz(events, rate_Hz), spent.Rates(*of)
    if name == "rate":
        return rates, [counting]
    if name == "rate, CV":
        return np.hstack([rates, spike_features.isi_variations(events)]), [counting, spent.Intervals(*of)]
    if name == "ISI, rate":
        isis = spike_features.mean_isis(events, rate_Hz)
        return np.hstack([isis, rates]), [counting, spent.Intervals(*of, variation=False)]
    if name == "statistics":
        bin_steps, lag_steps = (round(ms * 1e-3 * rate_Hz) for ms in (BIN_ms, LAG_ms))
        pairs = spike_features.co_occurrences(events, lag_steps)
        fano = spike_features.bin_fano_factors(events, bin_steps)
        layers = [
            counting,
            spent.Intervals(*of),
            spent.BinFanoFactors(*of, bins=n_steps // bin_steps),
            spent.CoOccurrences(*of, pairs=float(pairs[seen.split.test].sum(axis=1).mean())),
        ]
        return np.hstack([rates, spike_features.isi_variations(events), fano, pairs]), layers
    if name == "delays":
        apart_ms = 1e3 * n_steps / rate_Hz / DELAYS
        traces = spike_features.delayed_traces(events, rate_Hz, tau_ms=apart_ms, delay_ms=apart_ms, n_delays=DELAYS)
        return traces, [spent.DelayedTraces(*of, steps=n_steps, delays=DELAYS)]
    if name == "image":
        counts = spike_features.grey_images(events, COLUMNS, white=255)
        white = max(1, int(counts[seen.split.train].max()))  # the fullest bin of the training trials
        images = spike_features.grey_images(events, COLUMNS, white).reshape(len(counts), -1)
        return images.astype(float), [spent.GreyImages(*of, columns=COLUMNS)]
    raise InputError(f"features: '{name}' are not features of a plain classifier; {nearest(name, VECTORS)}")


VECTORS = ("rate", "rate, CV", "ISI, rate", "statistics", "delays", "image")
DISTANCES: dict[str, tuple[Callable[..., np.ndarray], str, tuple[float, ...]]] = {
    "van Rossum": (van_rossum, "tau_ms", TAUS_ms),
    "Victor-Purpura": (victor_purpura, "shift_cost_per_s", SHIFT_COSTS_per_s),
}
"""Each distance, its parameter, and the candidate values."""


# --- systems -----------------------------------------------------------------------------------------


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for each random start, and for the spiking networks one more each, with early exit."""
    seen = seen_of(parameters, arrays)
    encoder = parameters.data.encoders[parameters.encoder].model_dump(mode="json")
    n_taxels = seen.events.n_afferents // 2
    rows = []
    for decided in _decided(parameters, seen, arrays):
        steps = decided.signal_ms * 1e-3 * seen.rate_Hz
        encoding = encoding_cost(n_taxels, steps, decided.signal_ms, encoder, recorded_Hz=float(arrays["recorded_Hz"]))
        total = encoding + decided.features + decided.classifier
        rows.append(
            {
                "encoder": parameters.encoder,
                "features": parameters.features,
                "classifier": parameters.classifier,
                "window_ms": parameters.window_ms,
                "decision": decided.decision,
                "seed": decided.seed,
                "as_in": AS_IN.get((parameters.encoder, parameters.features, parameters.classifier), ""),
                "accuracy_validation": decided.accuracy_validation,
                "accuracy_test": decided.accuracy_test,
                "signal_ms": decided.signal_ms,
                "flops": total.flops,
                "flops_encoder": encoding.flops,
                "flops_features": decided.features.flops,
                "flops_classifier": decided.classifier.flops,
                **total.columns("macs", "acs", "sops", "parameters", "bytes", "energy_estimate_nJ"),
                "n_train": len(seen.split.train),
                "n_validation": len(seen.split.validation),
                "n_test": len(seen.split.test),
                "spikes": seen.spikes,
                "chosen": decided.chosen,
            }
        )
    return rows


AS_IN = {
    ("Izhikevich", "rate, CV", "kNN"): "[13]",
    ("Izhikevich", "statistics", "kNN"): "[14]",
    ("Izhikevich", "ISI, rate", "SVM"): "[15]",
    ("Izhikevich", "delays", "ELM"): "[16]",
    ("Izhikevich", "van Rossum", "kNN"): "[17]",
    ("Izhikevich", "Victor-Purpura", "kNN"): "[17]",
    ("Poisson", "spikes", "SNN"): "[18]",
    ("LIF", "spikes", "RSNN"): "[this work]",
}
"""The rows of the texture paper's Table I, by its references. [18] shows its network images of Poisson spikes."""


def _decided(parameters: Parameters, seen: Seen, arrays: Arrays) -> Iterator[Decided]:
    name, features = parameters.classifier, parameters.features
    is_network = name in ("SNN", "RSNN")
    if is_network != (features == "spikes") or (features in DISTANCES and name != "kNN"):
        raise InputError(
            f"classifier: {name} does not take {features}; give the networks spikes, kNN distances, and all but the "
            f"networks {', '.join(VECTORS)}"
        )
    if is_network:
        for seed in parameters.seeds:
            yield from network(parameters, seen, arrays, seed)
    elif features in DISTANCES:
        yield nearest_trains(features, seen, parameters.window_ms)
    else:
        table, layers = feature_table(features, seen)
        scaled = StandardScaler().fit(table[seen.split.train]).transform(table)
        taking = cost(*layers)
        for seed in parameters.seeds if name == "ELM" else parameters.seeds[:1]:
            validated, tested, chosen, deciding = FAMILIES[name](scaled, seen.labels, seen.split, seed)
            whole = cost(Standardise(table.shape[1]), *deciding)
            yield Decided("window", validated, tested, chosen, taking, whole, parameters.window_ms, seed)


Chosen = tuple[float, float, str, list[Layer]]
"""Accuracy on validation and on test trials, the choice, and the layers of the classifier."""


def knn(features: np.ndarray, labels: np.ndarray, split: Split, seed: int) -> Chosen:
    """The k nearest neighbours (ties: the smallest k)."""
    train, validation, test = split
    fitted = KNeighborsClassifier(NEIGHBOURS[-1], algorithm="brute").fit(features[train], labels[train])
    near = {side: fitted.kneighbors(features[part])[1] for side, part in (("v", validation), ("t", test))}
    best = max(NEIGHBOURS, key=lambda k: (_share(labels[train][near["v"][:, :k]], labels[validation]), -k))
    validated, tested = (
        _share(labels[train][near[side][:, :best]], labels[part]) for side, part in (("v", validation), ("t", test))
    )
    return validated, tested, f"k = {best}", [NearestPoints(len(train), features.shape[1], best)]


def svm(features: np.ndarray, labels: np.ndarray, split: Split, seed: int) -> Chosen:
    """Support vector machines with an RBF kernel, one against one (ties: the smoothest)."""
    train, validation, test = split
    grid = [(c, gamma / features.shape[1]) for c in SVM_C for gamma in SVM_GAMMA]
    tried = [SVC(C=c, gamma=gamma).fit(features[train], labels[train]) for c, gamma in grid]
    scores = [machine.score(features[validation], labels[validation]) for machine in tried]
    best = tried[int(np.argmax(scores))]
    layers: list[Layer] = [SupportVectorMachines(len(best.support_), features.shape[1], len(best.classes_))]
    tested = float(best.score(features[test], labels[test]))
    return float(max(scores)), tested, f"C = {best.C:g}, gamma = {best.gamma:.3g}", layers


def elm(features: np.ndarray, labels: np.ndarray, split: Split, seed: int) -> Chosen:
    """Extreme learning machines with sigmoids (ties: the smallest, then the most regularised)."""
    train, validation, test = split
    # Weights are uniform in (-1, 1): many features saturate the sigmoids unless they are scaled down.
    scales = (1.0, features.shape[1] ** -0.5)
    tried = []
    for hidden, scale in product(ELM_HIDDEN, scales):
        machine = ELMClassifier(hidden, random_state=seed).fit(scale * features[train], labels[train])
        path = machine.accuracy_path(ELM_ALPHAS, scale * features[validation], labels[validation])
        tried += [(float(score), -hidden, alpha, scale) for score, alpha in zip(path, ELM_ALPHAS, strict=True)]
    validated, minus_hidden, alpha, scale = max(tried)
    features = scale * features
    machine = ELMClassifier(-minus_hidden, alpha=alpha, random_state=seed).fit(features[train], labels[train])
    layers: list[Layer] = [
        Dense(features.shape[1], -minus_hidden, "sigmoid"), Dense(*machine.coef_.shape, bias=False),
    ]  # fmt: skip
    tested = float(machine.score(features[test], labels[test]))
    return validated, tested, f"{-minus_hidden} hidden, alpha = {alpha:g}", layers


FAMILIES: Mapping[str, Callable[[np.ndarray, np.ndarray, Split, int], Chosen]] = {"kNN": knn, "SVM": svm, "ELM": elm}


def nearest_trains(name: str, seen: Seen, window_ms: float) -> Decided:
    """The k nearest neighbours by a distance between spike trains; its parameter and k are chosen together."""
    distance, key, values = DISTANCES[name]
    train, validation, test = (select(seen.events, part) for part in seen.split)
    known, wanted = seen.labels[seen.split.train], seen.labels[seen.split.validation]
    tried = []
    for value in values:
        near = _nearest(distance(validation, seen.rate_Hz, others=train, **{key: value}))
        tried += [(_share(known[near[:, :k]], wanted), -k, value) for k in NEIGHBOURS]
    validated, minus_k, value = max(tried)
    near = _nearest(distance(test, seen.rate_Hz, others=train, **{key: value}))
    tested = _share(known[near[:, :-minus_k]], seen.labels[seen.split.test])
    theirs = spike_counts(train).sum(axis=0)
    of, kept = (train.n_afferents, seen.spikes), {"references": len(known), "reference_spikes": float(theirs.sum())}
    if name == "van Rossum":
        layer: Layer = spent.VanRossum(*of, **kept, steps=seen.n_steps)
    else:
        layer = spent.VictorPurpura(*of, **kept, pairs=float(spike_counts(test).mean(axis=0) @ theirs))
    chosen = f"{key} = {value:g}, k = {-minus_k}"
    deciding = cost(spent.NearestOf(len(known), -minus_k))
    return Decided("window", validated, tested, chosen, cost(layer), deciding, window_ms)


def network(parameters: Parameters, seen: Seen, arrays: Arrays, seed: int) -> Iterator[Decided]:
    """A spiking network over the whole window, and the same one with early exit."""
    trains = trains_of(parameters, seen, arrays)
    window = WindowSpec(length_ms=parameters.window_ms, per_trial=1)
    task = Task(window=window, split=parameters.split, stratify=SIDES)
    model = "rsnn" if parameters.classifier == "RSNN" else "snn"
    tried = []
    training = parameters.network.training.model_copy(update={"batch": parameters.batch})
    for tau_ms in parameters.taus_ms:
        changes = {"model": model, "tau_mem_ms": tau_ms, "tau_syn_ms": tau_ms, "training": training}
        spec = parameters.network.model_copy(update=changes)
        tried.append(trainer.fit(trains, spec, task, (seed, seed + 1)))
    fitted, sides = max(tried, key=lambda pair: pair[0].training.best.validation_accuracy)
    row, spec = measuring.measure(fitted, sides, trains.populations)["row"], fitted.network.spec
    sizes = len(trains.afferents), len(trains.classes)
    chosen = f"tau = {spec.tau_mem_ms:g} ms"
    for decision, start, accuracy, steps in (
        ("window", "", row["accuracy_test"], row["window_steps"]),
        ("early exit", "exit_", row["exit_accuracy"], row["exit_steps"]),
    ):
        sops = {name: row[start + name] for name in ledger.SOPS}
        signal_ms = 1e3 * steps / seen.rate_Hz
        counted = ledger.network_cost(spec, *sizes, sops, steps=steps, signal_ms=signal_ms)
        validated = row["accuracy_validation"] if decision == "window" else float("nan")
        yield Decided(decision, validated, accuracy, chosen, Cost(), counted, signal_ms, seed)


def trains_of(parameters: Parameters, seen: Seen, arrays: Arrays) -> SpikeTrains:
    """The spikes of a cell in the format of a network: events of each trial in order of time."""
    events = seen.events
    order = np.lexsort((events.afferent, events.step, events.trial))
    ends = np.cumsum(np.bincount(events.trial, minlength=len(events.trial_steps)))[:-1]
    return SpikeTrains(
        steps=np.split(events.step[order], ends),
        units=np.split(events.afferent[order], ends),
        trial_steps=events.trial_steps,
        sampling_rate_Hz=seen.rate_Hz,
        afferents=tuple(arrays["afferents"].tolist()),
        conditions=conditions_of(arrays),
        encoder=parameters.data.encoders[parameters.encoder].model_dump(mode="json"),
        recorded_Hz=float(arrays["recorded_Hz"]),
    )


def select(events: Events, trials: np.ndarray) -> Events:
    """The events of some trials, given in ascending order and renumbered."""
    number = np.full(len(events.trial_steps), -1)
    number[trials] = np.arange(len(trials))
    mine = number[events.trial] >= 0
    trial, afferent, step = number[events.trial[mine]], events.afferent[mine], events.step[mine]
    return Events(trial, afferent, step, events.trial_steps[trials], events.n_afferents)


def _nearest(distances: np.ndarray) -> np.ndarray:
    """Indices of the nearest references, `(trial, neighbour)`, in ascending distance; ties to the first."""
    return np.argsort(distances, axis=1, kind="stable")[:, : NEIGHBOURS[-1]]


def _share(neighbours: np.ndarray, labels: np.ndarray) -> float:
    """Accuracy of the vote of each row's neighbours (ties: the lowest class)."""
    votes = np.apply_along_axis(np.bincount, 1, neighbours, minlength=int(max(neighbours.max(), labels.max())) + 1)
    return float((votes.argmax(axis=1) == labels).mean())


# --- report ------------------------------------------------------------------------------------------


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy over the length of the signal, over features and encoders, and over costs."""
    yield from figures.drawings(results)


VIEW = View(
    by=("classifier", "features", "encoder", "window_ms", "decision"),
    measures=heads(
        "accuracy_test signal_ms flops flops_encoder flops_features flops_classifier parameters "
        "energy_estimate_nJ spikes",
        flops_encoder="encoder",
        flops_features="features",
        flops_classifier="classifier",
        spikes="spikes",
    ),
    cost="flops",
    score="accuracy_test",
    note=(
        "The texture paper's Table I names earlier systems without accuracies; they were measured "
        "with other sensors on other textures. Features use whole windows of both SA-I and RA-I afferents."
    ),
    apart=("window_ms",),
    spiking=("classifier", ("SNN", "RSNN")),
    splits=(),
)
