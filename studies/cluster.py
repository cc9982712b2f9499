"""Computing cells on the workers of a Dask cluster. Dask alone decides where a cell runs, and whether it runs again."""

import asyncio
import logging
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import torch

from neurotact.backend import TORCH_INSTRUCTIONS
from neurotact.errors import InputError, first_line, optional
from neurotact.studies.engine import AnyCell, Beside, Engine, Files, MapCells
from neurotact.studies.executors import in_one_process
from neurotact.versions import versions

if TYPE_CHECKING:
    from distributed import Client, Future, Worker

REACH_S = 10.0
"""Time limit for the scheduler to answer, and then for its first worker to join."""
RETRIES = 2
OURS = "neurotact"
SAME = "install the same everywhere (pip install -c constraints.txt)"


@contextmanager
def cluster(address: str) -> Iterator[MapCells]:
    """Compute cells on the workers of a Dask scheduler, such as `tcp://host:8786`; each cell is a task.

    Raises InputError if Dask is not installed, the scheduler does not answer, no worker joins it, or a worker differs
    from this machine in something on which its numbers may depend.
    """
    distributed = optional("distributed", "`scheduler`: needs Dask; install it with pip install 'neurotact[dask]'")
    for name in ("distributed", "distributed.client"):  # the errors raised here say the same
        logging.getLogger(name).setLevel(logging.CRITICAL)
    asyncio.run(_reach(address))
    with distributed.Client(address, timeout=REACH_S, set_as_default=False) as client:
        try:
            client.wait_for_workers(1, timeout=REACH_S)
            _check_packages(client)
            client.run(_check_worker, versions())
        except TimeoutError as error:
            start = f"start some with dask worker {address} --nworkers -1 --nthreads 1"
            raise InputError(f"`scheduler={address!r}`: no worker joined it within {REACH_S:g} s; {start}") from error
        except (ImportError, AttributeError) as error:
            raise InputError(
                f"`scheduler={address!r}`: a worker lacks something ({first_line(error)}); {SAME}"
            ) from error
        yield partial(_map_cells, client, address)


def _check_packages(client: "Client") -> None:
    """Raise InputError for a worker with another neurotact, or without one.

    Dask itself asks: the functions of this version may not exist there.
    """
    known: Any = client.get_versions(packages=[OURS])
    here = known["client"]["packages"][OURS]
    for address, about in known["workers"].items():
        there = about["packages"][OURS]
        if there is None:
            raise InputError(f"worker {address}: lacks {OURS}; install neurotact[dask] there")
        if there != here:
            raise InputError(f"worker {address}: {OURS} is {there} there and {here} here; {SAME}")


async def _reach(address: str) -> None:
    """Check that a scheduler answers before a client is made: a client that cannot connect is slow to give up."""
    from distributed import Security
    from distributed.comm.core import connect

    try:
        answering = await connect(address, timeout=REACH_S, **Security().get_connection_args("client"))
        await answering.close()
    except ValueError as error:
        raise InputError(f"`scheduler={address!r}`: {error}; give an address such as tcp://host:8786") from error
    except OSError as error:
        raise InputError(
            f"`scheduler={address!r}`: no scheduler answered there within {REACH_S:g} s; "
            "start one with dask scheduler, and give the address that it prints"
        ) from error


def _map_cells(
    client: "Client", address: str, engine: Engine, cells: list[AnyCell], folder: Path, beside: Beside | None
) -> Iterator[tuple[Any, Any]]:
    from distributed import KilledWorker, as_completed

    if beside is not None:
        yield from in_one_process(beside)
    cell_of = _submit(client, engine, cells, folder)
    go_on = "then give the same command again: what is done is kept"
    for future in as_completed(list(cell_of), loop=client.loop):
        cell = cell_of.pop(future)
        try:
            files = future.result()
        except KilledWorker as error:
            why = f"several workers were lost while they computed cell {cell.digest()}"
            look = "look in their logs for the cause, such as too little memory"
            raise InputError(f"`scheduler={address!r}`: {why}; {look}, {go_on}") from error
        except CancelledError as error:
            raise InputError(f"`scheduler={address!r}`: the scheduler was lost; start it again, {go_on}") from error
        except InputError:
            raise
        except Exception:
            _check_packages(client)  # of a worker that has joined since
            raise
        yield cell, files


def _submit(client: "Client", engine: Engine, cells: list[AnyCell], folder: Path) -> "dict[Future, AnyCell]":
    """Send each shared input once, and its cells as tasks; returns the cell of each future."""
    import dask.config

    cell_of = {}
    run = uuid4().hex  # runs that share a scheduler share no task

    def path_of(cell: AnyCell) -> Path:
        return folder / cell.given

    for path, group in groupby(sorted(cells, key=path_of), key=path_of):
        same = list(group)
        name = path.stem
        # A task that returns its own input can run again; scattered data are lost with their worker.
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
            given = client.submit(_identity, engine.load(path), key=f"given-{name}-{run}")
        # The first part of the key makes the cells a group: Dask assigns them one by one, not all in advance.
        keys = [(f"cells-{name}-{run}", cell.digest()) for cell in same]
        n = len(same)
        arguments = [engine.run] * n, same, [given] * n, [versions()] * n
        cell_of |= zip(client.map(_run_on_worker, *arguments, key=keys, retries=RETRIES), same, strict=True)
    return cell_of


def _identity(given: Any) -> Any:
    return given


def _run_on_worker(run_cell: Callable[..., Files], cell: AnyCell, given: Any, expected: dict[str, str]) -> Files:
    _check_worker(expected)  # again: workers may join while the study runs
    torch.set_num_threads(1)
    return run_cell(cell, given, None, False)


def _check_worker(expected: dict[str, str], dask_worker: "Worker | None" = None) -> None:
    """On a worker: raise InputError if its numbers might differ from those of this machine.

    dask_worker: set by `Client.run`; a task finds its own worker.
    """
    from distributed import get_worker

    worker, installed = dask_worker or get_worker(), versions()
    for name in (name for name in expected if name != "python" and installed.get(name) != expected[name]):
        remedy = f"start it with {TORCH_INSTRUCTIONS}={expected[name].lower()}" if name == "instructions" else SAME
        there = installed.get(name, "unknown")
        raise InputError(f"worker {worker.address}: {name} is {there} there and {expected[name]} here; {remedy}")
    if worker.state.nthreads != 1:
        raise InputError(
            f"worker {worker.address}: has {worker.state.nthreads} threads, but a cell needs its own process; "
            "start workers with --nworkers -1 --nthreads 1"
        )
