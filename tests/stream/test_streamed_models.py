"""Streams of every causal encoder model: the decisions of whole trials, and a saved state goes on."""

import numpy as np
import pytest
import torch
from made_chains import make_signal, offline, told
from neurotact_parts.streams.chain import Chain, chain_of
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.encoders.model import usable
from neurotact.encoders.specs import default_of, load, n_afferents
from neurotact.errors import InputError
from neurotact.networks.definition.executors import EXECUTORS
from neurotact.networks.definition.rsnn import RSNN

STREAMED = [model for model, row in usable().items() if row.title not in EXECUTORS["stream"].lacks]
LIVELY = {
    "send-on-delta": {"threshold": 0.5},
    "sigma-delta": {"threshold_unit_ms": 10.0},
    "step-forward": {"threshold": 0.5},
    "moving-window": {"threshold": 0.5, "window_ms": 7.0},
    "bens-spiker": {"gain": 0.1, "filter_ms": 10.0},
    "latency": {"cycle_ms": 20.0, "sa1.gain": 0.3},
    "burst": {"cycle_ms": 45.0, "sa1.gain": 0.3},
    "resonate-and-fire": {"low.gain_per_ms": 0.3},
    "mechanoreceptor": {"sa1.gain": 1.0},
}
"""Settings that make a signal of a few mV fire."""


def chain_of_model(model: str) -> Chain:
    changes = {"conditioning.baseline": "start", "conditioning.resample_Hz": 1000.0, **LIVELY.get(model, {})}
    encoder = load(default_of(model), changes)
    network = RSNN(
        n_afferents(encoder, 2), 3, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0), hidden=6,
        forward_weight_scale=3.0,
    )  # fmt: skip
    return chain_of((encoder, network), nt.Streamed(sampling_rate_Hz=400.0, length_ms=40))


@pytest.mark.parametrize("model", STREAMED)
def test_a_stream_decides_as_whole_trials_do_and_a_saved_state_goes_on(model, tmp_path):
    chain, signal = chain_of_model(model), make_signal(90)
    raster, expected = offline(chain, signal)
    assert raster.any()
    stream, resumed = Stream(chain), Stream(chain)
    first = stream.push(signal[:37])
    stream.save(tmp_path / "state")
    resumed.load(tmp_path / "state")
    for each in (stream, resumed):
        rest = [*each.push(signal[37:60]), *each.push(signal[60:]), *each.finish()]
        assert told(first + rest)[: len(expected)] == expected


def test_a_running_stream_changes_only_the_keys_of_its_model():
    stream = Stream(chain_of_model("send-on-delta"))
    stream.push(make_signal(40))
    other = load("step-forward", {"conditioning.baseline": "start", "conditioning.resample_Hz": 1000.0})
    with pytest.raises(InputError, match="unit, model or taxels"):
        stream.changed(encoder=other)
    wider = stream.changed(encoder=stream.chain.encoder.model_copy(update={"threshold": 1e6}))
    assert sum(decision.input_spikes for decision in wider.push(np.cumsum(make_signal(400), axis=0))[1:]) == 0


def test_programs_of_lif_afferents_refuse_another_model_by_its_name():
    with pytest.raises(InputError, match="must have LIF afferents here; its model is 'burst'"):
        _ = chain_of_model("burst").lif
