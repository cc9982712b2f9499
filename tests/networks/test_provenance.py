"""What a network remembers of its trials and its encoder, and what it says of others."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data.recordings import Recordings
from neurotact.data.splits import Split
from neurotact.encoders import specs as encoders
from neurotact.encoders.encoding import encode_recordings
from neurotact.networks.training.provenance import SIDES, Provenance, first_difference, provenance_of

SPLIT = Split(np.array([0, 1, 2]), np.array([3]), np.array([4, 5]))
AFFERENTS = ("SA-I taxel1", "RA-I taxel1")


def touch(copies=()) -> Recordings:
    """Seven different trials; `copies` pairs name trials which are the same recording as another."""
    rng = np.random.default_rng(0)
    signals = [20 * np.sin(rng.uniform(0.05, 0.3) * np.arange(80.0 + i))[:, None] for i in range(7)]
    for trial, original in copies:
        signals[trial] = signals[original]
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": [*"abababa"]}))


def trains_of(recordings=None, **changes):
    return encode_recordings(recordings or touch(), encoders.load("sa1-ra1-lif", changes))


def table_of(**changes):
    return encoders.load("sa1-ra1-lif", changes).model_dump(mode="json", exclude_none=True)


# --- trials ------------------------------------------------------------------------------------------


def test_every_trial_stands_on_its_side_and_what_no_side_holds_is_unseen():
    trains = trains_of()
    known = provenance_of(trains, SPLIT)
    assert known.sides(trains).tolist() == ["training"] * 3 + ["validation", "test", "test", "unseen"]
    assert known.tested(trains).tolist() == [4, 5]


@given(order=st.permutations(range(7)), keep=st.integers(1, 7))
def test_trials_are_known_by_content_wherever_they_stand(order, keep):
    trains = trains_of()
    sides = provenance_of(trains, SPLIT).sides(trains)
    chosen = np.array(order[:keep])
    moved = trains.select(chosen)
    assert provenance_of(trains, SPLIT).sides(moved).tolist() == sides[chosen].tolist()
    without = replace(moved, trial_digests=())
    assert provenance_of(trains, SPLIT).sides(without).tolist() == sides[chosen].tolist()


def test_a_recording_is_known_whatever_its_label_and_its_encoder():
    trains = trains_of()
    other = replace(touch(), conditions=pd.DataFrame({"label": [*"bababab"]}))
    again = trains_of(other, **{"sa1.gain": 10.0})
    assert provenance_of(trains, SPLIT).sides(again).tolist() == provenance_of(trains, SPLIT).sides(trains).tolist()
    # Its spikes are others, so that those without the recording's digest are not known.
    assert set(provenance_of(trains, SPLIT).sides(replace(again, trial_digests=()))) == {"unseen"}


@pytest.mark.parametrize(
    ("copies", "expected"),
    [
        ([(4, 0)], ["training", "test"]), ([(4, 3)], ["validation", "test"]), ([(5, 4)], ["test", "test"]),
        ([(4, 1), (3, 1)], ["training", "test"]),
    ],
)  # fmt: skip
def test_a_trial_that_stands_on_several_sides_counts_as_the_most_seen(copies, expected):
    trains = trains_of(touch(copies))
    known = provenance_of(trains, SPLIT)
    assert known.sides(trains)[4:6].tolist() == expected
    assert {4, 5} <= set(known.tested(trains).tolist())


@pytest.mark.parametrize("trained_with", [True, False])
@pytest.mark.parametrize("asked_with", [True, False])
def test_files_with_and_without_digests_of_recordings_are_told_by_what_both_know(trained_with, asked_with):
    trains = trains_of()
    bare = replace(trains, trial_digests=())
    known = provenance_of(trains if trained_with else bare, SPLIT)
    found = known.sides(trains if asked_with else bare)
    assert found.tolist() == ["training"] * 3 + ["validation", "test", "test", "unseen"]


def test_a_copy_that_was_rounded_is_known_by_its_spikes():
    """Its digest is another; a new recording of the same touch with a little noise is not known."""
    rng = np.random.default_rng(0)
    signals = [30 * rng.standard_normal((400, 4)).cumsum(axis=0) for _ in range(7)]
    recordings = Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": [*"abababa"]}))
    trains = trains_of(recordings, **{"sa1.gain": 1.0})
    known = provenance_of(trains, SPLIT)
    expected = ["training"] * 3 + ["validation", "test", "test", "unseen"]
    rounded = trains_of(replace(recordings, signals=[signal.round(4) for signal in signals]), **{"sa1.gain": 1.0})
    assert not set(rounded.trial_digests) & set(trains.trial_digests)
    assert known.sides(rounded).tolist() == expected
    noisy = [signal + 3 * rng.standard_normal(signal.shape) for signal in signals]
    assert set(known.sides(trains_of(replace(recordings, signals=noisy), **{"sa1.gain": 1.0}))) == {"unseen"}


def test_silent_trials_of_other_recordings_are_not_known():
    silent = [replace(touch(), signals=[0 * signal + level for signal in touch().signals]) for level in (0.0, 1e-3)]
    first, other = (trains_of(each) for each in silent)
    assert not any(map(len, first.steps + other.steps))
    assert set(provenance_of(first, SPLIT).sides(other)) == {"unseen"}


@given(
    digests=st.lists(st.text("0123456789abcdef", min_size=16, max_size=16), max_size=4)
    | st.lists(st.text(), max_size=4)
)
def test_provenance_comes_back_equal_from_json_and_from_lists_of_earlier_versions(digests):
    sides = {
        side: {"recorded": digests[::step], "spikes": digests[:step]}
        for side, step in zip(SIDES, (1, -1, 2), strict=True)
    }
    listed = {"encoder": {}, "afferents": AFFERENTS, "trials": sides}
    known = Provenance.model_validate(listed)
    assert known.model_dump() == Provenance.model_validate(json.loads(known.model_dump_json())).model_dump()
    for side, its in known.trials:
        assert [list(its.recorded), list(its.spikes)] == [*sides[side].values()]


def test_a_trial_takes_22_bytes_of_the_file():
    digests = [f"{number:016x}" for number in range(1000)]
    trials = {side: {"recorded": digests, "spikes": digests} for side in SIDES}
    text = json.dumps(Provenance(encoder={}, afferents=(), trials=trials).model_dump(mode="json"), indent=2)
    assert len(text) < 3 * 1000 * 22


@pytest.mark.parametrize("text", ["AAAA", "AAAAAAAAAA", "%" * 12])
def test_digests_that_are_damaged_are_refused(text):
    trials = {side: {"spikes": text} for side in SIDES}
    with pytest.raises(ValueError, match="spikes"):
        Provenance(encoder={}, afferents=(), trials=trials)


# --- encoders ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"sa1.t_ref_ms": 5}, "sa1.t_ref_ms is 5.0 but was 1.0 in training"),
        ({"ra1.gain": 20, "sa1.gain": 4}, "sa1.gain is 4.0 but was 3.2 in training"),
        ({"conditioning.ema_cutoff_Hz": 45}, "conditioning.ema_cutoff_Hz is 45.0 but was "),
        ({"conditioning.rectify": True}, "conditioning.rectify is True but was False in training"),
        ({"conditioning.resample_Hz": 500}, "conditioning.resample_Hz is 500.0 but was absent in training"),
        ({"conditioning.scale": [1, 2]}, "conditioning.scale.0 is 1.0 but was absent in training"),
    ],
)
def test_the_first_key_that_differs_is_named_with_both_values(changes, expected):
    found = first_difference(table_of(**changes), AFFERENTS, table_of(), AFFERENTS)
    assert str(found).startswith(expected)


def test_other_afferents_and_models_differ():
    found = first_difference(table_of(), AFFERENTS[::-1], table_of(), AFFERENTS)
    assert str(found) == "afferent 1 is RA-I taxel1 but was SA-I taxel1 in training"
    poisson = encoders.load("poisson").model_dump(mode="json")
    assert str(first_difference(poisson, AFFERENTS, table_of(), AFFERENTS)).startswith("model is poisson but was lif")
    assert str(first_difference({}, (), table_of(), ())).endswith("in training")


@pytest.mark.parametrize("without", ["v_rest_mV", "model", "conditioning"])
def test_a_default_that_is_not_written_out_is_no_difference(without):
    spec = encoders.load("sa1-ra1-lif", {"v_rest_mV": -65.0}).model_copy(update={"conditioning": _PLAIN})
    table = spec.model_dump(mode="json", exclude_none=True)
    shorter = {key: value for key, value in table.items() if key != without}
    assert first_difference(shorter, AFFERENTS, table, AFFERENTS) is None
    assert first_difference(spec.model_dump(mode="json"), AFFERENTS, shorter, AFFERENTS) is None


_PLAIN = encoders.load("sa1-ra1-lif").conditioning.__class__()


def test_encoders_that_this_version_does_not_know_are_compared_as_they_stand():
    assert first_difference({"model": "mine", "a": {"b": 1}}, (), {"model": "mine", "a": {"b": 1}}, ()) is None
    found = first_difference({"model": "mine", "a": {"b": 2}}, (), {"model": "mine", "a": {"b": 1}}, ())
    assert str(found) == "a.b is 2 but was 1 in training"
