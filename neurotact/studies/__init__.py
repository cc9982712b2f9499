"""The engine of studies: specs, cells, their computation, tables and claims.

Other rooms take:

    automatic: FOLDS, TESTED, WORDS
    cell: RIGHT_SEEN, SEARCH, Searched, task_of
    encoding_tables: TOUCH, periods, read_encoding
    executors: modules
    loading: Study, choice_changes, engine_of, resolve
    measures: INTEGERS, Measure, RECONSTRUCTION, requested
    networks: ENGINE
    runner: STUDY, add_report_time, load, run, write_tables
    store: ANSWER, BASELINES, PAGE, RECORDINGS, RESULT, STUDY, cell_folder, is_done, moved, result_of, timed
    study: Cell, PARTS, SPLIT, StudySpec, by_split, cells, encoder_columns, encoder_names, has_one_split,
        has_one_window, setting_columns, split_columns, swept_columns, to_toml, value_at
    sweeps: JOIN, values
    way: ALL_SETS, HEADS, Listed, Named, View, module_of, optional
    way_cells: load_arrays
    way_study: WayStudy, cells
"""
