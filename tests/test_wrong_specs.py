"""Whatever a spec holds where something else is due, it is taken or refused in one sentence.

Tried are all keys of all shipped specs and of their models, in files and as settings (`--set`), by all that commands do
with a spec before any work.
"""

import copy
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.networks.search import tuning

from neurotact import plugins, spec
from neurotact.data import dataset, hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders import specs as encoders
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.model import name_in, of_name
from neurotact.errors import InputError
from neurotact.metrics.prices import PriceList
from neurotact.networks.definition import recipe
from neurotact.networks.definition import space as spaces
from neurotact.networks.definition.recipe import Seen
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.studies import loading, runner, study

WRONG = [
    0, -1, 3, 2**63 - 1, 10**30, -1e-9, 1e15, math.nan, -math.inf, True, "text", "", "auto", "a & b", [], [1], ["x"],
    [math.nan], [[]], [{}], {}, {"x": 1}, {"": 0}, {"x": {"y": []}},
]  # fmt: skip
"""What a key may be given in place of what it takes; a list where a table is due, and the reverse, among them."""
BY_NAME = [-1, 2**63 - 1, math.nan, True, "text", "", [], [[]], {}, {"x": 1}]
"""What each key of a model is set to, of which there are many."""
EXTRA = ("extra", "", "x.y", "model", "way")
"""Keys that a table may have too many."""


SETTINGS = (
    "", "a..b", "a & b", "quick", "set", "with_data", "encoder", "network", "parameters", "dataset.file", "seed",
    "sweep.", "sweep.x", "sweep.seed", "sweep.split.fold", "sweep.split.seed", "split.group", "split.folds",
    "split.order", "split.test_where", "window.length_ms", "window.per_trial", "window.onset.rest_ms",
    "conditioning.baseline", "conditioning.resample_Hz",
)  # fmt: skip
"""Keys that options and people set, also those of another kind of study."""


class Change(NamedTuple):
    """A shipped spec (or simulator) and what is wrong with it.

    where: a path of keys in its file, or a dotted key; how: "replaced", "dropped" or "added", in the file, or "set".
    """

    kind: str
    path: Path
    how: str
    where: Any
    wrong: Any = None


# --- all that is wrong ------------------------------------------------------------------------------


def places(value: Any, path: tuple = ()) -> Iterator[tuple]:
    """The path to every node of a table, the table itself first."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield from places(part, (*path, key))


def known(model: Any, before: str = "") -> Iterator[str]:
    """The dotted keys of a spec's model, with those of the tables inside."""
    for name, field in model.model_fields.items():
        yield f"{before}{name}"
        for inner in spec._models_in(field.annotation):
            yield from known(inner, f"{before}{name}.")


def models(kind: str, table: Mapping[str, Any]) -> list[Any]:
    """The models of a spec: of a study also that of its protocol, or of its parts."""
    if kind == "encoders":
        return [of_name(name_in(table)).spec]
    if kind == "networks":
        return [RSNNSpec]
    if kind != "studies":
        return []
    return [getattr(plugins.load("ways", table.get("way", "networks")), "Parameters", study.StudySpec)]


def changes_of(kind: str, path: Path, seen: set) -> Iterator[Change]:
    """Every change of a file; seen: forms that were tried in another file, of which one is enough."""
    table = spec.read(path)
    for place in places(table):
        form = kind, tuple("*" if isinstance(key, int) else key for key in place)
        if form in seen:
            continue
        seen.add(form)
        if place:
            yield from (Change(kind, path, "replaced", place, wrong) for wrong in WRONG)
            yield Change(kind, path, "dropped", place)
        yield from (Change(kind, path, "added", (*place, key), wrong) for key in EXTRA for wrong in (0, "x", {"x": 1}))
        if place and all(isinstance(key, str) for key in place):
            yield from (Change(kind, path, "set", ".".join(place), wrong) for wrong in WRONG)
    if kind == "studies":
        yield from (Change(kind, path, "set", key, wrong) for key in SETTINGS for wrong in WRONG if key not in table)
    for model in models(kind, table):
        for key in dict.fromkeys(known(model)):
            if (kind, model, key) not in seen:
                seen.add((kind, model, key))
                yield from (Change(kind, path, "set", key, wrong) for wrong in BY_NAME)
                if key.count(".") == 0 and key not in table:
                    yield from (Change(kind, path, "added", (key,), wrong) for wrong in WRONG)


@cache
def changes() -> list[Change]:
    found, seen = [], set()
    # A study that takes a file of recordings chooses values that others contain: it is tried whole, and first.
    shipped = [(kind, path) for kind in spec.KINDS for path in spec.shipped(kind)]
    for kind, path in sorted(shipped, key=lambda one: one[1].stem != "own-recordings"):
        found += changes_of(kind, path, seen if path.stem != "own-recordings" else set())
    for name in plugins.names("simulators"):
        for key in known(dataset.simulator(name).model):
            found += [Change("simulators", Path(name), "set", key, wrong) for wrong in BY_NAME]
    return found


def shortened(table: dict[str, Any]) -> dict[str, Any]:
    """A study with one value on each axis of its sweep and no quick look: read as the whole, in less time."""
    sweep = {key: value[:1] if isinstance(value, list) else value for key, value in table.get("sweep", {}).items()}
    return {key: value for key, value in table.items() if key != "quick"} | {"sweep": sweep}


def changed(table: Any, change: Change, place: tuple) -> Any:
    """A copy of `table` with a change at `place`."""
    if not place:
        return change.wrong
    here = copy.copy(table)
    key, *rest = place
    if change.how == "dropped" and not rest:
        del here[key]
    elif isinstance(here, dict):
        here[key] = changed(here.get(key), change, tuple(rest))
    elif isinstance(here, list) and isinstance(key, int):
        here[key] = changed(here[key], change, tuple(rest))
    return here


# --- all that commands do with a spec before any work -----------------------------------------------


def use_encoder(name: Path, given: Mapping[str, Any], _: Path) -> None:
    """As encode, live and calibrate."""
    encoders.encode(np.zeros((1, 10, 8), np.float32), 2000.0, encoders.load(name, given))
    spec.load(AfferentSpec, name, given)


def use_network(name: Path, given: Mapping[str, Any], _: Path) -> None:
    """As train and tune."""
    network, seen = spec.load(RSNNSpec, name, given), Seen(100, 200, 1000.0, 10.0)
    if network.hidden < 1000:
        RSNN(16, 8, recipe.resolve(network, seen), 2000.0, backend="reference")
    recipe.space(network, seen)
    list(recipe.described(network, seen))


def use_space(name: Path, given: Mapping[str, Any], _: Path) -> None:
    """As tune."""
    table = {"space": spaces.load_space(str(name)), "trials": 2}
    asked = spec.build(spaces.SearchSpec, spec.override(table, given), source=str(name))
    spaces.check(asked.space, spec.load(RSNNSpec, "rsnn"), source=str(name))
    tuning.Tuner(asked).ask()


def use_study(name: Path, given: Mapping[str, Any], data: Path) -> None:
    """As study run, with and without --data and --quick; study resume and report read it as it was written."""
    refusals = []
    for quick in (False, True) if "quick" in spec.read(name) else (False,):
        for file in (None, data):
            try:
                what = loading.resolve(name, given, quick=quick, data=file)
                list(loading.engine_of(what).cells(what))
                runner._made_from(what)
                study.to_toml(what)
            except InputError as error:
                refusals.append(error)
    try:
        runner._made_from(loading.read_back(name))
    except InputError as error:
        refusals.append(error)
    if refusals:
        raise refusals[0]


def use_simulator(name: Path, given: Mapping[str, Any], _: Path) -> None:
    """As simulate and live."""
    dataset.simulator(str(name)).build(given, f"simulate {name}").n_trials  # noqa: B018


USES: dict[str, Callable[[Path, Mapping[str, Any], Path], None]] = {
    "encoders": use_encoder, "networks": use_network, "networks/spaces": use_space, "studies": use_study,
    "simulators": use_simulator, "prices": lambda name, given, _: spec.load(PriceList, name, given),
}  # fmt: skip


def refusal_of(change: Change, folder: Path, data: Path) -> str:
    """Why a spec with the change is refused; empty where it is taken."""
    name, given = change.path, {change.where: change.wrong} if change.how == "set" else {}
    if change.kind != "simulators":
        table = spec.read(change.path)
        first = change.where.partition(".")[0] if change.how == "set" else change.where[0]
        if change.kind == "studies" and first not in ("sweep", "quick", "with_data"):
            table = shortened(table)
        name = folder / change.path.name
        table = table if given else changed(table, change, change.where)
        name.write_text(spec.to_toml(table), encoding="utf-8")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            USES[change.kind](name, given, data)
    except InputError as error:
        return str(error)
    return ""


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("data") / "touches.h5"
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 6})
    hdf5.save_recordings(Recordings(np.zeros((12, 250, 2), np.float32), 500.0, "mV", conditions), path)
    return path


def test_every_kind_of_spec_and_every_way_to_spoil_it_is_tried():
    assert {change.kind for change in changes()} == USES.keys()
    assert {change.how for change in changes()} == {"replaced", "dropped", "added", "set"}
    assert {("dataset",), ("dataset", "extra"), "dataset.file", "encoder.conditioning.resample_Hz"} <= {
        change.where for change in changes() if change.path.stem == "own-recordings"
    }


@examples(120)
@given(change=st.deferred(lambda: st.sampled_from(changes())))
def test_any_wrong_value_anywhere_in_a_spec_is_taken_or_refused(tmp_path, data, change):
    assert "\n" not in refusal_of(change, tmp_path, data)


@pytest.mark.slow
@pytest.mark.parametrize("kind", USES)
def test_every_wrong_value_everywhere_in_a_spec_is_taken_or_refused(tmp_path, data, kind):
    tried = [change for change in changes() if change.kind == kind]
    refusals = list(map(partial(refusal_of, folder=tmp_path, data=data), tried))
    assert not [words for words in refusals if "\n" in words]
    assert len(set(refusals)) > 10
