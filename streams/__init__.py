"""A trained chain in use, sample by sample; found by name, as the tools of others.

A chain is causal conditioning -> SA-I and RA-I LIF afferents with their refractory periods -> a network of CUBA-LIF
neurons -> a decision, at the end of a window or as soon as the early-exit rule allows. `chain` builds it from a run
folder and refuses what cannot run sample by sample. `windows` defines where windows start in a signal without an end.
`stream` runs it in float32, with the same spikes as `encode` and `infer` on whole trials: in C++ (`native`), or in
Python with the functions that define conditioning, encoder and network, with their state as an argument and a result.
`sources` reads samples from a pipe, a device or a file, and `flow` decides them: `nt.stream`.
"""
