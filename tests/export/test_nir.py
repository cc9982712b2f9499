"""NIR: what is written means what the network does, is read back to the last bit, and loads elsewhere."""

import json
import warnings
from itertools import pairwise

import h5py
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS, make_encoder, make_signal, unequal_stretches
from neurotact_parts.exporters.nir import compare, graph, note
from neurotact_parts.exporters.nir.execute import Interpreter, flat
from neurotact_parts.exporters.nir.nodes import Clock
from typer.testing import CliRunner

import neurotact as nt
from neurotact.cli import app
from neurotact.encoders import afferents
from neurotact.encoders.specs import n_afferents
from neurotact.errors import InputError
from neurotact.networks.exit.rule import ExitRule

nir = pytest.importorskip("nir")

MEMBRANES, RESETS = ("eq4", "delayed", "immediate"), ("zero", "subtract", "hard")


def network(seed=0, dtype=torch.float64, **keys) -> nt.RSNN:
    scales = {"forward_weight_scale": 3.0} | ({} if keys.get("model") == "snn" else {"recurrent_weight_scale": 0.4})
    made = nt.RSNN(
        6, 3, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(seed), dtype=dtype,
        **{"hidden": 7, **(scales if keys.get("hidden") != 0 else {}), **keys},
    )  # fmt: skip
    if made.bias is not None:
        made.bias.data = torch.linspace(-1, 1, 3, dtype=dtype)
    unequal_stretches(made)
    return made


def spikes(n_trials=3, n_steps=60, seed=0) -> np.ndarray:
    return (np.random.default_rng(seed).random((n_trials, n_steps, 6)) < 0.3).astype(np.uint8)


@given(
    membrane=st.sampled_from(MEMBRANES),
    reset=st.sampled_from(RESETS),
    delay=st.integers(0, 1),
    readout=st.sampled_from(["count", "integrator", "leaky", "stretches"]),
    model=st.sampled_from(["rsnn", "snn"]),
    past=st.sampled_from([{}, {"direct": True}, {"hidden": 0}]),
    seed=st.integers(0, 99),
    dt_s=st.sampled_from([None, 1e-4, 0.37]),
)
@examples(60)
def test_a_graph_spikes_as_its_network_and_reads_back_to_the_last_bit(
    tmp_path, membrane, reset, delay, readout, model, past, seed, dt_s
):
    past = past if readout in ("integrator", "stretches") else {}
    keys = {"membrane": membrane, "reset": reset, "model": model, **READOUTS[readout], **past}
    if past.get("hidden") == 0:
        keys = {**READOUTS[readout], **past}
    elif model == "rsnn":
        keys["recurrent_delay_steps"] = delay
    net = network(seed, **keys)
    path = tmp_path / "net.nir"
    nt.to_nir(net, path, dt_s=dt_s, force=True)
    written = nir.read(path)
    found = compare.report(net, written, spikes(seed=seed))
    assert found["differing"].tolist() == [0] * (1 + (net.spec.hidden > 0)), found.to_string()
    back = nt.from_nir(path).network
    assert back.spec == net.spec
    assert back.sampling_rate_Hz == net.sampling_rate_Hz
    assert [*back.state_dict()] == [*net.state_dict()]
    assert all(torch.equal(a, b) for a, b in zip(net.state_dict().values(), back.state_dict().values(), strict=True))


def test_a_maximum_over_time_is_refused_but_for_the_plain_form():
    net = network(readout="max")
    with pytest.raises(InputError, match=r"readout max: NIR does not run it.*readout = 'integrator'"):
        nt.to_nir(net)
    said = note.of(nt.to_nir(net, plain=True), "graph")
    assert said is not None
    assert "with a decay of 20 ms, from the bias on, and take the largest value over time" in said.differences[-1]


def test_the_sums_of_an_integrator_begin_at_its_bias():
    net = network(readout="integrator")
    out = Interpreter(nt.to_nir(net), 1e-3).run(np.zeros((1, 4, 6)))["output"]
    assert out[0] == pytest.approx(np.tile([-1.0, 0.0, 1.0], (4, 1)))


@pytest.mark.parametrize("reset", RESETS)
@pytest.mark.parametrize("membrane", MEMBRANES)
def test_the_report_finds_the_first_difference_of_the_plain_form(membrane, reset):
    net = network(membrane=membrane, reset=reset, model="snn")
    plain = nt.to_nir(net, plain=True)
    found = compare.report(net, plain, spikes())
    said = note.of(plain, "graph")
    assert said is not None
    is_exact = (membrane, reset) == ("immediate", "hard")
    assert bool(said.differences) != is_exact
    assert (found["differing"].sum() == 0) == is_exact
    if not is_exact:
        row = found.iloc[0]
        ours = net.simulate(torch.from_numpy(spikes())).hidden.detach().numpy()
        theirs = Interpreter(plain, 1e-3).run(spikes().astype(float), ("hidden",))["hidden"]
        first = tuple(np.argwhere(ours != theirs)[0])
        assert (row["first_trial"], row["first_step"], row["first_neuron"]) == first


def test_an_edited_weight_is_found_where_it_first_matters():
    net = network(membrane="immediate", reset="hard", model="snn")
    made = nt.to_nir(net)
    made.nodes["w_in"].weight = made.nodes["w_in"].weight.copy()
    made.nodes["w_in"].weight[2] = 0
    row = compare.report(net, made, spikes()).iloc[0]
    silenced = net.simulate(torch.from_numpy(spikes())).hidden.detach().numpy()[..., 2]
    assert row["first_neuron"] == 2
    assert row["first_step"] == np.flatnonzero(silenced[int(row["first_trial"])])[0]
    assert row["differing"] == silenced.sum()
    with pytest.raises(InputError, match="was changed since neurotact wrote it"):
        nt.from_nir(nt_changed(net))


def nt_changed(net: nt.RSNN):
    """A graph one of whose neurons got another time constant."""
    made = nt.to_nir(net)
    made.nodes["readout"].tau_mem = made.nodes["readout"].tau_mem * np.array([1.0, 2.0, 1.0])
    return made


# --- afferents --------------------------------------------------------------------------------------

SEVERAL = (
    {},
    {"sa1.grades": [0.5, 1.0]},
    {"sa1.opposite": True},
    {"sa1.opposite": True, "ra1.grades": [0.3, 0.5, 1, 2]},
)
"""Afferents of three taxels, of two, and of one, as many as the network hears."""


@given(
    sa=st.integers(0, 7), ra=st.integers(0, 7), seed=st.integers(0, 99), v_reset=st.sampled_from([-65.0, -70.0, -60.0]),
    several=st.sampled_from(SEVERAL),
)  # fmt: skip
@examples(40)
def test_lowered_afferents_rest_as_long_as_the_encoder_says(sa, ra, seed, v_reset, several):
    encoder = make_encoder(several)
    encoder = encoder.model_copy(
        update={
            "sa1": encoder.sa1.model_copy(update={"t_ref_ms": sa}),
            "ra1": encoder.ra1.model_copy(update={"t_ref_ms": ra}),
            "v_reset_mV": v_reset,
        }
    )
    signal = make_signal(150, n_taxels=6 // n_afferents(encoder, 1), seed=seed).astype(np.float64)[None]
    raster, _ = afferents.encode(signal, 1000.0, encoder)
    made = graph.of(network(), encoder, lower_refractory=True)
    found = compare.report(network(), made, raster, conditioned=signal, encoder=encoder)
    assert found["layer"].tolist() == ["afferents", "hidden", "readout"]
    assert found["differing"].sum() == 0, found.to_string()
    without = compare.report(network(), graph.of(network(), encoder), raster, conditioned=signal, encoder=encoder)
    assert (without["differing"].iloc[0] == 0) >= (sa == ra == 0)


def test_a_refractory_period_that_is_not_lowered_stands_in_the_note_and_makes_a_difference(tmp_path):
    encoder, signal = make_encoder(), np.full((1, 80, 3), 9.0)
    raster, _ = afferents.encode(signal, 1000.0, encoder)
    made = nt.to_nir((encoder, network()))
    said = note.of(made, "graph")
    assert said is not None
    assert (said.refractory_steps, said.lowered) == ({"sa1": 2, "ra1": 1}, False)
    assert "refractory" in said.differences[0]
    assert made.nodes["afferents"].metadata["refractory_time"].tolist() == [2e-3] * 3 + [1e-3] * 3
    assert "refractory_time" not in str(flat(graph.of(network(), encoder, lower_refractory=True))[0])
    nt.to_nir((encoder, network()), tmp_path / "fivefold.nir", dt_s=5e-3)
    stated = nir.read(tmp_path / "fivefold.nir").nodes["afferents"].metadata["refractory_time"]
    assert stated.tolist() == [1e-2] * 3 + [5e-3] * 3
    row = compare.report(network(), made, raster, conditioned=signal, encoder=encoder).iloc[0]
    # Without its rest a neuron fires again too soon: two steps before the second spike of the encoder.
    second = np.flatnonzero(raster[0, :, 0])[1]
    assert (row["layer"], row["first_step"], row["other"]) == ("afferents", second - 2, 1.0)


@pytest.mark.parametrize("several", SEVERAL)
def test_an_encoder_its_rule_and_classes_come_back(tmp_path, several):
    net, encoder = network(dtype=torch.float32), make_encoder(several, baseline="start")
    made = graph.of(
        net, encoder, rule=ExitRule(12, from_first_spike=True), classes=("felt", "silk", "wood"), lower_refractory=True
    )
    nir.write(tmp_path / "chain.nir", made)
    back = nt.from_nir(tmp_path / "chain.nir")
    assert (back.encoder, back.rule, back.classes) == (
        encoder,
        ExitRule(12, from_first_spike=True),
        ("felt", "silk", "wood"),
    )
    assert back.network.w_in.dtype == torch.float32
    assert float(nir.read(tmp_path / "chain.nir").metadata["dt"]) == 1e-3


# --- other simulators -------------------------------------------------------------------------------


def of_simulators(net: nt.RSNN, made, names) -> "compare.pd.DataFrame":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return compare.report(net, made, spikes(), names)


@pytest.mark.parametrize("model", ["rsnn", "snn"])
@pytest.mark.parametrize(("simulator", "module"), [("snntorch", "nirtorch"), ("norse", "norse")])
@pytest.mark.parametrize("readout", ["count", "stretches"])
def test_others_load_an_immediate_network_and_spike_as_it_does(tmp_path, simulator, module, model, readout):
    pytest.importorskip(module)
    net = network(membrane="immediate", reset="hard", model=model, dtype=torch.float32, **READOUTS[readout])
    nt.to_nir(net, tmp_path / "net.nir", dt_s=1e-4, plain=readout == "stretches")
    found = of_simulators(net, nir.read(tmp_path / "net.nir"), (simulator,))
    assert found["spikes"].min() > 100
    assert found["differing"].tolist() == [0, 0]


@pytest.mark.parametrize("reset", RESETS)
@pytest.mark.parametrize("membrane", MEMBRANES)
@pytest.mark.parametrize(("simulator", "module"), [("snntorch", "nirtorch"), ("norse", "norse")])
def test_others_run_the_plain_form_as_the_interpreter_does(tmp_path, membrane, reset, simulator, module):
    pytest.importorskip(module)
    net = network(membrane=membrane, reset=reset, dtype=torch.float32)
    nt.to_nir(net, tmp_path / "net.nir", plain=True, dt_s=1e-4)
    found = of_simulators(net, nir.read(tmp_path / "net.nir"), ("graph", simulator))
    mine, other = (part.drop(columns="simulator").reset_index(drop=True) for _, part in found.groupby("simulator"))
    assert mine.equals(other)


def test_a_simulator_that_lacks_a_node_is_told_so():
    pytest.importorskip("norse")
    with pytest.raises(InputError, match=r"norse: has no Delay; write the plain form"):
        of_simulators(network(), nt.to_nir(network()), ("norse",))
    pytest.importorskip("nirtorch")
    with pytest.raises(InputError, match=r"dt_s=1e-4"):
        of_simulators(network(), nt.to_nir(network(), plain=True), ("snntorch",))
    with pytest.raises(InputError, match="'nest' is unknown"):
        of_simulators(network(), nt.to_nir(network()), ("nest",))


@pytest.mark.parametrize("model", ["rsnn", "snn"])
def test_the_export_of_snntorch_takes_our_wrapper_and_we_take_its_file(tmp_path, model):
    pytest.importorskip("nirtorch")
    from snntorch.export_nir import export_to_nir

    net = network(membrane="immediate", reset="zero", model=model, dtype=torch.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = export_to_nir(nt.to_snntorch(net), torch.ones(1, 9, 6), ignore_dims=[0, 1])
    nir.write(tmp_path / "theirs.nir", theirs)
    with pytest.raises(InputError, match=r"does not contain its step.*1e-4"):
        nt.from_nir(tmp_path / "theirs.nir")
    back = nt.from_nir(tmp_path / "theirs.nir", dt_s=1e-4, sampling_rate_Hz=1000.0).network
    assert (back.spec.membrane, back.spec.reset, back.spec.model) == ("immediate", "hard", model)
    for name, value in net.state_dict().items():
        torch.testing.assert_close(back.state_dict()[name], value, rtol=1e-6, atol=1e-7)


def test_the_default_network_goes_to_snntorch_and_its_export(tmp_path):
    pytest.importorskip("nirtorch")
    from snntorch.export_nir import export_to_nir

    seeded = torch.Generator().manual_seed(0)
    net = nt.RSNN(6, 3, nt.RSNNSpec(model="snn", readout="integrator", hidden=5), 1000.0, generator=seeded)
    net.bias.data = torch.tensor([0.5, 0.0, -0.5])
    theirs = nt.to_snntorch(net)
    hidden, sums = theirs(torch.from_numpy(spikes()))
    ours = net.simulate(torch.from_numpy(spikes()))
    assert torch.equal(hidden, ours.hidden)
    # Sums of so many float32 terms, in another order: each addition rounds to half a unit in the last place of the sum.
    rounding = sums.shape[1] * torch.finfo(torch.float32).eps * sums.abs().max().item()
    torch.testing.assert_close(sums.double(), ours.readout.cumsum(dim=1) + net.integration.level, rtol=0, atol=rounding)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = export_to_nir(theirs, torch.ones(1, 9, 6), ignore_dims=[0, 1])
    assert [type(node).__name__ for node in made.nodes.values()] == ["Input", "Linear", "CubaLIF", "Linear", "Output"]


# --- what is refused --------------------------------------------------------------------------------


def test_what_no_graph_holds_is_refused_in_a_sentence(tmp_path):
    net = network()
    net.beta.data[0] = 1.0
    with pytest.raises(InputError, match=r"beta: is 1, and NIR's time constants represent only decays from 0"):
        nt.to_nir(net)
    with pytest.raises(InputError, match="leave out either"):
        graph.of(network(), make_encoder(), plain=True, lower_refractory=True)
    with pytest.raises(InputError, match="has no afferents"):
        graph.of(network(), lower_refractory=True)
    with pytest.raises(InputError, match="dt_s"):
        nt.to_nir(network(), dt_s=-1.0)
    with pytest.raises(InputError, match="is the plain form of a network, with 2 differences from it"):
        nt.from_nir(nt.to_nir(network(), plain=True))
    nt.to_nir(network(), tmp_path / "a.nir")
    with pytest.raises(InputError, match="already exists"):
        nt.to_nir(network(), tmp_path / "a.nir")


def foreign(**changes):
    """A feed-forward graph of another program."""
    clock = Clock(1e-3)
    nodes = {
        "w_in": nir.Linear(weight=np.ones((4, 2))), "hidden": clock.cuba(0.9, 0.8, 2.0, 4),
        "w_out": nir.Linear(weight=np.ones((3, 4))), "out": clock.cuba(0.5, 0.5, 1.0, 3),
    }  # fmt: skip
    nodes |= changes
    names = ["input", *nodes, "output"]
    ends = {"input": nir.Input({"input": np.array([2])}), "output": nir.Output({"output": np.array([3])})}
    return nir.NIRGraph({"input": ends["input"], **nodes, "output": ends["output"]}, list(pairwise(names)))


def test_the_thresholds_and_scales_of_others_go_into_the_weights():
    made = foreign()
    made.nodes["hidden"].w_in = made.nodes["hidden"].w_in * np.array([1.0, 2.0, 3.0, 4.0])
    net = nt.from_nir(made, dt_s=1e-3).network
    assert net.w_in[0].tolist() == pytest.approx([0.5, 1.0, 1.5, 2.0])
    assert compare.report(net, made_with_dt(made), spikes()[..., :2])["differing"].sum() == 0


def made_with_dt(made):
    made.metadata = {"dt": 1e-3}
    return made


@pytest.mark.parametrize(
    ("node", "key", "value", "complaint"),
    [
        ("out", "tau_syn", np.full(3, 1e-9), "below the step"),
        ("hidden", "tau_mem", np.full(4, -1.0), "below the step"),
        ("out", "v_threshold", np.full(3, np.nan), "not finite"),
        ("hidden", "metadata", {"refractory_time": np.full(4, 2e-3)}, r"'hidden' has a refractory_time.*take it out"),
    ],
)
def test_what_no_network_holds_is_refused(node, key, value, complaint):
    made = foreign()
    setattr(made.nodes[node], key, value)
    with pytest.raises(InputError, match=complaint):
        nt.from_nir(made, dt_s=1e-3)


def test_a_step_or_a_clock_that_the_file_states_otherwise_is_refused():
    """An argument is never taken and ignored; one that agrees is no error."""
    ours = nt.to_nir(network())
    dt_s, rate_Hz = ours.metadata["dt"], nt.from_nir(ours).network.sampling_rate_Hz
    for asked, stated in (({"dt_s": 3e-4}, dt_s), ({"sampling_rate_Hz": 123.0}, rate_Hz)):
        (name,) = asked
        with pytest.raises(InputError, match=rf"^{name}: .* is given, but graph states {stated:g}; leave {name} out$"):
            nt.from_nir(ours, **asked)
    theirs = foreign()
    theirs.metadata["dt"] = 1e-3
    with pytest.raises(InputError, match=r"^dt_s: 0\.0005 is given, but graph states 0\.001; leave dt_s out$"):
        nt.from_nir(theirs, dt_s=5e-4)
    for made, right in ((ours, {"dt_s": dt_s, "sampling_rate_Hz": rate_Hz}), (theirs, {"dt_s": 1e-3})):
        assert nt.from_nir(made, **right).network.sampling_rate_Hz == nt.from_nir(made).network.sampling_rate_Hz


def test_a_graph_without_one_input_and_one_output_is_refused():
    made = foreign()
    made.nodes["more"] = nir.Output({"output": np.array([3])})
    made.edges.append(("hidden", "more"))
    with pytest.raises(InputError, match="has 2 Output nodes; a network has one"):
        nt.from_nir(made, dt_s=1e-3)


# --- hostile files ----------------------------------------------------------------------------------


@pytest.fixture
def hostile(tmp_path):
    """A file of an own network, and a way to change it."""
    path = tmp_path / "net.nir"
    nt.to_nir(network(), path)

    def spoil(change) -> str:
        with h5py.File(path, "r+") as file:
            change(file)
        with pytest.raises(InputError) as raised:
            nt.from_nir(path)
        message = str(raised.value)
        assert "\n" not in message
        assert str(path) in message
        return message

    return spoil


def replaced(file, name, **keys):
    del file[name]
    file.create_dataset(name, **keys)


def test_a_declared_size_beyond_the_limit_is_refused_before_it_is_read(hostile):
    size = {"shape": (10**9, 100), "dtype": "f8", "chunks": (1000, 100), "compression": "gzip"}
    assert "more than the limit" in hostile(lambda file: replaced(file, "node/nodes/w_in/weight", **size))


def test_edges_without_end_are_refused(hostile):
    size = {"shape": (10**9, 2), "dtype": h5py.string_dtype(), "chunks": (1000, 2)}
    assert "limit" in hostile(lambda file: replaced(file, "node/edges", **size))


def test_links_to_other_files_and_circles_are_refused(hostile):
    def outside(file):
        del file["node/nodes/w_in/weight"]
        file["node/nodes/w_in/weight"] = h5py.ExternalLink("/etc/passwd", "/x")

    assert "is not in the file" in hostile(outside)


def test_graphs_within_graphs_have_an_end(hostile):
    def circle(file):
        file["node/nodes/inner"] = file["node"]

    assert "deeper than" in hostile(circle) or "more than" in hostile(circle)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("node/nodes/w_in/type", "Conv2d"),
        ("node/nodes/w_in/type", "os.system"),
        ("node/metadata/neurotact", "{" * 10_000),
        ("node/metadata/neurotact", json.dumps({"dt_s": 0})),
        ("node/metadata/dt", 5.0),
        ("node/nodes/w_in/weight", np.full((7, 6), np.nan)),
        ("node/nodes/w_in/weight", np.zeros((7, 6), complex)),
        ("node/nodes/w_in/weight", np.zeros((3, 6))),
        ("node/edges", np.array([["nobody", "w_in"]], dtype=h5py.string_dtype())),
    ],
)
def test_spoilt_values_are_refused_in_one_line(hostile, name, value):
    hostile(lambda file: replaced(file, name, data=value))


def test_a_file_that_is_no_nir_is_refused(tmp_path):
    (tmp_path / "a.nir").write_bytes(b"not HDF5")
    with pytest.raises(InputError, match="cannot be read as NIR"):
        nt.from_nir(tmp_path / "a.nir")
    with pytest.raises(InputError, match="there is no such file"):
        nt.from_nir(tmp_path / "b.nir")


# --- interpreter ------------------------------------------------------------------------------------


def test_a_delay_holds_back_each_value_for_its_own_time():
    made = nir.NIRGraph(
        {
            "input": nir.Input({"input": np.array([2])}), "d": nir.Delay(delay=np.array([1e-3, 3e-3])),
            "output": nir.Output({"output": np.array([2])}),
        },
        [("input", "d"), ("d", "output")],
    )  # fmt: skip
    out = Interpreter(made, 1e-3).run(np.arange(1.0, 11.0).reshape(1, 5, 2))["output"][0]
    assert out.tolist() == [[0, 0], [1, 0], [3, 0], [5, 2], [7, 4]]
    made.nodes["d"].delay = np.array([1e-3, 2.5e-3])
    with pytest.raises(InputError, match="is not a whole number of"):
        Interpreter(made, 1e-3)


def test_a_cycle_without_a_delay_comes_back_in_the_next_step():
    made = nir.NIRGraph(
        {
            "input": nir.Input({"input": np.array([1])}), "sum": nir.Threshold(threshold=np.array([0.5])),
            "back": nir.Scale(scale=np.array([1.0])), "output": nir.Output({"output": np.array([1])}),
        },
        [("input", "sum"), ("sum", "back"), ("back", "sum"), ("sum", "output")],
    )  # fmt: skip
    out = Interpreter(made, 1.0).run(np.array([[[0.0], [1.0], [0.0], [0.0]]]))["output"]
    assert out.ravel().tolist() == [0, 1, 1, 1]
    assert [*flat(made)[0]] == ["input", "sum", "back", "output"]


def test_a_node_without_a_meaning_is_named():
    made = nir.NIRGraph.from_list(nir.Flatten({"input": np.array([2, 3])}, start_dim=0, end_dim=-1))
    with pytest.raises(InputError, match="is a Flatten, which is not interpreted"):
        Interpreter(made, 1.0)


# --- command line -----------------------------------------------------------------------------------


def test_the_command_exports_proves_and_says_what_differs(tmp_path, caplog):
    encoder = make_encoder(baseline="start")
    recordings = nt.simulate("gratings", trials=1, duration_s=0.15)
    nt.save(recordings, tmp_path / "gratings.h5")
    nt.save(nt.encode(recordings, encoder), tmp_path / "spikes.h5")
    nt.train(
        tmp_path / "spikes.h5",
        tmp_path / "run",
        "rsnn",
        {"hidden": 6, "training.epochs": 1},
        window=nt.Window(length_ms=100),
    )
    arguments = ["export", str(tmp_path / "run"), "--to", "nir"]

    def said(*more: str) -> str:
        done = CliRunner().invoke(app, [*arguments, *more])
        assert done.exit_code == 0, done.output
        return done.output

    nt.train(tmp_path / "spikes.h5", tmp_path / "default", settings={"hidden": 6, "training.epochs": 1})
    words = ["export", str(tmp_path / "default"), "--to", "nir", "--recordings", str(tmp_path / "gratings.h5")]
    done = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "c.nir"), "--prove", "1"])
    assert done.exit_code == 0, done.output
    outside = "the encoder (clock slower than its encoder's"
    assert [outside in record.getMessage() for record in caplog.records].count(True) == 1
    for layer in ("hidden", "readout"):
        assert f"graph, {layer}: equal" in done.stdout
    assert outside in json.loads(nir.read(tmp_path / "c.nir").metadata["neurotact"])["outside"][0]
    done = CliRunner().invoke(app, [*words[:4], "-o", str(tmp_path / "d.nir"), "--lower-refractory"])
    assert str(done.exception).startswith(f"lower_refractory: the encoder stays outside the graph ({outside[13:]}")
    assert not (tmp_path / "d.nir").exists()
    lowered = said(
        "-o",
        str(tmp_path / "a.nir"),
        "--lower-refractory",
        "--prove",
        "1",
        "--recordings",
        str(tmp_path / "gratings.h5"),
    )
    for layer in ("afferents", "hidden", "readout"):
        assert f"graph, {layer}: equal" in lowered
    plain = said("-o", str(tmp_path / "b.nir"), "--plain", "--network-only")
    assert "differs: reset zero is written as hard" in plain
    back = nt.from_nir(tmp_path / "a.nir")
    assert back.encoder == encoder
    assert len(back.classes) == 8
