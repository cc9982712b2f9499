"""Formats are as fine as their bits allow, and the integer twin is close to the float chain that it was made from."""

import numpy as np
import pytest
import torch
from compiled import chosen, raster_of
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_chain, make_signal, offline
from neurotact_parts.exporters.c import formats, integer
from neurotact_parts.exporters.c.formats import Raw, Weight
from neurotact_parts.exporters.c.proving import expected_in_integers

from neurotact.data.conditioning import conditioned_length
from neurotact.errors import InputError
from neurotact.networks.training.ranges import Ranges, record


@given(value=st.floats(1e-6, 0.999))
def test_a_weight_is_right_to_its_mantissa(value):
    weight = Weight.of(value)
    assert 2**14 <= weight.mantissa < 2**15
    assert weight.mantissa / 2**weight.bits == pytest.approx(value, rel=2**-14)


@given(state=st.integers(-(2**29), 2**29), target=st.integers(-(2**29), 2**29), value=st.floats(1e-4, 0.99))
def test_what_follows_neither_overshoots_nor_turns_back(state, target, value):
    after = int(integer.follow(np.array(state), np.array(target), Weight.of(value)))
    assert min(state, target) <= after <= max(state, target)
    assert after == pytest.approx(state + (target - state) * value, abs=2 + abs(target - state) * 2**-14)


@given(a=st.integers(-(2**40), 2**40), bits=st.integers(0, 30))
def test_division_rounds_towards_zero(a, bits):
    assert int(integer.over(np.array(a), bits)) == int(a / 2**bits)


@pytest.mark.parametrize("kind", [{}, {"membrane": "delayed", "reset": "subtract"}, {"membrane": "immediate"}])
def test_fine_formats_decide_as_the_float_chain_does(kind):
    """Weights that 8 bits hold exactly, states of 24 bits: what is left is rounding in the last bits."""
    chain = make_chain({"ema_cutoff_Hz": 30.0, "baseline": "start", "start_ms": 15.0}, seed=3, **kind)
    with torch.no_grad():
        for w in (chain.network.w_in, chain.network.w_rec, chain.network.w_out):
            top = w.abs().max()
            w.copy_(torch.round(w / top * 127) * top / 127)
    signals = [make_signal(400, seed=k) for k in range(6)]
    fine = chosen(chain, signals, state_bits=24)
    same = n = spikes = 0
    for signal in signals:
        said = expected_in_integers(chain, fine, [fine.raw.samples(signal)])[0]
        raster, expected = offline(chain, signal)
        rows = [tuple(np.flatnonzero(row).tolist()) for row in raster]
        spikes += sum(map(len, rows))
        assert sum(a != b for a, b in zip(said.afferents, rows, strict=True)) <= 0.01 * len(rows)
        same += sum(one[-1] == other[1] for one, other in zip(said.decisions, expected, strict=True))
        n += len(expected)
    assert spikes > 100
    assert same >= 0.9 * n


def test_coarse_weights_and_states_are_coarser():
    chain = make_chain({})
    ranges = Ranges(-10.0, 10.0, 5.0, 5.0)
    for bits in range(2, 9):
        found = formats.choose(chain, ranges, weight_bits=bits, state_bits=16)
        top = 2 ** (bits - 1) - 1
        assert max(np.abs(found.hidden.w).max(), np.abs(found.hidden.v).max()) == top
        whole = found.hidden.w * found.hidden.unit * 2.0**found.hidden.shift
        step = found.hidden.unit * 2.0**found.hidden.shift
        assert np.abs(whole - chain.network.w_in.detach().numpy()).max() <= 0.5 * step + 1e-9
    for bits in (*range(8, 17), 24):
        found = formats.choose(chain, ranges, state_bits=bits)
        assert formats.HEADROOM * 5.0 / found.hidden.unit <= 2 ** (bits - 1)


def test_slow_networks_get_wide_states():
    ranges = Ranges(-10.0, 10.0, 5.0, 5.0)
    quick, slow = (make_chain({}, tau_mem_ms=tau, tau_syn_ms=tau) for tau in (5.0, 400.0))
    assert formats.choose(quick, ranges).state_bits == 16
    assert formats.choose(slow, ranges).state_bits == 24


def test_a_slow_readout_gets_wide_states_too():
    """States are as wide as the layer that leaks more by rounding needs, here the readout with constants of its own."""
    chain = make_chain({}, tau_mem_ms=5.0, tau_syn_ms=5.0, learn=["alpha", "beta"])
    ranges = Ranges(-10.0, 10.0, 5.0, 5.0)
    assert formats.choose(chain, ranges).state_bits == 16
    with torch.no_grad():
        for decay in (chain.network.alpha, chain.network.beta):
            decay[1] = float(np.exp(-1 / 400))
    assert formats.choose(chain, ranges).state_bits == 24


def test_a_sample_off_zero_is_centred():
    raw = formats.choose(make_chain({"baseline": "start"}), Ranges(1.6, 2.0, 5.0, 5.0)).raw
    assert raw.zero == pytest.approx(1.8)
    assert raw.samples(np.array([1.6, 1.8, 2.0])).tolist() == pytest.approx([-26214, 0, 26214], abs=1)
    assert Raw(0.5, 0.0).samples(np.array([1e9, -1e9])).tolist() == [32767, -32768]


def test_whole_numbers_that_fit_are_samples_as_they_are():
    chain = make_chain({"baseline": "start"})
    counts = Ranges(0.0, 4095.0, 5.0, 5.0, is_whole=True)
    assert formats.choose(chain, counts).raw == Raw(1.0, 0.0)
    assert formats.choose(chain, counts._replace(low=900.0)).raw == Raw(1.0, 0.0)
    assert formats.choose(chain, counts._replace(is_whole=False)).raw.lsb < 0.2
    assert formats.choose(chain, counts._replace(high=65535.0)).raw.lsb > 1  # beyond 16 bits
    assert formats.choose(chain, counts._replace(low=900.0, is_whole=False), lsb=0.5).raw == Raw(0.5, 0.0)
    assert formats.choose(chain, Ranges(1000.0, 1000.1, 5.0, 5.0), lsb=0.01).raw.zero == pytest.approx(1000.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"beta": 1.5}, "beta is 1.5, which is no decay"),
        ({"threshold": -1.0}, "a threshold of -1 has no integer form"),
    ],
)
def test_dynamics_without_an_integer_form_are_refused(change, message):
    chain = make_chain({})
    for name, value in change.items():
        getattr(chain.network, name).data.fill_(value)
    with pytest.raises(InputError, match=message):
        formats.choose(chain, Ranges(-10.0, 10.0, 5.0, 5.0))


@examples(15)
@given(seed=st.integers(0, 99), falling=st.booleans())
def test_a_signal_under_a_negative_scale_spikes_as_its_negative_under_the_positive_one(seed, falling):
    raw, rasters = Raw(10 / 32767, 0.0).samples(make_signal(120, seed=seed)), []
    for sign in (1, -1):
        conditioning = {"ema_cutoff_Hz": 30.0, "baseline": "start", "scale": (0.7 * sign, 0.4)}
        chain = make_chain(conditioning, afferents={"sa1.opposite": falling})
        front = formats.choose(chain, Ranges(-10.0, 10.0, 5.0, 5.0)).front
        rasters.append(integer.encode((raw * [sign, 1])[None], front))
    np.testing.assert_array_equal(*rasters)
    assert rasters[0].any()


@pytest.mark.parametrize("key", ["tau_mem_ms", "ra1.t_ref_ms"])
def test_times_in_closed_form_that_32_bits_do_not_hold_are_refused(key):
    chain = make_chain({"resample_Hz": 1000.0}, rate_Hz=100.0, afferents={"integration": "exact", key: 1e5})
    with pytest.raises(InputError, match=rf"encoder: {key} is longer than 2\^15 steps.* export it in float32"):
        formats.choose(chain, Ranges(-10.0, 10.0, 5.0, 5.0))


def test_an_lsb_that_does_not_fit_is_refused():
    chain = make_chain({"offset": (500.0, 0.0)})
    with pytest.raises(InputError, match="give a coarser one"):
        formats.choose(chain, Ranges(-10.0, 10.0, 5.0, 5.0), lsb=1e-4)
    with pytest.raises(InputError, match="give a finer one"):
        formats.choose(make_chain({}), Ranges(-10.0, 10.0, 5.0, 5.0), lsb=1e6)


@examples(20)
@given(
    rate=st.sampled_from([370.0, 700.0, 1700.0, 3333.3, 150.0, 35.6, 1000.0]), n=st.integers(1, 200),
    integration=st.sampled_from(["clock", "exact"]),
)  # fmt: skip
def test_a_trial_in_integers_has_the_steps_of_a_whole_one(rate, n, integration):
    chain = make_chain({"resample_Hz": 1000.0}, rate_Hz=rate, afferents={"integration": integration})
    front = formats.choose(chain, Ranges(-10.0, 10.0, 5.0, 5.0)).front
    n_steps = conditioned_length(n, rate, 1000.0)
    assert integer.n_steps(n, front) == n_steps
    assert integer.encode(np.zeros((1, n, 2), np.int16), front).shape[1] == n_steps


@pytest.mark.parametrize("rate", [370.0, 1700.0])
@pytest.mark.parametrize("conditioning", [{}, {"ema_cutoff_Hz": 30.0, "scale": (0.2, 0.2)}])
@pytest.mark.parametrize("integration", ["clock", "exact"])
def test_trials_in_integers_end_alike_alone_and_beside_longer_ones(rate, conditioning, integration):
    chain = make_chain({"resample_Hz": 1000.0, **conditioning}, rate_Hz=rate, afferents={"integration": integration})
    made = formats.choose(chain, Ranges(-10.0, 10.0, 5.0, 5.0))
    trials = [made.raw.samples(make_signal(n, seed=n)) for n in (1, 40, 93, 120)]
    together = expected_in_integers(chain, made, trials)
    assert [expected_in_integers(chain, made, [trial])[0] for trial in trials] == together
    assert sum(map(len, together[-1].afferents)) > 0


def test_a_trial_in_closed_form_has_no_spike_of_a_sample_after_its_end():
    """A step that is half filled belongs to it, and would hold a spike of the sample that a longer trial has."""
    afferents = {"integration": "exact", "sa1.t_ref_ms": 1.7, "ra1.t_ref_ms": 1.3}
    chain = make_chain({"resample_Hz": 1000.0, "scale": (0.01, -0.01)}, rate_Hz=370.0, afferents=afferents)
    made = formats.choose(chain, Ranges(-10.0, 10.0, 5.0, 5.0))
    for n in range(1, 30):
        raw = made.raw.samples(make_signal(n, seed=n))
        padded = np.concatenate([raw, np.repeat(raw[-1:], 4, axis=0)])
        alone = integer.encode(raw[None], made.front)
        together = integer.encode(padded[None], made.front, np.array([n]))[:, : integer.n_steps(n, made.front)]
        np.testing.assert_array_equal(together, alone)


def test_ranges_are_the_largest_values_that_were_seen():
    chain = make_chain({}, seed=1)
    signal = make_signal(100)
    raster = raster_of(chain, signal)[None, :40]
    found = record(chain.network, torch.from_numpy(raster), [signal])
    assert found.low == pytest.approx(float(signal.min()))
    assert found.high == pytest.approx(float(signal.max()))
    assert found.hidden > 1
    assert record(chain.network, torch.zeros(1, 40, 4), [signal]).hidden == 0
