"""At the break-even, both networks cost the same; more steps and dearer updates leave room for fewer spikes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison.break_even import break_even, dense_cost, drawn, spiking_cost, table

from neurotact.errors import InputError
from neurotact.metrics.prices import names, price_list

SIZES = st.tuples(st.integers(4, 64), st.integers(4, 128), st.integers(2, 20))


@given(SIZES, st.integers(1, 50), st.sampled_from(names()))
def test_both_networks_cost_the_same_there(sizes, steps, name):
    prices = price_list(name)
    rate = break_even(*sizes, steps, prices)
    dense = dense_cost(*sizes).energy_nJ(prices)
    spent = [
        spiking_cost(*sizes, steps, at, event_driven=prices.event_driven).energy_nJ(prices)
        for at in (rate, 1.1 * rate + 1e-6)
    ]
    assert rate >= 0
    assert spent[0] == pytest.approx(dense, rel=1e-6) if rate else spent[0] >= dense
    assert spent[1] > dense
    assert break_even(*sizes, steps + 1, prices) <= rate


def test_a_published_range_is_met_by_few_steps_with_memory():
    """Dampfhoffer et al.: 0.15 to 1.38 spikes per synapse, by hardware."""
    assert 0.15 < break_even(32, 50, 10, 5, price_list("memory-45nm")) < 1.38
    assert 0.15 < break_even(32, 50, 10, 300, price_list("memory-45nm-events")) < 1.38
    assert break_even(32, 50, 10, 300, price_list("memory-45nm")) == 0
    with pytest.raises(InputError, match="at least 1"):
        break_even(32, 50, 10, 0, price_list("memory-45nm"))


def test_the_figure_has_a_line_for_each_list():
    figure = drawn(table([price_list("memory-45nm"), price_list("loihi")], steps=(1, 5)))
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels[1:] == ["memory-45nm", "loihi"]
    never = drawn(table([price_list("xylo")], steps=(1, 5))).axes[0].get_legend()
    assert never.get_texts()[1].get_text() == "xylo: never"
