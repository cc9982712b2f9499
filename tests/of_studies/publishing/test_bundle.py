"""A bundle holds what a paper needs of a study, and its study runs again to the same bytes in any place."""

import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path, PurePosixPath

import made_inputs
import pytest
from in_process import studies_here, typed, without_pictures
from levels import thinned
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from neurotact_parts.studies.publishing import bundle as bundled
from neurotact_parts.studies.publishing import prints

import neurotact as nt
from neurotact.data import hdf5
from neurotact.errors import InputError
from neurotact.figures.style import add_legend, new_figure
from neurotact.studies import runner

ROOT = Path(__file__).parents[3]
STUDY = """
title = "Felt & silk_1"
encoder = "sa1-ra1-lif"
network = "rsnn"
baselines = "linear"
dataset = { file = "my touches.h5" }
window = { length_ms = 50.0, start_ms = 80.0, per_trial = 1 }
[set]
"network.training.epochs" = 1
"network.hidden" = 3
[sweep]
"encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms" = [[1, 1], [5, 10]]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A small study of a file of recordings."""
    place = tmp_path_factory.mktemp("the place")
    hdf5.save_recordings(made_inputs.touches(), place / "my touches.h5")
    (place / "small.toml").write_text(STUDY)
    with studies_here():
        assert typed("study", "run", place / "small.toml", "-o", place / "run").code == 0
    return place / "run"


@pytest.fixture(scope="module")
def bundle(finished, tmp_path_factory) -> Path:
    done = typed("study", "bundle", finished, "-o", tmp_path_factory.mktemp("out") / "bundle")
    assert done.code == 0, done.err
    return Path(done.out.split(": run the study")[0])


def compared(bundle: Path) -> dict[str, Path]:
    """The files that reproduce.sh compares: by their names, where the bundle has them."""
    match = re.search(r"^for name in (.*); do$", (bundle / "reproduce.sh").read_text(), re.MULTILINE)
    assert match is not None
    return {name: bundle / name if name == "answer.json" else bundle / "tables" / name for name in match[1].split()}


def test_the_study_of_a_bundle_runs_again_to_the_same_bytes_in_another_place(bundle, tmp_path):
    moved = tmp_path / "elsewhere"
    shutil.copytree(bundle, moved)
    with studies_here():
        assert typed("study", "run", "study.toml", "-o", "again", cwd=moved).code == 0
    names = compared(moved)
    assert {"answer.json", "results.csv", "sops.csv", "encoding.csv", "ledger.csv", "baselines.csv"} <= {*names}
    assert "timings.csv" not in names
    assert {name for name, path in names.items() if (moved / "again" / name).read_bytes() != path.read_bytes()} == set()
    assert {path.name for path in (moved / "again").glob("*.csv")} - {runner.TIMINGS} == {*names} - {"answer.json"}


@pytest.mark.thorough
def test_the_script_says_whether_the_bytes_are_the_same(bundle, tmp_path):
    moved = tmp_path / "else where"
    shutil.copytree(bundle, moved)
    program = tmp_path / "neurotact"
    runs = f'exec {shlex.quote(sys.executable)} -m neurotact --quiet "$@"\n'
    program.write_text(f"#!/bin/sh\n{runs}")
    program.chmod(0o755)
    path = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    again = ["sh", moved / "reproduce.sh"]
    done = subprocess.run(again, env=os.environ | path, capture_output=True, text=True)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, f"all {len(compared(moved))} files are the same")
    before = (moved / "versions.json").read_text()
    (moved / "tables" / "sops.csv").write_text("other\n")
    (moved / "versions.json").write_text(before.replace('"numpy": "', '"numpy": "0.'))
    done = subprocess.run(again, env=os.environ | path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "tables/sops.csv: FAILED" in done.stderr
    assert done.stderr.endswith("these files are not those of the bundle; unpack it again\n")
    assert not (moved / "changed.txt").exists()
    (moved / "SHA256SUMS").write_text(bundled._hashes([bundled._Source(moved / "data", PurePosixPath("data"))]))
    program.write_text(f'#!/bin/sh\n[ "$1" != --version ] || {{ echo 9.9; exit; }}\n{runs}')
    done = subprocess.run(again, env=os.environ | path, capture_output=True, text=True)
    assert (done.returncode, f"1 of {len(compared(moved))} files differ" in done.stdout) == (1, True)
    assert '<   "numpy": "0.' in done.stdout
    assert f"this study ran with neurotact {nt.__version__}, here is 9.9: bytes may differ" in done.stderr


def test_the_script_takes_the_python_that_has_neurotact_or_says_what_to_do(bundle, tmp_path):
    """Only with these programs on the PATH: a shell's, and what a test writes."""
    moved, programs = tmp_path / "moved", tmp_path / "programs"
    shutil.copytree(bundle, moved)
    programs.mkdir()
    for name in ("sh", "dirname", "rm", "cmp"):
        (programs / name).symlink_to(str(shutil.which(name)))
    again, environment = [str(programs / "sh"), str(moved / "reproduce.sh")], {"PATH": str(programs)}
    (moved / "again").mkdir()
    done = subprocess.run(again, env=environment, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == (
        f"neurotact {nt.__version__} is not here; activate the environment that has it, or install it into this one\n"
    )
    assert (moved / "again").is_dir()
    asked = programs / "python3"
    asked.write_text(
        '#!/bin/sh\n[ "$1 $2" = "-m neurotact" ] || exit 9\n[ "$3" = --version ] || { echo "$@"; exit 7; }\n'
    )
    asked.chmod(0o755)
    done = subprocess.run(again, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (7, "-m neurotact study run study.toml -o again\n")


def test_no_file_of_a_bundle_names_a_place_of_this_machine(bundle, finished):
    places = [str(finished.parent).encode(), str(ROOT).encode(), str(Path.home()).encode() + b"/"]
    named = [path for path in bundle.rglob("*") if path.is_file() and any(one in path.read_bytes() for one in places)]
    assert named == []


def test_the_hashes_are_those_of_all_files(bundle, finished):
    lines = [line.split("  ", 1) for line in (bundle / "SHA256SUMS").read_text().splitlines()]
    there = {path.relative_to(bundle).as_posix() for path in bundle.rglob("*") if path.is_file()} - {"SHA256SUMS"}
    assert {name for _, name in lines} == there
    assert all(hashlib.sha256((bundle / name).read_bytes()).hexdigest() == known for known, name in lines)
    assert (bundle / "recordings.sha256").read_text().splitlines() == [
        "  ".join(line) for line in lines if line[1].startswith("data/")
    ]
    assert (bundle / "data" / "my touches.h5").read_bytes() == (finished.parent / "my touches.h5").read_bytes()


def test_every_table_is_there_as_csv_and_latex_with_its_caption(bundle, finished):
    for path in (bundle / "tables").glob("*.csv"):
        assert path.read_bytes() == (finished / path.name).read_bytes()
        text = path.with_suffix(".tex").read_text()
        assert r"\caption{Felt \& silk\_1: " in text
        assert r"\bottomrule" in text
    assert "one row per trained network" in (bundle / "tables" / "results.tex").read_text()
    assert "Means over seeds" in (bundle / "tables" / "shown-1.tex").read_text()


def widths_of(folder: Path) -> dict[str, float]:
    """The width of each figure in inches."""
    found = {}
    for path in folder.glob("*.pdf"):
        box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+)", path.read_bytes())
        assert box is not None
        found[path.stem] = float(box[1]) / 72
    return found


WIDTHS = {"ieee": 7.16, "nature-column": 85 / 25.4, "ieee-column": 3.5, "nature": 180 / 25.4}


@thinned("width", WIDTHS)
def test_figures_have_the_width_of_a_column(width, bundle, finished, tmp_path):
    folder = bundle if width == "ieee" else nt.bundle_study(finished, tmp_path / width, width=width)
    widths = widths_of(folder / "figures")
    assert {*widths} == {path.stem for path in (finished / "figures").glob("*.svg")}
    assert [*widths.values()] == pytest.approx([WIDTHS[width]] * len(widths), abs=0.01)


def in_columns(width_in: float) -> tuple[Figure, list[Axes]]:
    """A figure of four panels in two columns, of which the upper are twice as high, at a width."""
    figure = new_figure(6.0)
    panels = figure.subplots(2, 2, sharey=True, height_ratios=[2, 1]).ravel().tolist()
    for panel in panels:
        panel.plot([0, 1], label="a name of some length")
        panel.plot([1, 0], label="another one of more length")
    add_legend(figure, panels, 2, title="of the lines")
    figure = prints.fit(figure, width_in)
    figure.draw_without_rendering()
    return figure, panels


def test_panels_stand_below_each_other_in_one_column_and_no_legend_is_wider():
    figure, panels = in_columns(3.5)
    boxes = [panel.get_position() for panel in panels]
    assert all(above.y0 > below.y1 for above, below in pairwise(boxes))
    assert boxes[0].height / boxes[2].height == pytest.approx(2.0, rel=0.15)
    assert figure.get_figheight() == prints.PAGE_in
    assert all(panel.yaxis.get_major_ticks()[0].label1.get_visible() for panel in panels)
    (legend,) = figure.legends
    assert legend.get_window_extent().width <= 3.5 * figure.dpi
    assert [text.get_text() for text in legend.get_texts()] == ["a name of some length", "another one of more length"]
    assert legend.get_title().get_text() == "of the lines"


def test_panels_of_two_columns_stay_beside_each_other():
    figure, panels = in_columns(7.16)
    assert panels[0].get_position().x1 < panels[1].get_position().x0
    assert [*figure.get_size_inches()] == pytest.approx([7.16, 6.0])


def test_without_data_the_hashes_stay_and_the_readme_says_what_is_missing(bundle, finished, tmp_path, monkeypatch):
    without_pictures(monkeypatch)
    out = tmp_path / "bundle"
    (out / "SHA256SUMS").parent.mkdir()
    (out / "SHA256SUMS").touch()
    assert typed("study", "bundle", finished, "-o", out, "--without-data").code == 2
    assert typed("study", "bundle", finished, "-o", out, "--without-data", "--force").code == 0
    assert not (out / "data").exists()
    assert (out / "recordings.sha256").read_bytes() == (bundle / "recordings.sha256").read_bytes()
    assert "`data/my touches.h5`" in (out / "README.md").read_text()
    assert "-c SHA256SUMS recordings.sha256 >" in (out / "reproduce.sh").read_text()
    readme = (bundle / "README.md").read_text()
    assert "not here" not in readme
    assert f"It needs neurotact {nt.__version__} (Python 3." in readme
    assert "The parts of the study took 1 min, one after another." in readme
    assert f'ends with "all {len(compared(bundle))} files are the same"' in readme


def test_what_cannot_be_a_bundle_is_refused_and_stays(finished, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    with pytest.raises(InputError, match="is not a bundle"):
        nt.bundle_study(finished, tmp_path / "mine", force=True)
    assert (tmp_path / "mine" / "thesis.tex").is_file()
    with pytest.raises(InputError, match="holds the study"):
        nt.bundle_study(finished, finished.parent, force=True)
    for inside in (finished / "b", finished / "new" / "b", finished / "spikes"):
        with pytest.raises(InputError, match=r"is in the folder of the study; choose one beside it, .*run-bundle$"):
            nt.bundle_study(finished, inside, force=True)
        assert inside.name != "b" or not inside.exists()
    with pytest.raises(InputError, match="width: 'a4' is unknown"):
        nt.bundle_study(finished, tmp_path / "b", width="a4")  # pyright: ignore[reportArgumentType]
    copy = tmp_path / "copy"
    shutil.copytree(finished, copy)
    shutil.rmtree(next((copy / "cells").iterdir()))
    with pytest.raises(InputError, match="is not finished; neurotact study resume"):
        nt.bundle_study(copy, tmp_path / "b")
    (finished.parent / "my touches.h5").rename(finished.parent / "away.h5")
    try:
        with pytest.raises(InputError, match="recordings of this study are not there"):
            nt.bundle_study(finished, tmp_path / "b")
    finally:
        (finished.parent / "away.h5").rename(finished.parent / "my touches.h5")
    assert not (tmp_path / "b").exists()
    assert not list(tmp_path.glob(".*"))


def test_methods_and_references_are_those_of_the_study(bundle):
    methods, entries = ((bundle / name).read_text() for name in ("methods.md", "references.bib"))
    assert "Windows of 50 ms were classified, the first of which begins 80 ms after" in methods
    assert f"The data were {made_inputs.touches().summary()}." in methods
    assert "RA-I refractory period in ms with SA-I refractory period in ms (1 with 1 and 5 with 10)" in methods
    assert "hidden neurons 3" in methods
    assert re.search(r"There were \d+ afferents\.", methods)
    assert "tuned on the validation trials: on signals (mean and deviation): logistic regression" in methods
    assert f"neurotact {nt.__version__}" in methods
    assert "@misc{neurotact" in entries
    assert f"note = {{Version {nt.__version__}}}" in entries
    assert "10.1109/ISSCC.2014.6757323" in entries
    assert "of = " not in entries
