"""Checkpoints of a training on disk: one safetensors file, replaced only as a whole, never pickle.

Tensors: `log` (a row per epoch, the fields of `Epoch`), `generator`, `weights.*` and `best.*` (the network's state now
and after its best epoch), `adam.*` (the state of the optimiser, whichever it is), `member1.*` and so on (the states of
networks that are finished, where several are trained), and the SHA-256 of all of these with the name of the training.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from neurotact.errors import InputError
from neurotact.files import read_bytes, whole
from neurotact.networks.definition import optimisers
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training.epochs import Checkpoint, Epoch, tensors_of
from neurotact.networks.training.run_folder import Expected, expected_of, untrained
from neurotact.networks.training.run_folder import check_tensors as check

SHA256 = "sha256"
FIX = "start again with `force=True`"
PARTS = {"weights": "weights", "best": "best_weights", "adam": "optimiser"}
"""Prefixes of tensor names, and the field of `Checkpoint` that holds these tensors."""


class Net(NamedTuple):
    """What the tensors of a checkpoint depend on."""

    spec: RSNNSpec
    n_inputs: int
    n_classes: int
    sampling_rate_Hz: float = 1000.0

    def state(self) -> Expected:
        """Its tensors."""
        return expected_of(self.n_inputs, self.n_classes, self.spec, self.sampling_rate_Hz, torch.float32)

    def fixed(self) -> set[str]:
        """Those that are not trained."""
        if self.spec.own is None:
            return {"alpha", "beta", "threshold"} - set(self.spec.learn)
        network = untrained(self.n_inputs, self.n_classes, self.spec, self.sampling_rate_Hz, torch.float32)
        trained = {name for name, parameter in network.named_parameters() if parameter.requires_grad}
        return set(network.state_dict()) - trained


def save(checkpoint: Checkpoint, path: str | Path, training: str) -> None:
    """Write a checkpoint; it replaces the previous one.

    training: any text that identifies this training.
    """
    log = torch.tensor(checkpoint.epochs, dtype=torch.float64)
    tensors = {"log": log, "generator": checkpoint.generator}
    for part, field in PARTS.items():
        tensors |= {f"{part}.{name}": tensor for name, tensor in getattr(checkpoint, field).items()}
    for number, weights in enumerate(checkpoint.finished, 1):
        tensors |= {f"member{number}.{name}": tensor for name, tensor in weights.items()}
    content = safetensors.torch.save({**tensors, SHA256: _sha256(tensors, training)})
    with whole(path) as draft:
        draft.write_bytes(content)


def load(path: str | Path, net: Net, training: str) -> Checkpoint:
    """Read what `save` wrote; InputError explains why a file is damaged, or that it is of another training."""
    path = Path(path)
    tensors = _read(path)
    log = tensors.get("log", torch.empty(0))
    n_epochs, most = len(log) if log.ndim else 0, net.spec.n_trainings * net.spec.training.epochs
    if not 1 <= n_epochs <= most:
        raise _damaged(path, f"its log has {n_epochs} epochs where 1 to {most} are possible")
    n_finished = _n_finished(log, net.spec.n_trainings)
    check(tensors, _expected(net, n_epochs, n_finished, tensors), path, FIX)
    if not torch.equal(tensors.pop(SHA256), _sha256(tensors, training)):
        raise _damaged(path, "its content has changed, or it is of another training")
    epochs = tuple(Epoch(int(number), *values, member=int(member)) for number, *values, member in log.tolist())
    if not _is_numbered(epochs, n_finished + 1):
        raise _damaged(path, "its log does not number the epochs")
    _check_generator(tensors["generator"], path)
    parts = {field: tensors_of(tensors, part) for part, field in PARTS.items()}
    finished = tuple(tensors_of(tensors, f"member{number}") for number in range(1, n_finished + 1))
    return Checkpoint(epochs=epochs, generator=tensors["generator"], finished=finished, **parts)


def _n_finished(log: Tensor, most: int) -> int:
    """How many members are finished: those before the one of the last epoch; 0 of a log that does not say it."""
    last = float(log[-1, -1]) if log.ndim == 2 and log.shape[1] == len(Epoch._fields) else 1.0
    return int(last) - 1 if last in range(1, most + 1) else 0


def _is_numbered(epochs: Sequence[Epoch], n_members: int) -> bool:
    """Whether the members, and the epochs of each, are numbered from 1."""
    members = [epoch.member for epoch in epochs]
    expected = [(m, number) for m in range(1, n_members + 1) for number in range(1, members.count(m) + 1)]
    return set(members) == {*range(1, n_members + 1)} and [(e.member, e.epoch) for e in epochs] == expected


def _read(path: Path) -> dict[str, Tensor]:
    content = read_bytes(path)
    try:
        return safetensors.torch.load(content)
    except (SafetensorError, LookupError, ValueError, RuntimeError) as error:
        raise _damaged(path, f"it is not a safetensors file: {error}") from error


def _expected(net: Net, n_epochs: int, n_finished: int, found: Mapping[str, Tensor]) -> Expected:
    """found: the tensors of the file; they tell which networks are recurrent, or have a path past the hidden layer."""

    def state(part: str) -> Expected:
        spec = net.spec
        if spec.model == "auto":
            spec = spec.of_model("rsnn" if f"{part}.w_rec" in found else "snn")
        if spec.direct == "auto":
            w_out = found.get(f"{part}.w_out", torch.empty(0))
            spec = spec.model_copy(update={"direct": len(w_out) > spec.hidden})
        return net._replace(spec=spec).state()

    fixed = net.fixed()
    adam = {
        f"adam.{name}.{key}": (kept, torch.float32)
        for name, (shape, _) in state("weights").items()
        if name not in fixed
        for key, kept in optimisers.state_shapes(net.spec.training.optimiser, shape).items()
    }
    parts = ["weights", "best", *(f"member{number}" for number in range(1, n_finished + 1))]
    return {
        "log": ((n_epochs, len(Epoch._fields)), torch.float64),
        "generator": (tuple(torch.Generator().get_state().shape), torch.uint8),
        SHA256: ((hashlib.sha256().digest_size,), torch.uint8),
        **{f"{part}.{name}": tensor for part in parts for name, tensor in state(part).items()},
        **adam,
    }


def _check_generator(state: Tensor, path: Path) -> None:
    try:
        torch.Generator().set_state(state)
    except RuntimeError as error:
        raise _damaged(path, "its generator state is invalid") from error


def _sha256(tensors: Mapping[str, Tensor], training: str) -> Tensor:
    """Digest of names and contents, `(32,)` uint8."""
    content = hashlib.sha256(training.encode())
    for name in sorted(tensors):
        content.update(f"\n{name} {tuple(tensors[name].shape)} {tensors[name].dtype}\n".encode())
        content.update(tensors[name].contiguous().numpy().tobytes())
    return torch.tensor(list(content.digest()), dtype=torch.uint8)


def _damaged(path: Path, why: str) -> InputError:
    return InputError(f"{path}: is damaged ({why}); {FIX}")
