"""C says what its twin says, spike by spike, for every kind of chain; and its text holds what it must."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import made_chains
import numpy as np
import pytest
from compiled import chosen, compare, compare_on, kinds_of, pressed, spikes_of
from levels import thinned
from made_chains import ADAPTING, make_chain, make_encoder, make_signal
from neurotact_parts.exporters.c import c_export, proof
from neurotact_parts.streams.chain import chain_of
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.training import run_folder

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason=str(proof.missing("cc")))
FALLING = {"afferents": {"sa1.opposite": True, "ra1.gain": 90.0}}
"""A second SA-I under each taxel, of the falling signal."""
CLOSED = {"afferents": {**FALLING["afferents"], "integration": "exact", "sa1.t_ref_ms": 5.0, "ra1.t_ref_ms": 5.0}}
KINDS = {
    "paper": ({"ema_cutoff_Hz": 30.0, "baseline": "start", "scale": (2.0, 0.5)}, {"patience": 5}),
    "delayed": ({"baseline": "start"}, {"membrane": "delayed", "reset": "subtract", "recurrent_delay_steps": 1}),
    "immediate": (
        {"baseline": "high-pass", "high_pass_Hz": 2.0, "rectify": True},
        {"membrane": "immediate", "reset": "hard", "patience": 3},
    ),
    "feed-forward": ({"baseline": "start", "offset": (0.1, -0.2)}, {"model": "snn", "membrane": "immediate"}),
    "integrator": (
        {"offset": (1.0, 1.2), "scale": (0.5, 0.7)},
        {"readout": "integrator", "patience": 4, "windows": {"length_ms": 30, "hop_ms": 9}},
    ),
    "leaky": ({"scale": (0.5, 0.7)}, {"readout": "leaky", "patience": 6, "windows": {"length_ms": 30, "hop_ms": 9}}),
    "max": ({"offset": (1.0, 1.2)}, {"readout": "max", "patience": 3, "membrane": "immediate"}),
    "smoothed": ({"ema_cutoff_Hz": 30.0}, {}),
    "scaled, of an integrator": ({"scale": (0.5, 0.7)}, {"readout": "integrator", "patience": 4}),
    "adapting": ({"ema_cutoff_Hz": 30.0}, {**ADAPTING, "patience": 5}),
    "adapting, delayed": (
        {"scale": (0.5, 0.7)},
        {**ADAPTING, "membrane": "delayed", "reset": "subtract", "recurrent_delay_steps": 1, "readout": "integrator"},
    ),
    "adapting, immediate": ({}, {**ADAPTING, "membrane": "immediate", "reset": "hard", "model": "snn", "patience": 4}),
    "contact": ({}, {"windows": {"length_ms": 25, "contact": True, "quiet_ms": 4, "start_ms": 11}, "patience": 2}),
    "faster": ({"resample_Hz": 1000.0, "ema_cutoff_Hz": 30.0}, {"rate_Hz": 370.0, "reset": "hard"}),
    "slower": ({"resample_Hz": 1000.0}, {"rate_Hz": 1700.0, "membrane": "delayed", "recurrent_delay_steps": 1}),
    "many": ({}, {"hidden": 300, "forward_weight_scale": 2.0, "n_taxels": 130}),
    "inverted": ({"baseline": "start", "offset": (0.1, -0.2), "scale": (-2.0, 0.5)}, {"patience": 5}),
    "falling": ({"baseline": "start", "scale": (2.0, 0.5)}, {**FALLING, "patience": 5}),
    "falling, resampled": (
        {"resample_Hz": 1000.0, "baseline": "high-pass", "high_pass_Hz": 2.0, "offset": (0.1, -0.2)},
        {**FALLING, "rate_Hz": 370.0, "readout": "integrator", "membrane": "delayed", "step_ms": 3.0},
    ),
    "graded": (
        {"baseline": "start", "scale": (2.0, -0.5)},
        {
            "afferents": {
                "sa1.grades": [0.5, 1.0, 3.0],
                "sa1.opposite": True,
                "ra1.grades": [0.4, 2.0],
                "ra1.gain": 60.0,
            }
        },
    ),
    "closed form": (
        {"resample_Hz": 1000.0, "baseline": "start", "scale": (2.0, -0.5)},
        {**CLOSED, "rate_Hz": 35.6, "readout": "integrator", "patience": 40},
    ),
    "closed form, resampled": ({"resample_Hz": 1000.0, "ema_cutoff_Hz": 30.0}, {**CLOSED, "rate_Hz": 1700.0}),
    "closed form, many": (
        {"resample_Hz": 200.0},
        {**CLOSED, "rate_Hz": 60.0, "n_taxels": 90, "windows": {"length_ms": 200}},
    ),
    "falling, many": ({"baseline": "start"}, {**FALLING, "n_taxels": 90, "forward_weight_scale": 1.0}),
}


def made(kind: str):
    conditioning, options = KINDS[kind]
    return make_chain(conditioning, **options)


@needs_compiler
@thinned("kind", [*KINDS], every=3)
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_c_says_what_its_twin_says(kind, variant, tmp_path):
    chain = made(kind)
    signals = [make_signal(150, chain.n_taxels, seed=k) for k in range(3)]
    if variant == "integer" and (chain.network.adaptation is not None or chain.network.leaks):
        with pytest.raises(InputError, match="C in integers does not run it"):
            chosen(chain, signals, state_bits=16)
        return
    formats = None if variant == "float" else chosen(chain, signals, state_bits=16)
    difference, expected = compare(chain, tmp_path, formats)
    assert difference is None
    assert all(n > 0 for n in spikes_of(expected))
    assert kinds_of(expected, chain) == {*range(chain.network.n_inputs // chain.n_taxels)} or not chain.lif.sa1.opposite


@needs_compiler
@thinned("variant", ["integer", "float"])
def test_c_feels_the_press_and_the_release_of_real_presses(variant, data_folder, tmp_path):
    chain, presses = pressed(data_folder)
    formats = chosen(chain, presses) if variant == "integer" else None
    difference, expected = compare_on(presses, chain, tmp_path, formats, flags=proof.SANITIZERS)
    assert difference is None
    assert kinds_of(expected, chain) == {0, 1, 2}
    assert all(n > 10 for n in spikes_of(expected))


@needs_compiler
@pytest.mark.parametrize("variant", ["float", "integer"])
@pytest.mark.parametrize("rate_Hz", [370.0, 1700.0])
def test_c_decides_a_window_as_long_as_the_trial(variant, rate_Hz, tmp_path):
    n_samples, conditioning = 150, {"resample_Hz": 1000.0, "ema_cutoff_Hz": 30.0}
    chain = make_chain(conditioning, rate_Hz=rate_Hz, windows={"length_ms": 1e3 * n_samples / rate_Hz})
    formats = None if variant == "float" else chosen(chain, [make_signal(n_samples)], state_bits=16)
    difference, expected = compare(chain, tmp_path, formats, n=1, n_samples=n_samples)
    assert difference is None
    assert [row[2] for row in expected[0].decisions] == [round(1e3 * n_samples / rate_Hz)]
    assert all(n > 0 for n in spikes_of(expected))


@needs_compiler
def test_the_example_reads_to_the_end_of_a_trial(tmp_path):
    chain = make_chain({"resample_Hz": 1000.0}, rate_Hz=100.0, windows={"length_ms": 400})
    c_export.write(chain, tmp_path, None, name="skin")
    flags = proof.WARNINGS
    subprocess.run(["cc", *flags, "skin.c", "example.c", "-o", "example"], cwd=tmp_path, check=True)
    lines = "".join(f"{a},{b}\n" for a, b in make_signal(40).tolist())
    said = subprocess.run(["./example"], cwd=tmp_path, input=lines, capture_output=True, text=True, check=True).stdout
    assert re.fullmatch(r"0 \w+ 400 steps \d+ spikes\n", said)


@needs_compiler
@pytest.mark.parametrize("membrane", ["eq4", "immediate"])
def test_c_adapts_from_what_was_sent_where_a_threshold_is_negative(membrane, tmp_path):
    chain = make_chain({}, **ADAPTING, membrane=membrane)
    chain.network.threshold.data[0] = -0.1
    difference, expected = compare(chain, tmp_path, None)
    assert difference is None
    assert spikes_of(expected)[1] > 0


@needs_compiler
@thinned("bits", [(8, 24), (2, 8), (5, 12)])
def test_c_keeps_to_its_twin_where_states_saturate(bits, tmp_path):
    """Formats from a quiet recording, so that the loud one leaves every range."""
    chain = make_chain({"ema_cutoff_Hz": 30.0}, patience=5, forward_weight_scale=8.0)
    formats = chosen(chain, [0.2 * make_signal(150, seed=k) for k in range(2)], weight_bits=bits[0], state_bits=bits[1])
    loud = formats._replace(raw=formats.raw._replace(lsb=formats.raw.lsb / 4))
    difference, _ = compare(chain, tmp_path, loud, flags=("-O1", *proof.SANITIZERS[2:]))
    assert difference is None


@needs_compiler
def test_the_sanitizers_find_nothing(tmp_path):
    assert compare(made("adapting"), tmp_path / "adapting", None, flags=proof.SANITIZERS)[0] is None
    chain = made("slower")._replace(windows=made("contact").windows)
    assert compare(chain, tmp_path / "float", None, flags=proof.SANITIZERS)[0] is None
    formats = chosen(chain, [make_signal(150)], state_bits=24)
    assert compare(chain, tmp_path / "integer", formats, flags=proof.SANITIZERS)[0] is None


@needs_compiler
def test_a_stream_decides_what_the_float_variant_decides(tmp_path):
    chain = made("paper")
    _, expected = compare(chain, tmp_path, None, n=1)
    found = [
        (d.window, d.start_step, d.steps, d.input_spikes, d.hidden_spikes, int(d.heard), d.index)
        for d in Stream(chain).decide([make_signal(150)])
    ]
    assert [row for row in found if row[1] + chain.windows.length <= 150] == expected[0].decisions


def test_a_difference_is_named():
    one = proof.Spoken([(0,), ()], {0: [(1,)]}, [(0, 0, 2, 1, 1, 1, 0)])
    assert proof.first_difference([one], [one]) is None
    cases = {
        r"trial 0, afferents, step 1: \(\) where \(3,\)": one._replace(afferents=[(0,), (3,)]),
        r"trial 0, window 0, hidden neurons, step 0": one._replace(hidden={0: [(2,)]}),
        r"trial 0, window 1, hidden neurons, 0 steps where 1": one._replace(hidden={0: [(1,)], 1: [()]}),
        r"decision \(0, 0, 2, 1, 1, 1, 0\) where": one._replace(decisions=[(0, 0, 2, 1, 1, 1, 1)]),
        r"1 decisions where 0": one._replace(decisions=[]),
        r"2 steps where 1": one._replace(afferents=[(0,)]),
    }
    for message, other in cases.items():
        assert re.search(message, str(proof.first_difference([one], [other]))), message


def test_the_source_keeps_to_its_rules(tmp_path):
    chain = made("paper")
    c_export.write(chain, tmp_path, chosen(chain, [make_signal(150)]), name="skin")
    source = (tmp_path / "skin.c").read_text() + (tmp_path / "skin.h").read_text()
    assert re.findall(r"#include [<\"](.*)[>\"]", source) == ["skin.h", "stdint.h"]
    assert not re.search(r"\b(float|double|malloc|free|math)\b", re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL))
    assert {path.name for path in tmp_path.iterdir()} == {"skin.c", "skin.h", "example.c", "README.md"}


@needs_compiler
@pytest.mark.parametrize("variant", ["integer", "converted", "float"])
def test_the_example_decides_and_names_what_is_no_sample(variant, tmp_path):
    chain = made("paper")
    signal = np.rint(make_signal(150)) if variant == "integer" else make_signal(150)
    formats = None if variant == "float" else chosen(chain, [signal])
    c_export.write(chain, tmp_path, formats)
    build = ["cc", *proof.WARNINGS, "touch.c", "example.c", "-o", "example"]
    subprocess.run(build, cwd=tmp_path, check=True)

    def run(text: str) -> tuple[int, str, str]:
        done = subprocess.run([tmp_path / "example"], input=text, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout, done.stderr

    rows = "".join(f"{9 * k}, {-k}\n" for k in range(90))
    code, decided, complaint = run(rows)
    assert (code, complaint) == (0, "")
    assert [line.split()[0] for line in decided.splitlines()] == ["0", "1"]
    assert run("left,right\n" + rows)[::2] == (2, _complaint(1, variant))
    assert run(rows + "5,x\n" + rows)[::2] == (2, _complaint(91, variant))
    assert run(rows + "5,x\n" + rows)[1] == decided
    if variant == "converted":
        assert formats is not None
        assert not formats.raw.is_plain
        program = '#define main of_example\n#include "example.c"\n#undef main\nint main(void) { double signal; '
        program += 'while (scanf("%lf", &signal) == 1) printf("%d\\n", sample_of(signal)); return of_example(); }\n'
        (tmp_path / "convert.c").write_text(program)
        subprocess.run(["cc", *proof.WARNINGS, "touch.c", "convert.c", "-o", "example"], cwd=tmp_path, check=True)
        signals = np.random.default_rng(0).normal(0, 40, 50)
        samples = run("".join(f"{x!r}\n" for x in signals.tolist()))[1]
        assert [int(x) for x in samples.split()] == formats.raw.samples(signals).tolist()
        return
    if variant == "integer":
        assert run("1,2\n0.5,1\n")[::2] == (2, _complaint(2, variant))
        assert run("1,2\n1,32768\n")[::2] == (
            2, "sample 2: 32768 does not fit in 16 bits; give -32768 to 32767\n"
        )  # fmt: skip
    else:
        words = "8 samples with repeated values, 1 gaps, 5 samples skipped\n"
        spoilt = "nan,1\n" * 3 + "0,0\n" * 9 + "inf,1\n" * 6 + "1,-inf\n" * 4
        assert run(rows + spoilt)[::2] == (0, words)


def _complaint(row: int, variant: str) -> str:
    kind = "whole numbers" if variant == "integer" else "numbers"
    return f"sample {row}: is not 2 {kind}; give one line a sample, without a header\n"


def test_class_names_are_c_strings(tmp_path):
    network = RSNN(4, 2, hidden=3, sampling_rate_Hz=1000.0)
    chain = chain_of((make_encoder(), network))._replace(classes=('a "b"\\', "café??/"))
    c_export.write(chain, tmp_path)
    assert r'{"a \042b\042\134", "caf\303\251\077\077/"}' in (tmp_path / "touch.c").read_text()


@needs_compiler
def test_names_that_are_no_text_are_escaped_and_end_no_comment(tmp_path):
    chain = made("smoothed")
    encoder = chain.encoder.model_copy(update={"unit": "mV */ int x; /* \ud800\n"})
    odd = chain._replace(classes=("\udc80felt", "a\nb", "\\"), encoder=encoder)
    c_export.write(odd, tmp_path)
    assert r'{"\134udc80felt", "a\012b", "\134"}' in (tmp_path / "touch.c").read_text()
    subprocess.run(["cc", *proof.WARNINGS, "touch.c", "example.c", "-o", "example"], cwd=tmp_path, check=True)


@pytest.mark.parametrize("name", ["2skins", "a b", "ü", "", "int x"])
def test_a_name_that_c_does_not_take_is_refused(name, tmp_path):
    with pytest.raises(InputError, match="must be a C name"):
        c_export.write(made("paper"), tmp_path, name=name)


def test_a_harness_that_stops_is_no_success(tmp_path):
    (tmp_path / "skin.h").write_text("const uint8_t *afferents, const uint8_t *neurons,")
    with pytest.raises(InputError, match="stopped in the middle"):
        proof._parsed(b"E", "skin", tmp_path)


def test_trials_of_another_type_are_refused():
    with pytest.raises(InputError, match="must be int16 or float32"):
        proof._packed([np.zeros((3, 2))])


def exported(folder: Path, run: Path, **options) -> dict[str, bytes]:
    nt.export_c(run, folder, **options)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_an_export_needs_the_run_folder_alone(tmp_path):
    """Training saves the ranges that an export computes from the recordings, where they are given."""
    made_chains.make_run(tmp_path)
    due = exported(tmp_path / "due", tmp_path / "run", recordings=tmp_path / "skin.h5")
    shutil.move(tmp_path / "run", tmp_path / "elsewhere")
    (tmp_path / "skin.h5").unlink()
    (tmp_path / "spikes.h5").unlink()
    assert exported(tmp_path / "found", tmp_path / "elsewhere") == due


def changed(run: Path, ranges: dict | None) -> None:
    path = run / "network.json"
    table = json.loads(path.read_text())
    table["extra"]["ranges"] = ranges
    path.write_text(json.dumps(table))


def test_a_run_without_ranges_names_the_fix_and_a_damaged_one_its_file(tmp_path):
    run = made_chains.make_run(tmp_path) / "run"
    due = exported(tmp_path / "due", run)
    changed(run, None)
    with pytest.raises(InputError, match=r"does not hold the ranges .* name them with `recordings`, or"):
        nt.export_c(run, tmp_path / "chain")
    assert exported(tmp_path / "found", run, recordings=tmp_path / "skin.h5") == due
    nt.export_c(run, tmp_path / "float", variant="float")
    whole = {"low": -1.0, "high": 1.0, "hidden": 2.0, "readout": 3.0}
    for damaged in ({**whole, "high": "much"}, {**whole, "high": -2.0}, {**whole, "hidden": -1.0}, {"low": 0.0}, 3):
        changed(run, damaged)
        with pytest.raises(InputError, match=r"ranges.*network\.json"):
            nt.export_c(run, tmp_path / "chain")


def test_recordings_that_are_gone_in_training_leave_no_ranges(tmp_path):
    made_chains.make_run(tmp_path)
    (tmp_path / "skin.h5").unlink()
    nt.train(
        tmp_path / "spikes.h5",
        tmp_path / "again",
        "rsnn",
        {"hidden": 4, "training.epochs": 1},
        window=nt.Window(length_ms=40),
    )
    assert run_folder.restore(tmp_path / "again").ranges is None
    assert run_folder.restore(tmp_path / "run").ranges is not None
