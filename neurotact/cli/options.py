"""Options of commands: those of a function of `neurotact.api`, with its names and its defaults."""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from neurotact.spec import parse_assignments, parse_choice, parse_where

LABEL = "label"
"""The condition of a value alone: the class."""
MOST_SEEDS = 2**63 - 2
"""Largest seed of a training, which draws its order from the next seed."""
MOST_SPLITS = 2**32 - 2
"""Largest seed of a split, which also uses the next one; scikit-learn takes 32 bits."""
MOST_WORKERS = 1024

Texts = list[str] | None
SetOption = Annotated[
    Texts, typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the spec; may be repeated.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it already exists.")]
OutFile = Annotated[Path, typer.Option("-o", "--out", dir_okay=False, help="The file to write.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
RunFolder = Annotated[Path, typer.Argument(help="The folder of a trained network.")]
MovedSpikes = Annotated[
    Path | None, typer.Option("--spikes", help="The spikes that the run was trained on, if they were moved.")
]
StudyFolder = Annotated[Path, typer.Argument(help="The folder of a study.")]
HopMs = Annotated[float | None, typer.Option(help="Time between the starts of windows; the window length when absent.")]


def option(kind: Any, help: str, *names: str, **more: Any) -> Any:
    """The annotation of an option with values of this kind; further arguments as of `typer.Option`."""
    return Annotated[kind, typer.Option(*names, help=help, **more)]


def flag(name: str, help: str) -> Any:
    """The annotation of an option without a value."""
    return option(bool, help, name)


REPLACED = flag("--force", "Replace a training that is in the folder.")
OPTIONS: dict[str, Any] = {
    "settings": SetOption,
    "spikes": Annotated[Path, typer.Argument(help="An HDF5 file of spikes, as encode writes it.")],
    "run": RunFolder,
    "recordings": Annotated[Path, typer.Argument(help="An HDF5 file of recordings.")],
    "path": Annotated[Path, typer.Argument(help="The folder or file to read.")],
    "folder": option(Path, "The folder to write.", "-o", "--out"),
    "out": OutFile,
    "force": Force,
    "encoder": option(str, "Name or path of an encoder spec."),
    "device": option(str, "A torch device: cpu, cuda, cuda:1, mps."),
    "workers": option(
        int | None, "Worker processes; the results do not depend on it.", min=1, max=MOST_WORKERS, show_default="2"
    ),
    "scheduler": option(
        str | None, "Run on the workers of this Dask scheduler, such as tcp://host:8786.", metavar="ADDRESS"
    ),
    "seed": option(int, "Random seed of the weights and of the order of windows.", min=0, max=MOST_SEEDS),
    "length_ms": option(
        float | None, "Length of a window, the unit that is classified.", "--window-ms",
        show_default="the shortest trial from the touch on, at most 2000",
    ),
    "start_ms": option(
        float | None, "Start of the first window in each trial.",
        show_default="where the touch begins; 0 with --window-ms",
    ),
    "hop_ms": HopMs,
    "per_trial": option(
        int | None, "Maximum number of windows per trial.",
        show_default="up to 4 s of windows; all that fit with --window-ms",
    ),
    "align": option(
        Literal["trial", "onset"], "What --start-ms counts from: the trial's beginning, or the onset of contact."
    ),
    "rest_ms": option(
        float | None, "With --align onset: length of the rest at the start of each trial.", show_default="50"
    ),
    "onset_deviations": option(
        float | None, "With --align onset: contact begins this many standard deviations above the rest.",
        show_default="3",
    ),
    "where": option(
        Texts, "Use these trials alone, as in speed=300 or speed=300,450 or material!=wood; may be repeated.",
        metavar="CONDITION=VALUE",
    ),
    "leave_out": option(
        Texts, "Leave these trials out, as in material=wood; a value alone is a class, as in rest; may be repeated.",
        metavar="CONDITION=VALUE",
    ),
    "test_where": option(
        Texts, "Test on these trials and train on the others, as in speed=450 or speed=300,450; may be repeated.",
        metavar="CONDITION=VALUE",
    ),
    "group": option(Texts, "Trials with the same value are never split; may be repeated.", metavar="CONDITION"),
    "order": option(
        str | None,
        "Test on the last trials of each class, in the order of this condition; trial: the order of the file.",
        metavar="CONDITION",
    ),
    "folds": option(int | None, "Divide the trials into this many folds and test on one.", min=2),
    "fold": option(int | None, "The fold that is tested, from 0.", min=0, show_default="0"),
    "leave_out_each": option(
        Texts, "Test on each value of this condition in turn, as in speed; no training trial has that value. Twice, as "
        "for speed and force: on each pair of values, of which no training trial has one.",
        metavar="CONDITION",
    ),
    "stratify": option(Texts, "A condition to balance in the split; may be repeated."),
    "split_seed": option(
        int | None, "Random seed of the split into training, validation and test.",
        min=0, max=MOST_SPLITS, show_default="0",
    ),
    "exit_tolerance": option(
        float, "Validation accuracy that early exit may lose, as a share of 1.", "--exit-tolerance", "--tolerance"
    ),
    "allow_other_encoder": flag("--allow-other-encoder", "Accept spikes of an encoder other than the one in training."),
}  # fmt: skip
"""The option of each parameter of functions of `neurotact.api` that several commands have."""


def calling(function: Callable[..., Any], **described: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a function that calls one of `neurotact.api`, whose arguments it receives as `given`.

    The parameters that `OPTIONS` or `described` has are options of the command, with their defaults. Other parameters
    of the decorated function are options of the command alone.
    """

    def decorated(run: Callable[..., None]) -> Callable[..., None]:
        options = OPTIONS | described
        theirs = [_option(param, options[name]) for name, param in _parameters(function).items() if options.get(name)]
        own = [param.replace(kind=param.KEYWORD_ONLY) for name, param in _parameters(run).items() if name != "given"]

        def command(**values: Any) -> None:
            run(arguments(function, values), **{param.name: values[param.name] for param in own})

        command.__doc__ = run.__doc__
        command.__signature__ = inspect.Signature([*theirs, *own])  # pyright: ignore[reportFunctionMemberAccess]
        command.__annotations__ = {param.name: param.annotation for param in (*theirs, *own)}
        return command

    return decorated


def arguments(function: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a function of `neurotact.api` from the values of options, of which None is not given.

    >>> from neurotact.api.encoding import encode_file
    >>> arguments(encode_file, {"out": Path("a.h5"), "where": ["speed=300"], "encoder": None, "as_json": True})
    {'out': PosixPath('a.h5'), 'where': {'speed': [300]}, 'leave_out': {}}
    """
    parsed = {**values}
    if "where" in values:
        parsed["where"], parsed["leave_out"] = parse_choice(values["where"] or [], values.get("leave_out") or [], LABEL)
    if values.get("test_where"):
        parsed["test_where"] = parse_where(values["test_where"], "`test_where`")
    if "settings" in values:
        parsed["settings"] = parse_assignments(values["settings"] or [])
    return {name: parsed[name] for name in _parameters(function) if parsed.get(name) is not None}


def _parameters(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(function).parameters


def _option(parameter: inspect.Parameter, described: Any) -> inspect.Parameter:
    """A parameter as an option: one that cannot be absent must be given; a list is absent in place of empty."""
    is_needed = parameter.default in (None, "") and described.__origin__ in (Path, str)
    default = parameter.empty if is_needed else None if parameter.default == () else parameter.default
    return parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=described, default=default)
