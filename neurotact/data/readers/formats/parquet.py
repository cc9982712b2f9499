"""Parquet tables, which pyarrow reads: a column of the table is a column."""

from pathlib import Path

from neurotact.data.readers.formats.contents import PARQUET, check_content, damaged_as
from neurotact.data.readers.table.cells import Table, table_of
from neurotact.errors import optional
from neurotact.files import check_size

VALUE_BYTES = 8
"""Memory of a value, of which a file may hold any number as one and a count."""


def read(path: Path) -> dict[str, Table]:
    """The table in a file; InputError without pyarrow, and for a file that is damaged or too large."""
    check_content(path, PARQUET, wanted="a Parquet table", fix="save it in Python with pandas.DataFrame.to_parquet")
    needed = f"{path}: pyarrow is needed to read Parquet; pip install 'neurotact[parquet]'"
    parquet = optional("pyarrow.parquet", needed)
    with damaged_as(path, "cannot be read as a Parquet table", "write it again"):
        with parquet.ParquetFile(path) as file:
            held = file.metadata
            n_bytes = sum(held.row_group(number).total_byte_size for number in range(held.num_row_groups))
            check_size(path, max(n_bytes, VALUE_BYTES * held.num_rows * held.num_columns))
            frame = file.read().to_pandas()
        if frame.index.name is not None:
            frame = frame.reset_index()
        columns = {str(name): values.fillna("") if values.dtype == "str" else values for name, values in frame.items()}
        return {"": table_of(path, columns)}
