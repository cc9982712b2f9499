"""The printed results of a trained network."""

import pandas as pd

from neurotact.cli.output import print_line
from neurotact.networks.training import comparison
from neurotact.networks.training.outcome import Outcome, summary_of
from neurotact.tables import to_json


def print_json(outcome: Outcome) -> None:
    """One record in a list: the accuracy and the cost of a trained network."""
    print(to_json(pd.DataFrame([summary_of(outcome.as_json())])))


def print_outcome(outcome: Outcome) -> None:
    """The accuracy, the cost and the confusions of a trained network."""
    for line in comparison.lines(outcome.compared):
        print(line)
    print(comparison.costs(outcome.row, outcome.step_ms))
    print(comparison.confused(outcome.confusion, outcome.classes))
    print_line(outcome.acausal)
