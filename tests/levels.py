"""The levels of the tests: quick (`make test`), thorough (`make test-rest`, in CI too) and slow (`make test-slow`).

A test without a mark is quick. Each law has a quick test, unless its README entry says why not; more of its cases and
examples are thorough.
"""

from collections.abc import Callable, Sequence
from typing import Any

import pytest
from hypothesis import settings

QUICK, THOROUGH = 10, 100
"""Examples that hypothesis draws for a test."""


def examples(at_most: int) -> settings:
    """Of a test whose examples are costly, or whose space is soon drawn or large: so many beyond the quick level."""
    is_quick = settings.default.max_examples == QUICK
    return settings(max_examples=min(at_most, QUICK) if is_quick else at_most)


def thinned(names: str | tuple[str, ...], values: Sequence[Any], every: int = 0, **more: Any) -> Callable:
    """As `pytest.mark.parametrize`: quick with the first value (and each `every`-th one), thorough with all.

    A `pytest.param` keeps its own marks.
    """

    def case(index: int, value: Any) -> Any:
        if hasattr(value, "marks"):
            return value
        is_quick = index % every == 0 if every else index == 0
        values = value if isinstance(names, tuple) else (value,)
        return pytest.param(*values, marks=[] if is_quick else [pytest.mark.thorough])

    return pytest.mark.parametrize(names, [case(*each) for each in enumerate(values)], **more)
