"""Recurrent spiking networks: definition, training, early exit, exchange.

Other rooms take:

    definition.clock: apart, binned, spread, steps_per_bin
    definition.executors: FEATURES, LIF_INSTEAD, Subject, lacking, left_outside, require
    definition.learned: Balance, LearnSpec
    definition.module: ModuleNetwork, new
    definition.native: addresses_of, device_of, exits_at, shape_of
    definition.network: Network
    definition.optimisers: kind_of
    definition.parts: Sizes
    definition.readouts: Integration, Stretches
    definition.recipe: Seen, TAU_SHARE, chosen_for, described, joined_cost, resolve, training_of, void_keys
    definition.rsnn: FEED_FORWARD, RECURRENT, RSNN, rsnn_of
    definition.seeds: of_start
    definition.space: SearchSpec, check, load_space
    definition.specs: BUILT_IN, RSNNSpec, TrainingSpec, given_keys, part_of
    definition.surrogate: FastSigmoid, arctan, fast_sigmoid
    exit.patience: ExitChoice, exits, in_words, is_tolerated, oracle_exit, upper_bound
    exit.rule: ExitRule, FULL_WINDOW, Leader, SavedBand, check_band, leads
    exit.truncated: SimulatedWindows, judged, simulate_windows
    training.balancing: SETTINGS, columns_of, note
    training.cautions: FEW_PER_CLASS, MEMBER, calibrated, copies, few_test_trials, not_learned, together, training
    training.cross_validation: TABLE, line, run, tasks_of
    training.epochs: Epoch, Examples, Training, best_in, best_of, evaluate, train
    training.events: DetectorSpec, in_parts, labels_of, names_of
    training.linear: INVERSE_PENALTIES
    training.losses: absolute_error, cross_entropy, hinge, squared_error
    training.model_selection: RuledOut, SEEN, Tried, again, are_unranked, best_of, candidates, right_seen, rule_out,
        trainings
    training.numbers: check, errors, groups_of, interval, of_trials
    training.outcome: outcome_of, summary_of
    training.ranges: OF_EVENTS, Ranges, evenly, record, record_states
    training.resumable: RESULT, check_apart, check_place, clear, line_of, run, saved_in
    training.run_folder: LOG, NETWORK, Restored, WEIGHTS, files_of, load_network, load_spikes_of, restore, save,
        save_network, shapes_of, test_trials, trained_spikes_of
    training.sparsity: prune, pruned_stay_pruned
    training.tasks: Sides, Task, check_refuse, examples_of, held_out, kind_of_copies, labels_of, load_spikes, names_of,
        of_file, path_of, seen, seen_trials, sides_of, task_of, to_calibrate, trials_of, with_every_condition,
        with_suited_window
    training.trainer: Trained, exit_of, finished, fit, new_trained, refusing
    use.classifier: SpikingClassifier
    use.exporters: Exporter, export, exporter, usable
    use.fitted: Fitted, check_folder, is_in_memory, name_of, restore
    use.inference: infer
    use.ledger: ABOUT, Afferents, SOPS, decision_ledger, input_spikes, is_row_counted, network_cost, row_cost,
        study_ledger
    use.measuring: OWN_KEYS, accuracy_of, by_condition, mean_sops, means, measure, right_of, synops_of, touched
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
