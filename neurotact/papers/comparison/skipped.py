"""Tasks and sets whose recordings are not at hand: what stands in place of their data and of their results."""

import logging
from collections.abc import Iterable

import numpy as np
import pandas as pd

from neurotact.errors import InputError
from neurotact.studies.protocol import Arrays

log = logging.getLogger("neurotact")

SKIPPED = "skipped"
"""Why there are no results: the name of an array, and a column that is empty for what was run."""


def left_out(name: str, error: InputError) -> Arrays:
    """In place of the data of a task or set, with a warning."""
    why = f"{name} is left out: {error}"
    log.warning("%s", why)
    return {SKIPPED: np.array(why)}


def skipped_row(arrays: Arrays, measures: Iterable[str]) -> dict[str, object]:
    """In place of its results: every measure is NaN."""
    return {**dict.fromkeys(measures, float("nan")), SKIPPED: str(arrays[SKIPPED])}


def of_run(results: pd.DataFrame) -> pd.DataFrame:
    """The rows of what was run."""
    return results[results["accuracy_test"].notna()]
