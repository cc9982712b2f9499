"""What a network learns of a window, as it is asked for: the class of its trial, or numbers."""

from typing import Literal

from pydantic import Field

from neurotact.spec import Spec

Balance = Literal["none", "classes", "conditions"]


class LearnSpec(Spec):
    """What a network learns of windows, and which of them count the same; `nt.Learn`.

    >>> LearnSpec(refuse=0.05)
    Learn(refuse=0.05)
    """

    public = "Learn"
    balance: Balance = "none"
    """Training windows count the same for each class, or for each condition of the split within a class, too."""
    refuse: float | None = Field(default=None, gt=0, lt=1)
    """Share of known touches that may be refused, so that touches of other classes are, as none of these."""
