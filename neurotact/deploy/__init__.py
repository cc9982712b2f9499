"""A trained chain where it is used: sample by sample, as C on a microcontroller, and beside the limits of other chips.

A chain is causal conditioning -> SA-I and RA-I LIF afferents with their refractory periods -> a network of CUBA-LIF
neurons -> a decision, at the end of a window or as soon as the early-exit rule allows. `chain` puts it together from a
run folder and refuses what cannot be carried from one sample to the next. `windows` says where windows start in a
signal that has no end. Three things walk along the same chain:

- `stream`: in Python, in float32, spike for spike what `encode` and `infer` make of whole trials. It calls the
  functions that define conditioning, encoder and network, with their state going in and coming out.
- `integer`: in whole numbers, as a microcontroller without a floating-point unit computes; `formats` chooses the
  formats from recorded ranges. Its own arithmetic is defined there, in NumPy. `fine_tuning` trains a network on with
  weights rounded as they will be there.
- `c_export`: C99 for either. The float32 variant equals `stream`, the integer variant equals `integer`, to the last
  spike; `proof` compiles it, runs it here and in an emulated Cortex-M, and compares.
"""
