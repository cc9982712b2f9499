"""Afferents in closed form in C: the steps of the definition in float, and nearly those in integers."""

import math

import numpy as np
import pytest
from compiled import chosen, compare_on, spikes_of
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_chain, make_signal, told
from neurotact_parts.exporters.c import integer, proof
from neurotact_parts.exporters.c.formats import OCTAVE, PIECE, ClosedForm
from neurotact_parts.exporters.c.proof import Spoken
from neurotact_parts.exporters.c.proving import expected_in_float, expected_in_integers
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.stream import Stream

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason=str(proof.missing("cc")))
pytestmark = pytest.mark.filterwarnings("ignore:.*count as one")
OPTIONS = [
    {},
    {"sa1.grades": [0.5, 1.0, 4.0], "v_reset_mV": -70.0},
    {"sa1.opposite": True, "tau_mem_ms": 3.0},
    {"sa1.taxels": [1], "tau_mem_ms": 60.0, "recorded_taxels": ["a", "b"]},
]


def made(rate_Hz: float, clock_Hz: float = 1000.0, afferents: dict | None = None, **options) -> Chain:
    how = {"resample_Hz": clock_Hz, "baseline": "start", "start_ms": 60.0}
    options = {"windows": {"length_ms": 60, "hop_ms": 45}, **options}
    return make_chain(how, rate_Hz=rate_Hz, afferents={"integration": "exact", **(afferents or {})}, **options)


@needs_compiler
@pytest.mark.thorough
@given(
    rate_Hz=st.floats(20, 999),
    clock_Hz=st.sampled_from([1000.0, 1000.0, 2500.0]),
    periods=st.tuples(st.floats(0.1, 3), st.sampled_from([0.2, 5.0, 70.0])),
    options=st.sampled_from(OPTIONS),
    patience=st.sampled_from([None, 20]),
    loud=st.sampled_from([0.3, 1.0, 40.0]),
    seed=st.integers(0, 99),
)
@examples(10)
def test_c_has_the_steps_and_decisions_of_a_stream_and_of_its_twin(
    rate_Hz, clock_Hz, periods, options, patience, loud, seed, tmp_path_factory
):
    afferents = {**options, "sa1.t_ref_ms": periods[0], "ra1.t_ref_ms": periods[1]}
    chain = made(rate_Hz, clock_Hz, afferents, patience=patience, readout="integrator")
    signals = [loud * make_signal(n, seed=seed + n) for n in (90, 41)]
    for formats in (None, chosen(chain, signals)):
        folder = tmp_path_factory.mktemp("c")
        difference, expected = compare_on(signals, chain, folder, formats, flags=("-O0",))
        assert difference is None
        if formats is None:
            rows = [(start, label, steps, inputs, hidden) for _, start, steps, inputs, hidden, _, label in
                    expected[0].decisions]  # fmt: skip
            assert told(Stream(chain).decide([signals[0]]))[: len(rows)] == rows


def steps_of(said: Spoken, n_afferents: int) -> np.ndarray:
    raster = np.zeros((len(said.afferents), n_afferents), bool)
    for step, fired in enumerate(said.afferents):
        raster[step, list(fired)] = True
    return raster


@pytest.mark.parametrize("rate_Hz", [20.0, 35.6, 150.0, 999.0])
def test_integers_have_the_spikes_of_the_definition_in_the_same_step_or_the_next(rate_Hz):
    chain = made(rate_Hz, afferents={"sa1.opposite": True, "sa1.t_ref_ms": 2.5})
    signals = [make_signal(150, seed=k) for k in range(3)]
    formats = chosen(chain, signals)
    for raw in map(formats.raw.samples, signals):
        signal = (raw * formats.raw.lsb + formats.raw.zero).astype(np.float32)
        said = expected_in_integers(chain, formats, [raw])[0], expected_in_float(chain, signal)
        ours, theirs = (steps_of(each, chain.network.n_inputs) for each in said)
        assert len(ours) == len(theirs)
        assert ours.sum(axis=0).tolist() == theirs.sum(axis=0).tolist()
        padded = np.pad(theirs, ((1, 1), (0, 0)))
        assert (ours <= (padded[:-2] | padded[1:-1] | padded[2:])).all()
        assert (ours & theirs).sum() > 0.98 * ours.sum() > 0


@given(st.integers(1, 2**31 - 1), st.integers(0, 2**27), st.integers(512, 2**31 - 1))
def test_a_logarithm_and_a_power_in_integers_are_near_the_true_ones(value, ticks, octave):
    assert abs(integer.log2(np.array([value]))[0] / 2**OCTAVE - math.log2(value)) < 5e-5
    closed = ClosedForm((1, 0), 2**16, octave, round(2**40 / octave), 0)
    assert integer.kept(np.array([ticks]), closed)[0] / 2**OCTAVE == pytest.approx(2 ** (-ticks / octave), abs=4e-5)
    assert len(integer.CURVES[0]) == 2**PIECE + 1


@needs_compiler
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_a_constant_press_fires_at_its_closed_form(variant, tmp_path):
    """A drive of twice the threshold: first after tau ln 2, then each t_ref + tau ln 2; tau is 10 ms, t_ref 5 ms."""
    afferents = {"sa1.gain": 2.0, "sa1.t_ref_ms": 5.0, "integration": "exact"}
    chain = make_chain({"resample_Hz": 1000.0}, rate_Hz=50.0, afferents=afferents)
    signals = [np.full((10, 2), 10.0, np.float32)]
    formats = None if variant == "float" else chosen(chain, signals)
    difference, expected = compare_on(signals, chain, tmp_path, formats, flags=("-O1",))
    assert difference is None
    first_ms = 10 * math.log(2)
    due = [math.ceil(first_ms + nth * (5 + first_ms)) - 1 for nth in range(17)]
    assert [step for step, fired in enumerate(expected[0].afferents) if 0 in fired] == due
    assert spikes_of(expected)[0] == 34


@needs_compiler
@pytest.mark.parametrize("rate_Hz", [50.0, 35.6])
def test_a_spike_on_the_border_of_a_step_is_in_the_step_before(rate_Hz, tmp_path):
    """A drive without end: membranes cross at once, and spikes are whole refractory periods apart."""
    chain = make_chain(
        {"resample_Hz": 1000.0}, rate_Hz=rate_Hz, afferents={"sa1.t_ref_ms": 5.0, "integration": "exact"}
    )
    signals = [np.full((10, 2), 1e15, np.float32)]
    difference, expected = compare_on(signals, chain, tmp_path, None, flags=proof.SANITIZERS)
    assert difference is None
    assert [step for step, fired in enumerate(expected[0].afferents[:16]) if 0 in fired] == [0, 4, 9, 14]
