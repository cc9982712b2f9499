"""What the spikes of an encoder stand for, and what survives it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from levels import thinned
from neurotact_parts.encoders.decoding import decode
from neurotact_parts.encoders.survival import survival

import neurotact as nt
from neurotact.data.recordings import Recordings
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import usable
from neurotact.encoders.specs import default_of, encode, load
from neurotact.errors import InputError

FINE = {
    "send-on-delta": {"threshold": 1.0, "t_ref_ms": 0},
    "step-forward": {"threshold": 0.3},
    "moving-window": {"threshold": 0.05, "window_ms": 1.0},
    "sigma-delta": {"threshold_unit_ms": 12.0},
    "bens-spiker": {"gain": 0.08, "filter_ms": 25.0},
}


def wave(n_steps=2000):
    """A slow sine of amplitude 10."""
    return 10 * np.sin(2 * np.pi * 3 * np.arange(n_steps) / 1000).reshape(1, -1, 1)


@pytest.mark.parametrize("model", FINE)
def test_a_fine_encoder_is_decoded_to_its_signal(model):
    encoder, signal = load(model, FINE[model]), wave()
    decoded = decode(encode(signal, 1000.0, encoder)[0], 1000.0, encoder)
    middle = slice(200, 1800)
    found, true = decoded[0, middle, 0], signal[0, middle, 0]
    assert np.corrcoef(found, true)[0, 1] > 0.98
    if model != "moving-window":  # whose events are not all of one size
        assert found.std() == pytest.approx(true.std(), rel=0.12)


@pytest.mark.parametrize("changes", [{}, {"integration": "exact"}])
def test_what_survives_is_of_the_spikes_that_encoding_gives(changes):
    encoder = load("sa1-ra1-lif", {"conditioning": {"baseline": "none", "resample_Hz": 2000.0}, **changes})
    felt, trains = survival._felt(touches(4), encoder), encode_recordings(touches(4), encoder)
    for raster, steps, units in zip(felt.spikes, trains.steps, trains.units, strict=True):
        np.testing.assert_array_equal(np.argwhere(raster), np.c_[steps, units])


def test_the_models_whose_spikes_have_a_meaning_are_those():
    assert {name for name, model in usable().items() if model.decode} == set(FINE)


def test_a_model_without_a_decoder_is_refused_with_the_filter_that_decodes_any():
    with pytest.raises(InputError, match=r"spikes of 'burst' have no meaning.*nt\.what_survives"):
        decode(np.zeros((1, 10, 4), np.uint8), 1000.0, load("burst"))


def touches(n_trials=24):
    rng, time_s = np.random.default_rng(0), np.arange(600)[:, None] / 1000
    signals = [
        20 * np.sin(2 * np.pi * f * time_s + rng.uniform(0, 6, 3)).astype(np.float32)
        for f in np.tile([2.0, 11.0], n_trials // 2)
    ]
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": ["slow", "fast"] * (n_trials // 2)}))


@thinned("model", [model for model in usable() if model != "mechanoreceptor"], every=3)
def test_what_survives_is_measured_for_every_model(model):
    encoder = load(default_of(model))
    found = survival.survival_of(touches(), encoder)
    assert repr(found) == f"Survival({found})"
    whole = found.table.iloc[-1]
    assert found.table.population.tolist()[-1] == "all"
    assert len(found.table) == 3
    assert whole.spikes_per_s == pytest.approx(found.table.spikes_per_s[:2].mean())
    assert whole.snr_dB > -1  # on other trials, of which there are few
    assert np.isnan(whole.own_snr_dB) == (model not in FINE)
    assert whole.energy_nJ_per_s > 0
    assert found.shown.signal.std() > 0.5
    assert "dB of the signal" in str(found)


def test_a_finer_threshold_lets_more_survive():
    snr_dB = [
        survival.survival_of(touches(), load("step-forward", {"threshold": threshold})).table.own_snr_dB.iloc[-1]
        for threshold in (12.0, 3.0)
    ]
    assert snr_dB[0] < 8 < snr_dB[1]


def test_taxels_in_another_order_change_nothing_that_survives():
    """The offsets and scales of an encoder are of named taxels."""
    named = replace(touches(), channels=("left", "middle", "right"))
    how = {"offset": range(named.n_channels), "scale": range(1, 1 + named.n_channels), "taxels": named.channels}
    encoder = load("step-forward", {f"conditioning.{key}": [*values] for key, values in how.items()})
    back = [*reversed(range(named.n_channels))]
    found, turned = (nt.what_survives(each, encoder).table for each in (named, named.of_taxels(back)))
    pd.testing.assert_frame_equal(found, turned)


def test_one_class_is_refused():
    alone = touches(8).select(np.arange(0, 8, 2))
    with pytest.raises(InputError, match="hold one class"):
        survival.survival_of(alone, load("burst"))


def test_keywords_choose_the_encoder_the_trials_and_the_draw(monkeypatch):
    monkeypatch.setattr(survival, "PER_CLASS", 6)
    felt = touches(24)
    skin = Recordings(felt.signals, 1000.0, "mV", felt.conditions.assign(day=np.repeat([1, 2, 3], 8)))
    usual = nt.what_survives(skin, encoder="step-forward")
    changes = (
        {"settings": {"threshold": 3.0}},
        {"where": {"day": [1, 2]}},
        {"leave_out": {"day": 2}},
        {"seed": 1},
    )
    for change in changes:
        found = nt.what_survives(skin, encoder="step-forward", **change)
        assert not found.table.equals(usual.table), change
    assert nt.plot_survival(found=usual).axes
    with pytest.raises(InputError, match=r"found: must be Survival; got DataFrame; nt\.what_survives returns it"):
        nt.plot_survival(usual.table)
