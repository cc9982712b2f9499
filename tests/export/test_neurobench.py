"""NeuroBench's columns: by loops over single numbers, and as NeuroBench itself counts the network in snnTorch."""

import shutil
from importlib.util import find_spec
from typing import Any

import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_event_run, make_run
from neurotact_parts.exporters.neurobench_columns import columns

import neurotact as nt
from neurotact.errors import InputError
from neurotact.networks.training import run_folder, tasks
from neurotact.networks.use import inference

READOUTS = {
    "count": {},
    "integrator": {"readout": "integrator"},
    "stretches": {"readout": "integrator", "readout_stretches": 2, "readout_stretch_ms": 4.0},
    "direct": {"readout": "integrator", "direct": True},
}
N_INPUTS, N_HIDDEN, N_CLASSES = 3, 4, 2
BYTES = 4


def network(membrane: str, reset: str, delay: int | None, readout: str, seed: int, step_ms: float | None = None):
    """Weights in eighths, some of them zero, and decays of 1/2: in ten steps float32 rounds nothing.

    delay: None without recurrence.
    """
    keys = {"membrane": membrane, "reset": reset, "step_ms": step_ms, **READOUTS[readout]}
    keys |= {"model": "snn"} if delay is None else {"model": "rsnn", "recurrent_delay_steps": delay}
    made = nt.RSNN(N_INPUTS, N_CLASSES, nt.RSNNSpec(hidden=N_HIDDEN, **keys), 1000.0)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for weights in made.weights:
            weights.copy_(torch.randint(-4, 12, weights.shape, generator=generator) / 8)
        made.alpha.fill_(0.5)
        made.beta.fill_(0.5)
    return made


def windows(seed: int, n_windows: int = 5, n_steps: int = 10) -> torch.Tensor:
    return (torch.rand(n_windows, n_steps, N_INPUTS, generator=torch.Generator().manual_seed(seed)) < 0.4).float()


DRAWN = (
    st.sampled_from(["eq4", "delayed", "immediate"]), st.sampled_from(["zero", "subtract"]),
    st.sampled_from([None, 0, 1]), st.sampled_from([*READOUTS]), st.integers(0, 2**31), st.sampled_from([None, 2.0]),
    st.sampled_from([10, 3, 2, 1]),
)  # fmt: skip


# --- by loops ---------------------------------------------------------------------------------------


class Loops:
    """NeuroBench's counters, in neurons that are computed one by one."""

    def __init__(self) -> None:
        self.acs = self.active = self.outputs = self.updates = 0

    def projected(self, spikes: list[float], weights: list[list[float]], neuron: int, times: int = 1) -> float:
        total = 0.0
        for spike, row in zip(spikes, weights, strict=True):
            self.acs += times * (spike != 0 and row[neuron] != 0)
            total += spike * row[neuron]
        return total

    def fired(self, syn: float, mem: float, before: float, reset: str, first: bool) -> tuple[float, float]:
        if before > 1:
            mem = 0.0 if reset == "zero" else mem - 1.0
        self.updates += first or mem != before
        self.outputs += 1
        self.active += mem > 1
        return syn, mem


def looped(net: nt.RSNN, x: list[list[float]], found: Loops) -> None:
    """One window by snnTorch's equations, syn = syn / 2 + input and mem = mem / 2 + syn.

    Weights are halved where the current is halved with the membrane; late layers hear nothing of the last two steps.
    """
    spec = net.spec
    late, factor = (0 if spec.membrane == "immediate" else 2), (0.5 if spec.membrane == "eq4" else 1.0)
    w_in, w_out = net.w_in.tolist(), net.w_out.tolist()
    sent, state = [[0.0] * N_HIDDEN for _ in range(late)], [(0.0, 0.0)] * N_HIDDEN
    for k in range(len(x) - late):
        back = k + late - max(1, late) - spec.recurrent_delay_steps
        returning = sent[back] if back >= 0 else [0.0] * N_HIDDEN
        following = []
        for j, (syn, mem) in enumerate(state):
            current = found.projected(x[k], w_in, j)
            if net.w_rec is not None:
                current += found.projected(returning, net.w_rec.tolist(), j, 2 if spec.reset == "zero" else 1)
            after = syn / 2 + factor * current
            following.append(found.fired(after, mem / 2 + after, mem, spec.reset, k == 0))
        state = following
        sent.append([float(mem > 1) for _, mem in state])
    if net.bias is not None:
        for k, spikes in enumerate(sent[: len(x)]):
            for c in range(N_CLASSES):
                found.projected(spikes + (x[k] if spec.direct else []), w_out, c)
        return
    state = [(0.0, 0.0)] * N_CLASSES
    for k in range(len(x) - late):
        for c, (syn, mem) in enumerate(state):
            after = syn / 2 + factor * found.projected(sent[k], w_out, c)
            state[c] = found.fired(after, mem / 2 + after, mem, spec.reset, k == 0)


@given(*DRAWN)
@examples(60)
def test_the_columns_are_what_loops_over_single_numbers_count(membrane, reset, delay, readout, seed, step_ms, n):
    net, x, found = network(membrane, reset, delay, readout, seed, step_ms), windows(seed, n_steps=n), Loops()
    for window in net.binned(x).tolist():
        looped(net, window, found)
    row = columns(net, x)
    weights = [net.w_in, net.w_out] if net.w_rec is None else [net.w_in, net.w_rec, net.w_out]
    every = torch.cat([weight.flatten() for weight in weights])
    # Of each spiking layer: alpha, beta and threshold of each neuron, a factor of spikes, and the reset as an int64.
    layers = [N_HIDDEN] if net.bias is not None else [N_HIDDEN, N_CLASSES]
    more = [value for value in (net.bias, net.w_stretch) if value is not None]
    assert row == {
        "footprint_bytes": BYTES * (len(every) + sum(value.numel() for value in more))
        + sum(3 * BYTES * n + BYTES + 8 for n in layers),
        "connection_sparsity": round(float((every == 0).double().mean()), 4),
        "activation_sparsity": pytest.approx(1 - found.active / found.outputs if found.outputs else 0.0, rel=1e-12),
        "effective_acs": found.acs / len(x),
        "effective_macs": 0.0,
        "membrane_updates": found.updates / len(x),
    }


def test_what_is_compared_spikes_and_rests():
    rows = pd.DataFrame([columns(network("eq4", "zero", 0, "count", seed), windows(seed)) for seed in range(20)])
    assert 0.5 < rows["activation_sparsity"].mean() < 0.9
    assert (rows["activation_sparsity"] < 1).all()
    assert (rows["connection_sparsity"] > 0).any()
    assert rows["membrane_updates"].max() < 8 * (N_HIDDEN + N_CLASSES)  # some membranes rest


def test_windows_are_counted_as_one_batch_whatever_their_number():
    net, x = network("eq4", "zero", 0, "count", 3), windows(3, n_windows=150)
    rows = pd.DataFrame([columns(net, part) for part in x.split(50)])
    assert columns(net, x) == pytest.approx(rows.mean().to_dict())


def test_without_zeros_recurrence_and_late_layers_they_are_our_sops():
    net, x = network("immediate", "subtract", None, "count", 5), windows(5)
    with torch.no_grad():
        for weights in net.weights:
            weights[weights == 0] = 0.125
    spikes = net.simulate(x).hidden.sum(), x.sum()
    assert columns(net, x)["effective_acs"] * len(x) == N_CLASSES * spikes[0] + N_HIDDEN * spikes[1]


# --- as NeuroBench does -----------------------------------------------------------------------------


def by_neurobench(net: nt.RSNN, x: torch.Tensor, batch: int) -> dict[str, Any]:
    import snntorch
    from neurobench.benchmarks import Benchmark
    from neurobench.metrics.static import ConnectionSparsity, Footprint
    from neurobench.metrics.workload import ActivationSparsity, MembraneUpdates, SynapticOperations
    from neurobench.models import TorchModel
    from torch.utils.data import DataLoader, TensorDataset

    model = TorchModel(nt.to_snntorch(net))
    model.add_activation_module(snntorch.SpikingNeuron)
    loader = DataLoader(TensorDataset(x, torch.zeros(len(x))), batch_size=batch)
    metrics = [[Footprint, ConnectionSparsity], [ActivationSparsity, SynapticOperations, MembraneUpdates]]
    found = Benchmark(model, loader, [], [lambda both: both[1].sum(dim=1)], metrics).run(quiet=True)
    operations = found["SynapticOperations"]
    return {
        "footprint_bytes": found["Footprint"],
        "connection_sparsity": found["ConnectionSparsity"],
        "activation_sparsity": pytest.approx(found["ActivationSparsity"], rel=1e-12),  # a mean of batches
        "effective_acs": operations["Effective_ACs"],
        "effective_macs": operations["Effective_MACs"],
        "membrane_updates": found["MembraneUpdates"],
    }


needs_neurobench = pytest.mark.skipif(
    not find_spec("neurobench"),
    reason="no neurobench here; pip install --no-deps neurobench==2.3.0",
)


@needs_neurobench
@given(*DRAWN, st.integers(1, 5))
@examples(40)
def test_the_columns_are_those_of_neurobench(membrane, reset, delay, readout, seed, step_ms, n, batch):
    net, x = network(membrane, reset, delay, readout, seed, step_ms), windows(seed, n_steps=n)
    assert columns(net, x) == by_neurobench(net, x, batch)


@needs_neurobench
def test_membranes_that_hardly_move_are_rounded_as_there():
    net = nt.RSNN(N_INPUTS, N_CLASSES, nt.RSNNSpec(hidden=60, readout="integrator", model="snn"), 1000.0)
    with torch.no_grad():
        net.w_in.copy_(torch.randn(net.w_in.shape, generator=torch.Generator().manual_seed(0)))
    x = windows(1, n_windows=20, n_steps=150)
    assert columns(net, x) == by_neurobench(net, x, len(x))


@needs_neurobench
@pytest.mark.parametrize("make", [make_run, make_event_run])
def test_the_columns_of_a_run_are_those_of_neurobench(tmp_path, make):
    folder = make(tmp_path)
    row = nt.export(folder / "run", tmp_path / "scores.csv", "neurobench").iloc[0].to_dict()
    restored = run_folder.restore(folder / "run")
    test = tasks.sides_of(run_folder.trained_spikes_of(restored), restored.task).test
    assert isinstance(restored.network, nt.RSNN)
    expected = by_neurobench(restored.network, test.spikes.float(), 2)
    assert {name: row[name] for name in expected} == expected


# --- of a run ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("made"), 30)


def test_a_run_has_a_row_of_its_test_windows(made, tmp_path):
    told = []
    table = nt.export(made / "run", tmp_path / "scores.csv", "neurobench", tell=told.append)
    whole = nt.summarise(nt.infer(made / "run", made / "spikes.h5", test_only=True, early_exit=False)).iloc[-1]
    restored = run_folder.restore(made / "run")
    test = tasks.sides_of(run_folder.trained_spikes_of(restored), restored.task).test
    assert isinstance(restored.network, nt.RSNN)
    assert table.to_dict("records") == [
        {
            "windows": whole["windows"], "accuracy_test": whole["accuracy"],
            **columns(restored.network, test.spikes), "sops_total": whole["sops_total"],
        }
    ]  # fmt: skip
    assert len(test.labels) == whole["windows"] > 2
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "scores.csv"), table, check_dtype=False)
    assert told[0] is table
    assert "computes recurrence twice" in told[1]


@pytest.mark.parametrize("settings", [{"model": "snn"}, {"reset": "subtract"}])
def test_what_is_not_counted_twice_is_not_told_of(tmp_path, settings):
    told = []
    make_event_run(tmp_path, **settings)
    nt.export(tmp_path / "run", tmp_path / "scores.json", "neurobench", tell=told.append)
    assert len(told) == 1


def test_our_own_columns_are_of_whole_test_windows(made, tmp_path, monkeypatch):
    asked, infer = [], inference.infer
    monkeypatch.setattr(inference, "infer", lambda *given, **how: asked.append(how) or infer(*given, **how))
    nt.export(made / "run", tmp_path / "scores.csv", "neurobench")
    assert asked == [{"early_exit": False, "test_only": True}]


def test_the_spikes_of_another_training_are_refused(made, tmp_path):
    make_run(tmp_path, 12)
    with pytest.raises(InputError, match=r"spikes\.h5: no longer contains the trials"):
        nt.export(made / "run", tmp_path / "scores.csv", "neurobench", spikes=tmp_path / "spikes.h5")


def test_outputs_that_exist_and_inputs_are_kept(made, tmp_path):
    out = tmp_path / "scores.md"
    nt.export(made / "run", out, "neurobench")
    with pytest.raises(InputError, match=r"scores\.md: already exists"):
        nt.export(made / "run", out, "neurobench")
    nt.export(made / "run", out, "neurobench", force=True)
    for taken in (made / "spikes.h5", *run_folder.files_of(made / "run")):
        with pytest.raises(InputError, match=r"is an input of this command"):
            nt.export(made / "run", taken, "neurobench", force=True)


def test_spikes_that_moved_are_named(made, tmp_path):
    shutil.copytree(made / "run", tmp_path / "elsewhere" / "run")  # its spikes are no longer beside it
    with pytest.raises(InputError, match=r"name them with `spikes`"):
        nt.export(tmp_path / "elsewhere" / "run", tmp_path / "a.csv", "neurobench")
    moved = nt.export(tmp_path / "elsewhere" / "run", tmp_path / "a.csv", "neurobench", spikes=made / "spikes.h5")
    assert moved.equals(nt.export(made / "run", tmp_path / "b.csv", "neurobench"))


def test_a_network_that_snntorch_cannot_hold_is_refused(tmp_path):
    make_event_run(tmp_path, reset="hard")
    with pytest.raises(InputError, match=r"snnTorch"):
        nt.export(tmp_path / "run", tmp_path / "scores.csv", "neurobench")
    assert not (tmp_path / "scores.csv").exists()


def test_a_classifier_in_memory_has_no_test_windows():
    with pytest.raises(InputError, match=r"neurobench needs the folder of a training, whose test windows"):
        nt.export(nt.SpikingClassifier(), "scores.csv", "neurobench")
