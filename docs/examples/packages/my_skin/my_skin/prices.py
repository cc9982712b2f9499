"""A price list: the energy of an operation of each kind."""

from neurotact.metrics.prices import PriceList

CHIP = PriceList(
    operations="8-bit integers",
    source="my data sheet, table 3",
    multiplication_pJ=0.2,
    addition_pJ=0.03,
)
