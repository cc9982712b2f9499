"""The memory of a simulation, checked before it starts."""

from neurotact.errors import InputError
from neurotact.files import MAX_MB, max_bytes

BYTES_A_VALUE = 4
"""Signals are float32."""


def check_room(n_trials: int, n_samples: int, n_channels: int) -> None:
    """InputError if this many trials, samples per trial and channels take more memory than one input may.

    >>> check_room(10**9, 2500, 8)
    Traceback (most recent call last):
    neurotact.errors.InputError: simulation: 1,000,000,000 trials of 2,500 samples and 8 channels take 80,000,000 MB, more than the limit of 512 MB; simulate fewer or shorter trials, or set NEUROTACT_MAX_MB=... to raise the limit
    """  # noqa: E501
    n_bytes = n_trials * n_samples * n_channels * BYTES_A_VALUE
    limit = max_bytes()
    if n_bytes > limit:
        raise InputError(
            f"simulation: {n_trials:,} trials of {n_samples:,} samples and {n_channels:,} channels take "
            f"{n_bytes / 1e6:,.0f} MB, more than the limit of {limit / 1e6:,.0f} MB; simulate fewer or shorter trials, "
            f"or set {MAX_MB}=... to raise the limit"
        )
