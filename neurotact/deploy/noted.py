"""The faults of a source of samples, counted."""

from dataclasses import dataclass


@dataclass
class Noted:
    """Counts of errors in a source, which is not changed by them.

    bad_rows: rows that were not used: no samples, repeats, or of a time that fits no other. cut_off: an incomplete end.
    restarts, wraps: of the clock that writes time stamps. outliers: time stamps that fit no other.
    stalls, late_blocks, late_ms: of the arrival.
    """

    bad_rows: int = 0
    cut_off: int = 0
    stalls: int = 0
    late_blocks: int = 0
    late_ms: float = 0.0
    restarts: int = 0
    wraps: int = 0
    outliers: int = 0

    def trouble(self) -> str:
        """The counts that are not zero, in words.

        >>> Noted(bad_rows=2, restarts=1).trouble()
        'bad rows 2, clock restarts 1'
        """
        words = (
            (self.bad_rows, "bad rows"), (self.cut_off, "cut off at the end"), (self.restarts, "clock restarts"),
            (self.wraps, "clock wraps"), (self.outliers, "time stamps ignored"), (self.stalls, "stalls"),
        )  # fmt: skip
        counts = [f"{what} {n}" for n, what in words if n]
        late = [f"late blocks {self.late_blocks} (by up to {self.late_ms:.1f} ms)"] if self.late_blocks else []
        return ", ".join(counts + late)
