"""The Python reference: every name that the package and its rooms export, once, by subject, from its docstring."""

import inspect
import pkgutil
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import neurotact
from neurotact.spec import Spec


class Subject(NamedTuple):
    """A page: its heading, what it is about, and the names of the front door that stand on it, in this order.

    room: a room whose own names stand there, too.
    """

    heading: str
    about: str
    names: str = ""
    room: str = ""


SUBJECTS = {
    "recordings": Subject(
        "Recordings",
        "Signals of taxels, one array `(time, taxel)` per trial, with a sampling rate in Hz, a unit and a table of "
        "conditions: simulated, read from files of many kinds, loaded and saved.",
        "Recordings simulate read_folder Naming Layout read_table read_arrays read read_nwb fetch load load_recordings "
        "save describe",
    ),
    "spikes": Subject(
        "Spikes",
        "Spikes of named afferents, one list of steps per trial, on a clock in Hz: read from events, loaded, drawn, "
        "and exchanged with tools of neuroscience.",
        "SpikeTrains read_events Events read_raster load_spikes plot_raster save_raster to_neo from_neo to_nwb",
    ),
    "encoding": Subject(
        "Encoding",
        "From signals `(time, taxel)` to spikes `(time, afferent)`: encoders by name or as a spec, and gains for a "
        "sensor of your own. Gains are in mV per unit of the signal, periods in ms.",
        "encode encode_file calibrate what_survives plot_survival SpikeEncoder AfferentSpec FiringWarning spec_names",
    ),
    "windows": Subject(
        "Windows and splits",
        "Windows of spikes as an array `(window, time, afferent)` of 0 and 1, with classes `(window,)` and trials "
        "`(window,)`, divided so that no trial is on two sides. Lengths are in ms.",
        "windows Window Onset Split Learn WindowedSpikes SpikeArray",
    ),
    "networks": Subject(
        "Networks",
        "Spiking networks, trained on windows `(window, time, afferent)`: as a scikit-learn estimator, from files into "
        "a run folder, or as a `torch.nn.Module`. Time constants are in ms.",
        "SpikingClassifier train conditions_curve tune Search result RSNN RSNNSpec TrainingSpec save_network "
        "load_network",
    ),
    "decisions": Subject(
        "Decisions and their cost",
        "Classes, times in steps and ms, and synaptic operations (SOPs), one row per window.",
        "infer refuse summarise sops",
    ),
    "deployment": Subject(
        "Streams, devices and exchange",
        "A trained chain in use: sample by sample, `(sample, taxel)`, in the unit of the encoder; as C, in integers, "
        "as NIR, in snnTorch, on a page.",
        "Stream Streamed Samples Decision stream Flow live export export_c fine_tune learn save_energy check_chip "
        "to_nir from_nir export_nir to_nir_data from_nir_data to_snntorch from_snntorch",
    ),
    "studies": Subject(
        "Studies",
        "Many networks from one TOML file, over processes and machines, with a report that says what came out.",
        "run_study resume_study report_study study_answer bundle_study",
    ),
    "baselines": Subject(
        "Opponents",
        "Classical and modern classifiers with scikit-learn's interface. X is `(trial, time, channel)` or "
        "`(example, feature)`, as each says; import them from `neurotact_parts.opponents`.",
        room="neurotact_parts.opponents",
    ),
    "extending": Subject(
        "Plug-ins and errors",
        "What packages of your own register, and the one error that says that an input cannot be used.",
        "Reader Simulator Exporter InputError",
        room="neurotact.baselines",
    ),
}
"""The pages, in the order of a chain."""


def rooms() -> list[ModuleType]:
    """The package, then each room that exports names, and the opponents."""
    found = (import_module(f"neurotact.{room.name}") for room in pkgutil.iter_modules(neurotact.__path__) if room.ispkg)
    beside = import_module("neurotact_parts.opponents")
    return [neurotact, *(room for room in found if getattr(room, "__all__", ())), beside]


def exported() -> dict[str, object]:
    """What is exported, by its first full name: a room's names that the front door has too are not repeated."""
    found: dict[str, object] = {}
    for room in rooms():
        for name in room.__all__:
            what = getattr(room, name)
            is_listed = inspect.isfunction(what) or inspect.isclass(what)
            if is_listed and all(what is not other for other in found.values()):
                found[f"{room.__name__}.{name}"] = what
    return found


def names_of(subject: Subject) -> list[str]:
    """The full names on the page of a subject."""
    own = [name for name in exported() if subject.room and name.rpartition(".")[0] == subject.room]
    return [*(f"neurotact.{name}" for name in subject.names.split()), *sorted(own)]


def overview() -> str:
    """The first page: the subjects, each with its names."""
    rows = [
        f"| [{subject.heading}](python/{page}.md) | {', '.join(map(_link, names_of(subject)))} |"
        for page, subject in SUBJECTS.items()
    ]
    toctree = "\n".join(f"python/{page}" for page in SUBJECTS)
    table = "\n".join(["| subject | names |", "|---|---|", *rows])
    return f"{table}\n\n```{{toctree}}\n:hidden:\n\n{toctree}\n```"


def _link(name: str) -> str:
    return f"{{py:obj}}`{name.rpartition('.')[2]} <{name}>`"


def page(name: str) -> str:
    """The page of a subject in Markdown; a name that is on no page is an error."""
    of_pages = [each for subject in SUBJECTS.values() for each in names_of(subject)]
    everything = exported()
    if sorted(of_pages) != sorted(everything):
        raise RuntimeError(f"reference: on no page or on two: {sorted({*of_pages} ^ {*everything}) or of_pages}")
    subject = SUBJECTS[name]
    entries = (f"## {each.rpartition('.')[2]}\n\n{_directive(each, everything[each])}" for each in names_of(subject))
    return "\n\n".join([subject.about, *entries])


def _directive(name: str, what: object) -> str:
    if inspect.isfunction(what):
        return _rest(f".. autofunction:: {name}")
    assert inspect.isclass(what), name
    if issubclass(what, Spec):
        return _rest(f".. autoclass:: {name}\n   :no-members:") + "\n\nIts keys: [specs](../specs.md)."
    return _rest(f".. autoclass:: {name}\n   :members:")


def _rest(text: str) -> str:
    return f"```{{eval-rst}}\n{text}\n```"
