"""Random numbers of afferents that depend on nothing but the seed, the afferent, and the samples that it has received.

Each number is a hash, the output function of SplitMix64 (Steele, Lea and Flood 2014, doi 10.1145/2660193.2660195), of a
digest of a taxel's samples so far. So a trial has its noise at any index of any file, whole, in pieces or as a stream,
and another trial, if only the last bit of a sample differs, has other noise from that sample on. A trial that is the
same in every sample has the same noise; draw more of it with other seeds.
"""

import numpy as np

from neurotact.errors import InputError

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""Distance of two numbers of one sequence before they are mixed."""
BITS = 32
"""Of a sample, which is hashed as float32, the type of recordings; the number of its step is put above them."""


def _mixed(numbers: np.ndarray) -> np.ndarray:
    """A hash of each uint64, of which every bit depends on every bit: the output function of SplitMix64; in place.

    >>> _mixed(np.array([1234567], np.uint64) + GOLDEN).tolist()
    [6457827717110365317]
    """
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        numbers ^= numbers >> np.uint64(shift)
        numbers *= np.uint64(factor)
    numbers ^= numbers >> np.uint64(31)
    return numbers


def digests(signal: np.ndarray, first_step: int, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A digest of the samples of each taxel up to each step, `(..., time, taxel)` uint64, and that of all of them.

    It is the sum of a hash of each sample and its step, so that a signal in pieces has the digests of the whole.
    Samples count as float32, whatever the float type of the signal.

    signal: `(..., time, taxel)`. first_step: the number of its first step. before: the digest of the samples before it,
        `(..., taxel)`; zeros for none.

    >>> whole, _ = digests(np.ones((4, 1)), 0, np.zeros(1, np.uint64))
    >>> _, so_far = digests(np.ones((3, 1)), 0, np.zeros(1, np.uint64))
    >>> bool(digests(np.ones((1, 1)), 3, so_far)[0][-1] == whole[-1])
    True
    """
    with np.errstate(over="ignore"):
        samples = signal.astype(np.float32)
    samples += np.float32(0.0)  # so that -0 is 0
    keys = samples.view(np.uint32).astype(np.uint64)
    keys |= np.arange(first_step, first_step + signal.shape[-2], dtype=np.uint64)[:, None] << np.uint64(BITS)
    keys = _mixed(keys)
    keys[..., :1, :] += before[..., None, :]
    np.cumsum(keys, axis=-2, out=keys)
    return keys, keys[..., -1, :].copy() if signal.shape[-2] else before


def check_continued(digest: np.ndarray, signal: np.ndarray) -> None:
    """InputError if a digest `(trial, taxel)` is not of the trials and taxels of a signal `(trial, time, taxel)`."""
    if digest.shape != (len(signal), signal.shape[2]):
        raise InputError(
            f"state: is of {digest.shape[0]} trials of {digest.shape[1]} taxels, and the signal has {len(signal)} of "
            f"{signal.shape[2]}; give the state that encode returned for the samples before"
        )


def between(digest: np.ndarray, step_of: np.ndarray, first: int) -> np.ndarray:
    """The digests on a finer clock, `(..., fine step, taxel)`: of its steps numbered from `first` on.

    step_of: the step of `digest`, which is `(..., step, taxel)`, that each fine step belongs to.
    """
    numbers = np.arange(first, first + len(step_of), dtype=np.uint64) * GOLDEN
    return digest[..., step_of, :] + numbers[:, None]


def random_integers(seed: int, digest: np.ndarray, copy: int) -> np.ndarray:
    """Uniform uint64 of the shape of a digest `(..., time, taxel)`: one for each afferent and step.

    copy: which afferent of each taxel: the number of its population, or fit. Two taxels with the same samples have
    different numbers.

    >>> digest, _ = digests(np.zeros((5, 2)), 0, np.zeros(2, np.uint64))
    >>> len({*random_integers(0, digest, 0).ravel().tolist(), *random_integers(1, digest, 0).ravel().tolist()})
    20
    """
    return _mixed(digest + places(seed, copy, digest.shape[-1]))


def places(seed: int, copy: int, n_taxels: int) -> np.ndarray:
    """What `random_integers` adds to the digests of each taxel, `(taxel,)` uint64."""
    afferents = (np.uint64(copy) << np.uint64(BITS)) + np.arange(n_taxels, dtype=np.uint64)
    return _mixed(_mixed(np.array([seed], np.uint64) + GOLDEN) + afferents)
