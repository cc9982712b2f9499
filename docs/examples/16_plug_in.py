"""
A plug-in: read your own format by name
=======================================

A package of yours adds a reader with one entry point. Then `nt.read`, `neurotact import` and studies know it by name,
and nothing in neurotact changes.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import neurotact as nt

# %%
# The module: a function from a path to recordings, and a `Reader` that names it.

MODULE = '''
import numpy as np
import neurotact as nt

def read(folder):
    """A .npy array (time, taxel) per touch, named <class>_<number>.npy, at 500 Hz in mV."""
    files = sorted(folder.glob("*_*.npy"))
    labels = [file.stem.rpartition("_")[0] for file in files]
    return nt.Recordings([np.load(file) for file in files], 500.0, "mV", labels, source=str(folder))

READER = nt.Reader("Touches of my skin: a folder of .npy files.", read)
'''

# %%
# These three files are what `pip install .` leaves of a package whose `pyproject.toml` has the entry point
# `my-skin = "my_skin:READER"` under `[project.entry-points."neurotact.readers"]`.

site = Path(tempfile.mkdtemp())
(site / "my_skin.py").write_text(MODULE)
(info := site / "my_skin-0.1.dist-info").mkdir()
(info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-skin\nVersion: 0.1\n")
(info / "entry_points.txt").write_text("[neurotact.readers]\nmy-skin = my_skin:READER\n")

# %%
sys.path.append(str(site))
rng, time_s = np.random.default_rng(0), np.arange(400)[:, None] / 500.0
(site / "data").mkdir()
for number in range(6):
    name, frequency_Hz = (("felt", 5.0), ("mesh", 15.0))[number % 2]
    waves = np.sin(2 * np.pi * frequency_Hz * time_s + rng.uniform(0, 6, 4))
    np.save(site / "data" / f"{name}_{number}.npy", 8 * waves)

touches = nt.read("my-skin", site / "data")
assert isinstance(touches, nt.Recordings)
spikes = nt.encode(
    touches, settings={"sa1.gain": 4.0, "ra1.gain": 60.0, "sa1.t_ref_ms": 2, "ra1.t_ref_ms": 2}
)
figure = nt.plot_raster(spikes, trial=0, recordings=touches)
