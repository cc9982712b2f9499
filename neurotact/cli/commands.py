"""The commands by name. Each group of them is imported when it is used."""

import warnings
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer.main import get_group

from neurotact import __version__, progress
from neurotact.cli.help import TASKS
from neurotact.cli.lazy import command_of, lazy_group
from neurotact.interrupt import ending_at_once


class Place(NamedTuple):
    """The location of a command: its module in this package, its function or app there, and its line of help."""

    module: str
    name: str
    help: str


COMMANDS = {
    "study": Place("studies", "app", "Run, resume and report studies."),
    "import": Place("recordings", "app", "Convert recordings to one HDF5 file."),
    "fetch": Place("datasets", "fetch", "Download a public tactile data set."),
    "simulate": Place("simulate", "app", "Simulate an experiment."),
    "info": Place("datasets", "info", "Describe the content of a file of recordings or spikes."),
    "calibrate": Place("encoding", "calibrate", "Find an encoder's gains for a sensor, from its training trials."),
    "encode": Place("encoding", "encode", "Turn whole trials into the spikes of SA-I and RA-I afferents."),
    "raster": Place(
        "encoding", "raster",
        "Draw a trial's spikes (.png, .svg, .pdf), or write those of all trials (.csv, .nwb).",
    ),
    "train": Place("networks", "train_command", "Train a network on windows of spike trains."),
    "infer": Place("networks", "infer", "Classify every window with a trained network, and count its operations."),
    "sops": Place("networks", "sops", "Write the synaptic operations of each test window (.csv, .json, .md, .tex)."),
    "tune": Place("networks", "tune", "Search a network's hyperparameters on validation windows."),
    "save": Place(
        "networks", "save",
        "Find the network that saves the most energy at the accuracy of a run, by all ways together.",
    ),
    "learn": Place("networks", "learn", "Teach a network a new class from a few touches, by its readout alone."),
    "conditions-curve": Place(
        "networks", "conditions_curve",
        "How many values of a condition must be recorded, such as speeds.",
    ),
    "stream": Place("stream", "stream", "Classify samples as they arrive, from a pipe, a device or a file."),
    "live": Place("live", "live", "Show a running chain on a local page with sliders: touch, spikes, decision."),
    "export": Place(
        "export", "export_command",
        "Write a trained run as C, NIR or in another form, or check it against a chip.",
    ),
    "fine-tune": Place(
        "export", "fine_tune",
        "Continue the training of a network with rounded weights, for an export with few bits.",
    ),
    "list": Place(
        "specs", "list_specs",
        "List the specs that ship, and other packages' parts: encoders, networks, search spaces, studies, price lists.",
    ),
    "show": Place("specs", "show", "Print a spec, with the comments that give its sources."),
    "copy": Place("specs", "copy", "Copy a spec to this folder, to edit it and pass its path."),
}  # fmt: skip


def _load(name: str) -> Any:
    entry = COMMANDS[name]
    with ending_at_once(), warnings.catch_warnings():  # torch alone takes seconds
        warnings.simplefilter("ignore")  # warnings of other packages while they load do not help the user
        command = getattr(import_module(f"neurotact.cli.{entry.module}"), entry.name)
    return get_group(command) if isinstance(command, typer.Typer) else command_of(command)


Root = lazy_group(lambda: {name: entry.help for name, entry in COMMANDS.items()}, _load, TASKS)
app = typer.Typer(cls=Root, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress; warnings and errors are shown.")] = False,
) -> None:
    """Spiking touch: taxel signals to mechanoreceptor spikes to a decision, and the cost of each saving."""
    progress.show(not quiet)
    if version:
        print(__version__)
        raise typer.Exit
