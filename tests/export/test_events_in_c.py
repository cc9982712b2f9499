"""C of a network that takes the events of a sensor says what a stream says, here and on an emulated Cortex-M0."""

import subprocess

import numpy as np
import pytest
from made_chains import events_of_trial, make_event_run
from neurotact_parts.exporters.c import boards, c_export, export, proof, proving
from neurotact_parts.streams.events import Channels, afferents_of
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.errors import InputError
from neurotact.networks.training import run_folder

pytestmark = pytest.mark.skipif(proof.missing("cc") is not None, reason="there is no C compiler")
STEP_us = 1000


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return make_event_run(tmp_path_factory.mktemp("sensor"))


def events_of(run, chain, trial: int) -> np.ndarray:
    """Times in us and afferents of the events of a trial in the file, and the end of its window, as C takes them."""
    rows = [row.split(",") for row in events_of_trial(run, trial)]
    channels = Channels(afferents_of(chain))
    events = [(int(time), channels.number(channel, polarity)) for time, channel, polarity in rows]
    return np.array([*events, (60_000, proving.ALONE)], np.uint32)


@pytest.mark.skipif(proof.missing("arm-none-eabi-gcc", "qemu-system-arm") is not None, reason="there is no emulator")
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_a_cortex_m0_decides_events_of_a_file_as_infer(run, variant, tmp_path):
    made = export.prepared(run / "run", integer=variant == "integer")
    c_export.write(made.chain, tmp_path, made.formats, parts=c_export.HARNESS)
    board = boards.BOARDS["cortex-m0"]
    board = board._replace(flags=(*board.flags, f"-DTOUCH_TICKS={STEP_us}u"))
    said, _ = proof.on_board(tmp_path, "touch", [events_of(run, made.chain, trial) for trial in range(24)], board)
    found = np.array([decision for one in said for decision in one.decisions])
    expected = nt.infer(run / "run", run / "spikes.h5", early_exit=True)
    classes = np.array(made.chain.classes)
    if variant == "float":
        decided = expected[["steps", "input_spikes", "hidden_spikes"]].to_numpy()
        np.testing.assert_array_equal(found[:, 2:5], decided)
        assert classes[found[:, -1]].tolist() == expected["predicted"].tolist()
    else:  # of rounded weights: every spike equal to the twin in integers
        trials = proving.trials_of(run / "run", made.chain, made.formats, 3)
        board = boards.BOARDS["cortex-m0"]
        said, _ = proof.on_board(tmp_path, "touch", trials.given, board)
        assert proof.first_difference(list(proof.cut_off(said, trials.expected)), trials.expected) is None
        assert (classes[found[:, -1]] == expected["predicted"]).mean() > 0.9


def spoken(folder, rows: list[tuple[int, int]], start: int = 0) -> tuple[list[str], str]:
    """What the example says of events, and of their faults, with a clock that runs from `start` on."""
    source = (
        (folder / "example.c").read_text().replace("reset(&chain);", f"reset(&chain); touch_start(&chain, {start}u);")
    )
    (folder / "started.c").write_text(source)
    flags = [*proof.WARNINGS, *proof.SANITIZERS, f"-DTOUCH_TICKS={STEP_us}u"]
    subprocess.run(["cc", *flags, "touch.c", "started.c", "-o", "started"], cwd=folder, check=True)
    lines = [f"{(time + start) % 2**32}" + f", {channel}" * (channel >= 0) for time, channel in rows]
    text = "\n".join([*lines, ""])
    done = subprocess.run([folder / "started"], input=text, capture_output=True, text=True, check=True)
    return done.stdout.splitlines(), done.stderr


@pytest.mark.parametrize("start", [0, 2**32 - 31_234])
def test_the_example_counts_what_a_stream_counts_and_a_clock_may_wrap(run, start, tmp_path):
    nt.export_c(run / "run", tmp_path, variant="float", streamed=nt.Streamed(length_ms=20, hop_ms=7))
    rng, stream = np.random.default_rng(0), Stream(run / "run", streamed=nt.Streamed(length_ms=20, hop_ms=7))
    times = np.sort(rng.integers(0, 90_000, 200))
    times[rng.random(200) < 0.2] -= 3_000
    times[::9] -= times[::9] % STEP_us  # at the beginning of a step
    rows = [*zip(times.clip(0).tolist(), rng.integers(0, 8, 200).tolist(), strict=True), (100_000, -1)]
    rows[100:100] = [(rows[99][0] - 5_000, -1)]  # a time that is over
    decisions = []
    for time_us, channel in rows:
        decisions += stream.push_events(1e-6 * time_us, channel) if channel >= 0 else stream.advance(1e-6 * time_us)
    said, faults = spoken(tmp_path, rows, start)
    assert said == [
        f"{d.window} {d.label if d.heard else 'nothing'} {d.steps} steps {d.input_spikes + d.hidden_spikes} spikes"
        for d in decisions
    ]
    tally = stream.tally
    assert min(tally.late, tally.doubled, tally.unknown) > 3
    assert faults == f"{tally.late} events late, {tally.doubled} doubled, {tally.unknown} of unknown channels\n"


def test_an_export_needs_no_recordings_and_takes_none(run, tmp_path):
    lines: list[object] = []
    assert run_folder.restore(run / "run").ranges is not None
    nt.export_c(run / "run", tmp_path / "c", prove=2, tell=lines.append)
    assert "every spike and decision equal" in str(lines[-1])
    assert "OFF channel0, OFF channel1, OFF channel2, ON channel0" in (tmp_path / "c" / "README.md").read_text()
    for wrong in ({"lsb": 1.0}, {"recordings": run / "spikes.h5"}, {"streamed": nt.Streamed(sampling_rate_Hz=1000)}):
        with pytest.raises(InputError, match="takes the events of a sensor"):
            nt.export_c(run / "run", tmp_path / "d", **wrong)


def test_a_graph_of_a_run_on_events_has_the_network_alone_and_equal_spikes(tmp_path):
    pytest.importorskip("nir")
    run = make_event_run(tmp_path, readout_stretches=1)
    lines: list[str] = []
    made = nt.export_nir(run / "run", tmp_path / "run.nir", prove=3, tell=lambda line: lines.append(str(line)))
    assert "afferents" not in made.nodes
    assert any(line.startswith("graph, hidden: equal") for line in lines)
    assert not any(line.startswith("graph") and "equal" not in line for line in lines)
    with pytest.raises(InputError, match="use neurotact stream"):
        nt.live(run / "run", "gratings")
