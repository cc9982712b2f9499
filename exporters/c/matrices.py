"""Weight matrices as tables of C: dense, or in sparse rows where a pruned network then takes less flash."""

from typing import NamedTuple

import numpy as np

from neurotact.metrics.flops import index_bytes
from neurotact.networks.definition.rsnn import RSNN

NAMES = ("w_in", "w_rec", "w_out")


class Matrix(NamedTuple):
    """Which weights of a matrix a program keeps.

    there: whether there is a synapse, `(presynaptic, postsynaptic)` bool; None of a network that was not pruned.
    sparse: whether each row has the synapses that exist alone, with their columns beside the weights.
    """

    there: np.ndarray | None
    sparse: bool

    def weights(self, matrix: np.ndarray) -> np.ndarray:
        """Those that are kept, of a matrix `(..., presynaptic, postsynaptic)`."""
        return matrix[..., self.there] if self.sparse else matrix

    def indices(self, name: str) -> dict[str, np.ndarray]:
        """The tables beside the weights, by name: of sparse rows the columns, and where each begins and the last ends;
        of dense ones the synapses of each, which are counted.
        """
        if self.there is None:
            return {}
        fans = self.there.sum(axis=1)
        if not self.sparse:
            return {f"{name}_fan": fans}
        return {f"{name}_to": np.nonzero(self.there)[1], f"{name}_row": np.concatenate([[0], fans.cumsum()])}


def matrices_of(network: RSNN, weight_bytes: int) -> dict[str, Matrix]:
    """How each matrix of a network is kept, in the least flash: an index has the bytes of its largest value.

    >>> from neurotact.networks.training.sparsity import prune
    >>> net = RSNN(20, 3, hidden=20, model="snn", sampling_rate_Hz=1000.0)
    >>> prune(net, 0.7)
    >>> {name: matrix.sparse for name, matrix in matrices_of(net, 1).items()}
    {'w_in': True, 'w_out': True}
    """
    kept = {}
    n_values = 1 if network.stretches is None else network.stretches.number
    for name, there in zip(NAMES, network.present, strict=True):
        if not there.numel():
            continue
        if not network.synapses:
            kept[name] = Matrix(None, False)
            continue
        (rows, columns), n = there.shape, int(there.sum())
        each = weight_bytes * (n_values if name == "w_out" else 1)
        in_rows = n * (each + index_bytes(columns - 1)) + (rows + 1) * index_bytes(n)
        dense = rows * columns * each + rows * index_bytes(columns)
        kept[name] = Matrix(there.numpy(), in_rows < dense and n > 0)  # C has no empty table
    return kept
