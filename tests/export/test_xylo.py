"""XyloAudio 2: our integers are the chip's, by loops over single numbers and by XyloSim; what a conversion keeps."""

import json
import re
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples, thinned
from made_chains import make_event_run, make_run
from neurotact_parts.exporters import chips
from neurotact_parts.exporters.xylo import export
from neurotact_parts.exporters.xylo.chip import Chip, ChipLayer, Ran
from neurotact_parts.exporters.xylo.conversion import converted, with_neurons_of_the_chip

import neurotact as nt
from neurotact.data import hdf5
from neurotact.errors import InputError
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training.run_folder import Restored
from neurotact.networks.training.tasks import Task
from neurotact.neurons import CubaLIF

has_xylosim = pytest.mark.skipif(export.find_spec("xylosim") is None, reason=export.ABSENT)
KINDS = ("spikes", "currents", "membranes")
RATE_Hz = 1000.0


def drawn(seed: int) -> tuple[Chip, np.ndarray]:
    """A chip with random numbers in all its bits, and input spikes: several a step, and states at their limits."""
    rng = np.random.default_rng(seed)
    n_inputs, hidden, classes, steps = rng.integers(1, (9, 13, 5, 30)).tolist()
    largest, most = (128, 32768) if seed % 3 == 0 else (40, 900)

    def weights(*shape: int) -> np.ndarray:
        return rng.integers(-largest, largest, shape) * (rng.random(shape) < rng.random())

    def layer(n_before: int, n: int, among: bool, sent: int) -> ChipLayer:
        shifts, dashes = rng.integers(0, 8, 2).tolist(), rng.integers(1, 16, 2).tolist()
        recurrent = weights(n, n) if among else None
        return ChipLayer(weights(n_before, n), recurrent, *shifts, *dashes, rng.integers(1, most, n), sent)

    chip = Chip(layer(n_inputs, hidden, bool(seed % 4), 31), layer(hidden, classes, False, 1))
    counts = rng.integers(1, 3, (2, steps, n_inputs)) * (rng.random((2, steps, n_inputs)) < rng.random())
    return chip, counts.astype(np.uint8)


def by_single_numbers(chip: Chip, window: np.ndarray) -> list[list[list[tuple[int, int, int, bool]]]]:
    """What XyloSim's C++ does, line by line: (spikes, current, membrane, clipped) of each neuron, step and layer."""

    def clip(x: int) -> int:
        return max(-32768, min(32767, x))

    def decay(x: int, dash: int) -> int:
        return x >> dash or (x > 0) - (x < 0)

    layers = [chip.hidden, chip.readout]
    currents, membranes = ([[0] * len(layer.threshold) for layer in layers] for _ in range(2))
    sent, told = [0] * len(chip.hidden.threshold), [[], []]
    for arriving in [*window.tolist(), [0] * window.shape[1]]:
        projections = [(0, arriving, chip.hidden.weights, chip.hidden.shift)]
        if chip.hidden.among is not None:
            projections.append((0, sent, chip.hidden.among, chip.hidden.shift_among))
        projections.append((1, sent, chip.readout.weights, chip.readout.shift))
        for layer, spikes, weights, shift in projections:
            for count, row in zip(spikes, weights.tolist(), strict=True):
                for _ in range(count):
                    currents[layer] = [clip(i + (w << shift)) for i, w in zip(currents[layer], row, strict=True)]
        for k, layer in enumerate(layers):
            now = []
            for j, threshold in enumerate(layer.threshold.tolist()):
                is_full = currents[k][j] in (-32768, 32767)
                currents[k][j] -= decay(currents[k][j], layer.dash_syn)
                wanted = currents[k][j] - decay(membranes[k][j], layer.dash_mem)
                risen = membranes[k][j] + clip(wanted)
                membranes[k][j] = clip(risen)
                is_full |= clip(wanted) != wanted or clip(risen) != risen
                n = 0
                while membranes[k][j] >= threshold and n < layer.most:
                    membranes[k][j], n = membranes[k][j] - threshold, n + 1
                now.append((n, currents[k][j], membranes[k][j], is_full))
            told[k].append(now)
        sent = [n for n, *_ in told[0][-1]]
    return told


@given(st.integers(0, 10**6))
@examples(60)
def test_a_chip_is_a_loop_over_single_numbers(seed):
    chip, spikes = drawn(seed)
    expected = [np.array(layer) for layer in zip(*(by_single_numbers(chip, each) for each in spikes), strict=True)]
    for ran, loop in zip(chip.run(spikes), expected, strict=True):
        assert np.stack([getattr(ran, kind) for kind in KINDS], axis=-1).tolist() == loop[..., :3].tolist()
        assert ran.clipped == loop[..., 3].sum()


def test_what_is_drawn_meets_the_limits():
    ran = [each for seed in range(30) for each in drawn(seed)[0].run(drawn(seed)[1])]
    assert sum(each.clipped > 0 for each in ran) > 5
    assert sum((each.spikes == 31).any() for each in ran) > 1
    assert sum((each.spikes > 0).any() and not each.clipped for each in ran) > 5


@has_xylosim
@given(st.integers(0, 10**6))
def test_a_chip_is_xylosim(seed):
    chip, spikes = drawn(seed)
    told = export.beside_xylosim(chip, spikes)
    assert all(words.startswith("equal") for words in told.iloc[:, 1]), told.to_string()


def test_a_change_of_a_membrane_beyond_16_bits_is_clipped_and_counted():
    layer = ChipLayer(np.array([[-128], [127]]), None, 7, 0, 15, 1, np.array([2**15 - 1]), 0)
    ran = layer.run(np.array([[[1, 0], [0, 3]]], np.uint8))
    assert ran.membranes.ravel().tolist() == [-16383, -16383 + 2**15 - 1]  # of 32384 and the decay of 8192
    assert ran.clipped == 1


def network(readout="count", n_inputs=4, rate_Hz=RATE_Hz, seed=0, **keys) -> nt.RSNN:
    generator = torch.Generator().manual_seed(seed)
    spec = {"hidden": 7, "forward_weight_scale": 3.0, "readout": readout, **keys}
    return nt.RSNN(n_inputs, 3, sampling_rate_Hz=rate_Hz, generator=generator, dtype=torch.float64, **spec)


def windows(n_steps=60, share=0.2, n_inputs=4) -> torch.Tensor:
    return torch.from_numpy((np.random.default_rng(0).random((8, n_steps, n_inputs)) < share).astype(np.uint8))


FITTING = {
    "membrane": "immediate", "reset": "subtract",
    "tau_mem_ms": chips.steps_of(4), "tau_syn_ms": chips.steps_of(3),
}  # fmt: skip


@pytest.mark.parametrize("readout", ["count", "integrator"])
def test_a_network_of_the_chips_neurons_is_not_changed(readout):
    net = network(readout, **FITTING)
    made, inputs = with_neurons_of_the_chip(net), windows()
    for ours, theirs in zip(net.infer(inputs), made.infer(inputs), strict=True):
        torch.testing.assert_close(ours, theirs)
    assert {"membrane": made.spec.membrane, "reset": made.spec.reset}.items() <= FITTING.items()


@given(
    membrane=st.sampled_from(["eq4", "delayed", "immediate"]),
    taus=st.tuples(st.floats(1.0, 40.0), st.floats(1.0, 40.0)),
    above=st.booleans(),
)
@examples(30)
def test_a_constant_rate_reaches_a_converted_threshold_where_it_did(membrane, taus, above):
    net = network(model="snn", membrane=membrane, tau_mem_ms=taus[0], tau_syn_ms=taus[1], n_inputs=1)
    alpha, beta = float(net.alpha[0]), float(net.beta[0])
    gain = (beta if membrane == "eq4" else 1) / (1 - alpha) / (1 - beta)
    net.w_in.data[:] = (1.02 if above else 0.98) / gain
    constant = torch.ones(1, 400, 1, dtype=torch.uint8)
    made = converted(net, constant[:, :20])
    spikes = [each.simulate(constant).hidden.sum().item() > 0 for each in (net, made.network)]
    spikes += [bool(chip.run(constant.numpy())[0].spikes.any()) for chip in (made.fine,)]
    assert spikes == [above] * 3


@pytest.mark.parametrize(("readout", "expected"), [("integrator", [1, 2, 0]), ("max", [0, 2, 1])])
def test_membranes_are_read_at_the_end_or_at_their_largest(readout, expected):
    """The bias is added in the unit of a weight; below 0 a maximum is 0, as ours begins there."""
    net = network(readout, model="snn", **FITTING)
    assert net.bias is not None
    net.bias.data[:] = net.w_out.detach().abs().max() / 127 * torch.tensor([0.0, 1.0, 1.5])
    made = converted(net, windows())
    for chip, bits in ((made.chip, made.chip.readout.shift), (made.fine, 20)):
        steps = np.array([[[9, 2, 0], [0, 3, 0]], [[0, 0, 0], [0, 0, 0]], [[-9, 9, -9], [-3, -9, -9]]]) * 2**bits
        assert made.labels(Ran(steps, steps, steps), chip).tolist() == expected


@given(leak=st.floats(2.0, 60.0), above=st.booleans(), peak=st.booleans())
@examples(20)
def test_a_constant_rate_lifts_a_converted_integrator_as_far(leak, above, peak):
    """One class is lifted by a hidden neuron that always spikes, another by its bias: the larger one wins."""
    keys = {"readout": "max" if peak else "integrator", "readout_tau_ms": leak, "model": "snn", "hidden": 1}
    net = network(**keys, n_inputs=1, **FITTING)
    net.w_in.data[:], net.w_out.data[:] = 50.0, torch.tensor([[1.0, 0.0, 0.0]])
    lifted = 1 / (1 - net.readout_decay)
    assert net.bias is not None
    net.bias.data[1] = lifted / (1.05 if above else 0.95)
    constant = torch.ones(1, 600, 1, dtype=torch.uint8)
    made = converted(net, constant[:, :20])
    found = [int(each.infer(constant).labels) for each in (net, made.network)]
    assert found == [0 if above else 1] * 2
    single = np.minimum(made.fine.run(constant.numpy())[0].spikes, 1)  # the chip's hidden neuron spikes 31 times
    for chip in (made.fine, made.chip):
        found = made.labels(chip.readout.run(single), chip)
        assert found.tolist() == [0 if above else 1]


@pytest.mark.parametrize("keys", [{"model": "snn"}, {"model": "snn", "step_ms": 2.0}])
def test_hidden_neurons_first_spike_as_in_float(keys):
    """Until its first reset, a neuron on the chip is that of the network, but for its bits."""
    net, inputs = network(**keys, **FITTING), windows()
    made, net_inputs = converted(net, inputs), net.binned(inputs).numpy()
    expected = made.network.simulate(torch.from_numpy(net_inputs)).hidden.numpy() > 0
    assert expected.any(axis=1).mean() > 0.2
    fine, rounded = (chip.run(net_inputs)[0].spikes[:, :-1] > 0 for chip in (made.fine, made.chip))
    assert (fine.argmax(axis=1) == expected.argmax(axis=1)).all()
    assert (fine.any(axis=1) == expected.any(axis=1)).all()
    assert (rounded.argmax(axis=1) == expected.argmax(axis=1)).mean() > 0.9


def test_weights_are_shifted_so_that_least_spikes_differ():
    net, inputs = network(model="snn", **FITTING), windows(share=0.7)
    made = converted(net, inputs)
    hidden, fine = made.chip.hidden, made.fine.run(inputs.numpy())[0].spikes
    assert 0 < hidden.shift < 7
    differ = []
    for shift in range(8):
        threshold = (hidden.threshold * 2.0 ** (shift - hidden.shift)).astype(int).clip(1, 2**15 - 1)
        other = Chip(hidden._replace(shift=shift, threshold=threshold), made.chip.readout)
        differ.append(int((other.run(inputs.numpy())[0].spikes != fine).sum()))
    assert differ[hidden.shift] < differ[7]
    assert differ[hidden.shift] < differ[0]


def test_an_integrator_adds_up_on_the_chip():
    net, inputs = network("integrator", model="snn", **FITTING), windows(n_steps=300)
    assert net.bias is not None
    net.bias.data[:] = torch.tensor([0.5, -0.5, 0.0])
    made, sent = converted(net, inputs), net.simulate(inputs).hidden.detach().numpy()
    expected = net.infer(inputs).labels.tolist()
    assert len({*expected}) > 1
    for chip in (made.fine, made.chip):
        assert made.labels(chip.readout.run(sent.astype(np.uint8)), chip).tolist() == expected


@given(seed=st.integers(0, 999), model=st.sampled_from(["snn", "rsnn"]), scale=st.sampled_from([1.0, 1e-3, 20.0]))
@examples(20)
def test_weights_and_thresholds_keep_their_ratio_in_the_chips_bits(seed, model, scale):
    net = network(model=model, seed=seed, **FITTING, **({"recurrent_delay_steps": 1} if model == "rsnn" else {}))
    if net.w_rec is not None:
        net.w_rec.data *= scale
    for weights in (net.w_in, net.w_rec):  # a neuron whose weights are too small for its threshold to have 16 bits
        if weights is not None:
            weights.data[:, 0] *= 1e-5
    made = converted(net, windows())
    assert made.network.neuron == CubaLIF("immediate", "subtract", 0)
    hidden, threshold = made.chip.hidden, float(made.network.threshold[0]) * (1 - 2.0**-made.chip.hidden.dash_syn)
    assert (hidden.dash_syn, hidden.dash_mem, made.chip.readout.dash_syn) == (3, 4, 3)
    for layer, floats in ((hidden.weights << hidden.shift, net.w_in), (hidden.among, net.w_rec)):
        if layer is None or floats is None:
            continue
        whole = layer << (hidden.shift_among if floats is net.w_rec else 0)
        shift = hidden.shift_among if floats is net.w_rec else hidden.shift
        unit, at_most = threshold / hidden.threshold, threshold / np.maximum(hidden.threshold - 1, 0.5)
        error = np.abs(whole * unit - floats.detach().numpy())
        assert (error <= 0.5001 * at_most * 2**shift + np.abs(whole) * (at_most - unit)).all()
        assert np.abs(whole >> shift).max() <= 127
    largest = [np.abs(each).max() for each in (hidden.weights, hidden.among) if each is not None]
    assert max(largest) == 127
    assert min(largest) >= 127 // 4 or 0 in (hidden.shift, hidden.shift_among)
    assert (hidden.threshold >= 1).all()
    assert (hidden.threshold <= 2**15 - 1).all()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("chip"))


def test_an_export_names_what_it_converts_and_what_that_costs(run, tmp_path):
    told = []
    chip = nt.export(run / "run", tmp_path / "chip.json", "xyloaudio2", prove=3, tell=told.append)
    words = "\n".join(each for each in told if isinstance(each, str))
    for what in (
        "membrane: eq4, on the chip immediate; rep",
        "reset: zero, on the chip subtract",
        "decay of the current:",
    ):
        assert f"  converted: {what}" in words
    assert "  outside: conditioning and afferents: analog signals, on the chip spikes; on a microcontroller" in words
    written = json.loads((tmp_path / "chip.json").read_text())
    assert written == chip.specification
    names = {"weights_in", "weights_rec", "weights_out", "threshold", "threshold_out"}  # as Rockpool has them
    names |= {f"dash_{state}{end}" for state in ("mem", "syn") for end in ("", "_out")}
    assert written.keys() == names | {f"weight_shift_{name}" for name in ("in", "rec", "out")}
    assert np.array(written["weights_rec"]).shape == (5, 5)
    shifts = [written[f"weight_shift_{name}"] for name in ("in", "rec", "out")]
    assert shifts == [chip.hidden.shift, chip.hidden.shift_among, chip.readout.shift]
    assert [len(written[key]) for key in ("weights_in", "threshold", "threshold_out", "dash_syn")] == [4, 5, 2, 5]
    with pytest.raises(InputError, match="exists"):
        nt.export(run / "run", tmp_path / "chip.json", "xyloaudio2")
    other = nt.export(run / "run", tmp_path / "chip.json", "xyloaudio2", force=True, tell=(again := []).append)
    assert other.specification == written
    assert again == told[: len(again)]
    assert len(again) == len(told) - 2


def test_a_proof_runs_the_test_windows(run, tmp_path, monkeypatch):
    """Of as many trials as are asked for, and on the network's clock."""
    ran = []
    monkeypatch.setattr(export, "beside_xylosim", lambda chip, inputs: ran.append(inputs) or "")
    for prove in (1, 2):
        nt.export(run / "run", tmp_path / "chip.json", "xyloaudio2", prove=prove, force=True)
    assert len(ran[1]) == 2 * len(ran[0])
    trains = hdf5.load_spikes(run / "spikes.h5")
    task = export.fitted.restore(run / "run").task
    first = export.tasks.trials_of(trains, task).test[:1]
    expected, _ = export.tasks.examples_of(trains, first, task)
    assert (ran[0] == expected.spikes.numpy()).all()


def test_stages_count_what_differs():
    net, inputs, labels = network(hidden=9, recurrent_weight_scale=2.0), windows(share=0.5), np.arange(8) % 3
    made = converted(net, inputs)
    stages = export.in_stages(net, made, inputs, labels)
    inferred, in_float = (each.infer(inputs) for each in (net, made.network))
    ran = [chip.run(inputs.numpy()) for chip in (made.fine, made.chip)]
    found = [inferred.labels, in_float.labels, *(made.labels(ran[k][1], (made.fine, made.chip)[k]) for k in (0, 1))]
    found = [np.asarray(each) for each in found]
    assert stages["accuracy_percent"].tolist() == [100 * (each == labels).mean() for each in found]
    assert stages["differ_from_infer"].tolist() == [(each != found[0]).sum() for each in found]
    assert stages["differ_from_infer"].max() > 0
    hidden = [np.asarray(each.hidden_spikes) for each in (inferred, in_float)]
    hidden += [each[0].spikes[:, :60].sum(axis=(1, 2), dtype=int) for each in ran]
    assert stages["hidden_spikes"].tolist() == [each.mean() for each in hidden]
    several = [int((each[0].spikes[:, :60] > 1).sum()) for each in ran]
    assert stages["several_spikes"].tolist() == [0, 0, *several]
    assert several[1] > 0
    assert stages["clipped"].tolist() == [0, 0, 0, ran[1][0].clipped + ran[1][1].clipped]


def test_without_xylosim_a_sentence_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(export, "find_spec", lambda name: None)
    assert re.search(r"not compared .* install it with: pip install xylosim", str(export.beside_xylosim(*drawn(0))))


@has_xylosim
@thinned("made", [make_run, partial(make_event_run, readout="count")])
def test_a_trained_run_is_equal_in_xylosim(tmp_path, made):
    """Of signals and of the events of a sensor."""
    told = []
    nt.export(made(tmp_path) / "run", tmp_path / "chip.json", "xyloaudio2", prove=9, tell=told.append)
    assert len(told[-2]) == 6
    assert all(words.startswith("equal") for words in told[-2].iloc[:, 1]), told[-2].to_string()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"readout": "integrator", "readout_stretches": 3, "readout_stretch_ms": 20.0}, "readout of stretches: .*= 1"),
        ({"threshold_adaptation": 0.3}, "threshold adaptation: XyloAudio 2 takes 0, not 0.3; train again"),
        ({"hidden": 1001, "model": "snn"}, "hidden neurons: XyloAudio 2 takes at most 1000, not 1001"),
        ({"n_inputs": 17}, "inputs: XyloAudio 2 takes at most 16, not 17"),
        ({"readout": "integrator", "direct": True}, "path past the hidden layer: limits of chips"),
        ({}, "was fitted in memory"),
    ],
)
def test_what_the_chip_does_not_have_is_refused(tmp_path, monkeypatch, keys, message):
    task = Task.model_validate({"window": {"length_ms": 60}})
    restored = Restored(network(**keys), task, FULL_WINDOW, ("a", "b", "c"), (), {}, None)
    monkeypatch.setattr(export.fitted, "restore", lambda run, spikes: restored)
    with pytest.raises(InputError, match=message):
        nt.export("run", tmp_path / "chip.json", "xyloaudio2")
    assert not [*tmp_path.iterdir()]
