"""A chain without an encoder: events of a sensor, in any order in a step and in any pieces, decide as `infer`."""

import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_chains import make_encoder, told
from neurotact_parts.streams.chain import Chain, chain_of
from neurotact_parts.streams.events import MOST_CELLS, Channels

import neurotact as nt
from neurotact.data import hdf5
from neurotact.errors import InputError
from neurotact.networks.exit.rule import ExitRule

N, STEP_s, LENGTH = 4, 1e-3, 20
AFFERENTS = ("OFF a", "OFF b", "ON a", "ON b")


def made(*, patience: int | None = None, step_ms: float | str = "encoder", **windows) -> Chain:
    generator = torch.Generator().manual_seed(1)
    network = nt.RSNN(
        N, 3, sampling_rate_Hz=1 / STEP_s, hidden=6, forward_weight_scale=3.0, generator=generator, step_ms=step_ms
    )
    chain = chain_of((None, network), nt.Streamed(**{"length_ms": LENGTH, **windows}))
    return chain._replace(rule=ExitRule(patience, from_first_spike=True), taxels=AFFERENTS)


def inferred(chain: Chain, steps: np.ndarray, units: np.ndarray, n_steps: int) -> list[tuple]:
    """What `infer` says of the windows of a trial with these events."""
    raster = np.zeros((n_steps, N), np.uint8)
    raster[steps[steps < n_steps], units[steps < n_steps]] = 1
    starts = chain.windows.starts(raster).tolist()
    if not starts:
        return []
    found = chain.network.infer(
        torch.from_numpy(np.stack([raster[i : i + chain.windows.length] for i in starts])), chain.rule
    )
    columns = (found.labels, found.steps, found.input_spikes, found.hidden_spikes)
    return list(zip(starts, *(column.tolist() for column in columns), strict=True))


EVENTS = st.lists(st.tuples(st.integers(0, 90), st.floats(0, 0.99), st.integers(0, N - 1)), min_size=1, max_size=60)
CHAINS = {
    "back to back": made(),
    "overlapping, early exit": made(hop_ms=7, patience=4),
    "contact": made(contact=True, quiet_ms=5),
    "a clock of its own": made(step_ms=3.0),
}


@pytest.mark.parametrize("backend", ["auto", "reference"])
@pytest.mark.parametrize("name", CHAINS)
@given(EVENTS, st.randoms(use_true_random=False), st.integers(1, 60))
def test_events_in_any_order_within_a_step_and_in_any_pieces_decide_as_infer(name, backend, events, random, piece):
    chain = CHAINS[name]
    random.shuffle(events)
    events.sort(key=lambda event: event[0])  # by steps alone
    steps, parts, units = (np.array(column) for column in zip(*events, strict=True))
    stream, decisions = nt.Stream(chain, backend=backend), []
    time_s = (steps + parts) * STEP_s
    for i in range(0, len(events), piece):
        decisions += stream.push_events(time_s[i : i + piece], units[i : i + piece])
    decisions += stream.advance(0.15)
    assert told(decisions) == inferred(chain, steps, units, 150)
    assert stream.tally.events == len(events)
    assert stream.tally.doubled == len(events) - len({*zip(steps.tolist(), units.tolist(), strict=True)})
    assert stream.tally.late == stream.tally.unknown == 0


@given(EVENTS, st.lists(st.integers(0, 60), max_size=8), st.integers(1, 60))
def test_late_doubled_and_unknown_events_are_counted_and_change_nothing(events, places, piece):
    chain = CHAINS["back to back"]
    events.sort(key=lambda event: event[0])
    good = [((step + part) * STEP_s, unit) for step, part, unit in events]
    rows, reached, late, unknown = [], -1, 0, 0
    for i, (time_s, unit) in enumerate(good):
        rows.append((time_s, unit))
        reached = max(reached, events[i][0])
        for _ in range(places.count(i)):
            rows += [(time_s, N + 3), (time_s, unit)]
            unknown += 1
            if reached > 0:
                rows.append(((reached - 1) * STEP_s, 0))
                late += 1
    clean, faulty = nt.Stream(chain), nt.Stream(chain)
    expected = clean.push_events(*zip(*good, strict=True)) + clean.flush()
    decisions = []
    for i in range(0, len(rows), piece):
        decisions += faulty.push_events(*zip(*rows[i : i + piece], strict=True))
    assert told(decisions + faulty.flush()) == told(expected)
    assert (faulty.tally.late, faulty.tally.unknown) == (late, unknown)
    assert faulty.tally.doubled == clean.tally.doubled + unknown


def test_a_state_holds_the_step_under_way(tmp_path):
    chain = CHAINS["back to back"]
    first, whole = nt.Stream(chain), nt.Stream(chain)
    first.push_events([0.0031, 0.0052], [1, 2])
    first.save(tmp_path / "state")
    other = nt.Stream(chain, backend="reference")
    other.load(tmp_path / "state")
    rest = [0.0054, 0.0059, 0.007], [2, 3, 0]
    whole.push_events([0.0031, 0.0052, *rest[0]], [1, 2, *rest[1]])
    assert other.push_events(*rest) == []
    assert other.tally == whole.tally
    assert other.flush() == whole.flush() != []


def test_silence_ends_windows_and_a_trial_begins_the_clock_again():
    chain, stream = CHAINS["back to back"], nt.Stream(CHAINS["back to back"])
    assert [d.start_step for d in stream.advance(0.05)] == [0, LENGTH]
    stream.push_events([0.051], ["ON a"])
    assert stream.finish() == []
    assert stream.tally.unfinished == 1
    assert told(stream.push_events([0.001], [1]) + stream.flush()) == inferred(
        chain, np.array([1]), np.array([1]), LENGTH
    )
    large = chain_of((None, nt.RSNN(MOST_CELLS // 10, 2, hidden=2, sampling_rate_Hz=1e3)), nt.Streamed(length_ms=33))
    assert nt.Stream(large).push_events([0.032, 0.033], [7, 8])[0].input_spikes == 1


def test_channels_are_found_by_numbers_names_and_populations():
    channels = Channels(AFFERENTS)
    assert [channels.number(*event) for event in (("b", "ON"), ("1", 1), (1, "0"), ("a", "-1"), (3,), ("ON a",))] == [
        3, 3, 1, 0, 3, 2,
    ]  # fmt: skip
    assert {channels.number(*event) for event in (("c", "ON"), (2, 1), (0, 2), ("a", "UP"), (4,), ("a",), (-1,))} == {
        -1
    }
    assert Channels(("a b", "a c", "x d")).number(1, -1) == 1
    for polarity, expected in (("merge", [1, 1]), ("on", [1, -2]), ("off", [-2, 1])):
        alone = Channels(("left", "right"), polarity)
        assert [alone.number("right", value) for value in ("1", "-1")] == expected
    with pytest.raises(InputError, match="merge, on or off"):
        Channels(("left", "right")).number(0, 1)
    with pytest.raises(InputError, match="OFF, ON"):
        Channels(AFFERENTS, "merge")


def test_each_kind_of_chain_refuses_the_input_of_the_other():
    stream = nt.Stream(CHAINS["back to back"])
    for call in (lambda: stream.push(np.zeros((3, N))), lambda: stream.missing(2)):
        with pytest.raises(InputError, match="takes the events of a sensor"):
            call()
    for wrong in (([-0.1], [0]), ([np.nan], [0]), ([0.1, 0.2], [0]), (["a"], [0]), ([1e6], [0])):
        with pytest.raises(InputError):
            stream.push_events(*wrong)
    samples = nt.Stream(
        (
            make_encoder(baseline="start"),
            nt.RSNN(2, 2, hidden=2, sampling_rate_Hz=1e3),
        )
    )
    for call in (lambda: samples.push_events([0.1], [0]), lambda: samples.advance(1.0), samples.flush):
        with pytest.raises(InputError, match="has an encoder"):
            call()


# --- the command line ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A network trained on the events of a sensor: `events.csv`, `spikes.h5` and `run` in a folder."""
    folder = tmp_path_factory.mktemp("sensor")
    rng, rows = np.random.default_rng(0), []
    for trial in range(24):
        label, n = ("felt", "silk")[trial % 2], (30, 45)[trial % 2]
        for time_us in np.sort(rng.choice(60_000, n, replace=False)).tolist():
            rows.append(f"{trial},{label},{time_us},{rng.integers(0, 3)},{rng.integers(0, 2)}")
    (folder / "events.csv").write_text("\n".join(["trial,label,time_us,channel,polarity", *rows, ""]))
    for words in (
        (
            "import",
            "events",
            folder / "events.csv",
            "-o",
            folder / "spikes.h5",
            "--duration-ms",
            "60",
            "--merge-events",
        ),
        ("train", folder / "spikes.h5", "-o", folder / "run", "--window-ms", "60", "--set", "training.epochs=2"),
    ):
        subprocess.run([sys.executable, "-m", "neurotact", *map(str, words)], check=True, capture_output=True)
    return folder


def events_of(folder, trial: int) -> list[str]:
    rows = [line.split(",") for line in (folder / "events.csv").read_text().splitlines()[1:]]
    return [",".join(row[2:]) for row in rows if row[0] == str(trial)]


def decided(folder, rows: list[str], *words: str, source: str = "-") -> tuple[int, list[dict], str]:
    """The code, the decisions and the last line of `neurotact stream` on these rows."""
    command = [sys.executable, "-m", "neurotact", "stream", str(folder / "run"), "--json", "--from", source, *words]
    done = subprocess.run(command, input="\n".join([*rows, ""]), capture_output=True, text=True, check=False)
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines()], done.stderr


@pytest.mark.thorough
def test_a_pipe_of_events_decides_as_infer_and_its_faults_are_counted_and_said_once(run):
    expected = nt.infer(run / "run", run / "spikes.h5", early_exit=True)
    for trial in (0, 1):
        rows = events_of(run, trial)
        code, (decision,), said = decided(run, ["time_us,channel,polarity", *rows])
        assert code == 0
        row = expected.iloc[trial]
        assert (decision["label"], decision["steps"], decision["input_spikes"], decision["hidden_spikes"]) == (
            row["predicted"], row["steps"], row["input_spikes"], row["hidden_spikes"],
        )  # fmt: skip
        faulty = [*rows[:9], rows[8], "x,1,1", "70000", "20,1,1", rows[9].replace(",", "0000000000000,", 1), "21,9,9"]
        code, _, said = decided(run, faulty, "--time-unit", "us")
        assert code == 0
        assert said.count("is over") == said.count("share a step") == said.count("does not have") == 1
        assert "late 1, doubled" in said
        assert "unknown 1, bad rows 1, time stamps ignored 1" in said
