"""Checkpoints: `weights.safetensors` and `network.json` in a folder, never pickle.

The JSON contains the SHA-256 of the weights. Loading thus detects a save that was interrupted between the two files, a
truncated file, and a file of another network.
"""

import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from neurotact import __version__
from neurotact.errors import InputError, nearest
from neurotact.files import existing, read_bytes, read_json, whole, write_json
from neurotact.networks.definition import module
from neurotact.networks.definition.kernels import Backend
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import build

WEIGHTS = "weights.safetensors"
NETWORK = "network.json"
DTYPES = {"float32": torch.float32, "float64": torch.float64}
KEYS = ("spec", "n_inputs", "n_classes", "sampling_rate_Hz", "dtype", "neurotact", "weights_sha256", "extra")


Expected = Mapping[str, tuple[tuple[int, ...], torch.dtype]]
"""Shape and type of each tensor that a file must contain."""


def save(network: Network, folder: str | Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write a network into `folder`; each file is written in full and then renamed.

    extra: further JSON values of the network: class names, training history, encoder spec.
    Raises InputError for values that JSON cannot hold, for a surrogate that the spec does not describe, and for
    weights that are NaN or infinite.

    >>> import tempfile
    >>> net = RSNN(16, 8, RSNNSpec(hidden=20), sampling_rate_Hz=2000.0)
    >>> folder = tempfile.mkdtemp()
    >>> save(net, folder, {"best_epoch": 12})
    >>> again, metadata = load(folder)
    >>> torch.equal(again.w_rec, net.w_rec), metadata["extra"]
    (True, {'best_epoch': 12})
    """
    dtype = next((name for name, known in DTYPES.items() if known == network.dtype), None)
    if dtype is None:
        raise InputError(f"network: weights are {network.dtype}; convert it to one of {', '.join(DTYPES)}")
    if isinstance(network, RSNN) and network.spike != network.spec.spike:
        raise InputError(
            "network: its surrogate is not the one that its spec describes, and a checkpoint would lose it; "
            "set network.spike = network.spec.spike before saving"
        )
    for name, tensor in network.state_dict().items():
        if not tensor.isfinite().all():
            lower = network.spec.training.lower_rate
            raise InputError(f"network: '{name}' holds NaN or infinity; train it with a lower rate, as in {lower}")
    extra = dict(extra or {})
    try:
        json.dumps(extra, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"extra: cannot be written as JSON ({error}); give numbers, text, lists and tables") from error
    tensors = {name: t.detach().cpu().contiguous().clone() for name, t in network.state_dict().items()}
    weights = safetensors.torch.save(tensors)
    folder = Path(folder)
    with whole(folder / WEIGHTS) as draft:
        draft.write_bytes(weights)
    values = (
        network.spec.model_dump(mode="json"), network.n_inputs, network.n_classes, network.sampling_rate_Hz,
        dtype, __version__, hashlib.sha256(weights).hexdigest(), extra,
    )  # fmt: skip
    write_json(folder / NETWORK, dict(zip(KEYS, values, strict=True)))


def load(folder: str | Path, *, backend: Backend = "auto") -> tuple[Network, dict[str, Any]]:
    """The network in `folder`, and the content of `network.json`; its `extra` is that of `save`.

    Raises InputError, which names the file, if a file is missing, truncated or altered, or if the two do not match.
    """
    folder = existing(folder, "folder")
    metadata = _metadata(folder / NETWORK)
    spec = build(RSNNSpec, metadata["spec"], source=str(folder / NETWORK))
    sizes = metadata["n_inputs"], metadata["n_classes"], spec, metadata["sampling_rate_Hz"]
    dtype = DTYPES[metadata["dtype"]]
    weights = _weights(folder / WEIGHTS, metadata, expected_of(*sizes, dtype))
    network = untrained(*sizes, dtype, backend=backend)
    network.load_state_dict(weights)
    return network, metadata


def _metadata(path: Path) -> dict[str, Any]:
    table = read_json(path)
    if not isinstance(table, dict):
        raise InputError(f"{path}: is not a checkpoint's table; save the network again")
    for key in KEYS:
        if key not in table:
            raise InputError(f"{path}: '{key}' is missing; save the network again")
    for key in ("n_inputs", "n_classes"):
        if type(table[key]) is not int or table[key] < 1:
            raise InputError(f"{path}: {key} must be a whole number >= 1; got {table[key]!r}")
    rate = table["sampling_rate_Hz"]
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0 < rate <= sys.float_info.max:
        raise InputError(f"{path}: sampling_rate_Hz must be a positive number; got {rate!r}")
    if str(table["dtype"]) not in DTYPES:
        raise InputError(f"{path}: dtype {table['dtype']!r} is unknown; {nearest(str(table['dtype']), [*DTYPES])}")
    for key in ("spec", "extra"):
        if not isinstance(table[key], dict):
            raise InputError(f"{path}: {key} must be a table; got {table[key]!r}")
    return table


def _weights(path: Path, metadata: dict[str, Any], expected: Expected) -> dict[str, Tensor]:
    """The tensors; their shapes are checked against the metadata before a network is built."""
    content = read_bytes(path)
    if hashlib.sha256(content).hexdigest() != metadata["weights_sha256"]:
        raise InputError(f"{path}: is damaged, or not the file that {NETWORK} was saved with; save the network again")
    try:
        tensors = safetensors.torch.load(content)
    except SafetensorError as error:
        raise InputError(f"{path}: is not a safetensors file ({error}); save the network again") from error
    check(tensors, expected, path, "save the network again")
    return tensors


def shapes_of(spec: RSNNSpec, n_inputs: int, n_classes: int) -> dict[str, tuple[int, ...]]:
    """The tensors of a network's state and their shapes, known before it is built.

    >>> shapes_of(RSNNSpec(hidden=20, model="snn"), 16, 8)
    {'w_in': (16, 20), 'w_out': (20, 8), 'alpha': (2,), 'beta': (2,), 'threshold': (2,)}
    """
    recurrent = {"w_rec": (spec.hidden, spec.hidden)} if spec.recurrent else {}
    bias = {"bias": (n_classes,)} if spec.integrates else {}
    dynamics = dict.fromkeys(("alpha", "beta", "threshold"), (2,))
    stretch = {"w_stretch": (k, spec.hidden, n_classes)} if (k := spec.readout_stretches) > 1 else {}
    readout = {"w_out": (spec.hidden, n_classes), **stretch, **bias}
    return {"w_in": (n_inputs, spec.hidden), **recurrent, **readout, **dynamics}


def untrained(
    n_inputs: int, n_classes: int, spec: RSNNSpec, rate_Hz: float, dtype: torch.dtype, *, backend: Backend = "auto"
) -> Network:
    """A network whose weights will be replaced: torch's global generator is not advanced."""
    generator = torch.Generator()
    return module.new(n_inputs, n_classes, spec, rate_Hz, backend=backend, generator=generator, dtype=dtype)


def expected_of(n_inputs: int, n_classes: int, spec: RSNNSpec, rate_Hz: float, dtype: torch.dtype) -> Expected:
    """Shape and type of each tensor of a network's state; those of an RSNN are known before it is built."""
    if spec.own is None:
        return {name: (shape, dtype) for name, shape in shapes_of(spec, n_inputs, n_classes).items()}
    state = untrained(n_inputs, n_classes, spec, rate_Hz, dtype).state_dict()
    return {name: (tuple(tensor.shape), tensor.dtype) for name, tensor in state.items()}


def check(tensors: Mapping[str, Tensor], expected: Expected, path: Path, fix: str) -> None:
    """Refuse tensors that are missing, unknown, of another shape or type, NaN or infinite; the error ends in `fix`."""
    for name in (*expected, *tensors):
        if name not in tensors:
            raise InputError(f"{path}: '{name}' is missing; {fix}")
        if name not in expected:
            raise InputError(f"{path}: '{name}' is unknown ({nearest(name, [*expected])}); {fix}")
    for name, (shape, dtype) in expected.items():
        tensor = tensors[name]
        if tuple(tensor.shape) != shape or tensor.dtype != dtype:
            raise InputError(
                f"{path}: '{name}' is {tuple(tensor.shape)} {tensor.dtype} where {shape} {dtype} is expected; {fix}"
            )
        if not tensor.isfinite().all():
            raise InputError(f"{path}: '{name}' holds NaN or infinity; {fix}")
