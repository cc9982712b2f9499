"""TDMS files of LabVIEW: each group of channels is a trial. The package npTDMS reads them."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurotact.data.readers.clock.split import joined
from neurotact.data.readers.clock.stamps import unit_in
from neurotact.data.readers.columns import LayoutSpec, Table, chosen_places
from neurotact.data.readers.formats.contents import TDMS, check_content
from neurotact.data.readers.formats.numpy_files import as_signal
from neurotact.errors import InputError, nearest, optional, some
from neurotact.files import check_size, existing

TDMS_SUFFIX = ".tdms"
INTERVAL_S = "wf_increment"
"""The property of a channel with the interval of its samples."""
VALUE_BYTES = 8
SAME = 1e-9
"""Share by which intervals of channels may differ."""


class _Group(NamedTuple):
    """The channels of a group by their names, those of times in seconds; and the names of those that are neither.

    intervals_s: of the channels that have one.
    """

    numbers: dict[str, np.ndarray]
    times: dict[str, np.ndarray]
    others: list[str]
    intervals_s: dict[str, float]


def read_groups(path: str | Path, layout: LayoutSpec, *, find_time: bool = True) -> dict[str, Table]:
    """The groups of a TDMS file by their names, their channels of numbers as taxels.

    layout: the channels that are taxels, the one that is the time, and the group (`array`), if not each is a trial.
    find_time: whether a channel that the layout does not name may be the time, by its name or because it holds times;
    without one, the time follows from the interval of the channels, if they have one.

    InputError without npTDMS, for a damaged file, and for channels of different lengths or intervals.
    """
    path = existing(path)
    check_size(path, path.stat().st_size)
    check_content(path, TDMS, wanted="a TDMS file", fix="export it from LabVIEW again")
    needed = "npTDMS is needed to read TDMS files; pip install 'neurotact[tdms]'"
    file_class = optional("nptdms", f"{path}: {needed}").TdmsFile
    with _heard() as warnings:
        found_groups = _groups(path, file_class)
    groups = {name: group for name, group in found_groups.items() if group.numbers}
    if not groups:
        raise InputError(f"{path}: holds no channel of numbers; save the samples of each taxel as a channel")
    if layout.array is not None and layout.array not in groups:
        raise InputError(f"{path}: holds no group '{layout.array[:40]}' of numbers; {nearest(layout.array, [*groups])}")
    notes = tuple(f"npTDMS says: {warning.getMessage()[:80]}" for warning in warnings[:1])
    tables = {
        name: _table(group, layout, path, name, find_time=find_time)
        for name, group in groups.items()
        if layout.array in (None, name)
    }
    return {name: table._replace(notes=(*notes, *table.notes)) for name, table in tables.items()}


@contextmanager
def _heard() -> Iterator[list[logging.LogRecord]]:
    """The warnings of npTDMS, such as that of a file that was cut off, which it would print one by one."""
    ear = BufferingHandler(sys.maxsize)
    ear.setLevel(logging.WARNING)
    loggers = [logging.getLogger(name) for name in [*logging.root.manager.loggerDict] if name.startswith("nptdms.")]
    before = [(logger, logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [ear], False
    try:
        yield ear.buffer
    finally:
        for logger, handlers, propagates in before:
            logger.handlers, logger.propagate = handlers, propagates


def _groups(path: Path, file_class: Any) -> dict[str, _Group]:
    try:
        # opened here, because npTDMS leaves a damaged file open
        with path.open("rb") as stream, file_class.open(stream) as file:
            channels = {group.name: group.channels() for group in file.groups()}
            check_size(path, VALUE_BYTES * sum(len(channel) for group in channels.values() for channel in group))
            return {name: _group(group) for name, group in channels.items()}
    except InputError:
        raise
    except Exception as error:  # damaged bytes make npTDMS and numpy raise nearly anything
        why = (str(error).splitlines() or [type(error).__name__])[0][:80]
        raise InputError(f"{path}: is a damaged TDMS file ({why}); save or copy it again") from error


def _group(channels: list[Any]) -> _Group:
    group = _Group({}, {}, [], {})
    for channel in channels:
        values = np.asarray(channel[:])
        if values.dtype.kind in "iuf" and len(values):
            group.numbers[channel.name] = values
        elif values.dtype.kind == "M" and len(values):
            group.times[channel.name] = (values - values[0]) / np.timedelta64(1, "s")
        else:
            group.others.append(channel.name)
        if channel.properties.get(INTERVAL_S):
            group.intervals_s[channel.name] = float(channel.properties[INTERVAL_S])
    return group


def _table(group: _Group, layout: LayoutSpec, path: Path, name: str, *, find_time: bool) -> Table:
    where = f"{path}, group '{name[:40]}'"
    channels = {**group.numbers, **group.times}
    names = tuple(channels)
    chosen, time_at, rest_at = chosen_places(
        layout.columns, layout.time_column, names, [""] * len(names), path, find_time=find_time
    )  # fmt: skip
    time_name = names[time_at] if time_at is not None else next(iter(group.times), None) if find_time else None
    stamps_at = [name for name in (time_name, None if rest_at is None else names[rest_at]) if name is not None]
    taxels = [names[column] for column in chosen] or [name for name in group.numbers if name not in stamps_at]
    if not taxels:
        raise InputError(f"{where}: has no channel besides the time; save the samples of each taxel as a channel")
    lengths = {name: len(channels[name]) for name in [*taxels, *stamps_at]}
    if len(set(lengths.values())) > 1:
        shown = some([f"{name} {length}" for name, length in lengths.items()])
        raise InputError(f"{where}: has channels of different lengths ({shown}); choose the taxels with `columns`")
    signal = as_signal(np.stack([channels[name] for name in taxels], axis=1), where)
    notes = (f"holds no number, so no taxel: {some(group.others)}",) if group.others and not chosen else ()
    its = Table(tuple(taxels), signal, None, 0, layout.time_unit, notes)
    if rest_at is not None:
        seconds, rest = (channels[name].astype(np.float64) for name in stamps_at)
        time = joined(seconds, rest, names[rest_at], where, 0, layout.time_unit)
        return its._replace(time=time, time_unit="s")
    if time_name is not None:
        unit = "s" if time_name in group.times else layout.time_unit or unit_in(time_name)
        return its._replace(time=channels[time_name].astype(np.float64), time_unit=unit)
    intervals_s = [group.intervals_s[name] for name in taxels if name in group.intervals_s]
    if not find_time or len(intervals_s) < len(taxels):
        return its
    if max(intervals_s) - min(intervals_s) > SAME * max(intervals_s):
        raise InputError(f"{where}: has channels of different intervals; choose taxels of one with `columns`")
    return its._replace(time=np.arange(len(signal)) * intervals_s[0], time_unit="s")
