"""The commands from recordings to spikes: calibrate, encode, raster."""

from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np
import typer

from neurotact import effects, files, spec
from neurotact.cli.options import (
    MOST_SPLITS,
    EncoderOption,
    Fold,
    Folds,
    Force,
    Group,
    LeaveOut,
    Order,
    OutFile,
    SetOption,
    Spikes,
    Stratify,
    TestWhere,
    Where,
    choice_of,
    split_table,
)
from neurotact.cli.options import Recordings as RecordingsFile
from neurotact.cli.output import print_line, print_table
from neurotact.cli.words import say
from neurotact.data import encoded_from, hdf5
from neurotact.data.conditioning import acausal_note
from neurotact.data.nwb_output import to_nwb
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import SplitSpec, check_stratify, training_touches
from neurotact.data.trial_choice import chosen_trials
from neurotact.encoders import alternatives, calibration, firing, resting
from neurotact.encoders import specs as encoders
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_file
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.errors import InputError
from neurotact.figures import raster as rasters
from neurotact.figures.calibration import draw_calibration
from neurotact.figures.style import save as save_figure
from neurotact.progress import track

COLUMNS = ["baseline", "polarity", "accuracy", "separation_sa", "separation_ra", "acausal", "chosen"]
"""The columns shown for alternatives."""


def calibrate(
    recordings: RecordingsFile,
    out: OutFile,
    encoder: EncoderOption = "sa1-ra1-lif",
    settings: SetOption = None,
    split_seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=MOST_SPLITS,
            show_default="0",
            help="Random seed of the split; only its training trials are used.",
        ),
    ] = None,
    stratify: Stratify = None,
    where: Where = None,
    leave_out: LeaveOut = None,
    test_where: TestWhere = None,
    group: Group = None,
    order: Order = None,
    folds: Folds = None,
    fold: Fold = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="Compare baselines and polarities first and use the best causal one.")
    ] = False,
    rest_ms: Annotated[
        float,
        typer.Option(
            "--rest-ms",
            min=1,
            help="Length of the rest at the start of each trial, in which afferents should be silent.",
        ),
    ] = resting.REST_MS,
    figure: Annotated[Path | None, typer.Option(help="Also draw how the gains were chosen (.png, .svg, .pdf).")] = None,
    force: Force = False,
) -> None:
    """Find an encoder's gains for a sensor, from its training trials.

    A baseline that uses the whole trial is replaced by a causal one, and the
    cut-off of the moving average is chosen, unless they are given with --set.
    Afferents that fire at rest are listed, with a remedy.
    """
    began = perf_counter()
    _check_outputs([out, figure], force, [recordings, encoder])
    asked = split_table(split_seed, test_where, group, order, folds, fold)
    rule, changes = CalibrationRule(), spec.parse_assignments(settings or [])
    start = spec.load(AfferentSpec, encoder, changes)
    fit, times = calibration.way_of(start, changes)
    if compare:
        spec.refuse(changes, alternatives.COMPARED)
    n_steps = alternatives.n_steps(rule) if compare else times * rule.candidates
    choice = choice_of(where, leave_out)
    with hdf5.open_recordings(recordings) as stored, track("calibrate", n_steps) as advance:
        data = chosen_trials(stored, choice, str(recordings))
        split = spec.build(SplitSpec, asked, source="calibrate")
        check_stratify(data.conditions, stratify, split)
        training = data.select(training_touches(data, stratify or (), split))
        compared = alternatives.compare(training, start, advance, rule) if compare else None
        found = fit(training, start, advance, rule) if compared is None else compared.best
        at_rest = resting.resting_table(training, found.encoder, rest_ms)
        complaint = resting.complaint(at_rest, rest_ms, found.encoder.conditioning.baseline)
    trials = f"{len(training)} training trials (split seed {asked['seed']}) of {recordings.name}"
    comment = f"# Calibrated from {encoder} on the {trials}.\n"
    files.write_text(out, comment + spec.to_toml(found.encoder.model_dump(mode="json", exclude_none=True)))
    if figure:
        save_figure(draw_calibration(found.table, found.isi), figure)
    if compared is not None:
        print_table(compared.table[COLUMNS])
    print(
        f"{out}: sa1.gain = {found.encoder.sa1.gain:g}, ra1.gain = {found.encoder.ra1.gain:g}, from {len(training)} "
        f"training trials in {perf_counter() - began:.1f} s"
    )
    if complaint:
        say(f"{recordings}: {complaint}")


def encode(
    recordings: RecordingsFile,
    out: OutFile,
    encoder: EncoderOption = "sa1-ra1-lif",
    settings: SetOption = None,
    where: Where = None,
    leave_out: LeaveOut = None,
    force: Force = False,
) -> None:
    """Turn whole trials into the spikes of SA-I and RA-I afferents."""
    files.check_new(out, force=force, inputs=[recordings, encoder])
    what = encoders.load(encoder, spec.parse_assignments(settings or []))
    choice = choice_of(where, leave_out)
    with hdf5.open_recordings(recordings) as stored:
        data = chosen_trials(stored, choice, str(recordings))
        with track("encode", len(data)) as advance:
            found = encode_file(data, what, out, lambda n: advance(n, ""))
    for complaint in firing.complaints(found.fired, found.steps, found.clock_Hz, what):
        say(complaint)
    print(
        f"{out}: {found.trials} trials, {found.fired.sum()} spikes of {len(found.fired)} afferents "
        f"in {found.steps / found.clock_Hz:.1f} s"
    )
    print_line(acausal_note(what.model_dump(mode="json")))


def raster(
    spikes: Spikes,
    out: OutFile,
    trial: Annotated[int | None, typer.Option(min=0, show_default="0", help="Which trial to draw.")] = None,
    start_s: Annotated[
        float | None, typer.Option("--start-s", min=0, show_default="0", help="Start of the part that is drawn.")
    ] = None,
    stop_s: Annotated[
        float | None, typer.Option("--stop-s", help="End of the part that is drawn; the trial's end when absent.")
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option(help="The file of recordings, if it was moved after encoding.")
    ] = None,
    force: Force = False,
) -> None:
    """Draw a trial's spikes (.png, .svg, .pdf), or write those of all trials (.csv, .nwb).

    The signal is drawn above the spikes.
    """
    kind = "events" if out.suffix in (".csv", ".nwb") else "picture"
    effects.check(file=kind, trial=trial, start_s=start_s, stop_s=stop_s, recordings=recordings)
    trial = trial or 0
    files.check_new(out, force=force, inputs=[spikes, recordings])
    trains = hdf5.load_spikes(spikes)
    files.check_new(out, force=force, inputs=[trains.source or None])
    if trial >= len(trains):
        raise InputError(f"--trial {trial}: {spikes} holds trials 0 to {len(trains) - 1}; choose one of them")
    if out.suffix == ".csv":
        rasters.write_events(trains, out)
    elif out.suffix == ".nwb":
        to_nwb(trains, out, force=force)
    else:
        signal = _signal_of(trains, trial, recordings, spikes)
        rasters.write_raster(trains, trial, out, signal=signal, start_s=start_s or 0.0, stop_s=stop_s)
    print(out)


def _check_outputs(outputs: list[Path | None], force: bool, inputs: list[str | Path]) -> None:
    """Refuse outputs that exist or are inputs, and two outputs that are one file."""
    given = [out for out in outputs if out]
    for out in given:
        files.check_new(out, force=force, inputs=inputs)
    places = [out.resolve() for out in given]
    if len(set(places)) < len(places):
        raise InputError(f"{given[-1]}: is the path of two outputs of this command; give each its own file")


def _signal_of(
    trains: SpikeTrains, trial: int, given: Path | None, spikes: Path
) -> tuple[np.ndarray, float, str] | None:
    """The recorded signal of one trial, its sampling rate and unit; None if the recordings are not available."""
    try:
        path, (recorded,) = encoded_from.find(spikes, trains, np.array([trial]), given)
    except encoded_from.AbsentError as error:
        say(f"the signal is left out: {error}")
        return None
    with hdf5.open_recordings(path) as data:
        n_samples = int(data.lengths[recorded])
        files.check_size(f"{path}, trial {recorded}", 4 * n_samples * data.n_channels)
        return data.piece(int(recorded), 0, n_samples), data.sampling_rate_Hz, data.unit
