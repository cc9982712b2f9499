"""A clock at fault costs no sample more than the rule says, and never silences a stream."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_chain, make_signal
from neurotact_parts.streams import sources, stamped_rows
from neurotact_parts.streams.sources import Rows, parser_of
from neurotact_parts.streams.stamped_rows import AHEAD, BEHIND, Faults, StampedRows
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.errors import InputError

MS = 1e-3


def taken(stamps, *, rate_Hz: float = 1000.0, unit_s: float = MS) -> tuple[list, Faults]:
    """What becomes of rows numbered from 0: their numbers, `(n,)` for n missing samples, `...` for a restart."""
    faults = Faults()
    rows, found = StampedRows("pipe", rate_Hz, unit_s, faults), []
    placed = [each for number, stamp in enumerate(stamps) for each in rows.take(float(stamp), [float(number)])]
    for row in (*placed, *rows.rest()):
        found += [...] if row.restarts else [(row.lost,)] if row.lost else []
        found.append(int(row.values[0]) if row.values else None)
    return found, faults


def used(found: list) -> list[int]:
    """The numbers of the rows that were used."""
    return [each for each in found if isinstance(each, int)]


def missing(found: list) -> list[int]:
    """The numbers of missing samples."""
    return [each[0] for each in found if isinstance(each, tuple)]


def ramp(n: int, begin: float = 0.0, step: float = 1.0) -> list[float]:
    return [begin + k * step for k in range(n)]


# --- the law: the decisions of the streams without the fault ------------------------------------------

FAR = st.one_of(
    st.floats(5, 1e9), st.floats(-1e9, -1e-3), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0])
)


def decided(chain, signal: np.ndarray, stamps: list[float], cuts: list[int] = []) -> tuple[list, Stream, Faults]:  # noqa: B006
    """The decisions of a table with time stamps in ms, whose bytes come in pieces."""
    stream, faults = Stream(chain), Faults()
    parser = parser_of(nt.Samples(time_column="ms"), "pipe", chain.n_taxels, chain.sampling_rate_Hz, faults)
    rows = (f"{t!r},{','.join(repr(float(v)) for v in row)}\n" for t, row in zip(stamps, signal, strict=True))
    data = "".join(rows).encode()
    places = sorted({0, *(cut % len(data) for cut in cuts)})
    pieces = [data[a:b] for a, b in zip(places, [*places[1:], len(data)], strict=True)]
    arrived = [each for piece in pieces for each in parser.take(piece)]
    return [*sources.decide(stream, [*arrived, *parser.rest()])], stream, faults


@given(
    at=st.integers(1, 140), stamps=st.lists(FAR, min_size=1, max_size=AHEAD - 1), seed=st.integers(0, 9),
    cuts=st.lists(st.integers(0, 9999), max_size=3), baseline=st.sampled_from(["none", "start"]),
)  # fmt: skip
@examples(40)
def test_stamps_that_fit_no_other_change_no_decision(at, stamps, seed, cuts, baseline):
    chain, signal = make_chain({"baseline": baseline}, patience=5), make_signal(150, seed=seed)
    clock = ramp(150, 7.0)
    clock[at : at + len(stamps)] = [clock[at - 1] + stamp if abs(stamp) > 1e-3 else stamp for stamp in stamps]
    found, stream, faults = decided(chain, signal, clock, cuts)
    assert found == Stream(chain).push(signal)
    assert stream.tally.trouble() == ""
    assert 1 <= faults.outliers <= len(stamps)
    assert (faults.bad_rows, faults.restarts) == (0, 0)


@given(
    n=st.integers(60, 150), begin=st.sampled_from([0.0, 1.0, 1e6, 1.7e12]), again=st.sampled_from([0.0, -5e5, 9e7]),
    seed=st.integers(0, 9), cuts=st.lists(st.integers(0, 9999), max_size=3),
)  # fmt: skip
@examples(30)
def test_a_clock_that_starts_again_is_a_gap_and_costs_no_row(n, begin, again, seed, cuts):
    chain, signal = make_chain({"baseline": "start"}), make_signal(260, seed=seed)
    found, stream, faults = decided(chain, signal, ramp(n, begin) + ramp(260 - n, again + begin * (again > 0)), cuts)
    clean = Stream(chain)
    expected = clean.push(signal[:n])
    clean.gap()
    expected += clean.push(signal[n:])
    assert found == expected
    assert (faults.restarts, faults.outliers, faults.bad_rows) == (1, 0, 0)
    assert stream.tally.samples == 260
    assert stream.tally.gaps == 1


@given(
    period_ms=st.sampled_from([1, 2, 28]), is_signed=st.booleans(), before=st.integers(1, 40), lost=st.integers(0, 9),
    counter=st.sampled_from([
        (16, 1e-3, 1e-3), (32, 1e-3, 1e-3), (32, 1e-6, 1e-6), (32, 1e-6, 1e-3), (16, 1e-3, 1.0), (32, 1e-6, 1.0),
        (32, 1e-3, 1.0), (32, 1e-9, 1e-9), (16, 1e-3, 1e-6),
    ]),
)  # fmt: skip
@examples(60)
def test_a_counter_that_wraps_goes_on(period_ms, is_signed, before, lost, counter):
    """A counter of bits of ticks, and the unit in which its stamps are written."""
    bits, tick_s, unit_s = counter
    length, ticks, rate_Hz = 2**bits, round(period_ms * 1e-3 / tick_s), 1e3 / period_ms
    number = np.r_[0:before, before + lost : 60]
    counted = (length - before * ticks + number * ticks) % length
    counted = np.where(counted >= length // 2, counted - length, counted) if is_signed else counted
    found, faults = taken((counted * tick_s / unit_s).tolist(), rate_Hz=rate_Hz, unit_s=unit_s)
    assert used(found) == list(range(len(number)))
    assert sum(missing(found)) == lost
    assert (faults.wraps, faults.restarts, faults.outliers, faults.bad_rows) == (not is_signed, 0, 0, 0)


@pytest.mark.parametrize("length", [2**15, 2**31])
def test_a_signed_counter_wraps_at_its_middle(length):
    found, faults = taken([length - 3, length - 2, length - 1, *range(-length, -length + 30)])
    assert found == [*range(33)]
    assert (faults.wraps, faults.restarts) == (1, 0)


def test_every_wrap_is_unwrapped():
    stamps = [k % 2**16 for k in range(0, 400_000, 100)]
    found, faults = taken(stamps, rate_Hz=10.0)
    assert found == [*range(4000)]
    assert faults.trouble() == "clock wraps 6"


@pytest.mark.parametrize("ahead", [-2, -1, 1, 2])
def test_a_stamp_that_errs_by_a_row_or_two_costs_no_more_than_four(ahead):
    """It is believed, or taken for the same sample: the rows after it then repeat what is past."""
    stamps = ramp(100)
    stamps[50] += ahead
    found, faults = taken(stamps)
    assert {*range(100)} - {*used(found)} <= {*range(49, 53)}
    assert len(used(found)) + sum(missing(found)) == 100
    assert faults.restarts == 0


# --- the cases of the rule ----------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [1, 2, 3, 7, 500, 30_000])
def test_a_jump_ahead_is_missing_samples(lost):
    found, faults = taken(ramp(50) + ramp(AHEAD, 50 + lost))
    assert found == [*range(50), (lost,), *range(50, 50 + AHEAD)]
    assert faults == Faults()


def test_a_jump_of_days_is_a_clock_that_was_set():
    found, faults = taken(ramp(50) + ramp(50, 1.7e12))
    assert found == [*range(50), ..., *range(50, 100)]
    assert faults.restarts == 1


def test_a_link_that_loses_most_rows_is_not_silenced():
    stamps = ramp(600)[:510] + ramp(30, 520, 17.0) + ramp(100, 1030)
    found, faults = taken(stamps)
    assert used(found) == list(range(len(stamps)))
    assert sum(missing(found)) == stamps[-1] + 1 - len(stamps)
    assert faults == Faults()


def test_repeated_and_late_rows_are_dropped_and_change_nothing():
    faults = Faults()
    rows = StampedRows("pipe", 1000.0, MS, faults)
    stamps = [*range(40), *range(10, 40), *range(40, 70), 45, 50, *range(70, 90)]  # a packet is sent twice
    found = [placed for stamp in stamps for placed in rows.take(float(stamp), [float(stamp)])]
    assert [placed.values for placed in found] == [[float(k)] for k in range(90)]
    assert {(placed.lost, placed.restarts) for placed in found} == {(0, False)}
    assert faults.trouble() == "bad rows 32"


@pytest.mark.parametrize(("rate_Hz", "tick_ms"), [(2000.0, 1), (1000.0, 10), (400.0, 1000), (333.0, 1)])
def test_a_coarse_clock_costs_no_row(rate_Hz, tick_ms):
    stamps = [tick_ms * math.floor(k / rate_Hz / MS / tick_ms + 1e-9) for k in range(3000)]
    found, faults = taken(stamps, rate_Hz=rate_Hz)
    assert found == [*range(3000)]
    assert faults == Faults()


def test_a_coarse_clock_shows_what_is_lost():
    stamps = [k // 2 for k in range(200)]
    del stamps[100:103]
    found, faults = taken(stamps, rate_Hz=2000.0)
    assert used(found) == [*range(197)]
    assert [each for each in found if isinstance(each, tuple)] == [
        (2,),
        (1,),
    ]  # the tick of three rows, one of them left
    assert faults == Faults()


def test_rows_stamped_as_they_are_read_are_used_in_order():
    """A serial port hands over 16 rows at once, which the host then stamps."""
    stamps = [16 * (k // 16) + 0.01 * (k % 16) for k in range(1600)]
    found, faults = taken(stamps)
    assert found == [*range(1600)]
    assert faults == Faults()


@pytest.mark.parametrize("stamp", [499.0, 0.0, math.nan, 1e9])
def test_a_clock_that_stands_still_does_not_silence_the_stream(stamp, capsys):
    stamps = ramp(500) + [stamp] * 5000 + ramp(300, 5500)
    found, faults = taken(stamps)
    assert used(found) == [*range(5800)]
    assert used(found) == found  # no gap
    assert faults.bad_rows == 0
    assert faults.outliers > 4000
    assert capsys.readouterr().err.count("used as successive samples") == 1


@given(
    pieces=st.lists(
        st.tuples(st.integers(0, 40), st.sampled_from([0.0, 1e-3, 1.0, 1.5, 700.0, -1.0, math.nan, 1e300]), FAR),
        min_size=1, max_size=12,
    ),
    rate_Hz=st.sampled_from([1.0, 1000.0, 1e6]),
)  # fmt: skip
@examples(60)
def test_whatever_the_stamps_each_row_is_used_in_order_or_counted_and_a_clean_clock_is_heard_again(pieces, rate_Hz):
    stamps = ramp(stamped_rows.FIRST_ROWS, 0.0, 1e3 / rate_Hz)  # it has the right rate
    stamps += [begin + k * step for n, step, begin in pieces for k in range(n)]
    clean = ramp(stamped_rows.MOST_HELD + 2 * BEHIND, 12.0, 1e3 / rate_Hz)
    found, faults = taken([*stamps, *clean], rate_Hz=rate_Hz)
    assert used(found) == sorted(set(used(found)))
    assert len(used(found)) + faults.bad_rows == len(stamps) + len(clean)
    assert found[-BEHIND:] == [*range(len(stamps) + len(clean) - BEHIND, len(stamps) + len(clean))]


# --- what is said and refused -------------------------------------------------------------------------


def test_each_kind_of_fault_is_said_once_as_it_happens(capsys):
    wrapping = [(2**16 - 50 + k) % 2**16 for k in range(100)]
    odd = [1e9, 51.0, -7.0, *ramp(30, 53)]
    rows, said = StampedRows("pipe", 1000.0, MS, Faults()), []
    for number, stamp in enumerate([*wrapping, *odd, *ramp(60), *ramp(60, 9e7), *ramp(60), *([math.nan] * 2100)]):
        list(rows.take(stamp, [float(number)]))
        said += [(number, line) for line in capsys.readouterr().err.splitlines()]
    once = " (said once; the counts come at the end)"
    assert [line for _, line in said] == [
        f"neurotact: pipe: time stamps wrap from 65535 to 0; they go on from there{once}",
        f"neurotact: pipe: time stamps fit no other: 1000000000 after 49; such stamps are ignored{once}",
        f"neurotact: pipe: time stamps jump from 82 to 0: the clock has started again, and so does the chain{once}",
        f"neurotact: pipe: time stamps have fitted no other for 1001 rows, which are used as successive samples{once}",
    ]
    assert [number for number, _ in said] == [50, 101, 133 + BEHIND - 1, 133 + 180 + 1000]


@pytest.mark.parametrize(
    ("unit_s", "step", "words"), [(1.0, 1.0, "1 s"), (MS, MS, "1e-06 s"), (MS, 4.0, "0.004 s"), (MS, 1e3, "1 s")]
)
@pytest.mark.parametrize("n", [60, 900])
def test_stamps_of_another_rate_are_refused(unit_s, step, words, n):
    with pytest.raises(InputError, match=f"pipe: the time stamps advance by {words} a row.*0.001 s.*`time_column`"):
        taken(ramp(n, 0.0, step), unit_s=unit_s)


def test_a_unit_of_microseconds_is_taken():
    faults = Faults()
    rows = parser_of(nt.Samples(time_column="us"), "-", 1, 1000.0, faults)
    assert isinstance(rows, Rows)
    found = [*rows.take(b"0,1\n1000,2\n4000,3\n")]
    assert [(each.missing, None if each.samples is None else each.samples.tolist()) for each in found] == [
        (0, [[1.0], [2.0]]), (2, None), (0, [[3.0]]),
    ]  # fmt: skip
