"""TDMS files of LabVIEW: a table for each group of channels. The package npTDMS reads them."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import BufferingHandler
from pathlib import Path

import numpy as np

from neurotact.data.readers.formats import Format
from neurotact.data.readers.formats.contents import TDMS
from neurotact.data.readers.table.cells import Table, table_of
from neurotact.errors import InputError, optional, some
from neurotact.files import check_size

INTERVAL_S = "wf_increment"
"""The property of a channel with the interval of its samples."""
UNIT = "unit_string"
"""The property of a channel with the unit of its samples."""
VALUE_BYTES = 8


def _read(path: Path) -> dict[str, Table]:
    """The groups of a file by their names, of their channels those of numbers and of times."""
    needed = "npTDMS is needed to read TDMS files; pip install 'neurotact[tdms]'"
    file_class = optional("nptdms", f"{path}: {needed}").TdmsFile
    with (
        _heard() as warnings,
        path.open("rb") as stream,  # because npTDMS leaves a damaged file open
        file_class.open(stream) as file,
    ):
        channels = {group.name: group.channels() for group in file.groups()}
        check_size(path, VALUE_BYTES * sum(len(channel) for group in channels.values() for channel in group))
        held = {name: [(each, np.asarray(each[:])) for each in group] for name, group in channels.items()}
    said = [f"npTDMS says: {warning.getMessage()[:80]}" for warning in warnings[:1]]
    tables = {}
    for name, group in held.items():
        used = [(channel, values) for channel, values in group if values.dtype.kind in "iufM" and len(values)]
        others = [channel.name for channel, values in group if values.dtype.kind not in "iufM" or not len(values)]
        if any(values.dtype.kind in "iuf" for _, values in used):
            notes = [*said, *([f"holds no number, so no taxel: {some(others)}"] if others else [])]
            intervals_s = [float(channel.properties.get(INTERVAL_S) or 0) or None for channel, _ in used]
            columns = {channel.name: values for channel, values in used}
            units = tuple(str(channel.properties.get(UNIT) or "") for channel, _ in used)
            its = table_of(f"{path}, group '{name[:40]}'", columns, intervals_s, notes)
            tables[name] = its._replace(units=units if any(units) else ())
    if not tables:
        raise InputError(f"{path}: holds no channel of numbers; save the samples of each taxel as a channel")
    return tables


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


FORMAT = Format("a TDMS file", "copy it, or export it from LabVIEW again", _read, contents=(TDMS,))
