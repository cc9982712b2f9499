"""Refractory periods as a page names them: as many numbers as the encoder has refractory periods."""

from collections.abc import Iterator

import pandas as pd

from neurotact.encoders.model import of_name
from neurotact.encoders.specs import period_keys
from neurotact.figures.style import SYMBOLS
from neurotact.studies import sweeps
from neurotact.studies.study import StudySpec

NONE = "-"
"""In place of a refractory period, for an encoder without one."""


def in_words(model: str, first_ms: float, second_ms: float) -> str:
    """The refractory periods of an encoder: of two populations, the second one first as the texture paper writes them;
    of whole taxels; or none.

    >>> in_words("lif", 10.0, 1.0), in_words("send-on-delta", 5.0, 5.0), in_words("burst", 0.0, 0.0)
    ('1&10', '5', '-')
    """
    numbers = f"{second_ms:g}", f"{first_ms:g}"
    return "&".join(numbers[2 - len(period_keys(model)) :]) or NONE


def of_rows(table: pd.DataFrame, study: StudySpec) -> Iterator[str]:
    """The refractory periods of each row, whose encoder is its own where a study sweeps encoders."""
    named = table["encoder"] if "encoder" in table else [None] * len(table)
    models = [model if isinstance(model, str) else study.encoder.model for model in named]
    columns = models, table["t_ref_sa_ms"], table["t_ref_ra_ms"]
    return (in_words(*row) for row in zip(*columns, strict=True))


def head(study: StudySpec) -> str:
    """The heading of a column of `in_words`, without its unit.

    >>> from neurotact.studies.study import resolve
    >>> head(resolve("refractory-period"))
    't_ref RA-I & SA-I'
    """
    names = () if sweeps.values(study.sweep, "encoder") else populations(study)
    return f"t_ref {' & '.join(names)}" if names else "t_ref"


def populations(study: StudySpec) -> tuple[str, ...]:
    """What the numbers of `in_words` are of; empty where the encoder has one period for whole taxels, or none.

    >>> from neurotact.studies.study import resolve
    >>> populations(resolve("refractory-period"))
    ('RA-I', 'SA-I')
    """
    if len(period_keys(study.encoder.model)) < 2:
        return ()
    first, second = (population.name for population in of_name(study.encoder.model).populations[:2])
    return second, first


def axis(study: StudySpec) -> str:
    """The words of an axis of a figure that shows `in_words`.

    >>> from neurotact.studies.study import resolve
    >>> print(axis(resolve("refractory-period")))
    $t_\\mathrm{ref}$ of RA-I & SA-I (ms)
    """
    _, _, of = head(study).partition(" ")
    return rf"{SYMBOLS[0]}{' of ' if of else ''}{of} (ms)"


def named(pair: str) -> str:
    """Of `in_words`, with its name and unit.

    >>> named("1&10"), named(NONE)
    ('t_ref 1&10 ms', 'no t_ref')
    """
    return "no t_ref" if pair == NONE else f"t_ref {pair} ms"


def in_ms(pair: str) -> str:
    """Of `in_words`, with its unit.

    >>> in_ms("1&10"), in_ms(NONE)
    ('1&10 ms', 'no t_ref')
    """
    return named(pair).removeprefix("t_ref ")


def sizes(pair: str) -> tuple[float, ...]:
    """Of `in_words`, as numbers.

    >>> sizes("1&10"), sizes(NONE)
    ((1.0, 10.0), ())
    """
    return () if pair == NONE else tuple(map(float, pair.split("&")))


def is_short(pair: str, sample_ms: float) -> bool:
    """Whether a refractory period of `in_words` is shorter than a sample of the sensor.

    >>> is_short("1&10", 6.7), is_short("7&7", 6.7), is_short(NONE, 6.7)
    (True, False, False)
    """
    return any(size < sample_ms for size in sizes(pair))
