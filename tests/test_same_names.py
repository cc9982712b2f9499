"""A name of an option means one thing in all of Python's front door: the same default, and values of the same type."""

import inspect
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Any, NamedTuple, Union, get_args, get_origin

import pytest

import neurotact as nt
from neurotact.spec import Spec

ESTIMATOR = "None in an estimator: as the spec of the network says"
TWO_THINGS = {
    "batch": f"of a search, how many networks are proposed at once. {ESTIMATOR}",
    "encoder": "None in a stream that goes on: as before",
    "epochs": f"of `fine_tune`, which goes on from trained weights, fewer. {ESTIMATOR}",
    "label": "of NWB and Neo the name of a column that there is; of other files found by several names",
    "length_ms": "of a stream as in training when absent",
    "lsb": "of samples a factor; of an export found from the range of the recordings",
    "name": "of a data set, of the functions in C, of the column of an NWB file with the names of units",
    "polarity": "of an import what is made of it; of a stream what import made, if afferents have none",
    "progress": "a simulator makes trials of which the caller does not know the number",
    "recordings": "in memory, in a file, or either, as the function takes the other inputs",
    "seed": "of `fine_tune` None: one that is given is refused where nothing is trained",
    "source": "of recordings their origin; of a stream where samples come from, standard input",
    "start_ms": "of a stream as in training when absent",
    "step_ms": "of formats that may say the clock, theirs when absent; events say none",
    "time_column": "of a table the name of the column; of samples that arrive the unit of the first one",
    "trial": "which trial is drawn; of a table the columns that tell trials apart",
    "trials": "of a search their number; of an NWB file its table of trials; of spikes which are cut",
    "validation": "of a split a share; of `fit` the windows, as in every opponent",
    "weight_bits": "of an export those of the fine-tuning, which chooses them",
}
"""Names with two defaults or types, and why."""
IN_WORDS = {
    "early_exit": False, "full_window": False, "resume": False, "force": False, "rest_ms": 50.0, "hold_ms": 5.0,
    "folds": None, "settings": None, "where": None, "leave_out": None, "exit_tolerance": 0.01, "show": print,
}  # fmt: skip
"""Defaults that the pages tell."""
UNITS = ("_ms", "_s", "_Hz")


class Option(NamedTuple):
    """An option of a function, a method or a spec."""

    name: str
    default: Any
    types: frozenset[Any]


def public() -> Iterator[Option]:
    for name in vars(nt)["__all__"]:
        found = getattr(nt, name)
        if inspect.isfunction(found):
            yield from options(found)
        elif inspect.isclass(found) and issubclass(found, Spec) and found.public:
            fields = found.model_fields.items()
            yield from (Option(key, field.get_default(), types(field.annotation)) for key, field in fields)
        elif inspect.isclass(found) and not issubclass(found, Spec | tuple | Exception):
            for key, method in vars(found).items():
                if inspect.isfunction(method) and (key == "__init__" or not key.startswith("_")):
                    yield from options(method)


def options(function: Any) -> Iterator[Option]:
    for name, each in inspect.signature(function, eval_str=True).parameters.items():
        if each.default is not each.empty:
            yield Option(name, each.default, types(each.annotation))


def types(annotation: Any) -> frozenset[Any]:
    """The types of values, apart from None."""
    parts = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    return frozenset(str(part) for part in parts if part not in (NoneType, Any))


OF_NAME: dict[str, list[Option]] = {}
for one in public():
    OF_NAME.setdefault(one.name, []).append(one)


def differ(name: str) -> bool:
    return len({(repr(each.default), each.types) for each in OF_NAME[name] if each.types}) > 1


@pytest.mark.parametrize("name", sorted(OF_NAME))
def test_a_name_has_one_default_and_one_type(name):
    assert differ(name) == (name in TWO_THINGS)


def test_defaults_are_those_of_the_pages():
    assert {*TWO_THINGS} <= {*OF_NAME}
    assert {name: OF_NAME[name][0].default for name in IN_WORDS} == IN_WORDS
    assert {each.default.__name__ for each in OF_NAME["tell"]} == {"untold"}


def test_a_time_has_its_unit_in_its_name():
    """`hold_ms`, not `hold`: a number of these names would be one of seconds or of steps."""
    stems = {name.removesuffix(unit) for name in OF_NAME for unit in UNITS if name.endswith(unit)}
    assert not stems & {*OF_NAME}
