"""The front door: one function for each thing that a user does, on objects in memory or on files.

Each joins rooms that know nothing of one another; estimators, specs and arrays come from their own rooms. The command
line calls these functions alone, so that both do the same with the same defaults.

Other rooms take:

    encoding: calibrate, encode, encode_file, plot_raster, save_raster
    networks: infer, load_network, result, save_network, sops, summarise, train
    recordings: ARRAY_NAMES, EVENT_NAMES, describe, fetch, load, load_recordings, load_spikes, read, read_arrays,
        read_events, read_folder, read_raster, read_table, save, simulate
    settings: Events, Layout, Learn, Naming, Onset, Search, Split, Window
    specs: keys_of, of_other_packages, spec_names
    studies: is_begun, report_study, resume_study, run_study, study_answer
"""
