"""Tables hold the same rows whatever their suffix."""

import json

import numpy as np
import pandas as pd
import pytest

from neurotact.errors import InputError
from neurotact.export.tables import sops_summary, write_table
from neurotact.metrics.synops import summary, to_table

TABLE = pd.DataFrame({"name": ["a|b", "é"], "n": [1, 2], "sops": [1 / 3, np.nan]})


def test_json_and_csv_keep_every_digit(tmp_path):
    for suffix in ("csv", "json"):
        write_table(TABLE, tmp_path / f"t.{suffix}")
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "t.csv"), TABLE, rtol=1e-15)
    assert json.loads((tmp_path / "t.json").read_text()) == [
        {"name": "a|b", "n": 1, "sops": 1 / 3},
        {"name": "é", "n": 2, "sops": None},
    ]


def test_markdown_begins_with_what_it_is_about(tmp_path):
    write_table(TABLE, tmp_path / "t.md", about="# Title\n")
    head, *rows = (tmp_path / "t.md").read_text().split("\n\n")[1].splitlines()
    assert (tmp_path / "t.md").read_text().startswith("# Title\n\n| name |")
    assert head == "| name | n | sops |"
    assert rows[1:] == ["| a\\|b | 1 | 0.333333 |", "| é | 2 | - |"]


def test_the_sops_of_single_windows_stand_under_their_means():
    table = to_table(labels=["a", "b"], predicted=["b", "b"], steps=[300, 100], input_spikes=[10, 0],
                     hidden_spikes=[4, 0], n_hidden=30, n_readout=8)  # fmt: skip
    told = sops_summary(summary(table), "run, full window")
    assert "| all | 2 | 0.5 | 200 |" in told
    assert told.startswith("# Synaptic operations (SOPs) of run, full window")
    sides = sops_summary(summary(table.assign(side=["test", "training"])), "run, full window")
    assert "the sides of the split apart" in sides
    assert "| training | all | 1 | 1 (seen in training) | 100 |" in sides
    assert "| test | all | 1 | 0 | 300 |" in sides


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"t\.xls.*\.csv, \.json, \.md"):
        write_table(TABLE, tmp_path / "t.xls")
