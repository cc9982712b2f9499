"""What chips ask of a network: the limits that a network keeps, and those that it breaks, by name."""

import math

import pytest
import torch
from neurotact_parts.exporters import chips

from neurotact.encoders.specs import load
from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule

FITTING_TAU_ms = -1 / math.log(1 - 2.0**-4) / 2.0
MADE_FOR_XYLO = {
    "membrane": "immediate", "reset": "subtract", "tau_mem_ms": FITTING_TAU_ms, "tau_syn_ms": FITTING_TAU_ms,
    "hidden": 24,
}  # fmt: skip


def broken(target: str, rule=FULL_WINDOW, encoder=None, n_inputs=16, n_classes=8, **spec) -> dict[str, str]:
    network = RSNN(n_inputs, n_classes, sampling_rate_Hz=2000.0, **spec)
    found = chips.compare(network, encoder, rule, target)
    assert (found["cost"] != "").equals(~found["fits"])
    return {row.what: row.cost for row in found.itertuples() if not row.fits}


def test_a_network_made_for_xylo_fits_but_for_the_front_end():
    assert list(broken("xyloaudio2", **MADE_FOR_XYLO)) == ["conditioning and afferents"]


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("inputs", {"n_inputs": 18}),
        ("hidden neurons", {"hidden": 1001, "model": "snn"}),
        ("classes", {"n_classes": 9, "hidden": 23}),
        ("membrane", {"membrane": "eq4"}),
        ("reset", {"reset": "zero"}),
        ("threshold adaptation", {"threshold_adaptation": 0.3}),
        ("readout", {"readout": "integrator"}),
        ("recurrent delay", {"recurrent_delay_steps": 1}),
        ("decay of the current", {"tau_syn_ms": 5.0}),
        ("decay of the membrane", {"tau_mem_ms": 5.0}),
        ("fan-out of a hidden neuron, on average", {"hidden": 25}),
        ("early exit", {"rule": ExitRule(5)}),
    ],
)
def test_each_limit_of_xylo_is_checked(what, change):
    assert list(broken("xyloaudio2", **(MADE_FOR_XYLO | change))) == (
        ["conditioning and afferents", what] if what == "early exit" else [what, "conditioning and afferents"]
    )


def test_loihi_wants_its_own_membrane_and_reset():
    assert list(broken("loihi2", membrane="immediate", reset="hard")) == ["conditioning and afferents"]
    assert {"membrane", "reset"} <= broken("loihi2").keys()
    encoder = {"sa1": {"t_ref_ms": 40.0}, "ra1": {"t_ref_ms": 1.0}}
    assert "refractory steps of sa1" in broken("loihi2", encoder=encoder)
    assert "decay of the membrane" in broken("loihi2", tau_mem_ms=9000.0)
    assert "recurrent delay" in broken("loihi2", recurrent_delay_steps=1)
    assert "microcode" in broken("loihi2", threshold_adaptation=0.3)["threshold adaptation"]
    assert "recurrent delay" not in broken("loihi2", model="snn")


def test_learned_decays_are_checked_as_they_were_learned_those_of_the_readout_too():
    network = RSNN(16, 8, sampling_rate_Hz=2000.0, learn=["alpha", "beta"], **MADE_FOR_XYLO)
    fitting, other = math.exp(-1 / chips.steps_of(4)), math.exp(-1 / 11.0)

    def decays(target: str) -> list[tuple[str, str, bool]]:
        found = chips.compare(network, None, FULL_WINDOW, target)
        rows = found[found["what"].str.startswith("decay")]
        return [*zip(rows["what"], rows["here"], rows["fits"], strict=True)]

    assert [fits for _, _, fits in decays("xyloaudio2")] == [True, True]
    with torch.no_grad():
        network.alpha.copy_(torch.tensor([other, fitting]))
        network.beta.copy_(torch.tensor([fitting, other]))
    current, membrane = "decay of the current", "decay of the membrane"
    tau = f"tau {FITTING_TAU_ms:g} ms"
    assert decays("xyloaudio2") == [
        (current, "tau 5.5 ms", False), (current, tau, True), (membrane, tau, True), (membrane, "tau 5.5 ms", False)
    ]  # fmt: skip
    assert [here for _, here, _ in decays("loihi2")] == ["11.0 steps", "15.5 steps", "15.5 steps", "11.0 steps"]


def test_a_delay_of_recurrence_is_none_without_recurrence():
    spec = RSNNSpec(model="snn", recurrent_delay_steps=1)
    for target in ("xyloaudio2", "loihi2"):
        found = chips.compare(RSNN(2, 2, spec, 1000.0), None, FULL_WINDOW, target).set_index("what")
        assert found.loc["recurrent delay", "fits"]


@pytest.mark.parametrize("target", ["xyloaudio2", "loihi2"])
@pytest.mark.parametrize("projection", ["w_in", "w_rec", "w_out"])
def test_a_weight_that_dwarfs_the_others_does_not_fit_eight_bits(target, projection):
    network = RSNN(16, 8, hidden=24, sampling_rate_Hz=2000.0, generator=torch.Generator().manual_seed(0))
    weights = getattr(network, projection).data
    weights[0, 0] = 40 * weights.std()  # a step of 0.3 deviations: rounding changes 0.09 of 0.8

    def projections() -> list[str]:
        found = chips.compare(network, None, FULL_WINDOW, target)
        return [row.what for row in found.itertuples() if not row.fits and row.what.endswith("weights")]

    name = {"w_in": "input", "w_rec": "recurrent", "w_out": "readout"}[projection]
    assert projections() == [f"{name} weights"]
    weights[0, 0] = 0
    assert projections() == []


def test_spinnaker_holds_what_fits_a_processor():
    assert broken("spinnaker2", rule=ExitRule(5)) == {}
    assert list(broken("spinnaker2", hidden=300)) == ["bytes of one processor"]
    # 248 bytes below the limit, where thresholds that adapt take 4 bytes a hidden neuron.
    assert broken("spinnaker2", hidden=161, n_classes=9) == {}
    assert list(broken("spinnaker2", hidden=161, n_classes=9, threshold_adaptation=0.3)) == ["bytes of one processor"]


def test_spinnaker_runs_the_afferents_that_c_has():
    causal = {"conditioning.baseline": "start"}
    for name in ("sa1-ra1-lif", "sa1-ra1-lif-polarities", "sa1-ra1-lif-graded"):
        assert broken("spinnaker2", encoder=load(name, causal).model_dump()) == {}
    refused = {"izhikevich": causal, "sa1-ra1-lif": {"conditioning.baseline": "mean"}}
    for name, changes in refused.items():
        assert list(broken("spinnaker2", encoder=load(name, changes).model_dump())) == ["conditioning and afferents"]


def test_an_unknown_chip_is_refused():
    with pytest.raises(InputError, match="did you mean 'spinnaker2'"):
        broken("spinnaker")


@pytest.mark.parametrize("target", chips.CHECKS)
def test_events_of_a_sensor_need_no_front_end(target):
    network = RSNN(16, 8, hidden=30, sampling_rate_Hz=2000.0)
    named = [chips.compare(network, encoder, FULL_WINDOW, target)["what"].tolist() for encoder in (None, {})]
    front = "conditioning and afferents"
    assert named[1] == [what for what in named[0] if what != front or target == "spinnaker2"]
    assert chips.compare(network, {}, FULL_WINDOW, target).set_index("what")["fits"].get(front, True)
