"""The interval between spikes of a LIF neuron in closed form, which its steps are compared with."""

import math

from neurotact.neurons import LIF


def lif_isi_steps(neuron: LIF, drive_mV: float) -> float:
    """The inter-spike interval at constant drive, in steps; infinite below threshold.

    `n + ceil((tau_mem / dt) ln(D / (D - (v_threshold - v_rest))))` for v_reset = v_rest.
    """
    gap = neuron.v_threshold_mV - neuron.v_rest_mV
    if drive_mV <= gap:
        return math.inf
    start = neuron.v_reset_mV - neuron.v_rest_mV
    steps = math.log((drive_mV - start) / (drive_mV - gap)) / -math.log(neuron.decay)
    # At a whole number of steps the threshold is met, not passed: rounding must not add a step.
    return neuron.refractory_steps + max(1, math.ceil(steps - 1e-9))
