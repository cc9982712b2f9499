"""A stream decides what the whole trial decides, whatever the blocks; what it cannot use, it counts."""

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from levels import examples
from made_chains import ADAPTING, READOUTS, make_chain, make_encoder, make_run, make_signal, offline, told
from neurotact_parts.streams.chain import chain_of
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.backend import native
from neurotact.data.dataset import simulator
from neurotact.encoders import specs
from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.exit.rule import ExitRule

CONDITIONINGS = (
    {},
    {"ema_cutoff_Hz": 30.0, "baseline": "start", "start_ms": 15.0},
    {"baseline": "start", "scale": (2.0, 0.5)},
    {"ema_cutoff_Hz": 60.0, "baseline": "high-pass", "high_pass_Hz": 2.0, "rectify": True},
    {"baseline": "start", "offset": (0.1, -0.2), "scale": (1.0, 2.0)},
)
WINDOWS = (
    {"length_ms": 40},
    {"length_ms": 30, "hop_ms": 7, "start_ms": 12},
    {"length_ms": 25, "contact": True, "quiet_ms": 4},
)
BACKENDS = ["reference", *(["native"] if native else [])]
MEMBRANES = [(m, r) for m in ("eq4", "delayed", "immediate") for r in ("zero", "subtract", "hard")]


def blocks_of(signal: np.ndarray, sizes: list[int]) -> list[np.ndarray]:
    """The signal cut at these sizes, over and over."""
    blocks, at, i = [], 0, 0
    while at < len(signal):
        size = sizes[i % len(sizes)]
        blocks.append(signal[at : at + size])
        at, i = at + size, i + 1
    return blocks


def fitting(decisions, n_steps: int, length: int) -> list:
    """Without those that left a window early which the trial then cut off."""
    return [d for d in decisions if d.start_step + length <= n_steps]


@given(
    seed=st.integers(0, 50),
    n_samples=st.integers(8, 260),
    sizes=st.lists(st.integers(1, 90), min_size=1, max_size=4),
    conditioning=st.sampled_from(CONDITIONINGS),
    rate_Hz=st.sampled_from([None, 35.6, 700.0, 1000.0, 1700.0, 3333.3]),
    windows=st.sampled_from(WINDOWS),
    rule=st.sampled_from([{}, {"patience": 1}, {"patience": 5}]),
    kind=st.sampled_from(MEMBRANES),
    delay=st.integers(0, 1),
    readout=st.sampled_from([*READOUTS]),
    model=st.sampled_from(["rsnn", "snn"]),
    adapting=st.sampled_from([{}, ADAPTING]),
    step_ms=st.sampled_from([None, 3.0, 7.0]),
    backend=st.sampled_from(BACKENDS),
)
@examples(60)
def test_a_stream_decides_what_the_whole_trial_decides(
    seed,
    n_samples,
    sizes,
    conditioning,
    rate_Hz,
    windows,
    rule,
    kind,
    delay,
    readout,
    model,
    adapting,
    step_ms,
    backend,
):
    if rate_Hz:
        high_enough = {"ema_cutoff_Hz": 0.2 * rate_Hz} if "ema_cutoff_Hz" in conditioning else {}
        conditioning = conditioning | {"resample_Hz": 1000.0} | high_enough
    n_samples = min(n_samples, 20) if rate_Hz == 35.6 else n_samples
    chain = make_chain(
        conditioning, rate_Hz=rate_Hz or 1000.0, **rule, windows=windows, seed=seed,
        membrane=kind[0], reset=kind[1], recurrent_delay_steps=delay, readout=readout, model=model, step_ms=step_ms,
        **adapting,
    )  # fmt: skip
    signal = make_signal(n_samples, seed=seed)
    raster, expected = offline(chain, signal)
    found = list(Stream(chain, backend=backend).decide(blocks_of(signal, sizes)))
    assert told(fitting(found, len(raster), chain.windows.length)) == expected


@pytest.mark.parametrize("backend", BACKENDS)
@given(
    rate_Hz=st.sampled_from([35.6, 100.0, 700.0, 1700.0, 3333.3]), n_samples=st.integers(9, 60),
    conditioning=st.sampled_from(CONDITIONINGS), at=st.integers(0, 60), seed=st.integers(0, 9),
)  # fmt: skip
@examples(15)
def test_a_window_as_long_as_the_trial_is_decided_at_its_end(backend, rate_Hz, n_samples, conditioning, at, seed):
    high_enough = {"ema_cutoff_Hz": 0.2 * rate_Hz} if "ema_cutoff_Hz" in conditioning else {}
    conditioning = conditioning | {"resample_Hz": 1000.0} | high_enough
    chain = make_chain(conditioning, rate_Hz=rate_Hz, windows={"length_ms": 1e3 * n_samples / rate_Hz}, seed=seed)
    signal = make_signal(n_samples, seed=seed)
    _, expected = offline(chain, signal)
    assert len(expected) == 1
    stream = Stream(chain, backend=backend)
    found = [*stream.push(signal[:at]), *stream.push(signal[at:])]
    assert told([*found, *stream.finish()]) == expected
    assert rate_Hz > chain.clock_Hz or stream.tally.unfinished == 0  # nothing is left over


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("rule", [{}, {"patience": 14}])
def test_a_slower_clock_merges_spikes_and_ends_with_the_window_and_the_rule(backend, rule):
    """Windows of five bins and a part of one, in which afferents spike more than once a bin."""
    windows = {"length_ms": 40, "hop_ms": 13}
    chain = make_chain({}, step_ms=7.0, windows=windows, readout="integrator", model="snn", **rule)
    signal = make_signal(400, seed=3)
    raster, expected = offline(chain, signal)
    found = list(Stream(chain, backend=backend).decide([signal]))
    assert told(fitting(found, len(raster), chain.windows.length)) == expected
    starts, _, steps, inputs, _ = zip(*expected, strict=True)
    assert sum(raster[at : at + n].sum() for at, n in zip(starts, steps, strict=True)) > sum(inputs)
    assert max(steps) == 40  # which is no whole number of bins
    assert not rule or min(steps) < 40


@pytest.mark.parametrize("backend", BACKENDS)
def test_spikes_that_wait_for_the_clock_are_part_of_the_state(backend, tmp_path):
    chain, signal = make_chain({}, step_ms=7.0, windows={"length_ms": 40}), make_signal(200, seed=3)
    whole = list(Stream(chain, backend=backend).decide([signal]))
    for at in range(60, 67):
        first, second = Stream(chain, backend=backend), Stream(chain, backend=backend)
        decided = first.push(signal[:at])
        first.save(tmp_path / f"state{at}")
        second.load(tmp_path / f"state{at}")
        assert [*decided, *second.push(signal[at:]), *second.finish()] == whole


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("model", "of_hidden"), [("rsnn", 6 + 3), ("snn", 3)])
def test_operations_are_those_counted_by_hand(model, of_hidden, backend):
    """Six hidden neurons and three classes: an input spike reaches 6, a hidden one 3, or with recurrence 6 + 3."""
    chain = make_chain({}, model=model, windows={"length_ms": 40, "hop_ms": 13}, patience=5)
    traces: list = []
    stream = Stream(chain, backend=backend, watch=traces.append)
    found = [*stream.push(make_signal(200))]
    for decision in found:
        assert decision.sops == 6 * decision.input_spikes + of_hidden * decision.hidden_spikes
    afferents, hidden = (np.concatenate([getattr(each, name) for each in traces]) for name in ("afferents", "hidden"))
    first = found[0]  # was the oldest window all along
    assert first.sops == 6 * afferents[: first.steps].sum() + of_hidden * hidden[: first.steps].sum()
    assert any(d.input_spikes != d.hidden_spikes for d in found)  # else a swap would not show


SEVERAL = (
    {"sa1.grades": [0.3, 0.6, 1.0, 1.7]},
    {"sa1.opposite": True},
    {"sa1.opposite": True, "sa1.grades": [0.5, 1.0], "ra1.grades": [0.4, 1.0, 3.0]},
)
"""Afferents of a taxel."""


@given(
    seed=st.integers(0, 50),
    sizes=st.lists(st.integers(1, 90), min_size=1, max_size=4),
    afferents=st.sampled_from(SEVERAL),
    conditioning=st.sampled_from(CONDITIONINGS[:3]),
    windows=st.sampled_from(WINDOWS),
    at=st.integers(0, 200),
    backends=st.tuples(st.sampled_from(BACKENDS), st.sampled_from(BACKENDS)),
)
@examples(15)
def test_several_afferents_a_taxel_decide_in_a_stream_as_on_the_whole_trial(
    tmp_path, seed, sizes, afferents, conditioning, windows, at, backends
):
    chain = make_chain(conditioning, patience=5, windows=windows, seed=seed, afferents=afferents)
    signal = make_signal(200, seed=seed)
    raster, expected = offline(chain, signal)
    backends = backends if afferents == {"sa1.opposite": True} else ("reference", "reference")
    one, other = (Stream(chain, backend=each) for each in backends)
    found = [each for block in blocks_of(signal[:at], sizes) for each in one.push(block)]
    one.save(tmp_path / "state", force=True)
    other.load(tmp_path / "state")
    found += [each for block in blocks_of(signal[at:], sizes) for each in other.push(block)]
    assert told(fitting([*found, *other.finish()], len(raster), chain.windows.length)) == expected


@pytest.mark.parametrize("afferents", SEVERAL)
def test_the_compiled_step_sends_the_spikes_of_every_afferent_of_a_taxel(afferents):
    strong = {**afferents, "sa1.gain": 30.0, "ra1.gain": 300.0}
    chain, signal = make_chain({}, afferents=strong), make_signal(200, seed=1)
    traces: dict[str, list] = {backend: [] for backend in BACKENDS}
    for backend, found in traces.items():
        Stream(chain, backend=backend, watch=found.append).push(signal)
    sent = {backend: np.concatenate([each.afferents for each in found]) for backend, found in traces.items()}
    for found in sent.values():
        np.testing.assert_array_equal(found, sent["reference"])
    n = chain.n_taxels
    assert all(sent["reference"][:, i : i + n].any() for i in range(0, chain.network.n_inputs, n))


def test_the_made_chains_spike_and_decide_differently():
    """Else the law above would hold of silence."""
    labels, exits, hidden = set(), 0, 0
    for seed in range(6):
        chain = make_chain({}, patience=5, seed=seed)
        for _, label, steps, _, spikes in offline(chain, make_signal(400, seed=seed))[1]:
            labels.add(label)
            exits += steps < chain.windows.length
            hidden += spikes
    assert len(labels) > 1
    assert exits > 5
    assert hidden > 100


@given(cut=st.integers(0, 90), rate_Hz=st.sampled_from([1000.0, 1700.0]))
@examples(6)
def test_a_state_goes_on_where_it_was_taken(cut, rate_Hz):
    conditioning = {"ema_cutoff_Hz": 30.0, "baseline": "start", "resample_Hz": 1000.0}
    chain = make_chain(conditioning, rate_Hz=rate_Hz, windows={"length_ms": 30, "hop_ms": 9})
    signal = make_signal(90)
    one, other = Stream(chain), Stream(chain)
    before = one.push(signal[:cut])
    state = one.state()
    whole = before + one.push(signal[cut:])
    other.restore(state)
    assert before + other.push(signal[cut:]) == whole
    other.restore(state)  # what was pushed since has not changed it
    assert before + other.push(signal[cut:]) == whole
    one.reset()
    assert one.push(signal) == whole


def test_a_stream_has_no_more_windows_under_way_than_overlap():
    chain = make_chain({}, windows={"length_ms": 30, "hop_ms": 7})
    stream, most = Stream(chain), 0
    for sample in make_signal(200):
        stream.push(sample)
        most = max(most, len(stream.state().windows))
    assert chain.windows.at_once == 5
    assert most == 5


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("model", ["rsnn", "snn"])
def test_a_decision_costs_its_input_spikes_and_its_hidden_spikes_each_at_their_fan_out(model, backend):
    """Of 6 hidden neurons and 3 classes: an input spike reaches 6 neurons, a hidden one 3, or 9 with recurrence."""
    chain = make_chain({}, model=model)
    decisions = [d for d in Stream(chain, backend=backend).decide([make_signal(200)]) if d.hidden_spikes]
    assert decisions
    for each in decisions:
        assert each.input_spikes != each.hidden_spikes
        assert each.sops == 6 * each.input_spikes + (9 if model == "rsnn" else 3) * each.hidden_spikes


def test_a_baseline_of_the_whole_trial_is_refused_with_the_fix():
    network = RSNN(4, 2, hidden=3, sampling_rate_Hz=1000.0)
    with pytest.raises(InputError, match=r"a stream has not received the whole trial.*conditioning.baseline start"):
        Stream((make_encoder(baseline="mean"), network))


@pytest.mark.parametrize(
    ("encoder", "n_inputs", "options", "message"),
    [
        (specs.load("izhikevich"), 4, {}, "would make their integration unstable"),
        (make_encoder(), 3, {}, "receives 3 afferents, not one SA-I and one RA-I under each taxel"),
        (make_encoder({"sa1.grades": [0.5, 1.0]}), 4, {}, "receives 4 afferents, not 3 under each taxel"),
        (make_encoder(offset=(1.0, 2.0, 3.0)), 4, {}, "offset has 3 values"),
        (make_encoder(), 4, {"sampling_rate_Hz": 500.0}, "come at 500 Hz but"),
        (make_encoder(resample_Hz=1000.0), 4, {}, "rate of the samples must be given"),
        (make_encoder(resample_Hz=900.0), 4, {"sampling_rate_Hz": 500.0}, "resamples to 900 Hz"),
        (make_encoder(), 4, {"length_ms": 100, "hop_ms": 1}, "100 windows would overlap"),
        (make_encoder(), 4, {"contact": True, "quiet_ms": 0.1}, "quiet_ms"),
    ],
)
def test_a_chain_that_cannot_be_carried_is_refused(encoder, n_inputs, options, message):
    with pytest.raises(InputError, match=message):
        chain_of((encoder, RSNN(n_inputs, 2, hidden=3, sampling_rate_Hz=1000.0)), nt.Streamed(**options))


@pytest.mark.filterwarnings("ignore:window.align")
def test_a_network_of_windows_from_the_onset_of_contact_is_told_where_they_begin(tmp_path):
    """They do not begin with the trial: `infer` and a stream would decide other windows."""
    folder, window = make_run(tmp_path), nt.Window(length_ms=40, align="onset", onset=nt.Onset(rest_ms=20))
    settings = {"hidden": 3, "training.epochs": 1}
    nt.train(folder / "spikes.h5", folder / "onset", "rsnn", settings, window=window)
    for run in (lambda how: Stream(folder / "onset", streamed=how),
                lambda how: nt.export_c(folder / "onset", folder / "c", streamed=how)):  # fmt: skip
        with pytest.raises(InputError, match=r"onset: was trained on windows from the onset of contact.*contact=True"):
            run(nt.Streamed())
        run(nt.Streamed(contact=True, quiet_ms=5))
    assert Stream(folder / "onset", streamed=nt.Streamed(hop_ms=20)).chain.windows.hop == 20


@pytest.mark.parametrize("samples", [np.zeros((3, 5)), np.zeros((1, 2, 2)), np.zeros(3), [["a", "b"]]])
def test_samples_of_another_shape_are_refused(samples):
    with pytest.raises(InputError, match="samples"):
        Stream(make_chain({})).push(samples)


def test_a_nan_is_the_last_good_value_and_is_counted():
    chain = make_chain({"ema_cutoff_Hz": 30.0})
    signal = make_signal(120)
    spoilt, held = signal.copy(), signal.copy()
    spoilt[50, 1] = np.nan
    spoilt[90:92, 0] = np.inf
    held[50, 1] = signal[49, 1]
    held[90:92, 0] = signal[89, 0]
    stream, clean = Stream(chain), Stream(chain)
    found = stream.push(spoilt)
    assert [d._replace(held=0) for d in found] == clean.push(held)
    assert [d.held for d in found] == [0, 1, 2]
    assert stream.tally.trouble() == "held 3"


@pytest.mark.parametrize("way", ["nan", "missing"])
def test_a_gap_begins_anew_and_drops_what_it_cut(way):
    chain = make_chain({"baseline": "start"})
    signal = make_signal(300)
    stream, alone = Stream(chain, hold_ms=5), Stream(chain, hold_ms=5)
    found = stream.push(signal[:70])
    if way == "nan":
        found += stream.push(np.full((10, 2), np.nan))
    else:
        found += stream.missing(10)
    after = stream.push(signal[80:])
    assert stream.tally.gaps == 1
    assert stream.tally.dropped == 1
    assert [d.time_s for d in found] == [0.04]
    assert told(after) == [(s, *rest) for s, *rest in told(alone.push(signal[80:]))]
    assert after[0].time_s == pytest.approx(0.08 + 0.04)
    assert [d.window for d in after][:2] == [2, 3]


def test_missing_samples_within_hold_ms_repeat_the_last():
    chain = make_chain({})
    signal = make_signal(80)
    filled = np.concatenate([signal[:30], np.repeat(signal[29:30], 3, axis=0), signal[30:]])
    stream = Stream(chain, hold_ms=5)
    found = stream.push(signal[:30]) + stream.missing(3) + stream.push(signal[30:])
    assert told(found) == told(Stream(chain).push(filled))
    assert found[0].held == 3
    assert stream.tally.missing == 3


FORMS = {
    "one sample": lambda block: list(block),
    "float32 in one piece": lambda block: [block],
    "float64": lambda block: [block.astype(float)],
    "with strides": lambda block: [np.repeat(block, 2, axis=1)[:, ::2]],
    "column by column": lambda block: [np.asfortranarray(block)],
    "lists": lambda block: [block.tolist()],
    "read-only": lambda block: [np.frombuffer(block.tobytes(), np.float32).reshape(block.shape)],
    "nothing": lambda block: [block[:0], block],
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_form_of_the_samples_changes_nothing(form, backend):
    chain, signal = make_chain({}), make_signal(80)
    stream, plain = Stream(chain, backend=backend), Stream(chain, backend="reference")
    found = [each for part in FORMS[form](signal) for each in stream.push(part)]
    assert found == plain.push(signal)
    assert stream.tally == plain.tally
    assert np.array_equal(stream.state().good, signal[-1])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_buffer_that_is_used_again_changes_no_sample_of_the_past(backend):
    chain, signal = make_chain({}), make_signal(60)
    stream, plain = (Stream(chain, backend=backend) for _ in range(2))
    buffer, found = np.empty_like(signal[0]), []
    for sample in signal:
        buffer[:] = sample
        found += stream.push(buffer)
    buffer[:] = 1000.0
    found += stream.missing(3)
    assert found == plain.push(signal) + plain.missing(3)
    assert stream.tally == plain.tally


def test_samples_that_are_missing_one_by_one_become_a_gap_too():
    stream = Stream(make_chain({}), hold_ms=5)
    stream.push(make_signal(20))
    for _ in range(4):
        stream.missing(1)
    stream.push(np.full((1, 2), np.nan))
    assert stream.tally.gaps == 0
    stream.missing(1)
    assert stream.tally.gaps == 1
    stream.push(make_signal(20))
    assert (stream.tally.gaps, stream.state().bad_in_a_row) == (1, 0)


def test_nothing_is_decided_while_a_taxel_is_dead():
    chain = make_chain({})
    signal = make_signal(500)
    signal[:, 1] = np.nan
    stream = Stream(chain)
    assert stream.push(signal) == []
    assert stream.tally.skipped == 500


def test_the_unit_is_converted():
    chain = make_chain({})
    signal = make_signal(80)
    assert told(Stream(chain, unit="V").push(signal / np.float32(1000.0))) == told(Stream(chain).push(signal))
    with pytest.raises(InputError, match="'count' but 'mV'"):
        Stream(chain, unit="count")


def test_finish_counts_what_it_cuts_off():
    stream = Stream(make_chain({}))
    stream.push(make_signal(100))
    assert stream.finish() == []
    assert stream.tally.unfinished == 1
    assert stream.state().opening.step == 0


@pytest.mark.skipif(not native, reason="no compiled kernels")
@given(
    seed=st.integers(0, 50),
    sizes=st.lists(st.integers(1, 40), min_size=1, max_size=4),
    cuts=st.lists(st.integers(0, 250), max_size=3),
    n_taxels=st.sampled_from([1, 3, 8, 9]),
    conditioning=st.sampled_from([{}, {"baseline": "start", "start_ms": 15.0}]),
    adapting=st.sampled_from([{}, ADAPTING]),
)
@examples(30)
def test_the_compiled_step_remembers_and_counts_what_the_reference_does(
    seed, sizes, cuts, n_taxels, conditioning, adapting
):
    """Spoilt samples, gaps and trials' ends in between: every decision, count and state is the same."""
    chain = make_chain(conditioning, n_taxels=n_taxels, windows=WINDOWS[1], patience=3, seed=seed, **adapting)
    signal = make_signal(260, n_taxels, seed)
    for cut in cuts:
        signal[cut : cut + 1 + cut % 9] = np.nan
    streams = [Stream(chain, backend=each) for each in BACKENDS]
    found = [[stream.push(block) for block in blocks_of(signal, sizes)] for stream in streams]
    assert found[0] == found[1]
    reference, compiled = (stream.state() for stream in streams)
    assert reference.tally == compiled.tally
    assert (reference.opening, reference.n_windows, reference.origin) == (
        compiled.opening, compiled.n_windows, compiled.origin,
    )  # fmt: skip
    for mine, theirs in zip(reference.windows, compiled.windows, strict=True):
        assert mine[:3] == theirs[:3]
        assert all(np.array_equal(a, b) for a, b in zip(mine.hidden, theirs.hidden, strict=True))
    assert streams[0].finish() == streams[1].finish()


@pytest.mark.skipif(not native, reason="no compiled kernels")
@given(
    readout=st.sampled_from([*READOUTS]),
    adapting=st.sampled_from([{}, ADAPTING]),
    baseline=st.sampled_from(["none", "start", "high-pass"]),
    n_taxels=st.sampled_from([1, 8, 9]),
    cut=st.integers(0, 90),
)
@example(readout="leaky", adapting={}, baseline="start", n_taxels=9, cut=47)
@example(readout="count", adapting=ADAPTING, baseline="start", n_taxels=9, cut=31)
@examples(30)
def test_a_state_goes_from_the_compiled_step_to_the_reference_and_back(readout, adapting, baseline, n_taxels, cut):
    """In the middle of windows and of a step of the network, whose spikes wait."""
    settings = {"recurrent_weight_scale": 0.4, "step_ms": 2.0} | ({} if readout == "max" else adapting)
    chain = make_chain(
        {"baseline": baseline, "ema_cutoff_Hz": 30.0}, n_taxels=n_taxels, readout=readout,
        windows={"length_ms": 30, "hop_ms": 9}, **settings,
    )  # fmt: skip
    signal, streams = make_signal(120, n_taxels), [Stream(chain, backend=each) for each in BACKENDS]
    before = [stream.push(signal[:cut]) for stream in streams]
    states = [stream.state() for stream in streams]
    if cut:
        afferents = [(*state.encoder.sa1, *state.encoder.ra1, state.encoder.last) for state in states]
        assert all(np.array_equal(one, other) for one, other in zip(*afferents, strict=True))
    rest = [stream.push(signal[cut:]) for stream in streams]
    assert before[0] == before[1]
    assert rest[0] == rest[1]
    for stream, state in zip(streams, states[::-1], strict=True):
        stream.restore(state)
        assert stream.push(signal[cut:]) == rest[0]


@pytest.mark.skipif(not native, reason="no compiled kernels")
@pytest.mark.parametrize("readout", [*READOUTS])
def test_a_state_of_another_size_is_refused_by_the_compiled_step(readout):
    stream = Stream(make_chain({}, readout=readout, windows={"length_ms": 30, "hop_ms": 7}), backend="native")
    stream.push(make_signal(50))
    compiled = stream._compiled
    content, layout = compiled._stream.state(), compiled._layout
    n_windows = int(np.frombuffer(content, layout.stream, 1)[0]["under_way"])
    assert n_windows == 5
    assert len(content) == layout.stream.itemsize + n_windows * layout.window.itemsize
    more = np.frombuffer(content, layout.stream, 1).copy()
    for under_way in (-1, 6):
        more["under_way"] = under_way
        with pytest.raises(ValueError, match="too many windows"):
            compiled._stream.restore(more.tobytes() + content[layout.stream.itemsize :])
    for changed in (content[:-1], content + b"0", b"", content[:20]):
        with pytest.raises(ValueError, match="state: "):
            compiled._stream.restore(changed)


@pytest.mark.slow
@pytest.mark.skipif(not native, reason="no compiled kernels")
def test_ten_minutes_of_gratings_do_not_drift():
    """1.2 million samples in uneven blocks decide as the whole trial does, to the last window."""
    encoder = specs.load("sa1-ra1-lif", {"conditioning.baseline": "start", "sa1.gain": 6.4, "ra1.gain": 32})
    network = RSNN(16, 8, hidden=30, sampling_rate_Hz=2000.0, generator=torch.Generator().manual_seed(0))
    chain = chain_of((encoder, network), nt.Streamed(length_ms=150))._replace(rule=ExitRule(180, from_first_spike=True))
    slides = np.concatenate(
        list(simulator("gratings").simulate(simulator("gratings").build({"trials": 1}, "test")).signals)
    )
    signal = np.resize(slides, (1_200_000, 8)).astype(np.float32)
    raster, expected = offline(chain, signal)
    found = list(Stream(chain, backend="native").decide(blocks_of(signal, [1, 100, 333, 7])))
    assert len(expected) == 4000
    assert told(fitting(found, len(raster), chain.windows.length)) == expected
    assert sum(row[4] for row in expected) > 10_000
