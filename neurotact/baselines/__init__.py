"""Classical classifiers for comparison with spiking networks, in scikit-learn's API.

Other rooms take:

    elm: Activation, ELMClassifier
    families: ELM, EXTRA_TREES, KNN, LOGISTIC_REGRESSION, MINIROCKET, POOLED_GRU, SVM, standardised
    features: averaged, bin_edges, counted
    minirocket: MiniRocket, MiniRocketClassifier
    opponent: Opponent, Opponents, Settings, Sides, accuracy, best_of, joined, load, named
    opponents: BINS, Cuts, Input, LINEAR, MOST_SAMPLES, RIGHT, SPIKES, cuts_of, gru_steps, in_words, pieces_of,
        rows, signal_inputs, spike_inputs, without_slow
    pooled_gru: GRU, PooledGRUClassifier
    targets: MachinesMixin, decide, encode, indices_of, signed
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
