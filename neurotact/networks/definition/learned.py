"""What a network learns of a window, as it is asked for: the class of its trial, numbers, or the event at its end."""

from typing import Any, Literal

from pydantic import Field

from neurotact import effects
from neurotact.spec import OneOrMore, Spec

Balance = Literal["none", "classes", "conditions"]
CONDITION: dict[str, Any] = {"metavar": "CONDITION"}


class LearnSpec(Spec):
    """What a network learns of windows, and which of them count the same; `nt.Learn`.

    >>> LearnSpec(target="force_N"), LearnSpec(refuse=0.05)
    (Learn(target=('force_N',)), Learn(refuse=0.05))
    """

    public = "Learn"
    target: OneOrMore = Field(default=(), json_schema_extra=CONDITION)
    """Learn the numbers of this condition, such as force_N, in place of classes; or events, the marks of long
    recordings. Of several conditions, each has a readout neuron, whose value at the end of a window is in its unit."""
    balance: Balance = "none"
    """Training windows count the same for each class, or for each condition of the split within a class, too."""
    refuse: float | None = Field(default=None, gt=0, lt=1)
    """Share of known touches that may be refused, so that touches of other classes are, as none of these."""
    false_alarms_per_h: float | None = Field(default=None, ge=0)
    """Of a detector of events: how many false alarms an hour are allowed on validation recordings, where its threshold
    is chosen; 10 when absent."""

    def check_given(self) -> None:
        """Refuse false alarms of what is no detector."""
        effects.check(target=self.target, false_alarms_per_h=self.false_alarms_per_h)
