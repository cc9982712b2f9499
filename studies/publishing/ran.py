"""What the files of a finished study say of the networks, the encoders and the rivals that ran."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from neurotact import files
from neurotact.studies import loading, runner, store
from neurotact.tables import read_table


class Ran(NamedTuple):
    """networks, encoders: the specs of each network and of its fitted encoder. afferents: how many each encoder has.

    rivals: the names of classifiers or regressions, by what they decide from. versions: of the software, the machine.
    seconds: that all parts and cells took, one after another.
    """

    networks: Sequence[Mapping[str, Any]] = ()
    encoders: Sequence[Mapping[str, Any]] = ()
    afferents: Sequence[int] = ()
    rivals: Mapping[str, Sequence[str]] = {}
    versions: Mapping[str, str] = {}
    seconds: float = 0.0


NOTHING = Ran()


def ran_in(folder: Path, study: loading.Study) -> Ran:
    """What ran in the folder of a finished study."""
    cells = loading.engine_of(study).cells(study)
    paths = [store.cell_folder(folder, cell) / "network.json" for cell in cells]
    found = [files.read_json(path) for path in paths if path.is_file()]
    extras = [one.get("extra", {}) for one in found]
    return Ran(
        [one["spec"] for one in found],
        [extra["encoder"] for extra in extras if "encoder" in extra],
        [len(extra["afferents"]) for extra in extras if "afferents" in extra],
        _rivals(folder / "baselines.csv"),
        files.read_json(folder / runner.VERSIONS),
        float(read_table(folder / runner.TIMINGS)["seconds"].sum()) if (folder / runner.TIMINGS).is_file() else 0.0,
    )


def _rivals(path: Path) -> dict[str, list[str]]:
    """The names of the rivals, by what they decide from."""
    if not path.is_file():
        return {}
    table = read_table(path)
    if not {"classifier", "input"} <= {*table}:
        return {}
    return {str(place): list(dict.fromkeys(rows)) for place, rows in table.groupby("input", sort=False)["classifier"]}


def shared(tables: Sequence[Mapping[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings that all tables have alike, and the others, each with a list of its values.

    >>> shared([{"hidden": 0, "a": {"x": 1, "y": 2}}, {"hidden": 20, "a": {"x": 1, "y": 3}}])
    ({'a': {'x': 1}}, {'hidden': [0, 20], 'a': {'y': [2, 3]}})
    """
    alike: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for key in dict.fromkeys(key for table in tables for key in table):
        values = [table.get(key) for table in tables]
        if all(isinstance(value, Mapping) for value in values):
            inner, apart = shared([value for value in values if isinstance(value, Mapping)])
            alike |= {key: inner} if inner else {}
            others |= {key: apart} if apart else {}
        elif all(value == values[0] for value in values):
            alike[key] = values[0]
        else:
            others[key] = [value for n, value in enumerate(values) if value not in values[:n]]
    return alike, others
