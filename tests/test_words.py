"""Messages name parameters; the command line shows them as the options of the command that was typed."""

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.main import get_command

import neurotact as nt
from neurotact.cli import words
from neurotact.cli.commands import app
from neurotact.cli.options import fields_of, name_of
from neurotact.spec import specs_of

PACKAGE = Path(nt.__file__).parent
PUBLIC = vars(nt)["__all__"]
ALONE = {"to"}
"""Parameters of a command alone: the target of `export`."""
OTHERS = {"published", "honest", "paper", "skipped", "afferents", "accuracy_class_means", "task", "protocol", "way"}
OTHERS |= {"X", "model"}
"""Names in backquotes that are no parameters: ways and columns of protocols, and the place of a name."""


def commands(group=None, before: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    group = group or get_command(app)
    for name in group.commands:
        inner = group.commands[name]
        yield from commands(inner, (*before, name)) if hasattr(inner, "commands") else [(*before, name)]


PARAMETERS = {name for command in commands() for name in words.options_of(command)}


def parameters() -> Iterator[str]:
    """Those of all that Python users call."""
    for name in PUBLIC:
        found = getattr(nt, name)
        if inspect.isclass(found):
            for method in (each for each, value in vars(found).items() if inspect.isfunction(value)):
                yield from inspect.signature(getattr(found, method)).parameters
        elif callable(found):
            yield from inspect.signature(found).parameters
            yield from (path for name, kind in specs_of(found).items() for path in fields_of(name, kind))


KEYWORDS = {*map(name_of, parameters())} | ALONE | OTHERS


def messages(path: Path) -> Iterator[str]:
    """The texts of a module that are no docstrings, with `X` in place of values."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    docs = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    parts = {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs | parts:
            yield node.value


def test_a_name_in_backquotes_is_a_parameter_of_a_command_and_of_python():
    beside = (PACKAGE.parent / room for room in ("exporters", "readers"))
    for path in sorted(path for folder in (PACKAGE, *beside) for path in folder.rglob("*.py")):
        if path.is_relative_to(PACKAGE / "cli") or path.name in ("details.py", "columns.py"):  # texts of a page
            continue
        marked = [mark for message in messages(path) for mark in words.MARKED.findall(message)]
        for mark in marked:
            call = re.match(r"nt\.(\w+)", mark)
            if call:
                assert call[1] in PUBLIC, f"{path}: {mark}"
            else:
                call = re.sub(r"(?<==)(X|%g|\{.*\})|\{.*?\}", "0", f"f({mark})")
                names = words.given_in(call) or [(re.match(r"\w*", mark)[0], True)]  # pyright: ignore
                for name, _ in names:
                    assert name in KEYWORDS, f"{path}: {mark}"
                    assert name in PARAMETERS | OTHERS | {words.LEFT_OUT}, f"{path}: {mark}"


@pytest.mark.parametrize(
    ("command", "message", "typed"),
    [
        ("import folder", "give `sampling_rate_Hz`, or `time_column`", "give --sampling-rate-Hz, or --time-column"),
        ("import arrays", "use `axes='trial,time'`", "use --axes trial,time"),
        ("import arrays", "with `names={'label': ...}`", "with --names label=VALUE"),
        ("import nwb", "with `leave_out_units={'name': 'unit 3'}`", "with --units 'name!=unit 3'"),
        ("import folder", "pass `decimal=','` or points", "pass --decimal , or points"),
        ("train", "a longer window (`length_ms`)", "a longer window (--window-ms)"),
        ("train", "`split.seed`: or `onset.rest_ms`", "--split-seed: or --rest-ms"),
        ("train", "`window=nt.Window(onset=nt.Onset(deviations=4))`", "--onset-deviations 4"),
        ("info", "`nt.train(..., window=nt.Window(start_ms=...))`", "neurotact train ... --start-ms VALUE"),
        ("tune", "`nt.train(..., split=nt.Split(seed=3, repeats=5))`", "neurotact train ... --split-seed 3 --repeats 5"),  # noqa: E501
        ("train", "`settings={'hidden': 64}`, `force=True`", "--set hidden=64, --force"),
        ("study report", "`settings={'window.length_ms': ...}` changes it", "--set window.length_ms=VALUE changes it"),
        ("export", "again: `nt.train(..., settings={'reset': 'hard'})`", "again: neurotact train ... --set reset=hard"),
        ("encode", "`hidden`: no `option here`, nor `nt.train(`", "`hidden`: no `option here`, nor `nt.train(`"),
        ("stream", "`source='a b.csv'`, `run`", "--from 'a b.csv', RUN"),
    ],
)  # fmt: skip
def test_a_message_is_shown_as_it_is_typed(command, message, typed, monkeypatch):
    monkeypatch.setattr("sys.argv", ["neurotact", "--quiet", *command.split(), "file"])
    assert words.as_typed(message) == typed
