"""A command imports what it uses: none that describes waits for torch, and none that reads or shows for scipy."""

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.networks.definition import optimisers

COMMANDS = """
import json, sys
from types import ModuleType
from typer.main import get_command
from neurotact.cli import main
from neurotact.cli.commands import app

def names(group, before=()):
    for name in group.commands:
        inner = group.commands[name]
        yield from names(inner, (*before, name)) if hasattr(inner, "commands") else ((*before, name),)
    yield before

def loaded(*words):
    sys.argv = ["neurotact", *words]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
    return [name for name, module in sys.modules.items() if type(module) is ModuleType]
"""
HELP = "found = {' '.join(name): loaded(*name, '--help') for name in names(get_command(app))}"
FILES = "found = {' '.join(words): loaded(*words) for words in json.loads(sys.argv[1])}"
SHOWS = "\njson.dump(found, open('found.json', 'w'))"
ALL = {"torch", "scipy", "sklearn", "matplotlib", "nni", "nir", "snntorch", "distributed"}


def run(tmp_path, script: str, *words: str) -> dict[str, list[str]]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run(
        [sys.executable, "-c", COMMANDS + script + SHOWS, *words], cwd=tmp_path, check=True, env=environment,
        capture_output=True,
    )  # fmt: skip
    return json.loads((tmp_path / "found.json").read_text())


def test_no_help_loads_what_computes(tmp_path):
    found = run(tmp_path, HELP)
    assert {"", "train", "study run", "export", "simulate gratings", "import nwb"} <= {*found}
    assert {name: each for name, modules in found.items() if (each := {"pandas", *ALL} & {*modules})} == {}


@pytest.fixture
def table(tmp_path):
    rows = [f"{trial},{'ab'[trial % 2]},{row},{trial + row % 7}" for trial in range(6) for row in range(20)]
    (tmp_path / "touches.csv").write_text("\n".join(["trial,label,t_ms,p1", *rows]))


def test_what_reads_and_shows_loads_no_more_than_tables_need(table, tmp_path):
    words = "import table touches.csv --unit mV --time-column t_ms -o touches.h5"
    commands = [["list"], ["show", "sa1-ra1-lif"], ["fetch"], words.split(), ["info", "touches.h5"]]
    found = run(tmp_path, FILES, json.dumps(commands))
    assert {name: each for name, modules in found.items() if (each := ALL & {*modules})} == {}
    assert "pandas" not in found["show sa1-ra1-lif"]
    assert len(nt.load(tmp_path / "touches.h5")) == 6


def test_a_study_waits_for_its_processes_without_what_computes(tmp_path):
    """Its own process reads, waits and writes tables; the server of processes loads torch once for all others."""
    words = f"study run {Path(__file__).parent / 'studies' / 'tiny.toml'} -o run --set sweep.seed=[0]"
    changes = ["--set", "sweep.network.hidden=[4]", "--set", "network.training.epochs=1"]
    (found,) = run(tmp_path, FILES, json.dumps([[*words.split(), *changes]])).values()
    assert not {"joblib", *ALL} & {*found}
    assert (tmp_path / "run" / "report.html").is_file()


def printed(script: str) -> str:
    """What a script prints in a process of its own."""
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout


def test_the_server_of_processes_puts_nothing_off():
    script = (
        "import sys\nfrom neurotact.lazily import lazily\n"
        "with lazily():\n    import neurotact.studies.networks, pandas\n"
        "import neurotact.loaded\nprint({type(each).__name__ for each in sys.modules.values()} & {'_Late'})"
    )
    assert printed(script) == "set()\n"


@given(st.sampled_from([*optimisers.USUAL]), st.sampled_from([*optimisers.OPTIONS]))
def test_what_is_known_of_optimisers_without_torch_is_so(name, option):
    assert optimisers.named(name) in optimisers.names()
    assert optimisers.takes(name, option) == (option in inspect.signature(getattr(torch.optim, name)).parameters)


def test_the_package_itself_loads_nothing(tmp_path):
    script = (
        "import neurotact, sys; assert not {'numpy', 'pandas', 'torch', 'pydantic'} & {*sys.modules}; neurotact.train"
    )
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)


def test_a_module_that_is_put_off_is_the_module(tmp_path):
    """It is registered once, is loaded by its first use, and what fails to load fails again."""
    script = """
import sys
from neurotact.lazily import lazily
with lazily():
    import pandas as pd
    from neurotact import neurons
with lazily():
    import pandas
assert pandas is pd is sys.modules["pandas"] and "numpy" not in sys.modules
from neurotact.neurons import LIF
assert neurons.LIF is LIF and neurons.__doc__ and "pandas.core" not in sys.modules
assert pd.DataFrame({"a": [1]}).shape == (1, 1) and "pandas.core" in sys.modules
assert vars(neurons)["LIF"] is LIF and neurons.__loader__ is neurons.__spec__.loader
assert not [finder for finder in sys.meta_path if "neurotact.lazily" in str(type(finder))]
"""
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)


def test_what_is_set_on_a_module_that_is_put_off_stays():
    script = (
        "from neurotact.lazily import lazily\nwith lazily():\n    from neurotact import neurons\n"
        "neurons.LIF = 5\nprint(neurons.LIF, neurons.__name__, neurons.LIF)"
    )
    assert printed(script) == "5 neurotact.neurons 5\n"


def test_a_module_that_fails_to_load_fails_where_it_is_used_and_is_tried_again(tmp_path):
    script = """
import pathlib
import neurotact
from neurotact.lazily import lazily
neurotact.__path__.append(".")
pathlib.Path("made.py").write_text("import no_such_module")
with lazily():
    from neurotact import made
for _ in range(2):
    try:
        made.value
    except ModuleNotFoundError as error:
        assert error.name == "no_such_module"
    else:
        raise AssertionError
pathlib.Path("made.py").write_text("value = 5  # of another length")
assert made.value == 5
"""
    subprocess.run([sys.executable, "-B", "-c", script], cwd=tmp_path, check=True)


def test_threads_that_use_a_module_at_once_wait_for_it(tmp_path):
    script = """
import threading
from neurotact.lazily import lazily
with lazily():
    import pandas as pd
found = []
threads = [threading.Thread(target=lambda: found.append(pd.DataFrame)) for _ in range(8)]
for each in threads: each.start()
for each in threads: each.join()
assert len(found) == 8
"""
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)


def test_a_package_is_loaded_before_its_modules():
    """Where parts of pandas were loaded first, it crashed the process."""
    script = (
        "import sys\nfrom neurotact.lazily import lazily\nwith lazily():\n    import pandas\n"
        "late = type(sys.modules['pandas']).__name__\nimport pandas._libs.lib\n"
        "print(late, type(sys.modules['pandas']).__name__, pandas.to_numeric(['1']).tolist())"
    )
    assert printed(script) == "_Late module [1]\n"
