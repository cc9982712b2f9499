"""Laws of every encoder model: pieces equal the whole, each taxel is alone, zeros are silent; spikes by hand."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.encoders.bens_spiker import BensSpikerState
from neurotact_parts.encoders.decoding import hann

from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.recordings import Recordings
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import usable
from neurotact.encoders.specs import afferent_names, default_of, encode, load
from neurotact.errors import InputError

MODELS = usable()
RATE_Hz = 1000.0
LIVELY = {
    "send-on-delta": {"threshold": 1.0, "t_ref_ms": 3.0},
    "sigma-delta": {"threshold_unit_ms": 15.0, "t_ref_ms": 2.0},
    "step-forward": {"threshold": 1.0},
    "moving-window": {"threshold": 1.0, "window_ms": 7.0, "t_ref_ms": 2.0},
    "bens-spiker": {"gain": 0.05, "filter_ms": 15.0},
    "latency": {"cycle_ms": 20.0, "sa1.gain": 0.1, "ra1.gain": 0.2},
    "burst": {"cycle_ms": 45.0, "sa1.gain": 0.1, "ra1.gain": 0.2},
    "resonate-and-fire": {"low.gain_per_ms": 0.05, "high.gain_per_ms": 0.05},
}
"""Settings that make the signals below fire."""
SIGNALS = {**{name: {} for name in MODELS}, "latency contact": {"begins": "contact", "contact": 0.5, "quiet_ms": 5.0}}


def spec_of(name):
    model = name.split()[0]
    return load(default_of(model), {**LIVELY.get(model, {}), **SIGNALS.get(name, {})})


def waves(n_trials=2, n_steps=160, n_taxels=3, seed=0, kind="f4"):
    """Sums of two sines of random frequencies and phases, of some 10 units."""
    rng, time_s = np.random.default_rng(seed), np.arange(n_steps) / RATE_Hz
    turns = rng.uniform(3, 40, (2, n_trials, 1, n_taxels)) * time_s[:, None] + rng.random((2, n_trials, 1, n_taxels))
    return (10 * np.sin(2 * np.pi * turns).sum(axis=0)).astype(kind)


@pytest.mark.parametrize("name", SIGNALS)
@given(cuts=st.lists(st.integers(0, 160), max_size=4), seed=st.integers(0, 99), kind=st.sampled_from(["f4", "f8"]))
@examples(8)
def test_pieces_equal_the_whole(name, cuts, seed, kind):
    spec, signal = spec_of(name), waves(seed=seed, kind=kind)
    whole, _ = encode(signal, RATE_Hz, spec)
    state, parts = None, []
    for first, last in pairwise([0, *sorted(cuts), signal.shape[1]]):
        part, state = encode(signal[:, first:last], RATE_Hz, spec, state)
        parts.append(part)
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)
    assert whole.shape == (2, 160, len(afferent_names("abc", spec.model_dump())))
    assert set(np.unique(whole)) <= {0, 1}


@pytest.mark.parametrize("name", SIGNALS)
def test_a_state_is_not_changed_by_the_steps_after_it(name):
    spec, signal = spec_of(name), waves()
    _, state = encode(signal[:, :60], RATE_Hz, spec)
    once, _ = encode(signal[:, 60:], RATE_Hz, spec, state)
    again, _ = encode(signal[:, 60:], RATE_Hz, spec, state)
    np.testing.assert_array_equal(once, again)


@pytest.mark.parametrize("name", [name for name in SIGNALS if name in MODELS])
def test_each_trial_and_taxel_is_encoded_alone(name):
    spec, signal = spec_of(name), waves(seed=3)
    together, _ = encode(signal, RATE_Hz, spec)
    assert together.any()
    for trial, taxel in ((0, 2), (1, 0)):
        n_before = taxel if "seed" in type(spec).model_fields else 0  # noise depends on the number of a taxel
        alone, _ = encode(signal[trial : trial + 1, :, taxel - n_before : taxel + 1], RATE_Hz, spec)
        np.testing.assert_array_equal(together[trial, :, taxel::3], alone[0, :, n_before :: n_before + 1])


@pytest.mark.parametrize("name", [*SIGNALS])
def test_a_signal_of_zeros_gives_no_spike(name):
    assert not encode(np.zeros((1, 200, 2)), RATE_Hz, spec_of(name))[0].any()


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("signal", [np.zeros((2, 9)), np.zeros((1, 9, 2), int)])
def test_what_is_no_float_array_of_trials_is_refused(name, signal):
    with pytest.raises(InputError, match=r"signal: must be a float array \(trial, time, taxel\)"):
        encode(signal, RATE_Hz, spec_of(name))


def test_a_refractory_period_in_seconds_is_asked_about():
    with pytest.raises(InputError, match=r"sa1.t_ref_ms: must be 0 or at least 0.05 ms \(did you mean 5 ms\?\)"):
        load("sa1-ra1-lif", {"sa1.t_ref_ms": 0.005})
    assert load("sa1-ra1-lif", {"sa1.t_ref_ms": 0.05}).sa1.t_ref_ms == 0.05


@pytest.mark.parametrize("name", [name for name, model in MODELS.items() if "t_ref_ms" in model.spec.model_fields])
@pytest.mark.parametrize("t_ref_ms", [0.0, 4.0])
def test_a_taxel_is_silent_for_its_refractory_period(name, t_ref_ms):
    spikes, _ = encode(
        waves(n_taxels=1, n_steps=400), RATE_Hz, load(name, {**LIVELY.get(name, {}), "t_ref_ms": t_ref_ms})
    )
    shortest = min(np.diff(np.flatnonzero(trial.any(axis=1))).min() for trial in spikes)
    assert shortest >= t_ref_ms + 1
    assert not (spikes[..., 0] & spikes[..., 1]).any()


@pytest.mark.parametrize("model", MODELS)
def test_a_model_costs_what_its_taxels_and_steps_cost(model):
    """Twice the taxels do twice the work, but for what all share."""
    table = load(default_of(model)).model_copy(update={"conditioning": load("sa1-ra1-lif").conditioning})
    dumped = {**table.model_dump(mode="json", exclude_none=True), "conditioning": {}}
    one, two = (encoding_cost(n, 300, 150.0, dumped) for n in (4, 8))
    shared = 300 if model == "latency" else 0
    assert two.flops - shared == 2 * (one.flops - shared) > 0


LONE = {
    "izhikevich": (2 * 10 + 2) * 8 * 300,  # b v in each Euler step; two gains
    "poisson": 2 * 8 * 300,
    "moving-window": 8 * 300,
    "bens-spiker": 2 * 8 * 300,
    "latency": 2 * 8 * 300 + 300,
    "burst": 2 * 2 * 8 * 6,
    "mechanoreceptor": (2 + 1 + 1) * 8 * 1500,
}
"""The multiplications of 300 ms of 8 taxels whose product is not added; other models have none."""


@pytest.mark.parametrize("model", MODELS)
def test_multiplications_whose_product_is_not_added_have_their_own_price(model):
    counted = MODELS[model].cost(load(default_of(model)).model_dump(mode="json"), 8, 300, 1.0)
    assert counted.multiplications == LONE.get(model, 0)
    assert counted.flops > 0


def test_operations_of_lif_afferents_counted_by_hand():
    # 2 taxels, 3 steps, an SA-I and an RA-I each: 12 updates of 2 MACs; 6 differences and absolute values; 12 tests.
    counted = MODELS["lif"].cost({}, 2, 3, 1.0)
    assert (counted.macs, counted.acs, counted.other_flops) == (24, 6, 18)


# --- spikes counted by hand -------------------------------------------------------------------------


def steps_of(values, settings, model):
    """The steps of the events of each afferent, for one taxel."""
    signal = np.array(values, float).reshape(1, -1, 1)
    spikes, _ = encode(signal, RATE_Hz, load(model, settings))
    return [np.flatnonzero(column).tolist() for column in spikes[0].T]


def test_send_on_delta_measures_from_the_sample_of_the_last_event():
    #         ref 0  0  3  3  3  5.5 5.5 5.5 ...: +3, +2.5, then -2.5
    values = [0, 1.9, 3, 4.9, 4, 5.5, 3.6, 3, 3.5]
    assert steps_of(values, {"threshold": 2.0, "t_ref_ms": 0}, "send-on-delta") == [[2, 5], [7]]


def test_a_change_in_the_refractory_period_is_sent_after_it():
    values = [0, 2, 4, 6, 8, 8, 8]
    assert steps_of(values, {"threshold": 2.0, "t_ref_ms": 3}, "send-on-delta") == [[1, 5], []]


def test_step_forward_sends_a_large_change_in_several_steps():
    values = [0, 5, 5, 5, 5, -3, -3, -3, -3]  # base 0 2 4 4 4, then 2 0 -2 -2: x must be beyond a step, not at it
    assert steps_of(values, {"threshold": 2.0}, "step-forward") == [[1, 2], [5, 6, 7]]


def test_a_moving_window_compares_with_the_mean_of_the_samples_before():
    values = [0, 3, 3, 3, 3, 0]  # means before each: -, 0, 1.5, 3, 3, 3
    settings = {"threshold": 1.4, "window_ms": 2.0}
    assert steps_of(values, settings, "moving-window") == [[1, 2], [5]]


def test_sigma_delta_keeps_what_a_pulse_does_not_say():
    values = [3, 3, 3, 3, -9, -9]  # integral 3 6>1 4 7>2, then -7>-2, -11>-6: pulses of 5
    assert steps_of(values, {"threshold_unit_ms": 5.0}, "sigma-delta") == [[1, 3], [4, 5]]


def test_sigma_delta_forgets_an_overload():
    """The integral stops at four thresholds: five pulses at most follow a blow of any size."""
    on, off = steps_of([1e6, *[0.0] * 20], {"threshold_unit_ms": 5.0}, "sigma-delta")
    assert (on, off) == ([0, 1, 2, 3], [])


def test_a_latency_is_the_logarithm_of_the_drive():
    settings = {"cycle_ms": 50.0, "tau_ms": 10.0, "sa1.gain": 1.0, "ra1.gain": 1e-9}
    sa1, ra1 = steps_of([np.exp(-2.5)] * 120, settings, "latency")
    assert (sa1, ra1) == ([25, 75], [])
    assert steps_of([np.exp(-5.5)] * 120, settings, "latency") == [[], []]  # weaker than exp(-50 / 10)


def test_a_contact_begins_one_cycle():
    settings = {
        "cycle_ms": 20.0, "tau_ms": 10.0, "sa1.gain": 1.0, "ra1.gain": 1e-9, "begins": "contact", "contact": 0.3,
        "quiet_ms": 10.0,
    }  # fmt: skip
    strong, nothing = [np.exp(-1.0)] * 30, [0.0] * 15
    sa1, _ = steps_of([*nothing, *strong, *nothing, *strong], settings, "latency")
    assert sa1 == [25, 70]  # 10 steps after the contacts at 15 and 60, and not again while each lasts


def test_a_burst_tells_the_mean_drive_of_the_cycle_before():
    settings = {"cycle_ms": 50.0, "sa1.gain": 1.0, "ra1.gain": 1e-9}  # up to 5 spikes, 10 to 2 ms apart
    sa1, _ = steps_of([*[1.0] * 50, *[0.4] * 50, *[0.0] * 50, *[0.0] * 10], settings, "burst")
    # P = 1: five, 2 ms apart. P = 0.4: two, 10 - 0.4 * 8 = 6.8 ms apart, in whole ms. P = 0: none.
    assert sa1 == [50, 52, 54, 56, 58, 100, 107]


def test_a_burst_of_a_drive_beyond_the_strongest_is_the_strongest():
    settings = {"cycle_ms": 50.0, "sa1.gain": 1.0, "ra1.gain": 1e-9}
    assert steps_of([7.0] * 100, settings, "burst") == steps_of([1.0] * 100, settings, "burst")


def test_bens_spiker_gives_a_spike_where_the_filter_fits_and_sends_it_late():
    """The signal is two responses: two spikes, each a filter's length later; what they leave is nothing."""
    h, signal = hann(5.0, 1.0), np.zeros(40)
    signal[10:15] += h
    signal[20:25] += h
    spikes, state = encode(signal[None, :, None], RATE_Hz, load("bens-spiker", {"gain": 1.0, "filter_ms": 5.0}))
    assert np.flatnonzero(spikes[0, :, 0]).tolist() == [14, 24]
    assert not spikes[..., 1].any()
    assert isinstance(state, BensSpikerState)
    assert abs(state.remaining).max() < 1e-12


def test_a_resonator_prefers_its_frequency():
    settings = {"low.gain_per_ms": 0.15, "high.gain_per_ms": 0.15, "low.frequency_Hz": 8, "high.frequency_Hz": 30}
    time_s = np.arange(2000) / RATE_Hz
    counts = [
        [len(its) for its in steps_of(np.sin(2 * np.pi * f * time_s), settings, "resonate-and-fire")] for f in (8, 30)
    ]
    assert counts[0][0] > 10 > counts[0][1]
    assert counts[1][1] > 40 > counts[1][0]


@pytest.mark.parametrize(("settings", "model", "said"), [
    ({"cycle_ms": 1.0}, "latency", "two steps"),
    ({"shortest_isi_ms": 0.5}, "burst", "less than a step"),
    ({"high.frequency_Hz": 500.0}, "resonate-and-fire", "half the clock"),
    ({"filter_ms": 9000.0}, "bens-spiker", "more than"),
])  # fmt: skip
def test_what_a_clock_cannot_express_is_refused(settings, model, said):
    with pytest.raises(InputError, match=said):
        encode(np.zeros((1, 10, 1)), RATE_Hz, load(model, settings))


def test_a_burst_that_outlasts_its_cycle_is_refused():
    with pytest.raises(InputError, match="a burst ends before the next"):
        load("burst", {"cycle_ms": 20.0})


@pytest.mark.parametrize("name", SIGNALS)
@examples(3)
@given(lengths=st.lists(st.integers(100, 160), min_size=2, max_size=5))
def test_trials_of_other_lengths_do_not_change_the_spikes_of_a_trial(name, lengths):
    """They are encoded side by side, with zeros after the ends of the shorter ones."""
    spec = spec_of(name)
    spec = spec.model_copy(update={"conditioning": ConditioningSpec(baseline="none", ema_cutoff_Hz=None)})
    signals = [wave[:n] for wave, n in zip(waves(len(lengths), seed=len(lengths)), lengths, strict=True)]
    labels = pd.DataFrame({"label": ["felt"] * len(lengths)})
    trains = encode_recordings(Recordings(signals, RATE_Hz, spec.unit, labels), spec)
    for trial, signal in enumerate(signals):
        alone, _ = encode(signal[None], RATE_Hz, spec)
        np.testing.assert_array_equal(np.argwhere(alone[0]), np.c_[trains.steps[trial], trains.units[trial]])
