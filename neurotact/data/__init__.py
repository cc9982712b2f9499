"""Recordings, conditioning, windows and splits.

Other rooms take:

    augmentation: AUTO, AugmentationSpec, CopiesWhenRead, NONE, UNRANKED, check_taxels, in_words, varied_copies
    conditioning: ACAUSAL, Baseline, CAUSAL, Conditioned, Conditioner, ConditioningSpec, HALF, PIECE_VALUES,
        acausal_note, check_used, condition, condition_pieces, conditioned_length, ema, ema_coefficient, is_long,
        pieces, sampled_length, standardised
    contact: OnsetSpec, REST_MS
    copies: Copies, are_telling, copies_of, equal_examples, joined, with_touches
    dataset: ALL, DatasetSpec, Progress, Reader, SOURCES, Simulator, expand, load_recordings, load_touches, reader,
        simulator, until
    description: MOST_TAXELS, afferents_table, conditions_table, constant_taxels, held_line, lengths_line, marks_line,
        taxels_summary, taxels_table
    digests: DIGEST, DIGITS, TOUCH, content_digest, recorded_digest, recorded_trials, spike_digests
    doubtful: check, lines, of_copies, warn
    encoded_from: AbsentError, find, opened
    fetch: SETS, fetch, missing, public_set, registry_of
    hdf5: StoredRecordings, encoded_by, kind_of, load, load_recordings, load_spikes, open_recordings, save_recordings,
        save_spikes, spike_writer
    hdf5_input: Declared, EVENTS, attribute, opened, own_members, reading
    hdf5_output: Output, create
    marks: COLUMNS, NONE, labels_at
    onset: common_onset_s, evenly, onsets_s
    readers.clock.units: DAY_S, FASTEST_HZ, HOUR_S, LONGEST_S, SHORTEST_S, SLOWEST_HZ, UNIT_S, Unit, apart,
        is_time_of_day, joined, pair_in, seconds_of, timings, unit_in, without_unit
    readers.columns: CHOICE, Clock, ColumnsSpec, GUESSES, LayoutSpec, Missing, OF_ARRAYS, OF_EVENTS, Samples, called,
        check_rises, chosen_places, clock_of, evenly, is_index, is_text, read_table, samples_of, unit_of
    readers.formats: Arrays, Cells, Format, arrays_in, holding, suffixes, tables_in
    readers.formats.contents: FLAC, HDF5, LVM, MATLAB, MCAP, NPY, NPZ, PARQUET, ROS_BAG, SOUND, SQLITE, TDMS, TORCH,
        ZIP, check_content, content_of, content_of_bytes, damaged_as
    readers.specs: EventSpec, FIELD, FILE, MOST_AFFERENTS, NamingSpec
    readers.table.cells: COMMAS, COMMENT, DECIMAL_COMMA, Decimal, FLOAT32_MAX, LOOKED_AT, MAX_CHANNELS, NEAR_IN_FLOAT32,
        NOT_FINITE, NUMBER, THOUSANDS, Table, as_signal, cells, check_digits, check_width, columns_of, finite_called,
        grouping_of, has_decimal_commas, has_decimals, is_gap, is_meant_as_number, is_value, lines_of, numbers,
        table_of, values_of
    readers.table.headings: SEPARATOR_LINE, UNITS, check_first_row, is_unit, named_table, rate_in, separator_of
    readers.table.texts: read_any_text, read_text, split_header
    recordings: LABEL, Recordings, Trials, check_channels, check_conditions, check_import, check_named_classes,
        check_sampling_rate, class_indices, class_names, default_channels, order_by_name, select_conditions, unit_factor
    spikes: SpikeTrains, TrialSpikes, Variations, empty_raster, from_rasters, from_trials, populations_of, spikes_of
    splits: Split, SplitSpec, Splits, aside_of, check_each, check_stratify, combination, each_left_out, folds_of_groups,
        groups_of, hold_out, hold_out_groups, split_conditions, split_touches, split_trials, training_touches, turns_of,
        validation_note, values_to_leave_out
    spool: Spool
    trial_choice: EVERY, LeaveOut, TrialChoice, Where, Words, chosen_trials, fewer_trials, values_in_words
    window_choice: ARGUMENTS, FOUND, LATE, RESTS, Timing, Words, choose, left_after, on_late_onsets, suited_window,
        timing_of
    windowed: Origin, SpikeArray, WindowedSpikes, in_order, windows
    windows: LONGEST_STEPS, WindowSpec, Windows, check_fit, cut, left_out, steps_of, whole_steps
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
