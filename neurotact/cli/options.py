"""Options that several commands share."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from neurotact import effects
from neurotact.cli.words import say
from neurotact.data.recordings import LABEL
from neurotact.data.trial_choice import TrialChoice
from neurotact.spec import parse_choice, parse_where

SHORTEST_STEP_MS, SHORTEST_TOUCH_MS = 1.0, 5.0

MOST_SEEDS = 2**63 - 2
"""Largest seed of a training, which draws its order from the next seed."""
MOST_SPLITS = 2**32 - 2
"""Largest seed of a split, which also uses the next one; scikit-learn takes 32 bits."""
MOST_WORKERS = 1024

SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the spec; may be repeated.")
]
MovedSpikes = Annotated[
    Path | None, typer.Option("--spikes", help="The spikes that the run was trained on, if they were moved.")
]
OutFile = Annotated[Path, typer.Option("-o", "--out", dir_okay=False, help="The file to write.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it already exists.")]
OutFolder = Annotated[Path, typer.Option("-o", "--out", help="The folder to write.")]
EncoderOption = Annotated[str, typer.Option(help="Name or path of an encoder spec.")]
DeviceOption = Annotated[str, typer.Option(help="A torch device: cpu, cuda, cuda:1, mps.")]
PopulationDevice = Annotated[
    str,
    typer.Option("--device", help="cpu: processes. Another torch device (cuda, cuda:1): networks are trained at once."),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        max=MOST_WORKERS,
        show_default="2",
        help="Worker processes; the results do not depend on it.",
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Run on the workers of this Dask scheduler, such as tcp://host:8786."),
]
Seed = Annotated[
    int, typer.Option(min=0, max=MOST_SEEDS, help="Random seed of the weights and of the order of windows.")
]
WindowMs = Annotated[
    float | None,
    typer.Option(
        "--window-ms",
        show_default="the shortest trial from the touch on, at most 2000",
        help="Length of a window, the unit that is classified.",
    ),
]
StartMs = Annotated[
    float | None,
    typer.Option(
        "--start-ms",
        show_default="where the touch begins; 0 with --window-ms",
        help="Start of the first window in each trial.",
    ),
]
HopMs = Annotated[
    float | None,
    typer.Option("--hop-ms", help="Time between the starts of windows; the window length when absent."),
]
PerTrial = Annotated[
    int | None,
    typer.Option(
        "--per-trial",
        show_default="up to 4 s of windows; all that fit with --window-ms",
        help="Maximum number of windows per trial.",
    ),
]
Stratify = Annotated[list[str] | None, typer.Option(help="A condition to balance in the split; may be repeated.")]
SplitSeed = Annotated[
    int | None,
    typer.Option(
        min=0, max=MOST_SPLITS, show_default="0", help="Random seed of the split into training, validation and test."
    ),
]
TestWhere = Annotated[
    list[str] | None,
    typer.Option(
        "--test-where",
        metavar="CONDITION=VALUE",
        help="Test on these trials and train on the others, as in speed=450 or speed=300,450; may be repeated.",
    ),
]
Where = Annotated[
    list[str] | None,
    typer.Option(
        "--where",
        metavar="CONDITION=VALUE",
        help="Use these trials alone, as in speed=300 or speed=300,450 or material!=wood; may be repeated.",
    ),
]
LeaveOut = Annotated[
    list[str] | None,
    typer.Option(
        "--leave-out",
        metavar="CONDITION=VALUE",
        help="Leave these trials out, as in material=wood; a value alone is a class, as in rest; may be repeated.",
    ),
]
Group = Annotated[
    list[str] | None,
    typer.Option("--group", metavar="CONDITION", help="Trials with the same value are never split; may be repeated."),
]
Order = Annotated[
    str | None,
    typer.Option(
        "--order",
        metavar="CONDITION",
        help="Test on the last trials of each class, in the order of this condition; trial: the order of the file.",
    ),
]
Folds = Annotated[
    int | None, typer.Option("--folds", min=2, help="Divide the trials into this many folds and test on one.")
]
Fold = Annotated[int | None, typer.Option("--fold", min=0, show_default="0", help="The fold that is tested, from 0.")]
FoldsInTurn = Annotated[
    int | None,
    typer.Option(
        "--folds", min=2, help="Divide the trials into this many folds and test on each in turn, or on --fold alone."
    ),
]
FoldOrAll = Annotated[
    int | None, typer.Option("--fold", min=0, show_default="each in turn", help="Test on this fold alone, from 0.")
]
Align = Annotated[
    Literal["trial", "onset"],
    typer.Option(help="What --start-ms counts from: the trial's beginning, or the onset of contact."),
]
RestMs = Annotated[
    float | None,
    typer.Option(
        "--rest-ms", show_default="50", help="With --align onset: length of the rest at the start of each trial."
    ),
]
OnsetDeviations = Annotated[
    float | None,
    typer.Option(
        "--onset-deviations",
        show_default="3",
        help="With --align onset: contact begins this many standard deviations above the rest.",
    ),
]
Tolerance = Annotated[
    float,
    typer.Option(
        "--exit-tolerance", "--tolerance", help="Validation accuracy that early exit may lose, as a share of 1."
    ),
]
ExitBy = Annotated[
    str,
    typer.Option(
        "--exit-by",
        help="Early exit waits for stability (the leading class unchanged for long enough) or margin (a large enough "
        "lead); how long or how large is chosen on validation windows.",
    ),
]
OtherEncoder = Annotated[
    bool, typer.Option("--allow-other-encoder", help="Accept spikes of an encoder other than the one in training.")
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Recordings = Annotated[Path, typer.Argument(help="An HDF5 file of recordings.")]
Spikes = Annotated[Path, typer.Argument(help="An HDF5 file of spikes, as encode writes it.")]
RunFolder = Annotated[Path, typer.Argument(help="The folder of a trained network.")]
StudyFolder = Annotated[Path, typer.Argument(help="The folder of a study.")]
Source = Annotated[Path, typer.Argument(help="The folder or file to read.")]


def choice_table(where: list[str] | None, leave_out: list[str] | None) -> dict[str, Any]:
    """The options for the trials that are used, as two tables of conditions."""
    kept, left = parse_choice(where or [], leave_out or [], LABEL)
    return {"where": kept, "leave_out": left}


def choice_of(where: list[str] | None, leave_out: list[str] | None) -> TrialChoice:
    """The options for the trials that are used, as a choice."""
    return TrialChoice.of(**choice_table(where, leave_out))


def split_table(
    seed: int | None,
    test_where: list[str] | None,
    group: list[str] | None,
    order: str | None,
    folds: int | None,
    fold: int | None,
) -> dict[str, Any]:
    """The options for the split, as its table; None means not given."""
    effects.check(split_seed=seed, order=order, fold=fold, folds=folds)
    where = parse_where(test_where or [], "--test-where")
    chosen = {"seed": seed or 0, "order": order, "folds": folds, "fold": fold or 0}
    return {"test_where": where, "group": group or [], **chosen}


def split_changes(
    test_where: list[str] | None,
    group: list[str] | None,
    order: str | None,
    folds: int | None,
    repeats: int | None,
) -> dict[str, Any]:
    """The options for the split, as changes of a study; others keep the study's value."""
    given = {"split.group": group, "split.order": order, "split.folds": folds}
    changes = {key: value for key, value in given.items() if value}
    if test_where:
        changes["split.test_where"] = parse_where(test_where, "--test-where")
    if folds:
        changes["sweep.split.fold"] = list(range(folds))
    if repeats:
        changes["sweep.split.seed"] = list(range(repeats))
    return changes


def say_if_seconds(length_ms: float | None) -> None:
    """Print a line on stderr for a window of a few milliseconds, which is likely meant in seconds.

    `data.windows` refuses a window of less than a step, with the same hint.
    """
    if length_ms is not None and SHORTEST_STEP_MS <= length_ms < SHORTEST_TOUCH_MS:
        say(f"--window-ms {length_ms:g}: a window of {length_ms:g} ms is shorter than a touch; is it meant in seconds?")


def window_table(
    length_ms: float | None,
    start_ms: float | None,
    hop_ms: float | None,
    per_trial: int | None,
    align: str,
    rest_ms: float | None,
    deviations: float | None,
) -> dict[str, Any]:
    """The options for the windows, as the table of a window; None means not given."""
    effects.check(align=align, rest_ms=rest_ms, onset_deviations=deviations)
    say_if_seconds(length_ms)
    rest_ms, deviations = 50.0 if rest_ms is None else rest_ms, 3.0 if deviations is None else deviations
    onset = {"rest_ms": rest_ms, "bin_ms": min(10.0, rest_ms), "deviations": deviations}
    table = {"length_ms": length_ms, "start_ms": start_ms, "hop_ms": hop_ms, "per_trial": per_trial}
    return table | ({"align": align, "onset": onset} if align != "trial" else {})
