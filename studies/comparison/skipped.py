"""Tasks and sets whose recordings are not available: placeholders for their data and their results."""

import logging
from collections.abc import Iterable

import numpy as np
import pandas as pd

from neurotact.data.dataset import DatasetSpec
from neurotact.errors import InputError
from neurotact.studies.way import Arrays

log = logging.getLogger("neurotact")

SKIPPED = "skipped"
"""The reason for missing results: the name of an array, and of a column that is empty for rows with results."""


def left_out(name: str, error: InputError, dataset: DatasetSpec | None = None) -> Arrays:
    """A placeholder for the data of a task or set; logs a warning. Raises the error for a user's own file."""
    if dataset is not None and dataset.content is not None:
        raise error
    why = f"{name} is left out: {error}"
    log.warning("%s", why)
    return {SKIPPED: np.array(why)}


def skipped_row(arrays: Arrays, measures: Iterable[str]) -> dict[str, object]:
    """A placeholder for the results: every measure is NaN."""
    return {**dict.fromkeys(measures, float("nan")), SKIPPED: str(arrays[SKIPPED])}


def of_run(results: pd.DataFrame) -> pd.DataFrame:
    """The rows with results."""
    return results[results["accuracy_test"].notna()]
