"""Groups of commands that are imported on use: the help of a group imports none of them."""

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from neurotact import plugins
from neurotact.cli.help import Command
from neurotact.errors import InputError

Help = str | Callable[[], str]
"""A command's line in its group's help, or a function that finds it."""


def new_app(help: str = "") -> typer.Typer:
    """An app whose help is plain text, with the whole line of each command."""
    plain: dict[str, Any] = {"add_completion": False, "pretty_exceptions_enable": False, "rich_markup_mode": None}
    return typer.Typer(cls=lazy_group(dict, str), help=help, **plain)


def command_of(function: Callable[..., None]) -> Any:
    """A function as a command by itself."""
    app = new_app()
    app.command(cls=Command)(function)
    return get_command(app)


class LazyCommands(MutableMapping[str, Any]):
    """Commands by name, each loaded when it is looked up.

    ready: commands that need no loading. names: those of the others. load: returns one of these by its name.
    """

    def __init__(
        self, ready: MutableMapping[str, Any], names: Callable[[], Iterable[str]], load: Callable[[str], Any]
    ) -> None:
        self._loaded = {**ready}
        self._names, self._load = names, load

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            if name not in self._names():
                raise KeyError(name)
            self._loaded[name] = self._load(name)
            self._loaded[name].name = name  # the name that the user types, not that of the function
        return self._loaded[name]

    def __setitem__(self, name: str, command: Any) -> None:
        self._loaded[name] = command

    def __delitem__(self, name: str) -> None:
        del self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._names(), *self._loaded]))

    def __len__(self) -> int:
        return len(list(iter(self)))


def add_plugins(
    app: typer.Typer,
    kind: plugins.Group,
    plugin_of: Callable[[str], Any],
    command: Callable[[str, Any], Callable[..., None]],
) -> None:
    """Give `app` a command for each plug-in of a kind, such as "readers", with its `about` as the first line of help.

    plugin_of: returns the plug-in of a name. command: returns the function of a command for the name of a plug-in and
        the plug-in; its docstring, if any, follows in the help.
    """

    def load(name: str) -> Any:
        plugin = plugin_of(name)
        run = command(name, plugin)
        run.__doc__ = f"{plugin.about}\n\n{run.__doc__ or ''}"
        return command_of(run)

    def about(name: str) -> str:
        try:
            return plugin_of(name).about
        except InputError as error:  # the others are shown all the same
            return f"Cannot be used: {error}."

    def helps() -> dict[str, Help]:
        return {name: lambda name=name: about(name) for name in plugins.names(kind)}

    def begin(context: typer.Context) -> None:
        group: Any = context.command
        name = context.invoked_subcommand or ""
        if name in group.ready:  # a command of ours; of two plug-ins of one name, loading tells
            plugins.refuse_taken(kind, name)

    app.info.cls = lazy_group(helps, load)
    app.callback()(begin)  # it is a group although it may have no other command


def lazy_group(
    helps: Callable[[], Mapping[str, Help]], load: Callable[[str], Any], tasks: Mapping[str, str] | None = None
) -> type[TyperGroup]:
    """A kind of group with further commands, which `load(name)` returns when they are run or their help is requested.

    helps: the line of each such command in the group's help, by name. tasks: the names of all commands by the heading
        under which the help shows them; one heading by default.
    """

    class LazyGroup(TyperGroup):
        def __init__(self, **attributes: Any) -> None:
            super().__init__(**attributes)
            self.ready = {**self.commands}
            self.commands = LazyCommands(self.ready, helps, load)

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            ready = {name: command.get_short_help_str(200) for name, command in self.ready.items()}
            lazy = {name: line if isinstance(line, str) else line() for name, line in helps().items()}
            lines = lazy | ready
            for heading, names in (tasks or {"Commands": " ".join(lines)}).items():
                with formatter.section(heading):
                    formatter.write_dl([(name, lines[name]) for name in names.split()])

    return LazyGroup
