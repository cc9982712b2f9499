"""The command line: it parses, calls and prints."""

import logging
import shlex
import sys
import warnings
from collections.abc import Callable
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import torch
import typer
from rich.console import Console
from rich.table import Table

from neurotact import __version__, files, spec
from neurotact.data import hdf5
from neurotact.data.conditioning import ACAUSAL, acausal_note
from neurotact.data.readers import braille_letters, fabricslide, folder, pvdf_hardness, touch_modality
from neurotact.data.recordings import Recordings
from neurotact.data.simulate.experiments import EXPERIMENTS, Experiment
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import SplitSpec
from neurotact.encoders import specs as encoders
from neurotact.encoders.afferents import AfferentSpec
from neurotact.errors import InputError, nearest
from neurotact.export import raster as rasters
from neurotact.export.calibration_figure import draw_calibration
from neurotact.export.style import save as save_figure
from neurotact.export.tables import sops_summary, write_table
from neurotact.metrics import synops
from neurotact.networks import tuning
from neurotact.networks.specs import RSNNSpec
from neurotact.progress import counting, say, track
from neurotact.studies import (
    calibration,
    comparison,
    firing,
    kinds,
    ledger,
    preparation,
    runner,
    search,
    train_run,
    trained,
)
from neurotact.studies.encoding import encode_file
from neurotact.studies.trained import Task

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
simulate_app = typer.Typer(help="Simulate an experiment.")
import_app = typer.Typer(help="Read recordings as they were published into one HDF5 file.")
study_app = typer.Typer(help="Run, resume and report studies.")
app.add_typer(simulate_app, name="simulate")
app.add_typer(import_app, name="import")
app.add_typer(study_app, name="study")
console = Console(soft_wrap=True, highlight=False)
INTERRUPTED = 130
MOST_SEEDS = 2**63 - 2
"""Of a training, which draws its order from the next seed."""
MOST_SPLITS = 2**32 - 2
"""Of a split, in the same way; scikit-learn takes 32 bits."""
MOST_WORKERS = 1024
IMPORTED = (".csv", ".npz", ".lvm")
"""Files of recordings as they were published."""
SHOWN = ["label", "windows", "accuracy", "steps", "input_spikes", "hidden_spikes", "sops_total"]
"""What of a SOP summary fits a terminal; the files hold all of it."""
SIDES = {
    synops.TRAINING: "training windows: seen in training, so that their accuracy is not that of new touches",
    synops.VALIDATION: "validation windows: they chose the epoch and the patience",
    synops.TEST: "test windows",
    synops.UNSEEN: "unseen windows: of trials on no side of the split",
    synops.UNKNOWN: "windows of which it cannot be told whether they were seen in training",
}

SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the spec; may be repeated.")
]
OutFile = Annotated[Path, typer.Option("-o", "--out", dir_okay=False, help="The file to write.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it already exists.")]
OutFolder = Annotated[Path, typer.Option("-o", "--out", help="The folder to write.")]
EncoderOption = Annotated[str, typer.Option(help="Name or path of an encoder spec.")]
DeviceOption = Annotated[str, typer.Option(help="A torch device: cpu, cuda, cuda:1, mps.")]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        max=MOST_WORKERS,
        show_default="2",
        help="Processes; the results are the same for any number.",
    ),
]
SchedulerOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler, tcp://host:8786: its workers do the work.")
]
Seed = Annotated[
    int, typer.Option(min=0, max=MOST_SEEDS, help="Random seed of the weights and of the order of windows.")
]
WindowMs = Annotated[float, typer.Option("--window-ms", help="Length of the window that is classified.")]
StartMs = Annotated[float, typer.Option("--start-ms", help="Skipped at the beginning of each trial.")]
HopMs = Annotated[float | None, typer.Option("--hop-ms", help="Between windows; their length when absent.")]
PerTrial = Annotated[int | None, typer.Option("--per-trial", help="At most so many windows a trial.")]
Stratify = Annotated[list[str] | None, typer.Option(help="A condition to balance in the split.")]
SplitSeed = Annotated[
    int, typer.Option(min=0, max=MOST_SPLITS, help="Of the split into training, validation and test.")
]
Tolerance = Annotated[float, typer.Option(help="Validation accuracy that early exit may lose.")]
OtherEncoder = Annotated[
    bool, typer.Option("--allow-other-encoder", help="Take spikes that are encoded otherwise than in training.")
]


def main() -> None:
    """Run the command line; exit code 0, 2 for what the user got wrong, 1 for a fault of neurotact."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[_Said()])
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal may know no µ
    warnings.showwarning = lambda message, *_: say(message)
    try:
        for word in sys.argv[1:]:
            files.check_text(word)
        code = app(sys.argv[1:] or ["--help"], prog_name="neurotact", standalone_mode=False)
    except InputError as error:
        say(error)
        sys.exit(2)
    except typer.TyperException as error:
        say(f"{error.format_message().rstrip('.')}; see {_command_of(error)} --help")
        sys.exit(2)
    if code == INTERRUPTED:  # Typer makes this of Ctrl-C
        say("interrupted")
    sys.exit(code or 0)


class _Said(logging.Handler):
    """What neurotact logs, said like its errors."""

    def emit(self, record: logging.LogRecord) -> None:
        say(self.format(record))


def _command_of(error: typer.TyperException) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context else "neurotact"


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Spiking touch: taxel signals to mechanoreceptor spikes to a decision, and what each saving costs."""
    if version:
        print(__version__)
        raise typer.Exit


@app.command("list")
def list_specs() -> None:
    """List the specs that ship: encoders, networks, search spaces, studies."""
    for kind in spec.KINDS:
        table = Table("name", "about", title=kind, title_justify="left", box=None)
        for path in spec.shipped(kind):
            table.add_row(path.stem, path.read_text(encoding="utf-8").splitlines()[0].lstrip("# "))
        console.print(table)


@app.command()
def show(name: Annotated[str, typer.Argument(help="Name or path of a spec.")]) -> None:
    """Print a spec, with the comments that give its sources."""
    print(_find_any(name).read_text(encoding="utf-8"), end="")


@app.command()
def copy(
    name: Annotated[str, typer.Argument(help="Name of a spec.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="The file; NAME.toml here when absent.")] = None,
    force: Force = False,
) -> None:
    """Copy a spec here, to be edited and given by its path."""
    source = _find_any(name)
    target = out or Path(source.name)
    files.check_new(target, force=force, inputs=[source])
    files.write_text(target, source.read_text(encoding="utf-8"))
    print(target)


def _simulator(name: str, experiment: Experiment) -> Callable[[Path, list[str] | None, bool], None]:
    """The command that simulates an experiment; a change within a nested table keeps the rest of it."""

    def command(out: OutFile, set_: SetOption = None, force: Force = False) -> None:
        files.check_new(out, force=force)
        table = spec.override(experiment.model().model_dump(mode="json"), spec.parse_assignments(set_ or []))
        what: Any = spec.build(experiment.model, table, source=f"simulate {name}")
        with track("simulate", what.n_trials) as advance:
            recordings = experiment.simulate(what, counting(advance))
        _save_recordings(recordings, out)

    return command


for _name, _experiment in EXPERIMENTS.items():
    simulate_app.command(_name, help=_experiment.about)(_simulator(_name, _experiment))


def _check_import(source: Path, out: Path, force: bool) -> None:
    files.check_new(out, force=force, inputs=[p for p in files.below(source) if p.suffix.lower() in IMPORTED])


@import_app.command("fabricslide")
def import_fabricslide(source: Path, out: OutFile, force: Force = False) -> None:
    """FabricSlide: 7 fabrics under a 16-taxel finger (Wang et al. 2022), a folder of CSV files."""
    _check_import(source, out, force)
    _save_recordings(fabricslide.read(source), out)


@import_app.command("pvdf-hardness")
def import_pvdf_hardness(source: Path, out: OutFile, force: Force = False) -> None:
    """A P(VDF-TrFE) patch pressed on five cubes: the published .lvm folders, or a folder of cube*.npz."""
    _check_import(source, out, force)
    _save_recordings(pvdf_hardness.read(source), out)


@import_app.command("touch-modality")
def import_touch_modality(source: Path, out: OutFile, force: Force = False) -> None:
    """Sliding, brushing and rolling on a 4 x 4 array (Mendeley Data dmcdp33ctt): three folders of .lvm files."""
    _check_import(source, out, force)
    _save_recordings(touch_modality.read(source), out)


@import_app.command("braille-letters")
def import_braille_letters(
    source: Path,
    out: OutFile,
    step_ms: Annotated[float, typer.Option("--step-ms", help="The clock on which events become spikes.")] = 5.0,
    force: Force = False,
) -> None:
    """27 Braille letters under an event-based fingertip (Zenodo 6556273): the published file, to spikes."""
    files.check_new(out, force=force, inputs=[source])
    trains = braille_letters.read(source, step_ms)
    hdf5.save_spikes(trains, out)
    print(
        f"{out}: {len(trains)} trials of {len(trains.classes)} classes, {sum(map(len, trains.steps))} spikes of "
        f"{len(trains.afferents)} afferents, {trains.trial_steps[0]} steps at {trains.sampling_rate_Hz:g} Hz"
    )


@import_app.command("folder")
def import_folder(
    source: Path,
    out: OutFile,
    sampling_rate_hz: Annotated[float, typer.Option("--sampling-rate-Hz", help="Samples a second.")],
    unit: Annotated[str, typer.Option(help="Unit of the signals, such as mV, V or count.")],
    force: Force = False,
) -> None:
    """Any recordings: a sub-folder a class, holding CSV or NPZ files, a row a sample and a column a taxel."""
    _check_import(source, out, force)
    _save_recordings(folder.read(source, sampling_rate_hz, unit), out)


@app.command()
def calibrate(
    recordings: Path,
    out: OutFile,
    encoder: EncoderOption = "sa1-ra1-lif",
    set_: SetOption = None,
    split_seed: Annotated[
        int, typer.Option(min=0, max=MOST_SPLITS, help="Of the split; only its training trials are looked at.")
    ] = 0,
    stratify: Stratify = None,
    figure: Annotated[Path | None, typer.Option(help="Also draw how the gains were chosen (.png, .svg, .pdf).")] = None,
    force: Force = False,
) -> None:
    """Find an encoder's gains for a sensor, from its training trials; no classifier is looked at.

    A baseline that knows the whole trial gives way to one that knows the past alone, unless it is given with --set.
    """
    _check_outputs([out, figure], force, [recordings, encoder])
    rule, changes = calibration.CalibrationRule(), spec.parse_assignments(set_ or [])
    start = spec.load(AfferentSpec, encoder, changes)
    chooses = start.conditioning.baseline in ACAUSAL and "conditioning.baseline" not in changes
    fit, times = (calibration.calibrate_causally, len(calibration.PAST)) if chooses else (calibration.calibrate, 1)
    with hdf5.open_recordings(recordings) as data, track("calibrate", times * rule.candidates) as advance:
        split = preparation.split_conditions(data.conditions, stratify or (), SplitSpec(seed=split_seed))
        found = fit(data.select(split.train), start, advance, rule)
    trials = f"{len(split.train)} training trials (split seed {split_seed}) of {recordings.name}"
    comment = f"# Calibrated from {encoder} on the {trials}.\n"
    files.write_text(out, comment + spec.to_toml(found.encoder.model_dump(mode="json", exclude_none=True)))
    if figure:
        save_figure(draw_calibration(found.table, found.isi), figure)
    print(f"{out}: sa1.gain = {found.encoder.sa1.gain:g}, ra1.gain = {found.encoder.ra1.gain:g}")


@app.command()
def encode(
    recordings: Path,
    out: OutFile,
    encoder: EncoderOption = "sa1-ra1-lif",
    set_: SetOption = None,
    force: Force = False,
) -> None:
    """Turn whole trials into the spikes of SA-I and RA-I afferents."""
    files.check_new(out, force=force, inputs=[recordings, encoder])
    what = encoders.load(encoder, spec.parse_assignments(set_ or []))
    with hdf5.open_recordings(recordings) as data, track("encode", len(data)) as advance:
        found = encode_file(data, what, out, lambda n: advance(n, ""))
    for complaint in firing.complaints(found.fired, found.steps, found.clock_Hz, what):
        say(complaint)
    print(
        f"{out}: {found.trials} trials, {found.fired.sum()} spikes of {len(found.fired)} afferents "
        f"in {found.steps / found.clock_Hz:.1f} s"
    )
    _print_line(acausal_note(what.model_dump(mode="json")))


@app.command()
def raster(
    spikes: Path,
    out: OutFile,
    trial: Annotated[int, typer.Option(min=0, help="Which trial to draw.")] = 0,
    start_s: Annotated[float, typer.Option("--start-s", min=0, help="Beginning of the stretch.")] = 0.0,
    stop_s: Annotated[float | None, typer.Option("--stop-s", help="Its end; the trial's end when absent.")] = None,
    recordings: Annotated[Path | None, typer.Option(help="The recordings, when they moved since encoding.")] = None,
    force: Force = False,
) -> None:
    """Draw a trial's spikes with the signal above (.png, .svg, .pdf), or write all events (.csv)."""
    files.check_new(out, force=force, inputs=[spikes, recordings])
    trains = hdf5.load_spikes(spikes)
    files.check_new(out, force=force, inputs=[trains.source or None])
    if trial >= len(trains):
        raise InputError(f"--trial {trial}: {spikes} holds trials 0 to {len(trains) - 1}; choose one of them")
    if out.suffix == ".csv":
        rasters.write_events(trains, out)
    else:
        signal = _signal_of(trains, trial, recordings, spikes)
        rasters.write_raster(trains, trial, out, signal=signal, start_s=start_s, stop_s=stop_s)
    print(out)


@app.command("train")
def train_command(
    spikes: Path,
    out: OutFolder,
    network: Annotated[str, typer.Option(help="Name or path of a network spec.")] = "default",
    set_: SetOption = None,
    window_ms: WindowMs = 150.0,
    start_ms: StartMs = 0.0,
    hop_ms: HopMs = None,
    per_trial: PerTrial = None,
    stratify: Stratify = None,
    split_seed: SplitSeed = 0,
    tolerance: Tolerance = 0.01,
    seed: Seed = 0,
    device: DeviceOption = "cpu",
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted training; begin where there is none.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a training that is in the folder.")] = False,
) -> None:
    """Train a network on windows of spike trains; the best on validation is kept.

    What is interrupted goes on with the same command and --resume, and leaves the same files.
    """
    what = spec.load(RSNNSpec, network, spec.parse_assignments(set_ or []))
    window = {"length_ms": window_ms, "start_ms": start_ms, "hop_ms": hop_ms, "per_trial": per_trial}
    task = _task("train", window, split_seed, stratify, tolerance)
    try:
        done = train_run.run(
            spikes, out, what, task, seed=seed, device=_device(device), force=force, resume=resume, tell=print
        )
    except train_run.Interrupted as interrupted:
        say(_how_to_go_on(interrupted.epochs))
        sys.exit(INTERRUPTED)
    if done is None:
        print(f"{out}: this training is done already; its result is in {out / train_run.RESULT}")
    else:
        _print_row(f"{out}: test of {done.n_test} windows", done.row)
        for line in (*comparison.lines(done.compared, done.row["sops_total"]), done.acausal):
            _print_line(line)
        for complaint in comparison.complaints(done.compared):
            say(complaint)


def _how_to_go_on(epochs: int) -> str:
    """What an interrupted training says, with the command that goes on."""
    if epochs == 0:
        return "interrupted before the first epoch was over; nothing is saved"
    words = [word for word in sys.argv[1:] if word not in ("--force", "--resume")]
    return f"interrupted after epoch {epochs}; go on with: {shlex.join(['neurotact', *words, '--resume'])}"


@app.command()
def tune(
    spikes: Path,
    out: OutFolder,
    space: Annotated[str, typer.Option(help="Name or path of a search space, in NNI's terms.")] = "texture",
    network: Annotated[str, typer.Option(help="Name or path of the network spec that the space changes.")] = "default",
    set_: SetOption = None,
    trials: Annotated[int, typer.Option(min=1, help="Networks to train.")] = 100,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Random seed of the search.")] = 0,
    objective: Annotated[
        str, typer.Option(help="accuracy, or accuracy-sops with the Pareto front of both.")
    ] = "accuracy",
    sops_weight: Annotated[
        float, typer.Option("--sops-weight", min=0, help="w in accuracy - w log10(SOPs), the objective accuracy-sops.")
    ] = 0.1,
    tuner: Annotated[str, typer.Option(help="tpe, random or grid.")] = "tpe",
    batch: Annotated[int, typer.Option(min=1, help="Trials proposed at once; proposals depend on it.")] = 8,
    assessor: Annotated[str, typer.Option(help="median-stop ends hopeless trials early; or none.")] = "median-stop",
    start_epoch: Annotated[int, typer.Option("--start-epoch", min=1, help="After it, a trial may be stopped.")] = 10,
    window_ms: WindowMs = 150.0,
    start_ms: StartMs = 0.0,
    hop_ms: HopMs = None,
    per_trial: PerTrial = None,
    stratify: Stratify = None,
    split_seed: SplitSeed = 0,
    tolerance: Tolerance = 0.01,
    workers: Annotated[
        int, typer.Option(min=1, max=MOST_WORKERS, help="Processes; the journal is the same for any number.")
    ] = 2,
) -> None:
    """Search a network's hyperparameters on validation windows; given the same folder again, it goes on there."""
    settings = {
        "space": tuning.load_space(space),
        "tuner": tuner,
        "trials": trials,
        "batch": batch,
        "seed": seed,
        "objective": objective,
        "sops_weight": sops_weight,
        "assessor": assessor,
        "start_epoch": start_epoch,
    }
    window = {"length_ms": window_ms, "start_ms": start_ms, "hop_ms": hop_ms, "per_trial": per_trial}
    problem = search.problem_of(
        hdf5.load_spikes(spikes),
        spec.build(tuning.SearchSpec, settings, source=f"tune --space {space}"),
        spec.load(RSNNSpec, network, spec.parse_assignments(set_ or [])),
        _task("tune", window, split_seed, stratify, tolerance),
    )
    with files.locked(out):
        try:
            with search.processes(spikes, workers) as run, track("tune", trials) as advance:
                found, timing = search.search(problem, out, run, advance)
        except KeyboardInterrupt:
            say(f"interrupted; the same command goes on in {out}")
            sys.exit(INTERRUPTED)
        search.write_tables(problem, out, found)
        search.draw(problem, found, out / "search.png")
        torch.set_num_threads(1)  # as in the search, so that its best network comes out again to the last bit
        result = search.save_best(problem, spikes, out, found)
    best = search.best_of(found)
    _print_row(f"{out}: trial {best.id} of {len(found)} is the best; its test", result["row"])
    print(f"{out / 'best.toml'}: proposals took {timing.proposals:.1f} s of {timing.seconds:.1f} s")


@app.command()
def infer(
    run: Path,
    spikes: Path,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write each window's decision (.csv, .json, .md).")
    ] = None,
    early_exit: Annotated[
        bool, typer.Option("--early-exit", help="Stop where the validated patience says so.")
    ] = False,
    allow_other_encoder: OtherEncoder = False,
    device: DeviceOption = "cpu",
    force: Force = False,
) -> None:
    """Classify every window of spike trains with a trained network, and count what it cost.

    Windows of training, validation, test and unseen trials are summarised apart; trials are known by their content.
    """
    if out:
        files.check_new(out, force=force, inputs=[*_network_files(run), spikes])
    restored = trained.restore(run, device=_device(device))
    trains = hdf5.load_spikes(spikes)
    table = trained.infer(restored, trains, early_exit=early_exit, allow_other_encoder=allow_other_encoder)
    if out:
        write_table(table, out)
    _print_sides(synops.summary(table))
    _print_line(acausal_note(trains.encoder))


@app.command()
def sops(
    run: Path,
    out: OutFile,
    spikes: Annotated[Path | None, typer.Option(help="The spikes, when they moved since training.")] = None,
    early_exit: Annotated[bool, typer.Option("--early-exit", help="With early exit.")] = False,
    allow_other_encoder: OtherEncoder = False,
    force: Force = False,
) -> None:
    """Write the synaptic operations of each test window of a trained network (.csv, .json, .md)."""
    files.check_new(out, force=force, inputs=[*_network_files(run), spikes])
    restored = trained.restore(run)
    restored = restored._replace(spikes_path=spikes or restored.spikes_path)
    files.check_new(out, force=force, inputs=[restored.spikes_path])
    trains = trained.load_spikes_of(restored)
    table = trained.infer(
        restored, trains, early_exit=early_exit, test_only=True, allow_other_encoder=allow_other_encoder
    )
    summary = synops.summary(table)
    what = f"{run.resolve().name}, {'early exit' if early_exit else 'full window'}"
    write_table(table, out, about=sops_summary(summary, what))
    _print_sides(summary)
    _print_line(acausal_note(trains.encoder))
    network = restored.network
    sizes = len(trains.afferents), network.n_classes
    costs = ledger.decision_ledger(network.spec, *sizes, trains.sampling_rate_Hz, summary, encoder=trains.encoder)
    _print_table(costs[["name", "macs", "acs", "parameters", "signal_ms", "energy_estimate_nJ"]])


@study_app.command("run")
def study_run(
    name: Annotated[str, typer.Argument(help="Name or path of a study spec.")],
    out: OutFolder,
    quick: Annotated[bool, typer.Option("--quick", help="A smaller sweep of the same kind.")] = False,
    set_: SetOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Run a study: every cell of its sweep, the tables, the figures, the report."""
    _run_study(kinds.resolve(name, spec.parse_assignments(set_ or []), quick=quick), out, workers, scheduler)


@study_app.command("resume")
def study_resume(folder: Path, workers: WorkersOption = None, scheduler: SchedulerOption = None) -> None:
    """Go on with a study that was interrupted."""
    _run_study(runner.load(folder), folder, workers, scheduler)


@study_app.command("report")
def study_report(folder: Path) -> None:
    """Write the tables, figures and report again from the cells that are done."""
    print(runner.report(folder))


def _run_study(what: kinds.Study, out: Path, workers: int | None, scheduler: str | None) -> None:
    if workers and scheduler:
        raise InputError("--workers, --scheduler: give one of them; a cluster has the workers that have joined it")
    try:
        print(runner.run(what, out, workers or 2, scheduler))
    except KeyboardInterrupt:
        say(f"interrupted; go on with: neurotact study resume {out}")
        sys.exit(INTERRUPTED)


def _find_any(name: str) -> Path:
    """A spec of any kind; a name that stands in several kinds is refused."""
    if name.endswith(".toml") or "/" in name:
        return files.existing(name)
    known = [path for kind in spec.KINDS for path in spec.shipped(kind)]
    found = [path for path in known if path.stem == name]
    if not found:
        raise InputError(f"{name}: there is no such spec; {nearest(name, [path.stem for path in known])}")
    return found[0]


def _task(command: str, window: dict[str, Any], split_seed: int, stratify: list[str] | None, tolerance: float) -> Task:
    """The task that the options of a command describe."""
    split = {"seed": split_seed}
    table = {"window": window, "split": split, "stratify": stratify or [], "exit_tolerance": tolerance}
    return spec.build(Task, table, source=command)


def _check_outputs(outputs: list[Path | None], force: bool, inputs: list[str | Path]) -> None:
    """Refuse outputs that exist or are inputs, and two outputs that are one file."""
    given = [out for out in outputs if out]
    for out in given:
        files.check_new(out, force=force, inputs=inputs)
    places = [out.resolve() for out in given]
    if len(set(places)) < len(places):
        raise InputError(f"{given[-1]}: is the place of two outputs of this command; give each its own file")


def _network_files(run: Path) -> list[Path]:
    return [path for path in run.glob("*") if path.is_file() and path.suffix in (".json", ".safetensors")]


def _save_recordings(recordings: Recordings, out: Path) -> None:
    hdf5.save_recordings(recordings, out)
    seconds = recordings.lengths.sum() / recordings.sampling_rate_Hz
    print(
        f"{out}: {len(recordings)} trials of {len(recordings.classes)} classes, {recordings.n_channels} taxels, "
        f"{seconds:.1f} s at {recordings.sampling_rate_Hz:g} Hz, in {recordings.unit}"
    )


def _signal_of(
    trains: SpikeTrains, trial: int, given: Path | None, spikes: Path
) -> tuple[np.ndarray, float, str] | None:
    """The recorded signal of one trial, its sampling rate and unit; None where the recordings are not at hand."""
    path = given or Path(trains.source or ".")
    if not (given or path.is_file()):
        say(f"the signal is left out: {trains.source or 'its recordings'} is not there; name it with --recordings")
        return None
    with hdf5.open_recordings(path) as data:
        if len(data) != len(trains):
            raise InputError(
                f"{data.source}: holds {len(data)} trials but {spikes} {len(trains)}; "
                "name the recordings that were encoded with --recordings"
            )
        n_samples = int(data.lengths[trial])
        files.check_size(f"{path}, trial {trial}", 4 * n_samples * data.n_channels)
        return data.piece(trial, 0, n_samples), data.sampling_rate_Hz, data.unit


def _device(name: str) -> str:
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        raise InputError(
            f"--device {name}: torch cannot use it here ({str(error).splitlines()[0]}); try cpu"
        ) from error
    return name


def _print_row(title: str, row: dict[str, Any]) -> None:
    table = Table(title=title, title_justify="left", show_header=False, box=None)
    for key, value in row.items():
        table.add_row(key, _shown(value))
    console.print(table)


def _print_line(line: str | None) -> None:
    if line:
        print(line)


def _print_sides(summary: pd.DataFrame) -> None:
    """A SOP summary, a table a side."""
    for side, rows in summary.groupby(synops.SIDE, sort=False):
        _print_table(rows[SHOWN], title=SIDES[str(side)])


def _print_table(frame: pd.DataFrame, title: str | None = None) -> None:
    table = Table(*map(str, frame.columns), title=title, title_justify="left", box=None)
    for row in frame.itertuples(index=False):
        table.add_row(*map(_shown, row))
    console.print(table)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)
