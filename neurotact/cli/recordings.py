"""The commands that import recordings in published and common formats."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import typer

from neurotact import files
from neurotact.cli.lazy import add_plugins, new_app
from neurotact.cli.options import Force, LeaveOut, OutFile, Source, Where, choice_of, choice_table
from neurotact.cli.output import save_recordings
from neurotact.data import doubtful, hdf5
from neurotact.data.readers import arrays, clock, event_files, folder, nwb, raster, sample_table
from neurotact.data.recordings import Recordings
from neurotact.data.sources import Reader, reader
from neurotact.data.spikes import SpikeTrains
from neurotact.data.trial_choice import EVERY, TrialChoice, chosen_trials
from neurotact.errors import InputError
from neurotact.spec import parse_choice

IMPORTED = (".csv", ".npz", ".npy", ".mat", ".lvm", ".tdms", ".h5", ".hdf5", ".nwb", ".txt", ".tsv")
"""Formats of recordings."""

app = new_app("Convert recordings to one HDF5 file.")


SignalUnit = Annotated[str, typer.Option("--unit", help="Unit of the signals, such as mV, V or count.")]
RateOrStamps = Annotated[
    float | None,
    typer.Option("--sampling-rate-Hz", help="Samples per second; found from the time stamps when absent."),
]
TaxelColumns = Annotated[
    str | None,
    typer.Option("--columns", help="The taxels, by numbers from 1 or by names, as in 1-5, left,right or p1-p8."),
]
TimeColumn = Annotated[
    str | None,
    typer.Option(
        "--time-column",
        help="The column of time stamps, or in files of arrays their array; seconds and the rest as in sec,nanosec.",
        show_default="one named time, timestamp or t (t_ms), else one of times of day",
    ),
]
TimeUnit = Annotated[
    clock.Unit | None,
    typer.Option(
        "--time-unit",
        help="Unit of the time stamps.",
        show_default="that of the column's name (t_ms), else the one that fits touch",
    ),
]
MergeEvents = Annotated[
    bool,
    typer.Option(
        "--merge-events",
        help="Accept that more than 1 % of the events become one spike with another of their channel and step.",
    ),
]
RateOfFile = Annotated[
    float | None,
    typer.Option("--sampling-rate-Hz", help="Samples per second.", show_default="the array fs of the file"),
]
NamesOfArrays = Annotated[
    list[str] | None,
    typer.Option(
        "--names",
        metavar="WHAT=NAME",
        help="Names of signals, label or channels in the file, as in signals=data,label=gesture; may be repeated.",
    ),
]
Axes = Annotated[
    str | None,
    typer.Option(
        help="Axes of the signals, in their order, as in trial,taxel,time or, of a grid, trial,row,column,time.",
        show_default="trial,time,taxel; of a grid its longest axis is the time",
    ),
]
TrialTable = Annotated[
    Path | None,
    typer.Option(help="A CSV file of conditions: a row per trial, for a folder a column file; or classes as .npy."),
]
Decimal = Annotated[Literal[".", ","], typer.Option("--decimal", help="Decimal separator.")]
HeaderLines = Annotated[
    int | None, typer.Option("--header-lines", help="Lines before the first sample.", show_default="detected")
]
MaxGap = Annotated[
    float | None,
    typer.Option(
        "--max-gap-ms", help="Longest allowed interval between time stamps.", show_default="five times the usual one"
    ),
]
DropRepeats = Annotated[
    bool,
    typer.Option(
        "--drop-repeats",
        help="Drop every row with the time stamp of the row before it, in place of spreading such rows evenly.",
    ),
]


@app.command("folder")
def import_folder(
    source: Source,
    out: OutFile,
    unit: SignalUnit,
    sampling_rate_Hz: RateOrStamps = None,
    levels: Annotated[
        str | None,
        typer.Option(
            help="Conditions that name the sub-folders, from the top, as in label,speed.", show_default="label"
        ),
    ] = None,
    pattern: Annotated[
        str | None, typer.Option(help="Conditions in the file names, as in {label}_F{force}_{repetition}.csv.")
    ] = None,
    conditions: Annotated[
        Path | None, typer.Option(help="A CSV file with the column file and one column per condition.")
    ] = None,
    columns: TaxelColumns = None,
    time_column: TimeColumn = None,
    time_unit: TimeUnit = None,
    max_gap_ms: MaxGap = None,
    drop_repeats: DropRepeats = False,
    decimal: Decimal = ".",
    header_lines: HeaderLines = None,
    array: Annotated[
        str | None,
        typer.Option(help="The array of each NPZ or MATLAB file that is its trial.", show_default="each is a trial"),
    ] = None,
    transpose: Annotated[bool, typer.Option("--transpose", help="Arrays are (taxel, time).")] = False,
    where: Where = None,
    leave_out: LeaveOut = None,
    force: Force = False,
) -> None:
    """Any recordings: a folder of text, NumPy, MATLAB or LabVIEW files, one row per sample, one column per taxel.

    One sub-folder per class, unless --levels, --pattern or --conditions say where the class and the conditions are.
    Time stamps that jitter are interpolated onto a regular clock.
    """
    _check_import(source, out, force, conditions)
    choice = choice_of(where, leave_out)
    naming = {"levels": levels or (), "pattern": pattern, "table": str(conditions) if conditions else None}
    layout = {
        "columns": columns or (), "time_column": time_column, "time_unit": time_unit, "max_gap_ms": max_gap_ms,
        "drop_repeats": drop_repeats, "decimal": decimal, "header_lines": header_lines, "array": array,
        "transpose": transpose,
    }  # fmt: skip
    _save(folder.read(source, sampling_rate_Hz, unit, naming=naming, layout=layout), out, choice)


@app.command("table")
def import_table(
    source: Source,
    out: OutFile,
    unit: SignalUnit,
    sampling_rate_Hz: RateOrStamps = None,
    label: Annotated[
        str | None, typer.Option(help="The column of classes.", show_default="one named label, class, y or target")
    ] = None,
    trial: Annotated[
        str | None,
        typer.Option(
            help="The columns that tell trials apart, as in subject,repetition.",
            show_default="one named trial, recording or touch",
        ),
    ] = None,
    segments: Annotated[
        bool,
        typer.Option(
            "--segments", help="Each stretch of samples of one class is a trial, as in a continuous recording."
        ),
    ] = False,
    annotations: Annotated[
        Path | None,
        typer.Option(help="A CSV file with begin, end and label of each touch in a continuous recording."),
    ] = None,
    columns: TaxelColumns = None,
    time_column: TimeColumn = None,
    time_unit: TimeUnit = None,
    max_gap_ms: MaxGap = None,
    drop_repeats: DropRepeats = False,
    decimal: Decimal = ".",
    header_lines: HeaderLines = None,
    where: Where = None,
    leave_out: LeaveOut = None,
    force: Force = False,
) -> None:
    """Recordings in one CSV file: a row per sample of all trials, with the trial and the class of each.

    Columns of numbers that change within trials are taxels; those that are constant within each trial are conditions.
    One continuous recording is cut into trials by the class of each sample (--segments) or by --annotations.
    """
    _check_import(source, out, force, annotations)
    spec = {
        "label": label, "trial": trial or (), "segments": segments,
        "annotations": str(annotations) if annotations else None, **choice_table(where, leave_out),
        "columns": columns or (), "time_column": time_column, "time_unit": time_unit, "max_gap_ms": max_gap_ms,
        "drop_repeats": drop_repeats, "decimal": decimal, "header_lines": header_lines,
    }  # fmt: skip
    _save(sample_table.read(source, sampling_rate_Hz, unit, spec), out)


@app.command("arrays")
def import_arrays(
    source: Source,
    out: OutFile,
    unit: SignalUnit,
    sampling_rate_Hz: RateOfFile = None,
    names: NamesOfArrays = None,
    axes: Axes = None,
    conditions: TrialTable = None,
    where: Where = None,
    leave_out: LeaveOut = None,
    force: Force = False,
) -> None:  # fmt: skip
    """Recordings in one NPZ, NPY, MATLAB or HDF5 file: signals of all trials in one array, their classes in another.

    Further arrays with one value per trial become conditions. A grid of taxels is read row by row.
    """
    _check_import(source, out, force, conditions)
    choice = choice_of(where, leave_out)
    named = _names(names or [], [arrays.SIGNALS, *arrays.ALIASES])
    _save(arrays.read(source, sampling_rate_Hz, unit, names=named, axes=axes, conditions=conditions), out, choice)


@app.command("raster")
def import_raster(
    source: Source,
    out: OutFile,
    sampling_rate_Hz: RateOfFile = None,
    names: NamesOfArrays = None,
    axes: Axes = None,
    conditions: TrialTable = None,
    levels: Annotated[str | None, typer.Option(help="For a folder: conditions that name sub-folders.")] = None,
    pattern: Annotated[str | None, typer.Option(help="For a folder: conditions in the file names.")] = None,
    array: Annotated[
        str | None, typer.Option(help="For a folder: the array of each file that is its trial.")
    ] = None,
    transpose: Annotated[bool, typer.Option("--transpose", help="For a folder: arrays are (afferent, time).")] = False,
    merge_events: MergeEvents = False,
    where: Where = None,
    leave_out: LeaveOut = None,
    force: Force = False,
) -> None:  # fmt: skip
    """Spikes as dense arrays of 0 and 1, or of counts.

    One NPZ, NPY, MATLAB or HDF5 file of (trial, time, afferent), or a folder of files of (time, afferent). A count of
    several spikes in one step is one spike: how many are lost is printed, and more than 1 % are refused without
    --merge-events.
    """
    _check_import(source, out, force, conditions)
    choice = choice_of(where, leave_out)
    found = raster.read(
        source, sampling_rate_Hz, names=_names(names or [], [arrays.SIGNALS, *arrays.ALIASES]), axes=axes,
        conditions=conditions, naming={"levels": levels, "pattern": pattern},
        layout={"array": array, "transpose": transpose}, merge_events=merge_events,
    )  # fmt: skip
    _save(found, out, choice)


@app.command("events")
def import_events(
    source: Source,
    out: OutFile,
    step_ms: Annotated[float, typer.Option("--step-ms", help="Time step of the spikes.")] = 1.0,
    time_unit: Annotated[
        clock.Unit | None,
        typer.Option("--time-unit", help="Unit of the times.", show_default="of the file, else s; us for x, y, t, p"),
    ] = None,
    origin: Annotated[
        Literal["zero", "first"], typer.Option(help="Start of a trial: time zero, or its first event.")
    ] = "zero",
    duration_ms: Annotated[
        float | None, typer.Option("--duration-ms", help="Length of every trial.", show_default="up to the last event")
    ] = None,
    polarity: Annotated[
        Literal["separate", "merge", "on", "off"],
        typer.Option(help="One population per polarity, one for both (merge), or one polarity only."),
    ] = "separate",
    polarities: Annotated[
        str | None, typer.Option(help="Names of the polarities, from the lowest value.", show_default="OFF,ON")
    ] = None,
    channels: Annotated[str | None, typer.Option(help="Names of the channels, from channel 0.")] = None,
    n_channels: Annotated[
        int | None, typer.Option("--n-channels", help="Number of channels.", show_default="up to the last event's")
    ] = None,
    sensor: Annotated[str | None, typer.Option(help="Size of the grid of x, y, t, p events, as in 34x34.")] = None,
    names: Annotated[
        list[str] | None,
        typer.Option(
            "--names", metavar="WHAT=NAME",
            help="Names of time, channel, polarity (or population), trial or label in the file, as in "
            "time=ts_us,label=shape; may be repeated.",
        ),
    ] = None,
    levels: Annotated[str | None, typer.Option(help="For a folder: conditions that name sub-folders.")] = None,
    pattern: Annotated[str | None, typer.Option(help="For a folder: conditions in the file names.")] = None,
    conditions: Annotated[Path | None, typer.Option(help="For a folder: a CSV file of conditions.")] = None,
    merge_events: MergeEvents = False,
    where: Where = None,
    leave_out: LeaveOut = None,
    force: Force = False,
) -> None:  # fmt: skip
    """Spikes of any event-based sensor: CSV, NPZ or NPY, HDF5 in the Heidelberg layout, or a folder of such files.

    The file defines the populations, such as ON and OFF. Events of a channel within one step are one spike: how many is
    printed, and more than 1 % of the events are refused without --merge-events.
    """
    _check_import(source, out, force, conditions)
    choice = choice_of(where, leave_out)
    spec = {
        "step_ms": step_ms, "time_unit": time_unit, "origin": origin, "duration_ms": duration_ms, "polarity": polarity,
        "polarities": polarities or (), "channels": channels or (), "n_channels": n_channels, "sensor": sensor,
        "merge_events": merge_events,
    }  # fmt: skip
    naming = {"levels": levels or (), "pattern": pattern, "table": str(conditions) if conditions else None}
    _save(
        event_files.read(
            source, spec, names=_names(names or [], [*event_files.ALIASES, event_files.POLARITY]), naming=naming
        ),
        out,
        choice,
    )


@app.command("nwb")
def import_nwb(
    source: Source,
    out: OutFile,
    trials: Annotated[str, typer.Option(help="The table of intervals whose rows are trials.")] = "trials",
    label: Annotated[str, typer.Option(help="The column of that table with the class of each trial.")] = "label",
    step_ms: Annotated[
        float | None,
        typer.Option("--step-ms", help="Time step of the spikes.", show_default="the file's resolution, else 1"),
    ] = None,
    name: Annotated[
        str, typer.Option(help="The column of units with their names.", show_default="afferent, else their ids")
    ] = nwb.AFFERENT,
    series: Annotated[
        str | None, typer.Option(help="Read this time series as recordings, one taxel per column, instead of spikes.")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the series.", show_default="as the file says")] = None,
    sampling_rate_Hz: RateOrStamps = None,
    max_gap_ms: MaxGap = None,
    drop_repeats: DropRepeats = False,
    units: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=VALUE",
            help="Read these units, by columns of theirs or of their electrodes, as in quality=good, location!=M1 or "
            "name!=unit7; may be repeated.",
        ),
    ] = None,
    unobserved: Annotated[
        Literal["leave-out", "silent"] | None,
        typer.Option(
            help="Trials that touch invalid times, or that a unit does not observe whole: leave all of them out, or "
            "read them as silent.",
            show_default="leave out at most 10 % of the trials",
        ),
    ] = None,
    merge_events: MergeEvents = False,
    where: Where = None,
    leave_out: LeaveOut = None,
    force: Force = False,
) -> None:
    """Neurodata Without Borders: spike times of units, or a time series, cut into the trials of an NWB 2 file."""
    _check_import(source, out, force)
    choice = choice_of(where, leave_out)
    asked = {
        "trials": trials, "label": label, "step_ms": step_ms, "name": name, "series": series, "unit": unit,
        "merge_events": merge_events, "unobserved": unobserved, "sampling_rate_Hz": sampling_rate_Hz,
        "max_gap_ms": max_gap_ms, "drop_repeats": drop_repeats,
    }  # fmt: skip
    named = [each if "=" in each else f"name={each}" for each in units or []]
    asked["units"], asked["leave_out_units"] = parse_choice(named, [], "name", ("--units", "--units"))
    _save(nwb.read(source, asked, choice), out)


def _names(assignments: list[str], known: list[str]) -> dict[str, str]:
    """Assignments, one per option or separated by commas; a comma without `WHAT=` after it is part of a name."""
    apart = re.compile(rf",(?=(?:{'|'.join(known)})=)")
    pairs = [each.partition("=") for assignment in assignments for each in apart.split(assignment)]
    wrong = [what + equals for what, equals, name in pairs if what not in known or not name]
    if wrong:
        raise InputError(f"--names {wrong[0]}: must read WHAT=NAME, where WHAT is one of {', '.join(known)}")
    twice = [what for what, _, _ in pairs if [each[0] for each in pairs].count(what) > 1]
    if twice:
        raise InputError(f"--names {twice[0]}: is given twice; give it one name")
    return {what: name for what, _, name in pairs}


def _command(name: str, form: Reader) -> Callable[..., None]:
    def run(
        source: Source, out: OutFile, where: Where = None, leave_out: LeaveOut = None, force: Force = False
    ) -> None:
        _check_import(source, out, force)
        choice = choice_of(where, leave_out)
        _save(form.read(source), out, choice)

    def run_on_clock(
        source: Source,
        out: OutFile,
        step_ms: Annotated[float, typer.Option("--step-ms", help="Time step of the spikes.")] = (form.step_ms or 1.0),
        where: Where = None,
        leave_out: LeaveOut = None,
        force: Force = False,
    ) -> None:
        _check_import(source, out, force)
        choice = choice_of(where, leave_out)
        _save(form.read(source, step_ms), out, choice)

    return run if form.step_ms is None else run_on_clock


add_plugins(app, "readers", reader, _command)


def _check_import(source: Path, out: Path, force: bool, table: Path | None = None) -> None:
    found = files.below(source) if files.existing(source, "file or folder").is_dir() else []
    inputs = [path for path in found if path.suffix.lower() in IMPORTED]
    files.check_new(out, force=force, inputs=[source, *inputs, table])


def _save(found: Recordings | SpikeTrains, out: Path, choice: TrialChoice = EVERY) -> None:
    """Save the chosen trials of what was read."""
    found = chosen_trials(found, choice, found.source or "recordings")
    doubtful.check(found, found.source or "recordings")
    if isinstance(found, Recordings):
        save_recordings(found, out)
        return
    hdf5.save_spikes(found, out)
    populations = found.populations
    shares = (
        f" ({', '.join(f'{len(rows)} {name}' for name, rows in populations.items())})" if len(populations) > 1 else ""
    )
    print(
        f"{out}: {len(found)} trials of {len(found.classes)} classes, {sum(map(len, found.steps))} spikes of "
        f"{len(found.afferents)} afferents{shares}, {found.trial_steps[0]} steps at {found.sampling_rate_Hz:g} Hz"
    )
