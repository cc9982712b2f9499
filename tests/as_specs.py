"""Options of imports, as a table of a test has them side by side, as the specs that Python takes."""

from collections.abc import Mapping
from typing import Any

import neurotact as nt

NAMING = {"levels": "levels", "pattern": "pattern", "conditions": "table", "label": "label"}


def of_folder(options: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `nt.read_folder`."""
    return _named(of_table(options))


def of_raster(options: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `nt.read_raster`, whose conditions may be of a file, too."""
    left = {key: value for key, value in options.items() if key != "conditions"}
    return of_folder(left) | {key: options[key] for key in ("conditions",) if key in options}


def of_events(options: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `nt.read_events`."""
    left = _named(options)
    events = {key: left.pop(key) for key in nt.Events.model_fields if key in left}
    return left | ({"events": nt.Events(**events)} if events else {})


def _named(options: Mapping[str, Any]) -> dict[str, Any]:
    """The same, with what names of files say as a spec."""
    naming = {NAMING[key]: value for key, value in options.items() if key in NAMING}
    left = {key: value for key, value in options.items() if key not in NAMING}
    return left | ({"naming": nt.Naming(**naming)} if naming else {})


def of_table(options: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `nt.read_table`."""
    layout = {key: value for key, value in options.items() if key in nt.Layout.model_fields}
    left = {key: value for key, value in options.items() if key not in layout}
    return left | ({"layout": nt.Layout(**layout)} if layout else {})
