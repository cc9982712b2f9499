"""Processors on which an export is tested, and the power of a chip of each kind."""

from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
HOST, CORTEX_M, SCRIPT = HERE / "host.c", HERE / "cortex_m.c", HERE / "cortex_m.ld"
SHIFT = 10
"""QEMU's clock advances by 2^SHIFT ns per instruction, several ticks of SysTick, so ticks count instructions."""
LONG_SHIFT = 6
"""The same for `ROOMY`, whose timer then ends after 2.7 thousand million instructions."""


class Chip(NamedTuple):
    """A chip with such a processor, its bytes, and its power while it computes, from its data sheet."""

    name: str
    clock_Hz: float
    flash: int
    ram: int
    watts: float
    source: str


class Board(NamedTuple):
    """A machine of QEMU, its processor, the frequency of its SysTick in QEMU, and a chip of this kind.

    cycles_per_instruction: of the exports. On Cortex-M0 1.37, the sum of Arm's cycles (Cortex-M0 Technical Reference
    Manual, Table 3-1) over a trace of 2.7 million instructions of the integer variant; on Cortex-M4 1.3, an assumption
    without a measurement.
    """

    machine: str
    processor: str
    flags: tuple[str, ...]
    flash: int
    ram: int
    clock_Hz: float
    cycles_per_instruction: float
    chip: Chip
    shift: int = SHIFT


NRF51 = Chip(
    "nRF51822",
    16e6,
    256 * 1024,
    16 * 1024,
    4.71e-3 * 2.957,
    "4.71 mA at 2.957 V on an nRF51 DK, from devzone.nordicsemi.com/blogs/756 (unverified)",
)
NRF52 = Chip(
    "nRF52832",
    64e6,
    512 * 1024,
    64 * 1024,
    3.7e-3 * 3.0,
    "58 µA/MHz from flash with DC/DC at 3 V, as quoted elsewhere from the nRF52832 Product Specification (unverified)",
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
_BIG = BOARDS["cortex-m4"]
_TIMER = "-DTIMER=0x40000000u"
ROOMY = {
    "cortex-m0": BOARDS["cortex-m0"]._replace(
        machine=_BIG.machine, flags=(*BOARDS["cortex-m0"].flags, _TIMER), flash=_BIG.flash, ram=_BIG.ram,
        clock_Hz=_BIG.clock_Hz, shift=LONG_SHIFT,
    ),
    "cortex-m4": _BIG._replace(flags=(*_BIG.flags, _TIMER), shift=LONG_SHIFT),
}  # fmt: skip
"""The instructions of each processor on a machine of 4 MB, which runs both, and with a timer of 32 bits: for programs
that no chip of the kind holds, and for decisions of millions of instructions."""
