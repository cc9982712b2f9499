"""Sweeps over specs: cells, runner, calibration, claims, report."""
