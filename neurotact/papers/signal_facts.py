"""What a paper says of its signals beside what a simulation does: facts that hold or fail, printed and kept."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from neurotact.tables import write_table


class Fact(NamedTuple):
    """One thing the paper says, and what the simulation does."""

    fact: str
    source: str
    target: str
    reached: str
    holds: bool


def tell(facts: Sequence[Fact]) -> None:
    """Print every fact with its target, and how many hold.

    >>> tell([Fact("pulses are as long as published", "Fig. 2", "0.8 s", "0.81 s", True)])
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
