"""From recordings to spikes: calibrate an encoder, encode, and draw."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from time import perf_counter

import numpy as np

from neurotact import effects, files, spec
from neurotact.api import tools
from neurotact.api.arguments import Conditions, LeftOut, Settings, Tell, check_instance, silent
from neurotact.data import encoded_from, hdf5
from neurotact.data.augmentation import AUTO, NONE, AugmentationSpec, in_words
from neurotact.data.conditioning import acausal_note
from neurotact.data.description import held_line
from neurotact.data.digests import recorded_trials
from neurotact.data.recordings import Recordings, Trials
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Splits, check_stratify, training_touches
from neurotact.data.trial_choice import TrialChoice, chosen_trials
from neurotact.encoders import firing, specs
from neurotact.encoders.encoding import Encoded, encode_recordings
from neurotact.encoders.encoding import encode_file as write_encoded
from neurotact.encoders.model import DrivenSpec, EncoderSpec
from neurotact.encoders.sensitivity import sensitivities_of, value_of
from neurotact.errors import InputError, number_of
from neurotact.lazily import lazily
from neurotact.progress import Advance, track
from neurotact.progress import silent as silently
from neurotact.spec import takes_specs

with lazily():
    from neurotact.encoders import alternatives, calibration, gain_search
    from neurotact.figures import calibration as calibration_figure
    from neurotact.figures import raster, style


log = logging.getLogger("neurotact")

RETURNED = "nt.simulate, nt.load or nt.read_folder returns them"
COMPARED = ["baseline", "polarity", "accuracy", "separation_sa", "separation_ra", "acausal", "chosen"]
"""The columns of a comparison that are told."""


def encode(
    recordings: Recordings,
    encoder: str | Path | EncoderSpec = "sa1-ra1-lif",
    settings: Settings | None = None,
    *,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    augmentation: str | None = None,
    copies: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> SpikeTrains:
    """Spikes of SA-I and RA-I afferents for whole trials.

    encoder: a spec, or the name or path of one. settings: changes of it, dotted keys.
    where, leave_out: the trials to encode, as of `read`.
    augmentation: also encode varied copies of each trial, for training alone: what varies, of "time" (played faster or
        slower), "gain" (scaled), "start" (begun later) and "taxels" (a quarter of them at rest), as in "time+gain".
        copies: of each trial, 3 if None.
    progress: called with the number of trials done since its last call.
    Raises InputError for an unknown encoder, key, condition or value. Warns (`FiringWarning`) of a population that is
    silent, or whose every firing afferent is saturated.

    >>> import neurotact as nt
    >>> spikes = nt.encode(nt.simulate("gratings", trials=1, duration_s=0.3), "sa1-ra1-lif", {"sa1.t_ref_ms": 5})
    >>> spikes.afferents[0], spikes.encoder["sa1"]["t_ref_ms"]
    ('SA-I taxel1', 5.0)
    """
    check_instance("recordings", recordings, Recordings, RETURNED)
    recordings = chosen_trials(recordings, TrialChoice.of(where, leave_out), recordings.source or "recordings")
    what = specs.resolve(encoder, settings)
    trains = encode_recordings(recordings, what, progress, _augmentation(augmentation, copies))
    counts = np.bincount(np.concatenate(trains.units), minlength=len(trains.afferents))
    for complaint in firing.complaints(counts, int(trains.trial_steps.sum()), trains.sampling_rate_Hz, what):
        warnings.warn(complaint, firing.FiringWarning, stacklevel=2)
    return trains


def encode_file(
    recordings: str | Path,
    out: str | Path,
    encoder: str | Path | EncoderSpec = "sa1-ra1-lif",
    settings: Settings | None = None,
    *,
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    augmentation: str | None = None,
    copies: int | None = None,
    force: bool = False,
    tell: Tell = silent,
) -> Encoded:
    """Write the spikes of a file of recordings to the file `out`: those of `encode`, with little memory.

    encoder, settings, where, leave_out, augmentation, copies: as of `encode`. force: replace a file. tell: called with
    what `neurotact encode` prints.
    Returns the numbers of trials, of spikes of each afferent `(afferent,)` and of steps, and the clock in Hz.
    Raises InputError for a file that exists, and as `encode` does; logs of what it warns.

    >>> done = nt.encode_file("touch.h5", "encoded.h5", settings={"conditioning.baseline": "start"})
    >>> done.trials, done.clock_Hz
    (30, 1000.0)
    """
    out = Path(out)
    files.check_new(out, force=force, inputs=_paths(recordings, encoder))
    what, varied = specs.resolve(encoder, settings), _augmentation(augmentation, copies)
    with hdf5.open_recordings(recordings) as stored:
        data = chosen_trials(stored, TrialChoice.of(where, leave_out), str(recordings))
        with track("encode", len(data)) as advance:
            encoded = write_encoded(data, what, out, lambda n: advance(n, ""), varied)
    for complaint in firing.complaints(encoded.fired, encoded.steps, encoded.clock_Hz, what):
        log.warning("%s", complaint)
    tell(
        f"{out}: {number_of(encoded.trials, 'trial')}, {number_of(encoded.fired.sum(), 'spike')} of "
        f"{number_of(len(encoded.fired), 'afferent')} in {encoded.steps / encoded.clock_Hz:.1f} s"
    )
    if varied is not None:
        tell(f"beside {varied.copies} copies of each trial for training, {in_words(varied.kind, varied)}")
    if note := acausal_note(what.model_dump(mode="json")):
        tell(note)
    return encoded


def _augmentation(kind: str | None, copies: int | None) -> AugmentationSpec | None:
    """The varied copies that the arguments of a call describe; None if there are none."""
    effects.check(copies=copies, augmentation=kind)
    if kind is None or kind == NONE:
        return None
    if kind == AUTO:
        raise InputError("`augmentation`: 'auto' is for studies, which choose while they train; name what varies")
    table = {"kind": kind, **({} if copies is None else {"copies": copies})}
    return spec.build(AugmentationSpec, table, source="`augmentation`")


@takes_specs
def calibrate(
    recordings: Recordings | str | Path,
    encoder: str | Path | EncoderSpec = "sa1-ra1-lif",
    settings: Settings | None = None,
    *,
    split: Splits = Splits(),
    where: Conditions | None = None,
    leave_out: LeftOut = None,
    compare: bool = False,
    rest_ms: float = firing.REST_MS,
    out: str | Path | None = None,
    figure: str | Path | None = None,
    survives: str | Path | None = None,
    force: bool = False,
    tell: Tell = silent,
) -> EncoderSpec:
    """An encoder with gains for a sensor, from the training trials of a split: `neurotact calibrate`.

    recordings: in memory, or the path of a file of them.
    settings: changes of the encoder, dotted keys. A baseline that knows the whole trial gives way to one that knows the
        past alone, and a moving average is chosen, unless `settings` name `conditioning.baseline` and
        `conditioning.ema_cutoff_Hz`. Afferents of a sensor that is slower than the clock are computed once per sample,
        in closed form, unless the spec or `settings` set `integration`.
    split: how trials are divided, as for `train`; the gains know nothing of its validation and test trials.
    where, leave_out: the trials that are divided, as of `read`.
    compare: try every baseline and polarity, and use the best that knows the past alone.
    rest_ms: length of the rest at the start of each trial; afferents that fire in it are named in a line.
    out, figure: files for the encoder (.toml) and for a drawing of how its gains were chosen (.png, .svg, .pdf); one
        that exists is refused unless `force`. survives: a file for a drawing of what of the training trials survives
        the fitted encoder (`what_survives`), which is also told in a line. tell: called with what the command prints.
    Raises InputError for less than two classes, for constant signals, and as `train` does for the split.

    >>> encoder = nt.calibrate("touch.h5", settings={"conditioning.baseline": "start"})
    >>> encoder.sa1.gain > 0, len(encoder.conditioning.scale)
    (True, 2)
    """
    began = perf_counter()
    _check_outputs([Path(file) for file in (out, figure, survives) if file], force, _paths(recordings, encoder))
    split.check_single("calibrate")
    start, given = specs.resolve(encoder, settings), specs.set_keys(encoder, settings)
    rule = gain_search.CalibrationRule(every=bool(figure))
    apart, group = tuple(split.test_where), tuple(split.one.group)
    fit, times = calibration.calibration_for(start, settings or {}, apart=apart, group=group)
    if compare:
        spec.refuse(settings or {}, alternatives.COMPARED)
    n_steps = alternatives.n_steps(rule) if compare else times * rule.candidates
    with _opened(recordings) as (stored, is_file), _tracked("calibrate", n_steps if is_file else 0) as advance:
        source = stored.source or "recordings"
        data = chosen_trials(stored, TrialChoice.of(where, leave_out), source)
        check_stratify(data.conditions, split.stratify, split.one)
        training = data.select(training_touches(data, split.stratify, split.one))
        start, notes = calibration.with_integration(start, given, training.sampling_rate_Hz)
        for note in notes:
            log.warning("%s: %s", source, note)
        compared = alternatives.compare(training, start, advance, rule, apart, group) if compare else None
        calibrated = fit(training, start, advance, rule) if compared is None else compared.best
        at_rest = firing.resting_table(training, calibrated.encoder, rest_ms)
        left = tools.what_survives(training, calibrated.encoder) if survives else None
    trials = f"{number_of(len(training), 'training trial')}"
    if out:
        about = f"{trials} (split seed {split.seed}) of {Path(source).name}"
        origin = encoder if isinstance(encoder, (str, Path)) else "an encoder"
        saved = spec.to_toml(calibrated.encoder.model_dump(mode="json", exclude_none=True))
        files.write_text(out, f"# Calibrated from {origin} on the {about}.\n{saved}")
    if figure:
        thresholds = [
            sensitivity.name for sensitivity in sensitivities_of(calibrated.encoder) if sensitivity.is_threshold
        ]
        style.save(
            calibration_figure.draw_calibration(
                calibrated.table, calibrated.isi, _units(calibrated.encoder), thresholds
            ),
            figure,
        )
    if compared is not None:
        tell(compared.table[COMPARED])
    gains = ", ".join(
        f"{sensitivity.key} = {value_of(calibrated.encoder, sensitivity):g}"
        for sensitivity in sensitivities_of(calibrated.encoder)
    )
    tell(f"{out or 'encoder'}: {gains}, from {trials} in {perf_counter() - began:.1f} s")
    if survives and left is not None:
        style.save(tools.plot_survival(left), survives)
        tell(f"{survives}: {left}")
    if complaint := firing.complaint_at_rest(at_rest, rest_ms, calibrated.encoder.conditioning.baseline):
        log.warning("%s: %s", source, complaint)
    return calibrated.encoder


def plot_raster(
    spikes: SpikeTrains,
    trial: int | None = None,
    recordings: Recordings | None = None,
    *,
    start_s: float | None = None,
    stop_s: float | None = None,
) -> "raster.Figure":
    """The spikes of one trial as a matplotlib figure, under the signals of `recordings` where they are given.

    trial: the first if None. start_s, stop_s: the part that is drawn; the whole trial if None.
    Raises InputError for a trial that does not exist, and for recordings that do not hold it.

    >>> figure = nt.plot_raster(nt.load_spikes("spikes.h5"), trial=0, recordings=nt.load_recordings("touch.h5"))
    >>> len(figure.axes)
    2
    """
    check_instance("spikes", spikes, SpikeTrains, "nt.encode returns them")
    trial, signal = trial or 0, None
    if recordings is not None:
        rows = recorded_trials(recordings, spikes, np.array([raster.existing_trial(spikes, trial)]))
        if rows is None:
            raise InputError(f"recordings: do not hold trial {trial} of the spikes; give those that were encoded")
        signal = (recordings.signals[rows[0]], recordings.sampling_rate_Hz, recordings.unit)
    return raster.draw_raster(spikes, trial, signal, start_s or 0.0, stop_s)


def save_raster(
    spikes: str | Path,
    out: str | Path,
    *,
    trial: int | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    recordings: str | Path | None = None,
    force: bool = False,
    tell: Tell = silent,
) -> None:
    """Draw a trial of a file of spikes (.png, .svg, .pdf), or write the spikes of all (.csv, .nwb): `neurotact raster`.

    trial: the one that is drawn, 0 if None. start_s, stop_s: the part that is drawn; the whole trial if None.
    recordings: the file that was encoded, where it moved since; without one the signal is left out, which is logged.
    force: replace a file. tell: called with the line that `neurotact raster` prints.
    Raises InputError for a file that exists, another suffix, and a trial that does not exist.

    >>> nt.save_raster("spikes.h5", "spikes.csv")
    >>> Path("spikes.csv").read_text().splitlines()[0]
    'trial,afferent,type,time_s'
    """
    out = Path(out)
    kind = "events" if out.suffix in (".csv", ".nwb") else "picture"
    effects.check(file=kind, trial=trial, start_s=start_s, stop_s=stop_s, recordings=recordings)
    files.check_new(out, force=force, inputs=[spikes, recordings])
    trains = hdf5.load_spikes(spikes)
    files.check_new(out, force=force, inputs=[trains.source or None])
    trial = trial or 0
    if trial >= len(trains):
        raise InputError(f"`trial={trial}`: {spikes} holds trials 0 to {len(trains) - 1}; choose one of them")
    if out.suffix == ".csv":
        raster.write_events(trains, out)
    elif out.suffix == ".nwb":
        tools.to_nwb(trains, out, force=force)
    else:
        signal = _signal_of(trains, trial, recordings, spikes)
        raster.write_raster(trains, trial, out, signal=signal, start_s=start_s or 0.0, stop_s=stop_s)
    held = held_line(trains)
    tell(f"{out}: {held}" if held else str(out))


def _units(encoder: EncoderSpec) -> dict[str, str]:
    """What is searched of each population and its unit, for a drawing."""
    known = encoder.gain_units if isinstance(encoder, DrivenSpec) else {}
    return {
        sensitivity.name: known.get(sensitivity.name, sensitivity.unit) for sensitivity in sensitivities_of(encoder)
    }


@contextmanager
def _opened(recordings: Recordings | str | Path) -> Iterator[tuple[Trials, bool]]:
    """Recordings, and whether they are in a file."""
    if isinstance(recordings, (str, Path)):
        with hdf5.open_recordings(recordings) as stored:
            yield stored, True
    else:
        check_instance("recordings", recordings, Recordings, RETURNED)
        yield recordings, False


def _tracked(what: str, total: int) -> AbstractContextManager[Advance]:
    """`track`, unless there is nothing to show."""
    return track(what, total) if total else nullcontext(silently)


def _paths(*inputs: object) -> list[str | Path]:
    return [source for source in inputs if isinstance(source, (str, Path))]


def _check_outputs(outputs: list[Path], force: bool, inputs: list[str | Path]) -> None:
    """Refuse outputs that exist or are inputs, and two outputs that are one file."""
    for out in outputs:
        files.check_new(out, force=force, inputs=inputs)
    if len({out.resolve() for out in outputs}) < len(outputs):
        raise InputError(f"{outputs[-1]}: is the path of two outputs of this command; give each its own file")


def _signal_of(
    trains: SpikeTrains, trial: int, given: str | Path | None, spikes: str | Path
) -> tuple[np.ndarray, float, str] | None:
    """The recorded signal of one trial, its sampling rate and unit; None if the recordings are not available."""
    try:
        path, (recorded,) = encoded_from.find(spikes, trains, np.array([trial]), given)
    except encoded_from.AbsentError as error:
        log.warning("the signal is left out: %s", error)
        return None
    with encoded_from.opened(path, trains) as data:
        n_samples = int(data.lengths[recorded])
        files.check_size(f"{path}, trial {recorded}", 4 * n_samples * data.n_channels)
        return data.piece(int(recorded), 0, n_samples), data.sampling_rate_Hz, data.unit
