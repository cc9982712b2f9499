"""Who watches a stream sees the spikes that it decided on; a stream that changes goes on where it was."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS, make_chain, make_encoder, make_signal, offline
from neurotact_parts.streams.stream import Stream

from neurotact.backend import native
from neurotact.errors import InputError
from neurotact.networks.exit.rule import ExitRule

BACKENDS = ["reference", *(["native"] if native else [])]


def watched(chain, backend: str, signal: np.ndarray, size: int) -> tuple[list, list]:
    """Decisions and traces of a signal in blocks, with its end."""
    traces: list = []
    stream = Stream(chain, backend=backend, watch=traces.append)
    found = [d for at in range(0, len(signal), size) for d in stream.push(signal[at : at + size])]
    return found + stream.finish(), traces


def joined(traces, name: str) -> np.ndarray:
    return np.concatenate([getattr(trace, name) for trace in traces])


@given(
    seed=st.integers(0, 30), size=st.integers(1, 60), rate_Hz=st.sampled_from([1000.0, 700.0, 1700.0]),
    membrane=st.sampled_from(["eq4", "delayed", "immediate"]), readout=st.sampled_from([*READOUTS]),
    patience=st.sampled_from([None, 4]), hop_ms=st.sampled_from([30, 7]), backend=st.sampled_from(BACKENDS),
)  # fmt: skip
@examples(15)
def test_a_trace_holds_the_spikes_that_were_decided_on(
    seed, size, rate_Hz, membrane, readout, patience, hop_ms, backend
):
    conditioning = {} if rate_Hz == 1000.0 else {"resample_Hz": 1000.0}
    windows = {"length_ms": 30, "hop_ms": hop_ms, "start_ms": 5}
    chain = make_chain(
        conditioning, rate_Hz=rate_Hz, patience=patience, windows=windows, seed=seed, membrane=membrane, readout=readout
    )
    signal = make_signal(150, seed=seed)
    found, traces = watched(chain, backend, signal, size)
    assert found == list(Stream(chain, backend=backend).decide([signal]))
    raster, _ = offline(chain, signal)
    assert np.array_equal(joined(traces, "afferents"), raster.astype(bool))
    begins = [trace.begin_s for trace in traces]
    n_steps = np.cumsum([0, *(len(trace.window) for trace in traces[:-1])])
    assert begins == pytest.approx((n_steps / chain.clock_Hz).tolist())
    hidden, window = joined(traces, "hidden"), joined(traces, "window")
    assert not hidden[window < 0].any()
    for decision in found:  # a window that was always the oldest has all its steps
        whole = np.flatnonzero(window == decision.window)
        if len(whole) == decision.steps:
            assert hidden[whole].sum() == decision.hidden_spikes
            assert whole[0] == decision.start_step


@pytest.mark.skipif(not native, reason="no compiled kernels")
@given(
    seed=st.integers(0, 30), size=st.integers(1, 50), n_taxels=st.sampled_from([1, 3, 9, 33]),
    hidden=st.sampled_from([6, 70]), step_ms=st.sampled_from([None, 4.0]),
    spoilt=st.lists(st.integers(0, 120), max_size=3),
)  # fmt: skip
@examples(8)
def test_the_compiled_step_shows_what_the_reference_shows(seed, size, n_taxels, hidden, step_ms, spoilt):
    """With values that are held, gaps, and more neurons than a word has bits."""
    chain = make_chain(
        {"baseline": "start"},
        n_taxels=n_taxels,
        hidden=hidden,
        step_ms=step_ms,
        windows={"length_ms": 30, "hop_ms": 9},
        patience=5,
        seed=seed,
    )
    signal = make_signal(130, n_taxels, seed)
    for at in spoilt:
        signal[at : at + 1 + at % 9] = np.nan
    (mine, reference), (theirs, compiled) = (watched(chain, each, signal, size) for each in BACKENDS)
    assert mine == theirs
    for name in ("afferents", "hidden", "window"):
        assert np.array_equal(joined(reference, name), joined(compiled, name))
    ends = [{round((t.begin_s + len(t.window) * t.step_s) * 1000) for t in each} for each in (reference, compiled)]
    assert max(ends[0]) == max(ends[1])


def test_hidden_neurons_of_the_made_chains_spike():
    """Else the laws above would hold of silence."""
    chain = make_chain({}, patience=4, windows={"length_ms": 30})
    _, traces = watched(chain, "auto", make_signal(300), 20)
    assert joined(traces, "hidden").sum() > 50


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_stream_that_changes_leaves_the_other_as_it_was(backend):
    chain, signal = make_chain({}, patience=5), make_signal(200)
    stream, alone = (Stream(chain, backend=backend) for _ in range(2))
    stream.push(signal[:70])
    alone.push(signal[:70])
    encoder = chain.encoder.model_copy(update={"sa1": chain.encoder.sa1.model_copy(update={"t_ref_ms": 9.0})})
    other = stream.changed(encoder=encoder, rule=ExitRule(2, from_first_spike=True))
    assert other.chain.encoder.sa1.t_ref_ms == 9.0
    assert other.chain.rule.patience == 2
    assert other.push(signal[70:]) != (expected := alone.push(signal[70:]))
    assert stream.push(signal[70:]) == expected
    assert other.tally.samples == 200


def test_another_conditioning_is_no_change_that_a_running_stream_takes():
    stream = Stream(make_chain({}))
    with pytest.raises(InputError, match="another conditioning, unit, model or taxels"):
        stream.changed(encoder=make_encoder(baseline="start"))
