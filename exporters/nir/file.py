"""NIR files (HDF5): written completely, and read after a check of every declared size, link and type."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
from neurotact_parts.exporters.nir.execute import KINDS
from neurotact_parts.exporters.nir.nodes import nir

from neurotact import files
from neurotact.data.hdf5_input import Declared, reading
from neurotact.data.hdf5_output import Output
from neurotact.errors import InputError

MOST_NODES = 1000
"""Maximum number of nodes and edges of a graph: the time to check types grows with its square."""
DEEPEST = 3
"""Maximum depth of graphs within graphs."""


def write(graph: Any, path: str | Path, *, force: bool = False) -> None:
    """Write a graph; an existing file is refused unless `force`.

    Its nodes keep their order, without which snnTorch's import fails for graphs within a graph.
    """
    files.check_new(path, force=force)
    with files.whole(path) as draft:
        with Output(draft) as output, _in_order():
            nir().write(output, graph)
        output.check()


@contextmanager
def _in_order() -> Iterator[None]:
    """Let new HDF5 groups keep the order of what is put into them."""
    config = h5py.get_config()
    before, config.track_order = config.track_order, True
    try:
        yield
    finally:
        config.track_order = before


def read(path: str | Path) -> Any:
    """The graph in a file; InputError, in one line, for a file that is damaged, hostile or has unknown nodes."""
    package = nir()
    with reading(path, "NIR", "`nt.to_nir`, or what wrote it") as file:
        declared = Declared(file, path)
        table = _graph(declared, "node", 0, [MOST_NODES])
        try:
            return package.dict2NIRNode({**table, "type_check": True})
        except AssertionError as error:
            raise ValueError(str(error) or "its nodes do not fit together") from error
        except RecursionError as error:
            raise ValueError("its graphs are nested too deeply") from error


def _graph(declared: Declared, name: str, depth: int, left: list[int]) -> dict[str, Any]:
    """A graph as a table; `left` counts down the nodes and edges that a file may have."""
    if depth > DEEPEST:
        raise ValueError(f"{name} is nested deeper than {DEEPEST} graphs")
    graph = _table(declared, name, left)
    if graph.get("type") != "NIRGraph":
        raise ValueError(f"{name} is not a graph")
    nodes, edges = declared.group(f"{name}/nodes"), declared.value(f"{name}/edges")
    if edges.ndim != 2 or edges.shape[1] != 2:
        raise ValueError(f"{name}/edges are not pairs of names")
    left[0] -= len(edges)
    graph["edges"] = [(str(a), str(b)) for a, b in edges]
    graph["nodes"] = {}
    for key in nodes:
        kind = declared.value(f"{name}/nodes/{key}/type")
        if kind != "NIRGraph" and kind not in KINDS:
            raise InputError(
                f"{declared.path}: '{key}' is a {str(kind)[:40]!a}, which is not supported; known: {', '.join(KINDS)}"
            )
        inner = f"{name}/nodes/{key}"
        graph["nodes"][key] = (
            _graph(declared, inner, depth + 1, left) if kind == "NIRGraph" else _table(declared, inner, left)
        )
    return graph


def _table(declared: Declared, name: str, left: list[int]) -> dict[str, Any]:
    """A node's fields and metadata, without a graph's nodes and edges."""
    left[0] -= 1
    if left[0] < 0:
        raise InputError(f"{declared.path}: has more than {MOST_NODES} nodes and edges, which is not supported")
    group = declared.group(name)
    if len(group) > 20:
        raise ValueError(f"{name} has {len(group)} fields")
    table: dict[str, Any] = {}
    for key in group:
        if key == "metadata":
            notes = declared.group(f"{name}/{key}")
            table[key] = {
                note: declared.value(f"{name}/{key}/{note}")
                for note in list(notes)[:20]
                if notes.get(note, getclass=True) is h5py.Dataset
            }
        elif key not in ("nodes", "edges"):
            table[key] = declared.value(f"{name}/{key}")
    return table
