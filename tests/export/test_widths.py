"""What is counted on 32-bit numbers: as the types of exported integer C say, and priced apart by integer lists."""

import math
import re
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
from compiled import chosen
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_chain, make_signal
from neurotact_parts.exporters.c import c_export

from neurotact import spec as specs
from neurotact.encoders import specs as encoders
from neurotact.encoders.cost import encoding_cost
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, NotCounted, SpikingLayer, cost
from neurotact.metrics.prices import OF_WIDTH, OPERATIONS, PRICED, WIDE, PriceList, names, price_list
from neurotact.networks.use.ledger import Afferents

counts = st.integers(0, 10**5)
sizes = st.integers(65536, 8 * 10**5)
INT8 = price_list("int8-45nm")
CACHES = (8192, 32768, 1048576), {8: (1.25, 2.5, 12.5), 32: (5.0, 10.0, 50.0)}
"""Sizes in bytes, and the price of a read of a number of so many bits."""
OPERATION_PJ = {
    8: {"multiplications": 0.2, "acs": 0.05},
    32: {"multiplications": 3.1, "acs": 0.1},
}
AS_MACS = {"macs": 1, "divisions": 2, "exponentials": 4}


def price_of(bits: int, kind: str) -> float:
    """Of one operation of a kind on integers of so many bits."""
    own = OPERATION_PJ[bits]
    if kind in AS_MACS:
        return AS_MACS[kind] * (own["multiplications"] + own["acs"])
    return own["acs" if kind == "comparisons" else kind]


@st.composite
def costs(draw) -> Cost:
    """A cost of which a part is on 32-bit numbers; its memories lie between the first and the last cache."""
    narrow, wide = (
        Cost(
            **{name: draw(counts) for name in (*OPERATIONS, "weights_accesses", "states_accesses", "buffers_accesses")},
            bytes=draw(sizes) + (states := draw(sizes)), states_bytes=states, buffers_bytes=65536,
        )
        for _ in range(2)
    )  # fmt: skip
    return narrow + replace(wide, buffers_accesses=0, buffers_bytes=0).in_32_bits()


@given(costs())
def test_the_energy_in_integers_is_that_of_each_operation_and_number_at_its_width(found):
    def by_width(name: str) -> dict[int, float]:
        wide = getattr(found, f"{WIDE}{name}", 0)
        return {8: getattr(found, name) - wide, 32: wide}

    total = sum(price_of(bits, kind) * n for kind in OPERATIONS for bits, n in by_width(kind).items())
    for memory in ("weights", "states", "buffers"):
        size = sum(n / 4 * bits / 8 for bits, n in by_width(f"{memory}_bytes").items())
        for bits, n in by_width(f"{memory}_accesses").items():
            total += n * np.interp(size, CACHES[0], CACHES[1][bits])
    assert 1e3 * found.energy_nJ(INT8) == pytest.approx(total)


@given(costs())
def test_lists_of_one_width_take_all_alike(found):
    bare = replace(found, **{field.name: 0 for field in fields(Cost) if field.name.startswith(WIDE)})
    for name in names():
        own, of_bare = (one.energy_nJ(price_list(name)) for one in (found, bare))
        assert own == of_bare if name != INT8.name else own >= of_bare
    both = found + found
    assert [getattr(found.times(2), name) for name in PRICED if not name.endswith("_bytes")] == [
        getattr(both, name) for name in PRICED if not name.endswith("_bytes")
    ]


WAYS = st.fixed_dictionaries(
    {"baseline": st.sampled_from(["none", "start", "high-pass"])},
    optional={"ema_cutoff_Hz": st.just(30.0), "offset": st.just([0.5, -1.0]), "rectify": st.just(True)},
)


KINDS = ["sa1", "ra1"]
PERIODS = [(1000.0, 254.0), (1000.0, 255.0), (2000.0, 127.0), (2000.0, 127.2)]
"""A clock in Hz, and the longest refractory period in ms."""


@pytest.mark.filterwarnings("ignore:t_ref of 127.2 ms")
@pytest.mark.parametrize("period", PERIODS)
@given(
    how=WAYS,
    integration=st.sampled_from(["clock", "exact"]),
    long=st.sampled_from(KINDS),
    empty=st.sampled_from([*KINDS, None]),
)
@examples(5)
def test_encoding_is_counted_at_the_widths_of_exported_integers(
    how, integration, period, long, empty, tmp_path_factory
):
    """A refractory counter alone has fewer bits than 32, where the steps of the longest period fit in them."""
    clock_Hz, t_ref_ms = period
    afferents = {"integration": integration, "sa1.t_ref_ms": 2.0, "ra1.t_ref_ms": 2.0}
    afferents[f"{long}.t_ref_ms"] = t_ref_ms
    if empty is not None:
        afferents |= {f"{empty}.taxels": [], "recorded_taxels": ["a", "b"]}
    chain = make_chain({**how, "resample_Hz": clock_Hz}, rate_Hz=500.0, afferents=afferents)
    folder = tmp_path_factory.mktemp("c")
    written = c_export.write(chain, folder, chosen(chain, [make_signal(90)]), name="c")
    header = next(path for path in written if path.suffix == ".h").read_text()
    taxel = re.search(r"typedef struct \{([^}]*)\} c_taxel;", header)
    assert taxel is not None
    types = {name: int(width) for width, name in re.findall(r"int(\d+)_t (\w+)", taxel[1])}
    counter = types.pop("silent", None) or types.pop("refractory")
    assert set(types.values()) <= {32, 64}
    table = chain.encoder.model_dump(mode="json")
    n, steps = 4 if empty is None else 2, 300.0
    found = encoding_cost(2, steps, 1e3 * steps / clock_Hz, table, recorded_Hz=500.0, spikes=7.0)
    updates = steps if integration == "clock" else 1e-3 * (1e3 * steps / clock_Hz) * 500.0
    narrow = {name: getattr(found, name) - getattr(found, f"{WIDE}{name}") for name in OF_WIDTH}
    is_narrow = counter == 8
    expected = {"states_accesses": is_narrow * 2 * n * updates, "states_bytes": is_narrow * 4 * n}
    assert narrow == {**dict.fromkeys(OF_WIDTH, 0), **expected}


@pytest.mark.parametrize("encoder", specs.shipped("encoders"), ids=lambda path: path.stem)
def test_all_of_an_encoder_is_wide_but_its_counters(encoder):
    table = encoders.load(encoder).model_dump(mode="json")
    found = encoding_cost(4, 200, 200.0, table, recorded_Hz=1000.0)
    apart = {name for name in OF_WIDTH if getattr(found, name) != getattr(found, f"{WIDE}{name}")}
    assert apart == ({"states_accesses", "states_bytes"} if table.get("model", "lif") == "lif" else set())
    assert found.energy_nJ(INT8) > 2 * replace(found, **{f"{WIDE}{name}": 0 for name in OF_WIDTH}).energy_nJ(INT8)


def test_a_network_has_the_width_of_its_list():
    afferents = Afferents(16, {}, 1000.0)
    network = cost(SpikingLayer(16, 20, 150, 800, True))
    assert all(getattr(network, f"{WIDE}{name}") == 0 for name in OF_WIDTH)
    both = afferents.cost(150) + network
    assert both.wide_macs == afferents.cost(150).macs == both.macs - network.macs


def test_rows_that_do_not_say_widths_are_not_counted_by_lists_that_have_several():
    row = {name: value for name, value in Cost(macs=3, states_accesses=0).columns(*PRICED).items() if WIDE not in name}
    table = pd.DataFrame([row])
    for name in names():
        assert math.isnan(price_list(name).energy_nJ(row)) == (name == INT8.name)
        assert math.isnan(price_list(name).energy_nJ(table).item()) == (name == INT8.name)
    assert math.isnan((Cost(macs=1) + NotCounted()).in_32_bits().energy_nJ(INT8))
    silent = Cost(macs=1).in_32_bits()  # what it moves is not counted
    assert math.isnan(silent.energy_nJ(INT8))
    assert silent.wide_states_accesses == 0


def test_a_list_says_its_prices_of_both_widths():
    assert "Encoding computes in 32 bits: 3.2 pJ per MAC, 0.1 pJ per addition." in INT8.in_words()
    mine = PriceList(**{"like": "int8-45nm", "addition_pJ": 0.07})
    assert mine.wide == INT8.wide
    assert "Encoding" not in price_list("memory-45nm").in_words()
    with pytest.raises(InputError, match=r"wide\.memory_pJ: must be there where memory_pJ is, and only there"):
        PriceList(**{"like": "int8-45nm", "wide": {"like": "arithmetic-45nm"}})
