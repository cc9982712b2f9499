"""A session without a server: changes hold from one sample to the next, and windows are counted where they belong."""

import json
import tomllib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from costs import sops_table
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from live_pages import Given, cut, session_of
from made_chains import make_chain, make_signal, offline
from neurotact_parts.exporters.live import messages, scores
from neurotact_parts.exporters.live.frames import EVENT, Audience, FrameBuilder, Mailbox
from neurotact_parts.exporters.live.scores import cost_nJ, summary
from neurotact_parts.streams.sources import Arrived

from neurotact.encoders import afferents, specs
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.metrics.flops import NotCounted
from neurotact.metrics.prices import MEMORY_45NM
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.use.ledger import decision_ledger
from neurotact.spec import override


@pytest.mark.parametrize("least", [0.0, 2.5])
def test_a_change_of_patience_keeps_the_least_lead_and_the_page_has_a_column_for_it(least):
    chain = make_chain({}, patience=8)
    chain = chain._replace(rule=replace(chain.rule, least_lead=least))
    session = session_of(chain, Given([make_signal(60)]))
    assert session.hello().get("refuses", False) == (least > 0)
    assert session.scores.confusion.shape == (3, 5 if least else 4)
    session.do(messages.Change(kind="change", values={"patience": 5}))
    assert session.stream.chain.rule == ExitRule(5, from_first_spike=True, least_lead=least)


def rows_of(found) -> list[tuple]:
    ordered = sorted((scored.decision for scored in found), key=lambda d: d.window)
    return [(d.start_step, d.index, d.steps, d.input_spikes, d.hidden_spikes) for d in ordered]


def offline_with_a_change(chain, other, signal, cut_at) -> list[tuple]:
    """Spikes of `encode` with one encoder up to a sample and, with its state, with the other from there on."""
    clock_Hz = chain.clock_Hz
    first, state = afferents.encode(signal[None, :cut_at], clock_Hz, chain.encoder)
    rest, _ = afferents.encode(signal[None, cut_at:], clock_Hz, other, state)
    raster = np.concatenate([first[0], rest[0]])
    starts = chain.windows.starts(raster)
    windows = np.stack([raster[start : start + chain.windows.length] for start in starts.tolist()])
    found = chain.network.infer(torch.from_numpy(windows), chain.rule)
    columns = (found.labels, found.steps, found.input_spikes, found.hidden_spikes)
    return list(zip(starts.tolist(), *(part.tolist() for part in columns), strict=True))


@given(
    cut_at=st.integers(1, 350), seed=st.integers(0, 20), hop=st.sampled_from([None, 13]),
    values=st.fixed_dictionaries({}, optional={
        "sa1.t_ref_ms": st.integers(0, 20), "ra1.t_ref_ms": st.integers(0, 20),
        "sa1.gain": st.floats(0.5, 50.0), "ra1.gain": st.floats(0.5, 200.0),
    }).filter(bool),
)  # fmt: skip
@examples(12)
def test_a_change_is_that_of_an_encoder_that_changed_at_this_sample(cut_at, seed, hop, values):
    windows = {"length_ms": 40} if hop is None else {"length_ms": 40, "hop_ms": hop}
    chain, signal = make_chain({}, patience=8, windows=windows, seed=seed), make_signal(360, seed=seed)
    session = session_of(chain, Given([signal]))
    found = session.take(Arrived(signal[:cut_at]))
    session.do(messages.Change(kind="change", values=values))
    found += session.take(Arrived(signal[cut_at:]))
    table = override(chain.encoder.model_dump(mode="json"), values)
    other = afferents.AfferentSpec.model_validate(table)
    expected = offline_with_a_change(chain, other, signal, cut_at)
    assert [row for row in rows_of(found) if row[0] + 40 <= len(signal)] == expected


@given(cut_at=st.integers(1, 300), patience=st.sampled_from([None, 1, 3, 20]), seed=st.integers(0, 10))
@examples(8)
def test_another_patience_holds_from_this_sample_on(cut_at, patience, seed):
    chain, signal = make_chain({}, patience=6, seed=seed), make_signal(320, seed=seed)
    session = session_of(chain, Given([signal]))
    before = rows_of(session.take(Arrived(signal[:cut_at])))
    session.do(messages.Change(kind="change", values={"patience": patience}))
    after = rows_of(session.take(Arrived(signal[cut_at:])))
    _, old = offline(chain, signal)
    _, new = offline(chain._replace(rule=ExitRule(patience, from_first_spike=True)), signal)
    assert before == [row for row in old if row[0] + row[2] <= cut_at]
    assert [row for row in after if row[0] >= cut_at] == [row for row in new if row[0] >= cut_at]


def test_a_page_is_told_the_operations_counted_by_hand():
    """Six hidden neurons that hear each other, and three classes."""
    chain, signal = make_chain({}, patience=6), make_signal(400)
    box, session = Mailbox(lambda: None), session_of(chain, Given([signal]))
    box.is_greeted = True
    session.audience.join(box)
    session.take(Arrived(signal))
    (mail,) = box.take()
    rows = json.loads(mail)["rows"]
    expected = [6 * inputs + (6 + 3) * hidden for _, _, _, inputs, hidden in offline(chain, signal)[1]]
    assert [row[8] for row in rows] == expected
    assert session._counted()["totals"]["sops"] == sum(expected)
    assert [6 * row[6] + 9 * row[7] for row in rows] == expected
    assert any(row[6] != row[7] for row in rows)


def test_a_window_counts_for_settings_and_classes_that_held_all_through_it():
    chain, signal = make_chain({}), make_signal(400)
    feed = Given([signal])
    session = session_of(chain, feed)
    feed.label = "0"
    found = session.take(Arrived(signal[:100]))  # windows 0, 1; window 2 is under way
    session.do(messages.Change(kind="change", values={"sa1.t_ref_ms": 4}))
    feed.label = "1"
    found += session.take(Arrived(signal[100:220]))
    feed.label = "no class of this network"
    found += session.take(Arrived(signal[220:400]))
    assert [scored.truth for scored in found] == [0, 0, None, 1, 1, *[None] * 5]
    assert [scored.version for scored in found] == [0, 0, None, *[1] * 7]
    compared = session.scores.comparison()
    assert compared["changes"] == {"sa1.t_ref_ms": [2.0, 4.0]}
    assert (compared["before"]["windows"], compared["after"]["windows"]) == (2, 7)
    confusion = session.scores.confusion
    assert confusion.sum() == 4
    assert confusion[0].sum() == confusion[1].sum() == 2
    assert session.scores.sums["right"] == np.trace(confusion)


def test_windows_in_which_nothing_is_heard_are_nothing_in_the_list_and_in_the_confusion():
    chain, signal = make_chain({}), make_signal(120)
    still = np.zeros_like(signal)
    feed = Given([still])
    session = session_of(chain, feed)
    feed.label = "0"
    found = session.take(Arrived(still))
    assert found
    assert not any(scored.decision.heard or scored.is_right for scored in found)
    (one,) = session.state()["sides"]
    assert one["confusion"] == [[0, 0, 0, len(found)], [0] * 4, [0] * 4]
    assert (one["right"], session.scores.sums["right"]) == (0, 0)


SIDES = ["training", "test", "unseen", "validation", "unknown"]


def test_windows_of_each_side_are_counted_apart():
    """A trial's windows count on the side that the trial was on in training, even if the class stays the same."""
    chain, signal = make_chain({}), make_signal(120)
    feed = Given([signal])
    session = session_of(chain, feed, sides=SIDES)
    found = []
    for trial in range(5):
        feed.label = "01"[trial == 4]
        found.append([*session.take(Arrived(signal[:80], trial=trial)), *session.take(Arrived())])
        found[-1] += session.take(Arrived(signal[80:], end=True, trial=trial))
    assert [{scored.side for scored in windows} for windows in found] == [{side} for side in SIDES]
    state = session.state()
    assert [one["side"] for one in state["sides"]] == ["unseen", "test", "validation", "training", "unknown"]
    for one in state["sides"]:
        windows = found[SIDES.index(one["side"])]
        right = sum(scored.decision.index == scored.truth for scored in windows)
        assert (one["labelled"], one["right"]) == (len(windows), right)
        assert (np.sum(one["confusion"]), np.trace(one["confusion"])) == (len(windows), right)
    assert np.sum([one["confusion"] for one in state["sides"]], axis=0).tolist() == state["confusion"]
    assert [row[-1] for row in (scored.row() for windows in found for scored in windows)] == [
        scored.side for windows in found for scored in windows
    ]


def test_accuracy_before_and_after_a_change_is_that_of_touches_not_seen_in_training():
    chain, signal = make_chain({}), make_signal(200)
    feed = Given([signal])
    session = session_of(chain, feed, sides=SIDES)
    scored = []
    for trial, label in enumerate("01010"):
        feed.label = label
        scored += session.take(Arrived(signal, end=True, trial=trial))
    found = summary(scored)
    shares = {True: [], False: []}
    for one in scored:
        shares[one.side in ("training", "validation", "unknown")].append(one.truth == one.decision.index)
    assert len(shares[True]) + len(shares[False]) == len(scored)
    assert (found["accuracy"], found["accuracy_seen"]) == (np.mean(shares[False]), np.mean(shares[True]))
    assert summary([one for one in scored if one.side == "training"])["accuracy"] is None
    session.do(messages.Do(kind="clear"))
    assert session.state()["sides"] == []


def test_without_known_sides_every_touch_is_unseen():
    session = session_of(make_chain({}), Given([make_signal(80)]))
    session.feed.label = "0"
    session.take(Arrived(make_signal(80), trial=3))
    assert [one["side"] for one in session.state()["sides"]] == ["unseen"]


def test_only_the_last_windows_are_compared():
    chain = make_chain({})
    session = session_of(chain)
    found = session.take(Arrived(make_signal(2000)))
    session.do(messages.Compare(kind="compare", windows=5))
    session.do(messages.Change(kind="change", values={"patience": 5}))
    assert session.scores.comparison()["before"] == summary(found[-5:])
    assert session.scores.comparison()["after"] is None


def test_changes_in_quick_succession_are_one(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("neurotact_parts.exporters.live.session.time.monotonic", lambda: now[0])
    session = session_of(make_chain({}))
    first = session.take(Arrived(make_signal(200)))
    for wait_s, value in ((0.0, 3), (1.0, 4), (1.5, 7)):
        now[0] += wait_s
        session.do(messages.Change(kind="change", values={"sa1.t_ref_ms": value}))
        session.take(Arrived(make_signal(90)))
    compared = session.scores.comparison()
    assert compared["changes"] == {"sa1.t_ref_ms": [2.0, 7.0]}
    assert compared["before"] == summary(first)
    now[0] += 5.0
    session.do(messages.Change(kind="change", values={"ra1.gain": 31.0}))
    assert session.scores.comparison()["changes"] == {"ra1.gain": [30.0, 31.0]}


def test_nothing_changes_where_the_values_are_what_they_are():
    session = session_of(make_chain({}, patience=5))
    found = session.take(Arrived(make_signal(100)))
    session.do(messages.Change(kind="change", values=session._settings()))
    assert session.scores.comparison()["changes"] == {}
    assert session.scores.comparison()["after"] == summary(found)


def test_the_energy_of_a_decision_is_that_of_the_cost_ledger():
    chain = make_chain({"ema_cutoff_Hz": 30.0}, patience=5)
    (scored,) = session_of(chain).take(Arrived(make_signal(40)))
    from neurotact.metrics import synops

    decision, network = scored.decision, chain.network
    table = sops_table(
        labels=["a"], predicted=["a"], steps=np.array([decision.steps]), input_spikes=np.array([decision.input_spikes]),
        hidden_spikes=np.array([decision.hidden_spikes]), n_hidden=network.spec.hidden, n_readout=network.n_classes,
        recurrent=network.spec.recurrent,
    )  # fmt: skip
    ledger = decision_ledger(
        network.spec, network.n_inputs, network.n_classes, chain.clock_Hz, synops.summary(table),
        encoder=chain.encoder.model_dump(mode="json"), prices=MEMORY_45NM,
    )  # fmt: skip
    assert cost_nJ(chain, decision) == scored.nJ == pytest.approx(ledger["energy_estimate_nJ"].iloc[-1], rel=1e-12)


def test_an_energy_that_is_not_counted_reaches_the_page_as_null(monkeypatch):
    monkeypatch.setattr(scores, "encoding_cost", lambda *_, **__: NotCounted())
    session = session_of(make_chain({}, patience=5))
    found = session.take(Arrived(make_signal(40)))
    sent = found[0].row()
    shown = sent[9], summary(found)["nJ"], session._counted()["totals"]["nJ"]
    assert shown == (None, None, None)
    assert json.dumps(sent, allow_nan=False)


def test_a_saved_encoder_is_the_one_that_runs(tmp_path):
    chain = make_chain({"baseline": "start"})
    session = session_of(chain, save_to=tmp_path)
    session.do(messages.Change(kind="change", values={"sa1.t_ref_ms": 5, "ra1.gain": 17.25, "patience": 9}))
    session.do(messages.Save(kind="save", name="by-hand"))
    path = tmp_path / "by-hand.toml"
    assert specs.load(path) == session.stream.chain.encoder
    assert tomllib.loads(path.read_text())["sa1"]["t_ref_ms"] == 5
    assert "patience of the exit: 9 steps (9 ms)" in path.read_text()
    (tmp_path / "link.toml").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="already exists"):
        session.do(messages.Save(kind="save", name="link"))


def test_a_refractory_period_is_taken_in_whole_steps():
    session = session_of(make_chain({}))
    session.do(messages.Change(kind="change", values={"sa1.t_ref_ms": 3.4}))
    assert session._settings()["sa1.t_ref_ms"] == 3.0


def test_other_taxels_than_those_of_the_chain_are_refused():
    with pytest.raises(InputError, match="has 3 taxels but the chain has 2"):
        session_of(make_chain({}), Given([make_signal(10, 3)]))


def test_populations_are_those_that_the_names_say():
    session = session_of(make_chain({}))
    session.afferents = ("slow left", "slow right", "fast left", "fast right")
    shown = session.hello()["populations"]
    assert [(each["name"], each["key"], each["afferents"]) for each in shown] == [
        ("slow", "sa1", [0, 1]), ("fast", "ra1", [2, 3]),
    ]  # fmt: skip


# --- frames -------------------------------------------------------------------------------------------


def read_frame(frame: bytes, n_taxels: int) -> tuple[dict, np.ndarray, np.ndarray, np.ndarray]:
    length = int.from_bytes(frame[:4], "little")
    header = json.loads(frame[4 : 4 + length])
    at = 4 + length + -length % 4
    size = header["columns"] * n_taxels * 2
    columns = np.frombuffer(frame, "<f4", size, at).reshape(-1, n_taxels, 2)
    at += 4 * size
    sent = np.frombuffer(frame, EVENT, header["afferents"], at)
    hidden = np.frombuffer(frame, EVENT, header["hidden"], at + 8 * header["afferents"])
    assert at + 8 * (len(sent) + len(hidden)) == len(frame)
    return header, columns, sent, hidden


@given(sizes=st.lists(st.integers(1, 60), min_size=3, max_size=8), rate_Hz=st.sampled_from([1000.0, 2000.0]))
@examples(8)
def test_frames_hold_every_spike_and_the_reach_of_every_sample(sizes, rate_Hz):
    chain = make_chain({}, rate_Hz=rate_Hz, windows={"length_ms": 120})
    sizes = [*sizes, 10]
    signal = make_signal(sum(sizes))
    session = session_of(chain, Given([signal], rate_Hz=rate_Hz))
    at, columns, spikes, hidden = 0, [], [], []
    bucket = session._frames.bucket
    for size in sizes:
        session.take(Arrived(signal[at : at + size]))
        header, *arrays = read_frame(session._frames.frame({}), 2)
        columns.append(arrays[0])
        for found, events in ((spikes, arrays[1]), (hidden, arrays[2])):
            steps = np.rint((header["t0_s"] + events["after_s"].astype(float)) * rate_Hz).astype(int)
            found += zip(steps.tolist(), events["neuron"].tolist(), strict=True)
        at += size
    whole = len(signal) // bucket
    parts = signal[: whole * bucket].reshape(whole, bucket, 2)
    expected = np.stack([parts.min(axis=1), parts.max(axis=1)], axis=2)
    assert np.array_equal(np.concatenate(columns), expected)
    raster, _ = offline(chain, signal)
    assert spikes == [tuple(each) for each in np.argwhere(raster).tolist()]
    assert len(hidden) == session._hidden


def test_what_is_too_much_to_draw_is_counted_and_the_counts_are_right(monkeypatch):
    monkeypatch.setattr("neurotact_parts.exporters.live.frames.MOST_EVENTS", 5)
    monkeypatch.setattr("neurotact_parts.exporters.live.frames.MOST_BUCKETS", 3)
    chain, signal = make_chain({}), make_signal(400)
    session = session_of(chain, Given([signal]))
    for block in cut(signal, 20):
        session.take(Arrived(block))
    header, columns, sent, hidden = read_frame(session._frames.frame({}), 2)
    assert len(columns) <= 3
    assert len(sent) + len(hidden) <= 5
    assert header["thinned"] > 0
    assert session._afferent_spikes.sum() == offline(chain, signal)[0].sum()


def test_missing_samples_leave_a_gap_in_what_is_drawn():
    builder = FrameBuilder(1000.0, 1)
    builder.samples(np.zeros((8, 1), np.float32), 0)
    builder.samples(np.ones((9, 1), np.float32), 20)
    header, columns, *_ = read_frame(builder.frame({}), 1)
    assert header["begins_s"] == [[0.0, 2], [0.02, 2]]
    assert columns[:, 0, 0].tolist() == [0, 0, 1, 1]


def test_a_mailbox_rings_once_and_the_newest_wins():
    rings = []
    box = Mailbox(lambda: rings.append(1))
    for n in range(30):
        box.frame(bytes([n]))
        box.state(str(n))
        box.decisions([[n]])
    assert len(rings) == 1
    mail = box.take()
    assert mail[1] == "29"
    assert json.loads(mail[0])["rows"] == [[n] for n in range(30)]
    assert mail[2:] == [bytes([n]) for n in range(18, 30)]
    assert box.dropped == 18
    assert box.take() == []
    box.note("hello")
    assert len(rings) == 2


def test_a_mailbox_is_bounded():
    box = Mailbox(lambda: None)
    for n in range(5000):
        box.decisions([[n]])
        box.note(str(n))
    *notes, decisions = box.take()
    assert len(notes) == 16
    assert [rows[0] for rows in json.loads(decisions)["rows"]] == list(range(3000, 5000))


def test_an_audience_comes_and_goes():
    audience, box = Audience(), Mailbox(lambda: None)
    audience.join(box)
    assert audience.each() == [box]
    audience.leave(box)
    assert len(audience) == 0


def test_spikes_are_those_of_encode(tmp_path):
    """The counters of a session count what `encode` makes of the same recordings."""
    import pandas as pd

    from neurotact.data.recordings import Recordings

    chain, signal = make_chain({"baseline": "start"}), make_signal(300)
    session = session_of(chain, Given([signal]))
    session.take(Arrived(signal))
    trains = encode_recordings(Recordings([signal], 1000.0, "mV", pd.DataFrame({"label": ["a"]})), chain.encoder)
    assert session._afferent_spikes.tolist() == np.bincount(trains.units[0], minlength=4).tolist()


def test_of_a_slower_network_the_race_shows_how_long_the_leader_has_led_on_the_clock_of_its_samples():
    signal = make_signal(400)
    session = session_of(make_chain({}, step_ms=5.0), Given([signal]))
    led = []  # the class that leads a window, and for how long
    for row in signal:
        session.take(Arrived(row[None]))
        if race := session._race():
            led.append((race["window"], race["leader"], race["standing"]))
    longer = {now[2] - before[2] for before, now in pairwise(led) if before[:2] == now[:2] and now[2] > before[2] > 0}
    assert longer == {5}
