"""The network's clock: spikes of the encoder's clock, put into bins of one step of the network each.

An afferent whose spikes are at least `n` steps apart has at most one spike in `n` steps. The bins then lose no spike,
and the network is computed once a bin.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

from neurotact.errors import InputError

if TYPE_CHECKING:  # a clock needs no torch, only spikes do
    from torch import Tensor

NEARLY = 1e-6
"""How far a network's step may be from a whole number of the encoder's, of it: rates are not exact in decimals."""
AT_ONCE = 64
"""Windows whose spikes are listed together."""


def steps_per_bin(step_ms: float | str | None, sampling_rate_Hz: float, name: str = "step_ms") -> int:
    """Steps of the encoder's clock in one step of the network; 1 if `step_ms` is None or "encoder".

    Raises InputError, which calls the step `name`, unless they are a whole number, at least 1.

    >>> steps_per_bin(5.0, 1000.0), steps_per_bin(None, 1000.0)
    (5, 1)
    """
    if step_ms is None or isinstance(step_ms, str):
        return 1
    wanted = step_ms * 1e-3 * sampling_rate_Hz
    n = max(1, round(wanted))
    if abs(wanted - n) > NEARLY * n:
        raise InputError(
            f"{name}: {step_ms:g} ms is not a whole number of steps at {sampling_rate_Hz:g} Hz; "
            f"{n * 1e3 / sampling_rate_Hz:.6g} ms is"
        )
    return n


def binned(spikes: Tensor, n: int) -> Tensor:
    """Spikes `(trial, time, afferent)` in bins of `n` steps, `(trial, bin, afferent)` of the same type.

    An afferent that spikes in a bin has one spike there, however many it had. The last bin may be shorter. Of graded
    input a bin has the largest value.

    >>> import torch
    >>> binned(torch.tensor([[[0], [1], [0], [0], [1]]]), 2).flatten().tolist()
    [1, 0, 1]
    """
    import torch

    if n == 1:
        return spikes
    n_trials, n_steps, n_afferents = spikes.shape
    n_bins = -(-n_steps // n)
    if n_steps % n:
        spikes = torch.cat([spikes, spikes.new_zeros(n_trials, n_bins * n - n_steps, n_afferents)], dim=1)
    if spikes.dtype in (torch.uint8, torch.bool):
        return reduce(torch.bitwise_or, (spikes[:, k::n] for k in range(n)))
    return spikes.unflatten(1, (n_bins, n)).amax(dim=2)


def spread(spikes: Tensor, n: int, n_steps: int) -> Tensor:
    """Spikes `(trial, bin, neuron)` of a network at the last step of each bin, `(trial, time, neuron)`.

    >>> import torch
    >>> spread(torch.tensor([[[1], [0], [1]]]), 2, 5).flatten().tolist()
    [0, 1, 0, 0, 1]
    """
    import torch

    if n == 1:
        return spikes
    n_trials, n_bins, n_neurons = spikes.shape
    fine = spikes.new_zeros(n_trials, n_steps, n_neurons)
    fine[:, (torch.arange(1, n_bins + 1) * n).clamp(max=n_steps) - 1] = spikes
    return fine


def merged(spikes: Tensor, n: int) -> int:
    """How many spikes bins of `n` steps merge with another of the same afferent.

    >>> import torch
    >>> merged(torch.tensor([[[1], [1], [0], [0]]]), 2)
    1
    """
    return 0 if n == 1 else int(spikes.count_nonzero()) - int(binned(spikes, n).count_nonzero())


class _Close(NamedTuple):
    """Spikes that are close to another of their afferent, for 1, 2, 3, ... steps.

    following: how many are fewer steps than that after another one. merged: how many bins of so many steps merge, which
    is no more, whenever the bins begin.
    """

    following: tuple[int, ...]
    merged: tuple[int, ...]


def close(spikes: Tensor, most: int) -> _Close:
    """The close spikes of windows `(trial, time, afferent)`, for up to `most` steps.

    >>> import torch
    >>> close(torch.tensor([[[1], [1], [0], [1]]]), 4)
    _Close(following=(0, 1, 2, 2), merged=(0, 1, 1, 2))
    """
    import torch

    following, merged = torch.zeros(2, most, dtype=torch.int64)
    for part in spikes.split(AT_ONCE):
        *train, step = (part != 0).transpose(1, 2).nonzero(as_tuple=True)
        is_next = torch.stack([which[1:] == which[:-1] for which in train]).all(dim=0) & (step.diff() < most)
        one, other = step[:-1][is_next], step[1:][is_next]
        steps = range(1, most + 1)
        following += torch.tensor([int((other - one < n).sum()) for n in steps])
        merged += torch.tensor([int((one // n == other // n).sum()) for n in steps])
    return _Close(tuple(following.tolist()), tuple(merged.tolist()))


def in_words(n_merged: int, n_spikes: int) -> str:
    """How many of the input spikes are merged.

    >>> in_words(3, 1200)
    '3 of 1,200 input spikes (0.25 %) lie in one step of the network with another of the same afferent, and count once'
    """
    return (
        f"{n_merged:,} of {n_spikes:,} input spikes ({100 * n_merged / n_spikes:.2g} %) lie in one step of the network "
        "with another of the same afferent, and count once"
    )


def apart(spikes: Tensor, most: int | None = None) -> int:
    """The least distance between two spikes of one afferent in windows `(trial, time, afferent)`, in steps.

    The number of steps of a window if no afferent spikes twice in one: bins of so many steps merge no spikes.
    most: how far to look; a larger distance is given as this one.

    >>> import torch
    >>> apart(torch.tensor([[[1], [0], [0], [1], [0]]])), apart(torch.zeros(1, 5, 1)), apart(torch.zeros(1, 5, 1), 2)
    (3, 5, 2)
    """
    fired, n_steps = spikes != 0, spikes.shape[1]
    last = max(1, n_steps if most is None else min(most, n_steps))
    return next((n for n in range(1, last) if bool((fired[:, n:] & fired[:, :-n]).any())), last)
