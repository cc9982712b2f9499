"""A trained chain as C99, from a raw sample to a decision, in float32 or in integers.

- `integer`: the chain in integers, as a microcontroller without a floating-point unit computes, defined in NumPy;
  `formats` chooses the formats from recorded ranges. `fine_tuning` continues the training of a network with weights
  that are rounded in the same way.
- `c_export`: C99. The float32 variant equals `neurotact_parts.streams.stream` and the integer variant equals
  `integer`, spike for spike; `proof` compiles it, runs it here and in an emulated Cortex-M, and compares.
- `bill`: instructions, flash and RAM of a decision on an emulated processor, beside those of opponents, whose C is in
  `opponents`.
"""
