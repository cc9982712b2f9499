"""The report of a run folder: one page for any study."""

from pathlib import Path

from neurotact import files
from neurotact.report import networks, ways
from neurotact.studies import runner
from neurotact.studies.loading import engine_of
from neurotact.studies.way_study import WayStudy


def write(folder: Path) -> Path:
    """Write the figures and `report.html` of a run from its tables; the page's path.

    Raises InputError when the folder holds no study or no tables, and when another process works in it.
    """
    study = runner.load(folder)
    own = engine_of(study).report
    with files.locked(folder):
        if own is not None:
            return own(study, folder)
        if isinstance(study, WayStudy):
            return ways.write(study, folder)
        return networks.write(study, folder)
