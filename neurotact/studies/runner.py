"""Running a study: its cells in spawned processes, each done once, whatever interrupts it."""

import importlib.metadata
import os
import platform
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from neurotact import __version__, files
from neurotact.backend import native
from neurotact.errors import InputError
from neurotact.progress import track
from neurotact.spec import build, read
from neurotact.studies import report
from neurotact.studies.cell import cell_folder, run_cell
from neurotact.studies.preparation import prepare, spikes_path
from neurotact.studies.study import Cell, StudySpec, cells, swept_columns, to_toml, value_at

ATTEMPTS = 3
PACKAGES = ("torch", "numpy", "scipy", "scikit-learn", "pandas", "h5py", "snntorch", "pydantic")


def run(study: StudySpec, folder: Path, workers: int) -> Path:
    """Run what is not yet done of `study` in `folder`, then write tables and report; the report's path.

    Each cell trains in a spawned process with one thread, so that the number of workers changes no number.
    Raises InputError when the folder holds another study or anything else.
    """
    _claim(folder, study)
    every = list(cells(study))
    todo = [cell for cell in every if not _is_done(folder, cell)]
    with _workers(workers) as start_pool:
        _map(start_pool, prepare, [(folder, study.dataset, every, study.linear_baseline)], "prepare")
        _map(start_pool, run_cell, [(cell, folder) for cell in todo], "cells")
    return finish(study, folder)


def load(folder: Path) -> StudySpec:
    """The study that a run folder holds."""
    path = files.existing(folder, "folder") / "study.toml"
    if not path.is_file():
        raise InputError(f"{folder}: holds no study; start one with neurotact study run NAME -o {folder}")
    return build(StudySpec, read(path), source=str(path))


def finish(study: StudySpec, folder: Path) -> Path:
    """Write results.csv, encoding.csv, timings.csv, the figures and the report from what the cells left."""
    every = list(cells(study))
    done = [cell for cell in every if _is_done(folder, cell)]
    if not done:
        raise InputError(f"{folder}: no cell is done yet; run neurotact study resume {folder}")
    if len(done) < len(every):
        print(f"{folder}: {len(done)} of {len(every)} cells are done; the report shows these", file=sys.stderr)
    _write_csv(results_table(study, folder, done), folder / "results.csv")
    _write_csv(_timings_table(folder, done), folder / "timings.csv")
    tables = {cell.spikes_name: spikes_path(folder, cell).with_suffix(".csv") for cell in done}
    _write_csv(pd.concat(map(report.read_encoding, tables.values()), ignore_index=True), folder / "encoding.csv")
    return report.write(study, folder)


def results_table(study: StudySpec, folder: Path, done: list[Cell]) -> pd.DataFrame:
    """One row a cell, in the order of the sweep; swept keys without a column of their own come last."""
    rows = []
    for cell in done:
        extra = {key: value_at(cell, key) for key in swept_columns(study)}
        rows.append({**files.read_json(cell_folder(folder, cell) / "result.json")["row"], **extra})
    return pd.DataFrame(rows)


def _timings_table(folder: Path, done: list[Cell]) -> pd.DataFrame:
    rows = [{"cell": c.digest(), **files.read_json(cell_folder(folder, c) / "timing.json")} for c in done]
    return pd.DataFrame(rows)


def _is_done(folder: Path, cell: Cell) -> bool:
    return (cell_folder(folder, cell) / "result.json").is_file()


def _claim(folder: Path, study: StudySpec) -> None:
    """Make `folder` this study's; refuse one that is another's."""
    path = folder / "study.toml"
    if path.is_file():
        if load(folder) != study:
            raise InputError(f"{folder}: already holds another study; choose another folder or remove it")
    elif not files.is_free(folder):
        raise InputError(f"{folder}: is not empty and holds no study; choose another folder")
    files.write_text(path, to_toml(study))
    files.write_json(folder / "versions.json", versions())


def versions() -> dict[str, str]:
    """What the numbers may depend on besides the specs."""
    found = {name: importlib.metadata.version(name) for name in PACKAGES}
    backend = "native" if native is not None else "reference"
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "backend": backend,
        "neurotact": __version__,
        **found,
    }


def _write_csv(table: pd.DataFrame, path: Path) -> None:
    with files.whole(path) as draft:
        table.to_csv(draft, index=False, lineterminator="\n")


@contextmanager
def _workers(n_workers: int) -> Iterator[Callable[[], ProcessPoolExecutor]]:
    """Yield a function that starts a pool; its processes are ended when the block is left, however it is left."""
    pools: list[ProcessPoolExecutor] = []

    def start() -> ProcessPoolExecutor:
        # Spawned, not forked: a fork after an OpenMP call hangs.
        pools.append(ProcessPoolExecutor(n_workers, mp_context=get_context("spawn"), initializer=_one_thread))
        return pools[-1]

    threads = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        yield start
    except BaseException:
        for pool in pools:
            for process in list((pool._processes or {}).values()):
                process.terminate()
        raise
    finally:
        for pool in pools:
            pool.shutdown(wait=True, cancel_futures=True)
        if threads is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = threads


def _one_thread() -> None:
    torch.set_num_threads(1)


def _map(start_pool: Callable[[], ProcessPoolExecutor], task: Callable[..., None], jobs: list[Any], what: str) -> None:
    """Do every job; a process that dies costs its jobs another attempt, and nothing else."""
    if not jobs:
        return
    with track(what, len(jobs)) as advance:
        for attempt in range(1, ATTEMPTS + 1):
            pool = start_pool()
            waiting = {pool.submit(task, *job): job for job in jobs}
            jobs = []
            try:
                for future in _as_done(set(waiting)):
                    future.result()
                    waiting.pop(future)
                    advance(1, "")
                return
            except BrokenProcessPool:
                jobs = list(waiting.values())
                if attempt == ATTEMPTS:
                    raise
                print(f"{what}: a worker process died; {len(jobs)} to do again", file=sys.stderr)


def _as_done(futures: set[Future]) -> Iterator[Future]:
    while futures:
        done, futures = wait(futures, return_when=FIRST_COMPLETED)
        yield from done
