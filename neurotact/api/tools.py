"""What packages beside this one offer, each found by its name in the group `neurotact.tools` and loaded when used."""

from typing import Any

from neurotact import plugins

TOOLS = (
    "Decision", "Flow", "Samples", "Stream", "Streamed", "bundle_study", "check_chip", "conditions_curve",
    "fine_tune", "from_neo", "from_nir", "from_nir_data", "from_snntorch", "learn", "live", "plot_survival",
    "read_nwb", "refuse", "save_energy", "stream", "to_neo", "to_nir", "to_nir_data", "to_nwb", "to_snntorch",
    "tune", "what_survives",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in TOOLS:
        return plugins.load_function("tools", name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
