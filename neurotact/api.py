"""The front door's functions: what the command line does, one call each, on objects in memory.

Each joins rooms that know nothing of one another; estimators, specs and arrays come from their own rooms.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from neurotact import effects, files, spec, tables
from neurotact.data import doubtful, hdf5, sources
from neurotact.data.digests import recorded_trials
from neurotact.data.readers import arrays, event_files, folder, nwb, raster, sample_table
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import SplitSpec, check_stratify, training_touches
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.data.window_choice import ARGUMENTS
from neurotact.deploy import c_export, export, fine_tuning
from neurotact.deploy.export import Exported
from neurotact.encoders import alternatives, calibration, firing, specs
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import EncoderSpec
from neurotact.errors import InputError
from neurotact.figures.raster import draw_raster, existing_trial
from neurotact.figures.search import save_found
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, given_keys
from neurotact.networks.search import search, search_tables
from neurotact.networks.training import checkpoint, tasks, train_run, trained
from neurotact.networks.training.outcome import summary_of
from neurotact.networks.use import inference
from neurotact.report import report
from neurotact.studies import loading, runner

Settings = Mapping[str, Any]
"""Changes of a spec: dotted keys and their values, such as `{"sa1.t_ref_ms": 5}`."""
LeftOut = str | Sequence[str] | Mapping[str, Any] | None
"""Trials to leave out: by conditions, such as `{"material": "wood"}`, or by class, such as "rest,moving"."""


def simulate(
    name: str, settings: Settings | None = None, *, progress: sources.Progress | None = None, **parameters: Any
) -> Recordings:
    """Simulate an experiment, such as "gratings"; InputError names the nearest for an unknown name or key.

    settings, parameters: changes of its spec: dotted keys in `settings`, plain ones as keywords.
    progress: called as `progress(done, total)` with numbers of trials.

    >>> simulate("gratings", trials=1, duration_s=0.3)
    Recordings(48 trials x 8 taxels, 600 samples at 2000 Hz (0.3 s), mV, 8 classes)
    """
    found = sources.simulator(_text("name", name))
    changes = {**parameters, **spec.checked_settings(settings)}
    return found.simulate(found.build(changes, f"simulate {name}"), progress)


def read(
    name: str, path: str | Path, *, where: Settings | None = None, leave_out: LeftOut = None
) -> Recordings | SpikeTrains:
    """Read recordings, or spikes, as they were published; `name` is a reader's, such as "fabricslide".

    where: conditions of the trials to keep, such as `{"speed": 300, "force_N": [3, 6]}`, one or several values each.
    leave_out: conditions of trials to leave out, or classes. A line says how many trials are kept.
    Raises InputError for a condition or a value that no trial has.
    """
    choice = TrialChoice.of(where, leave_out)
    return chosen_trials(sources.reader(_text("name", name)).read(Path(path)), choice, str(path))


def read_folder(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str = "",
    *,
    levels: str | Sequence[str] = (),
    pattern: str | None = None,
    conditions: str | Path | None = None,
    columns: str | Sequence[str] = (),
    time_column: str | None = None,
    time_unit: str | None = None,
    max_gap_ms: float | None = None,
    drop_repeats: bool = False,
    decimal: str = ".",
    header_lines: int | None = None,
    array: str | None = None,
    transpose: bool = False,
    where: Settings | None = None,
    leave_out: LeftOut = None,
) -> Recordings:
    """Read a folder of CSV, NPZ or MATLAB files, a row per sample and a column per taxel: `neurotact import folder`.

    sampling_rate_Hz: samples per second; found from the time stamps when None. unit: of the signals, such as "count".
    levels: what the sub-folders are, from the top, such as "label,speed"; "label" when nothing else gives the label.
    pattern: conditions in the file names, such as "{label}_F{force}_{repetition}.csv".
    conditions: a CSV file with the column `file` and one column per condition.
    columns: the taxels, by numbers from 1 or by names, such as "1-5"; all but the time column when empty.
    time_column, time_unit, max_gap_ms: the stamps, by default a column, or in files of arrays an array, with a name
        like time, timestamp or t, whole seconds and the rest of the second (as in "sec,nanosec"), else a column of
        times of day; their unit ("s", "ms", "us", "ns"), by default that of the name, else the one that fits touch; and
        their longest interval.
    drop_repeats: drop every row with the time stamp of the row before it, in place of spreading such rows evenly.
    decimal: "." or ",". header_lines: lines before the first sample; found out when None.
    array: the array of each NPZ or MATLAB file that is its trial; each is one when None. transpose: whether arrays are
        (taxel, time).
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file, the line and the fix.
    """
    choice = TrialChoice.of(where, leave_out)
    naming = {"levels": levels, "pattern": pattern, "table": None if conditions is None else str(conditions)}
    layout = {
        "columns": columns, "time_column": time_column, "time_unit": time_unit, "max_gap_ms": max_gap_ms,
        "drop_repeats": drop_repeats, "decimal": decimal, "header_lines": header_lines, "array": array,
        "transpose": transpose,
    }  # fmt: skip
    found = folder.read(path, sampling_rate_Hz, unit, naming=naming, layout=layout)
    return chosen_trials(found, choice, str(path))


def read_table(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str = "",
    *,
    label: str | None = None,
    trial: str | Sequence[str] = (),
    segments: bool = False,
    annotations: str | Path | None = None,
    where: Settings | None = None,
    leave_out: LeftOut = None,
    columns: str | Sequence[str] = (),
    time_column: str | None = None,
    time_unit: str | None = None,
    max_gap_ms: float | None = None,
    drop_repeats: bool = False,
    decimal: str = ".",
    header_lines: int | None = None,
) -> Recordings:
    """Read one CSV file with a row per sample of all trials: `neurotact import table`.

    label: the column of classes; one named label, class, y or target when None. trial: the columns that tell trials
    apart, such as "subject,repetition"; one named trial, recording or touch when empty. segments: whether each stretch
    of samples of one class is a trial, as in a continuous recording. annotations: a CSV file with the columns begin,
    end and label, a row per touch, in place of both. columns: the taxels; all columns of numbers that change within
    trials when empty; those that are constant within each trial are conditions.
    where, leave_out: the trials to keep, and to leave out, such as the class "rest", which is no touch; as of `read`.
    sampling_rate_Hz, unit, time_column, time_unit, max_gap_ms, drop_repeats, decimal, header_lines: as of
    `read_folder`.
    Raises InputError, which names the file, the line or the column, and the fix.
    """
    spec = {
        "label": label, "trial": trial, "segments": segments,
        "annotations": None if annotations is None else str(annotations), **TrialChoice.of(where, leave_out)._asdict(),
        "columns": columns, "time_column": time_column, "time_unit": time_unit, "max_gap_ms": max_gap_ms,
        "drop_repeats": drop_repeats, "decimal": decimal, "header_lines": header_lines,
    }  # fmt: skip
    return sample_table.read(path, sampling_rate_Hz, unit, spec)


def read_arrays(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str = "",
    *,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
    where: Settings | None = None,
    leave_out: LeftOut = None,
) -> Recordings:
    """Read one NPZ, NPY, MATLAB or HDF5 file with the signals of all trials in one array: `neurotact import arrays`.

    sampling_rate_Hz: that which the file says (`fs`, `sampling_rate`) when None. names: what the file calls signals,
    label and channels, such as `{"label": "gesture"}`; signals are the only array with three or four axes, unless
    named. axes: theirs, in their order, such as "trial,taxel,time" or of a grid "trial,time,row,column". conditions: a
    CSV file with a row per trial, or an .npy file with the class of each. Other arrays of one value a trial become
    conditions.
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file, the array and the fix.
    """
    choice = TrialChoice.of(where, leave_out)
    found = arrays.read(path, sampling_rate_Hz, unit, names=names, axes=axes, conditions=conditions)
    return chosen_trials(found, choice, str(path))


def read_raster(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    *,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
    levels: str | Sequence[str] = (),
    pattern: str | None = None,
    array: str | None = None,
    transpose: bool = False,
    merge_events: bool = False,
    where: Settings | None = None,
    leave_out: LeftOut = None,
) -> SpikeTrains:
    """Read rasters of 0 and 1, or of counts, `(trial, time, afferent)`: `neurotact import raster`.

    The file is as of `read_arrays`, with afferents in place of taxels: sampling_rate_Hz, names, axes, conditions. A
    folder has a raster `(time, afferent)` per trial: levels, pattern, conditions, array, transpose as of `read_folder`.
    merge_events: whether more than 1 % of the spikes may be lost where a step counts several.
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file and the fix.
    """
    choice = TrialChoice.of(where, leave_out)
    found = raster.read(
        path, sampling_rate_Hz, names=names, axes=axes, conditions=conditions,
        naming={"levels": levels, "pattern": pattern}, layout={"array": array, "transpose": transpose},
        merge_events=merge_events,
    )  # fmt: skip
    return chosen_trials(found, choice, str(path))


def read_events(
    path: str | Path,
    settings: Settings | None = None,
    *,
    names: Mapping[str, str] | None = None,
    naming: Settings | None = None,
    where: Settings | None = None,
    leave_out: LeftOut = None,
) -> SpikeTrains:
    """Spike trains from a file of events (CSV, NPZ, NPY, HDF5) or a folder of one file per trial.

    settings: step_ms, merge_events, time_unit, origin, duration_ms, polarity, polarities, channels, n_channels, sensor.
    names: what the file calls time, channel, population, trial and label. naming: of a folder: levels, pattern, table.
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file and the place.
    """
    choice = TrialChoice.of(where, leave_out)
    return chosen_trials(event_files.read(path, settings, names=names, naming=naming), choice, str(path))


def read_nwb(
    path: str | Path,
    settings: Settings | None = None,
    *,
    where: Settings | None = None,
    leave_out: LeftOut = None,
) -> Recordings | SpikeTrains:
    """The spike trains of the units of an NWB file, cut into its trials; with `series` recordings of a time series.

    settings: trials, label, step_ms, name, merge_events, units, leave_out_units, unobserved; of a series also unit, and
    where it has time stamps sampling_rate_Hz, max_gap_ms and drop_repeats, as of `read_folder`. where, leave_out: the
    trials to keep, and to leave out, by the columns of the table of trials, as of `read`.
    Raises InputError, which names the file and the fix.
    """
    choice = TrialChoice.of(where, leave_out)
    return nwb.read(path, settings, choice)


def load(path: str | Path) -> Recordings | SpikeTrains:
    """Load an HDF5 file of recordings or of spike trains."""
    return hdf5.load(path)


def save(what: Recordings | SpikeTrains, path: str | Path, *, force: bool = False) -> None:
    """Save recordings or spike trains as HDF5; an existing file is refused unless `force`.

    Warns of copies among recordings and among events of a sensor; raises InputError for copies with two classes.
    """
    files.check_new(path, force=force)
    if isinstance(what, Recordings) or (isinstance(what, SpikeTrains) and not what.encoder):
        doubtful.check(what, str(path))
    if isinstance(what, Recordings):
        hdf5.save_recordings(what, path)
    elif isinstance(what, SpikeTrains):
        hdf5.save_spikes(what, path)
    else:
        raise InputError(f"save: takes recordings or spike trains; got {type(what).__name__}")


def encode(
    recordings: Recordings,
    encoder: str | Path | EncoderSpec = "sa1-ra1-lif",
    settings: Settings | None = None,
    *,
    where: Settings | None = None,
    leave_out: LeftOut = None,
    progress: Callable[[int], None] | None = None,
) -> SpikeTrains:
    """Spikes of SA-I and RA-I afferents for whole trials.

    encoder: a spec, or the name or path of one. settings: changes of it, dotted keys.
    where, leave_out: the trials to encode, as of `read`.
    progress: called with the number of trials done since its last call.
    Warns (`FiringWarning`) of a population that is silent, or whose every firing afferent is saturated.

    >>> spikes = encode(simulate("gratings", trials=1, duration_s=0.3), "sa1-ra1-lif", {"sa1.t_ref_ms": 5})
    >>> spikes.afferents[0], spikes.encoder["sa1"]["t_ref_ms"]
    ('SA-I taxel1', 5.0)
    """
    _instance("recordings", recordings, Recordings, "nt.simulate, nt.load or nt.read_folder returns them")
    recordings = chosen_trials(recordings, TrialChoice.of(where, leave_out), recordings.source or "recordings")
    what = specs.resolve(encoder, settings)
    trains = encode_recordings(recordings, what, progress)
    counts = np.bincount(np.concatenate(trains.units), minlength=len(trains.afferents))
    for complaint in firing.complaints(counts, int(trains.trial_steps.sum()), trains.sampling_rate_Hz, what):
        warnings.warn(complaint, firing.FiringWarning, stacklevel=2)
    return trains


def calibrate(
    recordings: Recordings,
    encoder: str | Path | AfferentSpec = "sa1-ra1-lif",
    settings: Settings | None = None,
    *,
    split_seed: int | None = None,
    stratify: Sequence[str] = (),
    split: Settings | None = None,
    where: Settings | None = None,
    leave_out: LeftOut = None,
    compare: bool = False,
) -> AfferentSpec:
    """An encoder with gains for a sensor, from the training trials of the split with that random seed.

    split: how else trials are divided, as for `train`; the gains know nothing of its validation and test trials.
    where, leave_out: the trials that are divided, as of `read`.
    settings: changes of the encoder, dotted keys. A baseline that knows the whole trial gives way to one that knows the
    past alone, and a moving average is chosen, unless `settings` name `conditioning.baseline` and
    `conditioning.ema_cutoff_Hz`.
    compare: try every baseline and polarity, and use the best that knows the past alone.
    """
    _instance("recordings", recordings, Recordings, "nt.simulate, nt.load or nt.read_folder returns them")
    recordings = chosen_trials(recordings, TrialChoice.of(where, leave_out), recordings.source or "recordings")
    how = spec.build(SplitSpec, _split(split_seed, split), "split")
    check_stratify(recordings.conditions, stratify, how)
    training = recordings.select(training_touches(recordings, stratify, how))
    changed = spec.resolve(AfferentSpec, encoder, settings)
    if compare:
        spec.refuse(settings or {}, alternatives.COMPARED)
        return alternatives.compare(training, changed).best.encoder
    fit, _ = calibration.way_of(changed, settings or {})
    return fit(training, changed).encoder


def plot_raster(
    spikes: SpikeTrains,
    trial: int = 0,
    recordings: Recordings | None = None,
    *,
    start_s: float = 0.0,
    stop_s: float | None = None,
) -> Figure:
    """The spikes of one trial as a matplotlib figure, under the signals of `recordings` where they are given."""
    _instance("spikes", spikes, SpikeTrains, "nt.encode returns them")
    signal = None
    if recordings is not None:
        found = recorded_trials(recordings, spikes, np.array([existing_trial(spikes, trial)]))
        if found is None:
            raise InputError(f"recordings: do not hold trial {trial} of the spikes; give those that were encoded")
        signal = (recordings.signals[found[0]], recordings.sampling_rate_Hz, recordings.unit)
    return draw_raster(spikes, trial, signal, start_s, stop_s)


def train(
    spikes: str | Path,
    folder: str | Path,
    network: str | Path | RSNNSpec = "default",
    settings: Settings | None = None,
    *,
    length_ms: float | None = None,
    start_ms: float | None = None,
    hop_ms: float | None = None,
    per_trial: int | None = None,
    align: str = "trial",
    onset: Settings | None = None,
    stratify: Sequence[str] = (),
    split_seed: int | None = None,
    split: Settings | None = None,
    where: Settings | None = None,
    leave_out: LeftOut = None,
    exit_tolerance: float = 0.01,
    exit_by: str = "stability",
    seed: int = 0,
    device: str = "cpu",
    force: bool = False,
    resume: bool = False,
) -> dict[str, Any]:
    """Train a network on windows of a file of spikes and save it in `folder`, as `neurotact train` does.

    Returns what it came to: `accuracy_test` with its 95 % interval (`low`, `high`, over `trials` test trials);
    `chance`, `commonest` and `baseline_accuracy` (of `baseline`, the best of eight classifiers on the same spikes) to
    compare it with; SOPs and steps, also with early exit (`exit_...`); and `cautions`, the list of what may be wrong.

    network: a spec, or the name or path of one. settings: changes of it, dotted keys.
    length_ms, start_ms, hop_ms, per_trial, align, onset: as for `windows`.
    stratify: conditions that are balanced in the split.
    split: how else trials are divided: group, test_where, order, folds, fold, validation and test, as for the method
    `split` of `windows`, such as `{"test_where": {"speed": 450}}`.
    where, leave_out: the trials that are used at all, as of `read`.
    exit_tolerance: validation accuracy that early exit may lose.
    exit_by: "stability", the leading class unchanged for long enough, or "margin", a lead that is large enough.
    force: replace a training that is in the folder. resume: go on with one that was interrupted.
    The spikes stay in their file, by whose content `resume` knows them; `save` writes one.
    Raises InputError for a folder that is not free, for spikes that cannot be used and for unknown keys.
    """
    place = Path(folder)
    spikes = _file_of(spikes)
    window = {"length_ms": length_ms, "start_ms": start_ms, "hop_ms": hop_ms, "per_trial": per_trial, "align": align}
    sides = _split(split_seed, split)
    task = tasks.task_of(
        "train", _window(window, onset), sides, stratify, exit_tolerance, exit_by, where=where, leave_out=leave_out
    )
    task = tasks.with_suited_window(task, tasks.load_spikes(spikes, task, tell=True), ARGUMENTS)
    what = spec.resolve(RSNNSpec, network, settings)
    given = given_keys(network, settings)
    train_run.run(spikes, place, what, task, given=given, seed=seed, device=device, force=force, resume=resume)
    return summary_of(files.read_json(place / train_run.RESULT))


def infer(
    run: str | Path,
    spikes: SpikeTrains | str | Path,
    *,
    early_exit: bool = False,
    test_only: bool = False,
    where: Settings | None = None,
    leave_out: LeftOut = None,
    allow_other_encoder: bool = False,
    device: str = "cpu",
) -> pd.DataFrame:
    """Decide every window of spike trains, or of a file of them, with the network in the run folder `run`.

    One row per window, with its spikes and SOPs. Columns: trial, side (training, validation, test, unseen), label,
    predicted, steps, input_spikes, hidden_spikes and sops_*.
    test_only: the network's own test trials alone. early_exit: stop where the validated rule says so.
    where, leave_out: the trials to decide, as of `read`; they are numbered anew in the column trial.
    Raises InputError for spikes of another encoder, unless `allow_other_encoder`.
    """
    trains = hdf5.load_spikes(spikes) if isinstance(spikes, (str, Path)) else spikes
    _instance("spikes", trains, SpikeTrains, "nt.encode and nt.load return them")
    trains = chosen_trials(trains, TrialChoice.of(where, leave_out), "spikes")
    restored = trained.restore(run, device=device)
    return inference.infer(
        restored, trains, early_exit=early_exit, test_only=test_only, allow_other_encoder=allow_other_encoder
    )


def export_c(
    run: str | Path,
    folder: str | Path,
    *,
    variant: str = "integer",
    recordings: str | Path | None = None,
    spikes: str | Path | None = None,
    weight_bits: int | None = None,
    state_bits: int | None = None,
    lsb: float | None = None,
    name: str = "touch",
    force: bool = False,
    **windows: Any,
) -> Exported:
    """Write the chain in the run folder `run` as C99, from a raw sample to a decision, as `neurotact export` does.

    variant: "integer", whose formats are chosen from the run's training trials, or "float". recordings, spikes: that
    the run was trained on, where they moved since. weight_bits: 2 to 8; when None those of `fine_tune`, else 8.
    state_bits: 8 to 16, or 24; chosen when None. lsb: of a sample of 16 bits; from the recorded range when None.
    name: prefix of every name in C.
    windows: early_exit, length_ms, start_ms, hop_ms, contact, quiet_ms, sampling_rate_Hz, as for `Stream`.
    Returns the chain and its formats.
    """
    effects.check(
        variant=variant, weight_bits=weight_bits, state_bits=state_bits, lsb=lsb, ranges=variant == "integer",
        recordings=recordings, spikes=spikes,
    )  # fmt: skip
    if variant not in ("integer", "float"):
        raise InputError(f"variant: '{variant}' is unknown; choose integer or float")
    for path in c_export.paths(Path(folder), name):
        files.check_new(path, force=force)
    found = export.prepared(
        run, integer=variant == "integer", recordings=recordings, spikes=spikes, weight_bits=weight_bits,
        state_bits=state_bits, lsb=lsb, **windows,
    )  # fmt: skip
    c_export.write(found.chain, Path(folder), found.formats, name=name)
    return found


def fine_tune(
    run: str | Path,
    folder: str | Path,
    *,
    weight_bits: int = 8,
    state_bits: int | None = None,
    epochs: int = fine_tuning.EPOCHS,
    seed: int | None = None,
    spikes: str | Path | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Train the network in the run folder `run` on with rounded weights, as `neurotact fine-tune` does.

    It is saved in `folder` as a run of its own, which `export_c` writes with these bits. weight_bits: 2 to 8.
    state_bits: 8 to 16, or 24; chosen when None. epochs: 0 rounds alone. seed: of the order of windows, 0 if
    None. Training and validation trials are used alone.
    spikes: that the run was trained on, where they moved since. force: replace a training that is in the folder.
    Returns what it came to, as `train` does.
    """
    place = Path(folder)
    fine_tuning.run(
        run, place, weight_bits=weight_bits, state_bits=state_bits, epochs=epochs, seed=seed, spikes=spikes, force=force
    )
    return summary_of(files.read_json(place / train_run.RESULT))


def tune(
    spikes: str | Path,
    folder: str | Path,
    space: str | Path | Mapping[str, Any] | None = None,
    network: str | Path | RSNNSpec = "default",
    settings: Settings | None = None,
    *,
    trials: int = 100,
    seed: int = 0,
    objective: str = "accuracy",
    sops_weight: float | None = None,
    max_sops: float | None = None,
    tuner: str = "tpe",
    assessor: str = "median-stop",
    start_epoch: int | None = None,
    length_ms: float | None = None,
    start_ms: float | None = None,
    hop_ms: float | None = None,
    per_trial: int | None = None,
    align: str = "trial",
    onset: Settings | None = None,
    stratify: Sequence[str] = (),
    split_seed: int | None = None,
    split: Settings | None = None,
    where: Settings | None = None,
    leave_out: LeftOut = None,
    exit_tolerance: float = 0.01,
    exit_by: str = "stability",
    workers: int | None = None,
    batch: int = 8,
    device: str = "cpu",
    resume: bool = False,
) -> pd.DataFrame:
    """Search a network's hyperparameters on validation windows, as `neurotact tune` does: one row per trial.

    space: name or path of a search space in NNI's terms, or the space itself; when None, around the choices of the
    network's recipe. trials: networks to train; the first is the network as given. The best has the highest value and,
    of equal ones, the fewest SOPs.
    objective: "accuracy", or "accuracy-sops", which is accuracy - `sops_weight` (0.1) log10(SOPs). max_sops: budget of
    the best network, in mean SOPs per window.
    tuner: "tpe", "random" or "grid". assessor: "median-stop" stops trials below the median early, from `start_epoch`
    (10) on; "none" trains all to the end.
    batch: trials that are proposed together. device: another torch device than "cpu", such as "cuda", trains each
    batch at once, in place of `workers` processes (2).
    Windows, split, where, leave_out, exit_tolerance and exit_by: as for `train`.
    The journal, tables, figure, `best.toml` and the best network are saved in `folder`; given the same folder again,
    the search continues there. resume: with more `trials` than before, too, as if all had been asked for at once.
    """
    place = Path(folder)
    spikes = _file_of(spikes)
    window = {"length_ms": length_ms, "start_ms": start_ms, "hop_ms": hop_ms, "per_trial": per_trial, "align": align}
    sides = _split(split_seed, split)
    task = tasks.task_of(
        "tune", _window(window, onset), sides, stratify, exit_tolerance, exit_by, where=where, leave_out=leave_out
    )
    trains = tasks.load_spikes(spikes, task, tell=True)
    task = tasks.with_suited_window(task, trains, ARGUMENTS)
    effects.check(workers=workers, device=device)
    table = {
        "trials": trials,
        "seed": seed,
        "objective": objective,
        "sops_weight": sops_weight,
        "max_sops": max_sops,
        "tuner": tuner,
        "assessor": assessor,
        "start_epoch": start_epoch,
        "batch": batch,
    }
    searched = spec.resolve(RSNNSpec, network, settings)
    asked = search.asked("tune", space, searched, table, trains, task, given_keys(network, settings))
    problem = search.problem_of(trains, asked, searched, task, device)
    with files.locked(place):
        with search.runner(problem, spikes, workers or 2, device) as run:
            found, _ = search.search(problem, place, run, resume=resume)
        save_found(problem, found, place)
        search.save_best(problem, spikes, place, found, device)
    return search_tables.trials_table(found)


def run_study(
    name: str | Path,
    folder: str | Path,
    settings: Settings | None = None,
    *,
    data: str | Path | None = None,
    where: Settings | None = None,
    leave_out: LeftOut = None,
    quick: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    device: str = "cpu",
) -> pd.DataFrame:
    """Run a study, shipped or your own, in `folder`; its results, one row per trained network.

    settings: changes of the study, dotted keys that name the part first: `{"network.hidden": 40}`.
    data: a file of recordings of your own, for a study that takes one: `run_study("own-recordings", "mine",
        data="touches.h5")`, or "ways-to-save". where, leave_out: its trials that are used, as of `read`.
    quick: a smaller sweep of the same kind. workers: processes on this machine, 2 if None. scheduler: address of a Dask
    scheduler, in their place. device: another torch device than "cpu", such as "cuda", trains all networks at once.
    The folder holds all tables, the figures and `report.html`; what was done before is not done again.
    """
    choice = TrialChoice.of(where, leave_out)
    changes = {**spec.checked_settings(settings), **loading.choice_changes(**choice._asdict())}
    study = loading.resolve(name, changes, quick=quick, data=data)
    runner.run(study, Path(folder), workers, scheduler, device)
    return _reported(Path(folder))


def report_study(folder: str | Path) -> pd.DataFrame:
    """Write the tables, figures and `report.html` of a study from what is done; its results."""
    runner.write_tables(Path(folder))
    return _reported(Path(folder))


def save_network(network: RSNN, folder: str | Path, *, force: bool = False) -> None:
    """Save a network as safetensors and JSON in `folder`; an existing network is refused unless `force`."""
    _instance("network", network, RSNN, "a SpikingClassifier has one in network_")
    files.check_new(Path(folder) / checkpoint.NETWORK, force=force)
    checkpoint.save(network, folder)


def load_network(folder: str | Path) -> RSNN:
    """The network in a folder that `save_network`, `train` or the command line wrote."""
    return checkpoint.load(folder)[0]


def _reported(folder: Path) -> pd.DataFrame:
    """Write the figures and the page from the tables of a study; its results."""
    report.write(folder)
    return tables.read_table(folder / "results.csv")


def _window(window: dict[str, Any], onset: Settings | None) -> dict[str, Any]:
    effects.check(align=window["align"], onset=onset)
    return window | ({"onset": dict(onset)} if onset else {})


def _split(seed: int | None, settings: Settings | None) -> dict[str, Any]:
    given = spec.checked_settings(settings)
    beside = {key: given.get(key) for key in ("order", "folds", "test_where")}
    effects.check(split_seed=seed, **beside)
    effects.check_keys(given, [effects.voids(**beside)], "split")
    return {"seed": seed or 0, **given}


def _text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise InputError(f"{name}: must be text; got {type(value).__name__}")
    return value


def _file_of(spikes: object) -> Path:
    """The path of a file of spikes; InputError for spikes in memory, which no run folder could find again."""
    if not isinstance(spikes, (str, Path)):
        raise InputError(
            f"spikes: must be the path of a file; got {type(spikes).__name__}; nt.save(spikes, 'spikes.h5') writes one"
        )
    return Path(spikes)


def _instance(name: str, value: object, wanted: type, fix: str) -> None:
    if not isinstance(value, wanted):
        raise InputError(f"{name}: must be {wanted.__name__}; got {type(value).__name__}; {fix}")
