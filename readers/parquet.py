"""Parquet tables, which pyarrow reads: a column of the table is a column."""

from pathlib import Path

from neurotact.data.readers.formats import Format
from neurotact.data.readers.formats.contents import PARQUET
from neurotact.data.readers.table.cells import Table, table_of
from neurotact.errors import optional
from neurotact.files import check_size

VALUE_BYTES = 8
"""Memory of a value, of which a file may hold any number as one and a count."""


def _read(path: Path) -> dict[str, Table]:
    needed = f"{path}: pyarrow is needed to read Parquet; pip install 'neurotact[parquet]'"
    with optional("pyarrow.parquet", needed).ParquetFile(path) as file:
        held = file.metadata
        n_bytes = sum(held.row_group(number).total_byte_size for number in range(held.num_row_groups))
        check_size(path, max(n_bytes, VALUE_BYTES * held.num_rows * held.num_columns))
        frame = file.read().to_pandas()
    if frame.index.name is not None:
        frame = frame.reset_index()
    columns = {str(name): values.fillna("") if values.dtype == "str" else values for name, values in frame.items()}
    return {"": table_of(path, columns)}


FORMAT = Format("a Parquet table", "save it in Python with pandas.DataFrame.to_parquet", _read, contents=(PARQUET,))
