"""Which choices of the default rules a thousandth of the data flips: of windows, the encoder and the network.

    python benchmarks/steady_choices.py [--draws 20] [--calibrations 5] [--sets letters cubes ...]
    python benchmarks/steady_choices.py --whole [--sets gratings cubes ...]

Of each real set in $NEUROTACT_DATA, and each made-up one (`made_sets`), a thousandth of the trials (one at least) is
left out before windows and the encoder are chosen, and a thousandth of the spikes before the network is. A line for
each choice that was not the same in all draws says how often it had which value.

--whole: calibrations alone, as they are and with all candidate gains, also those that cannot be chosen: processor
seconds of each, what is chosen, and whether both choose the same.
"""

import argparse
import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
import torch
from made_sets import SETS
from made_sets import touches as touches_of
from neurotact_parts.studies.braille.reader import read as read_letters

import neurotact as nt
from neurotact import spec
from neurotact.data.conditioning import conditioned_length
from neurotact.data.dataset import reader
from neurotact.data.onset import common_onset_s
from neurotact.data.recordings import Recordings
from neurotact.data.window_choice import Timing, choose
from neurotact.data.windows import WindowSpec
from neurotact.encoders import gain_search
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.calibration import calibrate_causally
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.sensitivity import sensitivities_of, value_of
from neurotact.encoders.specs import pays_exact
from neurotact.networks.definition import recipe
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training.tasks import examples_of
from neurotact.studies.automatic import membrane_ms

DATA = Path(os.environ.get("NEUROTACT_DATA", "../shared/data"))
SHARE, CLOCK_HZ = 1e-3, 1000.0
READ = {"fabrics": ("fabricslide", "fabricslide/fabric"), "cubes": ("pvdf-hardness", "pvdf-hardness"),
        "cubes-150": ("pvdf-hardness", "pvdf-hardness-150")}  # fmt: skip
SIMULATED = ("gratings", "contact-materials")
KEYS = ("model", "step_ms", "readout_stretches", "tau_mem_ms", "training.epochs", "training.readout_dropout")


def recordings_of(name: str) -> Recordings:
    """The recordings of a set."""
    if name in SETS:
        return touches_of(SETS[name])
    if name == "icub":
        arrays = np.load(DATA / "icub-slide" / "icub.npz")
        signals = [signal.astype(np.float32) for signal in arrays["signals"]]
        return Recordings(signals, 20.0, "count", pd.DataFrame({"label": arrays["label"].astype(str)}))
    if name in SIMULATED:
        simulated = nt.simulate(name)
        assert isinstance(simulated, Recordings)
        return simulated
    kind, folder = READ[name]
    touches = reader(kind).read(DATA / folder)
    assert isinstance(touches, Recordings)
    return touches


def chosen_for_recordings(touches: Recordings) -> tuple[dict[str, Any], AfferentSpec]:
    """The window, and what calibration chooses beside gains; the encoder."""
    rate_Hz = touches.sampling_rate_Hz
    steps = np.array([conditioned_length(len(signal), rate_Hz, CLOCK_HZ) for signal in touches.signals])
    window = choose(Timing(steps / CLOCK_HZ, CLOCK_HZ, common_onset_s(touches)))[0]
    tau_ms = membrane_ms(window["length_ms"], 10.0)
    given = {"conditioning.resample_Hz": CLOCK_HZ, "tau_mem_ms": tau_ms}
    start = spec.load(AfferentSpec, "sa1-ra1-lif", given)
    if pays_exact(start, rate_Hz):
        start = start.model_copy(update={"integration": "exact"})
    encoder = calibrate_causally(touches, start, choose_ema=True, choose_opposite=True, tell=False).encoder
    found = {f"window.{key}": value for key, value in window.items()}
    found |= {"encoder.tau_mem_ms": tau_ms, "encoder.sa1.opposite": encoder.sa1.opposite}
    for key in ("baseline", "ema_cutoff_Hz"):
        found[f"encoder.conditioning.{key}"] = getattr(encoder.conditioning, key)
    return found, encoder


def chosen_for_spikes(spikes: torch.Tensor, rate_Hz: float) -> dict[str, Any]:
    """What the network's recipe chooses."""
    network = recipe.chosen_for(RSNNSpec(recipe="default"), spikes, rate_Hz)
    table = spec.leaves(network.model_dump(mode="json"))
    return {f"network.{key}": table[key] for key in KEYS}


def told(name: str, found: Sequence[Mapping[str, Any]]) -> None:
    """Print each choice that was not the same in all draws."""
    for key in sorted({key for each in found for key in each}):
        counts = Counter(each.get(key) for each in found)
        if len(counts) > 1:
            print(f"{name}: {key}: " + ", ".join(f"{value} ({n}x)" for value, n in counts.most_common()))
    print(f"{name}: {len(found)} draws; {dict(found[0])}", flush=True)


def beside_whole(name: str) -> None:
    """Print what a calibration chooses and takes, and how many times as long all candidates take."""
    touches, taken, found = recordings_of(name), [], []
    following = gain_search.following
    for every in (False, True):
        start_s = time.process_time()
        with patch.object(
            gain_search, "following", lambda rows, rule, e=every: following(rows, rule.model_copy(update={"every": e}))
        ):
            found.append(chosen_for_recordings(touches))
        taken.append(time.process_time() - start_s)
    choices, encoder = found[0]
    gains = {one.key: value_of(encoder, one) for one in sensitivities_of(encoder)}
    is_same = "the same" if found[0] == found[1] else f"NOT THE SAME: {found[1]}"
    print(f"{name}: {taken[0]:.1f} s, all candidates {taken[1]:.1f} s: {is_same}; {choices}, {gains}", flush=True)


def without(rng: np.random.Generator, n: int) -> np.ndarray:
    """The indices of `n` things without a thousandth of them, one at least."""
    return np.sort(rng.permutation(n)[max(1, round(SHARE * n)) :])


def main() -> None:
    """Draw, choose, and print."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--calibrations", type=int, default=5)
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--sets", nargs="+")
    asked = parser.parse_args()
    if asked.whole:
        for name in asked.sets or [*READ, "icub", *SIMULATED, *SETS]:
            beside_whole(name)
        return
    for name in asked.sets or ["letters", *READ, "icub", *SETS]:
        rng = np.random.default_rng(0)
        if name == "letters":
            trains, window = read_letters(DATA / "braille-th10" / "events.npz", 1.0), {"length_ms": 1300.0}
        else:
            touches = recordings_of(name)
            found, encoder = chosen_for_recordings(touches)
            parts = (touches.select(without(rng, len(touches))) for _ in range(asked.calibrations))
            told(name, [found, *(chosen_for_recordings(part)[0] for part in parts)])
            trains = encode_recordings(touches, encoder)
            window = {key.removeprefix("window."): value for key, value in found.items() if key.startswith("window.")}
        cut = WindowSpec(**{**window, "per_trial": 1})
        spikes = examples_of(trains, np.arange(0, len(trains), 2), cut)[0].spikes
        at = spikes.flatten().nonzero()[:, 0]
        choices = [chosen_for_spikes(spikes, trains.sampling_rate_Hz)]
        for _ in range(asked.draws):
            fewer = torch.zeros_like(spikes).flatten()
            fewer[at[without(rng, len(at))]] = 1
            choices.append(chosen_for_spikes(fewer.view_as(spikes), trains.sampling_rate_Hz))
        told(f"{name}, spikes", choices)


if __name__ == "__main__":
    main()
