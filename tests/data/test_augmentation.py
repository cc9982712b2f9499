"""Varied copies: what varies, what stays, and that they follow their trial."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neurotact import plugins
from neurotact.data import augmentation, hdf5
from neurotact.data.augmentation import CANDIDATES, AugmentationSpec, played, varied_copies
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import StoredCopies
from neurotact.data.windows import WindowSpec
from neurotact.encoders import specs
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.networks.training import tasks
from neurotact.spec import build

RATE_HZ = 200.0
CLOCK = {"conditioning.resample_Hz": 1000.0}


def touches(n_trials=6, n_samples=80, rest=0, offset=0.0):
    rng = np.random.default_rng(0)
    signals = offset + rng.normal(0, 0.05, (n_trials, n_samples, 2))
    signals[:, rest:] += rng.normal(0, 3, (n_trials, 1, 2)) * np.cos(np.arange(n_samples - rest) / 5)[:, None]
    return Recordings(signals, RATE_HZ, "mV", pd.DataFrame({"label": ["felt", "silk"] * (n_trials // 2)}))


def copies(recordings, **keys):
    return {each.kind: each for each in varied_copies(recordings, AugmentationSpec(**keys))}


@given(
    speed=st.floats(0.1, 10), n=st.integers(2, 60), first=st.floats(0, 100), seed=st.integers(0, 9)
)  # fmt: skip
def test_a_played_signal_stays_within_its_values_and_is_never_shorter(speed, n, first, seed):
    signal = np.random.default_rng(seed).normal(size=(n, 2))
    found = played(signal, speed, first)
    assert len(found) == max(n, round(n / speed))
    assert (found <= signal.max(axis=0) + 1e-12).all()
    assert (found >= signal.min(axis=0) - 1e-12).all()


@given(n=st.integers(2, 60), shift=st.integers(0, 20))
def test_at_its_own_speed_a_signal_is_itself(n, shift):
    signal = np.random.default_rng(n).normal(size=(n, 1))
    np.testing.assert_array_equal(played(signal, 1.0), signal)
    left = max(0, n - shift)
    np.testing.assert_allclose(played(signal, 1.0, float(shift))[:left], signal[n - left :], atol=1e-12)


@given(speed=st.floats(0.2, 5), frequency=st.floats(0.005, 0.02))
def test_a_tone_is_as_many_times_faster(speed, frequency):
    n = 400
    tone = np.sin(2 * np.pi * frequency * np.arange(n))[:, None]
    found = played(tone, speed)
    forward = np.arange(min(len(found), int((n - 1) / speed)))
    np.testing.assert_allclose(found[forward, 0], np.sin(2 * np.pi * frequency * speed * forward), atol=0.01)


def test_copies_vary_in_what_their_kind_says_and_share_their_factors():
    recordings = touches()
    found = copies(recordings, copies=2)
    assert list(found) == list(CANDIDATES[1:])
    for kind, each in found.items():
        assert each.of.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
        for signal, trial in zip(each.recordings.signals, each.of, strict=True):
            own = recordings.signals[trial]
            assert len(signal) >= len(own)
            if kind == "gain":
                level = own[:10].mean(axis=0)
                factor = np.linalg.norm(signal - level) / np.linalg.norm(own - level)
                assert 0.5 <= factor <= 2
                np.testing.assert_allclose(signal - level, factor * (own - level), atol=1e-4)
    both, gain = found["time+gain"].recordings.signals, found["gain"].recordings.signals
    for one, other in zip(both, gain, strict=True):  # scaled alike, then played at another speed
        assert one.max() <= other.max() + 1e-4
        assert one.min() >= other.min() - 1e-4


def test_kinds_differ_only_in_what_varies():
    """The speed is seen in the length; gain and start in the first sample."""
    kinds = ("time", "gain", "start", "time+gain", "time+start", "gain+start", "time+gain+start")
    found = {kind: copies(touches(), kind=kind, shift_ms=100.0)[kind].recordings.signals for kind in kinds}
    for number in range(len(found["time"])):
        first: dict[tuple[bool, bool], list[np.ndarray]] = {}
        for kind, signals in found.items():
            first.setdefault(("gain" in kind, "start" in kind), []).append(signals[number][0])
        for same in first.values():
            np.testing.assert_allclose(same, np.broadcast_to(same[0], np.shape(same)), atol=1e-5)
        assert len({len(signals[number]) for kind, signals in found.items() if "time" in kind}) == 1
        assert len({round(float(same[0][0]), 6) for same in first.values()}) == 4
    assert all(len(signal) == 80 for kind in ("gain", "start", "gain+start") for signal in found[kind])
    starts = [
        [signal[0] for signal in copies(touches(), kind=kind, gain_factor=1 + 1e-12)[kind].recordings.signals]
        for kind in ("start", "gain+start")
    ]
    np.testing.assert_allclose(*starts, atol=1e-5)


def test_another_seed_gives_other_copies():
    one, other = (copies(touches(), kind="gain", seed=seed)["gain"].recordings.signals for seed in (0, 1))
    assert all((a != b).any() for a, b in zip(one, other, strict=True))


def test_gain_is_about_the_rest_before_the_touch():
    recordings = touches(rest=20, offset=1820.0)
    for each, trial in zip(
        *(lambda found: (found.recordings.signals, found.of))(copies(recordings)["gain"]), strict=True
    ):
        assert abs(each[:15].mean() - recordings.signals[trial][:15].mean()) < 0.1


def test_blocks_do_not_change_copies(monkeypatch):
    recordings, spec = touches(), AugmentationSpec(kind="time+gain")
    (whole,) = varied_copies(recordings, spec)
    monkeypatch.setattr("neurotact.data.augmentation.BLOCK_VALUES", 1)
    parts = list(varied_copies(recordings, spec))
    assert len(parts) == len(recordings) * spec.copies
    assert np.concatenate([part.of for part in parts]).tolist() == whole.of.tolist()
    signals = [signal for part in parts for signal in part.recordings.signals]
    for one, other in zip(signals, whole.recordings.signals, strict=True):
        np.testing.assert_array_equal(one, other)


@given(order=st.permutations(range(6)), kept=st.integers(1, 6))
def test_a_trial_has_its_copies_at_any_index_and_beside_any_others(order, kept):
    recordings, chosen = touches(), list(order)[:kept]
    for kind in ("time+start", "gain+taxels"):
        every, found = (
            [*copies(some, kind=kind, copies=2)[kind].recordings.signals]
            for some in (recordings, recordings.select(chosen))
        )
        assert not np.array_equal(every[0], every[1])
        for place, trial in enumerate(chosen):
            for copy in range(2):
                one, other = found[2 * place + copy], every[2 * trial + copy]
                np.testing.assert_array_equal(one, other)


def skin(n_taxels, n_trials=4):
    rng = np.random.default_rng(1)
    signals = 100 + np.arange(n_taxels) + rng.normal(0, 2, (n_trials, 1, n_taxels)) * np.cos(np.arange(80) / 5)[:, None]
    return Recordings(signals, RATE_HZ, "mV", pd.DataFrame({"label": ["felt", "silk"] * (n_trials // 2)}))


@given(n_taxels=st.integers(2, 12), share=st.floats(0.05, 0.95), kind=st.sampled_from(["taxels", "time+gain+taxels"]))
def test_a_share_of_the_taxels_rests_and_the_others_are_those_of_the_kind_without_it(n_taxels, share, kind):
    recordings, how = skin(n_taxels), {"copies": 3, "taxel_share": share}
    without = kind.removesuffix("+taxels")
    others = recordings if kind == "taxels" else copies(recordings, kind=without, **how)[without].recordings
    found = copies(recordings, kind=kind, **how)[kind]
    drawn = set()
    for number, (signal, trial) in enumerate(zip(found.recordings.signals, found.of, strict=True)):
        still = np.ptp(signal, axis=0) == 0
        assert 1 <= still.sum() <= n_taxels - 1
        assert abs(still.sum() - share * n_taxels) <= 1
        own = others.signals[trial if kind == "taxels" else number]
        np.testing.assert_array_equal(signal[:, ~still], own[:, ~still].astype(np.float32))
        drawn.add((*still,))
    assert len(drawn) > 1 or n_taxels == 2 or share > 0.5


def test_copies_are_encoded_once_for_the_trainings_that_read_them_again(monkeypatch):
    """Of the last reads alone, so that many splits take no more memory."""
    encoder, made = specs.resolve("sa1-ra1-lif", CLOCK), []
    trains = encode_recordings(touches(), encoder, augmentation=AugmentationSpec())
    encode = plugins.load_function("tools", "encode_copies")
    monkeypatch.setattr(plugins, "load_function", lambda *_: lambda *given: made.append(1) or encode(*given))
    task = tasks.Task(window=WindowSpec(length_ms=200), augmentation="time")
    first, again, other = (tasks.sides_of(trains, task.model_copy(update={"augmentation": kind}))
                           for kind in ("time", "time", "gain"))  # fmt: skip
    assert len(made) == 2
    assert torch.equal(first.train.spikes, again.train.spikes)
    assert not torch.equal(first.train.spikes, other.train.spikes)
    variations = trains.variations
    assert variations is not None
    for place in range(2 * augmentation.MOST_MADE):
        [*variations.source.blocks(np.array([place]))]
    assert len(variations.source.made) == augmentation.MOST_MADE


def test_afferents_of_a_taxel_at_rest_are_silent():
    encoder = specs.resolve("sa1-ra1-lif", {**CLOCK, "conditioning.baseline": "start", "sa1.gain": 60, "ra1.gain": 600})
    recordings, spec = skin(4), AugmentationSpec(kind="taxels", copies=3, taxel_share=0.5)
    varied = encode_recordings(recordings, encoder, augmentation=spec).variations
    assert varied is not None
    for signal, units in zip(copies(recordings, **spec.model_dump())["taxels"].recordings.signals, varied.trains.units,
                             strict=True):  # fmt: skip
        fired = np.bincount(units, minlength=8).reshape(2, 4)  # SA-I and RA-I of each taxel
        still = np.ptp(signal, axis=0) == 0
        assert still.sum() == 2
        assert not fired[:, still].any()
        assert fired.any()


def test_a_sensor_with_one_taxel_has_none_to_leave_at_rest(tmp_path):
    alone = AugmentationSpec(kind="gain+taxels")
    with pytest.raises(InputError, match="'taxels' leaves some of the taxels at rest, and these recordings have only"):
        encode_recordings(skin(1), specs.resolve("sa1-ra1-lif", CLOCK), augmentation=alone)
    assert encode_recordings(skin(1), specs.resolve("sa1-ra1-lif", CLOCK)).variations is None


@pytest.mark.parametrize("kind", ["gain+time", "time+time", "speed", "taxels+start", ""])
def test_a_kind_is_written_in_one_way(kind):
    with pytest.raises(InputError, match="must be none, auto, or some of time, gain, start"):
        build(AugmentationSpec, {"kind": kind}, "augmentation")


def test_spikes_of_copies_are_those_of_their_signals_and_follow_their_trials(tmp_path):
    recordings, spec = touches(), AugmentationSpec(kind="time", copies=2)
    encoder = specs.resolve("sa1-ra1-lif", CLOCK)
    trains = encode_recordings(recordings, encoder, augmentation=spec)
    varied = trains.variations
    assert varied is not None
    alone = encode_recordings(copies(recordings, kind="time", copies=2)["time"].recordings, encoder)
    assert [steps.tolist() for steps in varied.trains.steps] == [steps.tolist() for steps in alone.steps]
    assert sum(map(len, alone.steps)) > 0

    hdf5.save_spikes(trains, tmp_path / "spikes.h5")
    read = hdf5.load_spikes(tmp_path / "spikes.h5")
    assert len(read) == len(trains) == 6
    assert read.variations is not None
    assert read.variations.of.tolist() == varied.of.tolist()
    assert set(read.variations.kind) == {"time"}

    some = read.select([4, 1])
    assert some.variations is not None
    assert some.variations.of.tolist() == [1, 1, 0, 0]
    assert [steps.tolist() for steps in some.variations.trains.steps] == [alone.steps[i].tolist() for i in (2, 3, 8, 9)]


def events(trains):
    return [(steps.tolist(), units.tolist()) for steps, units in zip(trains.steps, trains.units, strict=True)]


ENCODED = encode_recordings(
    touches(rest=20), specs.resolve("sa1-ra1-lif", {**CLOCK, "sa1.gain": 60}), augmentation=AugmentationSpec(copies=2)
)


@given(rows=st.lists(st.integers(0, 35), min_size=1, max_size=8))
def test_copies_are_the_same_whichever_are_read(rows):
    varied = ENCODED.variations
    assert varied is not None
    some = varied.only(np.array(rows))
    every = events(varied.trains)
    assert events(some.trains) == [every[row] for row in rows]
    assert some.of.tolist() == varied.of[rows].tolist()
    assert list(some.trains.conditions["label"]) == [ENCODED.conditions["label"][trial] for trial in some.of.tolist()]
    assert sum(len(steps) for steps, _ in every) > 0


def test_a_file_holds_recordings_and_no_spikes_of_copies_and_the_copies_are_the_same(tmp_path):
    import h5py

    path, again = tmp_path / "spikes.h5", tmp_path / "again.h5"
    hdf5.save_spikes(ENCODED.select([4, 1, 2]), path)
    with h5py.File(path) as file:
        assert len(file["spikes/lengths"]) == 3
    read = hdf5.load_spikes(path)
    assert read.variations is not None
    assert ENCODED.variations is not None
    wanted = [place for trial in (1, 2, 4) for place in (2 * trial, 2 * trial + 1)]
    every = events(ENCODED.variations.trains)
    assert events(read.variations.trains) == [every[12 * kind + place] for kind in range(3) for place in wanted]
    assert read.variations.of.tolist() == 3 * [1, 1, 2, 2, 0, 0]
    hdf5.save_spikes(read, again)
    copied = hdf5.load_spikes(again).variations
    assert copied is not None
    assert events(copied.trains) == events(read.variations.trains)


def test_a_file_of_an_earlier_version_has_the_spikes_of_its_copies(tmp_path):
    import h5py

    varied = ENCODED.variations
    assert varied is not None
    stored = varied._replace(source=StoredCopies(varied.trains), places=np.arange(len(varied.of)))
    hdf5.save_spikes(replace(ENCODED, variations=stored), tmp_path / "spikes.h5")
    with h5py.File(tmp_path / "spikes.h5") as file:
        assert len(file["spikes/lengths"]) == 6 + 36
        assert "copied" not in file
    read = hdf5.load_spikes(tmp_path / "spikes.h5")
    assert events(read) == events(ENCODED)
    assert read.variations is not None
    assert events(read.variations.trains) == events(varied.trains)
    assert (read.variations.kind == varied.kind).all()


def test_of_copies_only_the_spikes_in_windows_are_kept():
    window = WindowSpec(length_ms=100, start_ms=100, per_trial=1)
    whole, cut = ENCODED.with_variations(), ENCODED.with_variations(window)
    windows = whole.cut(window)
    np.testing.assert_array_equal(cut.raster(windows), whole.raster(windows))
    assert all((steps < 200).all() for steps in cut.steps[6:])
    assert any((steps >= 200).any() for steps in whole.steps[6:])


@pytest.mark.parametrize(("name", "value", "message"), [
    ("variation_of", 6, "must name a trial and a kind"), ("variation_place", 36, "must be from 0 to 35"),
])  # fmt: skip
def test_a_file_whose_copies_are_of_no_trial_is_refused(tmp_path, name, value, message):
    import h5py

    path = tmp_path / "spikes.h5"
    hdf5.save_spikes(ENCODED, path)
    with h5py.File(path, "a") as file:
        file[name][0] = value
    with pytest.raises(InputError, match=message):
        hdf5.load_spikes(path)
