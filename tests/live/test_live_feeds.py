"""Where a session's samples come from: recordings with their labels, a finger that is moved, a device."""

import io
import os

import numpy as np
import pandas as pd
import pytest
from live_pages import session_of
from made_chains import make_chain, make_signal
from neurotact_parts.exporters.live import feeds, messages
from neurotact_parts.exporters.live.feeds import ByHand, Device, Replay
from neurotact_parts.exporters.live.finger import Control, Finger
from neurotact_parts.streams.sources import Faults

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.dataset import Simulator, simulator
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError


@pytest.fixture
def skin(tmp_path):
    signals = [make_signal(60, seed=1), make_signal(90, seed=2)]
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": ["a", "b"]})), tmp_path / "skin.h5")
    return tmp_path / "skin.h5", signals


def test_recordings_are_replayed_with_their_labels(skin):
    path, signals = skin
    feed, found = Replay(str(path), 20.0, loops=False), {"a": [], "b": []}
    for piece in feed.pieces(Faults()):
        if piece.samples is not None:
            found[feed.label].append(piece.samples)
    assert [np.array_equal(np.concatenate(each), signal) for each, signal in zip(found.values(), signals, strict=True)]
    assert feed.note == "trial 2 of 2"
    assert (feed.sampling_rate_Hz, feed.unit, feed.taxels) == (1000.0, "mV", ("taxel1", "taxel2"))


def test_recordings_that_loop_begin_again(skin):
    feed, labels = Replay(str(skin[0]), 20.0, loops=True), []
    for piece in feed.pieces(Faults()):
        labels += [feed.label] if piece.end else []
        if len(labels) == 5:
            break
    assert labels == ["a", "b", "a", "b", "a"]


def test_shuffled_recordings_have_each_trial_once_in_another_order(tmp_path):
    labels = [str(number) for number in range(12)]
    signals = [make_signal(20, seed=seed) for seed in range(12)]
    path = tmp_path / "many.h5"
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": labels})), path)

    def orders() -> list[list[str | None]]:
        feed, found = Replay(str(path), 20.0, loops=True, shuffled=True), []
        for piece in feed.pieces(Faults()):
            found += [feed.label] if piece.end else []
            if len(found) == 24:
                return [found[:12], found[12:]]
        return []

    first, second = orders()
    assert sorted(first) == sorted(second) == sorted(labels)
    assert first not in (labels, second)
    assert orders() == [first, second]


SPEC = {"duration_s": 0.1}


def test_a_finger_touches_what_its_controls_say(monkeypatch):
    monkeypatch.setattr(feeds, "LIFTED_S", 0.0)
    feed = ByHand("gratings", simulator("gratings"), SPEC, 20.0)
    assert [control.name for control in feed.controls] == ["grating", "force_N", "speed_mm_per_s"]
    touches, labels = [[]], []
    for piece in feed.pieces(Faults()):
        if piece.samples is not None:
            touches[-1].append(piece.samples)
        if piece.end:
            labels.append(feed.label)
            touches.append([])
            if len(labels) == 2:
                break
    expected = [simulator("gratings").by_hand.touch(feed._spec, feed.values, number) for number in range(2)]
    for touch, recorded in zip(touches, expected, strict=False):
        assert np.array_equal(np.concatenate(touch), recorded.signals[0])
    assert labels == ["P4.0", "P4.0"]
    assert not np.array_equal(expected[0].signals, expected[1].signals)


def test_a_finger_that_is_moved_begins_another_touch(monkeypatch):
    monkeypatch.setattr(feeds, "LIFTED_S", 0.0)
    feed = ByHand("gratings", simulator("gratings"), {"duration_s": 1.0}, 20.0)
    n_samples = 0
    for piece in feed.pieces(Faults()):
        if piece.end:
            break
        n_samples += 0 if piece.samples is None else len(piece.samples)
        if n_samples > 100:
            feed.move({"grating": "P0.5", "force_N": 3})
    assert 100 < n_samples < 200
    assert feed.values == {"grating": "P0.5", "force_N": 3.0, "speed_mm_per_s": 8.6}


def test_slides_by_hand_are_like_those_of_the_study_and_none_of_them():
    gratings = simulator("gratings")
    spec = gratings.build({"trials": 3, "duration_s": 0.3, "forces_N": [12], "speeds_mm_per_s": [8.6]}, "test")
    study = gratings.simulate(spec, None)
    by_hand = gratings.by_hand.touch(spec, gratings.by_hand.checked(spec, {}), 0)
    of_class = study.signals[np.flatnonzero(study.conditions["label"] == "P4.0")]
    assert not any(np.array_equal(signal, by_hand.signals[0]) for signal in of_class)
    alike = [np.corrcoef(signal.ravel(), by_hand.signals[0].ravel())[0, 1] for signal in of_class]
    assert max(alike) > 0.5


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"grating": "P9"}, "grating: 'P9' is unknown"),
        ({"force_N": 1000.0}, "force_N: must be from 1 to 24; got 1000.0"),
        ({"force_N": "hard"}, "force_N: must be from 1 to 24"),
        ({"force_N": float("nan")}, "force_N: must be from 1 to 24"),
        ({"force_N": True}, "force_N: must be from 1 to 24"),
        ({"forc_N": 3.0}, "forc_N: is not a control of this finger; did you mean 'force_N'"),
    ],
)
def test_a_control_that_cannot_be_set_is_refused_and_nothing_moves(values, message):
    feed = ByHand("gratings", simulator("gratings"), SPEC, 1.0)
    before = dict(feed.values)
    with pytest.raises(InputError, match=message):
        feed.move(values)
    assert feed.values == before


def test_a_simulator_without_a_finger_is_refused():
    with pytest.raises(InputError, match="has no finger to control"):
        ByHand("stiffness", simulator("stiffness"), {}, 1.0)


def test_the_finger_of_another_package_serves(monkeypatch):
    monkeypatch.setattr(feeds, "LIFTED_S", 0.0)
    controls = (Control("depth_mm", "Depth", 1.0, low=0.5, high=2.0, step=0.1),)

    def touch(spec, values, number):
        signal = np.full((40, 2), values["depth_mm"], np.float32)
        return Recordings(signal[None], 1000.0, "mV", pd.DataFrame({"label": ["1"]}))

    theirs = Simulator(
        "x", simulator("gratings").model, lambda spec, progress: None, Finger(lambda spec: controls, touch)
    )
    feed = ByHand("theirs", theirs, {}, 20.0)
    session = session_of(make_chain({}), feed)
    session.do(messages.Move(kind="move", values={"depth_mm": 2.0}))
    for piece in feed.pieces(Faults()):
        session.take(piece)
        if piece.end:
            break
    assert session.scores.confusion[1].sum() == 1


def test_a_device_is_read_and_the_page_says_what_it_touches(tmp_path):
    signal = make_signal(120)
    text = io.StringIO()
    np.savetxt(text, signal, delimiter=",")
    path = tmp_path / "pipe"
    os.mkfifo(path)
    descriptor = os.open(path, os.O_RDWR)
    feed = Device(str(path), nt.Samples(), ("left", "right"), 1000.0, "mV")
    session = session_of(make_chain({}), feed)
    session.do(messages.Label(kind="label", label="2"))
    pieces = feed.pieces(session.faults)
    assert next(pieces).samples is None
    os.write(descriptor, text.getvalue().encode())
    found: list = []
    while len(found) < 3:
        found += session.take(next(pieces))
    os.close(descriptor)
    assert [scored.truth for scored in found] == [2, 2, 2]
    with pytest.raises(InputError, match="is not a class of the network"):
        session.do(messages.Label(kind="label", label="silk"))
    with pytest.raises(InputError, match="sets its own rate"):
        session.do(messages.Speed(kind="speed", speed=2.0))


def test_a_device_whose_clock_starts_again_is_followed(tmp_path):
    signal = make_signal(300)
    stamps = [*range(150), *range(150)]
    rows = (f"{t},{a!r},{b!r}\n" for t, (a, b) in zip(stamps, signal.astype(float).tolist(), strict=True))
    (tmp_path / "rows.csv").write_text("".join(rows))
    session = session_of(
        make_chain({}),
        Device(str(tmp_path / "rows.csv"), nt.Samples(time_column="ms"), ("left", "right"), 1000.0, "mV"),
    )
    found = [scored for piece in session.feed.pieces(session.faults) for scored in session.take(piece)]
    assert len(found) == 2 * (150 // 40)
    assert session.stream.tally.samples == 300
    assert "gaps 1" in session.state()["trouble"]
    assert "clock restarts 1" in session.state()["trouble"]


def test_a_touch_that_takes_too_much_memory_is_refused():
    with pytest.raises(InputError, match="more than the limit"):
        ByHand("gratings", simulator("gratings"), {"duration_s": 1e9}, 1.0)
