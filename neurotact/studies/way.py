"""The interface of a paper's own system, which is then swept, run, resumed and reported as every study is.

Each way is a module that an entry point of the group `neurotact.ways` names. It contains `Parameters` and the
functions of `_Way`, which connect estimators, signals, costs and drawings of other modules.
"""

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Protocol, cast, get_args

import numpy as np
import pandas as pd

from neurotact import plugins
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    from neurotact.figures import style

Optional = Literal["named", "cautions", "tables", "own"]
"""Functions that the module of a way may also have."""
Arrays = dict[str, np.ndarray]
"""The shared input of the cells of a study, by name; no array of objects."""


HEADS = {
    "accuracy_test": "test accuracy (%)",
    "accuracy_validation": "validation accuracy (%)",
    "accuracy_train": "training accuracy (%)",
    "macs": "MACs",
    "acs": "ACs",
    "multiplications": "other multiplications",
    "comparisons": "comparisons",
    "divisions": "divisions and roots",
    "exponentials": "exponentials and logarithms",
    "flops": "FLOPs",
    "parameters": "parameters",
    "bytes": "memory (bytes)",
    "sops": "SOPs",
    "sops_total": "SOPs",
    "weights_accesses": "weights read",
    "states_accesses": "states read and written",
    "buffers_accesses": "features and spikes read and written",
    "signal_ms": "signal (ms)",
    "energy_estimate_nJ": "energy estimate (nJ)",
    "input_spikes": "input spikes",
    "hidden_spikes": "hidden spikes",
    "neurons": "mean N",
}
"""Heads in tables of the columns that several ways have."""


def heads(columns: str, **own: str) -> dict[str, str]:
    """The heads of `columns`, names separated by spaces: from `own`, otherwise from `HEADS`.

    >>> heads("flops epoch sops", flops="FLOPs (paper's count)", epoch="epoch chosen")
    {'flops': "FLOPs (paper's count)", 'epoch': 'epoch chosen', 'sops': 'SOPs'}
    """
    return {name: own.get(name) or HEADS[name] for name in columns.split()}


class View(NamedTuple):
    """How a report reads `results.csv`.

    by: columns that identify a configuration; its rows (seeds, splits) are averaged.
    measures: columns that are shown, with their heads; a head that ends in (%) is shown in percent.
    cost, score: the columns of the trade-off figure's axes, both among `measures`.
    note: what the reader must know about the rows, such as which protocol chooses on test data.
    apart: columns of `by` with tasks or rules that are not compared with each other; each value has its own answer.
    optimistic: values of these columns that use test data for choices; their answers come last.
    spiking: a column of `by` and its values that are spiking networks; they are compared with the best of the others.
    splits: columns of `results.csv` that name the test trials of a row: a split, a fold, the value that is left out.
        Rows that are alike there are seeds of one split, whose mean counts once. Empty: all rows test the same trials;
        None: unknown. If the results have n_train and n_test (and test_trials, where several examples are of one
        trial), shares are compared over splits (`metrics.resampled`), or on the trials of a single one; otherwise
        nothing is tested. The same of validation (n_validation, validation_trials) gives the error of the choice.
    """

    by: tuple[str, ...]
    measures: Mapping[str, str]
    cost: str
    score: str
    note: str = ""
    apart: tuple[str, ...] = ()
    optimistic: tuple[str, ...] = ()
    spiking: tuple[str, tuple[str, ...]] | None = None
    splits: tuple[str, ...] | None = None


class Own(NamedTuple):
    """The changes of a way for the file that `data` names.

    changes: dotted keys of the study, such as `data.set` and `sweep.seed`; they replace all given keys.
    notes: what was chosen for the recordings, in words.
    """

    changes: dict[str, Any]
    notes: tuple[str, ...] = ()


ALL_SETS = "all sets"
"""The setting of an answer to all settings together, which comes first: its labels are by all values of `View.by`, and
in its picture a line joins what is drawn of one setting."""


class Listed(NamedTuple):
    """A table of the first screen.

    rows: columns of `View.measures` are shown with their heads, the score with the interval from `low` to `high` if
    there is one; the head of any other column is its name. first: the rows to show before the others are unfolded.
    """

    caption: str
    rows: pd.DataFrame
    first: Sequence[int] = ()


class Named(NamedTuple):
    """An answer whose picture says by itself what it is of.

    headline: one sentence. details: all others, which are folded. labels: for each column of a cost, the first shown
    first, the names of configurations by their values of `View.by` without `View.apart`; empty where the point has no
    name, and missing where it is not drawn. what: has a name, in the words of the picture's legend. next: what to do
    then, and the commands.
    """

    headline: str
    details: Sequence[str] = ()
    labels: Mapping[str, Mapping[tuple[str, ...], str]] = {}
    what: str = "what the sentence and the table name"
    next: tuple[str, Sequence[str]] = ("", ())


class _Way(Protocol):
    """The contents of the module of a way.

    Parameters: everything that decides a cell's numbers; its field `data` decides the arrays that cells share.
    Four functions are optional (`optional`):
    `named(results) -> dict[str, Named]`: the answer of each setting (`View.apart`, in words), which the command also
    prints, with the names in its picture; without it the report says how the rows of `View.spiking` compare.
    `cautions(results) -> list[str]`: what limits these answers, each with its remedy.
    `tables(results) -> dict[str, Sequence[Listed]]`: tables for each answer by its setting, which replace the table of
    the best of each kind and are printed.
    `own(path, given) -> Own`: the changes for a file that `data` names; without it `data` is refused. path:
    absolute, of a file that exists. given: the dotted keys that are set, including `[with_data]` of the study file. It
    raises InputError if the file or a key is wrong.
    """

    Parameters: type[Spec]
    VIEW: View

    def load(self, data: Any) -> Arrays:
        """Simulate or read, and prepare, the arrays that cells with equal `data` share."""
        ...

    def run(self, parameters: Any, arrays: Arrays) -> list[dict[str, Any]]:
        """The rows of `results.csv` of one cell: plain numbers and text."""
        ...

    def draw(self, results: pd.DataFrame, arrays: Arrays) -> "Iterator[style.Drawn]":
        """The figures of the report."""
        ...


def optional(module: _Way, name: Optional) -> Callable[..., Any] | None:
    """An optional function of a way; None if it lacks it."""
    return getattr(module, name, None)


def module_of(name: str) -> _Way:
    """The module of a way.

    InputError for an unknown name, with the nearest, for a module without a part, and for one with a function that is
    meant to be a part, since it takes `results` alone, and that no study calls.
    """
    module = plugins.load("ways", name)
    lacking = [part for part in ("Parameters", "VIEW", "load", "run", "draw") if not hasattr(module, part)]
    if lacking:
        raise plugins.unfit("ways", name, f"has no {lacking[0]}")
    if not (isinstance(module.Parameters, type) and issubclass(module.Parameters, Spec)):
        raise plugins.unfit("ways", name, "has Parameters that are not a Spec")
    for key, one in inspect.getmembers(module, inspect.isfunction):
        is_own = one.__module__ == module.__name__ and not key.startswith("_")
        if is_own and key not in get_args(Optional) and [*inspect.signature(one).parameters] == ["results"]:
            known = ", ".join(get_args(Optional))
            why = f"has a function '{key}' of the results that no study calls ({known} are; a helper begins with _)"
            raise plugins.unfit("ways", name, why)
    return cast(_Way, module)
