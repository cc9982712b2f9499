"""Neo: what goes there comes back to the step; blocks of others are put on a clock as their times say."""

import sys

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

import neurotact as nt
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError

neo = pytest.importorskip("neo", reason="neo is not installed")
LIF = {"model": "lif", "sa1": {"gain": 3.2}, "ra1": {"gain": 16.0}}


def trains_of(lengths, rate_Hz=1000.0, seed=0, density=0.1, **about) -> SpikeTrains:
    rng = np.random.default_rng(seed)
    events = [np.nonzero(rng.random((n, 3)) < density) for n in lengths]
    conditions = pd.DataFrame(
        {
            "label": [("felt", "silk")[i % 2] for i in range(len(lengths))],
            "force_N": [i / 3 for i in range(len(lengths))],
            "trial": np.arange(len(lengths)),
            "name": "Ann",
        }
    )
    return SpikeTrains(
        [steps.astype(np.int64) for steps, _ in events], [units.astype(np.uint16) for _, units in events],
        np.array(lengths), rate_Hz, ("SA-I a", "SA-I b", "RA-I a"), conditions,
        **{"encoder": LIF, "source": "skin.h5", **about},
    )  # fmt: skip


@given(
    lengths=st.lists(st.integers(1, 300), min_size=1, max_size=4),
    rate_Hz=st.sampled_from([35.61, 49.0, 1000.0, 1000 / 3, 44_100.0]),
    density=st.sampled_from([0.0, 0.02, 0.5, 1.0]),
    seed=st.integers(0, 99),
    digests=st.booleans(),
)
@examples(30)
def test_spikes_come_back_to_the_step(lengths, rate_Hz, density, seed, digests):
    about = {"trial_digests": tuple(f"{i:016x}" for i in range(len(lengths)))} if digests else {}
    trains = trains_of(lengths, rate_Hz, seed, density, **about, recorded_Hz=35.6 if digests else None)
    back = nt.from_neo(nt.to_neo(trains))
    for mine, its in ((trains.steps, back.steps), (trains.units, back.units)):
        assert [each.tolist() for each in mine] == [each.tolist() for each in its]
    assert back.trial_steps.tolist() == lengths
    pd.testing.assert_frame_equal(back.conditions, trains.conditions)
    for key in ("sampling_rate_Hz", "afferents", "encoder", "source", "trial_digests", "recorded_Hz"):
        assert getattr(back, key) == getattr(trains, key)


def test_a_segment_is_a_trial_and_a_train_an_afferent_in_ms():
    trains = trains_of([40, 20], rate_Hz=2000.0, density=0.3)
    block = nt.to_neo(trains)
    assert [segment.annotations["label"] for segment in block.segments] == ["felt", "silk"]
    second = block.segments[1]
    assert [train.name for train in second.spiketrains] == list(trains.afferents)
    own = trains.steps[1][trains.units[1] == 2]
    np.testing.assert_allclose(second.spiketrains[2].rescale("s").magnitude, own / 2000.0)
    assert str(second.spiketrains[2].units.dimensionality) == "ms"
    assert float(second.spiketrains[2].t_stop) == 10.0


def made(times_by_trial, t_start=0.0, t_stop=0.02, names=None, **annotations):
    block = neo.Block()
    for trial, trains in enumerate(times_by_trial):
        segment = neo.Segment(cloth=f"cloth{trial}", **annotations)
        for place, times in enumerate(trains):
            name = None if names is None else names[place]
            segment.spiketrains.append(
                neo.SpikeTrain(np.array(times), units="s", t_start=t_start, t_stop=t_stop, name=name)
            )
        block.segments.append(segment)
    return block


def test_another_s_block_is_put_on_a_clock_by_hand():
    """Two spikes within a millisecond are one; the last stands at the end of its train, and so in the last step."""
    block = made([[[5.0, 5.0032, 5.0039], [5.02]], [[], [5.0101]]], 5.0, 5.02, depth_mm=2)
    with pytest.raises(InputError, match=r"block: 1 of 5 events \(20 %\) .* `step_ms`, .* `merge_events=True`"):
        nt.from_neo(block, label="cloth")
    found = nt.from_neo(block, label="cloth", merge_events=True)
    assert (found.afferents, found.sampling_rate_Hz, found.encoder) == (("unit0", "unit1"), 1000.0, {})
    assert [each.tolist() for each in found.steps] == [[0, 3, 19], [10]]
    assert [each.tolist() for each in found.units] == [[0, 0, 1], [1]]
    assert found.conditions.to_dict("list") == {"label": ["cloth0", "cloth1"], "depth_mm": [2, 2]}
    assert nt.from_neo(block, label="cloth", step_ms=0.1).steps[0].tolist() == [0, 32, 39, 199]


def test_units_that_some_segments_lack_are_silent_there():
    block = made([[[0.001], [0.002]]], names=("left", "right"))
    block.segments += made([[[0.003]]], names=("middle",)).segments
    found = nt.from_neo(block, label="cloth")
    assert found.afferents == ("left", "right", "middle")
    assert [each.tolist() for each in found.units] == [[0, 1], [2]]


@pytest.mark.parametrize(
    ("block", "options", "message"),
    [
        (neo.Block(), {}, "segments each hold spike trains"),
        ("spikes.nix", {}, "must be a neo.Block"),
        (made([[]]), {}, "segments each hold spike trains"),
        (made([[[0.001]]]), {}, r"segment 0 has no annotation 'label' \(cloth\)"),
        (made([[[0.001], []]], names=("a", "a")), {"label": "cloth"}, "two spike trains called 'a'"),
        (made([[[0.001]]]), {"label": "cloth", "step_ms": 0}, "step_ms: must be a positive number"),
        (made([[[0.001]]], t_stop=1e12), {"label": "cloth"}, "no clock holds it"),
    ],
)
def test_what_is_no_block_of_trials_is_refused(block, options, message):
    with pytest.raises(InputError, match=message):
        nt.from_neo(block, **options)


def test_a_trial_without_a_step_and_a_missing_package_are_refused(monkeypatch):
    with pytest.raises(InputError, match="a trial without a step"):
        nt.to_neo(trains_of([3, 0]))
    monkeypatch.setitem(sys.modules, "neo", None)
    with pytest.raises(InputError, match=r"pip install 'neurotact\[neuro\]'"):
        nt.to_neo(trains_of([3]))


def recorded(spans_by_trial):
    """A block of trials, of which each unit was recorded from one time to another, with a spike at each beginning."""
    block = neo.Block()
    for trial, spans in enumerate(spans_by_trial):
        segment = neo.Segment(label=("felt", "silk")[trial % 2], phase=("early", "late")[trial > 0])
        for unit, (start, stop) in enumerate(spans):
            segment.spiketrains.append(
                neo.SpikeTrain(np.array([start]), units="s", t_start=start, t_stop=stop, name=f"unit{unit}")
            )
        block.segments.append(segment)
    return block


def test_segments_that_a_unit_does_not_observe_whole_are_left_out(caplog):
    """The twin of `obs_intervals` of NWB: a spike train that ends early was not silent thereafter."""
    whole = [[(1.0, 2.0), (1.0, 2.0)]] * 19
    found = nt.from_neo(recorded([[(1.0, 2.0), (1.0, 1.5)], *whole]))
    assert len(found) == 19
    assert caplog.messages == [
        "block: 1 of 20 trials are left out: 1 are not observed whole by unit1 (observes 19 of 20)"
    ]
    caplog.clear()
    assert len(nt.from_neo(recorded([[(1.0, 2.0), (1.001, 1.9995)], *whole]))) == 20  # to a step of 1 ms
    assert not caplog.messages
    late = recorded([[(1.0, 2.0), (1.2, 2.0)], whole[0]])
    with pytest.raises(
        InputError, match=r"1 of 2 trials would be left out.*the same t_start.*`unobserved='leave-out'`, or"
    ):
        nt.from_neo(late)
    assert nt.from_neo(late, unobserved="leave-out").conditions["label"].tolist() == ["silk"]
    assert len(nt.from_neo(late, unobserved="silent")) == 2
    assert len(nt.from_neo(late, where={"phase": "late"})) == 1
    assert "block: 1 of 2 trials are kept: phase = late" in caplog.messages


def test_spike_trains_that_are_absent_are_said(caplog):
    block = made([[[0.001], [0.002]]], names=("left", "right"))
    block.segments += made([[[0.003]]], names=("middle",)).segments
    nt.from_neo(block, label="cloth")
    assert caplog.messages == ["block: 2 of 2 segments lack spike trains of some units, which are silent there"]
