"""Cases whose inputs are well formed and whose content is odd, as sensors, loggers and people leave it.

Damage ends most cases in a parser; these reach what comes after it. Each says what its input holds, in samples, events
and trials, so that the judge sees what was lost, doubled or misread without a word. A kind is as in `cases`.
"""

import gzip
import json
import random
import shutil
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cases
import h5py
import mutations
import numpy as np
import scipy.io
from cases import NETWORK, fetch
from judge import Case

RATES_Hz = (20.0, 50.0, 93.0, 100.0, 1000.0)
HOSTILE = [
    "<b>felt</b>", "<script>alert(1)</script>", "<img src=x onerror=alert(1)>", "felt\nsilk", "felt\tsilk", "x" * 300,
    "../felt", "..", ".", "/etc/passwd", "a/b", "C:\\felt", "=1+1", "-o", "--force", "+felt", "@felt", "felt,silk",
    "felt;silk", '"felt"', "'felt'", "$\\frac{$", "$x$", "_", "%s", "{}", "{{7*7}}", "[red]", "felt ", " felt", "Felt",
    "FELT", "nan", "None", "null", "true", "0", "1", "1.0", "01", "1e3", "-1", "½", "٣", "ﬀ", "é", "e\u0301",
    "\u202efelt", "\ufeff", "\u200b", "日本", "\N{GRINNING FACE}", "felt\0", "\x1b[31mfelt", "\udcff", "label", "trial",
    "rest", "all", "mean", "con",
]  # fmt: skip
"""Names of classes that break a page, a path, a table, a figure or a comparison."""


class Content(NamedTuple):
    """A continuous stretch of touch: samples, their stamps in s, and their rate."""

    signal: np.ndarray
    time_s: np.ndarray
    rate_Hz: float


def _content(rng: random.Random, n: int | None = None, n_taxels: int | None = None) -> Content:
    noise = np.random.default_rng(rng.randrange(2**32))
    n = n or rng.choice([30, 60, 200, 500])
    rate_Hz = rng.choice(RATES_Hz)
    signal = noise.normal(rng.choice([0, 300]), rng.choice([1, 40]), (n, n_taxels or rng.choice([1, 2, 5]))).round(3)
    return Content(signal, np.arange(n) / rate_Hz, rate_Hz)


# --- what happens to stamps -------------------------------------------------------------------------


def _rounded(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    """To the tick of a logger."""
    tick_s = rng.choice([0.001, 0.01, 0.0156, 0.1, 1.0])
    return np.round(time_s / tick_s) * tick_s


def _in_batches(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    """Packets of samples with one stamp each: that of their arrival."""
    size = rng.choice([2, 5, 10, 50])
    return time_s[np.minimum(np.arange(len(time_s)) // size * size, len(time_s) - 1)]


def _since_1970(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    return time_s + rng.choice([1.7e9, 1.7e9 + 1 / 3, 3600.0, 1e6])


def _as_float32(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    return (time_s + rng.choice([0.0, 5000.0, 1e5, 1.7e9])).astype(np.float32).astype(float)


def _jittered(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    noise = np.random.default_rng(rng.randrange(2**32))
    return time_s + noise.normal(0, rng.choice([0.01, 0.1, 0.6]) * abs(float(time_s[1] - time_s[0])), len(time_s))


def _with_a_gap(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    at = rng.randrange(1, len(time_s))
    return time_s + np.where(np.arange(len(time_s)) >= at, rng.choice([0.3, 5.0, 3600.0]), 0)


def _restarted(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    """The logger starts again at 0, or its clock is set back."""
    at = rng.randrange(1, len(time_s))
    back_s = rng.choice([float(time_s[at]), 3600.0, float(time_s[at] - time_s[at - 1])])
    return time_s - np.where(np.arange(len(time_s)) >= at, back_s, 0)


def _wrapped(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    """A counter of ms in 16 bits, or of us in 32."""
    limit_s = rng.choice([2**16 * 1e-3, 2**32 * 1e-6, 2**8 * 1e-3])
    return (time_s + limit_s - rng.random() * float(time_s[-1])) % limit_s


def _backwards(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    return time_s[::-1]


def _swapped(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    changed = time_s.copy()
    for _ in range(rng.choice([1, 5])):
        at = rng.randrange(len(changed) - 1)
        changed[[at, at + 1]] = changed[[at + 1, at]]
    return changed


def _repeated(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    changed = time_s.copy()
    for at in rng.sample(range(1, len(changed)), rng.choice([1, len(changed) // 4])):
        changed[at] = changed[at - 1]
    return changed


def _constant(time_s: np.ndarray, rng: random.Random) -> np.ndarray:
    return np.full(len(time_s), rng.choice([0.0, 5.0]))


STAMPS: list[Callable[[np.ndarray, random.Random], np.ndarray]] = [
    *[_rounded, _in_batches, _since_1970, _as_float32, _jittered] * 3, _with_a_gap, _restarted, _wrapped,
    _backwards, _swapped, _repeated, _constant,
]  # fmt: skip


def _clock(rng: random.Random) -> Callable[[np.ndarray], np.ndarray]:
    """What one device does to the stamps of all its trials; some do it in a few trials alone."""
    some = [(rng.choice(STAMPS), rng.randrange(2**32)) for _ in range(rng.choice([0, 1, 1, 1, 1, 2]))]
    is_rare = rng.random() < 0.2

    def stamped(time_s: np.ndarray) -> np.ndarray:
        for change, seed in some if len(time_s) > 1 and not (is_rare and rng.random() < 0.6) else ():
            time_s = change(time_s, random.Random(seed))
        return time_s

    return stamped


def _written_stamps(time_s: np.ndarray, rng: random.Random) -> tuple[str, list[str]]:
    """A header and stamps as a file writes them: in a unit, as whole numbers, or as a time of day."""
    how = rng.choice(["s", "ms", "us", "ns", "ms int", "us int", "plain", "clock", "date"])
    if how in ("clock", "date"):
        whole_ms = [round(1e3 * (t % 86400)) for t in time_s]
        clock = [f"{t // 3600000 % 24:02}:{t // 60000 % 60:02}:{t // 1000 % 60:02}.{t % 1000:03}" for t in whole_ms]
        return rng.choice(["time", "clock"]), [f"2026-01-02T{t}" for t in clock] if how == "date" else clock
    unit = how.partition(" ")[0]
    scaled = time_s * {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "plain": 1.0}[unit]
    name = rng.choice(["t", "time", "timestamp"]) + ("" if unit == "plain" else f"_{unit}")
    if how.endswith("int") or unit == "ns":
        return name, [str(round(t)) for t in scaled]
    digits = rng.choice([17, 17, 17, 9, 6])
    return name, [f"{value:.{digits}g}" for value in scaled]


# --- what happens to values and rows ----------------------------------------------------------------


def _valued(signal: np.ndarray, rng: random.Random) -> np.ndarray:
    how = rng.choice(
        ["keep", "keep", "int", "round", "clip", "flat", "taxel", "huge", "tiny", "zero", "binary", "huge one"]
    )
    changed = signal.copy()
    if how == "flat":
        changed[len(changed) // 2 :] = changed[len(changed) // 2]
    elif how == "taxel":
        changed[:, 0] = rng.choice([0.0, 5.0])
    elif how == "huge one":
        changed[rng.randrange(len(changed)), 0] = rng.choice([1e9, -1e30])
    elif how == "clip":
        changed = np.clip(changed, -1, 1)
    elif how == "binary":
        changed = (changed > changed.mean()).astype(float)
    else:
        digits, factor = {"int": (0, 1), "round": (1, 1), "huge": (3, 1e9), "tiny": (15, 1e-9), "zero": (0, 0)}.get(
            how, (3, 1)
        )
        changed = (changed * factor).round(digits)
    return changed


class Style(NamedTuple):
    """How a table is written."""

    separator: str = ","
    decimal: str = "."
    encoding: str = "utf-8"
    end: str = "\n"
    head: str = ""
    quoted: bool = False
    trailing: bool = False


def _style(rng: random.Random) -> Style:
    separator = rng.choice([",", ",", ";", "\t", " ", "|", ", ", "; "])
    decimal = "," if separator.strip() != "," and rng.random() < 0.3 else "."
    return Style(
        separator, decimal, rng.choice(["utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16", "cp1252", "utf-16-le"]),
        rng.choice(["\n", "\n", "\r\n", "\r"]),
        rng.choice(["", "", "", "# sensor 7, 2026\n", "% Größe 1 mm\n", "sep=;\n", "Logger v1\nUnit: mV\n\n", "\n"]),
        rng.random() < 0.15, rng.random() < 0.1,
    )  # fmt: skip


def _write_table(
    path: Path, header: Sequence[str], rows: Sequence[Sequence[str]], style: Style, is_headed: bool = True
) -> None:
    def line(cells: Sequence[str]) -> str:
        written = [f'"{cell}"' for cell in cells] if style.quoted else cells
        return style.separator.join(written) + (style.separator.strip() if style.trailing else "")

    lines = [line(header)] * is_headed + [line([cell.replace(".", style.decimal) for cell in row]) for row in rows]
    text = style.head.replace("\n", style.end) + style.end.join(lines) + style.end
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode(style.encoding, "replace"))


def _numbers(row: np.ndarray) -> list[str]:
    return [repr(float(value)) if value != round(value) else str(int(value)) for value in row.tolist()]


def _total(signals: Sequence[np.ndarray]) -> float:
    return float(sum(np.abs(signal).sum() for signal in signals))


# --- kinds: tables, folders, arrays -----------------------------------------------------------------


def stamped_tables(rng: random.Random, place: Path, base: Path) -> Case:
    """One table of all trials, with stamps of any kind, its rows in any order."""
    n_trials = rng.choice([2, 4, 7])
    is_stamped = rng.random() < 0.75
    first = _content(rng)
    header = ["trial", "label", "t_ms", *(f"p{i}" for i in range(first.signal.shape[1]))]
    rows, clock = [], _clock(rng)
    form = rng.getstate()
    for trial in range(n_trials):
        n = rng.choice([1, 2, 20]) if rng.random() < 0.05 else len(first.signal)
        signal = _valued(_content(rng, n, first.signal.shape[1]).signal, rng)
        time_s = clock(np.arange(n) / first.rate_Hz)
        after = rng.getstate()
        rng.setstate(form)  # one way of writing for all trials
        header[2], stamps = _written_stamps(time_s, rng)
        rng.setstate(after)
        rows += [[str(trial), "xy"[trial % 2], t, *_numbers(v)] for t, v in zip(stamps, signal, strict=True)]
    kept = [0, 1, *([2] if is_stamped else []), *range(3, len(header))]
    rows, header = [[row[k] for k in kept] for row in rows], [header[k] for k in kept]
    how = rng.choice(["keep", "keep", "keep", "shuffle", "interleave", "copies", "drop"])
    if how == "shuffle":
        rng.shuffle(rows)
    elif how == "interleave":
        rows = [row for k in range(n_trials) for row in rows[k::n_trials]]
    elif how == "copies":
        rows += rows[: rng.choice([1, len(rows) // 2, len(rows)])]
    elif how == "drop":
        rows = [row for row in rows if rng.random() < 0.9]
    _write_table(place / "table.csv", header, rows, _style(rng) if rng.random() < 0.2 else Style())
    rate = [] if is_stamped and rng.random() < 0.8 else ["--sampling-rate-Hz", f"{first.rate_Hz:g}"]
    more = rng.choice(
        [[], [], [], ["--segments"], ["--time-unit", "ms"], ["--max-gap-ms", "1e6"], ["--max-gap-ms", "50"]]
    )
    words = ["import", "table", "table.csv", "--unit", "mV", *rate, *more, "-o", "out.h5"]
    return Case("content: stamped tables", words, out="out.h5", holds={"samples": len(rows)})


def text_tables(rng: random.Random, place: Path, base: Path) -> Case:
    """A folder of tables in any encoding, with any separator, decimal mark and header: each number is read right."""
    style = _style(rng)
    is_headed, suffix = rng.random() < 0.8, rng.choice([".csv", ".csv", ".txt", ".tsv"])
    signals = []
    content = _content(rng)
    for label in ("rough", "smooth"):
        for trial in range(2):
            signal = _valued(_content(rng, len(content.signal), content.signal.shape[1]).signal, rng)
            rows = [_numbers(row) for row in signal]
            header = [f"p{i}" for i in range(signal.shape[1])]
            if rng.random() < 0.03:
                rows.insert(rng.randrange(len(rows)), header if rng.random() < 0.5 else [""] * len(header))
            _write_table(
                place / "raw" / label / f"{trial}{suffix}",
                header,
                rows,
                style,
                is_headed,
            )
            signals.append(signal)
    decimal = ["--decimal", ","] if style.decimal == "," and rng.random() < 0.8 else []
    words = ["import", "folder", "raw", "--sampling-rate-Hz", f"{content.rate_Hz:g}", "--unit", "mV", *decimal]
    holds = {"samples": sum(map(len, signals)), "trials": 4, "total": _total(signals)}
    return Case("content: text", [*words, "-o", "out.h5"], out="out.h5", holds=holds)


def stamped_folders(rng: random.Random, place: Path, base: Path) -> Case:
    """A folder of a file a trial, with stamps of any kind."""
    first, clock, n_samples = _content(rng), _clock(rng), 0
    form = rng.getstate()
    for label in ("rough", "smooth"):
        for trial in range(rng.choice([1, 2, 3])):
            n = rng.choice([1, 2, 10, 2000]) if rng.random() < 0.08 else len(first.signal)
            signal = _valued(_content(rng, n, first.signal.shape[1]).signal, rng)
            after = rng.getstate()
            rng.setstate(form)
            name, stamps = _written_stamps(clock(np.arange(n) / first.rate_Hz), rng)
            rng.setstate(after)
            rows = [[t, *_numbers(v)] for t, v in zip(stamps, signal, strict=True)]
            _write_table(place / "raw" / label / f"{trial}.csv", [name, *"abcde"[: signal.shape[1]]], rows, Style())
            n_samples += n
    if rng.random() < 0.3:  # a recording twice, under another name or class
        shutil.copy(place / "raw/rough/0.csv", place / rng.choice(["raw/rough/9.csv", "raw/smooth/9.csv"]))
        n_samples += sum(1 for _ in (place / "raw/rough/0.csv").open()) - 1
    rate = rng.choice([[], [], [], ["--sampling-rate-Hz", f"{first.rate_Hz:g}"], ["--max-gap-ms", "1e7"]])
    words = ["import", "folder", "raw", "--unit", "mV", *rate, "-o", "out.h5"]
    return Case("content: stamped folders", words, out="out.h5", holds={"samples": n_samples})


def arrays(rng: random.Random, place: Path, base: Path) -> Case:
    """One file of arrays: any number type, order of axes, kind of label, copies of trials, NaN at the end of some."""
    noise = np.random.default_rng(rng.randrange(2**32))
    n_trials, n_steps, n_taxels = rng.choice([4, 6, 20]), rng.choice([20, 50, 200]), rng.choice([1, 3, 8])
    signals = noise.normal(0, 50, (n_trials, n_steps, n_taxels))
    how = rng.choice(["keep", "keep", "copies", "scaled", "padded", "nan", "masked", "flat", "binary", "int", "image"])
    if how in ("copies", "scaled"):
        signals[n_trials // 2 :] = signals[: n_trials - n_trials // 2] * (1 if how == "copies" else 1.0001)
    elif how in ("padded", "nan"):
        for trial in range(0, n_trials, 2):
            signals[trial, n_steps - rng.randrange(1, n_steps) :] = np.nan if how == "nan" else 0
    elif how == "flat":
        signals[0] = 0
    elif how == "binary":
        signals = (signals > 40).astype(float)
    kind = rng.choice(["f8", "f4", "f2", ">f4", "i2", "i4", "u1", "?", "f8"])
    given = signals if how == "nan" else signals.astype(kind)
    given = given.reshape(n_trials, n_steps, n_taxels)
    n_samples = int((~np.isnan(given).all(axis=2)).sum()) if how == "nan" else n_trials * n_steps
    labels = _labels(rng, n_trials)
    axes = rng.choice(["trial,time,taxel"] * 3 + ["trial,taxel,time", "taxel,time,trial"])
    order = {"trial,time,taxel": (0, 1, 2), "trial,taxel,time": (0, 2, 1), "taxel,time,trial": (2, 1, 0)}[axes]
    content: dict[str, Any] = {"X": given.transpose(order), "y": labels}
    if rng.random() < 0.4:
        content["person"] = noise.integers(0, 3, n_trials)
    if rng.random() < 0.2:
        content["fs"] = np.array([[100.0]])
    if rng.random() < 0.2:
        content["t"] = np.arange(n_steps) / 100
    name = _write_arrays(place, content, rng)
    if name is None:
        return Case(
            "content: arrays",
            ["import", "arrays", "gone.npz", "--sampling-rate-Hz", "100", "--unit", "V", "-o", "out.h5"],
        )
    words = ["import", "arrays", name, "--sampling-rate-Hz", "100", "--unit", rng.choice(["V", "mV", "count"])]
    asked = rng.choice([[], [], [], ["--names", "label=person"], ["--names", "signals=X"]])
    words += [*(["--axes", axes] if axes != "trial,time,taxel" or rng.random() < 0.2 else []), *asked, "-o", "out.h5"]
    return Case("content: arrays", words, out="out.h5", holds={"samples": n_samples, "trials": n_trials})


def _labels(rng: random.Random, n: int) -> np.ndarray:
    which = np.arange(n) % 2
    some = [which, which.astype(float), which.astype(bool), np.array(["felt", "silk"])[which],
            np.array([b"felt", b"silk"])[which], which + 0.5, which[:, None], np.eye(2)[which],
            np.array(rng.sample(HOSTILE, 2))[which], np.arange(n), which * 0]  # fmt: skip
    return rng.choice(some)


def _write_arrays(place: Path, content: dict[str, Any], rng: random.Random) -> str | None:
    how = rng.choice(["npz", "npz", "mat", "h5"])
    try:
        if how == "npz":
            np.savez(place / "arrays.npz", **content)
        elif how == "mat":
            scipy.io.savemat(place / "arrays.mat", content, do_compression=rng.random() < 0.5)
        else:
            with h5py.File(place / "arrays.h5", "w") as file:
                for name, array in content.items():
                    text = np.asarray(array).dtype.kind == "U"
                    file.create_dataset(name, data=array.astype(object) if text else array,
                                        dtype=h5py.string_dtype() if text else None)  # fmt: skip
    except (ValueError, TypeError, UnicodeEncodeError):  # a text that the format cannot hold
        return None
    return f"arrays.{how}"


# --- kinds: events ----------------------------------------------------------------------------------


def stamped_events(rng: random.Random, place: Path, base: Path) -> Case:
    """A file of events whose times are rounded, large, repeated, out of order or in a small float."""
    noise = np.random.default_rng(rng.randrange(2**32))
    n, n_channels = rng.choice([40, 300, 3000]), rng.choice([1, 5, 12])
    step_ms = rng.choice([0.1, 1.0, 1.0, 5.0])
    how = rng.choice(["clock", "clock", "poisson"])
    trial = np.sort(noise.integers(0, 4, n))
    steps = np.concatenate([_distinct(noise, int((trial == k).sum())) for k in range(4)])
    time_s = steps * step_ms * 1e-3 if how == "clock" else noise.random(n) * 2.0
    time_s = time_s + rng.choice([0.0, 0.0, 0.5e-3 * step_ms, 100.0, 1.7e9])
    kind = rng.choice(["f8", "f8", "f4", "i8", "f2"])
    unit, factor = rng.choice([("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
    times = time_s * factor
    if rng.random() < 0.2:
        times = times.round(rng.choice([0, 1, 3]))
    with np.errstate(all="ignore"):
        times = times.round().astype("i8") if kind == "i8" else times.astype(kind)
    channel = noise.integers(0, n_channels, n) if rng.random() < 0.5 else steps % n_channels
    polarity = rng.choice(
        [None, noise.integers(0, 2, n), noise.choice([-1, 1], n), np.array(["ON", "OFF"])[noise.integers(0, 2, n)]]
    )
    if rng.random() < 0.2:
        order = noise.permutation(n)
        trial, times, channel = trial[order], times[order], channel[order]
        polarity = None if polarity is None else polarity[order]
    options = ["--step-ms", f"{step_ms:g}", "--time-unit", unit]
    options += rng.choice([[], [], ["--origin", "first"], ["--origin", "first"], ["--polarity", "merge"],
                           ["--n-channels", "12"], ["--duration-ms", "1000"], ["--polarity", "on"]])  # fmt: skip
    columns = {"trial": trial, "time": times, "channel": channel, "label": np.array(["rough", "smooth"])[trial % 2]}
    columns |= {} if polarity is None else {"polarity": polarity}
    if rng.random() < 0.5:
        written = [np.char.mod("%.9g", c) if c.dtype == "f4" else c.astype(str) for c in columns.values()]
        _write_table(
            place / "events.csv",
            [*columns],
            [list(row) for row in zip(*(w.tolist() for w in written), strict=True)],
            Style(),
        )
        name = "events.csv"
    else:
        names = {f"event_{key}": value for key, value in columns.items() if key != "label"}
        np.savez(place / "events.npz", **names, label=np.array(["rough", "smooth", "rough", "smooth"]))
        name = "events.npz"
    # A clock that the times are on keeps every event; otherwise some fall into one step.
    stays = how == "clock" and kind in ("f8", "i8") and "on" not in options and "--duration-ms" not in options
    holds = {"trials": len(set(trial.tolist()))} | ({"events": n} if stays and "merge" not in options else {})
    return Case("content: events", ["import", "events", name, *options, "-o", "out.h5"], out="out.h5", holds=holds)


def _distinct(noise: np.random.Generator, n: int) -> np.ndarray:
    """Increasing steps, each once, so that no two events of a trial fall into one."""
    return np.sort(noise.choice(max(4 * n, 1), n, replace=False))


def rasters(rng: random.Random, place: Path, base: Path) -> Case:
    """Spikes as arrays or tables of 0 and 1, of any number type: no signal, and nothing but spikes."""
    noise = np.random.default_rng(rng.randrange(2**32))
    shape = rng.choice([4, 8]), rng.choice([50, 300]), rng.choice([1, 6])
    raster = (noise.random(shape) < rng.choice([0.01, 0.1, 0.5])).astype(rng.choice(["?", "u1", "i4", "f4", "f8"]))
    if rng.random() < 0.2:
        raster = raster * np.asarray(rng.choice([2, 255]), raster.dtype if raster.dtype != bool else "u1")
    command = rng.choice(["arrays", "events", "folder"])
    if command == "folder":
        for trial, each in enumerate(raster):
            label = place / "raw" / ("felt", "silk")[trial % 2]
            label.mkdir(parents=True, exist_ok=True)
            np.savez(label / f"{trial}.npz", spikes=each) if rng.random() < 0.5 else np.savetxt(
                label / f"{trial}.csv", each.astype(int), fmt="%d", delimiter=","
            )
        words = ["import", "folder", "raw", "--sampling-rate-Hz", "1000", "--unit", "V", "-o", "out.h5"]
    else:
        np.savez(place / "spikes.npz", X=raster, y=np.arange(len(raster)) % 2)
        rate = ["--sampling-rate-Hz", "1000", "--unit", "V"]
        words = ["import", command, "spikes.npz", *(rate if command == "arrays" else []), "-o", "out.h5"]
    return Case("content: rasters", words, out="out.h5", holds={"trials": len(raster)})


# --- kinds: NWB, foreign files ----------------------------------------------------------------------


def intervals(rng: random.Random, place: Path, base: Path) -> Case:
    """An NWB file whose trials overlap, are empty, unsorted, rounded or beyond the recording."""
    fetch(base, place, "spikes.nwb")
    with h5py.File(place / "spikes.nwb", "r+") as file:
        table = file["intervals/trials"]
        begin, end = table["start_time"][:], table["stop_time"][:]
        n_events = len(file["units/spike_times"])
        how = rng.choice(
            ["overlap", "empty", "reversed", "shuffled", "rounded", "beyond", "nan", "copies", "late", "float32"]
        )
        if how == "overlap":
            end = end + rng.choice([0.001, 0.1, 5.0])
        elif how == "empty":
            end[rng.randrange(len(end))] = begin[0]
        elif how == "reversed":
            begin, end = end, begin
        elif how == "shuffled":
            order = np.random.default_rng(0).permutation(len(begin))
            begin, end = begin[order], end[order]
        elif how == "rounded":
            begin, end = begin.round(rng.choice([1, 2, 3])), end.round(rng.choice([1, 2, 3]))
        elif how == "beyond":
            begin[-1], end[-1] = 1e4, 1e4 + 0.3
        elif how == "nan":
            end[rng.randrange(len(end))] = np.nan
        elif how == "copies":
            begin[1], end[1] = begin[0], end[0]
        elif how == "late":
            begin, end = begin + 1.7e9, end + 1.7e9
            file["units/spike_times"][:] += 1.7e9
        else:
            begin, end = begin.astype("f4"), end.astype("f4")
        table["start_time"][:], table["stop_time"][:] = begin, end
    more = rng.choice([[], [], ["--step-ms", "1"], ["--step-ms", "0.5"], ["--leave-out", "smooth"]])
    holds = {"events": n_events} if how in ("shuffled", "late", "float32") and not more else {}
    return Case("content: NWB", ["import", "nwb", "spikes.nwb", *more, "-o", "out.h5"], out="out.h5", holds=holds)


FOREIGN = {
    "page.html": b"<!doctype html><html><body><h1>404 Not Found</h1></body></html>\n",
    "pointer": b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"4d7a2146" * 8 + b"\nsize 12345\n",
    "notebook": json.dumps({"cells": [], "nbformat": 4}).encode(),
    "object.json": json.dumps({"data": [[1, 2], [3, 4]], "fs": 100}).encode(),
    "lines.json": b'{"t": 0, "v": [1, 2]}\n{"t": 1, "v": [3, 4]}\n',
    "png": b"\x89PNG\r\n\x1a\n" + bytes(200),
    "pdf": b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n",
    "wav": b"RIFF\x24\x08\x00\x00WAVEfmt \x10\x00\x00\x00\x01\x00\x01\x00\x44\xac\x00\x00" + bytes(64),
    "sqlite": b"SQLite format 3\0" + bytes(84),
    "parquet": b"PAR1" + bytes(40) + b"PAR1",
    "pickle": b"\x80\x04\x95\x0c\x00\x00\x00\x00\x00\x00\x00\x8c\x02os\x94\x8c\x06system\x94\x93\x94.",
    "npy": mutations.npy("(4, 2)", "<f8") + bytes(64),
    "matlab5": b"MATLAB 5.0 MAT-file" + b" " * 105 + b"\x00\x01IM",
    "hdf5": b"\x89HDF\r\n\x1a\n" + bytes(100),
    "latex": b"\\begin{tabular}{ll}\n1 & 2 \\\\\n\\end{tabular}\n",
    "markdown": b"| a | b |\n|---|---|\n| 1 | 2 |\n| 3 | 4 |\n",
    "python": b"import numpy as np\nprint(np.zeros(3))\n",
    "shell": b"#!/bin/sh\necho 1,2\n",
    "ds_store": b"\x00\x00\x00\x01Bud1" + bytes(80),
    "nothing": b"",
    "one": b"1\n",
    "words": b"the quick brown fox\njumps over\n",
}  # fmt: skip
"""Files of other programs, by their kind."""


def foreign(rng: random.Random, place: Path, base: Path) -> Case:
    """A file of another program, compressed or under another name, for every command that reads one."""
    kind = rng.choice([*FOREIGN, "xlsx", "gzip", "zip"])
    content = _packed(kind, base) if kind in ("xlsx", "gzip", "zip") else FOREIGN[kind]
    suffix = rng.choice([".csv", ".npz", ".npy", ".mat", ".h5", ".txt", ".nwb", ".xlsx", ".json", ".gz", ".toml", ""])
    command = rng.choice(
        ["folder", "arrays", "table", "events", "nwb", "encode", "train", "info", "stream", "study", "infer"]
    )
    name = f"given{suffix}"
    if command == "folder":
        for label in ("felt", "silk"):
            (place / "raw" / label).mkdir(parents=True)
            (place / "raw" / label / name).write_bytes(content)
        if rng.random() < 0.5:
            fetch(base, place, "csv")
            shutil.copytree(place / "csv", place / "raw", dirs_exist_ok=True)
    else:
        (place / name).write_bytes(content)
    rate = ["--sampling-rate-Hz", "100", "--unit", "V"]
    words = {
        "folder": ["import", "folder", "raw", *rate, "-o", "out.h5"],
        "arrays": ["import", "arrays", name, *rate, "-o", "out.h5"],
        "table": ["import", "table", name, *rate, "-o", "out.h5"],
        "events": ["import", "events", name, "-o", "out.h5"],
        "nwb": ["import", "nwb", name, "-o", "out.h5"],
        "encode": ["encode", name, "-o", "out.h5"],
        "train": ["train", name, *NETWORK, "-o", "out"],
        "info": ["info", name],
        "stream": ["stream", "chain", "--from", name],
        "study": ["study", "run", "own-recordings", "--quick", "--data", name, "-o", "out"],
        "infer": ["infer", name, name],
    }[command]
    if command == "stream":
        fetch(base, place, "chain")
    return Case("foreign files", words, endless=command == "stream", resolve_only=command == "study")


def _packed(kind: str, base: Path) -> bytes:
    table = (base / "table.csv").read_bytes()
    if kind == "gzip":
        return gzip.compress(table, mtime=0)
    stream = mutations.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("xl/workbook.xml" if kind == "xlsx" else "table.csv", table)
        archive.writestr("[Content_Types].xml" if kind == "xlsx" else "b.csv", b"<Types/>")
    return stream.getvalue()


# --- kinds: streams, names, specs -------------------------------------------------------------------


def stream_clocks(rng: random.Random, place: Path, base: Path) -> Case:
    """A table of samples whose clock starts again, wraps, stands, jumps or repeats, into a trained chain."""
    fetch(base, place, "chain")
    noise = np.random.default_rng(rng.randrange(2**32))
    n = rng.choice([200, 600])
    time_s = np.arange(n) * 0.0005
    for _ in range(rng.choice([0, 1, 1, 2])):
        time_s = rng.choice([*STAMPS, *[_with_a_gap, _restarted, _wrapped] * 4])(time_s, rng)
    unit, factor = rng.choice([("s", 1.0), ("ms", 1e3), ("us", 1e6)])
    values = noise.normal(0, 20, (n, 8)).round(2)
    lines = [f"{t * factor:.9g},{','.join(map(str, row))}" for t, row in zip(time_s, values.tolist(), strict=True)]
    if rng.random() < 0.2:
        lines[rng.randrange(n)] = rng.choice(["", ",".join(["nan"] * 9), "# reset", ",".join(["0"] * 9), "x"])
    (place / "samples.csv").write_text("\n".join(lines) + "\n")
    stamps = rng.choice([["--time-column", unit]] * 9 + [[]])
    words = [
        "stream",
        "chain",
        "--from",
        "samples.csv",
        *stamps,
        *rng.choice([[], [], ["--json"], ["--hold-ms", "20"]]),
    ]
    return Case("content: stream clocks", words, endless=True)


def hostile_names(rng: random.Random, place: Path, base: Path) -> Case:
    """Classes, conditions, channels or files with names that break pages, paths and tables."""
    some = rng.sample(HOSTILE, 2)
    if rng.random() < 0.4:
        return _hostile_folder(some, rng, place)
    source = rng.choice(["touch.h5", "spikes.h5"])
    fetch(base, place, source)
    fits = [mutations._encoded(name.replace("\0", "")) for name in some]
    with h5py.File(place / source, "r+") as file:
        for path in [p for p in _texts(file) if rng.random() < 0.7]:
            old = file[path][:]
            known = {
                value: fits[k % 2] + (b"" if k < 2 else b"%d" % k)
                for k, value in enumerate(dict.fromkeys(old.tolist()))
            }
            del file[path]
            file.create_dataset(
                path, data=np.array([known[v] for v in old.tolist()], object), dtype=h5py.string_dtype()
            )
    words = {
        "touch.h5": [["encode", "touch.h5", "-o", "out.h5"], ["calibrate", "touch.h5", "-o", "out.toml"],
                     ["raster", "touch.h5", "-o", "out.png"]],
        "spikes.h5": [["train", "spikes.h5", *NETWORK, "-o", "out"], ["raster", "spikes.h5", "-o", "out.csv"],
                      ["raster", "spikes.h5", "-o", "out.png"], ["raster", "spikes.h5", "-o", "out.nwb"]],
    }[source]  # fmt: skip
    return Case("hostile names", rng.choice([*words, ["info", source, "--all"]]))


def _texts(file: h5py.File) -> list[str]:
    found: list[str] = []
    file.visititems(
        lambda name, node: (
            found.append(name) if isinstance(node, h5py.Dataset) and h5py.check_string_dtype(node.dtype) else None
        )
    )
    return found


def _hostile_folder(names: list[str], rng: random.Random, place: Path) -> Case:
    n = 0
    for name in (*names, "silk"):
        folder = mutations._encoded(name.replace("/", "_").replace("\0", "_"))[:250]
        if folder in (b".", b"..", b""):
            continue
        path = Path(mutations.os.fsdecode(mutations.os.fsencode(place) + b"/raw/" + folder))
        path.mkdir(parents=True, exist_ok=True)
        for trial in range(2):
            np.savetxt(path / f"{trial}.csv", np.random.default_rng(n).normal(size=(30, 2)), delimiter=",")
            n += 1
    words = ["import", "folder", "raw", "--sampling-rate-Hz", "100", "--unit", "V", "-o", "out.h5"]
    return Case("hostile names", words, out="out.h5", holds={"samples": 30 * n})


def own_studies(rng: random.Random, place: Path, base: Path) -> Case:
    """A study of a person's own recordings, its file or its settings changed, read and checked and not run."""
    fetch(base, place, "touch.h5")
    name = rng.choice(["own-recordings", "own-recordings", "ways-to-save", "unknown-conditions"])
    source = cases.spec.find("studies", name)
    (place / "spoilt.toml").write_bytes(
        mutations.spoil_toml(source.read_bytes(), rng) if rng.random() < 0.7 else source.read_bytes()
    )
    words = ["study", "run", "spoilt.toml", "--data", "touch.h5", *rng.choice([[], ["--quick"]])]
    for _ in range(rng.choice([0, 1, 2])):
        key = rng.choice(
            [*cases.KEYS["study run"], "split.group", "split.folds", "window.length_ms", "dataset.where", "sweep.seed"]
        )
        words += ["--set", f"{key}={cases._toml_of(mutations.value(rng))}".replace("\0", "")]
    if rng.random() < 0.3:
        words += rng.choice([["--folds", "3"], ["--group", "force_N"], ["--test-where", "force_N=3"],
                             ["--repeats", "2"], ["--where", "force_N=3"], ["--leave-out", "P0.5"],
                             ["--order", "trial"]])  # fmt: skip
    return Case("own studies", [*words, "-o", "out"], resolve_only=True)


KINDS: dict[cases.Kind, float] = {
    stamped_tables: 14, text_tables: 12, stamped_folders: 12, arrays: 12, stamped_events: 14, rasters: 5, intervals: 6,
    foreign: 9, stream_clocks: 6, hostile_names: 8, own_studies: 6,
}  # fmt: skip
"""As `cases.KINDS`."""
