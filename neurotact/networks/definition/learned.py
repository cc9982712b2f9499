"""What a network learns of a window, as it is asked for: the class of its trial, or numbers."""

from typing import Any, Literal

from pydantic import Field

from neurotact.spec import OneOrMore, Spec

Balance = Literal["none", "classes", "conditions"]
CONDITION: dict[str, Any] = {"metavar": "CONDITION"}


class LearnSpec(Spec):
    """What a network learns of windows, and which of them count the same; `nt.Learn`.

    >>> LearnSpec(target="force_N")
    Learn(target=('force_N',))
    """

    public = "Learn"
    target: OneOrMore = Field(default=(), json_schema_extra=CONDITION)
    """Learn the numbers of this condition of the trials, such as force_N, in place of their class. Of several, each has
    a readout neuron, whose value at the end of a window is in the unit of the condition."""
    balance: Balance = "none"
    """Training windows count the same for each class, or for each condition of the split within a class, too."""
