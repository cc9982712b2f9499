"""Cases of a trained chain and of what it is read from: fine-tune, stream, live and export, and files of NWB.

A kind is as in `cases`. The chain is causal, as a stream needs it.
"""

import random
from pathlib import Path

import cases
import h5py
import mutations
from cases import NETWORK, fetch
from judge import Case

CAUSAL = ("--set", "conditioning.baseline=start")
SAMPLES = 400
"""Rows of a table of samples, more than a window."""
FINE_TUNED = ("fine-tune", "chain", "--epochs", "1", "-o", "out")
COMMANDS: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "fine-tune": ([*FINE_TUNED], ("chain", "causal.h5")),
    "stream": (["stream", "chain", "--from", "samples.csv", "--time-column", "ms"], ("chain", "samples.csv")),
    "live": (["live", "chain", "--from", "touch.h5"], ("chain", "touch.h5")),
    "export": (["export", "chain", "--to", "c", "-o", "out"], ("chain", "causal.h5", "touch.h5")),
    "import nwb": (["import", "nwb", "spikes.nwb", "-o", "out.h5"], ("spikes.nwb",)),
}
"""As `cases.COMMANDS`."""
STREAM_OPTIONS = [
    [], [], ["--json"], ["--full-window"], ["--contact"], ["--contact", "--quiet-ms", "0"], ["--hop-ms", "5"],
    ["--window-ms", "1"], ["--window-ms", "1e9"], ["--hold-ms", "0"], ["--hold-ms", "1e12"], ["--start-ms", "20"],
    ["--unit", "V"], ["--unit", "N"], ["--sampling-rate-Hz", "500"], ["--format", "int16"], ["--format", "float32"],
    ["--format", "int16", "--lsb", "1e-20"], ["--time-column", "s"], ["--time-column", "ms"], ["--stall-s", "0.01"],
]  # fmt: skip
EXPORT_OPTIONS = [
    [], ["--variant", "float"], ["--weight-bits", "2"], ["--weight-bits", "9"], ["--state-bits", "8"],
    ["--state-bits", "24"], ["--lsb", "1e-9"], ["--lsb", "1e9"], ["--name", "a b"], ["--name", "int"], ["--contact"],
    ["--full-window"], ["--window-ms", "1e7"], ["--hop-ms", "1"], ["--sampling-rate-Hz", "500"],
]  # fmt: skip
NIR_OPTIONS = [[], ["--plain"], ["--lower-refractory"], ["--network-only"], ["--dt-s", "1e-4"], ["--dt-s", "0"]]
NWB_OPTIONS = [
    [], [], ["--trials", "units"], ["--trials", "epochs"], ["--label", "force_N"], ["--label", "id"],
    ["--step-ms", "5"], ["--step-ms", "1e-9"], ["--step-ms", "1e9"], ["--name", "spike_times"],
    ["--series", "touch"], ["--unit", "mV"],
]  # fmt: skip


def base_commands() -> list[list[str]]:
    """As `cases.base_commands`, which run before."""
    return [
        ["encode", "touch.h5", *CAUSAL, "-o", "causal.h5"],
        ["train", "causal.h5", *NETWORK, "--set", "step_ms=encoder", "--set", "readout_stretches=1", "-o", "chain"],
        ["raster", "spikes.h5", "-o", "spikes.nwb"],
        *(words for words, _ in (COMMANDS["fine-tune"], COMMANDS["stream"], COMMANDS["export"])),
        ["export", "chain", "--to", "nir", "-o", "out.nir"],
        ["import", "nwb", "spikes.nwb", "-o", "nwb.h5"],
    ]


def make_samples(base: Path) -> None:
    """A table of samples as a device sends them, and the same as numbers of 16 bits: of the first touch."""
    rng = random.Random(0)
    rows = [[round(rng.gauss(0, 20), 2) for _ in range(8)] for _ in range(SAMPLES)]
    lines = (f"{step * 0.5},{','.join(map(str, row))}\n" for step, row in enumerate(rows))
    (base / "samples.csv").write_text("".join(lines))
    whole = (int(value).to_bytes(2, "little", signed=True) for row in rows for value in row)
    (base / "samples.bin").write_bytes(b"".join(whole))


def fine_tuning(rng: random.Random, place: Path, base: Path) -> Case:
    """A network or its spikes, damaged, or odd numbers of bits and epochs."""
    fetch(base, place, "chain", "causal.h5")
    words = [*FINE_TUNED]
    if rng.random() < 0.6:
        mutations.spoil_file(rng.choice([*sorted((place / "chain").iterdir()), place / "causal.h5"]), rng)
    else:
        words += rng.choice(
            [["--weight-bits", "1"], ["--weight-bits", "2"], ["--state-bits", "9"], ["--state-bits", "17"],
             ["--epochs", "0"], ["--seed", str(2**32)], ["--seed", "3", "--json"], ["--weight-bits", "99"]]
        )  # fmt: skip
    return Case("fine-tune", words, out="out")


def streams(rng: random.Random, place: Path, base: Path) -> Case:
    """Samples from a table, raw numbers or recordings, damaged or not, into a chain, damaged or not."""
    source = rng.choice(["samples.csv", "samples.csv", "samples.bin", "touch.h5"])
    fetch(base, place, "chain", source)
    words = ["stream", "chain", "--from", source, *rng.choice(STREAM_OPTIONS), *rng.choice(STREAM_OPTIONS)]
    if source == "samples.bin":
        words += ["--format", rng.choice(["int16", "int16", "float32", "csv"])]
    elif source == "samples.csv" and rng.random() < 0.8:
        words += ["--time-column", "ms"]
    _spoil_one(rng, place, source)
    return Case("stream", words, endless=True)


def live(rng: random.Random, place: Path, base: Path) -> Case:
    """The same on a page, which Ctrl-C ends; or a simulated finger whose spec is changed."""
    source = rng.choice(["touch.h5", "touch.h5", "samples.csv", "gratings", "-"])
    fetch(base, place, "chain", *([source] if (base / source).is_file() else []))
    some = [
        [], ["--speed", "5"], ["--speed", "0"], ["--loop"], ["--port", "1"], ["--port", "99999"],
        ["--save-to", "saved"], ["--save-to", "chain/network.json"], ["--set", "trials=0"],
        ["--set", f"duration_s={mutations.text(rng)[:40]}"],
        ["--set", "rate=1"],
    ]  # fmt: skip
    words = ["live", "chain", "--from", source, *rng.choice(some), *rng.choice(STREAM_OPTIONS)]
    _spoil_one(rng, place, source)
    return Case("live", [word.replace("\0", "") for word in words if word != "--json"], endless=True)


def exports(rng: random.Random, place: Path, base: Path) -> Case:
    """C or NIR of a chain, damaged or not, with any of their options; or a check against a chip."""
    fetch(base, place, "chain", "causal.h5", "touch.h5")
    kind = rng.choices(["c", "nir", "check"], [5, 3, 2])[0]
    if kind == "check":
        chip = rng.choice(["xyloaudio2", "xyloaudio2", "loihi2", "spinnaker2", "loihi"])
        words, out = ["export", "chain", "--check", chip], None
    else:
        some = EXPORT_OPTIONS if kind == "c" else NIR_OPTIONS
        out = "out" if kind == "c" else "out.nir"
        words = ["export", "chain", "--to", kind, *rng.choice(some), *rng.choice(some), "-o", out]
    _spoil_one(rng, place, rng.choice(["touch.h5", "causal.h5"]))
    return Case("export", words, out=out)


def nwb(rng: random.Random, place: Path, base: Path) -> Case:
    """A file of NWB whose tables, series or bytes are damaged, with any options of its import."""
    fetch(base, place, "spikes.nwb")
    if rng.random() < 0.8:
        mutations.spoil_file(place / "spikes.nwb", rng)
    elif rng.random() < 0.5:
        _lose_a_column(place / "spikes.nwb", rng)
    words = ["import", "nwb", "spikes.nwb", *rng.choice(NWB_OPTIONS), *rng.choice(NWB_OPTIONS), "-o", "out.h5"]
    return Case("NWB", words, out="out.h5")


def _lose_a_column(path: Path, rng: random.Random) -> None:
    """Take a column, or its description, off one of the tables."""
    with h5py.File(path, "r+") as file:
        table = rng.choice([file["intervals/trials"], file["units"]])
        name = rng.choice([*table, *table.attrs])
        if name in table:
            del table[name]
        else:
            del table.attrs[name]


def _spoil_one(rng: random.Random, place: Path, source: str) -> None:
    """Damage a file of the chain, or what it reads, or nothing."""
    some = sorted((place / "chain").iterdir())
    how = rng.random()
    if how < 0.3:
        mutations.spoil_file(rng.choice(some), rng)
    elif how < 0.65 and (place / source).is_file():
        mutations.spoil_file(place / source, rng)


KINDS: dict[cases.Kind, float] = {fine_tuning: 3, streams: 6, live: 3, exports: 5, nwb: 5}
"""As `cases.KINDS`."""
