"""A checkpoint of a training comes back bit for bit, or is refused in one sentence that says what to do."""

import math
import os

import pytest
import safetensors.torch
import torch
from hypothesis import given
from hypothesis import strategies as st

from neurotact.errors import InputError
from neurotact.networks.definition import optimisers
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training.epoch_checkpoint import SHA256, Net, _sha256, load, save
from neurotact.networks.training.epochs import Checkpoint, Examples, train

NET = Net(RSNNSpec(hidden=5, learn=("beta",), training=TrainingSpec(epochs=4, batch=8)), 3, 2)


@pytest.fixture(scope="module")
def checkpoint() -> Checkpoint:
    """After the third of four epochs."""
    spikes = (torch.rand(16, 30, 3, generator=torch.Generator().manual_seed(0)) < 0.3).to(torch.uint8)
    examples = Examples(spikes, torch.arange(16) % 2)
    net = RSNN(3, 2, NET.spec, 1000.0, backend="reference", generator=torch.Generator().manual_seed(1))
    kept: list[Checkpoint] = []
    train(net, examples, examples, generator=torch.Generator().manual_seed(2), keep=kept.append)
    return kept[2]


def test_a_checkpoint_comes_back_as_it_was(tmp_path, checkpoint):
    path = tmp_path / "new" / "checkpoint.safetensors"
    save(checkpoint, path, "one")
    again = load(path, NET, "one")
    assert again.epochs == checkpoint.epochs
    assert [type(value) for value in again.epochs[0]] == [int, float, float, float, float, int]
    for field in ("weights", "best_weights", "optimiser"):
        before, after = getattr(checkpoint, field), getattr(again, field)
        assert before.keys() == after.keys()
        assert all(before[name].numpy().tobytes() == after[name].numpy().tobytes() for name in before)
    assert torch.equal(again.generator, checkpoint.generator)
    assert set(checkpoint.optimiser) == {
        f"{name}.{key}" for name in ("w_in", "w_rec", "w_out", "beta") for key in ("step", "exp_avg", "exp_avg_sq")
    }
    assert os.listdir(path.parent) == [path.name]


def test_a_checkpoint_fits_the_optimiser_that_left_it(tmp_path, checkpoint):
    save(checkpoint, tmp_path / "c", "one")
    training = NET.spec.training.model_copy(update={"optimiser": "Adamax"})
    with pytest.raises(InputError, match="exp_inf' is missing"):
        load(tmp_path / "c", NET._replace(spec=NET.spec.model_copy(update={"training": training})), "one")


@pytest.mark.parametrize("optimiser", sorted({*optimisers.names()} - {"Muon"}))
def test_the_state_of_every_optimiser_comes_back(tmp_path, optimiser):
    training = NET.spec.training.model_copy(update={"optimiser": optimiser, "epochs": 1})
    net = NET._replace(spec=NET.spec.model_copy(update={"training": training, "readout": "integrator"}))
    spikes = torch.ones(4, 9, 3, dtype=torch.uint8)
    examples, kept = Examples(spikes, torch.arange(4) % 2), []
    network = RSNN(3, 2, net.spec, 1000.0, backend="reference")
    train(network, examples, examples, generator=torch.Generator(), keep=kept.append)
    save(kept[0], tmp_path / "c", "one")
    again = load(tmp_path / "c", net, "one").optimiser
    assert again.keys() == kept[0].optimiser.keys()
    assert all(torch.equal(again[name], value) for name, value in kept[0].optimiser.items())


def test_another_training_is_refused(tmp_path, checkpoint):
    save(checkpoint, tmp_path / "c", "one")
    with pytest.raises(InputError, match=r"of another training.*`force=True`"):
        load(tmp_path / "c", NET, "two")


def refusal_of(path) -> str | None:
    try:
        load(path, NET, "one")
    except InputError as error:
        return str(error)
    return None


@given(st.data())
def test_no_byte_can_be_changed_or_lost_unseen(tmp_path, checkpoint, data):
    save(checkpoint, tmp_path / "c", "one")
    content = bytearray((tmp_path / "c").read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        content = content[:at]
    else:
        content[at] ^= data.draw(st.integers(1, 255))
    (tmp_path / "c").write_bytes(content)
    refusal = refusal_of(tmp_path / "c")
    if refusal is None:
        assert content[at : at + 1].isspace()  # a space of the header, for another
    else:
        assert refusal.endswith("; start again with `force=True`")


def forged(path, tensors) -> None:
    """As a foreign tool would write it, digest included."""
    tensors = {name: tensor for name, tensor in tensors.items() if tensor is not None and name != SHA256}
    path.write_bytes(safetensors.torch.save({**tensors, SHA256: _sha256(tensors, "one")}))


def with_value(tensor, value):
    changed = tensor.clone()
    changed.view(-1)[0] = value
    return changed


@pytest.mark.parametrize(
    ("name", "change", "complaint"),
    [
        *(
            (n, lambda t: with_value(t, math.nan), "holds NaN")
            for n in ("weights.w_in", "best.w_rec", "adam.beta.step")
        ),
        ("log", lambda t: with_value(t, math.inf), "holds NaN or infinity"),
        ("log", lambda t: with_value(t, 2), "does not number the epochs"),
        ("log", lambda t: t[:0], "has 0 epochs where 1 to 4"),
        ("log", lambda t: torch.cat([t, t]), "has 6 epochs where 1 to 4"),
        ("log", lambda t: t[0, 0], "has 0 epochs"),
        ("log", lambda t: t[:, :3].contiguous(), "'log' is"),
        ("log", lambda _: None, "has 0 epochs"),
        ("weights.w_in", lambda t: t.T.contiguous(), "'weights.w_in' is"),
        ("weights.w_in", lambda t: t.double(), "'weights.w_in' is"),
        ("weights.w_in", lambda _: None, "'weights.w_in' is missing"),
        ("adam.w_out.exp_avg", lambda _: None, "'adam.w_out.exp_avg' is missing"),
        ("adam.alpha.step", lambda _: torch.zeros(()), "'adam.alpha.step' is unknown"),
        ("generator", lambda t: t[:-1].contiguous(), "'generator' is"),
        ("generator", lambda t: torch.full_like(t, 255), "generator state is invalid"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(tmp_path, checkpoint, name, change, complaint):
    save(checkpoint, tmp_path / "c", "one")
    tensors = safetensors.torch.load((tmp_path / "c").read_bytes())
    forged(tmp_path / "c", tensors)
    load(tmp_path / "c", NET, "one")  # the forger knows how
    forged(tmp_path / "c", {**tensors, name: change(tensors.get(name))})
    with pytest.raises(InputError, match=complaint):
        load(tmp_path / "c", NET, "one")


def test_a_checkpoint_of_another_network_is_refused(tmp_path, checkpoint):
    save(checkpoint, tmp_path / "c", "one")
    for net in (NET._replace(n_inputs=4), NET._replace(n_classes=3), NET._replace(spec=RSNNSpec(hidden=5))):
        with pytest.raises(InputError, match=r"c: '.*' is .*"):
            load(tmp_path / "c", net, "one")


@pytest.mark.parametrize("content", [b"", b"{", b"\x80\x04not a tensor", bytes(8), b"\xff" * 64])
def test_what_is_no_safetensors_file_is_refused(tmp_path, content):
    (tmp_path / "c").write_bytes(content)
    with pytest.raises(InputError, match=r"is damaged .*start again with `force=True`"):
        load(tmp_path / "c", NET, "one")


def test_a_checkpoint_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="c: there is no such file"):
        load(tmp_path / "c", NET, "one")
