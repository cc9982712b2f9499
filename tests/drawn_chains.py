"""Chains and networks with several features at once, drawn from a seed: what is equal alone may differ together."""

import random
from typing import Any

import numpy as np
import torch
from made_chains import READOUTS, make_encoder, unequal_stretches
from neurotact_parts.streams.chain import Chain, chain_of

import neurotact as nt
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.specs import n_afferents
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training.sparsity import prune

DIRECT = ("integrator", "stretches")
MEMBRANES, RESETS = ("eq4", "delayed", "immediate"), ("zero", "subtract", "hard")


def draw_network(rng: random.Random, n_inputs: int, rate_Hz: float) -> RSNN:
    """A network of any readout, recurrent or not, with or without a hidden layer, a clock of its own, and so on."""
    step_ms, recurrent, hidden = 1e3 / rate_Hz, rng.random() < 0.6, rng.choice([0, 4, 6, 12])
    readout = rng.choice([*READOUTS] if hidden else DIRECT)
    keys: dict[str, Any] = {"hidden": hidden, **READOUTS[readout]}
    if rng.random() < 0.4:
        keys["step_ms"] = step_ms = step_ms * rng.choice([2, 3])
    if readout == "stretches":
        keys["readout_stretch_ms"] = step_ms * rng.choice([2, 4])
    if hidden:
        keys |= {"model": "rsnn" if recurrent else "snn", "direct": readout in DIRECT and rng.random() < 0.4}
        keys |= {"membrane": rng.choice(MEMBRANES), "reset": rng.choice(RESETS), "forward_weight_scale": 3.0}
        keys |= rng.choice([{}, {"threshold_adaptation": 0.3, "tau_adaptation_ms": 12.0}])
        keys |= rng.choice([{}, {"learn": ["alpha", "beta", "threshold"]}])
    if keys.get("model") == "rsnn":
        keys |= {"recurrent_weight_scale": 0.5, "recurrent_delay_steps": rng.choice([0, 1])}
        keys |= rng.choice([{}, {"recurrent_blocks": 2}])
    generator = torch.Generator().manual_seed(rng.randrange(2**31))
    network = RSNN(n_inputs, rng.choice([2, 3]), sampling_rate_Hz=rate_Hz, generator=generator, **keys)
    unequal_stretches(network)
    with torch.no_grad():
        if network.bias is not None:
            network.bias.normal_(generator=generator)
        if "learn" in keys:
            for constant, values in ((network.alpha, [0.8, 0.6]), (network.beta, [0.7, 0.93])):
                constant.copy_(torch.tensor(values))
            network.threshold.copy_(torch.tensor([0.7, 1.3]))
    if rng.random() < 0.4:
        prune(network, rng.choice([0.3, 0.8]))
    return network


def draw_rule(rng: random.Random, network: RSNN) -> ExitRule:
    """Whole windows or an early exit, for classes, of which some are refused, or for numbers."""
    patience, first = rng.choice([None, 1, 5, 12]), rng.random() < 0.6
    if network.bias is not None and rng.random() < 0.25:
        return ExitRule(patience, first, band=(rng.choice([0.3, 1.0, 3.0]),) * network.n_classes)
    return ExitRule(patience, first, least_lead=rng.choice([0.0, 0.0, 1.0]))


def draw_encoder(rng: random.Random, n_taxels: int, rate_Hz: float, clock_Hz: float) -> AfferentSpec:
    """LIF afferents of any kind behind any causal conditioning."""
    how: dict[str, Any] = rng.choice([{}, {"baseline": "start", "start_ms": 20.0}, {"baseline": "high-pass"}])
    how = how | rng.choice([{}, {"ema_cutoff_Hz": 0.2 * rate_Hz}])
    how |= rng.choice([{}, {"offset": [0.1] * n_taxels, "scale": [-0.9] * n_taxels}])
    how |= {} if clock_Hz == rate_Hz else {"resample_Hz": clock_Hz}
    step_ms = 1e3 / clock_Hz
    afferents: dict[str, Any] = {
        "sa1.t_ref_ms": step_ms * rng.choice([0, 2, 5]), "ra1.t_ref_ms": step_ms * rng.choice([1, 3])
    }  # fmt: skip
    for one in ({"sa1.grades": [0.5, 1.0]}, {"sa1.opposite": True}, {"ra1.change": "both"}, {"sa1.rate_ms": 20.0},
                {"integration": "exact", "sa1.t_ref_ms": 5.3}):  # fmt: skip
        afferents |= one if rng.random() < 0.2 else {}
    if rng.random() < 0.25:
        some = {
            f"{part}.taxels": sorted(rng.sample(range(n_taxels), rng.randint(1, n_taxels))) for part in ("sa1", "ra1")
        }
        afferents |= {**some, "recorded_taxels": [f"t{i}" for i in range(n_taxels)]}
    return make_encoder(afferents, **how)


def draw_chain(seed: int) -> Chain:
    """A chain of all of these, with windows that follow each other, overlap or begin at a contact."""
    rng = random.Random(seed)
    n_taxels, rate_Hz = rng.choice([1, 2, 5]), rng.choice([1000.0, 400.0, 1333.0])
    clock_Hz = rng.choice([rate_Hz, 1000.0])
    encoder = draw_encoder(rng, n_taxels, rate_Hz, clock_Hz)
    network, step_ms = draw_network(rng, n_afferents(encoder, n_taxels), clock_Hz), 1e3 / clock_Hz
    windows: dict[str, Any] = {"length_ms": step_ms * rng.choice([10, 31])}
    windows |= rng.choice([{}, {"hop_ms": step_ms * 7}, {"contact": True, "quiet_ms": step_ms * 5}])
    windows |= rng.choice([{}, {"start_ms": step_ms * 13}])
    chain = chain_of((encoder, network), nt.Streamed(sampling_rate_Hz=rate_Hz, **windows))
    rule = draw_rule(rng, network)
    return chain._replace(rule=rule, tells_numbers=bool(rule.band))


def by_hand(network: RSNN, spikes: torch.Tensor, steps: torch.Tensor) -> list[list[int]]:
    """Operations of each window until its decision, synapse by synapse: into, among and out of hidden neurons."""
    with torch.no_grad():
        hidden = network.simulate(spikes, ordered=True).hidden.numpy()
    given, n_hidden, found = network.binned(spikes).numpy(), network.spec.hidden, []
    is_pruned, out = bool(network.spec.training.sparsity), network.readout_weights.detach().numpy()
    out = np.abs(out).sum(axis=0) if out.ndim == 3 else out
    among = np.zeros((n_hidden, 0)) if network.w_rec is None else network.w_rec.detach().numpy()
    for window, n_steps in enumerate(steps.tolist()):
        counts = [0, 0, 0]
        for step in range(-(-n_steps // network.steps_per_bin)):
            for afferent in np.flatnonzero(given[window, step]):
                counts[0] += _reached(network.w_in.detach().numpy()[afferent], is_pruned=is_pruned)
                heard = out[n_hidden + afferent] if network.spec.hears_afferents else out[0, :0]
                counts[2] += _reached(heard, is_pruned=is_pruned)
            for neuron in np.flatnonzero(hidden[window, step]) if n_hidden else ():
                within = among.shape[1] // network.spec.recurrent_blocks
                first = neuron // within * within if within else 0
                counts[1] += _reached(among[neuron, first : first + within], is_pruned=is_pruned)
                counts[2] += _reached(out[neuron], is_pruned=is_pruned)
        found.append(counts)
    return found


def _reached(weights: np.ndarray, *, is_pruned: bool) -> int:
    return sum(1 for weight in weights.tolist() if weight != 0 or not is_pruned)
