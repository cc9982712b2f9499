"""What a detector of events learns: labels at the ends of windows, parts of long recordings, and state that decays."""

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.streams.long_recordings import (
    LEFT,
    PART_S,
    RECORDING,
    in_parts,
    left_after,
    network_for,
    parts_for,
    taus_ms_of,
    window_for,
)

import neurotact as nt
from neurotact.data import marks
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.networks.definition.learned import LearnSpec
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import events, tasks

RATE_Hz = 100.0


def trains_of(lengths, table=(), n_afferents=2, seed=0, **more) -> SpikeTrains:
    rng = np.random.default_rng(seed)
    steps = [np.sort(rng.choice(n, n // 3, replace=False)) for n in lengths]
    return SpikeTrains(
        steps, [rng.integers(0, n_afferents, len(row)).astype(np.uint16) for row in steps], np.array(lengths), RATE_Hz,
        tuple(f"SA-I {i}" for i in range(n_afferents)), pd.DataFrame({"label": ["session"] * len(lengths)}), {},
        marks=pd.DataFrame([*table], columns=marks.COLUMNS), **more,
    )  # fmt: skip


@st.composite
def long_trains(draw):
    lengths = draw(st.lists(st.integers(60, 400), min_size=1, max_size=3))
    rows = []
    for trial, length in enumerate(lengths):
        edges = sorted(draw(st.sets(st.integers(0, length), max_size=8)))
        spans = [*zip(edges[::2], edges[1::2], strict=False)]
        rows += [(trial, a / RATE_Hz, b / RATE_Hz, draw(st.sampled_from(["contact", "slip"]))) for a, b in spans]
    digests = tuple(f"d{trial}" for trial in range(len(lengths)))
    return trains_of(lengths, rows, trial_digests=digests, trial_touches=digests)


@given(long_trains(), st.integers(2, 6))
@examples(40)
def test_parts_hold_every_spike_and_every_mark_once_and_no_onset_is_lost(trains, n):
    parts = in_parts(trains, n)
    of, begin_s = (
        parts.conditions[RECORDING].to_numpy(),
        parts.conditions[PART_S].to_numpy(),
    )
    first = np.rint(begin_s * RATE_Hz).astype(int)
    for trial in range(len(trains)):
        mine = np.flatnonzero(of == trial).tolist()
        assert 1 <= len(mine) <= n
        assert (first[mine] == np.cumsum([0, *parts.trial_steps[mine]])[:-1]).all()
        assert parts.trial_steps[mine].sum() == trains.trial_steps[trial]
        assert np.concatenate([parts.steps[i] + first[i] for i in mine]).tolist() == trains.steps[trial].tolist()
        assert np.concatenate([parts.units[i] for i in mine]).tolist() == trains.units[trial].tolist()
    table, known = parts.marks, trains.marks
    assert table is not None
    assert known is not None
    shift = begin_s[table["trial"]]
    back = np.column_stack([of[table["trial"]], table["start_s"] + shift, table["stop_s"] + shift])
    assert np.allclose(back, known[marks.COLUMNS[:3]])
    assert table["label"].tolist() == known["label"].tolist()
    assert len({*parts.trial_digests}) == len({*parts.trial_touches}) == len(parts)


def test_one_part_is_the_recording_itself():
    trains = trains_of([100])
    assert events.in_parts(trains, 1) is trains


def test_few_recordings_are_split_by_time_and_the_windows_at_cuts_are_counted(caplog):
    table = [(0, 2.0, 3.1, "slip"), (0, 5.0, 5.5, "slip"), (1, 1.0, 4.0, "slip")]
    trains, window = trains_of([1000, 600], table), WindowSpec(length_ms=300, hop_ms=100)
    assert parts_for(trains, window) == 5
    parts = in_parts(trains, 5)
    whole, cut = trains.cut(window), parts.cut(window)
    assert f"{len(whole) - len(cut)} of {len(whole)} windows" in caplog.text
    inside = [*zip(cut.trial, cut.start, strict=True)]
    assert all(start + 30 <= parts.trial_steps[trial] for trial, start in inside)
    assert parts_for(trains_of([100] * 10), WindowSpec(length_ms=300)) == 1


def test_a_window_has_the_label_at_its_end():
    trains = trains_of([100], [(0, 0.2, 0.5, "slip"), (0, 0.5, 0.7, "contact")])
    task = tasks.Task(window=WindowSpec(length_ms=100, hop_ms=50), target=("events",))
    windows = trains.cut(task.window)
    names = tasks.names_of(trains, task)
    assert names == ("none", "contact", "slip")
    ends = (windows.start + 10) / RATE_Hz
    expected = ["slip" if 0.2 <= end < 0.5 else "contact" if 0.5 <= end < 0.7 else "none" for end in ends]
    assert [names[label] for label in tasks.labels_of(trains, windows, task)] == expected


def test_sides_share_no_sample_and_classes_count_the_same():
    table = [(trial, 0.5 + k, 0.7 + k, "slip") for trial in range(2) for k in range(9)]
    trains = in_parts(trains_of([1000, 1000], table), 5)
    task = tasks.Task(window=WindowSpec(length_ms=100, hop_ms=50), target=("events",), balance="classes")
    sides, trials = tasks.sides_of(trains, task), tasks.trials_of(trains, task)
    assert sorted(np.concatenate(trials).tolist()) == [*range(len(trains))]
    assert sides.train.weights is not None
    sums = [sides.train.weights[sides.train.labels == label].sum() for label in range(2)]
    assert sums[0] == pytest.approx(sums[1])
    assert "each class counts the same" in tasks.balance_note(trains, task)[0]


@pytest.mark.parametrize("taus", [(10.0,), (10.0, 10.0), (5.0, 15.0, 40.0)])
def test_what_is_left_of_a_response_is_the_tail_of_the_sum_of_waiting_times(taus):
    drawn = np.random.default_rng(0).exponential(taus, (200_000, len(taus))).sum(axis=1)
    for length_ms in (20.0, 60.0):
        assert left_after(taus, length_ms) == pytest.approx((drawn > length_ms).mean(), abs=0.005)


DEFAULT = {"recipe": "default"}


@pytest.mark.parametrize(
    "keys", [DEFAULT, {**DEFAULT, "readout_tau_ms": 200.0}, {**DEFAULT, "tau_mem_ms": 80.0, "tau_syn_ms": 5.0}]
)
def test_the_window_that_nobody_gave_is_as_long_as_the_time_constants_need(keys):
    spec = RSNNSpec(**keys)
    window = window_for(WindowSpec(), spec)
    assert left_after(taus_ms_of(spec, window.length_ms), window.length_ms) <= LEFT
    assert window.length_ms == 300 or left_after(taus_ms_of(spec, window.length_ms - 10), window.length_ms - 10) > LEFT
    assert window.hop_ms == window.length_ms / 4
    given = window_for(WindowSpec(length_ms=500, hop_ms=20), spec)
    assert (given.length_ms, given.hop_ms) == (500, 20)


LEAKY = {
    "model": "snn",
    "hidden": 4,
    "readout": "integrator",
    "readout_tau_ms": 40.0,
    "tau_mem_ms": 15.0,
    "tau_syn_ms": 15.0,
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": "rsnn"}, "set 'snn'"),
        ({"readout": "max", "readout_tau_ms": 40.0}, "set readout = 'integrator' and readout_tau_ms"),
        ({"readout_tau_ms": None}, "a readout that forgets"),
        ({"readout_tau_ms": 100.0}, r"give at least \d+ ms, or shorten readout_tau_ms"),
        ({"threshold_adaptation": 0.1, "tau_adaptation_ms": 200.0}, "40, 200|200"),
    ],
)
def test_a_network_that_does_not_forget_is_refused_with_the_fix(changes, message):
    window = WindowSpec(length_ms=300)
    network_for(RSNNSpec(**LEAKY), window)
    with pytest.raises(InputError, match=message):
        network_for(RSNNSpec(**{**LEAKY, **changes}), window)


def test_the_length_that_a_refusal_names_is_enough():
    spec = RSNNSpec(**{**LEAKY, "readout_tau_ms": 100.0})
    with pytest.raises(InputError, match="give at least") as refused:
        network_for(spec, WindowSpec(length_ms=300))
    enough = float(str(refused.value).split("give at least ")[1].split()[0])
    network_for(spec, WindowSpec(length_ms=enough))


def test_older_state_is_forgotten():
    spec = RSNNSpec(**LEAKY)
    network = RSNN(2, 3, spec, 1000.0, generator=torch.Generator().manual_seed(0))
    spikes = (torch.rand(1, 900, 2, generator=torch.Generator().manual_seed(1)) < 0.08).to(torch.uint8)
    other = spikes.clone()
    other[:, :300] = other[:, :300].flip(1)
    integration = network.integration
    assert integration is not None
    values = [torch.stack([*integration.over(network.simulate(one).readout)], 1)[0] for one in (spikes, other)]
    apart = (values[0] - values[1]).abs().amax(dim=1)
    assert apart[299] > 0
    assert apart[-1] < 0.01 * apart.max()


@pytest.mark.parametrize(
    ("marked", "message"),
    [(None, "needs annotations in time"), ([], "needs annotations in time")],
)
def test_training_without_marks_is_refused(tmp_path, marked, message):
    trains = trains_of([300] * 10)
    object.__setattr__(trains, "marks", None if marked is None else trains.marks)
    nt.save(trains, tmp_path / "a.h5")
    with pytest.raises(InputError, match=message):
        nt.train(tmp_path / "a.h5", tmp_path / "run", learn=nt.Learn(target="events"))


def test_settings_that_do_not_fit_are_refused(tmp_path):
    nt.save(trains_of([300] * 10, [(trial, 1.0, 2.0, "slip") for trial in range(10)]), tmp_path / "a.h5")
    how = {"learn": nt.Learn(target="events")}
    for more, message in (
        ({"window": nt.Window(align="onset")}, "window.align"),
        ({"network": "rsnn"}, "set 'snn'"),
        ({"settings": {"hidden": 0}}, "hidden = 0"),
        ({"settings": {"readout_tau_ms": 300.0}, "window": nt.Window(length_ms=200)}, "give at least"),
        ({"settings": {"readout": "count"}}, "readout"),
    ):
        with pytest.raises(InputError, match=message):
            nt.train(tmp_path / "a.h5", tmp_path / "run", **{**how, **more})
    with pytest.raises(InputError, match="target='events'"):
        nt.train(tmp_path / "a.h5", tmp_path / "run", learn=LearnSpec(false_alarms_per_h=3))


def test_training_windows_of_one_label_are_refused():
    trains = trains_of([300] * 10, [(0, 1.0, 2.9, "slip")])
    task = tasks.Task(window=WindowSpec(length_ms=100), target=("events",))
    split = tasks.Split(np.arange(1, 8), np.array([8]), np.array([0, 9]))
    with pytest.raises(InputError, match="too few classes"):
        tasks.trials_of(trains, task, split)
