"""The table of executors holds: what it calls equal spikes as the reference does, and what it refuses is refused."""

from dataclasses import replace
from importlib.metadata import EntryPoint
from typing import Literal

import numpy as np
import pandas as pd
import pytest
import torch
from compiled import chosen, given_to
from compiled import compare as compare_in_c
from made_chains import READOUTS, make_chain, make_encoder, make_signal, offline, told, unequal_stretches
from neurotact_parts.encoders.send_on_delta import SendOnDeltaSpec
from neurotact_parts.exporters.c import c_export, proof
from neurotact_parts.exporters.nir import compare, note
from neurotact_parts.exporters.snntorch import to_snntorch
from neurotact_parts.streams.chain import WITHOUT_END, Chain, chain_of
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact import plugins
from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.recordings import Recordings
from neurotact.encoders import afferents, closed_form
from neurotact.encoders.afferents import AfferentSpec, AfferentType
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import EncoderSpec, usable
from neurotact.encoders.specs import is_exact, load, n_afferents
from neurotact.errors import InputError
from neurotact.networks.definition import module
from neurotact.networks.definition.executors import (
    EVENTS,
    EXECUTORS,
    FEATURES,
    IN_TIME,
    LAYERS,
    NO_LAYER,
    OF_ANOTHER_PACKAGE,
    OTHER,
    PAST,
    SETTINGS,
    SETTLED,
    Subject,
    require,
)
from neurotact.networks.definition.parts import NetworkPart
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training.events import DetectorSpec
from neurotact.spec import Spec

MODELS = usable()
TAXELS, CLASSES, RATE_Hz = 2, 3, 1000.0
CONDITIONED = {
    "moving average": {"ema_cutoff_Hz": 30.0},
    "resampling": {"resample_Hz": RATE_Hz},
    "baseline of the past": {"baseline": "start", "start_ms": 20.0},
    "baseline of the whole trial": {"baseline": "mean"},
    "standardisation": {"offset": [0.5] * TAXELS, "scale": [0.9] * TAXELS},
    "rectification": {"rectify": True},
    "membranes in closed form": {"resample_Hz": RATE_Hz, "baseline": "start"},
}
ENCODED = {
    "several grades a taxel": {"sa1.grades": [0.5, 1.0]},
    "SA-I of the falling signal": {"sa1.opposite": True},
    "afferents under some taxels": {"sa1.taxels": [1], "sa1.grades": [0.5, 1.0], "recorded_taxels": ["a", "b"]},
    "half-wave rate of change": {"ra1.change": "both"},
    "rise in SA-I": {"sa1.rate_ms": 20.0},
    "membranes in closed form": {"integration": "exact"},
}
NETWORKS = {
    "clock of the network": {"step_ms": 3.0},
    "clock slower than its encoder's": {"step_ms": 3.0},
    "recurrence": {"model": "rsnn"},
    "recurrence in blocks": {"recurrent_blocks": 3},
    "recurrent delay": {"recurrent_delay_steps": 1},
    "membrane eq4": {"membrane": "eq4"},
    "membrane delayed": {"membrane": "delayed"},
    "membrane immediate": {"membrane": "immediate"},
    "reset zero": {"reset": "zero"},
    "reset subtract": {"reset": "subtract"},
    "reset hard": {"reset": "hard"},
    "adaptive thresholds": {"threshold_adaptation": 0.3, "tau_adaptation_ms": 12.0},
    "learned constants": {"learn": ["alpha", "beta", "threshold"]},
    "another surrogate": {"surrogate": "arctan"},
    OTHER: {},
    LAYERS: {},
    "double precision": {},
    "readout count": READOUTS["count"],
    "readout integrator": READOUTS["integrator"],
    "readout that leaks": READOUTS["leaky"],
    "readout max": READOUTS["max"],
    "readout of stretches": READOUTS["stretches"],
    NO_LAYER: {**READOUTS["integrator"], "hidden": 0},
    PAST: {**READOUTS["integrator"], "direct": True},
    IN_TIME: READOUTS["integrator"],
    SETTLED: READOUTS["integrator"],
}
RULES = {
    "exit by patience": ExitRule(5, from_first_spike=True),
    SETTLED: ExitRule(5, from_first_spike=True, band=(1.0, 2.0, 3.0)),
    "none of these": ExitRule(5, from_first_spike=True, least_lead=2.0),
}


class MineSpec(SendOnDeltaSpec):
    model: Literal["mine"] = "mine"  # pyright: ignore[reportIncompatibleVariableOverride]


MINE = MODELS["send-on-delta"]._replace(spec=MineSpec)


class NoKeys(Spec):
    """Of a network without any."""


STRANGER = NetworkPart("weights alone", NoKeys, lambda keys, sizes: torch.nn.Linear(sizes.n_inputs, sizes.n_classes))


@pytest.fixture(autouse=True)
def _models_of_another_package(monkeypatch):
    point = EntryPoint("mine", f"{__name__}:MINE", "neurotact.encoders")
    monkeypatch.setitem(plugins._found("encoders"), "mine", [point])
    point = EntryPoint("stranger", f"{__name__}:STRANGER", "neurotact.networks")
    monkeypatch.setitem(plugins._found("networks"), "stranger", [point])


def parts_with(feature: str) -> tuple[EncoderSpec | None, nt.RSNN, ExitRule]:
    """A small chain that has the feature, and spikes enough to decide."""
    encoder = make_encoder(ENCODED.get(feature), **CONDITIONED.get(feature, {"baseline": "start"}))
    models = {row.title: model for model, row in MODELS.items() if model != "lif"}
    if feature in models:
        encoder = load(models[feature], {"conditioning.baseline": "start"})
        own = encoder.conditioning.model_copy(update={"resample_Hz": None})
        encoder = encoder.model_copy(update={"conditioning": own})
    if feature == OF_ANOTHER_PACKAGE:
        encoder = MineSpec(threshold=1.0)
    n_inputs = n_afferents(encoder, TAXELS)
    encoder = None if feature == EVENTS else encoder
    scales = {} if feature == NO_LAYER else {"forward_weight_scale": 3.0, "recurrent_weight_scale": 0.4}
    settings = {"hidden": 6, **scales, **NETWORKS.get(feature, {})}
    network = nt.RSNN(
        n_inputs, CLASSES, sampling_rate_Hz=RATE_Hz, generator=torch.Generator().manual_seed(0),
        dtype=torch.float64 if feature == "double precision" else torch.float32, **settings,
    )  # fmt: skip
    if feature in (OTHER, LAYERS):
        spec = RSNNSpec(hidden=[6, 4]) if feature == LAYERS else RSNNSpec(model="stranger")
        network = module.new(n_inputs, CLASSES, spec, RATE_Hz, generator=torch.Generator().manual_seed(0))
    else:
        unequal_stretches(network)
    return encoder, network, RULES.get(feature, FULL_WINDOW)


def chain_with(feature: str) -> Chain:
    encoder, network, rule = parts_with(feature)
    given_Hz = (
        None if feature == EVENTS else 400.0 if feature in ("resampling", "membranes in closed form") else RATE_Hz
    )
    chain = chain_of((encoder, network), nt.Streamed(sampling_rate_Hz=given_Hz, length_ms=40))._replace(rule=rule)
    if feature == IN_TIME:
        assert network.bias is not None
        with torch.no_grad():
            network.bias[0] = -3.0  # another label comes into force
        return chain._replace(detector=DetectorSpec(threshold=0, steps=1), windows=WITHOUT_END)
    return chain


def subject_with(feature: str) -> Subject:
    return Subject(*parts_with(feature), feature == IN_TIME)


def windows(n_inputs: int) -> torch.Tensor:
    return torch.from_numpy((np.random.default_rng(0).random((4, 50, n_inputs)) < 0.3).astype(np.uint8))


def in_native(feature: str) -> None:
    encoder, network, rule = parts_with(feature)
    if isinstance(encoder, AfferentSpec):
        signal = np.stack([make_signal(80, TAXELS)])
        encode = closed_form.encode if is_exact(encoder) else afferents.encode
        rasters = [encode(signal, RATE_Hz, encoder, backend=backend)[0] for backend in ("native", "reference")]
        np.testing.assert_array_equal(rasters[0], rasters[1])
        assert rasters[0].any()
    found = []
    for backend in ("native", "reference"):
        network.backend = backend
        found.append(network.infer(windows(network.n_inputs), rule))
    assert (found[0].hidden_spikes.sum() > 0) == (feature not in (NO_LAYER, OTHER))  # a stranger counts none
    for ours, theirs in zip(found[0][:4], found[1][:4], strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=0, equal_nan=True)


def in_a_stream(feature: str) -> None:
    if feature == IN_TIME:
        return  # tests/stream/test_detector.py
    chain = chain_with(feature)
    signal = given_to(chain, 150)
    for backend in ("auto", "reference"):
        _, expected = offline(chain, signal)
        stream = Stream(chain, backend=backend)
        if chain.takes_events:
            steps, units = np.nonzero(signal)
            decided = told([*stream.push_events(steps / RATE_Hz, units), *stream.advance(0.15)])
        else:
            decided = told(stream.decide([signal]))
        assert expected
        assert decided[: len(expected)] == expected


def in_c(feature: str, tmp_path, *, integer: bool) -> None:
    chain = chain_with(feature)
    formats = chosen(chain, [given_to(chain, 150, seed=k) for k in range(2)]) if integer else None
    difference, expected = compare_in_c(chain, tmp_path / "c", formats, n=1, flags=("-O0",))
    assert difference is None
    assert expected[0].decisions


def in_nir(feature: str) -> None:
    encoder, network, _ = parts_with(feature)
    if feature == "clock of the network":
        binned = network.binned(windows(network.n_inputs)).numpy()
        found = compare.report(network.on_own_clock(), nt.to_nir(network), binned)
        assert found["differing"].tolist() == [0] * len(found)
        return
    if feature == EVENTS:
        spikes = windows(network.n_inputs).numpy()
        found = compare.report(network, nt.to_nir((encoder, network)), spikes)
        assert found["differing"].tolist() == [0] * len(found)
        return
    graph = nt.to_nir((encoder, network), lower_refractory=True)
    conditioned = np.stack([make_signal(80, TAXELS)])
    assert isinstance(encoder, AfferentSpec)
    raster = afferents.encode(conditioned, RATE_Hz, encoder)[0]
    found = compare.report(network, graph, raster, conditioned=conditioned, encoder=encoder)
    assert found["differing"].tolist() == [0] * len(found)


def in_snntorch(feature: str) -> None:
    _, network, _ = parts_with(feature)
    with torch.no_grad():
        hidden, readout = to_snntorch(network)(windows(network.n_inputs))
        expected = network.simulate(windows(network.n_inputs))
    assert expected.hidden.any()
    torch.testing.assert_close(hidden, expected.hidden.float())
    given = expected.readout
    if network.integration is not None:
        given = torch.stack([*network.integration.detach().over(given)], dim=1)
    torch.testing.assert_close(readout.float(), given.float())


def executed(executor: str, feature: str, tmp_path) -> None:
    runs = {
        "native": in_native,
        "stream": in_a_stream,
        "nir": in_nir,
        "snntorch": in_snntorch,
    }
    if executor.startswith("c-"):
        in_c(feature, tmp_path, integer=executor == "c-integer")
    else:
        runs[executor](feature)


def export(executor: str, feature: str, folder) -> None:
    encoder, network, rule = parts_with(feature)
    if executor == "native":
        network.infer(windows(network.n_inputs), rule)  # by the reference, unless kernels are asked for
        network.backend = "native"
        network.infer(windows(network.n_inputs), rule)
    elif executor.startswith("nir"):
        nt.to_nir((encoder, network), plain=executor == "nir-plain")
    elif executor == "snntorch":
        to_snntorch(network)
    else:
        chain = chain_with(feature)
        formats = chosen(chain, [make_signal(90)]) if executor == "c-integer" else None
        c_export.write(chain, folder, formats, name="c")


def pairs(*, refused: bool):
    for name, executor in EXECUTORS.items():
        marks = [pytest.mark.slow] if name.startswith("c-") and not refused else []
        for feature, how in FEATURES.items():
            lacks = feature in executor.lacks
            if (
                feature not in executor.leaves
                and lacks == refused
                and how.part in executor.parts
                and (refused or executor.is_equal)
            ):
                yield pytest.param(name, feature, marks=marks)


@pytest.mark.parametrize(("executor", "feature"), [p for p in pairs(refused=False) if p.values[0] != "reference"])
def test_what_the_table_calls_equal_spikes_as_the_reference(executor, feature, tmp_path):
    if executor in ("c-float", "c-integer") and proof.missing("cc"):
        pytest.skip("there is no C compiler")
    if executor == "nir":
        pytest.importorskip("nir")
    executed(executor, feature, tmp_path)


@pytest.mark.parametrize(
    ("executor", "feature"), [(name, feature) for name, executor in EXECUTORS.items() for feature in executor.leaves]
)
def test_what_stays_outside_is_said_and_the_rest_spikes_as_the_reference(executor, feature, caplog):
    pytest.importorskip("nir")
    encoder, network, _ = parts_with(feature)
    graph = nt.to_nir((encoder, network), plain=executor == "nir-plain")
    why = f"the encoder ({feature}: {EXECUTORS[executor].what} does not run it: {EXECUTORS[executor].leaves[feature]})"
    assert [record.message.count(why) for record in caplog.records] == [1]
    said = note.of(graph, "graph")
    assert said is not None
    assert said.outside[0].startswith(why)
    assert "afferents" not in graph.nodes
    if executor == "nir":
        binned = network.binned(windows(network.n_inputs)).numpy()
        found = compare.report(network.on_own_clock(), graph, binned)
        assert found["differing"].tolist() == [0] * len(found)
        back = nt.from_nir(graph)
        assert back.network.steps_per_bin == network.steps_per_bin
        assert back.network.sampling_rate_Hz == network.sampling_rate_Hz
        assert feature == OF_ANOTHER_PACKAGE or back.encoder == encoder


@pytest.mark.slow
@pytest.mark.parametrize("integer", [False, True])
@pytest.mark.parametrize(
    "chosen_taxels",
    [{"sa1.taxels": [], "ra1.taxels": [3]}, {"sa1.taxels": [1, 4], "ra1.taxels": []},
     {"sa1.taxels": [4], "ra1.taxels": [1, 3], "sa1.opposite": True}],
)  # fmt: skip
def test_c_does_not_look_at_taxels_that_no_afferent_uses(chosen_taxels, integer, tmp_path):
    if proof.missing("cc"):
        pytest.skip("there is no C compiler")
    how = {"baseline": "start", "ema_cutoff_Hz": 60.0, "offset": [0.1, 0.2, 0.3, 0.4, 0.5], "scale": [1, -2, 1, 3, 2]}
    chain = make_chain(
        {**how, "resample_Hz": 1000.0}, rate_Hz=400.0, n_taxels=5,
        afferents={**chosen_taxels, "recorded_taxels": [*"abcde"]},
    )  # fmt: skip
    formats = chosen(chain, [make_signal(150, 5, seed=k) for k in range(2)]) if integer else None
    difference, expected = compare_in_c(chain, tmp_path / "c", formats, n=2, flags=("-O0",))
    assert difference is None
    assert expected[0].decisions


@pytest.mark.parametrize(("executor", "feature"), list(pairs(refused=True)))
def test_what_the_table_refuses_is_refused_with_its_reason(executor, feature, tmp_path):
    encoder, *_ = parts_with(feature)
    if executor == "native" and FEATURES[feature].part == "encoder":  # nothing chooses a backend for these models
        assert feature == OF_ANOTHER_PACKAGE or "backend" not in MODELS[encoder.model].encode.__annotations__
        return
    reason = EXECUTORS[executor].lacks[feature]
    with pytest.raises(InputError) as refused:
        require(executor, subject_with(feature))
    assert reason in str(refused.value)
    assert FEATURES[feature].instead in str(refused.value)
    with pytest.raises(InputError, match=feature):
        export(executor, feature, tmp_path)


def test_a_detector_in_integers_is_told_what_runs_it_and_no_other_readout():
    leaks = subject_with("readout that leaks")._replace(detects=True)
    with pytest.raises(InputError, match=rf"^{IN_TIME}: .*; export it in float32$"):
        require("c-integer", leaks)
    require("c-float", leaks)


@pytest.mark.parametrize("feature", FEATURES)
def test_a_feature_is_seen_where_it_is_and_the_reference_runs_it(feature):
    encoder, network, rule = parts_with(feature)
    assert FEATURES[feature].present(subject_with(feature))
    if encoder is not None:
        signal = Recordings([make_signal(80, TAXELS)], RATE_Hz, "mV", pd.DataFrame({"label": ["a"]}))
        trains = encode_recordings(replace(signal, unit=encoder.unit), encoder)
        assert trains.trial_steps[0] > 0
    network.backend = "reference"
    assert len(network.infer(windows(network.n_inputs), rule).labels) == 4


def test_every_key_of_a_spec_is_in_the_table():
    """A new key is a feature, or a size, a constant or a way of training."""
    known = SETTINGS.union(*(feature.keys for feature in FEATURES.values()))
    for spec in (RSNNSpec, AfferentSpec, AfferentType, ConditioningSpec):
        assert set(spec.model_fields) <= known, spec.__name__


def test_what_an_executor_lacks_is_a_feature_of_a_part_that_it_runs():
    for name, executor in EXECUTORS.items():
        for feature in (*executor.lacks, *executor.leaves):
            assert FEATURES[feature].part in executor.parts, (name, feature)
        assert executor.lacks.keys().isdisjoint(executor.leaves)
