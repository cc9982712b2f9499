"""What one sample of 8 taxels costs a chain with 30 hidden neurons: `nt.Stream`, compiled or not, and exported C.

Processor time of this thread for each sample, less that of reading the clock: median, 99th and 99.9th percentile, each
the median of several rounds. `nt.Stream` takes samples one at a time and in blocks of 100, whose time is divided by
100. The time between samples of the texture paper's sensor is 500 µs; fingers a core: how many such streams 99.9 % of
the samples leave time for. Interrupts count as time of the thread that they interrupt, and strike other samples in each
round: a sum that takes as long as a sample shows what they do alone, and the median of each sample over the rounds,
which begin alike, what the chain costs without them.
"""

import argparse
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from neurotact_parts.exporters.c import c_export, formats
from neurotact_parts.streams.chain import Chain, chain_of

import neurotact as nt
from neurotact.backend import Backend
from neurotact.encoders import afferents, specs
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training.ranges import record

TIMER = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "touch.h"

static double now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

int main(void)
{
    static touch_chain chain;
    touch_sample sample[TOUCH_TAXELS];
    touch_decision decisions[TOUCH_MOST_DECISIONS];
    touch_reset(&chain);
    while (fread(sample, sizeof sample, 1, stdin) == 1) {
        const double began = now_ns();
        touch_push(&chain, sample, decisions);
        const double done = now_ns();
        printf("%.0f\\n", done - began - (now_ns() - done));
    }
    return 0;
}
"""


def made() -> tuple[Chain, np.ndarray]:
    """The paper's network on its simulated gratings, untrained but as lively, and a minute of samples."""
    encoder = specs.load("sa1-ra1-lif", {"conditioning.baseline": "start", "sa1.gain": 6.4, "ra1.gain": 32})
    generator = torch.Generator().manual_seed(0)
    network = nt.RSNN(16, 8, hidden=30, forward_weight_scale=1.0, sampling_rate_Hz=2000.0, generator=generator)
    chain = chain_of((encoder, network), nt.Streamed(length_ms=150))._replace(rule=ExitRule(180, from_first_spike=True))
    return chain, np.concatenate(list(nt.simulate("gratings", trials=1).signals))


def each_ns(call: Callable[[Any], object], parts: Iterable[Any]) -> np.ndarray:
    """Of each call, less what reading the clock takes."""
    clock_ns, took = time.thread_time_ns, []
    for part in parts:
        began = clock_ns()
        call(part)
        done = clock_ns()
        took.append(2 * done - began - clock_ns())
    return np.array(took, float)


def stream_ns(chain: Chain, samples: np.ndarray, block: int, backend: Backend) -> np.ndarray:
    stream = nt.Stream(chain, backend=backend)
    stream.push(samples[:100])
    return each_ns(stream.push, np.split(samples[: len(samples) // block * block], len(samples) // block)) / block


def step_ns(chain: Chain, samples: np.ndarray) -> np.ndarray:
    """The compiled step alone, called as `nt.Stream` calls it."""
    stream = nt.Stream(chain, backend="native")
    assert stream._compiled is not None
    return each_ns(stream._compiled.take, samples)


def loop_ns(samples: np.ndarray, like_ns: float) -> np.ndarray:
    """A sum of whole numbers that takes about `like_ns`."""
    whole = [range(n) for n in range(200)]
    took = [np.median(each_ns(sum, [numbers] * 1000)) for numbers in whole]
    return each_ns(sum, [whole[int(np.searchsorted(took, like_ns))]] * len(samples))


def c_ns(chain: Chain, samples: np.ndarray, *, integer: bool) -> np.ndarray:
    with tempfile.TemporaryDirectory() as scratch:
        folder, chosen = Path(scratch), None
        if integer:
            raster = afferents.encode(samples[None, :2000], chain.clock_Hz, chain.encoder)[0]
            windows = torch.from_numpy(raster[:, : chain.windows.length])
            chosen = formats.choose(chain, record(chain.network, windows, [samples]))
            samples = chosen.raw.samples(samples)
        c_export.write(chain, folder, chosen)
        (folder / "timer.c").write_text(TIMER)
        subprocess.run(["cc", "-std=c99", "-O2", "touch.c", "timer.c", "-o", "timer"], cwd=folder, check=True)
        told = subprocess.run([folder / "timer"], input=samples.tobytes(), capture_output=True, check=True).stdout
    return np.array(told.split(), float)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    torch.set_num_threads(1)
    chain, samples = made()
    samples = samples[: given.samples]
    few = samples[: given.samples // 100]
    like_ns = float(np.median(stream_ns(chain, samples, 1, "native")))
    rows = {
        "nt.Stream, reference, blocks of 1": lambda: stream_ns(chain, few, 1, "reference"),
        "nt.Stream, compiled, blocks of 1": lambda: stream_ns(chain, samples, 1, "native"),
        "its step alone, blocks of 1": lambda: step_ns(chain, samples),
        "a sum that takes as long": lambda: loop_ns(samples, like_ns),
        "nt.Stream, compiled, blocks of 100": lambda: stream_ns(chain, samples, 100, "native"),
        "C, float": lambda: c_ns(chain, samples, integer=False),
        "C, integer": lambda: c_ns(chain, samples, integer=True),
    }
    for name, measure in rows.items():
        rounds = np.array([measure() for _ in range(given.rounds)]) / 1e3
        single = np.percentile(rounds, [50, 99, 99.9], axis=1)
        median, high, highest = np.median(single, axis=1)
        own = np.percentile(np.median(rounds, axis=0), 99.9)
        print(
            f"{name}: median {median:.2f} µs, 99 % {high:.2f} µs, 99.9 % {highest:.2f} µs ({single[2].min():.2f} to "
            f"{single[2].max():.2f} in {given.rounds} rounds); each sample's median over rounds, 99.9 % {own:.2f} µs; "
            f"{int(500 / highest)} fingers a core",
            flush=True,
        )


if __name__ == "__main__":
    main()
