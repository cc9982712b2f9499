"""Facts about a paper's signals, checked on a simulation: each holds or fails, is printed and saved."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from neurotact.tables import write_table


class Fact(NamedTuple):
    """One statement of the paper, and the value in the simulation."""

    fact: str
    source: str
    target: str
    reached: str
    holds: bool


def print_facts(facts: Sequence[Fact]) -> None:
    """Print every fact with its target, and the number that hold.

    >>> print_facts([Fact("pulses are as long as published", "Fig. 2", "0.8 s", "0.81 s", True)])
    holds  pulses are as long as published [Fig. 2]
           0.8 s: 0.81 s
    1 of 1 facts hold
    """
    for fact in facts:
        print(f"{'holds' if fact.holds else 'FAILS'}  {fact.fact} [{fact.source}]")
        print(f"       {fact.target}: {fact.reached}")
    print(f"{sum(fact.holds for fact in facts)} of {len(facts)} facts hold")


def keep(facts: Sequence[Fact], folder: Path) -> None:
    """Write the facts into `facts.csv` of a folder."""
    write_table(pd.DataFrame(facts), folder / "facts.csv")
