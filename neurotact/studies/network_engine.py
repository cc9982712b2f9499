"""The engine of a study of spiking networks, or of afferents alone."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from neurotact.data.hdf5 import load_spikes
from neurotact.studies import cell, encoded, preparation, selection, study
from neurotact.studies.engine import Engine
from neurotact.studies.firing import read_encoding
from neurotact.studies.store import cell_folder, result_of
from neurotact.studies.study import SOURCE, Cell, StudySpec, swept_columns, value_at
from neurotact.workers import in_a_process


class NetworkEngine(Engine[StudySpec, Cell]):
    """See `Engine`; cells share the recordings and the spikes of every swept encoder."""

    load_given = staticmethod(load_spikes)
    run_cell = staticmethod(cell.run_cell)

    def cells(self) -> list[Cell]:
        return list(study.cells(self.study))

    def steps(self, folder: Path) -> Iterator[tuple[str, list[Cell]]]:
        """All cells as one step, unless a selection decides which come next."""
        if self.study.selection is None:
            yield from super().steps(folder)
            return
        for step in selection.steps(self.study, folder):
            yield step.name, list(step.cells)

    def asked_for(self, folder: Path) -> list[Cell]:
        """All cells; with a selection, the cells of its steps so far."""
        return self.cells() if self.study.selection is None else list(selection.asked_for(self.study, folder))

    def prepare(self, folder: Path) -> None:
        in_a_process(preparation.prepare, folder, self.study, self.cells())

    def check(self, folder: Path) -> None:
        preparation.check(folder, self.study, self.cells())

    def tables(self, folder: Path, done: Sequence[Cell]) -> Mapping[str, pd.DataFrame]:
        results = results_table(self.study, folder, done)
        tables = {"results.csv": results, "encoding.csv": encoding_table(self.study, folder, done)}
        if self.study.network is not None:
            return tables | {f"{name}.csv": table for name, table in extra_tables(self.study, folder, done).items()}
        places = [cell_folder(folder, one) for one in done]
        return tables | {encoded.ISI: encoded.isi_table(places, results, swept_columns(self.study))}


def results_table(study: StudySpec, folder: Path, done: Sequence[Cell]) -> pd.DataFrame:
    """One row per cell, in the order of the sweep; swept keys without their own column come last."""
    rows = []
    for one in done:
        extra = {key: value_at(one, key) for key in swept_columns(study)}
        rows.append({**result_of(folder, one)["row"], **extra})
    return pd.DataFrame(rows)


def extra_tables(study: StudySpec, folder: Path, done: Sequence[Cell]) -> dict[str, pd.DataFrame]:
    """The further tables of the cells, by name; each line begins with the swept values of its cell."""
    found: dict[str, list[dict]] = {}
    for one in done:
        result = result_of(folder, one)
        keys = {name: result["row"][name] for name in ("dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed")}
        keys |= {key: value_at(one, key) for key in swept_columns(study)}
        for name, lines in result.get("tables", {}).items():
            found.setdefault(name, []).extend({**keys, **line} for line in lines)
    return {name: pd.DataFrame(lines) for name, lines in found.items()}


def encoding_table(study: StudySpec, folder: Path, done: Sequence[Cell]) -> pd.DataFrame:
    """Firing under each condition, once for each encoder; swept keys of the encoder and the simulation come last."""
    keys = [key for key in swept_columns(study) if key.startswith(("encoder.", SOURCE))]
    tables = {}
    for one in done:
        if one.spikes_name not in tables:
            table = read_encoding((folder / one.given).with_suffix(".csv"))
            tables[one.spikes_name] = table.assign(**{key: value_at(one, key) for key in keys})
    return pd.concat(tables.values(), ignore_index=True)
