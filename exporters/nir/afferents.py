"""SA-I and RA-I afferents as a graph of NIR's nodes, from their input signals to spikes.

The graph receives `(2 taxel)` values per step: the conditioned signal of each taxel, then its absolute change per ms.
NIR has no node for a magnitude, a moving baseline or a filter that starts at its first sample, so conditioning is not
part of the graph. Membranes are in mV above rest. NIR's neurons have no refractory period; it is metadata of their node
(`note.REFRACTORY`). Lowered, it consists of
`Threshold`, `Delay` and `Scale`: `silent[t]` is 1 during the refractory steps, from the step after a spike. It forces
the membrane to fire, which resets it, and removes those spikes.
"""

from typing import Any

import numpy as np
from neurotact_parts.exporters.nir.nodes import FORCE, Clock, Edges, graph, linear, nir, scale, threshold
from neurotact_parts.exporters.nir.note import REFRACTORY
from scipy.linalg import block_diag

from neurotact.encoders.afferents import AfferentSpec


def of_encoder(
    encoder: AfferentSpec, n_taxels: int, clock_Hz: float, clock: Clock, *, lower_refractory: bool = False
) -> tuple[dict[str, Any], Edges]:
    """Nodes and edges from `input` to the node `afferents`."""
    sa1, ra1 = (encoder.neuron(kind, clock_Hz) for kind in (encoder.sa1, encoder.ra1))
    columns = encoder.columns(n_taxels)
    n_each = [len(its) * len(kind.gains) for its, kind in zip(columns, (encoder.sa1, encoder.ra1), strict=True)]
    n = sum(n_each)
    tau = clock.tau(sa1.decay, "tau_mem_ms")
    # A neuron of neurotact spikes at its threshold, one of NIR above it.
    level = np.nextafter(np.float32(sa1.v_threshold_mV - sa1.v_rest_mV), np.float32(-np.inf))
    lif = nir().LIF(
        tau=np.full(n, tau), r=np.ones(n), v_leak=np.zeros(n), v_threshold=np.full(n, np.float64(level)),
        v_reset=np.full(n, sa1.v_reset_mV - sa1.v_rest_mV),
    )  # fmt: skip
    blocks = [
        np.kron(np.array(kind.gains)[:, None], np.eye(n_taxels)[its])
        for its, kind in zip(columns, (encoder.sa1, encoder.ra1), strict=True)
    ]
    nodes: dict[str, Any] = {"gain": linear(block_diag(*blocks).T), "afferents": lif}
    silent = np.repeat([sa1.refractory_steps, ra1.refractory_steps], n_each)
    if lower_refractory:
        nodes["afferents"] = _refractory(lif, silent, clock)
    elif silent.any():
        lif.metadata[REFRACTORY] = silent * clock.dt_s
    return nodes, [("input", "gain"), ("gain", "afferents")]


def _refractory(lif: Any, silent: np.ndarray, clock: Clock) -> Any:
    """Neurons that stay at their reset for `silent` steps after a spike.

    `silent[t] = silent[t-1] or spike[t-1]`, for n steps after the spike: a `Threshold` of 1/2 on
    `silent[t-1] + spike[t-1] - spike[t-1-n]`.
    """
    n = len(silent)
    nodes = {
        "lif": lif,
        "spike": threshold(0.5, n),
        "silent": threshold(0.5, n),
        "stay": clock.delay(1, n),
        "begin": clock.delay(1, n),
        "end": clock.delay(silent + 1, n),
        "over": scale(-1.0, n),
        "force": scale(FORCE, n),
        "veto": scale(-1.0, n),
    }
    edges = [
        ("input", "lif"), ("lif", "spike"), ("spike", "output"),
        ("silent", "stay"), ("stay", "silent"), ("spike", "begin"), ("begin", "silent"),
        ("spike", "end"), ("end", "over"), ("over", "silent"),
        ("silent", "force"), ("force", "lif"), ("silent", "veto"), ("veto", "spike"),
    ]  # fmt: skip
    return graph(nodes, edges, n, n)
