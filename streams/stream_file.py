"""The state of a stream in a file: safetensors, with a JSON table and the SHA-256 of the content in its header.

The file is written completely and then renamed. On reading, these are checked before use: the hash, the chain of the
state, and the name, shape and type of each array.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
import torch
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.running import Running
from neurotact_parts.streams.stream_state import StreamState, Tally
from neurotact_parts.streams.windows import Opening
from safetensors import SafetensorError, safe_open

from neurotact.data.conditioning import Conditioned
from neurotact.encoders.specs import encode
from neurotact.errors import InputError
from neurotact.files import check_new, check_size, existing, read_bytes, whole
from neurotact.networks.exit.rule import Leader
from neurotact.neurons import CubaLIFState

FIX = "save the state again"
Arrays = dict[str, np.ndarray]


def fingerprint(chain: Chain) -> str:
    """SHA-256 of all that gives a state its meaning: encoder, network, exit rule, windows and rates."""
    table = {
        "encoder": chain.encoder.model_dump(mode="json"), "network": chain.network.spec.model_dump(mode="json"),
        "rule": {key: value for key, value in asdict(chain.rule).items() if key not in ("least_lead", "band") or value},
        "windows": asdict(chain.windows), "classes": chain.classes,
        "rates": [chain.sampling_rate_Hz, chain.clock_Hz], **({"takes_events": True} if chain.takes_events else {}),
        **({} if chain.detector is None else {"detector": chain.detector.model_dump()}),
    }  # fmt: skip
    digest = hashlib.sha256(json.dumps(table, sort_keys=True).encode())
    for name, tensor in sorted(chain.network.state_dict().items()):
        digest.update(name.encode() + tensor.detach().cpu().numpy().tobytes())
    return digest.hexdigest()


def save(chain: Chain, state: StreamState, path: str | Path, *, force: bool = False) -> None:
    """Save the state of a stream of a chain; an existing file is refused unless `force`."""
    check_new(path, force=force)
    table, arrays = _parts(chain, state)
    table["chain"] = fingerprint(chain)
    text = json.dumps(table, sort_keys=True)
    arrays = {name: np.ascontiguousarray(values) for name, values in arrays.items()}
    metadata = {"stream": text, "sha256": _hash(text, arrays)}
    with whole(path) as draft:
        draft.write_bytes(safetensors.numpy.save(arrays, metadata=metadata))


def load(chain: Chain, path: str | Path) -> StreamState:
    """The state that `save` wrote for a stream of the same chain.

    Raises InputError, which names the file, if it is damaged or of another chain.
    """
    path = existing(path)
    check_size(path, path.stat().st_size)
    try:
        with safe_open(path, "numpy") as file:
            metadata = file.metadata() or {}
        arrays = safetensors.numpy.load(read_bytes(path))
        text = metadata["stream"]
        table = json.loads(text)
    except (SafetensorError, OSError, KeyError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not the state of a stream ({type(error).__name__}); {FIX}") from error
    if metadata.get("sha256") != _hash(text, arrays):
        raise InputError(f"{path}: is damaged; {FIX}")
    if not isinstance(table, dict) or table.get("chain") != fingerprint(chain):
        raise InputError(f"{path}: belongs to a stream of another chain; give one of this chain")
    try:
        return _state(chain, table, arrays)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not a state of this version ({error}); {FIX}") from error


def _hash(text: str, arrays: Arrays) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode() + arrays[name].tobytes())
    return digest.hexdigest()


def _parts(chain: Chain, state: StreamState) -> tuple[dict[str, Any], Arrays]:
    """A state as a table of numbers and as arrays by name."""
    done, opening = state.conditioned, state.opening
    arrays: Arrays = {}
    if state.good is not None:
        arrays["good"] = state.good
    if state.waiting is not None:
        arrays["waiting"] = state.waiting
    for name in ("smoothed", "held"):
        if (values := getattr(done, name)) is not None:
            arrays[f"conditioned.{name}"] = values
    if done.carried is not None:
        arrays["conditioned.carried"] = done.carried[0]
    counters: dict[str, int] = {}
    if state.encoder is not None:
        arrays |= _leaves(state.encoder, "encoder", counters)
    windows = []
    for number, window in enumerate(state.windows):
        layers = {"hidden": window.hidden, "readout": window.readout, "leader": window.leader}
        for name, layer in layers.items():
            if layer is not None:
                known = _fields(chain, name) if isinstance(layer, CubaLIFState) else layer._fields
                parts = ((key, getattr(layer, key)) for key in known)
                arrays |= {f"window{number}.{name}.{key}": part.numpy() for key, part in parts if part is not None}
        arrays[f"window{number}.waiting"] = window.waiting
        windows.append({key: value for key, value in window._asdict().items() if isinstance(value, int)})
    table = {
        "n_samples": done.n_samples, "n_steps": done.n_steps, "n_carried": done.carried and done.carried[1],
        "opening": [opening.step, opening.silent, opening.free_at], "windows": windows, "n_windows": state.n_windows,
        "bad_in_a_row": state.bad_in_a_row, "origin": state.origin, "tally": asdict(state.tally), "encoder": counters,
        "event_step": state.event_step,
    }  # fmt: skip
    return table, arrays


def _leaves(part: Any, name: str, counters: dict[str, int]) -> Arrays:
    """The arrays of a state and of the states in it, by dotted names; its numbers are added to `counters`."""
    if isinstance(part, np.ndarray):
        return {name: part}
    if isinstance(part, int):
        counters[name] = part
        return {}
    fields = part._asdict() if hasattr(part, "_asdict") else dict(enumerate(part))
    return {
        key: values
        for field, value in fields.items()
        for key, values in _leaves(value, f"{name}.{field}", counters).items()
    }


def _rebuilt(example: Any, name: str, take: Any, counters: dict[str, int]) -> Any:
    """A state in the form of another one of the same encoder, of arrays that `take` gives by their names."""
    if isinstance(example, np.ndarray):
        return take(name, example.shape, example.dtype)
    if isinstance(example, int):
        return int(counters[name])
    if hasattr(example, "_asdict"):
        parts = example._asdict().items()
        return type(example)(**{field: _rebuilt(value, f"{name}.{field}", take, counters) for field, value in parts})
    return tuple(_rebuilt(value, f"{name}.{field}", take, counters) for field, value in enumerate(example))


def _state(chain: Chain, table: dict[str, Any], arrays: Arrays) -> StreamState:
    """The state from a table and arrays; each array must have the shape and type that the chain requires."""
    remaining = dict(arrays)
    n, f32 = chain.n_taxels, np.float32

    def take(name: str, shape: tuple[int, ...], kind: Any) -> np.ndarray:
        values = remaining.pop(name)
        if values.shape != shape or values.dtype != kind:
            raise ValueError(f"'{name}' is {values.shape} {values.dtype} where {shape} {np.dtype(kind)} is expected")
        return values

    def maybe(name: str, shape: tuple[int, ...], kind: Any = f32) -> np.ndarray | None:
        return take(name, shape, kind) if name in remaining else None

    baseline = chain.encoder.conditioning.baseline
    carried = maybe("conditioned.carried", (n,), f32 if baseline == "high-pass" else np.float64)
    conditioned = Conditioned(
        int(table["n_samples"]), int(table["n_steps"]), maybe("conditioned.smoothed", (n,)),
        maybe("conditioned.held", (1, n)),
        None if carried is None else (carried, int(table["n_carried"])),
    )  # fmt: skip
    encoder = None
    if any(name.startswith("encoder.") for name in remaining):
        _, example = encode(np.zeros((1, 1, n), f32), chain.signal_Hz, chain.encoder)
        encoder = _rebuilt(example, "encoder", take, table["encoder"])
    if len(table["windows"]) > chain.windows.at_once:
        raise ValueError(f"{len(table['windows'])} windows where {chain.windows.at_once} may overlap")
    windows = tuple(_window(chain, part, f"window{i}.", take) for i, part in enumerate(table["windows"]))
    state = StreamState(
        Opening(chain.windows, *(int(number) for number in table["opening"])), conditioned, encoder, windows,
        int(table["n_windows"]), maybe("good", (n,)), int(table["bad_in_a_row"]), int(table["origin"]),
        Tally(**{key: int(value) for key, value in table["tally"].items()}),
        int(table.get("event_step", 0)), maybe("waiting", (n,), np.bool_),
    )  # fmt: skip
    if remaining:
        raise ValueError(f"'{next(iter(remaining))}' is unknown")
    return state


def _fields(chain: Chain, layer: str) -> tuple[str, ...]:
    """The saved parts of a layer's state: the adaptation only if thresholds adapt."""
    adapts = chain.network.adaptation_of(("hidden", "readout").index(layer)) is not None
    return tuple(key for key in CubaLIFState._fields if key != "adaptation" or adapts)


def _window(chain: Chain, numbers: dict[str, int], prefix: str, take: Any) -> Running:
    network = chain.network
    integrates = network.bias is not None

    def layer(name: str, size: int) -> CubaLIFState:
        fields = _fields(chain, name)
        parts = {key: torch.from_numpy(take(f"{prefix}{name}.{key}", (1, size), np.float32)) for key in fields}
        return CubaLIFState(**{"adaptation": torch.zeros(1, size), **parts})

    kinds = {
        "counts": np.float64 if integrates else np.int64,
        "heard": np.bool_,
        "leaky": np.float64,
        "stood": np.float64,
    }
    sizes: dict[str, tuple[int, ...]] = dict.fromkeys(("counts", "leaky", "stood"), (1, network.n_classes))
    absent = {*([] if network.leaks else ["leaky"]), *([] if chain.rule.band else ["stood"])}
    standing = {
        key: torch.from_numpy(take(f"{prefix}leader.{key}", sizes.get(key, (1,)), kinds.get(key, np.int64)))
        for key in Leader._fields
        if key not in absent
    }
    leader = Leader(**standing)
    if not 0 <= int(leader.index) < network.n_classes:
        raise ValueError("the leading class of a window is unknown")
    return Running(
        hidden=layer("hidden", network.spec.hidden),
        readout=None if integrates else layer("readout", network.n_classes),
        leader=leader,
        waiting=take(f"{prefix}waiting", (network.n_inputs,), np.bool_),
        **{key: int(value) for key, value in numbers.items()},
    )
