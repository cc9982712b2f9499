"""Small chains with spikes enough to decide, and what they make of whole trials: encode, cut, infer."""

from pathlib import Path

import numpy as np
import pandas as pd
import torch
from neurotact_parts.streams.chain import Chain, chain_of

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import n_afferents
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training import run_folder, trainer
from neurotact.networks.training.tasks import Task
from neurotact.spec import override


def make_encoder(afferents: dict | None = None, **conditioning) -> AfferentSpec:
    """afferents: changes of the two types, dotted keys."""
    table = {"sa1": {"gain": 8.0, "t_ref_ms": 2}, "ra1": {"gain": 30.0, "t_ref_ms": 1}, "conditioning": conditioning}
    return AfferentSpec.model_validate(override(table, afferents or {}))


READOUTS: dict[str, dict] = {
    "count": {"readout": "count"},
    "integrator": {"readout": "integrator"},
    "leaky": {"readout": "integrator", "readout_tau_ms": 9.0},
    "max": {"readout": "max"},
    "stretches": {"readout": "integrator", "readout_stretches": 3, "readout_stretch_ms": 12.0},
}


ADAPTING = {"threshold_adaptation": 0.3, "tau_adaptation_ms": 12.0}


def make_chain(
    conditioning: dict, *, rate_Hz: float = 1000.0, patience: int | None = None,
    windows: dict | None = None, n_taxels: int = 2, seed: int = 0, readout: str = "count",
    afferents: dict | None = None, **network,
) -> Chain:  # fmt: skip
    """readout: of `READOUTS`; afferents: as for `make_encoder`."""
    encoder = make_encoder(afferents, **conditioning)
    settings = {"hidden": 6, "forward_weight_scale": 3.0, **READOUTS[readout], **network}
    if not settings["hidden"]:
        settings.pop("forward_weight_scale")
    elif settings.get("model") == "snn":
        settings.pop("recurrent_delay_steps", None)
    else:
        settings.setdefault("recurrent_weight_scale", 0.4)
    if readout == "stretches" and (step_ms := network.get("step_ms")):
        settings["readout_stretch_ms"] = 3 * step_ms
    clock_Hz = encoder.conditioning.resample_Hz or rate_Hz
    generator = torch.Generator().manual_seed(seed)
    net = RSNN(n_afferents(encoder, n_taxels), 3, sampling_rate_Hz=clock_Hz, generator=generator, **settings)
    unequal_stretches(net)
    streamed = nt.Streamed(sampling_rate_Hz=rate_Hz, **(windows or {"length_ms": 40}))
    chain = chain_of((encoder, net), streamed)
    return chain._replace(rule=ExitRule(patience, from_first_spike=True))


def unequal_stretches(network: RSNN) -> None:
    """Give the stretches of a window, if it has any, weights that differ."""
    if network.w_stretch is not None:
        with torch.no_grad():
            network.w_stretch.normal_(generator=torch.Generator().manual_seed(1))


def make_run(folder: Path, n_trials: int = 12, channels: tuple[str, ...] | None = None) -> Path:
    """In the folder: `skin.h5`, recordings; `spikes.h5`, their spikes; `run`, a network of an epoch."""
    signals = [make_signal(130, seed=k) for k in range(n_trials)]
    labels = pd.DataFrame({"label": [("felt", "silk")[k % 2] for k in range(n_trials)]})
    named = {} if channels is None else {"channels": channels}
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", labels, **named), folder / "skin.h5")
    trains = encode_recordings(hdf5.load_recordings(folder / "skin.h5"), make_encoder(baseline="start"))
    hdf5.save_spikes(trains, folder / "spikes.h5")
    spec = RSNNSpec.model_validate({"hidden": 5, "forward_weight_scale": 3.0, "training": {"epochs": 1}})
    task = Task.model_validate({"window": {"length_ms": 40}})
    done, _ = trainer.fit(trains, spec, task, (0, 1))
    run_folder.save(done, folder / "run", trains, folder / "spikes.h5", task)
    return folder


SMALL = {"training.epochs": 2, "hidden": 12, "model": "rsnn", "direct": False}


def make_event_run(folder: Path, **settings) -> Path:
    """In the folder: `events.csv`, events of a sensor in us; `spikes.h5`, as imported; `run`, of two epochs."""
    rng, rows = np.random.default_rng(0), []
    for trial in range(24):
        label, n = ("felt", "silk")[trial % 2], (30, 45)[trial % 2]
        for time_us in np.sort(rng.choice(60_000, n, replace=False)).tolist():
            rows.append(f"{trial},{label},{time_us},{rng.integers(0, 3)},{rng.integers(0, 2)}")
    (folder / "events.csv").write_text("\n".join(["trial,label,time_us,channel,polarity", *rows, ""]))
    events = nt.Events(duration_ms=60, merge_events=True)
    hdf5.save_spikes(nt.read_events(folder / "events.csv", events=events), folder / "spikes.h5")
    nt.train(
        folder / "spikes.h5",
        folder / "run",
        settings={**SMALL, **settings},
        window=nt.Window(length_ms=60),
    )
    return folder


def events_of_trial(folder: Path, trial: int) -> list[str]:
    """Time, channel and polarity of each event of a trial of `make_event_run`."""
    rows = [line.split(",") for line in (folder / "events.csv").read_text().splitlines()[1:]]
    return [",".join(row[2:]) for row in rows if row[0] == str(trial)]


def make_signal(n_samples: int, n_taxels: int = 2, seed: int = 0) -> np.ndarray:
    """Touches as slow bumps with noise, in mV."""
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.standard_normal((n_samples, n_taxels)), axis=0) * 0.4
    return (slow + 0.3 * rng.standard_normal((n_samples, n_taxels)) + 1.5).astype(np.float32)


def offline(chain: Chain, signal: np.ndarray) -> tuple[np.ndarray, list[tuple]]:
    """The raster of a whole trial, and of each window that fits: start, label, steps, input and hidden spikes."""
    recordings = Recordings([signal], chain.sampling_rate_Hz, "mV", pd.DataFrame({"label": ["a"]}))
    trains = encode_recordings(recordings, chain.encoder)
    raster = np.zeros((int(trains.trial_steps[0]), chain.network.n_inputs), np.uint8)
    raster[trains.steps[0], trains.units[0]] = 1
    starts = chain.windows.starts(raster)
    if not len(starts):
        return raster, []
    windows = np.stack([raster[start : start + chain.windows.length] for start in starts.tolist()])
    found = chain.network.infer(torch.from_numpy(windows), chain.rule)
    columns = (found.labels, found.steps, found.input_spikes, found.hidden_spikes)
    return raster, list(zip(starts.tolist(), *(part.tolist() for part in columns), strict=True))


def told(decisions) -> list[tuple]:
    """Decisions as `offline` gives them, in the order of their windows."""
    rows = sorted(decisions, key=lambda each: each.window)
    return [(d.start_step, d.index, d.steps, d.input_spikes, d.hidden_spikes) for d in rows]
