"""The kernels of a population, in Triton's interpreter, against the definition: spikes to the last bit, gradients."""

import json
import os
import subprocess
import sys
from functools import cache
from typing import get_args

import pytest
import torch
from torch import Tensor

from neurotact.errors import InputError
from neurotact.networks import native, reference
from neurotact.networks.population.population import Batch, Counts, Form, Population, packed
from neurotact.networks.rsnn import RSNN
from neurotact.networks.specs import RSNNSpec
from neurotact.neurons import Membrane, Reset

pytest.importorskip("triton", reason="Triton is not installed: pip install 'neurotact[gpu]'")

CLASSES = 3
VARIANTS = [
    (membrane, reset, delay, model)
    for place, (membrane, reset) in enumerate((m, r) for m in get_args(Membrane) for r in get_args(Reset))
    for delay, model in [(place % 2, "rsnn"), *([(0, "snn")] if reset == "zero" else [])]
]
each_variant = pytest.mark.parametrize("variant", VARIANTS, ids=str)


def network(n_inputs: int, hidden: int, seed: int, **spec) -> RSNN:
    """A network that spikes in earnest, whose layers have constants of their own."""
    table = {"forward_weight_scale": 8.0, "recurrent_weight_scale": 0.5, "readout_surrogate_scale": 7.0, **spec}
    net = RSNN(
        n_inputs, CLASSES, RSNNSpec(hidden=hidden, surrogate_scale=5.0 + seed, **table), 400.0,
        backend="reference", generator=torch.Generator().manual_seed(seed),
    )  # fmt: skip
    with torch.no_grad():
        net.threshold.copy_(torch.tensor([1.0, 0.7]))
        net.alpha.copy_(torch.tensor([0.75, 0.8]))
    return net


def drawn(n_windows: int, n_steps: int, n_inputs: int) -> Tensor:
    return (torch.rand(n_windows, n_steps, n_inputs, generator=torch.Generator().manual_seed(1)) < 0.4).to(torch.uint8)


def batch_of(members: list[int], windows: list[list[int]]) -> Batch:
    most = max(map(len, windows))
    rows = [[*row, *[0] * (most - len(row))] for row in windows]
    numbers = (torch.tensor(each, dtype=torch.int32) for each in (members, rows, [len(row) for row in windows]))
    return Batch(*numbers)


class Ran:
    """Two networks of different sizes that were run forward and backward in one launch each."""

    def __init__(self, nets: list[RSNN], spikes: Tensor, batch: Batch) -> None:
        self.nets, self.spikes, self.batch = nets, spikes, batch
        self.population = Population(nets, Form.of(nets[0], spikes.shape[1]), packed(spikes), torch.device("cpu"))
        self.counts, self.tape = self.population.run(batch, keep=True)
        generator = torch.Generator().manual_seed(3)
        self.g = Counts(*(torch.randn(each.shape, generator=generator) for each in self.counts))
        for place, member in enumerate(batch.members.tolist()):
            for g, size in zip(self.g, (nets[member].spec.hidden, CLASSES), strict=True):
                g[place, batch.trials[place] :], g[place, :, size:] = 0.0, 0.0
        self.gradients = self.population.gradients(batch, self.tape, self.g)

    def places(self):
        """Each place's network, its windows, and how many there are."""
        for place, member in enumerate(self.batch.members.tolist()):
            n = int(self.batch.trials[place])
            yield place, self.nets[member], self.spikes[self.batch.windows[place, :n].long()], n


@cache
def ran(variant) -> Ran:
    membrane, reset, delay, model = variant
    what = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay, "model": model}
    nets = [network(4, hidden, seed, **what) for seed, hidden in enumerate((9, 6))]
    return Ran(nets, drawn(5, 9, 4), batch_of([1, 0], [[4, 0, 3], [1, 2]]))


@cache
def wide() -> Ran:
    """Two words of afferents, words of 64 bits for the hidden neurons, and more windows than a tile holds."""
    return Ran([network(33, 40, 0)], drawn(18, 6, 33), batch_of([0], [[*range(18)]]))


def assert_same_spikes(run: Ran) -> None:
    for place, net, spikes, n in run.places():
        hidden = net.spec.hidden
        wanted = net.simulate(spikes, ordered=True)
        assert wanted.hidden.any()
        assert wanted.readout.any()
        assert torch.equal(run.counts.hidden[place, :n, :hidden], wanted.hidden.sum(dim=1))
        assert torch.equal(run.counts.readout[place, :n, :CLASSES], wanted.readout.sum(dim=1))
        assert not run.counts.hidden[place, :n, hidden:].any()
        for layer, (tape, sent) in enumerate(zip(run.tape, wanted, strict=True)):
            fired = tape[place, :n, :, : sent.shape[2]] > net.threshold[layer]
            shift = 0 if net.spec.membrane == "immediate" else 1  # else step t sends s[t]
            assert torch.equal(fired[:, : fired.shape[1] - shift].to(sent.dtype), sent[:, shift:])
        # The last membranes hold every rounding of the window.
        _, state = reference.cuba_lif_layer(
            spikes.float(), net.w_in, net.w_rec, alpha=net.alpha[0], beta=net.beta[0], threshold=net.threshold[0],
            neuron=net.neuron, spike=net.spike, ordered=True,
        )  # fmt: skip
        assert torch.equal(run.tape.hidden[place, :n, -1, :hidden], state.membrane)


def assert_same_gradients(run: Ran, backend: str) -> None:
    for place, net, spikes, n in run.places():
        net.backend = backend
        names = [name for name in ("w_in", "w_rec", "w_out") if getattr(net, name) is not None]
        counts = net(spikes)
        given = [g[place, :n, : own.shape[1]] for g, own in zip(run.g, (counts.hidden, counts.readout), strict=True)]
        total = (counts.hidden * given[0]).sum() + (counts.readout * given[1]).sum()
        wanted = torch.autograd.grad(total, [getattr(net, name) for name in names])
        found = run.population.parts(run.gradients[place])
        for name, gradient in zip(names, wanted, strict=True):
            own = found[name][: gradient.shape[0], : gradient.shape[1]].clone()
            assert (own - gradient).abs().max() <= 1e-4 * gradient.abs().max()
            assert gradient.any()
            assert torch.equal(found[name].count_nonzero(), own.count_nonzero())  # padded weights get none


@each_variant
def test_spikes_are_those_of_the_ordered_reference_to_the_last_bit(variant):
    assert_same_spikes(ran(variant))


@each_variant
def test_gradients_agree_with_autograd(variant):
    assert_same_gradients(ran(variant), "reference")


@pytest.mark.skipif(native.native is None, reason="the kernels are not compiled here")
def test_gradients_agree_with_the_native_kernels():
    assert_same_gradients(ran(VARIANTS[0]), "native")


def test_more_words_neurons_and_windows():
    assert_same_spikes(wide())
    assert_same_gradients(wide(), "reference")


def test_what_is_kept_for_the_gradient_changes_nothing():
    run = ran(VARIANTS[0])
    counts, tape = run.population.run(run.batch, keep=False)
    assert tape is None
    assert all(map(torch.equal, counts, run.counts))


def test_bits_are_the_spikes():
    spikes = drawn(3, 4, 37)
    words = packed(spikes)
    assert words.shape == (3, 4, 2)
    read = torch.stack([(words[:, :, j // 32] >> (j % 32)) & 1 for j in range(37)], dim=2)
    assert torch.equal(read.to(torch.uint8), spikes)


def test_weights_come_back_as_they_went():
    nets = [network(4, hidden, seed) for seed, hidden in enumerate((9, 6))]
    population = Population(nets, Form.of(nets[0], 5), packed(drawn(1, 5, 4)), torch.device("cpu"))
    other = network(4, 6, 7)
    population.write(other, population.weights[1])
    for name in ("w_in", "w_rec", "w_out"):
        assert torch.equal(getattr(other, name), getattr(nets[1], name))


@pytest.mark.parametrize(
    ("net", "named"),
    [
        (RSNN(4, 3, RSNNSpec(hidden=65), 400.0), "65 hidden"),
        (RSNN(129, 3, RSNNSpec(hidden=6), 400.0), "129 inputs"),
        (RSNN(4, 3, RSNNSpec(hidden=6, readout="integrator"), 400.0), "integrator"),
        (RSNN(4, 3, RSNNSpec(hidden=6, readout="max"), 400.0), "max"),
        (RSNN(4, 3, RSNNSpec(hidden=6, learn=("beta",)), 400.0), "learned dynamics"),
        (RSNN(4, 3, RSNNSpec(hidden=6), 400.0, dtype=torch.float64), "float64"),
    ],
)
def test_what_no_kernel_runs_is_refused_in_a_line(net, named):
    with pytest.raises(InputError, match=named) as caught:
        Form.of(net, 10)
    assert "\n" not in str(caught.value)


COMPILE = """
import json, re, sys
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from neurotact.networks.population import kernels
from neurotact.networks.population.population import Form
from neurotact.neurons import CubaLIF

def products(fn, form, fused, **more):
    constants = {**form.constants(), **more}
    kinds = {name: "*i32" for name in ("spikes", "windows", "members", "sizes", "trials")}
    kinds |= dict.fromkeys(("most_trials", "n_steps", "n_inputs", "n_tiles"), "i32")
    kinds |= dict.fromkeys(constants, "constexpr")
    signature = {name: kinds.get(name, "*fp32") for name in fn.arg_names}
    source = ASTSource(fn=fn, signature=signature, constexprs=constants)
    options = {"num_warps": 4, "enable_fp_fusion": fused}
    made = triton.compile(source, target=GPUTarget("cuda", 90, 32), options=options)
    return len(re.findall(r"fma\\.rn\\S*\\.f32", made.asm["ptx"])), "ftz" in made.asm["ptx"]

form = Form(16, 32, 8, 300, CubaLIF("delayed"), True)
found = {"ordered": products(kernels.forward, form, False, KEEP=True)}
found["fused"] = products(kernels.forward, form, True, KEEP=True)
found["backward"] = products(kernels.backward, form, False)
print(json.dumps(found))
"""


def test_compiled_for_a_gpu_forward_holds_no_fused_multiply_add():
    """Triton compiles for a GPU that is not there; allowed to fuse, it would, and spikes would differ."""
    environment = {key: value for key, value in os.environ.items() if key != "TRITON_INTERPRET"}
    done = subprocess.run([sys.executable, "-c", COMPILE], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["ordered"] == [0, False]  # nor are small numbers flushed to zero
    assert found["fused"][0] > 0
    assert found["backward"][0] > 0  # it does compile; the order of its products is the compiler's
