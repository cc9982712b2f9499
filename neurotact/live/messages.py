"""What a page may ask for: small, typed, and nothing else. What does not fit is dropped and counted."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

LONGEST = 2_048
"""Bytes of a message."""
SLOWEST, FASTEST = 0.05, 20.0
"""Of a replay, in times its own rate."""

Name = Annotated[str, Field(min_length=1, max_length=64)]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Change(_Message):
    """Other values of the chain: `sa1.t_ref_ms`, `sa1.gain`, ..., and `patience` in steps, null for the full window."""

    kind: Literal["change"]
    values: dict[Name, Number | None] = Field(min_length=1, max_length=16)


class Move(_Message):
    """Other values of the simulated finger."""

    kind: Literal["move"]
    values: dict[Name, Number | Name] = Field(min_length=1, max_length=16)


class Speed(_Message):
    """How fast recordings are replayed, or the finger moves, in times its own rate."""

    kind: Literal["speed"]
    speed: float = Field(ge=SLOWEST, le=FASTEST)


class Label(_Message):
    """What is touched, where the source does not know it; null: unknown."""

    kind: Literal["label"]
    label: Annotated[str, Field(max_length=200)] | None


class Compare(_Message):
    """How many windows are compared before and after a change."""

    kind: Literal["compare"]
    windows: int = Field(ge=1, le=1_000)


class Save(_Message):
    """Save the encoder under a name, in the folder that the command line chose."""

    kind: Literal["save"]
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")


class Do(_Message):
    """Clear the counts, or replay the recordings again."""

    kind: Literal["clear", "again"]


Message = Change | Move | Speed | Label | Compare | Save | Do
_MESSAGE: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="kind")])


def read(text: str) -> Message | None:
    """The message in a text; None where there is none.

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
