"""Events in long recordings, such as contact and slip: what a detector learns of windows, each labelled at its end.

Its recordings and its network: `neurotact_parts.streams.long_recordings`; when an event begins: `.detector` there.
"""

from typing import Any

import torch
from pydantic import Field

from neurotact import plugins
from neurotact.data import marks
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import Windows
from neurotact.errors import InputError
from neurotact.spec import Spec

TARGET = "events"
"""The target of a detector, in place of the names of conditions."""


def tool(name: str) -> Any:
    """A function of the package beside this one that has detectors."""
    return plugins.load_function("tools", name)


class DetectorSpec(Spec):
    """When an event begins: a label leads the others by more than `threshold` in `steps` steps of the network.

    heard_s, false_alarms: the recordings without training on which this was chosen, and what it had there; if known.
    """

    threshold: float = Field(ge=0)
    steps: int = Field(ge=1)
    heard_s: float = Field(default=0.0, exclude_if=lambda heard_s: not heard_s)
    false_alarms: int = Field(default=0, exclude_if=lambda n: not n)


def names_of(trains: SpikeTrains) -> tuple[str, ...]:
    """The labels in time, first `marks.NONE`; InputError without marks."""
    if trains.marks is None or not len(trains.marks):
        raise InputError(
            "target: 'events' needs annotations in time, and the spikes have none; import the recordings with "
            "`keep_whole`, or give nt.Recordings(..., marks=), and encode them again"
        )
    return (marks.NONE, *sorted(trains.marks["label"].unique()))


def labels_of(trains: SpikeTrains, windows: Windows) -> torch.Tensor:
    """The label in force at the end of each window, `(window,)` int64, an index into `names_of`."""
    index = {name: number for number, name in enumerate(names_of(trains))}
    assert trains.marks is not None
    found = marks.labels_at(trains.marks, windows.trial, (windows.start + windows.n_steps) / trains.sampling_rate_Hz)
    return torch.tensor([index[label] for label in found], dtype=torch.int64)


def in_parts(trains: SpikeTrains, n: int) -> SpikeTrains:
    """Each recording cut in time into at most `n` parts, which are trials."""
    return trains if n == 1 else tool("recordings_in_parts")(trains, n)
