"""Conditioning: each step against its closed form."""

from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from neurotact.data import conditioning
from neurotact.data.conditioning import (
    Conditioner,
    ConditioningSpec,
    condition,
    condition_pieces,
    conditioned_length,
    ema,
    ema_coefficient,
)
from neurotact.data.recordings import Recordings
from neurotact.data.windows import WindowSpec, cut
from neurotact.errors import InputError

RATES = st.sampled_from([35.6, 100.0, 1000.0, 2000.0])
VALUES = st.floats(-1e3, 1e3, width=32)
SIGNALS = st.tuples(st.integers(2, 40), st.integers(1, 3)).flatmap(lambda n: hnp.arrays(float, n, elements=VALUES))


def resample(signal, rate_Hz, to_Hz):
    return Conditioner(rate_Hz, ConditioningSpec(resample_Hz=to_Hz)).whole(signal)


def skin(signals, rate_Hz=1000.0, unit="mV") -> Recordings:
    table = pd.DataFrame({"label": [f"class{i % 2}" for i in range(len(signals))]})
    return Recordings(signals, rate_Hz, unit, table, source="skin.h5")


# --- exponential moving average ---------------------------------------------------------------------


@given(st.floats(0.01, 0.99), VALUES)
def test_the_ema_leaves_a_constant_alone(coefficient, level):
    signal = np.full((50, 2), level)
    np.testing.assert_allclose(ema(signal, coefficient), signal, rtol=1e-12, atol=1e-12)


@given(st.floats(0.01, 0.99))
def test_the_step_response_is_exponential(coefficient):
    step = np.r_[0.0, np.ones(60)][:, None]
    np.testing.assert_allclose(ema(step, coefficient)[:, 0], 1.0 - (1.0 - coefficient) ** np.arange(61), atol=1e-12)


@given(st.floats(1.0, 50.0))
def test_a_sine_at_the_cut_off_loses_3_db(cutoff_Hz):
    rate_Hz = 2000.0
    n_samples = round(40 * rate_Hz / cutoff_Hz)
    sine = np.sin(2 * np.pi * cutoff_Hz * np.arange(n_samples) / rate_Hz)[:, None]
    settled = ema(sine, ema_coefficient(cutoff_Hz, rate_Hz))[n_samples // 2 :]
    assert 20 * np.log10(np.abs(settled).max()) == pytest.approx(-3.0, abs=0.15)


@given(SIGNALS, st.floats(0.01, 0.99), st.data())
def test_a_signal_smoothed_in_two_pieces_is_that_smoothed_whole(signal, coefficient, data):
    at = data.draw(st.integers(1, len(signal) - 1))
    first = ema(signal[:at], coefficient)
    second = ema(signal[at:], coefficient, before=first[-1])
    np.testing.assert_array_equal(np.concatenate([first, second]), ema(signal, coefficient))


@given(SIGNALS, st.floats(0.01, 0.99))
def test_the_ema_follows_its_recursion(signal, coefficient):
    expected = [signal[0]]
    for x in signal[1:]:
        expected.append(expected[-1] + coefficient * (x - expected[-1]))
    np.testing.assert_allclose(ema(signal, coefficient), expected, rtol=1e-9, atol=1e-9)


@given(SIGNALS, st.floats(0.01, 0.99))
def test_taxels_and_trials_are_smoothed_alone(one, coefficient):
    stacked = np.stack([one, one[::-1]])
    np.testing.assert_array_equal(ema(stacked, coefficient)[0], ema(one, coefficient))
    np.testing.assert_array_equal(ema(stacked, coefficient)[..., :1], ema(stacked[..., :1], coefficient))


def test_float32_stays_float32():
    signal = np.random.default_rng(0).normal(size=(2, 40, 3)).astype(np.float32)
    for changed in (ema(signal, 0.1), resample(signal, 100.0, 130.0)):
        assert changed.dtype == np.float32


@pytest.mark.parametrize("cutoff_Hz", [17.8, 30.0, 1000.0])
def test_a_cut_off_at_or_above_nyquist_is_refused(cutoff_Hz):
    with pytest.raises(InputError, match=r"ema_cutoff_Hz: .* is not below the Nyquist frequency of 17\.8 Hz"):
        condition(skin([np.ones((9, 1))], 35.6), ConditioningSpec(ema_cutoff_Hz=cutoff_Hz))


# --- resampling -------------------------------------------------------------------------------------


@given(SIGNALS, RATES)
def test_resampling_at_the_same_rate_changes_nothing(signal, rate_Hz):
    np.testing.assert_array_equal(resample(signal, rate_Hz, rate_Hz), signal)


@given(st.integers(1, 200), RATES, RATES, VALUES, VALUES)
def test_a_straight_line_stays_the_line_until_the_last_sample_holds(n_samples, rate_Hz, to_Hz, start, slope):
    line = start + slope * np.arange(n_samples)[:, None] / rate_Hz
    again = resample(line, rate_Hz, to_Hz)
    time_s = np.minimum(np.arange(len(again)) / to_Hz, (n_samples - 1) / rate_Hz)
    np.testing.assert_allclose(again[:, 0], start + slope * time_s, rtol=1e-9, atol=1e-7)


ANY_RATE = RATES | st.floats(10.0, 5000.0)


@given(st.integers(1, 500), ANY_RATE, ANY_RATE)
def test_a_trial_keeps_its_length(n_samples, rate_Hz, to_Hz):
    lasts = n_samples / rate_Hz * to_Hz
    n_steps = len(resample(np.zeros((n_samples, 1)), rate_Hz, to_Hz))
    if to_Hz >= rate_Hz:
        assert abs(n_steps - lasts) <= 0.5 + 2e-6
    else:  # a step at the last sample counts, even if less than half of it is left
        assert -0.5 - 2e-6 <= n_steps - lasts < 1.0
    assert (n_steps - 1) / to_Hz < n_samples / rate_Hz, "every step begins within the trial"
    assert n_steps / to_Hz > (n_samples - 1) / rate_Hz - 1e-9, "no step at or before the last sample is missing"


@given(st.integers(1, 500), ANY_RATE, ANY_RATE)
def test_a_window_as_long_as_the_trial_fits(n_samples, rate_Hz, to_Hz):
    length_ms = 1e3 * n_samples / rate_Hz
    assume(length_ms * 1e-3 * to_Hz >= 1.5)  # a trial of less may have two steps, and each is a window
    n_steps = conditioned_length(n_samples, rate_Hz, to_Hz)
    assert len(cut(np.array([n_steps]), to_Hz, WindowSpec(length_ms=length_ms))) == 1


@given(st.integers(1, 10**7), ANY_RATE, ANY_RATE)
def test_a_longer_trial_has_no_fewer_steps(n_samples, rate_Hz, to_Hz):
    assert conditioned_length(n_samples, rate_Hz, to_Hz) <= conditioned_length(n_samples + 1, rate_Hz, to_Hz)


@given(SIGNALS, st.integers(1, 9))
def test_a_whole_multiple_of_the_rate_keeps_every_sample(signal, times):
    np.testing.assert_allclose(resample(signal, 100.0, 100.0 * times)[::times], signal, rtol=1e-9, atol=1e-9)


def test_a_35_6_hz_skin_on_a_1_khz_clock_keeps_the_samples_of_common_instants():
    signal = np.random.default_rng(1).normal(size=(357, 16))
    again = resample(signal, 35.6, 1000.0)
    assert len(again) == 10_028  # 357 samples of 1 / 35.6 s are 10.028 s
    np.testing.assert_array_equal(again[10_000:], np.repeat(signal[-1:], 28, axis=0))
    np.testing.assert_allclose(again[::2500], signal[::89], atol=1e-10)  # 89 samples are 2.5 s


@given(SIGNALS, RATES, RATES)
def test_resampling_stays_between_the_extremes(signal, rate_Hz, to_Hz):
    again = resample(signal, rate_Hz, to_Hz)
    assert again.min() >= signal.min() - 1e-9
    assert again.max() <= signal.max() + 1e-9


def test_the_result_has_the_encoders_clock():
    felt = condition(skin([np.ones((36, 2)), np.ones((9, 2))], 35.6), ConditioningSpec(resample_Hz=1000.0))
    assert felt.sampling_rate_Hz == 1000.0
    assert [len(s) for s in felt.signals] == [1011, 253]


# --- baseline, standardisation, rectification -------------------------------------------------------


PAST = st.sampled_from(["start", "high-pass"])


def taken_off(signal, baseline, **options):
    return condition(skin([signal]), ConditioningSpec(baseline=baseline, **options)).signals[0]


@given(SIGNALS, PAST, st.integers(1, 50), st.data())
def test_a_baseline_of_the_past_knows_nothing_that_comes_after(signal, baseline, start_ms, data):
    at = data.draw(st.integers(1, len(signal) - 1))
    other = np.concatenate([signal[:at], data.draw(hnp.arrays(float, signal[at:].shape, elements=VALUES))])
    ours, theirs = (taken_off(x, baseline, start_ms=start_ms, high_pass_Hz=20.0) for x in (signal, other))
    np.testing.assert_array_equal(ours[:at], theirs[:at])


def test_the_mean_of_a_trial_knows_what_comes_after():
    signal = np.arange(6.0)[:, None]
    assert taken_off(signal, "mean")[0] != taken_off(np.r_[signal, [[50.0], [60.0]]], "mean")[0]


@given(SIGNALS, st.integers(1, 50))
def test_the_mean_of_the_start_is_the_mean_so_far_until_it_is_kept(signal, start_ms):
    level = np.stack([signal[: min(t + 1, start_ms)].mean(axis=0) for t in range(len(signal))])
    np.testing.assert_allclose(taken_off(signal, "start", start_ms=start_ms), signal - level, atol=1e-3)


BASELINES_OF_THE_PAST = ({"baseline": "start", "start_ms": 20.0}, {"baseline": "high-pass", "high_pass_Hz": 2.0})


@given(SIGNALS, RATES, st.sampled_from(BASELINES_OF_THE_PAST))
def test_a_baseline_counts_time_on_the_encoders_clock(signal, rate_Hz, how):
    """As if the signal had been recorded on that clock."""
    resampled = resample(signal, rate_Hz, 500.0)
    found = condition(skin([signal], rate_Hz), ConditioningSpec(resample_Hz=500.0, **how)).signals[0]
    expected = condition(skin([resampled], 500.0), ConditioningSpec(**how)).signals[0]
    np.testing.assert_allclose(found, expected, atol=1e-3)


@given(SIGNALS)
def test_the_start_lies_between_the_first_sample_and_the_mean_so_far(signal):
    signal = signal.astype(np.float32)
    np.testing.assert_array_equal(taken_off(signal, "start", start_ms=1.0), signal - signal[:1])
    so_far = signal.cumsum(axis=0, dtype=float) / np.arange(1, len(signal) + 1)[:, None]
    np.testing.assert_allclose(taken_off(signal, "start", start_ms=1e6), signal - so_far, atol=1e-3)


@given(SIGNALS, st.floats(0.1, 400.0))
def test_a_high_pass_is_what_the_ema_leaves(signal, cutoff_Hz):
    signal = signal.astype(np.float32)
    smooth = ema(signal, ema_coefficient(cutoff_Hz, 1000.0))
    np.testing.assert_array_equal(taken_off(signal, "high-pass", high_pass_Hz=cutoff_Hz), signal - smooth)


def test_a_high_pass_above_nyquist_is_refused_by_its_name():
    with pytest.raises(InputError, match="high_pass_Hz: 600 Hz is not below the Nyquist frequency of 500 Hz"):
        taken_off(np.ones((9, 1)), "high-pass", high_pass_Hz=600.0)


def test_the_baseline_is_that_of_each_taxel_of_each_trial():
    rng = np.random.default_rng(2)
    trials = [rng.normal(5.0, 1.0, (n, 3)).astype(np.float32) for n in (8, 8)]
    for signals in (trials, np.stack(trials)):
        felt = condition(skin(signals), ConditioningSpec(baseline="mean"))
        for signal, original in zip(felt.signals, trials, strict=True):
            np.testing.assert_allclose(signal, original - original.mean(axis=0), atol=1e-5)


def test_other_trials_are_standardised_by_the_training_trials():
    train, test = np.random.default_rng(3).normal([1.0, 50.0], [2.0, 5.0], (2, 4000, 2))
    offset, scale = (tuple(values.tolist()) for values in (train.mean(axis=0), train.std(axis=0)))
    felt = condition(skin([train, test]), ConditioningSpec(offset=offset, scale=scale))
    assert felt.unit == "sd"
    np.testing.assert_allclose(felt.signals[0].mean(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose(felt.signals[0].std(axis=0), 1.0, atol=1e-4)
    assert 1e-3 < np.abs(felt.signals[1].mean(axis=0)).max() < 0.1


@pytest.mark.parametrize("values", [{"offset": [1.0]}, {"scale": [1.0] * 3}, {"offset": [0.0] * 2, "scale": [1.0]}])
def test_offsets_of_another_sensor_are_refused(values):
    with pytest.raises(InputError, match=r"skin\.h5: has 2 channels but the encoder's conditioning has [13] offsets"):
        condition(skin([np.ones((9, 2))]), ConditioningSpec(**values))


def test_rectification_comes_last():
    felt = condition(skin([np.array([[0.0], [2.0]])]), ConditioningSpec(offset=[1.0], scale=[0.5], rectify=True))
    assert felt.signals[0].ravel().tolist() == [2.0, 2.0]


def test_smoothing_comes_before_resampling():
    signal = np.random.default_rng(4).normal(size=(20, 2))
    felt = condition(skin([signal], 100.0), ConditioningSpec(ema_cutoff_Hz=10.0, resample_Hz=1000.0))
    expected = resample(ema(signal.astype(np.float32), ema_coefficient(10.0, 100.0)), 100.0, 1000.0)
    np.testing.assert_array_equal(felt.signals[0], expected)


def test_nothing_asked_changes_nothing():
    touch = skin([np.ones((9, 2)), np.zeros((4, 2))])
    felt = condition(touch, ConditioningSpec())
    for one, other in zip(felt.signals, touch.signals, strict=True):
        np.testing.assert_array_equal(one, other)


def test_trials_stacked_or_listed_are_conditioned_alike():
    signals = np.random.default_rng(5).normal(size=(3, 30, 2)).astype(np.float32)
    how = ConditioningSpec(ema_cutoff_Hz=30.0, resample_Hz=1300.0, baseline="mean", rectify=True)
    stacked, listed = condition(skin(signals), how), condition(skin(list(signals)), how)
    for one, other in zip(stacked.signals, listed.signals, strict=True):
        np.testing.assert_array_equal(one, other)


# --- in pieces --------------------------------------------------------------------------------------

FLOAT32 = st.tuples(st.integers(1, 60), st.integers(1, 3)).flatmap(
    lambda shape: hnp.arrays(np.float32, shape, elements=st.floats(-1e3, 1e3, width=32) | st.just(-0.0))
)


@given(
    signal=FLOAT32, values=st.integers(1, 40), cutoff_Hz=st.none() | st.just(10.0), baseline=st.sampled_from(
        ["none", "mean", "start", "high-pass"]
    ), clock_Hz=st.none() | st.sampled_from([100.0, 1000.0, 35.6, 3.0, 99.0, 101.0]), is_scaled=st.booleans(),
    rectify=st.booleans(), unit=st.sampled_from(["mV", "V"]), n_steps=st.integers(1, 600),
)  # fmt: skip
def test_a_trial_conditioned_in_pieces_or_from_its_start_is_that_conditioned_whole(
    signal, values, cutoff_Hz, baseline, clock_Hz, is_scaled, rectify, unit, n_steps
):
    n_channels = signal.shape[1]
    options = {"ema_cutoff_Hz": cutoff_Hz, "resample_Hz": clock_Hz, "baseline": baseline, "rectify": rectify}
    if is_scaled:
        options |= {"offset": [0.3, -1.0, 2.0][:n_channels], "scale": [3.0, 0.1, 7.0][:n_channels]}
    touch, how = skin([signal], rate_Hz=100.0), ConditioningSpec(**options)
    with patch.object(conditioning, "PIECE_VALUES", values):
        whole = condition(touch.to_unit(unit), how).signals[0]
        pieces = list(condition_pieces(touch, 0, how, unit))
        start = list(condition_pieces(touch, 0, how, unit, n_steps))
    np.testing.assert_array_equal(np.concatenate(start), whole[:n_steps], strict=True)
    assert max(p.shape[0] for p in pieces) <= max(1, values // n_channels)
    assert len(whole) == conditioned_length(len(signal), 100.0, clock_Hz)
    np.testing.assert_array_equal(np.concatenate(pieces), whole, strict=True)


@pytest.mark.parametrize(
    ("baseline", "clock_Hz", "most"), [("start", None, 41), ("none", 200.0, 21), ("mean", None, 60)]
)
def test_of_a_trial_no_more_is_read_than_the_steps_need(baseline, clock_Hz, most, monkeypatch):
    read, piece = [], Recordings.piece
    monkeypatch.setattr(Recordings, "piece", lambda *call: read.append(call[3]) or piece(*call))
    touch = skin([np.ones((60, 2))], rate_Hz=100.0)
    list(condition_pieces(touch, 0, ConditioningSpec(baseline=baseline, resample_Hz=clock_Hz), n_steps=40))
    assert max(read) == most


@given(signal=FLOAT32, coefficient=st.floats(1e-4, 1), size=st.none() | st.integers(1, 7), is_begun=st.booleans())
def test_the_compiled_average_is_that_of_scipy_to_the_last_bit(signal, coefficient, size, is_begun):
    signals = signal if size is None else np.stack([signal * np.float32(k) for k in range(size)])[..., ::-1]
    before = np.float32(0.7) - signals[..., -1, :] if is_begun else None
    smooth = ema(signals, coefficient, before)
    with patch.object(conditioning, "native", None):
        np.testing.assert_array_equal(smooth, ema(signals, coefficient, before), strict=True)


def test_a_slower_clock_holds_no_more_of_the_signal_at_once(monkeypatch):
    touch = skin([np.ones((5000, 2))], rate_Hz=1000.0)
    held = []
    interpolated = conditioning.interpolated
    monkeypatch.setattr(conditioning, "PIECE_VALUES", 100)
    monkeypatch.setattr(conditioning, "interpolated", lambda x, *rest: held.append(len(x)) or interpolated(x, *rest))
    pieces = list(condition_pieces(touch, 0, ConditioningSpec(resample_Hz=10.0)))
    assert sum(map(len, pieces)) == 50
    assert max(held) <= 2 * 50


@given(signal=FLOAT32)
def test_a_short_trial_has_numpys_mean_and_a_long_one_that_of_float64(signal):
    pieces = conditioning._mean([signal])
    np.testing.assert_array_equal(pieces, signal.mean(axis=0, keepdims=True))
    with patch.object(conditioning, "PIECE_VALUES", signal.shape[1]):
        long = conditioning._mean([signal])
    expected = signal.mean(axis=0, keepdims=True, dtype=np.float64)
    np.testing.assert_allclose(long, expected, rtol=1e-6, atol=1e-30 if len(signal) == 1 else 1e-10)


def test_the_mean_of_a_long_trial_is_not_lost_beside_its_sum():
    """In float32, one and 2^25 is 2^25, however often it is added."""
    signal = np.ones((2**20, 2), np.float32)
    signal[0] = 2**25
    assert signal.mean(axis=0).tolist() == [32.0] * 2
    assert conditioning._mean([signal])[0].tolist() == pytest.approx([33.0] * 2, rel=1e-6)
