"""Processors that an export is tried on, and what a chip of their kind draws."""

from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
HOST, CORTEX_M, SCRIPT = HERE / "host.c", HERE / "cortex_m.c", HERE / "cortex_m.ld"
SHIFT = 10
"""QEMU's clock moves 2^SHIFT ns an instruction, several ticks of SysTick: so ticks count instructions."""


class Chip(NamedTuple):
    """A chip with such a processor: what it draws while it computes, from its data sheet."""

    name: str
    clock_Hz: float
    watts: float
    source: str


class Board(NamedTuple):
    """A machine of QEMU, its processor, the frequency of its SysTick there, and a chip of the kind.

    cycles_per_instruction: of the exports. On Cortex-M0 1.37, found by adding up Arm's cycles (Cortex-M0 Technical
    Reference Manual, Table 3-1) over a trace of 2.7 million instructions of the integer variant; on Cortex-M4 taken to
    be 1.3, which nobody measured.
    """

    machine: str
    processor: str
    flags: tuple[str, ...]
    flash: int
    ram: int
    clock_Hz: float
    cycles_per_instruction: float
    chip: Chip


NRF51 = Chip(
    "nRF51822",
    16e6,
    4.71e-3 * 2.957,
    "4.71 mA at 2.957 V on an nRF51 DK, after devzone.nordicsemi.com/blogs/756 (unverified)",
)
NRF52 = Chip(
    "nRF52832",
    64e6,
    3.7e-3 * 3.0,
    "58 µA/MHz from flash with DC/DC at 3 V, as others quote the nRF52832 Product Specification (unverified)",
)
BOARDS = {
    "cortex-m0": Board(
        "microbit", "Cortex-M0", ("-mcpu=cortex-m0", "-mthumb"), 256 * 1024, 16 * 1024, 16e6, 1.37, NRF51
    ),
    "cortex-m4": Board(
        "mps2-an386", "Cortex-M4F", ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
        4 * 1024 * 1024, 4 * 1024 * 1024, 25e6, 1.3, NRF52,
    ),
}  # fmt: skip
