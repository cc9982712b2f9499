"""Rows that share a time stamp, counted and said: how many are dropped, how many are spread."""

import logging
from collections.abc import Mapping

from neurotact.data.readers.clock import MOST_DROPPED, Stamps
from neurotact.errors import InputError

log = logging.getLogger("neurotact")


def say_dropped(stamps: Mapping[str, Stamps], drop_repeats: bool, where: str) -> None:
    """Say how many rows are dropped; InputError if they are many, and `drop_repeats` does not ask for it.

    stamps: of each trial that has any, by its name. where: of all trials, begins messages.
    InputError, too, if `drop_repeats` drops nothing.
    """
    fewer = {name: its for name, its in stamps.items() if its.n_dropped}
    if not fewer:
        if drop_repeats:
            why = "no row has the time stamp of the row before it" if stamps else "the samples have no time stamps"
            raise InputError(f"{where}: `drop_repeats`: {why}; leave it out")
        return
    n_rows, n_dropped = _rows(stamps), sum(its.n_dropped for its in fewer.values())
    which = f"in {len(fewer)} of {len(stamps)} trials; the first is {next(iter(fewer))}"
    if n_dropped > MOST_DROPPED * n_rows and not drop_repeats:
        raise InputError(
            f"{where}: {n_dropped:,} of {n_rows:,} rows repeat the row before them with its time stamp ({which}); drop "
            "them with `drop_repeats=True`, or give `sampling_rate_Hz` if each row is a sample of its own"
        )
    log.warning(
        "%s: %s of %s rows repeat the time stamp of the row before them and are dropped (%s)",
        where, f"{n_dropped:,}", f"{n_rows:,}", which,
    )  # fmt: skip


def say_shared(stamps: Mapping[str, Stamps], rate_Hz: float, where: str) -> None:
    """Say how many rows share the stamp of the row before them and are spread; rate_Hz: of the recordings."""
    shared = {name: its for name, its in stamps.items() if its.n_shared}
    if shared:
        n_shared = sum(its.n_shared for its in shared.values())
        log.warning(
            "%s: %s of %s rows have the time stamp of the row before them (in %d of %d trials); all are kept, spread "
            "evenly over the time to the next stamp, at %g Hz; if that is wrong, give `sampling_rate_Hz` or "
            "`drop_repeats=True`",
            where, f"{n_shared:,}", f"{_rows(shared):,}", len(shared), len(stamps), rate_Hz,
        )  # fmt: skip


def _rows(stamps: Mapping[str, Stamps]) -> int:
    return sum(len(its.keep) for its in stamps.values())
