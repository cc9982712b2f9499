"""`neurotact stream` and `neurotact export`: a run, a pipe, and what is refused."""

import json
import shutil
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
import torch
from made_chains import make_run, make_signal, told

import neurotact as nt
from neurotact import cli
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings

N = 12


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A network of an epoch, with its spikes and recordings beside it."""
    return make_run(tmp_path_factory.mktemp("chain"), N)


class Done(NamedTuple):
    code: int
    out: list[str]
    err: list[str]


@pytest.fixture
def neurotact(monkeypatch, capsys, tmp_path):
    """The command line in this process; `given` are the bytes of a file that --from names."""

    def call(*words, given: bytes | None = None) -> Done:
        if given is not None:
            (tmp_path / "samples").write_bytes(given)
            words = (*words, "--from", tmp_path / "samples")
        monkeypatch.setattr(sys, "argv", ["neurotact", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        told = capsys.readouterr()
        return Done(int(end.value.code or 0), told.out.splitlines(), told.err.splitlines())

    return call


def test_a_table_becomes_decisions(run, neurotact):
    signal = make_signal(130, seed=3)
    text = "a,b\n" + "".join(f"{a!r},{b!r}\n" for a, b in signal.astype(float).tolist()) + "1,x\n0.5"
    done = neurotact("stream", run / "run", "--json", given=text.encode())
    assert done.code == 0, done.err
    found = [json.loads(line) for line in done.out]
    expected = [d._asdict() for d in nt.Stream(run / "run").push(signal)]
    assert found == expected
    last = done.err[-1]
    assert "130 samples" in last
    assert "missing 1" in last
    assert "bad rows 1, cut off at the end 1" in last


def test_a_clock_at_fault_is_said_as_it_happens_and_counted(run, neurotact):
    signal = make_signal(260, seed=3)
    stamps = [*range(130), *range(130)]
    stamps[40] = 99999
    rows = (f"{t},{a!r},{b!r}\n" for t, (a, b) in zip(stamps, signal.astype(float).tolist(), strict=True))
    done = neurotact("stream", run / "run", "--json", "--time-column", "ms", given="".join(rows).encode())
    assert done.code == 0, done.err
    stream = nt.Stream(run / "run")
    expected = stream.push(signal[:130])
    stream.gap()
    assert [json.loads(line) for line in done.out] == [d._asdict() for d in expected + stream.push(signal[130:])]
    assert [("99999 after 39" in line, "from 129 to 0" in line) for line in done.err] == [
        (True, False), (False, True), (False, False),
    ]  # fmt: skip
    assert "260 samples" in done.err[-1]
    assert "clock restarts 1, time stamps ignored 1" in done.err[-1]


FLOATS = ("sampling-rate-Hz", "lsb", "zero", "window-ms", "start-ms", "hop-ms", "quiet-ms", "hold-ms", "stall-s")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "-1", "0", "1e300", "-1e300", "1e-300"])
@pytest.mark.parametrize("option", FLOATS)
def test_a_number_is_used_or_refused(run, option, value, neurotact):
    words = {"lsb": ["--format", "int16"], "zero": ["--format", "int16"], "quiet-ms": ["--contact"]}
    samples = b"".join(b"%d,%d\n" % (k % 7, k % 3) for k in range(60))
    given = samples if option not in ("lsb", "zero") else np.arange(-60, 60, dtype="<i2").tobytes()
    done = neurotact("stream", run / "run", *words.get(option, []), f"--{option}={value}", given=given)
    assert len(done.err) == 1
    if done.code:
        assert done.code == 2
        assert option.partition("-")[0] in done.err[0].replace("length", "window")
    else:
        assert "60 samples, " in done.err[0]
        assert option == "stall-s" or value in ("-1", "0", "1e-300")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--format", "float32", "--time-column", "ms"], "--time-column: has no effect without --format csv"),
        (["--lsb", "2"], "--lsb: has no effect without --format int16"),
        (["--format", "float32", "--zero", "2"], "--zero: has no effect without --format int16"),
    ],
)
def test_an_option_without_effect_is_refused(run, words, message, neurotact):
    done = neurotact("stream", run / "run", *words, given=b"1,2\n")
    assert (done.code, len(done.err)) == (2, 1)
    assert message in done.err[0]


def test_a_class_name_that_is_no_text_is_escaped(run, tmp_path, neurotact):
    odd = tmp_path / "odd"
    shutil.copytree(run / "run", odd)
    about = (odd / "network.json").read_text()
    (odd / "network.json").write_text(about.replace('"felt"', '"\\udc80felt\\u001b[2J"'))
    signal = make_signal(130, seed=3).astype(float).tolist()
    done = neurotact("stream", odd, given="".join(f"{a!r},{b!r}\n" for a, b in signal).encode())
    assert done.code == 0, done.err
    assert all(line.isprintable() for line in done.out)
    assert neurotact("export", odd, "--to", "c", "--variant", "float", "-o", tmp_path / "c").code == 0
    assert r'"\134udc80felt\033[2J"' in (tmp_path / "c" / "touch.c").read_text()


@pytest.mark.parametrize("early_exit", [False, True])
def test_a_stream_counts_the_operations_that_infer_counts(run, early_exit, neurotact):
    counted = nt.infer(run / "run", run / "spikes.h5", early_exit=early_exit)
    words = [] if early_exit else ["--full-window"]
    done = neurotact("stream", run / "run", "--from", run / "skin.h5", "--json", *words)
    rows = [json.loads(line) for line in done.out]
    whole = [row for row in rows if row["start_step"] + 40 <= 130]  # infer has no window that the trial cuts off
    assert [row["sops"] for row in whole] == counted["sops_total"].tolist()
    assert [row["input_spikes"] for row in whole] == counted["input_spikes"].tolist()
    assert counted["sops_total"].nunique() > 10
    said = neurotact("stream", run / "run", "--from", run / "skin.h5", *words).out
    assert [f", {row['sops']} SOPs" in line for row, line in zip(rows, said, strict=True)] == [True] * len(rows)


def test_recordings_become_decisions_in_words(run, neurotact):
    done = neurotact("stream", run / "run", "--from", run / "skin.h5", "--full-window", "--hop-ms", "30")
    assert done.code == 0, done.err
    assert len(done.out) == 4 * N
    assert all("after 40 steps (40 ms)" in line for line in done.out)
    assert "unfinished 12" in done.err[-1]


@pytest.mark.parametrize(
    ("words", "given", "message"),
    [
        ([], b"1,2,3\n", "line 1 has 3 values"),
        ([], b"", "samples: has no sample"),
        (["--format", "int16"], b"1,2\n3,4\n", "pass --format csv"),
        (["--format", "wav"], b"", "Invalid value for '--format'"),
        (["--rate", "slow"], b"", "--rate slow: is unknown"),
        (["--time-column", "h"], b"", "Invalid value for '--time-column'"),
        (["--from", "/no/such/pipe"], None, "/no/such/pipe: cannot be read"),
        (["--unit", "count"], b"", "'count' but 'mV'"),
        (["--contact", "--quiet-ms", "0"], b"", "quiet_ms"),
    ],
)
def test_what_cannot_be_used_is_one_line(run, words, given, message, neurotact):
    done = neurotact("stream", run / "run", *words, given=given)
    assert done.code == 2
    assert message in done.err[0]
    assert len(done.err) == 1
    assert not done.out


@pytest.mark.slow
def test_nobody_listening_is_no_fault(run):
    row = b"0.1,0.2\n" * 1000
    words = [sys.executable, "-m", "neurotact", "stream", str(run / "run")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        process.stdin.write(row)
        process.stdin.close()
        assert b"Traceback" not in process.stderr.read()
        assert process.wait(60) == 0


def test_an_export_is_written_once(run, tmp_path, neurotact):
    done = neurotact("export", run / "run", "--to", "c", "-o", tmp_path / "c", "--name", "skin", "--state-bits", "16")
    assert done.code == 0, done.err
    assert "2 taxels, 4-5-2 neurons, 8-bit weights, 16-bit states" in done.out[-1]
    again = neurotact("export", run / "run", "--to", "c", "-o", tmp_path / "c", "--name", "skin")
    assert again.code == 2
    assert "skin.h: already exists" in again.err[0]
    assert nt.export_c(run / "run", tmp_path / "c", variant="float", name="skin", force=True).formats is None
    assert "float arithmetic" in (tmp_path / "c" / "skin.c").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "needs --to NAME (bill, c, neurobench, nir, xyloaudio2)"),
        (["--to", "vhdl", "-o", "x"], "there is none called 'vhdl'; known: bill, c, neurobench, nir, xyloaudio2"),
        (["--to", "c", "-o", "x", "--variant", "double"], "'double' is not one of 'integer', 'float'"),
        (["--to", "c", "-o", "x", "--weight-bits", "9"], "weight_bits: must be from 2 to 8"),
        (["--to", "c", "-o", "x", "--state-bits", "20"], "state_bits: must be from 8 to 16, or 24"),
        (["--to", "c", "-o", "x", "--lsb", "nan"], "lsb: must be a positive number"),
        (["--to", "c", "-o", "x", "--recordings", "no.h5"], "no.h5"),
        (["--check", "loihi3"], "did you mean 'loihi2'"),
    ],
)
def test_an_export_that_cannot_be_is_one_line(run, tmp_path, words, message, monkeypatch, neurotact):
    monkeypatch.chdir(tmp_path)
    done = neurotact("export", run / "run", *words)
    assert done.code == 2
    assert message in done.err[0]
    assert not list(tmp_path.iterdir())


def test_a_check_names_what_stands_in_the_way(run, neurotact):
    done = neurotact("export", run / "run", "--check", "xyloaudio2")
    assert done.code == 0, done.err
    assert any(line.startswith("NOT  membrane: eq4; immediate; train again") for line in done.out)
    assert any(line.startswith("fits  inputs: 4; at most 16") for line in done.out)


def test_the_recordings_must_be_those_of_the_run(run, tmp_path):
    other = Recordings(np.zeros((3, 9, 2)), 1000.0, "mV", pd.DataFrame({"label": ["a", "b", "a"]}))
    hdf5.save_recordings(other, tmp_path / "other.h5")
    with pytest.raises(nt.InputError, match=r"does not hold the recordings that .* was encoded from"):
        nt.export_c(run / "run", tmp_path / "c", recordings=tmp_path / "other.h5")


def test_a_run_with_early_exit_streams_with_it_where_its_loss_is_bounded(run, tmp_path):
    signal = make_signal(130, seed=5)
    assert nt.Stream(run / "run").chain.rule.never  # of two validation trials
    shutil.copytree(run / "run", tmp_path / "run")
    path = tmp_path / "run" / "network.json"
    network = json.loads(path.read_text())
    network["extra"]["exit_losses"] = dict.fromkeys(range(299), 0.0)
    path.write_text(json.dumps(network))
    early = nt.Stream(tmp_path / "run")
    full = nt.Stream(tmp_path / "run", streamed=nt.Streamed(full_window=True))
    assert early.chain.rule.patience is not None
    assert [nt.from_nir(nt.to_nir(one / "run")).rule.never for one in (run, tmp_path)] == [True, False]
    chips = [nt.check_chip(one / "run", "loihi2") for one in (run, tmp_path)]
    assert not chips[0].equals(chips[1])
    assert full.chain.rule.patience is None
    assert [row[2] for row in told(full.push(signal))] == [40] * 3
    assert torch.equal(early.chain.network.w_in, full.chain.network.w_in)
