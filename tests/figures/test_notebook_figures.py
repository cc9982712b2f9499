"""Figures are shown by a notebook, pyplot imported or not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

CELLS = """
import sys
from IPython.core.interactiveshell import InteractiveShell

shell = InteractiveShell.instance()
shown = []
shell.displayhook.write_format_data = lambda data, metadata=None: shown.append(data)
if {with_pyplot}:
    shell.run_cell("import matplotlib.pyplot as plt", silent=True)
first = '''
import numpy as np, pandas as pd
import neurotact as nt
from neurotact.data.spikes import from_rasters
felt = pd.DataFrame({{"label": ["felt"]}})
spikes = from_rasters(np.eye(4, 2, dtype=np.uint8)[None], 1000.0, ("SA-I a", "RA-I a"), felt)
'''
assert shell.run_cell(first).success
assert shell.run_cell("nt.plot_raster(spikes)").success
if {with_pyplot}:
    import matplotlib.pyplot as plt
    assert plt.get_fignums() == []
else:
    assert "matplotlib.pyplot" not in sys.modules
(bundle,) = shown
assert bundle["image/png"][:8] == b"\\x89PNG\\r\\n\\x1a\\n", bundle.keys()
"""


@pytest.mark.thorough
@pytest.mark.parametrize("with_pyplot", [False, True])
def test_a_cell_that_ends_in_a_figure_shows_it(with_pyplot, tmp_path):
    pytest.importorskip("IPython", reason="the test extra installs IPython")
    done = subprocess.run(
        [sys.executable, "-c", CELLS.format(with_pyplot=with_pyplot)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg", "IPYTHONDIR": str(tmp_path),
             "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
