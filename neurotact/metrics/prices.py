"""Price lists: the energy of each operation and of each access to memory, as specs that are found by name.

Ours are the files in `prices/`; another package adds one by an entry point of the group `neurotact.prices`
(`docs/plugins.md`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from neurotact import plugins, spec
from neurotact.errors import InputError, nearest
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    import pandas as pd


Price = Annotated[float, Field(ge=0, le=1e9)]
DEFAULT = "memory-45nm"
"""Of studies, trained networks and classifiers (`docs/concepts/energy.md` argues for it)."""
DIVISION_MACS, EXPONENTIAL_MACS = 2, 4
"""MACs by which a division or root, and an exponential or logarithm, is computed: as many as their FLOPs."""

OPERATIONS = ("macs", "acs", "multiplications", "comparisons", "divisions", "exponentials")
NEURONS = ("neuron_updates", "neuron_macs", "neuron_comparisons", "readout_updates", "sops_sent")
MEMORIES = ("weights", "states", "buffers")
"""The memories of a chain: what training fixes; what lasts from sample to sample; spikes and features on their way."""
ACCESSES = tuple(f"{memory}_accesses" for memory in MEMORIES)
OF_WIDTH = (*OPERATIONS, "weights_accesses", "states_accesses", "weights_bytes", "states_bytes")
"""Of these a `Cost` also has, after `WIDE`, how many are on 32-bit numbers where a chain computes in integers."""
WIDE = "wide_"
PRICED = (
    *OPERATIONS, "sops", *NEURONS, *ACCESSES, *(f"{memory}_bytes" for memory in MEMORIES),
    *(f"{WIDE}{name}" for name in OF_WIDTH),
)  # fmt: skip
"""What a price list can have a price of: names of a `flops.Cost`."""


WITH_MEMORY = ("synaptic_operation_pJ", "neuron_update_pJ")
"""Prices of a list that stand for all that an operation or an update takes."""


class OneWidth(Spec):
    """The energy of operations and accesses on numbers of one width; see `PriceList`."""

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
    like: str | None = None
    """Name of an installed list that has the keys which this one leaves out; what is read is whole, and has none."""
    mac_pJ: Price | None = None
    """Of a multiplication whose product is added; absent: that of both."""
    comparison_pJ: Price | None = None
    """Of a comparison, magnitude, shift or rounding; absent: that of an addition."""
    division_pJ: Price | None = None
    """Of a division or square root; absent: that of 2 MACs."""
    exponential_pJ: Price | None = None
    """Of an exponential or logarithm; absent: that of 4 MACs."""
    bits: int = Field(default=32, ge=1, le=64)
    """Of a number in memory."""
    memory_pJ: tuple[tuple[Annotated[float, Field(ge=0)], Price], ...] = ()
    """Of an access to a number in a memory of so many bytes, `[[8192, 5.0], [32768, 10.0]]`: linear between and beyond
    these sizes; absent: memory costs nothing."""
    synaptic_operation_pJ: Price | None = None
    """Of a synaptic operation on a chip, with its memory; absent: an addition and its accesses."""
    neuron_update_pJ: Price | None = None
    """Of the update of a neuron on a chip, with its memory; absent: its operations and accesses."""
    sent_operation_pJ: Price | None = None
    """Of a synaptic operation of a spike that a neuron of the network sent; absent: that of any."""
    readout_update_pJ: Price | None = None
    """Of a step of a readout neuron that only adds up, on a chip that visits all on every step; absent: nothing."""
    event_driven: bool = False
    """Whether neurons are updated when a spike comes, in place of on every step."""

    @model_validator(mode="before")
    @classmethod
    def _like_another(cls, table: Any) -> Any:
        if not isinstance(table, Mapping) or table.get("like") is None:
            return table
        name = str(table["like"])
        if name.endswith(".toml") or "/" in name:
            raise InputError(f"like: must be the name of an installed price list; got {name}")
        other = price_list(name).model_dump(exclude_none=True, exclude={"name"})
        return {**other, **{key: value for key, value in table.items() if key != "like"}}

    @model_validator(mode="after")
    def _operations_have_a_price(self) -> Self:
        if self.sent_operation_pJ is not None and self.synaptic_operation_pJ is None:
            raise InputError("sent_operation_pJ: needs a price of the others, synaptic_operation_pJ; add it")
        whole = next((key for key in WITH_MEMORY if getattr(self, key) is not None), None)
        if whole and self.memory_pJ:
            raise InputError(
                f"memory_pJ: {whole} stands for its memory, too, which would count twice; give one of them"
            )
        return self

    @field_validator("memory_pJ")
    @classmethod
    def _rising(cls, given: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        sizes = [size for size, _ in given]
        if sizes != sorted({*sizes}) or len(sizes) == 1:
            raise ValueError("needs two sizes or more, each larger than the one before")
        return given

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

    def energy_pJ(self, own: Mapping[str, Any]) -> Any:  # noqa: N802
        """Of operations and accesses of one width."""
        total, on_chip = 0.0, self._on_chip(own)
        for kind, price in self.by_kind.items():
            total = total + price * (own.get(kind, 0) - on_chip.get(kind, 0))
        total = total + _or(self.synaptic_operation_pJ, 0) * own.get("sops", 0)
        total = total + _or(self.neuron_update_pJ, 0) * own.get("neuron_updates", 0)
        if self.sent_operation_pJ is not None:
            dearer = self.sent_operation_pJ - _or(self.synaptic_operation_pJ, 0)
            total = total + dearer * own.get("sops_sent", 0)
        if self.readout_update_pJ is not None:
            total = total + self.readout_update_pJ * own.get("readout_updates", 0)
        for memory in MEMORIES if self.memory_pJ else ():
            accesses, size = own.get(f"{memory}_accesses", math.nan), own.get(f"{memory}_bytes", 0)
            total = total + accesses * self.access_pJ(size)
        return total

    def access_pJ(self, size: Any) -> Any:  # noqa: N802
        """The price of an access to a number in a memory; size: bytes if numbers have 32 bits.

        >>> price_list("memory-45nm").access_pJ(20 * 1024)
        7.5
        """
        given = np.asarray(size, float) * self.bits / 32
        sizes, prices = np.array(self.memory_pJ).T
        right = np.clip(np.searchsorted(sizes, given), 1, len(sizes) - 1)
        slope = (prices[right] - prices[right - 1]) / (sizes[right] - sizes[right - 1])
        found = np.maximum(0.0, prices[right] + slope * (given - sizes[right]))
        return found if isinstance(size, pd.Series) or found.ndim else float(found)

    def _on_chip(self, own: Mapping[str, Any]) -> dict[str, Any]:
        """The operations by kind that a price of a synaptic operation or of an update stands for."""
        of_updates = {"macs": "neuron_macs", "comparisons": "neuron_comparisons"}
        found = {} if self.neuron_update_pJ is None else {k: own.get(name, 0) for k, name in of_updates.items()}
        return found if self.synaptic_operation_pJ is None else {**found, "acs": own.get("sops", 0)}


class PriceList(OneWidth):
    """The energy of an operation of each kind and of an access to memory, in picojoules (`prices/*.toml`).

    >>> mine = PriceList(source="my data sheet", multiplication_pJ=1.0, addition_pJ=0.25)
    >>> mine.energy_nJ({"macs": 1000, "acs": 4000}), mine.by_kind["divisions"]
    (2.25, 2.5)

    With a price of memory, what is read and written costs, and is NaN where it is not counted. A price of a neuron's
    update or of a synaptic operation stands for all that they take, and is refused beside one of memory.
    """

    wide: OneWidth | None = None
    """Of a list of narrower integers: prices on 32-bit numbers, in which exported C encodes; absent: as all others."""

    @model_validator(mode="after")
    def _memory_has_both_prices(self) -> Self:
        if self.wide is not None and bool(self.wide.memory_pJ) != bool(self.memory_pJ):
            raise InputError("wide.memory_pJ: must be there where memory_pJ is, and only there")
        return self

    def energy_nJ(self, counted: Mapping[str, Any] | pd.DataFrame) -> Any:  # noqa: N802
        """The energy of numbers of operations and accesses, in nJ; of a table with a column for each, that of each row.

        counted: names of `PRICED`. A kind of operation that is not there costs nothing; NaN where accesses that
        have a price are not there, and by a list with prices `wide` where the width of operations is not there.
        """
        own = {name: counted[name] for name in counted if name in PRICED}
        if self.wide is None:
            return 1e-3 * self.energy_pJ(own)
        wide = {name: own.get(f"{WIDE}{name}", math.nan) for name in OF_WIDTH}
        rest = own | {name: own.get(name, 0) - wide[name] for name in OF_WIDTH}
        for size in ("weights_bytes", "states_bytes"):  # both lie in one memory
            rest[size] = rest[size] + wide[size] * self.wide.bits / self.bits
            wide[size] = rest[size] * self.bits / self.wide.bits
        return 1e-3 * (self.energy_pJ(rest) + self.wide.energy_pJ({**wide, "buffers_accesses": 0}))

    def repriced(self, table: pd.DataFrame) -> pd.DataFrame:
        """A table of costs that the default list priced, with the energy by this one."""
        return table if self == ARITHMETIC_45NM else table.assign(energy_estimate_nJ=self.energy_nJ(table))

    def in_words(self) -> str:
        """How energy is estimated."""
        pJ = self.by_kind
        return (
            f"Energy is an estimate {self._memory()}, by the price list {self.name}: "
            f"{pJ['macs']:g} pJ per MAC, {pJ['acs']:g} pJ per addition{self._comparison()}, "
            f"{pJ['multiplications']:g} pJ per other multiplication, {pJ['divisions']:g} pJ per division, "
            f"{pJ['exponentials']:g} pJ per exponential{self.operations and ', '}{self.operations} ({self.source})."
            f"{self._encoding()}"
        )

    def _encoding(self) -> str:
        if self.wide is None:
            return ""
        pJ, bits = self.wide.by_kind, self.wide.bits
        return f" Encoding computes in {bits} bits: {pJ['macs']:g} pJ per MAC, {pJ['acs']:g} pJ per addition."

    def _memory(self) -> str:
        if not self.memory_pJ:
            on_chip = self.synaptic_operation_pJ is not None or self.neuron_update_pJ is not None
            return "of operations on a chip" if on_chip else "of the arithmetic alone, without memory"
        prices = ", ".join(f"{price:g} pJ in {size / 1024:g} kB" for size, price in self.memory_pJ)
        neurons = ", neurons updated when a spike comes" if self.event_driven else ""
        return f"of arithmetic and memory (an access to {self.bits} bits: {prices}, linear between){neurons}"

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
    if str(name) in _ours():
        plugins.refuse_taken("prices", str(name))
        return _read(str(name))
    if not plugins.has("prices", str(name)):
        raise InputError(f"prices: there is none called '{name}'; {nearest(str(name), names())}")
    return plugins.load("prices", str(name), PriceList).model_copy(update={"name": str(name)})


def names() -> list[str]:
    """The names of the price lists that ship, the default first, then those of other packages."""
    return [*_ours(), *plugins.names("prices")]


@cache
def _ours() -> list[str]:
    return sorted((path.stem for path in spec.shipped(PriceList.folder)), key=lambda name: (name != DEFAULT, name))


@cache
def _read(name: str) -> PriceList:
    """A list that ships, read once: a report prices every row by every list."""
    return spec.load(PriceList, name, {"name": name})


Priced = Annotated[
    PriceList, BeforeValidator(lambda given: price_list(given) if isinstance(given, str | Path) else given)
]
"""A price list as a key of a spec: its name, its path, or the whole table."""
ARITHMETIC_45NM = price_list("arithmetic-45nm")
"""Of a `Cost` where no list is named."""
MEMORY_45NM = price_list(DEFAULT)
