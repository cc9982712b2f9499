"""What type checkers see of `tools.py`; nothing of the packages beside this one is imported for it."""

from typing import Any

from neurotact_parts.networks.search.tune import tune as tune
from neurotact_parts.streams.flow import Flow as Flow
from neurotact_parts.streams.flow import stream as stream
from neurotact_parts.streams.stream import Stream as Stream
from neurotact_parts.streams.stream_state import Decision as Decision
from neurotact_parts.streams.streamed import SampleSpec, StreamedSpec

Samples = SampleSpec
Streamed = StreamedSpec
TOOLS: tuple[str, ...]

def __getattr__(name: str) -> Any: ...
