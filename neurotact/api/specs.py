"""The specs that ship."""

from typing import Literal

from neurotact import spec
from neurotact.errors import InputError, nearest


def spec_names(kind: Literal["encoders", "networks", "networks/spaces", "studies"]) -> list[str]:
    """The names of the specs of a kind that ship, as `neurotact list` prints them; InputError for another kind.

    >>> spec_names("networks")
    ['default', 'rsnn', 'snn']
    """
    if kind not in spec.KINDS:
        raise InputError(f"kind: {kind!r} is unknown; {nearest(str(kind), spec.KINDS)}")
    return [path.stem for path in spec.shipped(kind)]
