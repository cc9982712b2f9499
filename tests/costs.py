"""A cost without what it moves, which `tests/metrics/test_memory_by_loops.py` counts by itself."""

from neurotact.metrics.flops import FLOPS, Cost
from neurotact.metrics.prices import PRICED


def operations(counted: Cost) -> dict[str, float]:
    """Operations, parameters, bytes, SOPs and energy by the arithmetic alone."""
    return {name: value for name, value in counted.columns().items() if name not in PRICED[len(FLOPS) + 1 :]}
