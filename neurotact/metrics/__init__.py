"""Measures of spike trains and networks: rates, intervals, synaptic operations, costs.

Other rooms take:

    decision: Decision, is_within, otherwise
    firing: firing_of, touch_spikes, windowed_spikes
    flops: ACTIVATIONS, BYTES, Cost, Dense, FLOPS, Integrator, LEDGER_COLUMNS, Layer, Moments, MovingAverage,
        NearestPoints, NotCounted, SIGMOID, SYNAPSES, SpikingLayer, Standardise, TANH, changed, cost, in_registers,
        index_bytes, ledger_table, passed, with_weights
    fronts: pareto_front
    isi_distributions: bin_edges, bins_of, separation, shares_of
    linear: FOLDS, cross_validated_accuracy, linear
    paired: Paired, by_trial, compare, compare_by_trial, compare_shares, p_in_words
    power: WEAK, can_beat_guessing, in_words, is_too_weak
    prices: ACCESSES, ARITHMETIC_45NM, DEFAULT, MEMORY_45NM, NEURONS, PRICED, PriceList, Priced, WIDE, names, price_list
    referee: GAP, Verdict, Way, best_of, cheapest_of, holm, is_gap, judge, least_difference, level_with_best,
        may_be_cheapest
    resampled: DIFFERENCES, Interval, LEAST_SPLITS, SHARES, compare_over_splits, least_difference_over_splits,
        resampled_error, resampled_interval, resampled_p, sizes_of
    savings: Savings, savings, worse_than_another
    shares: standard_error, wilson_interval
    signal_flops: Averaging, BaselineRemoval, Interpolation, Rectification, ScaledSteps, StandardisedSteps
    spike_trains: Events, Spikes, check_rate, events_of_raster, isis_ms, rates_Hz, spike_counts
    starts: FITTED, ONE, Spread, interval, spread
    synops: OF_NUMBERS, REFUSED, SIDE, SIDES, Synops, TEST, TRAINING, UNKNOWN, UNSEEN, VALIDATION, in_words,
        not_counted, of_network, summary, summary_markdown, table_of
"""
