"""C treats missing values, gaps and the ends of its counters as a stream does, and faults at none of them."""

from dataclasses import replace
from itertools import pairwise
from math import lcm

import numpy as np
import pytest
from compiled import chosen
from driven import COUNTED, Do, Driven, Told, checksum, streamed
from levels import thinned
from made_chains import ADAPTING, make_chain, make_signal
from neurotact_parts.exporters.c import c_export, integer, proof
from neurotact_parts.exporters.c.boards import BOARDS
from neurotact_parts.exporters.c.formats import Formats
from neurotact_parts.exporters.c.proving import expected_in_integers
from neurotact_parts.streams.chain import LARGEST, Chain
from neurotact_parts.streams.stream import Stream
from neurotact_parts.streams.stream_state import StreamState

from neurotact.backend import native
from neurotact.encoders.closed_form import ExactState
from neurotact.errors import InputError

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason=str(proof.missing("cc")))
ABSENT = proof.missing("arm-none-eabi-gcc", "qemu-system-arm")
OVERLAPPING = {"length_ms": 30, "hop_ms": 9}
KINDS = {
    "none": ({}, {"patience": 5}),
    "feed-forward": (
        {"baseline": "start", "start_ms": 1.0, "offset": (0.1, -0.2)},
        {"model": "snn", "membrane": "immediate"},
    ),
    "start": ({"ema_cutoff_Hz": 30.0, "baseline": "start", "start_ms": 20.0}, {"patience": 5, "windows": OVERLAPPING}),
    "delayed": ({"baseline": "start"}, {"membrane": "delayed", "reset": "subtract", "recurrent_delay_steps": 1}),
    "high-pass": (
        {"baseline": "high-pass", "high_pass_Hz": 2.0, "rectify": True, "ema_cutoff_Hz": 60.0},
        {"membrane": "immediate", "reset": "hard", "readout": "integrator", "windows": OVERLAPPING, "patience": 4},
    ),
    "contact": (
        {"baseline": "high-pass", "high_pass_Hz": 8.0},
        {"windows": {"length_ms": 15, "contact": True, "quiet_ms": 3}, "patience": 2},
    ),
    "faster": ({"resample_Hz": 1000.0, "ema_cutoff_Hz": 30.0, "baseline": "start"}, {"rate_Hz": 400.0}),
    "slower": ({"resample_Hz": 1000.0, "baseline": "start"}, {"rate_Hz": 1700.0, "windows": OVERLAPPING}),
    "adapting": ({"baseline": "start"}, {**ADAPTING, "readout": "leaky", "patience": 5}),
    "falling": ({"baseline": "start"}, {"afferents": {"sa1.opposite": True}, "windows": OVERLAPPING, "patience": 5}),
    "closed form": (
        {"resample_Hz": 1000.0, "ema_cutoff_Hz": 30.0, "baseline": "start", "start_ms": 30.0},
        {"rate_Hz": 400.0, "afferents": {"integration": "exact"}, "windows": OVERLAPPING, "patience": 5},
    ),
}
IN_INTEGERS = [kind for kind in KINDS if kind != "adapting"]
NOT_VALID = (np.nan, np.inf, -np.inf, 3.4e38, -3.4e38, np.nextafter(np.float32(LARGEST), np.float32(np.inf)))


def made(kind: str) -> Chain:
    conditioning, options = KINDS[kind]
    return make_chain(conditioning, **options)


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """An export of a kind, compiled once, and its formats."""
    made_already: dict[tuple[str, str], Driven] = {}

    def of(kind: str, variant: str = "float") -> Driven:
        if (kind, variant) not in made_already:
            chain = made(kind)
            signals = [make_signal(150, chain.n_taxels, seed=k) for k in range(2)]
            formats = None if variant == "float" else chosen(chain, signals, state_bits=16)
            made_already[kind, variant] = Driven(chain, formats, tmp_path_factory.mktemp("c"))
        return made_already[kind, variant]

    return of


def records_of(seed: int, n: int, chain: Chain, formats: Formats | None = None) -> list[Do]:
    """Samples with values, samples and stretches that are missing, and gaps and resets, at random places."""
    rng = np.random.default_rng(seed)
    signal = make_signal(n, chain.n_taxels, seed)
    samples = signal if formats is None else formats.raw.samples(signal)
    found: list[Do] = []
    at = 0
    while at < n:
        what = rng.choice(6, p=[0.94, 0.025, 0.015, 0.015, 0.003, 0.002])
        long = 1 if rng.random() < 0.6 else int(rng.integers(2, 12))
        if what == 0 or (what in (1, 2) and formats is not None and long == 1):
            found.append(("push", samples[at]))
        elif what in (1, 2) and formats is None:  # single taxels, or all
            for row in samples[at : at + long].copy():
                row[rng.random(len(row)) < (0.4 if what == 1 else 1.0)] = rng.choice(np.array(NOT_VALID, np.float32))
                found.append(("push", row))
        elif what in (1, 2, 3):
            found += [("missing", None)] * long
        else:
            found.append(("gap" if what == 4 or formats is not None else "reset", None))
        at += long
        if at % 50 == 0:
            found.append(("tally", None))
    return [*found, ("tally", None)]


def same(one: Told, other: Told) -> bool:
    """Equal but for the order of the decisions of one sample, which C writes by their places."""
    return (one.steps, sorted(one.decisions), one.counts) == (other.steps, sorted(other.decisions), other.counts)


# --- missing values and gaps --------------------------------------------------------------------------


@needs_compiler
@thinned("kind", [*KINDS], every=4)
def test_c_in_float_treats_missing_values_as_a_stream_does(kind, driven):
    exported, n_decisions, troubles = driven(kind), 0, np.zeros(7, int)
    for seed in range(4):
        records = records_of(seed, 800 if seed else 100, exported.chain)
        expected = streamed(exported.chain, records, "auto" if seed else "reference")
        assert same(exported.run(records), expected)
        n_decisions += len(expected.decisions)
        troubles += np.array(expected.counts).sum(axis=0)
    assert n_decisions > 10
    assert dict(zip(COUNTED, troubles > 0, strict=True)) == dict.fromkeys(COUNTED, True)  # else nothing was tried


@needs_compiler
@thinned("kind", [*IN_INTEGERS], every=4)
def test_c_in_integers_holds_what_is_missing_and_starts_again(kind, driven):
    exported, n_decisions = driven(kind, "integer"), 0
    chain, formats = exported.chain, exported.formats
    for seed in range(2):
        records = records_of(seed, 900, chain, formats)
        expected, cut_off = in_integers(chain, formats, records)
        said = exported.run(records)
        said = said._replace(decisions=[row for row in said.decisions if row[0] not in cut_off])
        assert same(said._replace(counts=[]), expected._replace(counts=[]))
        assert [row[:5] for row in said.counts] == [row[:5] for row in expected.counts]
        n_decisions += len(expected.decisions)
    assert n_decisions > 6
    assert any(row[5] for row in expected.decisions)  # on values that were held


@needs_compiler
def test_no_flag_of_the_compiler_removes_the_guard(tmp_path):
    chain = made("none")
    records = records_of(1, 400, chain)
    counts = Driven(chain, None, tmp_path, flags=("-O2", "-ffast-math")).run(records).counts
    assert [row[:5] for row in counts] == [row[:5] for row in streamed(chain, records).counts]


def in_integers(chain: Chain, formats: Formats, records: list[Do]) -> tuple[Told, set[int]]:
    """What the twin says to the samples between two gaps, and the windows that gaps cut off, which it does not have."""
    stretches: list[list[tuple[np.ndarray, bool]]] = [[]]
    counts = dict.fromkeys(COUNTED, 0)
    told, cut_off, n_bad, n_windows = Told([], [], []), set(), 0, 0
    hold = max(1, int(c_export.HOLD_MS * 1e-3 * chain.sampling_rate_Hz))

    def finish() -> None:
        """Add what the twin says to the last stretch, and begin another."""
        nonlocal n_windows
        if not stretches[-1]:
            return
        trial = np.stack([sample for sample, _ in stretches[-1]])
        said = expected_in_integers(chain, formats, [trial])[0]
        opening, opened = chain.windows.begin(), 0
        steps_done = said.afferents[: n_done(len(trial), formats)]
        for step in steps_done:
            opens, opening = opening.after(len(step) > 0)
            opened += opens
        held = [is_held for _, is_held in stretches[-1]]
        sample_of = samples_of_steps(len(trial), formats)
        whole = [row for row in said.decisions if row[1] + chain.windows.length <= len(steps_done)]
        for window, start, steps, inputs, hidden, heard, label in whole:
            n_held = sum(held[at] for at in sample_of[start : start + steps])
            told.decisions.append((n_windows + window, start, steps, inputs, hidden, n_held, heard, label))
        told.steps.extend(checksum(step) for step in steps_done)
        cut_off.update(range(n_windows + len(whole), n_windows + opened))
        n_windows += opened
        stretches.append([])

    for what, sample in records:
        if what == "push":
            stretches[-1].append((sample, False))
            counts["samples"] += 1
            n_bad = 0
        elif what == "missing":
            counts["missing"] += 1
            n_bad += 1
            if stretches[-1] and n_bad <= hold:
                stretches[-1].append((stretches[-1][-1][0], True))
        if what == "gap" or (what == "missing" and n_bad > hold):
            counts["gaps"] += bool(stretches[-1])
            finish()
        if what == "tally":
            told.counts.append(tuple(counts.values()))
    finish()
    return told, cut_off


def n_done(n_samples: int, formats: Formats) -> int:
    """The number of steps that samples complete, before the trial ends."""
    if formats.front.stride is None and formats.front.closed is not None:
        whole, part = formats.front.closed.stride
        return n_samples * (whole * 2**32 + part) >> 32
    if formats.front.stride is None or not n_samples:
        return n_samples
    whole, part = formats.front.stride
    return (n_samples - 1) * 2**32 // (whole * 2**32 + part) + 1


def samples_of_steps(n_samples: int, formats: Formats) -> list[int]:
    """The sample at which each step is processed."""
    numbers, seen = [], [n_done(n, formats) for n in range(n_samples + 1)]
    for sample, (before, after) in enumerate(pairwise(seen)):
        numbers += [sample] * (after - before)
    return numbers


@pytest.mark.parametrize("backend", ["reference", *(["native"] if native else [])])
def test_a_value_that_no_chain_can_compute_with_is_missing(backend):
    chain, signal = make_chain({"baseline": "start"}), make_signal(120)
    largest = np.float32(LARGEST)
    for value in NOT_VALID:
        spoilt, marked = signal.copy(), signal.copy()
        spoilt[50:53, 1], marked[50:53, 1] = value, np.nan
        one, other = (Stream(chain, backend=backend) for _ in range(2))
        assert one.push(spoilt) == other.push(marked)
        assert one.tally.held == 3
    stream = Stream(chain, backend=backend)
    stream.push(np.concatenate([signal[:50], [[largest, -largest]], signal[50:]]))
    assert stream.tally.trouble() == ""
    state = stream.state()
    assert np.isfinite(state.encoder.sa1.membrane_mV).all()
    assert np.isfinite(state.encoder.ra1.membrane_mV).all()


def test_gains_that_exceed_every_number_are_refused():
    with pytest.raises(InputError, match=r"encoder: a gain of 30 over a scale of 1e-12 exceeds float32"):
        make_chain({"scale": (1e-12, 1.0)})


# --- counters at their ends ---------------------------------------------------------------------------

BEYOND = 2**32
"""Steps and windows are counted in 32 bits."""


def aged(chain: Chain, state: StreamState) -> StreamState:
    """The state of a stream that has run on until shortly before step 2^32."""
    done, ratio = state.conditioned, chain.sampling_rate_Hz / chain.clock_Hz
    unit = lcm(chain.windows.hop or 1, 10)  # whole hops, and whole samples
    more = (BEYOND - 100 - state.opening.step) // unit * unit
    n_more, felt = round(more * ratio), round(more * chain.signal_Hz / chain.clock_Hz)
    opening = replace(state.opening, step=state.opening.step + more, free_at=state.opening.free_at + more)
    done = done._replace(n_samples=done.n_samples + n_more, n_steps=done.n_steps + felt)
    encoder = state.encoder
    if isinstance(encoder, ExactState):
        encoder = encoder._replace(n_samples=encoder.n_samples + felt, n_steps=encoder.n_steps + more)
    return replace(state, opening=opening, conditioned=done, encoder=encoder, n_windows=BEYOND - 3)


@needs_compiler
@thinned("kind", [*KINDS], every=4)  # those that other tests have compiled
def test_no_step_is_the_last_of_a_chain_in_float(kind, driven):
    """With sanitizers, over the step and the window at which a counter of 32 bits ends."""
    exported = driven(kind)
    chain = exported.chain
    n = round(900 * chain.sampling_rate_Hz / chain.clock_Hz)
    signal, stream = make_signal(n, chain.n_taxels, seed=3), Stream(chain, backend="reference")
    stream.push(signal[: n // 5])
    records: list[Do] = [("push", row) for row in signal]
    records[n // 2 : n // 2 + 3] = [("missing", None)] * 3
    records = [*records[: n // 5], ("age", stream.state()), *records[n // 5 :], ("tally", None)]
    records[n // 5] = ("age", aged(chain, stream.state()))
    records += [("finish", None)] * (chain.clock_Hz != chain.sampling_rate_Hz)
    expected = streamed(chain, records)
    assert same(exported.run(records), expected)
    assert {BEYOND - 3, BEYOND - 1, 0} <= {row[0] for row in expected.decisions}
    starts = [row[1] for row in expected.decisions]
    assert max(starts) > BEYOND - 300
    assert min(starts[starts.index(max(starts)) :]) < 300
    if native and kind in ("delayed", "slower"):
        assert expected == streamed(chain, records, "reference")


@needs_compiler
@thinned("kind", IN_INTEGERS, every=4)
def test_no_step_is_the_last_of_a_chain_in_integers(kind, driven):
    exported = driven(kind, "integer")
    chain, formats = exported.chain, exported.formats
    raw = formats.raw.samples(make_signal(700, seed=3))
    count = BEYOND - 150
    state = Stream(chain, backend="reference").state()
    opening, done = replace(state.opening, step=count), state.conditioned._replace(carried=(np.zeros(2), 0))
    state = replace(state, opening=opening, conditioned=done, n_windows=BEYOND - 3)
    records: list[Do] = [("age", state), *(("push", row) for row in raw)]
    said = exported.run(records)
    raster = integer.encode(raw[None], formats.front)[0][: n_done(len(raw), formats)]
    assert said.steps == [checksum(np.flatnonzero(row)) for row in raster]
    plain = expected_in_integers(chain, formats, [raw])[0]
    decided = [(window + BEYOND - 3, start + count, *rest) for window, start, *rest in plain.decisions]
    mine = {(*row[:5], *row[6:]) for row in said.decisions}
    assert mine >= {(window % BEYOND, start % BEYOND, *rest) for window, start, *rest in decided}
    assert {BEYOND - 3, BEYOND - 1, 0} <= {row[0] for row in said.decisions}
    starts = [row[1] for row in said.decisions]
    assert max(starts) > BEYOND - 300
    assert min(starts) < 300


@needs_compiler
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_counts_end_at_their_largest_number(variant, driven):
    exported, signal = driven("none", variant), make_signal(300)
    rows = signal if exported.formats is None else exported.formats.raw.samples(signal)
    largest = BEYOND - 1
    records: list[Do] = [("counts", [largest - 1, largest - 2, largest, largest, largest - 1, largest, 7])]
    records += [("push", row) for row in rows[:100]] + [("missing", None)] * 9 + [("push", row) for row in rows[100:]]
    said = exported.run([*records, ("gap", None), ("tally", None)])
    assert said.counts == [(largest, largest - 2, largest, largest, largest - 1, largest, 7 + len(said.decisions))]


@needs_compiler
def test_samples_that_are_missing_for_ever_are_one_gap(driven):
    """The number of them in a row does not come round to 0, after which values would be held again."""
    records: list[Do] = [*(("push", row) for row in make_signal(60)), *([("missing", None)] * 9)]
    records += [("bad", BEYOND - 3), *([("missing", None)] * 9), ("tally", None)]
    assert driven("none").run(records).counts[0][:5] == (60, 0, 18, 1, 0)


def test_windows_whose_spikes_no_counter_holds_are_refused(tmp_path):
    chain = made("none")
    with pytest.raises(InputError, match="windows: their spikes may exceed a counter of 32 bits"):
        c_export.write(chain._replace(windows=replace(chain.windows, length=2**30, hop=2**30)), tmp_path)


@pytest.mark.skipif(ABSENT is not None, reason=str(ABSENT))
@thinned(
    ("kind", "variant"),
    [
        ("delayed", "float"),
        ("slower", "float"),
        ("delayed", "integer"),
        ("closed form", "float"),
        ("closed form", "integer"),
    ],
    every=2,
)
def test_an_emulated_processor_does_the_same(kind, variant, driven, tmp_path):
    here = driven(kind, variant)
    chain, formats = here.chain, here.formats
    begun = round(120 * chain.sampling_rate_Hz / chain.clock_Hz)  # samples until a baseline of the start is known
    signal, stream = make_signal(begun + 500, seed=5), Stream(chain, backend="reference")
    stream.push(signal[:begun])
    state = aged(chain, stream.state())
    if formats is not None:
        done = state.conditioned
        state = replace(state, conditioned=done._replace(carried=(np.array([5, -5]) * BEYOND, BEYOND - 100)))
    rows = signal if formats is None else formats.raw.samples(signal)
    records = [*records_of(1, 250, chain, formats), ("reset", None), *(("push", row) for row in rows[:begun])]
    records += [("age", state), *(("push", row) for row in rows[begun:]), ("tally", None)]
    said = here.run(records)
    assert Driven(chain, formats, tmp_path, BOARDS["cortex-m0"]).run(records) == said
    assert formats is not None or same(said, streamed(chain, records))
    assert len(said.decisions) > 5
