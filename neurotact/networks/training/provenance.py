"""What a network was trained on: the encoder of its spikes, and the content of the trials on each side of the split.

Trials are identified by the digest of the recording. It stays the same if a recording is encoded again, saved in
another file, or moved within a file. A recording with another digest, such as a copy at another rate, is identified by
its spikes if they are equal and many.
"""

import base64
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, PlainSerializer, ValidationError

from neurotact import plugins
from neurotact.data.copies import are_telling
from neurotact.data.digests import DIGITS, spike_digests
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.encoders.model import name_in, of_name
from neurotact.metrics.synops import UNSEEN
from neurotact.spec import Spec


def _packed(digests: tuple[str, ...]) -> str | tuple[str, ...]:
    """Digests as the Base64 text of their bytes, a third of a list's length; a list if they are no digests of ours.

    >>> _packed(("0123456789abcdef", "fedcba9876543210")), _packed(("touch 1",))
    ('ASNFZ4mrze/+3LqYdlQyEA==', ('touch 1',))
    """
    are_ours = all(len(digest) == DIGITS and not set(digest) - set("0123456789abcdef") for digest in digests)
    return base64.b64encode(bytes.fromhex("".join(digests))).decode() if are_ours else digests


def _unpacked(digests: Any) -> Any:
    """The digests of a text by `_packed`; lists are of earlier versions, or not ours."""
    if not isinstance(digests, str):
        return digests
    text = base64.b64decode(digests, validate=True).hex()
    if len(text) % DIGITS:
        raise ValueError(f"must hold {DIGITS // 2} bytes for each trial")
    return [text[at : at + DIGITS] for at in range(0, len(text), DIGITS)]


_Digests = Annotated[
    tuple[str, ...], BeforeValidator(_unpacked), PlainSerializer(_packed, str | tuple[str, ...], "json")
]


class _Trials(Spec):
    """The trials of one side, by their digests (`data.digests`)."""

    recorded: _Digests = ()
    """Digests of the recordings; none if the spikes file did not have them."""
    spikes: _Digests
    """Digests of the spikes, for files without digests of the recordings."""


class _SplitTrials(Spec):
    """The trials of every side."""

    training: _Trials
    validation: _Trials
    test: _Trials


SIDES = tuple(_SplitTrials.model_fields)
RATE = "recorded_Hz"
"""Key of an encoder's table that describes the recording."""
"""From the most seen side to the least seen."""


class Provenance(Spec):
    """The spikes that a network was trained on."""

    encoder: dict[str, Any]
    afferents: tuple[str, ...]
    trials: _SplitTrials

    def sides(self, trains: SpikeTrains) -> np.ndarray:
        """The side that each trial was on, `(trial,)` text: one of `SIDES`, or `UNSEEN`.

        If the content of a trial was on several sides, the most seen one counts: training, then validation.
        """
        if not self._is_recorded(trains):
            return self._sides_of("spikes", spike_digests(trains))
        sides = self.sides_of_recorded(trains.trial_digests)
        unknown = np.flatnonzero(sides == UNSEEN)
        unknown = unknown[are_telling(trains, unknown)]
        if len(unknown):
            sides[unknown] = self._sides_of("spikes", spike_digests(trains.select(unknown)))
        return sides

    def with_training(self, new: "Provenance") -> "Provenance":
        """The same if the training trials of `new` were trained on, too."""
        seen, also = self.trials.training, new.trials.training
        recorded = (*seen.recorded, *also.recorded) if seen.recorded else ()
        training = _Trials(recorded=recorded, spikes=(*seen.spikes, *also.spikes))
        return self.model_copy(update={"trials": self.trials.model_copy(update={"training": training})})

    def with_first(self, n: int) -> "Provenance":
        """The same with the first n training trials alone: those after them were learned later, by `with_training`."""
        first = {key: digests[:n] for key, digests in self.trials.training}
        return self.model_copy(update={"trials": self.trials.model_copy(update={"training": _Trials(**first)})})

    def sides_of_recorded(self, digests: Iterable[str]) -> np.ndarray:
        """The side that each recording was on, by its digest (`data.digests`)."""
        return self._sides_of("recorded", digests)

    def tested(self, trains: SpikeTrains) -> np.ndarray:
        """The trials with content that was on the test side, ascending; it may have been on another side too."""
        if self._is_recorded(trains):
            return np.flatnonzero(np.isin(trains.trial_digests, self.trials.test.recorded))
        return np.flatnonzero(np.isin(spike_digests(trains), self.trials.test.spikes))

    def _is_recorded(self, trains: SpikeTrains) -> bool:
        """Whether the digests of the recordings are known of both."""
        return bool(trains.trial_digests and self.trials.training.recorded)

    def _sides_of(self, kind: Literal["recorded", "spikes"], digests: Iterable[str]) -> np.ndarray:
        side_of = {digest: side for side in reversed(SIDES) for digest in getattr(getattr(self.trials, side), kind)}
        return np.array([side_of.get(digest, UNSEEN) for digest in digests], object)


def provenance_of(trains: SpikeTrains, split: Split) -> Provenance:
    """The provenance of a network that is trained on these sides of these spike trains."""
    of_spikes, recorded = np.array(spike_digests(trains)), np.array(trains.trial_digests)
    sides = {
        side: _Trials(
            recorded=tuple(recorded[trials].tolist()) if len(recorded) else (), spikes=tuple(of_spikes[trials].tolist())
        )
        for side, trials in zip(SIDES, split, strict=True)
    }
    return Provenance(encoder=dict(trains.encoder), afferents=trains.afferents, trials=_SplitTrials(**sides))


class _Difference(NamedTuple):
    """A key with different values in two encodings; a value is None if it is absent."""

    key: str
    theirs: Any
    ours: Any

    def __str__(self) -> str:
        theirs, ours = ("absent" if value is None else f"{value}" for value in (self.theirs, self.ours))
        return f"{self.key} is {theirs} but was {ours} in training"


def first_difference(
    encoder: Mapping[str, Any], afferents: Iterable[str], trained_encoder: Mapping[str, Any], trained_on: Iterable[str]
) -> _Difference | None:
    """The first key of an encoder (with its conditioning), or the first afferent, that differs from training.

    Defaults are filled in: a spec that gains a key stays the same encoder. The rate of the recording may differ.

    >>> str(first_difference({"sa1": {"t_ref_ms": 5}}, ["SA-I a"], {"sa1": {"t_ref_ms": 1}}, ["SA-I a"]))
    'sa1.t_ref_ms is 5 but was 1 in training'
    >>> first_difference({"v_rest_mV": -65}, ["SA-I a"], {"v_rest_mV": -65.0}, ["SA-I a"])
    """
    theirs, ours = (dict(_flat(_with_defaults(table))) for table in (encoder, trained_encoder))
    theirs, ours = (
        keys | {f"afferent {number}": name for number, name in enumerate(names, start=1)}
        for keys, names in ((theirs, afferents), (ours, trained_on))
    )
    for key in {**ours, **theirs}:
        if theirs.get(key) != ours.get(key):
            return _Difference(key, theirs.get(key), ours.get(key))
    return None


def _with_defaults(encoder: Mapping[str, Any]) -> Mapping[str, Any]:
    """An encoder's table with its defaults; unchanged if this version does not know the model."""
    name = name_in(encoder)
    try:
        table = encoder
        if plugins.has("encoders", name):
            table = of_name(name).spec.model_validate(encoder).model_dump(mode="json")
        return {key: value for key, value in table.items() if key != RATE}
    except ValidationError:
        return encoder


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and plain values of nested tables and lists, without None."""
    if isinstance(value, Mapping):
        pairs = value.items()
    elif isinstance(value, (list, tuple)):
        pairs = enumerate(value)
    else:
        if value is not None:
            yield key, value
        return
    for name, inner in pairs:
        yield from _flat(inner, f"{key}.{name}" if key else str(name))
