"""Further measurements, each requested by a key of a study and found by its name: a table of results, and its figures.

They are entry points of the group `neurotact.measures`. A study names them as keys of its own, `signals = true`, or in
its table `measures`.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from pydantic import Field, TypeAdapter, create_model

from neurotact import plugins, spec
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError, closest, nearest
from neurotact.spec import Spec

TABLE = "measures"
"""The table of a study."""
RECONSTRUCTION = "reconstruction"
"""The table with the column snr_dB, of each encoder, that a measure may bring."""
INTEGERS = "integers"
"""The table of networks with 8-bit weights, which reports show beside opponents with as many."""


class Measure(NamedTuple):
    """A measurement that a study may request.

    value: the type of the key's value. about: what the key asks for, in a sentence. table: the name of its table,
    `table.csv` of a run; download: what a row of it is, in words.
    of_study: the table, from the run folder, the study, its cells and the first one's recordings, before any cell runs.
    of_network: the rows of a cell, from its network, its windows of each side and the value of the key.
    draw: figures of a report, from the study, `results.csv` with the columns `pair` and `setting`, the table with
        `pair`, and the classes. check: raises ValueError if the study cannot be measured.
    needs_whole_trials: whether spikes after a network's last window are kept for it.
    """

    value: Any
    about: str
    table: str
    download: str
    of_study: Callable[[Path, Any, Sequence[Any], Recordings], pd.DataFrame] | None = None
    of_network: Callable[[Any, Any, Any], list[dict[str, Any]]] | None = None
    draw: Callable[[Any, pd.DataFrame, pd.DataFrame, Any], Iterator[Any]] | None = None
    check: Callable[[Any], None] | None = None
    needs_whole_trials: bool = False


@lru_cache
def of_name(name: str) -> Measure:
    """The measure of that name; InputError as of `plugins.load`."""
    return plugins.load("measures", name, Measure)


def requested(asked: Mapping[str, Any]) -> dict[str, Measure]:
    """The measures that a study or a cell names, by name."""
    return {name: of_name(name) for name in asked}


def value_of(name: str, asked: Mapping[str, Any]) -> Any:
    """The value of a measure's key, of the type that the measure takes."""
    return TypeAdapter(of_name(name).value).validate_python(asked[name])


def placed(keys: Mapping[str, Any], known: Collection[str]) -> dict[str, Any]:
    """The dotted keys of a study, those of measures in its table `measures`. known: the study's own keys.

    Raises InputError for an unknown key that is nearly the name of a measure.

    >>> placed({"signals": True, "same_drive.spikes": 5, "title": "a"}, ["title"])
    {'measures.signals': True, 'measures.same_drive.spikes': 5, 'title': 'a'}
    """
    names = plugins.names("measures")
    for first in (key.partition(".")[0] for key in keys):
        if first not in (*known, *names) and (near := closest(first, [*known, *names])) in names:
            raise InputError(f"{first}: unknown key; did you mean '{near}'?")
    return {f"{TABLE}.{key}" if key.partition(".")[0] in names else key: value for key, value in keys.items()}


def gathered(table: dict[str, Any], known: Collection[str]) -> dict[str, Any]:
    """The table of a study file with the measures that stand among its keys in its table `measures`; as `placed`."""
    own = {dotted: table[key] for key, dotted in zip(table, placed(table, known), strict=True) if key != dotted}
    return spec.override({key: value for key, value in table.items() if f"{TABLE}.{key}" not in own}, own)


def checked(asked: Any) -> Any:
    """The values of measures by name, as saved; those that ask for nothing, such as `false`, are left out.

    Raises InputError for an unknown name or a wrong value.
    """
    if not isinstance(asked, Mapping):
        return asked
    given = {name: value for name, value in asked.items() if value is not None and value is not False and value != []}
    for name in given:
        if not plugins.has("measures", name):
            raise ValueError(f"there is none called '{name}'; {nearest(name, plugins.names('measures'))}")
    try:
        return spec.build(_spec_of(tuple(given)), given, TABLE).model_dump(mode="json") if given else {}
    except InputError as error:
        raise InputError(str(error).removesuffix(f" ({TABLE})")) from error


def every() -> type[Spec]:
    """A spec with a key for each measure that is installed."""
    return _spec_of(tuple(plugins.names("measures")))


def tables() -> set[str]:
    """The names of the tables of all measures that are installed."""
    return {of_name(name).table for name in plugins.names("measures")}


@lru_cache
def _spec_of(names: tuple[str, ...]) -> type[Spec]:
    fields: dict[str, Any] = {name: (of_name(name).value, Field(description=of_name(name).about)) for name in names}
    return create_model("Measures", __base__=Spec, __doc__="Further tables of a study.", **fields)
