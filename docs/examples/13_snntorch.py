"""
Go on in snnTorch
=================

A trained network as a module of snnTorch's neurons, which trains on, or is taken apart, there. The axes are
`(trial, time, afferent)`, or time first on request.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

import neurotact as nt

touches = nt.simulate(
    "gratings", trials=10, pitches_mm=[4.0, 1.0], forces_N=[12.0], speeds_mm_per_s=[8.6], duration_s=0.4
)
data = nt.windows(nt.encode(touches), nt.Window(length_ms=150, start_ms=100, per_trial=1))
network = nt.SpikingClassifier(hidden=20, epochs=10, random_state=0).fit(data.X, data.y)

# %%
module = nt.to_snntorch(network, time_first=True)
print(module)

# %%
# The same spikes go in, and the same hidden spikes come out of both.

spikes = torch.from_numpy(np.asarray(data.X))
hidden, readout = module(spikes.transpose(0, 1))
ours = network.network_.simulate(spikes).hidden
print("hidden:", tuple(hidden.shape), " readout:", tuple(readout.shape))
print("spikes that differ:", int((hidden.transpose(0, 1) != ours).sum()), "of", int(ours.sum()))

# %%
# One window: the spikes of the hidden neurons, and the value of the readout as it grows.

figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4), sharex=True, layout="constrained")
clock_Hz = network.network_.clock_Hz  # steps of the network per second
step, neuron = np.nonzero(hidden[:, 0].detach().numpy())
above.plot(1e3 * step / clock_Hz, neuron, "|", color="black", markersize=4)
above.set_ylabel("hidden neuron")
below.plot(
    1e3 * np.arange(len(readout)) / clock_Hz, readout[:, 0].detach().numpy(), label=network.classes_
)
below.set(xlabel="time (ms)", ylabel="readout")
below.legend()
plt.show()
