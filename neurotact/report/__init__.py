"""The report page of a run folder: it reads tables and computes nothing.

Other rooms take:

    answer: Baseline, Network, Trials, interval_of
    encoding_drawings: name_classes
    first_screen: mark, table_of_configurations, with_interval, within
    front: Front, baselines_of
    networks: Steps, write
    page: ANSWER, PAGE, Table, if_there, write
    periods: NONE, head, in_ms, of_rows
    report: write
    tables: first_spikes, with_pair
    under_prices: times, turning
    way_answer: Configuration, WayAnswer, answers
    ways: over_rows, seen
    wording: count, energy, percent
"""
