"""Events in long recordings, such as contact and slip: what a detector learns, and how recordings are divided for it.

A network learns windows, each labelled by the mark in force at its end, and runs on through a whole recording: state
that is older than a window has decayed. When an event begins is told by `neurotact_parts.streams.detector`.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import torch
from pydantic import Field

from neurotact.data import marks
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import Windows, WindowSpec, steps_of
from neurotact.errors import InputError
from neurotact.networks.definition import recipe
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import Spec

log = logging.getLogger("neurotact")

TARGET = "events"
"""The target of a detector, in place of the names of conditions."""
LEFT = 0.01
"""Share of the response to a spike that may be left a window later."""
SHORTEST_MS, HOPS = 300.0, 4
"""Of windows that nobody gave: the least length, and how many begin within one."""
RECORDINGS = 10
"""With fewer recordings, each is cut in time into parts, as many as this together: sides of a split are of parts."""
FALSE_ALARMS_PER_H = 10.0
RECORDING, PART_S = "recording", "part_begin_s"
"""Conditions of a part: the recording that it is of, and when it begins there."""


class DetectorSpec(Spec):
    """When an event begins: a label leads the others by more than `threshold` in `steps` steps of the network."""

    threshold: float = Field(ge=0)
    steps: int = Field(ge=1)


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


def check_labels(labels: torch.Tensor) -> None:
    """Refuse training windows of one label."""
    if len(labels.unique()) < 2:
        raise InputError("target: all training windows end under one label; annotate more events, or split otherwise")


def in_parts(trains: SpikeTrains, n: int) -> SpikeTrains:
    """Each recording cut in time into `n` parts, as trials; a cut that falls into a mark is moved to its end.

    The parts of one recording are no copies of each other. Times of a part count from its begin.
    """
    if n == 1:
        return trains
    rate_Hz, rows, labelled = trains.sampling_rate_Hz, [], []
    table = pd.DataFrame(columns=marks.COLUMNS) if trains.marks is None else trains.marks
    for trial, n_steps in enumerate(trains.trial_steps.tolist()):
        own = table[table["trial"] == trial]
        for first, last in pairwise(_edges(n_steps, n, own, rate_Hz)):
            inside = own[(own["start_s"] >= first / rate_Hz) & (own["start_s"] < last / rate_Hz)]
            times = {key: (inside[key].clip(upper=last / rate_Hz) - first / rate_Hz) for key in marks.COLUMNS[1:3]}
            labelled.append(inside.assign(trial=len(rows), **times))
            rows.append((trial, first, last))
    of, first, last = np.array(rows).T
    kept = [np.searchsorted(trains.steps[trial], (a, b)) for trial, a, b in rows]
    of_parts = {
        name: tuple(f"{names[trial]}/{a}" for trial, a, _ in rows) if (names := getattr(trains, name)) else ()
        for name in ("trial_digests", "trial_touches")
    }
    conditions = trains.conditions.iloc[of].reset_index(drop=True)
    return replace(
        trains, steps=[trains.steps[row[0]][a:b] - row[1] for row, (a, b) in zip(rows, kept, strict=True)],
        units=[trains.units[row[0]][a:b] for row, (a, b) in zip(rows, kept, strict=True)], trial_steps=last - first,
        conditions=conditions.assign(**{RECORDING: of, PART_S: first / rate_Hz}), variations=None,
        marks=None if trains.marks is None else pd.concat(labelled, ignore_index=True), **of_parts,
    )  # fmt: skip


def _edges(n_steps: int, n: int, own: pd.DataFrame, rate_Hz: float) -> list[int]:
    """The steps at which the parts of a recording begin, and its end."""
    edges = {0, n_steps}
    for place in np.linspace(0, n_steps, n + 1)[1:-1].round().astype(int).tolist():
        for start, stop in own[["start_s", "stop_s"]].to_numpy() * rate_Hz:
            place = math.ceil(stop - 1e-6) if start <= place < stop else place
        edges.add(min(place, n_steps))
    return sorted(edges)


def parts_for(trains: SpikeTrains, window: WindowSpec) -> int:
    """In how many parts each recording is cut; told, with the windows that this drops."""
    n = math.ceil(RECORDINGS / len(trains))
    if n > 1:
        cuts = (trains.trial_steps, in_parts(trains, n).trial_steps)
        length, start, hop = steps_of(window, trains.sampling_rate_Hz)
        whole, cut = (int(np.maximum(0, (steps - start - length) // hop + 1).sum()) for steps in cuts)
        log.warning(
            "Split: by time, since there are %d recordings: each is cut into up to %d parts outside of marks; %d of %d "
            "windows, which would cross a cut, are dropped.", len(trains), n, whole - cut, whole,
        )  # fmt: skip
    return n


def left_after(taus_ms: Sequence[float], length_ms: float) -> float:
    """The share of the response to a spike, through exponentials one after another, that is left after a time.

    >>> round(left_after([10.0], 10.0), 2)
    0.37
    """
    from scipy.signal import lfilter

    response = np.eye(1, 20_000)[0]
    for tau_ms in taus_ms:
        response = lfilter([1.0], [1.0, -math.exp(-length_ms / 1000 / tau_ms)], response)
    return float(response[1000:].sum() / response.sum())


def _taus_ms(spec: RSNNSpec, length_ms: float) -> list[float]:
    """The time constants of a network for windows of a length: given ones, and those of the recipe."""
    shares = {"tau_syn_ms": recipe.TAU_SHARE, "tau_mem_ms": recipe.TAU_SHARE, "readout_tau_ms": recipe.READOUT_SHARE}
    is_given = {key: spec.recipe is None or key in spec.model_fields_set for key in shares}
    taus = [getattr(spec, key) if is_given[key] else length_ms / share for key, share in shares.items()]
    return [tau for tau in (*taus, spec.tau_adaptation_ms if spec.threshold_adaptation else None) if tau]


def window_for(window: WindowSpec, spec: RSNNSpec) -> WindowSpec:
    """The windows of a detector: what nobody gave is chosen such that older state has decayed; told."""
    if window.align != "trial":
        raise InputError("window.align: a detector has windows all along a recording; leave `align` out")
    length_ms = window.length_ms
    if "length_ms" not in window.model_fields_set:
        length_ms = SHORTEST_MS
        while left_after(_taus_ms(spec, length_ms), length_ms) > LEFT:
            length_ms += 10
    hop_ms = window.hop_ms or length_ms / HOPS
    log.warning(
        "Window: %g ms, one each %g ms, labelled at its end; after it less than %g %% of a response is left.",
        length_ms, hop_ms, 100 * LEFT,
    )  # fmt: skip
    return window.model_copy(update={"length_ms": length_ms, "hop_ms": hop_ms})


def check_network(spec: RSNNSpec, window: WindowSpec) -> None:
    """Refuse a network that cannot run on without windows: its state must decay, and within one."""
    if spec.own is not None or spec.model != "snn":
        raise InputError(
            f"model: '{spec.model}' may keep what is older than a window, and a detector runs on without; set 'snn'"
        )
    if spec.readout != "integrator" or spec.readout_tau_ms is None:
        raise InputError(
            "target: 'events' needs a readout that forgets; set readout = 'integrator' and readout_tau_ms, or leave "
            "them to network='default'"
        )
    taus_ms = _taus_ms(spec.model_copy(update={"recipe": None}), window.length_ms)
    if (left := left_after(taus_ms, window.length_ms)) > LEFT:
        fitting = window.length_ms
        while left_after(taus_ms, fitting) > LEFT:
            fitting *= 1.02
        raise InputError(
            f"window.length_ms: {window.length_ms:g} ms after a spike {100 * left:.2g} % of the response is left (time "
            f"constants of {', '.join(f'{tau:g}' for tau in taus_ms)} ms), more than {100 * LEFT:g} %; give at least "
            f"{math.ceil(fitting / 10) * 10} ms, or shorten readout_tau_ms"
        )


@torch.no_grad()
def values_of(network: Network, trains: SpikeTrains, trial: int) -> np.ndarray:
    """The value of each label after each whole step of the network, through a trial without reset, `(step, label)`."""
    n_steps = int(trains.trial_steps[trial]) // network.steps_per_bin * network.steps_per_bin
    whole = trains.raster(Windows(np.array([trial]), np.zeros(1, np.int64), n_steps))
    gained = network.simulate(torch.from_numpy(whole).to(network.device)).readout[0].cpu()
    integration = network.integration
    assert integration is not None
    return torch.stack([*integration.cpu().over(gained)]).numpy()
