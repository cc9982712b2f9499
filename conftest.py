"""Examples in docstrings that need an optional package are left out where it is not installed."""

from importlib.util import find_spec

NEEDS = {"pynwb": "neurotact/data/nwb_output.py"}
collect_ignore = [path for package, path in NEEDS.items() if not find_spec(package)]
