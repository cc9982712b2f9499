"""What an option that a command does not have was meant to be: a key of the spec that the command changes."""

import shlex
from collections.abc import Sequence
from typing import Any

from typer import TyperException

from neurotact.api.specs import keys_of
from neurotact.cli.words import SET
from neurotact.errors import some


def as_key(error: TyperException, words: Sequence[str]) -> str:
    """What to type in place of an unknown option that is named like keys of the spec; empty if it is none.

    words: the command line. An option may name a key within a table by its last word, and with `-` for `_`.
    """
    option, context = getattr(error, "option_name", None), getattr(error, "ctx", None)
    parameters = {param.opts[0].lstrip("-"): param for param in context.command.params} if option and context else {}
    if "set" not in parameters:
        return ""
    name = str(option).lstrip("-").replace("-", "_").lower()
    keys = [key for key in _keys(context, parameters) if f".{key.lower()}".endswith(f".{name}")]
    value = _value_of(str(option), words)
    fixes = [f"{SET} {shlex.quote(f'{key}={value}')}" for key in sorted(keys, key=len)]
    return f"; it is a key of the spec: {some(fixes, 3, ' or ')}" if fixes else ""


def _keys(context: Any, parameters: dict[str, Any]) -> list[str]:
    """The dotted keys of the spec that the option `--set` of a command changes."""
    if context.parent.info_name == "simulate":
        return keys_of("simulators", context.info_name)
    if context.parent.info_name == "study":
        return keys_of("studies")
    return next((keys_of(f"{part}s") for part in ("network", "encoder") if part in parameters), [])


def _value_of(option: str, words: Sequence[str]) -> str:
    """The value that is typed after an option; the place for one without any."""
    for word, after in zip(words, [*words[1:], "-"], strict=True):
        if word.startswith(f"{option}="):
            return word.removeprefix(f"{option}=")
        if word == option:
            return "VALUE" if after.startswith("-") and not after[1:2].isdigit() else after
    return "VALUE"
