"""What the command line says to a newcomer: an example in every help, groups of options, and few lines of warnings."""

import logging
import shlex

import numpy as np
import pytest
from typer.main import get_command

import neurotact as nt
from neurotact import cli
from neurotact.cli import commands as root
from neurotact.cli.commands import app
from neurotact.cli.help import EXAMPLES, GROUPS, TASKS
from neurotact.encoders import specs
from neurotact.studies import automatic


def commands(group=None, before=""):
    group = group or get_command(app)
    for name in group.commands:
        inner = group.commands[name]
        yield from commands(inner, f"{before}{name} ") if hasattr(inner, "commands") else [(f"{before}{name}", inner)]


COMMANDS = dict(commands())


def test_every_command_has_an_example():
    assert {*EXAMPLES} == {*COMMANDS}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_parses(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = shlex.split(EXAMPLES[name])
    assert words[: 1 + len(name.split())] == ["neurotact", *name.split()]
    COMMANDS[name].make_context(name, words[1 + len(name.split()) :])


def printed(capsys, monkeypatch, *words: str) -> str:
    monkeypatch.setattr("sys.argv", ["neurotact", *words])
    with pytest.raises(SystemExit):
        cli.main()
    return "".join(capsys.readouterr())


def test_a_help_ends_with_its_example_and_has_groups_where_options_are_many(capsys, monkeypatch):
    said = printed(capsys, monkeypatch, "train", "--help")
    assert said.rstrip().endswith(EXAMPLES["train"])
    places = [said.index(f"\n{group}:") for group in ("Options", *GROUPS, "Example")]
    assert places == sorted(places)
    assert said.index("--window-ms") > said.index("\nWindows:")
    assert "Windows:" not in printed(capsys, monkeypatch, "stream", "--help")


def test_the_help_of_the_program_has_each_command_once_by_task_with_study_first(capsys, monkeypatch):
    said = printed(capsys, monkeypatch, "--help")
    places = []
    for task, names in TASKS.items():
        begin = said.index(f"\n{task}:\n")
        places += [begin, *(said.index(f"\n  {name} ", begin) for name in names.split())]
    assert places == sorted(places)
    assert [name for names in TASKS.values() for name in names.split()] == [*root.COMMANDS]
    assert next(iter(root.COMMANDS)) == "study"
    assert "\nCommands:\n" in printed(capsys, monkeypatch, "study", "--help")


@pytest.mark.parametrize("group", ["", "study", "import", "simulate"])
@pytest.mark.parametrize("width", ["40", "80", "120"])
def test_no_line_of_a_command_is_cut(group, width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", width)
    said = printed(capsys, monkeypatch, *group.split(), "--help")
    assert not [line for line in said.splitlines() if line.endswith("...") and not line.endswith("[ARGS]...")]
    lines = {name.split()[-1]: inner for name, inner in COMMANDS.items() if group and name.startswith(f"{group} ")}
    for name, inner in lines.items():
        assert "".join(inner.help.partition("\n\n")[0].split()) in "".join(said.split()), name


def test_the_help_of_calibrate_says_which_membranes_own_recordings_has(capsys, monkeypatch):
    said = " ".join(printed(capsys, monkeypatch, "calibrate", "--help").split())
    own_ms, given_ms = (
        specs.resolve("sa1-ra1-lif", settings).model_dump()["tau_mem_ms"] for settings in ({}, {"tau_mem_ms": 50})
    )
    least_ms, most_ms = (automatic.membrane_ms(length_ms, own_ms) for length_ms in (1.0, 1e6))
    assert f"Membranes keep the spec's time constant, {own_ms:g} ms by default; own-recordings takes" in said
    assert f"takes a twentieth of the window, {least_ms:g} to {most_ms:g} ms: give it as --set tau_mem_ms=50." in said
    assert given_ms == most_ms
    assert automatic.membrane_ms(600.0, own_ms) == 600.0 / 20


@pytest.mark.parametrize(
    ("given", "form"), [("my-data/", "folder"), ("touches.csv", "table"), ("touches.npz", "arrays"), ("a.nwb", "nwb")]
)
def test_import_of_a_path_names_the_form(given, form, capsys, monkeypatch):
    said = printed(capsys, monkeypatch, "import", given)
    assert said == f"neurotact: {given}: say what it is: neurotact import {form} {given} --help\n"


def test_import_of_a_wrong_form_names_the_near_one(capsys, monkeypatch):
    assert "No such command 'foldr'" in printed(capsys, monkeypatch, "import", "foldr")


def folder_of_rasters(tmp_path, n_files):
    for number in range(n_files):
        (tmp_path / "felt").mkdir(exist_ok=True)
        raster = (np.random.default_rng(number).random((50, 3)) < 0.2).astype(np.uint8)
        np.savez(tmp_path / "felt" / f"{number}.npz", x=raster, fs=1000.0)
    return tmp_path


def test_the_same_of_many_files_is_one_line(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        nt.read_raster(folder_of_rasters(tmp_path, 5))
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == len({line.partition(": ")[2][:12] for line in lines}), lines


@pytest.mark.parametrize(("jitter", "is_told"), [(1e-5, False), (0.05, True)])
def test_jitter_is_told_where_it_matters(jitter, is_told, tmp_path, caplog):
    rng = np.random.default_rng(0)
    (tmp_path / "felt").mkdir()
    for number in range(3):
        time_s = np.arange(200) / 1000 + rng.normal(0, jitter / 1000, 200)
        rows = np.column_stack([time_s, rng.normal(size=(200, 2))])
        np.savetxt(tmp_path / "felt" / f"{number}.csv", rows, "%.9f", ",", header="t_s,a,b", comments="")
    with caplog.at_level(logging.WARNING):
        nt.read_folder(tmp_path, unit="mV")
    assert ("jitter" in caplog.text) == is_told
