"""What neurotact writes beside the nodes: the step, the clock, the specs, the exit rule, and what is left out."""

import json
import math
from typing import Any

from pydantic import Field

from neurotact import __version__
from neurotact.errors import InputError
from neurotact.networks.early_exit import ExitRule
from neurotact.spec import Spec, build

KEY = "neurotact"
DISCRETISATION = "forward Euler in steps of dt_s; a cycle without a Delay comes back in the next step"


class Note(Spec):
    """`metadata/neurotact` of a file, as JSON."""

    dt_s: float = Field(gt=0)
    """Of a step in the file; time constants and delays are in its units."""
    sampling_rate_Hz: float = Field(gt=0)
    """Of the network's clock, which `dt_s` need not be the inverse of."""
    form: str
    """exact, or plain: CubaLIF and Linear alone."""
    differences: tuple[str, ...] = ()
    """What the plain form does otherwise."""
    discretisation: str = DISCRETISATION
    network: dict[str, Any]
    unused: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """alpha, beta and threshold that an integrator's readout has and does not use."""
    bias: tuple[float, ...] | None = None
    """Of an integrator, from which its sums begin."""
    classes: tuple[str, ...]
    encoder: dict[str, Any] | None = None
    """Of a graph that begins with afferents: its input is what `conditioning` makes of a recording."""
    refractory_steps: dict[str, int] | None = None
    """Of sa1 and ra1, which NIR's neurons lack."""
    lowered: bool = False
    """Whether the refractory periods are made of nodes."""
    exit_patience: int | None = Field(default=None, ge=1)
    """Early exit: decide when the leading class has stood for more steps than this, counted from the first readout
    spike; NIR has no word for it."""
    exit_margin: float | None = Field(default=None, gt=0)
    """In place of a patience: decide when the leading class is ahead by this."""
    exit_from_first_spike: bool = True
    neurotact: str = __version__

    @property
    def rule(self) -> ExitRule:
        return ExitRule(self.exit_patience, self.exit_from_first_spike, self.exit_margin)

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
    found = build(Note, table, source=f"{source}, neurotact")
    if not math.isclose(float(metadata.get("dt", math.nan)), found.dt_s, rel_tol=1e-12):
        raise InputError(f"{source}: its dt is not that of its note; write it again with neurotact export")
    return found
