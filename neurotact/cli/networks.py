"""The commands that train a network, search one, and measure it: train, tune, infer, sops."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import pandas as pd
import torch
import typer

from neurotact import effects, files, spec
from neurotact.cli.options import (
    Align,
    DeviceOption,
    ExitBy,
    Fold,
    FoldOrAll,
    Folds,
    FoldsInTurn,
    Force,
    Group,
    HopMs,
    Json,
    LeaveOut,
    MovedSpikes,
    OnsetDeviations,
    Order,
    OtherEncoder,
    OutFile,
    OutFolder,
    PerTrial,
    PopulationDevice,
    RestMs,
    RunFolder,
    Seed,
    SetOption,
    Spikes,
    SplitSeed,
    StartMs,
    Stratify,
    TestWhere,
    Tolerance,
    Where,
    WindowMs,
    WorkersOption,
    choice_of,
    choice_table,
    split_table,
    window_table,
)
from neurotact.cli.outcome import print_json, print_outcome
from neurotact.cli.output import print_line, print_table
from neurotact.cli.words import say
from neurotact.data import hdf5
from neurotact.data.conditioning import acausal_note
from neurotact.data.copies import copies_of
from neurotact.data.trial_choice import chosen_trials
from neurotact.data.window_choice import ARGUMENTS
from neurotact.errors import INTERRUPTED
from neurotact.figures.search import save_found
from neurotact.metrics import synops
from neurotact.networks.definition.specs import RSNNSpec, given_keys
from neurotact.networks.search import journal, search
from neurotact.networks.training import cautions, population, repeated, tasks, train_run, trained
from neurotact.networks.use import inference, ledger
from neurotact.progress import track
from neurotact.tables import to_json, write_table

SHOWN = ["label", "windows", "accuracy", "steps", "input_spikes", "hidden_spikes", "sops_total"]
"""The columns of a SOP summary that fit a terminal; the files hold all of them."""
SIDES = {
    synops.TRAINING: "training windows: seen in training, so their accuracy does not hold for new touches",
    synops.VALIDATION: "validation windows: used to choose the epoch and the exit rule",
    synops.TEST: "test windows",
    synops.UNSEEN: "unseen windows: of trials outside the split",
    synops.UNKNOWN: "windows that may have been seen in training: the network was saved without the list of its trials",
}


def train_command(
    spikes: Spikes,
    out: OutFolder,
    network: Annotated[str, typer.Option(help="Name or path of a network spec.")] = "default",
    settings: SetOption = None,
    length_ms: WindowMs = None,
    start_ms: StartMs = None,
    hop_ms: HopMs = None,
    per_trial: PerTrial = None,
    align: Align = "trial",
    rest_ms: RestMs = None,
    onset_deviations: OnsetDeviations = None,
    where: Where = None,
    leave_out: LeaveOut = None,
    test_where: TestWhere = None,
    group: Group = None,
    order: Order = None,
    folds: FoldsInTurn = None,
    fold: FoldOrAll = None,
    repeats: Annotated[
        int,
        typer.Option(
            "--repeats",
            min=1,
            max=1000,
            help="Number of random splits, one network each; seeds from --split-seed upwards.",
        ),
    ] = 1,
    stratify: Stratify = None,
    split_seed: SplitSeed = None,
    exit_tolerance: Tolerance = 0.01,
    exit_by: ExitBy = "stability",
    seed: Seed = 0,
    device: DeviceOption = "cpu",
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an interrupted training; start a new one if there is none.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a training that is in the folder.")] = False,
    as_json: Json = False,
) -> None:
    """Train a network on windows of spike trains.

    The weights of the best epoch (`training.keep`) are saved. After an interruption, the same command with --resume
    continues and writes the same files. With --folds or --repeats, one network is trained per split, each in its own
    folder, and the mean is printed.
    """
    changes = spec.parse_assignments(settings or [])
    what = spec.load(RSNNSpec, network, changes)
    window = window_table(length_ms, start_ms, hop_ms, per_trial, align, rest_ms, onset_deviations)
    split = split_table(split_seed, test_where, group, order, folds, fold)
    choice = choice_table(where, leave_out)
    task = tasks.task_of("train", window, split, stratify, exit_tolerance, exit_by, **choice)
    trains = tasks.load_spikes(spikes, task, tell=True)
    task = tasks.with_suited_window(task, trains, ARGUMENTS)
    every_fold = folds is not None and fold is None
    options = {"seed": seed, "device": _device(device), "force": force, "resume": resume}
    options["given"] = given_keys(network, changes)
    options["tell"] = lambda line: None if as_json else print(line)
    try:
        if every_fold or repeats > 1:
            each = repeated.tasks_of(task, every_fold=every_fold, repeats=repeats)
            _print_repeated(out, repeated.run(spikes, out, what, each, **options), as_json=as_json)
            for caution in cautions.copies(len(copies_of(trains).trials), len(trains)):
                say(caution)
            return
        done = train_run.run(spikes, out, what, task, **options)
    except train_run.Interrupted as interrupted:
        say(_how_to_go_on(interrupted.epochs))
        sys.exit(INTERRUPTED)
    if done is None:
        print(f"{out}: this training is done already; its result is in {out / train_run.RESULT}")
    else:
        if as_json:
            print_json(done)
        else:
            print_outcome(done)
            _print_next(out, spikes)
        for caution in done.cautions:
            say(caution)


def _print_next(run: Path, spikes: Path) -> None:
    """Print where results were saved, and what to run next."""
    where = shlex.quote(str(run))
    print(f"saved in {run}: the network, {train_run.RESULT} with all numbers, {trained.LOG}")
    print(f"next: neurotact infer {where} {shlex.quote(str(spikes))} --early-exit")
    print(f"      neurotact sops {where} -o sops.csv")


def _print_repeated(out: Path, found: repeated.Repeated, *, as_json: bool) -> None:
    if as_json:
        print(to_json(found.table))
        return
    print_table(found.table[["folder", "accuracy_validation", "accuracy_test", "baseline", "sops_total", "exit_steps"]])
    print(f"{out / repeated.TABLE}: {repeated.line(found)}")


def _how_to_go_on(epochs: int) -> str:
    """The message of an interrupted training, with the command that continues it."""
    if epochs == 0:
        return "interrupted before the first epoch was over; nothing is saved"
    words = [word for word in sys.argv[1:] if word not in ("--force", "--resume")]
    return f"interrupted after epoch {epochs}; go on with: {shlex.join(['neurotact', *words, '--resume'])}"


def tune(
    spikes: Spikes,
    out: OutFolder,
    space: Annotated[
        str | None,
        typer.Option(help="Name or path of a search space, in NNI's terms; if absent, around the network's choices."),
    ] = None,
    network: Annotated[str, typer.Option(help="Name or path of the network spec that the space changes.")] = "default",
    settings: SetOption = None,
    trials: Annotated[int, typer.Option(min=1, help="Number of networks to train.")] = 100,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Random seed of the search.")] = 0,
    objective: Annotated[
        str, typer.Option(help="accuracy, or accuracy-sops with the Pareto front of both.")
    ] = "accuracy",
    sops_weight: Annotated[
        float | None,
        typer.Option(
            "--sops-weight",
            min=0,
            show_default="0.1",
            help="w in accuracy - w log10(SOPs), which --objective accuracy-sops maximises.",
        ),
    ] = None,
    max_sops: Annotated[
        float | None,
        typer.Option("--max-sops", help="Budget of the best network: mean SOPs per window."),
    ] = None,
    tuner: Annotated[str, typer.Option(help="How trials are proposed: tpe, random or grid.")] = "tpe",
    batch: Annotated[
        int, typer.Option(min=1, help="Trials proposed together; another number gives other proposals.")
    ] = 8,
    assessor: Annotated[
        str, typer.Option(help="median-stop stops trials below the median early; none trains all to the end.")
    ] = "median-stop",
    start_epoch: Annotated[
        int | None,
        typer.Option("--start-epoch", min=1, show_default="10", help="First epoch after which a trial may be stopped."),
    ] = None,
    length_ms: WindowMs = None,
    start_ms: StartMs = None,
    hop_ms: HopMs = None,
    per_trial: PerTrial = None,
    align: Align = "trial",
    rest_ms: RestMs = None,
    onset_deviations: OnsetDeviations = None,
    where: Where = None,
    leave_out: LeaveOut = None,
    test_where: TestWhere = None,
    group: Group = None,
    order: Order = None,
    folds: Folds = None,
    fold: Fold = None,
    stratify: Stratify = None,
    split_seed: SplitSeed = None,
    exit_tolerance: Tolerance = 0.01,
    exit_by: ExitBy = "stability",
    workers: WorkersOption = None,
    device: PopulationDevice = "cpu",
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue a search of fewer trials, up to --trials; start one if there is none."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Search a network's hyperparameters on validation windows.

    The first trial is the network as given. The best has the highest value and, of equal ones, the fewest SOPs. An
    interrupted search continues when the same command is given again; with --resume it may ask for more trials.
    """
    effects.check(workers=workers, device=device)
    table = {
        "tuner": tuner,
        "trials": trials,
        "batch": batch,
        "seed": seed,
        "objective": objective,
        "sops_weight": sops_weight,
        "max_sops": max_sops,
        "assessor": assessor,
        "start_epoch": start_epoch,
    }
    window = window_table(length_ms, start_ms, hop_ms, per_trial, align, rest_ms, onset_deviations)
    split = split_table(split_seed, test_where, group, order, folds, fold)
    task = tasks.task_of("tune", window, split, stratify, exit_tolerance, exit_by, **choice_table(where, leave_out))
    trains = tasks.load_spikes(spikes, task, tell=True)
    task = tasks.with_suited_window(task, trains, ARGUMENTS)
    changes = spec.parse_assignments(settings or [])
    searched = spec.load(RSNNSpec, network, changes)
    source = "tune" if space is None else f"tune --space {space}"
    asked = search.asked(source, space, searched, table, trains, task, given_keys(network, changes))
    problem = search.problem_of(trains, asked, searched, task, device)
    with files.locked(out):
        try:
            with search.runner(problem, spikes, workers or 2, device) as run, track("tune", trials) as advance:
                found, timing = search.search(problem, out, run, advance, resume=resume)
            save_found(problem, found, out)
            outcome = search.save_best(problem, spikes, out, found, device)
        except KeyboardInterrupt:
            say(f"interrupted; the same command continues in {out}")
            sys.exit(INTERRUPTED)
    best = journal.best_of(found)
    if as_json:
        print_json(outcome)
    else:
        print(
            f"trial {best.id} of {len(found)} is the best; {timing.seconds:.1f} s, proposals {timing.proposals:.1f} s"
        )
        if problem.search.first is not None:
            print(journal.beside_given(found))
        print_outcome(outcome)
        print(f"its settings: {out / 'best.toml'}; every trial: {out / 'trials.csv'}; figure: {out / 'search.png'}")
        _print_next(out / "best", spikes)
    for caution in outcome.cautions:
        say(caution)


def infer(
    run: RunFolder,
    spikes: Spikes,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write one row per window (.csv, .json, .md).")
    ] = None,
    early_exit: Annotated[
        bool, typer.Option("--early-exit", help="Stop each window by the rule chosen on validation windows.")
    ] = False,
    where: Where = None,
    leave_out: LeaveOut = None,
    allow_other_encoder: OtherEncoder = False,
    device: DeviceOption = "cpu",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Classify every window with a trained network, and count its operations.

    Training, validation, test and unseen windows are summarised separately; trials are recognised by their content.
    """
    effects.check(force=force, out=out)
    if out:
        files.check_new(out, force=force, inputs=[*_network_files(run), spikes])
    restored = trained.restore(run, device=_device(device))
    trains = chosen_trials(hdf5.load_spikes(spikes), choice_of(where, leave_out), str(spikes))
    table = inference.infer(restored, trains, early_exit=early_exit, allow_other_encoder=allow_other_encoder)
    if out:
        write_table(table, out)
    _print_sides(synops.summary(table), as_json=as_json)
    if not as_json:
        print_line(acausal_note(trains.encoder))


def sops(
    run: RunFolder,
    out: OutFile,
    spikes: MovedSpikes = None,
    early_exit: Annotated[bool, typer.Option("--early-exit", help="Count with early exit.")] = False,
    allow_other_encoder: OtherEncoder = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write the synaptic operations of each test window (.csv, .json, .md)."""
    files.check_new(out, force=force, inputs=[*_network_files(run), spikes])
    restored = trained.restore(run, spikes=spikes)
    files.check_new(out, force=force, inputs=[restored.spikes_path])
    trains = trained.load_spikes_of(restored)
    table = inference.infer(
        restored, trains, early_exit=early_exit, test_only=True, allow_other_encoder=allow_other_encoder
    )
    summary = synops.summary(table)
    what = f"{run.resolve().name}, {'early exit' if early_exit else 'full window'}"
    write_table(table, out, about=synops.summary_markdown(summary, what))
    _print_sides(summary, as_json=as_json)
    if as_json:
        return
    print_line(acausal_note(trains.encoder))
    print(f"saved in {out}, a row per window")
    network = restored.network
    sizes = len(trains.afferents), network.n_classes
    costs = ledger.decision_ledger(network.spec, *sizes, trains.sampling_rate_Hz, summary, encoder=trains.encoder)
    print_table(costs[["name", "macs", "acs", "parameters", "signal_ms", "energy_estimate_nJ"]])


def _network_files(run: Path) -> list[Path]:
    return [
        path
        for path in files.existing(run, "folder").glob("*")
        if path.is_file() and path.suffix in (".json", ".safetensors")
    ]


def _device(name: str) -> str:
    population.device_of(name, torch.float32)
    return name


def _print_sides(summary: pd.DataFrame, *, as_json: bool) -> None:
    """A SOP summary, one table per side; as JSON, one table."""
    if as_json:
        print(to_json(summary))
        return
    for side, rows in summary.groupby(synops.SIDE, sort=False):
        print_table(rows[SHOWN], title=SIDES[str(side)])
