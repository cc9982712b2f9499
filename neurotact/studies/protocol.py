"""What a paper's own system gives, so that it is swept, run, resumed and reported as every study is.

Each protocol is a module that an entry point of the group `neurotact.protocols` names: its `Parameters`, and the
functions of `ProtocolModule`.
It glues; estimators, signals, costs and drawings have their own places.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal, NamedTuple, Protocol, cast

import numpy as np
import pandas as pd

from neurotact import plugins
from neurotact.figures.style import Drawn
from neurotact.spec import Spec

Arrays = dict[str, np.ndarray]
"""What the cells of a study share, by name; no array of objects."""


HEADS = {
    "accuracy_test": "test accuracy (%)",
    "accuracy_validation": "validation accuracy (%)",
    "accuracy_train": "training accuracy (%)",
    "macs": "MACs",
    "acs": "ACs",
    "other_flops": "other FLOPs",
    "flops": "FLOPs",
    "parameters": "parameters",
    "bytes": "memory (bytes)",
    "sops": "SOPs",
    "sops_total": "SOPs",
    "signal_ms": "signal (ms)",
    "energy_estimate_nJ": "energy estimate (nJ)",
    "input_spikes": "input spikes",
    "hidden_spikes": "hidden spikes",
    "neurons": "mean N",
}
"""What tables call the columns that several protocols have."""


def heads(columns: str, **own: str) -> dict[str, str]:
    """The heads of `columns`, named in their order with spaces between them: those of `own`, else of `HEADS`.

    >>> heads("flops epoch sops", flops="FLOPs (paper's count)", epoch="epoch chosen")
    {'flops': "FLOPs (paper's count)", 'epoch': 'epoch chosen', 'sops': 'SOPs'}
    """
    return {name: own.get(name) or HEADS[name] for name in columns.split()}


class View(NamedTuple):
    """How a report reads `results.csv`.

    by: columns that name a configuration; the other rows (seeds, splits) are averaged over.
    measures: columns that are shown, with their heads; a head that ends in (%) is shown in percent.
    cost, score: the columns of the trade-off figure's axes, both among `measures`.
    note: what must be known to read the rows, such as which protocol chooses on test data.
    apart: columns of `by` whose values are tasks or rules that are not compared with each other; an answer each.
    optimistic: values of those whose choices saw test data; their answers come last.
    spiking: a column of `by` and its values that are spiking networks, which are set beside the best of the others.
    """

    by: tuple[str, ...]
    measures: Mapping[str, str]
    cost: str
    score: str
    note: str = ""
    apart: tuple[str, ...] = ()
    optimistic: tuple[str, ...] = ()
    spiking: tuple[str, tuple[str, ...]] | None = None


class Own(NamedTuple):
    """What a protocol makes of a file that `--data` names.

    changes: dotted keys of the study, such as `data.set` and `sweep.seed`, in place of all that were given.
    notes: what was chosen for the recordings, in words.
    """

    changes: dict[str, Any]
    notes: tuple[str, ...] = ()


class Listed(NamedTuple):
    """A table of the first screen.

    rows: columns of `View.measures` are shown with their heads, the score beside the interval from `low` to `high`
    where there is one; the name of another column is its head.
    """

    caption: str
    rows: pd.DataFrame


class TaskData(NamedTuple):
    """A recognition task as every family of classifiers can see it.

    features: `(example, feature)`, what the paper's classifiers see, not standardised.
    sequences: `(example, time, channel)` float32, the conditioned signal in `unit`, at `sampling_rate_Hz`.
    labels: `(example,)` class names; groups: `(example,)`, examples of one group stay on one side of a split.
    """

    features: np.ndarray
    sequences: np.ndarray
    sampling_rate_Hz: float
    unit: str
    labels: np.ndarray
    groups: np.ndarray


class ProtocolModule(Protocol):
    """What the module of a protocol holds.

    Parameters: all that decides a cell's numbers; its field `data` decides the arrays that cells share.
    Four functions may be there besides (`optional`):
    `answers(results) -> list[str]`: sentences that head the report and that the command prints.
    `cautions(results) -> list[str]`: what makes them worth little, each with its remedy.
    `tables(results) -> dict[str, Listed]`: a table for each answer by its setting (`View.apart`, in words), which
    stands in place of the best of each kind and is printed.
    `own(path, given) -> Own`: what a file that `--data` names becomes; without it `--data` is refused. path: absolute,
    of a file that exists. given: the dotted keys that are set, those of `[with_data]` of the study file among them. It
    raises InputError for whatever is wrong with the file or the keys.
    """

    Parameters: type[Spec]
    VIEW: View

    def load(self, data: Any) -> Arrays:
        """Simulate or read, and prepare, what cells with equal `data` share."""
        ...

    def run(self, parameters: Any, arrays: Arrays) -> list[dict[str, Any]]:
        """The rows of `results.csv` of one cell: plain numbers and text."""
        ...

    def draw(self, results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
        """The figures of the report."""
        ...


def optional(
    module: ProtocolModule, name: Literal["answers", "cautions", "tables", "own"]
) -> Callable[..., Any] | None:
    """A function that a protocol may have (see `ProtocolModule`); None where it has none."""
    return getattr(module, name, None)


def module_of(name: str) -> ProtocolModule:
    """The module of a protocol; InputError names the nearest where there is none."""
    return cast(ProtocolModule, plugins.load("protocols", name))
