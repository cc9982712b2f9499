"""The data that a page draws: frames of signals and spikes, and a mailbox for each page.

A frame is `length of the header (uint32) | header (JSON) | zeros to a multiple of 4 | arrays`, little-endian. Its
arrays, in order: minimum and maximum of each taxel in each bucket, `(bucket, taxel, 2)` float32; spikes of
afferents and spikes of hidden neurons, each `(event, 2)`: seconds after `t0_s` as float32, and the neuron as uint32.
"""

import json
from collections import deque
from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np
from neurotact_parts.streams.stream_state import Trace

BUCKETS_PER_S = 250.0
"""Columns of a signal per second of drawing; with a faster recording, a column holds many samples."""
MOST_BUCKETS = 2_000
MOST_EVENTS = 20_000
"""Maximum number of events in a frame. Further ones are not drawn, but counted."""
MOST_FRAMES, MOST_DECISIONS = 12, 2_000
"""Maximum number of frames that wait for a page; a newer one then replaces the oldest."""
EVENT = np.dtype([("after_s", "<f4"), ("neuron", "<u4")])


class FrameBuilder:
    """Collects signals and spikes since the last frame.

    sampling_rate_Hz, n_taxels: of the samples.
    """

    def __init__(self, sampling_rate_Hz: float, n_taxels: int) -> None:
        self.bucket = max(1, round(sampling_rate_Hz / BUCKETS_PER_S))
        self.bucket_s = self.bucket / sampling_rate_Hz
        self._rate_Hz = sampling_rate_Hz
        self._rest = np.empty((0, n_taxels), np.float32)
        self._next_sample = 0
        self.thinned = 0
        self.clear()

    def clear(self) -> None:
        """Delete the collected data."""
        self._columns: list[np.ndarray] = []
        self._begins: list[int] = []
        self._traces: list[Trace] = []
        self._n_columns, self._n_events = 0, 0
        self.marks: list[tuple[float, str]] = []

    def samples(self, block: np.ndarray, first: int) -> None:
        """Samples `(sample, taxel)` as received, `first` being the number of the first in the stream."""
        if first != self._next_sample:  # samples are missing in between
            self._rest = self._rest[:0]
        self._next_sample = first + len(block)
        values = np.concatenate([self._rest, block])
        begin = first - len(self._rest)
        whole = len(values) // self.bucket
        self._rest = values[whole * self.bucket :].copy()
        if not whole:
            return
        if self._n_columns + whole > MOST_BUCKETS:
            self.thinned += whole
            return
        parts = values[: whole * self.bucket].reshape(whole, self.bucket, -1)
        self._columns.append(np.stack([np.fmin.reduce(parts, axis=1), np.fmax.reduce(parts, axis=1)], axis=2))
        self._begins += range(begin, begin + whole * self.bucket, self.bucket)
        self._n_columns += whole

    def trace(self, trace: Trace) -> None:
        """Add the spikes."""
        n = int(trace.afferents.sum()) + int(trace.hidden.sum())
        if self._n_events + n > MOST_EVENTS:
            self.thinned += n
            return
        self._n_events += n
        self._traces.append(trace)

    def frame(self, about: dict[str, Any]) -> bytes:
        """A frame of the collected data, which is then deleted; `about` goes into its header."""
        begins = [first / self._rate_Hz for first in self._begins]
        t0_s = min([*begins[:1], *(trace.begin_s for trace in self._traces[:1])], default=0.0)
        afferents, hidden = (self._events(t0_s, name) for name in ("afferents", "hidden"))
        columns = np.concatenate(self._columns) if self._columns else np.empty(0, np.float32)
        header = {
            **about, "t0_s": t0_s, "begins_s": _runs(begins, self.bucket_s), "columns": self._n_columns,
            "afferents": len(afferents), "hidden": len(hidden), "marks": self.marks, "thinned": self.thinned,
        }  # fmt: skip
        self.clear()
        text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
        padding = b"\0" * (-len(text) % 4)
        arrays = (columns.astype("<f4").tobytes(), afferents.tobytes(), hidden.tobytes())
        return b"".join([len(text).to_bytes(4, "little"), text, padding, *arrays])

    def _events(self, t0_s: float, name: str) -> np.ndarray:
        parts = [np.empty(0, EVENT)]
        for trace in self._traces:
            steps, neurons = np.nonzero(getattr(trace, name))
            events = np.empty(len(steps), EVENT)
            events["after_s"] = trace.begin_s - t0_s + steps * trace.step_s
            events["neuron"] = neurons
            parts.append(events)
        return np.concatenate(parts)


def _runs(begins_s: list[float], bucket_s: float) -> list[tuple[float, int]]:
    """Runs of columns without a gap: the start time and the number of columns of each.

    >>> _runs([0.0, 0.5, 1.0, 3.0], 0.5)
    [(0.0, 3), (3.0, 1)]
    """
    runs: list[tuple[float, int]] = []
    for begin_s in begins_s:
        if runs and abs(runs[-1][0] + runs[-1][1] * bucket_s - begin_s) < 0.5 * bucket_s:
            runs[-1] = (runs[-1][0], runs[-1][1] + 1)
        else:
            runs.append((begin_s, 1))
    return runs


class Mailbox:
    """The queue for one page. Writers never wait: if the queue is full, the newest frames are kept.

    ring: called, in any thread, when the queue is no longer empty.
    is_greeted: whether the page has its first message; nothing else is queued before.
    dropped: frames replaced by newer ones before they were sent.
    """

    def __init__(self, ring: Callable[[], None]) -> None:
        self._ring, self._lock = ring, Lock()
        self._frames: deque[bytes] = deque(maxlen=MOST_FRAMES)
        self._state: str | None = None
        self._notes: deque[str] = deque(maxlen=16)
        self._decisions: deque[list[Any]] = deque(maxlen=MOST_DECISIONS)
        self._has_mail = False
        self.dropped = 0
        self.is_greeted = False

    def frame(self, frame: bytes) -> None:
        with self._lock:
            self.dropped += len(self._frames) == MOST_FRAMES
            self._frames.append(frame)
        self._arrived()

    def state(self, state: str) -> None:
        with self._lock:
            self._state = state
        self._arrived()

    def note(self, note: str) -> None:
        """A message for this page only, as JSON."""
        with self._lock:
            self._notes.append(note)
        self._arrived()

    def decisions(self, rows: list[list[Any]]) -> None:
        with self._lock:
            self._decisions.extend(rows)
        self._arrived()

    def take(self) -> list[str | bytes]:
        """The content of the queue, in the order of sending."""
        with self._lock:
            mail: list[str | bytes] = [*self._notes]
            if self._decisions:
                about = {"kind": "decisions", "rows": [*self._decisions], "dropped": self.dropped}
                mail.append(json.dumps(about, allow_nan=False, separators=(",", ":")))
            if self._state is not None:
                mail.append(self._state)
            mail += self._frames
            self._state, self._has_mail = None, False
            for waiting in (self._notes, self._decisions, self._frames):
                waiting.clear()
            return mail

    def _arrived(self) -> None:
        with self._lock:
            rings, self._has_mail = not self._has_mail, True
        if rings:
            self._ring()


class Audience:
    """The mailboxes of all connected pages."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._boxes: list[Mailbox] = []

    def join(self, box: Mailbox) -> None:
        with self._lock:
            self._boxes.append(box)

    def leave(self, box: Mailbox) -> None:
        with self._lock:
            self._boxes.remove(box)

    def each(self) -> list[Mailbox]:
        with self._lock:
            return [*self._boxes]

    def __len__(self) -> int:
        return len(self._boxes)
