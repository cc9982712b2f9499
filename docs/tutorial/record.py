"""Recordings of a skin that does not exist, in the form that a data logger might leave: for the tutorial.

    python docs/tutorial/record.py my-data

Four fabrics slide under five taxels at three speeds, fifteen times each: folders my-data/<fabric>/<mm per min>/.
A file has a comment, a header, and a row per sample: a time stamp in seconds, then five counts of a 12-bit converter,
with a comma at the end. The clock is 93 Hz, and its stamps jitter.
"""

import sys
from pathlib import Path

import numpy as np

RATE_Hz = 93.0
FABRICS = {"corduroy": (1.3, 200.0), "felt": (0.0, 40.0), "mesh": (0.4, 80.0), "twill": (0.7, 130.0)}
"""Spatial period in mm (0: none) and depth in counts."""
SPEEDS_mm_per_min = (300, 450, 600)
TRIALS, SECONDS, REST_s = 15, 2.5, 0.4


def touch(
    period_mm: float, depth: float, speed_mm_per_min: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Time stamps `(time,)` in seconds and counts `(time, taxel)`: rest, then contact, and the fabric sliding by."""
    intervals_s = rng.normal(1.0, 0.08, round(SECONDS * RATE_Hz)).clip(0.6, 1.4) / RATE_Hz
    time_s = np.cumsum(intervals_s)[:, None]
    contact = 1.0 / (1.0 + np.exp(-(time_s - REST_s - rng.uniform(0.0, 0.2)) / 0.03))
    way_mm = speed_mm_per_min / 60.0 * time_s + np.linspace(0.0, 2.0, 5) + rng.uniform(0.0, 5.0)
    ridges = np.sin(2.0 * np.pi * way_mm / period_mm) if period_mm else np.zeros_like(way_mm)
    rough = rng.normal(0.0, 0.4, way_mm.shape)
    load = rng.normal(700.0, 60.0) * np.array([0.8, 1.0, 1.1, 1.0, 0.7])
    counts = (
        400.0 + 30.0 * np.arange(5) + contact * (load + depth * (ridges + rough)) + rng.normal(0.0, 4.0, way_mm.shape)
    )
    return time_s[:, 0], counts.clip(0, 4095).astype(int)


def main(folder: Path) -> None:
    """Write all files."""
    rng = np.random.default_rng(0)
    for fabric, (period_mm, depth) in FABRICS.items():
        for speed in SPEEDS_mm_per_min:
            (folder / fabric / str(speed)).mkdir(parents=True)
            for trial in range(TRIALS):
                time_s, counts = touch(period_mm, depth, speed, rng)
                rows = [
                    f"{t:.4f}," + "".join(f"{count}," for count in row) for t, row in zip(time_s, counts, strict=True)
                ]
                text = "\n".join([f"# skin 7, {fabric}, {speed} mm/min", "time,t1,t2,t3,t4,t5,", *rows])
                (folder / fabric / str(speed) / f"slide{trial:02d}.csv").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
