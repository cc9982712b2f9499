"""A spec's `model` decides its keys; LIF specs are what they were; every model goes the whole way."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.encoders.izhikevich import IzhikevichSpec
from neurotact_parts.encoders.poisson import PoissonSpec
from neurotact_parts.studies.texture.simulator import GratingsSpec, simulate

from neurotact import spec
from neurotact.data import conditioning
from neurotact.data.conditioning import condition
from neurotact.data.recordings import Recordings
from neurotact.encoders import specs
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.model import AnyEncoder, usable
from neurotact.errors import InputError
from neurotact.spec import Spec

NAMES = ("sa1-ra1-lif", *(name for name in usable() if name != "lif"))


class Part(Spec):
    """A spec that holds an encoder, as studies do."""

    encoder: AnyEncoder


def refusal(call) -> str:
    with pytest.raises(InputError) as error:
        call()
    assert "\n" not in str(error.value)
    return str(error.value)


def table(name: str, **changes) -> dict:
    return spec.override(specs.load(name).model_dump(mode="json", exclude_none=True), changes)


def test_the_model_chooses_the_spec():
    assert [type(specs.load(name)) for name in NAMES[:3]] == [AfferentSpec, IzhikevichSpec, PoissonSpec]


def test_a_spec_without_a_model_is_lif(tmp_path):
    lif = table("sa1-ra1-lif")
    del lif["model"]
    (tmp_path / "mine.toml").write_text(spec.to_toml(lif))
    assert specs.load(tmp_path / "mine.toml") == specs.load("sa1-ra1-lif")
    assert spec.build(Part, {"encoder": lif}, "a").encoder == specs.load("sa1-ra1-lif")


@pytest.mark.parametrize(
    ("name", "key", "meant"),
    [
        ("sa1-ra1-lif", "sa1.t_ref", "t_ref_ms"),
        ("izhikevich", "a_per_m", "a_per_ms"),
        ("izhikevich", "sa1.gain_mV", "gain_mV_per_ms"),
        ("poisson", "sed", "seed"),
        ("poisson", "ra1.gain_hz", "gain_Hz"),
        ("poisson", "conditioning.baselin", "baseline"),
    ],
)
def test_an_unknown_key_names_the_nearest_of_its_model(name, key, meant):
    wanted = f"{key}: unknown key; did you mean '{meant}'?"
    assert refusal(lambda: specs.load(name, {key: 1})).startswith(wanted)
    nested = refusal(lambda: spec.build(Part, {"encoder": table(name, **{key: 1})}, "study.toml"))
    assert nested == f"encoder.{wanted} (study.toml)"


def test_a_wrong_value_in_a_study_is_named_without_the_tag_of_its_model():
    message = refusal(lambda: spec.build(Part, {"encoder": table("poisson", **{"sa1.gain_Hz": 0})}, "study.toml"))
    assert message == "encoder.sa1.gain_Hz: must be > 0; got 0 (study.toml)"
    assert refusal(lambda: spec.build(Part, {"encoder": 5}, "study.toml")).startswith("encoder: must be a table; got 5")


def test_an_unknown_model_names_the_nearest():
    assert refusal(lambda: specs.load("poisson", {"model": "poison"})).startswith(
        "model: 'poison' is unknown; did you mean 'poisson'?"
    )
    nested = refusal(lambda: spec.build(Part, {"encoder": {"model": "poison"}}, "study.toml"))
    assert nested == "encoder.model: 'poison' is unknown; did you mean 'poisson'? (study.toml)"


def test_the_state_of_another_encoder_is_refused():
    signal = np.zeros((1, 4, 1))
    _, state = specs.encode(signal, 2000.0, specs.load("poisson"))
    assert "PoissonState, of another encoder" in refusal(
        lambda: specs.encode(signal, 2000.0, specs.load("izhikevich"), state)
    )


def touched(n_trials: int = 6) -> Recordings:
    wave = 12 * np.sin(np.arange(800) / 40)[None, :, None] * np.linspace(0.5, 1, n_trials)[:, None, None]
    noise = np.random.default_rng(0).normal(0, 0.3, (n_trials, 800, 2))
    return Recordings((wave + noise).astype(np.float32), 2000.0, "mV", pd.DataFrame({"label": ["a", "b"] * 3}))


@pytest.mark.parametrize("name", NAMES)
def test_chunks_of_trials_do_not_show(name, monkeypatch):
    whole = encode_recordings(touched(), specs.load(name))
    monkeypatch.setattr(conditioning, "PIECE_VALUES", 2000)
    chunked = encode_recordings(touched(), specs.load(name))
    assert sum(map(len, whole.steps)) > 20
    assert whole.encoder["model"] == specs.load(name).model
    for a, b in zip(whole.steps + whole.units, chunked.steps + chunked.units, strict=True):
        assert np.array_equal(a, b)


FITTED = [
    pytest.param(name, marks=[pytest.mark.thorough] if name == "bens-spiker" else [])
    for name in NAMES
    if name not in ("sa1-ra1-lif", "mechanoreceptor")
]


@pytest.mark.parametrize("name", FITTED)
def test_shipped_gains_and_thresholds_give_the_spikes_of_lif_on_the_gratings(name, gratings_felt):
    """Each population by itself, where each has a gain."""
    felt, lif = gratings_felt
    spikes = specs.encode(felt, 2000.0, specs.load(name))[0][:, 500:].sum(axis=(0, 1), dtype=int)
    parts = [list(counts) for counts in (spikes.reshape(2, -1).sum(axis=1), lif.reshape(2, -1).sum(axis=1))]
    found, expected = parts if specs.populations(specs.load(name))[0].part else map(sum, parts)
    assert found == pytest.approx(expected, rel=0.1)


@pytest.fixture(scope="module")
def gratings_felt():
    """Conditioned gratings, and the spikes of each LIF afferent."""
    lif = specs.load("sa1-ra1-lif")
    felt = condition(simulate(GratingsSpec(trials=2)), lif.conditioning).signals
    return felt, specs.encode(felt, 2000.0, lif)[0][:, 500:].sum(axis=(0, 1), dtype=int)


@pytest.mark.parametrize("start", ["sa1-ra1-lif", specs.load("sa1-ra1-lif")])
@pytest.mark.parametrize(("key", "baseline"), [("high_pass_Hz", "high-pass"), ("start_ms", "start")])
def test_a_key_that_its_baseline_ignores_is_refused(start, key, baseline):
    changes = {f"conditioning.{key}": 2.0}
    with pytest.raises(InputError, match=rf"^conditioning\.{key}: the baseline 'mean' ignores it; .*={baseline}, too"):
        specs.resolve(start, changes)
    heeded = specs.resolve(start, {**changes, "conditioning.baseline": baseline})
    assert getattr(heeded.conditioning, key) == 2.0
