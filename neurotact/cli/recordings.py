"""The commands that import recordings in published and common formats."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from neurotact import files
from neurotact.api import recordings as api
from neurotact.api import tools
from neurotact.api.recordings import Reader, Recordings, SpikeTrains, reader
from neurotact.api.settings import Layout
from neurotact.cli.help import Command
from neurotact.cli.lazy import add_plugins, new_app
from neurotact.cli.options import Force, OutFile, Texts, calling, flag, of_field, option
from neurotact.cli.output import save
from neurotact.errors import InputError
from neurotact.spec import parse_choice

IMPORTED = (".csv", ".npz", ".npy", ".mat", ".lvm", ".tdms", ".h5", ".hdf5", ".nwb", ".txt", ".tsv")
"""Formats of recordings."""

UNIT = option(str, "Unit of the signals, such as mV, V or count.")
RATE_OR_STAMPS = option(
    float | None, "Samples per second; found from the time stamps when absent.", "--sampling-rate-Hz"
)
MERGE_EVENTS = flag(
    "--merge-events", "Accept that more than 1 % of the events become one spike with another of their channel and step."
)
OF_STAMPS = {key: of_field(key, Layout.model_fields[key]) for key in ("max_gap_ms", "drop_repeats")}
TEXTS = "columns time_column time_unit max_gap_ms drop_repeats missing decimal header_lines"
"""Options of the columns of a text file."""
OF_ARRAYS = {
    "sampling_rate_Hz": option(
        float | None, "Samples per second.", "--sampling-rate-Hz", show_default="the array fs of the file"
    ),
    "names": option(
        Texts,
        "Names of signals, label or channels in the file, as in signals=data,label=gesture; may be repeated.",
        metavar="WHAT=NAME",
    ),
    "axes": option(
        str | None,
        "Axes of the signals, in their order, as in trial,taxel,time or, of a grid, trial,row,column,time.",
        show_default="trial,time,taxel; of a grid its longest axis is the time",
    ),
    "conditions": option(
        Path | None, "A CSV file of conditions: a row per trial, for a folder a column file; or classes as .npy."
    ),
}
OF_FOLDERS = {
    "label": option(str | None, "For a folder: the condition that is the class.", show_default="label"),
    "levels": option(str | None, "For a folder: conditions that name sub-folders."),
    "pattern": option(str | None, "For a folder: conditions in the file names."),
}

app = new_app("Convert recordings to one HDF5 file.")


@app.command("folder", cls=Command)
@calling(api.read_folder, unit=UNIT, sampling_rate_Hz=RATE_OR_STAMPS)
def import_folder(given: dict[str, Any], out: OutFile, force: Force = False) -> None:
    """Any recordings: a folder of text, NumPy, MATLAB or LabVIEW files, one row per sample, one column per taxel.

    One sub-folder per class, unless --levels, --pattern or --conditions say where the class and the conditions are.
    Time stamps that jitter are interpolated onto a regular clock.
    """
    _import(api.read_folder, given, out, force)


@app.command("table", cls=Command)
@calling(
    api.read_table,
    label=option(str | None, "The column of classes.", show_default="one named label, class, y or target"),
    trial=option(
        str | None, "The columns that tell trials apart, as in subject,repetition.",
        show_default="one named trial, recording or touch",
    ),
    segments=flag("--segments", "Each stretch of samples of one class is a trial, as in a continuous recording."),
    annotations=option(
        Path | None, "A CSV file with begin, end and label of each touch in a continuous recording."
    ),
    keep_whole=flag("--keep-whole", "With either, a continuous recording stays one trial, with a mark for each touch."),
    unit=UNIT,
    sampling_rate_Hz=RATE_OR_STAMPS,
    layout=TEXTS,
)  # fmt: skip
def import_table(given: dict[str, Any], out: OutFile, force: Force = False) -> None:
    """Recordings in one CSV file: a row per sample of all trials, with the trial and the class of each.

    Columns of numbers that change within trials are taxels; those that are constant within each trial are conditions.
    One continuous recording is cut into trials by the class of each sample (--segments) or by --annotations.
    """
    _import(api.read_table, given, out, force)


@app.command("arrays", cls=Command)
@calling(api.read_arrays, unit=UNIT, **OF_ARRAYS)
def import_arrays(given: dict[str, Any], out: OutFile, force: Force = False) -> None:
    """Recordings in one NPZ, NPY, MATLAB or HDF5 file: signals of all trials in one array, their classes in another.

    Further arrays with one value per trial become conditions. A grid of taxels is read row by row.
    """
    _import(api.read_arrays, given, out, force)


@app.command("raster", cls=Command)
@calling(
    api.read_raster,
    naming="levels pattern label",
    layout="array transpose",
    array=option(str | None, "For a folder: the array of each file that is its trial."),
    transpose=flag("--transpose", "For a folder: arrays are (afferent, time)."),
    merge_events=MERGE_EVENTS,
    **OF_ARRAYS,
    **OF_FOLDERS,
)
def import_raster(given: dict[str, Any], out: OutFile, force: Force = False) -> None:
    """Spikes as dense arrays of 0 and 1, or of counts.

    One NPZ, NPY, MATLAB or HDF5 file of (trial, time, afferent), or a folder of files of (time, afferent). A count of
    several spikes in one step is one spike: how many are lost is printed, and more than 1 % are refused without
    --merge-events.
    """
    _import(api.read_raster, given, out, force)


@app.command("events", cls=Command)
@calling(
    api.read_events,
    names=option(
        Texts,
        "Names of time, channel, polarity (or population), trial or label in the file, as in "
        "time=ts_us,label=shape; may be repeated.",
        metavar="WHAT=NAME",
    ),
    conditions=option(Path | None, "For a folder: a CSV file of conditions."),
    **OF_FOLDERS,
)
def import_events(given: dict[str, Any], out: OutFile, force: Force = False) -> None:
    """Spikes of any event-based sensor: CSV, NPZ or NPY, HDF5 in the Heidelberg layout, or a folder of such files.

    The file defines the populations, such as ON and OFF. Events of a channel within one step are one spike: how many is
    printed, and more than 1 % of the events are refused without --merge-events.
    """
    _import(api.read_events, given, out, force)


@app.command("nwb", cls=Command)
@calling(
    tools.read_nwb,
    trials=option(str, "The table of intervals whose rows are trials."),
    label=option(str, "The column of that table with the class of each trial."),
    step_ms=option(float | None, "Time step of the spikes.", show_default="the file's resolution, else 1"),
    name=option(str, "The column of units with their names.", show_default="afferent, else their ids"),
    series=option(str | None, "Read this time series as recordings, one taxel per column, instead of spikes."),
    unit=option(str | None, "Unit of the series.", show_default="as the file says"),
    sampling_rate_Hz=RATE_OR_STAMPS,
    **OF_STAMPS,
    units=option(
        Texts,
        "Read these units, by columns of theirs or of their electrodes, as in quality=good, location!=M1 or "
        "name!=unit7; may be repeated.",
        metavar="COLUMN=VALUE",
    ),
    unobserved=option(
        Literal["leave-out", "silent"] | None,
        "Trials that touch invalid times, or that a unit does not observe whole: leave all of them out, or read them "
        "as silent.",
        show_default="leave out at most 10 % of the trials",
    ),
    merge_events=MERGE_EVENTS,
)
def import_nwb(given: dict[str, Any], out: OutFile, force: Force = False) -> None:
    """Neurodata Without Borders: spike times of units, or a time series, cut into the trials of an NWB 2 file."""
    named = [name if "=" in name else f"name={name}" for name in given.pop("units", [])]
    given["units"], given["leave_out_units"] = parse_choice(named, [], "name", ("`units`", "`units`"))
    _import(tools.read_nwb, given, out, force)


def _names(assignments: list[str], known: list[str]) -> dict[str, str]:
    """Assignments, one per option or separated by commas; a comma without `WHAT=` after it is part of a name."""
    apart = re.compile(rf",(?=(?:{'|'.join(known)})=)")
    pairs = [part.partition("=") for assignment in assignments for part in apart.split(assignment)]
    wrong = [what + equals for what, equals, name in pairs if what not in known or not name]
    if wrong:
        raise InputError(f"--names {wrong[0]}: must read WHAT=NAME, where WHAT is one of {', '.join(known)}")
    twice = [what for what, _, _ in pairs if [pair[0] for pair in pairs].count(what) > 1]
    if twice:
        raise InputError(f"--names {twice[0]}: is given twice; give it one name")
    return {what: name for what, _, name in pairs}


def _command(name: str, form: Reader) -> Callable[..., None]:
    step_ms = (
        None
        if form.step_ms is None
        else option(float | None, "Time step of the spikes.", show_default=f"{form.step_ms:g}")
    )

    @calling(api.read, step_ms=step_ms)
    def run(given: dict[str, Any], out: OutFile, force: Force = False) -> None:
        _import(api.read, {**given, "name": name}, out, force)

    return run


add_plugins(app, "readers", reader, _command)


def _import(read: Callable[..., Recordings | SpikeTrains], given: dict[str, Any], out: Path, force: bool) -> None:
    """Read with the arguments of a command, and save."""
    path = given["path"]
    paths = files.below(path) if files.existing(path, "file or folder").is_dir() else []
    inputs = [file for file in paths if file.suffix.lower() in IMPORTED]
    table = given["naming"].table if "naming" in given else None
    files.check_new(out, force=force, inputs=[path, *inputs, given.get("conditions"), given.get("annotations"), table])
    if "names" in given:
        given["names"] = _names(given["names"], api.EVENT_NAMES if read is api.read_events else api.ARRAY_NAMES)
    save(read(**given), out)
