"""What one sample of 8 taxels costs a chain with 30 hidden neurons: `nt.Stream`, compiled or not, and exported C.

Processor time of this thread for each sample, so that other processes do not count: median, 99th and 99.9th percentile.
`nt.Stream` takes samples one at a time and in blocks of 100, whose time is divided by 100. The time between samples of
the texture paper's sensor is 500 µs; fingers a core: how many such streams 99.9 % of the samples leave time for.
"""

import argparse
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

import neurotact as nt
from neurotact.deploy import c_export, formats
from neurotact.deploy.chain import Chain, chain_of
from neurotact.encoders import afferents, specs
from neurotact.networks.early_exit import ExitRule

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
        printf("%.0f\\n", now_ns() - began);
    }
    return 0;
}
"""


def made() -> tuple[Chain, np.ndarray]:
    """The paper's network on its simulated gratings, untrained but as lively, and a minute of samples."""
    encoder = specs.load("sa1-ra1-lif", {"conditioning.baseline": "start", "sa1.gain": 6.4, "ra1.gain": 32})
    generator = torch.Generator().manual_seed(0)
    network = nt.RSNN(16, 8, hidden=30, forward_weight_scale=1.0, sampling_rate_Hz=2000.0, generator=generator)
    chain = chain_of((encoder, network), length_ms=150)._replace(rule=ExitRule(180, from_first_spike=True))
    return chain, np.concatenate(list(nt.simulate("gratings", trials=1).signals))


def stream_ns(chain: Chain, samples: np.ndarray, block: int, backend: str) -> np.ndarray:
    stream, took = nt.Stream(chain, backend=backend), np.empty(len(samples) // block)
    stream.push(samples[:100])
    for i in range(len(took)):
        part = samples[i * block : (i + 1) * block]
        began = time.thread_time_ns()
        stream.push(part)
        took[i] = time.thread_time_ns() - began
    return took / block


def step_ns(chain: Chain, samples: np.ndarray) -> np.ndarray:
    """The compiled step alone, called as `nt.Stream` calls it."""
    stream, took = nt.Stream(chain, backend="native"), np.empty(len(samples))
    step = stream._compiled.push
    for i in range(len(took)):
        part = samples[i : i + 1]
        began = time.thread_time_ns()
        step(samples=part, held=False)
        took[i] = time.thread_time_ns() - began
    return took


def c_ns(chain: Chain, samples: np.ndarray, *, integer: bool) -> np.ndarray:
    with tempfile.TemporaryDirectory() as scratch:
        folder, chosen = Path(scratch), None
        if integer:
            raster = afferents.encode(samples[None, :2000], chain.clock_Hz, chain.encoder)[0]
            windows = torch.from_numpy(raster[:, : chain.windows.length])
            chosen = formats.choose(chain, formats.record(chain.network, windows, [samples]))
            samples = chosen.raw.samples(samples)
        c_export.write(chain, folder, chosen)
        (folder / "timer.c").write_text(TIMER)
        subprocess.run(["cc", "-std=c99", "-O2", "touch.c", "timer.c", "-o", "timer"], cwd=folder, check=True)
        told = subprocess.run([folder / "timer"], input=samples.tobytes(), capture_output=True, check=True).stdout
    return np.array(told.split(), float)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=100_000)
    given = parser.parse_args()
    torch.set_num_threads(1)
    chain, samples = made()
    samples = samples[: given.samples]
    few = samples[: given.samples // 10]
    for name, took in (
        ("nt.Stream, reference, blocks of 1", stream_ns(chain, few, 1, "reference")),
        ("nt.Stream, compiled, blocks of 1", stream_ns(chain, samples, 1, "native")),
        ("its step alone, blocks of 1", step_ns(chain, samples)),
        ("nt.Stream, compiled, blocks of 100", stream_ns(chain, samples, 100, "native")),
        ("C, float", c_ns(chain, samples, integer=False)),
        ("C, integer", c_ns(chain, samples, integer=True)),
    ):
        median, high, highest = np.percentile(took, [50, 99, 99.9]) / 1e3
        print(
            f"{name}: median {median:.2f} µs, 99 % {high:.2f} µs, 99.9 % {highest:.2f} µs of 500 µs "
            f"({len(took)} calls); {int(500 / highest)} fingers a core",
            flush=True,
        )


if __name__ == "__main__":
    main()
