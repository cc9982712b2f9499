"""Bags of ROS 1 and 2, which the package rosbags reads: a table for each topic, a column for each number in it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from neurotact.data.readers.formats import Format
from neurotact.data.readers.formats.contents import MCAP, ROS_BAG, SQLITE
from neurotact.data.readers.table.cells import MAX_CHANNELS, Table, table_of
from neurotact.errors import InputError, optional
from neurotact.files import check_size

NUMBER_BYTES = 100
"""Memory of a number with its name, while messages are read."""
TIME = "time_ns"
"""The column of times: the stamp of a message's header, else when the message was recorded."""


def _read(path: Path) -> dict[str, Table]:
    """The topics of a bag by their names, of messages that all have the same numbers; a note names the others."""
    needed = f"{path}: rosbags is needed to read bags of ROS; pip install 'neurotact[ros]'"
    highlevel = optional("rosbags.highlevel", needed)
    stores = optional("rosbags.typesys", needed)
    rows: dict[str, list[dict[str, Any]]] = {}
    n_bytes = 0
    usual = stores.get_typestore(stores.Stores.LATEST)
    with highlevel.AnyReader([path], default_typestore=usual) as bag:
        for connection, recorded_ns, raw in bag.messages():
            row = dict(_numbers(bag.deserialize(raw, connection.msgtype), ""))
            stamp = row.pop("header.stamp.sec", 0) * 10**9 + row.pop("header.stamp.nanosec", 0)
            rows.setdefault(connection.topic, []).append({TIME: stamp or recorded_ns, **row})
            n_bytes += NUMBER_BYTES * (1 + len(row))
            check_size(path, n_bytes)
    alike = {
        topic: its for topic, its in rows.items() if len(its[0]) > 1 and all(row.keys() == its[0].keys() for row in its)
    }  # fmt: skip
    if not alike:
        raise InputError(f"{path}: holds no topic whose messages all have the same numbers; save its samples as CSV")
    others = [topic for topic in rows if topic not in alike]
    notes = [f"topics without numbers, or with another number of them in each message: {', '.join(others)}"]
    return {
        topic.lstrip("/"): table_of(
            f"{path}, topic '{topic[:40]}'", {name: np.array([row[name] for row in its]) for name in its[0]},
            notes=notes if others else (),
        )
        for topic, its in alike.items()
    }  # fmt: skip


def _numbers(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The numbers in a message, and in the messages and arrays in it, by their names: `wrench.force.x`, `data.0`."""
    if isinstance(value, (bool, int, float, np.number)):
        yield name, value
    elif isinstance(value, (list, np.ndarray)):
        for place, each in enumerate(value[:MAX_CHANNELS]):
            yield from _numbers(each, f"{name}.{place}")
    elif hasattr(value, "__dataclass_fields__"):
        for field in value.__dataclass_fields__:
            if not field.startswith("__") and field != "layout":
                yield from _numbers(getattr(value, field), f"{name}.{field}" if name else field)


FORMAT = Format("a bag of ROS", "record it again with rosbag or ros2 bag", _read, contents=(ROS_BAG, MCAP, SQLITE))
