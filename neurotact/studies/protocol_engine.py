"""The engine of a study of a protocol."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from neurotact.studies import protocol_cell, protocol_study
from neurotact.studies.engine import Engine
from neurotact.studies.protocol_study import ProtocolCell, ProtocolStudy, swept_values
from neurotact.studies.store import result_of
from neurotact.workers import in_a_process


class ProtocolEngine(Engine[ProtocolStudy, ProtocolCell]):
    """See `Engine`; cells share the arrays of the protocol's data."""

    load_given = staticmethod(protocol_cell.load_arrays)
    run_cell = staticmethod(protocol_cell.run_cell)

    def cells(self) -> list[ProtocolCell]:
        return list(protocol_study.cells(self.study))

    def prepare(self, folder: Path) -> None:
        in_a_process(protocol_cell.prepare, folder, self.cells())

    def check(self, folder: Path) -> None:
        protocol_cell.check(folder, self.cells())

    def tables(self, folder: Path, done: Sequence[ProtocolCell]) -> Mapping[str, pd.DataFrame]:
        return {"results.csv": results_table(self.study, folder, done)}


def results_table(study: ProtocolStudy, folder: Path, done: Sequence[ProtocolCell]) -> pd.DataFrame:
    """The rows of all cells, in the order of the sweep; the swept values are the first columns."""
    rows = []
    for cell in done:
        swept = swept_values(study, cell)
        rows += [{**swept, **row} for row in result_of(folder, cell)["rows"]]
    return pd.DataFrame(rows)
