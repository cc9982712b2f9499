"""What chips ask of a network: the limits that a network keeps, and those that it breaks, by name."""

import math

import pytest

from neurotact.deploy import targets
from neurotact.errors import InputError
from neurotact.networks.early_exit import FULL_WINDOW, ExitRule
from neurotact.networks.rsnn import RSNN

FITTING_TAU_ms = -1 / math.log(1 - 2.0**-4) / 2.0


def broken(target: str, rule=FULL_WINDOW, encoder=None, n_inputs=16, n_classes=8, **spec) -> dict[str, str]:
    network = RSNN(n_inputs, n_classes, sampling_rate_Hz=2000.0, **spec)
    found = targets.check(network, encoder, rule, target)
    assert (found["cost"] != "").equals(~found["fits"])
    return {row.what: row.cost for row in found.itertuples() if not row.fits}


def test_a_network_made_for_xylo_fits_but_for_the_front_end():
    made = {"membrane": "immediate", "reset": "subtract", "tau_mem_ms": FITTING_TAU_ms, "tau_syn_ms": FITTING_TAU_ms}
    assert list(broken("xyloaudio2", **made)) == ["conditioning and afferents"]


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("inputs", {"n_inputs": 18}),
        ("hidden neurons", {"hidden": 1001}),
        ("classes", {"n_classes": 9}),
        ("membrane", {"membrane": "eq4"}),
        ("reset", {"reset": "zero"}),
        ("readout", {"readout": "integrator"}),
        ("recurrent delay", {"recurrent_delay_steps": 1}),
        ("decay of the current", {"tau_syn_ms": 5.0}),
        ("decay of the membrane", {"tau_mem_ms": 5.0}),
        ("early exit", {"rule": ExitRule(5)}),
    ],
)
def test_each_limit_of_xylo_is_checked(what, change):
    made = {"membrane": "immediate", "reset": "subtract", "tau_mem_ms": FITTING_TAU_ms, "tau_syn_ms": FITTING_TAU_ms}
    assert list(broken("xyloaudio2", **(made | change))) == (
        ["conditioning and afferents", what] if what == "early exit" else [what, "conditioning and afferents"]
    )


def test_loihi_wants_its_own_membrane_and_reset():
    assert list(broken("loihi2", membrane="immediate", reset="hard")) == ["conditioning and afferents"]
    assert {"membrane", "reset"} <= broken("loihi2").keys()
    encoder = {"sa1": {"t_ref_ms": 40.0}, "ra1": {"t_ref_ms": 1.0}}
    assert "refractory steps of sa1" in broken("loihi2", encoder=encoder)
    assert "decay of the membrane" in broken("loihi2", tau_mem_ms=9000.0)


def test_spinnaker_holds_what_fits_a_processor():
    assert broken("spinnaker2", rule=ExitRule(5)) == {}
    assert list(broken("spinnaker2", hidden=300)) == ["bytes of one processor"]


def test_an_unknown_chip_is_refused():
    with pytest.raises(InputError, match="did you mean 'spinnaker2'"):
        broken("spinnaker")
