"""From spikes back to the signal, for the encoders whose spikes say by themselves what they stand for.

Each names its decoder in its `Model`; here are the filters of those that have one. Any encoder's spikes can be decoded
by the optimal linear filter (`nt.what_survives`).
"""

import numpy as np

from neurotact.encoders.model import EncoderSpec, of_name, usable
from neurotact.errors import InputError, some

MOST_TAPS = 2000


def decode(spikes: np.ndarray, sampling_rate_Hz: float, encoder: EncoderSpec) -> np.ndarray:
    """The signal that an encoder's spikes stand for, `(trial, time, 2 taxel)` to `(trial, time, taxel)`, in its unit.

    It is that of the conditioned signal. Sums of steps begin at 0: they tell changes, not where the signal began.
    Ben's spiker is decoded without its delay. Raises InputError for a model whose spikes have no such meaning.

    >>> from neurotact.encoders.specs import encode, load
    >>> encoder = load("step-forward", {"threshold": 0.5})
    >>> ramp = np.linspace(0, 5, 101).reshape(1, 101, 1)
    >>> spikes, _ = encode(ramp, 1000.0, encoder)
    >>> bool(abs(decode(spikes, 1000.0, encoder) - ramp).max() <= 0.55)  # a threshold, and a sample's change
    True
    """
    own = of_name(encoder.model).decode
    if own is None:
        known = [name for name, model in usable().items() if model.decode is not None]
        raise InputError(
            f"encoder: spikes of '{encoder.model}' have no meaning of their own, as those of {some(known, len(known))} "
            "have; a linear filter decodes any (nt.what_survives)"
        )
    n_taxels = spikes.shape[2] // 2
    signed = spikes[..., :n_taxels].astype(float) - spikes[..., n_taxels:]
    return own(signed, 1e3 / sampling_rate_Hz, encoder)


def filtered(signed: np.ndarray, taps: np.ndarray, ahead: int) -> np.ndarray:
    """The convolution of `(trial, time, taxel)` with the taps, `ahead` steps earlier, as long as the spikes."""
    n_steps, n_taps = signed.shape[1], len(taps)
    padded = np.pad(signed, ((0, 0), (n_taps - 1, ahead), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, n_taps, axis=1)
    return (windows @ taps[::-1])[:, ahead : ahead + n_steps]


def hann(filter_ms: float, step_ms: float) -> np.ndarray:
    """The taps of a filter, `(tap,)`, positive and of sum 1: a Hann window of that length.

    >>> hann(3.0, 1.0).round(9).tolist()
    [0.25, 0.5, 0.25]
    """
    n_taps = max(1, round(filter_ms / step_ms))
    if n_taps > MOST_TAPS:
        raise InputError(f"filter_ms: {filter_ms:g} ms is {n_taps} steps, more than {MOST_TAPS}; shorten it")
    window = np.sin(np.pi * np.arange(1, n_taps + 1) / (n_taps + 1)) ** 2
    return window / window.sum()
