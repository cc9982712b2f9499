import contextlib
import json
import os

import pytest
import safetensors.torch
import torch
from hypothesis import given
from hypothesis import strategies as st
from snntorch import surrogate

from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.networks.training.run_folder import KEYS, NETWORK, WEIGHTS
from neurotact.networks.training.run_folder import load_network as load
from neurotact.networks.training.run_folder import save_network as save


def network(seed: int = 0, dtype: torch.dtype = torch.float32, **spec) -> RSNN:
    spec = RSNNSpec(**{"hidden": 10, "forward_weight_scale": 3.0, **spec})
    generator = torch.Generator().manual_seed(seed)
    made = RSNN(6, 4, spec, 2000.0, backend="reference", generator=generator, dtype=dtype)
    with torch.no_grad():  # as training would leave them: not what the spec alone gives
        made.alpha.mul_(torch.tensor([0.99, 0.97]))
        made.threshold.mul_(1.01)
    return made


def spikes() -> torch.Tensor:
    return (torch.rand(8, 60, 6, generator=torch.Generator().manual_seed(9)) < 0.2).to(torch.uint8)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("membrane", ["eq4", "delayed", "immediate"])
@pytest.mark.parametrize("delay", [0, 1])
def test_a_round_trip_gives_identical_outputs(tmp_path, membrane, delay, dtype):
    variant = {"membrane": membrane, "reset": "subtract", "recurrent_delay_steps": delay}
    net = network(dtype=dtype, **variant, learn=("alpha",), surrogate_scale=7.0)
    extra = {"classes": ["rough", "smooth", "ärmel", "d"], "best_epoch": 12, "losses": [1.5, 0.25], "encoder": None}
    save(net, tmp_path / "new" / "run", extra)
    again, metadata = load(tmp_path / "new" / "run", backend="reference")
    assert metadata["extra"] == extra
    assert (metadata["n_inputs"], metadata["n_classes"], metadata["sampling_rate_Hz"]) == (6, 4, 2000.0)
    assert again.spec == net.spec
    assert again.backend == "reference"
    assert again.w_in.dtype == dtype
    for (name, mine), (other, its) in zip(net.named_parameters(), again.named_parameters(), strict=True):
        assert name == other
        assert torch.equal(mine, its)
        assert mine.requires_grad == its.requires_grad
    assert again.spike == FastSigmoid(7.0)
    a, b = net.simulate(spikes()), again.simulate(spikes())
    assert a.readout.sum() > 0
    assert torch.equal(a.hidden, b.hidden)
    assert torch.equal(a.readout, b.readout)
    a.readout.sum().backward()
    b.readout.sum().backward()
    assert torch.equal(net.w_in.grad, again.w_in.grad)


def test_saving_twice_replaces_and_leaves_no_draft(tmp_path):
    save(network(0), tmp_path)
    save(network(1), tmp_path, {"run": 2})
    again, metadata = load(tmp_path)
    assert torch.equal(again.w_in, network(1).w_in)
    assert metadata["extra"] == {"run": 2}
    assert sorted(os.listdir(tmp_path)) == sorted([NETWORK, WEIGHTS])


def test_loading_draws_no_random_numbers(tmp_path):
    save(network(), tmp_path)
    before = torch.get_rng_state()
    load(tmp_path)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("length", [0, 1, 7, 8, 100, -1])
def test_truncated_weights_are_refused(tmp_path, length):
    save(network(), tmp_path)
    path = tmp_path / WEIGHTS
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(InputError, match=r"weights.safetensors: is damaged"):
        load(tmp_path)


def test_a_save_cut_off_between_its_files_is_noticed(tmp_path):
    save(network(0), tmp_path / "a")
    save(network(1), tmp_path / "b")
    (tmp_path / "b" / WEIGHTS).replace(tmp_path / "a" / WEIGHTS)
    with pytest.raises(InputError, match="is damaged, or not the file"):
        load(tmp_path / "a")


@pytest.mark.parametrize("length", [0, 1, 40, -3])
def test_truncated_json_is_refused(tmp_path, length):
    save(network(), tmp_path)
    path = tmp_path / NETWORK
    path.write_text(path.read_text()[:length])
    with pytest.raises(InputError, match=r"network.json: is not valid JSON"):
        load(tmp_path)


def rewrite(folder, tensors=None, **changes):
    """Alter a saved checkpoint as a foreign tool would, digest included."""
    import hashlib

    if tensors is not None:
        (folder / WEIGHTS).write_bytes(safetensors.torch.save(tensors))
    table = json.loads((folder / NETWORK).read_text())
    table["weights_sha256"] = hashlib.sha256((folder / WEIGHTS).read_bytes()).hexdigest()
    for key, value in changes.items():
        if value is None:
            del table[key]
        else:
            table[key] = value
    (folder / NETWORK).write_text(json.dumps(table))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        *(({key: None}, f"'{key}' is missing") for key in ("spec", "n_inputs", "n_classes", "dtype", "extra")),
        ({"n_inputs": 7}, r"'w_in' is \(6, 10\) torch.float32 where \(7, 10\)"),
        ({"n_classes": 10**12}, "'w_out'"),
        ({"n_inputs": 0}, "n_inputs must be a whole number"),
        ({"n_inputs": True}, "n_inputs must be a whole number"),
        ({"n_classes": "4"}, "n_classes must be a whole number"),
        ({"sampling_rate_Hz": -1}, "sampling_rate_Hz must be a positive"),
        ({"sampling_rate_Hz": "fast"}, "sampling_rate_Hz must be a positive"),
        ({"dtype": "float16"}, "did you mean 'float64'|did you mean 'float32'"),
        ({"dtype": "float64"}, "float64 is expected"),
        ({"dtype": ["float32"]}, "dtype"),
        ({"spec": {"hiden": 10}}, "hiden: unknown key; did you mean 'hidden'"),
        ({"spec": {"hidden": 11}}, "'w_in'"),
        ({"spec": {"hidden": 10, "recurrent_delay_steps": 2}}, "recurrent_delay_steps: must be <= 1; got 2"),
        ({"spec": {"hidden": 10, "recurrent_delay_steps": True}}, "recurrent_delay_steps: must be a whole number"),
        ({"spec": []}, "spec must be a table"),
        ({"extra": ["classes"]}, "extra must be a table"),
        ({"sampling_rate_Hz": 10**400}, "sampling_rate_Hz must be a positive"),
    ],
)
def test_tables_that_do_not_fit_are_refused(tmp_path, changes, complaint):
    save(network(), tmp_path)
    rewrite(tmp_path, **changes)
    with pytest.raises(InputError, match=complaint):
        load(tmp_path)


def test_weights_that_do_not_fit_are_refused(tmp_path):
    save(network(), tmp_path)
    tensors = safetensors.torch.load((tmp_path / WEIGHTS).read_bytes())
    for change, complaint in (
        ({"w_rec": None}, "'w_rec' is missing"),
        ({"w_reck": torch.zeros(2)}, r"'w_reck' is unknown \(did you mean 'w_rec'\?\); save the network again"),
        ({"w_rec": torch.zeros(10, 9)}, "'w_rec' is"),
        ({"alpha": torch.zeros(())}, "'alpha' is"),
        ({"alpha": torch.zeros(2, dtype=torch.float64)}, "'alpha' is"),
    ):
        altered = {name: value for name, value in {**tensors, **change}.items() if value is not None}
        rewrite(tmp_path, altered)
        with pytest.raises(InputError, match=complaint):
            load(tmp_path)
    rewrite(tmp_path, tensors)
    load(tmp_path)


def test_what_is_no_checkpoint_is_refused(tmp_path):
    with pytest.raises(InputError, match="there is no such folder"):
        load(tmp_path / "absent")
    with pytest.raises(InputError, match=r"network.json: there is no such file"):
        load(tmp_path)
    (tmp_path / NETWORK).write_text("[]")
    with pytest.raises(InputError, match="is not a checkpoint's table"):
        load(tmp_path)
    save(network(), tmp_path)
    (tmp_path / WEIGHTS).write_bytes(b"\x80\x04not a tensor")  # a pickle's first bytes
    rewrite(tmp_path)
    with pytest.raises(InputError, match="is not a safetensors file"):
        load(tmp_path)
    (tmp_path / WEIGHTS).unlink()
    with pytest.raises(InputError, match=r"weights.safetensors: there is no such file"):
        load(tmp_path)


def test_what_a_checkpoint_cannot_hold_is_refused_before_anything_is_written(tmp_path):
    for extra in ({"loss": float("nan")}, {"weights": torch.zeros(1)}):
        with pytest.raises(InputError, match="extra: cannot be written as JSON"):
            save(network(), tmp_path, extra)
    with pytest.raises(InputError, match=r"torch\.float16"):
        save(network().half(), tmp_path)
    odd = network()
    odd.spike = surrogate.atan()
    with pytest.raises(InputError, match="surrogate"):
        save(odd, tmp_path)
    assert os.listdir(tmp_path) == []


def test_a_feed_forward_network_is_kept_without_recurrent_weights(tmp_path):
    net = network(model="snn")
    save(net, tmp_path)
    assert "w_rec" not in safetensors.torch.load_file(tmp_path / WEIGHTS)
    again, _ = load(tmp_path, backend="reference")
    assert not again.spec.recurrent
    assert torch.equal(net.simulate(spikes()).readout, again.simulate(spikes()).readout)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("name", ["w_in", "w_rec", "w_out", "alpha", "beta", "threshold"])
def test_weights_that_are_nan_or_infinite_are_refused(tmp_path, name, value):
    save(network(), tmp_path / "run")
    tensors = safetensors.torch.load((tmp_path / "run" / WEIGHTS).read_bytes())
    tensors[name].flatten()[1] = value
    rewrite(tmp_path / "run", tensors)
    with pytest.raises(InputError, match=f"{WEIGHTS}: '{name}' holds NaN or infinity"):
        load(tmp_path / "run")
    broken = network()
    broken.load_state_dict(tensors)
    with pytest.raises(InputError, match=f"network: '{name}' holds NaN or infinity"):
        save(broken, tmp_path / "new")
    assert not (tmp_path / "new").exists()


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.just(10**400) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@given(st.sampled_from(KEYS[:-2]), JUNK)
def test_junk_in_the_table_is_refused_or_changes_nothing_that_runs(tmp_path, key, junk):
    save(network(), tmp_path)
    rewrite(tmp_path, **{key: junk})
    with contextlib.suppress(InputError):
        load(tmp_path)[0].infer(spikes())


def test_a_large_weights_file_is_refused_before_it_is_read(tmp_path, monkeypatch):
    save(network(), tmp_path)
    with (tmp_path / WEIGHTS).open("ab") as file:
        file.truncate(2_000_000)
    monkeypatch.setenv("NEUROTACT_MAX_MB", "1")
    with pytest.raises(InputError, match=f"{WEIGHTS}: holds 2 MB, more than the limit of 1 MB"):
        load(tmp_path)
