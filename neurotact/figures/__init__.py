"""Figures for print, for any study.

Other rooms take:

    calibration: draw_calibration
    columns: in_unit, name_of, quantity
    conditions: draw_conditions
    encoding: Classes, POPULATIONS, draw_isis, draw_rasters, draw_rates, draw_spike_counts
    labels: label_points
    networks: Published, Spent, cost_of, draw_accuracy_and_sops, draw_confusion, draw_trade_off, draw_training
    raster: PALETTE, draw_raster, existing_trial, write_events, write_raster
    style: Drawn, INK, MUTED, PAIR_AXIS, PAIR_TITLE, PALE, RA, SA, SERIES, SYMBOLS, TOTAL, add_legend, bars,
        keep_within, name_ticks, new_figure, new_panels, printed, save, sequence, series_style
"""
