"""What a network is compared with: an estimator, the grid that validation searches, its input and its cost.

An opponent is a part of the group `opponents` (`docs/plugins.md`), as those that ship are (`opponents/`).
"""

import inspect
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike

from neurotact import plugins
from neurotact.checks import one_of
from neurotact.errors import InputError, first_line
from neurotact.metrics.flops import Cost, Layer, cost
from neurotact.progress import say

T = TypeVar("T")
Opponents = Literal["none", "linear", "readout", "quick", "all"]
"""Which opponents a study fits."""
Takes = Literal["features", "sequences", "signals"]
Joins = Literal["linear", "quick", "all", "named"]
Tells = Literal["classes", "numbers"]
LEVELS = {"linear": 0, "readout": 0, "quick": 1, "all": 2, "named": 3}


class Sides(NamedTuple):
    """Inputs `(example, ...)` and labels `(example,)` for training, validation and test.

    Labels of numbers are `(example, target)`, standardised on the training side; estimators get those of a single
    target as `(example,)`.
    """

    train: np.ndarray
    validation: np.ndarray
    test: np.ndarray
    y_train: np.ndarray
    y_validation: np.ndarray
    y_test: np.ndarray


def standardised(sequences: np.ndarray, labels: np.ndarray, sides: Sequence[np.ndarray]) -> Sides:
    """Sequences `(example, time, channel)` of each side, float32, each channel standardised on the training side.

    sides: indices or booleans that select the examples of training, validation and test.
    """
    training = sequences[sides[0]]
    offset, scale = (of(axis=(0, 1), dtype=np.float64) for of in (training.mean, training.std))
    scale = np.where(scale > 0, scale, 1.0)
    del training

    def standard(side: np.ndarray) -> np.ndarray:
        chosen = sequences[side]
        done = np.empty(chosen.shape, np.float32)
        for values, into in zip(chosen, done, strict=True):
            into[:] = (values - offset) / scale
        return done

    return Sides(*map(standard, sides), *(labels[side] for side in sides))


class Candidate(NamedTuple):
    """A description, the fitted estimator, and the layers of its decision; None where they are not counted.

    again: fits the same settings to other sides.
    """

    settings: str
    fitted: Any
    layers: tuple[Layer, ...] | None
    again: "Callable[[Sides], Candidate]"

    def spent(self, before: Cost) -> dict[str, float]:
        """The ledger's columns of a decision, and of what comes before it.

        Where the decision is not counted, nothing is known but the signal that it waits for; the rest is NaN.
        """
        columns = (before + cost(*self.layers or ())).columns()
        if self.layers is None:
            return {name: value if name == "signal_ms" else float("nan") for name, value in columns.items()}
        return columns


Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Opponent:
    """A classifier on the windows, trials and split of a network.

    about: a line about it.
    build: called with settings of the grid; gives an estimator with scikit-learn's `fit` and `predict`, such as its
        class. Every `random_state` that it leaves open gets the seed. If `fit` has the parameter `validation`, it gets
        `(X, y)` of the validation examples, to stop or choose by.
    grid: settings, from the cheapest on. Validation chooses the first of the most accurate, and none is fitted after
        one without an error, in a study also with 8 bits. Or a function of the sides and the seed that gives them.
    takes: its input. `features` `(example, feature)`: counts, means in time bins, spectra; `signals` `(example, time,
        channel)`: all samples, up to 1000 steps; `sequences`: the same in bins of 20 ms.
    layers: of a decision, for the ledger of costs, from the fitted estimator and its training input. Without it the
        cost is not counted: no sentence compares it, and none takes it for zero.
    words: the settings in words, from the fitted estimator.
    rounded: a copy of the fitted estimator whose parameters are whole numbers of so many bits times a step (`rounded`),
        from it, its training input and the bits. Without it, tables say "not rounded".
    tells: the `classes` of examples or `numbers`.
    joins: studies whose `baselines` are `linear`, `quick` or `all` fit it; `named`: those that ask for it by name.
    is_ordered: False where a grid need not begin with the cheapest: then all are fitted, and the cheapest of the most
        accurate is chosen.
    most_examples: of training; more would take too long. least_steps: of a sequence.

    Raises InputError for an input or a level that is none of these, and for what cannot be called.

    >>> from sklearn.neighbors import KNeighborsClassifier
    >>> nearest = Opponent("The nearest examples.", KNeighborsClassifier, [{"n_neighbors": k} for k in (1, 3)])
    >>> x, y = np.array([[0.0], [0.1], [0.2], [0.9], [1.0], [1.1]]), np.array([0, 0, 0, 1, 1, 1])
    >>> best_of(nearest, Sides(x, x, x, y, y, y), seed=0).settings
    'n_neighbors 1'
    """

    about: str
    build: Callable[..., Any]
    grid: Sequence[Settings] | Callable[[Sides, int], Iterable[Settings]] = ({},)
    takes: Takes = "features"
    layers: Callable[[Any, np.ndarray], tuple[Layer, ...]] | None = None
    words: Callable[[Any], str] | None = None
    rounded: Callable[[Any, np.ndarray, int], Any] | None = None
    joins: Joins = "quick"
    tells: Tells = "classes"
    is_ordered: bool = True
    most_examples: int | None = None
    least_steps: int = 1

    def __post_init__(self) -> None:
        one_of("takes", self.takes, get_args(Takes))
        one_of("joins", self.joins, get_args(Joins))
        one_of("tells", self.tells, get_args(Tells))
        for name in ("build", "layers", "words", "rounded"):
            value = getattr(self, name)
            if not callable(value) and (value is not None or name == "build"):
                raise InputError(f"Opponent.{name}: must be a function; got {value!r}")

    def candidates(self, sides: Sides, seed: int) -> Iterator[Candidate]:
        """Fitted with each settings of the grid, from the cheapest on."""
        rows = self.grid(sides, seed) if callable(self.grid) else self.grid
        found = (self._fitted(sides, settings, seed) for settings in rows)
        yield from found if self.is_ordered else sorted(found, key=lambda one: cost(*one.layers or ()).flops)

    def _fitted(self, sides: Sides, settings: Settings, seed: int) -> Candidate:
        estimator = self.build(**settings)
        parameters = estimator.get_params() if hasattr(estimator, "get_params") else {}
        is_open = {key for key, value in parameters.items() if value is None and key.endswith("random_state")}
        if is_open:
            estimator.set_params(**dict.fromkeys(is_open, seed))
        held = {"validation": (sides.validation, _plain(sides.y_validation))}
        takes_held = "validation" in inspect.signature(estimator.fit).parameters
        from sklearn.exceptions import ConvergenceWarning

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # for features that carry no information
            estimator.fit(sides.train, _plain(sides.y_train), **held if takes_held else {})
        plain = (
            f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in settings.items()
        )
        return Candidate(
            self.words(estimator) if self.words else ", ".join(plain),
            estimator,
            self.layers(estimator, sides.train) if self.layers else None,
            partial(self._fitted, settings=settings, seed=seed),
        )


def _plain(labels: np.ndarray) -> np.ndarray:
    """Labels as scikit-learn's estimators take them: those of a single target without its axis."""
    return labels[:, 0] if labels.ndim == 2 and labels.shape[1] == 1 else labels


def load(name: str) -> Opponent:
    """The opponent of classes of this name; InputError, with the nearest one, if there is none or it cannot be used.

    >>> load("SVM").takes
    'features'
    """
    found = plugins.load("opponents", name, Opponent)
    if found.tells != "classes":
        raise InputError(
            f"opponents: '{name}' tells {found.tells}, and classes are asked for; name one that tells these"
        )
    return found


def joined(takes: Takes, level: Opponents, tells: Tells = "classes") -> dict[str, Opponent]:
    """The opponents of an input that a study of a level fits, by name, in the order of tables and of ties.

    Those that ship come first, as `pyproject.toml` has them.

    >>> list(joined("features", "linear"))
    ['logistic regression']
    """
    found = {name: plugins.load("opponents", name, Opponent) for name in plugins.in_order("opponents")}
    own = {name: one for name, one in found.items() if (one.takes, one.tells) == (takes, tells)}
    return {name: one for name, one in own.items() if LEVELS[one.joins] <= LEVELS[level]}


def best_of(opponent: Opponent, sides: Sides, seed: int) -> Candidate:
    """The candidate with the highest validation accuracy (ties: the first); test examples are not used."""
    found = opponent.candidates(sides, seed)
    return first_best((accuracy(one, sides.validation, sides.y_validation), one) for one in found)[1]


def part_of(labels: np.ndarray, n: int) -> np.ndarray:
    """The places of n examples, evenly spaced within each class, ascending; all if there are no more.

    Of numbers `(example, target)` they are evenly spaced over those of the first target.

    >>> part_of(np.array([0, 1] * 4), 4).tolist()
    [0, 3, 4, 7]
    """
    if len(labels) <= n:
        return np.arange(len(labels))
    order = np.argsort(labels if labels.ndim == 1 else labels[:, 0], kind="stable")
    return np.sort(order[np.linspace(0, len(labels) - 1, n).round().astype(int)])


@cache
def say_once(line: str) -> None:
    """Print a line on stderr, the first time in a process."""
    say(line)


def first_best(scored: Iterable[tuple[float, T]]) -> tuple[float, T]:
    """The first of the highest accuracy; after one of 1 no other is asked for, as none can be better.

    scored: `(accuracy, what has it)`, at least one.

    >>> first_best(iter([(0.5, "a"), (0.9, "b"), (0.9, "c")]))
    (0.9, 'b')
    """
    remaining = iter(scored)
    best = next(remaining)
    while best[0] < 1 and (following := next(remaining, None)) is not None:
        best = following if following[0] > best[0] else best
    return best


def rounded(values: ArrayLike, bits: int, of: ArrayLike | None = None) -> np.ndarray:
    """The nearest whole multiples of one step, of `bits` bits with their sign, as the C export holds a matrix.

    of: the values whose largest fills the bits; None: `values`.

    >>> rounded([0.2, 0.7, 3.0, 9.0], 3, of=[-3.0, 0.5]).tolist()
    [0.0, 1.0, 3.0, 3.0]
    """
    values, top = np.asarray(values), 2 ** (bits - 1) - 1
    step = float(np.abs(values if of is None else of).max(initial=0.0)) / top or 1.0
    whole = np.rint(values.astype(float) / step).clip(-top, top)
    return (whole * step).astype(np.result_type(values, np.float32))


def accuracy(candidate: Candidate, x: np.ndarray, y: np.ndarray) -> float:
    """Share of correct decisions, or the mean score of numbers."""
    return float(right(candidate.fitted.predict(x), y).mean())


def right(told: Any, labels: Any, deviation: Any = None) -> Any:
    """Whether each example is decided correctly; of numbers, its score. `(example,)`, of arrays or tensors.

    told: labels, values of a readout `(example, class)`, or numbers. labels: class indices `(example,)`, or numbers
    `(example, target)`. The score of an example is 1 less the mean over targets of the squared error in units of
    `deviation`, that of training (1 if absent): on average 1 is perfect, and 0 what the mean of training would have, as
    R^2 is.

    >>> right(np.array([1, 0]), np.array([1, 1])), right(np.array([[0.0, 3.0], [2.0, 1.0]]), np.array([1, 1]))
    (array([ True, False]), array([ True, False]))
    >>> right(np.array([3.0, 5.0]), np.array([[3.0], [3.0]]), np.array([4.0]))
    array([1.  , 0.75])
    """
    if labels.ndim == 1:
        return (told if told.ndim == 1 else told.argmax(1)) == labels
    errors = told.reshape(labels.shape) - labels
    errors = errors if deviation is None else errors / deviation
    return 1 - (errors * errors).mean(1)


@contextmanager
def named(name: str) -> Iterator[None]:
    """What goes wrong in an opponent of another package is an InputError that names it."""
    try:
        yield
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        if plugins.is_ours("opponents", name) or not plugins.has("opponents", name):
            raise
        raise plugins.unfit("opponents", name, f"cannot be fitted ({first_line(error)})") from error
