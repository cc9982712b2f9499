"""Random numbers of afferents that depend on nothing but seed, trial, afferent and step."""

from collections.abc import Iterator

import numpy as np

PER_BLOCK = 4
"""Random numbers that Philox draws for one value of its counter."""


def random_integers(
    seed: int, trials: np.ndarray, first_step: int, n_steps: int, n_taxels: int, n_copies: int
) -> Iterator[tuple[int, int, np.ndarray]]:
    """Uniform uint64 `(time,)` of each trial and afferent, with their places: the same in pieces as in the whole.

    A counter-based generator (Philox) starts at any step: seed and trial are its key; step, taxel and copy (population,
    or fit) its counter. trials: their numbers, `(trial,)`. Afferents: the first copy of each taxel comes first.

    >>> whole = [x for _, _, x in random_integers(0, np.array([7]), 0, 6, 2, 1)]
    >>> later = [x for _, _, x in random_integers(0, np.array([7]), 3, 3, 2, 1)]
    >>> [bool((a[3:] == b).all()) for a, b in zip(whole, later)]
    [True, True]
    """
    generator = np.random.Philox(0)
    table = generator.state
    block, skipped = divmod(first_step, PER_BLOCK)
    for i, trial in enumerate(trials.tolist()):
        for afferent in range(n_copies * n_taxels):
            copy, taxel = divmod(afferent, n_taxels)
            table["state"]["key"] = np.array([seed, trial], np.uint64)
            table["state"]["counter"] = np.array([block, taxel, copy, 0], np.uint64)
            table["buffer_pos"] = PER_BLOCK  # discard the rest of an earlier block
            generator.state = table
            yield i, afferent, generator.random_raw(skipped + n_steps)[skipped:]
