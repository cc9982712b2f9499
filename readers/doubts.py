"""What speaks against the way recordings were read: values, lengths and counts that signals of touch rarely have.

Each doubt is one sentence with its fix. None refuses: a rare sensor may be as it seems. What nearly all samples or
trials show is doubted, too: a pause, a glitch or one good trial does not make a clock a taxel.
"""

import logging
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from neurotact_parts.readers.clock.stamps import GAP, OF_GIVEN_RATE, OF_STAMPS, of_rate

from neurotact.data.readers.clock.units import UNIT_S
from neurotact.data.readers.table.cells import LOOKED_AT, NEAR_IN_FLOAT32, has_decimals
from neurotact.data.readers.table.headings import UNITS
from neurotact.data.recordings import Recordings
from neurotact.errors import some
from neurotact.lazily import lazily

with lazily():
    from neurotact import checks


log = logging.getLogger("neurotact")

RASTER = "neurotact import raster reads spikes, of arrays or of a folder of files"
MOST_COUNTED, SILENT = 5, 0.9
"""Whole numbers up to the first, of which the second share at least is 0, look like spikes that were counted."""
ENDS = tuple(float(2**bits - 1) for bits in (7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 18, 20, 23, 24, 31, 32))
"""Highest values of converters of so many bits; of one with signs, the lowest is the negative of one more."""
AT_THE_END = 0.05
"""Share of the samples at a converter's end above which the signal is cut off."""
LEAST_RISING = 20
"""Samples of a trial, one at least, from which on a taxel that rises in every trial is a doubt."""
EVEN = 0.1
"""Share of its rise by which a time stamp or a counter may deviate from a straight line; a touch deviates more."""
FEW, RARE = 0.01, 0.001
"""Shares of steps or samples, and of the samples of a taxel that is mostly at rest, that are exceptions to a doubt."""
NUMBERS, AXIS = re.compile(r"\d+"), re.compile(r"[xyz](?![a-z])")
"""In which the names of taxels differ, in small letters."""
LEAST_TRIALS = 10
"""Trials from which on a class of its own for each of them is a doubt."""


class Fixes(NamedTuple):
    """How an import is given again, in words. drop: without a taxel that is none. stamps: with a column of time stamps,
    before `drop`. axes: with other axes; empty if they cannot be wrong.
    """

    drop: str
    stamps: str = ""
    axes: str = ""


class _Values(NamedTuple):
    """What the samples of all trials are: of each taxel, `(taxel,)`, and of all.

    constant: has one value throughout; steady: one value within each trial, `usual`, `(trial, taxel)`; rising: rises
    evenly within each trial; all with few exceptions. is_constant: without any. ends: the highest and lowest samples of
    trials. n_whole, n_zeros, n_bits, n_counted: whole numbers, and those that are 0, 0 or 1, or few.
    """

    constant: np.ndarray
    is_constant: bool
    steady: np.ndarray
    rising: np.ndarray
    usual: np.ndarray
    ends: Counter[float]
    n_samples: int
    n_whole: int
    n_zeros: int
    n_bits: int
    n_counted: int


def _nearly_all(count: int, n: int, few: float = FEW) -> bool:
    """Whether so many of `n` trials or samples are all but few; of at least four one may be an exception."""
    return n - count <= max(int(n >= 4), few * n)


def say_doubts(recordings: Recordings, where: str, fixes: Fixes, *, rate_is_given: bool = True) -> None:
    """Warn of what speaks against recordings as they were read; `where` begins each line.

    rate_is_given: whether the sampling rate was not found from time stamps.
    """
    for doubt in doubts(recordings, fixes, rate_is_given=rate_is_given):
        log.warning("%s: %s", where, doubt)


def doubts(recordings: Recordings, fixes: Fixes, *, rate_is_given: bool = True) -> Iterator[str]:
    """The doubts that `say` prints, one sentence each.

    >>> import pandas as pd
    >>> raster = (np.random.default_rng(0).random((2, 90, 3)) < 0.3).astype(float)
    >>> taps = Recordings(raster, 1000.0, "mV", pd.DataFrame({"label": ["tap", "rub"]}))
    >>> print(*doubts(taps, Fixes("use `columns`")))
    every sample is 0 or 1, as of a raster; neurotact import raster reads spikes, of arrays or of a folder of files
    """
    values = _values_of(recordings.signals)
    is_spikes = _are_spikes(values)
    if is_spikes:
        yield is_spikes
    yield from _of_taxels(recordings, values, fixes, is_spikes=bool(is_spikes))
    if are_thousandths(recordings.signals):
        yield (
            "the samples have three decimals and none lies between 0 and 1, as if separators of thousands were read as "
            "decimal points; if so, write whole numbers without them"
        )
    yield from _of_lengths(recordings, fixes.axes)
    fix = OF_GIVEN_RATE if rate_is_given else OF_STAMPS
    yield from of_rate(recordings.lengths, recordings.sampling_rate_Hz, fix)
    yield from _of_classes(recordings)


def say_unit(said: Mapping[str, str], given: str, where: str) -> None:
    """Warn of a unit that a file says of its signals and that is not the given one.

    said: units, by what says them; of those that are none of touch, nothing is known.
    """
    own, others = _plain(given), {}
    for name, unit in said.items():
        if (its := _plain(unit)) in KNOWN and its != own:
            others.setdefault(SYMBOLS.get(unit.strip().lower(), unit.strip("[]() ")), []).append(name)
    for unit, names in others.items():
        log.warning("%s: says %s (%s), but %s is given and used", where, unit, some(names, 2), given)


def units_in(names: Sequence[str]) -> dict[str, str]:
    """The units in the names of taxels, by the names; one letter is a unit if all names of several end in it.

    >>> units_in(["force_mV", "heat [kPa]", "pad_A"]), units_in(["left_N", "right_N"]), units_in(["pad_A"])
    ({'force_mV': 'mV', 'heat [kPa]': 'kPa'}, {'left_N': 'N', 'right_N': 'N'}, {})
    """
    found = {name: match[1] or match[2] for name in names if (match := UNIT_AT_END.search(name))}
    are_units = len(names) == len(found) > 1 and len({*found.values()}) == 1
    return {name: unit for name, unit in found.items() if are_units or len(unit) > 1 or not name.endswith(f"_{unit}")}


def _plain(unit: str) -> str:
    """A unit as another one is compared with it."""
    text = SYMBOLS.get(unit.strip().lower(), unit.strip("[]() ")).replace("µ", "u").replace("μ", "u").casefold()
    return "count" if text == "counts" else text


SYMBOLS = {"volts": "V", "volt": "V", "newtons": "N", "newton": "N", "pascals": "Pa", "amperes": "A", "meters": "m"}
"""Short names of units that NWB spells out."""
UNIT_AT_END = re.compile(r"[\[(]\s*([^\s\[\]()]+)\s*[\])]$|_([^\W\d_]+)$")
"""The unit at the end of a name: in brackets, or after a line."""
KNOWN = {_plain(unit) for unit in UNITS} - {"-", *UNIT_S}
"""Units of signals of touch."""


def kinds_of_names(names: Sequence[str]) -> str:
    """What is to be said of columns that are all taken as taxels, though numbered ones have others beside them.

    Empty if there is nothing to say. Names are of one kind if they differ in numbers or in an axis, x, y or z, alone.

    >>> kinds_of_names(["p1", "p2", "p3", "heat1", "heat2"])
    "names of 2 kinds are all taken as taxels: p1 to p3, heat1 to heat2; if some are none, name the taxels with \
`columns`, as in `columns='p1-p3'`"
    >>> kinds_of_names(["x1", "y1", "x2", "y2"]), kinds_of_names(["left", "right"])
    ('', '')
    """
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(AXIS.sub("x", NUMBERS.sub("1", name.lower())), []).append(name)
    numbered = [its for kind, its in kinds.items() if "1" in kind and len(its) > 1]
    if len(kinds) == 1 or not numbered:
        return ""
    most = max(numbered, key=len)
    shown = some([its[0] if len(its) == 1 else f"{its[0]} to {its[-1]}" for its in kinds.values()])
    is_range = [*names][names.index(most[0]) : names.index(most[-1]) + 1] == most
    given = f", as in `columns='{most[0]}-{most[-1]}'`" if is_range else ""
    return (
        f"names of {len(kinds)} kinds are all taken as taxels: {shown}; if some are none, name the taxels with "
        f"`columns`{given}"
    )


def are_thousandths(signals: Sequence[np.ndarray] | np.ndarray) -> bool:
    """Whether nearly all samples are as whole numbers of which a separator of thousands made decimals.

    A mean of few counts has few decimals, too, but those of a half, a quarter or an eighth.

    >>> are_thousandths([np.array([[1.234], [2.718], [850.0], [1.415]])]), are_thousandths([np.arange(4.0)[:, None]])
    (True, False)
    """
    n_such = n_other = n_samples = 0
    for signal in signals:
        size = np.abs(signal[:LOOKED_AT]).ravel()
        near = 1e-6 if size.dtype == np.float64 else NEAR_IN_FLOAT32
        fits = (size < 1000) & ((size >= 1) | (size == 0))
        its = size[fits]
        n_such += int(has_decimals(its, 3, near).sum())
        n_other += int((~has_decimals(8 * its, 0, near)).sum())
        n_samples += size.size
    return _nearly_all(n_such, n_samples) and 2 * n_other > n_samples


def _values_of(signals: Sequence[np.ndarray] | np.ndarray) -> _Values:
    usual = np.stack([_usual(signal) for signal in signals])
    typical = _usual(usual)
    n_taxels = len(typical)
    n_constant, n_steady, n_rising = (np.zeros(n_taxels, np.int64) for _ in range(3))
    n_rows = n_long = n_whole = n_zeros = n_bits = n_counted = 0
    ends: Counter[float] = Counter()
    for signal, its in zip(signals, usual, strict=True):
        n_same = (signal == its).sum(axis=0)
        n_constant += n_same if (its == typical).all() else (signal == typical).sum(axis=0)
        n_steady += [_nearly_all(n, len(signal)) for n in n_same.tolist()]
        n_long += len(signal) >= LEAST_RISING
        n_rising += _rises(signal)
        is_whole = signal == np.floor(signal)
        n_whole += int(is_whole.sum())
        zeros = int((signal == 0).sum())
        n_zeros += zeros
        n_bits += zeros + int((signal == 1).sum())
        n_counted += int((is_whole & (signal >= 0) & (signal <= MOST_COUNTED)).sum())
        ends.update([*signal.max(axis=0).tolist(), *signal.min(axis=0).tolist()])
        n_rows += len(signal)
    return _Values(
        np.array([_nearly_all(n, n_rows, RARE) for n in n_constant.tolist()]),
        bool((n_constant == n_rows).all()),
        np.array([_nearly_all(n, len(usual)) for n in n_steady.tolist()]),
        np.array([n_long > 0 and _nearly_all(n, len(usual)) for n in n_rising.tolist()]),
        usual, ends, n_rows * n_taxels, n_whole, n_zeros, n_bits, n_counted,
    )  # fmt: skip


def _usual(signal: np.ndarray) -> np.ndarray:
    """The lower median of some samples of each taxel, which is one of its values."""
    signal = signal[:: max(1, len(signal) // LOOKED_AT)]
    middle = (len(signal) - 1) // 2
    return np.partition(signal, middle, axis=0)[middle]


def _rises(signal: np.ndarray) -> np.ndarray:
    """Of each taxel of `(time, taxel)`, whether it rises evenly, but for few steps: a pause, or a new start."""
    if len(signal) < 2:
        return np.zeros(signal.shape[1], bool)
    rises = ((signal[1:] < signal[:-1]).mean(axis=0) <= FEW) & (signal[1:] > signal[:-1]).any(axis=0)
    for taxel in np.flatnonzero(rises):
        its = np.diff(signal[:, taxel].astype(np.float64))
        line = np.cumsum(np.clip(its, 0.0, GAP * np.median(its[its > 0])))
        even = np.linspace(line[0], line[-1], len(line))
        rises[taxel] = np.abs(line - even).max() <= EVEN * (line[-1] - line[0])
    return rises


def _are_spikes(values: _Values) -> str:
    """Whether samples look like spikes, in words; empty if they do not."""
    n_filled = values.n_samples - values.n_zeros
    if not values.n_zeros or not n_filled:
        return ""
    n_ones, n_counted = values.n_bits - values.n_zeros, values.n_counted - values.n_zeros
    most = (1 - FEW) * n_filled
    if n_ones and n_ones >= most:
        return f"{_every(n_ones, n_filled)} sample is 0 or 1, as of a raster; {RASTER}"
    if n_counted >= most and values.n_zeros >= SILENT * values.n_samples:
        each = _every(n_counted, n_filled)
        return (
            f"{each} sample is a whole number from 0 to {MOST_COUNTED}, and most are 0, as of counted spikes; {RASTER}"
        )
    return ""


def _every(count: int, n: int) -> str:
    return "every" if count == n else "nearly every"


def _of_taxels(recordings: Recordings, values: _Values, fixes: Fixes, *, is_spikes: bool) -> Iterator[str]:
    names = np.array(recordings.channels)
    if recordings.lengths.max() == 1:
        return
    if values.constant.all():
        every = "every" if values.is_constant else "nearly every"
        yield f"{every} sample is {_usual(values.usual)[0]:g}, so nothing was recorded; check the file"
        return
    if values.constant.any() and not is_spikes:
        yield f"every sample has the same value in {some(names[values.constant].tolist())}; {fixes.drop}"
    if values.rising.any() and not values.rising.all():
        named = some(names[values.rising].tolist())
        yield f"{named} rises throughout every trial, as time stamps or a counter do; {fixes.stamps}{fixes.drop}"
    steady = np.flatnonzero(values.steady & ~values.constant)
    telling = [taxel for taxel in steady.tolist() if _tells_the_class(recordings, values.usual[:, taxel])]
    if telling:
        named = some(names[telling].tolist())
        yield f"{named} has one value for each class, as a label does, which would tell a network; {fixes.drop}"
    cut = _share_at_an_end(recordings, values)
    if cut is not None:
        end, share = cut
        yield (
            f"{100 * share:.0f} % of all samples are {end:g}, the end of a converter, where a signal is cut off; lower "
            "the sensor's gain, or drop these trials"
        )


def _tells_the_class(recordings: Recordings, of_trials: np.ndarray) -> bool:
    """Whether a value of each trial is one for each class, and another for each other class, but for few trials."""
    labels, n_classes = recordings.labels, len(recordings.classes)
    usual = [Counter(of_trials[labels == label].tolist()).most_common(1)[0] for label in range(n_classes)]
    n_usual = sum(n for _, n in usual)
    return len({value for value, _ in usual}) == n_classes < len(labels) and _nearly_all(n_usual, len(labels))


def _share_at_an_end(recordings: Recordings, values: _Values) -> tuple[float, float] | None:
    """The end of a converter at which too many samples are, and their share; None if there is none."""
    if not _nearly_all(values.n_whole, values.n_samples):
        return None
    ends = [end for end in values.ends if end in ENDS or (end < 0 and -end - 1 in ENDS)]
    for end in sorted(ends, reverse=True):
        share = sum(int((signal == end).sum()) for signal in recordings.signals) / values.n_samples
        if share > AT_THE_END:
            return end, share
    return None


def _of_lengths(recordings: Recordings, axes: str) -> Iterator[str]:
    lengths = recordings.lengths
    if lengths.max() == 1:
        yield "every trial has one sample, as features without time have, of which no afferent fires; give the signals"
    elif (lengths == 1).any():
        yield f"{(lengths == 1).sum()} of {len(lengths)} trials have one sample; leave them out, or check the trials"
    if axes and (doubt := checks.swapped(int(np.median(lengths)), recordings.n_channels, "taxel", axes)):
        yield doubt


def _of_classes(recordings: Recordings) -> Iterator[str]:
    n_classes, n_trials = len(recordings.classes), len(recordings)
    if n_trials >= LEAST_TRIALS and _nearly_all(n_classes, n_trials):
        each = f"{'each' if n_classes == n_trials else 'nearly each'} of the {n_trials} trials"
        yield (
            f"{each} has a class of its own ({some(list(recordings.classes), 3)}), so none can be learned and tested; "
            "if these are numbers of trials or measured values, name another class"
        )
