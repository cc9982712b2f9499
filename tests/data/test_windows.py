"""Windows lie inside their trial and remember it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data.windows import WindowSpec, cut
from neurotact.errors import InputError
from neurotact.spec import build

LENGTHS = st.lists(st.integers(20, 60), min_size=1, max_size=5)
SPECS = st.builds(
    WindowSpec,
    length_ms=st.integers(1, 15), start_ms=st.integers(0, 5), hop_ms=st.none() | st.integers(1, 20),
    per_trial=st.none() | st.integers(1, 4),
)  # fmt: skip


@given(LENGTHS, SPECS)
def test_every_window_lies_in_its_trial_after_the_start(lengths, spec):
    windows = cut(np.array(lengths), 1000.0, spec)
    assert windows.n_steps == spec.length_ms
    assert (windows.start >= spec.start_ms).all()
    assert (windows.start + windows.n_steps <= np.array(lengths)[windows.trial]).all()


@given(LENGTHS, SPECS)
def test_a_trial_has_all_the_windows_that_fit_and_no_more_than_asked(lengths, spec):
    windows = cut(np.array(lengths), 1000.0, spec)
    hop = spec.hop_ms or spec.length_ms
    for trial, length in enumerate(lengths):
        starts = [s for s in range(int(spec.start_ms), length, int(hop)) if s + spec.length_ms <= length]
        assert windows.start[windows.trial == trial].tolist() == starts[: spec.per_trial]


@given(LENGTHS, SPECS)
def test_windows_without_a_hop_do_not_overlap(lengths, spec):
    windows = cut(np.array(lengths), 1000.0, spec.model_copy(update={"hop_ms": None}))
    steps = [(trial, start + i) for trial, start in zip(windows.trial, windows.start, strict=True)
             for i in range(windows.n_steps)]  # fmt: skip
    assert len(set(steps)) == len(steps)


def test_windows_name_the_trials_that_they_are_given():
    windows = cut(np.array([4, 2]), 1000.0, WindowSpec(length_ms=2), trials=np.array([7, 3]))
    assert windows.trial.tolist() == [7, 7, 3]
    with pytest.raises(InputError, match=r"trial 3 lasts 0\.002 s, less than the 0\.003 s of start_ms \+ length_ms"):
        cut(np.array([4, 2]), 1000.0, WindowSpec(length_ms=3), trials=np.array([7, 3]))


def test_a_length_is_rounded_to_steps_of_the_clock():
    assert cut(np.array([100]), 35.6, WindowSpec(length_ms=2000)).n_steps == 71


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"length_ms": 0.1}, "window.length_ms: 0.1 ms is less than one step at 1000 Hz; lengthen it (in milliseconds"),
        ({"length_ms": 5, "hop_ms": 0.2}, "window.hop_ms: 0.2 ms is less than one step"),
        ({"length_ms": 0.5}, "window.length_ms: 0.5 ms is less than one step"),  # half a step, which rounds down
        ({"length_ms": 0.6}, "window.length_ms: 0.6 ms is less than one step"),  # and more, which rounds up
        ({"length_ms": 50}, "trial 1 lasts 0.030 s, less than the 0.050 s"),
        ({"length_ms": 10, "start_ms": 1000}, "trial 1 lasts 0.030 s"),
    ],
)
def test_a_window_that_does_not_fit_is_refused(spec, message):
    with pytest.raises(InputError) as refusal:
        cut(np.array([100, 30, 40]), 1000.0, WindowSpec(**spec))
    assert message in str(refusal.value)


@pytest.mark.parametrize("table", [{"length_ms": 0}, {"start_ms": -1}, {"hop_ms": 0}, {"per_trial": 0}])
def test_a_window_of_nothing_is_no_spec(table):
    with pytest.raises(InputError, match=next(iter(table))):
        build(WindowSpec, table, "study.toml")


def test_more_windows_than_memory_holds_are_refused():
    with pytest.raises(
        InputError, match="the cut into 1099511627776 windows: holds 43,980,465 MB, more than the limit"
    ):
        cut(np.array([2**40]), 1000.0, WindowSpec(length_ms=1))


@pytest.mark.parametrize("key", ["length_ms", "start_ms", "hop_ms"])
@pytest.mark.parametrize("duration_ms", [1e19, 1e300])
def test_a_window_longer_than_any_trial_is_refused(key, duration_ms):
    with pytest.raises(InputError, match=f"window.{key}: 1e\\+[0-9]+ ms is longer than any trial may be; shorten it"):
        cut(np.array([1000]), 1000.0, WindowSpec(**{"length_ms": 3, key: duration_ms}))
