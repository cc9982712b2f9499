"""Copies of a trial: found by their content, whatever they are called; and other trials are none."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.readers import nwb
from neurotact_parts.readers.neo_blocks import from_neo, to_neo
from neurotact_parts.readers.nwb_output import to_nwb

from neurotact.data import conditioning, doubtful, hdf5
from neurotact.data import copies as finding
from neurotact.data.copies import Copies, copies_of, equal_examples, joined
from neurotact.data.digests import recorded_digest
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.data.splits import SplitSpec, hold_out, split_touches, training_touches
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import load
from neurotact.errors import InputError

NAMES = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")


def walk(seed: int, length: int = 240, taxels: int = 3, scale: float = 1.0) -> np.ndarray:
    return scale * np.random.default_rng(seed).standard_normal((length, taxels)).cumsum(axis=0)


def recordings_of(signals, labels=None, **columns) -> Recordings:
    table = pd.DataFrame({"label": labels or ["a", "b"] * (len(signals) // 2) + ["a"] * (len(signals) % 2), **columns})
    return Recordings(signals, 1000.0, "mV", table)


def spikes_of(rasters, labels=None) -> SpikeTrains:
    return from_rasters(rasters, 1000.0, NAMES, pd.DataFrame({"label": labels or ["a"] * len(rasters)}))


def interpolated(signal: np.ndarray, factor: int) -> np.ndarray:
    """Every `factor`-th sample alone, on the clock of all: what an import makes of an export at a lower rate."""
    time = np.arange(0, len(signal), factor)
    return np.stack([np.interp(np.arange(time[-1] + 1), time, column) for column in signal[::factor].T], axis=1)


# --- recordings ---------------------------------------------------------------------------------------

COPYING = st.lists(st.integers(0, 4), min_size=1, max_size=9)


@given(COPYING, st.integers(1, 3), st.integers(10, 40))
def test_trials_of_one_touch_are_found_and_no_others(touches, taxels, length):
    found = copies_of(recordings_of([walk(touch, length, taxels) for touch in touches]))
    assert found.first.tolist() == [touches.index(touch) for touch in touches]
    assert not found.is_near.any()
    assert found.trials.tolist() == [at for at, touch in enumerate(touches) if touches.index(touch) < at]


@pytest.mark.parametrize(("length", "taxels", "scale"), [(240, 3, 1.0), (900, 8, 1e-3), (60, 2, 50.0), (400, 1, 1.0)])
@pytest.mark.parametrize(
    "change",
    [
        lambda x: x.round(6), lambda x: x[:-5], lambda x: x[7:], lambda x: x[: int(0.7 * len(x))],
        lambda x: x[:, ::-1], lambda x: x + 2 * np.abs(x).max(), lambda x: interpolated(x, 2),
        lambda x: x.round(6)[3:-2, ::-1],
    ],
)  # fmt: skip
def test_near_copies_are_found_wherever_they_are(change, length, taxels, scale):
    touches = [walk(seed, length, taxels, scale) for seed in range(8)]
    for place in (0, 8):
        signals = touches[:]
        signals.insert(place, change(touches[3]))
        first, original = (0, 4) if place == 0 else (3, 3)
        expected = np.arange(9)
        expected[[original, place]] = first
        assert copies_of(recordings_of(signals)).first.tolist() == expected.tolist()


@examples(20)
@given(st.integers(0, 1000), st.floats(0.05, 3.0))
def test_a_touch_repeated_with_noise_is_no_copy(seed, noise):
    """The same movement twice: equal but for noise of a twentieth of the typical change."""
    once, rng = walk(seed), np.random.default_rng(seed + 1)
    again = once + noise * rng.standard_normal(once.shape)
    assert not len(copies_of(recordings_of([once, again])).trials)


def test_windows_that_overlap_are_no_copies():
    signal = walk(0, 1000)
    assert not len(copies_of(recordings_of([signal[at : at + 300] for at in range(0, 700, 100)])).trials)


def test_a_trial_that_contains_two_others_makes_them_one():
    whole = walk(0, 300)
    found = copies_of(recordings_of([whole[:200], whole[100:], walk(1, 300), whole]))
    assert found.first.tolist() == [0, 0, 2, 0]
    assert found.is_near.tolist() == [False, True, False, True]


@pytest.mark.parametrize("signal", [np.zeros((50, 3)), np.full((50, 3), 0.1234567), np.eye(50, 3) * [1, 0, 0]])
def test_a_trial_that_hardly_changes_is_a_copy_of_nothing(signal):
    recordings = recordings_of([signal, walk(0, 50), signal, walk(0, 50)])
    assert copies_of(recordings).first.tolist() == [0, 1, 2, 1]
    trains = encode_recordings(recordings, load("sa1-ra1-lif", {"conditioning.baseline": "none"}))
    assert copies_of(trains).first.tolist() == copies_of(trains).equal.tolist() == [0, 1, 2, 1]
    assert trains.trial_digests[0] == trains.trial_digests[2]


@given(order=st.permutations(range(7)))
def test_the_order_of_trials_plays_no_part(order):
    touches = [0, 1, 0, 2, 1, 3, 0]
    signals = [walk(touch)[touch if at == 4 else 0 :] for at, touch in enumerate(touches)]  # trial 4 is cut
    moved = copies_of(recordings_of([signals[at] for at in order])).first
    same = np.array([touches[at] for at in order])
    assert ((moved[:, None] == moved) == (same[:, None] == same)).all()


def test_a_long_trial_in_a_file_is_compared_to_its_end(tmp_path):
    once, other = walk(0, 2000), walk(0, 2000)
    other[-100:] += 5 * walk(2, 100)
    recordings = recordings_of([once, walk(1, 2000), once, other, once.round(5)])
    hdf5.save_recordings(recordings, tmp_path / "touch.h5")
    with patch.object(conditioning, "PIECE_VALUES", 3000), hdf5.open_recordings(tmp_path / "touch.h5") as stored:
        for touches in (stored, recordings):
            found = copies_of(touches)
            assert found.first.tolist() == [0, 1, 0, 3, 0]
            assert found.is_near.tolist() == [False, False, False, False, True]


@pytest.mark.parametrize("form", ["memory", "hdf5", "nwb", "neo"])
def test_spikes_remember_near_copies_in_every_format(form, tmp_path):
    signals = [walk(0), walk(1), walk(0), walk(1)[4:].round(5), walk(2)]
    recordings = recordings_of(signals, ["a"] * 5)
    trains = encode_recordings(recordings, load("sa1-ra1-lif"))
    own = tuple(recorded_digest(recordings, trial) for trial in range(5))
    if form == "hdf5":
        hdf5.save_spikes(trains, tmp_path / "spikes.h5")
        trains = hdf5.load_spikes(tmp_path / "spikes.h5")
    elif form == "nwb":
        pytest.importorskip("pynwb")
        to_nwb(trains, tmp_path / "spikes.nwb")
        trains = nwb.read(tmp_path / "spikes.nwb")
    elif form == "neo":
        pytest.importorskip("neo")
        trains = from_neo(to_neo(trains))
    assert trains.trial_digests == own
    assert trains.trial_touches == (own[0], own[1], own[0], own[1], own[4])
    assert copies_of(trains).first.tolist() == copies_of(recordings).first.tolist() == [0, 1, 0, 1, 4]
    assert copies_of(trains).equal.tolist() == copies_of(recordings).equal.tolist() == [0, 1, 0, 3, 4]
    assert copies_of(trains.select([4, 3, 1, 0])).first.tolist() == [0, 1, 1, 3]
    assert encode_recordings(recordings.select([0, 1, 4]), load("sa1-ra1-lif")).trial_touches == ()


@given(st.lists(st.integers(0, 3), min_size=1, max_size=8), st.lists(st.sampled_from("xyz"), min_size=8, max_size=8))
def test_joined_trials_share_a_group_with_each_neighbour_of_a_chain(numbers, names):
    pairs = [*zip(numbers, names, strict=False)]
    expected = [*range(len(pairs))]
    for _ in pairs:  # as many rounds as the longest chain has links
        for one, (number, name) in enumerate(pairs):
            alike = [at for at, (other, its) in enumerate(pairs) if other == number or its == name]
            expected[one] = min(expected[at] for at in alike)
    assert joined(np.array(numbers), np.array(names[: len(numbers)])).tolist() == expected


# --- spikes -------------------------------------------------------------------------------------------


def rasters_of(seed: int, n: int, density: float = 0.2) -> np.ndarray:
    return (np.random.default_rng(seed).random((n, 60, 4)) < density).astype(np.uint8)


@given(COPYING, st.lists(st.booleans(), min_size=9, max_size=9))
def test_spike_trains_are_copies_of_equal_ones_and_never_while_silent(touches, silent):
    rasters = [0 * rasters_of(0, 1)[0] if silent[at] else rasters_of(touch, 1)[0] for at, touch in enumerate(touches)]
    expected, known = [], {}
    for at, touch in enumerate(touches):
        expected.append(at if silent[at] else known.setdefault(touch, at))
    assert copies_of(spikes_of(rasters)).first.tolist() == expected


def test_a_few_spikes_may_be_equal_by_chance():
    few = np.zeros((60, 4), np.uint8)
    few[[3, 9, 20], [0, 1, 2]] = 1
    assert not len(copies_of(spikes_of([few, few])).trials)
    few[30, 3] = 1
    assert copies_of(spikes_of([few, few])).trials.tolist() == [1]


def test_regular_spikes_may_be_equal_by_chance():
    """However many: all afferents at their highest rate from the start on; with one odd interval they tell."""
    regular = np.zeros((600, 4), np.uint8)
    regular[::3] = 1
    assert not len(copies_of(spikes_of([regular, regular], ["a", "b"])).trials)
    regular[[300, 301], 2] = 0, 1
    assert copies_of(spikes_of([regular, regular])).trials.tolist() == [1]


def test_equal_spikes_of_other_recordings_are_copies_unless_the_afferents_are_saturated():
    regular = np.zeros((400, 4), np.uint8)
    regular[::3] = 1
    irregular = (np.random.default_rng(0).random((400, 4)) < 0.3).astype(np.uint8)
    for raster, copies in ((regular, []), (irregular, [1])):
        trains = replace(spikes_of([raster] * 2), trial_digests=("a" * 16, "b" * 16))
        assert copies_of(trains).trials.tolist() == copies
        assert copies_of(replace(trains, trial_digests=("a" * 16,) * 2)).trials.tolist() == [1]


def test_a_copy_at_another_rate_is_one_once_it_is_encoded():
    """Files of 2 kHz and of 1 kHz that are never in one: their spikes on one clock are equal."""
    how = conditioning.ConditioningSpec(resample_Hz=1000.0, baseline="start")
    fast, encoder = walk(0, 800, scale=9.0), load("sa1-ra1-lif").model_copy(update={"conditioning": how})
    at_2_kHz, at_1_kHz = recordings_of([fast, walk(1, 800, scale=9.0)]), recordings_of([fast[::2]])
    fast_trains = encode_recordings(replace(at_2_kHz, sampling_rate_Hz=2000.0), encoder)
    slow_trains = encode_recordings(at_1_kHz, encoder)
    trains = [*fast_trains.trials(), *(trial._replace(n_steps=400) for trial in slow_trains.trials())]
    together = SpikeTrains(
        [t.steps for t in trains], [t.units for t in trains], np.array([t.n_steps for t in trains]), 1000.0,
        fast_trains.afferents, pd.DataFrame({"label": ["a", "b", "a"]}), fast_trains.encoder,
        trial_digests=tuple(t.digest for t in trains),
    )  # fmt: skip
    assert copies_of(together).first.tolist() == [0, 1, 0]


@given(st.lists(st.integers(0, 3), min_size=1, max_size=10), st.lists(st.sampled_from("ab"), min_size=10, max_size=10))
def test_equal_examples_have_equal_values_and_labels(numbers, labels):
    X = np.stack([rasters_of(number, 1)[0] for number in numbers])
    named = np.array(labels[: len(numbers)])
    assert equal_examples(X).tolist() == [numbers.index(number) for number in numbers]
    pairs = [*zip(numbers, named, strict=True)]
    assert equal_examples(X, named).tolist() == [pairs.index(pair) for pair in pairs]


# --- splits -------------------------------------------------------------------------------------------


@examples(30)
@given(
    st.lists(st.integers(0, 11), min_size=6, max_size=20), st.integers(0, 99),
    st.sampled_from([{}, {"folds": 3}, {"order": "trial"}, {"group": "subject"}, {"test_where": {"speed": 2}}]),
)  # fmt: skip
def test_no_digest_is_on_two_sides(copied, seed, how):
    """For any structure of copies, equal or cut, of recordings and of their spikes."""
    touches = [*range(12), *copied]
    signals = [walk(touch, 120, 2)[2 * (at > 20) :] for at, touch in enumerate(touches)]
    classes = ["felt" if touch % 2 else "silk" for touch in touches]
    columns = {"subject": [str(touch // 2) for touch in touches], "speed": [1 + (touch > 7) for touch in touches]}
    recordings = recordings_of(signals, classes, **columns)
    trains = spikes_of(np.array([rasters_of(touch, 1)[0] for touch in touches]), classes)
    trains = replace(trains, conditions=recordings.conditions)
    for what in (recordings, trains):
        split = split_touches(what, (), SplitSpec.model_validate({"seed": seed, **how}))
        sides = [{touches[trial] for trial in side} for side in split]
        assert sum(map(len, sides)) == len(set.union(*sides)) == 12
        assert sorted(np.concatenate(split)) == list(range(len(touches)))


def test_an_encoder_is_fitted_on_each_touch_once(caplog):
    recordings = recordings_of([walk(seed % 10) for seed in range(20)])
    training = training_touches(recordings, (), SplitSpec())
    everything = split_touches(recordings, (), SplitSpec()).train
    assert len(training) == len(everything) / 2
    assert set(everything % 10) == set(training % 10)
    assert caplog.messages == [f"recordings: copies of training trials are left out of the fit: {len(training)}"]


@given(st.lists(st.integers(0, 9), max_size=30), st.integers(0, 99))
def test_equal_examples_are_held_out_together(copied, seed):
    numbers = np.array([*range(10), *copied])
    labels = numbers % 2
    first = np.array([numbers.tolist().index(number) for number in numbers])
    held = hold_out(labels, 0.2, seed, first)
    assert not set(numbers[held]) & set(np.delete(numbers, held))
    assert set(labels[held]) == set(np.delete(labels, held)) == {0, 1}


def test_patterns_that_repeat_are_no_copies():
    """Of two classes with one pattern each, some examples can still be held out."""
    labels = np.repeat([0, 1], 10)
    assert hold_out(labels, 0.2, 0, labels * 10).tolist() == hold_out(labels, 0.2, 0, np.arange(20)).tolist()
    with pytest.raises(InputError, match="3 examples of 2 classes are too few"):
        hold_out(np.array([0, 0, 1]), 0.2, 0, np.array([0, 0, 2]))


# --- words --------------------------------------------------------------------------------------------


def test_an_import_names_copies(caplog):
    files = ["a/1.csv", "a/2.csv", "a/3.csv", "a/4.csv"]
    recordings = recordings_of([walk(0), walk(1), walk(0), walk(1)[3:]], ["a"] * 4, file=files)
    doubtful.check(recordings, "in/")
    assert caplog.messages == [
        "in/: 1 of 4 trials is a copy of another one: a/3.csv of a/1.csv; a split keeps copies together and counts "
        "them once",
        "in/: 1 of 4 trials is a near copy of another one (with another rounding, rate, length, offset or order of "
        "taxels): a/4.csv of a/2.csv; a split keeps copies together and counts them once",
    ]


@pytest.mark.parametrize("kind", ["recordings", "spikes"])
def test_a_copy_with_another_class_is_refused(kind, caplog):
    signals = [walk(0), walk(1), walk(2), walk(0), walk(1)[3:]]
    recordings = recordings_of(signals, ["felt", "silk", "silk", "silk", "felt"])
    touches = recordings if kind == "recordings" else spikes_of([rasters_of(n, 1)[0] for n in (0, 1, 2, 0)],
                                                                ["felt", "silk", "silk", "silk"])  # fmt: skip
    refusal = (
        r"^in/: trial 3 of class 'silk' is a copy of trial 0 of class 'felt'; keep the one with the right class and "
        r"remove the other$"
    )
    with pytest.raises(InputError, match=refusal):
        doubtful.check(touches, "in/")
    doubtful.check(recordings.select([0, 1, 2, 4]), "in/")  # a near copy is no proof
    assert "trial 3 of trial 1 (class 'felt', not 'silk')" in caplog.text


def test_classes_that_hold_the_same_trials_are_named_and_imported(caplog):
    """Files that were made to try a format: no class is the right one."""
    doubtful.check(recordings_of([walk(0), walk(1), walk(1), walk(0)], ["felt", "felt", "silk", "silk"]), "in/")
    assert "in/: every class ('felt', 'silk') holds the same trials, so that nothing tells the classes" in caplog.text
    with pytest.raises(InputError, match="is a copy of"):
        doubtful.check(recordings_of([walk(0), walk(1), walk(1)], ["felt", "felt", "silk"]), "in/")


def test_a_near_copy_does_not_hide_a_copy_with_another_class():
    recordings = recordings_of([walk(0), walk(0)[3:], walk(0)[3:]], ["felt", "felt", "silk"])
    with pytest.raises(InputError, match="trial 2 of class 'silk' is a copy of trial 1 of class 'felt'"):
        doubtful.check(recordings, "in/")


@pytest.mark.parametrize(
    ("classes", "named"),
    [
        (("Wood", "wood ", "WOOD", "felt"), ["'Wood', 'wood ', 'WOOD'"]), (("felt 1", "felt1"), ["'felt 1', 'felt1'"]),
        (("felt", "silk", "silk-2"), []), (("a", "A", "b", "B"), ["'a', 'A'", "'b', 'B'"]),
    ],
)  # fmt: skip
def test_classes_that_differ_in_case_or_blanks_are_named(classes, named):
    found = list(doubtful.of_classes(classes))
    assert len(found) == len(named)
    assert all(names in line for names, line in zip(named, found, strict=True))


def test_nothing_is_said_of_trials_without_doubt(caplog):
    recordings = recordings_of([walk(seed) for seed in range(6)])
    doubtful.check(recordings, "in/")
    assert not caplog.messages
    assert doubtful.lines(recordings) == doubtful.lines(encode_recordings(recordings, load("sa1-ra1-lif"))) == []
    assert list(doubtful.of_copies(recordings.conditions, Copies(np.arange(6), np.arange(6)))) == []


def test_spike_trains_are_compared_once_as_long_as_they_last(monkeypatch):
    asked, of_spikes = [], finding._of_spikes
    monkeypatch.setattr(finding, "_of_spikes", lambda trains: asked.append(1) or of_spikes(trains))
    rasters = (np.random.default_rng(0).random((4, 60, 4)) < 0.3).astype(np.uint8)
    one, other = spikes_of(rasters), spikes_of(rasters[[0, 0, 1, 2]])
    found = [copies_of(trains).first.tolist() for trains in (one, other, one)]
    assert found == [[0, 1, 2, 3], [0, 0, 2, 3], [0, 1, 2, 3]]
    assert len(asked) == 2
    n_known = len(finding._known)
    del one, other
    assert len(finding._known) == n_known - 2
