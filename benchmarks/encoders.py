"""Every encoder beside a plain NumPy loop over the steps of one trial after the other, and beside spike-encoding.

    python benchmarks/encoders.py --peers loop spike-encoding --json encoders.json

The loop is vectorised over the taxels of a trial, as one writes it from the equations; for LIF afferents it is their
definition in NumPy. spike-encoding (PyPI, 1.8) steps through time in torch, all trials at once;
its step-forward gives our spikes but where the signal meets the threshold exactly. LIF afferents in closed form, on a
tenth of the samples, are beside their definition in NumPy and, as `clock`, beside the kernel that steps at 1 kHz; the
interpolation of the samples that it takes is not timed. Processor time of one thread, in turns of one run.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from side_by_side import Row, missing, parse, publish

from neurotact.encoders import afferents, closed_form
from neurotact.encoders.model import EncoderSpec, usable
from neurotact.encoders.specs import default_of, encode, load

RATE_HZ = 1000.0
CASES = {"small": (24, 500, 8), "large": (600, 2000, 16)}
PACKAGES = ("numpy", "torch", "spike-encoding")
SETTINGS = {
    "send-on-delta": {"threshold": 4.0},
    "step-forward": {"threshold": 4.0},
    "moving-window": {"threshold": 10.0},
    "sigma-delta": {"threshold_unit_ms": 300.0},
}
"""Where the shipped values are for other signals."""
FEW_ROWS = 4
SLOWER = 10
"""Steps of the clock in a sample of the sensor whose afferents are in closed form."""
ON_A_CLOCK = load("sa1-ra1-lif", {"conditioning.resample_Hz": RATE_HZ})
EXACT = ON_A_CLOCK.model_copy(update={"integration": "exact"})


def signals(n_trials: int, n_steps: int, n_taxels: int) -> np.ndarray:
    """Sums of two sines of 1 to 20 Hz, of some 20 units, `(trial, time, taxel)` float32."""
    rng, time_s = np.random.default_rng(0), np.arange(n_steps) / RATE_HZ
    turns = rng.uniform(1, 20, (2, n_trials, 1, n_taxels)) * time_s[:, None] + rng.random((2, n_trials, 1, n_taxels))
    return (10 * np.sin(2 * np.pi * turns).sum(axis=0)).astype(np.float32)


class Timed(NamedTuple):
    """What is timed, and by what its time is multiplied."""

    run: Callable[[], object]
    times: float = 1.0


def loop(signal: np.ndarray, spec: EncoderSpec) -> Timed:
    """One trial after the other."""
    if isinstance(spec, afferents.AfferentSpec):  # they have a kernel in C++
        return Timed(lambda: [afferents.encode(trial[None], RATE_HZ, spec, backend="reference") for trial in signal])
    return Timed(lambda: [encode(trial[None], RATE_HZ, spec) for trial in signal])


def spike_encoding(signal: np.ndarray, spec: EncoderSpec) -> Timed | None:
    """Its step-forward and its Ben's spiker, all trials and taxels as rows; None for models that it lacks.

    Its Ben's spiker loops over rows, each of which takes as long: a few are timed.
    """
    rows = torch.from_numpy(np.ascontiguousarray(signal.transpose(0, 2, 1)).reshape(-1, signal.shape[1]))
    if spec.model == "step-forward":
        from spike_encoding.step_forward_converter import StepForwardConverter

        of_theirs = StepForwardConverter(threshold=[spec.threshold] * len(rows))
        found, mine = of_theirs.encode(rows).abs().sum().item(), encode(signal, RATE_HZ, spec)[0].sum()
        assert abs(found - mine) < 0.01 * mine, (found, mine)
        return Timed(lambda: of_theirs.encode(rows))
    if spec.model == "bens-spiker":
        from spike_encoding.bens_spiker_algorithm import BensSpikerAlgorithm

        order = round(spec.filter_ms * 1e-3 * RATE_HZ)
        few = rows[:FEW_ROWS]
        each = len(few)
        of_theirs = BensSpikerAlgorithm([0.5] * each, filter_order=[order] * each, filter_cutoff=[0.2] * each)
        return Timed(lambda: of_theirs.encode(few.clone()), len(rows) / each)
    return None


PEERS = {"loop": loop, "spike-encoding": spike_encoding}


def definition_of_exact(signal: np.ndarray, rate_Hz: float) -> Timed:
    """All trials at once, sample by sample."""
    return Timed(lambda: closed_form.encode(signal, rate_Hz, EXACT, backend="reference"))


def clock(signal: np.ndarray, rate_Hz: float) -> Timed:
    resampled = np.repeat(signal, round(RATE_HZ / rate_Hz), axis=1)
    return Timed(lambda: afferents.encode(resampled, RATE_HZ, ON_A_CLOCK))


def rows_of_exact(case: str, rounds: int) -> list[Row]:
    """Of a sensor that is slower than the clock."""
    signal, rate_Hz = np.ascontiguousarray(signals(*CASES[case])[:, ::SLOWER]), RATE_HZ / SLOWER
    share = 1e3 * float(closed_form.encode(signal, rate_Hz, EXACT)[0].mean())
    rows = []
    for peer, of in (("definition", definition_of_exact), ("clock", clock)):
        theirs = of(signal, rate_Hz)
        mine_ms, peer_ms = medians_ms(lambda: closed_form.encode(signal, rate_Hz, EXACT), theirs, rounds)
        note = f"{mine_ms / signal.size * 1e6:.0f} ms for a million samples; {share:.0f} spikes in 1000 steps"
        rows.append(Row(f"{case} lif, exact", peer, mine_ms, peer_ms, peer_ms / mine_ms, note))
    return rows


def seconds(run: Callable[[], object]) -> float:
    start = time.thread_time()
    run()
    return time.thread_time() - start


def medians_ms(ours: Callable[[], object], theirs: Timed, rounds: int) -> tuple[float, float]:
    """In turns."""
    taken = np.array([[seconds(ours), theirs.times * seconds(theirs.run)] for _ in range(rounds)])
    mine_ms, peer_ms = 1e3 * np.median(taken, axis=0)
    return float(mine_ms), float(peer_ms)


def rows_of(case: str, peers: list[str], rounds: int) -> list[Row]:
    signal, rows = signals(*CASES[case]), []
    n_samples = signal.size / 1e6
    for model in usable():
        spec = load(default_of(model), SETTINGS.get(model, {}))

        def ours(spec: EncoderSpec = spec) -> object:
            return encode(signal, RATE_HZ, spec)

        share = 1e3 * float(encode(signal, RATE_HZ, spec)[0].mean())
        for peer in peers:
            try:
                theirs = PEERS[peer](signal, spec)
            except ImportError as error:
                missing(peer, error)
                continue
            if theirs is None:
                continue
            mine_ms, peer_ms = medians_ms(ours, theirs, rounds)
            note = f"{mine_ms / n_samples:.0f} ms for a million samples; {share:.0f} spikes in 1000 steps"
            rows.append(Row(f"{case} {model}", peer, mine_ms, peer_ms, peer_ms / mine_ms, note))
    return rows


def main() -> None:
    asked = parse(tuple(CASES), tuple(PEERS), __doc__ or "")
    torch.set_num_threads(1)
    rows = [row for case in asked.case for row in rows_of(case, asked.peers, asked.rounds)]
    if "loop" in asked.peers:
        rows += [row for case in asked.case for row in rows_of_exact(case, asked.rounds)]
    publish(rows, PACKAGES, asked.json)


if __name__ == "__main__":
    main()
