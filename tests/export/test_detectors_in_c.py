"""A detector in C: the label in force changes as in a stream and in whole recordings, to the last bit."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
import torch
from compiled import compare, compare_on, given_to
from driven import Do, Driven, streamed
from levels import thinned
from made_chains import ADAPTING, make_chain, make_signal
from neurotact_parts.exporters.c import c_export, proof
from neurotact_parts.exporters.c.boards import BOARDS
from neurotact_parts.streams import detector
from neurotact_parts.streams.chain import PASSING, WITHOUT_END, Chain
from neurotact_parts.streams.stream import Stream
from test_c_guards import records_of, same

from neurotact.networks.training.events import DetectorSpec
from neurotact.networks.training.sparsity import prune

needs_compiler = pytest.mark.skipif(proof.missing("cc") is not None, reason="there is no C compiler")
ABSENT = proof.missing("arm-none-eabi-gcc", "qemu-system-arm")
SLOW = {"step_ms": 3.0}
KINDS: dict[str, tuple[dict, dict]] = {
    "plain": ({}, {}),
    "slow clock": ({"baseline": "start"}, SLOW),
    "adapting on a slow clock": ({"baseline": "high-pass", "high_pass_Hz": 2.0}, {**SLOW, **ADAPTING}),
    "adapting below zero": ({}, {**ADAPTING, "learn": ["threshold"]}),
    "averaged": ({"ema_cutoff_Hz": 60.0}, {}),
    "pruned": ({}, {}),
    "faster": ({"resample_Hz": 1000.0, "baseline": "start"}, {"rate_Hz": 400.0}),
    "closed form": (
        {"resample_Hz": 1000.0, "baseline": "start", "start_ms": 30.0},
        {"rate_Hz": 400.0, "afferents": {"integration": "exact"}},
    ),
    "events of a sensor": ({}, SLOW),
}
BEYOND = 2**32


def made(kind: str, rule: DetectorSpec | None = None) -> Chain:
    """A chain without windows, of which no label leads for ever."""
    conditioning, options = KINDS[kind]
    chain = make_chain(conditioning, **{"readout": "leaky", "model": "snn", **options})
    network = chain.network
    if kind == "pruned":
        prune(network, 0.4)
    if kind == "adapting below zero":
        with torch.no_grad():
            network.threshold[0] = -0.05
    if kind == "events of a sensor":
        chain = chain._replace(encoder=PASSING, takes_events=True)
    rng = np.random.default_rng(0)
    _, values = detector.run_on(network, (rng.random((2000, network.n_inputs)) < 0.1).astype(np.uint8))
    assert network.bias is not None
    with torch.no_grad():
        network.bias.sub_(torch.from_numpy(values.mean(axis=0)).float())
    rule = rule or DetectorSpec(threshold=0.2 * float(values.std()), steps=2)
    return chain._replace(detector=rule, windows=WITHOUT_END, classes=("none", "contact", "slip"))


def told_by(stream: Stream, signal: np.ndarray) -> list[tuple[int, ...]]:
    """What a stream tells of a trial, as C does."""
    if stream.chain.takes_events:
        steps, units = np.nonzero(signal)
        decisions = [*stream.push_events(steps / 1000.0, units), *stream.advance(len(signal) / 1000.0)]
    else:
        decisions = [*stream.push(signal), *stream.finish()]
    sops = stream.chain.network.synapses
    return [
        (
            d.window,
            d.start_step,
            d.steps,
            d.input_spikes,
            d.hidden_spikes,
            *([d.sops] if sops else []),
            d.heard,
            d.index,
        )
        for d in decisions
    ]


@needs_compiler
@thinned("kind", [*KINDS], every=3)
def test_c_tells_what_whole_recordings_and_a_stream_tell(kind, tmp_path):
    chain = made(kind)
    difference, expected = compare(chain, tmp_path, None, n_samples=300)
    assert difference is None
    for seed, trial in enumerate(expected):
        assert told_by(Stream(chain), given_to(chain, 300 - 7 * seed, seed)) == trial.decisions
    assert len({row[-1] for trial in expected for row in trial.decisions}) > 1
    assert sum(len(trial.decisions) for trial in expected) > 5
    for change in (
        lambda rows: rows[:-1],
        lambda rows: [*rows, (len(rows), *rows[-1][1:])],
    ):  # neither is cut off as a window is
        wrong = [trial._replace(decisions=change(trial.decisions), runs_on=False) for trial in expected]
        assert proof.first_difference(list(proof.cut_off(wrong, expected)), expected) is not None


@needs_compiler
@pytest.mark.parametrize(("threshold", "steps"), [(0.0, 1), (0.0, 5), (0.3, 2), (1.0, 1)])
def test_a_label_comes_into_force_by_the_rule_of_the_run(threshold, steps, tmp_path):
    chain = made("plain", DetectorSpec(threshold=threshold, steps=steps))
    difference, expected = compare(chain, tmp_path, None, n=2, n_samples=400, flags=("-O0",))
    assert difference is None
    assert sum(len(trial.decisions) for trial in expected) > 3


@needs_compiler
def test_a_lead_that_is_equal_to_the_threshold_is_none(tmp_path):
    """Of whole values, whose leads are often equal to the threshold."""
    for threshold in (0.0, 1.0, 2.0):
        chain = make_chain({}, readout="integrator", model="snn")._replace(
            detector=DetectorSpec(threshold=threshold, steps=2), windows=WITHOUT_END
        )
        with torch.no_grad():
            chain.network.w_out.copy_(torch.tensor([[1, -1, 0], [-1, 0, 1], [0, 1, -1]] * 2))
        difference, expected = compare(chain, tmp_path / str(threshold), None, n=3, n_samples=400, flags=("-O0",))
        assert difference is None
        assert expected[0].decisions


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """An export of a kind, compiled once with sanitizers."""
    made_already: dict[str, Driven] = {}

    def of(kind: str) -> Driven:
        if kind not in made_already:
            made_already[kind] = Driven(made(kind), None, tmp_path_factory.mktemp("c"))
        return made_already[kind]

    return of


@needs_compiler
@pytest.mark.parametrize("kind", ["adapting on a slow clock", "faster"])
def test_missing_values_gaps_and_resets_do_to_a_detector_what_they_do_to_a_stream(kind, driven):
    exported, n_changes = driven(kind), 0
    for seed in range(3):
        records = records_of(seed, 800, exported.chain)
        expected = streamed(exported.chain, records)
        assert same(exported.run(records), expected)
        n_changes += len(expected.decisions)
        assert sum(row[5] for row in expected.decisions)  # steps on repeated values
    assert n_changes > 20


@needs_compiler
@pytest.mark.parametrize("kind", ["adapting on a slow clock", "adapting below zero"])
def test_no_step_is_the_last_of_a_detector(kind, driven):
    """Over the step and the change at which a counter of 32 bits ends, whose network's step is no power of two."""
    exported = driven(kind)
    state = Stream(exported.chain, backend="reference").state()
    begun = BEYOND - 400
    averages = state.conditioned._replace(carried=(np.zeros(2), 0))
    state = replace(state, opening=replace(state.opening, step=begun), conditioned=averages, n_windows=BEYOND - 3)
    pushed: list[Do] = [("push", row) for row in make_signal(3000, seed=3)]
    plain, aged = exported.run(pushed), exported.run([("age", state), *pushed])
    assert aged.steps == plain.steps
    assert aged.decisions == [
        ((number + BEYOND - 3) % BEYOND, (start + begun) % BEYOND, *rest) for number, start, *rest in plain.decisions
    ]
    starts = [row[1] for row in aged.decisions]
    assert {BEYOND - 3, BEYOND - 1, 0} <= {row[0] for row in aged.decisions}
    assert max(starts) > BEYOND - 400
    assert min(starts) < 400


@needs_compiler
@pytest.mark.parametrize("kind", ["plain", "slow clock"])
def test_no_count_of_a_detector_grows_by_which_its_network_steps(kind, tmp_path):
    chain = made(kind)
    c_export.write(chain, tmp_path, None)
    source = """#include "touch.h"
        int main(void)
        {
            static touch_chain chain;
            static touch_sample sample[TOUCH_TAXELS];
            touch_decision decisions[TOUCH_MOST_DECISIONS];
            touch_reset(&chain);
            for (int i = 0; i < 100; i++) touch_push(&chain, sample, decisions);
            return (int)chain.windows[0].steps;
        }"""
    (tmp_path / "main.c").write_text(source)
    subprocess.run(["cc", "-std=c99", "touch.c", "main.c", "-o", "main"], cwd=tmp_path, check=True)
    n = chain.network.steps_per_bin
    assert n < subprocess.run([tmp_path / "main"], check=False).returncode <= 2 * n


@pytest.mark.skipif(ABSENT is not None, reason=str(ABSENT))
@thinned("kind", ["slow clock", "pruned", "events of a sensor"], every=3)
def test_an_emulated_cortex_m0_tells_the_same(kind, tmp_path):
    chain = made(kind)
    signals = [given_to(chain, 250, seed=seed) for seed in range(2)]
    difference, expected = compare_on(signals, chain, tmp_path, None, board=BOARDS["cortex-m0"])
    assert difference is None
    assert expected[0].decisions


def test_the_header_tells_of_changes_and_of_no_windows(tmp_path):
    c_export.write(made("plain"), tmp_path, None)
    header, readme = (tmp_path / "touch.h").read_text(), (tmp_path / "README.md").read_text()
    assert "WINDOW_STEPS" not in header
    assert "number of this change" in header
    assert "It runs on without windows." in readme
    assert "A window" not in readme
    c_export.write(made("plain")._replace(detector=None, windows=make_chain({}).windows), tmp_path / "other", None)
    assert "number of the window" in (tmp_path / "other" / "touch.h").read_text()
