"""A fitted opponent as C99: the means of a window's time bins, standardised, and the shortest C of its decision.

It has the calls of a chain and takes the same samples of 16 bits, which are added up in whole numbers. Trees compare
these sums; the others compute in float32. m2cgen computes in double, for which small processors have no unit, and
emlearn has no support vector machine with kernels and no extreme learning machine.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.exporters.c import c_export
from neurotact_parts.exporters.c.c_export import Table, literal, text, unsigned, wrapped
from neurotact_parts.exporters.c.formats import LARGEST, Raw

from neurotact import __version__
from neurotact.baselines.features import averaged, bin_edges
from neurotact.errors import InputError

PROGRAM = (("opponent.h", "{}.h"), ("opponent.c", "{}.c"))
HARNESS = (("harness.h", "harness.h"), ("harness.c", "harness.c"))
SHARE = 2**16 - 1
"""Of a class in a leaf: the value of a whole one."""


class Decision(NamedTuple):
    """The decision of a fitted estimator: its form in the template, the sizes that it has there, its tables."""

    kind: str
    score: str
    sizes: Mapping[str, int]
    tables: Sequence[Table]


class Standard(NamedTuple):
    """The means of a window's time bins, standardised: the input of an opponent.

    mean, scale: of each bin and taxel, `(bin, taxel)`. is_sequence: whether the input is a sequence of bins, or flat.
    """

    mean: np.ndarray
    scale: np.ndarray
    is_sequence: bool

    @staticmethod
    def of(samples: np.ndarray, n_bins: int, *, is_sequence: bool) -> "Standard":
        """Of training windows `(window, sample, taxel)`; a sequence has one mean and scale of each taxel."""
        means = averaged(samples, n_bins)
        axes = (0, 1) if is_sequence else 0
        mean, scale = (np.broadcast_to(f(means, axis=axes), means.shape[1:]) for f in (np.mean, np.std))
        return Standard(mean, np.where(scale > 0, scale, 1.0), is_sequence)

    def input(self, samples: np.ndarray) -> np.ndarray:
        """The input for windows `(window, sample, taxel)`: `(window, bin, taxel)` or `(window, bin x taxel)`."""
        made = (averaged(samples, len(self.mean)) - self.mean) / self.scale
        return made if self.is_sequence else made.reshape(len(made), -1)


class Means(NamedTuple):
    """How features come from sums of samples: `(sum - centre) scale + shift` with a whole centre, `(feature,)` each."""

    centre: np.ndarray
    scale: np.ndarray
    shift: np.ndarray

    @staticmethod
    def of(standard: Standard, raw: Raw, ends: np.ndarray) -> "Means":
        """ends: of the time bins, `(bin,)`, in samples."""
        widths = np.diff(ends, prepend=0)[:, None]
        mean = ((standard.mean - raw.zero) * widths / raw.lsb).ravel()
        scale = (raw.lsb / (widths * standard.scale)).ravel()
        centre = np.rint(mean)
        return Means(centre, scale, (centre - mean) * scale)

    def sums(self, features: np.ndarray) -> np.ndarray:
        """The largest sums whose feature is not above the given ones."""
        return np.floor((features - self.shift) / self.scale + self.centre)

    def of_taxels(self, n_taxels: int) -> "Means":
        """Those of the taxels, where all time bins have the same; else of all features."""
        parts = [part.reshape(-1, n_taxels) for part in self]
        alike = all((part == part[0]).all() for part in parts)
        return Means(*(part[0] for part in parts)) if alike else self

    def tables(self, kind: str = "float") -> list[Table]:
        """Of this type of C."""
        about = "Of features: subtracted from the sums of samples, their factors, and then added."
        return [
            _whole(about, "centre", self.centre, "int32_t"), _real("", "scale", self.scale, kind),
            _real("", "shift", self.shift, kind),
        ]  # fmt: skip


def write(
    fitted: Any,
    standard: Standard,
    raw: Raw,
    classes: Sequence[str],
    n_samples: int,
    folder: Path,
    *,
    name: str = "touch",
    parts: Sequence[tuple[str, str]] = (*PROGRAM, *HARNESS),
) -> list[Path]:
    """Write the C of a fitted estimator on the means in time bins of a window, and return the paths.

    classes: of the labels 0 and on. n_samples: of a window.
    Raises InputError for an estimator that has no C, as all that tell numbers, and for a class that was not among its
    training examples.

    >>> from sklearn.neighbors import KNeighborsClassifier
    >>> windows = np.array([[[0.0], [1.0]], [[2.0], [5.0]]])
    >>> standard = Standard.of(windows, 2, is_sequence=False)
    >>> nearest = KNeighborsClassifier(1).fit(standard.input(windows), [0, 1])
    >>> [path.name for path in write(nearest, standard, Raw(1, 0), "ab", 2, Path("nearest"), parts=PROGRAM)]
    ['touch.h', 'touch.c']
    """
    names = [kind.__name__ for kind in type(fitted).__mro__]
    if not hasattr(fitted, "classes_"):
        raise InputError(
            f"opponent: {names[0]} tells numbers, and opponents have C for classes alone; export the network, whose C "
            "tells numbers"
        )
    kind = next((name for name in names if name in DECISIONS), "")
    if not kind:
        raise InputError(f"opponent: {names[0]} has no C here; choose among {', '.join(DECISIONS)}")
    if len(fitted.classes_) != len(classes):
        raise InputError(
            f"opponent: knows {len(fitted.classes_)} of {len(classes)} classes; train it on windows of all"
        )
    n_bins, n_taxels = standard.mean.shape
    ends = bin_edges(n_samples, n_bins)[1:]
    if np.diff(ends, prepend=0).max() * 2**15 > LARGEST:
        raise InputError(f"windows: have {n_samples} samples, of which a sum may exceed 32 bits; shorten them")
    means = Means.of(standard, raw, ends)
    decision = DECISIONS[kind](fitted, means)
    if decision.kind == "minirocket":  # whose comparisons need the last bit of its input
        means = means.of_taxels(n_taxels)
    context = {
        "title": f"{kind} on the means of {n_bins} time bins: {n_taxels} taxels, {len(classes)} classes.",
        "version": __version__, "name": name, "macro": name.upper(), "n_taxels": n_taxels, "ends": ends.tolist(),
        "class_names": [text(one) for one in classes], "class_type": unsigned(len(classes)),
        "kind": decision.kind, "score": decision.score or unsigned(len(classes)), "sizes": decision.sizes,
        "tables": [*_standardising(means, decision.kind), *decision.tables], "n_scales": len(means.scale),
        "spiking": False, "numbers": False, "events": False, "learns": False, "finishes": False,
        "afferent_type": "uint8_t", "neuron_type": "uint8_t",
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    return c_export.rendered(context, folder, name, parts)


def _standardising(means: Means, kind: str) -> list[Table]:
    return [] if kind == "trees" else means.tables("double" if kind == "minirocket" else "float")


def _linear(fitted: Any, means: Means) -> Decision:
    """A logistic regression, behind a scaler of its own, which its weights take in."""
    inner, machine = fitted[0], fitted[-1]
    weights = machine.coef_ / inner.scale_
    return Decision("linear", "float", {}, _outputs(weights, machine.intercept_ - weights @ inner.mean_))


def _elm(fitted: Any, means: Means) -> Decision:
    if fitted.activation != "sigmoid":
        raise InputError(f"opponent: an ELM of {fitted.activation} neurons has no C here; use activation 'sigmoid'")
    hidden = [
        _real("Of the hidden layer, one row per neuron.", "hidden_weights", fitted.hidden_weights_.T),
        _real("", "hidden_bias", fitted.hidden_biases_),
    ]
    outputs = _outputs(fitted.coef_.T, fitted.intercept_)
    return Decision("elm", "float", {"HIDDEN": fitted.hidden}, [*hidden, *outputs])


def _outputs(weights: np.ndarray, bias: np.ndarray) -> list[Table]:
    """Tables of an output per class."""
    weights, bias = _of_classes(weights, bias)
    return [_real("Of the classes, one row each.", "weights", weights), _real("", "bias", bias)]


def _of_classes(weights: np.ndarray, bias: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An output per class; the first of two that share one is always 0."""
    if len(weights) > 1:
        return weights, bias
    return np.concatenate([0 * weights, weights]), np.concatenate([0 * bias, bias])


def _machines(fitted: Any, means: Means) -> Decision:
    """Machines of all pairs of classes; a vector has a coefficient for each other class, in their order."""
    sign = -1 if len(fitted.classes_) == 2 else 1  # scikit-learn turns the sign of a single machine
    first = np.concatenate([[0], np.cumsum(fitted.n_support_)])
    tables = [
        _real("Support vectors, class by class.", "vectors", fitted.support_vectors_),
        _real("", "coefficients", sign * fitted.dual_coef_.T), _real("", "bias", sign * fitted.intercept_),
        _whole("The first vector of each class, and their number.", "first", first, "int32_t"),
        _real("", "gamma_of_kernel", np.array([fitted.gamma])),
    ]  # fmt: skip
    return Decision("svm", "", {"VECTORS": int(first[-1])}, tables)


def _trees(fitted: Any, means: Means) -> Decision:
    """Inner nodes of all trees; a child below zero is a leaf, of which those with equal shares are one."""
    trees = [one.tree_ for one in fitted.estimators_]
    of = np.concatenate([tree.value[:, 0] for tree in trees])
    shares, share = np.unique(np.rint(SHARE * of / of.sum(axis=1, keepdims=True)), axis=0, return_inverse=True)
    left, right = (np.concatenate([getattr(tree, f"children_{side}") for tree in trees]) for side in ("left", "right"))
    starts = np.cumsum([0, *(tree.node_count for tree in trees)])
    of_tree = np.repeat(starts[:-1], np.diff(starts))
    inner = left >= 0
    place = np.where(inner, np.cumsum(inner) - 1, -1 - share.ravel())
    children = np.stack([place[left + of_tree], place[right + of_tree]], axis=1)[inner]
    feature = np.concatenate([tree.feature for tree in trees])[inner]
    threshold = np.concatenate([tree.threshold for tree in trees])[inner]
    own = Means(*(part[feature] for part in means))
    sums = np.clip(own.sums(threshold), -LARGEST, LARGEST)
    kind = "int16_t" if max(len(children), len(shares)) < 2**15 else "int32_t"
    tables = [
        _whole("Inner nodes: feature, largest sum that goes left.", "feature", feature, unsigned(len(means.scale))),
        _whole("", "threshold", sums, "int32_t"),
        _whole("Left and right child of each: an inner node, or -1 minus a leaf.", "children", children, kind),
        _whole("The first node of each tree.", "roots", place[starts[:-1]], kind),
        _whole("Shares of the classes in leaves.", "shares", shares, "uint16_t"),
    ]  # fmt: skip
    return Decision("trees", "uint32_t", {"TREES": len(trees)}, tables)


def _neighbours(fitted: Any, means: Means) -> Decision:
    points, labels = fitted._fit_X, fitted._y
    tables = [
        _real("Training examples, and their classes.", "points", points),
        _whole("", "label_of", labels, unsigned(len(fitted.classes_))),
    ]
    return Decision("neighbours", "", {"POINTS": len(points), "NEIGHBOURS": fitted.n_neighbors}, tables)


def _gru(fitted: Any, means: Means) -> Decision:
    """Gates in torch's order: reset, update, candidate."""
    network = {name: value.detach().numpy() for name, value in fitted.network_.state_dict().items()}
    gates = {
        "input_weights": "weight_ih",
        "state_weights": "weight_hh",
        "input_bias": "bias_ih",
        "state_bias": "bias_hh",
    }
    tables = [_real("Of the gates, a row per cell.", name, network[f"gru.{key}_l0"]) for name, key in gates.items()]
    outputs = _outputs(network["dense.weight"], network["dense.bias"])
    return Decision("gru", "float", {"HIDDEN": fitted.hidden}, [*tables, *outputs])


def _minirocket(fitted: Any, means: Means) -> Decision:
    """Counts of values above biases, whose lengths and standardisation the weights take in.

    The 84 kernels are three of nine places in their order; every other convolution is padded.
    """
    convolutions, (scaler, ridge) = fitted.transform_.convolutions_, fitted.ridge_
    n_steps = fitted.transform_.n_steps_
    lengths = [n_steps if one.padded else n_steps - 8 * one.dilation for one in convolutions]
    n_biases = [len(one.biases) for one in convolutions]
    dilations = {one.dilation: n for one, n in zip(convolutions, n_biases, strict=True)}
    places, weights = np.array([*dilations.items()]), np.atleast_2d(ridge.coef_) / scaler.scale_
    of_counts, bias = _of_classes(weights / np.repeat(lengths, n_biases), ridge.intercept_ - weights @ scaler.mean_)
    n_channels = np.array([len(one.channels) for one in convolutions])
    channels = np.concatenate([one.channels for one in convolutions])
    tables = [
        _whole("Dilations, and how many biases a convolution has there.", "dilations", places, "int32_t"),
        _whole("How many taxels each convolution adds up, and which.", "n_taxels", n_channels, "uint8_t"),
        _whole("", "taxels", channels, unsigned(fitted.transform_.n_channels_)),
        _real("Biases of the features.", "biases", np.concatenate([one.biases for one in convolutions])),
        _real("Of the counts of values above a bias, a row each.", "weights", of_counts.T), _real("", "bias", bias),
    ]  # fmt: skip
    return Decision("minirocket", "float", {"DILATIONS": len(dilations), "MOST_BIASES": max(n_biases)}, tables)


DECISIONS: dict[str, Callable[[Any, Means], Decision]] = {
    "Pipeline": _linear,
    "SVC": _machines,
    "ELMClassifier": _elm,
    "ExtraTreesClassifier": _trees,
    "KNeighborsClassifier": _neighbours,
    "PooledGRUClassifier": _gru,
    "MiniRocketClassifier": _minirocket,
}
"""By the class of the estimator; a pipeline is a scaler and a logistic regression."""


def _real(about: str, name: str, values: np.ndarray, kind: str = "float") -> Table:
    text = literal if kind == "float" else repr
    return _table(about, name, (text(float(value)) for value in values.ravel()), values.size, kind)


def _whole(about: str, name: str, values: np.ndarray, kind: str) -> Table:
    return _table(about, name, map(str, values.ravel().astype(np.int64).tolist()), values.size, kind)


def _table(about: str, name: str, values: Iterable[str], size: int, kind: str) -> Table:
    return Table(about or "As above.", kind, name, size, list(wrapped(values)))
