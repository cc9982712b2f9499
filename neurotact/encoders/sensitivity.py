"""What calibration turns in an encoder of any model: the gain of each population, or a threshold that all share."""

from typing import Any, NamedTuple

from neurotact.encoders.model import EncoderSpec, sensitivity_key
from neurotact.encoders.specs import described, dotted, populations


class Sensitivity(NamedTuple):
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


def sensitivities_of(encoder: EncoderSpec) -> tuple[Sensitivity, ...]:
    """The sensitivities of an encoder, in the order of its output: the first gain or threshold of each part.

    >>> from neurotact.encoders.specs import load
    >>> [sensitivity[:2] for name in ("poisson", "send-on-delta") for sensitivity in sensitivities_of(load(name))]
    [('sa1.gain_Hz', 'SA-I'), ('ra1.gain_Hz', 'RA-I'), ('threshold', 'ON and OFF')]
    """
    sensitivities = []
    for part in dict.fromkeys(population.part for population in populations(encoder)):
        its = [population for population in populations(encoder) if population.part == part]
        key = sensitivity_key(type(described(encoder, its[0])))
        assert key is not None  # else the model is unfit
        names = tuple(population.name for population in its)
        sensitivities.append(Sensitivity(dotted(part, key), " and ".join(names), names, key.startswith("threshold")))
    return tuple(sensitivities)


def value_of(encoder: EncoderSpec, sensitivity: Sensitivity) -> float:
    """Where a sensitivity stands.

    >>> from neurotact.encoders.specs import load
    >>> encoder = load("send-on-delta", {"threshold": 2.5})
    >>> value_of(encoder, sensitivities_of(encoder)[0])
    2.5
    """
    value: Any = encoder
    for key in sensitivity.key.split("."):
        value = getattr(value, key)
    return float(value)


def adjusted(encoder: Any, sensitivity: Sensitivity, value: float) -> Any:
    """The encoder with a sensitivity at another value.

    >>> from neurotact.encoders.specs import load
    >>> encoder = load("burst")
    >>> adjusted(encoder, sensitivities_of(encoder)[1], 3.0).ra1.gain
    3.0
    """
    part, _, key = sensitivity.key.rpartition(".")
    if not part:
        return encoder.model_copy(update={key: value})
    return encoder.model_copy(update={part: getattr(encoder, part).model_copy(update={key: value})})
