"""The one error that means: what you gave cannot be used, and this is how to mend it; and words for messages."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

INTERRUPTED = 130
"""The exit code after Ctrl-C."""


class InputError(ValueError):
    """A spec, a file or a recording that neurotact cannot use.

    The message is one sentence that names the thing and the fix; the command line prints it on one
    line and leaves with exit code 2. Anything else that escapes is a fault of neurotact.

    >>> raise InputError("sa1.t_ref_ms: must be >= 0; got -1 (encoders/sa1-ra1-lif.toml)")
    Traceback (most recent call last):
    neurotact.errors.InputError: sa1.t_ref_ms: must be >= 0; got -1 (encoders/sa1-ra1-lif.toml)
    """

    def _render_traceback_(self) -> list[str]:
        """What IPython and notebooks print: the message alone, and in their verbose mode the traceback, too."""
        shell = import_module("IPython").get_ipython()
        if shell is not None and shell.InteractiveTB.mode not in ("Context", "Minimal"):
            return shell.InteractiveTB.structured_traceback(type(self), self, self.__traceback__, tb_offset=1)
        return [f"{type(self).__name__}: {self}  [%tb Verbose shows the traceback]"]


def nearest(word: str, known: "list[str] | tuple[str, ...]") -> str:
    """`; did you mean 'x'?` for the closest of `known`, else the list of them.

    >>> nearest("hiden", ["hidden", "tau_mem_ms"])
    "did you mean 'hidden'?"
    >>> nearest("zzz", ["hidden", "tau_mem_ms"])
    'known: hidden, tau_mem_ms'
    """
    suggestion = closest(word, known)
    return "known: " + ", ".join(known) if suggestion is None else f"did you mean '{suggestion}'?"


def closest(word: str, known: Sequence[str], alike: float = 0.5) -> str | None:
    """The word of `known` that is nearly `word`; None if none is. alike: least similarity, from 0 to 1.

    >>> closest("wod", ["felt", "wood"]), closest("zzz", ["felt", "wood"])
    ('wood', None)
    """
    from difflib import get_close_matches

    return next(iter(get_close_matches(word, known, n=1, cutoff=alike)), None)


def some(names: Sequence[str], most: int = 5, between: str = ", ") -> str:
    """The first names and the number of the others.

    >>> some(["a", "b"]), some(list("abcdefg"))
    ('a, b', 'a, b, c, d, e and 2 more')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return between.join(names[:most]) + more


def number_of(n: int, noun: str) -> str:
    """A number with its noun.

    >>> number_of(1, "class"), number_of(2, "class"), number_of(3, "pair of periods")
    ('1 class', '2 classes', '3 pairs of periods')
    """
    one, of, what = noun.partition(" of ")
    return f"{n} {one}{'' if n == 1 else 'es' if one.endswith('s') else 's'}{of}{what}"


def in_digits(value: float, digits: int = 3) -> str:
    """A number with so many digits, or with all before its point if these are more, and then without an exponent.

    >>> in_digits(0.12345), in_digits(123.4), in_digits(1234.0), in_digits(100.0, 2)
    ('0.123', '123', '1,234', '100')
    """
    return f"{value:.{digits}g}" if abs(value) < 10**digits - 0.5 else f"{value:,.0f}"


def first_line(error: BaseException) -> str:
    """An error of other code in one line: its type and the first line of its message.

    >>> first_line(KeyError("gain")), first_line(ValueError("no gain\\nat line 3")), first_line(StopIteration())
    ("KeyError: 'gain'", 'ValueError: no gain', 'StopIteration')
    """
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def optional(name: str, without: str) -> Any:
    """A module that may not be installed; without: what an InputError says then, with `{}` for the reason.

    >>> optional("json", "").dumps([1])
    '[1]'
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(without.format(error)) from error
