"""The way `targets`: a study of networks that tell numbers of a touch, or detect events, beside rivals that do too.

Its cells, spikes and tables are those of a study of networks. What belongs to classes alone is refused, or left out.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from neurotact_parts.streams.long_recordings import network_for, window_for
from pydantic import Field

from neurotact.data import hdf5
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import OneOrMore, Spec, build, leaves, resolve
from neurotact.studies import networks, study
from neurotact.studies.automatic import AUTO, CHOICE
from neurotact.studies.study import HIDDEN, Cell, StudySpec

with lazily():  # a process that waits for others needs no torch
    from neurotact_parts.studies.targets import report

    from neurotact.networks.training import numbers

EVENTS, FOLDS = "events", 4
OF_CLASSES = (
    "augmentation", "balance", "choose_grades", "integers", "measures", "search", "test_every_condition",
    "training_windows", "dataset.subsets", "sweep.dataset",
)  # fmt: skip
"""Keys of a study that have no meaning, or none yet, where no classes are learned."""
LEFT_OUT = {"augmentation": {"kind": "none"}, "integers": False, "choose_grades": False}
WINDOW, NETWORK = "window.", "network."


class Parameters(Spec):
    """What the networks of a study learn."""

    target: OneOrMore = Field(min_length=1)
    """Conditions whose numbers are learned, or `events`."""
    false_alarms_per_h: float | None = Field(default=None, ge=0)
    """Of detectors: how many false alarms an hour are allowed on validation recordings."""


def parameters_of(given: Mapping[str, Any]) -> Parameters:
    """The parameters of a study; InputError for wrong ones."""
    found = build(Parameters, dict(given), source="a study with a target")
    if found.target != (EVENTS,) and found.false_alarms_per_h is not None:
        raise InputError("false_alarms_per_h: is of detectors; give `target='events'`, or leave it out")
    if EVENTS in found.target and len(found.target) > 1:
        raise InputError("target: 'events' stands alone; numbers need another study")
    return found


def cells(what: StudySpec) -> Iterator[Cell]:
    """The cells of a study of networks, each with its target."""
    target = parameters_of(what.parameters).model_dump(mode="json", exclude_none=True)
    for cell in study.cells(what):
        yield cell.model_copy(update={"source": {**cell.source, **target}})


def own(table: Mapping[str, Any], given: Mapping[str, Any], quick: bool, data: str | Path | None) -> dict[str, Any]:
    """The changes of a study of networks that make it one of its target, with notes of what they are.

    table: of the study file. given: the changes that are asked for. quick: whether its own smaller sweep runs. data:
    the file of recordings.
    Raises InputError for what has no meaning without classes, and for a target that the recordings do not have.
    """
    parameters = parameters_of(given.get("parameters", table.get("parameters", {})))
    _check(table, given, parameters)
    if _is_as_run(table, parameters, given):
        return {}
    file = data or table.get("dataset", {}).get("file")
    if file is None:
        raise InputError("target: needs a file of recordings; give it as `data`")
    choice = TrialChoice(*({} if (value := given.get(key)) is None else value for key in CHOICE))
    with hdf5.open_recordings(file) as stored:
        chosen = chosen_trials(stored, choice, str(file), tell=False)
        conditions, marks = chosen.conditions, chosen.marks
    names = ", ".join(parameters.target)
    title = str(table.get("title", "A study")).removesuffix(f": {names}")
    changes = {**LEFT_OUT, "as_run": True, "title": f"{title}: {names}"}
    if parameters.target != (EVENTS,):
        numbers.check(conditions, parameters.target, conditions.index.to_numpy())
        classes = f"ranges of {parameters.target[0]} with equal numbers of training trials"
        return {**changes, "notes": [*_notes(f"Numbers: networks tell {names}, in units.", classes)]}
    if marks is None or not len(marks):
        raise InputError(
            f"{file}: has no annotations in time, which `target='events'` needs; import the recordings with "
            "`keep_whole`, or give nt.Recordings(..., marks=)"
        )
    classes = "stretches of training recordings with one mark, or none, behind the beginning of their recording"
    told = _notes(f"Events: networks detect {', '.join(sorted(marks['label'].unique()))}.", classes)
    return {**changes, **_of_detector(table, given), **_sweep(table, given, quick), "notes": [*told]}


def _is_as_run(table: Mapping[str, Any], parameters: Parameters, given: Mapping[str, Any]) -> bool:
    """Whether a study file was written by a run, and has what is its own already.

    Files written before `as_run` was have notes that say so.
    """
    notes = table.get("notes", ())
    has_own = table.get("as_run") or any(str(note).startswith(("Numbers: ", "Events: ")) for note in notes)
    is_changed = any(key.startswith(("window", "network")) for key in given)
    return bool(has_own) and not is_changed and parameters == parameters_of(table.get("parameters", {}))


def _check(table: Mapping[str, Any], given: Mapping[str, Any], parameters: Parameters) -> None:
    void = (*OF_CLASSES, "early_exit") if parameters.target == (EVENTS,) else OF_CLASSES
    asked = next((key for key in leaves(given) if key.startswith(void)), None)
    if asked is not None and asked.startswith("early_exit"):
        raise InputError(f"{asked}: a detector runs on without windows, which early exit would end; leave it out")
    if asked is not None:
        raise InputError(f"{asked}: is of classes, and a study with a target learns none; leave it out")
    swept = " & ".join([*table.get("sweep", {}), *(key.removeprefix("sweep.") for key in given if "sweep." in key)])
    for key in swept.split(" & "):
        if key == "encoder" or key.startswith(WINDOW):
            why = "encoders are compared by classes" if key == "encoder" else "rivals have one window"
            raise InputError(f"sweep.{key}: {why}; a study with a target is own-recordings, or one like it")


def _notes(what: str, classes: str) -> Iterator[str]:
    yield what
    yield f"Gains: chosen by how well they separate classes; these are {classes}."
    yield "Left out, since they belong to classes: varied copies, 8-bit weights, confusions."


def _sweep(table: Mapping[str, Any], given: Mapping[str, Any], quick: bool) -> dict[str, Any]:
    """The sweep of detectors: each recording is tested once, and all have a hidden layer.

    Without one a network has a single fit of whole windows, which does not forget.
    """
    key, changes = f"sweep.{HIDDEN}", {}
    sizes = (table.get("quick", {}) if quick else {}).get(key, table.get("sweep", {}).get(HIDDEN))
    if isinstance(sizes, list) and not {key, HIDDEN} & given.keys():
        changes[key] = [size for size in sizes if size]
    if not any(name.startswith(("split", "sweep.split", "sweep.seed", "seed")) for name in given):
        changes |= {"split.folds": FOLDS, "sweep.split.fold": [*range(FOLDS)], "sweep.seed": [0]}
    return changes


def _of_detector(table: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The windows and the network of a detector, which runs on: what is older than a window must have decayed."""
    asked = {key.removeprefix(WINDOW): value for key, value in given.items() if key.startswith(WINDOW)}
    its = {} if table.get("window") == AUTO else table.get("window", {})
    window = build(WindowSpec, {**its, **asked}, "`window`")
    named = given.get("network", table.get("network", "default"))
    settings = {key.removeprefix(NETWORK): value for key, value in given.items() if key.startswith(NETWORK)}
    network = resolve(RSNNSpec, build(RSNNSpec, named, "`network`") if isinstance(named, dict) else named, settings)
    window = window_for(window, network)
    fitting = network_for(network, window)
    changed = {key: getattr(fitting, key) for key in ("model", "readout", "readout_tau_ms")}
    void = None if window.align == "onset" else {"onset"}
    of_network = {f"{NETWORK}{key}": value for key, value in changed.items() if value != getattr(network, key)}
    return {**of_network, "window": window.model_dump(mode="json", exclude_none=True, exclude_unset=True, exclude=void)}


def _report(what: StudySpec, folder: Path) -> Path:
    return report.write(what, folder)


ENGINE = networks.ENGINE._replace(cells=cells, report=_report, own=own)
