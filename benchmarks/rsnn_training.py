"""One training step (forward, cross-entropy, backward, Adam) of a recurrent spiking network, ours beside peers.

    python benchmarks/rsnn_training.py --case paper --peers snntorch jax --json rsnn.json

Everything runs in one process and takes turns. Each side runs its own neuron at its fastest documented path on the
CPU, with one thread and with all; the better is kept. Ours takes the membrane of the peer where it knows it.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass

import torch
from side_by_side import Row, Runner, best_of, missing, parse, publish
from torch.nn import functional

from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec

ALPHA, BETA, SCALE = 0.9, 0.95, 10.0
PACKAGES = ("torch", "numpy", "snntorch", "spikingjelly", "norse", "jax", "jaxlib")


@dataclass(frozen=True)
class Case:
    inputs: int
    hidden: int
    classes: int
    steps: int
    density: float
    reset: str = "zero"
    weight: float = 1.0  # standard deviation of a weight, times the root of its fan-in
    batch: int = 128
    recurrent: bool = True
    readout: str = "count"  # or integrator, of which peers here have none
    learn: tuple[str, ...] = ()


CASES = {
    "paper": Case(16, 30, 8, 300, 0.12),
    "paper-subtract": Case(16, 30, 8, 300, 0.12, reset="subtract"),
    "large": Case(48, 450, 27, 260, 0.03, weight=0.9),
}


def data(case: Case) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    shape = case.batch, case.steps, case.inputs
    spikes = (torch.rand(shape, generator=generator) < case.density).to(torch.uint8)
    return spikes, torch.randint(case.classes, (case.batch,), generator=generator)


def torch_step(parameters, counts: Callable[[], torch.Tensor], labels: torch.Tensor) -> Callable[[], object]:
    optimiser = torch.optim.Adam(parameters, lr=1e-4, fused=True)

    def run() -> torch.Tensor:
        optimiser.zero_grad()
        loss = functional.cross_entropy(counts(), labels)
        loss.backward()
        optimiser.step()
        return loss

    return run


def ours(case: Case, membrane: str) -> tuple[Callable[[], object], RSNN]:
    spec = RSNNSpec(
        hidden=case.hidden, membrane=membrane, reset=case.reset, surrogate_scale=SCALE,
        forward_weight_scale=case.weight, recurrent_weight_scale=0.1,
        model="rsnn" if case.recurrent else "snn", readout=case.readout, learn=case.learn,
    )  # fmt: skip
    generator = torch.Generator().manual_seed(0)
    net = RSNN(case.inputs, case.classes, spec, 2000.0, backend="native", generator=generator)
    with torch.no_grad():
        net.alpha.fill_(ALPHA)
        net.beta.fill_(BETA)
    spikes, labels = data(case)
    learned = [weights for weights in net.parameters() if weights.requires_grad]
    return torch_step(learned, lambda: net(spikes).readout, labels), net


def snntorch(case: Case) -> list[Callable[[], object]]:
    import snntorch as snn
    from snntorch import surrogate

    gradient = surrogate.fast_sigmoid(slope=SCALE)
    kept = {"alpha": ALPHA, "beta": BETA, "spike_grad": gradient, "reset_mechanism": case.reset}

    class Net(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.into = torch.nn.Linear(case.inputs, case.hidden, bias=False)
            self.hidden = snn.RSynaptic(linear_features=case.hidden, **kept) if case.recurrent else snn.Synaptic(**kept)
            self.out = torch.nn.Linear(case.hidden, case.classes, bias=False)
            self.readout = snn.Synaptic(**kept)

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            state = self.hidden.reset_mem()  # spikes of a recurrent layer, current, membrane
            out_current, out_membrane = self.readout.reset_mem()
            sent = []
            for arriving in self.into(x):  # one product over the window, as its tutorials advise for speed
                spikes, *moved = self.hidden(arriving, *state)
                state = [spikes, *moved] if case.recurrent else moved
                decided, out_current, out_membrane = self.readout(self.out(spikes), out_current, out_membrane)
                sent.append(decided)
            return torch.stack(sent).sum(0)

    net, (spikes, labels) = Net(), data(case)
    x = spikes.transpose(0, 1).float().contiguous()
    return [torch_step(net.parameters(), lambda: net(x), labels)]


def spikingjelly(case: Case) -> list[Callable[[], object]]:
    from spikingjelly.activation_based import functional as sj
    from spikingjelly.activation_based import layer, neuron, surrogate

    def node() -> torch.nn.Module:
        reset = 0.0 if case.reset == "zero" else None
        return neuron.LIFNode(
            tau=1 / (1 - BETA), decay_input=False, v_reset=reset, surrogate_function=surrogate.Sigmoid(SCALE),
            detach_reset=True,
        )  # fmt: skip

    tau = 1 / (1 - ALPHA)
    net = torch.nn.Sequential(
        layer.Linear(case.inputs, case.hidden, bias=False, step_mode="m"),
        layer.LinearRecurrentContainer(
            torch.nn.Sequential(layer.SynapseFilter(tau=tau), node()),
            case.hidden,
            case.hidden,
            bias=False,
            step_mode="m",
        ),
        layer.Linear(case.hidden, case.classes, bias=False, step_mode="m"),
        layer.SynapseFilter(tau=tau, step_mode="m"),
        node(),
    )
    sj.set_step_mode(net[4], "m")
    spikes, labels = data(case)
    x = spikes.transpose(0, 1).float().contiguous()

    def counts() -> torch.Tensor:
        sj.reset_net(net)
        return net(x).sum(0)

    return [torch_step(net.parameters(), counts, labels)]


def norse(case: Case) -> list[Callable[[], object]]:
    import norse.torch as nt

    parameters = nt.LIFParameters(
        tau_syn_inv=torch.tensor((1 - ALPHA) * 1e3), tau_mem_inv=torch.tensor((1 - BETA) * 1e3), v_th=torch.tensor(1.0),
        alpha=torch.tensor(SCALE),
    )  # fmt: skip
    net = torch.nn.ModuleList(
        [
            nt.LIFRecurrent(case.inputs, case.hidden, p=parameters),
            torch.nn.Linear(case.hidden, case.classes, bias=False),
            nt.LIF(p=parameters),
        ]
    )
    spikes, labels = data(case)
    x = spikes.transpose(0, 1).float().contiguous()

    def counts() -> torch.Tensor:
        hidden, _ = net[0](x)
        return net[2](net[1](hidden))[0].sum(0)

    return [torch_step(net.parameters(), counts, labels)]


def jax(case: Case) -> list[Callable[[], object]]:
    """A jitted scan of our own equations with its Adam inside, the way Spyx works; three lengths of unrolling."""
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    import jax
    import jax.numpy as jnp

    @jax.custom_vjp
    def spike(u):
        return (u > 0).astype(jnp.float32)

    spike.defvjp(lambda u: (spike(u), u), lambda u, g: (g / (1 + SCALE * jnp.abs(u)) ** 2,))
    spikes, labels = data(case)
    x, y = jnp.asarray(spikes.transpose(0, 1).float().numpy()), jnp.asarray(labels.numpy())

    def reset(total, sent):
        kept = jax.lax.stop_gradient(sent)
        return total * (1 - kept) if case.reset == "zero" else total - kept

    def make(unroll: int) -> Callable[[], object]:
        def loss(weights, x, y):
            w_in, w_rec, w_out = weights

            def step(carry, arriving):
                current, membrane, sent, out_current, out_membrane, out_sent, counts = carry
                next_membrane = reset(BETA * (membrane + current), sent)
                next_current = ALPHA * current + arriving + (sent @ w_rec if case.recurrent else 0)
                next_out = reset(BETA * (out_membrane + out_current), out_sent)
                next_out_current = ALPHA * out_current + sent @ w_out
                counts = counts + out_sent
                carry = next_current, next_membrane, spike(next_membrane - 1), next_out_current, next_out
                return (*carry, spike(next_out - 1), counts), None

            hidden, out = jnp.zeros((case.batch, case.hidden)), jnp.zeros((case.batch, case.classes))
            start = hidden, hidden, hidden, out, out, out, out
            counts = jax.lax.scan(step, start, x @ w_in, unroll=unroll)[0][-1]
            return -jnp.take_along_axis(jax.nn.log_softmax(counts), y[:, None], 1).mean()

        @jax.jit
        def update(weights, first, second, count, x, y):
            gradient = jax.grad(loss)(weights, x, y)
            count = count + 1
            first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, gradient)
            second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, gradient)
            moved = jax.tree.map(
                lambda w, m, v: w - 1e-4 * (m / (1 - 0.9**count)) / (jnp.sqrt(v / (1 - 0.999**count)) + 1e-8),
                weights, first, second,
            )  # fmt: skip
            return moved, first, second, count

        keys = jax.random.split(jax.random.PRNGKey(0), 3)
        shapes = ((case.inputs, case.hidden), (case.hidden, case.hidden), (case.hidden, case.classes))
        scales = (case.weight, 0.1 * case.weight, case.weight)
        weights = tuple(
            jax.random.normal(k, s) * scale / s[0] ** 0.5 for k, s, scale in zip(keys, shapes, scales, strict=True)
        )
        zeros = jax.tree.map(jnp.zeros_like, weights)
        state = [weights, zeros, zeros, 0.0]

        def run() -> object:
            state[:] = update(*state, x, y)
            return jax.block_until_ready(state[0])

        return run

    return [make(unroll) for unroll in ((1, 2, 4) if case.hidden < 100 else (1,))]


PEERS = {"snntorch": snntorch, "jax": jax, "spikingjelly": spikingjelly, "norse": norse}


def rows_of(name: str, peers: list[str], rounds: int) -> list[Row]:
    case, threads = CASES[name], sorted({1, os.cpu_count() or 1})
    runners, nets = [], {}
    for membrane in ("eq4", "immediate"):
        for n in threads:
            run, nets[membrane] = ours(case, membrane)
            runners.append(Runner(f"ours {membrane}", run, n))
    there = []
    for peer in peers:
        try:
            found = PEERS[peer](case)
        except (ImportError, AttributeError) as error:
            missing(peer, error)
            continue
        there.append(peer)
        # XLA settles its threads when the process starts, so JAX has what the machine has.
        runners += [Runner(peer, run, n) for run in found for n in (threads if peer != "jax" else threads[-1:])]
    best = best_of(runners, seconds=0.15, rounds=rounds)
    rates = {}
    for membrane, net in nets.items():
        counts = net(data(case)[0])
        rates[membrane] = counts.hidden.mean().item() / case.steps, counts.readout.mean().item() / case.steps
    rows = []
    for peer in there:
        membrane = "immediate" if peer == "snntorch" else "eq4"
        (ours_ms, ours_threads), (peer_ms, peer_threads) = best[f"ours {membrane}"], best[peer]
        hidden, readout = rates[membrane]
        note = (
            f"{membrane}, {case.reset}; threads {ours_threads} and {peer_threads}; "
            f"rate {hidden:.2f} hidden, {readout:.2f} readout"
        )
        rows.append(Row(name, peer, ours_ms, peer_ms, peer_ms / ours_ms, note))
    return rows


def main() -> None:
    asked = parse(tuple(CASES), tuple(PEERS), __doc__ or "")
    rows = [row for name in asked.case for row in rows_of(name, asked.peers, asked.rounds)]
    publish(rows, PACKAGES, asked.json)


if __name__ == "__main__":
    main()
