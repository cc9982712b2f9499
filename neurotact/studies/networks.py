"""The way of spiking networks: cells share recordings and the spikes of every swept encoder."""

from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import pandas as pd

from neurotact.data.hdf5 import load_spikes
from neurotact.data.spikes import SpikeTrains
from neurotact.lazily import lazily
from neurotact.studies import store, study
from neurotact.studies.calibration_keys import ENCODER
from neurotact.studies.encoding_tables import read_encoding
from neurotact.studies.engine import Beside, Engine, Files, Results
from neurotact.studies.study import OF_SPIKES, SOURCE, Cell, StudySpec, by_split, swept_columns, value_at
from neurotact.tables import LAYERS, write_table

with lazily():  # a process that waits for others, which compute, needs no torch
    from neurotact.studies import cell as cells
    from neurotact.studies import preparation


def _prepare(folder: Path, what: StudySpec, of: list[Cell]) -> bool:
    return preparation.prepare(folder, what, of)


Rows = list[tuple[dict[str, Any], dict[str, Any]]]
"""Rows of `baselines.csv`, each with its shares of correct windows by side and trial."""


def _fit(job: tuple[Any, ...]) -> tuple[float, Rows]:
    began = perf_counter()
    rows = preparation.rows_beside(*job)
    return perf_counter() - began, rows


def _beside(folder: Path, what: StudySpec, of: list[Cell], at_once: bool) -> Beside | None:
    """The classical classifiers on the windows of the networks: jobs for each split, encoder and kind of varied copies.

    The first of each split and kind, on signals, too, take longest and begin first.
    """
    if what.baselines == "none" or not store.flaws(folder, store.BASELINES):
        return None
    groups = [list({cell.spikes_name: cell for cell in group}.values()) for group in by_split(of)]
    cells = [of[0], *{cell.dataset: cell for cell in of}.values()]
    first = [{str(cell.augmentation): cell for cell in reversed(group)} for group in groups]
    both = zip(groups, first, strict=True)
    jobs = [(folder, what, cell, cells, cell is own[str(cell.augmentation)]) for group, own in both for cell in group]
    order = sorted(range(len(jobs)), key=lambda number: not jobs[number][-1])

    def write(made: Mapping[int, tuple[float, Rows]]) -> None:
        ordered = [made[place] for place in sorted(made, key=order.__getitem__)]
        _write_baselines(folder, [row for _, rows in ordered for row in rows])
        store.add_time(folder, "baselines", sum(seconds for seconds, _ in ordered))

    return Beside("classifiers", _fit, [jobs[number] for number in order], write, at_once)


def _write_baselines(folder: Path, rows: Rows) -> None:
    """Write the tables of the classifiers beside the networks.

    `baselines_trials.csv` contains, for each row of `baselines.csv` (`baseline`) and each validation or test trial
    (`side`), the share of correctly classified windows; copies are one trial, the first of them.
    """
    trials = [
        (number, side, *pair)
        for number, (_, shares) in enumerate(rows)
        for side, by_trial in shares.items()
        for pair in by_trial.items()
    ]
    tables = (
        pd.DataFrame([row for row, _ in rows]),
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
        known = ("dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", LAYERS, "seed")
        keys = {name: result["row"][name] for name in known if name in result["row"]}
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
