"""What whole numbers cost the texture paper's chain: weight bits and state bits beside accuracy, SOPs and bytes.

The network is trained in float on the simulated gratings, then rounded; its integer twin (`neurotact.deploy.integer`),
which the C export equals to the last spike, decides the test windows. Nothing is trained again.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pydantic import Field

from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.splits import SplitSpec, split_conditions
from neurotact.data.windows import WindowSpec
from neurotact.deploy import formats, integer
from neurotact.deploy.chain import Chain, chain_of
from neurotact.deploy.formats import Formats
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.calibration import calibrate
from neurotact.encoders.encoding import encode_recordings
from neurotact.figures.style import Drawn, add_legend, new_figure, printed, series_style
from neurotact.metrics import synops
from neurotact.networks import trained
from neurotact.networks.early_exit import FULL_WINDOW, ExitRule
from neurotact.networks.specs import RSNNSpec
from neurotact.networks.trained import Task
from neurotact.papers.texture.simulator import SIMULATOR
from neurotact.spec import Spec, build
from neurotact.studies.protocol import Arrays, View

FLOAT = 32


class QuantisationData(Spec):
    """The gratings, and how much of each slide is used."""

    simulation: dict[str, Any] = {"trials": 25}
    """Keys of the simulator that differ from their defaults."""
    window: WindowSpec = WindowSpec(length_ms=150.0, start_ms=250.0, per_trial=1)


class Parameters(Spec):
    """One network, at every number of bits."""

    data: QuantisationData = QuantisationData()
    encoder: AfferentSpec
    """Gains are calibrated on the training trials."""
    t_ref_ms: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]] = (1.0, 1.0)
    """Of RA-I and SA-I."""
    network: RSNNSpec = RSNNSpec()
    weight_bits: tuple[Literal[2, 3, 4, 5, 6, 7, 8], ...] = Field(default=(8, 6, 4, 3, 2), min_length=1)
    state_bits: tuple[Literal[8, 9, 10, 11, 12, 13, 14, 15, 16, 24], ...] = Field(
        default=(24, 16, 14, 12, 10), min_length=1
    )
    seed: int = Field(default=0, ge=0)
    """Of the split, the weights and the order of training."""


VIEW = View(
    by=("pair", "weight_bits", "state_bits"),
    measures={
        "accuracy_test": "test accuracy (%)",
        "exit_accuracy": "with early exit (%)",
        "exit_steps": "steps with early exit",
        "exit_sops_total": "SOPs with early exit",
        "bytes": "weights and states (bytes)",
    },
    cost="bytes",
    score="exit_accuracy",
    note="Weights and states are rounded after training. 32 bits: float. Bytes: weights packed to their bits, and one "
    "window's currents and membranes; code and what conditioning and afferents keep are not among them.",
)


def load(data: QuantisationData) -> Arrays:
    """The slides up to the end of their first window, and their classes."""
    spec = SIMULATOR.build(data.simulation, "quantisation")
    recordings = SIMULATOR.simulate(spec, None)
    rate_Hz = recordings.sampling_rate_Hz
    n_samples = round((data.window.start_ms + data.window.length_ms) * 1e-3 * rate_Hz)
    signals = np.stack([signal[:n_samples] for signal in recordings.signals])
    labels = recordings.conditions[LABEL].to_numpy(dtype=str)
    return {"signals": signals, "labels": labels, "sampling_rate_Hz": np.array(rate_Hz)}


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for float and for each pair of weight bits and state bits."""
    conditions = pd.DataFrame({LABEL: arrays["labels"]})
    skin = Recordings(arrays["signals"], float(arrays["sampling_rate_Hz"]), "mV", conditions, source="gratings")
    task = Task(window=parameters.data.window, split=SplitSpec(seed=parameters.seed))
    split = split_conditions(conditions, (), task.split)
    trains = encode_recordings(skin, _encoder(parameters, skin.select(split.train)))
    seeds = (2 * parameters.seed, 2 * parameters.seed + 1)
    done, sides = trained.fit(trains, parameters.network, task, seeds)
    encoder = build(AfferentSpec, dict(trains.encoder), source="quantisation")
    chain = chain_of((encoder, done.network), length_ms=task.window.length_ms)._replace(rule=done.rule)
    ranges = formats.record(chain.network, sides.train.spikes, list(skin.select(split.train).signals))
    measured = trained.measure(done, sides.test, trains.populations)["row"]
    test = skin.select(split.test)
    first = round(task.window.start_ms * 1e-3 * chain.clock_Hz)
    columns = ("accuracy_test", "exit_accuracy", "exit_steps", "exit_sops_total")
    rows = [_row(parameters, chain, FLOAT, FLOAT, {key: measured[key] for key in columns})]
    for weight_bits in parameters.weight_bits:
        for state_bits in parameters.state_bits:
            chosen = formats.choose(chain, ranges, weight_bits=weight_bits, state_bits=state_bits)
            windows = integer.encode(chosen.raw.samples(np.asarray(test.signals)), chosen.front)[:, first:]
            found = _measured(chain, chosen, windows, test.labels)
            rows.append(_row(parameters, chain, weight_bits, state_bits, found))
    return rows


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy over state bits, a line for each number of weight bits."""
    yield Drawn(
        "accuracy-over-bits",
        "Accuracy over bits",
        draw_over_bits(results),
        "Test accuracy with early exit over the bits of currents and membranes, a line for each number of weight bits, "
        "a panel for each pair of refractory periods (RA-I & SA-I). Dotted: float.",
        "Accuracy rises with the bits of states and is level from some number on.",
    )


@printed
def draw_over_bits(results: pd.DataFrame) -> Figure:
    """One panel for each pair of refractory periods."""
    pairs = list(dict.fromkeys(results["pair"]))
    figure = new_figure(2.6)
    panels = figure.subplots(1, len(pairs), sharey=True, squeeze=False)[0]
    for axes, pair in zip(panels, pairs, strict=True):
        rows = results[results["pair"] == pair]
        whole = rows[rows["weight_bits"] != FLOAT]
        axes.axhline(100 * rows[rows["weight_bits"] == FLOAT]["exit_accuracy"].mean(), linestyle=":", color="0.4")
        for index, (bits, part) in enumerate(whole.groupby("weight_bits", sort=False)):
            means = part.groupby("state_bits")["exit_accuracy"].mean()
            axes.plot(means.index, 100 * means, label=f"{bits}-bit weights", **series_style(index))
        axes.set(title=f"t_ref {pair} ms", xlabel="state bits", xticks=sorted(set(whole["state_bits"])))
    panels[0].set_ylabel("test accuracy (%)")
    add_legend(figure, panels, ncols=5)
    return figure


def _encoder(parameters: Parameters, training: Recordings) -> AfferentSpec:
    table = parameters.encoder.model_dump(mode="json", exclude_none=True)
    for part, t_ref_ms in zip(("ra1", "sa1"), parameters.t_ref_ms, strict=True):
        table[part]["t_ref_ms"] = t_ref_ms
    return calibrate(training, build(AfferentSpec, table, source="quantisation")).encoder


def _measured(chain: Chain, chosen: Formats, windows: np.ndarray, labels: np.ndarray) -> dict[str, float]:
    full, early = (_inferred(chain, chosen, windows, rule) for rule in (FULL_WINDOW, chain.rule))
    sops = synops.of_network(chain.network, early.input_spikes, early.hidden_spikes).total
    return {
        "accuracy_test": float((full.labels == labels).mean()),
        "exit_accuracy": float((early.labels == labels).mean()),
        "exit_steps": float(early.steps.mean()),
        "exit_sops_total": float(sops.mean()),
    }


def _inferred(chain: Chain, chosen: Formats, windows: np.ndarray, rule: ExitRule) -> integer.Decided:
    return integer.infer(windows, chosen, chain.network.neuron, rule)


def _row(
    parameters: Parameters, chain: Chain, weight_bits: int, state_bits: int, measured: dict[str, float]
) -> dict[str, Any]:
    network = chain.network
    n_weights = sum(w.numel() for w in (network.w_in, network.w_rec, network.w_out) if w is not None)
    n_states = 2 * (network.spec.hidden + network.n_classes)
    ra1, sa1 = parameters.t_ref_ms
    weight_bytes, state_bytes = math.ceil(n_weights * weight_bits / 8), math.ceil(n_states * state_bits / 8)
    about = {"pair": f"{ra1:g}&{sa1:g}", "weight_bits": weight_bits, "state_bits": state_bits, "seed": parameters.seed}
    sizes = {"weight_bytes": weight_bytes, "state_bytes": state_bytes, "bytes": weight_bytes + state_bytes}
    return {**about, **measured, **sizes}
