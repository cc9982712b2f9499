"""Ways to spoil an input: values nobody meant, and damage to files of every kind that neurotact reads.

Everything is drawn from the `random.Random` that is passed, so that a seed gives the same damage again.
"""

import copy
import json
import os
import random
import stat
import struct
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from safetensors.numpy import load, save

TEXTS = [
    "", " ", "0", "-1", "1", "0.5", "true", "nan", "-inf", "1e309", "-1e308", "1e-320", "0x10", "1_000", "٣", "½",
    str(2**31), str(2**63), str(2**64), str(-(2**63)), "9" * 400, "9" * 5000, "1" * 40 + ".5", "..", "/", "~", "a b",
    "a\nb", "a\tb",
    "$\\frac{$", "$x$", "=1+1", "-x", "@x", "+x", "a|b", "<b>", "[red]", "[/]", "%s", "{}", "\\", "'",
    '"', "ø", "日本", "\u202e", "\udcff", "\x1b[31m", "x" * 300, "x" * 60_000, "[1, 2]", "{a = 1}", "[" * 3000,
    "{a = " * 500, "2020-01-01", "None", "con", "5&5",
]  # fmt: skip
VALUES: list[Any] = [
    None, True, False, 0, -1, 1, 2, 0.5, -0.0, 1e-320, 1e38, 1e300, -1e300, 7.5, float("nan"), float("inf"),
    -float("inf"), 2**31, 2**53, 2**62, 2**63, 2**64, -(2**63), 10**30, 10**400, 10**9, 10**6, "", "x", "nan", "1",
    "$\\frac{$", "=1+1",
    "\udcff", "x" * 300, "x" * 60_000, [], [[]], {}, [1], [None], ["a", "a"], {"": 1}, {"a": {"b": []}}, [[1, 2], [3]],
    [0.5] * 5000, ["a"] * 5000,
]  # fmt: skip
"""What stands where something else is due; JSON and TOML hold most of it."""
HUGE = 3_000_000_000
"""Bytes that a file declares or seems to hold: too many to read."""


def text(rng: random.Random) -> str:
    """A value that a person, a script or an attacker may give for an option."""
    return rng.choice(TEXTS)


def value(rng: random.Random) -> Any:
    """A value that stands where another is due, free to be changed."""
    return copy.deepcopy(rng.choice(VALUES))


# --- trees, as TOML and JSON hold them --------------------------------------------------------------


def places(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path to every node of a tree of tables and lists, the root left out."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, node in items:
        yield (*path, key)
        yield from places(node, (*path, key))


def spoil_tree(tree: Any, rng: random.Random) -> Any:
    """Change one node of `tree`, in place: another value, no node, a key too many, a name misspelt."""
    where = list(places(tree))
    if not where:
        return value(rng)
    *path, last = rng.choice(where)
    node = tree
    for key in path:
        node = node[key]
    how = rng.choices(["value", "drop", "add", "rename", "scale", "swap"], [6, 2, 1, 1, 2, 1])[0]
    number = isinstance(node[last], (int, float)) and not isinstance(node[last], bool)
    if how == "drop":
        del node[last]
    elif how == "rename" and isinstance(node, dict):
        node[rng.choice(["", "ä.b", f"{last}s", "x" * 300])] = node.pop(last)
    elif how == "add" and isinstance(node, dict):
        node[rng.choice(["", "extra", "model", "seed", "$\\frac{$"])] = value(rng)
    elif how == "scale" and number:
        node[last] = node[last] * rng.choice([-1, 0, 0.5, 1.01, 10, 1e4, 1e9, 1e300, 10**30])
    elif how == "swap":
        other = tree
        for key in rng.choice(where):
            other = other[key]
        node[last] = json.loads(json.dumps(other, default=str))
    else:
        node[last] = value(rng)
    return tree


def to_toml(tree: dict[str, Any]) -> str:
    """TOML text of a tree, nested values inline; unlike neurotact's own it takes anything."""

    def show(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{quote(str(k))} = {show(v)}" for k, v in value.items()) + "}"
        if isinstance(value, list):
            return "[" + ", ".join(map(show, value)) + "]"
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, float):
            return repr(value).replace("inf", "inf")
        return str(value) if isinstance(value, int) else quote(str(value))

    def quote(value: str) -> str:
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")

    return "".join(f"{quote(str(key))} = {show(value)}\n" for key, value in tree.items())


def spoil_toml(content: bytes, rng: random.Random) -> bytes:
    """A TOML file with a node changed, a line nested deeply, or its bytes damaged."""
    how = rng.choices(["tree", "nested", "bytes"], [8, 1, 1])[0]
    if how == "tree":
        tree = tomllib.loads(content.decode())
        for _ in range(rng.choice([1, 1, 1, 2, 4])):
            tree = spoil_tree(tree, rng)
        return _encoded(to_toml(tree if isinstance(tree, dict) else {"x": tree}))
    if how == "nested":
        levels = rng.choice([100, 1000, 30_000])
        line = rng.choice(["[" * levels + "]" * levels, "{a=" * levels + "1" + "}" * levels, "[" * levels])
        key = rng.choice(["title", "gain", "x", ".".join("a" * levels)])
        return f"{key} = {line}\n".encode() + content
    return spoil_bytes(content, rng)


def spoil_json(content: bytes, rng: random.Random) -> bytes:
    """JSON (or a line of JSON lines) with a node changed, nested deeply, or its bytes damaged."""
    how = rng.choices(["tree", "nested", "bytes", "constant"], [8, 1, 2, 1])[0]
    if how == "tree":
        lines = content.decode().splitlines()
        is_lines = len(lines) > 1 and all(line.startswith("{") for line in lines)
        at = rng.randrange(len(lines)) if is_lines else 0
        tree = json.loads(lines[at] if is_lines else content)
        for _ in range(rng.choice([1, 1, 1, 2, 4])):
            tree = spoil_tree(tree, rng)
        changed = json.dumps(tree)
        return _encoded("\n".join([*lines[:at], changed, *lines[at + 1 :]]) + "\n" if is_lines else changed)
    if how == "nested":
        return b"[" * 100_000 + b"]" * rng.choice([0, 100_000])
    if how == "constant":
        return rng.choice(
            [b"", b"null", b"[]", b"{}", b"1", b'"x"', b"NaN", b"[1]", b'{"row": 1}', b"9" * 6000, b"\xff"]
        )
    return spoil_bytes(content, rng)


def _encoded(what: str) -> bytes:
    return what.encode("utf-8", "surrogateescape")


# --- any bytes, tables ------------------------------------------------------------------------------


def spoil_bytes(content: bytes, rng: random.Random) -> bytes:
    """Flipped bits, a cut, a repeat, junk in between, zeros, nothing."""
    spoilt = bytearray(content)
    how = rng.choice(["flip", "flip", "cut", "cut", "repeat", "junk", "zeros", "empty", "nul"])
    at = rng.randrange(len(spoilt) + 1)
    if how == "flip":
        for _ in range(rng.choice([1, 3, 30])):
            if spoilt:
                spoilt[rng.randrange(len(spoilt))] ^= 1 << rng.randrange(8)
    elif how == "cut":
        del spoilt[at:]
    elif how == "repeat":
        spoilt += spoilt[at:]
    elif how == "junk":
        spoilt[at:at] = rng.randbytes(rng.choice([1, 20, 5000]))
    elif how == "zeros":
        spoilt[at : at + 64] = bytes(len(spoilt[at : at + 64]))
    elif how == "nul":
        spoilt[at:at] = b"\0"
    else:
        spoilt.clear()
    return bytes(spoilt)


def spoil_table(content: bytes, rng: random.Random) -> bytes:
    """A table as text (CSV, .lvm): cells, rows and headers that do not fit, or damaged bytes."""
    separator = b"\t" if b"\t" in content[:2000] else b","
    lines = content.splitlines() or [b""]
    at = rng.randrange(len(lines))
    how = rng.choice(["cell", "cell", "row", "wide", "long", "encoding", "quote", "lines", "header", "bytes", "bytes"])
    if how == "cell":
        cells = lines[at].split(separator)
        cells[rng.randrange(len(cells))] = _encoded(text(rng))
        lines[at] = separator.join(cells)
    elif how == "row":
        cells = lines[at].split(separator)
        lines[at] = separator.join(rng.choice([cells[:-1], [*cells, b"1"], [], [b""] * len(cells), cells * 3]))
    elif how == "wide":
        name = rng.choice([b"name%d", b"taxel", b"1"])
        lines[0] = separator.join(name.replace(b"%d", b"%d" % i) for i in range(50_000))
    elif how == "long":
        lines[at] = rng.choice([b"1" * 1_000_000, (b"1" + separator) * 200_000, b"x" * 1_000_000])
    elif how == "encoding":
        encoding = rng.choice(["utf-16", "utf-32", "utf-8-sig"])
        return content.decode("latin-1").encode(encoding) + rng.choice([b"", b"\xff"])
    elif how == "quote":
        lines[at] = b'"' + lines[at]
    elif how == "header":
        lines.insert(0, rng.choice([b"", b"a,a", b"$\\frac{$", b"=1,2", b"\xff", b"#", lines[0]]))
    elif how == "bytes":
        return spoil_bytes(content, rng)
    else:
        return rng.choice([b"\r\n", b"\r", b"\n\n", b"", b"\n"]).join(lines)
    return b"\n".join(lines) + b"\n"


# --- HDF5, NumPy archives, weights ------------------------------------------------------------------


def spoil_hdf5(path: Path, rng: random.Random) -> None:
    """Change what an HDF5 file holds: a dataset or attribute of another kind, size or content; or its bytes."""
    if rng.random() < 0.3:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
        return
    with h5py.File(path, "r+") as file:
        for _ in range(rng.choice([1, 1, 1, 2])):
            _spoil_open(file, rng)


def _spoil_open(file: h5py.File, rng: random.Random) -> None:
    names: list[str] = []
    file.visit(names.append)
    if rng.random() < 0.3:
        owner = file[rng.choice([n for n in names if isinstance(file[n], h5py.Group)])] if rng.random() < 0.4 else file
        _spoil_attribute(owner, rng)
        return
    name = rng.choice([n for n in names if isinstance(file.get(n), h5py.Dataset)] or ["x"])
    is_small = name in file and (file[name].size or 0) < HUGE // 100  # one before may have made it huge
    old = file[name][()] if is_small and rng.random() < 0.9 else np.zeros(3)
    if name in file:
        del file[name]
    how = rng.choice(DATASETS)
    how(file, name, np.atleast_1d(np.asarray(old)), rng)


def _absent(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    pass


def _of_another_kind(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    kinds = ["i1", "u2", "i8", "u8", "f2", "f4", "f8", "?", "c16", "S3", [("a", "i4")]]
    values = old if old.dtype != object else np.arange(len(old))
    with np.errstate(all="ignore"):
        try:
            file[name] = values.astype(rng.choice(kinds))
        except (ValueError, TypeError):
            file[name] = np.zeros(values.shape, "i2")


def _of_another_shape(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    values = old if old.dtype != object else np.arange(len(old))
    shapes = [
        values[:0],
        values[:-1],
        values[..., None],
        values[None],
        np.concatenate([values, values]),
        values.ravel(),
    ]
    shapes += [values.T, np.asarray(values.ravel()[0] if values.size else 0), values[:1]]
    file[name] = rng.choice(shapes)


def _of_other_values(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    if old.dtype.kind in "OSU":
        _of_other_words(file, name, old, rng)
        return
    values = old.astype("f8" if old.dtype.kind == "f" else "i8")
    numbers = (
        [0, -1, 1, 3, 2**31, 2**62, -(2**62), 10**9]
        if values.dtype.kind == "i"
        else [np.nan, np.inf, -1e300, 1e38, 0.0]
    )
    flat = values.reshape(-1)
    everywhere = rng.random() < 0.3
    flat[slice(None) if everywhere else rng.randrange(len(flat) or 1)] = rng.choice(numbers) if len(flat) else 0
    file[name] = rng.choice([values, values, values, values[::-1], -values])


def _of_other_words(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    n = len(old)
    if rng.random() < 0.3:
        file[name] = np.array([rng.choice([b"\xff\xfe", b"", b"a\xf0"])] * n, dtype="S4")
        return
    words = [rng.choice(TEXTS).replace("\0", "").encode("utf-8", "ignore") for _ in range(rng.choice([1, 2, 3]))]
    chosen = np.array([words[i % len(words)] for i in range(n)], dtype=object)
    file.create_dataset(name, data=chosen, dtype=h5py.string_dtype())


def _ragged(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    """Spikes of trials, as variable-length rows: out of order, outside, too many, of another kind."""
    boxed = np.empty(len(old), dtype=object)
    kind = rng.choice(["f8", "i8", "u2"])
    for i, row in enumerate(old):
        row = np.ravel(row)  # of more axes h5py writes outside its memory
        numbers = row.astype(kind) if row.dtype.kind in "iuf" else np.arange(3, dtype=kind)
        how = rng.choice(["keep", "keep", "reverse", "negative", "far", "nan", "double", "empty", "many"])
        if how == "many" and i == 0:
            numbers = np.resize(numbers, 300_000)
        elif how in ("negative", "far", "nan") and len(numbers):
            number = {"negative": -1, "far": 2**40, "nan": np.nan if kind == "f8" else 65535}[how]
            numbers[-1] = np.asarray(number).astype(kind)
        elif how == "double":
            numbers = np.repeat(numbers, 2)
        boxed[i] = {"reverse": numbers[::-1], "empty": numbers[:0]}.get(how, numbers)
    file.create_dataset(name, data=boxed, dtype=h5py.vlen_dtype(np.dtype(kind)))


def _declared_huge(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    """Space that is declared and never written: a small file that fills the memory of whoever reads it."""
    kind = np.dtype("f4") if old.dtype == object else old.dtype
    shape = rng.choice([(HUGE // kind.itemsize,), (HUGE // kind.itemsize // 8, 8), (2**40, 8), (2**62,), (2, HUGE)])
    file.create_dataset(
        name, shape, kind, chunks=tuple(min(n, 4096) for n in shape), compression=rng.choice([None, "gzip"])
    )


def _elsewhere(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    """Links and storage outside the file."""
    how = rng.choice(["soft", "loop", "external", "raw", "virtual"])
    if how == "soft":
        file[name] = h5py.SoftLink("/nothing/there")
    elif how == "loop":
        file[name] = h5py.SoftLink(f"/{name}")
    elif how == "external":
        file[name] = h5py.ExternalLink(
            rng.choice(["/dev/zero", "/etc/hostname", "absent.h5", file.filename]), f"/{name}"
        )
    elif how == "raw":
        file.create_dataset(name, old.shape, "i8", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])
    else:
        layout = h5py.VirtualLayout((1000,), "f4")
        layout[:] = h5py.VirtualSource("absent.h5", "x", (1000,))
        file.create_virtual_dataset(name, layout)


def _a_group(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    file.create_group(name)


def _extra(file: h5py.File, name: str, old: np.ndarray, rng: random.Random) -> None:
    file[name] = np.arange(5)
    extra = f"{rng.choice(['conditions/', 'spikes/', ''])}{rng.choice(['further', '$x$', 'ä', 'x' * 300])}"
    if extra not in file:  # one before may have added it
        file[extra] = np.arange(rng.choice([0, 5]))


DATASETS: list[Callable[[h5py.File, str, np.ndarray, random.Random], None]] = [
    _absent, _of_another_kind, _of_another_shape, _of_other_values, _of_other_values, _of_other_words, _ragged,
    _declared_huge, _elsewhere, _a_group, _extra,
]  # fmt: skip


def _spoil_attribute(owner: Any, rng: random.Random) -> None:
    name = rng.choice([*owner.attrs, "kind", "sampling_rate_Hz"])
    old = owner.attrs.get(name)
    if name in owner.attrs:
        del owner.attrs[name]
    if isinstance(old, str) and old[:1] in ("[", "{") and rng.random() < 0.6:
        owner.attrs[name] = spoil_json(old.encode(), rng)[:60_000].decode("utf-8", "ignore").replace("\0", "")
        return
    junk: list[Any] = [
        None,
        "",
        "x",
        "[" * 50_000,
        "nan",
        b"\xff\xfe",
        0,
        -1.0,
        float("nan"),
        float("inf"),
        1e-300,
        1e300,
    ]
    junk += [2**62, np.arange(5), np.zeros((2, 2)), h5py.Empty("f4"), "$\\frac{$", "1" * 5000, True]
    value = rng.choice(junk)
    if value is not None:
        owner.attrs[name] = value


def spoil_npz(path: Path, rng: random.Random) -> None:
    """Change what a NumPy archive holds: an array of another kind or size, a pickle, a bomb; or its bytes."""
    how = rng.choice(["array", "array", "array", "pickle", "header", "bomb", "members", "bytes", "bytes", "alone"])
    if how == "bytes":
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
        return
    with np.load(path) as archive:
        arrays = dict(archive)
    key = rng.choice(list(arrays))
    if how == "array":
        arrays[key] = _odd_array(arrays[key], rng)
        arrays = {
            rng.choice(["", "a/b", "../x", "ä", "$\\frac{$", key, key]) if k == key else k: v for k, v in arrays.items()
        }
        with np.errstate(all="ignore"):
            np.savez(path, **arrays)
    elif how == "pickle":
        np.savez(path, **{key: np.array([{"a": 1}, None], dtype=object)})
    elif how == "alone":
        np.save(path.with_suffix(".npy"), arrays[key])
        path.with_suffix(".npy").replace(path)
    else:
        _write_archive(path, key, how, rng)


def _odd_array(array: np.ndarray, rng: random.Random) -> np.ndarray:
    if array.dtype.names:
        array = array[array.dtype.names[0]]
    array = np.atleast_1d(array)
    broken = array.astype("f8") if array.dtype.kind in "iufb" else np.zeros(max(1, len(array)))
    broken.reshape(-1)[:1] = rng.choice([np.nan, np.inf, 1e300])
    kinds = ["f2", "f8", ">f4", "i1", "?", "c8", "U3", "S2", "M8[s]", "V4", "u8", "g"]
    with np.errstate(all="ignore"):
        other = [np.zeros(array.shape, kind) for kind in kinds]
    smaller = [array[:0], array[:, :0] if array.ndim > 1 else array, array.ravel(), array[0], np.zeros((0, 0))]
    larger = [array[None], np.zeros((1, 5000)), np.float64(3), np.asfortranarray(array)]
    return rng.choice([*other, *smaller, *larger, broken])


def npy(shape: str, descr: str = "<f4") -> bytes:
    """The head of a NumPy array, which its values follow."""
    text = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}"
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def _write_archive(path: Path, key: str, how: str, rng: random.Random) -> None:
    """An archive by hand: a header that lies, a member that unpacks to gigabytes, members that are no arrays."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        if how == "bomb":
            with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
                member.write(npy(f"({HUGE // 4 // 8}, 8)"))
                block = bytes(2**24)
                for _ in range(rng.choice([4, HUGE // len(block)])):
                    member.write(block)
        elif how == "header":
            shape = rng.choice(
                ["(10, 10)", "(-1, 2)", f"({2**62}, 4)", f"({HUGE}, 8)", "()", "(" * 900 + ")" * 900, "'x'", "None"]
            )
            archive.writestr(f"{key}.npy", npy(shape, rng.choice(["<f4", "|O", "<f99", "x"])) + bytes(400))
        else:
            for i in range(rng.choice([1, 3, 20_000])):
                archive.writestr(
                    rng.choice([f"{i}.npy", f"{i}.txt", f"../{i}.npy"]),
                    rng.choice([b"", b"junk", npy("(2,)") + bytes(8)]),
                )


def spoil_weights(content: bytes, rng: random.Random) -> bytes:
    """A safetensors file: weights that are not finite, of another shape or type, missing; a header that lies; bytes."""
    how = rng.choice(["value", "value", "shape", "type", "drop", "extra", "header", "bytes", "bytes"])
    if how == "bytes":
        return spoil_bytes(content, rng)
    if how == "header":
        size = rng.choice([0, 5, 2**31, 2**62, len(content)])
        return struct.pack("<Q", size) + content[8:]
    weights = load(content)
    name = rng.choice(list(weights))
    old = weights[name]
    if how == "value":
        changed = old.copy()
        changed.reshape(-1)[: rng.choice([1, changed.size])] = rng.choice([np.nan, np.inf, 1e38, -5.0, 0.0])
        weights[name] = changed
    elif how == "shape":
        weights[name] = rng.choice(
            [old.ravel(), old[None], old[:-1] if old.ndim else old, np.zeros((2000, 2000), "f4")]
        )
    elif how == "type":
        weights[name] = old.astype(rng.choice(["f8", "f2", "i4", "?"]))
    elif how == "drop":
        del weights[name]
    else:
        weights["extra"] = np.zeros(3, "f4")
    return save({key: np.ascontiguousarray(value) for key, value in weights.items()})


# --- a file of any kind, by its name ----------------------------------------------------------------


def spoil_file(path: Path, rng: random.Random) -> None:
    """Damage one file as its kind can be damaged, or put something else in its place."""
    if rng.random() < 0.12:
        replace_file(path, rng)
        return
    if path.suffix in (".h5", ".nwb"):
        spoil_hdf5(path, rng)
    elif path.suffix == ".npz":
        spoil_npz(path, rng)
    else:
        by_suffix = {".toml": spoil_toml, ".json": spoil_json, ".jsonl": spoil_json, ".safetensors": spoil_weights}
        by_suffix |= {".csv": spoil_table, ".lvm": spoil_table, ".md": spoil_bytes}
        path.write_bytes(by_suffix.get(path.suffix, spoil_bytes)(path.read_bytes(), rng))


def replace_file(path: Path, rng: random.Random) -> None:
    """What is no plain file, or an endless one, in the place of a file; or nothing."""
    path.unlink()
    how = rng.choice(["absent", "folder", "fifo", "zero", "loop", "dangling", "sparse", "secret"])
    if how == "folder":
        path.mkdir()
    elif how == "fifo":
        os.mkfifo(path)
    elif how == "zero":
        path.symlink_to("/dev/zero")
    elif how == "loop":
        path.symlink_to(path.name)
    elif how == "dangling":
        path.symlink_to("nothing-there")
    elif how == "sparse":
        path.touch()
        os.truncate(path, HUGE)
    elif how == "secret":
        path.write_bytes(b"x")
        path.chmod(0)


def spoil_folder(folder: Path, rng: random.Random) -> None:
    """Put something into a folder, or in the place of one inside, that does not belong there."""
    inside = sorted(path for path in folder.rglob("*") if path.is_dir()) or [folder]
    place = rng.choice([folder, rng.choice(inside)])
    how = rng.choice(["empty", "nested", "loop", "name", "name", "hidden", "twin", "folder", "stray", "drop", "move"])
    some = sorted(path for path in place.rglob("*") if path.is_file()) or [place / "x"]
    chosen = rng.choice(some)
    name = _encoded(text(rng)[:200].replace("/", "_").replace("\0", "") or "x")
    if how == "nested":
        (place / "deeper" / "still").mkdir(parents=True, exist_ok=True)
        _copy(chosen, place / "deeper" / "still" / chosen.name)
    elif how == "loop":
        if not (place / "again").is_symlink():
            (place / "again").symlink_to(place, target_is_directory=True)
    elif how == "name" and place != folder:
        os.rename(
            os.fsencode(place), os.path.join(os.fsencode(place.parent), name if name not in (b".", b"..") else b"x")
        )
    elif how == "name" and chosen.is_file():
        os.rename(
            os.fsencode(chosen), os.path.join(os.fsencode(chosen.parent), name[:100] + os.fsencode(chosen.suffix))
        )
    elif how == "hidden":
        _copy(chosen, place / f".{chosen.name}")
    elif how == "twin":
        _copy(
            chosen,
            place
            / f"{chosen.stem.upper()}{rng.choice([chosen.suffix, chosen.suffix.upper(), '.csv', '.npz', '.bak'])}",
        )
    elif how == "folder":
        (place / f"folder{chosen.suffix}").mkdir()
    elif how == "stray":
        (place / rng.choice(["notes.txt", "Thumbs.db", "x", "a.csv", "b.npz", "c.lvm"])).write_bytes(
            rng.choice([b"", b"1,2\n", b"\xff" * 9])
        )
    elif how == "drop":
        chosen.unlink(missing_ok=True)
    elif how == "move" and chosen.exists():
        chosen.rename(folder / chosen.name)
    else:
        for path in some:
            path.unlink(missing_ok=True)


def _copy(source: Path, target: Path) -> None:
    if source.is_file():
        target.write_bytes(source.read_bytes())


def is_plain(path: Path) -> bool:
    """Whether reading `path` to its end is safe: a plain file that is not huge."""
    found = path.lstat()
    return stat.S_ISREG(found.st_mode) and found.st_size < HUGE


def archive_of(arrays: dict[str, np.ndarray]) -> bytes:
    """The bytes of a NumPy archive."""
    stream = BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()
