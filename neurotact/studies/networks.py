"""The way of spiking networks: cells share recordings and the spikes of every swept encoder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from neurotact.data.hdf5 import load_spikes
from neurotact.data.spikes import SpikeTrains
from neurotact.lazily import lazily
from neurotact.progress import track
from neurotact.studies import store, study
from neurotact.studies.calibration_keys import ENCODER
from neurotact.studies.encoding_tables import read_encoding
from neurotact.studies.engine import Engine, Files, Results
from neurotact.studies.study import OF_SPIKES, SOURCE, Cell, StudySpec, by_split, swept_columns, value_at
from neurotact.tables import write_table
from neurotact.workers import pool_as_done

with lazily():  # a process that waits for others, which compute, needs no torch
    from neurotact.studies import cell as cells
    from neurotact.studies import preparation


def _prepare(folder: Path, what: StudySpec, of: list[Cell]) -> bool:
    return preparation.prepare(folder, what, of)


def _fit(job: tuple[Any, ...]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    return preparation.rows_beside(*job)


def _beside(folder: Path, what: StudySpec, of: list[Cell], n_workers: int) -> None:
    """Fit the classical classifiers on the windows of the networks, for each split and encoder, if they are missing.

    `baselines_trials.csv` contains, for each row of `baselines.csv` (`baseline`) and each validation or test trial
    (`side`), the share of correctly classified windows; copies are one trial, the first of them.
    """
    if what.baselines == "none" or not store.flaws(folder, store.BASELINES):
        return
    groups = [list({cell.spikes_name: cell for cell in group}.values()) for group in by_split(of)]
    cells = [of[0], *{cell.dataset: cell for cell in of}.values()]
    jobs = [(folder, what, cell, cells, cell is group[0]) for group in groups for cell in group]
    longest_first = sorted(range(len(jobs)), key=lambda number: not jobs[number][-1])
    rows: dict[int, list[tuple[dict[str, Any], dict[str, Any]]]] = {}
    with (
        store.timed(folder, "baselines"),
        track("classifiers on signals and spikes", len(jobs)) as advance,
        pool_as_done(n_workers) as run,
    ):
        for place, found in run(_fit, [jobs[number] for number in longest_first]):
            rows[longest_first[place]] = found
            advance(1, "")
    every = [pair for number in sorted(rows) for pair in rows[number]]
    trials = [
        (number, side, *pair)
        for number, (_, shares) in enumerate(every)
        for side, by_trial in shares.items()
        for pair in by_trial.items()
    ]
    tables = (
        pd.DataFrame([row for row, _ in every]),
        pd.DataFrame(trials, columns=["baseline", "side", "trial", "right"]),
    )
    for name, table in zip(store.BASELINES, tables, strict=True):
        write_table(table, folder / name)
    store.seal(folder, store.BASELINES)


def _check(folder: Path, what: StudySpec, of: list[Cell]) -> None:
    preparation.check(folder, what, of)


def _run(cell: Cell, trains: SpikeTrains, kept: Path | None, tells: bool) -> Files:
    return cells.run_cell(cell, trains, kept, tells)


def tables(folder: Path, what: StudySpec, results: Results) -> Mapping[str, pd.DataFrame]:
    """The tables by file name; each is in the order of the sweep.

    results.csv: of `results_table`. encoding.csv: firing under each condition, once for each encoder; swept keys of the
    encoder and the simulation come last. Then the further tables that the study requests, whose
    lines begin with the swept values of their cell.
    """
    swept, rows = swept_columns(what), results_table(what, results)
    written = {"results.csv": rows, "encoding.csv": _encoding_table(folder, results, swept)}
    further: dict[str, list[dict[str, Any]]] = {}
    for cell, result in results:
        if "tables" not in result:
            continue
        keys = {name: result["row"][name] for name in ("dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed")}
        keys |= {key: value_at(cell, key) for key in swept}
        for name, lines in result["tables"].items():
            further.setdefault(f"{name}.csv", []).extend({**keys, **line} for line in lines)
    return written | {name: pd.DataFrame(lines) for name, lines in further.items()}


def results_table(what: StudySpec, results: Results) -> pd.DataFrame:
    """One row per cell; swept keys without their own column come last."""
    swept = swept_columns(what)
    table = pd.DataFrame([{**result["row"], **{key: value_at(cell, key) for key in swept}} for cell, result in results])
    uncounted = [column for column in table if "sops" in str(column) and table[column].isna().all()]
    return table.astype(dict.fromkeys(uncounted, float))  # and not objects


def _encoding_table(folder: Path, results: Results, swept: list[str]) -> pd.DataFrame:
    keys = [key for key in swept if key in OF_SPIKES or key.startswith((ENCODER, SOURCE))]
    of_encoder: dict[str, Cell] = {}
    for cell, _ in results:
        of_encoder.setdefault(cell.given, cell)
    parts = [
        read_encoding((folder / given).with_suffix(".csv")).assign(**{key: value_at(cell, key) for key in keys})
        for given, cell in of_encoder.items()
    ]
    return pd.concat(parts, ignore_index=True)


ENGINE = Engine(study.cells, _prepare, _check, load_spikes, _run, tables, _beside)
"""The entry point `networks` of the group `neurotact.ways`."""
