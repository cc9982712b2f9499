"""Readers of published data sets and of common formats."""
