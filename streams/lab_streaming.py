"""Streams of the Lab Streaming Layer (labstreaminglayer.org), which the package pylsl receives."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from neurotact.data.recordings import order_by_name
from neurotact.errors import InputError, number_of, optional

LSL = "lsl:"
"""Prefix of the name of a stream."""
FOUND_S = 5.0
"""Time in which a stream is found."""
AT_ONCE_S = 0.2
"""Longest wait of one call, during which Ctrl-C is not heard."""
MOST_SAMPLES = 4096
"""Of one block."""
RATE_TOLERANCE = 0.01


@contextmanager
def inlet(
    path: str, n_taxels: int, rate_Hz: float, taxels: tuple[str, ...] | None = None
) -> Iterator[Callable[[float], bytes | None]]:
    """A function that waits for samples, and returns them as float32 `(sample, taxel)`; no bytes once the stream ends.

    Its channels are put in the order of `taxels` by their labels. Samples come whole and in order, as the layer sends
    them by TCP, so their stamps are not used. Raises InputError for a stream that is absent or of another form.
    """
    try:
        pylsl = optional("pylsl", f"{path}: needs pylsl; pip install 'neurotact[lsl]'")
    except RuntimeError as error:  # pylsl is installed, and the library that it needs is not
        raise InputError(
            f"{path}: pylsl cannot be used ({str(error).partition('.')[0][:80]}); install liblsl"
        ) from error
    found = pylsl.resolve_byprop("name", path.removeprefix(LSL), timeout=FOUND_S)
    if not found:
        raise InputError(f"{path}: no such stream is found in {FOUND_S:g} s; start it, and check its name")
    stream = pylsl.StreamInlet(found[0], recover=False)
    try:
        order = _checked(pylsl, stream.info(), path, n_taxels, rate_Hz, taxels)

        def receive(wait_s: float) -> bytes | None:
            try:
                sample, stamp = stream.pull_sample(timeout=min(wait_s, AT_ONCE_S))
                if stamp is None:
                    return None
                more, _ = stream.pull_chunk(timeout=0.0, max_samples=MOST_SAMPLES)
            except RuntimeError:  # its sender has ended
                return b""
            with np.errstate(over="ignore"):  # a value beyond float32 is infinite, and counts as missing
                block = np.array([sample, *more], "<f4")
            return (block if order is None else block[:, order]).tobytes()

        yield receive
    finally:
        stream.close_stream()


def _checked(
    pylsl: Any, info: Any, path: str, n_taxels: int, rate_Hz: float, taxels: tuple[str, ...] | None
) -> list[int] | None:
    """The places of the taxels among the channels; InputError for a stream of another form, or at another rate."""
    if info.channel_format() == pylsl.cf_string:
        raise InputError(f"{path}: sends texts, not numbers; give a stream of samples")
    if info.channel_count() != n_taxels:
        found, wanted = number_of(info.channel_count(), "channel"), number_of(n_taxels, "taxel")
        raise InputError(f"{path}: has {found} where {wanted} should be; give these")
    sent_Hz = info.nominal_srate()  # 0 if it is irregular
    if sent_Hz and abs(sent_Hz / rate_Hz - 1) > RATE_TOLERANCE:
        raise InputError(
            f"{path}: comes at {sent_Hz:g} Hz, but {rate_Hz:g} Hz are expected; give `sampling_rate_Hz={sent_Hz:g}`"
        )
    labels, channel = [], info.desc().child("channels").child("channel")
    for _ in range(n_taxels):
        labels.append(channel.child_value("label"))
        channel = channel.next_sibling()
    return order_by_name(labels, taxels, path) if all(labels) else None
