"""Examples in docstrings that need an optional package are left out where it is not installed."""

from importlib.util import find_spec

collect_ignore = [] if find_spec("pynwb") else ["neurotact/data/nwb_output.py"]
