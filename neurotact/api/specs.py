"""The specs that ship."""

from importlib import import_module
from typing import Any, Literal, get_args

from neurotact import plugins, spec
from neurotact.errors import InputError, nearest


def spec_names(kind: Literal["encoders", "networks", "networks/spaces", "studies", "prices"]) -> list[str]:
    """The names of the specs of a kind, as `neurotact list` prints them: those that ship, then those of other packages.

    Raises InputError for another kind.

    >>> spec_names("networks")
    ['default', 'layered', 'rsnn', 'snn']
    """
    if kind not in spec.KINDS:
        raise InputError(f"kind: {kind!r} is unknown; {nearest(str(kind), spec.KINDS)}")
    return [*(path.stem for path in spec.shipped(kind)), *of_other_packages(kind)]


def of_other_packages(kind: str) -> dict[str, str]:
    """The names that parts of other packages have among the specs of a kind, with their packages; none of a study.

    >>> of_other_packages("studies")
    {}
    """
    return plugins.of_others(kind) if kind in get_args(plugins.Group) else {}  # pyright: ignore[reportArgumentType]


def keys_of(kind: str, name: str = "") -> list[str]:
    """The dotted keys of all specs of a kind; of a simulator, whose name is given, those in its tables, too.

    kind: simulators, encoders, networks or studies.

    >>> "training.epochs" in keys_of("networks"), "trials" in keys_of("simulators", "gratings")
    (True, True)
    """
    if kind == "simulators":
        from neurotact.data.dataset import simulator

        model: Any = simulator(name).model
        return [*dict.fromkeys([*spec.keys_of(model), *spec.leaves(model().model_dump())])]
    room, of_kind = {
        "encoders": ("neurotact.encoders.model", "EncoderSpec"),
        "networks": ("neurotact.networks.definition.specs", "RSNNSpec"),
        "studies": ("neurotact.studies.study", "StudySpec"),
    }[kind]
    return [*spec.keys_of(getattr(import_module(room), of_kind))]
