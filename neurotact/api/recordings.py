"""Recordings and spike trains: simulated, read, loaded and saved."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurotact import effects, files, plugins, spec
from neurotact.api.arguments import Conditions, LeftOut, Settings, Tell, check_text
from neurotact.data import dataset, description, doubtful, hdf5
from neurotact.data import fetch as public
from neurotact.data.dataset import Reader as Reader
from neurotact.data.dataset import Simulator as Simulator
from neurotact.data.dataset import reader as reader
from neurotact.data.dataset import simulator as simulator
from neurotact.data.description import MOST_TAXELS as MOST_TAXELS
from neurotact.data.onset import common_onset_s
from neurotact.data.readers.columns import OF_ARRAYS, OF_EVENTS, LayoutSpec
from neurotact.data.readers.specs import EventSpec, NamingSpec
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.data.window_choice import timing_of
from neurotact.errors import InputError, number_of, some
from neurotact.progress import track
from neurotact.repeated_warnings import in_few_lines
from neurotact.spec import takes_specs

ARRAY_NAMES, EVENT_NAMES = OF_ARRAYS, [*OF_EVENTS, "polarity"]
"""What `names` of a file of arrays, and of one of events, may call by another name."""


def simulate(
    name: str, settings: Settings | None = None, *, progress: dataset.Progress | None = None, **parameters: Any
) -> Recordings:
    """Simulate an experiment, such as "gratings"; InputError names the nearest for an unknown name or key.

    settings, parameters: changes of its spec: dotted keys in `settings`, plain ones as keywords.
    progress: called as `progress(done, total)` with numbers of trials.

    >>> simulate("gratings", trials=1, duration_s=0.3)
    Recordings(48 trials x 8 taxels, 600 samples at 2000 Hz (0.3 s), mV, 8 classes)
    """
    source = dataset.simulator(check_text("name", name))
    changes = {**parameters, **spec.checked_settings(settings)}
    return source.simulate(source.build(changes, f"simulate {name}"), progress)


@in_few_lines
def read(
    name: str,
    path: str | Path,
    *,
    step_ms: float | None = None,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
) -> Recordings | SpikeTrains:
    """Read recordings, or spikes, as they were published; `name` is a reader's, such as "fabricslide".

    step_ms: of the clock of spikes, for a reader of events; its own when None.
    where: conditions of the trials to keep, such as `{"speed": 300, "force_N": [3, 6]}`, one or several values each.
    leave_out: conditions of trials to leave out, or classes. A line says how many trials are kept.
    Raises InputError for a condition or a value that no trial has.

    >>> nt.read("fabricslide", "fabricslide/", where={"speed_mm_per_min": 300})  # doctest: +SKIP
    Recordings(160 trials x 16 taxels, 73 to 161 samples at 35.61 Hz (2.05 to 4.52 s), count, 8 classes)
    """
    choice = TrialChoice.of(where, leave_out)
    reader = dataset.reader(check_text("name", name))
    effects.check(step_ms=step_ms, clock_ms=reader.step_ms)
    recordings = reader.read(Path(path)) if step_ms is None else reader.read(Path(path), step_ms)
    return chosen_trials(recordings, choice, str(path))


@in_few_lines
@takes_specs
def read_folder(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str | None = None,
    *,
    naming: NamingSpec = NamingSpec(),
    layout: LayoutSpec = LayoutSpec(),
    where: Conditions | None = None,
    leave_out: LeftOut = None,
) -> Recordings:
    """Read a folder of CSV, NPZ or MATLAB files, a row per sample and a column per taxel: `neurotact import folder`.

    sampling_rate_Hz: samples per second; found from the time stamps when None. unit: of the signals, such as "count".
    naming: where the class and the conditions of a file are, such as `nt.Naming(pattern="{label}_F{force}.csv")`.
    layout: the columns of a file, its time stamps, and what is done about faults, as in `nt.Layout(columns="1-5")`.
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file, the line and the fix.

    >>> naming, layout = nt.Naming(pattern="{label}/F{speed}_{number}.csv"), nt.Layout(time_column="t_ms")
    >>> nt.read_folder("csv", unit="mV", naming=naming, layout=layout)
    Recordings(12 trials x 2 taxels, 60 samples at 1000 Hz (0.06 s), mV, 2 classes)
    """
    choice = TrialChoice.of(where, leave_out)
    read = plugins.load_function("tools", "import_folder")
    recordings = read(path, sampling_rate_Hz, unit or "", naming=naming.given(), layout=layout.given())
    return chosen_trials(recordings, choice, str(path))


@in_few_lines
@takes_specs
def read_table(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str | None = None,
    *,
    label: str | None = None,
    trial: str | Sequence[str] = (),
    segments: bool = False,
    annotations: str | Path | None = None,
    keep_whole: bool = False,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    layout: LayoutSpec = LayoutSpec(),
) -> Recordings:
    """Read one CSV file with a row per sample of all trials: `neurotact import table`.

    label: the column of classes; one named label, class, y or target when None. trial: the columns that tell trials
    apart, such as "subject,repetition"; one named trial, recording or touch when empty. segments: whether each stretch
    of samples of one class is a trial, as in a continuous recording. annotations: a CSV file with the columns begin,
    end and label, a row per touch, in place of both. keep_whole: whether a continuous recording stays
    one trial, with a mark for each touch, as a detector of events needs it.
    layout: the columns, as of `read_folder`; all columns of numbers that change within trials are taxels when it names
    none, and those that are constant within each trial are conditions.
    where, leave_out: the trials to keep, and to leave out, such as the class "rest", which is no touch; as of `read`.
    Raises InputError, which names the file, the line or the column, and the fix.

    >>> nt.read_table("table.csv", unit="mV", trial="trial", layout=nt.Layout(columns="p1,p2", time_column="t_ms"))
    Recordings(12 trials x 2 taxels, 60 samples at 1000 Hz (0.06 s), mV, 2 classes)
    """
    spec = {"label": label, "trial": trial, "segments": segments, "annotations": annotations and str(annotations)}
    spec["keep_whole"] = keep_whole
    choice = TrialChoice.of(where, leave_out)._asdict()
    read = plugins.load_function("tools", "import_table")
    return read(path, sampling_rate_Hz, unit or "", {**layout.given(), **spec, **choice})


@in_few_lines
def read_arrays(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str | None = None,
    *,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
) -> Recordings:
    """Read one NPZ, NPY, MATLAB or HDF5 file with the signals of all trials in one array: `neurotact import arrays`.

    sampling_rate_Hz: that which the file says (`fs`, `sampling_rate`) when None. names: what the file calls signals,
    label and channels, such as `{"label": "gesture"}`, an array or a column of the conditions; signals are the only
    array with three or four axes, unless named. axes: theirs, in their order, such as "trial,taxel,time" or of a grid
    "trial,time,row,column". conditions: a CSV file with a row per trial, or an .npy file with the class of each. Other
    arrays of one value a trial become conditions.
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file, the array and the fix.

    >>> nt.read_arrays("arrays.npz", 1000.0, "mV", names={"label": "gesture"})
    Recordings(12 trials x 2 taxels, 60 samples at 1000 Hz (0.06 s), mV, 2 classes)
    """
    choice = TrialChoice.of(where, leave_out)
    read = plugins.load_function("tools", "import_arrays")
    recordings = read(path, sampling_rate_Hz, unit or "", names=names, axes=axes, conditions=conditions)
    return chosen_trials(recordings, choice, str(path))


@in_few_lines
@takes_specs
def read_raster(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    *,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
    naming: NamingSpec = NamingSpec(),
    layout: LayoutSpec = LayoutSpec(),
    merge_events: bool = False,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
) -> SpikeTrains:
    """Read rasters of 0 and 1, or of counts, `(trial, time, afferent)`: `neurotact import raster`.

    The file is as of `read_arrays`, with afferents in place of taxels: sampling_rate_Hz, names, axes, conditions. A
    folder has a raster `(time, afferent)` per trial: naming, and array and transpose of layout, as of `read_folder`.
    merge_events: whether more than 1 % of the spikes may be lost where a step counts several.
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file and the fix.

    >>> X, y = np.eye(6, dtype=np.uint8)[None].repeat(4, axis=0), ["felt", "silk"] * 2
    >>> np.savez("raster.npz", x=X, label=y)
    >>> nt.read_raster("raster.npz", 1000.0).steps[0].tolist()
    [0, 1, 2, 3, 4, 5]
    """
    choice = TrialChoice.of(where, leave_out)
    trains = plugins.load_function("tools", "import_raster")(
        path, sampling_rate_Hz, names=names, axes=axes, conditions=conditions,
        naming=naming.given(), layout=layout.given(),
        merge_events=merge_events,
    )  # fmt: skip
    return chosen_trials(trains, choice, str(path))


@in_few_lines
@takes_specs
def read_events(
    path: str | Path,
    *,
    events: EventSpec = EventSpec(),
    names: Mapping[str, str] | None = None,
    naming: NamingSpec = NamingSpec(),
    where: Conditions | None = None,
    leave_out: LeftOut = None,
) -> SpikeTrains:
    """Read a file of events (CSV, NPZ, NPY, HDF5), or a folder of one file per trial: `neurotact import events`.

    events: the clock, the populations and the channels, such as `nt.Events(step_ms=0.5, polarity="merge")`.
    names: what the file calls time, channel, polarity (or population), trial and label.
    naming: of a folder, as of `read_folder`.
    where, leave_out: the trials to keep and to leave out, as of `read`.
    Raises InputError, which names the file, the place and the fix.

    >>> spikes = nt.read_events("events.csv", events=nt.Events(step_ms=1.0))
    >>> len(spikes), spikes.steps[0].tolist(), spikes.units[0].tolist()
    (12, [1, 4, 9], [0, 1, 0])
    """
    choice = TrialChoice.of(where, leave_out)
    options, read = events.given(), plugins.load_function("tools", "import_events")
    return chosen_trials(read(path, options, names=names, naming=naming.given()), choice, str(path))


def fetch(name: str | None = None, out: str | Path | None = None, *, show: Tell = print) -> None:
    """Download a public tactile data set to the folder `out`, as `neurotact fetch` does; without a name, list the sets.

    out: its name in $NEUROTACT_DATA if None. Licence, size and citation are shown first; files that exist are kept.
    show: called with each line.
    Raises InputError for an unknown set, and where it cannot be downloaded, with the steps by hand.

    >>> nt.fetch("fabricslide", "fabricslide/")  # doctest: +SKIP
    """
    effects.check(out=out, name=name)
    if name is None:
        for key, about in public.SETS.items():
            show(f"{key}: {about.about}")
        return
    about = public.public_set(name)
    folder = Path(out) if out else dataset.expand(f"$NEUROTACT_DATA/{name}")
    show(f"{name}: {about.about}")
    facts = {"licence": about.licence, "size": about.size, "cite": about.citation, "page": about.page}
    for what, fact in facts.items():
        show(f"{what}: {fact}")
    with track("fetch", max(1, len(public.missing(name, folder)))) as advance:
        n_files = public.fetch(name, folder, advance)
    n_there = len(public.registry_of(name)) - n_files
    command = f"import {about.reader}" if about.reader else "train"
    show(f"{folder}: {number_of(n_files, 'file')} downloaded, {n_there} existed; neurotact {command} reads them")


def describe(file: str | Path, *, all: bool = False, show: Tell = print) -> None:
    """Tell what a file of recordings or spikes holds, as `neurotact info` does, in lines and tables.

    Classes and conditions, marks in time, the length and rate of trials, when the touch begins, and the range of each
    taxel or the rate of each population. all: a row for each taxel, however many there are. show: called with each line
    and table.
    Raises InputError for a file that is neither.

    >>> lines = []
    >>> nt.describe("touch.h5", show=lines.append)
    >>> lines[0]
    'touch.h5: 30 trials of 2 classes, 2 taxels, in mV'
    """
    kind = hdf5.kind_of(file)
    effects.check(all=all, content=kind)
    if kind == "recordings":
        with hdf5.open_recordings(file) as data:
            of = f"{number_of(len(data.classes), 'class')}, {number_of(data.n_channels, 'taxel')}, in {data.unit}"
            _describe(
                f"{file}: {number_of(len(data), 'trial')} of {of}", data, data.lengths, common_onset_s(data), show
            )
            taxels = description.taxels_table(data)
            is_short = all or len(taxels) <= MOST_TAXELS
            show(taxels if is_short else description.taxels_summary(taxels))
            if dead := description.constant_taxels(taxels):
                show(f"constant within every trial: {some(dead)}")
            if not is_short:
                show("`all=True` prints a row for each taxel")
            lines = doubtful.lines(data)
    else:
        spikes = hdf5.load_spikes(file)
        _describe(f"{file}: {spikes!r}", spikes, np.asarray(spikes.trial_steps), timing_of(spikes).touch_s, show)
        show(description.afferents_table(spikes))
        if held := description.held_line(spikes):
            show(held)
        lines = doubtful.lines(spikes)
    for line in lines:
        show(line)


def _describe(
    title: str, data: hdf5.StoredRecordings | SpikeTrains, lengths: np.ndarray, onset_s: float, show: Tell
) -> None:
    show(title)
    show(description.lengths_line(lengths, data.sampling_rate_Hz))
    if onset_s:
        show(
            f"the touch begins about {1e3 * onset_s:.0f} ms after the start of a trial "
            "(`nt.train(..., window=nt.Window(start_ms=...))`)"
        )
    show(description.conditions_table(data.conditions))
    if data.marks is not None and len(data.marks):
        line = description.marks_line(data.marks, float(lengths.sum()) / data.sampling_rate_Hz)
        show(f"{line} (`nt.train(..., learn=nt.Learn(target='events'))`)")


def load(path: str | Path) -> Recordings | SpikeTrains:
    """Load an HDF5 file of recordings or of spike trains.

    >>> nt.load("touch.h5")
    Recordings(30 trials x 2 taxels, 200 samples at 1000 Hz (0.2 s), mV, 2 classes)
    """
    return hdf5.load(path)


def load_recordings(path: str | Path) -> Recordings:
    """Load an HDF5 file of recordings; InputError for one of spike trains.

    As `load`, with a result of one type.

    >>> nt.load_recordings("touch.h5").signals[0].shape
    (200, 2)
    """
    return hdf5.load_recordings(path)


def load_spikes(path: str | Path) -> SpikeTrains:
    """Load an HDF5 file of spike trains; InputError for one of recordings.

    As `load`, with a result of one type.

    >>> nt.load_spikes("spikes.h5").afferents
    ('SA-I taxel1', 'SA-I taxel2', 'RA-I taxel1', 'RA-I taxel2')
    """
    return hdf5.load_spikes(path)


def save(what: Recordings | SpikeTrains, path: str | Path, *, force: bool = False) -> None:
    """Save recordings or spike trains as HDF5; an existing file is refused unless `force`.

    Warns of copies among recordings and among events of a sensor; raises InputError for copies with two classes.

    >>> nt.save(nt.load("touch.h5"), "copy.h5")
    >>> nt.load("copy.h5").classes
    ('felt', 'silk')
    """
    files.check_new(path, force=force)
    if isinstance(what, Recordings) or (isinstance(what, SpikeTrains) and not what.encoder):
        doubtful.check(what, what.source or str(path))
    if isinstance(what, Recordings):
        hdf5.save_recordings(what, path)
    elif isinstance(what, SpikeTrains):
        hdf5.save_spikes(what, path)
    else:
        raise InputError(f"save: takes recordings or spike trains; got {type(what).__name__}")
