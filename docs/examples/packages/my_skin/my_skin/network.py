"""A network: two hidden layers of leaky integrate-and-fire neurons, and a linear readout."""

from torch import nn, stack

from neurotact.networks.definition import parts, surrogate
from neurotact.neurons import decay_per_step
from neurotact.spec import Spec


class Keys(Spec):
    """Neurons of each hidden layer, time constant of their membranes, and slope of their spikes in training."""

    units: int = 20
    tau_ms: float = 20.0
    surrogate: str = "triangle"


class TwoLayers(nn.Module):
    """Spikes (batch, time, afferent) to scores in each step (batch, time, class). A spike takes 1 off its membrane."""

    def __init__(self, keys, sizes):
        super().__init__()
        self.first = nn.Linear(sizes.n_inputs, keys.units)
        self.second = nn.Linear(keys.units, keys.units)
        self.out = nn.Linear(keys.units, sizes.n_classes)
        self.decay = decay_per_step(keys.tau_ms, sizes.clock_Hz)
        self.spike = surrogate.spike_function(keys.surrogate, scale=1.0)

    def forward(self, spikes):
        for layer in (self.first, self.second):
            membrane, sent = 0.0, []
            for arriving in layer(spikes).unbind(dim=1):
                membrane = self.decay * membrane + arriving
                sent.append(self.spike(membrane - 1))
                membrane = membrane - sent[-1]
            spikes = stack(sent, dim=1)
        return self.out(spikes) / 10


NETWORK = parts.NetworkPart("Two hidden layers of LIF neurons.", Keys, TwoLayers)
