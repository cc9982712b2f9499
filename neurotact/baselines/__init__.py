"""The door of the classifiers that networks are compared with: inputs, choice by validation, costs, sentences.

Other rooms take:

    features: averaged, bin_edges, counted
    opponent: Candidate, Opponent, Opponents, Settings, Sides, Takes, accuracy, best_of, joined, load, named,
        part_of, right, rounded, say_once, standardised
    opponents: BINS, Cuts, ERRORS, Input, LINEAR, MOST_SAMPLES, RIGHT, ROUNDED, SPIKES, cuts_of, gru_steps,
        in_words, pieces_of, rows, signal_inputs, spike_inputs, without_slow
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
