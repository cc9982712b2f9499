"""A chain without an encoder: events of a sensor, in any order in a step and in any pieces, decide as `infer`."""

import json
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from in_process import typed
from made_chains import events_of_trial, make_encoder, make_event_run, told
from neurotact_parts.streams import sources
from neurotact_parts.streams.chain import Chain, chain_of
from neurotact_parts.streams.events import MOST_CELLS, Channels

import neurotact as nt
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
    found = other.flush()
    assert found == whole.flush()
    steps, units = np.array([3, 5, 5, 5, 7]), np.array([1, 2, 2, 3, 0])
    assert told(found) == inferred(chain, steps, units, LENGTH)
    one_by_one = nt.Stream(chain)
    for step, unit in zip(steps, units, strict=True):
        one_by_one.push_events(step * STEP_s, unit)
    assert told(one_by_one.flush()) == told(found)


def test_silence_ends_windows_and_a_trial_begins_the_clock_again():
    chain, stream = CHAINS["back to back"], nt.Stream(CHAINS["back to back"])
    assert [d.start_step for d in stream.advance(0.05)] == [0, LENGTH]
    stream.push_events([0.051], ["ON a"])
    assert stream.finish() == []
    assert stream.tally.unfinished == 1
    stream.push_events([(LENGTH - 0.5) * STEP_s], ["ON a"])
    assert [d.input_spikes for d in stream.finish()] == [1]
    assert told(stream.push_events([0.001], [1]) + stream.flush()) == inferred(
        chain, np.array([1]), np.array([1]), LENGTH
    )
    large = chain_of((None, nt.RSNN(MOST_CELLS // 10, 2, hidden=2, sampling_rate_Hz=1e3)), nt.Streamed(length_ms=33))
    assert nt.Stream(large).push_events([0.032, 0.033], [7, 8])[0].input_spikes == 1


@pytest.mark.parametrize("clock_Hz", [0.5, 50.0, 30_000.0, 1e6])
def test_every_clock_takes_each_event_once(clock_Hz):
    network = nt.RSNN(N, 2, hidden=2, sampling_rate_Hz=clock_Hz)
    stream = nt.Stream((None, network), streamed=nt.Streamed(length_ms=10e3 / clock_Hz))
    (decision,) = stream.push_events(np.arange(11) / clock_Hz, np.arange(11) % N)
    assert (decision.input_spikes, stream.tally.doubled, stream.tally.late) == (10, 0, 0)


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


def test_times_of_events_may_have_decimal_commas(capsys):
    rows = sources.EventRows("-", Channels(["a", "b"]), sources.Faults())
    assert [arrived.events for arrived in rows.take(b"time;channel\n0;a\n0,5;b\n1,25;a\n")] == [
        sources.Events([0.0, 0.5, 1.25], [0, 1, 0])
    ]
    assert capsys.readouterr().err == "neurotact: -: commas in numbers are decimal\n"


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
    """A network trained on the events of a sensor."""
    return make_event_run(tmp_path_factory.mktemp("sensor"))


def streamed(folder, rows: list[str], *words: str) -> tuple[int, list[dict], str]:
    """The code, the decisions and what `neurotact stream` says of a file of these rows."""
    (folder / "given.csv").write_text("\n".join([*rows, ""]))
    done = typed("stream", folder / "run", "--json", "--from", folder / "given.csv", *words)
    return done.code, [json.loads(line) for line in done.out.splitlines()], done.err


def test_a_file_of_events_decides_as_infer(run):
    expected = nt.infer(run / "run", run / "spikes.h5", early_exit=True)
    for trial in (0, 1, 2):
        rows, row = events_of_trial(run, trial), expected.iloc[trial]
        shifted = [
            f"{10**15 + int(time)};{other.replace(',', ';')}" for time, other in (each.split(",", 1) for each in rows)
        ]
        first = int(rows[0].split(",")[0]) // 1000 * 1000
        for text, words in (
            (["time_us,channel,polarity", *rows], ()),
            (rows, ("--time-unit", "us")),
            (
                [
                    "p,n,ts_us,id",
                    *(f"{p},0,{time},{channel}" for time, channel, p in (each.split(",") for each in rows)),
                ],
                (),
            ),
            ([f"{10**15 + first}", *shifted], ("--time-unit", "us", "--origin", "first")),
        ):
            code, (decision,), said = streamed(run, text, *words)
            assert code == 0
            assert "every event was used" in said or "doubled" in said
            if "--origin" not in words or not first:
                found = tuple(decision[key] for key in ("label", "steps", "input_spikes", "hidden_spikes", "sops"))
                assert found == tuple(row[["predicted", "steps", "input_spikes", "hidden_spikes", "sops_total"]])


def test_faults_of_a_source_are_counted_and_said_once(run):
    rows = events_of_trial(run, 0)
    faulty = [*rows[:9], "x,1,1", "0,1,1", "1,0,1", "9" * 20 + ",1,1", f"{rows[8].split(',')[0]},9,9", "5,1,1,1", "7,"]
    code, decisions, said = streamed(run, [*faulty, rows[8]], "--time-unit", "us")
    assert (code, len(decisions)) == (0, 1)
    assert (
        said.count("is over")
        == said.count("share a step")
        == said.count("does not have")
        == said.count("fit no other")
        == 1
    )
    assert "late 2, doubled 1, unknown 1, bad rows 3, time stamps ignored 1" in said
    restarted = [*rows, *(f"{-(10**7) + 1000 * i},0,0" for i in range(40))]
    code, decisions, said = streamed(run, restarted, "--time-unit", "us")
    assert "the clock has started again" in said
    assert "clock restarts 1" in said
    assert "gaps 1" in said
    assert f"{len(restarted)} events" not in streamed(run, [*rows, "61000"], "--time-unit", "us")[2]
    assert f"{len(rows)} events" in streamed(run, [*rows, "61000"], "--time-unit", "us")[2]
    assert "time stamps ignored 19" in said
    wrapped = [f"{(2**32 - 9_000 + 1000 * i) % 2**32},0,0" for i in range(60)]
    _, decisions, said = streamed(run, wrapped, "--time-unit", "us", "--origin", "first")
    assert "clock wraps 1" in said
    assert [each["input_spikes"] for each in decisions] == [60] or decisions[0]["steps"] < 60


@pytest.mark.parametrize(
    ("rows", "words", "message"),
    [
        (["time,where", "1,2"], (), "names no column of time and channel"),
        (["felt"], (), "names no column"),
        ([], (), "has no event"),
        (["1700000000,1,1"], (), "--origin"),
        (["-1,1,1"], (), "--origin"),
        (["0.001,0,1"], ("--polarity", "on"), "OFF, ON"),
        (["0.001,0,1"], ("--lsb", "2"), "--lsb"),
        (["0.001,0,1"], ("--stall-s", "2"), "takes the events of a sensor"),
        (["0.001,0,1"], ("--rate", "real"), "is for samples"),
    ],
)
def test_what_is_no_stream_of_events_is_refused(run, rows, words, message):
    code, decisions, said = streamed(run, rows, *words)
    assert (code, decisions) == (2, [])
    assert message in said


def test_a_socket_and_a_pipe_give_what_a_file_gives(run):
    rows = ["time_us,channel,polarity", *events_of_trial(run, 3)]
    _, expected, _ = streamed(run, rows)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with server.accept()[0] as connection:
                for row in rows:
                    connection.sendall(f"{row}\n".encode())

        thread = threading.Thread(target=serve)
        thread.start()
        found = [*nt.stream(run / "run", f"tcp:127.0.0.1:{server.getsockname()[1]}").decisions]
        thread.join()
    assert [decision._asdict() for decision in found] == expected
    for address in ("tcp:localhost", "tcp:localhost:70000", "tcp::80"):
        with pytest.raises(InputError, match="no address"):
            next(nt.stream(run / "run", address).decisions)
    for held in ("touches.h5", "lsl:Skin"):
        with pytest.raises(InputError, match="holds samples"):
            nt.stream(run / "run", held)


@pytest.mark.thorough
def test_a_pipe_gives_each_decision_as_soon_as_time_passes_its_window(run):
    command = [
        sys.executable,
        "-m",
        "neurotact",
        "stream",
        str(run / "run"),
        "--json",
        "--from",
        "-",
        "--time-unit",
        "ms",
    ]
    with subprocess.Popen(
        [*command, "--full-window"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as pipe:
        assert pipe.stdin is not None
        assert pipe.stdout is not None
        print("1,0,1\n1,2,0\n60", file=pipe.stdin, flush=True)
        assert json.loads(pipe.stdout.readline())["input_spikes"] == 2
        print("130", file=pipe.stdin, flush=True)
        assert json.loads(pipe.stdout.readline())["start_step"] == 60
