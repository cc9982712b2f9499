"""The steps of events: all events on a clock are kept, however the stamps are written; others keep their step."""

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.readers.events.times import (
    Rounding,
    event_times,
    in_order,
    joined_times,
    lengths_of,
    rounding_of,
    steps_of,
)

from neurotact.data.readers.clock.units import UNIT_S

RATES_HZ = [35.6, 100.0, 900.0, 1000.0, 3000.0, 12_345.6, 25_600.0, 30_000.0, 44_100.0]
EPOCH_S = {"zero": [0], "first": [0, 1_036_800, 1_700_000_000]}
"""Seconds from the counter's zero to the trial: at once, after twelve days of uptime, since 1970."""


def steps(stamps, unit_s, step_s, origin: Any = "zero", **options) -> list[int]:
    times = event_times(stamps, unit_s, origin, **options)
    return steps_of(times, step_s, rounding_of(times, step_s)).tolist()


def exact(ticks: np.ndarray, rate_Hz: float, unit: Any, way: str) -> list[int]:
    """Stamps in whole units of ticks of a clock, by whole numbers alone."""
    tenths = round(10 * rate_Hz)
    units = 10 * round(1 / UNIT_S[unit])
    return [(2 * tick * units + tenths * (way == "round")) // (2 * tenths) for tick in ticks.tolist()]


@st.composite
def clocks(draw):
    """A rate, a unit of stamps that can tell its steps apart, and some of its ticks, the first at zero or not."""
    rate_Hz, unit = draw(st.sampled_from(RATES_HZ)), draw(st.sampled_from(sorted(UNIT_S)))
    assume(4 * UNIT_S[unit] < 1 / rate_Hz)
    seed, n, every = draw(st.integers(0, 10**6)), draw(st.integers(40, 200)), draw(st.sampled_from([1, 2, 7]))
    ticks = every * np.sort(np.random.default_rng(seed).choice(1500, n, replace=False))
    return rate_Hz, unit, ticks


@given(
    clocks(), st.sampled_from(["i4", "u4", "i8", "u8", "f8", "text"]), st.sampled_from(["round", "cut"]),
    st.sampled_from(sorted(EPOCH_S)), st.integers(0, 2),
)  # fmt: skip
@examples(100)
def test_whole_stamps_of_a_clock_keep_every_event(clock, kind, way, origin, epoch):
    rate_Hz, unit, ticks = clock
    long_ago = round(EPOCH_S[origin][epoch % len(EPOCH_S[origin])] / UNIT_S[unit])
    stamps = [stamp + long_ago for stamp in exact(ticks, rate_Hz, unit, way)]
    assume(kind == "text" or kind[0] == "f" or max(stamps) <= np.iinfo(kind).max)
    assume(kind != "f8" or max(stamps) < 2**53)
    due = (ticks - (ticks[0] if origin == "first" else 0)).tolist()
    texts = np.array(list(map(str, stamps)))
    found = np.array(stamps, "i8" if kind == "text" else kind)
    assert steps(found, UNIT_S[unit], 1 / rate_Hz, origin, texts=texts if kind == "text" else None) == due


@given(
    clocks(),
    st.sampled_from(["f4", "f8", "product", "%.6f", "%.9f", "%.7g", "%.6e", "%r", "f4 text", "was f4", "f4 us"]),
    st.booleans(),
)
@examples(100)
def test_fractions_keep_every_event(clock, kind, is_late):
    """Seconds in floats and as text of any form; where origins are far the stamps still tell steps apart."""
    rate_Hz, _, ticks = clock
    time_s = ticks / rate_Hz + 3.0 * is_late
    origin, texts = "first" if is_late else "zero", None
    if kind in ("f4", "f8"):
        stamps = time_s.astype(kind)
    elif kind == "was f4":
        stamps = time_s.astype("f4").astype(float)
    elif kind == "f4 us":
        stamps = np.round(time_s, 6).astype("f4")
    elif kind == "product":
        stamps = ticks.astype("f4") * np.float32(1 / rate_Hz) + np.float32(3.0 * is_late)
    else:
        texts = time_s.astype("f4").astype(str) if kind == "f4 text" else np.array([kind % t for t in time_s.tolist()])
        stamps = texts.astype(float)
    assume(4 * np.abs(stamps.astype(float) - time_s).max() < 1 / rate_Hz)
    due = (ticks - (ticks[0] if is_late else 0)).tolist()
    assert steps(stamps, 1.0, 1 / rate_Hz, origin, texts=texts) == due


@pytest.mark.parametrize("resolution", [4, 10, 1000])
@pytest.mark.parametrize("unit", ["us", "ns"])
def test_a_timer_coarser_than_its_unit_keeps_every_event(resolution, unit):
    """Four microseconds of a small board's timer; nanoseconds that were microseconds."""
    rate_Hz = round(1 / (8.37 * UNIT_S[unit] * resolution), 1)
    stamps = np.array(exact(np.arange(500), rate_Hz, unit, "cut")) // resolution * resolution
    assert steps(stamps, UNIT_S[unit], 1 / rate_Hz) == list(range(500))


@pytest.mark.parametrize("way", ["round", "cut"])
@pytest.mark.parametrize("rate_Hz", [600.0, 800.0, 900.0, 970.0])
def test_milliseconds_tell_the_steps_of_a_clock_that_is_hardly_slower(rate_Hz, way):
    ticks = np.arange(2000)
    assert steps(np.array(exact(ticks, rate_Hz, "ms", way)), 1e-3, 1 / rate_Hz) == ticks.tolist()


def test_one_event_is_enough_where_the_unit_is_known():
    assert steps(np.array([33]), 1e-6, 1 / 30_000) == [1]
    assert steps(np.array([0.000033]), 1.0, 1 / 30_000, texts=np.array(["0.000033"])) == [1]


def test_events_beside_a_clock_leave_those_on_it_where_they_are():
    """A third of the events come from elsewhere: they keep the step that holds them, the others that of the clock."""
    rng = np.random.default_rng(0)
    ticks = rng.choice(5000, 400, replace=False)
    stamps = np.concatenate([np.array(exact(ticks, 30_000.0, "us", "round")), rng.integers(0, 160_000, 200)])
    found = np.array(steps(stamps, 1e-6, 1 / 30_000))
    assert found[:400].tolist() == ticks.tolist()
    others = stamps[400:] * 0.03
    assert (np.abs(others - np.rint(others)) < 0.02)[found[400:] != np.floor(others + 1e-9)].all()


def test_events_at_any_time_after_the_first_of_their_trial_are_on_no_clock():
    """The first event of each trial is at its origin, which says nothing."""
    stamps = np.random.default_rng(0).integers(0, 100_000, 1000)
    trial = np.repeat(np.arange(500), 2)
    times = event_times(stamps, 1e-6, "first", trial)
    assert rounding_of(times, 1 / 30_000) is None
    assert steps_of(times, 1 / 30_000, None).tolist() == np.floor(times.time_s * 30_000 + 1e-9).tolist()


@pytest.mark.parametrize("way", [np.rint, np.floor])
def test_trials_that_begin_between_two_steps_keep_every_event(way):
    """Each trial has its own distance from the clock, here all around a microsecond, so no rounding is that of all."""
    ticks = np.arange(1, 200)
    trials = [event_times(way((ticks / 30_000 + phase * 1e-6) / 1e-6).astype(int), 1e-6) for phase in range(34)]
    trials += [event_times(way((ticks / 30_000 - 4e-7) / 1e-6).astype(int), 1e-6)]
    overall = rounding_of(joined_times(trials), 1 / 30_000)
    assert overall is None
    for trial in trials:
        assert (np.diff(steps_of(trial, 1 / 30_000, overall)) == 1).all()


def test_trials_last_until_their_end_but_for_what_is_rounding():
    ends = event_times(np.array([0.6, 0.6 + 1e-10, 0.6001, 1e-9]), 1.0)
    assert lengths_of(ends, 1e-3, None).tolist() == [600, 600, 601, 1]
    assert lengths_of(ends, 1e-3, Rounding(0.0, 2e-4)).tolist() == [600, 600, 600, 1]


@pytest.mark.parametrize("rate_Hz", [500, 1000, 2000])
def test_whole_numbers_of_products_lose_no_event(rate_Hz):
    """1.001 * 1e6 is a little less than 1001000, and cut off 1000999."""
    stamps = (np.arange(3000) / rate_Hz * 1e6).astype(int)
    assert (stamps % (1_000_000 // rate_Hz) != 0).any()
    assert steps(stamps, 1e-6, 1 / rate_Hz) == list(range(3000))


@given(st.integers(0, 10**6), st.integers(1, 300), st.sampled_from([2, 5, 33, 100, 1000]))
@examples(100)
def test_events_at_any_time_keep_the_step_that_holds_them(seed, n, microseconds):
    """Steps of whole microseconds: the stamp says the step, and nothing is moved to the next."""
    stamps = np.random.default_rng(seed).integers(0, 40 * microseconds, n)
    moved = np.array(steps(stamps, 1e-6, microseconds * 1e-6)) - stamps // microseconds
    on_clock = (stamps % microseconds <= 1) | (stamps % microseconds == microseconds - 1)
    assert not moved[~on_clock].any()
    assert on_clock.all() or not moved.any()


@given(st.integers(0, 10**6), st.sampled_from(["f2", "f4", "f8"]), st.sampled_from([0.001, 0.0007]))
@examples(60)
def test_floats_at_any_time_move_by_no_more_than_their_precision(seed, kind, step_s):
    stamps = np.random.default_rng(seed).random(400).astype(kind)
    place = stamps.astype(float) / step_s
    moved = np.array(steps(stamps, 1.0, step_s)) - np.floor(place)
    precision = 2 * np.spacing(stamps).astype(float) / step_s
    assert set(moved.tolist()) <= {0, 1}
    assert (np.ceil(place) - place <= precision + 1e-8)[moved == 1].all()
    assert moved.mean() < 0.01  # half precision is as coarse as the step, and says no clock


def test_the_last_microsecond_of_a_step_is_in_it():
    assert steps(np.array([0, 999, 1000, 1999]), 1e-6, 1e-3) == [0, 0, 1, 1]
    assert steps(np.array([4, 9, 15]), 1e-3, 5e-3) == [0, 1, 3]
    assert steps(np.array([0.0, 0.02, 0.05]), 1.0, 0.025) == [0, 0, 2]
    always = np.arange(999, 9000, 1000)
    assert steps(always, 1e-6, 1e-3) == list(range(9))
    both = np.array([1000, 1999, 4999, 5000, 7000, 7999])  # two stamps of one step are no rounding of its beginning
    assert steps(both, 1e-6, 1e-3) == [1, 1, 4, 5, 7, 7]


def test_origins_are_of_each_trial_and_of_any_integer():
    top = np.array([2**64 - 1, 2**64 - 1001, 7, 2007], np.uint64)
    times = event_times(top, 1e-6, "first", np.array([0, 0, 1, 1]))
    assert times.time_s.tolist() == [0.001, 0.0, 0.0, 0.002]
    low = np.array([-(2**63), 2**62], np.int64)
    assert event_times(low, 1e-9, "first").time_s.tolist() == [0.0, (2**63 + 2**62) * 1e-9]
    assert event_times(np.zeros(0, np.int64), 1e-6, "first").time_s.tolist() == []


@pytest.mark.parametrize(("bits", "kind"), [(31, "i8"), (32, "u4"), (32, "i4"), (32, "i8")])
def test_a_counter_that_begins_again_goes_on(bits, kind):
    true = 2**bits - 500_000 + 1000 * np.arange(1000) - (2**31 if kind == "i4" else 0)
    low = -(2**31) if kind == "i4" else 0
    stamps = ((true - low) % 2**bits + low).astype(kind)
    found = in_order(stamps, np.zeros(1000, int), [np.arange(1000) % 7])
    assert (found.n_wraps, found.n_back) == (1, 0)
    np.testing.assert_array_equal(found.stamps, true)
    two = in_order(np.concatenate([stamps, stamps]), np.repeat([1, 0], 1000), [np.arange(2000) % 7])
    assert two.n_wraps == 2
    np.testing.assert_array_equal(two.stamps, np.concatenate([true, true]))


@pytest.mark.parametrize(
    ("stamps", "afferent", "n_back"),
    [
        ([0, 1, 2, 3, 9, 4, 10], [0, 1, 0, 1, 0, 1, 0], 1),  # one event late
        ([0, 5, 9, 0, 4, 8], [0, 0, 0, 1, 1, 1], 0),  # one afferent after the other
        ([5, 1, 4, 2, 3, 0], [0, 1, 0, 1, 0, 1], 0),  # in no order at all
        ([0, 100, 4_000_000_000, 5, 105], [0, 1, 0, 1, 0], 1),  # one event far ahead
        ([0, 1_500_000_000, 3_000_000_000, 5, 105], [0, 1, 0, 1, 0], 1),  # far back, but not the range of a counter
    ],
)
def test_events_out_of_order_are_counted(stamps, afferent, n_back):
    found = in_order(np.array(stamps), np.zeros(len(stamps), int), [np.array(afferent)])
    assert (found.n_back, found.n_wraps, found.stamps.tolist()) == (n_back, 0, stamps)


def test_nanoseconds_of_a_trial_pass_the_range_of_a_counter():
    true = np.arange(0, 8_000_000_000, 10_000_000)
    shown = true % 2**32
    assert in_order(shown, np.zeros(len(true), int), [np.arange(len(true)) % 3]).n_wraps == 1
    assert in_order(shown, np.zeros(len(true), int), [np.arange(len(true)) % 3], may_wrap=False).n_wraps == 0
