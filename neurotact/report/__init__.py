"""The report page of a run folder: it reads tables and computes nothing.

Other rooms take:

    encoding_drawings: name_classes
    first_screen: table_of_configurations
    networks: Steps, write
    page: Table, if_there, write
    periods: head, in_ms
    report: write
    running: writer
    tables: first_spikes, with_pair
    under_prices: times, turning
    way_answer: Configuration, WayAnswer, answers
    ways: over_rows, seen
    wording: count, energy
"""
