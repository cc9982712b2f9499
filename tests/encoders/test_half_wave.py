"""LIF afferents with an onset and of one sign of change: what drives them, and that the kernel and pieces agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from test_afferents import RATE_HZ, in_pieces, touches

from neurotact.encoders import specs
from neurotact.encoders.afferents import AfferentSpec, encode
from neurotact.encoders.cost import encoding_cost
from neurotact.errors import InputError

options = st.fixed_dictionaries(
    {
        "sa1.rate_ms": st.sampled_from([0.0, 5.0, 20.0]),
        "sa1.opposite": st.booleans(),
        "sa1.grades": st.sampled_from([[1.0], [0.5, 2.0]]),
        "ra1.change": st.sampled_from(["rectified", "on", "off", "both"]),
    }
)


def spec(changes) -> AfferentSpec:
    found = specs.load("sa1-ra1-lif", changes)
    assert isinstance(found, AfferentSpec)
    return found


@given(touches(), options, st.lists(st.floats(0, 1), max_size=2))
@examples(30)
def test_kernel_definition_and_pieces_agree(signal, changes, cuts):
    encoder = spec(changes)
    whole, end = encode(signal, RATE_HZ, encoder, backend="reference")
    compiled, state = encode(signal, RATE_HZ, encoder)
    assert np.array_equal(compiled, whole)
    assert np.array_equal(state.sa1.membrane_mV, end.sa1.membrane_mV)
    assert np.array_equal(in_pieces(signal, encoder, cuts)[0], whole)


@given(touches())
@examples(15)
def test_on_and_off_share_what_the_rectified_receive(signal):
    n = signal.shape[2]
    both = encode(signal, RATE_HZ, spec({"ra1.change": "both"}))[0][..., n:]
    on, off = (encode(signal, RATE_HZ, spec({"ra1.change": change}))[0][..., n:] for change in ("on", "off"))
    assert np.array_equal(both, np.concatenate([on, off], axis=2))
    assert np.array_equal(off, encode(-signal, RATE_HZ, spec({"ra1.change": "on"}))[0][..., n:])
    rising = np.maximum.accumulate(signal, axis=1)  # one that never falls
    onward, rectified = (encode(rising, RATE_HZ, spec({"ra1.change": each}))[0] for each in ("on", "rectified"))
    assert np.array_equal(onward, rectified)
    assert not encode(rising, RATE_HZ, spec({"ra1.change": "off"}))[0][..., n:].any()


def test_on_fires_once_a_cycle_where_rectified_fires_twice():
    phase = 2 * np.pi * 50 * np.arange(2000) / RATE_HZ
    signal = 6.0 * np.sin(phase)[None, :, None]
    rasters = [encode(signal, RATE_HZ, spec({"ra1.change": each}))[0][0, :, 1] for each in ("rectified", "on")]
    assert [int(raster[1000:].sum()) for raster in rasters] == [50, 25]
    vectors = [abs(np.mean(np.exp(1j * phase[np.flatnonzero(raster)]))) for raster in rasters]
    assert vectors[0] < 0.1  # half a cycle apart
    assert vectors[1] > 0.9


def test_the_rise_gives_an_onset_and_the_hold_none():
    signal = np.minimum(np.arange(1000) * 0.1, 5.0)[None, :, None]  # mV; 50 samples of rise
    plain, quick = (encode(signal, RATE_HZ, spec({"sa1.rate_ms": ms}))[0][0, :, 0] for ms in (0.0, 20.0))
    assert np.flatnonzero(quick)[0] < np.flatnonzero(plain)[0]
    assert quick[:60].sum() > plain[:60].sum()
    assert abs(int(quick[200:].sum()) - int(plain[200:].sum())) <= 1


def pressed(depth_mm, speed_mm_per_s, seconds=0.8) -> np.ndarray:
    """A ramp that is held, `(trial, time, taxel)`."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return np.minimum(time_s * speed_mm_per_s, depth_mm)[None, :, None]


def test_the_biological_spec_fires_as_its_comments_say():
    encoder = specs.load("sa1-ra1-lif-biological", {"conditioning": {"baseline": "none"}})
    held = encode(pressed(0.78, 72.0), RATE_HZ, encoder)[0][0, -1000:, :4]
    assert held.sum() / 4 / 0.5 == pytest.approx(33, abs=4)
    slow = encode(pressed(0.5, 6.0), RATE_HZ, encoder)[0][0, :, 4:].sum(axis=0)
    assert slow.tolist() == [pytest.approx(4, abs=1), 0]
    quick = encode(pressed(0.78, 72.0), RATE_HZ, encoder)[0][0]
    assert np.flatnonzero(quick[:, 3])[0] <= 0.005 * RATE_HZ


def test_the_rise_costs_a_mac_and_a_comparison_a_taxel_and_step():
    plain, quick = (encoding_cost(4, 100, 100.0, spec({"sa1.rate_ms": ms}).model_dump()) for ms in (0.0, 20.0))
    assert (quick.macs - plain.macs, quick.other_flops - plain.other_flops) == (400, 400)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ra1.rate_ms": 5.0}, "the rate of change alone drives RA-I"),
        ({"sa1.change": "on"}, "for its rise, set sa1.rate_ms"),
        ({"ra1.change": "up"}, "ra1.change: must be"),
    ],
)
def test_what_a_type_cannot_be_driven_by_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        spec(changes)
