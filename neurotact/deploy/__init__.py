"""A trained chain in use: sample by sample, as C on a microcontroller, and compared with the limits of other chips.

A chain is causal conditioning -> SA-I and RA-I LIF afferents with their refractory periods -> a network of CUBA-LIF
neurons -> a decision, at the end of a window or as soon as the early-exit rule allows. `chain` builds it from a run
folder and refuses what cannot run sample by sample. `windows` defines where windows start in a signal without an end.
Three modules run the same chain:

- `stream`: in Python, in float32, with the same spikes as `encode` and `infer` on whole trials. It calls the
  functions that define conditioning, encoder and network, with their state as an argument and a result.
- `integer`: in integers, as a microcontroller without a floating-point unit computes; `formats` chooses the formats
  from recorded ranges. This arithmetic is defined there, in NumPy. `fine_tuning` continues the training of a network
  with weights that are rounded in the same way.
- `c_export`: C99 for either. The float32 variant equals `stream` and the integer variant equals `integer`, spike for
  spike; `proof` compiles it, runs it here and in an emulated Cortex-M, and compares.
"""
