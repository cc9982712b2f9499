"""A refractory period as a key of an encoder's spec."""

from typing import Annotated

from pydantic import AfterValidator, Field

LEAST_MS = 0.05
"""A shorter period is refused, since it is rather one in seconds: afferents have about 1 ms. 0 is none."""


def _in_ms(t_ref_ms: float) -> float:
    if 0 < t_ref_ms < LEAST_MS:
        raise ValueError(f"must be 0 or at least {LEAST_MS:g} ms (did you mean {1e3 * t_ref_ms:g} ms?)")
    return t_ref_ms


RefractoryMs = Annotated[float, Field(ge=0), AfterValidator(_in_ms)]
"""A refractory period in ms, 0 for none."""
