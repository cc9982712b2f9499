"""Rows of a ROS topic (`rostopic echo -p`, `ros2 topic echo --csv`, bagpy): the header of a message is no taxel."""

import re

import numpy as np

from neurotact.data.readers.tables import TextTable, columns_at
from neurotact.data.readers.usual_rows import is_sample

HEADER = re.compile(r"(.*[./_])?header[./_](seq|stamp|frame_id)\b.*", re.ASCII)
"""The names of its columns."""
FIELDS = 3
"""Columns of the header in ROS 2: seconds, nanoseconds, the name of the frame."""
SECOND_NS = 10**9
LEAST_NS = 1000
"""Nanoseconds that a clock shows at least once; a number of a trial or a finger is smaller."""


def is_header(name: str) -> bool:
    """Whether a column is of the header of a message.

    >>> [is_header(name) for name in ("field.header.stamp", "header.stamp.secs", "header", "pressure")]
    [True, True, False, False]
    """
    return bool(HEADER.fullmatch(name))


def stamps_of(table: TextTable) -> np.ndarray | None:
    """The stamps of ROS 2 messages in seconds from the first one on, `(row,)`; None if the columns are something else.

    `ros2 topic echo --csv` names no column, and begins each row with the header of the message, if it has one.
    """
    seconds, nanoseconds, frame = (*table.first_row[:FIELDS], "", "", "")[:FIELDS]
    if table.names or table.n_columns <= FIELDS or is_sample(frame) or not (seconds + nanoseconds).isdigit():
        return None
    second, rest_ns = columns_at(table, [0, 1])
    if second.dtype.kind not in "iu" or rest_ns.dtype.kind not in "iu":
        return None
    if not (LEAST_NS <= rest_ns.max() < SECOND_NS and min(second.min(), rest_ns.min()) >= 0):
        return None
    since_first = (second - second[0]).astype(np.float64) * SECOND_NS + (rest_ns - rest_ns[0])
    return since_first / SECOND_NS if (np.diff(since_first) >= 0).all() and since_first[-1] > 0 else None
