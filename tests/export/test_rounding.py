"""Weights that are seen rounded: what is seen, which gradient comes back, and what is left at the end."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.exporters.c.rounding import Grid, SeenRounded, seen_rounded

from neurotact.networks.definition.rsnn import RSNN

KINDS = [{}, {"model": "snn"}, {"readout": "integrator"}, {"membrane": "immediate", "learn": ("alpha", "threshold")}]


def make_network(**keys) -> RSNN:
    recurrence = {} if keys.get("model") == "snn" else {"recurrent_weight_scale": 0.5}
    settings = {"hidden": 5, "forward_weight_scale": 3.0, "sampling_rate_Hz": 1000.0, **recurrence}
    return RSNN(4, 3, generator=torch.Generator().manual_seed(0), **{**settings, **keys})


def grids_of(network: RSNN, step: float = 0.25, most: int = 7) -> dict[str, Grid]:
    names = [name for name in ("w_in", "w_rec", "w_out", "bias") if getattr(network, name) is not None]
    return {name: Grid(step * (1 + k), most) for k, name in enumerate(names)}


def spikes_of(n_windows: int = 6) -> torch.Tensor:
    return (torch.rand(n_windows, 30, 4, generator=torch.Generator().manual_seed(1)) < 0.3).to(torch.uint8)


@given(
    weights=st.lists(st.floats(-100, 100, width=32), min_size=1, max_size=9),
    step=st.floats(1e-3, 10),
    most=st.integers(1, 127),
)
def test_what_is_seen_is_on_the_grid_and_nearest_to_the_weight(weights, step, most):
    fine = torch.tensor(weights)
    seen = SeenRounded(Grid(step, most))(fine)
    whole = (seen.double() / step).round()
    assert torch.equal(seen, (whole * step).float())
    assert float(whole.abs().max()) <= most
    inside = fine.double().abs() <= most * step
    assert float((seen.double() - fine.double()).abs()[inside].max() if inside.any() else 0.0) <= 0.5001 * step
    assert torch.equal(seen[~inside], (fine.sign() * float(torch.tensor(most * step).float()))[~inside])


@pytest.mark.parametrize("backend", ["auto", "reference"])
@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_those_of_the_rounded_network(kind, backend):
    """Weight by weight, also of those that the grid clips."""
    fine, rounded = make_network(backend=backend, **kind), make_network(backend=backend, **kind)
    grids = grids_of(fine, most=2)
    with torch.no_grad():
        for name, grid in grids.items():
            getattr(rounded, name).copy_(grid.nearest(getattr(fine, name)))
    labels = torch.tensor([0, 1, 2, 0, 1, 2])

    def gradients(network: RSNN, names: dict[str, str]) -> dict[str, torch.Tensor]:
        counts = network(spikes_of())
        (torch.nn.functional.cross_entropy(counts.readout, labels) + counts.hidden.square().mean()).backward()
        parameters = dict(network.named_parameters())
        return {name: parameters[inner].grad for name, inner in names.items()}

    with seen_rounded(fine, grids):
        found = gradients(fine, {name: f"parametrizations.{name}.original" for name in grids})
    expected = gradients(rounded, {name: name for name in grids})
    clipped = (make_network(**kind).w_in.abs() > 2.5 * grids["w_in"].step) & (expected["w_in"] != 0)
    assert clipped.any()
    for name, gradient in expected.items():
        assert gradient.any(), name
        assert torch.equal(found[name], gradient), name


@pytest.mark.parametrize("kind", KINDS)
def test_afterwards_the_weights_are_those_that_were_seen(kind):
    network, before = make_network(**kind), make_network(**kind)
    grids = grids_of(network)
    with seen_rounded(network, grids):
        seen = {name: getattr(network, name).detach().clone() for name in grids}
        counts = network(spikes_of())
    assert type(network) is RSNN
    assert {*network.state_dict()} == {*before.state_dict()}
    for name in grids:
        assert torch.equal(getattr(network, name), seen[name])
        assert isinstance(getattr(network, name), torch.nn.Parameter)
    assert not torch.equal(network.w_in, before.w_in)
    assert torch.equal(network(spikes_of()).readout, counts.readout)


def test_an_error_leaves_no_trace():
    network = make_network()
    with pytest.raises(RuntimeError, match="on purpose"), seen_rounded(network, grids_of(network)):
        raise RuntimeError("on purpose")
    assert type(network) is RSNN
