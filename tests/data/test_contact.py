"""The onset of contact: counted by hand, and decided by what came before it alone."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data.contact import OnsetSpec, onset_of
from neurotact.data.spikes import SpikeTrains, TrialSpikes, from_trials
from neurotact.data.windowed import windows
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.spec import build

SPIKES = st.lists(st.integers(0, 299), max_size=200).map(lambda steps: np.sort(np.array(steps, np.int64)))


def trains_of(*trials: list[int], n_steps: int = 300) -> SpikeTrains:
    spikes = [TrialSpikes(np.array(steps, np.int64), np.zeros(len(steps), np.uint16), n_steps) for steps in trials]
    table = pd.DataFrame({"label": ["felt", "silk"] * len(spikes)}).head(len(spikes))
    return from_trials(spikes, 1000.0, ("SA-I taxel1",), table)


@given(SPIKES, st.integers(0, 300))
def test_what_comes_later_cannot_move_an_onset(steps, cut_at):
    """The rule is causal: an onset before `cut_at` is the same however the trial goes on."""
    whole, past = (onset_of(some, 1000.0, OnsetSpec()) for some in (steps, steps[steps < cut_at]))
    if past is not None or (whole is not None and whole < cut_at):
        assert past == whole


@given(SPIKES, st.floats(0.5, 8), st.integers(1, 30))
def test_an_onset_is_the_first_step_above_the_level(steps, deviations, width):
    spec = OnsetSpec(rest_ms=50, bin_ms=width, deviations=deviations)
    count = np.array([((steps > t - width) & (steps <= t)).sum() for t in range(300)])
    rest = count[width - 1 : 50]
    above = np.flatnonzero(count > rest.mean() + deviations * max(rest.std(), rest.mean() ** 0.5, 1))
    above = above[above >= 50]
    assert onset_of(steps, 1000.0, spec) == (above[0] if len(above) else None)


def test_windows_start_at_the_onset_and_say_where_they_cannot():
    """Four spikes within 10 ms are more than three deviations above silence; three are not."""
    trains = trains_of([100, 101, 102, 103], [100, 101, 102], [290, 291, 292, 293])
    data = trains.cut(WindowSpec(length_ms=20, start_ms=5, per_trial=1, align="onset"))
    assert data.start.tolist() == [108, 5, 280]
    complaint = (
        r"1 of 3 trials have no onset of contact \(the first is trial 1\): their windows start at the "
        r"trial's beginning; 1 end too soon after it for a window \(the first is trial 2\)"
    )
    with pytest.warns(UserWarning, match=complaint):
        windows(trains, nt.Window(length_ms=20, start_ms=5, per_trial=1, align="onset"))
    assert (
        windows(trains_of([100, 101, 102, 103], [60, 61, 62, 63]), nt.Window(length_ms=20, align="onset")).start_steps[
            0
        ]
        == 103
    )


def test_a_restless_afferent_is_no_contact():
    """One spike per ms at rest: ten in each bin, so that contact is more than 10 + 3 sqrt(10) of them."""
    restless = list(range(300))
    assert onset_of(np.array(restless), 1000.0, OnsetSpec()) is None
    touched = np.sort(np.array(restless + [200] * 10))
    assert onset_of(touched, 1000.0, OnsetSpec()) == 200


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ({"bin_ms": 60}, "bin_ms must not exceed rest_ms"),
        ({"deviations": 0}, "deviations"),
        ({"rest_ms": -1}, "rest_ms"),
    ],
)
def test_a_rule_that_cannot_be_is_no_spec(table, complaint):
    with pytest.raises(InputError, match=complaint):
        build(OnsetSpec, table, "study.toml")


def test_a_bin_below_one_step_is_refused():
    with pytest.raises(InputError, match=r"window\.onset\.bin_ms: 10 ms is less than one step at 30 Hz"):
        onset_of(np.array([1]), 30.0, OnsetSpec())


def test_a_window_from_an_onset_is_read_back_equal():
    spec = WindowSpec(align="onset", onset=OnsetSpec(deviations=5))
    assert WindowSpec.model_validate(spec.model_dump(mode="json")) == spec
