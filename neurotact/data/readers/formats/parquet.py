"""Parquet tables, which pyarrow reads: a column of the table is a column."""

from pathlib import Path

from neurotact.data.readers.formats.contents import PARQUET, check_content
from neurotact.data.readers.table.cells import Table, table_of
from neurotact.errors import InputError, first_line, optional
from neurotact.files import check_size


def read(path: Path) -> dict[str, Table]:
    """The table in a file; InputError without pyarrow, and for a file that is damaged or too large."""
    check_content(path, PARQUET, wanted="a Parquet table", fix="save it in Python with pandas.DataFrame.to_parquet")
    needed = f"{path}: pyarrow is needed to read Parquet; pip install 'neurotact[parquet]'"
    parquet = optional("pyarrow.parquet", needed)
    try:
        with parquet.ParquetFile(path) as file:
            groups = [file.metadata.row_group(number) for number in range(file.metadata.num_row_groups)]
            check_size(path, sum(group.total_byte_size for group in groups))
            frame = file.read().to_pandas()
        if frame.index.name is not None:
            frame = frame.reset_index()
        columns = {str(name): values.fillna("") if values.dtype == "str" else values for name, values in frame.items()}
        return {"": table_of(path, columns)}
    except InputError:
        raise
    except Exception as error:  # damaged bytes make Arrow raise nearly anything
        raise InputError(
            f"{path}: cannot be read as a Parquet table ({first_line(error)[:80]}); write it again"
        ) from error
