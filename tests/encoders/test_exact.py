"""Laws of membranes that are solved between samples: the limit of a finer clock, in any pieces."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_chain, offline, told
from neurotact_parts.encoders.survival.survival import survival_of
from neurotact_parts.streams.stream import Stream

from neurotact.data import conditioning
from neurotact.data.recordings import Recordings
from neurotact.encoders import afferents, encoding
from neurotact.encoders.afferents import drives
from neurotact.encoders.calibration import calibrate, with_integration
from neurotact.encoders.closed_form import ExactState, cost_of_spikes
from neurotact.encoders.cost import encoding_cost
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.gain_search import CalibrationRule
from neurotact.encoders.specs import (
    conditioning_of,
    encode,
    encode_whole,
    exact_note,
    finish,
    is_exact,
    load,
    resolve,
    set_keys,
)
from neurotact.errors import InputError
from neurotact.metrics.flops import MovingAverage, cost
from neurotact.metrics.signal_flops import BaselineRemoval
from neurotact.networks.training.provenance import first_difference
from neurotact.neurons import LIF, ExactLIF, decay_per_step, exact_lif_interval, exact_lif_start, lif_start, lif_step

RATE_Hz, CLOCK_Hz, FINE = 93.0, 1000.0, 2000
OPTIONS = [{}, {"sa1.grades": [0.5, 1.0]}, {"sa1.rate_ms": 20.0}, {"ra1.change": "both"}, {"sa1.opposite": True}]


def spec_of(**settings):
    given = {"integration": "exact", "conditioning.resample_Hz": CLOCK_Hz, "sa1.gain": 1.5, "ra1.gain": 30.0}
    return load("sa1-ra1-lif", {**given, **settings})


def steady(n_samples=40, n_trials=2, n_taxels=3, seed=0):
    """Signals of some 20 mV, with changes as large from sample to sample."""
    return np.random.default_rng(seed).normal(0, 12, (n_trials, n_samples, n_taxels)).cumsum(axis=1) / 3


def times_ms(neuron, drive, duration_ms):
    """The times of the spikes of each of the neurons, for drives `(interval, neuron)`."""
    state, found = exact_lif_start(neuron, 1), [[] for _ in range(drive.shape[1])]
    for n, now in enumerate(drive):
        spikes, state = exact_lif_interval(neuron, now[None], state, duration_ms)
        for which, time_ms in zip(*spikes, strict=True):
            found[which].append(n * duration_ms + time_ms)
    return found


def stepped_ms(neuron, drive, duration_ms):
    """The same by `LIF`, whose drive holds for `FINE` steps."""
    step_ms = duration_ms / FINE
    silent = round(float(neuron.t_ref_ms[0]) / step_ms)
    lif = LIF(decay_per_step(neuron.tau_mem_ms, 1e3 / step_ms), silent)
    state, found = lif_start(lif, drive.shape[1:], np.dtype(float)), [[] for _ in range(drive.shape[1])]
    for step, now in enumerate(np.repeat(drive, FINE, axis=0), start=1):
        fired, state = lif_step(lif, now, state)
        for which in np.flatnonzero(fired):
            found[which].append(step * step_ms)
    return found, step_ms


@given(seed=st.integers(0, 999), t_ref_ms=st.sampled_from([1.0, 5.0, 12.0]), tau_ms=st.sampled_from([3.0, 10.0, 40.0]))
@examples(8)
def test_it_is_the_limit_of_a_clock(seed, t_ref_ms, tau_ms):
    """Each step rounds each spike up by a step at most, so that the n-th spike is late by n steps at most."""
    drive = np.random.default_rng(seed).uniform(-10, 50, (6, 5))
    neuron = ExactLIF(tau_ms, np.full(5, t_ref_ms))
    expected, step_ms = stepped_ms(neuron, drive, 10.0)
    for ours, theirs in zip(times_ms(neuron, drive, 10.0), expected, strict=True):
        assert len(ours) == len(theirs)
        late = np.array(theirs) - np.array(ours)
        np.testing.assert_array_less(-1e-6, late)
        np.testing.assert_array_less(late, 4 * step_ms * np.arange(1, len(late) + 1))


@given(
    cuts=st.lists(st.integers(0, 40), max_size=4), seed=st.integers(0, 99), options=st.sampled_from(OPTIONS),
    clock_Hz=st.sampled_from([40.0, 93.0, 200.0, 1000.0]),
)  # fmt: skip
@examples(10)
@pytest.mark.filterwarnings("ignore:.*count as one")
def test_pieces_equal_the_whole(cuts, seed, options, clock_Hz):
    spec, signal = spec_of(**options, **{"conditioning.resample_Hz": clock_Hz}), steady(seed=seed)
    whole, last = encode(signal, RATE_Hz, spec)
    state, parts = None, []
    for first, end in pairwise([0, *sorted(cuts), signal.shape[1]]):
        part, state = encode(signal[:, first:end], RATE_Hz, spec, state)
        parts.append(part)
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)
    assert isinstance(state, ExactState)
    to_the_end = np.concatenate([whole, finish(RATE_Hz, spec, state)], axis=1)
    np.testing.assert_array_equal(encode_whole(signal, RATE_Hz, spec), to_the_end)
    for ours, theirs in zip(state, last, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@given(seed=st.integers(0, 999), t_ref_ms=st.floats(0.2, 20), gain=st.floats(0.1, 1e6))
@examples(10)
def test_a_refractory_period_holds_one_spike_at_most(seed, t_ref_ms, gain):
    drive = gain * np.random.default_rng(seed).uniform(-1, 1, (12, 4))
    for times in times_ms(ExactLIF(10.0, np.full(4, t_ref_ms)), drive, 7.0):
        assert (np.diff(times) > t_ref_ms - 1e-9).all()


@given(t_ref_ms=st.sampled_from([1.0, 2.0, 5.0]), seed=st.integers(0, 99))
@examples(6)
def test_bins_as_long_as_the_refractory_period_lose_no_spike(t_ref_ms, seed):
    settings = {"sa1.t_ref_ms": t_ref_ms, "ra1.t_ref_ms": t_ref_ms, "sa1.gain": 200.0}
    fine, coarse = (
        encode_whole(steady(seed=seed), 100.0, spec_of(**settings, **{"conditioning.resample_Hz": clock_Hz}))
        for clock_Hz in (20_000.0, 1e3 / t_ref_ms)
    )
    np.testing.assert_array_equal(fine.sum(axis=1), coarse.sum(axis=1))


@given(drive=st.floats(-1e6, 10.0), duration_ms=st.floats(0.01, 1e4))
@examples(20)
def test_there_is_no_spike_up_to_the_rheobase(drive, duration_ms):
    assert times_ms(ExactLIF(10.0, np.full(1, 1.0)), np.full((50, 1), drive), duration_ms) == [[]]


def test_an_interval_at_constant_drive_has_its_closed_form():
    (times,) = times_ms(ExactLIF(10.0, np.full(1, 2.0)), np.full((9, 1), 25.0), 11.0)
    np.testing.assert_allclose(np.diff(times), 2.0 + 10.0 * np.log(25 / 15))
    np.testing.assert_allclose(times[0], 10.0 * np.log(25 / 15))


def test_a_signal_at_the_encoders_clock_gives_what_the_clock_gives():
    """Intervals are multiples of a step there, so that rates are lower by what a step rounds."""
    signal = np.full((1, 4000, 1), 20.0)
    exact = encode(signal, 10_000.0, spec_of(**{"conditioning.resample_Hz": 10_000.0}))[0].sum()
    clock = encode(signal, 10_000.0, spec_of(integration="clock"))[0].sum()
    assert 0 <= int(exact) - int(clock) <= 2


@pytest.mark.parametrize(("rate_Hz", "clock_Hz", "n"), [(93.0, 1000.0, 40), (100.0, 10.0, 11), (400.0, 1000.0, 7)])
@pytest.mark.filterwarnings("ignore:.*count as one")
def test_a_trial_has_the_steps_of_a_resampled_one(rate_Hz, clock_Hz, n):
    spec = spec_of(**{"conditioning.resample_Hz": clock_Hz})
    assert encode_whole(steady(n), rate_Hz, spec).shape[1] == conditioning.conditioned_length(n, rate_Hz, clock_Hz)


def test_the_drive_holds_from_a_sample_to_the_next():
    """RA-I fire while the change holds, 10 ms, and are silent before and after it."""
    signal = np.array([0.0, 0.0, 40.0, 40.0]).reshape(1, -1, 1)
    spikes = encode(signal, 100.0, spec_of(**{"ra1.gain": 16.0}))[0][0, :, 1]  # 16 * 40 / 10 = 64 mV
    assert np.flatnonzero(spikes).tolist() == [21, 24, 27, 29]  # 21.70, then each 1 + 1.70 ms
    gains = (1.0,), (1.6,)
    assert drives(signal, gains, None)[0][0, :, 1].tolist() == [0, 0, 64.0, 0]


def test_only_samples_that_come_faster_than_the_clock_are_resampled():
    assert conditioning_of(spec_of(), RATE_Hz).resample_Hz is None
    assert conditioning_of(spec_of(), 2000.0).resample_Hz == CLOCK_Hz
    assert conditioning_of(spec_of(integration="clock"), RATE_Hz).resample_Hz == CLOCK_Hz
    fast = Recordings([steady(500)[0]], 2000.0, "mV", pd.DataFrame({"label": ["a"]}))
    assert encode_recordings(fast, spec_of()).trial_steps.tolist() == [250]


def recorded(n_samples=60, n_trials=6, seed=0):
    """Touches of two classes, of which one changes twice as fast."""
    rng, time_s = np.random.default_rng(seed), np.arange(n_samples)[:, None] / RATE_Hz
    rates_Hz = np.repeat([2.0, 6.0], n_trials // 2)
    signals = [
        np.sin(2 * np.pi * f * time_s + rng.uniform(0, 6, 2)) + rng.normal(0, 0.1, (n_samples, 2)) for f in rates_Hz
    ]
    labels = pd.DataFrame({"label": ["slow"] * (n_trials // 2) + ["fast"] * (n_trials // 2)})
    return Recordings([each.astype(np.float32) for each in signals], RATE_Hz, "mV", labels)


def test_a_long_trial_is_encoded_as_a_short_one(monkeypatch):
    spec = spec_of(**{"sa1.gain": 20.0, "conditioning.baseline": "start"})
    whole = encode_recordings(recorded(), spec)
    for module in (conditioning, encoding):
        monkeypatch.setattr(module, "PIECE_VALUES", 150)
    pieces = encode_recordings(recorded(), spec)
    assert whole.trial_steps.tolist() == [645] * 6
    assert sum(map(len, whole.steps)) > 100
    for ours, theirs in zip((*pieces.steps, *pieces.units), (*whole.steps, *whole.units), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert whole.encoder["recorded_Hz"] == RATE_Hz
    assert first_difference(whole.encoder, [], {**whole.encoder, "recorded_Hz": 50.0}, []) is None
    assert "recorded_Hz" not in encode_recordings(recorded(), spec_of(integration="clock")).encoder


@given(cuts=st.lists(st.integers(0, 60), max_size=4))
@examples(4)
def test_a_stream_decides_as_the_whole_trial(cuts, tmp_path_factory):
    network = {"hidden": 6, "forward_weight_scale": 3.0}
    conditioned = {"baseline": "start", "start_ms": 50.0, "ema_cutoff_Hz": 30.0, "resample_Hz": 1000.0}
    chain = make_chain(conditioned, rate_Hz=RATE_Hz, afferents={"integration": "exact"}, patience=20, **network)
    signal = 3 * recorded().signals[5]
    raster, expected = offline(chain, signal)
    traces = []
    stream, found = Stream(chain, watch=traces.append), []
    for first, last in pairwise([0, *sorted(cuts), len(signal)]):
        found += stream.push(signal[first:last])
        path = tmp_path_factory.mktemp("state") / "state"
        stream.save(path)
        stream = Stream(chain, watch=traces.append)
        stream.load(path)
    found += stream.finish()
    assert expected
    assert told(found)[: len(expected)] == expected
    np.testing.assert_array_equal(np.concatenate([trace.afferents for trace in traces]), raster != 0)


def test_gains_are_found_on_the_samples_of_the_sensor():
    start = load(
        "sa1-ra1-lif", {"integration": "exact", "conditioning.baseline": "start", "conditioning.ema_cutoff_Hz": 30}
    )
    fitted = calibrate(recorded(), start, rule=CalibrationRule(candidates=16), tell=False)
    assert is_exact(fitted.encoder)
    assert fitted.encoder.conditioning.resample_Hz == CLOCK_Hz
    assert exact_note(CLOCK_Hz, RATE_Hz) in fitted.notes
    trains = encode_recordings(recorded(), fitted.encoder)
    chosen = fitted.table[fitted.table.chosen].set_index("afferent").spikes_per_s
    of_each = np.bincount(np.concatenate(trains.units), minlength=4).reshape(2, 2).sum(axis=1)
    np.testing.assert_allclose(of_each / 2 / (6 * 60 / RATE_Hz), [chosen["SA-I"], chosen["RA-I"]], rtol=0.02)
    assert survival_of(recorded(), fitted.encoder).table.snr_dB.iloc[-1] > 0


@pytest.mark.parametrize("clock_Hz", [None, 200.0, 1000.0])
@pytest.mark.parametrize("rate_Hz", [35.61, 199.0, 200.0, 999.0, 1000.0, 2000.0])
def test_a_sensor_slower_than_the_clock_is_calibrated_in_closed_form(rate_Hz, clock_Hz):
    start = load("sa1-ra1-lif", {} if clock_Hz is None else {"conditioning.resample_Hz": clock_Hz})
    chosen, notes = with_integration(start, [], rate_Hz)
    least_Hz = clock_Hz or CLOCK_Hz
    assert is_exact(chosen) == (rate_Hz < least_Hz)
    if not is_exact(chosen):
        assert (chosen, notes) == (start, [])
        return
    assert chosen.conditioning.resample_Hz == least_Hz
    assert notes == [f"{exact_note(least_Hz, rate_Hz)}; to choose otherwise, set integration = 'clock'"]
    same = {"integration": start.integration, "conditioning": start.conditioning}
    assert chosen.model_copy(update=same) == start


@pytest.mark.parametrize("model", ["send-on-delta", "izhikevich", "mechanoreceptor"])
def test_other_encoders_than_lif_keep_their_clock(model):
    assert with_integration(load(model), [], RATE_Hz) == (load(model), [])


@pytest.mark.parametrize("integration", ["clock", "exact"])
@pytest.mark.parametrize("place", ["settings", "spec", "file", "spec with other settings"])
def test_an_integration_that_is_set_is_kept(tmp_path, place, integration):
    given = {"integration": integration}
    what, settings = {
        "settings": ("sa1-ra1-lif", given),
        "spec": (load("sa1-ra1-lif", given), None),
        "file": (str(tmp_path / "mine.toml"), {"sa1.t_ref_ms": 5}),
        "spec with other settings": (load("sa1-ra1-lif", given), {"sa1.t_ref_ms": 5}),
    }[place]
    (tmp_path / "mine.toml").write_text(f"integration = '{integration}'\n[sa1]\ngain = 1.0\n[ra1]\ngain = 1.0\n")
    start = resolve(what, settings)
    assert with_integration(start, set_keys(what, settings), RATE_Hz) == (start, [])
    assert start.integration == integration


@pytest.mark.parametrize("settings", [None, {"sa1.t_ref_ms": 5}])
@pytest.mark.parametrize("what", ["sa1-ra1-lif", load("sa1-ra1-lif")])
def test_an_integration_that_is_not_set_is_chosen(what, settings):
    assert is_exact(with_integration(resolve(what, settings), set_keys(what, settings), RATE_Hz)[0])


def test_spikes_in_closed_form_by_hand():
    # Time: U_inf - U, U_inf - threshold, their quotient 4, its logarithm 8, t + tau ln. End: + t_ref, < sample's end.
    # Membrane: end - t, times -1 / tau, exp 8, reset - U_inf, U_inf + that times exp, >= threshold. Bin: times R, up.
    counted = cost_of_spikes(2.5)
    assert counted.macs == 2.5 * (1 + 1)
    assert counted.acs == 2.5 * (2 + 1 + 1 + 1)
    assert counted.other_flops == 2.5 * (4 + 8 + 1 + 1 + 8 + 1 + 1 + 1)
    assert (counted.parameters, counted.bytes) == (0, 0)
    with pytest.raises(InputError, match=r"spikes: must be >= 0"):
        cost_of_spikes(-1.0)


def test_its_cost_is_that_of_samples_and_spikes():
    spec = spec_of(**{"conditioning.ema_cutoff_Hz": 30.0}).model_copy(update={"recorded_Hz": 100.0})
    table = spec.model_dump(mode="json", exclude_none=True)
    conditioned = cost(MovingAverage(50, 3), BaselineRemoval(50, 3, level="mean"), signal_ms=500)
    of_samples = conditioned.in_32_bits() + afferents.cost({"integration": "exact"}, 3, 50, 10.0)
    assert encoding_cost(3, 500, 500.0, table, spikes=0) == of_samples
    assert encoding_cost(3, 500, 500.0, table, spikes=70) == of_samples + cost_of_spikes(70).in_32_bits()
    quick = {**table, "recorded_Hz": 2000.0}  # is resampled to 1 kHz
    of_steps = encoding_cost(3, 500, 500.0, {**table, "integration": "clock"}, recorded_Hz=2000.0)
    assert encoding_cost(3, 500, 500.0, quick, spikes=70) == (of_steps + cost_of_spikes(70)).in_32_bits()
    fastest = encoding_cost(3, 500, 500.0, {**table, "sa1": {"t_ref_ms": 5.0}})  # 3 at 200 Hz and 3 at 1 kHz
    assert fastest == of_samples + cost_of_spikes(3 * 100 + 3 * 500).in_32_bits()
    on_a_clock = {**table, "integration": "clock"}
    assert encoding_cost(3, 500, 500.0, on_a_clock, spikes=70) == encoding_cost(3, 500, 500.0, on_a_clock)


def test_what_it_cannot_do_is_refused():
    with pytest.raises(InputError, match=r"sa1.t_ref_ms must be 0.1 or more with integration = 'exact'"):
        spec_of(**{"sa1.t_ref_ms": 0})
    _, state = encode(steady(), RATE_Hz, spec_of())
    with pytest.raises(InputError, match="of another encoder"):
        encode(steady(), RATE_Hz, spec_of(integration="clock"), state)
    with pytest.warns(UserWarning, match=r"sa1.t_ref_ms: 1 ms is shorter than a step of 5 ms"):
        encode(steady(), RATE_Hz, spec_of(**{"conditioning.resample_Hz": 200.0, "ra1.t_ref_ms": 5.0}))
