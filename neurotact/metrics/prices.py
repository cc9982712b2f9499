"""Price lists: the energy of an operation of each kind, as specs that are found by name.

Another package adds one by an entry point of the group `neurotact.prices` (`docs/plugins.md`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pandas as pd
from pydantic import BeforeValidator, Field

from neurotact import plugins, spec
from neurotact.spec import Spec

Price = Annotated[float, Field(ge=0, le=1e9)]
DEFAULT = "arithmetic-45nm"
DIVISION_MACS, EXPONENTIAL_MACS = 2, 4
"""MACs by which a division or root, and an exponential or logarithm, is computed: as many as their FLOPs."""


class PriceList(Spec):
    """The energy of an operation of each kind, in picojoules (`prices/*.toml`).

    >>> mine = PriceList(source="my data sheet", multiplication_pJ=1.0, addition_pJ=0.25)
    >>> mine.energy_nJ({"macs": 1000, "acs": 4000}), mine.by_kind["divisions"]
    (2.25, 2.5)
    """

    folder: ClassVar[str] = "prices"

    name: str = "unnamed"
    """By which it was found; tables and sentences say it."""
    operations: str = ""
    """What is priced, in words, such as `32-bit floating point at 45 nm`."""
    source: str = Field(min_length=1)
    """Where the prices are from."""
    multiplication_pJ: Price
    """Of a multiplication whose product is not added."""
    addition_pJ: Price
    """Of an addition or subtraction: what a spike costs."""
    mac_pJ: Price | None = None
    """Of a multiplication whose product is added; absent: that of both."""
    comparison_pJ: Price | None = None
    """Of a comparison, magnitude, shift or rounding; absent: that of an addition."""
    division_pJ: Price | None = None
    """Of a division or square root; absent: that of 2 MACs."""
    exponential_pJ: Price | None = None
    """Of an exponential or logarithm; absent: that of 4 MACs."""

    @property
    def by_kind(self) -> dict[str, float]:
        """The price of an operation of each kind of a `Cost`, in pJ."""
        mac = _or(self.mac_pJ, self.multiplication_pJ + self.addition_pJ)
        return {
            "macs": mac,
            "acs": self.addition_pJ,
            "multiplications": self.multiplication_pJ,
            "comparisons": _or(self.comparison_pJ, self.addition_pJ),
            "divisions": _or(self.division_pJ, DIVISION_MACS * mac),
            "exponentials": _or(self.exponential_pJ, EXPONENTIAL_MACS * mac),
        }

    def energy_nJ(self, operations: Mapping[str, Any] | pd.DataFrame) -> Any:  # noqa: N802
        """The energy of numbers of operations by kind, in nJ; of a table with a column for each kind, that of each row.

        A kind that is not there costs nothing.
        """
        return 1e-3 * sum(price * operations[kind] for kind, price in self.by_kind.items() if kind in operations)

    def repriced(self, table: pd.DataFrame) -> pd.DataFrame:
        """A table of costs that the default list priced, with the energy by this one."""
        return table if self == ARITHMETIC_45NM else table.assign(energy_estimate_nJ=self.energy_nJ(table))

    def in_words(self) -> str:
        """How energy is estimated."""
        pJ = self.by_kind
        return (
            f"Energy is an estimate of the arithmetic alone, without memory, by the price list {self.name}: "
            f"{pJ['macs']:g} pJ per MAC, {pJ['acs']:g} pJ per addition{self._comparison()}, "
            f"{pJ['multiplications']:g} pJ per other multiplication, {pJ['divisions']:g} pJ per division, "
            f"{pJ['exponentials']:g} pJ per exponential{self.operations and ', '}{self.operations} ({self.source})."
        )

    def _comparison(self) -> str:
        price = self.by_kind["comparisons"]
        return " or comparison" if price == self.addition_pJ else f", {price:g} pJ per comparison"


def _or(price: float | None, otherwise: float) -> float:
    return otherwise if price is None else price


def price_list(name: str | Path | PriceList) -> PriceList:
    """The price list with this name, of any installed package, or of the TOML file at this path; a list stays as it is.

    Raises InputError for one that is unknown or cannot be used.

    >>> price_list("arithmetic-45nm").by_kind["divisions"]
    9.200000000000001
    >>> price_list("arithmetic-54nm")
    Traceback (most recent call last):
    neurotact.errors.InputError: prices: there is none called 'arithmetic-54nm'; did you mean 'arithmetic-45nm'?
    """
    if isinstance(name, PriceList):
        return name
    if str(name).endswith(".toml") or "/" in str(name):
        return spec.load(PriceList, name, {"name": Path(name).stem})
    return plugins.load("prices", str(name), PriceList).model_copy(update={"name": str(name)})


def _named(given: Any) -> Any:
    return price_list(given) if isinstance(given, (str, Path)) else given


Priced = Annotated[PriceList, BeforeValidator(_named)]
"""A price list as a key of a spec: its name, its path, or the whole table."""
ARITHMETIC_45NM = spec.load(PriceList, DEFAULT, {"name": DEFAULT})
