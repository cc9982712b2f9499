"""The report page of a run folder: it reads tables and computes nothing.

Other rooms take:

    answer: Answer, Baseline, Network, Trials, interval_of, opponents_of
    encoding_drawings: name_classes
    first_screen: interval_in_words, mark, table_of_configurations, with_interval, within
    front: Front, as_json, baseline_as_json, baselines_of, costs_of
    networks: DOWNLOADS, Steps, means_table, write
    page: Figure, PRINTED, Table, if_there, write
    period_choice: Places, as_c, in_folds
    periods: NONE, head, in_ms, of_rows, sizes
    report: write
    running: writer
    sentences: verdict
    tables: afferents_of, first_spikes, tables_beside, with_pair, with_setting
    under_prices: times, turning
    way_answer: Configuration, WayAnswer, answers
    ways: DOWNLOADS, over_rows, seen
    wording: Measure, chance_of, count, energy, milliseconds, p_of, percent
"""
