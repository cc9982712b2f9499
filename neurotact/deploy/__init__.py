"""A trained chain in use, sample by sample, and the door of exporters, which write it in other forms.

A chain is causal conditioning -> SA-I and RA-I LIF afferents with their refractory periods -> a network of CUBA-LIF
neurons -> a decision, at the end of a window or as soon as the early-exit rule allows. `chain` builds it from a run
folder and refuses what cannot run sample by sample. `windows` defines where windows start in a signal without an end.
`stream` runs it in float32, with the same spikes as `encode` and `infer` on whole trials: in C++ (`native`), or in
Python with the functions that define conditioning, encoder and network, with their state as an argument and a result.
`exporters` finds forms by name: C, NIR, and those of other packages.

Other rooms take:

    chain: Chain, LARGEST, build_encoder, chain_of, encoder_of
    exporters: Exporter, export, exporter, usable
    native: columns_of, numbers_of
    sources: Arrived, at_its_rate, decide, kind_of, live, parser_of, recorded, trouble_of, waiting
    stream: Stream
    stream_state: Decision, Trace
    streamed: SampleSpec, StreamedSpec
"""
