"""Every option of every command, and every keyword of Python's front door, has an effect or is refused.

A way is a command on small inputs. For each option the table holds words that change what it prints or writes (files
that only hold the settings do not count), or words that are refused: exit code 2, and one line that names the option.
"""

import ast
import inspect
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import made_inputs
import numpy as np
import pandas as pd
import pytest
import torch
from typer.main import get_group

import neurotact as nt
from neurotact import cli
from neurotact.api import encoding
from neurotact.cli import words
from neurotact.cli.options import arguments, fields_of, name_of
from neurotact.networks.definition.specs import given_keys
from neurotact.networks.training import tasks
from neurotact.spec import specs_of
from neurotact.studies import loading, study

ROOT = Path(__file__).parents[1]
PACKAGE = Path(nt.__file__).parent
SETTINGS = ("train.toml", "search.json", "study.toml", "best.toml")
TIMES = re.compile(r"\d+(\.\d+)? s\b")
TWICE = "twice"
"""Of an option that replaces outputs: given the second time."""


class Way(NamedTuple):
    """A command, and for each of its options words that change the outcome, or that are refused.

    changes: `a | b` means a beside b; `! a` means that the command then fails on its input. tested: the test that shows
    the effect of an option, for those which need more than small inputs.
    """

    words: str
    changes: dict[str, str] = {}
    refused: dict[str, str] = {}
    tested: dict[str, str] = {}
    is_slow: bool = False


CHOICE = {"--where": "--where label=felt", "--leave-out": "--leave-out felt"}
WRITTEN = {"-o": "-o other.h5", "--force": TWICE}
TRAIN = "train in/spikes.h5 -o t --network rsnn --set hidden=3 --set training.epochs=1"
ONE = "--window-ms 40 --start-ms 80"
CURVE = "--network --set --window-ms --align --where --leave-out --augmentation --seed -o --figure --force"
NETWORK = {
    "--set": "--set hidden=5",
    "--window-ms": "--window-ms 50",
    "--start-ms": "--start-ms 90",
    "--hop-ms": "--hop-ms 20",
    "--per-trial": "--per-trial 1",
    "--align": "--align onset",
    "--rest-ms": "--rest-ms 20 | --align onset",
    "--onset-deviations": "--onset-deviations 60 | --align onset",
    "--where": "--where speed=300",
    "--leave-out": "--leave-out speed=300",
    "--test-where": "--test-where speed=450",
    "--group": "--group day",
    "--order": "--order trial",
    "--folds": "--folds 2 --fold 0",
    "--fold": "--fold 1 | --folds 2",
    "--stratify": "--stratify speed",
    "--split-seed": "--split-seed 3",
    "--exit-tolerance": "--exit-tolerance 0.9",
    "--json": "--json",
}
NO_NETWORK = {
    "--rest-ms": "--rest-ms 50",
    "--onset-deviations": "--onset-deviations 3",
    "--fold": "--fold 0",
    "--split-seed": "--split-seed 0 --order trial",
    "--stratify": "--stratify speed --test-where day=0",
    "--set": "--set model=snn --set recurrent_weight_scale=0.1",
}
STREAM = {
    "--unit": "--unit V",
    "--window-ms": "--window-ms 30",
    "--start-ms": "--start-ms 100",
    "--hop-ms": "--hop-ms 25",
    "--contact": "--contact",
    "--quiet-ms": "--quiet-ms 2 | --contact",
}
EXITS = {"--full-window": "tests/stream/test_stream_cli.py"}
"""Early exit needs more validation trials than these inputs have."""
FRAMES = {
    "--format": "--format csv",
    "--baud": "--baud 115200",
    "--sampling-rate-Hz": "--sampling-rate-Hz 1000",
    "--time-column": "--time-column ms",
    "--lsb": "--lsb 1",
    "--zero": "--zero 0",
    "--stall-s": "--stall-s 1",
}
OF_C = {
    "--variant": "--variant integer",
    "--weight-bits": "--weight-bits 8",
    "--state-bits": "--state-bits 16",
    "--lsb": "--lsb 0.01",
    "--name": "--name touch",
    "--new-classes": "--new-classes 1",
    "--sampling-rate-Hz": "--sampling-rate-Hz 1000",
    "--window-ms": "--window-ms 50",
    "--start-ms": "--start-ms 80",
    "--hop-ms": "--hop-ms 50",
    "--contact": "--contact",
    "--quiet-ms": "--quiet-ms 50",
    "--full-window": "--full-window",
    "--recordings": "--recordings in/touch.h5",
    "--spikes": "--spikes in/spikes.h5",
}
OF_NIR = {
    "--plain": "--plain",
    "--lower-refractory": "--lower-refractory",
    "--network-only": "--network-only",
    "--dt-s": "--dt-s 0.001",
}
MOVED = "tests/data/test_encoded_from.py"
STUDY = "tests/studies/test_interrupted.py"
BUNDLE = "tests/of_studies/publishing/test_bundle.py"
TARGETS = "tests/of_studies/targets/test_studies_of_targets.py"
SPLITS = "tests/of_studies/comparison/test_own_set.py"
WINDOW, SPLIT = fields_of("window", nt.Window, in_python=True), fields_of("split", nt.Split, in_python=True)
LAYOUT = fields_of("layout", nt.Layout)
"""The fields of windows, of splits and of layouts, by their paths."""

WAYS = {
    "list": [Way("list")],
    "show": [Way("show rsnn")],
    "copy": [Way("copy rsnn", {"-o": "-o mine.toml", "--force": TWICE})],
    "simulate gratings": [
        Way("simulate gratings -o a.h5 --set trials=1 --set duration_s=0.2", WRITTEN | {"--set": "--set seed=7"})
    ],
    "fetch": [Way("fetch", refused={"-o": "-o x"}, tested={"-o": "tests/data/test_fetch.py"})],
    "import folder": [
        Way(
            "import folder in/csv --unit mV -o a.h5",
            WRITTEN
            | CHOICE
            | {
                "--unit": "--unit V",
                "--sampling-rate-Hz": "--sampling-rate-Hz 500",
                "--levels": "--levels cloth | --pattern {label}_{number}.csv",
                "--pattern": "--pattern {label}_{number}.csv",
                "--conditions": "--conditions in/conditions.csv",
                "--label": "--label number | --pattern {speed}_{number}.csv",
                "--columns": "--columns p1",
                "--time-column": "--time-column t_ms | --sampling-rate-Hz 500 --columns p1,p2",
                "--time-unit": "--time-unit s",
                "--max-gap-ms": "! --max-gap-ms 0.5",
                "--decimal": "! --decimal ,",
                "--missing": "! --missing interpolate",
                "--header-lines": "! --header-lines 2",
            },
            {"--array": "--array p1", "--transpose": "--transpose"},
            {"--drop-repeats": "tests/data/readers/test_layouts.py"},
        ),
        Way(
            "import folder in/npz --unit mV --sampling-rate-Hz 1000 -o a.h5",
            {"--array": "--array pressure", "--transpose": "--transpose"},
            {
                "--columns": "--columns 1",
                "--decimal": "--decimal ,",
                "--header-lines": "--header-lines 1",
                "--time-unit": "--time-unit ms",
                "--max-gap-ms": "--max-gap-ms 5",
                "--drop-repeats": "--drop-repeats",
            },
        ),
    ],
    "import table": [
        Way(
            "import table in/table.csv --unit mV -o a.h5",
            WRITTEN
            | CHOICE
            | {
                "--unit": "--unit V",
                "--sampling-rate-Hz": "--sampling-rate-Hz 500",
                "--label": "--label gesture",
                "--trial": "--trial turn",
                "--columns": "--columns p1",
                "--time-column": "--time-column t_ms | --sampling-rate-Hz 500 --columns p1,p2",
                "--time-unit": "--time-unit s",
                "--max-gap-ms": "! --max-gap-ms 0.5",
                "--decimal": "! --decimal ,",
                "--missing": "! --missing interpolate",
                "--header-lines": "! --header-lines 2",
            },
            tested={"--drop-repeats": "tests/data/readers/test_layouts.py"},
        ),
        Way("import table in/continuous.csv --unit mV --segments -o a.h5", {"--columns": "--columns p1"}),
        Way("import table in/continuous.csv --unit mV -o a.h5", {"--segments": "--segments"}),
        Way("import table in/continuous.csv --unit mV --segments -o a.h5", {"--keep-whole": "--keep-whole"}),
        Way("import table in/unlabelled.csv --unit mV -o a.h5", {"--annotations": "--annotations in/annotations.csv"}),
        Way(
            "import table in/unlabelled.csv --unit mV --annotations in/annotations.csv -o a.h5",
            refused={"--trial": "--trial p1", "--segments": "--segments"},
        ),
        Way(
            "import table in/table.csv --unit mV --sampling-rate-Hz 1000 --columns p1 -o a.h5",
            refused={"--time-unit": "--time-unit ms"},
        ),
    ],
    "import arrays": [
        Way(
            "import arrays in/arrays.npz --unit mV --sampling-rate-Hz 1000 --names label=gesture -o a.h5",
            WRITTEN
            | {
                "--unit": "--unit V",
                "--sampling-rate-Hz": "--sampling-rate-Hz 500",
                "--axes": "--axes trial,taxel,time",
                "--conditions": "--conditions in/of-trials.csv",
                "--where": "--where y=0",
                "--leave-out": "--leave-out y=0",
            },
        ),
        Way(
            "import arrays in/arrays.npz --unit mV --sampling-rate-Hz 1000 -o a.h5",
            {"--names": "--names label=gesture"},
        ),
    ],
    "import raster": [
        Way(
            "import raster in/rasters.npz --sampling-rate-Hz 1000 --names label=gesture -o a.h5",
            WRITTEN
            | {
                "--sampling-rate-Hz": "--sampling-rate-Hz 500",
                "--axes": "--axes trial,taxel,time",
                "--conditions": "--conditions in/of-trials.csv",
                "--where": "--where label=silk",
                "--leave-out": "--leave-out silk",
            },
            {
                "--levels": "--levels label",
                "--pattern": "--pattern {label}.npz",
                "--label": "--label speed",
                "--array": "--array x",
                "--transpose": "--transpose",
            },
            {"--merge-events": "tests/data/readers/test_import_raster.py"},
        ),
        Way("import raster in/rasters.npz --sampling-rate-Hz 1000 -o a.h5", {"--names": "--names label=gesture"}),
        Way(
            "import raster in/rasters --sampling-rate-Hz 1000 -o a.h5",
            {
                "--levels": "--levels cloth | --pattern {label}.npz",
                "--pattern": "--pattern {label}.npz",
                "--label": "--label number | --pattern {number}.npz",
                "--array": "--array x",
                "--transpose": "--transpose",
            },
            {"--names": "--names label=gesture", "--axes": "--axes time,taxel"},
        ),
    ],
    "import events": [
        Way(
            "import events in/events.csv -o a.h5",
            WRITTEN
            | CHOICE
            | {
                "--step-ms": "--step-ms 2",
                "--time-unit": "--time-unit ms | --merge-events",
                "--origin": "--origin first",
                "--duration-ms": "--duration-ms 20",
                "--channels": "--channels left,right",
                "--n-channels": "--n-channels 3",
                "--names": "! --names label=trial",
                "--merge-events": "--merge-events | --step-ms 20",
            },
            {
                "--polarity": "--polarity merge",
                "--polarities": "--polarities OFF,ON",
                "--sensor": "--sensor 34x34",
                "--levels": "--levels label",
                "--pattern": "--pattern {label}.csv",
                "--conditions": "--conditions in/conditions.csv",
                "--label": "--label speed",
            },
        ),
        Way(
            "import events in/polar.csv -o a.h5", {"--polarity": "--polarity merge", "--polarities": "--polarities A,B"}
        ),
        Way("import events in/grid.csv --time-unit s -o a.h5", {"--sensor": "--sensor 9x9"}),
        Way(
            "import events in/events -o a.h5",
            {
                "--levels": "--levels cloth | --pattern {label}.csv",
                "--pattern": "--pattern {label}.csv",
                "--conditions": "--conditions in/of-events.csv",
                "--label": "--label number | --pattern {number}.csv",
            },
        ),
    ],
    "info": [Way("info in/wide.h5", {"--all": "--all"}), Way("info in/spikes.h5", refused={"--all": "--all"})],
    "calibrate": [
        Way(
            "calibrate in/touch.h5 -o a.toml --set conditioning.baseline=start",
            {
                "-o": "-o b.toml",
                "--force": TWICE,
                "--encoder": "--encoder sa1-ra1-lif-graded",
                "--set": "--set sa1.t_ref_ms=9",
                "--split-seed": "--split-seed 3",
                "--stratify": "--stratify speed",
                "--where": "--where speed=300",
                "--leave-out": "--leave-out speed=300",
                "--test-where": "--test-where speed=450",
                "--group": "--group day",
                "--order": "--order trial",
                "--folds": "--folds 2",
                "--fold": "--fold 1 | --folds 2",
                "--figure": "--figure gains.png",
            },
            {
                "--fold": "--fold 0",
                "--split-seed": "--split-seed 0 --order trial",
                "--stratify": "--stratify speed --test-where day=0",
            },
            {"--rest-ms": "tests/encoders/test_calibration.py"},
            is_slow=True,
        ),
        Way("calibrate in/touch.h5 -o a.toml", {"--compare": "--compare"}, is_slow=True),
        Way("calibrate in/touch.h5 -o a.toml", {"--survives": "--survives left.png"}, is_slow=True),
    ],
    "encode": [
        Way(
            "encode in/touch.h5 -o a.h5 --set conditioning.baseline=start",
            WRITTEN
            | CHOICE
            | {
                "--encoder": "--encoder sa1-ra1-lif-graded",
                "--set": "--set sa1.t_ref_ms=9",
                "--augmentation": "--augmentation gain",
            },
            {"--copies": "--copies 2"},
        ),
        Way(
            "encode in/touch.h5 -o a.h5 --set conditioning.baseline=start --augmentation gain",
            {"--copies": "--copies 2", "--augmentation": "--augmentation time"},
        ),
    ],
    "raster": [
        Way(
            "raster in/spikes.h5 -o a.svg",
            {
                "-o": "-o b.svg",
                "--force": TWICE,
                "--trial": "--trial 1",
                "--start-s": "--start-s 0.1",
                "--stop-s": "--stop-s 0.1",
            },
            tested={"--recordings": MOVED},
        ),
        *(
            Way(
                f"raster in/spikes.h5 -o a{kind}",
                {"--force": TWICE},
                refused={
                    "--trial": "--trial 0",
                    "--start-s": "--start-s 0",
                    "--stop-s": "--stop-s 0.1",
                    "--recordings": "--recordings in/touch.h5",
                },
            )
            for kind in (".csv", ".nwb")
        ),
    ],
    "train": [
        Way(
            f"{TRAIN} {ONE}",
            NETWORK
            | {
                "-o": "-o other",
                "--network": "--network snn",
                "--leave-out-each": "--leave-out-each speed",
                "--repeats": "--repeats 2",
                "--refuse": "--refuse 0.5",
                "--seed": "--seed 4",
                "--force": TWICE,
                "--resume": TWICE,
            },
            NO_NETWORK,
            {
                "--device": "tests/networks/test_resumable.py",
                "--augmentation": "tests/networks/test_model_selection.py",
                "--balance": "tests/networks/test_balancing.py",
                "--target": "tests/networks/test_numbers.py",
                "--false-alarms-per-h": "tests/stream/test_detector.py",
            },
            is_slow=True,
        )
    ],
    "conditions-curve": [
        Way(
            "conditions-curve in/spikes.h5 speed",
            {},
            {},
            dict.fromkeys(CURVE.split(), "tests/networks/test_conditions_curve.py"),
        )
    ],
    "tune": [
        Way(
            f"tune in/spikes.h5 -o t --network rsnn --set training.epochs=2 --space texture --trials 3 {ONE}",
            NETWORK
            | {
                "-o": "-o other",
                "--set": "--set training.epochs=1",
                "--network": "--network snn",
                "--space": "--space in/space.toml",
                "--trials": "--trials 4",
                "--seed": "--seed 4",
                "--objective": "--objective accuracy-sops",
                "--sops-weight": "--sops-weight 5 | --objective accuracy-sops",
                "--max-sops": "--max-sops 10",
                "--tuner": "--tuner random | --trials 30",
                "--batch": "--batch 1 | --trials 24",
                "--assessor": "--assessor none | --batch 1 --trials 12 --set training.epochs=14",
                "--start-epoch": "--start-epoch 1 | --batch 1 --trials 8",
            },
            NO_NETWORK
            | {
                "--sops-weight": "--sops-weight 0.1",
                "--start-epoch": "--start-epoch 10 --assessor none",
            },
            {
                "--workers": "tests/networks/test_search.py",
                "--resume": "tests/networks/test_search.py",
            },
            is_slow=True,
        )
    ],
    "infer": [
        Way(
            "infer in/run in/spikes.h5",
            CHOICE
            | {"-o": "-o a.csv", "--early-exit": "--early-exit", "--json": "--json", "--force": f"{TWICE} | -o a.csv"},
            {"--force": "--force"},
            {"--device": "tests/networks/test_resumable.py"},
        ),
        Way("infer in/run in/other-spikes.h5", {"--allow-other-encoder": "--allow-other-encoder"}),
    ],
    "sops": [
        Way(
            "sops in/run -o a.csv",
            {
                "--prices": "--prices in/chip.toml",
                "-o": "-o b.csv",
                "--early-exit": "--early-exit",
                "--json": "--json",
                "--force": TWICE,
            },
            tested={"--spikes": MOVED},
        ),
        Way("sops in/run -o a.csv --spikes in/other-spikes.h5", {"--allow-other-encoder": "--allow-other-encoder"}),
    ],
    "fine-tune": [
        Way(
            "fine-tune in/run -o t --weight-bits 3 --epochs 1",
            {
                "-o": "-o other",
                "--weight-bits": "--weight-bits 2",
                "--state-bits": "--state-bits 24",
                "--epochs": "--epochs 0",
                "--seed": "--seed 5",
                "--force": TWICE,
                "--json": "--json",
            },
            {"--seed": "--seed 0 --epochs 0"},
            {"--spikes": MOVED},
        )
    ],
    "learn": [
        Way(
            "learn in/sums in/wool.h5 -o t --touches 2",
            {
                "-o": "-o other",
                "--touches": "--touches 3",
                "--force": TWICE,
                "--json": "--json",
            },
            tested={"--spikes": MOVED},
        )
    ],
    "save": [
        Way(
            "save in/run -o t --trials 4",
            {
                "-o": "-o other",
                "--trials": "--trials 2",
                "--at-most-points": "--at-most-points 60",
                "--prices": "--prices arithmetic-45nm",
                "--seed": "--seed 4",
                "--json": "--json",
            },
            tested={
                "--workers": "tests/networks/test_saving.py",
                "--recordings": "tests/networks/test_saving.py",
                "--spikes": MOVED,
            },
        )
    ],
    "stream": [
        Way(
            "stream in/run --from in/touch.h5",
            STREAM | {"--json": "--json"},
            FRAMES | {"--quiet-ms": "--quiet-ms 50", "--hop-ms": "--hop-ms 20 --contact"},
            EXITS
            | {"--rate": "tests/stream/test_stream_cli.py"}
            | dict.fromkeys(("--time-unit", "--origin", "--polarity"), "tests/stream/test_event_streams.py"),
        ),
        Way(
            "stream in/run --from in/samples.csv",
            STREAM | {"--format": "! --format int16"},
            {key: FRAMES[key] for key in ("--baud", "--lsb", "--zero", "--stall-s")},
            EXITS
            | {
                "--hold-ms": "tests/stream/test_stream_cli.py",
                "--stall-s": "tests/stream/test_sources.py",
                "--zero": "tests/stream/test_sources.py",
            },
        ),
        Way("stream in/run --from in/stamped.csv --time-column s", {"--hold-ms": "--hold-ms 1"}, {"--lsb": "--lsb 1"}),
        Way("stream in/run --from in/stamped.csv", {"--time-column": "--time-column s"}),
        Way("stream in/run --from in/samples.i16 --format int16", {"--lsb": "--lsb 0.01"}),
        Way("stream in/run --from in/samples.f32 --format float32", refused={"--time-column": "--time-column ms"}),
        Way(
            "stream in/run --from serial:/dev/none",
            {"--from": "--from in/touch.h5"},
            tested={"--baud": "tests/stream/test_sources.py"},
        ),
        Way(
            "stream in/run --from in/samples.csv",
            refused={"--time-unit": "--time-unit us", "--origin": "--origin first", "--polarity": "--polarity on"},
        ),
        Way("stream in/slow-run --from in/samples.csv", {"--sampling-rate-Hz": "--sampling-rate-Hz 450"}),
    ],
    "live": [
        Way(
            "live in/run --from in/touch.h5",
            refused=FRAMES
            | {"--set": "--set seed=1", "--quiet-ms": "--quiet-ms 50", "--hop-ms": "--hop-ms 20 --contact"},
            tested=dict.fromkeys(
                (
                    "--from",
                    "--speed",
                    "--loop",
                    "--shuffle",
                    "--set",
                    "--save-to",
                    "--port",
                    "--unit",
                    "--hold-ms",
                    *STREAM,
                    *EXITS,
                    *FRAMES,
                ),
                "tests/live/test_live_cli.py",
            ),
        ),
        Way("live in/run --from gratings", refused=FRAMES | {"--loop": "--loop", "--shuffle": "--shuffle"}),
        Way(
            "live in/run --from in/samples.csv",
            refused={
                "--speed": "--speed 1",
                "--loop": "--loop",
                "--shuffle": "--shuffle",
                "--stall-s": "--stall-s 1",
            },
        ),
    ],
    "export": [
        Way(
            "export in/run --to c -o a",
            {key: words for key, words in OF_C.items() if key not in EXITS and key != "--new-classes"}
            | {
                "-o": "-o b",
                "--to": "--to nir -o b",
                "--variant": "--variant float",
                "--weight-bits": "--weight-bits 4",
                "--state-bits": "--state-bits 10",
                "--name": "--name skin",
                "--window-ms": "--window-ms 40",
                "--start-ms": "--start-ms 70",
                "--hop-ms": "--hop-ms 20",
                "--quiet-ms": "--quiet-ms 2 | --contact",
                "--force": TWICE,
                "--lsb": "--lsb 0.1",
                "--sampling-rate-Hz": "! --sampling-rate-Hz 500",
                "--recordings": "! --recordings in/slow.h5",
                "--spikes": "! --spikes in/slow-spikes.h5",
            },
            OF_NIR
            | {"--quiet-ms": "--quiet-ms 50", "--hop-ms": "--hop-ms 50 --contact", "--new-classes": "--new-classes 1"},
            EXITS | {"--prove": "tests/export/test_c_export.py", "--new-classes": "tests/export/test_learning_in_c.py"},
        ),
        Way(
            "export in/run --to c --variant float -o a",
            refused={key: OF_C[key] for key in ("--weight-bits", "--state-bits", "--lsb", "--recordings", "--spikes")},
        ),
        Way(
            "export in/run --to nir -o a.nir",
            {
                "--plain": "--plain",
                "--lower-refractory": "--lower-refractory",
                "--network-only": "--network-only",
                "--dt-s": "--dt-s 0.0001",
            },
            OF_C,
        ),
        Way(
            "export in/run --to xyloaudio2 -o a.json",
            {"--prove": "--prove 1", "--spikes": "! --spikes in/slow-spikes.h5", "-o": "-o b.json", "--force": TWICE},
            OF_NIR | {key: words for key, words in OF_C.items() if key != "--spikes"},
        ),
        Way(
            "export in/run --check loihi2",
            {"--check": "--check xyloaudio2"},
            OF_C | OF_NIR | {"--to": "--to c", "-o": "-o a", "--prove": "--prove 1", "--force": "--force"},
        ),
    ],
    "study run": [
        Way(
            "study run in/tiny.toml -o s",
            refused={
                "--workers": "--workers 2 --scheduler tcp://127.0.0.1:8786",
                "--set": "--set network.model=snn --set network.recurrent_weight_scale=0.1",
            },
            tested={
                "-o": STUDY,
                "--quick": "tests/studies/test_study.py",
                "--data": SPLITS,
                "--window-ms": SPLITS,
                "--where": SPLITS,
                "--leave-out": SPLITS,
                "--test-where": SPLITS,
                "--group": SPLITS,
                "--order": SPLITS,
                "--folds": SPLITS,
                "--leave-out-each": "tests/studies/test_automatic.py",
                "--repeats": SPLITS,
                "--target": TARGETS,
                "--false-alarms-per-h": TARGETS,
                "--set": "tests/studies/test_study.py",
                "--workers": "tests/studies/test_scheduler.py",
                "--scheduler": "tests/studies/test_scheduler.py",
                "--json": "tests/test_cli.py",
            },
        ),
    ],
    "study resume": [
        Way(
            "study resume in/none",
            tested={
                "--workers": "tests/studies/test_scheduler.py",
                "--scheduler": "tests/studies/test_scheduler.py",
                "--json": "tests/test_cli.py",
            },
        )
    ],
    "study bundle": [
        Way("study bundle in/none -o b", tested=dict.fromkeys(("-o", "--width", "--without-data", "--force"), BUNDLE))
    ],
    "study report": [Way("study report in/none", tested={"--json": "tests/test_cli.py"})],
    "import nwb": [
        Way(
            "import nwb in/spikes.nwb -o a.h5",
            WRITTEN
            | CHOICE
            | {
                "--label": "--label speed",
                "--step-ms": "--step-ms 2 --merge-events",
                "--units": "--units 'afferent!=SA-I taxel1'",
                "--trials": "! --trials others",
                "--name": "! --name others",
            },
            {
                "--unit": "--unit N",
                "--sampling-rate-Hz": "--sampling-rate-Hz 500",
                "--max-gap-ms": "--max-gap-ms 5",
                "--drop-repeats": "--drop-repeats",
            },
            {
                **dict.fromkeys(("--series", "--unobserved", "--merge-events"), "tests/data/readers/test_nwb.py"),
                **dict.fromkeys(("--unit", "--sampling-rate-Hz"), "tests/data/readers/test_nwb.py"),
                **dict.fromkeys(("--max-gap-ms", "--drop-repeats"), "tests/data/readers/test_nwb.py"),
            },
        )
    ],
}
SAME = {
    **dict.fromkeys(
        (
            f"simulate {name}"
            for name in ("stiffness", "touch-modality", "contact-materials", "compliance", "gratings-slips")
        ),
        "simulate gratings",
    ),
    **dict.fromkeys((f"import {name}" for name in ("fabricslide", "pvdf-hardness", "touch-modality")), "encode"),
    **dict.fromkeys((f"import {name}" for name in ("cost", "stemnist-pressure", "cluster-haptic-texture")), "encode"),
    **dict.fromkeys(
        (f"import {name}" for name in ("braille-letters", "st-mnist", "stemnist", "vt-snn")), "import events"
    ),
}
"""Commands of plug-ins, whose options are those of one function, or work as those of another command."""


def commands(group: Any = None, before: str = "") -> Iterator[tuple[str, Any]]:
    group = group or get_group(cli.app)
    for name in group.commands:
        command = group.commands[name]
        yield from (
            commands(command, f"{before}{name} ") if hasattr(command, "commands") else [(f"{before}{name}", command)]
        )


COMMANDS = dict(commands())


def options_of(name: str) -> set[str]:
    return {each.opts[0] for each in COMMANDS[name].params if each.opts[0].startswith("-")}


def test_every_option_of_every_command_is_in_the_table():
    assert {*WAYS, *SAME} == {*COMMANDS}
    for name, same in SAME.items():
        assert options_of(name) <= options_of(same) | {"-o"}, name
    for name, ways in WAYS.items():
        known = {option for way in ways for option in (*way.changes, *way.tested)}
        assert known == options_of(name), name
        assert {option for way in ways for option in way.refused} <= known, name


def test_the_tests_that_are_named_exist():
    named = {path for ways in WAYS.values() for way in ways for path in way.tested.values()}
    assert [path for path in named if not (ROOT / path).is_file()] == []


class Outcome(NamedTuple):
    code: int
    said: str
    left: tuple[tuple[str, bytes], ...]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    made_inputs.make(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        further()
    return folder


def further() -> None:
    """Inputs in which every option has something to change."""
    with np.load("arrays.npz") as arrays:
        signals, labels = arrays["x"], arrays["gesture"]
    pd.DataFrame({"wet": ["no"] * len(labels)}).to_csv("of-trials.csv", index=False)
    rasters = (signals > np.median(signals)).astype(np.uint8)
    np.savez("rasters.npz", raster=rasters, gesture=labels, label=np.roll(labels, 1))
    for trial, (raster, label) in enumerate(zip(rasters, labels, strict=True)):
        Path("rasters", label).mkdir(parents=True, exist_ok=True)
        np.savez(Path("rasters", label, f"{trial}.npz"), x=raster, z=raster[:, ::-1])
    events = pd.read_csv("events.csv")
    events.assign(polarity=events["channel"]).to_csv("polar.csv", index=False)
    grid = events.rename(columns={"channel": "x"}).assign(y=1, p=events["channel"])
    grid.to_csv("grid.csv", index=False)
    files = []
    for trial, rows in events.groupby("trial"):
        label = rows["label"].iloc[0]
        Path("events", label).mkdir(parents=True, exist_ok=True)
        files.append(f"{label}/{trial}.csv")
        rows[["t", "channel"]].to_csv(Path("events", files[-1]), index=False)
    pd.DataFrame({"file": files, "label": ["felt", "silk"] * 6, "wet": "no"}).to_csv("of-events.csv", index=False)
    wide = np.random.default_rng(0).normal(size=(4, 20, 70)).astype(np.float32)
    nt.save(nt.Recordings(wide, 1000.0, "mV", pd.DataFrame({"label": ["a", "b"] * 2})), "wide.h5")
    Path("space.toml").write_text('hidden = { _type = "choice", _value = [2, 3] }\n')
    Path("chip.toml").write_text("source = 'a data sheet'\nmultiplication_pJ = 0.2\naddition_pJ = 0.1\n")
    if find_spec("pynwb"):
        spikes = nt.load("spikes.h5")
        assert isinstance(spikes, nt.SpikeTrains)
        nt.to_nwb(spikes, "spikes.nwb")
    sums = made_inputs.NETWORK | {"readout": "integrator", "recipe": None}
    nt.train("spikes.h5", "sums", "rsnn", sums, window=nt.Window(length_ms=50, start_ms=80))
    wool = nt.load("spikes.h5")
    nt.save(replace(wool, conditions=wool.conditions.assign(label="wool")), "wool.h5")
    for name in ("tiny.toml", "tiny-encoder.toml"):
        shutil.copy(ROOT / "tests" / "studies" / name, name)


BASES: dict[str, Outcome] = {}
"""The outcomes of commands without the option, computed once."""


class Runner:
    """Runs commands, each in a new folder that leads to the inputs as `in`."""

    def __init__(self, inputs: Path, place: Path, patch: pytest.MonkeyPatch, capsys: Any) -> None:
        self.inputs, self.place, self.patch, self.capsys = inputs, place, patch, capsys
        self.n = 0

    def outcome(self, words: str) -> Outcome:
        """Of the commands in `words`, between semicolons: the code and the lines of the last."""
        self.n += 1
        folder = self.place / str(self.n)
        folder.mkdir()
        (folder / "in").symlink_to(self.inputs)
        self.patch.chdir(folder)
        said, code = "", 0
        for part in words.split(" ; "):
            self.patch.setattr(sys, "argv", ["neurotact", *shlex.split(part)])
            try:
                cli.main()
                code = 0
            except SystemExit as end:
                code = int(end.code or 0)
            said = "".join(self.capsys.readouterr())
        files = [
            path for path in folder.rglob("*") if path.is_file() and "in" not in path.relative_to(folder).parts[:1]
        ]
        left = {path.relative_to(folder).as_posix(): _content(path) for path in files}
        return Outcome(code, TIMES.sub("s", said), tuple(sorted(left.items())))

    def pair(self, way: Way, entry: str) -> tuple[Outcome, Outcome, int]:
        """The outcomes without and with an option, and the exit code that is expected with it."""
        fails = entry.startswith("! ")
        words, _, beside = entry.removeprefix("! ").partition(" | ")
        base = f"{way.words} {beside}".strip()
        if base not in BASES:
            BASES[base] = self.outcome(base)
        return BASES[base], self.outcome(f"{base} {words}"), 2 if fails else 0


def _content(path: Path) -> bytes:
    return b"" if path.name in SETTINGS else path.read_bytes()


@pytest.fixture
def runner(inputs, tmp_path, monkeypatch, capsys) -> Runner:
    return Runner(inputs, tmp_path, monkeypatch, capsys)


def cases(kind: str) -> list[Any]:
    """Of the options that change something the first of each way is quick, and all that are refused."""

    def level(way: Way, number: int) -> list[pytest.MarkDecorator]:
        if way.is_slow:
            return [pytest.mark.slow]
        return [pytest.mark.thorough] if kind == "changes" and number else []

    return [
        pytest.param(way, option, words, id=f"{way.words} {words}", marks=level(way, number))
        for ways in WAYS.values()
        for way in ways
        for number, (option, words) in enumerate(getattr(way, kind).items())
    ]


@pytest.mark.filterwarnings("default::UserWarning")
@pytest.mark.parametrize(("way", "option", "words"), cases("changes"))
def test_an_option_changes_what_is_printed_or_written(way, option, words, runner):
    if ".nwb" in way.words:
        pytest.importorskip("pynwb")
    if words.startswith(TWICE):
        base = way.words + words.removeprefix(TWICE).replace(" | ", " ")
        again = [runner.outcome(f"{base} ; {base}{more}").code for more in ("", f" {option}")]
        assert again == [2, 0]
        return
    without, given, code = runner.pair(way, words)
    assert given.code == code, given.said
    assert "no effect" not in given.said
    assert given != without


@pytest.mark.parametrize(("way", "option", "words"), cases("refused"))
def test_an_option_without_effect_is_refused(way, option, words, runner):
    if ".nwb" in way.words:
        pytest.importorskip("pynwb")
    done = runner.outcome(f"{way.words} {words}")
    assert (done.code, done.said.count("\n"), done.left) == (2, 1, ()), done.said
    key = words.rpartition("--set ")[2].partition("=")[0]
    assert option in done.said or (option == "--set" and key in done.said)


@pytest.mark.parametrize("words", ["encode in/touch.h5 -o a.h5", "stream in/run --from in/touch.h5", TRAIN + " " + ONE])
def test_the_same_command_has_the_same_outcome(words, runner):
    """Else every option would seem to change something."""
    assert runner.outcome(words) == runner.outcome(words)


# --- Python ------------------------------------------------------------------------------------------------

FUNCTIONS = [name for name in vars(nt)["__all__"] if inspect.isfunction(getattr(nt, name))]
AS_COMMAND = {
    name: command
    for name in FUNCTIONS
    if (command := words._command(name).partition(" --")[0]) in COMMANDS
} | {"windows": "train", "simulate": "simulate gratings", "read": "import braille-letters"}  # fmt: skip
"""Functions that do what a command does: a keyword is the option of its name."""
NO_FUNCTION = {"list", "show", "copy"}
"""Commands without a function: of specs, which are files."""
OF_COMMANDS = {"as_json", "to", "check"}
"""Options of commands alone: how they print, and which function `export` calls."""
SAVED = {"out", "force"}
"""Options of commands that save what a function returns, and of `export`, where `out` is a folder or a file."""
NAMES = {"settings": "--set", "length_ms": "--window-ms", "folder": "-o", "path": "-o", "parameters": "--set",
         "out": "-o",
    "leave_out_units": "--units",
    "source": "--from",}  # fmt: skip
INPUTS = {"spikes", "run", "touched", "study", "recordings", "name", "path", "what", "source", "block", "parts",
          "network", "folder", "column", "file", "decisions", "tell", "show", "check", "kind", "options"}  # fmt: skip
"""What a function works on, and whom it tells."""
HERE, NWB, NEO = "tests/test_options.py", "tests/data/readers/test_nwb.py", "tests/data/test_neo_blocks.py"
DECODING = "tests/encoders/test_decoding.py"
SNNTORCH, API = "tests/networks/test_snntorch_exchange.py", "tests/test_api.py"
FITTED = "tests/networks/test_fitted.py"
ELSEWHERE = {
    **dict.fromkeys(("encode.progress", "simulate.progress", "infer.test_only", "to_nwb.force"), HERE),
    **dict.fromkeys(("from_neo.leave_out", "from_nir.backend"), HERE),
    **dict.fromkeys((f"{name}.{key}" for name in ("train", "tune", "conditions_curve", "run_study", "calibrate")
        for key in (*WINDOW, *SPLIT)), HERE),
    "windows.window.onset.bin_ms": "tests/data/test_contact.py",
    **dict.fromkeys((f"{name}.{key}" for name in ("read_raster", "read_table") for key in LAYOUT), HERE),
    **dict.fromkeys(("run_study.learn.balance", "run_study.learn.refuse"), TARGETS),
    "refuse.share": "tests/export/test_refusal.py",
    "tune.search.first": "tests/networks/test_tuning.py",
    "to_snntorch.time_first": FITTED,
    **dict.fromkeys(("save.force", "save_network.force"), API),
    "plot_survival.found": DECODING,
    **dict.fromkeys(
        (f"what_survives.{key}" for key in ("encoder", "settings", "where", "leave_out", "seed")), DECODING
    ),
    **dict.fromkeys(("to_nwb.session_start", "to_nwb.about"), NWB),
    **dict.fromkeys(("from_nir.dt_s", "from_nir.sampling_rate_Hz"), "tests/export/test_nir.py"),
    "from_nir.reset": "tests/export/test_nir_graphs.py",
    **dict.fromkeys(("from_nir_data.data", "from_nir_data.labels"), "tests/export/test_nir_data.py"),
    **dict.fromkeys(("from_nir_data.sampling_rate_Hz", "from_nir_data.node"), "tests/export/test_nir_data.py"),
    **dict.fromkeys(("from_snntorch.sampling_rate_Hz", "from_snntorch.backend"), SNNTORCH),
    **dict.fromkeys((f"from_neo.{key}" for key in ("step_ms", "label", "merge_events", "unobserved", "where")), NEO),
}  # fmt: skip


def no_value(value: Any) -> bool:
    return value is None or value == ()


def test_an_option_is_a_keyword_with_its_default():
    """What the command line can do, Python can; every option is a keyword, none hides in others."""
    of_command: dict[str, list[str]] = {}
    for name, command in AS_COMMAND.items():
        of_command.setdefault(command, []).append(name)
    others = {same: of_command[command] for same, command in SAME.items() if same.startswith("simulate")}
    of_command |= others | {name: ["read"] for name in SAME if name.startswith("import")}
    assert {*COMMANDS} - {*of_command} == NO_FUNCTION
    for command, names in of_command.items():
        keywords = [inspect.signature(getattr(nt, name)).parameters for name in names]
        for option in COMMANDS[command].params:
            if option.name in OF_COMMANDS or (option.name in SAVED and not any("out" in each for each in keywords)):
                continue
            if option.name in {path for name in names for path in fields(name)}:
                assert not option.default, f"{command}: {option.name}"  # the spec has the default
                continue
            defaults = [each[option.name].default for each in keywords if option.name in each]
            assert defaults, f"{command}: {option.name}"
            given = option.default
            is_same = any(given == default or (no_value(given) and no_value(default)) for default in defaults)
            assert is_same or option.required or (command == "export" and given is None), f"{command}: {option.name}"


def fields(name: str) -> dict[str, str]:
    """The fields of the specs that a function takes: the path of each, by the name of its option."""
    specs = specs_of(getattr(nt, name))
    return {name_of(path): path for key, kind in specs.items() for path in fields_of(key, kind, in_python=True)}


def test_what_counts_decisions_takes_whole_windows_unless_early_exit_is_asked_for():
    """In files and in memory; what runs a chain on a device exits early unless whole windows are asked for."""
    of_classifier = (nt.SpikingClassifier.decide, nt.SpikingClassifier.sops, nt.SpikingClassifier.costs)
    for counts in (nt.infer, nt.sops, *of_classifier):
        assert inspect.signature(counts).parameters["early_exit"].default is False
    assert nt.Streamed().full_window is False


def test_what_is_not_typed_is_not_given():
    """Else a default would be refused where it has no effect; an option of two owners belongs to the function."""
    absent = {"drop_repeats": False, "columns": None, "levels": None, "label": None}
    assert arguments(nt.read_folder, {**absent, "path": Path("a")}) == {"path": Path("a")}
    assert arguments(nt.train, {"spikes": Path("a"), "group": [], "fold": None}) == {"spikes": Path("a")}
    typed = arguments(nt.read_raster, {"conditions": Path("a.csv"), "pattern": "{label}.npz"})
    assert typed == {"conditions": Path("a.csv"), "naming": nt.Naming(pattern="{label}.npz")}


def test_a_rest_is_as_long_everywhere():
    assert inspect.signature(nt.calibrate).parameters["rest_ms"].default == nt.Onset().rest_ms


def test_a_public_function_names_all_its_keywords():
    """Besides `simulate`, whose further keywords are the keys of its spec, and `export`: those of its exporter."""
    swallowing = [
        name
        for name in FUNCTIONS
        if any(each.kind == each.VAR_KEYWORD for each in inspect.signature(getattr(nt, name)).parameters.values())
    ]
    assert swallowing == ["export", "simulate"]
    assert not any(each.kind == each.VAR_KEYWORD for each in inspect.signature(nt.Stream).parameters.values())


def test_every_keyword_of_every_function_is_in_a_table():
    absent = []
    for name in FUNCTIONS:
        options = options_of(AS_COMMAND[name]) if name in AS_COMMAND else set()
        plain = {
            key: key
            for key in inspect.signature(getattr(nt, name)).parameters
            if key not in specs_of(getattr(nt, name))
        }
        for keyword, path in {**plain, **fields(name)}.items():
            option = NAMES.get(keyword, "--" + keyword.replace("_", "-"))
            if option not in options and keyword not in INPUTS and f"{name}.{path}" not in ELSEWHERE:
                absent.append(f"{name}.{path}")
    assert absent == []


def test_the_tests_of_keywords_name_them():
    assert [name for name, path in ELSEWHERE.items() if name.rpartition(".")[2] not in (ROOT / path).read_text()] == []


NO_EFFECT = {
    "train": [
        {"window": nt.Window(onset=nt.Onset(rest_ms=20))},
        {"window": nt.Window(onset=nt.Onset(deviations=3))},
        {"split": nt.Split(seed=0, order="trial")},
        {"split": nt.Split(fold=0)},
        {"split": nt.Split(nested=False)},
        {"split": nt.Split(test=0.2, folds=3)},
        {"split": nt.Split(test=0.2, test_where={"speed": 450})},
        {"split": nt.Split(test=0.2, leave_out_each="speed")},
        {"split": nt.Split(leave_aside=True, test_where={"speed": 450})},
        {"split": nt.Split(stratify="speed", test_where={"day": 0})},
        {"settings": {"model": "snn", "recurrent_weight_scale": 0.1}},
        {"settings": {"model": "snn", "recurrent_delay_steps": 0}},
        {"settings": {"readout": "integrator", "readout_surrogate_scale": 3.0}},
        {"settings": {"training.readout_dropout": 0.1}},
        {"settings": {"training.relative_learning_rate": 0.1, "training.learning_rate": 0.1}},
        {"network": "default", "settings": {"model": "snn", "forward_weight_scale": 0.3}},
        {"network": nt.RSNNSpec(model="snn", recurrent_weight_scale=0.3)},
    ],
    "tune": [
        {"search": nt.Search(sops_weight=0.1)},
        {"search": nt.Search(start_epoch=10, assessor="none")},
        {"window": nt.Window(onset=nt.Onset(rest_ms=20))},
        {"split": nt.Split(repeats=2)},
        {"split": nt.Split(leave_out_each="speed")},
        {"settings": {"training.readout_dropout": 0.1}},
    ],
    "export_c": [
        {"variant": "float", "weight_bits": 8},
        {"new_classes": 1},
        {"variant": "float", "recordings": "in/touch.h5"},
        {"streamed": nt.Streamed(quiet_ms=50.0)},
        {"streamed": nt.Streamed(hop_ms=50.0, contact=True)},
    ],
    "fine_tune": [{"epochs": 0, "seed": 0}],
    "run_study": [
        {"workers": 2, "scheduler": "tcp://127.0.0.1:8786"},
        {"settings": {"network.model": "snn", "network.recurrent_weight_scale": 0.1}},
        {"settings": {"split.nested": False}},
        {"settings": {"window.onset.rest_ms": 20.0}},
    ],
}
FIRST = {"train": "spikes.h5", "tune": "spikes.h5", "export_c": "run", "fine_tune": "run", "run_study": "tiny.toml"}


@pytest.mark.parametrize(
    ("name", "keywords"),
    [pytest.param(name, each, id=f"{name} {each}") for name in NO_EFFECT for each in NO_EFFECT[name]],
)
def test_a_keyword_without_effect_is_refused(name, keywords, inputs, tmp_path):
    usual = {"network": "rsnn", "window": nt.Window(length_ms=40, start_ms=80)} if name in ("train", "tune") else {}
    with pytest.raises(nt.InputError, match="has no effect"):
        getattr(nt, name)(inputs / FIRST[name], tmp_path / "out", **usual | keywords)
    assert not any((tmp_path / "out").rglob("*")) if (tmp_path / "out").is_dir() else True


CONSTRUCTED = ("RSNN", "SpikingClassifier", "SpikeEncoder", "Stream")
KEYWORDS = {
    "SpikingClassifier": {
        "hidden": 10, "recurrent": False, "tau_mem_ms": 3.0, "tau_syn_ms": 1.5, "learning_rate": 0.5, "batch": 5,
        "epochs": 1, "patience": 1, "network": "rsnn", "settings": {"readout": "max"}, "validation_fraction": 0.4,
        "exit_tolerance": 0.9, "random_state": 4, "verbose": True,
    },
    "SpikeEncoder": {
        "encoder": "izhikevich", "settings": {"sa1.t_ref_ms": 9}, "sampling_rate_Hz": 500.0, "unit": "V",
        "calibrate": False,
    },
    "Stream": {
        "unit": "V", "streamed": nt.Streamed(length_ms=30),
    },
    "RSNN": {"spec": nt.RSNNSpec(hidden=4), "sampling_rate_Hz": 500.0, "dtype": torch.float64, "hidden": 9},
}  # fmt: skip
"""Values of the keywords of constructors that change what an object computes, or prints."""
OF_CONSTRUCTORS = {
    "SpikingClassifier.sampling_rate_Hz": "tests/networks/test_classifier.py",
    "SpikingClassifier.device": "tests/networks/test_classifier.py",
    "RSNN.backend": "tests/networks/test_native.py",
    "RSNN.generator": "tests/networks/test_reference.py",
    "RSNN.returns": "tests/networks/test_sequential.py",
    "Stream.hold_ms": "tests/stream/test_stream.py",
    "Stream.backend": "tests/stream/test_stream.py",
    "Stream.watch": "tests/stream/test_stream_watch.py",
}
"""The tests of other keywords of constructors."""
NO_EFFECT_THERE = [
    (nt.RSNN, {"model": "snn", "recurrent_weight_scale": 0.3}),
    (nt.RSNN, {"training": {"readout_dropout": 0.1}}),
    (nt.SpikingClassifier, {"recurrent": False, "settings": {"recurrent_weight_scale": 0.3}}),
    (nt.SpikingClassifier, {"network": "rsnn", "settings": {"training.readout_dropout": 0.1}}),
    (nt.SpikeEncoder, {"encoder": "izhikevich", "calibrate": True}),
    (nt.Stream, {"streamed": nt.Streamed(quiet_ms=5.0)}),
    (nt.Stream, {"streamed": nt.Streamed(contact=True, hop_ms=5.0)}),
]


def touches() -> tuple[np.ndarray, np.ndarray]:
    """Signals `(trial, time, taxel)` of two classes."""
    rng, y = np.random.default_rng(0), np.repeat(["felt", "silk"], 8)
    strength = np.where(y == "felt", 30, 9)[:, None, None]
    wave = strength * np.sin(np.linspace(0, 9, 80) + rng.uniform(0, 6, (16, 1)))[..., None]
    return (wave + rng.normal(0, 1, (16, 80, 2))).astype(np.float32), y


USUAL: dict[str, list[Any]] = {}
"""What an object computes and prints with no keyword but those that it needs."""


def computed(name: str, capsys: Any, **keywords: Any) -> list[Any]:
    """What an object with these keywords computes and prints."""
    X, y = touches()
    if name == "SpikeEncoder":
        given = {"sampling_rate_Hz": 1000.0, "settings": {"conditioning.baseline": "start"}} | keywords
        if "encoder" in keywords:
            given.pop("settings")
        encoder = nt.SpikeEncoder(**given).fit(X, y)
        return [np.asarray(encoder.transform(X)).tolist(), encoder.spec_.unit]
    spikes = (np.abs(X) > 8).astype(np.uint8)
    if name == "SpikingClassifier":
        model = {} if "recurrent" in keywords else {"model": "rsnn"}
        given = {
            "hidden": 12, "epochs": 12, "batch": 4, "random_state": 0, "sampling_rate_Hz": 1000.0,
            "settings": {"step_ms": 1.0, "readout_stretches": 1, **model},
        }  # fmt: skip
        clf = nt.SpikingClassifier(**given | keywords).fit(spikes, y)
        return [clf.decision_function(spikes).tolist(), clf.exit_rule_, capsys.readouterr().out]
    given = {"sampling_rate_Hz": 1000.0, "generator": torch.Generator().manual_seed(0)}
    if name == "RSNN":
        network = nt.RSNN(2, 2, **given | keywords)
        return [network(torch.from_numpy(spikes)).hidden.tolist(), network.w_in.dtype]
    conditioning = {"baseline": "start"}
    encoder = nt.AfferentSpec.model_validate({"sa1": {"gain": 8}, "ra1": {"gain": 9}, "conditioning": conditioning})
    network = nt.RSNN(4, 2, hidden=5, forward_weight_scale=3.0, **given)
    return [nt.Stream((encoder, network), **{"streamed": nt.Streamed(length_ms=20.0)} | keywords).push(X[0])]


@pytest.mark.parametrize(("name", "keyword"), [(name, key) for name in KEYWORDS for key in KEYWORDS[name]])
def test_a_keyword_of_a_constructor_changes_what_is_computed(name, keyword, capsys):
    if name not in USUAL:
        USUAL[name] = computed(name, capsys)
    assert USUAL[name] != computed(name, capsys, **{keyword: KEYWORDS[name][keyword]})


def test_every_keyword_of_a_constructor_is_in_a_table():
    for name in CONSTRUCTED:
        keywords = {*inspect.signature(getattr(nt, name)).parameters} - {"n_inputs", "n_classes", "source", "keys"}
        told = {each.partition(".")[2] for each in OF_CONSTRUCTORS if each.startswith(f"{name}.")}
        assert {*KEYWORDS[name]} - {"hidden"} | told | ({"hidden"} & keywords) == keywords, name
    for name, path in OF_CONSTRUCTORS.items():
        assert name.partition(".")[2] in (ROOT / path).read_text(), name


@pytest.mark.parametrize(("made", "keywords"), NO_EFFECT_THERE)
def test_a_keyword_of_a_constructor_without_effect_is_refused(made, keywords):
    X, y = touches()
    encoder = nt.AfferentSpec.model_validate({"sa1": {"gain": 8}, "ra1": {"gain": 9}})
    uses = {
        nt.RSNN: lambda: nt.RSNN(4, 2, sampling_rate_Hz=1000.0, **keywords),
        nt.SpikingClassifier: lambda: nt.SpikingClassifier(sampling_rate_Hz=1000.0, **keywords).fit(np.abs(X) > 8, y),
        nt.SpikeEncoder: lambda: nt.SpikeEncoder(sampling_rate_Hz=1000.0, **keywords).fit(X, y),
        nt.Stream: lambda: nt.Stream((encoder, nt.RSNN(4, 2, sampling_rate_Hz=1000.0)), **keywords),
    }
    with pytest.raises(nt.InputError, match="has no effect"):
        uses[made]()


@pytest.mark.parametrize("beside", [{"groups": np.arange(16)}, {}])
def test_what_holds_out_windows_is_refused_beside_validation_windows(beside):
    X, y = touches()
    spikes = (np.abs(X) > 8).astype(np.uint8)
    fraction = None if beside else 0.2
    clf = nt.SpikingClassifier(sampling_rate_Hz=1000.0, validation_fraction=fraction)
    with pytest.raises(nt.InputError, match="has no effect where validation windows are given"):
        clf.fit(spikes, y, validation=(spikes, y), **beside)


def test_a_swept_key_is_refused_only_if_no_cell_uses_it(inputs):
    settings = {"sweep.network.recurrent_weight_scale": [0.1, 0.2]}
    both = settings | {"sweep.network.model": ["rsnn", "snn"]}
    assert len([*study.cells(study.resolve(inputs / "tiny.toml", both))]) > 1
    with pytest.raises(nt.InputError, match=r"network\.recurrent_weight_scale: has no effect with model = 'snn'"):
        loading.resolve(inputs / "tiny.toml", settings | {"network.model": "snn"})


def test_a_key_of_a_file_that_has_no_effect_there_is_refused(inputs, tmp_path):
    (tmp_path / "mine.toml").write_text('model = "snn"\nrecurrent_weight_scale = 0.3\n')
    with pytest.raises(nt.InputError, match="recurrent_weight_scale: has no effect"):
        nt.train(inputs / "spikes.h5", tmp_path / "run", tmp_path / "mine.toml", window=nt.Window(length_ms=40))


@pytest.mark.parametrize("name", ["rsnn", "snn", "default"])
def test_a_shipped_network_is_not_refused_for_another_model(name):
    assert given_keys(name, {"model": "snn"}) == ["model", *(["recipe"] if name == "default" else [])]


class AskedError(Exception):
    """Carries what is asked for out of a function."""


def ask(*given: Any, **options: Any) -> None:
    raise AskedError(given, options)


WHOLE = nt.Window(
    length_ms=41, start_ms=3, hop_ms=7, per_trial=2, align="onset", onset=nt.Onset(rest_ms=9, bin_ms=4, deviations=2)
)
SPLITS_OF = [
    nt.Split(validation=0.3, test=0.2, seed=4, group="day", stratify="speed"),
    nt.Split(test_where={"day": 0, "speed": 450}, leave_aside=True, nested=False),
    nt.Split(order="trial"),
    nt.Split(folds=3, fold=2),
]
TURNS = [
    (nt.Split(repeats=2, seed=3), {"sweep.split.seed": [3, 4]}),
    (nt.Split(folds=3), {"sweep.split.fold": [0, 1, 2]}),
    (nt.Split(folds=3, fold=1), {}),
]
"""Divisions that have turns, or might, and the sweep of a study for them."""


def test_every_field_of_a_window_and_of_a_split_is_given():
    every = (*SPLITS_OF, nt.Split(repeats=2), nt.Split(leave_out_each="day"))
    assert {f"window.{key}" for key in WHOLE.given()} == {*WINDOW}
    assert {f"split.{key}" for split in every for key in split.given()} == {*SPLIT}


@pytest.mark.parametrize("split", SPLITS_OF, ids=repr)
@pytest.mark.parametrize("name", ["train", "tune", "conditions_curve"])
def test_every_field_of_a_spec_reaches_the_task(name, split, monkeypatch):
    monkeypatch.setattr(tasks, "load_spikes", ask)
    more: dict[str, Any] = {} if name == "conditions_curve" else {"split": split}
    with pytest.raises(AskedError) as asked:
        getattr(nt, name)("spikes.h5", "there", window=WHOLE, **more)
    task = asked.value.args[0][1]
    assert task.window == WHOLE
    if more:
        assert task.split.model_dump() == split.one.model_dump()
        assert task.stratify == split.stratify


@pytest.mark.parametrize(("split", "sweep"), [*((split, {}) for split in SPLITS_OF), *TURNS], ids=repr)
def test_every_field_of_a_spec_reaches_the_study(split, sweep, monkeypatch):
    monkeypatch.setattr(loading, "resolve", ask)
    with pytest.raises(AskedError) as asked:
        nt.run_study("own-recordings", "there", window=WHOLE, split=split)
    given = {key: value for key, value in split.given().items() if key not in ("repeats", "stratify")}
    expected = {f"window.{key}": value for key, value in WHOLE.given().items()}
    expected |= {f"split.{key}": value for key, value in given.items()} | sweep
    assert asked.value.args[0][1] == expected | ({"dataset.stratify": ("speed",)} if split.stratify else {})


@pytest.mark.parametrize("split", SPLITS_OF, ids=repr)
def test_every_field_of_a_split_reaches_the_fit_of_an_encoder(split, inputs, monkeypatch):
    monkeypatch.setattr(encoding, "training_touches", ask)
    monkeypatch.setattr(encoding, "check_stratify", lambda *given: None)
    with pytest.raises(AskedError) as asked:
        nt.calibrate(inputs / "touch.h5", split=split)
    assert asked.value.args[0][1:] == (split.stratify, split.one)


@pytest.mark.parametrize("split", [nt.Split(repeats=2), nt.Split(leave_out_each="speed")], ids=repr)
def test_a_split_with_turns_is_refused_where_trials_are_divided_once(split, inputs):
    spikes = nt.load_spikes(inputs / "spikes.h5")
    for call in (
        lambda: nt.calibrate(inputs / "touch.h5", split=split),
        lambda: nt.windows(spikes, nt.Window(length_ms=40)).split(split),
    ):
        with pytest.raises(nt.InputError, match="has no effect"):
            call()


@pytest.mark.parametrize(
    ("keywords", "said"),
    [
        ({"length_ms": 40}, "`length_ms` is a field of `window`: `window=nt.Window(length_ms=...)`"),
        ({"split_seed": 3}, "`split_seed` is a field of `split`: `split=nt.Split(seed=...)`"),
        ({"window": 40}, "window: must be an nt.Window(...); got int"),
        ({"split": nt.Window()}, "split: must be an nt.Split(...); got WindowSpec"),
    ],
)
def test_a_field_outside_of_its_spec_is_refused_with_its_place(keywords, said):
    with pytest.raises(nt.InputError, match=re.escape(said)):
        nt.train("spikes.h5", "run", **keywords)


FIELDS_OF_TEXT = {
    "columns": "1", "time_column": "t", "time_unit": "s", "max_gap_ms": 9, "drop_repeats": True,
    "missing": "drop-trial", "decimal": ",", "header_lines": 1,
}  # fmt: skip


@pytest.mark.parametrize(("key", "value"), [*FIELDS_OF_TEXT.items(), ("array", "x"), ("transpose", True)])
def test_a_field_of_a_layout_that_a_file_does_not_have_is_refused(key, value, inputs):
    one: dict[str, Any] = {key: value}
    with pytest.raises(nt.InputError, match=f"`{key}` is for a folder"):
        nt.read_raster(inputs / "rasters.npz", 1000, names={"label": "gesture"}, layout=nt.Layout(**one))
    if key not in FIELDS_OF_TEXT:
        with pytest.raises(nt.InputError, match=f"{key}: unknown key"):
            nt.read_table(inputs / "table.csv", unit="mV", layout=nt.Layout(**one))


MOST_PARAMETERS = 16


def test_no_public_function_takes_too_many_parameters():
    of = {name: len(inspect.signature(getattr(nt, name)).parameters) for name in FUNCTIONS}
    assert {name: number for name, number in of.items() if number > MOST_PARAMETERS} == {}


def test_no_function_takes_too_many_parameters():
    many = []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                names = [each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                if len([name for name in names if name not in ("self", "cls")]) > MOST_PARAMETERS:
                    many.append(f"{path}: {node.name}")
    assert many == []


def test_keywords_that_no_option_has(inputs):
    recordings = nt.load(inputs / "touch.h5")
    assert isinstance(recordings, nt.Recordings)
    done: list[Any] = []
    nt.encode(recordings, settings=made_inputs.ENCODER, progress=done.append)
    nt.simulate("gratings", trials=1, duration_s=0.2, progress=lambda *each: done.append(each))
    assert sum(each for each in done if isinstance(each, int)) == len(recordings)
    assert any(isinstance(each, tuple) for each in done)
    tables = [nt.infer(inputs / "run", inputs / "spikes.h5", test_only=test_only) for test_only in (False, True)]
    assert 0 < len(tables[1]) < len(tables[0])
    pytest.importorskip("nir")
    graph = nt.to_nir(inputs / "run")
    assert [nt.from_nir(graph, backend=each).network.backend for each in ("auto", "reference")] == ["auto", "reference"]
    pytest.importorskip("neo")
    spikes = nt.load(inputs / "spikes.h5")
    assert isinstance(spikes, nt.SpikeTrains)
    assert nt.from_neo(nt.to_neo(spikes), leave_out="felt").classes == ("silk",)
