"""The cost of integers in the texture paper's chain: accuracy, SOPs and bytes over weight bits and state bits.

The network is trained in float on the simulated gratings, then rounded, or fine-tuned with rounded weights
(`exporters.c.fine_tuning`); its integer twin (`exporters.c.integer`), identical to the C export in every spike,
classifies the test windows.
"""

import copy
import math
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pandas as pd
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from neurotact_parts.exporters.c import fine_tuning, formats, integer
from neurotact_parts.exporters.c.formats import Formats, Steps
from neurotact_parts.exporters.c.rounding import Grid
from neurotact_parts.streams.chain import Chain, chain_of
from neurotact_parts.streams.streamed import StreamedSpec
from neurotact_parts.studies.texture.simulator import SIMULATOR
from pydantic import Field

from neurotact.data.recordings import LABEL, Recordings
from neurotact.data.splits import SplitSpec, split_touches
from neurotact.data.windows import WindowSpec
from neurotact.encoders.afferents import POPULATIONS, AfferentSpec
from neurotact.encoders.calibration import calibrate
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import BY_CALIBRATION, FITTED
from neurotact.figures.style import (
    MUTED,
    PALE,
    Drawn,
    add_legend,
    bars,
    keep_within,
    new_figure,
    printed,
    series_style,
)
from neurotact.metrics import synops
from neurotact.networks.definition.rsnn import RSNN, rsnn_of
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training import trainer
from neurotact.networks.training.ranges import Ranges, record, record_states
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.training.trainer import Trained
from neurotact.networks.use import measuring
from neurotact.spec import Spec, build
from neurotact.studies.way import Arrays, View, heads

FLOAT = 32
TRAINED, TRAINED_ON, ROUNDING, FINE_TUNING = "float", "float, trained on", "rounding", "fine-tuning"


class QuantisationData(Spec):
    """The gratings, and the used part of each slide."""

    simulation: dict[str, Any] = {"trials": 25}
    """Keys of the simulator that differ from their defaults."""
    window: WindowSpec = WindowSpec(length_ms=150.0, start_ms=250.0, per_trial=1)


class Parameters(Spec):
    """One network, with every number of bits."""

    decided: ClassVar[Mapping[str, str]] = {
        **{f"encoder.{key}": BY_CALIBRATION for key in FITTED},
        **{f"encoder.{part}.t_ref_ms": "set t_ref_ms, as in t_ref_ms=[1, 5] (RA-I, SA-I)" for part in POPULATIONS},
    }

    data: QuantisationData = QuantisationData()
    encoder: AfferentSpec
    """Gains are calibrated on the training trials."""
    t_ref_ms: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]] = (1.0, 1.0)
    """Refractory periods of RA-I and SA-I."""
    network: RSNNSpec = RSNNSpec()
    weight_bits: tuple[Literal[2, 3, 4, 5, 6, 7, 8], ...] = Field(default=(8, 6, 4, 3, 2), min_length=1)
    state_bits: tuple[Literal[8, 9, 10, 11, 12, 13, 14, 15, 16, 24], ...] = Field(
        default=(24, 16, 14, 12, 10), min_length=1
    )
    fine_tune_epochs: int = Field(default=fine_tuning.EPOCHS, ge=0)
    """Epochs of fine-tuning; 0 skips it."""
    seed: int = Field(default=0, ge=0)
    """Random seed of the split, the weights and the order of training."""


VIEW = View(
    by=("pair", "method", "weight_bits", "state_bits"),
    measures=heads(
        "accuracy_test exit_accuracy exit_steps exit_sops_total bytes",
        exit_accuracy="with early exit (%)",
        exit_steps="steps with early exit",
        exit_sops_total="SOPs with early exit",
        bytes="weights and states (bytes)",
    ),
    cost="bytes",
    score="exit_accuracy",
    note="Rounding: of weights and states after training. Fine-tuning: further training with rounded weights, without "
    "test windows; 'float, trained on' is trained as long without rounding. 32 bits: float. Bytes: weights packed to "
    "their bits, and one window's currents and membranes, without code and the states of conditioning and afferents.",
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


class Given(NamedTuple):
    """A network trained in float with its chain, the windows of every side, and the trials of the test.

    first: step at which a window starts.
    """

    done: Trained
    chain: Chain
    sides: Sides
    ranges: Ranges
    task: Task
    test: Recordings
    first: int


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row for float, one for float with further training, and two for each pair of bits: rounding and fine-tuning.

    The second row shows the effect of further training alone.
    """
    conditions = pd.DataFrame({LABEL: arrays["labels"]})
    skin = Recordings(arrays["signals"], float(arrays["sampling_rate_Hz"]), "mV", conditions, source="gratings")
    task = Task(window=parameters.data.window, split=SplitSpec(seed=parameters.seed))
    split = split_touches(skin, (), task.split)
    trains = encode_recordings(skin, _encoder(parameters, skin.select(split.train)))
    seeds = (2 * parameters.seed, 2 * parameters.seed + 1)
    done, sides = trainer.fit(trains, parameters.network, task, seeds)
    encoder = build(AfferentSpec, dict(trains.encoder), source="quantisation")
    chain = chain_of((encoder, done.network), StreamedSpec(length_ms=task.window.length_ms))._replace(rule=done.rule)
    ranges = record(chain.network, sides.train.spikes, list(skin.select(split.train).signals))
    first = round(task.window.start_ms * 1e-3 * chain.clock_Hz)
    given = Given(done, chain, sides, ranges, task, skin.select(split.test), first)
    measured = measuring.measure(done, sides, trains.populations)["row"]
    columns = ("accuracy_test", "exit_accuracy", "exit_steps", "exit_sops_total")
    rows = [_row(parameters, chain.network, TRAINED, (FLOAT, FLOAT), {key: measured[key] for key in columns})]
    if parameters.fine_tune_epochs:
        measured = measuring.measure(_trained_on(parameters, given, {}), sides, trains.populations)["row"]
        row = {key: measured[key] for key in columns}
        rows.append(_row(parameters, chain.network, TRAINED_ON, (FLOAT, FLOAT), row))
    return [*rows, *_whole_rows(parameters, given)]


def _whole_rows(parameters: Parameters, given: Given) -> Iterator[dict[str, Any]]:
    chain, windows = given.chain, None
    for weight_bits in parameters.weight_bits:
        tuned: dict[Steps, Chain] = {}  # state bits change the steps of few weight bits, if any
        for state_bits in parameters.state_bits:
            bits = (weight_bits, state_bits)
            rounded = formats.choose(chain, given.ranges, weight_bits=weight_bits, state_bits=state_bits)
            if windows is None:  # samples and afferents are the same for all bits
                samples = rounded.raw.samples(np.asarray(given.test.signals))
                windows = integer.encode(samples, rounded.front)[:, given.first :]
            yield _row(parameters, chain.network, ROUNDING, bits, _measured(chain, rounded, windows, given))
            if not parameters.fine_tune_epochs:
                continue
            steps = formats.Layers(rounded.hidden, rounded.readout).steps
            if steps not in tuned:
                done = _trained_on(parameters, given, fine_tuning.grids_of(chain.network, steps, weight_bits))
                tuned[steps] = chain._replace(network=done.network, rule=done.rule)
            other = tuned[steps]
            seen = record_states(other.network, given.sides.train.spikes)
            ranges = given.ranges._replace(hidden=seen[0], readout=seen[1])
            chosen = formats.choose(other, ranges, weight_bits=weight_bits, state_bits=state_bits, steps=steps)
            yield _row(parameters, other.network, FINE_TUNING, bits, _measured(other, chosen, windows, given))


def _trained_on(parameters: Parameters, given: Given, grids: dict[str, Grid]) -> Trained:
    """The network fine-tuned on these grids, with its own exit rule; without grids, trained as long in float."""
    network = copy.deepcopy(rsnn_of("c-integer", given.done.network))
    order = torch.Generator().manual_seed(parameters.seed)
    training = fine_tuning.train_rounded(
        network, given.sides.train, given.sides.validation, grids, generator=order, epochs=parameters.fine_tune_epochs
    )
    return trainer.finished(network, training, given.sides, given.task)


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Accuracy over bits of states, and over bits of weights with their bytes."""
    yield Drawn(
        "accuracy-over-bits",
        "Accuracy over bits of states",
        _draw_over_bits(results),
        "Test accuracy with early exit over the bits of currents and membranes, a line for each number of weight bits, "
        "a panel for each pair of refractory periods (RA-I & SA-I) and each method for integer weights. Dotted: float; "
        "dashed: float, with further training as long as fine-tuning.",
        "Accuracy rises with the bits of states up to some number, then is constant.",
    )
    yield Drawn(
        "rounding-and-fine-tuning",
        "Rounding and fine-tuning",
        _draw_over_weight_bits(results),
        f"Test accuracy with early exit over the bits of weights, states of {_usual_bits(results)} bits, and the bytes "
        "of weights and one window's states. Bars: standard deviation over seeds. Dotted: float; dashed: float, "
        "with further training as long as fine-tuning.",
        "Accuracy over bits of weights for rounding and fine-tuning; bytes fall with the bits.",
    )


@printed
def _draw_over_bits(results: pd.DataFrame) -> Figure:
    """A column of panels for each pair of refractory periods, a row for each method for integer weights."""
    pairs, whole = list(dict.fromkeys(results["pair"])), results[results["weight_bits"] != FLOAT]
    methods = list(dict.fromkeys(whole["method"]))
    figure = new_figure(0.6 + 2.0 * len(methods))
    panels = figure.subplots(len(methods), len(pairs), sharex=True, sharey=True, squeeze=False)
    for (row, method), (column, pair) in product(enumerate(methods), enumerate(pairs)):
        axes = panels[row, column]
        rows = whole[(whole["pair"] == pair) & (whole["method"] == method)]
        _draw_float(axes, results, pair)
        for index, (bits, part) in enumerate(rows.groupby("weight_bits", sort=False)):
            means = part.groupby("state_bits")["exit_accuracy"].mean()
            axes.plot(means.index, 100 * means, label=f"{bits}-bit weights", **series_style(index))
        axes.set(title=f"t_ref {pair} ms, {method}", xticks=sorted(set(whole["state_bits"])))
    for axes in panels[-1]:
        axes.set_xlabel("state bits")
    for axes in panels[:, 0]:
        axes.set_ylabel("test accuracy (%)")
    add_legend(figure, panels.flat, ncols=5)
    return figure


@printed
def _draw_over_weight_bits(results: pd.DataFrame) -> Figure:
    """A panel for each pair of refractory periods, and one of the bytes."""
    pairs, state_bits = list(dict.fromkeys(results["pair"])), _usual_bits(results)
    whole = results[results["state_bits"] == state_bits]
    figure = new_figure(2.6)
    *panels, sizes = figure.subplots(1, len(pairs) + 1, squeeze=False)[0]
    for axes in panels[1:]:
        axes.sharey(panels[0])
    for axes, pair in zip(panels, pairs, strict=True):
        _draw_float(axes, results, pair)
        rows = whole[whole["pair"] == pair]
        for index, (method, part) in enumerate(rows.groupby("method", sort=False)):
            share = 100 * part.groupby("weight_bits")["exit_accuracy"].agg(["mean", "std"])
            axes.errorbar(
                share.index, share["mean"], bars(share["mean"], share["std"]), label=method, **series_style(index)
            )
        axes.set(title=f"t_ref {pair} ms", xlabel="weight bits", xticks=sorted(set(whole["weight_bits"])))
    panels[0].set_ylabel("test accuracy (%)")
    keep_within(panels[:1])
    means = whole.groupby("weight_bits")[["weight_bytes", "state_bytes"]].mean()
    sizes.bar(means.index, means["weight_bytes"], color=MUTED, label="weights")
    sizes.bar(means.index, means["state_bytes"], bottom=means["weight_bytes"], color=PALE, label="states")
    sizes.set(title="bytes", xlabel="weight bits", xticks=list(means.index))
    add_legend(figure, [*panels, sizes], ncols=5)
    return figure


def _draw_float(axes: Axes, results: pd.DataFrame, pair: str) -> None:
    for method, style in ((TRAINED, ":"), (TRAINED_ON, "--")):
        rows = results[(results["pair"] == pair) & (results["method"] == method)]
        if len(rows):
            axes.axhline(100 * rows["exit_accuracy"].mean(), linestyle=style, color=MUTED, label=method)


def _usual_bits(results: pd.DataFrame) -> int:
    """State bits that an export chooses for this network, 16, or the most in the study."""
    known = {int(bits) for bits in results["state_bits"] if bits != FLOAT}
    return 16 if 16 in known else max(known)


def _encoder(parameters: Parameters, training: Recordings) -> AfferentSpec:
    table = parameters.encoder.model_dump(mode="json", exclude_none=True)
    for part, t_ref_ms in zip(("ra1", "sa1"), parameters.t_ref_ms, strict=True):
        table[part]["t_ref_ms"] = t_ref_ms
    return calibrate(training, build(AfferentSpec, table, source="quantisation")).encoder


def _measured(chain: Chain, chosen: Formats, windows: np.ndarray, given: Given) -> dict[str, float]:
    labels = given.test.labels
    full, early = (integer.infer(windows, chosen, chain.network.neuron, rule) for rule in (FULL_WINDOW, chain.rule))
    sops = synops.of_network(chain.network, early.input_spikes, early.hidden_spikes).total
    return {
        "accuracy_test": float((full.labels == labels).mean()),
        "exit_accuracy": float((early.labels == labels).mean()),
        "exit_steps": float(early.steps.mean()),
        "exit_sops_total": float(sops.mean()),
    }


def _row(
    parameters: Parameters, network: RSNN, method: str, bits: tuple[int, int], measured: dict[str, float]
) -> dict[str, Any]:
    """bits: of weights and of states."""
    n_weights = sum(weights.numel() for weights in network.weights)
    n_states = 2 * (network.spec.hidden + network.n_classes)
    ra1, sa1 = parameters.t_ref_ms
    weight_bytes, state_bytes = (math.ceil(n * b / 8) for n, b in zip((n_weights, n_states), bits, strict=True))
    about = {"pair": f"{ra1:g}&{sa1:g}", "method": method, "weight_bits": bits[0], "state_bits": bits[1]}
    sizes = {"weight_bytes": weight_bytes, "state_bytes": state_bytes, "bytes": weight_bytes + state_bytes}
    return {**about, "seed": parameters.seed, **measured, **sizes}
