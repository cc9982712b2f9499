"""None of these: how many known touches are answered and how many unknown ones refused, with classes left out in turn.

    python benchmarks/left_out_classes.py -o docs/data/left-out-classes.csv [--sets fabrics letters]

Sets are read in $NEUROTACT_DATA. Each class of fabrics, and each of nine groups of three letters, is left out of a
training in turn; its touches are then unknown. The least lead is chosen on validation windows of the known classes, for
some shares of them; the rival's, logistic regression on spikes in bins, in the same way from its own leads. Trainings
are short (`SETTINGS`): this compares leads, and is not the accuracy that the sets allow.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from neurotact_parts.studies.braille.reader import read as read_letters
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from steady_choices import DATA, chosen_for_recordings, recordings_of

from neurotact import spec
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import WindowSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.refusal import least_lead
from neurotact.networks.exit.rule import leads
from neurotact.networks.training import tasks, trainer
from neurotact.networks.training.tasks import Sides, Task

SHARES = (0.05, 0.1, 0.2)
SETTINGS = {"model": "snn", "hidden": 100, "readout": "integrator", "training.epochs": 60}
BINS, PENALTIES = 10, (0.001, 0.01, 0.1, 1.0)
"""Of the rival: bins of a window, and the inverse penalties of which validation chooses."""
EACH = 80
"""Recordings of each letter."""


class Set(NamedTuple):
    """Spikes, their windows, and the classes that are left out together."""

    trains: SpikeTrains
    window: WindowSpec
    groups: list[list[str]]


class Told(NamedTuple):
    """Values of the classes `(window, class)`, of validation, test and unknown windows."""

    validation: torch.Tensor
    test: torch.Tensor
    unknown: torch.Tensor


def set_of(name: str) -> Set:
    """A set, ready to be cut."""
    if name == "letters":
        every = read_letters(DATA / "braille-th10" / "events.npz", 5.0)
        trains = every.select(np.flatnonzero(every.conditions.groupby("label").cumcount().to_numpy() < EACH))
        letters = list(trains.classes)
        return Set(trains, WindowSpec(length_ms=1300, per_trial=1), [letters[n::9] for n in range(9)])
    touches = recordings_of(name)
    found, encoder = chosen_for_recordings(touches)
    window = {key.removeprefix("window."): value for key, value in found.items() if key.startswith("window.")}
    trains = encode_recordings(touches, encoder)
    return Set(trains, WindowSpec(**{**window, "per_trial": 1}), [[label] for label in trains.classes])


def network(trains: SpikeTrains, task: Task, sides: Sides, unknown: torch.Tensor) -> Told:
    """The readouts of a short training."""
    chosen = spec.load(RSNNSpec, "default", SETTINGS)
    fitted, _ = trainer.fit(trains, chosen, task, (0, 1))
    return Told(*(fitted.network.infer(each).readout for each in (sides.validation.spikes, sides.test.spikes, unknown)))


def logistic(sides: Sides, unknown: torch.Tensor) -> Told:
    """The values of logistic regression on spikes in bins."""

    def binned(spikes: torch.Tensor) -> np.ndarray:
        parts = [part.sum(dim=1) for part in spikes.float().tensor_split(BINS, dim=1)]
        return torch.cat(parts, dim=1).numpy()

    train, validation, test, new = map(binned, (*(side.spikes for side in sides), unknown))
    labels, held = sides.train.labels.numpy(), sides.validation.labels.numpy()
    machines = [make_pipeline(StandardScaler(), LogisticRegression(C=c, max_iter=300)) for c in PENALTIES]
    best = max(machines, key=lambda machine: machine.fit(train, labels).score(validation, held))
    return Told(*(torch.from_numpy(best.decision_function(each)) for each in (validation, test, new)))


def rows_of(name: str) -> Iterator[dict]:
    """For each group that is left out, classifier and share: how many windows are answered and refused."""
    trains, window, groups = set_of(name)
    for group in groups:
        task = Task(window=window, leave_out={"label": group})
        is_unknown = trains.conditions["label"].isin(group).to_numpy()
        known = trains.select(np.flatnonzero(~is_unknown))
        sides = tasks.sides_of(known, task)
        unknown = tasks.examples_of(trains, np.flatnonzero(is_unknown), task)[0].spikes
        labels = np.unique(sides.train.labels.numpy())
        for who, told in (("network", network(known, task, sides, unknown)), ("logistic", logistic(sides, unknown))):
            right = told.test.argmax(dim=1).numpy() == np.searchsorted(labels, sides.test.labels.numpy())
            for share in SHARES:
                least = least_lead(leads(told.validation).numpy(), share)
                answered, wrongly = (leads(values).numpy() >= least for values in (told.test, told.unknown))
                yield {
                    "set": name, "left_out": " ".join(group), "classifier": who, "share": share,
                    "validation": len(told.validation), "test": len(right), "unknown": len(wrongly),
                    "accuracy": right.mean(), "answered": answered.mean(),
                    "accuracy_answered": right[answered].mean(), "unknown_refused": 1 - wrongly.mean(),
                }  # fmt: skip


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over the groups, with 95 % intervals.

    Of known touches that of the trials of one test side, since groups share them; of unknown ones, that of the groups,
    drawn anew: a class is unknown as a whole.
    """
    rng, found = np.random.default_rng(0), []
    for keys, part in rows.groupby(["set", "classifier", "share"], sort=False):
        refused = part["unknown_refused"].to_numpy()
        drawn = rng.choice(refused, (10_000, len(refused))).mean(axis=1)
        known = wilson_interval(float(part["answered"].mean()), round(part["test"].mean()))
        found.append(
            {
                **dict(zip(("set", "classifier", "share"), keys, strict=True)), "groups": len(part),
                "validation": round(part["validation"].mean()), "test": round(part["test"].mean()),
                **part[["accuracy", "answered"]].mean(), "answered_low": known[0], "answered_high": known[1],
                **part[["accuracy_answered", "unknown_refused"]].mean(),
                "refused_low": np.quantile(drawn, 0.025), "refused_high": np.quantile(drawn, 0.975),
            }
        )  # fmt: skip
    return pd.DataFrame(found)


def main() -> None:
    """Train, choose, refuse, and write."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--sets", nargs="+", default=["fabrics", "letters"])
    asked = parser.parse_args()
    found = summary(pd.DataFrame([row for name in asked.sets for row in rows_of(name)]))
    print(found.to_string(index=False, float_format="{:.3f}".format))
    if asked.out:
        found.to_csv(asked.out, index=False, float_format="%.4g", lineterminator="\n")


if __name__ == "__main__":
    main()
