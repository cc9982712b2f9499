"""The name of a column in words: its quantity and its unit."""

from typing import Any

UNITS = {"mm_per_s": "mm/s", "per_s": "1/s"} | {unit: unit for unit in ("ms", "Hz", "mV", "mm", "N", "V", "s")}
NAMES = {
    "accuracy_validation": "validation accuracy",
    "accuracy_test": "test accuracy",
    "sops_input": "SOPs from afferents to hidden neurons",
    "sops_recurrent": "SOPs among hidden neurons",
    "sops_readout": "SOPs from hidden neurons to the readout",
    "sops_total": "SOPs",
    "sops_total_feedforward": "SOPs without the recurrent ones",
    "spikes_sa": "SA-I spikes per sample",
    "spikes_ra": "RA-I spikes per sample",
    "spikes_sa_per_s": "SA-I spikes per second",
    "spikes_ra_per_s": "RA-I spikes per second",
    "spikes_total_per_s": "SA-I and RA-I spikes per second",
    "sa_share": "share of SA-I among all spikes",
    "isi_sa_ms": "inter-spike interval of SA-I in ms",
    "isi_ra_ms": "inter-spike interval of RA-I in ms",
    "isi_overlap_sa": "overlap of the SA-I interval distributions of two classes",
    "isi_overlap_ra": "overlap of the RA-I interval distributions of two classes",
    "isi_sd_sa_ms": "deviation of the SA-I inter-spike intervals in ms",
    "isi_sd_ra_ms": "deviation of the RA-I inter-spike intervals in ms",
    "silent_share_sa": "share of trials without an SA-I spike",
    "silent_share_ra": "share of trials without an RA-I spike",
    "latency_sa_ms": "time to the first SA-I spike in ms",
    "latency_ra_ms": "time to the first RA-I spike in ms",
    "chosen": "being chosen (1 or 0)",
    "persists": "keeping the window length (1 or 0)",
    "window.length_ms": "window length in ms",
    "exit_share": "share of steps with early exit",
    "oracle_share": "share of steps with the paper's early exit",
    "exit_steps": "steps with early exit",
    "exit_steps_sd": "deviation of the steps with early exit over samples",
    "exit_accuracy": "accuracy with early exit",
    "exit_sops_total": "SOPs with early exit",
}
"""Columns of a study's tables whose names need words."""


def quantity(column: str) -> tuple[str, str]:
    """The name and the unit in a column's name; an empty unit if it has none.

    >>> quantity("force_N"), quantity("speed_mm_per_s"), quantity("fabric")
    (('force', 'N'), ('speed', 'mm/s'), ('fabric', ''))
    """
    for suffix, unit in UNITS.items():
        if column.endswith(f"_{suffix}"):
            return column.removesuffix(f"_{suffix}").replace("_", " "), unit
    return column.replace("_", " "), ""


def in_unit(column: str, value: Any) -> str:
    """A value with its column's unit.

    >>> in_unit("force_N", 12.0), in_unit("speed_mm_per_s", 8.6), in_unit("finger", "left")
    ('12 N', '8.6 mm/s', 'left')
    """
    number = f"{value:g}" if isinstance(value, (int, float)) and not isinstance(value, bool) else str(value)
    return f"{number} {quantity(column)[1]}".strip()


def name_of(column: str) -> str:
    """The quantity in a column of a study's tables, for a sentence.

    >>> name_of("accuracy_test"), name_of("window.start_ms")
    ('test accuracy', 'window.start in ms')
    """
    name, unit = quantity(column)
    return NAMES.get(column, f"{name} in {unit}" if unit else name)
