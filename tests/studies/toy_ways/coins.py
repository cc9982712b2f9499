"""A protocol small enough for tests: a coin of some bias is foreseen by two rules."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from pydantic import Field

from neurotact.figures.style import Drawn, new_figure
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View


class CoinSpec(Spec):
    tosses: int = Field(default=40, ge=1)
    heads: float = Field(default=0.7, ge=0, le=1)
    path: str | None = None


class Parameters(Spec):
    data: CoinSpec = CoinSpec()
    rule: str
    repetitions: int = 2
    seed: int = 0


VIEW = View(
    ("rule", "heads"),
    {"accuracy_test": "test accuracy (%)", "flops": "FLOPs"},
    "flops",
    "accuracy_test",
    "Coins.",
    spiking=("rule", ("toss",)),
    splits=(),
)


def load(data: CoinSpec) -> Arrays:
    return {"fell": np.random.default_rng(0).random(data.tosses) < data.heads}


def run(parameters: Parameters, arrays: Arrays) -> list[dict]:
    generator = np.random.default_rng(parameters.seed)
    rows = []
    for repetition in range(parameters.repetitions):
        guesses = generator.random(len(arrays["fell"])) < 0.5 if parameters.rule == "toss" else True
        accuracy = (guesses == arrays["fell"]).mean()
        row = {"heads": parameters.data.heads, "repetition": repetition, "accuracy_test": accuracy, "flops": 1.0}
        rows.append({**row, "n_train": 1, "n_test": len(arrays["fell"])})
    return rows


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    figure = new_figure(2.0)
    figure.subplots().plot(arrays["fell"])
    yield Drawn("tosses", "Tosses", figure, f"{len(results)} rows.", "What fell.")
