"""Messages in the words of the command line.

Below `cli`, a message names a parameter as in Python, in backquotes. Here it becomes the option of the command that was
typed, whose parameters are named as those of `neurotact.api`; a call of `neurotact.api` becomes its command.
"""

import ast
import re
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from typer.main import get_command

from neurotact import progress
from neurotact.cli.commands import app
from neurotact.cli.options import name_of
from neurotact.spec import as_text, assignments_of

MARKED = re.compile(r"`([^`]+)`")
COMMANDS = {
    "read": "import",
    "describe": "info",
    "encode_file": "encode",
    "run_study": "study run",
    "resume_study": "study resume",
    "report_study": "study report",
    "plot_raster": "raster",
    "save_raster": "raster",
    "export_c": "export --to c",
    "export_nir": "export --to nir",
    "to_nir": "export --to nir",
    "check_chip": "export",
    "save_energy": "save",
    "bundle_study": "study bundle",
}
"""Commands that are not called as their function; that of `read_x` is `import x`."""

SET = "--set"
"""The option of `settings` also in messages of a command without it, such as `study report`: another command has it."""
LEFT_OUT = "leave_out_units"
"""Has no option of its own: it is `units` with `!=`."""


def say(what: object) -> None:
    """Print one line on stderr, in the words of the command that was typed."""
    progress.say(as_typed(str(what)))


def as_typed(message: str) -> str:
    """A message in the words of the command that was typed."""
    return in_options(message, options_of(sys.argv[1:])) if MARKED.search(message) else message


def in_options(message: str, options: Mapping[str, str]) -> str:
    """A message with its parameters as options, and its calls as commands.

    options: the option of each parameter. What is neither a parameter nor a call stays as it is, with its backquotes.

    >>> options = {"rest_ms": "--rest-ms", "align": "--align", "window_ms": "--window-ms", "settings": "--set"}
    >>> in_options("`onset.rest_ms`: has no effect without `window=nt.Window(align='onset', length_ms=9)`", options)
    '--rest-ms: has no effect without --align onset --window-ms 9'
    >>> in_options("train with `settings={'hidden': 64}`; try `nt.calibrate(..., compare=True)` or `nt.tune`", options)
    'train with --set hidden=64; try neurotact calibrate ... --compare or neurotact tune'
    """
    return MARKED.sub(lambda match: _typed(match[1], options) or match[0], message)


def options_of(words: Iterable[str]) -> dict[str, str]:
    """The option of each parameter of the command that these words begin; of an argument its name in capitals."""
    command: Any = get_command(app)
    for word in words:
        if word in getattr(command, "commands", {}):
            command = command.commands[word]
    options = {
        name_of(param.name): param.opts[0] if param.opts[0].startswith("-") else param.name.upper()
        for param in command.params
    }
    return {"settings": SET} | options | ({LEFT_OUT: options["units"]} if "units" in options else {})


def _typed(marked: str, options: Mapping[str, str]) -> str | None:
    """Parameters or a call, as they are typed; None if they are not of the command line."""
    function, bracket, inner = marked.partition("(") if marked.startswith("nt.") else ("", "(", f"{marked})")
    given = given_in(f"f({inner}" if bracket else "f()")
    if given is None:
        return None
    words: list[str] = []
    if function:
        words = ["neurotact", *_command(function.removeprefix("nt.")).split()]
        options = options_of(words[1:]) | {"...": "..."}
    if not all(name in options for name, _ in given):
        return None
    words += [_option(options[name], value, "!=" if name == LEFT_OUT else "=") for name, value in given]
    return " ".join(words)


def given_in(call: str) -> list[tuple[str, Any]] | None:
    """What a call gives, by the names of options, with fields in place of specs; None if the text is none.

    >>> given_in("f(window=nt.Window(length_ms=300, onset=nt.Onset(deviations=4)), force=True)")
    [('window_ms', 300), ('onset_deviations', 4), ('force', True)]
    """
    try:
        return [*_fields_in(ast.parse(call, mode="eval").body)]
    except (AssertionError, SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def _fields_in(call: ast.expr, before: str = "") -> Iterator[tuple[str, Any]]:
    assert isinstance(call, ast.Call)
    yield from ((arg if (arg := ast.unparse(each)) == "..." else name_of(arg), True) for each in call.args)
    for keyword in call.keywords:
        if isinstance(keyword.value, ast.Call):
            yield from _fields_in(keyword.value, f"{before}{keyword.arg}.")
        else:
            yield name_of(f"{before}{keyword.arg}"), ast.literal_eval(keyword.value)


def _command(function: str) -> str:
    """The command of a function of `neurotact.api`."""
    return COMMANDS.get(function) or function.replace("read_", "import ").replace("_", "-")


def _option(option: str, value: Any, sign: str) -> str:
    """An option with its value; one for each key of a table and each item of a list."""
    if value is True:
        return option
    if isinstance(value, Mapping):
        return " ".join(f"{option} {_quoted(text)}" for text in assignments_of(value, sign))
    return " ".join(f"{option} {_quoted(text)}" for text in (value if isinstance(value, list) else [value]))


def _quoted(value: Any) -> str:
    """A value as it is typed in a shell.

    >>> _quoted("trial,time"), _quoted("{label}.csv"), _quoted(0.5), _quoted(...)
    ('trial,time', "'{label}.csv'", '0.5', 'VALUE')
    """
    return shlex.quote(as_text(value))
