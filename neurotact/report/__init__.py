"""The report page of a run folder: it reads tables and computes nothing.

Other rooms take:

    encoding_drawings: name_classes
    first_screen: table_of_configurations
    networks: DOWNLOADS, Steps, means_table, write
    page: ANSWER, PAGE, PRINTED, RECORDINGS, STUDY, Table, if_there, moved, write
    periods: head, in_ms
    report: write
    tables: first_spikes, with_pair, with_setting
    under_prices: times, turning
    way_answer: Configuration, WayAnswer, answers
    ways: DOWNLOADS, over_rows, seen
    wording: count, energy
"""
