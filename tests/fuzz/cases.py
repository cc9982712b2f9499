"""What is tried: valid commands on small inputs, and for each kind of input a way to spoil it.

A kind is a function of a generator, a folder of its own and the folder of valid inputs; it returns the case.
"""

import os
import random
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import mutations
import numpy as np
import scipy.io
import typer
from judge import Case

from neurotact import cli, plugins, spec
from neurotact.data.dataset import simulator

ROOT = Path(__file__).parents[2]
TINY = ROOT / "tests" / "studies" / "tiny.toml"
NETWORK = ("--set", "training.epochs=1", "--set", "hidden=4", "--window-ms", "50")
GRATINGS = ("trials=3", "duration_s=0.3", "pitches_mm=[4.0, 0.5]", "forces_N=[3.0, 12.0]", "speeds_mm_per_s=[8.6]")
SIMULATIONS = {
    "gratings": GRATINGS,
    "stiffness": ("placements=1", "grasps=1"),
    "touch-modality": ("people=1", "recording_s=2"),
    "contact-materials": ("trials=1", "frequencies_Hz=[5.0]", "forces_N=[0.2]", "duration_s=0.4"),
    "compliance": ("trials=1",),
}
STUDY = ("--set", "sweep.seed=[0]", "--set", "network.hidden=4", "--set", "network.training.epochs=1", "--workers", "1")
PROTOCOL = ("sweep.protocol=['honest']", "sweep.classifier=['S-ELM']", "sweep.features=['4F']", "parameters.splits=1",
            "parameters.network.draws=1")  # fmt: skip


def _sets(assignments: tuple[str, ...]) -> list[str]:
    return [word for one in assignments for word in ("--set", one)]


COMMANDS: dict[str, tuple[list[str], tuple[str, ...]]] = {
    **{
        f"simulate {name}": (["simulate", name, *_sets(sets), "-o", "out.h5"], ()) for name, sets in SIMULATIONS.items()
    },
    "import folder": (
        ["import", "folder", "csv", "--sampling-rate-Hz", "1000", "--unit", "mV", "-o", "out.h5"],
        ("csv",),
    ),
    "import arrays": (
        ["import", "arrays", "arrays.npz", "--sampling-rate-Hz", "100", "--unit", "V", "-o", "out.h5"],
        ("arrays.npz",),
    ),
    "import table": (["import", "table", "table.csv", "--unit", "V", "-o", "out.h5"], ("table.csv",)),
    "import table --segments": (
        ["import", "table", "session.csv", "--unit", "V", "--segments", "--leave-out", "rest", "-o", "out.h5"],
        ("session.csv",),
    ),
    "import table --annotations": (
        ["import", "table", "session.csv", "--unit", "V", "--annotations", "marks.csv", "-o", "out.h5"],
        ("session.csv", "marks.csv"),
    ),
    "info": (["info", "touch.h5"], ("touch.h5",)),
    "import fabricslide": (["import", "fabricslide", "fabric", "-o", "out.h5"], ("fabric",)),
    "import pvdf-hardness": (["import", "pvdf-hardness", "presses", "-o", "out.h5"], ("presses",)),
    "calibrate": (["calibrate", "touch.h5", "-o", "out.toml"], ("touch.h5",)),
    "encode": (["encode", "touch.h5", "-o", "out.h5"], ("touch.h5",)),
    "raster": (["raster", "spikes.h5", "-o", "out.png"], ("spikes.h5", "touch.h5")),
    "train": (["train", "spikes.h5", *NETWORK, "-o", "out"], ("spikes.h5",)),
    "tune": (["tune", "spikes.h5", "--trials", "2", "--workers", "1", *NETWORK, "-o", "out"], ("spikes.h5",)),
    "infer": (["infer", "net", "spikes.h5", "-o", "out.csv"], ("net", "spikes.h5")),
    "sops": (["sops", "net", "-o", "out.csv"], ("net", "spikes.h5")),
    "study run": (["study", "run", str(TINY), *STUDY, "-o", "out"], ()),
    "study resume": (["study", "resume", "study", "--workers", "1"], ("study",)),
    "study report": (["study", "report", "study"], ("study",)),
    "list": (["list"], ()),
    "show": (["show", "rsnn"], ()),
    "copy": (["copy", "rsnn", "-o", "out.toml"], ()),
}
"""Valid command lines, and what each needs in its folder."""
WORKS_IN = {"study resume": ("study",), "study report": ("study",)}
SLOW = {"study run", "study resume", "study report", "tune"}
ENDLESS = {"stream", "live"}
"""Commands that may go on until Ctrl-C."""


def base_commands() -> list[list[str]]:
    """What makes the folder of valid inputs, one after another."""
    return [
        ["simulate", "gratings", *_sets(GRATINGS), "-o", "touch.h5"],
        ["encode", "touch.h5", "-o", "spikes.h5"],
        ["calibrate", "touch.h5", "-o", "fitted.toml"],
        ["train", "spikes.h5", *NETWORK, "-o", "net"],
        ["tune", "spikes.h5", "--trials", "2", "--workers", "1", *NETWORK, "-o", "search"],
        ["study", "run", str(TINY), *STUDY, "-o", "study"],
        ["study", "run", "stiffness-slfn", *_sets(PROTOCOL), "--workers", "1", "-o", "protocol"],
        ["raster", "spikes.h5", "-o", "raster.png"],
    ]


def make_folders(base: Path) -> None:
    """Recordings in each layout that can be imported."""
    rng = np.random.default_rng(0)
    for label in ("rough", "smooth"):
        for trial in range(2):
            signal = rng.normal(size=(60, 3)).round(3)
            table = "a,b,c\n" + "".join(",".join(map(str, row)) + "\n" for row in signal.tolist())
            _write(base / "csv" / label / f"{trial}.csv", table.encode())
            _write(
                base / "npz" / label / f"{trial}.npz",
                mutations.archive_of({"press": signal.astype("f4"), "lift": signal}),
            )
    header = ", ".join(["timestamp", "proximity1", "proximity2", *(f"channel{i + 1}" for i in range(16))])
    for name in ("Linen_F120_V-50mmps_0.csv", "Linen_F120_V50mmps_1.csv", "Silk_F120_V50mmps_0.csv"):
        rows = "".join(",".join(map(str, [28 * i, 0, 65535, *rng.integers(0, 900, 16)])) + "\n" for i in range(40))
        _write(base / "fabric" / name, f"{header}\n{rows}".encode())
    for cube in (1, 2):
        adc = {f"c0{cube}_s1_v300_t0{t}_adc": rng.integers(0, 60_000, (50, 8)).astype("u2") for t in (1, 2)}
        force = {f"c0{cube}_s1_v300_t01_force": rng.random(52)}
        _write(base / "cubes" / f"cube0{cube}.npz", mutations.archive_of({**adc, **force}))
        for kind, columns in (("Voltage", 8), ("Force", 1)):
            head = "\t".join("abcdefgh"[:columns])
            rows = "".join("\t".join(map(str, row)) + "\n" for row in rng.random((50, columns)).round(4).tolist())
            _write(base / "presses" / f"Hardness_{kind}_Seq1_Sp300_Cube{cube}_t1.lvm", f"{head}\n{rows}".encode())
    make_events(base, rng)
    touched = {"X": rng.normal(size=(6, 40, 3)).astype("f4"), "y": np.arange(6) % 2, "person": np.array([*"aabbcc"])}
    _write(base / "arrays.npz", mutations.archive_of({**touched, "names": np.array(["x", "y", "z"])}))
    samples = "trial,label,t_ms,force,a,b\n" + "".join(
        f"{trial},{'xy'[trial % 2]},{10 * n},{trial % 3},{','.join(map(str, rng.integers(0, 900, 2)))}\n"
        for trial in range(4) for n in range(30)
    )  # fmt: skip
    _write(base / "table.csv", samples.encode())
    session = "label,time_ms,left,right\n" + "".join(
        f"{('rest', 'tap', 'rub')[n // 30 % 3]},{10 * n},{','.join(map(str, rng.integers(0, 900, 2)))}\n"
        for n in range(360)
    )
    _write(base / "session.csv", session.encode())
    marks = "".join(f"{0.3 * n},{0.3 * n + 0.25},{'ab'[n % 2]},{n % 3}\n" for n in range(12))
    _write(base / "marks.csv", f"begin_s,end_s,label,force\n{marks}".encode())
    with h5py.File(base / "arrays.h5", "w") as file:
        for name, array in touched.items():
            file[f"touches/{name}"] = array.astype("S1") if name == "person" else array
    for label in ("rough", "smooth"):
        for speed in ("150", "300"):
            stamps = np.cumsum(rng.normal(10.7, 1.0, 60)).round(2)
            rows = (f"{stamp},{','.join(map(str, rng.integers(0, 900, 5)))},\n" for stamp in stamps)
            _write(base / "stamped" / label / speed / "touch_F3.csv", ("t_ms,a,b,c,d,e,\n" + "".join(rows)).encode())
    row = "\t".join(["1.65"] * 17) + "\n"
    for label in ("brushing", "rolling", "sliding"):
        _write(base / "modality" / label / "1.lvm", (row * 30_000).encode())
    scipy.io.savemat(base / "arrays.mat", touched, do_compression=True)
    for label in ("rough", "smooth"):
        matrices = {"touch": rng.normal(size=(60, 3)), "t_ms": np.cumsum(rng.normal(10.7, 1.0, 60)), "fs": 93.0}
        (base / "matrices" / label).mkdir(parents=True)
        scipy.io.savemat(base / "matrices" / label / "a.mat", matrices)
        _write(base / "matrices" / label / "b.npz", mutations.archive_of({**matrices, "fs": np.array([[93.0]])}))


def make_events(base: Path, rng: np.random.Generator) -> None:
    """Events in each layout that can be imported."""
    n = 80
    trial, time_ms = np.sort(rng.integers(0, 4, n)), rng.integers(0, 300, n)
    channel, polarity = rng.integers(0, 5, n), rng.integers(0, 2, n)
    labels = np.array(["rough", "smooth"])
    rows = zip(trial, labels[trial % 2], time_ms, channel, polarity, strict=True)
    table = "trial,label,time_ms,channel,polarity\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    _write(base / "events.csv", table.encode())
    arrays = {"event_trial": trial, "event_time_ms": time_ms, "event_channel": channel, "event_polarity": polarity}
    _write(base / "events.npz", mutations.archive_of({**arrays, "label": labels[np.arange(4) % 2]}))
    kind = np.dtype([("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "?")])
    for label in labels:
        one = np.zeros(40, kind)
        one["x"], one["t"], one["p"] = (
            rng.integers(0, 4, 40),
            np.sort(rng.integers(0, 90_000, 40)),
            rng.random(40) < 0.5,
        )
        _write(base / "grid" / label / "0.npz", mutations.archive_of({"events": one}))
    with h5py.File(base / "digits.h5", "w") as file:
        times = file.create_dataset("spikes/times", (4,), h5py.vlen_dtype(np.float16))
        units = file.create_dataset("spikes/units", (4,), h5py.vlen_dtype(np.uint16))
        for i in range(4):
            times[i], units[i] = np.sort(rng.random(15)).astype(np.float16), rng.integers(0, 9, 15).astype(np.uint16)
        file["labels"] = np.array([0, 1, 0, 1], np.uint8)
        file["extra/keys"], file["extra/speaker"] = np.array([b"zero", b"one"]), np.arange(4)


ARRAY_OPTIONS = [
    [], [], [], ["--names", "signals=X"], ["--names", "label=person"], ["--names", "label=X"], ["--names", "a=b=c"],
    ["--names", "signals=touches/X"], ["--names", "channels=names,label=y"], ["--axes", "taxel,time,trial"],
]  # fmt: skip
MATRIX_OPTIONS = [
    [], ["--array", "touch"], ["--array", "touch"], ["--array", "t_ms"], ["--array", "fs"], ["--array", "x"],
    ["--array", "touch", "--transpose"],
]  # fmt: skip
EVENT_OPTIONS = [
    [], [], ["--step-ms", "5"], ["--origin", "first"], ["--polarity", "merge"], ["--polarity", "on"],
    ["--duration-ms", "100"], ["--n-channels", "9"], ["--channels", "a,b,c,d,e"], ["--time-unit", "us"],
    ["--sensor", "4x1"], ["--names", "label=trial"], ["--polarities", "a,b,c"], ["--levels", "label"],
    ["--merge-events"], ["--merge-events", "--step-ms", "0.7"], ["--merge-events", "--time-unit", "ns"],
    ["--names", "polarity=channel"],
]  # fmt: skip
LAYOUT_OPTIONS = [
    [], ["--levels", "label,speed"], ["--levels", "speed,label"], ["--levels", "a,b,label"], ["--columns", "2-4"],
    ["--columns", "a,b"], ["--columns", "9"], ["--pattern", "{label}_F{force}.csv"], ["--pattern", "touch_F{force}"],
    ["--time-unit", "us"], ["--max-gap-ms", "15"], ["--decimal", ","], ["--header-lines", "1"], ["--header-lines", "3"],
    ["--sampling-rate-Hz", "50"], ["--sampling-rate-Hz", "1e9"],
]  # fmt: skip


def events(rng: random.Random, place: Path, base: Path) -> Case:
    """Files of events, damaged or not, with any options of their import; a Heidelberg file is also loaded as it is."""
    name = rng.choice(["events.csv", "events.npz", "grid", "digits.h5"])
    fetch(base, place, name)
    if rng.random() < 0.85:
        some = (
            [place / name] if (place / name).is_file() else sorted(p for p in (place / name).rglob("*") if p.is_file())
        )
        mutations.spoil_file(rng.choice(some), rng)
    if name == "digits.h5" and rng.random() < 0.3:
        return Case("events", ["train", name, *NETWORK, "-o", "out"], out="out")
    return Case("events", ["import", "events", name, *rng.choice(EVENT_OPTIONS), "-o", "out.h5"], out="out.h5")


def array_files(rng: random.Random, place: Path, base: Path) -> Case:
    """One file of arrays, damaged or not, with any options of its import."""
    name = rng.choice(["arrays.npz", "arrays.h5", "arrays.mat"])
    fetch(base, place, name)
    if rng.random() < 0.85:
        mutations.spoil_file(place / name, rng)
    words = ["import", "arrays", name, "--sampling-rate-Hz", "100", "--unit", "V", *rng.choice(ARRAY_OPTIONS)]
    return Case("files of arrays", [*words, "-o", "out.h5"], out="out.h5")


def facts(rng: random.Random, place: Path, base: Path) -> Case:
    """What a damaged file holds."""
    name = rng.choice(["touch.h5", "spikes.h5", "digits.h5"])
    fetch(base, place, name)
    mutations.spoil_file(place / name, rng)
    return Case("facts", ["info", name, *rng.choice([[], ["--all"]])])


def layouts(rng: random.Random, place: Path, base: Path) -> Case:
    """A folder with time stamps, of text or arrays, damaged or not, with any options of its import."""
    folder = rng.choice(["stamped", "stamped", "matrices"])
    fetch(base, place, folder)
    if rng.random() < 0.5:
        mutations.spoil_file(rng.choice(sorted(p for p in (place / folder).rglob("*") if p.is_file())), rng)
    elif rng.random() < 0.6:
        mutations.spoil_folder(place / folder, rng)
    kind = LAYOUT_OPTIONS if folder == "stamped" else MATRIX_OPTIONS
    words = [*rng.choice(kind), *rng.choice(LAYOUT_OPTIONS)]
    stamps = ["--time-column", rng.choice(["t_ms", "t_ms", "t_ms", "1", "a", "7", ""]), "--time-unit", "ms"]
    return Case(
        "layouts", ["import", "folder", folder, "--unit", "count", *stamps, *words, "-o", "out.h5"], out="out.h5"
    )


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def fetch(base: Path, place: Path, *names: str) -> None:
    """Copy valid inputs into a case's folder."""
    for name in names:
        if (base / name).is_dir():
            shutil.copytree(base / name, place / name)
        else:
            shutil.copy(base / name, place / name)


# --- the kinds --------------------------------------------------------------------------------------

Kind = Callable[[random.Random, Path, Path], Case]


def options(rng: random.Random, place: Path, base: Path) -> Case:
    """A valid command whose options or arguments are changed, left out or added."""
    name = _any_command(rng)
    words, needs = COMMANDS[name]
    words = list(words)
    fetch(base, place, *needs)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        _change_words(words, OPTIONS[name.partition(" --")[0]], rng, place)
    endless = name in ENDLESS
    return Case(f"options of {name.split()[0]}", words, changes=WORKS_IN.get(name, ()), endless=endless)


def _any_command(rng: random.Random) -> str:
    names = list(COMMANDS)
    return rng.choices(names, [1 if name in SLOW else 4 for name in names])[0]


def _change_words(words: list[str], known: list[tuple[str, bool]], rng: random.Random, place: Path) -> None:
    how = rng.choices(["value", "option", "path", "drop", "unknown"], [5, 5, 3, 1, 1])[0]
    option, is_flag = rng.choice(known or [("--help", True)])
    if not words:  # changes before this one dropped them
        words.append(option)
    elif how == "value":
        words[rng.randrange(1, len(words)) if len(words) > 1 else 0] = mutations.text(rng)
    elif how == "option":
        words += [option] if is_flag else [option, _number(rng) if rng.random() < 0.6 else mutations.text(rng)]
    elif how == "path":
        words[rng.randrange(len(words))] = odd_path(rng, place)
    elif how == "drop":
        del words[rng.randrange(len(words))]
    else:
        words.insert(
            rng.randrange(len(words) + 1), rng.choice(["--", "-", "--help", "--versoin", "-o", "--set", "x", "-\udcff"])
        )


def _number(rng: random.Random) -> str:
    return str(
        rng.choice(
            [0, -1, 1, 2, 3, 1e-9, 1e9, 1e300, "nan", "inf", 2**31, 2**32, 2**63, 10**30, 0.999, 1.0, "1e5", "007"]
        )
    )


def odd_path(rng: random.Random, place: Path) -> str:
    """A path to something that is not a fitting file, or to nothing."""
    how = rng.choice(["fifo", "zero", "sparse", "folder", "loop", "words", "words", "null", "long", "inside", "closed"])
    made = place / f"odd-{how}"
    if how == "fifo" and not made.exists():
        os.mkfifo(made)
    elif how == "zero" and not made.is_symlink():
        made.symlink_to("/dev/zero")
    elif how == "loop" and not made.is_symlink():
        made.symlink_to(made.name)
    elif how == "sparse":
        made.touch()
        os.truncate(made, mutations.HUGE)
    elif how == "folder":
        made.mkdir(exist_ok=True)
    elif how == "closed":
        made.mkdir(exist_ok=True)
        made.chmod(0)
        return rng.choice([made.name, f"{made.name}/x.h5", f"{made.name}/x/y.toml"])
    elif how == "words":
        return rng.choice(
            [
                "absent.h5",
                "absent/absent.h5",
                "spikes.h5",
                "touch.h5",
                "net",
                "ø.h5",
                "\udcff.h5",
                "a\nb.png",
                ".",
                "csv",
            ]
        )
    elif how == "inside":
        return rng.choice(["touch.h5/x", "out.h5/x.h5", "x" * 250 + ".h5", "x" * 300, "x" * 5000])
    return {"null": "/dev/null", "long": "x/" * 3000}.get(how, made.name)


def sets(rng: random.Random, place: Path, base: Path) -> Case:
    """`--set KEY=VALUE` on a valid command: a key of its spec or none, a value that fits or not."""
    name = rng.choices(list(KEYS), [1 if n in SLOW else 4 for n in KEYS])[0]
    words, needs = COMMANDS[name]
    words = list(words)
    fetch(base, place, *needs)
    for _ in range(rng.choice([1, 1, 2])):
        key = rng.choice(KEYS[name])
        if rng.random() < 0.2:
            key = rng.choice(
                ["", ".", "a..b", f"{key}.x", key.split(".")[0], "__class__", "x" * 3000, ".".join("a" * 2000), "model"]
            )
        value = mutations.text(rng) if rng.random() < 0.5 else _toml_of(mutations.value(rng))
        words += ["--set", f"{key}={value}".replace("\0", "")]
    return Case(f"--set of {name.split()[0]}", words, changes=WORKS_IN.get(name, ()))


def _toml_of(value: Any) -> str:
    return mutations.to_toml({"v": value}).partition(" = ")[2].strip()


def encoder(rng: random.Random, place: Path, base: Path) -> Case:
    source = rng.choice([*spec.shipped("encoders"), base / "fitted.toml"])
    fetch(base, place, "touch.h5")
    _spoilt_spec(source, place / "spoilt.toml", rng)
    words = rng.choice([["encode", "touch.h5", "-o", "out.h5"]] * 3 + [["calibrate", "touch.h5", "-o", "out.toml"]])
    return Case("encoder specs", [*words, "--encoder", "spoilt.toml"], out=words[3])


def network(rng: random.Random, place: Path, base: Path) -> Case:
    fetch(base, place, "spikes.h5")
    _spoilt_spec(rng.choice(spec.shipped("networks")), place / "spoilt.toml", rng)
    quick = _sets(("training.epochs=1",)) if rng.random() < 0.9 else []
    return Case(
        "network specs",
        ["train", "spikes.h5", "--network", "spoilt.toml", *quick, "--window-ms", "50", "-o", "out"],
        out="out",
    )


def space(rng: random.Random, place: Path, base: Path) -> Case:
    fetch(base, place, "spikes.h5")
    _spoilt_spec(rng.choice(spec.shipped("networks/spaces")), place / "spoilt.toml", rng)
    words = ["tune", "spikes.h5", "--space", "spoilt.toml", "--trials", "2", "--workers", "1", *NETWORK, "-o", "out"]
    return Case("search spaces", words, out="out")


def study_spec(rng: random.Random, place: Path, base: Path) -> Case:
    """A shipped study, which is read and checked; run it would take minutes."""
    _spoilt_spec(rng.choice(spec.shipped("studies")), place / "spoilt.toml", rng)
    quick = ["--quick"] if rng.random() < 0.3 else []
    return Case("study specs", ["study", "run", "spoilt.toml", *quick, "-o", "out"], resolve_only=True)


def tiny_study(rng: random.Random, place: Path, base: Path) -> Case:
    """A small study that is run where it is valid."""
    _spoilt_spec(TINY, place / "spoilt.toml", rng)
    words = ["study", "run", "spoilt.toml", *STUDY, "-o", "out"]
    return Case("studies run", words, out="out", resolve_only=_simulates_all(place / "spoilt.toml"))


def _simulates_all(study: Path) -> bool:
    """Whether a study lost the small numbers of its simulation: as it ships that takes minutes."""
    try:
        dataset = tomllib.loads(study.read_text())["dataset"]
        return "simulate" in dataset and not {"trials", "duration_s"} <= dataset.get("parameters", {}).keys()
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return False


def _spoilt_spec(source: Path, target: Path, rng: random.Random) -> None:
    target.write_bytes(mutations.spoil_toml(source.read_bytes(), rng))


def recordings(rng: random.Random, place: Path, base: Path) -> Case:
    fetch(base, place, "touch.h5", "spikes.h5")
    mutations.spoil_file(place / "touch.h5", rng)
    words = rng.choice(
        [["encode", "touch.h5", "-o", "out.h5"]] * 3
        + [["encode", "touch.h5", "--encoder", "poisson", "-o", "out.h5"], ["calibrate", "touch.h5", "-o", "out.toml"]]
        + [["raster", "spikes.h5", "--recordings", "touch.h5", "-o", "out.png"]]
    )
    return Case("recordings", words, out=words[-1])


def spikes(rng: random.Random, place: Path, base: Path) -> Case:
    fetch(base, place, "spikes.h5", "touch.h5", "net")
    mutations.spoil_file(place / "spikes.h5", rng)
    words = rng.choice(
        [["raster", "spikes.h5", "-o", f"out{suffix}"] for suffix in (".csv", ".csv", ".png")]
        + [["train", "spikes.h5", *NETWORK, "-o", "out"]] * 3
        + [["train", "spikes.h5", *NETWORK, "--stratify", "force_N", "-o", "out"]]
        + [["infer", "net", "spikes.h5", "-o", "out.csv"], ["sops", "net", "-o", "out.csv"]]
    )
    return Case("spikes", words, out=words[-1])


def archives(rng: random.Random, place: Path, base: Path) -> Case:
    layout = rng.choice(["npz", "cubes"])
    fetch(base, place, layout)
    mutations.spoil_file(rng.choice(sorted((place / layout).rglob("*.npz"))), rng)
    return Case("NumPy archives", _import(layout), out="out.h5")


def tables(rng: random.Random, place: Path, base: Path) -> Case:
    layout = rng.choices(["csv", "fabric", "presses", "modality"], [4, 3, 3, 1])[0]
    fetch(base, place, layout)
    mutations.spoil_file(rng.choice(sorted(path for path in (place / layout).rglob("*") if path.is_file())), rng)
    return Case("tables", _import(layout), out="out.h5")


def sample_tables(rng: random.Random, place: Path, base: Path) -> Case:
    words, inputs = COMMANDS[rng.choice([name for name in COMMANDS if name.startswith("import table")])]
    fetch(base, place, *inputs)
    mutations.spoil_file(place / rng.choice(inputs), rng)
    return Case("sample tables", list(words), out="out.h5")


def folders(rng: random.Random, place: Path, base: Path) -> Case:
    layout = rng.choices(["csv", "npz", "fabric", "presses", "cubes", "modality"], [5, 3, 2, 3, 2, 1])[0]
    fetch(base, place, layout)
    for _ in range(rng.choice([1, 1, 2])):
        mutations.spoil_folder(place / layout, rng)
    return Case("folders", _import(layout))


def _import(layout: str) -> list[str]:
    reader = {
        "fabric": "fabricslide",
        "presses": "pvdf-hardness",
        "cubes": "pvdf-hardness",
        "modality": "touch-modality",
    }
    extra = [] if layout in reader else ["--sampling-rate-Hz", "1000", "--unit", "mV"]
    return ["import", reader.get(layout, "folder"), layout, *extra, "-o", "out.h5"]


def checkpoint(rng: random.Random, place: Path, base: Path) -> Case:
    fetch(base, place, "net", "spikes.h5")
    mutations.spoil_file(rng.choice(sorted((place / "net").iterdir())), rng)
    early = ["--early-exit"] if rng.random() < 0.4 else []
    words = rng.choice([["infer", "net", "spikes.h5", *early], ["sops", "net", *early, "-o", "out.csv"]])
    return Case("checkpoints", words)


def run_folder(rng: random.Random, place: Path, base: Path) -> Case:
    """A study's folder with one file damaged: resuming refuses, or gives the very results."""
    name = rng.choices(["study", "protocol"], [4, 1])[0]
    fetch(base, place, name)
    command = rng.choice(["resume", "report"])
    left = sorted(path for path in (place / name).rglob("*") if path.is_file() and path.parent.name != "figures")
    decisive = [
        path
        for path in left
        if path.name in ("result.json", "study.toml", "data.json") or path.suffix in (".h5", ".npz")
    ]
    chosen = rng.choice(decisive if rng.random() < 0.5 else left)
    if rng.random() < 0.85:
        mutations.spoil_file(chosen, rng)
    elif rng.random() < 0.5:
        mutations.spoil_folder(place / name, rng)
    else:
        _read_only(place / name)
    expected = (f"{name}/results.csv", (base / name / "results.csv").read_bytes())
    told = command == "resume" and chosen.name not in ("study.toml", "results.csv")
    workers = ["--workers", "1"] if command == "resume" else []
    return Case("run folders", ["study", command, name, *workers], changes=(name,), results=expected if told else None)


def journal(rng: random.Random, place: Path, base: Path) -> Case:
    fetch(base, place, "spikes.h5", "search")
    mutations.spoil_file(place / "search" / rng.choice(["journal.jsonl", "journal.jsonl", "search.json"]), rng)
    return Case(
        "search journals",
        ["tune", "spikes.h5", "--trials", "2", "--workers", "1", *NETWORK, "-o", "search"],
        changes=("search",),
    )


def names(rng: random.Random, place: Path, base: Path) -> Case:
    (place / "given.toml").write_bytes(mutations.spoil_bytes(spec.shipped("networks")[0].read_bytes(), rng))
    if rng.random() < 0.3:
        mutations.replace_file(place / "given.toml", rng)
    given = rng.choice(["given.toml", "./given.toml", "rsnn", odd_path(rng, place), mutations.text(rng)])
    return Case(
        "names of specs",
        rng.choice([["show", given], ["copy", given], ["copy", given, "-o", "out.toml"], ["list", given]]),
    )


def paths(rng: random.Random, place: Path, base: Path) -> Case:
    """A valid command with what is not a fitting file, or cannot be reached, in place of one of its paths."""
    name = _any_command(rng)
    words, needs = list(COMMANDS[name][0]), COMMANDS[name][1]
    fetch(base, place, *needs)
    after = [k + 1 for k, word in enumerate(words[:-1]) if word in ("-o", "--from", "--annotations")]
    named = sorted({k for k, word in enumerate(words) if word in needs or word.endswith(".toml")} | {*after})
    if rng.random() < 0.3:
        words += [rng.choice(["--encoder", "--network", "--space", "--data", "--conditions", "--recordings"]), "x"]
        named.append(len(words) - 1)
    words[rng.choice(named or [-1])] = odd_path(rng, place)
    return Case("paths", words, changes=WORKS_IN.get(name, ()), endless=name in ENDLESS)


def outputs(rng: random.Random, place: Path, base: Path) -> Case:
    """An output that exists, that is an input, or that cannot be written."""
    name = rng.choice([n for n, (words, _) in COMMANDS.items() if "-o" in words and n not in SLOW])
    words, needs = COMMANDS[name]
    fetch(base, place, *needs)
    how = rng.choice(["there", "input", "link", "folder", "readonly", "absent", "odd"])
    target = words[words.index("-o") + 1]
    given = [need for need in needs if (place / need).exists()]
    if how == "there":
        (place / target).write_bytes(b"mine")
    elif how == "input" and given:
        target = rng.choice(given)
    elif how == "link" and given:
        (place / target).symlink_to(given[0])
    elif how == "folder":
        (place / target).mkdir()
        (place / target / "mine").write_bytes(b"mine")
    elif how == "readonly":
        (place / "locked").mkdir()
        target = f"locked/{target}"
        _read_only(place)
    elif how == "absent":
        target = f"a/b/{target}"
    else:
        target = odd_path(rng, place)
    words = [*words[: words.index("-o") + 1], target, *words[words.index("-o") + 2 :]]
    return Case("outputs", words, out=target)


def _read_only(folder: Path) -> None:
    for path in [folder, *folder.rglob("*")]:
        if not path.is_symlink():
            path.chmod(0o555 if path.is_dir() else 0o444)


KINDS: dict[Kind, float] = {
    options: 16, sets: 9, encoder: 6, network: 5, space: 2, study_spec: 10, tiny_study: 1.5, recordings: 11, spikes: 11,
    events: 8, array_files: 5, facts: 4, layouts: 6, archives: 6, tables: 9, sample_tables: 4, folders: 8,
    checkpoint: 8, run_folder: 5, journal: 1.5, names: 4, outputs: 5, paths: 5,
}  # fmt: skip
"""Each kind and its share."""


def draw(seed: int, number: int, place: Path, base: Path) -> Case:
    """Case `number` of a seed, its inputs written into `place`."""
    rng = random.Random(f"{seed}/{number}")
    np.random.seed(rng.randrange(2**32))  # noqa: NPY002 - of libraries that ask no generator
    kind = rng.choices(list(KINDS), list(KINDS.values()))[0]
    return kind(rng, place, base)


# --- what the command line offers -------------------------------------------------------------------


def _commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, command in getattr(group, "commands", {}).items():
        if hasattr(command, "commands"):
            yield from _commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


def _options() -> dict[str, list[tuple[str, bool]]]:
    """Every option of every command, and whether it is a flag: new ones are tried without a word here."""
    found = {}
    for name, command in _commands(typer.main.get_command(cli.app)):
        found[name] = [
            (option, bool(getattr(one, "is_flag", False)))
            for one in command.params
            if one.param_type_name == "option"
            for option in one.opts[:1]
        ]
    return found


def _keys_of(table: dict[str, Any], before: str = "") -> list[str]:
    found = []
    for key, value in table.items():
        found.append(f"{before}{key}")
        if isinstance(value, dict):
            found += _keys_of(value, f"{before}{key}.")
    return found


def _keys() -> dict[str, list[str]]:
    """The keys that `--set` may name, by command."""
    afferents, net, study = (
        _keys_of(spec.read(path))
        for path in (spec.find("encoders", "fabric-sa1-ra1-lif"), spec.find("networks", "rsnn"), TINY)
    )
    simulated = {
        f"simulate {name}": _keys_of(simulator(name).model().model_dump(mode="json"))
        for name in plugins.names("simulators")
    }
    known = {"encode": afferents, "calibrate": afferents, "train": net, "tune": net}
    parts = [*(f"encoder.{key}" for key in afferents), *(f"network.{key}" for key in net), *study]
    return {**simulated, **known, "study run": parts}


OPTIONS = _options()
KEYS = _keys()
