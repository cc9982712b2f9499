"""What a notebook and a prompt show: short texts, tables, and one line for what the user got wrong."""

import subprocess
import sys

import numpy as np
import pytest

import neurotact as nt
from neurotact.errors import InputError
from neurotact.metrics.synops import synops
from neurotact.networks.training.epochs import Epoch, Training

CELLS = """
import contextlib, io
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
def said(cell):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        shell.run_cell(cell)
    return out.getvalue().strip()
said("import neurotact as nt")
one = said("nt.RSNN(4, 2, hiden=3, sampling_rate_Hz=1000.0)")
assert one.count("\\n") == 0 and one.startswith("InputError: hiden: unknown key"), one
assert "Traceback" in said("%tb Verbose") or "override(table, keys)" in said("%tb Verbose")
assert said("nt.RSNN(4, 2, hiden=3, sampling_rate_Hz=1000.0)") == one
"""


def test_an_error_of_input_is_one_line():
    pytest.importorskip("IPython")
    assert InputError("hiden: unknown key")._render_traceback_() == [
        "InputError: hiden: unknown key  [%tb Verbose shows the traceback]"
    ]


@pytest.mark.thorough
def test_in_a_notebook_it_is_that_line_and_its_traceback_on_request():
    pytest.importorskip("IPython")
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", CELLS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_spec_shows_the_keys_that_differ_and_all_in_a_notebook():
    spec = nt.RSNNSpec(hidden=20, training=nt.TrainingSpec(epochs=15))
    assert repr(spec) == "RSNNSpec(hidden=20, training=TrainingSpec(epochs=15))"
    assert "tau_mem_ms" in spec._repr_html_()
    assert eval(repr(spec), {"RSNNSpec": nt.RSNNSpec, "TrainingSpec": nt.TrainingSpec}) == spec


def test_histories_and_costs_are_short_and_become_tables():
    log = tuple(Epoch(number, 1 / number, 0.5, 1 / number, 0.5) for number in range(1, 40))
    training, cost = Training(log, log[-1]), synops(np.arange(99), np.arange(99), 30, 8, recurrent=True)
    assert len(repr(training)) < 120 > len(repr(cost))
    assert (len(training.table()), len(cost.table())) == (39, 99)
    assert training._repr_html_().count("<tr") == 40
    assert "<table" in cost._repr_html_()
