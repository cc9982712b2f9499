"""The signals before any spike, and the same drive at several refractory periods."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from lif_intervals import lif_isi_steps
from neurotact_parts.studies.texture.same_drive import SameDriveSpec, same_drive_table, threshold_gap
from neurotact_parts.studies.texture.signals import principal_frequency, signal_table
from neurotact_parts.studies.texture.simulator import GratingsSpec, simulate

from neurotact.data.recordings import Recordings
from neurotact.encoders.afferents import AfferentSpec
from neurotact.spec import load

ENCODER = load(AfferentSpec, "sa1-ra1-lif")
RATE_Hz = 2000.0


@given(st.floats(2.0, 12.0), st.floats(0.0, 6.2), st.floats(-50.0, 50.0))
@examples(40)
def test_the_principal_frequency_is_that_of_a_sine_whatever_its_phase_and_level(frequency, phase, level):
    time_s = np.arange(2000) / RATE_Hz
    signal = level + np.sin(2 * np.pi * frequency * time_s + phase)
    assert principal_frequency([signal], RATE_Hz) == pytest.approx(frequency, abs=0.35)


@pytest.fixture(scope="module")
def touch():
    return simulate(GratingsSpec(trials=4, start="random", pitches_mm=(4.0, 1.0), forces_N=(3.0, 12.0)))


def test_the_table_has_a_row_a_class_and_condition_and_the_pace_of_the_ridges(touch):
    table = signal_table(touch, ENCODER, ["force_N", "speed_mm_per_s"], 250.0)
    assert len(table) == 8
    np.testing.assert_allclose(table.principal_Hz, GratingsSpec().speed_factor * table.expected_Hz, atol=0.3)
    assert (table.groupby("force_N").peak_mV.mean().diff().dropna() > 0).all()


def test_twice_the_signal_is_twice_the_peak_at_the_same_frequency(touch):
    twice = Recordings(2 * touch.signals, touch.sampling_rate_Hz, touch.unit, touch.conditions)
    before, after = (signal_table(each, ENCODER, ["force_N"], 250.0) for each in (touch, twice))
    np.testing.assert_allclose(after.peak_mV, 2 * before.peak_mV, rtol=1e-5)
    assert after.principal_Hz.tolist() == before.principal_Hz.tolist()


def test_signals_of_other_touch_have_no_pace_of_ridges():
    skin = Recordings(np.ones((2, 800, 3)), RATE_Hz, "mV", pd.DataFrame({"label": ["felt", "silk"]}))
    assert list(signal_table(skin, ENCODER, [], 0.0).columns) == ["label", "peak_mV", "principal_Hz"]


@pytest.fixture(scope="module")
def same(touch):
    return same_drive_table(touch, ENCODER, SameDriveSpec(trials=3), 250.0)


def test_a_constant_drive_fires_as_its_closed_form_says(same):
    rows = same[same.drive == "constant"].set_index("t_ref_ms")
    for t_ref_ms, row in rows.iterrows():
        neuron = ENCODER.neuron(ENCODER.sa1.model_copy(update={"t_ref_ms": t_ref_ms}), RATE_Hz)
        interval = lif_isi_steps(neuron, row.peak_mV)
        first = interval - neuron.refractory_steps  # the first spike waits for no refractory period
        assert row.spikes == 1 + (2000 - first) // interval


def test_every_drive_reaches_the_published_count_and_loses_spikes_with_the_period(same):
    for _, rows in same.fillna("").groupby(["drive", "label"]):
        counts = rows.sort_values("t_ref_ms").spikes.tolist()
        assert 38 <= counts[0] < 45
        assert counts[0] > counts[1] > counts[2] > 0
        assert rows.peak_mV.iloc[0] >= threshold_gap(ENCODER)


def test_a_drive_that_cannot_fire_so_often_is_left_out(touch):
    table = same_drive_table(touch, ENCODER, SameDriveSpec(spikes=1800, trials=1), 250.0)
    assert table.empty
    assert list(table.columns) == ["drive", "label", "t_ref_ms", "peak_mV", "spikes"]
