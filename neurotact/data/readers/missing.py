"""Missing samples of recordings: interpolated, or their trials dropped, within limits and never without a word."""

import logging
from collections.abc import Sequence

import numpy as np

from neurotact.data.readers.layout import Missing
from neurotact.data.readers.sampled import Read
from neurotact.errors import InputError, some

MOST_INTERPOLATED = 0.05
"""Share of a trial's samples of a taxel that may be interpolated: more would be a signal that nobody recorded."""
MOST_DROPPED = 0.2
"""Share of the trials that may be dropped: more would be another set."""
log = logging.getLogger("neurotact")


def mended(read: Sequence[Read], how: Missing | None, where: str) -> tuple[list[Read], list[int]]:
    """The trials without missing samples, and their numbers in `read`.

    Logs how many samples are interpolated, or which trials are dropped. Raises InputError beyond the limits, and where
    nothing is missing.
    """
    everything = [*read], [*range(len(read))]
    if how is None:
        return everything
    marked = {number: trial for number, trial in enumerate(read) if trial.table.missing is not None}
    cut = [number for number, trial in enumerate(read) if trial.table.n_cut]
    if not marked and not cut:
        raise InputError(f"{where}: `missing='{how}'`: no sample is missing; leave it out")
    if how == "drop-trial":
        return _without(read, sorted({*marked, *cut}), where)
    if not marked:
        return everything  # lines without a sample, which leave a gap between stamps
    mended = [_interpolated(trial) if number in marked else trial for number, trial in enumerate(read)]
    n_missing = sum(int(trial.table.missing.sum()) for trial in marked.values() if trial.table.missing is not None)
    n_all = sum(trial.table.signal.size for trial in read)
    log.warning(
        "%s: %s of %s samples are missing and interpolated, in %d of %d trials (%s)",
        where, f"{n_missing:,}", f"{n_all:,}", len(marked), len(read), some([trial.file for trial in marked.values()]),
    )  # fmt: skip
    return mended, [*range(len(read))]


def _without(read: Sequence[Read], dropped: Sequence[int], where: str) -> tuple[list[Read], list[int]]:
    names = some([read[number].file for number in dropped])
    if len(dropped) > MOST_DROPPED * len(read):
        raise InputError(
            f"{where}: {len(dropped)} of {len(read)} trials have missing samples ({names}), more than "
            f"{100 * MOST_DROPPED:.0f} % to drop; record them again, or use `missing='interpolate'`"
        )
    log.warning("%s: %d of %d trials have missing samples and are dropped (%s)", where, len(dropped), len(read), names)
    kept = [number for number in range(len(read)) if number not in {*dropped}]
    return [read[number] for number in kept], kept


def _interpolated(trial: Read) -> Read:
    """The trial with missing samples on the line between their neighbours, and equal to the nearest one at the ends."""
    its, missing = trial.table, trial.table.missing
    assert missing is not None
    shares = missing.mean(axis=0)
    worst = int(np.argmax(shares))
    if shares[worst] > MOST_INTERPOLATED:
        name = its.names[worst] if its.names else f"taxel {worst + 1}"
        raise InputError(
            f"{trial.where}: {100 * shares[worst]:.1f} % of the samples of {name} are missing, more than "
            f"{100 * MOST_INTERPOLATED:.0f} % to interpolate; record it again, or use `missing='drop-trial'`"
        )
    signal, at = its.signal.copy(), np.arange(len(its.signal)) if its.time is None else its.time
    for taxel in np.flatnonzero(missing.any(axis=0)):
        gap = missing[:, taxel]
        signal[gap, taxel] = np.interp(at[gap], at[~gap], signal[~gap, taxel])
    return trial._replace(table=its._replace(signal=signal, missing=None))
