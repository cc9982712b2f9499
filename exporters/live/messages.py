"""The requests that a page may send: small and typed. All others are dropped and counted."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

LONGEST = 2_048
"""Maximum number of bytes of a message."""
SLOWEST, FASTEST = 0.05, 20.0
"""Speed of a replay, as a multiple of its own rate."""

Name = Annotated[str, Field(min_length=1, max_length=64)]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Change(_Message):
    """New values of the chain: `sa1.t_ref_ms`, `sa1.gain`, ..., and `patience` in steps, null for the full window."""

    kind: Literal["change"]
    values: dict[Name, Number | None] = Field(min_length=1, max_length=16)


class Move(_Message):
    """New values of the simulated finger."""

    kind: Literal["move"]
    values: dict[Name, Number | Name] = Field(min_length=1, max_length=16)


class Speed(_Message):
    """Speed of the replay or of the finger, as a multiple of its own rate."""

    kind: Literal["speed"]
    speed: float = Field(ge=SLOWEST, le=FASTEST)


class Label(_Message):
    """The touched class, if the source does not know it; null: unknown."""

    kind: Literal["label"]
    label: Annotated[str, Field(max_length=200)] | None


class Compare(_Message):
    """Number of windows to compare before and after a change."""

    kind: Literal["compare"]
    windows: int = Field(ge=1, le=1_000)


class Save(_Message):
    """Save the encoder under a name, in the folder of `save_to`."""

    kind: Literal["save"]
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")


class Do(_Message):
    """Clear the counts, or replay the recordings again."""

    kind: Literal["clear", "again"]


Message = Change | Move | Speed | Label | Compare | Save | Do
_MESSAGE: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="kind")])


def read(text: str) -> Message | None:
    """The message in a text; None if it is not valid.

    >>> read('{"kind": "speed", "speed": 2}')
    Speed(kind='speed', speed=2.0)
    >>> read('{"kind": "speed", "speed": 1e9}'), read("[" * 1000), read('{"kind": "eval", "code": "1"}')
    (None, None, None)
    """
    if len(text) > LONGEST:
        return None
    try:
        return _MESSAGE.validate_json(text)
    except (ValidationError, RecursionError):
        return None
