"""The metadata that neurotact writes with the nodes: step, clock, specs, exit rule, and what is left out."""

import json
import math
from typing import Any

from pydantic import Field, model_validator

from neurotact import __version__
from neurotact.errors import InputError
from neurotact.networks.exit.rule import ExitRule, SavedBand, check_band
from neurotact.spec import Spec, build

KEY = "neurotact"
REFRACTORY = "refractory_time"
"""The metadata of neurons that are silent after a spike, in s for each: the name that NIR's developers propose for a
parameter (github.com/neuromorphs/NIR/issues/138)."""
DISCRETISATION = "forward Euler in steps of dt_s; a cycle without a Delay comes back in the next step"


class Note(Spec):
    """`metadata/neurotact` of a file, as JSON."""

    dt_s: float = Field(gt=0)
    """Seconds per step in the file, for time constants and delays."""
    sampling_rate_Hz: float = Field(gt=0)
    """Of the network's clock; `dt_s` may differ from its inverse."""
    form: str
    """exact, or plain: only CubaLIF and Linear."""
    differences: tuple[str, ...] = ()
    """Differences of the plain form."""
    discretisation: str = DISCRETISATION
    network: dict[str, Any]
    unused: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """alpha, beta and threshold of an integrator's readout, which it does not use; without hidden neurons, of both."""
    bias: tuple[float, ...] | None = None
    """Initial values of an integrator."""
    classes: tuple[str, ...]
    encoder: dict[str, Any] | None = None
    """Of a graph that begins with afferents: its input is a recording after `conditioning`."""
    refractory_steps: dict[str, int] | None = None
    """Of sa1 and ra1; NIR's neurons have none."""
    lowered: bool = False
    """Whether the refractory periods are written as nodes."""
    exit_patience: int | None = Field(default=None, ge=1)
    """Early exit: decide when the same class has led for more steps than this, counted from the first readout spike;
    NIR does not define it."""
    outside: tuple[str, ...] = ()
    """What of the chain the graph does not hold, in words."""
    encoder_outside: dict[str, Any] | None = None
    """Of a graph that begins with spikes: the encoder that makes them."""
    step_ms: float | None = Field(default=None, gt=0)
    """Of a graph that receives spikes in bins: their length."""
    input_Hz: float | None = Field(default=None, gt=0)
    """Of such a graph: steps per second of the spikes that are put into bins."""
    gone = {"exit_margin": None}
    exit_from_first_spike: bool = True
    least_lead: float = Field(default=0.0, ge=0, exclude_if=lambda lead: not lead)
    """A class that leads by less at the decision is refused; NIR does not define it."""
    exit_band: SavedBand = Field(default=(), exclude_if=lambda band: not band)
    """Of numbers: early exit when none has moved by more for more steps than the patience."""
    neurotact: str = __version__

    @model_validator(mode="after")
    def _has_a_band_of_its_numbers(self) -> "Note":
        check_band(self.exit_band, self.classes)
        return self

    @property
    def rule(self) -> ExitRule:
        return ExitRule(self.exit_patience, self.exit_from_first_spike, self.least_lead, self.exit_band)

    def metadata(self) -> dict[str, Any]:
        """As a graph's metadata."""
        return {"dt": self.dt_s, KEY: json.dumps(self.model_dump(mode="json"))}


def of(graph: Any, source: str) -> Note | None:
    """The note in a graph; None of another program's graph."""
    metadata = graph.metadata if isinstance(graph.metadata, dict) else {}
    if KEY not in metadata:
        return None
    try:
        table = json.loads(metadata[KEY])
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{source}: its note 'neurotact' is not JSON; write it again with neurotact export") from error
    if not isinstance(table, dict):
        raise InputError(f"{source}: its note 'neurotact' is not a table; write it again with neurotact export")
    note = build(Note, table, source=f"{source}, neurotact")
    if not math.isclose(float(metadata.get("dt", math.nan)), note.dt_s, rel_tol=1e-12):
        raise InputError(f"{source}: its dt differs from that of its note; write it again with neurotact export")
    return note
