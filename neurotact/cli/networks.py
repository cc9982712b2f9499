"""The commands that train a network, search one, and measure it: train, tune, infer, sops."""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from neurotact.api import networks as api
from neurotact.api import tools
from neurotact.cli.options import MOST_SEEDS, REPLACED, Json, MovedSpikes, calling, flag, option
from neurotact.cli.output import print_json, print_table, show, unless
from neurotact.cli.words import say
from neurotact.errors import INTERRUPTED
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


COPIES = option(
    str | None,
    "The varied copies in the file to train on, too (see neurotact encode); none leaves them out.",
    metavar="KIND",
    show_default="those in the file",
)
ANSWERED = ["answered", "accuracy_answered"]
SHOWN = [
    "label", "windows", "accuracy", *ANSWERED, "steps", "input_spikes", "hidden_spikes", "sops_total", "outcome",
    "events", "delay_ms",
]  # fmt: skip
"""The columns of a SOP summary that fit a terminal, and errors of numbers; the files hold all of them."""
SIDES = {
    "training": "training windows: seen in training, so their accuracy does not hold for new touches",
    "validation": "validation windows: used to choose the epoch, and the exit rule if not at a left-out condition",
    "test": "test windows",
    "unseen": "unseen windows: of trials outside the split",
    "unknown": "windows that may have been seen in training: the network was saved without the list of its trials",
}


@calling(
    api.train,
    network=option(str, "Name or path of a network spec."),
    augmentation=COPIES,
    resume=flag("--resume", "Continue an interrupted training; start a new one if there is none."),
    force=REPLACED,
)
def train_command(given: dict[str, Any], as_json: Json = False) -> None:
    """Train a network on windows of spike trains.

    The weights of the best epoch (`training.keep`) are saved. After an interruption, the same command with --resume
    continues and writes the same files. With --folds, --leave-out-each or --repeats, one network is trained per split,
    each in its own folder, and the mean is printed.
    """
    try:
        row = api.train(**given, tell=unless(as_json))
    except api.resumable.Interrupted as interrupted:
        say(_how_to_go_on(given["folder"], interrupted.epochs))
        sys.exit(INTERRUPTED)
    splits = row.pop("splits", None)
    if as_json:
        print_json(pd.DataFrame([row]) if splits is None else splits)
    elif splits is None:
        _print_next(given["folder"], given["spikes"])
    for caution in row["cautions"]:
        say(caution)


def _print_next(run: Path, spikes: Path) -> None:
    """Print what to run next."""
    where = shlex.quote(str(run))
    print(f"next: neurotact infer {where} {shlex.quote(str(spikes))}")
    print(f"      neurotact sops {where} -o sops.csv")


def _how_to_go_on(folder: Path, epochs: int) -> str:
    """The message of an interrupted training, or of one of several, with the command that continues it."""
    if epochs == 0 and not api.cross_validation.trained_in(folder):
        return "interrupted before the first epoch was over; nothing is saved"
    words = [word for word in sys.argv[1:] if word not in ("--force", "--resume")]
    after = f"after epoch {epochs}" if epochs else "before the first epoch was over; earlier trainings are saved"
    return f"interrupted {after}; go on with: {shlex.join(['neurotact', *words, '--resume'])}"


@calling(
    tools.conditions_curve,
    column=Annotated[str, typer.Argument(help="The condition, such as speed, with three values or more.")],
    network=option(str, "Name or path of a network spec."),
    window="window_ms align",
    augmentation=COPIES,
    out=option(Path | None, "Also write one row per training (.csv, .json, .md, .tex).", "-o", "--out"),
    figure=option(Path | None, "Also draw the curve (.png, .svg, .pdf)."),
)
def conditions_curve(given: dict[str, Any]) -> None:
    """How many values of a condition must be recorded, such as speeds.

    Networks are trained on one value, on two and so on, and tested on one that they do not know; the curve and the
    advice are printed. Each training has as many trials.
    """
    tools.conditions_curve(**given, tell=show)


@calling(
    tools.tune,
    network=option(str, "Name or path of the network spec that the space changes."),
    split="split_seed stratify test_where group order folds fold",
    resume=flag("--resume", "Continue a search of fewer trials, up to --trials; start one if there is none."),
)  # fmt: skip
def tune(given: dict[str, Any], as_json: Json = False) -> None:
    """Search a network's hyperparameters on validation windows.

    The first trial is the network as given. The best has the highest value and, of equal ones, the fewest SOPs. An
    interrupted search continues when the same command is given again; with --resume it may ask for more trials.
    """
    try:
        tools.tune(**given, tell=unless(as_json))
    except KeyboardInterrupt:
        say(f"interrupted; the same command continues in {given['folder']}")
        sys.exit(INTERRUPTED)
    best = given["folder"] / "best"
    row = api.result(best)
    if as_json:
        print_json(pd.DataFrame([row]))
    else:
        _print_next(best, given["spikes"])
    for caution in row["cautions"]:
        say(caution)


@calling(
    tools.save_energy,
    run=Annotated[
        Path, typer.Argument(help="The folder of a trained network or of a study of some, or a file of recordings.")
    ],
    trials=option(int, "Trainings in all.", min=1),
    at_most_points=option(float, "Accuracy on validation windows that may be lost, in points.", min=0, max=100),
    prices=option(str, "The price list whose energy is saved: a name (`neurotact list`)."),
    seed=option(int, "Random seed of the search and of the weights.", min=0, max=MOST_SEEDS),
    recordings=option(Path | None, "The recordings that the run was trained on, if they were moved."),
    spikes=MovedSpikes,
)
def save(given: dict[str, Any], as_json: Json = False) -> None:
    """Find the network that saves the most energy at the accuracy of a run, by all ways together.

    Refractory periods, clocks, neurons, pruned weights, shorter windows and early exit are tried alone and together, on
    validation windows. Each point of the front is a run folder in -o, the answer is in -o/1. From a file of recordings
    the default network is trained first. An interrupted search continues when the same command is given again.
    """
    try:
        answer = tools.save_energy(**given, tell=unless(as_json))
    except KeyboardInterrupt:
        say(f"interrupted; the same command continues in {given['folder']}")
        sys.exit(INTERRUPTED)
    if as_json:
        print_json(pd.DataFrame([{key: value for key, value in answer.items() if key not in ("points", "cautions")}]))
    elif answer["best"] is not None:
        best, spikes = (shlex.quote(str(given["folder"] / answer["points"][0][of])) for of in ("folder", "spikes"))
        after = f"export {best} --to c -o chain/" if answer["next"] == "export" else f"infer {best} {spikes}"
        print(f"next: neurotact {after}")
    for caution in answer["cautions"]:
        say(caution)


@calling(
    tools.learn,
    touched=Annotated[Path, typer.Argument(help="Spikes of touches, of classes that the network does not know.")],
    touches=option(int, "Touches of each new class that are learned; the others test it.", min=1),
    spikes=MovedSpikes,
    force=REPLACED,
)
def learn(given: dict[str, Any], as_json: Json = False) -> None:
    """Teach a network a new class from a few touches, by its readout alone.

    The readout is refitted on what it hears of the run's training windows, and then learns the new touches one by one.
    What the known classes lose is printed. The network is saved as a new run.
    """
    row = tools.learn(**given, tell=unless(as_json))
    if as_json:
        print_json(pd.DataFrame([row]))
    else:
        print(f"next: neurotact infer {shlex.quote(str(given['folder']))} {shlex.quote(str(given['touched']))}")


@calling(
    api.infer,
    out=option(Path | None, "Also write one row per window (.csv, .json, .md, .tex).", "-o", "--out"),
    early_exit=flag("--early-exit", "Stop each window by the rule chosen on validation windows, where it is used."),
)
def infer(given: dict[str, Any], as_json: Json = False) -> None:
    """Classify every window with a trained network, and count its operations.

    Training, validation, test and unseen windows are summarised separately; trials are recognised by their content.
    """
    told: list[Any] = []
    _print_sides(api.infer(**given, tell=told.append), told, as_json=as_json)


@calling(
    api.sops,
    spikes=MovedSpikes,
    early_exit=flag("--early-exit", "Count with early exit."),
    prices=option(str, "The price list of the estimate of energy: a name (`neurotact list`) or a path."),
)
def sops(given: dict[str, Any], as_json: Json = False) -> None:
    """Write the synaptic operations of each test window (.csv, .json, .md, .tex)."""
    told: list[Any] = []
    _print_sides(api.sops(**given, tell=told.append), told, as_json=as_json)


def _in_words(column: "pd.Series") -> "pd.Series":
    """A column of a summary, which says what is not counted."""
    return column.astype(object).where(column.notna(), "not counted") if column.isna().any() else column


def _print_sides(table: "pd.DataFrame", told: list[Any], *, as_json: bool) -> None:
    """The means of decisions, one table per side, and what else was told; as JSON, one table."""
    means = api.summarise(table)
    if as_json:
        print_json(means)
        return
    for side, rows in means.groupby("side", sort=False):
        shown = [name for name in rows if name in SHOWN or str(name).startswith("rmse_")]
        print_table(rows[shown].apply(_in_words), title=SIDES[str(side)])
    for line in told:
        show(line)
