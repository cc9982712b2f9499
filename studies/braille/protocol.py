"""The recurrent and the feed-forward network of the Braille-reading study, trained as in its public notebooks.

Müller-Cleve et al. 2022, Frontiers in Neuroscience 16:951164; github.com/event-driven-robotics/tactile_braille_reading,
`braille_reading_rsnn.ipynb` and `parameters_th10.txt`. The notebooks report the test accuracy of the best epoch on
test letters; `honest` uses the best epoch on validation letters and tests once.
"""

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from neurotact_parts.studies.braille import reader as braille_letters
from pydantic import Field
from sklearn.model_selection import train_test_split

from neurotact.data import doubtful
from neurotact.data.dataset import expand
from neurotact.data.windows import Windows
from neurotact.errors import InputError
from neurotact.figures.style import Drawn, add_legend, new_figure, printed, series_style
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.use import measuring
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View, heads

PUBLISHED = {"rsnn": 0.637, "snn": 0.449}
"""Test accuracy of both networks at an event threshold of 10, for the best epoch on test letters."""
TEST, SPLIT_SEED = 0.2, 42
VALIDATION = 0.1
"""Share of all letters, taken from the training letters under `honest`."""


class BrailleData(Spec):
    """The events, and the clock of the spikes."""

    path: str = "$NEUROTACT_DATA/braille-th10/events.npz"
    step_ms: float = Field(default=5.0, gt=0)
    length_ms: float = Field(default=1350.0, gt=0)
    binning: braille_letters.Binning = "nearest"


class Parameters(Spec):
    """One training."""

    data: BrailleData = BrailleData()
    network: RSNNSpec = RSNNSpec()
    copies: int = Field(default=2, ge=1)
    """Input neurons per channel, each with its own weights."""
    outputs: int = Field(default=28, ge=2)
    """Readout neurons; the notebooks have one more than letters, which no label uses."""
    protocol: Literal["published", "honest"] = "published"
    """Letters for the choice of the epoch: `published`, the test letters themselves; `honest`, validation letters."""
    seed: int = Field(default=0, ge=0)
    """Random seed of the weights and the order of training; the split is fixed."""


VIEW = View(
    by=("model", "protocol"),
    measures=heads(
        "accuracy_test accuracy_last accuracy_train epoch epochs sops_total hidden_spikes",
        accuracy_last="test accuracy of the last epoch (%)",
        epoch="epoch chosen",
        epochs="epochs run",
        hidden_spikes="hidden spikes per letter",
    ),
    cost="sops_total",
    score="accuracy_test",
    note="Under `published` the epoch is the best one on the test letters, so the accuracy is optimistic; "
    "under `honest` it is the best one on validation letters, a tenth of all, which are not used for training.",
    apart=("protocol",),
    optimistic=("published",),
)


class Sides(NamedTuple):
    """Letters to train on, to choose the epoch on, and to test on."""

    train: Examples
    chosen_on: Examples
    test: Examples


def load(data: BrailleData) -> Arrays:
    """The spikes of every letter, `(trial, time, channel)`, and its class."""
    trains = braille_letters.read(expand(data.path), data.step_ms, binning=data.binning, length_ms=data.length_ms)
    doubtful.warn(trains)  # the published split is by letter alone
    whole = Windows(np.arange(len(trains)), np.zeros(len(trains), np.int64), int(trains.trial_steps[0]))
    return {"spikes": trains.raster(whole), "labels": trains.labels, "step_ms": np.array(data.step_ms)}


def sides_of(labels: np.ndarray, protocol: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Letters to train on, to choose the epoch on and to test on: 80/20 by class, as published.

    >>> [len(side) for side in sides_of(np.repeat(np.arange(4), 50), "honest")]
    [140, 20, 40]
    >>> train, chosen_on, test = sides_of(np.repeat(np.arange(4), 50), "published")
    >>> len(train), bool((chosen_on == test).all())
    (160, True)
    """
    shares = {"test_size": TEST, "random_state": SPLIT_SEED}
    rest, test = train_test_split(np.arange(len(labels)), stratify=labels, **shares)
    if protocol == "published":
        return rest, test, test
    n_validation = round(VALIDATION * len(labels))
    training, validation = train_test_split(
        rest, test_size=n_validation, stratify=labels[rest], random_state=SPLIT_SEED
    )
    return training, validation, test


def run(parameters: Parameters, arrays: Arrays) -> list[dict[str, Any]]:
    """A row: test accuracy of the chosen epoch and of the last one, and the network's spikes."""
    labels = torch.from_numpy(arrays["labels"])
    if parameters.outputs <= int(labels.max()):
        raise InputError(f"outputs: must be {int(labels.max()) + 1} or more, one for each letter")
    spikes = torch.from_numpy(np.tile(arrays["spikes"], parameters.copies))
    sides = Sides(*(Examples(spikes[side], labels[side]) for side in sides_of(arrays["labels"], parameters.protocol)))
    weights, order = (torch.Generator().manual_seed(2 * parameters.seed + i) for i in range(2))
    rate_Hz = 1e3 / float(arrays["step_ms"])
    network = RSNN(spikes.shape[2], parameters.outputs, parameters.network, rate_Hz, generator=weights)
    last: dict[str, Any] = {}
    done = train(network, sides.train, sides.chosen_on, generator=order, keep=lambda state: last.update(state.weights))
    inferred = network.infer(sides.test.spikes)
    row = {
        "model": parameters.network.model,
        "protocol": parameters.protocol,
        "seed": parameters.seed,
        "accuracy_test": measuring.accuracy_of(inferred, sides.test),
        "accuracy_train": done.best.train_accuracy,
        "epoch": done.best.epoch,
        "epochs": len(done.epochs),
        "sops_total": float(measuring.synops_of(inferred, network).total.mean()),
        "hidden_spikes": float(inferred.hidden_spikes.double().mean()),
        "n_train": len(sides.train.labels),
        "n_test": len(sides.test.labels),
    }
    network.load_state_dict(last)
    return [{**row, "accuracy_last": measuring.accuracy_of(network.infer(sides.test.spikes), sides.test)}]


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Test accuracy of each training and the published values."""
    yield Drawn(
        "beside-the-published",
        "Comparison with the published values",
        _draw_beside(results),
        "Test accuracy of each training. Dotted: published.",
        "One mark per training, for the recurrent and the feed-forward network, and the published accuracy of each.",
    )


@printed
def _draw_beside(results: pd.DataFrame) -> Figure:
    """A column for each network, a mark for each training."""
    figure = new_figure(2.6)
    axes = figure.subplots()
    names = {"rsnn": "recurrent", "snn": "feed-forward"}
    models = [model for model in names if model in set(results["model"])]
    for index, (protocol, rows) in enumerate(results.groupby("protocol", sort=False)):
        x = [models.index(model) + 0.15 * (index - 0.5) for model in rows["model"]]
        label = "best epoch on test letters" if protocol == "published" else "best epoch on validation letters"
        axes.plot(x, rows["accuracy_test"], label=label, **{**series_style(index), "linestyle": "none"})
    for index_, model in enumerate(models):
        axes.hlines(PUBLISHED[model], index_ - 0.3, index_ + 0.3, linestyle=":", color="0.4")
    axes.set(
        xticks=range(len(models)), xticklabels=[names[model] for model in models], ylabel="test accuracy", ylim=(0, 1)
    )
    axes.set_xlim(-0.5, len(models) - 0.5)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.grid(axis="y")
    add_legend(figure, [axes], ncols=2)
    return figure
