"""What calibration turns in an encoder of any model: the gain of each population, or a threshold that all share."""

from typing import Any, NamedTuple

from neurotact.encoders.specs import EncoderSpec, described, dotted, populations
from neurotact.spec import Spec


class Knob(NamedTuple):
    """A number of an encoder that sets how much it fires.

    key: of the spec, dotted. name: of the populations that it sets, in words. populations: their names.
    is_threshold: more spikes the smaller it is; else it is a gain, and more spikes the larger it is.
    """

    key: str
    name: str
    populations: tuple[str, ...]
    is_threshold: bool

    @property
    def part(self) -> str:
        """The key of the part of the spec that holds it; empty if it is the spec's own."""
        return self.key.rpartition(".")[0]

    @property
    def kind(self) -> str:
        """What it is, in words."""
        return "threshold" if self.is_threshold else "gain"

    @property
    def unit(self) -> str:
        """Its unit on standardised signals, in words."""
        _, _, unit = self.key.rpartition(".")[2].replace("unit_ms", "sd_ms").partition("_")
        return unit.replace("_per_", "/").replace("_", " ") or ("sd" if self.is_threshold else "per sd")


def field_of(kind: Spec) -> str | None:
    """The key of a part of a spec that sets how much it fires: its first gain or threshold; None if it has neither.

    >>> from neurotact.encoders.specs import load
    >>> field_of(load("poisson").sa1), field_of(load("send-on-delta"))
    ('gain_Hz', 'threshold')
    """
    return next((key for key in type(kind).model_fields if key.startswith(("gain", "threshold"))), None)


def knobs_of(encoder: EncoderSpec) -> tuple[Knob, ...]:
    """The knobs of an encoder, in the order of its output: the first gain or threshold of each part of its spec.

    >>> from neurotact.encoders.specs import load
    >>> [knob[:2] for name in ("poisson", "send-on-delta") for knob in knobs_of(load(name))]
    [('sa1.gain_Hz', 'SA-I'), ('ra1.gain_Hz', 'RA-I'), ('threshold', 'ON and OFF')]
    """
    knobs = []
    for part in dict.fromkeys(population.part for population in populations(encoder)):
        its = [population for population in populations(encoder) if population.part == part]
        key = field_of(described(encoder, its[0]))
        assert key is not None  # every model has one
        names = tuple(population.name for population in its)
        knobs.append(Knob(dotted(part, key), " and ".join(names), names, key.startswith("threshold")))
    return tuple(knobs)


def value_of(encoder: EncoderSpec, knob: Knob) -> float:
    """Where a knob stands.

    >>> from neurotact.encoders.specs import load
    >>> encoder = load("send-on-delta", {"threshold": 2.5})
    >>> value_of(encoder, knobs_of(encoder)[0])
    2.5
    """
    value: Any = encoder
    for key in knob.key.split("."):
        value = getattr(value, key)
    return float(value)


def pair_of(encoder: EncoderSpec) -> tuple[float, float]:
    """The gains or thresholds of the first two populations; both are the same where they share one.

    >>> from neurotact.encoders.specs import load
    >>> pair_of(load("sa1-ra1-lif"))
    (3.2, 16.0)
    """
    values = [value_of(encoder, knob) for knob in knobs_of(encoder)]
    return values[0], values[min(1, len(values) - 1)]


def turned(encoder: Any, knob: Knob, value: float) -> Any:
    """The encoder with a knob at another value.

    >>> from neurotact.encoders.specs import load
    >>> encoder = load("burst")
    >>> turned(encoder, knobs_of(encoder)[1], 3.0).ra1.gain
    3.0
    """
    part, _, key = knob.key.rpartition(".")
    if not part:
        return encoder.model_copy(update={key: value})
    return encoder.model_copy(update={part: getattr(encoder, part).model_copy(update={key: value})})
